"""Which vibrations of a scene a device and rate can display, and how the others are displayed.

A vibration above 0.4 of the rate is muted or lowered in frequency, as `displayed_mode`, `displayed_wave_rate` and
`displayed_pair` decide. `undisplayable` lists the vibrations that are muted or lowered, `rate_faults` those that are
refused, `warnings` those that are displayed with a deviation. Faults and warnings give a path in the configuration:
`materials.comb.texture.spacing_m`, `scene.objects.table.patches[1]`.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import islice
from typing import Final

from hapticd.base.errors import Path, Problem, path_text
from hapticd.base.lattice import reflection_of
from hapticd.base.model import MAX_FAULTS
from hapticd.config.materials import Material, Tap
from hapticd.config.modes import Mode
from hapticd.config.scene import TOUCHING_DISTANCE_M, SceneObject, Wall, patches_in_order, used_materials
from hapticd.config.texture import Autoregressive, Grooves, Stochastic
from hapticd.config.waveform import Waveform
from hapticd.rendering.compensation import MAX_STRIKE_FORCE_RATIO, Load, Shape, shapes_of, with_poles_of
from hapticd.rendering.device_output import Output
from hapticd.rendering.displayed_error import displayed_error
from hapticd.rendering.filter_design import power_above, stochastic_filter
from hapticd.rendering.kept_contact import KeptTap, kept_tap
from hapticd.rendering.plausibility import figure_warnings
from hapticd.rendering.resampling import resampled
from hapticd.rendering.undisplayable_text import Undisplayable, Use

DISPLAYABLE_RATE_FRACTION: Final = 0.4
"""Highest displayable frequency, as a fraction of the rate of servo or link, whichever is lower."""
DEFAULT_SURFACE_N_PER_M: Final = 800.0
"""Stiffness for which modes without a surface are compensated: a typical one of the shipped materials."""
MIN_NORMAL_STIFFNESS_PART: Final = 0.5
"""From this fraction of the stiffness along a strike on, compensation is designed for contact with the surface."""
FAST_STROKE_M_PER_S: Final = 0.5
"""Speed of a fast stroke, at which the shape of a groove should last at least two ticks."""
MAX_POWER_LOSS: Final = 0.01
"""Largest fraction of a texture's power, or a waveform's energy, that may be lost without a warning."""
MAX_SPECTRUM_ERROR_DB: Final = 3.0
"""Largest error of a texture's spectrum without a warning."""


def displayed_mode(mode: Mode, output: Output) -> tuple[Mode | None, float]:
    """Return the mode as it is displayed, and the factor on its amplitude coefficient that keeps the first peak.

    Above 0.4 of the rate of servo or link, whichever is lower, a mode is muted (None) or lowered to that frequency.
    """
    highest = 2.0 * math.pi * DISPLAYABLE_RATE_FRACTION * output.carried_hz
    if mode.angular_frequency_rad_per_s <= highest:
        return mode, 1.0
    if output.undisplayable == "mute":
        return None, 1.0
    lowered = Mode(decay_rate_per_s=mode.decay_rate_per_s, angular_frequency_rad_per_s=highest)
    return lowered, mode.peak / lowered.peak


def strike_error(mode: Mode, output: Output) -> float | None:
    """Return the displayed error of a strike: that of the handle's acceleration relative to the mode.

    The strike begins at a tick; through a slow link the error is the RMS over all onsets within a frame.
    Returns None if the mode is muted or lowered, or if mass and damping of the handle are unknown.
    """
    if output.dynamics is None or displayed_mode(mode, output)[0] is not mode:
        return None
    return displayed_error(
        mode,
        output.dynamics,
        output.carried_hz,
        output.compensation,
        output.effective_mass_kg,
        NO_SURFACE.load(output).free,
    )


