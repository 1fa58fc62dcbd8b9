"""Grooves whose frequency follows speed and force, against closed forms written from the equations."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import pytest

from hapticd.base.core import EventKind
from hapticd.base.errors import InvalidError
from hapticd.config.materials import Material, validate_materials
from hapticd.config.modes import Mode
from hapticd.config.texture import Grooves
from hapticd.rendering.compensation import NO_LOAD, Load, shapes_of
from hapticd.rendering.device_output import output_of
from hapticd.rendering.displayability import undisplayable
from tests.support.rig import Rig

Floats = npt.NDArray[np.float64]

MASS_KG = 0.001
DEVICE = {"effective_mass_kg": MASS_KG, "max_force_n": 100, "max_speed_m_per_s": 1000}
SPACING, STIFFNESS, V_GAIN, F_GAIN, DECAY_S = 0.002, 800.0, 40.0, 63.4, 0.003
START_M = 0.00071234  # no sample lies on a groove
SPEEDS, FORCES = [0.05, 0.1, 0.3], [0.2, 1.0]
GRID = [[120.0, 160.0], [180.0, 260.0], [300.0, 420.0]]
TABLE = {"speeds_m_per_s": SPEEDS, "forces_n": FORCES, "frequencies_hz": GRID}
FLOOR = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "m"}


def comb(table: Mapping[str, object] = TABLE, **texture: object) -> dict[str, object]:
    keys: dict[str, object] = {
        "kind": "grooves",
        "display": "vibration",
        "spacing_m": SPACING,
        "width_m": 0.0005,
        "velocity_gain_per_s": V_GAIN,
        "force_gain_m_per_s2_per_n": F_GAIN,
        "decay_time_s": DECAY_S,
        "frequency_table": dict(table),
    }
    return {"stiffness_n_per_m": STIFFNESS, "texture": {**keys, **texture}}


def bilinear(speed: Floats, force: Floats) -> Floats:
    """numpy's interpolation, which stays at the ends: over the force in each row, then over the speed."""
    rows = np.array([np.interp(force, FORCES, row) for row in GRID])
    return np.array([np.interp(v, SPEEDS, column) for v, column in zip(speed, rows.T, strict=True)])


def stroked(
    material: Mapping[str, object],
    speeds: Floats,
    force_n: tuple[float, float],
    way_m_per_s: float = 0.2,
    rate_hz: float = 10_000,
    device: Mapping[str, object] = DEVICE,
) -> tuple[Rig, Floats, Floats, Floats, Floats]:
    """A stroke whose force goes in a straight line from one to the other, with `speeds` as what is measured at the
    ticks: the tangential vibration (n,), and of each groove its time, speed and force."""
    rig = Rig(
        {"floor": FLOOR}, materials={"m": material}, device=device, ramp_s=max(0.001, 2 / rate_hz), rate_hz=rate_hz
    )
    count = len(speeds)
    time_s = np.arange(count) / rate_hz
    x = START_M + way_m_per_s * time_s
    depth = np.linspace(*force_n, count) / STIFFNESS
    samples = rig.render(np.stack([x, -depth], axis=1), np.stack([speeds, 0 * speeds], axis=1))
    struck_s = (np.arange(1, math.floor(x[-1] / SPACING) + 1) * SPACING - START_M) / way_m_per_s
    tick = np.ceil(struck_s * rate_hz - 1e-9).astype(int)
    force = np.interp(struck_s, time_s, np.linspace(*force_n, count))
    return rig, np.asarray(samples["vibration_force_n"][:, 0]), struck_s, speeds[tick], force


def rung(count: int, rate_hz: float, struck_s: Floats, newtons: Floats, hertz: Floats) -> Floats:
    """Each strike by itself: A exp(-t/tau) sin(2 pi f t) for five time constants, or, where another of its frequency
    comes before that, as long as that one sounds."""
    until_s = struck_s + 5 * DECAY_S
    for i in range(len(struck_s) - 2, -1, -1):
        later = np.flatnonzero((hertz[i + 1 :] == hertz[i]) & (struck_s[i + 1 :] <= until_s[i])) + i + 1
        until_s[i] = max([until_s[i], *until_s[later]])
    time_s = np.arange(count)[:, None] / rate_hz
    since = time_s - struck_s
    sounds = (since >= 0) & (time_s <= until_s)
    each = np.where(sounds, np.exp(-since / DECAY_S) * np.sin(2 * np.pi * hertz * since), 0.0)
    total: Floats = each @ newtons
    return total


