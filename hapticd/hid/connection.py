"""Keeps a device connected: sets it up, hands it to C, waits, sets it up again after a reset, and looks for it when it
has gone.

A thread does that while the daemon runs; C's reader and writer threads (csrc/device/hd_hid_reader.c and
hd_hid_writer.c) do what happens every few milliseconds, and the servo waits for neither. A device that is lost is
looked for every `RETRY_S`; the scene stays.
"""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

from hapticd.base.core import CData, HidMeaning, Status, ffi, invalid_reason, lib
from hapticd.base.errors import HapticdError
from hapticd.hid.device import Device, Driver
from hapticd.hid.link import Link, link_of, measured_force_hz, paced
from hapticd.hid.offload import Offload
from hapticd.hid.plan import DeviceError, Plan
from hapticd.hid.signs import Check
from hapticd.hid.stopper import StopFile
from hapticd.system.repeated_lines import MAX_STATE_INTERVAL_S, Repeats

RETRY_S: Final = 0.25
"""A device that is gone is looked for so often."""
RECOVERY_S: Final = 0.25
"""A device that was set up again has this long to say that it is ready."""
SETTLE_S: Final = 0.02
"""Reports about its set-up may be under way so long."""
LISTEN_S: Final = 0.15
"""So long a device is listened to, to find out whether it reports without being moved."""
PLAYING_S: Final = 1.0
"""A device whose reports have room for it has this long to say that an effect plays."""
STOP_S: Final = 2.0
"""So long the end waits for a set-up that is under way."""
_RATE_EVERY_S: Final = 1.0

_log = logging.getLogger("hapticd")


@dataclass(frozen=True, slots=True)
class Opened:
    """A device that is open, and how it is driven."""

    device: Device
    driver: Driver
    name: str
    out_interval_s: float | None = None
    """Interval of the endpoint that takes forces; None where none is known."""
    on_change: bool | None = None
    """The device reports only what changes; None: listen to it."""
    measure: bool = True
    """Whether it is measured how long reports take."""
    identity: str = ""
    """Which device it is, where there may be several."""


Source = Callable[[], Opened]
"""Finds and opens the device. Raises HapticdError, one line, while it cannot."""


@dataclass(frozen=True, slots=True)
class _Live:
    """What is connected."""

    opened: Opened
    plan: Plan
    link: Link
    since_s: float
    """time.monotonic()"""

    def resets_seen(self, has_played: bool) -> bool | None:
        """Whether a reset by another program would be seen; None: not known yet, or it has no effects to lose.
        `has_played`: the device has said that an effect of ours plays."""
        if self.plan.foreign_s is None:
            return None
        asked = self.plan.effects is not None and time.monotonic() - self.since_s < PLAYING_S
        return True if has_played else None if asked else False


