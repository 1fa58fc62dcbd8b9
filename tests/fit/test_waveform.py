"""Taps that are pulses: the fitted waveform compared with the recorded curve, and the choice of a waveform."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

import hapticd
from hapticd.analysis.statistics import FitError
from hapticd.cli import main
from hapticd.config.materials import shipped_materials, validate_materials
from hapticd.fit.from_files import fit_taps
from hapticd.fit.recording import Recording, Source, save
from hapticd.fit.synthesize import Stylus, taps
from hapticd.fit.tap import TapFit
from hapticd.fit.verdict import Exclusions
from hapticd.fit.waveform import Equations, FittedPulse, Pulse, WaveformFit
from tests.support.marks import rest_slow

Floats = npt.NDArray[np.float64]
GAP_S = 0.2
PEAK_PER_S = 150.0
SPEEDS = np.array([0.05, 0.31, 0.12, 0.44, 0.2, 0.08, 0.5, 0.26, 0.36, 0.16, 0.4, 0.1])


def push(x: Floats) -> Floats:
    """Return a pulse of one sign, over x from 0 to 1, with a peak of 1."""
    return np.asarray(np.where((x > 0) & (x < 1), np.sin(np.pi * np.clip(x, 0, 1)) ** 1.5, 0.0))


def thud(x: Floats) -> Floats:
    """Return a pulse with a steep rise, a slow fall, and a pull after that."""
    rise = np.sin(np.pi / 2 * np.clip(4 * x, 0, 1)) ** 2
    fall = np.cos(np.pi / 2 * np.clip((x - 0.25) / 0.75, 0, 1)) ** 2
    pull = np.sin(np.pi * np.clip((x - 1) / 0.6, 0, 1)) ** 2
    return np.asarray(rise * fall - 0.2 * pull)


def recorded(
    shape: Callable[[Floats], Floats] = push,
    width_s: float = 0.01,
    rate_hz: float = 1000.0,
    noise: float = 0.1,
    power: float = 1.0,
    speeds: Floats = SPEEDS,
    seed: int = 1,
) -> tuple[Recording, Floats]:
    """Return pulses with peaks of PEAK_PER_S times the speed, one every GAP_S, not at samples, and their onsets."""
    random = np.random.default_rng(seed)
    time_s = np.arange(round(rate_hz * GAP_S * len(speeds))) / rate_hz
    onsets_s = GAP_S * np.arange(len(speeds)) + 0.06 + random.uniform(0, 1, len(speeds)) / rate_hz
    samples = 9.8 + noise * random.standard_normal(len(time_s))
    for speed, onset_s in zip(speeds, onsets_s, strict=True):
        samples += PEAK_PER_S * 0.3 * (speed / 0.3) ** power * shape((time_s - onset_s) / width_s)
    return Recording("pulses", rate_hz, samples, None, None, None, speeds, Source("pulses", "")), onsets_s


def waveform_of(*recordings: Recording, kind: str = "waveform") -> WaveformFit:
    found = fit_taps(recordings, kind)  # type: ignore[arg-type]
    assert isinstance(found, WaveformFit)
    return found


def explained(found: WaveformFit, shape: Callable[[Floats], Floats], width_s: float) -> float:
    """Return the fraction of the true curve's variance that the fitted curve explains at the best onset."""
    fine = np.linspace(-0.5 * width_s, 2.5 * width_s, 3001)
    truth = shape(fine / width_s)
    left = [np.sum((truth - found.curve.at(fine + s)) ** 2) for s in np.linspace(-0.4 * width_s, 0.4 * width_s, 161)]
    return 1 - float(min(left)) / float(np.sum(truth**2))


