"""Checks of arguments that a program passes to a client, before anything is sent.

They find values that cannot be encoded, or would make the client wait for ever. The daemon validates the rest.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping
from typing import Any

from hapticd.base.codec import MAX_DEPTH
from hapticd.base.errors import InvalidError, Path, Problem, known_names, path_text, shown


def invalid_argument(where: str, problem: str) -> InvalidError:
    """Return the error for one invalid argument."""
    return InvalidError([Problem(where, problem)])


def seconds(name: str, value: object, *, zero: bool = False) -> float:
    """Check that a value is a finite time in s above 0 (with `zero` also 0), and return it. Raises InvalidError."""
    number = _number(value)
    if number is None or not 0 <= number < math.inf or (number == 0 and not zero):
        limit = "of at least 0" if zero else "of more than 0"
        raise invalid_argument(name, f"must be a number of seconds {limit}, is {shown(value)}")
    return number


def within(name: str, value: object, limit: float, unit: str) -> float:
    """Check that a value is a number from -`limit` to `limit`, and return it as float. Raises InvalidError."""
    number = _number(value)
    if number is None or not -limit <= number <= limit:
        raise invalid_argument(name, f"must be a number from {-limit:g} to {limit:g} {unit}, is {shown(value)}")
    return number


def flag(name: str, value: object) -> bool:
    """Check that a value is a boolean of Python or numpy, and return it as bool. Raises InvalidError."""
    made = value.tolist() if hasattr(value, "tolist") else value
    if not isinstance(made, bool):
        raise invalid_argument(name, f"must be True or False, is {shown(value)}")
    return made


def path(name: str, value: object) -> str:
    """Check that a value is a path, and return it as text. Raises InvalidError, also for an empty path."""
    if not isinstance(value, str | os.PathLike):
        raise invalid_argument(name, f"must be a path, is {shown(value)}")
    found = os.fspath(value)
    if not isinstance(found, str) or not found or "\0" in found:
        raise invalid_argument(name, f"must be a path, is {shown(found) if found else 'empty'}")
    return found


def mapping(name: str, value: object) -> dict[str, object]:
    """Check that a value is a mapping, and return it as a dict. Raises InvalidError."""
    if not isinstance(value, Mapping):
        raise invalid_argument(name, f"must be a mapping, is {shown(value)}")
    return dict(value)


def numbers(name: str, value: object) -> list[float]:
    """Check that a value is a list, a tuple or an array of numbers, and return it as a list. Raises InvalidError."""
    found = []
    for place, each in enumerate(_items(name, value, "numbers")):
        number = _number(each)
        if number is None:
            raise invalid_argument(f"{name}[{place}]", f"must be a number, is {shown(each)}")
        found.append(number)
    return found


def rows(name: str, value: object) -> list[list[float]]:
    """Check that a value is a list of lists of numbers or a 2-D array, and return it as lists. Raises InvalidError."""
    return [numbers(f"{name}[{place}]", each) for place, each in enumerate(_items(name, value, "lists of numbers"))]


def texts(name: str, value: object) -> list[str]:
    """Check that a value is a list of strings, and return it. Raises InvalidError, also for a single string."""
    found = []
    for place, each in enumerate(_items(name, value, "strings")):
        if not isinstance(each, str):
            raise invalid_argument(f"{name}[{place}]", f"must be a string, is {shown(each)}")
        found.append(each)
    return found


def one_of(name: str, value: object, known: Iterable[str]) -> None:
    """Raise InvalidError unless `value` is one of the `known` names."""
    names = tuple(known)
    if not isinstance(value, str) or value not in names:
        raise invalid_argument(name, f"unknown {name} {shown(value)}; {known_names(str(value), names)}")


def plain(where: Path, value: object) -> Any:
    """Return `value` as plain data for JSON: numpy's numbers and arrays become Python's, a tuple becomes a list.

    Raises InvalidError with the path of a value that JSON does not have.
    """
    if len(where) > MAX_DEPTH:
        raise invalid_argument(path_text(where[:1]), f"must not be nested deeper than {MAX_DEPTH}")
    match value:
        case None | bool():
            return value
        case str():
            if not _is_utf8(value):
                raise invalid_argument(path_text(where), f"must be text that UTF-8 can encode, is {shown(value)}")
            return value
        case int():
            if not -(2**63) <= value < 2**64:
                raise invalid_argument(path_text(where), f"must be an integer of at most 64 bits, is {shown(value)}")
            return int(value)
        case float():
            if not math.isfinite(value):
                raise invalid_argument(path_text(where), f"must be finite, is {float(value)}")
            return float(value)
        case Mapping():
            for key in value:
                if not isinstance(key, str) or not _is_utf8(key):
                    raise invalid_argument(path_text(where), f"keys must be strings, this one is {shown(key)}")
            return {str(key): plain((*where, key), inner) for key, inner in value.items()}
        case list() | tuple():
            return [plain((*where, place), inner) for place, inner in enumerate(value)]
    tolist = getattr(value, "tolist", None)  # numpy's scalars and arrays
    made = None if tolist is None else tolist()
    if made is None or isinstance(made, type(value)):
        raise invalid_argument(path_text(where), f"must be a JSON value, is {shown(value)}")
    return plain(where, made)


def _is_utf8(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def _items(name: str, value: object, what: str) -> list[object]:
    if isinstance(value, str | bytes | Mapping) or not isinstance(value, Iterable):
        raise invalid_argument(name, f"must be a list of {what}, is {shown(value)}")
    return list(value)


def _number(value: object) -> float | None:
    """Return a number of Python or numpy as float; None for a string, a boolean or anything else."""
    if isinstance(value, bool | str | bytes) or not hasattr(value, "__float__"):
        return None
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return None
