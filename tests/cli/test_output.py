"""Output of commands: text, JSON, and the error of a failed command."""

from __future__ import annotations

import io
import json
import sys
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import Any, cast

import msgpack
import pytest

from hapticd.base.core import Fault, HidMeaning, SignsProblem, SignsState
from hapticd.base.errors import HapticdError, InvalidError, Problem, in_order
from hapticd.cli import main
from hapticd.cli.common import print_result
from hapticd.cli.failure import report_error
from hapticd.client.sources import patch_tree
from hapticd.daemon.counters import Granted
from hapticd.daemon.status_text import FAULT_REASONS, lines, text_of
from hapticd.hid.device_texts import LET_GO
from hapticd.hid.signs import SignsStatus
from hapticd.protocol.calls import DaemonNotRunning, RemoteError, result_of
from hapticd.protocol.events import fault_names
from hapticd.protocol.messages import Code
from hapticd.protocol.results import Status
from tests.support.cli import said
from tests.support.fake_daemon import fake_daemon

# ---- status ----------------------------------------------------------------------------------------------------------


def status(**changes: object) -> Status:
    histogram = {"edges": [1000, 2000], "counts": [0, 10, 0], "sum": 15000, "max": 1_500_000}
    plain: dict[str, Any] = {
        "version": "1.2.3",
        "protocol": 1,
        "state": "running",
        "device": "sim",
        "connection": None,
        "rate_hz": 10_000.0,
        "realtime": Granted("fifo", 80, 3, "process", True, ()).to_dict(),
        "revision": 1234,
        "tick": 98_766,
        "forces": "on",
        "faults": [],
        "lease_s": None,
        "counters": {"skipped": 0, "overruns": 0, "samples_dropped": 0, "events_dropped": 0, "strikes": 12_340},
        "overruns": {"threshold": 0.1, "action": "warn", "missed_share": 0.0123, "configured_rate_hz": 10_000.0},
        "histograms": {"lateness_ns": histogram},
        "flight": {"seconds": 10.0, "written": 1, "directory": "/var/lib/hapticd", "problem": None},
        "undisplayable": [],
        "warnings": [],
        "offload": [],
    }
    return cast(Status, {**plain, **changes})


def test_the_status_of_a_daemon_without_problems() -> None:
    assert text_of(list(lines(status()))).splitlines() == [
        "forces           on",
        "real time        SCHED_FIFO 80, processor 3, all memory locked, idle states held off",
        "periods          98,766 ticks, none missed",
        "device           sim at 10 kHz",
        "scene            revision 1,234",
        "lease            none",
        "lateness         median 1.5 us, 99 % within 1.99 us, longest 1.5 ms",
        "strikes          12,340",
        "telemetry        nothing dropped",
        "flight recorder  the last 10 s; 1 file written to /var/lib/hapticd",
        "daemon           hapticd 1.2.3, protocol 1, running",
    ]


def test_problems_come_first_with_their_remedies() -> None:
    refused = Granted("other", 0, None, "none", False, ("SCHED_FIFO priority 80: Operation not permitted",))
    counters = {"skipped": 1234, "overruns": 1, "samples_dropped": 1, "events_dropped": 0}
    faulted = status(
        forces="faulted", faults=["device", "lease"], realtime=refused.to_dict(), counters=counters, rate_hz=5000.0
    )
    assert text_of(list(lines(faulted))).splitlines()[:9] == [
        "forces           off by a fault: the device does not report and a lease lapsed",
        "                 `hapticd force on` turns them on again once the cause has ended",
        "real time        no priority, any processor, no memory locked, idle states as they are",
        "                 not granted: SCHED_FIFO priority 80: Operation not permitted",
        "                 `hapticd doctor` says how to grant it",
        "periods          98,766 ticks; 1,234 missed (1.23 %), 1 time",
        "                 1.23 % of the last second's; above 10 %: warn",
        "device           sim at 5 kHz, stepped down from 10 kHz",
        "scene            revision 1,234",
    ]
    assert ("telemetry", "1 sample and 0 events dropped") in list(lines(faulted))
    assert ("forces", "off, by a command or since the start: `hapticd force on` turns them on") in list(
        lines(status(forces="off"))
    )


