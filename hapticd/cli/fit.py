"""`hapticd fit`: materials from recordings."""

from __future__ import annotations

import datetime
import math
import os
import sys
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias, TypeVar

import click

from hapticd.base.errors import HapticdError
from hapticd.cli.common import (
    Choice,
    Finite,
    check_new,
    json_option,
    note,
    overwrite_option,
    print_json,
    write_whole,
    yaml_text,
)
from hapticd.cli.synthesize import synthesize_command

if TYPE_CHECKING:
    from hapticd.config.materials import Material
    from hapticd.config.modes import Attack
    from hapticd.fit.exclusions import Exclusions
    from hapticd.fit.provenance import Fit, Kind
    from hapticd.fit.recording import Recording
    from hapticd.fit.tap_kind import TapKind
    from hapticd.fit.taps.amplitude import LawKind

_F = TypeVar("_F", bound=Callable[..., Any])
AS_WAVEFORM: Final = "the taps are pulses and do not ring: the material has a waveform; --as mode fits a mode"
STIFFNESS_N_PER_M: Final = 800.0
"""As most of the library's."""


@dataclass(frozen=True, slots=True)
class _Fitted:
    """A fit, and what of it goes into the material."""

    fit: Fit
    figures: Mapping[str, object]
    notes: tuple[str, ...] = ()
    """What a person may want to do about it."""
    without: Collection[str] = ()
    """Figures that say nothing of the material, as it is taken."""


_Step: TypeAlias = "Callable[[str], None]"
_Fitting: TypeAlias = "Callable[[Sequence[Recording], _Step, Exclusions], _Fitted]"


@click.group("fit", no_args_is_help=False, short_help="Make a material from recordings.")
def fit_command() -> None:
    """Make a material from recordings of a stylus: acceleration, force and position, as CSV, npz or WAV.

    Beside each FILE stands FILE.yaml, which names columns, units and rate.
    """


fit_command.add_command(synthesize_command)


def _options(command: _F) -> _F:
    for option in (
        json_option,
        overwrite_option,
        click.option("--strict", is_flag=True, help="Refuse what would be left out: a bad file, a clipped tap."),
        click.option("--merge", is_flag=True, help="Add to what the output holds, instead of replacing it."),
        click.option(
            "--stiffness",
            "stiffness_n_per_m",
            type=Finite(min=0, max=1e5),
            metavar="N/M",
            help=f"Stiffness of the material where the recordings do not tell it [default: {STIFFNESS_N_PER_M:g}].",
        ),
        click.option(
            "--report", type=click.Path(), metavar="FILE.html|.png", help="Draw recording and model (needs matplotlib)."
        ),
        click.option("--name", metavar="NAME", help="Name of the material [default: the output's, without .yaml]."),
        click.option("-o", "--output", type=click.Path(), metavar="FILE", help="Write the material there, as YAML."),
        click.argument("files", nargs=-1, required=True, type=click.Path(), metavar="FILES..."),
    ):
        command = option(command)
    return command


