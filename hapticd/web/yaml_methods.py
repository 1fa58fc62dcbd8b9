"""Methods of a page: the editors' schema, and opening and saving files of scenes and materials."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from pathlib import Path
from typing import Final, cast

from hapticd.base import wording
from hapticd.base.errors import HapticdError, InvalidError, Problem
from hapticd.base.yaml_source import MAX_YAML_BYTES, printable
from hapticd.config.shipped_files import described, shipped
from hapticd.protocol.calls import RemoteError
from hapticd.protocol.messages import Code
from hapticd.web import yaml_files
from hapticd.web.editor_schema import editor_schema
from hapticd.web.page import Method, Page
from hapticd.web.yaml_files import FILE_PARTS, Opened

_SHIPPED_FOLDERS: Final = ("scenes", "materials")
"""Kinds of shipped files that a page can open."""


async def _schema(_: Page, params: Mapping[str, object]) -> object:
    """Answer web.schema: return the JSON Schema of materials, objects and scene (editor_schema.py)."""
    return editor_schema()


async def _shipped(_: Page, params: Mapping[str, object]) -> object:
    """Answer web.yaml_shipped: `name` and description (`shows`) of each shipped file."""

    def read_descriptions() -> object:
        return {
            folder: [{"name": each.name, "shows": each.shows} for each in described(folder)]
            for folder in _SHIPPED_FOLDERS
        }

    return await asyncio.to_thread(read_descriptions)


async def _open(page: Page, params: Mapping[str, object]) -> object:
    """Answer web.yaml_open: check the `text` of the file `name`, and apply its scene and materials in one change.

    `force` is that of the method apply.
    """
    return await _apply(page, params, params.get("name"), params.get("text"))


async def _open_shipped(page: Page, params: Mapping[str, object]) -> object:
    """Answer web.yaml_open_shipped: apply a shipped file, by `folder` (scenes, materials) and `name`.

    `force` is that of the method apply. The result has the file's `text`.
    """
    folder, name = params.get("folder"), params.get("name")
    if folder not in _SHIPPED_FOLDERS:
        raise HapticdError(f"folder: must be {' or '.join(_SHIPPED_FOLDERS)}")
    files = shipped(folder)
    if not isinstance(name, str) or name not in files:
        raise HapticdError(f"name: must be one of {', '.join(files)}")
    text = await asyncio.to_thread(Path(files[name]).read_text, encoding="utf-8")
    return {**await _apply(page, params, f"{name}.yaml", text), "text": text}


async def _apply(page: Page, params: Mapping[str, object], name: object, text: object) -> dict[str, object]:
    """Apply the scene and materials of a YAML text. An error lists the problems of the text by line and key."""
    given, force = str(name), params.get("force", False)
    if not isinstance(force, bool):
        raise HapticdError("force: must be true or false")
    try:
        opened = await asyncio.to_thread(_read, name, text)
        change = opened.change
        result = await page.daemon.apply(materials=change.materials, scene=change.scene, wait=True, force=force)
    except InvalidError as error:
        raise _refused(given, error.problems) from None
    except RemoteError as error:
        raise _refused(given, error.problems, error.code) if error.problems else error from None
    materials = (await page.daemon.get_materials())["materials"]
    differing = await asyncio.to_thread(yaml_files.changed_materials, materials)
    scene = opened.scene
    return {
        "name": given,
        "revision": result["revision"],
        "materials": sorted(opened.materials),
        "scene": scene is not None,
        "objects": 0 if scene is None else len(cast("Mapping[str, object]", scene["objects"])),
        "left_out": list(opened.left_out),
        "warnings": result.get("warnings", []),
        "others": {each: full for each, full in differing.items() if each not in opened.materials},
    }


def _read(name: object, text: object) -> Opened:
    if isinstance(text, str) and len(text) > MAX_YAML_BYTES:
        raise HapticdError(f"text: must have at most {wording.size(MAX_YAML_BYTES)}")
    return yaml_files.read(name, text)


def _refused(name: str, problems: tuple[Problem, ...], code: int = Code.INVALID_PARAMS) -> RemoteError:
    listed = yaml_files.placed(problems, name)
    text = f"{printable(name)}: {wording.count(len(listed), 'fault')}; nothing was changed"
    return RemoteError(code, text, listed)


async def _save(page: Page, params: Mapping[str, object]) -> object:
    """Answer web.yaml_save: return the daemon's scene and materials as a file's `text`.

    `parts`: the sections to save. `opened`: {name, text, others}, the file to change, with `name` and `text` as given
    to web.yaml_open and `others` from its result.
    """
    parts = params.get("parts", list(FILE_PARTS))
    if not isinstance(parts, list) or not parts or not all(part in FILE_PARTS for part in parts):
        raise HapticdError(f"parts: must be a list of one or both of {', '.join(FILE_PARTS)}")
    given = params.get("opened")
    if given is not None and not isinstance(given, dict):
        raise HapticdError("opened: must be a map of name, text and others")
    scene, materials = (await page.daemon.get_scene())["scene"], (await page.daemon.get_materials())["materials"]

    def write() -> yaml_files.Saved:
        if given is None:
            return yaml_files.saved(scene, materials, parts)
        others = given.get("others", {})
        if not isinstance(others, dict):
            raise HapticdError("others: must be a map of materials")
        opened = _read(given.get("name"), given.get("text"))
        return yaml_files.saved(scene, materials, parts, opened, given["text"], others)

    saved = await asyncio.to_thread(write)
    return {"text": saved.text, "kept": saved.kept, "materials": saved.materials}


YAML_PAGE_METHODS: Final[dict[str, Method]] = {
    "web.schema": _schema,
    "web.yaml_shipped": _shipped,
    "web.yaml_open": _open,
    "web.yaml_open_shipped": _open_shipped,
    "web.yaml_save": _save,
}
