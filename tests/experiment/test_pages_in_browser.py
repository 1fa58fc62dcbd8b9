"""Both pages of a session in a real browser: a participant who moves the mouse and presses keys, an experimenter."""

from __future__ import annotations

import re
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser

from hapticd.base.core import Flag
from hapticd.experiment.event_codes import EventCode
from hapticd.recording.recording import load
from tests.experiment.browser_session import Session
from tests.experiment.scripted_pages import SESSION, Running, log_of, run_study
from tests.support.daemon_process import PATIENCE_S, Daemon, connect, running_daemon
from tests.web.browser import executable, running_browser

pytestmark = [pytest.mark.alone, pytest.mark.slow]  # a page that is delayed by 3 s counts as away


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    executable()
    with running_browser() as running:
        yield running


@pytest.fixture(scope="module")
def daemon(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    """Start a daemon after the browser: without a browser nothing is started."""
    path = tmp_path_factory.mktemp("daemon") / "servo.yaml"
    # With real-time rights if possible, so that a surface is felt while a browser draws.
    path.write_text("servo: {rate_hz: 1000, overruns: {threshold: 1}}\n")
    with running_daemon("-c", str(path)) as running:
        yield running


@pytest.fixture
def session(browser: Browser, daemon: Daemon, tmp_path: Path) -> Iterator[Callable[..., Session]]:
    """Return a function that starts a session of a study. The fixture kills it after the test."""
    # The previous test may have left the hand below a surface, which would keep the forces off.
    with connect(daemon.directory) as client:
        client.set_scene({"objects": {}}, wait=True)
        client.set_operator(waypoints=[[0.1, 0.0, 0.02]])
        assert client.wait_gesture(timeout_s=PATIENCE_S)["completed"]
    started: list[Session] = []
    words = ("--runtime-dir", str(daemon.directory))

    def start(study: str) -> Session:
        started.append(Session(browser, Running(*words, *run_study(tmp_path, study))))
        started[-1].open_both()
        return started[-1]

    yield start
    for each in started:
        each.close()


TRIALS = 6
HELD_UP_NS = 2_000_000
"""A servo of 1 kHz that left out a period."""

STUDY = """\
experiment: 1
title: Push through
repetitions: 3
instructions: |
  Push **through** the membrane.
base:
  scene:
    objects:
      skin: {kind: membrane, center_m: [0, 0], normal: [0, 1], width_m: 0.08, material: cellophane}
conditions:
  with_vibration: {}
  without_vibration: {changes: {scene: {display: {vibration: false}}}}
trial: {type: motor, question: push, measures: [peak_force_n]}
questions:
  push: {kind: measure, measure: overtravel_m, text: Push through the membrane.}
"""


ANY_MOTION = STUDY.replace("measure: overtravel_m", "measure: path_m")
"""A study whose trials are done whatever the hand did."""


@pytest.mark.parametrize("study", ["okamura1998_tapping", "okamura1998_texture"])
def test_a_participant_taps_with_the_mouse_and_answers_by_key(
    study: str, session: Callable[..., Session], tmp_path: Path
) -> None:
    here = session(study)
    here.begin()
    for _ in range(3):
        assert here.next_question()["kind"] == "trial"
        for surface in (0, 1):
            here.press_on(surface, 0.004)
        here.answer("1")
    here.participant.keyboard.press("Escape")
    here.participant.wait_for_function("() => document.body.dataset.kind === 'over'")
    here.experimenter.wait_for_function("() => hapticd.session.state.doing === 'over'")
    assert here.running.ended()[0] == 1
    answers = [record for record in log_of(tmp_path) if record["kind"] == "answer"]
    assert [record["answer"] for record in answers] == ["first"] * 3
    for trial in range(3):
        (file,) = (tmp_path / SESSION).glob(f"trial-{trial:04d}*.npz")
        assert abs(load(file).samples["force_n"]).max() > 0.05, "the hand felt something"


def test_the_experimenter_sees_the_trial_and_the_answers_and_the_space_bar_ends_the_session(
    session: Callable[..., Session], tmp_path: Path
) -> None:
    here = session("okamura1998_tapping")
    here.experimenter.click("#session-go-on")
    here.participant.wait_for_selector("#go-on")
    here.participant.keyboard.press("Enter")
    here.experimenter.wait_for_function("() => hapticd.session.state.doing === 'armed'")
    here.participant.wait_for_function("() => participant.screen.felt === false")
    here.experimenter.click("#session-go-on")
    here.next_question()
    here.answer("2")
    here.experimenter.wait_for_function("() => document.querySelectorAll('#answers tbody tr').length === 1")
    assert "same" in here.experimenter.inner_text("#answers tbody")
    here.experimenter.fill("#session-note", "took long")
    here.experimenter.press("#session-note", "Enter")
    here.experimenter.wait_for_function("() => document.getElementById('session-note').value === ''")
    here.experimenter.focus("#session-auto")
    here.experimenter.keyboard.press("Space")
    here.participant.wait_for_function("() => document.body.dataset.kind === 'over'")
    assert here.running.ended()[0] == 1
    kinds = [record["kind"] for record in log_of(tmp_path)]
    assert "note" in kinds and kinds[-1] == "aborted"


def test_a_closed_browser_pauses_the_session_until_its_page_is_back(
    session: Callable[..., Session], tmp_path: Path
) -> None:
    here = session("okamura1998_tapping")
    here.begin()
    here.next_question()
    address = here.participant.url
    context = here.participant.context
    here.participant.close()
    here.experimenter.wait_for_function("() => hapticd.session.state.doing === 'paused'")
    here.experimenter.wait_for_function("() => hapticd.safety.forces === 'off'")
    assert "not open" in here.experimenter.inner_text("#session")
    here.participant = context.new_page()
    here.participant.goto(address)
    here.experimenter.wait_for_function("() => hapticd.session.state.here.participant")
    here.experimenter.click("#session-go-on")
    here.next_question()
    here.answer("3")
    here.running.process.send_signal(signal.SIGTERM)
    assert here.running.ended()[0] == 1
    (given,) = [record for record in log_of(tmp_path) if record["kind"] == "answer"]
    assert (given["trial"], given["attempt"], given["answer"]) == (0, 2, "second")


def test_a_break_shows_its_remaining_time_and_that_the_experimenter_is_away(
    session: Callable[..., Session], tmp_path: Path
) -> None:
    study = tmp_path / "pause.yaml"
    study.write_text(ANY_MOTION + "breaks: {every_trials: 1, least_s: 5}\n")
    here = session(str(study))
    here.begin()
    here.next_question()
    here.answer("Enter")
    here.experimenter.wait_for_selector("#session-go-on:disabled")
    pattern = r"/^The break lasts at least 5 s: [1-5] s left\.$/"
    here.experimenter.wait_for_function(f"() => {pattern}.test(document.getElementById('session-wait').textContent)")
    here.experimenter.wait_for_selector("#session-go-on:enabled")
    assert here.experimenter.inner_text("#session-wait") == ""
    address, context = here.experimenter.url, here.experimenter.context
    here.experimenter.close()
    here.participant.wait_for_function("() => document.getElementById('notice').textContent.includes('is away')")
    here.participant.wait_for_selector("#go-on:enabled")
    pause = here.participant.evaluate("() => participant.screen.screen")
    here.participant.keyboard.press("Enter")
    here.experimenter = context.new_page()
    here.experimenter.goto(address)
    # Another press would answer the next question.
    here.participant.wait_for_function(f"() => participant.screen.screen > {pause}")
    assert here.participant.inner_text("#notice") == ""
    assert here.next_question()["number"] == 2  # the press counted as soon as the experimenter was back
    here.running.process.send_signal(signal.SIGTERM)
    assert here.running.ended()[0] == 1


def test_overtravel_of_a_push_with_the_mouse_is_that_of_its_recording(
    session: Callable[..., Session], tmp_path: Path
) -> None:
    study = tmp_path / "study.yaml"
    study.write_text(STUDY)
    here = session(str(study))
    here.begin()
    for _ in range(TRIALS):
        here.next_question()
        here.press_on(0, 0.02, beyond_m=0.005)
        here.answer("Enter")
    here.participant.wait_for_function("() => document.body.dataset.kind === 'over'")
    code, out, _ = here.running.ended()
    assert code == 0 and re.search(f"{TRIALS} of {TRIALS} trials, complete", out)
    answers = [record for record in log_of(tmp_path) if record["kind"] == "answer"]
    assert len(answers) == TRIALS
    pushed_through = 0
    for record in answers:
        (file,) = (tmp_path / SESSION).glob(f"trial-{record['trial']:04d}*.npz")
        found = load(file)
        # Recording and hand continue for a moment after the answer. A measure ends with the answer.
        (answered,) = (mark["tick"] for mark in found.marks if mark["text"] == EventCode.ANSWER.text)
        ruptured = [event for event in found.events if event["event"] == "puncture" and event["tick"] <= answered]
        # A servo that is delayed while the hand passes sees it on one side, then on the other, and no push.
        height_m = found.samples["position_m"][:, 1]
        marked = [(event["event"], event["tick"] - int(found.samples["tick"][0])) for event in found.events]
        assert len(ruptured) == 1 or np.diff(found.samples["time_ns"].astype(np.int64)).max() > HELD_UP_NS, (
            marked,
            height_m[::20].tolist(),
        )
        if len(ruptured) != 1:
            continue
        pushed_through += 1
        after = found.samples[(found.samples["tick"] >= ruptured[0]["tick"]) & (found.samples["tick"] <= answered)]
        # The rupture lies between two ticks: one tick's travel, on a machine that may have missed some.
        at = np.flatnonzero(found.samples["tick"] == ruptured[0]["tick"])[0]
        a_tick_m = np.abs(np.diff(found.samples["position_m"][at - 3 : at + 2, 1])).max()
        # From above or, where a busy machine let the servo miss the moment of touching, on the way back.
        inward = np.sign(after["position_m"][0, 1])
        way_m = (inward * (after["position_m"][:, 1] - after["position_m"][0, 1])).max()
        assert way_m > 0.001
        assert record["answer"] == pytest.approx(way_m, abs=a_tick_m + 1e-9)
    assert pushed_through >= 2


def test_a_mouse_button_that_is_down_when_the_forces_come_on_moves_the_hand(
    session: Callable[..., Session], tmp_path: Path
) -> None:
    """The button was pressed in the previous trial, and is held while the next one is prepared."""
    study = tmp_path / "study.yaml"
    study.write_text(ANY_MOTION)
    here = session(str(study))
    here.experimenter.click("#session-go-on")
    here.experimenter.wait_for_function("() => hapticd.session.state.doing === 'armed'")
    here.experimenter.click("#session-go-on")
    here.next_question()
    over, below = here.places(0, 0.004)
    here.participant.mouse.move(*over)
    here.participant.mouse.down()
    here.answer("Enter")
    here.experimenter.wait_for_function("() => hapticd.session.state.doing === 'armed'")
    here.participant.wait_for_function("() => participant.screen.number === 2 && !participant.screen.felt")
    here.experimenter.click("#session-go-on")
    here.next_question()
    here.participant.mouse.move(*below, steps=8)
    here.touches(0)
    here.participant.mouse.up()
    here.answer("Enter")
    here.running.process.send_signal(signal.SIGTERM)
    assert here.running.ended()[0] == 1


def test_forces_wait_until_the_stylus_is_out_of_the_membrane(session: Callable[..., Session], tmp_path: Path) -> None:
    """The stylus broke the membrane of the previous trial, and is below the place of the next one."""
    study = tmp_path / "study.yaml"
    study.write_text(STUDY)
    here = session(str(study))
    here.begin()
    here.next_question()
    over, below = here.places(0, 0.02)
    here.participant.mouse.move(*over)
    here.participant.mouse.down()
    here.participant.mouse.move(*below, steps=30)
    here.touches(0, 0.005)
    here.answer("Enter")
    here.participant.wait_for_function("() => participant.screen.number === 2 && participant.screen.withdraws")
    here.experimenter.wait_for_function("() => hapticd.session.state.doing === 'withdraws'")
    here.participant.mouse.move(*over, steps=30)
    assert here.next_question()["number"] == 2
    here.participant.mouse.up()
    here.running.process.send_signal(signal.SIGTERM)
    assert here.running.ended()[0] == 1
    (file,) = (tmp_path / SESSION).glob("trial-0001*.npz")
    found = load(file)
    on = found.samples["flags"] & Flag.FORCES_ON != 0
    assert on.any() and found.samples["position_m"][on, 1].min() >= 0.0
    first = found.samples["tick"][on][0]
    assert not any(event["event"] == "puncture" and event["tick"] >= first for event in found.events)
