"""All benchmarks, and the pages into which their results are written."""

from __future__ import annotations

import re
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from bench import (
    browser,
    closed_loop,
    command,
    crowd,
    displayed,
    features,
    fit,
    lateness,
    link,
    offline,
    passivity,
    resources,
    stability,
    streams,
    telemetry,
    tick,
    web,
)
from bench.report import ROOT, Advance, Options, Section, filled, machine
from bench.summary import with_summary
from hapticd.base.errors import HapticdError
from hapticd.base.files import check_new
from hapticd.cli import main

DOCS = ROOT / "docs"
ACCURACY, SPEED, DEVICES = "accuracy.md", "benchmarks.md", "devices.md"
REQUIRED_MODULES = ("distributed", "matplotlib", "pyarrow", "scipy")


@dataclass(frozen=True, slots=True)
class Measurement:
    """A benchmark: its description, its function, and the page of its section."""

    about: str
    run: Callable[[Options, Advance], Section]
    page: str = ACCURACY


MEASUREMENTS: dict[str, Measurement] = {
    "closed_loop": Measurement("closed-loop error over the rate", closed_loop.run),
    "displayed": Measurement("displayed acceleration: compensation off, mass, full", displayed.run),
    "stability": Measurement("stability margins: maps, and 10,000 random walls and corners", stability.run),
    "passivity": Measurement("passivity observer and controller: energy given to the hand, cost", passivity.run),
    "fit": Measurement("taps fitted to synthetic recordings: errors, and coverage of the intervals", fit.run),
    "tick": Measurement("work per tick, and the estimator", tick.run, SPEED),
    "features": Measurement("what each feature of a surface adds to a tick", features.run, SPEED),
    "crowd": Measurement("1 to 10,000 objects, and compiling them", crowd.run, SPEED),
    "offline": Measurement("render and simulate, ticks a second", offline.run, SPEED),
    "servo": Measurement("lateness and work, compared with cyclictest", lateness.run, SPEED),
    "command": Measurement("command round trip, compared with a bare echo", command.run, SPEED),
    "telemetry": Measurement("ten subscribers, one dead", telemetry.run, SPEED),
    "streams": Measurement("streamed forces: losses, latency, processor time", streams.run, SPEED),
    "web": Measurement("cost of the page's server", web.run, SPEED),
    "browser": Measurement("the page in a browser: frames, latency of force, picture and sound", browser.run, SPEED),
    "resources": Measurement("start, memory, processor time", resources.run, SPEED),
    "link": Measurement("links of 1000 to 125 Hz: stability, and error of each material", link.run, DEVICES),
}


def unknown(names: Sequence[str]) -> str | None:
    """Return an error for the first name that no benchmark has; None if all are known."""
    for name in names:
        if name not in MEASUREMENTS:
            return f"unknown benchmark {name}; known: {', '.join(MEASUREMENTS)}"
    return None


def listed() -> str:
    """Return a line for each benchmark: its name, description and page."""
    return "\n".join(f"  {name:11s} {each.about} ({each.page})" for name, each in MEASUREMENTS.items())


@dataclass(slots=True)
class Found:
    """The results of a run."""

    pages: dict[str, list[Section]]
    """The sections of each page."""
    failed: list[str]
    """Names of the benchmarks that failed."""
    duration_s: float = 0.0


def _measure(console: Console, names: Sequence[str], options: Options, on: str | None = None) -> Found:
    """Run benchmarks, and print each section as soon as it is complete. The section of a failed one has its error.

    Each section ends with its command, and with `on`, the machine, if only some benchmarks are run.
    """
    found = Found({}, [])
    begin = time.monotonic()
    columns = (TextColumn("{task.description:44}"), BarColumn(), TimeElapsedColumn())
    for number, name in enumerate(names, 1):
        each = MEASUREMENTS[name]
        started = time.monotonic()
        if not console.is_terminal:
            console.print(f"{number}/{len(names)} {name}: {each.about}", highlight=False)
        # Redrawn rarely, since drawing takes processor time from the measurement.
        with Progress(*columns, console=console, transient=True, refresh_per_second=1) as progress:
            task = progress.add_task(name, total=1.0)

            def advance(part: float, what: str, label: str = f"{number}/{len(names)} {name}") -> None:
                progress.update(task, completed=part, description=f"{label}: {what}")  # noqa: B023

            try:
                section = each.run(options, advance)
            except Exception as error:
                traceback.print_exc()
                found.failed.append(name)
                why = " ".join(str(error).split()) or type(error).__name__
                section = Section(name, [f"**Not measured:** {why}"])
        command = f"`python -m bench {name}`, {time.monotonic() - started:.0f} s"
        section.parts.append(command if on is None else f"{command}, measured separately: {on}")
        found.pages.setdefault(each.page, []).append(section)
        section.show(console)
    found.duration_s = time.monotonic() - begin
    return found


