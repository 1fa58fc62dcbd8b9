"""The energy that touched surfaces gave to the hand, by the definition of docs/passivity.md."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from hapticd.base.core import Flag
from hapticd.base.errors import HapticdError
from hapticd.config.scene import Constant, field_ids
from hapticd.rendering.device_output import output_of
from hapticd.sweeps.columns import Column, Row
from hapticd.sweeps.point import Point

Floats = npt.NDArray[np.float64]
_PERIOD_TOLERANCE: Final = 1e-9
"""Tolerance in periods: an age of positions that exceeds an integer by at most this is not rounded up."""


def given_j(force_n: Floats, position_m: Floats, touched: npt.NDArray[np.bool_], max_gap_ticks: int = 0) -> float:
    """Return the largest energy that one contact had given to the hand at any tick, in J, at least 0.

    The energy is the sum of f.(x' - x) from the contact's first tick. The force f acts while the position changes
    from x to x'; that of the contact's last tick counts, too. `force_n` and `position_m` have shape (n, 2),
    `touched` (n,). Gaps of at most `max_gap_ticks` end no contact.
    """
    steps = np.zeros(len(force_n))
    steps[1:] = (force_n[:-1] * np.diff(position_m, axis=0)).sum(1)
    largest = 0.0
    edges = np.flatnonzero(np.diff(np.concatenate(([0], touched.astype(np.int8), [0]))))
    gaps = np.flatnonzero(edges[2::2] - edges[1:-1:2] > max_gap_ticks) if len(edges) else edges
    edges = np.concatenate((edges[:1], np.stack((edges[1 + 2 * gaps], edges[2 + 2 * gaps]), 1).ravel(), edges[-1:]))
    for begin, end in edges.reshape(-1, 2):
        sums = np.cumsum(steps[begin + 1 : end + 1])
        if len(sums):
            largest = max(largest, float(sums.max()))
    return largest


class EnergyGiven:
    """The largest net energy, in J, that surfaces had given to the hand at any time of one contact.

    The energy is the sum of f.(x' - x) over ticks. f is the commanded force of the touched objects after the force
    limit, without vibration. x is the true position of the handle, or in the open loop the position on the hand's path.
    """

    columns = (
        Column(
            "energy_given_j",
            "number",
            "measured",
            "J",
            "Largest net energy that the touched surfaces gave to the hand in one contact.",
        ),
    )
    needs_run = True

    def of(self, point: Point) -> Row:
        """Return the largest energy of all contacts of the point's run.

        Raises HapticdError if the scene has fields: samples have only the total force.
        """
        config, run = point.config, point.run
        fields = field_ids(config.scene.objects)
        if fields:
            raise HapticdError(
                f"energy_given: the scene must not have fields, has {fields[0]}: samples have only the total force"
            )
        contact = run.samples["contact_force_n"]
        pushes = [each.force_n for each in config.scene.objects.values() if isinstance(each, Constant)]
        force = contact - np.sum(pushes, axis=0) if pushes else contact.copy()
        size = np.hypot(*contact.T)
        over = size > config.device.max_force_n
        force[over] *= (config.device.max_force_n / size[over])[:, np.newaxis]
        position = run.samples["position_m"] if run.truth is None else run.truth[:, :2]
        # Reported positions are late: a true contact of the handle may continue while the reports show a gap.
        age = 0 if run.truth is None else output_of(config, run.rate_hz).age_s * run.rate_hz
        touched = (run.samples["flags"] & Flag.CONTACT) != 0
        return {"energy_given_j": given_j(force, position, touched, math.ceil(age - _PERIOD_TOLERANCE))}
