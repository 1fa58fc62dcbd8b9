"""Pictures of reports, compared with recordings made from closed forms."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from hapticd.analysis.statistics import Estimate
from hapticd.fit.panels import compared, density, law, level, overlay, page_of
from hapticd.fit.recording import Recording, Source
from hapticd.fit.report import Curve, Panel
from hapticd.fit.verdict import Exclusion, Verdict
from hapticd.rendering.filter_design import stochastic_filter
from tests.support.marks import rest_slow

JUDGED = Verdict("good", "all of it")

RATE = 25_000.0
Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Fitted:
    """A fit with given values."""

    figures: Mapping[str, object]
    parts: Mapping[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ("careful",)
    judged: Verdict = JUDGED
    left_out: tuple[Exclusion, ...] = ()

    def material(self) -> Mapping[str, object]:
        return self.figures

    @property
    def verdict(self) -> str:
        return str(self.judged)

    def to_dict(self) -> Mapping[str, object]:
        return {}

    def __getattr__(self, name: str) -> Any:
        return self.parts[name]


def recording(name: str, acceleration: Floats | None, **more: Any) -> Recording:
    given = {
        "force_n": None,
        "position_m": None,
        "tangential_position_m": None,
        "speed_m_per_s": None,
        "source": Source(f"{name}.csv", "ab" * 32),
        **more,
    }
    return Recording(name=name, rate_hz=RATE, acceleration_m_per_s2=acceleration, **given)


def curves(panel: Panel) -> dict[str, tuple[Floats, Floats]]:
    return {curve.label: (curve.x, curve.y) for curve in panel.curves}


def test_density_is_power_over_frequency() -> None:
    """White noise of variance 1 has 2/rate at all frequencies; a sine has half its squared amplitude in one line."""
    noise = np.random.default_rng(1).standard_normal(400_000)
    frequency, power = density(noise, RATE, 1000)
    assert frequency[0] == RATE / 1000
    assert power[:-1].mean() == pytest.approx(2 / RATE, rel=0.01)
    sine = 3.0 * np.sin(2 * np.pi * 500 * np.arange(100_000) / RATE)
    frequency, power = density(sine, RATE, 1000)
    assert frequency[np.argmax(power)] == 500
    assert power.sum() * (frequency[1] - frequency[0]) == pytest.approx(4.5, rel=1e-6)


def test_overlay_shows_what_is_left() -> None:
    recorded = np.arange(300.0)
    model = np.full(300, np.nan)
    model[100:200] = np.arange(100.0, 200.0) - 2.0
    shown, left, spectrum = overlay("one", RATE, recorded, model)
    (x, y), (_, said) = curves(shown)["recording"], curves(shown)["model"]
    assert x[0] == pytest.approx(1e3 * 100 / RATE) and len(x) == 100
    assert np.array_equal(y - said, np.full(100, 2.0))
    assert np.array_equal(curves(left)["recording less model"][1], np.full(100, 2.0))
    assert set(curves(spectrum)) == {"recording", "model", "residual"}
    assert overlay("none", RATE, recorded, np.full(300, np.nan)) == ()


def test_overlay_of_stretches_keeps_the_gaps_between_them() -> None:
    """A second of strikes: the pictures show the longest section, and the spectra are of this section alone."""
    recorded = np.random.default_rng(2).standard_normal(25_000)
    model = np.full(25_000, np.nan)
    for begin, end in ((1000, 1100), (5000, 5400), (6000, 6100), (20_000, 20_100)):
        model[begin:end] = recorded[begin:end] - 1.0
    shown, left, spectrum = overlay("one", RATE, recorded, model)
    x, y = curves(shown)["model"]
    assert len(x) == pytest.approx(0.15 * RATE, abs=2)
    assert np.count_nonzero(np.isfinite(y)) == 500
    assert np.array_equal(np.isfinite(y), np.isfinite(curves(left)["recording less model"][1]))
    assert np.nanmax(np.abs(curves(left)["recording less model"][1] - 1.0)) < 1e-12
    assert np.array_equal(curves(spectrum)["recording"][1], density(recorded[5000:5400], RATE)[1])


def test_a_law_is_a_line_with_its_interval() -> None:
    panel = law("A", "m/s", np.array([0.1, 0.4]), np.array([31.0, 119.0]), Estimate(300.0, 290.0, 315.0))
    dots, line = panel.curves
    assert dots.points and np.array_equal(dots.y, [31.0, 119.0])
    assert line.low is not None and line.high is not None
    assert np.allclose(line.y, 300 * line.x) and np.allclose(line.low, 290 * line.x)
    assert np.allclose(line.high, 315 * line.x) and line.x.max() > 0.4


def test_what_is_the_same_everywhere() -> None:
    panel = level("f", "m/s", "Hz", np.array([0.1, 0.4]), np.array([199.0, 201.0]), Estimate(200.0, 198.0, 203.0))
    dots, line = panel.curves
    assert dots.points and np.array_equal(dots.y, [199.0, 201.0])
    assert line.low is not None and line.high is not None
    assert np.all(line.y == 200) and np.all(line.low == 198) and np.all(line.high == 203)
    assert line.x[0] == 0 and line.x[-1] > 0.4
    same = compared("A", "N", np.array([1.0, 2.0]), np.array([1.1, 4.0]))
    assert np.array_equal(same.curves[1].x, same.curves[1].y) and same.curves[1].x.max() > 4


def hits_of(*speeds: float) -> list[Any]:
    return [
        SimpleNamespace(
            recording=f"folder/t{speed}",
            speed_m_per_s=speed,
            coefficient_m_per_s2=300 * speed + 1,
            angular_frequency_rad_per_s=2 * np.pi * (200 + speed),
            rate_hz=RATE,
            measured=np.ones(100) * speed,
            modelled=np.zeros(100),
        )
        for speed in speeds
    ]


STRAIGHT = {
    "linear": True,
    "second": None,
    "frequency_hz": Estimate(200.0, 199.0, 201.0),
    "slope_per_s": Estimate(300.0, 299.0, 301.0),
    "offset_slope_per_s": Estimate(290.0, 280.0, 300.0),
    "offset_m_per_s2": Estimate(2.0, 0.0, 4.0),
}
"""Figures of taps whose amplitudes lie on a line."""


def test_taps() -> None:
    parts = {**STRAIGHT, "taps": hits_of(0.1, 0.4, 0.2, 0.3)}
    page = page_of("tap", "pine: tap", Fitted({}, parts), [recording("a", None), recording("a", None)])
    assert (page.title, page.verdict, page.warnings) == ("pine: tap", "good: all of it", ("careful",))
    assert page.sources == (("a.csv", "ab" * 32),)
    ((first, less, hertz), *rest) = page.rows
    x, y = curves(first)["offset"]
    assert np.allclose(y, 2 + 290 * x)
    assert "table" not in curves(first)
    assert np.allclose(curves(less)["recorded"][1], 1.0)
    assert np.allclose(curves(less)["offset"][1], 2 - 10 * x)
    assert np.all(curves(less)["model"][1] == 0)
    band = less.curves[1]
    assert band.low is not None and band.high is not None
    assert np.allclose(band.low, -x) and np.allclose(band.high, x)
    assert np.allclose(curves(hertz)["recorded"], ((0.1, 0.4, 0.2, 0.3), (200.1, 200.4, 200.2, 200.3)))
    assert [row[0].title for row in rest] == ["t0.4, 0.4 m/s", "t0.3, 0.3 m/s", "t0.2, 0.2 m/s"]
    assert np.all(curves(rest[0][1])["recording less model"][1] == 0.4)


def test_taps_that_bend_and_have_two_modes() -> None:
    """The model is the table, besides a dashed line; recordings of two modes leave no residual."""
    time_s = np.arange(1000) / RATE - 0.002
    later = np.maximum(time_s, 0)
    both = 30 * np.exp(-150 * later) * np.sin(1300 * later) + 12 * np.exp(-400 * later) * np.sin(5000 * later)
    (hit,) = hits_of(0.2)
    hit.measured = both + 1e-3 * np.random.default_rng(7).standard_normal(1000)
    hit.modelled = 0 * both
    parts = {
        **STRAIGHT,
        "taps": [hit],
        "linear": False,
        "amplitudes": ((0.1, Estimate(20.0, 19.0, 21.0)), (0.2, Estimate(61.0, 60.0, 62.0))),
        "second": object(),
    }
    page = page_of("tap", "pine: tap", Fitted({}, parts), [])
    (lines, less, _), one, two = page.rows
    assert np.array_equal(curves(lines)["model"], ((0, 0.1, 0.2), (0, 20, 61)))
    x, y = curves(lines)["line through 0"]
    assert np.allclose(y, 300 * x)
    assert np.allclose(curves(less)["model"][1], 0)
    assert np.allclose(curves(less)["line through 0"][1], 300 * x - np.interp(x, (0, 0.1, 0.2), (0, 20, 61)))
    assert one[0].title == "t0.2, 0.2 m/s" and two[0].title == "t0.2, 0.2 m/s, two modes"
    assert np.std(curves(two[1])["recording less model"][1]) < 2e-3


def test_what_is_left_out_is_drawn_with_its_reason() -> None:
    """Pictures: a recording with marks at the used taps, the samples near an excluded tap, and an excluded file."""
    seen = np.random.default_rng(1).standard_normal(25_000)
    (hit,) = hits_of(0.2)
    hit.recording, hit.onset_s = "folder/a", 0.25
    parts = {**STRAIGHT, "taps": [hit]}
    left = (
        Exclusion("folder/a", "clipped", "tap", 0.5),
        Exclusion("b", "no onset"),
        Exclusion("c", "cannot be read"),
    )
    fit = Fitted({}, parts, left_out=left)
    page = page_of("tap", "pine: tap", fit, [recording("folder/a", seen)], [recording("b", seen[:50])])
    marked, (tap, whole) = page.rows[-2:]
    assert curves(marked[0])["fitted"][0].tolist() == [0.25] and curves(marked[0])["left out"][0].tolist() == [0.5]
    assert marked[0].curves[2].crossed and curves(marked[0])["left out"][1][0] > seen.max()
    assert (tap.title, whole.title) == ("a left out: clipped", "b left out: no onset")
    x, y = curves(tap)["recording"]
    assert x[0] == pytest.approx(490) and x[-1] == pytest.approx(560) and y[0] == seen[12_250]
    assert len(curves(whole)["recording"][0]) == 50


@pytest.mark.parametrize(("low", "high"), rest_slow([(60, 85), (40, 130), (20, 500), (20, 5000), (1, 12_500)]))
def test_labels_of_logarithmic_axes_do_not_overlap(low: float, high: float) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    from hapticd.fit.report import _CELL_INCHES, _draw

    figure, axes = plt.subplots(figsize=(0.8 * _CELL_INCHES[0], 0.7 * _CELL_INCHES[1]))
    hertz = np.linspace(low, high, 50)
    _draw(axes, Panel("spectrum", "Hz", "dB", (Curve("one", hertz, 1 / hertz),), logarithmic=True))
    figure.canvas.draw()
    boxes = [
        label.get_window_extent()
        for label in (*axes.get_xticklabels(), *axes.get_xticklabels(minor=True))
        if label.get_text() and axes.get_xlim()[0] <= label.get_position()[0] <= axes.get_xlim()[1]
    ]
    plt.close(figure)
    boxes.sort(key=lambda box: box.x0)
    assert len(boxes) >= 3
    assert all(left.x1 + 3 < right.x0 for left, right in itertools.pairwise(boxes))


def test_grooves() -> None:
    speeds, forces = np.array([-0.1, 0.2, -0.3]), np.array([1.0, 2.0, 0.5])
    strikes = [
        SimpleNamespace(speed_m_per_s=v, force_n=f, amplitude_m_per_s2=50 * abs(v) + 6 * f)
        for v, f in zip(speeds, forces, strict=True)
    ]
    stroke = SimpleNamespace(name="s", rate_hz=RATE, acceleration_m_per_s2=np.ones(100), model_m_per_s2=np.zeros(100))
    parts = {
        "strikes": strikes,
        "strokes": [stroke] * 5,
        "velocity_gain_per_s": Estimate(50.0, 45.0, 55.0),
        "force_gain_m_per_s2_per_n": Estimate(6.0, 5.0, 7.0),
    }
    page = page_of("grooves", "comb", Fitted({}, parts), [])
    by_speed, by_force, together = page.rows[0]
    assert np.allclose(*curves(together)["recorded"])
    assert np.allclose(curves(by_speed)["recorded"], (abs(speeds), 50 * abs(speeds)))
    assert np.allclose(curves(by_force)["recorded"], (forces, 6 * forces))
    assert [len(row) for row in page.rows] == [3, 3, 3, 3]


@pytest.mark.long
def test_textures() -> None:
    """Noise filtered by the stochastic filter, in its direct form by scipy."""
    from scipy.signal import lfilter

    speed, force, count = 0.1, 1.5, 500_000
    rms = 40 * speed + 2 * force
    shape = stochastic_filter(200.0, 300.0, RATE)
    poles = np.array([1.0])
    for k in shape.reflection:
        poles = np.append(poles, 0.0) + k * np.append(poles, 0.0)[::-1]
    assert shape.taps is None
    noise = lfilter([1.0], poles, np.random.default_rng(5).standard_normal(count))
    noise *= rms / noise.std()
    texture = {
        "kind": "stochastic",
        "peak_hz": 200.0,
        "mean_hz": 300.0,
        "velocity_gain_per_s": 40.0,
        "force_gain_m_per_s2_per_n": 2.0,
    }
    autoregressive = {
        "kind": "autoregressive",
        "rate_hz": RATE,
        "models": [
            {"speed_m_per_s": 0.1, "force_n": 1.4, "coefficients": list(poles[1:]), "rms_m_per_s2": rms},
            {"speed_m_per_s": 0.3, "force_n": 1.4, "coefficients": [0.5], "rms_m_per_s2": 99.0},
        ],
    }
    place = speed * np.arange(count) / RATE
    forces = np.full(count, force)
    for made in (texture, autoregressive):
        whole = recording("a", noise, force_n=forces, tangential_position_m=0.3 - place)
        bare = recording("b", noise)
        steady = recording("c", noise, force_n=forces, speed_m_per_s=speed)
        block = SimpleNamespace(speed_m_per_s=speed, force_n=force, rms_m_per_s2=1.01 * rms, mean_hz=301.0)
        parts = {"blocks": (block,) * 3, "mean_hz": Estimate(300.0, 290.0, 310.0)}
        page = page_of("texture", "grit", Fitted({"texture": made}, parts), [whole, bare, steady])
        assert [len(row) for row in page.rows] == [3, 2, 2]
        level_of, by_speed, by_force = page.rows[0]
        modelled, recorded = curves(level_of)["recorded"]
        assert np.allclose(modelled, rms) and np.allclose(recorded, 1.01 * rms)
        assert np.allclose(curves(by_speed)["recorded"], [[speed] * 3, [301.0] * 3])
        assert np.allclose(curves(by_force)["recorded"], [[force] * 3, [301.0] * 3])
        for spectrum, ratio in page.rows[1:]:
            frequency, power = curves(spectrum)["model"]
            assert np.sum(power) * (frequency[1] - frequency[0]) == pytest.approx(rms**2, rel=0.05)
            _, decibels = curves(ratio)["recording over model"]
            assert np.abs(decibels).max() < 1.5
            assert abs(decibels.mean()) < 0.1


@pytest.mark.parametrize("turned", [1.0, -1.0])
def test_punctures(turned: float) -> None:
    """Force and deflection of a spring that breaks, and the ringing after that."""
    stiffness, depth, amplitude, decay, omega = 600.0, 0.004, 38.0, 330.0, 1260.0
    struck, rng = 2500, np.random.default_rng(3)
    place = 0.02 + turned * 0.05 * (np.arange(4000) - struck) / RATE
    deflection = turned * (place - 0.02) + depth
    since = (np.arange(4000) - struck) / RATE
    force = np.where(since <= 0, stiffness * np.maximum(deflection, 0.0), 0.0) + 0.003 * rng.standard_normal(4000)
    later = np.maximum(since, 0.0)
    ringing = amplitude * np.exp(-decay * later) * np.sin(omega * later)
    figures = {
        "stiffness_n_per_m": stiffness,
        "rupture": {
            "depth_m": depth,
            "amplitude_m_per_s2": amplitude,
            "decay_rate_per_s": decay,
            "angular_frequency_rad_per_s": omega,
        },
    }
    ours = recording("skin", turned * ringing + 9.81, force_n=force, position_m=place)
    held = recording("held", ringing, force_n=0 * force, position_m=place)
    broken = {"recording": "skin", "time_s": struck / RATE, "speed_m_per_s": 0.05, "depth_m": depth}
    rupture = SimpleNamespace(**broken, force_n=2.4, amplitude_m_per_s2=38.5)
    parts = {
        "ruptures": (rupture,),
        "depth_m": Estimate(0.004, 0.0039, 0.0041),
        "force_n": Estimate(2.4, 2.3, 2.5),
        "amplitude_m_per_s2": Estimate(38.0, 37.0, 39.0),
    }
    page = page_of("puncture", "skin", Fitted(figures, parts), [held, ours])
    assert [len(row) for row in page.rows] == [3, 4]
    deep, strong, loud = page.rows[0]
    for panel, wanted in ((deep, 4.0), (strong, 2.4), (loud, 38.5)):
        assert np.allclose(curves(panel)["recorded"], [[0.05], [wanted]])
    assert np.allclose(curves(deep)["model"][1], 4.0)
    spring, _, left, _ = page.rows[1]
    x, y = curves(spring)["recording"]
    assert np.allclose(x, 1e3 * deflection, rtol=0, atol=1e-9) and np.array_equal(y, force)
    assert np.allclose(curves(spring)["model"], ((0, 4), (0, 2.4)))
    assert np.abs(curves(left)["recording less model"][1]).max() < 1e-9
