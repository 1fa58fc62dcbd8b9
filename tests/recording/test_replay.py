"""Recordings rendered again: a recording made by an offline run is reproduced to the bit."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

import hapticd
from hapticd import shipped
from hapticd.base.core import SAMPLE_DTYPE, Flag
from hapticd.base.errors import HapticdError
from hapticd.cli import main
from hapticd.config.configuration import default_config, load_config
from hapticd.config.modes import Mode
from hapticd.config.scene import validate_scene
from hapticd.recording.recording import load
from hapticd.recording.replay import FORCE_FIELDS, _change_scene, _Revision, replay
from hapticd.recording.simulated import simulate_files
from hapticd.recording.writer import RecordingWriter
from hapticd.rendering.device_output import output_of
from hapticd.rendering.offline import Rerun, render_run, simulate_run
from tests.support.rig import Rig

CONFIG = Path(shipped.__path__[0])
SCENES = sorted(CONFIG.glob("scenes/*.yaml"))
FLOOR = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"}
RATE_HZ = 10_000
PUSH_N = 0.5
PUSH = {"kind": "constant", "force_n": [0.0, PUSH_N]}


def write(
    target: Path,
    samples: np.ndarray,
    config: Mapping[str, Any],
    *changes: Mapping[str, Any],
    texts: Mapping[str, Any] | None = None,
) -> None:
    """A recording as `hapticd record` writes it, of given samples."""
    whole = load_config(config)
    with RecordingWriter(target, overwrite=True) as writer:
        writer.begin(
            {
                "config": {"servo": whole.servo.to_dict(), "device": whole.device.to_dict()},
                "scene": whole.scene.to_dict(),
                "materials": {name: material.to_dict() for name, material in whole.materials.items()},
                **(texts or {}),
            }
        )
        for change in ({"revision": 1}, *changes):
            writer.write_change(change)
        writer.write(samples)
        writer.finish()


def rewrite(path: Path, name: str, value: object) -> None:
    """Has one of its texts say something else; None: it is not there."""
    with np.load(path) as file:
        members = {**file, name: np.array(json.dumps(value))}
    if value is None:
        del members[name]
    np.savez(path, **members)


def strokes(seconds: float, seed: int = 1) -> np.ndarray:
    """A smooth path into and out of an object at y = 0."""
    time = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    phase = np.random.default_rng(seed).uniform(0, 6, 4)
    x = 0.02 * np.sin(7 * time + phase[0]) + 0.01 * np.sin(19 * time + phase[1])
    y = 0.003 + 0.005 * np.cos(50 * time) + 0.001 * np.sin(41 * time + phase[3])
    return np.column_stack([x, y])


@pytest.mark.long
@pytest.mark.parametrize("scene", SCENES, ids=lambda path: path.stem)
def test_every_shipped_scene_comes_out_bit_for_bit(tmp_path: Path, scene: Path) -> None:
    operator = re.search(r"\bOperator: (\w+\.yaml)\n", scene.read_text())
    assert operator is not None
    simulate_files([str(scene)], str(CONFIG / "operators" / operator[1]), str(tmp_path / "run.npz"), 3.0, None)
    again = replay(tmp_path / "run.npz")
    assert len(again.samples) == again.ticks == again.identical == 3 * RATE_HZ
    assert (again.first_different, again.missing_revisions, again.settled) == (None, (), True)
    for name in SAMPLE_DTYPE.names or ():
        assert again.samples[name].tobytes() == again.recorded[name].tobytes(), name
    with np.load(tmp_path / "run.npz") as file:
        recorded = [(str(event["event"]), int(event["tick"])) for event in file["events"]]
    # The operator does not affect the tick.
    recorded = [event for event in recorded if event[0] != "gesture_end"]
    assert [(event["event"], event["tick"]) for event in again.events] == recorded


@pytest.mark.parametrize("reports", [{"report_interval_s": 0.00025}, {"link": {"rate_hz": 1000}}])
def test_reports_that_are_rarer_than_ticks(tmp_path: Path, reports: dict[str, Any]) -> None:
    config = {"device": {"sim": reports}, "scene": {"objects": {"floor": FLOOR}}}
    run = simulate_run(config, [[0, 0, 0.01], [0.2, 0.01, -0.004], [0.4, 0.0, 0.01]])
    assert (run.samples["flags"] & Flag.REPEATED).any() and (run.samples["flags"] & Flag.CONTACT).any()
    write(tmp_path / "run.npz", run.samples, config)
    again = replay(tmp_path / "run.npz")
    assert again.identical == again.ticks
    assert again.samples["flags"].tobytes() == run.samples["flags"].tobytes()


def test_missed_periods_are_those_of_the_recording(tmp_path: Path) -> None:
    positions = strokes(0.5)
    periods = np.where(np.arange(len(positions)) % 700 == 699, 30, 1)
    rig = Rig({"floor": FLOOR}, rate_hz=RATE_HZ)
    samples = rig.render(positions, periods=periods)
    assert (samples["flags"] & Flag.SKIPPED).any() and (samples["flags"] & Flag.RINGING).any()
    write(tmp_path / "run.npz", samples, rig.source)
    assert replay(tmp_path / "run.npz").identical == len(positions)


def test_jumps_of_the_position_are_those_of_the_recording(tmp_path: Path) -> None:
    positions = strokes(0.5)
    positions[2000:] += [0.01, 0.0]
    positions[3000:] += [0.0, 0.002]
    config = {"scene": {"objects": {"floor": FLOOR}}}
    run = render_run(config, positions, RATE_HZ)
    assert np.flatnonzero(run.samples["flags"] & Flag.GLITCH).tolist() == [2000, 3000]
    write(tmp_path / "run.npz", run.samples, config)
    again = replay(tmp_path / "run.npz")
    assert again.identical == again.ticks
    speeds = [event["speed_m_per_s"] for event in again.events if event["event"] == "glitch"]
    steps = np.hypot(*np.diff(positions, axis=0)[[1999, 2999]].T)
    assert speeds == pytest.approx(steps * RATE_HZ)


def test_the_link_of_a_real_device_limits_the_displayed_frequencies(tmp_path: Path) -> None:
    """At 1000 forces a second glass is lowered; the replay strikes the mode that the daemon struck at this link."""
    config = {"device": {"kind": "hid"}, "scene": {"objects": {"floor": {**FLOOR, "material": "glass"}}}}
    whole = load_config(config)
    rerun = Rerun(output_of(whole, RATE_HZ, 1000.0), 1)
    rerun.turn_to(whole.scene, whole.scene.objects, whole.materials, 1)
    recorded = render_run({"scene": config["scene"]}, strokes(0.5), RATE_HZ).samples
    samples, _ = rerun.run(recorded, np.full(len(recorded), 1 / RATE_HZ), np.ones(len(recorded), np.uint32))
    status = {"connection": {"link_hz": 1000.0}}
    write(tmp_path / "run.npz", samples[1:], config, texts={"status": status})
    again = replay(tmp_path / "run.npz")
    assert again.identical == len(again.samples) > 4000
    write(tmp_path / "run.npz", samples[1:], config, texts={"status": {"connection": None}})
    again = replay(tmp_path / "run.npz")
    assert again.differences["vibration_force_n"].largest_n > 0.01


@pytest.mark.parametrize("begin", [0, 60])
def test_the_force_of_a_check_of_signs_is_as_recorded_without_the_scene(tmp_path: Path, begin: int) -> None:
    """A constant force of the scene comes in over the ramp once the check is over."""
    config = {"device": {"kind": "hid"}, "scene": {"objects": {"push": PUSH}}}
    whole = load_config(config)
    recorded = np.zeros(2000, SAMPLE_DTYPE)
    recorded["tick"] = np.arange(2000)
    recorded["time_ns"] = recorded["tick"] * 100_000
    recorded["flags"] = Flag.FORCES_ON
    recorded["flags"][:1000] |= np.uint32(Flag.CHECKING)
    recorded["force_n"][:900, 0] = 0.1 * np.sin(np.arange(900))
    rerun = Rerun(output_of(whole, RATE_HZ), 1)
    rerun.turn_to(whole.scene, whole.scene.objects, whole.materials, 1)
    rerun.restart(muted=True)
    samples, _ = rerun.run(recorded, np.full(2000, 1 / RATE_HZ), np.ones(2000, np.uint32))
    assert samples["force_n"][:1000].tobytes() == recorded["force_n"][:1000].tobytes()
    assert (samples["flags"] & Flag.CHECKING).tobytes() == (recorded["flags"] & Flag.CHECKING).tobytes()
    assert 0.0 < samples["force_n"][1000, 1] < 0.1 * PUSH_N and samples["force_n"][-1].tolist() == [0.0, PUSH_N]
    write(tmp_path / "run.npz", samples[begin:], config, texts={"status": {"connection": None}})
    again = replay(tmp_path / "run.npz")
    assert again.identical == len(again.samples) > 1900


def test_the_rate_is_that_which_the_daemon_had_stepped_down_to(tmp_path: Path) -> None:
    config = {"scene": {"objects": {"floor": FLOOR}}}
    run = render_run({**config, "servo": {"rate_hz": 5000}}, strokes(0.5)[::2], 5000)
    write(tmp_path / "run.npz", run.samples, config, texts={"status": {"rate_hz": 5000.0}})
    again = replay(tmp_path / "run.npz")
    assert again.identical == len(again.samples) > 2000
    write(tmp_path / "run.npz", run.samples, config)
    assert replay(tmp_path / "run.npz").differences["force_n"].largest_n > 0.01


class Changing:
    """A run that changes on the way, by the calls that a daemon makes."""

    def __init__(self) -> None:
        config = default_config()
        self.materials = config.materials
        self.rerun = Rerun(output_of(config, RATE_HZ), 4)
        self.positions = strokes(1.0)
        self.parts: list[np.ndarray] = []
        self.at = 0

    def go(self, to: int, revision: int) -> None:
        recorded = np.zeros(to - self.at, SAMPLE_DTYPE)
        recorded["tick"] = np.arange(self.at, to)
        recorded["time_ns"] = recorded["tick"] * 100_000
        recorded["position_m"] = self.positions[self.at : to]
        before = np.vstack([self.positions[:1], self.positions[:-1]])
        recorded["velocity_m_per_s"] = (self.positions - before)[self.at : to] * RATE_HZ
        recorded["flags"] = Flag.FORCES_ON
        samples, _ = self.rerun.run(recorded, np.full(to - self.at, 1 / RATE_HZ), np.ones(to - self.at, np.uint32))
        assert set(samples["revision"]) == {revision}
        self.parts.append(samples)
        self.at = to


def test_scene_materials_and_commands_change_where_they_did(tmp_path: Path) -> None:
    """Under the hand, too: a material at tick 3000, an object that comes at 5000 and goes at 7000, a mode that is
    played at 8000, and a contact that is cleared at a tick that presses."""
    run = Changing()
    first = validate_scene({"objects": {"floor": FLOOR}})
    run.rerun.turn_to(first, ["floor"], run.materials, 1)
    run.go(3000, 1)
    softer = {**run.materials, "wood": run.materials["wood"].model_copy(update={"stiffness_n_per_m": 500.0})}
    run.rerun.turn_to(first, [], softer, 2)
    run.go(5000, 2)
    box = {"kind": "box", "center_m": [0.0, 0.002], "size_m": [0.03, 0.004], "material": "steel"}
    second = validate_scene({"ramp_s": 0.01, "objects": {"floor": FLOOR, "box": box}})
    run.rerun.turn_to(second, ["box"], softer, 3)
    run.go(7000, 3)
    run.rerun.turn_to(validate_scene({"ramp_s": 0.01, "objects": {"floor": FLOOR}}), ["box"], softer, 5)
    run.go(8000, 5)
    run.rerun.play(Mode(100.0, 900.0), "first_peak", (3.0, 4.0), 7.0)
    pressed = 8300 + int(np.argmax(run.positions[8300:, 1] < -0.001))
    run.go(pressed, 5)
    run.rerun.reset(["floor"], pressed * 100_000)
    run.go(10_000, 5)
    samples = np.concatenate(run.parts)
    assert all((part["flags"] & Flag.CONTACT).any() for part in run.parts if len(part) > 1500)
    changes = (
        {"revision": 2, "materials": {"wood": softer["wood"].to_dict()}},
        {"revision": 3, "scene": {"ramp_s": 0.01}, "objects": {"box": second.objects["box"].to_dict()}},
        {"revision": 4, "objects": {"box": {**box, "size_m": [0.01, 0.01]}}},
        {"revision": 5, "objects": {"box": None}},
        {
            "tick": 8000,
            "play": {
                "decay_rate_per_s": 100.0,
                "angular_frequency_rad_per_s": 900.0,
                "attack": "first_peak",
                "direction": [3.0, 4.0],
                "amplitude_m_per_s2": 7.0,
            },
        },
        {"tick": pressed, "reset": {"objects": ["floor"]}},
    )
    config = {"servo": {"rate_hz": RATE_HZ}, "scene": {"objects": {"floor": FLOOR}}}
    write(tmp_path / "run.npz", samples, config, *changes)
    again = replay(tmp_path / "run.npz")
    assert again.identical == again.ticks == 10_000
    # Each change matters: without it, the first difference is where it was.
    for left_out, tick in enumerate((3000, 5000, None, 7000, 8000, pressed)):
        kept = [change for place, change in enumerate(changes) if place != left_out]
        write(tmp_path / "less.npz", samples, config, *kept)
        again = replay(tmp_path / "less.npz")
        if "revision" in changes[left_out] and tick is not None:
            assert again.missing_revisions == (changes[left_out]["revision"],)
            assert len(again.samples) < 10_000
        elif tick is None:
            assert again.identical == 10_000, "no tick was rendered with revision 4"
        else:
            first = again.first_different
            assert first is not None and tick <= first < tick + 100


def test_a_rendered_recording_keeps_the_time_of_day(tmp_path: Path) -> None:
    """Exported to .mcap, it lies beside the recorded one."""
    config = {"scene": {"objects": {"floor": FLOOR}}}
    clock = {"monotonic_ns": 10**9, "realtime_ns": 1_750_000_000 * 10**9}
    run = render_run(config, strokes(1.0)[:100], RATE_HZ)
    write(tmp_path / "run.npz", run.samples, config, texts={"recording": {"started": clock, "lost": 3}})
    replay(tmp_path / "run.npz").write(tmp_path / "again.npz")
    again = load(tmp_path / "again.npz")
    assert again.started is not None and again.started.realtime_ns == clock["realtime_ns"]
    assert np.array_equal(again.utc(), load(tmp_path / "run.npz").utc())


@pytest.mark.parametrize("about", [None, [1], "stopped"])
def test_a_recording_without_an_account_is_rendered_and_written(tmp_path: Path, about: object) -> None:
    config = {"scene": {"objects": {"floor": FLOOR}}}
    run = render_run(config, strokes(1.0)[:100], RATE_HZ)
    write(tmp_path / "run.npz", run.samples, config, texts={"recording": about})
    replay(tmp_path / "run.npz").write(tmp_path / "again.npz")
    again = load(tmp_path / "again.npz")
    assert len(again.samples) == 100 and again.started is None


def test_a_replay_begins_at_a_tick_without_effects_of_earlier_ticks(tmp_path: Path) -> None:
    config = {"scene": {"objects": {"floor": FLOOR}}}
    run = render_run(config, strokes(1.0), RATE_HZ)
    flags = run.samples["flags"]
    touched = np.flatnonzero(flags & Flag.CONTACT)
    begin = int(touched[0]) + 50
    assert flags[begin] & Flag.CONTACT and flags[begin] & Flag.RINGING
    write(tmp_path / "run.npz", run.samples[begin:], config)
    again = replay(tmp_path / "run.npz")
    quiet = flags & (Flag.CONTACT | Flag.RINGING | Flag.RAMPING) == 0
    expected = next(tick for tick in range(begin + 1, len(flags)) if quiet[tick] and quiet[tick - 1])
    assert int(again.samples["tick"][0]) == expected
    assert again.identical == len(again.samples) == len(flags) - expected


def test_without_a_settled_tick_the_entire_recording_is_rendered_and_reported(tmp_path: Path) -> None:
    config = {"scene": {"objects": {"floor": FLOOR}}}
    inside = np.column_stack([np.zeros(2000), np.full(2000, -0.001)])
    run = render_run(config, inside, RATE_HZ)
    write(tmp_path / "run.npz", run.samples[1000:], config)
    again = replay(tmp_path / "run.npz")
    assert not again.settled and len(again.samples) == 1000
    # The pressed object is touched again, and its force rises over the ramp: 200 ticks.
    different = np.flatnonzero((again.samples["force_n"] != again.recorded["force_n"]).any(axis=1))
    assert 190 <= len(different) <= 200 and different[-1] <= 200
    assert "each has a contact, a ringing mode or a ramp" in again.summary()


def test_it_begins_anew_after_a_gap_and_after_a_fault(tmp_path: Path) -> None:
    config = {"scene": {"objects": {"floor": FLOOR}}}
    samples = render_run(config, strokes(1.0), RATE_HZ).samples
    kept = np.concatenate([samples[:2500], samples[2600:]])
    kept["flags"][5000:5100] |= np.uint32(Flag.FAULT)
    write(tmp_path / "run.npz", kept, config)
    again = replay(tmp_path / "run.npz")
    assert again.identical == len(again.samples)
    ticks = set(again.samples["tick"].tolist())
    assert set(range(2500)) < ticks
    assert not ticks & {*range(2500, 2600), *range(5100, 5200)}
    assert {2600 + 7000, 5200 + 4000} < ticks


def test_ticks_with_a_streamed_force_are_left_out_and_reported(tmp_path: Path) -> None:
    config = {"scene": {"objects": {"floor": FLOOR}}}
    samples = render_run(config, strokes(1.0), RATE_HZ).samples
    end = 4000 + 10 + int(np.argmax(samples["flags"][4000:] & Flag.CONTACT != 0))
    assert (samples["flags"][[end - 1, end]] & Flag.CONTACT).all(), "it ends while something is pressed"
    samples["flags"][end - 1000 : end] |= np.uint32(Flag.STREAMED)
    samples["contact_force_n"][end - 1000 : end] += 0.1
    samples["force_n"][end - 1000 : end] += 0.1
    write(tmp_path / "run.npz", samples, config)
    again = replay(tmp_path / "run.npz")
    assert again.identical == len(again.samples) == 9000 - again.left_out["begun_before"]
    assert again.left_out["streamed"] == 1000 and 0 < again.left_out["begun_before"] < 2000
    assert set(range(end - 1000)) < set(again.samples["tick"].tolist())
    assert "1,000 with a streamed force" in again.summary()
    samples["flags"] |= np.uint32(Flag.STREAMED)
    write(tmp_path / "run.npz", samples, config)
    with pytest.raises(HapticdError, match="no tick can be rendered again: 10,000 with a streamed force"):
        replay(tmp_path / "run.npz")


def test_forces_that_were_off_are_off(tmp_path: Path) -> None:
    config = {"scene": {"objects": {"floor": FLOOR}}}
    samples = render_run(config, strokes(0.6), RATE_HZ).samples
    off = samples.copy()
    off["flags"] &= ~np.uint32(Flag.FORCES_ON)
    write(tmp_path / "run.npz", off[1:], config)
    again = replay(tmp_path / "run.npz")
    assert (again.samples["flags"] & Flag.CONTACT).any()
    assert not again.samples["force_n"].any()


def test_a_difference_is_measured_and_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = {"scene": {"objects": {"floor": FLOOR}}}
    samples = render_run(config, strokes(0.4), RATE_HZ).samples
    samples["force_n"][700] += [0.03, 0.04]
    write(tmp_path / "run.npz", samples, config)
    again = replay(tmp_path / "run.npz")
    assert (again.identical, again.first_different) == (3999, 700)
    assert again.differences["force_n"].largest_n == pytest.approx(0.05)
    assert again.differences["force_n"].rms_n == pytest.approx(0.05 / np.sqrt(4000))
    assert again.differences["contact_force_n"].largest_n == 0
    assert main(["replay", str(tmp_path / "run.npz")]) == 1
    told = "4,000 of 4,000 ticks rendered again, 1 not as recorded, the first is tick 700; "
    assert capsys.readouterr().out == f"{tmp_path}/run.npz: {told}the force differs by 0.05 N at most, 0.000791 N RMS\n"


def test_the_command_and_the_function(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, operator = str(CONFIG / "scenes" / "membrane.yaml"), str(CONFIG / "operators" / "push.yaml")
    simulate_files([scene], operator, str(tmp_path / "run.npz"), 1.0, None)
    target = tmp_path / "again.npz"
    assert main(["replay", str(tmp_path / "run.npz"), "-o", str(target), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["ticks"], told["replayed"], told["identical"], told["first_different"]) == (10_000,) * 3 + (None,)
    assert told["differences"].keys() == set(FORCE_FIELDS)
    assert hapticd.replay(target).identical == 10_000, "what was rendered is a recording again"
    assert load(target).samples.tobytes() == load(tmp_path / "run.npz").samples.tobytes()


@pytest.mark.parametrize(
    ("left_out", "told"),
    [("config", "no config"), ("scene", "no scene"), ("materials", "no materials"), ("changes", "no changes")],
)
def test_a_recording_without_a_needed_text_is_refused(tmp_path: Path, left_out: str, told: str) -> None:
    config = {"scene": {"objects": {"floor": FLOOR}}}
    samples = render_run(config, strokes(0.1), RATE_HZ).samples
    write(tmp_path / "run.npz", samples, config)
    rewrite(tmp_path / "run.npz", left_out, None)
    with pytest.raises(HapticdError, match=f"run.npz: cannot be rendered again: it holds {told}"):
        replay(tmp_path / "run.npz")


@pytest.mark.parametrize(
    ("part", "value", "told"),
    [
        ("config", {"servo": {"rate_hz": -1}, "device": {}}, "servo.rate_hz"),
        ("config", [], "no config"),
        ("config", {"servo": {}}, "KeyError"),
        ("scene", {"objects": {"floor": {**FLOOR, "material": "nothing"}}}, "nothing"),
        ("scene", {"objects": {"floor": {"kind": "cube"}}}, "cube"),
        ("changes", [{"revision": 9}], "no tick can be rendered again: 1,000 whose scene is not in the file"),
        ("changes", [7], "TypeError"),
    ],
)
def test_an_invalid_text_is_an_error_of_one_line(tmp_path: Path, part: str, value: object, told: str) -> None:
    config = {"scene": {"objects": {"floor": FLOOR}}}
    samples = render_run(config, strokes(0.1), RATE_HZ).samples
    write(tmp_path / "run.npz", samples, config)
    rewrite(tmp_path / "run.npz", part, value)
    with pytest.raises(HapticdError, match=told) as raised:
        replay(tmp_path / "run.npz")
    assert "run.npz" in str(raised.value) and "\n" not in str(raised.value)


def test_ticks_of_a_recording_only_grow(tmp_path: Path) -> None:
    config = {"scene": {"objects": {"floor": FLOOR}}}
    samples = render_run(config, strokes(0.2), RATE_HZ).samples
    with pytest.raises(HapticdError, match="comes after tick"):
        again = replace_ticks(samples)
        rerun = Rerun(output_of(load_config(config), RATE_HZ), 1)
        whole = load_config(config)
        rerun.turn_to(whole.scene, whole.scene.objects, whole.materials, 1)
        rerun.run(again, np.full(len(again), 1e-4), np.ones(len(again), np.uint32))


def replace_ticks(samples: np.ndarray) -> np.ndarray:
    backwards = samples.copy()
    backwards["tick"] = backwards["tick"][::-1]
    return backwards


def test_a_step_down_is_rendered_at_both_rates(tmp_path: Path) -> None:
    """The second half equals a separate run at its rate; in its first ticks earlier modes still ring."""
    config = {"scene": {"objects": {"floor": FLOOR}}}
    positions = strokes(1.0)
    fast = render_run(config, positions[:5000], RATE_HZ).samples
    slow = render_run({**config, "servo": {"rate_hz": 5000}}, positions[5000::2], 5000).samples.copy()
    slow["tick"] += 5000
    slow["time_ns"] += 500_000_000
    slow["revision"] = 2
    samples = np.concatenate([fast, slow])
    target = tmp_path / "run.npz"
    status = {"rate_hz": float(RATE_HZ)}
    write(target, samples, config, {"revision": 2, "rate_hz": 5000.0}, texts={"status": status})
    again = replay(target)
    assert again.missing_revisions == ()
    ticks = again.samples["tick"]
    assert set(ticks.tolist()) >= set(range(5000)) and (ticks >= 5000).sum() > 2000
    assert again.identical == len(again.samples)
    # Without the new rate in the recording, the forces differ.
    write(target, samples, config, {"revision": 2}, texts={"status": status})
    again = replay(target)
    assert again.first_different is not None and again.first_different >= 5000


@pytest.mark.parametrize("rate_hz", ["fast", 0.0, -1.0, 1e300, None, [5000]])
def test_an_invalid_rate_is_refused(tmp_path: Path, rate_hz: object) -> None:
    config = {"scene": {"objects": {"floor": FLOOR}}}
    run = render_run(config, strokes(0.1), RATE_HZ)
    run.samples["revision"][500:] = 2
    write(tmp_path / "run.npz", run.samples, config, {"revision": 2, "rate_hz": rate_hz})
    with pytest.raises(HapticdError):
        replay(tmp_path / "run.npz")


def test_objects_are_taken_in_the_order_in_which_they_changed() -> None:
    """The order in which forces are added up follows from it, and must not differ from process to process."""
    scene = validate_scene({"objects": {id: {"kind": "constant", "force_n": [1, 0]} for id in ("c", "a", "b")}})
    taken: list[list[str]] = []

    class Took:
        def turn_to(self, _scene: object, changed: Mapping[str, None], *_: object) -> None:
            taken.append(list(changed))

    names = [f"o{number}" for number in range(40, 0, -1)]
    revisions = [_Revision(1, scene, {}, (*names, "c"), 1e3), _Revision(2, scene, {}, ("z", "o7", "c", "a"), 1e3)]
    rerun = cast(Rerun, Took())
    assert _change_scene(rerun, revisions, -1, 1) == 1
    assert _change_scene(rerun, revisions, 1, 0) == 0
    assert taken == [[*names, "c", "z", "a"], ["c", "a", "b"]]
