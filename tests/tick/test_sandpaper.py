"""Sandpaper as the tick renders it: its power, its spectrum, its rests, and what updates of a scene do to it.

References are scipy's filters on the numbers that stand in the compiled table, closed forms, and one run against
another. Seeds are fixed, so every figure is the same on every run. How far an estimate may lie from what it estimates
follows from the spectrum: the power of N samples of noise with density P (mean 1 over the band) scatters by
sqrt(2 mean(P^2)/N) of itself, that of a Gaussian process.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pytest
import scipy.interpolate
import scipy.signal

from hapticd.base.core import NOISE_DTYPE, EventKind, Flag, Status, ffi, invalid_reason, lib, pointer, records
from hapticd.rendering.device_output import output_of
from hapticd.rendering.displayability import warnings
from hapticd.rendering.offline import render_run
from hapticd.rendering.resampling import MAX_RESAMPLING_ERROR_DB
from tests.support.marks import rest_slow
from tests.support.rig import FLOOR, Rig, still

Array = npt.NDArray[np.float64]

RATES = (1e3, 2e3, 4e3, 5e3, 10e3)
GRITS = (60, 100, 400, 600)
STIFFNESS = 800.0
MASS = 0.05
SLANT = (0.6, 0.8)
"""A normal whose components are exact enough to tell tangent from normal."""
SANDPAPER = {"kind": "stochastic", "peak_hz": 250, "mean_hz": 310, "velocity_gain_per_s": 40, "seed": 7}
PATCH_RAMP = 0.002


# ---- what is under test ----------------------------------------------------------------------------------------


def material(texture: Mapping[str, object] | None, stiffness: float = STIFFNESS) -> dict[str, object]:
    made: dict[str, object] = {"stiffness_n_per_m": stiffness}
    return made if texture is None else {**made, "texture": dict(texture)}


def floor(name: str = "paper", **keys: object) -> dict[str, object]:
    return {**FLOOR, "material": name, **keys}


def rig_of(
    texture: Mapping[str, object],
    rate_hz: float = 1e3,
    *,
    normal: Sequence[float] = (0.0, 1.0),
    max_force_n: float = 100.0,
    **scene: object,
) -> Rig:
    """A floor of one texture; the effective mass is `MASS`."""
    return Rig(
        {"w": floor(normal=list(normal))},
        materials={"paper": material(texture)},
        rate_hz=rate_hz,
        device={"effective_mass_kg": MASS, "max_force_n": max_force_n},
        **scene,
    )


class Stroke(NamedTuple):
    """Positions and velocities of a stroke that presses with the same force all the time."""

    position_m: Array
    velocity_m_per_s: Array


def stroke(speed: npt.ArrayLike, force_n: float, rate_hz: float, normal: Sequence[float] = (0.0, 1.0)) -> Stroke:
    """A tangential speed a tick, on a floor of `STIFFNESS` through the origin."""
    v = np.atleast_1d(np.asarray(speed, dtype=np.float64))
    n = np.asarray(normal, dtype=np.float64)
    t = np.array([n[1], -n[0]])
    s = np.cumsum(v) / rate_hz
    return Stroke(np.outer(s, t) - force_n / STIFFNESS * n, np.outer(v, t))


def vibration(rig: Rig, path: Stroke) -> Array:
    """The tangential component on a level floor, m/s^2: samples before the effective mass."""
    force = rig.render(path.position_m, path.velocity_m_per_s)["vibration_force_n"]
    assert not np.any(force[:, 1])
    return np.asarray(force[:, 0] / MASS)


class Noise(NamedTuple):
    """What a table says of the noise of an object."""

    record: Any
    speeds: Array
    forces: Array
    rms: Array
    reflection: Array
    taps: Array


def noise_of(rig: Rig, id: str = "w") -> Noise:
    found = rig.compiler.slot_of(id)
    assert found is not None
    table = rig.table
    record = table.noises[table.materials[table.objects[found[0]].material].noise]
    numbers = np.frombuffer(ffi.buffer(table.numbers, 8 * table.number_count), np.float64)[record.first :].copy()
    axes, nodes = np.split(numbers, [record.speed_count + record.force_count])
    size = 1 + record.order + (record.order + 1 if record.taps else 0)
    grid = nodes[: record.speed_count * record.force_count * size].reshape(record.speed_count, record.force_count, size)
    speeds, forces = np.split(axes, [record.speed_count])
    return Noise(record, speeds, forces, grid[..., 0], grid[..., 1 : 1 + record.order], grid[..., 1 + record.order :])


def run(
    nodes: npt.ArrayLike,
    speed: npt.ArrayLike,
    force: npt.ArrayLike,
    *,
    taps: bool = False,
    speeds: Sequence[float] = (0.0,),
    forces: Sequence[float] = (0.0,),
    **fields: float,
) -> Array:
    """hd_noise_run; `nodes` [speeds][forces][RMS, reflection coefficients, taps]."""
    grid = np.asarray(nodes, dtype=np.float64)
    order = (grid.shape[-1] - 2) // 2 if taps else grid.shape[-1] - 1
    numbers = np.concatenate([speeds, forces, grid.ravel()])
    held = records(NOISE_DTYPE, 1)
    record = pointer("struct hd_noise[]", held)[0]
    record.order, record.taps, record.speed_count, record.force_count = order, taps, len(speeds), len(forces)
    record.force_per_unit = 1.0
    for name, value in fields.items():
        setattr(record, name, value)
    v, f = (np.ascontiguousarray(x, dtype=np.float64) for x in np.broadcast_arrays(speed, force))
    out = np.empty(len(v))
    v_pointer, f_pointer, out_pointer = (pointer("double[]", x) for x in (v, f, out))
    place = ffi.addressof(record)
    status = lib.hd_noise_run(
        place, pointer("double[]", numbers), len(numbers), len(v), v_pointer, f_pointer, out_pointer
    )
    assert status == Status.OK, invalid_reason()
    return out


# ---- references ------------------------------------------------------------------------------------------------


def ratio(reflection: Sequence[float] | Array, taps: Sequence[float] | Array = ()) -> tuple[Array, Array]:
    """Numerator and denominator of the lattice of unit power: A_m = A_(m-1) + k_m z^-1 B_(m-1) with B_m its reverse;
    B_m is heard through the cosines of the stages above it."""
    rows = [np.ones(1)]
    for k in reflection:
        longer = np.append(rows[-1], 0.0)
        rows.append(longer + k * longer[::-1])
    cosines = np.sqrt(1 - np.asarray(reflection, dtype=np.float64) ** 2)
    numerator = np.zeros(len(rows))
    for m, v in enumerate(taps if len(taps) else (1.0,)):
        numerator[: m + 1] += v * np.prod(cosines[m:]) * rows[m][::-1]
    return numerator, rows[-1]


class Spectrum(NamedTuple):
    frequency_hz: Array
    density: Array
    """1/Hz, one-sided."""

    @classmethod
    def of(cls, numerator: npt.ArrayLike, denominator: npt.ArrayLike, rate_hz: float) -> Spectrum:
        frequency = np.linspace(0, rate_hz / 2, 100_001)
        _, response = scipy.signal.freqz(numerator, denominator, worN=frequency, fs=rate_hz)
        return cls(frequency, np.abs(response) ** 2 * 2 / rate_hz)

    def within(self, low_hz: float, high_hz: float) -> float:
        held = (self.frequency_hz >= low_hz) & (self.frequency_hz <= high_hz)
        return float(np.trapezoid(self.density[held], self.frequency_hz[held]))

    @property
    def power(self) -> float:
        return float(np.trapezoid(self.density, self.frequency_hz))

    @property
    def peak_hz(self) -> float:
        return float(self.frequency_hz[np.argmax(self.density)])

    @property
    def mean_hz(self) -> float:
        return float(np.trapezoid(self.density * self.frequency_hz, self.frequency_hz)) / self.power

    def scatter(self, seconds: float) -> float:
        """Standard deviation of the RMS of so many seconds, as a fraction of it."""
        square = float(np.trapezoid(self.density**2, self.frequency_hz)) / self.power**2
        return 0.5 * math.sqrt(square / seconds)


def spectrum_of(rig: Rig, id: str = "w", node: tuple[int, int] = (0, 0)) -> Spectrum:
    noise = noise_of(rig, id)
    return Spectrum.of(*ratio(noise.reflection[node], noise.taps[node]), rig.rate_hz)


def recorded(rate_hz: float, resonances: Sequence[tuple[float, float]], real: Sequence[float] = ()) -> list[float]:
    """a_1 .. a_p of an all-pole model with resonances (frequency, half-power bandwidth) and real poles."""
    poles: list[complex] = list(real)
    for frequency, bandwidth in resonances:
        pole = np.exp(np.pi * (-bandwidth + 2j * frequency) / rate_hz)
        poles += [pole, np.conj(pole)]
    return [float(a) for a in np.real(np.poly(poles))[1:]]


def gain_of(coefficients: Sequence[float]) -> float:
    """RMS of the output for white numbers of unit RMS, from the impulse response."""
    pulse = np.zeros(20_000)
    pulse[0] = 1
    response = scipy.signal.lfilter([1], [1, *coefficients], pulse)
    assert abs(response[-1000:]).max() < 1e-12
    return float(np.sqrt(np.sum(response**2)))


def rms(samples: Array) -> float:
    return float(np.sqrt(np.mean(samples**2)))


def has_spectrum(samples: Array, expected: Spectrum, rate_hz: float) -> None:
    """Welch's estimate against scipy's, in ten bands of a tenth of the power each: to five times their scatter, and
    half the resolution of 1 Hz at each edge."""
    frequency, density = scipy.signal.welch(samples, rate_hz, nperseg=round(rate_hz))
    measured = Spectrum(frequency, density / (np.sum(density) * frequency[1]))
    share = np.cumsum(expected.density)
    edges = np.interp(np.linspace(0, 1, 11), share / share[-1], expected.frequency_hz)
    found = np.interp(edges, frequency, np.cumsum(measured.density) * frequency[1])
    squares = np.interp(edges, expected.frequency_hz, np.cumsum(expected.density**2) * expected.frequency_hz[1])
    allowed = 5 * np.sqrt(np.diff(squares) * rate_hz / len(samples)) + np.interp(edges[1:], *expected)
    assert np.count_nonzero(allowed < 0.03) >= 4
    assert np.all(np.abs(np.diff(found) - 0.1) < allowed)


# ---- 1. power --------------------------------------------------------------------------------------------------

RECORDED_HZ = 5e3
MODELS: dict[tuple[float, float], tuple[list[float], float]] = {
    (0.05, 0.5): (recorded(RECORDED_HZ, [(120, 100), (400, 300)]), 0.2),
    (0.05, 2.0): (recorded(RECORDED_HZ, [(160, 120), (420, 200)]), 0.5),
    (0.2, 0.5): (recorded(RECORDED_HZ, [(180, 150)], [0.4]), 0.4),
    (0.2, 2.0): (recorded(RECORDED_HZ, [(220, 150), (380, 250)], [-0.3]), 0.9),
}


def autoregressive(
    models: Mapping[tuple[float, float], tuple[Sequence[float], float]], **keys: object
) -> dict[str, object]:
    """By speed and force: coefficients, and the RMS of the innovation, which is told as such or by what it makes of the
    output."""
    found: list[dict[str, object]] = []
    for index, ((speed, force), (a, innovation)) in enumerate(models.items()):
        level = {"rms_m_per_s2": innovation * gain_of(a)} if index % 2 else {"variance_m2_per_s4": innovation**2}
        found.append({"speed_m_per_s": speed, "force_n": force, "coefficients": list(a), **level})
    return {"kind": "autoregressive", "rate_hz": RECORDED_HZ, "models": found, **keys}


def law_of_models(speed: float, force: float, rate_hz: float) -> float:
    """RMS by the four models: each one's power in the band of the rate, then bilinear."""
    values = np.empty((2, 2))
    for place, (a, innovation) in MODELS.items():
        spectrum = Spectrum.of([1], [1, *a], RECORDED_HZ)
        kept = spectrum.within(0, rate_hz / 2) / spectrum.power
        values[int(place[0] == 0.2), int(place[1] == 2.0)] = innovation * gain_of(a) * math.sqrt(kept)
    grid = scipy.interpolate.RegularGridInterpolator(((0.05, 0.2), (0.5, 2.0)), values)
    return float(grid([min(max(speed, 0.05), 0.2), min(max(force, 0.5), 2.0)])[0])


