"""Changing a YAML text in place: only values that differ are replaced, everything else stays byte for byte."""

from __future__ import annotations

import copy
import difflib
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hapticd.base.yaml_source import load_text
from hapticd.config.shipped_files import shipped
from hapticd.web.yaml_editing import edited, same

TEXT = """\
# A floor.
scene:
  objects:
    floor: {kind: wall, point_m: [0, 0],   # where it is
            material: wood}                # what of
    side:
      kind: wall
      normal: [1e0, 0]  # to the right

      # patches, from left to right
      patches:
        - {from_m: -0.01, to_m: 0, material: 'off'}   # left
        - {from_m: 0, to_m: 0.01, material: "glass"}  # right
  ramp_s:   0.05    # slow
"""


def change(make: Callable[[Any], None], text: str = TEXT) -> tuple[list[str], list[str]]:
    """Return the removed and the added lines."""
    data = copy.deepcopy(load_text(text, "").data)
    assert isinstance(data, dict)
    make(data)
    new, kept = edited(text, data)
    assert kept
    assert same(load_text(new, "").data, data)
    diff = [line for line in difflib.ndiff(text.splitlines(), new.splitlines()) if line[0] in "+-"]
    return [line[2:] for line in diff if line[0] == "-"], [line[2:] for line in diff if line[0] == "+"]


def test_a_number_changes_and_its_comment_and_spaces_stay() -> None:
    assert change(lambda data: data["scene"].update(ramp_s=0.1)) == (
        ["  ramp_s:   0.05    # slow"],
        ["  ramp_s:   0.1    # slow"],
    )


def test_a_member_of_a_mapping_on_one_line() -> None:
    removed, added = change(lambda data: data["scene"]["objects"]["floor"].update(material="glass", normal=[0, 1]))
    assert removed == ["            material: wood}                # what of"]
    assert added == ["            material: glass, normal: [0, 1]}                # what of"]


def test_an_object_that_is_added_stands_behind_the_others() -> None:
    removed, added = change(lambda data: data["scene"]["objects"].update(peg={"kind": "disc", "radius_m": 0.005}))
    assert (removed, added) == ([], ["    peg: {kind: disc, radius_m: 0.005}"])


def test_an_object_that_is_taken_away_takes_its_lines_along() -> None:
    removed, added = change(lambda data: data["scene"]["objects"].pop("side"))
    assert added == []
    assert removed[0] == "    side:" and removed[-1].endswith("# right")


def test_patches_are_added_and_taken_away_at_the_end() -> None:
    def patches(data: Any) -> list[Any]:
        found: list[Any] = data["scene"]["objects"]["side"]["patches"]
        return found

    removed, added = change(lambda data: patches(data).append({"from_m": 0.01, "to_m": 0.02, "material": "steel"}))
    assert (removed, added) == ([], ["        - {from_m: 0.01, to_m: 0.02, material: steel}"])
    removed, added = change(lambda data: patches(data).pop())
    assert (removed, added) == (['        - {from_m: 0, to_m: 0.01, material: "glass"}  # right'], [])


def test_a_section_that_is_added_stands_at_the_end() -> None:
    removed, added = change(lambda data: data.update(materials={"wood": {"stiffness_n_per_m": 900}}))
    assert (removed, added) == ([], ["materials:", "  wood: {stiffness_n_per_m: 900}"])


def test_nothing_changed_is_nothing_written() -> None:
    data: Any = load_text(TEXT, "").data
    assert edited(TEXT, data) == (TEXT, True)
    data["scene"]["objects"]["floor"]["point_m"] = [0.0, -0.0]
    assert edited(TEXT, data) == (TEXT, True)


@pytest.mark.parametrize(
    "text",
    [
        "a: 1\r\nb: {c: 2}\r\n",
        "\ufeffa: 1\nb: {c: 2}\n",
        "a: 1\nb: {c: 2}",
        "# ä\N{GRINNING FACE}\na: 1 # ü\nb: {c: 2}\n",
        "--- # first\na: 1\nb: {c: 2}\n...\n",
        "{a: 1, b: {c: 2}}",
        '"a": 1\n? b\n: {c: 2}\n',
        "a: &x 1\nb: !!map {c: 2}\n",
        "a: 1\nb:\n# comment\n  c: 2\n",
    ],
)
def test_other_forms_of_a_text(text: str) -> None:
    wanted: dict[str, Any] = {"a": 3, "b": {"c": 4, "d": [1, {"e": "off"}]}, "f": True}
    new, _ = edited(text, wanted)
    assert same(load_text(new, "").data, wanted)
    assert ("\r\n" in text) == ("\r\n" in new) and text.startswith("\ufeff") == new.startswith("\ufeff")


def test_true_and_1_are_not_the_same() -> None:
    assert edited("a: true\n", {"a": 1}) == ("a: 1\n", True)
    assert not same([True], [1]) and same({"a": [1]}, {"a": [1.0]})


STRINGS = ("off", "1", "", "# a", "a: b", "null", "- x", "ä")
values = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(-1000, 1000), st.floats(-1e6, 1e6), st.sampled_from(STRINGS)),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from("abcde"), inner, max_size=3),
    max_leaves=12,
)


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(st.dictionaries(st.sampled_from("abcde"), values, min_size=1, max_size=4), st.data())
def test_whatever_is_changed_is_read_back(after: dict[str, Any], data: st.DataObject) -> None:
    before = data.draw(st.dictionaries(st.sampled_from("abcde"), values, min_size=1, max_size=4))
    first, _ = edited("a: # first\n  b: 1 # comment\n", before)
    new, _ = edited(first, after)
    assert same(load_text(new, "").data, after)


@pytest.mark.parametrize("file", [*shipped("scenes").values(), *shipped("materials").values()])
def test_a_number_of_a_shipped_file_changes_one_line(file: str) -> None:
    with open(file, encoding="utf-8") as opened:
        text = opened.read()

    def first_number(tree: Any) -> bool:
        items = (
            list(tree.items()) if isinstance(tree, dict) else list(enumerate(tree)) if isinstance(tree, list) else []
        )
        for key, value in items:
            if type(value) in (int, float):
                tree[key] = value + 0.5
                return True
            if first_number(value):
                return True
        return False

    removed, added = change(lambda data: assert_(first_number(data)), text)
    assert len(removed) == len(added) == 1


def assert_(found: bool) -> None:
    assert found
