"""Telemetry of a daemon as outlets of Lab Streaming Layer (LSL): every sample, and the event codes.

On Linux LSL and the daemon both use CLOCK_MONOTONIC, so on the daemon's machine its times are sent unchanged. A double
resolves a nanosecond of these times for 97 days after the machine was started.
"""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from types import ModuleType
from typing import Any, Final, cast

import numpy as np

from hapticd._version import __version__
from hapticd.base.errors import HapticdError
from hapticd.client.blocking import Client
from hapticd.client.record import DAEMON_STOPPED_REASON, END_SILENCE_S
from hapticd.client.samples import SampleBatch, SampleStream
from hapticd.experiment.event_codes import TRIAL_NUMBER_OFFSET, EventCode, code_of
from hapticd.protocol.places import has_ended, no_telemetry
from hapticd.protocol.results import Status
from hapticd.system.extras import install_command

SAMPLES_OUTLET: Final = "hapticd samples"
"""Name of the LSL outlet of samples."""
EVENTS_OUTLET: Final = "hapticd events"
"""Name of the LSL outlet of event codes."""
OUTLET_BUFFER_S: Final = 60
"""An outlet keeps the newest data of this duration, for a reader that lags."""
OUTLET_LINGER_S: Final = 0.5
"""Delay before an outlet is closed: closing drops unsent data, and LSL does not report when all was sent."""
_DRAIN_TIMEOUT_S: Final = 1.0
"""After the stop, telemetry is received until the daemon's last tick, or until the daemon was silent for this time."""
_RECEIVE_TIMEOUT_S: Final = 0.1
"""Time between two checks for the stop and for a silent daemon, while no message arrives."""


@dataclass(frozen=True, slots=True)
class Channel:
    """A channel of an LSL outlet: a field of the daemon's samples, or one axis of a vector field."""

    label: str
    field: str
    axis: int | None
    unit: str
    kind: str


def _vector(quantity: str, suffix: str, kind: str, unit: str) -> tuple[Channel, ...]:
    field = f"{quantity}_{suffix}"
    return tuple(Channel(f"{quantity}_{name}_{suffix}", field, axis, unit, kind) for axis, name in enumerate("xy"))


SAMPLE_CHANNELS: Final = (
    Channel("tick", "tick", None, "count", "Counter"),
    *_vector("position", "m", "Position", "m"),
    *_vector("velocity", "m_per_s", "Velocity", "m/s"),
    *_vector("contact_force", "n", "Force", "N"),
    *_vector("vibration_force", "n", "Force", "N"),
    *_vector("force", "n", "Force", "N"),
    Channel("revision", "revision", None, "count", "Counter"),
    Channel("flags", "flags", None, "bits", "Flags"),
)
"""Channels of the outlet `hapticd samples`, in order."""


@dataclass(frozen=True, slots=True)
class Sent:
    """Numbers of samples and event codes that were sent to LSL, and of samples that were lost or dropped."""

    samples: int
    """Number of samples that were sent."""
    events: int
    """Number of event codes that were sent."""
    lost: int
    """Number of samples that were lost between the daemon and this process."""
    dropped: int
    """Number of samples that the daemon dropped because its ring buffer was full."""


def _pylsl() -> ModuleType:
    try:
        import pylsl
    except ImportError:
        raise HapticdError(f"Lab Streaming Layer needs pylsl: {install_command('lsl')}") from None
    except RuntimeError:
        # The package of pylsl can come without the library.
        raise HapticdError(
            "pylsl cannot find liblsl; get it from https://github.com/sccn/liblsl/releases and set PYLSL_LIB"
        ) from None
    return cast(ModuleType, pylsl)


