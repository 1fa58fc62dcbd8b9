"""A USB joystick with force feedback of the PID class, as a device that the guest's own USB stack enumerates.

One end of a socket pair is given to the kernel's vhci_hcd, the other is served here with PyPI's `usbip`. Endpoints are
held to their frames: once in an interval at most one output report is taken and one input report given, so that a
write to hidraw blocks as it does on a cable.

Behind the bus stands a state machine of its own, written from the PID specification and not from the daemon: effects
that are created, set, started, that end when their duration is over; device control, gain, pool. `record` holds every
report with its time, `forces` every force that the handle would show, `faults` what a strict device would not have
taken. Lengths in metre and forces in newton, x to the right, y away from the user; HID's Y grows towards the user.
"""

from __future__ import annotations

import contextlib
import glob
import math
import os
import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from usbip import protocol
from usbip.classes.device import hid as usb_hid
from usbip.device import USBDevice

VENDOR, PRODUCT = 0x1209, 0x5AFF
VHCI = Path("/sys/devices/platform/vhci_hcd.0")
FULL_SPEED = 2
PORT = 0
TRAVEL_M = 0.05
FULL_SCALE_N = 8.0
COUNTS = 32767
MAGNITUDE = 10000
EFFECTS = 4
INFINITE = 0xFFFF

# Report ids. Output, feature and input reports are numbered apart.
POSITION, STATE = 1, 2
SET_EFFECT, SET_ENVELOPE, SET_CONSTANT, OPERATION, BLOCK_FREE, CONTROL, GAIN = 1, 2, 5, 10, 11, 12, 13
CREATE, BLOCK_LOAD, POOL = 5, 6, 7
ENABLE, DISABLE, STOP_ALL, RESET, PAUSE, CONTINUE = range(1, 7)
START, START_SOLO, STOP = 1, 2, 3


def _item(prefix: int, value: int, signed: bool) -> bytes:
    for size, code in ((1, 1), (2, 2), (4, 3)):
        bits = 8 * size - signed
        if -(1 << bits) * signed <= value < 1 << bits:
            return bytes([prefix | code]) + (value & (1 << 8 * size) - 1).to_bytes(size, "little")
    raise ValueError(value)


def _main(prefix: int, flags: int) -> bytes:
    return bytes([prefix | 1, flags])


def _page(value: int) -> bytes:
    return _item(0x04, value, False)


def _usages(*values: int) -> bytes:
    return b"".join(_item(0x08, value, False) for value in values)


def _id(value: int) -> bytes:
    return _item(0x84, value, False)


def _range(low: int, high: int, bits: int, count: int = 1) -> bytes:
    limits = ((0x14, low), (0x24, high), (0x34, low), (0x44, high))
    return (
        b"".join(_item(prefix, value, True) for prefix, value in limits)
        + _item(0x74, bits, False)
        + _item(0x94, count, False)
    )


def _unit(unit: int, exponent: int) -> bytes:
    return _item(0x64, unit, False) + bytes([0x55, exponent & 15])


def _inside(kind: int, usage: int, *parts: bytes) -> bytes:
    return _usages(usage) + _main(0xA0, kind) + b"".join(parts) + b"\xc0"


IN, OUT, FEATURE = 0x80, 0x90, 0xB0
ARRAY, VARIABLE, PADDING = 0, 2, 3
PHYSICAL, APPLICATION, LOGICAL = 0, 1, 2


def _value(main: int, usage: int, low: int, high: int, bits: int) -> bytes:
    return _usages(usage) + _range(low, high, bits) + _main(main, VARIABLE)


def _pad(main: int, bits: int) -> bytes:
    return _range(0, 1, bits) + _main(main, PADDING)


def _selector(main: int, usage: int, *choices: int) -> bytes:
    return _inside(LOGICAL, usage, _usages(*choices), _range(1, len(choices), 8), _main(main, ARRAY))


