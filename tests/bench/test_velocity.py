"""What bench/velocity.py judges estimators by, and that its peers are what they are called."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from bench import velocity
from bench.peers import Peers, compiled
from bench.report import Floats

pytestmark = pytest.mark.slow  # the peers are compiled first

STEP, RATE = 20e-6, 10_000.0


@pytest.fixture(scope="module")
def peers() -> Peers:
    return compiled()


def positions(count: int = 400) -> tuple[Floats, Floats]:
    time_s = np.arange(count) / RATE
    path = np.stack((0.1 * time_s + 0.3 * time_s**2, 0.01 * np.sin(40 * time_s)), 1)
    return np.full(count, 1 / RATE), velocity.quantise(path, STEP)


def estimated(peers: Peers, name: str) -> Floats:
    interval_s, position = positions()
    return velocity.estimate_of(peers, velocity.estimators(peers)[name])(STEP, interval_s, position)


def test_backward_difference(peers: Peers) -> None:
    _, position = positions()
    assert estimated(peers, velocity.FLOOR)[1:] == pytest.approx(np.diff(position, axis=0) * RATE, rel=1e-9)


def test_low_pass(peers: Peers) -> None:
    _, position = positions()
    x = 2 * np.pi * 30.0 / RATE
    share = x / (1 + x)
    expected = lfilter([share], [1, share - 1], np.diff(position, axis=0) * RATE, axis=0)
    assert estimated(peers, "low-pass of it, 30 Hz")[1:] == pytest.approx(expected, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("window", [16, 64])
def test_least_squares(peers: Peers, window: int) -> None:
    _, position = positions()
    found = estimated(peers, f"least squares, {window}")
    time_s = np.arange(window) / RATE
    for newest in (100, 250, 399):
        slopes = np.polyfit(time_s, position[newest - window + 1 : newest + 1], 1)[0]
        assert found[newest] == pytest.approx(slopes, rel=1e-6, abs=1e-9)


def test_foaw_is_the_longest_line_within_a_step(peers: Peers) -> None:
    _, position = positions()
    found = estimated(peers, "FOAW end fit, 16")
    for newest in (50, 200, 399):
        for axis in range(2):
            kept = 0.0
            for back in range(1, 16):
                slope = (position[newest, axis] - position[newest - back, axis]) * RATE / back
                line = position[newest, axis] - slope * np.arange(1, back) / RATE
                if np.any(np.abs(line - position[newest - 1 : newest - back : -1, axis]) > STEP * (1 + 1e-9)):
                    break
                kept = slope
            assert found[newest, axis] == pytest.approx(kept, rel=1e-9, abs=1e-12)


def test_kalman_is_the_textbook_filter(peers: Peers) -> None:
    _, position = positions()
    h, jerk, noise = 1 / RATE, 30.0, STEP**2 / 12
    transition = np.array([[1, h, h * h / 2], [0, 1, h], [0, 0, 1]])
    drive = jerk**2 * np.array(
        [[h**5 / 20, h**4 / 8, h**3 / 6], [h**4 / 8, h**3 / 3, h**2 / 2], [h**3 / 6, h**2 / 2, h]]
    )
    look = np.array([[1.0, 0.0, 0.0]])
    for axis in range(2):
        state = np.array([position[0, axis], 0.0, 0.0])
        cover = np.diag([noise, 1.0, 100.0])
        expected = [0.0]
        for sample in position[1:, axis]:
            state, cover = transition @ state, transition @ cover @ transition.T + drive
            gain = cover @ look.T / (look @ cover @ look.T + noise)
            state = state + gain[:, 0] * (sample - state[0])
            cover = (np.eye(3) - gain @ look) @ cover
            expected.append(state[1])
        assert estimated(peers, "Kalman, calm")[:, axis] == pytest.approx(expected, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("deceleration", [0.0, 3.0])
def test_an_approach_moves_as_it_says(deceleration: float) -> None:
    step = 1e-12
    trial = velocity.approach(np.random.default_rng(3), RATE, step, deceleration)
    speeds = np.diff(trial.position_m, axis=0) * RATE
    middle = (trial.time_s[1:] + trial.time_s[:-1]) / 2
    for axis in range(2):
        held = trial.onset_s[axis] - trial.slowing_s[axis]
        since = np.maximum(middle - trial.onset_s[axis], -held)
        inside = np.abs(middle - trial.slowing_s[axis]) > 1 / RATE
        expected = trial.speed_m_per_s[axis] - deceleration * since
        assert speeds[inside, axis] == pytest.approx(expected[inside], abs=1e-6)
        assert -1 / RATE < trial.onset_s[axis] <= 0
        assert held == 0 or velocity.HELD_S[0] <= held <= velocity.HELD_S[1]


def test_errors_are_relative_to_the_speed_at_the_onset() -> None:
    def half(step_m: float, interval_s: Floats, position_m: Floats) -> Floats:
        return np.full_like(position_m, 0.05)

    for deceleration in (0.0, 10.0):
        errors = velocity.tap_errors(half, RATE, STEP, deceleration, 50)
        speeds = 0.05 / (errors + 1)
        assert speeds.min() >= 0.05
        assert speeds.max() <= 0.5
        # Spread evenly over the logarithm.
        assert np.median(speeds) == pytest.approx(np.sqrt(0.05 * 0.5), rel=0.3)


def all_pairs(time_s: Floats, position_m: Floats, step_m: float) -> tuple[float, float]:
    """Slowest and fastest line through every interval: of any two samples, rise - step < slope run < rise + step."""
    later, earlier = np.tril_indices(len(time_s), -1)
    run = time_s[later] - time_s[earlier]
    rise = position_m[later] - position_m[earlier]
    return float(((rise - step_m) / run).max()), float(((rise + step_m) / run).min())


def test_what_the_samples_allow_at_constant_speed() -> None:
    rng = np.random.default_rng(4)
    for _ in range(5):
        trial = velocity.approach(rng, RATE, STEP, 0.0)
        for axis in range(2):
            low, high = velocity.consistent(trial, axis, STEP, 0.0)
            assert (low, high) == pytest.approx(all_pairs(trial.time_s, trial.position_m[:, axis], STEP), rel=1e-6)
            assert low * (1 - 1e-9) <= trial.speed_m_per_s[axis] <= high * (1 + 1e-9)


@pytest.mark.parametrize("deceleration", [1.0, 10.0])
def test_what_the_samples_allow_under_deceleration(deceleration: float) -> None:
    rng = np.random.default_rng(5)
    for _ in range(5):
        trial = velocity.approach(rng, RATE, STEP, deceleration)
        for axis in range(2):
            low, high = velocity.consistent(trial, axis, STEP, deceleration)
            speed = trial.speed_m_per_s[axis]
            assert low - 1e-6 <= speed <= high + 1e-6
            # A motion at either end, its acceleration free, does pass through; one a little beyond does not.
            held = trial.onset_s[axis] - trial.slowing_s[axis]
            since = trial.time_s - trial.onset_s[axis]
            slowed = np.maximum(since, -held)
            shape = 0.5 * slowed**2 - held * (since - slowed)
            room = [
                widest_room(trial.position_m[:, axis], since, shape, wanted, deceleration)
                for wanted in (low, high, low - 0.2 * (high - low), high + 0.2 * (high - low))
            ]
            assert max(room[:2]) <= 0.5 * STEP * (1 + 1e-3)
            assert min(room[2:]) > 0.5 * STEP


def widest_room(position: Floats, since: Floats, shape: Floats, speed: float, deceleration: float) -> float:
    """The smallest largest distance from the samples of the motions with this speed: over place and acceleration.

    For each acceleration the best place is the middle of the extremes; the distance is convex in the acceleration.
    """
    low, high = -2 * deceleration - 2, 1.0
    for _ in range(80):
        a, b = low + (high - low) / 3, high - (high - low) / 3
        left, right = (np.ptp(position - speed * since - x * shape) / 2 for x in (a, b))
        low, high = (low, b) if left < right else (a, high)
    return float(np.ptp(position - speed * since - low * shape) / 2)


def test_ours_reaches_the_aim_with_the_default_joystick(peers: Peers) -> None:
    estimate = velocity.estimate_of(peers, velocity.estimators(peers)[velocity.OURS])
    errors = np.abs(velocity.tap_errors(estimate, RATE, STEP, 0.0, 40))
    assert np.median(errors) < 0.02
    assert errors.max() < 0.10
    assert velocity.after_stop(estimate, RATE, STEP, 20) < 1e-3
