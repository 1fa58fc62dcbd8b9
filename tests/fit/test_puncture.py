"""Punctures: fits with known parameters, and recordings without a puncture."""

import dataclasses
import math
import re
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from hapticd.analysis.statistics import FitError, Floats
from hapticd.config.materials import Material, validate_materials
from hapticd.fit.puncture import fit_puncture
from hapticd.fit.recording import Recording, Source
from hapticd.fit.synthesize import Stylus, puncture

SPEEDS = (0.03, 0.05, 0.08, 0.1, 0.06)


def membrane(**keys: float) -> Material:
    rupture = {
        "depth_m": 0.005,
        "amplitude_m_per_s2": 38.0,
        "decay_rate_per_s": 330.0,
        "angular_frequency_rad_per_s": 1260.0,
    } | keys
    return validate_materials({"skin": {"stiffness_n_per_m": 300.0, "rupture": rupture}})["skin"]


def punctures(material: Material, seed: int) -> list[Recording]:
    return [puncture(material, speed, Stylus(seed=100 * seed + k)) for k, speed in enumerate(SPEEDS)]


@pytest.mark.slow
@pytest.mark.parametrize("depth_m", [0.002, 0.005])
def test_the_truth_is_found(depth_m: float) -> None:
    material = membrane(depth_m=depth_m)
    fits = [fit_puncture(punctures(material, seed)) for seed in range(5)]

    def middle(name: str) -> float:
        return float(np.median([getattr(fit, name).value for fit in fits]))

    assert middle("depth_m") == pytest.approx(depth_m, rel=0.01)
    assert middle("stiffness_n_per_m") == pytest.approx(300.0, rel=0.01)
    assert middle("force_n") == pytest.approx(300.0 * depth_m, rel=0.01)
    assert middle("amplitude_m_per_s2") == pytest.approx(38.0, rel=0.02)
    assert middle("frequency_hz") == pytest.approx(1260 / (2 * math.pi), rel=0.005)
    assert middle("decay_rate_per_s") == pytest.approx(330.0, rel=0.02)


@pytest.mark.long
def test_the_material_loads_and_comes_back() -> None:
    fit = fit_puncture(punctures(membrane(), 3))
    again = validate_materials({"skin": fit.material()})["skin"]
    second = fit_puncture(punctures(again, 4))
    assert second.depth_m.value == pytest.approx(fit.depth_m.value, rel=0.01)
    assert second.stiffness_n_per_m.value == pytest.approx(fit.stiffness_n_per_m.value, rel=0.01)


@pytest.mark.long
def test_no_puncture_is_an_answer() -> None:
    drawn = puncture(membrane(), 0.05, ruptures=False)
    with pytest.raises(FitError, match="no puncture here"):
        fit_puncture([drawn])
    found = fit_puncture([*punctures(membrane(), 1), drawn])
    assert len(found.ruptures) == len(SPEEDS)
    assert any("no puncture here" in warning for warning in found.warnings)


RATE = 10_000
TIME = np.arange(6000) / RATE
RING = np.exp(-330 * TIME) * np.sin(1260 * TIME)


def pressed(way_m: Floats, force_n: Floats, rings_s: Sequence[float] = (), seed: int = 0) -> Recording:
    """Return a recording of a stylus on this path with this force, and ringings at these times, with little noise."""
    random = np.random.default_rng(seed)
    heard = sum((np.roll(RING, round(at * RATE)) * (at <= TIME) for at in rings_s), np.zeros(len(TIME)))
    noise = random.standard_normal((3, len(TIME)))
    return Recording(
        "pressed",
        RATE,
        38.0 * heard + 0.05 * noise[0],
        force_n + 0.005 * noise[1],
        way_m + 2e-6 * noise[2],
        None,
        None,
        Source("pressed", ""),
    )


def way(*points: tuple[float, float]) -> Floats:
    """Return the positions on straight lines between these points (s, m)."""
    return np.interp(TIME, *np.array(points).T)


