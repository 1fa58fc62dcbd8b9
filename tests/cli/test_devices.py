"""`hapticd devices parse`: files with a report descriptor, and other files."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hapticd.cli import main
from tests.support.cli import said
from tests.support.hid_descriptors import Joystick

STICK = bytes(Joystick())


def hexadecimal(data: bytes) -> str:
    return "\n".join(data[at : at + 16].hex(" ") for at in range(0, len(data), 16)) + "\n"


@pytest.mark.parametrize(
    "content",
    [
        STICK,
        hexadecimal(STICK).encode(),
        STICK.hex().upper().encode(),
        b"# a joystick\n" + ", ".join(f"0x{byte:02X}" for byte in STICK).encode() + b" // its end\n",
    ],
)
def test_json(tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes) -> None:
    file = tmp_path / "descriptor"
    file.write_bytes(content)
    assert main(["devices", "parse", str(file), "--json"]) == 0
    parsed = json.loads(capsys.readouterr().out)
    assert parsed["usable"] is True and parsed["missing"] == []
    field = parsed["input"]["y"]["field"]
    assert {name: field[name] for name in ("report_id", "bit_offset", "bit_size", "logical_min")} == {
        "report_id": 1,
        "bit_offset": 16,
        "bit_size": 16,
        "logical_min": -32767,
    }
    assert parsed["constant_force"]["report_bytes"] == 4
    assert parsed["constant_force"]["magnitude"]["bit_offset"] == 8
    assert parsed["device_control"]["command"]["kind"] == "array"
    assert parsed["device_control"]["command"]["entries"]["stop_all_effects"]["value"] == 3
    assert parsed["pool"]["simultaneous_effects_max"]["bit_offset"] == 16


def test_json_of_bits(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "descriptor"
    file.write_bytes(bytes(Joystick(control="bits")))
    assert main(["devices", "parse", str(file), "--json"]) == 0
    control = json.loads(capsys.readouterr().out)["device_control"]
    assert control["command"]["kind"] == "bits" and control["report_id"] == 7
    assert control["command"]["entries"]["device_reset"]["field"]["bit_offset"] == 3


def test_a_single_effect_reports_its_force_at_right_angles(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With 255 counts in a turn, half a count is 1.2 % of a force; two effects, or 35999 counts, have no such error."""
    file = tmp_path / "descriptor"
    leaks = []
    for like in (
        Joystick(is_magnitude_signed=False),
        Joystick(is_magnitude_signed=False, direction_bits=16),
        Joystick(),
    ):
        file.write_bytes(bytes(like))
        assert main(["devices", "parse", str(file)]) == 0
        leaks.append("up to 1.2 % of a force acts at right angles to it" in capsys.readouterr().out)
    assert leaks == [True, False, False]
    assert main(["devices", "parse", str(file), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["leak"] == 0.0


def test_words(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "descriptor"
    file.write_bytes(STICK)
    assert main(["devices", "parse", str(file)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "can be driven"
    assert lines[1] == "forces: along x and y, by 2 effects"
    assert lines[2] == "axis x: input report 1, 16 bits at 0, -32767 to 32767"
    assert "constant force: magnitude in output report 4, 16 bits at 8, -10000 to 10000" in lines
    file.write_bytes(bytes(Joystick(without=frozenset({0x73, 0x96}))))
    assert main(["devices", "parse", str(file)]) == 0
    line = capsys.readouterr().out.splitlines()[0]
    assert line == "cannot be driven: its report descriptor has no Set Constant Force, no Device Control"


@pytest.mark.parametrize(
    ("like", "message"),
    [
        (Joystick(force_axes=(0x30,), directions=1), "forces: along x only, by 1 effect"),
        (Joystick(is_magnitude_signed=False, direction_bits=16), "forces: along x and y, by 1 effect"),
    ],
)
def test_the_pushed_axes_and_the_number_of_effects_are_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], like: Joystick, message: str
) -> None:
    file = tmp_path / "descriptor"
    file.write_bytes(bytes(like))
    assert main(["devices", "parse", str(file)]) == 0
    assert message in capsys.readouterr().out.splitlines()


def test_skipped_items_are_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "descriptor"
    file.write_bytes(STICK[:6] + bytes([0x0D, 7]) + STICK[6:])
    assert main(["devices", "parse", str(file)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "can be driven"
    assert lines[-1] == "not used: report descriptor, byte 6 (reserved item): skipped"
    assert main(["devices", "parse", str(file), "--json"]) == 0
    parsed = json.loads(capsys.readouterr().out)
    assert parsed["usable"] and parsed["problems"] == ["report descriptor, byte 6 (reserved item): skipped"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "the report descriptor is empty"),
        (STICK[:-1], "report descriptor: a collection is still open at its end"),
        (b"05 01\n09 4\n", 'descriptor, line 2: "09 4": must be bytes in hexadecimal such as 05 01 09 04'),
        (b"a joystick\n", 'line 1: "a joystick": must be bytes in hexadecimal'),
    ],
)
def test_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes, message: str) -> None:
    file = tmp_path / "descriptor"
    file.write_bytes(content)
    assert message in said(capsys, 1, "devices", "parse", str(file), "--json")


def test_a_file_without_end(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["devices", "parse", "/dev/zero"]) == 1
    assert "must have at most 4096 bytes" in capsys.readouterr().err


def test_no_such_file(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["devices", "parse", "/nowhere/descriptor"]) == 1
    assert "/nowhere/descriptor" in capsys.readouterr().err
