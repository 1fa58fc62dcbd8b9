"""Friction: a spring to where the probe sticks, never more than mu F_n.

The reference is the stop operator (Prandtl): with the stretch e of the spring, e <- clip(e + ds, +- mu F_n / k), the
force -k e along the surface.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest

from hapticd.base.core import EVENT_DTYPE, SAMPLE_DTYPE, EventKind, Status, ffi, invalid_reason, lib, pointer, records
from hapticd.config.configuration import load_config
from hapticd.rendering.compiler.table import Compiler
from hapticd.rendering.device_output import output_of
from hapticd.rendering.joystick import new_operator, new_sim
from hapticd.rendering.offline import new_world
from tests.support.rig import Rig, still

Points = npt.NDArray[np.float64]

K, MU, SPRING = 800.0, 0.35, 600.0
MATERIALS: dict[str, object] = {
    "rough": {"stiffness_n_per_m": K, "friction": {"coefficient": MU, "stiffness_n_per_m": SPRING}},
    "soft": {"stiffness_n_per_m": 500, "friction": {"coefficient": MU, "stiffness_n_per_m": SPRING}},
    "plain": {"stiffness_n_per_m": K},
}
FLOOR = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "rough"}


def turned(points: npt.ArrayLike, angle: float, about: Sequence[float] = (0.0, 0.0)) -> Points:
    """Points turned counterclockwise about the origin and then moved."""
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(points, dtype=np.float64) @ np.array([[c, s], [-s, c]]) + np.asarray(about)


def stop(s: Points, longest: npt.ArrayLike, stretch: float = 0.0) -> Points:
    """Stretch of the spring at each place along a path, that at the first one given."""
    limits = np.broadcast_to(longest, s.shape)
    found = np.empty_like(s)
    found[0] = stretch
    for i in range(1, len(s)):
        found[i] = np.clip(found[i - 1] + s[i] - s[i - 1], -limits[i], limits[i])
    return found


def surfaces(angle: float, center: Sequence[float]) -> dict[str, dict[str, object]]:
    """A wall, a box and a membrane (from both sides) whose surface is y = 0, turned and moved."""
    normal = [-float(np.sin(angle)), float(np.cos(angle))]
    middle = turned([0, -0.005], angle, center)
    return {
        "wall": {"kind": "wall", "point_m": list(center), "normal": normal, "material": "rough"},
        "box": {
            "kind": "box",
            "center_m": middle.tolist(),
            "size_m": [0.06, 0.01],
            "angle_rad": angle,
            "material": "rough",
        },
        "membrane": {
            "kind": "membrane",
            "center_m": list(center),
            "normal": normal,
            "width_m": 0.06,
            "material": "rough",
        },
        "membrane from below": {
            "kind": "membrane",
            "center_m": list(center),
            "normal": [-normal[0], -normal[1]],
            "width_m": 0.06,
            "material": "rough",
        },
    }


@pytest.mark.long
@pytest.mark.parametrize("kind", ["wall", "box", "membrane", "membrane from below"])
@pytest.mark.parametrize("degrees", [0.0, 90.0, 197.0])
def test_spring_before_slip_and_mu_times_the_normal_force_while_sliding(kind: str, degrees: float) -> None:
    """To and fro under a changing load, on every flat shape: the stop operator, to rounding."""
    angle, center = np.radians(degrees), (0.02, -0.01)
    rig = Rig({"it": surfaces(angle, center)[kind]}, materials=MATERIALS)
    t = np.arange(20_000) / 10_000
    depth = 0.001 + 0.0006 * np.sin(2 * np.pi * 0.7 * t) * np.minimum(4 * t, 1)
    s = 0.004 * np.sin(2 * np.pi * 3 * t) * np.exp(-t) + 0.001 * np.sin(40 * t)
    land = np.column_stack([np.zeros(60), np.linspace(0.0005, -0.001, 60)])
    rig.render(turned(land, angle, center))
    path = np.column_stack([s, -depth])
    samples = rig.render(turned(path, angle, center))
    pushes = turned(samples["contact_force_n"], -angle)
    np.testing.assert_allclose(pushes[:, 1], K * depth, rtol=0, atol=1e-11)
    expected = -SPRING * stop(s, MU * K * depth / SPRING)
    np.testing.assert_allclose(pushes[:, 0], expected, rtol=0, atol=1e-11)
    slides = np.abs(expected) >= MU * K * depth * (1 - 1e-9)
    assert 0.1 < slides.mean() < 0.95
    assert rig.kinds() == []


def test_the_spring_and_the_slip_are_exact() -> None:
    """k ds before the slip and mu F_n after it, at 1e-12; the other way it takes twice the stretch."""
    rig = Rig({"floor": FLOOR}, materials=MATERIALS)
    rig.render(np.column_stack([np.zeros(20), np.linspace(0.0005, -0.001, 20)]))
    normal, longest = K * 0.001, MU * K * 0.001 / SPRING
    s = np.linspace(0, 0.003, 3001)
    force = rig.render(np.column_stack([s, np.full_like(s, -0.001)]))["contact_force_n"]
    np.testing.assert_allclose(force[:, 0], -np.minimum(SPRING * s, MU * normal), rtol=0, atol=1e-12)
    back = s[::-1]
    force = rig.render(np.column_stack([back, np.full_like(s, -0.001)]))["contact_force_n"]
    stretch = np.maximum(longest - (s[-1] - back), -longest)
    np.testing.assert_allclose(force[:, 0], -SPRING * stretch, rtol=0, atol=1e-12)
    np.testing.assert_allclose(force[:, 1], normal, rtol=0, atol=1e-12)


@pytest.mark.parametrize("amplitude", [0.0003, 0.001, 0.004])
def test_work_around_a_loop_is_that_of_the_hysteresis(amplitude: float) -> None:
    """4 mu F (a - mu F / k) are lost in each loop to +- a and back; nothing within the pre-sliding stretch."""
    rig = Rig({"floor": FLOOR}, materials=MATERIALS)
    rig.render(np.column_stack([np.zeros(20), np.linspace(0.0005, -0.001, 20)]))
    loop = amplitude * np.concatenate([np.linspace(1, -1, 20_001), np.linspace(-1, 1, 20_001)[1:]])
    first = amplitude * np.linspace(0, 1, 10_001)
    s = np.concatenate([first, loop, loop[1:]])
    force = rig.render(np.column_stack([s, np.full_like(s, -0.001)]))["contact_force_n"][:, 0]
    s, force = s[-len(loop) :], force[-len(loop) :]
    work = -float(np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(s)))
    most = MU * K * 0.001
    expected = 4 * most * max(0.0, amplitude - most / SPRING)
    # The trapezium rule is off where a sample lies across a corner of the loop: by less than k ds^2 / 8, twice.
    assert work == pytest.approx(expected, abs=SPRING * (amplitude / 10_000) ** 2)


@pytest.mark.long
def test_friction_on_a_disc_follows_the_arc_and_over_the_bottom() -> None:
    """Round the rim, several turns to and fro: the stop operator over the arc length, past the seam at the bottom.

    The arc is the probe's own, at the radius R - d.
    """
    radius, depth = 0.005, 0.0008
    center = np.array([0.01, 0.02])
    disc = {"kind": "disc", "center_m": center.tolist(), "radius_m": radius, "material": "rough"}
    rig = Rig({"peg": disc}, materials=MATERIALS)
    t = np.arange(60_000) / 10_000
    angle = np.pi + 0.05 * np.sin(60 * t) + 8 * np.sin(1.1 * t) * np.minimum(t / 2, 1)

    def polar(r: npt.ArrayLike, a: npt.ArrayLike) -> Points:
        return np.column_stack(np.broadcast_arrays(r * np.sin(a), r * np.cos(a))) + center

    rig.render(polar(np.linspace(radius + 5e-4, radius - depth, 50), np.pi))
    samples = rig.render(polar(radius - depth, angle))
    radial = polar(1.0, angle) - center
    tangent = np.column_stack([radial[:, 1], -radial[:, 0]])
    normal = np.sum(samples["contact_force_n"] * radial, axis=1)
    along = np.sum(samples["contact_force_n"] * tangent, axis=1)
    np.testing.assert_allclose(normal, K * depth, rtol=0, atol=1e-12)
    # The way of a tick is its chord, (R - d) sin of the step.
    way = (radius - depth) * np.concatenate([[np.pi], np.pi + np.cumsum(np.sin(np.diff(angle)))])
    expected = -SPRING * stop(way, MU * K * depth / SPRING)
    np.testing.assert_allclose(along, expected, rtol=0, atol=1e-11)
    assert rig.kinds() == []
    assert np.ptp(angle) > 4 * np.pi


def test_pressed_less_it_slides_and_lifted_off_it_forgets() -> None:
    rig = Rig({"floor": FLOOR}, materials=MATERIALS)
    rig.render(np.column_stack([np.zeros(20), np.linspace(0.0005, -0.001, 20)]))
    rig.render(np.column_stack([np.linspace(0, 0.0004, 50), np.full(50, -0.001)]))
    depth = np.linspace(0.001, 0.0, 501)
    force = rig.render(np.column_stack([np.full(501, 0.0004), -depth]))["contact_force_n"]
    wanted = -np.minimum(SPRING * 0.0004, MU * K * depth)
    np.testing.assert_allclose(force[:, 0], wanted, rtol=0, atol=1e-12)
    assert rig.kinds() == [EventKind.RELEASE]
    again = rig.render(np.column_stack([np.full(20, 0.0004), np.linspace(0.0002, -0.001, 20)]))
    assert not again["contact_force_n"][:, 0].any()


@pytest.mark.long
def test_held_open_loop_for_an_hour_the_force_does_not_move() -> None:
    """3.6 million ticks at mu F_n - 1 %: bit for bit the same force; with a trembling hand the place stays, too."""
    rig = Rig({"floor": FLOOR}, rate_hz=1000, materials=MATERIALS)
    rig.render(np.column_stack([np.zeros(20), np.linspace(0.0005, -0.001, 20)]))
    longest = MU * K * 0.001 / SPRING
    x = 0.99 * longest
    rig.render(np.column_stack([np.linspace(0, x, 50), np.full(50, -0.001)]))
    first = rig.render(still(x, -0.001, 1))["contact_force_n"][0]
    for _ in range(36):
        force = rig.render(still(x, -0.001, 100_000))["contact_force_n"]
        assert np.all(force == first)
    rng = np.random.default_rng(1)
    for _ in range(5):
        trembling = x + rng.uniform(-0.009, 0.009, 100_000) * longest
        force = rig.render(np.column_stack([trembling, np.full(100_000, -0.001)]))["contact_force_n"]
        np.testing.assert_allclose(force[:, 0], -SPRING * trembling, rtol=0, atol=1e-12)


# ---- Closed loop -------------------------------------------------------------------------------------------------

EXACT = {"encoder_step_m": 0, "force_step_n": 0, "coulomb_friction_n": 0}


class Loop:
    """The servo's tick and the simulated joystick, stretch by stretch."""

    def __init__(
        self, material: Mapping[str, object], waypoints: Sequence[Sequence[float]], sim: Mapping[str, object]
    ) -> None:
        config = load_config(
            {
                "device": {"sim": {**sim, "start_m": list(waypoints[0][1:])}},
                "materials": {"it": dict(material)},
                "scene": {"objects": {"floor": {**FLOOR, "material": "it"}}},
            }
        )
        compiler = Compiler(output_of(config, 1000))
        self.world = new_world(compiler.update(config.scene, config.scene.objects, config.materials, 1))
        device = config.device.sim
        self.hand = new_operator(waypoints, "minimum_jerk")
        self.sim = new_sim(device, 1000)
        lib.hd_sim_operate(self.sim, self.hand)
        lib.hd_sim_settle(self.sim)
        self.state = ffi.gc(lib.hd_state_new(1), lib.hd_state_free)
        lib.hd_state_set_resolution(self.state, device.encoder_step_m)

    def run(self, count: int) -> tuple[npt.NDArray[np.void], Points]:
        """Samples, and the handle's own position and velocity, (count, 4)."""
        samples, truth, events = records(SAMPLE_DTYPE, count), np.empty((count, 4)), records(EVENT_DTYPE, 1000)
        found = ffi.new("size_t *")
        status = lib.hd_simulate(
            self.world,
            self.state,
            self.sim,
            count,
            pointer("struct hd_sample[]", samples),
            pointer("double[]", truth),
            pointer("struct hd_event[]", events),
            len(events),
            found,
        )
        assert status == Status.OK, invalid_reason()
        return samples, truth