class Connection:
    """One device, found and found again. `open` and `stop` are for one thread; `status` for any."""

    def __init__(
        self, source: Source, priority: int = 0, stop_file: StopFile | None = None, check: Check | None = None
    ) -> None:
        """`priority`: of C's threads, 0 for none. `stop_file`: where to write what stops a device that is driven.
        `check`: of signs, of each device before its first force; None: they are trusted."""
        made = lib.hd_hid_new()
        if made == ffi.NULL:
            raise MemoryError("no memory for a connection")
        self.hid: CData = ffi.gc(made, lib.hd_hid_free)
        self.offload = Offload(self.hid)
        """The effects that the device plays itself."""
        self.denied = False
        """Whether C's threads were refused their priority."""
        self._source = source
        self._priority = priority
        self._stop_file = stop_file
        self._check = check
        self._live: _Live | None = None
        self._problem: str | None = None
        self._resets = 0
        self._connects = 0
        self._rates: tuple[float | None, float | None] = (None, None)
        self._counted: tuple[float, int, int] | None = None
        self._stop = threading.Event()
        # Taken by whoever connects or lets go. Once abandoned, the thread does neither any more.
        self._hands = threading.Lock()
        self._abandoned = False
        self._thread: threading.Thread | None = None
        self._repeats = Repeats()

    # ---- Life ------------------------------------------------------------------------------------------------------

    def open(self) -> tuple[Plan, Link]:
        """Connects for the first time. Raises HapticdError, one line, where that cannot be."""
        live = self._connect()
        return live.plan, live.link

    def start(self) -> None:
        """Looks after the connection from now on; waits a moment for the first position, so that the servo has one."""
        deadline = time.monotonic() + LISTEN_S
        while not self._raw().positions and time.monotonic() < deadline and not self._stop.wait(0.002):
            pass
        self._thread = threading.Thread(target=self._run, name="device", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Force zero, effects stopped and freed, actuators off; then the device is let go.

        A thread that hangs in the kernel in the middle of a set-up is left there after `STOP_S`, and with it the
        device's descriptor: there was no force while it set the device up.
        """
        self._stop.set()
        lib.hd_hid_wake(self.hid)
        if self._thread is not None:
            self._thread.join(STOP_S)
            with self._hands:
                self._abandoned = self._thread.is_alive()
                if self._abandoned:
                    _log.warning("the device does not answer its set-up: it is left as it is, with a force of zero")
                    self.offload.detach()
                    lib.hd_hid_disconnect(self.hid, 1)
            self._thread = None
        self._let_go(orderly=True)

    def suspect(self) -> None:
        """The device may have lost what it was sent, as in a suspend: it is set up again. For any thread."""
        lib.hd_hid_suspect(self.hid)

    def status(self) -> dict[str, object]:
        """What get_status says of the connection."""
        live, raw = self._live, self._raw()
        states = {
            meaning.name.lower(): bool(raw.states >> (meaning - 1) & 1)
            for meaning in HidMeaning
            if raw.states_known >> (meaning - 1) & 1
        }
        connected = live is not None and raw.connected
        # C ends a connection before the thread hears of it; what is lost has a reason from the first moment.
        problem = self._problem or (None if connected else _why(raw))
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
            "foreign_effect_s": live.plan.foreign_s if live is not None and seen is False else None,
            "connects": self._connects,
            "states": states,
        }

    # ---- The thread ------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        while not self._stop.is_set():
            self._repeats.flush()
            if self._live is None:
                if not self._stop.wait(RETRY_S):
                    self._try(self._connect)
                continue
            lib.hd_hid_wait(self.hid, int(_RATE_EVERY_S * 1e9))
            if self._stop.is_set():
                break
            raw = self._raw()
            if not raw.connected:
                self._lose(_why(raw))
            elif raw.reset:
                self._try(self._recover)
            self._count()

    def _try(self, work: Callable[[], object]) -> None:
        """What goes wrong is logged once for each reason, and ends the connection."""
        try:
            work()
        except HapticdError as error:
            self._lose(str(error))
        except Exception as error:
            # A fault of ours. Without this thread nobody would look for the device again.
            failure = error
            self._repeats.note(
                "failed", lambda since: _log.error("the thread of the device failed%s", since.more, exc_info=failure)
            )
            self._lose(f"{type(error).__name__}: {error}")

    def _lose(self, why: str) -> None:
        if why != self._problem:
            self._repeats.line("lost", logging.WARNING, f"device lost: {why}", MAX_STATE_INTERVAL_S)
        self._problem = why
        self._let_go(orderly=False)

    def _let_go(self, *, orderly: bool) -> None:
        with self._hands:
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

    def _connect(self) -> _Live:
        opened = self._source()
        try:
            plan = opened.driver.set_up(opened.device)
            measured_hz = measured_force_hz(opened.device, plan) if opened.measure else None
            link = link_of(plan, opened.out_interval_s, measured_hz)
            on_change = opened.on_change
            if on_change is None:
                on_change = not _reports_steadily(opened.device, plan.x.report_id != 0, self._stop)
            signs = None
            if self._check is not None:
                signs = self._check.of(opened.identity, plan.driven_axes, plan.resolution_m)
            plan = paced(replace(plan, on_change=on_change, signs=signs), link.rate_hz)
            self._hand_over(opened.device, plan)
        except BaseException:
            if self._stop_file is not None:
                lib.hd_last_report_drop()
            opened.device.close()
            raise
        self._connects += 1
        if self._problem is not None:
            self._repeats.line(
                "found", logging.INFO, f"device found: {opened.name} at {opened.device.path}", MAX_STATE_INTERVAL_S
            )
        self._problem = None
        # Last: whoever hears that it is connected hears of no problem, and has it counted.
        self._live = live = _Live(opened, plan, link, time.monotonic())
        return live

    def _hand_over(self, device: Device, plan: Plan) -> None:
        described = plan.to_c()
        zero, stop = [message.at_rest() for message in plan.force], [message.at_rest() for message in plan.stop]
        if self._stop_file is not None:
            self._stop_file.keep(device.path, device.fileno(), zero, stop, plan.write_interval_s)
        with self._hands:
            if self._abandoned:
                raise DeviceError(f"{device.path}: answers after it was given up")
            self.offload.detach()
            lib.hd_hid_disconnect(self.hid, 0)
            result = lib.hd_hid_connect(self.hid, described, device.fileno(), self._priority)
            if result == Status.ERR_DENIED and self._priority:
                self.denied, self._priority = True, 0
                result = lib.hd_hid_connect(self.hid, described, device.fileno(), 0)
            if result == Status.OK:
                if self._stop_file is not None:
                    # What a fault of the process sends to the device.
                    lengths = ffi.new("uint32_t[]", list(map(len, (*zero, *stop))))
                    reports = ffi.new("uint8_t[]", b"".join((*zero, *stop)))
                    count, pause_s = len(zero) + len(stop), plan.write_interval_s
                    lib.hd_last_report_keep(device.fileno(), reports, lengths, count, pause_s)
                self.offload.attach(plan.periodic, plan.no_periodic)
        if result == Status.ERR_INVALID:
            raise DeviceError(f"{device.path}: {invalid_reason()}")
        if result != Status.OK:
            raise DeviceError(f"{device.path}: cannot be connected: {Status(result).name.lower()}")

    def _recover(self) -> None:
        """Sets up again a device that was reset. If its effects have the same numbers, the servo notices only
        forces that did not arrive. A device that keeps its actuators off is tried again and again."""
        live = self._live
        assert live is not None
        if self._problem is None:
            self._resets += 1
            self._repeats.line("reset", logging.WARNING, f"device reset: {live.opened.name} is set up anew")
        plan = live.opened.driver.set_up(live.opened.device)
        plan = replace(plan, on_change=live.plan.on_change, signs=live.plan.signs)
        plan = paced(plan, live.link.rate_hz)
        if plan != live.plan:
            self._hand_over(live.opened.device, plan)
            self._live, self._problem = _Live(live.opened, plan, live.link, time.monotonic()), None
            return
        # The set-up itself resets the device, which it reports too.
        deadline = time.monotonic() + RECOVERY_S
        while not self._stop.wait(SETTLE_S) and time.monotonic() < deadline and self._actuators() is not True:
            pass
        if self._actuators() is not False:
            lib.hd_hid_clear_reset(self.hid)
            self._problem = None
        elif self._problem is None:
            self._problem = "the device keeps its actuators off"
            self._repeats.line("actuators", logging.WARNING, self._problem)

    def _actuators(self) -> bool | None:
        """Whether the device says that its actuators are on; None where it says nothing."""
        raw, bit = self._raw(), 1 << (HidMeaning.ACTUATORS - 1)
        return bool(raw.states & bit) if raw.states_known & bit else None

    def _raw(self) -> CData:
        raw = ffi.new("struct hd_hid_status *")
        lib.hd_hid_status(self.hid, raw)
        return raw

    def _count(self) -> None:
        """Reports and forces a second, over the last second or more."""
        raw, now = self._raw(), time.monotonic()
        if self._counted is None:
            self._counted = (now, raw.reports, raw.forces)
            return
        since, reports, forces = self._counted
        if now - since >= 0.5 * _RATE_EVERY_S:
            self._rates = ((raw.reports - reports) / (now - since), (raw.forces - forces) / (now - since))
            self._counted = (now, raw.reports, raw.forces)


def _why(raw: CData) -> str:
    """What ended a connection."""
    return os.strerror(raw.error) if raw.error else "the connection ended"


def _reports_steadily(device: Device, numbered: bool, stop: threading.Event) -> bool:
    """Whether a device reports the same thing twice running: then silence means that something is wrong."""
    last: dict[int, bytes] = {}
    deadline = time.monotonic() + LISTEN_S
    while (left := deadline - time.monotonic()) > 0 and not stop.is_set():
        report = device.listen(left)
        if report:
            report_id = report[0] if numbered else 0
            if last.get(report_id) == report:
                return True
            last[report_id] = report
    return False
