"""`get_status`: the short answer is the long one without histograms, and cached members are never stale."""

from types import SimpleNamespace
from typing import Any, cast

import pytest

from hapticd.base import codec
from hapticd.config.configuration import load_config
from hapticd.daemon.engine import Engine
from hapticd.daemon.methods import Methods
from hapticd.daemon.refusal import MethodError
from hapticd.protocol import messages

WALL = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"}
MOVING = {"clock", "lease_s"}
"""Members that differ in each status."""


def still(status: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in status.items() if name not in MOVING}


def test_the_short_answer_is_the_report_without_histograms() -> None:
    engine = Engine(load_config({"scene": {"objects": {"floor": WALL}}}))
    flight = SimpleNamespace(version=1, status=lambda: {"written": flight.version})
    methods = Methods(engine, flight=cast(Any, flight))

    def compare() -> dict[str, Any]:
        report = still(methods.status())
        assert still(methods.call("get_status", {"detail": True})) == report
        del report["histograms"]
        assert still(methods.call("get_status", {})) == report
        return report

    first = compare()
    assert compare() == first
    methods.call("update_scene", {"objects": {"floor": {"point_m": [0.0, 0.01]}}})
    assert compare()["revision"] == first["revision"] + 1
    flight.version = 2
    assert compare()["flight"] == {"written": 2}
    engine.gesture_ended({"event": "gesture_end", "tick": 3})
    assert compare()["operator"]["ends"] == [{"event": "gesture_end", "tick": 3}]
    methods.call("lease", {"duration_s": 60.0})
    assert methods.call("get_status", {})["lease_s"] == pytest.approx(60.0, abs=5.0)
    with pytest.raises(MethodError, match="detail"):
        methods.call("get_status", {"detail": 1})


@pytest.mark.parametrize("counts", [(0, 0), (3, 4), (15, 1), (20, 2), (2, 70)])
def test_members_are_joined_to_one_map(counts: tuple[int, int]) -> None:
    first, second = (
        {f"{place}{index}": index for index in range(count)} for place, count in zip("ab", counts, strict=True)
    )
    joined = codec.Members.of(first).joined(second)
    assert joined == codec.encode({**first, **second})
    reply = messages.result_reply("x", codec.Encoded((joined,)))
    assert reply == messages.result_reply("x", {**first, **second})
