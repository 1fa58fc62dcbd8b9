"""What a strike meets: surfaces that are touched, onsets between two ticks, an actuator that lags.

The reference is a handle in a hand, with wall and actuator where there are any, put together here, by the
matrix exponential of scipy; the library's waveform is exp(-B t) sin(w t).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.linalg import expm

from hapticd.config.actuator import Actuator
from hapticd.config.materials import shipped_materials
from hapticd.config.modes import Mode
from hapticd.rendering.offline import simulate_run
from tests.support.rig import FLOOR, Rig

Floats = npt.NDArray[np.float64]

RATE = 10_000.0
FINE = 16
MASS, DAMPING, STIFFNESS = 0.05, 5.2, 300.0
"""The default handle and hand."""
SPEED = 1 / 64
METALS = ("steel", *(pytest.param(name, marks=pytest.mark.slow) for name in ("aluminum", "glass", "cast_iron")))


def mode_of(name: str) -> Mode:
    tap = shipped_materials()[name].tap
    assert tap is not None
    return tap.mode


def tap_of(name: str, stiffness: float, damping: float = 0.0) -> dict[str, Any]:
    mode = mode_of(name)
    tap = {
        "attack_slope_per_s": 1 / SPEED,
        "angular_frequency_rad_per_s": mode.angular_frequency_rad_per_s,
        "decay_rate_per_s": mode.decay_rate_per_s,
    }
    return {"stiffness_n_per_m": stiffness, "damping_n_s_per_m": damping, "tap": tap}


def rig_of(material: dict[str, Any], objects: dict[str, Any] | None = None, **device: object) -> Rig:
    settings = {"compensation": "full", "max_force_n": 100, **device}
    return Rig(objects or {"wall": {**FLOOR, "material": "m"}}, materials={"m": material}, device=settings)


def tapped(rig: Rig, part: float, seconds: float = 0.12) -> Floats:
    """Forces of a tap with A = 1 that began `part` of a period before the first of them. The probe does not stop."""
    ticks = round(seconds * RATE)
    path = np.column_stack([np.zeros(ticks + 1), -SPEED / RATE * (np.arange(ticks + 1) - 1 + part)])
    velocity = np.full((ticks + 1, 2), [0.0, -SPEED])
    force: Floats = rig.render(path, velocity=velocity)["vibration_force_n"][1:, 1]
    return force


def acceleration(force: Floats, wall: float = 0.0, damper: float = 0.0, actuator: Actuator | None = None) -> Floats:
    """Of the handle from rest, in FINE parts of a period: what is held is the force less that of a sampled wall."""
    states = 2 if actuator is None else 2 + actuator.order
    law = np.zeros((states + 1, states + 1))
    law[0, 1] = 1
    law[1, :2] = -STIFFNESS / MASS, -DAMPING / MASS
    law[1, 2] = 1 / MASS
    if actuator is not None:
        a, zeta = actuator.rate_per_s, actuator.damping_ratio
        if actuator.order == 1:
            law[2, 2:] = -a, a
        else:
            law[2, 3] = 1
            law[3, 2:] = -a * a, -2 * zeta * a, a * a
    step = expm(law / RATE / FINE)
    state = np.zeros(states + 1)
    before, found = 0.0, []
    for push in force:
        state[-1] = push - wall * state[0] - damper * (state[0] - before) * RATE
        before = state[0]
        for _ in range(FINE):
            was = state[1]
            state = step @ state
            found.append((state[1] - was) * RATE * FINE)
    return np.array(found)


def error_of(moved: Floats, mode: Mode, part: float) -> float:
    """RMS of the difference to exp(-B t) sin(w t) from 30 Hz to 0.4 of the rate, over its RMS."""
    moved = np.concatenate((np.zeros(round(part * FINE)), moved))
    pole = complex(-mode.decay_rate_per_s, mode.angular_frequency_rad_per_s)
    integral = (np.exp(pole * np.arange(len(moved) + 1) / RATE / FINE) / pole).imag
    wanted = np.diff(integral) * RATE * FINE
    lines = 1 << 18
    frequency = np.fft.rfftfreq(lines, 1 / RATE / FINE)
    band = (frequency >= 30) & (frequency <= 0.4 * RATE)
    one, other = (np.fft.rfft(each, lines)[band] for each in (moved - wanted, wanted))
    return float(np.linalg.norm(one) / np.linalg.norm(other))


AT_TICK = 2.0**-20


@pytest.mark.long
@pytest.mark.parametrize(("name", "before", "after"), [("wood", 0.20, 0.07), ("acrylic", 0.14, 0.08)])
def test_the_wall_that_is_tapped_is_compensated_for(name: str, before: float, after: float) -> None:
    known = acceleration(tapped(rig_of(tap_of(name, 800)), AT_TICK), 800)
    # The same forces as if nothing were touched: those of a wall without stiffness.
    unknown = acceleration(tapped(rig_of(tap_of(name, 0)), AT_TICK), 800)
    assert error_of(unknown, mode_of(name), AT_TICK) > before
    assert error_of(known, mode_of(name), AT_TICK) < after
    free = acceleration(tapped(rig_of(tap_of(name, 0)), AT_TICK))
    assert error_of(free, mode_of(name), AT_TICK) < 0.03


@pytest.mark.long
def test_the_damping_of_the_wall_counts() -> None:
    for damper in (0.0, 5.0):
        moved = acceleration(tapped(rig_of(tap_of("wood", 800, damper)), AT_TICK), 800, damper)
        assert error_of(moved, mode_of("wood"), AT_TICK) < 0.07
    ignored = acceleration(tapped(rig_of(tap_of("wood", 800)), AT_TICK), 800, 5.0)
    assert error_of(ignored, mode_of("wood"), AT_TICK) > 0.07


@pytest.mark.long
@pytest.mark.parametrize("name", METALS)
def test_onsets_anywhere_between_two_ticks(name: str) -> None:
    """Metals were 11.5 to 16 % off over them."""
    errors = []
    for part in (np.arange(4) + 0.5) / 4:
        moved = acceleration(tapped(rig_of(tap_of(name, 800)), float(part), 0.06), 800)
        errors.append(error_of(moved, mode_of(name), float(part)))
    assert math.sqrt(np.mean(np.square(errors))) < 0.10


@pytest.mark.long
@pytest.mark.parametrize("order", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_the_lag_of_the_actuator_is_compensated_for(order: int) -> None:
    """The paper's device, 1.6 kHz: its metals lie there."""
    lag = {"bandwidth_hz": 1600, "order": order}
    actuator = Actuator.model_validate(lag)
    for name, allowed in (("wood", 0.07), ("aluminum", 0.13), ("steel", 0.16)):
        known = tapped(rig_of(tap_of(name, 800), actuator=lag), AT_TICK, 0.1)
        moved = acceleration(known, 800, actuator=actuator)
        assert error_of(moved, mode_of(name), AT_TICK) < allowed
    ignored = acceleration(tapped(rig_of(tap_of("steel", 800)), AT_TICK, 0.05), 800, actuator=actuator)
    assert error_of(ignored, mode_of("steel"), AT_TICK) > 0.5


