"""The velocity estimator (`hd_velocity_run`) against closed forms and the set of speeds from all pairs."""

import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from hapticd.base.core import ffi, invalid_reason, lib, pointer
from tests.support.marks import rest_slow

Array = npt.NDArray[np.float64]

STEP_M = 20e-6
RATE_HZ = 10_000.0
# The estimator widens each sample's interval by 1e-9 of a step, against rounding.
WIDEN = 2e-9
# Over this much of the past it keeps a line at most: the time in which 1 m/s^2 bends a path by three steps.
SPAN_S = math.sqrt(6 * STEP_M)
# It never looks at less than this many samples where one line explains them.
LEAST_SAMPLES = 32


def run(step_m: float, interval_s: Array, position_m: Array) -> tuple[Array, Array]:
    """Velocity and half width, [n, 2] each, of positions [n, 2] at intervals [n]."""
    position_m = np.ascontiguousarray(position_m, np.float64)
    interval_s = np.ascontiguousarray(interval_s, np.float64)
    velocity, width = np.full_like(position_m, np.nan), np.full_like(position_m, np.nan)
    arrays = [pointer("double[]", a) for a in (interval_s, position_m, velocity, width)]
    assert lib.hd_velocity_run(step_m, len(position_m), *arrays) == lib.HD_OK
    return velocity, width


def encode(position_m: Array, step_m: float = STEP_M) -> Array:
    """What an encoder of that step says."""
    return np.asarray(np.round(position_m / step_m) * step_m, np.float64)


def regular(count: int, rate_hz: float = RATE_HZ) -> tuple[Array, Array]:
    """Time stamps and intervals, [count] each."""
    return np.arange(count) / rate_hz, np.full(count, 1.0 / rate_hz)


def slopes(time_s: Array, position_m: Array, step_m: float) -> tuple[float, float]:
    """Slowest and fastest line through every interval of [n] samples, from all pairs.

    A line exists for a slope v if and only if max(p - v t) - min(p - v t) <= step: one condition a pair.
    """
    later, earlier = np.tril_indices(len(time_s), -1)
    run_s = time_s[later] - time_s[earlier]
    rise = position_m[later] - position_m[earlier]
    return float(((rise - step_m) / run_s).max()), float(((rise + step_m) / run_s).min())


def test_slopes_of_all_pairs_are_those_of_the_linear_programme() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        time = np.cumsum(rng.uniform(0.5, 1.5, 30))
        position = np.round(rng.uniform(-2, 2) * time + rng.uniform())
        low, high = slopes(time, position, 1.0)
        rows = np.stack((time, np.ones(30)), 1)
        limits = np.concatenate((position + 0.5, 0.5 - position))
        for sign, expected in ((1.0, low), (-1.0, high)):
            found = linprog([sign, 0], np.concatenate((rows, -rows)), limits, bounds=(None, None))
            assert found.x[0] == pytest.approx(expected, abs=1e-7)


@given(st.lists(st.tuples(st.floats(1e-6, 2.0), st.floats(-1, 1), st.floats(-1, 1)), min_size=2, max_size=50))
def test_exact_positions_give_the_backward_difference(samples: list[tuple[float, float, float]]) -> None:
    data = np.array(samples)
    velocity, width = run(0.0, data[:, 0], data[:, 1:])
    assert np.array_equal(velocity[0], [0.0, 0.0])
    assert np.array_equal(velocity[1:], np.diff(data[:, 1:], axis=0) / data[1:, :1])
    assert np.all(np.isinf(width[0])) and np.all(width[1:] == 0.0)


@settings(deadline=None)
@given(
    speed=st.tuples(st.floats(-1, 1), st.floats(-0.05, 0.05)),
    offset=st.floats(-1, 1),
    step_m=st.floats(1e-6, 1e-4),
    rate_hz=st.floats(1e3, 1e4),
    jitter=st.floats(0, 0.9),
    seed=st.integers(0, 2**32 - 1),
)
def test_true_speed_of_a_line_lies_within_the_half_width(
    speed: tuple[float, float], offset: float, step_m: float, rate_hz: float, jitter: float, seed: int
) -> None:
    interval = (1 + jitter * np.random.default_rng(seed).uniform(-1, 1, 400)) / rate_hz
    interval[0] = 0.0
    position = np.cumsum(interval)[:, None] * np.array(speed) + offset * step_m
    velocity, width = run(step_m, interval, encode(position, step_m))
    assert np.array_equal(velocity[0], [0.0, 0.0])
    assert np.all(np.isinf(width[0])) and np.all(np.isfinite(width[1:])) and np.all(width[1:] >= 0)
    slack = 1e-9 * step_m * rate_hz / (1 - jitter)
    assert np.all(np.abs(velocity - speed)[1:] <= width[1:] + slack)


