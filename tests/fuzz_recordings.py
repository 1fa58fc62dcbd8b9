"""Mutated recordings, as many as asked for: each is read, or refused in one line; memory stays bounded.

    python -m tests.fuzz_recordings [--runs 20000] [--seed 0]

A recording of each form, .npz, .csv and .mcap, is changed in its bytes and in what it holds: members, headers,
lengths, texts. What is read is rendered again, which must say what is wrong, too. The tests do some of each; a file
that fails is kept and named.
"""

from __future__ import annotations

import argparse
import io
import json
import random
import resource
import shutil
import struct
import tempfile
import time
import warnings
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np

from hapticd.config import load_config
from hapticd.core import SAMPLE_DTYPE
from hapticd.errors import HapticdError
from hapticd.offline import simulate
from hapticd.recorded import load_recorded
from hapticd.replayed import replay
from hapticd.sink import open_sink
from tests import fuzzing
from tests.fuzzing import Tree

HANGS_S: Final = 10.0
"""Processor time; a recording of twenty milliseconds that takes longer hangs."""
ROOM_BYTES: Final = 1 << 30
"""Address room beyond what the process has; a file of some kilobytes that needs more is not bounded."""
LONGEST_LINE: Final = 4000
TICKS: Final = 200

FLOOR: Final = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"}
CONFIG: Final = {"servo": {"rate_hz": 10000}, "scene": {"objects": {"floor": FLOOR}}}
CHANGES: Final[tuple[Tree, ...]] = (
    {"revision": 1},
    {"revision": 2, "objects": {"floor": FLOOR | {"material": "steel"}}},
    {"tick": 20, "reset": {"objects": ["floor"]}},
    {
        "tick": 50,
        "play": {
            "decay_rate_per_s": 90.0,
            "angular_frequency_rad_per_s": 400.0,
            "attack": "coefficient",
            "direction": [0.0, 1.0],
            "amplitude_m_per_s2": 3.0,
        },
    },
)


class Failure(AssertionError):
    """What was found, and where the file is."""


@cache
def whole(ending: str) -> dict[str, bytes]:
    """The files of a recording, by what its name has behind the stem."""
    config = load_config(CONFIG)
    samples = simulate(CONFIG, [[0.0, 0.0, 0.001], [0.01, 0.0, -0.001], [0.02, 0.001, 0.001]], 1e-4 * TICKS)
    samples["revision"] = np.where(samples["tick"] < 120, 1, 2)
    with tempfile.TemporaryDirectory(prefix="hapticd-test-") as folder:
        with open_sink(Path(folder) / f"r{ending}") as sink:
            sink.begin(
                {
                    "config": {"servo": config.servo.to_dict(), "device": config.device.to_dict()},
                    "scene": config.scene.to_dict(),
                    "materials": {name: config.materials[name].to_dict() for name in ("wood", "steel")},
                }
            )
            for change in CHANGES:
                sink.write_change(change)
            sink.write(samples)
            sink.write_event({"event": "contact", "tick": 3, "time_ns": 300000, "object": "floor"})
            sink.write_event({"event": "mark", "tick": 9, "time_ns": 900000, "text": "one", "data": {"a": [1, None]}})
            sink.finish()
        return {path.name.removeprefix("r"): path.read_bytes() for path in Path(folder).iterdir()}


# ---- What is changed ---------------------------------------------------------------------------------------------


def torn(source: random.Random, content: bytes) -> bytes:
    """Bytes changed, cut, added; now and then lengths of all ones."""
    found = bytearray(content)
    for _ in range(source.choice((1, 1, 2, 8, 64))):
        at = source.randrange(len(found)) if found else 0
        choice = source.randrange(8)
        if choice < 3 and found:
            found[at] ^= 1 << source.randrange(8)
        elif choice == 3:
            found[at : at + 8] = source.choice((b"\xff" * 8, b"\xff" * 4, bytes(8), struct.pack("<Q", 1 << 40)))
        elif choice == 4:
            del found[at : at + source.randrange(1, 50)]
        elif choice == 5:
            found[at:at] = source.randbytes(source.randrange(1, 20))
        elif choice == 6 and source.random() < 0.3:
            del found[at:]
        elif found:
            found[at] = source.randrange(256)
    return bytes(found)


