"""A hand that the strikes of a comb drive is warned of; one that they do not is not."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapticd.analysis.check import check
from hapticd.base.core import EventKind
from hapticd.cli import main
from hapticd.config.configuration import load_config
from hapticd.rendering.offline import simulate_run

FLOOR = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "comb"}


def source_of(damping: float, stiffness: float = 30.0, mass: float = 0.0, friction: float = 0.0) -> dict[str, Any]:
    hand = {"mass_kg": mass, "stiffness_n_per_m": stiffness, "damping_n_s_per_m": damping}
    return {"device": {"sim": {"coulomb_friction_n": friction, "hand": hand}}, "scene": {"objects": {"comb": FLOOR}}}


def warned(source: dict[str, Any]) -> bool:
    return any("its strikes drive this hand" in each.problem for each in check(load_config(source)).warnings)


def test_a_light_hand_is_warned_of_and_the_default_one_is_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "comb.yaml"
    path.write_text(json.dumps(source_of(0.3)))
    assert main(["check", "-c", str(path)]) == 1
    assert "materials.comb.texture: its strikes drive this hand over the grooves" in capsys.readouterr().out
    assert not warned({"scene": {"objects": {"comb": FLOOR}}})


def test_nothing_drives_where_nothing_vibrates_or_holds() -> None:
    silent = source_of(0.3)
    silent["scene"]["display"] = {"force": True, "vibration": False}
    assert not warned(silent)
    assert not warned(source_of(0.3, stiffness=0.0))


def goes_on(seed: int) -> tuple[bool, bool]:
    """A hand drawn at random that moves in its own way: whether it is warned of, and whether strikes go on."""
    random = np.random.default_rng(seed)

    def between(low: float, high: float) -> float:
        return float(math.exp(random.uniform(math.log(low), math.log(high))))

    source = source_of(
        between(0.05, 20), between(20, 500), float(random.choice([0, 0.01])), float(random.choice([0, 0.05]))
    )
    press, speed, x = between(0.3, 1.0), between(0.05, 0.5), float(random.uniform(-0.01, 0.01))
    deep = press / source["device"]["sim"]["hand"]["stiffness_n_per_m"] + press / 800
    source["device"]["sim"] |= {"start_m": [x, 0.002], "workspace_m": 0.5, "handle_mass_kg": between(0.02, 0.1)}
    end = 0.3 + 0.03 / speed
    run = simulate_run(source, [[0, x, 0.002], [0.3, x, -deep], [end, x + 0.03, -deep]], end + 7.0)
    late = run.events[run.events["kind"] == EventKind.GROOVE]["time_ns"] * 1e-9 > end + 6.0
    return warned(source), bool(late.any())


@pytest.mark.slow
def test_hands_that_are_driven_are_warned_of() -> None:
    found = [goes_on(seed) for seed in range(60)]
    assert [seed for seed, (told, driven) in enumerate(found) if driven and not told] == []
    assert sum(driven for _, driven in found) > 15
    # And few of the others.
    assert sum(told and not driven for told, driven in found) <= 6
    assert sum(not told for told, _ in found) > 15


def noisy(gain: float, damping: float, material: dict[str, Any] | None = None) -> dict[str, Any]:
    """Noise about 200 Hz that grows with speed and force, under a hand on a handle without dry friction."""
    gains = {"velocity_gain_per_s": gain, "force_gain_m_per_s2_per_n": gain}
    source = source_of(damping, stiffness=100.0)
    source["scene"]["objects"]["comb"] = {**FLOOR, "material": "loud"}
    texture = {"kind": "stochastic", "peak_hz": 200, "mean_hz": 280, **gains}
    source["materials"] = {"loud": {"stiffness_n_per_m": 800, "texture": texture, **(material or {})}}
    return source


def warned_of_noise(source: dict[str, Any]) -> bool:
    return any("its noise drives this hand" in each.problem for each in check(load_config(source)).warnings)


def test_noise_that_a_light_hand_keeps_up_is_warned_of() -> None:
    assert warned_of_noise(noisy(20.0, 0.3))
    assert not warned_of_noise(noisy(0.1, 5.0))
    held = noisy(20.0, 0.3)
    held["device"]["sim"]["coulomb_friction_n"] = 0.3
    assert not warned_of_noise(held)


@pytest.mark.slow
@pytest.mark.parametrize("material", ["sandpaper_60", "sandpaper_400"])
def test_the_shipped_sandpapers_do_not_drive_the_default_hand(material: str) -> None:
    assert not warned_of_noise({"scene": {"objects": {"it": {**FLOOR, "material": material}}}})


def test_noise_on_a_very_soft_surface_is_checked_too() -> None:
    assert not warned_of_noise(noisy(0.1, 5.0, {"stiffness_n_per_m": 0.01}))


def keeps_sounding(seed: int) -> tuple[bool, bool]:
    """A hand and a noise drawn at random, moved in its own way: whether it is warned of, and whether noise goes on."""
    random = np.random.default_rng(seed)
    source = noisy(math.exp(random.uniform(math.log(0.1), math.log(30))), math.exp(random.uniform(-1.5, 2.5)))
    speed, press = float(random.uniform(0.05, 0.5)), float(random.uniform(0.3, 1.0))
    deep = press / 100.0 + press / 800.0
    source["device"]["sim"] |= {"start_m": [0, 0.002], "workspace_m": 0.5}
    end = 0.3 + 0.03 / speed
    run = simulate_run(source, [[0, 0, 0.002], [0.3, 0, -deep], [end, 0.03, -deep]], end + 10.0)
    return warned_of_noise(source), bool(np.abs(run.samples["vibration_force_n"][-10_000:]).max() > 0.01)


@pytest.mark.slow
def test_noise_that_drives_the_hand_is_warned_of() -> None:
    found = [keeps_sounding(seed) for seed in range(40)]
    assert [seed for seed, (told, sounds) in enumerate(found) if sounds and not told] == []
    assert sum(sounds for _, sounds in found) > 5
    assert sum(not told for told, _ in found) > 15
