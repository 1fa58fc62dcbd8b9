"""Discs pressed deep, to the centre and through it: direction, steps, energy of closed ways, friction, grooves.

The references share nothing with the core: the nearest point of the rim is that of the straight line from the centre,
a force is the difference quotient of the energy that is stored, and energies are sums over the way.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest

from hapticd.base.core import MATERIAL_DTYPE, EventKind, records
from hapticd.rendering.disc_stiffness import round_properties
from tests.support.rig import Rig

Points = npt.NDArray[np.float64]

K, RADIUS, MU, SPRING = 800.0, 0.002, 0.35, 600.0
PACE = 24.0
"""How much faster than the probe the proxy goes at most."""
WHOLE, BARE = 0.5, 0.2
"""Distances from the centre, in radii, beyond which geometry acts fully, and within which not at all."""
SPACING, WIDTH, LOWERED = 0.0005, 0.0004, 0.0001
GROOVES = {"kind": "grooves", "spacing_m": SPACING, "width_m": WIDTH}
FRICTION = {"coefficient": MU, "stiffness_n_per_m": SPRING}
MATERIALS: dict[str, object] = {
    "plain": {"stiffness_n_per_m": K},
    "rough": {"stiffness_n_per_m": K, "friction": FRICTION},
    "shaped": {"stiffness_n_per_m": K, "texture": {**GROOVES, "display": "geometry", "depth_m": LOWERED}},
    "both": {
        "stiffness_n_per_m": K,
        "texture": {**GROOVES, "display": "geometry", "depth_m": LOWERED},
        "friction": FRICTION,
    },
    "comb": {
        "stiffness_n_per_m": K,
        "texture": {
            **GROOVES,
            "display": "vibration",
            "velocity_gain_per_s": 1000,
            "frequency_hz": 200,
            "decay_time_s": 0.003,
        },
    },
}


def peg(material: str = "plain", rate_hz: float = 10_000.0) -> Rig:
    item = {"kind": "disc", "center_m": [0, 0], "radius_m": RADIUS, "material": material}
    return Rig({"peg": item}, rate_hz=rate_hz, materials=MATERIALS)


def polar(radius: npt.ArrayLike, angle: npt.ArrayLike) -> Points:
    """Points at angles clockwise from the top."""
    return np.column_stack(np.broadcast_arrays(radius * np.sin(angle), radius * np.cos(angle)))


def straight(a: npt.ArrayLike, b: npt.ArrayLike, step: float) -> Points:
    """From a to b in steps of this size."""
    way = np.asarray(b, dtype=np.float64) - np.asarray(a, dtype=np.float64)
    part = np.linspace(0.0, 1.0, max(2, round(float(np.hypot(*way)) / step) + 1))
    return np.asarray(a) + part[:, None] * way


def force(rig: Rig, path: Points) -> Points:
    found: Points = rig.render(path)["contact_force_n"]
    return found


def steps(vectors: Points) -> npt.NDArray[np.float64]:
    found: npt.NDArray[np.float64] = np.hypot(*np.diff(vectors, axis=0).T)
    return found


def work(pushes: Points, path: Points) -> float:
    """What the surface gave to a hand that went along this way, by the trapezium rule."""
    return float(np.sum(0.5 * (pushes[1:] + pushes[:-1]) * np.diff(path, axis=0)))


@pytest.mark.parametrize("close", [0.9, 0.5, 0.25, 0.1, 0.05])
def test_around_the_centre_the_force_points_from_it_however_deep(close: float) -> None:
    """Several turns, to and fro: K (R - r) along the line from the centre, where it used to stay as it was."""
    rig = peg(rate_hz=1000)
    angle = 8 * np.sin(np.linspace(0, 2 * np.pi, 4000))
    r = close * RADIUS * (1 + 0.05 * np.sin(np.arange(4000) / 50) ** 2)
    force(rig, straight((0, 1.1 * RADIUS), (0, r[0]), 2e-5))
    expected = K * (RADIUS - r)[:, None] * polar(1.0, angle)
    np.testing.assert_allclose(force(rig, polar(r, angle)), expected, rtol=0, atol=1e-12)
    assert rig.kinds() == []


@pytest.mark.parametrize("offset", [0.0, 1e-9, 0.01, 0.05, 0.2, 0.49, -0.03, -0.3])
@pytest.mark.parametrize("degrees", [0, 90, 200])
def test_pressed_through_it_the_surface_point_comes_round(offset: float, degrees: float) -> None:
    """With a force that has no step, and points from the centre again once the probe is out of its middle."""
    rig, step = peg(), 1e-6
    path = straight((offset * RADIUS, 1.2 * RADIUS), (offset * RADIUS, -1.2 * RADIUS), step)
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    path = path @ np.array([[c, s], [-s, c]])
    pushes = force(rig, path)
    assert [EventKind(int(kind)) for kind in rig.events["kind"]] == [EventKind.CONTACT, EventKind.RELEASE]
    assert steps(pushes).max() <= K * (1 + PACE) * step * 1.001
    r = np.hypot(*path.T)
    # Half a turn takes pi R / PACE from the centre on, before or after it.
    near = abs(offset) * PACE < 1.2
    far = r > RADIUS * (np.pi / PACE + 0.01) if near else r > 0
    expected = K * np.maximum(RADIUS - r, 0)[:, None] * path / np.maximum(r, 1e-12)[:, None]
    np.testing.assert_allclose(pushes[far], expected[far], rtol=0, atol=1e-11)
    assert far.sum() > 1500


def test_a_probe_that_rests_where_it_was_pressed_through_is_held_as_it_was() -> None:
    """What turns the direction is the way of the probe, not time: a hand at rest in the middle feels no change."""
    rig = peg()
    rig.render(straight((1e-5, 1.1 * RADIUS), (1e-5, -0.02 * RADIUS), 1e-6))
    pushes = force(rig, np.tile([1e-5, -0.02 * RADIUS], (5000, 1)))
    assert np.all(pushes == pushes[0])


def ways(rng: np.random.Generator, count: int, centred: bool) -> Points:
    """A closed way from outside, in, around in the disc, again, and out where it came in."""
    t = np.linspace(0, 2 * np.pi, count)
    if centred:  # through the centre, or close by
        orders = np.arange(1, 5)
        amounts = (rng.normal(size=(2, 4)) + 1j * rng.normal(size=(2, 4))) / orders
        around = np.exp(1j * np.outer(orders, t))
        z = amounts[0] @ around + amounts[1] @ np.conj(around)
        z -= z[rng.integers(count)] * (1.0 + rng.choice([0.0, 0.02, 0.1]) * rng.normal())
        z *= rng.uniform(0.3, 0.97) * RADIUS / np.abs(z).max()
    else:
        r = rng.uniform(0.25, 0.75) + rng.uniform(0.05, 0.2) * np.sin(rng.integers(1, 5) * t + rng.uniform(0, 6))
        z = RADIUS * r * np.exp(1j * rng.uniform(0.2, 7) * np.sin(rng.integers(1, 4) * t))
    step = float(np.abs(np.diff(z)).mean())
    outside = 1.2 * RADIUS * np.exp(1j * np.angle(z[0]))
    inward = np.linspace(outside, z[0], max(2, round(abs(outside - z[0]) / step)))
    whole = np.concatenate([inward, z[1:], z[1:], inward[-2::-1]])
    return np.column_stack([whole.real, whole.imag])


@pytest.mark.parametrize("centred", [True, False], ids=["through the centre", "around it"])
@pytest.mark.parametrize("material", ["plain", "rough", "shaped", "both"])
def test_no_closed_way_gives_energy(material: str, centred: bool) -> None:
    """Quasi-static: the energy gained falls to zero with the square of the step; the disc can store 1.6 mJ."""
    rng = np.random.default_rng(4)
    given: list[list[float]] = []
    for _ in range(3):
        fine = ways(rng, 16_001, centred)
        given.append([work(force(peg(material), fine[::every]), fine[::every]) for every in (4, 1)])
    coarse, finest = np.array(given).T
    if centred or material in ("rough", "both"):
        assert finest.max() < 0.0  # on its way round the proxy loses some, and friction does
        assert coarse.max() < 0.0
    else:
        assert np.abs(finest).max() <= np.abs(coarse).max() / 8
        assert np.abs(finest).max() < 4e-6


def faded(r: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """What there is of geometry at r: a smooth step over 0.2 to 0.5 R."""
    x = np.clip((np.asarray(r) / RADIUS - BARE) / (WHOLE - BARE), 0, 1)
    return np.asarray(x * x * (3 - 2 * x))


def lowering(s: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """A raised cosine at each groove."""
    offset = np.asarray(s) - SPACING * np.round(np.asarray(s) / SPACING)
    return np.where(2 * np.abs(offset) < WIDTH, LOWERED * (0.5 + 0.5 * np.cos(2 * np.pi * offset / WIDTH)), 0.0)


def stored(p: Points) -> npt.NDArray[np.float64]:
    """K/2 (d - g H)^2, for probes on the upper half."""
    r = np.hypot(*p.T)
    pressed = np.maximum(0.0, RADIUS - r - faded(r) * lowering(RADIUS * np.arctan2(p[:, 0], p[:, 1])))
    found: npt.NDArray[np.float64] = 0.5 * K * pressed**2
    return found


def clockwise(p: Points) -> Points:
    """Unit vectors around the centre."""
    found: Points = np.column_stack([p[:, 1], -p[:, 0]]) / np.hypot(*p.T)[:, None]
    return found


def went(r: npt.ArrayLike, angle: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """The integral of r over the angle, from the first point on: how far a probe went along the surface, m."""
    radius, bearing = np.broadcast_arrays(r, angle)
    steps = 0.5 * (radius[1:] + radius[:-1]) * np.diff(bearing)
    return np.concatenate([[0.0], np.cumsum(steps)])


def test_sticking_on_shaped_ground_the_force_is_the_gradient_of_the_energy_and_the_spring_along_the_surface() -> None:
    """At all depths, through the complete fade of geometry."""
    rng = np.random.default_rng(1)
    bearing = 0.9
    for _ in range(30):
        rig = peg("both")
        r = np.linspace(1.1, rng.uniform(BARE + 0.02, 0.9), 2000) * RADIUS
        force(rig, polar(r, bearing))
        # A small way: it sticks where it was pressed in.
        angle = np.linspace(bearing, bearing + rng.uniform(-0.04, 0.04), 200)
        depths = r[-1] * np.linspace(1, rng.uniform(0.97, 1.0), 200)
        path = polar(depths, angle)
        pushes = force(rig, path)
        h = 1e-9
        slope = np.column_stack([(stored(path - h * axis) - stored(path + h * axis)) / (2 * h) for axis in np.eye(2)])
        spring = -SPRING * went(depths, angle)[:, None] * clockwise(path)
        np.testing.assert_allclose(pushes, slope + spring, rtol=0, atol=1e-5)


@pytest.mark.parametrize("rate_hz", [1000, 10_000])
@pytest.mark.parametrize("deep", [0.02, 0.1, 0.3, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95])
def test_sliding_around_the_centre_friction_is_mu_times_the_normal_force(deep: float, rate_hz: float) -> None:
    """Several ways round, to and fro and at changing depths: K d along the normal, mu K d against the motion."""
    rng = np.random.default_rng(round(100 * deep))
    for _ in range(4):
        rig = peg("rough", rate_hz)
        force(rig, straight((0, 1.1 * RADIUS), (0, (1 - deep) * RADIUS), 2e-6))
        # First in the direction of the stroke, far enough to slide: the spring is longest at the largest depth.
        way = rng.choice([-1, 1])
        far = 1.05 * MU * K * 1.2 * deep * RADIUS / SPRING / ((1 - deep) * RADIUS)
        angle = way * np.linspace(0.0, 2 * far + rng.uniform(1, 7), 6000)
        shallower = 1.0 - 0.2 * rng.uniform(0.0, 1.0) * np.linspace(0.0, 1.0, 6000) ** 2
        depth = deep * RADIUS * shallower
        path = polar(RADIUS - depth, angle)
        pushes = force(rig, path)[np.abs(angle) > 2 * far]
        slid = path[np.abs(angle) > 2 * far]
        outward = slid / np.hypot(*slid.T)[:, None]
        pressed = K * depth[np.abs(angle) > 2 * far]
        np.testing.assert_allclose(np.sum(pushes * outward, axis=1), pressed, rtol=1e-9)
        np.testing.assert_allclose(np.sum(pushes * clockwise(slid), axis=1), -way * MU * pressed, rtol=1e-9)


@pytest.mark.parametrize("close", [0.95, 0.7, 0.5, 0.4, 0.25, 0.15, 0.06])
def test_sticking_friction_has_the_stiffness_of_its_spring_at_every_depth(close: float) -> None:
    rig = peg("rough")
    force(rig, straight((0, 1.1 * RADIUS), (0, close * RADIUS), 1e-6))
    far = 0.9 * MU * K * (1 - close) / SPRING / close
    angle = np.concatenate([np.linspace(0, far, 4000), np.linspace(far, -far, 8000)[1:]])
    path = polar(close * RADIUS, angle)
    pushes = force(rig, path)
    # The way of a tick is its chord: a part of step^2 / 6 less than the arc.
    along = SPRING * close * RADIUS * angle
    np.testing.assert_allclose(
        np.sum(pushes * clockwise(path), axis=1), -along, rtol=0, atol=np.abs(along).max() * (far / 4000) ** 2
    )
    outward = path / np.hypot(*path.T)[:, None]
    np.testing.assert_allclose(np.sum(pushes * outward, axis=1), K * (1 - close) * RADIUS, rtol=1e-12)


@pytest.mark.parametrize("deep", [0.9, 0.55, 0.3])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_spring_that_is_stretched_at_one_depth_and_eased_off_at_another_gives_nothing(deep: float, sign: int) -> None:
    """Sticking all the way: to one side there, back again here, either way round.

    The hand loses what the spring still holds at the end, stretched by the difference of the two ways.
    """
    turn = sign * 0.9 * MU * K * 0.05 / SPRING
    corners = [(deep, 0.0), (deep, turn), (0.95, turn), (0.95, 0.0), (deep, 0.0)]
    r, angle = np.concatenate(
        [np.linspace(a, b, 20_000)[1:] for a, b in pairwise(np.array([corners[0], *corners]))]
    ).T * [[RADIUS], [1.0]]
    for order in (slice(None), slice(None, None, -1)):
        rig = peg("rough")
        rig.render(straight((0, 1.1 * RADIUS), (0, deep * RADIUS), 1e-6))
        path = polar(r[order], angle[order])
        held = 0.5 * SPRING * went(r[order], angle[order])[-1] ** 2
        assert -work(force(rig, path), path) == pytest.approx(held, rel=1e-6, abs=1e-12)


@pytest.mark.parametrize("close", [0.9, 0.5, 0.25])
def test_a_trembling_hand_does_not_drift(close: float) -> None:
    """To and fro on straight lines in every direction, 1000 times: friction is bit for bit back to rounding."""
    rig = peg("rough")
    stuck = polar(close * RADIUS, [0.0, 0.5 * MU * K * (1 - close) / SPRING / close])
    force(rig, np.concatenate([straight((0, 1.1 * RADIUS), stuck[0], 1e-6), straight(stuck[0], stuck[1], 1e-6)]))
    before = force(rig, stuck[1:])[0]
    rng = np.random.default_rng(3)
    shakes = stuck[1] + rng.uniform(-0.02, 0.02, (1000, 2)) * (1 - close) * RADIUS
    path = np.stack([shakes, np.tile(stuck[1], (1000, 1))], axis=1).reshape(-1, 2)
    np.testing.assert_allclose(force(rig, path)[1::2], np.tile(before, (1000, 1)), rtol=0, atol=1e-12)


@pytest.mark.parametrize("close", [0.9, 0.5])
def test_a_probe_that_circles_while_it_sticks_stretches_the_spring_by_the_area_over_r(close: float) -> None:
    """Friction is not the gradient of an energy of the place: a path around an area A returns with A/r more or less."""
    rig = peg("rough")
    force(rig, straight((0, 1.1 * RADIUS), (0, close * RADIUS), 1e-6))
    turn = np.linspace(0, 2 * np.pi, 2001)
    small = 0.2 * MU * K * (1 - close) * RADIUS / SPRING
    path = np.column_stack([small * np.sin(turn), close * RADIUS - small * (1 - np.cos(turn))])
    pushes = force(rig, path)
    expected = went(np.hypot(*path.T), np.arctan2(path[:, 0], path[:, 1]))[-1]
    assert pushes[-1, 0] == pytest.approx(-SPRING * expected, rel=1e-5)
    assert abs(expected) == pytest.approx(np.pi * small**2 / (close * RADIUS - small), rel=0.05)


def test_the_force_held_from_tick_to_tick_gives_no_more_than_its_stiffness_allows() -> None:
    """The hand gets at most S/2 times the square of each step, S the bound of the stability margin, at every depth.

    That is the work of the force of a tick along the step to the next one. The disc stores nothing at both ends.
    """
    rng = np.random.default_rng(6)
    material = records(MATERIAL_DTYPE, 1)
    material["stiffness_n_per_m"], material["friction_coefficient"] = K, MU
    material["friction_stiffness_n_per_m"] = SPRING
    bound = round_properties(np.array([RADIUS]), material, K * RADIUS)
    stiffness = float(max(bound.normal[0], bound.tangent[0]))
    for _ in range(60):
        corners = rng.uniform(-1, 1, (rng.integers(3, 40), 2)) * RADIUS * rng.uniform(0.1, 0.9)
        outside = 1.2 * RADIUS * corners[0] / np.hypot(*corners[0])
        points = np.array([outside, *corners, *(corners[::-1] if rng.random() < 0.3 else []), outside])
        step = RADIUS * 10 ** rng.uniform(-3, -1)
        path = np.concatenate([straight(a, b, step)[1:] for a, b in pairwise(points)] + [outside[None, :]])
        path = np.concatenate([outside[None, :], path])
        pushes = force(peg("rough"), path)
        moves = np.diff(path, axis=0)
        assert np.sum(pushes[:-1] * moves) <= 0.5 * stiffness * np.sum(moves**2)


@pytest.mark.parametrize("close", [0.8, 0.45, 0.2, 0.06])
def test_grooves_sound_however_deep_they_are_stroked(close: float) -> None:
    """One strike for each that the proxy passes, where the bearing used to stand still."""
    rig = peg("comb")
    force(rig, straight((0, 1.1 * RADIUS), (0, close * RADIUS), 1e-6))
    angle = np.linspace(0, 2.9, 3000)
    rig.render(polar(close * RADIUS, angle))
    struck = len(rig.of(EventKind.GROOVE))
    assert struck == int(RADIUS * 2.9 / SPACING)


@pytest.mark.long
def test_on_a_path_through_the_disc_no_material_causes_a_step() -> None:
    """A step of the force is of the order of the step of the probe, on every way: it halves with it."""
    for material in ("plain", "rough", "shaped", "both"):
        largest: list[float] = []
        rng = np.random.default_rng(9)
        fine = ways(rng, 32_001, True)
        for every in (4, 2, 1):
            largest.append(float(steps(force(peg(material), fine[::every])).max()))
        assert all(0.4 <= b / a <= 0.6 for a, b in pairwise(largest)), material
