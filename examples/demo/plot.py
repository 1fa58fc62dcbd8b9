"""The plot: taps, slopes, puncture, comb and sandpaper, as measured, as in the library and as in the paper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from examples.demo import canvas, comb, paper, puncture, sandpaper
from examples.demo.canvas import LIBRARY, MEASURED, PAPER, Panel
from examples.demo.comb import Combing
from examples.demo.parts import Seen
from examples.demo.perform import MASS_KG, Floats, Recorded
from examples.demo.puncture import Torn
from examples.demo.sandpaper import Sanding, peak_of
from examples.demo.strikes import ENDS_AFTER_DECAY_TIMES, ON_TICK_S
from examples.demo.taps import Tapped
from hapticd.analysis.drawing import drawing, plain_decades
from hapticd.config.materials import Material, Materials, Mode
from hapticd.config.texture import Grooves, Stochastic

PLOT: Final = Path(__file__).parents[2] / "demo.png"
"""File of the plot in the repository, which git ignores. Beside it is the same plot as SVG."""
DRAWN_STROKE: Final = 4
"""Index in `comb.STROKES` of the stroke that is drawn. It goes to the right."""
DRAWN_SPACINGS: Final = (-0.2, 1.8)
"""Part of the comb that is drawn, in spacings."""
DRAWN_RUPTURE_S: Final = (-0.02, 0.018)
"""Time that is drawn before and after the rupture."""
MAX_DRAWN_HZ: Final = 1000.0
PRESS_MARKERS: Final = ("o", "s", "^")


def save(seen: Mapping[str, Seen], library: Materials, rate_hz: float, skipped: int, periods: int) -> None:
    """Draw every part with enough measurements, and write the plot to PLOT and as SVG beside it."""
    with drawing(canvas.SETTINGS, "hapticd demo"):
        figure, panels = canvas.sheet()
        draw(panels, seen, library, rate_hz)
        canvas.finish(figure, rate_hz, skipped, periods)
        canvas.write(figure, PLOT)


def draw(panels: Sequence[Panel], seen: Mapping[str, Seen], library: Materials, rate_hz: float) -> None:
    """Draw the measurements into the panels, in the order of the parts, the slopes of all taps after the taps."""
    left = iter(panels)
    fits = {name: each.measured for name, each in seen.items() if isinstance(each.measured, Tapped) and each.enough}
    for name, each in seen.items():
        if library[name].tap is not None and _begun(panel := next(left), f"tap on {name}", each):
            _tap(panel, name, each, library[name])
    panel = next(left)
    panel.title("taps on all materials")
    if fits:
        _slopes(panel, fits, library)
    else:
        panel.empty("Not enough measured: no material has enough taps.")
    torn, combed, sanded = seen[puncture.MATERIAL], seen[comb.MATERIAL], seen[sandpaper.MATERIAL]
    if _begun(panel := next(left), f"puncture of {puncture.MATERIAL}", torn):
        _puncture(panel, torn.best[0], torn.measured, library[puncture.MATERIAL])
    if _begun(panel := next(left), "stroke over a comb", combed):
        _stroke(panel, combed.best[0], library[comb.MATERIAL])
    if _begun(panel := next(left), "strikes of the comb", combed):
        _strikes(panel, combed.measured, library[comb.MATERIAL])
    if _begun(panel := next(left), f"spectrum of {sandpaper.MATERIAL}", sanded):
        _spectrum(panel, sanded.measured, library[sandpaper.MATERIAL], rate_hz)


def _begun(panel: Panel, title: str, seen: Seen) -> bool:
    """Title a panel; return whether there is enough to draw, and write the reason if there is not."""
    panel.title(title.replace("_", " "))
    if not seen.enough:
        panel.empty(f"Not enough measured: {seen}.")
    return seen.enough


def _ringing(since: Floats, mode: Mode) -> Floats:
    """Return a mode of amplitude 1 that begins at 0 and ends after five decay times."""
    rings = (since >= 0) & (since <= ENDS_AFTER_DECAY_TIMES / mode.decay_rate_per_s + ON_TICK_S)
    after = np.where(rings, since, 0.0)
    return np.asarray(np.exp(-mode.decay_rate_per_s * after) * np.sin(mode.angular_frequency_rad_per_s * after))


def _tap(panel: Panel, name: str, seen: Seen, material: Material) -> None:
    recorded, best, found = *seen.best, seen.measured
    tap, printed, strikes = material.tap, paper.TAPS[name], found.strikes
    assert tap is not None
    chosen = int(np.where(best.unscaled, best.true_speed, 0.0).argmax())
    speed, onset_s, decay_s = best.true_speed[chosen], best.strikes.due_s[chosen], tap.mode.decay_time_s
    since = recorded.time_s - onset_s
    window = (since > -0.2 * decay_s) & (since < 5.5 * decay_s)
    fine = np.linspace(-0.2 * decay_s, 5.5 * decay_s, 400)
    amplitude = tap.amplitude_m_per_s2(speed)
    panel.curves.plot(1e3 * fine, amplitude * _ringing(fine, tap.mode), **LIBRARY)
    panel.curves.plot(1e3 * fine, printed.slope_per_s * speed * _ringing(fine, printed.mode), **PAPER)
    drawn = panel.waveform(
        1e3 * since[window], recorded.vibration(1)[window], amplitude * _ringing(since[window], tap.mode)
    )
    panel.axes("time after contact, ms", "acceleration, m/s²")
    panel.caption(
        f"Tap at {speed:.3f} m/s, n = {found.count}{drawn}",
        f"Frequency {strikes.frequency_hz:.1f} / {tap.mode.frequency_hz:.0f} / {printed.frequency_hz:g} Hz",
        f"Decay time {1e3 * strikes.decay_time_s:.2f} / {1e3 * decay_s:.2f} / {1e3 * printed.decay_time_s:.2f} ms",
        f"Amplitude over speed {found.slope(found.true_speed):.0f} / {tap.amplitude_m_per_s2(1.0):.0f} / "
        f"{printed.slope_per_s:g} 1/s",
    )


def _slopes(panel: Panel, fits: Mapping[str, Tapped], library: Materials) -> None:
    fastest = 1.03 * max(float(found.true_speed[found.unscaled].max()) for found in fits.values())
    ends = np.array([0.0, fastest])
    heights: dict[str, float] = {}
    for name, found in fits.items():
        tap, used = library[name].tap, found.unscaled
        assert tap is not None
        law = np.array([tap.amplitude_m_per_s2(speed) for speed in found.true_speed[used].tolist()])
        measured = abs(found.strikes.amplitude[used])
        heights[name] = tap.amplitude_m_per_s2(fastest)
        panel.curves.plot(ends, [0.0, heights[name]], **LIBRARY)
        panel.curves.plot(ends, paper.TAPS[name].slope_per_s * ends, **PAPER)
        panel.curves.plot(found.true_speed[used], measured, **MEASURED)
        panel.residual(found.true_speed[used], canvas.percent_of_value(measured, law))
    top = 1.05 * max(heights.values())
    ordered = sorted(heights, key=heights.__getitem__)
    for name, height in zip(ordered, canvas.spread(np.array(sorted(heights.values())), 0.073 * top), strict=True):
        panel.curves.text(1.02 * fastest, height, name.replace("_", " "), va="center", fontsize=7.5)
    panel.curves.set(xlim=(0.0, 1.36 * fastest), ylim=(0.0, top))
    panel.axes("approach speed, m/s", "amplitude, m/s²")
    count = sum(found.count for found in fits.values())
    panel.caption(
        f"Amplitude of taps below the force limit, n = {count}",
        "The slopes are in (a) to (g). Those of the paper are from its Table 1, taken as the coefficient A of its "
        "equation 1.",
    )


def _puncture(panel: Panel, recorded: Recorded, torn: Torn, material: Material) -> None:
    rupture, stiffness = material.rupture, material.stiffness_n_per_m
    assert rupture is not None
    since = recorded.time_s - recorded.onset_s(recorded.reported("puncture")[0])
    window = (since >= DRAWN_RUPTURE_S[0]) & (since <= DRAWN_RUPTURE_S[1])
    deflection = -recorded.samples["position_m"][:, 1]

    def force(at: Floats) -> Floats:
        elastic = stiffness * np.interp(at, since, deflection)
        rung = MASS_KG * rupture.amplitude_m_per_s2 * _ringing(at, rupture.mode)
        return np.asarray(np.where(at < 0, elastic, rung))

    fine, after = np.linspace(*DRAWN_RUPTURE_S, 761), np.linspace(0.0, DRAWN_RUPTURE_S[1], 361)
    panel.curves.plot(1e3 * fine, force(fine), **LIBRARY)
    printed = paper.PUNCTURE_AMPLITUDE_M_PER_S2 * _ringing(after, paper.PUNCTURE_MODE)
    panel.curves.plot(1e3 * after, MASS_KG * printed, **PAPER)
    measured = recorded.samples["contact_force_n"][window, 1] + recorded.samples["vibration_force_n"][window, 1]
    drawn = panel.waveform(1e3 * since[window], measured, force(since[window]))
    panel.axes("time after rupture, ms", "force, N")
    angular, decay = 2 * np.pi * torn.strikes.frequency_hz, 1 / torn.strikes.decay_time_s
    mode, printed_mode = rupture.mode, paper.PUNCTURE_MODE
    panel.caption(
        f"n = {torn.count}{drawn}. The paper prints no force before the rupture.",
        f"Angular frequency {angular:.0f} / {mode.angular_frequency_rad_per_s:g} / "
        f"{printed_mode.angular_frequency_rad_per_s:g} rad/s",
        f"Decay rate {decay:.0f} / {mode.decay_rate_per_s:g} / {printed_mode.decay_rate_per_s:g} 1/s",
        f"Amplitude {torn.amplitude[-1]:.1f} / {rupture.amplitude_m_per_s2:g} / "
        f"{paper.PUNCTURE_AMPLITUDE_M_PER_S2:g} m/s²",
    )


def _stroke(panel: Panel, recorded: Recorded, material: Material) -> None:
    grooves, mode = material.texture, material.groove_mode
    assert isinstance(grooves, Grooves) and mode is not None
    speed, press, _ = comb.STROKES[DRAWN_STROKE]
    begin_s, end_s = comb.PASSES[DRAWN_STROKE][1:]
    x = recorded.samples["position_m"][:, 0]
    here = (recorded.time_s > begin_s) & (recorded.time_s < end_s)
    low, high = (grooves.spacing_m * edge for edge in DRAWN_SPACINGS)
    window = here & (x > low) & (x < high)
    time_s, library = recorded.time_s[window], np.zeros(int(window.sum()))
    for event in recorded.reported("groove"):
        onset_s = recorded.onset_s(event)
        if begin_s < onset_s < end_s:
            force = np.interp(onset_s, recorded.time_s, recorded.samples["contact_force_n"][:, 1])
            library += _strength(grooves, event["true_speed_m_per_s"], force) * _ringing(time_s - onset_s, mode)
    if not library.any():
        panel.empty("Not enough measured: periods were missed over the grooves that are drawn.")
        return
    panel.curves.plot(1e3 * x[window], library, **LIBRARY)
    drawn = panel.waveform(1e3 * x[window], recorded.vibration(0)[window], library)
    for groove in range(int(np.ceil(DRAWN_SPACINGS[0])), int(DRAWN_SPACINGS[1]) + 1):
        panel.curves.axvline(1e3 * groove * grooves.spacing_m, color=canvas.GUIDE_COLOR, lw=0.8, zorder=1)
    panel.axes("position along the comb, mm", "acceleration, m/s²")
    panel.caption(
        f"Stroke to the right at {speed:g} m/s with {press:g} N{drawn}; grey lines: grooves, "
        f"{1e3 * grooves.spacing_m:g} mm apart. The paper prints neither frequency nor decay time of a groove: "
        f"{mode.frequency_hz:g} Hz and {1e3 * mode.decay_time_s:g} ms are choices of the library."
    )


def _strength(grooves: Grooves, speed: npt.ArrayLike, force: Floats | float) -> Floats:
    """Return the amplitude of the library's law in m/s^2."""
    return np.asarray(grooves.velocity_gain_per_s * np.abs(speed) + grooves.force_gain_m_per_s2_per_n * force)


