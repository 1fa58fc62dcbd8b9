"""Check whether the device, the rate and the grip of a configuration can display its scene, before anything moves.

The scene is compiled as in the daemon, but nothing is sent to a device. The report descriptor of a connected HID
joystick and the interval of its endpoint are read from sysfs, without access to the joystick.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Final, NamedTuple

from hapticd.base.errors import HapticdError, InvalidError, Problem, path_text
from hapticd.base.lattice import reflection_of
from hapticd.config.configuration import Config
from hapticd.config.materials import Material
from hapticd.config.scene import Disc, Scene
from hapticd.config.texture import Autoregressive, Stochastic
from hapticd.config.waveform import Waveform
from hapticd.hid.discovery import choose, find
from hapticd.hid.link import Link, link_of
from hapticd.hid.plan import UndrivableError
from hapticd.hid.sources import read_replay
from hapticd.rendering.compiler.table import Compiler
from hapticd.rendering.device_output import UNKNOWN_HANDLE, Output, loop_of, output_of
from hapticd.rendering.displayability import (
    NO_SURFACE,
    displayed_mode,
    displayed_pair,
    displayed_wave_rate,
    materials_in,
    modes_of,
    preload_notes,
    rate_faults,
    strike_error,
    undisplayable,
    warnings,
    waveform_of,
)
from hapticd.rendering.displayed_error import waveform_error
from hapticd.rendering.driven_hand import driven_hand_warnings
from hapticd.rendering.filter_design import peak_of
from hapticd.rendering.lagging_modes import lag_warnings
from hapticd.rendering.placement import NO_FORCE, Reach, placement_warnings
from hapticd.rendering.resampling import resampled
from hapticd.rendering.scene_stability import Stability, evaluate
from hapticd.rendering.stability import Loop
from hapticd.rendering.undisplayable_text import Use

NOTED_TAP_SPEED_M_PER_S: Final = 0.1
"""Approach speed for which the report gives the depth that a compensated tap needs."""
_STEP_UNKNOWN_TEXT: Final = "the encoder's step is not known"
"""Reason in a report why the stability is unknown."""
_REPLAY_TEXT: Final = "a recording does not react to forces"
"""Reason in a report why the stability of a recording is unknown."""
_SIMULATED_TEXT: Final = (
    "to compute the loop without the joystick, set device.kind: sim, device.sim.encoder_step_m and "
    "device.sim.link.rate_hz"
)
"""Remedy in a report on a joystick that is not connected."""
_LINK_UNKNOWN_TEXT: Final = (
    "not set, and the joystick is not connected: vibrations are checked at the servo's rate, but the link may carry "
    "fewer forces per second; an interval of 4 ms carries 250 reports per second, and a force takes one report per "
    "effect"
)
"""Note in a report on a joystick whose link's rate is unknown."""


@dataclass(frozen=True, slots=True)
class Vibration:
    """A vibration of a material (mode, waveform or texture), as configured and as displayed."""

    use: Use
    frequency_hz: float
    """Frequency of a mode, peak of a texture's spectrum, or the frequency that halves the energy of a waveform."""
    shown_hz: float | None
    """The frequency that is displayed; None if the vibration is silent."""
    error: float | None
    """Displayed error of the handle's acceleration, 0.1 for 10 %; None if the handle is unknown or another frequency is
    displayed."""


@dataclass(frozen=True, slots=True)
class Checked:
    """A checked material: its stiffness, its vibrations (`sounds`), and whether the scene uses the material."""

    name: str
    used: bool
    stiffness_n_per_m: float
    sounds: tuple[Vibration, ...]
    verdict: Mapping[str, str]
    """Verdict of each fit of the material, good, fair or poor, by the kind of fit; empty if it was not fitted."""


@dataclass(frozen=True, slots=True)
class Report:
    """The result of `hapticd check`."""

    output: Output
    device: str
    """Description of the device in words."""
    materials: tuple[Checked, ...]
    stability: Stability
    refused: tuple[Problem, ...]
    """Problems that keep the daemon from starting."""
    undisplayable: tuple[Problem, ...]
    warnings: tuple[Problem, ...]
    notes: tuple[Problem, ...]
    """Remarks that do not count as faults."""

    @property
    def encoder_step_m(self) -> float | None:
        """Step of the measured positions; None if unknown."""
        return None if self.stability.assumed is None else self.stability.assumed.encoder_step_m

    @property
    def faults(self) -> int:
        """Number of problems. Stability that is unknown or only unproved does not count."""
        return len(self.refused) + len(self.undisplayable) + len(self.warnings) + len(self.stability.harmful)

    def to_dict(self) -> dict[str, object]:
        """Return the report as a mapping for JSON."""
        lists = ("refused", "undisplayable", "warnings", "notes", "materials")
        return {
            "can_be_shown": self.faults == 0,
            "device": self.device,
            "rate_hz": self.output.rate_hz,
            "link_hz": self.output.link_rate_hz,
            "rearm_m": self.output.rearm_m,
            "encoder_step_m": self.encoder_step_m,
            **{name: [asdict(each) for each in getattr(self, name)] for name in lists},
            "stability": self.stability.to_dict(),
        }


