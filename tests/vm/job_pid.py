"""A USB joystick of the PID class and the daemon: found, set up, felt, lost, found again, stopped in every way."""

from __future__ import annotations

import fcntl
import math
import os
import signal
import struct
import sys
import time
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import rig
import usb_pid_joystick as usb
from rig import check, scenario, until

STIFFNESS = 200.0
DEPTH_M = 0.005
FORCE_N = STIFFNESS * DEPTH_M
DURATION_S = 0.1
FRAME_S = 0.002
LETS_GO = 0.05
"""Speed of a handle that nobody holds, m/s for each newton."""
PULSE_N = 0.1 * usb.FULL_SCALE_N
SCENE = {
    "objects": {
        "floor": {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "soft"},
        "side": {"kind": "wall", "point_m": [0.02, 0], "normal": [-1, 0], "material": "soft"},
    }
}
CONFIG: dict[str, Any] = {
    "device": {
        "kind": "hid",
        "hid": {"full_scale_force_n": usb.FULL_SCALE_N, "travel_m": usb.TRAVEL_M, "signs": "trust"},
    },
    "servo": {"rate_hz": 1000},
    "materials": {
        "soft": {"stiffness_n_per_m": STIFFNESS},
        "bell": {
            "stiffness_n_per_m": STIFFNESS,
            "tap": {"attack_slope_per_s": 300, "frequency_hz": 40, "decay_time_s": 0.08},
        },
        "film": {
            "stiffness_n_per_m": STIFFNESS,
            "rupture": {
                "depth_m": 0.004,
                "amplitude_m_per_s2": 10,
                "decay_rate_per_s": 30,
                "angular_frequency_rad_per_s": 250,
                "heals": False,
            },
        },
    },
    "scene": SCENE,
}
Point = tuple[float, float]
ABOVE, INSIDE, AWAY = (0.0, 0.01), (0.0, -DEPTH_M), (0.0, 0.04)


def glide(start: Point, end: Point, duration_s: float) -> Callable[[float], Point]:
    """Minimum jerk from one place to another, beginning now."""
    begin = time.monotonic()

    def at(t_s: float) -> Point:
        u = min(max((t_s - begin) / duration_s, 0.0), 1.0)
        s = u**3 * (10 - 15 * u + 6 * u * u)
        return start[0] + s * (end[0] - start[0]), start[1] + s * (end[1] - start[1])

    return at


def go(joystick: usb.Joystick, end: Point, duration_s: float = 0.25) -> None:
    """Moves the handle there."""
    joystick.motion = glide(joystick.place, end, duration_s)
    time.sleep(duration_s + 0.05)


def near(force: Point, wanted: Point, tolerance: float = 0.03) -> bool:
    return math.dist(force, wanted) <= tolerance


def pressed(joystick: usb.Joystick, seconds: float = 5) -> bool:
    """Whether the force of the floor is there, or comes."""
    return bool(until(lambda: near(joystick.force(), (0, FORCE_N)), seconds))


def last_pushed(joystick: usb.Joystick, since: float) -> float:
    """How long after `since` the handle still felt a force."""
    until(lambda: joystick.force() == (0.0, 0.0), 5)
    with joystick.lock:
        joystick._show()
        ends = [t for t, x, y in joystick.forces if (x, y) == (0.0, 0.0) and t >= since]
    return (min(ends) if ends else math.inf) - since


def names(joystick: usb.Joystick) -> list[str]:
    """What the host said, as words."""
    controls = ["?", "enable", "disable", "stop all", "reset", "pause", "continue"]
    operations = ["?", "start", "start solo", "stop"]
    said = []
    for report in joystick.record:
        key = (report.kind, report.id)
        if key == ("output", usb.CONTROL):
            said.append(controls[report.data[1]])
        elif key == ("output", usb.OPERATION):
            said.append(f"{operations[report.data[2]]} {report.data[1]}")
        else:
            word = {
                ("output", usb.SET_EFFECT): "set",
                ("output", usb.SET_CONSTANT): "constant",
                ("output", usb.BLOCK_FREE): "free",
                ("output", usb.GAIN): "gain",
                ("set", usb.CREATE): "create",
                ("get", usb.BLOCK_LOAD): "load",
                ("get", usb.POOL): "pool",
            }.get(key, f"{key}")
            said.append(f"{word} {report.data[1]}" if word in ("set", "constant", "free") else word)
    return said


