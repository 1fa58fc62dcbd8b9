"""The measurements of the demo against known values, and its exit codes.

The daemon's tick renders taps and strokes without a clock, so that every run is the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import scipy.signal

from examples.demo import __main__ as demo
from examples.demo import parts, plot, taps
from examples.demo.comb import passages
from examples.demo.marks import Marks
from examples.demo.perform import MASS_KG, Disturbed, Recorded, joined
from examples.demo.sandpaper import SEGMENT_TICKS, peak_of
from examples.demo.strikes import strikes_of
from hapticd.base.core import SAMPLE_DTYPE, Flag
from hapticd.protocol.events import event_map
from hapticd.rendering.offline import simulate_run
from tests.support.rig import Rig

Floats = npt.NDArray[np.float64]
Kept = Callable[[str, int, npt.NDArray[np.intp]], npt.NDArray[np.bool_]]
"""Returns which samples of a performance are kept, from its material, its repetition and the samples' numbers."""
COMB = "comb_2400um_vibration"
OMEGA, DECAY, RATE = 2 * np.pi * 200.0, 1 / 3e-3, 10_000.0


def rung(time_s: Floats, onsets: Floats, amplitudes: Floats) -> Floats:
    """Return the sum of the modes of all strikes, which ends 5/B after the last strike."""
    since = time_s[:, None] - onsets
    each = np.where(since >= 0, np.exp(-DECAY * np.maximum(since, 0)) * np.sin(OMEGA * since), 0.0)
    group = np.cumsum(np.diff(onsets, prepend=-1.0) > 5 / DECAY)
    last = np.searchsorted(onsets, time_s, side="right") - 1
    silent = (last < 0) | (time_s - onsets[last] > 5 / DECAY)
    return np.where(silent, 0.0, np.where(group == group[last][:, None], each, 0.0) @ amplitudes)


def telemetry(time_s: Floats, vibration: Floats | float = 0.0, x: Floats | float = 0.0) -> Recorded:
    samples: npt.NDArray[Any] = np.zeros(len(time_s), SAMPLE_DTYPE)
    samples["vibration_force_n"][:, 0] = MASS_KG * np.asarray(vibration)
    samples["position_m"][:, 0] = x
    samples["position_m"][:, 1] = -0.001
    return Recorded(time_s, samples, (), 0, RATE)


def some_strikes() -> tuple[Floats, Floats]:
    rng = np.random.default_rng(1)
    onsets = 0.01 + np.cumsum(rng.uniform(6e-3, 0.03, 20))
    return onsets, rng.uniform(2, 20, 20) * rng.choice([-1, 1], 20)


def test_a_mode_and_its_strikes_are_found_as_they_were_made() -> None:
    onsets, amplitudes = some_strikes()
    time_s = np.arange(round(0.45 * RATE)) / RATE
    found = strikes_of(telemetry(time_s, rung(time_s, onsets, amplitudes)), 0, onsets)
    assert found.number.tolist() == list(range(20)) and found.left_over == 0
    assert found.frequency_hz == pytest.approx(OMEGA / (2 * np.pi), rel=1e-9)
    assert found.decay_time_s == pytest.approx(1 / DECAY, rel=1e-9)
    assert found.late_s < 1e-9
    np.testing.assert_allclose(found.amplitude, amplitudes, rtol=1e-6)


def test_a_strike_too_many_and_one_of_another_shape_are_left_over() -> None:
    onsets, amplitudes = some_strikes()
    time_s = np.arange(round(0.45 * RATE)) / RATE
    vibration = rung(time_s, onsets, amplitudes)
    assert strikes_of(telemetry(time_s, vibration), 0, np.delete(onsets, 8)).left_over > 0
    vibration[2001] += 0.1
    assert strikes_of(telemetry(time_s, vibration), 0, onsets).left_over > 0


def test_a_sine_that_is_exactly_zero_at_a_sample_continues() -> None:
    time_s = np.arange(400) / RATE
    vibration = rung(time_s, np.array([0.01]), np.array([8.0]))
    vibration[175] = 0.0  # one and a half periods after the strike
    found = strikes_of(telemetry(time_s, vibration), 0, [0.01])
    np.testing.assert_allclose(found.amplitude, [8.0], rtol=1e-6)
    assert found.left_over == 0