def check(config: Config, *, offline: bool = True) -> Report:
    """Check whether device, rate and grip can display the scene of a configuration; return the report.

    A joystick that is not connected is a problem unless `offline`.
    """
    scene, materials = config.scene, config.materials
    device = _device(config, offline)
    output = output_of(config, config.servo.rate_hz, device.link_hz)
    shown = materials_in(scene.objects, materials)
    refused = rate_faults(scene.objects, materials, output)
    found_warnings: list[Problem] = []
    if not refused:
        # A vibration that the actuator attenuates is reported once, as a problem of the actuator.
        found_warnings += lag_warnings(shown, output)
        slowed = {problem.where for problem in found_warnings}
        others = [*warnings(scene.objects, materials, output)]
        others += [] if device.loop is None else driven_hand_warnings(config, device.loop, shown)
        found_warnings += [problem for problem in others if problem.where not in slowed]
        found_warnings += placement_warnings(scene, materials, Reach.of(config))
    unknown = Stability(device.unknown, None)
    return Report(
        output=output,
        device=device.words,
        materials=tuple(_checked(name, material, name in shown, output) for name, material in materials.items()),
        stability=unknown if device.loop is None else _stability(config, output, device.loop),
        refused=(*device.undrivable, *refused),
        undisplayable=tuple(Problem(f"materials.{mode.material}", str(mode)) for mode in undisplayable(shown, output)),
        warnings=tuple(found_warnings),
        notes=(
            *device.notes,
            *_hidden_parts(scene),
            *_weak_discs(config),
            *_imperfect_fits(shown),
            *preload_notes(shown, output, NOTED_TAP_SPEED_M_PER_S),
        ),
    )


def _hidden_parts(scene: Scene) -> Iterator[Problem]:
    """Yield a note for each kind of force that the scene does not display."""
    if not scene.display.force:
        yield NO_FORCE
    if not scene.display.vibration:
        yield Problem("scene.display.vibration", "false: taps and textures do not vibrate")


def _weak_discs(config: Config) -> Iterator[Problem]:
    """Yield a note for each disc whose largest force, stiffness times radius at its centre, is below max_force_n."""
    limit_n = config.device.max_force_n
    for id, item in config.scene.objects.items():
        if not isinstance(item, Disc):
            continue
        stiffness = config.materials[item.material].stiffness_n_per_m
        held_n = stiffness * item.radius_m
        if held_n < limit_n * (1.0 - 1e-9):
            yield Problem(
                path_text(("scene", "objects", id)),
                f"holds {held_n:.3g} N, stiffness times radius; a hand that presses harder passes through the disc; "
                f"with radius_m {limit_n / stiffness:.3g} or {limit_n / item.radius_m:.4g} N/m the disc "
                f"holds device.max_force_n, {limit_n:g} N",
            )


def _imperfect_fits(shown: Mapping[str, Material]) -> Iterator[Problem]:
    """Yield a note, with the reasons, for each fit of the scene's materials whose verdict is not good."""
    for name, material in shown.items():
        for kind, verdict in material.fitted.items():
            if verdict.quality != "good":
                where = path_text(("materials", name, "provenance", "verdict", kind))
                yield Problem(where, f"the fit is {verdict.quality}: {'; '.join(verdict.reasons) or 'no reason given'}")


def _stability(config: Config, output: Output, loop: Loop) -> Stability:
    compiler = Compiler(output)
    # Textures do not affect stability, and one that is refused cannot be compiled.
    silent = {
        name: material.model_copy(update={"texture": None}) if isinstance(material.texture, Stochastic) else material
        for name, material in config.materials.items()
    }
    compiler.update(config.scene, config.scene.objects, silent, 1)
    return evaluate(compiler, config.scene, loop, unsafe=False)


class _Device(NamedTuple):
    """The device of a configuration."""

    words: str
    unknown: str | None = None
    """The reason why the stability is unknown; None if `loop` is set."""
    loop: Loop | None = None
    link_hz: float | None = None
    """Forces per second that the link carries; None if unknown."""
    undrivable: tuple[Problem, ...] = ()
    """Problems of a connected device that keep the daemon from starting."""
    notes: tuple[Problem, ...] = ()
    """Assumptions about the device, for the report."""


