"""The connection to a device: sets it up, passes it to C, recovers it after a reset, and reconnects it after a loss.

A thread does this while the daemon runs. C's reader and writer threads read positions and write forces; the servo waits
for neither thread. While the device is lost, this thread tries to connect it every `RECONNECT_INTERVAL_S`.
"""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from hapticd.base.core import CData, HidMeaning, Status, ffi, invalid_reason, lib
from hapticd.base.errors import HapticdError
from hapticd.hid.device import Device, Driver
from hapticd.hid.handle_use import HandleUse
from hapticd.hid.link import Link, link_of, measured_force_hz, plan_paced_for_link
from hapticd.hid.offload import Offload
from hapticd.hid.plan import DeviceError, Plan
from hapticd.hid.signs import Check
from hapticd.hid.stopper import StopFile
from hapticd.system.repeated_lines import MAX_STATE_INTERVAL_S, Repeats

RECONNECT_INTERVAL_S: Final = 0.25
"""Interval between two attempts to connect a lost device."""
READY_TIMEOUT_S: Final = 0.25
"""After a device was set up again, its actuators must be on within this time."""
READY_POLL_INTERVAL_S: Final = 0.02
"""Interval of the checks whether the actuators are on. The first check also waits for it, because the device may still
report the reset that is part of the set-up."""
FIRST_REPORTS_TIMEOUT_S: Final = 0.15
"""Longest wait for the first position, and for two equal reports, which show that a device reports steadily."""
PLAYING_REPORT_TIMEOUT_S: Final = 1.0
"""If a device does not report within this time that an effect plays, its resets count as unnoticed (`resets_seen`)."""
STOP_TIMEOUT_S: Final = 2.0
"""At the end of the daemon, a set-up in progress is abandoned after this time."""
_RATE_INTERVAL_S: Final = 1.0
"""The rates of reports and forces are averaged over about this time."""

_log = logging.getLogger("hapticd")


@dataclass(frozen=True, slots=True)
class Opened:
    """An open device, the driver that sets it up, and how the device sends and accepts reports."""

    device: Device
    driver: Driver
    name: str
    out_interval_s: float | None = None
    """Polling interval of the USB endpoint for output reports; None if it is not known."""
    on_change: bool | None = None
    """Whether the device reports only changes; None if this must be found out from the device's reports."""
    measure: bool = True
    """Whether to measure, during set-up, the rate at which the device accepts output reports."""
    identity: str = ""
    """Text that distinguishes the device from others."""
    keys: Mapping[str, int | str] = field(default_factory=dict)
    """The keys of `device.hid` that select this device: vendor, product, serial number and device_version, as known."""


Source = Callable[[], Opened]
"""Function that finds and opens the device, and returns it. Raises HapticdError if the device cannot be opened."""


@dataclass(frozen=True, slots=True)
class _LiveConnection:
    """A connected device, with its plan (its fields and reports) and its link (the rate of forces it accepts)."""

    opened: Opened
    plan: Plan
    link: Link
    since_s: float
    """Value of time.monotonic() when the device was connected."""

    def resets_seen(self, has_played: bool) -> bool | None:
        """Return whether a reset by another program would be noticed.

        Returns None if this is not known yet, or if the device has no effects (vendor reports). `has_played` says
        whether the device has reported that one of hapticd's effects plays.
        """
        if self.plan.foreign_effect_s is None:
            return None
        may_follow = self.plan.effects is not None and time.monotonic() - self.since_s < PLAYING_REPORT_TIMEOUT_S
        return True if has_played else None if may_follow else False