def test_the_status_counts_the_messages_of_streams() -> None:
    streams = {"target": {"received": 0}, "force": {"received": 300, "used": 222, "timeouts": 12, "active": False}}
    shown = dict(lines(status(streams=streams)))
    assert shown["force stream"] == "ended: 300 messages received, 222 used; timed out 12 times"
    assert "target stream" not in shown


POWERLESS = 1 << (HidMeaning.POWER - 1)


def with_signs(
    forces: str, word: SignsState, problem: SignsProblem = SignsProblem.FINE, idle: int = 0
) -> list[tuple[str, str]]:
    connection = {
        "name": None,
        "state": "connected",
        "problem": None,
        "link_hz": None,
        "report_hz": None,
        "force_hz": None,
        "states": {},
        "resets": 0,
        "signs": SignsStatus(word, problem, "x", idle).to_dict(),
    }
    faults = ["signs"] if forces == "faulted" else []
    return list(lines(status(forces=forces, faults=faults, connection=connection)))


def test_the_status_has_the_check_of_signs_and_the_remedy() -> None:
    shown = with_signs("on", SignsState.CHECKING)
    assert shown[0] == ("forces", "on, but held back while the signs of the device are checked")
    assert ("signs", "checking") in shown
    shown = with_signs("on", SignsState.WAITING, SignsProblem.CONTACT)
    advice = f"the handle touches an object of the scene: move it away, then {LET_GO}"
    assert ("signs", f"waiting: {advice}") in shown
    shown = with_signs("on", SignsState.WAITING, SignsProblem.IDLE, POWERLESS)
    assert shown[0] == ("forces", "on, but held back while the device exerts none")
    advice = SignsStatus(SignsState.WAITING, SignsProblem.IDLE, "x", POWERLESS).line()
    assert ("signs", f"waiting: {advice}") in shown
    shown = with_signs("on", SignsState.RIGHT)
    assert shown[0] == ("forces", "on") and ("signs", "right") in shown
    shown = with_signs("faulted", SignsState.WRONG, SignsProblem.SWAPPED)
    assert shown[:2] == [
        ("forces", "off by a fault: the signs of the device are not known"),
        (
            "",
            "a force along x moves the handle along y: run `hapticd devices calibrate` to find device.hid.force_axes, "
            "or set device.hid.signs: trust without device_version to skip the check",
        ),
    ]
    assert ("signs", "wrong") in shown


def test_force_on_reports_a_pending_check_of_signs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    signs = SignsStatus(SignsState.CHECKING, SignsProblem.FINE, "x").to_dict()
    powerless = SignsStatus(SignsState.WAITING, SignsProblem.IDLE, "x", POWERLESS).to_dict()
    wrong = SignsStatus(SignsState.WRONG, SignsProblem.REVERSED, "x").line()
    answers: list[Any] = [
        {"result": {"forces": "on", "tick": 1, "signs": signs}},
        {"result": {"forces": "on", "tick": 1, "signs": powerless}},
        {"error": {"code": -32003, "message": f"forces are off because {wrong}", "data": {"faults": ["signs"]}}},
    ]

    def answer(request: dict[str, Any]) -> list[bytes]:
        return [msgpack.packb({"jsonrpc": "2.0", "id": request["id"], **answers.pop(0)})]

    with fake_daemon(tmp_path, answer):
        assert main(["--runtime-dir", str(tmp_path), "force", "on"]) == 0
        assert capsys.readouterr().out == f"forces on, once the check of signs has passed: {LET_GO}\n"
        assert main(["--runtime-dir", str(tmp_path), "force", "on"]) == 0
        assert capsys.readouterr().out == (
            "forces on, but held back: the device exerts no force because its actuators have no power: "
            "plug the power supply in (or release its emergency stop)\n"
        )
        assert main(["--runtime-dir", str(tmp_path), "force", "on"]) == 1
        assert capsys.readouterr().err == (
            "hapticd: forces are off because a force along x moves the handle the other way: "
            "run `hapticd devices calibrate` to find device.hid.force_axes, "
            "or set device.hid.signs: trust without device_version to skip the check\n"
        )


