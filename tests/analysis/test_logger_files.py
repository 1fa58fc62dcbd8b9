"""Recordings as loggers, oscilloscopes and pipes write them: units in names, preambles, a .wav of unknown length."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from hapticd.analysis.calibration.accelerometer import load_recording
from hapticd.base.errors import HapticdError
from hapticd.fit.recording import Recording, RecordingError, load

SAMPLES = 40
VALUES = [round(math.sin(0.7 * index) + 0.5, 6) for index in range(SAMPLES)]
G = 9.80665
BY_NUMBER = "columns: {time: {column: 1}, acceleration: {column: 2}}"
SI_NAMES = ["time_s,acceleration_m_per_s2"]


def rows(separator: str = ",", point: str = ".", after: str = "", ms: bool = False) -> list[str]:
    times = [index if ms else index / 1000 for index in range(SAMPLES)]
    pairs = zip(times, VALUES, strict=True)
    return [f"{time:.4f}{separator}{value:.6f}".replace(".", point) + after for time, value in pairs]


def written(
    folder: Path, head: Sequence[str], numbers: Sequence[str], beside: str = "", encoding: str = "utf-8"
) -> Path:
    path = folder / "a.csv"
    path.write_bytes("\n".join([*head, *numbers, ""]).encode(encoding))
    Path(f"{path}.yaml").write_text(beside or "# nothing")
    return path


def acceleration(recording: Recording) -> list[float]:
    assert recording.acceleration_m_per_s2 is not None
    return list(recording.acceleration_m_per_s2)


def check_scale(path: Path, scale: float = 1.0) -> None:
    recording = load(path)
    assert recording.rate_hz == pytest.approx(1000)
    assert acceleration(recording) == pytest.approx([scale * value for value in VALUES], rel=1e-9, abs=1e-12)


def refused(path: Path) -> str:
    with pytest.raises(RecordingError) as error:
        load(path)
    text = str(error.value)
    assert text.startswith(f"{path}: ") and text.isprintable()
    return text


# ---- Units in names and in lines of units ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "scale"),
    [
        ("Acc (g)", G), ("accel [m/s^2]", 1), ("ax_g", G), ("Acc X g", G), ("a / g", G), ("a/(mm/s^2)", 1e-3),
        ("acc_mg", 1e-3 * G), ("ACC (G)", G), ("AX_G", G), ("Beschl. {g}", G), ("\u52a0\u901f\u5ea6X\uff08g\uff09", G),
        ("a (mm s\u207b\u00b2)", 1e-3), ("a_mm_per_s2", 1e-3), ("a_mmps2", 1e-3), ("Accel..mm.s.2.", 1e-3),
        ("a (mm/s/s)", 1e-3), ("a (cm/sec^2)", 1e-2), ("a (millimeters per second squared)", 1e-3), ("g", G),
        ("a (g-force)", G), ("a(g) filtered", G), ("a (raw) (g)", G), ("a [in g]", G), ("a (mm/(s^2))", 1e-3),
        ("Acc (g, filtered)", G), ("a (RMS mg)", 1e-3 * G), ("X (100g)", G), ("Acc (\u00b12g)", G), ("Acc in G", G),
        ("ax_g (left)", G), ("Accel, g (LGR S/N: 123, SEN S/N: 123)", G), ("acc_mg_x", 1e-3 * G), ("ax_g.1", G),
        ("ax_g_filtered", G), ("accel_x_milli_g", 1e-3 * G), ("acc-x-mg", 1e-3 * G), ("acc_g_force", G),
        ("a (gRMS)", G), ("a_mm_s_2_1", 1e-3), ("a [mm/s$^2$]", 1e-3), ("a (mm/sek\u00b2)", 1e-3),
        ("a (mm/s\u00c2\u00b2)", 1e-3), ("a (mm/s\ufffd)", 1e-3), ("a (mm/s\u00fd)", 1e-3),
        # No units.
        ("Acc (x)", 1), ("Acc (1)", 1), ("Acc (filtered)", 1), ("Acc (left)", 1), ("a_n", 1), ("acc_mm", 1), ("a_v", 1),
        ("Acc (s1)", 1), ("Acc (L/R)", 1), ("Acc (MA)", 1), ("Acc (min)", 1), ("ax_G", 1), ("16 g", 1), ("way[2]", 1),
        ("Acceleration (without g)", 1), ("a (m/s^2) (g removed)", 1), ("Beschl. ohne g", 1), ("acc_wo_g", 1),
    ],
)  # fmt: skip
def test_a_unit_in_a_name_is_read(tmp_path: Path, name: str, scale: float) -> None:
    check_scale(written(tmp_path, [f'Time (s),"{name}"'], rows(), BY_NUMBER), scale)


@pytest.mark.parametrize(
    "name", ["Time (ms)", "TIME [MS]", "t_ms", "t/ms", "millis", "Zeit in ms", "Time (milliseconds)", "t (msec)"]
)
def test_a_unit_of_time_in_a_name_is_read(tmp_path: Path, name: str) -> None:
    check_scale(written(tmp_path, [f"{name},a"], rows(ms=True), BY_NUMBER))


@pytest.mark.parametrize(
    ("quantity", "name", "scale"),
    [
        ("position", "d (\u00b5)", 1e-6),
        ("force", "F_mN", 1e-3), ("force", "Fn [N]", 1), ("force", "F_n", 1), ("position", "x (\u00b5m)", 1e-6),
        ("position", "d [micron]", 1e-6), ("tangential_position", "s_mm", 1e-3), ("position", "Z (MM)", 1e-3),
    ],
)  # fmt: skip
def test_units_of_other_quantities_in_names(tmp_path: Path, quantity: str, name: str, scale: float) -> None:
    beside = f"columns: {{time: {{column: 1}}, {quantity}: {{column: 2}}}}"
    found = load(written(tmp_path, [f"t,{name}"], rows(), beside))
    values = getattr(found, {"force": "force_n"}.get(quantity, f"{quantity}_m"))
    assert list(values) == pytest.approx([scale * value for value in VALUES], rel=1e-9, abs=1e-15)


@pytest.mark.parametrize(("name", "scale"), [("v_mm_s", 1e-3), ("v (cm/s)", 1e-2), ("vel_mmps", 1e-3), ("v_ms", 1)])
def test_a_speed_in_an_array_has_the_unit_of_its_name(tmp_path: Path, name: str, scale: float) -> None:
    np.savez(tmp_path / "a.npz", **{"rate_hz": np.array(1000), "a [g]": np.array(VALUES), name: np.array(250.0)})
    beside = f"columns: {{acceleration: {{column: 'a [g]'}}, speed: {{column: '{name}'}}}}"
    (tmp_path / "a.npz.yaml").write_text(beside)
    found = load(tmp_path / "a.npz")
    assert found.speed_m_per_s == pytest.approx(250 * scale)
    assert acceleration(found) == pytest.approx([G * value for value in VALUES])
    assert "the acceleration is in g by the name of its column 'a [g]'" in found.notes


@pytest.mark.parametrize(
    ("name", "given", "scale"),
    [
        ("Acc (g)", "scale: -1", -G), ("Acc (g)", "unit: G", G), ("Acc (g)", "unit: m/s^2, scale: 9.81", 9.81),
        ("Acc (m/s^2)", "unit: m/s\u00b2", 1), ("Acc (m/s^2)", "unit: ms^-2, scale: 2", 2),
        ("Acc (mV)", "unit: g, scale: 0.01", 0.01 * G), ("Acc (mV)", "scale: 0.01", 0.01), ("a_raw", "scale: 0.5", 0.5),
        ("Acc (V)", "scale: 1, unit: g", G), ("Acc (x)", "unit: g", G), ("F (N)", "scale: 3", 3),
    ],
)  # fmt: skip
def test_the_yaml_file_agrees_with_the_name(tmp_path: Path, name: str, given: str, scale: float) -> None:
    beside = f"columns: {{time: {{column: 1}}, acceleration: {{column: 2, {given}}}}}"
    check_scale(written(tmp_path, [f"t,{name}"], rows(), beside), scale)


@pytest.mark.parametrize(
    ("name", "given", "told"),
    [
        ("Acc (m/s^2)", "unit: g", "is in m/s^2 by the name of its column 'Acc (m/s^2)', in g by "),
        ("Acc (m/s^2)", "unit: g, scale: -1", "in g by "),
        ("acceleration_m_per_s2", "unit: g", "is in m_per_s2 by the name of its column"),
        ("ax_g", "unit: m/s^2", "is in g by the name of its column 'ax_g', in m/s^2 by "),
        ("Acc (g)", "scale: 9.81", "the scale 9.81 in"),
        ("Acc (mg)", "scale: -0.0098", "converts it once more: leave the scale out, or set unit: m/s^2"),
        (
            "Acc (mV)",
            "scale: 1",
            "unknown unit of acceleration 'mV' by the name of its column 'Acc (mV)', known: m/s^2",
        ),
        ("Acc (V)", "unit: g", "is in V by the name of its column 'Acc (V)', in g by "),
        ("CH1_V", "scale: -1", "unknown unit of acceleration 'V'"),
        ("Acc (counts)", "", "unknown unit of acceleration 'counts'"),
        ("Measurement (VDC)", "", "unknown unit of acceleration 'VDC'"),
        ("v (ips)", "", "unknown unit of acceleration 'ips'"),
        ("raw_ax", "", "unknown unit of acceleration 'raw'"),
        ("acc_dB", "", "unknown unit of acceleration 'dB'"),
        ("Acc (\u00b5g)", "", "unknown unit of acceleration '\u03bcg'"),
        ("a (ADC counts)", "", "unknown unit of acceleration 'ADC'"),
        ("a (normalized)", "", "unknown unit of acceleration 'normalized'"),
        ("Acc (mV/g)", "", "unknown unit of acceleration 'mV/g'"),
        ("Acc (mA)", "", "unknown unit of acceleration 'mA'"),
        ("Acc (mm)", "", "unknown unit of acceleration 'mm'"),
        ("Acc (N)", "unit: g", "is in N by the name of its column 'Acc (N)', in g by "),
        ("speed_m_per_s", "", "unknown unit of acceleration 'm_per_s'"),
        ("Acc (g) (m/s^2)", "", "states two units: g and m/s^2"),
    ],
)
def test_a_name_that_contradicts_the_yaml_file_is_refused(tmp_path: Path, name: str, given: str, told: str) -> None:
    beside = f"columns: {{time: {{column: 1}}, acceleration: {{column: 2, {given}}}}}"
    assert told in refused(written(tmp_path, [f"t,{name}"], rows(), beside))


@pytest.mark.parametrize(
    ("head", "beside", "told"),
    [
        (["t,a", "s,m/s^2"], "unit: g", "is in m/s^2 by the line of units, in g by "),
        (["t,a", "[s],[m/s^2]"], "unit: g", "is in [m/s^2] by the line of units, in g by "),
        (["t,a", "s,mV"], "unit: g", "is in mV by the line of units, in g by "),
        (["t,a", "(s),(V)"], "", "unknown unit of acceleration '(V)' by the line of units"),
        (
            ["Time (s),Acc (g)", "s,m/s^2"],
            "",
            "in g by the name of its column 'Acc (g)', in m/s^2 by the line of units",
        ),
        (["time_s,acceleration_m_per_s2", "s,g"], "", "in m_per_s2 by the name of its column"),
        (["t,a", "-,-"], "", "unknown unit of time '-' by the line of units"),
    ],
)
def test_a_line_of_units_that_contradicts_is_refused(tmp_path: Path, head: list[str], beside: str, told: str) -> None:
    columns = f"columns: {{time: {{column: 1}}, acceleration: {{column: 2, {beside}}}}}"
    assert told in refused(written(tmp_path, head, rows(), columns))


def test_an_accelerometer_with_a_line_of_other_units_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, [*SI_NAMES, "s,g"], rows())
    with pytest.raises(HapticdError, match=r"in m_per_s2 by the name of its column .*, in g by the line of units"):
        load_recording(path)
    path = written(tmp_path, ["sep=;", "Logger;7", "time_s;acceleration_m_per_s2", "s;m/s2"], rows(";", ","))
    assert load_recording(path).acceleration_m_per_s2 == pytest.approx(np.array(VALUES) - np.mean(VALUES))


@pytest.mark.parametrize(
    ("quantity", "name", "unit"),
    [
        ("force", "weight_g", "g"), ("force", "F (grams)", "grams"), ("force", "load_kilograms", "kilograms"),
        ("force", "T (Nmm)", "Nmm"), ("position", "x_px", "px"), ("position", "angle (rad)", "rad"),
    ],
)  # fmt: skip
def test_an_unknown_unit_of_a_quantity_is_refused(tmp_path: Path, quantity: str, name: str, unit: str) -> None:
    beside = f"columns: {{time: {{column: 1}}, {quantity}: {{column: 2}}}}"
    told = f"unknown unit of {quantity} '{unit}' by the name of its column '{name}', known: "
    assert told in refused(written(tmp_path, [f"t,{name}"], rows(), beside))


def test_times_in_minutes_are_refused(tmp_path: Path) -> None:
    told = "unknown unit of time 'min' by the name of its column 'Time_min'"
    assert told in refused(written(tmp_path, ["Time_min,a"], rows(), BY_NUMBER))


# ---- Separators and preambles ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "separator", "point", "encoding"),
    [
        ("sep=;", ";", ",", "utf-8"), ('"sep=;"', ";", ",", "utf-8-sig"), ("SEP=,", ",", ".", "utf-8"),
        ("sep=\t", "\t", ",", "utf-16"), ("sep=\\t", "\t", ".", "utf-8"), ("sep=|", "|", ".", "utf-8"),
        ("sep=;;", ";", ".", "utf-8"), ("sep= ", " ", ".", "utf-8"),
    ],
)  # fmt: skip
def test_sep_gives_the_separator(tmp_path: Path, line: str, separator: str, point: str, encoding: str) -> None:
    head = [line, SI_NAMES[0].replace(",", separator)]
    check_scale(written(tmp_path, head, rows(separator, point), encoding=encoding))


LABVIEW = """LabVIEW Measurement\t
Writer_Version\t2
Separator\tTab
Multi_Headings\tNo
Date\t2026/01/02
Time\t12:00:00.123
***End_of_Header***\t
\t
Channels\t1\t\t
Samples\t40\t40
Y_Unit_Label\tg\tg
X0\t0.0000E+0\t0.0000E+0
Delta_X\t0.001000\t0.001000
***End_of_Header***\t\t
X_Value\tAcc (g)\tComment""".splitlines()
TEKTRONIX = """Model,MSO54
Firmware Version,1.28

