"""Measures, compared with closed forms and with separate runs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import hapticd
from bench.displayed import moved_error
from hapticd.analysis.calibration.verify import ONSET_LEAD_PERIODS
from hapticd.base.errors import HapticdError, InvalidError
from hapticd.config.materials import shipped_materials
from hapticd.sweeps.columns import Row
from hapticd.sweeps.keys import Run
from hapticd.sweeps.measures.registry import MEASURE_CLASSES, parse_measure
from hapticd.sweeps.point import Point
from tests.sweeps.results_of import FLOOR

EXACT = {"sim": {"encoder_step_m": 0, "force_step_n": 0, "coulomb_friction_n": 0}}
BASE: dict[str, Any] = {"materials": {"m": {"stiffness_n_per_m": 200}}, "scene": {"objects": {"floor": FLOOR}}}
DOWN = {"waypoints": [[0, 0, 0.01], [0.2, 0, -0.01]]}


def measured(given: Any, document: dict[str, Any], run: Run = "simulate") -> Row:
    measure = parse_measure(given)
    found = measure.of(Point(document, run))
    assert list(found) == [column.name for column in measure.columns]
    return found


def test_the_peak_force_of_a_path_into_a_wall_is_stiffness_times_depth() -> None:
    """Open loop: f = K d at the last tick, whose depth is 10 mm minus the distance of one tick."""
    found = measured("peak_force_n", {**BASE, "operator": DOWN}, "render")
    rate_hz = 10_000.0
    assert found["peak_force_n"] == pytest.approx(200 * (0.01 - 0.1 / rate_hz), rel=1e-9)


def test_the_speed_of_a_path_without_contact_is_that_of_the_hand() -> None:
    away = {"waypoints": [[0, -0.02, 0.03], [0.5, 0.02, 0.06]]}
    found = measured("peak_speed_m_per_s", {**BASE, "operator": away}, "render")
    assert found["peak_speed_m_per_s"] == pytest.approx(np.hypot(0.04, 0.03) / 0.5, rel=1e-6)


def test_a_path_of_minimum_jerk_is_that_of_flash_and_hogan() -> None:
    way = {"waypoints": [[0, 0, 0.03], [1, 0.04, 0.03]], "interpolation": "minimum_jerk"}
    point = Point({**BASE, "operator": way, "duration_s": 1.0}, "render")
    s = np.arange(10_000) / 10_000
    expected = 0.04 * (10 * s**3 - 15 * s**4 + 6 * s**5)
    assert point.run.samples["position_m"][:, 0] == pytest.approx(expected, abs=1e-12)


def test_a_quantile_is_that_of_the_sorted_samples() -> None:
    document = {**BASE, "operator": DOWN}
    options = {"field": "force_n", "axis": "y", "q": 0.75}
    found = measured({"quantile": options}, document)
    force = np.sort(hapticd.simulate(BASE, DOWN)["force_n"][:, 1])
    place = 0.75 * (len(force) - 1)
    low = int(place)
    expected = force[low] + (place - low) * (force[low + 1] - force[low])
    assert found == {"force_n_y_q75": pytest.approx(expected, rel=1e-12)}
    assert parse_measure({"quantile": options}).columns[0].unit == "N"
    assert measured({"quantile": {**options, "name": "mine"}}, document).keys() == {"mine"}


@pytest.mark.parametrize("rate_hz", [1000.0, 10_000.0])
def test_the_stability_factor_of_a_wall_is_two_b_over_k_t(rate_hz: float) -> None:
    """b > K T/2 (Colgate and Schenkel 1997), with the default handle's 0.2 N s/m."""
    document = {**BASE, "device": EXACT, "servo": {"rate_hz": rate_hz}}
    found = measured("stability_factor", document, "none")
    assert found["stability_factor"] == pytest.approx(2 * 0.2 * rate_hz / 200, rel=1e-9)


def test_a_scene_in_which_nothing_can_be_touched_has_no_factor() -> None:
    assert measured("stability_factor", {"scene": {"objects": {}}}, "none") == {"stability_factor": None}


@pytest.mark.parametrize("material", ["wood", "steel"])
@pytest.mark.parametrize("compensation", ["off", "full"])
def test_the_displayed_error_is_that_of_the_handles_motion(material: str, compensation: Any) -> None:
    """The motion of the linear device is integrated separately from the closed form."""
    document = {"device": {"compensation": compensation}}
    found = measured({"displayed_error": {"material": material}}, document, "none")
    mode = shipped_materials()[material].tap.mode  # type: ignore[union-attr]
    moved = moved_error(mode, "default", compensation, 10_000.0, ONSET_LEAD_PERIODS)
    assert found["displayed_error"] == pytest.approx(moved, rel=0.02, abs=2e-3)


