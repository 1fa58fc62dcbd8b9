"""Recordings: files are read in SI units on a uniform clock, or refused by name."""

from __future__ import annotations

import dataclasses
import hashlib
import io
import os
import random
import re
import struct
import sys
import zipfile
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from scipy.io import wavfile

from hapticd.analysis.recordings.clock import COLUMN_OF
from hapticd.analysis.recordings.files import MAX_RECORDING_BYTES
from hapticd.analysis.statistics import Floats
from hapticd.base.errors import HapticdError, InvalidError
from hapticd.base.units import UNITS_OF, Quantity
from hapticd.config.materials import shipped_materials
from hapticd.fit.recording import Recording, RecordingError, load, save
from hapticd.fit.synthesize import Stylus, taps

DOCS = (Path(__file__).parents[2] / "docs" / "fit.md").read_text()
RATE_HZ = 5000.0


def wave(time_s: Floats) -> Floats:
    return np.asarray(3.0 * np.sin(2 * np.pi * 50 * time_s))


def write(path: Path, columns: dict[str, Floats], beside: str = "", delimiter: str = ",") -> Path:
    rows = np.column_stack(list(columns.values()))
    lines = [delimiter.join(columns)] + [delimiter.join(f"{value:.9g}" for value in row) for row in rows]
    path.write_text("\n".join(lines) + "\n")
    if beside:
        Path(f"{path}.yaml").write_text(beside)
    return path


def acceleration_of(recording: Recording) -> Floats:
    assert recording.acceleration_m_per_s2 is not None
    return recording.acceleration_m_per_s2


def refused(path: Path) -> str:
    with pytest.raises(RecordingError) as told:
        load(path)
    text = str(told.value)
    assert text.startswith(f"{path}: ")
    assert "\n" not in text
    return text


TIME_S = np.arange(500) / RATE_HZ


def test_usual_names_need_no_yaml(tmp_path: Path) -> None:
    path = write(tmp_path / "tap.csv", {"time_s": TIME_S, "acceleration_m_per_s2": wave(TIME_S), "force_n": TIME_S})
    found = load(path)
    assert found.rate_hz == pytest.approx(RATE_HZ)
    assert acceleration_of(found) == pytest.approx(wave(TIME_S), abs=1e-6)
    assert found.force_n == pytest.approx(TIME_S)
    assert found.position_m is None
    assert found.speed_m_per_s is None
    assert found.source.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_the_yaml_says_columns_units_rate_and_speed(tmp_path: Path, delimiter: str) -> None:
    beside = """
rate_hz: 5000
speed_m_per_s: [0.1, 0.2]
columns:
  acceleration: {column: z, unit: g, scale: -0.5}
  position: {column: 1, unit: mm}
"""
    path = write(tmp_path / "tap.csv", {"way": TIME_S, "z": wave(TIME_S)}, beside, delimiter)
    found = load(path)
    assert acceleration_of(found) == pytest.approx(-0.5 * 9.80665 * wave(TIME_S), abs=1e-6)
    assert found.position_m == pytest.approx(1e-3 * TIME_S)
    assert list(np.atleast_1d(found.speed_m_per_s)) == [0.1, 0.2]  # type: ignore[arg-type]


def test_columns_without_names_are_numbered_and_comments_skipped(tmp_path: Path) -> None:
    path = tmp_path / "plain.csv"
    path.write_text("# a stylus\n" + "".join(f"{t:.6f};{a:.9f}\n" for t, a in zip(TIME_S, wave(TIME_S), strict=True)))
    Path(f"{path}.yaml").write_text("columns: {time: {column: 1}, acceleration: {column: 2}}")
    assert acceleration_of(load(path)) == pytest.approx(wave(TIME_S), abs=1e-6)