def descriptor() -> bytes:
    """The report descriptor: two axes of 16 bits, PID with selectors as arrays and a constant force of +-10000."""
    index = (0x22, 1, EFFECTS, 8)
    # 255 are a whole turn, 36000 hundredths of a degree; times are in milliseconds.
    turn = _range(0, 255, 8, 2) + _item(0x44, 36000, True) + _unit(0x14, -2)
    direction = _inside(LOGICAL, 0x57, _page(0x0A), _usages(1, 2), turn, _main(OUT, VARIABLE), _unit(0, 0)) + _page(
        0x0F
    )
    axes = _inside(LOGICAL, 0x55, _page(1), _usages(0x30, 0x31), _range(0, 1, 1, 2), _main(OUT, VARIABLE)) + _page(0x0F)
    pid = [
        _inside(
            LOGICAL,
            0x92,
            _id(STATE) + _usages(0x9F, 0xA0, 0xA4, 0xA5, 0xA6) + _range(0, 1, 1, 5) + _main(IN, VARIABLE),
            _pad(IN, 3) + _value(IN, 0x94, 0, 1, 1) + _value(IN, 0x22, 1, EFFECTS, 7),
        ),
        _inside(
            LOGICAL,
            0x21,
            _id(SET_EFFECT) + _value(OUT, *index) + _selector(OUT, 0x25, 0x26),
            _unit(0x1003, -3) + b"".join(_value(OUT, usage, 0, 32767, 16) for usage in (0x50, 0x54, 0x51, 0xA7)),
            _unit(0, 0),
            _value(OUT, 0x52, 0, 255, 8) + _value(OUT, 0x53, 1, 8, 8),
            axes + _value(OUT, 0x56, 0, 1, 1) + _pad(OUT, 5) + direction,
        ),
        # hid-pidff offers no constant force without an envelope. None is shown here: envelopes are taken and left.
        _inside(
            LOGICAL,
            0x5A,
            _id(SET_ENVELOPE) + _value(OUT, *index),
            *(_value(OUT, usage, 0, 255, 8) for usage in (0x5B, 0x5D)),
            *(_value(OUT, usage, 0, 32767, 16) for usage in (0x5C, 0x5E)),
        ),
        _inside(LOGICAL, 0x73, _id(SET_CONSTANT) + _value(OUT, *index) + _value(OUT, 0x70, -MAGNITUDE, MAGNITUDE, 16)),
        _inside(
            LOGICAL,
            0x77,
            _id(OPERATION)
            + _value(OUT, *index)
            + _selector(OUT, 0x78, 0x79, 0x7A, 0x7B)
            + _value(OUT, 0x7C, 0, 255, 8),
        ),
        _inside(LOGICAL, 0x90, _id(BLOCK_FREE) + _value(OUT, *index)),
        _id(CONTROL) + _selector(OUT, 0x96, *range(0x97, 0x9D)),
        _inside(LOGICAL, 0x7D, _id(GAIN) + _value(OUT, 0x7E, 0, 255, 8)),
        _inside(LOGICAL, 0xAB, _id(CREATE) + _selector(FEATURE, 0x25, 0x26) + _value(FEATURE, 0x3B, 0, 511, 16)),
        _inside(
            LOGICAL,
            0x89,
            _id(BLOCK_LOAD) + _value(FEATURE, *index) + _selector(FEATURE, 0x8B, 0x8C, 0x8D, 0x8E),
            _value(FEATURE, 0xAC, 0, 32767, 16),
        ),
        _inside(
            LOGICAL,
            0x7F,
            _id(POOL) + _value(FEATURE, 0x80, 0, 32767, 16) + _value(FEATURE, 0x83, 0, 255, 8),
            _usages(0xA9, 0xAA) + _range(0, 1, 1, 2) + _main(FEATURE, VARIABLE) + _pad(FEATURE, 6),
        ),
    ]
    pointer = _inside(PHYSICAL, 1, _usages(0x30, 0x31) + _range(-COUNTS, COUNTS, 16, 2) + _main(IN, VARIABLE))
    return _page(1) + _inside(APPLICATION, 4, _id(POSITION) + pointer, _page(0x0F), *pid)


# Bytes of each report after its id.
OUTPUT_BYTES = {SET_EFFECT: 15, SET_ENVELOPE: 7, SET_CONSTANT: 3, OPERATION: 3, BLOCK_FREE: 1, CONTROL: 1, GAIN: 1}


@dataclass
class Effect:
    """One block: what was set, and until when it plays."""

    duration_s: float | None = None
    gain: float = 1.0
    direction: tuple[float, float] = (0.0, 0.0)
    magnitude: float = 0.0
    until: float | None = None
    told: bool = False


@dataclass
class Record:
    """A report that the host sent: `kind` is output, set (feature) or get (feature)."""

    t_s: float
    kind: str
    id: int
    data: bytes


