"""One point of a sweep: its configuration, operator and run, each computed when first used."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from hapticd.base.errors import HapticdError
from hapticd.base.yaml_source import Json
from hapticd.config.configuration import Config, load_config
from hapticd.config.operator import Operator, parse_operator
from hapticd.rendering.joystick import waypoints_of
from hapticd.rendering.offline import Run, render_run, simulate_run
from hapticd.sweeps.keys import Run as RunKind

OPERATOR_KEY: Final = "operator"
"""Key of the operator (the motion of the hand) in the document of a point."""
PARAMETERS_KEY: Final = "parameters"
"""Key of the free parameters in the document of a point."""
DURATION_KEY: Final = "duration_s"
"""Key of the duration of the run, in s, in the document of a point."""
NON_CONFIG_KEYS: Final = (OPERATOR_KEY, PARAMETERS_KEY, DURATION_KEY)
"""Keys in the document of a point that are not keys of a configuration."""


class Point:
    """A point of a sweep, computed from its document.

    The document has the keys of a configuration, and `operator`, `parameters` and `duration_s`.
    """

    def __init__(self, document: Mapping[str, Json], run: RunKind) -> None:
        self.run_kind = run
        self._document = document

    @cached_property
    def source(self) -> dict[str, Json]:
        """The configuration of the point as plain data, before validation."""
        return {key: value for key, value in self._document.items() if key not in NON_CONFIG_KEYS}

    @cached_property
    def config(self) -> Config:
        """The validated configuration of the point. Raises InvalidError if the configuration has faults."""
        return load_config(self.source)

    @property
    def operator_source(self) -> dict[str, Json] | None:
        """The operator (the motion of the hand) as plain data; None if the study has none."""
        given = self._document.get(OPERATOR_KEY)
        return given if isinstance(given, dict) else None

    @property
    def parameters(self) -> dict[str, Json]:
        """Free parameters of the point, which are not part of the configuration."""
        given = self._document.get(PARAMETERS_KEY)
        return given if isinstance(given, dict) else {}

    @cached_property
    def operator(self) -> Operator | None:
        """The validated operator (the motion of the hand); None if the study has none. Raises InvalidError."""
        given: Any = self._document.get(OPERATOR_KEY)
        return None if given is None else parse_operator(given)

    @property
    def rate_hz(self) -> float:
        """Rate of the servo, in ticks per second."""
        return self.config.servo.rate_hz

    @property
    def duration_s(self) -> float | None:
        """Duration of the run in s; None if the run lasts as long as the path of the operator."""
        found = self._document.get(DURATION_KEY)
        return float(found) if isinstance(found, int | float) else None

    @cached_property
    def waypoints(self) -> npt.NDArray[np.float64]:
        """The path of the hand, rows [t_s, x_m, y_m], shape (n, 3). Raises InvalidError, HapticdError."""
        operator = self.operator
        if operator is None:
            raise HapticdError("the study has no operator: a run needs one")
        return waypoints_of(operator, self.config)

    @cached_property
    def run(self) -> Run:
        """The run of the point: the closed loop with the simulated joystick, or with `run: render` the open loop.

        In the open loop, positions are those on the path of the hand. Raises InvalidError, HapticdError.
        """
        operator = self.operator
        if operator is None or self.run_kind == "none":
            raise HapticdError("the study has no run: it needs an operator, and run: simulate or render")
        if self.run_kind == "render":
            return render_run(self.config, self._positions())
        return simulate_run(
            self.config, self.waypoints, self.duration_s, interpolation=operator.interpolation, check_stability=False
        )

    def _positions(self) -> npt.NDArray[np.float64]:
        """Return the reference position of the hand at each of n ticks in m, (n, 2)."""
        duration_s = float(self.waypoints[-1, 0]) if self.duration_s is None else self.duration_s
        return self.hand_at(np.arange(max(1, round(duration_s * self.rate_hz))) / self.rate_hz)

    def hand_at(self, at_s: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Return the hand's reference positions in m, (n, 2), at n times in s. Raises InvalidError, HapticdError."""
        way = self.waypoints
        if self.operator is not None and self.operator.interpolation == "minimum_jerk":
            # 10 s^3 - 15 s^4 + 6 s^5 between two waypoints (Flash and Hogan 1985), as in the simulated hand.
            segment = np.clip(np.searchsorted(way[:, 0], at_s, side="right") - 1, 0, max(0, len(way) - 2))
            start, end = way[segment], way[np.minimum(segment + 1, len(way) - 1)]
            duration_s = np.maximum(end[:, 0] - start[:, 0], 1e-300)
            s = np.clip((at_s - start[:, 0]) / duration_s, 0.0, 1.0)[:, np.newaxis]
            return start[:, 1:] + (end - start)[:, 1:] * s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        return np.column_stack([np.interp(at_s, way[:, 0], way[:, axis]) for axis in (1, 2)])
