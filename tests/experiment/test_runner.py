"""A running session: what is armed when, the effect of commands, and what remains after a crash."""

from __future__ import annotations

import json
import random
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapticd.base.core import SAMPLE_DTYPE, Flag
from hapticd.base.errors import HapticdError
from hapticd.config.configuration import load_config
from hapticd.experiment.daemon_stage import DaemonStage
from hapticd.experiment.front import Command, Reply, Shown
from hapticd.experiment.session import plan_document, plan_of
from hapticd.experiment.session_folder import SessionFolder
from hapticd.experiment.session_log import read_log
from hapticd.experiment.stage import ForcesLost, ForcesStopped, Telemetry
from hapticd.experiment.trial_scenes import configurations
from hapticd.protocol.calls import DaemonNotRunning, RemoteError
from hapticd.recording.recording import load
from tests.experiment.sessions import STAIRCASE, STUDY, NotedStage, ScriptedFront, planned, resumed, started
from tests.support.daemon_process import connect, running_daemon

SESSION = Path("sub-P07/ses-01")


def _config(folder: Path) -> Path:
    """Write the configuration of a servo that needs no real-time rights, and whose missed periods are not reported."""
    path = folder / "servo.yaml"
    path.write_text("servo: {rate_hz: 1000, realtime: off, overruns: {threshold: 1}}\n")
    return path


def _records(root: Path, kind: str) -> list[dict[str, Any]]:
    return [record for record in read_log(root / SESSION / "log.jsonl").records if record["kind"] == kind]


def test_every_trial_is_armed_with_the_forces_off_and_answered_before_the_next(tmp_path: Path) -> None:
    stage, front = NotedStage(), ScriptedFront()
    assert started(tmp_path, stage, front).run() == "ended"
    plan = planned()
    assert len(plan.trials) == 6
    one = ["record", "arm", "mark trial_armed", "enable", "mark interval", "mark answer", "fade", "mark forces_off"]
    one += ["recorded", "mark trial_end"]
    assert stage.done == ["fade", "mark session_begin", *(one * 6), "fade", "mark session_end"]
    answers = _records(tmp_path, "answer")
    assert [answer["trial"] for answer in answers] == [trial.index for trial in plan.trials]
    for trial, answer in zip(plan.trials, answers, strict=True):
        assert answer["correct"] == int(trial.correct == "first")
    kinds = [record["kind"] for record in read_log(tmp_path / SESSION / "log.jsonl").records]
    assert kinds == ["session_started", *(["trial_started", "answer"] * 6), "ended"]


def test_what_is_armed_is_what_was_planned(tmp_path: Path) -> None:
    stage = NotedStage()
    started(tmp_path, stage, ScriptedFront()).run()
    plan = planned()
    for trial, config in zip(plan.trials, stage.configs, strict=True):
        wanted = configurations(plan.study, trial.stimuli)[0]
        assert config.scene == wanted.scene
        assert config.materials["left"] == wanted.materials[str(trial.stimuli[0].levels["material"])]
        assert config.materials["right"] == wanted.materials[str(trial.stimuli[1].levels["material"])]


def test_the_participants_side_gets_no_name(tmp_path: Path) -> None:
    front = ScriptedFront()
    started(tmp_path, NotedStage(), front).run()
    text = repr(front.shown)
    for name in ("wood", "delrin", "steel", "material", "force"):
        assert name not in text
    assert "The left one" in text


def test_a_pause_and_a_repetition_begin_the_trial_again(tmp_path: Path) -> None:
    stage, front = NotedStage(), ScriptedFront()
    front.commands = {"ask": [Command("repeat"), Command("pause"), Command("note", "a cough")]}
    assert started(tmp_path, stage, front).run() == "ended"
    assert [record["because"] for record in _records(tmp_path, "trial_given_up")] == ["repeat", "pause"]
    assert [record["text"] for record in _records(tmp_path, "note")] == ["a cough"]
    first = [record["attempt"] for record in _records(tmp_path, "trial_started") if record["trial"] == 0]
    assert first == [1, 2, 3]
    assert len(_records(tmp_path, "paused")) == len(_records(tmp_path, "continued")) == 1
    assert sorted(record["trial"] for record in _records(tmp_path, "answer")) == list(range(6))
    # Each attempt has a separate file.
    files = [str(record["file"]) for record in _records(tmp_path, "trial_started")]
    assert len(set(files)) == len(files)
    # The force is zero and the recording has ended before the trial begins again.
    one = ["record", "arm", "mark trial_armed", "enable", "mark interval", "fade", "mark trial_given_up", "recorded"]
    assert stage.done[:20] == ["fade", "mark session_begin", *one, *one, "mark pause_begin", "mark pause_end"]


