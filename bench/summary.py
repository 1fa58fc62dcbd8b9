"""The summary at the top of docs/accuracy.md: the largest error of each kind, read from the tables of the page."""

from __future__ import annotations

import re

Rows = list[list[str]]


def with_summary(page: str) -> str:
    """Return the page with the summary of its tables in front of its first section."""
    head, *sections = re.split(r"^(?=## )", page, flags=re.MULTILINE)
    about = head.partition("\n| ")[0].strip()
    lines = ["| largest error of | error | cost, or what changes it |", "| --- | ---: | --- |"]
    lines += [f"| {' | '.join(row)} |" for row in _rows(page)]
    return "\n\n".join([about, "\n".join(lines), "".join(sections)])


def _tables(page: str) -> dict[str, Rows]:
    """Return the rows of each table, without the rule, by the caption above it."""
    found = re.findall(r"^((?:[^|#\n].*\n)+)\n((?:\|.*\n)+)", page, flags=re.MULTILINE)
    tables = {caption: [line[2:-2].split(" | ") for line in lines.splitlines()] for caption, lines in found}
    return {" ".join(caption.split()): [rows[0], *rows[2:]] for caption, rows in tables.items()}


def _number(cell: str) -> float:
    found = re.match(r"-?[\d.]+", cell)
    return float(found[0]) if found else float("-inf")


def _rows(page: str) -> Rows:
    tables = _tables(page)

    def largest(caption: str, column: str, row: str = "") -> str:
        """Return the cell with the largest first number, of all tables, columns and rows that the patterns match."""
        cells = [
            line[place]
            for text, rows in tables.items()
            if re.search(caption, text)
            for line in rows[1:]
            if re.search(row, line[0])
            for place, name in enumerate(rows[0])
            if re.search(column, name) and place
        ]
        if not cells:
            raise ValueError(f"no cell of {caption!r}, {column!r}, {row!r}")
        return max(cells, key=_number)

    def on_a_wall(what: str, unit: str, column: str) -> list[str]:
        cells = [
            largest(caption, column, f"^{rate}$").replace(" ", f" {unit} ", 1)
            for caption, rate in (("^K(?!.* old).*peaks", 10000), ("^K(?!.* old).*peaks", 1000), (" tick old", 10000))
        ]
        return [
            f"a wall's {what}, 10000 Hz",
            cells[0],
            f"1000 Hz: {cells[1]}; reports one tick old, 800 N/m: {cells[2]}",
        ]

    grips, wall, trials = "grip .*displayed error", "^On a wall of", "^Trials by verdict"
    safe, rest = largest(trials, "^trials$", "^safe$"), largest(trials, "^rest$", "^safe$")
    energies, fitted, strokes = "^Largest energy", "^Median error, %", "^Strokes and punctures"
    return [
        on_a_wall("force", "mN", "^error of the force"),
        on_a_wall("penetration", "um", "^of the penetration"),
        [
            "a tap's acceleration without contact, `full`",
            f"{largest(grips, '^full$')} %",
            f"forces for up to {largest(grips, '^tail$')} after the onset; `off`: {largest(grips, '^off$')} %",
        ],
        [
            "a tap's acceleration on a wall, `full`",
            f"{largest(wall, ': full$|: any onset$')} %",
            f"if the wall is left out: {largest(wall, ': wall left out$')} %",
        ],
        [
            "the verdict *safe*: trials that do not come to rest",
            f"{int(safe) - int(rest)} of {safe}",
            ", ".join(f"{name}: {largest(trials, name, '^safe$')}" for name in ("still falling", "cycle", "grow")),
        ],
        [
            "the energy of a contact, `control`, over its [bound](passivity.md)",
            f"{largest(energies, '^worst / F v .T . a.$', 'control$')}",
            f"`off`: {largest(energies, '^worst / F v .T . a.$', 'off$')}; "
            f"`control` costs {largest('^ns a tick', '^control - off$').split()[0]} ns a tick",
        ],
        [
            "a fitted tap, median",
            f"{largest(fitted, '.').split()[0]} %",
            f"slope: {largest(fitted, '^slope$').split()[0]} %; "
            f"frequency: {largest(fitted, '^frequency$').split()[0]} %",
        ],
        [
            "a fitted stroke or puncture, median",
            f"{largest(strokes, '^median error')} %",
            f"grooves: {largest(strokes, '^median error', 'grooves')} %; "
            f"punctures: {largest(strokes, '^median error', 'puncture')} %",
        ],
    ]
