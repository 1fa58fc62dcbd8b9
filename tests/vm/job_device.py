"""The virtual joystick itself, driven report by report from a bare client: what the other jobs rest on."""

from __future__ import annotations

import struct
import subprocess
import sys
import time

import hidraw
import usb_pid_joystick as usb
from rig import check, done, scenario, until


def client(node: str) -> None:
    """In a process of its own, as a device must not be its own user."""
    device = hidraw.device()
    device.open_path(node.encode())
    device.write([usb.CONTROL, usb.RESET])
    device.write([usb.CONTROL, usb.ENABLE])
    device.write([usb.GAIN, 255])
    device.send_feature_report([usb.CREATE, 1, 0, 0])
    assert device.get_feature_report(usb.BLOCK_LOAD, 5)[:3] == [usb.BLOCK_LOAD, 1, 1]
    device.write(struct.pack("<BBB4HBB3B", usb.SET_EFFECT, 1, 1, 100, 0, 0, 0, 255, 255, 1, 0, 0))
    device.write(struct.pack("<BBh", usb.SET_CONSTANT, 1, 5000))
    device.write([usb.OPERATION, 1, usb.START, 1])
    begin = time.monotonic()
    for _ in range(100):
        device.write(struct.pack("<BBh", usb.SET_CONSTANT, 1, 5000))
    took = time.monotonic() - begin
    time.sleep(0.3)
    device.write(struct.pack("<BBh", usb.SET_CONSTANT, 2, 1))
    device.close()
    print(took)


if len(sys.argv) > 1:
    client(sys.argv[1])
    sys.exit()

joystick = usb.Joystick(motion=lambda t_s: (0.01, -0.02))
with usb.Plug(joystick) as plug:
    scenario("the virtual USB joystick, with a bare client")
    print(f"  the kernel's driver said at first: {[(r.kind, r.data.hex(' ')) for r in joystick.record]}")
    check(bool(plug.event_node()), "hid-pidff took it, with a constant force", plug.event_node())
    check(not joystick.faults, "and said nothing wrong", joystick.faults)
    joystick.clear()
    answer = subprocess.run([sys.executable, __file__, plug.node], capture_output=True, text=True)
    check(answer.returncode == 0, "the client ran", answer.stderr[-300:])
    check(abs(float(answer.stdout) - 0.4) < 0.02, "100 writes take 100 frames", answer.stdout.strip())
    until(lambda: joystick.faults, 2)
    check([fault[:8] for fault in joystick.faults] == ["effect 2"], "a wrong report is noted", joystick.faults)
    forces = [(x, y) for _, x, y in joystick.forces]
    check(forces == [(0.0, 0.0), (4.0, 0.0), (0.0, 0.0)], "force on, and off by itself", joystick.forces)
    shown = joystick.forces[2][0] - joystick.forces[1][0]
    check(abs(shown - 0.1) < 0.01, "after the effect's duration", shown)
done()
