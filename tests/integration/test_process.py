"""The daemon's process: start, refusals, signals, stalls, clients that come and go."""

from __future__ import annotations

import os
import pty
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import msgpack
import numpy as np
import pytest
import zmq

from hapticd.base.core import SAMPLE_DTYPE, Fault, Flag, records
from hapticd.config.configuration import load_config
from hapticd.daemon.engine import Engine
from tests.support.daemon_process import PATIENCE_S, Daemon, Wire, connect, running_daemon, until, wired

PUSH = {"push": {"kind": "constant", "force_n": [0.0, 0.5]}}


def run_once(*arguments: str, directory: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "hapticd", "--runtime-dir", str(directory), "run", *arguments],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )


def one_line(result: subprocess.CompletedProcess[str]) -> str:
    assert result.returncode != 0
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 1, result.stderr
    return lines[0]


def largest_slope(data: np.ndarray) -> float:
    """How fast the force changed, N/s; ticks that were missed on a busy machine count as the time that they were."""
    return float(np.max(np.abs(np.diff(data["force_n"][:, 1])) / np.diff(data["time_ns"]) * 1e9))


def from_whole_on(data: np.ndarray) -> np.ndarray:
    """From the first tick with all of the force. Where a busy machine holds up the servo's first ticks for longer than
    the ramp, the field's ramp begins again beside that of the forces, and their product is steeper than either."""
    whole: int = np.flatnonzero(np.isclose(data["force_n"][:, 1], 0.5))[0]
    return data[whole:]


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_signal_fades_the_force_and_exits_with_0(number: int) -> None:
    with running_daemon() as daemon, wired(daemon) as wire:
        wire.result("set_scene", scene={"objects": PUSH}, wait=True)
        batches = []
        with connect(daemon.directory) as client, client.samples() as samples:
            deadline = time.monotonic() + PATIENCE_S
            while not batches or batches[-1]["force_n"][-1, 1] != pytest.approx(0.5):
                assert time.monotonic() < deadline, wire.result("get_status")["faults"]
                batches.append(np.array(next(samples)))
            assert daemon.stop(number) == 0
            # What shows that the force is zero may still be on its way from one thread of ours to another.
            while (batch := samples.receive(0.5 if batches[-1]["force_n"][-1, 1] == 0.0 else 60.0)) is not None:
                batches.append(np.array(batch))
        data = np.concatenate(batches)
        assert data["force_n"][-1, 1] == 0.0
        assert largest_slope(from_whole_on(data)) <= 0.5 / 0.02 * 1.001
        assert not (daemon.directory / "hapticd.command").exists()
        assert not (daemon.directory / "hapticd.telemetry").exists()


@pytest.mark.long
def test_second_daemon_is_refused_with_a_clear_line_and_the_first_goes_on() -> None:
    with running_daemon() as daemon:
        line = one_line(run_once(directory=daemon.directory))
        assert "another daemon" in line
        assert str(daemon.process.pid) in line
        with wired(daemon) as wire:
            assert wire.result("get_status")["state"] == "running"


@pytest.mark.long
def test_stale_socket_files_do_not_stop_the_restart() -> None:
    with running_daemon() as daemon:
        daemon.process.send_signal(signal.SIGKILL)
        daemon.process.wait()
        assert (daemon.directory / "hapticd.command").exists()
        again = Daemon(daemon.directory)
        # The old file is still there, so readiness is an answer.
        with wired(again) as wire:
            assert wire.result("get_status")["state"] == "running"
        assert again.stop() == 0
        daemon.process = again.process


@pytest.mark.long
def test_permissions_of_the_runtime_directory() -> None:
    with running_daemon() as daemon:
        assert os.stat(daemon.directory).st_mode & 0o777 == 0o700
        for name in ("hapticd.command", "hapticd.telemetry"):
            assert os.stat(daemon.directory / name).st_mode & 0o777 == 0o660