@pytest.mark.slow
@settings(deadline=None, max_examples=30)
@given(speed=st.floats(0.15, 0.9), offset=st.floats(0, 1), jitter=st.floats(0, 0.3), seed=st.integers(0, 99))
def test_estimate_is_the_middle_of_the_exact_set_of_a_window(
    speed: float, offset: float, jitter: float, seed: int
) -> None:
    interval = (1 + jitter * np.random.default_rng(seed).uniform(-1, 1, 220)) / RATE_HZ
    time = np.cumsum(interval)
    position = encode(np.stack((speed * time, -speed * time), 1) + offset * STEP_M)
    velocity, width = run(STEP_M, interval, position)
    for newest in range(1, len(time), 7):
        windows = [
            slopes(time[k : newest + 1], position[k : newest + 1, 0], STEP_M)
            for k in range(max(0, newest - 63), newest)
        ]
        found = [
            abs(velocity[newest, 0] - (low + high) / 2) <= 1e-6 * speed
            and abs(width[newest, 0] - (high - low) / 2) <= 1e-6 * speed
            for low, high in windows
        ]
        assert any(found)
        least = windows[max(0, len(windows) + 1 - LEAST_SAMPLES)]
        assert width[newest, 0] <= (least[1] - least[0]) / 2 + 1e-6 * speed


@pytest.mark.long
@pytest.mark.parametrize("speed", rest_slow([0.004, 0.001, 0.02, 0.05]))
def test_runs_of_equal_positions_lose_nothing(speed: float) -> None:
    # Of a run only the ends are kept, and a run may be cut within: so the set must lie between those of two
    # windows of all samples, one sample apart.
    time, interval = regular(600)
    position = encode(np.stack((speed * time, 7e-6 - speed * time), 1))
    velocity, width = run(STEP_M, interval, position)
    for newest in range(5, 600, 59):
        for a in range(2):
            low, high = velocity[newest, a] - width[newest, a], velocity[newest, a] + width[newest, a]
            sets = [
                slopes(time[k : newest + 1], position[k : newest + 1, a], STEP_M)
                for k in range(max(0, newest - 250), newest)
            ]
            slack = 1e-6 * speed + WIDEN
            assert any(
                sets[k][0] >= low - slack >= sets[k + 1][0] - 2 * slack
                and sets[k][1] <= high + slack <= sets[k + 1][1] + 2 * slack
                for k in range(len(sets) - 1)
            ) or (low, high) == pytest.approx(sets[0], rel=1e-6)


def test_error_at_constant_speed() -> None:
    rng = np.random.default_rng(2)
    time, interval = regular(1000)
    errors = []
    for _ in range(100):
        speed = np.exp(rng.uniform(math.log(0.05), math.log(0.5), 2)) * rng.choice([-1, 1], 2)
        velocity, _ = run(STEP_M, interval, encode(time[:, None] * speed + rng.uniform(0, STEP_M, 2)))
        errors.append(np.abs(velocity[400:] / speed - 1))
    assert np.median(errors) < 0.005
    assert np.max(errors) < 0.10


@pytest.mark.long
@pytest.mark.parametrize("deceleration", rest_slow([3.0, 1.0, 10.0]))
def test_deceleration_biases_little(deceleration: float) -> None:
    rng = np.random.default_rng(3)
    time, interval = regular(900)
    errors, straight = [], []
    for _ in range(200):
        since = np.clip(time[:, None] - (time[-1] - 0.03), 0, None)
        at_contact = rng.uniform(0.05, 0.3, 2)
        path = (at_contact + deceleration * 0.03) * time[:, None] - deceleration / 2 * since**2
        position = encode(path + rng.uniform(0, STEP_M, 2))
        velocity, _ = run(STEP_M, interval, position)
        errors.extend(velocity[-1] - at_contact)
        for a in range(2):  # the longest window of the newest samples that one line explains
            count = 2
            while count < 64:
                low, high = slopes(time[-count - 1 :], position[-count - 1 :, a], STEP_M)
                if low > high:
                    break
                count += 1
            low, high = slopes(time[-count:], position[-count:, a], STEP_M)
            straight.append((low + high) / 2 - at_contact[a])
    assert abs(np.mean(errors)) < 0.3 * np.mean(straight)
    assert np.sqrt(np.mean(np.square(errors))) < 0.6 * np.sqrt(np.mean(np.square(straight)))


