"""How much memory reading a recording takes, and what is said of files that are none."""

from __future__ import annotations

import io
import json
import os
import re
import struct
import tracemalloc
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

import hapticd
from hapticd.base.core import SAMPLE_DTYPE
from hapticd.base.errors import HapticdError
from hapticd.cli import main
from hapticd.recording import reading_limits
from hapticd.recording.csv_reader import _BLOCK
from hapticd.recording.event_cells import FromCells, _UnknownCells
from hapticd.recording.event_columns import members_of, members_of_kind
from hapticd.recording.formats import open_writer
from hapticd.recording.reader import load_recorded
from hapticd.recording.reading_limits import LEAST_LIMIT, TIMES_SIZE, default_limit, size_of
from hapticd.recording.replay import replay
from tests.recording.test_writer import FORMS, noisy
from tests.soak import fuzz_recordings
from tests.support.loading_memory import memory_of_loading

LIMIT = 32 << 20
MEBI = bytes(1 << 20)


def peak(act: Callable[[], object]) -> int:
    """The most memory that was in use meanwhile, bytes; too much where an array grows (see memory_of_loading)."""
    tracemalloc.start()
    try:
        act()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def short_recording(folder: Path, ending: str) -> Path:
    """A recording of a few samples."""
    for name, content in fuzz_recordings.whole(f".{ending}").items():
        (folder / f"short{name}").write_bytes(content)
    return folder / f"short.{ending}"


def refusal(path: Path) -> str:
    """What is said of a file that may take LIMIT; it takes no more than that."""
    told = []

    def read() -> None:
        for attempt in (load_recorded, replay):
            with pytest.raises(HapticdError) as caught:
                attempt(path, LIMIT)
            told.append(str(caught.value))

    assert peak(read) < LIMIT + (8 << 20)
    first, again = (re.sub(r"needs [\d.]+ \w+ of", "needs so much of", text) for text in told)
    assert first == again and told[0].startswith(f"{path.parent}/") and told[0].isprintable()
    return told[0].removeprefix(f"{path.parent}/")


def archive(path: Path, **members: Iterator[bytes]) -> Path:
    """A recording with members that are others, or more."""
    whole = io.BytesIO(fuzz_recordings.whole(".npz")[".npz"])
    with zipfile.ZipFile(whole) as old, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            if name.removesuffix(".npy") not in members:
                new.writestr(name, old.read(name))
        for name, content in members.items():
            with new.open(f"{name}.npy", "w", force_zip64=True) as member:
                for data in content:
                    member.write(data)
    return path


def header(shape: tuple[int, ...], form: object) -> bytes:
    made = io.BytesIO()
    np.lib.format.write_array_header_1_0(made, {"descr": form, "fortran_order": False, "shape": shape})
    return made.getvalue()


def blocks(begin: bytes, mebis: int) -> Iterator[bytes]:
    yield begin
    for _ in range(mebis):
        yield MEBI


SAMPLES = np.lib.format.dtype_to_descr(SAMPLE_DTYPE)


@pytest.mark.slow
def test_samples_that_were_compressed_take_what_they_may(tmp_path: Path) -> None:
    count = (100 << 20) // 112
    path = archive(tmp_path / "a.npz", samples=blocks(header((count,), SAMPLES), 100))
    assert path.stat().st_size < 1 << 20
    with pytest.raises(
        HapticdError, match=r"needs 100 MiB of memory with its samples, more than the 32 MiB that it may"
    ):
        hapticd.load(path, max_memory=LIMIT)
    with pytest.raises(HapticdError, match="--max-memory"):
        replay(path, LIMIT)
    assert len(hapticd.load(path, max_memory=101 << 20).samples) == count


def test_a_member_that_nobody_needs_is_not_unpacked(tmp_path: Path) -> None:
    path = archive(tmp_path / "a.npz", other=blocks(header((100 << 20,), "|u1"), 100))
    assert peak(lambda: load_recorded(path)) < 8 << 20


