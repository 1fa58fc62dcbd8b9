"""The compiler: slots, generations and versions of objects that come, stay, change and go."""

from __future__ import annotations

from hapticd.compile import Compiler, Output
from hapticd.core import Status, lib
from hapticd.materials import shipped_materials
from hapticd.scene import MAX_OBJECTS, Scene, validate_scene

OUTPUT = Output(10_000, 0.05, 8.9, 5, "mute")
WALL = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"}
SKIN = {"kind": "membrane", "center_m": [0, 0], "normal": [0, 1], "width_m": 0.02, "material": "cellophane"}


def scene(**objects: object) -> Scene:
    return validate_scene({"objects": objects})


def take(compiler: Compiler, new: Scene, revision: int, *changed: str) -> object:
    table = compiler.update(new, changed, shipped_materials(), revision)
    assert lib.hd_table_check(table, MAX_OBJECTS) == Status.OK
    return table


def test_slot_and_generation_stay_with_id_and_kind() -> None:
    compiler = Compiler(OUTPUT)
    take(compiler, scene(a=WALL, b=WALL), 1, "a", "b")
    a, b = compiler.slot_of("a"), compiler.slot_of("b")
    assert a is not None
    assert b is not None
    assert a[0] != b[0]
    take(compiler, scene(a={**WALL, "point_m": [0, 1]}, b=WALL), 2, "a")
    assert compiler.slot_of("a") == a
    take(compiler, scene(a=SKIN, b=WALL), 3, "a")
    turned = compiler.slot_of("a")
    assert turned is not None
    assert turned[1] not in (a[1], b[1])
    assert compiler.slot_of("b") == b
    take(compiler, scene(b=WALL), 4, "a")
    assert compiler.slot_of("a") is None
    take(compiler, scene(a=SKIN, b=WALL), 5, "a")
    again = compiler.slot_of("a")
    assert again is not None
    assert again[1] != turned[1]
    assert compiler.name_of(*turned) == "a"  # events of what has gone can still be told


def test_version_changes_with_the_surface_only() -> None:
    compiler = Compiler(OUTPUT)
    table = take(compiler, scene(a=WALL), 1, "a")
    first = table.walls[0].key.version  # type: ignore[attr-defined]
    table = take(compiler, scene(a={**WALL, "material": "steel"}), 2, "a")
    assert table.walls[0].key.version == first  # type: ignore[attr-defined]  # same stiffness, another tap
    table = take(compiler, scene(a={**WALL, "normal": [1, 1]}), 3, "a")
    assert table.walls[0].key.version != first  # type: ignore[attr-defined]


def test_fullest_scene_can_be_replaced_by_another() -> None:
    compiler = Compiler(OUTPUT)
    full = scene(**{f"a{i}": WALL for i in range(MAX_OBJECTS)})
    take(compiler, full, 1, *full.objects)
    other = scene(**{f"b{i}": WALL for i in range(MAX_OBJECTS)})
    table = take(compiler, other, 2, *other.objects, *full.objects)
    assert table.wall_count == MAX_OBJECTS  # type: ignore[attr-defined]
    places = {compiler.slot_of(f"b{i}") for i in range(MAX_OBJECTS)}
    assert len({place[0] for place in places if place}) == MAX_OBJECTS


def test_fields_add_up_and_only_their_change_is_a_new_version() -> None:
    compiler = Compiler(OUTPUT)
    spring = {"kind": "spring", "center_m": [0.5, 0], "stiffness_n_per_m": 10, "damping_n_s_per_m": 1}
    honey = {"kind": "viscous", "damping_n_s_per_m": 2}
    push = {"kind": "constant", "force_n": [1, -1]}
    table = take(compiler, scene(s=spring, h=honey, p=push), 1, "s", "h", "p")
    field = table.field  # type: ignore[attr-defined]
    assert (field.force_n[0], field.force_n[1]) == (6, -1)
    assert (field.stiffness_n_per_m, field.damping_n_s_per_m) == (10, 3)
    version = table.field_version  # type: ignore[attr-defined]
    take(compiler, scene(s=spring, h=honey, p=push, w=WALL), 2, "w", "s")
    assert table.field_version == version  # type: ignore[attr-defined]
    take(compiler, scene(s=spring, w=WALL), 3, "h", "p")
    assert table.field_version != version  # type: ignore[attr-defined]
    assert (field.force_n[0], field.damping_n_s_per_m) == (5, 1)
