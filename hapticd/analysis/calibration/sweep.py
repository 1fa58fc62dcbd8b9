"""The drive: bursts of one frequency after the other, from the middle down, then up.

A burst is a slowly decaying mode, struck in turn to one side and to the other. A soft spring to the middle, whose
force is part of the recorded one, brings a free handle back. The strength of each burst follows from how far the one
before it went, so that the handle stays in the middle third of its travel; it is never more than `LARGEST_PART` of the
limit, which leaves the spring its part.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from hapticd.analysis.calibration.rig import Rig, on_grid
from hapticd.base.core import Flag
from hapticd.base.errors import HapticdError
from hapticd.config.configuration import Config, Hand
from hapticd.config.modes import Mode
from hapticd.config.scene import Display, Scene, Spring
from hapticd.rendering.offline import Samples

SPRING: Final = Spring(kind="spring", center_m=(0.0, 0.0), stiffness_n_per_m=20.0, damping_n_s_per_m=0.3)
FIRST_HZ: Final = 60.0
HIGHEST_HZ: Final = 1600.0
"""As far as the paper measured."""
BURST_DECAYS: Final = 3.0
"""A burst's length, in times in which it falls to 1/e."""
LARGEST_PART: Final = 0.8
LEAD_S: Final = 0.06
"""A burst is evaluated from so long before it on; a delay may be as long."""
FORGOTTEN_S: Final = 0.03
"""A force that was not renewed for so long may have expired."""
REST_S: Final = 0.1
CHUNK_S: Final = 0.02
MIDDLE_PART: Final = 1.0 / 3.0
"""The part of the travel that the handle may not leave."""

Floats = npt.NDArray[np.float64]
Axis = Literal["x", "y"]


@dataclass(frozen=True, slots=True)
class Burst:
    """One burst of the drive."""

    frequency_hz: float
    force_n: float
    """Its coefficient; negative: to the other side."""
    begin: int
    """The period at which it begins."""
    end: int


@dataclass(frozen=True, slots=True)
class Record:
    """What a drive gave along its axis, one number a servo period."""

    rate_hz: float
    hold_s: float
    """How long the actuator holds a force."""
    held: bool
    force_n: Floats
    """(n,) the command, in the steps of the actuator where these are known."""
    position_m: Floats
    """(n,) what was reported; NaN at periods without a new report."""
    bursts: tuple[Burst, ...]
    left_out: int = 0
    """Bursts during which the servo stalled."""

    @property
    def step_m(self) -> float:
        """The smallest step between positions; 0 where the handle never moved."""
        known = self.position_m[~np.isnan(self.position_m)]
        steps = np.abs(np.diff(known))
        return float(steps[steps > 0].min(initial=np.inf)) if np.any(steps > 0) else 0.0


def sweep_config(config: Config, *, held: bool, force_n: float) -> Config:
    """The configuration with nothing in its scene but the spring, with this limit of force, and in newton: a mode's
    coefficient is a force. Of a simulated joystick the hand is taken off unless `held`."""
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
    scene = Scene(display=Display(), objects={"middle": SPRING})
    return config.model_copy(update={"device": device.model_copy(update=plain), "scene": scene})


def travel_m(config: Config) -> float:
    """From the middle to the end of the handle's travel."""
    return config.device.sim.workspace_m if config.device.kind == "sim" else config.device.hid.travel_m