# ---- What is found ---------------------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize(
    ("shape", "rate_hz", "width_s"),
    rest_slow([(push, 1000.0, 0.01), (thud, 1000.0, 0.01), (push, 5000.0, 0.006), (thud, 5000.0, 0.006)]),
)
def test_the_waveform_is_the_curve_that_was_recorded(
    shape: Callable[[Floats], Floats], rate_hz: float, width_s: float
) -> None:
    recording, onsets_s = recorded(shape, width_s, rate_hz)
    found = waveform_of(recording)
    assert explained(found, shape, width_s) > 0.99
    slope = found.first_peak_slope_per_s
    assert slope.value == pytest.approx(PEAK_PER_S, rel=0.02)
    assert found.variance_accounted_for > 0.98
    assert len(found.taps) == len(SPEEDS)
    assert found.samples[0] == found.samples[-1] == 0
    assert found.length_s < 2.2 * width_s
    # All onsets have the same error: the curve begins slightly before or after the pulse.
    off_s = np.array([tap.onset_s for tap in found.taps]) - onsets_s
    assert np.ptp(off_s) < 0.3 / rate_hz
    assert found.verdict.startswith("good: a waveform explains ")


@pytest.mark.long
def test_the_waveform_begins_at_the_contact() -> None:
    """Hum is added to the seven samples of rest, and to the samples after the pulse."""
    width_s, random = 0.0045, np.random.default_rng(4)
    time_s = np.arange(160) / 1000
    recordings, onsets_s = [], []
    for index, speed in enumerate(SPEEDS):
        onset_s = 0.006 + random.uniform(0, 0.001)
        hum = 1.5 * np.sin(2 * np.pi * 200 * (time_s - onset_s) + random.uniform(-1, 1))
        samples = 9.8 + PEAK_PER_S * speed * push((time_s - onset_s) / width_s) + hum
        samples += 0.5 * random.standard_normal(160)
        name = f"tap {index}"
        recordings.append(Recording(name, 1000.0, samples, None, None, None, float(speed), Source(name, "")))
        onsets_s.append(onset_s)
    found = waveform_of(*recordings)
    true_s = {recording.name: onset_s for recording, onset_s in zip(recordings, onsets_s, strict=True)}
    off_s = [tap.onset_s - true_s[tap.recording] for tap in found.taps]
    assert abs(float(np.median(off_s))) < 0.001
    assert found.length_s < 3 * width_s
    assert explained(found, push, width_s) > 0.98


@pytest.mark.long
def test_a_waveform_that_is_not_over_begins_at_the_contact() -> None:
    """A pulse that is longer than a waveform does not show the level at rest."""
    random = np.random.default_rng(8)
    time_s = np.arange(160) / 1000
    recordings, off_s = [], []
    for index, speed in enumerate(SPEEDS):
        onset_s = 0.006 + random.uniform(0, 0.001)
        since_s = np.maximum(time_s - onset_s, 0.0)
        samples = 9.8 + PEAK_PER_S * speed * np.exp(-9 * since_s) * np.sin(2 * np.pi * 29 * since_s)
        samples += 0.1 * random.standard_normal(160)
        name = f"tap {index}"
        recordings.append(Recording(name, 1000.0, samples, None, None, None, float(speed), Source(name, "")))
        off_s.append(onset_s)
    found = waveform_of(*recordings)
    for tap in found.taps:
        assert abs(tap.onset_s - off_s[int(tap.recording.split()[1])]) < 0.001


def held(found: WaveformFit, shape: Callable[[Floats], Floats], width_s: float) -> float:
    """Return the fraction of samples whose intervals contain the true curve, aligned with the fitted curve."""
    fine, at = np.arange(-0.01, found.length_s + 0.01, 1e-4), np.arange(len(found.samples)) / found.rate_hz
    shifts = np.linspace(-0.4 * width_s, 0.4 * width_s, 401)
    left = [np.sum((shape((fine + s) / width_s) - found.curve.at(fine)) ** 2) for s in shifts]
    off = np.array(found.samples) - shape((at + shifts[int(np.argmin(left))]) / width_s)
    return float(np.mean(np.abs(off)[1:-1] <= np.array(found.deviations)[1:-1]))


