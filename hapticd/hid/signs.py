"""Parameters, state and log of the check of a device's signs (csrc/device/hd_signs.h), before the scene's first force.

The signs are right if a force along an axis moves the handle along the same axis, in the same direction.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Final

from hapticd.base import wording
from hapticd.base.core import HidMeaning, SignsProblem, SignsState, lib
from hapticd.hid.device_texts import LET_GO
from hapticd.system.repeated_lines import MAX_STATE_INTERVAL_S, Repeats

PULSE_FORCE_SHARE: Final = 0.1
"""Force of a pulse by which the check pushes the handle, as a fraction of the device's largest force."""
MIN_PULSE_MOTION_SHARE: Final = 0.005
"""A smaller motion during a pulse does not count, as a fraction of the handle's half travel."""
PULSE_END_MOTION_SHARE: Final = 0.1
"""A pulse ends early once the handle has moved by this fraction of its half travel."""
_MIN_MOTION_ENCODER_STEPS: Final = 2.0
"""A smaller motion during a pulse does not count, in steps of the encoder."""
_PROBLEM_TEXTS: Final[dict[SignsProblem, str]] = {
    SignsProblem.REVERSED: "a force along {axis} moves the handle the other way",
    SignsProblem.SWAPPED: "a force along {axis} moves the handle along {other}",
    SignsProblem.STILL: "the handle did not move when it was pushed along {axis}",
    SignsProblem.UNCERTAIN: "the handle did not clearly follow when it was pushed along {axis}",
    SignsProblem.MOVING: "the handle does not come to rest",
    SignsProblem.CONTACT: "the handle touches an object of the scene",
}
_IDLE_TEXTS: Final[dict[HidMeaning, tuple[str, str]]] = {
    HidMeaning.POWER: ("its actuators have no power", "plug the power supply in (or release its emergency stop)"),
    HidMeaning.SAFETY: (
        "its safety switch is open",
        "hold the handle lightly and still (or release its emergency stop)",
    ),
    HidMeaning.ACTUATORS: ("its actuators are off", "switch the device's actuators on, or plug the device in again"),
    HidMeaning.PAUSED: ("it is paused", "end the program that paused it"),
    HidMeaning.RESET: ("it was reset", "wait until it is set up again"),
}
"""For each state in which a device exerts no force: what the device reports, and what the user should do."""
STILL_ADVICE: Final = f"{LET_GO}, release its emergency stop, switch it to a work mode with force feedback"
"""What the user should do if the handle does not move, and the device does not report why."""
SIGNS_REMEDY: Final = (
    "run `hapticd devices calibrate` to find device.hid.force_axes, or set device.hid.signs: trust without "
    "device_version to skip the check"
)

_log = logging.getLogger("hapticd")


def idle_texts(idle: int) -> tuple[str, str]:
    """Return why a device exerts no force, and what the user should do; `idle` is that of `SignsStatus`, not 0."""
    causes, remedies = zip(*(texts for meaning, texts in _IDLE_TEXTS.items() if idle >> (meaning - 1) & 1), strict=True)
    return f"the device exerts no force because {wording.listed(causes)}", wording.listed(remedies)


@dataclass(frozen=True, slots=True)
class Signs:
    """Parameters of the check whether one device's forces push the right way, as C's `struct hd_hid_signs`."""

    number: int
    """Number of the device, from 1; each device is checked once."""
    axes: int
    """The axes that are checked: bit 0 x, bit 1 y."""
    force_n: float
    """Force of the pulse by which the check pushes the handle."""
    least_m: float
    """Smallest mean motion during a pulse that counts as a motion."""
    enough_m: float
    """Motion of the handle after which a pulse ends early."""


class Check:
    """Provides, for each connected device, the parameters of the check whether its forces push the right way."""

    def __init__(self, travel_m: float, full_scale_force_n: float, trusted_version: int | None = None) -> None:
        """Use half the handle's travel, `travel_m`, and the device's largest force, `full_scale_force_n`.

        A device of the version `trusted_version` (bcdDevice) is not checked; None: every device is checked.
        """
        self._travel_m, self._force_n = travel_m, PULSE_FORCE_SHARE * full_scale_force_n
        self._trusted_version = trusted_version
        self._numbers: dict[str, int] = {}

    def why(self, version: int | str | None) -> str | None:
        """Return why a device that would be trusted is checked: it shows another version. None: it is not another."""
        if self._trusted_version in (None, version):
            return None
        shows = f"0x{version:04x}" if isinstance(version, int) else "none"
        action = f"set device_version: {shows}" if isinstance(version, int) else "remove device_version"
        return (
            f"device.hid.device_version is 0x{self._trusted_version:04x}, the device shows {shows}: "
            f"its signs are checked before the first force, at each start; if they are right, {action}"
        )

    def of(
        self, identity: str, axes: tuple[bool, bool], resolution_m: float, version: int | str | None = None
    ) -> Signs | None:
        """Return the parameters for a device; None if it is trusted, or has no axis with both a position and a force.

        `axes` says for x and y whether the axis has both; `resolution_m` is the step of positions. Each device has a
        number, which it keeps when it is connected again: the core checks a number only once.
        """
        trusted = self._trusted_version is not None and version == self._trusted_version
        if trusted or not any(axes):
            return None
        number = self._numbers.setdefault(identity, len(self._numbers) + 1)
        least_m = max(MIN_PULSE_MOTION_SHARE * self._travel_m, _MIN_MOTION_ENCODER_STEPS * resolution_m)
        enough_m = max(PULSE_END_MOTION_SHARE * self._travel_m, least_m)
        return Signs(number, axes[0] | axes[1] << 1, self._force_n, least_m, enough_m)


