"""Contact sets: which surfaces of a scene can be touched at the same time, and how stable each such set is.

The analysis reads the arrays of the compiled table. The region of a surface is the area in which a probe can touch it.
For a wall this is a strip as deep as the force limit lets the probe go, for a membrane a strip around it, for a box or
disc the entire shape. A box that is pressed through holds the probe on its far side, too: as deep below a face as the
force limit lets the probe go. Two surfaces act together if their regions meet, or if one is where the other is pressed
through.

A contact set is a pair that meets and all surfaces that meet both, or a surface that meets no other. All surfaces that
a probe touches at once lie in one of the sets, except in rare cases behind discs and beyond the ends of surfaces. If
there are too many pairs to compare, all surfaces form one set. So a set may be too large.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.base.core import Shape
from hapticd.rendering.stability import (
    MAX_STABLE_RADIUS,
    WORST_NORMAL_FACTOR,
    Floats,
    Limit,
    Loop,
    Margin,
    Verdict,
    held_factor,
    limits,
    spectral_radius,
)
from hapticd.rendering.surface_properties import SurfaceProperties, properties_of
from hapticd.rendering.surface_table import Ints, SurfaceTable

MAX_COMPARED_PAIRS: Final = 500_000
"""Above this number of pairs all surfaces form one contact set."""
MAX_COMPARED_TRIPLES: Final = 2_000_000
"""Above this number of triples all surfaces form one contact set."""
MAX_SEARCHED_SETS: Final = 400
"""Number of sets, the worst first, among which sets of different surfaces are searched for the report."""
MAX_REPORTED_SETS: Final = 20
"""Maximum number of sets that `hapticd check` reports one by one."""
MAX_STABILITY_LINES: Final = 5
"""Maximum number of sets with a warning, one line each."""
_BOX_MARGIN_M: Final = 1e-12
"""Margin of axis-aligned bounding boxes against rounding."""


class _Regions(NamedTuple):
    """Rectangles or circles in which surfaces can be touched; arrays (n, 2) in m, `round` and `reachable` (n,)."""

    center: Floats
    normal: Floats
    half: Floats
    """Half extents along the tangent (n_y, -n_x) and along the normal."""
    through: tuple[Floats, ...]
    """The same of boxes that are pressed through along the tangent, and along the normal; empty if none can be."""
    round: npt.NDArray[np.bool_]
    """Whether the region is a circle, with the radius half[:, 0]."""
    reachable: npt.NDArray[np.bool_]
    """Whether the region lies, at least in part, within the workspace."""


def _regions(surfaces: SurfaceTable, properties: SurfaceProperties, loop: Loop) -> _Regions:
    objects = surfaces.objects
    shape = objects["shape"]
    center, normal = objects["point_m"].copy(), objects["normal"].copy()
    half = objects["half_m"].copy()
    radius = math.sqrt(2.0) * loop.workspace_m
    with np.errstate(divide="ignore"):
        deep = np.minimum(loop.max_force_n / properties.normal, 2.0 * radius)
    wall = shape == Shape.WALL
    height = np.einsum("ij,ij->i", center, normal)
    center[wall] = normal[wall] * (height - 0.5 * deep)[wall, None]
    half[wall, 0], half[wall, 1] = radius, 0.5 * deep[wall]
    membrane = shape == Shape.MEMBRANE
    breaks = surfaces.materials["rupture_depth_m"][objects["material"]]
    half[membrane, 1] = np.where(breaks > 0.0, np.minimum(breaks, deep), deep)[membrane]
    box = shape == Shape.BOX
    pressed = np.where(box[:, None], np.maximum(half, deep[:, None] - half), half)
    through = tuple(np.where([axis == 0, axis == 1], pressed, half) + loop.encoder_step_m for axis in (0, 1))
    half += loop.encoder_step_m
    reachable = ~wall | (np.abs(height - 0.5 * deep) - 0.5 * deep <= radius)
    thin = bool((pressed > half).any())
    return _Regions(center, normal, half, through if thin else (), shape == Shape.DISC, reachable)


def _meet(regions: _Regions, a: Ints, b: Ints) -> npt.NDArray[np.bool_]:
    """Return for each pair of surfaces in `a` and `b` whether their regions meet.

    This includes that one lies where the other is pressed through.
    """
    found = _intersect(regions, regions.half, a, b)
    for half in regions.through:
        for one, other in ((a, b), (b, a)):
            apart = np.flatnonzero(~found & (half[one] > regions.half[one]).any(axis=1))
            found[apart] = _intersect(regions, half, one[apart], other[apart])
    return found


def _intersect(regions: _Regions, half_of_a: Floats, a: Ints, b: Ints) -> npt.NDArray[np.bool_]:
    """Return for each pair whether the region of `a`, with these half extents, meets that of `b`.

    By the separating axis theorem; the axes are normal and tangent of each rectangle, and the line between the centres.
    """
    separated = np.zeros(len(a), dtype=bool)
    away = regions.center[b] - regions.center[a]
    distance = np.hypot(away[:, 0], away[:, 1])
    between = away / np.maximum(distance, 1e-300)[:, None]

    def reach(which: Ints, halves: Floats, axis: Floats) -> Floats:
        normal, half = regions.normal[which], halves[which]
        along = np.abs(np.einsum("ij,ij->i", normal, axis))
        across = np.abs(normal[:, 1] * axis[:, 0] - normal[:, 0] * axis[:, 1])
        found: Floats = np.where(regions.round[which], half[:, 0], across * half[:, 0] + along * half[:, 1])
        return found

    def separates(axis: Floats) -> npt.NDArray[np.bool_]:
        found: npt.NDArray[np.bool_] = np.abs(np.einsum("ij,ij->i", away, axis)) > (
            reach(a, half_of_a, axis) + reach(b, regions.half, axis)
        )
        return found

    separated |= separates(between)
    for which in (a, b):
        normal = regions.normal[which]
        tangent = np.stack((normal[:, 1], -normal[:, 0]), axis=1)
        straight = ~regions.round[which]
        separated |= straight & (separates(normal) | separates(tangent))
    return ~separated


class _Bounds(NamedTuple):
    """Axis-aligned bounding boxes: lower and upper corners, (n, 2) in m."""

    low: Floats
    high: Floats


def _bounds(regions: _Regions, which: Ints, halves: Floats) -> _Bounds:
    """Return the bounding boxes of the surfaces `which`, whose regions have these half extents."""
    normal, half = np.abs(regions.normal[which]), halves[which]
    extent = half[:, :1] * normal[:, ::-1] + half[:, 1:] * normal
    # The margin leaves boxes that just touch to _meet, independent of rounding.
    extent = np.where(regions.round[which][:, None], half[:, :1], extent) + _BOX_MARGIN_M
    return _Bounds(regions.center[which] - extent, regions.center[which] + extent)


def _beginning_within(ones: _Bounds, others: _Bounds, axis: int, room: int) -> tuple[Ints, Ints] | None:
    """Return the pairs that overlap and of which the other begins within the one along an axis.

    Returns None if there are more than `room` pairs.
    """
    order = np.argsort(others.low[:, axis], kind="stable")
    begins = others.low[order, axis]
    first = np.searchsorted(begins, ones.low[:, axis], side="left").tolist()
    last = np.searchsorted(begins, ones.high[:, axis], side="right").tolist()
    low, high = others.low[:, 1 - axis], others.high[:, 1 - axis]
    own_low, own_high = ones.low[:, 1 - axis].tolist(), ones.high[:, 1 - axis].tolist()
    found: list[Ints] = []
    total = 0
    for own in range(len(first)):
        inside = order[first[own] : last[own]]
        found.append(inside[(low[inside] <= own_high[own]) & (high[inside] >= own_low[own])])
        total += len(found[-1])
        if total > room:
            return None
    return np.repeat(np.arange(len(found)), list(map(len, found))), np.concatenate(found)


def _overlapping_boxes(regions: _Regions, which: Ints) -> tuple[Ints, Ints] | None:
    """Return the pairs of the surfaces `which` whose axis-aligned bounding boxes overlap, sorted, lower slot first.

    The bounding box of one of the two is that of its region, also where it is pressed through. Returns None if there
    are more than MAX_COMPARED_PAIRS.
    """
    region = _bounds(regions, which, regions.half)
    keys = np.zeros(0, dtype=np.int64)
    for half in regions.through or (regions.half,):
        wider = _bounds(regions, which, half)
        axis = int(np.argmin((wider.high - wider.low).mean(axis=0)))
        for ones, others in ((wider, region), (region, wider)):
            # A pair may be found in both orders, and a surface overlaps itself.
            found = _beginning_within(ones, others, axis, 2 * MAX_COMPARED_PAIRS + len(which))
            if found is None:
                return None
            one, other = which[found[0]], which[found[1]]
            a, b = np.minimum(one, other), np.maximum(one, other)
            keys = np.union1d(keys, (a * len(regions.half) + b)[a < b])
    if len(keys) > MAX_COMPARED_PAIRS:
        return None
    return keys // len(regions.half), keys % len(regions.half)


def _neighbours(count: int, a: Ints, b: Ints) -> tuple[Ints, Ints]:
    """Return the slots that each of `count` surfaces meets, concatenated, after their starts (count + 1,)."""
    ends = np.concatenate((a, b))
    order = np.lexsort((np.concatenate((b, a)), ends))
    starts = np.concatenate(([0], np.cumsum(np.bincount(ends, minlength=count))))
    return starts, np.concatenate((b, a))[order]


_SUM_COLUMNS: Final = 12
"""Number of columns that are summed over the surfaces of a set.

