"""Scenes: every kind of object, faults and their places, names of materials, and round trips."""

import math
import pathlib
from itertools import pairwise
from random import Random

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from hapticd.base.errors import InvalidError, Problem
from hapticd.base.model import MAX_FAULTS
from hapticd.base.yaml_source import Json
from hapticd.config.materials import shipped_materials
from hapticd.config.scene import (
    MAX_OBJECTS,
    Scene,
    Viscous,
    Wall,
    load_scene,
    materials_of,
    reference_problems,
    scene_steps,
    used_materials,
    validate_object,
    validate_scene,
)

WALL: dict[str, Json] = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"}
MEMBRANE: dict[str, Json] = {
    "kind": "membrane",
    "center_m": [0, 0.03],
    "normal": [3, 4],
    "width_m": 0.02,
    "material": "cellophane",
}
SPRING: dict[str, Json] = {"kind": "spring", "center_m": [0, 0], "stiffness_n_per_m": 50}
VISCOUS: dict[str, Json] = {"kind": "viscous", "damping_n_s_per_m": 2}
CONSTANT: dict[str, Json] = {"kind": "constant", "force_n": [0, -0.2]}
BOX: dict[str, Json] = {"kind": "box", "center_m": [0.03, 0.02], "size_m": [0.02, 0.01], "material": "wood"}
DISC: dict[str, Json] = {"kind": "disc", "center_m": [-0.03, 0.02], "radius_m": 0.005, "material": "glass"}
ALL: dict[str, Json] = {
    "a": WALL,
    "b": MEMBRANE,
    "c": SPRING,
    "d": VISCOUS,
    "e": CONSTANT,
    "f": BOX,
    "g": DISC,
}
NO_PATCHES: dict[str, Json] = {"patches": [], "patch_ramp_m": 0.001}


def faults(name: str, data: Json) -> dict[str, str]:
    with pytest.raises(InvalidError) as caught:
        validate_object(name, data)
    return {problem.where: problem.problem for problem in caught.value.problems}


def test_every_kind() -> None:
    scene = validate_scene({"objects": ALL})
    assert scene.to_dict() == {
        "display": {"force": True, "vibration": True},
        "ramp_s": 0.02,
        "passivity": "off",
        "objects": {
            **ALL,
            "a": {**WALL, **NO_PATCHES},
            "b": {**MEMBRANE, "normal": [0.6, 0.8]},
            "c": {**SPRING, "damping_n_s_per_m": 0},
            "f": {**BOX, "angle_rad": 0},
        },
    }


components = st.floats(-1e9, 1e9)


@given(components, components)
def test_normals_become_unit_vectors_once(x: float, y: float) -> None:
    assume(math.hypot(x, y) >= 1e-9)
    wall = validate_object("w", {**WALL, "normal": [x, y]})
    assert isinstance(wall, Wall)
    assert math.hypot(*wall.normal) == pytest.approx(1, abs=1e-15)
    assert math.atan2(wall.normal[1], wall.normal[0]) == pytest.approx(math.atan2(y, x), abs=1e-15)
    again = validate_object("w", wall.to_dict())
    assert isinstance(again, Wall)
    assert again.normal == wall.normal


@pytest.mark.parametrize("normal", [[0, 0], [1e-10, 0], [0.0, -0.0]])
def test_a_normal_needs_a_direction(normal: Json) -> None:
    ((where, problem),) = faults("table", {**WALL, "normal": normal}).items()
    assert where == "objects.table.normal"
    assert "a length of at least 1e-09" in problem


def test_the_path_of_a_fault_does_not_contain_the_kind() -> None:
    bad: dict[str, Json] = {**WALL, "normal": [1, "x"], "wall": 1, "material": ""}
    for name in ("table", "wall", "spring", "objects"):
        assert faults(name, bad) == {
            f"objects.{name}.normal[1]": 'should be a valid number, is "x"',
            f"objects.{name}.material": 'String should have at least 1 character, is ""',
            f"objects.{name}.wall": "unknown key; known: kind, point_m, normal, material, patches, patch_ramp_m",
        }


