"""`device.rearm_m`: noise at a surface is no tap, a withdrawal of so much is one again."""

from __future__ import annotations

import numpy as np
import pytest

from hapticd.base.core import EventKind
from tests.support.rig import Rig

REARM_M = 10e-6
SHAPES: dict[str, dict[str, object]] = {
    "wall": {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"},
    "box": {"kind": "box", "center_m": [0, -0.01], "size_m": [0.04, 0.02], "angle_rad": 0, "material": "wood"},
    "disc": {"kind": "disc", "center_m": [0, -0.01], "radius_m": 0.01, "material": "wood"},
    "membrane": {"kind": "membrane", "center_m": [0, 0], "normal": [0, 1], "width_m": 0.02, "material": "wood"},
}


def rendered(shape: str, height_m: np.ndarray, rearm_m: float) -> tuple[Rig, np.ndarray]:
    rig = Rig({"o": SHAPES[shape]}, device={"rearm_m": rearm_m})
    path = np.stack([np.zeros(len(height_m)), height_m], axis=1)
    samples = rig.render(path)
    return rig, samples


def struck(rig: Rig) -> np.ndarray:
    contacts = rig.of(EventKind.CONTACT)
    return contacts[contacts["amplitude_m_per_s2"] > 0]


@pytest.mark.parametrize("shape", list(SHAPES))
def test_white_noise_at_a_surface_is_one_tap(shape: str) -> None:
    """1 um of white noise exactly at the surface, for a second: a quarter of the ticks are onsets, one is a tap. A
    withdrawal by the depth arms it again, one by less does not."""
    noise = np.random.default_rng(3).normal(0, 1e-6, 10_000)
    height = np.concatenate([np.linspace(1e-3, 1e-5, 50), noise])
    rig, _ = rendered(shape, height, 0.0)
    assert len(struck(rig)) == pytest.approx(2500, rel=0.05)
    rig, samples = rendered(shape, height, REARM_M)
    assert len(struck(rig)) == 1
    # The contact force is the same with and without it.
    np.testing.assert_array_equal(samples["contact_force_n"], rendered(shape, height, 0.0)[1]["contact_force_n"])
    less, enough = 0.9 * REARM_M, 1.1 * REARM_M
    around = [np.full(3, 1e-5 * 5), np.full(3, -2e-6)]
    rig, _ = rendered(shape, np.concatenate([*around, np.full(3, less), np.full(3, -2e-6)]), REARM_M)
    assert len(struck(rig)) == 1
    rig, _ = rendered(shape, np.concatenate([*around, np.full(1, enough), np.full(3, -2e-6)]), REARM_M)
    assert len(struck(rig)) == 2


def test_flicker_between_two_steps_of_an_encoder_never_taps_again() -> None:
    step = 20e-6
    for offset in np.linspace(0, 0.999, 7) * step:
        levels = offset - step + step * (np.random.default_rng(4).integers(0, 2, 400))
        rig, _ = rendered("wall", np.concatenate([np.full(20, 1e-3), levels]), step)
        assert len(struck(rig)) == 1


@pytest.mark.parametrize("shape", list(SHAPES))
@pytest.mark.parametrize("speed", [0.01, 0.05, 0.2, 1.0])
@pytest.mark.parametrize("away_m", [1.2 * REARM_M, 1e-4, 1e-3])
def test_every_tap_after_a_withdrawal_is_one_however_slow(shape: str, speed: float, away_m: float) -> None:
    """Away in steps far below the depth or above it, and as far as where the surface is not looked at every tick."""
    down = np.linspace(away_m, -1e-5, max(3, round(away_m / speed * 10_000)))
    first = np.linspace(1e-3, away_m, 50)
    rig, _ = rendered(shape, np.concatenate([first, down, down[::-1], down, down[::-1], down]), REARM_M)
    assert len(struck(rig)) == 3
