"""What a program passes that is wrong: one line that names the argument, before anything waits.

Asked of the client of coroutines, whose methods the blocking one runs.
"""

from __future__ import annotations

import asyncio
import inspect
import math
from collections.abc import Callable, Iterator
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hapticd
import hapticd.aio
from hapticd.client.blocking import connect
from tests.support.fake_daemon import FakeDaemon, fake_daemon, result

Call = Callable[[Any], Any]


@pytest.fixture(scope="module")
def fake(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FakeDaemon]:
    with fake_daemon(tmp_path_factory.mktemp("run"), lambda request: [result(request, {"tick": 1})]) as fake:
        yield fake


WRONG: list[tuple[str, Call]] = [
    ("method: must be a string, is 3", lambda d: d.call(3)),
    ("params: must be a mapping, is a list", lambda d: d.call("get_status", [])),
    ("scene: must be a mapping, the path of a file or a hapticd.Scene, is 3", lambda d: d.set_scene(3)),
    ("scene: must be a path, is empty", lambda d: d.set_scene("")),
    ("wait: must be True or False, is 1", lambda d: d.set_scene({}, wait=1)),
    ("wait: must be True or False, is \"yes\"", lambda d: d.reload(wait="yes")),
    ("objects: must be a mapping or the path of a file, is a list", lambda d: d.update_scene([])),
    ("objects: keys must be strings, this one is 1", lambda d: d.update_scene({1: None})),
    ("materials.a: must be a JSON value, is a Python object of type date",
     lambda d: d.set_materials({"a": date(2026, 1, 2)})),
    ("scene.a: must be an integer of at most 64 bits, is an integer of 71 bits",
     lambda d: d.apply(scene={"a": 2**70})),
    ("direction[1]: must be a number, is \"up\"",
     lambda d: d.play("wood", direction=[0, "up"], amplitude_m_per_s2=1)),
    ("direction: must be a list of numbers, is 3", lambda d: d.play("wood", direction=3, amplitude_m_per_s2=1)),
    ("mode: must be a mapping, is 200", lambda d: d.play(mode=200, amplitude_m_per_s2=1)),
    ("objects: must be a list of strings, is \"floor\"", lambda d: d.reset("floor")),
    ("text: must be text that UTF-8 can encode, is \"\\ud800\"", lambda d: d.mark("\ud800")),
    ("data.when: must be a JSON value, is a Python object of type date",
     lambda d: d.mark("a", {"when": date(2026, 1, 2)})),
    ("waypoints[0]: must be a list of numbers, is 0", lambda d: d.set_operator([0, 0, 0.01])),
    ("waypoints[1][2]: must be a number, is null", lambda d: d.set_operator([[0, 0, 0], [1, 0, None]])),
    ("gesture: must be a mapping, is \"tap\"", lambda d: d.set_operator(gesture="tap")),
    ("overwrite: must be True or False, is \"trial\"", lambda d: entered(d.record("a.npz", "trial"))),
    ("path: must be a path, is 3", lambda d: entered(d.record(3))),
    ("timeout_s: must be a number of seconds of more than 0, is 0", lambda d: d.states(0)),
    ("timeout_s: must be a number of seconds of more than 0, is true", lambda d: d.events(True)),
    ("newest: must be True or False, is 2", lambda d: d.states(newest=2)),
    ("topic: unknown topic \"sample\"; did you mean samples?",
     lambda d: d.telemetry("state", "sample")),
    ("telemetry: needs at least one topic; known: samples, state, event, change, status",
     lambda d: d.telemetry()),
]  # fmt: skip


async def entered(context: Any) -> None:
    async with context:
        raise AssertionError


@pytest.mark.parametrize(("told", "call"), WRONG, ids=[told.partition(",")[0] for told, _ in WRONG])
def test_what_is_wrong_is_named(fake: FakeDaemon, told: str, call: Call) -> None:
    asked = len(fake.requests)

    async def main() -> None:
        async with hapticd.aio.connect(fake.directory, 60.0) as client:
            found = call(client)
            if inspect.isawaitable(found):
                await found

    with pytest.raises(hapticd.InvalidError) as caught:
        asyncio.run(main())
    assert str(caught.value) == told
    assert len(fake.requests) == asked, "nothing was sent"


def test_numpy_is_as_good_as_lists(fake: FakeDaemon) -> None:
    with connect(fake.directory, np.float32(60)) as client:
        client.play("wood", direction=np.array([0, 1]), amplitude_m_per_s2=np.float64(2))
        client.set_operator(np.zeros((1, 3)))
        client.set_scene({}, wait=np.True_)  # type: ignore[arg-type]
        client.mark("a", np.arange(3))  # type: ignore[arg-type]
    play, operator, scene, mark = (request["params"] for request in fake.requests[-4:])
    assert play == {"material": "wood", "direction": [0.0, 1.0], "amplitude_m_per_s2": 2.0}
    assert operator == {"waypoints": [[0.0, 0.0, 0.0]]}
    assert scene == {"scene": {}, "wait": True}
    assert mark == {"text": "a", "data": [0, 1, 2]}


@pytest.mark.parametrize("module", [hapticd, hapticd.aio], ids=["blocking", "asyncio"])
@pytest.mark.parametrize("wrong", [0, -1, math.nan, math.inf, "5", None, True])
def test_times_of_connect(module: Any, wrong: Any, tmp_path: Path) -> None:
    with pytest.raises(hapticd.InvalidError, match=r"^timeout_s: must be a number of seconds of more than 0, is "):
        module.connect(tmp_path, timeout_s=wrong)
    if wrong != 0:
        with pytest.raises(hapticd.InvalidError, match=r"^wait_s: must be a number of seconds of at least 0, is "):
            module.connect(tmp_path, wait_s=wrong)


@pytest.mark.parametrize("read", [hapticd.load, hapticd.load_scene, hapticd.replay, connect])
@pytest.mark.parametrize("wrong", [3, b"x", [], "", "a\0b"])
def test_what_is_no_path(read: Call, wrong: Any) -> None:
    with pytest.raises(hapticd.InvalidError, match=r"^(path|scene|runtime_dir): must be a path, is "):
        read(wrong)


def test_a_closed_client_subscribes_to_nothing(fake: FakeDaemon) -> None:
    client = connect(fake.directory)
    client.close()
    with pytest.raises(hapticd.HapticdError, match="the client is closed"):
        client.states()