@pytest.mark.parametrize(
    ("data", "where", "problem"),
    [
        ({}, "objects.o.kind", "Field required"),
        (
            {"kind": "wal"},
            "objects.o.kind",
            "should be one of 'wall', 'membrane', 'box', ",
        ),
        ({"kind": 3}, "objects.o.kind", "'constant', is \"3\""),
        ({"kind": ["wall"]}, "objects.o.kind", "should be one of 'wall'"),
        ({"kind": None}, "objects.o.kind", "should be one of 'wall'"),
        (None, "objects.o", "should be a mapping, is null"),
        ([], "objects.o", "should be a mapping, is a list"),
        ("wall", "objects.o", 'should be a mapping, is "wall"'),
        ({**WALL, "point_m": [0]}, "objects.o.point_m[1]", "Field required"),
        (
            {**WALL, "point_m": [0, 0, 0]},
            "objects.o.point_m",
            "List should have at most 2 items after validation, not 3",
        ),
        ({**WALL, "point_m": 0}, "objects.o.point_m", "should be a list, is 0"),
        ({**WALL, "point_m": "00"}, "objects.o.point_m", 'should be a list, is "00"'),
        ({**WALL, "point_m": {"x": 0}}, "objects.o.point_m", "should be a list, is a mapping"),
        ({**WALL, "point_m": [11, 0]}, "objects.o.point_m[0]", "should be less than or equal to 10, is 11"),
        ({**WALL, "point_m": [0, math.nan]}, "objects.o.point_m[1]", "should be a finite number, is nan"),
        ({**WALL, "point_m": [0, -math.inf]}, "objects.o.point_m[1]", "should be a finite number, is -inf"),
        ({**WALL, "point_m": [0, True]}, "objects.o.point_m[1]", "should be a valid number, is true"),
        ({**BOX, "size_m": [1]}, "objects.o.size_m[1]", "Field required"),
        ({**BOX, "size_m": [1, 0]}, "objects.o.size_m[1]", "should be greater than or equal to 0.0001, is 0"),
        ({**BOX, "size_m": [-1, 1]}, "objects.o.size_m[0]", "should be greater than or equal to 0.0001, is -1"),
        ({**BOX, "angle_rad": math.inf}, "objects.o.angle_rad", "should be a finite number, is inf"),
        ({**DISC, "radius_m": 0}, "objects.o.radius_m", "should be greater than or equal to 0.0001, is 0"),
        ({**DISC, "normal": [0, 1]}, "objects.o.normal", "unknown key; known: kind, center_m, radius_m, material"),
        ({**WALL, "patches": None}, "objects.o.patches", "should be a list, is null"),
        ({**WALL, "patches": {}}, "objects.o.patches", "should be a list, is a mapping"),
        ({**WALL, "patches": [3]}, "objects.o.patches[0]", "should be a mapping, is 3"),
        ({**WALL, "patch_ramp_m": 0}, "objects.o.patch_ramp_m", "should be greater than or equal to 0.00001, is 0"),
        (
            {**SPRING, "stiffness_n_per_m": -1},
            "objects.o.stiffness_n_per_m",
            "should be greater than or equal to 0, is -1",
        ),
        ({**SPRING, "stifness_n_per_m": 1}, "objects.o.stifness_n_per_m", "did you mean stiffness_n_per_m?"),
        ({**VISCOUS, "damping_n_s_per_m": None}, "objects.o.damping_n_s_per_m", "should be a valid number, is null"),
        (
            {**CONSTANT, "force_n": [0, 10**400]},
            "objects.o.force_n[1]",
            "should be a valid number, is an integer of 1329 bits",
        ),
    ],
)
def test_faults_of_an_object(data: Json, where: str, problem: str) -> None:
    ((found_where, found),) = faults("o", data).items()
    assert found_where == where
    assert problem in found


def test_faults_begin_with_the_root() -> None:
    with pytest.raises(InvalidError, match=r"^params\.objects\.table\.kind: Field required$"):
        validate_object("table", {}, ("params",))
    with pytest.raises(InvalidError, match=r"^scene\.ramp_s: should be less than or equal to 1, is 2$"):
        validate_scene({"ramp_s": 2}, ("scene",))
    with pytest.raises(InvalidError, match=r"^scene: should be a mapping, is null$"):
        validate_scene(None, ("scene",))


def test_bad_ids() -> None:
    assert faults("a.b", WALL) == {'objects."a.b"': 'must not hold a dot or a control character: "a.b"'}
    assert faults("", WALL) == {'objects.""': 'String should have at least 1 character, is ""'}


