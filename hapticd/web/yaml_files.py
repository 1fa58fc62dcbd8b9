"""YAML of a page: what a file holds for the daemon, and the page's scene and materials as a file.

A page sends the text of a file; nothing here opens a file that a page names. The text goes through hapticd's own
loader, which refuses aliases, nesting without end and texts without end before anything is built from them.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, cast

from hapticd.base.errors import HapticdError, InvalidError, Problem
from hapticd.base.yaml_source import Document, Json, load_text, one_line
from hapticd.config.change_files import ChangeFiles, change_of
from hapticd.config.configuration import config_of_documents
from hapticd.config.document_kinds import CONFIGURATION_KEYS, kind_of
from hapticd.config.materials import Material, shipped_materials, validate_materials
from hapticd.config.scene import Scene, used_materials, validate_scene
from hapticd.web.yaml_editing import block_text, edited, same

PARTS: Final = ("materials", "scene")
LONGEST_NAME: Final = 200
_PLACE: Final = re.compile(r"(\d+):(\d+)(?:: (.*))?$", re.DOTALL)
_BEGINS: Final = (
    "# Scene and materials as they were on the page of hapticd web; `hapticd check -c FILE` reads it again.\n"
)

_Map = dict[str, Json]


@dataclass(frozen=True, slots=True)
class Opened:
    """What a text holds."""

    document: Document
    change: ChangeFiles
    left_out: tuple[str, ...]
    """Its sections that are for the start of a daemon alone."""

    @property
    def materials(self) -> _Map:
        """In full, by name."""
        return {} if self.change.materials is None else cast(_Map, dict(self.change.materials))

    @property
    def scene(self) -> _Map | None:
        """In full; None where it holds none."""
        return None if self.change.scene is None else cast(_Map, dict(self.change.scene))


def read(name: object, text: object) -> Opened:
    """Reads and checks the text of a file that a person calls `name`.

    Raises InvalidError, which names every fault by line and key; also for a configuration that is faulty elsewhere.
    """
    if not isinstance(name, str) or not 0 < len(name) <= LONGEST_NAME:
        raise HapticdError(f"name: must be a text of at most {LONGEST_NAME} characters")
    if not isinstance(text, str):
        raise HapticdError("text: must be a text")
    document = load_text(text, name)
    if kind_of(document.data) != "configuration":
        return Opened(document, change_of([document]), ())
    assert isinstance(document.data, dict)
    config_of_documents([document])
    kept = {key: value for key, value in document.data.items() if key in PARTS}
    if not kept:
        text = "holds neither materials nor a scene, only what a daemon is started with; use: hapticd run -c"
        raise InvalidError([Problem(document.where(()), text)])
    left_out = tuple(key for key in CONFIGURATION_KEYS if key in document.data)
    return Opened(document, change_of([replace(document, data=kept)]), left_out)


def placed(problems: Sequence[Problem], name: str) -> list[dict[str, Json]]:
    """Faults for a page: `line`, `column` (from 1; nil where a fault has no place), `where`, the key, and `problem`."""
    found: list[dict[str, Json]] = []
    for each in problems:
        rest = each.where.removeprefix(one_line(name))
        match = _PLACE.match(rest.removeprefix(":"))
        line, column, where = (int(match[1]), int(match[2]), match[3] or "") if match else (None, None, rest)
        found.append({"line": line, "column": column, "where": where, "problem": each.problem})
    return found


def changed_materials(materials: Mapping[str, object]) -> _Map:
    """Those that differ from the shipped library, in full. Raises InvalidError."""
    shipped = shipped_materials()
    found = {name: material.to_dict() for name, material in validate_materials(dict(materials)).items()}
    return {
        name: full for name, full in found.items() if name not in shipped or not same(full, shipped[name].to_dict())
    }


@dataclass(frozen=True, slots=True)
class Saved:
    """The text of a file."""

    text: str
    kept: bool
    """Comments, order and layout are those of the opened file."""
    materials: list[str]
    """Names of the materials in it."""


def saved(
    scene: Mapping[str, object],
    materials: Mapping[str, object],
    parts: Collection[str] = PARTS,
    opened: Opened | None = None,
    text: str = "",
    others: Mapping[str, object] | None = None,
) -> Saved:
    """The daemon's scene and materials as a file that `hapticd check -c`, `run -c` and `apply` read.

    Only materials that differ from the shipped library are written, and of everything only what differs from its
    default. `opened` with its `text`: the file that they go into; what differs is changed in it, the rest stays.
    `others`: materials that the daemon had when it was opened and that are not in it; they are added only if they have
    changed since, or the scene names them. Raises HapticdError where there is nothing to save.
    """
    found = validate_scene(dict(scene))
    written: _Map
    used = used_materials(found.objects.values())
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
        wanted["scene"] = found.to_dict()
    if not wanted:
        raise HapticdError("there is nothing to save: every material is as shipped")
    brief: _Map = {
        "materials": {name: _brief(each) for name, each in validate_materials(written).items()},
        "scene": _brief(found),
    }
    if opened is None:
        text, kept = _BEGINS + block_text({part: brief[part] for part in PARTS if part in wanted}), True
    else:
        text, kept = _into(opened, text, wanted, brief)
    return Saved(text, kept, sorted(written) if "materials" in wanted else [])


def _brief(model: Scene | Material) -> Json:
    """Without what is as by default."""
    return _whole_numbers(cast(Json, model.model_dump(mode="json", exclude_none=True, exclude_defaults=True)))


def _whole_numbers(tree: Json) -> Json:
    """800.0 as 800, as people write it."""
    if isinstance(tree, dict):
        return {key: _whole_numbers(value) for key, value in tree.items()}
    if isinstance(tree, list):
        return [_whole_numbers(value) for value in tree]
    return int(tree) if isinstance(tree, float) and tree.is_integer() and abs(tree) < 1e15 else tree


def _into(opened: Opened, text: str, wanted: _Map, brief: _Map) -> tuple[str, bool]:
    """The opened text with the parts that are wanted."""
    raw = opened.document.data
    assert isinstance(raw, dict)
    bare = {"bare scene": "scene", "bare materials": "materials"}.get(kind_of(raw) or "")
    whole = True
    canonical: _Map = {"materials": opened.materials, "scene": opened.scene or {}}
    if bare is not None and set(wanted) <= {bare}:
        return edited(text, cast(_Map, _over(raw, canonical[bare], wanted[bare], brief[bare])))
    if bare is not None:
        # What stood alone becomes a section beside another one.
        raw, text = {bare: raw}, _below(bare, text)
        whole = same(_data_of(text), raw)
        text = text if whole else block_text(raw)
    after = dict(raw)
    for part, value in wanted.items():
        after[part] = _over(raw[part], canonical[part], value, brief[part]) if part in raw else brief[part]
    text, kept = edited(text, after)
    return text, kept and whole


def _data_of(text: str) -> Json:
    try:
        return load_text(text, "").data
    except HapticdError:
        return None


def _below(key: str, text: str) -> str:
    """A text as what stands below a key."""
    lines = text.removeprefix("\ufeff").splitlines(keepends=True)
    comments = next((row for row, line in enumerate(lines) if not line.startswith("#")), len(lines))
    return "".join(
        (*lines[:comments], f"{key}:\n", *(f"  {line}" if line.strip() else line for line in lines[comments:]))
    )


def _over(raw: Json, before: Json, wanted: Json, brief: Json) -> Json:
    """What is to stand in a file in place of `raw`, which means `before` in full: as it is where it means what is
    wanted; of a mapping only the members that differ. `brief`: what is wanted, without what is as by default."""
    if same(before, wanted):
        return raw
    if isinstance(raw, dict) and isinstance(before, dict) and isinstance(wanted, dict) and isinstance(brief, dict):
        kept: dict[str, Json] = {}
        for key, value in raw.items():
            if key in wanted:
                kept[key] = _over(value, before.get(key), wanted[key], brief.get(key, wanted[key]))
            elif value is None and key not in before:
                kept[key] = None
        new = {key: value for key, value in brief.items() if key not in raw}
        return kept | {key: value for key, value in new.items() if not same(before.get(key), wanted.get(key))}
    if isinstance(raw, list) and isinstance(before, list) and isinstance(wanted, list) and isinstance(brief, list):
        common = min(len(raw), len(before), len(wanted), len(brief))
        start: list[Any] = [_over(*each) for each in zip(raw[:common], before, wanted, brief, strict=False)]
        return [*start, *brief[common:]]
    return brief
