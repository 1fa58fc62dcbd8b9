"""Relative paths in YAML files begin in the folder of the file that holds them, wherever the program runs."""

from __future__ import annotations

import os
import tempfile
import textwrap
from collections.abc import Mapping
from pathlib import Path

import pytest

import hapticd
from hapticd.base.errors import HapticdError
from hapticd.base.yaml_source import load_text
from hapticd.config.configuration import config_of
from hapticd.experiment.study import load_study
from hapticd.sweeps.study import load_sweep
from tests.experiment.studies import PAIRS

REPLAY = "device: {kind: replay, replay: {path: rec.jsonl}}\n"
ONLY_HERE = "scene: {objects: {pull: {kind: spring, center_m: [0, 0], stiffness_n_per_m: 50}}}\n"


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of files; the process is in another, which has files of the same names."""
    for name in ("rig", "override", "elsewhere"):
        (tmp_path / name).mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    (tmp_path / "elsewhere" / "rec.jsonl").write_text("")
    return tmp_path / "rig"


def written(path: Path, text: str) -> str:
    path.write_text(text)
    return os.path.relpath(path)


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({"rig/a.yaml": REPLAY}, "rig/rec.jsonl"),
        ({"rig/a.yaml": REPLAY.replace("rec.jsonl", "../override/rec.jsonl")}, "rig/../override/rec.jsonl"),
        # A key has the folder of its own file, whichever file has the keys around it.
        ({"rig/a.yaml": REPLAY, "override/b.yaml": "device: {replay: {speed: 2}}\n"}, "rig/rec.jsonl"),
        ({"rig/a.yaml": REPLAY, "override/b.yaml": "device: {replay: {path: new.jsonl}}\n"}, "override/new.jsonl"),
        ({"override/b.yaml": "device: {replay: {path: new.jsonl}}\n", "rig/a.yaml": REPLAY}, "rig/rec.jsonl"),
        ({"rig/a.yaml": "device: {kind: replay}\n", "elsewhere/b.yaml": REPLAY}, "elsewhere/rec.jsonl"),
    ],
    ids=["one", "above", "override_beside", "override", "overridden", "here"],
)
def test_a_recording_is_in_the_folder_of_the_file_that_names_it(
    rig: Path, files: Mapping[str, str], expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = [written(rig.parent / name, text) for name, text in files.items()]
    for config in (config_of(names), hapticd.load_config(names)):
        assert config.device.replay is not None and config.device.replay.path == f"{rig.parent}/{expected}"
    monkeypatch.setenv("HAPTICD_CONFIG", ":".join(names))
    found = config_of().device.replay
    assert found is not None and found.path == f"{rig.parent}/{expected}"


def test_absolute_paths_stay_and_links_are_not_followed(rig: Path) -> None:
    absolute = written(rig / "a.yaml", REPLAY.replace("rec.jsonl", "/data/rec.jsonl"))
    link = rig.parent / "override" / "linked.yaml"
    (rig / "b.yaml").write_text(REPLAY)
    link.symlink_to(rig / "b.yaml")
    paths = [config_of([os.fspath(name)]).device.replay for name in (absolute, link)]
    assert [each and each.path for each in paths] == ["/data/rec.jsonl", f"{rig.parent}/override/rec.jsonl"]


def test_flight_files_have_the_same_rule(rig: Path) -> None:
    assert config_of([written(rig / "a.yaml", "flight: {directory: flights}\n")]).flight.directory == f"{rig}/flights"
    assert config_of([written(rig / "b.yaml", "flight: {seconds: 5}\n")]).flight.directory is None


@pytest.mark.parametrize("value", ['""', "[rec.jsonl]", "5", "null"])
def test_a_path_that_is_none_is_refused_as_before(rig: Path, value: str) -> None:
    with pytest.raises(HapticdError, match=r"a\.yaml:1:\d+: device\.replay"):
        config_of([written(rig / "a.yaml", REPLAY.replace("rec.jsonl", value))])


def test_what_has_no_folder_begins_in_the_current_one(rig: Path) -> None:
    """A mapping, the standard input, and a pipe of the shell."""
    replay = hapticd.load_config({"device": {"kind": "replay", "replay": {"path": "rec.jsonl"}}}).device.replay
    assert replay is not None and replay.path == f"{os.getcwd()}/rec.jsonl"
    os.mkfifo(rig / "pipe")
    folders = {load_text(REPLAY, name).folder for name in ("/dev/stdin", "/dev/fd/63", str(rig / "pipe"), "gone.yaml")}
    assert folders == {os.getcwd()}


def test_a_file_in_shared_memory_has_a_folder() -> None:
    with tempfile.NamedTemporaryFile("w", dir="/dev/shm", suffix=".yaml") as file:
        assert load_text(REPLAY, file.name).folder == "/dev/shm"


def test_the_base_of_a_study_is_beside_it(rig: Path) -> None:
    begin, end = PAIRS.index("base:"), PAIRS.index("places:")
    base = textwrap.dedent(PAIRS[begin:end].removeprefix("base:\n"))
    study = written(rig / "study.yaml", f"{PAIRS[:begin]}base: boxes.yaml\n{PAIRS[end:]}")
    Path("boxes.yaml").write_text(base)
    with pytest.raises(HapticdError) as caught:
        load_study(study)
    assert str(caught.value) == f"{rig}/boxes.yaml: cannot be read: No such file or directory"
    (rig / "boxes.yaml").write_text(base)
    assert load_study(study).base is not None


@pytest.mark.parametrize("key", ["base", "operator"])
def test_base_and_operator_of_a_sweep_are_beside_it(rig: Path, key: str) -> None:
    text = "base: fields\noperator: push\nvary: {servo.rate_hz: [1000, 2000]}\nmeasure: [peak_force_n]\n"
    text = text.replace("fields" if key == "base" else "push", "other.yaml")
    Path("other.yaml").write_text(ONLY_HERE if key == "base" else "waypoints: [[0, 0, 0], [1, 0.01, 0]]\n")
    with pytest.raises(HapticdError) as caught:
        load_sweep(written(rig / "sweep.yaml", text))
    assert f"{rig}/other.yaml: cannot be read: No such file or directory" in str(caught.value)
