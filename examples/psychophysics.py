"""A staircase in a Python script: the smallest difference in the stiffness of two walls that a person notices.

    hapticd run                                        # in one terminal
    python examples/psychophysics.py answers.csv       # in another one; --simulated answers automatically

In each trial the simulated hand taps two walls, one after the other, and the script asks which was stiffer. The rule
1-up-2-down converges at 70.7 % correct answers. `hapticd experiment` runs such studies from a YAML file.
"""

from __future__ import annotations

import argparse
import csv
import random
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Final

import hapticd
from hapticd.base.errors import HapticdError
from hapticd.experiment.procedures.staircase import Staircase, StaircaseParameters

STANDARD_N_PER_M: Final = 500.0
FLOOR: Final = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "tested"}
TAP: Final = {"kind": "tap", "object": "floor", "speed_m_per_s": 0.1}


def staircase(trials: int) -> Staircase:
    """Return a staircase of differences in N/m, which starts at 200 and changes by factors."""
    parameters = {
        "rule": "1-up-2-down",
        "start": 200,
        "least": 1,
        "most": 400,
        "steps": [2, 1.41421],
        "axis": "logarithmic",
        "trials": trials,
        "guess": 0.5,
    }
    return Staircase(StaircaseParameters.model_validate(parameters))


def present(daemon: hapticd.Client, stiffness_n_per_m: float) -> float:
    """Let the hand tap a wall of this stiffness, and return the largest force in N."""
    daemon.update_materials({"tested": {"stiffness_n_per_m": stiffness_n_per_m}}, wait=True)
    with daemon.samples() as samples:
        daemon.set_operator(gesture=TAP)
        end = daemon.wait_gesture(timeout_s=60)
        largest = 0.0
        for batch in samples:
            largest = max(largest, float(abs(batch["force_n"]).max()))
            if batch["tick"][-1] >= end["tick"]:
                return largest
    raise HapticdError("the telemetry ended")


def person(forces_n: tuple[float, float]) -> str:
    """Ask the participant at the terminal which wall was stiffer. The forces are not shown."""
    while True:
        answer = input("Which was stiffer, the first (1) or the second (2)? ").strip()
        if answer in ("1", "2"):
            return answer


def simulated(forces_n: tuple[float, float]) -> str:
    """Return the number of the wall with the larger force."""
    return "1" if forces_n[0] > forces_n[1] else "2"


def run(daemon: hapticd.Client, path: Path, answer_of: Callable[[tuple[float, float]], str], trials: int) -> Staircase:
    """Run trials until the staircase ends, and write a row of the table after each trial."""
    order = random.Random(1)
    procedure = staircase(trials)
    tested = {"stiffness_n_per_m": STANDARD_N_PER_M}
    daemon.apply(materials={"tested": tested}, scene={"objects": {"floor": FLOOR}}, wait=True)
    with open(path, "x", newline="") as file:
        table = csv.writer(file)
        table.writerow(["trial", "difference_n_per_m", "stiffer", "answer", "correct"])
        while (difference := procedure.level()) is not None:
            stiffer = order.choice("12")
            walls: list[float] = [STANDARD_N_PER_M + (difference if place == stiffer else 0.0) for place in "12"]
            trial = len(procedure.answers) + 1
            daemon.mark(f"trial {trial}", {"stiffness_n_per_m": [*walls]})
            answer = answer_of((present(daemon, walls[0]), present(daemon, walls[1])))
            procedure.answer(difference, answer == stiffer)
            table.writerow([trial, difference, stiffer, answer, answer == stiffer])
            file.flush()
    return procedure


def main() -> int:
    """Run the script, and return the exit code."""
    parser = argparse.ArgumentParser(prog="psychophysics", description="A staircase of the stiffness of two walls.")
    parser.add_argument("path", type=Path, help="New file for the table of answers (.csv).")
    parser.add_argument("--simulated", action="store_true", help="Answer from the forces instead of asking.")
    parser.add_argument("--trials", type=int, default=40, help="Maximum number of trials.")
    given = parser.parse_args()
    try:
        with hapticd.connect() as daemon:
            done = run(daemon, given.path, simulated if given.simulated else person, given.trials)
        found = done.estimate()
    except (HapticdError, OSError) as error:
        print(f"psychophysics: {error}", file=sys.stderr)
        return 1
    print(
        f"threshold {found.threshold:.1f} N/m (95 %: {found.low:.1f} to {found.high:.1f}), {len(done.answers)} trials"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
