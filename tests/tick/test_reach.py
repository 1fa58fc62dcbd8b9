"""What is in reach: thousands of objects change nothing of what the few do that are met."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import pytest

from hapticd.base.core import EventKind
from tests.support.rig import Rig, still

Points = npt.NDArray[np.float64]

MATERIALS: dict[str, object] = {
    "m": {"stiffness_n_per_m": 300},
    "tapped": {
        "stiffness_n_per_m": 350,
        "tap": {"attack_slope_per_s": 309, "frequency_hz": 67, "decay_time_s": 0.00648},
    },
    "rough": {"stiffness_n_per_m": 250, "friction": {"coefficient": 0.3}},
    "skin": {
        "stiffness_n_per_m": 200,
        "rupture": {
            "depth_m": 0.003,
            "amplitude_m_per_s2": 38,
            "decay_rate_per_s": 330,
            "angular_frequency_rad_per_s": 1260,
            "heals": True,
        },
    },
}
NAMES = list(MATERIALS)


def random_object(rng: np.random.Generator, center: Points, size: float) -> dict[str, object]:
    """A box, a disc or a membrane that goes no farther than `size` from `center`."""
    material = NAMES[int(rng.integers(len(NAMES)))]
    kind, angle = ("box", "disc", "membrane")[int(rng.integers(3))], float(rng.uniform(0, 2 * np.pi))
    common: dict[str, object] = {"kind": kind, "center_m": center.tolist(), "material": material}
    if kind == "box":
        size_m = rng.uniform(0.1, 1.0, 2) * size * np.sqrt(2)
        return {**common, "size_m": np.maximum(size_m, 2e-4).tolist(), "angle_rad": angle}
    if kind == "disc":
        return {**common, "radius_m": max(1e-4, float(rng.uniform(0.1, 1.0)) * size)}
    width = max(1e-4, 2 * float(rng.uniform(0.1, 1.0)) * size)
    return {**common, "normal": [np.cos(angle).item(), np.sin(angle).item()], "width_m": width}


def wander(rng: np.random.Generator, count: int, around: Points, reach: float, most: float) -> Points:
    """Straight moves between random places within `reach`, with steps of up to `most`, (count, 2)."""
    legs: list[Points] = []
    here, total = around.astype(np.float64), 0
    while total < count:
        there = around + rng.uniform(-reach, reach, 2)
        steps = int(np.ceil(np.hypot(*(there - here)) / (most * rng.uniform(0.02, 1.0))))
        legs.append(here + (there - here) * np.arange(steps)[:, None] / steps)
        here, total = there, total + steps
    return np.concatenate(legs)[:count]


def happened(rig: Rig) -> list[tuple[object, ...]]:
    """The events of the last stretch, by name instead of slot, in an order that does not depend on slots."""
    found = []
    for event in rig.events:
        name = rig.compiler.name_of(int(event["slot"]), int(event["generation"])) or ""
        numbers = tuple(round(float(event[key]), 12) for key in ("before_tick_s", "speed_m_per_s", "value"))
        found.append((int(event["tick"]), int(event["kind"]), name, int(event["code"]), *numbers))
    return sorted(found)


def same(one: Rig, other: Rig, path: Points, periods: npt.ArrayLike | None = None) -> int:
    """Renders a path on both: the same forces to rounding, the same events. How many contacts there were."""
    a, b = one.render(path, periods=periods), other.render(path, periods=periods)
    for key in ("contact_force_n", "vibration_force_n", "force_n"):
        np.testing.assert_allclose(a[key], b[key], rtol=1e-13, atol=1e-15, err_msg=key)
    np.testing.assert_array_equal(a["flags"], b["flags"])
    assert happened(one) == happened(other)
    return len(one.of(EventKind.CONTACT))


@pytest.mark.long
@pytest.mark.parametrize("at", [(0.0, 0.0), pytest.param((9.7, -9.9), marks=pytest.mark.slow)])
def test_ten_thousand_objects_change_nothing_of_the_few_that_are_met(at: tuple[float, float]) -> None:
    """Twelve that overlap around the probe; 10,000 elsewhere, of all sizes, and walls in all directions."""
    rng = np.random.default_rng(round(10 + at[0]))
    center = np.array(at)
    near = {f"near{i}": random_object(rng, center + rng.uniform(-0.02, 0.02, 2), 0.008) for i in range(12)}
    near["floor"] = {"kind": "wall", "point_m": [at[0], at[1] - 0.02], "normal": [0, 1], "material": "rough"}
    many: dict[str, object] = {}
    while len(many) < 10_000:
        place = rng.uniform(-10, 10, 2)
        if len(many) % 3 == 0:  # crowded, just out of reach of the path
            angle = rng.uniform(0, 2 * np.pi)
            place = np.clip(center + rng.uniform(0.06, 0.3) * np.array([np.cos(angle), np.sin(angle)]), -10, 10)
        gap = float(np.hypot(*(place - center))) - 0.05
        if len(many) % 50 == 0:
            direction = rng.normal(size=2)
            direction /= np.hypot(*direction)
            point = center - rng.uniform(0.05, 0.3) * direction
            if np.abs(point).max() <= 10:
                many[f"w{len(many)}"] = {
                    "kind": "wall",
                    "point_m": point.tolist(),
                    "normal": direction.tolist(),
                    "material": "m",
                }
        elif gap > 2e-3:
            many[f"o{len(many)}"] = random_object(rng, place, min(gap, 10 ** rng.uniform(-3, 0.5)))
    many = dict([*many.items()][len(near) :])  # as many as a scene holds
    few = Rig(near, rate_hz=1000, materials=MATERIALS)
    all_of_them = Rig({**many, **near}, rate_hz=1000, materials=MATERIALS)
    reversed_order = Rig({**near, **many}, rate_hz=1000, materials=MATERIALS)
    path = wander(rng, 30_000, center, 0.03, 0.0049)
    path[15_000:] = center + wander(rng, 15_000, np.zeros(2), 0.03, 2e-4)
    assert same(few, all_of_them, path) > 500
    few = Rig(near, rate_hz=1000, materials=MATERIALS)
    assert same(few, reversed_order, path) > 500


def test_jumps_and_stalls_are_met_as_with_few() -> None:
    rng = np.random.default_rng(4)
    near = {f"near{i}": random_object(rng, rng.uniform(-0.03, 0.03, 2), 0.012) for i in range(20)}
    far = {f"far{i}": random_object(rng, rng.uniform(0.05, 0.2, 2), 0.002) for i in range(3000)}
    few, many = Rig(near, rate_hz=1000, materials=MATERIALS), Rig({**far, **near}, rate_hz=1000, materials=MATERIALS)
    path = wander(rng, 12_000, np.zeros(2), 0.04, 0.003)
    for at in range(0, 12_000, 100):  # jumps: into things, out of them, far away and back
        path[at : at + 50] += rng.uniform(-0.02, 0.02, 2)
    path[6000:6003] = [-3, 2]
    periods = np.ones(len(path), np.uint32)
    periods[rng.integers(1, len(path), 200)] = rng.integers(2, 60, 200)
    assert same(few, many, path, periods) > 100


def test_where_several_surfaces_are_pressed_the_proxy_meets_the_same_with_few_and_with_many() -> None:
    """The candidates of a crowd were not sorted, so contacts that begin in one tick came in another order.

    The path of the proxy depends on the order of the pressed surfaces.
    """
    for seed in range(40, 60):
        rng = np.random.default_rng((13, seed))
        near = {f"near{i}": random_object(rng, rng.uniform(-0.02, 0.02, 2), 0.008) for i in range(12)}
        around = [0.07 * (1 + i % 3) * np.array([np.cos(i), np.sin(i)]) for i in range(200)]
        far = {f"far{i}": random_object(rng, place, 0.002) for i, place in enumerate(around)}
        few = Rig(near, rate_hz=1000, materials=MATERIALS)
        many = Rig({**near, **far}, rate_hz=1000, materials=MATERIALS)
        assert same(few, many, wander(rng, 3000, np.zeros(2), 0.03, 0.0049)) > 20


def test_walls_in_all_directions_are_met_where_they_are() -> None:
    """A polygon of 90 walls, 1 m across and 9 m from the origin: the sum of K d over those that are behind."""
    center = np.array([6.0, -7.0])
    directions = 2 * np.pi * np.arange(90) / 90 + 0.01
    normals = -np.column_stack([np.cos(directions), np.sin(directions)])
    walls: dict[str, object] = {
        f"w{i}": {"kind": "wall", "point_m": (center - 0.5 * n).tolist(), "normal": n.tolist(), "material": "m"}
        for i, n in enumerate(normals)
    }
    rng = np.random.default_rng(6)
    rig = Rig(walls, rate_hz=1000, materials=MATERIALS)
    path = []
    for direction in directions[::7]:
        outward = np.array([np.cos(direction + 0.02), np.sin(direction + 0.02)])
        r = np.concatenate([np.arange(0, 0.503, 0.004), [0.503] * 3, np.arange(0.503, 0, -0.004)])
        path.append(center + r[:, None] * outward + rng.uniform(-1e-4, 1e-4, (len(r), 2)))
    positions = np.concatenate(path)
    samples = rig.render(positions)
    depth = -((positions - center) @ normals.T + 0.5)
    expected = 300 * np.maximum(depth, 0) @ normals
    np.testing.assert_allclose(samples["contact_force_n"], expected, rtol=0, atol=1e-11)
    assert (depth > 0).sum() > 100


@pytest.mark.slow
def test_objects_that_come_move_and_go_every_tick() -> None:
    """An update before each tick, far away and near, on both scenes; those of one live among 800 others."""
    rng = np.random.default_rng(7)
    near: dict[str, object] = {f"near{i}": random_object(rng, rng.uniform(-0.02, 0.02, 2), 0.006) for i in range(8)}
    far: dict[str, object] = {f"far{i}": random_object(rng, rng.uniform(0.2, 3, 2), 0.05) for i in range(800)}
    few, many = Rig(near, rate_hz=1000, materials=MATERIALS), Rig({**far, **near}, rate_hz=1000, materials=MATERIALS)
    path = wander(rng, 600, np.zeros(2), 0.025, 0.002)
    contacts = 0
    for n in range(60):
        changes: dict[str, object] = {}
        if n % 2:
            changes[f"near{rng.integers(8)}"] = random_object(rng, rng.uniform(-0.02, 0.02, 2), 0.006)
        if n % 5 == 0:
            changes["visitor"] = random_object(rng, path[10 * n], 0.004)
        elif n % 5 == 3 and "visitor" in few.source["scene"]["objects"]:
            changes["visitor"] = None
        few.update(changes)
        elsewhere: Mapping[str, object] = {
            f"far{rng.integers(800)}": random_object(rng, rng.uniform(0.2, 3, 2), 0.05),
            f"new{n}": random_object(rng, rng.uniform(0.2, 3, 2), 0.01),
            **({f"new{n - 2}": None} if n > 2 else {}),
        }
        many.update({**changes, **elsewhere})
        contacts += same(few, many, path[10 * n : 10 * n + 10])
    assert contacts > 15


def test_one_update_a_tick() -> None:
    rng = np.random.default_rng(8)
    rig = Rig({"floor": {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "m"}}, materials=MATERIALS)
    path = np.column_stack([np.linspace(-0.01, 0.01, 300), np.full(300, -0.001)])
    rig.render(np.column_stack([np.full(100, -0.01), np.linspace(0.001, -0.001, 100)]))
    for n, position in enumerate(path):
        place = rng.uniform(-5, 5, 2)
        rig.update({f"o{n % 7}": random_object(rng, place + np.sign(place) * 0.2, 0.1)})
        sample = rig.render([position])
        np.testing.assert_allclose(sample["contact_force_n"][0], [0, 0.3], rtol=0, atol=1e-14)
        assert rig.kinds() == []


@pytest.mark.parametrize("kind", ["wall", "box", "disc"])
def test_an_object_from_far_away_onto_the_probe_comes_in_over_the_ramp(kind: str) -> None:
    """It was never in reach: it appears, and is felt where the probe is, whether it moves or is at rest."""
    for speed in (0.0, 1e-6):
        things = {
            "wall": ({"kind": "wall", "normal": [0, 1], "material": "m"}, "point_m", [0, -5], [0, 0]),
            "box": ({"kind": "box", "size_m": [0.1, 0.02], "material": "m"}, "center_m", [8, -5], [0, -0.01]),
            "disc": ({"kind": "disc", "radius_m": 0.01, "material": "m"}, "center_m", [8, -5], [0, -0.01]),
        }
        common, key, away, here = things[kind]
        others = {f"o{i}": random_object(np.random.default_rng(i), np.array([3.0, 3.0]), 1.0) for i in range(50)}
        rig = Rig({**others, "it": {**common, key: away}}, materials=MATERIALS)
        path = still(0, -0.001, 900) + np.column_stack([np.arange(900) * speed, np.zeros(900)])
        assert not rig.render(path[:400])["contact_force_n"].any()
        rig.update({"it": {**common, key: here}})
        samples = rig.render(path[400:])
        force = samples["contact_force_n"]
        (contact,) = rig.events
        assert contact["kind"] == EventKind.CONTACT
        assert contact["code"] == 1
        assert np.hypot(*np.diff(force, axis=0, prepend=[[0, 0]]).T).max() <= 0.3 / 200 * 1.01
        expected = np.array([0, 0.3])
        if kind == "disc":
            offset = path[-1] - [0, -0.01]
            expected = 300 * (0.01 / np.hypot(*offset) - 1) * offset
        np.testing.assert_allclose(force[-1], expected, rtol=0, atol=1e-12)
        assert not samples["vibration_force_n"].any()


@pytest.mark.parametrize("upright", [False, True])
def test_what_comes_into_reach_is_met_in_the_tick_of_the_crossing(upright: bool) -> None:
    """Straight on for 19 m at 4.9 m/s, grazing discs or just not: contact times are those of the circles."""
    rng = np.random.default_rng(12)
    x = np.cumsum(rng.uniform(0.02, 0.03, 760)) - 9.5
    x = x[x < 9.5]
    radius, step, rate = 1e-3, 0.0049, 1000.0
    heights = rng.uniform(0.8, 1.2, len(x)) * radius * rng.choice([-1, 1], len(x))
    centers = np.column_stack([heights, x] if upright else [x, heights])
    rig = Rig(
        {
            f"d{i}": {"kind": "disc", "center_m": center.tolist(), "radius_m": radius, "material": "m"}
            for i, center in enumerate(centers)
        },
        rate_hz=rate,
        materials=MATERIALS,
    )
    along = -9.6 + step * np.arange(round(19.2 / step))
    rig.render(np.column_stack([0 * along, along] if upright else [along, 0 * along]))
    contacts = rig.of(EventKind.CONTACT)
    times = np.sort(contacts["tick"] / rate - contacts["before_tick_s"])
    hit = np.abs(heights) < radius
    wanted = np.sort(x[hit] - np.sqrt(radius**2 - heights[hit] ** 2) + 9.6) / (step * rate)
    assert len(wanted) > 300
    np.testing.assert_allclose(times, wanted, rtol=0, atol=1e-9)
