"""What bench/modes.py computes errors from: its references, and that errors that are there are found."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bench import modes
from bench.peers import Peers, compiled
from hapticd.config.modes import Mode

pytestmark = pytest.mark.slow  # the peers are compiled first

WOOD = Mode(1 / 0.00648, 2 * math.pi * 67)


@pytest.fixture(scope="module")
def peers() -> Peers:
    return compiled()


def strikes() -> modes.Strikes:
    rng = np.random.default_rng(1)
    at = np.array([0, 1, 1, 40, 77], dtype=np.uint64)
    return modes.Strikes(at, rng.uniform(0, 1e-4, 5), rng.uniform(-1, 1, (5, 2)))


def test_the_reference_is_the_decaying_sine() -> None:
    times = [-0.001, 0.0, 0.0005, 0.01]
    expected = [0.0] + [math.exp(-t / 0.00648) * math.sin(2 * math.pi * 67 * t) for t in times[1:]]
    assert modes.reference(WOOD, times) == pytest.approx(expected, rel=1e-12)


def test_strikes_add() -> None:
    struck = strikes()
    found = modes.sum_of(WOOD, struck, 80, 80)
    for tick in (0, 1, 39, 40, 79):
        total = np.zeros(2)
        for at, before, force in zip(struck.at, struck.before_s, struck.force_n, strict=True):
            since = (tick - int(at)) / modes.RATE_HZ + before
            if int(at) <= tick:
                total += force * math.exp(-since / 0.00648) * math.sin(2 * math.pi * 67 * since)
        assert found[tick] == pytest.approx(total, abs=1e-14)


def test_a_minute_of_strikes_never_lets_a_mode_end() -> None:
    for mode in (WOOD, modes.BELL, Mode(1 / 0.00032, 2 * math.pi * 1682)):
        struck = modes.strikes_of(mode, 3.0)
        gaps = np.diff(struck.at.astype(np.int64)) / modes.RATE_HZ
        assert gaps.min() >= 0
        assert gaps.max() < 5 / mode.decay_rate_per_s
        assert struck.at[-1] < 3 * modes.RATE_HZ


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "least", "most"),
    [
        (modes.OURS, 0.0, 1e-13),
        ("libm: exp, sin, cos", 0.0, 1e-13),
        ("recurrence of two terms, double", 0.0, 1e-11),
        ("rotor, single", 1e-8, 1e-4),
        ("recurrence of two terms, single", 1e-8, 1e-2),
        # The nearest of 256 is up to pi/256 of a turn's radian away, and the coefficient is 1.12.
        ("table of 256 sines, nearest", 2e-3, 2 * math.pi / 256 / 0.5),
        # Straight lines between sines: (2 pi/n)^2/8.
        ("table of 4096 sines, linear", 1e-8, (2 * math.pi / 4096) ** 2 / 8 * 4),
    ],
)
def test_every_way_makes_the_same_sound_but_for_its_error(peers: Peers, name: str, least: float, most: float) -> None:
    way = modes.ways(peers)[name]
    before_s = 0.375 / modes.RATE_HZ
    count = modes.ticks_within(WOOD, before_s)
    wanted = modes.reference(WOOD, [(tick + 0.375) / modes.RATE_HZ for tick in range(1, count + 1)])
    assert least <= modes.single_error(peers, way, WOOD, wanted, before_s) <= most
    struck = strikes()
    assert least <= modes.minute_error(peers, way, WOOD, struck, 80, modes.sum_of(WOOD, struck, 80, 80)) <= most


@pytest.mark.slow
def test_a_mode_ends_after_five_decay_times(peers: Peers) -> None:
    for name, way in modes.ways(peers).items():
        if name == modes.FLOOR:
            continue
        bank = modes.bank(peers, way, [WOOD])
        force = np.array([1.0, 0.0])
        peers.lib.peer_modes_strike(bank, 0, peers.doubles(force), 3e-5)
        heard, _ = peers.ring(bank, 400)
        last = np.flatnonzero(heard[:, 0])[-1] + 1
        assert last == int((5 * 0.00648 - 3e-5) * modes.RATE_HZ)
