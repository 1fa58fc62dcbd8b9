"""The quantile over time of a field of the samples."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, StringConstraints

from hapticd.base.model import CheckedTogether
from hapticd.config.schema import unit_of
from hapticd.sweeps.columns import Column, Row
from hapticd.sweeps.point import Point


class QuantileOptions(CheckedTogether):
    """Options of the measure `quantile`."""

    field: Literal["position_m", "velocity_m_per_s", "contact_force_n", "vibration_force_n", "force_n"] = Field(
        description="A field of the samples of telemetry."
    )
    axis: Literal["x", "y", "magnitude"] = Field(
        default="magnitude", description="Component of the field, or its magnitude."
    )
    q: float = Field(ge=0, le=1, description="Quantile from 0 (smallest) over 0.5 (median) to 1 (largest).")
    name: Annotated[str, StringConstraints(min_length=1, max_length=64)] | None = Field(
        default=None, description="Name of the column; by default made of the options."
    )


class Quantile:
    """The quantile q of a field over the ticks of a run, with linear interpolation between two values."""

    needs_run = True

    def __init__(self, options: QuantileOptions) -> None:
        self._options = options
        self._name = options.name or f"{options.field}_{options.axis}_q{100 * options.q:g}"
        what = f"Quantile {options.q:g} of {options.field}, {options.axis}."
        self.columns = (Column(self._name, "number", "measured", unit_of(options.field) or "", what),)

    def of(self, point: Point) -> Row:
        """Return the quantile over all ticks of the point's run."""
        values = point.run.samples[self._options.field]
        axis = self._options.axis
        taken = np.hypot(*values.T) if axis == "magnitude" else values[:, "xy".index(axis)]
        return {self._name: float(np.quantile(taken, self._options.q))}
