"""The materials that a joystick design can display, as a criterion for choosing its components."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, Strict

from hapticd.base.errors import HapticdError
from hapticd.base.model import Model, Name
from hapticd.config.configuration import Config
from hapticd.config.materials import Material
from hapticd.config.modes import Mode
from hapticd.config.scene import Scene, Wall
from hapticd.rendering.device_output import Output, output_of
from hapticd.rendering.displayability import strike_error, struck_shapes, touched_by
from hapticd.rendering.scene_stability import sets_of
from hapticd.sweeps.columns import Column, Row
from hapticd.sweeps.point import Point


class DisplayedMaterialsOptions(Model):
    """Options of the measure `displayed_materials`."""

    materials: Annotated[tuple[Name, ...], Strict(False), Field(min_length=1, max_length=100)] = Field(
        description="Materials with a tap of one mode."
    )
    error_at_most: Annotated[float, Field(gt=0, le=10)] = Field(
        default=0.2, description="Largest displayed error of a tap; 0.2 is 20 %."
    )
    speed_m_per_s: Annotated[float, Field(gt=0, le=10)] = Field(
        default=0.1, description="Speed of a tap whose force must stay below the force limit."
    )


class DisplayedMaterials:
    """Counts the materials that are displayed, and gives a reason for each material that is not.

    A material is displayed if a wall of it is stable in every hand (docs/stability.md), the rate is high enough for its
    tap, the displayed error of the tap (docs/accuracy.md) is at most `error_at_most`, and the vibration force of a tap
    at `speed_m_per_s` does not exceed device.max_force_n.
    """

    columns = (
        Column("suffices", "boolean", "measured", "", "Whether every material is displayed."),
        Column("displayed", "integer", "measured", "", "Number of materials that are displayed."),
        Column("worst_error", "number", "measured", "", "Largest displayed error of the taps that the rate allows."),
        Column("needed_force_n", "number", "measured", "N", "Largest force of the taps that the rate allows."),
        Column("not_displayed", "text", "measured", "", "Materials that are not displayed, by their first reason."),
    )
    needs_run = False

    def __init__(self, options: DisplayedMaterialsOptions) -> None:
        self._options = options

    def of(self, point: Point) -> Row:
        """Count materials with the configured handle, hand, rate, encoder, actuator, force limit and compensation.

        Raises HapticdError for a material without a tap of one mode, and for a device with an unknown handle.
        """
        config = point.config
        output = output_of(config, config.servo.rate_hz)
        if output.dynamics is None:
            raise HapticdError("displayed_materials: a real joystick needs device.handle")
        errors: list[float] = []
        forces: list[float] = []
        missing: dict[str, list[str]] = {}
        walls: dict[str, bool] = {}
        """Whether a wall is stable, by its material without the tap, since many materials differ only in the tap."""
        for name in self._options.materials:
            material = config.materials.get(name)
            mode = None if material is None or material.tap is None else material.tap.one_mode
            if material is None or mode is None:
                raise HapticdError(f"displayed_materials: {name} is not a material with a tap of one mode")
            shown = _shown(material, mode, output, self._options.speed_m_per_s)
            if shown is not None:
                errors.append(shown[0])
                forces.append(shown[1])
            surface = material.model_copy(update={"tap": None}).model_dump_json()
            if surface not in walls:
                walls[surface] = _is_stable(config, name)
            fault = self._fault(config.device.max_force_n, walls[surface], shown)
            if fault is not None:
                missing.setdefault(fault[0], []).append(f"{name}{fault[1]}")
        count = sum(map(len, missing.values()))
        return {
            "suffices": count == 0,
            "displayed": len(self._options.materials) - count,
            "worst_error": max(errors, default=None),
            "needed_force_n": max(forces, default=None),
            "not_displayed": "; ".join(f"{reason}: {', '.join(names)}" for reason, names in missing.items()) or None,
        }

    def _fault(self, max_force_n: float, is_stable: bool, shown: tuple[float, float] | None) -> tuple[str, str] | None:
        """Return why a material is not displayed, and the value that is too large; None if it is displayed."""
        if not is_stable:
            return "may oscillate", ""
        if shown is None:
            return "rate too low", ""
        error, force_n = shown
        if error > self._options.error_at_most:
            return "error", f" {100 * error:.0f} %"
        return ("force", f" {force_n:.2g} N") if force_n > max_force_n else None


def _shown(material: Material, mode: Mode, output: Output, speed_m_per_s: float) -> tuple[float, float] | None:
    """Return displayed error and maximum force in N of a tap; None if the frequency of the tap is too high."""
    error = strike_error(mode, output)
    if error is None:
        return None
    assert material.tap is not None and output.dynamics is not None
    amplitude = material.tap.coefficient(material.tap.amplitude_m_per_s2(speed_m_per_s))
    shapes = struck_shapes(mode, output, touched_by(material, "tap"))
    if shapes is None:
        return error, output.effective_mass_kg * amplitude * mode.peak
    return error, float(output.dynamics.mass_kg * amplitude * max(shape.peak for shape in shapes))


def _is_stable(config: Config, name: str) -> bool:
    """Return whether a wall of a material is stable in every hand."""
    wall = Wall(kind="wall", point_m=(0.0, 0.0), normal=(0.0, 1.0), material=name)
    sets = sets_of(config.model_copy(update={"scene": Scene(objects={"wall": wall})}))
    assert sets is not None  # the handle is known
    return bool((sets.factor >= 1.0).all())
