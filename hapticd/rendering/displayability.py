"""What of a scene and its materials this device and rate can show, and what becomes of the rest.

What the rate cannot carry is muted or lowered. `displayed_mode`, `displayed_wave_rate` and `displayed_pair` decide how,
for whoever compiles or strikes a mode. Three functions only report: `undisplayable` what is muted or lowered,
`rate_faults` what is refused because the rate cannot carry it at all, `warnings` what is shown, but not as it was
meant. Places are those of a configuration file: `materials.comb.texture.spacing_m`, `scene.objects.table.patches[1]`.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from typing import Final

from hapticd.base.errors import Path, Problem, path_text
from hapticd.base.lattice import reflection_of
from hapticd.base.model import MAX_FAULTS
from hapticd.config.materials import Material
from hapticd.config.modes import Mode
from hapticd.config.scene import TOUCHING_M, SceneObject, Wall, patches_in_order, used_materials
from hapticd.config.texture import Autoregressive, Grooves, Stochastic
from hapticd.config.waveform import Waveform
from hapticd.rendering.compensation import MAX_STRIKE_FORCE_RATIO, Load, Shape, shapes_of
from hapticd.rendering.device_output import Output
from hapticd.rendering.displayed_error import displayed_error
from hapticd.rendering.filter_design import power_above, stochastic_filter
from hapticd.rendering.resampling import resampled
from hapticd.rendering.undisplayable_text import Undisplayable, Use

DISPLAYABLE: Final = 0.4
"""What lies above this fraction of the rate, of servo or link, whichever is lower, is not displayed as it is."""
TOUCHED_N_PER_M: Final = 800.0
"""The surface that a mode without one of its own may meet: that of the shipped materials."""
MOSTLY_ACROSS: Final = 0.5
"""A strike that meets this part of the surface's stiffness or more is compensated best where it is touched."""
STROKE_M_PER_S: Final = 0.5
"""A fast stroke: a groove's shape that it passes in less than two ticks is hardly displayed."""
MAX_LOSS: Final = 0.01
"""More of a recorded texture's power than this is not lost silently."""
MAX_ERROR_DB: Final = 3.0
"""Nor is its spectrum farther off than this."""


def displayed_mode(mode: Mode, output: Output) -> tuple[Mode | None, float]:
    """The mode as the rate can carry it, and the factor on its coefficient that keeps the first peak.

    Above 0.4 of the rate a mode is muted (None) or lowered to 0.4 of the rate, which is the link's if that is lower.
    """
    highest = 2.0 * math.pi * DISPLAYABLE * output.carried_hz
    if mode.angular_frequency_rad_per_s <= highest:
        return mode, 1.0
    if output.undisplayable == "mute":
        return None, 1.0
    lowered = Mode(decay_rate_per_s=mode.decay_rate_per_s, angular_frequency_rad_per_s=highest)
    return lowered, mode.peak / lowered.peak


def strike_error(mode: Mode, output: Output) -> float | None:
    """Displayed error of a strike that begins at a tick (hapticd.rendering.displayed_error).

    None where the mode is muted or lowered, or where mass and damping of the handle are not known.
    """
    if output.dynamics is None or displayed_mode(mode, output)[0] is not mode:
        return None
    return displayed_error(
        mode,
        output.dynamics,
        output.carried_hz,
        output.compensation,
        output.effective_mass_kg,
        output.actuator,
    )


@dataclass(frozen=True, slots=True)
class Touched:
    """The surface that a strike meets, and how the strike is directed to it."""

    stiffness_n_per_m: float = 0.0
    damping_n_s_per_m: float = 0.0
    across: float = 1.0
    """What of them acts along the strike: (n . d)^2 of the surface's normal n and the strike's direction d."""

    @property
    def met_n_per_m(self) -> float:
        """The stiffness that a mode is designed for: the surface's, or TOUCHED_N_PER_M where there is none."""
        return self.stiffness_n_per_m or TOUCHED_N_PER_M

    def load(self, output: Output) -> Load:
        """What a strike against it meets."""
        return Load(self.met_n_per_m, self.damping_n_s_per_m, output.age_s, output.actuator)

    @property
    def own(self) -> bool:
        """Whether a mode is compensated best where it is touched; else where nothing is."""
        return self.stiffness_n_per_m > 0.0 and self.across >= MOSTLY_ACROSS


UNTOUCHED: Final = Touched()