@pytest.mark.long
def test_intervals_hold_what_lies_between_the_samples() -> None:
    """A steep rise, in 2.5 samples, with very little noise."""
    found = waveform_of(recorded(thud, noise=0.01)[0])
    assert held(found, thud, 0.01) >= 0.8
    assert found.first_peak_slope_per_s.low < PEAK_PER_S < found.first_peak_slope_per_s.high


@pytest.mark.slow
@pytest.mark.parametrize("shape", [push, thud])
def test_intervals_hold_the_truth_as_often_as_they_say(shape: Callable[[Floats], Floats]) -> None:
    """In 100 sets, less the scatter of 100 sets."""
    slopes, curves = [], []
    for seed in range(100):
        width_s = 0.01 + 0.00002 * seed
        found = waveform_of(recorded(shape, width_s, noise=0.5, seed=seed)[0])
        slope = found.first_peak_slope_per_s
        slopes.append(slope.low <= PEAK_PER_S <= slope.high)
        curves.append(held(found, shape, width_s))
    assert np.mean(slopes) >= 0.91
    assert np.mean(curves) >= 0.95 - 2 * float(np.std(curves)) / 10


@pytest.mark.long
def test_the_rendered_tap_is_the_recorded_one() -> None:
    recording, _ = recorded(thud, 0.008)
    found = waveform_of(recording)
    material = {"stiffness_n_per_m": 0.0, **found.material()}
    rate_hz, speed, height_m = 10_000, 0.3, 0.00123
    time_s = np.arange(400) / rate_hz
    path = np.stack((np.zeros(400), height_m - speed * time_s), axis=1)
    wall = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "felt"}
    config = {
        "device": {"effective_mass_kg": 1.0, "max_force_n": 100.0},
        "materials": {"felt": material},
        "scene": {"objects": {"wall": wall}},
    }
    force = hapticd.render(config, path, rate_hz, velocity_m_per_s=np.tile((0.0, -speed), (400, 1)))
    felt = force["vibration_force_n"][:, 1]
    left = [
        np.sum((felt - PEAK_PER_S * speed * thud((time_s - height_m / speed - s) / 0.008)) ** 2)
        for s in np.linspace(-0.003, 0.003, 121)
    ]
    assert 1 - min(left) / np.sum(felt**2) > 0.99


def test_the_equations_are_those_of_the_curve() -> None:
    """Compared with a dense least-squares fit of the kernel's sums."""
    random = np.random.default_rng(3)
    pulses, placed, rows, sides = [], [], [], []
    for _ in range(5):
        onset_s, amplitude = float(random.uniform(0.001, 0.01)), float(random.uniform(1, 5))
        measured = random.standard_normal(60)
        pulses.append(Pulse("r", 0.0, onset_s, 1.0, 1000.0, measured, 0.02))
        placed.append(FittedPulse(amplitude, 0.25, onset_s, 0.0))
        at = (np.arange(60) / 1000.0 - onset_s) * 700.0
        inside = (at >= 0) & (at <= 14)
        x = np.abs(at[inside, None] - np.arange(15))
        near, far = 1.5 * x**3 - 2.5 * x**2 + 1, -0.5 * x**3 + 2.5 * x**2 - 4 * x + 2
        rows.append(amplitude * np.where(x <= 1, near, np.where(x <= 2, far, 0.0))[:, 1:-1])
        sides.append(measured[inside] - 0.25)
    matrix, side = np.concatenate(rows), np.concatenate(sides)
    bends = np.zeros((13, 15))
    for i in range(13):
        bends[i, i : i + 3] = [1, -2, 1]
    bends = bends[:, 1:-1]
    gram = matrix.T @ matrix
    smooth = 1e-4 * float(np.mean(np.diag(gram))) * bends.T @ bends
    wanted = np.linalg.solve(gram + smooth, matrix.T @ side)
    equations = Equations(pulses, placed, 700.0, 15)
    assert equations.solved() == pytest.approx(np.concatenate(([0.0], wanted, [0.0])), abs=1e-9)
    without = np.concatenate(rows[1:])
    left = np.linalg.solve(without.T @ without + smooth, without.T @ np.concatenate(sides[1:]))
    assert equations.solved(without=0)[1:-1] == pytest.approx(left, abs=1e-9)


