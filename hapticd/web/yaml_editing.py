"""Changing a YAML text in place: only values that differ are replaced, everything else stays.

Comments, order, alignment, quotes and number formats of a handwritten file are kept. PyYAML gives the position of each
value in the text. The result is read again by hapticd's loader; if that gives other values than intended, the
text is written again from scratch.
"""

from __future__ import annotations

import re
from typing import Final, cast

import yaml

from hapticd.base.errors import HapticdError
from hapticd.base.yaml_source import Json, load_text
from hapticd.base.yaml_text import flow_text

_YAML_LOADER: Final = yaml.CBaseLoader if yaml.__with_libyaml__ else yaml.BaseLoader
"""PyYAML's loader that finds positions and does not convert values."""
_LINE_END_PATTERN: Final = re.compile(r"\r\n|[\n\r\x85\u2028\u2029]|\Z")
_MAX_LINE_CHARACTERS: Final = 100
"""Longest line for an added mapping; a longer mapping is written as a block."""


class _IntricateError(Exception):
    """A mapping or list cannot be edited in place: its text must be replaced."""


def same(one: Json, other: Json) -> bool:
    """Return whether two values are the same: 800 and 800.0 are the same, true and 1 are not."""
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(same(value, other[key]) for key, value in one.items())
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(same, one, other))
    return isinstance(one, bool) == isinstance(other, bool) and one == other


def edited(text: str, after: dict[str, Json]) -> tuple[str, bool]:
    """Return the YAML text with the values of `after`, and whether everything else is unchanged.

    `text` must be a mapping that load_text accepts. If a value cannot be replaced in place, the text is written again
    without its comments, and the second result is False.
    """
    mark = "\ufeff" if text.startswith("\ufeff") else ""
    body = text.removeprefix("\ufeff")
    before = load_text(body, "").data
    if same(before, after):
        return text, True
    try:
        node = yaml.compose(body, Loader=_YAML_LOADER)
        edits = _Edits(body)
        edits.value(cast(yaml.Node, node), before, after)
        new = edits.applied()
        if same(load_text(new, "").data, after):
            return mark + new, True
    except (_IntricateError, HapticdError):
        pass
    return block_text(after), False


