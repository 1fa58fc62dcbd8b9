"""The virtual joystick itself, driven report by report from a bare client: what the other jobs rest on; then the
commands that use a device without a daemon, and the udev rule."""

from __future__ import annotations

import errno
import json
import os
import struct
import subprocess
import time
from pathlib import Path

import hidraw
import usb_pid_joystick as usb
import yaml
from groups import with_group
from rig import answer_of, check, done, hapticd_says, scenario, until

from hapticd.hid.claim import CLAIM_RULES_PATH as RULES_OF_CLAIMS

RULES = Path(__file__).resolve().parents[2] / "systemd" / "70-hapticd.rules"


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


def dump_and_calibrate(joystick: usb.Joystick) -> None:
    """`hapticd devices` and its commands."""
    scenario("hapticd devices: listed, dumped, calibrated")
    name = f"{usb.VENDOR:04x}:{usb.PRODUCT:04x}"
    answer = hapticd_says("devices", "--json")
    listed = json.loads(answer.stdout)
    check([item["usable"] for item in listed] == [True], "listed as one that can be driven", answer.stdout[:200])
    joystick.motion = lambda t_s: (0.02 * t_s % 0.04, 0.0)
    answer = hapticd_says("devices", "dump", name, "-o", "/run/dump.jsonl", "--for", "0.2s")
    check(answer.returncode == 0, "dumped", answer.stdout.strip(), answer.stderr[-300:])
    answer = hapticd_says("devices", "dump", "1209:0000", "-o", "/run/none.jsonl")
    check(answer.returncode == 1 and "no HID device" in answer.stderr, "of another one, refused", answer.stderr.strip())
    joystick.free = -0.2  # it goes against the force, as one whose motors are wired the other way round
    joystick.clear()
    answer = hapticd_says("devices", "calibrate", "--yes")
    check(answer.returncode == 0, "calibrated", answer.stderr[-300:])
    axes = yaml.safe_load(answer.stdout)["device"]["hid"]["force_axes"]
    wrong_way = {"x": {"sign": -1}, "y": {"sign": -1}, "swap": False}
    check(axes == wrong_way, "it is found to push the wrong way", axes)
    check(joystick.force() == (0.0, 0.0) and not joystick.faults, "force zero at the end", joystick.faults[:3])
    most = max(abs(x) + abs(y) for _, x, y in joystick.forces)
    check(most <= 0.1 * usb.FULL_SCALE_N, "no more than a tenth of the full force; N", most)
    joystick.free = None


def claimed(plug: usb.Plug) -> None:
    """A program that has the event node open loses it, nobody but root gets the new one, and hidraw drives it on."""
    scenario("hapticd devices claim and release")
    name = f"{usb.VENDOR:04x}:{usb.PRODUCT:04x}"
    os.chmod(plug.event_node(), 0o660)  # as udev has it for whoever sits there
    held = os.open(plug.event_node(), os.O_RDWR | os.O_NONBLOCK)
    answer = hapticd_says("devices", "claim")
    check(answer.returncode == 0, "claimed", answer.stdout.strip(), answer.stderr[-300:])
    try:
        os.read(held, 24)
        check(False, "what was open of it ends")
    except OSError as error:
        check(error.errno == errno.ENODEV, "what was open of it ends", error.strerror)
    os.close(held)
    event = os.stat(plug.event_node())
    check(event.st_mode & 0o777 == 0o600, "its new event node is root's alone", oct(event.st_mode))
    (listed,) = json.loads(hapticd_says("devices", "--json").stdout)
    check(listed["claimed"] and listed["usable"], "it can be driven", listed["path"], listed["driver"])
    plug.node = listed["path"]
    plug.joystick.clear()
    answer = answer_of(lambda: client(plug.node))
    forces = [(x, y) for _, x, y in plug.joystick.forces]
    check((4.0, 0.0) in forces, "and it is, over hidraw", forces, answer.stderr[-300:])
    answer = hapticd_says("devices", "claim", name)
    check(answer.returncode == 1 and "already claimed" in answer.stderr, "not twice", answer.stderr.strip())
    answer = hapticd_says("devices", "release", name)
    check(answer.returncode == 0, "released", answer.stdout.strip(), answer.stderr[-300:])
    (listed,) = json.loads(hapticd_says("devices", "--json").stdout)
    check(not listed["claimed"] and not Path("/", RULES_OF_CLAIMS).exists(), "no rule is left", listed["path"])
    plug.node = listed["path"]
    answer = hapticd_says("devices", "release", name)
    check(answer.returncode == 1 and "is not claimed" in answer.stderr, "not twice either", answer.stderr.strip())


