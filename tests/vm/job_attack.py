"""The service under attack by a member of its group, under a systemd of its own: `run.sh -s job_attack.py`.

Each time the service goes on as the same process, NRestarts stays 0, and `set_forces` is answered.
"""

from __future__ import annotations

import contextlib
import functools
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
import numpy as np
import rig
import yaml
import zmq
from job_system import CONFIG, HAPTICD, connected, for_everybody, journal, run, shown, succeeds, systemctl
from rig import check, scenario, until

import hapticd
import hapticd.cli
from hapticd.base.errors import HapticdError
from hapticd.protocol import zmtp
from hapticd.system.open_files import MAX_SOCKET_CONNECTIONS

COMMAND = rig.RUNTIME / "hapticd.command"
TELEMETRY = rig.RUNTIME / "hapticd.telemetry"
BOARD = Path("/run/attack")
"""Where attackers leave what they saw, and find what they wait for."""
ATTACKERS = 5
EACH = 300
"""Connections of an attacker to each of the two sockets; without bounds the daemon's descriptors would not do."""
OF_A_PROCESS = MAX_SOCKET_CONNECTIONS // 4
MODELS = 60
WATCHDOG_S = 1
"""Of the unit meanwhile; the models take longer."""
FLOOD = 5000
SOON_S = 0.5
"""Of this machine's time, whose processor does an instruction in a nanosecond."""
SETUP: dict[str, Any] = {
    "servo": {"rate_hz": 1000, "realtime": "required"},
    "scene": {"objects": {"push": {"kind": "constant", "force_n": [0.7, -0.4]}}},
}


def member(attack: Callable[[], object]) -> rig.Child:
    """A process of another user who is in the group."""

    def do() -> object:
        group, user = grp.getgrnam("hapticd").gr_gid, pwd.getpwnam("nobody")
        resource.setrlimit(resource.RLIMIT_NOFILE, (16384, 16384))
        os.setgroups([group])
        os.setgid(user.pw_gid)
        os.setuid(user.pw_uid)
        return attack()

    return rig.Child(do)


def as_a_member(attack: Callable[[], object]) -> int | None:
    """The same, to its end; its exit code."""
    return member(attack).wait(240)


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


def status() -> Any:
    with connected() as client:
        return client.get_status()


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


class Connection:
    """Of a peer that greets, shakes hands, and then says nothing."""

    def __init__(self, path: Path, kind: bytes) -> None:
        self.sock = socket.socket(socket.AF_UNIX)
        self.sock.setblocking(False)
        self.path, self.hello = path, zmtp.ZMTP_GREETING + zmtp.ready(kind)
        self.came = 0
        self.ended = False

    def connected(self) -> bool:
        try:
            self.sock.connect(os.fspath(self.path))
        except BlockingIOError:  # as many wait for the daemon as may
            return False
        try:
            self.sock.sendall(self.hello)
        except OSError:
            self.ended = True
        return True

    def settled(self) -> bool:
        """Whether the daemon shook hands, or ended it."""
        with contextlib.suppress(BlockingIOError):
            try:
                data = self.sock.recv(4096)
            except ConnectionError:
                data = b""
            self.came += len(data)
            self.ended = self.ended or not data
        return self.ended or self.came > len(zmtp.ZMTP_GREETING)


def connections(number: int) -> None:
    """As many as EACH to both sockets; says how many are open once all are settled, holds them till it is told."""
    held = [Connection(*where) for where in ((COMMAND, b"DEALER"), (TELEMETRY, b"SUB")) for _ in range(EACH)]
    refused = [each for each in held if not until(each.connected, 30)]
    silent = [each for each in held if not until(each.settled, 30)]
    (BOARD / f"{number}.all").write_text(f"{len(refused)} {len(silent)}")
    until((BOARD / "count").exists, 120, 0.05)
    for each in held:
        each.settled()
    open_ones = [sum(not each.ended for each in held if each.path == path) for path in (COMMAND, TELEMETRY)]
    (BOARD / f"{number}.count").write_text(json.dumps(open_ones))
    until((BOARD / "over").exists, 120, 0.05)


def told(ending: str) -> list[Any]:
    """What each attacker says; fewer where one does not."""
    paths = [BOARD / f"{number}.{ending}" for number in range(ATTACKERS)]
    until(lambda: all(path.exists() and path.read_text() for path in paths), 120, 0.05)
    return [path.read_text() for path in paths if path.exists()]


