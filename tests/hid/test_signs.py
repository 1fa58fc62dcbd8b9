"""The check of a device's signs in simulated time: a handle with mass, friction, spring and hand, one step a tick."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, field

import numpy as np
import pytest

from hapticd.base.core import CData, HidMeaning, SignsProblem, SignsState, ffi, lib
from hapticd.hid.signs import Check, SignsStatus

LET_GO = "let go of the handle, or hold it lightly and still if it has a hand sensor"

RATE_HZ = 1000
TRAVEL_M = 0.05
FULL_N = 8.9
MAX_N = 6.0
RAMP_S = 0.1
STEP_N = MAX_N / RATE_HZ / RAMP_S
"""Largest change of the force in a tick, in N."""

Hand = Callable[[float], tuple[float, float]]


def _no_hand(_: float) -> tuple[float, float]:
    return 0.0, 0.0


@dataclass
class Handle:
    """A handle in simulated time; `turn` maps a commanded force to the force that the device exerts."""

    mass_kg: float = 0.1
    damping: float = 0.5
    friction_n: float = 0.05
    spring: float = 0.0
    turn: tuple[tuple[float, float], tuple[float, float]] = ((1.0, 0.0), (0.0, 1.0))
    hand: Hand = _no_hand
    """The hand's force over time, in N."""
    step_m: float = 1.5e-6
    noise_m: float = 0.0
    late: int = 10
    """Ticks from a force to the position that it has changed."""
    held: bool = False
    position_m: list[float] = field(default_factory=lambda: [0.0, 0.0])
    speed: list[float] = field(default_factory=lambda: [0.0, 0.0])
    forces: list[tuple[float, float]] = field(default_factory=list)
    random: np.random.Generator = field(default_factory=lambda: np.random.default_rng(1))

    def report(self) -> tuple[float, float]:
        here = [position + self.random.normal() * self.noise_m for position in self.position_m]
        return tuple(round(position / self.step_m) * self.step_m for position in here)  # type: ignore[return-value]

    def move(self, force_n: tuple[float, float], time_s: float) -> None:
        self.forces.append(force_n)
        acts = self.forces[-self.late - 1] if len(self.forces) > self.late else (0.0, 0.0)
        for axis, hand_n in enumerate(self.hand(time_s)):
            if self.held:
                continue
            pushed = self.turn[axis][0] * acts[0] + self.turn[axis][1] * acts[1] + hand_n
            pushed -= self.spring * self.position_m[axis] + self.damping * self.speed[axis]
            speed = self.speed[axis] + pushed / self.mass_kg / RATE_HZ
            drag = self.friction_n / self.mass_kg / RATE_HZ
            self.speed[axis] = math.copysign(max(abs(speed) - drag, 0.0), speed)
            self.position_m[axis] += self.speed[axis] / RATE_HZ
            if abs(self.position_m[axis]) > TRAVEL_M:
                self.position_m[axis] = math.copysign(TRAVEL_M, self.position_m[axis])
                self.speed[axis] = 0.0


class Run:
    """Runs the check with a simulated handle."""

    def __init__(self, handle: Handle, axes: tuple[bool, bool] = (True, True)) -> None:
        self.handle = handle
        self.signs = ffi.gc(lib.hd_signs_new(), lib.hd_signs_free)
        check = Check(TRAVEL_M, FULL_N).of("stick", axes, handle.step_m)
        assert check is not None
        self.of: CData = ffi.new("struct hd_hid_signs *", asdict(check))
        self.input = ffi.new("struct hd_signs_input *")
        self.input.elapsed_s = 1.0 / RATE_HZ
        self.input.max_force_n, self.input.ramp_s = MAX_N, RAMP_S
        self.input.enabled = 1
        self.force = ffi.new("double[2]")
        self.ticks = 0

    def tick(self) -> SignsStatus:
        self.input.position_m = self.handle.report()
        status = SignsStatus.read(lib.hd_signs_try(self.signs, self.of, self.input, self.force))
        self.handle.move((self.force[0], self.force[1]), self.ticks / RATE_HZ)
        self.ticks += 1
        return status

    def until(self, *states: SignsState, at_most_s: float = 30.0) -> SignsStatus:
        for _ in range(round(at_most_s * RATE_HZ)):
            status = self.tick()
            if status.state in states:
                return status
        raise AssertionError(status)

    def end(self) -> SignsStatus:
        return self.until(SignsState.RIGHT, SignsState.WRONG, SignsState.UNCLEAR)


