"""The plot of the demo, drawn from measurements that are 5 % above the library."""

from __future__ import annotations

import csv
import re
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import yaml
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from examples.demo import canvas, comb, paper, plot, puncture, sandpaper, taps
from examples.demo.canvas import LIBRARY, MEASURED, PAPER, Panel
from examples.demo.comb import Combing
from examples.demo.marks import Marks, residual
from examples.demo.parts import Seen, all_parts
from examples.demo.perform import MASS_KG, Recorded
from examples.demo.puncture import Torn
from examples.demo.sandpaper import Sanding
from examples.demo.strikes import Strikes
from examples.demo.taps import Tapped
from hapticd.base.core import SAMPLE_DTYPE
from hapticd.config.materials import Material, Materials, shipped_materials
from hapticd.config.texture import Grooves, Stochastic
from hapticd.rendering.filter_design import power_spectrum, stochastic_filter

Floats = npt.NDArray[np.float64]
RATE = 10_000.0
ABOVE = 1.05
"""Measured values over those of the library."""
DATA = Path(__file__).parents[1] / "data"
WITHOUT_PAPER = "jl"
"""Panels for which the paper prints no figures."""


def ringing(since: Floats, decay_per_s: float, omega: float) -> Floats:
    rings = (since >= 0) & (since * decay_per_s <= 5 + 1e-9)
    return np.where(rings, np.exp(-decay_per_s * since * rings) * np.sin(omega * since * rings), 0.0)


def strikes(amplitude: Floats, onset_s: float, decay_time_s: float, frequency_hz: float) -> Strikes:
    every = np.ones(len(amplitude))
    onsets = onset_s * every
    numbers = np.arange(len(every))
    return Strikes(numbers, onsets, onsets, amplitude, frequency_hz * every, decay_time_s * every, 0, 0)


def tapped(material: Material) -> tuple[Recorded, Tapped]:
    assert material.tap is not None
    mode, speed = material.tap.mode, np.linspace(0.05, 0.14, 10)
    time_s = np.arange(round((0.01 + 6 * mode.decay_time_s) * RATE)) / RATE
    amplitude = ABOVE * np.array([material.tap.amplitude_m_per_s2(each) for each in speed.tolist()])
    samples = np.zeros(len(time_s), SAMPLE_DTYPE)
    samples["vibration_force_n"][:, 1] = (
        MASS_KG * amplitude[-1] * ringing(time_s - 0.01, mode.decay_rate_per_s, mode.angular_frequency_rad_per_s)
    )
    struck = strikes(amplitude, 0.01, mode.decay_time_s, mode.frequency_hz)
    return Recorded(time_s, samples, (), 0, RATE), Tapped(struck, speed, speed, np.ones(10, dtype=np.bool_), 0)


def torn(material: Material) -> tuple[Recorded, Torn]:
    rupture = material.rupture
    assert rupture is not None
    mode, time_s = rupture.mode, np.arange(600) / RATE
    deflection = rupture.rupture_depth_m * time_s / 0.03
    samples = np.zeros(len(time_s), SAMPLE_DTYPE)
    samples["position_m"][:, 1] = -deflection
    samples["contact_force_n"][:, 1] = np.where(time_s < 0.03, ABOVE * material.stiffness_n_per_m * deflection, 0.0)
    samples["vibration_force_n"][:, 1] = (
        ABOVE
        * MASS_KG
        * rupture.amplitude_m_per_s2
        * ringing(time_s - 0.03, mode.decay_rate_per_s, mode.angular_frequency_rad_per_s)
    )
    event = {"event": "puncture", "time_ns": 30_000_000, "before_tick_s": 0.0}
    amplitude = np.array([ABOVE * rupture.amplitude_m_per_s2])
    struck = strikes(amplitude, 0.03, mode.decay_time_s, mode.frequency_hz)
    one = np.array([1e-6])
    return Recorded(time_s, samples, (event,), 0, RATE), Torn(struck, amplitude, 0 * one, 0 * one, one, one, 0)


