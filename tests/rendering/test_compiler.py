"""The compiler: slots, generations and versions of objects that are added, kept, changed and removed; records."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator, Mapping
from itertools import pairwise
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy import signal

from hapticd.base.core import OBJECT_DTYPE, WAVEFORM_PARTS, CData, Shape, Status, Texture, ffi, invalid_reason, lib
from hapticd.config.materials import Material, shipped_materials, validate_materials
from hapticd.config.scene import Scene, validate_scene
from hapticd.rendering.compiler.table import Compiler, _place_of
from hapticd.rendering.device_output import Output

OUTPUT = Output(10_000, 0.05, 8.9, 5, "mute")
WALL = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"}
SKIN = {"kind": "membrane", "center_m": [0, 0], "normal": [0, 1], "width_m": 0.02, "material": "cellophane"}
BOX = {"kind": "box", "center_m": [0.01, 0.02], "size_m": [0.03, 0.01], "material": "wood"}
DISC = {"kind": "disc", "center_m": [0.01, 0.02], "radius_m": 0.005, "material": "wood"}
PLAIN = {"stiffness_n_per_m": 700}
GRIT = {"kind": "stochastic", "peak_hz": 250, "mean_hz": 310, "velocity_gain_per_s": 40, "seed": 7}
COMB = {"kind": "grooves", "spacing_m": 0.002, "width_m": 0.0005}


def scene(**objects: object) -> Scene:
    return validate_scene({"objects": objects})


def library(**materials: object) -> dict[str, Material]:
    return {**shipped_materials(), **validate_materials(materials)}


SHIPPED = library()


class Taken:
    """A compiler, and a world that takes every table that it gives."""

    def __init__(self, output: Output = OUTPUT) -> None:
        self.compiler = Compiler(output)
        self.world = ffi.gc(lib.hd_world_new(), lib.hd_world_free)
        self.revision = 0

    def take(self, new: Scene, *changed: str, materials: Mapping[str, Material] = SHIPPED) -> Any:
        self.revision += 1
        table = self.compiler.update(new, changed or tuple(new.objects), materials, self.revision)
        assert lib.hd_world_load(self.world, table) == Status.OK, invalid_reason()
        return table

    def slot(self, id: str) -> int:
        place = self.compiler.slot_of(id)
        assert place is not None
        return place[0]

    def object(self, table: Any, id: str) -> Any:
        return table.objects[self.slot(id)]


def changed(table: Any) -> set[int]:
    return {table.changed[index] for index in range(table.changed_count)}


# ---- Slots ---------------------------------------------------------------------------------------------------------


def test_slot_and_generation_stay_with_id_and_kind() -> None:
    taken = Taken()
    compiler = taken.compiler
    taken.take(scene(a=WALL, b=WALL))
    a, b = compiler.slot_of("a"), compiler.slot_of("b")
    assert a is not None
    assert b is not None
    assert a[0] != b[0]
    taken.take(scene(a={**WALL, "point_m": [0, 1]}, b=WALL), "a")
    assert compiler.slot_of("a") == a
    taken.take(scene(a=SKIN, b=WALL), "a")
    turned = compiler.slot_of("a")
    assert turned is not None
    assert turned[1] not in (a[1], b[1])
    assert compiler.slot_of("b") == b
    taken.take(scene(b=WALL), "a")
    assert compiler.slot_of("a") is None
    taken.take(scene(a=SKIN, b=WALL), "a")
    again = compiler.slot_of("a")
    assert again is not None
    assert again[1] != turned[1]
    for place in (a, turned):
        assert compiler.name_of(*place) == "a"  # its events can still be named


def test_free_slots_are_given_out_again_the_lowest_first() -> None:
    taken = Taken()
    table = taken.take(scene(**{f"a{i}": WALL for i in range(100)}))
    assert table.object_count == 100
    kept = {f"a{i}": WALL for i in range(100) if i not in (7, 3, 50)}
    table = taken.take(scene(**kept), "a50", "a3", "a7")
    assert [i for i in range(100) if table.objects[i].shape == Shape.NONE] == [3, 7, 50]
    table = taken.take(scene(**kept, b=BOX), "b")
    assert taken.slot("b") == 3
    table = taken.take(scene(**kept, b=BOX, c=BOX, d=BOX, e=BOX), "c", "d", "e")
    assert [taken.slot(id) for id in "cde"] == [7, 50, 100]
    assert table.object_count == 101


def test_replacing_all_objects_of_a_scene_needs_no_more_slots() -> None:
    taken = Taken()
    full = scene(**{f"a{i}": WALL for i in range(3000)})
    taken.take(full)
    other = scene(**{f"b{i}": DISC for i in range(3000)})
    table = taken.take(other, *other.objects, *full.objects)
    assert table.object_count == 3000
    assert {taken.slot(f"b{i}") for i in range(3000)} == set(range(3000))


def gone(taken: Taken, *ids: str) -> list[tuple[int, int]]:
    """Places of walls that come one by one and go at once, beside one that stays."""
    places = []
    for id in ids:
        taken.take(scene(stays=WALL, **{id: WALL}), id)
        place = taken.compiler.slot_of(id)
        assert place is not None
        places.append(place)
        taken.take(scene(stays=WALL), id)
    return places


def test_names_of_removed_objects_are_kept_until_their_events_are_read() -> None:
    taken = Taken()
    compiler = taken.compiler
    taken.take(scene(stays=WALL))
    stays = compiler.slot_of("stays")
    assert stays is not None
    before = gone(taken, "a", "b")
    read = taken.revision
    after = gone(taken, "c")
    for revision, names in ((read - 1, [None, "b", "c"]), (read, [None, None, "c"]), (taken.revision, [None] * 3)):
        compiler.events_read(revision)
        compiler.update(scene(stays=WALL), (), SHIPPED, taken.revision + 1)
        assert [compiler.name_of(*place) for place in before + after] == names
    assert compiler.name_of(*stays) == "stays"
    assert compiler.name_of(lib.HD_NO_SLOT, 0) is None


def test_names_are_kept_over_the_end_of_revisions() -> None:
    """They count modulo 2**32."""
    taken = Taken()
    compiler = taken.compiler
    taken.take(scene(stays=WALL))
    taken.revision = 0xFFFFFFFC
    places = gone(taken, "a")
    last = taken.revision
    taken.revision = -1
    places += gone(taken, "b")
    for revision, names in ((last - 1, ["a", "b"]), (0, [None, "b"]), (1, [None, None])):
        compiler.events_read(revision)
        compiler.update(scene(stays=WALL), (), SHIPPED, taken.revision + 1)
        assert [compiler.name_of(*place) for place in places] == names


def test_of_one_update_all_names_are_kept() -> None:
    """Contacts with any of them end in the same tick."""
    taken = Taken()
    many = [f"b{index}" for index in range(30)]
    taken.take(scene(**dict.fromkeys(many, WALL)), *many)
    found = [taken.compiler.slot_of(id) for id in many]
    taken.take(scene(), *many)
    assert [taken.compiler.name_of(*place) for place in found if place is not None] == many


# ---- Versions ------------------------------------------------------------------------------------------------------


def versions(record: Any) -> tuple[int, int, int]:
    return record.generation, record.pose_version, record.surface_version


@pytest.mark.parametrize(
    ("change", "place", "skin"),
    [
        ({}, False, False),
        ({"point_m": [0, 0.001]}, True, False),
        ({"normal": [1, 1]}, True, False),
        ({"material": "steel"}, False, True),
        ({"patches": [{"from_m": 0, "to_m": 0.01, "material": "glass"}]}, False, True),
        ({"point_m": [1, 0], "material": "glass"}, True, True),
    ],
)
def test_versions_change_with_the_pose_and_the_surface(change: dict[str, object], place: bool, skin: bool) -> None:
    taken = Taken()
    table = taken.take(scene(a=WALL, b=WALL))
    before, other = versions(taken.object(table, "a")), bytes(ffi.buffer(table.objects + taken.slot("b"), 80))
    taken.compiler.published()
    table = taken.take(scene(a={**WALL, **change}, b=WALL), "a")
    after = versions(taken.object(table, "a"))
    assert after[0] == before[0]
    assert (after[1] != before[1], after[2] != before[2]) == (place, skin)
    assert bytes(ffi.buffer(table.objects + taken.slot("b"), 80)) == other
    assert changed(table) == {taken.slot("a")}
    assert not table.all_changed


def test_versions_of_patches() -> None:
    patches = [{"from_m": 0.0, "to_m": 0.01, "material": "glass"}]
    taken = Taken()
    table = taken.take(scene(a={**WALL, "patches": patches}))
    first = versions(taken.object(table, "a"))
    # Moved: surface and pieces are unchanged, and the pieces keep their place.
    parts = table.parts_version
    table = taken.take(scene(a={**WALL, "patches": patches, "point_m": [0, 1]}))
    assert table.parts_version == parts
    moved = versions(taken.object(table, "a"))
    assert (moved[1] != first[1], moved[2]) == (True, first[2])
    for other in (
        [{"from_m": 0.0, "to_m": 0.02, "material": "glass"}],
        [{"from_m": 0.0, "to_m": 0.02, "material": "steel"}],
        [],
    ):
        table = taken.take(scene(a={**WALL, "patches": other, "point_m": [0, 1]}))
        after = versions(taken.object(table, "a"))
        assert after[1] == moved[1]
        assert after[2] != moved[2]
        moved = after
    table = taken.take(scene(a={**WALL, "patch_ramp_m": 0.002, "patches": patches, "point_m": [0, 1]}))
    assert versions(taken.object(table, "a"))[2] != moved[2]


def test_a_changed_material_reaches_all_that_is_made_of_it_and_nothing_else() -> None:
    patch = {"from_m": 0.0, "to_m": 0.01, "material": "own"}
    objects = {
        "a": {**WALL, "material": "own"},
        "b": BOX,
        "c": {**WALL, "patches": [patch]},
        "d": {**DISC, "material": "own"},
    }
    taken = Taken()
    materials = library(own=PLAIN)
    table = taken.take(scene(**objects), materials=materials)
    taken.compiler.published()
    before = {id: versions(taken.object(table, id)) for id in objects}
    parts = table.parts_version
    table = taken.compiler.update(scene(**objects), (), library(own={"stiffness_n_per_m": 900}), 2)
    assert lib.hd_world_load(taken.world, table) == Status.OK
    after = {id: versions(taken.object(table, id)) for id in objects}
    assert {id for id in objects if after[id] != before[id]} == {"a", "c", "d"}
    assert all(after[id][:2] == before[id][:2] for id in objects)
    assert changed(table) == {taken.slot(id) for id in "acd"}
    assert table.parts_version != parts
    assert table.materials[taken.object(table, "a").material].stiffness_n_per_m == 900
    # The same scene, parsed again: nothing changed.
    taken.compiler.published()
    parts = table.parts_version
    table = taken.compiler.update(scene(**objects), (), library(own={"stiffness_n_per_m": 900}), 3)
    assert not changed(table)
    assert table.parts_version == parts


def test_changes_add_up_until_they_are_published() -> None:
    taken = Taken()
    objects: dict[str, object] = {f"a{i}": BOX for i in range(20)}
    table = taken.take(scene(**objects))
    assert table.all_changed
    taken.compiler.published()
    for index in (3, 7, 3):
        objects[f"a{index}"] = {**BOX, "center_m": [0, 0.01 * index]}
        table = taken.take(scene(**objects), f"a{index}")
    del objects["a9"]
    table = taken.take(scene(**objects), "a9")
    assert changed(table) == {3, 7, 9}
    taken.compiler.published()
    table = taken.take(scene(**objects), "nobody")
    assert not changed(table)
    assert not table.all_changed


def test_a_refused_update_leaves_the_table_unchanged() -> None:
    """Slots and generations too: the servo still has the contacts of these objects."""
    taken = Taken()
    materials = library(own=PLAIN)
    before = scene(a=WALL, b=BOX, c={**DISC, "material": "own"}, d=SKIN, push={"kind": "constant", "force_n": [1, 2]})
    table = taken.take(before, materials=materials)
    taken.compiler.published()
    places = {id: taken.compiler.slot_of(id) for id in before.objects}
    contents = dict(content(table, taken.compiler, before))
    after = scene(
        x=BOX, y=WALL, c=SKIN, d={**SKIN, "width_m": 0.1}, e=DISC, push={"kind": "constant", "force_n": [5, 2]}
    )
    ids = sorted({*before.objects, *after.objects})
    taken.compiler.update(after, ids, library(own={"stiffness_n_per_m": 5}), 2)
    taken.compiler.restore(before, ids, materials, 1)
    taken.compiler.events_read(2)
    table = taken.take(before, "a", materials=materials)
    assert table.all_changed
    assert {id: taken.compiler.slot_of(id) for id in before.objects} == places
    assert dict(content(table, taken.compiler, before)) == contents
    assert (table.field.force_n[0], table.field.force_n[1]) == (1, 2)
    assert all(taken.compiler.slot_of(id) is None for id in "xye")


# ---- Shapes and patches ----------------------------------------------------------------------------------------------


def test_shapes() -> None:
    angle = 0.3
    taken = Taken()
    table = taken.take(scene(wall={**WALL, "normal": [3, 4]}, skin=SKIN, box={**BOX, "angle_rad": angle}, disc=DISC))

    def place(id: str) -> tuple[int, list[float]]:
        record = taken.object(table, id)
        return record.shape, [*record.point_m, *record.normal, *record.half_m]

    assert place("wall") == (Shape.WALL, [0, 0, 0.6, 0.8, 0, 0])
    assert place("skin") == (Shape.MEMBRANE, [0, 0, 0, 1, 0.01, 0])
    assert place("disc") == (Shape.DISC, [0.01, 0.02, 0, 1, 0.005, 0.005])
    shape, numbers = place("box")
    assert shape == Shape.BOX
    x, y, n_x, n_y, half_t, half_n = numbers
    # The corners, as the record has them, against those of the turned rectangle.
    for right in (-1, 1):
        for up in (-1, 1):
            corner = complex(x, y) + right * half_t * complex(n_y, -n_x) + up * half_n * complex(n_x, n_y)
            turned = complex(0.015 * right, 0.005 * up) * complex(math.cos(angle), math.sin(angle))
            assert corner == pytest.approx(complex(0.01, 0.02) + turned, abs=1e-15)


@pytest.mark.long
def test_pieces_name_the_material_at_every_point_of_a_wall() -> None:
    """Against the patches themselves, at every place that is not in a ramp; and every ramp as wide as it may be."""
    rng = random.Random(3)
    names = ["wood", "glass", "steel", "delrin"]
    for _ in range(100):
        edges = sorted(rng.uniform(-0.1, 0.1) for _ in range(2 * rng.randint(1, 6)))
        if min(b - a for a, b in pairwise(edges)) < 2e-5:
            continue
        spans = list(zip(edges[::2], edges[1::2], strict=True))
        if rng.random() < 0.5 and len(spans) > 1:
            spans[1] = (spans[0][1], spans[1][1])  # these two touch
        patches = [{"from_m": a, "to_m": b, "material": rng.choice(names)} for a, b in spans]
        rng.shuffle(patches)
        ramp = 10 ** rng.uniform(-5, -1)
        taken = Taken()
        other = {**WALL, "patches": [{"from_m": -1, "to_m": 1, "material": "glass"}]}
        table = taken.take(scene(other=other, a={**WALL, "patches": patches, "patch_ramp_m": ramp}))
        record = taken.object(table, "a")
        pieces = [table.pieces[record.piece_first + index] for index in range(record.piece_count)]
        stiffness = {name: SHIPPED[name].stiffness_n_per_m for name in names}
        begins = [piece.from_m for piece in pieces[1:]]
        lengths = [math.inf, *np.diff(begins), math.inf]
        for index, piece in enumerate(pieces[1:]):
            assert piece.half_ramp_m == pytest.approx(min(ramp, lengths[index], lengths[index + 1]) / 2, rel=1e-12)
        for s in np.linspace(-0.12, 0.12, 401):
            if any(abs(s - piece.from_m) <= piece.half_ramp_m for piece in pieces[1:]):
                continue
            meant = next((p["material"] for p in patches if p["from_m"] <= s < p["to_m"]), "wood")
            held = pieces[sum(begin <= s for begin in begins)]
            assert table.materials[held.material].stiffness_n_per_m == stiffness[str(meant)]


# ---- Materials -------------------------------------------------------------------------------------------------------


def test_only_materials_in_use_are_in_the_table_and_their_places_are_used_again() -> None:
    taken = Taken()
    table = taken.take(scene(a=WALL, b={**BOX, "material": "steel"}))
    assert table.material_count == 2
    steel = taken.object(table, "b").material
    table = taken.take(scene(a=WALL), "b")
    for name in ("glass", "delrin", "acrylic"):
        table = taken.take(scene(a=WALL, b={**BOX, "material": name}), "b")
        table = taken.take(scene(a=WALL), "b")
    assert table.material_count == 2
    table = taken.take(scene(a=WALL, b={**BOX, "material": "glass"}), "b")
    assert taken.object(table, "b").material == steel
    assert table.materials[steel].stiffness_n_per_m == SHIPPED["glass"].stiffness_n_per_m


def test_the_record_of_a_surface() -> None:
    tap = {"attack_slope_per_s": 300, "frequency_hz": 100, "decay_time_s": 0.01, "attack": "first_peak"}
    friction = {"coefficient": 0.3, "stiffness_n_per_m": 400}
    rupture = {"max_strain": 0.5, "radius_m": 0.01, "amplitude_m_per_s2": 38, "heals": True}
    own = {
        "stiffness_n_per_m": 700,
        "damping_n_s_per_m": 2,
        "tap": tap,
        "friction": friction,
        "rupture": {**rupture, "decay_rate_per_s": 330, "angular_frequency_rad_per_s": 1260},
    }
    taken = Taken()
    table = taken.take(scene(a={**WALL, "material": "own"}), materials=library(own=own))
    record = table.materials[taken.object(table, "a").material]
    assert (record.stiffness_n_per_m, record.damping_n_s_per_m) == (700, 2)
    assert (record.friction_coefficient, record.friction_stiffness_n_per_m) == (0.3, 400)
    assert record.heals == 1
    assert record.rupture_depth_m == pytest.approx(0.01 * math.sqrt(1.5**2 - 1), rel=1e-14)
    assert record.texture == Texture.NONE
    w, b = 2 * math.pi * 100, 100.0
    assert complex(record.tap.rotor_re, record.tap.rotor_im) == pytest.approx(np.exp(complex(-b, w) * 1e-4), rel=1e-14)
    scan = np.exp(-b * (t := np.linspace(0, 0.01, 1_000_001))) * np.sin(w * t)
    assert record.tap.peak == pytest.approx(scan.max(), rel=1e-9)
    assert record.tap.peak_time_s == pytest.approx(t[scan.argmax()], abs=1e-7)
    assert record.tap.end_s == pytest.approx(0.05)
    assert record.tap.amplitude_per_unit == 300
    assert record.tap.force_per_unit == pytest.approx(0.05 * 300 / scan.max(), rel=1e-9)
    assert record.rupture.amplitude_per_unit == 38
    assert record.rupture.force_per_unit == pytest.approx(0.05 * 38)


def test_the_record_of_grooves() -> None:
    tap = {"attack_slope_per_s": 300, "frequency_hz": 100, "decay_time_s": 0.01}
    gains = {"velocity_gain_per_s": 1200, "force_gain_m_per_s2_per_n": 63.4}
    materials = library(
        taps={**PLAIN, "tap": tap, "texture": {**COMB, "display": "vibration", **gains}},
        own={
            **PLAIN,
            "tap": tap,
            "texture": {**COMB, "display": "vibration", **gains, "frequency_hz": 200, "decay_time_s": 0.003},
        },
        fast={
            **PLAIN,
            "texture": {**COMB, "display": "vibration", **gains, "frequency_hz": 4001, "decay_time_s": 0.003},
        },
        shape={**PLAIN, "texture": {**COMB, "display": "geometry", "depth_m": 0.0003}},
        drag={**PLAIN, "texture": {**COMB, "display": "damping", "damping_n_s_per_m": 4}},
    )
    names = ("taps", "own", "fast", "shape", "drag")
    taken = Taken()
    table = taken.take(scene(**{name: {**WALL, "material": name} for name in names}), materials=materials)
    taps, own, fast, shape, drag = (table.materials[taken.object(table, name).material] for name in names)
    for record in (taps, own, fast, shape, drag):
        assert (record.spacing_m, record.width_m) == (0.002, 0.0005)
    for record, hertz in ((taps, 100), (own, 200)):
        assert record.texture == Texture.STRIKES
        assert (record.velocity_gain_per_s, record.force_gain_m_per_s2_per_n) == (1200, 63.4)
        assert record.groove.angular_frequency_rad_per_s == pytest.approx(2 * math.pi * hertz)
        assert (record.groove.amplitude_per_unit, record.groove.force_per_unit) == (1, 0.05)
    assert fast.groove.force_per_unit == 0  # above 0.4 of the rate: muted
    assert (shape.texture, shape.depth_m) == (Texture.GEOMETRY, 0.0003)
    assert (drag.texture, drag.drag_n_s_per_m) == (Texture.DRAG, 4)


# ---- Noise -----------------------------------------------------------------------------------------------------------


def noise_of(taken: Taken, table: Any, id: str) -> tuple[Any, np.ndarray[Any, Any], np.ndarray[Any, Any], Any]:
    """An object's noise, its speeds, forces, and nodes (speeds, forces, numbers of a node)."""
    material = table.materials[taken.object(table, id).material]
    assert material.texture == Texture.NOISE
    record = table.noises[material.noise]
    numbers = np.array(ffi.unpack(table.numbers, table.number_count))[record.first :]
    speeds, numbers = np.split(numbers, [record.speed_count])
    forces, numbers = np.split(numbers, [record.force_count])
    size = 1 + record.order + (record.order + 1 if record.taps else 0)
    nodes = numbers[: len(speeds) * len(forces) * size].reshape(len(speeds), len(forces), size)
    return record, speeds, forces, nodes