Horizontal Units,S
Sample Interval,1e-3
Record Length,40
Probe Attenuation,1
Vertical Units,V
Label,CH1
TIME,CH1""".splitlines()
SIGLENT = ["Record Length,Analog:40", "Vertical Units,CH1:V", "Horizontal Scale,0.001", "Source,CH1", "Second,Volt"]
DEWESOFT = """Dewesoft export
File name: a.dxd
Start time: 1.2.2026 12:00:00
Sample rate: 1000 Hz

Time (s),AI 1 (g)""".splitlines()


@pytest.mark.parametrize(
    ("head", "numbers", "beside", "scale"),
    [
        (LABVIEW, rows("\t"), "{time: {column: X_Value}, acceleration: {column: Acc (g)}}", G),
        (TEKTRONIX, rows(), "{time: {column: TIME}, acceleration: {column: CH1, scale: 20, unit: g}}", 20 * G),
        (DEWESOFT, rows(), "{time: {column: Time (s)}, acceleration: {column: AI 1 (g)}}", G),
        (["Time,Channel A", "(ms),(g)", ""], rows(ms=True), "{time: {column: Time}, acceleration: {column: 2}}", G),
        (
            ["X,CH1,Start,Increment,", "Sequence,Volt,-6.0e-3,1.0e-3,"],
            rows(after=",", ms=True),
            "{time: {column: X, scale: 0.001, unit: s}, acceleration: {column: CH1, scale: 3}}",
            3,
        ),
        (["Dev: x, 12", "Rate: 1 kHz,", "t,a", "s,g"], rows(), "{time: {column: t}, acceleration: {column: a}}", G),
        (SIGLENT, rows(), "{time: {column: Second}, acceleration: {column: Volt, scale: 5}}", 5),
        (["Dev: x, 12", "Date: Mon, 12:00", *SI_NAMES], rows(), "", 1),
        (["Device,ADXL355", *SI_NAMES], rows(), "", 1),
        (["sep=;", "Range;16 g", "time_s;acceleration_m_per_s2"], rows(";", ","), "", 1),
        (["Device;ADXL355", "Rate;1000 Hz"], rows(";", ","), "{time: {column: 1}, acceleration: {column: 2}}", 1),
        (["Dev,A", "Time (s),Acc (g)", "float,float"], rows(), "{time: {column: 1}, acceleration: {column: 2}}", G),
        (["s,g", "t,a"], rows(), "{time: {column: t}, acceleration: {column: a}}", G),
        (["Time (s), Acc (g)"], rows(";"), "{time: {column: 1}, acceleration: {column: 2}}", G),
        (["Time (s),16 g (g)"], rows(), "{time: {column: 1}, acceleration: {column: 2}}", G),
        (["Time [s] Acc [g]"], rows(" "), "{time: {column: 1}, acceleration: {column: 'Acc [g]'}}", G),
        (
            ["Record Length,40.0,,0.0000,0.5", "Source,CH1,,0.0010,1.144218", "Units,V,,0.0020,1.48545"],
            [f",,,{row}" for row in rows()[3:]],
            "{time: {column: 4}, acceleration: {column: 5}}",
            1,
        ),
        ([',"Acc Ave. (g)"'], rows(), "{time: {column: 1}, acceleration: {column: Acc Ave. (g)}}", G),
        (["Mode,Detail,", "Waveform Data,"], rows(after=","), BY_NUMBER[9:], 1),
        (["Sensor (10 mV/g),A", "Time (s),Acc (g)"], rows(), BY_NUMBER[9:], G),
        (["# t [s] a [g]"], rows(" "), "{time: {column: 't [s]'}, acceleration: {column: 'a [g]'}}", G),
        (["# t (ms), a (g)", "# recorded by me", "#"], rows(ms=True), BY_NUMBER[9:], G),
        (["# t,a", "# ms,g", "# Rate: 1000 Hz, Range: 16 g"], rows(ms=True), BY_NUMBER[9:], G),
        (["# t (ms), a (g)"], rows("\t", ms=True), BY_NUMBER[9:], G),
        (["Logger 7", "# t (ms), a (g)"], rows(ms=True), BY_NUMBER[9:], G),
    ],
    ids=["LabVIEW", "Tektronix", "Dewesoft", "Pico", "Rigol", "units", "Siglent", "logger", "one line", "sep",
         "no names", "types", "units above names", "two separators", "range", "blanks", "old Tektronix", "PicoLog",
         "GW Instek", "title with units", "numpy, blanks", "comment below names", "values below names", "tab",
         "title above a comment"],
)  # fmt: skip
def test_a_preamble_is_skipped(tmp_path: Path, head: list[str], numbers: list[str], beside: str, scale: float) -> None:
    check_scale(written(tmp_path, head, numbers, beside and f"columns: {beside}"), scale)


@pytest.mark.parametrize(
    ("head", "numbers", "told"),
    [
        ([*SI_NAMES, "0.0,1", "ERR,ERR"], rows(), "line 2 holds a number, but the lines of numbers begin"),
        ([*SI_NAMES, "n/a,0.5"], rows(), 'line 2 must hold numbers, holds "n/a"'),
        ([*SI_NAMES, "0.0,n/a"], rows(), 'line 2 must hold numbers, holds "n/a"'),
        (["Rate,1000"], rows(), "PATH: none of the columns acceleration_m_per_s2"),
        ([*SI_NAMES, *rows()[:3], "0.003,"], rows()[4:], 'line 5 must hold numbers, holds ""'),
        ([*SI_NAMES, *rows()[:20], "Restart,"], rows()[21:], 'line 22 must hold numbers, holds "Restart"'),
        (["Rate", "2000", *SI_NAMES], rows(), "set in PATH.yaml skip_lines, the number of lines to leave out"),
        (['"Time', '(s)","Acc', '(g)"'], rows(), "end in neither names nor units"),
        (["Time (s), Acc (g), Force (N)"], rows(";"), "end in neither names nor units"),
        (["a,b,c,d", "Volt,x,y,z"], [f"{row},1,2" for row in rows()], "end in neither names nor units"),
        (SI_NAMES, [*rows(), "Mean,0.5"], 'line 42 must hold numbers, holds "Mean"'),
        (
            [";SampleRate, 1000,Hz", ";Headers, time,Ax"],
            rows(),
            "line 3 must have 3 columns, as many as there are names, has 2; if the line above holds no names, set in",
        ),
    ],
)  # fmt: skip
def test_lines_of_numbers_are_never_skipped(tmp_path: Path, head: list[str], numbers: list[str], told: str) -> None:
    path = written(tmp_path, head, numbers)
    assert told.replace("PATH", str(path)) in refused(path)


DATED = [f"2026-01-01 12:00:00.{index:03d},{value}" for index, value in enumerate(VALUES)]


@pytest.mark.parametrize("texts", ["", ",ok"], ids=["date", "date and state"])
def test_a_column_beside_dates_is_read(tmp_path: Path, texts: str) -> None:
    beside = "rate_hz: 1000\ncolumns: {acceleration: {column: 'ax [g]'}}"
    numbers = [row + texts for row in DATED]
    numbers[7:7] = ["# mark, 5" + texts]
    path = written(tmp_path, [f"Time,ax [g]{texts}"], numbers, beside)
    check_scale(path, G)


@pytest.mark.parametrize("lost", [0, 1, 39])
def test_a_lost_value_beside_dates_is_refused(tmp_path: Path, lost: int) -> None:
    numbers = [*DATED[:lost], "2026-01-01 12:00:00.000,n/a", *DATED[lost + 1 :]]
    path = written(tmp_path, ["Time,ax [g]"], numbers, "rate_hz: 1000\ncolumns: {acceleration: {column: 2}}")
    assert f'line {lost + 2} must hold numbers, holds "n/a"' in refused(path)


def test_skip_lines_leaves_lines_out(tmp_path: Path) -> None:
    check_scale(written(tmp_path, ["Rate", "2000", "", *SI_NAMES], rows(), "skip_lines: 3"))
    broken = rows()
    broken[7] = "x,1"
    path = written(tmp_path, ["Rate", "2000", *SI_NAMES], broken, "skip_lines: 2")
    assert 'line 11 must hold numbers, holds "x"' in refused(path)
    assert "has no line after the 99 that are skipped" in refused(written(tmp_path, SI_NAMES, rows(), "skip_lines: 99"))
    np.savez(tmp_path / "a.npz", rate_hz=1000, force_n=np.array(VALUES))
    (tmp_path / "a.npz.yaml").write_text("skip_lines: 1")
    assert "is for a .csv" in refused(tmp_path / "a.npz")


# ---- .wav of unknown length ------------------------------------------------------------------------------------------

DATA = np.round(np.array(VALUES) * 2**14).astype("<i2").tobytes()
UNKNOWN = "the header does not give the number of samples, as if written to a pipe"


def wav(riff_size: int, data_size: int, data: bytes = DATA, kind: bytes = b"RIFF", before: bytes = b"") -> bytes:
    """After "Multimedia Programming Interface and Data Specifications 1.0" (1991), and EBU Tech 3306 for RF64."""
    form = b"fmt " + struct.pack("<IHHIIHH", 16, 1, 1, 1000, 2000, 2, 16)
    head = kind + struct.pack("<I", riff_size) + b"WAVE" + before + form
    return head + b"data" + struct.pack("<I", data_size) + data


def ds64(data_size: int) -> bytes:
    return b"ds64" + struct.pack("<IQQQI", 28, 36 + 36 + data_size, data_size, data_size // 2, 0)


def read_wav(folder: Path, content: bytes) -> Recording:
    path = folder / "a.wav"
    path.write_bytes(content)
    (folder / "a.wav.yaml").write_text("columns: {acceleration: {column: 1, scale: 2}}")
    return load(path)


@pytest.mark.parametrize(
    ("content", "is_unknown"),
    [
        (wav(0xFFFFFFFF, 0xFFFFFFFF), True),
        (wav(0x7FFFF024, 0x7FFFF000), True),
        (wav(0x7FFFF022, 0x7FFFEFFE), True),
        (wav(0x80000024, 0x80000000), True),
        (wav(0x7FFFFF24, 0x7FFFFF00), True),
        (wav(36, 0), True),
        (wav(0, 0, DATA + b"\0"), True),
        (wav(0xFFFFFFFF, 0xFFFFFFFF, kind=b"RF64", before=ds64(0)), True),
        (wav(0xFFFFFFFF, 0xFFFFFFFF, kind=b"RF64", before=ds64(len(DATA))), False),
        (wav(0xFFFFFFFF, 0xFFFFFFFF, kind=b"BW64", before=ds64(len(DATA))), False),
        (wav(0xFFFFFFFF, len(DATA)), False),
    ],
    ids=["ffmpeg", "sox", "sox, 3 bytes", "arecord", "arecord, old", "GStreamer", "killed", "RF64 to a pipe", "RF64",
         "BW64", "RIFF alone"],
)  # fmt: skip
def test_a_wav_of_unknown_length_is_read_to_its_end(tmp_path: Path, content: bytes, is_unknown: bool) -> None:
    found = read_wav(tmp_path, content)
    assert acceleration(found) == pytest.approx(VALUES, abs=2**-14)
    assert len(acceleration(found)) == SAMPLES
    assert [note.startswith(UNKNOWN) for note in found.notes] == [True] * is_unknown


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (wav(36 + 180, 180), "is cut off: 80 of 180 bytes of its samples are there"),
        (wav(0x60000024, 0x60000000), "is cut off: 80 of 1610612736 bytes"),
        (wav(0xFFFFFFFF, 0xFFFFFFFF, kind=b"RF64", before=ds64(2**33)), "is cut off: 80 of 8589934592 bytes"),
        (wav(36, 0, b""), "has 0"),
        (wav(48, 0, b"LIST\x04\0\0\0INFO"), "has 0"),
        (wav(36, 0)[:36], "is damaged: a chunk `data`, which has the samples, was not found"),
        (b"fLaC" + DATA, "is not a .wav: it begins with neither RIFF nor RIFX, RF64 or BW64"),
    ],
)
def test_a_wav_that_is_cut_off_or_empty_is_refused(tmp_path: Path, content: bytes, told: str) -> None:
    with pytest.raises(RecordingError, match=told):
        read_wav(tmp_path, content)
