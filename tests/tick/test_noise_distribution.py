"""How noise is distributed: Gaussian at every rate, whatever its filter.

A stationary Gaussian process with correlation r(k) has the kurtosis 3; that of N samples scatters with the standard
error sqrt(24/N sum r(k)^4) (Lomnicki 1961), the sum over all k. The correlation is taken from the filter's own
numbers."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal
import scipy.stats

from tests.tick.test_sandpaper import SANDPAPER, noise_of, ratio, rig_of, stroke, vibration

COUNT = 100_000


@pytest.mark.parametrize("rate_hz", [1e3, 2e3, 4e3, 10e3])
def test_noise_is_gaussian_at_every_rate(rate_hz: float) -> None:
    rig = rig_of(SANDPAPER, rate_hz)
    samples = vibration(rig, stroke(np.full(COUNT, 0.1), 1.0, rate_hz))[200:]
    noise = noise_of(rig)
    impulse = np.zeros(4000)
    impulse[0] = 1
    response = scipy.signal.lfilter(*ratio(noise.reflection[0, 0], noise.taps[0, 0]), impulse)
    correlation = scipy.signal.correlate(response, response, method="fft") / np.sum(response**2)
    error = np.sqrt(24 / len(samples) * np.sum(correlation**4))
    assert scipy.stats.kurtosis(samples, fisher=False) == pytest.approx(3, abs=4 * error)
    assert error < 0.05
    # The parts beyond 2, 3 and 4 sigma; of the last, so that few are a wide range.
    memory = np.sum(correlation**2)
    for bound in (2.0, 3.0, 4.0):
        part = 2 * scipy.stats.norm.sf(bound)
        found = np.mean(np.abs(samples) > bound * np.std(samples))
        assert found == pytest.approx(part, abs=5 * np.sqrt(part * memory / len(samples)))
    assert np.abs(samples).max() < 6 * np.std(samples)
