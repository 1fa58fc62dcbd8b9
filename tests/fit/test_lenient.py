"""Fits of sets with a bad file or event, which is left out and reported; --strict refuses the set."""

from __future__ import annotations

import contextlib
import dataclasses
import json
from pathlib import Path
from typing import Final

import numpy as np
import pytest

from hapticd.analysis.recordings.clipping import clipped
from hapticd.analysis.statistics import FitError, Floats
from hapticd.cli import main
from hapticd.config.configuration import load_config
from hapticd.fit.grooves import fit_grooves
from hapticd.fit.preparation import complete_sections
from hapticd.fit.puncture import fit_puncture
from hapticd.fit.recording import Recording, Source
from hapticd.fit.tap import fit_tap
from hapticd.fit.texture import fit_texture
from hapticd.fit.verdict import ONE_PART, Exclusions, Warnings
from tests.fit.test_refusals import GOOD, RATE_HZ, SEEN, TIME, Columns, puncture, ringing, written
from tests.support.cli import said
from tests.support.marks import rest_slow

KINDS: Final = ("tap", "grooves", "texture", "puncture")


def one_tap(speed: float, seed: int, hz: float = 300.0, rest: int = 2000, rate_hz: float = RATE_HZ) -> Columns:
    """Return a tap with a slope of 400 1/s and a decay time of 10 ms."""
    time_s = np.arange(rest + round(0.2 * rate_hz)) / rate_hz
    seen = 9.8 + ringing(time_s, (rest - 0.7) / rate_hz, 400 * speed, hz, 0.01)
    noise = np.random.default_rng(seed).standard_normal(len(time_s))
    return {TIME: time_s, SEEN: seen + 0.3 * noise, "speed_m_per_s": np.full(len(time_s), speed)}


def clip(columns: Columns) -> Columns:
    middle, reach = np.median(columns[SEEN]), np.ptp(columns[SEEN]) / 8
    return {**columns, SEEN: np.clip(columns[SEEN], middle - reach, middle + reach)}


def silent(columns: Columns) -> Columns:
    noise = np.random.default_rng(9).standard_normal(len(columns[TIME]))
    return {**columns, SEEN: 9.8 + 1e-3 * noise}


def too_fast(columns: Columns) -> Columns:
    """Replace the acceleration by a ringing of 4950 Hz, too fast for the sampling rate."""
    return {**columns, SEEN: 9.8 + ringing(columns[TIME], 0.2, 100, 4950, 0.01)}


def lost(columns: Columns) -> Columns:
    """Remove 20 samples, ten before the end."""
    kept = np.delete(np.arange(len(columns[TIME])), np.arange(-30, -10))
    return {name: values[kept] for name, values in columns.items()}


SETS: Final[dict[str, list[Columns]]] = {
    **GOOD,
    "tap": [one_tap(speed, seed) for seed, speed in enumerate((0.1, 0.15, 0.2, 0.3))],
}
MORE: Final[dict[str, Columns]] = {
    "tap": one_tap(0.25, 7),
    "puncture": puncture(0.02, 7),
    "grooves": {**GOOD["grooves"][0], SEEN: GOOD["grooves"][0][SEEN] + 0.01},
    "texture": {**GOOD["texture"][0], SEEN: GOOD["texture"][0][SEEN] + 0.01},
}
"""One more recording of each kind, to be damaged."""


def fitted(folder: Path, capsys: pytest.CaptureFixture[str], kind: str, files: list[str]) -> tuple[str, list[str]]:
    """Return the material without its provenance, as JSON with the number of files, and the lines on stderr."""
    assert main(["fit", kind, *files, "-o", str(folder / "found.yaml"), "--overwrite"]) == 0
    material = load_config(str(folder / "found.yaml")).materials["found"].to_dict()
    origin = material.pop("provenance")
    assert isinstance(origin, dict) and all(file["path"] in files for file in origin["files"])
    lines = capsys.readouterr().err.splitlines()
    return json.dumps([material, len(origin["files"])]), lines


BAD: Final = (
    ("tap", clip, ": clipped at"),
    ("tap", silent, "no onset: the largest acceleration is"),
    ("tap", too_fast, "sampling rate of 10000 Hz is too low"),
    ("puncture", clip, "the ringing of the rupture is clipped at"),
    ("puncture", silent, "the acceleration changes by"),
    ("puncture", too_fast, "Hz, and its sampling rate of 10000 Hz is too low"),
    ("grooves", clip, "clipped at"),
    ("grooves", silent, "the acceleration changes by"),
    ("grooves", too_fast, "Hz, and its sampling rate of 10000 Hz is too low"),
    ("texture", clip, "clipped at"),
    ("texture", silent, "the acceleration changes by"),
    ("texture", too_fast, "left out: "),
)


