"""Discs pressed deep, to the centre and through it: direction, steps, energy of closed ways, friction, grooves.

The references share nothing with the core: the nearest point of the rim is that of the straight line from the centre,
a force is the difference quotient of the energy that is stored, and energies are sums over the way.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest

from hapticd.base.core import EventKind
from tests.support.rig import Rig

Points = npt.NDArray[np.float64]

K, RADIUS, MU, SPRING = 800.0, 0.002, 0.35, 600.0
PACE = 24.0
"""How much faster than the probe the proxy goes at most."""
WHOLE, BARE = 0.5, 0.2
"""Distances from the centre, in radii, beyond which geometry and friction act fully, and within which not at all."""
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
    """What there is of geometry and friction at r: a smooth step over 0.2 to 0.5 R."""
    x = np.clip((np.asarray(r) / RADIUS - BARE) / (WHOLE - BARE), 0, 1)
    return np.asarray(x * x * (3 - 2 * x))


def lowering(s: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """A raised cosine at each groove."""
    offset = np.asarray(s) - SPACING * np.round(np.asarray(s) / SPACING)
    return np.where(2 * np.abs(offset) < WIDTH, LOWERED * (0.5 + 0.5 * np.cos(2 * np.pi * offset / WIDTH)), 0.0)


def stored(p: Points, anchor: float) -> npt.NDArray[np.float64]:
    """K/2 (d - g H)^2 + g k/2 (s - anchor)^2, for probes on the upper half that stick."""
    r = np.hypot(*p.T)
    s = RADIUS * np.arctan2(p[:, 0], p[:, 1])
    pressed = np.maximum(0.0, RADIUS - r - faded(r) * lowering(s))
    found: npt.NDArray[np.float64] = 0.5 * K * pressed**2 + 0.5 * SPRING * faded(r) * (s - anchor) ** 2
    return found


def test_sticking_on_shaped_ground_the_force_is_the_gradient_of_the_stored_energy() -> None:
    """At all depths, through the complete fade."""
    rng = np.random.default_rng(1)
    bearing = 0.9
    for _ in range(30):
        rig = peg("both")
        r = np.linspace(1.1, rng.uniform(BARE + 0.02, 0.9), 2000) * RADIUS
        force(rig, polar(r, bearing))
        # A small way: it sticks where it was pressed in.
        a, b = bearing, bearing + rng.uniform(-0.04, 0.04)
        path = polar(r[-1] * np.linspace(1, rng.uniform(0.97, 1.0), 200), np.linspace(a, b, 200))
        pushes = force(rig, path)
        h = 1e-9
        slope = np.column_stack(
            [
                (stored(path - h * axis, RADIUS * bearing) - stored(path + h * axis, RADIUS * bearing)) / (2 * h)
                for axis in np.eye(2)
            ]
        )
        np.testing.assert_allclose(pushes, slope, rtol=0, atol=1e-5)


def test_sliding_deep_friction_is_mu_of_the_normal_force_at_the_rim() -> None:
    """R/r mu F_n where it acts fully, times g deeper, zero in the middle; the radial part is from stored energy."""
    for close in (0.95, 0.7, 0.5, 0.4, 0.3, 0.21, 0.19, 0.1):
        rig = peg("rough")
        force(rig, straight((0, 1.1 * RADIUS), (0, close * RADIUS), 1e-6))
        angle = np.linspace(0, 2.5, 4000)
        pushes = force(rig, polar(close * RADIUS, angle))[-1]
        tangent = np.array([np.cos(angle[-1]), -np.sin(angle[-1])])
        normal = MU * K * (1 - close) * RADIUS
        g = float(faded(close * RADIUS))
        assert pushes @ tangent == pytest.approx(-normal * g / close, abs=1e-10)
        h = 1e-9
        rise = float(faded(close * RADIUS + h) - faded(close * RADIUS - h)) / (2 * h)
        radial = K * (1 - close) * RADIUS - 0.5 * rise * normal**2 / SPRING
        assert pushes @ polar(1.0, angle[-1])[0] == pytest.approx(radial, abs=1e-6)


@pytest.mark.parametrize("deep", [0.9, 0.55, 0.3])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_spring_that_is_stretched_at_one_depth_and_eased_off_at_another_gives_nothing(deep: float, sign: int) -> None:
    """Sticking all the way: to one side there, back again here, either way round."""
    rig = peg("rough")
    rig.render(straight((0, 1.1 * RADIUS), (0, deep * RADIUS), 1e-6))
    turn = sign * 0.9 * MU * K * 0.05 / SPRING
    corners = [(deep, 0.0), (deep, turn), (0.95, turn), (0.95, 0.0), (deep, 0.0)]
    path = np.concatenate(
        [polar(RADIUS * np.linspace(a[0], b[0], 20_000), np.linspace(a[1], b[1], 20_000)) for a, b in pairwise(corners)]
    )
    taken = -work(force(rig, path), path)
    assert abs(taken) <= 1e-12
    taken = -work(force(rig, path[::-1]), path[::-1])
    assert abs(taken) <= 1e-12


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