@dataclass
class Joystick:
    """The joystick behind the bus. Its lock is taken by everything."""

    motion: Callable[[float], tuple[float, float]] = lambda t_s: (0.0, 0.0)
    free: float | None = None
    """The hand is off: metres a second for each newton, to the end of the way; None: the hand holds the handle."""
    record: list[Record] = field(default_factory=list)
    forces: list[tuple[float, float, float]] = field(default_factory=list)
    positions: list[tuple[float, float, float]] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    silent: bool = False
    """Whether input reports are kept back."""
    deaf: bool = False
    """Whether output reports are left waiting."""
    priority: int = 0
    """SCHED_FIFO priority of what would be hardware; 0: none."""
    report_descriptor: bytes = field(default_factory=descriptor)

    def __post_init__(self) -> None:
        self.lock = threading.RLock()
        self.input: deque[bytes] = deque()
        self.place = (0.0, 0.0)
        self._last_s = time.monotonic()
        self.power_on()

    def power_on(self) -> None:
        """As after a reset that nobody asked for: no effects, actuators off, gain full."""
        with self.lock:
            self.effects: dict[int, Effect] = {}
            self.enabled = self.paused = False
            self.gain = 1.0
            self.loaded: tuple[int, int] = (0, 3)
            self._tell(0)

    def clear(self) -> None:
        """Forgets what was recorded."""
        with self.lock:
            for kept in (self.record, self.forces, self.positions, self.faults):
                kept.clear()

    def force(self) -> tuple[float, float]:
        """What the handle shows now."""
        if not self.enabled or self.paused:
            return 0.0, 0.0
        now, x, y = time.monotonic(), 0.0, 0.0
        for effect in self.effects.values():
            if effect.until is not None and now < effect.until:
                level = FULL_SCALE_N * effect.magnitude * effect.gain * self.gain
                x, y = x + level * effect.direction[0], y + level * effect.direction[1]
        return x, y

    # ---- What the host says ----------------------------------------------------------------------------------------

    def output(self, data: bytes) -> None:
        """An output report, its id first."""
        with self.lock:
            report, body = data[0], data[1:]
            self.record.append(Record(time.monotonic(), "output", report, data))
            if len(body) != OUTPUT_BYTES.get(report):
                self._wrong(f"an output report {report} of {len(body)} bytes", data)
            elif report == CONTROL:
                self._control(body[0], data)
            elif report == GAIN:
                self.gain = body[0] / 255
            elif body[0] not in self.effects:
                self._wrong(f"effect {body[0]}, which was not created", data)
            else:
                self._effect(report, body, self.effects[body[0]], data)
            self._show()

    def _effect(self, report: int, body: bytes, effect: Effect, data: bytes) -> None:
        if report == SET_EFFECT:
            _, kind, duration, repeat, sample, delay, gain, trigger, flags, x, y = struct.unpack("<BB4HBB3B", body)
            if kind != 1 or repeat > 32767 or sample > 32767 or delay > 32767 or 8 < trigger < 255 or flags & ~7:
                self._wrong("a Set Effect out of its ranges", data)
            if duration > 32767 and duration != INFINITE:
                self._wrong(f"a duration of {duration}", data)
            effect.duration_s = float("inf") if duration == INFINITE else duration * 1e-3
            effect.gain = gain / 255
            effect.direction = _direction(flags, x, y)
            if effect.direction == (0.0, 0.0):
                self._wrong("an effect without a direction", data)
        elif report == SET_CONSTANT:
            (magnitude,) = struct.unpack("<h", body[1:])
            if abs(magnitude) > MAGNITUDE:
                self._wrong(f"a magnitude of {magnitude}", data)
            effect.magnitude = magnitude / MAGNITUDE
        elif report == OPERATION:
            operation, loops = body[1], body[2]
            if operation == STOP:
                effect.until = None
            elif operation not in (START, START_SOLO) or effect.duration_s is None:
                self._wrong(
                    f"operation {operation} on an effect that was{'' if effect.duration_s else ' not'} set", data
                )
            else:
                for other in self.effects.values():
                    other.until = None if operation == START_SOLO else other.until
                times = float("inf") if loops == 255 else max(loops, 1)
                effect.until = time.monotonic() + effect.duration_s * times
        elif report == BLOCK_FREE:
            del self.effects[body[0]]
        self._tell_playing()

    def _control(self, what: int, data: bytes) -> None:
        if what == STOP_ALL:
            for effect in self.effects.values():
                effect.until = None
        elif what == RESET:
            for effect in self.effects.values():
                effect.until = None
            self._tell_playing()
            self.effects.clear()
            self.paused, self.enabled = False, True
        elif what in (ENABLE, DISABLE):
            self.enabled = what == ENABLE
        elif what in (PAUSE, CONTINUE):
            self.paused = what == PAUSE
        else:
            self._wrong(f"device control {what}", data)
        self._tell(0)

    def set_feature(self, kind: int, report: int, data: bytes) -> None:
        """SET_REPORT."""
        with self.lock:
            if kind == usb_hid.REPORT_OUTPUT:
                self.output(data)
                return
            self.record.append(Record(time.monotonic(), "set", report, data))
            if report != CREATE or len(data) != 4 or data[1] != 1:
                self._wrong("a feature report that cannot be set", data)
                self.loaded = (0, 3)
                return
            free = next((index for index in range(1, EFFECTS + 1) if index not in self.effects), None)
            self.loaded = (free or 0, 1 if free else 2)
            if free:
                self.effects[free] = Effect()

    def get_feature(self, kind: int, report: int, length: int) -> bytes:
        """GET_REPORT."""
        with self.lock:
            self.record.append(Record(time.monotonic(), "get", report, b""))
            if (kind, report) == (usb_hid.REPORT_FEATURE, BLOCK_LOAD):
                return struct.pack("<BBBH", BLOCK_LOAD, *self.loaded, 100)
            if (kind, report) == (usb_hid.REPORT_FEATURE, POOL):
                return struct.pack("<BHBB", POOL, 100, EFFECTS, 1)
            return bytes([report]) + bytes(max(length - 1, 0))

    # ---- What the device says --------------------------------------------------------------------------------------

    def frame(self) -> bytes | None:
        """The next input report: the state if that has changed, else where the handle is."""
        with self.lock:
            self._show()
            for index, effect in self.effects.items():
                if effect.until is not None and time.monotonic() >= effect.until:
                    effect.until = None
                    self._tell_playing(index)
            if self.silent:
                return None
            return self.input.popleft() if self.input else self._position()

    def _position(self) -> bytes:
        now = time.monotonic()
        if self.free is None:
            self.place = self.motion(now)
        else:
            step = (now - self._last_s) * self.free
            moved = [
                min(max(at + step * push, -TRAVEL_M), TRAVEL_M)
                for at, push in zip(self.place, self.force(), strict=True)
            ]
            self.place = (moved[0], moved[1])
        self._last_s = now
        self.positions.append((now, *self.place))
        x, y = (round(min(max(at / TRAVEL_M, -1.0), 1.0) * COUNTS) for at in self.place)
        return struct.pack("<Bhh", POSITION, x, -y)

    def _tell(self, index: int) -> None:
        playing = index in self.effects and self.effects[index].until is not None
        # Paused, actuators enabled, safety switch, override switch, actuator power.
        flags = self.paused | self.enabled << 1 | 1 << 2 | 1 << 4
        self.input.append(struct.pack("<BBB", STATE, flags, playing | index << 1))

    def _tell_playing(self, *ended: int) -> None:
        for index, effect in self.effects.items():
            if index in ended or effect.told != (effect.until is not None):
                effect.told = effect.until is not None
                self._tell(index)

    def _show(self) -> None:
        force = self.force()
        if not self.forces or self.forces[-1][1:] != force:
            self.forces.append((time.monotonic(), *force))

    def _wrong(self, what: str, data: bytes) -> None:
        self.faults.append(f"{what}: {data.hex(' ')}")


