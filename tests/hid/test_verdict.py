"""`devices parse`, `devices`, `doctor`, `check` and `run` agree whether a device can be driven, and why not."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from hapticd.analysis.check import check
from hapticd.cli import main
from hapticd.config.configuration import load_config
from hapticd.config.hid import Hid
from hapticd.doctor import devices as doctor
from hapticd.doctor.machine import Machine, Needs
from hapticd.hid import discovery, sources
from hapticd.hid.descriptor.layout import layout_of
from hapticd.hid.descriptor.parser import parse
from hapticd.hid.discovery import SysfsDevice
from hapticd.hid.drivers.pid_plan import periodic_problem
from hapticd.hid.plan import DeviceError
from hapticd.hid.replay import Recording, save
from hapticd.hid.sources import open_hid
from hapticd.hid.verdict import verdict_of
from tests.support.hid_descriptors import (
    CONSTANT,
    DATA_ARRAY,
    DESKTOP,
    INPUT,
    ORDINAL,
    OUTPUT,
    PID,
    Joystick,
    data,
    logical,
    physical,
    size,
    unit,
    usage,
    usage32,
    usage_page,
)

STICK = bytes(Joystick())
MILLISECONDS = unit(0x1003, -3)


def instead(old: bytes, new: bytes, descriptor: bytes = STICK) -> bytes:
    """Return the descriptor with the first occurrence of an item replaced."""
    assert old in descriptor
    return descriptor.replace(old, new, 1)


def with_duration(items: bytes) -> bytes:
    return instead(
        MILLISECONDS + usage_page(0x0F) + usage(0x50) + logical(0, 32767) + physical(0, 32767),
        usage_page(0x0F) + usage(0x50) + items,
    )


def with_magnitude(low: int, high: int) -> bytes:
    return instead(
        usage(0x70) + logical(-10000, 10000) + physical(-10000, 10000),
        usage(0x70) + logical(low, high) + physical(low, high),
    )


def with_axis(name: int) -> bytes:
    """Return a descriptor with other usages for the axes X and Y."""
    return instead(usage(0x30, 0x31) + logical(-32767, 32767), usage(name, name + 1) + logical(-32767, 32767))


def with_id(report: int, number: int) -> bytes:
    """Return a descriptor in which an output report, given by the usage of its collection, has another id."""
    start = usage(report) + b"\xa1\x02\x85"
    at = STICK.index(start) + len(start)
    return STICK[:at] + bytes([number]) + STICK[at + 1 :]


ENABLE = usage_page(PID) + usage(0x56) + logical(0, 1) + physical(0, 1) + size(1) + data(OUTPUT)
X_ENABLE = usage_page(DESKTOP) + usage(0x30) + logical(0, 1) + size(1) + data(OUTPUT)


def with_enable(items: bytes, descriptor: bytes = STICK) -> bytes:
    """Return a descriptor with another Direction Enable; the padding is not adapted."""
    return instead(ENABLE, usage_page(PID) + usage(0x56) + items, descriptor)


def with_axes_enable(items: bytes, descriptor: bytes = STICK) -> bytes:
    """Return a descriptor with another Axes Enable."""
    both = usage_page(DESKTOP) + usage(0x30, 0x31) + logical(0, 1) + size(1, 2) + data(OUTPUT)
    return instead(both, items, descriptor)


NO_ENABLE = bytes(Joystick(without=frozenset({0x56})))
UNSIGNED = bytes(Joystick(is_magnitude_signed=False))

# The expected reason, or None; the descriptor; and device.hid.
CASES: dict[str, tuple[str | None, bytes, dict[str, Any]]] = {
    "plain": (None, STICK, {}),
    "two reports with one id": (
        "Set Effect and Set Constant Force are output report 1: sending one would set the others to zero",
        with_id(0x73, 1),
        {},
    ),
    "a gain in the report of commands": (
        "Device Control and Device Gain are output report 7",
        with_id(0x7D, 7),
        {},
    ),
    "no ids": (
        "and Set Envelope are the one output report, which has no id",
        re.sub(rb"\x85.", b"", STICK, flags=re.DOTALL),
        {},
    ),
    "a direction of two parts, no Axes Enable": (
        None,
        instead(
            usage32(ORDINAL, 1, 2) + logical(0, 255) + physical(0, 36000),
            usage32(DESKTOP, 0x30, 0x31) + logical(-127, 127) + physical(-127, 127),
            bytes(Joystick(force_axes=())),
        ),
        {},
    ),
    "a duration that ends at 0": (
        "Duration goes from -5 to 0 in counts of 0.001 s: it holds no duration",
        with_duration(logical(-5, 0) + physical(-5, 0) + MILLISECONDS),
        {},
    ),
    "a duration below 0": ("Duration goes from -9 to -2", with_duration(logical(-9, -2) + physical(-9, -2)), {}),
    "a duration of 0 to 0": ("Duration goes from 0 to 0", with_duration(logical(0, 0) + physical(0, 0)), {}),
    "a duration of 1 ms": ("Duration goes from 0 to 1 in", with_duration(logical(0, 1) + physical(0, 1)), {}),
    "a duration of 1 ms where none is needed": (
        None,
        with_duration(logical(0, 1) + physical(0, 1)),
        {"quirks": ["infinite_duration"]},
    ),
    "a duration in picoseconds": (
        "in counts of 1e-12 s: it holds no duration of 0.005 s or more",
        with_duration(logical(0, 32767) + physical(0, 32767) + unit(0x1003, -12)),
        {},
    ),
    "a duration in years": (
        "its shortest effect would push for 1e+07 s after the daemon was killed",
        with_duration(logical(0, 32767) + physical(0, 32767) + unit(0x1003, 7)),
        {},
    ),
    "a duration of years a count": (
        "its shortest effect would push for",
        with_duration(logical(0, 1) + physical(0, 2147483647) + unit(0x1003, 7)),
        {},
    ),
    "a physical duration that is reversed": (
        None,
        with_duration(logical(0, 32767) + physical(500, 100) + MILLISECONDS),
        {},
    ),
    "two axes and nothing that tells them apart": (
        "neither Direction nor Axes Enable to distinguish them",
        bytes(Joystick(force_axes=(), direction_bits=0)),
        {},
    ),
    "one effect, and no angle": (
        "the device has two axes, room for one effect, and no angle for the direction of a force",
        bytes(Joystick(direction_bits=0)),
        {"quirks": ["one_effect"]},
    ),
    "a vector, and magnitudes without a sign": (
        "the device has two axes, magnitudes without a sign, and no angle for the direction of a force",
        instead(
            usage32(ORDINAL, 1, 2) + logical(0, 255) + physical(0, 36000),
            usage32(DESKTOP, 0x30, 0x31) + logical(-127, 127) + physical(-127, 127),
            bytes(Joystick(is_magnitude_signed=False)),
        ),
        {},
    ),
    "a scaled magnitude": (
        "count for a force of zero is not clear",
        instead(
            usage(0x70) + logical(0, 10000) + physical(0, 10000),
            usage(0x70) + logical(0, 10000) + physical(-10000, 10000),
            bytes(Joystick(is_magnitude_signed=False)),
        ),
        {},
    ),
    "only Rx and Ry": ("device.hid.axes.x.usage: the device has no axis X; it has Rx, Ry", with_axis(0x33), {}),
    "Rx and Ry as configured": (
        None,
        with_axis(0x33),
        {"axes": {"x": {"usage": "Rx"}, "y": {"usage": "Ry", "sign": -1}}},
    ),
    "an axis that the configuration alone has": (
        "device.hid.axes.y.usage: the device has no axis Z; it has X, Y",
        STICK,
        {"axes": {"y": {"usage": "Z"}}},
    ),
    "a magnitude without force": ("has no count above zero", with_magnitude(-10000, 0), {}),
    "a magnitude of three steps": ("fewer than 8 counts from none to full force", with_magnitude(-3, 3), {}),
    "a magnitude of one way": (
        "-1 to 10000, has less than half of the full force in the negative",
        with_magnitude(-1, 10000),
        {},
    ),
    "a digital stick": ("its range, -1 to 1, has fewer than 32 counts", bytes(Joystick(axis_range=(-1, 1))), {}),
    "a direction of one bit": (
        "(Direction): its range, 0 to 1, has fewer than 32 counts a turn",
        instead(
            logical(0, 255) + physical(0, 36000), logical(0, 1) + physical(0, 36000), bytes(Joystick(force_axes=()))
        ),
        {},
    ),
    "Direction Enable of 0 to 0 in 2 bits": (
        "Direction Enable that can be set (bit 82 of output report 1 has 2 bits and the range 0 to 0)",
        with_enable(logical(0, 0) + size(2) + data(OUTPUT)),
        {},
    ),
    "Direction Enable of 0 to 0 in one bit": (None, with_enable(logical(0, 0) + size(1) + data(OUTPUT)), {}),
    "Direction Enable beyond its bits": (
        "Direction Enable that can be set (bit 82 of output report 1 has 2 bits and the range 8 to 9)",
        with_enable(logical(8, 9) + size(2) + data(OUTPUT)),
        {},
    ),
    "Direction Enable of 40 bits": (
        "Direction Enable that can be set (bit 82 of output report 1 has 40 bits and the range 0 to 1)",
        with_enable(logical(0, 1) + size(40) + data(OUTPUT)),
        {},
    ),
    "Direction Enable as an array": (
        "Direction Enable that can be set (bit 82 of output report 1 is an array)",
        with_enable(logical(0, 1) + size(1) + data(OUTPUT, DATA_ARRAY)),
        {},
    ),
    "Direction Enable as an input": (
        "Direction Enable that can be set (it is in input report 1)",
        with_enable(logical(0, 1) + size(1) + data(INPUT)),
        {},
    ),
    "constant Direction Enable, and Axes Enable": (
        None,
        with_enable(logical(0, 1) + size(1) + data(OUTPUT, CONSTANT)),
        {},
    ),
    "constant Direction Enable, and no Axes Enable": (
        "Direction Enable that can be set (bit 80 of output report 1 is constant)",
        with_enable(logical(0, 1) + size(1) + data(OUTPUT, CONSTANT), bytes(Joystick(force_axes=()))),
        {},
    ),
    "constant Direction Enable, and magnitudes without a sign": (
        "Direction Enable that can be set (bit 82 of output report 1 is constant)",
        with_enable(logical(0, 1) + size(1) + data(OUTPUT, CONSTANT), UNSIGNED),
        {},
    ),
    "constant Axes Enable, and Direction Enable": (
        None,
        with_axes_enable(usage_page(DESKTOP) + usage(0x30, 0x31) + logical(0, 1) + size(1, 2) + data(OUTPUT, CONSTANT)),
        {},
    ),
    "constant Axes Enable, and no Direction Enable": (
        "Axes Enable X that can be set (bit 80 of output report 1 is constant), no Set Effect: Axes Enable Y that can",
        with_axes_enable(
            usage_page(DESKTOP) + usage(0x30, 0x31) + logical(0, 1) + size(1, 2) + data(OUTPUT, CONSTANT), NO_ENABLE
        ),
        {},
    ),
    "Axes Enable as an array": (
        "Axes Enable X that can be set (bit 80 of output report 1 is an array)",
        with_axes_enable(
            usage_page(DESKTOP) + usage(0x30, 0x31) + logical(0, 1) + size(1, 2) + data(OUTPUT, DATA_ARRAY), NO_ENABLE
        ),
        {},
    ),
    "one constant axis in Axes Enable": (
        "Axes Enable Y that can be set (bit 81 of output report 1 is constant)",
        with_axes_enable(X_ENABLE + usage(0x31) + data(OUTPUT, CONSTANT)),
        {},
    ),
    "no constant force": (
        "Set Constant Force",
        bytes(Joystick(without=frozenset({0x73}))),
        {},
    ),
    "bytes that make no sense": ("the descriptor ends after 0 of the item's 1 bytes", STICK[:100], {}),
}


def plugged(descriptor: bytes) -> SysfsDevice:
    return SysfsDevice("/dev/hidraw0", "Stick", 1, 2, "", "USB", "", descriptor, 1e-3, 1e-3, "ok")


@pytest.mark.parametrize("name", CASES)
def test_all_commands_give_the_same_verdict(
    name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    reason, descriptor, keys = CASES[name]
    device = {"kind": "hid", "hid": {"vendor": 1, **keys}}
    hid = Hid.model_validate(device["hid"])
    here = [plugged(descriptor)]
    monkeypatch.setattr(discovery, "find", lambda: here)
    monkeypatch.setattr(sources, "find", lambda: here)
    monkeypatch.setattr("hapticd.analysis.check.find", lambda: here)
    monkeypatch.setattr(sources, "HidrawDevice", lambda path: None)
    file, config = tmp_path / "descriptor", tmp_path / "config.yaml"
    file.write_bytes(descriptor)
    config.write_text(json.dumps({"device": device}))

    # run: a device that is found and can be driven is opened.
    reasons = {"run": ""}
    try:
        open_hid(hid)
    except DeviceError as error:
        reasons["run"] = str(error)
    # devices parse
    code = main(["devices", "parse", str(file), "-c", str(config)])
    captured = capsys.readouterr()
    message = captured.out + captured.err
    reasons["parse"] = "" if message.startswith("can be driven\n") else message
    assert code == (1 if captured.err else 0)
    # devices
    assert main(["devices", "-c", str(config)]) == 0
    listed = capsys.readouterr().out.splitlines()[1].strip()
    reasons["devices"] = "" if listed.startswith("can be driven") else listed
    assert main(["devices", "-c", str(config), "--json"]) == 0
    (item,) = json.loads(capsys.readouterr().out)
    assert item["usable"] == (reason is None) and (item["why_not"] is None) == (reason is None)
    # check
    reasons["check"] = "".join(problem.problem for problem in check(load_config({"device": device})).refused)
    # doctor
    findings = list(doctor.permissions(Machine(find=lambda sysfs, dev: here), Needs(device=hid)))
    reasons["doctor"] = "".join(one.what for one in findings if one.verdict == "fail")

    if reason is None:
        assert reasons == dict.fromkeys(reasons, "")
    else:
        assert all(reason in each for each in reasons.values()), reasons
        assert all("\n" not in each.strip() for of, each in reasons.items() if of != "parse")


@pytest.mark.parametrize("name", ["a duration of 0 to 0", "two axes and nothing that tells them apart", "plain"])
def test_a_recording_is_judged_as_the_device(
    name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`run` refuses it in one line, before anything is opened; `check` counts it."""
    reason, descriptor, _ = CASES[name]
    recording, config = tmp_path / "stick.jsonl", tmp_path / "config.yaml"
    save(recording, Recording("Stick", 1, 2, descriptor, ((0.0, bytes(7)),)), False)
    device = {"kind": "replay", "replay": {"path": str(recording)}}
    config.write_text(json.dumps({"device": device}))
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path / "run"))
    refused = [problem.problem for problem in check(load_config({"device": device})).refused]
    if reason is None:
        assert not refused
        return
    assert len(refused) == 1 and reason in refused[0]
    assert main(["check", "-c", str(config)]) == 1
    capsys.readouterr()
    assert main(["run", "-c", str(config)]) == 1
    message = capsys.readouterr().err.splitlines()[-1]
    assert message.startswith(f"hapticd: device.replay.path: {recording}: the device cannot be driven: ")
    assert reason in message


