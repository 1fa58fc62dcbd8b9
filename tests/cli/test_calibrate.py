"""`hapticd calibrate` and `hapticd verify` with the simulated joystick and with a simulated HID device."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapticd.analysis.calibration import rig
from hapticd.analysis.calibration.accelerometer import load_recording
from hapticd.cli import main
from hapticd.config.configuration import load_config
from hapticd.hid import sources
from hapticd.hid.connection import Opened
from hapticd.hid.drivers.pid import PidDriver
from hapticd.system.extras import install_command
from tests.support.cli import said
from tests.support.hid_descriptors import Joystick
from tests.support.hid_device import FakePid

SIM = "servo: {rate_hz: 1000}\n"
HID = "servo: {rate_hz: 1000, realtime: 'off'}\ndevice: {kind: hid, hid: {travel_m: 0.04, signs: trust}}\n"


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("sim.yaml").write_text(SIM)
    Path("hid.yaml").write_text(HID)


@pytest.mark.long
def test_calibrate_writes_the_section(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["calibrate", "-c", "sim.yaml", "-o", "found.yaml", "--plot", "response.png"]
    assert main(arguments) == 0
    out = capsys.readouterr().out
    assert "handle mass" in out and "grip stiffness" in out and "95 % bounds" in out
    assert "device:" not in out  # the section is in the file
    assert Path("response.png").read_bytes().startswith(b"\x89PNG")
    device = load_config(["sim.yaml", "found.yaml"]).device
    assert device.handle is not None and device.grip is not None
    assert device.handle.mass_kg == pytest.approx(0.04, rel=0.02)
    assert device.rearm_m == pytest.approx(2e-5)  # the encoder step, as the encoder has no noise
    assert device.handle.friction_n == pytest.approx(0.05, rel=0.02)
    assert device.grip.stiffness_n_per_m == pytest.approx(300, rel=0.05)
    # Existing files are replaced only with --overwrite.
    error = said(capsys, 1, "calibrate", "-c", "sim.yaml", "-o", "found.yaml")
    assert error.startswith("hapticd: found.yaml: already exists; give another name, or --overwrite")
    assert "response.png: already exists" in said(capsys, 1, "calibrate", "--plot", "response.png")


@pytest.mark.slow
def test_calibrate_prints_json(capsys: pytest.CaptureFixture[str]) -> None:
    Path("old.yaml").write_text("old")
    assert main(["calibrate", "-c", "sim.yaml", "--json", "-o", "old.yaml", "--overwrite", "--axis", "y"]) == 0
    result = json.loads(capsys.readouterr().out)
    mass = result["estimates"]["handle_mass"]
    assert mass["low"] <= mass["value"] <= mass["high"]
    assert result["axis"] == "y"
    assert result["device"]["handle"]["mass_kg"] == pytest.approx(mass["value"], rel=1e-3)
    assert {point["by"] for point in result["response"]["held"]} == {"encoder"}
    assert load_config("old.yaml").device.handle is not None


@pytest.mark.parametrize(
    ("missing", "what", "arguments"),
    [("matplotlib", "a plot", ("--plot", "response.png")), ("scipy", "calibrating", ())],
)
def test_calibrate_without_an_optional_package(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    missing: str,
    what: str,
    arguments: tuple[str, ...],
) -> None:
    monkeypatch.setitem(sys.modules, missing, None)
    error = said(capsys, 1, "calibrate", "-c", "sim.yaml", *arguments)
    assert error == f"hapticd: {what} needs {missing}: {install_command('fit')}\n"


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (None, "cannot be read: No such file or directory"),
        ("time_s,acceleration_m_per_s2\n0,1\n1\n", "line 3 must have 2 columns, has 1"),
        ("time_s,a\n" + "0,1\n" * 20, "has no column 'acceleration_m_per_s2'; known: time_s, a"),
        ("time_s,acceleration_m_per_s2\n" + "0,1\n" * 20, "time_s must rise from sample to sample"),
        ("time_s,acceleration_m_per_s2\n0,1\n1,x\n", 'line 3 must hold numbers, holds "x"'),
    ],
)
def test_faulty_recordings_are_refused(capsys: pytest.CaptureFixture[str], content: str | None, problem: str) -> None:
    if content is not None:
        Path("felt.csv").write_text(content)
    assert said(capsys, 1, "verify", "-c", "sim.yaml", "--recording", "felt.csv") == f"hapticd: felt.csv: {problem}\n"


def _array_alone(path: Path) -> None:
    with path.open("wb") as file:
        np.save(file, np.zeros(3))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("write", "problem"),
    [
        (lambda path: path.write_bytes(b""), "is not an archive written by numpy.savez"),
        (lambda path: path.write_bytes(bytes(50)), "is not an archive written by numpy.savez"),
        (_array_alone, "is not an archive written by numpy.savez"),
        (
            lambda path: np.savez(path, time_s=np.arange(20) * 1j, acceleration_m_per_s2=np.zeros(20)),
            "'time_s' must hold numbers, holds complex128",
        ),
        (
            lambda path: np.savez(path, time_s=np.array(["a"] * 20), acceleration_m_per_s2=np.zeros(20)),
            "'time_s' must hold numbers, holds str32",
        ),
    ],
)
def test_faulty_archives_are_refused(
    capsys: pytest.CaptureFixture[str], write: Callable[[Path], object], problem: str
) -> None:
    write(Path("felt.npz"))
    error = said(capsys, 1, "verify", "-c", "sim.yaml", "--recording", "felt.npz")
    assert error == f"hapticd: felt.npz: {problem}\n"


def test_a_table_of_a_spreadsheet_is_read() -> None:
    """The table has a byte order mark, and empty lines at its end."""
    lines = "".join(f"{time / 8},{time % 3}\r\n" for time in range(24))
    Path("felt.csv").write_bytes(b"\xef\xbb\xbf" + b"time_s,acceleration_m_per_s2\r\n" + lines.encode() + b"\r\n\r\n")
    recording = load_recording("felt.csv")
    assert recording.time_s.tolist() == [time / 8 for time in range(24)]
    assert recording.acceleration_m_per_s2.tolist() == [time % 3 - 1 for time in range(24)]


@pytest.mark.parametrize("number", ["nan", "inf"])
@pytest.mark.parametrize(
    "arguments",
    [("verify", "--speed"), ("verify", "--scale"), ("calibrate", "--force-n"), ("play", "wood", "--amplitude")],
)
def test_nan_and_infinity_are_refused(
    capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], number: str
) -> None:
    assert f"Invalid value for '{arguments[-1]}': {number} is not " in said(capsys, 2, *arguments, number)


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (("-o", "none/found.yaml"), "none/found.yaml: cannot be written: the folder none does not exist"),
        (("--plot", "none/response.png"), "none/response.png: cannot be written: the folder none does not exist"),
        (("--plot", "response.foo"), "response.foo: unknown picture format: the name must end in .png or another of "),
        (("--accelerometer", "felt.wav"), "felt.wav: the name of a recording must end in .npz or .csv"),
    ],
)
def test_an_output_that_cannot_be_written_is_refused_before_the_handle_moves(
    capsys: pytest.CaptureFixture[str], stick: FakePid, arguments: tuple[str, str], problem: str
) -> None:
    error = said(capsys, 1, "calibrate", "-c", "hid.yaml", "--yes", *arguments)
    assert error.startswith(f"hapticd: {problem}")
    assert not pushed(stick)


def test_no_number_is_cut_off_on_80_columns(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert main(["verify", "-c", "sim.yaml"]) == 0
    table = capsys.readouterr().out
    assert "cellophane" in table and "…" not in table
    normals = [[0.0, 1.0], [0.6, 0.8], [-0.6, 0.8]]
    walls = {
        f"a_rather_long_name_{index}": {"kind": "wall", "point_m": [0, 0], "normal": normal, "material": "it"}
        for index, normal in enumerate(normals)
    }
    scene = {"materials": {"it": {"stiffness_n_per_m": 99_990}}, "scene": {"objects": walls}}
    Path("stiff.yaml").write_text(json.dumps(scene))
    assert main(["check", "-c", "stiff.yaml"]) == 1
    table = capsys.readouterr().out
    assert "eigenvalues" in table and "unsafe" in table and "…" not in table


def test_verify(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verify", "-c", "sim.yaml"]) == 0
    table = capsys.readouterr().out
    assert "wood" in table and "silent" in table
    assert main(["verify", "-c", "sim.yaml", "--json"]) == 0
    result = {(each["material"], each["use"]): each for each in json.loads(capsys.readouterr().out)}
    assert result["steel", "tap"]["displayed_hz"] is None
    assert 0 < result["cellophane", "rupture"]["error"] < 1
    assert 0 < result["wood", "wall"]["error"] < 1
    np.savez("felt.npz", time_s=np.arange(100.0), acceleration_m_per_s2=np.random.default_rng(1).normal(size=100))
    assert "the drive was not found in the recording" in said(
        capsys, 1, "verify", "-c", "sim.yaml", "--recording", "felt.npz"
    )


def test_a_real_device_needs_a_recording(capsys: pytest.CaptureFixture[str]) -> None:
    error = said(capsys, 1, "verify", "-c", "hid.yaml")
    assert error == "hapticd: a real device needs an accelerometer on its handle: give --recording FILE\n"


# ---- A device and its servo --------------------------------------------------------------------------------------


@pytest.fixture
def stick(monkeypatch: pytest.MonkeyPatch) -> Iterator[FakePid]:
    """A joystick whose handle is stuck in the middle."""
    fake = FakePid(bytes(Joystick()))
    monkeypatch.setattr(rig, "SERVO_STALL_TIMEOUT_S", 60.0)
    monkeypatch.setattr(
        sources,
        "open_hid",
        lambda hid: Opened(fake.device, PidDriver(fake.layout, hid), "Lab stick", None, True, measure=False),
    )
    middle = {name: (axis.field.logical_min + axis.field.logical_max) // 2 for name, axis in fake.layout.input.items()}
    fake.report(middle["x"], middle["y"])
    yield fake
    fake.close()


def pushed(stick: FakePid) -> list[str]:
    return [entry for entry in stick.log if entry.startswith("constant_force")]


def test_a_stuck_handle_is_reported_and_released(capsys: pytest.CaptureFixture[str], stick: FakePid) -> None:
    error = said(capsys, 1, "calibrate", "-c", "hid.yaml", "--yes", "-o", "found.yaml")
    assert "the handle does not move under 0.8 N at 60 Hz" in error
    stick.wait(lambda: not stick.enabled)
    assert len(pushed(stick)) > 10
    assert stick.force() == (0.0, 0.0)
    assert not Path("found.yaml").exists()


def test_ctrl_c_sets_the_force_to_zero(
    capsys: pytest.CaptureFixture[str], stick: FakePid, monkeypatch: pytest.MonkeyPatch
) -> None:
    strike = rig.ServoRig.strike
    shown: list[tuple[float, float]] = []
    stick.on_log = lambda _: shown.append(stick.force())

    def interrupted(self: rig.ServoRig, *arguments: Any) -> int:
        """Interrupt the first burst after a force was seen."""
        felt = any(force != (0.0, 0.0) for force in shown)
        tick = strike(self, *arguments)
        if felt:
            raise KeyboardInterrupt
        return tick

    monkeypatch.setattr(rig.ServoRig, "strike", interrupted)
    assert main(["calibrate", "-c", "hid.yaml", "--yes"]) == 130
    assert capsys.readouterr().err == "hapticd: interrupted; the force is zero, nothing was written\n"
    assert any(force != (0.0, 0.0) for force in shown)
    stick.wait(lambda: not stick.enabled)
    assert stick.force() == (0.0, 0.0)


def test_nothing_moves_before_the_confirmation(
    capsys: pytest.CaptureFixture[str], stick: FakePid, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("click.confirm", _refuse)
    assert main(["calibrate", "-c", "hid.yaml"]) == 130
    assert stick.log == []


def _refuse(text: str, **_: object) -> Callable[[], None]:
    import click

    assert "Let go of the handle" in text
    raise click.Abort