def combed(material: Material) -> tuple[Recorded, Combing]:
    grooves, mode = material.texture, material.groove_mode
    assert isinstance(grooves, Grooves) and mode is not None
    speed, press, _ = comb.STROKES[plot.DRAWN_STROKE]
    begin_s, end_s = comb.PASSES[plot.DRAWN_STROKE][1:]
    time_s = np.arange(round(begin_s * RATE), round(end_s * RATE)) / RATE
    samples = np.zeros(len(time_s), SAMPLE_DTYPE)
    samples["position_m"][:, 0] = -comb.HALF_STROKE_M + speed * (time_s - begin_s)
    samples["contact_force_n"][:, 1] = press
    amplitude = ABOVE * (grooves.velocity_gain_per_s * speed + grooves.force_gain_m_per_s2_per_n * press)
    events, vibration = [], np.zeros(len(time_s))
    for groove in range(-5, 6):
        onset_s = begin_s + (groove * grooves.spacing_m + comb.HALF_STROKE_M) / speed
        time_ns = round(onset_s * 1e9)
        events.append({"event": "groove", "time_ns": time_ns, "before_tick_s": 0.0, "true_speed_m_per_s": speed})
        vibration += amplitude * ringing(
            time_s - time_ns / 1e9, mode.decay_rate_per_s, mode.angular_frequency_rad_per_s
        )
    samples["vibration_force_n"][:, 0] = MASS_KG * vibration
    count = comb.MIN_STRIKES
    speeds, presses = np.linspace(0.05, 0.2, count), np.resize([0.5, 1.0, 1.5], count)
    struck = ABOVE * (grooves.velocity_gain_per_s * speeds + grooves.force_gain_m_per_s2_per_n * presses)
    found = Combing(
        strikes=strikes(struck, 0.0, mode.decay_time_s, mode.frequency_hz),
        groove=np.arange(count),
        position_m=grooves.spacing_m * np.arange(count),
        direction=np.ones(count),
        speed_m_per_s=speeds,
        force_n=presses,
        true_speed_m_per_s=speeds,
        unscaled=np.ones(count, dtype=np.bool_),
        passed=count,
        reported=count,
    )
    return Recorded(time_s, samples, tuple(events), 0, RATE), found