def in_order(said: list[str], wanted: list[str]) -> bool:
    """Whether these come in this order, whatever is between."""
    rest = iter(said)
    return all(any(word == other for other in rest) for word in wanted)


def upload() -> None:
    """A constant force through the kernel's own driver, in a process of its own."""
    node = os.open(sys.argv[2], os.O_RDWR)
    # type FF_CONSTANT, new, direction, no trigger, 100 ms, level, no envelope
    effect = bytearray(struct.pack("<HhHHHHH2xh", 0x52, -1, 0x4000, 0, 0, 100, 0, 0x2000).ljust(48, b"\0"))
    fcntl.ioctl(node, 0x40304580, effect, True)
    (number,) = struct.unpack_from("<h", effect, 2)
    os.write(node, struct.pack("<qqHHi", 0, 0, 0x15, number, 1))
    time.sleep(0.2)
    os.close(node)


def reset_by_another() -> None:
    """What newer kernels' hid-pidff says before an upload: reset, twice, and enable."""
    with open(sys.argv[2], "r+b", buffering=0) as node:
        for what in (usb.RESET, usb.RESET, usb.ENABLE):
            node.write(bytes([usb.CONTROL, what]))


def other(what: str, node: str) -> rig.Answer:
    return rig.answer_of(main, [__file__, what, node])


def found_and_set_up(joystick: usb.Joystick, daemon: rig.Daemon) -> None:
    scenario("found, and set up in the right order")
    device = daemon.device()
    check("PID joystick" in str(device), "get_status names it", device)
    check(until(lambda: len(joystick.forces) > 0, 2) and joystick.force() == (0.0, 0.0), "no force at the start")
    said = names(joystick)
    wanted = ["reset", "stop all", "enable", "gain", "create", "load", "set 1", "constant 1", "start 1"]
    check(in_order(said, wanted), "the set-up's order", said[:24])
    check(in_order(said, ["create", "load", "set 2", "constant 2", "start 2"]), "and the second axis")
    durations = {
        struct.unpack_from("<H", r.data, 3)[0] for r in joystick.record if r.id == usb.SET_EFFECT and r.kind == "output"
    }
    check(durations == {100}, "effects of 100 ms", durations)
    check(joystick.enabled and joystick.gain == 1.0, "actuators on, gain full", joystick.gain)
    check(not joystick.faults, "nothing that a strict device refuses", joystick.faults[:4])


def into_walls(joystick: usb.Joystick, daemon: rig.Daemon) -> None:
    scenario("into walls: magnitude, sign and axis")
    go(joystick, ABOVE)
    go(joystick, INSIDE)
    time.sleep(0.1)
    check(joystick.force() == (0.0, 0.0), "forces are off until they are asked for", joystick.force())
    daemon.client.set_forces(True)
    check(pressed(joystick), "the floor pushes away from the user", joystick.force())
    time.sleep(0.5)
    check(pressed(joystick, 0), "and goes on: effects are renewed", joystick.force())
    go(joystick, ABOVE)
    check(near(joystick.force(), (0, 0), 0.002), "nothing above it", joystick.force())
    go(joystick, (0.024, 0.01))
    check(near(joystick.force(), (-0.8, 0)), "the side pushes to the left", joystick.force())
    go(joystick, (0.022, -0.003))
    check(near(joystick.force(), (-0.4, 0.6)), "the corner pushes both ways", joystick.force())
    go(joystick, ABOVE)
    # A slow press, position by position against force by force.
    joystick.clear()
    go(joystick, (0, -0.01), 1.0)
    worst = 0.0
    for t, _, y in joystick.forces[2:]:
        past = [STIFFNESS * max(0.0, -place[2]) for place in joystick.positions if t - 0.02 <= place[0] <= t + FRAME_S]
        if past:
            worst = max(worst, min(past) - y, y - max(past))
    check(len(joystick.forces) > 100, "the force follows the handle", len(joystick.forces))
    check(worst < 0.02, "by what the floor says of a position of the last 20 ms; N beside it", worst)
    go(joystick, ABOVE)
    check(not joystick.faults, "nothing that a strict device refuses", joystick.faults[:4])


