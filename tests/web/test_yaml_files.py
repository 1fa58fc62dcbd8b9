"""YAML of a page: opened files, faults with their places, and saved files that are read again."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import pytest

from hapticd.base.errors import HapticdError, InvalidError
from hapticd.config.configuration import load_config
from hapticd.config.materials import shipped_materials
from hapticd.config.shipped_files import shipped
from hapticd.web import yaml_files
from hapticd.web.yaml_files import FILE_PARTS, placed, read, saved

PLAY = (Path(yaml_files.__file__).parents[1] / "shipped/play.yaml").read_text(encoding="utf-8")
LIBRARY: dict[str, Any] = {name: material.to_dict() for name, material in shipped_materials().items()}


def running(text: str) -> tuple[Any, Any]:
    """Return scene and materials of a daemon that applied this text."""
    opened = read("a.yaml", text)
    return copy.deepcopy(opened.scene), copy.deepcopy({**LIBRARY, **opened.materials})


def loads(text: str, tmp_path: Path) -> Any:
    (tmp_path / "saved.yaml").write_text(text, encoding="utf-8")
    return load_config(tmp_path / "saved.yaml")


def test_a_configuration_gives_materials_and_scene_and_leaves_out_the_rest() -> None:
    opened = read("play.yaml", PLAY)
    assert opened.left_out == ("device",)
    assert sorted(opened.materials) == ["comb", "sandpaper"]
    assert opened.scene is not None and "floor" in opened.scene["objects"]  # type: ignore[operator]


@pytest.mark.parametrize(
    ("text", "line", "where", "problem"),
    [
        (
            "scene:\n  objects:\n    a: {kind: wal}\n",
            3,
            "scene.objects.a.kind",
            "should be one of 'wall'",
        ),
        (
            "materials:\n  a: {stiffness_n_per_m: -1}\n",
            2,
            "materials.a.stiffness_n_per_m",
            "should be greater than or equal to 0",
        ),
        ("scene:\n  objects: {\n", 3, "", "while parsing a flow "),
        ("servo: {rate_hz: 1}\nscene: {}\n", 1, "servo.rate_hz", "should be greater than or equal to 1000"),
        ("servo: {rate_hz: 1000}\n", 1, "", "neither materials nor a scene"),
        ("gesture: {kind: tap, object: a}\n", None, "", "holds a gesture"),
        ("a: &x [1]\nb: *x\n", 2, "", "aliases are not allowed"),
        ("a: 1\na: 2\n", 2, "", "duplicate key"),
        ("[" * 40 + "]" * 40, 1, "", "deeper"),
        ("", 1, "", "neither materials nor a scene"),
        ("scene: !!python/object/apply:os.system [ls]\n", 1, "", "is not allowed here"),
    ],
)
def test_faults_are_reported_by_line_and_key(text: str, line: int | None, where: str, problem: str) -> None:
    with pytest.raises(InvalidError) as caught:
        read("a:1.yaml", text)
    found: Any = placed(caught.value.problems, "a:1.yaml")[0]
    assert (found["line"], found["where"]) == (line, where)
    assert problem in found["problem"]


def test_all_faults_are_reported() -> None:
    with pytest.raises(InvalidError) as caught:
        read(
            "a.yaml",
            "scene:\n  ramp_s: 3\n  objects:\n    a: {kind: disc, center_m: [0, 0], radius_m: x, material: wood}\n",
        )
    assert [(each["line"], each["where"]) for each in placed(caught.value.problems, "a.yaml")] == [
        (2, "scene.ramp_s"),
        (4, "scene.objects.a.radius_m"),
    ]


@pytest.mark.parametrize("text", ["x" * (2 << 20) + "xx", "a: [" + "[" * 100_000, "&a " * 1000 + "b", "\x00"])
def test_texts_without_end_are_refused(text: str) -> None:
    with pytest.raises(InvalidError):
        read("a.yaml", text)


@pytest.mark.parametrize(
    ("name", "text"), [(3, "a: 1"), ("", "a: 1"), ("a" * 201, "a: 1"), ("a", None), ("a", b"a: 1")]
)
def test_params_of_another_type_are_refused(name: object, text: object) -> None:
    with pytest.raises(HapticdError, match="must be a text"):
        read(name, text)


def test_a_name_that_is_a_path_is_only_a_name(tmp_path: Path) -> None:
    (tmp_path / "secret.yaml").write_text("scene: {}\n")
    with pytest.raises(InvalidError, match="neither materials nor a scene"):
        read(str(tmp_path / "secret.yaml"), "")


@pytest.mark.parametrize("file", [*shipped("scenes").values(), *shipped("materials").values()])
def test_an_unchanged_file_is_saved_unchanged(file: str) -> None:
    text = Path(file).read_text(encoding="utf-8")
    scene, materials = running(text)
    opened = read("a.yaml", text)
    parts = ["scene"] if opened.change.materials is None else ["materials"]
    found = saved(scene or {}, materials, parts, opened, text)
    assert (found.text, found.kept) == (text, True)


def test_what_changed_is_changed_in_the_file_and_comments_stay(tmp_path: Path) -> None:
    scene, materials = running(PLAY)
    scene["objects"]["peg"]["radius_m"] = 0.01
    scene["objects"]["ball"] = {"kind": "disc", "center_m": [0.0, 0.05], "radius_m": 0.004, "material": "wood"}
    materials["comb"]["friction"]["coefficient"] = 0.35
    found = saved(scene, materials, FILE_PARTS, read("play.yaml", PLAY), PLAY)
    before, after = PLAY.splitlines(), found.text.splitlines()
    assert [line for line in before if line not in after] == [
        "    friction: {coefficient: 0.2, stiffness_n_per_m: 500}",
        "    peg: {kind: disc, center_m: [-0.052, 0.012], radius_m: 0.008, material: acrylic}",
    ]
    assert "    ball: {kind: disc, center_m: [0, 0.05], radius_m: 0.004, material: wood}" in after
    config = loads(found.text, tmp_path)
    assert config.scene.to_dict() == read("a", found.text).scene == yaml_files.validate_scene(scene).to_dict()
    assert config.materials["comb"].to_dict() == materials["comb"]
    again = saved(*running(found.text), FILE_PARTS, read("a.yaml", found.text), found.text)
    assert again.text == found.text


def test_without_a_file_only_what_differs_from_the_library_is_saved(tmp_path: Path) -> None:
    scene, materials = running(PLAY)
    materials["wood"] = {**materials["wood"], "stiffness_n_per_m": 900.0}
    found = saved(scene, materials)
    assert found.materials == ["comb", "sandpaper", "wood"]
    assert "steel:" not in found.text and "ramp_s" not in found.text and "stiffness_n_per_m: 900\n" in found.text
    config = loads(found.text, tmp_path)
    assert config.scene.to_dict() == scene
    assert config.materials["wood"].stiffness_n_per_m == 900
    again = saved(*running(found.text), FILE_PARTS, read("a.yaml", found.text), found.text)
    assert again.text == found.text


def test_a_scene_alone_gets_the_materials_that_it_needs(tmp_path: Path) -> None:
    text = "# Mine.\nobjects:\n  a: {kind: disc, center_m: [0, 0], radius_m: 0.01, material: wood}  # round\n"
    scene, materials = running(text)
    materials["wood"] = {**materials["wood"], "stiffness_n_per_m": 900.0}
    materials["unused"] = {"stiffness_n_per_m": 1.0, "damping_n_s_per_m": 0.0}
    opened = read("a.yaml", text)
    found = saved(scene, materials, FILE_PARTS, opened, text, {"unused": materials["unused"]})
    assert found.materials == ["wood"] and found.kept
    assert found.text.startswith("# Mine.\nscene:\n  objects:\n    a: {kind: disc") and "# round" in found.text
    assert loads(found.text, tmp_path).materials["wood"].stiffness_n_per_m == 900
    later = saved(scene, {**materials, "unused": {"stiffness_n_per_m": 2.0}}, FILE_PARTS, opened, text, {"unused": {}})
    assert later.materials == ["unused", "wood"]


def test_a_default_that_the_file_says_and_strings_of_the_core_schema_stay() -> None:
    text = "scene: {ramp_s: 2e-2, passivity: off, objects: {off: {kind: viscous, damping_n_s_per_m: 2}}}  # all\n"
    scene, materials = running(text)
    assert scene["passivity"] == "off" and "off" in scene["objects"]
    scene["objects"]["off"]["damping_n_s_per_m"] = 3.5
    found = saved(scene, materials, FILE_PARTS, read("a", text), text)
    assert found.text == text.replace("m: 2}", "m: 3.5}")


def test_nothing_to_save_is_an_error() -> None:
    with pytest.raises(HapticdError, match="nothing to save: every material is as shipped"):
        saved({}, LIBRARY, ["materials"])