@pytest.mark.long
def test_taps_that_saturate_get_a_table() -> None:
    recording, _ = recorded(power=0.5)
    found = waveform_of(recording)
    assert found.amplitudes
    tap = validate_materials({"m": {"stiffness_n_per_m": 1.0, **found.material()}})["m"].tap
    assert tap is not None
    for speed in (0.1, 0.2, 0.3, 0.45):
        assert tap.amplitude_m_per_s2(speed) == pytest.approx(45.0 * (speed / 0.3) ** 0.5, rel=0.04)
    assert any(line.startswith("A(v) is a power law of exponent 0.5") for line in found.warnings)
    assert found.law.kind == "power"
    assert found.verdict.startswith("good: ")


@pytest.mark.long
def test_a_tap_that_is_another_is_left_out_and_reported() -> None:
    recording, _ = recorded()
    samples = recording.acceleration_m_per_s2
    assert samples is not None
    samples[1040:1120] = 9.8 + 30 * np.sin(np.arange(80) * 1.3) * np.exp(-np.arange(80) / 30)
    samples[1440:1600] = 2 * 9.8 - samples[1440:1600]
    found = waveform_of(recording)
    assert len(found.taps) == len(SPEEDS) - 2
    assert [line for line in found.warnings if "is left out: the waveform of the others explains" in line]
    assert [line for line in found.warnings if "is left out: pushes with the opposite sign" in line]
    assert len(found.left_out) == 2
    with pytest.raises(FitError, match="--strict forbids exclusions"):
        fit_taps([recording], "waveform", excluded=Exclusions(strict=True))


@pytest.mark.slow
def test_a_waveform_of_the_minority_of_the_taps_is_not_good() -> None:
    recording, onsets_s = recorded()
    assert waveform_of(recording).judged.quality == "good"
    samples = recording.acceleration_m_per_s2
    assert samples is not None
    usable, top = 5, samples.max() + 1.0
    for onset_s in onsets_s[usable:]:
        first = round(onset_s * recording.rate_hz) + 2
        samples[first : first + 4] = top
    found = waveform_of(recording)
    assert len(found.taps) == usable
    assert found.judged.quality == "poor"
    gone = len(SPEEDS) - usable
    assert found.judged.reasons == (f"{gone} of {len(SPEEDS)} taps are left out",)
    left_out = found.to_dict()["left_out"]
    assert isinstance(left_out, list) and len(left_out) == gone


@pytest.mark.long
def test_taps_that_push_downwards_are_turned() -> None:
    recording, _ = recorded(lambda x: -push(x))
    found = waveform_of(recording)
    assert explained(found, push, 0.01) > 0.99
    assert "the taps push downwards: the sign of the acceleration is reversed" in found.warnings


@pytest.mark.long
def test_two_samples_of_rest_are_enough() -> None:
    recording, onsets_s = recorded(noise=0.02)
    assert recording.acceleration_m_per_s2 is not None
    cut = []
    for index, onset_s in enumerate(onsets_s):
        first = int(onset_s * 1000) - 1
        part = recording.acceleration_m_per_s2[first : first + 100]
        speed = float(SPEEDS[index])
        cut.append(Recording(f"tap {index}", 1000.0, part, None, None, None, speed, Source(f"tap {index}", "")))
    found = waveform_of(*cut)
    assert len(found.taps) >= len(SPEEDS) - 1
    assert explained(found, push, 0.01) > 0.98


