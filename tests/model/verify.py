"""The triple buffer and the ring, proved: `make verify-model`. docs/adr/0020 says what is proved and what is not.

models     spin visits every state of triple.pml and ring.pml
mutations  and finds each of those that are made wrong: a weaker memory order, two steps swapped, a step left out
code       the steps that the C code takes, as the compiler sees them, are those of the models, call by call
mutations  and of C code that is made wrong they are not
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Final

HERE: Final = Path(__file__).parent
ROOT: Final = HERE.parents[1]


@dataclass(frozen=True)
class Search:
    """One model, all of its states."""

    model: str
    defines: tuple[str, ...] = ()
    claim: str | None = None
    """An LTL formula of the model; None: its assertions."""
    fair: bool = False
    finds: bool = False
    """It is to find something."""

    def __str__(self) -> str:
        what = "assertions" if self.claim is None else f"{self.claim}, by fair schedules" if self.fair else self.claim
        return " ".join((self.model, *self.defines)) + f" ({what})"


PROOFS: Final = (
    Search("triple"),
    Search("triple", claim="owned"),
    Search("triple", ("PROMPT",), claim="taken", fair=True),
    Search("ring", ("CAPACITY=1",)),
    Search("ring", ("CAPACITY=2",)),
    Search("ring", ("CAPACITY=1", "PROMPT"), claim="taken", fair=True),
)
_TRIPLE: Final = (
    *("PUBLISH=0", "PUBLISH=ACQ", "PUBLISH=REL", "ACQUIRE=0", "ACQUIRE=ACQ", "ACQUIRE=REL"),
    *("MUTATE_LATE", "MUTATE_KEEP", "MUTATE_NO_NEW", "MUTATE_STAYS_NEW", "MUTATE_BLIND"),
)
_RING: Final = (
    *("COMMIT=0", "RELEASE=0", "LOAD_WRITE=0", "LOAD_READ=0"),
    *("MUTATE_EARLY_COMMIT", "MUTATE_EARLY_RELEASE", "MUTATE_FREE_ALL", "ROOM=3"),
)
MUTATIONS: Final = (
    *(Search("triple", (one,), finds=True) for one in _TRIPLE),
    *(Search("ring", (one,), finds=True) for one in _RING),
)


def program(*words: str | Path, folder: Path) -> str:
    """What it says; it must go well."""
    done = subprocess.run([str(word) for word in words], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(map(str, words))}:\n{done.stdout}{done.stderr}"
    return done.stdout


def searched(search: Search, compiler: str) -> int:
    """The number of states, once it came out as it should. Raises AssertionError."""
    with tempfile.TemporaryDirectory(prefix="hapticd-model-") as name:
        folder = Path(name)
        shutil.copy(HERE / f"{search.model}.pml", folder)
        program("spin", "-a", *(f"-D{one}" for one in search.defines), f"{search.model}.pml", folder=folder)
        how = ["-DNOCLAIM", "-DSAFETY"] if search.claim is None else []
        program(compiler, "-w", "-O0" if search.finds else "-O1", *how, "-o", "pan", "pan.c", folder=folder)
        run = ["-a", "-N", search.claim] if search.claim else []
        said = program("./pan", "-m2000000", *run, *(["-f"] if search.fair else []), folder=folder)
    errors = re.search(r"errors: (\d+)", said)
    states = re.search(r"(\d+) states, stored", said)
    assert errors is not None and states is not None, said
    assert "max search depth too small" not in said, said
    if search.finds:
        assert int(errors[1]) > 0 and "assertion violated" in said, f"not found: {search}\n{said}"
    else:
        assert int(errors[1]) == 0 and "Search not completed" not in said, f"{search}\n{said}"
    return int(states[1])


# ---- The code's own steps -------------------------------------------------------------------------------------------

Steps = frozenset[tuple[str, ...]]
"""Each call with what it does: several accesses to one place in a row are one."""


def model_steps() -> Steps:
    """Of long random runs."""
    found = set()
    for model in ("triple", "ring"):
        for seed in ("1", "2"):
            said = program("spin", "-T", f"-n{seed}", "-u100000", HERE / f"{model}.pml", folder=ROOT)
            for process in "12" if model == "ring" else "01":
                lines = (line.strip() for line in said.splitlines())
                found |= calls([line[2:] for line in lines if line.startswith(f"{process} ")])
    return frozenset(found)


def code_steps(sources: Path, compiler: str) -> Steps:
    """Of the C code in that folder."""
    with tempfile.TemporaryDirectory(prefix="hapticd-model-") as name:
        folder = Path(name)
        flags = ["-std=c11", "-O1", "-D_GNU_SOURCE", "-pthread", f"-I{sources}"]
        hooks = ["-Dmemcpy=traced_memcpy", "-Dmemset=traced_memset", "-include", HERE / "hooks.h", "-fsanitize=thread"]
        objects = []
        for source, more in (
            (sources / "base" / "hd_triple.c", hooks),
            (sources / "base" / "hd_ring.c", hooks),
            (HERE / "trace.c", hooks),
            (sources / "api" / "hd_error.c", []),
            (HERE / "hooks.c", []),
        ):
            objects.append(folder / f"{source.stem}.o")
            program(compiler, *flags, *more, "-c", source, "-o", objects[-1], folder=folder)
        program(compiler, *objects, "-o", "trace", folder=folder)
        return calls(program("./trace", folder=folder).splitlines())


def calls(lines: list[str]) -> Steps:
    found: set[tuple[str, ...]] = set()
    steps: list[str] = []
    for line in lines:
        match line.split(maxsplit=1):
            case ["BEGIN", name]:
                steps = [name]
            case ["STEP", step]:
                steps.append(step)
            case ["END"]:
                found.add(tuple(step for step, _ in groupby(steps)))
    return frozenset(found)


WRONG: Final = (
    ("base/hd_atomic.h", "&atomic->value, value, memory_order_acq_rel", "&atomic->value, value, memory_order_relaxed"),
    ("base/hd_ring.h", "hd_atomic_u64_load_acquire(&ring->write)", "hd_atomic_u64_load_relaxed(&ring->write)"),
    ("base/hd_ring.c", "hd_atomic_u64_store_release(&ring->write", "hd_atomic_u64_store_relaxed(&ring->write"),
    (
        "base/hd_ring.c",
        "    memcpy(slot, record, ring->record_size);\n    hd_ring_commit(ring);\n",
        "    hd_ring_commit(ring);\n    memcpy(slot, record, ring->record_size);\n",
    ),
)
"""File, what stands in it, and what is made of that."""


def wrong_steps(wrong: tuple[str, str, str], compiler: str) -> Steps:
    name, before, after = wrong
    with tempfile.TemporaryDirectory(prefix="hapticd-model-") as folder:
        copy = Path(folder) / "csrc"
        shutil.copytree(ROOT / "csrc", copy)
        text = (copy / name).read_text()
        assert before in text, f"{name} has no {before!r}"
        (copy / name).write_text(text.replace(before, after))
        return code_steps(copy, compiler)


def compared(compiler: str) -> int:
    """The number of ways that calls go. Raises AssertionError."""
    model, code = model_steps(), code_steps(ROOT / "csrc", compiler)
    assert model == code, f"only in the models: {sorted(model - code)}\nonly in the code: {sorted(code - model)}"
    for wrong in WRONG:
        assert wrong_steps(wrong, compiler) != model, f"not found: {wrong}"
    return len(code)


def main() -> int:
    if shutil.which("spin") is None:
        if os.geteuid() != 0 or shutil.which("apt-get") is None:
            print("make verify-model needs spin: install spin (Debian, Ubuntu)", file=sys.stderr)
            return 1
        quiet = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
        subprocess.run(["apt-get", "update", "-qq"], env=quiet, check=True)
        subprocess.run(
            ["apt-get", "install", "-y", "-qq", "--no-install-recommends", "spin"],
            env=quiet,
            check=True,
            stdout=subprocess.DEVNULL,
        )
    compiler = os.environ.get("CC", "cc")
    began = time.monotonic()
    try:
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            for search, states in zip(PROOFS, pool.map(lambda one: searched(one, compiler), PROOFS), strict=True):
                print(f"proved: {search}: {states} states", flush=True)
            list(pool.map(lambda one: searched(one, compiler), MUTATIONS))
        print(f"found: {len(MUTATIONS)} of {len(MUTATIONS)} mutations of the models", flush=True)
        ways = compared(compiler)
    except AssertionError as error:
        print(f"verify-model: {error}", file=sys.stderr)
        return 1
    print(f"the code takes the models' steps: {ways} ways of 6 calls; {len(WRONG)} of {len(WRONG)} mutations differ")
    print(f"verify-model: ok, {time.monotonic() - began:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