def _text(source: random.Random, content: bytes) -> bytes:
    """JSON with a wrong branch, or torn."""
    if source.random() < 0.3:
        return torn(source, content)
    if source.random() < 0.02:
        return source.choice((b"[" * 100_000, b"1" * 10_000, b"nan", b'"' + b"x" * 100_000 + b'"', b""))
    tree = json.loads(content)
    if type(tree) is not dict and type(tree) is not list:
        return json.dumps(fuzzing.value(source)).encode()
    for _ in range(source.choice((1, 1, 2, 4))):
        fuzzing.mutate(source, tree)
    return json.dumps(tree).encode()


HEADERS: Final = (
    (
        b"(200,)",
        (b"(200000000000,)", b"(-1,)", b"(201,)", b"(199,)", b"(200,1)", b"()", b"(2**40,)", b"(1e3,)", b"(True,)"),
    ),
    (b"'<f8'", (b"'|O'", b"'<f4'", b"'<U9999999'", b"'>f8'", b"'<c16'", b"'|S0'", b"'<M8[ns]'", b"'|V99999999'")),
    (b"'tick'", (b"'tock'", b"''", b"'time_ns'", b"1", b"b'tick'")),
    (b"(2,)", (b"(3,)", b"(0,)", b"(99999999,)", b"(-2,)", b"(2,2)")),
    (b"False", (b"True", b"0", b"[]", b"-" * 5000 + b"1", b"(" * 150, b"{" * 50)),
    (b"'fortran_order'", (b"'x'", b"'descr'")),
)


