"""The drive of a calibration: bursts at one frequency each, from FIRST_BURST_HZ downwards, then upwards.

A burst is a slowly decaying mode, struck in alternating directions. A soft spring returns a free handle to the middle;
the spring's force is recorded, too. The motion in each burst determines the force of the next one, which keeps the
handle in the middle third of its travel. A burst's force is at most MAX_BURST_FORCE_FRACTION of the force limit, which
leaves a reserve for the spring.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from hapticd.analysis.calibration.rig import Rig, on_grid
from hapticd.analysis.statistics import Floats
from hapticd.base.core import Flag
from hapticd.base.errors import HapticdError
from hapticd.config.configuration import Config, Hand
from hapticd.config.modes import Mode
from hapticd.config.scene import Display, Scene, Spring
from hapticd.rendering.offline import Samples

CENTERING_SPRING: Final = Spring(kind="spring", center_m=(0.0, 0.0), stiffness_n_per_m=20.0, damping_n_s_per_m=0.3)
"""Spring that returns a free handle to the middle, and too soft to affect a burst noticeably."""
FIRST_BURST_HZ: Final = 60.0
"""Frequency of the first burst, in the middle of the range."""
MAX_BURST_HZ: Final = 1600.0
"""Highest frequency of a drive with an accelerometer, as in the measurements of the paper."""
BURST_DECAYS: Final = 3.0
MAX_BURST_FORCE_FRACTION: Final = 0.8
"""Largest force of a burst as a fraction of the force limit; the rest is a reserve for the spring."""
BURST_LEAD_TIME_S: Final = 0.06
"""A burst is fitted from this time before its begin. The longest delay that can be fitted is about as long."""
FORCE_EXPIRY_TIME_S: Final = 0.03
"""A device may end a force that is not renewed for this time."""
DRIVE_REST_TIME_S: Final = 0.1
"""Time before and after the bursts."""
RUN_CHUNK_TIME_S: Final = 0.02
"""Longest time between two checks of the handle's position."""
MAX_TRAVEL_FRACTION: Final = 1.0 / 3.0
"""Fraction of the travel, about the middle, within which the handle must stay."""

Axis = Literal["x", "y"]


@dataclass(frozen=True, slots=True)
class Burst:
    """A burst of the drive: a decaying mode of one frequency."""

    frequency_hz: float
    force_n: float
    """Coefficient of the mode as a force, negative if struck in the negative direction of the axis."""
    begin: int
    """First servo period of the burst."""
    end: int
    """First servo period after the burst."""


@dataclass(frozen=True, slots=True)
class Record:
    """Force and position along the axis of a drive, with one value per servo period."""

    rate_hz: float
    hold_s: float
    """Time for which the actuator holds a force."""
    held: bool
    """Whether a hand held the handle."""
    force_n: Floats
    """Commanded force (n,), rounded to the actuator's steps if these are known."""
    position_m: Floats
    """Measured position (n,); NaN in periods without a new one."""
    bursts: tuple[Burst, ...]
    left_out: int = 0
    """Number of bursts that are excluded because the servo stalled during them."""

    @property
    def step_m(self) -> float:
        """Smallest step between two measured positions; 0 if the handle never moved."""
        known = self.position_m[~np.isnan(self.position_m)]
        steps = np.abs(np.diff(known))
        return float(steps[steps > 0].min(initial=np.inf)) if np.any(steps > 0) else 0.0


def sweep_config(config: Config, *, held: bool, force_n: float) -> Config:
    """Return the configuration of a drive: a scene with only the centering spring, and the force limit `force_n`.

    The effective mass is 1 kg, so that a mode's coefficient is a force in newton. The simulated hand is removed unless
    `held`.
    """
    device = config.device
    sim = (
        device.sim
        if held
        else device.sim.model_copy(update={"hand": Hand(mass_kg=0, stiffness_n_per_m=0, damping_n_s_per_m=0)})
    )
    plain = {
        "max_force_n": force_n,
        "effective_mass_kg": 1.0,
        "undisplayable": "mute",
        "compensation": "off",
        "sim": sim,
    }
    scene = Scene(display=Display(), objects={"middle": CENTERING_SPRING})
    return config.model_copy(update={"device": device.model_copy(update=plain), "scene": scene})


def travel_m(config: Config) -> float:
    """Return the distance from the middle to the end of the handle's travel."""
    return config.device.sim.workspace_m if config.device.kind == "sim" else config.device.hid.travel_m