@dataclass(frozen=True, slots=True)
class SignsStatus:
    """The state of the check whether forces push the right way, as the servo reports it."""

    state: SignsState
    problem: SignsProblem
    axis: str
    idle: int = 0
    """Why the device exerts no force, for the problem `IDLE`: bit (m - 1) for each HidMeaning m."""

    @classmethod
    def read(cls, word: int) -> SignsStatus:
        """Decode the state from the member `signs` of C's `struct hd_counters`."""
        problem = word >> lib.HD_SIGNS_PROBLEM_SHIFT & 0xFF
        axis = word >> lib.HD_SIGNS_AXIS_SHIFT & 0xFF
        return cls(SignsState(word & 0xFF), SignsProblem(problem), "xy"[axis], word >> lib.HD_SIGNS_IDLE_SHIFT)

    @property
    def holds_back(self) -> bool:
        """Whether forces are on, but the scene's forces are held back until the check has ended."""
        return self.state in (SignsState.CHECKING, SignsState.WAITING)

    @property
    def problem_text(self) -> str | None:
        """What is wrong with the signs, or what prevents the check; None without a problem."""
        if self.problem == SignsProblem.IDLE:
            return idle_texts(self.idle)[0]
        text = _PROBLEM_TEXTS.get(self.problem)
        return None if text is None else text.format(axis=self.axis, other="y" if self.axis == "x" else "x")

    @property
    def advice(self) -> str:
        """What the user should do about the problem that the check found."""
        if self.state == SignsState.WRONG:
            return SIGNS_REMEDY
        if self.problem == SignsProblem.IDLE:
            return idle_texts(self.idle)[1]
        if self.problem == SignsProblem.STILL:
            again = ", then turn forces on again" if self.state == SignsState.UNCLEAR else ""
            return (
                f"{STILL_ADVICE}{again}; if friction or a dead band takes {100 * PULSE_FORCE_SHARE:g} % of the largest "
                "force, set device.hid.force_axes by hand, or device.hid.signs: trust to skip the check"
            )
        if self.state == SignsState.UNCLEAR:
            return f"{LET_GO}, and turn forces on again, or {SIGNS_REMEDY}"
        return f"{'move it away, then ' if self.problem == SignsProblem.CONTACT else ''}{LET_GO}"

    def line(self) -> str | None:
        """Return the problem of the signs and the advice in one line; None without a problem."""
        return None if self.problem_text is None else f"{self.problem_text}: {self.advice}"

    def to_dict(self) -> dict[str, object]:
        """Return the state as a map: the member `signs` of the status that clients request."""
        named = self.state in (SignsState.CHECKING, SignsState.WRONG, SignsState.UNCLEAR)
        return {
            "state": self.state.name.lower(),
            "axis": self.axis if named else None,
            "problem": self.problem.name.lower() if self.problem else None,
            "advice": self.line(),
        }


class SignsLog:
    """Logs, after each change, the result of the check whether forces push the right way, or what prevents it."""

    def __init__(self) -> None:
        self._last: SignsStatus | None = None
        self._repeats = Repeats()

    def note(self, status: SignsStatus) -> None:
        """Log the state of the check of signs, if it differs from the state that was logged last."""
        self._repeats.flush()
        line = status.line()
        if status == self._last or (line is None and status.state != SignsState.RIGHT):
            return
        self._last = status
        if line is None:
            text = "the signs of the device are right: forces are displayed"
            self._repeats.line("right", logging.INFO, text)
        elif status.problem == SignsProblem.IDLE:
            self._repeats.line("idle", logging.WARNING, f"forces are held back: {line}", MAX_STATE_INTERVAL_S)
        elif status.state == SignsState.WRONG:
            _log.error("signs of the device are wrong, forces stay off: %s", line)
        else:
            _log.warning("signs of the device are not known yet: %s", line)
