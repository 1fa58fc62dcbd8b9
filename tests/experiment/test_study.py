"""A study is read completely, or refused with a line that names file, line, key and a correction."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from hapticd.base.errors import HapticdError, InvalidError
from hapticd.experiment.plan import plan
from hapticd.experiment.study import load_study, study_of
from tests.experiment.studies import ADAPTIVE, CONSTANT, LISTED, PAIRS, RATING

MATERIALS = "    levels: [wood, acrylic, glass, steel]"
STAIRCASE = "start: 50, least: 1, most: 200, steps: [10, 5], trials: 20}"

# By the mistake: the study, a text in it, its replacement, the text of the line with the fault, the message.
MISTAKES = {
    "unknown version": (PAIRS, "experiment: 1", "experiment: 2", "experiment: 2", "should be 1, is 2"),
    "no title": (PAIRS, "title: Which is stiffer?\n", "", "experiment: 1", "title: Field required"),
    "unknown key": (PAIRS, "places: [", "place: [", "place: [", "did you mean places?"),
    "unknown base": (PAIRS, "base:\n", "base: nowhere\nbase_:\n", "base: nowhere", "nor a shipped scene"),
    "device in the base": (
        PAIRS,
        "  scene:\n",
        "  device: {kind: sim}\n  scene:\n",
        "  device:",
        "belongs to the daemon",
    ),
    "unknown material in the base": (
        PAIRS,
        "{left: wood, right: wood}",
        "{left: wod, right: wood}",
        "left: wod",
        "did you mean wood?",
    ),
    "unknown kind of object": (
        PAIRS,
        "left: {kind: box",
        "left: {kind: bx",
        "left: {kind: bx",
        "should be one of 'wall'",
    ),
    "unknown material among the levels": (
        PAIRS,
        "glass, steel]",
        "glas, steel]",
        "glas, steel]",
        "did you mean glass?",
    ),
    "a level twice": (PAIRS, "glass, steel]", "glass, wood]", "glass, wood]", "duplicate level wood"),
    "a key that is not there": (
        PAIRS,
        '"materials.{place}"',
        '"scene.objects.{place}.skin.material"',
        "levels: [wood",
        "unknown key scene.objects.left",
    ),
    "a key outside of scene and materials": (
        PAIRS,
        '"materials.{place}"',
        '"servo.{place}"',
        'at: "servo',
        "must begin with scene. or materials.",
    ),
    "a key without its place": (
        PAIRS,
        '"materials.{place}"',
        "materials.left",
        "at: materials.left",
        "would all set the same key",
    ),
    "no path": (PAIRS, '"materials.{place}"', '"materials..{place}"', 'at: "materials..', "separated by dots"),
    "levels without at": (PAIRS, '    at: "materials.{place}"\n', "", "  material:", "levels need at"),
    "levels and variants": (
        PAIRS,
        MATERIALS,
        MATERIALS + "\n    variants: {a: {}}",
        "  material:",
        "exactly one of levels and variants",
    ),
    "unknown factor": (PAIRS, "cross: [material]", "cross: [materiel]", "cross: [materiel]", "did you mean material?"),
    "a factor that nothing varies": (
        RATING,
        "cross: [stiffness, display]",
        "cross: [stiffness]",
        "  display:",
        "no trial",
    ),
    "a condition that the scene refuses": (PAIRS, "{force: false}", "{forc: false}", "forc", "did you mean force?"),
    "unknown type": (PAIRS, "type: paired_comparison", "type: paired", "type: paired", "should be 'paired_comparison'"),
    "neither cross nor list": (PAIRS, "  cross: [material]\n", "", "  material:", "no trial varies this factor"),
    "cross and list": (
        LISTED,
        "  question: which\n",
        "  question: which\n  cross: [material]\n",
        "  list:",
        "at most one of cross",
    ),
    "one stimulus for a pair": (
        PAIRS.replace("  with_itself: true\n", ""),
        "[wood, acrylic, glass, steel]",
        "[wood]",
        "cross:",
        "pair needs two",
    ),
    "too few places": (PAIRS, "places: [left, right]", "places: [left]", "places: [left]", "2 stimuli side by side"),
    "places in intervals": (PAIRS, "  presentation: places\n", "", "places: [left", "one after the other"),
    "a place that is a level": (
        PAIRS.replace("left", "glass"),
        "cross:",
        "cross:",
        "places: [glass",
        "would see its name",
    ),
    "unknown question": (PAIRS, "question: stiffer", "question: stifer", "question: stifer", "did you mean stiffer?"),
    "a question of another kind": (
        RATING,
        "type: rating",
        "type: motor",
        "  real:",
        "needs a question of kind measure, is slider",
    ),
    "two answers on one key": (PAIRS, 'key: "2"', 'key: "1"', "name: same", "is already the key of first"),
    "an answer that no key chooses": (
        PAIRS.replace('key: "2", ', ""),
        'key: "1"',
        'key: "2"',
        "name: same",
        "its default, 2, is the key of first",
    ),
    "a key that is a number": (PAIRS, 'key: "2"', "key: 2", "key: 2", "should be a valid string, is 2"),
    "a target like its reference": (
        CONSTANT,
        "reference: {stiffness: 800}",
        "reference: {stiffness: 700}",
        "reference:",
        "700: no answer is correct; the target equals the reference",
    ),
    "a listed forced choice whose target nobody knows": (
        CONSTANT.replace("  reference: {stiffness: 800}\n", "").replace("repetitions: 7\n", ""),
        "cross: [stiffness]",
        "list: [{stimuli: [{stiffness: 600}, {stiffness: 600}, {stiffness: 700}]}, "
        "{stimuli: [{stiffness: 900}, {stiffness: 1000}, {stiffness: 900}], correct: two}]",
        "list:",
        "600/600/700: no answer is correct; give the trial correct",
    ),
    "overtravel without a membrane": (
        RATING,
        "measures: [peak_force_n]",
        "measures: [overtravel_m]",
        "trial:",
        "the scene has none",
    ),
    "two answers of one name": (PAIRS, "name: same", "name: first", "label: Same", "needs its own name"),
    "the key that stops": (PAIRS, 'key: "2"', "key: escape", "key: escape", "cannot be the key of an answer"),
    "no key": (PAIRS, 'key: "2"', "key: F1", "key: F1", "unknown keyboard key"),
    "no answer for a stimulus": (PAIRS, "means: second", "means: third", "means: third", "2 stimuli"),
    "equal stimuli without an answer": (
        PAIRS,
        '      - {name: same, label: Same, key: "2", means: same}\n',
        "",
        "with_itself",
        "give an answer with means",
    ),
    "asks for an unknown factor": (
        PAIRS,
        "asks: {factor: material",
        "asks: {factor: weight",
        "asks:",
        "known: material",
    ),
    "a slider that falls": (RATING, "low: 0, high: 10", "low: 10, high: 0", "  real:", "low must be less than high"),
    "unknown order": (PAIRS, "kind: blocked", "kind: block", "kind: block", "should be 'random'"),
    "blocks of what has none": (PAIRS, "kind: blocked", "kind: random", "by: condition", "has no blocks"),
    "a square of one block": (
        CONSTANT,
        "repetitions: 7",
        "repetitions: 7\norder: {kind: latin_square}",
        "order:",
        "two blocks or more",
    ),
    "a break that never is": (PAIRS, "every_trials: 5, ", "", "breaks:", "has no breaks"),
    "feedback where nothing is correct": (
        RATING,
        "time_limit_s: 30",
        "feedback: correctness",
        "feedback:",
        "no answer is defined as correct",
    ),
    "a time limit of nothing": (
        RATING,
        "time_limit_s: 30",
        "time_limit_s: 0",
        "time_limit_s",
        "should be greater than 0",
    ),
    "no repetitions": (
        RATING,
        "repetitions: 3",
        "repetitions: 0",
        "repetitions: 0",
        "should be greater than or equal to 1",
    ),
    "unknown published results": (
        PAIRS,
        "okamura1998.tapping",
        "okamura1998.taping",
        "analysis:",
        "okamura1998.tapping?",
    ),
    "a staircase without variable": (
        ADAPTIVE,
        "      variable: {name: frequency_hz, at: materials.surface.tap.frequency_hz, reference: 200, level: added}\n",
        "",
        "    one:",
        "variable: Field required",
    ),
    "a staircase of no number": (
        ADAPTIVE,
        "tap.frequency_hz, reference: 200, level: added",
        "tap, reference: 200, level: added",
        "level: added",
        "is not a number",
    ),
    "a staircase that leaves the range": (
        ADAPTIVE,
        "least: 1, most: 200, steps: [10, 5]",
        "least: -900, most: 200, steps: [10, 5]",
        "least: -900",
        "the lowest level",
    ),
    "unknown procedure": (
        ADAPTIVE,
        "kind: staircase, rule: 1-up-2",
        "kind: stair, rule: 1-up-2",
        "kind: stair,",
        "staircase",
    ),
    "practice without a level": (ADAPTIVE, "      practice_level: 100\n", "", "    one:", "needs practice_level"),
    "procedures of another type": (
        ADAPTIVE,
        "type: forced_choice",
        "type: paired_comparison",
        "type: paired",
        "procedures need type forced_choice",
    ),
    "a level that nothing has": (
        LISTED,
        "{material: wood}]",
        "{material: wod}]",
        "{material: wod}",
        "did you mean wood?",
    ),
    "a condition without trials": (
        LISTED.replace("repetitions: 2", "repetitions: 2, condition: second"),
        "  second: {}",
        "  second: {}\n  third: {}",
        "  third: {}",
        "has no trials",
    ),
    "a level without trials": (LISTED, "levels: [wood, steel]", "levels: [wood, steel, glass]", "answers:", "glass"),
    "a stimulus too many": (
        LISTED,
        "[{material: wood}]",
        "[{material: wood}, {material: steel}]",
        "{material: wood}",
        "has 1 stimuli",
    ),
    "no such correct answer": (
        LISTED,
        "condition: first}",
        "condition: first, correct: C}",
        "correct: C",
        "unknown answer",
    ),
    "an answer that names no level": (LISTED, "level: wood}", "level: wool}", "level: wool", "did you mean wood?"),
    "no reference": (CONSTANT, "  reference: {stiffness: 800}\n", "", "trial:", "needs reference"),
    "a reference that lacks a factor": (
        CONSTANT,
        "reference: {stiffness: 800}",
        "reference: {stifness: 800}",
        "reference:",
        "did you mean stiffness?",
    ),
    "a level that the material refuses": (
        CONSTANT,
        "[600, 700",
        "[-600, 700",
        "[-600",
        "should be greater than or equal to 0, is -600",
    ),
    "alternatives of a rating": (
        RATING,
        "  type: rating",
        "  type: rating\n  alternatives: 3",
        "alternatives",
        "is only valid for",
    ),
}


@pytest.mark.parametrize("text", [PAIRS, ADAPTIVE, LISTED, RATING, CONSTANT])
def test_a_valid_study_is_read_completely(text: str, tmp_path: Path) -> None:
    file = tmp_path / "study.yaml"
    file.write_text(text)
    study = load_study(file)
    again = study_of(study.to_dict())
    assert again == study
    assert plan(again, "P01", 1, 1).trials == plan(study, "P01", 1, 1).trials


def test_there_are_forty_mistakes_and_more() -> None:
    assert len(MISTAKES) >= 40


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_one_line_with_its_place(name: str, tmp_path: Path) -> None:
    good, old, new, line_text, message = MISTAKES[name]
    assert old in good
    text = good.replace(old, new, 1)
    file = tmp_path / "study.yaml"
    file.write_text(text)
    with pytest.raises(HapticdError) as caught:
        load_study(file)
    error_text = str(caught.value)
    assert message in error_text
    assert "\n" not in error_text
    if not isinstance(caught.value, InvalidError):  # a missing file has no line
        assert name == "unknown base"
        return
    lines = [number for number, line in enumerate(text.splitlines(), 1) if line_text in line]
    placed = [problem for problem in caught.value.problems if message in str(problem)]
    assert {str(problem).rsplit(".yaml:", 1)[1].split(":")[0] for problem in placed} <= {str(line) for line in lines}


def test_every_mistake_of_a_study_is_reported_at_once(tmp_path: Path) -> None:
    file = tmp_path / "study.yaml"
    text = PAIRS.replace("question: stiffer", "question: stifer").replace("kind: blocked", "kind: random")
    file.write_text(text.replace("cross: [material]", "cross: [materiel]"))
    with pytest.raises(InvalidError) as caught:
        load_study(file)
    text = str(caught.value)
    assert "materiel" in text and "stifer" in text and "has no blocks" in text


def _faults(data: dict[str, Any]) -> list[str]:
    with pytest.raises(InvalidError) as caught:
        study_of(data)
    return [problem.where for problem in caught.value.problems]


def test_a_mistake_of_a_factor_is_reported_once_and_those_of_two_variants_both() -> None:
    """Procedures, levels and places of a wrong factor give one fault; two wrong variants give two."""
    data = yaml.safe_load(ADAPTIVE)
    data["factors"] = {"decay": {"at": "materials.surface.tap.decay_time_s", "levels": [0.005, -0.02]}}
    data["trial"]["cross"] = ["decay"]
    assert _faults(data) == ["factors.decay.levels[1]"]
    data["factors"]["decay"] = {"at": "materials.surface.tap.decay", "levels": [0.005, 0.02]}
    assert _faults(data) == ["factors.decay.at"]
    data = yaml.safe_load(PAIRS)
    data["factors"]["material"]["levels"][1] = "acrilic"
    assert _faults(data) == ["factors.material.levels[1]"]
    data = yaml.safe_load(RATING)
    for variant in data["factors"]["display"]["variants"].values():
        variant["scene"]["display"] = {"vibratin": False}
    assert _faults(data) == ["factors.display.variants.silent", "factors.display.variants.ringing"]


def test_a_base_file_is_in_the_folder_of_the_study_and_its_faults_have_its_lines(tmp_path: Path) -> None:
    begin, end = PAIRS.index("base:"), PAIRS.index("places:")
    block = PAIRS[begin:end].removeprefix("base:\n")
    (tmp_path / "boxes.yaml").write_text("\n".join(line[2:] for line in block.splitlines()))
    file = tmp_path / "study.yaml"
    file.write_text(PAIRS[:begin] + "base: boxes.yaml\n" + PAIRS[end:])
    inline = tmp_path / "inline.yaml"
    inline.write_text(PAIRS)
    assert load_study(file) == load_study(inline)
    boxes = (tmp_path / "boxes.yaml").read_text()
    (tmp_path / "boxes.yaml").write_text(boxes.replace("size_m: [0.05, 0.04], material: left", "material: left"))
    with pytest.raises(InvalidError, match=r"boxes\.yaml:4:5: scene\.objects\.left\.size_m: Field required"):
        load_study(file)


def test_a_study_that_another_command_takes_is_named_so(tmp_path: Path) -> None:
    from hapticd.config.configuration import load_config

    file = tmp_path / "study.yaml"
    file.write_text(PAIRS)
    with pytest.raises(InvalidError, match="holds a study; use: hapticd experiment check"):
        load_config(file)
    scene = tmp_path / "scene.yaml"
    scene.write_text("scene: {objects: {}}")
    with pytest.raises(InvalidError, match="holds a scene"):
        load_study(scene)


def test_a_null_in_a_change_survives(tmp_path: Path) -> None:
    """null removes a key in a merge patch, and remains when a study is read, written and read again."""
    text = RATING.replace(
        "silent: {scene: {display: {vibration: false}}}", "silent: {materials: {surface: {tap: null}}}"
    )
    file = tmp_path / "study.yaml"
    file.write_text(text)
    study = load_study(file)
    again = study_of(study.to_dict())
    silent = next(each for each in plan(again, "P1", 1, 1).trials if each.cell == "800, silent")
    assert silent.stimuli[0].changes == {"materials": {"surface": {"tap": None}}}
