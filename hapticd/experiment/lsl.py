"""Telemetry of a daemon as outlets of Lab Streaming Layer (LSL): every sample, and the event codes.

LSL's clock on Linux is CLOCK_MONOTONIC, as the daemon's is: on the daemon's machine its times are passed on unchanged.
A double holds them to a nanosecond for the first 97 days after the machine was started.
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
import numpy.typing as npt

from hapticd._version import __version__
from hapticd.base.errors import HapticdError
from hapticd.client.blocking import Client
from hapticd.client.record import DAEMON_STOPPED_REASON, END_SILENCE_S
from hapticd.client.samples import SampleBatch, SampleStream
from hapticd.experiment.event_codes import TRIAL_NUMBERS, EventCode, code_of
from hapticd.protocol.places import has_ended, no_telemetry
from hapticd.protocol.results import Status

SAMPLES: Final = "hapticd samples"
EVENTS: Final = "hapticd events"
"""Names of the outlets."""

BUFFERED_S: Final = 60
"""So much is kept for a reader that is behind."""
LINGER_S: Final = 0.5
"""An outlet drops at its end what was not sent yet, and LSL does not say what was: readers have all of it by then."""
_BEHIND_S: Final = 1.0
"""At the end, what is on its way from the daemon is waited for, as long as something comes."""
_LOOK_S: Final = 0.1


@dataclass(frozen=True, slots=True)
class Channel:
    """One number of each sample: the field of the daemon's sample that it comes from, and the axis of a vector."""

    label: str
    field: str
    axis: int | None
    unit: str
    kind: str


def _vector(quantity: str, suffix: str, kind: str, unit: str) -> tuple[Channel, ...]:
    field = f"{quantity}_{suffix}"
    return tuple(Channel(f"{quantity}_{name}_{suffix}", field, axis, unit, kind) for axis, name in enumerate("xy"))


CHANNELS: Final = (
    Channel("tick", "tick", None, "count", "Counter"),
    *_vector("position", "m", "Position", "m"),
    *_vector("velocity", "m_per_s", "Velocity", "m/s"),
    *_vector("contact_force", "n", "Force", "N"),
    *_vector("vibration_force", "n", "Force", "N"),
    *_vector("force", "n", "Force", "N"),
    Channel("revision", "revision", None, "count", "Counter"),
    Channel("flags", "flags", None, "bits", "Flags"),
)
"""Of `hapticd samples`, in their order."""


@dataclass(frozen=True, slots=True)
class Sent:
    """What went through the outlets."""

    samples: int
    events: int
    lost: int
    """Samples that did not arrive here."""
    dropped: int
    """Samples that the daemon's ring had no room for."""


def _pylsl() -> ModuleType:
    try:
        import pylsl
    except ImportError:
        raise HapticdError("Lab Streaming Layer needs pylsl: pip install 'hapticd[lsl]'") from None
    except RuntimeError:
        # Where pylsl's package is one without the library.
        raise HapticdError(
            "pylsl finds no liblsl: take one from https://github.com/sccn/liblsl/releases, and name it in PYLSL_LIB"
        ) from None
    return cast(ModuleType, pylsl)


def matrix_of(batch: npt.NDArray[np.void]) -> npt.NDArray[np.float64]:
    """(n, len(CHANNELS)) numbers of a batch of n samples."""
    columns = [batch[each.field] if each.axis is None else batch[each.field][:, each.axis] for each in CHANNELS]
    return np.column_stack([column.astype(np.float64) for column in columns])


class Outlets:
    """The two outlets; a context, after which they are gone."""

    def __init__(self, status: Status, directory: str) -> None:
        """`status` of the daemon, `directory` of its sockets. Raises HapticdError where pylsl is missing."""
        lsl = _pylsl()
        source = f"hapticd:{socket.gethostname()}:{directory}"
        samples = lsl.StreamInfo(
            SAMPLES, "Haptics", len(CHANNELS), float(status["rate_hz"]), lsl.cf_double64, f"{source}:samples"
        )
        self._describe(samples, status, [(each.label, each.unit, each.kind) for each in CHANNELS])
        events = lsl.StreamInfo(EVENTS, "Markers", 1, lsl.IRREGULAR_RATE, lsl.cf_int32, f"{source}:events")
        self._describe(events, status, [("code", "none", "Marker")])
        codes = events.desc().append_child("codes")
        for code in EventCode:
            row = codes.append_child("code")
            row.append_child_value("number", str(int(code)))
            row.append_child_value("name", code.text)
            row.append_child_value("meaning", code.meaning)
        codes.append_child_value("trial_numbers_from", str(TRIAL_NUMBERS))
        self._samples: Any = lsl.StreamOutlet(samples, max_buffered=BUFFERED_S)
        self._events: Any = lsl.StreamOutlet(events, max_buffered=BUFFERED_S)
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
        """A chunk with a time for each sample: the deadline of its tick."""
        if len(batch):
            self._samples.push_chunk(matrix_of(batch), (batch["time_ns"] / 1e9).tolist())

    def push_event(self, event: Mapping[str, object]) -> None:
        """The code of an event, where it has one, at the time of its tick."""
        code = code_of(event)
        if code is None:
            return
        at_s = cast(int, event["time_ns"]) / 1e9
        self._events.push_sample([int(code)], at_s)
        self.sent_events += 1
        if code is EventCode.TRIAL_ARMED:
            trial = cast("Mapping[str, int]", event["data"]).get("trial")
            if isinstance(trial, int):
                self._events.push_sample([TRIAL_NUMBERS + trial], at_s)

    def __enter__(self) -> Outlets:
        return self

    def __exit__(self, *error: object) -> None:
        if self._samples.have_consumers() or self._events.have_consumers():
            time.sleep(LINGER_S)
        # Whose end is what closes them.
        self._samples = self._events = None


def stream(client: Client, stop: threading.Event, started: Callable[[], None] = lambda: None) -> Sent:
    """Passes a daemon's telemetry on until `stop` is set, up to the tick that the daemon is at then.

    `started` is called once the outlets are there. Raises HapticdError where pylsl is missing, DaemonNotRunning
    where the daemon goes away.
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
            received = messages.receive(_LOOK_S)
            silent_s = time.monotonic() - heard_s
            if received is None:
                _check_silence(client, silent_s)
                if last_tick is not None and silent_s > _BEHIND_S:
                    break
                continue
            heard_s = time.monotonic()
            topic, message = received
            if topic == "event":
                outlets.push_event(message)
                continue
            batch = account.convert(topic, message)
            if account.restarts:
                raise HapticdError("the daemon was restarted, and its ticks began again; start this again")
            outlets.push_samples(batch)
            # Events are sent before the samples of their ticks.
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
    """Has the outlets there while the block runs, by a thread with a separate connection.

    Raises what keeps them from beginning before the block, and what ended them early after it.
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
