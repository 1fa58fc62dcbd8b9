"""Which surfaces of a scene can be touched at the same time, and how stable each such set is.

It reads the compiled table, whole arrays at a time. A surface is the region in which a probe can touch it: a wall is a
strip below its surface, as deep as the force limit presses, a membrane a strip about it, a box or a disc all of it.
Two surfaces act together where their regions meet. A set is a pair that meets and whatever meets both, or a surface
that meets none: whatever a probe touches at once lies within one of the sets. Where too many meet to look at them pair
by pair, a set is all that may lie over one cell of a grid. Either way a set may be too large, but never too small.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.base.core import Shape, Texture
from hapticd.rendering.disc_stiffness import round_skins
from hapticd.rendering.stability import (
    CORNER,
    GROWS,
    PRESS_N,
    Floats,
    Limit,
    Loop,
    Margin,
    Verdict,
    held_factor,
    limits,
    spectral_radius,
)
from hapticd.rendering.surface_table import Ints, SurfaceTable

MOST_PAIRS: Final = 40_000
"""So many pairs are looked at, or a set is what lies over a cell of a grid."""
MOST_LOOKS: Final = 200_000
"""The same for triples."""
MOST_TRIES: Final = 400
"""So many of the worst sets are looked at for different ones."""
MOST_TOLD: Final = 20
"""Sets that are told one by one."""
MOST_LINES: Final = 5
"""Sets that are told as lines."""
_CELLS: Final = 4
"""A region that is wider than so many cells of the grid is compared with all others."""


class _Skins(NamedTuple):
    """What each surface pushes back with, at most anywhere on it; arrays (n,)."""

    normal: Floats
    """Stiffness along the normal."""
    tangent: Floats
    """Stiffness along the surface."""
    damping: Floats
    drag: Floats
    rubbed: Floats
    """mu K and mu D: what friction follows the normal force with."""
    rubbed_damping: Floats
    normal_noise: Floats
    """Force along the normal for each metre that a position is off, along the tangent, and for each m/s."""
    tangent_noise: Floats
    normal_speed_noise: Floats
    tangent_speed_noise: Floats

    def of(self, rows: npt.NDArray[np.integer]) -> _Skins:
        """The skins at these places."""
        return _Skins(*(values[rows] for values in self))


def _material_skins(materials: npt.NDArray[np.void]) -> _Skins:
    stiffness, damping = materials["stiffness_n_per_m"], materials["damping_n_s_per_m"]
    rubs = materials["friction_coefficient"] > 0.0
    spring = np.where(rubs, materials["friction_stiffness_n_per_m"], 0.0)
    # The surface is lowered by H, of slope H' and curvature H'': the force is -grad(K/2 (d - H)^2), whose derivative
    # is K (1, H')(1, H')^T, and K (d - H) H'' along the surface.
    grooved = materials["texture"] == Texture.GEOMETRY
    width = np.where(grooved, materials["width_m"], 1.0)
    slope = np.where(grooved, math.pi * materials["depth_m"] / width, 0.0)
    curvature = 2.0 * math.pi * slope / width
    normal = stiffness * (1.0 + slope)
    flank = stiffness * (slope * slope + slope) + PRESS_N * curvature
    drag = np.where(materials["texture"] == Texture.DRAG, materials["drag_n_s_per_m"], 0.0)
    mu = materials["friction_coefficient"]
    return _Skins(
        normal=normal,
        tangent=spring + flank,
        damping=damping,
        drag=drag,
        rubbed=mu * normal,
        rubbed_damping=mu * damping,
        normal_noise=normal,
        # An anchor is off by as much as a position, and the spring by both; its longest stretch follows F_n.
        tangent_noise=2.0 * spring + flank + mu * normal,
        normal_speed_noise=damping,
        tangent_speed_noise=drag + mu * damping,
    )


def _round(surfaces: SurfaceTable, skins: _Skins) -> None:
    """Puts in what discs are where they have friction or shaped grooves."""
    materials = surfaces.materials[surfaces.objects["material"]]
    depends = (materials["friction_coefficient"] > 0.0) | (materials["texture"] == Texture.GEOMETRY)
    discs = np.flatnonzero((surfaces.objects["shape"] == Shape.DISC) & depends)
    if len(discs) == 0:
        return
    found = round_skins(surfaces.objects["half_m"][discs, 0], materials[discs], PRESS_N)
    skins.normal[discs] = skins.normal_noise[discs] = found.normal
    skins.tangent[discs] = found.tangent
    skins.rubbed[discs] = found.rubbed
    skins.tangent_noise[discs] = found.tangent + found.spring + found.rubbed


def _skins(surfaces: SurfaceTable) -> _Skins:
    """Of each object: its material's, or the largest of its pieces' and of the ramps between them."""
    materials = _material_skins(surfaces.materials)
    skins = _Skins(*(values.copy() for values in materials.of(surfaces.objects["material"])))
    _round(surfaces, skins)
    patched = np.flatnonzero(surfaces.objects["piece_count"] > 0)
    if len(patched) == 0:
        return skins
    # Where a material of stiffness K1 goes over into one of K2 over a width w, K' <= 3/2 |K2 - K1| / w and
    # K'' <= 6 |K2 - K1| / w^2; the force is -grad(K/2 d^2), pressed so deep as PRESS_N does in the middle.
    of = surfaces.pieces["material"]
    stiffness = surfaces.materials["stiffness_n_per_m"][of]
    before = np.concatenate((stiffness[:1], stiffness[:-1]))
    ramp = 2.0 * surfaces.pieces["half_ramp_m"]
    step = np.where(ramp > 0.0, np.abs(stiffness - before), 0.0)
    ramp = np.where(ramp > 0.0, ramp, 1.0)
    depth = PRESS_N / np.maximum(0.5 * (stiffness + before), 1e-3)
    cross = 1.5 * step / ramp * depth
    along = 3.0 * step / ramp**2 * depth**2 + cross
    pieces = materials.of(of)
    pieces = pieces._replace(
        normal=np.maximum(pieces.normal, np.where(step > 0.0, before, 0.0)) + cross,
        tangent=pieces.tangent + along,
        normal_noise=np.maximum(pieces.normal_noise, np.where(step > 0.0, before, 0.0)) + cross,
        tangent_noise=pieces.tangent_noise + along,
    )
    # The pieces of walls follow each other without gaps, in an order of their own.
    order = patched[np.argsort(surfaces.objects["piece_first"][patched], kind="stable")]
    starts = surfaces.objects["piece_first"][order].astype(np.int64)
    for into, values in zip(skins, pieces, strict=True):
        into[order] = np.maximum.reduceat(values, starts)
    return skins


class _Regions(NamedTuple):
    """Rectangles, or circles, in which each surface can be touched; arrays (n, 2), (n, 2) and (n, 2)."""

    center: Floats
    normal: Floats
    half: Floats
    """Half extents along the tangent (n_y, -n_x) and along the normal."""
    round: npt.NDArray[np.bool_]
    reachable: npt.NDArray[np.bool_]


def _regions(surfaces: SurfaceTable, skins: _Skins, loop: Loop) -> _Regions:
    objects = surfaces.objects
    shape = objects["shape"]
    center, normal = objects["point_m"].copy(), objects["normal"].copy()
    half = objects["half_m"].copy()
    radius = math.sqrt(2.0) * loop.workspace_m
    with np.errstate(divide="ignore"):
        deep = np.minimum(loop.max_force_n / skins.normal, 2.0 * radius)
    wall = shape == Shape.WALL
    height = np.einsum("ij,ij->i", center, normal)
    center[wall] = normal[wall] * (height - 0.5 * deep)[wall, None]
    half[wall, 0], half[wall, 1] = radius, 0.5 * deep[wall]
    membrane = shape == Shape.MEMBRANE
    breaks = surfaces.materials["rupture_depth_m"][objects["material"]]
    half[membrane, 1] = np.where(breaks > 0.0, np.minimum(breaks, deep), deep)[membrane]
    half += loop.encoder_step_m
    reachable = ~wall | (np.abs(height - 0.5 * deep) - 0.5 * deep <= radius)
    return _Regions(center, normal, half, shape == Shape.DISC, reachable)


def _meet(regions: _Regions, a: Ints, b: Ints) -> npt.NDArray[np.bool_]:
    """Whether the regions a and b meet: no axis separates them, of either or from centre to centre."""
    apart = np.zeros(len(a), dtype=bool)
    away = regions.center[b] - regions.center[a]
    distance = np.hypot(away[:, 0], away[:, 1])
    between = away / np.maximum(distance, 1e-300)[:, None]

    def reach(which: Ints, axis: Floats) -> Floats:
        normal, half = regions.normal[which], regions.half[which]
        along = np.abs(np.einsum("ij,ij->i", normal, axis))
        across = np.abs(normal[:, 1] * axis[:, 0] - normal[:, 0] * axis[:, 1])
        found: Floats = np.where(regions.round[which], half[:, 0], across * half[:, 0] + along * half[:, 1])
        return found

    def separates(axis: Floats) -> npt.NDArray[np.bool_]:
        found: npt.NDArray[np.bool_] = np.abs(np.einsum("ij,ij->i", away, axis)) > reach(a, axis) + reach(b, axis)
        return found

    apart |= separates(between)
    for which in (a, b):
        normal = regions.normal[which]
        tangent = np.stack((normal[:, 1], -normal[:, 0]), axis=1)
        straight = ~regions.round[which]
        apart |= straight & (separates(normal) | separates(tangent))
    return ~apart


class _Grid:
    """Upright boxes about regions, over the cells of a grid; those that are wider than a few cells stand apart."""

    def __init__(self, regions: _Regions, which: Ints) -> None:
        """`which` regions are looked at; places below count in it. There is at least one."""
        normal, half = np.abs(regions.normal[which]), regions.half[which]
        across = np.stack((normal[:, 1], normal[:, 0]), axis=1)
        extent = half[:, :1] * across + half[:, 1:] * normal
        self.extent = np.where(regions.round[which][:, None], half[:, :1], extent)
        self.center = regions.center[which]
        cell = max(1e-5, 4.0 * float(np.median(self.extent.max(axis=1))))
        low = np.floor((self.center - self.extent) / cell).astype(np.int64)
        spans = np.floor((self.center + self.extent) / cell).astype(np.int64) - low + 1
        self.wide = np.any(spans > _CELLS, axis=1)
        small = np.flatnonzero(~self.wide)
        low, spans = low[small], spans[small]
        copies = spans[:, 0] * spans[:, 1]
        place = np.repeat(np.arange(len(small)), copies)
        within = np.arange(len(place)) - np.repeat(np.cumsum(copies) - copies, copies)
        columns = spans[place, 0]
        # Two cells with one key only make more to look at.
        key = (low[place, 0] + within % columns) * 1_000_003 + low[place, 1] + within // columns
        order = np.argsort(key, kind="stable")
        self.key, self.owner = key[order], small[place[order]]
        """The cells' keys in rising order, and whose boxes lie over them."""

    def pairs(self) -> tuple[Ints, Ints] | None:
        """Places of boxes that may meet, each pair once, the lower first; None: more than MOST_PAIRS."""
        count = len(self.center)
        broad = np.flatnonzero(self.wide)
        if len(broad) * count > 4 * MOST_PAIRS:
            return None
        found: list[tuple[Ints, Ints]] = []
        total = 0
        for place in broad:
            room = self.extent + self.extent[place]
            near = np.flatnonzero(np.all(np.abs(self.center - self.center[place]) <= room, axis=1))
            near = near[(near > place) | ~self.wide[near]]
            found.append((np.full(len(near), place), near))
            total += len(near)
        for step in range(1, len(self.key)):
            same = np.flatnonzero(self.key[step:] == self.key[:-step])
            total += len(same)
            if len(same) == 0 or total > MOST_PAIRS:
                break
            found.append((self.owner[same], self.owner[same + step]))
        if total > MOST_PAIRS:
            return None
        if not found:
            return np.zeros(0, np.int64), np.zeros(0, np.int64)
        one, other = (np.concatenate(each) for each in zip(*found, strict=True))
        pair = np.unique(np.minimum(one, other) * count + np.maximum(one, other))
        pair = pair[pair // count != pair % count]
        return pair // count, pair % count


def _joined(count: int, a: Ints, b: Ints) -> tuple[Ints, Ints]:
    """All that each meets, one after the other: where those of each begin (count + 1,), and who they are."""
    ends = np.concatenate((a, b))
    order = np.lexsort((np.concatenate((b, a)), ends))
    starts = np.concatenate(([0], np.cumsum(np.bincount(ends, minlength=count))))
    return starts, np.concatenate((b, a))[order]


_COLUMNS: Final = 12
"""Of what surfaces add to a set: stiffness xx, xy, yy; damping xx, xy, yy; noise of x and y that grows with stiffness,
and that which does not; mu K / 2 and 2 mu D, by which delayed friction follows the normal force."""


def _rows(surfaces: SurfaceTable, skins: _Skins, loop: Loop) -> Floats:
    """What each surface adds to a set: (n, _COLUMNS)."""
    objects = surfaces.objects
    normal = objects["normal"]
    tangent = np.stack((normal[:, 1], -normal[:, 0]), axis=1)
    plane = (objects["shape"] == Shape.WALL) | (objects["shape"] == Shape.MEMBRANE)

    def matrix(along: Floats, across: Floats) -> Floats:
        # What may push any way pushes every way.
        along, across = (np.where(plane, each, np.maximum(along, across)) for each in (along, across))
        terms = [
            along * normal[:, i] * normal[:, j] + across * tangent[:, i] * tangent[:, j]
            for i, j in ((0, 0), (0, 1), (1, 1))
        ]
        return np.stack(terms, axis=1)

    def noise(along: Floats, across: Floats) -> Floats:
        size = np.abs(normal).sum(axis=1)
        straight = [size * (along * np.abs(normal[:, i]) + across * np.abs(tangent[:, i])) for i in (0, 1)]
        return np.where(plane[:, None], np.stack(straight, axis=1), (CORNER * (along + across))[:, None])

    return np.concatenate(
        (
            matrix(skins.normal, skins.tangent),
            matrix(skins.damping, skins.drag),
            0.5 * loop.encoder_step_m * noise(skins.normal_noise, skins.tangent_noise),
            loop.speed_step_m_per_s * noise(skins.normal_speed_noise, skins.tangent_speed_noise),
            0.5 * skins.rubbed[:, None],
            2.0 * skins.rubbed_damping[:, None],
        ),
        axis=1,
    )


def _largest(rows: Floats) -> Floats:
    """The larger eigenvalue of symmetric 2 by 2 matrices xx, xy, yy: (n, 3) to (n,)."""
    xx, xy, yy = rows[:, 0], rows[:, 1], rows[:, 2]
    return np.asarray(0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy))


