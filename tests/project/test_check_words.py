"""The check of words finds the words that the guide avoids, and no others."""

from __future__ import annotations

import pytest

from tests.project.check_words import GUIDE, avoided_words, findings

WORDS = avoided_words(GUIDE.read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ('"""What is told of a tap."""\n', ["told"]),
        ("x = 1  # Beside the wall.\n", ["Beside"]),
        ('raise ValueError(f"{name} is none of\\nthem")\n', ["is none"]),
        ('"""It waits so long."""\n', ["so long"]),
        ('"""It waits so long as the\nwhole scene goes on."""\n', ["goes on", "whole"]),
        ("LASTS = 7.0\n", ["LASTS"]),
        ("_REST_S: float = 7.0\n", ["_REST_S"]),
    ],
)
def test_a_word_to_avoid_is_found(source: str, found: list[str]) -> None:
    assert sorted(one.found for one in findings(source, WORDS)) == sorted(found)


@pytest.mark.parametrize(
    "source",
    [
        "FIT_DECAY_TIMES = 7.0\n",
        'told = apart["whole"]\n',
        '"""There is no wall, and the count is a whole number: see `told`."""\n',
        '"""As long as it is not so long as that."""\n',
        "class Limits:\n    LASTS = 1\n",
    ],
)
def test_other_words_pass(source: str) -> None:
    assert findings(source, WORDS) == []


def test_a_finding_names_its_line_and_what_to_write() -> None:
    (finding,) = findings('x = 1\ny = """First line.\n\nGone anew."""\n', WORDS)
    assert (finding.line, finding.found, finding.advice) == (4, "anew", "again")


@pytest.mark.parametrize(
    ("suffix", "text", "found"),
    [
        (".md", "A page.\n\nIt is told anew.\n", [3, 3]),
        (".md", "`told`\n\n    told\n\n```\ntold\n```\n<!-- told -->\nIt is beside.\n", [9]),
        (".h", "/* First line.\n * It is told. */\nint told;\n", [2]),
        (".js", "const told = 1; // the whole scene\n", [1]),
    ],
)
def test_pages_and_comments_of_other_languages_are_read(suffix: str, text: str, found: list[int]) -> None:
    assert [one.line for one in findings(text, WORDS, suffix)] == found