def test_impact_is_followed_at_once() -> None:
    rng = np.random.default_rng(4)
    time, interval = regular(700)
    for _ in range(100):
        since = time[:, None] - (time[400] - rng.uniform(0, 1e-4, 2))
        position = encode(np.where(since < 0, 0.3, -0.15) * since + rng.uniform(0, STEP_M, 2))
        velocity, width = run(STEP_M, interval, position)
        # n samples know a speed to step / (n T): to 45 mm/s after 5. Thrice that, for the window to let go.
        assert np.all(np.min(np.abs(velocity[401:416] + 0.15), axis=0) < 0.045)
        # Once all windows lie behind the impact, it is a line like any other.
        settled = 400 + round(2.2 * SPAN_S * RATE_HZ)
        assert np.all(np.abs(velocity[settled:] + 0.15) <= width[settled:] + 1e-9)


def test_rest_is_exactly_zero() -> None:
    _, interval = regular(50_000)
    velocity, width = run(STEP_M, interval, np.full((50_000, 2), 0.0123))
    assert not velocity.any()
    assert np.all(width[1000:] <= 2.001 * STEP_M / SPAN_S)


def test_motion_comes_to_rest() -> None:
    time, interval = regular(1500)
    position = encode(np.minimum(time, 0.05)[:, None] * np.array([0.2, -0.007]))
    velocity, _ = run(STEP_M, interval, position)
    still = 500 + round(2.2 * SPAN_S * RATE_HZ)
    assert not velocity[still:].any()


def test_dithering_between_two_counts_is_no_motion() -> None:
    rng = np.random.default_rng(5)
    _, interval = regular(5000)
    position = encode(rng.integers(0, 2, (5000, 2)).astype(np.float64) * STEP_M)
    position[:200] = 0.0
    velocity, _ = run(STEP_M, interval, position)
    # The first change may be a slow start, as far as the rest before lets it; all later ones lie on one level
    # line.
    assert np.all(np.abs(velocity) <= 4 * STEP_M / SPAN_S)
    assert np.all(np.abs(velocity[400:]) < 1e-6)


def test_repeated_samples_change_nothing() -> None:
    rng = np.random.default_rng(6)
    time, interval = regular(3000)
    position = encode(0.02 * np.stack((np.sin(30 * time), np.cos(17 * time)), 1))
    velocity, width = run(STEP_M, interval, position)
    copies = rng.integers(1, 4, 3000)
    first = np.cumsum(copies) - copies
    spread = np.zeros(int(copies.sum()))
    spread[first] = interval
    for step in (STEP_M, 0.0):
        velocity, width = run(step, interval, position)
        repeated, repeated_width = run(step, spread, np.repeat(position, copies, axis=0))
        assert np.array_equal(repeated, np.repeat(velocity, copies, axis=0))
        assert np.array_equal(repeated_width, np.repeat(width, copies, axis=0))


def test_time_below_a_nanosecond_counts_on_to_the_next_sample() -> None:
    position = np.array([[0.0, 0.0], [1e-6, 2e-6], [3e-6, 5e-6]])
    velocity, _ = run(0.0, np.array([0.0, 0.6e-9, 0.6e-9]), position)
    assert not velocity[1].any()
    assert velocity[2] == pytest.approx(position[2] / 1.2e-9)


def test_after_a_long_pause_only_the_mean_speed_is_known() -> None:
    time, interval = regular(300)
    position = encode(0.1 * np.stack((time, -time), 1))
    interval[200] = 2.5
    position[200:] += 0.05
    velocity, width = run(STEP_M, interval, position)
    assert velocity[200] == pytest.approx((position[200] - position[199]) / 2.5)
    assert width[200] == pytest.approx([STEP_M / 2.5] * 2)
    fresh, _ = run(STEP_M, interval[200:], position[200:])
    assert np.array_equal(velocity[201:], fresh[1:])


