"""The largest force and the largest speed of a run."""

from __future__ import annotations

import numpy as np

from hapticd.sweeps.columns import Column, Row
from hapticd.sweeps.point import Point


class PeakForce:
    """The largest magnitude of the commanded force, max |f|, in N."""

    columns = (Column("peak_force_n", "number", "measured", "N", "Largest magnitude of the commanded force."),)
    needs_run = True

    def of(self, point: Point) -> Row:
        """Return the largest force of all ticks of the run."""
        return {"peak_force_n": float(np.hypot(*point.run.samples["force_n"].T).max())}


class PeakSpeed:
    """The largest speed of the handle, max |v|, in m/s: its true speed, or in the open loop the estimated one."""

    columns = (Column("peak_speed_m_per_s", "number", "measured", "m/s", "Largest speed of the handle."),)
    needs_run = True

    def of(self, point: Point) -> Row:
        """Return the largest speed of all ticks of the run."""
        run = point.run
        velocity = run.samples["velocity_m_per_s"] if run.truth is None else run.truth[:, 2:]
        return {"peak_speed_m_per_s": float(np.hypot(*velocity.T).max())}
