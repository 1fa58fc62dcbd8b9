"""Noise filters match their reports: spectra, moments and stability against scipy, mpmath and a lattice in time."""

import itertools
import math
from collections.abc import Sequence

import mpmath
import numpy as np
import numpy.typing as npt
import pytest
import scipy.integrate
import scipy.signal
from hypothesis import given, settings
from hypothesis import strategies as st

from hapticd.base.lattice import coefficients_of, reflection_of
from hapticd.config.texture import MAX_MODELS
from hapticd.rendering.compiler.noise_filters import Model, grid
from hapticd.rendering.filter_design import Filter, power_spectrum, stochastic_filter
from hapticd.rendering.resampling import MAX_RESAMPLING_ERROR_DB, resampled

Array = npt.NDArray[np.float64]

RATES = (1e3, 2e3, 4e3, 5e3, 10e3)
PAIRS = ((250, 310), (250, 250), (150, 400), (400, 300), (100, 105), (100, 200), (450, 480))


# ---- references ------------------------------------------------------------------------------------------------


def impulse_response(reflection: Sequence[float], taps: Sequence[float] | None, count: int) -> Array:
    """The normalised lattice, sample by sample: each stage rotates its input and its delayed state."""
    order = len(reflection)
    weights = taps if taps is not None else [1.0] + [0.0] * order
    delayed = [0.0] * (order + 1)
    out = np.empty(count)
    for n in range(count):
        backward = [0.0] * (order + 1)
        forward = 1.0 if n == 0 else 0.0
        for m in range(order, 0, -1):
            k = reflection[m - 1]
            c = math.sqrt(1 - k * k)
            backward[m] = k * forward + c * delayed[m - 1]
            forward = c * forward - k * delayed[m - 1]
        backward[0] = forward
        delayed = backward
        out[n] = sum(v * b for v, b in zip(weights, backward, strict=True))
    return out


def transfer(noise: Filter, angle: Array) -> Array:
    """|H|^2 from polynomials, evaluated by scipy. The numerator is a sum of reversed step-up polynomials."""
    reflection = noise.reflection
    numerator = np.zeros(len(reflection) + 1)
    gain = math.sqrt(math.prod(1 - k * k for k in reflection))
    for m, v in enumerate(noise.taps or (1.0,)):
        part = np.array([1.0, *coefficients_of(reflection[:m])])[::-1]
        numerator[: m + 1] += gain * v / math.sqrt(math.prod(1 - k * k for k in reflection[:m])) * part
    _, response = scipy.signal.freqz(numerator, [1.0, *coefficients_of(reflection)], worN=angle)
    return np.asarray(np.abs(response) ** 2)


def moments(noise: Filter, rate_hz: float) -> tuple[float, float]:
    """Power and centroid of the density, by adaptive quadrature on pieces that are graded around the peak."""
    half = rate_hz / 2
    steps = [half * 4.0**-j for j in range(9)]
    edges = sorted(
        {0.0, half, noise.peak_hz} | {min(max(noise.peak_hz + s * d, 0), half) for d in steps for s in (1, -1)}
    )

    def integral(weigh: bool) -> float:
        def f(x: float) -> float:
            return float(power_spectrum(noise, x, rate_hz)) * (x if weigh else 1.0)

        return sum(
            scipy.integrate.quad(f, a, b, epsabs=1e-11, epsrel=1e-9)[0] for a, b in itertools.pairwise(edges) if b > a
        )

    power = integral(False)
    return power, integral(True) / power


def ar(rate_hz: float, resonances: Sequence[tuple[float, float]], real: Sequence[float] = ()) -> tuple[float, ...]:
    """Reflection coefficients of an all-pole model with resonances (frequency, bandwidth) and real poles."""
    poles: list[complex] = list(real)
    for frequency, bandwidth in resonances:
        pole = np.exp((-bandwidth + 2j * frequency) * np.pi / rate_hz)
        poles += [pole, np.conj(pole)]
    return reflection_of(np.real(np.poly(poles))[1:])