@pytest.mark.parametrize(
    ("way_m", "stiffness", "rings_s"),
    [
        (way((0, -0.002), (0.1, 0), (0.3, 0.004), (0.6, -0.002)), 300.0, ()),
        (way((0, -0.002), (0.1, 0), (0.3, 0.004), (0.305, -0.002)), 300.0, ()),
        (way((0, -0.03), (0.3, 0), (0.32, 0.0004), (0.34, 0), (0.6, -0.03)), 5000.0, (0.3,)),
    ],
    ids=["pressed and let go", "let go at once", "a tap on a wall"],
)
def test_what_goes_back_is_no_puncture(way_m: Floats, stiffness: float, rings_s: Sequence[float]) -> None:
    with pytest.raises(FitError, match="no puncture here"):
        fit_puncture([pressed(way_m, stiffness * np.maximum(way_m, 0), rings_s)] * 2)


def test_glitches_of_the_force_are_no_puncture() -> None:
    """One glitch up, one down: where the means over 2 ms fall most, no sample is high."""
    way_m = way((0, -0.002), (0.6, 0.016))
    force = np.zeros(len(TIME))
    force[[3000, 3060]] = 50.0, -20.0
    with pytest.raises(FitError, match="no puncture here"):
        fit_puncture([pressed(way_m, force, seed=seed) for seed in range(2)])


@pytest.mark.long
def test_a_force_that_stays_is_reported() -> None:
    """A needle still rubs after the rupture."""
    way_m = way((0, -0.002), (0.6, 0.016))
    struck_s = 0.007 / 0.03
    force = np.where(struck_s > TIME, 300.0 * np.maximum(way_m, 0), 0.3 * 1.5)
    fit = fit_puncture([pressed(way_m, force, [struck_s], seed) for seed in range(3)])
    assert fit.depth_m.value == pytest.approx(0.005, rel=0.01)
    assert fit.stiffness_n_per_m.value == pytest.approx(300.0, rel=0.01)
    assert any("30 % of the force is left" in warning for warning in fit.warnings)


@pytest.mark.long
def test_a_soft_touch_is_reported() -> None:
    way_m = way((0, -0.002), (0.6, 0.016))
    struck_s, deep = 0.007 / 0.03, np.maximum(way_m, 0)
    fit = fit_puncture(
        [pressed(way_m, np.where(struck_s > TIME, 300 * deep**2 / (deep + 0.001), 0), [struck_s], k) for k in range(3)]
    )
    assert any("softer at first" in warning for warning in fit.warnings)


def in_contact(recording: Recording) -> Recording:
    """Return the recording without the samples before the touch."""
    assert recording.force_n is not None
    first = int(np.argmax(recording.force_n > 0.1))
    columns = ("acceleration_m_per_s2", "force_n", "position_m")
    return dataclasses.replace(recording, **{name: getattr(recording, name)[first:] for name in columns})


@pytest.mark.long
def test_a_recording_that_begins_in_contact_is_reported() -> None:
    begun = [in_contact(each) for each in punctures(membrane(), 5)]
    fit = fit_puncture(begun)
    assert fit.depth_m.value == pytest.approx(0.005, rel=0.01)
    assert sum("begins in contact" in warning for warning in fit.warnings) == len(begun)