@pytest.mark.parametrize("where", ["begin", "phase", "ready", "ask"])
def test_the_stop_key_fades_the_force_and_the_session_can_go_on(where: str, tmp_path: Path) -> None:
    stage, front = NotedStage(), ScriptedFront()
    front.commands = {where: [Command("abort")]}
    assert started(tmp_path, stage, front).run() == "aborted"
    assert stage.done[-2:] == ["fade", "mark session_aborted"]
    assert len(_records(tmp_path, "aborted")) == 1
    assert resumed(tmp_path / SESSION, NotedStage(), ScriptedFront()).run() == "ended"
    assert [record["trial"] for record in _records(tmp_path, "answer")] == list(range(6))


def test_a_session_that_is_over_does_not_run_again(tmp_path: Path) -> None:
    started(tmp_path, NotedStage(), ScriptedFront()).run()
    with pytest.raises(HapticdError, match="this session is over"):
        resumed(tmp_path / SESSION, NotedStage(), ScriptedFront()).run()
    with pytest.raises(HapticdError, match="this session already exists; resume it with"):
        started(tmp_path, NotedStage(), ScriptedFront())


def test_the_plan_comes_back_from_its_file(tmp_path: Path) -> None:
    for number, document in enumerate((STUDY, STAIRCASE)):
        root = tmp_path / str(number)
        started(root, NotedStage(), ScriptedFront(), document)
        folder = SessionFolder.open(root / SESSION)
        assert plan_document(plan_of(folder)) == plan_document(planned(document)) == folder.plan
        assert plan_of(folder) == planned(document)


class _DiedError(BaseException):
    """As if the process had been killed: no handler of errors catches it."""


def _level(shown: Shown) -> str:
    return shown.answers[shown.number % 2].name


@pytest.mark.parametrize("seed", range(3))
def test_killed_at_any_call_a_session_with_a_staircase_continues_as_if_it_had_not_been_killed(
    seed: int, tmp_path: Path
) -> None:
    complete = tmp_path / "whole"
    assert started(complete, NotedStage(), ScriptedFront(_level), STAIRCASE).run() == "ended"
    chance = random.Random(seed)

    def dies() -> Callable[[str], None]:
        left = chance.randrange(3, 60)

        def die(done: str) -> None:
            nonlocal left
            left -= 1
            if left == 0:
                raise _DiedError

        return die

    root = tmp_path / "killed"
    deaths = 0
    try:
        session = started(root, NotedStage(dies()), ScriptedFront(_level), STAIRCASE)
        session.run()
    except _DiedError:
        deaths += 1
    for _ in range(200):
        again = resumed(root / SESSION, NotedStage(dies()), ScriptedFront(_level))
        try:
            if again.run() == "ended":
                break
        except _DiedError:
            deaths += 1
    assert deaths > 0
    for kind, names in (("answer", ("trial", "answer", "level", "correct")), ("trial_skipped", ("trial",))):
        left, right = ([[each[name] for name in names] for each in _records(place, kind)] for place in (complete, root))
        assert left == right
    assert _records(complete, "answer")[-1]["procedure_state"] == _records(root, "answer")[-1]["procedure_state"]


def test_answers_are_on_disk_before_the_next_trial_begins(tmp_path: Path) -> None:
    seen: list[int] = []

    class Looking(ScriptedFront):
        def ready(self, shown: Shown, watched: Any) -> Command | None:
            seen.append(len(_records(tmp_path, "answer")))
            return super().ready(shown, watched)

    started(tmp_path, NotedStage(), Looking()).run()
    assert seen == list(range(6))


def test_forces_that_are_lost_in_a_trial_make_it_begin_again(tmp_path: Path) -> None:
    left = [2]

    def fails(done: str) -> None:
        if done == "check" and left[0]:
            left[0] -= 1
            raise ForcesLost("the daemon took the forces away (lease)")

    front = ScriptedFront()
    assert started(tmp_path, NotedStage(fails), front).run() == "ended"
    assert len(front.lines) == 2
    assert [record["attempt"] for record in _records(tmp_path, "answer")] == [3, 1, 1, 1, 1, 1]
    left[0] = 100
    root = tmp_path / "always"
    with pytest.raises(HapticdError, match="took the forces away"):
        started(root, NotedStage(fails), ScriptedFront()).run()
    assert _records(root, "answer") == []