def first(rig: Rig) -> float:
    """The force half a cycle after the strike tells gains apart."""
    return float(tapped(rig, AT_TICK, 0.004)[30])


def test_what_is_touched_beside_counts_by_its_slope_along_the_strike() -> None:
    """A strike sees sum K (n . d)^2 and the fields, along its direction d; the forces are linear in that."""
    material = tap_of("wood", 800)
    wall: dict[str, Any] = {**FLOOR, "material": "m"}
    off = rig_of(material)
    off.update(off.config.scene.to_dict()["objects"], display={"force": False, "vibration": True})
    free, alone = first(off), first(rig_of(material))
    assert free == pytest.approx(first(rig_of(tap_of("wood", 0))), rel=0.02)
    for beside, share in (
        ({"kind": "wall", "point_m": [0, 0.001], "normal": [0.6, 0.8], "material": "m"}, 1.64),
        ({"kind": "wall", "point_m": [0.001, 0], "normal": [1, 0], "material": "m"}, 1.0),
        ({"kind": "spring", "center_m": [0, 0], "stiffness_n_per_m": 400}, 1.5),
    ):
        both = rig_of(material, {"beside": beside, "wall": wall})
        # Whatever else the neighbour struck was struck in other ticks or along other directions.
        if beside["kind"] == "wall":
            both.render(np.full((3000, 2), [0.0, 0.0005]))
        slope = (first(both) - free) / (alone - free)
        assert slope == pytest.approx(share, rel=0.05)


def test_a_new_stiffness_is_known_to_the_next_strike_and_leaves_what_rings() -> None:
    """The live update of a wall that rings, and the same run again to the last bit."""

    def run() -> list[Floats]:
        rig = rig_of(tap_of("wood", 800))
        objects = rig.config.scene.to_dict()["objects"]
        one = tapped(rig, AT_TICK, 0.01)
        rig.update(objects, {"m": tap_of("wood", 2000)})
        deeper = -SPEED / RATE * (np.arange(101, 2101) - 1 + AT_TICK)
        path, velocity = np.column_stack([np.zeros(2000), deeper]), np.full((2000, 2), [0.0, -SPEED])
        rest = rig.render(path, velocity=velocity)["vibration_force_n"][:, 1]
        return [one, rest, tapped(rig, AT_TICK, 0.03)]

    found = run()
    whole = tapped(rig_of(tap_of("wood", 800)), AT_TICK, 0.21)
    assert np.array_equal(np.concatenate(found[:2]), whole[:2100])
    assert np.allclose(found[2], tapped(rig_of(tap_of("wood", 2000)), AT_TICK, 0.03), rtol=0, atol=1e-15)
    assert all(np.array_equal(one, other) for one, other in zip(found, run(), strict=True))


