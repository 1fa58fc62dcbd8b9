"""Boxes, discs and membranes: nothing tunnels, nothing pops out, corners and seams, updates under the hand.

Where a segment meets a shape is worked out here by clipping and by roots, in numpy; forces are compared with
K d along the surface that was met.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest

from hapticd.base.core import EventKind, Flag
from hapticd.rendering.offline import simulate_run
from tests.support.rig import Rig, still

Points = npt.NDArray[np.float64]

K = 800.0
RAMP_S = 0.02
MATERIALS = {
    "m": {"stiffness_n_per_m": K},
    "loud": {
        "stiffness_n_per_m": K,
        "tap": {"attack_slope_per_s": 309, "frequency_hz": 67, "decay_time_s": 0.00648},
    },
    "hard": {"stiffness_n_per_m": 2000},
}


def box(center: Sequence[float], size: Sequence[float], angle: float = 0.0, material: str = "m") -> dict[str, object]:
    return {
        "kind": "box",
        "center_m": [float(x) for x in center],
        "size_m": [float(x) for x in size],
        "angle_rad": float(angle),
        "material": material,
    }


def disc(center: Sequence[float], radius: float, material: str = "m") -> dict[str, object]:
    return {"kind": "disc", "center_m": [float(x) for x in center], "radius_m": radius, "material": material}


def skin(center: Sequence[float], width: float, angle: float = 0.0, material: str = "m") -> dict[str, object]:
    """A membrane whose normal is (0, 1), turned by an angle."""
    return {
        "kind": "membrane",
        "center_m": [float(x) for x in center],
        "normal": [-float(np.sin(angle)), float(np.cos(angle))],
        "width_m": width,
        "material": material,
    }


def wall(point: Sequence[float], angle: float = 0.0, material: str = "m") -> dict[str, object]:
    normal = [-float(np.sin(angle)), float(np.cos(angle))]
    return {"kind": "wall", "point_m": [float(x) for x in point], "normal": normal, "material": material}


def turned(points: npt.ArrayLike, angle: float, about: Sequence[float] = (0.0, 0.0)) -> Points:
    """Points turned counterclockwise about the origin and then moved."""
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(points, dtype=np.float64) @ np.array([[c, s], [-s, c]]) + np.asarray(about)


def down(x: float, top: float, bottom: float, step: float) -> Points:
    """Straight down from one height to another."""
    y = np.arange(top, bottom, -step)
    return np.column_stack([np.full_like(y, x), y])


def across(start: float, end: float, y: float, step: float) -> Points:
    """Straight along x at one height."""
    x = np.linspace(start, end, round(abs(end - start) / step) + 1)
    return np.column_stack([x, np.full_like(x, y)])


def force(samples: npt.NDArray[np.void]) -> Points:
    found: Points = samples["contact_force_n"]
    return found


# ---- Where segments meet shapes ----------------------------------------------------------------------------------


class Entry:
    """Where segments from outside enter a shape: fraction (NaN: not at all), outward normal, how nearly they miss."""

    def __init__(self, fraction: Points, normal: Points, margin: Points) -> None:
        self.fraction, self.normal, self.margin = fraction, normal, margin


def box_entry(a: Points, b: Points, size: Sequence[float]) -> Entry:
    """Of a box about the origin: clipped by its four half planes (Cyrus and Beck)."""
    normals = np.array([[0.0, 1.0], [1.0, 0.0], [0.0, -1.0], [-1.0, 0.0]])
    half = np.array([size[1], size[0], size[1], size[0]]) / 2.0
    begin = a @ normals.T - half  # distance from each face, positive outside
    end = b @ normals.T - half
    with np.errstate(divide="ignore", invalid="ignore"):
        cut = begin / (begin - end)
    enter = np.where((begin > 0) & (end < begin), cut, -np.inf)
    enter[(begin > 0) & (end >= 0)] = np.inf
    leave = np.where((begin <= 0) & (end > 0), cut, 1.0)
    face = np.argmax(enter, axis=1)
    first = enter[np.arange(len(a)), face]
    meets = (begin > 0).any(axis=1) & (first < leave.min(axis=1))
    # How far from an edge it passes: the middle of what is inside, or of what comes nearest to it.
    middle = np.clip(0.5 * (np.clip(first, 0, 1) + leave.min(axis=1)), 0, 1)[:, None]
    inside = np.abs((a + middle * (b - a)) @ normals[:2].T) - half[:2]
    return Entry(np.where(meets, first, np.nan), normals[face], np.abs(inside).min(axis=1))


def disc_entry(a: Points, b: Points, radius: float) -> Entry:
    """Of a disc about the origin: the foot of the perpendicular, and half the chord back from it."""
    way = b - a
    length = np.hypot(*way.T)
    unit = way / length[:, None]
    foot = -np.sum(a * unit, axis=1)
    distance = np.abs(a[:, 0] * unit[:, 1] - a[:, 1] * unit[:, 0])
    half_chord = np.sqrt(np.maximum(radius**2 - distance**2, 0.0))
    enter = (foot - half_chord) / length
    meets = (distance < radius) & (enter >= 0) & (enter < 1)
    hit = a + enter[:, None] * way
    return Entry(np.where(meets, enter, np.nan), hit / np.hypot(*hit.T)[:, None], np.abs(distance - radius))


def skin_entry(a: Points, b: Points, width: float) -> Entry:
    """Of a membrane along x about the origin; a point on it counts as above."""
    crosses = (a[:, 1] >= 0) != (b[:, 1] >= 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        cut = a[:, 1] / (a[:, 1] - b[:, 1])
        along = np.abs(a[:, 0] + cut * (b[:, 0] - a[:, 0]))
        meets = crosses & (along < width / 2)
    normal = np.column_stack([np.zeros(len(a)), np.where(a[:, 1] >= 0, 1.0, -1.0)])
    return Entry(np.where(meets, cut, np.nan), normal, np.where(crosses, np.abs(along - width / 2), 1.0))


def random_moves(rng: np.random.Generator, count: int, reach: float, rate_hz: float) -> tuple[Points, Points]:
    """Straight moves of one period at up to 5 m/s, beginning within `reach` of the origin."""
    a = rng.uniform(-reach, reach, (count, 2))
    angle = rng.uniform(0, 2 * np.pi, count)
    length = rng.uniform(1e-5, 0.999 * 5.0 / rate_hz, count)
    return a, a + length[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])


def apart(a: Points, b: Points, far: Sequence[float]) -> Points:
    """Moves as one path. Going far away and back is a jump, after which nothing is remembered: (3 n, 2)."""
    path = np.empty((len(a), 3, 2))
    path[:, 0], path[:, 1], path[:, 2] = a, b, far
    return path.reshape(-1, 2)


def check_moves(
    thing: dict[str, object],
    a: Points,
    b: Points,
    entry: Entry,
    place: Callable[[Points], Points],
    wanted: Callable[[Points, Entry], Points],
    rate_hz: float = 1000.0,
) -> int:
    """Every crossing has its contact, at its time, and its force; nothing else has any. How many crossed.

    Moves, entries and forces are in the shape's own axes; `place` puts points where the shape is, its turning alone is
    that of forces.
    """
    plain = entry.margin > 1e-12
    a, b = a[plain], b[plain]
    entry = Entry(entry.fraction[plain], entry.normal[plain], entry.margin[plain])
    rig = Rig({"it": thing}, rate_hz=rate_hz, materials=MATERIALS)
    samples = rig.render(apart(place(a), place(b), [1.0, 1.0]))
    contacts = rig.of(EventKind.CONTACT)
    move, phase = np.divmod(contacts["tick"].astype(np.int64), 3)
    assert np.all(phase == 1)
    crossing = np.flatnonzero(np.isfinite(entry.fraction))
    np.testing.assert_array_equal(move, crossing)
    np.testing.assert_array_equal(contacts["code"], 0)
    np.testing.assert_allclose(contacts["before_tick_s"], (1.0 - entry.fraction[crossing]) / rate_hz, rtol=0, atol=1e-9)
    ahead = place(np.zeros((1, 2)))
    met = Entry(entry.fraction[crossing], entry.normal[crossing], entry.margin[crossing])
    expected = np.zeros((len(a), 2))
    expected[crossing] = place(wanted(b[crossing], met)) - ahead
    np.testing.assert_allclose(force(samples[1::3]), expected, rtol=0, atol=1e-11)
    assert not force(samples[0::3]).any()
    assert not force(samples[2::3]).any()
    return len(crossing)


def flat(size: Sequence[float]) -> Callable[[Points, Entry], Points]:
    """K d of the face that was entered, while the probe is behind it and not past its ends."""

    def wanted(b: Points, entry: Entry) -> Points:
        upright = np.abs(entry.normal[:, 1]) > 0.5
        height = np.where(upright, size[1], size[0]) / 2
        width = np.where(upright, size[0], size[1]) / 2
        depth = height - np.sum(b * entry.normal, axis=1)
        along = np.abs(entry.normal[:, 1] * b[:, 0] - entry.normal[:, 0] * b[:, 1])
        held = (depth > 0) & (along <= width)
        return np.where(held, K * depth, 0.0)[:, None] * entry.normal

    return wanted


@pytest.mark.parametrize("degrees", [0, 17, 45, 90, 120, 180, 250, 333])
def test_nothing_tunnels_through_a_thin_box(degrees: float) -> None:
    rng = np.random.default_rng(int(degrees))
    size, center, angle = (0.006, 0.0005), (0.013, -0.007), np.radians(degrees)
    a, b = random_moves(rng, 60_000, 0.004, 1000)
    outside = (np.abs(a) > np.array(size) / 2).any(axis=1)
    a, b = a[outside], b[outside]
    met = check_moves(
        box(center, size, angle), a, b, box_entry(a, b, size), lambda p: turned(p, angle, center), flat(size)
    )
    assert met > 8_000


@pytest.mark.parametrize("degrees", [0, 30, 90, 200])
def test_nothing_tunnels_through_a_membrane(degrees: float) -> None:
    rng = np.random.default_rng(100 + int(degrees))
    center, angle = (-0.02, 0.03), np.radians(degrees)
    a, b = random_moves(rng, 60_000, 0.004, 1000)
    entry = skin_entry(a, b, 0.006)
    met = check_moves(skin(center, 0.006, angle), a, b, entry, lambda p: turned(p, angle, center), flat((0.006, 0.0)))
    assert met > 8_000


@pytest.mark.long
@pytest.mark.parametrize("radius", [0.00025, 0.001, 0.003])
def test_nothing_tunnels_through_a_disc(radius: float) -> None:
    """A disc that was crossed pushes toward where it was entered, or was left again; never with more than its depth."""
    rng = np.random.default_rng(round(radius * 1e6))
    center = np.array([0.02, 0.04])
    a, b = random_moves(rng, 120_000, radius + 0.002, 1000)
    outside = np.hypot(*a.T) > radius
    a, b = a[outside], b[outside]
    entry = disc_entry(a, b, radius)
    plain = entry.margin > 1e-12
    a, b, fraction, normal = a[plain], b[plain], entry.fraction[plain], entry.normal[plain]
    rig = Rig({"it": disc(center, radius)}, rate_hz=1000, materials=MATERIALS)
    samples = rig.render(apart(a + center, b + center, [1.0, 1.0]))
    contacts = rig.of(EventKind.CONTACT)
    crossing = np.flatnonzero(np.isfinite(fraction))
    assert len(crossing) > 5_000
    np.testing.assert_array_equal(contacts["tick"], 3 * crossing + 1)
    np.testing.assert_allclose(contacts["before_tick_s"], (1 - fraction[crossing]) * 1e-3, rtol=0, atol=1e-9)
    pushes = force(samples[1::3])
    assert not pushes[~np.isfinite(fraction)].any()
    b, n, f = b[crossing], normal[crossing], pushes[crossing]
    inside = np.hypot(*b.T) < radius
    toward = np.sum(f * n, axis=1)
    assert np.all(toward[inside] > 0)
    strength = np.hypot(*f.T)
    held = strength > 0
    assert np.all(toward[held] > 0)
    # The force is K (R - p.m) along some m, the bearing.
    bearing = f[held] / strength[held, None]
    np.testing.assert_allclose(strength[held], K * (radius - np.sum(b[held] * bearing, axis=1)), rtol=0, atol=1e-11)
    # Straight through the middle it is met where it was entered and held there.
    through = held & (np.sum(b * n, axis=1) < 0)
    assert through.sum() > 200
    np.testing.assert_allclose((f / np.where(held, strength, 1)[:, None])[through], n[through], rtol=0, atol=1e-9)


def follow_box(path: Points, size: Sequence[float]) -> tuple[list[tuple[int, str, float]], Points]:
    """The contact with a box about the origin, sample by sample: events (tick, what, fraction) and forces."""
    events: list[tuple[int, str, float]] = []
    forces = np.zeros_like(path)
    entry = box_entry(path[:-1], path[1:], size)
    normal: Points | None = None
    for k in range(1, len(path)):
        p = path[k]
        if normal is None and np.isfinite(entry.fraction[k - 1]):
            normal = entry.normal[k - 1]
            events.append((k, "contact", float(entry.fraction[k - 1])))
        if normal is not None:
            height, width = (size[1], size[0]) if abs(normal[1]) > 0.5 else (size[0], size[1])
            depth = height / 2 - float(p @ normal)
            if depth <= 0 or abs(normal[1] * p[0] - normal[0] * p[1]) > width / 2:
                normal = None
                events.append((k, "release", 1.0))
            else:
                forces[k] = K * depth * normal
    return events, forces


def test_a_path_that_goes_in_and_out_is_held_by_the_face_it_entered_each_time() -> None:
    """Long straight moves through and around a box, entered by every face; it holds until it is left there."""
    rng = np.random.default_rng(5)
    size = (0.004, 0.0005)
    corners = rng.uniform(-0.005, 0.005, (4000, 2)) * [1, 0.5]
    corners[0] = [0.0, 0.002]
    legs = []
    for a, b in pairwise(corners):
        count = max(1, int(np.ceil(np.hypot(*(b - a)) / rng.uniform(1e-4, 4.9e-3))))
        legs.append(a + (b - a) * np.arange(count)[:, None] / count)
    path = np.concatenate(legs)
    events, forces = follow_box(path, size)
    for degrees in (0, 63):
        angle = np.radians(degrees)
        rig = Rig({"it": box((0.3, -0.2), size, angle)}, rate_hz=1000, materials=MATERIALS)
        samples = rig.render(turned(path, angle, (0.3, -0.2)))
        kinds = {EventKind.CONTACT: "contact", EventKind.RELEASE: "release"}
        found = [(int(e["tick"]), kinds[EventKind(int(e["kind"]))]) for e in rig.events]
        assert found == [(tick, what) for tick, what, _ in events]
        before = rig.of(EventKind.CONTACT)["before_tick_s"]
        wanted = [(1 - fraction) / 1000 for _, what, fraction in events if what == "contact"]
        np.testing.assert_allclose(before, wanted, rtol=0, atol=1e-9)
        np.testing.assert_allclose(force(samples), turned(forces, angle), rtol=0, atol=1e-11)
    assert len(events) > 1500
    assert {tuple(np.sign(np.round(f, 9))) for f in forces} == {(0, 0), (0, 1), (0, -1), (1, 0), (-1, 0)}


# ---- No pop-out --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("degrees", [0, 30, 90, 145, 180, 270])
@pytest.mark.parametrize("kind", ["box", "membrane"])
@pytest.mark.parametrize("offset", [-0.4, 0.0, 0.31])
def test_pressed_through_it_pushes_back_to_the_side_it_came_from(kind: str, degrees: float, offset: float) -> None:
    angle, center, width, thin = np.radians(degrees), (0.02, 0.01), 0.02, 0.0005 if kind == "box" else 0.0
    thing = box(center, (width, thin), angle) if kind == "box" else skin(center, width, angle)
    for step in (1e-5, 4e-4):
        rig = Rig({"it": thing}, rate_hz=1000, materials=MATERIALS)
        path = down(offset * width, 0.002, -0.008, step)
        back = path[::-1]
        depth = thin / 2 - path[:, 1]
        expected = np.column_stack([np.zeros(len(path)), K * np.maximum(depth, 0.0)])
        samples = rig.render(turned(path, angle, center))
        assert rig.kinds() == [EventKind.CONTACT]
        np.testing.assert_allclose(force(samples), turned(expected, angle), rtol=0, atol=1e-11)
        samples = rig.render(turned(back, angle, center))
        np.testing.assert_allclose(force(samples), turned(expected[::-1], angle), rtol=0, atol=1e-11)
        (release,) = rig.events
        assert release["kind"] == EventKind.RELEASE
        first_out = int(np.argmax(depth[::-1] <= 0))
        assert abs(int(release["tick"]) - len(path) - first_out) <= 1  # a sample on the surface may be on either side


def polar(radius: npt.ArrayLike, angle: npt.ArrayLike) -> Points:
    """Points at angles clockwise from the top."""
    return np.column_stack(np.broadcast_arrays(radius * np.sin(angle), radius * np.cos(angle)))


@pytest.mark.parametrize("rate_hz", [1000.0, 10_000.0])
@pytest.mark.parametrize("depth", [0.05, 0.2, 0.45, 0.7, 0.9])
def test_circling_a_disc_the_force_is_radial_all_around(rate_hz: float, depth: float) -> None:
    radius, center = 0.005, np.array([0.01, -0.03])
    rig = Rig({"peg": disc(center, radius)}, rate_hz=rate_hz, materials=MATERIALS)
    step = 0.3 / rate_hz / radius
    angle = np.concatenate([np.zeros(40), np.arange(0, 15, step), np.arange(15, -15, -step)])
    r = np.full_like(angle, radius * (1 - depth))
    r[:40] = np.linspace(radius * 1.1, r[-1], 40)
    r[40:] -= 0.02 * radius * np.sin(3 * angle[40:])
    samples = rig.render(polar(r, angle) + center)
    expected = K * np.maximum(radius - r, 0)[:, None] * polar(1.0, angle)
    np.testing.assert_allclose(force(samples), expected, rtol=0, atol=1e-12)
    assert rig.kinds() == [EventKind.CONTACT]


# ---- Corners and seams -------------------------------------------------------------------------------------------


def test_slipping_over_an_edge_lets_go_and_the_side_is_met_from_outside() -> None:
    rig = Rig({"b": box((0, -0.005), (0.02, 0.01))}, materials=MATERIALS)
    rig.render(down(0.0095, 0.001, -0.001, 1e-5))
    path = across(0.0095, 0.0115, -0.001, 1e-5)
    samples = rig.render(path)
    expected = np.where(path[:, 0] < 0.01 - 1e-9, K * 0.001, 0.0)
    assert np.abs(force(samples)[:, 1] - expected)[np.abs(path[:, 0] - 0.01) > 1e-9].max() < 1e-12
    assert not force(samples)[:, 0].any()
    assert rig.kinds() == [EventKind.RELEASE]
    samples = rig.render(path[::-1])
    np.testing.assert_allclose(force(samples)[:, 0], K * np.maximum(0.01 - path[::-1, 0], 0), rtol=0, atol=1e-12)
    assert not force(samples)[:, 1].any()


def test_floor_and_side_of_a_box_are_touched_together() -> None:
    """A box on a floor, met from the side by a probe that is pressed 1 mm into the floor; and the other way round."""
    objects = {"floor": wall((0, 0)), "b": box((0.01, 0.005), (0.02, 0.01))}
    for deep in (1e-4, 1e-3, 4e-3):
        rig = Rig(objects, materials=MATERIALS)
        rig.render(down(-0.003, 0.001, -deep, 1e-5))
        path = across(-0.003, 0.002, -deep, 1.3e-5)
        samples = rig.render(path)
        np.testing.assert_allclose(force(samples)[:, 0], -K * np.maximum(path[:, 0], 0), rtol=0, atol=1e-12)
        assert np.ptp(force(samples)[:, 1]) == 0.0
        (contact,) = rig.events
        tick = int(contact["tick"]) - int(samples["tick"][0])
        assert path[tick - 1, 0] <= 0 < path[tick, 0]
        before = path[tick, 0] / (path[tick, 0] - path[tick - 1, 0]) / 10_000
        assert contact["before_tick_s"] == pytest.approx(before, abs=1e-9)
    rig = Rig(objects, materials=MATERIALS)
    rig.render(across(-0.003, 0.001, 0.002, 1e-5))
    path = down(0.001, 0.002, -0.001, 1e-5)
    samples = rig.render(path)
    np.testing.assert_allclose(force(samples)[:, 1], K * np.maximum(-path[:, 1], 0), rtol=0, atol=1e-12)
    np.testing.assert_allclose(force(samples)[:, 0], -K * 0.001, rtol=0, atol=1e-12)


@pytest.mark.parametrize("degrees", [0, 90, 180, 270, 33])
@pytest.mark.parametrize("kind", ["boxes", "membranes", "a wall and boxes", "boxes upside down"])
def test_flush_floors_have_no_seam(kind: str, degrees: float) -> None:
    """Slid over 1 mm deep, both ways: no gap, no force sideways, no tap."""
    angle, center = np.radians(degrees), np.array([0.03, -0.02])
    places = [turned([x, -0.005], angle, center) for x in (-0.02, 0.0, 0.02)]
    if kind == "membranes":
        tops = [turned([x, 0.0], angle, center) for x in (-0.02, 0.0, 0.02)]
        objects = {f"o{i}": skin(p, 0.02, angle, "loud") for i, p in enumerate(tops)}
    else:
        turn = np.pi if kind == "boxes upside down" else 0.0
        objects = {f"o{i}": box(p, (0.02, 0.01), angle + turn * (i % 2), "loud") for i, p in enumerate(places)}
    if kind == "a wall and boxes":
        del objects["o1"]
        objects["o1"] = box(turned([0.0, -0.003], angle, center), (0.02, 0.006), angle, "loud")
    for step in (1.37e-5, 1e-4):  # the second has samples on the seams
        rig = Rig(objects, materials=MATERIALS)
        rig.render(turned(down(-0.025, 0.0005, -0.001, 1e-4), angle, center))
        rig.render(turned(still(-0.025, -0.001, 3000), angle, center), velocity=np.zeros((3000, 2)))
        path = across(-0.025, 0.025, -0.001, step)
        path = np.concatenate([path, path[::-1]])
        samples = rig.render(turned(path, angle, center))
        pushes = turned(force(samples), -angle)
        np.testing.assert_allclose(pushes[:, 1], K * 0.001, rtol=0, atol=1e-9)
        assert np.abs(pushes[:, 0]).max() <= 1e-12
        assert np.abs(samples["vibration_force_n"]).max() <= 1e-9
        assert np.abs(rig.of(EventKind.CONTACT)["amplitude_m_per_s2"]).max() <= 1e-6
        assert len(rig.of(EventKind.CONTACT)) == len(rig.of(EventKind.RELEASE)) == 4


def test_a_seam_that_is_slid_over_while_pressing_on_strikes_nothing() -> None:
    objects = {"a": box((-0.01, -0.005), (0.02, 0.01), 0, "loud"), "b": box((0.01, -0.005), (0.02, 0.01), 0, "loud")}
    rig = Rig(objects, materials=MATERIALS)
    x = np.linspace(-0.002, 0.002, 401)
    rig.render(np.column_stack([np.full(50, -0.002), np.linspace(1e-4, -5e-4, 50)]))
    rig.render(still(-0.002, -5e-4, 3000))
    samples = rig.render(np.column_stack([x, -5e-4 - 1e-4 * np.arange(401) / 400]))
    assert not samples["vibration_force_n"].any()
    assert rig.kinds() == [EventKind.RELEASE, EventKind.CONTACT]


@pytest.mark.parametrize("make", [lambda x: box((x, -0.005), (0.02, 0.01)), lambda x: skin((x, 0), 0.02)])
def test_a_seam_that_is_pressed_exactly_is_held_by_one_of_the_two(make: Callable[[float], dict[str, object]]) -> None:
    rig = Rig({"a": make(-0.01), "b": make(0.01)}, materials=MATERIALS)
    path = down(0.0, 0.0005, -0.001, 1e-5)
    samples = rig.render(path)
    np.testing.assert_allclose(force(samples)[:, 1], K * np.maximum(-path[:, 1], 0), rtol=0, atol=1e-12)
    assert rig.kinds() == [EventKind.CONTACT]


def test_landing_on_a_seam_lands_on_the_floor() -> None:
    """Within one tick over one box, through the common side, into the other: it is the floor that is met."""
    rng = np.random.default_rng(8)
    count = 20_000
    a = np.column_stack([-rng.uniform(0, 0.003, count), rng.uniform(1e-6, 0.002, count)])
    b = np.column_stack([rng.uniform(0, 0.003, count), -rng.uniform(1e-6, 0.002, count)])
    hit = a[:, 0] + (b[:, 0] - a[:, 0]) * a[:, 1] / (a[:, 1] - b[:, 1])
    keep = (np.hypot(*(b - a).T) < 0.00499) & (np.abs(hit) > 1e-9)
    a, b, hit = a[keep], b[keep], hit[keep]
    assert (hit < 0).sum() > 2000
    for order in (("a", "b"), ("b", "a")):
        things = {"a": box((-0.01, -0.005), (0.02, 0.01)), "b": box((0.01, -0.005), (0.02, 0.01))}
        rig = Rig({id: things[id] for id in order}, rate_hz=1000, materials=MATERIALS)
        samples = rig.render(apart(a, b, [1, 1]))
        np.testing.assert_allclose(force(samples[1::3])[:, 1], -K * b[:, 1], rtol=0, atol=1e-11)
        assert not force(samples[1::3])[:, 0].any()


def test_what_lies_behind_a_soft_surface_is_met_at_its_own_time() -> None:
    rate = 1000.0
    for behind in (box((0, -0.006), (0.02, 0.01)), disc((0, -0.006), 0.005), skin((0, -0.001), 0.02)):
        rig = Rig({"skin": skin((0, 0), 0.02), "it": behind}, rate_hz=rate, materials=MATERIALS)
        path = np.column_stack([np.zeros(30), 0.001 - 0.00017 * np.arange(30)])
        samples = rig.render(path)
        first, second = rig.of(EventKind.CONTACT)
        for event, depth in ((first, 0.001), (second, 0.002)):
            assert event["tick"] / rate - event["before_tick_s"] == pytest.approx(depth / 0.17, abs=1e-9)
        expected = K * (np.maximum(-path[:, 1], 0) + np.maximum(-0.001 - path[:, 1], 0))
        np.testing.assert_allclose(force(samples)[:, 1], expected, rtol=0, atol=1e-12)


def test_stacked_and_overlapping_objects_add_up() -> None:
    objects = {
        "low": box((0, -0.005), (0.02, 0.01)),
        "high": box((0.001, 0.005), (0.02, 0.01), 0, "hard"),
        "over": box((0, 0.004), (0.01, 0.014)),
    }
    rig = Rig(objects, materials=MATERIALS)
    path = down(0.0005, 0.012, -0.002, 1.7e-5)
    y = path[:, 1]
    samples = rig.render(path)
    expected = K * np.maximum(0.011 - y, 0) + 2000 * np.maximum(0.01 - y, 0) + K * np.maximum(0 - y, 0)
    limited = np.minimum(expected, 1e9)
    np.testing.assert_allclose(force(samples)[:, 1], limited, rtol=0, atol=1e-9)
    assert np.hypot(*samples["force_n"].T).max() <= 8.9
    assert len(rig.of(EventKind.CONTACT)) == 3
    samples = rig.render(path[::-1])
    assert len(rig.of(EventKind.RELEASE)) == 3
    np.testing.assert_allclose(force(samples)[:, 1], expected[::-1], rtol=0, atol=1e-9)


def acute(kind: str, stiffness: float) -> dict[str, object]:
    """Two surfaces at 10 degrees whose wedge opens upwards."""
    half = np.radians(5)
    objects = {}
    for id, side in (("left", -1), ("right", 1)):
        normal = np.array([-side * np.cos(half), np.sin(half)])
        if kind == "walls":
            objects[id] = {"kind": "wall", "point_m": [0, 0], "normal": normal.tolist(), "material": "stiff"}
        else:
            along = np.array([side * np.sin(half), np.cos(half)])
            center = 0.05 * along - 0.005 * normal
            objects[id] = box(center, (0.1, 0.01), float(np.arctan2(-normal[0], normal[1])), "stiff")
    return {
        "device": {"max_force_n": 8.9, "sim": {"start_m": [0, 0.03]}},
        "materials": {"stiff": {"stiffness_n_per_m": stiffness}},
        "scene": {"objects": objects},
    }


@pytest.mark.parametrize("kind", ["walls", "boxes"])
@pytest.mark.parametrize("exact", [True, False])
def test_inside_an_acute_corner_the_closed_loop_is_bounded(kind: str, exact: bool) -> None:
    """10 degrees, 1 kHz, half the passive limit b > K T/2 for both walls together; a hand pushes in and moves about."""
    damping, period = 0.2 + 5.0, 1e-3
    stiffness = 0.5 * 2 * damping / period / (2 * np.cos(np.radians(5)) ** 2)  # eigenvalue of sum K n n^T
    config = acute(kind, stiffness)
    if exact:
        config["device"] = {
            "sim": {"start_m": [0, 0.03], "encoder_step_m": 0, "force_step_n": 0, "coulomb_friction_n": 0}
        }
    points = [[0, 0, 0.03], [0.3, 0, 0.005], [1, 0.002, -0.005], [1.5, -0.004, -0.01], [2, 0, -0.008], [6, 0, -0.008]]
    run = simulate_run(config, points, 6.0, 1000)
    assert run.truth is not None
    position, pushes = run.truth[:, :2], run.samples["force_n"]
    assert np.isfinite(pushes).all()
    assert np.hypot(*pushes.T).max() <= 8.9
    # The hand of 300 N/m can push the probe no farther than it wants to be; with less than 6 N anyway.
    assert np.abs(position[:, 0]).max() <= 0.005
    assert position[:, 1].min() >= -0.0105
    early, late = position[3000:4000], position[5000:]
    assert np.ptp(late, axis=0).max() <= np.ptp(early, axis=0).max() + 1e-9
    assert np.ptp(late, axis=0).max() <= (1e-6 if exact else 2e-4)


# ---- Updates under the hand --------------------------------------------------------------------------------------


def steps(samples: npt.NDArray[np.void], before: npt.NDArray[np.void]) -> float:
    pushes = np.concatenate([before[-1:], samples])["force_n"]
    return float(np.hypot(*np.diff(pushes, axis=0).T).max())


PRESSED_BOX = box((0, -0.005), (0.02, 0.01))
PRESSED_DISC = disc((0, -0.005), 0.005)
BOX_CHANGES: dict[str, tuple[dict[str, object] | None, bool]] = {
    # What it becomes, and whether the contact stays.
    "lower": (box((0, -0.0052), (0.02, 0.01)), True),
    "higher": (box((0, -0.002), (0.02, 0.01)), True),
    "sideways": (box((0.004, -0.005), (0.02, 0.01)), True),
    "away sideways": (box((0.014, -0.005), (0.02, 0.01)), False),
    "away below": (box((0, -0.015), (0.02, 0.01)), False),
    "far below": (box((0, -5), (0.02, 0.01)), False),
    "far away": (box((7, -5), (0.02, 0.01)), False),
    "larger": (box((0, -0.005), (0.04, 0.013)), True),
    "smaller": (box((0, -0.005), (0.005, 0.0085)), True),
    "beside": (box((0.004, -0.005), (0.005, 0.01)), False),
    "turned": (box((0, -0.005), (0.02, 0.01), np.radians(30)), True),
    "turned back": (box((0, -0.005), (0.02, 0.01), np.radians(-30)), True),
    "upside down": (box((0, -0.005), (0.02, 0.01), np.pi), False),
    "harder": (box((0, -0.005), (0.02, 0.01), 0, "hard"), True),
    "gone": (None, False),
    "a disc": (disc((0, -0.005), 0.006), False),
    "a membrane": (skin((0, 0), 0.02), False),
    "a wall": (wall((0, 0)), False),
}
DISC_CHANGES: dict[str, tuple[dict[str, object] | None, bool]] = {
    "lower": (disc((0, -0.0052), 0.005), True),
    "higher": (disc((0, -0.0045), 0.005), True),
    "sideways": (disc((0.002, -0.005), 0.005), True),
    "away": (disc((0.02, -0.005), 0.005), False),
    "far below": (disc((0, -5), 0.005), False),
    "larger": (disc((0, -0.005), 0.008), True),
    "smaller": (disc((0, -0.005), 0.0043), True),
    "deep": (disc((0, 0.003), 0.005), True),
    "harder": (disc((0, -0.005), 0.005, "hard"), True),
    "gone": (None, False),
    "a box": (box((0, -0.005), (0.02, 0.01)), False),
}


def final_force(thing: dict[str, object] | None, p: Points) -> Points | None:
    """Where the change leaves the probe touching from above: K d along the surface; None where that is not asked."""
    if thing is None:
        return np.zeros(2)
    stiffness = 2000.0 if thing["material"] == "hard" else K
    center = np.array(thing.get("center_m", [0, 0]))
    if thing["kind"] == "disc":
        offset = p - center
        r = float(np.hypot(*offset))
        bearing = p - np.array(PRESSED_DISC["center_m"])
        bearing /= np.hypot(*bearing)
        if r < float(thing["radius_m"]) and offset @ bearing < 0:  # type: ignore[arg-type] # beyond its middle, and held on the side where it was
            return stiffness * (float(thing["radius_m"]) - float(offset @ bearing)) * bearing  # type: ignore[arg-type]
        return stiffness * max(0.0, float(thing["radius_m"]) - r) * offset / r  # type: ignore[arg-type]
    if thing["kind"] == "box":
        width, height = thing["size_m"]  # type: ignore[misc]
        local = turned(p - center, -float(thing["angle_rad"]))  # type: ignore[arg-type]
        if abs(local[0]) > width / 2 or abs(local[1]) > height / 2:
            return np.zeros(2)
        if height / 2 - abs(local[1]) < width / 2 - abs(local[0]):
            flat = np.array([0.0, stiffness * (height / 2 - abs(local[1])) * np.sign(local[1])])
            return turned(flat, float(thing["angle_rad"]))  # type: ignore[arg-type]
    return None


@pytest.mark.parametrize(
    ("before", "changes"),
    [(PRESSED_BOX, change) for change in BOX_CHANGES.items()]
    + [(PRESSED_DISC, change) for change in DISC_CHANGES.items()],
    ids=[f"box {id}" for id in BOX_CHANGES] + [f"disc {id}" for id in DISC_CHANGES],
)
def test_no_update_under_the_hand_steps_the_force(
    before: dict[str, object], changes: tuple[str, tuple[dict[str, object] | None, bool]]
) -> None:
    rate = 10_000
    _, (after, stays) = changes
    rig = Rig({"it": before}, rate_hz=rate, materials=MATERIALS)
    p = np.array([0.001, -0.001])
    rig.render(down(p[0], 0.001, p[1], 1e-5))
    first = rig.render(still(*p, 100))
    assert force(first)[-1, 1] > 0.5
    rig.update({"it": after})
    samples = rig.render(still(*p, 600))
    largest = float(np.hypot(*np.concatenate([first, samples])["force_n"].T).max())
    # Depth and direction change over the ramp together, and what was let go fades out beside what is met.
    assert steps(samples, first) <= 3.0 * largest / (RAMP_S * rate)
    assert largest <= 2.0 * max(float(np.hypot(*samples["force_n"][-1])), float(np.hypot(*first["force_n"][-1])))
    assert (EventKind.RELEASE not in rig.kinds()) is stays
    assert not samples["flags"][-1] & Flag.RAMPING
    expected = final_force(after, p)
    if expected is not None:
        np.testing.assert_allclose(force(samples)[-1], expected, rtol=0, atol=1e-12)


def test_a_box_that_is_moved_again_and_again_is_followed() -> None:
    """Every tenth tick another place, within the ramp of the last: the force follows, and the contact stays."""
    rng = np.random.default_rng(2)
    for kind in ("box", "disc"):
        make = PRESSED_BOX if kind == "box" else PRESSED_DISC
        rig = Rig({"it": make}, materials=MATERIALS)
        rig.render(down(0, 0.001, -0.001, 1e-5))
        last = rig.render(still(0, -0.001, 10))
        for _ in range(200):
            moved = [rng.uniform(-0.0005, 0.0005), -0.005 + rng.uniform(-0.0005, 0.0005)]
            rig.update({"it": {**make, "center_m": moved}})
            samples = rig.render(still(0, -0.001, 10))
            assert steps(samples, last) <= 3 * 1.3 / (RAMP_S * 10_000)
            assert rig.kinds() == []
            last = samples


@pytest.mark.parametrize("thing", [box((0, 0), (0.02, 0.0005)), skin((0, 0), 0.02)], ids=["box", "membrane"])
def test_what_is_thin_is_held_from_the_same_side_after_a_stall(thing: dict[str, object]) -> None:
    """Periods were missed, longer than the ramp: it comes in again, from the side that it was pressed from."""
    rig = Rig({"it": thing}, materials=MATERIALS)
    rig.render(down(0.001, 0.001, -0.001, 1e-5))
    before = rig.render(still(0.001, -0.001, 100))
    samples = rig.render(still(0.001, -0.001, 400), periods=[5000] + [1] * 399)
    assert force(samples)[0, 1] == 0.0
    assert np.all(force(samples)[:, 1] >= 0)
    assert force(samples)[-1, 1] == pytest.approx(float(force(before)[-1, 1]), abs=1e-12)
    assert steps(samples[1:], samples[:1]) <= 1.0 / (RAMP_S * 10_000) * 1.01
    assert not samples["vibration_force_n"].any()
    out = rig.render(down(0.001, 0.002, -0.001, 1e-5)[::-1])
    assert np.all(force(out)[:, 1] >= 0)
    assert rig.kinds() == [EventKind.RELEASE]


def test_a_disc_that_was_gone_through_in_a_tick_is_held_from_the_same_side_after_a_stall() -> None:
    rig = Rig({"it": disc((0, 0), 0.001)}, rate_hz=1000, materials=MATERIALS)
    rig.render([[0.0001, 0.0012], [0.0001, -0.0005]])
    before = rig.render(still(0.0001, -0.0005, 10))
    samples = rig.render(still(0.0001, -0.0005, 400), periods=[500] + [1] * 399)
    np.testing.assert_allclose(force(samples)[-1], force(before)[-1], rtol=0, atol=1e-12)
    assert force(samples)[-1, 1] > 0.5


def test_a_box_behind_the_surface_that_is_pressed_is_not_met_again_and_again() -> None:
    """It appears around a probe that presses a wall, wholly behind that wall's surface."""
    rig = Rig({"wall": wall((0, 0), -np.pi / 2)}, materials=MATERIALS)
    path = np.column_stack([np.linspace(0.0005, -0.002, 300), np.zeros(300)])
    rig.render(path)
    rig.update({"box": box((-0.0055, -0.0045), (0.01, 0.01))})  # its upper face is the nearest one
    samples = rig.render(still(-0.002, 0, 500))
    assert rig.kinds() == []
    np.testing.assert_allclose(force(samples), np.tile([K * 0.002, 0.0], (500, 1)), rtol=0, atol=1e-12)


