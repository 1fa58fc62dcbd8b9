"""What bench/timing.py compares times with."""

from __future__ import annotations

import numpy as np
import pytest

from bench import timing
from bench.peers import Peers, compiled

pytestmark = pytest.mark.slow  # the peers are compiled first


@pytest.fixture(scope="module")
def peers() -> Peers:
    return compiled()


@pytest.mark.parametrize("rate_hz", [1000.0, 10_000.0])
def test_a_straight_line_is_off_by_the_bend_of_the_way(peers: Peers, rate_hz: float) -> None:
    onset = timing.Onset(rate_hz, 0.0, 200)
    ways = timing.onset_ways(peers)
    assert timing.onset_errors(peers, ways["at the tick"], onset) == pytest.approx(onset.truth_s, abs=1e-15)
    # d(t) = v t - a t^2/2 between t1 = tau - T and t2 = tau: the chord crosses zero at t1 - d1 T/(d2 - d1).
    first, second = onset.truth_s - onset.period_s, onset.truth_s
    depth = [onset.speed * t - timing.DECELERATION * t**2 / 2 for t in (first, second)]
    expected = first - depth[0] * onset.period_s / (depth[1] - depth[0])
    found = timing.onset_errors(peers, ways[timing.OURS], onset)
    assert found == pytest.approx(expected, abs=1e-12)
    # Half the deceleration over the speed, times what lies on either side.
    leading = -timing.DECELERATION / (2 * onset.speed) * first * second
    assert found == pytest.approx(leading, rel=0.1, abs=1e-12)


@pytest.mark.parametrize("step_m", [0.0, timing.STEP_M])
def test_the_core_says_what_the_formula_does(peers: Peers, step_m: float) -> None:
    onset = timing.Onset(10_000.0, step_m, 100)
    formula = timing.onset_errors(peers, timing.onset_ways(peers)[timing.OURS], onset)
    assert timing.rendered_errors(onset) == pytest.approx(formula, abs=1e-11)


def test_passages_are_where_the_fine_motion_crosses() -> None:
    stroke = timing.Stroke(1000.0, 0.0, timing.SPACING_M, 3, 2.0)
    time_s = np.arange(0, (len(stroke.along) - 1) / 1000.0, 1e-6)
    amplitude, middle = 3.75 * timing.SPACING_M, 0.1037 * timing.SPACING_M
    fine = np.floor((amplitude * np.sin(4 * np.pi * time_s) + middle) / timing.SPACING_M)
    crossed = time_s[np.flatnonzero(np.diff(fine))]
    assert len(crossed) == len(stroke.passed)
    assert np.array([at for at, _ in stroke.passed]) == pytest.approx(crossed, abs=2e-6)


def test_strikes_are_matched_to_their_passages() -> None:
    stroke = timing.Stroke(1000.0, 0.0, timing.SPACING_M, 3, 2.0)
    times = np.array([at for at, _ in stroke.passed])
    which = np.array([groove for _, groove in stroke.passed])
    late, lost = timing.matched(stroke, times + 2e-4, which)
    assert late == pytest.approx(2e-4)
    assert lost == 0
    late, lost = timing.matched(stroke, times[::2], which[::2])
    assert lost == len(times) // 2
    assert late == pytest.approx(0, abs=1e-15)
    assert timing.matched(stroke, times + 0.02, which)[1] == len(times)


def test_one_strike_a_tick_loses_what_is_passed_within_it(peers: Peers) -> None:
    stroke = timing.strokes(1000.0)["0.2 mm at up to 1 m/s, exact"]
    lost = {}
    for name, way in timing.groove_ways(peers).items():
        times, which, _ = peers.grooves(way, 1e-3, stroke.spacing_m, stroke.along)
        lost[name] = timing.matched(stroke, times, which)[1]
    assert lost[timing.ALL] == lost[timing.CROSSING] == 0
    # Every tick that passes any groove strikes one.
    ticks = np.count_nonzero(np.diff(np.floor(stroke.along / stroke.spacing_m)))
    assert lost[timing.ONE] == len(stroke.passed) - ticks


@pytest.mark.parametrize("rate_hz", [1000.0, 10_000.0])
def test_the_core_strikes_every_passage_at_its_crossing(peers: Peers, rate_hz: float) -> None:
    for stroke in timing.strokes(rate_hz).values():
        times, which = timing.rendered_strikes(stroke)
        expected, grooves, _ = peers.grooves(
            timing.groove_ways(peers)[timing.CROSSING], 1 / rate_hz, stroke.spacing_m, stroke.along
        )
        assert times == pytest.approx(expected, abs=1e-11)
        assert which.tolist() == grooves.tolist()
        assert timing.matched(stroke, times, which)[1] == 0