@pytest.mark.long
def test_a_pulse_that_is_not_over_is_faded_out_and_reported() -> None:
    recording, _ = recorded(lambda x: (1 - np.exp(-3 * np.maximum(x, 0))) * np.exp(-np.maximum(x, 0) / 5), noise=0.02)
    found = waveform_of(recording)
    assert found.length_s <= 0.1
    assert any("faded out" in line for line in found.warnings)
    assert found.verdict.startswith("fair")
    assert found.samples[-1] == 0
    slope = found.first_peak_slope_per_s
    assert slope.high - slope.value < 0.05 * slope.value
    # The interval contains the error of the fade-out.
    assert found.deviations[-2] > 0.2


@pytest.mark.long
def test_what_is_no_waveform_is_refused_in_a_line() -> None:
    few, _ = recorded(speeds=SPEEDS[:2])
    with pytest.raises(FitError, match="2 taps are too few: needs 3"):
        waveform_of(few)
    one, _ = recorded(speeds=np.full(6, 0.3) + np.arange(6) * 0.001)
    with pytest.raises(FitError, match="all 6 taps have about one speed"):
        waveform_of(one)
    random = np.random.default_rng(5)
    noise = [np.concatenate((np.zeros(60), 20 * random.standard_normal(30), np.zeros(110))) for _ in SPEEDS]
    mixed = np.concatenate(noise) + 9.8 + 0.01 * random.standard_normal(200 * len(SPEEDS))
    with pytest.raises(FitError, match=r"have another waveform|does not rise with the speed"):
        waveform_of(Recording("noise", 1000.0, mixed, None, None, None, SPEEDS, Source("noise", "")))


# ---- Mode or waveform ------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("shape", [push, thud])
def test_pulses_are_given_a_waveform(shape: Callable[[Floats], Floats]) -> None:
    recording, _ = recorded(shape)
    assert isinstance(fit_taps([recording]), WaveformFit)
    assert isinstance(fit_taps([recording], "mode"), TapFit)


@pytest.mark.parametrize("name", rest_slow(["wood", "acrylic", "glass"]))
def test_what_rings_is_given_a_mode(name: str) -> None:
    tap = shipped_materials()[name].tap
    assert tap is not None
    recording, _ = taps(tap, np.linspace(0.1, 0.45, 8), Stylus(rate_hz=10_000.0))
    assert isinstance(fit_taps([recording]), TapFit)


def test_where_neither_fits_the_reason_is_that_of_the_mode() -> None:
    tap = shipped_materials()["steel"].tap
    assert tap is not None
    recording, _ = taps(tap, SPEEDS, Stylus(rate_hz=5000.0))
    with pytest.raises(FitError) as caught:
        fit_taps([recording])
    with pytest.raises(FitError) as by_mode:
        fit_taps([recording], "mode")
    assert str(caught.value) == str(by_mode.value)


@pytest.mark.long
def test_the_command_writes_a_waveform(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording, _ = recorded()
    file = str(tmp_path / "pulses.npz")
    save(recording, file)
    assert main(["fit", "tap", file, "--json"]) == 0
    output = json.loads(capsys.readouterr().out)
    assert "--as mode fits a mode" in " ".join(output["notes"])
    tap = output["materials"]["tap"]["tap"]
    assert tap["attack"] == "first_peak"
    assert tap["waveform"]["samples"][0] == 0
    assert validate_materials({"tap": output["materials"]["tap"]})["tap"].tap is not None
    assert main(["fit", "tap", file, "--json", "--as", "mode"]) == 0
    as_mode = json.loads(capsys.readouterr().out)["materials"]["tap"]["tap"]
    assert "waveform" not in as_mode and ("frequency_hz" in as_mode or "mode_table" in as_mode)


def test_options_of_modes_make_no_waveform(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fit", "tap", str(tmp_path / "pulses.npz"), "--as", "waveform", "--table"]) == 2
    assert "--law table is only for modes, and --as waveform fits no modes: leave out one" in capsys.readouterr().err
