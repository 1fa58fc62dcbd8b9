"""A tap whose amplitude is a table over the approach speed, and where the figures of a material come from."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hapticd.base.core import EventKind, lib
from hapticd.base.errors import InvalidError
from hapticd.config.configuration import default_config, load_config
from hapticd.config.materials import MAX_TAP_POINTS, validate_materials
from hapticd.config.modes import Mode
from hapticd.rendering.compiler.material_record import material_record
from hapticd.rendering.device_output import output_of
from hapticd.rendering.displayability import undisplayable, warnings
from tests.support.rig import FLOOR, Rig

RATE = 10_000
FREQUENCY_HZ = 210.0
DECAY_S = 0.008
POINTS = [[0.1, 40.0], [0.2, 50.0], [0.4, 120.0]]
FALLING = [[0.1, 40.0], [0.2, 10.0]]


def material(points: list[list[float]], **tap: object) -> dict[str, Any]:
    mode = {"frequency_hz": FREQUENCY_HZ, "decay_time_s": DECAY_S}
    return {"stiffness_n_per_m": 100.0, "tap": {**mode, "amplitudes": points, **tap}}


def by_hand(points: list[list[float]], speed: float) -> float:
    """numpy's interpolation from the origin on, and beyond the end the last line."""
    ends = np.array([[0.0, 0.0], *points])
    (v0, a0), (v1, a1) = ends[-2:]
    beyond = a1 + (a1 - a0) / (v1 - v0) * (speed - v1)
    return max(0.0, float(np.interp(speed, *ends.T) if speed <= v1 else beyond))


