"""Textures: fits of synthetic strokes with known parameters, and refusals."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from hapticd.analysis.statistics import FitError
from hapticd.base.lattice import reflection_of
from hapticd.config.materials import Material, validate_materials
from hapticd.config.texture import Autoregressive
from hapticd.fit.recording import Recording, Source
from hapticd.fit.synthesize import Hand, Stylus, texture
from hapticd.fit.texture import fit_texture
from hapticd.rendering.filter_design import power_spectrum

PLACES = ((0.05, 0.6), (0.05, 2.0), (0.15, 0.6), (0.15, 2.0), (0.1, 1.0))


def sandpaper(peak_hz: float, mean_hz: float) -> Material:
    noise = {
        "kind": "stochastic",
        "peak_hz": peak_hz,
        "mean_hz": mean_hz,
        "velocity_gain_per_s": 24.0,
        "force_gain_m_per_s2_per_n": 2.4,
    }
    return validate_materials({"grit": {"stiffness_n_per_m": 800.0, "texture": noise}})["grit"]


def strokes(material: Material, seed: int, duration_s: float = 8.0) -> list[Recording]:
    return [
        texture(material, speed, force, Stylus(seed=100 * seed + k, tremor_m_per_s2=0.3), Hand(duration_s=duration_s))
        for k, (speed, force) in enumerate(PLACES)
    ]


@pytest.mark.slow
@pytest.mark.parametrize(("peak_hz", "mean_hz", "resolved"), [(160.0, 210.0, 4), (250.0, 280.0, 9)])
def test_the_truth_is_found(peak_hz: float, mean_hz: float, resolved: int) -> None:
    """The density of the first spectrum falls by only 14 % from the peak to 20 Hz: not all sets resolve its peak."""
    fits = [fit_texture(strokes(sandpaper(peak_hz, mean_hz), seed)) for seed in range(9)]

    def error(name: str, truth: float) -> float:
        """The median over the sets that have the figure."""
        found = [getattr(fit, name) for fit in fits]
        return float(np.median([abs(each.value / truth - 1) for each in found if each is not None]))

    assert sum(fit.peak_resolved for fit in fits) >= resolved
    assert all(fit.peak_resolved or (fit.peak_hz is None and fit.peak_below_hz > peak_hz) for fit in fits)
    assert error("peak_hz", peak_hz) < 0.03
    assert error("mean_hz", mean_hz) < 0.01
    assert error("velocity_gain_per_s", 24.0) < 0.05
    assert error("force_gain_m_per_s2_per_n", 2.4) < 0.05
    assert not any("moves" in warning for fit in fits for warning in fit.warnings)


def test_a_stroke_between_two_models_has_spectrum_and_level_of_one() -> None:
    models = [
        {"speed_m_per_s": speed, "force_n": 1.0, "coefficients": [-0.5, 0.2], "rms_m_per_s2": level}
        for speed, level in ((0.05, 1.0), (0.15, 5.0))
    ]
    noise = {"kind": "autoregressive", "rate_hz": 2500.0, "models": models}
    material = validate_materials({"grit": {"stiffness_n_per_m": 800.0, "texture": noise}})["grit"]
    recordings = [texture(material, 0.1, 1.0, Stylus(seed=seed, noise_rms=0.0)) for seed in range(6)]
    levels = [
        float(np.std(each.acceleration_m_per_s2)) for each in recordings if each.acceleration_m_per_s2 is not None
    ]
    assert len(levels) == 6 and max(levels) < 1.1 * min(levels)


@pytest.mark.slow
def test_a_frequency_that_moves_with_speed_is_reported() -> None:
    slow, fast = sandpaper(140.0, 190.0), sandpaper(180.0, 230.0)
    recordings = [
        texture(slow if speed < 0.1 else fast, speed, force, Stylus(seed=k), Hand(duration_s=6.0))
        for k, (speed, force) in enumerate(PLACES[:4])
    ]
    fit = fit_texture(recordings)
    assert any("changes with speed" in warning for warning in fit.warnings)
    assert fit.mean_per_speed_hz_s_per_m is not None
    assert fit.mean_per_speed_hz_s_per_m.low > 0


@pytest.mark.slow
def test_autoregressive_models_have_the_spectrum() -> None:
    """The model's spectrum of two resonances differs from the true one by few dB."""
    radius = (0.93, 0.9)
    polynomial = np.array([1.0])
    for r, hz in zip(radius, (180.0, 420.0), strict=True):
        polynomial = np.convolve(polynomial, [1.0, -2 * r * np.cos(2 * np.pi * hz / 2500.0), r * r])
    models = [
        {"speed_m_per_s": v, "force_n": f, "coefficients": polynomial[1:].tolist(), "rms_m_per_s2": 20 * v + f}
        for v, f in PLACES
    ]
    texture_keys = {"kind": "autoregressive", "rate_hz": 2500.0, "models": models}
    material = validate_materials({"cloth": {"stiffness_n_per_m": 800.0, "texture": texture_keys}})["cloth"]
    fit = fit_texture(strokes(material, 3, 20.0), autoregressive=True)
    assert len(fit.ar_models) == len(PLACES)
    found = validate_materials({"cloth": {"stiffness_n_per_m": 800.0, **fit.material()}})["cloth"].texture
    assert isinstance(found, Autoregressive)
    frequency = np.arange(30.0, 700.0, 5.0)
    truth = power_spectrum((reflection_of(polynomial[1:].tolist()), None), frequency, 2500.0)
    loud = truth > 0.01 * truth.max()
    errors = []
    for model in found.models:
        shape = power_spectrum((reflection_of(model.coefficients), None), frequency, found.rate_hz)
        errors.append(10 * np.log10(shape[loud] / truth[loud]))
        assert model.rms_m_per_s2 == pytest.approx(20 * model.speed_m_per_s + model.force_n, rel=0.15)
    assert float(np.sqrt(np.mean(np.square(errors)))) < 1.0
    assert float(np.median(np.abs(errors))) < 1.0