Columns: stiffness xx, xy, yy; damping xx, xy, yy; noise of x and y that grows with the stiffness; noise of x and y
that does not; mu K / 2 and 2 mu D, by which delayed friction follows the normal force.
"""


def _contributions(surfaces: SurfaceTable, properties: SurfaceProperties, loop: Loop) -> Floats:
    """Return the stiffness, damping and noise that each surface adds to a contact set, (n, _SUM_COLUMNS)."""
    objects = surfaces.objects
    normal = objects["normal"]
    tangent = np.stack((normal[:, 1], -normal[:, 0]), axis=1)
    plane = (objects["shape"] == Shape.WALL) | (objects["shape"] == Shape.MEMBRANE)

    def matrix(along: Floats, across: Floats) -> Floats:
        # A box or disc may push along any direction, so it counts with the larger value in every direction.
        along, across = (np.where(plane, each, np.maximum(along, across)) for each in (along, across))
        terms = [
            along * normal[:, i] * normal[:, j] + across * tangent[:, i] * tangent[:, j]
            for i, j in ((0, 0), (0, 1), (1, 1))
        ]
        return np.stack(terms, axis=1)

    def noise(along: Floats, across: Floats) -> Floats:
        size = np.abs(normal).sum(axis=1)
        straight = [size * (along * np.abs(normal[:, i]) + across * np.abs(tangent[:, i])) for i in (0, 1)]
        return np.where(plane[:, None], np.stack(straight, axis=1), (WORST_NORMAL_FACTOR * (along + across))[:, None])

    return np.concatenate(
        (
            matrix(properties.normal, properties.tangent),
            matrix(properties.damping, properties.drag),
            0.5 * loop.encoder_step_m * noise(properties.normal_noise, properties.tangent_noise),
            loop.speed_step_m_per_s * noise(properties.normal_speed_noise, properties.tangent_speed_noise),
            0.5 * properties.friction_per_depth[:, None],
            2.0 * properties.friction_per_speed[:, None],
        ),
        axis=1,
    )


def _largest_eigenvalue(rows: Floats) -> Floats:
    """Return the larger eigenvalue of symmetric 2 by 2 matrices, given as xx, xy, yy: (n, 3) to (n,)."""
    xx, xy, yy = rows[:, 0], rows[:, 1], rows[:, 2]
    return np.asarray(0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy))


_SlotsOfSet: TypeAlias = Callable[[int], tuple[int, ...]]
"""Function that returns the slots of a set, in ascending order, given the set's number from 0."""


