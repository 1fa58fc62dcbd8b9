"""Grooves at the level of the tick: strikes, geometry, damping, patches, every shape, hot updates.

References are closed forms of the motion: positions are straight (or turn evenly), so that each passage has a known
time, and forces are the gradient of an energy that stands in `energy_force` once more.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq

from hapticd.base.core import EventKind
from hapticd.rendering.offline import simulate_run
from tests.support.rig import Rig

Floats = npt.NDArray[np.float64]

MASS_KG = 0.001  # so little that dozens of strikes at once leave the limit alone
DEVICE = {"effective_mass_kg": MASS_KG, "max_force_n": 100, "max_speed_m_per_s": 1000}
V_GAIN, F_GAIN = 40.0, 63.4
STIFFNESS = 800.0
FREQUENCY_HZ, DECAY_S = 200.0, 0.003


def comb(spacing_m: float = 0.002, **changes: float) -> dict[str, object]:
    """A material whose grooves vibrate; `changes` are keys of it or of its texture."""
    texture: dict[str, object] = {
        "kind": "grooves",
        "display": "vibration",
        "spacing_m": spacing_m,
        "width_m": spacing_m / 4,
        "velocity_gain_per_s": V_GAIN,
        "force_gain_m_per_s2_per_n": F_GAIN,
        "frequency_hz": FREQUENCY_HZ,
        "decay_time_s": DECAY_S,
    }
    material: dict[str, object] = {"stiffness_n_per_m": STIFFNESS, "texture": texture}
    for key, value in changes.items():
        (texture if key in texture else material)[key] = value
    return material


def shaped(spacing_m: float, width_m: float, depth_m: float, stiffness: float = STIFFNESS) -> dict[str, object]:
    """A material whose grooves are geometry."""
    texture = {"kind": "grooves", "display": "geometry", "spacing_m": spacing_m, "width_m": width_m, "depth_m": depth_m}
    return {"stiffness_n_per_m": stiffness, "texture": texture}


class Wall:
    """A wall somewhere, and points of it by s and depth."""

    def __init__(self, angle: float = 0.0, point: tuple[float, float] = (0.0, 0.0), **keys: object) -> None:
        self.point = np.array(point)
        self.normal = np.array([-math.sin(angle), math.cos(angle)])
        self.tangent = np.array([math.cos(angle), math.sin(angle)])
        self.item = {"kind": "wall", "point_m": list(point), "normal": self.normal.tolist(), "material": "m", **keys}

    def at(self, s: npt.ArrayLike, depth: npt.ArrayLike) -> Floats:
        """Positions, shape (n, 2)."""
        along, deep = np.broadcast_arrays(np.asarray(s, np.float64), np.asarray(depth, np.float64))
        return np.asarray(self.point + along[:, None] * self.tangent - deep[:, None] * self.normal)

    def forces(self, samples: npt.NDArray[np.void], field: str = "contact_force_n") -> tuple[Floats, Floats]:
        """Of each sample: along the normal, along the tangent."""
        return samples[field] @ self.normal, samples[field] @ self.tangent


def rig_of(
    items: Mapping[str, object],
    materials: Mapping[str, object],
    *,
    rate_hz: float = 10_000,
    ramp_s: float = 0.02,
    device: Mapping[str, object] = DEVICE,
) -> Rig:
    return Rig(items, rate_hz=rate_hz, materials=materials, device=device, ramp_s=ramp_s)


def times_of(rig: Rig, kind: EventKind = EventKind.GROOVE) -> Floats:
    """When the last stretch's events happened, s."""
    events = rig.of(kind)
    return np.asarray(events["tick"] / rig.rate_hz - events["before_tick_s"])


def strikes_of(rig: Rig) -> npt.NDArray[np.void]:
    return rig.of(EventKind.GROOVE)


def passages(s0: float, speed: float, spacing: float, from_s: float, to_s: float) -> Floats:
    """Exact times, from_s < t <= to_s, at which s0 + speed t is k spacing, in rising order."""
    start, v, d = Fraction(s0), Fraction(speed), Fraction(spacing)
    ends = sorted((start + v * Fraction(from_s), start + v * Fraction(to_s)))
    numbers = range(math.floor(ends[0] / d), math.ceil(ends[1] / d) + 1)
    times = sorted((k * d - start) / v for k in numbers)
    return np.array([float(t) for t in times if Fraction(from_s) < t <= Fraction(to_s)])


def ringing(
    time_s: Floats, struck_s: Floats, newtons: Floats, frequency_hz: float = FREQUENCY_HZ, decay_s: float = DECAY_S
) -> Floats:
    """The sum of modes struck at those times, silent from five time constants after the last strike on."""
    out = np.zeros_like(time_s)
    silent = np.append(np.diff(struck_s) > 5 * decay_s, True)
    for index, (begin, force) in enumerate(zip(struck_s, newtons, strict=True)):
        last = struck_s[index + int(np.argmax(silent[index:]))]
        heard = slice(*np.searchsorted(time_s, [begin, last + 5 * decay_s]))
        since = time_s[heard] - begin
        out[heard] += force * np.exp(-since / decay_s) * np.sin(2 * np.pi * frequency_hz * since)
    return out


# ---- Strikes ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate_hz", [1000.0, 2000.0, 4000.0, 5000.0, 10_000.0])
@pytest.mark.parametrize("speed", [0.001, 0.0137, 0.1, 0.61803, 2.0])
@pytest.mark.parametrize(("direction", "angle"), [(1, 0.0), (-1, 0.7), (1, 2.5), (-1, -1.3)])
def test_strikes_of_a_straight_stroke(rate_hz: float, speed: float, direction: int, angle: float) -> None:
    """Count, time, amplitude, direction and what is heard, for a stroke that goes deeper (or less deep) as it goes."""
    # At 2 m/s and 1 kHz up to seven in a tick; 1 mm/s takes its time.
    spacing = {0.001: 0.0001, 2.0: 0.0003}.get(speed, 0.0016)
    wall = Wall(angle, (0.0131, -0.0217))
    rig = rig_of({"w": wall.item}, {"m": comb(spacing)}, rate_hz=rate_hz)
    s0, v = -0.00234567 * direction, speed * direction
    duration = 8.5 * spacing / speed if speed < 1 else 0.012
    time = np.arange(round(duration * rate_hz)) / rate_hz
    d0, sinking = (0.0002, 0.4 * speed) if direction > 0 else (0.0305, -0.45 * speed)
    samples = rig.render(wall.at(s0 + v * time, d0 + sinking * time))
    wanted = passages(s0, v, spacing, 0.0, float(time[-1]))
    found = times_of(rig)
    assert len(wanted) > 5
    assert len(found) == len(wanted)
    assert np.abs(found - wanted).max() <= 1e-9
    events = strikes_of(rig)
    amplitude = V_GAIN * speed + F_GAIN * STIFFNESS * (d0 + sinking * wanted)
    np.testing.assert_allclose(events["amplitude_m_per_s2"], amplitude, rtol=1e-6)
    np.testing.assert_allclose(events["speed_m_per_s"], v, rtol=1e-6)
    assert events["value"].tolist() == list(range(1, len(wanted) + 1))
    assert np.all(events["scale"] == 1.0)
    normal, tangent = wall.forces(samples, "vibration_force_n")
    heard = direction * ringing(time, wanted, MASS_KG * amplitude)
    assert np.abs(tangent - heard).max() <= 1e-9
    assert np.abs(normal).max() <= 1e-12