@settings(deadline=None)
@given(
    st.sampled_from([0.0, 1e-6, STEP_M, 1e-4]),
    st.lists(
        st.tuples(
            st.sampled_from([0.0, 1e-300, 1e-12, 1e-9, 1e-7, 1e-4, 1e-3, 0.3, 1.0, 2.0, 1e6, 1e300]),
            st.floats(-0.1, 0.1),
            st.integers(-3, 3),
        ),
        max_size=200,
    ),
)
def test_any_intervals_and_positions_stay_finite(step_m: float, samples: list[tuple[float, float, int]]) -> None:
    data = np.array(samples, np.float64).reshape(-1, 3)
    position = data[:, 1:] * [1.0, STEP_M]
    velocity, width = run(step_m, data[:, 0], position)
    assert np.all(np.isfinite(velocity))
    assert not np.any(np.isnan(width)) and np.all(width >= 0)
    # No pair of samples says more than its rise and one step over a nanosecond; the correction at most
    # doubles it.
    assert np.all(np.abs(velocity) <= 3 * (0.2 + step_m) / 1e-9)


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_axes_are_independent_and_mirror_images_agree(seed: int) -> None:
    rng = np.random.default_rng(seed)
    interval = rng.uniform(0.5, 1.5, 600) / RATE_HZ
    speed = np.repeat(rng.uniform(-0.3, 0.3, (6, 2)), 100, axis=0)
    position = encode(np.cumsum(interval[:, None] * speed, axis=0))
    velocity, width = run(STEP_M, interval, position)
    again, again_width = run(STEP_M, interval, position)
    assert velocity.tobytes() == again.tobytes() and width.tobytes() == again_width.tobytes()
    swapped, swapped_width = run(STEP_M, interval, position[:, ::-1])
    assert np.array_equal(swapped[:, ::-1], velocity) and np.array_equal(swapped_width[:, ::-1], width)
    mirrored, mirrored_width = run(STEP_M, interval, -position)
    assert np.array_equal(-mirrored, velocity) and np.array_equal(mirrored_width, width)


@pytest.mark.long
def test_a_million_samples_do_not_drift() -> None:
    time, interval = regular(1_000_000)
    turns = np.abs((0.1 * time[:, None] + [0.0, 0.013]) % 0.2 - 0.1)  # a triangle, 0.1 m/s both ways
    position = encode(turns)
    velocity, width = run(STEP_M, interval, position)
    assert np.all(np.isfinite(velocity)) and np.all(np.isfinite(width[1:]))
    assert not np.any((velocity != 0) & (np.abs(velocity) < np.finfo(np.float64).tiny))
    # Away from the turns, after a million samples as after a thousand, the speed lies within the half width.
    distance = np.minimum(np.abs(turns), np.abs(turns - 0.1))
    line = distance > 0.1 * 2.5 * SPAN_S
    line[: round(2.5 * SPAN_S * RATE_HZ)] = False
    assert np.all(np.abs(np.abs(velocity) - 0.1)[line] <= width[line] + 1e-8)


@pytest.mark.parametrize(
    ("step_m", "interval_s", "position_m", "reason"),
    [
        (-1.0, 1e-4, 0.0, "step_m"),
        (math.nan, 1e-4, 0.0, "step_m"),
        (math.inf, 1e-4, 0.0, "step_m"),
        (0.0, -1e-4, 0.0, "interval_s[1]"),
        (0.0, math.inf, 0.0, "interval_s[1]"),
        (STEP_M, 1e-4, math.nan, "position[1]"),
    ],
)
def test_faulty_arguments_are_refused(step_m: float, interval_s: float, position_m: float, reason: str) -> None:
    interval = np.array([0.0, interval_s])
    position = np.array([[0.0, 0.0], [0.0, position_m]])
    velocity = pointer("double[]", np.zeros((2, 2)))
    interval_s_c, position_c = pointer("double[]", interval), pointer("double[]", position)
    status = lib.hd_velocity_run(step_m, 2, interval_s_c, position_c, velocity, ffi.NULL)
    assert status == lib.HD_ERR_INVALID
    assert invalid_reason().startswith(reason)