@pytest.mark.parametrize("size", [2**31, 100 << 20, 20_000])
def test_a_header_is_no_longer_than_numpy_writes(tmp_path: Path, size: int) -> None:
    begin = b"\x93NUMPY\x02\x00" + struct.pack("<I", size)
    path = archive(tmp_path / "a.npz", samples=blocks(begin, 100))
    assert refusal(path) == f"a.npz: is no recording of hapticd: samples.npy: says that its header has {size} bytes"


def test_a_directory_without_end(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w") as file:
        for number in range(25_000):
            file.writestr(str(number), b"")
    assert refusal(path) == "a.npz: is no recording of hapticd: the directory of its archive is too long"


@pytest.mark.slow
def test_texts_take_what_they_may(tmp_path: Path) -> None:
    text = "[" + "[]," * 1_000_000 + "[]]"
    path = archive(tmp_path / "a.npz", scene=iter([header((), f"<U{len(text)}"), text.encode("utf-32-le")]))
    assert "of memory with scene" in refusal(path)
    files = fuzz_recordings.whole(".csv") | {".about.json": text.encode()}
    for name, content in files.items():
        (tmp_path / f"b{name}").write_bytes(content)
    assert "of memory with b.about.json" in refusal(tmp_path / "b.csv")
    found = json.loads(text)
    assert size_of(found) > 64 * len(found)


def test_a_member_that_is_there_twice(tmp_path: Path) -> None:
    path = archive(tmp_path / "a.npz")
    with zipfile.ZipFile(path, "a") as file, pytest.warns(UserWarning):
        file.writestr("scene.npy", b"")
    assert refusal(path) == "a.npz: is no recording of hapticd: scene.npy: is there twice"


# ---- .csv --------------------------------------------------------------------------------------------------------


def csv(tmp_path: Path, **files: bytes) -> Path:
    for name, content in fuzz_recordings.whole(".csv").items():
        (tmp_path / f"a{name}").write_bytes(files.get(name.strip(".").replace(".", "_"), content))
    return tmp_path / "a.csv"


def rows() -> tuple[bytes, bytes]:
    names, row = fuzz_recordings.whole(".csv")[".csv"].split(b"\n")[:2]
    return names + b"\n", row + b"\n"


@pytest.mark.slow
def test_rows_take_what_samples_do(tmp_path: Path) -> None:
    names, row = rows()
    short = b",".join(b"0" for _ in row.split(b",")) + b"\n"
    path = csv(tmp_path, csv=names + short * 200_000)
    assert path.stat().st_size < 8 << 20
    assert memory_of_loading(short_recording(tmp_path, "csv"), path, LIMIT) < LIMIT, "22 MiB of samples, and a quarter"
    csv(tmp_path, csv=names + short * 400_000)
    for attempt in (load_recorded, replay):
        with pytest.raises(HapticdError, match="of memory with its samples"):
            attempt(path, LIMIT)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"0," * 3_000_000, "line 2 is too long"),
        (b"%s" + b"\xff\xfe\n", "line 3 has something else than numbers"),
        (b"%s\n\n" + b"root:$6$secret\n", "line 5: has another number of columns than the line of names"),
    ],
)
def test_rows_that_are_none(tmp_path: Path, content: bytes, told: str) -> None:
    names, row = rows()
    path = csv(tmp_path, csv=names + content.replace(b"%s", row))
    assert refusal(path) == f"a.csv: is no recording of hapticd: {told}"


@pytest.mark.parametrize("cell", [b"secret", b"1.5", b"-1", b"9" * 30, b"1e3", b""])
def test_a_cell_that_is_none_is_not_shown(tmp_path: Path, cell: bytes) -> None:
    names, row = rows()
    path = csv(tmp_path, csv=names + row * 3 + row.replace(b"0", cell, 1) + row)
    assert row.startswith(b"0,")
    assert refusal(path) == "a.csv: is no recording of hapticd: line 5: column 1 is no number of its kind"


