"""The interface of a measure."""

from __future__ import annotations

from typing import Protocol

from hapticd.base.model import Model
from hapticd.sweeps.columns import Column, Row
from hapticd.sweeps.point import Point


class Measure(Protocol):
    """One or more quantities that are measured at a point."""

    @property
    def columns(self) -> tuple[Column, ...]:
        """The columns of the quantities that the measure returns."""

    @property
    def needs_run(self) -> bool:
        """Whether the measure needs the run of the point."""

    def of(self, point: Point) -> Row:
        """Measure a point and return the values of `columns`. Raises HapticdError if the point cannot be measured."""


class NoOptions(Model):
    """The empty options of a measure without options."""
