"""Vibrations that the rate cannot carry, or displays with a deviation, are reported wherever a scene is set."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapticd.base.core import Status, lib
from hapticd.base.errors import InvalidError, Problem
from hapticd.cli import main
from hapticd.config.configuration import load_config
from hapticd.config.materials import Material
from hapticd.config.scene import validate_object
from hapticd.daemon.engine import Engine
from hapticd.daemon.methods import Methods
from hapticd.daemon.refusal import MethodError
from hapticd.rendering.compiler import noise_filters
from hapticd.rendering.device_output import Output
from hapticd.rendering.displayability import material_rate_faults
from hapticd.rendering.joystick import target_of
from hapticd.rendering.offline import render, render_run, simulate, simulate_run

FLOOR = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"}
GRIT = {"kind": "stochastic", "peak_hz": 250, "mean_hz": 310, "velocity_gain_per_s": 40}
HIGH = {"stiffness_n_per_m": 800, "texture": {**GRIT, "peak_hz": 450, "mean_hz": 600}}
FINE = {
    "stiffness_n_per_m": 800,
    "texture": {"kind": "grooves", "display": "damping", "spacing_m": 1e-3, "width_m": 1e-4, "damping_n_s_per_m": 2},
}
STIFF = {"stiffness_n_per_m": 800}
MATERIALS = {"high": HIGH, "fine": FINE}
LINE = [[0, 0, 0.01], [0.05, 0, -0.001]]


def methods(**objects: object) -> Methods:
    config = load_config({"servo": {"rate_hz": 1000}, "materials": MATERIALS, "scene": {"objects": objects}})
    return Methods(Engine(config))


def limits(daemon: Methods, member: str) -> list[dict[str, object]]:
    found = daemon.status()[member]
    assert isinstance(found, list)
    return found


def refused(call: Any) -> list[dict[str, str]]:
    with pytest.raises(MethodError) as caught:
        call()
    assert caught.value.code == -32602
    data = caught.value.data
    assert isinstance(data, list)
    return data


def test_frequencies_above_half_the_rate_are_refused_at_every_start() -> None:
    source = {"materials": MATERIALS, "scene": {"objects": {"floor": {**FLOOR, "material": "high"}}}}
    for run in (
        lambda: render_run(source, [[0, 0]], 1000),
        lambda: simulate_run(source, LINE, rate_hz=1000),
        lambda: Engine(load_config({**source, "servo": {"rate_hz": 1000}})),
    ):
        with pytest.raises(InvalidError) as caught:
            run()
        assert [problem.where for problem in caught.value.problems] == ["materials.high.texture.mean_hz"]
    assert len(render_run(source, [[0, 1]], 10_000).samples) == 1


def test_it_is_refused_in_a_scene_an_object_and_a_material() -> None:
    daemon = methods(floor=FLOOR)
    patched = {**FLOOR, "patches": [{"from_m": 0, "to_m": 1, "material": "high"}]}
    (found,) = refused(lambda: daemon.call("set_scene", {"scene": {"objects": {"a": patched, "floor": FLOOR}}}))
    assert found["where"] == "scene.objects.a.patches[0].material"
    assert found["problem"].startswith("materials.high.texture.mean_hz: must be less than half the servo rate")
    (found,) = refused(lambda: daemon.call("update_scene", {"objects": {"floor": {"material": "high"}}}))
    assert found["where"] == "objects.floor.material"
    (found,) = refused(lambda: daemon.call("update_materials", {"materials": {"wood": {"texture": HIGH["texture"]}}}))
    assert found["where"] == "materials.wood.texture.mean_hz"
    assert daemon.status()["revision"] == 1
    daemon.call("update_materials", {"materials": {"high": {"stiffness_n_per_m": 1}}})  # nothing is made of it


def test_patches_keep_their_materials_too() -> None:
    daemon = methods(floor={**FLOOR, "patches": [{"from_m": 0, "to_m": 1, "material": "fine"}]})
    (found,) = refused(lambda: daemon.call("update_materials", {"materials": {"fine": None}}))
    assert found == {"where": "materials.fine", "problem": 'cannot be removed: object "floor" uses it'}
    (found,) = refused(
        lambda: daemon.call(
            "update_scene", {"objects": {"floor": {"patches": [{"from_m": 0, "to_m": 1, "material": "x"}]}}}
        )
    )
    assert found["where"] == "objects.floor.patches[0].material"


def test_warnings_are_part_of_the_status_and_follow_the_scene() -> None:
    daemon = methods(a={**FLOOR, "material": "fine"}, b={**FLOOR, "material": "fine"}, c=FLOOR)
    places = [warning["where"] for warning in limits(daemon, "warnings")]
    assert places == ["materials.fine.texture.width_m"]
    daemon.call("update_scene", {"objects": {"a": None, "b": None}})
    assert limits(daemon, "warnings") == []
    steel = {"objects": {"a": {**FLOOR, "material": "steel"}}}
    daemon.call("update_scene", steel)
    (mode,) = limits(daemon, "undisplayable")
    assert (mode["material"], mode["mode"]) == ("steel", "tap")


def test_vibrations_that_a_link_cannot_carry_are_muted_and_reported() -> None:
    source = {
        "device": {"sim": {"link": {"rate_hz": 1000}}},
        "scene": {"objects": {"floor": {**FLOOR, "material": "steel"}}},
    }
    run = simulate_run(source, LINE)
    (told,) = run.undisplayable
    assert (told.material, told.mode, told.frequency_hz, told.shown_hz) == ("steel", "tap", pytest.approx(1682), None)
    assert not run.samples["vibration_force_n"].any()
    assert run.samples["contact_force_n"].any()
    daemon = Methods(Engine(load_config(source)))
    (mode,) = limits(daemon, "undisplayable")
    assert (mode["material"], mode["mode"], mode["shown_hz"]) == ("steel", "tap", None)
    assert simulate_run({**source, "device": {"sim": {"link": {"rate_hz": 8000}}}}, LINE).undisplayable == ()


def test_positions_come_once_a_frame() -> None:
    source = {"device": {"sim": {"link": {"rate_hz": 500, "delay_frames": 2}, "encoder_step_m": 0}}, "scene": {}}
    run = simulate_run(source, [[0, 0, 0], [0.2, 0.02, 0.01]], 0.2)
    assert run.truth is not None
    # Ticks of a frame have one position: that of the handle two frames before the frame began.
    ticks = np.arange(len(run.samples))
    made = np.maximum(ticks // 20 * 20 - 40, 0)
    np.testing.assert_array_equal(run.samples["position_m"], run.truth[made, :2])


def test_warnings_of_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    source = {"materials": MATERIALS, "scene": {"objects": {"floor": {**FLOOR, "material": "fine"}}}}
    run = simulate_run(source, LINE, rate_hz=1000)
    assert {warning.where for warning in run.warnings} >= {"materials.fine.texture.width_m"}
    assert render_run({}, [[0, 0]]).warnings == ()
    monkeypatch.chdir(tmp_path)
    Path("scene.yaml").write_text(
        "materials:\n  fine: {stiffness_n_per_m: 800, texture: {kind: grooves, display: damping, spacing_m: 1e-3, "
        "width_m: 1e-4, damping_n_s_per_m: 2}}\n"
        "scene:\n  objects:\n    floor: {kind: wall, point_m: [0, 0], normal: [0, 1], material: fine}\n"
    )
    Path("hand.yaml").write_text("waypoints: [[0, 0, 0.01], [0.05, 0, 0]]\n")
    assert main(["simulate", "scene.yaml", "--operator", "hand.yaml", "-o", "a.npz", "--rate", "1000"]) == 0
    told = capsys.readouterr().err.splitlines()
    assert told == [f"hapticd: warning: {warning}" for warning in run.warnings]


def test_vibrations_that_a_run_cannot_display_are_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    source = {"materials": MATERIALS, "scene": {"objects": {"floor": {**FLOOR, "material": "steel"}}}}
    for run in (simulate_run(source, LINE, rate_hz=1000), render_run(source, [[0, 0]], 1000)):
        (told,) = run.undisplayable
        assert (told.material, told.mode, told.shown_hz) == ("steel", "tap", None)
        assert str(told) == f"tap of steel, {told.frequency_hz:g} Hz: silent"
    assert simulate_run(source, LINE).undisplayable == ()
    monkeypatch.chdir(tmp_path)
    Path("scene.yaml").write_text("objects:\n  floor: {kind: wall, point_m: [0, 0], normal: [0, 1], material: steel}\n")
    Path("hand.yaml").write_text("waypoints: [[0, 0, 0.01], [0.05, 0, 0]]\n")
    assert main(["simulate", "scene.yaml", "--operator", "hand.yaml", "-o", "a.npz", "--rate", "1000"]) == 0
    assert capsys.readouterr().err.splitlines()[0] == f"hapticd: {told}"


def test_patches_of_a_refused_material_are_found_with_one_check(monkeypatch: pytest.MonkeyPatch) -> None:
    daemon = methods()
    daemon.call("update_materials", {"materials": {"bad": {"texture": {**GRIT, "peak_hz": 600}, **STIFF}}})
    patches = [{"from_m": n / 1000, "to_m": (n + 1) / 1000, "material": "wood"} for n in range(300)]
    patches[299]["material"] = "bad"
    looked: list[str] = []

    def look(name: str, material: Material, output: Output) -> list[Problem]:
        looked.append(name)
        return material_rate_faults(name, material, output)

    monkeypatch.setattr("hapticd.daemon.methods.material_rate_faults", look)
    (found,) = refused(lambda: daemon.call("update_scene", {"objects": {"w": {**FLOOR, "patches": patches}}}))
    assert found["where"] == "objects.w.patches[299].material"
    assert found["problem"].startswith("materials.bad.texture.peak_hz: must be less than half the servo rate")
    assert sorted(looked) == ["bad", "wood"]


def test_a_change_pauses_after_each_filter_that_it_designs() -> None:
    daemon = methods()
    model = {"coefficients": [-0.3, 0.1], "rms_m_per_s2": 1}
    models = [{"speed_m_per_s": n / 10, "force_n": 1, **model} for n in range(40)]
    sand = {"texture": {"kind": "autoregressive", "rate_hz": 700, "models": models}, **STIFF}
    assert sum(1 for _ in daemon.change("update_materials", {"materials": {"sand": sand}})) > len(models)
    # Known by now.
    designed = noise_filters._shown_model.cache_info().misses
    daemon.call("update_scene", {"objects": {"floor": {**FLOOR, "material": "sand"}}})
    assert noise_filters._shown_model.cache_info().misses == designed


def test_a_scene_that_cannot_be_rendered_leaves_everything_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    daemon = methods(floor=FLOOR, skin={**FLOOR, "point_m": [0, 1]})
    engine = daemon._engine
    places = {id: engine._compiler.slot_of(id) for id in ("floor", "skin")}
    real = lib.hd_servo_publish

    class Lib:
        def __getattr__(self, name: str) -> object:
            return (lambda servo, table: Status.ERR_MEMORY) if name == "hd_servo_publish" else getattr(lib, name)

    monkeypatch.setattr("hapticd.daemon.engine.lib", Lib())
    with pytest.raises(Exception, match="the scene cannot be rendered: no memory"):
        daemon.call("update_scene", {"objects": {"floor": None, "new": {**FLOOR, "kind": "wall"}}})
    monkeypatch.setattr("hapticd.daemon.engine.lib", lib)
    assert real is lib.hd_servo_publish
    assert daemon.status()["revision"] == 1
    assert {id: engine._compiler.slot_of(id) for id in ("floor", "skin")} == places
    assert daemon.call("update_scene", {"objects": {"new": FLOOR}})["revision"] == 2


def test_gestures_go_to_the_upper_side_of_a_solid() -> None:
    materials = load_config({}).materials
    angle = 0.4
    box = {"kind": "box", "center_m": [0.01, 0.02], "size_m": [0.03, 0.01], "angle_rad": angle, "material": "wood"}
    target = target_of(validate_object("box", box), materials)
    assert target is not None
    upper = complex(0.01, 0.02) + complex(0, 0.005) * complex(math.cos(angle), math.sin(angle))
    assert complex(*target.point_m) == pytest.approx(upper, abs=1e-15)
    assert complex(*target.normal) == pytest.approx(1j * complex(math.cos(angle), math.sin(angle)), abs=1e-15)
    assert (target.half_m, target.face) == (0.015, "face")
    disc = {"kind": "disc", "center_m": [0.01, 0.02], "radius_m": 0.005, "material": "cellophane"}
    target = target_of(validate_object("disc", disc), materials)
    assert target is not None
    assert (target.point_m, target.normal, target.rupture_depth_m) == ((0.01, 0.025), (0.0, 1.0), None)
    assert target.half_m == math.inf
    skin = {"kind": "membrane", "center_m": [0, 0], "normal": [0, 1], "width_m": 0.03, "material": "cellophane"}
    target = target_of(validate_object("skin", skin), materials)
    assert target is not None
    assert (target.half_m, target.face) == (0.015, "membrane")
    target = target_of(validate_object("floor", {**FLOOR, "material": "wood"}), materials)
    assert target is not None
    assert target.half_m == math.inf
    assert target_of(validate_object("p", {"kind": "constant", "force_n": [0, 1]}), materials) is None


def test_a_gesture_beyond_a_face_is_refused_by_daemon_and_run() -> None:
    box = {"kind": "box", "center_m": [0, 0], "size_m": [0.01, 0.01], "material": "wood"}
    tap: dict[str, dict[str, Any]] = {"gesture": {"kind": "tap", "object": "box", "speed_m_per_s": 0.1, "at_m": 0.02}}
    daemon = methods(box=box)
    said = "0.02 is beyond the face, which ends at 0.005"
    with pytest.raises(InvalidError, match=rf"^gesture\.at_m: {said}$"):
        simulate_run({"scene": {"objects": {"box": box}}}, tap)
    assert refused(lambda: daemon.call("set_operator", tap)) == [{"where": "gesture.at_m", "problem": said}]
    tap["gesture"]["at_m"] = 0.005
    assert len(simulate_run({"scene": {"objects": {"box": box}}}, tap).samples)


def test_a_run_is_at_the_rate_of_its_configuration() -> None:
    slow = {"servo": {"rate_hz": 2000}, "scene": {"objects": {"floor": {**FLOOR, "material": "wood"}}}}
    plain = {"scene": slow["scene"]}
    points = [[0, 0.001 - 0.0001 * i] for i in range(30)]
    for given, rate_hz, meant in ((slow, None, 2000), (slow, 5000, 5000), (plain, None, 10_000), (plain, 2000, 2000)):
        for run in (render_run(given, points, rate_hz), simulate_run(given, LINE, 0.02, rate_hz)):
            assert run.rate_hz == meant
            assert np.all(np.diff(run.samples["time_ns"]) == 1e9 / meant)
        assert len(run.samples) == 0.02 * meant
    assert np.array_equal(render(slow, points), render(plain, points, 2000))
    assert np.array_equal(simulate(slow, LINE, 0.02), simulate(plain, LINE, 0.02, 2000))
