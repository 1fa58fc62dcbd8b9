"""The closed loop against its continuous closed form: the error falls with T as the order of the hold says."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest

from bench.closed_loop import LOOPS, RATES_HZ, Continuous, Loop, error, order, placed, simulated, without_hold
from tests.support.marks import rest_slow


def matrix_exponential(loop: Loop, time_s: float) -> tuple[float, float, float]:
    """Position, velocity and wall force at one time, with 30 digits: exp(A t) of [y, v, w, w'] from event to event."""
    with mpmath.workdps(30):
        mass = mpmath.mpf(loop.mass)

        def flow(state: mpmath.matrix, inside: bool, lasting: mpmath.mpf) -> mpmath.matrix:
            stiffness = loop.hand_stiffness + mpmath.mpf(loop.stiffness if inside else 0)
            damping = loop.handle_damping + mpmath.mpf(loop.hand_damping) + (loop.damping if inside else 0)
            force = [-stiffness / mass, -damping / mass, loop.hand_stiffness / mass, loop.hand_damping / mass]
            return mpmath.expm(mpmath.matrix([[0, 1, 0, 0], force, [0, 0, 0, 1], [0] * 4]) * lasting) * state

        begin = mpmath.matrix([loop.start, 0, loop.start, -loop.speed])
        onset = mpmath.findroot(lambda t: flow(begin, False, t)[0], (0.03, 0.1), solver="anderson", tol=1e-40)
        time = mpmath.mpf(time_s)
        state = flow(begin, False, min(time, onset))
        if time > onset:
            state = flow(state, True, min(time, mpmath.mpf(loop.moving_s)) - onset)
        if time > loop.moving_s:
            state[3] = 0
            state = flow(state, True, time - loop.moving_s)
        force = -loop.stiffness * state[0] - loop.damping * state[1] if time > onset else mpmath.mpf(0)
        return float(state[0]), float(state[1]), float(force)


@pytest.mark.slow
@pytest.mark.parametrize("loop", LOOPS.values(), ids=LOOPS)
def test_closed_form_is_that_of_the_differential_equation(loop: Loop) -> None:
    times = np.array([0.01, 0.05, 0.07, 0.11, 0.1205, 0.15])
    found = np.array(Continuous(loop).at(times)).T
    expected = [matrix_exponential(loop, time_s) for time_s in times]
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-13)
    force = Continuous(loop).at(np.linspace(0, loop.duration_s, 10_001))[2]
    after = np.linspace(0, loop.duration_s, 10_001) > Continuous(loop).onset_s
    assert (force[after] > 0).all(), "it lets go of the wall, which the closed form does not know"


@pytest.mark.parametrize("rate_hz", RATES_HZ)
def test_the_handle_before_the_onset_is_the_closed_form(rate_hz: float) -> None:
    loop = Loop(800.0, 2.0)
    time_s, y, force = simulated(loop, rate_hz)
    truth = Continuous(loop)
    before = time_s <= truth.onset_s
    np.testing.assert_allclose(y[before], truth.at(time_s[before])[0], rtol=0, atol=1e-15)
    assert not force[before].any()
    assert force[~before].all()


@pytest.mark.long
@pytest.mark.parametrize("loop", rest_slow(LOOPS.values()), ids=LOOPS)
def test_error_falls_with_the_first_order_of_the_period(loop: Loop) -> None:
    errors = [error(loop, rate) for rate in RATES_HZ]
    for name in ("force_n", "penetration_m", "held_n"):
        values = [getattr(e, name) for e in errors]
        assert order(RATES_HZ, values) == pytest.approx(1.0, abs=0.1), name
        assert values == sorted(values, reverse=True), name


@pytest.mark.long
@pytest.mark.parametrize("stiffness", rest_slow([400.0, 800.0, 2000.0]))
def test_a_held_force_is_half_a_period_old(stiffness: float) -> None:
    """K T/2 of negative damping explains the first order: the rest is of second order, and far smaller."""
    loop = Loop(stiffness)
    left = [without_hold(loop, rate) for rate in RATES_HZ]
    assert order(RATES_HZ, left) == pytest.approx(2.0, abs=0.2)
    assert left[-1] < 0.02 * error(loop, RATES_HZ[-1]).penetration_m


@pytest.mark.long
def test_reports_one_tick_old_make_it_three_halves() -> None:
    loop = Loop(800.0)
    for rate in RATES_HZ:
        times = error(loop, rate, delay_periods=1).penetration_m / error(loop, rate).penetration_m
        assert times == pytest.approx(3.0, rel=0.1)


@pytest.mark.parametrize("rate_hz", RATES_HZ)
def test_an_onset_between_ticks_is_answered_at_the_next(rate_hz: float) -> None:
    for phase in range(0, 16, 5):
        loop = placed(Loop(800.0, 2.0), rate_hz, phase)
        time_s, y, force = simulated(loop, rate_hz)
        first = int(np.argmax(force > 0))
        assert 0 <= time_s[first] - Continuous(loop).onset_s <= 1 / rate_hz
        # Its force is that of the model at the handle's place, with the speed of the last step.
        approach = (y[first - 1] - y[first]) * rate_hz
        assert force[first] == pytest.approx(-800.0 * y[first] + 2.0 * approach, rel=1e-9)
