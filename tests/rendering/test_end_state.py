"""The end of a motion: written-out motions whose end is known, and a handle on a wall beyond its exact limit."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from bench.stability import LIGHT, on_wall
from bench.swept import STUDIES
from hapticd.base.yaml_source import load_path
from hapticd.config.dynamics import Dynamics
from hapticd.rendering.end_state import EndState, end_state
from hapticd.rendering.offline import CompiledScene, Simulation
from hapticd.rendering.stability import Loop, spectral_radius, timing

Floats = npt.NDArray[np.float64]
RATE_HZ = 500.0


def ends(speed: Callable[[Floats], Floats], longest_s: float = 640.0) -> EndState:
    """The end of a motion along x whose speed is written out as a function of time."""
    now = 0

    def advance(duration_s: float) -> Floats:
        nonlocal now
        count = round(duration_s * RATE_HZ)
        moved = np.zeros((count, 4))
        moved[:, 2] = speed((now + np.arange(count)) / RATE_HZ)
        now += count
        return moved

    return end_state(advance, longest_s)


def test_a_drop_on_the_way_into_a_cycle_is_no_rest() -> None:
    # It falls to a tenth of its speed within ten seconds, and then goes on for ever.
    found = ends(lambda t: (0.05 + 0.45 * np.exp(-t / 4.0)) * np.sin(40.0 * t))
    assert found.fate == "cycles"
    assert found.peak_m_per_s == pytest.approx(0.05, rel=1e-2)
    assert found.after_s < 640.0


@pytest.mark.parametrize("lasting_s", [0.5, 5.0, 30.0])
def test_a_decaying_motion_rests_however_slowly_it_decays(lasting_s: float) -> None:
    found = ends(lambda t: 0.1 * np.exp(-t / lasting_s) * np.sin(40.0 * t))
    assert found.fate == "rests"
    # From 0.1 to 1e-7 m/s.
    assert found.after_s == pytest.approx(lasting_s * math.log(1e6), abs=1.5)


def test_dry_friction_stops_it_at_once() -> None:
    assert ends(lambda t: np.maximum(0.1 - 0.001 * t, 0.0) * np.sin(40.0 * t)) == EndState("rests", 0.0, 101.0)


def test_an_undecided_motion_is_reported() -> None:
    assert ends(lambda t: 0.1 * np.exp(-t / 2000.0) * np.sin(40.0 * t)).fate == "falls"
    assert ends(lambda t: 0.01 * np.exp(t / 400.0) * np.sin(40.0 * t)).fate == "grows"


def test_a_cycle_that_is_not_regular_is_followed_to_the_end() -> None:
    random = np.random.default_rng(1)
    found = ends(lambda t: random.uniform(-0.1, 0.1, len(t)))
    assert (found.fate, found.after_s) == ("cycles", 640.0)


def test_a_constant_speed_is_rest() -> None:
    assert ends(lambda t: np.full(len(t), 0.1)).fate == "rests"


@pytest.mark.long
@pytest.mark.parametrize(("stiffness", "fate"), [(3500.0, "rests"), (4050.0, "cycles"), (8000.0, "cycles")])
def test_a_free_handle_rests_up_to_its_exact_limit_and_not_beyond(stiffness: float, fate: str) -> None:
    """0.04 kg with 0.2 N s/m at 10 kHz: of the exact sampled loop the radius passes 1 at 4,000.1 N/m."""
    base: Any = load_path(STUDIES / "stability_rate.yaml").data
    config = on_wall(base["base"], LIGHT, stiffness)
    loop = Loop(timing(10_000.0), Dynamics(0.04, 0.2, 0.0, 0.0, 0.0, 0.0), 0.0, 0.0, 100.0, 0.075)
    assert (float(spectral_radius(np.diag([stiffness, 0.0]), np.zeros((2, 2)), loop)) < 1.0 + 1e-9) == (fate == "rests")
    simulation = Simulation(CompiledScene(config), [[0.0, 0.0, 0.005], [0.08, 0.0, 0.005]])
    simulation.advance(0.3)
    assert end_state(simulation.advance).fate == fate
