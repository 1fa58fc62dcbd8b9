"""The engine: the scene, its compiled table, and the servo that renders it. The protocol's methods act on it.

Only the command thread calls methods that change something; one other thread reads telemetry. The servo, a thread in C,
waits for neither.
"""

from __future__ import annotations

import logging
import math
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from itertools import islice
from time import monotonic_ns
from typing import TYPE_CHECKING, Final, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from hapticd.base.core import (
    EVENT_DTYPE,
    MAX_PENDING_MARKS,
    NO_SLOT,
    PLAY_SLOT,
    SAMPLE_DTYPE,
    CData,
    ClockSource,
    CommandKind,
    Fault,
    OverrunAction,
    Realtime,
    Status,
    StreamKind,
    ffi,
    invalid_reason,
    lib,
    pointer,
)
from hapticd.base.errors import HapticdError, InvalidError, Problem
from hapticd.base.model import MAX_FAULTS
from hapticd.base.steps import Steps
from hapticd.config.configuration import Config, Device
from hapticd.config.materials import Material, Materials
from hapticd.config.modes import Attack, Mode
from hapticd.config.scene import MAX_OBJECTS, Scene, SceneObject, of_all_materials, used_materials
from hapticd.daemon.command_ring import SERVO_POLL_INTERVAL_NS, CommandRing, Play, RingFullError
from hapticd.daemon.counters import (
    Counters,
    Granted,
    Histogram,
    StreamCounters,
    missing_of,
    read_counters,
    read_histograms,
    read_stream_counters,
)
from hapticd.hid.signs import Check, SignsLog
from hapticd.hid.stopper import StopFile
from hapticd.protocol.changes import Change, Reset, Revised, revised
from hapticd.protocol.displayability_warnings import MaterialReport
from hapticd.protocol.marks import Mark, Marks, MarksFullError
from hapticd.protocol.messages import MAX_GESTURE_ENDS
from hapticd.rendering.compiler.table import Compiler
from hapticd.rendering.device_output import Output, loop_of, output_of
from hapticd.rendering.displayability import (
    displayed_mode,
    material_rate_faults,
    materials_in,
    rate_faults,
    warnings,
)
from hapticd.rendering.joystick import new_operator, new_sim, set_rate
from hapticd.rendering.placement import NO_FORCE, Reach, placement_warnings
from hapticd.rendering.surface_margins import SurfaceMargins
from hapticd.rendering.undisplayable_text import Undisplayable
from hapticd.system.idle_states import IdleStateLock

if TYPE_CHECKING:
    from hapticd.hid.connection import Connection, Source
    from hapticd.hid.link import Link
    from hapticd.hid.offload import Offload, Offloaded

SAMPLE_CAPACITY: Final = 16384
"""Capacity of the ring of samples: more than a second at 10 kHz, longer than a garbage collection."""

DEVICE_TIMEOUT_S: Final = 0.1
"""Time by which the newest report may be older than usual before the device counts as lost."""
FROZEN_FORCE_FRACTION: Final = 0.1
"""Fraction of the maximum force above which an unchanged position counts as frozen (`device.frozen_after_s`)."""
MAX_UNSENT_CHANGES: Final = 1024
"""Largest number of changes that wait to be sent to subscribers; beyond it the oldest are dropped."""

MIN_STEP_DOWN_RATE_HZ: Final = 1000.0
"""Lowest rate to which the servo steps down after an overload."""

_log = logging.getLogger("hapticd")


class StaleRevisionError(HapticdError):
    """A change was not made, because the revision (number of a change) that it expects is not in force."""


class State(NamedTuple):
    """Scene, materials and revision (number of the last change) in force at one moment."""

    scene: Scene
    materials: Materials
    revision: int