@pytest.mark.parametrize("damping", [0.0, 3.0])
@pytest.mark.parametrize("rate_hz", [1000.0, 2000.0, 10_000.0])
def test_strikes_between_onset_and_release_of_an_oblique_stroke(rate_hz: float, damping: float) -> None:
    """In on one straight line, out on another: what is passed in contact within the first and the last tick counts."""
    wall = Wall(0.4, (0.01, 0.02))
    spacing, v, sink = 0.00031, 1.7, 0.6
    rig = rig_of({"w": wall.item}, {"m": comb(spacing, damping_n_s_per_m=damping)}, rate_hz=rate_hz)
    turn = round(0.012 * rate_hz)
    time = np.arange(2 * turn + 5) / rate_hz
    deepest, s0 = 0.00567, -0.01234
    down = deepest - sink * np.abs(time - time[turn])
    rig.render(wall.at(s0 + v * time, down))
    onset, release = time[turn] - deepest / sink, time[turn] + deepest / sink
    assert (onset * rate_hz) % 1 > 0.1
    assert (release * rate_hz) % 1 > 0.1
    wanted = passages(s0, v, spacing, onset, release)
    found = times_of(rig)
    assert len(found) == len(wanted)
    assert np.abs(found - wanted).max() <= 1e-9
    if rate_hz == 1000.0:  # several of them in the ticks of onset and release
        assert np.sum(wanted < np.ceil(onset * rate_hz) / rate_hz) > 1
        assert np.sum(wanted > np.floor(release * rate_hz) / rate_hz) > 1
    depth, speed = deepest - sink * np.abs(wanted - time[turn]), np.where(wanted < time[turn], sink, -sink)
    force = np.maximum(0.0, STIFFNESS * depth + damping * speed)
    # In the tick after the turn the force of the model goes over from one speed to the other.
    plain = (wanted < time[turn]) | (wanted > time[turn + 1]) | (damping == 0.0)
    amplitude = V_GAIN * v + F_GAIN * force
    np.testing.assert_allclose(strikes_of(rig)["amplitude_m_per_s2"][plain], amplitude[plain], rtol=1e-6)


@pytest.mark.parametrize("direction", [1, -1])
def test_a_groove_exactly_at_a_sample_is_struck_once(direction: int) -> None:
    """Spacing and steps are powers of two: every fourth sample lies on a groove, to the last bit."""
    spacing = 2.0**-9
    rig = rig_of({"w": Wall().item}, {"m": comb(spacing)}, rate_hz=1000)
    s = direction * np.arange(-9, 41) * spacing / 4
    rig.render(Wall().at(s, 0.001))
    wanted = np.array([t for t in (9 + 4 * k for k in range(-2, 11)) if 0 < t < len(s)]) / 1000
    found = times_of(rig)
    if direction < 0:  # one that is reached from above is passed when it is left
        wanted = wanted[wanted < 0.049]
    assert np.abs(found - wanted).max() <= 1e-12


def test_amplitude_follows_the_force_of_the_model_whether_it_is_displayed_or_still_ramping() -> None:
    wall = Wall()
    time = np.arange(300) / 10_000
    path = wall.at(-0.0001 + 0.1 * time, 0.001)
    wanted = passages(-0.0001, 0.1, 0.0005, 0.0, float(time[-1]))
    for force in (True, False):
        rig = Rig(
            {"w": wall.item},
            materials={"m": comb(0.0005)},
            device=DEVICE,
            ramp_s=1.0,
            display={"force": force, "vibration": True},
        )
        rig.render(path)  # begins inside: the force has come in by 3 % at the end
        np.testing.assert_allclose(times_of(rig), wanted, rtol=0, atol=1e-9)
        np.testing.assert_allclose(strikes_of(rig)["amplitude_m_per_s2"], V_GAIN * 0.1 + F_GAIN * 0.8, rtol=1e-6)


def test_nothing_is_struck_in_the_air() -> None:
    wall = Wall()
    rig = rig_of({"w": wall.item}, {"m": comb()})
    rig.render(wall.at(np.linspace(-0.05, 0.05, 4000), -1e-9))
    assert rig.kinds() == []


def test_ten_minutes_of_stroking_do_not_move_the_grooves() -> None:
    rate, spacing, speed, ticks = 1000, 0.0016, 0.0873, 397
    wall = Wall(0.9, (0.02, 0.01))
    rig = rig_of({"w": wall.item}, {"m": comb(spacing)}, rate_hz=rate)
    there = -0.01711 + speed * np.arange(ticks) / rate
    s = np.concatenate([there, there[-1] - speed * np.arange(ticks) / rate])
    path = wall.at(s, 0.001)
    one_way = passages(there[0], speed, spacing, 0.0, (ticks - 1) / rate)
    places = there[0] + speed * one_way
    # Both turns are more than half a spacing beyond the last groove, so that every passage counts.
    assert min(places[0] - there[0], there[-1] - places[-1]) > 0.51 * spacing
    back = ticks / rate + (there[-1] - places[::-1]) / speed
    wanted = np.concatenate([one_way, back])
    share = math.ceil(600 * rate / len(s) / 12)
    count, worst = 0, 0.0
    for repeat in range(12):
        rig.render(np.tile(path, (share, 1)))
        events = strikes_of(rig)
        assert len(events) == share * len(wanted)
        ticks_before = np.repeat(np.arange(share) + repeat * share, len(wanted)) * len(s)
        found = (events["tick"] - ticks_before.astype(np.uint64)) / rate - events["before_tick_s"]
        worst = max(worst, float(np.abs(found.reshape(share, -1) - wanted).max()))
        count += len(found)
    assert worst <= 1e-9
    assert count == 12 * share * len(wanted) > 30_000


@pytest.mark.parametrize("interval", [3, 7])
def test_missed_periods_lose_no_groove(interval: int) -> None:
    """Late samples: every passage is one strike; what began before the period that hears it is heard from there on."""
    rate, spacing, speed = 1000, 0.0005, 0.3
    wall = Wall()
    rig = rig_of({"w": wall.item}, {"m": comb(spacing)}, rate_hz=rate)
    time = np.arange(0, 15 * interval, interval) / rate
    rig.render(wall.at(-0.00123 + speed * time, 0.001), periods=[1] + [interval] * 14)
    wanted = passages(-0.00123, speed, spacing, 0.0, float(time[-1]))
    events = strikes_of(rig)
    assert len(events) == len(wanted)
    tick_s = events["tick"] * interval / rate
    np.testing.assert_allclose(events["before_tick_s"], np.minimum(tick_s - wanted, 1 / rate), rtol=0, atol=1e-9)


# ---- Re-arming ------------------------------------------------------------------------------------------------------


def visits(s: Sequence[float], spacing: float) -> list[int]:
    """The grooves struck along a way, by the rule alone: again only after half a spacing away, or another."""
    struck: list[int] = []
    held: int | None = None
    for before, after in pairwise(s):
        low, high = math.floor(Fraction(before) / Fraction(spacing)), math.floor(Fraction(after) / Fraction(spacing))
        for k in range(low + 1, high + 1) if high > low else range(low, high, -1):
            if k != held:
                struck.append(k)
                held = k
        if held is not None and abs(Fraction(after) - held * Fraction(spacing)) >= Fraction(spacing) / 2:
            held = None
    return struck


@pytest.mark.long
@given(
    start=st.integers(-40, 40),
    steps=st.lists(st.one_of(st.integers(-5, 5), st.integers(-60, 60)), min_size=1, max_size=80),
    exact=st.booleans(),
)
def test_wandering_strikes_by_the_rule(start: int, steps: list[int], exact: bool) -> None:
    """On a grid of an eighth of the spacing, on grooves and half way between them among it, and beside it."""
    spacing = 2.0**-10 if exact else 0.001
    s = (start + np.concatenate([[0], np.cumsum(steps)])) * (spacing / 8 if exact else 0.000123)
    rig = rig_of({"w": Wall().item}, {"m": comb(spacing)}, rate_hz=1000)
    rig.render(Wall().at(s, 0.0005))
    # Times in order, and of each the place where the way was then: the groove.
    at = np.interp(times_of(rig) * 1000, np.arange(len(s)), s)
    assert np.diff(times_of(rig)).min(initial=0.0) >= -1e-12
    assert np.rint(at / spacing).astype(int).tolist() == visits(s.tolist(), spacing)
    np.testing.assert_allclose(at, np.rint(at / spacing) * spacing, rtol=0, atol=1e-11)


