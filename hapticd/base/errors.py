"""Errors that a user can cause, and helpers for their texts.

Every message is one line that says where the error is, what is wrong and what would be right. A traceback that a user
sees is a defect.
"""

import difflib
import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

Path: TypeAlias = tuple[str | int, ...]
"""A place in a document: keys and list indices, from the root down."""

_MAX_SHOWN_CHARACTERS = 60
"""Length to which a text is cut in messages."""
_MAX_SHOWN_NAMES = 20
"""Largest number of known names that a message lists."""
_MAX_COMPARED_NAMES = 64
"""In a longer list of known names, similar names are not searched: each costs a comparison."""
MAX_SHOWN_PROBLEMS = 50
"""Largest number of faults that a message lists; the others are counted."""
_LOCATION_PATTERN = re.compile(r"(.+?):(\d+):(\d+)(?:: |$)")
"""FILE:LINE:COLUMN at the beginning of `Problem.where`."""


class HapticdError(Exception):
    """An error that a user can correct; its text is one line: where it is, what is wrong, what would be right."""


@dataclass(frozen=True, slots=True)
class Problem:
    """One fault: where it is, with file and line if known, and what is wrong there."""

    where: str
    problem: str

    def __str__(self) -> str:
        return f"{self.where}: {self.problem}" if self.where else self.problem


class InvalidError(HapticdError):
    """Error for invalid input; `problems` holds every fault that was found, sorted by file and line."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = in_order(problems)
        super().__init__(self.problems)

    def __str__(self) -> str:
        return "; ".join(lines_of(self.problems))


def in_order(problems: Iterable[Problem]) -> tuple[Problem, ...]:
    """Sort faults by file, line and column. Faults without a file come first, in the given order."""

    def place(problem: Problem) -> tuple[str, int, int]:
        found = _LOCATION_PATTERN.match(problem.where)
        return (found[1], int(found[2]), int(found[3])) if found else ("", 0, 0)

    return tuple(sorted(problems, key=place))


def lines_of(problems: Sequence[Problem]) -> list[str]:
    """Return a line for each of the first 50 faults, and a line with the number of the others."""
    hidden = len(problems) - MAX_SHOWN_PROBLEMS
    return [*map(str, problems[:MAX_SHOWN_PROBLEMS]), *([f"and {hidden} more"] if hidden > 0 else [])]


def collapse_whitespace(text: str) -> str:
    """Replace each run of white space of a text, line breaks included, by one space."""
    return " ".join(text.split())


def quoted(text: str) -> str:
    """Return `text` in double quotes on one line, cut after 60 characters, with unprintable characters escaped."""
    if len(text) > _MAX_SHOWN_CHARACTERS:
        text = text[:_MAX_SHOWN_CHARACTERS] + "..."
    return json.dumps(text, ensure_ascii=not text.isprintable())


def shown_name(text: str) -> str:
    """Return a name in quotation marks, shortened to one line."""
    return f"'{text}'" if short_name(text) == text else quoted(text)


def short_name(name: str) -> str:
    """Return a name; a long or unprintable one is shortened and quoted."""
    return name if name.isprintable() and len(name) <= 60 else quoted(name)


def shown(value: object) -> str:
    """Return a value as messages show it: scalars as YAML writes them, collections by their kind."""
    match value:
        case None:
            return "null"
        case bool():
            return "true" if value else "false"
        case int():
            bits = value.bit_length()
            return f"{int(value)}" if bits <= 64 else f"an integer of {bits} bits"
        case float():
            return repr(float(value))
        case str():
            return quoted(value)
        case dict():
            return "a mapping"
        case list() | tuple():
            return "a list"
        case _:
            return f"a Python object of type {type(value).__name__}"


def path_text(path: Sequence[str | int]) -> str:
    """Return a path as messages write it: `scene.objects.table.point_m[0]`. Keys with punctuation are quoted."""
    text = ""
    for element in path:
        if isinstance(element, int):
            text += f"[{element}]"
        else:
            odd = not element.isprintable() or not 0 < len(element) <= 64 or set(element) & set('."[]:; ')
            text += ("." if text else "") + (quoted(element) if odd else element)
    return text


def path_of_text(text: str) -> Path:
    """Return the path (keys and indices) that `path_text` writes as `text`."""
    parts = re.findall(r'"(?:[^"\\]|\\.)*"|\[\d+\]|[^.\[\]"]+', text)
    return tuple(json.loads(part) if part[0] == '"' else int(part[1:-1]) if part[0] == "[" else part for part in parts)


def known_names(name: str, known: Iterable[str]) -> str:
    """Return advice on an unknown name: "did you mean wood?", or without a similar name "known: wood, steel"."""
    names = list(known)
    close = near_names(name, names, 1)
    if close:
        return f"did you mean {close[0]}?"
    listed = ", ".join(names[:_MAX_SHOWN_NAMES]) + (", ..." if len(names) > _MAX_SHOWN_NAMES else "")
    return f"known: {listed or 'none'}"


def near_names(name: str, known: Sequence[str], max_count: int) -> list[str]:
    """Return at most `max_count` known names that are similar to `name`, the most similar first; case is ignored."""
    if len(name) > 2 * _MAX_SHOWN_CHARACTERS or len(known) > _MAX_COMPARED_NAMES:
        return []
    folded = {each.casefold(): each for each in known}
    return [folded[near] for near in difflib.get_close_matches(name.casefold(), folded, n=max_count)]
