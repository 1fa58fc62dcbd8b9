"""The command line without a daemon: commands, help, usage errors and lost output."""

from __future__ import annotations

import csv
import json
import os
import re
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticd import __version__
from hapticd.base.yaml_source import load_text
from hapticd.base.yaml_text import yaml_text
from hapticd.cli import main
from hapticd.cli.common import duration
from hapticd.config.materials import shipped_materials
from tests.support.cli import said
from tests.support.marks import rest_slow

ROOT = Path(__file__).parents[2]
SCENE = "objects:\n  floor: {kind: wall, point_m: [0, 0], normal: [0, 1], material: wood}\n"
WAYPOINTS = "waypoints: [[0, 0, 0.01], [0.05, 0, -0.002], [0.1, 0, 0.01]]\n"
COMMANDS = [
    "run",
    "status",
    "scene",
    "material",
    "apply",
    "play",
    "force",
    "reset",
    "operator",
    "mark",
    "watch",
    "record",
    "simulate",
    "check",
    "devices",
    "calibrate",
    "verify",
    "fit",
    "doctor",
    "install-service",
]
HIDDEN = ["bench", "completion", "paths", "schema", "stop-device"]
SECTIONS = ["Daemon:", "Scene:", "Observe and record:", "Offline:", "Studies:", "Device:", "Machine:"]


@pytest.fixture(autouse=True)
def _nowhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.chdir(tmp_path)


def test_help_names_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in ([], ["--help"], ["-h"]):
        assert main(arguments) == 0
        out = capsys.readouterr().out
        assert all(out.count(f"\n  {command} ") == 1 for command in COMMANDS)
        assert not [command for command in HIDDEN if f"\n  {command} " in out]
        assert [line for line in out.splitlines() if re.fullmatch(r"[A-Z].*:", line)] == ["Options:", *SECTIONS]
        assert "..." not in out.partition("Daemon:\n")[2]
    for command in (*COMMANDS, *HIDDEN):
        assert main([command, "--help"]) == 0
        assert "Usage: hapticd " + command in capsys.readouterr().out


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"hapticd {__version__}\n"


@pytest.mark.parametrize(
    "arguments",
    [
        ["status"],
        ["scene", "get"],
        ["apply", "comb"],
        ["mark", "trial 3"],
        ["play", "wood", "--amplitude", "1"],
        ["force", "on"],
        ["reset"],
        ["watch"],
        ["record", "x.npz", "--for", "1s"],
    ],
)
def test_without_a_daemon(capsys: pytest.CaptureFixture[str], tmp_path: Path, arguments: list[str]) -> None:
    line = f"hapticd: no daemon at {tmp_path}/hapticd; start one with: hapticd run\n"
    assert said(capsys, 1, *arguments) == line
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("group", ["scene", "material", "devices", "fit"])
def test_no_line_of_a_list_of_commands_is_cut(capsys: pytest.CaptureFixture[str], group: str) -> None:
    assert main([*group.split(), "--help"]) == 0
    listed = capsys.readouterr().out.partition("Commands:\n")[2].partition("\n\n")[0]
    assert listed and "..." not in listed


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["xyzzy"], "No such command 'xyzzy'. (see hapticd --help)"),
        (["xtatus"], "No such command 'xtatus'. Did you mean 'status'? (see hapticd --help)"),
        (["recrod"], "No such command 'recrod'. (Did you mean one of: 'record', 'reload'?) (see hapticd"),
        (["flight"], "No such command 'flight': it is now `hapticd record --past FILE` (see hapticd --help)"),
        (["recover", "x.npz"], "it is now `hapticd record --recover FILE` (see hapticd --help)"),
        (["scene"], "Missing command"),
        (["status", "--jsn"], "No such option '--jsn'. Did you mean '--json'? (see hapticd status --help)"),
        (["status", "more"], "unexpected extra argument"),
        (["force", "maybe"], "'maybe' is not one of 'on', 'off'"),
        (["force"], "Missing argument"),
        (["-z", "run"], "No such option '-z'. (see"),
        (["-z"], "No such option '-z'. (see"),
        (["scene", "gte"], "No such command 'gte'. Did you mean 'get'? (see hapticd scene --help)"),
        (["play", "wood", "--amplitude", "x"], "'x' is not a valid number"),
        (["record", "x.npz", "--past", "--recover"], "--past and --recover cannot be combined"),
        (["record", "x.npz", "--past", "--for", "1s"], "--past and --recover cannot be combined, nor with --for"),
        (
            ["record", "x.npz", "--recover", "--overwrite"],
            "--recover replaces no file, each recording gets a free name",
        ),
        (["simulate"], "Missing argument 'FILE...'"),
        (["play", "--amplitude", "1"], "give either MATERIAL or --mode"),
        (["play", "wood", "--mode", "frequency_hz=1", "--amplitude", "1"], "MATERIAL or --mode"),
        (["play", "--mode", "frequency_hz", "--amplitude", "1"], "must be like frequency_hz=200"),
        (["play", "--mode", "a=1,a=2", "--amplitude", "1"], "duplicate keys"),
        (["play", "--mode", "a=1e", "--amplitude", "1"], "must be like"),
        (["play", "wood"], "--amplitude"),
        (["play", "wood", "--amplitude", "-1"], "x>=0"),
        (["record", "x.npz", "--for", "5 parsecs"], "is not a duration such as 5s, 500ms or 2min"),
        (["record", "x.npz", "--for", "0s"], "is not a duration"),
        (["scene", "set", "x", "--expect-revision", "-1"], "x>=0"),
    ],
)
def test_usage_errors(capsys: pytest.CaptureFixture[str], arguments: list[str], message: str) -> None:
    line = said(capsys, 2, *arguments)
    assert message in line and "--help)" in line