@pytest.mark.slow
def test_events_take_what_they_may(tmp_path: Path) -> None:
    path = csv(tmp_path, events_csv=b"event,tick,time_ns\n" + b"a,1,1\n" * 200_000)
    assert "of memory with its events" in refusal(path)
    path = csv(tmp_path, events_csv=b"event,tick,time_ns\n" + b"x" * 3_000_000)
    assert "a.events.csv: a line is too long" in refusal(path)
    path = csv(tmp_path, events_csv=b"event,tick,time_ns\nsecret,x,1\n")
    assert "a.events.csv: line 2 is no event" in refusal(path)


CELLS = ["1", "-0", "007", "1.5", "1e3", "1_0", "true", "null", "NaN", "-Infinity", "[1, 2]", '{"a": []}', '"x"', "x"]
SLIPS = ["\t[]\n", " 1 ", " x ", "[x]", "[1", "1x", "nul", "\ufeff1", "9" * 5000, " ", '"']


@pytest.mark.parametrize("cell", CELLS + SLIPS)
def test_a_cell_that_nobody_knows_is_json_or_text(cell: str) -> None:
    try:
        wanted = json.loads(cell)
    except ValueError:
        wanted = cell
    cells = FromCells(["event", "later"])
    for others in ([], ["12", "-1.5"], ["x"], ["[", "1", "2]"]):
        found, _ = cells.events([["a", text] for text in [*others, cell]])
        assert type(found[-1]["later"]) is type(wanted) and repr(found[-1]["later"]) == repr(wanted)


def test_a_column_whose_cells_are_no_json_is_not_tried_for_ever() -> None:
    cells = FromCells(["event", "later", "other"])
    for number in range(_UnknownCells.MOST_TEXTS):
        assert cells.events([["a", f"[{number}x]", "1"]])[0][0]["later"] == f"[{number}x]"
    assert cells.events([["a", "[1]", "[1]"]])[0] == [{"event": "a", "later": "[1]", "other": [1]}]


def test_kinds_that_nobody_knows_are_not_remembered(tmp_path: Path) -> None:
    before = members_of_kind.cache_info().currsize
    path = csv(tmp_path, events_csv=b"event,tick,time_ns\n" + b"".join(b"a%d,1,1\n" % at for at in range(100)))
    assert [event["event"] for event in load_recorded(path).events] == [f"a{at}" for at in range(100)]
    assert members_of("a1") is None and members_of_kind.cache_info().currsize == before


def test_of_columns_of_one_name_the_last_counts(tmp_path: Path) -> None:
    path = csv(tmp_path, events_csv=b"event,tick,x,x\na,1,2,3\na,1,2,\n")
    assert load_recorded(path).events == [{"event": "a", "tick": 1, "x": 3}, {"event": "a", "tick": 1}]


def test_lines_of_events_are_whole_wherever_a_block_ends(tmp_path: Path) -> None:
    texts = [f"{at}\u2028\x85\U0001f600" * 7 + '\n",' * (at % 3) for at in range(9000)]
    rows = "".join(f'a,{at},"{text.replace(chr(34), chr(34) * 2)}"\n' for at, text in enumerate(texts))
    path = csv(tmp_path, events_csv=("event,tick,text\n" + rows.rstrip("\n")).encode())
    assert len(rows.encode()) > 2 * _BLOCK
    assert [event["text"] for event in load_recorded(path).events] == texts