def touched_by(material: Material, use: Use) -> Touched:
    """What a strike of this material meets: its tap itself, all others nothing of their own."""
    if use not in ("tap", "second") or material.tap is None:
        return UNTOUCHED
    return Touched(material.stiffness_n_per_m, material.damping_n_s_per_m, material.tap.aim[0] ** 2)


def struck_shapes(mode: Mode, output: Output, touched: Touched = UNTOUCHED) -> tuple[Shape, Shape] | None:
    """The forces by which a mode that the rate can carry is struck: where nothing is touched, and against this surface
    straight from the front (one of TOUCHED_N_PER_M where there is none). None where nothing is compensated.

    The core goes on a straight line from one to the other by the stiffness that acts along the strike.
    """
    if output.compensation == "off":
        return None
    assert output.dynamics is not None
    load, rate_hz = touched.load(output), output.carried_hz
    return shapes_of(mode, output.dynamics, rate_hz, output.compensation, load, touched.own)


def waveform_of(material: Material) -> Waveform | None:
    """What the material's tap plays, if it does not ring."""
    return None if material.tap is None else material.tap.waveform


def displayed_wave_rate(waveform: Waveform, output: Output) -> float | None:
    """Samples a second with which a waveform is played: its own, if half of its energy lies below 0.4 of the rate (the
    link's if that is lower). Otherwise it is muted (None), or slowed down until half of it does."""
    highest, middle = DISPLAYABLE * output.carried_hz, waveform.curve.middle_hz
    if middle <= highest:
        return waveform.rate_hz
    return None if output.undisplayable == "mute" else waveform.rate_hz * highest / middle


def displayed_pair(texture: Stochastic, output: Output) -> tuple[float, float] | None:
    """Peak and mean (Hz) that the texture's filter is designed for; None where it is muted.

    A peak above 0.4 of the rate is muted, or lowered to 0.4 of the rate and the mean by the same factor.
    """
    highest = DISPLAYABLE * output.carried_hz
    if texture.peak_hz <= highest:
        return texture.peak_hz, texture.mean_hz
    if output.undisplayable == "mute":
        return None
    return highest, texture.mean_hz * (highest / texture.peak_hz)


def modes_of(material: Material) -> list[tuple[Use, Mode]]:
    """The modes of a material, and what strikes them."""
    modes: tuple[tuple[Use, Mode | None], ...] = (
        *(("tap", mode) for mode in (() if material.tap is None else material.tap.modes)),
        ("second", None if material.tap is None or material.tap.second is None else material.tap.second.mode),
        ("rupture", None if material.rupture is None else material.rupture.mode),
        *(("groove", mode) for mode in material.groove_modes),
    )
    return [(use, mode) for use, mode in modes if mode is not None]


def mode_path(use: Use) -> Path:
    """Where a mode stands in its material."""
    keys: dict[Use, Path] = {"groove": ("texture",), "second": ("tap", "second")}
    return keys.get(use, (use,))


def undisplayable(materials: Mapping[str, Material], output: Output) -> list[Undisplayable]:
    """The modes and textures of these materials that the rate cannot carry."""
    found: list[Undisplayable] = []
    for name, material in materials.items():
        for use, mode in modes_of(material):
            shown, _ = displayed_mode(mode, output)
            if shown is not mode:
                found.append(Undisplayable(name, use, mode.frequency_hz, None if shown is None else shown.frequency_hz))
        waveform = waveform_of(material)
        if waveform is not None:
            rate_hz, middle_hz = displayed_wave_rate(waveform, output), waveform.curve.middle_hz
            if rate_hz != waveform.rate_hz:
                slowed_hz = None if rate_hz is None else middle_hz * rate_hz / waveform.rate_hz
                found.append(Undisplayable(name, "tap", middle_hz, slowed_hz))
        texture = material.texture
        if isinstance(texture, Stochastic) and texture.peak_hz > DISPLAYABLE * output.carried_hz:
            pair = displayed_pair(texture, output)
            found.append(Undisplayable(name, "texture", texture.peak_hz, None if pair is None else pair[0]))
    return found


def rate_faults(objects: Mapping[str, SceneObject], materials: Mapping[str, Material], output: Output) -> list[Problem]:
    """What of the materials in use has to be refused, because no sampled signal of this rate has it."""
    return [
        fault
        for name, material in materials_in(objects, materials).items()
        for fault in material_rate_faults(name, material, output)
    ]