@pytest.mark.parametrize("rate", rest_slow(RATES))
@pytest.mark.parametrize("kind", ["stochastic", "autoregressive"])
def test_a_minute_of_a_stroke_has_the_power_of_the_law(kind: str, rate: float) -> None:
    """Force per acceleration is the effective mass; the sense of the motion does not matter."""
    worst = 0.0
    for speed, force, direction in ((0.1, 0.8, "tangent"), (-0.25, 2.0, "normal"), (0.03, 0.3, "tangent")):
        if kind == "stochastic":
            texture: dict[str, object] = {**SANDPAPER, "force_gain_m_per_s2_per_n": 5}
            law = 40 * abs(speed) + 5 * force
        else:
            texture, law = autoregressive(MODELS), law_of_models(abs(speed), force, rate)
        rig = rig_of({**texture, "direction": direction}, rate, normal=SLANT)
        assert spectrum_of(rig).scatter(60) < 0.005
        path = stroke(np.full(round(60 * rate), speed), force, rate, SLANT)
        samples = rig.render(path.position_m)  # the estimated speed, as for anyone
        along, across = np.array([SLANT[1], -SLANT[0]]), np.array(SLANT)
        if direction == "normal":
            along, across = across, along
        noise = samples["vibration_force_n"] @ along
        assert np.abs(samples["vibration_force_n"] @ across).max() < 1e-14 * np.abs(noise).max()
        # The very first sample has no speed yet.
        assert noise[0] == 0 and np.all(noise[1:] != 0)
        worst = max(worst, abs(rms(noise[1:]) / (MASS * law) - 1))
        assert abs(float(np.mean(noise))) < 0.05 * MASS * law
        contact = samples["contact_force_n"][200:]
        np.testing.assert_allclose(contact, np.tile(force * np.array(SLANT), (len(contact), 1)), rtol=1e-9)
        np.testing.assert_allclose(
            samples["force_n"], samples["contact_force_n"] + samples["vibration_force_n"], rtol=1e-13, atol=1e-15
        )
    assert worst < 0.02