def _sets_of(rows: Floats, regions: _Regions, which: Ints) -> tuple[Floats, _SlotsOfSet]:
    """Return the sums (n, _SUM_COLUMNS) of the sets of the surfaces `which`, and a function for the slots of a set."""
    reached = which[regions.reachable[which]]
    far = which[~regions.reachable[which]]
    if len(reached) == 0:
        return np.asarray(rows[far]), lambda number: (int(far[number]),)
    pairs = _overlapping_boxes(regions, reached)
    if pairs is not None:
        meets = _meet(regions, *pairs)
        found = _pair_sets(rows, pairs[0][meets], pairs[1][meets], which)
        if found is not None:
            return found
    sums = np.concatenate((rows[reached].sum(axis=0, keepdims=True), rows[far]))
    return sums, lambda number: tuple(reached.tolist()) if number == 0 else (int(far[number - 1]),)


def _pair_sets(rows: Floats, a: Ints, b: Ints, which: Ints) -> tuple[Floats, _SlotsOfSet] | None:
    """Return the sets of pairs and of single surfaces as `_sets_of` does; None above MAX_COMPARED_TRIPLES.

    The set of a pair that meets contains the pair and all surfaces that meet both.
    """
    starts, others = _neighbours(len(rows), a, b)
    degree = np.diff(starts)
    fewer, more = np.where(degree[a] <= degree[b], (a, b), (b, a))
    count = degree[fewer]
    if count.sum() > MAX_COMPARED_TRIPLES:
        return None
    alone = which[degree[which] == 0]
    sums = rows[a] + rows[b]
    if len(a) > 0:
        # Candidates: neighbours of the pair's surface with fewer of them; `common` marks those of the other one, too.
        pair = np.repeat(np.arange(len(a)), count)
        within = np.arange(len(pair)) - np.repeat(np.cumsum(count) - count, count)
        third = others[starts[fewer[pair]] + within]
        known = np.sort(np.concatenate((a * len(rows) + b, b * len(rows) + a)))
        sought = third * len(rows) + more[pair]
        common = known[np.minimum(np.searchsorted(known, sought), len(known) - 1)] == sought
        np.add.at(sums, pair[common], rows[third[common]])

    def members(number: int) -> tuple[int, ...]:
        if number >= len(a):
            return (int(alone[number - len(a)]),)
        one, two = int(a[number]), int(b[number])
        met = [set(others[starts[slot] : starts[slot + 1]].tolist()) for slot in (one, two)]
        return tuple(sorted({one, two} | (met[0] & met[1])))

    return np.concatenate((sums, rows[alone])), members