class Sweep:
    """A drive (sequence of bursts) along one axis of a rig.

    The drive ends at `highest_hz`, by default when the motion falls below a step of the encoder. `progress` is called
    with a text for each burst.
    """

    def __init__(
        self,
        rig: Rig,
        progress: Callable[[str], None],
        axis: Axis,
        held: bool,
        limit_n: float,
        travel_m: float,
        highest_hz: float | None = None,
    ) -> None:
        self._rig, self._progress = rig, progress
        self._along = 0 if axis == "x" else 1
        self._held, self._travel_m, self._highest_hz = held, travel_m, highest_hz
        self._max_n = MAX_BURST_FORCE_FRACTION * limit_n
        self._taken: list[Samples] = []
        self._bursts: list[tuple[float, float, int, int]] = []

    def run(self) -> Record:
        """Play all bursts; return their record.

        Raises HapticdError if the handle leaves the middle third of its travel or does not move.
        """
        # The noise of the positions is measured before the free handle is driven.
        self._wait(DRIVE_REST_TIME_S if self._held else 1.0)
        for force in (self._max_n / 4, self._max_n):
            reach = self._play_burst(FIRST_BURST_HZ, force)
            step = self._record().step_m
            if reach >= 2 * step > 0.0:
                break
        else:
            raise HapticdError(
                f"the handle does not move under {self._max_n:g} N at {FIRST_BURST_HZ:g} Hz along {'xy'[self._along]}: "
                "use more force (--force-n); `hapticd devices calibrate` shows the forces that a HID device receives"
            )
        self._play_bursts(reach, force, self._falling_frequencies())
        self._play_bursts(reach, force, self._rising_frequencies(reach * self._max_n / force, step))
        self._wait(DRIVE_REST_TIME_S)
        return self._record()

    def _falling_frequencies(self) -> Iterator[float]:
        frequency = FIRST_BURST_HZ
        while frequency >= (1.5 if self._held else 2.0):
            yield frequency
            frequency /= 1.4

    def _rising_frequencies(self, reach_m: float, step_m: float) -> Iterator[float]:
        """Yield rising frequencies as long as the expected motion is at least `step_m`, then up to `highest_hz`.

        `reach_m` is the motion at FIRST_BURST_HZ under the largest force of a burst.
        """
        frequency = 1.25 * FIRST_BURST_HZ
        while frequency <= 0.4 / self._rig.hold_s:
            measurable = reach_m * (FIRST_BURST_HZ / frequency) ** 2 >= step_m
            if not measurable and (self._highest_hz is None or frequency > self._highest_hz):
                return
            yield frequency
            frequency *= 1.25

    def _play_bursts(self, reach_m: float, force_n: float, frequencies: Iterator[float]) -> None:
        """Play bursts of these frequencies; at FIRST_BURST_HZ, `force_n` moved the handle by `reach_m`."""
        # A burst should move the handle by 0.4 of the middle third.
        allowed = 0.4 * MAX_TRAVEL_FRACTION * self._travel_m
        # The resonance of a held handle determines its mass: bursts above 5 Hz are played twice.
        twice_hz = 5.0 if self._held else 20.0
        before = FIRST_BURST_HZ
        for frequency in frequencies:
            # Expected motion of a mass; spring and friction reduce it. The force at most doubles from burst to burst.
            likely = max(reach_m, 1e-9) * (before / frequency) ** 2
            force_n = min(self._max_n, force_n * min(2.0, allowed / likely))
            force_n = max(force_n, 0.02 * self._max_n)
            sides = (force_n, -force_n) * (2 if frequency >= twice_hz else 1)
            reach_m = max(self._play_burst(frequency, side) for side in sides)
            before = frequency

    def _play_burst(self, frequency_hz: float, force_n: float) -> float:
        """Play a burst; return the peak-to-peak motion of the handle in m."""
        self._progress(f"{'held' if self._held else 'free'}: {frequency_hz:.3g} Hz, {abs(force_n):.2g} N")
        # The decay time is three cycles, within limits.
        decay_s = min(0.7, max(0.05, 3.0 / frequency_hz))
        mode = Mode(1.0 / decay_s, 2 * math.pi * frequency_hz)
        side = math.copysign(1.0, force_n)
        tick = self._rig.strike(mode, abs(force_n), (side, 0.0) if self._along == 0 else (0.0, side))
        positions = self._wait(BURST_DECAYS * decay_s)
        self._bursts.append((frequency_hz, force_n, tick, tick + round(BURST_DECAYS * decay_s * self._rig.rate_hz)))
        return float(np.ptp(positions))

    def _wait(self, duration_s: float) -> Floats:
        """Run the rig for a time; return the positions (n,) in m.

        Raises HapticdError if the handle leaves the middle third of its travel.
        """
        found = []
        left_s = duration_s
        while left_s > 0:
            samples = self._rig.run(min(left_s, RUN_CHUNK_TIME_S))
            left_s -= RUN_CHUNK_TIME_S
            self._taken.append(samples)
            positions = samples["position_m"][:, self._along]
            farthest = float(np.abs(positions).max())
            if farthest > MAX_TRAVEL_FRACTION * self._travel_m:
                raise HapticdError(
                    f"stopped, the force is zero: the handle left the middle third of its travel, {1e3 * farthest:.1f} "
                    f"of {1e3 * self._travel_m:g} mm; bring it to the middle, or use less force (--force-n)"
                )
            found.append(positions)
        return np.concatenate(found)

    def _record(self) -> Record:
        """Return the record of all bursts until now. Missed periods have the previous force and no position."""
        samples = np.concatenate(self._taken)
        rate_hz = self._rig.rate_hz
        place, holding = on_grid(samples, rate_hz)
        count = len(holding)
        position = np.full(count, np.nan)
        new = (samples["flags"] & Flag.REPEATED) == 0
        position[place[new]] = samples["position_m"][new, self._along]
        force = samples["force_n"][holding, self._along]
        step_n = self._rig.force_steps_n[self._along]
        if step_n > 0:
            force = np.rint(force / step_n) * step_n
        first = int(samples["tick"][0])
        # A device may drop a force that is not renewed; bursts with such a gap are excluded.
        lost = place[:-1][np.diff(place) > FORCE_EXPIRY_TIME_S * rate_hz]
        bursts = []
        for frequency, strength, tick, end in self._bursts:
            begin = int(place[min(tick - first, len(place) - 1)])
            burst = Burst(frequency, strength, begin, min(count, begin + end - tick))
            if not np.any((lost >= begin - BURST_LEAD_TIME_S * rate_hz - 1) & (lost < burst.end)):
                bursts.append(burst)
        return Record(
            rate_hz=rate_hz,
            hold_s=self._rig.hold_s,
            held=self._held,
            force_n=np.ascontiguousarray(force, dtype=np.float64),
            position_m=position,
            bursts=tuple(bursts),
            left_out=len(self._bursts) - len(bursts),
        )