def test_materials_without_a_daemon_are_the_shipped_ones(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    note = f"hapticd: no daemon at {tmp_path}/hapticd; start one with: hapticd run; showing the shipped materials"
    for arguments, names in ((["list"], list(shipped_materials())), (["get", "steel"], ["steel"])):
        assert main(["material", *arguments]) == 0
        captured = capsys.readouterr()
        assert captured.err == f"{note}\n"
        printed = load_text(captured.out, "printed").data
        assert printed == {"materials": {name: shipped_materials()[name].to_dict() for name in names}}
        assert main(["material", *arguments, "--json"]) == 0
        captured = capsys.readouterr()
        assert captured.err == "" and json.loads(captured.out) == {**printed, "revision": None}
    assert main(["material", "get", "stel"]) == 1
    shipped = 'hapticd: unknown material "stel" in the shipped library; other materials need a running daemon'
    assert capsys.readouterr().err.splitlines() == [note, f"{shipped}; did you mean steel?"]


@pytest.mark.parametrize(
    ("arguments", "is_json"),
    [(["status", "--json"], True), (["status"], False), (["mark", "--", "--json"], False), (["--json", "x"], True)],
)
def test_an_error_is_json_with_the_option_json(
    capsys: pytest.CaptureFixture[str], arguments: list[str], is_json: bool
) -> None:
    assert main(arguments) != 0
    assert capsys.readouterr().err.startswith('{"error": ' if is_json else "hapticd: ")


def test_a_mark_keeps_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert "'--data': {a}: not JSON: " in said(capsys, 2, "mark", "x", "--data", "{a}")


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("5s", 5), ("500ms", 0.5), ("2min", 120), ("1h", 3600), ("3", 3), ("1.5s", 1.5), (".5s", 0.5), (" 5 s ", 5)],
)
def test_durations(text: str, seconds: float) -> None:
    assert duration(text) == seconds


