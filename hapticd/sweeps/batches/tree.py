"""Reads a tree of recordings, sorted by material and kind of fit, and reports all its faults before any fit begins.

    TREE/fit.yaml                  options of all materials; each fit.yaml may be left out
    TREE/MATERIAL/fit.yaml         options of one material
    TREE/MATERIAL/*.npz            recordings; one of the two files above must set their `kind`
    TREE/MATERIAL/KIND/*.npz       recordings of this kind: tap, grooves, texture or puncture
    TREE/MATERIAL/KIND/fit.yaml    options of one fit

A recording may have a YAML file that describes it, as in `hapticd fit`: tap1.csv.yaml for tap1.csv. Names that begin
with a dot are ignored.
"""

from __future__ import annotations

import hashlib
import os
import stat
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, get_args

from hapticd.analysis.recordings.files import TABLE_READERS, ending_of
from hapticd.base.errors import HapticdError, InvalidError, Problem, known_names, quoted
from hapticd.base.yaml_source import printable
from hapticd.config.materials import MAX_PROVENANCE_FILES, validate_materials
from hapticd.fit.options import MATERIAL_KEYS, FitOptions
from hapticd.fit.recording import Kind
from hapticd.sweeps.batches.folder_yaml import (
    FIT_YAML,
    KINDS_OF_KEY,
    BatchFolder,
    FolderYaml,
    key_of,
    merged,
    options_of,
)

FIT_KINDS: Final[tuple[Kind, ...]] = get_args(Kind)
_KINDS_TEXT: Final = ", ".join(FIT_KINDS[:-1]) + " or " + FIT_KINDS[-1]
"""All kinds of fits, as text for errors."""


@dataclass(frozen=True, slots=True)
class RecordingFile:
    """A recording: its path in the tree, and the hashes of the content of its files."""

    name: str
    """Path of the file, relative to the tree."""
    sha256: str
    yaml_sha256: str
    """SHA-256 of the YAML file that describes the recording; empty without one."""


@dataclass(frozen=True, slots=True)
class RecordingSet:
    """The recordings of one fit, and its options."""

    material: str
    kind: Kind
    folder: str
    """Path of the folder of the recordings, relative to the tree."""
    files: tuple[RecordingFile, ...]
    options: FitOptions
    strict: bool
    stiffness_n_per_m: float | None


@dataclass(frozen=True, slots=True)
class Tree:
    """A tree of recordings: a folder with one folder for each material."""

    path: str
    """Path as the user wrote it."""
    sets: tuple[RecordingSet, ...]
    """The recordings of each fit, by material, then by kind; punctures are last, since they determine the stiffness."""
    others: tuple[str, ...]
    """Paths of files that are not recordings, relative to the tree."""


def read_tree(path: str) -> Tree:
    """Read the tree at `path`. Raises HapticdError without a folder, InvalidError with all faults of the tree."""
    if not os.path.isdir(path):
        why = "not a folder" if os.path.exists(path) else "no such folder"
        raise HapticdError(f"{printable(path)}: {why}; a batch needs a folder with a folder for each material")
    reader = _Reader(path)
    sets = tuple(reader.read())
    if not reader.problems and not sets:
        reader.fault(
            "", f"holds no material: each has a folder with folders {_KINDS_TEXT}, or with recordings and {FIT_YAML}"
        )
    if reader.problems:
        raise InvalidError(reader.problems)
    return Tree(path, sets, tuple(reader.others))


def fingerprint(path: str, name: str) -> RecordingFile:
    """Return a recording with the hashes of its content. Raises HapticdError if it cannot be read."""
    yaml = f"{path}.yaml"
    return RecordingFile(name, _sha256(path), _sha256(yaml) if os.path.lexists(yaml) else "")


def _sha256(path: str) -> str:
    try:
        # Opening a pipe would block.
        if not stat.S_ISREG(os.stat(path).st_mode):
            raise HapticdError(f"{printable(path)}: not a regular file")
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise HapticdError(f"{printable(path)}: cannot be read: {error.strerror}") from None


@dataclass(slots=True)
class _Level:
    """A folder of a tree: its fit.yaml, recordings and subfolders."""

    name: str
    """Path of the folder, relative to the tree."""
    yaml: FolderYaml | None = None
    """The fit.yaml; None if it is missing or has faults."""
    faulty: bool = False
    recordings: list[str] = field(default_factory=list)
    """Paths of the recordings in the folder, relative to the tree."""
    folders: list[str] = field(default_factory=list)
    """Paths of the subfolders, relative to the tree."""


