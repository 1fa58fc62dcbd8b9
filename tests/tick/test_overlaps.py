"""Solids that overlap: whichever surface the probe comes in by, each pushes at once, and no way out gives more.

The reference is the sum of K d over the solids that hold the probe, d the way out by the face or the bearing that it
came in by.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from bench.loops import draw, settle
from hapticd.base.core import EventKind
from tests.support.rig import Rig

Points = npt.NDArray[np.float64]

FLOOR_K, SOLID_K, PRESSED = 1500.0, 6000.0, 0.0003
TAP = {"attack_slope_per_s": 60, "frequency_hz": 100, "decay_time_s": 0.01}
MATERIALS: dict[str, object] = {
    "soft": {"stiffness_n_per_m": FLOOR_K},
    "stiff": {"stiffness_n_per_m": SOLID_K, "tap": TAP},
}
FLOOR: dict[str, object] = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "soft"}

# Both lean over the floor: on it they lie farther out than below it, so that the proxy is in them first.
CENTER, RADIUS = np.array([-0.0034, 0.0015]), 0.0066
ANGLE = 0.4
SIDE = np.array([np.cos(ANGLE), -np.sin(ANGLE)])
DISC: dict[str, object] = {"kind": "disc", "center_m": CENTER.tolist(), "radius_m": RADIUS, "material": "stiff"}
BOX: dict[str, object] = {
    "kind": "box",
    "center_m": [0, 0],
    "size_m": [0.006, 0.02],
    "angle_rad": -ANGLE,
    "material": "stiff",
}


def disc_force(points: Points) -> Points:
    offset = points - CENTER
    distance = np.hypot(*offset.T)[:, None]
    return SOLID_K * np.maximum(RADIUS - distance, 0.0) * offset / distance


def box_force(points: Points) -> Points:
    return SOLID_K * np.maximum(0.003 - points @ SIDE, 0.0)[:, None] * SIDE


def into_it_and_out(deep: float) -> Points:
    """Along the floor, pressed into it, as far as x = 1 mm; down to `deep`, and back there."""
    y = np.linspace(0.001, -PRESSED, 40)
    x = np.linspace(0.006, 0.001, 200)
    down = np.linspace(-PRESSED, -deep, 50)
    parts = [
        np.column_stack([np.full(40, 0.006), y]),
        np.column_stack([x, np.full(200, -PRESSED)]),
        np.column_stack([np.full(50, 0.001), down]),
        np.column_stack([x[::-1], np.full(200, -deep)]),
    ]
    return np.concatenate(parts)


@pytest.mark.parametrize("deep", [PRESSED, 0.0006])
@pytest.mark.parametrize(("solid", "force"), [(DISC, disc_force), (BOX, box_force)], ids=["disc", "box"])
def test_a_solid_that_leans_over_the_floor_pushes_at_once(solid: dict[str, object], force: object, deep: float) -> None:
    """The proxy on the floor is in it before the probe is: then it was met too late, its force came over the
    ramp, and left whole."""
    assert callable(force)
    rig = Rig({"floor": FLOOR, "solid": solid}, materials=MATERIALS)
    path = into_it_and_out(deep)
    found = rig.render(path)["contact_force_n"]
    expected = force(path) + FLOOR_K * np.maximum(-path[:, 1:], 0.0) * [0, 1]
    assert np.abs(force(path)).max() > 3.0
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
    assert all(int(event["code"]) == 0 for event in rig.of(EventKind.CONTACT))  # none silent
    given = float(np.einsum("ij,ij->", found[:-1], np.diff(path, axis=0)))
    assert given <= 0.5 * (FLOOR_K + SOLID_K) * float((np.diff(path, axis=0) ** 2).sum())  # what steps make of it


@pytest.mark.slow
@pytest.mark.parametrize("seed", [4766, 7132, 8119, 8630])
def test_overlapping_solids_that_are_called_safe_come_to_rest(seed: int) -> None:
    """Four of 10,000 random loops that once went on for ever, and what they gave to the hand."""
    case = draw(seed)
    assert case is not None
    found = settle(case, "observe", 20.0)
    assert found.rests
    assert found.part < 1.0
