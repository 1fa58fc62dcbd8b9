"""Noise and ringing modes where the contact takes the force limit: noise yields first, by a gain that is the same for
samples of either sign; modes that ring when the contact passes the limit make room for it without a step.

The references are the same strokes without a limit, and closed forms of the contact force K d."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from hapticd.base.core import EventKind, Flag, Status, ffi, lib
from hapticd.config.materials import Mode
from hapticd.rendering.compiler.mode_record import mode_record
from hapticd.rendering.device_output import output_of
from tests.support.rig import FLOOR, Rig, line, still

Array = npt.NDArray[np.float64]

RATE = 10_000
STIFFNESS = 800.0
LIMIT = 8.9
GAIN_RAMP_S = 0.02
CREST = 4.0
"""The noise's gain leaves so many RMS of it room."""
LOUD = {
    "kind": "stochastic",
    "peak_hz": 250,
    "mean_hz": 310,
    "velocity_gain_per_s": 200,
    "direction": "normal",
    "seed": 7,
}
SPEED = 0.1
RMS_N = 0.05 * 200 * SPEED


def stroke(force_n: npt.ArrayLike, limit_n: float, **texture: object) -> tuple[Rig, npt.NDArray[np.void]]:
    """A stroke at `SPEED` along a floor, pressed with a force a tick."""
    force = np.asarray(force_n, dtype=np.float64)
    rig = Rig(
        {"w": {**FLOOR, "material": "paper"}},
        materials={"paper": {"stiffness_n_per_m": STIFFNESS, "texture": {**LOUD, **texture}}},
        device={"effective_mass_kg": 0.05, "max_force_n": limit_n},
    )
    ticks = np.arange(len(force))
    position = np.stack([SPEED / RATE * ticks, -force / STIFFNESS], axis=1)
    velocity = np.tile([SPEED, 0.0], (len(force), 1))
    return rig, rig.render(position, velocity)


def play(rig: Rig, mode: Mode, direction: tuple[float, float], amplitude_m_per_s2: float) -> None:
    record = ffi.new("struct hd_mode *")
    record[0] = mode_record(mode, 1.0, 1.0, output_of(rig.config, rig.rate_hz))
    assert lib.hd_play(rig.state, record, ffi.new("double[2]", direction), amplitude_m_per_s2) == Status.OK


