"""The plot: taps, slopes, puncture, comb and sandpaper, as rendered and as in the library."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from examples.demo import comb, puncture, sandpaper
from examples.demo.comb import Combing
from examples.demo.parts import Seen
from examples.demo.perform import Floats, Recorded
from examples.demo.sandpaper import peak_of
from examples.demo.taps import Tapped
from hapticd.config.materials import Material, Materials, Mode
from hapticd.config.texture import Grooves, Stochastic

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PLOT: Final = Path(__file__).parents[2] / "demo.png"
"""File of the plot in the repository, which git ignores."""
THERE_AND_BACK: Final = (4, 3)
"""Indices in `comb.STROKES` of the two strokes that are drawn. Strokes with an even index go to the right."""


def save(seen: Mapping[str, Seen], library: Materials, rate_hz: float) -> None:
    """Draw every part with enough measurements, and write the plot to PLOT."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(4, 3, figsize=(13, 12.5), constrained_layout=True)
    panels = iter(axes.flat)

    def panel_of(name: str) -> Axes | None:
        """Return the next panel; label it and return None if there is too little to draw."""
        panel: Axes = next(panels)
        if seen[name].enough:
            return panel
        panel.set_title(f"{name}: not enough seen", fontsize=10)
        panel.set_axis_off()
        return None

    fits = {name: each.measured for name, each in seen.items() if isinstance(each.measured, Tapped) and each.enough}
    for name, each in seen.items():
        if library[name].tap is not None and (panel := panel_of(name)):
            _tap(panel, name, *each.best, library[name])
    _slopes(next(panels), fits, library)
    if panel := panel_of(puncture.MATERIAL):
        _puncture(panel, seen[puncture.MATERIAL].best[0], library[puncture.MATERIAL])
    if panel := panel_of(comb.MATERIAL):
        _strokes(panel, seen[comb.MATERIAL].best[0], library[comb.MATERIAL])
    if panel := panel_of(comb.MATERIAL):
        _strikes(panel, seen[comb.MATERIAL].measured, library[comb.MATERIAL])
    if panel := panel_of(sandpaper.MATERIAL):
        _spectrum(panel, seen[sandpaper.MATERIAL].measured.mean_spectrum(), library[sandpaper.MATERIAL], rate_hz)
    figure.savefig(PLOT, dpi=100)
    plt.close(figure)


def _dress(panel: Axes, title: str, x: str, y: str, legend: Literal["best", "upper right"] = "best") -> None:
    panel.set_title(title, fontsize=10)
    panel.set_xlabel(x)
    panel.set_ylabel(y)
    panel.legend(fontsize=8, loc=legend)


def _ringing(since: Floats, mode: Mode) -> Floats:
    return np.asarray(np.exp(-mode.decay_rate_per_s * since) * np.sin(mode.angular_frequency_rad_per_s * since))


def _tap(panel: Axes, name: str, recorded: Recorded, found: Tapped, material: Material) -> None:
    assert material.tap is not None
    mode = material.tap.mode
    chosen = int(np.where(found.unscaled, found.speed, 0.0).argmax())
    since = recorded.time_s - found.strikes.onset_s[chosen]
    window = (since > -0.2 / mode.decay_rate_per_s) & (since < 5.5 / mode.decay_rate_per_s)
    panel.plot(1e3 * since[window], recorded.vibration(1)[window], ".", ms=4, label="rendered")
    fine = np.linspace(0, 5 / mode.decay_rate_per_s, 800)
    closed = material.tap.amplitude_m_per_s2(found.speed[chosen]) * _ringing(fine, mode)
    panel.plot(1e3 * fine, closed, lw=1, label="library")
    title = f"{name}: {found.strikes.frequency_hz:.0f} Hz, {1e3 * found.strikes.decay_time_s:.2f} ms"
    _dress(panel, title, "ms after contact", "m/s²")


def _slopes(panel: Axes, fits: Mapping[str, Tapped], library: Materials) -> None:
    if not fits:
        panel.set_axis_off()
        return
    for name, found in fits.items():
        tap = library[name].tap
        assert tap is not None
        unscaled = found.unscaled
        (line,) = panel.plot(found.true_speed[unscaled], abs(found.strikes.amplitude[unscaled]), "o", ms=3, label=name)
        ends = np.array([0, 1.02 * found.true_speed.max()])
        panel.plot(ends, [tap.amplitude_m_per_s2(end) for end in ends], lw=0.8, color=line.get_color())
    _dress(panel, "taps over the handle's true speed; lines: library", "m/s", "m/s²")


