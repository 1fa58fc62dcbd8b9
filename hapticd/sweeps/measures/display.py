"""Displayed error of a material's tap: what handle and hand make of the waveform, in closed form, without a run."""

from __future__ import annotations

from pydantic import Field

from hapticd.base.errors import HapticdError
from hapticd.base.model import Model, Name
from hapticd.rendering.device_output import output_of
from hapticd.rendering.displayability import strike_error
from hapticd.sweeps.columns import Column, Row
from hapticd.sweeps.point import Point


class DisplayedErrorOptions(Model):
    """Which material."""

    material: Name = Field(description="A material with a tap of one mode.")
    name: Name = Field(default="displayed_error", description="Name of the column.")


class DisplayedError:
    """RMS difference of the handle's acceleration and the tap's waveform over the RMS of the waveform, 30 Hz to 0.4 of
    the rate (docs/accuracy.md), for a tap that begins at a tick and touches nothing; 0.1 is 10 %. None: the rate,
    or the link's, does not carry the mode."""

    needs_run = False

    def __init__(self, options: DisplayedErrorOptions) -> None:
        self._options = options
        what = f"Displayed error of a tap on {options.material}; 0.1 is 10 %."
        self.columns = (Column(options.name, "number", "measured", "", what),)

    def of(self, point: Point) -> Row:
        """With the configured handle, hand, rate, actuator and compensation. Raises HapticdError without a tap."""
        config, name = point.config, self._options.material
        material, output = config.materials.get(name), output_of(config, config.servo.rate_hz)
        if material is None or material.tap is None:
            raise HapticdError(f"{name} is no material with a tap")
        if output.dynamics is None:
            raise HapticdError("the displayed error is not known for a real joystick without device.handle")
        if material.tap.waveform is not None:
            raise HapticdError(f"the tap of {name} is a waveform, which has no mode")
        return {self._options.name: strike_error(material.tap.mode, output)}