def test_saved_data_are_loaded_unchanged(tmp_path: Path) -> None:
    tap = shipped_materials()["wood"].tap
    assert tap is not None
    recording, _ = taps(tap, [0.1, 0.2], Stylus())
    save(recording, tmp_path / "taps.npz")
    found = load(tmp_path / "taps.npz")
    assert found.rate_hz == recording.rate_hz
    for field in dataclasses.fields(Recording):
        if field.name not in ("name", "source"):
            assert np.array_equal(
                np.asarray(getattr(found, field.name), dtype=np.float64),
                np.asarray(getattr(recording, field.name), dtype=np.float64),
                equal_nan=True,
            ), field.name
    save(dataclasses.replace(recording, speed_m_per_s=0.3), tmp_path / "one.npz")
    assert load(tmp_path / "one.npz").speed_m_per_s == 0.3
    with pytest.raises(HapticdError, match="cannot be written"):
        save(recording, tmp_path / "none" / "taps.npz")


@pytest.mark.parametrize(("kind", "full"), [(np.int16, 2**15), (np.int32, 2**31), (np.float32, 1)])
def test_wav_has_a_scale(tmp_path: Path, kind: type, full: int) -> None:
    path = tmp_path / "tap.wav"
    numbers = np.column_stack((0.25 * wave(TIME_S) / 3, 0.5 * wave(TIME_S) / 3)) * full
    wavfile.write(path, int(RATE_HZ), numbers.astype(kind))
    assert "needs" in refused(path)
    Path(f"{path}.yaml").write_text("columns: {acceleration: {column: 2, scale: 200}}")
    found = load(path)
    assert found.rate_hz == RATE_HZ
    assert acceleration_of(found) == pytest.approx(100 * wave(TIME_S) / 3, abs=0.01)


def test_jitter_is_put_right(tmp_path: Path) -> None:
    late = np.random.default_rng(1).uniform(-0.2, 0.2, len(TIME_S)) / RATE_HZ
    path = write(tmp_path / "tap.csv", {"time_s": TIME_S + late, "acceleration_m_per_s2": wave(TIME_S + late)})
    found = load(path)
    assert found.rate_hz == pytest.approx(RATE_HZ, rel=1e-3)
    # Its clock begins where the samples do on average, and its period is theirs: each within 1e-2 of a period.
    assert acceleration_of(found)[2:-2] == pytest.approx(wave(TIME_S)[2:-2], abs=0.01)
    assert np.abs(wave(TIME_S + late) - wave(TIME_S)).max() > 0.03


@pytest.mark.parametrize("late", [0.0, 0.4])
def test_a_gap_stays_a_gap_and_its_neighbours_stay(late: float, tmp_path: Path) -> None:
    """Samples 200 to 239 are lost; after them the clock goes on up to half a period off."""
    kept = np.delete(np.arange(500), np.arange(200, 240))
    time_s = TIME_S[kept] + np.where(kept >= 240, late / RATE_HZ, 0.0)
    path = write(tmp_path / "lost.csv", {"time_s": time_s, "force_n": wave(time_s)})
    found = load(path)
    assert found.rate_hz == pytest.approx(RATE_HZ, rel=1e-6) and found.gaps == ((200, 240),)
    assert found.force_n is not None and len(found.force_n) == 500
    # Its clock begins where the samples do on average.
    begin_s = np.mean(time_s - kept / RATE_HZ)
    true = wave(np.arange(500) / RATE_HZ + begin_s)
    away = np.abs(np.arange(500) - 219.5) > 26
    assert found.force_n[away][2:-2] == pytest.approx(true[away][2:-2], abs=0.01)
    line = np.diff(found.force_n[200:240])
    assert line == pytest.approx(np.full(39, line[0]), abs=1e-9)


def test_lost_and_doubled_samples_are_refused_by_their_place(tmp_path: Path) -> None:
    kept = np.delete(np.arange(500), [*range(200, 202), *range(203, 490)])
    path = write(tmp_path / "lost.csv", {"time_s": TIME_S[kept], "force_n": wave(TIME_S[kept])})
    assert "samples are missing: 289 in 2 gaps, the first between 0.0398 s and 0.0404 s" in refused(path)
    often = np.delete(np.arange(500), np.arange(3, 500, 20))
    path = write(tmp_path / "often.csv", {"time_s": TIME_S[often], "force_n": wave(TIME_S[often])})
    assert "were samples lost" in refused(path)
    twice = np.sort(np.append(TIME_S, TIME_S[100]))
    path = write(tmp_path / "twice.csv", {"time_s": twice, "force_n": wave(twice)})
    assert "the time does not rise from sample 101 to 102" in refused(path)