def material_rate_faults(name: str, material: Material, output: Output) -> list[Problem]:
    """As rate_faults, of one material."""
    texture = material.texture
    if not isinstance(texture, Stochastic):
        return []
    limit = output.rate_hz / 2
    return [
        _texture_problem(name, key, f"must be less than half the servo rate of {_hz(output.rate_hz)}, is {value:g}")
        for key, value in (("peak_hz", texture.peak_hz), ("mean_hz", texture.mean_hz))
        if value >= limit
    ]


def warnings(objects: Mapping[str, SceneObject], materials: Mapping[str, Material], output: Output) -> list[Problem]:
    """What of the scene is displayed, but not as it was meant, and how it is displayed then."""
    found: list[Problem] = []
    for name, material in materials_in(objects, materials).items():
        found += material_warnings(name, material, output)
    for id, item in objects.items():
        if isinstance(item, Wall) and item.patches:
            found += patch_warnings(item, ("scene", "objects", id))
    return found


def material_warnings(name: str, material: Material, output: Output) -> list[Problem]:
    """As warnings, of one material."""
    found = [*_compensation_warnings(name, material, output), *_waveform_warnings(name, material, output)]
    match material.texture:
        case Grooves() as texture:
            found += _groove_warnings(name, texture, output)
        case Stochastic() as texture:
            found += _stochastic_warnings(name, texture, output)
        case Autoregressive() as texture:
            found += _autoregressive_warnings(name, texture, output)
    return found


def materials_in(objects: Mapping[str, SceneObject], materials: Mapping[str, Material]) -> dict[str, Material]:
    """Those of the materials that these objects are made of, in their order."""
    used = used_materials(objects.values())
    return {name: material for name, material in materials.items() if name in used}


def _texture_problem(material: str, key: str, problem: str) -> Problem:
    return Problem(path_text(("materials", material, "texture", key)), problem)


def _hz(frequency_hz: float) -> str:
    return f"{frequency_hz:.4g} Hz" if frequency_hz < 1000 else f"{frequency_hz:.15g} Hz"


def _compensation_warnings(name: str, material: Material, output: Output) -> Iterator[Problem]:
    for use, mode in modes_of(material):
        shown, _ = displayed_mode(mode, output)
        touched = touched_by(material, use)
        shapes = None if shown is None else struck_shapes(shown, output, touched)
        shape = None if shapes is None else shapes[touched.own]
        if shape is not None and shape.limited:
            problem = (
                f"needs more than {MAX_STRIKE_FORCE_RATIO:g} times the force that its amplitude is worth on this device, and is given "
                f"that; its acceleration is off by {100 * shape.error:.2g} %"
            )
            yield Problem(path_text(("materials", name, *mode_path(use))), problem)


def _waveform_warnings(name: str, material: Material, output: Output) -> Iterator[Problem]:
    waveform = waveform_of(material)
    if waveform is None:
        return
    place = path_text(("materials", name, "tap", "waveform"))
    above = waveform.curve.energy_above(DISPLAYABLE * output.carried_hz)
    if above > MAX_LOSS and displayed_wave_rate(waveform, output) == waveform.rate_hz:
        what = "the link's" if output.carried_hz < output.rate_hz else "a rate of"
        problem = (
            f"has {100 * above:.3g} % of its energy above {_hz(DISPLAYABLE * output.carried_hz)}, which {what} "
            f"{_hz(output.carried_hz)} cannot carry as it is"
        )
        yield Problem(place, problem)
    if output.compensation != "off":
        yield Problem(
            place,
            f"is not compensated for handle, hand and hold: compensation: {output.compensation} is for modes; it is "
            "played as with compensation: off",
        )


def _groove_warnings(name: str, texture: Grooves, output: Output) -> Iterator[Problem]:
    one, two = ("tick", "ticks") if output.carried_hz == output.rate_hz else ("frame of the link", "frames of the link")
    travel_m = output.max_speed_m_per_s / output.carried_hz
    if texture.display == "vibration" and texture.spacing_m < travel_m * (1 - 1e-9):
        held_m_per_s = texture.spacing_m * output.carried_hz
        problem = (
            f"{texture.spacing_m:g} is less than the probe may travel in a {one}, {travel_m:g} at the device's "
            f"max_speed_m_per_s; up to {held_m_per_s:g} m/s a {one} passes one groove at most"
        )
        yield _texture_problem(name, "spacing_m", problem)
    least_m = 2 * STROKE_M_PER_S / output.carried_hz
    if texture.display != "vibration" and texture.width_m < least_m * (1 - 1e-9):
        problem = (
            f"{texture.width_m:g} is passed in less than two {two} at {STROKE_M_PER_S:g} m/s, "
            f"and its shape is hardly displayed; from {least_m:g} on it is"
        )
        yield _texture_problem(name, "width_m", problem)