HANDLES = {
    "light": Handle(mass_kg=0.03),
    "middling": Handle(),
    "heavy": Handle(mass_kg=0.4, friction_n=0.2),
    "no friction at all": Handle(friction_n=0.0, damping=0.0),
    "spring-centred": Handle(spring=60.0, damping=1.5),
    "stiff spring": Handle(mass_kg=0.05, spring=300.0, damping=1.0),
    "10 bits, noisy": Handle(step_m=1e-4, noise_m=1e-4),
    "8 bits": Handle(step_m=4e-4),
    "at its stop": Handle(position_m=[TRAVEL_M, -TRAVEL_M]),
    "slow link": Handle(late=25),
}


@pytest.mark.parametrize(
    "name", [name if name == "middling" else pytest.param(name, marks=pytest.mark.slow) for name in HANDLES]
)
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_the_way_a_device_pushes_is_found(name: str, way: float) -> None:
    like = HANDLES[name]
    handle = Handle(**{key: getattr(like, key) for key in like.__dataclass_fields__ if key not in ("turn", "forces")})
    handle.position_m, handle.speed = list(like.position_m), [0.0, 0.0]
    handle.turn = ((way, 0.0), (0.0, way))
    run = Run(handle)
    status = run.end()
    if way > 0:
        assert status.state == SignsState.RIGHT and status.line() is None
    else:
        assert (status.state, status.problem, status.axis) == (SignsState.WRONG, SignsProblem.REVERSED, "x")
    assert run.ticks / RATE_HZ < 8
    forces = np.array(handle.forces)
    assert np.abs(forces).max() <= 0.1 * FULL_N + 1e-12
    assert np.abs(np.diff(forces, axis=0)).max() <= STEP_N * (1 + 1e-9)
    assert (forces[:, 0] * forces[:, 1] == 0).all()
    assert np.abs(forces.sum(axis=0)).max() < 1e-6 * len(forces), "every pulse is followed by its opposite"


@pytest.mark.parametrize(
    ("turn", "problem", "axis"),
    [
        (((0.0, 1.0), (1.0, 0.0)), SignsProblem.SWAPPED, "x"),
        (((1.0, 0.0), (0.0, -1.0)), SignsProblem.REVERSED, "y"),
    ],
)
def test_one_wrong_axis_is_enough(
    turn: tuple[tuple[float, float], tuple[float, float]], problem: SignsProblem, axis: str
) -> None:
    run = Run(Handle(turn=turn))
    status = run.end()
    assert (status.state, status.problem, status.axis) == (SignsState.WRONG, problem, axis)
    pushed = len(run.handle.forces)
    for _ in range(500):
        assert run.tick().state == SignsState.WRONG
    assert not np.array(run.handle.forces)[pushed - 1 :].any()
    line = status.line()
    assert (
        line is not None
        and "hapticd devices calibrate" in line
        and "device.hid.signs: trust" in line
        and "\n" not in line
    )


def test_one_axis_is_pushed_alone() -> None:
    run = Run(Handle(turn=((1.0, 0.0), (0.0, -1.0))), axes=(True, False))
    assert run.end().state == SignsState.RIGHT
    assert not np.array(run.handle.forces)[:, 1].any()
    run = Run(Handle(turn=((-1.0, 0.0), (0.0, 1.0))), axes=(False, True))
    assert run.end().state == SignsState.RIGHT
    assert not np.array(run.handle.forces)[:, 0].any()


def test_an_axis_without_force_may_move_as_it_likes() -> None:
    """The axis is a pedal next to a wheel."""
    run = Run(Handle(hand=lambda time_s: (0.0, math.sin(20 * time_s))), axes=(True, False))
    assert run.end().state == SignsState.RIGHT