def test_every_fault_has_a_reason() -> None:
    assert [fault_names(fault)[0] for fault in Fault] == [*FAULT_REASONS]


# ---- failures --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("error", "code", "message", "problems"),
    [
        (HapticdError("no\nway"), None, "no way", []),
        (DaemonNotRunning("nobody"), -32009, "nobody", []),
        (
            InvalidError([Problem("a.yaml:3: scene", "is missing")]),
            -32602,
            "a.yaml:3: scene: is missing",
            [{"where": "a.yaml:3: scene", "problem": "is missing"}],
        ),
        (
            RemoteError(Code.INVALID_PARAMS, "x", [{"where": "mode", "problem": "must be a mapping"}]),
            -32602,
            "mode: must be a mapping",
            [{"where": "mode", "problem": "must be a mapping"}],
        ),
        (OSError(5, "Input/output error", "x.npz"), None, "x.npz: Input/output error", []),
    ],
)
def test_a_failure_as_json(
    error: Exception, code: int | None, message: str, problems: object, capsys: pytest.CaptureFixture[str]
) -> None:
    assert report_error(error, as_json=True) == 1
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.count("\n") == 1
    assert json.loads(captured.err) == {
        "error": {"message": message, "code": code, "exit_code": 1, "problems": problems}
    }
    assert report_error(error, as_json=False) == 1
    assert capsys.readouterr().err == f"hapticd: {message}\n"


WITH_JSON = [
    ["status"],
    ["reload"],
    ["scene", "get"],
    ["scene", "set", "scene.yaml"],
    ["material", "set", "none.yaml"],
    ["apply", "scene.yaml"],
    ["mark", "trial 3"],
    ["play", "wood", "--amplitude", "1"],
    ["force", "on"],
    ["reset"],
    ["watch"],
    ["record", "x.npz"],
    ["record", "--recover", "x.npz"],
    ["record", "--past", "x.npz"],
    ["replay", "none.npz"],
    ["simulate", "none.yaml", "--operator", "none.yaml", "-o", "x.npz"],
    ["check", "-c", "none.yaml"],
    ["devices", "parse", "none.hex"],
    ["devices", "dump", "none", "-o", "x.yaml"],
    ["devices", "calibrate", "-c", "none.yaml"],
    ["calibrate", "-c", "none.yaml"],
    ["verify", "-c", "none.yaml"],
    ["fit", "tap", "none.csv"],
    ["fit", "synthesize", "tap", "--material", "none", "-o", "x.npz"],
]