def test_a_strike_one_sample_after_the_end_of_another_is_found() -> None:
    onsets, amplitudes = np.array([0.01003, 0.02515]), np.array([8.0, -5.0])
    time_s = np.arange(450) / RATE
    vibration = rung(time_s, onsets, amplitudes)
    assert vibration[250] != 0.0 == vibration[251] and vibration[252] != 0.0
    found = strikes_of(telemetry(time_s, vibration), 0, onsets)
    np.testing.assert_allclose(found.amplitude, amplitudes, rtol=1e-6)
    assert found.left_over == 0


def test_a_strike_on_the_tick_after_the_end_of_another_is_found() -> None:
    onsets, amplitudes = np.array([0.01, 0.0251]), np.array([8.0, -5.0])
    time_s = np.arange(450) / RATE
    vibration = rung(time_s, onsets, amplitudes)
    vibration[251] = 1e-13  # the sine at its onset, after rounding
    found = strikes_of(telemetry(time_s, vibration), 0, onsets)
    np.testing.assert_allclose(found.amplitude, amplitudes, rtol=1e-6)
    assert found.left_over == 0


def test_a_strike_on_the_tick_after_missed_periods_is_hidden() -> None:
    """The strike before ended in the missed periods, so that no sample between the two is silent."""
    onsets, amplitudes = np.array([0.01003, 0.0261]), np.array([8.0, -5.0])
    time_s = np.arange(450) / RATE
    vibration = rung(time_s, onsets, amplitudes)
    vibration[261] = 1e-13
    kept = np.delete(np.arange(450), range(200, 261))
    found = strikes_of(telemetry(time_s[kept], vibration[kept]), 0, onsets)
    assert (found.number.tolist(), found.hidden, found.left_over) == ([0], 1, 0)


def test_a_strike_that_missed_periods_cut_off_before_the_next_one_is_hidden() -> None:
    """20 samples are too few for an unknown mode; the next strike begins in the missed periods."""
    for amplitude in (8.0, -3.0):
        onsets, amplitudes = np.array([0.01003, 0.015]), np.array([amplitude, 5.0])
        time_s = np.arange(600) / RATE
        kept = np.delete(np.arange(600), [*range(93, 98), *range(120, 180)])
        vibration = rung(time_s, onsets, amplitudes)
        vibration[101:120] += 1e-3 * amplitude * np.sin(np.arange(19))
        found = strikes_of(telemetry(time_s[kept], vibration[kept]), 0, onsets)
        assert (len(found.number), found.hidden, found.left_over) == (0, 2, 0)


def test_a_strike_that_rings_after_the_force_limit_scaled_it_is_hidden() -> None:
    onsets, amplitudes = np.array([0.01003, 0.018, 0.06]), np.array([8.0, 3.0, 5.0])
    time_s = np.arange(900) / RATE
    vibration = rung(time_s, onsets, amplitudes)
    vibration[140:400] *= 0.7
    recorded = telemetry(time_s, vibration)
    assert strikes_of(recorded, 0, onsets).left_over > 0
    recorded.samples["flags"][140] = Flag.SATURATED
    assert strikes_of(recorded, 0, onsets).left_over > 0  # without a missed period nothing grows beyond the limit
    kept = np.delete(np.arange(900), 20)
    found = strikes_of(Recorded(time_s[kept], recorded.samples[kept], (), 0, RATE), 0, onsets)
    assert (found.number.tolist(), found.hidden, found.left_over) == ([0, 2], 1, 0)


def test_missed_periods_hide_the_strikes_near_to_them_and_no_others() -> None:
    onsets, amplitudes = some_strikes()
    time_s = np.arange(round(0.45 * RATE)) / RATE
    kept = np.ones(len(time_s), dtype=np.bool_)
    for begin in (0.1, 0.2, 0.201, float(onsets[5]), float(onsets[9]) - 2e-4):
        kept[round(begin * RATE) : round(begin * RATE) + 7] = False
    found = strikes_of(telemetry(time_s[kept], rung(time_s, onsets, amplitudes)[kept]), 0, onsets)
    assert 14 <= len(found.number) < 20 and found.left_over == 0
    assert not {5, 9} & set(found.number.tolist()) and found.hidden == 20 - len(found.number)
    assert found.late_s < 1e-9
    np.testing.assert_allclose(found.amplitude, amplitudes[found.number], rtol=1e-6)