def response(node: np.ndarray[Any, Any], order: int, count: int = 1 << 16) -> np.ndarray[Any, Any]:
    """The impulse response of a node's normalised lattice, stage by stage as Gray and Markel draw it."""
    k, v = node[1 : 1 + order], node[1 + order :] if len(node) > 1 + order else None
    c = np.sqrt(1 - k**2)
    state = np.zeros(order)
    out = np.zeros(count)
    for n in range(count):
        f = 1.0 if n == 0 else 0.0
        g = np.zeros(order + 1)
        for m in range(order, 0, -1):
            f, g[m] = c[m - 1] * f - k[m - 1] * state[m - 1], k[m - 1] * f + c[m - 1] * state[m - 1]
        g[0] = f
        state = g[:order]
        out[n] = g[0] if v is None else float(np.dot(v, g))
    return out


def test_stochastic_noise_has_unit_power_and_its_peak() -> None:
    own = {
        **PLAIN,
        "texture": {**GRIT, "force_gain_m_per_s2_per_n": 5, "threshold_m_per_s": 0.003, "direction": "normal"},
    }
    taken = Taken()
    table = taken.take(scene(a={**WALL, "material": "own"}), materials=library(own=own))
    record, speeds, forces, nodes = noise_of(taken, table, "a")
    assert (record.velocity_gain_per_s, record.force_gain_m_per_s2_per_n, record.threshold_m_per_s) == (40, 5, 0.003)
    assert (record.along_normal, record.seed, record.force_per_unit) == (1, 7, 0.05)
    assert (len(speeds), len(forces), nodes[0, 0, 0]) == (1, 1, 0)
    h = response(nodes[0, 0], record.order, 1 << 13)
    assert np.sum(h**2) == pytest.approx(1, rel=1e-6)
    power = np.abs(np.fft.rfft(h, 1 << 16)) ** 2
    hertz = np.fft.rfftfreq(1 << 16, 1e-4)
    assert hertz[power.argmax()] == pytest.approx(250, rel=0.03)
    assert np.sum(hertz * power) / np.sum(power) == pytest.approx(310, rel=0.03)