def test_a_handle_that_is_held_is_unclear_until_it_is_let_go() -> None:
    run = Run(Handle(held=True))
    found = {run.tick().line() for _ in range(1500)}
    assert any(line and line.startswith("the handle did not move when it was pushed along x: let go") for line in found)
    status = run.end()
    assert (status.state, status.problem) == (SignsState.UNCLEAR, SignsProblem.STILL)
    pulses = len(run.handle.forces)
    run.input.enabled = 0
    for _ in range(100):
        assert run.tick().state == SignsState.UNCLEAR
    assert not np.array(run.handle.forces)[pulses - 1 :].any()
    run.handle.held, run.input.enabled = False, 1
    assert run.end().state == SignsState.RIGHT


@pytest.mark.slow
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_hand_that_moves_it_meanwhile_deceives_nobody(way: float) -> None:
    """The check waits for the end of the hand's motion, and reports it; whatever the hand does, no result is wrong."""
    wrong = SignsState.WRONG if way > 0 else SignsState.RIGHT
    right = SignsState.RIGHT if way > 0 else SignsState.WRONG
    outcomes = []
    for seed in range(12):
        random = np.random.default_rng(seed)
        rates_hz, phases = random.uniform(0.3, 9.0, (2, 4)), random.uniform(0, 2 * np.pi, (2, 4))
        sizes = random.uniform(0.0, 0.3, (2, 4))

        def hand(time_s: float, *of: np.ndarray) -> tuple[float, float]:
            rates_hz, phases, sizes = of
            swings = (sizes * np.sin(2 * np.pi * rates_hz * time_s + phases)).sum(axis=1)
            return tuple(swings * (time_s < 4.0))  # type: ignore[return-value]

        run = Run(Handle(turn=((way, 0.0), (0.0, way)), hand=lambda t, of=(rates_hz, phases, sizes): hand(t, *of)))
        found = set()
        for _ in range(round(30 * RATE_HZ)):
            status = run.tick()
            found.add(status.problem)
            if status.state in (SignsState.RIGHT, SignsState.WRONG, SignsState.UNCLEAR):
                break
        outcomes.append(status.state)
    assert wrong not in outcomes
    assert outcomes.count(right) >= 10


def test_the_check_waits_while_the_handle_moves_and_reports_it() -> None:
    handle = Handle(held=True)
    run = Run(handle)

    def swung() -> SignsStatus:
        handle.position_m[0] = 0.02 * math.sin(2 * math.pi * run.ticks / RATE_HZ)
        return run.tick()

    status = [swung() for _ in range(3000)][-1]
    assert (status.state, status.problem) == (SignsState.WAITING, SignsProblem.MOVING)
    assert status.line() == f"the handle does not come to rest: {LET_GO}"
    handle.held = False
    assert run.end().state == SignsState.RIGHT


def test_nothing_is_pushed_while_something_is_touched() -> None:
    run = Run(Handle())
    run.input.contact = 1
    status = [run.tick() for _ in range(1000)][-1]
    assert (status.state, status.problem) == (SignsState.WAITING, SignsProblem.CONTACT)
    assert status.line() == f"the handle touches an object of the scene: move it away, then {LET_GO}"
    assert not np.array(run.handle.forces).any()
    run.input.contact = 0
    while not run.force[0]:
        run.tick()
    run.input.contact = 1
    run.tick()
    assert run.force[0] == 0.0, "a pulse ends in the tick that meets something"
    run.input.contact = 0
    assert run.end().state == SignsState.RIGHT


@pytest.mark.parametrize("fails", ["enabled", "jumped"])
def test_a_pulse_ends_at_once_and_the_check_begins_again(fails: str) -> None:
    run = Run(Handle())
    while not run.force[0]:
        run.tick()
    setattr(run.input, fails, fails == "jumped")
    status = run.tick()
    assert run.force[0] == 0.0
    assert status.state == (SignsState.UNCHECKED if fails == "enabled" else SignsState.CHECKING)
    setattr(run.input, fails, fails == "enabled")
    assert run.end().state == SignsState.RIGHT