@pytest.mark.slow
def test_number_of_objects_is_limited() -> None:
    one = validate_object("one", VISCOUS)
    objects: dict[str, object] = {f"o{i}": one for i in range(MAX_OBJECTS)}
    scene = validate_scene({"objects": objects})
    objects["one"] = one
    with pytest.raises(InvalidError, match="objects: must hold at most 10000 entries, holds 10001"):
        validate_scene({"objects": objects})
    with pytest.raises(InvalidError, match="objects: must hold at most 10000 entries, holds 10001"):
        scene.with_objects({"one": one})
    assert len(scene.with_objects({"one": one, "o1": None}).objects) == MAX_OBJECTS


def test_changes_leave_other_objects_unchanged() -> None:
    scene = validate_scene({"objects": ALL, "ramp_s": 0.5})
    changed = scene.with_objects({"a": None, "b": validate_object("b", VISCOUS), "nobody": None})
    assert list(scene.objects) == list(ALL)
    assert list(changed.objects) == ["b", "c", "d", "e", "f", "g"]
    assert isinstance(changed.objects["b"], Viscous)
    assert changed.objects["c"] is scene.objects["c"]
    assert changed.ramp_s == 0.5


def test_unknown_materials() -> None:
    patches: Json = [patch(0, 1, "glass"), patch(1, 2, "zz")]
    scene = validate_scene(
        {
            "objects": {
                **ALL,
                "x": {**WALL, "material": "wod"},
                "y": {**MEMBRANE, "material": "zz"},
                "box": {**BOX, "material": "zz"},
                "disc": {**DISC, "material": "zz"},
                "table": {**WALL, "patches": patches},
            }
        }
    )
    known = ["wood", "glass", "cellophane"]
    assert reference_problems(scene.objects, known, ("scene",)) == [
        Problem(
            "scene.objects.x.material",
            'unknown material "wod"; did you mean wood?',
        ),
        *(
            Problem(f"scene.objects.{where}.material", 'unknown material "zz"; known: wood, glass, cellophane')
            for where in ("y", "box", "disc", "table.patches[1]")
        ),
    ]
    assert reference_problems(validate_scene({"objects": ALL}).objects, shipped_materials()) == []


def test_reported_unknown_materials_are_limited() -> None:
    objects: dict[str, Json] = {f"o{i}": {**BOX, "material": f"m{i}"} for i in range(MAX_FAULTS + 7)}
    problems = reference_problems(validate_scene({"objects": objects}).objects, ["wood"])
    assert len(problems) == MAX_FAULTS + 1
    assert problems[-1] == Problem("objects", "have 7 more unknown materials")


def test_materials_of() -> None:
    objects = validate_scene({"objects": ALL}).objects
    table = validate_object("t", {**WALL, "patches": [patch(0, 1, "steel"), patch(-1, 0, "glass")]})
    assert materials_of(table) == ("wood", "steel", "glass")
    assert [materials_of(objects[name]) for name in ALL] == [
        ("wood",),
        ("cellophane",),
        (),
        (),
        (),
        ("wood",),
        ("glass",),
    ]
    assert used_materials(objects.values()) == {"wood", "cellophane", "glass"}


# ---- patches --------------------------------------------------------------------------------------


def patch(from_m: float, to_m: float, material: str = "glass") -> dict[str, Json]:
    return {"from_m": from_m, "to_m": to_m, "material": material}


@pytest.mark.parametrize(
    ("patches", "where", "problem"),
    [
        ([patch(0, 0)], "[0]", "to_m must be at least 1e-05 above from_m, is 0; from_m is 0"),
        ([patch(0, 1), patch(3, 2)], "[1]", "to_m must be at least 1e-05 above from_m, is 2; from_m is 3"),
        ([patch(0, 1e-6)], "[0]", "to_m must be at least 1e-05 above from_m, is 1e-06; from_m is 0"),
        ([patch(0, 21)], "[0].to_m", "should be less than or equal to 20, is 21"),
        ([{"from_m": 0}], "[0].to_m", "Field required"),
        ([patch(0, 2), patch(1, 3)], "", "[0] and [1] overlap"),
        ([patch(5, 6), patch(1, 3), patch(0, 2)], "", "[1] and [2] overlap"),
        ([patch(0, 9), patch(1, 2)], "", "[0] and [1] overlap"),
        ([patch(0, 9), patch(1, 2), patch(3, 4)], "", "[0] and [1] overlap; [0] and [2] overlap"),
        ([patch(0, 1), patch(0, 1)], "", "[0] and [1] overlap"),
        (
            [patch(0, 1), patch(1.000001, 2)],
            "",
            "[0] and [1] leave a gap of 1e-06 m: it must be 0 or at least 1e-05",
        ),
    ],
)
def test_patches_that_are_refused(patches: Json, where: str, problem: str) -> None:
    found = faults("table", {**WALL, "patches": patches})
    assert next(iter(found)) == f"objects.table.patches{where}"
    assert next(iter(found.values())).startswith(problem)


