"""Seams: from one surface to the adjacent one the force goes on, and changes to another material over the ramp.

The reference of friction is the stop operator (Prandtl) over the whole way, which knows nothing of seams.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt
import pytest

from hapticd.base.core import EventKind
from hapticd.config.scene import TOUCHING_DISTANCE_M
from tests.support.rig import Rig, still

Points = npt.NDArray[np.float64]
Make = Callable[[float, float, str], dict[str, object]]

K, MU, SPRING, RAMP_S = 800.0, 0.35, 600.0, 0.02
MATERIALS: dict[str, object] = {
    "rough": {"stiffness_n_per_m": K, "friction": {"coefficient": MU, "stiffness_n_per_m": SPRING}},
    "stiff": {"stiffness_n_per_m": K, "friction": {"coefficient": 0.8, "stiffness_n_per_m": 1500}},
    "plain": {"stiffness_n_per_m": K},
    "soft": {"stiffness_n_per_m": 300, "damping_n_s_per_m": 1.5},
    "hard": {"stiffness_n_per_m": 1200},
    "ridged": {
        "stiffness_n_per_m": K,
        "texture": {"kind": "grooves", "display": "geometry", "spacing_m": 0.005, "width_m": 0.002, "depth_m": 0.0004},
    },
}
FLUSH_M = TOUCHING_DISTANCE_M
"""Faces of solids that differ by less are one surface, as patches of a wall are."""


def turned(points: npt.ArrayLike, angle: float) -> Points:
    """Points turned counterclockwise about the origin."""
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(points, dtype=np.float64) @ np.array([[c, s], [-s, c]])


def box(x: float, angle: float, material: str, y: float = 0.0) -> dict[str, object]:
    """2 cm wide, its surface the line y, before all is turned."""
    center = turned([x, y - 0.005], angle).tolist()
    return {"kind": "box", "center_m": center, "size_m": [0.02, 0.01], "angle_rad": angle, "material": material}


def upside_down(x: float, angle: float, material: str) -> dict[str, object]:
    return {**box(x, angle, material), "angle_rad": angle + np.pi}


def skin(x: float, angle: float, material: str) -> dict[str, object]:
    center, normal = turned([x, 0], angle).tolist(), turned([0, 1], angle).tolist()
    return {"kind": "membrane", "center_m": center, "normal": normal, "width_m": 0.02, "material": material}


def from_below(x: float, angle: float, material: str) -> dict[str, object]:
    return {**skin(x, angle, material), "normal": turned([0, -1], angle).tolist()}


def stop(s: Points, longest: Points) -> Points:
    """Stretch of the spring at each place along a path, from none."""
    found = np.zeros_like(s)
    for i in range(1, len(s)):
        found[i] = np.clip(found[i - 1] + s[i] - s[i - 1], -longest[i], longest[i])
    return found


def press(rig: Rig, x: float, angle: float, depth: float = 0.001) -> None:
    rig.render(turned(np.column_stack([np.full(30, x), np.linspace(0.0005, -depth, 30)]), angle))


def pushes(rig: Rig, x: Points, depth: npt.ArrayLike, angle: float) -> Points:
    path = np.column_stack(np.broadcast_arrays(x, -np.asarray(depth)))
    return turned(rig.render(turned(path, angle))["contact_force_n"], -angle)


@pytest.mark.parametrize("makes", [(box, box), (skin, skin), (box, upside_down), (from_below, skin), (skin, box)])
@pytest.mark.parametrize("degrees", [0.0, 90.0, 213.0])
def test_a_seam_of_one_material_is_not_there(makes: Sequence[Make], degrees: float) -> None:
    """To and fro over it, under a changing load: as on one surface."""
    angle = np.radians(degrees)
    rig = Rig({"a": makes[0](-0.01, angle, "rough"), "b": makes[1](0.01, angle, "rough")}, materials=MATERIALS)
    t = np.arange(12_000) / 10_000
    x = -0.0011 + 0.003 * np.sin(2 * np.pi * 4 * t) + 0.0007 * np.sin(60 * t)
    depth = 0.001 + 0.0004 * np.sin(2 * np.pi * 1.3 * t)
    press(rig, x[0], angle)
    found = pushes(rig, x, depth, angle)
    assert rig.kinds().count(EventKind.CONTACT) >= 6
    np.testing.assert_allclose(found[:, 1], K * depth, rtol=0, atol=1e-11)
    np.testing.assert_allclose(found[:, 0], -SPRING * stop(x, MU * K * depth / SPRING), rtol=0, atol=1e-11)


NEAR = [(lip, gap) for lip in (-0.999, -0.01, 0.0, 0.5, 0.999) for gap in (-0.999, -0.01, 0.0, 0.5, 0.999)]
"""Height of the second face over the first, and gap between their ends, over FLUSH_M."""


def moved(item: dict[str, object], by: Points) -> dict[str, object]:
    center = np.asarray(item["center_m"], dtype=np.float64) + by
    return {**item, "center_m": center.tolist()}


def crossings(rate_hz: float) -> Points:
    """s over the seam at 0: to and fro, in steps of a tenth of a nanometre and back, at rest on it, and fast."""
    t = np.arange(int(0.5 * rate_hz)) / rate_hz
    swing = -0.0011 + 0.003 * np.sin(2 * np.pi * 4 * t) + 0.0007 * np.sin(60 * t)
    creep = 1e-10 * np.concatenate([np.arange(-40, 41), np.arange(40, -41, -1)])
    rests = np.repeat([0.0, 3e-10, -9e-10, 2e-9, -2e-9, 0.0], 20)
    fast = np.tile([0.004, -0.004, 1e-9, -0.003, 0.0005], 10) if rate_hz <= 1000 else 3e-4 * (-1.0) ** np.arange(50)
    return np.concatenate([swing, creep, rests, fast, rests])


@pytest.mark.parametrize("makes", [(box, box), (skin, skin), (box, upside_down), (from_below, skin), (skin, box)])
@pytest.mark.parametrize("rate_hz", [1000, 10_000])
@pytest.mark.parametrize(("degrees", "away_m"), [(0.0, 0.0), (90.0, 0.05), (213.0, 9.9)])
def test_faces_that_differ_by_less_than_a_nanometre_are_one_surface(
    makes: Sequence[Make], rate_hz: float, degrees: float, away_m: float
) -> None:
    """In height, in the gap or the overlap of their ends: the force is that of one surface, at every depth."""
    angle = np.radians(degrees)
    origin = away_m * np.array([0.8, -0.6])
    x = crossings(rate_hz)
    depth = 10 ** np.interp(
        np.arange(len(x)), np.linspace(0, len(x), 6), [-3, -2.7, -6, -8.9, -3, -2.7]
    )  # 1.3 nm and more
    friction = -SPRING * stop(x, MU * K * depth / SPRING)
    path = turned(np.column_stack([x, -depth]), angle) + origin
    velocity = np.zeros_like(path)  # so that no damping acts and no tap is struck
    for lip, gap in (FLUSH_M * np.array(NEAR)).tolist():
        beyond = moved(makes[1](0.01, angle, "rough"), turned([gap, lip], angle))
        objects = {"a": moved(makes[0](-0.01, angle, "rough"), origin), "b": moved(beyond, origin)}
        rig = Rig(objects, rate_hz=rate_hz, materials=MATERIALS, device={"max_speed_m_per_s": 1000})
        down = np.column_stack([np.full(30, x[0]), np.linspace(0.0005, -depth[0], 30)])
        rig.render(turned(down, angle) + origin)
        found = turned(rig.render(path, velocity)["contact_force_n"], -angle)
        about = f"lip {lip:g} m, gap {gap:g} m"
        np.testing.assert_allclose(found[:, 1], K * depth, rtol=0, atol=1.1 * K * FLUSH_M, err_msg=about)
        np.testing.assert_allclose(found[:, 0], friction, rtol=0, atol=3 * SPRING * FLUSH_M, err_msg=about)


@pytest.mark.parametrize("makes", [(box, box), (skin, skin), (skin, box)])
@pytest.mark.parametrize("turn_rad", [4.9e-8, -4.9e-8])
def test_faces_turned_by_less_than_a_nanometre_over_their_length_are_one_surface(
    makes: Sequence[Make], turn_rad: float
) -> None:
    turning = moved(makes[1](0.0, turn_rad, "rough"), turned([0.01, 0.0], turn_rad))
    objects = {"a": makes[0](-0.01, 0, "rough"), "b": turning}
    rig = Rig(objects, materials=MATERIALS, device={"max_speed_m_per_s": 1000})
    x = crossings(10_000)
    press(rig, x[0], 0)
    found = pushes(rig, x, 0.001, 0)
    np.testing.assert_allclose(found[:, 1], K * 0.001, rtol=0, atol=1.1 * K * FLUSH_M)
    np.testing.assert_allclose(
        found[:, 0], -SPRING * stop(x, np.full(len(x), MU * K * 0.001 / SPRING)), rtol=0, atol=3 * SPRING * FLUSH_M
    )


@pytest.mark.parametrize("names", ["ab", "ba"])
@pytest.mark.parametrize("degrees", [0.0, 213.0])
@pytest.mark.parametrize("lip", [-0.9, 0.0, 0.9])
def test_a_probe_that_presses_nothing_lands_on_the_floor_at_a_seam(names: str, degrees: float, lip: float) -> None:
    """Straight through the seam, steep and flat, or within the nanometre above it: never into the side of a box."""
    angle = np.radians(degrees)
    for way in ([1e-4, -1e-4], [4e-4, -2e-5], [2e-5, -4e-4], [-1e-4, -1e-4], [4e-4, 0.0], [-4e-4, 0.0]):
        for above in (0.0, 3e-10, 8e-10):
            first = box(-0.01, angle, "plain")
            second = moved(box(0.01, angle, "plain"), turned([0.0, 1e-9 * lip], angle))
            rig = Rig(dict(zip(names, (first, second), strict=True)), materials=MATERIALS)
            step = np.array(way)
            path = np.array([0.0, above]) + step * np.arange(-5.5, 6)[:, None]
            height = np.linspace(path[-1, 1], -0.002, 60)  # and then deeper, on the other side
            path = np.vstack([path, np.column_stack([np.full(60, path[-1, 0] + step[0]), height])])
            found = turned(rig.render(turned(path, angle))["contact_force_n"], -angle)
            expected = K * np.maximum(0.0, -path[:, 1])
            about = f"way {way}, {above} m above"
            np.testing.assert_allclose(found[:, 0], 0.0, rtol=0, atol=1e-9, err_msg=about)
            np.testing.assert_allclose(found[:, 1], expected, rtol=0, atol=5 * K * FLUSH_M, err_msg=about)


@pytest.mark.parametrize("degrees", [0.0, 90.0, 213.0])
def test_a_probe_that_lifts_off_over_a_seam_is_not_held_by_a_side(degrees: float) -> None:
    """From 10 um deep to exactly the height of the floor, or a part of a nanometre above it, on the other box."""
    angle = np.radians(degrees)
    for height in (0.0, 2e-10, 9e-10):
        rig = Rig({"a": box(-0.01, angle, "plain"), "b": box(0.01, angle, "plain")}, materials=MATERIALS)
        x = np.array([-3e-5, -2e-5, 1e-5, 4e-5, 7e-5])
        y = np.array([-1e-5, -1e-5, height, height, -1e-5])
        press(rig, x[0], angle, 1e-5)
        path = np.vstack([np.column_stack([x, y]), np.column_stack([-x, y])])
        found = turned(rig.render(turned(path, angle))["contact_force_n"], -angle)
        np.testing.assert_allclose(found[:, 0], 0.0, rtol=0, atol=1e-9)
        np.testing.assert_allclose(found[:, 1], K * np.maximum(0.0, -path[:, 1]), rtol=0, atol=1e-9)


@pytest.mark.parametrize("end_m", [-FLUSH_M, 0.0, 0.99 * FLUSH_M])
def test_a_membrane_that_ends_flush_with_a_floor_is_not_met(end_m: float) -> None:
    """It stands in the floor. At a sample on it and beyond, only the floor pushes, and nothing is struck."""
    floor = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "plain"}
    tapping = {"stiffness_n_per_m": K, "tap": {"attack_slope_per_s": 60, "frequency_hz": 100, "decay_time_s": 0.01}}
    upright = {
        "kind": "membrane",
        "center_m": [0, end_m - 0.01],
        "normal": [1, 0],
        "width_m": 0.02,
        "material": "tapping",
    }
    rig = Rig({"w": floor, "m": upright}, materials={**MATERIALS, "tapping": tapping})
    press(rig, -0.0003, 0)
    x = -0.0003 + 2e-5 * np.arange(40)
    samples = rig.render(np.column_stack([x, np.full(40, -0.001)]))
    np.testing.assert_allclose(samples["contact_force_n"], np.tile([0, K * 0.001], (40, 1)), rtol=0, atol=1e-12)
    assert not np.any(samples["vibration_force_n"])


def test_faces_that_differ_by_more_than_a_nanometre_are_a_step_or_a_gap() -> None:
    """At a step the side pushes with the way beyond it. Past the end of a membrane, or over a gap, friction begins
    again. A sample lies exactly on the seam."""
    x = -0.004 + 0.2 * np.arange(300) / 10_000
    above, apart = np.array([0.0, 1.01 * FLUSH_M]), np.array([1.01 * FLUSH_M, 0.0])
    for make, by in ((box, above), (box, 100 * above), (box, apart), (skin, above), (skin, apart)):
        rig = Rig({"a": make(-0.01, 0, "rough"), "b": moved(make(0.01, 0, "rough"), by)}, materials=MATERIALS)
        press(rig, x[0], 0)
        found = pushes(rig, x, 0.001, 0)[:, 0]
        seam = int(np.argmax(x > 3 * FLUSH_M))
        assert found[seam - 2] == pytest.approx(-MU * K * 0.001, abs=1e-12)
        if make is box and by is not apart:
            np.testing.assert_allclose(found[seam:], -K * x[seam:], rtol=0, atol=2 * K * FLUSH_M)
        else:
            assert abs(found[seam]) <= SPRING * 2.1e-5


def test_no_way_over_seams_gives_more_than_the_stiffer_side_holds() -> None:
    """Quasi-static ways without friction: each crossing to a stiffer surface gives at most what K grows by, times half
    the square of the largest depth."""
    rng = np.random.default_rng(11)
    names = ["soft", "plain", "hard"]
    for _ in range(20):
        objects = {name: box(0.02 * (i - 1), 0, name) for i, name in enumerate(names)}
        rig = Rig(objects, materials=MATERIALS, device={"max_speed_m_per_s": 1000})
        t = np.linspace(0, 2 * np.pi, 6001)
        x = rng.uniform(0.011, 0.02) * np.sin(rng.integers(1, 4) * t + rng.uniform(0, 6))
        depth = 0.0012 + 0.001 * np.sin(rng.integers(1, 9) * t + rng.uniform(0, 6))
        lift = np.linspace(-0.0005, depth[0], 3000)
        path = np.column_stack(
            [np.concatenate([np.full(3000, x[0]), x, np.full(3000, x[-1])]), -np.concatenate([lift, depth, lift[::-1]])]
        )
        force = rig.render(path, np.zeros_like(path))["contact_force_n"]
        given = float(np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(path, axis=0)))
        stiffness = np.array([300.0, K, 1200.0])[np.searchsorted([-0.01, 0.01], x)]
        grown = np.maximum(0.0, np.diff(stiffness)).sum()
        assert given <= grown * depth.max() ** 2 / 2 + 1e-7


def after_crossings(begin: float, targets: npt.NDArray[np.float64], ramp: int) -> Points:
    """A value that moves in a straight line to each new target within `ramp` ticks, from where it is."""
    found = np.empty(len(targets))
    start, since, target = begin, ramp, targets[0]
    for tick, new in enumerate(targets):
        if new != target:
            start, since, target = found[tick - 1], 0, new
        since += 1
        found[tick] = start + (target - start) * min(1.0, since / ramp)
    return found


@pytest.mark.parametrize("rate_hz", [1000, 10_000])
@pytest.mark.parametrize("makes", [(box, box), (skin, box), (from_below, skin)])
@pytest.mark.parametrize("degrees", [0.0, 213.0])
@pytest.mark.parametrize("lip_m", [0.0, 9e-10])
def test_the_normal_force_goes_over_to_another_stiffness_over_the_ramp(
    rate_hz: float, makes: Sequence[Make], degrees: float, lip_m: float
) -> None:
    """F_n = K(t) d + D(t) v_n, both in a straight line from where they are: seams crossed while a ramp runs, back, to a
    third material, and a probe that rests beyond one."""
    angle = np.radians(degrees)
    names = ["soft", "plain", "hard"]
    objects = {
        name: moved(makes[i % 2](0.02 * i, angle, name), turned([0.0, lip_m * i], angle))
        for i, name in enumerate(names)
    }
    rig = Rig(objects, rate_hz=rate_hz, materials=MATERIALS, device={"max_speed_m_per_s": 1000})
    ramp = round(RAMP_S * rate_hz)
    speed = 0.02 / (2.4 * ramp)  # m a tick: a box lasts 2.4 ramps
    turns = [0.008, 0.0104, 0.0095, 0.0122, 0.0325, 0.0281, 0.0304, 0.0302, 0.0301, 0.0301]  # seams at 10 and 30 mm
    at = np.concatenate([[0.0], np.cumsum(np.maximum(np.abs(np.diff(turns)) / speed, 0.3 * ramp))])
    x = np.interp(np.arange(int(at[-1]) + 2 * ramp), at, turns)
    tick = np.arange(len(x))
    depth = 0.001 + 0.0004 * np.sin(2 * np.pi * tick / (1.7 * ramp))
    rate = -np.gradient(depth) * rate_hz
    down = np.column_stack([np.full(30, x[0]), np.linspace(0.0005, -depth[0], 30)])
    rig.render(turned(down, angle))
    velocity = turned(np.column_stack([np.zeros(len(x)), rate]), angle)
    found = turned(rig.render(turned(np.column_stack([x, -depth]), angle), velocity)["contact_force_n"], -angle)
    where = np.searchsorted([0.01, 0.03], x, side="left")
    stiffness = after_crossings(300.0, np.array([300.0, K, 1200.0])[where], ramp)
    damping = after_crossings(1.5, np.array([1.5, 0.0, 0.0])[where], ramp)
    # A seam to an equal damping begins no ramp of the damping: its target is the same.
    np.testing.assert_allclose(found[:, 1], stiffness * depth - damping * rate, rtol=0, atol=1e-9 + 2 * 1200 * lip_m)
    assert len(set(where)) == 3


@pytest.mark.parametrize(("before", "after"), [("ridged", "plain"), ("plain", "ridged")])
def test_a_surface_that_geometry_lowers_goes_over_without_a_step(before: str, after: str) -> None:
    """A groove's middle lies on the seam: what the surface is lower there fades over the ramp."""
    rig = Rig({"a": box(-0.01, 0, before), "b": box(0.01, 0, after)}, materials=MATERIALS)
    x = -0.003 + 0.08 * np.arange(850) / 10_000
    press(rig, x[0], 0)
    found = pushes(rig, x, 0.001, 0)[:, 1]
    from_middle = np.abs(x)
    groove = np.where(from_middle < 0.001, 0.0002 * (1 + np.cos(np.pi * from_middle / 0.001)), 0.0)
    seam = int(np.argmax(x > FLUSH_M))
    fading = np.clip(1 - (np.arange(850) - seam + 1) / (RAMP_S * 10_000), 0, 1)
    if before == "ridged":
        lowering = np.where(np.arange(850) < seam, groove, groove[seam - 1] * fading)
    else:
        lowering = np.where(np.arange(850) < seam, 0.0, groove - groove[seam - 1] * fading)
    np.testing.assert_allclose(found, K * (0.001 - lowering), rtol=0, atol=1e-12)


