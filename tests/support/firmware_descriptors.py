"""Report descriptors of devices that exist: two that were captured (tests/data/hid), and the known families of firmware
that anybody can build, written anew from what is public of them. Each has the odd items that its family has."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from tests.support.hid_descriptors import (
    APPLICATION,
    BUTTON,
    DATA_ARRAY,
    DESKTOP,
    FEATURE,
    INPUT,
    LOGICAL,
    ORDINAL,
    OUTPUT,
    PHYSICAL,
    PID,
    collection,
    data,
    logical,
    pad,
    physical,
    report_id,
    size,
    unit,
    usage,
    usage32,
    usage_page,
    usage_range,
    value,
)

_CAPTURED: Final = Path(__file__).parents[1] / "data" / "hid"
EFFECTS: Final = (0x26, 0x27, 0x30, 0x31, 0x32, 0x33, 0x34, 0x40, 0x41, 0x42, 0x43)
_IDS: Final = {
    "state": 2,
    "set_effect": 1,
    "envelope": 2,
    "condition": 3,
    "periodic": 4,
    "constant_force": 5,
    "ramp": 6,
    "operation": 10,
    "block_free": 11,
    "control": 12,
    "gain": 13,
    "create": 5,
    "load": 6,
    "pool": 7,
}


def _captured(name: str) -> bytes:
    return bytes.fromhex((_CAPTURED / f"{name}.hex").read_text())


SIDEWINDER_FF2: Final = _captured("ms-sidewinder-ff2")
"""Microsoft SideWinder Force Feedback 2, from a capture of its bus."""
XBOX_ONE_S: Final = _captured("xbox-one-s-bt-negative")
"""Xbox One S controller: it has the page of force feedback for its rumble, and no constant force."""


def _index(kind: int) -> bytes:
    return value(kind, 0x22, 1, 40, 8)


def _times(*names: int) -> bytes:
    body = usage(*names) + logical(0, 32767) + physical(0, 32767) + unit(0x1003, -3) + size(16, len(names))
    return body + data(OUTPUT) + unit(0)


def _percent(kind: int, name: int) -> bytes:
    """0 to 255, which stand for 0 to 10000."""
    return usage(name) + logical(0, 255) + physical(0, 10000) + size(8) + data(kind)


def _chosen(kind: int, *names: int) -> bytes:
    return usage(*names) + logical(1, len(names)) + physical(1, len(names)) + size(8) + data(kind, DATA_ARRAY)


def _report(name: str, around: int, *body: bytes) -> bytes:
    return usage_page(PID) + collection(usage(around), LOGICAL, report_id(_IDS[name]), *body)


def _levels(kind: str, most: int, bits: int) -> bytes:
    """Envelope, periodic, constant force or ramp, whose numbers go up to `most`."""
    least = -most
    body = _index(OUTPUT)
    match kind:
        case "constant_force":
            return _report(kind, 0x73, body, value(OUTPUT, 0x70, least, most, 16))
        case "ramp":
            return _report(kind, 0x74, body, *(value(OUTPUT, name, least, most, 16) for name in (0x75, 0x76)))
        case "envelope":
            body += b"".join(value(OUTPUT, name, 0, most, bits) for name in (0x5B, 0x5D))
            long = usage(0x5C, 0x5E) + logical(0, 32767) + physical(0, 32767) + unit(0x1003, -3) + size(32, 2)
            return _report(kind, 0x5A, body, long + data(OUTPUT) + unit(0))
        case _:
            body += value(OUTPUT, 0x70, 0, most, bits) + value(OUTPUT, 0x6F, least, most, 16)
            phase = usage(0x71) + logical(0, 35999) + physical(0, 35999) + unit(0x14, -2) + size(16) + data(OUTPUT)
            period = usage(0x72) + logical(0, 32767) + physical(0, 32767) + unit(0x1003, -3) + size(32)
            return _report(kind, 0x6E, body, phase, period + data(OUTPUT) + unit(0))


def _condition(most: int, has_negative: bool = True) -> bytes:
    body = _index(OUTPUT) + value(OUTPUT, 0x23, 0, 3, 4) + pad(OUTPUT, 4)
    names = (0x60, 0x61, 0x62) if has_negative else (0x60, 0x61)
    body += b"".join(value(OUTPUT, name, -most, most, 16) for name in names)
    body += b"".join(value(OUTPUT, name, 0, most, 16) for name in (0x63, 0x64, 0x65)) if has_negative else b""
    return _report("condition", 0x5F, body)


def _state(*names: int, is_indexed: bool = True) -> bytes:
    body = usage(*names) + logical(0, 1) + physical(0, 1) + size(1, len(names)) + data(INPUT)
    body += pad(INPUT, 8 - len(names))
    if is_indexed:
        body += value(INPUT, 0x94, 0, 1, 1) + value(INPUT, 0x22, 1, 40, 7)
    return _report("state", 0x92, body)


def _tail(effects: tuple[int, ...], control: bytes) -> bytes:
    """Operation, block free, control, gain, create, load and pool, which all of these have alike."""
    starts = _chosen(OUTPUT, 0x79, 0x7A, 0x7B)
    operation = _index(OUTPUT) + collection(usage(0x78), LOGICAL, starts) + value(OUTPUT, 0x7C, 0, 255, 8)
    bytes_wanted = usage_page(DESKTOP) + value(FEATURE, 0x3B, 0, 511, 10) + pad(FEATURE, 6)
    status = collection(usage(0x8B), LOGICAL, _chosen(FEATURE, 0x8C, 0x8D, 0x8E))
    # RAM Pool Available is declared as an array.
    left = usage(0xAC) + logical(0, 65535) + physical(0, 65535) + size(16) + data(FEATURE, DATA_ARRAY)
    flags = usage(0xA9, 0xAA) + logical(0, 1) + physical(0, 1) + size(1, 2) + data(FEATURE) + pad(FEATURE, 6)
    types = collection(usage(0x25), LOGICAL, _chosen(FEATURE, *effects))
    return b"".join(
        (
            _report("operation", 0x77, operation),
            _report("block_free", 0x90, _index(OUTPUT)),
            control,
            _report("gain", 0x7D, _percent(OUTPUT, 0x7E)),
            _report("create", 0xAB, types, bytes_wanted),
            _report("load", 0x89, _index(FEATURE), status, left),
            _report("pool", 0x7F, value(FEATURE, 0x80, 0, 65535, 16), value(FEATURE, 0x83, 0, 255, 8), flags),
        )
    )


def _set_effect(
    effects: tuple[int, ...],
    axes: int,
    *,
    turn: int,
    turn_bits: int,
    most_enable: int = 1,
    is_directed: bool = True,
    has_delay: bool = True,
    has_offsets: bool = True,
) -> bytes:
    """`most_enable`: the logical maximum of Axes Enable, which Direction Enable has, too. `is_directed`: the host may
    set Direction Enable; else it is constant."""
    body = _index(OUTPUT) + collection(usage(0x25), LOGICAL, _chosen(OUTPUT, *effects))
    body += _times(0x50, 0x54, 0x51, 0xA7) if has_delay else _times(0x50, 0x54, 0x51)
    body += _percent(OUTPUT, 0x52) + value(OUTPUT, 0x53, 1, 8, 8)
    bits = usage_page(DESKTOP) + usage(*range(0x30, 0x30 + axes)) + logical(0, most_enable) + size(1, axes)
    body += collection(usage(0x55), LOGICAL, bits + data(OUTPUT)) + usage_page(PID)
    body += usage(0x56) + size(1) + data(OUTPUT, 0x02 if is_directed else 0x03)
    body += size(1, 7 - axes) + data(OUTPUT, 0x03)
    # The unit is taken back before the field.
    angle = usage32(ORDINAL, *range(1, axes + 1)) + unit(0x14, -2) + logical(0, turn) + physical(0, 36000)
    body += collection(usage(0x57), LOGICAL, angle + unit(0) + size(turn_bits, axes) + data(OUTPUT))
    if has_offsets:
        offsets = usage32(ORDINAL, *range(1, min(axes, 2) + 1)) + logical(0, 32765) + size(16, min(axes, 2))
        body += usage_page(PID) + collection(usage(0x58), LOGICAL, offsets + data(OUTPUT))
    return _report("set_effect", 0x21, body)


def _joystick(axes: tuple[int, ...], *forces: bytes, buttons: int = 32, is_first: bool = True) -> bytes:
    keys = usage_page(BUTTON) + usage_range(1, buttons) + logical(0, 1) + size(1, buttons) + data(INPUT)
    handle = usage_page(DESKTOP) + usage(*axes) + logical(-32767, 32767) + size(16, len(axes)) + data(INPUT)
    inputs = report_id(1) + (keys + handle if is_first else handle + keys)
    return collection(
        usage_page(DESKTOP) + usage(0x04), APPLICATION, collection(usage(0x01), PHYSICAL, inputs), *forces
    )


def openffboard(axes: int) -> bytes:
    """OpenFFBoard with one axis or two. All of its joysticks have eight axes of input. With one, Axes Enable has the
    logical range 0 to 0, and Direction Enable has it, too. Commands of Device Control are bits of the range 1 to 6."""
    most = 32767
    commands = usage(*range(0x97, 0x9D)) + logical(1, 6) + size(1, 8) + data(OUTPUT)
    control = collection(usage(0x96), LOGICAL, commands)
    enable = 0 if axes == 1 else 1
    return _joystick(
        (0x30, 0x31, 0x32, 0x33, 0x34, 0x35, 0x37, 0x36),
        _state(0x9F, 0xA0, 0xA4, 0xA6, 0x94, is_indexed=False),
        _set_effect(EFFECTS, axes, turn=36000, turn_bits=16, most_enable=enable),
        _levels("envelope", most, 16),
        _condition(most),
        _levels("periodic", most, 16),
        _levels("constant_force", most, 16),
        _levels("ramp", most, 16),
        _tail(EFFECTS, _report("control", 0x95, control)),
        buttons=64,
    )


def _array_control() -> bytes:
    return _report("control", 0x96, _chosen(OUTPUT, *range(0x97, 0x9D)))


def arduino(axes: int) -> bytes:
    """The Arduino joystick library with force feedback, and Fino, which began as that: Direction Enable is constant,
    directions have 8 bits, numbers go up to 10000; three axes, or two in older ones."""
    types = (*EFFECTS, 0x28)
    return _joystick(
        (0x30, 0x31, 0x32),
        _state(0x9F, 0xA0, 0xA4, 0xA5, 0xA6),
        _set_effect(types, axes, turn=255, turn_bits=8, is_directed=False),
        _levels("envelope", 10000, 16),
        _condition(10000),
        _levels("periodic", 10000, 16),
        _levels("constant_force", 10000, 16),
        _levels("ramp", 10000, 16),
        _tail(types, _array_control()),
    )


def _adapt_ffb_joy() -> bytes:
    """adapt-ffb-joy: 180 counts a turn, magnitudes up to 255, no Start Delay, conditions with one coefficient."""
    types = (*EFFECTS, 0x28)
    return _joystick(
        (0x30, 0x31, 0x32),
        _state(0x9F, 0xA0, 0xA4, 0xA5, 0xA6),
        _set_effect(types, 2, turn=180, turn_bits=8, has_delay=False, has_offsets=False),
        _levels("envelope", 255, 8),
        _condition(127, has_negative=False),
        _levels("periodic", 255, 8),
        _levels("constant_force", 255, 16),
        _levels("ramp", 127, 16),
        _tail(types, _array_control()),
        buttons=16,
        is_first=False,
    )


OPENFFBOARD_1: Final = openffboard(1)
OPENFFBOARD_2: Final = openffboard(2)
ARDUINO: Final = arduino(3)
FINO: Final = arduino(3)
ADAPT_FFB_JOY: Final = _adapt_ffb_joy()
