"""Files of a page: checking the text of a file for the daemon, and writing scene and materials as a file.

A page sends the text of a file; no file that a page names is opened. hapticd's loader refuses aliases, too deep nesting
and too long texts before it builds values.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, cast

from hapticd.base.errors import HapticdError, InvalidError, Problem
from hapticd.base.yaml_source import Document, Json, load_text, printable
from hapticd.config.change_files import ChangeFiles, change_of
from hapticd.config.configuration import config_of_documents
from hapticd.config.document_kinds import CONFIGURATION_KEYS, kind_of
from hapticd.config.materials import Material, shipped_materials, validate_materials
from hapticd.config.scene import Scene, used_materials, validate_scene
from hapticd.web.yaml_editing import block_text, edited, same

FILE_PARTS: Final = ("materials", "scene")
"""Sections of a configuration that a page can open and save."""
MAX_FILE_NAME_CHARACTERS: Final = 200
"""Longest name of a file that a page opens."""
_PLACE_PATTERN: Final = re.compile(r"(\d+):(\d+)(?:: (.*))?$", re.DOTALL)
"""The end of a problem's `where`, after the file name: line, column and key."""
_FIRST_LINE: Final = (
    "# Scene and materials as they were on the page of hapticd web; `hapticd check -c FILE` reads it again.\n"
)

_Map = dict[str, Json]


@dataclass(frozen=True, slots=True)
class Opened:
    """The validated scene and materials in the text of a file that a page opens."""

    document: Document
    change: ChangeFiles
    left_out: tuple[str, ...]
    """Sections of the file that need a restart of the daemon, and were not applied."""

    @property
    def materials(self) -> _Map:
        """The materials by name, with all members."""
        return {} if self.change.materials is None else cast(_Map, dict(self.change.materials))

    @property
    def scene(self) -> _Map | None:
        """The scene with all members; None: the file has none."""
        return None if self.change.scene is None else cast(_Map, dict(self.change.scene))


def read(name: object, text: object) -> Opened:
    """Read and check the text of a file; `name` is its name in errors.

    Raises InvalidError with the line and key of every problem, also of problems in other sections of a configuration.
    """
    if not isinstance(name, str) or not 0 < len(name) <= MAX_FILE_NAME_CHARACTERS:
        raise HapticdError(f"name: must be a text of at most {MAX_FILE_NAME_CHARACTERS} characters")
    if not isinstance(text, str):
        raise HapticdError("text: must be a text")
    document = load_text(text, name)
    if kind_of(document.data) != "configuration":
        return Opened(document, change_of([document]), ())
    assert isinstance(document.data, dict)
    config_of_documents([document])
    kept = {key: value for key, value in document.data.items() if key in FILE_PARTS}
    if not kept:
        text = "has neither materials nor a scene, only sections for the start of a daemon; use: hapticd run -c"
        raise InvalidError([Problem(document.where(()), text)])
    left_out = tuple(key for key in CONFIGURATION_KEYS if key in document.data)
    return Opened(document, change_of([replace(document, data=kept)]), left_out)


def placed(problems: Sequence[Problem], name: str) -> list[dict[str, Json]]:
    """Return problems for a page: `line` and `column` (from 1; nil without a place), the key `where`, and `problem`."""
    listed: list[dict[str, Json]] = []
    for each in problems:
        rest = each.where.removeprefix(printable(name))
        match = _PLACE_PATTERN.match(rest.removeprefix(":"))
        line, column, where = (int(match[1]), int(match[2]), match[3] or "") if match else (None, None, rest)
        listed.append({"line": line, "column": column, "where": where, "problem": each.problem})
    return listed


def changed_materials(materials: Mapping[str, object]) -> _Map:
    """Return the materials that differ from the shipped ones, with all members. Raises InvalidError."""
    shipped = shipped_materials()
    given = {name: material.to_dict() for name, material in validate_materials(dict(materials)).items()}
    return {
        name: full for name, full in given.items() if name not in shipped or not same(full, shipped[name].to_dict())
    }


@dataclass(frozen=True, slots=True)
class Saved:
    """The text of a file of scene and materials that a page saves."""

    text: str
    kept: bool
    """Whether comments, order and layout of the opened file were kept."""
    materials: list[str]


