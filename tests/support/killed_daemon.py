"""Daemons that are there to be killed. They drive a joystick whose other end the test holds, so that it outlives them.

As a program (`python -m tests.support.killed_daemon FD RUNTIME_DIR CONFIG`): for each line on its standard input it
forks a daemon, says its process id, and, once that has ended, its exit code.
"""

from __future__ import annotations

import gc
import os
import sys
from types import SimpleNamespace
from typing import Any, cast

import hapticd.cli.daemon
import hapticd.daemon.process
from hapticd.config.hid import Hid
from hapticd.daemon import engine
from hapticd.hid import stopper
from hapticd.hid.connection import Opened, Source
from hapticd.hid.descriptor.layout import layout_of
from hapticd.hid.descriptor.parser import parse
from hapticd.hid.device import Device
from hapticd.hid.drivers.pid_plan import plan_of
from hapticd.hid.plan import Plan
from tests.support.hid_descriptors import Joystick

IDENTITY = stopper.Identity(240, 0, {"HID_NAME": "fake"})
NODE = "/dev/fake"
INDICES = (1, 2)
"""Of the effects that the test has set up."""


class _Driver:
    """What is set up is set up already."""

    def set_up(self, device: Device) -> Plan:
        return plan_of(layout_of(parse(bytes(Joystick()))), Hid(), "two", INDICES)


def source(fd: int) -> Source:
    """A joystick at the end of a socket."""

    def opened() -> Opened:
        own = os.dup(fd)
        device = SimpleNamespace(path=NODE, fileno=lambda: own, close=lambda: os.close(own))
        return Opened(cast(Device, device), _Driver(), "stick", None, True, False)

    return opened


def main(fd: int, runtime: str, config: str) -> None:
    patched = cast(Any, SimpleNamespace(engine=engine, stopper=stopper))
    patched.engine.source_of = lambda _: source(fd)
    patched.stopper.identity_of = lambda *_: IDENTITY
    for _ in sys.stdin:
        gc.disable()
        pid = os.fork()
        if pid == 0:
            os.close(0)
            os._exit(hapticd.daemon.process.run([config], runtime))
        print(pid, flush=True)
        print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2], sys.argv[3])