def replaced(page: str, sections: Sequence[Section]) -> str:
    """Return a page with `sections` in place of those with the same titles. Sections with new titles come last."""
    head, *others = re.split(r"^(?=## )", page, flags=re.MULTILINE)
    parts = {other.partition("\n")[0]: other for other in others}
    parts |= {f"## {section.title}": section.markdown() for section in sections}
    return "\n\n".join(part.strip() for part in (head, *parts.values())) + "\n"


def _write(found: Found, folder: Path, on: str, complete: bool) -> list[Path]:
    """Write pages into a folder and return their paths; unless `complete`, replace only sections of existing pages."""
    duration = f"The complete run took {found.duration_s / 60:.0f} minutes ({found.duration_s:.0f} s)."
    heads = {
        ACCURACY: (
            "Accuracy",
            "Errors of rendering, display and fitting, against arbitrary precision or a closed form. `make bench` "
            f"(`hapticd bench`) writes this page. {on} {duration} The command at the end of a section repeats the "
            "section's measurements; the time after it is what they took. Tests in `tests/` assert the errors of the "
            "core, with margins. [Algorithms and their alternatives](alternatives.md) compares cost and error of each "
            "kernel with other methods, and [Benchmarks](benchmarks.md) has the times.",
        ),
        SPEED: (
            "Benchmarks",
            "This page has times and rates, [Accuracy](accuracy.md) the errors of rendering. `make bench` writes "
            f"this page; ratios are taken within one run. {on} {duration} Other guests share the machine, so medians "
            "and ratios are meaningful, but the highest percentiles are not. A figure is the median over repetitions, "
            "with the tenth to the ninetieth percentile in brackets: (10 to 90 %).",
        ),
        DEVICES: ("Devices", on),
    }
    written = []
    in_docs = folder.resolve() == DOCS
    for page, sections in found.pages.items():
        if page == DEVICES and in_docs:
            # The rest of this page is written by hand.
            if not found.failed:
                link.write_into(DOCS / DEVICES, sections[0])
                written.append(DOCS / DEVICES)
            continue
        title, about = heads[page]
        if not complete and (folder / page).exists():
            text = replaced((folder / page).read_text(encoding="utf-8"), sections)
        else:
            text = "\n\n".join([f"# {title}", filled(about), *(section.markdown() for section in sections)]) + "\n"
        (folder / page).write_text(text, encoding="utf-8")
        if page == ACCURACY and (complete or in_docs) and not found.failed:
            # Only now, so that the measurements are not lost if the tables lack a cell of the summary.
            (folder / page).write_text(with_summary(text), encoding="utf-8")
        written.append(folder / page)
    return written


def perform(names: Sequence[str], options: Options, out: Path | None, overwrite: bool = False) -> int:
    """Run the named benchmarks, or all without a name, write the pages into `out`, and return the exit code.

    Raises HapticdError before the first measurement if pages exist and `overwrite` is not set.
    """
    missing = [module for module in REQUIRED_MODULES if find_spec(module) is None]
    if missing:
        raise HapticdError(f"the benchmarks need {', '.join(missing)}: pip install -e '.[dev]' in the source tree")
    chosen = [name for name in MEASUREMENTS if name in names] or list(MEASUREMENTS)
    on = machine()
    console = Console(width=None if sys.stdout.isatty() else 160)
    console.print(on, markup=False, highlight=False)
    complete = chosen == list(MEASUREMENTS) and not options.quick
    folder = out or (DOCS if complete or overwrite else None)
    if options.quick and folder is not None and folder.resolve() == DOCS:
        raise HapticdError("--quick measures too little for docs: give another folder with --out, or no --overwrite")
    if folder is not None:
        files = {MEASUREMENTS[name].page for name in chosen} | ({stability.PLOT} if "stability" in chosen else set())
        if folder.resolve() == DOCS:
            files.discard(DEVICES)
        for file in sorted(files):
            if (folder / file).exists():
                check_new(folder / file, overwrite)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise HapticdError(f"{folder}: cannot be created: {error.strerror}") from None
    options = replace(options, folder=folder)
    found = _measure(console, chosen, options, None if chosen == list(MEASUREMENTS) else on)
    console.print(f"\n{len(chosen)} measurements in {found.duration_s:.0f} s", highlight=False)
    if folder is not None:
        for path in _write(found, folder, on, chosen == list(MEASUREMENTS)):
            console.print(f"written: {path}", highlight=False)
    if found.failed:
        print(f"bench: not measured: {', '.join(found.failed)}", file=sys.stderr)
    return 1 if found.failed else 0


if __name__ == "__main__":
    sys.exit(main(["bench", *sys.argv[1:]]))