@pytest.mark.long
@pytest.mark.parametrize(("kind", "damage", "message"), rest_slow(BAD, fast=3))
def test_a_bad_file_is_left_out_and_the_rest_fitted_as_without_it(
    kind: str, damage: object, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert callable(damage)
    *good, bad = written(tmp_path, [*SETS[kind], damage(MORE[kind])])
    alone, _ = fitted(tmp_path, capsys, kind, good)
    beside, lines = fitted(tmp_path, capsys, kind, [bad, *good])
    (line,) = (line for line in lines if "left out" in line)
    assert line.startswith(f"hapticd: {bad}: ") and message in line
    assert beside == alone
    assert "--strict forbids exclusions" in said(capsys, 1, "fit", kind, bad, *good, "--strict")


@pytest.mark.parametrize("kind", [*KINDS[:1], *rest_slow(KINDS[1:], fast=0)])
def test_a_gap_far_from_what_is_fitted_costs_nothing_else(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """20 samples near the end are lost: fits of taps and punctures ignore this, and strokes leave out a part."""
    files = written(tmp_path, [*SETS[kind][1:], lost(SETS[kind][0])])
    assert main(["fit", kind, *files, "-o", str(tmp_path / "found.yaml")]) == 0
    lines = capsys.readouterr().err
    assert ("left out" in lines) == (kind in ("grooves", "texture"))
    if kind in ("grooves", "texture"):
        assert f"{files[-1]}: a part is left out" in lines and "20 samples are missing at" in lines
        assert "--strict forbids exclusions" in said(capsys, 1, "fit", kind, *files, "--strict")


def test_a_gap_in_a_tap_leaves_that_tap_out() -> None:
    recording = taps_of([0.1, 0.2, 0.3, 0.15, 0.25])
    assert recording.acceleration_m_per_s2 is not None
    spoilt = np.array(recording.acceleration_m_per_s2)
    spoilt[8220:8260] = np.linspace(spoilt[8219], spoilt[8260], 40)
    excluded = Exclusions()
    fit = fit_tap(
        [dataclasses.replace(recording, acceleration_m_per_s2=spoilt, gaps=((8220, 8260),))], excluded=excluded
    )
    assert [tap.speed_m_per_s for tap in fit.taps] == [0.1, 0.2, 0.15, 0.25] or len(fit.taps) == 5
    whole = fit_tap([recording])
    assert fit.slope_per_s.value == pytest.approx(whole.slope_per_s.value, rel=0.01)


# ---- Taps -----------------------------------------------------------------------------------------------------------


def taps_of(speeds: list[float], noise: float = 0.3) -> Recording:
    """Return taps of 400 1/s, 300 Hz and 10 ms, one every 0.3 s from 0.2 s on."""
    time_s = np.arange(round((0.2 + 0.3 * len(speeds)) * RATE_HZ)) / RATE_HZ
    seen = np.full(len(time_s), 9.8) + noise * np.random.default_rng(2).standard_normal(len(time_s))
    for index, speed in enumerate(speeds):
        seen += ringing(time_s, 0.2 + 0.3 * index, 400 * speed, 300, 0.01)
    return Recording("taps", RATE_HZ, seen, None, None, None, np.array(speeds), Source("taps", ""))


def of(columns: Columns, name: str = "one", rate_hz: float = RATE_HZ) -> Recording:
    return Recording(
        name, rate_hz, columns[SEEN], None, None, None, float(columns["speed_m_per_s"][0]), Source(name, "")
    )


def refusals(recordings: list[Recording]) -> list[str]:
    excluded = Exclusions()
    with contextlib.suppress(FitError):
        fit_tap(recordings, excluded=excluded)
    return [each.reason for each in excluded.items]


def test_a_strong_tap_that_is_no_ringing_is_not_called_weak() -> None:
    """One sample at 124 times the noise has another shape; a weak sample is no event at all."""
    good = taps_of([0.1, 0.2, 0.3, 0.15, 0.25], noise=0.1)
    assert good.acceleration_m_per_s2 is not None
    for height, message in ((12.4, "the peak is 12"), (0.9, "")):
        spoilt = np.array(good.acceleration_m_per_s2)
        spoilt[8000:8400] = 9.8 + 0.1 * np.random.default_rng(3).standard_normal(400)
        spoilt[8200] += height
        reasons = refusals([dataclasses.replace(good, acceleration_m_per_s2=spoilt)])
        assert not any("too weak" in reason for reason in reasons)
        assert message == "" or any(message in reason and "the shape is not a ringing" in reason for reason in reasons)


@pytest.mark.parametrize("rest", [2, 3, 5, 7])
def test_a_short_rest_does_where_the_onset_is_clear(rest: int) -> None:
    recordings = [
        of(one_tap(speed, seed, rest=rest + 1), f"t{seed}") for seed, speed in enumerate((0.1, 0.15, 0.2, 0.3, 0.25))
    ]
    fit = fit_tap(recordings)
    assert len(fit.taps) == 5
    assert fit.slope_per_s.value == pytest.approx(400, rel=0.03)
    assert fit.frequency_hz.value == pytest.approx(300, rel=0.01)


def test_few_samples_in_a_cycle_are_enough_where_the_onset_is_known() -> None:
    """300 Hz at 660 Hz: 2.2 samples in a cycle."""
    speeds = (0.1, 0.15, 0.2, 0.3, 0.25, 0.12, 0.18, 0.35)
    taps = [one_tap(speed, seed, rest=20, rate_hz=660.0) for seed, speed in enumerate(speeds)]
    fit = fit_tap([of(each, str(place), 660.0) for place, each in enumerate(taps)])
    assert fit.slope_per_s.value == pytest.approx(400, rel=0.03)
    assert fit.frequency_hz.value == pytest.approx(300, rel=0.003)
    assert fit.decay_time_s.value == pytest.approx(0.01, rel=0.03)
    assert any("2.2 samples in a cycle" in warning for warning in fit.warnings) and fit.judged.quality != "good"


def test_too_little_rest_is_reported_with_the_required_rest() -> None:
    late = one_tap(0.2, 3, rest=30)
    cut = {name: values[30:] for name, values in late.items()}
    good = [of(one_tap(speed, seed), f"t{seed}") for seed, speed in enumerate((0.1, 0.15, 0.2, 0.3))]
    (reason,) = refusals([*good, of(cut, "cut")])
    assert reason in {f"{count} samples of rest before the tap, 2 are needed" for count in (0, 1)}


def test_taps_that_are_left_out_weigh_on_the_verdict() -> None:
    speeds = [0.1, 0.2, 0.3, 0.15, 0.25, 0.12, 0.22, 0.32]
    recording = taps_of(speeds)
    assert recording.acceleration_m_per_s2 is not None
    low = dataclasses.replace(
        recording, acceleration_m_per_s2=np.minimum(recording.acceleration_m_per_s2, 9.8 + 400 * 0.145)
    )
    fit = fit_tap([low])
    assert len(fit.left_out) > len(fit.taps) >= 3
    assert fit.judged.quality == "poor" and f"{len(fit.left_out)} of 8 taps are left out" in fit.judged.reasons
    with pytest.raises(FitError, match="--strict forbids exclusions"):
        fit_tap([low], excluded=Exclusions(strict=True))


@pytest.mark.long
def test_five_of_twelve_taps_that_are_left_out_make_a_fit_of_the_others_poor() -> None:
    """The others begin downwards, and their sign is reversed; the five are clipped, or whole files are silent."""
    low, high = (0.1, 0.11, 0.12, 0.13, 0.14, 0.15, 0.16), (0.25, 0.3, 0.35, 0.4, 0.28)
    one = taps_of([*low, *high])
    assert one.acceleration_m_per_s2 is not None
    turned = np.maximum(19.6 - one.acceleration_m_per_s2, 9.8 - 400 * 0.17)
    files = [of(one_tap(speed, seed), f"t{seed}") for seed, speed in enumerate(low)]
    files = [dataclasses.replace(each, acceleration_m_per_s2=-samples_of(each)) for each in files]
    files += [of(silent(one_tap(speed, seed)), f"s{seed}") for seed, speed in enumerate(high)]
    for recordings in ([dataclasses.replace(one, acceleration_m_per_s2=turned)], files):
        fit = fit_tap(recordings)
        assert len(fit.taps) == 7 and fit.slope_per_s.value == pytest.approx(400, rel=0.05)
        assert fit.judged.quality == "poor" and "5 of 12 taps are left out" in fit.judged.reasons
        assert any("the sign of the acceleration is reversed" in warning for warning in fit.warnings)


def samples_of(recording: Recording) -> Floats:
    assert recording.acceleration_m_per_s2 is not None
    return recording.acceleration_m_per_s2


@pytest.mark.long
def test_a_refusal_names_what_was_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two of six files are silent; the other taps have one speed."""
    columns = [one_tap(0.2, seed) for seed in range(4)] + [silent(one_tap(0.2, 4, rest=rest)) for rest in (100, 200)]
    line = said(capsys, 1, "fit", "tap", *written(tmp_path, columns), "-o", str(tmp_path / "found.yaml"))
    assert "speed" in line
    assert "2 of 6 taps are left out: " in line and line.count("no onset") == 2


@pytest.mark.parametrize(
    ("left_out", "parts", "quality", "reason"),
    [
        (1, [], "good", None),
        (2, [], "fair", "2 of 12 recordings are left out"),
        (5, [], "poor", "5 of 12 recordings are left out"),
        (0, [0.4, 0.4], "good", None),
        (0, [0.4, 0.4, 0.5], "fair", "0 of 12 recordings are left out, and parts as long as 1.3 of the others"),
        (3, [0.4, 0.4], "poor", "3 of 12 recordings are left out, and parts as long as 0.8 of the others"),
    ],
)
def test_recordings_and_parts_that_are_left_out_weigh_alike(
    left_out: int, parts: list[float], quality: str, reason: str | None
) -> None:
    recordings = [of(one_tap(0.2, seed), f"t{seed}") for seed in range(12)]
    excluded, warnings = Exclusions(), Warnings()
    for place in range(left_out):
        excluded.add(f"t{place}", "clipped")
    for place, fraction in enumerate(parts):
        excluded.add(f"t{6 + place}", "clipped", ONE_PART, fraction=fraction)
    excluded.report_recordings(recordings, warnings)
    judged = warnings.verdict("so much")
    assert judged.quality == quality and judged.reasons == (() if reason is None else (reason,))
    assert len(warnings.lines) == left_out + len(parts)


# ---- Parts ----------------------------------------------------------------------------------------------------------


def test_clipped_samples_are_those_that_stand_at_an_end_after_a_leap() -> None:
    wave = np.round(100 * np.sin(np.linspace(0, 40, 4000))) / 10
    assert not clipped(wave).any()
    cut = np.clip(100 * np.sin(np.linspace(0, 40, 400)), -1000, 70)
    assert np.array_equal(clipped(cut), cut == 70)
    assert not clipped(np.zeros(20)).any()


def test_noise_on_the_peak_of_a_pulse_in_coarse_numbers_is_not_clipping() -> None:
    pulse = np.concatenate((np.zeros(60), 240.0 * np.sin(np.linspace(0, np.pi, 50)), np.zeros(60)))
    pulse[80:90] = [231.0, 234.0, 232.0, 236.0, 240.0, 240.0, 240.0, 236.0, 237.0, 234.0]
    assert not clipped(0.25 * np.round(pulse), 0.25).any()
    # Neither a longer run nor a run after a leap is due to chance.
    pulse[83] = pulse[87] = 240.0
    assert np.count_nonzero(clipped(0.25 * np.round(pulse), 0.25)) == 5
    sharp = np.concatenate((np.zeros(20), [1.0, 100.0, 240.0, 240.0, 240.0, 80.0], np.zeros(20)))
    assert np.count_nonzero(clipped(0.25 * sharp, 0.25)) == 3


def test_complete_sections_are_between_gaps_and_clipped_samples() -> None:
    seen = np.random.default_rng(1).standard_normal(10_000)
    seen[3000:3004] = 9.0
    recording = Recording(
        "one", 1e3, seen, np.arange(10_000.0), None, None, 0.1, Source("", ""), gaps=((6000, 6010), (9800, 9900))
    )
    excluded = Exclusions()
    parts = complete_sections(recording, 0.5, excluded)
    assert [part.name for part in parts] == ["one from 0 s", "one from 3.004 s", "one from 6.01 s"]
    lengths = [len(part.force_n) for part in parts if part.force_n is not None]
    assert lengths == [3000, 2996, 3790]
    assert parts[1].force_n is not None and parts[1].force_n[0] == 3004.0
    (exclusion,) = excluded.items
    assert exclusion.fraction == pytest.approx(0.0214)
    assert "clipped at 9 m/s^2 in 1 place, 10 samples are missing at 6 s, and in 1 more place" in exclusion.reason
    assert "0.214 of 10 s" in exclusion.reason
    with pytest.raises(FitError, match=r"0 % of the samples are in complete sections of 5 s, 50 % are needed"):
        complete_sections(recording, 5.0, Exclusions())


@pytest.mark.parametrize("fit", [fit_tap, fit_grooves, fit_texture, fit_puncture])
def test_the_same_file_twice_is_refused_by_every_fit(fit: object) -> None:
    one = dataclasses.replace(taps_of([0.1, 0.2]), source=Source("a", "ab"), name="a")
    assert callable(fit)
    with pytest.raises(FitError, match="b: duplicate of a, which would count twice; leave out one"):
        fit([one, dataclasses.replace(one, name="b")])