class ContactSets:
    """The contact sets of a scene, with the stability of each."""

    def __init__(self, surfaces: SurfaceTable, loop: Loop) -> None:
        self._loop = loop
        properties = properties_of(surfaces)
        rows = _contributions(surfaces, properties, loop)
        pushes = (surfaces.objects["shape"] != Shape.NONE) & rows.any(axis=1)
        base = np.zeros(_SUM_COLUMNS)
        base[[0, 2]] = surfaces.field_stiffness_n_per_m
        base[[3, 5]] = surfaces.field_damping_n_s_per_m
        base[6:8] = 0.5 * loop.encoder_step_m * surfaces.field_stiffness_n_per_m
        base[8:10] = loop.speed_step_m_per_s * surfaces.field_damping_n_s_per_m
        self.fields = bool(base.any())
        """Whether fields contribute to every set."""
        which = np.flatnonzero(pushes).astype(np.int64)
        if len(which) > 0:
            sums, self._members = _sets_of(rows, _regions(surfaces, properties, loop), which)
            sums = sums + base
        else:
            sums, self._members = (base[None] if self.fields else np.zeros((0, _SUM_COLUMNS))), lambda number: ()
        self._sums = sums
        self.stiffness_n_per_m = _largest_eigenvalue(sums[:, :3])
        """(n,): largest eigenvalue of each set's stiffness."""
        self.damping_n_s_per_m = _largest_eigenvalue(sums[:, 3:6])
        """(n,): largest eigenvalue of each set's damping."""
        self._passivity_factor, self._noise_factor = limits(
            self.stiffness_n_per_m + loop.lag * sums[:, 10],
            self.damping_n_s_per_m + loop.late_periods * sums[:, 11],
            sums[:, 6:8].max(axis=1, initial=0.0),
            sums[:, 8:10].max(axis=1, initial=0.0) + 0.5 * loop.force_step_n,
            loop,
        )
        # The same limits without damping.
        none = np.zeros(len(sums))
        still = limits(
            self.stiffness_n_per_m, none, sums[:, 6:8].max(axis=1, initial=0.0), none + 0.5 * loop.force_step_n, loop
        )
        self._noise_held = still[1] >= 1.0
        self._undamped_factor = np.minimum(*still)
        self.factor = np.minimum(self._passivity_factor, self._noise_factor)
        """(n,): largest factor on all stiffnesses of each set up to which the set is safe."""
        # At the passivity limit an oscillation may last for ever; friction that equals the noise still holds it.
        self.safe = (self._passivity_factor > 1.0) & (self._noise_factor >= 1.0)
        """(n,): whether each set is proved stable in any hand."""

    def __len__(self) -> int:
        return len(self._sums)

    def members(self, number: int) -> tuple[int, ...]:
        """Return the slots of the surfaces of a contact set, in ascending order."""
        return self._members(number)

    def matrices(self, number: int) -> tuple[Floats, Floats]:
        """Return the stiffness (N/m) and damping (N s/m) matrices of a contact set, (2, 2) each."""
        row = self._sums[number : number + 1]
        return _matrices(row[:, :3])[0], _matrices(row[:, 3:6])[0]

    def factors(self, number: int) -> dict[Limit, float]:
        """Return the factor by which the stiffness of a contact set may grow, for each condition of stability."""
        return {"passivity": float(self._passivity_factor[number]), "quantisation": float(self._noise_factor[number])}

    def worst(self, count: int, *, unsafe: bool) -> list[tuple[tuple[int, ...], int]]:
        """Return slots and number of up to `count` sets of different surfaces, the sets nearest to their limits first.

        They are sorted by margin without damping, by margin, and by stiffness. `unsafe` omits sets proved safe.
        """
        order = np.lexsort((-self.stiffness_n_per_m, self.factor, self._undamped_factor))
        if unsafe:
            order = order[~self.safe[order]]
        found: dict[tuple[int, ...], int] = {}
        for number in order[:MAX_SEARCHED_SETS].tolist():
            if len(found) == count:
                break
            found.setdefault(self._members(number), number)
        return list(found.items())

    def margins(self, chosen: Sequence[tuple[tuple[str, ...], int]]) -> list[Margin]:
        """Return the margins of chosen sets, given as the names of the objects and the number of each set."""
        if not chosen:
            return []
        numbers = [number for _, number in chosen]
        # Equal sets are computed once. A passive set does not grow: the search starts at its passivity factor.
        alike, which = np.unique(
            np.column_stack((self._sums[numbers, :6], np.minimum(self._passivity_factor[numbers], 1e9))),
            axis=0,
            return_inverse=True,
        )
        stiffness, damping = _matrices(alike[:, :3]), _matrices(alike[:, 3:6])
        radius = spectral_radius(stiffness, damping, self._loop)[which]
        free = spectral_radius(stiffness, damping, self._loop.without_hand())[which]
        held = held_factor(stiffness, damping, self._loop, alike[:, 6])[which]
        found = []
        for index, (names, number) in enumerate(chosen):
            size, factor = float(self.stiffness_n_per_m[number]), float(self.factor[number])
            limited: Limit = (
                "passivity" if self._passivity_factor[number] <= self._noise_factor[number] else "quantisation"
            )
            if radius[index] > MAX_STABLE_RADIUS:
                limited = "eigenvalues"
            verdict: Verdict = "safe" if self.safe[number] else "unproved"
            if max(radius[index], free[index]) > MAX_STABLE_RADIUS or not self._noise_held[number]:
                verdict = "unsafe"
            found.append(
                Margin(
                    objects=names,
                    stiffness_n_per_m=size,
                    damping_n_s_per_m=float(self.damping_n_s_per_m[number]),
                    limit_n_per_m=factor * size if size > 0.0 else 0.0,
                    held_limit_n_per_m=float(held[index]) * size if size > 0.0 else math.inf,
                    margin=factor,
                    limited_by=limited,
                    verdict=verdict,
                    spectral_radius=float(radius[index]),
                    free_radius=float(free[index]),
                )
            )
        return found


def safe_around(surfaces: SurfaceTable, loop: Loop, slots: Sequence[int]) -> bool:
    """Return whether every contact set that contains one of these surfaces is safe.

    Without surfaces, return whether the fields alone are safe.
    """
    if not slots:
        return bool(ContactSets(surfaces.of(np.zeros(0, np.int64)), loop).safe.all())
    own = np.array(slots)
    every = np.flatnonzero(surfaces.objects["shape"] != Shape.NONE)
    if len(own) * len(every) <= MAX_COMPARED_TRIPLES:
        a, b = np.repeat(own, len(every)), np.tile(every, len(own))
        every = np.union1d(own, b[_meet(_regions(surfaces, properties_of(surfaces), loop), a, b)])
    sets = ContactSets(surfaces.of(every), loop)
    wanted = set(np.searchsorted(every, own).tolist())
    return all(wanted.isdisjoint(sets.members(number)) for number in np.flatnonzero(~sets.safe).tolist())


def _matrices(rows: Floats) -> Floats:
    """Return symmetric matrices from xx, xy, yy: (n, 3) to (n, 2, 2)."""
    return np.asarray(rows[:, [0, 1, 1, 2]].reshape(-1, 2, 2))