@pytest.mark.parametrize("force_n", [(0.05, 1.5), (0.6, 0.6)])
@pytest.mark.parametrize("to", [0.4, -0.4])
def test_each_strike_rings_with_the_frequency_of_its_speed_and_force(force_n: tuple[float, float], to: float) -> None:
    """From rest to beyond the table, and from below it to above it in force."""
    speeds = np.linspace(0.0, to, 3000)
    _, heard, struck_s, speed, force = stroked(comb(), speeds, force_n)
    hertz = bilinear(np.abs(speed), force)
    assert {120.0} < set(hertz) or force_n[0] == force_n[1]
    wanted = rung(3000, 10_000, struck_s, MASS_KG * (V_GAIN * np.abs(speed) + F_GAIN * force), hertz)
    np.testing.assert_allclose(heard, wanted, atol=1e-12 * np.abs(wanted).max())


def test_beyond_the_table_it_is_one_mode_as_without_a_table() -> None:
    """Strikes of one frequency add to one voice, which ends after the last: as of a material without."""
    speeds = np.full(2000, 0.01)
    below = stroked(comb(), speeds, (0.1, 0.1))[1]
    plain = stroked(with_one_frequency(120.0), speeds, (0.1, 0.1))[1]
    np.testing.assert_allclose(below, plain, rtol=0, atol=1e-15)
    assert np.abs(below).max() > 0


def test_every_run_is_the_same_to_the_last_bit() -> None:
    speeds = np.linspace(0.0, 0.4, 2000)
    first, second = (stroked(comb(), speeds, (0.05, 1.5))[1] for _ in range(2))
    assert np.array_equal(first, second)


def test_one_point_one_speed_and_one_force_are_tables() -> None:
    speeds = np.linspace(0.0, 0.4, 2000)
    for table, hertz in (
        ({"speeds_m_per_s": [0.1], "forces_n": [1], "frequencies_hz": [[210]]}, lambda v, f: np.full(len(v), 210.0)),
        (
            {"speeds_m_per_s": [0.1, 0.2], "forces_n": [1], "frequencies_hz": [[210], [250]]},
            lambda v, f: np.interp(v, [0.1, 0.2], [210.0, 250.0]),
        ),
        (
            {"speeds_m_per_s": [0], "forces_n": [0, 1], "frequencies_hz": [[210, 250]]},
            lambda v, f: np.interp(f, [0.0, 1.0], [210.0, 250.0]),
        ),
    ):
        _, heard, struck_s, speed, force = stroked(comb(table), speeds, (0.2, 1.2))
        newtons = MASS_KG * (V_GAIN * speed + F_GAIN * force)
        wanted = rung(2000, 10_000, struck_s, newtons, np.asarray(hertz(speed, force)))
        np.testing.assert_allclose(heard, wanted, atol=1e-12 * np.abs(wanted).max())


def first_peak(hertz: Floats) -> Floats:
    """Largest value of exp(-t/tau) sin(w t), sampled finely."""
    time_s = np.linspace(0, DECAY_S, 20_001)
    return np.array([np.max(np.exp(-time_s / DECAY_S) * np.sin(2 * np.pi * each * time_s)) for each in hertz])