@pytest.mark.long
@pytest.mark.parametrize("rate", RATES)
def test_shipped_sandpapers_over_speeds_and_forces(rate: float) -> None:
    """To and fro: the speed is what counts. A minute's estimate scatters by less than a quarter of the 2 %."""
    gains = {60: (30, 3.0), 100: (24, 2.4), 400: (12, 1.2), 600: (8, 0.8)}
    rig = Rig({f"g{grit}": floor(f"sandpaper_{grit}") for grit in GRITS}, rate_hz=rate)
    for grit in GRITS:
        noise, spectrum = noise_of(rig, f"g{grit}"), spectrum_of(rig, f"g{grit}")
        node = [0.0, *noise.reflection[0, 0], *noise.taps[0, 0]]
        assert spectrum.scatter(60) < 0.005
        for index, (speed, force) in enumerate([(0.02, 0.5), (0.1, 1.0), (0.4, 3.0)]):
            v = speed * scipy.signal.square(np.arange(round(60 * rate)) * (2 * np.pi * 2.0 / rate))
            out = run(
                node,
                v,
                force,
                taps=bool(noise.record.taps),
                velocity_gain_per_s=noise.record.velocity_gain_per_s,
                force_gain_m_per_s2_per_n=noise.record.force_gain_m_per_s2_per_n,
                threshold_m_per_s=noise.record.threshold_m_per_s,
                seed=grit + 1000 * index,
            )
            assert rms(out) == pytest.approx(gains[grit][0] * speed + gains[grit][1] * force, rel=0.02)


def test_narrow_noise_has_its_power_when_listened_to_for_long_enough() -> None:
    """A minute of noise that is 20 Hz wide scatters by 0.8 %: 2 % are certain only after some more."""
    rig = rig_of({**SANDPAPER, "peak_hz": 40, "mean_hz": 42}, 2e3)
    spectrum, noise = spectrum_of(rig), noise_of(rig)
    seconds = 60 * math.ceil((spectrum.scatter(60) / 0.005) ** 2)
    assert seconds > 60 and spectrum.scatter(seconds) <= 0.005
    node = [1.0, *noise.reflection[0, 0], *noise.taps[0, 0]]
    out = run(node, np.full(round(seconds * 2e3), 0.1), 1.0, taps=bool(noise.record.taps))
    assert rms(out) == pytest.approx(1, rel=0.02)


# ---- 2. spectrum -----------------------------------------------------------------------------------------------

PAIRS = [
    (float(peak), peak * times)
    for peak in (40, 120, 250, 400, 700, 1500)
    for times in (0.8, 0.95, 1.0, 1.05, 1.3, 2.0, 3.0)
]


@pytest.mark.parametrize("rate", rest_slow(RATES))
def test_peak_and_mean_of_the_filter_in_the_table(rate: float) -> None:
    """What was asked for, or what the warning says instead; the latter only where 0.4 of the rate cannot hold 99 % of
    the power, or the mean is within 8 % of a peak at a quarter of the rate, where every mean needs a zero."""
    pairs = [(peak, mean) for peak, mean in PAIRS if peak <= 0.4 * rate and mean < rate / 2]
    assert len(pairs) > 20
    rig = Rig(
        {f"o{i}": floor(f"m{i}") for i in range(len(pairs))},
        materials={f"m{i}": material({**SANDPAPER, "peak_hz": p, "mean_hz": m}) for i, (p, m) in enumerate(pairs)},
        rate_hz=rate,
    )
    told = warnings(rig.config.scene.objects, rig.config.materials, output_of(rig.config, rate))
    reported = {problem.where: problem.problem for problem in told}
    met = 0
    for index, (peak, mean) in enumerate(pairs):
        spectrum = spectrum_of(rig, f"o{index}")
        assert spectrum.power == pytest.approx(1, rel=1e-6)
        problem = reported.pop(f"materials.m{index}.texture.mean_hz", None)
        if problem is None:
            met += 1
        else:
            shown = re.search(r"shown are ([\d.]+) Hz and ([\d.]+) Hz$", problem)
            assert shown is not None
            asked, (peak, mean) = (peak, mean), tuple(map(float, shown.groups()))
            assert peak == pytest.approx(asked[0], rel=0.03)
            assert spectrum.within(0, 0.4 * rate) < 0.99 or asked == (rate / 4, 0.95 * rate / 4)
        assert spectrum.peak_hz == pytest.approx(peak, rel=0.03)
        assert spectrum.mean_hz == pytest.approx(mean, rel=0.03)
    assert not reported
    assert met >= 0.85 * len(pairs)