def _direction(flags: int, x: int, y: int) -> tuple[float, float]:
    """Which way a positive magnitude pushes. An angle says where the force comes from; an axis, which way it goes."""
    if flags & 4:
        angle = 2 * math.pi * x / 255
        return -math.sin(angle), -math.cos(angle)
    return float(flags & 1), -float(flags >> 1 & 1)


class _Bus(USBDevice):  # type: ignore[misc]
    """A device whose endpoints are served once in a frame."""

    def __init__(self, joystick: Joystick, interface: Any, interval_ms: int, product: str) -> None:
        super().__init__(VENDOR, PRODUCT, manufacturer="hapticd", product=product, serial="VM1")
        self.set_speed(FULL_SPEED)
        self.add(interface)
        self.busid, self.busnum, self.devnum = "1-1", 1, 2
        self._joystick = joystick
        self._interval_s = interval_ms * 1e-3
        self._waiting: dict[int, deque[tuple[Any, Callable[[Any], None]]]] = {0: deque(), 1: deque()}
        self._guard = threading.Lock()
        self.gone = threading.Event()
        self.threads: list[int] = []
        """The threads that would be hardware."""

    def handle_urb(self, urb: Any, respond: Any = None) -> Any:
        """Control transfers at once; the others wait for their frame."""
        if urb.ep == 0:
            return super().handle_urb(urb, respond)
        with self._guard:
            self._waiting[urb.direction].append((urb, respond))
        return None

    def cancel_urb(self, number: int) -> None:
        """The host does not want it any more."""
        with self._guard:
            for way, waiting in self._waiting.items():
                self._waiting[way] = deque(entry for entry in waiting if entry[0].seqnum != number)

    def reset_io(self) -> None:
        """A new connection."""

    def frames(self) -> None:
        """One transfer each way in every interval, until the device is gone."""
        self.threads.append(threading.get_native_id())
        due = time.monotonic()
        while not self.gone.is_set():
            due = max(due + self._interval_s, time.monotonic() - self._interval_s)
            self.gone.wait(max(0.0, due - time.monotonic()))
            with self._guard:
                taken = self._waiting[protocol.OUT] and not self._joystick.deaf
                out = self._waiting[protocol.OUT].popleft() if taken else None
            if out is not None:
                urb, respond = out
                self._joystick.output(bytes(urb.buffer))
                urb.actual, urb.status = len(urb.buffer), 0
                respond(urb)
            with self._guard:
                data = self._joystick.frame() if self._waiting[protocol.IN] else None
                into = self._waiting[protocol.IN].popleft() if data is not None else None
            if into is not None:
                urb, respond = into
                urb.buffer, urb.actual, urb.status = data, len(data), 0
                respond(urb)