@pytest.mark.parametrize("undisplayable", ["mute", "lower"])
def test_noise_that_the_rate_cannot_carry(undisplayable: Any) -> None:
    taken = Taken(Output(1000, 0.05, 8.9, 5, undisplayable))
    own = {**PLAIN, "texture": {**GRIT, "peak_hz": 450, "mean_hz": 450}}
    table = taken.take(scene(a={**WALL, "material": "own"}), materials=library(own=own))
    record, _, _, nodes = noise_of(taken, table, "a")
    assert record.force_per_unit == (0 if undisplayable == "mute" else 0.05)
    if undisplayable == "lower":
        power = np.abs(np.fft.rfft(response(nodes[0, 0], record.order, 1 << 12), 1 << 16)) ** 2
        assert np.fft.rfftfreq(1 << 16, 1e-3)[power.argmax()] == pytest.approx(400, rel=0.03)


def test_autoregressive_noise_has_the_power_of_its_models() -> None:
    """RMS of a model: given, or that of white noise of its innovation's variance through 1/A, from scipy's impulse
    response."""
    models = [
        {"speed_m_per_s": 0.05, "force_n": 0.5, "coefficients": [-1.5, 0.8], "variance_m2_per_s4": 4},
        {"speed_m_per_s": 0.2, "force_n": 0.5, "coefficients": [-1.2, 0.9, -0.1], "rms_m_per_s2": 3},
        {"speed_m_per_s": 0.05, "force_n": 2, "coefficients": [-0.5], "rms_m_per_s2": 1},
    ]
    own = {**PLAIN, "texture": {"kind": "autoregressive", "rate_hz": 10_000, "seed": 5, "models": models}}
    taken = Taken()
    table = taken.take(scene(a={**WALL, "material": "own"}), materials=library(own=own))
    record, speeds, forces, nodes = noise_of(taken, table, "a")
    assert (record.order, record.taps, record.seed, record.along_normal) == (3, 0, 5, 0)
    assert (record.velocity_gain_per_s, record.force_gain_m_per_s2_per_n) == (0, 0)
    assert (speeds.tolist(), forces.tolist()) == ([0.05, 0.2], [0.5, 2])
    impulse = np.eye(1, 1 << 13)[0]
    for model, node in zip(models, (nodes[0, 0], nodes[1, 0], nodes[0, 1]), strict=True):
        h = signal.lfilter([1.0], [1.0, *model["coefficients"]], impulse)  # type: ignore[misc]
        variance = model.get("variance_m2_per_s4", 0)
        rms = model.get("rms_m_per_s2", math.sqrt(variance * np.sum(h**2)))  # type: ignore[operator]
        assert node[0] == pytest.approx(rms, rel=1e-9)
        assert response(node, 3, 1 << 13) == pytest.approx(h / math.sqrt(np.sum(h**2)), abs=1e-9)


