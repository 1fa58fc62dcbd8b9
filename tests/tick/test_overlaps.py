"""Solids that overlap: whichever surface the probe comes in by, each pushes at once, and no way out gives more.

The reference is the sum of K d over the solids that hold the probe, d the way out by the face or the bearing that it
came in by.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from bench.loops import Drawer, Kind, draw, settle
from bench.stability import evaluated
from hapticd.base.core import EventKind
from hapticd.rendering.offline import CompiledScene, Simulation
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


OVERLAPS = (341, 2196, 5898, 6495, 6532, 7466, 8239)
"""Seeds of loops of overlapping solids that cycled with up to 1.7 m/s."""


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
    assert found.fraction < 1.0


# ---- Contacts that begin below their surface ---------------------------------------------------------------------


def box(left: float, right: float, height: float = 0.01) -> dict[str, object]:
    """A box whose upper face lies at y = 0."""
    return {
        "kind": "box",
        "center_m": [0.5 * (left + right), -0.5 * height],
        "size_m": [right - left, height],
        "material": "soft",
    }


def along_the_floor(start: float, end: float, deep: float) -> Points:
    """Straight down to a depth, then along x."""
    down = np.column_stack([np.full(200, start), np.linspace(0.0005, -deep, 200)])
    x = np.linspace(start, end, 8001)
    return np.concatenate([down, np.column_stack([x, np.full(8001, -deep)])])


@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize("way", [1, -1])
def test_the_surface_of_two_boxes_that_overlap_flush_pushes_as_one(order: int, way: int) -> None:
    """The second box takes over the force when the probe leaves the first; both together never push."""
    boxes = {"a": box(-0.02, 0.001), "b": box(-0.001, 0.02)}
    rig = Rig(dict(list(boxes.items())[::order]), materials=MATERIALS)
    path = along_the_floor(-0.004 * way, 0.004 * way, 0.001)
    expected = np.column_stack([np.zeros(len(path)), FLOOR_K * np.maximum(-path[:, 1], 0.0)])
    np.testing.assert_allclose(rig.render(path)["contact_force_n"], expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("degrees", [10, 30, 60])
def test_a_slope_that_is_met_at_its_foot_pushes_from_zero(degrees: float) -> None:
    """The box stands with an edge on the floor. When the proxy comes to the edge, the probe is below the slope already.

    The force of the slope rises with the depth that the probe gains from there; on the way back it never acts deeper.
    """
    deep, angle = 0.001, math.radians(degrees)
    normal, tangent = np.array([-math.sin(angle), math.cos(angle)]), np.array([math.cos(angle), math.sin(angle)])
    slope = {
        "kind": "box",
        "center_m": (0.01 * tangent - 0.005 * normal).tolist(),
        "size_m": [0.02, 0.01],
        "angle_rad": angle,
        "material": "soft",
    }
    rig = Rig({"floor": FLOOR, "slope": slope}, materials=MATERIALS)
    into = along_the_floor(-0.003, 0.003, deep)
    path = np.concatenate([into, into[::-1]])
    found = rig.render(path)["contact_force_n"]
    depth = -path @ normal
    at_foot = deep * math.cos(angle)
    floor = FLOOR_K * np.maximum(-path[:, 1:], 0.0) * [0, 1]
    expected = floor + FLOOR_K * np.maximum(depth - at_foot, 0.0)[:, None] * np.where(path[:, :1] > 0.0, 1, 0) * normal
    step = float(np.hypot(*np.diff(path, axis=0).T).max())
    np.testing.assert_allclose(found, expected, rtol=0, atol=FLOOR_K * step)
    assert np.hypot(*(found - floor).T).max() > FLOOR_K * 0.003 * math.sin(angle) * 0.99
    assert np.hypot(*np.diff(found, axis=0).T).max() <= 2 * FLOOR_K * step


def closed_way(random: np.random.Generator, objects: dict[str, Any]) -> Points:
    """A random way through the objects that begins and ends outside of all of them."""
    outside = np.zeros(2)
    facing = [(np.array(item["point_m"]), np.array(item["normal"])) for item in objects.values() if "point_m" in item]
    for _ in range(50):
        angle = random.uniform(0, 2 * np.pi)
        outside = 0.05 * np.array([math.cos(angle), math.sin(angle)])
        if all((outside - point) @ normal > 0.0 for point, normal in facing):
            break
    inner = random.uniform(-0.012, 0.012, (int(random.integers(3, 9)), 2))
    corners = np.concatenate([outside[None], inner, outside[None]])
    parts = [corners[:1]]
    for a, b in pairwise(corners):
        count = math.ceil(float(np.hypot(*(b - a))) / 1e-5)
        parts.append(a + (b - a) * (np.arange(1, count + 1) / count)[:, None])
    return np.concatenate(parts)


def given_fraction(seed: int, friction: bool) -> float:
    """Work of the surfaces on a closed way, over the most that the steps of the way alone can make of springs."""
    random = np.random.default_rng(seed)
    objects = Drawer(random).overlapping()
    materials: dict[str, Any] = {name: {"stiffness_n_per_m": float(random.uniform(200, 2000))} for name in "abc"}
    total = sum(materials[item["material"]]["stiffness_n_per_m"] for item in objects.values())
    if friction:
        for material in materials.values():
            stiffness = float(random.uniform(200, 2000))
            material["friction"] = {"coefficient": float(random.uniform(0.05, 1)), "stiffness_n_per_m": stiffness}
        total += sum(materials[item["material"]]["friction"]["stiffness_n_per_m"] for item in objects.values())
    path = closed_way(random, objects)
    rig = Rig(objects, rate_hz=1000, materials=materials, device={"max_force_n": 100.0})
    forces = rig.render(path)["contact_force_n"]
    steps = np.diff(path, axis=0)
    work = float(np.einsum("ij,ij->", forces[:-1], steps))
    return work / (0.5 * total * float((steps**2).sum()))


@pytest.mark.parametrize("friction", [False, True])
def test_no_closed_way_through_overlapping_solids_gives_energy(friction: bool) -> None:
    """A held force of stiffness K gives at most K/2 of the square of a step more than it took."""
    fractions = [given_fraction(seed, friction) for seed in range(100)]
    assert max(fractions) <= 1.0


# ---- Margins -----------------------------------------------------------------------------------------------------


def sets_outside_of_the_margins(seed: int) -> set[frozenset[int]]:
    """Objects that a loop touches at once, although no contact set contains them all."""
    case = draw(seed, ("overlap",))
    assert case is not None
    config = case.config("off")
    sets = evaluated(config)
    members = [frozenset(sets.members(number)) for number in range(len(sets))]
    events = Simulation(CompiledScene(config), case.waypoints).run(case.waypoints[-1][0] + 0.5)[2]
    touched: set[int] = set()
    found: set[frozenset[int]] = set()
    for tick in np.unique(events["tick"]):
        for event in events[events["tick"] == tick]:
            if event["kind"] == EventKind.CONTACT:
                touched.add(int(event["slot"]))
            elif event["kind"] == EventKind.RELEASE:
                touched.discard(int(event["slot"]))
        if not any(touched <= each for each in members):
            found.add(frozenset(touched))
    return found


def test_what_is_pressed_at_once_lies_within_a_contact_set() -> None:
    """Also behind boxes that the hand was pressed through."""
    assert not [seed for seed in range(60) if sets_outside_of_the_margins(seed)]


# ---- Closed loops ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "seed"),
    [(None, 5809), ("mixed", 20441), *(("overlap", seed) for seed in OVERLAPS)],
)
def test_loops_that_once_cycled_come_to_rest(kind: Kind | None, seed: int) -> None:
    """Hands that press up to 9 N into overlapping solids within the margins: each cycled for ever before."""
    case = draw(seed) if kind is None else draw(seed, (kind,))
    assert case is not None
    found = settle(case, "observe", 20.0)
    assert found.rests