def _strikes(panel: Panel, combing: Combing, material: Material) -> None:
    grooves = material.texture
    assert isinstance(grooves, Grooves)
    presses = sorted({press for _, press, _ in comb.STROKES})
    nearest = np.array([min(presses, key=lambda press: abs(press - force)) for force in combing.force_n.tolist()])
    speed, amplitude = abs(combing.true_speed_m_per_s), abs(combing.strikes.amplitude)
    fastest = 1.05 * float(speed[combing.unscaled].max())
    ends = np.linspace(0.0, fastest, 100)
    for press, marker in zip(presses, PRESS_MARKERS, strict=True):
        here = (nearest == press) & combing.unscaled
        if not here.any():
            continue
        force = float(combing.force_n[here].mean())
        printed = paper.COMB_VELOCITY_GAIN_PER_S * ends + paper.COMB_FORCE_GAIN_M_PER_S2_PER_N * force
        library = _strength(grooves, ends, force)
        panel.curves.plot(ends, library, **LIBRARY)
        panel.curves.plot(ends, printed, **PAPER)
        panel.curves.plot(speed[here], amplitude[here], **{**MEASURED, "marker": marker, "ms": 3})
        for curve in (library, printed):
            panel.curves.text(-0.02 * fastest, curve[0], f"{press:g} N", ha="right", va="center", fontsize=7.5)
        each = _strength(grooves, speed[here], combing.force_n[here])
        panel.residual(speed[here], canvas.percent_of_value(amplitude[here], each), marker)
    panel.curves.set_yscale("log")
    plain_decades(panel.curves.yaxis, (1.0, 3.0))
    panel.curves.set_xlim(-0.2 * fastest, fastest)
    panel.curves.set_xticks([tick for tick in (0.0, 0.05, 0.1, 0.15, 0.2, 0.25) if tick < fastest])
    panel.axes("speed along the comb, m/s", "amplitude, m/s²")
    per_speed, per_force = combing.gains(combing.true_speed_m_per_s)
    panel.caption(
        f"Amplitude at three forces, n = {combing.count}",
        f"Gain of speed {per_speed:.1f} / {grooves.velocity_gain_per_s:g} / {paper.COMB_VELOCITY_GAIN_PER_S:g} 1/s",
        f"Gain of force {per_force:.2f} / {grooves.force_gain_m_per_s2_per_n:g} / "
        f"{paper.COMB_FORCE_GAIN_M_PER_S2_PER_N:g} m/s²/N",
        f"Weaker than the paper's comb ({1e3 * paper.COMB_SPACING_M:g} mm), so that strikes stay below the force limit "
        "of a joystick.",
    )