@pytest.mark.parametrize("rate", RATES)
def test_shipped_sandpapers_sound_as_scipy_has_it(rate: float) -> None:
    pairs = {60: (120, 170), 100: (160, 210), 400: (220, 260), 600: (250, 280)}
    rig = Rig({f"g{grit}": floor(f"sandpaper_{grit}") for grit in GRITS}, rate_hz=rate)
    assert not warnings(rig.config.scene.objects, rig.config.materials, output_of(rig.config, rate))
    for grit, (peak, mean) in pairs.items():
        spectrum, noise = spectrum_of(rig, f"g{grit}"), noise_of(rig, f"g{grit}")
        assert spectrum.peak_hz == pytest.approx(peak, rel=0.03)
        assert spectrum.mean_hz == pytest.approx(mean, rel=0.03)
        node = [1.0, *noise.reflection[0, 0], *noise.taps[0, 0]]
        out = run(node, np.full(round(60 * rate), 0.1), 1.0, taps=bool(noise.record.taps), seed=grit)
        has_spectrum(out, spectrum, rate)


def test_the_lattice_is_scipys_filter_sample_by_sample() -> None:
    """White numbers of the seed come out of a filter of order 0. One with an order draws its delays first, which
    fade."""
    for seed, reflection, taps in ((1, [-0.8, 0.5], []), (2, [-0.6, 0.4, -0.3], [0.5, 0.5, -0.5, 0.5])):
        count = 3000
        white = run([1.0], np.full(count, 0.1), 0.0, seed=seed)
        assert np.abs(white).max() <= 6
        out = run([1.0, *reflection, *taps], np.full(count, 0.1), 0.0, taps=bool(taps), seed=seed)
        expected = scipy.signal.lfilter(*ratio(reflection, taps), white)
        # Every start draws as many, whatever its order.
        np.testing.assert_allclose(out[500:], expected[500:], rtol=0, atol=1e-12)


# ---- 3. rest, threshold, seeds, an hour ------------------------------------------------------------------------


@pytest.mark.slow
def test_an_hour_is_as_strong_at_its_end_as_at_its_beginning() -> None:
    rig = rig_of({**SANDPAPER, "force_gain_m_per_s2_per_n": 5}, 1e3)
    spectrum = spectrum_of(rig)
    levels = []
    for part in range(6):
        path = stroke(np.full(600_000, 0.1), 0.8, 1e3)
        samples = rig.render(path.position_m + np.array([60.0 * part, 0]))["vibration_force_n"][:, 0]
        levels.append(rms(samples[1:]) / (MASS * 8.0))
        for half in (samples[:300_000], samples[300_000:]):
            has_spectrum(half, spectrum, 1e3)
    assert np.abs(np.array(levels) - 1).max() < 4 * spectrum.scatter(600)
    assert abs(np.mean(levels) - 1) < 4 * spectrum.scatter(3600)
    assert spectrum.scatter(600) < 0.002


def test_at_rest_it_is_silent_and_moving_on_it_goes_on() -> None:
    """Not faded: exactly 0 from the first tick without speed; what follows is what would have followed at once."""
    for texture in (SANDPAPER, autoregressive(MODELS)):
        moving = stroke(np.full(4000, 0.1), 1.0, 1e3)
        through = vibration(rig_of(texture), moving)
        rig = rig_of(texture)
        resting = [*np.full(1000, 0.1), *np.zeros(5000), *np.full(1500, 0.1), *np.zeros(1), *np.full(1500, 0.1)]
        samples = vibration(rig, stroke(resting, 1.0, 1e3))
        still_standing = np.asarray(resting) == 0
        assert not np.any(samples[still_standing])
        assert np.array_equal(samples[~still_standing], through)


def test_a_hand_that_rests_and_moves_on_feels_the_same_law() -> None:
    rig = rig_of(SANDPAPER)
    for _ in range(3):
        assert rms(vibration(rig, stroke(np.full(60_000, 0.1), 1.0, 1e3))) == pytest.approx(4.0, rel=0.02)
        # Estimated speeds are 0 from the second tick of the same position on.
        rest = rig.render(still(6.0, -1.0 / STIFFNESS, 2000))["vibration_force_n"]
        assert not np.any(rest[1:])


def test_it_fades_linearly_below_the_threshold() -> None:
    node = [0.0, -0.9, 0.6]
    keys: dict[str, Any] = {"force_gain_m_per_s2_per_n": 3.0, "threshold_m_per_s": 0.004, "seed": 5}
    full = run(node, np.full(1000, 0.004), 2.0, **keys)
    for part in (1e-12, 0.1, 0.5, 0.999):
        np.testing.assert_allclose(run(node, np.full(1000, part * 0.004), 2.0, **keys), part * full, rtol=1e-12)
    np.testing.assert_array_equal(run(node, np.full(1000, 0.3), 2.0, **keys), full)
    # Through the tick, and with a level that itself follows the speed.
    texture = {**SANDPAPER, "threshold_m_per_s": 0.01, "force_gain_m_per_s2_per_n": 5}
    reference = vibration(rig_of(texture), stroke(np.full(500, 0.1), 1.0, 1e3)) / 9.0
    speeds = np.linspace(0.0001, 0.03, 500)
    levels = (40 * speeds + 5) * np.minimum(1, speeds / 0.01)
    np.testing.assert_allclose(vibration(rig_of(texture), stroke(speeds, 1.0, 1e3)), levels * reference, rtol=1e-10)