def test_nothing_is_pushed_while_the_scene_still_fades() -> None:
    run = Run(Handle())
    run.input.gain = 0.5
    for _ in range(500):
        assert run.tick().state == SignsState.CHECKING
    assert not np.array(run.handle.forces).any()


def test_a_device_is_checked_once_and_another_one_again() -> None:
    run = Run(Handle())
    assert run.end().state == SignsState.RIGHT
    run.of.number = 2
    assert run.tick().state == SignsState.CHECKING
    assert run.end().state == SignsState.RIGHT
    run.of.number = 0
    assert run.tick().state == SignsState.TRUSTED


def test_a_device_has_one_number_as_often_as_it_comes() -> None:
    check = Check(TRAVEL_M, FULL_N)
    numbers = [check.of(identity, (True, False), 0.0) for identity in ("a", "b", "a")]
    assert [one and one.number for one in numbers] == [1, 2, 1]
    assert check.of("c", (False, False), 0.0) is None


def idle_for(*meanings: HidMeaning) -> int:
    return sum(1 << (meaning - 1) for meaning in meanings)


@pytest.mark.parametrize(
    ("meanings", "line"),
    [
        (
            [HidMeaning.SAFETY],
            "its safety switch is open: hold the handle lightly and still (or release its emergency ",
        ),
        ([HidMeaning.ACTUATORS], "its actuators are off: switch the device's actuators on"),
        ([HidMeaning.POWER], "its actuators have no power: plug the power supply in (or release its emergency stop)"),
        ([HidMeaning.PAUSED], "it is paused: end the program that paused it"),
        ([HidMeaning.RESET], "it was reset: wait until it is set up again"),
        ([HidMeaning.SAFETY, HidMeaning.POWER], "its actuators have no power and its safety switch is open: plug the "),
    ],
)
def test_the_check_waits_while_the_device_reports_that_it_exerts_no_force(
    meanings: list[HidMeaning], line: str
) -> None:
    run = Run(Handle(held=True))
    run.input.idle = idle_for(*meanings)
    found = {run.tick() for _ in range(20 * RATE_HZ)}
    assert {(status.state, status.problem) for status in found} == {(SignsState.WAITING, SignsProblem.IDLE)}
    (said,) = {status.line() for status in found}
    assert said is not None and said.startswith(f"the device exerts no force because {line}")
    run.handle.held, run.input.idle = False, 0
    began = run.ticks
    assert run.tick().state == SignsState.CHECKING
    assert run.end().state == SignsState.RIGHT
    assert run.ticks - began < 4 * RATE_HZ


def test_a_state_that_changes_during_a_push_discards_the_push() -> None:
    """A device that pushes the wrong way, but only while its safety switch is closed."""
    run = Run(Handle(turn=((-1.0, 0.0), (0.0, -1.0))))
    for tick in range(30 * RATE_HZ):
        run.input.idle = idle_for(HidMeaning.SAFETY) if tick // 130 % 2 else 0
        run.handle.held = bool(run.input.idle)
        status = run.tick()
        assert status.state in (SignsState.CHECKING, SignsState.WAITING), status
        if tick % 130 == 0:
            assert run.force[0] == 0.0
    run.input.idle, run.handle.held = 0, False
    assert (run.end().state, status.axis) == (SignsState.WRONG, "x")


def test_the_check_goes_on_with_the_axis_where_it_waited() -> None:
    run = Run(Handle())
    while not run.force[1]:
        run.tick()
    run.input.idle, run.handle.held = idle_for(HidMeaning.POWER), True
    for _ in range(3 * RATE_HZ):
        assert run.tick().problem == SignsProblem.IDLE
    run.input.idle, run.handle.held = 0, False
    pushed = len(run.handle.forces)
    assert run.end().state == SignsState.RIGHT
    assert not np.array(run.handle.forces)[pushed:, 0].any()