class Engine:
    """A servo with its device, its scene and the table compiled from the scene."""

    def __init__(self, config: Config, stop_file: StopFile | None = None) -> None:
        """Open the device, make the servo and compile the configuration's scene; no thread runs yet.

        `stop_file`: records how to stop a real device after the daemon was killed. Raises InvalidError for filters and
        frequencies that are impossible at this rate, and HapticdError for a device that cannot be opened.
        """
        servo = config.servo
        self.config = config
        self.rate_hz = servo.rate_hz
        self.state = State(config.scene, config.materials, 1)
        self.reach = Reach.of(config)
        self.granted: Granted | None = None
        self._poll_due_ns = 0
        self._suspends = 0
        self._signs = SignsLog()
        self._idle_lock = IdleStateLock()
        self._sim: CData | None = None
        self.connection: Connection | None = None
        self._offload: Offload | None = None
        if config.device.kind == "sim":
            self._sim = new_sim(config.device.sim, servo.rate_hz)
        else:
            below_servo = 0 if servo.realtime == "off" else max(1, servo.priority - 1)
            hid = config.device.hid
            replayed = config.device.kind == "replay"
            trusted_version = None if hid.signs == "check" else hid.device_version
            check = None
            if not replayed and (hid.signs == "check" or trusted_version is not None):
                check = Check(hid.travel_m, hid.full_scale_force_n, trusted_version)
            # Imported here because a simulated joystick does not need it and starts faster without it.
            from hapticd.hid.connection import Connection
            from hapticd.hid.handle_use import HandleUse

            use = HandleUse(hid, from_file=replayed)
            self.connection = Connection(source_of(config.device), below_servo, stop_file, check, use)
            if config.device.hid.offload == "auto":
                self._offload = self.connection.offload
        try:
            self._make()
        except BaseException:
            self._disconnect()
            raise

    def _make(self) -> None:
        config, servo = self.config, self.config.servo
        sim = config.device.sim
        resolution_m, report_age_s = sim.encoder_step_m, sum(sim.reports_s)
        self.force_steps_n = (sim.force_step_n, sim.force_step_n)
        self._link: Link | None = None
        if self.connection is not None:
            plan, self._link = self.connection.open()
            self.force_steps_n = plan.force_steps_n
            resolution_m, report_age_s = plan.resolution_m, 0.0
        self._resolution_m = resolution_m
        self.output = self._output_at(servo.rate_hz)
        self._margins = self._margins_at(self.output)
        self._reports: dict[str, MaterialReport] = {}
        refused = rate_faults(config.scene.objects, config.materials, self.output)
        if refused:
            raise InvalidError(refused)
        if self._offload is not None:
            self._offload.set_carried(self.output.carried_hz)
        self._operator_tick: int | None = None
        self._gesture_ends: deque[dict[str, object]] = deque(maxlen=MAX_GESTURE_ENDS)
        self._marks = Marks()
        self._changes: deque[Change] = deque(maxlen=MAX_UNSENT_CHANGES)
        self._touched = ffi.new("struct hd_touched[]", lib.HD_TOUCHED_MAX)
        settings = ffi.new("struct hd_servo_config *")
        settings.rate_hz = servo.rate_hz
        settings.cpu = -1 if servo.cpu is None else servo.cpu
        settings.priority = servo.priority
        settings.realtime = Realtime[servo.realtime.upper()]
        settings.slot_capacity = MAX_OBJECTS
        settings.sample_capacity = SAMPLE_CAPACITY
        settings.spin_ns = round(servo.spin_us * 1000)
        settings.resolution_m = resolution_m
        settings.device_timeout_s = DEVICE_TIMEOUT_S + report_age_s
        settings.clock = ClockSource[servo.clock.upper()]
        settings.overrun_threshold = servo.overruns.threshold
        settings.overrun_action = self._overrun_action(servo.rate_hz)
        settings.stream_timeout_s = servo.stream_timeout_s
        settings.frozen_s = config.device.frozen_after_s or 0.0
        settings.frozen_force_n = FROZEN_FORCE_FRACTION * config.device.max_force_n
        # Forces of a real device stay off until a client turns them on.
        settings.forces_on = self._sim is not None
        hid = None if self.connection is None else self.connection.hid
        made = lib.hd_servo_new(settings, self._sim or ffi.NULL, hid or ffi.NULL)
        if made == ffi.NULL:
            raise HapticdError(invalid_reason())

        # The struct keeps references to what its thread uses: a garbage collection frees objects in any order.
        self._servo = ffi.gc(made, lib.hd_servo_free)
        self._ring = CommandRing(self._servo, self.poll_servo)
        self._compiler = Compiler(self.output, self._offload)
        self._publish(self.scene, self.scene.objects, self.materials, self.revision)

    def _output_at(self, rate_hz: float) -> Output:
        return output_of(self.config, rate_hz, None if self._link is None else self._link.carried_hz(rate_hz))

    def _margins_at(self, output: Output) -> SurfaceMargins | None:
        loop = loop_of(
            self.config,
            output.rate_hz,
            resolution_m=self._resolution_m,
            force_step_n=max(self.force_steps_n),
            link_rate_hz=None if self._link is None else output.link_rate_hz,
        )
        return None if loop is None else SurfaceMargins(loop)

    def _overrun_action(self, rate_hz: float) -> OverrunAction:
        """Return the configured action on an overload, but a fault if half of `rate_hz` is below the minimum rate."""
        action = OverrunAction[self.config.servo.overruns.action.upper()]
        if action == OverrunAction.STEP_DOWN and rate_hz < 2.0 * MIN_STEP_DOWN_RATE_HZ:
            return OverrunAction.FAULT
        return action

    @property
    def scene(self) -> Scene:
        """The scene in force."""
        return self.state.scene

    @property
    def materials(self) -> Materials:
        """The materials in force."""
        return self.state.materials

    @property
    def revision(self) -> int:
        """The revision in force; it grows with each change of the scene, the materials or the rate."""
        return self.state.revision

    # ---- Life ------------------------------------------------------------------------------------------------------

    def start(self) -> Granted:
        """Start the servo thread. Raises HapticdError if real time is required and refused."""
        try:
            if self.connection is not None:
                self.connection.start()
            return self._start()
        except BaseException:
            self._disconnect()
            raise

    def _start(self) -> Granted:
        grant = ffi.new("struct hd_grant *")
        return self._apply_grant(lib.hd_servo_start(self._servo, grant), grant)

    def _apply_grant(self, status: int, grant: CData) -> Granted:
        servo = self.config.servo
        missing = missing_of(grant, servo)
        if servo.realtime != "off":
            try:
                self._idle_lock.hold()
            except OSError as error:
                missing.append(f"lock of the processors' idle states: {error.strerror} ({error.filename})")
        if self.connection is not None and self.connection.denied:
            missing.append("SCHED_FIFO for the threads that read and write the device")
            if servo.realtime == "required":
                status = Status.ERR_DENIED
        if status == Status.ERR_DENIED:
            raise HapticdError(
                f"servo.realtime is required but refused: {'; '.join(missing)}; "
                "raise the limits rtprio and memlock, or set servo.realtime to preferred"
            )
        if status != Status.OK:
            raise HapticdError(f"cannot start the servo thread: {os.strerror(ffi.errno)}")
        self.granted = Granted.of(grant, servo, self._idle_lock.held, missing)
        return self.granted

    def stop(self) -> None:
        """Fade the device's force to zero within the ramp time, end the servo thread and close the device."""
        self._idle_lock.release()
        ended = lib.hd_servo_stop(self._servo)
        self._disconnect()
        if ended != Status.OK:
            raise HapticdError(f"cannot end the servo thread: {os.strerror(ffi.errno)}")

    def _disconnect(self) -> None:
        if self.connection is not None:
            self.connection.stop()

    def beat(self) -> None:
        """Send the servo a heartbeat of the command thread; after a second without a heartbeat the forces fade out."""
        lib.hd_servo_beat(self._servo)

    # ---- Supervision of the servo --------------------------------------------------------------------------------

    def poll_servo(self) -> None:
        """Restart the servo after an overload, and check the device after a suspend, at most every 50 ms.

        The command thread calls this method often. Raises HapticdError if the servo cannot be restarted.
        """
        now_ns = monotonic_ns()
        if now_ns < self._poll_due_ns:
            return
        self._poll_due_ns = now_ns + SERVO_POLL_INTERVAL_NS
        self._changes.extend(self._ring.played())
        counters = self.counters()
        if counters.suspends != self._suspends:
            self._suspends = counters.suspends
            if self.connection is not None:
                self.connection.suspect()
        self._signs.note(counters.signs)
        if counters.overloaded and not counters.running:
            self._step_down()

    def _step_down(self) -> None:
        """Restart the servo after an overload: at half its rate or, if that is impossible, at its rate with a fault."""
        before, after = self.output, self._output_at(0.5 * self.rate_hz)
        refused = rate_faults(self.scene.objects, self.materials, after)
        problem = str(InvalidError(refused)) if refused else None
        if problem is None:
            try:
                self._change_rate(after)
            except HapticdError as error:
                problem = str(error)
        if problem is not None:
            _log.error("no step down to %g Hz: %s", after.rate_hz, problem)
            self._change_rate(before)
        grant = ffi.new("struct hd_grant *")
        faults = 0 if problem is None else int(Fault.OVERRUN)
        self._apply_grant(lib.hd_servo_restart(self._servo, faults, grant), grant)

    def _change_rate(self, output: Output) -> None:
        """Set the rate of a servo whose thread has ended. After a HapticdError, another rate must be set."""
        rate_hz = output.rate_hz
        changed_hz = None if rate_hz == self.rate_hz else rate_hz
        if lib.hd_servo_set_rate(self._servo, rate_hz, self._overrun_action(rate_hz)) != Status.OK:
            raise HapticdError(f"servo: {invalid_reason()}")
        if self._sim is not None:
            set_rate(self._sim, self.config.device.sim, rate_hz)
        self.output, self.rate_hz, self._margins = output, rate_hz, self._margins_at(output)
        if self._offload is not None:
            self._offload.set_carried(output.carried_hz)
        self._compiler.turn_to(output)
        self._ring.set_output(output)
        revision = (self.revision + 1) & 0xFFFFFFFF
        self._publish(self.scene, (), self.materials, revision)
        self._changes.append(Revised(revision, {}, {}, {}, None, changed_hz))
        self.state = self.state._replace(revision=revision)

    # ---- Scene and materials ---------------------------------------------------------------------------------------

    def take(
        self, scene: Scene, materials: Materials, changed: Iterable[str] | None = None, expected: int | None = None
    ) -> int:
        """Put a validated scene and its materials in force at once, and return their revision.

        `changed`: ids of all objects that may differ or are removed; None: compare all objects. `expected`:
        the revision that must be in force before, else StaleRevisionError is raised. If scene and materials are already
        in force, the revision stays.
        """
        before = self.state
        if expected is not None and expected != before.revision:
            raise StaleRevisionError(f"revision {expected} is not in force")
        if scene is before.scene and materials is before.materials:
            self._compiler.touched.clear()
            return before.revision
        changed = tuple(scene.changed_since(before.scene) if changed is None else changed)
        revision = (before.revision + 1) & 0xFFFFFFFF
        self._publish(scene, changed, materials, revision)
        self._changes.append(revised(revision, before.scene, scene, changed, before.materials, materials))
        self.state = State(scene, materials, revision)
        return revision

    def prepared(
        self, objects: Iterable[SceneObject], materials: Materials, sent: Iterable[str]
    ) -> Steps[dict[str, MaterialReport]]:
        """Compute the slow parts of the next change in steps, mainly filters of textures, and return material reports.

        `materials` are those after the change, `sent` the names of those that the request contains. The reports are of
        the materials of `objects`, of those in `sent` and of those that the change affects. Each step computes one
        filter or one material. Call `forget_prepared` once the change is made or abandoned.
        """
        reports = {}
        for name in dict.fromkeys([*sent, *used_materials(objects), *self._compiler.changing(materials)]):
            material = materials[name]
            # A material that is impossible at this rate is only reported here; a scene that uses it is refused later.
            if not material_rate_faults(name, material, self.output):
                yield from self._compiler.prepare(name, material)
            reports[name] = self.report_of(name, material)
            yield
        return reports

    def forget_prepared(self) -> None:
        """Release the filters that `prepared` computed for a change that was made or abandoned."""
        self._compiler.forget_prepared()

    def wait_revision(self, revision: int) -> int:
        """Wait for the first tick rendered with this revision of the scene or a later one, and return the tick.

        Raises WaitTimeoutError.
        """
        return self._ring.wait(
            lambda timeout_ns, tick: lib.hd_servo_wait_revision(self._servo, revision, timeout_ns, tick),
            f"revision {revision} did not come into force",
        )

    def limits(self) -> tuple[list[Undisplayable], list[Problem]]:
        """Return the vibrations that are above 0.4 of the rate, and all other display warnings. For any thread."""
        scene, materials, _ = self.state
        objects = of_all_materials(scene.objects)
        reports = {name: self.report_of(name, each) for name, each in materials_in(objects, materials).items()}
        self._reports = dict(reports)
        played = self.played()
        undisplayable = [one for each in reports.values() for one in each.undisplayable]
        others = [one for each in reports.values() for one in each.warnings]
        others += warnings(objects, {}, self.output)
        others += islice(placement_warnings(scene, materials, self.reach), MAX_FAULTS)
        others += () if scene.display.force else (NO_FORCE,)
        return [one for one in undisplayable if (one.material, one.mode) not in played], others

    def report_of(self, name: str, material: Material) -> MaterialReport:
        """Return the cached report of what is not displayed as written in a material. For any thread."""
        known = self._reports.get(name)
        if known is None or known.material is not material or known.output is not self.output:
            known = self._reports[name] = MaterialReport.of(name, material, self.output)
        return known

    def played(self) -> set[tuple[str, str]]:
        """Return the pairs of material and ringing mode that the device plays as effects. For any thread."""
        return {(each.material, each.mode) for each in self.offloaded() if each.refused is None}

    @property
    def offload_version(self) -> int:
        """A number that grows whenever the result of `offloaded` may change while the scene stays the same."""
        return 0 if self._offload is None else self._offload.version

    def offloaded(self) -> list[Offloaded]:
        """Return for each tap and rupture whether the device plays its vibration, or why not. For any thread."""
        if self._offload is None:
            return []
        return self._offload.outcomes(materials_in(self.scene.objects, self.materials))

    def margins(self, touched: bool = False) -> dict[str, float | None] | None:
        """Return the stability margin of each surface by object id: the factor by which its stiffness alone may grow.

        A margin of None is unlimited. `touched`: only the surfaces that the last change added or changed. Returns None
        if mass and damping of the handle are not known.
        """
        if self._margins is None:
            return None
        slots = list(self._compiler.touched if touched else self._compiler.slots())
        names = self._compiler.names_of(slots)
        margins = self._margins.of(self._compiler, slots)
        return {name: margin if margin < math.inf else None for name, margin in zip(names, margins, strict=True)}

    def name_of(self, slot: int, generation: int) -> str | None:
        """Return the id of the object that an event identifies by slot and generation; None: no object."""
        return self._compiler.name_of(slot, generation)

    def events_read(self, revision: int) -> None:
        """Release the names of objects that were removed before this revision.

        Call this once a sample with this revision was read, and every event up to its tick.
        """
        self._compiler.events_read(revision)

    def _publish(self, scene: Scene, changed: Iterable[str], materials: Materials, revision: int) -> None:
        changed = list(changed)
        table = self._compiler.update(scene, changed, materials, revision)
        if self._offload is not None:
            self._offload.settle()
        status = lib.hd_servo_publish(self._servo, table)
        if status != Status.OK:
            # The servo still has the old table; this makes the compiler's state match it again.
            reason = "no memory" if status == Status.ERR_MEMORY else invalid_reason()
            self._compiler.restore(self.scene, changed, self.materials, self.revision)
            raise HapticdError(f"the scene cannot be rendered: {reason}")
        self._compiler.published()

    # ---- Commands --------------------------------------------------------------------------------------------------

    def play(
        self, mode: Mode, attack: Attack, direction: tuple[float, float], amplitude_m_per_s2: float
    ) -> tuple[int, float | None]:
        """Strike a mode; return the tick that took the command, and the displayed frequency (None: the mode is silent).

        After a WaitTimeoutError the mode may still be struck, at the rate that the servo has then.
        """
        command = self._command(CommandKind.PLAY)
        effect = None
        if self._offload is not None:
            effect = self._offload.take(mode)
            self._offload.give(mode)
            self._offload.settle()
        length = math.hypot(*direction)
        command.direction = (direction[0] / length, direction[1] / length)
        command.amplitude = amplitude_m_per_s2
        command.slot = PLAY_SLOT
        play = Play(mode, attack, direction, amplitude_m_per_s2, effect)
        output = None
        # If the rate changed while the command waited, the mode was struck for the old rate, in the first tick after
        # the restart and before any force: it is sent again for the new rate.
        while output is not self.output:
            output = self.output
            command.mode = play.record(output)
            tick = self._ring.send([command], play)
        self._changes.extend(self._ring.played())
        played_hz = None if self._offload is None else self._offload.shown_hz(mode)
        if played_hz is not None:
            return tick, played_hz
        shown, _ = displayed_mode(mode, self.output)
        return tick, None if shown is None else shown.frequency_hz

    def reset(self, ids: Iterable[str] | None) -> int:
        """Heal membranes and clear the contact state of objects (None: of all); return the tick that did so."""
        commands = []
        ids = None if ids is None else tuple(ids)
        if ids is None:
            command = self._command(CommandKind.RESET)
            command.slot = NO_SLOT
            commands.append(command)
        else:
            for id in ids:
                place = self._compiler.slot_of(id)
                if place is not None:
                    command = self._command(CommandKind.RESET)
                    command.slot, command.generation = place
                    commands.append(command)
        tick = self._ring.send(commands) if commands else self.counters().ticks
        self._changes.append(Reset(tick, ids))
        return tick

    def set_forces(self, enabled: bool) -> int:
        """Turn forces on or off, and return the tick that did so. Turning on clears faults whose cause has ended."""
        command = self._command(CommandKind.FORCES)
        command.value = enabled
        return self._ring.send([command])

    def set_operator(self, waypoints: npt.NDArray[np.float64], interpolation: Literal["linear", "minimum_jerk"]) -> int:
        """Move the simulated hand along waypoints [t_s, x_m, y_m], and return the tick at which it starts.

        Raises HapticdError if the device is not the simulated joystick.
        """
        if self._sim is None:
            raise HapticdError(
                f"device.kind is {self.config.device.kind}: only the simulated joystick (sim) has an operator"
            )
        path = new_operator(waypoints.tolist(), interpolation)
        command = self._command(CommandKind.OPERATOR)
        command.path = path
        tick = self._ring.send([command])
        self._operator_tick = tick
        return tick

    def stream(self, kind: StreamKind, seq: int, x: float, y: float) -> None:
        """Send the servo a target of the simulated hand, in m, or a force, in N. The newest value applies.

        Raises HapticdError for a number that is not finite, and for a target beyond 1000 m or without a simulated hand.
        """
        if lib.hd_servo_stream(self._servo, kind, seq, ffi.new("double[2]", (x, y))) != Status.OK:
            raise HapticdError(invalid_reason())

    def stream_counters(self, kind: StreamKind) -> StreamCounters:
        """Return the servo's counters of the stream of targets or of forces. For any thread."""
        return read_stream_counters(self._servo, kind)

    def operator(self) -> dict[str, object] | None:
        """Return the member `operator` of a status: the last start and the last ends of motions. For any thread.

        Returns None without a simulated hand.
        """
        if self._sim is None:
            return None
        return {"started_tick": self._operator_tick, "ends": list(self._gesture_ends)}

    @property
    def operator_version(self) -> tuple[int | None, dict[str, object] | None]:
        """A value that changes whenever the result of `operator` changes."""
        return self._operator_tick, self._gesture_ends[-1] if self._gesture_ends else None

    def gesture_ended(self, event: dict[str, object]) -> None:
        """Keep an event `gesture_end` for `operator`. For the thread that reads events."""
        self._gesture_ends.append(event)

    def mark(self, mark: Mark) -> int:
        """Have the servo emit an event for a mark (a client's note); return the tick that took the mark.

        This works with forces off and with latched faults. Raises RingFullError, WaitTimeoutError.
        """
        try:
            number = self._marks.add(mark)
        except MarksFullError:
            raise RingFullError(
                f"{MAX_PENDING_MARKS} marks are under way: their events have not been sent yet"
            ) from None
        command = self._command(CommandKind.MARK)
        command.value = number
        try:
            return self._ring.send([command])
        except RingFullError:
            self._marks.take(number)
            raise

    def take_mark(self, number: int) -> Mark:
        """Return the mark with the number in an event, and release the mark. For the thread that reads events."""
        return self._marks.take(number)

    def set_lease(self, deadline_ns: int) -> None:
        """Set the end of a client's lease (CLOCK_MONOTONIC), at which the forces fade out; 0: no lease."""
        lib.hd_servo_set_lease(self._servo, deadline_ns)

    def _command(self, kind: CommandKind) -> CData:
        return self._ring.new(kind, self.revision)

    # ---- Telemetry -------------------------------------------------------------------------------------------------

    def counters(self) -> Counters:
        """Return the servo's counters since its start."""
        return read_counters(self._servo)

    def histograms(self) -> tuple[Histogram, Histogram]:
        """Return the histograms of the ticks' lateness and work time since the servo's start. For any thread."""
        return read_histograms(self._servo)

    def read_changes(self) -> Iterator[Change]:
        """Yield the changes, plays and resets that commands made since the last call. For one thread."""
        with suppress(IndexError):
            while True:
                yield self._changes.popleft()

    def read_samples(self, buffer: npt.NDArray[np.void]) -> tuple[int, int]:
        """Move samples from the servo into `buffer` (SAMPLE_DTYPE); return their number and the total of dropped ones.

        For one thread at a time; another thread may read events at the same time.
        """
        return self._read(lib.hd_servo_read_samples, "struct hd_sample[]", SAMPLE_DTYPE, buffer)

    def read_events(self, buffer: npt.NDArray[np.void]) -> tuple[int, int]:
        """Move events from the servo into `buffer` (EVENT_DTYPE); return their number and the total of dropped ones."""
        return self._read(lib.hd_servo_read_events, "struct hd_event[]", EVENT_DTYPE, buffer)

    def touching(self) -> list[str]:
        """Return the sorted ids of the touched objects, at most 1024, as the servo reports them.

        For the thread that reads samples, after it read them.
        """
        count = lib.hd_servo_read_touched(self._servo, self._touched)
        names = (self.name_of(record.slot, record.generation) for record in self._touched[0:count])
        return sorted(name for name in names if name is not None)

    def _read(
        self,
        read: Callable[[CData, CData, int, CData], int],
        ctype: str,
        dtype: np.dtype[np.void],
        buffer: npt.NDArray[np.void],
    ) -> tuple[int, int]:
        if buffer.dtype != dtype:
            raise ValueError(f"buffer: must be an array of {dtype}, is {buffer.dtype}")
        dropped = ffi.new("uint64_t *")  # not shared: samples and events may be read at the same time
        count = read(self._servo, pointer(ctype, buffer), len(buffer), dropped)
        return int(count), int(dropped[0])


def source_of(device: Device) -> Source:
    """Return the source of positions for a configured device that is not simulated."""
    from hapticd.hid import sources

    return sources.source_of(device)
