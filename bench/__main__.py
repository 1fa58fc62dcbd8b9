"""`hapticd bench`, `make bench` or `python -m bench`: [NAMES...] [--quick] [--out DIR]; `--help` says more."""

from __future__ import annotations

import argparse
import re
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from bench import (
    browser,
    closed_loop,
    command,
    contacts,
    crowd,
    displayed,
    features,
    fit,
    joystick,
    lateness,
    link,
    marks,
    modes,
    noise,
    offline,
    passivity,
    resources,
    stability,
    streams,
    sweeps,
    telemetry,
    tick,
    timing,
    velocity,
    web,
)
from bench.report import PICTURES, ROOT, Advance, Options, Section, machine
from hapticd.base.errors import HapticdError
from hapticd.base.files import check_new

DOCS = ROOT / "docs"
ACCURACY, SPEED, DEVICES = "accuracy.md", "benchmarks.md", "devices.md"
NEEDED = ("distributed", "matplotlib", "mpmath", "pyarrow", "scipy")


@dataclass(frozen=True, slots=True)
class Measurement:
    """Something that is measured: what, how, and on which page each of its sections stands."""

    about: str
    run: Callable[[Options, Advance], Section | list[Section]]
    pages: tuple[str, ...] = (ACCURACY,)


MEASUREMENTS: dict[str, Measurement] = {
    "rendered": Measurement("what is rendered against closed forms", closed_loop.rendered),
    "modes": Measurement("ringing modes: rotor, libm, tables, recurrences", modes.run),
    "velocity": Measurement("velocity estimators by encoder step and rate", velocity.run),
    "onset": Measurement("time of the onset, with and without interpolation", timing.onsets),
    "grooves": Measurement("time of groove strikes", timing.grooves),
    "noise": Measurement("coloured noise: lattices, direct form, tables", noise.run),
    "features": Measurement("each feature of a surface: cost and error", features.run),
    "joystick": Measurement("integration of the simulated joystick", joystick.run),
    "loop": Measurement("closed-loop error against the cost of the tick", closed_loop.run),
    "loops": Measurement("closed-loop error over the rate", closed_loop.loops),
    "displayed": Measurement("displayed acceleration: compensation off, mass, full", displayed.run),
    "stability": Measurement("stability margins: maps, and 10,000 random walls and corners", stability.run),
    "passivity": Measurement("passivity observer and controller: energy given to the hand, cost", passivity.run),
    "fit": Measurement("taps fitted to synthetic recordings: errors, and coverage of the intervals", fit.run),
    "contacts": Measurement("taps of a hundred kinds of contact, fitted and rendered", contacts.run),
    "tick": Measurement("work per tick, the estimator, subnormal numbers", tick.run, (SPEED,)),
    "crowd": Measurement("1 to 10,000 objects, and compiling them", crowd.run, (SPEED,)),
    "offline": Measurement("render and simulate, ticks a second", offline.run, (SPEED,)),
    "servo": Measurement("lateness, work and jitter beside cyclictest", lateness.run, (SPEED, ACCURACY)),
    "command": Measurement("command round trip beside a bare echo", command.run, (SPEED,)),
    "telemetry": Measurement("ten subscribers, one dead", telemetry.run, (SPEED,)),
    "marks": Measurement("what marks cost the servo", marks.run, (SPEED,)),
    "streams": Measurement("streamed forces: what is lost, how long one takes, what it costs", streams.run, (SPEED,)),
    "web": Measurement("what the page's server costs", web.run, (SPEED,)),
    "browser": Measurement(
        "the page in a browser: frames, and how late force, picture and sound are", browser.run, (SPEED,)
    ),
    "sweeps": Measurement(
        "sweeps on dask beside bare processes, plans, growth with points and workers", sweeps.run, (SPEED,)
    ),
    "resources": Measurement("start, memory, processor time", resources.run, (SPEED,)),
    "link": Measurement("links of 1000, 500 and 250 Hz: stability, and error of each material", link.run, (DEVICES,)),
}


def unknown(names: Sequence[str]) -> str | None:
    """What is wrong with these names, as one line."""
    for name in names:
        if name not in MEASUREMENTS:
            return f"unknown benchmark {name}; known: {', '.join(MEASUREMENTS)}"
    return None