def test_events_of_all_kinds_keep_their_order_and_their_lines(tmp_path: Path) -> None:
    """Rows are read in stretches of one kind each, and come back as they stood."""
    names = b"event,tick,time_ns,faults,object,later\n"
    wanted, content = [], b""
    for at in range(1000):
        if at % 3 == 0:
            wanted.append({"event": "fault", "tick": at, "time_ns": 7, "faults": ["control"] * (at % 2)})
            content += b"fault,%d,7,%s,,\n" % (at, b'"[""control""]"' if at % 2 else b"[]")
        elif at % 3 == 1:
            wanted.append({"event": "new", "tick": at, "later": at} if at % 2 else {"event": "new", "tick": at})
            content += b"new,%d,,,,%s\n" % (at, b"%d" % at if at % 2 else b"")
        else:
            wanted.append({"event": "newer", "time_ns": at, "object": None, "later": "two\nlines"})
            content += b'newer,,%d,,null,"two\nlines"\n' % at
    path = csv(tmp_path, events_csv=names + content)
    assert load_recorded(path).events == wanted
    lines = (names + content).count(b"\n")
    for row, told in ((b"new,x,,,,", "is no event"), (b"new,1", "has 2 columns, not 6")):
        csv(tmp_path, events_csv=names + content + row + b"\n" + content)
        assert f"a.events.csv: line {lines + 1} {told}" in refusal(path)


@pytest.mark.slow
def test_short_texts_of_events_are_counted_as_what_they_take(tmp_path: Path) -> None:
    """A text of three letters takes 52 bytes, and its place in a map."""
    names = b"event" + b"".join(b",c%d" % at for at in range(500)) + b"\n"
    row = b"a" + b"".join(b",x%02d" % (at % 100) for at in range(500)) + b"\n"
    path = csv(tmp_path, events_csv=names + row * 600)
    assert "of memory with its events" in refusal(path)


# ---- .mcap -------------------------------------------------------------------------------------------------------


def mcap(path: Path, change: Callable[[int, bytes], list[tuple[int, bytes]]]) -> Path:
    """A recording whose records are changed."""
    content = fuzz_recordings.whole(".mcap")[".mcap"]
    found = [content[:8]]
    for opcode, body in fuzz_recordings._records(content):
        found += [struct.pack("<BQ", kind, len(data)) + data for kind, data in change(opcode, body)]
    path.write_bytes(b"".join(found) + content[-8:])
    return path


def chunk(kind: bytes, size: int, data: bytes) -> bytes:
    return struct.pack("<QQQII", 0, 1, size, 0, len(kind)) + kind + struct.pack("<Q", len(data)) + data


@pytest.mark.parametrize("size", [1000, 60 << 20, 64 << 20])
def test_a_chunk_by_lz4_that_holds_more_than_it_says(tmp_path: Path, size: int) -> None:
    lz4 = pytest.importorskip("lz4.frame")
    data = lz4.compress(bytes(200 << 20))
    path = mcap(
        tmp_path / "a.mcap", lambda opcode, body: [(6, chunk(b"lz4", size, data))] if opcode == 6 else [(opcode, body)]
    )
    told = refusal(path)
    assert told.endswith("a chunk holds another number of bytes than it says") or "with one of its chunks" in told


@pytest.mark.parametrize("kind", [b"lz4", b"zstd", b""])
def test_chunks_of_every_compression_are_read(tmp_path: Path, kind: bytes) -> None:
    lz4, zstandard = pytest.importorskip("lz4.frame"), pytest.importorskip("zstandard")
    made = {b"lz4": lz4.compress, b"zstd": zstandard.ZstdCompressor(write_content_size=False).compress, b"": bytes}[
        kind
    ]

    def change(opcode: int, body: bytes) -> list[tuple[int, bytes]]:
        if opcode != 6:
            return [(opcode, body)]
        raw = zstandard.decompress(body[44:])
        return [(6, chunk(kind, len(raw), made(raw)))]

    path = mcap(tmp_path / "a.mcap", change)
    whole = tmp_path / "b.mcap"
    whole.write_bytes(fuzz_recordings.whole(".mcap")[".mcap"])
    found, given = load_recorded(path), load_recorded(whole)
    assert found.samples.tobytes() == given.samples.tobytes() and found.events == given.events
    assert found.texts == given.texts


