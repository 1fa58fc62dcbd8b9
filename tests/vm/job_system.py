"""hapticd as installed, under a systemd and a udev of its own: `run.sh -s job_system.py`.

The joystick is home-built and holds a force for ever, so that only what is sent to it takes the force away.
"""

from __future__ import annotations

import grp
import json
import math
import os
import pwd
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import rig
import uhid_vendor_joystick as uhid
import yaml
from rig import check, scenario, until

import hapticd
from hapticd.client.blocking import Client

HAPTICD = str(Path(sys.executable).with_name("hapticd"))
CONFIG = Path("/etc/hapticd/config.yaml")
RULES = Path("/etc/udev/rules.d/70-hapticd.rules")
USER = "hapticd-someone"  # the guest has the host's users, too
RECORD = rig.RUNTIME / "hapticd.device"

PUSH: dict[str, Any] = {
    "device": {"kind": "hid", "hid": {"vendor": uhid.VENDOR, "product": uhid.PRODUCT, "report": uhid.DESCRIPTION}},
    "servo": {"rate_hz": 1000, "realtime": "required"},
    "scene": {"objects": {"push": {"kind": "constant", "force_n": [0.7, -0.4]}}},
}


def run(*words: str) -> subprocess.CompletedProcess[str]:
    """A command, to its end."""
    return subprocess.run(words, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False, timeout=300)


def systemctl(*words: str) -> str:
    """What it says, on whichever of its two ways."""
    done = run("systemctl", *words)
    return (done.stdout + done.stderr).strip()


def succeeds(what: str, *words: str) -> str:
    done = run(*words)
    check(done.returncode == 0, what, done.returncode, (done.stdout + done.stderr).strip()[-600:])
    return done.stdout


def shown(unit: str, name: str) -> str:
    return systemctl("show", "-P", name, unit)


def journal(*words: str, unit: str = "hapticd") -> list[dict[str, Any]]:
    """Lines of a unit, the oldest first."""
    run("journalctl", "--sync")
    said = run("journalctl", "-u", unit, "-o", "json", "--no-pager", *words).stdout
    return [json.loads(line) for line in said.splitlines()]


def told(text: str, unit: str = "hapticd") -> bool:
    return any(text in str(line["MESSAGE"]) for line in journal(unit=unit))


def node_of(path: Path) -> tuple[str, str]:
    """Group and mode."""
    node = path.stat()
    return grp.getgrgid(node.st_gid).gr_name, oct(stat.S_IMODE(node.st_mode))


def connected() -> Client:
    return hapticd.connect(rig.RUNTIME, timeout_s=60)


def pushing(joystick: uhid.VendorJoystick) -> None:
    """Forces on, and the device shows one."""
    with connected() as client:
        client.set_forces(True)
    check(bool(until(lambda: joystick.force() != (0.0, 0.0), 5)), "it pushes", joystick.force())


def active_again(pid: str) -> bool:
    """The service is active with another process."""
    return bool(
        until(
            lambda: shown("hapticd", "MainPID") not in (pid, "0") and shown("hapticd", "ActiveState") == "active",
            120,
            0.5,
        )
    )


def installed() -> None:
    scenario("hapticd install-service")
    said = succeeds("install-service", HAPTICD, "install-service")
    print("    " + said.replace("\n", "\n    ").rstrip())
    for user in ("hapticd", "hapticd-web"):
        check(pwd.getpwnam(user).pw_shell.endswith("nologin"), f"sysusers made {user}", pwd.getpwnam(user))
    check(
        bool(until(lambda: node_of(Path("/dev/cpu_dma_latency")) == ("hapticd", "0o660"), 5)),
        "udev gave /dev/cpu_dma_latency to the group",
        node_of(Path("/dev/cpu_dma_latency")),
    )
    line = f'KERNELS=="*:{uhid.VENDOR:04X}:{uhid.PRODUCT:04X}.*", ENV{{HAPTICD_DEVICE}}="1"\n'
    text = RULES.read_text()
    at = text.index('KERNELS=="')
    RULES.write_text(text[:at] + line + text[at:])
    succeeds("the rule takes the joystick's line", "udevadm", "control", "--reload")
    CONFIG.write_text(yaml.safe_dump(PUSH))


def plugged() -> None:
    scenario("the joystick's node")
    found = until(lambda: sorted(Path("/dev").glob("hidraw*")), 5)
    check(bool(found), "a node")
    node = found[0]
    check(bool(until(lambda: node_of(node) == ("input", "0o660"), 10)), "for the group input", node_of(node))
    told = run("udevadm", "info", "--query=property", f"--name={node}").stdout
    tags = next((line for line in told.splitlines() if line.startswith("CURRENT_TAGS=")), "")
    check(":uaccess:" in tags, "with the tag uaccess", tags)