@pytest.mark.slow
@pytest.mark.parametrize("mains_hz", [50.0, 59.9])
def test_hum_is_reported(mains_hz: float) -> None:
    """A tone with a fifth of the RMS is a line with 4 % of the power."""
    spoilt, clean = [], strokes(sandpaper(160.0, 210.0), 4, 5.0)
    for recording in clean:
        heard = recording.acceleration_m_per_s2
        assert heard is not None
        time = np.arange(len(heard)) / recording.rate_hz
        hum = 0.2 * np.std(heard) * np.sqrt(2) * np.sin(2 * np.pi * mains_hz * time)
        spoilt.append(dataclasses.replace(recording, acceleration_m_per_s2=heard + hum))
    (message,) = (warning for warning in fit_texture(spoilt).warnings if "hum" in warning)
    assert f"a line at {mains_hz:g} Hz holds" in message
    assert float(message.split("holds ")[1].split(" %")[0]) == pytest.approx(100 * 0.04 / 1.04, rel=0.3)
    assert not any("hum" in warning for warning in fit_texture(clean).warnings)


@pytest.mark.slow
def test_two_textures_in_one_file_are_left_out_and_refused_alone() -> None:
    one, other = strokes(sandpaper(120.0, 170.0), 1, 4.0), strokes(sandpaper(250.0, 280.0), 2, 4.0)
    both = dataclasses.replace(
        one[0],
        acceleration_m_per_s2=np.concatenate((one[0].acceleration_m_per_s2, other[0].acceleration_m_per_s2)),
        force_n=np.concatenate((one[0].force_n, other[0].force_n)),
        tangential_position_m=None,
        speed_m_per_s=0.05,
    )
    both = dataclasses.replace(both, name="both", source=Source("both", ""))
    with pytest.raises(FitError, match="two textures"):
        fit_texture([both])
    fit = fit_texture([both, *one[1:]])
    assert "both: left out: two textures" in fit.warnings[0] and {block.recording for block in fit.blocks} == {
        recording.name for recording in one[1:]
    }


SPOILT: list[tuple[Callable[[Recording], dict[str, object]], str]] = [
    (lambda each: {"acceleration_m_per_s2": None}, "no acceleration"),
    (lambda each: {"force_n": None}, "no force"),
    (lambda each: {"force_n": np.zeros_like(each.force_n)}, "0 throughout"),
    (lambda each: {"force_n": 1e3 * each.force_n}, "in mN"),
    (lambda each: {"force_n": -each.force_n}, "mostly negative"),
    (lambda each: {"force_n": each.acceleration_m_per_s2 - 9.8}, "swapped"),
    (lambda each: {"tangential_position_m": None}, "a stroke needs one of them"),
    (lambda each: {"tangential_position_m": None, "speed_m_per_s": 60.0}, "in mm/s"),
    (lambda each: {"speed_m_per_s": 60.0}, "wrong unit"),
    (lambda each: {"acceleration_m_per_s2": np.clip(each.acceleration_m_per_s2, 0, 12)}, "clipped"),
    (
        lambda each: {
            "tangential_position_m": None,
            "speed_m_per_s": 0.05,
            "force_n": each.force_n / each.force_n.mean(),
        },
        "be separated",
    ),
    (lambda each: {"acceleration_m_per_s2": 1e3 * each.acceleration_m_per_s2}, "unit"),
    (lambda each: {"acceleration_m_per_s2": 1e-3 * each.acceleration_m_per_s2}, "unit"),
    (lambda each: {"force_n": 1 + 0 * each.force_n}, "in every sample"),
]


@pytest.mark.long
@pytest.mark.parametrize(("changed", "reason"), SPOILT)
def test_refusals_say_why(changed: Callable[[Recording], dict[str, object]], reason: str) -> None:
    spoilt = [dataclasses.replace(each, **changed(each)) for each in strokes(sandpaper(160.0, 210.0), 1, 2.0)]
    with pytest.raises(FitError, match=reason) as caught:
        fit_texture(spoilt)
    assert "\n" not in str(caught.value)


def noises() -> dict[str, np.ndarray[tuple[int], np.dtype[np.float64]]]:
    """Return 4 s at 10 kHz of accelerations that are not textures."""
    random, time = np.random.default_rng(1), np.arange(40_000) / 10_000
    white = random.standard_normal(len(time))
    return {
        "the sensor's noise": white,
        "tone": 5 * np.sin(2 * np.pi * 200 * time) + 0.02 * white,
        "motion of a hand": np.cumsum(random.standard_normal(len(time))) * 0.02,
    }


@pytest.mark.parametrize("what", ["the sensor's noise", "tone", "motion of a hand"])
def test_what_is_no_texture(what: str) -> None:
    one = texture(sandpaper(160.0, 210.0), 0.1, 1.0, Stylus(rate_hz=10_000.0), Hand(duration_s=4.0))
    spoilt = dataclasses.replace(one, acceleration_m_per_s2=noises()[what], source=Source("noise", ""))
    with pytest.raises(FitError, match=what):
        fit_texture([spoilt] * 2)
