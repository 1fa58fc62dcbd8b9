"""Random orders of trials and of the stimuli in them, from a seed.

The random generator is PCG64, seeded by (seed, participant, session). All allowed orders are equally likely.
"""

from __future__ import annotations

import hashlib
import re
from collections import defaultdict
from collections.abc import Hashable, Sequence
from typing import Final, Literal, TypeAlias

import numpy as np

OrderKind: TypeAlias = Literal["random", "blocked", "latin_square", "listed"]

_SEED_WORDS_PER_NAME: Final = 4
"""Number of 32-bit words of a participant's hashed name in the seed."""
_LATIN_SQUARE_SALT: Final = b"latin square"
"""Replaces the participant's name in the seed: all participants share a Latin square."""


def generator_of(seed: int, participant: str, session: int) -> np.random.Generator:
    """Return the random generator of a session. Equal arguments give the same orders."""
    return _generator(seed, participant.encode(), session)


def _generator(seed: int, name: bytes, number: int) -> np.random.Generator:
    words = np.frombuffer(hashlib.sha256(name).digest()[: 4 * _SEED_WORDS_PER_NAME], dtype="<u4")
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, *map(int, words), number])))


def participant_number(participant: str) -> int | None:
    """Return the number at the end of a participant's name, such as 7 for P07, or None without digits."""
    found = re.search(r"[0-9]{1,9}$", participant)
    return int(found[0]) if found else None


def williams_rows(count: int) -> int:
    """Return the number of rows of a Williams design for `count` treatments: `count` if even or 1, else twice that."""
    return count if count % 2 == 0 or count == 1 else 2 * count