def test_schema(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema"]) == 0
    schema = json.loads(capsys.readouterr().out)
    assert {"servo", "device", "materials", "scene"} <= schema["properties"].keys()


NAMES = st.text(
    st.characters(exclude_categories=["Cs", "Cc"], exclude_characters="\ufffe\uffff"), min_size=1, max_size=8
)
NAMES |= st.sampled_from(["null", "true", "False", "off", "1", "1e-3", "-", "~", "a b", "#", "a: b", "<<", "", "=="])
LEAVES = (
    st.none() | st.booleans() | st.integers(-(2**63), 2**63) | st.floats(allow_nan=False, allow_infinity=False) | NAMES
)
CONTENT = st.dictionaries(
    NAMES,
    st.recursive(LEAVES, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(NAMES, inner, max_size=3)),
    min_size=1,
    max_size=4,
)


@pytest.mark.long
@given(CONTENT)
def test_printed_yaml_is_read_back(content: dict[str, object]) -> None:
    assert load_text(yaml_text(content), "printed").data == content


def test_simulate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("scene.yaml").write_text(SCENE)
    Path("config.yaml").write_text("scene:\n  " + SCENE.replace("\n", "\n  ").rstrip() + "\n")
    Path("operator.yaml").write_text(WAYPOINTS)
    assert main(["simulate", "scene.yaml", "--operator", "operator.yaml", "-o", "a.npz", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result == {
        "file": "a.npz",
        "ticks": 1000,
        "duration_s": 0.1,
        "events": result["events"],
        "event_counts": result["event_counts"],
        "largest_force_n": result["largest_force_n"],
        "undisplayable": [],
        "warnings": [],
    }
    assert main(["simulate", "config.yaml", "--operator", "operator.yaml", "-o", "b.npz"]) == 0
    assert capsys.readouterr().out.startswith("b.npz: 1,000 ticks in 0.100 s, ")
    with np.load("a.npz") as first, np.load("b.npz") as second:
        assert first["samples"].tobytes() == second["samples"].tobytes(), "scene and configuration give one run"
        assert first["truth"].shape == (1000, 4)
        contact = first["events"][first["events"]["event"] == "contact"][0]
        assert contact["object"] == "floor"
        assert result["event_counts"] == dict(Counter(first["events"]["event"].tolist()))
        assert result["largest_force_n"] == np.hypot(*first["samples"]["force_n"].T).max() > 0
    assert (
        main(
            ["simulate", "scene.yaml", "--operator", "operator.yaml", "-o", "c.csv", "--for", "50ms", "--rate", "2000"]
        )
        == 0
    )
    with open("c.csv", newline="") as file:
        assert sum(1 for _ in csv.reader(file)) == 101


@pytest.mark.long
def test_simulate_without_a_file_prints_what_happened(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "comb", "--for", "100ms"]) == 0
    assert re.fullmatch(r"comb: 1,000 ticks in 0\.100 s, .*, largest force .* m?N\n", capsys.readouterr().out)
    assert os.listdir() == []
    assert main(["simulate", "comb", "--for", "100ms", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["file"] is None
    assert "need -o" in said(capsys, 2, "simulate", "comb", "--note", "a=b")


def test_simulate_is_at_the_rate_of_the_configuration(capsys: pytest.CaptureFixture[str]) -> None:
    Path("config.yaml").write_text("servo: {rate_hz: 2000}\nscene: {}\n")
    Path("operator.yaml").write_text(WAYPOINTS)
    for options, ticks in (([], 200), (["--rate", "5000"], 500)):
        command = ["simulate", "config.yaml", "--operator", "operator.yaml", "-o", f"{ticks}.npz", "--json", *options]
        assert main(command) == 0
        result = json.loads(capsys.readouterr().out)
        assert (result["ticks"], result["duration_s"]) == (ticks, 0.1)
    assert main(["simulate", "--help"]) == 0
    assert "[default: the configuration's]" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("scene", "operator", "output", "message"),
    [
        (SCENE.replace("wood", "woood"), WAYPOINTS, "x.npz", 'unknown material "woood"'),
        (
            SCENE.replace("[0, 1]", "[0, 0]"),
            WAYPOINTS,
            "x.npz",
            "scene.yaml:2:40: objects.floor.normal: must have a direction",
        ),
        (SCENE, "waypoints: []\n", "x.npz", "operator.yaml:1:1: waypoints"),
        (SCENE, WAYPOINTS, "x.mat", "x.mat: must end in .npz, .csv or .mcap"),
        (SCENE, WAYPOINTS, "no/x.npz", "no/x.npz: cannot be written: the folder no does not exist"),
        ("- 1\n", WAYPOINTS, "x.npz", "scene.yaml:1"),
        ("a: &x 1\nb: *x\n", WAYPOINTS, "x.npz", "scene.yaml:2:4: aliases are not allowed"),
    ],
)
def test_simulate_reports_faulty_arguments(
    capsys: pytest.CaptureFixture[str], scene: str, operator: str, output: str, message: str
) -> None:
    Path("scene.yaml").write_text(scene)
    Path("operator.yaml").write_text(operator)
    assert message in said(capsys, 1, "simulate", "scene.yaml", "--operator", "operator.yaml", "-o", output)
    assert sorted(os.listdir()) == ["operator.yaml", "scene.yaml"]


@contextmanager
def nowhere(kind: str) -> Iterator[int]:
    """Yield a descriptor to which writing fails: a closed pipe, or a full disk."""
    if kind == "full":
        descriptor = os.open("/dev/full", os.O_WRONLY)
    else:
        reader, descriptor = os.pipe()
        os.close(reader)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


PRINTING = ["--help", "check --json", "check", "check --help", "--version", "schema"]
"""A command for each way of printing: by click, by rich, as JSON."""


@pytest.mark.long
@pytest.mark.parametrize("command", rest_slow(PRINTING, fast=2))
@pytest.mark.parametrize("kind", ["pipe", "full"])
def test_lost_output_is_reported_in_one_line_and_a_closed_pipe_by_the_exit_code(command: str, kind: str) -> None:
    words = [sys.executable, "-m", "hapticd", *command.split()]
    with nowhere(kind) as stdout:
        process = subprocess.run(words, stdout=stdout, stderr=subprocess.PIPE, text=True, timeout=60)
    if kind == "pipe":
        assert (process.returncode, process.stderr) == (128 + signal.SIGPIPE, "")
        return
    lost = "standard output: cannot be written: No space left on device"
    assert process.returncode == 1
    if "--json" in words:
        assert json.loads(process.stderr)["error"]["message"] == lost
    else:
        assert process.stderr == f"hapticd: {lost}\n"


@pytest.mark.parametrize("kind", ["pipe", "full"])
@pytest.mark.parametrize(("command", "code"), [("status", 1), ("nonsense", 2), ("status --help", 0)])
def test_lost_error_output_does_not_change_the_exit_code(kind: str, command: str, code: int) -> None:
    words = [sys.executable, "-m", "hapticd", *command.split()]
    with nowhere(kind) as stderr:
        process = subprocess.run(words, stdout=subprocess.PIPE, stderr=stderr, timeout=60)
    assert process.returncode == code


@pytest.mark.long
@pytest.mark.parametrize("command", ["schema", "status"])
def test_without_writable_streams_the_exit_code_is_1(command: str) -> None:
    words = [sys.executable, "-m", "hapticd", command]
    with nowhere("full") as stream:
        process = subprocess.run(words, stdout=stream, stderr=stream, timeout=60)
    assert process.returncode == 1


def test_a_lost_warning_is_a_failure() -> None:
    program = (
        "import click, hapticd.cli\n"
        "hapticd.cli.cli.add_command(click.Command('warn', callback=lambda: click.echo('x', err=True)))\n"
        "hapticd.cli._LazyGroup.get_command = click.Group.get_command\n"
        "raise SystemExit(hapticd.cli.main(['warn']))\n"
    )
    with nowhere("full") as stderr:
        process = subprocess.run([sys.executable, "-c", program], stderr=stderr, timeout=60)
    assert process.returncode == 1


@pytest.mark.parametrize("command", ["--version", "--help", "status"])
def test_a_command_loads_no_more_than_it_needs(command: str) -> None:
    program = (
        "import sys; from hapticd.cli import main; main([sys.argv[1]]); "
        "print(*sorted({'numpy', 'pydantic', 'rich', 'yaml', 'asyncio', 'hapticd._core'} & sys.modules.keys()))"
    )
    process = subprocess.run(
        [sys.executable, "-c", program, command], capture_output=True, cwd=ROOT, text=True, timeout=60
    )
    assert process.stdout.splitlines()[-1] == ""
