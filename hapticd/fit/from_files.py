"""Fits of recording files, and the resulting keys of a material: the core of `hapticd fit`."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np

from hapticd.analysis.statistics import FitError, UnitError, require_scipy
from hapticd.base.errors import HapticdError
from hapticd.base.yaml_source import load_path, printable
from hapticd.config.configuration import load_config
from hapticd.config.materials import Material
from hapticd.config.waveform import MAX_WAVEFORM_LENGTH_S
from hapticd.fit.limits import TAP_LIMITS, WAVEFORM_LIMITS
from hapticd.fit.options import FitOptions, TapKind
from hapticd.fit.preparation import refuse_duplicates
from hapticd.fit.recording import FatalRecordingError, Kind, Recording, RecordingError, load
from hapticd.fit.result import Fit, estimates
from hapticd.fit.speed_law import LawKind
from hapticd.fit.tap import TapFit, fit_tap
from hapticd.fit.verdict import LOWER_LIMITS, Exclusions
from hapticd.fit.waveform import WaveformFit, fit_waveform, pulses_of, ring_on

AS_WAVEFORM: Final = (
    "a waveform explains the taps better than a mode: the material gets a waveform; --as mode fits a mode"
)
"""Note for the user if a waveform was chosen automatically."""
Step: TypeAlias = Callable[[str], None]
"""Callback with a text about the current step."""


@dataclass(frozen=True, slots=True)
class Fitted:
    """A fit, and the keys of a material that the fit determines."""

    fit: Fit
    figures: Mapping[str, object]
    notes: tuple[str, ...] = ()
    """Suggestions for the user."""
    without: Collection[str] = ()
    """Names of fitted values that the material does not use with the chosen options."""


def fitted_files(
    files: Sequence[str], kind: Kind, options: FitOptions, step: Step, strict: bool, folder: str = ""
) -> tuple[list[Recording], list[Recording], Fitted]:
    """Fit recording files; return the recordings that were used, those that were left out, and the fit.

    `files` are paths relative to `folder`, and become the names of the recordings.
    """
    excluded = Exclusions(strict)
    recordings: list[Recording] = []
    for file in files:
        step(f"reading {Path(file).name}")
        try:
            recordings.append(load(os.path.join(folder, file), file))
        except RecordingError as error:
            if len(files) == 1 or isinstance(error, FatalRecordingError):
                raise
            excluded.add(error.name, error.reason)
    if not recordings:
        raise excluded.refused(f"none of {len(files)} recordings can be read")
    # A division by zero gives NaN, which no material accepts: no need to warn.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        try:
            fitted = _fit(kind, options, recordings, step, excluded)
        except FitError as error:
            raise excluded.explained(error) from None
    used: list[Recording] = []
    unused: list[Recording] = []
    for recording in recordings:
        (unused if recording.name in excluded.recordings else used).append(recording)
    return used, unused, replace(fitted, notes=(*_notes_of(used), *fitted.notes))


def _notes_of(recordings: Sequence[Recording]) -> Iterator[str]:
    """Yield each note about the reading of recordings once, with the name of the first and the number of the others."""
    names: dict[str, list[str]] = {}
    for recording in recordings:
        for note in recording.notes:
            names.setdefault(note, []).append(recording.name)
    for note, (first, *others) in names.items():
        yield f"{first}{f' and {len(others)} more' if others else ''}: {note}"


def materials_of(path: str) -> dict[str, Material]:
    """Return the materials of an existing file, to which more will be added.

    Raises InvalidError, or HapticdError if the file has other keys than `materials`.
    """
    data = load_path(path).data
    if not isinstance(data, dict) or list(data) != ["materials"]:
        raise HapticdError(f"{printable(path)}: must have no key but materials, to which the fit adds")
    found = load_config(path).materials
    given = data["materials"]
    assert isinstance(given, dict)
    return {name: found[name] for name in given}


def _fit(kind: Kind, options: FitOptions, recordings: Sequence[Recording], step: Step, excluded: Exclusions) -> Fitted:
    found: Fit
    if kind == "tap":
        return _fitted_taps(options, recordings, step, excluded)
    step("fitting")
    if kind == "grooves":
        from hapticd.fit.grooves import fit_grooves

        found = fit_grooves(recordings, excluded=excluded)
    elif kind == "texture":
        from hapticd.fit.texture import fit_texture

        found = fit_texture(recordings, autoregressive=options.autoregressive is True, excluded=excluded)
    else:
        from hapticd.fit.puncture import fit_puncture

        found = fit_puncture(recordings, excluded=excluded)
    return Fitted(found, found.material())


# ---- Taps ------------------------------------------------------------------------------------------------------------


def _fitted_taps(options: FitOptions, recordings: Sequence[Recording], step: Step, excluded: Exclusions) -> Fitted:
    form: TapKind = options.form or ("mode" if options.of_modes else "auto")
    found = fit_taps(
        recordings,
        form,
        lambda recording: step(f"fitting {recording.name}"),
        excluded,
        options.law,
        options.mode_table,
        options.two_modes is False,
    )
    if isinstance(found, WaveformFit):
        notes = () if form == "waveform" else (AS_WAVEFORM,)
        return Fitted(found, found.material(), notes, ("first_peak_slope_per_s",) if found.amplitudes else ())
    two = options.two_modes if options.two_modes is not None else found.second is not None and found.second.kept
    figures = found.material(options.attack or "coefficient", two)
    notes_of_mode = []
    if found.power is not None:
        points = found.power.points
        notes_of_mode.append(
            f"the power law is written as {len(points)} amplitudes over speed, which are within "
            f"{100 * found.power.off:.2g} % of it from {points[0][0]:.3g} to {points[-1][0]:.3g} m/s"
        )
    if found.second is not None and not two:
        notes_of_mode.append("--two-modes takes both modes into the material")
    # Intervals of values that the material does not have would mislead.
    table = {"frequency_hz", "decay_time_s", "second.first_frequency_hz", "second.first_decay_time_s"}
    tap = figures["tap"]
    without = {
        name
        for name in estimates(found)
        if name.startswith("second.") != two
        or (not found.linear and ("slope" in name or "offset" in name))
        or (isinstance(tap, dict) and "mode_table" in tap and name in table)
    }
    return Fitted(found, figures, tuple(notes_of_mode), without)


def fit_taps(
    recordings: Sequence[Recording],
    kind: TapKind = "auto",
    progress: Callable[[Recording], None] | None = None,
    excluded: Exclusions | None = None,
    law: LawKind | None = None,
    mode_table: bool | None = None,
    one_mode: bool = False,
) -> TapFit | WaveformFit:
    """Fit the taps of one material by modes or by a waveform; the parameters from `progress` on are those of fit_tap.

    Raises FitError (one line), that of the fit by modes, if the recordings support neither fit.
    """
    require_scipy()
    refuse_duplicates(recordings)
    excluded = Exclusions() if excluded is None else excluded
    if kind == "mode":
        return fit_tap(recordings, progress, excluded, law, mode_table, one_mode)
    if kind == "waveform":
        warnings: list[str] = []
        return fit_waveform(pulses_of(recordings, warnings, excluded), warnings, excluded)
    # Exclusions of the form that is not chosen are dropped.
    of_mode, of_waveform = excluded.copy(), excluded.copy()
    ringing: TapFit | FitError
    try:
        ringing = fit_tap(recordings, progress, of_mode, law, mode_table, one_mode)
    except FitError as error:
        ringing = error
    found = _better_waveform(ringing, recordings, of_waveform)
    excluded.merge(of_mode if found is None else of_waveform)
    if found is not None:
        return found
    if isinstance(ringing, FitError):
        raise ringing
    return ringing


def _better_waveform(
    ringing: TapFit | FitError, recordings: Sequence[Recording], excluded: Exclusions
) -> WaveformFit | None:
    """Return the fit of a waveform if it explains the taps better than `ringing`, the fit by modes, else None.

    The modes are kept if they ring, that is, fall to 1/e in 0.3 of a period or later, and explain 95 % of the taps'
    variance (the median; a tap that was left out counts as 0). Otherwise the waveform is taken if its residual has less
    than half the variance of the modes' residual. The comparison favours the modes, which are fitted to each tap
    separately; the waveform that explains a tap is fitted to the other taps. Taps that ring longer than a waveform
    lasts, or past the recording's end, get no waveform if no mode can be fitted, if a mode leaves only noise, or if its
    decay time is longer than a waveform.
    """
    if isinstance(ringing, UnitError):
        return None
    warnings: list[str] = []
    try:
        pulses = pulses_of(recordings, warnings, excluded)
        if isinstance(ringing, FitError):
            if ring_on(pulses):
                return None
            found = fit_waveform(pulses, warnings, excluded)
            explains = found.variance_accounted_for >= LOWER_LIMITS["variance that a waveform explains"].poor
            resolved = found.samples_a_period >= LOWER_LIMITS["samples in a period of a waveform"].poor
            return found if explains and resolved else None
        by_mode = ringing.variance_accounted_for
        rings = ringing.decay_time_s.value * ringing.frequency_hz.value >= WAVEFORM_LIMITS.min_mode_periods
        if ringing.second is not None and rings:
            by_mode = max(by_mode, ringing.second.variance_accounted_for)
        by_mode = float(np.median([by_mode] * len(ringing.taps) + [0.0] * (len(pulses) - len(ringing.taps))))
        # Noise hides the end of a long ringing, which a waveform does not have to explain.
        noise_only = np.median([tap.residual_to_noise for tap in ringing.taps]) < TAP_LIMITS.max_residual_to_noise
        too_long = ringing.decay_time_s.value > MAX_WAVEFORM_LENGTH_S
        if rings and (by_mode >= WAVEFORM_LIMITS.min_mode_explained or (ring_on(pulses) and (noise_only or too_long))):
            return None
        found = fit_waveform(pulses, warnings, excluded)
    except FitError:
        return None
    return found if 1 - found.variance_accounted_for < WAVEFORM_LIMITS.max_residual_ratio * (1 - by_mode) else None