def listed() -> str:
    """The names and what they measure, a line each."""
    return "\n".join(f"  {name:10s} {each.about} ({each.pages[0]})" for name, each in MEASUREMENTS.items())


def _parser() -> argparse.ArgumentParser:
    defaults = Options()
    parser = argparse.ArgumentParser(
        prog="python -m bench",
        description="Measures speed and error. A whole run writes docs/accuracy.md, docs/benchmarks.md, the table of "
        f"links in docs/devices.md, and the figures in docs/{PICTURES}/.",
        epilog=f"names, and where each is told:\n{listed()}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help="what to measure [default: everything]")
    parser.add_argument("--quick", action="store_true", help="a minute or two: shows that it runs, not how fast")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="where the pages go [default: docs, of a whole run or with --overwrite]",
    )
    parser.add_argument(
        "--overwrite",
        action="store_true",
        help="replace the pages and figures that are there; of a part, its sections of them",
    )
    parser.add_argument("--pairs", type=int, default=defaults.pairs, help="paired runs beside cyclictest at each rate")
    parser.add_argument("--seconds", type=float, default=defaults.seconds, help="length of each of them")
    parser.add_argument("--minute", type=float, default=defaults.minute_s, help="seconds of the telemetry run")
    parser.add_argument("--load", type=int, default=0, help="busy processes beside the servo's runs")
    return parser


@dataclass(slots=True)
class Found:
    """The sections of each page, and what could not be measured."""

    pages: dict[str, list[Section]]
    failed: list[str]
    drawn: list[Path]
    took_s: float = 0.0


def _measure(
    console: Console, names: Sequence[str], options: Options, folder: Path | None, on: str | None = None
) -> Found:
    """Everything, shown as it comes, its figures into the folder. What fails says so in its place; the rest goes on.

    Each section ends with its command; `on` is added to it, the machine that a part was measured on.
    """
    found = Found({}, [], [])
    begin = time.monotonic()
    columns = (TextColumn("{task.description:44}"), BarColumn(), TimeElapsedColumn())
    for number, name in enumerate(names, 1):
        each = MEASUREMENTS[name]
        started = time.monotonic()
        if not console.is_terminal:
            console.print(f"{number}/{len(names)} {name}: {each.about}", highlight=False)
        # Redrawing is work beside what is measured.
        with Progress(*columns, console=console, transient=True, refresh_per_second=1) as progress:
            task = progress.add_task(name, total=1.0)

            def advance(part: float, what: str, label: str = f"{number}/{len(names)} {name}") -> None:
                progress.update(task, completed=part, description=f"{label}: {what}")  # noqa: B023

            try:
                given = each.run(options, advance)
                sections = given if isinstance(given, list) else [given]
                if folder is not None:
                    found.drawn += [path for section in sections for path in section.draw(folder / PICTURES)]
            except Exception as error:
                traceback.print_exc()
                found.failed.append(name)
                told = " ".join(str(error).split()) or type(error).__name__
                sections = [Section(name, [f"**Not measured:** {told}"])]
        told = (
            f"`python -m bench {name}`, {time.monotonic() - started:.0f} s{'' if on is None else f', by itself: {on}'}"
        )
        for index, section in enumerate(sections):
            section.parts.append(told)
            found.pages.setdefault(each.pages[min(index, len(each.pages) - 1)], []).append(section)
            section.show(console)
        console.print(f"({name}: {time.monotonic() - started:.0f} s)", highlight=False)
    found.took_s = time.monotonic() - begin
    return found


def replaced(page: str, sections: Sequence[Section]) -> str:
    """A page in which these sections stand instead of those of the same title; after the others where there is none."""
    head, *others = re.split(r"^(?=## )", page, flags=re.MULTILINE)
    parts = {other.partition("\n")[0]: other for other in others}
    parts |= {f"## {section.title}": section.markdown() for section in sections}
    return "\n\n".join(part.strip() for part in (head, *parts.values())) + "\n"