def test_nan_and_gaps_in_rows_are_refused_by_their_line(tmp_path: Path) -> None:
    numbers = wave(TIME_S)
    numbers[17] = np.nan
    path = write(tmp_path / "nan.csv", {"time_s": TIME_S, "force_n": numbers})
    assert 'line 19 must hold numbers, holds "nan"' in refused(path)
    np.savez(tmp_path / "nan.npz", rate_hz=RATE_HZ, force_n=numbers)
    assert "force_n is NaN or infinite in 1 samples, first in sample 18" in refused(tmp_path / "nan.npz")
    path.write_text("time_s,force_n\n0.0,1\n0.1,\n")
    assert "line 3 must hold numbers" in refused(path)
    path.write_text("time_s,force_n\n0.0,1\n0.1\n")
    assert "line 3 must have 2 columns" in refused(path)


def test_a_column_without_its_key_is_refused_with_the_way_to_write_it(tmp_path: Path) -> None:
    path = write(tmp_path / "tap.csv", {"t": TIME_S, "a": TIME_S})
    Path(f"{path}.yaml").write_text("columns:\n  time: t\n  force: {column: a}\n")
    with pytest.raises(InvalidError, match=r":2:3: columns\.time: .* such as \{column: t\}, is \"t\"$"):
        load(path)


@pytest.mark.parametrize(
    ("columns", "beside", "told"),
    [
        ({"a": TIME_S, "b": TIME_S}, "", "none of the columns acceleration_m_per_s2, force_n"),
        ({"a": TIME_S}, "columns: {force: {column: b}}\nrate_hz: 5000", "has no column 'b'; known: a"),
        ({"force_n": TIME_S}, "", "has neither a column time_s nor a rate"),
        ({"time_s": wave(TIME_S), "acceleration_m_per_s2": TIME_S}, "", "is it the right column?"),
        ({"time_s": 1e3 * TIME_S, "force_n": TIME_S}, "", "are they in another unit?"),
        ({"time_s": TIME_S, "force_n": TIME_S}, "rate_hz: 2500", "the times give 5000 Hz, but rate_hz is 2500 Hz"),
        ({"time_s": TIME_S[:8], "force_n": TIME_S[:8]}, "", "must have between 16 and 20000000 samples, has 8"),
    ],
)
def test_unsuitable_columns_are_refused(tmp_path: Path, columns: dict[str, Floats], beside: str, told: str) -> None:
    assert told in refused(write(tmp_path / "tap.csv", columns, beside))


def test_faults_of_the_yaml_file_are_reported_with_their_line(tmp_path: Path) -> None:
    path = write(tmp_path / "tap.csv", {"time_s": TIME_S, "z": TIME_S}, "rate_hz: fast\n")
    with pytest.raises(InvalidError, match=r"tap\.csv\.yaml:1:\d+: rate_hz: "):
        load(path)
    Path(f"{path}.yaml").write_text("rate_hz: 5000\ncolumns:\n  force:\n    column: z\n    unit: pound\n")
    with pytest.raises(
        InvalidError, match=r"tap\.csv\.yaml:5:\d+: columns\.force\.unit: unknown unit of force, known: N"
    ):
        load(path)


def test_damaged_and_missing_files_are_refused(tmp_path: Path) -> None:
    for name, content in (("a.npz", b"no archive"), ("a.wav", b"RIFFxxxx"), ("a.csv", b""), ("a.csv", b"\xff\xfe")):
        (tmp_path / name).write_bytes(content)
        Path(f"{tmp_path / name}.yaml").write_text("columns: {force: {column: 1}}\nrate_hz: 5000")
        refused(tmp_path / name)
    (tmp_path / "a.txt").write_text("1\n")
    assert "must end in .csv, .npz or .wav" in refused(tmp_path / "a.txt")
    with pytest.raises(HapticdError, match="cannot be read"):
        load(tmp_path / "none.csv")


