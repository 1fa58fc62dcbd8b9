"""Patches of a wall are kept as numbers, and nobody who uses them sees a difference to a tuple of them."""

from __future__ import annotations

import copy
import gc
import pickle
import tracemalloc
import weakref
from typing import Any

import pytest

from hapticd.config.configuration import Config
from hapticd.config.materials import Material
from hapticd.config.patches import Patch, Patches
from hapticd.config.scene import Scene, Wall, validate_object
from hapticd.rendering.compiler.table import Compiler
from hapticd.rendering.device_output import output_of

GIVEN = [
    {"from_m": 0.5, "to_m": 0.75, "material": "steel"},
    {"from_m": -1.0, "to_m": 0.25, "material": "foam"},
    {"from_m": 1.0, "to_m": 1.5, "material": "steel"},
]


def wall(patches: list[Any]) -> Wall:
    """A wall with these."""
    made = validate_object(
        "w", {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood", "patches": patches}
    )
    assert isinstance(made, Wall)
    return made


def many(count: int) -> list[dict[str, object]]:
    """So many, each of 0.3 mm."""
    return [{"from_m": 4e-4 * at, "to_m": 4e-4 * at + 3e-4, "material": "steel"} for at in range(count)]


def test_they_are_as_a_tuple_of_them() -> None:
    patches = wall(GIVEN).patches
    plain = tuple(Patch(**each) for each in GIVEN)  # type: ignore[arg-type]
    assert patches == plain and plain == patches and patches != plain[:2] and hash(patches) == hash(plain)
    assert tuple(patches) == plain and patches[1] == plain[1] and patches[-1] == plain[-1]
    assert patches[:2] == plain[:2] and len(patches) == 3 and plain[0] in patches and repr(patches) == repr(plain)
    assert patches[0].model_fields_set == plain[0].model_fields_set
    with pytest.raises(IndexError):
        patches[3]
    assert wall([]).patches == () and wall([]) == wall([]).model_copy(update={"patches": ()})


def test_what_follows_from_them() -> None:
    patches = wall(GIVEN).patches
    assert isinstance(patches, Patches)
    assert list(patches.order) == [1, 0, 2] and patches.first == {"steel": 0, "foam": 1}
    assert [patches.material(index) for index in range(3)] == ["steel", "foam", "steel"]


def test_they_come_back_as_they_were_given() -> None:
    made = wall(GIVEN)
    text = made.to_dict()
    assert text["patches"] == GIVEN and wall(GIVEN) == made
    assert validate_object("w", text) == made and Wall(**made.__dict__) == made
    for other in (pickle.loads(pickle.dumps(made)), copy.deepcopy(made)):
        assert other == made and isinstance(other.patches, Patches)
    assert wall([GIVEN[0]]) != wall([{**GIVEN[0], "material": "foam"}])
    assert Wall.model_construct(**{**made.__dict__, "patches": tuple(made.patches)}).to_dict() == text


def test_many_take_little_memory() -> None:
    given = many(2000)
    tracemalloc.start()
    try:
        made = wall(given)
        gc.collect()
        kept, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert made.to_dict()["patches"] == given
    # Two doubles, an index and a place in the order are 24 bytes each; a model of its own has 600.
    assert kept < 100 * len(given)


def test_a_material_that_nothing_is_made_of_is_let_go() -> None:
    compiler = Compiler(output_of(Config.parsed({"device": {"kind": "sim"}}), 1000.0))
    plain = Material(stiffness_n_per_m=100.0)
    scene = Scene(objects={"w": wall([])})
    watched = Material(stiffness_n_per_m=200.0)
    known = weakref.ref(watched)
    compiler.update(scene, ["w"], {"wood": watched}, 1)
    compiler.update(Scene(), ["w"], {"wood": watched, "other": plain}, 2)
    compiler.update(Scene(), [], {"other": plain}, 3)
    del watched
    gc.collect()
    assert known() is None