class Plug:
    """The joystick in its socket: `with Plug(joystick) as plug: plug.node`. A FirmwareJoystick goes in, too."""

    def __init__(self, joystick: Joystick, interval_ms: int = 4, product: str = "PID joystick") -> None:
        self.joystick, self.interval_ms, self.product = joystick, interval_ms, product
        self.node = ""

    def __enter__(self) -> Plug:
        self.plug_in()
        return self

    def __exit__(self, *_: object) -> None:
        self.pull()

    def plug_in(self, settle_s: float = 0.4) -> None:
        """Until hidraw is there, and the kernel's own driver has asked for whatever it asks for."""
        joystick = self.joystick
        joystick.power_on()
        interface = usb_hid.HID(
            joystick.report_descriptor,
            in_ep=0x81,
            in_interval=self.interval_ms,
            out_ep=0x01,
            out_interval=self.interval_ms,
            get_report=joystick.get_feature,
            set_report=joystick.set_feature,
        )
        self._bus = _Bus(joystick, interface, self.interval_ms, self.product)
        ours, kernels = socket.socketpair()
        threading.Thread(target=self._serve, args=(ours,), daemon=True).start()
        kernels.sendall(struct.pack(">HHI32s", protocol.VERSION, protocol.OP_REQ_IMPORT, 0, b"1-1"))
        answer = b""
        while len(answer) < 8 + 312:
            answer += kernels.recv(8 + 312 - len(answer))
        threading.Thread(target=self._bus.frames, daemon=True).start()
        (VHCI / "attach").write_text(f"{PORT} {kernels.fileno()} {1 << 16 | 2} {FULL_SPEED}")
        kernels.close()
        deadline = time.monotonic() + 20
        while not (node := self._find()):
            if time.monotonic() > deadline:
                raise TimeoutError("the kernel made no hidraw node of the joystick")
            time.sleep(0.002)
        self.node = node
        if joystick.priority:
            self.set_priority(joystick.priority)
        time.sleep(settle_s)

    def set_priority(self, priority: int) -> None:
        """The SCHED_FIFO priority of what would be hardware, and of the kernel's threads that carry its transfers."""
        kernels = [
            int(path.split("/")[2])
            for path in glob.glob("/proc/[0-9]*/comm")
            if Path(path).read_text().startswith(("vhci_rx", "vhci_tx"))
        ]
        for thread in (*self._bus.threads, *kernels):
            os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority))

    def _serve(self, connection: socket.socket) -> None:
        self._bus.threads.append(threading.get_native_id())
        protocol.serve_connection(connection, [self._bus])

    def pull(self) -> None:
        """Out of its socket, whoever uses it."""
        with contextlib.suppress(OSError):
            (VHCI / "detach").write_text(str(PORT))
        self._bus.gone.set()
        deadline = time.monotonic() + 20
        while os.path.exists(self.node):
            if time.monotonic() > deadline:
                raise TimeoutError(f"{self.node} stays")
            time.sleep(0.002)

    def _find(self) -> str:
        for path in glob.glob("/sys/class/hidraw/hidraw*"):
            node = "/dev/" + os.path.basename(path)
            if f"{VENDOR:08X}:{PRODUCT:08X}" in Path(path, "device/uevent").read_text() and os.path.exists(node):
                return node
        return ""

    def event_node(self) -> str:
        """The kernel's own device of it for constant forces; empty if there is none."""
        for path in sorted(glob.glob("/sys/class/input/event*")):
            effects = int(Path(path, "device/capabilities/ff").read_text().split()[0], 16)
            if effects >> (0x52 - 64) & 1:  # FF_CONSTANT, in the upper of two words
                return "/dev/input/" + os.path.basename(path)
        return ""