@dataclass(slots=True)
class _Reader:
    """Reads a tree of recordings and collects its faults."""

    root: str
    problems: list[Problem] = field(default_factory=list)
    others: list[str] = field(default_factory=list)
    fitted_kinds: dict[str, set[Kind]] = field(default_factory=lambda: defaultdict(set))
    """For each folder, the kinds of the fits whose recordings are in it and below."""
    may_set_kind: set[str] = field(default_factory=set)
    """Folders whose fit.yaml may set `kind`: the tree, and each material's folder with recordings directly in it."""

    def fault(self, name: str, text: str) -> None:
        self.problems.append(Problem(printable(os.path.join(self.root, name) if name else self.root), text))

    # ---- Folders -----------------------------------------------------------------------------------------------------

    def read(self) -> Iterator[RecordingSet]:
        root = self.level("")
        for name in root.recordings:
            self.fault(name, "recording outside of a material's folder; move it into the folder of its material")
        levels, sets = [root], []
        for name in root.folders:
            found, below = self.material(name, root)
            levels += below
            sets += found
        for level in levels:
            self.check_yaml(level)
        self.check_duplicates(sets)
        return iter(sets)

    def level(self, name: str) -> _Level:
        """Read a folder, and its fit.yaml if it has one."""
        level = _Level(name)
        folder = Path(self.root, name)
        try:
            entries = sorted(each.name for each in folder.iterdir() if not each.name.startswith("."))
        except OSError as error:
            self.fault(name, f"cannot be read: {error.strerror}")
            return level
        for entry in entries:
            inside = os.path.join(name, entry)
            if (folder / entry).is_dir():
                level.folders.append(inside)
            elif ending_of(entry) in TABLE_READERS:
                level.recordings.append(inside)
            elif ending_of(entry) in (".yaml", ".yml"):
                self.yaml(level, entry, entries)
            else:
                self.others.append(inside)
        return level

    def yaml(self, level: _Level, entry: str, entries: list[str]) -> None:
        """Read a fit.yaml into `level`, or check that a YAML file describes a recording of the folder."""
        name, described = os.path.join(level.name, entry), os.path.splitext(entry)[0]
        if entry == FIT_YAML:
            level.faulty = True
            try:
                level.yaml = FolderYaml(os.path.join(self.root, name), os.path.join(self.root, name))
                level.faulty = False
            except InvalidError as error:
                self.problems += error.problems
            except HapticdError as error:
                self.problems.append(Problem("", str(error)))
        elif described == os.path.splitext(FIT_YAML)[0]:
            self.fault(name, f"must be named {FIT_YAML}")
        elif ending_of(described) not in TABLE_READERS:
            self.fault(
                name, f"unexpected YAML file; options of a folder are in {FIT_YAML}, tap1.csv.yaml describes tap1.csv"
            )
        elif described not in entries:
            self.fault(name, f"describes {printable(described)}, which does not exist")
        elif not entry.endswith(".yaml"):
            self.fault(name, f"must be named {printable(described)}.yaml")

    def material(self, name: str, root: _Level) -> tuple[list[RecordingSet], list[_Level]]:
        """Return the recordings of each fit of a material, and the material's folders."""
        try:
            validate_materials({name: {"stiffness_n_per_m": 0.0}})
        except InvalidError as error:
            self.fault(name, f"invalid name of a material: {error.problems[0].problem}")
        own = self.level(name)
        kinds: dict[Kind, _Level] = {}
        if own.recordings:
            kind = _merged(root, own).kind
            self.may_set_kind |= {"", name}
            if kind is None and not (own.faulty or root.faulty):
                self.fault(
                    name,
                    f"holds recordings without a kind; put them into a folder {_KINDS_TEXT} or set kind in {FIT_YAML}",
                )
            if kind is not None:
                kinds[kind] = own
        levels = [own]
        for folder in own.folders:
            last = os.path.basename(folder)
            if last not in FIT_KINDS:
                self.fault(folder, f"unknown kind {quoted(last)}; {known_names(last, FIT_KINDS)}")
                continue
            below = self.level(folder)
            levels.append(below)
            for deeper in below.folders:
                self.fault(deeper, f"too deep; recordings must be in {printable(folder)} itself")
            if not below.recordings:
                self.fault(folder, f"holds no recordings ({', '.join(TABLE_READERS)})")
            elif last in kinds:
                self.fault(
                    folder, f"has the same kind as the recordings in {printable(name)} itself; put them into one folder"
                )
            else:
                kinds[last] = below
        self.check_kinds(name, kinds, levels)
        sets = [self.recording_set(name, kind, kinds[kind], root, own) for kind in FIT_KINDS if kind in kinds]
        return sets, levels

    def recording_set(self, material: str, kind: Kind, level: _Level, root: _Level, own: _Level) -> RecordingSet:
        """Return the recordings and options of one fit."""
        above = [root, own] if level is own else [root, own, level]
        for each in above:
            self.fitted_kinds[each.name].add(kind)
        given = _merged(*above)
        options = options_of(given, kind)
        self.check_options(options, above)
        files = []
        for name in level.recordings:
            try:
                files.append(fingerprint(os.path.join(self.root, name), name))
            except HapticdError as error:
                self.problems.append(Problem("", str(error)))
        strict = given.strict is True
        return RecordingSet(material, kind, level.name, tuple(files), options, strict, given.stiffness_n_per_m)

    # ---- Faults ------------------------------------------------------------------------------------------------------

    def check_kinds(self, name: str, kinds: dict[Kind, _Level], levels: list[_Level]) -> None:
        """Check the number of recordings of a material, and the combination of its kinds of fits."""
        if not kinds and len(levels) == 1 and not levels[0].recordings and not levels[0].folders:
            self.fault(
                name, f"holds no recordings; put them into a folder {_KINDS_TEXT}, or here with kind in {FIT_YAML}"
            )
        if len({MATERIAL_KEYS[kind] for kind in kinds}) < len(kinds):
            self.fault(name, "has grooves and a texture; a material can have only one of them")
        count = sum(len(level.recordings) for level in kinds.values())
        if count > MAX_PROVENANCE_FILES:
            self.fault(name, f"holds {count} recordings, at most {MAX_PROVENANCE_FILES} are allowed for a material")

    def check_options(self, options: FitOptions, above: list[_Level]) -> None:
        """Check that fit options do not exclude each other; a fault is reported at the innermost fit.yaml `above`."""
        spelled = {"form": "as:", "law": "law", "two_modes": "two_modes", "mode_table": "mode_table"}
        fault = options.fault(lambda option: spelled.get(option, option))
        if fault is None:
            return
        key = key_of(fault[0])
        owner = next(each.yaml for each in reversed(above) if each.yaml is not None and key in each.yaml.keys)
        problem = owner.problem(key, fault[1])
        if problem not in self.problems:
            self.problems.append(problem)

    def check_yaml(self, level: _Level) -> None:
        """Check the fit.yaml of a folder for keys that no fit below the folder uses."""
        if level.yaml is None:
            return
        fitted = self.fitted_kinds[level.name]
        for key in level.yaml.keys:
            kinds = KINDS_OF_KEY.get(key)
            if kinds is not None and not fitted & {*kinds}:
                has = ", ".join(kind for kind in FIT_KINDS if kind in fitted) or "nothing"
                self.problems.append(level.yaml.problem(key, f"only for {kinds[0]}; fitted here: {has}"))
            if key != "kind":
                continue
            last = os.path.basename(level.name)
            if level.name.count(os.sep) == 1:
                if level.yaml.folder.kind not in (None, last):
                    self.problems.append(level.yaml.problem(key, f"must be {last}, the name of the folder"))
            elif level.name not in self.may_set_kind:
                text = "only for recordings directly in the folder of a material, which do not exist here"
                self.problems.append(level.yaml.problem(key, text))

    def check_duplicates(self, sets: list[RecordingSet]) -> None:
        """Check that no two materials share a recording; each fit checks its own recordings."""
        first: dict[str, tuple[str, str]] = {}
        for each in sets:
            for file in each.files:
                material, name = first.setdefault(file.sha256, (each.material, file.name))
                if material != each.material:
                    other = printable(os.path.join(self.root, name))
                    self.fault(file.name, f"same content as {other}; a recording must belong to one material")


def _merged(*levels: _Level) -> BatchFolder:
    return merged(level.yaml.folder for level in levels if level.yaml is not None)