# ---- What people's files look like ---------------------------------------------------------------------------------


ROWS = [(0.0, 1.5, -2.25), (0.001, 2.5, 0.125), (0.002, -3.5, 1e-3), (0.003, 0.0, 7.0)] * 8
NUMBERED = [(0.001 * index, *row[1:]) for index, row in enumerate(ROWS)]


def lines(separator: str = ",", point: str = ".", after: str = "") -> list[str]:
    return [separator.join(repr(cell).replace(".", point) for cell in row) + after for row in NUMBERED]


HEAD = ["time_s", "acceleration_m_per_s2", "force_n"]


@pytest.mark.parametrize(
    "content",
    [
        "\n".join([",".join(HEAD), *lines()]).encode(),
        "\r\n".join([";".join(HEAD), *lines(";", ",")]).encode("utf-8-sig"),
        "\r".join(["\t".join(HEAD), *lines("\t", ",")]).encode("utf-16"),
        "\n".join([" ".join(HEAD), *lines(" ")]).encode(),
        "\n".join([",".join(HEAD) + ",", *lines(after=",")]).encode(),
        "\n".join([";".join(HEAD), *lines(";", after=";;")]).encode(),
        "\n".join(re.sub("[^,]+", r'"\g<0>"', line) for line in [",".join(HEAD), *lines()]).encode(),
        "\n".join(["# of a stylus", ",".join(HEAD), "s,m/s2,N", *lines()]).encode(),
        "\n".join([",".join(HEAD), "[s],[m/s\u00b2],", "", *lines()]).encode("latin-1"),
        "\n".join(["# 1 kHz", "# " + ",".join(HEAD), *lines()]).encode(),
        "\n".join([",".join([*HEAD, "label"]), *(f"{x},run A" for x in lines())]).encode(),
        "\n".join([",".join([*HEAD, "other"]), *(f"{x},nan" for x in lines())]).encode(),
        "\n".join([",".join([*HEAD, "twice", "twice"]), *(f"{x},1,2" for x in lines())]).encode(),
    ],
    ids=[
        "plain", "semicolons and decimal commas", "UTF-16", "blanks", "a comma at the ends", "empty columns", "quoted",
        "units", "units of Latin-1", "names in a comment", "text beside", "NaN beside", "a name twice beside",
    ],
)  # fmt: skip
def test_csv_is_read_as_people_write_it(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(content)
    found = load(path)
    assert found.rate_hz == 1000
    assert acceleration_of(found) == pytest.approx([row[1] for row in ROWS])
    assert found.force_n == pytest.approx([row[2] for row in ROWS])


def test_units_in_the_file_apply_if_the_yaml_file_gives_none(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["t,way,pull", "s,mm,lbf", *lines()]))
    beside = Path(f"{path}.yaml")
    beside.write_text("columns: {time: {column: 1}, position: {column: way}, force: {column: 3}}")
    assert "unknown unit of force 'lbf' by the line of units, known: N, mN, kN: set the scale " in refused(path)
    beside.write_text("columns: {time: {column: 1}, position: {column: way}, force: {column: 3, scale: 4.448}}")
    found = load(path)
    assert found.position_m == pytest.approx([1e-3 * row[1] for row in ROWS])
    assert found.force_n == pytest.approx([4.448 * row[2] for row in ROWS])


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"", "is empty"),
        (b"time_s,force_n\n", "holds no line of numbers"),
        (b"Lab 3\nRate;25000 Hz\nNames\n1,2\n", "lines 1 to 3, above the numbers, end in neither names nor units"),
        (b"time_s,force_n\n0,1\n0.1,\n", 'line 3 must hold numbers, holds ""'),
        (b"time_s;force_n\n0,0;1\n0,1;1.234,5\n", 'line 3 must hold numbers, holds "1.234,5"'),
        (b"time_s,force_n\n0,1\n0.1,2,3\n", "line 3 must have 2 columns, has 3"),
        (b"time_s force_n\n0 1\n0.1 2 3\n", "line 3 must have 2 columns, has 3"),
        (b"time_s,force_n,force_n\n0,1,2\n", 'has 2 columns "force_n": set the column\'s number'),
        (b"time_s,force_n,note\n" + b"0,1,a\n" * 9 + b'0,1,"a\n' * 2, "is a quotation mark not closed?"),
        (b"1," * 60_000, "none of the columns acceleration_m_per_s2"),
        (b"\0" * 100, "is not a text file"),
        (b"\x1b[31m,\x07\n" * 40, "holds no line of numbers in lines 1 to 40"),
    ],
)
def test_an_invalid_csv_is_refused(tmp_path: Path, content: bytes, told: str) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(content)
    text = refused(path)
    assert told in text and text.isprintable()