def _other_handle(config: Config) -> tuple[Problem, ...]:
    """Return a note if the report is for another handle than that of the simulated joystick."""
    handle, sim = config.device.handle, config.device.sim
    if handle is None or handle == sim.handle:
        return ()
    given, moved = (
        f"{each.mass_kg:g} kg, {each.damping_n_s_per_m:g} N s/m and {each.friction_n:g} N"
        for each in (handle, sim.handle)
    )
    problem = f"{given}: this report is for this handle, and the simulated joystick moves another one, of {moved}"
    return (Problem("device.handle", f"{problem} (device.sim)"),)


def _device(config: Config, offline: bool) -> _Device:
    device, rate_hz = config.device, config.servo.rate_hz
    if device.kind == "sim":
        return _Device("the simulated joystick", loop=loop_of(config, rate_hz), notes=_other_handle(config))
    if device.kind == "replay":
        assert device.replay is not None
        try:
            read_replay(device.replay, device.hid)
        except InvalidError as error:
            return _Device("a recording, which cannot be read", _REPLAY_TEXT, undrivable=tuple(error.problems))
        return _Device("a recording, which forces do not move", _REPLAY_TEXT)
    hid = device.hid
    handle = "" if device.handle is not None else "; device.handle is not set"
    away = _Device(
        "",
        UNKNOWN_HANDLE if handle else _STEP_UNKNOWN_TEXT,
        None,
        Link(None, None, hid.max_rate_hz).carried_hz(rate_hz),
    )
    try:
        found = choose(hid, find())
    except UndrivableError as error:
        return away._replace(words=f"{error}{handle}", undrivable=(Problem("device.hid", str(error)),))
    except HapticdError as error:
        notes = () if hid.max_rate_hz is not None else (Problem("device.hid.max_rate_hz", _LINK_UNKNOWN_TEXT),)
        absent = () if offline else (Problem("device.hid", f"{error}; to check without it: hapticd check --offline"),)
        return away._replace(
            words=f"not connected: {error}{handle}",
            unknown=f"{away.unknown}; {_SIMULATED_TEXT}",
            undrivable=absent,
            notes=notes,
        )
    name = f"{found.name} at {found.path}{handle}"
    try:
        _, plan = found.verdict.driver_and_plan()
    except HapticdError as error:
        problem = Problem("device.hid", f"{found}: {error}")
        return away._replace(words=f"{name}: {error}", unknown=_STEP_UNKNOWN_TEXT, undrivable=(problem,))
    link_hz = link_of(plan, found.out_interval_s).carried_hz(rate_hz)
    loop = loop_of(
        config,
        rate_hz,
        resolution_m=plan.resolution_m,
        force_step_n=max(plan.force_steps_n),
        link_rate_hz=link_hz,
    )
    return _Device(name, None if loop is not None else UNKNOWN_HANDLE, loop, link_hz)


def _checked(name: str, material: Material, used: bool, output: Output) -> Checked:
    fits = {kind: verdict.quality for kind, verdict in material.fitted.items()}
    return Checked(name, used, material.stiffness_n_per_m, tuple(_vibrations(material, output)), fits)


def _vibrations(material: Material, output: Output) -> Iterator[Vibration]:
    waveform, texture = waveform_of(material), material.texture
    if waveform is not None:
        yield _waveform_vibration(waveform, output)
    for use, mode in modes_of(material):
        shown, _ = displayed_mode(mode, output)
        shown_hz = None if shown is None else shown.frequency_hz
        yield Vibration(use, mode.frequency_hz, shown_hz, strike_error(mode, output))
    if isinstance(texture, Stochastic):
        pair = displayed_pair(texture, output)
        yield Vibration("texture", texture.peak_hz, None if pair is None else pair[0], None)
    elif isinstance(texture, Autoregressive):
        # The peak of the loudest model; at a rate too low for it, that of the resampled model.
        loudest = max(texture.models, key=lambda model: model.level(reflection_of(model.coefficients)))
        reflection = reflection_of(loudest.coefficients)
        peak_hz = shown_hz = peak_of(reflection, texture.rate_hz)
        if peak_hz >= output.rate_hz / 2:
            shown_hz = peak_of(resampled(reflection, texture.rate_hz, output.rate_hz).reflection, output.rate_hz)
        yield Vibration("texture", peak_hz, shown_hz, None)


def _waveform_vibration(waveform: Waveform, output: Output) -> Vibration:
    middle_hz, rate_hz = waveform.curve.middle_hz, displayed_wave_rate(waveform, output)
    if rate_hz is None:
        return Vibration("tap", middle_hz, None, None)
    error = None
    if rate_hz == waveform.rate_hz and output.dynamics is not None and output.actuator is None:
        load = NO_SURFACE.load(output).free
        error = waveform_error(waveform, output.dynamics, output.carried_hz, output.effective_mass_kg, load)
    return Vibration("tap", middle_hz, middle_hz * rate_hz / waveform.rate_hz, error)