def test_autoregressive_noise_at_another_rate_keeps_the_power_in_its_band() -> None:
    a = np.poly([0.97 * np.exp(0.2j), 0.97 * np.exp(-0.2j), 0.6, -0.6]).real
    model = {"speed_m_per_s": 0.1, "force_n": 1, "coefficients": a[1:].tolist(), "variance_m2_per_s4": 4}
    own = {**PLAIN, "texture": {"kind": "autoregressive", "rate_hz": 10_000, "models": [model]}}
    taken = Taken(Output(2000, 0.05, 8.9, 5, "mute"))
    table = taken.take(scene(a={**WALL, "material": "own"}), materials=library(own=own))
    _, _, _, nodes = noise_of(taken, table, "a")
    w = np.linspace(0, math.pi, 200_001)
    density = 4 / np.abs(np.polyval(a[::-1], np.exp(-1j * w))) ** 2 / math.pi
    inside = w <= math.pi / 5
    assert nodes[0, 0, 0] == pytest.approx(math.sqrt(np.trapezoid(density[inside], w[inside])), rel=1e-3)


def test_places_of_noises_stay_and_are_used_again() -> None:
    """A contact's noise goes on through updates of other materials."""
    materials = library(**{name: {**PLAIN, "texture": {**GRIT, "seed": seed}} for seed, name in enumerate("pqr")})
    walls = {name: {**WALL, "material": name} for name in "pqr"}
    taken = Taken()
    table = taken.take(scene(**walls), materials=materials)
    place = table.materials[taken.object(table, "r").material].noise
    table = taken.take(scene(r=walls["r"], plain=WALL), "p", "q", "plain", materials=materials)
    assert table.materials[taken.object(table, "r").material].noise == place
    assert noise_of(taken, table, "r")[0].seed == 2
    table = taken.take(scene(**walls), "p", "q", materials=materials)
    assert table.noise_count == 3
    assert [noise_of(taken, table, name)[0].seed for name in "pqr"] == [0, 1, 2]
    table = taken.take(scene(plain=WALL), "p", "q", "r", materials=materials)
    assert table.noise_count == 3  # silence, each of them


