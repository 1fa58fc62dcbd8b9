"""What the daemon validates of params that JSON Schema cannot say: relations between numbers, and what there is.

Params that are valid by their schema are taken, or refused with -32602 for one of these reasons; params that are not
valid by it are always refused with -32602.
"""

from __future__ import annotations

from typing import Final

RULES: Final[dict[str, str]] = {
    "length": "a normal, and the direction of play, have a length of at least 1e-9",
    "patches": "a patch of a wall is at least 1e-5 m wide; patches do not overlap, and touch or are 1e-5 m apart",
    "rising": "points over a speed, a force or time rise: by 1e-6 m/s, 1e-6 N, 1e-5 s",
    "as_many": "a table has as many rows, frequencies and decay times as it has speeds and forces",
    "grooves": "width_m of grooves is at most their spacing_m",
    "waveform": "a waveform begins and ends with 0, has a sample that is not 0, and lasts 0.1 s at most",
    "models": "models of a texture are stable, have an RMS of 1e6 m/s^2 at most, at most 256 different speeds and as "
    "many "
    "different forces, and no two of them have the same speed and force",
    "provenance": "a date is a day of the calendar; an interval does not end below its beginning",
    "stroke": "from_m and to_m of a stroke differ",
    "json": "data of a mark holds no byte strings, and has at most 8192 bytes as JSON",
    "known": "materials, objects and the tap or rupture of a material that are named must be there; materials that "
    "the scene "
    "uses stay",
    "rate": "the rate of the servo can carry the frequencies of textures that the scene uses",
    "reach": "a gesture lies on its object, which has a stiffness (a stroke) or a rupture (a puncture)",
    "merged": "what a merge patch makes of an object or a material is valid as a whole",
    "seq": "seq is above that of the message before",
    "files": "the configuration files are sound, and change nothing that needs a restart",
}

_SCENE: Final = ("length", "patches", "known", "rate")
_MATERIALS: Final = ("rising", "as_many", "grooves", "waveform", "models", "provenance", "rate")
OF_METHOD: Final[dict[str, tuple[str, ...]]] = {
    "set_scene": _SCENE,
    "update_scene": (*_SCENE, "merged"),
    "set_materials": _MATERIALS,
    "update_materials": (*_MATERIALS, "known", "merged"),
    "apply": (*dict.fromkeys(_SCENE + _MATERIALS),),
    "play": ("length", "known"),
    "reset": ("known",),
    "mark": ("json",),
    "set_operator": ("rising", "stroke", "known", "reach"),
    "stream_target": ("seq",),
    "stream_force": ("seq",),
    "reload": ("files",),
}
"""The rules that apply to each method; to others, none."""
