"""What the daemon finds in what came from a file: told with the file's line and column, faults and warnings alike."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from hapticd.base.yaml_source import load_text
from hapticd.cli import main
from hapticd.client.blocking import Client
from hapticd.config.file_faults import FromFile, placed
from tests.support.cli import said
from tests.support.daemon_process import Daemon, Wire

LOUD = {"stiffness_n_per_m": 800.0, "tap": {"attack_slope_per_s": 300.0, "frequency_hz": 5e4, "decay_time_s": 1e-3}}
SILENT = "50000 Hz is above 4000 Hz, 0.4 of the rate: it is silent"
FLOOR = {"kind": "wall", "point_m": [0.0, -0.05], "normal": [0.0, 1.0], "material": "wood"}


# ---- Faults ----------------------------------------------------------------------------------------------------------

FILES = {
    "scene set": (
        "scene:\n  objects:\n    table: {kind: disc,\n      material: wod, center_m: [0, 0], radius_m: 1}\n",
        "4:7",
    ),
    "scene update": ("objects:\n  table:\n    {kind: disc, material: wod, center_m: [0, 0], radius_m: 1}\n", "3:18"),
    "operator": ("gesture:\n  kind: tap\n  speed_m_per_s: 0.1\n  object: nobody\n", "4:3"),
}
KEYS = {
    "scene set": "scene.objects.table.material",
    "scene update": "objects.table.material",
    "operator": "gesture.object",
}


@pytest.mark.parametrize("command", FILES)
def test_a_fault_that_the_daemon_finds_is_told_where_the_file_has_it(
    daemon: Daemon, tmp_path: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    text, place = FILES[command]
    file = tmp_path / "file.yaml"
    file.write_text(text)
    line = said(capsys, 1, "--runtime-dir", str(daemon.directory), *command.split(), str(file))
    assert line.startswith(f"hapticd: {file}:{place}: {KEYS[command]}: ")


def test_a_fault_of_a_patch_is_told_where_the_file_has_it(client: Client, tmp_path: Path) -> None:
    file = tmp_path / "m.yaml"
    file.write_text("wood:\n  tap:\n    frequency_hz: high\n")
    with pytest.raises(Exception) as caught:
        client.update_materials(file)
    assert str(caught.value) == f'{file}:3:5: wood.tap.frequency_hz: should be a valid number, is "high"'


def test_a_fault_of_what_came_from_no_file_is_told_by_its_path(client: Client) -> None:
    with pytest.raises(Exception) as caught:
        client.update_scene({"table": {**FLOOR, "material": "wod"}})
    assert str(caught.value).startswith('objects.table.material: unknown material "wod"; did you mean wood?')


def test_both_parts_of_apply_are_found_in_their_files(client: Client, tmp_path: Path) -> None:
    scene, materials = tmp_path / "s.yaml", tmp_path / "m.yaml"
    scene.write_text("objects:\n  table: {kind: disc, center_m: [0, 0], radius_m: 1, material: soft}\n")
    materials.write_text("materials:\n  soft:\n    stiffness_n_per_m: -1\n")
    with pytest.raises(Exception) as caught:
        client.apply(materials=materials, scene=scene)
    assert str(caught.value).startswith(
        f"{materials}:3:5: materials.soft.stiffness_n_per_m: should be greater than or equal to 0"
    )


PLACES = [
    ("", "f.yaml:1:1"),
    ("a", "f.yaml:1:1: a"),
    ("a.b[1].c", "f.yaml:2:11: a.b[1].c"),
    ("a.b[1].gone.more", "f.yaml:2:10: a.b[1].gone.more"),
    ("a.b[7]", "f.yaml:2:3: a.b[7]"),
    ('a."odd.key".x', 'f.yaml:3:13: a."odd.key".x'),
    ('a."odd.keys"', 'f.yaml:1:1: a."odd.keys"'),
    ("ab", "f.yaml:4:1: ab"),
    ("gone", "f.yaml:1:1: gone"),
]


@pytest.mark.parametrize(("where", "told"), PLACES)
def test_a_place_is_found_by_its_path(where: str, told: str) -> None:
    document = load_text("a:\n  b: [1, {c: 2}]\n  odd.key: {x: 1}\nab: 2\n", "f.yaml")
    value = FromFile({}, document)
    assert placed(where, value) == told
    inner = FromFile({}, document, ("a",))
    assert placed("value.b[0]", {"value": inner}) == "f.yaml:2:7: a.b[0]"
    assert placed("values.b[0]", {"value": inner}) == "values.b[0]"


# ---- Warnings --------------------------------------------------------------------------------------------------------


def test_a_material_that_is_not_displayed_is_told_at_once(wire: Wire) -> None:
    expected = [{"where": "materials.loud.tap", "problem": SILENT}]
    assert wire.result("set_materials", materials={"loud": LOUD})["warnings"] == expected
    patch = {"loud": {"damping_n_s_per_m": 1.0}}
    assert wire.result("update_materials", materials=patch)["warnings"] == expected
    assert wire.result("apply", materials={"loud": LOUD})["warnings"] == expected
    assert "warnings" not in wire.result("update_materials", materials={"wood": {"damping_n_s_per_m": 0.0}})
    assert "warnings" not in wire.result("update_materials", materials={"loud": None})


def test_a_scene_is_told_of_the_materials_that_it_names(wire: Wire) -> None:
    wire.result("set_materials", materials={"loud": LOUD})
    loud = {**FLOOR, "material": "loud"}
    patched = {**FLOOR, "patches": [{"from_m": 0.0, "to_m": 0.01, "material": "loud"}]}
    problem = f"materials.loud.tap: {SILENT}"
    answer = wire.result("set_scene", scene={"objects": {"fine": FLOOR, "floor": loud, "other": loud}})
    assert answer["warnings"] == [{"where": "scene.objects.floor.material", "problem": problem}]
    answer = wire.result("update_scene", objects={"floor": patched})
    assert answer["warnings"] == [{"where": "objects.floor.patches[0].material", "problem": problem}]
    assert "warnings" not in wire.result("update_scene", objects={"fine": {"point_m": [0.0, -0.04]}})
    answer = wire.result("apply", materials={"loud": LOUD}, scene={"objects": {"floor": loud}})
    assert answer["warnings"] == [{"where": "materials.loud.tap", "problem": SILENT}]
    answer = wire.result("set_scene", scene={"objects": {}})
    assert answer.keys() == {"revision", "margins"}


def test_patches_that_are_narrowed_are_told_where_they_stand(wire: Wire) -> None:
    narrow = {**FLOOR, "patches": [{"from_m": 0.0, "to_m": 0.0001, "material": "wood"}]}
    (warned,) = wire.result("update_scene", objects={"floor": narrow})["warnings"]
    assert warned["where"] == "objects.floor.patches[0]"
    (warned,) = wire.result("set_scene", scene={"objects": {"floor": narrow}})["warnings"]
    assert warned["where"] == "scene.objects.floor.patches[0]"


def test_what_nobody_uses_yet_and_everybody_would_be_refused(wire: Wire) -> None:
    texture = {"kind": "stochastic", "peak_hz": 6000.0, "mean_hz": 100.0, "velocity_gain_per_s": 1.0, "seed": 1}
    fizz = {
        "stiffness_n_per_m": 1.0,
        "texture": {**texture, "force_gain_m_per_s2_per_n": 1.0, "threshold_m_per_s": 0.01},
    }
    (warned,) = wire.result("set_materials", materials={"fizz": fizz})["warnings"]
    assert warned["where"] == "materials.fizz.texture.peak_hz"
    assert "must be less than half the servo rate" in warned["problem"]


def test_a_mode_that_is_played_silently_is_told(wire: Wire) -> None:
    push: dict[str, Any] = {"direction": [0, 1], "amplitude_m_per_s2": 1}
    answer = wire.result("play", mode={"frequency_hz": 5e4, "decay_time_s": 0.01}, **push)
    assert answer["displayed_hz"] is None
    assert answer["warnings"] == [{"where": "mode", "problem": SILENT}]
    assert "warnings" not in wire.result("play", material="wood", **push)


def test_waypoints_beyond_the_stops_are_told(wire: Wire) -> None:
    (warned,) = wire.result("set_operator", waypoints=[[0, 0, 0.02], [1, 0, 0.3], [2, 0, 0.4]])["warnings"]
    assert warned["where"] == "waypoints[1]"
    assert warned["problem"] == "[0, 0.3] is beyond the stops of the handle, 0.075 m from the middle"
    (warned,) = wire.result("set_operator", waypoints=[[0, 0, 8]])["warnings"]
    assert warned["problem"] == (
        "[0, 8] is beyond the stops of the handle, 0.075 m from the middle; if it is in mm, write [0, 0.008]"
    )
    assert "warnings" not in wire.result("set_operator", waypoints=[[0, 0, 0.02]])


@pytest.mark.long
def test_commands_say_warnings_on_stderr_with_line_and_column(
    daemon: Daemon, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "m.yaml"
    file.write_text(f"materials:\n  loud:\n    {json.dumps(LOUD)}\n")
    column = file.read_text().splitlines()[2].index('"tap"') + 1
    command = ["--runtime-dir", str(daemon.directory), "material", "set", str(file)]
    assert main(command) == 0
    assert capsys.readouterr().err == f"hapticd: warning: {file}:3:{column}: materials.loud.tap: {SILENT}\n"
    assert main([*command, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["warnings"][0]["problem"] == SILENT


@pytest.mark.long
def test_of_several_files_the_one_is_named_that_the_place_is_in(
    daemon: Daemon, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, materials = tmp_path / "s.yaml", tmp_path / "m.yaml"
    wall = "kind: wall, point_m: [0, -0.05], normal: [0, 1]"
    scene.write_text(f"objects:\n  a: {{{wall}, material: loud}}\n  b: {{{wall}, material: louder}}\n")
    materials.write_text(f"loud:\n  {json.dumps(LOUD)}\n")
    command = ["--runtime-dir", str(daemon.directory), "apply", str(materials), str(scene)]
    line = said(capsys, 1, *command)
    column = scene.read_text().splitlines()[2].index("material") + 1
    assert line.startswith(
        f'hapticd: {scene}:3:{column}: objects.b.material: unknown material "louder"; did you mean loud?'
    )
    scene.write_text(f"objects:\n  a: {{{wall}, material: loud}}\n")
    assert main(command) == 0
    column = materials.read_text().splitlines()[1].index('"tap"') + 1
    assert capsys.readouterr().err == f"hapticd: warning: {materials}:2:{column}: loud.tap: {SILENT}\n"