def williams_row(count: int, row: int) -> list[int]:
    """Return row `row` of a Williams design, which is an order of the treatments 0 to count - 1.

    Over all rows each treatment is at each position equally often, and follows each other treatment equally often
    (Williams, "Experimental designs balanced for the estimation of residual effects of treatments", Aust. J. Sci. Res.
    A 2, 1949). Row 0 is 0, n-1, 1, n-2, ... for n treatments. Row k adds k to each treatment of row 0, modulo n. If n
    is odd, the rows from n on are the rows before them, reversed.
    """
    shift, backwards = row % count, row % williams_rows(count) >= count
    first = [(position + 1) // 2 if position % 2 == 0 else count - (position + 1) // 2 for position in range(count)]
    found = [(treatment + shift) % count for treatment in first]
    return found[::-1] if backwards else found


def latin_order(count: int, seed: int, participant: str, session: int) -> list[int]:
    """Return the treatments 0 to count - 1 in the order for a session, a row of a Williams design.

    Participants whose names end in consecutive numbers get consecutive rows, and so do consecutive sessions. A name
    without a number gets a random row. Which treatment is which symbol of the design depends on seed and count only.
    """
    symbols = _generator(seed, _LATIN_SQUARE_SALT, count).permutation(count)
    rows = williams_rows(count)
    number = participant_number(participant)
    if number is None:
        number = int(_generator(seed, _LATIN_SQUARE_SALT + participant.encode(), 0).integers(rows))
    return [int(symbols[treatment]) for treatment in williams_row(count, (number + session) % rows)]


def blocks_of(
    keys: Sequence[Hashable], kind: OrderKind, generator: np.random.Generator, square: Sequence[int] = ()
) -> list[list[int]]:
    """Return the blocks of a session in their order, each as a list of trials (indices of `keys`).

    `keys` has the condition, cell or repetition of each trial. For the kinds `blocked` and `latin_square`, trials with
    equal keys make a block. For `latin_square`, `square` is the order of the blocks, numbered by first appearance.
    Within a block all orders are equally likely, except for `listed`, which keeps the order.
    """
    if kind == "listed":
        return [list(range(len(keys)))]
    if kind == "random":
        return [shuffled(range(len(keys)), generator)]
    groups: dict[Hashable, list[int]] = {}
    for index, key in enumerate(keys):
        groups.setdefault(key, []).append(index)
    found = [shuffled(group, generator) for group in groups.values()]
    order = square if kind == "latin_square" else shuffled(range(len(found)), generator)
    return [found[block] for block in order]


def shuffled(items: Sequence[int], generator: np.random.Generator) -> list[int]:
    """Return the items in a random order; all orders are equally likely."""
    return [int(each) for each in generator.permutation(np.asarray(items, dtype=np.int64))]


def interleaved(counts: Sequence[int], generator: np.random.Generator) -> list[int]:
    """Return the order in which adaptive procedures get trials: procedure `index` occurs `counts[index]` times.

    The order consists of rounds. A round has each procedure that has trials left once, in random order.
    """
    found: list[int] = []
    for turn in range(max(counts, default=0)):
        found += shuffled([index for index, count in enumerate(counts) if turn < count], generator)
    return found


def sides(pairs: Sequence[tuple[int, int]], generator: np.random.Generator) -> list[bool]:
    """Return for each pair of stimuli, one per trial, whether its order is reversed.

    Equal pairs have both orders equally often, give or take one trial. Each stimulus is first as often as second, give
    or take one trial, without pairs of a stimulus with itself. Both orders of a pair are equally likely.
    """
    copies: dict[tuple[int, int], list[int]] = defaultdict(list)
    for index, (one, other) in enumerate(pairs):
        copies[min(one, other), max(one, other)].append(index)
    found = [False] * len(pairs)
    single: list[tuple[int, int, int]] = []
    for (low, high), indices in copies.items():
        if low == high:
            continue
        mixed = shuffled(indices, generator) if len(indices) > 1 else indices
        half = len(mixed) // 2
        for index in mixed[:half]:
            found[index] = pairs[index][0] == low
        for index in mixed[half : 2 * half]:
            found[index] = pairs[index][0] != low
        if len(mixed) % 2:
            single.append((low, high, mixed[-1]))
    for index, first in _balanced_directions(single, generator):
        found[index] = pairs[index][0] != first
    return found


def _balanced_directions(
    edges: Sequence[tuple[int, int, int]], generator: np.random.Generator
) -> list[tuple[int, int]]:
    """Give each edge (one, other, id) of a graph a direction, and return (id, first vertex) of each.

    An edge is a pair of stimuli. Each vertex is first as often as second, give or take one edge, because the directions
    follow Euler circuits. Vertices of odd degree are connected to an auxiliary vertex, whose edges are left out.
    """
    if not edges:
        return []
    joint = -1
    mixed = [edges[index] for index in shuffled(range(len(edges)), generator)]
    degree: dict[int, int] = defaultdict(int)
    for one, other, _ in mixed:
        degree[one] += 1
        degree[other] += 1
    added = [(joint, vertex, -1) for vertex, count in degree.items() if count % 2]
    everything = [*mixed, *added]
    at: dict[int, list[int]] = defaultdict(list)
    for number, (one, other, _) in enumerate(everything):
        at[one].append(number)
        at[other].append(number)
    flip = bool(generator.integers(2))
    used = [False] * len(everything)
    found: list[tuple[int, int]] = []
    # All degrees are even, so a walk ends where it began, and enters each vertex as often as it leaves it.
    for start in list(at):
        here = start
        while at[here]:
            number = at[here].pop()
            if used[number]:
                continue
            used[number] = True
            one, other, id = everything[number]
            there = other if here == one else one
            if id >= 0:
                found.append((id, there if flip else here))
            here = there
    return found


def target_positions(counts: Sequence[int], alternatives: int, generator: np.random.Generator) -> list[list[int]]:
    """Return the positions of the target, 0 to alternatives - 1, in the `counts[cell]` trials of each cell.

    In each cell, and in all cells together, the positions are equally frequent, give or take one trial.
    """
    cycle = shuffled(range(alternatives), generator)
    found: list[list[int]] = [[] for _ in counts]
    dealt = 0
    for cell in shuffled(range(len(counts)), generator):
        given = [cycle[(dealt + index) % alternatives] for index in range(counts[cell])]
        dealt += counts[cell]
        found[cell] = shuffled(given, generator)
    return found


def track_positions(count: int, alternatives: int, generator: np.random.Generator) -> list[int]:
    """Return the positions of the target, 0 to alternatives - 1, in the `count` trials of a procedure.

    Each group of 4 * alternatives successive trials has each position 4 times. A procedure that ends early is therefore
    nearly balanced.
    """
    found: list[int] = []
    while len(found) < count:
        found += shuffled([position for position in range(alternatives) for _ in range(4)], generator)
    return found[:count]
