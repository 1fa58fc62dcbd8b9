"""The command ring: sends commands to the servo, loses none, and waits for the tick that takes them.

A play is a ringing mode that the method `play` starts ("strikes"); it is kept here until the servo has struck it. Only
the command thread may use this module.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Final, NamedTuple

from hapticd.base.core import CData, CommandKind, Status, ffi, invalid_reason, lib
from hapticd.base.errors import HapticdError
from hapticd.config.modes import Attack, Mode
from hapticd.protocol.changes import Played
from hapticd.rendering.compiler.mode_record import mode_record
from hapticd.rendering.device_output import Output

if TYPE_CHECKING:
    from hapticd.hid.offload import EffectUse

COMMAND_TIMEOUT_S: Final = 1.0
"""Time within which the servo must take a command, as docs/protocol.md states."""
_MAX_PENDING_PLAYS: Final = 4096
"""Largest number of plays that are kept until they are struck: at least the capacity of the command ring."""
SERVO_POLL_INTERVAL_NS: Final = 50_000_000
"""Shortest time between two polls of the servo by the command thread (Engine.poll_servo)."""


class RingFullError(HapticdError):
    """The command ring is full of commands that the servo has not taken; none of the new commands was sent."""


class WaitTimeoutError(HapticdError):
    """The servo did not take a command or a revision in time."""


class Play(NamedTuple):
    """A ringing mode (decaying sinusoid) that the method `play` strikes, independent of the servo's rate."""

    mode: Mode
    attack: Attack
    direction: tuple[float, float]
    amplitude_m_per_s2: float
    effect: EffectUse | None
    """The device effect that plays the mode instead of the servo; None: the servo plays it."""

    def record(self, output: Output) -> tuple[float | list[float], ...]:
        """Return the members of a `struct hd_mode` for the mode at the rate of `output`."""
        return mode_record(self.mode, 1.0, self.mode.coefficient(1.0, self.attack), output, self.effect)


class CommandRing:
    """The command thread's end of the ring through which one servo gets its commands."""

    def __init__(self, servo: CData, poll_servo: Callable[[], None]) -> None:
        """Use the command ring of `servo`; while waiting for the servo, call `poll_servo`, which may restart it."""
        self._servo, self._poll_servo = servo, poll_servo
        self._sequence = ffi.new("uint64_t *")
        self._plays: deque[tuple[int, Play]] = deque(maxlen=_MAX_PENDING_PLAYS)
        """Plays that were sent and may not be struck yet, each with the number of its command."""

    def new(self, kind: CommandKind, revision: int) -> CData:
        """Return a new `struct hd_command *`; the servo takes it once its scene has this revision or a later one."""
        command = ffi.new("struct hd_command *")
        command.kind, command.revision = kind, revision
        return command

    def send(self, commands: list[CData], play: Play | None = None) -> int:
        """Send commands together, and return the tick that took the last one.

        `play`: the mode that the command strikes. Raises RingFullError, WaitTimeoutError.
        """
        sequence = self._put(commands)
        if play is not None:
            self._plays.append((sequence, play))
        return self._wait_command(sequence)

    def _put(self, commands: list[CData]) -> int:
        batch = ffi.new("struct hd_command[]", [command[0] for command in commands])
        status = lib.hd_servo_send(self._servo, batch, len(commands), self._sequence)
        if status == Status.ERR_FULL:
            raise RingFullError(f"the servo's command ring has no room for {len(commands)} more")
        if status != Status.OK:
            raise HapticdError(invalid_reason())
        return int(self._sequence[0])

    def _wait_command(self, sequence: int) -> int:
        return self.wait(
            lambda timeout_ns, tick: lib.hd_servo_wait_command(self._servo, sequence, timeout_ns, tick),
            "the servo did not take the command",
        )

    def wait(self, taken: Callable[[int, CData], int], failure: str) -> int:
        """Wait until the function `taken` returns OK, and return the tick that `taken` stored.

        `taken` gets the nanoseconds that it may wait, and where to store the tick. Between two calls the servo is
        polled, because only this thread can restart it after an overload. Raises WaitTimeoutError, whose text begins
        with `failure`.
        """
        tick = ffi.new("uint64_t *")
        until_ns = time.monotonic_ns() + int(COMMAND_TIMEOUT_S * 1e9)
        while taken(max(0, min(SERVO_POLL_INTERVAL_NS, until_ns - time.monotonic_ns())), tick) != Status.OK:
            if time.monotonic_ns() >= until_ns:
                raise WaitTimeoutError(f"{failure} within {COMMAND_TIMEOUT_S:g} s")
            self._poll_servo()
        return int(tick[0])

    def played(self) -> Iterator[Played]:
        """Yield the ringing modes of `play` that the servo has struck since the last call, in their order."""
        tick = ffi.new("uint64_t *")
        while self._plays and lib.hd_servo_wait_command(self._servo, self._plays[0][0], 0, tick) == Status.OK:
            _, play = self._plays.popleft()
            yield Played(int(tick[0]), play.mode, play.attack, play.direction, play.amplitude_m_per_s2)

    def set_output(self, output: Output) -> None:
        """Convert modes of `play` that are not struck yet to the rate of `output`. The servo thread must have ended."""
        for sequence, play in self._plays:
            mode = ffi.new("struct hd_mode *", play.record(output))
            if lib.hd_servo_retune(self._servo, sequence, mode) != Status.OK:
                raise HapticdError(f"play: a waiting mode cannot be converted to the new rate: {invalid_reason()}")
