"""An open recording: rows, outlines and the scene at a row."""

from typing import Any

import numpy as np
import pytest

from hapticd.base.core import SAMPLE_DTYPE
from hapticd.base.errors import HapticdError
from hapticd.recording.recording import Recording
from hapticd.web.playback import MAX_OUTLINE_PIXELS, MAX_ROWS_PER_ANSWER, Playback

RATE_HZ = 1000.0


def recording(
    count: int = 1000, texts: dict[str, Any] | None = None, events: list[dict[str, Any]] | None = None
) -> Recording:
    samples = np.zeros(count, SAMPLE_DTYPE)
    samples["tick"] = np.arange(count) + 500
    samples["time_ns"] = 10**12 + np.arange(count) * 10**6
    samples["force_n"][:, 0] = 3 * np.sin(np.arange(count) / 7.0)
    samples["force_n"][:, 1] = 4 * np.sin(np.arange(count) / 7.0)
    samples["revision"] = 7 + (np.arange(count) >= count // 2)
    found = {"config": {"servo": {"rate_hz": RATE_HZ}}, "changes": [{"revision": 7}], **(texts or {})}
    return Recording("tap.npz", samples, events or [], found)


def floats(data: object) -> Any:
    assert isinstance(data, bytes)
    return np.frombuffer(data, "<f4")


def test_rows_come_as_telemetry_sends_them() -> None:
    found: Any = Playback(recording()).rows(10, 5)
    dtype = np.dtype([(name, form, *map(tuple, rest)) for name, form, *rest in found["dtype"]])
    rows = np.frombuffer(found["data"], dtype)
    assert (found["first"], found["count"], found["first_tick"], found["dropped"]) == (10, 5, 510, 0)
    assert rows["tick"].tolist() == [510, 511, 512, 513, 514]


def test_rows_end_with_the_recording() -> None:
    found = Playback(recording()).rows(998, 100)
    assert found["count"] == 2


@pytest.mark.parametrize(("first", "count"), [(-1, 1), (1000, 1), (0, 0), (0, MAX_ROWS_PER_ANSWER + 1), (2**70, 1)])
def test_rows_beyond_are_refused(first: int, count: int) -> None:
    with pytest.raises(HapticdError, match="must be between"):
        Playback(recording()).rows(first, count)


def test_an_outline_has_minimum_and_maximum_of_each_pixel() -> None:
    playback = Playback(recording())
    found = playback.outline("force_x_n", 0, 1000, 10)
    wanted = recording().samples["force_n"][:, 0].reshape(10, 100)
    assert floats(found["min"]).tolist() == wanted.min(1).astype("f4").tolist()
    assert floats(found["max"]).tolist() == wanted.max(1).astype("f4").tolist()
    assert "raw" not in found


def test_an_outline_of_few_rows_is_raw() -> None:
    found = Playback(recording()).outline("force_n", 100, 200, 50)
    wanted = np.hypot(*recording().samples["force_n"][100:200].T)
    assert floats(found["raw"]).tolist() == wanted.astype("f4").tolist()


def test_an_outline_leaves_out_nan() -> None:
    given = recording()
    given.samples["force_n"][5, 0] = np.nan
    given.samples["force_n"][300:400, 0] = np.nan
    found = Playback(given).outline("force_x_n", 0, 1000, 10)
    assert np.isfinite(floats(found["min"])).tolist() == [True] * 3 + [False] + [True] * 6


@pytest.mark.parametrize(
    ("column", "first", "last", "pixels"),
    [
        ("secret", 0, 10, 5),
        ("force_n", 10, 10, 5),
        ("force_n", 0, 1001, 5),
        ("force_n", 0, 10, MAX_OUTLINE_PIXELS + 1),
        ("force_n", 0, 10, 0),
    ],
)
def test_outlines_beyond_are_refused(column: str, first: int, last: int, pixels: int) -> None:
    with pytest.raises(HapticdError, match="must be"):
        Playback(recording()).outline(column, first, last, pixels)


def test_the_scene_is_that_of_the_row() -> None:
    texts = {
        "scene": {"ramp_s": 0.02, "objects": {"floor": {"kind": "wall"}, "peg": {"kind": "disc"}}},
        "materials": {"wood": {"stiffness_n_per_m": 800}},
        "changes": [
            {"revision": 7},
            {"revision": 8, "objects": {"peg": None, "box": {"kind": "box"}}, "scene": {"ramp_s": 0.1}},
            {"revision": 9, "objects": {"box": None}},
        ],
    }
    playback = Playback(recording(texts=texts))
    before, after = playback.scene(499), playback.scene(500)
    assert before == {"scene": texts["scene"], "materials": texts["materials"], "revision": 7}
    assert after["scene"] == {"ramp_s": 0.1, "objects": {"floor": {"kind": "wall"}, "box": {"kind": "box"}}}
    assert after["revision"] == 8


def test_facts_have_the_events_by_row() -> None:
    events = [
        {"event": "contact", "tick": 600, "object": "floor"},
        {"event": "rate", "tick": 601, "rate_hz": 500.0},
        {"event": "mark", "tick": 700, "text": "here", "data": {"large": 1}},
        {"event": "contact", "tick": 10**6, "object": "beyond"},
        {"event": "contact", "tick": "no number"},
    ]
    facts = Playback(recording(events=events)).facts()
    assert facts["events"] == [
        {"event": "contact", "tick": 600, "row": 100, "object": "floor"},
        {"event": "mark", "tick": 700, "row": 200, "text": "here"},
    ]
    assert (facts["rows"], facts["rate_hz"], facts["start_ns"]) == (1000, RATE_HZ, 10**12)
    assert facts["duration_s"] == pytest.approx(1.0)


def test_what_cannot_be_played_is_refused() -> None:
    with pytest.raises(HapticdError, match="contains no samples"):
        Playback(recording(0))
    with pytest.raises(HapticdError, match="its rate must be between"):
        Playback(recording(texts={"config": {"servo": {"rate_hz": 1e300}}}))
    with pytest.raises(HapticdError, match="holds no servo rate"):
        Playback(recording(texts={"config": {}}))


def test_texts_of_another_form_do_no_harm() -> None:
    texts = {
        "scene": {"objects": ["no map"]},
        "materials": 3,
        "changes": [{"revision": 7}, {"revision": 8, "objects": [1]}],
    }
    assert Playback(recording(texts=texts)).scene(999)["scene"] == {"objects": {}}