@dataclass(frozen=True, slots=True)
class Touched:
    """The surface that a strike acts against, and the strike's direction relative to it."""

    stiffness_n_per_m: float = 0.0
    damping_n_s_per_m: float = 0.0
    strike_fraction: float = 1.0
    """Fraction of stiffness and damping along the strike: (n . d)^2, with the normal n and the strike's direction d."""
    pushes: tuple[tuple[Mode, float], ...] = ()
    """The modes of a tap, each with its largest coefficient along the normal over the approach speed, in 1/s."""

    @property
    def design_n_per_m(self) -> float:
        """Stiffness for which a mode is compensated: that of the surface; DEFAULT_SURFACE_N_PER_M without a surface."""
        return self.stiffness_n_per_m or DEFAULT_SURFACE_N_PER_M

    def load(self, output: Output) -> Load:
        """Return the load on a strike against this surface."""
        surface = self.design_n_per_m, self.damping_n_s_per_m
        return Load(*surface, output.age_s, output.actuator, output.slow_link)

    @property
    def best_in_contact(self) -> bool:
        """Whether the compensation is designed for contact with the surface, rather than without it."""
        return self.stiffness_n_per_m > 0.0 and self.strike_fraction >= MIN_NORMAL_STIFFNESS_PART


NO_SURFACE: Final = Touched()
"""A strike without a surface."""


def touched_by(material: Material, use: Use) -> Touched:
    """Return the surface that a strike acts against: the material's for a tap, NO_SURFACE for other strikes."""
    if use not in ("tap", "second") or material.tap is None:
        return NO_SURFACE
    tap = material.tap
    return Touched(material.stiffness_n_per_m, material.damping_n_s_per_m, tap.aim[0] ** 2, _pushes(tap))


def _pushes(tap: Tap) -> tuple[tuple[Mode, float], ...]:
    """Return the modes that a tap strikes along the normal, each with its largest coefficient over speed, in 1/s."""
    slope = 0.0 if tap.one_mode is None else tap.aim[0] * tap.coefficient(tap.largest_slope_per_s)
    if tap.one_mode is None or slope == 0.0:
        return ()
    second = () if tap.second is None or tap.second.ratio == 0.0 else ((tap.second.mode, tap.second.ratio * slope),)
    return (tap.one_mode, slope), *second


def kept_of(output: Output, touched: Touched) -> KeptTap | None:
    """Return the forces of a compensated tap that stays in contact; None if that needs no other forces."""
    if output.compensation != "full" or output.dynamics is None or not touched.stiffness_n_per_m > 0.0:
        return None
    pushes = []
    for mode, push in touched.pushes:
        shown, factor = displayed_mode(mode, output)
        if shown is not None:
            pushes.append((shown, factor * push))
    if not pushes:
        return None
    load = touched.load(output)
    return kept_tap(tuple(pushes), output.dynamics, output.carried_hz, load, touched.best_in_contact)


def struck_shapes(mode: Mode, output: Output, touched: Touched = NO_SURFACE) -> tuple[Shape, Shape] | None:
    """Return two shapes of the force of a displayable mode: without a surface, and against `touched`.

    The second shape is for a strike along the normal; if `touched` is NO_SURFACE, against DEFAULT_SURFACE_N_PER_M.
    Returns None without compensation.
    """
    if output.compensation == "off":
        return None
    assert output.dynamics is not None
    load, rate_hz = touched.load(output), output.carried_hz
    free, contact = shapes_of(mode, output.dynamics, rate_hz, output.compensation, load, touched.best_in_contact)
    kept = kept_of(output, touched)
    full = contact if kept is None else kept.full_of(mode, contact)
    if full is contact:
        return free, contact
    return with_poles_of(full, mode, output.dynamics, rate_hz, load.free), full


def waveform_of(material: Material) -> Waveform | None:
    """Return the waveform that the material's tap plays, or None if it plays none."""
    return None if material.tap is None else material.tap.waveform


def displayed_wave_rate(waveform: Waveform, output: Output) -> float | None:
    """Return the sampling rate (Hz) with which a waveform is played, or None if the waveform is muted.

    The waveform keeps its rate if half of its energy lies below 0.4 of the rate of servo or link, whichever is lower.
    Otherwise it is muted, or slowed down until that holds.
    """
    highest, middle = DISPLAYABLE_RATE_FRACTION * output.carried_hz, waveform.curve.middle_hz
    if middle <= highest:
        return waveform.rate_hz
    return None if output.undisplayable == "mute" else waveform.rate_hz * highest / middle