@pytest.mark.long
@pytest.mark.parametrize(
    ("others_hz", "message"), [((90.0, 517.0), "usual are 3[78]"), ((470.0,), "one mode explains")]
)
def test_a_rupture_that_rings_with_more_is_left_out(others_hz: Sequence[float], message: str) -> None:
    """The other punctures are fitted as before."""
    recordings = punctures(membrane(), 6)
    first = recordings[0]
    heard, force = first.acceleration_m_per_s2, first.force_n
    assert heard is not None and force is not None
    since = np.maximum(np.arange(len(heard)) - np.flatnonzero(force > 0.1)[-1], 0) / first.rate_hz
    other = sum(38.0 * np.exp(-200 * since) * np.sin(2 * np.pi * hz * since) for hz in others_hz)
    fit = fit_puncture([dataclasses.replace(first, acceleration_m_per_s2=heard + other), *recordings[1:]])
    assert len(fit.ruptures) == len(recordings) - 1
    (line,) = (warning for warning in fit.warnings if "left out" in warning)
    assert re.search(message, line), line
    assert fit.amplitude_m_per_s2.value == pytest.approx(38.0, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("heard", [lambda above: np.minimum(above, 0.6 * above.max()), lambda above: 6 * above])
def test_warnings_of_an_excluded_puncture_are_ignored(heard: Callable[[Floats], Floats]) -> None:
    """The puncture is clipped, or rings with another amplitude than the others."""
    recordings = punctures(membrane(), 5)
    first = in_contact(recordings[0])
    assert first.acceleration_m_per_s2 is not None
    rest = float(np.median(first.acceleration_m_per_s2))
    seen = rest + heard(first.acceleration_m_per_s2 - rest)
    fit = fit_puncture([dataclasses.replace(first, acceleration_m_per_s2=seen), *recordings[1:]])
    assert len(fit.ruptures) == len(recordings) - 1
    assert fit.judged.reasons == (f"1 of {len(recordings)} recordings are left out",)
    assert not any("begins in contact" in warning for warning in fit.warnings)


@pytest.mark.long
def test_few_samples_in_a_cycle_are_reported() -> None:
    slow = [puncture(membrane(), speed, Stylus(seed=k, rate_hz=1000.0)) for k, speed in enumerate(SPEEDS)]
    assert any("5.0 samples in a cycle" in warning for warning in fit_puncture(slow).warnings)
    assert not any("samples in a cycle" in warning for warning in fit_puncture(punctures(membrane(), 1)).warnings)


def test_two_punctures_in_a_file_are_refused() -> None:
    way_m = way((0, -0.002), (0.6, 0.016))
    times = 0.007 / 0.03, 0.0135 / 0.03
    force = 300 * (np.maximum(way_m, 0) * (times[0] > TIME) + np.maximum(way_m - 0.0065, 0) * (times[1] > TIME))
    with pytest.raises(FitError, match=r"ruptures at 0.23\d+ s and at 0.4[45]\d* s"):
        fit_puncture([pressed(way_m, force, times, seed) for seed in range(2)])


def test_one_puncture_has_no_interval() -> None:
    with pytest.raises(FitError, match="at least two recordings of a puncture are needed"):
        fit_puncture([puncture(membrane(), 0.05)])


@pytest.mark.long
@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        (lambda each: {"position_m": None}, "no position"),
        (lambda each: {"position_m": 1e3 * each.position_m}, "in mm"),
        (lambda each: {"position_m": -each.position_m}, "scale -1"),
        (lambda each: {"force_n": 0 * each.force_n}, "0 throughout"),
        (lambda each: {"force_n": 1e3 * each.force_n}, "is impossible"),
        (lambda each: {"force_n": None}, "no force"),
        (lambda each: {"force_n": each.acceleration_m_per_s2}, "no puncture here|swapped"),
        (lambda each: {"force_n": -each.force_n}, "mostly negative|no puncture here"),
        (lambda each: {"acceleration_m_per_s2": 1e3 * each.acceleration_m_per_s2}, "unit"),
        (lambda each: {"acceleration_m_per_s2": 1e-3 * each.acceleration_m_per_s2}, "unit"),
        (lambda each: {"acceleration_m_per_s2": np.clip(each.acceleration_m_per_s2, -50, 15)}, "clipped"),
    ],
)
def test_refusals_say_why(changed: object, reason: str) -> None:
    assert callable(changed)
    spoilt = [dataclasses.replace(each, **changed(each)) for each in punctures(membrane(), 2)]
    with pytest.raises(FitError, match=reason) as caught:
        fit_puncture(spoilt)
    assert "\n" not in str(caught.value)