def tap_and_puncture(joystick: usb.Joystick, daemon: rig.Daemon) -> None:
    scenario("tap and puncture arrive")
    objects = {"floor": {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "bell"}}
    daemon.client.set_scene({"objects": objects}, wait=True)
    joystick.clear()
    go(joystick, (0, -0.0005), 0.1)
    time.sleep(0.15)
    rings = [(t, y - STIFFNESS * 0.0005) for t, _, y in joystick.forces]
    peak = max(abs(y) for _, y in rings)
    crossings = [b[0] for a, b in pairwise(rings) if a[1] * b[1] < 0 and abs(a[1]) > 0.02]
    check(peak > 0.1, "the tap rings; N at most", peak)
    steps = [later - sooner for sooner, later in pairwise(crossings)]
    period = 2 * sorted(steps)[len(steps) // 2] if steps else math.inf
    check(abs(period - 1 / 40) < 0.004, "at its frequency; Hz", 1 / period)
    go(joystick, AWAY)

    film = {"kind": "membrane", "center_m": [0, 0.02], "normal": [0, 1], "width_m": 0.1, "material": "film"}
    with daemon.client.events(timeout_s=10) as events:
        daemon.client.set_scene({"objects": {"film": film}}, wait=True)
        joystick.clear()
        go(joystick, (0, 0.01), 0.5)
        seen: list[str] = []
        deadline = time.monotonic() + 3
        while "puncture" not in seen and time.monotonic() < deadline:
            event = events.receive(0.1)
            seen += [str(event["event"])] if event else []
        check("puncture" in seen, "the film breaks", seen)
    time.sleep(0.2)
    most = max(y for _, _, y in joystick.forces)
    check(abs(most - STIFFNESS * 0.004) < 0.3, "at the force of its depth", most)
    check(near(joystick.force(), (0, 0), 0.01), "and does not push any more", joystick.force())
    daemon.client.set_scene(SCENE, wait=True)
    go(joystick, ABOVE)


def unplugged(joystick: usb.Joystick, daemon: rig.Daemon, plug: usb.Plug) -> None:
    scenario("unplugged and plugged in again, in contact")
    go(joystick, INSIDE)
    check(pressed(joystick), "in contact", joystick.force())
    before = daemon.client.get_scene()
    plug.pull()
    check(until(lambda: daemon.faults(), 3), "a fault", daemon.faults())
    joystick.clear()
    plug.plug_in(settle_s=0)
    check(until(lambda: daemon.device().get("state") == "connected", 10, 0.05), "found again", daemon.device())
    time.sleep(1.0)
    check(not any(y for _, _, y in joystick.forces), "no force yet", joystick.forces[-3:])
    daemon.client.set_forces(True)
    check(pressed(joystick), "the floor is there when forces are asked for", joystick.force())
    check(daemon.client.get_scene() == before, "the scene was kept")
    check(not joystick.faults, "nothing that a strict device refuses", joystick.faults[:4])


def resets(joystick: usb.Joystick, daemon: rig.Daemon, plug: usb.Plug) -> None:
    scenario("the device resets by itself, in contact")
    check(pressed(joystick), "in contact", joystick.force())
    joystick.power_on()
    lost = time.monotonic()
    if not pressed(joystick, 2):
        daemon.client.set_forces(True)
    check(pressed(joystick, 3), "set up again", joystick.force(), daemon.device())
    print(f"  the force was back after {time.monotonic() - lost:.3f} s")

    scenario("the kernel's driver uploads an effect of its own")
    answer = other("upload", plug.event_node())
    check(answer.returncode == 0, "uploaded and played", answer.stderr[-300:])
    check(pressed(joystick, 3), "the force is right afterwards", joystick.force())

    scenario("another driver resets the device and enables it, as newer kernels' hid-pidff does")
    joystick.clear()
    answer = other("reset", plug.node)
    check(answer.returncode == 0, "reset", answer.stderr[-300:])
    if not pressed(joystick, 3):
        daemon.client.set_forces(True)
    if not check(pressed(joystick, 3), "set up again", joystick.force(), names(joystick)[:12]):
        joystick.power_on()  # what follows needs a device that works


def stopped(joystick: usb.Joystick, daemon: rig.Daemon) -> None:
    scenario("stopped: by command, by SIGSTOP, by SIGTERM, by SIGKILL")
    check(pressed(joystick), "in contact", joystick.force())
    since = time.monotonic()
    daemon.client.set_forces(False)
    ended = last_pushed(joystick, since)
    check(ended < 0.05, "the stop command: force zero after; s", ended)
    daemon.client.set_forces(True)
    check(pressed(joystick), "on again", joystick.force())
    joystick.clear()
    daemon.kill(signal.SIGSTOP)
    since = time.monotonic()
    ended = last_pushed(joystick, since)
    check(ended <= DURATION_S + 4 * FRAME_S, "SIGSTOP: force zero after; s", ended)
    time.sleep(1.0)
    daemon.kill(signal.SIGCONT)
    if not pressed(joystick, 2):
        check(bool(daemon.faults()), "after SIGCONT a fault is latched", daemon.faults())
        until(lambda: daemon.device().get("state") == "connected", 5, 0.05)
        daemon.client.set_forces(True)
    check(pressed(joystick, 3), "SIGCONT: the force comes back", joystick.force())
    joystick.clear()
    since = time.monotonic()
    code = daemon.stop(signal.SIGTERM)
    ended = last_pushed(joystick, since)
    check(code == 0 and ended < 0.06, "SIGTERM: exit code, force zero after; s", code, ended)
    said = names(joystick)
    check(
        in_order(said, ["stop 1", "free 1", "disable"]) and in_order(said, ["stop 2", "free 2", "disable"]),
        "effects stopped and freed, actuators off",
        said[-8:],
    )
    check(not joystick.faults, "nothing that a strict device refuses", joystick.faults[:4])


def killed(joystick: usb.Joystick) -> None:
    with rig.daemon(CONFIG, "killed") as daemon:
        daemon.client.set_forces(True)
        check(pressed(joystick), "a new daemon, in contact", joystick.force())
        joystick.clear()
        since = time.monotonic()
        daemon.kill(signal.SIGKILL)
        ended = last_pushed(joystick, since)
        check(ended <= DURATION_S + 4 * FRAME_S, "SIGKILL: force zero after; s", ended)


def signs(joystick: usb.Joystick) -> None:
    scenario("never calibrated: its signs are checked before the first force of the scene")
    known = CONFIG["device"]["hid"]
    hid = {key: value for key, value in known.items() if key != "signs"}
    for free, wanted in ((-LETS_GO, "wrong"), (LETS_GO, "right")):
        go(joystick, ABOVE)
        with rig.daemon({**CONFIG, "device": {"kind": "hid", "hid": hid}}, f"signs-{wanted}") as daemon:
            joystick.clear()
            joystick.free = free
            daemon.client.set_forces(True)
            ended = until(lambda d=daemon: d.device()["signs"]["state"] not in ("checking", "waiting"), 20, 0.1)
            with joystick.lock:
                largest = max(math.hypot(x, y) for _, x, y in joystick.forces)
                joystick.motion, joystick.free = (lambda t_s, at=joystick.place: at), None
            told = daemon.device()["signs"]
            check(bool(ended) and told["state"] == wanted, f"signs are {wanted}", told)
            check(0.5 * PULSE_N < largest <= 1.01 * PULSE_N, "by a tenth of the full force; N", largest)
            go(joystick, INSIDE)
            if wanted == "right":
                check(pressed(joystick), "then the force of the scene", joystick.force())
            else:
                check(daemon.faults() == ["signs"] and joystick.force() == (0.0, 0.0), "no force", joystick.force())
                check("hapticd devices calibrate" in daemon.said(), "the log says what to do")


def main() -> None:
    if len(sys.argv) > 1:
        {"upload": upload, "reset": reset_by_another}[sys.argv[1]]()
        return
    sys.setswitchinterval(0.0005)
    joystick = usb.Joystick(motion=lambda t_s: AWAY)
    with usb.Plug(joystick, interval_ms=2) as plug:
        joystick.clear()
        with rig.daemon(CONFIG) as daemon:
            found_and_set_up(joystick, daemon)
            into_walls(joystick, daemon)
            tap_and_puncture(joystick, daemon)
            unplugged(joystick, daemon, plug)
            resets(joystick, daemon, plug)
            stopped(joystick, daemon)
        killed(joystick)
        signs(joystick)
    rig.done()


if __name__ == "__main__":
    main()