# ---- Fields ----------------------------------------------------------------------------------------------------------


def test_fields_add_up_and_only_their_change_is_a_new_version() -> None:
    taken = Taken()
    spring = {"kind": "spring", "center_m": [0.5, 0], "stiffness_n_per_m": 10, "damping_n_s_per_m": 1}
    honey = {"kind": "viscous", "damping_n_s_per_m": 2}
    push = {"kind": "constant", "force_n": [1, -1]}
    table = taken.take(scene(s=spring, h=honey, p=push))
    field = table.field
    assert (field.force_n[0], field.force_n[1]) == (6, -1)
    assert (field.stiffness_n_per_m, field.damping_n_s_per_m) == (10, 3)
    version = table.field_version
    taken.take(scene(s=spring, h=honey, p=push, w=WALL), "w", "s")
    assert table.field_version == version
    taken.take(scene(s=spring, w=WALL), "h", "p")
    assert table.field_version != version
    assert (field.force_n[0], field.damping_n_s_per_m) == (5, 1)


def test_sums_of_fields_are_exact_however_often_they_come_and_go() -> None:
    rng = random.Random(1)
    taken = Taken()
    objects: dict[str, Any] = {}
    for step in range(400):
        id = f"f{rng.randrange(30)}"
        if id in objects and rng.random() < 0.4:
            del objects[id]
        else:
            size = 10 ** rng.uniform(-300, 2)
            objects[id] = {"kind": "constant", "force_n": [rng.uniform(-size, size), rng.choice([0.1, 0.2, 5e-324])]}
        table = taken.compiler.update(scene(**objects), [id], SHIPPED, step)
    for axis in range(2):
        assert table.field.force_n[axis] == math.fsum(item["force_n"][axis] for item in objects.values())