def test_forces_come_on_when_the_handle_is_out_of_everything(tmp_path: Path) -> None:
    stage, front = NotedStage(), ScriptedFront()
    stage.clear = [True, False]
    assert started(tmp_path, stage, front).run() == "ended"
    asked = [each for each in front.asked if each in ("withdraw", "ready", "ask")]
    assert asked[:7] == ["ready", "ask", "ready", "withdraw", "ask", "ready", "ask"]
    stage.clear = [False]
    front.commands["withdraw"] = [Command("abort")]
    stage.done.clear()
    assert started(tmp_path / "stopped", stage, front).run() == "aborted"
    assert "enable" not in stage.done


WALL = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"}
MEMBRANE = {"kind": "membrane", "center_m": [0, 0], "normal": [0, 1], "width_m": 0.04, "material": "cellophane"}
DISC = {"kind": "disc", "center_m": [0, 0], "radius_m": 0.008, "material": "wood"}


@pytest.mark.long
def test_a_handle_is_clear_inside_nothing_and_behind_no_membrane(tmp_path: Path) -> None:
    cases = [
        (WALL, (0.0, 0.001), True), (WALL, (0.0, -0.02), False),
        (MEMBRANE, (0.0, 0.001), True), (MEMBRANE, (0.01, -0.02), False), (MEMBRANE, (0.03, -0.02), True),
        (DISC, (0.0, 0.001), False), (DISC, (0.03, -0.001), True),
    ]  # fmt: skip
    with (
        running_daemon("-c", str(_config(tmp_path))) as daemon,
        connect(daemon.directory) as client,
        DaemonStage(client) as stage,
    ):
        for item, position_m, clear in cases:
            client.set_operator([[0.05, *position_m]])
            assert client.wait_gesture(timeout_s=60.0)["completed"]
            stage.arm(load_config({"scene": {"objects": {"item": item}}}))
            assert stage.is_clear() is clear, (item, position_m)


def test_a_procedure_that_has_ended_gives_no_more_breaks(tmp_path: Path) -> None:
    """After the last answer its other trials are skipped, and no break precedes them."""
    front = ScriptedFront(_level)
    study = {**STAIRCASE, "breaks": {"every_trials": 1}}
    assert started(tmp_path, NotedStage(), front, study).run() == "ended"
    answers = len(_records(tmp_path, "answer"))
    assert len(_records(tmp_path, "trial_skipped")) > 0
    assert front.asked.count("rest") == answers - 1


MOTOR: dict[str, Any] = {
    **{key: STAIRCASE[key] for key in ("experiment", "instructions")},
    "title": "Push through",
    "base": {
        "scene": {
            "objects": {
                "skin": {"kind": "membrane", "center_m": [0, 0], "normal": [0, 1], "width_m": 0.1, "material": "wood"}
            }
        }
    },
    "trial": {"type": "motor", "question": "push", "measures": ["peak_force_n"]},
    "repetitions": 2,
    "questions": {"push": {"kind": "measure", "measure": "overtravel_m", "text": "Push."}},
    "feedback": "measure",
}


class PushedStage(NotedStage):
    """A stage whose hand breaks the membrane in the attempts in `breaks`, counted from 0, and continues for 3 mm."""

    def __init__(self, breaks: frozenset[int], force_n: float = 2.0) -> None:
        super().__init__()
        self._breaks, self._force_n = breaks, force_n

    def telemetry(self) -> Telemetry:
        samples = np.zeros(101, SAMPLE_DTYPE)
        samples["time_ns"] = np.arange(101) * 1_000_000
        samples["position_m"][:, 1] = np.linspace(0.0, -6e-3, 101)
        samples["force_n"][50, 1] = self._force_n
        broke = {"event": "puncture", "object": "skin", "onset_time_ns": 50_000_000}
        return Telemetry(samples, [broke] if self.done.count("record") - 1 in self._breaks else [])


def test_a_motor_task_that_was_not_done_begins_again(tmp_path: Path) -> None:
    front = ScriptedFront(lambda shown: "")
    assert started(tmp_path, PushedStage(frozenset({1, 2})), front, MOTOR).run() == "ended"
    assert [answer["attempt"] for answer in _records(tmp_path, "answer")] == [2, 1]
    assert [answer["answer"] for answer in _records(tmp_path, "answer")] == [pytest.approx(3e-3)] * 2
    (given_up,) = _records(tmp_path, "trial_given_up")
    assert (given_up["trial"], given_up["because"]) == (
        0,
        "not done: No membrane broke. Push further, until it breaks.",
    )
    measured = "Largest force: 2 N. Overtravel: 3 mm."
    assert front.feedbacks == ["1: No membrane broke. Push further, until it breaks.", measured, measured]


