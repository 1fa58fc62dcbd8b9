"""Measures of a trial's motion, from its telemetry."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hapticd.base.core import SAMPLE_DTYPE, Flag
from hapticd.experiment.measures import Plane, completion_s, overtravel_m, path_m, peak_force_n, planes_of
from hapticd.protocol.events import event_map
from hapticd.rendering.offline import simulate_run

RATE_HZ = 10_000.0
HANDLE_KG, HANDLE_DAMPING = 0.04, 0.2
HAND_KG, GRIP, GRIP_DAMPING = 0.01, 300.0, 5.0


def _config(normal: tuple[float, float]) -> dict[str, Any]:
    """Return a membrane without vibration, and a joystick without encoder steps, friction and resolution."""
    return {
        "servo": {"rate_hz": RATE_HZ},
        "device": {
            "sim": {
                "handle_mass_kg": HANDLE_KG,
                "handle_damping_n_s_per_m": HANDLE_DAMPING,
                "coulomb_friction_n": 0.0,
                "encoder_step_m": 0.0,
                "force_step_n": 0.0,
                "hand": {"mass_kg": HAND_KG, "stiffness_n_per_m": GRIP, "damping_n_s_per_m": GRIP_DAMPING},
            }
        },
        "scene": {
            "display": {"force": True, "vibration": False},
            "objects": {
                "skin": {
                    "kind": "membrane",
                    "center_m": [0, 0],
                    "normal": list(normal),
                    "width_m": 0.1,
                    "material": "cellophane",
                }
            },
        },
    }


@pytest.mark.parametrize("angle", [90.0, 0.0, 235.0])
@pytest.mark.parametrize("speed", [0.02, 0.05, 0.12])
def test_overtravel_is_that_of_the_hand_in_closed_form_within_one_ticks_travel(angle: float, speed: float) -> None:
    """After the rupture handle and hand are a mass on a spring and a damper, whose other end stops: a linear equation,
    solved from the true position and velocity of the handle at the rupture."""
    normal = np.array([math.cos(math.radians(angle)), math.sin(math.radians(angle))])
    stop, height = 0.02, 0.01
    stops_s = (height + stop) / speed
    ends = np.array([height, -stop, -stop])[:, None] * normal
    waypoints = np.column_stack(([0.0, stops_s, stops_s + 0.6], ends))
    config = _config((float(normal[0]), float(normal[1])))
    run = simulate_run(config, waypoints)
    events = [event_map(event, run.objects.get((int(event["slot"]), int(event["generation"])))) for event in run.events]
    rupture = next(event for event in events if event["event"] == "puncture")
    measured = overtravel_m(run.samples, events, planes_of(config["scene"]["objects"]))
    assert measured is not None
    assert run.truth is not None
    tick = int(str(rupture["tick"]))
    depth = -run.truth[tick, :2] @ normal
    into = -run.truth[tick, 2:] @ normal
    onset_s, begun_s = int(str(rupture["onset_time_ns"])) / 1e9, tick / RATE_HZ
    mass, damping = HANDLE_KG + HAND_KG, HANDLE_DAMPING

    def reference(t: float) -> tuple[float, float]:
        return (speed * t - height, speed) if t < stops_s else (stop, 0.0)

    def moved(t: float, state: Any) -> list[float]:
        wanted, wanted_speed = reference(t)
        drawn = GRIP * (wanted - state[0]) + GRIP_DAMPING * (wanted_speed - state[1])
        return [state[1], (drawn - damping * state[1]) / mass]

    solved = solve_ivp(moved, (begun_s, stops_s + 0.6), [depth, into], rtol=1e-10, atol=1e-12, max_step=1e-3)
    at_onset = depth - into * (begun_s - onset_s)
    one_tick_m = abs(into) / RATE_HZ
    assert measured == pytest.approx(solved.y[0].max() - at_onset, abs=max(one_tick_m, 1e-6))
    assert measured > 0.001


SKIN = Plane((0.0, 0.0), (0.0, 1.0))


def _samples(count: int) -> Any:
    samples = np.zeros(count, SAMPLE_DTYPE)
    samples["time_ns"] = 5 + np.arange(count) * 100_000
    return samples


def test_a_membrane_that_did_not_break_has_no_overtravel() -> None:
    assert overtravel_m(_samples(10), [], {"skin": SKIN}) is None
    elsewhere = [{"event": "puncture", "object": "other", "onset_time_ns": 100_000}]
    assert overtravel_m(_samples(10), elsewhere, {"skin": SKIN}) is None


def test_overtravel_is_exact_to_the_nanosecond_after_a_hundred_days() -> None:
    samples = _samples(11)
    samples["time_ns"] += 100 * 86_400 * 10**9
    samples["position_m"][:, 1] = -np.arange(11) * 1e-3
    event = {"event": "puncture", "object": "skin", "onset_time_ns": int(samples["time_ns"][4]) + 50_000}
    assert overtravel_m(samples, [event], {"skin": SKIN}) == pytest.approx(0.0055, abs=1e-12)


def test_the_side_of_the_rupture_gives_the_direction_of_overtravel_whatever_the_velocity_is() -> None:
    """The hand enters from below, ruptures the membrane 3.5 mm above its centre, continues 2.5 mm, and returns to 5 mm
    below the centre. The estimated velocity lags: at the rupture it still points down."""
    samples = _samples(11)
    samples["position_m"][:, 0] = 0.2
    samples["position_m"][:, 1] = 0.1 + 1e-3 * np.array([0, 1, 2, 3, 4, 5, 6, 3, 0, -3, -5])
    samples["velocity_m_per_s"][:5, 1] = -10.0
    event = {"event": "puncture", "object": "skin", "onset_time_ns": int(samples["time_ns"][3]) + 50_000}
    for normal in ((0.0, 1.0), (0.0, -1.0)):
        measured = overtravel_m(samples, [event], {"skin": Plane((0.2, 0.1), normal)})
        assert measured == pytest.approx(0.0025, abs=1e-12)


def test_peak_force_completion_and_path() -> None:
    samples = _samples(10_001)
    samples["force_n"][77] = (-3.0, 4.0)
    samples["flags"][2_000:8_001] = int(Flag.FORCES_ON)
    angle = np.linspace(0.0, math.pi, 10_001)
    samples["position_m"] = 0.02 * np.column_stack((np.cos(angle), np.sin(angle)))
    assert peak_force_n(samples) == 5.0
    assert completion_s(samples) == pytest.approx(0.6, abs=1e-12)
    # The polygon of a hundred chords of the half circle, in closed form.
    assert path_m(samples) == pytest.approx(100 * 2 * 0.02 * math.sin(math.pi / 200), rel=1e-9)
    assert peak_force_n(samples[:0]) is completion_s(samples[:0]) is path_m(samples[:0]) is None
