"""A home-built joystick through uhid, driven by a description of its reports, and what is said of wrong ones."""

from __future__ import annotations

import copy
import json
import signal
import time
from typing import Any

import rig
import uhid_vendor_joystick as uhid
from rig import check, scenario, until

STIFFNESS = 200.0
CONFIG: dict[str, Any] = {
    "device": {"kind": "hid", "hid": {"vendor": uhid.VENDOR, "product": uhid.PRODUCT, "report": uhid.DESCRIPTION}},
    "servo": {"rate_hz": 1000},
    "materials": {"soft": {"stiffness_n_per_m": STIFFNESS}},
    "scene": {"objects": {"peg": {"kind": "box", "center_m": [0, 0], "size_m": [0.02, 0.02], "material": "soft"}}},
}


def refused(name: str, config: dict[str, Any], *wanted: str) -> None:
    """The daemon does not start, and says why in one line."""
    try:
        rig.Daemon(config, name).stop(signal.SIGKILL)
        said = "it started"
    except RuntimeError as error:
        said = str(error).partition(": ")[2].strip()
    check(all(word in said for word in wanted) and "Traceback" not in said, name, said)


def main() -> None:
    scenario("without a device")
    refused("no device", {"device": {"kind": "hid"}}, "no HID device")
    with uhid.VendorJoystick() as joystick:
        joystick.motion = lambda t_s: (0.03, 0.03)
        scenario("a vendor device is seen, and is no PID device")
        answer = rig.hapticd_says("devices", "--json")
        check(answer.returncode == 0, "hapticd devices", answer.stdout[:300] + answer.stderr[-200:])
        check("uhid" in json.dumps(json.loads(answer.stdout)) or "vendor joystick" in answer.stdout, "lists it")
        refused("without a description", {"device": {"kind": "hid"}}, "cannot be driven", "Set Constant Force")
        wrong = copy.deepcopy(CONFIG)
        wrong["device"]["hid"]["report"]["output"]["y"]["bit_offset"] = 32
        refused("a field beyond the report", wrong, "output")
        scenario("driven by its description")
        with rig.daemon(CONFIG, "vendor") as daemon:
            check(joystick.switched == [bytes([0x17, 1, 0xA5])], "switched on", joystick.switched)
            daemon.client.set_forces(True)
            time.sleep(0.3)
            check(joystick.force() == (0.0, 0.0), "no force away from the peg", joystick.force())
            for way in ((1, 0), (-1, 0), (0, 1), (0, -1)):
                begin = time.monotonic()

                def press(t_s: float, way: tuple[int, int] = way, begin: float = begin) -> tuple[float, float]:
                    reach = max(0.007, 0.03 - 0.1 * (t_s - begin))
                    return reach * way[0], reach * way[1]

                joystick.motion = press
                wanted = (0.6 * way[0], 0.6 * way[1])
                time.sleep(0.3)
                near = until(
                    lambda w=wanted: max(abs(a - b) for a, b in zip(joystick.force(), w, strict=True)) < 0.03, 3
                )
                check(bool(near), f"the peg pushes towards {way}", joystick.force())
                joystick.motion = lambda t_s, way=way: (0.03 * way[0], 0.03 * way[1])
                time.sleep(0.1)
            check(not joystick.faults, "nothing that the device refuses", joystick.faults[:3])
            check(daemon.stop() == 0, "ends well")
        check(joystick.force() == (0.0, 0.0), "force zero at the end", joystick.forces[-1:])
        check(not joystick.faults, "nothing that the device refuses", joystick.faults[:3])
    rig.done()


if __name__ == "__main__":
    main()
