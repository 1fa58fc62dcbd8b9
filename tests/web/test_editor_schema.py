"""The answer of `web.schema`: units are separate members, and optional members do not allow null."""

import json
from typing import Any

import pytest

from hapticd.config.document_kinds import OBJECT_KINDS
from hapticd.config.materials import Material
from hapticd.config.scene import Scene
from hapticd.web.editor_schema import editor_schema


def definition(found: dict[str, Any]) -> dict[str, Any]:
    tree: Any = editor_schema()
    for part in found["$ref"].removeprefix("#/").split("/"):
        tree = tree[part]
    assert isinstance(tree, dict)
    return tree


def test_materials_and_scene_have_their_members() -> None:
    schema: Any = editor_schema()
    assert definition(schema["material"])["properties"].keys() == Material.model_fields.keys()
    assert definition(schema["scene"])["properties"].keys() == Scene.model_fields.keys()


@pytest.mark.parametrize("kind", OBJECT_KINDS)
def test_an_object_is_found_by_its_kind(kind: str) -> None:
    schema: Any = editor_schema()
    assert definition(schema["objects"][kind])["properties"]["kind"]["const"] == kind


def test_a_member_names_its_unit_once() -> None:
    stiffness = definition(editor_schema()["material"])["properties"]["stiffness_n_per_m"]  # type: ignore[arg-type]
    assert stiffness["unit"] == "N/m"
    assert stiffness["description"] == "Normal force per penetration depth or deflection."
    assert (stiffness["minimum"], stiffness["maximum"]) == (0, 1e5)


def test_a_member_that_may_be_absent_is_described_as_what_it_is() -> None:
    tap = definition(editor_schema()["material"])["properties"]["tap"]  # type: ignore[arg-type]
    frequency = definition(tap)["properties"]["frequency_hz"]
    assert frequency["type"] == "number"
    assert "default" not in frequency
    assert "null" not in json.dumps(editor_schema())


def test_every_reference_leads_somewhere() -> None:
    text = json.dumps(editor_schema())
    for part in text.split('"$ref": "')[1:]:
        assert definition({"$ref": part.split('"')[0]})["properties"]