def many_connections() -> None:
    """More than there may be, of one process and of all, held while others are served."""
    BOARD.mkdir(mode=0o777)
    BOARD.chmod(0o777)
    attackers = [member(functools.partial(connections, number)) for number in range(ATTACKERS)]
    check(told("all") == ["0 0"] * ATTACKERS, "each is accepted or ended, none waits", *told("all"))
    (BOARD / "count").touch()
    counts = [json.loads(text) for text in told("count")]
    command, telemetry = ([count[at] for count in counts] for at in (0, 1))
    for name, found in (("command", command), ("telemetry", telemetry)):
        check(
            len(found) == ATTACKERS and max(found) <= OF_A_PROCESS and 0.9 < sum(found) / MAX_SOCKET_CONNECTIONS <= 1.0,
            f"{OF_A_PROCESS} of a process at most and {MAX_SOCKET_CONNECTIONS:,} in all, hardly fewer, {name}",
            found,
        )
    obeys()
    check(as_a_member(obeys_another) == 0, "another process of the attackers' user is served meanwhile")
    (BOARD / "over").touch()
    check([each.wait(120) for each in attackers] == [0] * ATTACKERS, "the attackers ran to their end")
    ended = [line["MESSAGE"] for line in journal() if "was disconnected" in str(line["MESSAGE"])]
    check(bool(ended), "the log names them", *ended[:1])
    check(as_a_member(obeys_another) == 0, "and when they are gone")


def obeys_another() -> None:
    """Commands are answered, and samples come."""
    with connected() as client:
        client.set_forces(False)
        assert next(iter(client.samples())) is not None