def struck(made: dict[str, Any], speed: float) -> tuple[float, float, np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """One approach: the event's amplitude and speed, vibration over mass, and times since the onset."""
    rig = Rig({"w": {**FLOOR, "material": "m"}}, materials={"m": made}, device={"max_force_n": 100})
    time_s = np.arange(600) / RATE
    path = np.zeros((600, 2))
    path[:, 1] = 0.00123 - speed * time_s
    samples = rig.render(path, velocity=np.tile((0.0, -speed), (600, 1)))
    (contact,) = rig.of(EventKind.CONTACT)
    mass = rig.config.device.effective_mass_kg
    return (
        float(contact["amplitude_m_per_s2"]),
        float(contact["speed_m_per_s"]),
        samples["vibration_force_n"][:, 1] / mass,
        time_s - 0.00123 / speed,
    )


@pytest.mark.parametrize("points", [POINTS, FALLING, [[0.25, 10.0]]])
@pytest.mark.parametrize("speed", [0.03, 0.1, 0.137, 0.2, 0.29, 0.4, 0.9])
def test_a_tap_is_as_strong_as_its_table_says(points: list[list[float]], speed: float) -> None:
    amplitude, told_speed, vibration, since = struck(material(points), speed)
    wanted = by_hand(points, speed)
    assert told_speed == pytest.approx(speed)
    assert amplitude == pytest.approx(wanted, rel=1e-12, abs=1e-12)
    heard = (since >= 0) & (since <= 5 * DECAY_S)
    form = np.where(heard, np.exp(-since / DECAY_S) * np.sin(2 * np.pi * FREQUENCY_HZ * since), 0.0)
    judged = np.abs(since - 5 * DECAY_S) > 1e-9
    assert np.allclose(vibration[judged], (wanted * form)[judged], rtol=0, atol=1e-9 * max(wanted, 1.0))


def test_first_peaks_are_as_large_as_the_table_says() -> None:
    made = material(POINTS, attack="first_peak")
    _, _, vibration, _ = struck(made, 0.3)
    # The samples pass the peak within half a period, where the sine is flat: cos(pi 210 / 10000) > 0.997.
    assert 0.99 * by_hand(POINTS, 0.3) < vibration.max() <= by_hand(POINTS, 0.3) * (1 + 1e-9)


def test_a_slope_and_its_table_are_the_same() -> None:
    slope = material([])
    slope["tap"] = {**slope["tap"], "attack_slope_per_s": 300.0}
    del slope["tap"]["amplitudes"]
    table = material([[0.1, 30.0], [0.3, 90.0]])
    for speed in (0.05, 0.17, 0.6):
        one, other = struck(slope, speed), struck(table, speed)
        assert one[0] == pytest.approx(other[0], rel=1e-12)
        assert np.allclose(one[2], other[2], rtol=0, atol=1e-11)


@pytest.mark.parametrize("points", [POINTS, FALLING, [[0.25, 10.0]]])
def test_what_python_says_of_an_amplitude_is_what_is_struck(points: list[list[float]]) -> None:
    tap = validate_materials({"m": material(points)})["m"].tap
    assert tap is not None
    for speed in np.linspace(0, 1.3, 27):
        assert tap.amplitude_m_per_s2(float(speed)) == pytest.approx(by_hand(points, float(speed)), abs=1e-12)


def test_tables_of_several_materials_do_not_mix_and_change_while_touched() -> None:
    ours = {name: material([[0.1, 10.0 * place], [0.2, 30.0 * place]]) for place, name in enumerate("abc", 1)}
    walls = {name: {**FLOOR, "point_m": [0.0, -0.001 * i], "material": name} for i, name in enumerate("abc")}
    rig = Rig(walls, materials=ours)

    def amplitudes(speed: float) -> dict[int, float]:
        path = np.zeros((800, 2))
        path[:, 1] = 0.0005 - speed * np.arange(800) / RATE
        path = np.concatenate((path, np.tile((0.0, 0.01), (3000, 1))))
        velocity = np.where(np.arange(len(path))[:, None] < 800, (0.0, -speed), (0.0, 0.0))
        rig.render(path, velocity=velocity)
        found = rig.of(EventKind.CONTACT)
        return {int(each["slot"]): float(each["amplitude_m_per_s2"]) for each in found}

    def slots(names: str) -> list[int]:
        places = [rig.compiler.slot_of(name) for name in names]
        return [place[0] for place in places if place is not None]

    first, second, third = slots("abc")
    assert amplitudes(0.15) == pytest.approx({first: 20.0, second: 40.0, third: 60.0})
    rig.update({}, materials={"b": {"stiffness_n_per_m": 100.0}, "c": material([[0.15, 7.0]])})
    assert amplitudes(0.15) == pytest.approx({first: 20.0, second: 0.0, third: 7.0})
    rig.update({"a": None}, materials={"b": material([[0.15, 3.0], [0.2, 1.0]])})
    assert amplitudes(0.15) == pytest.approx({second: 3.0, third: 7.0})


def test_a_table_stays_when_the_numbers_of_a_noise_grow_beside_it() -> None:
    """Both are in one array, which is laid out anew."""

    def noise(coefficients: list[float]) -> dict[str, Any]:
        models = [{"speed_m_per_s": 0.1, "force_n": 1.0, "coefficients": coefficients, "rms_m_per_s2": 1.0}]
        return {"stiffness_n_per_m": 100.0, "texture": {"kind": "autoregressive", "rate_hz": RATE, "models": models}}

    made = {"a": material([[0.1, 10.0], [0.2, 30.0]]), "n": noise([0.5])}
    walls = {"n": {**FLOOR, "point_m": [0, -1], "material": "n"}, "a": {**FLOOR, "material": "a"}}
    rig = Rig(walls, materials=made)

    def amplitude() -> float:
        path = np.zeros((40, 2))
        path[:, 1] = 0.0001 - 0.15 * np.arange(40) / RATE
        away = np.tile((0.0, 0.01), (2000, 1))
        whole = np.concatenate((path, away))
        rig.render(whole, velocity=np.where(np.arange(2040)[:, None] < 40, (0.0, -0.15), (0.0, 0.0)))
        (contact,) = rig.of(EventKind.CONTACT)
        return float(contact["amplitude_m_per_s2"])

    assert amplitude() == pytest.approx(20.0)
    rig.update({}, materials={"n": noise([0.1, 0.2, 0.05, 0.01])})
    assert amplitude() == pytest.approx(20.0)
    rig.update({"n": None})
    assert amplitude() == pytest.approx(20.0)


@pytest.mark.parametrize(
    ("tap", "told"),
    [
        ({"amplitudes": None}, "needs exactly one of attack_slope_per_s and amplitudes, has neither"),
        ({"attack_slope_per_s": 3}, "needs exactly one of attack_slope_per_s and amplitudes, has both"),
        ({"amplitudes": []}, "List should have at least 1 item"),
        ({"amplitudes": [[0.1, 2], [0.1, 3]]}, "amplitudes[1] must be at a speed at least 1e-06 m/s above"),
        ({"amplitudes": [[0.2, 2], [0.1, 3]]}, "amplitudes[1] must be at a speed"),
        ({"amplitudes": [[0.0, 2]]}, "m.tap.amplitudes[0][0]: should be greater than or equal to 0.0001"),
        ({"amplitudes": [[0.1, -2]]}, "m.tap.amplitudes[0][1]: should be greater than or equal to 0"),
        ({"amplitudes": [[0.1]]}, "m.tap.amplitudes[0][1]: Field required"),
        ({"amplitudes": [0.1, 2]}, "m.tap.amplitudes[0]: should be a list, is 0.1"),
        ({"amplitudes": 5}, "m.tap.amplitudes: should be a list, is 5"),
        (
            {"amplitudes": [[0.001 * (i + 1), 1] for i in range(257)]},
            "must hold at most 256 entries, holds 257",
        ),
    ],
)
def test_tables_that_are_none_are_refused(tap: dict[str, object], told: str) -> None:
    given = material(POINTS)
    given["tap"] = {**given["tap"], **tap}
    with pytest.raises(InvalidError) as caught:
        validate_materials({"m": given}, ("materials",))
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_largest_table_is_taken() -> None:
    assert MAX_TAP_POINTS == lib.HD_TAP_POINTS
    points = [[0.01 * (i + 1), float(i % 7)] for i in range(MAX_TAP_POINTS)]
    amplitude, _, _, _ = struck(material(points), 0.777)
    assert amplitude == pytest.approx(by_hand(points, 0.777), rel=1e-9)


# ---- Two modes -------------------------------------------------------------------------------------------------------

SECOND = {"frequency_hz": 530.0, "decay_time_s": 0.003}


@pytest.mark.parametrize("ratio", [0.4, -1.7])
@pytest.mark.parametrize("decay_s", [0.003, 0.011])
@pytest.mark.parametrize("attack", ["coefficient", "first_peak"])
def test_two_modes_ring_as_their_closed_form(ratio: float, decay_s: float, attack: str) -> None:
    made = material(POINTS, second={**SECOND, "decay_time_s": decay_s, "ratio": ratio}, attack=attack)
    amplitude, speed, vibration, since = struck(made, 0.31)
    assert amplitude == pytest.approx(by_hand(POINTS, speed))
    w = 2 * np.pi * FREQUENCY_HZ
    peak_s = np.arctan(w * DECAY_S) / w
    if attack == "first_peak":
        amplitude /= np.exp(-peak_s / DECAY_S) * np.sin(w * peak_s)
    wanted = np.zeros(len(since))
    judged = np.ones(len(since), dtype=bool)
    for part, hertz, decay in ((1.0, FREQUENCY_HZ, DECAY_S), (ratio, SECOND["frequency_hz"], decay_s)):
        form = amplitude * part * np.exp(-since / decay) * np.sin(2 * np.pi * hertz * since)
        wanted += np.where((since >= 0) & (since <= 5 * decay), form, 0.0)
        judged &= np.abs(since - 5 * decay) > 1e-9
    assert np.allclose(vibration[judged], wanted[judged], rtol=0, atol=1e-9 * amplitude)


def test_two_modes_struck_again_add_up_each_with_its_own() -> None:
    made = material([[0.1, 10.0]], second={**SECOND, "ratio": 0.5})
    plain = material([[0.1, 10.0]])
    alone = {**plain, "tap": {**plain["tap"], **SECOND, "amplitudes": [[0.1, 5.0]]}}

    def twice(of: dict[str, Any]) -> np.ndarray[Any, Any]:
        rig = Rig({"w": {**FLOOR, "material": "m"}}, materials={"m": of})
        time_s = np.arange(400) / RATE
        path = np.zeros((400, 2))
        path[:, 1] = 0.0004 * np.cos(2 * np.pi * 150 * time_s)
        samples = rig.render(path, velocity=np.gradient(path, 1 / RATE, axis=0))
        assert len(rig.of(EventKind.CONTACT)) == 6
        return np.asarray(samples["vibration_force_n"][:, 1])

    assert np.allclose(twice(made), twice(plain) + twice(alone), rtol=0, atol=1e-12)


def test_two_modes_are_held_back_together() -> None:
    made = material([[0.1, 2000.0]], second={**SECOND, "ratio": 0.8})
    rig = Rig({"w": {**FLOOR, "material": "m"}}, materials={"m": made}, device={"max_force_n": 3})
    path = np.zeros((300, 2))
    path[:, 1] = 0.00001 - 0.1 * np.arange(300) / RATE
    samples = rig.render(path, velocity=np.tile((0.0, -0.1), (300, 1)))
    (contact,) = rig.of(EventKind.CONTACT)
    assert 0 < contact["scale"] < 1
    assert np.hypot(*samples["force_n"].T).max() <= 3.0
    since = np.arange(300) / RATE - 0.0001
    both = np.zeros(300)
    for part, hertz, decay in ((1.0, FREQUENCY_HZ, DECAY_S), (0.8, SECOND["frequency_hz"], SECOND["decay_time_s"])):
        form = np.exp(-since / decay) * np.sin(2 * np.pi * hertz * since)
        both += part * np.where((since >= 0) & (since <= 5 * decay), form, 0.0)
    coefficient = 2000.0 * rig.config.device.effective_mass_kg * contact["scale"]
    judged = np.abs(since - 5 * SECOND["decay_time_s"]) > 1e-9
    assert np.allclose(samples["vibration_force_n"][judged, 1], coefficient * both[judged], rtol=0, atol=1e-9)


def test_a_second_mode_that_is_compensated_turns_round_with_its_sign() -> None:
    device = {"kind": "sim", "compensation": "full"}

    def heard(ratio: float) -> np.ndarray[Any, Any]:
        made = {**material([[0.1, 10.0]], second={**SECOND, "ratio": ratio}), "stiffness_n_per_m": 0.0}
        rig = Rig({"w": {**FLOOR, "material": "m"}}, materials={"m": made}, device=device)
        path = np.zeros((300, 2))
        path[:, 1] = 0.00123 - 0.1 * np.arange(300) / RATE
        return np.asarray(rig.render(path, velocity=np.tile((0.0, -0.1), (300, 1)))["vibration_force_n"][:, 1])

    none = heard(0.0)
    assert np.abs(heard(0.6) - none).max() > 0.01
    assert np.allclose(heard(0.6) + heard(-0.6), 2 * none, rtol=0, atol=1e-12)


def test_a_second_mode_that_the_rate_cannot_carry_is_told() -> None:
    made = validate_materials({"m": material(POINTS, second={**SECOND, "frequency_hz": 4500.0, "ratio": 1})})
    (told,) = undisplayable(made, output_of(default_config(), RATE))
    assert (told.mode, told.frequency_hz) == ("second", 4500.0)


def test_two_modes_of_which_one_is_silent_leave_room_for_the_wall() -> None:
    """The contact force grows to the later of the peaks that are heard, whichever mode has it."""
    slow = {"frequency_hz": 60.0, "decay_time_s": 0.01}
    device = {"max_force_n": 3, "undisplayable": "mute"}

    def scale(tap: dict[str, Any]) -> float:
        made = {"stiffness_n_per_m": 3000.0, "tap": {"amplitudes": [[0.1, 100.0]], **tap}}
        rig = Rig({"w": {**FLOOR, "material": "m"}}, materials={"m": made}, device=device)
        path = np.zeros((20, 2))
        path[:, 1] = 0.0000095 - 0.1 * np.arange(20) / RATE  # before the first peak of either
        rig.render(path, velocity=np.tile((0.0, -0.1), (20, 1)))
        (contact,) = rig.of(EventKind.CONTACT)
        return float(contact["scale"])

    alone = scale(slow)
    assert 0 < alone < 1
    silent = {"frequency_hz": 4500.0, "decay_time_s": 0.01}
    assert scale({**silent, "second": {**slow, "ratio": 1}}) == pytest.approx(alone, rel=1e-12)
    assert scale({**slow, "second": {**silent, "ratio": 1}}) == pytest.approx(alone, rel=1e-12)


def test_a_table_that_has_fallen_to_nothing_strikes_nothing() -> None:
    amplitude, _, vibration, _ = struck(material(FALLING), 0.9)
    assert amplitude == 0.0
    assert not vibration.any()


def test_what_is_struck_again_with_nothing_rings_on_as_long_as_before() -> None:
    """A strike of no amplitude does not start the five decay times anew."""
    made = material([[0.1, 40.0], [0.2, 0.0]], decay_time_s=0.02)
    rig = Rig({"w": {**FLOOR, "material": "m"}}, materials={"m": made})
    ticks = 1300
    speed = np.where(np.arange(ticks) < 300, 0.1, 0.9)
    path = np.zeros((ticks, 2))
    path[:, 1] = np.where(np.arange(ticks) == 300, 0.0005, np.minimum(0.00005 - 1e-5 * np.arange(ticks), -1e-5))
    path[:5, 1] = 0.00005
    samples = rig.render(path, velocity=np.stack((np.zeros(ticks), -speed), 1))
    contacts = rig.of(EventKind.CONTACT)
    assert contacts["amplitude_m_per_s2"].tolist() == [pytest.approx(40.0), 0.0]
    last = int(np.flatnonzero(samples["vibration_force_n"][:, 1])[-1])
    assert last == pytest.approx(5 + 5 * 0.02 * RATE, abs=2)


@pytest.mark.parametrize("undisplayable_as", ["mute", "lower"])
def test_a_second_mode_above_the_rate_is_muted_or_lowered(undisplayable_as: str) -> None:
    second = {"frequency_hz": 4500.0, "decay_time_s": 0.004, "ratio": 0.5}

    def heard(tap: dict[str, object]) -> np.ndarray[Any, Any]:
        rig = Rig(
            {"w": {**FLOOR, "material": "m"}},
            materials={"m": material([[0.1, 10.0]], **tap)},
            device={"undisplayable": undisplayable_as},
        )
        path = np.zeros((400, 2))
        path[:, 1] = 0.00123 - 0.1 * np.arange(400) / RATE
        return np.asarray(rig.render(path, velocity=np.tile((0.0, -0.1), (400, 1)))["vibration_force_n"][:, 1])

    both, alone = heard({"second": second}), heard({})
    if undisplayable_as == "mute":
        assert np.array_equal(both, alone)
        return
    # Lowered to 0.4 of the rate, its first peak as large as it would be.
    since = np.arange(400) / RATE - 0.0123
    lowered = Mode(250.0, 2 * np.pi * 4000.0)
    coefficient = 0.5 * 10.0 * Mode(250.0, 2 * np.pi * 4500.0).peak / lowered.peak
    form = np.exp(-since * 250.0) * np.sin(lowered.angular_frequency_rad_per_s * since)
    wanted = 0.05 * coefficient * np.where((since >= 0) & (since <= 0.02), form, 0.0)
    assert np.allclose((both - alone)[np.abs(since - 0.02) > 1e-9], wanted[np.abs(since - 0.02) > 1e-9], atol=1e-12)


@pytest.mark.parametrize("compensation", ["mass", "full"])
def test_what_a_handle_does_with_two_modes_is_the_sum_of_both(compensation: str) -> None:
    """Without a surface, which a tap may leave, compensation is linear: both modes are struck as each of them alone."""
    device = {"kind": "sim", "compensation": compensation}
    one = {"frequency_hz": FREQUENCY_HZ, "decay_time_s": DECAY_S}

    def heard(tap: dict[str, object]) -> np.ndarray[Any, Any]:
        made = {"stiffness_n_per_m": 0.0, "tap": tap}
        rig = Rig({"w": {**FLOOR, "material": "m"}}, materials={"m": made}, device=device)
        path = np.zeros((400, 2))
        path[:, 1] = 0.00123 - 0.1 * np.arange(400) / RATE
        return np.asarray(rig.render(path, velocity=np.tile((0.0, -0.1), (400, 1)))["vibration_force_n"][:, 1])

    both = heard({**one, "amplitudes": [[0.1, 10.0]], "second": {**SECOND, "ratio": 0.7}})
    parts = heard({**one, "attack_slope_per_s": 100.0}) + heard({**SECOND, "attack_slope_per_s": 70.0})
    assert np.abs(both).max() > 0.1
    assert np.allclose(both, parts, rtol=0, atol=1e-12)


def test_a_second_mode_that_needs_too_much_force_is_told_by_its_path() -> None:
    config = load_config(
        {
            "device": {
                "compensation": "full",
                "grip": {"mass_kg": 0.02, "stiffness_n_per_m": 3000, "damping_n_s_per_m": 10},
            },
            "materials": {"m": material(POINTS, second={"frequency_hz": 10.0, "decay_time_s": 0.1, "ratio": 1})},
            "scene": {"objects": {"w": {**FLOOR, "material": "m"}}},
        }
    )
    told = warnings(config.scene.objects, config.materials, output_of(config, RATE))
    assert [problem.where for problem in told if "times the force" in problem.problem] == ["materials.m.tap.second"]


def test_a_device_plays_the_first_mode_and_the_second_is_streamed() -> None:
    made = validate_materials({"m": material(POINTS, second={**SECOND, "ratio": -0.5})})["m"]
    assert made.tap is not None
    record, _ = material_record(made, 0, output_of(default_config(), RATE), {made.tap.mode: (7, 0.6, 0.05)})
    mass = default_config().device.effective_mass_kg
    assert (record.tap.effect, record.tap.effect_force_per_unit) == (7, pytest.approx(mass))
    assert record.second.effect == 0
    assert record.second.force_per_unit == pytest.approx(0.5 * mass)
    assert record.second.gain_re == -1.0


# ---- Provenance ------------------------------------------------------------------------------------------------------

ORIGIN = {
    "files": [{"path": "a tap.csv", "sha256": "0123456789abcdef" * 4}],
    "date": "2026-01-31",
    "version": "0.3.0",
    "intervals": {"tap.frequency_hz": [209.5, 210.5], "wall": [-1.0, 2]},
}


def test_where_a_material_comes_from_is_kept_and_not_rendered() -> None:
    plain = material(POINTS)
    known = {**plain, "provenance": ORIGIN}
    made = validate_materials({"m": known})["m"]
    assert made.to_dict()["provenance"] == ORIGIN
    assert validate_materials({"m": made.to_dict()})["m"] == made
    for one, other in zip(struck(plain, 0.2), struck(known, 0.2), strict=True):
        assert np.array_equal(one, other)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"files": []}, "files: List should have at least 1 item"),
        ({"files": [{"path": "a", "sha256": "abc"}]}, "m.provenance.files[0].sha256: "),
        ({"date": "31.1.2026"}, "m.provenance.date: "),
        ({"intervals": {"x": [1]}}, "m.provenance.intervals.x[1]: Field required"),
        ({"intervals": {"x": ["a", 2]}}, "m.provenance.intervals.x[0]: should be a valid number"),
        ({"intervals": {"x": [2.0, 1.0]}}, "m.provenance.intervals.x: must be [low, high], low <= high, is [2.0, 1.0]"),
        ({"date": "2026-02-30"}, 'm.provenance.date: must be a date such as 2026-11-29, is "2026-02-30"'),
        ({"author": "me"}, "m.provenance.author: unknown key"),
    ],
)
def test_provenance_that_is_none_is_refused(change: dict[str, object], told: str) -> None:
    with pytest.raises(InvalidError) as caught:
        validate_materials({"m": {**material(POINTS), "provenance": {**ORIGIN, **change}}}, ("materials",))
    assert told in str(caught.value)
