"""Materials under their public name: `hapticd.materials.shipped_materials`."""

from hapticd.config.materials import Friction, Material, Materials, Rupture, Tap, shipped_materials

__all__ = ["Friction", "Material", "Materials", "Rupture", "Tap", "shipped_materials"]