# ---- Updates against a fresh start -----------------------------------------------------------------------------------


def content(table: Any, compiler: Compiler, of: Scene) -> Iterator[tuple[str, object]]:
    """What a table says of each object, without the numbers of slots, versions, materials and noises."""

    def material(index: int) -> object:
        copy = ffi.new("struct hd_material *")
        copy[0] = table.materials[index]
        copy.noise = copy.tap_first = copy.tune_first = copy.mode_first = copy.wave_first = 0
        if copy.tap_count or copy.mode_count or copy.wave_count:
            parts = (
                (table.materials[index].tap_first, 2 * copy.tap_count),
                (table.materials[index].mode_first, 3 * copy.mode_count),
                (table.materials[index].wave_first, copy.wave_count and copy.wave_count + WAVEFORM_PARTS),
            )
            return bytes(ffi.buffer(copy)), [bytes(ffi.buffer(table.numbers + first, 8 * n)) for first, n in parts]
        if copy.texture != Texture.NOISE:
            return bytes(ffi.buffer(copy))
        noise = ffi.new("struct hd_noise *")
        noise[0] = table.noises[table.materials[index].noise]
        first, noise.first, noise.version = noise.first, 0, 0
        size = 1 + noise.order + (noise.order + 1 if noise.taps else 0)
        count = noise.speed_count + noise.force_count + noise.speed_count * noise.force_count * size
        return bytes(ffi.buffer(copy)), bytes(ffi.buffer(noise)), bytes(ffi.buffer(table.numbers + first, 8 * count))

    for id in of.objects:
        place = compiler.slot_of(id)
        if place is not None:
            record = table.objects[place[0]]
            pieces = [table.pieces[record.piece_first + index] for index in range(record.piece_count)]
            yield (
                id,
                (
                    record.shape,
                    [*record.point_m, *record.normal, *record.half_m],
                    material(record.material),
                    [(piece.from_m, piece.half_ramp_m, material(piece.material)) for piece in pieces],
                ),
            )


