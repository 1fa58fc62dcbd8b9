"""What a program passes to a client, checked before anything is sent: a mistake is one line, not a traceback.

What the daemon validates itself is left to it. Here is what would not get so far, or would wait for ever.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping
from typing import Any

from hapticd.base.codec import MAX_DEPTH
from hapticd.base.errors import InvalidError, Path, Problem, known_names, path_text, shown


def wrong(where: str, problem: str) -> InvalidError:
    """One argument that is wrong."""
    return InvalidError([Problem(where, problem)])


def seconds(name: str, value: object, *, zero: bool = False) -> float:
    """A time in s, more than 0 unless `zero` may be; infinity is none. Raises InvalidError."""
    number = _number(value)
    if number is None or not 0 <= number < math.inf or (number == 0 and not zero):
        least = "of at least 0" if zero else "of more than 0"
        raise wrong(name, f"must be a number of seconds {least}, is {shown(value)}")
    return number


def within(name: str, value: object, most: float, unit: str) -> float:
    """A number from -`most` to `most`. Raises InvalidError."""
    number = _number(value)
    if number is None or not -most <= number <= most:
        raise wrong(name, f"must be a number from {-most:g} to {most:g} {unit}, is {shown(value)}")
    return number


def flag(name: str, value: object) -> bool:
    """True or False, numpy's too."""
    made = value.tolist() if hasattr(value, "tolist") else value
    if not isinstance(made, bool):
        raise wrong(name, f"must be True or False, is {shown(value)}")
    return made


def path(name: str, value: object) -> str:
    """The path of a file or a folder."""
    if not isinstance(value, str | os.PathLike):
        raise wrong(name, f"must be a path, is {shown(value)}")
    found = os.fspath(value)
    if not isinstance(found, str) or not found or "\0" in found:
        raise wrong(name, f"must be a path, is {shown(found) if found else 'empty'}")
    return found


def mapping(name: str, value: object) -> dict[str, object]:
    """A mapping whose keys are texts."""
    if not isinstance(value, Mapping):
        raise wrong(name, f"must be a mapping, is {shown(value)}")
    return dict(value)


def numbers(name: str, value: object) -> list[float]:
    """A list, a tuple or a numpy array of numbers."""
    found = []
    for place, each in enumerate(_items(name, value, "numbers")):
        number = _number(each)
        if number is None:
            raise wrong(f"{name}[{place}]", f"must be a number, is {shown(each)}")
        found.append(number)
    return found


def rows(name: str, value: object) -> list[list[float]]:
    """A list of lists of numbers, or a numpy array of two dimensions."""
    return [numbers(f"{name}[{place}]", each) for place, each in enumerate(_items(name, value, "lists of numbers"))]


def texts(name: str, value: object) -> list[str]:
    """A list of texts; a text alone is taken for a mistake."""
    found = []
    for place, each in enumerate(_items(name, value, "texts")):
        if not isinstance(each, str):
            raise wrong(f"{name}[{place}]", f"must be a text, is {shown(each)}")
        found.append(each)
    return found


def one_of(name: str, value: object, known: Iterable[str]) -> None:
    """Raises InvalidError for what is none of the names that there are."""
    names = tuple(known)
    if not isinstance(value, str) or value not in names:
        raise wrong(name, f"unknown {name} {shown(value)}; {known_names(str(value), names)}")


def plain(where: Path, value: object) -> Any:
    """`value` as JSON can hold it, its types kept: numpy's numbers and arrays become Python's, a tuple a list.

    Raises InvalidError, with the place of what JSON cannot hold.
    """
    if len(where) > MAX_DEPTH:
        raise wrong(path_text(where[:1]), f"must not be nested deeper than {MAX_DEPTH}")
    match value:
        case None | bool():
            return value
        case str():
            if not _is_utf8(value):
                raise wrong(path_text(where), f"must be text that UTF-8 can hold, is {shown(value)}")
            return value
        case int():
            if not -(2**63) <= value < 2**64:
                raise wrong(path_text(where), f"must be a whole number of at most 64 bits, is {shown(value)}")
            return int(value)
        case float():
            if not math.isfinite(value):
                raise wrong(path_text(where), f"must be finite, is {float(value)}")
            return float(value)
        case Mapping():
            for key in value:
                if not isinstance(key, str) or not _is_utf8(key):
                    raise wrong(path_text(where), f"must have texts as keys, has {shown(key)}")
            return {str(key): plain((*where, key), inner) for key, inner in value.items()}
        case list() | tuple():
            return [plain((*where, place), inner) for place, inner in enumerate(value)]
    tolist = getattr(value, "tolist", None)  # numpy's scalars and arrays
    made = None if tolist is None else tolist()
    if made is None or isinstance(made, type(value)):
        raise wrong(path_text(where), f"must be what JSON can hold, is {shown(value)}")
    return plain(where, made)


def _is_utf8(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def _items(name: str, value: object, what: str) -> list[object]:
    if isinstance(value, str | bytes | Mapping) or not isinstance(value, Iterable):
        raise wrong(name, f"must be a list of {what}, is {shown(value)}")
    return list(value)


def _number(value: object) -> float | None:
    """numpy's numbers are numbers, too; texts and truth values are none."""
    if isinstance(value, bool | str | bytes) or not hasattr(value, "__float__"):
        return None
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return None
