"""Mutated recordings, as many as asked for: each is read, or refused in one line; memory stays bounded.

    python -m tests.soak.fuzz_recordings [--runs 20000] [--seed 0]

A recording, a file of the flight recorder and what a killed recording left are changed in their bytes and in what they
hold: members, samples, texts. What is read is rendered again, which must say what is wrong, too;
of parts a file is made, or they stay. The process gets LIMIT_BYTES of memory. The tests do some of each; a file that
fails is kept and named.
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
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache, partial
from pathlib import Path
from typing import Final

import numpy as np

from hapticd.base.core import SAMPLE_DTYPE
from hapticd.base.errors import HapticdError
from hapticd.config.configuration import load_config
from hapticd.recording.recording import load
from hapticd.recording.recovery import recover
from hapticd.recording.replay import replay
from hapticd.recording.writer import RecordingWriter
from hapticd.rendering.offline import simulate
from tests.support import fuzzing
from tests.support.fuzzing import Tree

HANGS_S: Final = 10.0
"""Processor time; a recording of twenty milliseconds that takes longer hangs."""
LIMIT_BYTES: Final = 256 << 20
"""Address room beyond what the process has: what a file claims beyond its size does not fit."""
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


def _fill(writer: RecordingWriter) -> None:
    """Records a short simulation."""
    config = load_config(CONFIG)
    samples = simulate(CONFIG, [[0.0, 0.0, 0.001], [0.01, 0.0, -0.001], [0.02, 0.001, 0.001]], 1e-4 * TICKS)
    samples["revision"] = np.where(samples["tick"] < 120, 1, 2)
    writer.begin(
        {
            "config": {"servo": config.servo.to_dict(), "device": config.device.to_dict()},
            "scene": config.scene.to_dict(),
            "materials": {name: config.materials[name].to_dict() for name in ("wood", "steel")},
        }
    )
    for change in CHANGES:
        writer.write_change(change)
    writer.write(samples)
    writer.write_event({"event": "contact", "tick": 3, "time_ns": 300000, "object": "floor"})
    writer.write_event({"event": "mark", "tick": 9, "time_ns": 900000, "text": "one", "data": {"a": [1, None]}})


@cache
def whole(form: str) -> dict[str, bytes]:
    """The files of a recording, by what their names have behind the stem; of parts by their names."""
    with tempfile.TemporaryDirectory(prefix="hapticd-test-") as folder:
        with RecordingWriter(Path(folder) / f"r{form}") as writer:
            _fill(writer)
            if form.startswith("left"):
                kinds = {path.suffix: path.read_bytes() for path in Path(folder).iterdir()}
                return {f".f{form}.1.0123456789abcdef{kind}": content for kind, content in kinds.items()}
            flight = {"reason": "asked", "tick": None, "complete_from": 10}
            writer.finish({"flight": flight, "recording": {"ticks": TICKS}} if form.startswith("flight") else {})
        return {path.name.removeprefix("r"): path.read_bytes() for path in Path(folder).iterdir()}


@cache
def members(form: str) -> dict[str, tuple[bytes, str | None]]:
    """The members of an archive: their bytes, and the text of those that are one."""
    found = {}
    with zipfile.ZipFile(io.BytesIO(whole(form)[form])) as archive:
        for name in archive.namelist():
            member = archive.read(name)
            array = np.load(io.BytesIO(member))
            found[name] = (member, str(array) if array.dtype.kind == "U" else None)
    return found


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


def _array(source: random.Random, content: bytes) -> bytes:
    """A .npy member: its bytes torn, or samples that no servo records."""
    if source.random() < 0.6:
        return torn(source, content)
    size = struct.unpack("<H", content[8:10])[0]
    data = content[10 + size :]
    records = np.frombuffer(data[: len(data) // SAMPLE_DTYPE.itemsize * SAMPLE_DTYPE.itemsize], SAMPLE_DTYPE).copy()
    if len(records):
        _hurt(source, records)
    return content[: 10 + size] + records.tobytes()


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


def npz(source: random.Random, form: str = ".npz") -> dict[str, bytes]:
    """A .npz: its archive torn, or put together anew of changed members."""
    if source.random() < 0.4:
        return {form: torn(source, whole(form)[form])}
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as new:
        chosen = source.sample(list(members(form)), source.choice((1, 1, 2)))
        for name, (member, text) in members(form).items():
            if name in chosen:
                if source.random() < 0.15:
                    continue
                member = _member(source, member, text)
            new.writestr(name, member, source.choice((zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED)))
    return {form: made.getvalue()}


def flight(source: random.Random) -> dict[str, bytes]:
    """A file of the flight recorder."""
    return npz(source, "flight.npz")


def _member(source: random.Random, member: bytes, text: str | None) -> bytes:
    """A changed member; texts are arrays of one long string."""
    if text is None or source.random() < 0.2:
        return _array(source, member)
    made = io.BytesIO()
    np.save(made, np.array(_text(source, text.encode()).decode("utf-8", "replace")))
    return made.getvalue()


def left(source: random.Random, form: str) -> dict[str, bytes]:
    """What a killed recording left: its part or its notes changed."""
    files = dict(whole(form))
    for name in source.sample(sorted(files), source.choice((1, 1, 2))):
        if source.random() < 0.03:
            del files[name]
        elif name.endswith(".notes") and source.random() < 0.7:
            lines = files[name].splitlines()
            at = source.randrange(len(lines))
            lines[at] = _text(source, lines[at])
            files[name] = b"".join(line + b"\n" for line in lines)
        else:
            files[name] = torn(source, files[name])
    return files


FORMS: Final[dict[str, Callable[[random.Random], dict[str, bytes]]]] = {
    ".npz": npz,
    "flight.npz": flight,
    "left.npz": partial(left, form="left.npz"),
}
WEIGHTS: Final = (6, 2, 1)


# ---- Runs --------------------------------------------------------------------------------------------------------


@contextmanager
def bounded_memory() -> Iterator[None]:
    """So little room that what a file claims beyond its size does not fit."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + LIMIT_BYTES, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