@pytest.mark.parametrize(("before", "after"), [("rough", "stiff"), ("stiff", "rough")])
def test_friction_goes_over_to_another_material_over_the_ramp(before: str, after: str) -> None:
    """Sliding: mu F_n with a mu that goes over in a straight line, from the tick of the seam on."""
    rig = Rig({"a": box(-0.01, 0, before), "b": box(0.01, 0, after)}, materials=MATERIALS)
    press(rig, -0.004, 0)
    x = -0.004 + 0.2 * np.arange(600) / 10_000
    found = pushes(rig, x, 0.001, 0)[:, 0]
    (contact,) = rig.of(EventKind.CONTACT)
    seam = int(np.argmax(x > 0))
    assert int(contact["tick"]) - 30 == seam
    mu = {"rough": MU, "stiff": 0.8}
    weight = np.clip((np.arange(600) - seam + 1) / (RAMP_S * 10_000), 0, 1)
    expected = -(mu[before] + weight * (mu[after] - mu[before])) * K * 0.001
    # A stronger spring that has not yet slid holds less: it is stretched by the way alone.
    if mu[after] < mu[before]:
        np.testing.assert_allclose(found[150:], expected[150:], rtol=0, atol=1e-12)
    else:
        assert np.all(np.abs(found[150:]) <= np.abs(expected[150:]) + 1e-12)
        assert found[-1] == pytest.approx(expected[-1], abs=1e-12)
    assert np.abs(np.diff(found[100:])).max() <= 1500 * 2e-5 * 1.001