@pytest.mark.parametrize(
    ("trace", "expected", "directions"),
    [
        ([0.5, 1.5, 2.5], [1, 2], [1, 1]),
        ([0.5, 3.5], [1, 2, 3], [1, 1, 1]),
        ([0.9, 1.1, 0.9, 1.1], [1], [1]),  # to and fro on one groove
        ([0.9, 1.1, 1.6, 1.1, 0.9], [1, 1], [1, -1]),  # half a spacing away meanwhile
        ([0.9, 1.0, 1.1], [1], [1]),  # a position on a groove counts as beyond it
        ([1.1, 1.0, 0.9], [1], [-1]),
        ([0.2, 0.4], [], []),
    ],
)
def test_passages(trace: list[float], expected: list[int], directions: list[int]) -> None:
    groove, at_s, direction = passages(telemetry(np.arange(len(trace)) / RATE, x=np.array(trace)), 1.0)
    assert groove.tolist() == expected
    assert np.interp(at_s, np.arange(len(trace)) / RATE, trace) == pytest.approx(expected)
    assert direction.tolist() == directions


@pytest.mark.parametrize(("periods", "expected"), [(200, [1, 2, 3]), (201, [1, 3])])
def test_nothing_is_passed_in_a_stall_that_is_longer_than_the_ramp(periods: int, expected: list[int]) -> None:
    time_s = np.array([0, 1, 1 + periods, 2 + periods]) / RATE
    groove, _, _ = passages(telemetry(time_s, x=np.array([0.5, 1.5, 2.5, 3.5])), 1.0)
    assert groove.tolist() == expected


def test_a_groove_that_is_passed_before_the_force_has_come_in_again_counts() -> None:
    recorded = telemetry(np.arange(3) / RATE, x=np.array([0.5, 0.9, 1.1]))
    recorded.samples["contact_force_n"][:, 1] = [1.0, 0.0, 0.01]
    assert passages(recorded, 1.0)[0].tolist() == [1]
    recorded.samples["position_m"][:, 1] = [-0.001, 0.001, -0.001]
    assert passages(recorded, 1.0)[0].tolist() == []


def rendered(samples: npt.NDArray[np.void], events: npt.NDArray[np.void], time_s: Floats) -> Recorded:
    maps = tuple({**event_map(event, None)} for event in events)
    return Recorded(time_s, samples, maps, int(samples["time_ns"][0]), RATE)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(5))
