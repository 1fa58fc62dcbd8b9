"""Refusals of `hapticd fit`: one line with the reason, no material, exit code 1."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np
import pytest

from hapticd.analysis.statistics import Floats
from hapticd.cli import main
from tests.support.cli import said
from tests.support.marks import rest_slow

Columns: TypeAlias = "dict[str, Floats]"
Damage: TypeAlias = "Callable[[Columns], Columns]"

RATE_HZ: Final = 10_000.0
TIME, SEEN, FORCE = "time_s", "acceleration_m_per_s2", "force_n"
NORMAL, ALONG, SPEED = "position_m", "tangential_position_m", "speed_m_per_s"


# ---- Recordings, made of sines and exponentials ----------------------------------------------------------------------


def ringing(time_s: Floats, onset_s: float, size: float, hz: float, decay_s: float) -> Floats:
    since = np.maximum(time_s - onset_s, 0.0)
    return np.asarray(size * np.exp(-since / decay_s) * np.sin(2 * np.pi * hz * since))


def taps(seed: int = 1) -> Columns:
    """Return six taps with a slope of 400 1/s, 300 Hz and a decay time of 10 ms."""
    random = np.random.default_rng(seed)
    time_s = np.arange(13_000) / RATE_HZ
    seen, place, force = np.full(len(time_s), 9.8), np.full(len(time_s), -0.01), np.zeros(len(time_s))
    for index, speed in enumerate((0.1, 0.2, 0.3, 0.15, 0.25, 0.12)):
        onset_s = 0.1 + 0.2 * index + 0.3e-4
        seen += ringing(time_s, onset_s, 400 * speed, 300, 0.01)
        near = np.abs(time_s - onset_s) < 0.1
        place[near] = np.maximum(speed * np.minimum(time_s[near] - onset_s, 0), -0.01)
        force += 2.0 * np.exp(-(((time_s - onset_s - 0.02) / 0.008) ** 2))
    seen += 0.3 * random.standard_normal(len(time_s))
    force += 0.003 * random.standard_normal(len(time_s))
    return {TIME: time_s, SEEN: seen, FORCE: force, NORMAL: place + 1e-6 * random.standard_normal(len(time_s))}


def stroke(speed: float, force_n: float, duration_s: float, random: np.random.Generator) -> Columns:
    time_s = np.arange(round(duration_s * RATE_HZ)) / RATE_HZ
    swing = 0.1 * np.sin(2 * np.pi * 1.3 * time_s + random.uniform(0, 6))
    press = force_n * (1 + 0.1 * np.sin(2 * np.pi * 0.9 * time_s + random.uniform(0, 6)))
    place = speed * (time_s + np.cumsum(swing) / RATE_HZ) + 1e-6 * random.standard_normal(len(time_s))
    return {
        TIME: time_s,
        FORCE: press + 0.004 * random.standard_normal(len(time_s)),
        ALONG: place,
        SPEED: speed * (1 + swing),
    }


def grooves(speed: float, force_n: float, seed: int) -> Columns:
    """Return a stroke with a ringing of 220 Hz and 4 ms every 2 mm."""
    random = np.random.default_rng(seed)
    found = stroke(speed, force_n, 0.8, random)
    seen = np.full(len(found[TIME]), 9.8)
    for number in range(1, int(found[ALONG][-1] / 2e-3) + 1):
        onset_s = float(np.interp(2e-3 * number, found[ALONG], found[TIME]))
        seen += ringing(found[TIME], onset_s, 300 * speed + 6 * force_n, 220, 0.004)
    return {**found, SEEN: seen + 0.3 * random.standard_normal(len(seen))}


def texture(speed: float, force_n: float, seed: int, hz: float = 250) -> Columns:
    """Return a stroke with noise filtered by one resonance."""
    random = np.random.default_rng(seed)
    found = stroke(speed, force_n, 3.0, random)
    count = len(found[TIME])
    at = np.fft.rfftfreq(count, 1 / RATE_HZ)
    shape = 1 / np.abs(1 - (at / hz) ** 2 + 0.7j * at / hz)
    coloured = np.fft.irfft(np.fft.rfft(random.standard_normal(count)) * shape, count)
    level = 10 * found[SPEED] + 1.5 * found[FORCE]
    return {**found, SEEN: 9.8 + coloured / coloured.std() * level + 0.01 * random.standard_normal(count)}


def puncture(speed: float, seed: int) -> Columns:
    """Return a puncture at a depth of 4 mm, with 400 N/m, and a ringing of 38 m/s^2 at 200 Hz."""
    random = np.random.default_rng(seed)
    ruptured_s = 0.006 / speed
    time_s = np.arange(round((ruptured_s + 0.15) * RATE_HZ)) / RATE_HZ
    place = speed * time_s - 0.002
    force = np.where(time_s < ruptured_s, 400 * np.maximum(place, 0), 0.0)
    seen = 9.8 + ringing(time_s, ruptured_s, 38, 200, 1 / 330)
    return {
        TIME: time_s,
        SEEN: seen + 0.3 * random.standard_normal(len(time_s)),
        FORCE: force + 0.003 * random.standard_normal(len(time_s)),
        NORMAL: 0.03 + place + 1e-6 * random.standard_normal(len(time_s)),
    }


CONDITIONS: Final = ((0.05, 0.5), (0.05, 1.5), (0.12, 0.5), (0.12, 1.5))
GOOD: Final[dict[str, list[Columns]]] = {
    "tap": [taps()],
    "grooves": [grooves(*each, seed) for seed, each in enumerate(CONDITIONS)],
    "texture": [texture(*each, seed) for seed, each in enumerate(CONDITIONS)],
    "puncture": [puncture(speed, seed) for seed, speed in enumerate((0.01, 0.02, 0.03))],
}


def written(folder: Path, recordings: list[Columns]) -> list[str]:
    names = []
    for index, columns in enumerate(recordings):
        names.append(str(folder / f"{index}.npz"))
        np.savez(names[-1], **columns)  # type: ignore[arg-type]
    return names


# ---- Damage --------------------------------------------------------------------------------------------------------


def times(name: str, factor: float) -> Damage:
    return lambda columns: {**columns, name: factor * columns[name]}


def swapped(one: str, other: str) -> Damage:
    return lambda columns: {**columns, one: columns[other], other: columns[one]}


def without(*names: str) -> Damage:
    return lambda columns: {name: values for name, values in columns.items() if name not in names}


def constant(name: str, value: float) -> Damage:
    return lambda columns: {**columns, name: np.full(len(columns[name]), value)}


def noise(columns: Columns) -> Columns:
    random = np.random.default_rng(5)
    return {**columns, SEEN: 9.8 + 0.05 * random.standard_normal(len(columns[TIME]))}


def clipped(columns: Columns) -> Columns:
    above = columns[SEEN] - 9.8
    most = 0.2 * float(np.abs(above).max())
    return {**columns, SEEN: 9.8 + np.clip(above, -most, most)}


def spoilt(columns: Columns) -> Columns:
    force = columns[FORCE].copy()
    force[len(force) // 2] = np.nan
    return {**columns, FORCE: force}


def every(step: int) -> Damage:
    return lambda columns: {name: values[::step] for name, values in columns.items()}


def released(columns: Columns) -> Columns:
    """Return a stylus that is withdrawn as slowly as it was pressed, without a rupture."""
    place = 0.03 + 0.003 * np.sin(np.linspace(0, np.pi, len(columns[TIME])))
    return {**columns, NORMAL: place, FORCE: 400 * (place - 0.03), SEEN: noise(columns)[SEEN]}


def softer(columns: Columns) -> Columns:
    """Change the texture in the middle of the stroke."""
    half = len(columns[TIME]) // 2
    other = texture(0.08, 1.0, 9, hz=700)
    return {**columns, SEEN: np.concatenate((columns[SEEN][:half], other[SEEN][half:]))}


DAMAGED: Final[list[tuple[str, str, Damage, str]]] = [
    ("tap", "no onset", noise, "no onset: the largest acceleration is"),
    ("tap", "one speed", lambda each: {**without(NORMAL)(each), SPEED: np.full(6, 0.2)}, "have about one speed"),
    ("tap", "clipped", clipped, "clipped"),
    ("tap", "rate too low", every(17), "must be at least 2.05 times that"),
    ("tap", "acceleration in mm/s^2", times(SEEN, 1e3), "off by a thousand"),
    ("tap", "acceleration in km/s^2", times(SEEN, 1e-3), "off by a thousand"),
    ("tap", "position in mm", times(NORMAL, 1e3), "must be between 0.001 and 10 m/s"),
    ("tap", "position in km", times(NORMAL, 1e-3), "must be between 0.001 and 10 m/s"),
    ("tap", "time in ms", times(TIME, 1e3), "are they in another unit?"),
    ("tap", "time and position", swapped(TIME, NORMAL), "is it the right column?"),
    ("tap", "time and acceleration", swapped(TIME, SEEN), "is it the right column?"),
    ("tap", "acceleration and position", swapped(SEEN, NORMAL), "is the position the right column?"),
    ("tap", "position and force", swapped(NORMAL, FORCE), "is the position the right column?"),
    ("tap", "force 0", constant(FORCE, 0), "the force is 0 throughout"),
    ("tap", "force in mN", times(FORCE, 1e4), "is impossible"),
    ("tap", "force in kN", times(FORCE, 1e-4), "too small to be felt: is it in kN?"),
    ("tap", "position at rest", constant(NORMAL, 0.01), "the position never moves"),
    ("tap", "NaN", spoilt, "force_n is NaN or infinite in 1 samples, first in sample 6501"),
    ("tap", "no acceleration", without(SEEN), "no acceleration"),
    ("tap", "no speed", without(NORMAL), "neither speed nor position"),
    ("grooves", "clipped", clipped, "clipped"),
    ("grooves", "rate too low", every(25), "too low"),
    ("grooves", "no force", without(FORCE), "no force"),
    ("grooves", "no way", without(ALONG, SPEED), "a stroke needs one of them"),
    ("grooves", "force 0", constant(FORCE, 0), "the force is 0 throughout"),
    ("grooves", "force in mN", times(FORCE, 1e3), "is impossible"),
    ("grooves", "force in kN", times(FORCE, 1e-3), "too small to be felt: is it in kN?"),
    ("grooves", "force with the other sign", times(FORCE, -1), "pressing must be positive"),
    ("grooves", "position in mm", times(ALONG, 1e3), "is it in mm?"),
    ("grooves", "position in km", times(ALONG, 1e-3), "m/s is too low"),
    ("grooves", "speed in mm/s", times(SPEED, 1e3), "is it in mm/s?"),
    ("grooves", "speed in km/s", times(SPEED, 1e-3), "one of them has the wrong unit or column"),
    ("grooves", "speed and force", swapped(SPEED, FORCE), "one of them has the wrong unit or column"),
    ("grooves", "time and position", swapped(TIME, ALONG), "is it the right column?"),
    ("grooves", "position and acceleration", swapped(ALONG, SEEN), "is it in mm?"),
    ("grooves", "noise", noise, "no grooves here"),
    ("grooves", "acceleration in mm/s^2", times(SEEN, 1e3), "must be between 0.1 and 5000 m/s^2"),
    ("grooves", "acceleration in km/s^2", times(SEEN, 1e-3), "must be between 0.1 and 5000 m/s^2"),
    ("grooves", "force and acceleration", swapped(FORCE, SEEN), "no grooves here"),
    ("grooves", "NaN", spoilt, "force_n is NaN or infinite"),
    ("texture", "clipped", clipped, "clipped"),
    ("texture", "no acceleration", without(SEEN), "no acceleration"),
    ("texture", "force 0", constant(FORCE, 0), "the force is 0 throughout"),
    ("texture", "force in mN", times(FORCE, 1e3), "is impossible"),
    ("texture", "force in kN", times(FORCE, 1e-3), "too small to be felt: is it in kN?"),
    ("texture", "position in mm", times(ALONG, 1e3), "is it in mm?"),
    ("texture", "position in km", times(ALONG, 1e-3), "m/s is too low"),
    ("texture", "speed in mm/s", times(SPEED, 1e3), "is it in mm/s?"),
    ("texture", "two textures", softer, "two textures"),
    ("texture", "noise", noise, "or it is the sensor's noise alone"),
    ("texture", "rate too low", every(20), "the spectrum does not end below half the rate"),
    ("texture", "acceleration in mm/s^2", times(SEEN, 1e3), "must be between 0.03 and 300 m/s^2"),
    ("texture", "acceleration in km/s^2", times(SEEN, 1e-3), "must be between 0.03 and 300 m/s^2"),
    ("texture", "force and acceleration", swapped(FORCE, SEEN), "or it is the sensor's noise alone"),
    ("texture", "NaN", spoilt, "force_n is NaN or infinite"),
    ("puncture", "no puncture", released, "no puncture here"),
    ("puncture", "clipped", clipped, "clipped"),
    ("puncture", "rate too low", every(23), "too low"),
    ("puncture", "force 0", constant(FORCE, 0), "the force is 0 throughout"),
    ("puncture", "force in mN", times(FORCE, 1e3), "is impossible"),
    ("puncture", "force in kN", times(FORCE, 1e-3), "off by a thousand"),
    ("puncture", "position in mm", times(NORMAL, 1e3), "is it in mm?"),
    ("puncture", "position in km", times(NORMAL, 1e-3), "off by a thousand"),
    ("puncture", "position with the other sign", times(NORMAL, -1), "must rise as the stylus presses in"),
    ("puncture", "force and acceleration", swapped(FORCE, SEEN), "columns swapped"),
    ("puncture", "force and position", swapped(FORCE, NORMAL), "the position must span at most"),
    ("puncture", "position at rest", constant(NORMAL, 0.01), "the position never moves"),
    ("puncture", "acceleration in mm/s^2", times(SEEN, 1e3), "must be between 0.1 and 3000 m/s^2"),
    ("puncture", "acceleration in km/s^2", times(SEEN, 1e-3), "must be between 0.1 and 3000 m/s^2"),
    (
        "puncture",
        "taps on a wall",
        lambda each: taps(len(each[TIME])),
        "no puncture here|does not follow the position",
    ),
    ("puncture", "NaN", spoilt, "force_n is NaN or infinite"),
]


@pytest.mark.parametrize("kind", ["tap", "puncture", *rest_slow(["grooves", "texture"], fast=0)])
def test_recordings_without_damage_are_fitted(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """If this failed, a refusal below could have another reason."""
    assert main(["fit", kind, *written(tmp_path, GOOD[kind]), "-o", str(tmp_path / "found.yaml")]) == 0
    assert (tmp_path / "found.yaml").read_text().startswith("materials:")
    capsys.readouterr()


LONG: Final = {("grooves", "acceleration in mm/s^2"), ("grooves", "acceleration in km/s^2")}
"""Refusals after a complete fit, which takes a second; the other kinds of fit test the same."""


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "damage", "message"),
    [
        pytest.param(
            kind, damage, message, id=f"{kind}: {what}", marks=[pytest.mark.slow] if (kind, what) in LONG else []
        )
        for kind, what, damage, message in DAMAGED
    ],
)
def test_refusals(kind: str, damage: Damage, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = written(tmp_path, [damage(columns) for columns in GOOD[kind]])
    line = said(capsys, 1, "fit", kind, *files, "-o", str(tmp_path / "found.yaml"))
    assert any(words in line for words in message.split("|")), line
    assert not (tmp_path / "found.yaml").exists()


@pytest.mark.parametrize(
    ("given", "asked", "message"),
    [
        ("taps", "texture", "no force"),
        ("grooves", "puncture", "no position along the normal"),
        ("texture", "puncture", "no position along the normal"),
        ("puncture", "grooves", "a stroke needs one of them"),
    ],
)
def test_recordings_of_another_kind(
    given: str, asked: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    columns = {"taps": [without(FORCE)(taps())], **GOOD}[given]
    assert message in said(capsys, 1, "fit", asked, *written(tmp_path, columns))
