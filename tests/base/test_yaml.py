"""The YAML loader: scalars of the core schema, errors and their places, line numbers, and no tracebacks."""

import json
import math
import pathlib

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from hapticd.base import yaml_source
from hapticd.base.errors import HapticdError, InvalidError, Problem
from hapticd.base.yaml_source import MAX_DEPTH, MAX_YAML_BYTES, Json, load_bytes, load_path, load_text
from tests.support.marks import rest_slow

PARSERS = [yaml.BaseLoader] + ([yaml.CBaseLoader] if yaml.__with_libyaml__ else [])


@pytest.fixture(params=PARSERS, ids=lambda parser: parser.__name__, autouse=True)
def parser(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run every test with PyYAML's Python parser and with libyaml's."""
    monkeypatch.setattr(yaml_source, "_YAML_LOADER", request.param)


ONE_PARSER = pytest.mark.parametrize(
    "parser", rest_slow(reversed(PARSERS)), ids=lambda parser: parser.__name__, indirect=True
)
"""Mark of a long test: CI runs it with the default parser, `make test-slow` with both."""


def refusal(text: str | bytes) -> Problem:
    with pytest.raises(InvalidError) as caught:
        load_bytes(text if isinstance(text, bytes) else text.encode(), "f.yaml")
    (problem,) = caught.value.problems
    assert str(caught.value) == f"{problem.where}: {problem.problem}"
    assert str(caught.value).isprintable()
    return problem


# YAML 1.2.2, section 10.3.2, and 10.2.1.2 for values that the regular expressions omit.
SCALARS: list[tuple[str, Json]] = [
    *((text, None) for text in ("null", "Null", "NULL", "~", "")),
    *((text, True) for text in ("true", "True", "TRUE")),
    *((text, False) for text in ("false", "False", "FALSE")),
    *((text, text) for text in ("off", "on", "yes", "no", "y", "n", "tRUE", "nULL", "None")),
    *(
        ("0", 0),
        ("-19", -19),
        ("+12", 12),
        ("010", 10),
        ("0o17", 15),
        ("0x1F", 31),
        ("0xdeadBEEF", 0xDEADBEEF),
    ),
    *(("1e-3", 0.001), (".5", 0.5), ("1.", 1.0), ("-2.5E+3", -2500.0), ("12e03", 12000.0), ("+.5", 0.5)),
    *((".inf", math.inf), ("-.INF", -math.inf), ("+.Inf", math.inf), ("1e999", math.inf)),
    *((text, text) for text in ("0b11", "1_000", "1:30", "-0x1F", "0o8", "0x", ".", "1e", "e5", "inf", "nan")),
    *((text, text) for text in ("9" * 5000, "0x" + "f" * 5000, "1e" + "9" * 5000)),
    *((text, text) for text in ("2001-12-14", "=", "+", "-.nan", "\u0661", "1.5.2", "0X1F", "0O7")),
    *(('"1"', "1"), ("'true'", "true"), ('""', ""), ("!!str 1", "1"), ("! 1", "1"), ('"\\u00e9"', "\xe9")),
    *(
        ('!!int "3"', 3),
        ("!!float 1", 1.0),
        ('!!bool "true"', True),
        ('!!null ""', None),
        ("!!float .5", 0.5),
    ),
]


@pytest.mark.parametrize(("text", "value"), SCALARS)
def test_scalars(text: str, value: Json) -> None:
    data = load_text(f"key: {text}", "f.yaml").data
    assert data == {"key": value}
    assert isinstance(data, dict)
    assert type(data["key"]) is type(value)


@pytest.mark.parametrize("text", [".nan", ".NaN", ".NAN"])
def test_not_a_number_is_parsed(text: str) -> None:
    data = load_text(f"[{text}]", "f.yaml").data
    assert isinstance(data, list)
    assert isinstance(data[0], float)
    assert math.isnan(data[0])


def test_collections_comments_and_block_scalars() -> None:
    text = "# c\na: [1, {b: 2}]\nc:\n  - x\n  -\n  - |\n    two\n    lines\nd: !!map {}\ne: !!seq []\n..."
    assert load_text(text, "f").data == {
        "a": [1, {"b": 2}],
        "c": ["x", None, "two\nlines\n"],
        "d": {},
        "e": [],
    }


def test_merge_key_is_an_ordinary_key() -> None:
    assert load_text("a: {<<: {b: 1}}", "f").data == {"a": {"<<": {"b": 1}}}


@pytest.mark.parametrize("text", ["", "\n", "# only a comment\n", "---\n"])
def test_empty_documents_hold_null(text: str) -> None:
    document = load_text(text, "f")
    assert document.data is None
    assert document.where(("servo",)) in ("f:1:1: servo", "f:2:1: servo")


def test_a_byte_order_mark_is_not_content() -> None:
    assert load_bytes(b"\xef\xbb\xbfa: 1", "f").data == {"a": 1}


REFUSED = [
    ("a: 1\nb: 2\na: 3", "f.yaml:3:1", 'duplicate key "a"'),
    ("a: 1\n'a': 3", "f.yaml:2:1", 'duplicate key "a"'),
    ("x: {a: 1, a: 1}", "f.yaml:1:11", 'duplicate key "a"'),
    ("a: &x 1\nb: *x", "f.yaml:2:4", 'aliases are not allowed: "*x"'),
    ("a: {b: 1,\n  3: 2}", "f.yaml:2:3", "keys must be strings, this one is 3; put it in quotes"),
    (
        "x: {a: 0,5}",
        "f.yaml:1:10",
        "this one is 5; put it in quotes; for the number 0.5 write a point, not a comma",
    ),
    ("true: 1", "f.yaml:1:1", "keys must be strings, this one is true; put it in quotes"),
    ("~: 1", "f.yaml:1:1", "keys must be strings, this one is null; put it in quotes"),
    ("? [a]\n: 1", "f.yaml:1:3", "keys must be strings, this one is a list"),
    ("? {a: 1}\n: 1", "f.yaml:1:3", "keys must be strings, this one is a mapping"),
    ("a: !!binary aGk=", "f.yaml:1:4", 'tag "tag:yaml.org,2002:binary" is not allowed here'),
    ("a: !!python/object:os.system {}", "f.yaml:1:4", "is not allowed here"),
    ("a: !local 1", "f.yaml:1:4", 'tag "!local" is not allowed here'),
    ("a: !!set {}", "f.yaml:1:4", "is not allowed here"),
    ("a: !!map []", "f.yaml:1:4", "is not allowed here"),
    ("a: !!int x", "f.yaml:1:4", "is not allowed here"),
    ("a: !!bool yes", "f.yaml:1:4", "is not allowed here"),
    ("a: 1\n---\nb: 2", "f.yaml:2:1", "a second document; a file holds one"),
    ("a: 1\n...\n---\n", "f.yaml:3:1", "a second document; a file holds one"),
    ("a: 1\nb: \x07", "f.yaml:2:4", 'control character "\\u0007"'),
    ("a: \x00", "f.yaml:1:4", 'control character "\\u0000"'),
    (b"a: 1\n\nbc: \xff", "f.yaml:3:5", "not UTF-8"),
    ("a: 1".encode("utf-16"), "f.yaml:1:1", "not UTF-8, but UTF-16: save it as UTF-8"),
    (b"\xfe\xff\x00a", "f.yaml:1:1", "not UTF-8, but UTF-16: save it as UTF-8"),
    (b"a: \xed\xa0\x80", "f.yaml:1:4", "not UTF-8"),
    (b"#" * (MAX_YAML_BYTES + 1), "f.yaml:1:1", "larger than 2097152 bytes"),
]


@pytest.mark.parametrize(("text", "where", "problem"), REFUSED, ids=range(len(REFUSED)))
def test_refusals_name_file_line_and_column(text: str | bytes, where: str, problem: str) -> None:
    refused = refusal(text)
    assert refused.where == where
    assert problem in refused.problem


@pytest.mark.parametrize(
    "text", ["a: [1, 2", "a: }", "a: b: c", "a:\n\t- b", "'", '"\\q"', "%YAML 2.0\n---\n", "- a\nb"]
)
def test_broken_syntax_is_one_line(text: str) -> None:
    assert refusal(text).where.startswith("f.yaml:")


@ONE_PARSER
def test_largest_size_is_taken() -> None:
    assert load_bytes(b"#" * MAX_YAML_BYTES, "f").data is None


@pytest.mark.parametrize("opening", ["[", "{a: ", "- ", "? - ", "a:\n"])
def test_nesting_is_refused_before_it_hurts(opening: str) -> None:
    is_block = opening == "a:\n"
    text = "".join(" " * depth + opening for depth in range(200)) if is_block else opening * 100_000
    assert refusal(text).problem in (
        f"nested deeper than {MAX_DEPTH} levels",
        "keys must be strings, this one is a list",
    )


def test_deepest_nesting_is_taken() -> None:
    data = load_text("[" * MAX_DEPTH + "]" * MAX_DEPTH, "f").data
    for _ in range(MAX_DEPTH - 1):
        assert isinstance(data, list)
        (data,) = data
    assert data == []
    assert "nested" in refusal("[" * (MAX_DEPTH + 1) + "]" * (MAX_DEPTH + 1)).problem


def test_lines_of_keys_and_items() -> None:
    text = "servo:\n  rate_hz: 1\nobjects:\n  table:\n    point_m:\n      - 0\n      - 1\n"
    text += "    'odd key': [a,\n  b]\n"
    document = load_text(text, "f.yaml")
    assert document.place(()) == "f.yaml:1:1"
    assert document.place(("objects", "table", "point_m")) == "f.yaml:5:5"
    assert document.place(("objects", "table", "point_m", 1)) == "f.yaml:7:9"
    assert document.place(("objects", "table", "odd key", 1)) == "f.yaml:9:3"
    assert document.place(("servo", "rate_hz", "deeper")) == "f.yaml:2:3"
    assert document.where(("servo", "rate_hz")) == "f.yaml:2:3: servo.rate_hz"
    assert document.where(("objects", "table", "point_m", 0)) == "f.yaml:6:9: objects.table.point_m[0]"
    assert document.where(("objects", "table", "normal")) == "f.yaml:4:3: objects.table.normal"
    assert document.where(()) == "f.yaml:1:1"


def test_files(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text("a: 1")
    assert load_path(path).data == {"a": 1}
    assert load_path(str(path)).name == str(path)
    for bad in (tmp_path / "none.yaml", tmp_path, "nul\0byte"):
        with pytest.raises(HapticdError, match="cannot be read") as caught:
            load_path(bad)
        assert str(caught.value).isprintable()


json_values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(st.characters(categories=["L", "N", "P", "S", "Zs"]), max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text("abc:#-'\"{ ", max_size=8), inner, max_size=4),
    max_leaves=20,
)


@pytest.mark.long
@ONE_PARSER
@given(json_values)
def test_json_means_the_same_as_yaml(value: Json) -> None:
    assert load_text(json.dumps(value, ensure_ascii=False), "f").data == value


def only_refused(content: bytes) -> None:
    try:
        load_bytes(content, "f.yaml")
    except InvalidError as error:
        assert str(error).isprintable()


@pytest.mark.long
@ONE_PARSER
@settings(max_examples=300)
@given(st.binary(max_size=60))
def test_any_bytes_are_taken_or_refused(content: bytes) -> None:
    only_refused(content)


FRAGMENTS = [
    "- ",
    ": ",
    "? ",
    ", ",
    "[",
    "]",
    "{",
    "}",
    "\n",
    "\n  ",
    "\n\t",
    "&a ",
    "*a ",
    "!!int ",
    "!x ",
    "!<t> ",
    "! ",
]
FRAGMENTS += [
    "'",
    '"',
    "#",
    " #",
    "a",
    "b",
    "1",
    ".5",
    "~",
    "<<",
    "0x",
    "%YAML 1.2\n",
    "---\n",
    "...\n",
    "|",
    "|2-\n",
    ">\n",
]
FRAGMENTS += ["\\", "@", "`", "=", "\x85", "\ufeff", "\u2028", "\xe9"]


@pytest.mark.long
@ONE_PARSER
@settings(max_examples=500)
@given(st.lists(st.sampled_from(FRAGMENTS), max_size=25).map("".join))
def test_any_tokens_are_taken_or_refused(text: str) -> None:
    only_refused(text.encode())


@given(st.text(st.characters(), max_size=30))
def test_any_text_is_taken_or_refused_with_lone_surrogates_too(text: str) -> None:
    try:
        load_text(text, "f.yaml")
    except InvalidError as error:
        assert str(error).isprintable()


@pytest.mark.parametrize("before", ["", "a: 1\n...\n", "# first\r\n%YAML 1.2\r\n"])
def test_thousands_of_directives_are_refused_before_they_are_parsed(
    before: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """libyaml compares each directive with all before it: 2 MB of them took nine seconds."""
    text = before + "%TAG !a! x\n%TAG !b! x\n" * 30
    line = before.count("\n") + 17
    with monkeypatch.context() as patch:
        patch.setattr(yaml_source, "_YAML_LOADER", lambda _: pytest.fail("parsed"))
        with pytest.raises(InvalidError) as refused:
            load_text(text, "f.yaml")
    assert str(refused.value) == f"f.yaml:{line}:1: more than 16 %TAG directives; none is needed here"
    few = "".join(f"%TAG !a{place}! x\n" for place in range(16))
    assert load_text(few + "---\na: 1\n", "f.yaml").data == {"a": 1}


@pytest.mark.parametrize(
    "large",
    [
        "a: 1\n...\n" + "%TAG !t! x\n" * 30,
        "&a " * 3000,
        "*a " * 3000,
        "[" * 30_000,
        "{a: " * 30_000,
        "- " * 30_000,
        "? " * 30_000,
        "'" + "''" * 30_000,
        '"' + "\\u0041" * 30_000,
        "|\n" + "  x\n" * 30_000,
        ">\n" + "\n" * 30_000,
        "#" * 30_000,
        "a: " + "1" * 30_000,
    ],
    ids=lambda text: repr(text[:8]),
)
def test_much_of_the_same_is_taken_or_refused_in_one_line(large: str) -> None:
    try:
        load_text(large, "f.yaml")
    except InvalidError as error:
        assert str(error).startswith("f.yaml:") and str(error).isprintable()
