"""What a measure is."""

from __future__ import annotations

from typing import Protocol

from hapticd.base.model import Model
from hapticd.sweeps.columns import Column, Row
from hapticd.sweeps.point import Point


class Measure(Protocol):
    """Something that is measured of a point."""

    @property
    def columns(self) -> tuple[Column, ...]:
        """What it fills."""

    @property
    def needs_run(self) -> bool:
        """Whether the point has to be run for it."""

    def of(self, point: Point) -> Row:
        """Its own columns. Raises HapticdError for what cannot be measured."""


class NoOptions(Model):
    """A measure without options."""