@pytest.mark.parametrize("measure", ["overtravel_m", "peak_force_n"])
def test_a_motor_task_that_is_never_done_has_no_answer_after_three_attempts(measure: str, tmp_path: Path) -> None:
    front = ScriptedFront(lambda shown: "")
    question = {**MOTOR["questions"]["push"], "measure": measure}
    study = {**MOTOR, "trial": {"type": "motor", "question": "push"}, "questions": {"push": question}}
    assert started(tmp_path, PushedStage(frozenset(), force_n=0.0), front, study).run() == "ended"
    assert [(answer["attempt"], answer["answer"]) for answer in _records(tmp_path, "answer")] == [(3, None)] * 2
    assert len(_records(tmp_path, "trial_given_up")) == 4


def test_forces_that_another_client_stopped_stay_off_until_the_experimenter_continues(tmp_path: Path) -> None:
    stopped = [True]

    def fails(done: str) -> None:
        if done == "check" and stopped:
            stopped.clear()
            raise ForcesStopped("another client switched the forces off")

    front = ScriptedFront()
    stage = NotedStage(fails)
    assert started(tmp_path, stage, front).run() == "ended"
    assert front.asked.count("paused") == 1
    assert stage.done.count("enable") == 7
    kinds = [record["kind"] for record in read_log(tmp_path / SESSION / "log.jsonl").records]
    assert kinds[2:5] == ["trial_given_up", "paused", "continued"]


@pytest.mark.parametrize("moment", ["before", "after"])
def test_a_stop_while_the_scene_is_loaded_leaves_the_forces_off(tmp_path: Path, moment: str) -> None:
    """The participant presses the stop between two intervals, while no method of the front is running."""
    stage = NotedStage()

    class Stops(ScriptedFront):
        def may_enable(self) -> Command | None:
            enabled = stage.done.count("enable")
            # It is called twice per interval: before and after the forces are switched on.
            return Command("abort") if enabled == (1 if moment == "before" else 2) and stage.done[-1] == last else None

    last = "arm" if moment == "before" else "enable"
    assert started(tmp_path, stage, Stops(), STAIRCASE).run() == "aborted"
    assert stage.done.count("enable") == (1 if moment == "before" else 2)
    assert "fade" in stage.done[max(at for at, done in enumerate(stage.done) if done == "enable") :]


def _run_with_answers(root: Path, pattern: str, **stop: float) -> tuple[int, str]:
    """Run a session whose answers are correct (+) or wrong (-), with an abort and a resume at |. Return the number of
    answers, and why it ended."""
    document = {**STUDY, "repetitions": 2, "stop": stop}
    marks = iter(pattern.replace("|", ""))
    right: list[str | None] = [trial.correct for trial in planned(document).trials]

    class Answering(ScriptedFront):
        def ready(self, shown: Shown, watched: Any) -> Command | None:
            if pattern[watched.answered] == "|" and watched.attempt == 1:
                return Command("abort")
            self.answers = lambda shown: _given(next(marks), right[watched.index])
            return super().ready(shown, watched)

    session = started(root, NotedStage(), Answering(), document)
    while session.run() == "aborted":
        session = resumed(root / SESSION, NotedStage(), Answering())
    return len(_records(root, "answer")), str(_records(root, "ended")[0]["because"])


def _given(sign: str, right: str | None) -> str:
    others = [name for name in ("first", "same", "second") if name != right]
    return right if sign == "+" and right is not None else others[0]


@pytest.mark.parametrize(
    "pattern, answered, because",
    [
        ("--+---++++++", 6, "3 wrong answers in a row"),
        ("--|-+++++++++", 3, "3 wrong answers in a row"),
        ("--+--+--+--+", 12, "all trials are done"),
    ],
)
def test_wrong_answers_in_a_row_end_the_test(pattern: str, answered: int, because: str, tmp_path: Path) -> None:
    """The count continues over a resume of the session."""
    assert _run_with_answers(tmp_path, pattern, wrong_in_a_row=3) == (answered, because)