class Sweep:
    """A drive along one axis of a rig; up to `highest_hz`, however little moves, or (None) as far as the encoder sees
    it. `progress` is called with what is done."""

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
        self._most_n = LARGEST_PART * limit_n
        self._taken: list[Samples] = []
        self._bursts: list[tuple[float, float, int, int]] = []

    def run(self) -> Record:
        """Drives. Raises HapticdError where the handle leaves the middle third, or does not move."""
        # Before the free handle is driven, the noise of its positions is measured.
        self._let(REST_S if self._held else 1.0)
        for force in (self._most_n / 4, self._most_n):
            reach = self._burst(FIRST_HZ, force)
            step = self._record().step_m
            if reach >= 2 * step > 0.0:
                break
        else:
            raise HapticdError(
                f"the handle does not move under {self._most_n:g} N at {FIRST_HZ:g} Hz along {'xy'[self._along]}: "
                "`hapticd devices calibrate` says what a HID device is sent; --force-n gives more force"
            )
        self._go(reach, force, self._down())
        self._go(reach, force, self._up(reach * self._most_n / force, step))
        self._let(REST_S)
        return self._record()

    def _down(self) -> Iterator[float]:
        frequency = FIRST_HZ
        while frequency >= (1.5 if self._held else 2.0):
            yield frequency
            frequency /= 1.4

    def _up(self, reach_m: float, step_m: float) -> Iterator[float]:
        """Up to where the motion, `reach_m` at FIRST_HZ under the most force, falls below a step, or the highest that
        is asked for."""
        frequency = 1.25 * FIRST_HZ
        while frequency <= 0.4 / self._rig.hold_s:
            seen = reach_m * (FIRST_HZ / frequency) ** 2 >= step_m
            if not seen and (self._highest_hz is None or frequency > self._highest_hz):
                return
            yield frequency
            frequency *= 1.25

    def _go(self, reach_m: float, force_n: float, frequencies: Iterator[float]) -> None:
        """Bursts at these frequencies, after one at FIRST_HZ that reached so far."""
        # A burst is meant to use 0.4 of the middle third.
        allowed = 0.4 * MIDDLE_PART * self._travel_m
        # Around its resonance, a held handle tells its mass.
        twice_hz = 5.0 if self._held else 20.0
        before = FIRST_HZ
        for frequency in frequencies:
            # What a mass does; a spring and friction do less, and no burst is more than twice as strong as the one
            # before.
            likely = max(reach_m, 1e-9) * (before / frequency) ** 2
            force_n = min(self._most_n, force_n * min(2.0, allowed / likely))
            force_n = max(force_n, 0.02 * self._most_n)
            sides = (force_n, -force_n) * (2 if frequency >= twice_hz else 1)
            reach_m = max(self._burst(frequency, side) for side in sides)
            before = frequency

    def _burst(self, frequency_hz: float, force_n: float) -> float:
        """How far the handle went."""
        self._progress(f"{'held' if self._held else 'free'}: {frequency_hz:.3g} Hz, {abs(force_n):.2g} N")
        # It falls to 1/e in three cycles.
        decay_s = min(0.7, max(0.05, 3.0 / frequency_hz))
        mode = Mode(1.0 / decay_s, 2 * math.pi * frequency_hz)
        side = math.copysign(1.0, force_n)
        tick = self._rig.strike(mode, abs(force_n), (side, 0.0) if self._along == 0 else (0.0, side))
        positions = self._let(BURST_DECAYS * decay_s)
        self._bursts.append((frequency_hz, force_n, tick, tick + round(BURST_DECAYS * decay_s * self._rig.rate_hz)))
        return float(np.ptp(positions))

    def _let(self, duration_s: float) -> Floats:
        """Lets time pass, and watches where the handle goes."""
        seen = []
        left_s = duration_s
        while left_s > 0:
            samples = self._rig.run(min(left_s, CHUNK_S))
            left_s -= CHUNK_S
            self._taken.append(samples)
            positions = samples["position_m"][:, self._along]
            farthest = float(np.abs(positions).max())
            if farthest > MIDDLE_PART * self._travel_m:
                raise HapticdError(
                    f"stopped, the force is zero: the handle left the middle third of its travel, {1e3 * farthest:.1f} "
                    f"of {1e3 * self._travel_m:g} mm; bring it to the middle, or use less force (--force-n)"
                )
            seen.append(positions)
        return np.concatenate(seen)

    def _record(self) -> Record:
        """On the grid of periods: those that the servo missed hold the force before them, and no position."""
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
        # A device lets a force expire that is not renewed; what it did then is not known.
        lost = place[:-1][np.diff(place) > FORGOTTEN_S * rate_hz]
        bursts = []
        for frequency, strength, tick, end in self._bursts:
            begin = int(place[min(tick - first, len(place) - 1)])
            burst = Burst(frequency, strength, begin, min(count, begin + end - tick))
            if not np.any((lost >= begin - LEAD_S * rate_hz - 1) & (lost < burst.end)):
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
