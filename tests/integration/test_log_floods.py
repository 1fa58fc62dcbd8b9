"""What a client can cause in the log: of each kind a line at once, then sums, however fast it asks."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path

import msgpack
import pytest

from hapticd.daemon.methods import _METHOD_HANDLERS
from tests.support.daemon_process import Daemon, Wire, running_daemon, until, wired

TIMES = 2000
NAMES = count()


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    config = tmp_path_factory.mktemp("c") / "c.yaml"
    config.write_text(
        "servo: {rate_hz: 1000, realtime: off, overruns: {threshold: 1}}\nflight: {seconds: 1}\n"
        "scene: {objects: {push: {kind: constant, force_n: [0, 0.5]}}}\n"
    )
    with running_daemon("-c", str(config)) as running:
        yield running


def notification(method: str, **params: object) -> bytes:
    return msgpack.packb({"jsonrpc": "2.0", "method": method, "params": params})


FLOODS: dict[str, Callable[[], bytes]] = {
    'notification "n': lambda: notification(f"n{next(NAMES)}"),
    'notification "set_forces"': lambda: notification("set_forces", enabled=next(NAMES)),
    'notification "set_scene"': lambda: notification("set_scene", scene={}, expect_revision=10**6 + next(NAMES)),
    'notification "update_materials"': lambda: notification("update_materials", materials={f"m{next(NAMES)}": 1}),
    "reloaded: ": lambda: notification("reload"),
    "forces turned ": lambda: notification("set_forces", enabled=next(NAMES) % 2 == 0),
}
"""What the lines begin with, and what makes them."""


@pytest.mark.parametrize("line", FLOODS)
def test_a_flood_is_a_line_a_second(daemon: Daemon, line: str) -> None:
    times = TIMES if line.startswith("notification") else TIMES // 10
    before = len(daemon.said().splitlines())
    with wired(daemon) as wire:
        begin = time.monotonic()
        for _ in range(times):
            wire.socket.send(FLOODS[line]())
        wire.result("get_status")
        until(lambda: len(lines_of(daemon, before, line)) >= 1)  # a reload is made beside what is asked
        took_s = time.monotonic() - begin
        # Whatever was held back is told in the next second, or when it doubles.
        told = lines_of(daemon, before, line)
        assert len(told) <= took_s + 2
        assert counted(told) <= times


def test_forces_that_are_turned_on_or_off_are_logged(tmp_path: Path) -> None:
    with running_daemon() as running, wired(running) as wire:
        wire.result("set_forces", enabled=True)  # they are on
        for enabled in (False, False, True, True):
            wire.result("set_forces", enabled=enabled)
        until(lambda: len(lines_of(running, 0, "forces turned ")) == 2)
        off, on = lines_of(running, 0, "forces turned ")
        assert off.endswith("forces turned off by a command (set_forces)")
        assert "forces turned on by a command (set_forces)" in on


@pytest.mark.long
def test_a_flood_of_files_is_a_line_a_second(daemon: Daemon) -> None:
    before = len(daemon.said().splitlines())
    with wired(daemon) as wire:
        begin = time.monotonic()
        for _ in range(200):
            wire.result("dump_flight")
        took_s = time.monotonic() - begin
        assert len(lines_of(daemon, before, "flight recorder: ")) <= took_s + 2


@pytest.mark.long
def test_methods_are_the_only_kinds() -> None:
    """A client cannot think of more kinds of lines than there are methods and codes."""
    with running_daemon() as running, wired(running) as wire:
        for _ in range(20):
            for method in _METHOD_HANDLERS:
                wire.socket.send(notification(method, **{f"k{next(NAMES)}": 1}))
        wire.result("get_status")
        assert len(lines_of(running, 0, "notification ")) <= 2 * len(_METHOD_HANDLERS)


@pytest.mark.long
def test_every_one_is_counted(tmp_path: Path) -> None:
    with running_daemon() as running, wired(running) as wire:
        flood(wire, FLOODS['notification "set_forces"'], 500)
        running.stop()
        assert counted(lines_of(running, 0, 'notification "set_forces"')) == 500


def flood(wire: Wire, make: Callable[[], bytes], times: int) -> None:
    for _ in range(times):
        wire.socket.send(make())
    wire.result("get_status")


def lines_of(daemon: Daemon, before: int, begin: str) -> list[str]:
    """Lines of a kind since then."""
    return [line for line in daemon.said().splitlines()[before:] if f"hapticd: {begin}" in line]


def counted(lines: list[str]) -> int:
    """How many they stand for."""
    more = re.findall(r"\(and ([\d,]+) more", "\n".join(lines))
    return len(lines) + sum(int(number.replace(",", "")) for number in more)