# ---- With a daemon -------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_a_session_on_a_daemon_arms_with_no_force_and_at_one_tick(tmp_path: Path) -> None:
    """Between two trials the command is zero before the scene changes, and until the forces are switched on."""
    with (
        running_daemon("-c", str(_config(tmp_path))) as daemon,
        connect(daemon.directory) as client,
        connect(daemon.directory) as other,
    ):
        # The hand presses on the left box all the time, so that each scene is felt.
        client.set_operator([[0.0, -0.03, 0.01], [0.3, -0.03, -0.02]])
        with other.record(tmp_path / "all.npz") as recorder, DaemonStage(client) as stage:
            assert started(tmp_path, stage, ScriptedFront()).run() == "ended"
        samples = load(recorder.result.file).samples
    revisions = samples["revision"]
    changes = np.flatnonzero(np.diff(revisions.astype(np.int64))) + 1
    on = (samples["flags"] & Flag.FORCES_ON) != 0
    # A busy machine loses samples: only changes with the samples of both ticks are checked.
    changes = changes[np.diff(samples["tick"].astype(np.int64))[changes - 1] == 1]
    for at in changes:
        assert not on[at - 1]
        assert not on[at]
        assert samples["force_n"][at - 1].tolist() == [0.0, 0.0]
        assert samples["force_n"][at].tolist() == [0.0, 0.0]
    # Each trial was felt, and its file has samples with the forces on.
    assert on.any()
    assert np.hypot(*samples["force_n"][on].T).max() > 0.0
    files = [str(record["file"]) for record in _records(tmp_path, "trial_started")]
    scenes: list[set[int]] = []
    for file in files:
        recorded = load(tmp_path / SESSION / file)
        assert recorded.notes["participant"] == "P07"
        codes = ["trial_armed", "interval", "answer", "forces_off"]
        texts = [mark["text"] for mark in recorded.marks]
        assert texts[-5:] == [*codes, "recorded"]
        # The first samples of a recording may precede the trial.
        assert set(texts[:-5]) <= {"session_begin", "trial_end"}
        # All forces of a trial belong to one scene.
        felt = (recorded.samples["flags"] & Flag.FORCES_ON) != 0
        scenes.append(set(recorded.samples["revision"][felt].tolist()))
    assert all(len(scene) == 1 for scene in scenes)
    assert len(set.union(*scenes)) == 6
    # No message that other clients can read names a stimulus.
    assert not any("steel" in json.dumps(mark["data"]) for mark in recorded.marks)


@pytest.mark.long
def test_another_client_that_changes_the_scene_is_found_before_the_forces_come_on(tmp_path: Path) -> None:
    with (
        running_daemon("-c", str(_config(tmp_path))) as daemon,
        connect(daemon.directory) as client,
        connect(daemon.directory) as other,
    ):

        class Meddled(ScriptedFront):
            def ready(self, shown: Shown, watched: Any) -> Command | None:
                other.update_scene({"left": None}, wait=True)
                return None

        with DaemonStage(client) as stage, pytest.raises(HapticdError, match="another client changed the scene"):
            started(tmp_path, stage, Meddled()).run()
        assert client.get_status()["forces"] == "off"
    assert len(_records(tmp_path, "stage_lost")) == 1


@pytest.mark.long
def test_a_stop_by_somebody_else_is_found_and_no_forces_come_without_a_lease(tmp_path: Path) -> None:
    with (
        running_daemon("-c", str(_config(tmp_path))) as daemon,
        connect(daemon.directory) as client,
        connect(daemon.directory) as other,
        pytest.raises(HapticdError, match="lease"),
        DaemonStage(client) as stage,
    ):
        stage.arm(configurations(planned().study, planned().trials[0].stimuli)[0])
        stage.check()
        stage.enable()
        stage.check()
        other.set_forces(False)
        with pytest.raises(ForcesStopped, match="another client switched the forces off"):
            stage.check()
        stage.fade()
        stage.check()
        # The lease lapsed, as if the runner had been delayed while the forces were off.
        other.lease(0, stage._token)
        with pytest.raises(RemoteError, match="lease"):
            stage.enable()
        assert other.get_status()["forces"] == "off"


@pytest.mark.slow
def test_a_killed_daemon_ends_the_run_with_an_error_of_one_line_and_the_session_can_be_resumed(tmp_path: Path) -> None:
    with running_daemon("-c", str(_config(tmp_path))) as daemon, connect(daemon.directory, timeout_s=3.0) as client:

        class Killing(ScriptedFront):
            def ask(self, shown: Shown, stage: Any) -> Reply | Command:
                if shown.number == 3:
                    daemon.stop(signal.SIGKILL)
                    stage.check()
                return super().ask(shown, stage)

        stage = DaemonStage(client)
        with pytest.raises(HapticdError) as caught, stage:
            started(tmp_path, stage, Killing()).run()
        assert isinstance(caught.value, DaemonNotRunning)
        assert "\n" not in str(caught.value)
    assert [record["trial"] for record in _records(tmp_path, "answer")] == [0, 1]
    with (
        running_daemon("-c", str(_config(tmp_path))) as daemon,
        connect(daemon.directory) as client,
        DaemonStage(client) as stage,
    ):
        assert resumed(tmp_path / SESSION, stage, ScriptedFront()).run() == "ended"
    assert [record["trial"] for record in _records(tmp_path, "answer")] == list(range(6))
