"""What of a configuration its device, rate and grip can carry, found before anything moves.

The scene is compiled as the daemon would, nothing is sent to a device and no force is made. Of a HID joystick that is
connected the report descriptor and the endpoint's interval are read, which the system knows without asking it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Final, NamedTuple

from hapticd.base.errors import HapticdError, Problem, path_text
from hapticd.base.lattice import reflection_of
from hapticd.config.configuration import Config
from hapticd.config.materials import Material
from hapticd.config.scene import Disc
from hapticd.config.texture import Autoregressive, Stochastic
from hapticd.config.waveform import Waveform
from hapticd.hid.discovery import choose, find
from hapticd.hid.link import Link, link_of
from hapticd.hid.plan import UndrivableError
from hapticd.hid.replay import load
from hapticd.hid.verdict import verdict_of
from hapticd.rendering.compiler.table import Compiler
from hapticd.rendering.device_output import UNKNOWN_HANDLE, Output, loop_of, output_of
from hapticd.rendering.displayability import (
    displayed_mode,
    displayed_pair,
    displayed_wave_rate,
    materials_in,
    modes_of,
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
from hapticd.rendering.resampling import resampled
from hapticd.rendering.scene_stability import Stability, evaluate
from hapticd.rendering.stability import Loop
from hapticd.rendering.undisplayable_text import Use

_UNPLUGGED: Final = "the encoder's step is not known"
_LINK_UNKNOWN: Final = (
    "is not given, and the joystick is not connected: vibrations are judged by the servo's rate, although its link may "
    "carry fewer forces a second; an interval of 4 ms carries 250 reports a second, and a force takes a report "
    "for each effect"
)


@dataclass(frozen=True, slots=True)
class Sound:
    """A mode or a waveform of a material, or the peak of its noise, and what becomes of it."""

    use: Use
    frequency_hz: float
    """Of a waveform, the frequency below which half of its energy lies."""
    shown_hz: float | None
    """None: silent."""
    error: float | None
    """How far the handle's acceleration is from the library's waveform
    (hapticd.rendering.displayed_error.displayed_error); None where
    nobody knows the handle, or where something else sounds."""


@dataclass(frozen=True, slots=True)
class Checked:
    """A material, whether the scene uses it, and what becomes of its sounds."""

    name: str
    used: bool
    stiffness_n_per_m: float
    sounds: tuple[Sound, ...]
    verdict: Mapping[str, str]
    """good, fair or poor, by the kind of fit; empty where it was not fitted."""


@dataclass(frozen=True, slots=True)
class Report:
    """What was found."""

    output: Output
    device: str
    """What is known of it, in words."""
    materials: tuple[Checked, ...]
    stability: Stability
    refused: tuple[Problem, ...]
    """What the daemon would not start with."""
    undisplayable: tuple[Problem, ...]
    warnings: tuple[Problem, ...]
    notes: tuple[Problem, ...]
    """What may surprise, and is as it is meant."""

    @property
    def encoder_step_m(self) -> float | None:
        """Of the positions; None where it is not known."""
        return None if self.stability.assumed is None else self.stability.assumed.encoder_step_m

    @property
    def faults(self) -> int:
        """How much of the scene cannot be carried as it is meant; what is not known or not proved is not among it."""
        return len(self.refused) + len(self.undisplayable) + len(self.warnings) + len(self.stability.harmful)

    def to_dict(self) -> dict[str, object]:
        """As JSON."""
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


def check(config: Config) -> Report:
    """Checks a configuration. Raises nothing for what cannot be shown: that is what is reported."""
    scene, materials = config.scene, config.materials
    device = _device(config)
    output = output_of(config, config.servo.rate_hz, device.link_hz)
    shown = materials_in(scene.objects, materials)
    refused = rate_faults(scene.objects, materials, output)
    told: list[Problem] = []
    if not refused:
        # What the actuator is the cause of is reported once.
        told += lag_warnings(shown, output)
        slowed = {problem.where for problem in told}
        others = [*warnings(scene.objects, materials, output)]
        others += [] if device.loop is None else driven_hand_warnings(config, device.loop, shown)
        told += [problem for problem in others if problem.where not in slowed]
    unknown = Stability(device.unknown, None)
    return Report(
        output=output,
        device=device.words,
        materials=tuple(_checked(name, material, name in shown, output) for name, material in materials.items()),
        stability=unknown if device.loop is None else _stability(config, output, device.loop),
        refused=(*device.undrivable, *refused),
        undisplayable=tuple(Problem(f"materials.{mode.material}", str(mode)) for mode in undisplayable(shown, output)),
        warnings=tuple(told),
        notes=(*device.notes, *_gone_through(config), *_doubtful(shown)),
    )


def _gone_through(config: Config) -> Iterator[Problem]:
    """The discs that hold less than the device could: no more than K R, at their centre."""
    most_n = config.device.max_force_n
    for id, item in config.scene.objects.items():
        if not isinstance(item, Disc):
            continue
        stiffness = config.materials[item.material].stiffness_n_per_m
        held_n = stiffness * item.radius_m
        if held_n < most_n * (1.0 - 1e-9):
            yield Problem(
                path_text(("scene", "objects", id)),
                f"holds {held_n:.3g} N, its stiffness times its radius; a hand that presses harder comes out on the "
                f"other side; with radius_m {most_n / stiffness:.3g} or {most_n / item.radius_m:.4g} N/m it holds "
                f"device.max_force_n, {most_n:g} N",
            )


def _doubtful(shown: Mapping[str, Material]) -> Iterator[Problem]:
    """The materials of the scene whose fits are not good, and why."""
    for name, material in shown.items():
        for kind, verdict in material.fitted.items():
            if verdict.quality != "good":
                where = path_text(("materials", name, "provenance", "verdict", kind))
                yield Problem(where, f"the fit is {verdict.quality}: {'; '.join(verdict.reasons) or 'no reason given'}")


def _stability(config: Config, output: Output, loop: Loop) -> Stability:
    compiler = Compiler(output)
    # What pushes is the same whatever sounds, and a sound that is refused cannot be compiled.
    silent = {
        name: material.model_copy(update={"texture": None}) if isinstance(material.texture, Stochastic) else material
        for name, material in config.materials.items()
    }
    compiler.update(config.scene, config.scene.objects, silent, 1)
    return evaluate(compiler, config.scene, loop, unsafe=False)


class _Device(NamedTuple):
    """What a configuration drives."""

    words: str
    unknown: str | None = None
    """What is not known, where there is no loop."""
    loop: Loop | None = None
    link_hz: float | None = None
    """Forces a second that its link carries, where that is known."""
    undrivable: tuple[Problem, ...] = ()
    """Why the daemon would not start with a device that is there."""
    notes: tuple[Problem, ...] = ()
    """What is assumed of it."""


def _device(config: Config) -> _Device:
    device, rate_hz = config.device, config.servo.rate_hz
    if device.kind == "sim":
        return _Device("the simulated joystick", loop=loop_of(config, rate_hz))
    if device.kind == "replay":
        assert device.replay is not None
        try:
            verdict_of(device.hid, load(device.replay.path).descriptor).driver_and_plan()
        except HapticdError as error:
            return _Device(f"a recording: {error}", _UNPLUGGED, undrivable=(Problem("device.replay", str(error)),))
        return _Device("a recording, which nothing pushes", "a recording has no loop")
    hid = device.hid
    handle = "" if device.handle is not None else "; what its handle is, is not given"
    away = _Device(
        "", UNKNOWN_HANDLE if handle else _UNPLUGGED, None, Link(None, None, hid.max_rate_hz).carried_hz(rate_hz)
    )
    try:
        found = choose(hid, find())
    except UndrivableError as error:
        return away._replace(words=f"{error}{handle}", undrivable=(Problem("device.hid", str(error)),))
    except HapticdError as error:
        notes = () if hid.max_rate_hz is not None else (Problem("device.hid.max_rate_hz", _LINK_UNKNOWN),)
        return away._replace(words=f"not there: {error}{handle}", notes=notes)
    told = f"{found.name} at {found.path}{handle}"
    try:
        _, plan = found.verdict.driver_and_plan()
    except HapticdError as error:
        problem = Problem("device.hid", f"{found}: {error}")
        return away._replace(words=f"{told}: {error}", unknown=_UNPLUGGED, undrivable=(problem,))
    link_hz = link_of(plan, found.out_interval_s).carried_hz(rate_hz)
    loop = loop_of(
        config,
        rate_hz,
        resolution_m=plan.resolution_m,
        force_step_n=max(plan.force_steps_n),
        link_rate_hz=link_hz,
    )
    return _Device(told, None if loop is not None else UNKNOWN_HANDLE, loop, link_hz)


def _checked(name: str, material: Material, used: bool, output: Output) -> Checked:
    fits = {kind: verdict.quality for kind, verdict in material.fitted.items()}
    return Checked(name, used, material.stiffness_n_per_m, tuple(_sounds(material, output)), fits)


def _sounds(material: Material, output: Output) -> Iterator[Sound]:
    waveform, texture = waveform_of(material), material.texture
    if waveform is not None:
        yield _waveform_sound(waveform, output)
    for use, mode in modes_of(material):
        shown, _ = displayed_mode(mode, output)
        yield Sound(use, mode.frequency_hz, None if shown is None else shown.frequency_hz, strike_error(mode, output))
    if isinstance(texture, Stochastic):
        pair = displayed_pair(texture, output)
        yield Sound("texture", texture.peak_hz, None if pair is None else pair[0], None)
    elif isinstance(texture, Autoregressive):
        # Of the loudest model the peak; at a rate that does not reach it, the peak of what is shown instead.
        loudest = max(texture.models, key=lambda model: model.level(reflection_of(model.coefficients)))
        reflection = reflection_of(loudest.coefficients)
        peak_hz = shown_hz = peak_of(reflection, texture.rate_hz)
        if peak_hz >= output.rate_hz / 2:
            shown_hz = peak_of(resampled(reflection, texture.rate_hz, output.rate_hz).reflection, output.rate_hz)
        yield Sound("texture", peak_hz, shown_hz, None)


def _waveform_sound(waveform: Waveform, output: Output) -> Sound:
    middle_hz, rate_hz = waveform.curve.middle_hz, displayed_wave_rate(waveform, output)
    if rate_hz is None:
        return Sound("tap", middle_hz, None, None)
    error = None
    if rate_hz == waveform.rate_hz and output.dynamics is not None and output.actuator is None:
        error = waveform_error(waveform, output.dynamics, output.carried_hz, output.effective_mass_kg)
    return Sound("tap", middle_hz, middle_hz * rate_hz / waveform.rate_hz, error)
