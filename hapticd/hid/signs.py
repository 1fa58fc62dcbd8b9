"""The check of a device's signs before the first force of the scene: csrc/device/hd_signs.h does it, here is what it
is given and what it reports."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Final

from hapticd.base.core import SignsProblem, SignsState, lib

FORCE: Final = 0.1
"""Of a pulse, as a part of the device's largest force; `hapticd devices calibrate` uses no more."""
LEAST: Final = 0.005
"""A handle that moved by less than this part of its half travel was not moved."""
ENOUGH: Final = 0.1
"""A pulse ends early once the handle has moved by this part."""
_STEPS: Final = 2.0
"""Of the encoder: less is no motion either."""
_SEEN: Final[dict[SignsProblem, str]] = {
    SignsProblem.REVERSED: "a force along {axis} moves the handle the other way",
    SignsProblem.SWAPPED: "a force along {axis} moves the handle along {other}",
    SignsProblem.STILL: "the handle did not move when it was pushed along {axis}",
    SignsProblem.UNCERTAIN: "the handle did not clearly follow when it was pushed along {axis}",
    SignsProblem.MOVING: "the handle does not come to rest",
    SignsProblem.CONTACT: "the handle touches an object of the scene",
}
_log = logging.getLogger("hapticd")
CORRECT: Final = (
    "run `hapticd devices calibrate` to find device.hid.force_axes, or set device.hid.signs: trust to skip the check"
)


@dataclass(frozen=True, slots=True)
class Signs:
    """What a connection has checked: the members of `struct hd_hid_signs`."""

    number: int
    """Of this device, from 1; each is checked once."""
    axes: int
    """Bit 0 x, bit 1 y."""
    force_n: float
    least_m: float
    enough_m: float


class Check:
    """Which devices are to be checked, and how."""

    def __init__(self, travel_m: float, full_scale_force_n: float) -> None:
        """`travel_m`: half the handle's travel; `full_scale_force_n`: the device's largest force."""
        self._travel_m, self._force_n = travel_m, FORCE * full_scale_force_n
        self._numbers: dict[str, int] = {}

    def of(self, identity: str, axes: tuple[bool, bool], resolution_m: float) -> Signs | None:
        """For the device of this identity, whose axes that move and are pushed are these. A device that comes back is
        not checked again. None: no axis is both."""
        if not any(axes):
            return None
        number = self._numbers.setdefault(identity, len(self._numbers) + 1)
        least_m = max(LEAST * self._travel_m, _STEPS * resolution_m)
        return Signs(number, axes[0] | axes[1] << 1, self._force_n, least_m, max(ENOUGH * self._travel_m, least_m))


@dataclass(frozen=True, slots=True)
class SignsStatus:
    """What the servo reports of the check."""

    state: SignsState
    problem: SignsProblem
    axis: str

    @classmethod
    def read(cls, word: int) -> SignsStatus:
        """From `signs` of struct hd_counters."""
        problem = word >> lib.HD_SIGNS_PROBLEM_SHIFT & 0xFF
        axis = word >> lib.HD_SIGNS_AXIS_SHIFT & 0xFF
        return cls(SignsState(word & 0xFF), SignsProblem(problem), "xy"[axis])

    @property
    def holds_back(self) -> bool:
        """Forces are on, and the scene is not felt yet."""
        return self.state in (SignsState.CHECKING, SignsState.WAITING)

    @property
    def seen(self) -> str | None:
        """What is wrong or in the way; None: nothing."""
        seen = _SEEN.get(self.problem)
        return None if seen is None else seen.format(axis=self.axis, other="y" if self.axis == "x" else "x")

    @property
    def advice(self) -> str:
        """What to do about that."""
        if self.state == SignsState.WRONG:
            return CORRECT
        if self.state == SignsState.UNCLEAR:
            return f"let go of the handle and turn forces on again, or {CORRECT}"
        away = "move it away and " if self.problem == SignsProblem.CONTACT else ""
        return f"{away}let go of it"

    def line(self) -> str | None:
        """What was seen and what to do about it, in one line; None: there is nothing to do."""
        return None if self.seen is None else f"{self.seen}: {self.advice}"

    def to_dict(self) -> dict[str, object]:
        """For get_status."""
        named = self.state in (SignsState.CHECKING, SignsState.WRONG, SignsState.UNCLEAR)
        return {
            "state": self.state.name.lower(),
            "axis": self.axis if named else None,
            "problem": self.problem.name.lower() if self.problem else None,
            "advice": self.line(),
        }


class SignsLog:
    """Lines of the log: where the check has come to something, or waits for somebody; no line twice in a row."""

    def __init__(self) -> None:
        self._last: SignsStatus | None = None

    def note(self, status: SignsStatus) -> None:
        """How far the check is now."""
        line = status.line()
        if status == self._last or (line is None and status.state != SignsState.RIGHT):
            return
        self._last = status
        if line is None:
            _log.info("signs of the device checked: forces move the handle the right way")
        elif status.state == SignsState.WRONG:
            _log.error("signs of the device are wrong, forces stay off: %s", line)
        else:
            _log.warning("signs of the device are not known yet: %s", line)