def test_arrays_are_columns_and_objects_are_left_alone(tmp_path: Path) -> None:
    class Executed:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return os.mkdir, (str(tmp_path / "executed"),)

    both = np.column_stack((TIME_S, wave(TIME_S)))
    spoilt = np.array([Executed()] * 3, dtype=object)
    np.savez(tmp_path / "a.npz", both=both, other=both.T.astype(">f4"), note=spoilt, rate_hz=np.array([5000]))
    beside = Path(f"{tmp_path / 'a.npz'}.yaml")
    beside.write_text("columns: {acceleration: {column: 'both[2]'}, force: {column: 'other[2]'}}")
    found = load(tmp_path / "a.npz")
    assert np.array_equal(acceleration_of(found), both[:, 1])
    assert found.force_n == pytest.approx(both[:, 1], abs=1e-6)
    beside.write_text("columns: {acceleration: {column: note}}")
    assert "'note' cannot be read: Object arrays cannot be loaded" in refused(tmp_path / "a.npz")
    np.savez(tmp_path / "b.npz", time_s=TIME_S, acceleration_m_per_s2=spoilt)
    assert "acceleration_m_per_s2 cannot be read: Object arrays" in refused(tmp_path / "b.npz")
    np.savez(tmp_path / "c.npz", time_s=TIME_S, acceleration_m_per_s2=both)
    assert "acceleration_m_per_s2 holds 2 columns, acceleration_m_per_s2[1] and so on" in refused(tmp_path / "c.npz")
    assert not (tmp_path / "executed").exists()


def test_archives_that_promise_more_than_they_hold_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": (10**12,)})
    for compression in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        with zipfile.ZipFile(tmp_path / "a.npz", "w", compression) as archive:
            archive.writestr("force_n.npy", stream.getvalue() + bytes(1_000_000))
        assert "force_n cannot be read: Unable to allocate" in refused(tmp_path / "a.npz")
    content = stream.getvalue().replace(b"1000000000000", b"        10000")
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("force_n.npy", content + bytes(800))
    assert "expected 80000 bytes got 800" in refused(tmp_path / "a.npz")
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("force_n.npy", bytes(10_001))
    monkeypatch.setattr("hapticd.analysis.recordings.files.MAX_UNPACKED_BYTES", 10_000)
    assert "unpacks to 10001 bytes, at most 10000 are allowed" in refused(tmp_path / "a.npz")


def riff(kind: int, bits: int, frames: bytes, channels: int = 1, extensible: bool = False) -> bytes:
    """After "Multimedia Programming Interface and Data Specifications 1.0" (1991), and Microsoft's mmreg.h."""
    frame = channels * bits // 8
    form = struct.pack("<HHIIHH", 0xFFFE if extensible else kind, channels, 5000, 5000 * frame, frame, bits)
    if extensible:
        guid = struct.pack("<H", kind) + bytes.fromhex("000000001000800000aa00389b71")
        form += struct.pack("<HHI", 22, bits, 0) + guid
    chunks = b"fmt " + struct.pack("<I", len(form)) + form + b"LIST" + struct.pack("<I", 3) + b"abc\0"
    chunks += b"data" + struct.pack("<I", len(frames)) + frames
    return b"RIFF" + struct.pack("<I", 4 + len(chunks)) + b"WAVE" + chunks


