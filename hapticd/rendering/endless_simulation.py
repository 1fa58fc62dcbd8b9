"""The closed loop of the tick and the simulated joystick for as long as is asked, and how its motion ends."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from hapticd.base.core import SAMPLE_DTYPE, Status, ffi, invalid_reason, lib, pointer, records
from hapticd.base.errors import HapticdError
from hapticd.config.configuration import Config
from hapticd.rendering.compiler.table import Compiler
from hapticd.rendering.device_output import output_of
from hapticd.rendering.end_state import EndState, end_state
from hapticd.rendering.joystick import new_operator, new_sim
from hapticd.rendering.offline import Samples, new_state_of, new_world

_STRETCH: Final = 4096
"""Ticks of a call of the core."""
RESTED_S: Final = 0.2
"""A motion is judged from so long after the hand's last waypoint on."""


class EndlessSimulation:
    """A loop that begins as `hapticd.simulate` and goes on where it was. Raises HapticdError as that does."""

    def __init__(
        self,
        config: Config,
        waypoints: Sequence[Sequence[float]],
        interpolation: Literal["linear", "minimum_jerk"] = "linear",
    ) -> None:
        """`waypoints` are rows [t_s, x_m, y_m] of the hand."""
        rate_hz = config.servo.rate_hz
        compiler = Compiler(output_of(config, rate_hz))
        self._world = new_world(compiler.update(config.scene, config.scene.objects, config.materials, 1))
        self._state = new_state_of(len(config.scene.objects))
        lib.hd_state_set_resolution(self._state, config.device.sim.encoder_step_m)
        self._sim = new_sim(config.device.sim, rate_hz)
        self._hand = new_operator(waypoints, interpolation)
        lib.hd_sim_operate(self._sim, self._hand)
        lib.hd_sim_settle(self._sim)
        self._rate_hz = rate_hz
        self._room = records(SAMPLE_DTYPE, _STRETCH)
        self._found = ffi.new("size_t *")

    def go_on(self, duration_s: float) -> npt.NDArray[np.float64]:
        """The handle's position (m) and velocity (m/s) at the ticks to come, (n, 4)."""
        truth = np.empty((self._ticks(duration_s), 4))
        for begin in range(0, len(truth), _STRETCH):
            part = truth[begin : begin + _STRETCH]
            self._run(part, self._room[: len(part)])
        return truth

    def recorded(self, duration_s: float) -> tuple[npt.NDArray[np.float64], Samples]:
        """As go_on, with the samples of the same ticks, (n,) of SAMPLE_DTYPE."""
        count = self._ticks(duration_s)
        truth, samples = np.empty((count, 4)), records(SAMPLE_DTYPE, count)
        self._run(truth, samples)
        return truth, samples

    def _ticks(self, duration_s: float) -> int:
        return max(1, round(duration_s * self._rate_hz))

    def _run(self, truth: npt.NDArray[np.float64], samples: Samples) -> None:
        status = lib.hd_simulate(
            self._world,
            self._state,
            self._sim,
            len(truth),
            pointer("struct hd_sample[]", samples),
            pointer("double[]", truth),
            ffi.NULL,
            0,
            self._found,
        )
        if status != Status.OK:
            raise HapticdError(f"the scene cannot be rendered: {invalid_reason()}")


def end_of(
    config: Config,
    waypoints: Sequence[Sequence[float]],
    longest_s: float = 640.0,
    interpolation: Literal["linear", "minimum_jerk"] = "linear",
) -> EndState:
    """How the motion of the handle ends once the hand's reference rests, as end_state judges it."""
    simulation = EndlessSimulation(config, waypoints, interpolation)
    simulation.go_on(waypoints[-1][0] + RESTED_S)
    return end_state(simulation.go_on, longest_s)