def _array(source: random.Random, content: bytes) -> bytes:
    """A .npy member: its header changed to another that can be read, or its bytes."""
    if source.random() < 0.4:
        return torn(source, content)
    size = struct.unpack("<H", content[8:10])[0]
    header, data = content[10 : 10 + size], content[10 + size :]
    for old, new in source.sample(HEADERS, 2):
        header = header.replace(old, source.choice(new), source.choice((1, 9)))
    if source.random() < 0.3:
        records = np.frombuffer(data[: len(data) // SAMPLE_DTYPE.itemsize * SAMPLE_DTYPE.itemsize], SAMPLE_DTYPE).copy()
        if len(records):
            _hurt(source, records)
            data = records.tobytes()
    return content[:8] + struct.pack("<H", len(header) % 65536) + header + data


def _hurt(source: random.Random, records: np.ndarray) -> None:
    """Numbers that no servo records."""
    for _ in range(source.choice((1, 3, 20))):
        record = records[source.randrange(len(records))]
        name = source.choice(SAMPLE_DTYPE.names or ())
        base = SAMPLE_DTYPE[name].base
        if base.kind == "f":
            record[name][source.randrange(2)] = fuzzing.number(source)
        else:
            limits = np.iinfo(base)
            record[name] = source.choice((0, int(limits.max), int(limits.min), source.randrange(int(limits.max))))


def npz(source: random.Random) -> dict[str, bytes]:
    """A .npz: its archive torn, or put together anew of changed members."""
    content = whole(".npz")[".npz"]
    if source.random() < 0.35:
        return {".npz": torn(source, content)}
    made = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(made, "w") as new, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that a name is there twice is meant
        names = old.namelist()
        plain = (zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED)
        kinds = (zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA) if source.random() < 0.05 else plain
        chosen = source.sample(names, source.choice((1, 1, 2)))
        for name in names:
            member = old.read(name)
            if name in chosen:
                if source.random() < 0.15:
                    continue
                member = _member(source, member)
            kind = source.choice(kinds)
            new.writestr(
                name if source.random() < 0.98 else source.choice(("../x.npy", "x.npy", "a/b.npy")), member, kind
            )
    found = made.getvalue()
    return {".npz": _patched(source, found) if source.random() < 0.2 else found}


def _member(source: random.Random, member: bytes) -> bytes:
    """A changed member; texts are arrays of one long string."""
    if source.random() < 0.02:
        return member + bytes(20_000_000)
    try:
        array = np.load(io.BytesIO(member))
        text = str(array)
        if array.dtype.kind != "U" or source.random() < 0.2:
            return _array(source, member)
        made = io.BytesIO()
        np.save(made, np.array(_text(source, text.encode()).decode("utf-8", "replace")))
        return made.getvalue()
    except ValueError:
        return torn(source, member)


def _patched(source: random.Random, content: bytes) -> bytes:
    """An archive whose directory says something else: methods, sizes, flags."""
    found = bytearray(content)
    at = found.find(b"PK\x01\x02")
    while at >= 0 and source.random() < 0.7:
        place, value = source.choice(
            ((8, b"\x01\x00"), (10, b"\x63\x00"), (20, b"\xff" * 4), (24, b"\xff\xff\xff\x7f"), (42, b"\xff" * 4))
        )
        found[at + place : at + place + len(value)] = value
        at = found.find(b"PK\x01\x02", at + 4)
    return bytes(found)


def csv(source: random.Random) -> dict[str, bytes]:
    """A .csv with what stands beside it."""
    files = dict(whole(".csv"))
    name = source.choice((".csv", ".csv", ".about.json"))
    if name == ".about.json":
        files[name] = _text(source, files[name])
    elif source.random() < 0.4:
        files[name] = torn(source, files[name])
    else:
        rows = [line.split(b",") for line in files[name].splitlines()]
        for _ in range(source.choice((1, 2, 10))):
            row = rows[source.choice((0, 1, source.randrange(len(rows))))]
            place = source.randrange(len(row))
            row[place] = source.choice(
                (b"", b"nan", b"inf", b"-1", b"1e999", b"x", b'"', b"#", b"9" * 400, b"\xff", b"1 2", row[place - 1])
            )
            if source.random() < 0.2:
                row.append(b"1")
        if source.random() < 0.2:
            rows = rows[: source.randrange(4)]
        files[name] = source.choice((b"\n", b"\n", b"\r\n", b"\n\n")).join(b",".join(row) for row in rows)
    if source.random() < 0.01:
        del files[name]
    return files


def _records(content: bytes) -> Iterator[tuple[int, bytes]]:
    """The records of a .mcap between its magics."""
    at = 8
    while at < len(content) - 8:
        opcode, length = struct.unpack_from("<BQ", content, at)
        yield opcode, content[at + 9 : at + 9 + length]
        at += 9 + length


def mcap(source: random.Random) -> dict[str, bytes]:
    """A .mcap: its bytes torn, or its records changed, with lengths and places as they are, or put right."""
    content = whole(".mcap")[".mcap"]
    choice = source.random()
    if choice < 0.4:
        return {".mcap": torn(source, content)}
    found = [content[:8]]
    records = list(_records(content))
    hit = source.sample(range(len(records)), source.choice((1, 1, 2)))
    for place, (opcode, body) in enumerate(records):
        if place in hit:
            body = _record(source, opcode, body, choice < 0.8)
            if source.random() < 0.1:
                opcode = source.randrange(256)
        if place in hit and source.random() < 0.05:
            continue
        length = len(body) if source.random() < 0.98 else source.choice((0, 1 << 40, 2**64 - 1, len(body) + 1))
        found.append(struct.pack("<BQ", opcode, length) + body)
    return {".mcap": b"".join(found) + content[-8:]}


def _record(source: random.Random, opcode: int, body: bytes, same_size: bool) -> bytes:
    if opcode == 6 and source.random() < 0.8:  # a chunk: its own lengths, or what it holds
        begin, end, size, crc, length = struct.unpack_from("<QQQII", body)
        kind, data = body[32 : 32 + length], body[40 + length :]
        if source.random() < 0.5:
            size = source.choice((0, size + 1, 1 << 31, 1 << 40, 2**64 - 1))
        else:
            import zstandard

            messages = bytearray(zstandard.decompress(data, size)) if kind == b"zstd" else bytearray(data)
            messages = bytearray(torn(source, bytes(messages)))
            if source.random() < 0.1:
                messages += bytes(50_000_000)
            size, crc = len(messages), zlib.crc32(bytes(messages))
            data = zstandard.compress(bytes(messages)) if kind == b"zstd" else bytes(messages)
        if source.random() < 0.1:
            kind = source.choice((b"lz4", b"", b"zst", b"none"))
        return struct.pack("<QQQII", begin, end, size, crc, len(kind)) + kind + struct.pack("<Q", len(data)) + data
    made = bytearray(body)
    for _ in range(source.choice((1, 2, 6))):
        at = source.randrange(len(made)) if made else 0
        made[at : at + 4] = source.choice(
            (b"\xff\xff\xff\xff", bytes(4), source.randbytes(4), struct.pack("<I", source.randrange(5000)))
        )
    return bytes(made[: len(body)]) if same_size else bytes(made)


FORMS: Final[dict[str, Callable[[random.Random], dict[str, bytes]]]] = {".npz": npz, ".csv": csv, ".mcap": mcap}


# ---- Runs --------------------------------------------------------------------------------------------------------


@contextmanager
def bounded_memory() -> Iterator[None]:
    """So little room that what a file claims beyond its size does not fit."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + ROOM_BYTES, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def check_refusal(error: HapticdError, path: Path) -> None:
    """One line that names a file of the recording."""
    told = str(error)
    assert told.isprintable(), repr(told)
    assert len(told) < LONGEST_LINE, len(told)
    assert str(path.with_suffix("")) in told, told


def run_one(path: Path) -> str:
    """Reads a recording and renders it again; what came of it."""
    try:
        found = load_recorded(path)
    except HapticdError as error:
        check_refusal(error, path)
        return "refused"
    assert found.samples.dtype == SAMPLE_DTYPE
    assert found.samples.ndim == 1
    try:
        again = replay(path)
    except HapticdError as error:
        check_refusal(error, path)
        return "read, not rendered"
    assert np.isfinite(again.samples["force_n"]).all()
    json.dumps(again.to_dict())
    assert again.summary().isprintable()
    return "rendered"


def run(source: random.Random, runs: int, forms: tuple[str, ...] = tuple(FORMS)) -> tuple[Counter[str], float]:
    """So many recordings: what came of them, and the longest time. Raises Failure with the one that failed."""
    outcomes: Counter[str] = Counter()
    worst_s = 0.0
    for form in forms:
        whole(form)
    with tempfile.TemporaryDirectory(prefix="hapticd-test-") as folder, fuzzing.hangs_after(HANGS_S) as begin:
        for form in forms:
            for name, content in whole(form).items():
                (Path(folder) / f"f{name}").write_bytes(content)
            assert run_one(Path(folder) / f"f{form}") == "rendered"
        for number in range(runs):
            form = source.choice(forms)
            for old in Path(folder).iterdir():
                old.unlink()
            for name, content in FORMS[form](source).items():
                (Path(folder) / f"f{name}").write_bytes(content)
            begin()
            started = time.process_time()
            try:
                with bounded_memory():
                    outcomes[f"{form} {run_one(Path(folder) / f'f{form}')}"] += 1
            except BaseException as error:  # a panic of pydantic is no Exception
                kept = tempfile.mkdtemp(prefix="hapticd-fuzz-")
                shutil.copytree(folder, kept, dirs_exist_ok=True)
                raise Failure(f"{number}: {type(error).__name__}: {error}: {kept}/f{form}") from error
            worst_s = max(worst_s, time.process_time() - started)
    return outcomes, worst_s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    outcomes, worst_s = run(random.Random(arguments.seed), arguments.runs)
    told = ", ".join(f"{count} {outcome}" for outcome, count in sorted(outcomes.items()))
    print(f"fuzz_recordings: ok, {arguments.runs} recordings: {told}; the slowest {1e3 * worst_s:.0f} ms")


if __name__ == "__main__":
    main()