# ---- stochastic filters ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("peak", "mean"), PAIRS)
@pytest.mark.parametrize("rate", RATES)
def test_ordinary_pairs_are_met_at_every_rate(peak: float, mean: float, rate: float) -> None:
    noise = stochastic_filter(peak, mean, rate)
    power, centroid = moments(noise, rate)
    assert power == pytest.approx(1, rel=1e-8)
    assert noise.mean_hz == pytest.approx(centroid, rel=1e-8)
    # No frequency of a fine grid, on polynomials that scipy evaluates, has more power than the reported peak.
    fine = np.linspace(0, np.pi, 20001)
    at_peak = transfer(noise, np.array([2 * np.pi * noise.peak_hz / rate]))[0]
    assert transfer(noise, fine).max() <= at_peak * (1 + 1e-9)
    assert noise.peak_hz == pytest.approx(peak, rel=1e-4)
    if mean <= 0.35 * rate:
        assert noise.mean_hz == pytest.approx(mean, rel=1e-4)
        assert noise.met(peak, mean)
    assert noise.met(peak, noise.mean_hz)


def test_every_sandpaper_is_met_where_its_power_fits() -> None:
    for rate in (2e3, 4e3, 5e3, 10e3):
        frequency = np.linspace(0, 0.4 * rate, 4001)
        for peak in range(100, 501, 50):
            for times in (1.05, 1.2, 1.5, 2.0):
                mean = peak * times
                if mean >= rate / 2:
                    continue
                noise = stochastic_filter(peak, mean, rate)
                # Where the nearest pair stands in, a white tail shows that 0.4 of the rate cannot hold the power.
                held = scipy.integrate.trapezoid(power_spectrum(noise, frequency, rate), frequency)
                assert noise.met(peak, mean) or (held < 0.99 and mean > 0.3 * rate), (rate, peak, mean)
                if rate >= 4e3:
                    assert noise.met(peak, mean, 1e-4)
                    assert noise.taps is None or mean == rate / 4


def test_at_a_quarter_of_the_rate_a_second_order_filter_means_its_peak() -> None:
    noise = stochastic_filter(250, 250, 1e3)
    assert noise.taps is None and len(noise.reflection) == 2
    assert noise.met(250, 250, 1e-9)
    # It is a peak, not white noise: more than 3 dB over both ends.
    assert np.all(power_spectrum(noise, [0, 500], 1e3) < 0.5 * power_spectrum(noise, 250, 1e3))


@pytest.mark.parametrize(("peak", "mean", "rate"), [(250, 310, 10e3), (150, 400, 5e3), (100, 105, 2e3)])
def test_the_mean_agrees_with_its_closed_form(peak: float, mean: float, rate: float) -> None:
    """The angle is pi/2 - 4/pi sum over odd n of cos(n w)/n^2, so the centroid of an AR(2) with autocorrelation
    Re(C p^n) is pi/2 - 4/pi Re(C chi(p)) with Legendre's chi function, (Li_2(p) - Li_2(-p))/2."""
    noise = stochastic_filter(peak, mean, rate)
    assert noise.taps is None
    k1, k2 = (mpmath.mpf(k) for k in noise.reflection)
    a1 = k1 * (1 + k2)
    pole = (-a1 + mpmath.sqrt(mpmath.mpc(a1**2 - 4 * k2))) / 2
    # rho_0 = 1, rho_1 = -k1 fix C.
    phase = (-k1 - pole.real) / -pole.imag
    chi = (mpmath.polylog(2, pole) - mpmath.polylog(2, -pole)) / 2
    angle = mpmath.pi / 2 - 4 / mpmath.pi * (mpmath.mpc(1, phase) * chi).real
    assert noise.mean_hz == pytest.approx(float(angle * rate / (2 * mpmath.pi)), rel=1e-12)
    # The closed form of the peak: cos w = -a1 (1 + a2)/(4 a2).
    assert noise.peak_hz == pytest.approx(float(mpmath.acos(-a1 * (1 + k2) / (4 * k2)) * rate / (2 * mpmath.pi)), 1e-5)


fraction = st.floats(0, 0.5, exclude_min=True, exclude_max=True) | st.floats(-7, 0).map(lambda x: 0.499 * 10**x)


