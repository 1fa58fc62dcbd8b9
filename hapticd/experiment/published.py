"""Published results that ship with hapticd, for comparison with sessions."""

from __future__ import annotations

from functools import cache
from importlib import resources

from hapticd.base.errors import HapticdError, known_names, quoted
from hapticd.base.yaml_source import Json, load_bytes


def published(name: str) -> dict[str, Json]:
    """Return the published results with the name FILE.SECTION, such as `okamura1998.tapping`.

    Raises HapticdError for an unknown name.
    """
    faults = published_faults(name)
    if faults:
        raise HapticdError(faults[0])
    file, _, section = name.partition(".")
    found = _files()[file][section]
    assert isinstance(found, dict)
    return found


def published_faults(name: str) -> list[str]:
    """Return a list with an error text if `name` is not a name of published results, else an empty list."""
    known = published_names()
    return [] if name in known else [f"unknown published results {quoted(name)}; {known_names(name, known)}"]


def published_names() -> list[str]:
    """Return the names of all published results, each as FILE.SECTION."""
    return [
        f"{file}.{section}"
        for file, sections in _files().items()
        for section, found in sections.items()
        if isinstance(found, dict) and "task" in found
    ]


@cache
def _files() -> dict[str, dict[str, Json]]:
    folder = resources.files("hapticd.experiment").joinpath("published")
    found: dict[str, dict[str, Json]] = {}
    for file in sorted(folder.iterdir(), key=lambda file: file.name):
        if file.name.endswith(".yaml"):
            data = load_bytes(file.read_bytes(), f"hapticd/experiment/published/{file.name}").data
            assert isinstance(data, dict)
            found[file.name.removesuffix(".yaml")] = data
    return found