def test_without_compensation_nothing_of_it_is_there() -> None:
    rig = rig_of(tap_of("steel", 800), compensation="off")
    record = rig.table.materials[0].tap
    assert (record.touched_n_per_m, record.kick_count, record.tail_end_s) == (0, 0, 0)
    assert rig_of(tap_of("steel", 800)).table.materials[0].tap.kick_count == 8


def test_forces_are_those_of_the_closed_loop() -> None:
    """In `simulate` the handle taps by itself; with and without vibration the difference is what the tap made of it."""
    speeds = []
    for shown in (True, False):
        config = {
            "device": {"compensation": "full", "max_force_n": 100, "sim": EXACT},
            "materials": {"m": tap_of("wood", 800)},
            "scene": {"objects": {"wall": {**FLOOR, "material": "m"}}, "display": {"vibration": shown}},
        }
        run = simulate_run(config, [[0, 0, 0.004], [0.1, 0, 0.004], [0.2, 0, -0.004], [0.6, 0, -0.004]])
        speeds.append(run.truth[:, 3])
        (onset,) = (event for event in run.events if event["kind"] == 1)
    amplitude = onset["amplitude_m_per_s2"]
    moved = np.diff(speeds[0] - speeds[1])[onset["tick"] :][:3000] * RATE / amplitude
    part = onset["before_tick_s"] * RATE
    mode = mode_of("wood")
    pole = complex(-mode.decay_rate_per_s, mode.angular_frequency_rad_per_s)
    edges = (np.arange(len(moved) + 1) + part) / RATE
    wanted = np.diff((np.exp(pole * edges) / pole).imag) * RATE
    frequency = np.fft.rfftfreq(1 << 16, 1 / RATE)
    band = (frequency >= 30) & (frequency <= 4000)
    one, other = (np.fft.rfft(each, 1 << 16)[band] for each in (moved - wanted, wanted))
    assert np.linalg.norm(one) / np.linalg.norm(other) < 0.1


EXACT = {"coulomb_friction_n": 0, "encoder_step_m": 0, "force_step_n": 0, "max_force_n": 100}


@pytest.mark.long
@pytest.mark.parametrize("name", ["wood", "delrin"])
def test_friction_that_holds_the_probe_is_compensated_for(name: str) -> None:
    """A tap that vibrates along the surface, where the probe does not slide: friction's spring acts on the handle."""
    spring, errors = 800.0, {}
    for coefficient in (0.0, 0.5):
        material = tap_of(name, 800)
        material["tap"]["direction"] = "tangent"
        material["friction"] = {"coefficient": coefficient, "stiffness_n_per_m": spring}
        path = np.full((1201, 2), [0.0, -SPEED / RATE * AT_TICK])
        path[0, 1] = SPEED / RATE * (1 - AT_TICK)
        force = rig_of(material).render(path, velocity=np.full((1201, 2), [0.0, -SPEED]))["vibration_force_n"][1:, 0]
        errors[coefficient] = error_of(acceleration(force, spring), mode_of(name), AT_TICK)
    assert errors[0.0] > 0.15  # the forces of a surface that does not hold it
    assert errors[0.5] < 0.08


def test_friction_that_slides_has_no_slope() -> None:
    """A groove that is stroked strikes the same with friction and without it, to the last bit."""
    forces = []
    for coefficient in (0.0, 0.5):
        texture = {"kind": "grooves", "display": "vibration", "spacing_m": 0.004, "width_m": 0.001}
        texture |= {"velocity_gain_per_s": 60, "frequency_hz": 200, "decay_time_s": 0.003}
        rough = {"coefficient": coefficient, "stiffness_n_per_m": 500}
        rig = rig_of({"stiffness_n_per_m": 800, "texture": texture, "friction": rough})
        path = np.column_stack([np.linspace(0, 0.02, 2000), np.full(2000, -0.001)])
        path[0, 1] = 0.0001
        forces.append(rig.render(path)["vibration_force_n"])
    assert np.abs(forces[0]).max() > 0.1
    assert np.array_equal(forces[0], forces[1])
