"""The simulated joystick against closed forms, in 40 digits where rounding matters (mpmath)."""

import itertools
import math
import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import mpmath
import numpy as np
import pytest
from mpmath import mp, mpf

from hapticd.base.core import CData, Interpolation, ffi, invalid_reason, lib

mp.dps = 40

PERIOD_S = 1e-4
Waypoints = Sequence[tuple[float, float, float]]


@dataclass(frozen=True)
class Device:
    """The fields of hd_sim_config that a test sets; the rest of the device is ideal."""

    handle_mass_kg: float = 0.04
    handle_damping_n_s_per_m: float = 0.0
    coulomb_friction_n: float = 0.0
    encoder_step_m: float = 0.0
    max_force_n: float = 8.9
    force_step_n: float = 0.0
    report_interval_s: float = 0.0
    report_delay_s: float = 0.0
    force_interval_s: float = 0.0
    force_intervals: int = 0
    workspace_m: float = 0.075
    force_timeout_s: float = 1000.0
    hand_mass_kg: float = 0.01
    hand_stiffness_n_per_m: float = 0.0
    hand_damping_n_s_per_m: float = 0.0
    start_m: tuple[float, float] = (0.0, 0.0)

    @property
    def mass_kg(self) -> float:
        return self.handle_mass_kg + self.hand_mass_kg


class Joystick:
    def __init__(self, device: Device, period_s: float = PERIOD_S) -> None:
        config = ffi.new("struct hd_sim_config *", vars(device))
        made = lib.hd_sim_new(config, period_s)
        if made == ffi.NULL:
            raise ValueError(invalid_reason())
        self.sim = ffi.gc(made, lib.hd_sim_free)
        self.path: CData | None = None

    def operate(self, waypoints: Waypoints, interpolation: Interpolation = Interpolation.LINEAR) -> None:
        self.path = new_path(waypoints, interpolation)
        lib.hd_sim_operate(self.sim, self.path)

    def settle(self) -> None:
        lib.hd_sim_settle(self.sim)

    def put(self, x_n: float, y_n: float = 0.0) -> None:
        lib.hd_sim_put(self.sim, ffi.new("double[2]", [x_n, y_n]))

    def advance(self, periods: int = 1) -> None:
        lib.hd_sim_advance(self.sim, periods)

    def truth(self) -> tuple[list[float], list[float], list[float]]:
        position, velocity, force = (ffi.new("double[2]") for _ in range(3))
        lib.hd_sim_truth(self.sim, position, velocity, force)
        return list(position), list(velocity), list(force)

    @property
    def x(self) -> float:
        return self.truth()[0][0]

    @property
    def v(self) -> float:
        return self.truth()[1][0]

    @property
    def force(self) -> list[float]:
        return self.truth()[2]

    def read(self) -> tuple[list[float], float, list[float]]:
        reading = ffi.new("struct hd_reading *")
        lib.hd_sim_read(self.sim, reading)
        return list(reading.position_m), reading.interval_s, list(reading.true_velocity_m_per_s)


def new_path(waypoints: Waypoints, interpolation: Interpolation = Interpolation.LINEAR) -> CData:
    flat = ffi.new("double[]", [float(number) for waypoint in waypoints for number in waypoint])
    made = lib.hd_operator_new(flat, len(waypoints), interpolation)
    if made == ffi.NULL:
        raise ValueError(invalid_reason())
    return ffi.gc(made, lib.hd_operator_free)


# ---- references ------------------------------------------------------------------------------------------

MINIMUM_JERK = {3: 10, 4: -15, 5: 6}
STRAIGHT = {1: 1}
REST: dict[int, int] = {}


def propagated(
    device: Device,
    x: mpf,
    v: mpf,
    force_n: mpf,
    reference: tuple[mpf, mpf, mpf, dict[int, int]],
    begin_s: mpf,
    end_s: mpf,
) -> tuple[mpf, mpf]:
    """Position and velocity at end_s: the matrix exponential of handle, hand and the reference's derivatives.

    The reference is from + travel * shape(t/duration); begin_s and end_s count from the segment's start.
    """
    start, travel, duration, shape = reference
    derivatives = []
    for order in range(7):
        value = mpf(0)
        for power, factor in shape.items():
            if power >= order:
                falling = mpmath.factorial(power) / mpmath.factorial(power - order)
                value += factor * falling * (begin_s / duration) ** (power - order) / duration**order
        derivatives.append(travel * value + (start if order == 0 else 0))
    mass, k = mpf(device.mass_kg), mpf(device.hand_stiffness_n_per_m)
    grip = mpf(device.hand_damping_n_s_per_m)
    system = mpmath.zeros(10)  # x, v, reference and its derivatives 1 to 6, constant force
    system[0, 1] = 1
    system[1, 0] = -k / mass
    system[1, 1] = -(mpf(device.handle_damping_n_s_per_m) + grip) / mass
    system[1, 2] = k / mass
    system[1, 3] = grip / mass
    system[1, 9] = force_n / mass
    for order in range(6):
        system[2 + order, 3 + order] = 1
    state = mpmath.matrix([x, v, *derivatives, 1])
    after = mpmath.expm(system * (end_s - begin_s), method="taylor") * state
    return after[0], after[1]


