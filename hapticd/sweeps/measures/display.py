"""Displayed error of a material's tap: how handle and hand distort its waveform, in closed form."""

from __future__ import annotations

from pydantic import Field

from hapticd.base.errors import HapticdError
from hapticd.base.model import Model, Name
from hapticd.rendering.device_output import output_of
from hapticd.rendering.displayability import strike_error
from hapticd.sweeps.columns import Column, Row
from hapticd.sweeps.point import Point


class DisplayedErrorOptions(Model):
    """Options of the measure `displayed_error`."""

    material: Name = Field(description="A material with a tap of one mode.")
    name: Name = Field(default="displayed_error", description="Name of the column.")


class DisplayedError:
    """RMS difference of the handle's acceleration and the tap's waveform, as a fraction of the RMS of the waveform.

    The error is computed from 30 Hz to 0.4 of the rate of servo or link (docs/accuracy.md), for a tap that begins at a
    tick, or at any time within a frame of a slower link, while nothing is touched. It is None if the frequency of the
    mode is too high for these rates.
    """

    needs_run = False

    def __init__(self, options: DisplayedErrorOptions) -> None:
        self._options = options
        what = f"Displayed error of a tap on {options.material}; 0.1 is 10 %."
        self.columns = (Column(options.name, "number", "measured", "", what),)

    def of(self, point: Point) -> Row:
        """Return the displayed error with the configured handle, hand, rate, actuator and compensation.

        Raises HapticdError if the material has no tap of one mode, or the handle is unknown.
        """
        config, name = point.config, self._options.material
        material, output = config.materials.get(name), output_of(config, config.servo.rate_hz)
        if material is None or material.tap is None:
            raise HapticdError(f"displayed_error: {name} is not a material with a tap")
        if output.dynamics is None:
            raise HapticdError("displayed_error: a real joystick needs device.handle")
        if material.tap.waveform is not None:
            raise HapticdError(f"displayed_error: the tap of {name} is a waveform, must be a mode")
        return {self._options.name: strike_error(material.tap.mode, output)}
