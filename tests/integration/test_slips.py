"""Slips in units on a running daemon: they are reported, and none throws the hand."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import hapticd
from hapticd.cli import main
from hapticd.client.blocking import Client
from hapticd.protocol.messages import Code
from tests.support.cli import said
from tests.support.daemon_process import Daemon, running_daemon, until

WALL = {"kind": "wall", "point_m": [0, -0.01], "normal": [0, 1], "material": "wood"}
SLIPPED = {**WALL, "point_m": [0, 10]}
HELD = {
    "wall": SLIPPED,
    "box": {"kind": "box", "center_m": [0, 0], "size_m": [8, 8], "material": "wood"},
    "disc": {"kind": "disc", "center_m": [0, 0.001], "radius_m": 0.03, "material": "wood"},
    "spring": {"kind": "spring", "center_m": [10, 0], "stiffness_n_per_m": 50},
}


CONFIG = """
servo: {rate_hz: 2000, realtime: off, overruns: {threshold: 1}}
device: {sim: {hand: {stiffness_n_per_m: 20000, damping_n_s_per_m: 100}}}
"""
"""A hand that 8.9 N move by 0.4 mm: it is at [0, 0] in all tests."""


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    file = tmp_path_factory.mktemp("slips") / "config.yaml"
    file.write_text(CONFIG)
    with running_daemon("-c", str(file)) as started:
        yield started


@pytest.fixture
def client(daemon: Daemon) -> Iterator[Client]:
    """A client of an empty scene, with forces on."""
    with hapticd.connect(daemon.directory) as connected:
        connected.set_forces(True)
        connected.set_scene({"objects": {}}, wait=True)
        yield connected


def refused(client: Client, method: str, **params: Any) -> dict[str, str]:
    """Call a method that must be refused with HANDLE_INSIDE and change nothing; return the problem."""
    before = client.get_scene()
    with pytest.raises(hapticd.RemoteError) as caught:
        client.call(method, params)
    assert caught.value.code == Code.HANDLE_INSIDE
    assert client.get_scene() == before
    (problem,) = caught.value.data  # type: ignore[misc]
    assert caught.value.message == f"{problem['where']}: {problem['problem']}"
    return problem  # type: ignore[no-any-return]


@pytest.mark.parametrize("kind", HELD)
def test_an_object_that_would_hold_the_handle_needs_force(client: Client, kind: str) -> None:
    problem = refused(client, "set_scene", scene={"objects": {"it": HELD[kind]}})
    assert problem["where"] == "scene.objects.it"
    assert "it pushes with the device's largest force, 8.9 N" in problem["problem"]
    assert problem["problem"].endswith(
        "nothing was changed: move the object or the handle, turn forces off, or repeat the change with force: true "
        "(--force)"
    )
    refused(client, "update_scene", objects={"it": HELD[kind]})
    refused(client, "apply", scene={"objects": {"it": HELD[kind]}}, materials={})
    assert client.state()["touching"] == []
    answer = client.set_scene({"objects": {"it": HELD[kind]}}, wait=True, force=True)
    (warning,) = answer["warnings"]
    assert warning["where"] == "scene.objects.it"
    assert "it pushes with the device's largest force, 8.9 N" in warning["problem"]


def test_moving_a_wall_by_a_slip_needs_force(client: Client) -> None:
    assert "warnings" not in client.set_scene({"objects": {"it": WALL}}, wait=True)
    assert refused(client, "update_scene", objects={"it": {"point_m": [0, 10]}})["where"] == "objects.it"
    assert "warnings" in client.update_scene({"it": {"point_m": [0, 10]}}, force=True)


def test_what_the_hand_feels_already_may_change_freely(client: Client) -> None:
    """The stiffness of a wall in which the hand is, a wall that is sent again, and one that moves a little."""
    client.set_materials({"soft": {"stiffness_n_per_m": 100}, "hard": {"stiffness_n_per_m": 2000}})
    assert "warnings" not in client.set_scene({"objects": {"it": {**WALL, "point_m": [0, 0.012], "material": "soft"}}})
    assert client.update_scene({"it": {"material": "hard"}}, wait=True)["revision"]
    assert client.update_scene({"it": {"point_m": [0, 0.013]}}, wait=True)["revision"]
    assert client.update_materials({"hard": {"stiffness_n_per_m": 3000}}, wait=True)["revision"]
    scene = client.get_scene()["scene"]
    assert client.set_scene(scene, wait=True)["revision"]


def test_of_many_objects_the_first_are_named_and_all_are_counted(client: Client) -> None:
    with pytest.raises(hapticd.RemoteError) as caught:
        client.set_scene({"objects": {f"it{place}": SLIPPED for place in range(300)}})
    assert caught.value.message.endswith(" (and 299 more)")
    assert str(caught.value).count("it pushes with the device's largest force") == 49
    assert str(caught.value).endswith("; and 251 more")


def test_without_forces_nothing_is_refused(client: Client) -> None:
    client.set_forces(False)
    (warning,) = client.set_scene({"objects": {"it": SLIPPED}})["warnings"]
    assert "10 m below its surface" in warning["problem"]
    client.set_scene({"objects": {}})
    client.set_forces(True)
    silent = {"display": {"force": False}, "objects": {"it": SLIPPED}}
    client.set_scene(silent)
    # With the display of forces, the same object comes over the hand.
    refused(client, "set_scene", scene={"objects": {"it": SLIPPED}})


def test_a_change_beyond_the_reach_and_odd_figures_are_reported(client: Client) -> None:
    soft = {"stiffness_n_per_m": 0.8, "tap": {"attack_slope_per_s": 309, "frequency_hz": 1.7, "decay_time_s": 0.006}}
    answer = client.apply(materials={"soft": soft}, scene={"objects": {"it": {**WALL, "point_m": [0, -10]}}})
    assert [each["where"] for each in answer["warnings"]] == [
        "scene.objects.it",
        "materials.soft.stiffness_n_per_m",
        "materials.soft.tap",
    ]
    assert [each["where"] for each in client.set_materials({"soft": soft})["warnings"]] == [
        "materials.soft.stiffness_n_per_m",
        "materials.soft.tap",
    ]
    assert client.get_status()["warnings"][0]["where"] == "scene.objects.it"


COMMANDS = (("scene set", "scene: {objects: "), ("scene update", "{objects: "), ("apply", "scene: {objects: "))


def test_commands_have_the_option_force(
    client: Client, daemon: Daemon, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place = ("--runtime-dir", str(daemon.directory))
    for command, part in COMMANDS:
        file = tmp_path / "slip.yaml"
        file.write_text(f"{part}{{it: {json.dumps(SLIPPED)}}}}}\n")
        line = said(capsys, 1, *place, *command.split(), str(file))
        assert "is 10 m below its surface" in line
        assert "repeat the change with force" in line
        revision = client.get_scene()["revision"]
        assert main([*place, *command.split(), "--force", str(file)]) == 0
        assert f"warning: {file}:1:" in capsys.readouterr().err
        assert client.get_scene()["revision"] == revision + 1
        client.set_scene({"objects": {}}, wait=True)


def test_a_reload_of_a_slip_needs_force(tmp_path: Path) -> None:
    file = tmp_path / "config.yaml"
    file.write_text(CONFIG)
    with running_daemon("-c", str(file)) as daemon, hapticd.connect(daemon.directory) as client:
        file.write_text(f"{CONFIG}scene: {{objects: {{it: {json.dumps(SLIPPED)}}}}}\n")
        assert refused(client, "reload")["where"] == f"{file}: scene.objects.it"
        until(lambda: f"not reloaded: {file}: scene.objects.it: the handle" in daemon.said())
        assert client.reload(force=True)["warnings"][0]["where"] == "scene.objects.it"


def test_a_slip_in_the_configuration_is_logged_at_the_start(tmp_path: Path) -> None:
    file = tmp_path / "config.yaml"
    file.write_text(f"{CONFIG}scene: {{objects: {{it: {json.dumps(SLIPPED)}}}}}\n")
    with running_daemon("-c", str(file)) as daemon:
        until(lambda: "scene.objects.it: the handle at rest, at [0, 0], is 10 m below its surface" in daemon.said())
