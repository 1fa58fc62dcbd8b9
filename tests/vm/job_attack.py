"""The service under attack by a member of its group, under a systemd of its own: `run.sh -s job_attack.py`.

Each time the service goes on as the same process, NRestarts stays 0, and `set_forces` is answered.
"""

from __future__ import annotations

import contextlib
import grp
import json
import os
import pwd
import resource
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgpack
import rig
import yaml
import zmq
from job_system import CONFIG, HAPTICD, connected, for_everybody, journal, run, shown, succeeds, systemctl
from rig import check, scenario, until

import hapticd
import hapticd.cli
from hapticd.errors import HapticdError

COMMAND = rig.RUNTIME / "hapticd.command"
TELEMETRY = rig.RUNTIME / "hapticd.telemetry"
MANY = 1100
"""Connections; the daemon's soft limit of descriptors is 1024 where nothing raises it."""
MODELS = 400
FLOOD = 5000
SOON_S = 0.5
"""Of this machine's time, whose processor does an instruction in a nanosecond."""
SETUP: dict[str, Any] = {
    "servo": {"rate_hz": 1000, "realtime": "required"},
    "scene": {"objects": {"push": {"kind": "constant", "force_n": [0.7, -0.4]}}},
}


def as_a_member(attack: Callable[[], object]) -> int | None:
    """A process of another user who is in the group; its exit code."""

    def do() -> object:
        group, user = grp.getgrnam("hapticd").gr_gid, pwd.getpwnam("nobody")
        resource.setrlimit(resource.RLIMIT_NOFILE, (16384, 16384))
        os.setgroups([group])
        os.setgid(user.pw_gid)
        os.setuid(user.pw_uid)
        return attack()

    return rig.Child(do).wait(240)


@contextlib.contextmanager
def the_same_goes_on(what: str) -> Iterator[None]:
    """The service is the same process before and after, is not restarted, and obeys."""
    scenario(what)
    until(lambda: shown("hapticd", "ActiveState") == "active", 60, 0.5)
    pid, restarts = shown("hapticd", "MainPID"), shown("hapticd", "NRestarts")
    begin = time.monotonic()
    yield
    took = time.monotonic() - begin
    check(shown("hapticd", "MainPID") == pid, "the same process; s", took)
    check(shown("hapticd", "NRestarts") == restarts, "no restart", shown("hapticd", "NRestarts"))
    until(lambda: shown("hapticd", "ActiveState") == "active", 60, 0.5)
    obeys()


def obeys() -> None:
    """Forces on and off, each answered."""
    try:
        with connected() as client:
            begin = time.monotonic()
            on, off = client.set_forces(True)["forces"], client.set_forces(False)["forces"]
            check((on, off) == ("on", "off"), "forces on and off; s", time.monotonic() - begin)
            check(client.get_status()["faults"] == [], "no fault", client.get_status()["faults"])
    except HapticdError as error:
        check(False, "it answers", error)


def request(method: str, id: int | None, **params: object) -> bytes:
    message = {"jsonrpc": "2.0", "method": method, "params": params}
    return msgpack.packb(message if id is None else message | {"id": id})


def dealer(context: zmq.Context[zmq.Socket[bytes]]) -> zmq.Socket[bytes]:
    made = context.socket(zmq.DEALER)
    made.setsockopt(zmq.LINGER, 0)
    made.setsockopt(zmq.SNDHWM, 0)
    made.setsockopt(zmq.RCVTIMEO, 200_000)
    made.connect(f"ipc://{COMMAND}")
    return made


# ---- Attacks ---------------------------------------------------------------------------------------------------------