def followed(
    device: Device, waypoints: Waypoints, shape: dict[int, int], force_n: float, times_s: Sequence[mpf]
) -> Iterator[tuple[mpf, mpf]]:
    """The x axis at rising times, for a handle that starts at rest at start_m with the reference there."""
    x, v, now = mpf(device.start_m[0]), mpf(0), mpf(0)
    legs = []
    from_s, from_m = mpf(0), x
    for t_s, x_m, _ in waypoints:
        if t_s > 0:
            duration = mpf(t_s) - from_s
            legs.append((from_s, mpf(t_s), (from_m, mpf(x_m) - from_m, duration, shape)))
        from_s, from_m = mpf(t_s), mpf(x_m)
    legs.append((from_s, mpmath.inf, (from_m, mpf(0), mpf(1), REST)))
    pending = iter(legs)
    begin, end, reference = next(pending)
    for time_s in times_s:
        while end < time_s:
            x, v = propagated(device, x, v, mpf(force_n), reference, now - begin, end - begin)
            now = end
            begin, end, reference = next(pending)
        x, v = propagated(device, x, v, mpf(force_n), reference, now - begin, time_s - begin)
        now = time_s
        yield x, v


HANDS = {
    "firm grip": Device(hand_stiffness_n_per_m=300, hand_damping_n_s_per_m=5, handle_damping_n_s_per_m=0.2),
    "undamped": Device(hand_stiffness_n_per_m=800),
    "critical": Device(handle_mass_kg=0.25, hand_mass_kg=0, hand_stiffness_n_per_m=400, hand_damping_n_s_per_m=20),
    "overdamped": Device(hand_stiffness_n_per_m=100, hand_damping_n_s_per_m=40, handle_damping_n_s_per_m=1),
    "viscous hand": Device(hand_damping_n_s_per_m=3, handle_damping_n_s_per_m=0.5),
    "no hand": Device(hand_mass_kg=0, handle_damping_n_s_per_m=0.5),
    "free": Device(hand_mass_kg=0),
    "weak spring": Device(hand_stiffness_n_per_m=1e-6, hand_damping_n_s_per_m=1),
    "stiff and light": Device(
        handle_mass_kg=0.002, hand_mass_kg=0, hand_stiffness_n_per_m=9e4, hand_damping_n_s_per_m=30
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("period_s", [1e-4, 1e-3])
@pytest.mark.parametrize("hand", HANDS)
@pytest.mark.parametrize(
    ("interpolation", "shape"),
    [(Interpolation.LINEAR, STRAIGHT), (Interpolation.MINIMUM_JERK, MINIMUM_JERK)],
    ids=["linear", "minimum_jerk"],
)
def test_follows_the_hand_and_a_force(
    hand: str, interpolation: Interpolation, shape: dict[int, int], period_s: float
) -> None:
    device = replace(HANDS[hand], workspace_m=1000)
    # Waypoints on no tick, a short one among them, one at the very start, and rest at the end.
    waypoints = [(0, 0.01, 0), (0.01234567, 0.03, 0), (0.0125, 0.031, 0), (0.04, -0.02, 0)]
    joystick = Joystick(device, period_s)
    joystick.operate(waypoints, interpolation)
    joystick.put(0.7)
    ticks = [10, 20, 30, 100] if period_s == 1e-3 else [1, 100, 130, 400, 1000]
    times = [mpf(period_s) * tick for tick in ticks]
    done = 0
    largest, fastest = mpf(0.03), mpf(0.1)
    for tick, (x, v) in zip(ticks, followed(device, waypoints, shape, 0.7, times), strict=True):
        for _ in range(tick - done):
            joystick.advance()
        done = tick
        largest, fastest = max(largest, abs(x)), max(fastest, abs(v))
        assert abs(joystick.x - x) < 1e-12 * largest
        assert abs(joystick.v - v) < 1e-12 * fastest


@pytest.mark.parametrize("hand", HANDS)
def test_an_equilibrium_is_kept_to_the_last_bits(hand: str) -> None:
    device = replace(HANDS[hand], start_m=(0.0123, -0.031))
    joystick = Joystick(device)
    for _ in range(5000):
        joystick.advance()
    assert joystick.truth()[:2] == ([0.0123, -0.031], [0.0, 0.0])
    if device.hand_stiffness_n_per_m >= 100:
        device = replace(device, handle_damping_n_s_per_m=50, start_m=(0.0, 0.0))
        joystick = Joystick(device)
        joystick.put(0.5)
        joystick.advance(1_000_000)
        # It creeps until a step adds less than half of the last bit: within ulp/2 * B/(k h) of the goal.
        assert joystick.x == pytest.approx(0.5 / device.hand_stiffness_n_per_m, abs=1e-14)


EVENTFUL = Device(
    coulomb_friction_n=0.3,
    handle_damping_n_s_per_m=0.2,
    hand_stiffness_n_per_m=300,
    hand_damping_n_s_per_m=1,
    workspace_m=0.04,
)
TOUR = [
    (0.0101, 0.03, 0.01),
    (0.0502, -0.06, 0.011),
    (0.1303, 0.06, 0.012),
    (0.1404, 0.0, 0.04),
    (0.2, 0.0, 0.0),
]


@pytest.mark.parametrize("interpolation", list(Interpolation))
@pytest.mark.parametrize("friction", [0.0, 0.3, 2.0])
def test_the_period_does_not_matter(interpolation: Interpolation, friction: float) -> None:
    """Stick, slip and stops fall into periods of any length; the motion is the same."""
    traces = []
    for period_s, chunk in ((1e-3, 1), (1e-4, 10), (1e-4, 1), (2.5e-5, 1), (1e-3 / 7, 1)):
        joystick = Joystick(replace(EVENTFUL, coulomb_friction_n=friction), period_s)
        joystick.operate(TOUR, interpolation)
        every = round(1e-3 / period_s / chunk)
        trace = []
        for _ in range(300):
            for _ in range(every):
                joystick.advance(chunk)
            position, velocity, _ = joystick.truth()
            trace.append(position + velocity)
        traces.append(trace)
    reference = np.array(traces[0])
    assert np.abs(reference[:, 0]).max() == 0.04  # it met the stops
    for trace in traces[1:]:
        np.testing.assert_allclose(np.array(trace)[:, :2], reference[:, :2], rtol=0, atol=4e-14)
        np.testing.assert_allclose(np.array(trace)[:, 2:], reference[:, 2:], rtol=0, atol=4e-12)


@pytest.mark.parametrize("delay_s", [0.0, 0.00033])
@pytest.mark.parametrize("interval_s", [0.0, 0.001, 0.0007])
@pytest.mark.parametrize("chunk", [7, 500, 4000])
def test_many_periods_at_once(chunk: int, interval_s: float, delay_s: float) -> None:
    device = replace(EVENTFUL, report_interval_s=interval_s, report_delay_s=delay_s, force_timeout_s=0.15003)
    one, many = Joystick(device), Joystick(device)
    for joystick in (one, many):
        joystick.operate(TOUR)
        joystick.put(0.4, 0.1)
    for _ in range(4000 // chunk):
        for _ in range(chunk):
            one.advance()
        many.advance(chunk)
        assert many.x == pytest.approx(one.x, abs=1e-13)
        assert many.v == pytest.approx(one.v, abs=1e-11)
        expected, got = one.read(), many.read()
        assert got[0] == pytest.approx(expected[0], abs=1e-13)
        assert got[1] == expected[1]
        assert got[2] == pytest.approx(expected[2], abs=1e-11)


# ---- friction --------------------------------------------------------------------------------------------


def test_friction_alone_stops_a_block_where_its_energy_is_spent() -> None:
    device = Device(hand_mass_kg=0.0, handle_mass_kg=0.05, coulomb_friction_n=0.1)
    joystick = Joystick(device)
    joystick.put(0.6)
    joystick.advance(100)
    x, v = joystick.x, joystick.v
    assert v == pytest.approx((0.6 - 0.1) / 0.05 * 0.01, rel=1e-13)
    joystick.put(0.0)
    joystick.advance(499)
    assert joystick.v > 0
    for _ in range(2):
        joystick.advance()
    rest = joystick.x
    assert joystick.v == 0
    assert rest == pytest.approx(x + v * v / (2 * 0.1 / 0.05), rel=1e-13)
    joystick.advance(100_000)
    assert (joystick.x, joystick.v) == (rest, 0.0)


def test_friction_and_damping_stop_a_block_in_time() -> None:
    """M v' = -b v - c: the way to rest is M v/b - M c/b^2 ln(1 + b v/c)."""
    device = Device(coulomb_friction_n=0.1, handle_damping_n_s_per_m=0.8, workspace_m=10)
    joystick = Joystick(device)
    joystick.put(5.0)
    joystick.advance(300)
    joystick.put(0.0)
    x, v = joystick.x, joystick.v
    joystick.advance(1)
    joystick.advance(50_000)
    b, c, m = 0.8, 0.1, 0.05
    assert joystick.v == 0
    assert joystick.x - x == pytest.approx(m * v / b - m * c / b**2 * math.log1p(b * v / c), rel=1e-12)


def test_an_oscillation_under_friction_loses_the_same_at_every_turn() -> None:
    k, c, start = 500.0, 0.7, 0.05
    device = Device(coulomb_friction_n=c, hand_stiffness_n_per_m=k, start_m=(start, 0.0))
    joystick = Joystick(device)
    joystick.operate([(0, 0, 0)])
    turns = math.ceil((start * k / c - 1) / 2)
    half_s = math.pi * math.sqrt(device.mass_kg / k)
    ticks = 0
    for turn in range(1, turns + 1):
        # To just before the turn: where the cosine about the displaced equilibrium is.
        until = math.floor(turn * half_s / PERIOD_S)
        joystick.advance(until - ticks)
        ticks = until
        amplitude = start - (2 * turn - 1) * c / k
        phase = math.pi * (until * PERIOD_S / half_s - (turn - 1))
        sign = -1 if turn % 2 else 1
        centre = -sign * c / k
        assert joystick.x == pytest.approx(centre - sign * amplitude * math.cos(phase), abs=1e-14)
    joystick.advance(100)
    assert joystick.v == 0
    assert joystick.x == pytest.approx((-1) ** turns * (start - 2 * turns * c / k), abs=1e-14)
    rest = joystick.x
    joystick.advance(1_000_000)
    assert (joystick.x, joystick.v) == (rest, 0.0)


@pytest.mark.parametrize("force", [0.2, -0.2, 0.19999, 0.0])
def test_friction_holds_what_it_can(force: float) -> None:
    joystick = Joystick(Device(coulomb_friction_n=0.2))
    joystick.put(force)
    for _ in range(1000):
        joystick.advance()
    joystick.advance(1000)
    assert (joystick.x, joystick.v) == (0.0, 0.0)
    joystick.put(math.nextafter(0.2, 1))
    joystick.advance()
    assert joystick.x >= 0
    joystick.put(0.3)
    joystick.advance(10)
    assert joystick.v == pytest.approx(0.1 / 0.05 * 1e-3, rel=1e-9)


@pytest.mark.long
def test_a_resting_handle_breaks_away_in_time() -> None:
    """The reference leaves at speed u: k u t + b_h u = c is when it moves."""
    u, c = 0.05, 0.37
    device = Device(
        coulomb_friction_n=c,
        handle_damping_n_s_per_m=0.2,
        hand_stiffness_n_per_m=300,
        hand_damping_n_s_per_m=2,
    )
    joystick = Joystick(device)
    joystick.operate([(1, u, -u)])
    away = (mpf(c) - 2 * mpf(u)) / (300 * mpf(u))
    ticks = int(away / mpf(PERIOD_S))
    joystick.advance(ticks)
    assert joystick.truth()[:2] == ([0, 0], [0, 0])
    reference = (mpf(0), mpf(u), mpf(1), STRAIGHT)
    for _ in range(50):
        ticks += 1
        joystick.advance()
        x, v = propagated(device, mpf(0), mpf(0), mpf(-c), reference, away, ticks * mpf(PERIOD_S))
        assert abs(joystick.x - x) < 1e-16
        assert abs(joystick.v - v) < 1e-14
        assert joystick.truth()[0] == [joystick.x, -joystick.x]


def test_a_curved_reference_that_friction_holds_all_the_way_and_one_that_it_does_not() -> None:
    """A hand that is mostly viscous pulls hardest about the middle, between two looks of a long period."""
    k, grip, travel, duration = 10.0, 20.0, 0.01, 0.03
    s = np.linspace(0, 1, 200_001)
    pull = travel * (k * (10 * s**3 - 15 * s**4 + 6 * s**5) + grip / duration * 30 * s**2 * (1 - s) ** 2)
    most = pull.max()
    assert pull[-1] < most / 2
    for factor, moves in ((1 + 1e-6, False), (1 - 1e-6, True)):
        device = Device(coulomb_friction_n=most * factor, hand_stiffness_n_per_m=k, hand_damping_n_s_per_m=grip)
        for period_s, periods in ((0.03, 1), (1e-4, 300), (0.01, 3)):
            joystick = Joystick(device, period_s)
            joystick.operate([(duration, travel, 0)], Interpolation.MINIMUM_JERK)
            for _ in range(periods):
                joystick.advance()
            assert (joystick.x > 0) == moves


def test_energy_is_never_created() -> None:
    chance = random.Random(2)
    for _ in range(40):
        device = Device(
            handle_mass_kg=10 ** chance.uniform(-2, 0),
            handle_damping_n_s_per_m=chance.choice([0, 10 ** chance.uniform(-2, 1)]),
            coulomb_friction_n=chance.choice([0, 10 ** chance.uniform(-3, 0)]),
            hand_stiffness_n_per_m=10 ** chance.uniform(0, 4),
            hand_damping_n_s_per_m=chance.choice([0, 10 ** chance.uniform(-2, 1)]),
            workspace_m=chance.choice([0.03, 1.0]),
            start_m=(chance.uniform(-0.03, 0.03), chance.uniform(-0.03, 0.03)),
        )
        joystick = Joystick(device, chance.choice([1e-4, 1e-3]))
        reference = [chance.uniform(-0.03, 0.03), 0.0]
        joystick.operate([(0, *reference)])
        energies = []
        for _ in range(300):
            position, velocity, _ = joystick.truth()
            energies.append(
                sum(
                    device.mass_kg * v * v / 2 + device.hand_stiffness_n_per_m * (x - w) ** 2 / 2
                    for x, v, w in zip(position, velocity, reference, strict=True)
                )
            )
            joystick.advance()
        assert np.diff(energies).max() <= 1e-13 * energies[0]


# ---- stops -----------------------------------------------------------------------------------------------


def test_a_stop_takes_the_energy_and_lets_go() -> None:
    device = Device(workspace_m=0.01)
    joystick = Joystick(device, 1e-3)
    joystick.put(1.0, -1.0)
    hit_s = math.sqrt(2 * 0.01 * 0.05 / 1.0)
    before = math.floor(hit_s / 1e-3)
    for _ in range(before):
        joystick.advance()
    assert joystick.x == pytest.approx(0.5 * 1.0 / 0.05 * (before * 1e-3) ** 2, rel=1e-13)
    for _ in range(100):
        joystick.advance()
        assert joystick.truth()[:2] == ([0.01, -0.01], [0.0, 0.0])
    joystick.put(-1.0, 0.0)
    joystick.advance(10)
    assert joystick.x == pytest.approx(0.01 - 0.5 * 1.0 / 0.05 * 0.01**2, rel=1e-13)
    assert joystick.truth()[0][1] == -0.01


def test_friction_holds_at_a_stop_too() -> None:
    joystick = Joystick(Device(workspace_m=0.01, coulomb_friction_n=0.2))
    joystick.put(5.0)
    joystick.advance(2000)
    assert joystick.x == 0.01
    joystick.put(-0.2)
    joystick.advance(2000)
    assert joystick.x == 0.01
    joystick.put(-0.25)
    joystick.advance(100)
    assert joystick.x == pytest.approx(0.01 - 0.5 * 0.05 / 0.05 * 0.01**2, rel=1e-12)


def test_an_oscillation_that_touches_a_stop_within_a_period() -> None:
    """It turns between two looks that are both inside the workspace; the stop is met all the same."""
    k, period_s = 500.0, 1e-3
    omega = math.sqrt(k / 0.05)
    turn_s = math.pi / omega
    assert 0.3 < (turn_s / period_s) % 1 < 0.7
    beyond = 0.02 * (1 - math.cos(omega * period_s * 0.2))
    device = Device(hand_stiffness_n_per_m=k, workspace_m=0.02, start_m=(-0.02, 0.0))
    joystick = Joystick(device, period_s)
    joystick.operate([(0, beyond / 2, 0)])  # without a stop it would turn at 0.02 + beyond
    for _ in range(math.ceil(turn_s / period_s)):
        joystick.advance()
        assert joystick.x < 0.02
    # It lost its speed at the stop and left it from rest.
    released_s = (math.pi - math.acos((0.02 - beyond / 2) / (0.02 + beyond / 2))) / omega
    left = math.ceil(turn_s / period_s) * period_s - released_s
    expected = beyond / 2 + (0.02 - beyond / 2) * math.cos(omega * left)
    assert joystick.x == pytest.approx(expected, abs=1e-15)


# ---- actuator --------------------------------------------------------------------------------------------


def test_the_actuator_limits_rounds_and_refuses_what_is_no_number() -> None:
    joystick = Joystick(Device(max_force_n=8.9, force_step_n=0.5))
    joystick.put(0.74, -0.76)
    assert joystick.force == [0.5, -1.0]
    joystick.put(1e300, -1e300)
    assert joystick.force == [8.5, -8.5]
    for bad in (math.nan, math.inf, -math.inf):
        joystick.put(1.0, 1.0)
        joystick.put(bad, 1.0)
        assert joystick.force == [0.0, 0.0]
    exact = Joystick(Device(max_force_n=8.9))
    exact.put(9.0, -8.899999)
    assert exact.force == [8.9, -8.899999]
    whole = Joystick(Device(max_force_n=8.9, force_step_n=8.9 / 2047))
    whole.put(8.9, -8.9)
    assert whole.force == pytest.approx([8.9, -8.9], rel=1e-15)


@pytest.mark.parametrize("period_s", [1e-4, 1e-3, 0.3e-3, 0.0007])
@pytest.mark.parametrize("chunk", [1, 5000])
def test_a_force_expires_by_itself(period_s: float, chunk: int) -> None:
    device = Device(force_timeout_s=0.1, workspace_m=1000)
    joystick = Joystick(device, period_s)
    joystick.put(0.5)
    joystick.advance(5)
    joystick.put(0.5)
    v = joystick.v
    whole = math.floor(0.1 / period_s * (1 + 1e-12))
    for _ in range(whole - 1):
        joystick.advance()
    assert joystick.force == [0.5, 0.0]
    for _ in range(2):
        joystick.advance()
    assert joystick.force == [0.0, 0.0]
    for _ in range(5000 // chunk):
        joystick.advance(chunk)
    assert joystick.v - v == pytest.approx(0.5 * 0.1 / 0.05, rel=1e-12)
    joystick.put(0.5)
    joystick.advance()
    assert joystick.force == [0.5, 0.0]


# ---- encoder and reports ---------------------------------------------------------------------------------


def test_positions_are_the_nearest_steps() -> None:
    step = 20e-6
    joystick = Joystick(Device(encoder_step_m=step, hand_stiffness_n_per_m=300, hand_damping_n_s_per_m=5))
    joystick.operate([(0.05, 0.0301, -0.0222)], Interpolation.MINIMUM_JERK)
    seen = set()
    for _ in range(1000):
        joystick.advance()
        position, _, velocity = joystick.read()
        exact, true_velocity, _ = joystick.truth()
        for got, true in zip(position, exact, strict=True):
            assert abs(got - true) <= step / 2 * (1 + 1e-9)
            assert got == pytest.approx(round(got / step) * step, abs=1e-17)
        assert velocity == true_velocity
        seen.add(position[0])
    assert len(seen) > 300


def test_the_first_look_has_no_interval() -> None:
    joystick = Joystick(Device(start_m=(0.01, 0.02)))
    assert joystick.read() == ([0.01, 0.02], 0.0, [0.0, 0.0])
    assert joystick.read()[1] == 0.0
    joystick.advance()
    assert joystick.read()[1] == PERIOD_S
    assert joystick.read()[1] == 0.0
    joystick.advance(7)
    assert joystick.read()[1] == pytest.approx(7 * PERIOD_S, rel=1e-15)
    joystick.settle()
    assert joystick.read()[1] == 0.0
    late = Joystick(Device())
    late.advance(3)
    assert late.read()[1] == 0.0
    late.advance()
    assert late.read()[1] == PERIOD_S


@pytest.mark.parametrize(
    ("interval_ticks", "delay_ticks"),
    list(itertools.product([1.0, 10.0, 2.5, 1.5, 0.25, 7 / 3], [0.0, 1.0, 3.0, 0.4, 12.7])),
)
def test_reports_come_when_they_are_due(interval_ticks: float, delay_ticks: float) -> None:
    """A free handle at constant speed: every report tells when it was made."""
    interval_s = 0.0 if interval_ticks == 1 else interval_ticks * PERIOD_S
    device = Device(report_interval_s=interval_s, report_delay_s=delay_ticks * PERIOD_S, start_m=(-0.05, 0.0))
    joystick = Joystick(device)
    joystick.put(8.0)
    joystick.advance(20)
    joystick.put(0.0)
    joystick.settle()  # at rest, at -0.05; reports count from here
    joystick.put(8.0)
    acceleration = 8.0 / 0.05
    assert joystick.read()[1] == 0
    last = 0
    for tick in range(1, 200):
        joystick.advance()
        position, interval, velocity = joystick.read()
        # Equal times are ready: 1e-6 of a period is far above rounding and below any real difference.
        number = max(0, math.floor((tick - delay_ticks) / interval_ticks + 1e-6))
        made_s = number * interval_ticks * PERIOD_S
        assert interval == pytest.approx((number - last) * interval_ticks * PERIOD_S, rel=1e-13)
        # Report times are counted in 2^-24 of a period: their clock may be wrong by that much a report.
        late_s = number * 2**-24 * PERIOD_S if interval_ticks == 7 / 3 else 0.0
        travelled = acceleration * made_s**2 / 2
        assert position[0] + 0.05 == pytest.approx(travelled, abs=1e-15 + acceleration * made_s * late_s)
        assert velocity[0] == pytest.approx(acceleration * made_s, abs=1e-12 + acceleration * late_s)
        last = number


# ---- the link of forces ----------------------------------------------------------------------------------


def carried_forces(
    puts: Sequence[tuple[int, float]], interval: Fraction, intervals: int, timeout: Fraction
) -> list[tuple[Fraction, float]]:
    """When the actuator's force changes, and to what, in ticks: frame by frame.

    At each frame the newest put from before it, if it is newer than the last frame, leaves and acts `intervals - 1`
    frames later; what is not followed by another within the timeout expires.
    """
    acting: list[tuple[Fraction, float]] = []
    for frame in range(1, 2 + math.ceil(puts[-1][0] / interval)):
        begin, end = (frame - 1) * interval, frame * interval
        waiting = [force for tick, force in puts if begin <= tick < end]
        if waiting:
            acting.append((end + (intervals - 1) * interval, waiting[-1]))
    changes = []
    for index, (at, force) in enumerate(acting):
        changes.append((at, force))
        if index + 1 == len(acting) or acting[index + 1][0] - at > timeout:
            changes.append((at + timeout, 0.0))
    return changes


def coasted(changes: Sequence[tuple[Fraction, float]], ticks: int, mass_kg: float) -> list[tuple[float, float]]:
    """Position and velocity of a free handle at ticks 1, 2, ... under a piecewise constant force, in fractions."""
    period = Fraction(1, 10_000)
    x = v = now = force = Fraction(0)
    found = []
    for at, new in sorted(
        [*changes, *((Fraction(tick), None) for tick in range(1, ticks + 1))], key=lambda each: each[0]
    ):
        lasting, now = (at - now) * period, at
        x += v * lasting + force / Fraction(mass_kg) * lasting**2 / 2
        v += force / Fraction(mass_kg) * lasting
        if new is None:
            found.append((float(x), float(v)))
        else:
            force = Fraction(new)
    return found


@pytest.mark.long
@pytest.mark.parametrize("intervals", [1, 2, 5, 16])
@pytest.mark.parametrize("interval", [Fraction(10), Fraction(1), Fraction(5, 2), Fraction(3, 2), Fraction(1, 4)])
@pytest.mark.parametrize("pause", [1, 7, 60])
def test_a_link_carries_the_newest_force_of_a_frame(pause: int, interval: Fraction, intervals: int) -> None:
    """A free handle: the motion tells when each force began to act, within ticks too."""
    timeout = Fraction(325, 10)
    device = Device(
        force_interval_s=float(interval) * PERIOD_S,
        force_intervals=intervals,
        force_timeout_s=float(timeout) * PERIOD_S,
        workspace_m=1000,
    )
    joystick = Joystick(device)
    choice = random.Random(f"{interval} {intervals} {pause}")
    puts = [(0, 2.0)]
    joystick.put(2.0)
    found = []
    for tick in range(1, 500):
        joystick.advance()
        found.append((joystick.x, joystick.v))
        if tick < 300 and choice.random() < 1 / pause:
            puts.append((tick, choice.randrange(-64, 65) / 8))
            joystick.put(puts[-1][1])
    changes = carried_forces(puts, interval, intervals, timeout)
    np.testing.assert_allclose(found, coasted(changes, 499, device.mass_kg), rtol=1e-12, atol=1e-15)
    assert joystick.force == [0.0, 0.0]


@pytest.mark.parametrize("chunk", [7, 500, 4000])
@pytest.mark.parametrize("interval_s", [0.001, 0.0007, 0.05])
def test_many_periods_at_once_behind_a_link(chunk: int, interval_s: float) -> None:
    device = replace(
        EVENTFUL,
        report_interval_s=interval_s,
        report_delay_s=interval_s,
        force_interval_s=interval_s,
        force_intervals=3,
        force_timeout_s=0.15003,
    )
    one, many = Joystick(device), Joystick(device)
    for joystick in (one, many):
        joystick.operate(TOUR)
    for index in range(4000 // chunk):
        for joystick in (one, many):
            joystick.put(0.4 * (-1) ** index, 0.1)
        for _ in range(chunk):
            one.advance()
        many.advance(chunk)
        assert many.x == pytest.approx(one.x, abs=1e-13)
        assert many.v == pytest.approx(one.v, abs=1e-11)
        assert many.force == one.force
        assert many.read()[1] == one.read()[1]


def test_a_link_of_one_tick_is_one_tick_late() -> None:
    """What is put at one tick acts from the next on: the same motion as that of forces put there without a link."""
    linked, direct = Joystick(replace(EVENTFUL, force_interval_s=PERIOD_S, force_intervals=1)), Joystick(EVENTFUL)
    for joystick in (linked, direct):
        joystick.operate(TOUR)
    choice = random.Random(5)
    force = 0.0
    for _ in range(3000):
        linked.advance()
        direct.advance()
        assert linked.truth()[:2] == direct.truth()[:2]
        direct.put(force)
        force = choice.uniform(-1, 1)
        linked.put(force)


def test_what_is_under_way_is_gone_after_settling() -> None:
    joystick = Joystick(Device(force_interval_s=0.001, force_intervals=2))
    joystick.put(3.0)
    joystick.advance(5)
    joystick.settle()
    joystick.advance(100)
    assert joystick.truth() == ([0.0, 0.0], [0.0, 0.0], [0.0, 0.0])
    joystick.put(3.0)
    joystick.advance(14)  # 105 ticks since settling are 10.5 frames; two more are 12
    assert joystick.force == [0.0, 0.0]
    joystick.advance(6)
    assert joystick.force == [3.0, 0.0]


# ---- the hand's reference -------------------------------------------------------------------------------------


def reference_of(joystick: Joystick) -> list[float]:
    """A handle that settles is where the hand wants to be."""
    joystick.settle()
    return joystick.truth()[0]


def test_the_reference_along_a_path() -> None:
    device = Device(start_m=(0.01, 0.0), hand_stiffness_n_per_m=300, hand_damping_n_s_per_m=5)
    joystick = Joystick(device)
    assert reference_of(joystick) == [0.01, 0.0]
    joystick.operate([(0.01, 0.03, 0.02), (0.02, 0.03, -0.02)])
    joystick.advance(50)
    assert reference_of(joystick) == pytest.approx([0.02, 0.01], abs=1e-17)
    joystick.advance(75)
    assert reference_of(joystick) == pytest.approx([0.03, 0.01], abs=1e-17)
    # A new path begins at the present reference and at its own time 0.
    joystick.operate([(0.02, -0.01, 0.01)], Interpolation.MINIMUM_JERK)
    joystick.advance(100)
    assert reference_of(joystick) == pytest.approx([0.01, 0.01], abs=1e-17)
    joystick.advance(1000)
    assert reference_of(joystick) == [-0.01, 0.01]
    joystick.operate([(0.0, 0.05, 0.06), (1.0, 0.06, 0.06)])
    assert reference_of(joystick) == [0.05, 0.06]
    joystick.operate([(0.0, 0.2, -0.3)])
    assert reference_of(joystick) == [0.075, -0.075]


def test_a_jump_of_the_reference_moves_the_spring_only() -> None:
    device = Device(hand_stiffness_n_per_m=300, hand_damping_n_s_per_m=5)
    joystick = Joystick(device)
    joystick.operate([(0, 0.01, 0)])
    assert joystick.truth()[:2] == ([0, 0], [0, 0])
    joystick.advance()
    x, v = propagated(device, mpf(0), mpf(0), mpf(0), (mpf(0.01), mpf(0), mpf(1), REST), mpf(0), mpf(PERIOD_S))
    assert abs(joystick.x - x) < 1e-17 and abs(joystick.v - v) < 1e-15


def test_a_path_of_many_short_segments() -> None:
    """Waypoints closer than a period: a straight line in a thousand pieces is a straight line."""
    device = replace(EVENTFUL, workspace_m=1.0)
    for interpolation in Interpolation:
        fine, coarse = Joystick(device, 1e-3), Joystick(device, 1e-3)
        coarse.operate([(0.1, 0.03, 0.0)])
        pieces = 1000 if interpolation == Interpolation.LINEAR else 4000
        fine.operate([(0.1 * (i + 1) / pieces, 0.03 * (i + 1) / pieces, 0) for i in range(pieces)], interpolation)
        for _ in range(150):
            fine.advance()
            coarse.advance()
        if interpolation == Interpolation.LINEAR:
            assert fine.x == pytest.approx(coarse.x, abs=1e-13)
        else:
            assert fine.x == pytest.approx(coarse.x, abs=1e-5)


@pytest.mark.long
def test_nothing_decays_into_subnormal_numbers() -> None:
    for device in (
        Device(hand_stiffness_n_per_m=300, hand_damping_n_s_per_m=5, start_m=(0.01, -0.02)),
        Device(handle_damping_n_s_per_m=5, hand_damping_n_s_per_m=5, start_m=(0.01, -0.02)),
        Device(
            hand_stiffness_n_per_m=30,
            hand_damping_n_s_per_m=9,
            coulomb_friction_n=1e-12,
            start_m=(0.01, -0.02),
        ),
    ):
        joystick = Joystick(device, 1e-3)
        joystick.operate([(0, 0, 0)])
        joystick.put(1.0)
        joystick.advance(10)
        joystick.put(0.0)
        for _ in range(60_000):
            joystick.advance()
            position, velocity, _ = joystick.truth()
            assert all(value == 0 or abs(value) >= 1e-30 for value in position + velocity)
        assert max(map(abs, velocity)) < 1e-20


# ---- what is refused -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("handle_mass_kg", 0.0),
        ("handle_mass_kg", -0.04),
        ("handle_mass_kg", math.nan),
        ("handle_damping_n_s_per_m", -1.0),
        ("coulomb_friction_n", math.inf),
        ("encoder_step_m", -2e-5),
        ("encoder_step_m", 1e-30),
        ("max_force_n", -1.0),
        ("force_step_n", math.nan),
        ("force_step_n", 1e-30),
        ("report_interval_s", -1.0),
        ("report_interval_s", 1e-7),
        ("report_delay_s", 0.3),
        ("force_interval_s", -1.0),
        ("force_interval_s", 1e-7),
        ("force_interval_s", math.nan),
        ("workspace_m", 0.0),
        ("force_timeout_s", 0.0),
        ("hand_mass_kg", -1.0),
        ("hand_stiffness_n_per_m", -1.0),
        ("hand_damping_n_s_per_m", math.nan),
        ("start_m", (0.0, 0.076)),
        ("start_m", (math.nan, 0.0)),
    ],
)
def test_a_device_that_cannot_be(field: str, value: object) -> None:
    with pytest.raises(ValueError, match=f"^{field}") as caught:
        Joystick(replace(Device(), **{field: value}))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("intervals", [0, 17])
def test_a_force_that_is_too_long_under_way(intervals: int) -> None:
    with pytest.raises(ValueError, match=rf"^force_intervals: {intervals} is not between 1 and 16$"):
        Joystick(Device(force_interval_s=0.001, force_intervals=intervals))


def test_a_device_too_light_for_its_rate() -> None:
    with pytest.raises(ValueError, match="too light"):
        Joystick(Device(handle_mass_kg=1e-6, hand_mass_kg=0, hand_damping_n_s_per_m=100))
    for period_s in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match=r"^period_s"):
            Joystick(Device(), period_s)


@pytest.mark.parametrize(
    ("waypoints", "message"),
    [
        ([], "at least one"),
        ([(-0.1, 0, 0)], r"waypoints\[0\]: t_s"),
        ([(0, 0, 0), (0, 0, 0)], r"waypoints\[1\]: t_s"),
        ([(0, 0, 0), (1, 0, 0), (0.5, 0, 0)], r"waypoints\[2\]: t_s"),
        ([(math.nan, 0, 0)], "t_s"),
        ([(math.inf, 0, 0)], "t_s"),
        ([(0, math.nan, 0)], "x_m"),
        ([(0, 0, math.inf)], "y_m"),
        ([(0, 0, 1e6)], "y_m"),
    ],
)
def test_waypoints_that_cannot_be_followed(waypoints: Waypoints, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        new_path(waypoints)


def test_an_interpolation_that_is_none() -> None:
    flat = ffi.new("double[3]", [0.0, 0.0, 0.0])
    assert lib.hd_operator_new(flat, 1, 2) == ffi.NULL
    assert "interpolation" in invalid_reason()