def pulled(share: float, hand_n_per_m: float = 300.0) -> tuple[list[list[float]], float, float]:
    """Waypoints of a hand that presses and then pulls along with `share` of mu F_n; the normal force, and the pull.

    At rest the hand's spring and the surface's share the way: F = reference / (1/k_hand + 1/k).
    """
    deep = 0.01
    normal = deep / (1 / hand_n_per_m + 1 / K)
    pull = share * MU * normal
    along = pull * (1 / hand_n_per_m + 1 / SPRING)
    return [[0, 0, 0.001], [1, 0, -deep], [2, 0, -deep], [8, along, -deep]], normal, pull


@pytest.mark.long
@pytest.mark.parametrize(("sim", "within"), [(EXACT, 1e-9), ({}, 0.06)], ids=["exact", "joystick"])
def test_pulled_with_one_percent_less_it_stays_for_an_hour(sim: Mapping[str, object], within: float) -> None:
    """Simulated, 3.6 million ticks. The joystick's own dry friction of 0.05 N takes its part of the pull."""
    waypoints, normal, pull = pulled(0.99)
    loop = Loop(MATERIALS["rough"], waypoints, sim)  # type: ignore[arg-type]
    samples, truth = loop.run(20_000)
    place = truth[-1, :2].copy()
    assert samples["force_n"][-1] == pytest.approx([-pull, normal], abs=within)
    for _ in range(36):
        samples, truth = loop.run(100_000)
        assert np.abs(truth[:, :2] - place).max() <= 1e-12