def test_a_description_that_does_not_fit_is_the_reason(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The reason is not what the descriptor lacks of the PID class."""
    file, config = tmp_path / "descriptor", tmp_path / "config.yaml"
    file.write_bytes(bytes(Joystick(without=frozenset({0x73}))))
    axis = {"bit_offset": 0, "bit_size": 8}
    report = {
        "input": {"report_id": 1, "x": {**axis, "counts_per_m": 1000}},
        "output": {"report_id": 99, "length": 2, "x": {**axis, "counts_per_n": 10}},
    }
    config.write_text(json.dumps({"device": {"kind": "hid", "hid": {"report": report}}}))
    assert main(["devices", "parse", str(file), "-c", str(config)]) == 0
    message = capsys.readouterr().out.splitlines()[0]
    assert message.startswith(
        "cannot be driven: device.hid.report.output.report_id: the device has no output report 99"
    )


def test_a_reversed_range_is_reported_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Linux refuses the complete descriptor, so such a device has no node."""
    descriptor = with_duration(logical(100, 5))
    file = tmp_path / "descriptor"
    file.write_bytes(descriptor)
    assert main(["devices", "parse", str(file)]) == 1
    message = capsys.readouterr().err
    assert "its logical minimum 100 is above its maximum 5" in message and message.count("\n") == 1
    why_not = verdict_of(Hid(), descriptor).why_not
    assert why_not is not None and "its logical minimum 100 is above its maximum 5" in why_not


def test_levels_of_periodic_effects_that_end_at_zero_are_refused() -> None:
    """The fade level was divided by its largest count, zero."""
    fade = usage(0x5D) + logical(0, 255) + physical(0, 255)
    descriptor = instead(fade, usage(0x5D) + logical(-5, 0) + physical(-5, 0))
    hid = Hid(offload="auto")
    assert periodic_problem(layout_of(parse(STICK)), hid) is None
    assert periodic_problem(layout_of(parse(descriptor)), hid) == "the device has no levels above zero"


def test_periodic_effects_that_share_a_report_are_not_used() -> None:
    """Each Set Periodic would set the numbers of the other report to zero. Constant forces do not need it."""
    hid = Hid(offload="auto")
    descriptor = with_id(0x6E, 4)
    assert verdict_of(hid, descriptor).drivable
    message = periodic_problem(layout_of(parse(descriptor)), hid)
    assert message == (
        "Set Constant Force and Set Periodic are output report 4: sending one would set the others to zero"
    )


def test_a_faulty_default_configuration_does_not_hide_the_devices(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "config.yaml"
    config.write_text("device: {kind: nonsense}\n")
    monkeypatch.setenv("HAPTICD_CONFIG", str(config))
    monkeypatch.setattr(discovery, "find", lambda: [plugged(STICK)])
    assert main(["devices"]) == 0
    captured = capsys.readouterr()
    assert "can be driven" in captured.out
    assert captured.err.startswith("hapticd: using the defaults, as the configuration is faulty: ")
    assert main(["devices", "-c", str(config)]) == 1