def test_attachments_that_are_there_twice(tmp_path: Path) -> None:
    path = mcap(tmp_path / "a.mcap", lambda opcode, body: [(opcode, body)] * (2 if opcode == 9 else 1))
    assert refusal(path) == "a.mcap: is no recording of hapticd: config is there twice"


@pytest.mark.slow
def test_a_long_simulation_is_written_in_chunks(tmp_path: Path) -> None:
    samples = np.concatenate([noisy(250_000, 0), noisy(250_000, 250_000)])
    with open_writer(tmp_path / "a.mcap") as writer:
        writer.write(samples)
        writer.finish({})
    assert load_recorded(tmp_path / "a.mcap").samples.tobytes() == samples.tobytes()


# ---- All of them -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ending", FORMS)
def test_what_hapticd_records_is_read_by_default(tmp_path: Path, ending: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a recording so long that its size decides, also for rendering it again."""
    path = tmp_path / f"a.{ending}"
    with open_writer(path) as writer:
        writer.begin({"config": {}, "scene": {"objects": {}}, "materials": {}})
        for batch in range(100):
            still = np.zeros(1000, SAMPLE_DTYPE)
            still["tick"] = np.arange(1000 * batch, 1000 * batch + 1000)
            still["time_ns"] = still["tick"] * 100_000
            writer.write(still)
        writer.finish({})
    size = 100_000 * (SAMPLE_DTYPE.itemsize * 5 // 4)
    assert memory_of_loading(short_recording(tmp_path, ending), path, size + (4 << 20)) < size + (8 << 20)
    monkeypatch.setattr(reading_limits, "LEAST_LIMIT", 0)
    assert len(load_recorded(path).samples) == 100_000


def test_the_limit_follows_size_and_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reading_limits, "_available", lambda: 1 << 40)
    assert default_limit(10) == LEAST_LIMIT and default_limit(1 << 30) == TIMES_SIZE << 30
    monkeypatch.setattr(reading_limits, "_available", lambda: 1000)
    assert default_limit(10) == 900
    monkeypatch.setattr(reading_limits, "_available", lambda: None)
    assert default_limit(10) == LEAST_LIMIT


def test_more_memory_than_there_is_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def none(*_: object) -> None:
        raise MemoryError

    path = archive(tmp_path / "a.npz")
    monkeypatch.setattr("hapticd.recording.reader.load_npz", none)
    with pytest.raises(HapticdError, match=r"a.npz: takes more memory than there is"):
        load_recorded(path)


@pytest.mark.parametrize("name", ["a.npz", "a.csv", "a.mcap"])
def test_a_pipe_is_not_waited_for(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    (tmp_path / f"b{name[1:]}").mkdir()
    assert refusal(tmp_path / name) == f"{name}: is no regular file"
    assert refusal(tmp_path / f"b{name[1:]}") == f"b{name[1:]}: is a directory"


def test_a_pipe_beside_a_csv_is_not_waited_for(tmp_path: Path) -> None:
    path = csv(tmp_path)
    for name in ("a.about.json", "a.events.csv"):
        (tmp_path / name).unlink()
        os.mkfifo(tmp_path / name)
        assert refusal(path) == f"{name}: is no regular file"
        (tmp_path / name).unlink()
        csv(tmp_path)


def test_replay_takes_max_memory(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = archive(tmp_path / "a.npz", samples=blocks(header(((100 << 20) // 112,), SAMPLES), 100))
    for given, told in (("32MiB", "32 MiB"), ("33554432", "32 MiB"), ("0.05G", "47.7 MiB"), ("50 MB", "47.7 MiB")):
        assert main(["replay", str(path), "--max-memory", given]) == 1
        assert f"more than the {told} that it may take" in capsys.readouterr().err
    for wrong in ("much", "0", "-1", "1XB", "1e99"):
        assert main(["replay", str(path), f"--max-memory={wrong}"]) == 2
        assert "is not a size such as 512MiB or 8GB" in capsys.readouterr().err