def saved(
    scene: Mapping[str, object],
    materials: Mapping[str, object],
    parts: Collection[str] = FILE_PARTS,
    opened: Opened | None = None,
    text: str = "",
    others: Mapping[str, object] | None = None,
) -> Saved:
    """Return the daemon's scene and materials as a file that `hapticd check -c`, `run -c` and `apply` read.

    Only materials that differ from the shipped ones are written, without members that have their default. `opened` with
    its `text` is the file to change; only values that differ are replaced. `others` are the daemon's materials that the
    file lacked when it was opened. They are added only if they have changed since then, or if the scene names them.
    Raises HapticdError if there is nothing to save.
    """
    valid = validate_scene(dict(scene))
    written: _Map
    used = used_materials(valid.objects.values())
    full = {name: each.to_dict() for name, each in validate_materials(dict(materials)).items()}
    differing = changed_materials(materials)
    if opened is None:
        written = differing
    else:
        before = opened.materials
        known = others or {}
        written = {
            name: each
            for name, each in full.items()
            if name in before or (name in differing and (name in used or not same(each, cast(Json, known.get(name)))))
        }
    wanted: _Map = {}
    if "materials" in parts and (written or (opened is not None and opened.change.materials is not None)):
        wanted["materials"] = cast(Json, written)
    if "scene" in parts:
        wanted["scene"] = valid.to_dict()
    if not wanted:
        raise HapticdError("there is nothing to save: every material is as shipped")
    brief: _Map = {
        "materials": {name: _brief(each) for name, each in validate_materials(written).items()},
        "scene": _brief(valid),
    }
    if opened is None:
        text, kept = _FIRST_LINE + block_text({part: brief[part] for part in FILE_PARTS if part in wanted}), True
    else:
        text, kept = _edited_file(opened, text, wanted, brief)
    return Saved(text, kept, sorted(written) if "materials" in wanted else [])


def _brief(model: Scene | Material) -> Json:
    """Return a scene or a material as a map without the members that have their default."""
    return _whole_numbers(cast(Json, model.model_dump(mode="json", exclude_none=True, exclude_defaults=True)))


def _whole_numbers(tree: Json) -> Json:
    """Return a tree of values with integers in place of floats such as 800.0."""
    if isinstance(tree, dict):
        return {key: _whole_numbers(value) for key, value in tree.items()}
    if isinstance(tree, list):
        return [_whole_numbers(value) for value in tree]
    return int(tree) if isinstance(tree, float) and tree.is_integer() and abs(tree) < 1e15 else tree


def _edited_file(opened: Opened, text: str, wanted: _Map, brief: _Map) -> tuple[str, bool]:
    """Return the opened file's text with the sections `wanted`, and whether comments and layout were kept."""
    raw = opened.document.data
    assert isinstance(raw, dict)
    bare = {"bare scene": "scene", "bare materials": "materials"}.get(kind_of(raw) or "")
    moved = True
    canonical: _Map = {"materials": opened.materials, "scene": opened.scene or {}}
    if bare is not None and set(wanted) <= {bare}:
        return edited(text, cast(_Map, _merged(raw, canonical[bare], wanted[bare], brief[bare])))
    if bare is not None:
        # The file is one section without its key: it gets the key, so that the other section can be added.
        raw, text = {bare: raw}, _in_section(bare, text)
        moved = same(_data_of(text), raw)
        text = text if moved else block_text(raw)
    after = dict(raw)
    for part, value in wanted.items():
        after[part] = _merged(raw[part], canonical[part], value, brief[part]) if part in raw else brief[part]
    text, kept = edited(text, after)
    return text, kept and moved


def _data_of(text: str) -> Json:
    try:
        return load_text(text, "").data
    except HapticdError:
        return None


def _in_section(key: str, text: str) -> str:
    """Return a YAML text indented as the section `key`; the key follows the first comments of the text."""
    lines = text.removeprefix("\ufeff").splitlines(keepends=True)
    comments = next((row for row, line in enumerate(lines) if not line.startswith("#")), len(lines))
    return "".join(
        (*lines[:comments], f"{key}:\n", *(f"  {line}" if line.strip() else line for line in lines[comments:]))
    )


def _merged(raw: Json, before: Json, wanted: Json, brief: Json) -> Json:
    """Return the value to write in place of `raw`, a value as it is in the opened file.

    `before` is `raw` with all members and `wanted` the new value with all members. `raw` is kept if they are the same;
    in a mapping, only the members that differ are changed. `brief` is `wanted` without members that have their
    default.
    """
    if same(before, wanted):
        return raw
    if isinstance(raw, dict) and isinstance(before, dict) and isinstance(wanted, dict) and isinstance(brief, dict):
        kept: dict[str, Json] = {}
        for key, value in raw.items():
            if key in wanted:
                kept[key] = _merged(value, before.get(key), wanted[key], brief.get(key, wanted[key]))
            elif value is None and key not in before:
                kept[key] = None
        new = {key: value for key, value in brief.items() if key not in raw}
        return kept | {key: value for key, value in new.items() if not same(before.get(key), wanted.get(key))}
    if isinstance(raw, list) and isinstance(before, list) and isinstance(wanted, list) and isinstance(brief, list):
        common = min(len(raw), len(before), len(wanted), len(brief))
        start: list[Any] = [_merged(*each) for each in zip(raw[:common], before, wanted, brief, strict=False)]
        return [*start, *brief[common:]]
    return brief
