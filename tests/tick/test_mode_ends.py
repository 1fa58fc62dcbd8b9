"""Where a mode ends: five time constants after its last strike, to the tick, whatever was struck between.

The references are the closed forms: the sum of A exp(-B t) sin(w t) of all strikes, up to 5/B after the last one."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import numpy.typing as npt
import pytest

from hapticd.base.core import EventKind, Status, ffi, lib
from hapticd.config.materials import Mode
from hapticd.rendering.compiler.mode_record import mode_record
from hapticd.rendering.device_output import output_of
from tests.support.rig import FLOOR, Rig, still

Array = npt.NDArray[np.float64]

RATE = 10_000
MASS = 0.05
SPEED = 0.1
SLOPE = 300.0


def material(mode: Mode) -> dict[str, object]:
    return {
        "stiffness_n_per_m": 800,
        "tap": {
            "attack_slope_per_s": SLOPE,
            "angular_frequency_rad_per_s": mode.angular_frequency_rad_per_s,
            "decay_rate_per_s": mode.decay_rate_per_s,
        },
    }


def taps(onsets: Array, x_m: Array, count: int) -> tuple[Array, Array]:
    """Positions and velocities of a probe that comes from above at `SPEED` through 0 at the times `onsets` (ticks), at
    the places x_m, and is above again a tick later."""
    position = np.zeros((count, 2))
    position[:, 1] = SPEED / RATE
    for onset, x in zip(onsets, x_m, strict=True):
        before = int(np.ceil(onset)) - 1
        position[before - 2 :, 0] = x
        position[before, 1] = SPEED / RATE * (onset - before)
        position[before + 1, 1] = -SPEED / RATE * (before + 1 - onset)
    return position, np.tile([0.0, -SPEED], (count, 1))


def closed(mode: Mode, onsets: Array, count: int) -> Array:
    """The force of all strikes of one mode, each before the end of the one before; silent 5/B after the last one."""
    ticks = np.arange(count)
    assert np.all(np.diff(onsets) / RATE <= 5 / mode.decay_rate_per_s + 1e-12)
    total = np.zeros(count)
    since_last = np.full(count, np.inf)
    for onset in onsets:
        since = (ticks - onset) / RATE
        since_last = np.where(since >= 0, since, since_last)
        wave = np.exp(-mode.decay_rate_per_s * since) * np.sin(mode.angular_frequency_rad_per_s * since)
        total += np.where(since >= 0, MASS * SLOPE * SPEED * wave, 0.0)
    return np.where(since_last <= 5 / mode.decay_rate_per_s, total, 0.0)


def rig_of(materials: dict[str, Mode], patches: list[dict[str, object]] | None = None) -> Rig:
    floor = {**FLOOR, "material": "a", **({"patches": patches} if patches else {})}
    return Rig(
        {"w": floor},
        materials={name: material(mode) for name, mode in materials.items()},
        device={"effective_mass_kg": MASS, "max_speed_m_per_s": 1000},
    )


def test_a_mode_of_a_whole_number_of_ticks_sounds_at_its_last() -> None:
    """372 decay times whose 5/B is n periods, at three rates: the mode sounds at n + 1 ticks, the last one included."""
    wrong = []
    for rate in (1000, 2000, 10_000):
        rig = Rig({"w": FLOOR}, rate_hz=rate, device={"effective_mass_kg": MASS})
        for n in range(2, 126):
            decay_s = float(Fraction(n, 5 * rate))
            rig.render(still(0, 1, 200))
            record = ffi.new("struct hd_mode *")
            record[0] = mode_record(Mode(1 / decay_s, 0.11 * rate), 1.0, 1.0, output_of(rig.config, rate))
            assert lib.hd_play(rig.state, record, ffi.new("double[2]", (0.0, 1.0)), 10.0) == Status.OK
            heard = rig.render(still(0, 1, 200))["vibration_force_n"][:, 1]
            if np.flatnonzero(heard).tolist() != list(range(1, n + 1)):
                wrong.append((rate, n))
    assert wrong == []


@pytest.mark.parametrize("between", [0.25, 0.3, 0.35])
def test_a_strike_in_the_last_fraction_of_a_tick_adds_to_what_rings(between: float) -> None:
    """5/B is 20.6 periods and the first onset 9.7, so that the mode ends at 30.3, between two ticks. A strike before
    that finds it ringing, one after it does not."""
    mode = Mode(5 * RATE / 20.6, 700.0)
    onsets = np.array([9.7, 30.0 + between])
    rig = rig_of({"a": mode})
    position, velocity = taps(onsets, np.zeros(2), 80)
    vibration = rig.render(position, velocity)["vibration_force_n"][:, 1]
    assert len(rig.of(EventKind.CONTACT)) == 2
    rings = 30.0 + between <= 30.3 + 1e-9
    expected = closed(mode, onsets, 80) if rings else sum(closed(mode, onsets[i : i + 1], 80) for i in range(2))
    np.testing.assert_allclose(vibration, expected, rtol=0, atol=1e-12)
    assert np.any(vibration[31:52])


def test_patches_a_b_a_are_one_mode_of_a_and_one_of_b() -> None:
    modes = {"a": Mode(300.0, 900.0), "b": Mode(200.0, 2100.0), "c": Mode(350.0, 3000.0)}
    patches = [
        {"from_m": 0.01, "to_m": 0.02, "material": "b"},
        {"from_m": 0.02, "to_m": 0.03, "material": "c"},
    ]
    rig = rig_of(modes, patches)
    where = "abcabca"
    at = {"a": 0.0, "b": 0.015, "c": 0.025}
    onsets = 20.13 + 41.3 * np.arange(len(where))
    count = 700
    position, velocity = taps(onsets, np.array([at[name] for name in where]), count)
    vibration = rig.render(position, velocity)["vibration_force_n"][:, 1]
    contacts = rig.of(EventKind.CONTACT)
    assert len(contacts) == len(where) and np.all(contacts["scale"] == 1)
    expected = np.zeros(count)
    for name, mode in modes.items():
        expected += closed(mode, onsets[[letter == name for letter in where]], count)
    np.testing.assert_allclose(vibration, expected, rtol=0, atol=1e-12)