@pytest.mark.parametrize(("before", "after"), [("rough", "stiff"), ("stiff", "rough"), ("rough", "plain")])
def test_a_hand_that_rests_beyond_the_seam_is_pushed_no_harder(before: str, after: str) -> None:
    """It sticks over the seam and stops there: neither a stiffer nor a softer spring adds to what it holds."""
    rig = Rig({"a": box(-0.01, 0, before), "b": box(0.01, 0, after)}, materials=MATERIALS)
    press(rig, -1e-4, 0)
    first = abs(float(pushes(rig, np.linspace(-1e-4, 1e-8, 100), 0.001, 0)[-1, 0]))
    assert first > 0.05
    held = np.concatenate([[first], np.abs(rig.render(still(1e-8, -0.001, 300))["contact_force_n"][:, 0])])
    assert np.all(np.diff(held) <= 1e-12)
    assert -np.diff(held).min() <= 2 * max(first, MU * K * 0.001) / (RAMP_S * 10_000)
    if after == "plain":
        assert held[-1] == 0.0


def test_no_closed_way_over_seams_of_three_materials_gives_energy() -> None:
    """Quasi-static, sticking and sliding, pressed more and less: the hand never gets back more than it gave."""
    rng = np.random.default_rng(7)
    for _ in range(10):
        order = rng.permutation(["rough", "stiff", "plain"])
        objects = {str(n): box(0.0002 * (n - 1), 0, str(order[n])) for n in range(3)}
        for n, item in enumerate(objects.values()):
            item["size_m"] = [0.0002, 0.01] if n == 1 else [0.02, 0.01]
            item["center_m"] = [(n - 1) * (0.0001 + 0.01), -0.005]
        rig = Rig(objects, materials=MATERIALS)
        t = np.linspace(0, 2 * np.pi, 20_001)
        size = rng.uniform(1e-4, 4e-4)
        x = size * (np.sin(t + rng.uniform(0, 6)) + 0.5 * np.sin(rng.integers(2, 9) * t))
        depth = 0.001 + 0.0008 * np.sin(rng.integers(1, 5) * t + rng.uniform(0, 6))
        x = np.concatenate([np.full(2000, x[0]), x, x[1:], np.full(2000, x[-1])])
        lift = np.linspace(-0.0005, depth[0], 2000)
        path = np.column_stack([x, -np.concatenate([lift, depth, depth[1:], lift[::-1]])])
        force = rig.render(path)["contact_force_n"]
        given = float(np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(path, axis=0)))
        assert given < 0.0