def test_rounds_before_the_wait_do_not_count() -> None:
    """Four of five rounds move nothing, before the device reports why."""
    held = Run(Handle(held=True))
    assert held.end().state == SignsState.UNCLEAR
    run = Run(Handle(held=True))
    for _ in range(2):
        for _ in range(held.ticks - 100):
            assert run.tick().state == SignsState.CHECKING
        run.input.idle = idle_for(HidMeaning.SAFETY)
        assert run.tick().state == SignsState.WAITING
        run.input.idle = 0
    run.handle.held = False
    assert run.end().state == SignsState.RIGHT


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("meanings", [[HidMeaning.SAFETY], [HidMeaning.SAFETY, HidMeaning.POWER, HidMeaning.ACTUATORS]])
def test_a_handle_that_moves_nevertheless_proves_the_report_wrong(way: float, meanings: list[HidMeaning]) -> None:
    """Some firmware never sets these bits. The first axis proves it; the second one is not delayed."""
    run = Run(Handle(turn=((1.0, 0.0), (0.0, way))))
    run.input.idle = idle_for(*meanings)
    states = [run.tick().state]
    while run.force[1] == 0.0:
        states.append(run.tick().state)
    assert states[0] == SignsState.WAITING and states[-1] == SignsState.CHECKING
    status = run.end()
    assert status.state == (SignsState.RIGHT if way > 0 else SignsState.WRONG)
    assert run.ticks < 8 * RATE_HZ
    # From then on the bits mean nothing, whatever they are.
    for idle in (0, run.input.idle):
        run.input.idle = idle
        assert run.tick().state == status.state


@pytest.mark.parametrize("seed", [32, 72])
def test_a_hand_that_turns_a_wheel_without_power_proves_nothing(seed: int) -> None:
    """The wheel has a spring. The hand turns it and pauses, again and again; by chance one round looks right."""
    random = np.random.default_rng(seed)
    rates_hz, phases = random.uniform(0.3, 6.0, 4), random.uniform(0.0, 2 * np.pi, 4)
    sizes_n = random.uniform(0.0, 0.2, 4)
    period_s = random.uniform(1.0, 4.0)

    def hand(time_s: float) -> tuple[float, float]:
        is_turning = time_s / period_s % 1.0 < 0.5
        return float((sizes_n * np.sin(2 * np.pi * rates_hz * time_s + phases)).sum()) * is_turning, 0.0

    run = Run(Handle(turn=((0.0, 0.0), (0.0, 0.0)), hand=hand, spring=60.0, damping=1.5), axes=(True, False))
    run.input.idle = idle_for(HidMeaning.POWER)
    found = {run.tick() for _ in range(2 * RATE_HZ)}
    assert {(status.state, status.problem) for status in found} == {(SignsState.WAITING, SignsProblem.IDLE)}


def test_bits_that_seemed_wrong_are_read_again_after_a_check_without_a_result() -> None:
    run = Run(Handle(turn=((1.0, 0.0), (0.0, 0.0))))
    run.input.idle = idle_for(HidMeaning.POWER)
    status = run.end()
    assert (status.state, status.problem, status.axis) == (SignsState.UNCLEAR, SignsProblem.STILL, "y")
    run.handle.held = True
    status = run.tick()
    assert (status.state, status.problem, status.axis) == (SignsState.WAITING, SignsProblem.IDLE, "x")


def test_after_the_check_the_scene_waits_for_a_device_that_exerts_no_force() -> None:
    run = Run(Handle())
    assert run.end().state == SignsState.RIGHT
    run.input.idle = idle_for(HidMeaning.SAFETY)
    status = run.tick()
    assert (status.state, status.problem, status.holds_back) == (SignsState.WAITING, SignsProblem.IDLE, True)
    assert tuple(run.force) == (0.0, 0.0)
    run.input.enabled = 0
    assert run.tick().state == SignsState.RIGHT
    run.input.enabled = 1
    assert run.tick().state == SignsState.WAITING
    run.input.idle = 0
    assert run.tick().state == SignsState.RIGHT


def test_a_handle_that_does_not_move_is_told_every_reason_in_one_line() -> None:
    status = Run(Handle(held=True)).end()
    line = status.line()
    assert line is not None and "\n" not in line
    for reason in ("let go", "hand sensor", "emergency stop", "work mode", "dead band takes 10 %", "force_axes"):
        assert reason in line
