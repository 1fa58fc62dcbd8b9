"""Shipped scenes and operators by their names."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hapticd.base.errors import HapticdError
from hapticd.cli import main
from hapticd.config.shipped_files import file_of, folder_of, shipped, shipped_scenes
from tests.support.cli import said


@pytest.fixture(autouse=True)
def _empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_names() -> None:
    assert file_of("comb", "scenes") == str(folder_of("scenes") / "comb.yaml")
    assert file_of("stroke", "operators") == str(folder_of("operators") / "stroke.yaml")
    assert file_of("-", "scenes") == "/dev/stdin"
    for path in ("folder/comb", "mine.yaml", "x.csv"):
        assert file_of(path, "scenes") == path


def test_a_file_of_the_name_comes_first() -> None:
    Path("corner").mkdir()
    assert file_of("corner", "scenes") == str(folder_of("scenes") / "corner.yaml")
    Path("comb").write_text("objects: {}\n")
    assert file_of("comb", "scenes") == "comb"


def test_unknown_names() -> None:
    with pytest.raises(HapticdError) as caught:
        file_of("sandpapr", "scenes")
    assert str(caught.value) == "sandpapr: neither a file nor a shipped scene; did you mean sandpaper?"
    with pytest.raises(HapticdError, match=r"^x: neither a file nor a shipped operator; shipped: around, "):
        file_of("x", "operators")
    with pytest.raises(HapticdError, match=r"^comb\.yaml: no such file; the shipped scene .* called comb$"):
        file_of("comb.yaml", "scenes")


@pytest.mark.long
@pytest.mark.parametrize("name", shipped("scenes"))
def test_a_shipped_scene_is_simulated_by_its_name(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", name, "-o", "by_name.csv", "--for", "2ms", "--json"]) == 0
    (scene,) = [scene for scene in shipped_scenes() if scene.name == name]
    assert scene.operator is not None
    paths = [scene.file, "--operator", shipped("operators")[scene.operator]]
    assert main(["simulate", *paths, "-o", "by_path.csv", "--for", "2ms", "--json"]) == 0
    assert Path("by_name.csv").read_bytes() == Path("by_path.csv").read_bytes()


def test_a_scene_file_needs_an_operator(capsys: pytest.CaptureFixture[str]) -> None:
    Path("s.yaml").write_text("objects: {}\n")
    assert "Missing option '--operator': a file with the motion of the hand, or one of around, corner," in said(
        capsys, 2, "simulate", "s.yaml", "-o", "x.npz"
    )
    Path("s.yaml").write_text("gesture: {}\n")
    assert "s.yaml: holds a gesture; use: hapticd operator s.yaml" in said(capsys, 1, "simulate", "s.yaml")


def test_check_accepts_a_shipped_scene(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "-c", "comb"]) == 0
    out = capsys.readouterr().out
    assert "slippery" in out
    # Numbers are written for people: neither 10000 Hz nor 2.304e+03.
    assert "servo at 10 kHz\n" in out and " 2,304 " in out and "e+0" not in out
    assert "did you mean comb?" in said(capsys, 1, "check", "-c", "cmb")


def test_scene_list(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scene", "list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(shipped("scenes"))
    assert "friction   A floor that is slippery on the left and sticky on the right. (operator: stroke)" in lines
    assert main(["scene", "list", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert [each["name"] for each in listed] == list(shipped("scenes"))
    assert all(each["shows"].endswith(".") and Path(each["file"]).is_file() for each in listed)