@pytest.mark.parametrize("extensible", [False, True])
@pytest.mark.parametrize(("kind", "bits"), [(1, 8), (1, 16), (1, 24), (1, 32), (3, 32), (3, 64)])
def test_every_kind_of_wav(tmp_path: Path, kind: int, bits: int, extensible: bool) -> None:
    numbers = [-1.0, -0.5, -1 / 128, 0.0, 0.25, 127 / 128] * 4
    frames = b""
    for number in numbers:
        whole = round(number * 2 ** (bits - 1))
        if kind == 3:
            cell = struct.pack("<f" if bits == 32 else "<d", number)
        else:
            cell = (
                (whole + 128).to_bytes(1, "little") if bits == 8 else whole.to_bytes(bits // 8, "little", signed=True)
            )
        frames += bytes(bits // 8) + cell
    path = tmp_path / "a.wav"
    path.write_bytes(riff(kind, bits, frames, 2, extensible))
    Path(f"{path}.yaml").write_text("columns: {acceleration: {column: 2, scale: 200}}")
    found = load(path)
    assert found.rate_hz == 5000
    assert list(acceleration_of(found)) == [200 * number for number in numbers]


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"riff", "is not a .wav: it begins with neither RIFF nor RIFX, RF64 or BW64"),
        (b"RIFF\0\0\0\0WAVE", "is damaged"),
        (riff(1, 16, bytes(200))[:-100], "is cut off: 100 of 200 bytes"),
        (riff(1, 16, bytes(101)), "is damaged"),
        (riff(6, 8, bytes(100)), "Unknown wave file format: ALAW. Supported formats: PCM, IEEE_FLOAT"),
        (riff(1, 16, bytes(100), channels=0), "is damaged"),
        (riff(1, 16, b""), "samples, has 0"),
        (riff(3, 32, struct.pack("<f", float("nan")) * 40), "is NaN or infinite in 40 samples"),
    ],
)
def test_an_invalid_wav_is_refused(tmp_path: Path, content: bytes, told: str) -> None:
    path = tmp_path / "a.wav"
    path.write_bytes(content)
    Path(f"{path}.yaml").write_text("columns: {acceleration: {column: 1}}")
    assert told in refused(path)


def test_a_rate_may_be_given_twice(tmp_path: Path) -> None:
    path = tmp_path / "a.wav"
    path.write_bytes(riff(1, 16, bytes(100)))
    Path(f"{path}.yaml").write_text("rate_hz: 2500\ncolumns: {acceleration: {column: 1}}")
    assert "the rate is 5000 Hz in the file, 2500 Hz in the YAML" in refused(path)


# ---- Clocks --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("begin_s", "rate_hz", "places"),
    [(0.0, 25_000, 6), (1e5, 25_000, 6), (1.7e9, 25_000, 6), (0.0, 24_414, 6), (0.0, 44_100, 5), (1e5, 3_000, 4)],
)
def test_rounded_times_are_a_uniform_clock(tmp_path: Path, begin_s: float, rate_hz: int, places: int) -> None:
    """Rounding is not jitter: samples stay unchanged, and the rate is the integer one."""
    time_s = begin_s + np.arange(5000) / rate_hz
    rows = "".join(f"{t:.{places}f},{float(a)!r}\n" for t, a in zip(time_s, wave(time_s - begin_s), strict=True))
    path = tmp_path / "a.csv"
    path.write_text("time_s,acceleration_m_per_s2\n" + rows)
    found = load(path)
    assert np.array_equal(acceleration_of(found), wave(time_s - begin_s))
    assert found.rate_hz == rate_hz


