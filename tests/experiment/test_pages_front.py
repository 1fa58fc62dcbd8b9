"""The content of the pages of a session, without a server: screens, console, presence, stylus."""

from __future__ import annotations

import json
import re
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hapticd.base.errors import HapticdError
from hapticd.experiment.front import Choice, Command, Seen, Shown
from hapticd.experiment.pages import screens
from hapticd.experiment.pages.pages_front import PagesFront
from hapticd.experiment.pages.participant_page import drawn_at
from hapticd.experiment.pages.presence import Presence
from tests.experiment.sessions import STUDY, NotedStage, planned, resumed, started
from tests.support.daemon_process import PATIENCE_S

LEFT = Seen((-0.03, -0.01), (0.0, 1.0), 0.025)
RIGHT = Seen((0.03, -0.01), (0.0, 1.0), 0.025)
SHOWN = Shown(
    number=1,
    total=6,
    at_most=False,
    phase="test",
    stimuli=2,
    in_places=True,
    surfaces=(LEFT, RIGHT),
    text="Which is stiffer?",
    kind="choice",
    answers=(Choice("wood", "The left one", "1", "first"), Choice("steel", "The right one", None, "second")),
)


# ---- Screens ------------------------------------------------------------------------------------------


def test_a_screen_of_a_trial_has_labels_and_keys_and_no_name_of_an_answer() -> None:
    screen = screens.trial(SHOWN, interval=2, felt=True, asks=True)
    question: Any = screen["question"]
    assert question["answers"] == [{"label": "The left one", "key": "1"}, {"label": "The right one", "key": "2"}]
    text = json.dumps(screen)
    assert "wood" not in text and "steel" not in text
    assert (screen["total"], screen["at_most"]) == (6, False)


def test_instructions_are_html_without_scripts() -> None:
    made = str(screens.read("**Tap** both. <script>alert(1)</script> [here](javascript:alert(1))", None)["html"])
    assert "<strong>Tap</strong>" in made
    assert "<script" not in made and 'href="javascript' not in made


# ---- The stylus ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("depth_m", [1e-6, 1e-3, 0.01])
def test_a_stylus_that_touches_is_drawn_on_the_surface_however_deep_it_presses(depth_m: float) -> None:
    x, y = drawn_at((-0.03, -0.01 - depth_m), True, (LEFT, RIGHT))
    assert (x, y) == (-0.03, pytest.approx(-0.01, abs=1e-15))


@pytest.mark.parametrize("x_m", [-0.2, -0.0551, -0.0055, -0.004, 0.0, 0.006, 0.3])
def test_no_depth_is_seen_at_the_ends_of_a_surface_or_beyond(x_m: float) -> None:
    assert drawn_at((x_m, -0.02), True, (LEFT, RIGHT)) == (x_m, pytest.approx(-0.01, abs=1e-15))


@pytest.mark.parametrize("place", [(-0.03, 0.0), (0.0, -0.05), (-0.03, -0.02)])
def test_a_stylus_that_touches_nothing_is_drawn_where_it_is(place: tuple[float, float]) -> None:
    assert drawn_at(place, False, (LEFT, RIGHT)) == place


# ---- Presence ------------------------------------------------------------------------------------------


def test_a_page_is_here_until_it_was_not_heard_for_so_long_or_closed() -> None:
    now, changes = [0.0], []
    presence = Presence(changes.append, away_s=3.0, now=lambda: now[0])
    presence.beat("a")
    presence.beat("b")
    now[0] = 2.0
    presence.beat("b")
    now[0] = 4.0
    presence.sweep()
    assert presence.here and changes == [True]
    presence.leave("b")
    presence.leave("b")
    assert not presence.here and changes == [True, False]


# ---- A session with a front whose pages a script plays ----------------------------------------


class Played:
    """A PagesFront to which `says` sends messages after each change, in the thread of the change."""

    def __init__(self, says: Callable[[PagesFront], None]) -> None:
        self._says, self._busy = says, False
        self.front = PagesFront(planned(STUDY), self._changed)

    def _changed(self) -> None:
        if not self._busy and hasattr(self, "front"):
            self._busy = True
            try:
                self._says(self.front)
            finally:
                self._busy = False


def _willing(front: PagesFront) -> None:
    """Press every button to continue, and give the first answer."""
    console, screen = front.console(), front.screen
    for who in ("participant", "experimenter"):
        if not console["here"][who]:
            front.here(who, True)  # type: ignore[arg-type]
    front.go_on("experimenter", console["screen"])
    if screen.get("question") is not None:
        front.answer(int(str(screen["screen"])), 0)


def test_a_session_runs_to_its_end_and_the_console_has_every_answer(tmp_path: Path) -> None:
    played = Played(_willing)
    stage = NotedStage()
    session = started(tmp_path, stage, played.front)
    played.front.opened([])
    assert session.run() == "ended"
    console = played.front.console()
    assert console["done"] == console["answers"] == len(played.front.rows()) == console["total"] == 6
    assert {row["answer"] for row in played.front.rows()} == {"first"}
    assert [row["trial"] for row in played.front.rows(since=4)] == [4, 5]


