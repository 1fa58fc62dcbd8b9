"""Where objects lie in the workspace: which the handle cannot reach, and which hold it deep inside.

An object holds the handle deep inside if it asks for more than the largest force of the device there. No hand comes
that deep by pressing, unless it overpowers the device; but an object that is put there pushes the hand out with all
the device's force (docs/adr/0067). A membrane has no inside. The functions take positions in m and forces in N.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Collection, Iterator, Mapping
from typing import Final, NamedTuple, Self, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticd.base.errors import Path, Problem, path_text
from hapticd.config.configuration import Config
from hapticd.config.materials import Material
from hapticd.config.scene import Scene, SceneObject, Surface
from hapticd.rendering.plausibility import field_problem

Point: TypeAlias = tuple[float, float]

NO_FORCE: Final = Problem("scene.display.force", "false: contacts and fields exert no force")
"""Note about a scene that holds the handle nowhere, because it displays no force."""

MAX_MOTION_FRACTION: Final = 0.25
"""A kept object that comes nearer by no more than this part of the half travel has moved; farther, it was put there."""
SPRING_FORCE_RATIO: Final = 2.0
"""A spring holds the handle if it asks for more than this multiple of the largest force: springs that guide ask for it
now and then."""
FAR_DISTANCE_RATIO: Final = 10.0
"""Positions farther from the middle than this multiple of the half travel are reported as implausible."""
_ROUNDING_ERROR_M: Final = 1e-9
"""A smaller distance is due to rounding."""
_M_PER_MM: Final = 1e-3


class Reach(NamedTuple):
    """Where the handle of a device can be, and the force that the device can exert."""

    half_travel_m: float
    """The handle reaches from minus to plus this distance from the middle, on each axis."""
    max_force_n: float
    rest_m: Point
    """Where the handle is at the start."""

    @classmethod
    def of(cls, config: Config) -> Self:
        """Return the reach of the configured device."""
        device = config.device
        if device.kind == "sim":
            return cls(device.sim.workspace_m, min(device.max_force_n, device.sim.max_force_n), device.sim.start_m)
        return cls(device.hid.travel_m, device.max_force_n, (0.0, 0.0))


def depth_m(item: SceneObject, at_m: Point) -> float:
    """Return how deep a point is inside a solid, or how far from the centre of a spring; not above 0 means outside."""
    x, y = at_m
    if item.kind == "wall":
        (point_x, point_y), (normal_x, normal_y) = item.point_m, item.normal
        return (point_x - x) * normal_x + (point_y - y) * normal_y
    if item.kind == "box":
        along, across = _own_axes(item.center_m, item.angle_rad, at_m)
        return min(0.5 * item.size_m[0] - abs(along), 0.5 * item.size_m[1] - abs(across))
    if item.kind == "disc":
        return item.radius_m - math.hypot(x - item.center_m[0], y - item.center_m[1])
    if item.kind == "spring":
        return math.hypot(x - item.center_m[0], y - item.center_m[1])
    return -math.inf


def holding(
    scene: Scene, objects: Mapping[str, SceneObject], materials: Mapping[str, Material], reach: Reach, at_m: Point
) -> frozenset[str]:
    """Return the ids of those of the scene's `objects` that hold a handle at a point deep inside."""
    if not scene.display.force:
        return frozenset()
    return frozenset(id for id, item in objects.items() if _holds(item, materials, reach, at_m))


def _holds(item: SceneObject, materials: Mapping[str, Material], reach: Reach, at_m: Point) -> bool:
    depth = depth_m(item, at_m)
    limit_n = reach.max_force_n * (SPRING_FORCE_RATIO if item.kind == "spring" else 1.0)
    return depth > 0.0 and _stiffness_at(item, materials, at_m) * depth > limit_n


def leaps_onto(item: SceneObject, before: SceneObject | None, reach: Reach, at_m: Point) -> bool:
    """Return whether an object has come over a point in one leap: it is new, or was much less deep `before`."""
    if before is None or before.kind != item.kind:
        return True
    return depth_m(item, at_m) - depth_m(before, at_m) > MAX_MOTION_FRACTION * reach.half_travel_m


def held_problem(
    item: SceneObject, materials: Mapping[str, Material], reach: Reach, at_m: Point, handle: str = "the handle"
) -> str:
    """Return the warning of an object that holds the handle at a point deep inside. `handle` says what is there."""
    x, y = at_m
    depth, stiffness_n_per_m = depth_m(item, at_m), _stiffness_at(item, materials, at_m)
    where = f"{depth:.4g} m {'from its centre' if item.kind == 'spring' else 'below its surface'}"
    return (
        f"{handle}, at [{x:.4g}, {y:.4g}], is {where}: it pushes with the device's largest force, "
        f"{reach.max_force_n:g} N, as {stiffness_n_per_m:g} N/m ask for {stiffness_n_per_m * depth:.4g} N"
        f"{_in_mm(item, reach)}"
    )


def unreachable_problem(item: SceneObject, reach: Reach) -> str | None:
    """Return the warning of an object that the handle cannot touch anywhere; None if it can, and for a field."""
    if item.kind == "viscous" or item.kind == "constant" or item.kind == "spring":
        return None
    x, y = item.point_m if item.kind == "wall" else item.center_m
    half_m = reach.half_travel_m
    # Nearly all objects have a point in reach; what the others take is not worth computing for these.
    if (-half_m <= x <= half_m and -half_m <= y <= half_m) or (gap_m := _gap_m(item, half_m)) <= _ROUNDING_ERROR_M:
        return None
    return (
        f"its surface cannot be reached: it is {gap_m:.4g} m beyond the range of the handle, {reach.half_travel_m:g} m "
        f"from the middle on each axis{_in_mm(item, reach)}"
    )


