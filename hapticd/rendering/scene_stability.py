"""How the contact sets of a scene stand, as it is reported: by `hapticd check` and by a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hapticd.base.errors import Problem, path_text
from hapticd.config.configuration import Config
from hapticd.config.scene import Scene, field_ids
from hapticd.rendering.compiler.table import Compiler
from hapticd.rendering.contact_sets import MAX_REPORTED_SETS, MAX_STABILITY_LINES, ContactSets
from hapticd.rendering.device_output import loop_of, output_of
from hapticd.rendering.stability import Loop, Margin
from hapticd.rendering.stability_remedy import with_remedy


@dataclass(frozen=True, slots=True)
class Stability:
    """How the sets of a scene stand, or why nobody knows."""

    unknown: str | None
    """One line; None: it is known."""
    assumed: Loop | None
    sets: int = 0
    unsafe: int = 0
    """How many are not safe."""
    worst: tuple[Margin, ...] = ()
    """Up to MAX_REPORTED_SETS, the least margin first: those that are not safe, or any where that was asked for."""

    @property
    def harmful(self) -> tuple[Margin, ...]:
        """Those that are more than unproved."""
        return tuple(margin for margin in self.worst if margin.verdict == "unsafe")

    def to_dict(self) -> dict[str, object]:
        """As `hapticd check --json` has it."""
        return {
            "unknown": self.unknown,
            "assumed": None if self.assumed is None else self.assumed.to_dict(),
            "sets": self.sets,
            "unsafe": self.unsafe,
            "worst": [margin.to_dict() for margin in self.worst],
        }

    def problems(self) -> list[Problem]:
        """A line for each set that is unsafe, and one for the rest of those that are reported."""
        harmful = self.harmful
        found = [Problem(place_of(margin.objects), str(margin)) for margin in harmful[:MAX_STABILITY_LINES]]
        if len(harmful) > MAX_STABILITY_LINES:
            more = f"{self.unsafe - MAX_STABILITY_LINES} more sets of objects are not safe, see `hapticd check`"
            found.append(Problem("scene.objects", more))
        return found


def place_of(objects: Sequence[str]) -> str:
    """Where a set stands in a configuration, and what acts with it."""
    first, others = objects[0], objects[1:]
    place = path_text(("scene", "objects", first))
    if not others:
        return place
    more = f" and {len(others) - 2} more" if len(others) > 3 else ""
    return f"{place} with {', '.join(others[: 2 if more else 3])}{more}"


def sets_of(config: Config) -> ContactSets | None:
    """The contact sets of a configuration's scene, with the simulated joystick or with `device.handle`; None: mass and
    damping of the handle are not known."""
    loop = loop_of(config, config.servo.rate_hz)
    if loop is None:
        return None
    compiler = Compiler(output_of(config, config.servo.rate_hz))
    compiler.update(config.scene, config.scene.objects, config.materials, 1)
    return ContactSets(compiler.surfaces(), loop)


def evaluate(compiler: Compiler, scene: Scene, loop: Loop, unsafe: bool = True) -> Stability:
    """The sets of a scene, which the compiler's table is made of. `unsafe`: report only sets that are not safe."""
    surfaces = compiler.surfaces()
    sets = ContactSets(surfaces, loop)
    found = sets.worst(MAX_REPORTED_SETS, unsafe=unsafe)
    everywhere = field_ids(scene.objects) if sets.fields else ()
    named = [((*compiler.names_of(slots), *everywhere), place) for slots, place in found]
    worst = (
        margin if margin.safe else with_remedy(margin, surfaces, loop, slots)
        for margin, (slots, _) in zip(sets.margins(named), found, strict=True)
    )
    return Stability(None, loop, len(sets), int((~sets.safe).sum()), tuple(worst))