_Members: TypeAlias = Callable[[int], tuple[int, ...]]
"""The slots of a set, in rising order."""


def _sets(rows: Floats, regions: _Regions, which: Ints) -> tuple[Floats, _Members]:
    """The sums of the sets that the surfaces `which` make, (n, _COLUMNS), and who is in each."""
    reached = which[regions.reachable[which]]
    far = which[~regions.reachable[which]]
    if len(reached) == 0:
        return np.asarray(rows[far]), lambda place: (int(far[place]),)
    grid = _Grid(regions, reached)
    pairs = grid.pairs()
    found = None
    if pairs is not None:
        a, b = reached[pairs[0]], reached[pairs[1]]
        meets = _meet(regions, a, b)
        found = _pair_sets(rows, a[meets], b[meets], which)
    return found or _cell_sets(rows, grid, reached, far)


def _pair_sets(rows: Floats, a: Ints, b: Ints, which: Ints) -> tuple[Floats, _Members] | None:
    """A pair that meets with what meets both of it, or a surface that meets none; None: more than MOST_LOOKS."""
    starts, others = _joined(len(rows), a, b)
    degree = np.diff(starts)
    fewer, more = np.where(degree[a] <= degree[b], (a, b), (b, a))
    count = degree[fewer]
    if count.sum() > MOST_LOOKS:
        return None
    alone = which[degree[which] == 0]
    sums = rows[a] + rows[b]
    if len(a) > 0:
        # What meets the one of a pair that meets fewer, and also the other.
        pair = np.repeat(np.arange(len(a)), count)
        within = np.arange(len(pair)) - np.repeat(np.cumsum(count) - count, count)
        third = others[starts[fewer[pair]] + within]
        known = np.sort(np.concatenate((a * len(rows) + b, b * len(rows) + a)))
        sought = third * len(rows) + more[pair]
        common = known[np.minimum(np.searchsorted(known, sought), len(known) - 1)] == sought
        np.add.at(sums, pair[common], rows[third[common]])

    def members(place: int) -> tuple[int, ...]:
        if place >= len(a):
            return (int(alone[place - len(a)]),)
        one, two = int(a[place]), int(b[place])
        met = [set(others[starts[slot] : starts[slot + 1]].tolist()) for slot in (one, two)]
        return tuple(sorted({one, two} | (met[0] & met[1])))

    return np.concatenate((sums, rows[alone])), members