class Peak:
    """The most memory that the process held since `begin`, beyond what it held then."""

    def begin(self) -> None:
        with suppress(OSError):
            Path("/proc/self/clear_refs").write_text("5")
        self._before, _ = _resident()

    def taken(self) -> int:
        """Bytes."""
        return max(0, _resident()[1] - self._before)


def _resident() -> tuple[int, int]:
    """Bytes that are held now, and the most that were."""
    told = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    now, most = (int(told[name].split()[0]) << 10 for name in ("VmRSS", "VmHWM"))
    return now, most


def check_refusal(error: HapticdError, path: Path) -> None:
    """One line that names a file of the recording."""
    told = str(error)
    assert told.isprintable(), repr(told)
    assert len(told) < LONGEST_LINE, len(told)
    assert str(path.with_suffix("")) in told, told


def run_one(path: Path) -> str:
    """Reads a recording and renders it again; what came of it."""
    if path.name.startswith("fleft"):
        return _recovered(path)
    try:
        found = load(path)
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


def _recovered(path: Path) -> str:
    found = recover(path)
    for told in found.problems:
        check_refusal(HapticdError(told), path.with_name(f".{path.name}"))
    for made in found.files:
        try:
            load(made)
        except HapticdError as error:
            check_refusal(error, made)
            return "recovered, not read"
    return "rendered" if found.files else "refused"


def _write(folder: str, files: Mapping[str, bytes]) -> None:
    for name, content in files.items():
        hidden = name.endswith((".part", ".notes"))
        (Path(folder) / (name if hidden else f"f{name}")).write_bytes(content)


def run(source: random.Random, runs: int, forms: tuple[str, ...] = tuple(FORMS)) -> tuple[Counter[str], float, int]:
    """So many recordings: what came of them, the longest time (s) and the most memory (bytes) that one took.

    Raises Failure with the one that failed.
    """
    outcomes: Counter[str] = Counter()
    worst_s, most, peak = 0.0, 0, Peak()
    for form in forms:
        whole(form)
    with tempfile.TemporaryDirectory(prefix="hapticd-test-") as folder, fuzzing.hangs_after(HANGS_S) as begin:
        for form in forms:
            _write(folder, whole(form))
            assert run_one(Path(folder) / f"f{form}") == "rendered"
        for number in range(runs):
            (form,) = source.choices(forms, [WEIGHTS[list(FORMS).index(form)] for form in forms])
            for old in Path(folder).iterdir():
                old.unlink()
            _write(folder, FORMS[form](source))
            begin()
            peak.begin()
            started = time.process_time()
            try:
                with bounded_memory():
                    outcomes[f"{form} {run_one(Path(folder) / f'f{form}')}"] += 1
            except BaseException as error:  # a panic of pydantic is no Exception
                kept = tempfile.mkdtemp(prefix="hapticd-fuzz-")
                shutil.copytree(folder, kept, dirs_exist_ok=True)
                raise Failure(f"{number}: {type(error).__name__}: {error}: {kept}/f{form}") from error
            worst_s, most = max(worst_s, time.process_time() - started), max(most, peak.taken())
    return outcomes, worst_s, most


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    outcomes, worst_s, most = run(random.Random(arguments.seed), arguments.runs)
    told = ", ".join(f"{count} {outcome}" for outcome, count in sorted(outcomes.items()))
    ends = f"the slowest {1e3 * worst_s:.0f} ms, the largest {most / 2**20:.1f} MiB"
    print(f"fuzz_recordings: ok, {arguments.runs} recordings: {told}; {ends}")


if __name__ == "__main__":
    main()