def _write(found: Found, folder: Path, on: str, whole: bool) -> list[Path]:
    """The pages, into a folder; their files. What is not all of a page goes into the one that is there."""
    took = f"The whole run took {found.took_s / 60:.0f} minutes ({found.took_s:.0f} s)."
    heads = {
        ACCURACY: (
            "Speed against error",
            "What each kernel costs and how wrong it is, beside other ways to do the same, against arbitrary "
            f"precision or a closed form. Written by `make bench` (`hapticd bench`). {on} {took} Ways are measured in "
            "turns in one process, and ratios are of one run, round by round; a cost is the median over the rounds, "
            "and in brackets the tenth to the ninetieth percentile of them. In the figures the way that hapticd takes "
            "is ringed. What a wake-up, a command and a scene cost is in [Benchmarks](benchmarks.md). All that a "
            "section claims is shown by the command at its end; errors of the core are asserted, with margins, in "
            "`tests/`.",
        ),
        SPEED: (
            "Benchmarks",
            "Times and rates. [Speed against error](accuracy.md) sets speed against error. Written by `make bench`; "
            f"ratios are of one run. {on} {took} Processors and other guests of the machine are shared, so that "
            "medians and ratios count, not the tails; a figure is the median over repetitions, and in brackets the "
            "tenth to the ninetieth percentile of them.",
        ),
    }
    written = []
    for page, sections in found.pages.items():
        if page == DEVICES:
            # A part of a page that is written by hand.
            if folder == DOCS and not found.failed:
                link.write_into(DOCS / DEVICES, sections[0])
                written.append(DOCS / DEVICES)
            continue
        title, about = heads[page]
        if not whole and (folder / page).exists():
            (folder / page).write_text(
                replaced((folder / page).read_text(encoding="utf-8"), sections), encoding="utf-8"
            )
            written.append(folder / page)
            continue
        text = "\n\n".join([f"# {title}", about, *(section.markdown() for section in sections)])
        (folder / page).write_text(text + "\n", encoding="utf-8")
        written.append(folder / page)
    return written


def perform(names: Sequence[str], options: Options, out: Path | None, overwrite: bool = False) -> int:
    """Measures what was asked for; the exit code. Raises HapticdError, of pages that are there and not to be replaced
    before anything is measured."""
    missing = [module for module in NEEDED if find_spec(module) is None]
    if missing:
        raise HapticdError(f"the benchmarks need {', '.join(missing)}: pip install -e '.[dev]' in the source tree")
    chosen = [name for name in MEASUREMENTS if name in names] or list(MEASUREMENTS)
    on = machine()
    console = Console(width=None if sys.stdout.isatty() else 160)
    console.print(on, markup=False, highlight=False)
    whole = chosen == list(MEASUREMENTS) and not options.quick
    if overwrite and out is None and options.quick:
        raise HapticdError("--quick measures too little for docs: give another folder with --out, or no --overwrite")
    folder = out or (DOCS if whole or overwrite else None)
    if folder is not None:
        for page in sorted({page for name in chosen for page in MEASUREMENTS[name].pages} - {DEVICES}):
            if (folder / page).exists():
                check_new(folder / page, overwrite)
    if folder is not None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise HapticdError(f"{folder}: cannot be made: {error.strerror}") from None
    found = _measure(console, chosen, options, folder, None if chosen == list(MEASUREMENTS) else on)
    console.print(f"\n{len(chosen)} measurements in {found.took_s:.0f} s", highlight=False)
    if folder is not None:
        for path in (*_write(found, folder, on, chosen == list(MEASUREMENTS)), *found.drawn):
            console.print(f"written: {path}", highlight=False)
    if found.failed:
        print(f"bench: not measured: {', '.join(found.failed)}", file=sys.stderr)
    return 1 if found.failed else 0


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line of `python -m bench`."""
    parser = _parser()
    given = parser.parse_args(arguments)
    wrong = unknown(given.names)
    if wrong is not None:
        parser.error(wrong)
    options = Options(
        pairs=given.pairs, seconds=given.seconds, minute_s=given.minute, load=given.load, quick=given.quick
    )
    try:
        return perform(given.names, options, given.out, given.overwrite)
    except HapticdError as error:
        print(f"bench: {error}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
