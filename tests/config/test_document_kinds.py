"""The kind of a document, from its keys, and the error if a command gets the file of another command."""

from __future__ import annotations

import os
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from hapticd.base.yaml_source import load_text
from hapticd.config import document_kinds
from hapticd.config.configuration import Config, load_config
from hapticd.config.document_kinds import kind_of
from hapticd.config.materials import Material
from hapticd.config.operator import OperatorParams
from hapticd.config.scene import Scene, SceneObject
from tests.support.cli import said

FLOOR = "{kind: wall, point_m: [0, 0], normal: [0, 1], material: wood}"
SCENE = f"objects:\n  floor: {FLOOR}\n"
TAP = "gesture: {kind: tap, object: floor, speed_m_per_s: 0.1}\n"
PATH = "waypoints: [[0, 0, 0.01], [0.1, 0, 0.01]]\n"
PINE = "materials:\n  pine: {stiffness_n_per_m: 700}\n"

KINDS: list[tuple[str, str | None]] = [
    (SCENE, "bare scene"),
    ("ramp_s: 0.1\n", "bare scene"),
    ("scene: {}\n", "scene"),
    (PINE, "materials"),
    (PINE + "scene: {}\n", "change"),
    ("servo: {}\nscene: {}\n", "configuration"),
    ("flight: {seconds: 5}\n", "configuration"),
    (PATH, "waypoints"),
    (TAP, "gesture"),
    ("{kind: tap, object: floor, speed_m_per_s: 0.1}\n", "gesture"),
    (f"floor: {FLOOR}\n", "objects"),
    (f"device: {FLOOR}\nhoney: null\n", "objects"),
    ("pine: {stiffness_n_per_m: 700}\n", "bare materials"),
    ("materials: {tap: {stiffness_n_per_m: 700}}\n", "materials"),
    ("device: {kind: sim}\n", "configuration"),
    ("floor: null\n", None),
    ("a: 1\n", None),
    ("- 1\n", None),
    ("", None),
]


@pytest.mark.parametrize(("text", "kind"), KINDS, ids=range(len(KINDS)))
def test_the_keys_determine_the_kind_of_a_document(text: str, kind: str | None) -> None:
    assert kind_of(load_text(text, "f").data) == kind


def test_the_keys_are_those_of_the_models() -> None:
    assert {*document_kinds.CONFIGURATION_KEYS, "materials", "scene"} == set(Config.model_fields)
    assert set(document_kinds.SCENE_KEYS) == set(Scene.model_fields)
    assert set(document_kinds.MATERIAL_KEYS) == set(Material.model_fields)
    of_operators = document_kinds.KEYS_OF_KIND["waypoints"] + document_kinds.KEYS_OF_KIND["gesture"]
    assert set(of_operators) == set(OperatorParams.model_fields)
    assert set(document_kinds.OBJECT_KINDS) == {
        kind for member in get_args(SceneObject) for kind in get_args(member.model_fields["kind"].annotation)
    }


READERS = {
    "check -c": ["check", "-c"],
    "run -c": ["run", "-c"],
    "apply": ["apply"],
    "simulate": ["simulate", "--operator", "stroke", "-o", "x.npz"],
    "simulate --operator": ["simulate", "comb", "-o", "x.npz", "--operator"],
    "replay": ["replay"],
    "fit tap": ["fit", "tap"],
}
FILES = {
    "scene.yaml": (SCENE, "a scene", "apply"),
    "floor.yaml": (f"floor: {FLOOR}\n", "objects", "scene update"),
    "pine.yaml": (PINE, "materials", "apply"),
    "both.yaml": (PINE + "scene: {}\n", "materials and a scene", "apply"),
    "tap.yaml": (TAP, "a gesture", "operator"),
    "path.yaml": (PATH, "waypoints", "operator"),
    "config.yaml": ("servo: {}\n", "a configuration", "run -c"),
    "tap.npz": (None, "a recording", "replay"),
}
CONFIGURATION = {"scene.yaml", "pine.yaml", "both.yaml", "config.yaml"}
TAKEN = {
    "check -c": CONFIGURATION,
    "run -c": CONFIGURATION,
    "apply": {"scene.yaml", "pine.yaml", "both.yaml"},
    "simulate": {"scene.yaml", "both.yaml", "config.yaml"},
    "simulate --operator": {"tap.yaml", "path.yaml"},
    "replay": {"tap.npz"},
    "fit tap": {"tap.npz"},
}