@fit_command.command("tap", short_help="Slope, frequency and decay of a tap.")
@_options
@click.option(
    "--attack",
    type=Choice(["coefficient", "first_peak"]),
    help="What the slope in the material means [default: coefficient].",
)
@click.option(
    "--law",
    type=Choice(["line", "power", "table"]),
    help="How the amplitude of the material follows the speed [default: as the taps have it, by AICc].",
)
@click.option("--table", is_flag=True, help="The same as --law table: amplitudes over speed, instead of a slope.")
@click.option(
    "--two-modes/--one-mode",
    default=None,
    help="Two modes in the material, or one [default: two where one explains too little].",
)
@click.option(
    "--as",
    "form",
    type=Choice(["auto", "mode", "waveform"]),
    help="A mode that rings, a waveform of a pulse, or what says more of the taps [default: auto].",
)
@click.option(
    "--mode-table/--no-mode-table",
    default=None,
    help="Frequency and decay over the speed, or one of each [default: as the taps have it].",
)
def tap_command(
    attack: Attack | None,
    law: LawKind | None,
    table: bool,
    two_modes: bool | None,
    form: TapKind | None,
    mode_table: bool | None,
    **options: Any,
) -> None:
    """Slope, frequency and decay of a tap, or its waveform, from recordings of taps and their speeds."""
    if table and law not in (None, "table"):
        raise click.UsageError(f"--table and --law {law} do not go together: leave out one")
    taken: LawKind | None = "table" if table else law
    of_modes = {
        "--table": table,
        "--law": law is not None,
        "--two-modes": two_modes is True,
        "--one-mode": two_modes is False,
        "--mode-table": mode_table is True,
        "--no-mode-table": mode_table is False,
        "--attack": attack is not None,
    }
    given_modes = [option for option, given in of_modes.items() if given]
    if form == "waveform" and given_modes:
        raise click.UsageError(f"{given_modes[0]} is of modes, and --as waveform makes none: leave out one")
    as_form: TapKind = form if form is not None else "mode" if given_modes else "auto"
    bent = taken not in (None, "line")
    for option, given in (("--table" if table else f"--law {law}", bent), ("--two-modes", two_modes)):
        if given and attack == "first_peak":
            raise click.UsageError(
                f"{option} and --attack do not go together: leave out one, {option} is of coefficients"
            )

    def fit(recordings: Sequence[Recording], step: _Step, excluded: Exclusions) -> _Fitted:
        from hapticd.fit.provenance import estimates
        from hapticd.fit.tap_kind import fit_taps
        from hapticd.fit.waveform import WaveformFit

        found = fit_taps(recordings, as_form, lambda recording: step(f"fitting {recording.name}"), excluded)
        if isinstance(found, WaveformFit):
            told = () if as_form == "waveform" else (AS_WAVEFORM,)
            return _Fitted(found, found.material(), told, ("first_peak_slope_per_s",) if found.amplitudes else ())
        notes = []
        kind = taken or found.law.kind
        if kind == "power" and found.law.power is not None:
            notes.append(
                f"the power law is written as {len(found.law.power.points)} amplitudes over speed, which are within "
                f"{100 * found.law.power.off:.2g} % of it from {found.law.power.points[0][0]:.3g} to "
                f"{found.law.power.points[-1][0]:.3g} m/s"
            )
        two = two_modes if two_modes is not None else found.second is not None and found.second.kept
        if found.second is not None and not two:
            notes.append("--two-modes takes both modes into the material")
        # Intervals of what the material does not have would mislead.
        said = set(estimates(found))
        second = {name for name in said if name.startswith("second.")}
        without = said - second if two else second
        if kind != "line":
            without |= {name for name in said if "slope" in name or "offset" in name}
        if kind != "power":
            without |= {name for name in said if name.startswith("power.")}
        figures = found.material(attack or "coefficient", taken, two, mode_table)
        tap = figures["tap"]
        if isinstance(tap, dict) and "mode_table" in tap:
            without |= {"frequency_hz", "decay_time_s", "second.first_frequency_hz", "second.first_decay_time_s"}
        return _Fitted(found, figures, tuple(notes), without)

    _run("tap", fit, per_file=2, **options)


@fit_command.command("grooves")
@_options
def grooves_command(**options: Any) -> None:
    """Spacing, mode and gains of grooves, from strokes over them."""

    def fit(recordings: Sequence[Recording], step: _Step, excluded: Exclusions) -> _Fitted:
        from hapticd.fit.grooves import fit_grooves

        step("fitting")
        found = fit_grooves(recordings, excluded=excluded)
        return _Fitted(found, found.material())

    _run("grooves", fit, **options)


@fit_command.command("texture")
@_options
@click.option("--ar", "autoregressive", is_flag=True, help="Autoregressive models over speed and force.")
def texture_command(autoregressive: bool, **options: Any) -> None:
    """Spectrum and loudness of a texture, from strokes over it."""

    def fit(recordings: Sequence[Recording], step: _Step, excluded: Exclusions) -> _Fitted:
        from hapticd.fit.texture import fit_texture

        step("fitting")
        found = fit_texture(recordings, autoregressive=autoregressive, excluded=excluded)
        return _Fitted(found, found.material())

    _run("texture", fit, **options)


@fit_command.command("puncture", short_help="Stiffness, rupture and mode of a membrane.")
@_options
def puncture_command(**options: Any) -> None:
    """Stiffness, rupture and mode of a membrane, from recordings of punctures."""

    def fit(recordings: Sequence[Recording], step: _Step, excluded: Exclusions) -> _Fitted:
        from hapticd.fit.puncture import fit_puncture

        step("fitting")
        found = fit_puncture(recordings, excluded=excluded)
        return _Fitted(found, found.material())

    _run("puncture", fit, **options)


