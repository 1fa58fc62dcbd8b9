"""Outlets of Lab Streaming Layer, read by inlets of the same machine."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapticd.cli import main
from hapticd.client.blocking import Client
from hapticd.experiment.daemon_stage import DaemonStage
from hapticd.experiment.lsl import SAMPLE_CHANNELS, streaming
from hapticd.protocol.calls import DaemonNotRunning
from hapticd.system.extras import install_command
from tests.experiment.sessions import ScriptedFront, started
from tests.support.cli import HAPTICD
from tests.support.daemon_process import PATIENCE_S, Daemon, connect, running_daemon

RATE_HZ = 1000
FLOOR = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"}
LABELS = [
    *("tick", "position_x_m", "position_y_m", "velocity_x_m_per_s", "velocity_y_m_per_s"),
    *("contact_force_x_n", "contact_force_y_n", "vibration_force_x_n", "vibration_force_y_n", "force_x_n", "force_y_n"),
    *("revision", "flags"),
]
UNITS = ["count", "m", "m", "m/s", "m/s", "N", "N", "N", "N", "N", "N", "count", "bits"]


@pytest.fixture(scope="module")
def lsl(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """Return pylsl, which finds only streams of this machine and this test."""
    config = tmp_path_factory.mktemp("lsl") / "lsl_api.cfg"
    config.write_text(
        "[multicast]\nResolveScope = machine\n[lab]\nKnownPeers = {127.0.0.1}\n"
        f"SessionID = {uuid.uuid4().hex}\n[log]\nlevel = -2\n"
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("LSLAPICFG", str(config))
        try:
            import pylsl
        except RuntimeError as error:  # PyPI has the library only for some machines
            pytest.skip(f"no liblsl here: {error}")
        yield pylsl


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    config = tmp_path_factory.mktemp("config") / "servo.yaml"
    config.write_text(f"servo: {{rate_hz: {RATE_HZ}, realtime: off, overruns: {{threshold: 1}}}}\n")
    with running_daemon("-c", str(config)) as daemon:
        yield daemon


@pytest.fixture
def client(daemon: Daemon) -> Iterator[Client]:
    with connect(daemon.directory) as client:
        yield client


@contextmanager
def running_lsl(daemon: Daemon) -> Iterator[subprocess.Popen[str]]:
    """Run `hapticd lsl` in a process while the context lasts, and end it by Ctrl-C."""
    process = subprocess.Popen(
        [*HAPTICD, "--runtime-dir", str(daemon.directory), "lsl"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        process.communicate(timeout=PATIENCE_S)


def opened(lsl: Any, name: str, recover: bool = False) -> Any:
    """Return an inlet that receives what is sent from now on. With `recover` it keeps data when the outlet closes."""
    (found,) = lsl.resolve_byprop("name", name, 1, PATIENCE_S)
    inlet = lsl.StreamInlet(found, max_buflen=60, recover=recover)
    inlet.open_stream(PATIENCE_S)
    return inlet


def codes_until(inlet: Any, last: int) -> list[tuple[int, float]]:
    """Return codes with their times up to a code, without contacts and releases, which depend on the hand."""
    found: list[tuple[int, float]] = []
    while not found or found[-1][0] != last:
        sample, at_s = inlet.pull_sample(PATIENCE_S)
        assert sample is not None
        if not 100 < sample[0] < 1000:
            found.append((sample[0], at_s))
    return found


def test_its_clock_is_the_daemons(lsl: Any) -> None:
    """LSL's clock is between two readings of CLOCK_MONOTONIC, the daemon's clock."""
    before = time.clock_gettime_ns(time.CLOCK_MONOTONIC)
    now_s = lsl.local_clock()
    assert before - 1000 <= now_s * 1e9 <= time.clock_gettime_ns(time.CLOCK_MONOTONIC) + 1000


@pytest.mark.slow
def test_every_sample_arrives_once_in_order_with_the_daemons_times_and_numbers(
    lsl: Any, daemon: Daemon, client: Client
) -> None:
    with running_lsl(daemon):
        inlet = opened(lsl, "hapticd samples")
        client.set_scene({"objects": {"floor": FLOOR}}, wait=True)
        with client.samples() as batches:
            client.set_operator([[0.0, 0.0, 0.01], [0.3, 0.01, -0.004], [1.0, 0.02, 0.01]])
            sent = [next(batches)]
            while sum(map(len, sent)) < 2 * RATE_HZ:
                sent.append(next(batches))
        samples = np.concatenate([np.asarray(batch) for batch in sent])
        rows, times = [], []
        while not rows or rows[-1][0] < samples["tick"][-1]:
            chunk, stamps = inlet.pull_chunk(timeout=PATIENCE_S, max_samples=64)
            assert len(stamps)
            rows += [list(row) for row in chunk]
            times += stamps
    got, at_s = np.array(rows), np.array(times)
    # Each sample arrives once and in order, from the first one that arrived.
    assert np.array_equal(np.diff(got[:, 0]), np.ones(len(got) - 1))
    inside = (got[:, 0] >= samples["tick"][0]) & (got[:, 0] <= samples["tick"][-1])
    got, at_s = got[inside], at_s[inside]
    assert np.array_equal(got[:, 0], samples["tick"])
    assert np.max(np.abs(at_s * 1e9 - samples["time_ns"])) <= 1.0
    for column, field in ((1, "position_m"), (3, "velocity_m_per_s"), (5, "contact_force_n")):
        assert np.array_equal(got[:, column : column + 2], samples[field])
    assert np.array_equal(got[:, 7:9], samples["vibration_force_n"])
    assert np.array_equal(got[:, 9:11], samples["force_n"])
    assert np.array_equal(got[:, 11], samples["revision"])
    assert np.array_equal(got[:, 12], samples["flags"])
    # The hand was pushed: these are not all zeros.
    assert got[:, 10].max() > 0.0


@pytest.mark.long
def test_the_streams_say_what_is_in_them(lsl: Any, daemon: Daemon) -> None:
    with running_lsl(daemon):
        samples, events = opened(lsl, "hapticd samples").info(), opened(lsl, "hapticd events").info()
    assert (samples.type(), samples.channel_count(), samples.nominal_srate()) == ("Haptics", len(LABELS), RATE_HZ)
    assert samples.channel_format() == lsl.cf_double64
    assert samples.get_channel_labels() == LABELS == [each.label for each in SAMPLE_CHANNELS]
    assert samples.get_channel_units() == UNITS
    assert samples.desc().child("acquisition").child_value("clock") == "CLOCK_MONOTONIC"
    assert (events.type(), events.channel_count(), events.nominal_srate()) == ("Markers", 1, lsl.IRREGULAR_RATE)
    assert events.channel_format() == lsl.cf_int32
    code = events.desc().child("codes").child("code")
    assert (code.child_value("number"), code.child_value("name")) == ("1", "session_begin")
    assert samples.source_id() != events.source_id()


@pytest.mark.long
def test_codes_of_a_session_come_with_the_numbers_of_their_trials(
    lsl: Any, daemon: Daemon, client: Client, tmp_path: Path
) -> None:
    with running_lsl(daemon), connect(daemon.directory) as other, other.events() as events:
        inlet = opened(lsl, "hapticd events")
        client.mark("answer")  # a mark of another client has no code
        with DaemonStage(client) as stage:
            assert started(tmp_path, stage, ScriptedFront()).run() == "ended"
        found = codes_until(inlet, 3)
        times_ns: list[int] = []
        while len(times_ns) < 6 * 5 + 2:
            event: Any = next(events)
            if event["event"] == "mark" and isinstance(event["data"], dict):
                times_ns.append(event["time_ns"])
    trials = [code for trial in range(6) for code in (10, 1000 + trial, 11, 13, 12, 14)]
    assert [code for code, _ in found] == [1, *trials, 3]
    of_marks = [at_s for code, at_s in found if code < 1000]
    assert np.max(np.abs(np.array(of_marks) * 1e9 - np.array(times_ns))) <= 1.0


@pytest.mark.slow
def test_what_is_touched_has_codes_too(lsl: Any, daemon: Daemon, client: Client) -> None:
    with running_lsl(daemon):
        client.set_scene({"objects": {"floor": FLOOR}}, wait=True)
        client.set_operator([[0.0, 0.0, 0.02], [0.2, 0.0, 0.02]])
        client.wait_gesture(PATIENCE_S)
        inlet = opened(lsl, "hapticd events")
        client.set_forces(True)
        with client.events() as events:
            client.set_operator([[0.0, 0.0, 0.02], [0.3, 0.0, -0.002], [0.6, 0.0, 0.02]])
            contact: Any = next(event for event in events if event["event"] == "contact")
        sample, at_s = inlet.pull_sample(PATIENCE_S)
        assert sample == [101]
        assert abs(at_s * 1e9 - contact["time_ns"]) <= 1.0


@pytest.mark.parametrize("attempt", range(4))
def test_outlets_that_end_have_sent_what_the_daemon_did_before(
    attempt: int, lsl: Any, daemon: Daemon, client: Client
) -> None:
    """The last code of a session is sent just before its process ends."""
    with streaming(client):
        inlet = opened(lsl, "hapticd events", recover=True)
        client.mark("session_end", {"code": 3})
    assert [code for code, _ in codes_until(inlet, 3)] == [3]
    inlet.close_stream()
    assert not any(thread.name == "hapticd-lsl" for thread in threading.enumerate())


@pytest.mark.long
def test_a_session_has_outlets_while_it_runs(lsl: Any, daemon: Daemon, tmp_path: Path) -> None:
    """A person at a terminal aborts when the first trial is ready."""
    arguments = ["experiment", "run", "okamura1998_puncture", "--participant", "P07", "--text", "--lsl"]
    process = subprocess.Popen(
        [*HAPTICD, "--runtime-dir", str(daemon.directory), *arguments, "-o", str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    inlet = opened(lsl, "hapticd events", recover=True)
    # Enter begins the session, and its practice.
    process.communicate("\n\n", timeout=PATIENCE_S)
    assert process.returncode == 1
    assert [code for code, _ in codes_until(inlet, 4)][:2] == [1, 10]
    inlet.close_stream()


@pytest.mark.long
def test_it_ends_with_what_it_sent(lsl: Any, daemon: Daemon) -> None:
    with running_lsl(daemon) as process:
        opened(lsl, "hapticd samples")
        process.send_signal(signal.SIGTERM)
        output, errors = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 0
        assert output.endswith(" samples and 0 events sent\n")
        assert "hapticd: the outlets 'hapticd samples' and 'hapticd events' are open\n" in errors


@pytest.mark.long
def test_a_daemon_that_goes_away_ends_it_in_one_line(lsl: Any, tmp_path: Path) -> None:
    config = tmp_path / "servo.yaml"
    config.write_text(f"servo: {{rate_hz: {RATE_HZ}, realtime: off, overruns: {{threshold: 1}}}}\n")
    with running_daemon("-c", str(config)) as daemon, running_lsl(daemon) as process:
        opened(lsl, "hapticd samples")
        daemon.stop()
        output, errors = process.communicate(timeout=PATIENCE_S)
        assert (process.returncode, output) == (1, "")
        assert errors.splitlines()[-1] == "hapticd: the daemon stopped"


@pytest.mark.long
def test_without_a_daemon_an_error_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--runtime-dir", str(tmp_path), "lsl"]) == 1
    assert capsys.readouterr().err == f"hapticd: no daemon at {tmp_path}; start one with: hapticd run\n"


@pytest.mark.long
@pytest.mark.parametrize(
    ("raised", "right"),
    [("ImportError", install_command("lsl")), ("RuntimeError", "github.com/sccn/liblsl/releases")],
)
def test_without_pylsl_or_its_library_it_names_what_to_install(
    raised: str, right: str, daemon: Daemon, tmp_path: Path
) -> None:
    """One package fails like a missing package, one like pylsl without its library."""
    (tmp_path / "pylsl.py").write_text(f"raise {raised}('first line\\nsecond line')\n")
    run = subprocess.run(
        [sys.executable, "-m", "hapticd", "--runtime-dir", str(daemon.directory), "lsl"],
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert (run.returncode, run.stdout) == (1, "")
    assert run.stderr.count("\n") == 1 and right in run.stderr


@pytest.mark.long
def test_outlets_that_cannot_begin_keep_a_session_from_beginning(tmp_path: Path) -> None:
    config = tmp_path / "servo.yaml"
    config.write_text(f"servo: {{rate_hz: {RATE_HZ}, realtime: off, overruns: {{threshold: 1}}}}\n")
    with running_daemon("-c", str(config)) as daemon, connect(daemon.directory, timeout_s=3.0) as client:
        daemon.stop()
        with pytest.raises(DaemonNotRunning), streaming(client):
            raise AssertionError("there are no outlets")


@pytest.mark.long
def test_a_simulated_session_offline_has_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["okamura1998_tapping", "--participant", "simulated:A", "--offline", "--lsl", "-o", str(tmp_path)]
    assert main(["experiment", "run", *arguments]) == 2
    assert capsys.readouterr().err.startswith("hapticd: --lsl cannot be combined with --offline")
    assert list(tmp_path.iterdir()) == []
