"""Reader of YAML: text in, plain data and line numbers out.

Scalars follow the core schema of YAML 1.2.2 (10.3): `off` and `"1"` are strings, `1e-3` is a number, and `<<` has no
special meaning. Errors, each with file, line and column, are: duplicate keys, keys that are not strings, aliases, tags
outside the core schema, several documents, nesting beyond MAX_DEPTH, a size above MAX_YAML_BYTES, and bytes that are
not UTF-8.

PyYAML only tokenises; data is built here from its events, without recursion.
"""

import os
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import islice
from typing import TypeAlias

import yaml

from hapticd.base.errors import HapticdError, InvalidError, Problem, path_text, quoted, shown

LINE_BREAKS = re.compile("\r\n|[\r\n\x85\u2028\u2029]")
MAX_DEPTH = 32
"""Maximum nesting of mappings and lists."""
_TOO_DEEP = "exceeded maximum nesting depth"
"""Text of the depth check of libyaml from 0.2.6 on (PyYAML 6.0.4), which may precede the check of this module."""
MAX_YAML_BYTES = 2 * 1024 * 1024

Json: TypeAlias = "bool | int | float | str | list[Json] | dict[str, Json] | None"
"""Plain data: what YAML, JSON and msgpack have in common."""

# Both loaders give the same events; that of libyaml is about 20 times faster and is in every wheel of PyYAML.
_YAML_LOADER: "type[yaml.CBaseLoader] | type[yaml.BaseLoader]" = (
    yaml.CBaseLoader if yaml.__with_libyaml__ else yaml.BaseLoader
)

