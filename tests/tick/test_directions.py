"""Where the vibration of taps and ruptures acts: normal, tangent, an angle.

The reference is the equation, m A exp(-B t) sin(w t) along the direction from the time of the onset on, and for what
the handle does of it a handle in a hand at a wall that presses along one axis, by the matrix exponential.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from hapticd import InvalidError, render
from hapticd.base.core import EventKind
from hapticd.config.configuration import load_config
from hapticd.config.materials import validate_materials
from tests.support.rig import Rig
from tests.tick.test_touched import AT_TICK, acceleration, error_of, mode_of, tap_of

Floats = npt.NDArray[np.float64]

RATE = 10_000.0
MASS = 0.05
SPEED = 0.2
SLOPE, FREQUENCY, DECAY_S = 100.0, 180.0, 0.004
TAP = {"attack_slope_per_s": SLOPE, "frequency_hz": FREQUENCY, "decay_time_s": DECAY_S}
RUPTURE = {"depth_m": 0.003, "amplitude_m_per_s2": 38, "frequency_hz": 200, "decay_time_s": 0.003}
AIMS: dict[str, tuple[dict[str, Any], float]] = {
    "plain": ({}, 0.0),
    "normal": ({"direction": "normal"}, 0.0),
    "tangent": ({"direction": "tangent"}, math.pi / 2),
    "angle": ({"angle_rad": 0.7}, 0.7),
    "back": ({"angle_rad": -2.5}, -2.5),
}
aims = pytest.mark.parametrize("aim", AIMS)


def turned(normal: Floats, angle: float, side: float = 1.0) -> Floats:
    """The normal turned by an angle towards the tangent (n_y, -n_x); of a surface seen from below, as in a mirror."""
    tangent = side * np.array([normal[1], -normal[0]])
    found: Floats = math.cos(angle) * normal + math.sin(angle) * tangent
    return found


def ringing(time: Floats, amplitude: float, frequency: float, decay_s: float) -> Floats:
    heard = np.exp(-time / decay_s) * np.sin(2 * math.pi * frequency * time)
    found: Floats = np.where((time >= 0) & (time <= 5 * decay_s), MASS * amplitude * heard, 0.0)
    return found


SOLIDS: dict[str, tuple[dict[str, Any], tuple[float, float], tuple[float, float]]] = {
    # The object, where it is touched, and its normal there.
    "floor": ({"kind": "wall", "point_m": [0, 0], "normal": [0, 1]}, (0.01, 0.0), (0, 1)),
    "slant": ({"kind": "wall", "point_m": [0, 0], "normal": [-0.6, 0.8]}, (0.0, 0.0), (-0.6, 0.8)),
    **{
        f"face {face}": (
            {"kind": "box", "center_m": [0.01, 0.02], "size_m": [0.04, 0.02], "angle_rad": 0.3},
            (0.01 + half * math.cos(0.3 + at), 0.02 + half * math.sin(0.3 + at)),
            (math.cos(0.3 + at), math.sin(0.3 + at)),
        )
        for face, (at, half) in enumerate((k * math.pi / 2, (0.02, 0.01)[k % 2]) for k in range(4))
    },
    **{
        f"disc at {at}": (
            {"kind": "disc", "center_m": [0, 0], "radius_m": 0.01},
            (0.01 * math.cos(at), 0.01 * math.sin(at)),
            (math.cos(at), math.sin(at)),
        )
        for at in (0.2, 1.9, -2.4)
    },
}


@aims
@pytest.mark.parametrize("solid", SOLIDS)
def test_a_tap_at_every_tick(solid: str, aim: str) -> None:
    item, place, normal = SOLIDS[solid]
    keys, angle = AIMS[aim]
    rig = Rig({"it": {**item, "material": "m"}}, materials={"m": {"stiffness_n_per_m": 0.0, "tap": {**TAP, **keys}}})
    n, part = np.array(normal), 0.3
    # From 20.3 periods before the onset on, straight in; nothing presses, so that only the tap is there.
    steps = np.arange(300.0)
    path = np.array(place) - n * SPEED * (np.minimum(steps, 60.0) - 20 - part)[:, None] / RATE
    found = rig.render(path, velocity=np.tile(-SPEED * n, (300, 1)))["vibration_force_n"]
    heard = ringing((steps - 20 - part) / RATE, SLOPE * SPEED, FREQUENCY, DECAY_S)
    np.testing.assert_allclose(found, heard[:, None] * turned(n, angle), rtol=0, atol=1e-11)
    assert np.abs(heard).max() > 0.5


@aims
@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("slant", [0.0, 0.8])
def test_a_rupture_from_both_sides(slant: float, side: float, aim: str) -> None:
    """n is that of the side entered, t stays: what breaks from below moves as its mirror image."""
    keys, angle = AIMS[aim]
    own = np.array([math.sin(slant), math.cos(slant)])
    item = {"kind": "membrane", "center_m": [0, 0], "normal": own.tolist(), "width_m": 0.02, "material": "m"}
    rig = Rig({"it": item}, materials={"m": {"stiffness_n_per_m": 10.0, "rupture": {**RUPTURE, **keys}}})
    n, part = side * own, 0.6
    steps = np.arange(400.0)
    ruptures = 20 + part + 0.003 * RATE / SPEED
    path = -n * SPEED * (np.minimum(steps, 250.0) - 20 - part)[:, None] / RATE
    found = rig.render(path, velocity=np.tile(-SPEED * n, (400, 1)))["vibration_force_n"]
    assert len(rig.of(EventKind.PUNCTURE)) == 1
    heard = ringing((steps - ruptures) / RATE, 38, 200, 0.003)
    assert np.abs(heard).max() > 0.5
    # -n and the same t: the tangent of the side entered, taken the other way.
    np.testing.assert_allclose(found, heard[:, None] * turned(n, angle, side), rtol=0, atol=1e-11)


def test_both_modes_of_a_tap_act_along_its_direction() -> None:
    second = {"frequency_hz": 410, "decay_time_s": 0.002, "ratio": -0.5}
    tap = {**TAP, "angle_rad": 1.1, "second": second}
    rig = Rig({"it": {**SOLIDS["slant"][0], "material": "m"}}, materials={"m": {"stiffness_n_per_m": 0.0, "tap": tap}})
    n = np.array([-0.6, 0.8])
    steps = np.arange(150.0)
    found = rig.render(-n * SPEED * (steps - 0.5)[:, None] / RATE, velocity=np.tile(-SPEED * n, (150, 1)))
    time = (steps - 0.5) / RATE
    whole = ringing(time, SLOPE * SPEED, FREQUENCY, DECAY_S) + ringing(time, -0.5 * SLOPE * SPEED, 410, 0.002)
    np.testing.assert_allclose(found["vibration_force_n"], whole[:, None] * turned(n, 1.1), rtol=0, atol=1e-11)


@pytest.mark.parametrize("compensation", ["off", "full"])
def test_without_a_direction_it_is_the_normal_to_the_last_bit(compensation: str) -> None:
    path = np.column_stack((np.zeros(200), 0.0012 - 1e-5 * np.arange(200.0)))

    def run(keys: dict[str, Any]) -> bytes:
        material = {"stiffness_n_per_m": 800, "tap": {**TAP, **keys}}
        config = {
            "device": {"compensation": compensation},
            "materials": {"m": material},
            "scene": {"objects": {"it": {**SOLIDS["floor"][0], "material": "m"}}},
        }
        samples: bytes = render(config, path, rate_hz=RATE).tobytes()
        return samples

    plain = run({})
    assert plain == run({"direction": "normal"})
    assert run({"angle_rad": 0.7}) == run({"angle_rad": 0.7}) != plain


def displayed(angle: float, name: str = "wood", stiffness: float = 800.0) -> tuple[Floats, Floats]:
    """Acceleration of the handle by a tap with A = 1: along n, where a wall presses, and along t, where none does."""
    material = tap_of(name, stiffness)
    material["tap"]["angle_rad"] = angle
    device = {"compensation": "full", "max_force_n": 100}
    objects = {"wall": {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "m"}}
    rig = Rig(objects, materials={"m": material}, device=device)
    speed, ticks = 1 / 64, 1200
    path = np.column_stack([np.zeros(ticks + 1), -speed / RATE * (np.arange(ticks + 1) - 1 + AT_TICK)])
    force = rig.render(path, velocity=np.tile([0.0, -speed], (ticks + 1, 1)))["vibration_force_n"][1:]
    return acceleration(force[:, 1], stiffness), acceleration(force[:, 0])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["wood", "acrylic"])
@pytest.mark.parametrize("angle", [0.4, math.pi / 4, 1.2])
def test_full_compensation_is_right_along_each_axis(angle: float, name: str) -> None:
    """At an angle, the wall acts on one part of the vibration and not on the other."""
    across, along = displayed(angle, name)
    assert error_of(across / math.cos(angle), mode_of(name), AT_TICK) < 0.09
    assert error_of(along / math.sin(angle), mode_of(name), AT_TICK) < 0.09


def test_the_wall_does_not_act_along_the_tangent() -> None:
    """Compensated as if it did, wood would be 20 % off."""
    across, along = displayed(math.pi / 2)
    assert error_of(along, mode_of("wood"), AT_TICK) < 0.03
    assert np.abs(across).max() < 1e-12


def test_at_the_limit_the_direction_stays() -> None:
    """The strike is scaled as a whole, along n and along t alike."""
    material = tap_of("wood", 800)
    material["tap"] |= {"angle_rad": 0.5, "attack_slope_per_s": 5000}
    for compensation in ("off", "full"):
        rig = Rig(
            {"wall": {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "m"}},
            materials={"m": material},
            device={"compensation": compensation, "max_force_n": 2},
        )
        path = np.full((400, 2), [0.0, -1e-6])
        path[0, 1] = 1e-6
        found = rig.render(path, velocity=np.tile([0.0, -0.5], (400, 1)))
        assert 0 < rig.of(EventKind.CONTACT)["scale"][0] < 0.2
        assert np.hypot(*found["force_n"].T).max() <= 2 * (1 + 1e-12)
        heard = found["vibration_force_n"]
        strongest = heard[np.hypot(*heard.T).argmax()]
        angle = math.atan2(strongest[0], strongest[1])
        assert angle == pytest.approx(0.5, abs=1e-9 if compensation == "off" else 0.2)


def test_faults_are_one_line_each() -> None:
    for use, keys in (("tap", TAP), ("rupture", RUPTURE)):
        for more, told in (
            ({"direction": "up"}, f"m.{use}.direction: should be 'tangent' or 'normal'"),
            ({"angle_rad": 11}, f"m.{use}.angle_rad: should be less than or equal to 10"),
            ({"angle_rad": "1"}, f"m.{use}.angle_rad"),
            ({"direction": "normal", "angle_rad": 1}, f"m.{use}: needs at most one of direction and angle_rad"),
        ):
            with pytest.raises(InvalidError) as caught:
                validate_materials({"m": {"stiffness_n_per_m": 800, use: {**keys, **more}}})
            assert told in str(caught.value) and "\n" not in str(caught.value)


def test_what_is_given_is_what_is_kept() -> None:
    for keys in ({}, {"direction": "tangent"}, {"angle_rad": 0.25}):
        data = {"stiffness_n_per_m": 800, "tap": {**TAP, **keys}}
        kept: Any = load_config({"materials": {"m": data}}).materials["m"].to_dict()
        assert {key: kept["tap"].get(key) for key in ("direction", "angle_rad")} == {
            key: keys.get(key) for key in ("direction", "angle_rad")
        }
        assert validate_materials({"m": kept})["m"].to_dict() == kept
    assert all(one != other for one, other in pairwise(AIMS.values()))