def test_less_than_half_a_spacing_about_a_groove_strikes_once_and_more_again() -> None:
    wall = Wall()
    time = np.arange(10_000) / 1000
    for reach, strikes in ((0.49, 1), (0.51, 40)):
        rig = rig_of({"w": wall.item}, {"m": comb(0.002)}, rate_hz=1000)
        rig.render(wall.at(0.004 + reach * 0.002 * np.sin(2 * np.pi * 2 * time + 0.3), 0.001))
        assert len(strikes_of(rig)) == strikes


def test_another_groove_arms() -> None:
    """Back and forth over two grooves: each strikes at every passage, though never half a spacing away from both."""
    wall = Wall()
    rig = rig_of({"w": wall.item}, {"m": comb(0.002)}, rate_hz=1000)
    rig.render(wall.at([0.0039, 0.0061, 0.0039, 0.0061, 0.0039], 0.001))
    assert visits([0.0039, 0.0061, 0.0039, 0.0061, 0.0039], 0.002) == [2, 3, 2, 3, 2]
    assert len(strikes_of(rig)) == 5


def test_steps_of_an_encoder_about_a_groove_strike_once() -> None:
    wall = Wall()
    rig = rig_of({"w": wall.item}, {"m": comb(0.002)}, rate_hz=1000)
    rng = np.random.default_rng(5)
    rig.render(wall.at(0.002 + 2e-5 * rng.integers(-2, 3, 60_000), 0.00125))
    assert len(strikes_of(rig)) == 1


def test_the_way_through_the_air_arms_where_it_ends_away() -> None:
    """Landing half a spacing from the groove struck last, or more, it strikes; nearer, it was not away."""
    wall = Wall()
    for landing, strikes in ((0.0029, 2), (0.0034, 1)):
        rig = rig_of({"w": wall.item}, {"m": comb(0.002)}, rate_hz=1000)
        stroke = np.linspace(0.0035, 0.0043, 20)
        down = np.linspace(landing, landing + 0.0001, 3)
        s = np.concatenate([stroke, np.linspace(0.0043, landing, 20), down, np.linspace(landing, 0.0043, 20)])
        depth = np.concatenate([np.full(20, 0.001), np.full(20, -0.001), np.full(23, 0.001)])
        rig.render(wall.at(s, depth))
        assert len(strikes_of(rig)) == strikes


# ---- A hand at rest -------------------------------------------------------------------------------------------------

PAPER = comb(velocity_gain_per_s=1200.0)
GRIPS = {
    # Mass, stiffness and damping of the hand, friction of the device (N).
    "light": (0.005, 50.0, 0.5, 0.05),
    "light, device without friction": (0.005, 50.0, 2.0, 0.0),
    "default": (0.01, 300.0, 5.0, 0.05),
    "firm": (0.05, 1000.0, 10.0, 0.05),
    "firm, device without friction": (0.05, 1000.0, 10.0, 0.0),
}


def resting(grip: str, encoder_m: float, from_m: float, to_m: float) -> tuple[int, Floats, float]:
    """A minute of a hand that presses with 1 N, goes from one place to another at 1 cm/s and stays: how often it was
    struck, where the handle was in the last half minute, and the force at the end."""
    mass, stiffness, damping, friction = GRIPS[grip]
    hand = {"mass_kg": mass, "stiffness_n_per_m": stiffness, "damping_n_s_per_m": damping}
    sim = {"encoder_step_m": encoder_m, "coulomb_friction_n": friction, "hand": hand}
    config = {
        "device": {"sim": sim},
        "materials": {"m": PAPER},
        "scene": {"objects": {"w": Wall().item}},
    }
    deep = 1.0 / STIFFNESS + 1.0 / stiffness
    arrival = 1.05 + abs(to_m - from_m) / 0.01
    way = [[0, from_m, 0.001], [0.5, from_m, -deep], [1, from_m, -deep], [arrival, to_m, -deep], [60, to_m, -deep]]
    run = simulate_run(config, way, 60.0, 1000)
    assert run.truth is not None
    strikes = int(np.sum(run.events["kind"] == EventKind.GROOVE))
    return strikes, run.truth[30_000:, 0], float(run.samples["contact_force_n"][-1, 1])


@pytest.mark.long
@pytest.mark.parametrize("encoder_m", [0.0, 20e-6])
@pytest.mark.parametrize("grip", GRIPS)
def test_a_hand_at_rest_is_struck_once_at_most(grip: str, encoder_m: float) -> None:
    """Laid down on a groove and right beside it, and stopping on it, right before and right behind it.

    Friction holds a light hand up to c/k short of where it wants to be: then it stops somewhere near the groove."""
    _, stiffness, _, friction = GRIPS[grip]
    short = friction / stiffness
    ends = [(0.0, 0.0), (1e-5, 1e-5), (-1e-5, -1e-5)]
    ends += [(-0.0007, short * part + past) for part in (0.0, 0.5, 1.0) for past in (-2e-5, 0.0, 1e-5, 3e-4)]
    most = 0
    for from_m, to_m in ends:
        strikes, place, force = resting(grip, encoder_m, from_m, to_m)
        assert strikes <= 1, (from_m, to_m)
        assert np.ptp(place) <= 1e-6, "it has not come to rest"
        assert abs(place[-1] - to_m) <= short + 1e-6
        assert force == pytest.approx(1.0, abs=friction + 20e-6 * STIFFNESS)
        most = max(most, strikes)
    assert most == 1


# ---- Geometry and damping -------------------------------------------------------------------------------------------


class Profile:
    """h(s), a raised cosine of depth g and width w at each k spacing, and its slope."""

    def __init__(self, spacing: float, width: float, depth: float) -> None:
        self.spacing, self.width, self.depth = spacing, width, depth

    def __call__(self, s: npt.ArrayLike) -> tuple[Floats, Floats]:
        along = np.asarray(s, np.float64)
        x = along - np.rint(along / self.spacing) * self.spacing
        turn = 2 * np.pi / self.width
        inside = np.abs(x) < self.width / 2
        height = np.where(inside, self.depth / 2 * (1 + np.cos(turn * x)), 0.0)
        return height, np.where(inside, -self.depth / 2 * turn * np.sin(turn * x), 0.0)

    def steepest(self) -> float:
        return math.pi * self.depth / self.width

    def most_curved(self) -> float:
        return 2 * math.pi**2 * self.depth / self.width**2


def energy_force(depth: Floats, k: Floats, dk: Floats, h: Floats, dh: Floats) -> tuple[Floats, Floats]:
    """-grad(K/2 max(0, d - h)^2), along the normal (against d) and along s."""
    e = np.maximum(0.0, depth - h)
    return k * e, k * e * dh - dk / 2 * e**2


