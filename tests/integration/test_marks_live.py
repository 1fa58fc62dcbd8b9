"""Marks, ends of gestures and the newest sample: what of them a client is told, and when."""

from __future__ import annotations

from typing import Any

import pytest

from hapticd.client.blocking import Client, Subscription
from tests.support.daemon_process import Wire

AWAY = [[0.0, 0.0, 0.05], [0.05, 0.0, 0.04]]


def next_of(events: Subscription[Any], kind: str) -> dict[str, Any]:
    return next(event for event in events if event["event"] == kind)


DATA = [None, True, 5, -1.5, "text", [1, [2, {"a": None}]], {"trial": 3, "condition": {"gain": 0.5}}]


@pytest.mark.parametrize("data", DATA, ids=repr)
def test_a_mark_is_an_event_of_the_tick_that_it_was_answered_with(client: Client, data: Any) -> None:
    with client.events() as events:
        tick = client.mark("trial 3", data)["tick"]
        event = next_of(events, "mark")
    assert (event["tick"], event["text"], event["data"]) == (tick, "trial 3", data)
    assert set(event) == {"event", "tick", "time_ns", "text", "data"}


def test_marks_come_in_their_order_and_between_the_changes_around_them(client: Client) -> None:
    """Fewer than may be under way, so that none waits for the events before it to be sent."""
    with client.events() as events:
        before = client.set_scene({"objects": {}}, wait=True)["tick"]
        ticks = [client.mark(str(number))["tick"] for number in range(60)]
        after = client.set_scene({"objects": {}}, wait=True)["tick"]
        found = [next_of(events, "mark") for _ in ticks]
    assert [event["text"] for event in found] == [str(number) for number in range(60)]
    assert [event["tick"] for event in found] == ticks
    assert before <= ticks[0]
    assert ticks[-1] < after


def test_a_mark_needs_no_forces(client: Client) -> None:
    client.set_forces(False)
    try:
        with client.events() as events:
            tick = client.mark("quiet")["tick"]
            assert next_of(events, "mark")["tick"] == tick
    finally:
        client.set_forces(True)


def test_a_mark_passes_while_a_fault_is_latched(client: Client) -> None:
    with client.events() as events:
        client.lease(0.001)
        assert next_of(events, "fault")["faults"] == ["lease"]
        assert client.mark("faulted")["tick"] == next_of(events, "mark")["tick"]
    client.set_forces(True)


def test_the_newest_sample_is_that_of_the_topic_and_newer_than_what_was_answered(client: Client) -> None:
    for _ in range(20):
        tick = client.mark("now")["tick"]
        state = client.get_state()
        assert state["tick"] >= tick
    with client.states() as states:
        assert set(next(states)) == set(state)


def test_the_newest_sample_knows_what_is_touched(client: Client) -> None:
    deep = {"kind": "wall", "point_m": [0, 0.3], "normal": [0, 1], "material": "wood"}
    with client.events() as events:
        client.set_scene({"objects": {"deep": deep}}, force=True)
        next_of(events, "contact")
    state = client.get_state()
    assert state["touching"] == ["deep"]
    assert "contact" in state["flag_names"]
    client.set_scene({"objects": {}}, wait=True)


def test_a_gesture_ends_with_its_last_waypoint(client: Client) -> None:
    rate = client.get_status()["rate_hz"]
    with client.events() as events:
        started = client.call("set_operator", {"waypoints": AWAY})
        end = next_of(events, "gesture_end")
    assert isinstance(started, dict)
    assert set(end) == {"event", "tick", "time_ns", "started_tick", "completed"}
    assert (end["started_tick"], end["completed"]) == (started["tick"], True)
    # Of this length, but for periods that were missed: time goes on in those, ticks do not.
    assert end["tick"] - started["tick"] <= 0.05 * rate
    operator = client.get_status()["operator"]
    assert operator is not None
    assert operator["started_tick"] == started["tick"]
    assert operator["ends"][-1] == end


def test_a_gesture_that_is_replaced_ends_where_the_next_begins(client: Client) -> None:
    with client.events() as events:
        first = client.set_operator([[0.0, 0.0, 0.05], [1000.0, 0.0, 0.04]])["tick"]
        second = client.set_operator(AWAY)["tick"]
        ends = [next_of(events, "gesture_end") for _ in range(2)]
    assert [(end["started_tick"], end["completed"]) for end in ends] == [(first, False), (second, True)]
    assert ends[0]["tick"] == second


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "no text": ({}, "text"),
    "an empty text": ({"text": ""}, "text"),
    "a text that is none": ({"text": 3}, "text"),
    "a long text": ({"text": "x" * 1001}, "text"),
    "bytes": ({"text": "x", "data": {"a": [b"x"]}}, "data"),
    "NaN": ({"text": "x", "data": [float("nan")]}, "data"),
    "infinite": ({"text": "x", "data": float("-inf")}, "data"),
    "much data": ({"text": "x", "data": ["x" * 8200]}, "data"),
}


