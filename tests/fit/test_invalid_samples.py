"""Impossible samples, in each column and each fit: reported with their place, and left out or refused."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from functools import cache

import numpy as np
import pytest

from hapticd.analysis.statistics import FitError, Floats
from hapticd.config.materials import Material, shipped_materials, validate_materials
from hapticd.fit.grooves import fit_grooves
from hapticd.fit.preparation import without_invalid_samples
from hapticd.fit.puncture import fit_puncture
from hapticd.fit.recording import Recording, Source
from hapticd.fit.synthesize import Hand, Stylus, grooves, puncture, taps, texture
from hapticd.fit.tap import fit_tap
from hapticd.fit.texture import fit_texture

RATE = 1000.0
COUNT = 2000
AT = 700
SECOND = AT / RATE
"""Time of sample AT."""
Change = Callable[[Floats], None]


def at(value: float, samples: int = 1, first: int = AT) -> Change:
    def change(values: Floats) -> None:
        values[first : first + samples] = value

    return change


def wild(values: Floats) -> None:
    values[AT : AT + 8] = 40.0 * np.array([1, -1, 1.5, -0.7, 2, -2, 0.5, 1])


def held(values: Floats) -> None:
    values[AT : AT + 150] = values[AT]


def wrapped(by: float) -> Change:
    def change(values: Floats) -> None:
        values[AT:] += by

    return change


def spoilt(recording: Recording, name: str, change: Change) -> Recording:
    values = np.array(getattr(recording, name), dtype=np.float64)
    change(values)
    return dataclasses.replace(recording, **{name: values})  # type: ignore[arg-type]


def stroke(seed: int = 1, **more: object) -> Recording:
    """Two seconds of a hand at 0.1 m/s and 1 N, as sines and white noise."""
    random = np.random.default_rng(seed)
    time = np.arange(COUNT) / RATE
    speed = 0.1 + 0.02 * np.sin(5 * time)
    columns: dict[str, object] = {
        "acceleration_m_per_s2": random.standard_normal(COUNT),
        "force_n": 1 + 0.2 * np.sin(4 * time) + 0.005 * random.standard_normal(COUNT),
        "position_m": None,
        "tangential_position_m": np.cumsum(speed) / RATE + 2e-6 * random.standard_normal(COUNT),
        "speed_m_per_s": speed + 0.001 * random.standard_normal(COUNT),
        **more,
    }
    return Recording(name="a", rate_hz=RATE, source=Source("a", ""), **columns)  # type: ignore[arg-type]


FOUND: Mapping[str, tuple[str, Change, str, int]] = {
    "force beyond": ("force_n", at(505831), f"the force of 505831 N at {SECOND:g} s is impossible (at most 200)", 1),
    "force of 201": ("force_n", at(-201), f"the force of -201 N at {SECOND:g} s is impossible", 1),
    "force not a number": ("force_n", at(np.nan, 5), f"the force of nan N at {SECOND:g} s is impossible", 5),
    "force spike": ("force_n", at(9.0), f"the force leaps to 9 N at {SECOND:g} s and back", 1),
    "force burst": ("force_n", wild, "N at 0.70", 8),
    "force stuck": ("force_n", held, f"from {SECOND:g} s to 0.849 s", 150),
    "force dropped out": ("force_n", at(0.0, 90), f"stands still at 0 N from {SECOND:g} s", 90),
    "speed beyond": ("speed_m_per_s", at(39.8), f"the speed of 39.8 m/s at {SECOND:g} s is impossible (at most 5)", 1),
    "speed spike": ("speed_m_per_s", at(-1.0, 3), f"the speed leaps to -1 m/s at {SECOND:g} s and back", 3),
    "speed stuck": ("speed_m_per_s", held, "the speed stands still", 150),
    "position wrapped": ("tangential_position_m", wrapped(-0.04), "leaps by -0.04", 1),
    "position slipped": ("tangential_position_m", wrapped(0.003), "leaps by 0.003", 1),
    "position spike": ("tangential_position_m", at(4e6), f"leaps to 4e+06 m at {SECOND:g} s and back", 1),
    "position burst": ("tangential_position_m", wild, "and back", 8),
    "position held": ("tangential_position_m", held, f"stands still from {SECOND:g} s, and leaps", 149),
    "acceleration beyond": ("acceleration_m_per_s2", at(2e6, 2), "the acceleration of 2e+06 m/s^2 at 0.7 s", 2),
    "acceleration held": ("acceleration_m_per_s2", held, "the acceleration stands still", 150),
}


@pytest.mark.parametrize("which", FOUND)
def test_impossible_samples_are_reported_with_place_and_replaced(which: str) -> None:
    """A straight line replaces the samples; in a smooth column it is within the noise of the true values."""
    name, change, message, samples = FOUND[which]
    clean = stroke()
    kept = without_invalid_samples(spoilt(clean, name, change), "texture")
    (line,) = kept.warnings
    assert line.startswith("a: ")
    assert message in line
    assert np.count_nonzero(kept.replaced) == samples
    assert kept.replaced[AT] or kept.replaced[AT + 1]
    if name != "acceleration_m_per_s2":
        truth, found = getattr(clean, name), getattr(kept.recording, name)
        noise = {"force_n": 0.04, "speed_m_per_s": 0.01, "tangential_position_m": 1.2e-3}[name]
        assert np.abs(found - truth).max() < noise


@pytest.mark.parametrize("kind", ["tap", "grooves", "texture", "puncture"])
def test_possible_samples_are_not_replaced(kind: str) -> None:
    """A rest between two strokes, coarse encoders, positions that come slowly and are held, and a force that ends."""
    plain = stroke()
    time = np.arange(COUNT) / RATE
    place = np.interp(time, [0, 0.5, 0.9, 1.5, 2], [0, 0, 0.2, 0.2, 0])
    rupture = np.where(time < 1.2, np.maximum(0.0, 8 * (time - 1.0)), 0.0)
    noise = np.random.default_rng(2).standard_normal(COUNT)
    for changed in (
        {},
        {"tangential_position_m": np.round(place / 1e-4) * 1e-4},
        {"tangential_position_m": np.repeat(place[::8], 8)},
        {"tangential_position_m": place + 1e-4 * noise},
        {"force_n": np.round(np.array(plain.force_n) / 0.1) * 0.1},
        {"force_n": np.repeat(np.array(plain.force_n)[::10], 10)},
        {"force_n": np.full(COUNT, 1.5), "speed_m_per_s": np.repeat([0.1, 0.2], COUNT // 2)},
        {"force_n": np.where(time < 0.4, 0.0, 1.0 + 0.05 * noise)},
        {"force_n": rupture} if kind in ("tap", "puncture") else {},
    ):
        recording = dataclasses.replace(plain, **changed)  # type: ignore[arg-type]
        kept = without_invalid_samples(recording, kind)  # type: ignore[arg-type]
        assert kept.warnings == ()
        assert kept.recording is recording


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("force_n", "the force of 900 N at 0.7 s is impossible (at most 200), and so are 1.5 % of the samples"),
        ("speed_m_per_s", "the speed of 900 m/s at 0.7 s is impossible (at most 5)"),
        ("acceleration_m_per_s2", "is it in another unit"),
    ],
)
def test_many_impossible_samples_are_refused(name: str, message: str) -> None:
    value = 9e7 if name == "acceleration_m_per_s2" else 900.0
    with pytest.raises(FitError) as caught:
        without_invalid_samples(spoilt(stroke(), name, at(value, 30)), "grooves")
    assert message in str(caught.value)


def test_a_position_that_leaps_again_and_again_is_refused() -> None:
    place = np.cumsum(np.full(20_000, 1e-4))
    place += 0.05 * np.cumsum(np.random.default_rng(1).random(20_000) < 0.006)
    recording = stroke()
    with pytest.raises(FitError, match=r"a: the position along the surface leaps in \d+ places, first by 0.0501 m at "):
        without_invalid_samples(
            dataclasses.replace(
                recording,
                acceleration_m_per_s2=None,
                force_n=None,
                speed_m_per_s=None,
                tangential_position_m=place,
            ),
            "grooves",
        )


# ---- The fits --------------------------------------------------------------------------------------------------------

PLACES = ((0.05, 0.6), (0.05, 2.0), (0.15, 0.6), (0.15, 2.0), (0.1, 1.0))


def material(**keys: object) -> Material:
    return validate_materials({"truth": {"stiffness_n_per_m": 500.0, **keys}})["truth"]


@cache
def strokes() -> tuple[Recording, ...]:
    grit = {"peak_hz": 160.0, "mean_hz": 210.0, "velocity_gain_per_s": 24.0, "force_gain_m_per_s2_per_n": 2.4}
    truth = material(texture={"kind": "stochastic", **grit})
    return tuple(
        texture(truth, speed, force, Stylus(seed=k, rate_hz=2500.0), Hand(duration_s=4.0))
        for k, (speed, force) in enumerate(PLACES)
    )


def by_speed(recording: Recording) -> Recording:
    """Return the recording with a column of speeds instead of the position."""
    place = recording.tangential_position_m
    assert place is not None
    speed = np.convolve(np.abs(np.gradient(place)) * recording.rate_hz, np.ones(51) / 51, "valid")
    column = np.concatenate((np.full(25, speed[0]), speed, np.full(25, speed[-1])))
    return dataclasses.replace(recording, speed_m_per_s=column, tangential_position_m=None)


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "change", "place"),
    [
        ("force_n", at(505831), "505831 N at 0.28 s"),
        ("force_n", at(np.nan, 4), "nan N at 0.28 s"),
        ("speed_m_per_s", at(39.8), "39.8 m/s at 0.28 s"),
        ("tangential_position_m", wrapped(0.4), "0.4"),
        ("acceleration_m_per_s2", at(8e5), "800000 m/s^2 at 0.28 s"),
        ("acceleration_m_per_s2", at(400.0, 2), "a knock"),
    ],
)
def test_textures_do_not_follow_a_wild_sample(name: str, change: Change, place: str) -> None:
    """The gains are those without the wild sample, within a fifth of their intervals."""
    clean = list(strokes())
    if name == "speed_m_per_s":
        clean = [by_speed(each) for each in clean]
    truth = fit_texture(clean)
    found = fit_texture([spoilt(clean[0], name, change), *clean[1:]])
    assert sum(place in line for line in found.warnings) == 1
    for gain in ("velocity_gain_per_s", "force_gain_m_per_s2_per_n"):
        one, other = getattr(found, gain), getattr(truth, gain)
        assert abs(one.value - other.value) < 0.2 * (other.high - other.low)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("force_n", at(505831)),
        ("force_n", wild),
        ("tangential_position_m", wrapped(-0.03)),
        ("tangential_position_m", at(1e6)),
        ("acceleration_m_per_s2", at(9e4)),
    ],
)
def test_grooves_do_not_follow_a_wild_sample(name: str, change: Change) -> None:
    mode = {"spacing_m": 0.002, "frequency_hz": 200.0, "decay_time_s": 0.003, "width_m": 0.0005}
    gains = {"velocity_gain_per_s": 1200.0, "force_gain_m_per_s2_per_n": 63.4}
    comb = material(texture={"kind": "grooves", "display": "vibration", **mode, **gains})
    clean = [
        grooves(comb, speed, force, Stylus(seed=k, rate_hz=5000.0))
        for k, (speed, force) in enumerate([(0.06, 0.6), (0.06, 2.0), (0.12, 0.6), (0.12, 2.0)])
    ]
    truth = fit_grooves(clean)
    found = fit_grooves([spoilt(clean[0], name, change), *clean[1:]])
    assert sum("0.14" in line for line in found.warnings) == 1
    for figure in ("velocity_gain_per_s", "force_gain_m_per_s2_per_n", "spacing_m"):
        one, other = getattr(found, figure), getattr(truth, figure)
        assert abs(one.value - other.value) < 0.5 * (other.high - other.low)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "change"), [("force_n", at(505831)), ("position_m", wrapped(-0.3)), ("position_m", at(1e6))]
)
def test_punctures_do_not_follow_a_wild_sample(name: str, change: Change) -> None:
    film = material(
        rupture={"depth_m": 0.002, "amplitude_m_per_s2": 38.0, "frequency_hz": 200.0, "decay_rate_per_s": 330.0}
    )
    clean = [puncture(film, 0.03 + 0.01 * k, Stylus(seed=k)) for k in range(4)]
    truth = fit_puncture(clean)
    found = fit_puncture([spoilt(clean[0], name, change), *clean[1:]])
    assert sum("0.028" in line for line in found.warnings) == 1
    for figure in ("stiffness_n_per_m", "depth_m"):
        one, other = getattr(found, figure), getattr(truth, figure)
        assert one.value == pytest.approx(other.value, rel=1e-3)


@pytest.mark.slow
def test_taps_do_not_follow_a_wild_sample() -> None:
    """One wild sample would hide all taps, whose peaks are less than a twentieth of it."""
    tap = shipped_materials()["wood"].tap
    clean, _ = taps(tap, np.linspace(0.1, 0.4, 6), Stylus(seed=1))
    truth = fit_tap([clean])
    found = fit_tap([spoilt(clean, "acceleration_m_per_s2", at(9e5))])
    assert any("the acceleration leaps to 900000 m/s^2 at 0.028 s and back" in line for line in found.warnings)
    assert found.slope_per_s.value == pytest.approx(truth.slope_per_s.value, rel=1e-3)
