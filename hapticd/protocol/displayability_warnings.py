"""Warnings of objects and materials in a message that are not displayed as written, with their paths in its params.

`get_status` has the same warnings of the complete scene (rendering/displayability.py).
"""

from collections.abc import Collection, Mapping
from itertools import islice
from typing import Final, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from hapticd.base.errors import Path, Problem, path_text
from hapticd.base.model import MAX_FAULTS
from hapticd.config.materials import Material
from hapticd.config.scene import SceneObject, Wall, material_names, material_places
from hapticd.rendering.device_output import Output
from hapticd.rendering.displayability import (
    DISPLAYABLE_RATE_FRACTION,
    material_rate_faults,
    material_warnings,
    patch_warnings,
    undisplayable,
)
from hapticd.rendering.placement import point_in_mm
from hapticd.rendering.undisplayable_text import Undisplayable, Use

_PATH_BY_MODE: Final[Mapping[Use, Path]] = {"second": ("tap", "second"), "groove": ("texture",)}
"""Path of a mode in its material, if it differs from the name of the mode."""


class MaterialReport(NamedTuple):
    """The parts of a material that an output does not display as written."""

    material: Material
    output: Output
    undisplayable: list[Undisplayable]
    """Modes and spectra with frequencies above 0.4 of the output's rate."""
    warnings: list[Problem]
    """Parts that are displayed, but not as written."""
    fine: bool
    """Whether there is nothing to report, and no texture has a frequency above half the output's rate."""

    @classmethod
    def of(cls, name: str, material: Material, output: Output) -> Self:
        """Return the report of a material for an output."""
        not_displayed, warnings = undisplayable({name: material}, output), material_warnings(name, material, output)
        fine = not (not_displayed or warnings or material_rate_faults(name, material, output))
        return cls(material, output, not_displayed, warnings, fine)

    def problems(self, name: str, played: Collection[tuple[str, str]]) -> list[Problem]:
        """Return the warnings of the material, or its faults if it cannot be rendered, with paths in a configuration.

        `played` are pairs of material and mode that the device plays as effects.
        """
        material, output, not_displayed, warnings, _ = self
        refused = material_rate_faults(name, material, output)
        if refused:  # no object uses the material yet; one that does is refused
            return refused
        above = [
            Problem(
                path_text(("materials", name, *_PATH_BY_MODE.get(one.mode, (one.mode,)))),
                above_rate(one.frequency_hz, one.shown_hz, output),
            )
            for one in not_displayed
            if (name, one.mode) not in played
        ]
        return above + warnings


def above_rate(frequency_hz: float, shown_hz: float | None, output: Output) -> str:
    """Return the warning of a frequency above 0.4 of the output's rate: silent, or displayed at another frequency."""
    shown = "it is silent" if shown_hz is None else f"it is shown at {shown_hz:g} Hz"
    return (
        f"{frequency_hz:g} Hz is above {DISPLAYABLE_RATE_FRACTION * output.carried_hz:g} Hz, 0.4 of the rate: {shown}"
    )


def change_warnings(
    objects: Mapping[str, SceneObject],
    sent: Collection[str],
    reports: Mapping[str, MaterialReport],
    root: Path,
    played: Collection[tuple[str, str]] = (),
) -> list[Problem]:
    """Return at most MAX_FAULTS warnings of objects and materials in a message, and of materials that the objects name.

    Paths of objects begin with `root`. Paths of materials whose names are in `sent` begin with `materials`; another
    material has the path of the first object that names it. `reports` has all these materials. `played` are pairs of
    material and mode that the device plays as effects.
    """
    if not sent and all(_is_fine(item, reports) for item in objects.values()):
        return []
    warnings: list[Problem] = []
    places: dict[str, Path] = {}
    for id, item in objects.items():
        for name, inner in material_places(item):
            places.setdefault(name, (*root, id, *inner))
        if isinstance(item, Wall) and item.patches:
            warnings += patch_warnings(item, (*root, id))
    named = dict.fromkeys([*sent, *places])
    for name in islice(named, MAX_FAULTS):
        problems = reports[name].problems(name, played)
        # The material is not in the message, so its complete warning becomes the problem of the key that names it.
        warnings += problems if name in sent else [Problem(path_text(places[name]), str(each)) for each in problems]
    return warnings[:MAX_FAULTS]


def _is_fine(item: SceneObject, reports: Mapping[str, MaterialReport]) -> bool:
    """Return whether an object is known to be displayed as written; a wall with patches needs a closer check."""
    if item.kind == "wall" and item.patches:
        return False
    return all(reports[name].fine for name in material_names(item))


def operator_warnings(waypoints: npt.NDArray[np.float64], workspace_m: float, where: str | None) -> list[Problem]:
    """Return a warning of the first of `waypoints`, shape (n, 3), that is beyond the stops of the handle; else [].

    `where` is the place of the warning, by default that of the waypoint.
    """
    beyond = np.abs(waypoints[:, 1:]).max(axis=1) > workspace_m
    if not beyond.any():
        return []
    first = int(np.argmax(beyond))
    x_m, y_m = waypoints[first, 1:].tolist()
    problem = (
        f"[{x_m:g}, {y_m:g}] is beyond the stops of the handle, {workspace_m:g} m from the middle"
        f"{point_in_mm('it', (x_m, y_m), workspace_m)}"
    )
    return [Problem(f"waypoints[{first}]" if where is None else where, problem)]
