"""Devices as OpenFFBoard with one axis and as Fino: the simulated firmware of tests/support/firmware.py through real
hidraw."""

from __future__ import annotations

import signal
import sys
import time
from typing import Any

import job_pid
import rig
import usb_pid_joystick as usb
from rig import check, scenario, until
from usb_firmware import FirmwareJoystick

from tests.support import firmware_descriptors as descriptors
from tests.support.firmware import ARDUINO, FINO, OPENFFBOARD_1

STIFFNESS, DEPTH_M = 200.0, 0.005
FORCE_N = STIFFNESS * DEPTH_M
DURATION_S = 0.1
FRAME_S = 0.002
FOREIGN_S = 0.1
"""So long at most another program's effect lasts in the place of ours."""
TOLERANCE_N = 0.03


def config(**hid: Any) -> dict[str, Any]:
    return {
        "device": {"kind": "hid", "hid": {"full_scale_force_n": usb.FULL_SCALE_N, "travel_m": usb.TRAVEL_M, **hid}},
        "servo": {"rate_hz": 1000},
        "materials": {"soft": {"stiffness_n_per_m": STIFFNESS}},
        "scene": {
            "objects": {
                "side": {"kind": "wall", "point_m": [0.02, 0], "normal": [-1, 0], "material": "soft"},
                "floor": {"kind": "wall", "point_m": [0, -0.01], "normal": [0, 1], "material": "soft"},
            }
        },
    }


def pushes(joystick: FirmwareJoystick, wanted: tuple[float, float], seconds: float = 3.0) -> bool:
    """Whether it shows this force, or comes to it."""
    return bool(until(lambda: job_pid.near(joystick.force(), wanted, TOLERANCE_N), seconds))


def one_axis() -> None:
    scenario("one axis, whose flags have the logical range 0 to 0")
    joystick = FirmwareJoystick(descriptors.OPENFFBOARD_1, OPENFFBOARD_1)
    with (
        usb.Plug(joystick, interval_ms=2, product="one axis") as plug,
        rig.daemon(config(signs="trust"), "one_axis") as daemon,
    ):
        check("one axis" in str(daemon.device()), "get_status names it", daemon.device().get("name"))
        effects = joystick.stick.sent("set_effect")
        check(
            bool(effects) and effects[-1][13] == 2, "its effect has a direction", effects[-1:] and effects[-1].hex(" ")
        )
        joystick.motion = lambda t_s: (0.0, 0.0)
        daemon.client.set_forces(True)
        check(pushes(joystick, (0.0, 0.0)), "no force in the free", joystick.force())
        joystick.motion = lambda t_s: (0.02 + DEPTH_M, 0.0)
        check(pushes(joystick, (-FORCE_N, 0.0)), "the wall pushes to the left", joystick.force())
        time.sleep(0.3)
        check(pushes(joystick, (-FORCE_N, 0.0), 0), "and goes on", joystick.force())
        since = time.monotonic()
        daemon.kill(signal.SIGKILL)
        time.sleep(0.5)
        ended = joystick.zero_after(since)
        check(ended <= DURATION_S + 4 * FRAME_S, "SIGKILL: force zero after; s", ended)
        check(not joystick.stick.faults, "nothing that a strict device refuses", joystick.stick.faults[:4])
        check(bool(plug.node), "by way of", plug.node)


def takes_foreign_uploads() -> None:
    scenario("frees its effects when its pool is read, and says nothing of them")
    joystick = FirmwareJoystick(descriptors.FINO, FINO)
    settings = config(offload="auto", signs="trust")
    with (
        usb.Plug(joystick, interval_ms=2, product="Fino") as plug,
        rig.daemon(settings, "fino") as daemon,
    ):
        joystick.motion = lambda t_s: (0.02 + DEPTH_M, 0.0)
        daemon.client.set_forces(True)
        check(pushes(joystick, (-FORCE_N, 0.0)), "the side pushes to the left", joystick.force())
        joystick.motion = lambda t_s: (0.0, -0.01 - DEPTH_M)
        check(pushes(joystick, (0.0, FORCE_N)), "the floor pushes away", joystick.force())
        check(not joystick.stick.faults, "nothing that a strict device refuses", joystick.stick.faults[:4])

        scenario("the kernel's driver uploads an effect of its own, from the left")
        begin = time.monotonic()
        answer = rig.answer_of(job_pid.main, [job_pid.__file__, "upload", plug.event_node()])
        check(answer.returncode == 0, "uploaded and played", answer.stderr[-300:])
        time.sleep(0.5)
        check(pushes(joystick, (0.0, FORCE_N), 0), "the force is right afterwards", joystick.force())
        wrong = [t for t, x, y in joystick.forces if t > begin and not job_pid.near((x, y), (0.0, FORCE_N), 0.05)]
        print(f"  it was another one for {wrong[-1] - wrong[0] if wrong else 0.0:.3f} s")

        scenario("another driver resets the device and enables it, and plays an effect in the place of ours")
        joystick.motion = lambda t_s: (0.02 + DEPTH_M, 0.0)
        check(pushes(joystick, (-FORCE_N, 0.0)), "the side pushes to the left", joystick.force())
        begin = time.monotonic()
        joystick.stick.stranger(turns=0.0)
        uploaded = time.monotonic()
        time.sleep(0.5)
        check(pushes(joystick, (-FORCE_N, 0.0), 0), "the force is right afterwards", joystick.force())
        wrong = [t for t, x, y in joystick.forces if t > begin and not job_pid.near((x, y), (-FORCE_N, 0.0), 0.05)]
        lasted = wrong[-1] - uploaded if wrong else 0.0
        check(bool(wrong) and lasted <= FOREIGN_S + 4 * FRAME_S, "and was another one for; s", lasted)


def reversed_signs() -> None:
    scenario("pushes the other way, and was never calibrated: its handle is let go")
    joystick = FirmwareJoystick(descriptors.ARDUINO, ARDUINO)
    joystick.free = 0.05
    with usb.Plug(joystick, interval_ms=2, product="Arduino"), rig.daemon(config(), "arduino") as daemon:
        daemon.client.set_forces(True)
        check(
            until(lambda: "signs" in daemon.faults(), 15, 0.05),
            "a fault, before any force of the scene",
            daemon.faults(),
        )
        check(pushes(joystick, (0.0, 0.0), 1), "no force", joystick.force())
        most = max(max(abs(x), abs(y)) for _, x, y in joystick.forces)
        check(0.0 < most <= 0.1 * usb.FULL_SCALE_N + 0.01, "it was pushed with a tenth of its force; N", most)


def main() -> None:
    sys.setswitchinterval(0.0005)
    one_axis()
    takes_foreign_uploads()
    reversed_signs()
    rig.done()


if __name__ == "__main__":
    main()