def test_passages_are_those_of_the_daemon_where_the_hand_bounces_and_periods_are_missed(seed: int) -> None:
    rng = np.random.default_rng(seed)
    periods = np.where(rng.random(20_000) < 0.02, rng.integers(2, 150, 20_000), 1)
    tick = np.cumsum(periods)
    knots = np.arange(0, tick[-1] + 600, 600)
    x = np.interp(tick, knots, np.cumsum(rng.uniform(-0.009, 0.01, len(knots))))
    y = np.interp(tick, knots, rng.uniform(-0.004, 0.002, len(knots)))
    rig = Rig({"surface": {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": COMB}})
    samples = rig.render(np.stack([x, y], axis=1), periods=periods)
    recorded = rendered(samples, rig.events, (tick - tick[0]) / RATE)
    groove, due, direction = passages(recorded, 0.0024)
    events = recorded.reported("groove")
    assert len(groove) == len(events) > 100
    np.testing.assert_allclose(due, [recorded.onset_s(event) for event in events], atol=1e-9)
    strikes = strikes_of(recorded, 0, due)
    assert strikes.left_over == 0
    assert np.all(strikes.amplitude * direction[strikes.number] > 0)


def test_the_peak_of_two_poles_is_found() -> None:
    rng = np.random.default_rng(3)
    pole = 0.93 * np.exp(2j * np.pi * 160 / RATE)
    noise = scipy.signal.lfilter([1.0], np.poly([pole, pole.conjugate()]).real, rng.normal(size=1_000_000))
    response = scipy.signal.freqz([1.0], np.poly([pole, pole.conjugate()]).real, np.linspace(0, 1000, 100_001), fs=RATE)
    true_peak = response[0][abs(response[1]).argmax()]
    frequency, spectrum = scipy.signal.welch(noise, RATE, nperseg=SEGMENT_TICKS, detrend=False)
    assert peak_of(frequency, spectrum, RATE) == pytest.approx(true_peak, rel=0.05)


def test_marks_list_missed_targets_and_nan() -> None:
    marks = Marks()
    assert marks.off("near", 1.001, 1.0, 0.01) == "+0.10%"
    assert marks.missed == []
    marks.off("far", 1.1, 1.0, 0.01)
    marks.off("none", float("nan"), 1.0, 0.01)
    assert [line.split()[0] for line in marks.missed] == ["far", "none"]


@cache
def _complete(path: tuple[tuple[float, ...], ...], kind: str, material: str) -> Recorded:
    surface = {"kind": kind, "normal": [0, 1], "material": material}
    surface |= {"point_m": [0, 0]} if kind == "wall" else {"center_m": [0, 0], "width_m": 0.02}
    run = simulate_run({"scene": {"objects": {"surface": surface}}}, path, check_stability=False)
    return rendered(run.samples, run.events, np.arange(len(run.samples)) / RATE)


class Machine:
    """Takes the place of the daemon: renders performances, and drops the samples that `kept` excludes."""

    def __init__(self, kept: Kept, wood: str = "wood") -> None:
        """Render the material `wood` in place of wood."""
        self.kept, self.wood = kept, wood
        self.surface: Any = None
        self.performances: list[str] = []

    @contextmanager
    def running(self, _: Path) -> Iterator[Machine]:
        yield self

    def get_status(self) -> dict[str, Any]:
        counters = {"ticks": 76_688, "skipped": 4_312}
        return {"version": "0", "device": "sim", "realtime": {}, "rate_hz": RATE, "counters": counters, "faults": []}

    def set_scene(self, scene: Any, wait: bool) -> None:
        self.surface = scene["objects"]["surface"]

    def reset(self) -> None:
        pass

    def perform(self, _: Any, path: Any, advance: Callable[[float], None]) -> Recorded:
        name = self.surface["material"]
        complete = _complete(tuple(map(tuple, path)), self.surface["kind"], self.wood if name == "wood" else name)
        self.performances.append(name)
        kept = self.kept(name, self.performances.count(name), np.arange(len(complete.time_s)))
        return Recorded(complete.time_s[kept], complete.samples[kept], complete.events, complete.start_ns, RATE)


RunDemo = Callable[[Machine], tuple[int, str]]


@pytest.fixture
def run_demo(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> RunDemo:
    def run(machine: Machine) -> tuple[int, str]:
        monkeypatch.setattr(demo, "running_daemon", machine.running)
        monkeypatch.setattr(parts, "perform", machine.perform)
        monkeypatch.setattr(parts, "MAX_REPETITIONS", 2)
        monkeypatch.setattr(plot, "PLOT", tmp_path / "demo.png")
        code = demo.main()
        for name in ("demo.png", "demo.svg"):
            assert (tmp_path / name).stat().st_size > 0
        return code, capsys.readouterr().out

    return run


def all_kept(_: str, __: int, number: npt.NDArray[np.intp]) -> npt.NDArray[np.bool_]:
    return number >= 0


def none_complete(_: str, __: int, number: npt.NDArray[np.intp]) -> npt.NDArray[np.bool_]:
    """Keep so few samples that no strike can be fitted, and no half second of a stroke is complete."""
    return number % 160 < 8


def few_missed(name: str, _: int, number: npt.NDArray[np.intp]) -> npt.NDArray[np.bool_]:
    """Drop samples so often that no strike can be fitted, but none of sandpaper, whose noise is a sequence of ticks."""
    return (number % 14 != 0) | (name == "sandpaper_100")


@pytest.mark.long
def test_the_demo_of_a_complete_recording_ends_with_0(run_demo: RunDemo) -> None:
    machine = Machine(all_kept)
    code, output = run_demo(machine)
    assert code == 0 and "not enough seen" not in output and "wrong" not in output
    assert len(machine.performances) == len(set(machine.performances)) == 10


@pytest.mark.long
def test_a_demo_without_measurements_reports_it_in_one_line_and_ends_with_0(run_demo: RunDemo) -> None:
    code, output = run_demo(Machine(none_complete))
    (line,) = [line for line in output.splitlines() if line.startswith("not enough seen")]
    assert code == 0 and "wrong" not in output
    for part in (
        "wood: 0 of 10 taps",
        f"{COMB}: 0 of 100 strikes",
        "sandpaper_100: 0 of 4 strokes",
        "cellophane: 0 of 1",
    ):
        assert part in line
    assert "the machine missed 4,312 of 81,000 periods" in line and "hapticd doctor" in line


@pytest.mark.long
def test_taps_of_several_repetitions_count_together(run_demo: RunDemo) -> None:
    def seen_by_turns(name: str, time: int, number: npt.NDArray[np.intp]) -> npt.NDArray[np.bool_]:
        """Keep one half of the taps in the first repetition, the other half in the second."""
        return np.asarray(((number < len(number) // 2) == (time == 1)) | few_missed(name, time, number))

    machine = Machine(seen_by_turns)
    code, output = run_demo(machine)
    assert code == 0 and "wood: " in output and "of 10 taps so far; once more" in output
    assert "wood" not in next((line for line in output.splitlines() if line.startswith("not enough seen")), "")
    assert machine.performances.count("wood") == 2


@pytest.mark.long
def test_a_wrong_figure_ends_with_1_even_if_other_parts_are_not_measured(
    run_demo: RunDemo,
) -> None:
    def all_of_wood(name: str, time: int, number: npt.NDArray[np.intp]) -> npt.NDArray[np.bool_]:
        return (all_kept if name == "wood" else none_complete)(name, time, number)

    code, output = run_demo(Machine(all_of_wood, wood="delrin"))
    assert code == 1 and "wrong: wood: frequency is off by +38.81 % (limit 1 %)" in output
    assert "not enough seen: " in output


@pytest.mark.long
def test_too_little_without_a_missed_period_ends_with_1(run_demo: RunDemo, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(taps, "MIN_TAPS", 27)  # there are twice 13 taps
    code, output = run_demo(Machine(all_kept))
    assert code == 1 and "wrong: wood: 26 of 27 taps, and no period was missed" in output


@pytest.mark.slow
def test_a_landing_without_a_tap_is_wrong_however_many_periods_are_missed(run_demo: RunDemo) -> None:
    code, output = run_demo(Machine(few_missed))
    assert code == 0 and "not enough seen: wood: 0 of 10 taps" in output
    code, output = run_demo(Machine(few_missed, wood="sandpaper_100"))  # this material has no tap
    assert code == 1 and "wrong: wood: the hand landed 2" in output and "times without a tap" in output


@pytest.mark.long
def test_a_disturbed_performance_is_repeated_and_then_given_up(run_demo: RunDemo) -> None:
    def lost(*_: Any) -> npt.NDArray[np.bool_]:
        raise Disturbed("7 samples were lost on their way")

    code, output = run_demo(Machine(lost))
    assert code == 0 and "wood: 7 samples were lost on their way; once more" in output
    assert "not enough seen: wood: 0 of 10 taps" in output


def test_measurements_of_several_performances_are_put_together() -> None:
    onsets, amplitudes = some_strikes()
    time_s = np.arange(round(0.45 * RATE)) / RATE
    one = strikes_of(telemetry(time_s, rung(time_s, onsets, amplitudes)), 0, onsets)
    both = joined([one, one])
    assert len(both.number) == 40 and both.left_over == 0 and both.late_s == one.late_s


def test_the_plot_is_where_git_ignores_it() -> None:
    root = Path(__file__).parents[2]
    assert root / "demo.png" == plot.PLOT
    assert {"/demo.png", "/demo.svg"} <= set((root / ".gitignore").read_text().splitlines())
