"""What `hapticd check` takes a joystick for: the same as the daemon that drives it, as far as that can be known."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from hapticd.analysis.check import check
from hapticd.config.configuration import load_config
from hapticd.daemon.engine import Engine
from hapticd.hid.connection import Opened
from hapticd.hid.discovery import SysfsDevice
from hapticd.hid.verdict import verdict_of
from tests.support.hid_descriptors import Joystick
from tests.support.hid_device import FakePid

TRAVEL_M = 0.04
FULL_N = 8.0
HANDLE = {"mass_kg": 0.1, "damping_n_s_per_m": 1.0, "friction_n": 0.05}
FLOOR = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"}


def source(**hid: Any) -> dict[str, Any]:
    device = {"handle": HANDLE, "hid": {"travel_m": TRAVEL_M, "full_scale_force_n": FULL_N, **hid}}
    return {
        "servo": {"rate_hz": 2000, "realtime": "off"},
        "device": {"kind": "hid", **device},
        "scene": {"objects": {"floor": FLOOR}},
    }


def plugged(monkeypatch: pytest.MonkeyPatch, descriptor: bytes, interval_s: float | None) -> None:
    """The only device of this machine, as sysfs tells of it."""
    found = SysfsDevice("stick", "stick", 1, 2, "", "USB", "", descriptor, interval_s, interval_s, "ok")
    monkeypatch.setattr("hapticd.analysis.check.find", lambda: [found])


@pytest.mark.parametrize(
    ("stick", "hid", "interval_s", "link_hz"),
    [
        (Joystick(), {}, 1e-3, 500),  # a report for each of two effects
        (Joystick(), {"max_rate_hz": 200}, 1e-3, 200),
        (Joystick(), {"max_rate_hz": 5000}, None, None),  # as fast as the servo
        (Joystick(), {"max_rate_hz": 5000}, 125e-6, None),
        (Joystick(is_magnitude_signed=False), {}, 2e-3, 250),  # magnitude and direction of one
        (Joystick(axes=(0x30,), force_axes=(0x30,)), {}, 1e-3, 1000),
    ],
)
def test_link_and_steps_are_the_daemons(
    monkeypatch: pytest.MonkeyPatch,
    stick: Joystick,
    hid: dict[str, Any],
    interval_s: float | None,
    link_hz: float | None,
) -> None:
    config = load_config(source(**hid))
    plugged(monkeypatch, bytes(stick), interval_s)
    report = check(config)
    fake = FakePid(bytes(stick))
    driver, _ = verdict_of(config.device.hid, bytes(stick)).driver_and_plan()
    opened = Opened(fake.device, driver, "stick", interval_s, on_change=False, measure=False)
    monkeypatch.setattr("hapticd.daemon.engine.source_of", lambda device: lambda: opened)
    engine = Engine(config)
    try:
        assumed = report.stability.assumed
        assert report.output == engine.output
        assert engine._margins is not None and assumed == engine._margins.loop
    finally:
        engine.stop()
        fake.close()
    assert report.output.link_rate_hz == (None if link_hz is None else pytest.approx(link_hz))
    assert assumed is not None
    # Directions of 8 bits are up to 0.7 degrees off, which is made up for: 1e-4 of a step.
    assert assumed.force_step_n == pytest.approx(FULL_N / stick.magnitude, rel=2e-4)
    assert assumed.encoder_step_m == pytest.approx(TRAVEL_M / stick.axis_range[1])


@pytest.mark.parametrize(("hid", "noted"), [({}, True), ({"max_rate_hz": 250}, False)])
def test_an_unknown_link_is_reported_once_the_joystick_is_away(
    monkeypatch: pytest.MonkeyPatch, hid: dict[str, Any], noted: bool
) -> None:
    monkeypatch.setattr("hapticd.analysis.check.find", list)
    report = check(load_config(source(**hid)))
    assert [note.where for note in report.notes] == ["device.hid.max_rate_hz"] * noted
    plugged(monkeypatch, bytes(Joystick()), 1e-3)
    assert check(load_config(source(**hid))).notes == ()


def test_a_joystick_that_cannot_be_driven_has_no_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    config = load_config(source(max_rate_hz=500, axes={"x": {"usage": "Rx"}}))
    plugged(monkeypatch, bytes(Joystick()), 1e-3)
    report = check(config)
    assert "cannot be driven: device.hid.axes.x.usage: the device has no axis Rx; it has " in report.device
    assert report.stability.assumed is None
    assert report.output.link_rate_hz == 500


def test_discs_that_a_hand_can_press_through_are_reported() -> None:
    """K R against the force limit: 800 N/m of 5 mm hold 4 N. This is reported, and does not count as a problem."""
    discs = {
        name: {"kind": "disc", "center_m": [x, 0.02], "radius_m": radius, "material": "soft"}
        for name, x, radius in (("small", 0.0, 0.005), ("just", 0.05, 0.01), ("large", 0.09, 0.02))
    }
    given = {
        "device": {"max_force_n": 8},
        "materials": {"soft": {"stiffness_n_per_m": 800}},
        "scene": {"objects": discs},
    }
    report = check(load_config(given))
    (note,) = report.notes
    assert note.where == "scene.objects.small"
    assert "holds 4 N" in note.problem
    assert "radius_m 0.01 or 1600 N/m" in note.problem
    assert report.faults == 0
    assert report.to_dict()["notes"] == [{"where": note.where, "problem": note.problem}]


def test_an_autoregressive_texture_sounds_at_the_peak_of_its_loudest_model() -> None:
    """Two poles r exp(+-i w): the peak of their spectrum is where cos is (1 + r^2) cos(w) / (2 r)."""

    def model(hz: float, rms: float) -> dict[str, object]:
        w, r = 2 * math.pi * hz / 2500.0, 0.95
        return {
            "speed_m_per_s": 0.1 * rms,
            "force_n": 1.0,
            "coefficients": [-2 * r * math.cos(w), r * r],
            "rms_m_per_s2": rms,
        }

    texture = {"kind": "autoregressive", "rate_hz": 2500.0, "models": [model(120.0, 1.0), model(310.0, 2.0)]}
    given = {
        "servo": {"rate_hz": 2500, "realtime": "off"},
        "materials": {"cloth": {"stiffness_n_per_m": 500.0, "texture": texture}},
        "scene": {"objects": {"floor": {**FLOOR, "material": "cloth"}}},
    }
    (sound,) = next(each for each in check(load_config(given)).materials if each.name == "cloth").sounds
    w = 2 * math.pi * 310.0 / 2500.0
    peak_hz = math.acos((1 + 0.95**2) / (2 * 0.95) * math.cos(w)) * 2500.0 / (2 * math.pi)
    assert sound.use == "texture" and sound.frequency_hz == pytest.approx(peak_hz, rel=1e-3)
    assert sound.shown_hz == sound.frequency_hz


def test_what_a_scene_does_not_display_is_noted() -> None:
    report = check(load_config({"scene": {"display": {"force": False, "vibration": False}}}))
    assert [note.where for note in report.notes] == ["scene.display.force", "scene.display.vibration"]
    assert report.faults == 0


def test_without_the_joystick_the_loop_is_that_of_a_simulated_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hapticd.analysis.check.find", list)
    away = source()
    unknown = check(load_config(away)).stability.unknown or ""
    assert unknown == (
        "the encoder's step is not known; to compute the loop without the joystick, set device.kind: sim, "
        "device.sim.encoder_step_m and device.sim.link.rate_hz"
    )
    sim = {"encoder_step_m": 5e-5, "link": {"rate_hz": 1000}}
    assumed = check(load_config({**away, "device": {**away["device"], "kind": "sim", "sim": sim}})).stability.assumed
    assert assumed is not None and assumed.dynamics.handle_mass_kg == HANDLE["mass_kg"]
    assert assumed.encoder_step_m == 5e-5
    del away["device"]["handle"]
    assert (check(load_config(away)).stability.unknown or "").startswith("device.handle is not given; it needs mass_kg")


def test_a_recording_that_cannot_be_read_is_reported_once(tmp_path: Path) -> None:
    path = tmp_path / "none.txt"
    report = check(load_config({"device": {"kind": "replay", "replay": {"path": str(path)}}}))
    assert [str(each) for each in report.refused] == [f"device.replay.path: {path}: No such file or directory"]
    assert report.device == "a recording, which cannot be read"
    assert report.stability.unknown == "a recording does not react to forces"


def test_a_report_on_another_handle_than_the_simulated_one_says_so() -> None:
    handle = {"mass_kg": 0.1}
    (note,) = check(load_config({"device": {"handle": handle}})).notes
    assert note.where == "device.handle"
    assert note.problem.endswith("moves another one, of 0.04 kg, 0.2 N s/m and 0.05 N (device.sim)")
    same = {"handle_mass_kg": 0.1, "handle_damping_n_s_per_m": 0, "coulomb_friction_n": 0}
    assert check(load_config({"device": {"handle": handle, "sim": same}})).notes == ()