@pytest.mark.long
@settings(max_examples=50, deadline=None)
@given(peak=fraction, mean=fraction, rate=st.sampled_from(RATES))
def test_any_pair_gives_a_sound_filter_that_reports_itself(peak: float, mean: float, rate: float) -> None:
    if not (0 < peak * rate < rate / 2 and 0 < mean * rate < rate / 2):
        return
    noise = stochastic_filter(peak * rate, mean * rate, rate)
    assert all(abs(k) < 1 for k in noise.reflection)
    assert len(noise.reflection) <= 3
    assert np.abs(np.roots([1, *coefficients_of(noise.reflection)])).max(initial=0) <= 0.9999
    if noise.taps is not None:
        assert len(noise.taps) == len(noise.reflection) + 1
        assert math.fsum(v * v for v in noise.taps) == pytest.approx(1, abs=1e-12)
    # The peak stays where it was asked for, but for the outermost 0.0005 of the rate.
    assert noise.peak_hz == pytest.approx(min(max(peak, 5e-4), 0.5 - 5e-4) * rate, rel=0.02)
    power, centroid = moments(noise, rate)
    assert power == pytest.approx(1, rel=1e-6)
    assert noise.mean_hz == pytest.approx(centroid, rel=1e-6)
    stochastic_filter.cache_clear()
    assert stochastic_filter(peak * rate, mean * rate, rate) == noise


def test_an_impossible_pair_is_met_as_closely_as_by_a_search_of_second_order_filters() -> None:
    for peak, mean, rate in ((150, 400, 1e3), (400, 120, 1e3), (250, 120, 10e3), (4000, 200, 10e3)):
        noise = stochastic_filter(peak, mean, rate)
        assert not noise.met(peak, mean)
        assert noise.met(peak, noise.mean_hz)
        angle = np.linspace(0, np.pi, 20001)
        best = math.inf
        for a2 in np.linspace(0.05, 0.98, 60):
            a1 = -4 * a2 / (1 + a2) * math.cos(2 * np.pi * peak / rate)
            power = np.abs(scipy.signal.freqz([1], [1, a1, a2], worN=angle)[1]) ** 2
            centroid = np.sum(angle * power) / np.sum(power) * rate / (2 * np.pi)
            best = min(best, abs(centroid - mean))
        assert abs(noise.mean_hz - mean) < best


@pytest.mark.parametrize(
    "pair", [(0, 100), (100, 0), (-1, 100), (500, 100), (100, 500), (math.nan, 100), (100, math.inf)]
)
def test_pairs_outside_the_band_are_refused(pair: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match="between 0 and half the rate, 500 Hz"):
        stochastic_filter(*pair, 1e3)


def test_met() -> None:
    noise = Filter((), None, 100.0, 200.0)
    assert noise.met(100, 200, 0) and noise.met(102, 195)
    assert not noise.met(104, 200) and not noise.met(100, 207) and noise.met(100, 207, 0.04)


# ---- spectra and coefficients ----------------------------------------------------------------------------------

stable = st.lists(st.floats(-0.95, 0.95), max_size=32)


@pytest.mark.long
@settings(max_examples=60, deadline=None)
@given(reflection=st.lists(st.floats(-0.9, 0.9), max_size=10), ladder=st.booleans(), seed=st.integers(0, 999))
def test_spectrum_is_that_of_the_lattice_in_time(reflection: list[float], ladder: bool, seed: int) -> None:
    taps = None
    if ladder:
        raw = np.random.default_rng(seed).normal(size=len(reflection) + 1)
        taps = tuple((raw / np.linalg.norm(raw)).tolist())
    response = impulse_response(reflection, taps, 4096)
    if abs(response[-400:]).max() > 1e-9:
        return  # rings on beyond the window
    assert np.sum(response**2) == pytest.approx(1, rel=1e-9)
    frequency = np.fft.rfftfreq(4096, 1e-3)
    expected = np.abs(np.fft.rfft(response)) ** 2 * 2e-3
    np.testing.assert_allclose(power_spectrum((reflection, taps), frequency, 1e3), expected, rtol=1e-6, atol=1e-12)


def test_ladder_of_a_designed_filter_is_its_rational_function() -> None:
    for pair in ((400, 300, 10e3), (250, 310, 1e3), (20, 2400, 10e3), (500, 525, 2e3)):
        noise = stochastic_filter(*pair)
        assert noise.taps is not None
        response = impulse_response(noise.reflection, noise.taps, 20000)
        assert np.sum(response**2) == pytest.approx(1, rel=1e-9)
        angle = np.linspace(0.001, 3.1, 50)
        np.testing.assert_allclose(
            power_spectrum(noise, angle * pair[2] / (2 * np.pi), pair[2]) * pair[2] / 2,
            transfer(noise, angle),
            rtol=1e-8,
        )


