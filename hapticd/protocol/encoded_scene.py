"""Scene and materials, encoded for answers: walls of many patches and materials that stay as they are, once.

Who asks for a scene of 80,000 patches again and again would otherwise have all of them encoded each time, and everybody
else would wait for it.
"""

from __future__ import annotations

from collections.abc import Mapping

from hapticd.base.codec import Encoded, encoded, encoded_list, encoded_map
from hapticd.base.model import AT_ONCE
from hapticd.config.materials import Material, Materials
from hapticd.config.patches import Patches
from hapticd.config.scene import Scene, SceneObject, Wall


class EncodedScene:
    """Keeps what was encoded; it is let go with what it stands for. For any thread."""

    def __init__(self) -> None:
        self._materials: dict[str, tuple[Material, Encoded]] = {}

    def prepare(self, objects: Mapping[str, SceneObject]) -> None:
        """Encodes what takes long. To be called before the objects are in force: who asks for them then would encode
        it, while others wait."""
        for item in objects.values():
            _patches_of(item)

    def scene(self, scene: Scene) -> Encoded:
        """As `scene.to_dict()`."""
        objects = encoded_map({id: _object(item) for id, item in scene.objects.items()})
        return encoded_map({**scene.to_dict(without={"objects"}), "objects": objects})

    def materials(self, materials: Materials) -> Encoded:
        """By their names, each as `material.to_dict()`."""
        before, found = self._materials, {}
        for name, material in materials.items():
            known = before.get(name)
            same = known is not None and known[0] is material
            found[name] = known if known and same else (material, encoded(material.to_dict()))
        self._materials = found
        return encoded_map({name: each for name, (_, each) in found.items()})


def _object(item: SceneObject) -> object:
    patches = _patches_of(item)
    return item.to_dict() if patches is None else encoded_map({**item.to_dict(without={"patches"}), "patches": patches})


def _patches_of(item: SceneObject) -> Encoded | None:
    """Many patches, encoded once; None where there are few or none."""
    if not isinstance(item, Wall) or not isinstance(item.patches, Patches) or len(item.patches) <= AT_ONCE:
        return None
    patches = item.patches
    if patches.encoded is None:
        patches.encoded = encoded_list(len(patches), patches.texts())
    return patches.encoded