class Outlets:
    """The LSL outlets (streams) of samples and of event codes; a context manager that closes them."""

    def __init__(self, status: Status, directory: str) -> None:
        """Open outlets for a daemon with this status, whose sockets are in `directory`.

        Raises HapticdError if pylsl or liblsl is not installed.
        """
        lsl = _pylsl()
        source = f"hapticd:{socket.gethostname()}:{directory}"
        count, rate_hz = len(SAMPLE_CHANNELS), float(status["rate_hz"])
        samples = lsl.StreamInfo(SAMPLES_OUTLET, "Haptics", count, rate_hz, lsl.cf_double64, f"{source}:samples")
        self._describe(samples, status, [(each.label, each.unit, each.kind) for each in SAMPLE_CHANNELS])
        events = lsl.StreamInfo(EVENTS_OUTLET, "Markers", 1, lsl.IRREGULAR_RATE, lsl.cf_int32, f"{source}:events")
        self._describe(events, status, [("code", "none", "Marker")])
        codes = events.desc().append_child("codes")
        for code in EventCode:
            row = codes.append_child("code")
            row.append_child_value("number", str(int(code)))
            row.append_child_value("name", code.text)
            row.append_child_value("meaning", code.meaning)
        codes.append_child_value("trial_numbers_from", str(TRIAL_NUMBER_OFFSET))
        self._samples: Any = lsl.StreamOutlet(samples, max_buffered=OUTLET_BUFFER_S)
        self._events: Any = lsl.StreamOutlet(events, max_buffered=OUTLET_BUFFER_S)
        self.sent_events = 0

    @staticmethod
    def _describe(info: Any, status: Status, channels: list[tuple[str, str, str]]) -> None:
        description = info.desc()
        acquisition = description.append_child("acquisition")
        acquisition.append_child_value("manufacturer", "hapticd")
        acquisition.append_child_value("model", str(status["device"]))
        acquisition.append_child_value("version", __version__)
        acquisition.append_child_value("clock", "CLOCK_MONOTONIC")
        listed = description.append_child("channels")
        for label, unit, kind in channels:
            channel = listed.append_child("channel")
            channel.append_child_value("label", label)
            channel.append_child_value("unit", unit)
            channel.append_child_value("type", kind)

    def push_samples(self, batch: SampleBatch) -> None:
        """Send a batch of samples to LSL. The time of a sample is the deadline of its tick."""
        if len(batch):
            fields = [(batch[each.field], each.axis) for each in SAMPLE_CHANNELS]
            columns = [(values if axis is None else values[:, axis]).astype(np.float64) for values, axis in fields]
            self._samples.push_chunk(np.column_stack(columns), (batch["time_ns"] / 1e9).tolist())

    def push_event(self, event: Mapping[str, object]) -> None:
        """Send the event code of a daemon's event to LSL, if there is one, with the time of the event's tick."""
        code = code_of(event)
        if code is None:
            return
        at_s = cast(int, event["time_ns"]) / 1e9
        self._events.push_sample([int(code)], at_s)
        self.sent_events += 1
        if code is EventCode.TRIAL_ARMED:
            trial = cast("Mapping[str, int]", event["data"]).get("trial")
            if isinstance(trial, int):
                self._events.push_sample([TRIAL_NUMBER_OFFSET + trial], at_s)

    def __enter__(self) -> Outlets:
        return self

    def __exit__(self, *error: object) -> None:
        if self._samples.have_consumers() or self._events.have_consumers():
            time.sleep(OUTLET_LINGER_S)
        # Deleting an outlet closes it.
        self._samples = self._events = None


def stream(client: Client, stop: threading.Event, started: Callable[[], None] = lambda: None) -> Sent:
    """Send a daemon's telemetry to LSL until `stop` is set, and return the numbers of samples and event codes.

    The last sample is that of the daemon's tick at the stop. `started` is called when the outlets are open. Raises
    HapticdError if pylsl or liblsl is not installed, or if the daemon ends or is restarted.
    """
    _pylsl()
    status, account = client.get_status(), SampleStream(warn=False)
    last_tick: int | None = None
    with (
        client.telemetry("samples", "event") as messages,
        Outlets(status, str(client.paths.directory)) as outlets,
    ):
        started()
        heard_s = time.monotonic()
        while True:
            if last_tick is None and stop.is_set():
                last_tick = client.get_status()["tick"]
            received = messages.receive(_RECEIVE_TIMEOUT_S)
            silent_s = time.monotonic() - heard_s
            if received is None:
                _check_silence(client, silent_s)
                if last_tick is not None and silent_s > _DRAIN_TIMEOUT_S:
                    break
                continue
            heard_s = time.monotonic()
            topic, message = received
            if topic == "event":
                outlets.push_event(message)
                continue
            batch = account.convert(topic, message)
            if account.restarts:
                raise HapticdError("the daemon was restarted, so its ticks begin at 0 again; run the command again")
            outlets.push_samples(batch)
            # The daemon sends an event before the sample of its tick.
            if last_tick is not None and len(batch) and int(batch["tick"][-1]) >= last_tick:
                break
    return Sent(account.received, outlets.sent_events, account.lost, account.dropped)


def _check_silence(client: Client, silent_s: float) -> None:
    if silent_s > client.timeout_s:
        raise no_telemetry(client.paths, client.timeout_s)
    if silent_s > END_SILENCE_S and has_ended(client.paths):
        raise HapticdError(DAEMON_STOPPED_REASON)


@contextmanager
def streaming(client: Client) -> Iterator[None]:
    """Send a daemon's telemetry to LSL while the context lasts, in a thread with a separate connection.

    An error while the outlets are opened is raised at the start of the context, a later error at its end.
    """
    stop, begun = threading.Event(), threading.Event()
    failed: list[BaseException] = []

    def run() -> None:
        try:
            with Client(client.paths.directory, client.timeout_s) as own:
                stream(own, stop, begun.set)
        except BaseException as error:
            failed.append(error)
        finally:
            begun.set()

    thread = threading.Thread(target=run, name="hapticd-lsl", daemon=True)
    thread.start()
    try:
        begun.wait()
        if not failed:
            yield
    finally:
        stop.set()
        thread.join()
    if failed:
        raise failed[0]
