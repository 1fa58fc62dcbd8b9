"""Errors of files that are damaged or not recordings, and the memory that a recording takes."""

from __future__ import annotations

import io
import os
import struct
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest

import hapticd
from hapticd.base.core import SAMPLE_DTYPE
from hapticd.base.errors import HapticdError
from hapticd.recording import reader
from hapticd.recording.replay import replay
from hapticd.recording.writer import RecordingWriter
from tests.recording.test_writer import some


def recorded(target: Path, count: int = 100) -> Path:
    with RecordingWriter(target) as writer:
        writer.begin({"config": {}, "scene": {"objects": {}}, "materials": {}})
        for first in range(0, count, 10_000):
            writer.write(some(min(10_000, count - first), first))
        writer.write_event({"event": "overrun", "tick": 3, "time_ns": 4, "missed": 2, "count": 1})
        writer.finish({})
    return target


def archive(path: Path, **members: bytes | None) -> Path:
    """A recording with members that are others, or more; None: without it."""
    whole = recorded(path.with_name("whole.npz"))
    with zipfile.ZipFile(whole) as old, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            if name.removesuffix(".npy") not in members:
                new.writestr(name, old.read(name))
        for name, content in members.items():
            if content is not None:
                new.writestr(f"{name}.npy", content)
    return path


def array(shape: tuple[int, ...], form: object, data: bytes = b"") -> bytes:
    made = io.BytesIO()
    np.lib.format.write_array_header_1_0(made, {"descr": form, "fortran_order": False, "shape": shape})
    return made.getvalue() + data


def refusal(path: Path) -> str:
    told = []
    for attempt in (hapticd.load, replay):
        with pytest.raises(HapticdError) as caught:
            attempt(path)
        told.append(str(caught.value))
    assert told[0] == told[1] and told[0].isprintable()
    return told[0].removeprefix(f"{path.parent}/")


SAMPLES = np.lib.format.dtype_to_descr(SAMPLE_DTYPE)
OTHER_SAMPLES = [(name, *rest) for name, *rest in SAMPLES if name != "force_n"]


@pytest.mark.parametrize(
    ("members", "told"),
    [
        ({"samples": None}, "no samples"),
        ({"samples": b"\x93NUMPY\x02\x00" + struct.pack("<I", 2**31)}, "samples.npy has an invalid header"),
        ({"samples": array((10**15,), SAMPLES)}, "samples.npy should have 112000000000000000 bytes of data, has"),
        ({"samples": array((1,), "|O", b"cos\nsystem\n.")}, "samples.npy is not a plain array"),
        ({"samples": array((2,), "<f8", bytes(16))}, "samples.npy is not an array of records"),
        ({"samples": array((1,), OTHER_SAMPLES, bytes(96))}, "samples.npy lacks force_n"),
        (
            {"truth": array((100, 3), "<f8", bytes(2400))},
            "truth has shape (100, 3) of float64, not (100, 4) of float64",
        ),
        ({"scene": array((1,), "<f8", bytes(8))}, "scene.npy is not a text"),
        ({"scene": array((), "<U2", "{:".encode("utf-32-le"))}, "Expecting property name enclosed in double quotes"),
        ({"scene": array((), "<U1", b"\xff\xff\xff\x7f")}, "codec can't decode bytes"),
        ({"events": array((1,), [("event", "<U1")], b"\xff\xff\xff\x7f")}, "codec can't decode bytes"),
        ({"events": array((10**15,), [("event", "<U1")])}, "should have 4000000000000000 bytes of data, has"),
    ],
)
def test_a_damaged_member_is_one_line(tmp_path: Path, members: dict[str, bytes | None], told: str) -> None:
    found = refusal(archive(tmp_path / "a.npz", **members))
    assert found.startswith("a.npz: damaged, or not a recording of hapticd: ") and told in found


@pytest.mark.parametrize("at", [0.1, 0.5, 0.9])
def test_a_changed_byte_is_noticed(tmp_path: Path, at: float) -> None:
    path = recorded(tmp_path / "a.npz")
    content = bytearray(path.read_bytes())
    content[int(at * 100 * SAMPLE_DTYPE.itemsize)] ^= 1
    path.write_bytes(content)
    assert refusal(path) == "a.npz: damaged, or not a recording of hapticd: Bad CRC-32 for file 'samples.npy'"


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 and so on", b"tick,time_ns\n1", b"\x89MCAP0\r\n\x01"])
def test_a_file_that_is_not_a_recording_is_an_error_of_one_line(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.npz").write_bytes(content)
    assert refusal(tmp_path / "a.npz") == "a.npz: damaged, or not a recording of hapticd: File is not a zip file"
    assert refusal(tmp_path / "b.npz") == "b.npz: No such file or directory"
    assert refusal(tmp_path / "a.mcap") == "a.mcap: must end in .npz; other formats are exports for other programs"


def test_a_recording_cut_short_is_one_line(tmp_path: Path) -> None:
    path = recorded(tmp_path / "a.npz")
    os.truncate(path, path.stat().st_size // 2)
    assert refusal(path).startswith("a.npz: damaged, or not a recording of hapticd: ")


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.npz")
    (tmp_path / "b.npz").mkdir()
    for name in ("a.npz", "b.npz"):
        assert refusal(tmp_path / name) == f"{name}: not a regular file"


def test_more_memory_than_there_is_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def none(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(reader, "_read", none)
    assert refusal(recorded(tmp_path / "a.npz")) == "a.npz: not enough memory"


def test_samples_take_no_memory_until_they_are_used(tmp_path: Path) -> None:
    path = recorded(tmp_path / "a.npz", 200_000)
    hapticd.load(recorded(tmp_path / "short.npz"))
    tracemalloc.start()
    recording = hapticd.load(path)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < recording.samples.nbytes / 4 and recording.samples["tick"][-1] == 199_999


def test_a_member_that_nobody_knows_is_not_read(tmp_path: Path) -> None:
    assert len(hapticd.load(archive(tmp_path / "a.npz", other=b"none of ours")).samples) == 100