def displayed_pair(texture: Stochastic, output: Output) -> tuple[float, float] | None:
    """Return the peak and mean frequency (Hz) for which the filter of a texture is designed; None if it is muted.

    A texture whose peak is above 0.4 of the rate is muted if `device.undisplayable` is `mute`. Otherwise peak and mean
    are lowered by the same factor, which brings the peak to 0.4 of the rate.
    """
    highest = DISPLAYABLE_RATE_FRACTION * output.carried_hz
    if texture.peak_hz <= highest:
        return texture.peak_hz, texture.mean_hz
    if output.undisplayable == "mute":
        return None
    return highest, texture.mean_hz * (highest / texture.peak_hz)


def modes_of(material: Material) -> list[tuple[Use, Mode]]:
    """Return the modes of a material, each with its use."""
    modes: tuple[tuple[Use, Mode | None], ...] = (
        *(("tap", mode) for mode in (() if material.tap is None else material.tap.modes)),
        ("second", None if material.tap is None or material.tap.second is None else material.tap.second.mode),
        ("rupture", None if material.rupture is None else material.rupture.mode),
        *(("groove", mode) for mode in material.groove_modes),
    )
    return [(use, mode) for use, mode in modes if mode is not None]


def mode_path(use: Use) -> Path:
    """Return the keys of a mode within its material, given its use."""
    keys: dict[Use, Path] = {"groove": ("texture",), "second": ("tap", "second")}
    return keys.get(use, (use,))


def undisplayable(materials: Mapping[str, Material], output: Output) -> list[Undisplayable]:
    """Return the modes, waveforms and textures of these materials whose frequency is too high for the rate."""
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
        if isinstance(texture, Stochastic) and texture.peak_hz > DISPLAYABLE_RATE_FRACTION * output.carried_hz:
            pair = displayed_pair(texture, output)
            found.append(Undisplayable(name, "texture", texture.peak_hz, None if pair is None else pair[0]))
    return found


def rate_faults(objects: Mapping[str, SceneObject], materials: Mapping[str, Material], output: Output) -> list[Problem]:
    """Return a fault for each frequency, of the objects' materials, that is not below half the servo rate."""
    return [
        fault
        for name, material in materials_in(objects, materials).items()
        for fault in material_rate_faults(name, material, output)
    ]


def material_rate_faults(name: str, material: Material, output: Output) -> list[Problem]:
    """Return a fault for each frequency of one material that is not below half the servo rate."""
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
    """Return a warning for each part of the scene that is displayed with a deviation."""
    found: list[Problem] = []
    for name, material in materials_in(objects, materials).items():
        found += material_warnings(name, material, output)
    for id, item in objects.items():
        if isinstance(item, Wall) and item.patches:
            found += patch_warnings(item, ("scene", "objects", id))
    return found


def material_warnings(name: str, material: Material, output: Output) -> list[Problem]:
    """Return a warning for each part of one material that is displayed with a deviation or has implausible figures."""
    found = figure_warnings(name, material)
    found += [*_compensation_warnings(name, material, output), *_waveform_warnings(name, material, output)]
    match material.texture:
        case Grooves() as texture:
            found += _groove_warnings(name, texture, output)
        case Stochastic() as texture:
            found += _stochastic_warnings(name, texture, output)
        case Autoregressive() as texture:
            found += _autoregressive_warnings(name, texture, output)
    return found


def materials_in(objects: Mapping[str, SceneObject], materials: Mapping[str, Material]) -> dict[str, Material]:
    """Return the materials that these objects use, in the order of `materials`."""
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
        # Without the limits of a tap that stays in contact, which may need less force.
        shapes = None if shown is None else struck_shapes(shown, output, replace(touched, pushes=()))
        shape = None if shapes is None else shapes[touched.best_in_contact]
        if shape is not None and shape.limited:
            problem = (
                f"would need more than {MAX_STRIKE_FORCE_RATIO:g} times the force of its amplitude on this device, "
                f"(m + m_h) A, and is limited to that; its acceleration is off by {100 * shape.error:.2g} %"
            )
            yield Problem(path_text(("materials", name, *mode_path(use))), problem)