@settings(max_examples=60, deadline=None)
@given(reflection=stable)
def test_coefficients_filter_like_the_lattice(reflection: list[float]) -> None:
    gain = math.sqrt(math.prod(1 - k * k for k in reflection))
    pulse = np.zeros(40)
    pulse[0] = gain
    expected = scipy.signal.lfilter([1.0], [1.0, *coefficients_of(reflection)], pulse)
    np.testing.assert_allclose(impulse_response(reflection, None, 40), expected, rtol=1e-6, atol=1e-9)


def exact_reflection(coefficients: Sequence[float]) -> list[float] | None:
    """The step-down with 80 digits; None where the filter is not stable."""
    with mpmath.workdps(80):
        polynomial = [mpmath.mpf(1), *map(mpmath.mpf, coefficients)]
        found: list[float] = []
        while len(polynomial) > 1:
            k = polynomial[-1]
            if abs(k) >= 1:
                return None
            found.insert(0, float(k))
            polynomial = [(a - k * b) / (1 - k * k) for a, b in zip(polynomial[:-1], polynomial[:0:-1], strict=True)]
    return found


@pytest.mark.long
@settings(max_examples=60, deadline=None)
@given(
    pairs=st.lists(st.tuples(st.floats(0.05, 0.995), st.floats(0.01, 3.13)), max_size=16),
    grow=st.booleans(),
)
def test_step_down_finds_unstable_filters_and_is_reversible(pairs: list[tuple[float, float]], grow: bool) -> None:
    # Exact coefficients, with one pair of poles pushed out of the circle.
    with mpmath.workdps(60):
        polynomial = [mpmath.mpf(1)]
        for i, (radius, angle) in enumerate(pairs):
            r = mpmath.mpf(1) / radius if grow and i == 0 else mpmath.mpf(radius)
            factor = [1, -2 * r * mpmath.cos(angle), r * r]
            polynomial = [
                sum(factor[j] * polynomial[i - j] for j in range(3) if 0 <= i - j < len(polynomial))
                for i in range(len(polynomial) + 2)
            ]
        coefficients = [float(a) for a in polynomial[1:]]
    expected = exact_reflection(coefficients)
    if expected is None:
        with pytest.raises(ValueError, match="not stable"):
            reflection_of(coefficients)
        return
    assert not grow or not pairs
    reflection = reflection_of(coefficients)
    np.testing.assert_allclose(reflection, expected, rtol=1e-14)
    # Backward stable: step-up after step-down gives the same coefficients.
    np.testing.assert_allclose(coefficients_of(reflection), coefficients, rtol=1e-12, atol=1e-11)


def test_order_32_with_poles_close_to_the_circle() -> None:
    """16 resonances of radius 0.99 below a quarter of the rate: E_p is 1e-20 of the power, so that the step-down loses
    the digits of a double; the reference has 80."""
    angles = np.linspace(0.05, 1.5, 16)
    poles = 0.99 * np.exp(1j * np.concatenate((angles, -angles)))
    coefficients = np.real(np.poly(poles))[1:]
    expected = exact_reflection(coefficients.tolist())
    assert expected is not None
    np.testing.assert_allclose(reflection_of(coefficients), expected, rtol=1e-14)


@pytest.mark.parametrize(
    "coefficients", [[1.0], [-1.0], [-2.0, 1.0], [0.0, 1.5], [-1.99, 0.9], [math.nan], [math.inf, 0]]
)
def test_unstable_or_unbounded_coefficients_are_refused(coefficients: list[float]) -> None:
    with pytest.raises(ValueError, match=r"not stable|finite"):
        reflection_of(coefficients)


def test_sign_convention() -> None:
    """x[n] = -a_1 x[n-1] + e[n]: a negative a_1 is a low-pass filter with a pole at -a_1."""
    assert reflection_of([-0.9]) == (-0.9,)
    assert coefficients_of((-0.5, 0.25)) == (-0.625, 0.25)
    assert reflection_of([]) == () and coefficients_of([]) == ()
    low, high = power_spectrum(((-0.9,), None), [0, 500], 1e3)
    assert low / high == pytest.approx((1.9 / 0.1) ** 2)


# ---- resampling ------------------------------------------------------------------------------------------------


