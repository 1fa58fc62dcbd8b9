"""What bench/noise.py judges noise by, and that its peers are the filters that they are called."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from bench import noise
from bench.peers import Peers, compiled

pytestmark = pytest.mark.slow  # the peers are compiled first

COUNT = 20_000


@pytest.fixture(scope="module")
def peers() -> Peers:
    return compiled()


@pytest.mark.parametrize("order", noise.ORDERS)
def test_a_filter_has_unit_power(order: int) -> None:
    filter = noise.coloured(order, 1)
    middles = (np.arange(200_000) + 0.5) * noise.RATE_HZ / 2 / 200_000
    assert noise.density(filter, middles).mean() * noise.RATE_HZ / 2 == pytest.approx(1, rel=1e-6)
    assert np.abs(np.roots(np.append(1.0, filter.coefficients))).max() < 1


@pytest.mark.parametrize("order", noise.ORDERS)
def test_direct_form_and_lattice_are_the_same_filter_while_it_stays(peers: Peers, order: int) -> None:
    filters = (noise.coloured(order, 1), noise.coloured(order, 2))
    made = noise.sources(peers, filters)
    still = np.zeros(COUNT, dtype=np.uint8)
    white, _ = made[noise.FLOOR].make(still)
    assert np.mean(white**2) == pytest.approx(1, rel=0.03)
    expected = lfilter([filters[0].gain], np.append(1.0, filters[0].coefficients), white)
    for name in (noise.DIRECT, noise.LADDER):
        assert made[name].make(still)[0] == pytest.approx(expected, abs=1e-6)


def test_the_core_plays_the_same_filter(peers: Peers) -> None:
    filters = (noise.coloured(10, 1), noise.coloured(10, 2))
    still = np.zeros(COUNT, dtype=np.uint8)
    ours, _ = noise.sources(peers, filters)[noise.OURS].make(still)
    # Its delays begin full. Undone, the filter leaves numbers that are white again, Gaussian and of unit power.
    white = lfilter(np.append(1.0, filters[0].coefficients), [filters[0].gain], ours)[100:]
    assert np.mean(white**2) == pytest.approx(1, rel=0.03)
    assert np.abs(white).max() <= 6 * (1 + 1e-9)
    assert abs(np.mean(white[1:] * white[:-1])) < 4 / math.sqrt(COUNT)


def test_third_octaves_are_zero_where_the_spectrum_is_right_and_tell_where_it_is_not() -> None:
    rng = np.random.default_rng(1)
    filter = noise.coloured(2, 1)
    samples = lfilter([filter.gain], np.append(1.0, filter.coefficients), rng.standard_normal(600_000))
    bands = noise.bands_db(samples, filter)
    assert math.sqrt(np.mean(bands**2)) < 0.2
    assert noise.bands_db(2 * samples, filter) == pytest.approx(bands + 20 * math.log10(2), abs=1e-9)


def test_only_the_normalised_lattice_keeps_its_power(peers: Peers) -> None:
    wrong = noise.errors(peers, 10, 20.0)
    assert wrong[noise.OURS].changing < 0.06
    assert wrong[noise.OURS].largest < math.sqrt(3) * 11
    for name in (noise.DIRECT, noise.LADDER):
        assert wrong[name].changing > 1
    assert math.isinf(wrong["table of 4096"].changing)