@pytest.mark.long
def test_any_sequence_of_updates_ends_where_a_fresh_start_does() -> None:
    rng = random.Random(11)
    curves = [[[0.1, 5]], [[0.1, 5], [0.2, 7], [0.5, 8]]]
    modes: list[dict[str, object]] = [
        {"frequency_hz": 100, "decay_time_s": 0.01},
        {"mode_table": {"speeds_m_per_s": [0.1], "frequencies_hz": [90], "decay_times_s": [0.02]}},
        {"mode_table": {"speeds_m_per_s": [0.1, 0.2], "frequencies_hz": [90, 80], "decay_times_s": [0.02, 0.01]}},
        {"waveform": {"rate_hz": 2000, "samples": [0, 1, 0]}},
        {"waveform": {"rate_hz": 2000, "samples": [0, 1, -0.5, 0]}},
    ]
    textures: list[object] = [None, GRIT, {**GRIT, "seed": 9}, {**COMB, "display": "geometry", "depth_m": 0.0002}]

    def material() -> dict[str, object]:
        texture = rng.choice(textures)
        tap: dict[str, object] = {**rng.choice(modes), "amplitudes": rng.choice(curves)}
        made = {"stiffness_n_per_m": rng.choice([500, 600]), **({} if texture is None else {"texture": texture})}
        return made if texture is not None or rng.random() < 0.5 else {**made, "tap": tap}

    def thing() -> dict[str, object]:
        name = rng.choice(["m0", "m1", "m2", "m3", "wood", "steel"])
        spring = {"kind": "viscous", "damping_n_s_per_m": rng.randrange(3)}
        patches = [{"from_m": 0.01 * i, "to_m": 0.01 * i + 0.005, "material": f"m{i}"} for i in range(rng.randrange(4))]
        kinds: list[dict[str, Any]] = [WALL, {**WALL, "patches": patches}, SKIN, BOX, DISC]
        return spring if rng.random() < 0.1 else {**rng.choice(kinds), "material": name}

    definitions = {f"m{i}": material() for i in range(4)}
    objects: dict[str, object] = {}
    materials = library(**definitions)
    taken = Taken()
    for step in range(300):
        touched = rng.sample([f"o{i}" for i in range(12)], rng.randint(1, 3))
        for id in touched:
            if rng.random() < 0.3:
                objects.pop(id, None)
            else:
                objects[id] = thing()
        if rng.random() < 0.2:
            definitions[f"m{rng.randrange(4)}"] = material()
            materials = library(**definitions)
        now = scene(**objects)
        if rng.random() < 0.1:  # refused: as if it had not been
            extra = scene(**{**objects, **{id: thing() for id in (*touched, "o0", "new")}})
            ids = [*touched, "o0", "new"]
            taken.take(now, *touched, materials=materials)
            places = {id: taken.compiler.slot_of(id) for id in objects}
            taken.compiler.update(extra, ids, library(**{**definitions, "m1": material()}), step)
            taken.compiler.restore(now, ids, materials, step)
            assert {id: taken.compiler.slot_of(id) for id in objects} == places
        table = taken.take(now, *touched, materials=materials)
        fresh = Taken()
        expected = fresh.take(now, materials=materials) if objects else None
        if expected is not None:
            assert dict(content(table, taken.compiler, now)) == dict(content(expected, fresh.compiler, now))
            assert table.field.damping_n_s_per_m == expected.field.damping_n_s_per_m
        assert table.object_count <= 13


def test_records_lie_as_the_header_says() -> None:
    """Through numpy's view of the same memory, field by field."""
    taken = Taken()
    table: CData = taken.take(scene(a=WALL, b={**BOX, "material": "steel"}))
    array = np.frombuffer(ffi.buffer(table.objects, 2 * OBJECT_DTYPE.itemsize), OBJECT_DTYPE)
    assert array["shape"].tolist() == [Shape.WALL, Shape.BOX]
    assert array["half_m"].tolist() == [[0, 0], [0.015, 0.005]]
    assert array["point_m"].tolist() == [[0, 0], [0.01, 0.02]]
    assert array["unused"].tolist() == [0, 0]


def test_a_shape_that_the_compiler_does_not_know_is_not_taken_for_another() -> None:
    with pytest.raises(AssertionError):
        _place_of(cast("Any", SimpleNamespace(kind="cone")))