@pytest.mark.parametrize("pressed_n", [6.0, 8.0, 8.85, LIMIT])
def test_the_mean_force_at_the_limit_is_the_contact_s(pressed_n: float) -> None:
    _, samples = stroke(np.full(12_000, pressed_n), LIMIT)
    force = samples["force_n"][400:, 1]
    room = LIMIT - pressed_n
    rms = min(RMS_N, room / CREST)
    # Noise of this spectrum forgets itself within some 20 samples.
    assert np.mean(force) == pytest.approx(pressed_n, abs=5 * rms * np.sqrt(20 / len(force)) + 1e-9)
    assert force.min() >= pressed_n - room - 1e-9 and np.hypot(*samples["force_n"].T).max() <= LIMIT
    assert np.std(force) == pytest.approx(rms, rel=0.1, abs=1e-9)
    both = samples["contact_force_n"] + samples["vibration_force_n"]
    np.testing.assert_allclose(samples["force_n"], both, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("direction", ["normal", "tangent"])
def test_noise_keeps_its_waveform_when_it_yields(direction: str) -> None:
    """It is the unlimited noise by one gain, and never larger."""
    axis = 1 if direction == "normal" else 0
    pressed = np.full(4000, 8.0)
    _, free = stroke(pressed, 100.0, direction=direction)
    _, held = stroke(pressed, LIMIT, direction=direction)
    ratio = held["vibration_force_n"][400:, axis] / free["vibration_force_n"][400:, axis]
    expected = (LIMIT - 8.0) / (CREST * RMS_N)
    assert np.median(ratio) == pytest.approx(expected, rel=1e-9)
    assert ratio.max() <= expected * (1 + 1e-9) and ratio.min() > 0.6 * expected
    assert np.mean(np.abs(ratio / expected - 1) > 1e-9) < 0.1


def test_the_gain_comes_back_over_its_ramp_and_is_reported_once() -> None:
    """Pressed to the limit, then let off to 2 N: the gain rises by a tick's part of 20 ms at most."""
    pressed = np.concatenate(
        [np.full(400, 8.0), np.linspace(8, LIMIT, 400), np.linspace(LIMIT, 2, 400), np.full(600, 2.0)]
    )
    _, free = stroke(pressed, 100.0)
    rig, held = stroke(pressed, LIMIT)
    noise = free["vibration_force_n"][:, 1]
    heard = (np.abs(noise) > 0.05) & (np.arange(len(noise)) > 300)  # the contact, met inside, has come in
    gain = np.interp(
        np.arange(len(noise)), np.flatnonzero(heard), (held["vibration_force_n"][:, 1][heard] / noise[heard])
    )
    room = np.minimum(1, (LIMIT - pressed) / (CREST * RMS_N))
    assert np.all(gain[300:] <= room[300:] + 2e-3)
    assert np.diff(gain[300:]).max() <= 1 / (GAIN_RAMP_S * RATE) * (1 + 1e-6)
    np.testing.assert_allclose(gain[-300:], 1, rtol=1e-9)
    saturated = (held["flags"] & Flag.SATURATED) != 0
    assert np.array_equal(saturated[heard], gain[heard] < 1 - 1e-12)
    assert len(rig.of(EventKind.SATURATION)) == 1


def test_a_strike_does_not_make_room_for_noise() -> None:
    """A mode struck by hand in loud noise is as large as without it; the noise yields to it."""
    scales = []
    for gain in (1e-9, 200.0):
        rig = Rig(
            {"w": {**FLOOR, "material": "paper"}},
            materials={
                "paper": {
                    "stiffness_n_per_m": STIFFNESS,
                    "tap": {"attack_slope_per_s": 600, "frequency_hz": 150, "decay_time_s": 0.01},
                    "texture": {**LOUD, "velocity_gain_per_s": gain},
                }
            },
            device={"effective_mass_kg": 0.05, "max_force_n": LIMIT},
        )
        depth = np.concatenate([np.full(5, -1e-4), np.linspace(1e-5, 5e-3, 100), np.full(295, 5e-3)])
        position = np.stack([SPEED / RATE * np.arange(400), -depth], axis=1)
        velocity = np.stack([np.full(400, SPEED), np.full(400, -0.45)], axis=1)
        samples = rig.render(position, velocity)
        assert np.hypot(*samples["force_n"].T).max() <= LIMIT
        scales.append(rig.of(EventKind.CONTACT)[0]["scale"])
    assert scales[0] == scales[1] and 0 < scales[0] < 1


@pytest.mark.parametrize("passivity", ["off", "control"])
@pytest.mark.parametrize("growth_ticks", [1, 10, 200])
@pytest.mark.parametrize("angle_degrees", [-90.0, 90.0, 0.0, -60.0])
def test_a_contact_force_at_the_limit_gets_it_in_full_whatever_rings(
    passivity: str, growth_ticks: int, angle_degrees: float
) -> None:
    """Modes of either sign, and pairs of opposite signs, ring while the wall's force grows to the limit of 4 N and to 6
    N, and returns. From 4 N on the command is the limit along the normal. Below it the vibration has the largest factor
    with which both of its signs fit; where both fit as they are, it is not changed."""
    limit = 4.0
    along = np.array([np.cos(np.radians(angle_degrees)), np.sin(np.radians(angle_degrees))])
    opposed = 0
    for delay in range(0, 180, 17):
        rig = Rig(
            {"w": {**FLOOR, "material": "plain"}},
            materials={"plain": {"stiffness_n_per_m": STIFFNESS}},
            device={"effective_mass_kg": 0.05, "max_force_n": limit, "max_speed_m_per_s": 1000},
            passivity=passivity,
        )
        levels = np.array([1.0, 1.0, 4.0, 4.0, 4.1, 4.1, 6.0, 6.0, 1.0, 1.0])
        ticks = np.cumsum([0, delay + 1, growth_ticks, 5, 1, 40, growth_ticks, 30, 1, 100])
        pressed = np.interp(np.arange(ticks[-1]), ticks, levels)
        rig.render(line(0.0005, 0.05, 20))
        rig.render(still(0, -1.0 / STIFFNESS, 20))
        for frequency_hz, sign in ((90.0, 1.0), (97.0, -0.8), (300.0, 0.3)):
            play(
                rig,
                Mode(1 / 0.05, 2 * np.pi * frequency_hz),
                (float(np.sign(sign) * along[0]), float(np.sign(sign) * along[1])),
                30.0 * abs(sign),
            )
        samples = rig.render(np.stack([np.zeros(len(pressed)), -pressed / STIFFNESS], axis=1))
        contact, vibration, force = (samples[f"{name}_n"] for name in ("contact_force", "vibration_force", "force"))
        if passivity == "off":  # the controller lowers what the wall gives back to a hand that leaves
            np.testing.assert_allclose(contact[:, 1], pressed, rtol=0, atol=1e-12)
        assert np.hypot(*force.T).max() <= limit
        full = contact[:, 1] >= limit
        np.testing.assert_allclose(force[full], np.tile([0, limit], (full.sum(), 1)), rtol=0, atol=1e-11)
        widest = np.maximum(np.hypot(*(contact + vibration).T), np.hypot(*(contact - vibration).T))
        fits = ~full & (widest < limit * (1 - 1e-12))
        np.testing.assert_allclose(force[fits], (contact + vibration)[fits], rtol=0, atol=1e-15)
        scaled = ~full & (widest > limit * (1 + 1e-12))
        left = (force - contact)[scaled]
        factor = np.sum(left * vibration[scaled], axis=1) / np.sum(vibration[scaled] ** 2, axis=1)
        np.testing.assert_allclose(left, factor[:, None] * vibration[scaled], rtol=0, atol=1e-11)
        sums = [np.hypot(*(contact[scaled] + side * left).T) for side in (1, -1)]
        np.testing.assert_allclose(np.maximum(*sums), limit, rtol=1e-11)
        opposed += int(np.sum(np.hypot(*(contact + vibration)[full].T) < limit - 0.01))
    if growth_ticks == 1 and angle_degrees != 0:
        assert opposed > 0  # the sum of what is wanted lay below the limit


@pytest.mark.parametrize("slant", [0.0, 90.0, 30.0])
def test_what_rings_when_the_contact_passes_the_limit_ends_without_a_step(slant: float) -> None:
    """A mode played at an angle to the normal, while the wall grows through the limit in some ticks. From tick to tick
    the command moves by no more than contact and mode do by themselves, and as the room closes that is left for the
    mode: limit - contact along the normal, sqrt(limit^2 - contact^2) along the surface."""
    count, mode_hz, decay = 1500, 60.0, 0.05
    for phase in range(0, 160, 20):
        pressed = np.concatenate([np.full(450 + phase, 6.0), np.linspace(6, 12, 40), np.full(count - 490 - phase, 12)])
        runs = []
        for limit in (100.0, LIMIT):
            rig = Rig(
                {"w": {**FLOOR, "material": "plain"}},
                materials={"plain": {"stiffness_n_per_m": STIFFNESS}},
                device={"effective_mass_kg": 0.05, "max_force_n": limit},
            )
            position = np.stack([np.zeros(count), -pressed / STIFFNESS], axis=1)
            first = rig.render(position[:400])
            angle = np.radians(90 - slant)
            play(rig, Mode(1 / decay, 2 * np.pi * mode_hz), (float(np.cos(angle)), float(np.sin(angle))), 50.0)
            runs.append(np.concatenate([first["force_n"], rig.render(position[400:])["force_n"]]))
        free, held = runs
        assert np.hypot(*held.T).max() <= LIMIT
        mode = free - np.stack([np.zeros(count), pressed], axis=1)
        own = np.abs(np.diff(pressed)) + np.hypot(*np.diff(mode, axis=0).T)
        fade = np.hypot(*mode[:-1].T) / (GAIN_RAMP_S * RATE)
        room = np.stack([np.sqrt(np.maximum(0, LIMIT**2 - pressed**2)), np.maximum(0, LIMIT - pressed)])
        closing = np.hypot(*(np.abs(np.diff(room)) * [[np.sin(np.radians(slant))], [np.cos(np.radians(slant))]]))
        step = np.hypot(*np.diff(held, axis=0).T)
        assert np.all(step[410:] <= (own + 2 * fade + closing)[410:] + 1e-9), phase
        np.testing.assert_allclose(held[-1], [0, LIMIT], rtol=1e-12, atol=1e-12)
