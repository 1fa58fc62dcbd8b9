"""A device that strikes a mode and tells what happened: the simulated joystick without clock, or a device at its servo.

Both run the servo's own tick over a configuration's scene.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from hapticd.base.core import EVENT_DTYPE, SAMPLE_DTYPE, Fault, Status, ffi, invalid_reason, lib, pointer, records
from hapticd.base.errors import HapticdError
from hapticd.config.configuration import Config
from hapticd.config.modes import Mode
from hapticd.daemon.engine import SAMPLE_CAPACITY, Engine
from hapticd.protocol.events import fault_names
from hapticd.rendering.compiler.mode_record import mode_record
from hapticd.rendering.compiler.table import Compiler
from hapticd.rendering.device_output import Output, output_of
from hapticd.rendering.joystick import new_sim
from hapticd.rendering.offline import Samples, new_world

POLL_S: Final = 0.005
STALLED_S: Final = 1.0
"""A servo that gives no sample for so long does not run."""


SIGNS_S: Final = 30.0
"""So long the check of a device's signs may wait for the handle to be let go."""


class Rig(ABC):
    """What is struck, and goes on for a while. Use as a context: at its end the force is zero."""

    rate_hz: float
    output: Output
    hold_s: float
    """How long the actuator holds a force: a period of the servo or of its link."""
    force_steps_n: tuple[float, float]
    """Steps of the actuator's force along x and y; 0: none are known."""

    @abstractmethod
    def strike(self, mode: Mode, amplitude_m_per_s2: float, direction: tuple[float, float]) -> int:
        """Strikes a mode, amplitude its coefficient; the tick that renders it first. Raises HapticdError."""

    @abstractmethod
    def run(self, duration_s: float) -> Samples:
        """Lets so much time pass; what was rendered in it, (n,) records of SAMPLE_DTYPE. Raises HapticdError."""

    @abstractmethod
    def close(self) -> None:
        """Takes the force away."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


class SimRig(Rig):
    """The simulated joystick; the same on every run."""

    def __init__(self, config: Config) -> None:
        self.config = config
        self.rate_hz = config.servo.rate_hz
        self.output = output_of(config, self.rate_hz)
        self.hold_s = 1.0 / self.output.carried_hz
        compiler = Compiler(self.output)
        self._world = new_world(compiler.update(config.scene, config.scene.objects, config.materials, 1))
        sim = config.device.sim
        self.force_steps_n = (sim.force_step_n, sim.force_step_n)
        self._sim = new_sim(sim, self.rate_hz)
        state = lib.hd_state_new(max(1, len(config.scene.objects)))
        if state == ffi.NULL:
            raise MemoryError("no memory for the state of a run")
        self._state = ffi.gc(state, lib.hd_state_free)
        lib.hd_state_set_resolution(self._state, sim.encoder_step_m)
        self._events = records(EVENT_DTYPE, 1024)
        self._event_count = ffi.new("size_t *")
        self.ticks = 0
        self.truth: list[npt.NDArray[np.float64]] = []
        """Of each stretch that ran: (n, 4), true position and velocity at the ticks."""

    def strike(self, mode: Mode, amplitude_m_per_s2: float, direction: tuple[float, float]) -> int:
        played = ffi.new("struct hd_mode *", mode_record(mode, 1.0, 1.0, self.output))
        length = math.hypot(*direction)
        unit = ffi.new("double[2]", [direction[0] / length, direction[1] / length])
        status = lib.hd_play(self._state, played, unit, amplitude_m_per_s2)
        if status != Status.OK:
            raise HapticdError(f"a mode cannot be struck: {invalid_reason()}")
        return self.ticks

    def run(self, duration_s: float) -> Samples:
        count = max(1, round(duration_s * self.rate_hz))
        samples = np.empty(count, SAMPLE_DTYPE)
        truth = np.empty((count, 4))
        status = lib.hd_simulate(
            self._world,
            self._state,
            self._sim,
            count,
            pointer("struct hd_sample[]", samples),
            pointer("double[]", truth),
            pointer("struct hd_event[]", self._events),
            len(self._events),
            self._event_count,
        )
        if status == Status.ERR_MEMORY:
            raise MemoryError("no memory for a run")
        if status != Status.OK:
            raise HapticdError(f"the scene cannot be rendered: {invalid_reason()}")
        self.truth.append(truth)
        self.ticks += count
        return samples

    def close(self) -> None:
        """Nothing moves without `run`."""


class ServoRig(Rig):
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
            faults = self._engine.faults()
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


def rig_of(config: Config, real: bool | None = None) -> Rig:
    """What strikes the device of a configuration. `real`: at a servo with its clock; None: unless it is simulated.

    Raises HapticdError where the device or the servo is not there.
    """
    simulated = config.device.kind == "sim" if real is None else not real
    return SimRig(config) if simulated else ServoRig(config)


def on_grid(samples: Samples, rate_hz: float) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """The period of each sample since the first, (n,), and the sample whose force each period has, (periods,): one that
    the servo missed has that of the period before."""
    since_ns = samples["time_ns"] - samples["time_ns"][0]
    place = np.rint(since_ns * 1e-9 * rate_hz).astype(np.int64)
    latest = np.zeros(int(place[-1]) + 1, np.int64)
    latest[place] = np.arange(len(samples))
    return place, np.maximum.accumulate(latest)
