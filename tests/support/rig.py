"""A tick under test: one state, a scene that may change between stretches of positions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from hapticd.base.core import EVENT_DTYPE, SAMPLE_DTYPE, EventKind, Status, ffi, invalid_reason, lib, pointer, records
from hapticd.config.configuration import load_config
from hapticd.config.scene import MAX_OBJECTS
from hapticd.rendering.compiler.table import Compiler
from hapticd.rendering.device_output import output_of

WOOD = {
    "stiffness_n_per_m": 800,
    "tap": {"attack_slope_per_s": 309, "frequency_hz": 67, "decay_time_s": 0.00648},
}
FLOOR = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"}
SKIN = {"kind": "membrane", "center_m": [0, 0], "normal": [0, 1], "width_m": 0.02, "material": "cellophane"}


class Rig:
    """Renders stretches of positions on one state."""

    def __init__(
        self,
        objects: Mapping[str, object],
        *,
        rate_hz: float = 10_000,
        materials: Mapping[str, object] | None = None,
        device: Mapping[str, object] | None = None,
        **scene: object,
    ) -> None:
        self.source: dict[str, Any] = {
            "device": dict(device or {}),
            "materials": dict(materials or {}),
            "scene": {"objects": dict(objects), **scene},
        }
        self.config = load_config(self.source)
        self.rate_hz = rate_hz
        self.period_s = 1.0 / rate_hz
        self.compiler = Compiler(output_of(self.config, rate_hz))
        self.revision = 0
        self.state = ffi.gc(lib.hd_state_new(MAX_OBJECTS), lib.hd_state_free)
        self.world = ffi.gc(lib.hd_world_new(), lib.hd_world_free)
        self.events: npt.NDArray[np.void] = records(EVENT_DTYPE, 0)
        self._compile(self.config.scene.objects)

    def _compile(self, changed: Sequence[str] | Mapping[str, object]) -> None:
        self.revision += 1
        self.table = self.compiler.update(self.config.scene, changed, self.config.materials, self.revision)
        assert lib.hd_world_load(self.world, self.table) == Status.OK, invalid_reason()
        self.compiler.published()

    def update(
        self, objects: Mapping[str, object], materials: Mapping[str, object] | None = None, **scene: object
    ) -> None:
        """Replaces (or with None removes) objects and materials; the next tick sees it."""
        section = self.source["scene"]
        for id, item in objects.items():
            if item is None:
                section["objects"].pop(id)
            else:
                section["objects"][id] = item
        section.update(scene)
        self.source["materials"].update(materials or {})
        before = set(self.config.scene.objects)
        self.config = load_config(self.source)
        self._compile(sorted(before | set(self.config.scene.objects)))

    def render(
        self,
        positions: npt.ArrayLike,
        velocity: npt.ArrayLike | None = None,
        periods: npt.ArrayLike | None = None,
    ) -> npt.NDArray[np.void]:
        """The samples of a stretch; its events are in `events`."""
        path = np.ascontiguousarray(positions, dtype=np.float64)
        speeds = None if velocity is None else np.ascontiguousarray(velocity, dtype=np.float64)
        gaps = None if periods is None else np.ascontiguousarray(periods, dtype=np.uint32)
        samples = records(SAMPLE_DTYPE, len(path))
        room = records(EVENT_DTYPE, 8 * len(path) + 1024)
        count = ffi.new("size_t *")
        status = lib.hd_render(
            self.world,
            self.state,
            pointer("double[]", path),
            ffi.NULL if speeds is None else pointer("double[]", speeds),
            ffi.NULL if gaps is None else pointer("uint32_t[]", gaps),
            len(path),
            pointer("struct hd_sample[]", samples),
            pointer("struct hd_event[]", room),
            len(room),
            count,
        )
        assert status == Status.OK, invalid_reason()
        assert count[0] <= len(room)
        self.events = room[: count[0]].copy()
        return samples

    def kinds(self) -> list[EventKind]:
        """Kinds of the last stretch's events, in order."""
        return [EventKind(int(kind)) for kind in self.events["kind"]]

    def of(self, kind: EventKind) -> npt.NDArray[np.void]:
        """The last stretch's events of one kind."""
        found: npt.NDArray[np.void] = self.events[self.events["kind"] == kind]
        return found


def line(start: float, speed: float, count: int, rate_hz: float = 10_000, x: float = 0.0) -> npt.NDArray[np.float64]:
    """Positions straight down (positive speed) from height `start`, (count, 2)."""
    path = np.zeros((count, 2))
    path[:, 0] = x
    path[:, 1] = start - speed * np.arange(count) / rate_hz
    return path


def still(x: float, y: float, count: int) -> npt.NDArray[np.float64]:
    """The same position, (count, 2)."""
    return np.tile([x, y], (count, 1)).astype(np.float64)