PROFILES = [Profile(0.002, 0.0005, 0.0003), Profile(0.0016, 0.0016, 0.0001), Profile(0.0064, 0.003, 0.001)]


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("angle", [0.0, 1.1, -2.4])
def test_geometry_is_the_gradient_of_its_energy(profile: Profile, angle: float) -> None:
    wall = Wall(angle, (0.013, -0.004))
    rig = rig_of({"w": wall.item}, {"m": shaped(profile.spacing, profile.width, profile.depth)})
    rig.render(wall.at(np.zeros(1), -0.001))
    rng = np.random.default_rng(2)
    s, depth = rng.uniform(-0.03, 0.03, 5000), rng.uniform(-0.0002, 0.002, 5000)
    samples = rig.render(wall.at(s, depth))
    h, dh = profile(s)
    wanted = energy_force(depth, np.full(5000, STIFFNESS), np.zeros(5000), h, dh)
    normal, tangent = wall.forces(samples)
    # s is known to 1e-17 m or so, and the tangential force changes with it by K e h''.
    np.testing.assert_allclose(normal, wanted[0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(tangent, wanted[1], rtol=0, atol=1e-12)
    assert np.any(wanted[1] > 0.01)
    assert not samples["vibration_force_n"].any()
    assert EventKind.GROOVE not in rig.kinds()


@pytest.mark.parametrize("profile", PROFILES)
def test_geometry_has_no_step(profile: Profile) -> None:
    """Along any way the force changes by no more than K (1 + h'^2 + e |h''|) a metre: the norm of the energy's Hessian,
    K [[1, -h'], [-h', h'^2 - e h'']], is bounded by that of its parts."""
    wall = Wall(0.3)
    rig = rig_of({"w": wall.item}, {"m": shaped(profile.spacing, profile.width, profile.depth)})
    deepest = 0.0015
    bound = STIFFNESS * (1 + profile.steepest() ** 2 + deepest * profile.most_curved())
    rng = np.random.default_rng(8)
    corners = np.column_stack([rng.uniform(-0.01, 0.01, 60), rng.uniform(-0.0003, deepest, 60)])
    way = np.concatenate([np.linspace(a, b, 2000) for a, b in pairwise(corners)])
    path = np.concatenate([wall.at([0.0] * 2, -0.001), wall.at(way[:, 0], way[:, 1])])
    force = rig.render(path)["contact_force_n"][1:]
    change, step = np.linalg.norm(np.diff(force, axis=0), axis=1), np.linalg.norm(np.diff(path[1:], axis=0), axis=1)
    assert np.all(change <= bound * step + 1e-13)
    assert np.any(change > 0.1 * bound * step + 1e-9)


@pytest.mark.parametrize("profile", PROFILES)
def test_damping_is_weighted_by_the_profile_and_has_no_step(profile: Profile) -> None:
    wall, drag, count = Wall(-0.8, (0.01, 0.0)), 7.0, 5000
    texture = {"kind": "grooves", "display": "damping", "spacing_m": profile.spacing, "width_m": profile.width}
    material = {"stiffness_n_per_m": STIFFNESS, "texture": {**texture, "damping_n_s_per_m": drag}}
    rig = rig_of({"w": wall.item}, {"m": material})
    rig.render(wall.at(np.zeros(1), -0.001))
    rng = np.random.default_rng(4)
    s, depth = rng.uniform(-0.03, 0.03, count), rng.uniform(-0.0005, 0.002, count)
    velocity = rng.uniform(-0.5, 0.5, (count, 2))
    normal, tangent = wall.forces(rig.render(wall.at(s, depth), velocity=velocity))
    weight = profile(s)[0] / profile.depth
    wanted = np.where(depth > 0, -drag * weight * (velocity @ wall.tangent), 0.0)
    np.testing.assert_allclose(tangent, wanted, rtol=0, atol=1e-12)
    np.testing.assert_allclose(normal, np.where(depth > 0, STIFFNESS * depth, 0.0), rtol=0, atol=1e-12)
    # At one speed the drag changes by no more than c v pi/w a metre, and it never drives.
    speed = 0.2
    s = np.linspace(-0.01, 0.01, 20_000)
    _, tangent = wall.forces(rig.render(wall.at(s, 0.001), velocity=np.tile(speed * wall.tangent, (len(s), 1))))
    assert np.abs(np.diff(tangent)).max() <= drag * speed * math.pi / profile.width * (s[1] - s[0]) + 1e-13
    assert tangent.max() <= 1e-15
    assert tangent.min() == pytest.approx(-drag * speed, rel=1e-3)


def work_around(
    rig: Rig, curve: Callable[[Floats], tuple[Floats, Floats]], corners: Sequence[float]
) -> tuple[float, float]:
    """The work of the contact force around a loop, and the sum of what comes and goes.

    `curve` gives positions and derivatives over u, shape (n, 2) each; between `corners` (of u, rising) it and the force
    are smooth, so that Gauss's quadrature is exact within rounding.
    """
    nodes, weights = np.polynomial.legendre.leggauss(24)
    cuts = np.array(corners)
    half = np.diff(cuts)[:, None] / 2
    u = (cuts[:-1, None] + half + half * nodes).ravel()
    position, slope = curve(u)
    before = np.tile(position[0], (300, 1))  # the contact's own ramp is over when the loop begins
    force = rig.render(np.concatenate([before, position]))["contact_force_n"][300:]
    power = np.sum(force * slope, axis=1) * (half * weights).ravel()
    return float(math.fsum(power)), float(math.fsum(np.abs(power)))


def polygon(wall: Wall, corners: Sequence[tuple[float, float]]) -> Callable[[Floats], tuple[Floats, Floats]]:
    """Closed, through (s, depth), a corner at each whole u."""
    points = np.array([*corners, corners[0]])

    def curve(u: Floats) -> tuple[Floats, Floats]:
        side = np.minimum(u.astype(int), len(corners) - 1)
        step = points[side + 1] - points[side]
        place = points[side] + (u - side)[:, None] * step
        return wall.at(place[:, 0], place[:, 1]), step[:, :1] * wall.tangent - step[:, 1:] * wall.normal

    return curve


def ellipse(
    wall: Wall, middle: tuple[float, float], axes: tuple[float, float]
) -> Callable[[Floats], tuple[Floats, Floats]]:
    def curve(u: Floats) -> tuple[Floats, Floats]:
        c, s = np.cos(u), np.sin(u)
        position = wall.at(middle[0] + axes[0] * c, middle[1] + axes[1] * s)
        return position, (-axes[0] * s)[:, None] * wall.tangent - (axes[1] * c)[:, None] * wall.normal

    return curve


def cuts_of(
    wall: Wall,
    curve: Callable[[Floats], tuple[Floats, Floats]],
    ends: Sequence[float],
    edges: Sequence[float],
    surface: Callable[[Floats], Floats],
) -> list[float]:
    """Where along a curve the force is not smooth: corners, edges of s, and where it leaves the surface."""

    def above(u: Floats) -> list[Floats]:
        offset = curve(u)[0] - wall.point
        along, depth = offset @ wall.tangent, -offset @ wall.normal
        return [*(along - edge for edge in edges), depth - surface(along)]

    grid = np.unique(np.concatenate([np.linspace(ends[0], ends[-1], 801), ends]))
    found = list(ends)
    for number, values in enumerate(above(grid)):
        found += grid[values == 0.0].tolist()
        for index in np.flatnonzero(values[:-1] * values[1:] < 0):
            found.append(
                brentq(
                    lambda u, n=number: float(above(np.array([u]))[n][0]),
                    grid[index],
                    grid[index + 1],
                    xtol=1e-16,
                    rtol=1e-15,
                )
            )
    found.sort()
    return [found[0]] + [b for a, b in pairwise(found) if b - a > 1e-12]


LOOPS = {
    "rectangle": ((-0.0011, 0.0003), (0.0012, 0.0003), (0.0012, 0.0013), (-0.0011, 0.0013)),
    "thin rectangle in a groove": ((-0.0001, 0.0004), (0.0002, 0.0004), (0.0002, 0.0005), (-0.0001, 0.0005)),
    "rectangle out of the surface": ((-0.0003, -0.0002), (0.0023, -0.0002), (0.0023, 0.0009), (-0.0003, 0.0009)),
    "triangle, partly out of a groove": ((-0.0002, 0.00005), (0.0004, 0.0001), (0.00011, 0.0008)),
}


@pytest.mark.parametrize("name", [*LOOPS, "ellipse", "ellipse out of the surface"])
def test_geometry_does_no_work_around_a_loop(name: str) -> None:
    profile, wall = Profile(0.002, 0.0005, 0.0003), Wall(0.6, (0.004, 0.002))
    rig = rig_of({"w": wall.item}, {"m": shaped(profile.spacing, profile.width, profile.depth)})
    if name in LOOPS:
        curve, ends = polygon(wall, LOOPS[name]), [float(i) for i in range(len(LOOPS[name]) + 1)]
    else:
        middle = (0.0013, 0.0009) if name == "ellipse" else (0.0001, 0.0001)
        curve, ends = ellipse(wall, middle, (0.0019, 0.0007)), [0.0, 2 * np.pi]
    edges = [k * profile.spacing + side * profile.width / 2 for k in range(-2, 4) for side in (-1, 1)]
    work, total = work_around(rig, curve, cuts_of(wall, curve, ends, edges, lambda s: profile(s)[0]))
    assert total > 1e-6
    assert abs(work) <= 1e-13 * total


def test_small_steps_around_a_loop_do_no_work_either() -> None:
    """The force at the middle of each step, as a sampled loop has it: the error falls with the square of the step."""
    profile, wall = Profile(0.002, 0.0005, 0.0003), Wall()
    curve = ellipse(wall, (0.0007, 0.0002), (0.0013, 0.0006))
    work = []
    for count in (1000, 10_000, 100_000):
        rig = rig_of({"w": wall.item}, {"m": shaped(profile.spacing, profile.width, profile.depth)})
        u = (np.arange(-1000, count) + 0.5) * 2 * np.pi / count
        position, slope = curve(u)
        force = rig.render(position)["contact_force_n"]
        work.append(abs(float(np.sum(force[1000:] * slope[1000:]) * 2 * np.pi / count)))
    assert work[1] <= work[0] / 30 + 1e-15
    assert work[2] <= work[1] / 30 + 1e-15
    assert work[2] <= 1e-11


# ---- Patches --------------------------------------------------------------------------------------------------------


def ramp(s: Floats, from_m: float, half: float) -> tuple[Floats, Floats]:
    """The weight of what begins at from_m, a smooth step over +-half, and its slope."""
    x = np.clip((s - (from_m - half)) / (2 * half), 0.0, 1.0)
    return x**2 * (3 - 2 * x), 6 * x * (1 - x) / (2 * half)


def of_pieces(s: Floats, values: Sequence[float], edges: Sequence[tuple[float, float]]) -> tuple[Floats, Floats]:
    """A parameter along a wall of pieces, with (from_m, half ramp) of each but the first, and its slope."""
    total, slope = np.full_like(s, values[0]), np.zeros_like(s)
    for before, after, edge in zip(values, values[1:], edges, strict=False):
        weight, rise = ramp(s, *edge)
        total += (after - before) * weight
        slope += (after - before) * rise
    return total, slope


UNIT = 2.0**-12
"""Spacings and edges are multiples of it, so that a groove lies on an edge to the last bit, or does not."""
SIDE_BY_SIDE = {
    "a": comb(7 * UNIT, frequency_hz=150.0, force_gain_m_per_s2_per_n=20.0),
    "b": comb(10 * UNIT, frequency_hz=270.0, force_gain_m_per_s2_per_n=70.0),
    "m": {"stiffness_n_per_m": STIFFNESS},
}


@pytest.mark.parametrize("speed", [0.013, 0.31, 1.9])
@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("edge", [41.5, 40.0, 49.0, 70.0])
def test_combs_side_by_side_strike_each_groove_once_with_its_own_mode(
    speed: float, direction: int, edge: float
) -> None:
    """Edges beside grooves, on one of b, of a, of both: a patch [from, to) has the one at from, not that at to."""
    low, middle, high = -21 * UNIT, edge * UNIT, 100 * UNIT
    patches = [{"from_m": low, "to_m": middle, "material": "a"}, {"from_m": middle, "to_m": high, "material": "b"}]
    wall = Wall(patches=patches)
    rig = rig_of({"w": wall.item}, SIDE_BY_SIDE, rate_hz=1000)
    s0, v = (-0.00613, speed) if direction > 0 else (0.0253, -speed)
    time = np.arange(math.ceil(0.0315 / speed * 1000)) / 1000
    samples = rig.render(wall.at(s0 + v * time, 0.001))
    rounding = 1e-12
    lines = {}
    for name, spacing, from_m, to_m in (("a", 7 * UNIT, low, middle), ("b", 10 * UNIT, middle, high)):
        times = passages(s0, v, spacing, 0.0, float(time[-1]))
        places = s0 + v * times
        lines[name] = times[(places >= from_m - rounding) & (places < to_m - rounding)]
    wanted = np.sort(np.concatenate(list(lines.values())))
    found = times_of(rig)
    assert len(found) == len(wanted)
    assert np.abs(found - wanted).max() <= 1e-9
    gains = np.where(np.isin(wanted, lines["a"]), 20.0, 70.0)
    amplitude = V_GAIN * speed + gains * STIFFNESS * 0.001
    np.testing.assert_allclose(strikes_of(rig)["amplitude_m_per_s2"], amplitude, rtol=1e-6)
    heard = np.zeros_like(time)
    for name, frequency, gain in (("a", 150.0, 20.0), ("b", 270.0, 70.0)):
        force = np.full(len(lines[name]), MASS_KG * (V_GAIN * speed + gain * STIFFNESS * 0.001))
        heard += ringing(time, lines[name], force, frequency)
    _, tangent = wall.forces(samples, "vibration_force_n")
    assert np.abs(tangent - direction * heard).max() <= 1e-9


def test_a_groove_of_the_same_number_beyond_an_edge_is_another_one() -> None:
    """Groove 5 lies at 8 mm on one side and at 9 mm on the other, and half a spacing is not left in between."""
    patches = [
        {"from_m": -0.02, "to_m": 0.0085, "material": "a"},
        {"from_m": 0.0085, "to_m": 0.03, "material": "b"},
    ]
    wall = Wall(patches=patches)
    rig = rig_of({"w": wall.item}, {**SIDE_BY_SIDE, "a": comb(0.0016), "b": comb(0.0018)}, rate_hz=1000)
    s = np.array([0.0077, 0.0084, 0.0086, 0.0093, 0.0083, 0.0077, 0.0095])
    rig.render(wall.at(s, 0.001))
    # 8, 9; back: 9 was not left, 8 again; and forth: 8 was not left, 9 again; all in one step the last time.
    struck = np.interp(times_of(rig) * 1000, np.arange(len(s)), s)
    np.testing.assert_allclose(struck, [0.008, 0.009, 0.008, 0.009], rtol=0, atol=1e-12)


PIECES = {
    # Three pieces: base, soft, base; then soft beside hard; then a patch narrower than its ramps.
    "one patch": ([(0.001, 0.004, "soft")], 0.001, ["base", "soft", "base"], [(0.001, 0.0005), (0.004, 0.0005)]),
    "two patches": (
        [(-0.002, 0.001, "hard"), (0.001, 0.0044, "soft")],
        0.0012,
        ["base", "hard", "soft", "base"],
        [(-0.002, 0.0006), (0.001, 0.0006), (0.0044, 0.0006)],
    ),
    "narrow patch": (
        [(0.0, 0.0004, "hard"), (0.0018, 0.004, "soft")],
        0.002,
        ["base", "hard", "base", "soft", "base"],
        [(0.0, 0.0002), (0.0004, 0.0002), (0.0018, 0.0007), (0.004, 0.001)],
    ),
}
STIFF = {"base": 800.0, "soft": 300.0, "hard": 1500.0}


@pytest.mark.long
@pytest.mark.parametrize("name", PIECES)
@pytest.mark.parametrize("grooved", [False, True])
def test_patches_go_over_into_each_other_by_the_formula_without_a_step_or_work(name: str, grooved: bool) -> None:
    given, ramp_m, order, edges = PIECES[name]
    patches = [{"from_m": a, "to_m": b, "material": material} for a, b, material in given]
    wall = Wall(0.5, (0.003, 0.001), patches=patches, patch_ramp_m=ramp_m, material="base")
    shapes = {
        "base": Profile(0.001, 0.0006, 0.0002),
        "soft": Profile(0.0013, 0.0013, 0.0001),
        "hard": Profile(0.0007, 0.0003, 0.00015),
    }
    materials = {
        key: shaped(shape.spacing, shape.width, shape.depth, STIFF[key])
        if grooved
        else {"stiffness_n_per_m": STIFF[key]}
        for key, shape in shapes.items()
    }
    rig = rig_of({"w": wall.item}, materials)

    def parameters(s: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        k, dk = of_pieces(s, [STIFF[key] for key in order], edges)
        h, dh = np.zeros_like(s), np.zeros_like(s)
        if grooved:
            h, dh = (part.copy() for part in shapes[order[0]](s))
            for before, after, edge in zip(order, order[1:], edges, strict=False):
                weight, rise = ramp(s, *edge)
                (h0, dh0), (h1, dh1) = shapes[before](s), shapes[after](s)
                h += weight * (h1 - h0)
                dh += weight * (dh1 - dh0) + rise * (h1 - h0)
        return k, dk, h, dh

    rig.render(wall.at(np.zeros(1), -0.001))
    rng = np.random.default_rng(6)
    s, depth = rng.uniform(-0.004, 0.007, 5000), rng.uniform(-0.0001, 0.0015, 5000)
    normal, tangent = wall.forces(rig.render(wall.at(s, depth)))
    wanted = energy_force(depth, *parameters(s))
    np.testing.assert_allclose(normal, wanted[0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(tangent, wanted[1], rtol=0, atol=2e-12)

    # The Hessian of K/2 (d - h)^2, term by term, with the largest of everything.
    narrow = min(half for _, half in edges)
    stiffest, steps = max(STIFF.values()), max(STIFF.values()) - min(STIFF.values())
    k1, k2 = 1.5 * steps / (2 * narrow), 6 * steps / (2 * narrow) ** 2
    rise1, rise2 = 1.5 / (2 * narrow), 6 / (2 * narrow) ** 2
    h1 = max(p.steepest() for p in shapes.values()) + rise1 * 0.0002 if grooved else 0.0
    h2 = max(p.most_curved() for p in shapes.values()) + rise2 * 0.0002 + 2 * rise1 * 2 * h1 if grooved else 0.0
    e = 0.0012
    bound = stiffest * (1 + h1**2 + e * h2) + 2 * k1 * e * (1 + h1) + k2 / 2 * e**2
    way = np.linspace(-0.004, 0.007, 200_001)
    force = rig.render(np.concatenate([wall.at([-0.004] * 300, e), wall.at(way, e)]))["contact_force_n"][300:]
    change = np.linalg.norm(np.diff(force, axis=0), axis=1)
    assert change.max() <= bound * (way[1] - way[0]) + 1e-12

    loop = polygon(wall, ((-0.0031, -0.0001), (0.0061, 0.0001), (0.0057, 0.0013), (-0.0027, 0.0008)))
    borders = [from_m + side * half for from_m, half in edges for side in (-1, 1)] + [from_m for from_m, _ in edges]
    if grooved:
        for shape in shapes.values():
            borders += [k * shape.spacing + side * shape.width / 2 for k in range(-6, 12) for side in (-1, 1)]
    corners = cuts_of(
        wall,
        loop,
        [0.0, 1.0, 2.0, 3.0, 4.0],
        [b for b in borders if -0.004 < b < 0.007],
        lambda s: parameters(s)[2],
    )
    work, total = work_around(rig, loop, corners)
    assert abs(work) <= 1e-12 * total


# ---- Discs, boxes, membranes ----------------------------------------------------------------------------------------

CENTER = np.array([0.011, -0.007])


def disc(radius: float) -> dict[str, object]:
    return {"kind": "disc", "center_m": CENTER.tolist(), "radius_m": radius, "material": "m"}


def around(radius: npt.ArrayLike, angle: npt.ArrayLike) -> Floats:
    """Points at angles (rad) from the top, clockwise."""
    a = np.asarray(angle, np.float64)
    return np.asarray(CENTER + np.asarray(radius, np.float64)[..., None] * np.column_stack([np.sin(a), np.cos(a)]))


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize(("spacing", "width"), [(0.002, 0.0005), (0.0013, 0.0013), (0.01 * math.pi / 10, 0.0002)])
@pytest.mark.parametrize("ticks", [1777, 23])
def test_a_turn_around_a_disc_strikes_each_groove_once(
    direction: int, spacing: float, width: float, ticks: int
) -> None:
    """Evenly around, many ticks a turn and few: each is struck once a turn, at its time, also one on the bottom."""
    radius, depth, rate = 0.005, 0.0004, 10_000
    rig = rig_of({"d": disc(radius)}, {"m": comb(spacing, width_m=width)}, rate_hz=rate)
    step = direction * 2 * np.pi / ticks
    start, turns = 0.0123 * direction, 3
    angle = start + step * np.arange(turns * ticks + 1)
    rig.render(around(radius - depth, angle))
    k = np.arange(-100, 101)
    places = k[np.abs(k) * spacing <= np.pi * radius * (1 + 1e-12)] * spacing / radius
    places = places[places > -np.pi * (1 - 1e-12)]  # where the first and the last meet, they are one
    once = np.sort(np.mod(direction * (places - start), 2 * np.pi))
    wanted = (once + 2 * np.pi * np.arange(turns)[:, None]).ravel() / abs(step) / rate
    found = times_of(rig)
    assert len(found) == len(wanted)
    assert np.abs(found - wanted).max() <= 1e-9
    events = strikes_of(rig)
    speed = (radius - depth) * math.sin(abs(step)) * rate  # the chord of a tick, along the tangent at its end
    np.testing.assert_allclose(events["speed_m_per_s"], direction * speed, rtol=1e-9)
    amplitude = V_GAIN * speed + F_GAIN * STIFFNESS * depth
    np.testing.assert_allclose(events["amplitude_m_per_s2"], amplitude, rtol=1e-9)


def test_strikes_on_a_disc_act_along_the_tangent_of_the_motion() -> None:
    radius = 0.005
    for direction in (1, -1):
        rig = rig_of({"d": disc(radius)}, {"m": comb(0.002)}, rate_hz=1000)
        angle = (0.002 / radius) + direction * np.array([-0.04, -0.02, 0.01, 0.02])
        samples = rig.render(around(np.full(4, radius - 0.0003), angle))
        (event,) = strikes_of(rig)
        assert event["tick"] == 2
        tangent = direction * np.array([math.cos(angle[2]), -math.sin(angle[2])])
        since = event["before_tick_s"]
        heard = MASS_KG * event["amplitude_m_per_s2"] * math.exp(-since / DECAY_S)
        heard *= math.sin(2 * np.pi * FREQUENCY_HZ * since)
        np.testing.assert_allclose(samples["vibration_force_n"][2], heard * tangent, rtol=1e-9)


def test_the_seam_of_a_disc_neither_strikes_nor_arms() -> None:
    """A groove 0.3 mm from the bottom, and a probe that swings over both: away is how far it is, not how s counts."""
    radius = 0.005
    spacing = (np.pi * radius - 0.0003) / 5
    rig = rig_of({"d": disc(radius)}, {"m": comb(spacing, width_m=0.0004)}, rate_hz=1000)
    time = np.arange(5000) / 1000
    angle = (5 * spacing + 0.0006 * np.sin(2 * np.pi * 3 * time + 0.5)) / radius
    rig.render(around(np.full(5000, radius - 0.0003), angle))
    assert len(strikes_of(rig)) == 1
    wide = (5 * spacing + 0.7 * spacing * np.sin(2 * np.pi * 3 * time + 0.5)) / radius
    rig = rig_of({"d": disc(radius)}, {"m": comb(spacing, width_m=0.0004)}, rate_hz=1000)
    rig.render(around(np.full(5000, radius - 0.0003), wide))
    # Its neighbour over the seam lies 0.6 mm away and is passed as well: two each way, but at the first.
    swings = 2 * 3 * 5
    assert len(strikes_of(rig)) == 2 * swings


@pytest.mark.parametrize("rounding", [-2e-16, 0.0, 2e-16])
def test_a_groove_on_the_bottom_of_a_disc_is_one_groove(rounding: float) -> None:
    """Twelve grooves all around: that on the bottom, where s starts again, has strikes, an arm and a shape as any."""
    spacing, depth = 0.0016, 0.0004
    radius = 6 * spacing / np.pi * (1 + rounding)
    for direction in (1, -1):
        rig = rig_of({"d": disc(radius)}, {"m": comb(spacing)}, rate_hz=1000)
        rig.render(around(np.full(40, radius - depth), np.pi + direction * np.linspace(-0.2, 0.2, 40)))
        assert len(strikes_of(rig)) == 1
        # Back to it and held on it, never half a spacing away.
        rest = np.pi + direction * np.append(np.linspace(0.2, 0.0, 20), 1e-4 * np.cos(np.arange(1000.0)))
        rig.render(around(np.full(1020, radius - depth), rest))
        assert len(strikes_of(rig)) == 0
    profile = Profile(spacing, 0.0008, 0.0002)
    rig = rig_of({"d": disc(radius)}, {"m": shaped(profile.spacing, profile.width, profile.depth)})
    angle = np.linspace(np.pi - 0.3, np.pi + 0.3, 601)
    path = around(np.full(601, radius - depth), angle)
    force = rig.render(np.concatenate([path[:1]] * 300 + [path]))["contact_force_n"][300:]
    h, dh = profile(radius * (angle - np.pi))
    outward = np.column_stack([np.sin(angle), np.cos(angle)])
    clockwise = np.column_stack([np.cos(angle), -np.sin(angle)])
    e = (STIFFNESS * (depth - h))[:, None]
    wanted = e * outward + e * (dh * radius / (radius - depth))[:, None] * clockwise
    np.testing.assert_allclose(force, wanted, rtol=0, atol=1e-10)


def test_geometry_of_a_disc_is_the_gradient_of_its_energy_and_does_no_work() -> None:
    radius, profile = 0.005, Profile(0.002, 0.0008, 0.0002)
    rig = rig_of({"d": disc(radius)}, {"m": shaped(profile.spacing, profile.width, profile.depth)})
    rig.render(around(np.array([0.006]), np.array([0.0])))
    rng = np.random.default_rng(12)
    angle = np.cumsum(rng.uniform(-0.1, 0.1, 3000))
    r = radius - rng.uniform(0.0001, 0.0012, 3000)
    force = rig.render(np.concatenate([around(r[:1], angle[:1])] * 300 + [around(r, angle)]))["contact_force_n"][300:]
    s = radius * (np.mod(angle + np.pi, 2 * np.pi) - np.pi)
    h, dh = profile(s)
    whole = np.abs(np.rint(s / profile.spacing)) * profile.spacing + profile.width / 2 <= np.pi * radius
    h, dh = h * whole, dh * whole
    e = np.maximum(0.0, radius - r - h)
    outward = np.column_stack([np.sin(angle), np.cos(angle)])
    clockwise = np.column_stack([np.cos(angle), -np.sin(angle)])
    # U = K/2 e^2, s = R angle: the tangential part is -dU/(r dangle) = K e h' R/r.
    wanted = (STIFFNESS * e)[:, None] * outward + (STIFFNESS * e * dh * radius / r)[:, None] * clockwise
    np.testing.assert_allclose(force, wanted, rtol=0, atol=1e-11)

    deep, shallow, first, last = 0.0039, 0.00485, -0.11, 0.53
    borders = [(k * profile.spacing + x * profile.width / 2) / radius for k in range(3) for x in (-1, 1)]
    across = sorted({first, last, *(b for b in borders if first < b < last)})
    shown = float(profile(np.array([radius * last]))[0][0])
    assert shown == 0.0  # the radial sides stay clear of the grooves
    crossing = profile.width / (2 * np.pi * radius) * math.acos(2 * (radius - shallow) / profile.depth - 1)
    surface = [k * profile.spacing / radius + x * crossing for k in range(3) for x in (-1, 1)]
    corners = [
        *across,
        last + 1.0,
        *(last + 1 + (last - b) for b in sorted({*across, *surface}, reverse=True) if first <= b <= last),
    ]
    corners = sorted({*corners, 2 * last + 1 - first, 2 * last + 2 - first})

    def curve(u: Floats) -> tuple[Floats, Floats]:
        side = np.digitize(u, [last, last + 1.0, 2 * last + 1 - first])
        a = np.choose(side, [u, np.full_like(u, last), 2 * last + 1 - u, np.full_like(u, first)])
        rise = shallow - deep
        far = np.choose(side, [deep, deep + (u - last) * rise, shallow, shallow - (u - (2 * last + 1 - first)) * rise])
        turn, out = np.choose(side, [1.0, 0.0, -1.0, 0.0]) * np.ones_like(u), np.choose(side, [0.0, rise, 0.0, -rise])
        radial, tangent = np.column_stack([np.sin(a), np.cos(a)]), np.column_stack([np.cos(a), -np.sin(a)])
        return around(far, a), (turn * far)[:, None] * tangent + (out * np.ones_like(u))[:, None] * radial

    work, total = work_around(rig, curve, corners)
    assert total > 1e-5
    assert abs(work) <= 1e-12 * total


@pytest.mark.parametrize("angle", [0.0, 0.6])
@pytest.mark.parametrize("face", [0, 1, 2, 3])
def test_grooves_of_a_box_count_from_the_middle_of_each_face(face: int, angle: float) -> None:
    """Clockwise over the face, in from the air at one end and over the edge at the other."""
    box = {"kind": "box", "center_m": CENTER.tolist(), "size_m": [0.02, 0.012], "angle_rad": angle, "material": "m"}
    long, thick = (0.01, 0.006) if face % 2 == 0 else (0.006, 0.01)
    rig = rig_of({"b": box}, {"m": comb(0.0016)}, rate_hz=1000)
    turned = angle - face * np.pi / 2
    normal, tangent = np.array([-np.sin(turned), np.cos(turned)]), np.array([np.cos(turned), np.sin(turned)])
    for direction in (1, -1):
        speed, s0, d0, sink = 0.43 * direction, -direction * (long + 0.0007), -0.001, 0.12
        time = np.arange(round((2 * long + 0.0025) / 0.43 * 1000)) / 1000
        height = thick - d0 - sink * time
        tick0 = int(rig.render([CENTER + (long + 0.05) * tangent + (thick + 0.05) * normal])["tick"][0]) + 1
        rig.render(CENTER + (s0 + speed * time)[:, None] * tangent + height[:, None] * normal)
        onset, edge = -d0 / sink, (long - direction * s0) / abs(speed)
        assert edge < time[-1]
        wanted = passages(s0, speed, 0.0016, onset, edge)
        found = times_of(rig) - tick0 / 1000
        assert len(wanted) > 4
        assert len(found) == len(wanted)
        assert np.abs(found - wanted).max() <= 1e-9
        force = STIFFNESS * (d0 + sink * wanted)
        np.testing.assert_allclose(strikes_of(rig)["amplitude_m_per_s2"], V_GAIN * 0.43 + F_GAIN * force, rtol=1e-6)
        np.testing.assert_allclose(strikes_of(rig)["speed_m_per_s"], speed, rtol=1e-6)


@pytest.mark.parametrize("side", [1, -1])
def test_a_membrane_has_its_grooves_from_either_side(side: int) -> None:
    """s, and the sign of the speed along it, are those of the membrane's own normal, whichever side presses."""
    skin = {"kind": "membrane", "center_m": CENTER.tolist(), "normal": [0.6, 0.8], "width_m": 0.02, "material": "m"}
    normal, tangent = np.array([0.6, 0.8]), np.array([0.8, -0.6])
    for v in (0.21, -0.21):
        rig = rig_of({"k": skin}, {"m": comb(0.0016)}, rate_hz=1000)
        time = np.arange(70) / 1000
        s0, sink = -0.0071 * np.sign(v), 0.05
        height = side * (0.0004 - sink * time)
        samples = rig.render(CENTER + (s0 + v * time)[:, None] * tangent + height[:, None] * normal)
        wanted = passages(s0, v, 0.0016, 0.008, float(time[-1]))
        np.testing.assert_allclose(times_of(rig), wanted, rtol=0, atol=1e-9)
        np.testing.assert_allclose(strikes_of(rig)["speed_m_per_s"], v, rtol=1e-6)
        amplitude = V_GAIN * 0.21 + F_GAIN * STIFFNESS * sink * (wanted - 0.008)
        np.testing.assert_allclose(strikes_of(rig)["amplitude_m_per_s2"], amplitude, rtol=1e-6)
        heard = np.sign(v) * ringing(time, wanted, MASS_KG * amplitude)
        assert np.abs(samples["vibration_force_n"] - heard[:, None] * tangent).max() <= 1e-9


@pytest.mark.parametrize("side", [1, -1])
def test_geometry_of_a_membrane_and_a_box_is_that_of_a_wall(side: int) -> None:
    profile = Profile(0.002, 0.0009, 0.0002)
    material = shaped(profile.spacing, profile.width, profile.depth)
    skin = {"kind": "membrane", "center_m": [0, 0], "normal": [0, 1], "width_m": 0.02, "material": "m"}
    box = {"kind": "box", "center_m": [0, -0.005 * side], "size_m": [0.02, 0.01], "material": "m"}
    s = np.linspace(-0.009, 0.009, 3001)
    for item in (skin, box):
        rig = rig_of({"o": item}, {"m": material})
        path = np.column_stack([s, np.full_like(s, -side * 0.0007)])
        force = rig.render(np.concatenate([[[s[0], side * 0.0001]], path]))["contact_force_n"][1:]
        h, dh = profile(s)
        np.testing.assert_allclose(force[:, 1], side * STIFFNESS * (0.0007 - h), rtol=0, atol=1e-12)
        np.testing.assert_allclose(force[:, 0], STIFFNESS * (0.0007 - h) * dh, rtol=0, atol=1e-12)


# ---- Hot updates ----------------------------------------------------------------------------------------------------


def test_stiffness_that_changes_a_thousand_times_a_second_leaves_the_strikes_where_they_are() -> None:
    wall, spacing, speed = Wall(0.3), 0.0007, 0.117
    rig = rig_of({"w": wall.item}, {"m": comb(spacing)}, rate_hz=1000)
    time = np.arange(400) / 1000
    path = wall.at(-0.00321 + speed * time, 0.001)
    rng = np.random.default_rng(9)
    found, amplitudes = [], []
    for index in range(len(time)):
        if index:
            rig.update({}, {"m": comb(spacing, stiffness_n_per_m=float(rng.uniform(400, 1200)))})
        rig.render(path[index : index + 1])
        found += times_of(rig).tolist()
        amplitudes += strikes_of(rig)["amplitude_m_per_s2"].tolist()
    wanted = passages(-0.00321, speed, spacing, 0.0, float(time[-1]))
    assert len(found) == len(wanted)
    assert np.abs(np.array(found) - wanted).max() <= 1e-9
    assert V_GAIN * speed + F_GAIN * 0.4 < min(amplitudes)
    assert max(amplitudes) < V_GAIN * speed + F_GAIN * 1.2


@pytest.mark.parametrize("ramp_s", [0.001, 0.0031, 0.02])
def test_a_wall_that_is_moved_along_itself_under_the_hand_strikes_nothing(ramp_s: float) -> None:
    wall = Wall()
    rig = rig_of({"w": wall.item}, {"m": comb(0.002)}, rate_hz=1000, ramp_s=ramp_s)
    place = np.array([[0.0003, -0.001]])
    rig.render(np.repeat(place, 50, axis=0))
    for shift in (0.01, 0.0101, -0.02, 0.0, 0.0009):
        rig.update({"w": {**wall.item, "point_m": [shift, 0]}})
        rig.render(np.repeat(place, 100, axis=0))
        assert EventKind.GROOVE not in rig.kinds()
    # The grooves went with it: they count from where it is now.
    time = np.arange(1, 101) / 1000
    rig.render(np.column_stack([0.0003 + 0.05 * time, np.full(100, -0.001)]))
    wanted = passages(0.0003 - 0.0009, 0.05, 0.002, 0.0, 0.1) + (50 + 5 * 100 - 1) / 1000
    np.testing.assert_allclose(times_of(rig), wanted, rtol=0, atol=1e-9)


def test_a_changed_frequency_is_that_of_the_next_strike_and_what_rings_goes_on() -> None:
    wall = Wall()
    rig = rig_of({"w": wall.item}, {"m": comb(0.002, decay_time_s=0.01)}, rate_hz=1000)
    time = np.arange(70) / 1000
    path = wall.at(-0.0005 + 0.1 * time, 0.001)
    first = rig.render(path[:10])
    rig.update({}, {"m": comb(0.002, decay_time_s=0.01, frequency_hz=310.0)})
    second = rig.render(path[10:])
    struck = passages(-0.0005, 0.1, 0.002, 0.0, float(time[-1]))
    force = np.full(len(struck), MASS_KG * (V_GAIN * 0.1 + F_GAIN * STIFFNESS * 0.001))
    heard = np.concatenate([first, second])["vibration_force_n"][:, 0]
    wanted = ringing(time, struck[:1], force[:1], 200.0, 0.01) + ringing(time, struck[1:], force[1:], 310.0, 0.01)
    assert np.abs(heard - wanted).max() <= 1e-9
    assert struck[0] < 0.009 < struck[1]


def test_other_grooves_under_a_resting_hand_strike_nothing() -> None:
    wall = Wall()
    rig = rig_of({"w": wall.item}, {"m": comb(0.002)}, rate_hz=1000)
    rig.render(wall.at(np.linspace(0.0095, 0.01001, 30), 0.001))
    assert len(strikes_of(rig)) == 1
    rng = np.random.default_rng(1)
    for spacing in (0.001, 0.0025, 0.00125, 0.002):
        rig.update({}, {"m": comb(spacing)})  # there is a groove at 10 mm in each of them
        rig.render(wall.at(0.01 + 2e-5 * rng.integers(-1, 2, 200), 0.001))
        assert EventKind.GROOVE not in rig.kinds()


def test_a_smooth_disc_that_becomes_a_comb_under_the_hand_strikes_nothing() -> None:
    radius = 0.005
    rig = rig_of({"d": disc(radius)}, {"m": {"stiffness_n_per_m": STIFFNESS}}, rate_hz=1000)
    place = around(np.full(100, radius - 0.001), np.full(100, 1.9))
    rig.render(place)
    friction = {"coefficient": 0.5}
    rig.update({}, {"m": {**comb(0.002), "friction": friction}})
    samples = rig.render(place)
    assert EventKind.GROOVE not in rig.kinds()
    # Nor does friction pull: it sticks where the probe is.
    outward = place - CENTER
    along = samples["contact_force_n"][:, 0] * outward[:, 1] - samples["contact_force_n"][:, 1] * outward[:, 0]
    assert np.abs(along).max() <= 1e-15


def test_strikes_of_an_object_go_on_counting_through_updates_of_it_and_of_others() -> None:
    wall = Wall()
    rig = rig_of({"w": wall.item}, {"m": comb(0.002)}, rate_hz=1000)
    time = np.arange(200) / 1000
    path = wall.at(0.0003 + 0.1 * time, 0.001)
    values = []
    for part in range(20):
        other = Wall(2.0, (0.2, 0.1)).item if part % 2 else None
        if part:
            rig.update({"far": other, "w": {**wall.item}} if "far" in rig.config.scene.objects or other else {})
        rig.render(path[10 * part : 10 * part + 10])
        values += strikes_of(rig)["value"].tolist()
    assert values == list(range(1, len(passages(0.0003, 0.1, 0.002, 0.0, 0.199)) + 1))


def test_strikes_of_a_tick_are_bounded_whatever_the_patches() -> None:
    """100 mm in a tick, over 10 patches of 900 grooves each."""
    wall = Wall()
    patches = [{"from_m": 0.01 * n, "to_m": 0.01 * n + 0.009, "material": "fine"} for n in range(10)]
    item = {**wall.item, "patches": patches, "patch_ramp_m": 1e-5}
    rig = rig_of({"w": item}, {"m": comb(0.5), "fine": comb(1e-5)}, rate_hz=1000)
    rig.render(wall.at(np.full(30, -0.001), 0.001))
    rig.render(wall.at(np.linspace(-0.001, 0.1, 2), 0.001))
    rig.render(wall.at(np.array([0.1, 0.0985]), 0.001))
    most = int(max(rig.of(EventKind.GROOVE)["value"]))
    assert 1024 < most <= 2 * 1024
