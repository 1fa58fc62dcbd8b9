"""The energy that touched surfaces gave to the hand, as docs/passivity.md counts it."""

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
from hapticd.sweeps.measures.measure import NoOptions
from hapticd.sweeps.point import Point

Floats = npt.NDArray[np.float64]
_PERIOD_TOLERANCE: Final = 1e-9
"""An age of so little more than a whole number of periods is that number."""


def given_j(force_n: Floats, position_m: Floats, touched: npt.NDArray[np.bool_], together: int = 0) -> float:
    """The largest sum of f.(x' - x) over one contact, J; 0 where no sum is ever above 0.

    A force f acts while the position goes from x to x', also after the last tick of the contact. `force_n` and
    `position_m` have shape (n, 2), `touched` (n,). Contacts that are no more than `together` ticks apart are one.
    """
    steps = np.zeros(len(force_n))
    steps[1:] = (force_n[:-1] * np.diff(position_m, axis=0)).sum(1)
    largest = 0.0
    edges = np.flatnonzero(np.diff(np.concatenate(([0], touched.astype(np.int8), [0]))))
    apart = np.flatnonzero(edges[2::2] - edges[1:-1:2] > together) if len(edges) else edges
    edges = np.concatenate((edges[:1], np.stack((edges[1 + 2 * apart], edges[2 + 2 * apart]), 1).ravel(), edges[-1:]))
    for begin, end in edges.reshape(-1, 2):
        sums = np.cumsum(steps[begin + 1 : end + 1])
        if len(sums):
            largest = max(largest, float(sums.max()))
    return largest


class EnergyGiven:
    """The most that the surfaces had given to the hand, less what they had taken, at any time of one contact.

    The sum of f.(x' - x), f the force of the touched objects as it is commanded (after the limit, without vibration)
    and x the handle's own position; of the open loop, x is the position on the hand's way.
    """

    columns = (
        Column(
            "energy_given_j",
            "number",
            "measured",
            "J",
            "Most energy that the touched surfaces gave to the hand beyond what they took, in one contact.",
        ),
    )
    needs_run = True

    def __init__(self, _: NoOptions) -> None: ...

    def of(self, point: Point) -> Row:
        """Of all contacts of the run. Raises HapticdError where fields act, whose force the samples do not tell."""
        config, run = point.config, point.run
        fields = field_ids(config.scene.objects)
        if fields:
            raise HapticdError(
                f"energy_given is of surfaces: the force of the field {fields[0]} is in the same sum, leave it out"
            )
        whole = run.samples["contact_force_n"]
        pushes = [each.force_n for each in config.scene.objects.values() if isinstance(each, Constant)]
        force = whole - np.sum(pushes, axis=0) if pushes else whole.copy()
        size = np.hypot(*whole.T)
        over = size > config.device.max_force_n
        force[over] *= (config.device.max_force_n / size[over])[:, np.newaxis]
        position = run.samples["position_m"] if run.truth is None else run.truth[:, :2]
        # What a late position hides: a contact of the handle's own that the reports see later.
        age = 0 if run.truth is None else output_of(config, run.rate_hz).age_s * run.rate_hz
        touched = (run.samples["flags"] & Flag.CONTACT) != 0
        return {"energy_given_j": given_j(force, position, touched, math.ceil(age - _PERIOD_TOLERANCE))}