def _spectrum(panel: Panel, sanding: Sanding, material: Material, rate_hz: float) -> None:
    from hapticd.rendering.filter_design import power_spectrum, stochastic_filter

    law, spectrum = material.texture, sanding.mean_spectrum()
    assert isinstance(law, Stochastic)
    frequency = np.linspace(0.0, rate_hz / 2, len(spectrum))
    # At 0 a one-sided spectrum is half of its neighbouring value.
    shown = (frequency > 0) & (frequency <= MAX_DRAWN_HZ)
    asked = power_spectrum(stochastic_filter(law.peak_hz, law.mean_hz, rate_hz), frequency[shown], rate_hz)
    # Scale the law to the power of the measured spectrum up to the last frequency.
    asked *= spectrum[shown].sum() / asked.sum()
    panel.curves.plot(frequency[shown], 1e3 * asked, **LIBRARY)
    panel.curves.plot(frequency[shown], 1e3 * spectrum[shown], **MEASURED)
    panel.residual(frequency[shown], canvas.percent_of_value(spectrum[shown], asked))
    panel.curves.set_ylim(0.0, None)
    panel.axes("frequency, Hz", "relative power, 1/kHz")
    # The variance of Welch's mean over windows that overlap by half (Hann; Welch 1967).
    windows = 2 * sanding.ticks.sum() / sandpaper.SEGMENT_TICKS - 1
    scatter = float(np.sqrt(19 / 18 / windows))
    peak_hz, mean_hz = peak_of(frequency, spectrum, rate_hz), frequency @ spectrum / spectrum.sum()
    panel.caption(
        f"Noise over the RMS of the law, {sanding.ticks.sum() / rate_hz:.1f} s of strokes; the paper prints no figures",
        f"Peak {peak_hz:.0f} / {law.peak_hz:g} Hz, mean {mean_hz:.0f} / {law.mean_hz:g} Hz",
        f"Noise is random: the expected standard deviation of a residual is {100 * scatter:.0f} %.",
    )
