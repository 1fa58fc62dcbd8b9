"""The margin of each surface in answers: that of the contact set of this surface alone, found in another way."""

from __future__ import annotations

import json
import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from bench.stability import evaluated
from hapticd.config.configuration import Config, load_config
from hapticd.daemon.engine import Engine
from hapticd.daemon.methods import Methods
from hapticd.daemon.process import _log_limits
from hapticd.rendering.device_output import loop_of

FLOOR = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "m"}


def config_of(objects: dict[str, Any], materials: dict[str, Any], **sections: Any) -> Config:
    return load_config({"materials": materials, "scene": {"objects": objects}, **sections})


def drawn_material(random: np.random.Generator) -> dict[str, Any]:
    found: dict[str, Any] = {"stiffness_n_per_m": float(random.choice([0.0, random.uniform(1, 3000)]))}
    if random.random() < 0.5:
        found["damping_n_s_per_m"] = float(random.uniform(0, 0.2))
    if random.random() < 0.5:
        found["friction"] = {"coefficient": 0.3, "stiffness_n_per_m": float(random.uniform(10, 2000))}
    grooves = {"kind": "grooves", "spacing_m": 0.002, "width_m": 0.001}
    texture = random.integers(3)
    if texture == 1:
        found["texture"] = {**grooves, "display": "geometry", "depth_m": float(random.uniform(1e-6, 1e-4))}
    elif texture == 2:
        found["texture"] = {**grooves, "display": "damping", "damping_n_s_per_m": float(random.uniform(0, 1))}
    return found


def drawn_object(random: np.random.Generator, names: list[str]) -> dict[str, Any]:
    kind, material = random.choice(["wall", "box", "disc", "membrane"]), str(random.choice(names))
    turn = float(random.uniform(0, 2 * math.pi))
    normal = [math.cos(turn), math.sin(turn)]
    if kind == "wall":
        wall = {"kind": "wall", "point_m": [0, 0], "normal": normal, "material": material}
        if random.random() < 0.5:
            patches = [{"from_m": -0.01, "to_m": 0.01, "material": str(random.choice(names))}]
            wall |= {"patches": patches, "patch_ramp_m": float(random.choice([1e-4, 0.004]))}
        return wall
    if kind == "box":
        return {"kind": "box", "center_m": [0, 0], "size_m": [0.01, 0.02], "angle_rad": turn, "material": material}
    if kind == "disc":
        radius_m = float(random.uniform(1e-3, 0.02))
        return {"kind": "disc", "center_m": [0, 0], "radius_m": radius_m, "material": material}
    return {"kind": "membrane", "center_m": [0, 0], "normal": normal, "width_m": 0.01, "material": material}


def alone(config: Config, id: str) -> float | None:
    """What `hapticd check` finds of the set of one object."""
    objects = {id: config.scene.objects[id]}
    sets = evaluated(config.model_copy(update={"scene": config.scene.model_copy(update={"objects": objects})}))
    factor = float(sets.factor[0]) if len(sets) else math.inf
    return None if math.isinf(factor) else factor


@pytest.mark.parametrize("seed", range(12))
def test_it_is_that_of_the_contact_set_of_one_surface(seed: int) -> None:
    random = np.random.default_rng(seed)
    materials = {f"m{place}": drawn_material(random) for place in range(8)}
    objects = {f"o{place}": drawn_object(random, list(materials)) for place in range(20)}
    sim = {"encoder_step_m": float(random.choice([0.0, 1e-6, 2e-5])), "force_step_n": 0.004}
    if random.random() < 0.5:
        sim["link"] = {"rate_hz": 1000}  # type: ignore[assignment]
    config = config_of(objects, materials, device={"sim": sim}, servo={"rate_hz": float(random.choice([1000, 10000]))})
    engine = Engine(config)
    margins = engine.margins()
    assert margins is not None
    assert margins == {id: alone(config, id) and pytest.approx(alone(config, id), rel=1e-9) for id in objects}
    # Changed one by one it is the same as all at once.
    for id in objects:
        for item in (None, config.scene.objects[id]):
            engine.take(engine.scene.with_objects({id: item}), engine.materials)
        touched = engine.margins(touched=True)
        assert touched == {id: margins[id] and pytest.approx(margins[id], rel=1e-12)}


LINKED = {
    "device": {"sim": {"link": {"rate_hz": 1000}}},
    "scene": {"objects": {"floor": {**FLOOR, "material": "wood"}, "pull": {"kind": "viscous", "damping_n_s_per_m": 1}}},
}


def test_answers_have_the_margins_of_the_changed_surfaces() -> None:
    methods = Methods(Engine(load_config(LINKED)))
    limit = 0.2 / 2.5e-3
    assert methods.call("get_scene", {})["margins"] == {"floor": pytest.approx(limit / 800)}
    soft = {"stiffness_n_per_m": 70, "tap": None}
    added = {"soft": soft, "none": {"stiffness_n_per_m": 0}}
    assert methods.call("update_materials", {"materials": added})["margins"] == {}
    objects = {"second": {**FLOOR, "material": "soft"}, "third": {**FLOOR, "material": "none"}}
    changed = methods.call("update_scene", {"objects": objects})
    assert changed["margins"] == {"second": pytest.approx(limit / 70), "third": None}
    json.dumps(changed, allow_nan=False)
    assert methods.call("update_scene", {"objects": {"pull": None, "third": None}})["margins"] == {}
    changed = methods.call("update_materials", {"materials": {"soft": {"stiffness_n_per_m": 35}}})
    assert changed["margins"] == {"second": pytest.approx(limit / 35)}
    again = methods.call("get_scene", {})
    assert again["margins"] == {"floor": pytest.approx(limit / 800), "second": pytest.approx(limit / 35)}
    # The same scene again touches nothing.
    assert methods.call("set_scene", {"scene": again["scene"]})["margins"] == {}
    stiff = {"materials": {"soft": {"stiffness_n_per_m": 140}}, "scene": {"objects": {"own": objects["second"]}}}
    assert methods.call("apply", stiff)["margins"] == {"own": pytest.approx(limit / 140)}
    assert "stability" not in methods.call("get_status", {})


def test_without_a_handle_there_are_no_margins() -> None:
    device = {"kind": "hid", "effective_mass_kg": 0.1}
    assert loop_of(load_config({"device": device}), 10_000.0) is None
    engine = Engine(load_config(LINKED))
    engine._margins = None  # as `loop_of` has it
    methods = Methods(engine)
    assert "margins" not in methods.call("get_scene", {})
    assert "margins" not in methods.call("update_scene", {"objects": {"floor": {"point_m": [0, 0.001]}}})


def test_the_log_names_the_worst_at_the_start(caplog: pytest.LogCaptureFixture) -> None:
    def said(materials: dict[str, Any]) -> list[str]:
        caplog.clear()
        objects = {f"wall_{name}": {**FLOOR, "material": name} for name in materials}
        engine = Engine(load_config({**LINKED, "materials": materials, "scene": {"objects": objects}}))
        _log_limits(engine, cast(Any, SimpleNamespace(missing=())), cast(Any, "built in"))
        return [record.message for record in caplog.records if record.levelname == "WARNING"]

    stiff = {f"m{place}": {"stiffness_n_per_m": 80 * place} for place in range(2, 7)}
    (line,) = said(stiff)
    worst = "wall_m6 0.17, wall_m5 0.2 and wall_m4 0.25"
    assert line == f"5 surfaces with a margin of stability below 1: {worst}; see `hapticd check`"
    assert said({"soft": {"stiffness_n_per_m": 40}}) == []
