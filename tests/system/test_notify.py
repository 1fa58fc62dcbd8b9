"""sd_notify: which messages arrive at a service manager's socket, and when."""

from __future__ import annotations

import logging
import os
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from hapticd.system import notify


class Manager:
    """The service manager's end of the socket."""

    def __init__(self, address: str) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(address)
        self.socket.setblocking(False)

    def received(self) -> list[dict[str, str]]:
        """Return the received messages, each as a map of its variables."""
        found = []
        while True:
            try:
                message = self.socket.recv(65536).decode()
            except BlockingIOError:
                return found
            found.append(dict(line.split("=", 1) for line in message.splitlines()))


@pytest.fixture
def manager(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Manager]:
    manager = Manager(str(tmp_path / "notify"))
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    monkeypatch.delenv("WATCHDOG_USEC", raising=False)
    monkeypatch.delenv("WATCHDOG_PID", raising=False)
    yield manager
    manager.socket.close()


def test_messages_and_their_variables(manager: Manager) -> None:
    before = time.monotonic_ns() // 1000
    assert notify.ready("two\nlines = one") and notify.reloading() and notify.status("x") and notify.stopping()
    assert notify.alive()
    ready, reloading, status, stopping, alive = manager.received()
    assert ready == {"READY": "1", "STATUS": "two lines = one"}
    assert reloading.keys() == {"RELOADING", "MONOTONIC_USEC"}
    assert before <= int(reloading["MONOTONIC_USEC"]) <= time.monotonic_ns() // 1000
    assert (status, stopping, alive) == ({"STATUS": "x"}, {"STOPPING": "1"}, {"WATCHDOG": "1"})


def test_an_abstract_address(monkeypatch: pytest.MonkeyPatch) -> None:
    name = f"hapticd-test-{os.getpid()}"
    manager = Manager(f"\0{name}")
    monkeypatch.setenv("NOTIFY_SOCKET", f"@{name}")
    assert notify.ready()
    assert manager.received() == [{"READY": "1"}]
    manager.socket.close()


def test_without_a_service_manager_nothing_is_sent(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    assert not notify.ready("x") and not notify.alive() and not notify.stopping()
    assert not caplog.records


def test_a_manager_that_is_gone_is_logged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "nobody"))
    with caplog.at_level(logging.WARNING):
        assert not notify.ready()
    assert "READY=1" in caplog.text


def test_a_manager_that_does_not_read_is_not_waited_for(manager: Manager, caplog: pytest.LogCaptureFixture) -> None:
    while notify.alive():
        pass
    assert not caplog.records
    full = len(manager.received())
    assert full > 0
    assert notify.alive()


@pytest.mark.parametrize(
    ("usec", "pid", "wanted"),
    [("2000000", "", 2.0), ("0", "", None), ("", "", None), ("x", "", None), ("2000000", "1", None)],
)
def test_interval_of_the_watchdog(monkeypatch: pytest.MonkeyPatch, usec: str, pid: str, wanted: float | None) -> None:
    monkeypatch.setenv("WATCHDOG_USEC", usec)
    monkeypatch.setenv("WATCHDOG_PID", pid)
    assert notify.watchdog_s() == wanted


def test_the_watchdog_of_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WATCHDOG_USEC", "500000")
    monkeypatch.setenv("WATCHDOG_PID", str(os.getpid()))
    assert notify.watchdog_s() == 0.5


class World:
    """A clock, a servo and a status line."""

    def __init__(self) -> None:
        self.now_s, self.ticks, self.line = 100.0, 5, "forces off"

    def watch(self) -> Callable[[], None]:
        return notify.Watch(lambda: (self.ticks, self.line), lambda: self.now_s)


def test_the_watchdog_is_fed_while_the_servo_ticks_and_only_then(
    manager: Manager, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("WATCHDOG_USEC", "2000000")
    world = World()
    watch = world.watch()
    fed = []
    for step in range(400):  # 40 s; the servo stops from 10 s to 20 s
        world.now_s = 100.0 + 0.1 * step
        if not 100 <= step < 200:
            world.ticks += 1000
        watch()
        fed += [0.1 * step for message in manager.received() if message == {"WATCHDOG": "1"}]
    ticking = [time_s for time_s in fed if time_s <= 10.0]
    assert max(later - sooner for sooner, later in zip([0.0, *ticking], [*ticking, 10.0], strict=True)) <= 1.0
    # At most one message is due to ticks from before the stop.
    assert len([time_s for time_s in fed if 10.0 < time_s < 20.0]) <= 1
    assert any(20.0 <= time_s <= 21.0 for time_s in fed)


def test_the_status_line_is_sent_when_it_changes(manager: Manager) -> None:
    world = World()
    watch = world.watch()
    for step in range(100):
        world.now_s += 0.1
        world.ticks += 1
        world.line = "forces on" if step >= 50 else "forces off"
        watch()
    assert manager.received() == [{"STATUS": "forces off"}, {"STATUS": "forces on"}]


def test_nothing_is_looked_at_without_a_manager(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    monkeypatch.delenv("WATCHDOG_USEC", raising=False)
    polls = []
    watch = notify.Watch(lambda: (len(polls), "") if polls.append(1) is None else (0, ""), lambda: 1e9 * len(polls))
    before = len(polls)
    for _ in range(5):
        watch()
    assert len(polls) == before
