"""The filters of textures that are noise, designed for a rate, and kept for a while after their use."""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from functools import lru_cache
from typing import Final, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.base.lattice import reflection_of
from hapticd.base.steps import Steps
from hapticd.config.texture import Autoregressive, AutoregressiveModel, Stochastic
from hapticd.rendering.device_output import Output
from hapticd.rendering.displayability import displayed_pair
from hapticd.rendering.filter_design import stochastic_filter
from hapticd.rendering.noise_grid import Model, grid
from hapticd.rendering.resampling import resampled


class Design(NamedTuple):
    """The filters of a noise at the servo's rate, over tangential speed (m/s) and normal force (N)."""

    order: int
    taps: bool
    speeds: tuple[float, ...]
    forces: tuple[float, ...]
    nodes: npt.NDArray[np.float64]
    """(speeds, forces, 1 + order, and order + 1 with taps): RMS in m/s^2, reflection coefficients, ladder taps."""
    muted: bool

    def numbers(self) -> npt.NDArray[np.float64]:
        return np.concatenate((self.speeds, self.forces, self.nodes.ravel()))


SILENCE: Final = Design(0, False, (0.0,), (0.0,), np.zeros((1, 1, 1)), True)


Noise: TypeAlias = Stochastic | Autoregressive
_KEPT: Final = 16 * 2**20
"""Bytes of designs that are kept after their use, of all outputs, and of what they were made of."""


def _bytes_of(texture: Noise) -> int:
    """About: a number of Python's and the reference to it have 32 bytes."""
    if isinstance(texture, Stochastic):
        return 512
    return sum(512 + 32 * len(model.coefficients) for model in texture.models)


class Designs:
    """Designs by what they are made of: materials come and go with the objects. For any thread."""

    def __init__(self) -> None:
        self._kept: OrderedDict[tuple[Noise, Output], tuple[Design, int]] = OrderedDict()
        """Each with its bytes."""
        self._bytes = 0
        self._lock = threading.Lock()

    def find(self, texture: Noise, output: Output) -> Design | None:
        with self._lock:
            found = self._kept.get((texture, output))
            if found is not None:
                self._kept.move_to_end((texture, output))
            return None if found is None else found[0]

    def keep(self, texture: Noise, output: Output, design: Design) -> None:
        """Keeps a design, and gives up those that were not asked for longest."""
        with self._lock:
            if (texture, output) not in self._kept:
                size = design.nodes.nbytes + _bytes_of(texture)
                self._kept[texture, output] = design, size
                self._bytes += size
            while self._bytes > _KEPT:
                self._bytes -= self._kept.popitem(last=False)[1][1]


designs: Final = Designs()


def design(texture: Noise, output: Output) -> Steps[Design]:
    """The filters of a texture, with a pause after each: that of a model identified at another rate takes tens of
    milliseconds."""
    found = designs.find(texture, output)
    if found is None:
        found = yield from _new_design(texture, output)
        designs.keep(texture, output, found)
    return found


def _new_design(texture: Noise, output: Output) -> Steps[Design]:
    if isinstance(texture, Stochastic):
        pair = displayed_pair(texture, output)
        if pair is None:
            return SILENCE
        shown = stochastic_filter(*pair, output.rate_hz)
        taps = () if shown.taps is None else shown.taps
        node = np.array([0.0, *shown.reflection, *taps])
        return Design(len(shown.reflection), bool(taps), (0.0,), (0.0,), node.reshape(1, 1, -1), False)
    models = []
    for model in texture.models:
        models.append(_shown_model(model, texture.rate_hz, output.rate_hz))
        yield
    order = max(len(model.reflection) for model in models)
    found = grid(models, order)
    return Design(order, False, found.speeds, found.forces, found.nodes, False)


@lru_cache(maxsize=1024)
def _shown_model(model: AutoregressiveModel, from_rate_hz: float, to_rate_hz: float) -> Model:
    given = reflection_of(model.coefficients)
    other = resampled(given, from_rate_hz, to_rate_hz)
    rms = model.level(given) * math.sqrt(other.kept)
    return Model(model.speed_m_per_s, model.force_n, other.reflection, rms)
