"""The scenes of the flight recorder's samples: which changes are kept, and which are dropped first."""

from __future__ import annotations

import pytest

from hapticd.config.configuration import default_config
from hapticd.config.modes import Mode
from hapticd.config.scene import MAX_PATCHES, Scene, SceneObject, validate_object, validate_scene
from hapticd.daemon.flight_scene import MAX_KEPT_WEIGHT, FlightScene
from hapticd.protocol.changes import MAX_FLIGHT_OBJECTS, MAX_FLIGHT_PARTS, Change, Played, Reset, Revised, revised
from hapticd.protocol.changes import MAX_LISTED_CHANGES as MAX_LISTED

MATERIALS = default_config().materials
FLOOR = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"}
RATE_HZ = 1000.0


def disc(place: float) -> SceneObject:
    return validate_object("disc", {"kind": "disc", "center_m": [place, 0], "radius_m": 0.01, "material": "wood"})


def moved(revision: int, place: float, id: str = "disc") -> Revised:
    return Revised(revision, {}, {id: disc(place)}, {}, None)


def played(tick: int) -> Played:
    return Played(tick, Mode(10.0, 300.0), "coefficient", (0.0, 1.0), 1.0)


@pytest.fixture
def scene() -> FlightScene:
    return FlightScene(validate_scene({"objects": {"floor": FLOOR}}), MATERIALS, 1, RATE_HZ)


def kept(scene: FlightScene) -> tuple[list[int | None], set[str], int]:
    """Return the changes' revisions (None: command), the ids at the beginning, and the first complete tick."""
    history = scene.history()
    objects = history.texts()["scene"]["objects"]  # type: ignore[index]
    return [change.get("revision") for change in history.change_maps()], set(objects), history.complete_from  # type: ignore[misc]


def test_changes_are_kept_as_long_as_a_sample_of_before_is(scene: FlightScene) -> None:
    changes: list[Change] = [moved(2, 0.1), played(50), moved(3, 0.2, "other"), Reset(70, ("disc",))]
    for change in changes:
        scene.take(change)
    assert kept(scene) == ([1, 2, None, 3, None], {"floor"}, 0)
    scene.forget(10, 1)
    assert kept(scene) == ([1, 2, None, 3, None], {"floor"}, 0)
    scene.forget(40, 2)
    assert kept(scene) == ([2, None, 3, None], {"floor", "disc"}, 0)
    scene.forget(60, 2)
    assert kept(scene) == ([2, 3, None], {"floor", "disc"}, 51)
    scene.forget(80, 3)
    assert kept(scene) == ([3], {"floor", "disc", "other"}, 71)
    history = scene.history()
    assert history.texts()["scene"]["objects"]["disc"]["center_m"] == [0.1, 0.0]  # type: ignore[index]
    assert history.missing({3, 4}) == [4]


def test_what_goes_away_is_gone(scene: FlightScene) -> None:
    scene.take(Revised(2, {"ramp_s": 0.5}, {"floor": None}, {"wood": None}, None, 500.0))
    scene.forget(0, 2)
    history = scene.history()
    texts = history.texts()
    assert texts["scene"] == {**Scene().to_dict(), "ramp_s": 0.5, "objects": {}}
    assert "wood" not in texts["materials"]  # type: ignore[operator]
    assert history.change_maps() == [{"revision": 2, "rate_hz": 500.0}]


def test_revisions_go_round(scene: FlightScene) -> None:
    scene = FlightScene(Scene(), MATERIALS, 0xFFFFFFFF, RATE_HZ)
    scene.take(moved(0, 0.1))
    assert kept(scene)[0] == [0xFFFFFFFF, 0] and scene.knows(0) and not scene.knows(1)
    scene.forget(5, 0)
    assert kept(scene)[0] == [0]


def test_of_too_many_changes_the_oldest_are_part_of_the_beginning(scene: FlightScene) -> None:
    scene.take(played(5))
    for revision in range(2, MAX_KEPT_WEIGHT + 2):
        scene.take(moved(revision, revision / 1e6))
    revisions, objects, complete_from = kept(scene)
    assert len(revisions) == 1 + MAX_KEPT_WEIGHT // 2, "each counts, and the object in it"
    assert (objects, complete_from) == ({"floor", "disc"}, 6)
    assert revisions[0] == MAX_KEPT_WEIGHT + 1 - MAX_KEPT_WEIGHT // 2
    assert scene.history().missing({1, 2, MAX_KEPT_WEIGHT}) == [1, 2]


def test_a_change_that_is_too_large_to_be_told_is_a_new_beginning(scene: FlightScene) -> None:
    before = validate_scene({"objects": {"floor": FLOOR}})
    after = before.with_objects({f"disc{number}": disc(number / 1e4) for number in range(MAX_LISTED + 1)})
    scene.take(moved(2, 0.1))
    change = revised(3, before, after, list(after.objects), MATERIALS, MATERIALS)
    assert change.complete is not None
    scene.take(change)
    scene.take(moved(4, 0.2))
    revisions, objects, _ = kept(scene)
    assert revisions == [3, 4] and objects == set(after.objects)


def test_a_scene_that_is_too_large_is_not_written() -> None:
    objects = {f"disc{number}": disc(number / 1e4) for number in range(MAX_FLIGHT_OBJECTS + 1)}
    scene = FlightScene(Scene().with_objects(objects), MATERIALS, 1, RATE_HZ)
    assert scene.history().texts() == {"scene": None, "materials": None}
    scene.take(Revised(2, {}, {"disc0": None}, {}, None))
    scene.forget(9, 2)
    assert len(kept(scene)[1]) == MAX_FLIGHT_OBJECTS


def patched(count: int) -> SceneObject:
    each = [{"from_m": 4e-4 * n, "to_m": 4e-4 * n + 3e-4, "material": "wood"} for n in range(count)]
    return validate_object("wall", {**FLOOR, "patches": each})


def test_patches_count_as_objects_do() -> None:
    """A patch is encoded in as many bytes as an object."""
    before = validate_scene({"objects": {"floor": FLOOR}})
    scene = FlightScene(before, MATERIALS, 1, RATE_HZ)
    large = patched(MAX_PATCHES)
    walls = {f"wall{number}": large for number in range(MAX_FLIGHT_PARTS // MAX_PATCHES + 1)}
    many = before.with_objects(walls)
    change = revised(2, before, many, list(walls), MATERIALS, MATERIALS)
    assert change.complete is not None and change.objects == {}
    scene.take(change)
    assert scene.history().texts() == {"scene": None, "materials": None}
    some = before.with_objects({"one": patched(500), "other": patched(500)})
    scene.take(revised(3, many, before, list(walls), MATERIALS, MATERIALS))
    for revision in range(4, 10):
        change = revised(revision, before, some, ["one", "other"], MATERIALS, MATERIALS)
        assert change.complete is None
        scene.take(change)
    assert kept(scene)[0] == [6, 7, 8, 9], "1003 parts each"


def test_after_a_change_that_never_came_nothing_is_known_until_all_of_it_is_told(scene: FlightScene) -> None:
    scene.take(moved(3, 0.1))
    assert scene.history().texts()["scene"] is None
    scene.take(Revised(4, {}, {}, {}, (validate_scene({"objects": {"floor": FLOOR}}), MATERIALS)))
    assert kept(scene) == ([4], {"floor"}, 0)
