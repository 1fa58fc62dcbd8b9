"""The order of trials and the sides of stimuli, from a seed; nothing here knows what is displayed.

The generator is PCG64, seeded by (seed, participant, session). Every order that the design allows is equally likely,
so that no stimulus is favoured by its place in the file.
"""

from __future__ import annotations

import hashlib
import re
from collections import defaultdict
from collections.abc import Hashable, Sequence
from typing import Final, Literal, TypeAlias

import numpy as np

OrderKind: TypeAlias = Literal["random", "blocked", "latin_square", "listed"]

_WORDS: Final = 4
"""Words of 32 bits that stand for a participant's name."""
_SQUARE: Final = b"latin square"


def generator_of(seed: int, participant: str, session: int) -> np.random.Generator:
    """The generator of one session: the same three give the same orders."""
    return _generator(seed, participant.encode(), session)


def _generator(seed: int, name: bytes, number: int) -> np.random.Generator:
    words = np.frombuffer(hashlib.sha256(name).digest()[: 4 * _WORDS], dtype="<u4")
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, *map(int, words), number])))


def participant_number(participant: str) -> int | None:
    """The digits that a participant's name ends with: 7 of P07; None without any."""
    found = re.search(r"[0-9]{1,9}$", participant)
    return int(found[0]) if found else None


def williams_rows(count: int) -> int:
    """How many rows a Williams design of so many treatments has: as many, or twice as many of an odd number."""
    return count if count % 2 == 0 or count == 1 else 2 * count


def williams_row(count: int, row: int) -> list[int]:
    """One row of a Williams design, treatments 0 to count - 1.

    Over all rows each treatment stands at each position equally often, and each follows each other one equally often
    (Williams, "Experimental designs balanced for the estimation of residual effects of treatments", Aust. J. Sci. Res.
    A 2, 1949). The first row is 0, n-1, 1, n-2, ...; the others add to it; of an odd number each is read backwards too.
    """
    shift, backwards = row % count, row % williams_rows(count) >= count
    first = [(position + 1) // 2 if position % 2 == 0 else count - (position + 1) // 2 for position in range(count)]
    found = [(treatment + shift) % count for treatment in first]
    return found[::-1] if backwards else found


def latin_order(count: int, seed: int, participant: str, session: int) -> list[int]:
    """Treatments 0 to count - 1 in the order of this participant and session.

    Participants whose names end in consecutive numbers get consecutive rows, and so do sessions; a name without a
    number gets a row at random. Which treatment stands for which symbol follows from the seed alone.
    """
    symbols = _generator(seed, _SQUARE, count).permutation(count)
    rows = williams_rows(count)
    number = participant_number(participant)
    if number is None:
        number = int(_generator(seed, _SQUARE + participant.encode(), 0).integers(rows))
    return [int(symbols[treatment]) for treatment in williams_row(count, (number + session) % rows)]


def blocks_of(
    keys: Sequence[Hashable], kind: OrderKind, generator: np.random.Generator, square: Sequence[int] = ()
) -> list[list[int]]:
    """Indices of `keys` in blocks, in the order of the session.

    Equal keys make a block, of `blocked` and `latin_square`; `square` is the order of the blocks of the latter, by
    number of their first appearance. Inside a block all orders are equally likely.
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
    """These numbers in an order of which all are equally likely."""
    return [int(each) for each in generator.permutation(np.asarray(items, dtype=np.int64))]


def interleaved(counts: Sequence[int], generator: np.random.Generator) -> list[int]:
    """Numbers of procedures, each as often as `counts` says: in rounds, each of which holds each procedure once that
    has trials left."""
    found: list[int] = []
    for turn in range(max(counts, default=0)):
        found += shuffled([index for index, count in enumerate(counts) if turn < count], generator)
    return found


def sides(pairs: Sequence[tuple[int, int]], generator: np.random.Generator) -> list[bool]:
    """Of each pair of stimuli whether it is presented the other way round.

    The same pair stands in either order equally often, or once more in one of them. Each stimulus stands first and
    second equally often, or once more in one of them, pairs with itself apart. Each order of a pair has the same
    probability.
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
    for index, first in _oriented(single, generator):
        found[index] = pairs[index][0] != first
    return found


def _oriented(edges: Sequence[tuple[int, int, int]], generator: np.random.Generator) -> list[tuple[int, int]]:
    """Edges (one, other, id) as (id, which comes first): along Euler circuits, so that each vertex comes first as
    often as second, or once more. Vertices of odd degree are joined through one that is then left out."""
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
    # A walk from a vertex of even degree ends where it began. So every walk passes each vertex in and out.
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
    """Of each trial of each cell the position of its target, 0 to alternatives - 1.

    In every cell, and in all together, each position comes equally often, or once more.
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
    """Positions of the target in the trials of a procedure, which may end early: of every 4 times `alternatives` trials
    in a row from the first, each position comes 4 times."""
    found: list[int] = []
    while len(found) < count:
        found += shuffled([position for position in range(alternatives) for _ in range(4)], generator)
    return found[:count]
