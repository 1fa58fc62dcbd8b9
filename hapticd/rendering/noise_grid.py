"""Models of noise at some speeds and forces, as a grid over all of them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hapticd.base.lattice import Reflection
from hapticd.rendering.filter_design import Array


@dataclass(frozen=True, slots=True)
class Model:
    """What noise was identified at one speed and force: an all-pole filter and the RMS of its output."""

    speed_m_per_s: float
    force_n: float
    reflection: Reflection
    rms_m_per_s2: float


@dataclass(frozen=True, slots=True)
class Grid:
    """Rising `speeds` (m/s) and `forces` (N); `nodes` [speeds][forces][1 + order]: RMS (m/s^2), then k_1 .. k_order."""

    speeds: tuple[float, ...]
    forces: tuple[float, ...]
    nodes: Array


def grid(models: Sequence[Model], order: int) -> Grid:
    """The grid on all speeds and forces at which there are models, validated: none is of a higher order than `order`.

    A model is its node, with zeros after its own order (which do not change it). A node without a model is a mean of
    all of them, weighted by the inverse square of their distance (Shepard, 1968) on axes scaled to their ranges: the
    weights are positive and add up to one, so that the RMS stays within what was given and every |k| below 1.
    """
    places = np.array([(model.speed_m_per_s, model.force_n) for model in models])
    speeds, rows = np.unique(places[:, 0], return_inverse=True)
    forces, columns = np.unique(places[:, 1], return_inverse=True)
    given = np.zeros((len(speeds), len(forces)), dtype=np.bool_)
    given[rows, columns] = True
    values = np.zeros((len(models), 1 + order))
    for value, model in zip(values, models, strict=True):
        value[0] = model.rms_m_per_s2
        value[1 : 1 + len(model.reflection)] = model.reflection
    nodes = np.empty((len(speeds), len(forces), 1 + order))
    nodes[rows, columns] = values
    scale = np.array([float(np.ptp(axis)) or 1.0 for axis in (speeds, forces)])
    for row in range(len(speeds)):
        free = np.flatnonzero(~given[row])
        away = (places[:, None] - np.stack(np.broadcast_arrays(speeds[row], forces[free]), axis=-1)) / scale
        distance = np.maximum(np.hypot(away[..., 0], away[..., 1]), np.finfo(np.float64).tiny)
        weights = (distance.min(axis=0) / distance) ** 2
        blends = (weights / weights.sum(axis=0)).T @ values
        # Rounding must not carry a mean past what it is the mean of.
        nodes[row, free] = np.clip(blends, values.min(axis=0), values.max(axis=0))
    return Grid(tuple(speeds.tolist()), tuple(forces.tolist()), nodes)