def test_reported_overlaps_are_limited() -> None:
    ((_, problem),) = faults("table", {**WALL, "patches": [patch(0, i + 1) for i in range(9)]}).items()
    assert problem.endswith("; and 3 more")


def test_patches_that_touch_after_rounding() -> None:
    edge = 0.1 + 0.2
    assert edge > 0.3
    wall = validate_object(
        "t", {**WALL, "patches": [patch(0.3, 0.5, "steel"), patch(0, edge), patch(-1e-5, 0, "wood")]}
    )
    assert isinstance(wall, Wall)
    assert list(zip(*wall.stretches(), strict=True)) == [
        (-math.inf, "wood"),
        (-1e-5, "wood"),
        (0, "glass"),
        (0.3, "steel"),
        (0.5, "wood"),
    ]


def test_sections_of_a_wall() -> None:
    wall = validate_object("t", {**WALL, "patches": [patch(2, 3), patch(-1, 1, "steel")]})
    assert isinstance(wall, Wall)
    assert list(zip(*wall.stretches(), strict=True)) == [
        (-math.inf, "wood"),
        (-1, "steel"),
        (1, "wood"),
        (2, "glass"),
        (3, "wood"),
    ]
    plain = validate_object("t", WALL)
    assert isinstance(plain, Wall)
    assert list(zip(*plain.stretches(), strict=True)) == [(-math.inf, "wood")]


@pytest.mark.long
@given(st.lists(st.integers(-1000, 1000), min_size=2, max_size=12, unique=True), st.randoms(use_true_random=False))
def test_any_order_of_patches_gives_the_same_sections(edges: list[int], random: Random) -> None:
    edges = sorted(edges)
    patches = [patch(a / 100, b / 100, f"m{a}") for a, b in pairwise(edges)]
    shuffled = random.sample(patches, len(patches))
    wall = validate_object("t", {**WALL, "patches": list[Json](shuffled)})
    assert isinstance(wall, Wall)
    assert list(zip(*wall.stretches(), strict=True)) == [
        (-math.inf, "wood"),
        *((a / 100, f"m{a}") for a in edges[:-1]),
        (edges[-1] / 100, "wood"),
    ]


# ---- round trips ----------------------------------------------------------------------------------


numbers = st.floats(-10, 10)
vectors = st.lists(numbers, min_size=2, max_size=2)
normals = vectors.filter(lambda v: math.hypot(*v) > 1e-6)
names = st.text(st.characters(exclude_categories=["C", "Zl", "Zp"], exclude_characters="."), min_size=1, max_size=64)
patch_lists = st.lists(st.integers(-19, 19), max_size=6, unique=True).map(
    lambda edges: [patch(edge, edge + 1) for edge in edges]
)
objects = st.one_of(
    st.fixed_dictionaries(
        {"kind": st.just("wall"), "point_m": vectors, "normal": normals, "material": names},
        optional={"patches": patch_lists, "patch_ramp_m": st.floats(1e-5, 1)},
    ),
    st.fixed_dictionaries(
        {
            "kind": st.just("box"),
            "center_m": vectors,
            "size_m": st.lists(st.floats(0.0001, 20), min_size=2, max_size=2),
            "material": names,
        },
        optional={"angle_rad": st.floats(-1000, 1000)},
    ),
    st.fixed_dictionaries(
        {"kind": st.just("disc"), "center_m": vectors, "radius_m": st.floats(0.0001, 10), "material": names}
    ),
    st.fixed_dictionaries(
        {
            "kind": st.just("membrane"),
            "center_m": vectors,
            "normal": normals,
            "width_m": st.floats(0.0001, 20),
            "material": names,
        }
    ),
    st.fixed_dictionaries(
        {"kind": st.just("spring"), "center_m": vectors, "stiffness_n_per_m": st.floats(0, 1e5)},
        optional={"damping_n_s_per_m": st.floats(0, 1e3)},
    ),
    st.fixed_dictionaries({"kind": st.just("viscous"), "damping_n_s_per_m": st.floats(0, 1e3)}),
    st.fixed_dictionaries({"kind": st.just("constant"), "force_n": vectors}),
)