def rule(plug: usb.Plug) -> None:
    """What udev makes of the joystick's nodes, of one that is named in the rule and of one that is not."""
    scenario("the udev rule")
    groups = Path("/etc/group")
    groups.write_text(with_group(groups.read_text(), "input", 4321))
    folder = Path("/run/udev/rules.d")
    folder.mkdir(parents=True, exist_ok=True)
    text = RULES.read_text()
    first = text.index('KERNELS=="')
    line = f'KERNELS=="*:{usb.VENDOR:04X}:{usb.PRODUCT:04X}.*", ENV{{HAPTICD_DEVICE}}="1"\n'
    known = line.replace("HAPTICD_DEVICE", "HAPTICD_KNOWN")  # one of the PID class
    for what, rules, named in (
        ("not named", text, False),
        ("named", text[:first] + line + text[first:], True),
        ("known", text[:first] + known + text[first:], True),
    ):
        (folder / RULES.name).write_text(rules)
        os.chown(plug.node, 0, 0)
        os.chmod(plug.node, 0o600)
        applied(f"hidraw/{os.path.basename(plug.node)}")
        node = os.stat(plug.node)
        mine = (node.st_gid, node.st_mode & 0o777) == (4321, 0o660)
        check(mine, f"hidraw, {what}: for the group input", node.st_gid, oct(node.st_mode))
        said = applied(f"input/{os.path.basename(plug.event_node())}")
        ours = [words for words in said.splitlines() if RULES.name in words and "Reading" not in words]
        check(
            any("MODE 0600" in words for words in ours) == named,
            f"event, {what}: {'root only' if named else 'as it was'}",
            ours,
        )


def applied(device: str) -> str:
    """What udevadm says of it."""
    words = [os.environ["VM_UDEVADM"], "test", f"/sys/class/{device}"]
    return subprocess.run(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=True).stdout


joystick = usb.Joystick(motion=lambda t_s: (0.01, -0.02))
with usb.Plug(joystick) as plug:
    scenario("the virtual USB joystick, with a bare client")
    print(f"  the kernel's driver said at first: {[(r.kind, r.data.hex(' ')) for r in joystick.record]}")
    check(bool(plug.event_node()), "hid-pidff took it, with a constant force", plug.event_node())
    check(not joystick.faults, "and said nothing wrong", joystick.faults)
    joystick.clear()
    answer = answer_of(lambda: client(plug.node))
    check(answer.returncode == 0, "the client ran", answer.stderr[-300:])
    check(abs(float(answer.stdout) - 0.4) < 0.02, "100 writes take 100 frames", answer.stdout.strip())
    until(lambda: joystick.faults, 2)
    check([fault[:8] for fault in joystick.faults] == ["effect 2"], "a wrong report is noted", joystick.faults)
    forces = [(x, y) for _, x, y in joystick.forces]
    check(forces == [(0.0, 0.0), (4.0, 0.0), (0.0, 0.0)], "force on, and off by itself", joystick.forces)
    shown = joystick.forces[2][0] - joystick.forces[1][0]
    check(abs(shown - 0.1) < 0.01, "after the effect's duration", shown)
    dump_and_calibrate(joystick)
    claimed(plug)
    rule(plug)
done()
