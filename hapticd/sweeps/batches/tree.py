"""The recordings of a tree, by material and kind of fit, with every fault of the tree before anything is fitted.

    TREE/fit.yaml                  for all materials; each fit.yaml may be left out
    TREE/MATERIAL/fit.yaml         for one
    TREE/MATERIAL/*.npz            recordings of the `kind` in one of these files
    TREE/MATERIAL/KIND/*.npz       recordings of that kind: tap, grooves, texture, puncture
    TREE/MATERIAL/KIND/fit.yaml    for one fit

Beside a recording stands its own YAML, as `hapticd fit` has it. Names that begin with a dot are left alone.
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
from hapticd.base.yaml_source import one_line
from hapticd.config.materials import MAX_PROVENANCE_FILES, validate_materials
from hapticd.fit.options import MATERIAL_KEYS, FitOptions
from hapticd.fit.recording import Kind
from hapticd.sweeps.batches.folder_yaml import NAME, TAKEN_BY, BatchFolder, FolderYaml, key_of, merged, options_of

KINDS: Final[tuple[Kind, ...]] = get_args(Kind)
_YAML: Final = (".yaml", ".yml")
_KNOWN: Final = ", ".join(KINDS[:-1]) + " or " + KINDS[-1]


@dataclass(frozen=True, slots=True)
class RecordingFile:
    """A recording: its name in the tree, and what it holds."""

    name: str
    sha256: str
    """Of the file."""
    beside: str
    """SHA-256 of the YAML beside it; empty: there is none."""


@dataclass(frozen=True, slots=True)
class RecordingSet:
    """The recordings of one fit, and how they are fitted."""

    material: str
    kind: Kind
    folder: str
    """In the tree."""
    files: tuple[RecordingFile, ...]
    options: FitOptions
    strict: bool
    stiffness_n_per_m: float | None


@dataclass(frozen=True, slots=True)
class Tree:
    """A tree of recordings."""

    path: str
    """As the user wrote it."""
    sets: tuple[RecordingSet, ...]
    """By material, then by kind: a puncture comes last, since it measures the stiffness."""
    others: tuple[str, ...]
    """Files that are no recordings, by their names in the tree."""


def read_tree(path: str) -> Tree:
    """Raises HapticdError where there is no such folder, InvalidError with every fault."""
    if not os.path.isdir(path):
        why = "is no folder" if os.path.exists(path) else "there is no such folder"
        raise HapticdError(f"{one_line(path)}: {why}; a batch needs a folder with a folder for each material")
    reader = _Reader(path)
    sets = tuple(reader.read())
    if not reader.problems and not sets:
        reader.fault("", f"holds no material: each has a folder with folders {_KNOWN}, or with recordings and {NAME}")
    if reader.problems:
        raise InvalidError(reader.problems)
    return Tree(path, sets, tuple(reader.others))


def fingerprint(path: str, name: str) -> RecordingFile:
    """What the recording at a path holds. Raises HapticdError where it cannot be read."""
    beside = f"{path}.yaml"
    return RecordingFile(name, _sha256(path), _sha256(beside) if os.path.lexists(beside) else "")


def _sha256(path: str) -> str:
    try:
        # A pipe would be waited for.
        if not stat.S_ISREG(os.stat(path).st_mode):
            raise HapticdError(f"{one_line(path)}: is no file")
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise HapticdError(f"{one_line(path)}: cannot be read: {error.strerror}") from None


@dataclass(slots=True)
class _Level:
    """A folder: what is in it."""

    name: str
    """In the tree."""
    yaml: FolderYaml | None = None
    faulty: bool = False
    """There is a fit.yaml that says nothing, since it has faults."""
    recordings: list[str] = field(default_factory=list)
    folders: list[str] = field(default_factory=list)


@dataclass(slots=True)
class _Reader:
    root: str
    problems: list[Problem] = field(default_factory=list)
    others: list[str] = field(default_factory=list)
    taken: dict[str, set[Kind]] = field(default_factory=lambda: defaultdict(set))
    """By folder: the kinds that are fitted in it and below."""
    loose: set[str] = field(default_factory=set)
    """Folders in which, or right below which, recordings stand that have their kind from a fit.yaml."""

    def fault(self, name: str, text: str) -> None:
        self.problems.append(Problem(one_line(os.path.join(self.root, name) if name else self.root), text))

    # ---- Folders -----------------------------------------------------------------------------------------------------

    def read(self) -> Iterator[RecordingSet]:
        root = self.level("")
        for name in root.recordings:
            self.fault(name, "stands beside the folders of the materials: put it into that of its own")
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
        """Reads a folder."""
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
            elif ending_of(entry) in _YAML:
                self.yaml(level, entry, entries)
            else:
                self.others.append(inside)
        return level

    def yaml(self, level: _Level, entry: str, entries: list[str]) -> None:
        """A YAML file is of the folder, or of a recording."""
        name, described = os.path.join(level.name, entry), os.path.splitext(entry)[0]
        if entry == NAME:
            level.faulty = True
            try:
                level.yaml = FolderYaml(os.path.join(self.root, name), os.path.join(self.root, name))
                level.faulty = False
            except InvalidError as error:
                self.problems += error.problems
            except HapticdError as error:
                self.problems.append(Problem("", str(error)))
        elif described == os.path.splitext(NAME)[0]:
            self.fault(name, f"must be called {NAME}")
        elif ending_of(described) not in TABLE_READERS:
            self.fault(name, f"is no YAML of a batch: that of a folder is {NAME}, that of tap1.csv is tap1.csv.yaml")
        elif described not in entries:
            self.fault(name, f"describes {one_line(described)}, which is not there")
        elif not entry.endswith(".yaml"):
            self.fault(name, f"must be called {one_line(described)}.yaml")

    def material(self, name: str, root: _Level) -> tuple[list[RecordingSet], list[_Level]]:
        """The fits of a material, and its folders."""
        try:
            validate_materials({name: {"stiffness_n_per_m": 0.0}})
        except InvalidError as error:
            self.fault(name, f"is no name of a material: {error.problems[0].problem}")
        own = self.level(name)
        kinds: dict[Kind, _Level] = {}
        if own.recordings:
            kind = _merged(root, own).kind
            self.loose |= {"", name}
            if kind is None and not (own.faulty or root.faulty):
                self.fault(name, f"holds recordings of no kind: put them into a folder {_KNOWN}, or kind into {NAME}")
            if kind is not None:
                kinds[kind] = own
        levels = [own]
        for folder in own.folders:
            last = os.path.basename(folder)
            if last not in KINDS:
                self.fault(folder, f"unknown kind {quoted(last)}; {known_names(last, KINDS)}")
                continue
            below = self.level(folder)
            levels.append(below)
            for deeper in below.folders:
                self.fault(deeper, f"is too deep: recordings stand in {one_line(folder)} itself")
            if not below.recordings:
                self.fault(folder, f"holds no recordings ({', '.join(TABLE_READERS)})")
            elif last in kinds:
                self.fault(
                    folder, f"is of the same kind as the recordings in {one_line(name)} itself: put them together"
                )
            else:
                kinds[last] = below
        self.check_kinds(name, kinds, levels)
        sets = [self.recording_set(name, kind, kinds[kind], root, own) for kind in KINDS if kind in kinds]
        return sets, levels

    def recording_set(self, material: str, kind: Kind, level: _Level, root: _Level, own: _Level) -> RecordingSet:
        """One fit."""
        above = [root, own] if level is own else [root, own, level]
        for each in above:
            self.taken[each.name].add(kind)
        said = _merged(*above)
        options = options_of(said, kind)
        self.check_options(options, above)
        files = []
        for name in level.recordings:
            try:
                files.append(fingerprint(os.path.join(self.root, name), name))
            except HapticdError as error:
                self.problems.append(Problem("", str(error)))
        strict = said.strict is True
        return RecordingSet(material, kind, level.name, tuple(files), options, strict, said.stiffness_n_per_m)

    # ---- Faults ------------------------------------------------------------------------------------------------------

    def check_kinds(self, name: str, kinds: dict[Kind, _Level], levels: list[_Level]) -> None:
        """What one material may have."""
        if not kinds and len(levels) == 1 and not levels[0].recordings and not levels[0].folders:
            self.fault(name, f"holds no recordings: they stand in a folder {_KNOWN}, or in it with kind in {NAME}")
        if len({MATERIAL_KEYS[kind] for kind in kinds}) < len(kinds):
            self.fault(name, "has grooves and a texture, and a material has one of them: leave out one folder")
        count = sum(len(level.recordings) for level in kinds.values())
        if count > MAX_PROVENANCE_FILES:
            self.fault(name, f"holds {count} recordings: {MAX_PROVENANCE_FILES} are the most of one material")

    def check_options(self, options: FitOptions, above: list[_Level]) -> None:
        """Options that do not go together; the fault stands at the innermost."""
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
        """Keys that no fit takes."""
        if level.yaml is None:
            return
        taken = self.taken[level.name]
        for key in level.yaml.keys:
            kinds = TAKEN_BY.get(key)
            if kinds is not None and not taken & {*kinds}:
                has = ", ".join(kind for kind in KINDS if kind in taken) or "nothing"
                self.problems.append(level.yaml.problem(key, f"is of {kinds[0]}, and here is fitted: {has}"))
            if key != "kind":
                continue
            last = os.path.basename(level.name)
            if level.name.count(os.sep) == 1:
                if level.yaml.folder.kind not in (None, last):
                    self.problems.append(level.yaml.problem(key, f"the folder says {last}: leave out one"))
            elif level.name not in self.loose:
                text = "is of recordings that stand in the folder of a material itself, and there are none"
                self.problems.append(level.yaml.problem(key, text))

    def check_duplicates(self, sets: list[RecordingSet]) -> None:
        """One recording is of one material. Within a fit, the fit refuses them."""
        first: dict[str, tuple[str, str]] = {}
        for each in sets:
            for file in each.files:
                material, name = first.setdefault(file.sha256, (each.material, file.name))
                if material != each.material:
                    other = one_line(os.path.join(self.root, name))
                    self.fault(file.name, f"holds the same as {other}: a recording is of one material")


def _merged(*levels: _Level) -> BatchFolder:
    return merged(level.yaml.folder for level in levels if level.yaml is not None)