@pytest.mark.parametrize(("params", "where"), BAD.values(), ids=BAD.keys())
def test_marks_that_are_refused(wire: Wire, params: dict[str, Any], where: str) -> None:
    error = wire.error("mark", **params)
    assert error["code"] == -32602
    assert [fault["where"] for fault in error["data"]] == [where]


# ---- set_materials and apply ----------------------------------------------------------------------------------------

SOFT = {"stiffness_n_per_m": 300.0, "damping_n_s_per_m": 1.0}
WALL = {"kind": "wall", "point_m": [0.0, -0.05], "normal": [0.0, 1.0], "material": "soft"}


def test_materials_are_set_whole_and_others_stay(wire: Wire) -> None:
    wire.result("set_materials", materials={"soft": SOFT, "hard": {"stiffness_n_per_m": 2000.0}})
    before = wire.result("get_materials")["materials"]
    answer = wire.result("set_materials", materials={"soft": {"stiffness_n_per_m": 400.0}}, wait=True)
    after = wire.result("get_materials")
    assert set(answer) == {"revision", "margins", "tick"}
    assert after["revision"] == answer["revision"]
    assert after["materials"]["soft"] == {"stiffness_n_per_m": 400.0, "damping_n_s_per_m": 0.0}
    assert {**after["materials"], "soft": before["soft"]} == before
    error = wire.error("set_materials", materials={"soft": None})
    assert error["data"][0]["where"] == "materials.soft"
    assert "update_materials" in error["data"][0]["problem"]
    wire.result("update_materials", materials={"soft": None, "hard": None})


@pytest.mark.long
def test_materials_and_scene_are_one_change(wire: Wire) -> None:
    revision = wire.result("get_scene")["revision"]
    answer = wire.result("apply", materials={"soft": SOFT}, scene={"objects": {"floor": WALL}}, wait=True)
    assert answer["revision"] == revision + 1
    assert "tick" in answer
    assert wire.result("get_scene")["scene"]["objects"]["floor"]["material"] == "soft"
    assert wire.result("apply", materials={"soft": {"stiffness_n_per_m": 1.0}})["revision"] == revision + 2
    assert wire.result("apply", scene={"objects": {}})["revision"] == revision + 3
    assert wire.error("apply", scene={"objects": {}}, expect_revision=revision)["code"] == -32001
    wire.result("update_materials", materials={"soft": None})


REFUSED: dict[str, tuple[dict[str, Any], list[str]]] = {
    "nothing": ({}, [""]),
    "nil": ({"scene": None}, ["scene"]),
    "faults of both": (
        {"materials": {"soft": {"stiffness_n_per_m": -1.0}}, "scene": {"objects": {"a": 1}}},
        ["materials.soft.stiffness_n_per_m", "scene.objects.a"],
    ),
    "an unknown material": (
        {"materials": {"sofd": SOFT}, "scene": {"objects": {"floor": WALL}}},
        ["scene.objects.floor.material"],
    ),
    "a rate that is too low for what was sent": (
        {
            "materials": {
                "soft": {
                    **SOFT,
                    "texture": {
                        "kind": "stochastic",
                        "peak_hz": 6000.0,
                        "mean_hz": 100.0,
                        "velocity_gain_per_s": 1.0,
                        "threshold_m_per_s": 0.002,
                    },
                }
            },
            "scene": {"objects": {"floor": WALL}},
        },
        ["materials.soft.texture.peak_hz"],
    ),
}


@pytest.mark.long
@pytest.mark.parametrize(("params", "where"), REFUSED.values(), ids=REFUSED.keys())
def test_what_is_applied_is_all_or_nothing(wire: Wire, params: dict[str, Any], where: list[str]) -> None:
    scene, materials = wire.result("get_scene"), wire.result("get_materials")
    error = wire.error("apply", **params)
    assert error["code"] == -32602
    assert [fault["where"] for fault in error["data"]] == where
    assert wire.result("get_scene") == scene
    assert wire.result("get_materials") == materials
