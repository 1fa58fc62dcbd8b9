"""The reference of bench/joystick.py against an integrator of its own, and the order of what it judges."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bench import joystick
from bench.peers import Peers, compiled
from bench.report import Floats


@pytest.fixture(scope="module")
def peers() -> Peers:
    return compiled()


def reference(time_s: float) -> tuple[float, float]:
    points = joystick.WAYPOINTS
    inside = np.searchsorted(points[:, 0], time_s, side="right") - 1
    if inside >= len(points) - 1:
        return float(points[-1, 1]), 0.0
    (t0, w0), (t1, w1) = points[inside], points[inside + 1]
    rate = (w1 - w0) / (t1 - t0)
    return float(w0 + rate * (time_s - t0)), float(rate)


def integrated(handle: joystick.Handle) -> Floats:
    """Positions every millisecond without friction, one stretch between knots after the other."""
    knots = joystick.Closed(handle).knots
    out = [0.0]
    state = np.zeros(2)
    for begin, end in pairwise(knots):
        push = joystick.PULSE_N if joystick.PULSE_S[0] <= begin < joystick.PULSE_S[1] else 0.0

        def slope(time_s: float, y: Floats, begin: float = begin, push: float = push) -> list[float]:
            w, rate = reference(begin + 1e-9)
            w += rate * (time_s - begin - 1e-9)
            pull = handle.hand_stiffness_n_per_m * (w - y[0]) + handle.hand_damping_n_s_per_m * (rate - y[1])
            return [y[1], (push + pull - handle.damping_n_s_per_m * y[1]) / handle.mass_kg]

        times = np.arange(round(begin * 1000) + 1, round(end * 1000) + 1) / 1000
        found = solve_ivp(slope, (begin, times[-1]), state, t_eval=times, rtol=1e-11, atol=1e-14, method="DOP853")
        out += found.y[0].tolist()
        state = found.y[:, -1]
    return np.array(out)


@pytest.mark.parametrize("name", ["a hand draws it", "light and firm"])
def test_the_closed_form_solves_the_equation(name: str) -> None:
    handle = joystick.HANDLES[name]
    assert joystick.Closed(handle).at(1000.0) == pytest.approx(integrated(handle), abs=1e-11)


@pytest.mark.slow
def test_with_friction_it_is_what_small_steps_go_to(peers: Peers) -> None:
    handle = joystick.HANDLES["the same with 0.2 N of friction"]
    truth = joystick.Closed(handle).at(1000.0)
    rate = 640_000.0
    small = joystick.path_of(peers, joystick.ways(peers)["Runge-Kutta, 4th order"], handle, rate)[::640]
    assert small == pytest.approx(truth, abs=1e-8)
    # It has stuck, and it has turned.
    assert np.any(np.diff(truth[5:]) == 0)
    assert np.any(np.diff(truth) < 0)


@pytest.mark.slow
def test_the_core_is_exact_and_the_others_have_their_order(peers: Peers) -> None:
    handle = joystick.HANDLES["a hand draws it"]
    errors = {}
    for rate in (1000.0, 2000.0):
        truth = joystick.Closed(handle).at(rate)
        for name, way in joystick.ways(peers).items():
            errors[name, rate] = float(np.abs(joystick.path_of(peers, way, handle, rate) - truth).max())
    assert max(errors[joystick.OURS, rate] for rate in (1000.0, 2000.0)) < 1e-15
    for name, order in ((joystick.FLOOR, 1), ("semi-implicit Euler", 1), ("Runge-Kutta, 4th order", 4)):
        assert errors[name, 1000.0] / errors[name, 2000.0] == pytest.approx(2**order, rel=0.15)