class Connection:
    """The connection to one device, including recovery and reconnection.

    One thread calls `open`, `start` and `stop`; any thread may call `status` and `suspect`.
    """

    def __init__(
        self,
        source: Source,
        priority: int = 0,
        stop_file: StopFile | None = None,
        check: Check | None = None,
        use: HandleUse | None = None,
    ) -> None:
        """Create a connection that is not open yet.

        `priority` is the SCHED_FIFO priority of C's threads, 0 for none. The reports that stop the device are written
        to `stop_file`. With `check`, C checks before a device's first force whether forces push the right way. `use`
        warns of implausible positions of the handle.
        """
        made = lib.hd_hid_new()
        if made == ffi.NULL:
            raise MemoryError("no memory for a connection")
        self.hid: CData = ffi.gc(made, lib.hd_hid_free)
        self.offload = Offload(self.hid)
        """The device effects that are played in place of modes."""
        self.denied = False
        """Whether C's threads were refused their priority."""
        self._source = source
        self._priority = priority
        self._stop_file = stop_file
        self._check = check
        self._use = use
        self._recheck: str | None = None
        """Why the connected device is checked although the configuration trusts its signs."""
        self._live: _LiveConnection | None = None
        self._problem: str | None = None
        self._resets = 0
        self._connects = 0
        self._rates: tuple[float | None, float | None] = (None, None)
        self._counted: tuple[float, int, int] | None = None
        self._stop = threading.Event()
        # Held to connect or disconnect. Once abandoned, the thread does neither.
        self._connect_lock = threading.Lock()
        self._abandoned = False
        self._thread: threading.Thread | None = None
        self._repeats = Repeats()

    # ---- Life ------------------------------------------------------------------------------------------------------

    def open(self) -> tuple[Plan, Link]:
        """Connect the device for the first time. Raises HapticdError if that fails."""
        live = self._connect()
        return live.plan, live.link

    def start(self) -> None:
        """Wait at most FIRST_REPORTS_TIMEOUT_S for the first position, then start the thread of the connection."""
        deadline = time.monotonic() + FIRST_REPORTS_TIMEOUT_S
        while not self._raw().positions and time.monotonic() < deadline and not self._stop.wait(0.002):
            pass
        self._thread = threading.Thread(target=self._run, name="device", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Send a force of zero, stop and free the effects, disable the actuators, and disconnect.

        If the thread hangs in the kernel during a set-up, it is abandoned after `STOP_TIMEOUT_S`, together with the
        file descriptor; the device has no force during a set-up.
        """
        self._stop.set()
        lib.hd_hid_wake(self.hid)
        if self._thread is not None:
            self._thread.join(STOP_TIMEOUT_S)
            with self._connect_lock:
                self._abandoned = self._thread.is_alive()
                if self._abandoned:
                    _log.warning("the device does not respond to its set-up; it is left with a force of zero")
                    self.offload.detach()
                    lib.hd_hid_disconnect(self.hid, 1)
            self._thread = None
        self._disconnect(orderly=True)

    def suspect(self) -> None:
        """Have the device set up again, because it may have lost its effects in a suspend."""
        lib.hd_hid_suspect(self.hid)

    def status(self) -> dict[str, object]:
        """Return the state of the connection as a map: the member `connection` of the status that clients request."""
        live, raw = self._live, self._raw()
        states = {
            meaning.name.lower(): bool(raw.states >> (meaning - 1) & 1)
            for meaning in HidMeaning
            if raw.states_known >> (meaning - 1) & 1
        }
        connected = live is not None and raw.connected
        # C ends a connection before the thread notices; until then the reason comes from C.
        problem = self._problem or (None if connected else _disconnect_reason(raw))
        report_hz, force_hz = self._rates
        link = None if live is None else live.link
        seen = live.resets_seen(bool(raw.effects_told)) if live is not None and connected else None
        return {
            "name": None if live is None else live.opened.name,
            "path": None if live is None else live.opened.device.path,
            "state": "connected" if connected else "lost",
            "problem": problem,
            "link_hz": None if link is None else link.rate_hz,
            "endpoint_hz": None if link is None else link.endpoint_hz,
            "measured_hz": None if link is None else link.measured_hz,
            "report_hz": report_hz,
            "force_hz": force_hz,
            "write_s": raw.write_ns * 1e-9 if raw.writes else None,
            "reports": raw.reports,
            "short_reports": raw.short_reports,
            "forces": raw.forces,
            "strikes": raw.strikes,
            "strikes_lost": raw.strikes_lost,
            "resets": self._resets,
            "resets_seen": seen,
            "foreign_effect_s": live.plan.foreign_effect_s if live is not None and seen is False else None,
            "connects": self._connects,
            "states": states,
            "device_version": None if live is None else live.opened.keys.get("device_version"),
            "warnings": [*filter(None, [self._recheck]), *(() if self._use is None else self._use.lines)],
        }

    def note_use(self, samples: npt.NDArray[np.void], touching: Callable[[], list[str]]) -> None:
        """Observe the handle in consecutive samples. `touching` returns the ids of the objects touched at the last."""
        live = self._live
        if self._use is not None and live is not None:
            self._use.note(samples, live.plan, touching)

    # ---- The thread ------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        while not self._stop.is_set():
            self._repeats.flush()
            if self._live is None:
                if not self._stop.wait(RECONNECT_INTERVAL_S):
                    self._try(self._connect)
                continue
            lib.hd_hid_wait(self.hid, int(_RATE_INTERVAL_S * 1e9))
            if self._stop.is_set():
                break
            raw = self._raw()
            if not raw.connected:
                self._lose(_disconnect_reason(raw))
            elif raw.reset:
                self._try(self._recover)
            self._count()

    def _try(self, work: Callable[[], object]) -> None:
        """Call `work`, which connects or recovers the device. An error in it ends the connection."""
        try:
            work()
        except HapticdError as error:
            self._lose(str(error))
        except Exception as error:
            # A bug of hapticd. The thread must survive it, or the device would never be connected again.
            failure = error
            self._repeats.note(
                "failed", lambda since: _log.error("the device's thread failed%s", since.more, exc_info=failure)
            )
            self._lose(f"{type(error).__name__}: {error}")

    def _lose(self, why: str) -> None:
        if why != self._problem:
            self._repeats.line("lost", logging.WARNING, f"device lost: {why}", MAX_STATE_INTERVAL_S)
        self._problem = why
        self._disconnect(orderly=False)

    def _disconnect(self, *, orderly: bool) -> None:
        with self._connect_lock:
            live, self._live = self._live, None
            self.offload.detach()
            if live is not None and not self._abandoned:
                ended = lib.hd_hid_disconnect(self.hid, orderly)
                live.opened.device.close()
                if self._stop_file is not None:
                    lib.hd_last_report_drop()
                if orderly and ended == Status.OK and self._stop_file is not None:
                    self._stop_file.drop()
        self._counted, self._rates = None, (None, None)

    def _connect(self) -> _LiveConnection:
        opened = self._source()
        try:
            plan = opened.driver.set_up(opened.device)
            measured_hz = measured_force_hz(opened.device, plan) if opened.measure else None
            link = link_of(plan, opened.out_interval_s, measured_hz)
            on_change = opened.on_change
            if on_change is None:
                on_change = not _reports_steadily(opened.device, plan.x.report_id != 0, self._stop)
            signs, version = None, opened.keys.get("device_version")
            if self._check is not None:
                signs = self._check.of(opened.identity, plan.driven_axes, plan.resolution_m, version)
            plan = plan_paced_for_link(replace(plan, on_change=on_change, signs=signs), link.rate_hz)
            self._hand_over(opened.device, plan)
        except BaseException:
            if self._stop_file is not None:
                lib.hd_last_report_drop()
            opened.device.close()
            raise
        self._connects += 1
        self._recheck = None if self._check is None or signs is None else self._check.why(version)
        if self._recheck is not None:
            self._repeats.line("recheck", logging.WARNING, self._recheck, MAX_STATE_INTERVAL_S)
        if self._problem is not None:
            self._repeats.line(
                "found", logging.INFO, f"device found: {opened.name} at {opened.device.path}", MAX_STATE_INTERVAL_S
            )
        self._problem = None
        # Set last: a status that shows the connection shows no problem and includes it in `connects`.
        self._live = live = _LiveConnection(opened, plan, link, time.monotonic())
        return live

    def _hand_over(self, device: Device, plan: Plan) -> None:
        described = plan.to_c()
        zero, stop = [message.at_rest() for message in plan.force], [message.at_rest() for message in plan.stop]
        if self._stop_file is not None:
            self._stop_file.keep(device.path, device.fileno(), zero, stop, plan.write_interval_s)
        with self._connect_lock:
            if self._abandoned:
                raise DeviceError(f"{device.path}: responds too late; its set-up was abandoned")
            self.offload.detach()
            lib.hd_hid_disconnect(self.hid, 0)
            result = lib.hd_hid_connect(self.hid, described, device.fileno(), self._priority)
            if result == Status.ERR_DENIED and self._priority:
                self.denied, self._priority = True, 0
                result = lib.hd_hid_connect(self.hid, described, device.fileno(), 0)
            if result == Status.OK:
                if self._stop_file is not None:
                    # The reports that a fatal signal of the process sends to the device.
                    lengths = ffi.new("uint32_t[]", list(map(len, (*zero, *stop))))
                    reports = ffi.new("uint8_t[]", b"".join((*zero, *stop)))
                    count, pause_s = len(zero) + len(stop), plan.write_interval_s
                    lib.hd_last_report_keep(device.fileno(), reports, lengths, count, pause_s)
                self.offload.attach(plan.periodic, plan.no_periodic)
        if result == Status.ERR_INVALID:
            raise DeviceError(f"{device.path}: {invalid_reason()}")
        if result != Status.OK:
            raise DeviceError(f"{device.path}: cannot connect: {Status(result).name.lower()}")

    def _recover(self) -> None:
        """Set up the device again after a reset.

        If the set-up results in the same plan, with the same Effect Block Indices, C keeps the connection, and only the
        forces during the set-up are lost. The set-up is repeated while the device keeps its actuators off.
        """
        live = self._live
        assert live is not None
        if self._problem is None:
            self._resets += 1
            self._repeats.line("reset", logging.WARNING, f"device reset: {live.opened.name} is set up again")
        plan = live.opened.driver.set_up(live.opened.device)
        plan = replace(plan, on_change=live.plan.on_change, signs=live.plan.signs)
        plan = plan_paced_for_link(plan, live.link.rate_hz)
        if plan != live.plan:
            self._hand_over(live.opened.device, plan)
            self._live, self._problem = _LiveConnection(live.opened, plan, live.link, time.monotonic()), None
            return
        # The set-up resets the device, too, and the device reports that reset.
        deadline = time.monotonic() + READY_TIMEOUT_S
        while (
            not self._stop.wait(READY_POLL_INTERVAL_S) and time.monotonic() < deadline and self._actuators() is not True
        ):
            pass
        if self._actuators() is not False:
            lib.hd_hid_clear_reset(self.hid)
            self._problem = None
        elif self._problem is None:
            self._problem = "the device keeps its actuators off"
            self._repeats.line("actuators", logging.WARNING, self._problem)

    def _actuators(self) -> bool | None:
        """Return whether the device reports that its actuators are on; None if it does not report this."""
        raw, bit = self._raw(), 1 << (HidMeaning.ACTUATORS - 1)
        return bool(raw.states & bit) if raw.states_known & bit else None

    def _raw(self) -> CData:
        raw = ffi.new("struct hd_hid_status *")
        lib.hd_hid_status(self.hid, raw)
        return raw

    def _count(self) -> None:
        """Measure the rates of input reports and of sent forces, in Hz, unless the last measurement is too recent."""
        raw, now = self._raw(), time.monotonic()
        if self._counted is None:
            self._counted = (now, raw.reports, raw.forces)
            return
        since, reports, forces = self._counted
        if now - since >= 0.5 * _RATE_INTERVAL_S:
            self._rates = ((raw.reports - reports) / (now - since), (raw.forces - forces) / (now - since))
            self._counted = (now, raw.reports, raw.forces)


def _disconnect_reason(raw: CData) -> str:
    """Return the reason why C ended a connection."""
    return os.strerror(raw.error) if raw.error else "the connection ended"


def _reports_steadily(device: Device, numbered: bool, stop: threading.Event) -> bool:
    """Return whether a device repeats an input report within FIRST_REPORTS_TIMEOUT_S, and so reports steadily.

    A pause in the reports of such a device is a fault.
    """
    last: dict[int, bytes] = {}
    deadline = time.monotonic() + FIRST_REPORTS_TIMEOUT_S
    while (left := deadline - time.monotonic()) > 0 and not stop.is_set():
        report = device.listen(left)
        if report:
            report_id = report[0] if numbered else 0
            if last.get(report_id) == report:
                return True
            last[report_id] = report
    return False
