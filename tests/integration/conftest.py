"""A real daemon for each file of tests, and clients of it for each test; a file that needs another has its own."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from hapticd.client.blocking import Client
from tests.support.daemon_process import Daemon, Wire, connect, running_daemon, wired


@pytest.fixture(scope="module")
def daemon() -> Iterator[Daemon]:
    with running_daemon() as daemon:
        yield daemon


@pytest.fixture(scope="module")
def quiet_daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    """A daemon at 1 kHz without real-time rights; it may miss any number of periods."""
    config = tmp_path_factory.mktemp("config") / "quiet.yaml"
    config.write_text("servo: {rate_hz: 1000, realtime: off, overruns: {threshold: 1}}\n")
    with running_daemon("-c", str(config)) as daemon:
        yield daemon


@pytest.fixture
def wire(daemon: Daemon) -> Iterator[Wire]:
    with wired(daemon) as wire:
        yield wire


@pytest.fixture
def client(daemon: Daemon) -> Iterator[Client]:
    with connect(daemon.directory) as client:
        yield client