@pytest.mark.parametrize("undisplayed", ["lower", "mute"])
def test_above_what_the_rate_carries_a_strike_is_lowered_with_its_first_peak_or_silent(undisplayed: str) -> None:
    """At 600 Hz modes go up to 240 Hz."""
    device = {**DEVICE, "undisplayable": undisplayed}
    speeds = np.linspace(0.05, 0.3, 180)
    rig, heard, struck_s, speed, force = stroked(comb(), speeds, (0.6, 0.6), rate_hz=600, device=device)
    hertz = bilinear(speed, force)
    assert hertz.min() < 240 < hertz.max()
    newtons = MASS_KG * (V_GAIN * speed + F_GAIN * force)
    above = hertz > 240
    if undisplayed == "mute":
        newtons = np.where(above, 0.0, newtons)
    else:
        newtons = np.where(above, newtons * first_peak(hertz) / first_peak(np.full(len(hertz), 240.0)), newtons)
    count = len(rig.of(EventKind.GROOVE))
    assert count == len(struck_s)
    wanted = rung(180, 600, struck_s, newtons, np.minimum(hertz, 240.0))
    np.testing.assert_allclose(heard, wanted, atol=1e-6 * np.abs(wanted).max())
    shown = undisplayable({"m": rig.config.materials["m"]}, output_of(rig.config, 600))
    assert [each.frequency_hz for each in shown] == [pytest.approx(420.0)]
    assert shown[0].shown_hz is None if undisplayed == "mute" else shown[0].shown_hz == pytest.approx(240.0)


HANDLE = {
    "handle": {"mass_kg": 0.03, "damping_n_s_per_m": 0.2, "friction_n": 0.0},
    "grip": {"mass_kg": 0.02, "damping_n_s_per_m": 5.0, "stiffness_n_per_m": 200.0},
}


def compensated(material: Mapping[str, object], compensation: str, speed: float) -> Floats:
    device = {"max_force_n": 100, "max_speed_m_per_s": 1000, "compensation": compensation, **HANDLE}
    return stroked(material, np.full(600, speed), (0.6, 0.6), device=device)[1]


def with_one_frequency(hertz: float) -> dict[str, object]:
    found = comb(frequency_hz=hertz)
    del found["texture"]["frequency_table"]  # type: ignore[attr-defined]
    return found


@pytest.mark.parametrize("compensation", ["mass", "full"])
def test_a_compensated_strike_is_that_of_a_material_with_its_frequency_alone(compensation: str) -> None:
    """The same where the table holds one frequency; between the nodes of a range, nearly."""
    one = comb({"speeds_m_per_s": [0.1], "forces_n": [1], "frequencies_hz": [[210]]})
    wanted = compensated(with_one_frequency(210.0), compensation, 0.1)
    found = compensated(one, compensation, 0.1)
    assert np.abs(wanted).max() > 0.1
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-12)
    speed = 0.0513
    hertz = float(bilinear(np.array([speed]), np.array([0.6]))[0])
    wanted = compensated(with_one_frequency(hertz), compensation, speed)
    found = compensated(comb(), compensation, speed)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=0.01 * np.abs(wanted).max())


@pytest.mark.parametrize("compensation", ["mass", "full"])
def test_compensation_follows_the_frequency(compensation: str) -> None:
    """What is struck at any frequency is what is designed for that frequency alone, but for the choice of the tail and
    the straight lines between the nodes: its displayed error stays within half a percent of that."""
    device = {"max_force_n": 100, "max_speed_m_per_s": 1000, "compensation": compensation, **HANDLE}
    rig = Rig({"floor": FLOOR}, materials={"m": comb()}, device=device)
    output = output_of(rig.config, 10_000)
    assert output.dynamics is not None and output.compensation != "off"
    from hapticd.rendering.compiler.mode_tables import tabled_grooves

    tuning = tabled_grooves(rig.config.materials["m"], output)
    assert tuning is not None
    from hapticd.rendering.compensation import _Band  # the spectra, which tests of compensation hold to mpmath

    for hertz in (123.0, 166.6, 251.7, 333.3, 419.0):
        mode = Mode(1 / DECAY_S, 2 * math.pi * hertz)
        w = mode.angular_frequency_rad_per_s
        row = [np.interp(w, tuning.nodes[:, 0], tuning.nodes[:, column]) for column in range(11)]
        alone = shapes_of(mode, output.dynamics, 10_000, output.compensation, Load(800.0), False)[0]
        tails = [] if tuning.tail is None else [tuning.tail.pole]
        band = _Band(mode, output.dynamics, 10_000, NO_LOAD, tails)
        columns = band.columns([complex(-mode.decay_rate_per_s, w), *tails])
        assert band.error(columns, np.array(row[5 : 5 + len(columns)])) < alone.error + 0.005