def test_pulled_with_more_it_slides_at_the_right_force() -> None:
    waypoints, normal, _ = pulled(1.0)
    waypoints += [[9, 0.02, -0.01], [29, 0.06, -0.01]]
    loop = Loop(MATERIALS["rough"], waypoints, EXACT)  # type: ignore[arg-type]
    loop.run(12_000)
    samples, truth = loop.run(12_000)
    force = samples["contact_force_n"]
    assert np.all(truth[:, 2] > 0)
    np.testing.assert_allclose(force[:, 0], -MU * force[:, 1], rtol=0, atol=1e-12)
    assert force[:, 1] == pytest.approx(normal, abs=1e-3)


BARE = {"mass_kg": 0, "stiffness_n_per_m": 300, "damping_n_s_per_m": 0}
"""A hand that draws and does not damp: b is the handle's 0.2 N s/m."""


@pytest.mark.parametrize(
    ("stiffness", "hand", "coulomb"),
    [
        (200.0, BARE, 0.0),
        (360.0, BARE, 0.0),
        (400.0, BARE, 0.05),
        (500.0, {}, 0.0),
        (10_400.0, {}, 0.0),
        (10_400.0, {}, 0.05),
    ],
)
def test_no_limit_cycle_at_the_recommended_stiffness(
    stiffness: float, hand: Mapping[str, object], coulomb: float
) -> None:
    """k up to 2 b / T at 1 kHz: after a move that ends in a stop, what is left of the motion dies out. (At 2 b / T
    itself nothing but dry friction or the hand's mass is left to damp it: test below.)"""
    sim = {**EXACT, "coulomb_friction_n": coulomb, "hand": dict(hand)}
    material = {"stiffness_n_per_m": 300, "friction": {"coefficient": 0.5, "stiffness_n_per_m": stiffness}}
    waypoints = [[0, 0, 0.001], [1, 0, -0.01], [2, 0, -0.01], [2.05, 0.01, -0.01]]
    loop = Loop(material, waypoints, sim)
    _, truth = loop.run(2_100)
    assert np.ptp(truth[2000:, 0]) > 1e-3
    sizes = [float(np.ptp(loop.run(1000)[1][:, 0])) for _ in range(100)]
    assert sizes[-1] <= 1e-9
    assert all(later <= earlier + 1e-12 for earlier, later in pairwise(sizes[1:]))