@pytest.mark.parametrize("arguments", WITH_JSON, ids=" ".join)
def test_every_command_fails_in_json_with_the_option_json(
    arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("scene.yaml").write_text("objects: {}\n")
    place = ["--runtime-dir", str(tmp_path)]
    assert said(capsys, 1, *place, *arguments, "--json") == said(capsys, 1, *place, *arguments)
    # A usage error is JSON, too.
    assert "--nonsense" in said(capsys, 2, *place, *arguments, "--json", "--nonsense")


def test_with_json_nothing_but_an_error_is_on_stderr(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Without a daemon the materials are the shipped ones, and a note says so, except with --json."""
    place = ["--runtime-dir", str(tmp_path)]
    assert main([*place, "material", "get", "wood"]) == 0
    assert "shipped" in capsys.readouterr().err
    assert main([*place, "material", "get", "wood", "--json"]) == 0
    captured = capsys.readouterr()
    assert list(json.loads(captured.out)["materials"]) == ["wood"] and captured.err == ""
    assert "unknown material" in said(capsys, 1, *place, "material", "get", "none", "--json")


class Terminal(io.StringIO):
    """A standard error stream that is a terminal."""

    def isatty(self) -> bool:
        return True


def test_on_a_terminal_each_fault_has_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    problems = [Problem(f"s.yaml:{line}:1: ramp_s", "is\nnegative") for line in (10, 9)]
    for error in (
        InvalidError(problems),
        RemoteError(Code.INVALID_PARAMS, "", [asdict(problem) for problem in in_order(problems)]),
    ):
        terminal, pipe = Terminal(), io.StringIO()
        for stream in (terminal, pipe):
            monkeypatch.setattr("sys.stderr", stream)
            assert report_error(error, as_json=False) == 1
        nine, ten = (f"s.yaml:{line}:1: ramp_s: is negative" for line in (9, 10))
        assert terminal.getvalue() == f"hapticd: {nine}\nhapticd: {ten}\n"
        if type(error) is RemoteError:
            assert pipe.getvalue() == f"hapticd: {nine}; {ten}\n"
    monkeypatch.setattr("sys.stderr", Terminal())
    report_error(InvalidError(problems), as_json=True)
    assert isinstance(sys.stderr, Terminal)
    assert [each["where"] for each in json.loads(sys.stderr.getvalue())["error"]["problems"]] == [
        "s.yaml:9:1: ramp_s",
        "s.yaml:10:1: ramp_s",
    ]


def test_faults_found_by_the_daemon_have_lines(tmp_path: Path) -> None:
    file = tmp_path / "s.yaml"
    file.write_text("b: {kind: wall}\na: {kind: wall}\n")
    params = {"objects": patch_tree(file, "objects")}
    found = [{"where": f"objects.{id}.point_m", "problem": "is missing"} for id in ("a", "b", "c")]
    with pytest.raises(RemoteError) as caught:
        result_of(RemoteError(Code.INVALID_PARAMS, "", found), params)
    assert [problem.where for problem in caught.value.problems] == [
        f"{file}:1:1: b.point_m",
        f"{file}:1:1: c.point_m",
        f"{file}:2:1: a.point_m",
    ]


# ---- warnings --------------------------------------------------------------------------------------------------------


def test_warnings_of_a_result(capsys: pytest.CaptureFixture[str]) -> None:
    result = {
        "revision": 2,
        "warning": "forces are off",
        "warnings": [{"where": "materials.x.tap", "problem": "50 kHz is above 0.4 of the rate"}],
    }
    print_result(result, as_json=False, text="revision 2")
    captured = capsys.readouterr()
    assert captured.out == "revision 2\n"
    assert captured.err.splitlines() == [
        "hapticd: warning: forces are off",
        "hapticd: warning: materials.x.tap: 50 kHz is above 0.4 of the rate",
    ]
    print_result(result, as_json=True, text="revision 2")
    captured = capsys.readouterr()
    assert (json.loads(captured.out), captured.err) == (result, "")


# ---- the log ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "level"),
    [
        ([], "info"),
        (["-q"], "warning"),
        (["-v"], "debug"),
        (["--log-level", "error"], "error"),
        (["-q", "--log-level", "info"], "info"),
    ],
)
def test_options_select_the_log_level(
    options: list[str], level: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    given: list[object] = []
    monkeypatch.setattr("hapticd.daemon.process.run", lambda *words: given.append(words[2]) or 0)
    monkeypatch.setattr("gc.disable", lambda: None)
    assert main(["run", *options]) == 0
    assert given == [level]


def test_force_off_reports_a_latched_fault(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    from hapticd.cli import daemon

    class Faulted:
        def set_forces(self, enabled: bool) -> dict[str, object]:
            return {"forces": "faulted", "tick": 7}

    monkeypatch.setattr(daemon, "daemon", lambda: nullcontext(Faulted()))
    assert main(["force", "off"]) == 0
    assert capsys.readouterr().out == "forces off: a fault is latched; see `hapticd status`\n"
