"""Ends `hapticd sweep run` at random moments, as Ctrl-C, SIGTERM and SIGKILL do: is anything lost, or left over?

python -m tests.soak.interrupt_sweeps [--ends 30] [--seed 1] [--points 300] [--latest 6.0]

SIGINT goes to all processes of the command, as from a terminal; the others to the command alone. Then no process of it
is left, it has said no more than a line besides the dashboard's address, and the rows of the folder are whole. At the
end the study is run through, and its rows are those of a study that nobody interrupted.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import yaml

from tests.support.daemon_process import PATIENCE_S

ENDS = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)
CODES = {signal.SIGINT: (130, -2), signal.SIGTERM: (143, -15), signal.SIGKILL: (-9,)}
"""The negative ones: while Python loads the command, or after its end."""


def study(folder: Path, points: int) -> Path:
    """A study whose points take some ten milliseconds each."""
    file = folder / "taps.yaml"
    masses = {"device.sim.hand.mass_kg": {"low": 0.01, "high": 0.1, "count": points}}
    file.write_text(
        yaml.safe_dump({"base": "materials", "operator": "taps", "vary": masses, "measure": ["peak_force_n"]})
    )
    return file


def command(file: Path, results: Path, *words: str) -> list[str]:
    """The command line of a study."""
    return [sys.executable, "-m", "hapticd", "sweep", "run", str(file), "-o", str(results), *words]


def left_over(session: int) -> list[str]:
    """Command lines of the processes of a session."""
    found = []
    for each in Path("/proc").iterdir():
        try:
            state, _, _, own = (each / "stat").read_text().rpartition(")")[2].split()[:4]
            if int(own) == session and state != "Z":
                found.append((each / "cmdline").read_text().replace("\0", " "))
        except (OSError, ValueError):
            continue  # no process, or one that has just ended
    return found


@dataclass(frozen=True, slots=True)
class End:
    """How a command ended."""

    code: int
    said: list[str]
    """Lines on stderr, without the dashboard's and progress."""
    left: list[str]
    took_s: float
    """From the signal to the end of its last process."""


def ended(words: list[str], number: signal.Signals, after_s: float) -> End:
    """Runs a command and ends it after some time."""
    with (
        tempfile.TemporaryFile("w+") as errors,
        subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=errors, start_new_session=True) as process,
    ):
        try:
            process.wait(after_s)
        except subprocess.TimeoutExpired:
            if number == signal.SIGINT:
                os.killpg(process.pid, number)
            else:
                process.send_signal(number)
        begin = time.monotonic()
        code = process.wait(PATIENCE_S)
        # Workers of a command that was killed end by themselves.
        while (left := left_over(process.pid)) and time.monotonic() < begin + PATIENCE_S:
            time.sleep(0.01)
        took_s = time.monotonic() - begin
        errors.seek(0)
        said = [line for line in errors.read().splitlines() if "dashboard: " not in line and "left" not in line]
    return End(code, said, left, took_s)


def digest(words: list[str]) -> str:
    """Of the rows, of a study that is run through."""
    done = subprocess.run([*words, "--json"], capture_output=True, text=True, check=True)
    told = json.loads(done.stdout)
    assert told["failed"] == 0
    return str(told["sha256"])


def wrong(end: End, number: signal.Signals) -> str | None:
    """What is not as it is to be."""
    if end.code not in (0, *CODES[number]):
        return f"exit code {end.code}: {end.said}"
    if end.left:
        return f"left over: {end.left}"
    # After SIGKILL Python's tracker of semaphores reports, in two lines, what it removed.
    if number != signal.SIGKILL and not all(line.startswith("hapticd: interrupted; ") for line in end.said):
        return f"said: {end.said}"
    return None


def main() -> int:
    """The exit code: whether all was as it is to be."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ends", type=int, default=30)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--points", type=int, default=300)
    parser.add_argument("--earliest", type=float, default=0.5, help="s; before, Python has not loaded the command yet")
    parser.add_argument("--latest", type=float, default=6.0, help="s")
    given = parser.parse_args()
    chance = random.Random(given.seed)
    bad: list[str] = []
    codes: Counter[str] = Counter()
    longest = 0.0
    with tempfile.TemporaryDirectory(prefix="hapticd-soak-") as name:
        folder = Path(name)
        file = study(folder, given.points)
        expected = digest(command(file, folder / "whole", "--threads"))
        for index in range(given.ends):
            number, after_s = ENDS[index % len(ENDS)], chance.uniform(given.earliest, given.latest)
            threads = ("--threads",) if chance.random() < 0.25 else ()
            end = ended(command(file, folder / f"r{index // 10}", *threads), number, after_s)
            fault = wrong(end, number)
            codes[f"{number.name} {end.code}"] += 1
            longest = max(longest, end.took_s)
            print(f"{index + 1}: {number.name} after {after_s:.2f} s {' '.join(threads)} -> {end.code}, "
                  f"{end.took_s:.2f} s, {fault or 'as it is to be'}", flush=True)  # fmt: skip
            if fault is not None:
                bad.append(fault)
        for index in range((given.ends + 9) // 10):
            if digest(command(file, folder / f"r{index}")) != expected:
                bad.append(f"rows of r{index} differ")
    print(f"{given.ends} ends, seed {given.seed}: {dict(codes)}, {longest:.1f} s at most; faults: {len(bad)}")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
