"""A daemon over a HID joystick that is no hardware: what `hapticd run` does, in a process that has the joystick, too.

As a program (`launcher -m tests.sanitized.stick RUNTIME_DIR CONFIG`): it does what the lines on its standard input say
until that is closed, and answers each with `done`: `plug`, `unplug`, `reset` (somebody else resets the joystick),
`hold` (the handle, in the floor) and `move`, `commit` (the defect that the sanitizer is to find).
"""

from __future__ import annotations

import importlib
import math
import sys
import threading
from types import SimpleNamespace
from typing import Any, cast

import hapticd.cli.daemon
import hapticd.daemon.process
from hapticd.config.configuration import config_of
from hapticd.daemon import engine
from hapticd.hid import stopper
from hapticd.hid.connection import Opened
from hapticd.hid.device import Device
from hapticd.hid.drivers.pid import PidDriver
from hapticd.hid.plan import DeviceError
from tests.support.hid_descriptors import Joystick
from tests.support.hid_device import FakePid
from tests.support.killed_daemon import IDENTITY

COUNTS = 32767
DEPTH = 0.1
"""How far the handle goes into the floor, as a part of its travel."""
PERIOD_S = 0.004


class Rig:
    """The joystick, the hand on it, and who tells them what to do."""

    def __init__(self, config: str) -> None:
        self.hid = config_of([config]).device.hid
        self.stick: FakePid | None = None
        self.moving = True
        self.over = threading.Event()

    def open(self) -> Opened:
        stick = self.stick
        if stick is None:
            raise DeviceError("no HID device is connected")
        return Opened(cast(Device, stick.device), PidDriver(stick.layout, self.hid), "stick", None, False)

    def move(self) -> None:
        step = 0
        while not self.over.wait(PERIOD_S):
            step += 1
            stick = self.stick
            if stick is not None:
                away = 2 * math.pi * PERIOD_S * step
                # HID's Y grows towards the user: into the floor. There it is held: above it nothing pushes.
                x, y = (math.sin(away), math.sin(3 * away)) if self.moving else (0.0, 1.0)
                stick.report(round(COUNTS * 0.3 * x), round(COUNTS * DEPTH * y))

    def obey(self, line: str) -> None:
        match line.split():
            case ["plug"]:
                self.stick = FakePid(bytes(Joystick(time_exponent=-4, level=10000)))
            case ["unplug"]:
                stick, self.stick = self.stick, None
                assert stick is not None
                stick.unplug()
            case ["reset"]:
                assert self.stick is not None
                self.stick.reset()
            case ["hold"]:
                self.moving = False
            case ["move"]:
                self.moving = True
            case ["commit"]:
                assert importlib.import_module("hapticd_defect").commit()
            case _:
                raise ValueError(line)

    def listen(self) -> None:
        for line in sys.stdin:
            self.obey(line)
            print("done", flush=True)


def main(runtime: str, config: str) -> int:
    rig = Rig(config)
    patched = cast(Any, SimpleNamespace(engine=engine, stopper=stopper))
    patched.engine.source_of = lambda _: rig.open
    patched.stopper.identity_of = lambda *_: IDENTITY
    rig.obey("plug")
    threads = [threading.Thread(target=work) for work in (rig.move, rig.listen)]
    for thread in threads:
        thread.start()
    code = hapticd.daemon.process.run([config], runtime)
    rig.over.set()
    for thread in threads:
        thread.join()
    return code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], sys.argv[2]))