@pytest.mark.long
@given(
    st.fixed_dictionaries(
        {"objects": st.dictionaries(names, objects, max_size=4)},
        optional={
            "ramp_s": st.floats(0.001, 1),
            "display": st.fixed_dictionaries({}, optional={"force": st.booleans(), "vibration": st.booleans()}),
        },
    )
)
def test_canonical_form_is_valid_and_stays(data: dict[str, Json]) -> None:
    scene = validate_scene(data)
    again = validate_scene(scene.to_dict())
    assert again == scene
    assert again.to_dict() == scene.to_dict()


def test_sources(tmp_path: pathlib.Path) -> None:
    scene = validate_scene({"objects": {"a": WALL}})
    bare = tmp_path / "bare.yaml"
    bare.write_text("objects:\n  a: {kind: wall, point_m: [0, 0], normal: [0, 1], material: wood}\n")
    section = tmp_path / "section.yaml"
    section.write_text("scene:\n  objects:\n    a: {kind: wall, point_m: [0, 0], normal: [0, 1], material: wood}\n")
    assert load_scene(scene) is scene
    for source in (bare, str(bare), section, {"objects": {"a": WALL}}, {"scene": {"objects": {"a": WALL}}}):
        assert load_scene(source) == scene
    assert load_scene({}) == Scene()


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("objects:\n  a:\n    kind: wal\n", r"bad.yaml:3:\d+: objects\.a\.kind: should be one of .*, is \"wal\""),
        ("scene:\n  ramp_s: 0\n", r"bad.yaml:2:\d+: scene\.ramp_s: should be greater than or equal to 0.001, is 0"),
        (
            "scene: {}\nservo: {}\n",
            r"^\S*bad.yaml: holds a configuration; use: hapticd run -c \S*bad.yaml$",
        ),
        (
            "scene: {}\ngesture: {}\nobjects: {}\n",
            r"^\S*bad.yaml:3:\d+: objects: belongs below the key `scene`$",
        ),
        ("scene: {}\ngesture: {}\n", r"^\S*bad.yaml:2:\d+: gesture: unknown key; known: scene$"),
        ("scene:\n", r"bad.yaml:1:\d+: scene: should be a mapping, is null"),
        ("- 1\n", r"bad.yaml:1:\d+: should be a mapping, is a list"),
    ],
)
def test_faults_in_a_file_name_the_line(tmp_path: pathlib.Path, text: str, problem: str) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises(InvalidError, match=problem):
        load_scene(path)


def test_validation_object_by_object_gives_the_same_scene() -> None:
    wall = {"kind": "wall", "point_m": [0, 0], "normal": [0, 3], "material": "wood"}
    patches = [{"from_m": 0.001 * at, "to_m": 0.001 * at + 0.0004, "material": "steel"} for at in range(500)]
    data = {"ramp_s": 0.1, "objects": {f"wall {at}": wall for at in range(600)} | {"one": wall | {"patches": patches}}}
    found = validate_scene(data)
    assert sum(1 for _ in scene_steps(data)) == 601
    assert found.ramp_s == 0.1 and found == Scene.parsed(data)
    assert list(found.objects) == list(data["objects"])  # type: ignore[call-overload]


def test_of_thousands_of_faults_the_first_are_reported() -> None:
    wall = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"}
    with pytest.raises(InvalidError) as refused:
        validate_scene({"objects": {f"w{at}": 1 for at in range(5000)}}, ("scene",))
    assert len(refused.value.problems) == 201
    assert [problem.where for problem in refused.value.problems[:2]] == ["scene.objects.w0", "scene.objects.w1"]
    assert str(refused.value.problems[-1]) == "scene.objects: the other entries were not checked"
    with pytest.raises(InvalidError, match="patches: must hold at most 512 entries, holds 60000"):
        validate_scene({"objects": {"one": wall | {"patches": [1] * 60_000}}})
    many = {f"k{at}": 1 for at in range(2000)}
    deep = {"objects": {"one": wall | {"patches": [{"from_m": 0, "to_m": 1, "material": many}]}}}
    for data, where in (
        (many, "scene"),
        ({"display": many}, "scene.display"),
        ({"objects": {"one": wall | many}}, "scene.objects.one"),
        (deep, "scene.objects.one.patches[0].material"),
    ):
        with pytest.raises(InvalidError) as refused:
            validate_scene(data, ("scene",))
        (problem,) = refused.value.problems
        assert problem.where == where and "keys; at most 256 are allowed" in problem.problem
