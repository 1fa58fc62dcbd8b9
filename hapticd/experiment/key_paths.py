"""Changes of a configuration (plain data) at paths of keys, such as `materials.wood.tap.frequency_hz`.

If a key of a shipped material is changed, its other keys keep the shipped values. `materials.left: wood` gives the
material `left` all keys of `wood`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from functools import cache
from typing import Final

from hapticd.base.errors import InvalidError, Path, Problem, known_names, path_of_text, path_text, shown
from hapticd.base.merge_patch import merge_patch
from hapticd.base.yaml_source import Document, Json, load_path
from hapticd.config.document_kinds import Kind, kind_of, refuse_other_kinds
from hapticd.config.materials import shipped_materials
from hapticd.config.shipped_files import file_of

BASE_KEY: Final = "base"
"""Key of a study or a sweep with the configuration that it changes, or with the name of a file that contains it."""
_PATH_ELEMENT: Final = re.compile(r"([^.\[\]]+)((?:\[[0-9]{1,5}\])*)")
"""A key that may be followed by indices, such as patches[0]."""


def path_of(text: str) -> Path:
    """Parse a path such as `scene.objects.floor.patches[0].material` into keys and indices.

    Raises ValueError if the text is not a path.
    """
    found: list[str | int] = []
    for part in text.split("."):
        match = _PATH_ELEMENT.fullmatch(part)
        if match is None:
            raise ValueError("must be keys separated by dots, such as materials.wood.tap.frequency_hz")
        found += [match[1], *(int(index) for index in re.findall(r"[0-9]+", match[2]))]
    return tuple(found)


def invalid_in(document: Document, base: Document | None, faults: Iterable[tuple[Path, str]]) -> InvalidError:
    """Return an error with file and line of each fault, which is in a study or sweep, or in its base file, if any."""
    return InvalidError(
        base.problem(path[1:], text)
        if base is not None and path[:1] == (BASE_KEY,) and len(path) > 1
        else document.problem(path, text)
        for path, text in faults
    )


@cache
def _shipped() -> dict[str, Json]:
    return {name: material.to_dict() for name, material in shipped_materials().items()}


def expanded(document: Mapping[str, Json]) -> dict[str, Json]:
    """Return a configuration with materials expanded: `left: wood` is replaced by `left` with all keys of `wood`.

    Raises InvalidError at materials.left if `wood` is neither a material of the configuration nor a shipped one.
    """
    materials = document.get("materials")
    if not isinstance(materials, dict) or not any(isinstance(value, str) for value in materials.values()):
        return dict(document)
    shipped = _shipped()
    found: dict[str, Json] = {}
    for name, value in materials.items():
        if isinstance(value, str):
            meant = materials.get(value)
            if isinstance(meant, dict):
                value = meant
            elif value in shipped:
                value = shipped[value]
            else:
                known = known_names(value, [*(each for each in materials if each != name), *shipped])
                problem = f"unknown material {value}; {known}"
                raise InvalidError([Problem(path_text(("materials", name)), problem)])
        found[name] = value
    return {**document, "materials": found}


def with_base(
    document: Document, data: Mapping[str, Json], content: str, *kinds: Kind
) -> tuple[dict[str, Json], Document | None]:
    """Return a study or sweep with its base, expanded, instead of the name of a file, and the document of this file.

    The file is in the folder of `document`, or is a shipped scene. It has `content`, as a document of one of `kinds`.
    Raises InvalidError if the base is faulty, HapticdError if the file cannot be read.
    """
    given = data.get(BASE_KEY, {})
    source: Document | None = None
    if isinstance(given, str):
        source = load_path(file_of(given, "scenes", document.folder))
        refuse_other_kinds(source, *kinds, "bare scene")
        source = source.below("scene") if kind_of(source.data) == "bare scene" else source
        given = source.data
    if not isinstance(given, dict):
        if source is not None:
            raise InvalidError([Problem(source.where(()), f"must be {content}")])
        text = f"must be {content}, or the name of a file or of a shipped scene, is {shown(given)}"
        raise InvalidError([document.problem((BASE_KEY,), text)])
    try:
        return {**data, BASE_KEY: expanded(given)}, source
    except InvalidError as error:
        faults = [((BASE_KEY, *path_of_text(each.where)), each.problem) for each in error.problems]
        raise invalid_in(document, source, faults) from None


def with_patch(document: Mapping[str, Json], patch: Mapping[str, Json]) -> dict[str, Json]:
    """Apply a merge patch (RFC 7396) to a configuration, and return the result with materials expanded.

    Raises InvalidError for an unknown material.
    """
    changed = patch.get("materials")
    if isinstance(changed, dict):
        document = _with_shipped(document, (name for name, value in changed.items() if isinstance(value, dict)))
    merged = merge_patch(dict(document), dict(patch))
    assert isinstance(merged, dict)
    return expanded(merged)


def with_value(document: Mapping[str, Json], path: Path, value: Json, *, make: bool = False) -> dict[str, Json]:
    """Return a configuration in which the key at `path` has the value `value`.

    With `make`, missing mappings along the path are created. Raises InvalidError for an unknown key in the path, or an
    unknown material.
    """
    if path[0] == "materials" and len(path) > 2:
        document = _with_shipped(document, (str(path[1]),))
    found = _set(dict(document), path, 0, value, make)
    assert isinstance(found, dict)
    return expanded(found)


def _with_shipped(document: Mapping[str, Json], names: Iterable[str]) -> Mapping[str, Json]:
    """Return a configuration to which the shipped materials of these names are added, unless it has them."""
    own = document.get("materials")
    own = own if isinstance(own, dict) else {}
    shipped = _shipped()
    missing: dict[str, Json] = {
        name: shipped[name] for name in names if name in shipped and not isinstance(own.get(name), dict | str)
    }
    return {**document, "materials": {**missing, **own}} if missing else document


def _set(node: Json, path: Path, depth: int, value: Json, make: bool) -> Json:
    """Return a copy of `node`, plain data at `path[:depth]`, with `value` at `path`. Other branches are shared."""
    if depth == len(path):
        return value
    key = path[depth]
    last = depth == len(path) - 1
    node = {} if node is None and make else node
    if isinstance(node, dict) and isinstance(key, str) and (last or make or key in node):
        return {**node, key: _set(node.get(key), path, depth + 1, value, make)}
    if isinstance(node, list) and isinstance(key, int) and key < len(node):
        return [*node[:key], _set(node[key], path, depth + 1, value, make), *node[key + 1 :]]
    known = f"; {known_names(str(key), node)}" if isinstance(node, dict) else ""
    raise InvalidError([Problem(path_text(path), f"unknown key {path_text(path[: depth + 1])}{known}")])


def difference(old: Mapping[str, Json], new: Mapping[str, Json]) -> dict[str, Json]:
    """Return the merge patch (RFC 7396) that turns `old` into `new`."""
    patch: dict[str, Json] = {key: None for key in old if key not in new}
    for key, value in new.items():
        before = old.get(key)
        if isinstance(value, dict) and isinstance(before, dict):
            inner = difference(before, value)
            if inner:
                patch[key] = inner
        elif key not in old or value != before or isinstance(value, bool) != isinstance(before, bool):
            patch[key] = value
    return patch
