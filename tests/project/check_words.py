"""Check the wording of code and pages: `python -m tests.project.check_words [FILE ...]` prints each place to mend.

A place is an expression of the table "Words to avoid" (docs/contributing.md) in a comment, a docstring, a text of
several words or a page, or a module constant of one word, which says neither quantity nor unit.
"""

from __future__ import annotations

import ast
import io
import re
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

ROOT: Final = Path(__file__).resolve().parents[2]
GUIDE: Final = ROOT / "docs" / "contributing.md"

CHECKED_FILES: Final = ("README.md", "csrc/**/*.[ch]", "docs/**/*.md", "hapticd/**/*.js", "hapticd/**/*.py")
UNCHECKED_PATHS: Final = (GUIDE, ROOT / "docs" / "adr", ROOT / "hapticd" / "web" / "static" / "vendor")
"""The guide quotes what it avoids, records of decisions are history, and other packages have their words."""

ONE_WORD_CONSTANT: Final = re.compile(r"_?[A-Z]{3,}(_(S|MS|US|NS|HZ|M|N|BYTES))?")


class Finding(NamedTuple):
    """A place to mend: line number, what was found and what to write."""

    line: int
    found: str
    advice: str


def avoided_words(guide: str) -> list[tuple[re.Pattern[str], str]]:
    """Read the table of words to avoid from the text of docs/contributing.md.

    Returns pairs of a pattern, which ignores case, and the words to write.
    """
    table = guide.partition("### Words to avoid\n")[2].partition("\n#")[0]
    rows = [(cell.replace(r"\|", "|"), advice) for cell, advice in re.findall(r"^\| `(.+?)` \| (.+?) \|$", table, re.M)]
    return [(re.compile(rf"(?<![\w.`-])(?:{pattern})(?![\w`-])", re.I), advice) for pattern, advice in rows]


def _prose(text: str, suffix: str) -> Iterator[tuple[int, str]]:
    """Yield the parts of a file that people read, each with the number of its first line."""
    if suffix == ".md":
        # Blocks, comments and code are replaced by a space and their line breaks, so that line numbers stay.
        unread = re.compile(r"^```.*?^```|^(?: {4}[^\n]*\n)+|<!--.*?-->|`[^`]*`", re.S | re.M)
        yield 1, unread.sub(lambda match: " " + "\n" * match.group().count("\n"), text)
    elif suffix == ".py":
        for token in tokenize.generate_tokens(io.StringIO(text).readline):
            is_text = token.type == tokenize.STRING or token.type == getattr(tokenize, "FSTRING_MIDDLE", -1)
            if token.type == tokenize.COMMENT or (is_text and " " in token.string.strip("\"' ")):
                yield token.start[0], token.string
    else:
        for comment in re.finditer(r"/\*.*?\*/|//[^\n]*", text, re.S):
            yield 1 + text.count("\n", 0, comment.start()), comment.group()


def _one_word_constants(source: str) -> Iterator[Finding]:
    for statement in ast.parse(source).body:
        targets = statement.targets if isinstance(statement, ast.Assign) else [getattr(statement, "target", None)]
        for target in targets:
            if isinstance(target, ast.Name) and ONE_WORD_CONSTANT.fullmatch(target.id):
                yield Finding(statement.lineno, target.id, "a name with quantity and unit, as MIN_REST_SAMPLES")


def findings(source: str, words: list[tuple[re.Pattern[str], str]], suffix: str = ".py") -> list[Finding]:
    """Find the places to mend in the text of a file, in the order of its lines."""
    found = list(_one_word_constants(source)) if suffix == ".py" else []
    for first_line, text in _prose(source, suffix):
        for pattern, advice in words:
            for match in pattern.finditer(text):
                found.append(Finding(first_line + text.count("\n", 0, match.start()), match.group(), advice))
    return sorted(found)


def _checked_files(paths: list[str]) -> list[Path]:
    files = [ROOT / path for path in paths] or [file for pattern in CHECKED_FILES for file in ROOT.glob(pattern)]
    return sorted(file for file in files if not any(map(file.is_relative_to, UNCHECKED_PATHS)))


def main(paths: list[str]) -> int:
    """Print each place to mend as FILE:LINE, and return the exit status: 1 if there is any."""
    words = avoided_words(GUIDE.read_text(encoding="utf-8"))
    status = 0
    for file in _checked_files(paths):
        for line, found, advice in findings(file.read_text(encoding="utf-8"), words, file.suffix):
            print(f"{file.relative_to(ROOT)}:{line}: {' '.join(found.split())!r}: write {advice}")
            status = 1
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