@pytest.mark.parametrize(
    ("reader", "name"), [(reader, name) for reader in READERS for name in FILES if name not in TAKEN[reader]]
)
def test_a_file_for_another_command_is_named_with_that_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], reader: str, name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    text, what, command = FILES[name]
    if text is None:
        np.savez(name, samples=np.zeros(3))
    else:
        Path(name).write_text(text)
    it = "not a recording: it " if reader in ("replay", "fit tap") else ""
    output = said(capsys, 1, *READERS[reader], name)
    meant = f"{it}holds {what}; use: hapticd {command} {name}"
    assert (
        output == f"hapticd: {name}: {meant if text else 'an archive, not YAML; for a recording use: hapticd replay'}\n"
    )
    assert os.listdir() == [name]


def test_a_bare_scene_is_a_configuration(tmp_path: Path) -> None:
    bare, section, materials = tmp_path / "bare.yaml", tmp_path / "section.yaml", tmp_path / "materials.yaml"
    bare.write_text(SCENE)
    section.write_text("scene:\n  " + SCENE.replace("\n", "\n  ").rstrip() + "\n")
    materials.write_text(PINE)
    assert load_config(bare) == load_config(section)
    both = load_config([materials, bare])
    assert list(both.scene.objects) == ["floor"] and both.materials["pine"].stiffness_n_per_m == 700


def test_faults_of_a_bare_scene_name_their_place_in_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("s.yaml").write_text("ramp_s: 9\n" + SCENE.replace("wood", "woood"))
    unknown = 'objects.floor.material: unknown material "woood"; did you mean wood?\n'
    too_much = "hapticd: s.yaml:1:1: ramp_s: should be less than or equal to 1, is 9\n"
    assert said(capsys, 1, "check", "-c", "s.yaml") == too_much
    Path("s.yaml").write_text(SCENE.replace("wood", "woood"))
    assert said(capsys, 1, "check", "-c", "s.yaml") == f"hapticd: s.yaml:2:56: {unknown}"


@pytest.mark.parametrize(
    ("gesture", "problem"),
    [
        (
            "{kind: tapp, object: floor, speed_m_per_s: 0.1}",
            "should be one of 'tap', 'stroke', 'puncture', is \"tapp\"",
        ),
        ("{kind: tap, object: flor, speed_m_per_s: 0.1}", 'has the id "flor"; did you mean floor?'),
        ("{kind: tap, object: floor, sped_m_per_s: 0.1}", "unknown key; did you mean speed_m_per_s?"),
    ],
)
def test_misspelt_gestures_are_refused_with_a_suggestion(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], gesture: str, problem: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("s.yaml").write_text(SCENE + "  honey: {kind: viscous, damping_n_s_per_m: 1}\n")
    Path("g.yaml").write_text(f"gesture: {gesture}\n")
    assert problem in said(capsys, 1, "simulate", "s.yaml", "--operator", "g.yaml", "-o", "x.npz")


@pytest.mark.parametrize("words", ["simulate FILE --operator taps", "check FILE", "apply FILE", "run -c FILE"])
def test_objects_beside_materials_belong_below_scene(
    words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "both.yaml"
    file.write_text("materials: {pine: {stiffness_n_per_m: 500}}\nobjects: {}\n")
    given = ["--runtime-dir", str(tmp_path), *words.replace("FILE", str(file)).split()]
    assert said(capsys, 1, *given) == f"hapticd: {file}:2:1: objects: belongs below the key `scene`\n"