def error_db(
    model: Sequence[float], from_hz: float, found: Sequence[float], to_hz: float, kept: float
) -> tuple[float, float]:
    """Largest and RMS difference where the model, limited to the band and brought to unit power, is within 30 dB of its
    peak, with scipy's freqz on both."""
    frequency = np.linspace(0, min(from_hz, to_hz) / 2, 40001)
    spectra = []
    for reflection, rate in ((model, from_hz), (found, to_hz)):
        gain = math.prod(1 - k * k for k in reflection)
        _, response = scipy.signal.freqz([1.0], [1.0, *coefficients_of(reflection)], worN=frequency, fs=rate)
        spectra.append(10 * np.log10(gain * np.abs(response) ** 2 * 2 / rate))
    truth = spectra[0] - 10 * math.log10(kept)
    difference = (spectra[1] - truth)[truth >= truth.max() - 30]
    return float(np.abs(difference).max()), float(np.sqrt(np.mean(difference**2)))


DOWN = {
    "one": [(250, 150)],
    "three": [(180, 60), (700, 300), (2500, 800)],
    "many": [(120, 40), (300, 60), (900, 200), (2200, 300), (4000, 900)],
    "broad": [(250, 400), (1500, 900)],
}
UP = {
    "one": [(250, 100)],
    "two": [(100, 30), (300, 60)],
    "four": [(60, 20), (150, 30), (250, 60), (400, 80)],
    "broad": [(100, 150), (300, 200)],
}


@pytest.mark.parametrize("name", DOWN)
@pytest.mark.parametrize(("from_hz", "to_hz"), [(25e3, 10e3), (25e3, 5e3), (25e3, 1e3), (10e3, 1e3), (10e3, 9e3)])
def test_down_a_model_keeps_its_spectrum(name: str, from_hz: float, to_hz: float) -> None:
    model = ar(from_hz, DOWN[name], [0.5])
    found, kept, told = resampled(model, from_hz, to_hz)
    worst, rms = error_db(model, from_hz, found, to_hz, kept)
    assert worst < MAX_RESAMPLING_ERROR_DB + 0.2
    assert told == pytest.approx(worst, abs=0.2)
    assert rms < 0.45
    # The total power is 1, so the part in the band is an integral of the density.
    frequency = np.linspace(0, to_hz / 2, 400001)
    held = scipy.integrate.simpson(power_spectrum((model, None), frequency, from_hz), x=frequency)
    assert kept == pytest.approx(held, rel=1e-6)


@pytest.mark.parametrize("name", UP)
@pytest.mark.parametrize(("from_hz", "to_hz"), [(5e3, 10e3), (1e3, 2e3), (1e3, 5e3), (1e3, 10e3)])
def test_up_a_model_keeps_its_spectrum_and_adds_little_beyond(name: str, from_hz: float, to_hz: float) -> None:
    model = ar(from_hz, UP[name], [0.3])
    found, kept, told = resampled(model, from_hz, to_hz)
    assert kept == pytest.approx(1, abs=1e-9)
    worst, rms = error_db(model, from_hz, found, to_hz, kept)
    assert told == pytest.approx(worst, abs=0.2)
    assert worst < (2 * MAX_RESAMPLING_ERROR_DB if to_hz <= 5e3 else 4 * MAX_RESAMPLING_ERROR_DB)
    assert rms < 0.8
    frequency = np.linspace(from_hz / 2, to_hz / 2, 40001)
    assert scipy.integrate.simpson(power_spectrum((found, None), frequency, to_hz), x=frequency) < 0.05


def test_the_order_is_the_smallest_that_is_close() -> None:
    # The plain case, where all orders come from one recursion: nothing shorter is close.
    model = ar(25e3, DOWN["three"])
    found, kept, _ = resampled(model, 25e3, 10e3)
    assert error_db(model, 25e3, found, 10e3, kept)[0] <= MAX_RESAMPLING_ERROR_DB
    for order in range(1, len(found)):
        assert error_db(model, 25e3, found[:order], 10e3, kept)[0] > MAX_RESAMPLING_ERROR_DB


def test_white_noise_stays_white_and_equal_rates_change_nothing() -> None:
    assert resampled((), 25e3, 10e3) == ((), pytest.approx(0.4), pytest.approx(0, abs=1e-9))
    model = (0.5, -0.25, 0.125)
    assert resampled(model, 5e3, 5e3) == (model, 1.0, 0.0)


@pytest.mark.long
@settings(max_examples=40, deadline=None)
@given(
    reflection=st.lists(st.floats(-0.99, 0.99), max_size=32),
    rates=st.tuples(st.sampled_from([500.0, 1e3, 5e3, 25e3, 1e5]), st.sampled_from([1e3, 2e3, 9999.0, 10e3])),
)
def test_whatever_is_resampled_is_stable(reflection: list[float], rates: tuple[float, float]) -> None:
    found, kept, _ = resampled(tuple(reflection), *rates)
    assert all(abs(k) < 1 for k in found)
    assert 0 < kept <= 1
    assert len(found) <= 32


