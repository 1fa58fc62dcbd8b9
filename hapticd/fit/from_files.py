"""A fit of files, and what of it goes into a material: what `hapticd fit` does."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeAlias

from hapticd.base.errors import HapticdError
from hapticd.base.yaml_source import load_path, one_line
from hapticd.config.configuration import load_config
from hapticd.config.materials import Material
from hapticd.config.modes import Attack
from hapticd.fit.exclusions import Exclusions
from hapticd.fit.provenance import Fit, estimates
from hapticd.fit.recording import NoRecordingError, Recording, RecordingError, load
from hapticd.fit.tap import TapFit
from hapticd.fit.tap_kind import TapKind, fit_taps
from hapticd.fit.taps.amplitude import LawKind
from hapticd.fit.waveform import WaveformFit

AS_WAVEFORM: Final = "the taps are pulses and do not ring: the material has a waveform; --as mode fits a mode"
Step: TypeAlias = Callable[[str], None]
"""Called with what is being done."""


@dataclass(frozen=True, slots=True)
class Fitted:
    """A fit, and what of it goes into the material."""

    fit: Fit
    figures: Mapping[str, object]
    notes: tuple[str, ...] = ()
    """What a person may want to do about it."""
    without: Collection[str] = ()
    """Figures that say nothing of the material, as it is taken."""


Fitting: TypeAlias = Callable[[Sequence[Recording], Step, Exclusions], Fitted]


def of_one_kind(fit: Callable[..., Fit]) -> Fitting:
    """A fit whose every figure goes into the material."""

    def fitted(recordings: Sequence[Recording], step: Step, excluded: Exclusions) -> Fitted:
        step("fitting")
        found = fit(recordings, excluded=excluded)
        return Fitted(found, found.material())

    return fitted


def of_taps(
    form: TapKind, attack: Attack | None, law: LawKind | None, two_modes: bool | None, mode_table: bool | None
) -> Fitting:
    """A fit of taps, of which the material has what is asked for; None: as the taps have it."""

    def fitted(recordings: Sequence[Recording], step: Step, excluded: Exclusions) -> Fitted:
        found = fit_taps(recordings, form, lambda recording: step(f"fitting {recording.name}"), excluded)
        if isinstance(found, WaveformFit):
            told = () if form == "waveform" else (AS_WAVEFORM,)
            return Fitted(found, found.material(), told, ("first_peak_slope_per_s",) if found.amplitudes else ())
        kind = law or found.law.kind
        two = two_modes if two_modes is not None else found.second is not None and found.second.kept
        figures = found.material(attack or "coefficient", law, two, mode_table)
        return Fitted(found, figures, _notes(found, kind, two), _without(found, kind, two, figures))

    return fitted


def _notes(found: TapFit, kind: LawKind, two: bool) -> tuple[str, ...]:
    notes = []
    if kind == "power" and found.law.power is not None:
        notes.append(
            f"the power law is written as {len(found.law.power.points)} amplitudes over speed, which are within "
            f"{100 * found.law.power.off:.2g} % of it from {found.law.power.points[0][0]:.3g} to "
            f"{found.law.power.points[-1][0]:.3g} m/s"
        )
    if found.second is not None and not two:
        notes.append("--two-modes takes both modes into the material")
    return tuple(notes)


def _without(found: TapFit, kind: LawKind, two: bool, figures: Mapping[str, object]) -> set[str]:
    """Intervals of what the material does not have would mislead."""
    said = set(estimates(found))
    second = {name for name in said if name.startswith("second.")}
    without = said - second if two else second
    if kind != "line":
        without |= {name for name in said if "slope" in name or "offset" in name}
    if kind != "power":
        without |= {name for name in said if name.startswith("power.")}
    tap = figures["tap"]
    if isinstance(tap, dict) and "mode_table" in tap:
        without |= {"frequency_hz", "decay_time_s", "second.first_frequency_hz", "second.first_decay_time_s"}
    return without


def fitted_files(
    files: Sequence[str], fit: Fitting, step: Step, strict: bool, folder: str = ""
) -> tuple[list[Recording], list[Recording], Fitted]:
    """The recordings that were used, those that were left out, and what was made of them. Files are known by their
    names in the folder."""
    excluded = Exclusions(strict)
    recordings: list[Recording] = []
    for file in files:
        step(f"reading {Path(file).name}")
        try:
            recordings.append(load(os.path.join(folder, file), file))
        except RecordingError as error:
            if len(files) == 1 or isinstance(error, NoRecordingError):
                raise
            excluded.add(error.name, error.reason)
    if not recordings:
        raise excluded.refused(f"none of {len(files)} recordings can be read")
    # What comes of a division by zero and the like is no number, and no material takes one.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        fitted = fit(recordings, step, excluded)
    used: list[Recording] = []
    unused: list[Recording] = []
    for recording in recordings:
        (unused if recording.name in excluded.recordings else used).append(recording)
    return used, unused, fitted


def materials_of(path: str) -> dict[str, Material]:
    """The materials of a file that is added to. Raises InvalidError, or HapticdError where it holds more than these."""
    data = load_path(path).data
    if not isinstance(data, dict) or list(data) != ["materials"]:
        raise HapticdError(f"{one_line(path)}: holds something else than materials, and is not added to")
    found = load_config(path).materials
    given = data["materials"]
    assert isinstance(given, dict)
    return {name: found[name] for name in given}
