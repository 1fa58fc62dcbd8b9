"""What the fuzzers share: values that tend to break things, and trees of plain data that are almost right."""

from __future__ import annotations

import math
import random
import signal
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, TypeAlias

Tree: TypeAlias = Any
"""None, bool, numbers, strings, lists, and dicts by string."""

NUMBERS: tuple[int | float, ...] = (
    *(0, 1, -1, 2, 7, 255, 1000, 65536),
    *(2**31 - 1, 2**31, 2**32 - 1, 2**32, 2**53 + 1, 2**63 - 1, -(2**63), 2**63, 2**64 - 1),
    *(0.0, -0.0, 0.5, 1e-9, 1e5, -1e5, 1e16, math.nextafter(1.0, 2.0)),
    *(1e-300, 5e-324, 2.2250738585072014e-308, 1e300, 1e308, -1e308, 1.7976931348623157e308),
    *(math.inf, -math.inf, math.nan),
)
"""Whole ones, powers of two, fractions, the ends of what a float holds."""
STRINGS: tuple[str, ...] = (
    *("", " ", "0", "1e5", "nan", "true", "null", "~"),
    *("wood", "steel", "wall", "floor", "kind", "a.b", "__class__"),
    *("a\nb", "\x00", "\x1b[2J", "\u2028", "\ufeff", "\u202e", "\U0001f600", "e\u0301"),
    *("../../etc/passwd", "%s%n{0}", "'\"`$(id)", ": - [", "x" * 64, "x" * 65),
)
"""Other kinds of values, names of ours, characters, what others take for code."""
KEYS: tuple[str, ...] = (
    *("kind", "material", "normal", "point_m", "objects", "scene", "materials", "patches", "texture", "tap"),
    *("rupture", "friction", "stiffness_n_per_m", "frequency_hz", "decay_time_s", "display", "wait"),
    *("expect_revision", "unknown", "", "__proto__", "Kind"),
)


def number(source: random.Random) -> int | float:
    """Any number: of the edges, of a magnitude, of bits."""
    choice = source.random()
    if choice < 0.6:
        return source.choice(NUMBERS)
    if choice < 0.8:
        return source.choice((1, -1)) * 10.0 ** source.uniform(-12, 12)
    if choice < 0.9:
        return source.randrange(-300, 300)
    found: float = struct.unpack("<d", source.randbytes(8))[0]
    return found


def text(source: random.Random) -> str:
    """A short string."""
    if source.random() < 0.8:
        return source.choice(STRINGS)
    return "".join(chr(source.choice((source.randrange(128), source.randrange(0xD800)))) for _ in range(5))


def value(source: random.Random, depth: int = 0) -> Tree:
    """Any small value."""
    choice = source.randrange(12 if depth < 3 else 9)
    if choice < 4:
        return number(source)
    if choice < 7:
        return text(source)
    if choice < 8:
        return source.choice((True, False))
    if choice < 9:
        return None
    if choice < 10:
        return [value(source, depth + 1) for _ in range(source.randrange(4))]
    return {source.choice(KEYS): value(source, depth + 1) for _ in range(source.randrange(4))}


def places(tree: Tree) -> list[tuple[Tree, str | int]]:
    """Every place below the root: what holds it, and its key or index there."""
    found: list[tuple[Tree, str | int]] = []
    pending = [tree]
    while pending:
        here = pending.pop()
        for key in here if type(here) is dict else range(len(here)):
            found.append((here, key))
            kind = type(here[key])
            if kind is dict or kind is list:
                pending.append(here[key])
    return found


def _nudged(source: random.Random, old: int | float) -> int | float:
    """A number near another one, or of another kind; whole numbers have 64 bits at most."""
    match source.randrange(7):
        case 0:
            return _whole(-old)
        case 1:
            return _whole(old * source.choice((10, 1000, 1e-3, 1e6)))
        case 2:
            return float(old)
        case 3:
            return math.nextafter(old, source.choice((math.inf, -math.inf)))
        case 4:
            return _whole(int(old)) if abs(old) < 1e18 else 0
        case 5:
            return _whole(old + source.choice((1, -1, 1e-9)))
        case _:
            return old * source.uniform(0, 2)


def _whole(number: int | float) -> int | float:
    return number if type(number) is float or -(2**63) <= number < 2**64 else float(number)


def mutate(source: random.Random, tree: Tree, graft: Callable[[], Tree] | None = None) -> None:
    """Changes one place of a tree that is a dict or a list; `graft` gives parts of other trees."""
    found = places(tree)
    if not found:
        if type(tree) is dict:
            tree[source.choice(KEYS)] = value(source)
        else:
            tree.append(value(source))
        return
    holder, key = source.choice(found)
    old = holder[key]
    choice = source.randrange(14)
    if choice < 3:
        holder[key] = value(source)
    elif choice < 6:
        if type(old) is int or type(old) is float:
            holder[key] = _nudged(source, old) if source.random() < 0.6 else number(source)
        else:
            holder[key] = number(source) if source.random() < 0.3 else text(source)
    elif choice == 6:
        del holder[key]
    elif choice == 7:
        if type(holder) is dict:
            holder[source.choice(KEYS) if source.random() < 0.7 else text(source)] = value(source)
        else:
            holder.insert(int(key), value(source))
    elif choice == 8:
        if type(holder) is dict:  # a slip of the pen
            name = str(key)
            at = source.randrange(len(name) + 1)
            holder[name[:at] + source.choice(("", "x", "_", name[at : at + 1] * 2)) + name[at + 1 :]] = holder.pop(key)
        else:
            holder.append(old)
    elif choice == 9:
        holder[key] = [old] if source.random() < 0.5 else {source.choice(KEYS): old}
    elif choice == 10:
        other, there = source.choice(found)
        if not _holds(old, other) and not _holds(other[there], holder):
            holder[key], other[there] = other[there], old
    elif choice == 11 and graft is not None:
        holder[key] = graft()
    elif choice == 12 and type(old) is str and old:
        at = source.randrange(len(old))
        holder[key] = source.choice((old[:at], old[:at] + text(source) + old[at:], old.upper(), old * 3))
    else:
        holder[key] = source.choice((True, False, None))


def _holds(tree: Tree, part: Tree) -> bool:
    """Whether `part` is this tree or lies in it: a swap would make a ring."""
    if tree is part:
        return True
    if type(tree) is not dict and type(tree) is not list:
        return False
    return any(_holds(below, part) for below in (tree.values() if type(tree) is dict else tree))


def nested(source: random.Random, depth: int) -> Tree:
    """Lists and maps one in the other, so deep."""
    tree: Tree = source.choice((1, "x", None))
    for _ in range(depth):
        tree = [tree] if source.random() < 0.5 else {"kind": tree}
    return tree


class HangError(Exception):
    """Something took longer than it may."""


@contextmanager
def hangs_after(limit_s: float) -> Iterator[Callable[[], None]]:
    """Has HangError raised in this thread once it has used so much processor time; what is yielded begins anew."""

    def raise_it(_: int, __: FrameType | None) -> None:
        raise HangError(f"more than {limit_s:g} s of processor time")

    before = signal.signal(signal.SIGVTALRM, raise_it)
    try:
        yield lambda: signal.setitimer(signal.ITIMER_VIRTUAL, limit_s) and None
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        signal.signal(signal.SIGVTALRM, before)