def test_at_the_very_limit_it_does_not_grow() -> None:
    """k = 2 b / T of a bare handle: the loop's largest eigenvalue is 1 - 4e-6; it rings on, a little less and less."""
    material = {"stiffness_n_per_m": 300, "friction": {"coefficient": 0.5, "stiffness_n_per_m": 400}}
    loop = Loop(material, [[0, 0, 0.001], [1, 0, -0.01], [2, 0, -0.01], [2.05, 0.01, -0.01]], {**EXACT, "hand": BARE})
    loop.run(5_000)
    sizes = [float(np.ptp(loop.run(10_000)[1][:, 0])) for _ in range(10)]
    shrinking = np.exp(np.diff(np.log(sizes)))
    assert np.all(shrinking < 1)
    assert shrinking[-1] == pytest.approx(np.exp(-3.6356e-6 * 10_000), rel=2e-2)


def test_no_limit_cycle_with_the_encoder_of_the_joystick() -> None:
    """k Delta / 2 <= c: the default spring on the default joystick comes to rest for good."""
    material = {"stiffness_n_per_m": 300, "friction": {"coefficient": 0.5}}
    loop = Loop(material, [[0, 0, 0.001], [1, 0, -0.01], [2, 0, -0.01], [2.05, 0.01, -0.01]], {})
    loop.run(4_000)
    _, truth = loop.run(60_000)
    assert np.ptp(truth[:, 0]) <= 1e-12