def test_what_a_negative_gain_leaves_is_at_least_silence() -> None:
    texture = {**SANDPAPER, "velocity_gain_per_s": 40, "force_gain_m_per_s2_per_n": -5}
    for force, level in ((0.2, 3.0), (0.8, 0.0), (0.9, 0.0), (5.0, 0.0)):
        samples = vibration(rig_of(texture), stroke(np.full(2000, 0.1), force, 1e3))
        if level == 0.0:
            assert np.abs(samples).max() < 1e-12
        else:
            unit = vibration(rig_of(SANDPAPER), stroke(np.full(2000, 0.1), force, 1e3)) / 4.0
            np.testing.assert_allclose(samples, level * unit, rtol=1e-9)


def test_same_seed_same_samples_another_seed_others() -> None:
    path = stroke(0.1 * np.sin(np.arange(20_000) / 300), 1.0, 1e3)
    for texture in (SANDPAPER, autoregressive(MODELS, seed=7)):
        config = {
            "device": {"effective_mass_kg": MASS, "max_force_n": 100},
            "materials": {"paper": material(texture)},
            "scene": {"objects": {"w": floor()}},
        }
        first, again = (render_run(config, path.position_m, 1e3).samples for _ in range(2))
        assert first.tobytes() == again.tobytes()
        others = []
        for seed in (0, 8, 2**53):
            config["materials"] = {"paper": material({**texture, "seed": seed})}
            others.append(render_run(config, path.position_m, 1e3).samples["vibration_force_n"][:, 0])
        x = first["vibration_force_n"][:, 0]
        for other in others:
            assert rms(other) == pytest.approx(rms(x), rel=0.1)
            assert abs(np.corrcoef(x, other)[0, 1]) < 0.1