def started(joystick: uhid.VendorJoystick) -> None:
    scenario("systemctl start")
    succeeds("start", "systemctl", "start", "hapticd")
    check(shown("hapticd", "ActiveState") == "active", "active", shown("hapticd", "StatusText"))
    pid = shown("hapticd", "MainPID")
    threads = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        number, name = int(task.name), (task / "comm").read_text().strip()
        threads.append((name, os.sched_getscheduler(number), os.sched_getparam(number).sched_priority))
    fifo = [thread for thread in threads if thread[1] == os.SCHED_FIFO]
    check(len(fifo) == 3 and len(threads) > 3, "SCHED_FIFO for the servo and the device alone", threads)
    first = os.getpriority(os.PRIO_PROCESS, int(pid))
    check(first == -10, "the thread that serves commands comes before everybody else's", first)
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    rights = [
        line.replace("\t", " ") for line in lines if line.startswith(("CapEff", "CapBnd", "NoNewPrivs", "Seccomp:"))
    ]
    check("CapBnd: 0000000000000000" in rights and "NoNewPrivs: 1" in rights, "no capabilities", rights)
    with connected() as client:
        status: Any = client.get_status()
    realtime = status["realtime"]
    check(not realtime["missing"] and realtime["idle_states_held"], "everything granted", realtime)
    check(status["forces"] == "off", "forces are off at first", status["forces"])
    record = json.loads(RECORD.read_text())
    check(record["path"].startswith("/dev/hidraw"), "a record that stops the device", record["path"])
    pushing(joystick)
    doctor = run(HAPTICD, "--runtime-dir", str(rig.RUNTIME), "doctor", "-c", str(CONFIG))
    print("    " + (doctor.stdout + doctor.stderr).replace("\n", "\n    ").rstrip())
    check(doctor.returncode == 0, "hapticd doctor finds nothing that fails")
    check("joystick     hapticd vendor joystick at /dev/hidraw0 may be driven" in doctor.stdout, "and the joystick")


def stopped(joystick: uhid.VendorJoystick) -> None:
    scenario("systemctl stop")
    succeeds("stop", "systemctl", "stop", "hapticd")
    check(joystick.force() == (0.0, 0.0), "zero", joystick.forces[-1])
    ended = shown("hapticd", "Result"), shown("hapticd", "ExecMainStatus"), shown("hapticd", "ActiveState")
    check(ended == ("success", "0", "inactive"), "exit code 0", *ended)
    check(not RECORD.exists() and not rig.RUNTIME.exists(), "its runtime directory is gone")


def killed(joystick: uhid.VendorJoystick, number: signal.Signals) -> None:
    scenario(f"{number.name} under force")
    pid = shown("hapticd", "MainPID")
    pushing(joystick)
    before = len([line for line in journal() if "force zero, effects stopped" in str(line["MESSAGE"])])
    begin = time.monotonic()
    os.kill(int(pid), number)
    zero = until(lambda: joystick.force() == (0.0, 0.0), 90)
    took = time.monotonic() - begin
    check(bool(zero), "zero; s", took)
    if number == signal.SIGSTOP:
        # The watchdog's 30 s, from when it was fed last, and the start of `hapticd stop-device`.
        check(20 < took < 60, "by the watchdog", took)
        check(told("Watchdog timeout"), "systemd says so")
    check(active_again(pid), "started again; s", time.monotonic() - begin)
    stops = [line for line in journal() if "force zero, effects stopped" in str(line["MESSAGE"])]
    check(len(stops) == before + 1, "ExecStopPost did it", [line["MESSAGE"] for line in stops[-1:]])
    with connected() as client:
        check(client.get_status()["forces"] == "off", "with forces off")


def reloaded() -> None:
    scenario("reload")
    pid = shown("hapticd", "MainPID")

    def scene() -> tuple[int, list[str]]:
        with connected() as client:
            answer: Any = client.get_scene()
            return answer["revision"], sorted(answer["scene"]["objects"])

    before = scene()
    changed = {**PUSH, "scene": {"objects": {"pull": {"kind": "constant", "force_n": [0.1, 0.0]}}}}
    CONFIG.write_text(yaml.safe_dump(changed))
    succeeds("systemctl reload, a good file", "systemctl", "reload", "hapticd")
    after = scene()
    check(after[0] > before[0] and after[1] == ["pull"], "the new scene", *after)
    CONFIG.write_text("scene: {objects: {pull: {kind: constant, force_n: [none, 0]}}}\n")
    done = run("systemctl", "reload", "hapticd")
    check(done.returncode != 0, "systemctl reload, a bad file: fails", done.stderr.strip())
    check(scene() == after, "nothing has changed", scene())
    check(shown("hapticd", "ActiveState") == "active", "active all the same")
    said = [line["MESSAGE"] for line in journal() if "force_n" in str(line["MESSAGE"])]
    check(bool(said), "the log says why", said[-1:])
    CONFIG.write_text(yaml.safe_dump(PUSH))
    os.kill(int(pid), signal.SIGHUP)
    check(bool(until(lambda: scene()[1] == ["push"], 20, 0.2)), "SIGHUP, a good file", scene())
    check(shown("hapticd", "MainPID") == pid, "still the same process")


