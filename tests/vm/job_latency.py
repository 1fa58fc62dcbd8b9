"""How long a force takes through the daemon, beside a bare loop of C, and what a blocked writer does to the servo.

Runs on the PREEMPT_RT kernel; floor.c is the bare loop. The endpoints are held to frames of 1 ms; the handle moves so
that every position is another one, a spring answers, and each force that arrives says by its size which position it
answers: the latency is from that position's frame to the force's frame. Nothing takes less than one frame.
"""

from __future__ import annotations

import bisect
import os
import struct
import subprocess
import sys
import time
from typing import Any

import rig
import usb_pid_joystick as usb
from rig import check, scenario

SECONDS = 1
SPEED_M_PER_S = 0.06
WAY_M = 0.03
STIFFNESS = usb.FULL_SCALE_N / usb.TRAVEL_M / 2
HARDWARE = 95
INTERRUPTS = 50
"""What a kernel with PREEMPT_RT gives the threads of a host controller's interrupts."""


def sweep(t_s: float) -> tuple[float, float]:
    """To the right at a steady speed, back at another, so that no position comes twice within a few periods."""
    period = WAY_M / SPEED_M_PER_S
    u = t_s % (2 * period)
    return (SPEED_M_PER_S * (u if u < period else 2 * period - u) - WAY_M / 2, 0.0)


def config(clock: str, rate_hz: int, spring: bool = True) -> dict[str, Any]:
    pull = {"kind": "spring", "center_m": [0, 0], "stiffness_n_per_m": STIFFNESS}
    return {
        "device": {
            "kind": "hid",
            "hid": {"full_scale_force_n": usb.FULL_SCALE_N, "travel_m": usb.TRAVEL_M, "signs": "trust"},
        },
        "servo": {"rate_hz": rate_hz, "clock": clock},
        "scene": {"objects": {"pull": pull} if spring else {}},
    }


def latencies(joystick: usb.Joystick) -> list[float]:
    """Of every new force along x (effect 1), in ms."""
    with joystick.lock:
        record, positions = list(joystick.record), list(joystick.positions)
    times = [place[0] for place in positions]
    found, last = [], None
    for report in record:
        if (report.kind, report.id) != ("output", usb.SET_CONSTANT) or report.data[1] != 1:
            continue
        (magnitude,) = struct.unpack("<h", report.data[2:])
        if magnitude == last:
            continue
        last = magnitude
        x = -magnitude / usb.MAGNITUDE * usb.FULL_SCALE_N / STIFFNESS
        if abs(x) > WAY_M / 2 - 0.001:  # where the handle turns, a place comes twice within a few frames
            continue
        here = bisect.bisect(times, report.t_s)
        recent = range(max(here - 12, 0), here)
        best = min(recent, key=lambda k: (abs(positions[k][1] - x), -k), default=None)
        if best is not None and abs(positions[best][1] - x) < 0.6e-3 * SPEED_M_PER_S:
            found.append((report.t_s - times[best]) * 1e3)
    return found


def told(name: str, values: list[float]) -> tuple[float, float]:
    """Median and worst."""
    ordered = sorted(values)
    median, worst = ordered[len(ordered) // 2], ordered[-1]
    late, rate = ordered[int(0.99 * len(ordered))], len(values) / SECONDS
    print(f"  {name:28} median {median:6.3f} ms, 99 % {late:6.3f}, worst {worst:6.3f}; {rate:.0f} forces/s")
    return median, worst


def measure_floor(joystick: usb.Joystick, node: str) -> tuple[float, float]:
    running = subprocess.Popen([os.environ["VM_OUT"] + "/floor", node, str(SECONDS + 1)])
    time.sleep(0.5)
    joystick.clear()
    time.sleep(SECONDS)
    values = latencies(joystick)
    check(running.wait() == 0 and len(values) > 100 * SECONDS, "the bare loop ran", len(values))
    return told("a bare loop of C", values)


def measure_daemon(joystick: usb.Joystick, plug: usb.Plug, clock: str, rate_hz: int) -> tuple[float, float]:
    name = f"{clock}-{rate_hz}"
    with rig.daemon(config(clock, rate_hz), name) as daemon:
        daemon.client.set_forces(True)
        time.sleep(0.5)
        joystick.clear()
        time.sleep(SECONDS)
        values = latencies(joystick)
        check(len(values) > 100 * SECONDS, f"the daemon ran, {name}", len(values), daemon.faults())
        result = told(f"the daemon, {name} Hz", values)
        if clock == "timer":
            # The joystick is a process here, and would take the servo's only processor for 0.2 ms of each frame.
            plug.set_priority(INTERRUPTS)
            lateness(joystick, daemon)
            plug.set_priority(HARDWARE)
        daemon.stop()
    return result


def lateness(joystick: usb.Joystick, daemon: rig.Daemon) -> None:
    """Of the servo, while writes go through, and while the device leaves them waiting."""
    worst = {}
    for name, deaf in (("writes go through", False), ("the writer is blocked", True)):
        seen: list[int] = []
        with daemon.client.samples(timeout_s=10) as samples:
            joystick.deaf = deaf
            begin = time.monotonic()
            while time.monotonic() < begin + 0.5:
                batch = samples.receive(0.1)
                if batch is not None:  # the first one may hold what was before
                    seen += batch["lateness_ns"][batch["time_ns"] > begin * 1e9].tolist()
        joystick.deaf = False
        seen.sort()
        worst[name] = seen[-1] * 1e-3
        print(f"  servo, {name}: lateness median {seen[len(seen) // 2] * 1e-3:.1f} us, worst {worst[name]:.1f} us")
    free, blocked = worst.values()
    check(blocked < max(1.5 * free, free + 20), "a blocked writer does not make the servo late", blocked / free)


def main() -> None:
    sys.setswitchinterval(0.0001)
    check("rt" in os.uname().release, "a PREEMPT_RT kernel", os.uname().release)
    joystick = usb.Joystick(motion=sweep, priority=HARDWARE)
    with usb.Plug(joystick, interval_ms=1) as plug:
        scenario("position report to force report, endpoints held to frames of 1 ms")
        floor = measure_floor(joystick, plug.node)
        for clock, rate_hz in (("device", 1000), ("timer", 1000)):
            median, worst = measure_daemon(joystick, plug, clock, rate_hz)
            print(f"    {median / floor[0]:.2f} of the bare loop's median, {worst / floor[1]:.2f} of its worst")
            if clock == "device":
                check(median <= 1.2 * floor[0], "the median is within 1.2 of the bare loop", median / floor[0])
    rig.done()


if __name__ == "__main__":
    main()