@pytest.mark.long
def test_directory_that_is_a_link_or_open_to_others_is_refused(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir(mode=0o700)
    (tmp_path / "link").symlink_to(tmp_path / "real")
    assert "symbolic link" in one_line(run_once(directory=tmp_path / "link"))
    (tmp_path / "open").mkdir()
    os.chmod(tmp_path / "open", 0o777)
    assert "other users may write" in one_line(run_once(directory=tmp_path / "open"))


@pytest.mark.long
def test_bad_configuration_is_one_line(tmp_path: Path) -> None:
    file = tmp_path / "c.yaml"
    file.write_text("servo:\n  rate_hz: 8000\n  rat: 1\n")
    assert "c.yaml:3:3: servo.rat: " in one_line(run_once("-c", str(file), directory=tmp_path / "run"))


@pytest.mark.long
def test_realtime_required_is_refused_without_rights(tmp_path: Path) -> None:
    """As an ordinary user, or as root with the rights taken away."""
    config = tmp_path / "c.yaml"
    config.write_text("servo: {realtime: required}\n")
    dropped = ["setpriv", "--bounding-set=-all", "--inh-caps=-all"] if os.geteuid() == 0 else []
    limits = "import resource as r; r.setrlimit(r.RLIMIT_RTPRIO, (0, 0)); "
    program = (
        f"{limits}import sys; from hapticd.cli import main; "
        f"sys.exit(main(['--runtime-dir', {str(tmp_path / 'run')!r}, 'run', '-c', {str(config)!r}]))"
    )
    result = subprocess.run(
        [*dropped, sys.executable, "-c", program], capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )
    line = one_line(result)
    assert "realtime is required but refused" in line
    assert "SCHED_FIFO" in line


@contextmanager
def without_rights(directory: Path, memlock: int) -> Iterator[tuple[Wire, list[str]]]:
    """A daemon without capabilities and real-time rights, and what it says until it is ready."""
    dropped = ["setpriv", "--bounding-set=-all", "--inh-caps=-all"] if os.geteuid() == 0 else []
    limits = (
        "import resource as r; r.setrlimit(r.RLIMIT_RTPRIO, (0, 0)); "
        f"r.setrlimit(r.RLIMIT_MEMLOCK, ({memlock}, {memlock})); "
    )
    program = (
        f"{limits}import sys; from hapticd.cli import main; "
        f"sys.exit(main(['--runtime-dir', {str(directory)!r}, 'run']))"
    )
    command = [*dropped, sys.executable, "-c", program]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        said = []
        for line in process.stderr:
            said.append(line)
            if "ready" in line:
                break
        try:
            wire = Wire(directory)
            yield wire, said
            wire.close()
            process.send_signal(signal.SIGTERM)
            assert process.wait(PATIENCE_S) == 0
        finally:
            process.kill()  # where the test has failed, nobody else ends it


@pytest.mark.long
def test_default_runs_without_rights_and_says_what_it_did_not_get(tmp_path: Path) -> None:
    with without_rights(tmp_path / "run", 65536) as (wire, lines):
        status = wire.result("get_status")
    said = "".join(lines)
    assert "not granted: SCHED_FIFO priority 80" in said
    assert "not granted: locked memory" in said
    assert status["realtime"]["scheduler"] == "other"
    assert status["realtime"]["memory_locked"] == "none"
    assert {line.split(":")[0].split(" ")[0] for line in status["realtime"]["missing"]} >= {"SCHED_FIFO", "locked"}
    assert status["state"] == "running"


@pytest.mark.long
def test_scene_that_outgrows_the_locked_memory_is_rendered_and_told(tmp_path: Path) -> None:
    with without_rights(tmp_path / "run", 6 * 2**20) as (wire, _):
        status = wire.result("get_status")
        assert status["realtime"]["memory_locked"] == "servo"
        assert not any("all objects" in line for line in status["realtime"]["missing"])
        disc = {"kind": "disc", "radius_m": 1e-3, "material": "wood"}
        discs = {f"d{i}": {**disc, "center_m": [0.01 * (i % 100), 0.1 + 0.01 * (i // 100)]} for i in range(9_990)}
        with connect(tmp_path / "run") as client, client.events() as events:
            for half in (list(discs.items())[::2], list(discs.items())[1::2]):
                wire.result("update_scene", objects=dict(half), wait=True)
            refused = next(event for event in events if event["event"] == "memory_refused")
        assert refused["problem"]
        status = wire.result("get_status")
        assert [line for line in status["realtime"]["missing"] if line.startswith("locked memory for all objects: ")]
        assert status["state"] == "running"
        assert not status["faults"]


@pytest.mark.slow
def test_stopped_process_costs_skipped_ticks_and_no_burst() -> None:
    with running_daemon() as daemon, wired(daemon) as wire:
        wire.result("set_scene", scene={"objects": PUSH}, wait=True)
        before = wire.result("get_status")["counters"]
        with connect(daemon.directory) as client, client.samples() as samples:
            parts = [np.array(next(samples))]  # of before, whatever else comes of it
            # A stall in the daemon's first 20 ms would add the field's ramp to that of the forces, which goes on.
            while not np.isclose(parts[-1]["force_n"][-1, 1], 0.5):
                parts.append(np.array(next(samples)))
            daemon.process.send_signal(signal.SIGSTOP)
            os.waitpid(daemon.process.pid, os.WUNTRACED)
            stopped = threading.Event()
            stopped.wait(1.0)  # the stall itself
            daemon.process.send_signal(signal.SIGCONT)
            parts += [np.array(next(samples)) for _ in range(30)]
        data = np.concatenate(parts)
        gaps = np.diff(data["time_ns"])
        stall = int(np.argmax(gaps))
        assert gaps[stall] >= 900_000_000
        assert data["flags"][stall + 1] & Flag.SKIPPED
        assert np.all(np.diff(data["tick"]) == 1)  # ticks have no gap, time has
        assert gaps.min() >= 99_999  # no burst: at least a period between any two (of 1e5 ns, rounded)
        after = data[stall + 1 : stall + 301]
        assert abs(after["force_n"][0, 1]) <= 0.5 / 200 * 1.001  # it comes in over the ramp again
        assert largest_slope(after) <= 0.5 / 0.02 * 1.001
        status = wire.result("get_status")
        assert status["counters"]["skipped"] - before["skipped"] >= 9000
        assert status["forces"] == "on"
        assert status["faults"] == []


@pytest.mark.slow
def test_a_process_that_was_stopped_is_not_overloaded(tmp_path: Path) -> None:
    config = tmp_path / "c.yaml"
    config.write_text("servo: {rate_hz: 1000, realtime: off, overruns: {threshold: 0.9, action: fault}}\n")
    with running_daemon("-c", str(config)) as daemon, wired(daemon) as wire:
        before = wire.result("get_status")["counters"]
        daemon.process.send_signal(signal.SIGSTOP)
        os.waitpid(daemon.process.pid, os.WUNTRACED)
        threading.Event().wait(2.5)  # the stall itself: more than nine tenths of two seconds
        daemon.process.send_signal(signal.SIGCONT)
        counters = before
        while counters["skipped"] < before["skipped"] + 2000 or counters["ticks"] < before["ticks"] + 2500:
            counters = wire.result("get_status")["counters"]
        assert counters["overloads"] == 0
        assert wire.result("get_status")["faults"] == []


@pytest.mark.long
def test_a_daemon_that_was_started_on_a_terminal_ends_with_it(tmp_path: Path) -> None:
    """And one that was not takes SIGHUP for a reload, as other tests have it."""
    ours, theirs = pty.openpty()
    try:
        words = [sys.executable, "-m", "hapticd", "--runtime-dir", str(tmp_path / "run"), "run"]
        process = subprocess.Popen(words, stdin=theirs, stderr=subprocess.PIPE, text=True)
        assert process.stderr is not None
        lines = []
        for line in process.stderr:
            lines.append(line)
            if "ready: " in line:
                break
        until((tmp_path / "run" / "hapticd.command").exists)
        process.send_signal(signal.SIGHUP)
        lines += process.stderr.readlines()
        assert process.wait(60) == 0, lines
        assert any("SIGHUP: stopping" in line for line in lines) and not any("reloaded" in line for line in lines)
        process.stderr.close()
    finally:
        os.close(ours)
        os.close(theirs)


def test_control_plane_that_hangs_fades_the_force() -> None:
    """An engine whose control thread does not beat; samples say when the force is gone."""
    engine = Engine(load_config({"scene": {"objects": PUSH}, "servo": {"realtime": "off", "rate_hz": 1000}}))
    engine.start()
    try:
        room = records(SAMPLE_DTYPE, 16384)
        data = room[:0]
        pause = threading.Event()
        while len(data) < 5000 and not (len(data) > 500 and data["force_n"][-1, 1] == 0.0):
            count, _ = engine.read_samples(room)
            data = np.concatenate([data, room[:count]])
            pause.wait(0.01)
        faded = int(np.flatnonzero(data["force_n"][:, 1])[-1]) + 1
        assert data["force_n"].max() == pytest.approx(0.5)
        assert 1000 <= faded <= 1100  # a second of ticks, and the ramp of 20
        assert largest_slope(from_whole_on(data)) <= 0.5 / 0.02 * 1.001
        assert engine.counters().faults == Fault.CONTROL
        engine.beat()
        engine.set_forces(True)
        assert engine.counters().faults == Fault(0)
    finally:
        engine.stop()


@pytest.mark.long
def test_client_killed_in_mid_request_and_ten_at_once() -> None:
    with running_daemon() as daemon:
        # Half a ZMTP greeting, and half a message, from sockets that then vanish.
        for part in (b"", b"\xff\x00\x00\x00", b"\xff" + b"\x00" * 8 + b"\x7f\x03\x00NULL" + b"\x00" * 40):
            with socket.socket(socket.AF_UNIX) as raw:
                raw.connect(str(daemon.directory / "hapticd.command"))
                raw.sendall(part)
        program = (
            "import sys, zmq, msgpack, os, signal\n"
            f"s = zmq.Context().socket(zmq.DEALER); s.connect('ipc://{daemon.directory}/hapticd.command')\n"
            "s.send(msgpack.packb({'jsonrpc': '2.0', 'id': 1, 'method': 'get_scene'})); s.poll(10000)\n"
            "for i in range(1000): s.send(msgpack.packb({'jsonrpc': '2.0', 'id': i, 'method': 'get_materials'}))\n"
            "os.kill(os.getpid(), signal.SIGKILL)\n"
        )
        killed = subprocess.run([sys.executable, "-c", program], timeout=PATIENCE_S, check=False)
        assert killed.returncode == -signal.SIGKILL
        errors: list[BaseException] = []

        def client(n: int) -> None:
            try:
                with wired(daemon) as wire:
                    for i in range(50):
                        wire.result(
                            "update_scene", objects={f"o{n}": {"kind": "viscous", "damping_n_s_per_m": i / 100}}
                        )
                        assert f"o{n}" in wire.result("get_scene")["scene"]["objects"]
            except BaseException as error:
                errors.append(error)

        threads = [threading.Thread(target=client, args=(n,)) for n in range(10)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert not errors
        with wired(daemon) as wire:
            objects = wire.result("get_scene")["scene"]["objects"]
            assert {f"o{n}" for n in range(10)} <= set(objects)


@pytest.mark.long
def test_client_that_does_not_read_its_answers_stops_nobody() -> None:
    with running_daemon() as daemon, wired(daemon) as wire:
        context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        deaf = context.socket(zmq.DEALER)
        deaf.setsockopt(zmq.LINGER, 0)
        deaf.setsockopt(zmq.RCVHWM, 1)
        deaf.setsockopt(zmq.SNDTIMEO, 200)
        deaf.connect(f"ipc://{daemon.directory}/hapticd.command")
        body = msgpack.packb({"jsonrpc": "2.0", "id": 1, "method": "get_materials"})
        try:
            for _ in range(5000):
                deaf.send(body)
        except zmq.Again:
            pass
        assert wire.result("get_status")["state"] == "running"
        context.destroy(0)


@pytest.mark.slow
def test_a_daemon_whose_lock_was_removed_keeps_its_directory() -> None:
    with running_daemon() as daemon:
        (daemon.directory / "hapticd.lock").unlink()
        assert "another daemon (process unknown) uses" in one_line(run_once(directory=daemon.directory))
        until(lambda: "hapticd.lock: removed or replaced" in daemon.said())
        with wired(daemon) as wire:
            assert wire.result("get_status")["state"] == "running"


@pytest.mark.long
def test_a_daemon_removes_only_what_is_its_own() -> None:
    with running_daemon() as daemon:
        with wired(daemon) as wire:
            wire.result("get_status")  # a file can be there before its daemon has noted that it is its own
        for name in ("hapticd.command", "hapticd.telemetry"):
            (daemon.directory / name).unlink()
            (daemon.directory / name).write_text("another's")
        assert daemon.stop() == 0
        for name in ("hapticd.command", "hapticd.telemetry"):
            assert (daemon.directory / name).read_text() == "another's"


@pytest.mark.long
def test_the_end_overtakes_reloads_whose_files_never_come(tmp_path: Path) -> None:
    """Each takes ten seconds: one after the other, they would take longer than this waits."""
    config = tmp_path / "c.yaml"
    config.write_text("servo: {realtime: off}\n")
    with running_daemon("-c", str(config)) as daemon:
        config.unlink()
        os.mkfifo(config)

        def is_taken() -> bool:
            pending = re.search(r"ShdPnd:\s*(\w+)", Path(f"/proc/{daemon.process.pid}/status").read_text())
            return pending is not None and int(pending[1], 16) == 0

        for _ in range(40):
            daemon.process.send_signal(signal.SIGHUP)
            until(is_taken)
        writers: list[int] = []

        def is_read() -> bool:
            with suppress(OSError):  # ENXIO: nobody has opened it to read yet
                writers.append(os.open(config, os.O_WRONLY | os.O_NONBLOCK))
            return bool(writers)

        until(is_read)
        try:
            assert daemon.stop() == 0
        finally:
            os.close(writers[0])
