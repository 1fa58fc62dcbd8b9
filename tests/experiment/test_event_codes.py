"""Event codes: which codes a session sends, their data, and what other programs read."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from hapticd.base.errors import HapticdError
from hapticd.experiment.daemon_stage import DaemonStage
from hapticd.experiment.event_codes import EventCode, code_of
from hapticd.experiment.front import Command
from tests.experiment.sessions import STAIRCASE, STUDY, NotedStage, ScriptedFront, planned, resumed, started
from tests.support.daemon_process import connect, running_daemon

DOCUMENT = Path(__file__).parents[2] / "docs" / "reference" / "studies.md"
SESSION = Path("sub-P07/ses-01")


def _codes(stage: NotedStage) -> list[int]:
    return [data["code"] for _, data in stage.marks]


def test_codes_fit_a_trigger_line_and_the_document_has_their_table() -> None:
    assert all(0 < code < 256 for code in EventCode)
    rows = re.findall(r"^\| (\d+) \| `(\w+)` \| (.+) \|$", DOCUMENT.read_text(), re.M)
    assert [(int(number), text) for number, text, _ in rows] == [(int(code), code.text) for code in EventCode]
    assert [meaning for *_, meaning in rows] == [code.meaning for code in EventCode]


def test_each_interval_has_its_number(tmp_path: Path) -> None:
    """Trials have two intervals. The numbers are those of the table in docs/reference/studies.md."""
    stage = NotedStage()
    assert started(tmp_path, stage, ScriptedFront(), STAIRCASE).run() == "ended"
    answered = {data["trial"] for _, data in stage.marks if data["code"] == 14}
    codes = _codes(stage)
    assert codes == [1, *([10, 11, 12, 11, 13, 12, 14] * len(answered)), 3]
    assert [data["interval"] for _, data in stage.marks if "interval" in data] == [1, 1, 2, 2] * len(answered)
    assert len(answered) > 1


def test_breaks_pauses_and_repetitions_have_codes(tmp_path: Path) -> None:
    stage, front = NotedStage(), ScriptedFront()
    front.commands = {"ask": [Command("repeat"), Command("pause")]}
    study = {**STUDY, "breaks": {"every_trials": 4}}
    assert started(tmp_path, stage, front, study).run() == "ended"
    one = [10, 11, 13, 12, 14]
    assert _codes(stage) == [1, 10, 11, 15, 10, 11, 15, 30, 31, *(one * 4), 20, 21, *(one * 2), 3]
    order = [trial.index for trial in planned(study).trials]
    assert [data["trial"] for _, data in stage.marks if data["code"] == 14] == order
    assert [data["attempt"] for _, data in stage.marks if data["code"] == 10] == [1, 2, 3, 1, 1, 1, 1, 1]


def test_aborted_and_resumed_sessions_have_codes(tmp_path: Path) -> None:
    stage, front = NotedStage(), ScriptedFront()
    front.commands = {"ask": [Command("abort")]}
    assert started(tmp_path, stage, front).run() == "aborted"
    assert _codes(stage) == [1, 10, 11, 4]

    def fails(done: str) -> None:
        if done == "enable":
            raise HapticdError("another client changed the scene")

    stage = NotedStage(fails)
    with pytest.raises(HapticdError, match="another client"):
        resumed(tmp_path / SESSION, stage, ScriptedFront()).run()
    assert _codes(stage) == [2, 10, 4]


def test_marks_hold_numbers_alone(tmp_path: Path) -> None:
    stage = NotedStage()
    started(tmp_path, stage, ScriptedFront()).run()
    for text, data in stage.marks:
        assert text == EventCode(data["code"]).text
        assert set(data) <= {"code", "trial", "attempt", "interval"}
        assert all(type(value) is int for value in data.values())


@pytest.mark.long
def test_any_client_reads_the_codes_of_a_session_on_a_daemon(tmp_path: Path) -> None:
    """Another client receives every code of a session, in order."""
    servo = tmp_path / "servo.yaml"
    servo.write_text("servo: {rate_hz: 1000, realtime: off, overruns: {threshold: 1}}\n")
    with (
        running_daemon("-c", str(servo)) as daemon,
        connect(daemon.directory) as client,
        connect(daemon.directory) as other,
        other.events() as events,
    ):
        with DaemonStage(client) as stage:
            assert started(tmp_path, stage, ScriptedFront()).run() == "ended"
        found: list[dict[str, Any]] = []
        while not found or found[-1]["code"] != 3:
            event = next(events)
            if event["event"] == "mark" and code_of(event) is not None:
                found.append(event["data"])  # type: ignore[arg-type]
    assert [data["code"] for data in found] == [1, *([10, 11, 13, 12, 14] * 6), 3]
    assert not any(name in json.dumps(found) for name in ("wood", "delrin", "steel", "left", "right"))


def test_a_code_is_read_of_a_sessions_mark_alone() -> None:
    mark = {"event": "mark", "text": "answer", "data": {"code": 13, "trial": 3, "attempt": 1}}
    assert code_of(mark) is EventCode.ANSWER
    assert code_of({"event": "contact", "object": "left"}) is EventCode.CONTACT
    for other in (
        {**mark, "text": "interval"},
        {**mark, "data": None},
        {**mark, "data": [13]},
        {**mark, "data": {"code": 13.0}},
        {**mark, "data": {"code": True}},
        {**mark, "data": {"code": 99}},
        {**mark, "text": "contact", "data": {"code": 101}},
        {"event": "answer", "data": {"code": 13}},
        {"event": "revision", "revision": 3},
    ):
        assert code_of(other) is None
