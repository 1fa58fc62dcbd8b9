"""Stability of a scene's contact sets, as `hapticd check` and offline runs report it."""

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
    """Stability of the contact sets of a scene, or the reason why the stability is unknown."""

    unknown: str | None
    """The reason, on one line; None if the stability is known."""
    assumed: Loop | None
    """The closed loop for which the stability was computed; None if the stability is unknown."""
    sets: int = 0
    unsafe: int = 0
    """Number of sets that are not proved safe."""
    worst: tuple[Margin, ...] = ()
    """Margins of up to MAX_REPORTED_SETS sets, the worst first: of sets not proved safe, or of all if requested."""

    @property
    def harmful(self) -> tuple[Margin, ...]:
        """Margins of the reported sets whose verdict is `unsafe`, without those whose safety is only unproved."""
        return tuple(margin for margin in self.worst if margin.verdict == "unsafe")

    def to_dict(self) -> dict[str, object]:
        """Return the map that `hapticd check --json` prints."""
        return {
            "unknown": self.unknown,
            "assumed": None if self.assumed is None else self.assumed.to_dict(),
            "sets": self.sets,
            "unsafe": self.unsafe,
            "worst": [margin.to_dict() for margin in self.worst],
        }

    def problems(self) -> list[Problem]:
        """Return a problem for each of the worst unsafe sets, and, if these are many, one with the number of others."""
        harmful = self.harmful
        found = [Problem(place_of(margin.objects), str(margin)) for margin in harmful[:MAX_STABILITY_LINES]]
        if len(harmful) > MAX_STABILITY_LINES:
            more = f"{self.unsafe - MAX_STABILITY_LINES} more sets of objects are not safe, see `hapticd check`"
            found.append(Problem("scene.objects", more))
        return found


def place_of(objects: Sequence[str]) -> str:
    """Return the configuration path of a contact set's first object, with the names of the other objects."""
    first, others = objects[0], objects[1:]
    place = path_text(("scene", "objects", first))
    if not others:
        return place
    more = f" and {len(others) - 2} more" if len(others) > 3 else ""
    return f"{place} with {', '.join(others[: 2 if more else 3])}{more}"


def sets_of(config: Config) -> ContactSets | None:
    """Return the contact sets of a configuration's scene, with the simulated joystick or with `device.handle`.

    Returns None if mass and damping of the handle are unknown.
    """
    loop = loop_of(config, config.servo.rate_hz)
    if loop is None:
        return None
    compiler = Compiler(output_of(config, config.servo.rate_hz))
    compiler.update(config.scene, config.scene.objects, config.materials, 1)
    return ContactSets(compiler.surfaces(), loop)


def evaluate(compiler: Compiler, scene: Scene, loop: Loop, unsafe: bool = True) -> Stability:
    """Return the stability of the compiled scene; `unsafe` limits the list `worst` to sets not proved safe."""
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
