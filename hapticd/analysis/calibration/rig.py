"""Rigs: devices under test, which strike modes and return the rendered samples.

SimRig is the simulated joystick without a clock, ServoRig a device with its servo. Both render the scene of a
configuration with the servo's tick, raise HapticdError if they fail, and have the same members:

strike(mode, amplitude, direction)  strike a mode with this coefficient; return the first tick that renders it
run(duration_s)                     run for a time; return its samples, (n,) records of SAMPLE_DTYPE
with rig:                           when the `with` statement ends, the force is zero
rate_hz, output                     rate of the servo, and how it renders for the device
hold_s                              how long the actuator holds a force: a period of the servo or of its link
force_steps_n                       steps of the actuator's force along x and y, 0 if unknown
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

SERVO_POLL_INTERVAL_S: Final = 0.005
"""Time between two reads of the samples; their buffer takes far longer to fill."""
SERVO_STALL_TIMEOUT_S: Final = 1.0
"""A servo without a new sample for this time counts as stopped."""
SIGNS_CHECK_TIMEOUT_S: Final = 30.0
"""Time within which the user must release the handle, for the check of the signs of the device's forces."""


class SimRig:
    """The simulated joystick; runs are deterministic."""

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
        """Do nothing: the handle moves only during `run`."""

    def strike(self, mode: Mode, amplitude_m_per_s2: float, direction: tuple[float, float]) -> int:
        """Strike a mode with this coefficient A; return the first tick that renders it."""
        self._simulation.strike(mode, amplitude_m_per_s2, direction)
        return self._ticks

    def run(self, duration_s: float) -> Samples:
        """Run for a time; return the samples rendered in it."""
        samples, _, _ = self._simulation.run(duration_s)
        self._ticks += len(samples)
        return samples


class ServoRig:
    """A device whose servo runs in this process, started as in the daemon, with the forces on."""

    def __init__(self, config: Config) -> None:
        """Start the servo. Raises HapticdError if the device or the servo cannot be started."""
        self._engine = Engine(config)
        self.rate_hz = config.servo.rate_hz
        self.output = self._engine.output
        self.hold_s = 1.0 / self.output.carried_hz
        self.force_steps_n = self._engine.force_steps_n
        self._room = np.empty(SAMPLE_CAPACITY, SAMPLE_DTYPE)
        self._events = np.empty(1024, EVENT_DTYPE)
        self._started = False
        try:
            self._engine.start()
            self._started = True
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
        """Wait until the servo has checked the signs of the forces. Raises HapticdError after SIGNS_CHECK_TIMEOUT_S."""
        deadline = time.monotonic() + SIGNS_CHECK_TIMEOUT_S
        while (signs := self._engine.counters().signs).holds_back:
            self.run(SERVO_POLL_INTERVAL_S)
            if time.monotonic() > deadline:
                raise HapticdError(f"stopped, the signs of the device are unknown: {signs.line() or signs.advice}")

    def strike(self, mode: Mode, amplitude_m_per_s2: float, direction: tuple[float, float]) -> int:
        """Strike a mode with this coefficient A; return the first tick that renders it."""
        tick, _ = self._engine.play(mode, "coefficient", direction, amplitude_m_per_s2)
        return tick

    def run(self, duration_s: float) -> Samples:
        """Run for a time; return the samples rendered in it. Raises HapticdError on a fault or lost samples."""
        taken: list[Samples] = []
        wanted_ns = round(duration_s * 1e9)
        latest_s = time.monotonic()
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
                latest_s = time.monotonic()
                taken.append(self._room[:count].copy())
                begun_ns, now_ns = int(taken[0]["time_ns"][0]), int(taken[-1]["time_ns"][-1])
                if now_ns - begun_ns >= wanted_ns:
                    return np.concatenate(taken)
            elif time.monotonic() - latest_s > SERVO_STALL_TIMEOUT_S:
                raise HapticdError(f"stopped: the servo has rendered no sample for {SERVO_STALL_TIMEOUT_S:g} s")
            time.sleep(SERVO_POLL_INTERVAL_S)

    def close(self) -> None:
        """Fade the force out, set it to zero, and close the device."""
        if self._started:
            self._started = False
            self._engine.stop()


Rig: TypeAlias = SimRig | ServoRig


def rig_of(config: Config) -> Rig:
    """Return the rig for the configured device. Raises HapticdError if the device or the servo cannot be started."""
    return SimRig(config) if config.device.kind == "sim" else ServoRig(config)


def on_grid(samples: Samples, rate_hz: float) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return the period of each sample, and the sample of each period.

    The first array (n,) counts periods from the first sample. The second (periods,) holds the index of the sample whose
    force acts in a period: in a missed period, that of the previous sample.
    """
    since_ns = samples["time_ns"] - samples["time_ns"][0]
    place = np.rint(since_ns * 1e-9 * rate_hz).astype(np.int64)
    latest = np.zeros(int(place[-1]) + 1, np.int64)
    latest[place] = np.arange(len(samples))
    return place, np.maximum.accumulate(latest)