def preload_notes(materials: Mapping[str, Material], output: Output, speed_m_per_s: float) -> list[Problem]:
    """Return a note for each compensated tap of these materials that needs a preload to stay in contact.

    It gives the depth at this speed from which on the hand holds the complete compensation, and the errors.
    """
    found = []
    for name, material in materials.items():
        kept = kept_of(output, touched_by(material, "tap"))
        if kept is not None and kept.full != kept.kept:
            depth_mm = 1e3 * kept.full_s * speed_m_per_s
            error, larger = (100 * max(shape.error for shape in each) for each in (kept.full, kept.kept))
            problem = (
                f"is displayed with an error of {error:.2g} % on its wall by a hand that stops at least "
                f"{1e3 * kept.full_s:.2g} ms after the onset, {depth_mm:.2g} mm deep at {speed_m_per_s:g} m/s; if it "
                f"stops earlier, compensation is reduced so that the tap stays in contact ({larger:.2g} % if it stops "
                "at the onset)"
            )
            found.append(Problem(path_text(("materials", name, "tap")), problem))
    return found


def _waveform_warnings(name: str, material: Material, output: Output) -> Iterator[Problem]:
    waveform = waveform_of(material)
    if waveform is None:
        return
    place = path_text(("materials", name, "tap", "waveform"))
    highest_hz = DISPLAYABLE_RATE_FRACTION * output.carried_hz
    above = waveform.curve.energy_above(highest_hz)
    if above > MAX_POWER_LOSS and displayed_wave_rate(waveform, output) == waveform.rate_hz:
        what = "the link's" if output.carried_hz < output.rate_hz else "a rate of"
        problem = (
            f"has {100 * above:.3g} % of its energy above {_hz(highest_hz)}, which {what} "
            f"{_hz(output.carried_hz)} cannot carry"
        )
        yield Problem(place, problem)
    if output.compensation != "off":
        yield Problem(
            place,
            f"is not compensated for handle, hand and hold, as compensation: {output.compensation} applies to modes "
            "only; it is played as with compensation: off",
        )


def _groove_warnings(name: str, texture: Grooves, output: Output) -> Iterator[Problem]:
    one, two = ("tick", "ticks") if output.carried_hz == output.rate_hz else ("frame of the link", "frames of the link")
    travel_m = output.max_speed_m_per_s / output.carried_hz
    if texture.display == "vibration" and texture.spacing_m < travel_m * (1 - 1e-9):
        held_m_per_s = texture.spacing_m * output.carried_hz
        problem = (
            f"{texture.spacing_m:g} is less than the probe may travel in a {one}, {travel_m:g} at the device's "
            f"max_speed_m_per_s; up to {held_m_per_s:g} m/s it passes at most one groove in a {one}"
        )
        yield _texture_problem(name, "spacing_m", problem)
    min_width_m = 2 * FAST_STROKE_M_PER_S / output.carried_hz
    if texture.display != "vibration" and texture.width_m < min_width_m * (1 - 1e-9):
        problem = (
            f"{texture.width_m:g} is passed in less than two {two} at {FAST_STROKE_M_PER_S:g} m/s, "
            f"too fast for its shape to be displayed; must be at least {min_width_m:g}"
        )
        yield _texture_problem(name, "width_m", problem)