def validated(**texture: object) -> Material:
    return validate_materials({"m": comb(**texture)})["m"]  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("changes", "where", "problem"),
    [
        ({"frequency_hz": 200}, "", "needs exactly one of frequency_table and frequency_hz, has both"),
        ({"angular_frequency_rad_per_s": 200}, "", "frequency_table and angular_frequency_rad_per_s, has both"),
        ({"decay_time_s": None}, "", "needs exactly one of decay_time_s and decay_rate_per_s, has neither"),
        ({"table": {**TABLE, "frequencies_hz": GRID[:2]}}, ".frequency_table", "a list for each speed, 3, has 2"),
        (
            {"table": {**TABLE, "frequencies_hz": [[1, 2], [1], [1, 2]]}},
            ".frequency_table",
            "frequencies_hz[1] must have a frequency for each force, 2, has 1",
        ),
        ({"table": {**TABLE, "speeds_m_per_s": [0.1, 0.1, 0.2]}}, ".frequency_table", "speeds_m_per_s[1] must be"),
        ({"table": {**TABLE, "forces_n": [1, 0.5]}}, ".frequency_table", "forces_n[1] must be at least 1e-06 above"),
        ({"table": {**TABLE, "forces_n": []}}, ".frequency_table.forces_n", "at least 1 item"),
        (
            {"table": {**TABLE, "forces_n": [-1, 1]}},
            ".frequency_table.forces_n[0]",
            "should be greater than or equal to 0",
        ),
        (
            {"table": {**TABLE, "frequencies_hz": [[1, 2], [1, 0], [1, 2]]}},
            ".frequency_table.frequencies_hz[1][1]",
            "should be greater than or equal to 0.01",
        ),
        (
            {"table": {"speeds_m_per_s": [0.01 * i for i in range(17)], "forces_n": [1], "frequencies_hz": [[1]] * 17}},
            ".frequency_table.speeds_m_per_s",
            "at most 16 entries",
        ),
    ],
)
def test_what_is_no_table_is_refused_in_a_line(changes: dict[str, object], where: str, problem: str) -> None:
    with pytest.raises(InvalidError) as caught:
        validated(**changes)
    found = {each.where: each.problem for each in caught.value.problems}
    assert problem in found[f"materials.m.texture{where}"]
    assert "\n" not in str(caught.value) or len(found) > 1


def test_a_table_stays_as_it_was_given() -> None:
    taken = validated()
    assert Material.model_validate(taken.to_dict()) == taken
    assert isinstance(taken.texture, Grooves) and taken.texture.frequency_table is not None
    pairs = [(v, f) for v in (0.0, 0.07, 0.1, 0.25, 0.3, 2.0) for f in (0.0, 0.2, 0.7, 1.0, 9.0)]
    speed, force = np.array(pairs).T
    found = [taken.texture.frequency_table.at(*pair) for pair in pairs]
    np.testing.assert_allclose(found, bilinear(speed, force), rtol=1e-14)


def test_other_frequencies_come_with_a_change_of_the_material() -> None:
    """Numbers of two materials lie in one array: a change of one moves those of the other."""
    rig = Rig(
        {"floor": FLOOR, "far": {**FLOOR, "point_m": [0, -1], "material": "n"}},
        materials={"m": comb(), "n": comb()},
        device=DEVICE,
    )
    x = START_M + 0.2 * np.arange(400) / 10_000
    path = np.stack([x, np.full(400, -0.6 / STIFFNESS)], axis=1)
    first = rig.render(path)["vibration_force_n"][:, 0]
    one = {"speeds_m_per_s": [0.1], "forces_n": [1], "frequencies_hz": [[210]]}
    rig.update({}, {"n": comb(one)})
    rig.update({"far": None})
    assert rig.table.number_count == 2 + 3 + 6
    rig.render(np.tile([0.0, 1.0], (400, 1)))
    rig.render(np.tile(path[:1], (400, 1)))
    second = rig.render(path)["vibration_force_n"][:, 0]
    assert np.abs(first).max() == pytest.approx(np.abs(second).max(), rel=0.05)
