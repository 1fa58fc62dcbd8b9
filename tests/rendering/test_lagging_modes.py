"""What `hapticd check` says of modes that the actuator is too slow for.

The reference is the handle's acceleration by the matrix exponential of scipy (tests.tick.test_touched), projected on
exp(-B t) sin(w t) from 30 Hz to 0.4 of the rate, with the actuator and without.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from hapticd.analysis.check import Report, check
from hapticd.config.actuator import Actuator
from hapticd.config.configuration import load_config
from tests.tick.test_touched import AT_TICK, FINE, RATE, Floats, acceleration, mode_of, rig_of, tap_of, tapped

SLOW = pytest.mark.slow
WORDS = re.compile(
    r"an actuator of ([\d.]+) Hz \(order (\d)\) shows ([\d.]+) % of this mode of ([\d.]+) Hz, "
    r"(?:(\d+) degrees (late|early)|in phase), with compensation: (\w+); (.*)"
)


def contained(moved: Floats, name: str) -> complex:
    mode = mode_of(name)
    pole = complex(-mode.decay_rate_per_s, mode.angular_frequency_rad_per_s)
    integral = (np.exp(pole * np.arange(len(moved) + 1) / RATE / FINE) / pole).imag
    wanted = np.diff(integral) * RATE * FINE
    lines = 1 << 18
    frequency = np.fft.rfftfreq(lines, 1 / RATE / FINE)
    band = (frequency >= 30) & (frequency <= 0.4 * RATE)
    one, other = (np.fft.rfft(each, lines)[band] for each in (moved, wanted))
    return complex(np.vdot(other, one) / np.vdot(other, other))


def checked(materials: dict[str, Any], objects: dict[str, Any] | None = None, **device: Any) -> Report:
    discs = {
        name: {"kind": "disc", "center_m": [0.02 * place, 0], "radius_m": 0.005, "material": name}
        for place, name in enumerate(materials)
    }
    return check(load_config({"device": device, "materials": materials, "scene": {"objects": objects or discs}}))


def told(report: Report) -> dict[str, re.Match[str]]:
    found = {problem.where: WORDS.fullmatch(problem.problem) for problem in report.warnings}
    return {where: match for where, match in found.items() if match is not None}


@pytest.mark.parametrize(
    ("name", "lag", "compensation"),
    [
        ("wood", {"bandwidth_hz": 60}, "off"),
        pytest.param("steel", {"bandwidth_hz": 1600, "order": 2}, "off", marks=SLOW),
        pytest.param("steel", {"bandwidth_hz": 300}, "mass", marks=SLOW),
        pytest.param("steel", {"bandwidth_hz": 300}, "full", marks=SLOW),
        pytest.param("acrylic", {"bandwidth_hz": 300, "order": 2, "damping_ratio": 0.2}, "full", marks=SLOW),
    ],
)
def test_the_reported_part_is_that_of_the_simulated_handle(name: str, lag: dict[str, Any], compensation: str) -> None:
    wall = 800.0 if compensation != "off" else 0.0
    material = tap_of(name, 800)
    match = told(checked({"m": material}, compensation=compensation, actuator=lag))["materials.m.tap"]
    slow = acceleration(tapped(rig_of(material, compensation=compensation, actuator=lag), AT_TICK), wall,
                        actuator=Actuator.model_validate(lag))  # fmt: skip
    swift = acceleration(tapped(rig_of(material, compensation=compensation), AT_TICK), wall)
    part = contained(slow, name) / contained(swift, name)
    assert float(match[3]) / 100 == pytest.approx(abs(part), abs=0.01)
    degrees = float(match[5] or 0) * (1 if match[6] == "early" else -1)
    assert degrees == pytest.approx(np.degrees(np.angle(part)), abs=1)
    assert (float(match[1]), int(match[2]), match[7]) == (lag["bandwidth_hz"], lag.get("order", 1), compensation)
    assert float(match[4]) == pytest.approx(mode_of(name).frequency_hz, rel=1e-3)


@SLOW
def test_the_reported_remedies_are_sufficient() -> None:
    report = checked({"m": tap_of("wood", 800)}, actuator={"bandwidth_hz": 60})
    remedy = told(report)["materials.m.tap"][8]
    words = re.fullmatch(
        r"compensation: full would show ([\d.]+) %, or an actuator of ([\d.]+) Hz would suffice", remedy
    )
    assert words is not None and float(words[1]) == pytest.approx(100, abs=10)
    needed_hz = float(words[2]) * 1.0005  # four digits are reported
    assert not told(checked({"m": tap_of("wood", 800)}, actuator={"bandwidth_hz": needed_hz}))
    assert told(checked({"m": tap_of("wood", 800)}, actuator={"bandwidth_hz": 0.9 * needed_hz}))
    assert not told(checked({"m": tap_of("wood", 800)}, compensation="full", actuator={"bandwidth_hz": 60}))


@SLOW
def test_each_mode_where_it_stands_and_only_those_in_the_scene() -> None:
    high = {"frequency_hz": 900, "decay_time_s": 0.01}
    low = {"frequency_hz": 30, "decay_time_s": 0.1}
    rupture = {"depth_m": 0.002, "amplitude_m_per_s2": 10, **high}
    grooves = {
        "kind": "grooves",
        "display": "vibration",
        "spacing_m": 0.01,
        "width_m": 0.0005,
        "velocity_gain_per_s": 9,
    }
    tap = {"attack_slope_per_s": 100, **low, "second": {**high, "ratio": 0.5}}
    materials = {
        "m": {"stiffness_n_per_m": 300, "tap": tap, "rupture": rupture, "texture": {**grooves, **high}},
        "unused": {"stiffness_n_per_m": 300, "tap": {"attack_slope_per_s": 100, **high}},
    }
    objects = {"skin": {"kind": "membrane", "center_m": [0, 0], "normal": [0, 1], "width_m": 0.02, "material": "m"}}
    lag = {"bandwidth_hz": 300}
    report = checked(materials, objects, actuator=lag)
    assert sorted(told(report)) == ["materials.m.rupture", "materials.m.tap.second", "materials.m.texture"]
    assert report.faults > 0
    assert not told(checked(materials, objects))
    # A silent mode is not reported again.
    config = {"servo": {"rate_hz": 1000}, "device": {"actuator": lag}, "materials": materials}
    assert not told(check(load_config({**config, "scene": {"objects": objects}})))


def test_without_a_handle_it_is_that_of_a_mass() -> None:
    hid = {"travel_m": 0.04, "full_scale_force_n": 8.0}
    report = checked({"m": tap_of("steel", 800)}, kind="hid", hid=hid, actuator={"bandwidth_hz": 400})
    match = told(report)["materials.m.tap"]
    assert 0 < float(match[3]) < 50 and match[8].startswith("device.handle and compensation: full")


def test_the_displayed_error_includes_the_actuator() -> None:
    errors = [
        checked({"m": tap_of("acrylic", 800)}, **device).materials[-1].sounds[0].error
        for device in ({}, {"actuator": {"bandwidth_hz": 100}})
    ]
    assert errors[0] is not None and errors[1] is not None and errors[1] > errors[0] + 0.2


def test_one_mode_is_warned_of_once() -> None:
    """A need for more than twice the force of the amplitude is caused by the actuator, and not reported in addition."""
    report = checked({"m": tap_of("steel", 800)}, compensation="mass", actuator={"bandwidth_hz": 300})
    assert [problem.where for problem in report.warnings] == ["materials.m.tap"]
    assert told(report)
