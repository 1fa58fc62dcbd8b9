"""The three forces of a sample, as the pages describe them: a scene for each part of a force."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from hapticd.base.core import Flag, lib
from tests.support.rig import FLOOR, SKIN, Rig, line, still

RATE = 10_000
COUNT = 400
MODE = {"frequency_hz": 200, "decay_time_s": 0.003}
GROOVES = {"kind": "grooves", "spacing_m": 0.002, "width_m": 0.0005}
HARD = {"stiffness_n_per_m": 800}
MATERIALS = {
    "plain": HARD,
    "damped": {**HARD, "damping_n_s_per_m": 5},
    "rough": {**HARD, "friction": {"coefficient": 0.3, "stiffness_n_per_m": 500}},
    "paper": {
        **HARD,
        "texture": {
            "kind": "stochastic",
            "peak_hz": 250,
            "mean_hz": 310,
            "velocity_gain_per_s": 40,
            "force_gain_m_per_s2_per_n": 5,
        },
    },
    "learned": {
        **HARD,
        "texture": {
            "kind": "autoregressive",
            "rate_hz": 1000,
            "models": [{"speed_m_per_s": 0.1, "force_n": 1, "coefficients": [0.5], "rms_m_per_s2": 4}],
        },
    },
    "lowered": {**HARD, "texture": {**GROOVES, "display": "geometry", "depth_m": 0.0002}},
    "dragging": {**HARD, "texture": {**GROOVES, "display": "damping", "damping_n_s_per_m": 20}},
    "struck": {**HARD, "texture": {**GROOVES, "display": "vibration", "velocity_gain_per_s": 1200, **MODE}},
}
Samples = npt.NDArray[np.void]


def stroke(count: int = COUNT) -> npt.NDArray[np.float64]:
    """0.1 m/s along a floor, 1 mm below its surface."""
    return np.column_stack([0.1 * np.arange(count) / RATE, np.full(count, -0.001)])


def stroked(material: str, **scene: Any) -> Samples:
    return Rig({"floor": {**FLOOR, "material": material}}, materials=MATERIALS, **scene).render(stroke())[COUNT // 2 :]


def rings(samples: Samples) -> bool:
    return bool(np.any(samples["flags"] & Flag.RINGING))


@pytest.mark.parametrize("material", ["paper", "learned"])
def test_noise_is_vibration_though_no_mode_rings(material: str) -> None:
    samples = stroked(material)
    assert not rings(samples)
    assert np.abs(samples["vibration_force_n"]).max() > 0.01
    assert np.array_equal(samples["contact_force_n"], stroked("plain")["contact_force_n"])
    silent = stroked(material, display={"vibration": False})
    assert not silent["vibration_force_n"].any()
    assert np.array_equal(silent["contact_force_n"], samples["contact_force_n"])


@pytest.mark.parametrize("material", ["rough", "lowered", "dragging"])
def test_friction_and_grooves_that_are_not_struck_are_contact_force(material: str) -> None:
    samples = stroked(material)
    assert not samples["vibration_force_n"].any()
    assert np.abs(samples["contact_force_n"] - stroked("plain")["contact_force_n"]).max() > 0.01


def test_damping_is_contact_force() -> None:
    plain, damped = (
        Rig({"floor": {**FLOOR, "material": material}}, materials=MATERIALS).render(line(0.001, 0.1, COUNT))
        for material in ("plain", "damped")
    )
    assert not damped["vibration_force_n"].any()
    assert damped["contact_force_n"][-1, 1] == pytest.approx(plain["contact_force_n"][-1, 1] + 0.5)


def test_grooves_taps_ruptures_and_play_are_vibration() -> None:
    struck = stroked("struck")
    assert rings(struck) and np.abs(struck["vibration_force_n"]).max() > 0.01
    assert np.array_equal(struck["contact_force_n"], stroked("plain")["contact_force_n"])
    tapped = Rig({"floor": FLOOR}).render(line(0.001, 0.1, COUNT))
    torn = Rig({"skin": SKIN}).render(line(0.001, 0.2, COUNT))
    for samples in (tapped, torn):
        assert rings(samples) and np.abs(samples["vibration_force_n"]).max() > 0.01
    # A ruptured membrane exerts no contact force; only its vibration remains.
    assert not torn["contact_force_n"][-1].any() and torn["vibration_force_n"][-1].any()


def test_fields_and_what_is_left_of_objects_are_contact_force() -> None:
    rig = Rig({"floor": {**FLOOR, "material": "plain"}}, materials=MATERIALS)
    (pressed,) = rig.render(still(0, -0.001, 300))[-1:]
    rig.update({"floor": None, "pull": {"kind": "constant", "force_n": [0.25, 0]}})
    samples = rig.render(still(0, -0.001, 300))
    left = samples["contact_force_n"][:, 1]
    assert left[0] == pytest.approx(pressed["contact_force_n"][1])
    assert 0 < left[100] < left[0]
    assert samples["contact_force_n"][-1] == pytest.approx([0.25, 0])
    assert not samples["vibration_force_n"].any()


def test_the_contact_force_is_what_the_passivity_controller_left() -> None:
    """A handle without known damping: the wall yields while the hand withdraws."""
    path = np.zeros((200, 2))
    path[:, 1] = 1e-5 * (np.abs(np.arange(200) - 100) - 95)
    device = {"sim": {"handle_damping_n_s_per_m": 0, "coulomb_friction_n": 0}}
    floor = {"floor": {**FLOOR, "material": "plain"}}
    off, on = (
        Rig(floor, materials=MATERIALS, device=device, passivity=mode).render(path) for mode in ("off", "control")
    )
    changed = np.any(on["contact_force_n"] != off["contact_force_n"], axis=1)
    assert changed.any()
    assert np.array_equal(changed, (on["flags"] & Flag.RESTRAINED) != 0)
    assert np.array_equal(on["force_n"], on["contact_force_n"])


def test_contact_is_as_it_was_before_the_limit_and_noise_as_the_limit_left_it() -> None:
    """The hand presses with 2.4 N against sandpaper; the limit is 1 N."""
    rig = Rig({"floor": {**FLOOR, "material": "paper"}}, materials=MATERIALS, device={"max_force_n": 1})
    path = stroke()
    path[:, 1] = -0.003
    samples = rig.render(path)[COUNT // 2 :]
    assert samples["contact_force_n"][:, 1] == pytest.approx(2.4)
    assert not samples["vibration_force_n"].any()
    assert np.linalg.norm(samples["force_n"], axis=1) == pytest.approx(1)
    assert np.all(samples["flags"] & Flag.SATURATED)


def test_both_are_as_they_were_before_the_fade_of_set_forces() -> None:
    rig = Rig({"floor": {**FLOOR, "material": "paper"}}, materials=MATERIALS)
    lib.hd_state_enable(rig.state, 0)
    samples = rig.render(stroke(600))[-100:]
    assert samples["contact_force_n"][:, 1] == pytest.approx(0.8)
    assert not samples["force_n"].any()
    assert not np.any(samples["flags"] & Flag.FORCES_ON)
    # No mode is struck while forces are off, but the noise is reported.
    assert np.abs(samples["vibration_force_n"]).max() > 0.01