def heavy(scale: float = 1.0) -> dict[str, Any]:
    """A material of autoregressive models of order 32, at another rate than the servo's: each takes a filter."""
    models = []
    for number in range(MODELS):
        angles = 0.1 + 0.18 * np.arange(16) + 1e-4 * number
        poles = 0.9 * np.exp(1j * angles)
        models.append(
            {
                "speed_m_per_s": 0.001 * (1 + number % 20),
                "force_n": 0.1 * (1 + number // 20),
                "coefficients": [round(float(each), 6) for each in np.poly([*poles, *poles.conj()]).real[1:] * scale],
                "rms_m_per_s2": 1.0,
            }
        )
    texture = {"kind": "autoregressive", "rate_hz": 200, "models": models}
    return {"stiffness_n_per_m": 100, "texture": texture}


def many_models() -> None:
    """So many models, all valid, and `force off` and `get_status` by turns while they are taken in."""
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    long, short = dealer(context), dealer(context)
    long.send(request("update_materials", 1, materials={"noise": heavy()}))
    begin = time.monotonic()
    waits: list[float] = []
    wrong: list[object] = []
    while not long.poll(0) and time.monotonic() < begin + 200:
        asked = time.monotonic()
        off = len(waits) % 2 == 0
        short.send(request("set_forces", 2, enabled=False) if off else request("get_status", 2))
        answer = msgpack.unpackb(short.recv())
        waits.append(time.monotonic() - asked)
        wrong += [answer["error"]] if "error" in answer else []
        time.sleep(0.01)
    answer = msgpack.unpackb(long.recv())
    took = time.monotonic() - begin
    context.destroy(0)
    waits.sort()
    held = [
        check("error" not in answer, "the models are taken; s", took, str(answer.get("error", ""))[:300]),
        check(took > 2 * WATCHDOG_S, f"which takes longer than twice the watchdog's {WATCHDOG_S} s"),
        check(not wrong and len(waits) > 1, "no answer meanwhile is an error", len(waits), *wrong[:1]),
        check(waits[-1] < SOON_S, "force off and status: p50, largest, s", waits[len(waits) // 2], waits[-1]),
    ]
    sys.exit(0 if all(held) else 1)


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
    CONFIG.write_text(yaml.safe_dump(SETUP))
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


def objects() -> list[str]:
    with connected() as client:
        answer: Any = client.get_scene()
        return sorted(answer["scene"]["objects"])


def written(name: str, scale: float) -> None:
    """A configuration that takes seconds to be read, with one object of that name."""
    wall = {"kind": "wall", "point_m": [0, -1], "normal": [0, 1], "material": "noise"}
    text = json.dumps(SETUP | {"materials": {"noise": heavy(scale)}, "scene": {"objects": {name: wall}}})
    CONFIG.write_text(text)


def reloads() -> int:
    """How many were done so far."""
    return sum(str(line["MESSAGE"]).startswith("reloaded: revision") for line in journal())


def reload_waits() -> None:
    """`hapticd reload` comes back when it is done, and says what came of it."""
    written("far", 0.999)
    begin = time.monotonic()
    said = succeeds("hapticd reload", HAPTICD, "--runtime-dir", str(rig.RUNTIME), "reload")
    took = time.monotonic() - begin
    check("revision" in said, "its result", said.strip())
    check(objects() == ["far"], "it was done by then; s", took)
    CONFIG.write_text("scene: {objects: {far: {kind: constant, force_n: [none, 0]}}}\n")
    done = run(HAPTICD, "--runtime-dir", str(rig.RUNTIME), "reload")
    check(done.returncode == 1 and "force_n" in done.stderr, "a bad one is refused", done.stderr.strip()[:300])
    check(objects() == ["far"], "and nothing has changed")


def reloads_and_stop() -> None:
    scenario("80 SIGHUPs, each for a configuration that takes seconds, then systemctl stop")
    pid = int(shown("hapticd", "MainPID"))
    written("near", 0.998)
    before = reloads()
    for _ in range(40):
        os.kill(pid, signal.SIGHUP)
    for _ in range(40):
        os.kill(pid, signal.SIGHUP)
    begin = time.monotonic()
    succeeds("stop", "systemctl", "stop", "hapticd")
    took = time.monotonic() - begin
    check(took < 10, "before the time-out of 15 s; s", took)
    ended = shown("hapticd", "Result"), shown("hapticd", "ExecMainStatus")
    check(ended == ("success", "0"), "exit code 0", *ended)
    check(reloads() == before, "none of the reloads was waited for")


def started(watchdog: str = "30s") -> None:
    """Restarts the service with this watchdog; "30s" is the unit's own. The host decides how long it takes."""
    file = Path("/etc/systemd/system/hapticd.service.d/attack.conf")
    file.parent.mkdir(exist_ok=True)
    file.write_text(f"[Service]\nTimeoutStartSec=600\nWatchdogSec={watchdog}\n")
    systemctl("daemon-reload")
    succeeds("start", "systemctl", "restart", "hapticd")
    check(shown("hapticd", "WatchdogUSec") == watchdog, "its watchdog", shown("hapticd", "WatchdogUSec"))


def main() -> None:
    sys.setswitchinterval(0.0005)
    scenario("install and start")
    succeeds("install-service", HAPTICD, "install-service")
    CONFIG.write_text(yaml.safe_dump(SETUP))
    for_everybody()
    started(f"{WATCHDOG_S}s")
    obeys()
    with the_same_goes_on(f"{2 * EACH * ATTACKERS:,} connections by {ATTACKERS} processes of a member of the group"):
        many_connections()
    with the_same_goes_on(f"{MODELS} autoregressive models by a member of the group, before a short watchdog"):
        check(as_a_member(many_models) == 0, "taken, and commands at once")
    with the_same_goes_on(f"{FLOOD} bad notifications by a member of the group"):
        before = len(journal())
        begin = time.monotonic()
        check(as_a_member(bad_notifications) == 0, "the attack ran")
        lines = len(journal()) - before
        check(lines <= time.monotonic() - begin + 5, "a line a second in the journal", lines)
    with the_same_goes_on("hapticd reload, of a configuration that takes seconds"):
        reload_waits()
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
    CONFIG.write_text(yaml.safe_dump(SETUP))
    # Longer than doctor takes on a busy host: a watchdog that ends the stopped process would leave nothing to look at.
    started("10min")
    pid = int(shown("hapticd", "MainPID"))
    os.kill(pid, signal.SIGSTOP)
    until(lambda: "T" in Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0], 5)
    found = json.loads(run(HAPTICD, "--runtime-dir", str(rig.RUNTIME), "doctor", "--json").stdout)
    told = [item["what"] for item in found if item["name"] == "daemon"]
    os.kill(pid, signal.SIGCONT)
    check(told == [f"process {pid} holds {rig.RUNTIME} and does not answer: it is stopped"], "says which", *told)
    started()
    with the_same_goes_on("afterwards"):
        pass
    reloads_and_stop()
    scenario("install-service --uninstall")
    succeeds("start", "systemctl", "start", "hapticd")
    said = succeeds("uninstall", HAPTICD, "install-service", "--uninstall")
    check("/etc/systemd/system/hapticd.service" in said, "the unit is named")
    check(not Path("/etc/systemd/system/hapticd.service").exists(), "the unit is away")
    check(shown("hapticd", "ActiveState") == "inactive", "and stopped", systemctl("is-active", "hapticd"))
    rig.done()


if __name__ == "__main__":
    try:
        main()
    finally:
        (rig.OUT / "journal.log").write_text(run("journalctl", "--no-pager", "-o", "short-monotonic").stdout)