_CORE_SCHEMA_TAG = "tag:yaml.org,2002:"
_NULL_PATTERN = re.compile(r"null|Null|NULL|~|")
_BOOL_PATTERN = re.compile(r"true|True|TRUE|false|False|FALSE")
_INT_PATTERN = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT_PATTERN = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_MAX_NUMBER_CHARACTERS = 400
"""A longer scalar is a string, even if it consists of digits."""
_TAG_DIRECTIVE = re.compile("(?:^|[\n\r\x85\u2028\u2029])%TAG")
_MAX_TAG_DIRECTIVES = 16
"""More are refused: libyaml compares each directive with all before it, in a time of the square of their number."""
_UTF_16 = (b"\xff\xfe", b"\xfe\xff")
_UNPRINTABLE_PATTERN = re.compile("[^\t\n\r\x20-\x7e\x85\xa0-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@dataclass(slots=True)
class Marks:
    """Line and column, from 1, of a value (in a mapping, of its key), and the same of the value's members."""

    line: int
    column: int
    children: dict[str | int, "Marks"]


_NO_CHILDREN: dict[str | int, Marks] = {}
"""The members of a scalar: an empty mapping that all scalars share."""


@dataclass(frozen=True, slots=True)
class Document:
    """A parsed document: its data, and the place of each value in the file `name`, which is None without a file."""

    data: Json
    name: str | None = None
    _marks: Marks | None = None
    _above: tuple[str, ...] = ()

    @property
    def folder(self) -> str:
        """The folder of the file, where relative paths in it begin; links are not followed.

        A mapping, the standard input (/dev/stdin) and a pipe have no folder. Their paths begin in the current one.
        """
        folder = os.path.dirname(os.path.abspath(self.name or ""))
        has_folder = self.name is not None and folder not in ("/dev", "/dev/fd") and os.path.isfile(self.name)
        return folder if has_folder else os.getcwd()

    def below(self, key: str) -> "Document":
        """Return a document in which this one is the value of `key`; lines and columns stay the same."""
        return replace(self, data={key: self.data}, _above=(key, *self._above))

    def mapping(self, known: Iterable[str]) -> dict[str, Json]:
        """Return the data, which must be a mapping. Raises InvalidError, which lists the keys `known`, otherwise."""
        if isinstance(self.data, dict):
            return self.data
        text = "is empty" if self.data is None else "must be a mapping"
        raise InvalidError([self.problem((), f"{text}; known keys: {', '.join(known)}")])

    def problem(self, path: Sequence[str | int], text: str) -> Problem:
        """Return the fault `text` of the value at `path`, with its place in the file."""
        return Problem(self.where(path), text)

    def place(self, path: Sequence[str | int]) -> str:
        """Return `FILE:LINE:COLUMN` of the key or list item at `path`, or of the nearest one that contains it."""
        marks = near = self._marks
        for element in self.own(path):
            marks = None if marks is None else marks.children.get(element)
            near = near if marks is None else marks
        line, column = (1, 1) if near is None else (near.line, near.column)
        return f"{printable(self.name or '')}:{line}:{column}"

    def own(self, path: Sequence[str | int]) -> Sequence[str | int]:
        """Return the path of a value as it is in the file, without the keys that `below` added."""
        return path[len(self._above) :]

    def where(self, path: Sequence[str | int]) -> str:
        """Return place and path of a value as text: `FILE:LINE:COLUMN: servo.rate_hz`, or without a file the path."""
        text = path_text(self.own(path))
        if self.name is None:
            return text
        return f"{self.place(path)}: {text}" if text else self.place(path)


@dataclass(slots=True)
class _Open:
    """A collection that is being read; in a mapping, `key` is the key whose value comes next."""

    data: "list[Json] | dict[str, Json]"
    marks: Marks
    key: str | None = None
    key_at: tuple[int, int] = (0, 0)


def load_path(path: "str | os.PathLike[str]") -> Document:
    """Read a YAML file.

    Raises InvalidError (one problem, `where` is FILE:LINE:COLUMN) for text that is refused, HapticdError for a file
    that cannot be read.
    """
    name = os.fspath(path)
    return load_bytes(read_file(name, MAX_YAML_BYTES), name)


def read_file(name: str, max_bytes: int) -> bytes:
    """Return at most the first `max_bytes` + 1 bytes of a file. Raises HapticdError if it cannot be read."""
    try:
        with open(name, "rb") as file:
            return file.read(max_bytes + 1)
    except OSError as error:
        raise HapticdError(f"{printable(name)}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise HapticdError(f"{printable(name)}: cannot be read: {error}") from None


def load_bytes(content: bytes, name: str) -> Document:
    """Parse a YAML document in UTF-8; `name` is the file's name in messages. Raises InvalidError as `load_path`."""
    if content.startswith(b"PK\x03\x04"):
        raise InvalidError([Problem(printable(name), "an archive, not YAML; for a recording use: hapticd replay")])
    if len(content) > MAX_YAML_BYTES:
        raise _refusal(name, 0, 0, f"larger than {MAX_YAML_BYTES} bytes")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        before = error.object[: error.start].decode("utf-8-sig")
        reason = "not UTF-8, but UTF-16: save it as UTF-8" if content.startswith(_UTF_16) else "not UTF-8"
        raise _refusal(name, *_line_column(before), reason) from None
    return _parse(text, name, _YAML_LOADER)


def load_text(text: str, name: str) -> Document:
    """Parse a YAML document; `name` is the file's name in messages. Raises InvalidError as `load_path`."""
    return load_bytes(text.encode("utf-8", "surrogatepass"), name)


def _parse(text: str, name: str, loader: "type[yaml.CBaseLoader] | type[yaml.BaseLoader]") -> Document:
    bad = _UNPRINTABLE_PATTERN.search(text)
    if bad:
        raise _refusal(name, *_line_column(text[: bad.start()]), f"control character {quoted(bad.group())}")
    tag = next(islice(_TAG_DIRECTIVE.finditer(text), _MAX_TAG_DIRECTIVES, None), None)
    if tag:
        where = _line_column(text[: tag.end() - len("%TAG")])
        raise _refusal(name, *where, f"more than {_MAX_TAG_DIRECTIVES} %TAG directives; none is needed here")
    try:
        return _build(loader(text), name)
    except yaml.MarkedYAMLError as error:
        raise _refusal(name, *_complaint(text, error)) from None


def _complaint(text: str, error: yaml.MarkedYAMLError) -> tuple[int, int, str]:
    """Return line and column, from 0, and text of an error of PyYAML; tabs in the indentation get a clearer text."""
    mark, problem = error.problem_mark, error.problem or "not YAML"
    line, column = (0, 0) if mark is None else (mark.line, mark.column)
    if problem == _TOO_DEEP:
        return line, column, f"nested deeper than {MAX_DEPTH} levels"
    rows = LINE_BREAKS.split(text)
    row = rows[min(line, len(rows) - 1)]
    indentation = row[: len(row) - len(row.lstrip(" \t"))]
    if "\t" in indentation:
        return line, indentation.index("\t"), "a tab; YAML is indented by spaces"
    begun = error.context_mark
    if error.context and begun is not None:
        problem += f", {error.context} at {begun.line + 1}:{begun.column + 1}"
    return line, column, problem


def _build(parser: "yaml.CBaseLoader | yaml.BaseLoader", name: str) -> Document:
    root: Document | None = None
    stack: list[_Open] = []
    while parser.check_event():
        event = parser.get_event()
        assert event is not None
        assert event.start_mark is not None
        line, column = event.start_mark.line, event.start_mark.column

        def refuse(problem: str, line: int = line, column: int = column) -> InvalidError:
            return _refusal(name, line, column, problem)

        # The most frequent events are matched first.
        match event:
            case yaml.ScalarEvent() | yaml.CollectionStartEvent():
                value = _value(event, refuse)
                top = stack[-1] if stack else None
                if top is not None and isinstance(top.data, dict) and top.key is None:
                    top.key, top.key_at = _key(value, top.data, refuse), (line + 1, column + 1)
                    continue
                marks = Marks(line + 1, column + 1, {} if isinstance(value, dict | list) else _NO_CHILDREN)
                if top is None:
                    root = Document(value, name, marks)
                elif isinstance(top.data, dict):
                    assert top.key is not None
                    marks.line, marks.column = top.key_at
                    top.data[top.key] = value
                    top.marks.children[top.key] = marks
                    top.key = None
                else:
                    top.marks.children[len(top.data)] = marks
                    top.data.append(value)
                if isinstance(value, dict | list):
                    if len(stack) == MAX_DEPTH:
                        raise refuse(f"nested deeper than {MAX_DEPTH} levels")
                    stack.append(_Open(value, marks))
            case yaml.MappingEndEvent() | yaml.SequenceEndEvent():
                stack.pop()
            case yaml.AliasEvent():
                raise refuse(f"aliases are not allowed: {quoted(f'*{event.anchor}')}")
            case yaml.DocumentStartEvent() if root is not None:
                raise refuse("a second document; a file holds one")
    return root or Document(None, name, Marks(1, 1, {}))


def _key(value: Json, mapping: dict[str, Json], refuse: Callable[[str], InvalidError]) -> str:
    if not isinstance(value, str):
        hint = "" if isinstance(value, dict | list) else "; put it in quotes"
        before = next(reversed(mapping.values()), None)
        if type(before) is int and type(value) is int:  # 0,5 in braces
            hint += f"; for the number {before}.{value} write a point, not a comma"
        raise refuse(f"keys must be strings, this one is {shown(value)}{hint}")
    if value in mapping:
        raise refuse(f"duplicate key {quoted(value)}")
    return value


def _value(event: "yaml.ScalarEvent | yaml.CollectionStartEvent", refuse: Callable[[str], InvalidError]) -> Json:
    if isinstance(event, yaml.ScalarEvent):
        return _scalar(event, refuse)
    is_mapping = isinstance(event, yaml.MappingStartEvent)
    if event.tag not in (None, "!", _CORE_SCHEMA_TAG + ("map" if is_mapping else "seq")):
        raise refuse(f"tag {quoted(event.tag)} is not allowed here")
    return {} if is_mapping else []


def _scalar(event: yaml.ScalarEvent, refuse: Callable[[str], InvalidError]) -> Json:
    text: str = event.value
    tag = event.tag
    if tag is None and not event.implicit[0]:
        return text
    if tag in ("!", _CORE_SCHEMA_TAG + "str"):
        return text
    known, value = _core(text, tag) if len(text) <= _MAX_NUMBER_CHARACTERS else (False, None)
    if known:
        return value
    if tag is None:
        return text
    raise refuse(f"tag {quoted(tag)} is not allowed here")


@lru_cache(maxsize=4096)
def _core(text: str, tag: str | None) -> tuple[bool, Json]:
    """Return whether the core schema reads a scalar as null, true, false or a number, and its value.

    Results are cached, since large files repeat values.
    """
    if tag in (None, _CORE_SCHEMA_TAG + "null") and _NULL_PATTERN.fullmatch(text):
        return True, None
    if tag in (None, _CORE_SCHEMA_TAG + "bool") and _BOOL_PATTERN.fullmatch(text):
        return True, text[0] in "tT"
    if tag in (None, _CORE_SCHEMA_TAG + "int") and _INT_PATTERN.fullmatch(text):
        return True, int(text, 0) if text[:2] in ("0o", "0x") else int(text)
    if tag in (None, _CORE_SCHEMA_TAG + "float") and _FLOAT_PATTERN.fullmatch(text):
        return True, float(text.replace(".", "") if text[-1] in "fFnN" else text)
    return False, None


def _line_column(before: str) -> tuple[int, int]:
    lines = LINE_BREAKS.split(before)
    return len(lines) - 1, len(lines[-1])


def printable(text: str) -> str:
    """Return a file's name or other text for a message: quoted if it has unprintable characters, else unchanged."""
    return text if text.isprintable() else quoted(text)


def _refusal(name: str, line: int, column: int, problem: str) -> InvalidError:
    return InvalidError([Problem(f"{printable(name)}:{line + 1}:{column + 1}", printable(problem))])
