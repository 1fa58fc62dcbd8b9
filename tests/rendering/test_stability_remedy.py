"""The reported remedy is enough: random grooves and patches at 0.99 of it are safe, and rest in the simulation."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest

from bench.stability import fate_of
from hapticd.analysis.check import check
from hapticd.config.configuration import load_config
from hapticd.rendering.stability import Margin

FREE = {"mass_kg": 0, "stiffness_n_per_m": 0, "damping_n_s_per_m": 0}
FLOOR: dict[str, Any] = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "m"}


def between(random: np.random.Generator, low: float, high: float) -> float:
    return float(math.exp(random.uniform(math.log(low), math.log(high))))


def drawn(seed: int) -> dict[str, Any]:
    """A free handle on a floor of geometry grooves, of patches, or of both."""
    random = np.random.default_rng(seed)
    stiffness = between(random, 100, 20_000)
    floor, materials = {**FLOOR}, {"m": {"stiffness_n_per_m": stiffness}}
    if seed % 3 != 1:
        spacing = between(random, 0.001, 0.006)
        width = spacing * random.uniform(0.3, 0.9)
        grooves = {"kind": "grooves", "display": "geometry", "spacing_m": spacing, "width_m": width}
        materials["m"]["texture"] = grooves | {"depth_m": width * between(random, 0.005, 0.1)}  # type: ignore[assignment]
    if seed % 3 != 0:
        materials["n"] = {"stiffness_n_per_m": stiffness * between(random, 0.14, 7)}
        floor |= {"patches": [{"from_m": -0.002, "to_m": 0.002, "material": "n"}]}
        floor["patch_ramp_m"] = between(random, 2e-4, 0.002)
    sim = {
        "handle_damping_n_s_per_m": between(random, 0.1, 5),
        "encoder_step_m": float(random.choice([0, 1e-6, 20e-6])),
        "force_step_n": 0,
        "report_delay_s": int(random.integers(0, 4)) * 1e-4,
        "hand": FREE,
    }
    return {
        "device": {"sim": sim, "max_speed_m_per_s": 1000},
        "materials": materials,
        "scene": {"objects": {"floor": floor}, "display": {"force": True, "vibration": False}},
    }


def margin_of(source: dict[str, Any]) -> Margin:
    (margin,) = check(load_config(source)).stability.worst
    return margin


def lowered(source: dict[str, Any], margin: Margin, part: float = 0.99) -> dict[str, Any]:
    """The scene with the reported remedy, slightly lowered."""
    materials = {name: {**material} for name, material in source["materials"].items()}
    every = re.fullmatch(r"every stiffness of .* at most (\S+) times its value", margin.remedy)
    found = re.findall(r"a (\S+) of at most (\S+) (?:N/m|m) for (m, n|m|n)", margin.remedy)
    assert every or found or not margin.remedy, margin.remedy
    if not found:
        factor = part * (float(every[1]) if every else margin.margin)
        for material in materials.values():
            material["stiffness_n_per_m"] *= factor
    for key, most, names in found:
        for name in names.split(", "):
            if key == "stiffness_n_per_m":
                materials[name][key] = min(materials[name][key], part * float(most))
            else:
                materials[name]["texture"] = materials[name]["texture"] | {"depth_m": part * float(most)}
    return source | {"materials": materials}


@pytest.mark.long
@pytest.mark.parametrize("seeds", [range(15), pytest.param(range(15, 120), marks=pytest.mark.slow)])
def test_the_reported_remedy_is_safe(seeds: range) -> None:
    told = 0
    for seed in seeds:
        source = drawn(seed)
        margin = margin_of(source)
        if not margin.safe:
            told += 1
            assert margin.remedy, seed
            assert margin_of(lowered(source, margin)).safe, (seed, margin.remedy)
            # What the limit says by itself holds as well: all stiffnesses so many times as large.
            if margin.limit_n_per_m > 0.0:
                for part in (0.99, 0.9):
                    factor = part * margin.limit_n_per_m / margin.stiffness_n_per_m
                    softer = {
                        name: material | {"stiffness_n_per_m": factor * material["stiffness_n_per_m"]}
                        for name, material in source["materials"].items()
                    }
                    assert margin_of(source | {"materials": softer}).safe, (seed, part)
    assert told > len(seeds) // 2


@pytest.mark.long
def test_slightly_more_than_the_reported_remedy_is_not_safe() -> None:
    for seed in range(0, 30, 3):
        source = drawn(seed)
        margin = margin_of(source)
        if not margin.safe:
            assert not margin_of(lowered(source, margin, 1.03)).safe, (seed, margin.remedy)


@pytest.mark.slow
def test_a_remedied_scene_comes_to_rest() -> None:
    """The free handle is laid on by 0.5 N, and pushed along the surface."""
    for seed in range(36):
        source = drawn(seed)
        margin = margin_of(source)
        if margin.safe:
            continue
        source = lowered(source, margin)
        push = {"kind": "constant", "force_n": [0.1 * (seed % 4), -0.5]}
        objects = source["scene"]["objects"] | {"push": push}
        source |= {"scene": source["scene"] | {"objects": objects}}
        x = -0.003 + 0.0002 * seed
        source["device"]["sim"]["start_m"] = [x, 0.002]
        assert fate_of(load_config(source), [[0, x, 0.002], [0.01, x, 0.002]]).fate == "rests", seed


def test_a_softer_wall_reaches_others() -> None:
    """Pressed with 8.9 N a wall of 80 N/m gives way by 111 mm and meets the disc below it, one of 800 N/m does not."""
    disc = {"kind": "disc", "center_m": [0, -0.06], "radius_m": 0.01, "material": "m"}
    source = {
        "device": {"sim": {"link": {"rate_hz": 1000}}},
        "materials": {"m": {"stiffness_n_per_m": 800}},
        "scene": {"objects": {"floor": FLOOR, "disc": disc}},
    }
    for margin in check(load_config(source)).stability.worst:
        told = load_config(source | {"materials": {"m": {"stiffness_n_per_m": 0.99 * margin.limit_n_per_m}}})
        assert all(each.safe for each in check(told).stability.worst)
        assert margin.limit_n_per_m == pytest.approx(40, rel=0.02)


def test_it_says_which_key() -> None:
    link = {"sim": {"link": {"rate_hz": 1000}}}
    rubber = {"m": {"stiffness_n_per_m": 800, "friction": {"coefficient": 0.3, "stiffness_n_per_m": 900}}}
    source = {"device": link, "materials": rubber, "scene": {"objects": {"floor": FLOOR}}}
    margin = margin_of(source)
    assert margin.remedy.startswith("every stiffness of m, springs of friction and fields included, at most 0.0")
    assert f"; safe in any hand with {margin.remedy}" in str(margin)
    spring = {"kind": "spring", "center_m": [0, 0], "stiffness_n_per_m": 500}
    margin = margin_of({"device": link, "scene": {"objects": {"spring": spring}}})
    assert margin.remedy.startswith("every stiffness of the fields at most 0.")
