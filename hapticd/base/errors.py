"""Errors that a user can cause, and the words that report them.

Every message is one line: what, where and what would be right. A traceback that a user sees is a defect.
"""

import difflib
import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

Path: TypeAlias = tuple[str | int, ...]
"""A place in a document: keys and list indices, from the root down."""

_SHOWN_CHARACTERS = 60
_SHOWN_NAMES = 20
_COMPARED_NAMES = 64
_SHOWN_PROBLEMS = 50
_PLACE = re.compile(r"(.+?):(\d+):(\d+)(?:: |$)")


class HapticdError(Exception):
    """Something a user can put right; `str` is one line that says what, where and what would be right."""


@dataclass(frozen=True, slots=True)
class Problem:
    """One fault: the place in the user's words, with file and line where known, and what is wrong."""

    where: str
    problem: str

    def __str__(self) -> str:
        return f"{self.where}: {self.problem}" if self.where else self.problem


class InvalidError(HapticdError):
    """What a person wrote is not valid; `problems` holds every fault found, by file and line."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = in_order(problems)
        super().__init__(self.problems)

    def __str__(self) -> str:
        return "; ".join(lines_of(self.problems))


def in_order(problems: Iterable[Problem]) -> tuple[Problem, ...]:
    """Faults by file, line and column; those without a file come first, in the order in which they were found."""

    def place(problem: Problem) -> tuple[str, int, int]:
        found = _PLACE.match(problem.where)
        return (found[1], int(found[2]), int(found[3])) if found else ("", 0, 0)

    return tuple(sorted(problems, key=place))


def lines_of(problems: Sequence[Problem]) -> list[str]:
    """What a person reads of faults, one a line: nobody reads hundreds."""
    hidden = len(problems) - _SHOWN_PROBLEMS
    return [*map(str, problems[:_SHOWN_PROBLEMS]), *([f"and {hidden} more"] if hidden > 0 else [])]


def on_one_line(text: str) -> str:
    """A text of others with a space for each line break and each run of white space."""
    return " ".join(text.split())


def quoted(text: str) -> str:
    """`text` in double quotes on one line, shortened, with everything unprintable escaped."""
    if len(text) > _SHOWN_CHARACTERS:
        text = text[:_SHOWN_CHARACTERS] + "..."
    return json.dumps(text, ensure_ascii=not text.isprintable())


def shown(value: object) -> str:
    """A value as a message shows it: scalars as YAML writes them, anything larger by its kind."""
    match value:
        case None:
            return "null"
        case bool():
            return "true" if value else "false"
        case int():
            bits = value.bit_length()
            return f"{int(value)}" if bits <= 64 else f"a whole number of {bits} bits"
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
    """A path as messages write it: `scene.objects.table.point_m[0]`; odd keys are quoted."""
    text = ""
    for element in path:
        if isinstance(element, int):
            text += f"[{element}]"
        else:
            odd = not element.isprintable() or not 0 < len(element) <= 64 or set(element) & set('."[]:; ')
            text += ("." if text else "") + (quoted(element) if odd else element)
    return text


def path_of_text(text: str) -> Path:
    """The path that path_text wrote."""
    parts = re.findall(r'"(?:[^"\\]|\\.)*"|\[\d+\]|[^.\[\]"]+', text)
    return tuple(json.loads(part) if part[0] == '"' else int(part[1:-1]) if part[0] == "[" else part for part in parts)


def known_names(name: str, known: Iterable[str]) -> str:
    """What would be right instead of an unknown name: 'did you mean wood?', or where nothing is near it 'known: wood,
    steel'."""
    names = list(known)
    close = near_names(name, names, 1)
    if close:
        return f"did you mean {close[0]}?"
    listed = ", ".join(names[:_SHOWN_NAMES]) + (", ..." if len(names) > _SHOWN_NAMES else "")
    return f"known: {listed or 'none'}"


def near_names(name: str, known: Sequence[str], most: int) -> list[str]:
    """The names that `name` may stand for, the nearest first; upper and lower case are one."""
    # Each name costs a comparison for each name; in a long list a person would look there.
    if len(name) > 2 * _SHOWN_CHARACTERS or len(known) > _COMPARED_NAMES:
        return []
    folded = {each.casefold(): each for each in known}
    return [folded[near] for near in difflib.get_close_matches(name.casefold(), folded, n=most)]
