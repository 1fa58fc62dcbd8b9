"""The measures of a joystick design, compared with closed forms and runs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

import hapticd
from hapticd.base.errors import HapticdError
from hapticd.config.materials import shipped_materials
from hapticd.sweeps.columns import Row
from hapticd.sweeps.measures.registry import parse_measure
from hapticd.sweeps.point import Point


def measured(given: Any, document: dict[str, Any]) -> Row:
    measure = parse_measure(given)
    found = measure.of(Point(document, "none"))
    assert list(found) == [column.name for column in measure.columns]
    return found


# ---- Colgate and Schenkel --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rate_hz", "b", "damping", "delay_s"),
    [
        (1000, 0.2, 0.0, 0.0),
        (10_000, 0.2, 0.0, 0.0),
        (4000, 1.5, 0.3, 0.0),
        (2000, 0.4, 0.1, 0.001),
        (1000, 2, 0, 0.005),
    ],
)
def test_the_passive_limit_is_its_closed_form(rate_hz: float, b: float, damping: float, delay_s: float) -> None:
    """K = (b - |D|) / (T/2 + t_d) (Colgate and Schenkel 1997)."""
    document = {
        "servo": {"rate_hz": rate_hz},
        "device": {"sim": {"handle_damping_n_s_per_m": b, "report_delay_s": delay_s}},
        "materials": {"m": {"stiffness_n_per_m": 100, "damping_n_s_per_m": damping}},
    }
    found = measured({"passive_limit": {"material": "m"}}, document)
    assert found["passive_limit_n_per_m"] == pytest.approx((b - damping) / (0.5 / rate_hz + delay_s), rel=1e-9)


def test_no_stiffness_is_passive_with_more_damping_than_the_handle_has() -> None:
    document = {"materials": {"m": {"stiffness_n_per_m": 100, "damping_n_s_per_m": 0.3}}}
    assert measured({"passive_limit": {"material": "m"}}, document) == {"passive_limit_n_per_m": 0.0}


def test_the_passive_limit_needs_a_material_and_a_handle() -> None:
    with pytest.raises(HapticdError, match="unknown material paper"):
        measured({"passive_limit": {"material": "paper"}}, {})
    with pytest.raises(HapticdError, match=r"device\.handle is not given"):
        measured({"passive_limit": {"material": "wood"}}, {"device": {"kind": "hid"}})


# ---- Displayed materials ---------------------------------------------------------------------------------------------

SEVEN = ["wood", "acrylic", "delrin", "aluminum", "glass", "cast_iron", "steel"]
GOOD: dict[str, Any] = {
    "device": {"compensation": "mass", "max_force_n": 40, "sim": {"handle_mass_kg": 0.12, "max_force_n": 100}}
}


def displayed(document: dict[str, Any], **options: Any) -> Row:
    return measured({"displayed_materials": {"materials": SEVEN, **options}}, document)


def changed(**device: Any) -> dict[str, Any]:
    sim = {**GOOD["device"]["sim"], **device.pop("sim", {})}
    return {"device": {**GOOD["device"], **device, "sim": sim}}


def test_a_good_design_displays_all() -> None:
    found = displayed(GOOD)
    assert found["suffices"] is True and found["displayed"] == 7 and found["not_displayed"] is None


def test_the_worst_error_is_the_largest_displayed_error() -> None:
    each = [measured({"displayed_error": {"material": name}}, GOOD)["displayed_error"] for name in SEVEN]
    assert displayed(GOOD)["worst_error"] == max(each)  # type: ignore[type-var]


def test_without_compensation_the_force_is_that_of_the_mode_in_the_library() -> None:
    """(m + m_h) A max(exp(-B t) sin(w t)), A = slope v."""
    largest = 0.0
    for name in SEVEN:
        tap = shipped_materials()[name].tap
        assert tap is not None and tap.attack_slope_per_s is not None
        assert tap.frequency_hz is not None and tap.decay_time_s is not None
        w, decay = 2 * np.pi * tap.frequency_hz, 1 / tap.decay_time_s
        top = minimize_scalar(
            lambda t, w=w, decay=decay: -np.exp(-decay * t) * np.sin(w * t),
            bounds=(0, np.pi / w),
            method="bounded",
            options={"xatol": 1e-12},
        )
        largest = max(largest, 0.13 * tap.attack_slope_per_s * 0.2 * -top.fun)
    found = displayed(changed(compensation="off"), speed_m_per_s=0.2, error_at_most=10)
    assert found["needed_force_n"] == pytest.approx(largest, rel=1e-9)


@pytest.mark.parametrize("compensation", ["off", "mass"])
def test_a_tap_needs_at_most_the_reported_force(compensation: str) -> None:
    """A tap at 0.1 m/s in the open loop: its largest vibration is between 2/3 and 1 of the reported force.

    A wave is only six ticks long, so that the samples may miss its peak.
    """
    document = changed(compensation=compensation)
    wall = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "steel"}
    found = measured({"displayed_materials": {"materials": ["steel"], "speed_m_per_s": 0.1}}, document)
    needed_n = found["needed_force_n"]
    assert isinstance(needed_n, float)
    peaks = []
    for phase in np.linspace(0, 1, 8, endpoint=False):
        y = 0.002 - 0.1 / 10_000 * (np.arange(400) + phase)
        samples = hapticd.render({**document, "scene": {"objects": {"w": wall}}}, np.column_stack([0 * y, y]))
        peaks.append(float(np.abs(samples["vibration_force_n"]).max()))
    assert 0.67 * needed_n < max(peaks) <= needed_n * (1 + 1e-3)


@pytest.mark.parametrize(
    ("device", "options", "reason", "count"),
    [
        ({"sim": {"handle_damping_n_s_per_m": 0.01}}, {}, "may oscillate: wood, acrylic, delrin", 0),
        ({"sim": {"encoder_step_m": 0.001}}, {}, "may oscillate: wood", 0),
        (
            {"sim": {"link": {"rate_hz": 1000}, "handle_damping_n_s_per_m": 5}},
            {"error_at_most": 2},
            "rate too low: aluminum, glass",
            3,
        ),
        ({"compensation": "off"}, {}, "error: aluminum 47 %, glass 5", 3),
        ({"max_force_n": 12}, {}, "force: cast_iron 13 N, steel 15 N", 5),
    ],
)
def test_a_material_that_is_not_displayed_has_its_first_reason(
    device: dict[str, Any], options: dict[str, Any], reason: str, count: int
) -> None:
    found = displayed(changed(**device), **options)
    assert isinstance(found["not_displayed"], str) and reason in found["not_displayed"]
    assert found["displayed"] == count and found["suffices"] is False


def test_a_wall_is_stable_if_its_margin_is() -> None:
    """The limit is 2 b/T = 4000 N/m for the default handle, so 800 N/m have a margin of 5; 1/5 of b gives 1."""
    for damping, stable in ((0.0401, True), (0.0399, False)):
        sim = {"handle_damping_n_s_per_m": damping, "encoder_step_m": 0, "force_step_n": 0}
        assert displayed(changed(sim=sim))["suffices"] is stable


def test_a_material_without_one_mode_is_refused() -> None:
    with pytest.raises(HapticdError, match="cellophane is not a material with a tap of one mode"):
        measured({"displayed_materials": {"materials": ["cellophane"]}}, {})