def connections() -> None:
    """Both sockets, more connections than there are descriptors, until no more are accepted."""
    held: list[socket.socket] = []

    def another() -> bool:
        each = socket.socket(socket.AF_UNIX)
        each.setblocking(False)
        try:
            each.connect(os.fspath(TELEMETRY if len(held) % 4 == 0 else COMMAND))
        except OSError:
            each.close()
            return False
        held.append(each)
        return True

    while len(held) < MANY and until(another, 3, 0.01):
        pass
    print(f"    {len(held)} connections")
    time.sleep(1)  # what waits is accepted, as much as it will
    sys.exit(0 if len(held) > MANY // 2 else 1)


def many_models() -> None:
    """400 autoregressive models of order 32, all valid, and `force off` while they are taken in."""
    models = [
        {
            "speed_m_per_s": 0.001 * (1 + number % 20),
            "force_n": 0.1 * (1 + number // 20),
            "coefficients": [-0.9 + 1e-4 * number, *[0.0] * 30, 1e-3],
            "rms_m_per_s2": 1.0,
        }
        for number in range(MODELS)
    ]
    texture = {"kind": "autoregressive", "rate_hz": 1000, "models": models}
    material = {"stiffness_n_per_m": 100, "texture": texture}
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    long, short = dealer(context), dealer(context)
    long.send(request("update_materials", 1, materials={"noise": material}))
    begin = time.monotonic()
    short.send(request("set_forces", 2, enabled=False))
    answer = msgpack.unpackb(short.recv())
    off_s = time.monotonic() - begin
    print(f"    force off answered after {off_s:.3g} s: {answer.get('error', 'taken')}")
    answer = msgpack.unpackb(long.recv())
    took = time.monotonic() - begin
    print(f"    the models after {took:.3g} s: {str(answer.get('error', 'taken'))[:300]}")
    context.destroy(0)
    if "error" in answer or off_s > SOON_S:
        sys.exit(1)


def bad_notifications() -> None:
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    made = dealer(context)
    for number in range(FLOOD):
        made.send(request("set_forces", None, enabled=number))
    made.send(request("get_status", 1))
    made.recv()
    context.destroy(0)


def identities(folder: Path = rig.RUNTIME) -> list[tuple[int, int]]:
    """Of the sockets; empty where one is missing."""
    paths = [folder / "hapticd.command", folder / "hapticd.telemetry"]
    return [(path.stat().st_ino, path.stat().st_dev) for path in paths] if all(map(Path.is_socket, paths)) else []


def cleaned(folder: Path, *rules: str) -> None:
    """systemd-tmpfiles over the folder of a living daemon, all of whose files are a year old."""
    before = identities(folder)
    old = time.time() - 365 * 86400
    for path in (*folder.iterdir(), folder):
        os.utime(path, (old, old))
    file = Path("/run/attack.conf")
    for rule in rules:
        file.write_text(rule + "\n")
        for what in ("--clean", "--create"):
            succeeds(f"systemd-tmpfiles {what}, {rule}", "systemd-tmpfiles", what, str(file))
        check(bool(before) and identities(folder) == before, "its sockets are still there")


def in_tmp() -> None:
    """A daemon in a folder that is cleaned as /tmp is, and a second one on its name."""
    scenario("systemd-tmpfiles in a folder such as /tmp")
    shared, folder = Path("/attacked"), Path("/attacked/hapticd-0")
    shared.mkdir()
    shared.chmod(0o1777)
    (shared / "old").touch()
    os.utime(shared / "old", (1, 1))
    words = ["--runtime-dir", str(folder), "run", "-c", str(CONFIG)]
    daemon = rig.Child(lambda: hapticd.cli.main(words), ["hapticd", *words])
    check(bool(until(lambda: identities(folder), 60, 0.1)), "a daemon")
    cleaned(folder, f"d {shared} 1777 root root 1s")
    check(not (shared / "old").exists(), "what else was old is gone")
    before = identities(folder)
    done = run(HAPTICD, *words)
    check(done.returncode == 1 and "another daemon" in done.stderr, "a second one is refused", done.stderr.strip())
    check(identities(folder) == before, "the first keeps its sockets")
    daemon.kill(signal.SIGTERM)
    check(daemon.wait(30) == 0 and identities(folder) == [], "and ends well")


def reloads_and_stop() -> None:
    scenario("40 SIGHUPs, then systemctl stop")
    pid = int(shown("hapticd", "MainPID"))
    for _ in range(40):
        os.kill(pid, signal.SIGHUP)
    begin = time.monotonic()
    succeeds("stop", "systemctl", "stop", "hapticd")
    took = time.monotonic() - begin
    check(took < 10, "before the time-out of 15 s; s", took)
    ended = shown("hapticd", "Result"), shown("hapticd", "ExecMainStatus")
    check(ended == ("success", "0"), "exit code 0", *ended)


def main() -> None:
    sys.setswitchinterval(0.0005)
    scenario("install and start")
    succeeds("install-service", HAPTICD, "install-service")
    CONFIG.write_text(yaml.safe_dump(SETUP))
    for_everybody()
    succeeds("start", "systemctl", "start", "hapticd")
    obeys()
    with the_same_goes_on(f"{MANY} connections by a member of the group"):
        check(as_a_member(connections) == 0, "the attack ran")
    with the_same_goes_on(f"{MODELS} autoregressive models by a member of the group"):
        check(as_a_member(many_models) == 0, "taken, and force off at once")
    with the_same_goes_on(f"{FLOOD} bad notifications by a member of the group"):
        before = len(journal())
        begin = time.monotonic()
        check(as_a_member(bad_notifications) == 0, "the attack ran")
        lines = len(journal()) - before
        check(lines <= time.monotonic() - begin + 5, "a line a second in the journal", lines)
    with the_same_goes_on("systemd-tmpfiles"):
        cleaned(rig.RUNTIME, f"d {rig.RUNTIME} 0750 hapticd hapticd 1s", f"e {rig.RUNTIME} - - - 1s")
    in_tmp()
    with the_same_goes_on("a second daemon on the same name"):
        before = identities()
        as_it = ("setpriv", "--reuid=hapticd", "--regid=hapticd", "--clear-groups")
        done = run(*as_it, HAPTICD, "--runtime-dir", str(rig.RUNTIME), "run")
        check(done.returncode == 1 and "another daemon" in done.stderr, "is refused", done.stderr.strip())
        check(identities() == before, "the first keeps its sockets")
    scenario("hapticd doctor, of a stopped daemon")
    pid = int(shown("hapticd", "MainPID"))
    os.kill(pid, signal.SIGSTOP)
    until(lambda: "T" in Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0], 5)
    found = json.loads(run(HAPTICD, "--runtime-dir", str(rig.RUNTIME), "doctor", "--json").stdout)
    told = [item["what"] for item in found if item["name"] == "daemon"]
    os.kill(pid, signal.SIGCONT)
    check(told == [f"process {pid} holds {rig.RUNTIME} and does not answer: it is stopped"], "says which", *told)
    with the_same_goes_on("afterwards"):
        pass
    reloads_and_stop()
    scenario("install-service --uninstall")
    succeeds("start", "systemctl", "start", "hapticd")
    said = succeeds("uninstall", HAPTICD, "install-service", "--uninstall")
    check("removed /etc/systemd/system/hapticd.service" in said, "the unit is away")
    check(shown("hapticd", "ActiveState") == "inactive", "and stopped", systemctl("is-active", "hapticd"))
    rig.done()


if __name__ == "__main__":
    try:
        main()
    finally:
        (rig.OUT / "journal.log").write_text(run("journalctl", "--no-pager", "-o", "short-monotonic").stdout)
