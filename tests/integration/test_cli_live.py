"""The command line against a real daemon, as a shell script would use it."""

from __future__ import annotations

import csv
import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hapticd.base.yaml_source import load_text
from hapticd.cli import main
from hapticd.recording.recording import load
from tests.support.daemon_process import PATIENCE_S, Daemon, connect, running_daemon

ROOT = Path(__file__).parents[2]
SCENE = """\
scene:
  objects:
    floor: {kind: wall, point_m: [0, 0], normal: [0, 1], material: wood}
    skin: {kind: membrane, center_m: [0, 0.03], normal: [0, 1], width_m: 0.02, material: cellophane}
"""
OPERATOR = "waypoints: [[0, 0, 0.01], [0.1, 0, 0.01], [0.2, 0, -0.003], [0.3, 0, 0.01]]\n"


@pytest.fixture(scope="module")
def daemon(quiet_daemon: Daemon) -> Daemon:
    return quiet_daemon


class Shell:
    """Runs commands in this process and keeps what they said."""

    def __init__(self, directory: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self._directory = directory
        self._capsys = capsys

    def __call__(self, *arguments: str) -> str:
        """What a command prints that must succeed."""
        code = main(["--runtime-dir", str(self._directory), *arguments])
        captured = self._capsys.readouterr()
        assert (code, captured.err) == (0, "")
        return captured.out

    def fails(self, *arguments: str) -> str:
        """The line of a command that must fail."""
        assert main(["--runtime-dir", str(self._directory), *arguments]) == 1
        captured = self._capsys.readouterr()
        assert captured.out == ""
        assert captured.err.startswith("hapticd: ") and captured.err.count("\n") == 1
        return captured.err

    def noted(self, *arguments: str) -> str:
        """What a command that must succeed says on stderr."""
        assert main(["--runtime-dir", str(self._directory), *arguments]) == 0
        return self._capsys.readouterr().err


@pytest.fixture
def shell(daemon: Daemon, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Shell:
    monkeypatch.chdir(tmp_path)
    Path("scene.yaml").write_text(SCENE)
    Path("operator.yaml").write_text(OPERATOR)
    return Shell(daemon.directory, capsys)


def command(daemon: Daemon, *arguments: str) -> subprocess.Popen[str]:
    """A command in a process of its own, for those that are ended by a signal."""
    return subprocess.Popen(
        [sys.executable, "-m", "hapticd", "--runtime-dir", str(daemon.directory), *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        cwd=ROOT,
        text=True,
    )


def test_status(shell: Shell) -> None:
    status = json.loads(shell("status", "--json"))
    assert status["rate_hz"] == 1000
    text = shell("status")
    assert "sim at 1 kHz" in text and "forces" in text


@pytest.mark.parametrize("name", ["HAPTICD_RUNTIME_DIR", "RUNTIME_DIRECTORY"])
def test_the_runtime_directory_may_come_from_the_environment(
    daemon: Daemon, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    monkeypatch.setenv(name, str(daemon.directory))
    assert main(["status"]) == 0
    assert "sim at 1 kHz" in capsys.readouterr().out


@pytest.mark.long
@pytest.mark.parametrize("arguments", [["status"], ["scene", "get"], ["watch"], ["watch", "--json"]])
def test_a_full_disk_ends_what_prints_in_one_line(daemon: Daemon, arguments: list[str]) -> None:
    words = [sys.executable, "-m", "hapticd", "--runtime-dir", str(daemon.directory), *arguments]
    with open("/dev/full", "wb") as full:
        process = subprocess.run(words, stdout=full, stderr=subprocess.PIPE, text=True, timeout=PATIENCE_S)
    lost = "standard output: cannot be written: No space left on device"
    assert process.returncode == 1
    if "--json" in arguments:
        assert json.loads(process.stderr)["error"]["message"] == lost
    else:
        assert process.stderr == f"hapticd: {lost}\n"


def test_a_scene_goes_round(shell: Shell) -> None:
    first = json.loads(shell("scene", "set", "scene.yaml", "--json"))["revision"]
    printed = shell("scene", "get")
    assert printed.startswith(f"# revision {first}\n")
    Path("again.yaml").write_text(printed)
    assert shell("scene", "set", "again.yaml") == f"revision {first + 1}\n"
    scene = json.loads(shell("scene", "get", "--json"))["scene"]
    assert load_text(printed, "printed").data == {"scene": scene}
    assert "in force from tick" in shell("scene", "set", "scene.yaml", "--wait")


@pytest.mark.long
def test_the_standard_input_is_a_file(daemon: Daemon) -> None:
    with command(daemon, "scene", "set", "-", "--json") as process:
        out, err = process.communicate(SCENE, PATIENCE_S)
    assert (process.returncode, err) == (0, "")
    assert json.loads(out)["revision"] > 0


def test_scene_update(shell: Shell) -> None:
    shell("scene", "set", "scene.yaml")
    Path("update.yaml").write_text("objects:\n  floor: {material: acrylic}\n  skin: null\n")
    shell("scene", "update", "update.yaml")
    scene = json.loads(shell("scene", "get", "--json"))["scene"]
    assert list(scene["objects"]) == ["floor"] and scene["objects"]["floor"]["material"] == "acrylic"


def test_a_scene_that_is_wrong_changes_nothing(shell: Shell) -> None:
    shell("scene", "set", "scene.yaml")
    before = shell("scene", "get")
    Path("bad.yaml").write_text(SCENE.replace("[0, 1]", "[0, off]", 1))
    assert "bad.yaml:3:54: scene.objects.floor.normal[1]" in shell.fails("scene", "set", "bad.yaml")
    Path("bad.yaml").write_text(SCENE.replace("wood", "woood"))
    assert 'unknown material "woood"; did you mean wood?' in shell.fails("scene", "set", "bad.yaml")
    assert "is stale" in shell.fails("scene", "set", "scene.yaml", "--expect-revision", "0")
    assert "missing.yaml: cannot be read" in shell.fails("scene", "set", "missing.yaml")
    assert shell("scene", "get") == before


def test_materials(shell: Shell) -> None:
    Path("felt.yaml").write_text("materials:\n  felt: {stiffness_n_per_m: 90}\n")
    shell("material", "set", "felt.yaml")
    assert json.loads(shell("material", "list", "--json"))["materials"]["felt"]["stiffness_n_per_m"] == 90
    printed = load_text(shell("material", "list"), "printed").data
    assert isinstance(printed, dict) and {"wood", "felt"} <= printed["materials"].keys()  # type: ignore[union-attr]
    Path("felt.yaml").write_text("materials:\n  felt: {stiffness_n_per_m: -1}\n")
    assert "materials.felt.stiffness_n_per_m" in shell.fails("material", "set", "felt.yaml")


def test_materials_are_set_whole_and_updated_in_parts(shell: Shell) -> None:
    def lichen() -> object:
        return json.loads(shell("material", "get", "lichen", "--json"))["materials"]["lichen"]

    Path("m.yaml").write_text("materials:\n  lichen: {stiffness_n_per_m: 90, damping_n_s_per_m: 1}\n")
    shell("material", "set", "m.yaml", "--wait")
    Path("m.yaml").write_text("lichen: {stiffness_n_per_m: 80}\n")
    shell("material", "update", "m.yaml")
    assert lichen() == {"stiffness_n_per_m": 80, "damping_n_s_per_m": 1}
    shell("material", "set", "m.yaml")
    assert lichen() == {"stiffness_n_per_m": 80, "damping_n_s_per_m": 0}
    Path("m.yaml").write_text("lichen: null\n")
    assert "holds neither materials nor a scene" in shell.fails("material", "set", "m.yaml")
    shell("material", "update", "m.yaml")
    assert shell.fails("material", "get", "lichn").startswith('hapticd: unknown material "lichn"; known: ')


def test_apply(shell: Shell) -> None:
    Path("fur.yaml").write_text("materials:\n  fur: {stiffness_n_per_m: 90}\n")
    Path("bare.yaml").write_text("objects:\n  rug: {kind: wall, point_m: [0, 0], normal: [0, 1], material: fur}\n")
    before = json.loads(shell("status", "--json"))["revision"]
    result = json.loads(shell("apply", "fur.yaml", "bare.yaml", "--wait", "--json"))
    assert result["revision"] == before + 1 and result["tick"] > 0
    assert list(json.loads(shell("scene", "get", "--json"))["scene"]["objects"]) == ["rug"]
    assert json.loads(shell("apply", "comb", "--expect-revision", str(before + 1), "--json"))["revision"] == before + 2
    assert "floor" in json.loads(shell("scene", "get", "--json"))["scene"]["objects"]
    Path("more.yaml").write_text(
        "scene:\n  objects:\n    rag: {kind: wall, point_m: [0, 0], normal: [0, 1], material: fur}\n"
    )
    shell("apply", "comb", "more.yaml", "--json")
    assert {"floor", "rag"} <= json.loads(shell("scene", "get", "--json"))["scene"]["objects"].keys()
    shell("scene", "set", "scene.yaml")
    told = "bare.yaml:1:1: ramp_s: should be less than or equal to 1, is 2"
    Path("bare.yaml").write_text("ramp_s: 2\n")
    assert shell.fails("apply", "fur.yaml", "bare.yaml") == f"hapticd: {told}\n"
    Path("unknown.yaml").write_text(
        "scene:\n  objects:\n    a: {kind: wall, point_m: [0, 0], normal: [0, 1], material: fr}\n"
    )
    told = shell.fails("apply", "fur.yaml", "unknown.yaml")
    assert told.startswith('hapticd: unknown.yaml:3:54: scene.objects.a.material: unknown material "fr"; ')
    Path("bare.yaml").write_text("materials: {}\ngesture: {}\n")
    assert "bare.yaml:2:1: gesture: unknown key; known: materials, scene" in shell.fails("apply", "bare.yaml")
    assert shell.fails("apply", "operator.yaml") == (
        "hapticd: operator.yaml: holds waypoints; use: hapticd operator operator.yaml\n"
    )
    Path("bare.yaml").write_text("floor: {material: steel}\n")
    assert "bare.yaml:1:1: holds neither materials nor a scene" in shell.fails("apply", "bare.yaml")
    assert json.loads(shell("status", "--json"))["revision"] == before + 4


def test_mark(shell: Shell, daemon: Daemon) -> None:
    with connect(daemon.directory) as client, client.events() as events:
        tick = json.loads(shell("mark", "trial 3", "--data", '{"side": "left"}', "--json"))["tick"]
        mark = next(event for event in events if event["event"] == "mark")
    assert (mark["tick"], mark["text"], mark["data"]) == (tick, "trial 3", {"side": "left"})
    assert shell("mark", "trial 4").startswith("marked at tick ")


def test_shipped_scenes_and_operators_by_their_names(shell: Shell) -> None:
    shell("scene", "set", "corner", "--json")
    assert list(json.loads(shell("scene", "get", "--json"))["scene"]["objects"]) == ["floor", "side"]
    assert shell("operator", "corner") == "takes 2 s\n"
    assert "did you mean corner?" in shell.fails("scene", "set", "cornr")
    assert "did you mean stroke?" in shell.fails("operator", "strok")


def test_files_for_another_command(shell: Shell) -> None:
    Path("wool.yaml").write_text("materials:\n  wool: {stiffness_n_per_m: 90}\n")
    Path("part.yaml").write_text("lamp: {kind: viscous, damping_n_s_per_m: 1}\n")
    taken = {
        "apply": ("scene.yaml", "wool.yaml"),
        "scene set": ("scene.yaml", "wool.yaml"),
        "scene update": ("scene.yaml", "part.yaml"),
        "material update": ("wool.yaml",),
    }
    for command, accepted in taken.items():
        for name, what, taker in (
            ("scene.yaml", "a scene", "apply"),
            ("part.yaml", "objects", "scene update"),
            ("wool.yaml", "materials", "apply"),
            ("operator.yaml", "waypoints", "operator"),
        ):
            if name in accepted:
                continue
            said = shell.fails(*command.split(), name)
            assert said == f"hapticd: {name}: holds {what}; use: hapticd {taker} {name}\n"
    np.savez("r.npz", samples=np.zeros(3))
    assert (
        shell.fails("operator", "r.npz")
        == "hapticd: r.npz: an archive, not YAML; for a recording use: hapticd replay\n"
    )
    assert shell.fails("operator", "wool.yaml").endswith(": holds materials; use: hapticd apply wool.yaml\n")


def test_a_motion_is_waited_for_and_recorded(shell: Shell) -> None:
    shell("apply", "scene.yaml", "--wait")
    ended = json.loads(shell("operator", "operator.yaml", "--wait", "--json"))
    assert ended["completed"] and ended["started_tick"] < ended["tick"]
    assert "nothing lost" in shell("record", "moved.npz", "--operator", "operator.yaml")
    recording = load("moved.npz")
    assert len(recording.samples) / recording.rate_hz >= ended["duration_s"]
    moved = [event for event in recording.events if event["event"] == "gesture_end"]
    assert [event["completed"] for event in moved] == [True]
    assert shell("record", "short.mcap", "--for", "0.1s").endswith("; exported to short.mcap\n")
    # A motion that cannot begin leaves no file.
    Path("tap.yaml").write_text("gesture: {kind: tap, object: nobody, speed_m_per_s: 0.1}\n")
    assert '"nobody"' in shell.fails("record", "none.npz", "--operator", "tap.yaml")
    assert not Path("none.npz").exists()


def test_ids_with_typos(shell: Shell) -> None:
    shell("scene", "set", "scene.yaml")
    assert 'unknown object "flor"; did you mean floor?' in shell.fails("reset", "flor")
    Path("tap.yaml").write_text("gesture: {kind: tap, object: flor, speed_m_per_s: 0.1}\n")
    assert 'has the id "flor"; did you mean floor?' in shell.fails("operator", "tap.yaml")
    assert "did you mean wood?" in shell.fails("play", "woood", "--amplitude", "1")


@pytest.mark.long
def test_the_scene_of_the_readme_runs_and_checks_everywhere(
    tmp_path: Path, shell: Shell, daemon: Daemon, capsys: pytest.CaptureFixture[str]
) -> None:
    (scene,) = re.findall(r"cat > scene\.yaml <<EOF\n(.*?)EOF\n", (ROOT / "README.md").read_text(), flags=re.DOTALL)
    Path("scene.yaml").write_text(scene)
    shell("scene", "set", "scene.yaml", "--wait", "--json")
    shell("apply", "scene.yaml", "--wait", "--json")
    assert list(json.loads(shell("scene", "get", "--json"))["scene"]["objects"]) == ["floor", "honey"]
    shell("check", "-c", "scene.yaml")
    assert json.loads(shell("scene", "get", "--json"))["margins"]["floor"] > 0.0
    shell("simulate", "scene.yaml", "--operator", "operator.yaml", "-o", "x.npz")
    with running_daemon("-c", "scene.yaml") as other, connect(other.directory) as client:
        assert list(client.get_scene()["scene"]["objects"]) == ["floor", "honey"]


@pytest.mark.long
def test_run_says_which_configuration_it_took(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "hapticd" / "config.yaml"
    path.parent.mkdir()
    path.write_text("servo: {rate_hz: 1000, realtime: off}\nscene: {objects: {}}\n")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    monkeypatch.delenv("HAPTICD_CONFIG", raising=False)
    with running_daemon() as found, connect(found.directory) as client:
        assert client.get_status()["rate_hz"] == 1000
        path.write_text(path.read_text().replace("{}", "{a: {kind: viscous, damping_n_s_per_m: 1}}"))
        client.reload()
        assert list(client.get_scene()["scene"]["objects"]) == ["a"]
        assert found.said().splitlines()[0].endswith(f"configuration: {path}")


def test_one_command_takes_materials_and_a_scene(shell: Shell) -> None:
    Path("all.yaml").write_text("materials:\n  moss: {stiffness_n_per_m: 90}\n" + SCENE)
    for command in ("apply", "scene set", "material set"):
        assert "in force from tick" in shell(*command.split(), "all.yaml", "--wait")
    assert "moss" in shell("material", "get", "moss")


def test_play_force_reset_operator(shell: Shell) -> None:
    shell("scene", "set", "scene.yaml")
    assert shell("play", "wood", "--amplitude", "2").startswith("struck at tick ")
    played = shell(
        "play", "--mode", "frequency_hz=90,decay_time_s=0.01", "--amplitude", "1", "--direction", "-1", "0", "--json"
    )
    assert json.loads(played)["tick"] > 0
    assert "unknown material" in shell.fails("play", "cheese", "--amplitude", "2")
    pulse = {"attack_slope_per_s": 9, "waveform": {"rate_hz": 200, "samples": [0, 1, 0]}}
    Path("felt.yaml").write_text(json.dumps({"felt": {"stiffness_n_per_m": 9, "tap": pulse}}))
    shell("material", "set", "felt.yaml")
    assert 'the tap of "felt" is a waveform, which play cannot strike; give a mode' in shell.fails(
        "play", "felt", "--amplitude", "2"
    )
    assert shell("force", "off") == "forces off\n"
    off = "hapticd: forces are off: `hapticd force on` or set_forces turns them on\n"
    assert shell.fails("play", "wood", "--amplitude", "2") == off
    noted = shell.noted("operator", "operator.yaml")
    assert noted == "hapticd: forces are off: no force acts on the moving hand; `hapticd status` gives the reason\n"
    assert shell.noted("record", "off.npz", "--operator", "operator.yaml") == noted
    assert json.loads(shell("force", "on", "--json"))["forces"] == "on"
    assert shell.noted("operator", "operator.yaml") == ""
    assert shell("reset", "skin").startswith("reset at tick ")
    assert shell("reset").startswith("reset at tick ")
    assert 'unknown object "nothing"' in shell.fails("reset", "nothing")
    assert shell("operator", "operator.yaml") == "takes 300 ms\n"
    Path("tap.yaml").write_text("gesture: {kind: tap, object: floor, speed_m_per_s: 0.1}\n")
    assert shell("operator", "tap.yaml").startswith("takes ")
    Path("way.csv").write_text("t_s,x_m,y_m\n0,0,0.01\n0.5,0,0.02\n")
    assert shell("operator", "way.csv") == "takes 500 ms\n"
    Path("way.csv").write_text("t_s,x_m,y_m\n0,0,0.01\n0,0,0.02\n")
    assert "way.csv:3" in shell.fails("operator", "way.csv")


def test_record_npz(shell: Shell, daemon: Daemon) -> None:
    Path("run.npz").write_text("an old recording")
    shell("scene", "set", "scene.yaml")
    shell("operator", "operator.yaml")
    with connect(daemon.directory) as client, client.samples() as batches:
        assert "run.npz: already exists" in shell.fails("record", "run.npz", "--for", "600ms")
        assert Path("run.npz").read_text() == "an old recording"
        result = json.loads(shell("record", "run.npz", "--for", "600ms", "--json", "--overwrite"))
        with np.load("run.npz") as archive:
            last = int(archive["samples"]["tick"][-1])
        batch = next(batch for batch in batches if batch["tick"][-1] > last)
        after_ns = int(batch["time_ns"][batch["tick"] > last][0])
    assert result["file"] == "run.npz" and result["ended_because"] is None
    assert result["ended"]["monotonic_ns"] > result["started"]["monotonic_ns"] and result["missed_periods"] >= 0
    assert (result["lost"], result["dropped"]) == (0, 0)
    with np.load("run.npz") as archive:
        samples, events = archive["samples"], archive["events"]
        assert len(samples) == result["ticks"] and len(events) == result["events"]
        assert (np.diff(samples["tick"]) == 1).all()
        span_ns = int(samples["time_ns"][-1] - samples["time_ns"][0])
        assert span_ns < 600_000_000 <= after_ns - int(samples["time_ns"][0]) + 500_000, (
            "ends at the time asked for, on the daemon's clock: the tick after it is beyond"
        )
        assert {"floor", "skin"} == json.loads(str(archive["scene"]))["objects"].keys()
        assert "wood" in json.loads(str(archive["materials"]))
        assert json.loads(str(archive["status"]))["rate_hz"] == 1000
        assert (events["tick"] >= samples["tick"][0]).all() and (events["tick"] <= samples["tick"][-1]).all()
        assert os.listdir() and not [name for name in os.listdir() if name.startswith(".")]


def test_record_csv(shell: Shell) -> None:
    said = shell("record", "run.csv", "--for", "0.1s")
    assert said.startswith("run.npz: ") and "nothing lost" in said
    with open("run.csv", newline="") as file:
        ticks = [int(row["tick"]) for row in csv.DictReader(file)]
    assert ticks == list(range(ticks[0], ticks[0] + len(ticks))) and ticks
    assert Path("run.events.csv").exists()


@pytest.mark.long
def test_record_refuses_before_it_records(shell: Shell) -> None:
    assert "must end in .npz, .csv or .mcap" in shell.fails("record", "run.mat")
    assert "the folder no does not exist" in shell.fails("record", "no/run.npz")


@pytest.mark.long
@pytest.mark.parametrize(
    ("number", "options", "code"),
    [(signal.SIGINT, [], 0), (signal.SIGTERM, [], 0), (signal.SIGINT, ["--for", "1h"], 130)],
)
def test_an_interrupted_recording_is_kept(
    daemon: Daemon, tmp_path: Path, number: int, options: list[str], code: int
) -> None:
    target = tmp_path / "run.npz"
    with (
        connect(daemon.directory) as client,
        client.samples() as batches,
        command(daemon, "record", str(target), *options) as process,
    ):
        for _ in batches:  # 50 times a second
            if any(part.stat().st_size > 0 for part in target.parent.glob(f".run.npz.{process.pid}.*.part")):
                break
            assert process.poll() is None
        process.send_signal(number)
        out, err = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, err) == (code, "")
    assert "nothing lost" in out
    with np.load(target) as archive:
        assert len(archive["samples"]) > 0
    assert os.listdir(tmp_path) == ["run.npz"]


@pytest.mark.long
def test_an_interrupt_ends_a_recording_that_a_script_put_in_the_background(daemon: Daemon, tmp_path: Path) -> None:
    """The shell has it ignore interrupts; who sends it one means it."""
    target = tmp_path / "run.npz"
    words = [sys.executable, "-m", "hapticd", "--runtime-dir", str(daemon.directory), "record", str(target)]
    ignoring = ["sh", "-c", 'trap "" INT; exec "$@"', "sh", *words]
    with (
        connect(daemon.directory) as client,
        client.samples() as batches,
        subprocess.Popen(ignoring, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=ROOT, text=True) as process,
    ):
        for _ in batches:
            if any(part.stat().st_size > 0 for part in target.parent.glob(f".run.npz.{process.pid}.*.part")):
                break
            assert process.poll() is None
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, err) == (0, "")
    assert target.exists() and "run.npz" in out


@pytest.mark.slow
def test_a_recording_whose_daemon_goes_away_is_kept(tmp_path: Path) -> None:
    target, config = tmp_path / "run.npz", tmp_path / "config.yaml"
    config.write_text("servo: {overruns: {threshold: 1}}\n")
    with (
        running_daemon("-c", str(config)) as daemon,
        connect(daemon.directory) as client,
        client.samples() as batches,
        command(daemon, "record", str(target)) as process,
    ):
        for _ in batches:
            if any(part.stat().st_size > 0 for part in target.parent.glob(f".run.npz.{process.pid}.*.part")):
                break
            assert process.poll() is None
        daemon.stop()
        err = process.communicate(timeout=PATIENCE_S)[1]
    assert process.returncode == 1
    assert "the daemon stopped" in err and err.count("\n") == 1
    with np.load(target) as archive:
        assert len(archive["samples"]) > 0
