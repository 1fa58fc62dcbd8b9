"""Filters of noise textures, designed for a rate, as a grid over speeds and forces."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Final, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.base.lattice import Reflection, reflection_of
from hapticd.base.steps import Steps
from hapticd.config.texture import Autoregressive, AutoregressiveModel, Stochastic
from hapticd.rendering.device_output import Output
from hapticd.rendering.displayability import displayed_pair
from hapticd.rendering.filter_design import stochastic_filter
from hapticd.rendering.resampling import resampled

Noise: TypeAlias = Stochastic | Autoregressive


class Design(NamedTuple):
    """The filters of a noise at the servo's rate, over tangential speed (m/s) and normal force (N)."""

    order: int
    taps: bool
    """Whether the filters have ladder taps."""
    speeds: tuple[float, ...]
    forces: tuple[float, ...]
    nodes: npt.NDArray[np.float64]
    """Array (speeds, forces, numbers): RMS in m/s^2, `order` reflection coefficients, with `taps` order + 1 taps."""
    muted: bool = False
    """Whether the noise is muted."""

    def numbers(self) -> npt.NDArray[np.float64]:
        """Return speeds, forces and nodes as the core's table holds them."""
        return np.concatenate((self.speeds, self.forces, self.nodes.ravel()))


MUTED_DESIGN: Final = Design(0, False, (0.0,), (0.0,), np.zeros((1, 1, 1)), True)
"""Design of a muted noise."""


class Model(NamedTuple):
    """Noise at one speed and force: an all-pole filter and the RMS of its output."""

    speed_m_per_s: float
    force_n: float
    reflection: Reflection
    rms_m_per_s2: float


def design(texture: Noise, output: Output) -> Steps[Design]:
    """Design the filters of a texture, one in each step (`yield`) of the computation.

    Steps of tens of milliseconds convert models that were identified at another rate.
    """
    if isinstance(texture, Autoregressive):
        for model in texture.models:
            _shown_model(model, texture.rate_hz, output.rate_hz)  # cached for the grid
            yield
        return _shown_grid(texture, output.rate_hz)
    pair = displayed_pair(texture, output)
    if pair is None:
        return MUTED_DESIGN
    shown = stochastic_filter(*pair, output.rate_hz)
    node = np.array([0.0, *shown.reflection, *(shown.taps or ())])
    return Design(len(shown.reflection), shown.taps is not None, (0.0,), (0.0,), node.reshape(1, 1, -1))


@lru_cache(maxsize=1024)
def _shown_model(model: AutoregressiveModel, from_rate_hz: float, to_rate_hz: float) -> Model:
    given = reflection_of(model.coefficients)
    other = resampled(given, from_rate_hz, to_rate_hz)
    rms = model.level(given) * math.sqrt(other.kept)
    return Model(model.speed_m_per_s, model.force_n, other.reflection, rms)


@lru_cache(maxsize=16)
def _shown_grid(texture: Autoregressive, rate_hz: float) -> Design:
    """Return the filters of a texture's models at a rate, cached as objects are often removed and added."""
    return grid([_shown_model(model, texture.rate_hz, rate_hz) for model in texture.models])


def grid(models: Sequence[Model]) -> Design:
    """Return the filters at the nodes of a grid: all speeds and all forces of the models, with the highest order.

    Each model is a node, with zeros beyond its own order (which do not change the model). A node without a model is a
    mean of all models, weighted by their inverse squared distance (Shepard, 1968) on axes scaled to their ranges. The
    weights are positive and add up to one, so the RMS stays within the models' range and every |k| below 1.
    """
    order = max(len(model.reflection) for model in models)
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
        # A mean must stay within its values despite rounding.
        nodes[row, free] = np.clip(blends, values.min(axis=0), values.max(axis=0))
    return Design(order, False, tuple(speeds.tolist()), tuple(forces.tolist()), nodes)
