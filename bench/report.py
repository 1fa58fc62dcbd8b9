"""Sections and tables of the benchmarks, on the terminal and in Markdown, and the description of the machine."""

from __future__ import annotations

import os
import platform
import re
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.table import Table as RichTable

ROOT = Path(__file__).resolve().parent.parent
Floats = npt.NDArray[np.float64]
Advance = Callable[[float, str], None]
"""A function that gets the progress of a benchmark: the completed fraction, and the current step."""


@dataclass(frozen=True, slots=True)
class Options:
    """Options of all benchmarks."""

    quick: bool = False
    """Use few repetitions: the benchmarks run, but the figures are not precise."""
    folder: Path | None = None
    """Folder of the pages and plots; None if none are written."""

    def few(self, many: int, few: int) -> int:
        """Return `few` in a quick run, otherwise `many`."""
        return few if self.quick else many


@dataclass(frozen=True, slots=True)
class Table:
    """A table of texts with a caption."""

    caption: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]

    def markdown(self) -> str:
        """Return the table in Markdown; all columns except the first are aligned to the right."""
        rule = "| --- |" + " ---: |" * (len(self.columns) - 1)
        lines = [filled(self.caption), "", "| " + " | ".join(self.columns) + " |", rule]
        return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in self.rows)])

    def rich(self) -> RichTable:
        """Return the table for the terminal."""
        table = RichTable(title=self.caption, title_justify="left", title_style="", expand=False)
        for index, column in enumerate(self.columns):
            table.add_column(column, justify="right" if index else "left")
        for row in self.rows:
            table.add_row(*row)
        return table


def filled(text: str) -> str:
    """Return a paragraph in lines of at most 120 columns, as on the other pages."""
    return textwrap.fill(text, 120, break_long_words=False, break_on_hyphens=False)


@dataclass(slots=True)
class Section:
    """The results of one benchmark: paragraphs and tables, in order."""

    title: str
    parts: list[str | Table] = field(default_factory=list)

    def body(self) -> str:
        """Return the section in Markdown without its title."""
        return "\n\n".join(filled(part) if isinstance(part, str) else part.markdown() for part in self.parts)

    def markdown(self) -> str:
        """Return the section in Markdown with its title."""
        return f"## {self.title}\n\n{self.body()}"

    def show(self, console: Console) -> None:
        """Print the section on the terminal."""
        console.print(f"\n[bold]{self.title}[/bold]")
        for part in self.parts:
            console.print(part if isinstance(part, str) else part.rich(), markup=False, highlight=False)


def between(advance: Advance, begin: float, end: float, what: str) -> Callable[[float], None]:
    """Return a function for the progress of a step, which takes the benchmark from `begin` to `end`."""
    return lambda fraction: advance(begin + (end - begin) * fraction, what)


def spread(values: Sequence[float] | Floats, form: str = ".3g", scale: float = 1.0) -> str:
    """Return the median, and in brackets the tenth and ninetieth percentile, as text."""
    low, middle, high = np.percentile(np.asarray(values, dtype=np.float64) * scale, [10, 50, 90])
    return f"{middle:{form}} ({low:{form}} to {high:{form}})"


def verdict(value: float, aim: float, *, above: bool = False) -> str:
    """Return as text whether a value reaches its aim: at most `aim`, or with `above` more than it."""
    return "yes" if (value > aim if above else value <= aim) else "**no**"


def machine() -> str:
    """Return a paragraph about this machine."""
    info = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    model = re.search(r"model name\s*:\s*(.*)", info)
    virtual = "hypervisor" in info
    family = re.search(r"cpu family\s*:\s*(\d+)", info)
    load = " ".join(f"{value:.2f}" for value in os.getloadavg())
    return (
        f"{model.group(1) if model else platform.machine()} (family {family.group(1) if family else '?'}), "
        f"{os.cpu_count()} cores{' of a virtual machine' if virtual else ''}, Linux {platform.release().split('-')[0]} "
        f"({'PREEMPT_RT' if 'PREEMPT_RT' in platform.version() else 'no PREEMPT_RT'}), "
        f"Python {platform.python_version()}; load averages at the start {load}."
    )