def _stochastic_warnings(name: str, texture: Stochastic, output: Output) -> Iterator[Problem]:
    pair = displayed_pair(texture, output)
    if pair is None or max(texture.peak_hz, texture.mean_hz) >= output.rate_hz / 2:
        return  # muted or refused, and reported as such
    shown = stochastic_filter(*pair, output.rate_hz)
    if not shown.met(*pair):
        problem = (
            f"a peak of {_hz(pair[0])} and a mean of {_hz(pair[1])} cannot both be reached at {_hz(output.rate_hz)}; "
            f"shown are {_hz(shown.peak_hz)} and {_hz(shown.mean_hz)}"
        )
        yield _texture_problem(name, "mean_hz", problem)
    if output.carried_hz < output.rate_hz:
        above = power_above(shown, DISPLAYABLE_RATE_FRACTION * output.carried_hz, output.rate_hz)
        if above > MAX_POWER_LOSS:
            yield _texture_problem(name, "mean_hz", _above_problem(above, output))


def _above_problem(above: float, output: Output) -> str:
    highest = _hz(DISPLAYABLE_RATE_FRACTION * output.carried_hz)
    return (
        f"has {100 * above:.3g} % of its power above {highest}, which the link's {_hz(output.carried_hz)} cannot carry"
    )


@lru_cache(maxsize=8)
def _losses(texture: Autoregressive, rate_hz: float, carried_hz: float) -> list[list[float]]:
    """Return three lists of the losses at a rate, with an entry for each model of a texture.

    The losses are the fraction of power cut off, the error of the spectrum in dB, and the fraction of power above 0.4
    of the link's rate (0 if the link is not slower than the servo).
    """
    shown = [resampled(reflection_of(model.coefficients), texture.rate_hz, rate_hz) for model in texture.models]
    limit_hz = DISPLAYABLE_RATE_FRACTION * carried_hz if carried_hz < rate_hz else math.inf
    above = [power_above((each.reflection, None), limit_hz, rate_hz) for each in shown]
    return [[1 - each.kept for each in shown], [each.error_db for each in shown], above]


def _autoregressive_warnings(name: str, texture: Autoregressive, output: Output) -> Iterator[Problem]:
    """Yield a warning for each kind of loss, about the model with the largest loss."""
    losses = _losses(texture, output.rate_hz, output.carried_hz)
    loss, error_db, above = map(max, losses)
    more = "" if len(texture.models) == 1 else ", more than any other model"
    problems = (
        (loss > MAX_POWER_LOSS, f"loses {100 * loss:.3g} % of its power at a rate of {_hz(output.rate_hz)}{more}"),
        (
            error_db > MAX_SPECTRUM_ERROR_DB,
            f"is shown with a spectrum that is off by up to {error_db:.2g} dB at a rate of {_hz(output.rate_hz)}{more}",
        ),
        (above > MAX_POWER_LOSS, f"{_above_problem(above, output)}{more}"),
    )
    for (is_large, problem), figures in zip(problems, losses, strict=True):
        if is_large:
            index = figures.index(max(figures))
            yield Problem(path_text(("materials", name, "texture", "models", index)), problem)


def patch_warnings(wall: Wall, root: Path) -> list[Problem]:
    """Return up to MAX_FAULTS warnings about the patches of a wall, whose path is `root`."""
    found = islice(_narrow_patches(wall), MAX_FAULTS)
    return [Problem(path_text((*root, "patches", index)), problem) for index, problem in found]


def _narrow_patches(wall: Wall) -> Iterator[tuple[int, str]]:
    """Yield index and problem of each patch whose width, or distance to the next patch, is below `patch_ramp_m`."""
    patches, ramp_m = wall.patches, wall.patch_ramp_m
    narrow = f"patch_ramp_m, {ramp_m:g}; the ramps between are narrowed"
    before: int | None = None
    for index in patches_in_order(patches):
        from_m, to_m = patches[index].from_m, patches[index].to_m
        if before is not None:
            gap = from_m - patches[before].to_m
            if TOUCHING_DISTANCE_M < gap < ramp_m - TOUCHING_DISTANCE_M:
                yield index, f"is {gap:.4g} from patches[{before}], nearer than {narrow}"
        if to_m - from_m < ramp_m - TOUCHING_DISTANCE_M:
            yield index, f"is {to_m - from_m:.4g} wide, narrower than {narrow}"
        before = index