def test_the_participants_page_gets_no_name_of_a_material_in_a_complete_session(tmp_path: Path) -> None:
    seen: list[str] = []

    def watched(front: PagesFront) -> None:
        seen.append(json.dumps(front.screen))
        _willing(front)

    assert started(tmp_path, NotedStage(), Played(watched).front).run() == "ended"
    assert len(seen) > 12
    for name in ("wood", "delrin", "steel"):
        assert not [each for each in seen if name in each]


def test_a_page_that_goes_while_the_forces_are_on_pauses_the_trial_and_it_begins_again(tmp_path: Path) -> None:
    left = []

    def once_away(front: PagesFront) -> None:
        if not left and front.screen.get("felt"):
            left.append(front.console()["trial"]["index"])
            front.here("participant", False)
            return
        _willing(front)

    played = Played(once_away)
    stage = NotedStage()
    assert started(tmp_path, stage, played.front).run() == "ended"
    assert played.front.console()["lines"] == ["paused: the participant's page is away"]
    assert stage.done.count("enable") == 7  # six trials, one of them twice
    records = [json.loads(line) for line in (tmp_path / "sub-P07/ses-01/log.jsonl").read_text().splitlines()]
    given_up = [each for each in records if each["kind"] == "trial_given_up"]
    assert [(each["trial"], each["because"]) for each in given_up] == [(left[0], "pause")]
    assert "paused" in [each["kind"] for each in records]


def test_an_answer_to_a_screen_that_is_over_counts_for_nothing(tmp_path: Path) -> None:
    numbers: list[int] = []

    def twice(front: PagesFront) -> None:
        for old in numbers:
            front.answer(old, 2)
            front.go_on("experimenter", old)
        if front.screen.get("question") is not None:
            numbers.append(int(str(front.screen["screen"])))
        _willing(front)

    played = Played(twice)
    assert started(tmp_path, NotedStage(), played.front).run() == "ended"
    assert [row["answer"] for row in played.front.rows()] == ["first"] * 6


def test_the_stop_of_the_participant_ends_the_session_which_can_be_resumed(tmp_path: Path) -> None:
    def stops(front: PagesFront) -> None:
        if front.console()["done"] == 2 and front.screen.get("felt"):
            front.command(Command("abort", "the participant pressed the stop"))
        else:
            _willing(front)

    assert started(tmp_path, NotedStage(), Played(stops).front).run() == "aborted"
    played = Played(_willing)
    again = resumed(tmp_path / "sub-P07/ses-01", NotedStage(), played.front)
    assert again.run() == "ended"
    assert [row["trial"] for row in played.front.rows()] == [2, 3, 4, 5]


def test_trials_that_begin_by_themselves_wait_for_a_page_that_is_away() -> None:
    changed = threading.Event()
    front = PagesFront(planned(STUDY), changed.set)
    front.set_auto(True)
    front.here("experimenter", True)
    results: list[Command | None] = []
    watched: Any = type("Watched", (), {})()
    thread = threading.Thread(target=lambda: results.append(front.ready(SHOWN, watched)))
    thread.start()
    assert changed.wait(PATIENCE_S)
    assert not results
    front.here("participant", True)
    thread.join(PATIENCE_S)
    assert results == [None]


@pytest.mark.parametrize("answer", [-1, 2, True, "0", None, 0.5])
def test_an_invalid_answer_is_refused(answer: object) -> None:
    front = PagesFront(planned(STUDY), lambda: None)
    front._show(screens.trial(SHOWN, interval=1, felt=True, asks=True), "felt", None, SHOWN)
    with pytest.raises(ValueError, match="answer: must be an integer from 0 to 1"):
        front.answer(1, answer)


def test_texts_beyond_their_length_are_refused() -> None:
    shown = Shown(1, 1, False, "test", 1, True, (LEFT,), "How was it?", "text", most_characters=5)
    front = PagesFront(planned(STUDY), lambda: None)
    front._show(screens.trial(shown, interval=1, felt=True, asks=True), "felt", None, shown)
    front.answer(1, "short")
    with pytest.raises(ValueError, match="the text has 6 characters, must have at most 5"):
        front.answer(1, "longer")


def test_a_note_changes_nothing_that_the_participant_sees(tmp_path: Path) -> None:
    numbers: list[object] = []

    def notes(front: PagesFront) -> None:
        if front.screen.get("question") is not None and len(numbers) < 3:
            numbers.append(front.screen["screen"])
            front.command(Command("note", "hums"))
        _willing(front)  # the answer to the screen before the note counts

    assert started(tmp_path, NotedStage(), Played(notes).front).run() == "ended"
    records = [json.loads(line) for line in (tmp_path / "sub-P07/ses-01/log.jsonl").read_text().splitlines()]
    assert [each["text"] for each in records if each["kind"] == "note"] == ["hums"] * 3