def _run(
    kind: Kind,
    fit: _Fitting,
    files: tuple[str, ...],
    output: str | None,
    name: str | None,
    report: str | None,
    stiffness_n_per_m: float | None,
    overwrite: bool,
    merge: bool,
    strict: bool,
    as_json: bool,
    per_file: int = 1,
) -> None:
    from hapticd.analysis.statistics import require_scipy
    from hapticd.fit import provenance
    from hapticd.fit import report as drawing

    require_scipy()
    if merge and output is None:
        raise click.UsageError("--merge adds to the file of -o, which is missing")
    name = name if name is not None else kind if output is None else Path(output).stem
    _check(files, output, name, report, overwrite, merge)
    if report is not None:
        drawing.require(report)
    library = _library(output) if merge and output is not None and os.path.exists(output) else {}
    onto = library.get(name)

    recordings, unused, fitted = _fit(files, fit, per_file, strict)
    notes = list(fitted.notes)
    given = stiffness_n_per_m
    if given is None:
        given = STIFFNESS_N_PER_M if onto is None else onto.stiffness_n_per_m
        if "stiffness_n_per_m" not in fitted.figures and onto is None:
            notes.append(f"the stiffness, {given:g} N/m, is not in the recordings; --stiffness sets it")
    if onto is not None:
        before = onto.to_dict()
        notes += [f"{key} of {name} in {output} is replaced" for key in fitted.figures if key in before]
    material = provenance.material(
        fitted.fit,
        fitted.figures,
        recordings,
        name,
        given,
        datetime.date.today(),
        kind=kind,
        onto=onto,
        without=fitted.without,
    )
    picture = None
    if report is not None:
        from hapticd.fit.panels import page_of

        picture = drawing.drawn(report, page_of(kind, f"{name}: {kind}", fitted.fit, recordings, unused))

    fresh = {"materials": {name: material.to_dict()}}
    if output is not None:
        whole = {**library, name: material}
        write_whole(
            output,
            yaml_text({"materials": {key: each.to_dict() for key, each in whole.items()}}) + "\n",
            overwrite or merge,
        )
    if report is not None and picture is not None:
        write_whole(report, picture, overwrite)
    if as_json:
        print_json({"kind": kind, "fit": _finite(fitted.fit.to_dict()), "notes": notes, **fresh})
        return
    # The material is what is read on, where it goes to no file: then the table is beside it.
    _tell(kind, fitted.fit, beside=output is None)
    for line in notes:
        note(line)
    if output is None:
        click.echo(yaml_text(fresh))


def _check(
    files: Sequence[str], output: str | None, name: str, report: str | None, overwrite: bool, merge: bool
) -> None:
    """What can be refused before anything is read."""
    from hapticd.config.materials import MAX_PROVENANCE_FILES, validate_materials

    validate_materials({name: {"stiffness_n_per_m": STIFFNESS_N_PER_M}})
    if len(files) > MAX_PROVENANCE_FILES:
        raise HapticdError(f"{len(files)} recordings are too many: {MAX_PROVENANCE_FILES} are the most of one material")
    taken = {}
    for file in files:
        taken[os.path.realpath(file)] = file
    for target in (output, report):
        if target is None:
            continue
        if os.path.realpath(target) in taken:
            raise HapticdError(f"{target}: is one of the recordings; give another name")
        check_new(target, overwrite or (merge and target == output))
    if output is not None and report is not None and os.path.realpath(output) == os.path.realpath(report):
        raise HapticdError(f"{output}: cannot be both the material and the report; give another name")


def _library(path: str) -> dict[str, Material]:
    """The materials of a file that is added to. Raises InvalidError, or HapticdError where it holds more than these."""
    from hapticd.base.yaml_source import load_path, one_line
    from hapticd.config.configuration import load_config

    data = load_path(path).data
    if not isinstance(data, dict) or list(data) != ["materials"]:
        raise HapticdError(f"{one_line(path)}: holds something else than materials, and is not added to")
    found = load_config(path).materials
    given = data["materials"]
    assert isinstance(given, dict)
    return {name: found[name] for name in given}


def _fit(
    files: Sequence[str], fit: _Fitting, per_file: int, strict: bool
) -> tuple[list[Recording], list[Recording], _Fitted]:
    """The recordings that were used, those that were left out, and what was made of them."""
    from hapticd.fit.exclusions import Exclusions
    from hapticd.fit.recording import NoRecordingError, RecordingError, load

    excluded = Exclusions(strict)
    with _progress(len(files) * per_file + (per_file == 1)) as step:
        recordings: list[Recording] = []
        for file in files:
            step(f"reading {Path(file).name}")
            try:
                recordings.append(load(file))
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


@contextmanager
def _progress(steps: int) -> Iterator[_Step]:
    """What is being done, over the files and the fit, in one line on a terminal."""
    if not sys.stderr.isatty():
        yield lambda text: None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=steps)
        begun = False

        def show(text: str) -> None:
            nonlocal begun
            bar.update(task, description=text, advance=1 if begun else 0)
            begun = True

        yield show


def _tell(kind: Kind, found: Fit, beside: bool) -> None:
    from rich.console import Console
    from rich.table import Table

    from hapticd.fit.provenance import estimates, plain_figures
    from hapticd.fit.report import figure_rows

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for head in (kind, "value", "95 % interval", "unit"):
        table.add_column(head, justify="left" if head in (kind, "unit") else "right", no_wrap=True)
    for row in figure_rows(estimates(found), plain_figures(found)):
        table.add_row(*row)
    Console(soft_wrap=True, stderr=beside).print(table)
    click.echo(found.verdict, err=beside)
    for warning in found.warnings:
        note(warning)


def _finite(value: object) -> object:
    """JSON has no number for what is none: null."""
    if isinstance(value, Mapping):
        return {str(key): _finite(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(inner) for inner in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