class _Edits:
    """Replacements of values in one YAML text, found from outer to inner values."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._newline = "\r\n" if "\r\n" in text else "\n"
        self._edits: list[tuple[int, int, str]] = []

    def applied(self) -> str:
        """Return the YAML text with all replacements made. Replacements must not overlap."""
        parts, at = [], 0
        for start, end, new in sorted(self._edits, key=lambda edit: edit[:2]):
            if start < at:
                raise _IntricateError
            parts += [self._text[at:start], new]
            at = end
        return "".join((*parts, self._text[at:]))

    def value(self, node: yaml.Node, before: Json, after: Json, key: yaml.Node | None = None) -> None:
        """Replace the value `before` of `node` by `after`; `key` is the node's key in a mapping."""
        if same(before, after):
            return
        kept = len(self._edits)
        try:
            if isinstance(node, yaml.MappingNode) and isinstance(before, dict) and isinstance(after, dict):
                self._mapping(node, before, after)
            elif isinstance(node, yaml.SequenceNode) and isinstance(before, list) and isinstance(after, list):
                self._sequence(node, before, after)
            else:
                raise _IntricateError
        except _IntricateError:
            del self._edits[kept:]
            self._replace(node, after, key)

    def _replace(self, node: yaml.Node, after: Json, key: yaml.Node | None) -> None:
        start, end = node.start_mark.index, self._end(node)
        new = flow_text(after)
        if key is not None:
            between = self._text[key.end_mark.index : start]
            if "\n" in between or "\r" in between or start == end or not between.endswith((" ", "\t")):
                # The old value is a block below its key, or empty: the new one is written next to the key.
                start = self._text.index(":", key.end_mark.index) + 1
                end = max(start, end)
                new = f" {new}"
        self._edits.append((start, end, new))

    def _sequence(self, node: yaml.SequenceNode, before: list[Json], after: list[Json]) -> None:
        common = min(len(before), len(after))
        if common == 0:
            raise _IntricateError
        for place in range(common):
            self.value(node.value[place], before[place], after[place])
        last_kept, last, added = node.value[common - 1], node.value[-1], after[common:]
        if node.flow_style:
            new = "".join(f", {flow_text(value)}" for value in added)
            self._edits.append((self._end(last_kept), self._end(last), new))
            return
        if common < len(before):
            first_removed = node.value[common].start_mark.index
            line = self._line_start(first_removed)
            if self._text[line:first_removed].strip(" ") != "-":
                raise _IntricateError
            self._edits.append((line, self._after_line(self._end(last)), ""))
        if added:
            pad = " " * node.start_mark.column
            self._insert_lines(self._after_line(self._end(last)), [f"{pad}- {flow_text(value)}" for value in added])

    def _mapping(self, node: yaml.MappingNode, before: dict[str, Json], after: dict[str, Json]) -> None:
        entries = {cast(str, key.value): (key, value) for key, value in node.value}
        kept = [name for name in entries if name in after]
        if not kept:
            raise _IntricateError
        for name in kept:
            key, value = entries[name]
            self.value(value, before[name], after[name], key)
        added = {name: value for name, value in after.items() if name not in entries}
        removed = [name for name in entries if name not in after]
        if node.flow_style:
            self._flow_mapping(list(entries), entries, removed, added)
        else:
            self._block_mapping(entries, removed, added)

    def _flow_mapping(
        self,
        order: list[str],
        entries: dict[str, tuple[yaml.Node, yaml.Node]],
        removed: list[str],
        added: dict[str, Json],
    ) -> None:
        last_kept = max(place for place, name in enumerate(order) if name not in removed)
        for place, name in enumerate(order[:last_kept]):
            if name in removed:
                self._edits.append((self._start(entries[name]), self._start(entries[order[place + 1]]), ""))
        at, end = self._entry_end(entries[order[last_kept]]), self._entry_end(entries[order[-1]])
        new = "".join(f", {flow_text(name)}: {flow_text(value)}" for name, value in added.items())
        if at != end or new:
            self._edits.append((at, end, new))

    def _block_mapping(
        self, entries: dict[str, tuple[yaml.Node, yaml.Node]], removed: list[str], added: dict[str, Json]
    ) -> None:
        for name in removed:
            start, end = self._start(entries[name]), self._after_line(self._entry_end(entries[name]))
            line = self._line_start(start)
            if self._text[line:start].strip(" "):
                raise _IntricateError
            self._edits.append((line, end, ""))
        if added:
            first, last = next(iter(entries.values())), list(entries.values())[-1]
            pad = " " * first[0].start_mark.column
            lines = [pad + line for name, value in added.items() for line in _entry(name, value, len(pad))]
            self._insert_lines(self._after_line(self._entry_end(last)), lines)

    def _insert_lines(self, at: int, lines: list[str]) -> None:
        break_before = "" if self._text[:at].endswith(("\n", "\r", "\x85", "\u2028", "\u2029")) else self._newline
        self._edits.append((at, at, break_before + "".join(line + self._newline for line in lines)))

    # ---- Positions ---------------------------------------------------------------------------------------------------

    @staticmethod
    def _start(entry: tuple[yaml.Node, yaml.Node]) -> int:
        start: int = entry[0].start_mark.index
        return start

    def _end(self, node: yaml.Node) -> int:
        """Return the index after the last character of a value. PyYAML's end of a block includes trailing comments."""
        while isinstance(node, yaml.CollectionNode) and not node.flow_style and node.value:
            last = node.value[-1]
            node = last[1] if isinstance(last, tuple) else last
        start, end = node.start_mark.index, node.end_mark.index
        return start + len(self._text[start:end].rstrip())

    def _line_start(self, at: int) -> int:
        return max(self._text.rfind(mark, 0, at) for mark in "\n\r\x85\u2028\u2029") + 1

    def _entry_end(self, entry: tuple[yaml.Node, yaml.Node]) -> int:
        """Return the index after the value of a mapping's entry, or after its key if the value is empty."""
        return max(self._end(entry[1]), entry[0].end_mark.index)

    def _after_line(self, at: int) -> int:
        """Return the index at which the line after the index `at` begins."""
        match = _LINE_END_PATTERN.search(self._text, at)
        assert match is not None
        return match.end()


def block_text(mapping: dict[str, Json]) -> str:
    """Return a mapping as a new YAML text: values that fit are on one line, others in blocks."""
    return "".join(f"{line}\n" for name, value in mapping.items() for line in _entry(name, value, 0))


def _entry(name: str, value: Json, pad: int) -> list[str]:
    """Return an entry of a block mapping as lines without indentation."""
    key, flow = flow_text(name), flow_text(value)
    small = pad + len(key) + len(flow) + 2 <= _MAX_LINE_CHARACTERS
    if isinstance(value, dict) and value and not (small and _is_leaf(value)):
        return [f"{key}:", *(f"  {line}" for inner, part in value.items() for line in _entry(inner, part, pad + 2))]
    if isinstance(value, list) and value and not small:
        return [f"{key}:", *(f"  - {flow_text(each)}" for each in value)]
    return [f"{key}: {flow}"]


def _is_leaf(mapping: dict[str, Json]) -> bool:
    return not any(isinstance(value, dict) for value in mapping.values())
