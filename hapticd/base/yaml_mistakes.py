"""What a person most likely did who wrote YAML that is none, or that says something else than was meant.

`diagnose` turns a parser's complaint into the place and the words of the slip: a parser gives up where it can go on no
longer, which is often lines below the colon, quote or bracket that is missing. `hint` is for text that YAML takes as a
plain string although somebody meant a number, a list or a mapping. Both only read text; nothing is repaired.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, TypeAlias

LINE_BREAKS: Final = re.compile("\r\n|[\r\n\x85\u2028\u2029]")
"""What ends a line in YAML."""
_CLOSING: Final = {"[": "]", "{": "}"}
_COLON: Final = re.compile(r":(?=\s|$)")
_WORD: Final = re.compile(r"[^\s:=,\[\]{}]+")
_NUMBER: Final = r"[-+]?[\d.]+(?:[eE][-+]?\d+)?"
_TAB: Final = "a tab; YAML indents by spaces"
_MOST_LEVELS: Final = 4
_LONGEST_LINE: Final = 4096
"""Nobody wrote a longer one by hand; what looks for a slip looks at the whole line again and again."""

Place: TypeAlias = tuple[int, int]
"""Line and column, from 0."""


class Slip(NamedTuple):
    """Where it is, and what it is; the place counts from 0."""

    line: int
    column: int
    words: str


def hint(text: str) -> str:
    """What was probably meant by a string where none belongs, to be put behind a message; empty where nobody knows."""
    if re.fullmatch(r"[-+]?\d+,\d+", text):
        return "; decimals have a point, not a comma"
    if re.match(r"[\u201c\u201d\u2018\u2019]", text):
        return "; quotes are straight: \" or '"
    if text.startswith("(") or text.endswith(")"):
        return "; lists stand in [ ], not in ( )"
    if text.endswith("]") and "[" not in text:
        return "; the [ is missing"
    if re.fullmatch(rf"{_NUMBER}(\s+{_NUMBER})+", text):
        return "; between two numbers belongs a comma, after the - of a list a space"
    found = _key_slip(text)
    return f"; {found}" if found else ""


def key_hint(key: str, value: object) -> str:
    """As `hint`, of an unknown key; in braces, `kind wall` and `kind:wall` are keys without a value."""
    if key[:1] in "\u00a0\u3000\u2007\u202f":
        return "a no-break space stands where a space belongs; "
    found = _key_slip(key) if value is None else None
    return f"{found}; " if found else ""


def _key_slip(text: str) -> str | None:
    """What is wrong with `key value`, `key:value` and `key = value`."""
    match = re.match(r"([^\W\d]\w*)(:(?=[^\s/])|\s*=\s*|\s+(?=\S))", text)
    if match is None:
        return None
    if "=" in match[2]:
        return f"after {match[1]} belongs a colon, not ="
    if match[2] == ":":
        return f"a space is missing after {match[1]}:"
    return f"a colon is missing after {match[1]}"


def diagnose(text: str, problem: str, at: Place, context: Place | None) -> Slip:
    """The slip behind what the parser said of `text`: `problem` where it gave up, `context` where that began."""
    lines = LINE_BREAKS.split(text)
    at = min(at[0], len(lines) - 1), at[1]
    if max(map(len, lines)) > _LONGEST_LINE:
        return Slip(*at, problem)
    brackets = _scan(lines)
    found = (
        _tab(lines, at, brackets)
        or _quote_or_bracket(lines, at, brackets)
        or _by_complaint(lines, problem, at, context)
        or _last_bracket(brackets)
    )
    return found or Slip(*at, problem)


@dataclass(slots=True)
class _Brackets:
    """What the text opens and closes, outside comments; places of the first that does not fit."""

    open_at: list[list[Place]]
    """Brackets that are open where each line begins."""
    bad_quote: tuple[Place, str] | None = None
    crossed: tuple[Place, str, str] | None = None
    """A bracket that another kind than its own closes."""
    unclosed: tuple[Place, str] | None = None


def _scan(lines: Sequence[str]) -> _Brackets:
    found = _Brackets([])
    stack: list[tuple[Place, str]] = []
    quote: tuple[Place, str] | None = None
    for row, line in enumerate(lines):
        found.open_at.append([place for place, _ in stack])
        column, fresh = 0, not stack
        after_quote = False
        while column < len(line):
            char = line[column]
            if quote is not None:
                if char == "\\" and quote[1] == '"':
                    column += 1
                elif char == quote[1]:
                    if char == "'" and line[column + 1 : column + 2] == "'":
                        column += 1
                    else:
                        after_quote, opened, quote = True, quote, None
                        rest = line[column + 1 :].lstrip()
                        if found.bad_quote is None and opened[0][0] != row and rest and rest[0] not in ",]}:#":
                            found.bad_quote = opened
            elif char == "#" and (column == 0 or line[column - 1].isspace()):
                break
            elif char.isspace():
                pass
            else:
                before = line[:column].rstrip()
                starts = fresh or before[-1:] in tuple(",[{") or before[-1:] == ":" or before in ("-", "?")
                starts = starts or not before or (before.endswith(" -") and not before[:-2].strip())
                if char in "\"'" and starts and not after_quote:
                    quote = ((row, column), char)
                elif char in _CLOSING and (stack or starts):
                    stack.append(((row, column), char))
                elif stack and char in _CLOSING.values():
                    place, opened_by = stack.pop()
                    if found.crossed is None and _CLOSING[opened_by] != char:
                        found.crossed = (place, opened_by, char)
                fresh, after_quote = False, False
            column += 1
    if quote is not None and found.bad_quote is None:
        found.bad_quote = quote
    if stack:
        found.unclosed = stack[-1]
    return found


def _tab(lines: Sequence[str], at: Place, brackets: _Brackets) -> Slip | None:
    line = lines[at[0]]
    indentation = line[: len(line) - len(line.lstrip(" \t"))]
    if "\t" in indentation and not brackets.open_at[at[0]]:
        return Slip(at[0], indentation.index("\t"), _TAB)
    return None


def _quote_or_bracket(lines: Sequence[str], at: Place, brackets: _Brackets) -> Slip | None:
    if brackets.bad_quote is not None and brackets.bad_quote[0] <= at:
        place, char = brackets.bad_quote
        return Slip(*place, f"the {char} that begins here is not closed")
    if brackets.crossed is not None and brackets.crossed[0] <= at:
        place, opened, closed = brackets.crossed
        return Slip(*place, f"the {opened} that begins here is closed by {closed}, not by {_CLOSING[opened]}")
    if brackets.unclosed is not None and brackets.unclosed[0] <= at:
        place, opened = brackets.unclosed
        return Slip(*place, f"the {opened} that begins here is not closed by {_CLOSING[opened]}")
    char = lines[at[0]][at[1] : at[1] + 1]
    if char in ("]", "}"):
        return Slip(*at, f"a {char} too many: nothing is open that it would close")
    return None


def _last_bracket(brackets: _Brackets) -> Slip | None:
    if brackets.unclosed is None:
        return None
    place, opened = brackets.unclosed
    return Slip(*place, f"the {opened} that begins here is not closed by {_CLOSING[opened]}")


def _by_complaint(lines: Sequence[str], problem: str, at: Place, context: Place | None) -> Slip | None:
    # libyaml and PyYAML's own parser say the same in other words.
    if "mapping values are not allowed" in problem:
        return _unexpected_colon(lines, at)
    if "expected ':'" in problem and context is not None:
        return _colon_missing(lines, context[0])
    if "expected ',' or" in problem:
        return _comma_missing(lines, at)
    if "cannot start any token" in problem:
        return _forbidden_start(lines, at)
    if "escape" in problem:
        return Slip(*at, "in double quotes a backslash begins an escape; in single quotes it is itself")
    if "expected key" in problem or "expected <block end>" in problem or "document start" in problem:
        return _indentation(lines, at)
    return None


def _before(lines: Sequence[str], row: int) -> int | None:
    """The next line above that holds more than a comment."""
    return next((above for above in range(row - 1, -1, -1) if _content(lines[above])), None)


def _content(line: str) -> str:
    """A line without indentation, comment and what follows it."""
    return re.sub(r"(^|\s)#.*", "", line).strip()


def _column(line: str) -> int:
    return len(line) - len(line.lstrip())


def _unexpected_colon(lines: Sequence[str], at: Place) -> Slip | None:
    row, column = at
    above = _before(lines, row)
    if above is not None and _has_no_colon(_content(lines[above])):
        return _colon_missing(lines, above)
    if _COLON.search(lines[row][:column]):
        return Slip(row, column, "a second colon in a line; put a value that holds one in quotes")
    if above is not None and _column(lines[row]) > _column(lines[above]):
        text = "indented deeper than the line above, which has its value already; keys side by side begin in one column"
        return Slip(row, _column(lines[row]), text)
    return None


def _has_no_colon(content: str) -> bool:
    """Whether a line is a key, with or without a value, but for its colon."""
    return bool(re.match(r"[^\W\d]", content)) and content[-1] not in "]},\"'" and not _COLON.search(content)


def _colon_missing(lines: Sequence[str], row: int) -> Slip | None:
    content, start = _content(lines[row]), _column(lines[row])
    word = _WORD.match(content)
    if word is None:
        return None
    slip = _key_slip(content)
    return Slip(row, start + word.end(), slip or f"a colon is missing after {word[0]}")


def _comma_missing(lines: Sequence[str], at: Place) -> Slip | None:
    row, column = at
    line = lines[row]
    if line[column : column + 1] == ":":
        key = re.search(r"(\S+)\s*$", line[:column])
        return Slip(row, key.start(), f"a comma is missing before {key[1]}") if key else None
    before = re.search(r"(\w+)\s*$", line[:column])
    if before and line[column : column + 1] in tuple("[{\"'"):
        return Slip(row, before.end(1), f"a colon is missing after {before[1]}")
    here = _WORD.match(line[column:])
    if here is not None:
        return Slip(row, column, f"a comma is missing before {here[0]}")
    return Slip(row, column, "a comma is missing before this")


def _forbidden_start(lines: Sequence[str], at: Place) -> Slip | None:
    rest = lines[at[0]][at[1] :]
    if rest.startswith("\t"):
        return Slip(*at, _TAB)
    if rest.startswith("```"):
        return Slip(*at, "``` belongs to the page that this was copied from, not to YAML")
    return Slip(*at, f"{rest[:1]} cannot begin a value; put the value in quotes") if rest else None


def _indentation(lines: Sequence[str], at: Place) -> Slip | None:
    row, column = at
    own = _column(lines[row])
    if column > own:
        rest = lines[row][column:].strip()
        comment = "; a comment begins with #" if rest.startswith(("//", "/*", ";", "--")) else ""
        return Slip(row, column, f"the value ends before this{comment}")
    before = _before(lines, row)
    if before is not None and own > _column(lines[before]) and _has_no_colon(_content(lines[before])):
        return _colon_missing(lines, before)
    levels: list[int] = []
    for above in range(row):
        if _content(lines[above]):
            level = _column(lines[above])
            levels = [*(each for each in levels if each < level), level]
    if not levels or own in levels:
        return None
    widths = " or ".join(map(str, levels[-_MOST_LEVELS:]))
    return Slip(row, own, f"indented by {own}, but the lines above that it could belong to by {widths}")
