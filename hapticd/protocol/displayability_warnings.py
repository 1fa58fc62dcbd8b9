"""What of a message cannot be displayed as it was meant, reported at its place in the message's params.

It is what `get_status` says of the scene (rendering/displayability.py), of no more than the message held.
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
    DISPLAYABLE,
    material_rate_faults,
    material_warnings,
    patch_warnings,
    undisplayable,
)
from hapticd.rendering.undisplayable_text import Undisplayable, Use

_PATH_BY_MODE: Final[Mapping[Use, Path]] = {"second": ("tap", "second"), "groove": ("texture",)}
"""Where a mode stands in its material, if not under its own name."""


class MaterialReport(NamedTuple):
    """What of a material is not displayed as it was meant, at an output."""

    material: Material
    output: Output
    undisplayable: list[Undisplayable]
    """What the rate cannot carry."""
    warnings: list[Problem]
    """What is shown otherwise."""
    fine: bool
    """There is nothing of either, and no signal of the rate lacks anything."""

    @classmethod
    def of(cls, name: str, material: Material, output: Output) -> Self:
        lacking, warnings = undisplayable({name: material}, output), material_warnings(name, material, output)
        fine = not (lacking or warnings or material_rate_faults(name, material, output))
        return cls(material, output, lacking, warnings, fine)

    def problems(self, name: str, played: Collection[tuple[str, str]]) -> list[Problem]:
        """All of it, at its place in a configuration; `played`: materials and modes that the device plays itself."""
        material, output, lacking, warnings, _ = self
        refused = material_rate_faults(name, material, output)
        if refused:  # nobody uses it yet; whoever does is refused
            return refused
        return [
            *(
                Problem(
                    path_text(("materials", name, *_PATH_BY_MODE.get(one.mode, (one.mode,)))),
                    above_rate(one.frequency_hz, one.shown_hz, output),
                )
                for one in lacking
                if (name, one.mode) not in played
            ),
            *warnings,
        ]


def above_rate(frequency_hz: float, shown_hz: float | None, output: Output) -> str:
    """What becomes of a frequency that the rate cannot carry."""
    shown = "it is silent" if shown_hz is None else f"it is shown at {shown_hz:g} Hz"
    return f"{frequency_hz:g} Hz is above {DISPLAYABLE * output.carried_hz:g} Hz, 0.4 of the rate: {shown}"


def change_warnings(
    objects: Mapping[str, SceneObject],
    sent: Collection[str],
    reports: Mapping[str, MaterialReport],
    root: Path,
    played: Collection[tuple[str, str]] = (),
) -> list[Problem]:
    """Of objects and materials that were sent, and of materials that these objects name, at most MAX_FAULTS.

    `objects` stand below `root`, the materials named in `sent` below `materials`; another material is reported where
    the first object names it. `reports` are those of all these materials; `played`: materials and modes that the device
    plays itself.
    """
    if not sent and all(_is_fine(item, reports) for item in objects.values()):
        return []
    found: list[Problem] = []
    places: dict[str, Path] = {}
    for id, item in objects.items():
        for name, inner in material_places(item):
            places.setdefault(name, (*root, id, *inner))
        if isinstance(item, Wall) and item.patches:
            found += patch_warnings(item, (*root, id))
    named = dict.fromkeys([*sent, *places])
    for name in islice(named, MAX_FAULTS):
        problems = reports[name].problems(name, played)
        # Of a material that stood elsewhere, the whole warning is what is wrong with naming it.
        found += problems if name in sent else [Problem(path_text(places[name]), str(each)) for each in problems]
    return found[:MAX_FAULTS]


def _is_fine(item: SceneObject, reports: Mapping[str, MaterialReport]) -> bool:
    """Whether there is surely nothing to report of an object."""
    if item.kind == "wall" and item.patches:
        return False
    return all(reports[name].fine for name in material_names(item))


def operator_warnings(waypoints: npt.NDArray[np.float64], workspace_m: float, where: str | None) -> list[Problem]:
    """Of waypoints, shape (n, 3), that the handle cannot follow, the first; `where` they came from, by default
    `waypoints` themselves."""
    beyond = np.abs(waypoints[:, 1:]).max(axis=1) > workspace_m
    if not beyond.any():
        return []
    first = int(np.argmax(beyond))
    x_m, y_m = waypoints[first, 1:]
    problem = f"[{x_m:g}, {y_m:g}] is beyond the stops of the handle, {workspace_m:g} m from the middle"
    return [Problem(f"waypoints[{first}]" if where is None else where, problem)]