def unplugged() -> None:
    scenario("the joystick has been unplugged, and comes back")
    with connected() as client:
        gone: Any = until(lambda: (s := client.get_status())["faults"] == ["device"] and s, 5, 0.05)
        check(bool(gone) and gone["connection"]["state"] == "lost", "fault device", client.get_status()["faults"])
    check(shown("hapticd", "ActiveState") == "active", "the service stays", shown("hapticd", "StatusText"))
    lost = journal("-g", "the device does not report", "-p", "warning")
    check(bool(lost) and lost[-1]["PRIORITY"] == "4", "journalctl -p warning shows it", lost[-1:])
    with uhid.VendorJoystick(0.005, math.inf) as joystick, connected() as client:
        back = until(lambda: client.get_status()["connection"]["state"] == "connected", 20, 0.1)
        check(bool(back), "found again", client.get_status()["connection"])
        pushing(joystick)
        check(client.get_status()["faults"] == [], "and no fault is left")
        stopped(joystick)


def for_everybody() -> None:
    """Any user may run hapticd, wherever this installation and its interpreter are."""
    for path in (HAPTICD, os.path.realpath(sys.executable), hapticd.__file__):
        for folder in Path(path).parents:
            folder.chmod(folder.stat().st_mode | 0o055)


def of_a_user() -> None:
    scenario("systemctl --user")
    succeeds("a user", "useradd", "--create-home", "--shell", "/bin/sh", USER)
    user = pwd.getpwnam(USER)
    runtime = Path(f"/run/user/{user.pw_uid}")
    runtime.mkdir(parents=True)
    os.chown(runtime, user.pw_uid, user.pw_gid)
    runtime.chmod(0o700)
    environment = f"XDG_RUNTIME_DIR={runtime}", f"HOME={user.pw_dir}"

    def theirs(*words: str) -> subprocess.CompletedProcess[str]:
        return run("setpriv", f"--reuid={USER}", f"--regid={USER}", "--init-groups", "env", *environment, *words)

    for_everybody()
    # As user@.service, without a login.
    Path("/run/systemd/system/someone.service").write_text(
        f"[Service]\nType=notify\nUser={USER}\nDelegate=yes\nEnvironment={' '.join(environment)}\n"
        "WorkingDirectory=~\nExecStart=/lib/systemd/systemd --user\n"
    )
    systemctl("daemon-reload")
    succeeds("systemd --user", "systemctl", "start", "someone")
    done = theirs(HAPTICD, "install-service", "--user")
    check(done.returncode == 0, "install-service --user", done.returncode, done.stdout + done.stderr)
    done = theirs("systemctl", "--user", "start", "hapticd")
    check(done.returncode == 0, "start", done.stderr)
    answer = theirs(HAPTICD, "--runtime-dir", str(runtime / "hapticd"), "status", "--json")
    check(answer.returncode == 0 and json.loads(answer.stdout)["device"] == "sim", "it answers", answer.stderr)
    for word in ("reload", "stop"):
        done = theirs("systemctl", "--user", word, "hapticd")
        check(done.returncode == 0, word, done.stderr)
    ended = theirs("systemctl", "--user", "show", "-P", "Result", "hapticd").stdout.strip()
    check(ended == "success", "ends well", ended)


def main() -> None:
    sys.setswitchinterval(0.0005)
    installed()
    with uhid.VendorJoystick(0.005, math.inf) as joystick:
        plugged()
        started(joystick)
        stopped(joystick)
        succeeds("start again", "systemctl", "start", "hapticd")
        killed(joystick, signal.SIGKILL)
        killed(joystick, signal.SIGSTOP)
        reloaded()
        pushing(joystick)
        check(not joystick.faults, "nothing that the device refuses", joystick.faults[:3])
    unplugged()
    of_a_user()
    for unit in ("hapticd", "hapticd-web"):
        print("    " + run("systemd-analyze", "security", "--no-pager", f"{unit}.service").stdout.splitlines()[-1])
    rig.done()


if __name__ == "__main__":
    try:
        main()
    finally:
        (rig.OUT / "journal.log").write_text(run("journalctl", "--no-pager", "-o", "short-monotonic").stdout)
