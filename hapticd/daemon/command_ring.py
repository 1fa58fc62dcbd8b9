"""The command ring: sends commands to the servo, loses none, and waits for the tick that takes them.

Modes that were sent to be struck are remembered until the servo took them. For the thread that serves commands.
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

WAIT_S: Final = 1.0
"""How long a command waits for the servo to take it."""
_MOST_PLAYS: Final = 4096
"""So many are remembered, no less than the ring holds."""
LOOK_EVERY_NS: Final = 50_000_000
"""So often the thread that serves commands looks whether the servo needs something."""


class RingFullError(HapticdError):
    """The servo has not yet taken what was sent before; nothing of this was sent."""


class WaitTimeoutError(HapticdError):
    """The servo did not take a command or a revision in time."""


class Play(NamedTuple):
    """What is struck, whatever the rate is when it is."""

    mode: Mode
    attack: Attack
    direction: tuple[float, float]
    amplitude_m_per_s2: float
    effect: EffectUse | None
    """What the device plays in its place."""

    def record(self, output: Output) -> tuple[float | list[float], ...]:
        """The numbers of its `struct hd_mode` at the output's rate."""
        return mode_record(self.mode, 1.0, self.mode.coefficient(1.0, self.attack), output, self.effect)


class CommandRing:
    """The commands of one servo."""

    def __init__(self, servo: CData, look_after: Callable[[], None]) -> None:
        """`look_after`: called while the servo is waited for."""
        self._servo, self._look_after = servo, look_after
        self._sequence = ffi.new("uint64_t *")
        self._plays: deque[tuple[int, Play]] = deque(maxlen=_MOST_PLAYS)
        """Sent and not known to be struck: each with the number of its command."""

    def new(self, kind: CommandKind, revision: int) -> CData:
        """A `struct hd_command *` for this revision of the scene or a later one."""
        command = ffi.new("struct hd_command *")
        command.kind, command.revision = kind, revision
        return command

    def send(self, commands: list[CData], play: Play | None = None) -> int:
        """The tick that took them all. `play`: what the command strikes. Raises RingFullError, WaitTimeoutError."""
        sequence = self._put(commands)
        if play is not None:
            self._plays.append((sequence, play))
        return self._taken(sequence)

    def _put(self, commands: list[CData]) -> int:
        batch = ffi.new("struct hd_command[]", [command[0] for command in commands])
        status = lib.hd_servo_send(self._servo, batch, len(commands), self._sequence)
        if status == Status.ERR_FULL:
            raise RingFullError(f"the command ring has no room for {len(commands)} more")
        if status != Status.OK:
            raise HapticdError(invalid_reason())
        return int(self._sequence[0])

    def _taken(self, sequence: int) -> int:
        return self.wait(
            lambda timeout_ns, tick: lib.hd_servo_wait_command(self._servo, sequence, timeout_ns, tick),
            "the servo did not take the command",
        )

    def wait(self, taken: Callable[[int, CData], int], late: str) -> int:
        """The tick that took something; `taken` itself waits for at most the nanoseconds that it is given.

        A servo that steps down goes on by this thread's doing, and would be waited for in vain if it did not look after
        it. Raises WaitTimeoutError, which says what is `late`.
        """
        tick = ffi.new("uint64_t *")
        until_ns = time.monotonic_ns() + int(WAIT_S * 1e9)
        while taken(max(0, min(LOOK_EVERY_NS, until_ns - time.monotonic_ns())), tick) != Status.OK:
            if time.monotonic_ns() >= until_ns:
                raise WaitTimeoutError(f"{late} within {WAIT_S:g} s")
            self._look_after()
        return int(tick[0])

    def played(self) -> Iterator[Played]:
        """The modes that the servo has struck since this was asked last, in their order."""
        tick = ffi.new("uint64_t *")
        while self._plays and lib.hd_servo_wait_command(self._servo, self._plays[0][0], 0, tick) == Status.OK:
            _, play = self._plays.popleft()
            yield Played(int(tick[0]), play.mode, play.attack, play.direction, play.amplitude_m_per_s2)

    def turn_to(self, output: Output) -> None:
        """The servo, which has ended, goes on at another rate: what it has not taken is struck for that rate."""
        for sequence, play in self._plays:
            mode = ffi.new("struct hd_mode *", play.record(output))
            if lib.hd_servo_retune(self._servo, sequence, mode) != Status.OK:
                raise HapticdError(f"a play under way: {invalid_reason()}")
