"""Patches of a wall: as given, in order along the wall, and limited in number."""

from __future__ import annotations

import copy
import gc
import pickle
import weakref
from typing import Any

import pytest

from hapticd.base.errors import InvalidError
from hapticd.config.configuration import Config
from hapticd.config.materials import Material
from hapticd.config.scene import MAX_PATCHES, MAX_SCENE_PATCHES, Patch, Scene, Wall, patches_in_order, validate_object
from hapticd.rendering.compiler.table import Compiler
from hapticd.rendering.device_output import output_of

GIVEN = [
    {"from_m": 0.5, "to_m": 0.75, "material": "steel"},
    {"from_m": -1.0, "to_m": 0.25, "material": "foam"},
    {"from_m": 1.0, "to_m": 1.5, "material": "steel"},
]


def wall(patches: list[Any]) -> Wall:
    """Return a wall with these patches."""
    made = validate_object(
        "w", {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood", "patches": patches}
    )
    assert isinstance(made, Wall)
    return made


def test_patches_are_ordered_along_the_wall() -> None:
    patches = wall(GIVEN).patches
    assert patches == tuple(Patch(**each) for each in GIVEN) and patches_in_order(patches) == [1, 0, 2]  # type: ignore[arg-type]
    assert wall([]).patches == ()


def test_patches_are_returned_as_given() -> None:
    made = wall(GIVEN)
    text = made.to_dict()
    assert text["patches"] == GIVEN and wall(GIVEN) == made
    assert validate_object("w", text) == made and Wall(**made.__dict__) == made
    for other in (pickle.loads(pickle.dumps(made)), copy.deepcopy(made)):
        assert other == made
    assert wall([GIVEN[0]]) != wall([{**GIVEN[0], "material": "foam"}])
    assert Wall.model_construct(**{**made.__dict__, "patches": tuple(made.patches)}).to_dict() == text


def test_the_number_of_patches_is_limited() -> None:
    many = [{"from_m": 4e-4 * at, "to_m": 4e-4 * at + 3e-4, "material": "steel"} for at in range(MAX_PATCHES + 1)]
    with pytest.raises(InvalidError, match=f"patches: must hold at most {MAX_PATCHES} entries"):
        wall(many)
    large = wall(many[:-1])
    count = MAX_SCENE_PATCHES // MAX_PATCHES
    scene = Scene(objects={f"w{at}": large for at in range(count)})
    refused = f"must have at most {MAX_SCENE_PATCHES} patches in all, have {(count + 1) * MAX_PATCHES}"
    with pytest.raises(InvalidError, match=refused):
        scene.with_objects({"one more": large})
    with pytest.raises(InvalidError, match=refused):
        Scene(objects={f"w{at}": large for at in range(count + 1)})


def test_an_unused_material_is_released() -> None:
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