def test_times_of_single_precision_are_a_uniform_clock(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", time_s=(100 + TIME_S).astype(np.float32), force_n=wave(TIME_S))
    found = load(tmp_path / "a.npz")
    assert np.array_equal(found.force_n, wave(TIME_S))  # type: ignore[arg-type]
    assert found.rate_hz == pytest.approx(RATE_HZ, rel=1e-4)


def test_times_that_are_rounded_too_far_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", {"time_s": np.round(TIME_S, 3), "force_n": wave(TIME_S)})
    assert "the times are rounded to 0.001 s, more than a sample period" in refused(path)
    Path(f"{path}.yaml").write_text("rate_hz: 5000\ncolumns: {force: {column: force_n}}")
    assert load(path).rate_hz == 5000


@pytest.mark.long
def test_a_clock_may_drift_and_a_position_is_not_a_clock(tmp_path: Path) -> None:
    time_s = np.arange(20_000) / RATE_HZ
    wandering = time_s + 2e-3 * np.sin(2 * np.pi * 0.3 * time_s)
    path = write(tmp_path / "a.csv", {"time_s": wandering, "force_n": wave(wandering)})
    found = load(path)
    even = wandering.mean() + (np.arange(20_000) - 9999.5) / found.rate_hz
    assert np.asarray(found.force_n)[20:-20] == pytest.approx(wave(even)[20:-20], abs=2e-3)
    place_m = 0.08 * time_s + 2e-3 * np.sin(2 * np.pi * 0.7 * time_s)
    path = write(tmp_path / "b.csv", {"time_s": place_m, "tangential_position_m": time_s})
    assert "periods from a uniform clock" in refused(path)


def test_a_clipped_peak_stays_clipped_on_a_jittering_clock(tmp_path: Path) -> None:
    late = TIME_S + np.random.default_rng(3).uniform(-0.3, 0.3, len(TIME_S)) / RATE_HZ
    path = write(tmp_path / "a.csv", {"time_s": late, "acceleration_m_per_s2": np.clip(wave(late), -9, 2.0)})
    found = acceleration_of(load(path))
    clipped = wave(TIME_S) > 2.3
    assert np.all(found[clipped] == 2.0)


def test_a_time_that_is_a_thousand_off_is_refused(tmp_path: Path) -> None:
    for factor in (1e-3, 1e3):
        path = write(tmp_path / "a.csv", {"time_s": factor * TIME_S, "force_n": TIME_S})
        assert "the rate must be between 100 Hz and 1 MHz" in refused(path)


def test_numbers_that_cannot_be_are_refused(tmp_path: Path) -> None:
    for number in (1e308, -1e12):
        np.savez(tmp_path / "a.npz", rate_hz=RATE_HZ, force_n=np.full(100, number))
        assert "force_n must be at most 1e+09 in magnitude" in refused(tmp_path / "a.npz")
    Path(f"{tmp_path / 'a.npz'}.yaml").write_text("columns: {force: {column: force_n, scale: 1.0e+300}}")
    assert "force_n is NaN or infinite in 100 samples" in refused(tmp_path / "a.npz")


# ---- Files that are none -------------------------------------------------------------------------------------------


def test_special_files_are_refused_without_blocking(tmp_path: Path) -> None:
    (tmp_path / "folder.csv").mkdir()
    assert "is a folder" in refused(tmp_path / "folder.csv")
    os.mkfifo(tmp_path / "pipe.csv")
    assert "is a pipe or a device" in refused(tmp_path / "pipe.csv")
    (tmp_path / "zero.csv").symlink_to("/dev/zero")
    assert "is a pipe or a device" in refused(tmp_path / "zero.csv")
    with (tmp_path / "sparse.npz").open("wb") as stream:
        stream.truncate(MAX_RECORDING_BYTES + 1)
    assert f"is larger than {MAX_RECORDING_BYTES} bytes" in refused(tmp_path / "sparse.npz")


def test_an_unreadable_yaml_file_is_an_error(tmp_path: Path) -> None:
    path = write(tmp_path / "tap.csv", {"time_s": TIME_S, "force_n": TIME_S})
    beside = Path(f"{path}.yaml")
    beside.symlink_to(tmp_path / "nowhere")
    with pytest.raises(HapticdError, match=r"tap\.csv\.yaml: cannot be read: No such file"):
        load(path)
    beside.unlink()
    os.mkfifo(beside)
    with pytest.raises(HapticdError, match=r"tap\.csv\.yaml: cannot be read: is a pipe"):
        load(path)
    beside.unlink()
    beside.write_text("# nothing\n")
    assert load(path).rate_hz == RATE_HZ


@pytest.mark.parametrize(
    ("beside", "told"),
    [
        ("rate_hz: .nan", "rate_hz: should be a finite number"),
        ("rate_hz: -5", "rate_hz: should be greater than or equal to 100"),
        ("rate: 5000", "rate: unknown key; did you mean rate_hz"),
        ("columns: {force: {column: force_n, scale: 0}}", "columns.force.scale: must not be 0"),
        ("columns: {force: {column: 0}}", "has no column '0'; known: time_s, force_n"),
        ("columns: {force: {column: 99999999999999999999}}", "has no column '99999999999999999999'"),
        ("columns: {time: {column: time_s}}", "has neither acceleration nor force nor position"),
        ("columns: {weight: {column: time_s}}", "should be 'time', 'acceleration', 'force', 'position'"),
    ],
)
def test_an_invalid_yaml_file_is_reported(tmp_path: Path, beside: str, told: str) -> None:
    path = write(tmp_path / "tap.csv", {"time_s": TIME_S, "force_n": TIME_S}, beside)
    with pytest.raises(HapticdError) as error:
        load(path)
    assert told in str(error.value)


@pytest.mark.long
def test_damaged_files_are_read_or_refused_in_one_line(tmp_path: Path) -> None:
    """Damage of many kinds: columns are read complete and finite, or an error is reported."""
    chance = random.Random(7)
    numbers = {"time_s": TIME_S, "acceleration_m_per_s2": wave(TIME_S), "force_n": TIME_S}
    np.savez_compressed(tmp_path / "a.npz", **numbers)  # type: ignore[arg-type]
    whole = {
        "csv": write(tmp_path / "a.csv", numbers).read_bytes(),
        "npz": (tmp_path / "a.npz").read_bytes(),
        "wav": riff(1, 24, bytes(range(240)) * 10, 2, extensible=True),
    }
    beside = b"columns:\n  acceleration: {column: 2, unit: g, scale: -1.0}\nrate_hz: 5000\n"
    tokens = [
        b"nan",
        b"1e999",
        b",",
        b"\n",
        b'"',
        b"\0",
        b"\xff",
        b"#",
        b"{",
        b": ",
        b"-",
        b"9" * 400,
        b"\xe2\x80\xa8",
        b"",
    ]
    read = 0
    for turn in range(600):
        ending = chance.choice(sorted(whole))
        parts = [bytearray(whole[ending]), bytearray(beside)]
        for _ in range(chance.choice([0, 1, 2, 8])):
            content = parts[0] if chance.random() < 0.8 else parts[1]
            at = chance.randrange(len(content) + 1)
            token = chance.choice([*tokens, chance.randbytes(4)])
            content[at : at + chance.choice([0, len(token), 40])] = token
        path = tmp_path / f"damaged.{ending}"
        path.write_bytes(parts[0])
        Path(f"{path}.yaml").write_bytes(parts[1])
        try:
            found = acceleration_of(load(path))
        except HapticdError as error:
            assert "\n" not in str(error) and str(error).startswith(str(path)), (turn, str(error))
        else:
            read += 1
            assert np.isfinite(found).all() and found.ndim == 1
    assert 50 < read < 550
    assert sys.getrecursionlimit() >= 1000


def test_the_documented_quantities_are_those_that_are_read() -> None:
    assert set(COLUMN_OF) == set(UNITS_OF) == set(get_args(Quantity))
    rows = re.findall(r"^\| `(\w+)` \| `(\w+)` \| (.*?) \|", DOCS, flags=re.MULTILINE)
    assert {quantity: name for quantity, name, _ in rows} == COLUMN_OF
    for quantity, _, units in rows:
        assert re.findall(r"`([^`]+)`", units) == list(UNITS_OF[quantity])