def sanded(material: Material) -> tuple[Recorded, Sanding]:
    """Return a spectrum that alternates between 5 % above and 5 % below the law."""
    law = material.texture
    assert isinstance(law, Stochastic)
    frequency = np.linspace(0.0, RATE / 2, sandpaper.SEGMENT_TICKS // 2 + 1)
    asked = power_spectrum(stochastic_filter(law.peak_hz, law.mean_hz, RATE), frequency, RATE)
    spectrum = asked * np.where(np.arange(len(asked)) % 2, ABOVE, 2 - ABOVE)
    strokes = np.arange(len(sandpaper.STROKES))
    ticks, ones = np.full(len(strokes), sandpaper.MIN_TICKS), np.ones(len(strokes))
    empty = Recorded(np.empty(0), np.zeros(0, SAMPLE_DTYPE), (), 0, RATE)
    return empty, Sanding(strokes, ticks, ones, np.tile(spectrum, (len(strokes), 1)), ones, ones)


@cache
def library() -> Materials:
    return shipped_materials()


@cache
def seen() -> dict[str, Seen]:
    others: dict[str, Any] = {comb.MATERIAL: combed, sandpaper.MATERIAL: sanded, puncture.MATERIAL: torn}
    made = {}
    for part in all_parts(library()):
        best = others.get(part.material, tapped)(library()[part.material])
        made[part.material] = Seen(part, best[1], best)
    return made


@cache
def panels() -> dict[str, Panel]:
    _, drawn = canvas.sheet()
    plot.draw(drawn, seen(), library(), RATE)
    return {panel.letter: panel for panel in drawn}


def meaning(line: Any) -> str:
    """Return what a line shows, by its color alone."""
    colors = {MEASURED["color"]: "measured", LIBRARY["color"]: "library", PAPER["color"]: "paper"}
    return {**colors, canvas.GUIDE_COLOR: "guide"}[line.get_color()]


def caption(panel: Panel) -> str:
    (text,) = panel.residuals.texts
    return text.get_text().replace("\n", " ")


def test_panels_have_letters_in_order_a_title_and_a_caption() -> None:
    for letter, panel in zip("abcdefghijkl", panels().values(), strict=True):
        assert re.match(rf"\({letter}\) \w+", panel.curves.get_title(loc="left"))
        assert len(caption(panel)) > 40


@pytest.mark.parametrize("letter", canvas.LETTERS)
def test_every_axis_has_a_quantity_and_a_unit(letter: str) -> None:
    panel = panels()[letter]
    labels = (panel.curves.get_ylabel(), panel.residuals.get_xlabel(), panel.residuals.get_ylabel())
    assert labels[2] == "residual, %"
    for label in labels:
        assert re.fullmatch(r"[a-z ]+, (m/s²|m/s|ms|mm|N|Hz|1/kHz|%)", label)


@pytest.mark.parametrize("letter", canvas.LETTERS)
def test_a_color_has_the_same_meaning_and_the_same_mark_in_every_panel(letter: str) -> None:
    panel = panels()[letter]
    drawn: dict[str, list[Any]] = {"measured": [], "library": [], "paper": [], "guide": []}
    for line in (*panel.curves.lines, *panel.residuals.lines):
        drawn[meaning(line)].append(line)
    assert all(line.get_linestyle() == "None" and line.get_marker() in "os^" for line in drawn["measured"])
    assert all(line.get_linestyle() == "-" and line.get_marker() == "None" for line in drawn["library"])
    assert all(line.get_linestyle() == "--" and line.get_marker() == "None" for line in drawn["paper"])
    assert drawn["measured"] and drawn["library"] and bool(drawn["paper"]) == (letter not in WITHOUT_PAPER)
    assert "paper prints" in caption(panel) if letter in WITHOUT_PAPER else True
    over = min(line.get_zorder() for line in drawn["measured"])
    assert over > max(line.get_zorder() for line in drawn["library"] + drawn["paper"] + drawn["guide"])


@pytest.mark.parametrize("letter", canvas.LETTERS)
def test_residuals_are_those_of_measurements_5_percent_above_the_library(letter: str) -> None:
    lines = [line for line in panels()[letter].residuals.lines if meaning(line) == "measured"]
    percent = np.concatenate([np.asarray(line.get_ydata()) for line in lines])
    if letter in "hk":
        np.testing.assert_allclose(percent, 5.0, rtol=1e-9)
    elif letter == "l":
        np.testing.assert_allclose(abs(percent), 5.0, rtol=0.02)
    else:  # the largest sample of the library's curve need not be drawn
        assert 4.0 < abs(percent).max() <= 5.0 + 1e-9
    low, high = panels()[letter].residuals.get_ylim()
    assert low < percent.min() <= percent.max() < high


def test_residuals_of_a_case_computed_by_hand() -> None:
    np.testing.assert_allclose(canvas.percent_of_peak(np.array([1.0, -2.2]), np.array([1.0, -2.0])), [0.0, -10.0])
    np.testing.assert_allclose(canvas.percent_of_value(np.array([1.1, 1.8]), np.array([1.0, 2.0])), [10.0, -10.0])
    assert residual(1.1, 1.0) == "+10.00%" and residual(60.0, 1200.0) == "-95.00%"


def test_the_curve_of_the_paper_does_not_follow_the_library() -> None:
    """The library's delrin in the place of wood moves the library's line, not the paper's."""
    panel = Panel("a", *Figure().subplots(2))
    plot._tap(panel, "wood", seen()["wood"], library()["delrin"])
    ys = {meaning(line): np.asarray(line.get_ydata()) for line in panel.curves.lines}
    speed = seen()["wood"].measured.true_speed.max()
    # Maxima of exp(-B t) sin(w t): 0.600 for wood, 0.566 for delrin.
    assert ys["paper"].max() == pytest.approx(0.600 * 309 * speed, rel=0.01)
    assert ys["library"].max() == pytest.approx(0.566 * 509 * speed, rel=0.01)


def test_captions_give_measured_library_and_paper() -> None:
    texts = {letter: caption(panel) for letter, panel in panels().items()}
    assert "Frequency 67.0 / 67 / 67 Hz" in texts["a"] and "n = 10" in texts["a"]
    assert "Amplitude over speed 324 / 309 / 309 1/s" in texts["a"]
    assert "Amplitude 39.9 / 38 / 38 m/s²" in texts["i"]
    assert "Gain of speed 63.0 / 60 / 1200 1/s" in texts["k"] and "Gain of force 6.30 / 6 / 63.4 m/s²/N" in texts["k"]


def text_of(table: Table) -> str:
    console = Console(width=200)
    with console.capture() as printed:
        console.print(table)
    return " ".join(printed.get().split())  # captions are broken at the width of the table


def test_the_tables_give_the_paper_and_the_residual() -> None:
    marks, materials = Marks(), library()
    taps_text = text_of(taps.table({"wood": seen()["wood"].measured}, materials, marks))
    assert taps_text.count("309 +5.00%") == 4  # library and paper, by estimated and by true speed
    comb_text = text_of(comb.table(seen()[comb.MATERIAL].measured, materials[comb.MATERIAL], marks))
    assert "velocity gain 1200 1/s (-94.75%), force gain 63.4 m/s^2/N (-90.06%)" in comb_text
    torn_text = text_of(puncture.table(seen()[puncture.MATERIAL].measured, materials[puncture.MATERIAL], marks))
    assert "39.90 m/s^2 (library 38: +5.00%; paper 38: +5.00%)" in torn_text


def test_the_figures_of_the_paper_are_those_that_it_prints() -> None:
    with (DATA / "okamura1998_tapping.csv").open() as rows:
        printed = {row["material"]: row for row in csv.DictReader(rows)}
    assert paper.TAPS.keys() == printed.keys()
    for name, tap in paper.TAPS.items():
        row = printed[name]
        wanted = [float(row[key]) for key in ("attack_slope_per_s", "frequency_hz", "decay_time_ms")]
        assert [tap.slope_per_s, tap.frequency_hz, 1e3 * tap.decay_time_s] == pytest.approx(wanted)
        assert (tap.mode.frequency_hz, tap.mode.decay_time_s) == pytest.approx((tap.frequency_hz, tap.decay_time_s))
    others = yaml.safe_load((DATA / "okamura1998_other.yaml").read_text())
    assert others["puncture_cellophane"] == {
        "amplitude_m_per_s2": paper.PUNCTURE_AMPLITUDE_M_PER_S2,
        "decay_rate_per_s": paper.PUNCTURE_MODE.decay_rate_per_s,
        "angular_frequency_rad_per_s": paper.PUNCTURE_MODE.angular_frequency_rad_per_s,
    }
    grooves = others["grooves_measured"]
    assert grooves["spacing_m"] == paper.COMB_SPACING_M
    assert grooves["velocity_gain_per_s"] == paper.COMB_VELOCITY_GAIN_PER_S
    assert grooves["force_gain_m_per_s2_per_n"] == paper.COMB_FORCE_GAIN_M_PER_S2_PER_N


DEUTERANOPIA = np.array(
    [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
)
"""Linear RGB as seen without the middle cones: Machado, Oliveira and Fernandes 2009, severity 1."""
PROTANOPIA = np.array(
    [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
)
"""The same without the long cones."""


def lab(color: str, seen_by: Floats) -> Floats:
    """Return the CIELAB coordinates (D65) of a color as someone sees it."""
    rgb = np.array([int(color[n : n + 2], 16) for n in (1, 3, 5)]) / 255
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    x, y, z = np.cbrt(to_xyz @ np.clip(seen_by @ linear, 1e-4, 1) / to_xyz.sum(axis=1))
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


@pytest.mark.parametrize("seen_by", [np.eye(3), DEUTERANOPIA, PROTANOPIA], ids=["all", "deuteranopia", "protanopia"])
def test_the_colors_differ_for_the_colour_blind(seen_by: Floats) -> None:
    """A difference of 2 is just visible side by side; small dots and thin lines need many times as much."""
    colors = [MEASURED["color"], LIBRARY["color"], PAPER["color"], "#FFFFFF"]
    for one, other in combinations(colors, 2):
        assert np.linalg.norm(lab(one, seen_by) - lab(other, seen_by)) > 35, (one, other)


def test_labels_at_the_ends_of_lines_do_not_overlap_and_stay_near_their_lines() -> None:
    values = np.array([0.0, 1.0, 1.1, 5.0])
    placed = canvas.spread(values, 1.0)
    assert np.diff(placed).min() >= 1.0 - 1e-9
    np.testing.assert_allclose(placed, [-0.45, 0.55, 1.55, 5.0])


@pytest.mark.parametrize("kept", [slice(0), slice(10)])
def test_a_stroke_with_periods_missed_over_the_grooves_says_so(kept: slice) -> None:
    recorded = seen()[comb.MATERIAL].best[0]
    missed = Recorded(recorded.time_s[kept], recorded.samples[kept], (), 0, RATE)
    panel = Panel("j", *Figure().subplots(2))
    plot._stroke(panel, missed, library()[comb.MATERIAL])
    assert "periods were missed" in caption(panel) and not panel.curves.lines


@pytest.mark.long
def test_a_panel_with_too_little_measured_says_how_much_and_draws_nothing() -> None:
    parts = {part.material: Seen(part) for part in all_parts(library())}
    _, drawn = canvas.sheet()
    plot.draw(drawn, parts, library(), RATE)
    assert "Not enough measured: wood: 0 of 10 taps." in caption(drawn[0])
    for panel, letter in zip(drawn, canvas.LETTERS, strict=True):
        assert panel.curves.get_title(loc="left").startswith(f"({letter}) ")
        assert "Not enough measured" in caption(panel) and not panel.curves.lines


@pytest.mark.long
def test_the_files_say_rate_mass_and_missed_periods(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plot, "PLOT", tmp_path / "demo.png")
    plot.save(seen(), library(), RATE, 4_312, 81_000)
    assert (tmp_path / "demo.png").read_bytes().startswith(b"\x89PNG")
    text = (tmp_path / "demo.svg").read_text()
    assert "10,000 Hz" in text and "0.05 kg" in text and "4,312 of 81,000 periods missed" in text
    assert text.count("library: the shipped materials") == 1


@pytest.mark.long
def test_no_text_overlaps_another_or_the_edge() -> None:
    figure, drawn = canvas.sheet()
    plot.draw(drawn, seen(), library(), RATE)
    canvas.finish(figure, RATE, 4_312, 81_000)
    figure.draw_without_rendering()
    texts = [*figure.texts, *figure.legends]
    for panel in drawn:
        texts += [panel.curves._left_title, *panel.curves.texts, *panel.residuals.texts]  # type: ignore[attr-defined]
        texts += [panel.curves.yaxis.label, panel.residuals.xaxis.label, panel.residuals.yaxis.label]
    boxes = [text.get_window_extent() for text in texts]
    for box in boxes:
        assert figure.bbox.x0 <= box.x0 and box.x1 <= figure.bbox.x1
        assert figure.bbox.y0 <= box.y0 and box.y1 <= figure.bbox.y1
    for (one, a), (other, b) in combinations(zip(texts, boxes, strict=True), 2):
        assert not a.shrunk(0.98, 0.9).overlaps(b.shrunk(0.98, 0.9)), (one, other)