@pytest.mark.parametrize(
    "beyond", [box(0.010001, 0, "rough"), box(0.01, 0, "rough", 2e-6), box(0.01, 0, "rough", -2e-6)]
)
def test_over_a_gap_or_a_step_friction_begins_anew(beyond: dict[str, object]) -> None:
    rig = Rig({"a": box(-0.01, 0, "rough"), "b": beyond}, materials=MATERIALS)
    press(rig, -0.004, 0)
    x = -0.004 + 0.2 * np.arange(300) / 10_000
    found = pushes(rig, x, 0.001, 0)[:, 0]
    seam = int(np.argmax(x > 1e-6))
    assert found[seam - 2] == pytest.approx(-MU * K * 0.001, abs=1e-12)
    assert abs(found[seam]) <= K * 2.1e-5  # the way since then, or into the side of a step


def test_a_seam_between_two_that_both_hold_is_none() -> None:
    """A box in a wall, flush with it: each has a spring of its own, and that of the box is gone with it."""
    floor = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "rough"}
    rig = Rig({"w": floor, "a": box(-0.01, 0, "rough")}, materials=MATERIALS)
    press(rig, -0.004, 0)
    x = -0.004 + 0.2 * np.arange(400) / 10_000
    found = pushes(rig, x, 0.001, 0)[:, 0]
    assert found[150] == pytest.approx(-2 * MU * K * 0.001, abs=1e-12)
    assert found[-1] == pytest.approx(-MU * K * 0.001, abs=1e-12)
