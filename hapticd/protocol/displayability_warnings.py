"""What of a message cannot be displayed as it was meant, told at its place in the message's params.

It is what `get_status` says of the scene (displayable.py), of no more than the message held.
"""

from collections.abc import Callable, Collection, Mapping
from itertools import islice
from typing import Final

import numpy as np
import numpy.typing as npt

from hapticd.base.errors import Path, Problem, path_text
from hapticd.base.model import MAX_FAULTS
from hapticd.config.materials import Material, Materials
from hapticd.config.scene import SceneObject, Wall, material_places
from hapticd.rendering.displayability import (
    DISPLAYABLE,
    material_rate_faults,
    material_warnings,
    patch_warnings,
    undisplayable,
)
from hapticd.rendering.output import Output
from hapticd.rendering.undisplayable import Use

_KEYS: Final[Mapping[Use, Path]] = {"second": ("tap", "second"), "groove": ("texture",)}
"""Where a mode stands in its material, if not under its own name."""


def above_rate(frequency_hz: float, shown_hz: float | None, output: Output) -> str:
    """What becomes of a frequency that the rate cannot carry."""
    shown = "it is silent" if shown_hz is None else f"it is shown at {shown_hz:g} Hz"
    return f"{frequency_hz:g} Hz is above {DISPLAYABLE * output.carried_hz:g} Hz, 0.4 of the rate: {shown}"


def change_warnings(
    objects: Mapping[str, SceneObject],
    sent: Collection[str],
    materials: Materials,
    output: Output,
    root: Path,
    played: Collection[tuple[str, str]] = (),
    working: Callable[[], None] = lambda: None,
) -> list[Problem]:
    """Of objects and materials that were sent, and of materials that these objects name, at most MAX_FAULTS.

    `objects` stand below `root`, the materials named in `sent` below `materials`; another material is told where the
    first object names it. `played`: materials and modes that the device plays by itself.
    """
    found: list[Problem] = []
    places: dict[str, Path] = {}
    for id, item in objects.items():
        for name, inner in material_places(item):
            places.setdefault(name, (*root, id, *inner))
        if isinstance(item, Wall) and item.patches:
            found += patch_warnings(item, (*root, id))
    named = {name: materials[name] for name in (*sent, *(name for name in places if name not in sent))}
    for name, material in islice(named.items(), MAX_FAULTS):
        working()
        told = _of_material(name, material, output, played)
        # Of a material that stood elsewhere, the whole warning is what is wrong with naming it.
        found += told if name in sent else [Problem(path_text(places[name]), str(problem)) for problem in told]
    return found[:MAX_FAULTS]


def _of_material(name: str, material: Material, output: Output, played: Collection[tuple[str, str]]) -> list[Problem]:
    refused = material_rate_faults(name, material, output)
    if refused:  # nobody uses it yet; whoever does is refused
        return refused
    lacking = [one for one in undisplayable({name: material}, output) if (name, one.mode) not in played]
    return [
        *(
            Problem(
                path_text(("materials", name, *_KEYS.get(one.mode, (one.mode,)))),
                above_rate(one.frequency_hz, one.shown_hz, output),
            )
            for one in lacking
        ),
        *material_warnings(name, material, output),
    ]


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