def test_behind_a_link_the_displayed_error_is_that_of_its_frames() -> None:
    """The force changes once in a frame, which begins at any time after the strike: errors of a servo of 1 kHz."""
    found = measured(
        {"displayed_error": {"material": "wood"}}, {"device": {"sim": {"link": {"rate_hz": 1000}}}}, "none"
    )
    mode = shipped_materials()["wood"].tap.mode  # type: ignore[union-attr]
    moved = [moved_error(mode, "default", "off", 1000.0, (index + 0.5) / 8) for index in range(8)]
    assert found["displayed_error"] == pytest.approx(np.sqrt(np.mean(np.square(moved))), rel=0.01)


def test_a_mode_above_the_limit_of_the_rate_has_no_displayed_error() -> None:
    tap = {"attack_slope_per_s": 64, "frequency_hz": 450, "decay_time_s": 0.01}
    document = {"servo": {"rate_hz": 1000}, "materials": {"high": {"stiffness_n_per_m": 100, "tap": tap}}}
    assert measured({"displayed_error": {"material": "high"}}, document, "none") == {"displayed_error": None}


@pytest.mark.parametrize("material", ["no_such", "membrane_without_tap"])
def test_a_material_without_a_tap_has_no_displayed_error(material: str) -> None:
    document = {"materials": {"membrane_without_tap": {"stiffness_n_per_m": 10}}}
    with pytest.raises(HapticdError, match=f"{material} is not a material with a tap"):
        measured({"displayed_error": {"material": material}}, document, "none")


@pytest.mark.parametrize(("fraction", "end"), [(0.5, "rests"), (1.05, "grows")])
def test_how_a_loop_ends(fraction: float, end: str) -> None:
    """A free handle with exact positions on one wall, below and above K = 2 b/T."""
    free = {"mass_kg": 0, "stiffness_n_per_m": 0, "damping_n_s_per_m": 0}
    push, strong = {"kind": "constant", "force_n": [0, -1]}, {"max_force_n": 100}
    document = {
        "servo": {"rate_hz": 1000},
        "device": {**strong, "max_speed_m_per_s": 1000, "sim": {**EXACT["sim"], **strong, "hand": free}},
        "materials": {"m": {"stiffness_n_per_m": fraction * 400}},
        "scene": {"objects": {"floor": FLOOR, "push": push}},
        "operator": {"waypoints": [[0, 0, 0.001], [0.01, 0, 0.001]]},
    }  # fmt: skip
    found = measured("end", document)
    assert found["rests"] is (end == "rests") and found["decays"] is (end == "rests")
    assert found["end"] == end or (end == "grows" and found["end"] == "cycles")


def test_the_measure_end_needs_the_closed_loop() -> None:
    with pytest.raises(HapticdError, match="run: simulate"):
        measured("end", {**BASE, "operator": DOWN}, "render")


def test_every_column_of_a_measure_has_a_description() -> None:
    options: dict[str, Any] = {
        "quantile": {"field": "force_n", "q": 0.5},
        "displayed_error": {"material": "wood"},
        "passive_limit": {"material": "wood"},
        "displayed_materials": {"materials": ["wood"]},
        "function": {"call": "module:name", "columns": {"x": "N"}},
    }
    for name in MEASURE_CLASSES:
        for column in parse_measure({name: options.get(name, {})}).columns:
            assert column.role == "measured" and column.description.endswith("."), name


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("peak", "unknown measure peak; known: "),
        ({"quantile": {"field": "forces", "q": 0.5}}, "quantile.field: should be 'position_m', 'velocity_m_per_s', "),
        ({"end": {"longest_s": 0}}, "end.longest_s: should be greater than or equal to 0.5, is 0"),
        ({"end": 3}, "end: must be a mapping of options"),
        ({"end": {}, "quantile": {}}, "must be a name or {name: options}, has 2 keys"),
        ({"peak_force_n": {"axis": "x"}}, "peak_force_n.axis: unknown key"),
    ],
)
def test_a_faulty_measure_is_reported(given: Any, message: str) -> None:
    with pytest.raises(InvalidError) as caught:
        parse_measure(given)
    assert message in str(caught.value)