def test_an_answer_without_a_key_has_its_number() -> None:
    shown = Shown(
        1, 1, False, "test", 1, True, (LEFT,), "?", "choice",
        answers=(Choice("a", "A", "x", None), Choice("b", "B", None, None), Choice("c", "C", None, None)),
    )  # fmt: skip
    question: Any = screens.trial(shown, interval=1, felt=True, asks=True)["question"]
    assert [each["key"] for each in question["answers"]] == ["x", "2", "3"]


def test_feedback_on_a_trial_is_on_the_next_screen_that_is_felt(tmp_path: Path) -> None:
    feedbacks: dict[object, object] = {}

    def record(front: PagesFront) -> None:
        if front.screen.get("felt"):
            feedbacks[front.screen["screen"]] = front.screen["told"]
        _willing(front)

    front = Played(record).front
    front.feedback("Correct.", "wood")
    front.set_auto(True)
    assert started(tmp_path, NotedStage(), front).run() == "ended"
    first, *later = feedbacks.values()
    assert first == "Correct." and len(later) == 5 and not any(later)


def test_an_experimenter_who_continues_before_the_end_of_a_break_reads_the_remaining_time() -> None:
    over = Command("abort", "over")

    def hurried(front: PagesFront) -> None:
        if front.console()["lines"]:
            front.command(over)
        elif front.console()["doing"] == "rests":
            front.go_on("experimenter", int(str(front.screen["screen"])))

    front = Played(hurried).front
    assert front.rest(None, 3600.0) == over
    assert re.fullmatch(r"The break lasts at least 3600 s: 3[56]\d\d s left", *front.console()["lines"])


def test_both_pages_have_the_time_that_is_left_of_a_break_whenever_they_are_opened() -> None:
    seen: list[tuple[Any, Any]] = []

    def press(front: PagesFront) -> None:
        if front.console()["doing"] == "rests":
            seen.append((front.console(), front.screen))
            front._until_s -= 1000.0  # as if 1000 s had passed
            seen.append((front.console(), front.screen))
            front.command(Command("abort", "over"))

    front = Played(press).front
    assert front.console()["least_s"] == front.console()["left_s"] == 0.0
    front.rest(None, 3600.0)
    for (console, screen), left_s in zip(seen, (3600.0, 2600.0), strict=True):
        assert console["least_s"] == 3600.0
        assert 0.0 <= left_s - console["left_s"] < PATIENCE_S
        assert 0.0 <= left_s - screen["least_s"] < PATIENCE_S


def test_a_server_that_is_stuck_is_a_pause(monkeypatch: pytest.MonkeyPatch) -> None:
    front = PagesFront(planned(STUDY), lambda: None)
    front.here("participant", True)
    front.here("experimenter", True)
    front.server_runs()
    assert front.may_enable() is None
    front._server_s = -1e9  # long ago
    assert front.may_enable() == Command("pause", "paused: the pages' server is away")


def test_a_lost_stage_is_reported() -> None:
    class Lost(NotedStage):
        def check(self) -> None:
            raise HapticdError("the daemon is gone")

    front = PagesFront(planned(STUDY), lambda: None)
    front.here("participant", True)
    front.here("experimenter", True)
    with pytest.raises(HapticdError, match="the daemon is gone"):
        front.ask(SHOWN, Lost())


def test_a_press_of_the_participant_takes_effect_when_the_experimenter_is_back() -> None:
    notices: list[str] = []

    def presses(front: PagesFront) -> None:
        number = int(str(front.screen["screen"]))
        if front.console()["doing"] != "reads":
            return
        if not front.console()["lines"]:
            notices.append(front.notice)
            front.go_on("participant", number)
        elif not front.console()["here"]["experimenter"]:
            front.here("experimenter", True)
            notices.append(front.notice)

    front = Played(presses).front
    front.here("participant", True)
    assert front.phase("practice", "Read this.") is None
    assert front.console()["lines"] == ["the experimenter's page must be open to continue"]
    away, back = notices
    assert "The experimenter is away" in away and back == ""


@pytest.mark.parametrize("who", ["participant", "experimenter"])
def test_a_press_of_a_participant_who_left_does_not_count(who: Any) -> None:
    """A press while a page is away takes effect later only if the participant pressed, and stayed present."""
    over = Command("abort", "over")

    def presses(front: PagesFront) -> None:
        number = int(str(front.screen["screen"]))
        if front.console()["doing"] != "reads":
            return
        match front.console()["lines"]:
            case []:
                front.go_on(who, number)
            case [_]:
                front.here("participant", False)
                front.go_on(who, number)
            case [_, line]:
                assert line == "the participant's page and the experimenter's page must be open to continue"
                front.here("experimenter", True)
                front.here("participant", True)
                front.command(over)

    front = Played(presses).front
    front.here("participant", True)
    assert front.phase("practice", "Read this.") == over