def _cell_sets(rows: Floats, grid: _Grid, reached: Ints, far: Ints) -> tuple[Floats, _Members]:
    """All whose boxes lie over a cell of the grid, for each cell, and the wide ones with every cell."""
    wide = reached[grid.wide]
    everywhere = rows[wide].sum(axis=0)
    starts = np.flatnonzero(np.diff(grid.key, prepend=grid.key[:1] - 1)) if len(grid.key) else np.zeros(0, np.int64)
    owners = reached[grid.owner]
    sums = np.add.reduceat(rows[owners], starts) + everywhere if len(starts) > 0 else np.asarray(everywhere[None])
    ends = np.append(starts[1:], len(owners))

    def members(place: int) -> tuple[int, ...]:
        if place >= len(sums):
            return (int(far[place - len(sums)]),)
        here = owners[starts[place] : ends[place]].tolist() if len(starts) > 0 else []
        return tuple(sorted({*wide.tolist(), *here}))

    return np.concatenate((sums, rows[far])), members


class ContactSets:
    """The sets of a scene, and how each stands."""

    def __init__(self, surfaces: SurfaceTable, loop: Loop) -> None:
        self._loop = loop
        skins = _skins(surfaces)
        rows = _rows(surfaces, skins, loop)
        pushes = (surfaces.objects["shape"] != Shape.NONE) & rows.any(axis=1)
        base = np.zeros(_COLUMNS)
        base[[0, 2]] = surfaces.field_stiffness_n_per_m
        base[[3, 5]] = surfaces.field_damping_n_s_per_m
        base[6:8] = 0.5 * loop.encoder_step_m * surfaces.field_stiffness_n_per_m
        base[8:10] = loop.speed_step_m_per_s * surfaces.field_damping_n_s_per_m
        self.fields = bool(base.any())
        """Whether fields push in every set."""
        which = np.flatnonzero(pushes).astype(np.int64)
        if len(which) > 0:
            sums, self._members = _sets(rows, _regions(surfaces, skins, loop), which)
            sums = sums + base
        else:
            sums, self._members = (base[None] if self.fields else np.zeros((0, _COLUMNS))), lambda place: ()
        self._sums = sums
        timing = loop.timing
        self.stiffness_n_per_m = _largest(sums[:, :3])
        """(n,), of each set."""
        self.damping_n_s_per_m = _largest(sums[:, 3:6])
        """(n,), of each set."""
        holds = timing.reach_s / timing.period_s - 0.5
        self._passive, self._silent = limits(
            self.stiffness_n_per_m + loop.lag * sums[:, 10],
            self.damping_n_s_per_m + holds * sums[:, 11],
            sums[:, 6:8].max(axis=1, initial=0.0),
            sums[:, 8:10].max(axis=1, initial=0.0) + 0.5 * loop.force_step_n,
            loop,
        )
        # The same with its damping left out: what stiffness alone does.
        none = np.zeros(len(sums))
        still = limits(
            self.stiffness_n_per_m, none, sums[:, 6:8].max(axis=1, initial=0.0), none + 0.5 * loop.force_step_n, loop
        )
        self._held_still = still[1] >= 1.0
        self._undamped = np.minimum(*still)
        self.factor = np.minimum(self._passive, self._silent)
        """(n,): a set is safe with its stiffnesses so many times as large."""
        # Energy that is neither given nor taken may go on for ever; friction that just holds, holds.
        self.safe = (self._passive > 1.0) & (self._silent >= 1.0)
        """(n,)."""

    def __len__(self) -> int:
        return len(self._sums)

    def members(self, place: int) -> tuple[int, ...]:
        """The slots of a set, in rising order."""
        return self._members(place)

    def matrices(self, place: int) -> tuple[Floats, Floats]:
        """Stiffness and damping of a set, as spectral_radius takes them: (2, 2) each."""
        row = self._sums[place : place + 1]
        return _matrices(row[:, :3])[0], _matrices(row[:, 3:6])[0]

    def factors(self, place: int) -> dict[Limit, float]:
        """By which factor the stiffness of a set may grow, by condition."""
        return {"passivity": float(self._passive[place]), "quantisation": float(self._silent[place])}

    def worst(self, most: int, *, unsafe: bool) -> list[tuple[tuple[int, ...], int]]:
        """Slots and place of up to `most` different sets, or of unsafe ones, the stiffest beside its limit first."""
        order = np.lexsort((-self.stiffness_n_per_m, self.factor, self._undamped))
        if unsafe:
            order = order[~self.safe[order]]
        found: dict[tuple[int, ...], int] = {}
        for place in order[:MOST_TRIES].tolist():
            if len(found) == most:
                break
            found.setdefault(self._members(place), place)
        return list(found.items())

    def margins(self, chosen: Sequence[tuple[tuple[str, ...], int]]) -> list[Margin]:
        """The margins of sets, given as names and place."""
        if not chosen:
            return []
        places = [place for _, place in chosen]
        # Many sets of a scene are alike; what is passive does not grow in any hand.
        alike, which = np.unique(
            np.column_stack((self._sums[places, :6], np.minimum(self._passive[places], 1e9))),
            axis=0,
            return_inverse=True,
        )
        stiffness, damping = _matrices(alike[:, :3]), _matrices(alike[:, 3:6])
        radius = spectral_radius(stiffness, damping, self._loop)[which]
        free = spectral_radius(stiffness, damping, self._loop.let_go())[which]
        held = held_factor(stiffness, damping, self._loop, alike[:, 6])[which]
        found = []
        for index, (names, place) in enumerate(chosen):
            size, factor = float(self.stiffness_n_per_m[place]), float(self.factor[place])
            limited: Limit = "passivity" if self._passive[place] <= self._silent[place] else "quantisation"
            if radius[index] > GROWS:
                limited = "eigenvalues"
            verdict: Verdict = "safe" if self.safe[place] else "unproved"
            if max(radius[index], free[index]) > GROWS or not self._held_still[place]:
                verdict = "unsafe"
            found.append(
                Margin(
                    objects=names,
                    stiffness_n_per_m=size,
                    damping_n_s_per_m=float(self.damping_n_s_per_m[place]),
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
    """Whether every set that has one of these surfaces is safe; without any, whether the fields alone are."""
    if not slots:
        return bool(ContactSets(surfaces.of(np.zeros(0, np.int64)), loop).safe.all())
    own = np.array(slots)
    every = np.flatnonzero(surfaces.objects["shape"] != Shape.NONE)
    if len(own) * len(every) <= MOST_LOOKS:
        a, b = np.repeat(own, len(every)), np.tile(every, len(own))
        every = np.union1d(own, b[_meet(_regions(surfaces, _skins(surfaces), loop), a, b)])
    sets = ContactSets(surfaces.of(every), loop)
    wanted = set(np.searchsorted(every, own).tolist())
    return all(wanted.isdisjoint(sets.members(place)) for place in np.flatnonzero(~sets.safe).tolist())


def _matrices(rows: Floats) -> Floats:
    """xx, xy, yy to symmetric matrices: (n, 3) to (n, 2, 2)."""
    return np.asarray(rows[:, [0, 1, 1, 2]].reshape(-1, 2, 2))