# ---- 4. blends -------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_models_that_swing_every_20_samples_stay_within_6_times_their_rms() -> None:
    """10,000 random stable models of any order, each with another: an RMS of 1 at both ends, so of 1 between."""
    rng = np.random.default_rng(3)
    count = 1000
    swings = np.where(np.arange(count) // 20 % 2, 0.2, 0.1)
    largest, power = 0.0, []
    for pair in range(10_000):
        order, taps = int(rng.integers(1, 33)), bool(pair % 2)
        reflection = rng.uniform(-1, 1, (2, order))
        if pair % 5 == 0:  # poles next to the circle
            reflection = np.sign(reflection) * (1 - 10 ** rng.uniform(-6, 0, (2, order)))
        weights = rng.normal(size=(2, order + 1))
        weights /= np.linalg.norm(weights, axis=1)[:, None]
        nodes = np.hstack([np.ones((2, 1)), reflection, *([weights] if taps else [])]).reshape(2, 1, -1)
        out = run(nodes, swings, 0.0, taps=taps, speeds=(0.1, 0.2), seed=pair)
        largest = max(largest, float(np.abs(out).max()))
        power.append(float(np.mean(out**2)))
    assert largest < 6
    error = float(np.std(power)) / math.sqrt(len(power))
    assert error < 0.005
    assert np.mean(power) == pytest.approx(1, abs=0.02)


@pytest.mark.long
def test_a_material_that_becomes_another_every_20_ticks_stays_within_6_times_its_rms() -> None:
    """The ramp is 20 ticks, so that it is never at rest."""
    rng = np.random.default_rng(4)

    def another() -> dict[str, object]:
        if rng.integers(3) == 0:
            peak = float(rng.uniform(60, 350))
            return material({**SANDPAPER, "peak_hz": peak, "mean_hz": float(rng.uniform(1, 1.2)) * peak})
        reflection = rng.uniform(-1, 1, int(rng.integers(1, 9)))
        _, a = ratio(reflection)
        model = {"speed_m_per_s": 0, "force_n": 0, "coefficients": a[1:].tolist()}
        return material({"kind": "autoregressive", "rate_hz": 1000, "models": [{**model, "rms_m_per_s2": 4.0}]})

    rig = rig_of(SANDPAPER, 1e3)
    parts = [vibration(rig, stroke(np.full(20, 0.1), 1.0, 1e3))]
    for _ in range(300):
        rig.update({}, {"paper": another()})
        path = stroke(np.full(20, 0.1), 1.0, 1e3)
        parts.append(vibration(rig, path))
    samples = np.concatenate(parts)
    assert np.abs(samples).max() < 6 * 4.0
    # A tenth of a minute of noise that is a tenth as wide as its band.
    assert rms(samples) == pytest.approx(4.0, rel=0.1)


# ---- 5. models identified from recordings ----------------------------------------------------------------------


@pytest.mark.long
def test_models_shown_at_their_own_rate_are_the_models() -> None:
    """At each node: scipy's spectrum of the coefficients as they were given, and the power of the impulse response."""
    rig = rig_of(autoregressive(MODELS), RECORDED_HZ)
    noise = noise_of(rig)
    assert noise.speeds.tolist() == [0.05, 0.2] and noise.forces.tolist() == [0.5, 2.0]
    for index, ((speed, force), (a, innovation)) in enumerate(MODELS.items()):
        node = divmod(index, 2)
        given, held = Spectrum.of([1], [1, *a], RECORDED_HZ), spectrum_of(rig, node=node)
        np.testing.assert_allclose(held.density, given.density / given.power, rtol=1e-9)
        assert noise.rms[node] == pytest.approx(innovation * gain_of(a), rel=1e-12)
        samples = vibration(
            rig_of(autoregressive(MODELS), RECORDED_HZ), stroke(np.full(300_000, speed), force, RECORDED_HZ)
        )
        assert rms(samples) == pytest.approx(innovation * gain_of(a), rel=0.02)
        has_spectrum(samples, held, RECORDED_HZ)


@pytest.mark.parametrize("rate", [1e3, 2e3, 1e4])
def test_models_shown_at_another_rate_keep_their_spectrum_where_their_power_is(rate: float) -> None:
    """`resampled` aims at MAX_RESAMPLING_ERROR_DB; within 20 dB of the peak these models are met to 1 dB. The RMS is
    that of the band, without what lies beyond it."""
    rig = rig_of(autoregressive(MODELS), rate)
    noise = noise_of(rig)
    for index, (a, innovation) in enumerate(MODELS.values()):
        node = divmod(index, 2)
        given, shown = Spectrum.of([1], [1, *a], RECORDED_HZ), spectrum_of(rig, node=node)
        band = min(rate, RECORDED_HZ) / 2
        kept = given.within(0, band)
        frequency = np.linspace(1, 0.999 * band, 5000)
        expected = 10 * np.log10(np.interp(frequency, *given) / kept)
        found = 10 * np.log10(np.interp(frequency, *shown))
        heard = expected > expected.max() - 20
        assert np.abs(found - expected)[heard].max() < 1
        assert np.median(np.abs(found - expected)[heard]) < MAX_RESAMPLING_ERROR_DB
        assert shown.power == pytest.approx(1, rel=1e-3)
        assert shown.within(band, rate / 2) < 0.05
        assert noise.rms[node] == pytest.approx(innovation * gain_of(a) * math.sqrt(kept / given.power), rel=1e-4)


def test_between_nodes_level_and_filter_lie_between() -> None:
    """The level is bilinear, sample for sample; reflection coefficients are, too, and so the spectrum at a place is
    that of their mean."""
    rng = np.random.default_rng(6)
    speeds, forces = [0.02, 0.05, 0.2], [0.3, 1.0, 2.5, 4.0]
    levels = rng.uniform(0.5, 3, (3, 4))
    reflection = np.array([-0.7, 0.5, -0.2])
    nodes = np.concatenate([levels[..., None], np.tile(reflection, (3, 4, 1))], axis=2)
    v = np.abs(np.cumsum(rng.normal(size=5000))) * 0.002 + 0.01
    f = np.abs(np.cumsum(rng.normal(size=5000))) * 0.05
    grid = scipy.interpolate.RegularGridInterpolator((speeds, forces), levels)
    expected = grid(np.column_stack([np.clip(v, 0.02, 0.2), np.clip(f, 0.3, 4.0)]))
    out = run(nodes, v, f, speeds=speeds, forces=forces, seed=2)
    unit = run([1.0, *reflection], np.full(5000, 0.1), 1.0, seed=2)
    np.testing.assert_allclose(out, expected * unit, rtol=1e-11, atol=1e-13)

    ends = np.array([[-0.95, 0.8], [-0.2, 0.8]])
    place = 0.3
    nodes = np.column_stack([[1.0, 2.0], ends]).reshape(2, 1, 3)
    out = run(nodes, np.full(300_000, 0.1 + 0.1 * place), 1.0, speeds=(0.1, 0.2), seed=3)
    between = Spectrum.of(*ratio(ends[0] + place * (ends[1] - ends[0])), 1e3)
    assert rms(out) == pytest.approx(1.3, rel=0.02)
    has_spectrum(out, between, 1e3)
    low, high = (Spectrum.of(*ratio(k), 1e3).peak_hz for k in ends)
    assert low < between.peak_hz < high


@pytest.mark.long
def test_scattered_models_are_met_where_they_are_and_bound_the_rest() -> None:
    places = [(0.02, 0.3), (0.06, 2.2), (0.1, 0.9), (0.15, 3.0), (0.3, 1.4)]
    models = {place: (recorded(RECORDED_HZ, [(100 + 60 * i, 120)]), 0.1 * (1 + i)) for i, place in enumerate(places)}
    levels = [innovation * gain_of(a) for a, innovation in models.values()]
    texture = autoregressive(models)
    for (speed, force), level, (a, _) in zip(places, levels, models.values(), strict=True):
        samples = vibration(rig_of(texture, RECORDED_HZ), stroke(np.full(150_000, speed), force, RECORDED_HZ))
        assert rms(samples) == pytest.approx(level, rel=0.02)
        given = Spectrum.of([1], [1, *a], RECORDED_HZ)
        has_spectrum(samples, given._replace(density=given.density / given.power), RECORDED_HZ)
    for speed, force in ((0.001, 0.01), (0.08, 1.1), (0.2, 2.0), (0.5, 9.0)):
        samples = vibration(
            rig_of({**texture, "threshold_m_per_s": 1e-5}, RECORDED_HZ),
            stroke(np.full(50_000, speed), force, RECORDED_HZ),
        )
        assert min(levels) * 0.98 < rms(samples) < max(levels) * 1.02


# ---- 6. updates under the hand ---------------------------------------------------------------------------------


def uneven(count: int, rate_hz: float = 1e3, force_n: float = 1.0) -> Stroke:
    """Speeds that change all the time and turn round."""
    return stroke(0.12 * np.sin(np.arange(count) / 37) + 0.03, force_n, rate_hz)


def part(path: Stroke, start: int, stop: int) -> Stroke:
    return Stroke(path.position_m[start:stop], path.velocity_m_per_s[start:stop])


@pytest.mark.long
@pytest.mark.parametrize("texture", [SANDPAPER, autoregressive(MODELS)], ids=["stochastic", "autoregressive"])
def test_updates_of_others_every_tick_do_not_touch_it(texture: dict[str, object]) -> None:
    """Objects, other sandpapers and fields come, change and go; noises get other places in the table."""
    path = uneven(240)
    alone = vibration(rig_of(texture), path)
    rig = rig_of(texture)
    parts = []
    for tick in range(240):
        name = f"m{tick % 3}"
        disc = {"kind": "disc", "center_m": [0.5, 0.2 + 1e-4 * tick], "radius_m": 0.05, "material": name}
        field = {"kind": "constant", "force_n": [0, 0.001 * tick]}
        changes: dict[str, object] = {"other": disc}
        if tick % 7 == 3:
            changes["push"] = field
        elif tick % 7 == 6:
            changes["push"] = None
        rig.update(changes, {name: material({**SANDPAPER, "peak_hz": 100 + tick})})
        parts.append(vibration(rig, part(path, tick, tick + 1)))
    assert np.array_equal(np.concatenate(parts), alone)


def test_a_stiffness_that_changes_every_tick_does_not_touch_it() -> None:
    path = uneven(240)
    alone = vibration(rig_of(SANDPAPER), path)
    rig = rig_of(SANDPAPER)
    parts = []
    for tick in range(240):
        rig.update({}, {"paper": material(SANDPAPER, STIFFNESS + tick)})
        parts.append(vibration(rig, part(path, tick, tick + 1)))
    assert np.array_equal(np.concatenate(parts), alone)


def test_what_follows_the_force_is_not_touched_by_a_damping_that_changes_every_tick() -> None:
    """Which leaves the force as it is, at a constant depth."""
    texture = autoregressive(MODELS)
    path = uneven(240)
    alone = vibration(rig_of(texture), path)
    rig = rig_of(texture)
    parts = []
    for tick in range(240):
        rig.update({}, {"paper": {**material(texture), "damping_n_s_per_m": tick % 2}})
        parts.append(vibration(rig, part(path, tick, tick + 1)))
    assert np.array_equal(np.concatenate(parts), alone)


def test_a_ramp_ends_in_its_time_whatever_else_is_updated() -> None:
    path = stroke(np.full(300, 0.1), 1.0, 1e3)
    alone = vibration(rig_of(SANDPAPER), path)
    rig = rig_of(SANDPAPER)
    parts = []
    for tick in range(300):
        gain = 40 if tick < 100 else 80
        rig.update({}, {"paper": material({**SANDPAPER, "velocity_gain_per_s": gain}, STIFFNESS + tick)})
        parts.append(vibration(rig, part(path, tick, tick + 1)))
    level = 1 + np.clip((np.arange(300) - 99) / 20, 0, 1)
    np.testing.assert_allclose(np.concatenate(parts), level * alone, rtol=1e-12)


def test_another_gain_comes_in_over_the_ramp() -> None:
    path = stroke(np.full(400, 0.1), 1.0, 1e3)
    alone = vibration(rig_of(SANDPAPER, ramp_s=0.05), path)
    rig = rig_of(SANDPAPER, ramp_s=0.05)
    before = vibration(rig, part(path, 0, 100))
    rig.update({}, {"paper": material({**SANDPAPER, "velocity_gain_per_s": 100, "force_gain_m_per_s2_per_n": 5})})
    after = vibration(rig, part(path, 100, 400))
    level = 4 + (15 - 4) * np.minimum(1, np.arange(1, 301) / 50)
    assert np.array_equal(before, alone[:100])
    np.testing.assert_allclose(after, alone[100:] * level / 4, rtol=1e-12)


def test_another_spectrum_comes_in_over_the_ramp_and_keeps_the_state() -> None:
    """The white numbers go on: once the ramp and what the filters remember are over, the samples are those of a run
    that had the new filter from the beginning."""
    low = {**SANDPAPER, "peak_hz": 80, "mean_hz": 140}
    path = stroke(np.full(3000, 0.1), 1.0, 1e3)
    first, second = (vibration(rig_of(texture), path) for texture in (SANDPAPER, low))
    rig = rig_of(SANDPAPER)
    before = vibration(rig, part(path, 0, 1000))
    rig.update({}, {"paper": material(low)})
    after = vibration(rig, part(path, 1000, 3000))
    assert np.array_equal(before, first[:1000])
    # A twentieth of the way at the first tick (a ramp of 20 ticks), all of it after the twentieth.
    step = np.abs(after - first[1000:])
    assert 0 < step[0] < 0.15 * 4 and step[500:].max() > 4
    np.testing.assert_allclose(after[1500:], second[2500:], rtol=0, atol=1e-9)
    assert np.abs(after[:40] - second[1000:1040]).max() > 1e-3


def test_a_texture_that_is_taken_away_and_given_back() -> None:
    rig = rig_of(SANDPAPER)
    path = stroke(np.full(120_000, 0.1), 1.0, 1e3)
    heard = []
    for start in range(0, 120_000, 40_000):
        rig.update({}, {"paper": material(SANDPAPER)})
        heard.append(vibration(rig, part(path, start, start + 20_000)))
        assert rig.kinds() == ([EventKind.CONTACT] if start == 0 else [])
        rig.update({}, {"paper": material(None)})
        assert not np.any(vibration(rig, part(path, start + 20_000, start + 40_000)))
        assert not rig.kinds()
    differ(heard)


def differ(heard: Sequence[Array]) -> None:
    """Twenty seconds each, of the same law and none like another."""
    for one, samples in enumerate(heard):
        assert rms(samples) == pytest.approx(4, rel=0.04)
        for other in heard[:one]:
            assert abs(np.corrcoef(samples, other)[0, 1]) < 0.05


def test_each_object_and_each_contact_has_its_own_noise() -> None:
    """A floor and a ceiling of one material, each touched twice."""
    rig = Rig(
        {"w": floor(), "ceiling": floor(point_m=[0, 0.1], normal=[0, -1])},
        materials={"paper": material(SANDPAPER)},
        rate_hz=1e3,
        device={"effective_mass_kg": MASS},
    )
    path = stroke(np.full(20_000, 0.1), 1.0, 1e3)
    heard = []
    for height in (-1.0 / STIFFNESS, 0.1 + 1.0 / STIFFNESS, 0.05) * 2:
        there = np.column_stack([path.position_m[:, 0], np.full(20_000, height)])
        samples = vibration(rig, Stroke(there, path.velocity_m_per_s))
        if height == 0.05:
            assert not np.any(samples)
        else:
            heard.append(samples)
    assert len(heard) == 4
    differ(heard)


def smooth(x: Array) -> Array:
    x = np.clip(x, 0, 1)
    return np.asarray(x * x * (3 - 2 * x))


def test_patches_fade_it_in_and_out_at_their_edges() -> None:
    """Sandpaper from 10 to 40 mm, drag up to 60 mm, plain elsewhere. Towards a material without noise it is silent from
    the middle of the ramp on, and its weight is that of the smooth step, twice what lies over one half."""
    comb = {"kind": "grooves", "display": "damping", "spacing_m": 0.002, "width_m": 0.001, "damping_n_s_per_m": 1}
    patches = [
        {"from_m": 0.01, "to_m": 0.04, "material": "paper"},
        {"from_m": 0.04, "to_m": 0.06, "material": "comb"},
    ]
    materials = {"paper": material(SANDPAPER), "comb": material(comb), "plain": material(None)}
    rig = Rig(
        {"w": floor("plain", patches=patches, patch_ramp_m=PATCH_RAMP)},
        materials=materials,
        rate_hz=1e4,
        device={"effective_mass_kg": MASS},
    )
    passages = []
    for speed in (0.07, -0.07, 0.07):
        start = 0.0 if speed > 0 else 0.07
        path = stroke(np.full(10_000, speed), 1.0, 1e4)
        path = Stroke(path.position_m + np.array([start, 0]), path.velocity_m_per_s)
        s = path.position_m[:, 0]
        own = np.minimum(smooth((s - 0.01) / PATCH_RAMP + 0.5), 1 - smooth((s - 0.04) / PATCH_RAMP + 0.5))
        weight = np.maximum(0, 2 * own - 1)
        samples = vibration(rig, path)
        assert np.array_equal(samples != 0, weight > 0)
        passages.append(samples[weight > 0])
        # As it sounds there: the same without patches, from the same beginning.
        whole = rig_of(SANDPAPER, 1e4)
        noise = vibration(whole, Stroke(path.position_m[weight > 0], path.velocity_m_per_s[weight > 0]))
        if len(passages) == 1:
            np.testing.assert_allclose(passages[0], weight[weight > 0] * noise, rtol=1e-6, atol=1e-12)
        assert rms(samples[weight == 1]) == pytest.approx(2.8, rel=0.2)
    # Another passage, another stretch of noise.
    assert abs(np.corrcoef(passages[0], passages[2])[0, 1]) < 0.2


def test_from_one_sandpaper_to_the_next_it_never_pauses() -> None:
    """Coarse on the left, fine on the right: no fading between them, the levels go over in the ramp's time."""
    fine = {**SANDPAPER, "peak_hz": 350, "mean_hz": 400, "velocity_gain_per_s": 20}
    objects = {"w": floor(patches=[{"from_m": 0, "to_m": 1, "material": "fine"}], patch_ramp_m=PATCH_RAMP)}
    rig = Rig(
        objects,
        materials={"paper": material(SANDPAPER), "fine": material(fine)},
        rate_hz=2e3,
        device={"effective_mass_kg": MASS},
    )
    v, half = 0.1, 4000
    path = stroke(np.full(2 * half, v), 1.0, 2e3)
    samples = vibration(rig, Stroke(path.position_m - [v * half / 2e3, 0], path.velocity_m_per_s))
    assert np.all(samples != 0)
    alone = vibration(rig_of(SANDPAPER, 2e3), path)
    assert np.array_equal(samples[: half - 2], alone[: half - 2])
    other = vibration(rig_of(fine, 2e3), path)
    np.testing.assert_allclose(samples[half + 1500 :], other[half + 1500 :], rtol=0, atol=1e-9)


# ---- 7. limits -------------------------------------------------------------------------------------------------


def test_the_force_limit_holds_and_the_wall_yields_last() -> None:
    loud = {**SANDPAPER, "velocity_gain_per_s": 400}
    rig = rig_of(loud, max_force_n=1.5)
    path = stroke(np.full(20_000, 0.1), 1.2, 1e3)
    samples = rig.render(path.position_m, path.velocity_m_per_s)
    force = np.hypot(*samples["force_n"].T)
    assert np.all(np.isfinite(samples["force_n"])) and force.max() <= 1.5
    both = samples["contact_force_n"] + samples["vibration_force_n"]
    np.testing.assert_array_equal(samples["force_n"], both)
    assert np.all(samples["flags"] & Flag.SATURATED)
    # Beyond the ramp of the contact force, which was met inside. The noise has what the wall leaves; see
    # test_noise_at_limit.py.
    np.testing.assert_allclose(samples["force_n"][20:, 1], 1.2, rtol=1e-9)
    assert rms(samples["force_n"][40:, 0]) == pytest.approx(0.3 / 4, rel=0.05)


def test_what_is_not_a_number_stops_it_and_never_comes_out() -> None:
    for texture in (SANDPAPER, autoregressive(MODELS)):
        rig = rig_of(texture)
        path = uneven(300)
        path.position_m[150] = math.nan
        samples = rig.render(path.position_m)
        assert all(np.all(np.isfinite(samples[name])) for name in ("force_n", "vibration_force_n", "contact_force_n"))
        assert np.any(samples["force_n"][100:150]) and not np.any(samples["force_n"][150:])
        assert np.all(samples["flags"][150:] & Flag.FAULT)
        lib.hd_state_enable(rig.state, 1)
    extreme = np.array([0.0, 5e-324, 1e-300, 1e-12, 1.0, 1e6, 1e300])
    nodes = np.array([[[1e-300, 0.5]], [[1e9, -0.999999]]])
    for force in (0.0, 1e-300, 1e300):
        out = run(nodes, np.repeat(extreme[:-1], 50), force, speeds=(0.0, 1e6), threshold_m_per_s=5e-324)
        assert np.all(np.isfinite(out))


def test_without_vibration_it_is_silent_and_does_not_run() -> None:
    """Switched on, it begins where a contact's noise begins: nothing of it ran before."""
    path = stroke(np.full(3000, 0.1), 1.0, 1e3)
    reference = vibration(rig_of(SANDPAPER), part(path, 0, 1000))
    rig = rig_of(SANDPAPER, display={"force": True, "vibration": False})
    silent = rig.render(*part(path, 0, 1000))
    assert not np.any(silent["vibration_force_n"])
    np.testing.assert_allclose(silent["force_n"][20:], np.tile([0, 1.0], (980, 1)), rtol=1e-12)
    rig.update({}, display={"force": True, "vibration": True})
    shown = vibration(rig, part(path, 1000, 2000))
    # The first tick of the ramp finds nothing to show yet.
    assert shown[0] == 0
    np.testing.assert_allclose(shown[1:] / reference[:-1], np.minimum(1, np.arange(2, 1001) / 20), rtol=1e-9)
    rig.update({}, display={"force": True, "vibration": False})
    assert not np.any(vibration(rig, part(path, 2000, 3000))[20:])
