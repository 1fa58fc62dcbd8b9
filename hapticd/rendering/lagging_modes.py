"""Modes for which the actuator is too slow: the part of each mode that the handle shows, and remedies.

The shown part of a mode is the complex projection of the handle's acceleration on the mode's waveform, 30 Hz to 0.4 of
the rate, divided by the projection with an ideal actuator. Its amplitude and phase are reported.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Final

from hapticd.base.errors import Problem, path_text
from hapticd.config.actuator import MAX_BANDWIDTH_HZ
from hapticd.config.dynamics import Dynamics
from hapticd.config.materials import Material
from hapticd.config.modes import Mode
from hapticd.rendering.compensation import part_shown, pole_shape
from hapticd.rendering.device_output import Output
from hapticd.rendering.displayability import Touched, displayed_mode, mode_path, modes_of, struck_shapes, touched_by

MAX_AMPLITUDE_ERROR: Final = 0.1
"""Largest unreported amplitude error, as a fraction: that of a mode at half the bandwidth of an actuator of order 1."""
_BANDWIDTH_SEARCH_FACTOR: Final = 1.5
"""Ratio of successive bandwidths that are tried to find a sufficient one."""
_BANDWIDTH_BISECTIONS: Final = 3
"""Number of bisections between an insufficient and a sufficient bandwidth."""
_UNKNOWN_HANDLE: Final = Dynamics(1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""Handle that is assumed if the device's is unknown. Strikes are then not compensated, so the mass cancels."""


def lag_warnings(materials: Mapping[str, Material], output: Output) -> list[Problem]:
    """Return a warning for each mode of these materials that the actuator does not show as intended."""
    if output.actuator is None:
        return []
    return [each for name, material in materials.items() for each in _material_lag_warnings(name, material, output)]


def shown_part(mode: Mode, output: Output, touched: Touched) -> complex:
    """Return the complex part of a displayable mode that the handle shows; 1 with an ideal actuator."""
    return _contained(mode, output, touched) / _contained(mode, replace(output, actuator=None), touched)


@lru_cache(maxsize=256)
def _contained(mode: Mode, output: Output, touched: Touched) -> complex:
    shapes = struck_shapes(mode, output, touched)
    dynamics, rate_hz, load = output.dynamics or _UNKNOWN_HANDLE, output.carried_hz, touched.load(output)
    if shapes is None:
        free = load.free
        return part_shown(mode, dynamics, rate_hz, pole_shape(mode, dynamics, rate_hz, 1 + 0j, free), free)
    load = load if touched.best_in_contact else load.free
    return part_shown(mode, dynamics, rate_hz, shapes[touched.best_in_contact], load)


def _material_lag_warnings(name: str, material: Material, output: Output) -> Iterator[Problem]:
    assert output.actuator is not None
    for use, mode in modes_of(material):
        carried, _ = displayed_mode(mode, output)
        if carried is None:
            continue
        touched = touched_by(material, use)
        part = shown_part(carried, output, touched)
        if not _is_shown(part):
            known = f"an actuator of {_hz(output.actuator.bandwidth_hz)} (order {output.actuator.order})"
            problem = (
                f"{known} shows {100 * abs(part):.3g} % of this mode of {_hz(carried.frequency_hz)}, {_phase(part)}, "
                f"with compensation: {output.compensation}; "
                f"{', or '.join(_remedies(carried, output, touched))}"
            )
            yield Problem(path_text(("materials", name, *mode_path(use))), problem)


def _phase(part: complex) -> str:
    late = round(-math.degrees(cmath.phase(part)))
    return f"{abs(late)} degrees {'late' if late > 0 else 'early'}" if late != 0 else "in phase"


def _is_shown(part: complex) -> bool:
    """Return whether the amplitude of the shown part is within MAX_AMPLITUDE_ERROR of 1."""
    return abs(abs(part) - 1) <= MAX_AMPLITUDE_ERROR


def _remedies(mode: Mode, output: Output, touched: Touched) -> Iterator[str]:
    """Yield texts of remedies; each remedy alone would show the mode to within MAX_AMPLITUDE_ERROR."""
    if output.compensation == "off":
        compensated = replace(output, compensation="full")
        if output.dynamics is None:
            yield "device.handle and compensation: full would compensate it, with up to twice the force"
        else:
            part = shown_part(mode, compensated, touched)
            if _is_shown(part):
                yield f"compensation: full would show {100 * abs(part):.3g} %"
    bandwidth_hz = _needed_hz(mode, output, touched)
    if bandwidth_hz is None:
        yield f"no bandwidth up to {_hz(MAX_BANDWIDTH_HZ)} would suffice"
    else:
        yield f"an actuator of {_hz(bandwidth_hz)} would suffice"


def _needed_hz(mode: Mode, output: Output, touched: Touched) -> float | None:
    """Return a bandwidth above the actuator's that shows the mode, with the same order and damping, or None.

    The result exceeds the smallest sufficient bandwidth by less than 6 %.
    """
    own = output.actuator
    assert own is not None

    def is_sufficient(bandwidth_hz: float) -> bool:
        """Return whether an actuator of this bandwidth shows the mode to within MAX_AMPLITUDE_ERROR."""
        faster = own.model_copy(update={"bandwidth_hz": bandwidth_hz})
        return _is_shown(shown_part(mode, replace(output, actuator=faster), touched))

    low = high = own.bandwidth_hz
    while not is_sufficient(high):
        if high == MAX_BANDWIDTH_HZ:
            return None
        low, high = high, min(MAX_BANDWIDTH_HZ, high * _BANDWIDTH_SEARCH_FACTOR)
    for _ in range(_BANDWIDTH_BISECTIONS):
        middle = math.sqrt(low * high)
        low, high = (low, middle) if is_sufficient(middle) else (middle, high)
    return high


def _hz(frequency_hz: float) -> str:
    return f"{frequency_hz:.4g} Hz"
