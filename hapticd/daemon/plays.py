"""Modes that were sent to be struck and were not yet, as far as it is known."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final, NamedTuple

from hapticd.base.core import CData, Status, ffi, invalid_reason, lib
from hapticd.base.errors import HapticdError
from hapticd.config.modes import Attack, Mode
from hapticd.protocol.changes import Played
from hapticd.rendering.compiler.mode_record import mode_record
from hapticd.rendering.device_output import Output

if TYPE_CHECKING:
    from hapticd.hid.offload import EffectUse

_MOST: Final = 4096
"""No less than the ring of commands holds."""


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


class Plays:
    """Under way from the command to the tick that takes it. For the thread that sends commands."""

    def __init__(self) -> None:
        self._sent: deque[tuple[int, Play]] = deque(maxlen=_MOST)

    def sent(self, sequence: int, play: Play) -> None:
        """A play is the command of this number."""
        self._sent.append((sequence, play))

    def taken(self, servo: CData) -> Iterator[Played]:
        """Those that the servo has taken since, in their order."""
        tick = ffi.new("uint64_t *")
        while self._sent and lib.hd_servo_wait_command(servo, self._sent[0][0], 0, tick) == Status.OK:
            _, play = self._sent.popleft()
            yield Played(int(tick[0]), play.mode, play.attack, play.direction, play.amplitude_m_per_s2)

    def turn_to(self, servo: CData, output: Output) -> None:
        """The servo, which has ended, goes on at another rate: what it has not taken is struck for that rate."""
        for sequence, play in self._sent:
            mode = ffi.new("struct hd_mode *", play.record(output))
            if lib.hd_servo_retune(servo, sequence, mode) != Status.OK:
                raise HapticdError(f"a play under way: {invalid_reason()}")