def test_a_sharp_line_survives() -> None:
    for to_hz in (10e3, 1e3):
        model = ar(25e3, [(300, 2)])
        found, kept, _ = resampled(model, 25e3, to_hz)
        assert kept == pytest.approx(1, abs=0.02)
        assert error_db(model, 25e3, found, to_hz, kept)[0] < MAX_RESAMPLING_ERROR_DB + 0.1


# ---- grids -----------------------------------------------------------------------------------------------------


def test_a_complete_grid_is_reproduced() -> None:
    rng = np.random.default_rng(1)
    models = [
        Model(v, f, tuple(rng.uniform(-0.99, 0.99, 4 if v == 0.1 else 3).tolist()), float(rng.uniform(0, 5)))
        for v in (0.2, 0.05, 0.1)
        for f in (1.0, 0.5)
    ]
    found = grid(models)
    assert found.speeds == (0.05, 0.1, 0.2) and found.forces == (0.5, 1.0)
    assert found.nodes.shape == (3, 2, 5)
    for model in models:
        node = found.nodes[found.speeds.index(model.speed_m_per_s), found.forces.index(model.force_n)]
        assert node.tolist() == [model.rms_m_per_s2, *model.reflection, 0.0][:5]


places = st.tuples(st.floats(0, 1), st.floats(0, 5))


@pytest.mark.long
@settings(max_examples=60, deadline=None)
@given(models=st.dictionaries(places, st.tuples(stable, st.floats(0, 100)), min_size=1, max_size=12))
def test_scattered_models_are_met_and_the_rest_lies_between(
    models: dict[tuple[float, float], tuple[list[float], float]],
) -> None:
    given_models = [Model(v, f, tuple(k), rms) for (v, f), (k, rms) in models.items()]
    found = grid(given_models)
    order = max(len(model.reflection) for model in given_models)
    assert list(found.speeds) == sorted({v for v, _ in models}) and list(found.forces) == sorted({f for _, f in models})
    assert np.all(np.isfinite(found.nodes)) and np.all(np.abs(found.nodes[..., 1:]) < 1)
    rms = [model.rms_m_per_s2 for model in given_models]
    assert np.all((found.nodes[..., 0] >= min(rms)) & (found.nodes[..., 0] <= max(rms)))
    for model in given_models:
        node = found.nodes[found.speeds.index(model.speed_m_per_s), found.forces.index(model.force_n)]
        padded = [*model.reflection, *[0.0] * (order - len(model.reflection))]
        assert node.tolist() == [model.rms_m_per_s2, *padded]


def test_a_missing_corner_is_a_mean_by_distance_on_scaled_axes() -> None:
    # Speeds span 0.1, forces 2: the corner is 1, sqrt 2 and 1 away from the others, with weights 2/5, 1/5, 2/5.
    found = grid([Model(0.1, 1, (0.5,), 1.0), Model(0.2, 1, (0.1,), 2.0), Model(0.1, 3, (-0.4,), 4.0)])
    np.testing.assert_allclose(found.nodes[1, 1], [0.2 * 1 + 0.4 * 2 + 0.4 * 4, 0.2 * 0.5 + 0.4 * 0.1 - 0.4 * 0.4])
    # A node close to a model is nearly that model.
    near = grid([Model(0.1, 1, (0.9,), 1.0), Model(0.1001, 1.001, (0.2,), 3.0), Model(1.0, 9.0, (-0.9,), 5.0)])
    assert near.nodes[0, 2, 1] != 0.9
    assert abs(near.nodes[0, 1, 0] - 2) < 1.1


def test_the_largest_grid() -> None:
    most = [Model(i / 100, i / 10, (0.1 * (i % 3),), 1.0) for i in range(MAX_MODELS)]
    assert grid(most).nodes.shape == (MAX_MODELS, MAX_MODELS, 2)


def test_a_higher_rate_keeps_all_power_however_sharp_the_poles() -> None:
    model = np.random.default_rng(0).uniform(-0.9, 0.9, 31).tolist()
    assert resampled((*model, -(1 - 1e-13)), 1e3, 10e3).kept == 1