# ---- Updates -----------------------------------------------------------------------------------------------------


def test_the_anchor_survives_updates() -> None:
    """Stiffness and friction change, other objects come and go: the probe sticks where it stuck."""
    x, longest = 0.0002, MU * K * 0.001 / SPRING
    assert x < longest
    for change in (
        {"floor": {**FLOOR, "material": "soft"}},
        {"other": {"kind": "box", "center_m": [0.5, 0.5], "size_m": [0.1, 0.1], "material": "plain"}},
        {"near": {"kind": "disc", "center_m": [0.004, 0], "radius_m": 0.001, "material": "plain"}},
        {"floor": {**FLOOR, "point_m": [0, -1e-4]}},
        {"floor": {**FLOOR, "point_m": [0.3, 0]}},
    ):
        rig = Rig({"floor": FLOOR}, materials=MATERIALS)
        rig.render(np.column_stack([np.zeros(20), np.linspace(0.0005, -0.001, 20)]))
        rig.render(np.column_stack([np.linspace(0, x, 50), np.full(50, -0.001)]))
        rig.update(change)
        samples = rig.render(still(x, -0.001, 400))
        assert rig.kinds() == []
        if change.get("floor", {}).get("point_m") != [0.3, 0]:  # that moves the coordinate itself
            np.testing.assert_allclose(samples["contact_force_n"][:, 0], -SPRING * x, rtol=0, atol=1e-12)
        for _ in range(20):
            rig.update({"far": {"kind": "disc", "center_m": [1, 1], "radius_m": 0.1, "material": "plain"}})
            rig.update({"far": None})
            last = samples["contact_force_n"][-1]
            samples = rig.render(still(x, -0.001, 3))
            np.testing.assert_array_equal(samples["contact_force_n"], np.tile(last, (3, 1)))


