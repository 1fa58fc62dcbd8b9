"""A fitted material is rendered and fitted again: the two fits agree."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hapticd.analysis.statistics import Floats
from hapticd.base.yaml_source import load_text
from hapticd.base.yaml_text import yaml_text
from hapticd.config.materials import Material, shipped_materials, validate_materials
from hapticd.fit.limits import SPEED_LAW_LIMITS
from hapticd.fit.recording import Recording, Source
from hapticd.fit.tap import TapFit, fit_tap
from tests.support.fitted import fitted_material
from tests.support.rig import FLOOR, Rig

RATE = 10_000
SPEEDS = np.linspace(0.05, 0.4, 10)
NOISE = 1e-3


def rendered(material: Material, seed: int, speeds: Floats = SPEEDS) -> Recording:
    """Return rendered taps at these speeds: the commanded vibration divided by the mass, plus noise."""
    rig = Rig(
        {"w": {**FLOOR, "material": "m"}},
        rate_hz=RATE,
        materials={"m": material.to_dict()},
        device={"max_force_n": 100},
    )
    heard = []
    for speed in speeds:
        height = 0.03 * speed - speed * np.arange(1500) / RATE
        path = np.stack((np.zeros(1500), np.maximum(height, -0.001)), 1)
        velocity = np.where(height[:, None] > -0.001, (0.0, -speed), (0.0, 0.0))
        heard.append(rig.render(path, velocity=velocity)["vibration_force_n"][:, 1])
        away = np.zeros((200, 2))
        away[:, 1] = 0.03
        rig.render(away, velocity=np.zeros((200, 2)))
    acceleration = np.concatenate(heard) / rig.config.device.effective_mass_kg
    noise = NOISE * np.abs(acceleration).max() * np.random.default_rng(seed).standard_normal(len(acceleration))
    return Recording("rendered", RATE, acceleration + noise, None, None, None, speeds, Source("rendered", ""))


def through_yaml(fit: TapFit, recording: Recording) -> Material:
    made = fitted_material(fit, [recording], "tap", 800.0)
    data: Any = load_text(yaml_text({"materials": {"m": made.to_dict()}}), "m.yaml").data
    return validate_materials(data["materials"])["m"]


@pytest.mark.long
@pytest.mark.parametrize("name", ["wood", "acrylic", "delrin", "glass", "cast_iron"])
def test_taps_come_back(name: str) -> None:
    truth = shipped_materials()[name]
    assert truth.tap is not None
    assert truth.tap.attack_slope_per_s is not None
    recording = rendered(truth, 1)
    first = fit_tap([recording])
    again = fit_tap([rendered(through_yaml(first, recording), 2)])
    for fit in (first, again):
        slope = truth.tap.mode.coefficient(truth.tap.attack_slope_per_s, truth.tap.attack)
        assert fit.slope_per_s.value == pytest.approx(slope, rel=0.01)
        assert fit.frequency_hz.value == pytest.approx(truth.tap.mode.frequency_hz, rel=0.01)
        assert fit.decay_time_s.value == pytest.approx(truth.tap.mode.decay_time_s, rel=0.01)


@pytest.mark.long
def test_a_table_comes_back() -> None:
    points = [[0.05, 30.0], [0.2, 60.0], [0.4, 70.0]]
    tap = {"amplitudes": points, "frequency_hz": 120.0, "decay_time_s": 0.008}
    truth = validate_materials({"m": {"stiffness_n_per_m": 800.0, "tap": tap}})["m"]
    # The number of speeds in a table, so that the table has a point for each speed.
    speeds = np.linspace(0.05, 0.4, SPEED_LAW_LIMITS.max_table_speeds)
    recording = rendered(truth, 3, speeds)
    assert not fit_tap([recording]).linear
    first = fit_tap([recording], law="table")
    again = through_yaml(first, recording)
    assert truth.tap is not None and again.tap is not None
    wanted = [truth.tap.amplitude_m_per_s2(speed) for speed in speeds]
    for fit in (first, fit_tap([rendered(again, 4, speeds)])):
        struck = np.array([(hit.speed_m_per_s, hit.coefficient_m_per_s2) for hit in fit.taps])
        assert np.allclose(struck[:, 0], speeds)
        assert np.allclose(struck[:, 1], wanted, rtol=0.01)