def _stochastic_warnings(name: str, texture: Stochastic, output: Output) -> Iterator[Problem]:
    pair = displayed_pair(texture, output)
    if pair is None or max(texture.peak_hz, texture.mean_hz) >= output.rate_hz / 2:
        return  # muted or refused, and reported as such
    shown = stochastic_filter(*pair, output.rate_hz)
    if not shown.met(*pair):
        problem = (
            f"a peak of {_hz(pair[0])} and a mean of {_hz(pair[1])} are not met at a rate of {_hz(output.rate_hz)}; "
            f"shown are {_hz(shown.peak_hz)} and {_hz(shown.mean_hz)}"
        )
        yield _texture_problem(name, "mean_hz", problem)
    if output.carried_hz < output.rate_hz:
        above = power_above(shown, DISPLAYABLE * output.carried_hz, output.rate_hz)
        if above > MAX_LOSS:
            yield _texture_problem(name, "mean_hz", _above_problem(above, output))


def _above_problem(above: float, output: Output) -> str:
    return (
        f"has {100 * above:.3g} % of its power above {_hz(DISPLAYABLE * output.carried_hz)}, more than the link's "
        f"{_hz(output.carried_hz)} can carry as it is"
    )


@lru_cache(maxsize=8)
def _losses(texture: Autoregressive, rate_hz: float, carried_hz: float) -> list[list[float]]:
    """What each model loses when it is shown at a rate: the fractions of power that are cut off, the errors of spectra
    in dB, and the fractions of power above what the link carries, if that is the lower rate."""
    shown = [resampled(reflection_of(model.coefficients), texture.rate_hz, rate_hz) for model in texture.models]
    limit_hz = DISPLAYABLE * carried_hz if carried_hz < rate_hz else math.inf
    above = [power_above((each.reflection, None), limit_hz, rate_hz) for each in shown]
    return [[1 - each.kept for each in shown], [each.error_db for each in shown], above]


def _autoregressive_warnings(name: str, texture: Autoregressive, output: Output) -> Iterator[Problem]:
    """Of the worst model of each kind, of equals the first."""
    losses = _losses(texture, output.rate_hz, output.carried_hz)
    loss, error_db, above = map(max, losses)
    more = "" if len(texture.models) == 1 else ", more than any other model"
    problems = (
        (loss > MAX_LOSS, f"loses {100 * loss:.3g} % of its power at a rate of {_hz(output.rate_hz)}{more}"),
        (
            error_db > MAX_ERROR_DB,
            f"is shown with a spectrum that is off by up to {error_db:.2g} dB at a rate of {_hz(output.rate_hz)}{more}",
        ),
        (above > MAX_LOSS, f"{_above_problem(above, output)}{more}"),
    )
    for (is_large, problem), figures in zip(problems, losses, strict=True):
        if is_large:
            index = figures.index(max(figures))
            yield Problem(path_text(("materials", name, "texture", "models", index)), problem)


def patch_warnings(wall: Wall, root: Path) -> list[Problem]:
    """As warnings, of a wall's patches; `where` begins with `root`, the wall's own place. MAX_FAULTS are reported."""
    found = islice(_narrow(wall), MAX_FAULTS)
    return [Problem(path_text((*root, "patches", index)), problem) for index, problem in found]


def _narrow(wall: Wall) -> Iterator[tuple[int, str]]:
    """The index of each patch that is too narrow for the ramp, or too near another one, and what is wrong with it."""
    patches, ramp_m = wall.patches, wall.patch_ramp_m
    narrow = f"patch_ramp_m, {ramp_m:g}; the ramps between are narrowed"
    before: int | None = None
    for index in patches_in_order(patches):
        from_m, to_m = patches[index].from_m, patches[index].to_m
        if before is not None:
            gap = from_m - patches[before].to_m
            if TOUCHING_M < gap < ramp_m - TOUCHING_M:
                yield index, f"is {gap:.4g} from patches[{before}], nearer than {narrow}"
        if to_m - from_m < ramp_m - TOUCHING_M:
            yield index, f"is {to_m - from_m:.4g} wide, narrower than {narrow}"
        before = index
