"""A rig: a device that strikes a mode and tells what happened. The simulated joystick without clock (SimRig), or a
device at its servo (ServoRig); both run the servo's own tick over a configuration's scene.

strike(mode, amplitude, direction)  strikes a mode, amplitude its coefficient; the tick that renders it first
run(duration_s)                     lets so much time pass; what was rendered in it, (n,) records of SAMPLE_DTYPE
with rig:                           at its end the force is zero
rate_hz, output                     of the servo, and how it renders for the device
hold_s                              how long the actuator holds a force: a period of the servo or of its link
force_steps_n                       steps of the actuator's force along x and y; 0: none are known

What they cannot do they raise as HapticdError.
"""

from __future__ import annotations

import time
from typing import Final, Self, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.base.core import EVENT_DTYPE, SAMPLE_DTYPE, Fault
from hapticd.base.errors import HapticdError
from hapticd.config.configuration import Config
from hapticd.config.modes import Mode
from hapticd.daemon.engine import SAMPLE_CAPACITY, Engine
from hapticd.protocol.events import fault_names
from hapticd.rendering.offline import CompiledScene, Samples, Simulation

POLL_S: Final = 0.005
STALLED_S: Final = 1.0
"""A servo that gives no sample for so long does not run."""
SIGNS_S: Final = 30.0
"""So long the check of a device's signs may wait for the handle to be let go."""


class SimRig:
    """The simulated joystick; the same on every run."""

    def __init__(self, config: Config) -> None:
        scene = CompiledScene(config)
        self.rate_hz, self.output, self.hold_s = scene.rate_hz, scene.output, 1.0 / scene.output.carried_hz
        step_n = config.device.sim.force_step_n
        self.force_steps_n = (step_n, step_n)
        self._simulation = Simulation(scene)
        self._ticks = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        """Nothing moves without `run`."""

    def strike(self, mode: Mode, amplitude_m_per_s2: float, direction: tuple[float, float]) -> int:
        self._simulation.strike(mode, amplitude_m_per_s2, direction)
        return self._ticks

    def run(self, duration_s: float) -> Samples:
        samples, _, _ = self._simulation.run(duration_s)
        self._ticks += len(samples)
        return samples


class ServoRig:
    """A device at a separate servo, as the daemon makes it. Forces are on from the start."""

    def __init__(self, config: Config) -> None:
        """Raises HapticdError where the device or the servo is not there."""
        self._engine = Engine(config)
        self.rate_hz = config.servo.rate_hz
        self.output = self._engine.output
        self.hold_s = 1.0 / self.output.carried_hz
        self.force_steps_n = self._engine.force_steps_n
        self._room = np.empty(SAMPLE_CAPACITY, SAMPLE_DTYPE)
        self._events = np.empty(1024, EVENT_DTYPE)
        self._begun = False
        try:
            self._engine.start()
            self._begun = True
            self._engine.set_forces(True)
            self._check_signs()
            self.run(2 * config.scene.ramp_s)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _check_signs(self) -> None:
        """Waits while the signs of a device are checked. Raises HapticdError where nobody lets it go on."""
        deadline = time.monotonic() + SIGNS_S
        while (signs := self._engine.counters().signs).holds_back:
            self.run(POLL_S)
            if time.monotonic() > deadline:
                raise HapticdError(f"stopped, the signs of the device are not known: {signs.line() or signs.advice}")

    def strike(self, mode: Mode, amplitude_m_per_s2: float, direction: tuple[float, float]) -> int:
        tick, _ = self._engine.play(mode, "coefficient", direction, amplitude_m_per_s2)
        return tick

    def run(self, duration_s: float) -> Samples:
        taken: list[Samples] = []
        wanted_ns = round(duration_s * 1e9)
        heard = time.monotonic()
        while True:
            self._engine.beat()
            count, dropped = self._engine.read_samples(self._room)
            self._engine.read_events(self._events)
            faults = self._engine.counters().faults
            if Fault.SIGNS in faults:
                raise HapticdError(f"stopped, the force is zero: {self._engine.counters().signs.line()}")
            if faults:
                raise HapticdError(f"stopped, the force is zero: fault {', '.join(fault_names(faults))}")
            if dropped:
                raise HapticdError("stopped: this machine does not keep up with the servo; try a lower servo.rate_hz")
            if count:
                heard = time.monotonic()
                taken.append(self._room[:count].copy())
                begun_ns, now_ns = int(taken[0]["time_ns"][0]), int(taken[-1]["time_ns"][-1])
                if now_ns - begun_ns >= wanted_ns:
                    return np.concatenate(taken)
            elif time.monotonic() - heard > STALLED_S:
                raise HapticdError("stopped: the servo gives no samples")
            time.sleep(POLL_S)

    def close(self) -> None:
        """Fades the force out, puts zero, and lets the device go."""
        if self._begun:
            self._begun = False
            self._engine.stop()


Rig: TypeAlias = SimRig | ServoRig


def rig_of(config: Config) -> Rig:
    """What strikes the device of a configuration. Raises HapticdError where the device or the servo is not there."""
    return SimRig(config) if config.device.kind == "sim" else ServoRig(config)


def on_grid(samples: Samples, rate_hz: float) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """The period of each sample since the first, (n,), and the sample whose force each period has, (periods,): one that
    the servo missed has that of the period before."""
    since_ns = samples["time_ns"] - samples["time_ns"][0]
    place = np.rint(since_ns * 1e-9 * rate_hz).astype(np.int64)
    latest = np.zeros(int(place[-1]) + 1, np.int64)
    latest[place] = np.arange(len(samples))
    return place, np.maximum.accumulate(latest)
