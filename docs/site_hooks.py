"""Hooks of mkdocs that make pages of the site from the files of the repository; mkdocs.yml names this file.

A link to a file that the site does not have, such as a file of the code, becomes text. CHANGELOG.md becomes a page.
Lists of CommonMark become lists of Python-Markdown, which needs an empty line before a list and an indentation of four
columns for each level.
"""

from __future__ import annotations

import re
from pathlib import Path

from markdown_it import MarkdownIt
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

DOCS = Path(__file__).resolve().parent
CHANGES = DOCS.parent / "CHANGELOG.md"
LINK = re.compile(r"(?<!!)\[([^\]]*)\]\(([^)#\s]+)(#[^)\s]*)?\)")


def inside(markdown: str, page: Path) -> str:
    """Return the text of a page of docs/ in which links to files outside docs/ are replaced by their text."""

    def replaced(link: re.Match[str]) -> str:
        text, target = link[1], link[2]
        if "://" in target or target.startswith("mailto:"):
            return link[0]
        if (page.parent / target).resolve() == CHANGES:
            return f"[{text}]({'../' * (len(page.relative_to(DOCS).parts) - 1)}changelog.md)"
        return link[0] if (page.parent / target).resolve().is_relative_to(DOCS) else text

    return LINK.sub(replaced, markdown)


def for_python_markdown(markdown: str) -> str:
    """Return the text with an empty line before each list, and an indentation of four columns for each level."""
    lines = markdown.split("\n")
    depth, width = [0] * len(lines), [0] * len(lines)
    begins: set[int] = set()
    loose: list[bool] = []
    for token in MarkdownIt("commonmark").parse(markdown):
        if token.type in ("bullet_list_close", "ordered_list_close"):
            loose.pop()
        if token.map is None:
            continue
        begin, end = token.map
        text_above = begin > 0 and bool(lines[begin - 1].strip())
        if token.type in ("bullet_list_open", "ordered_list_open"):
            loose.append("\n\n" in "\n".join(lines[begin:end]).rstrip("\n"))
            if text_above:
                begins.add(begin)
        elif token.type == "list_item_open":
            for number in range(begin + 1, min(end, len(lines))):
                depth[number] += 1
                width[number] += len(f"{token.info}{token.markup} ")
            if text_above and loose[-1]:
                begins.add(begin)
    made = []
    for number, (line, deep, wide) in enumerate(zip(lines, depth, width, strict=True)):
        made += [""] * (number in begins)
        made.append(" " * 4 * deep + line[wide:] if line[:wide].isspace() else line)
    return "\n".join(made)


def changelog(text: str) -> str:
    """Return CHANGELOG.md as a page of docs/: its links begin in the root of the repository."""
    return text.replace("](docs/", "](")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add CHANGELOG.md to the pages of the site."""
    text = CHANGES.read_text(encoding="utf-8")
    files.append(File.generated(config, "changelog.md", content=changelog(text)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Return the text of a page as Python-Markdown needs it; mkdocs calls this before it makes HTML."""
    return for_python_markdown(inside(markdown, DOCS / page.file.src_uri))