def _force_problem(item: SceneObject, reach: Reach) -> str | None:
    if item.kind != "constant" or math.hypot(*item.force_n) <= reach.max_force_n:
        return None
    return f"asks for {math.hypot(*item.force_n):.4g} N, and the device exerts at most {reach.max_force_n:g} N"


def placement_warnings(
    scene: Scene,
    materials: Mapping[str, Material],
    reach: Reach,
    *,
    objects: Mapping[str, SceneObject] | None = None,
    root: Path = ("scene", "objects"),
    handle_m: Point | None = None,
    held: Collection[str] | None = None,
) -> Iterator[Problem]:
    """Yield a warning for each object of a scene that is out of reach, holds the handle, or has implausible figures.

    `objects`: only these objects of the scene. Paths begin with `root`. `handle_m` is where the handle is, by default
    its position at the start. `held` are the objects that hold it there (`holding`), if they are known.
    """
    at_m, handle = (reach.rest_m, "the handle at rest") if handle_m is None else (handle_m, "the handle")
    objects = scene.objects if objects is None else objects
    held = holding(scene, objects, materials, reach, at_m) if held is None else held
    for id, item in objects.items():
        place: Path = ()
        problem = held_problem(item, materials, reach, at_m, handle) if id in held else None
        problem = problem or unreachable_problem(item, reach) or _force_problem(item, reach)
        if problem is None and (found := field_problem(item)) is not None:
            place, problem = (found[0],), found[1]
        if problem is not None:
            yield Problem(path_text((*root, id, *place)), problem)


def far_positions(position_m: npt.NDArray[np.float64], reach: Reach, name: str) -> list[Problem]:
    """Return a warning of positions, shape (n, 2), of which one is far beyond the range of the handle; else []."""
    farthest_m = float(np.abs(position_m).max(initial=0.0))
    if farthest_m <= FAR_DISTANCE_RATIO * reach.half_travel_m:
        return []
    problem = (
        f"has positions of up to {farthest_m:.4g} m, and the handle reaches {reach.half_travel_m:g} m from the middle: "
        "if they are in mm, divide them by 1000"
    )
    return [Problem(name, problem)]


def _own_axes(center_m: Point, angle_rad: float, at_m: Point) -> Point:
    """Return the coordinates of a point in the axes of a box."""
    x, y = at_m[0] - center_m[0], at_m[1] - center_m[1]
    if angle_rad == 0.0:
        return x, y
    cos, sin = math.cos(angle_rad), math.sin(angle_rad)
    return cos * x + sin * y, cos * y - sin * x


def _stiffness_at(item: SceneObject, materials: Mapping[str, Material], at_m: Point) -> float:
    if item.kind == "spring":
        return item.stiffness_n_per_m
    if item.kind == "viscous" or item.kind == "constant":
        return 0.0
    name = item.material
    if item.kind == "wall" and item.patches:
        (point_x, point_y), (normal_x, normal_y) = item.point_m, item.normal
        along = (at_m[0] - point_x) * normal_y - (at_m[1] - point_y) * normal_x
        begins, names = item.stretches()
        name = names[bisect_right(begins, along) - 1]
    return materials[name].stiffness_n_per_m


def _gap_m(item: Surface, half_m: float) -> float:
    """Return the distance from a surface to the square of half width `half_m`, along one axis; not above 0: none.

    It is the largest gap along the axes of both: convex shapes that have none along these overlap.
    """
    if item.kind == "wall":
        normal_x, normal_y = item.normal
        surface_m = item.point_m[0] * normal_x + item.point_m[1] * normal_y
        return abs(surface_m) - half_m * (abs(normal_x) + abs(normal_y))
    if item.kind == "disc":
        x, y = item.center_m
        return math.hypot(max(abs(x) - half_m, 0.0), max(abs(y) - half_m, 0.0)) - item.radius_m
    if item.kind == "box":
        half_width, half_height = 0.5 * item.size_m[0], 0.5 * item.size_m[1]
        angle_rad = item.angle_rad
    else:
        half_width, half_height = 0.5 * item.width_m, 0.0
        angle_rad = math.atan2(-item.normal[0], item.normal[1])
    x, y = item.center_m
    cos, sin = abs(math.cos(angle_rad)), abs(math.sin(angle_rad))
    along, across = _own_axes(item.center_m, angle_rad, (0.0, 0.0))
    return max(
        abs(x) - half_m - cos * half_width - sin * half_height,
        abs(y) - half_m - sin * half_width - cos * half_height,
        abs(along) - half_width - half_m * (cos + sin),
        abs(across) - half_height - half_m * (cos + sin),
    )


def _in_mm(item: SceneObject, reach: Reach) -> str:
    """Return a hint that the position may be in mm, if it is far away in m and in reach in mm; else ""."""
    if item.kind == "viscous" or item.kind == "constant":
        return ""
    key, point_m = ("point_m", item.point_m) if item.kind == "wall" else ("center_m", item.center_m)
    return point_in_mm(key, point_m, reach.half_travel_m)


def point_in_mm(name: str, point_m: Point, half_travel_m: float) -> str:
    """Return a hint that a point may be in mm, if it is far away in m and in reach in mm; else ""."""
    if not FAR_DISTANCE_RATIO * half_travel_m < max(map(abs, point_m)) <= half_travel_m / _M_PER_MM:
        return ""
    x, y = (_M_PER_MM * each for each in point_m)
    return f"; if {name} is in mm, write [{x:.4g}, {y:.4g}]"
