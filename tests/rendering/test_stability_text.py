"""The sentences on a scene's stability: results and remedies."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from hapticd.analysis.check import check
from hapticd.cli import main
from hapticd.config.configuration import load_config
from hapticd.rendering.stability_text import stability_words

README = (Path(__file__).parents[2] / "README.md").read_text()
FLOOR: dict[str, object] = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "glass"}
SLOW = {"sim": {"link": {"rate_hz": 1000}}}


def words(objects: dict[str, object], device: dict[str, object] | None = None) -> list[tuple[str, str]]:
    config = load_config({"device": device or {}, "scene": {"objects": objects}})
    return stability_words(check(config).stability.to_dict())


def test_the_scene_of_the_readme_does_not_frighten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (scene,) = re.findall(r"cat > scene\.yaml <<EOF\n(.*?)EOF\n", README, flags=re.DOTALL)
    monkeypatch.chdir(tmp_path)
    Path("scene.yaml").write_text(scene)
    assert main(["check", "-c", "scene.yaml"]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    told = captured.out.splitlines()
    assert "stability: stable with the configured hand; not proved for every hand. Nothing needs to be done" in told
    assert (
        "unproved: floor, honey: with a damping of 0.5 N s/m no stiffness is proved to be stable in any hand, as the "
        "handle itself damps by 0.2 N s/m. With less damping this could be proved" in told
    )
    assert " 0 of 1 " not in captured.out


def test_a_safe_scene_in_words() -> None:
    assert words({"floor": FLOOR}) == [("stability", "all that can be touched is stable in any hand")]
    assert words({}) == [("stability", "the scene has nothing that can be touched")]


def test_a_scene_that_may_oscillate_names_a_remedy() -> None:
    (_, whole), (verdict, one) = words({"floor": FLOOR}, SLOW)
    assert (
        whole
        == "what can be touched may oscillate: lower the stiffness, or raise servo.rate_hz unless the link is slower, "
        "see docs/stability.md"
    )
    assert verdict == "unsafe"
    proved = "the limit up to which a wall is proved to be stable in any hand"
    assert one.startswith(f"floor: 800 N/m is not below 80 N/m, {proved}; it may ")
    assert one.endswith("Needed: a lower stiffness or a higher servo.rate_hz")


def test_a_limit_reads_as_lower_than_the_stiffness() -> None:
    soft, floor = {"stiffness_n_per_m": 80.001}, {**FLOOR, "material": "soft"}
    stability = check(
        load_config({"materials": {"soft": soft}, "device": SLOW, "scene": {"objects": {"floor": floor}}})
    ).stability
    _, (_, line) = stability_words(stability.to_dict())
    assert line.startswith("floor: 80 N/m is not below 79.99 N/m, ")
    (margin,) = stability.worst
    assert "below 80 N/m it would be safe in any hand" in str(margin)


def test_several_sets_are_counted() -> None:
    peg = {"kind": "disc", "center_m": [0.05, 0.05], "radius_m": 0.005, "material": "wood"}
    (_, whole), *rest = words({"floor": FLOOR, "peg": peg}, SLOW)
    assert whole.startswith("2 of 2 sets of objects may oscillate: ") and len(rest) == 2
    (_, whole), *rest = words({"floor": FLOOR, "peg": peg, "honey": {"kind": "viscous", "damping_n_s_per_m": 1}})
    assert "not proved for every hand for 2 of 2 sets of objects" in whole and len(rest) == 2


def test_an_unknown_stability_in_words() -> None:
    told: dict[str, Any] = {"unknown": "device.handle is not given", "sets": 0, "unsafe": 0, "worst": []}
    assert stability_words(told) == [("stability", "not known: device.handle is not given")]