def _puncture(panel: Axes, torn: Recorded, material: Material) -> None:
    assert material.rupture is not None
    deflection = -1e3 * torn.samples["position_m"][:, 1]
    panel.plot(deflection, torn.samples["contact_force_n"][:, 1], lw=1, label="membrane")
    panel.plot(deflection, torn.samples["vibration_force_n"][:, 1], lw=0.7, label="vibration")
    panel.axvline(1e3 * material.rupture.rupture_depth_m, color="grey", lw=0.6)
    panel.set_xlim(-1, 9)
    _dress(panel, f"puncture of {puncture.MATERIAL}", "mm of deflection", "N")


def _strokes(panel: Axes, combed: Recorded, material: Material) -> None:
    assert isinstance(material.texture, Grooves)
    spacing = 1e3 * material.texture.spacing_m
    x, force = 1e3 * combed.samples["position_m"][:, 0], combed.samples["vibration_force_n"][:, 0]
    for number in THERE_AND_BACK:
        begin, end = comb.PASSES[number][1:]
        window = (combed.time_s > begin) & (combed.time_s < end)
        way = "→" if number % 2 == 0 else "←"
        panel.plot(x[window], force[window], lw=1, label=f"{way} {comb.STROKES[number][0]:g} m/s")
    for groove in range(-2, 4):
        panel.axvline(groove * spacing, color="grey", lw=0.6, label="grooves" if groove == 0 else None)
    panel.set_xlim(-2.5 * spacing, 3.5 * spacing)
    press = comb.STROKES[THERE_AND_BACK[0]][1]
    low, high = panel.get_ylim()
    panel.set_ylim(low, high + 0.6 * (high - low))  # room for the legend
    _dress(panel, f"comb, {spacing:g} mm, pressed with {press:g} N", "mm along the comb", "N", "upper right")


def _strikes(panel: Axes, combing: Combing, material: Material) -> None:
    grooves = material.texture
    assert isinstance(grooves, Grooves)
    presses = sorted({press for _, press, _ in comb.STROKES})
    nearest = np.array([min(presses, key=lambda press: abs(press - force)) for force in combing.force_n.tolist()])
    ends = np.array([0, 1.05 * abs(combing.speed_m_per_s).max()])
    for press in presses:
        here = (nearest == press) & combing.unscaled
        if not here.any():
            continue
        amplitude = abs(combing.strikes.amplitude[here])
        (dots,) = panel.plot(abs(combing.speed_m_per_s[here]), amplitude, "o", ms=3, label=f"{press:g} N")
        law = grooves.velocity_gain_per_s * ends + grooves.force_gain_m_per_s2_per_n * combing.force_n[here].mean()
        panel.plot(ends, law, lw=0.8, color=dots.get_color())
    panel.set_ylim(0, None)
    _dress(panel, "comb over the estimated speed; lines: library", "m/s", "m/s²")


def _spectrum(panel: Axes, spectrum: Floats, material: Material, rate_hz: float) -> None:
    from hapticd.rendering.filter_design import power_spectrum, stochastic_filter

    law = material.texture
    assert isinstance(law, Stochastic)
    frequency = np.linspace(0.0, rate_hz / 2, len(spectrum))
    fine = np.linspace(0, 1000, 1001)
    asked = power_spectrum(stochastic_filter(law.peak_hz, law.mean_hz, rate_hz), fine, rate_hz)
    # At 0 a one-sided spectrum is half of its neighbouring value.
    shown = (frequency > 0) & (frequency <= fine[-1])
    # Scale the law to the power of the measured spectrum up to the last frequency.
    asked *= spectrum[shown].sum() * frequency[1] / np.trapezoid(asked, fine)
    panel.plot(frequency[shown], 1e3 * spectrum[shown], ".-", ms=4, lw=0.6, label="rendered")
    panel.plot(fine, 1e3 * asked, lw=1, label="library")
    panel.axvline(law.peak_hz, color="grey", lw=0.6, label="peak")
    panel.axvline(law.mean_hz, color="grey", lw=0.6, ls="--", label="mean")
    peak_hz, mean_hz = peak_of(frequency, spectrum, rate_hz), frequency @ spectrum / spectrum.sum()
    title = f"{sandpaper.MATERIAL}: peak {peak_hz:.0f} Hz, mean {mean_hz:.0f} Hz"
    _dress(panel, title, "Hz", "power over the law's, 1/kHz")
