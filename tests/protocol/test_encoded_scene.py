"""Scene and materials, as they are told: the same as not encoded before, and what stays is encoded once."""

import msgpack
import pytest

from hapticd.base import codec
from hapticd.config.materials import Material, validate_materials
from hapticd.config.patches import Patches
from hapticd.config.scene import Scene, validate_scene
from hapticd.protocol import messages
from hapticd.protocol.encoded_scene import EncodedScene


def scene(count: int) -> Scene:
    edges = [(-10 + index * 5e-4, -10 + index * 5e-4 + 2e-4) for index in range(count)]
    patches = [{"from_m": begin, "to_m": end, "material": "cork"} for begin, end in edges]
    wall = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"}
    disc = {"kind": "disc", "center_m": [0, 0.1], "radius_m": 0.01, "material": "wood"}
    objects = {"floor": {**wall, "patches": patches}, "bare": wall, "knob": disc}
    return validate_scene({"ramp_s": 0.05, "objects": objects})


@pytest.mark.parametrize("count", [0, 3, 2000])
def test_a_scene_is_told_as_it_is(count: int) -> None:
    made = scene(count)
    assert msgpack.unpackb(bytes(EncodedScene().scene(made))) == made.to_dict()


def test_many_patches_are_encoded_once(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    texts = Patches.texts
    monkeypatch.setattr(Patches, "texts", lambda self: asked.append(len(self)) or texts(self))
    told, made = EncodedScene(), scene(2000)
    first = told.scene(made)
    assert told.scene(made) == first
    assert told.scene(made.model_copy(update={"ramp_s": 0.1})) != first
    assert asked.count(2000) == 1
    prepared = scene(3000)
    told.prepare(prepared.objects)
    assert asked.count(3000) == 1
    told.scene(prepared)
    assert asked.count(3000) == 1


def test_materials_are_encoded_once_and_let_go(monkeypatch: pytest.MonkeyPatch) -> None:
    materials = validate_materials({"wood": {"stiffness_n_per_m": 300}, "cork": {"stiffness_n_per_m": 90}})
    asked = []
    to_dict = Material.to_dict
    monkeypatch.setattr(
        Material,
        "to_dict",
        lambda self, **options: asked.append(self.stiffness_n_per_m) or to_dict(self, **options),
    )
    told = EncodedScene()
    assert msgpack.unpackb(bytes(told.materials(materials))) == {
        name: to_dict(each) for name, each in materials.items()
    }
    told.materials(materials)
    assert asked == [300, 90]
    other = validate_materials({"cork": {"stiffness_n_per_m": 80}})["cork"]
    told.materials({"wood": materials["wood"], "cork": other})
    assert asked == [300, 90, 80]
    told.materials({"cork": other})
    told.materials(materials)  # nothing is kept of what was not there meanwhile
    assert asked == [300, 90, 80, 300, 90]


@pytest.mark.parametrize("id", [7, "seven", None])
def test_an_answer_is_the_same_to_the_byte(id: int | str | None) -> None:
    result = {"scene": {"objects": {"a": [1, 2.5, None]}}, "revision": 3}
    encoded = {**result, "scene": codec.encoded(result["scene"])}
    assert messages.result_reply(id, encoded) == messages.result_reply(id, result)
    assert bytes(codec.encoded_list(2, iter([1, "b"]))) == codec.encode([1, "b"])


def test_a_large_part_of_an_answer_is_sent_from_where_it_stands() -> None:
    patches = [[n, 0.5 * n] for n in range(5_000)]
    large, small = codec.encoded_list(len(patches), patches), codec.encoded({"x": 1})
    scene = codec.encoded_map({"first": small, "patches": large, "last": small})
    reply = messages.result_reply(3, {"scene": scene, "revision": 9})
    assert isinstance(reply, codec.Encoded) and any(part is large.parts[0] for part in reply.parts)
    assert bytes(reply) == messages.result_reply(
        3, {"scene": {"first": {"x": 1}, "patches": patches, "last": {"x": 1}}, "revision": 9}
    )
    assert len(reply) == len(bytes(reply)) > codec.LARGE_PART