@pytest.mark.parametrize("make", [lambda x: box((x, -0.005), (0.02, 0.01)), lambda x: skin((x, 0), 0.02)])
def test_a_seam_that_is_slid_over_within_the_ramp_has_no_step(make: Callable[[float], dict[str, object]]) -> None:
    """What is held after a stall comes in over the ramp, and goes on from there on the neighbour."""
    rig = Rig({"a": make(-0.01), "b": make(0.01)}, materials=MATERIALS)
    rig.render(down(-0.0003, 0.0005, -0.001, 1e-5))
    path = across(-0.0003, 0.002, -0.001, 1e-5)
    samples = rig.render(path, periods=[5000] + [1] * (len(path) - 1))
    assert rig.kinds()[-2:] == [EventKind.RELEASE, EventKind.CONTACT]
    assert samples["flags"][int(rig.events[-1]["tick"] - samples["tick"][0])] & Flag.RAMPING
    expected = K * 0.001 * np.minimum(np.arange(len(path)) / (RAMP_S * 10_000), 1.0)
    np.testing.assert_allclose(force(samples)[:, 1], expected, rtol=0, atol=0.01 * K * 0.001)


def test_a_disc_behind_a_soft_surface_is_met_when_the_probe_comes_to_it() -> None:
    """Deep in a wall, towards a disc within it from below its middle: what stands straight above is not met before."""
    comb = {
        "kind": "grooves",
        "display": "vibration",
        "spacing_m": 0.0002,
        "width_m": 0.0001,
        "velocity_gain_per_s": 1000,
        "force_gain_m_per_s2_per_n": 60,
        "frequency_hz": 200,
        "decay_time_s": 0.003,
    }
    materials = {"soft": {"stiffness_n_per_m": 100}, "comb": {"stiffness_n_per_m": K, "texture": comb}}
    rig = Rig({"soft": wall((0, 0), 0, "soft"), "lump": disc((0, -0.005), 0.003, "comb")}, materials=materials)
    rig.render(down(-0.01, 0.0005, -0.006, 1e-5))
    rig.render(across(-0.01, -0.004, -0.006, 1e-5))
    path = across(-0.004, -0.0027, -0.006, 1e-6)
    samples = rig.render(path)
    (contact,) = rig.events
    tick = int(contact["tick"]) - int(samples["tick"][0])
    inside = np.hypot(path[:, 0], path[:, 1] + 0.005) < 0.003
    assert tick == int(np.argmax(inside))
    assert np.ptp(force(samples)[:tick], axis=0).max() <= 1e-12
    assert not samples["vibration_force_n"][:tick].any()
    assert np.hypot(*(force(samples)[tick] - force(samples)[tick - 1])) <= K * 2e-6