def test_friction_that_changes_comes_in_over_the_ramp() -> None:
    """From none to some, to other figures and to none: no step of the force, and the right one after it."""
    rng = np.random.default_rng(3)
    rig = Rig({"floor": FLOOR}, materials=MATERIALS)
    rig.render(np.column_stack([np.zeros(20), np.linspace(0.0005, -0.001, 20)]))
    last = rig.render(np.column_stack([np.linspace(0, 0.002, 500), np.full(500, -0.001)]))
    for n in range(40):
        friction = (
            None if n % 4 == 3 else {"coefficient": rng.uniform(0, 1), "stiffness_n_per_m": rng.uniform(50, 3000)}
        )
        material = {"stiffness_n_per_m": K} | ({} if friction is None else {"friction": friction})
        rig.update({"floor": {**FLOOR, "material": "m"}}, {"m": material})
        samples = rig.render(still(0.002, -0.001, 300))
        force = np.concatenate([last[-1:], samples])["contact_force_n"]
        assert np.abs(np.diff(force, axis=0)).max() <= 4 * K * 0.001 / 200
        most = 0.0 if friction is None else friction["coefficient"] * K * 0.001
        assert abs(force[-1, 0]) <= most + 1e-12
        last = samples


def turned_on_a_disc(last: np.void, radius: float, bearing: float) -> float:
    """The part of a force along a disc's tangent, clockwise."""
    x, y = last["contact_force_n"]
    return float(x * np.cos(bearing) - y * np.sin(bearing))


def test_friction_that_a_disc_loses_goes_out_over_the_ramp() -> None:
    """Stroked, and resting where it came to: the force along the surface only fades."""
    radius = 0.01
    bearing = np.linspace(0.5, 0.8, 500)
    path = (radius - 0.001) * np.column_stack([np.sin(bearing), np.cos(bearing)])
    item = {"kind": "disc", "center_m": [0, 0], "radius_m": radius, "material": "rough"}
    rig = Rig({"disc": item}, materials=MATERIALS)
    rig.render(np.concatenate([np.tile(path[0], (300, 1)), path]))
    last = rig.render(np.tile(path[-1], (10, 1)))
    before = turned_on_a_disc(last[-1], radius, bearing[-1])
    assert before == pytest.approx(-MU * K * 0.001, abs=1e-9)
    rig.update({"disc": {**item, "material": "plain"}})
    samples = rig.render(np.tile(path[-1], (300, 1)))
    along = np.array([before] + [turned_on_a_disc(sample, radius, bearing[-1]) for sample in samples])
    assert np.abs(np.diff(along)).max() <= 2 * abs(before) / 200
    assert np.all(np.diff(along) >= -1e-12)
    assert abs(along[-1]) <= 1e-12


def test_a_disc_that_is_moved_across_its_bottom_drags_by_no_more_than_that() -> None:
    """Pressed from below, where s goes from one end to the other: it goes the shorter way.

    The spring is stretched by the way of the disc along its surface at the probe.
    """
    item = {"kind": "disc", "center_m": [0, 0], "radius_m": 0.01, "material": "rough"}
    rig = Rig({"disc": item}, materials=MATERIALS)
    last = rig.render(still(1e-4, -0.009, 500))
    normal, way = np.array([1e-4, -0.009]) / np.hypot(1e-4, 0.009), 0.0
    for x in (2e-4, 0.5e-4, 3e-4):
        rig.update({"disc": {**item, "center_m": [x, 0]}})
        samples = rig.render(still(1e-4, -0.009, 300))
        force = np.concatenate([last[-1:], samples])["contact_force_n"]
        assert np.abs(np.diff(force, axis=0)).max() <= 0.01
        offset = np.array([1e-4 - x, -0.009])
        way += float(offset @ [normal[1], -normal[0]])
        normal = offset / np.hypot(*offset)
        pulled = samples["contact_force_n"][-1] @ [normal[1], -normal[0]]
        assert pulled == pytest.approx(-SPRING * way, rel=1e-9)
        assert abs(pulled) < 0.9 * MU * K * (0.01 - np.hypot(*offset))
        last = samples
