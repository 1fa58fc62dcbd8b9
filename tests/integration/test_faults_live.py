"""Faults that need a process of their own, its flight recorder, its reloads, and a client of the first release."""

from __future__ import annotations

import json
import re
import resource
import shutil
import signal
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest

import hapticd
from hapticd.client.blocking import Client
from hapticd.client.samples import SampleStream
from tests.support.daemon_process import Daemon, connect, running_daemon, until, wired

ROOT = Path(__file__).parents[2]
PUSH = {"push": {"kind": "constant", "force_n": [0.0, 0.5]}}
QUIET = "servo: {realtime: 'off', rate_hz: 1000, overruns: {threshold: 1.0}}\n"
DAY_NS = 86_400_000_000_000


def with_config(tmp_path: Path, text: str) -> Path:
    file = tmp_path / "c.yaml"
    file.write_text(QUIET + text)
    return file


# ---- Clocks ----------------------------------------------------------------------------------------------------------


class Clocks:
    """The time of day and the boot time of a process, ahead of the real ones."""

    def __init__(self, file: Path) -> None:
        self.file = file
        file.write_bytes(struct.pack("=2q", 0, 0))

    def ahead(self, *, realtime_ns: int = 0, boottime_ns: int = 0) -> None:
        with open(self.file, "r+b") as file:
            file.write(struct.pack("=2q", realtime_ns, boottime_ns))


@pytest.fixture
def clocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Clocks:
    compiler = shutil.which("cc") or shutil.which("gcc")
    assert compiler is not None, "a C compiler builds the core, so there is one"
    library = tmp_path / "clocks.so"
    command = [
        compiler,
        "-O2",
        "-shared",
        "-fPIC",
        str(ROOT / "tests" / "support" / "clocks.c"),
        "-o",
        str(library),
        "-ldl",
    ]
    subprocess.run(command, check=True)
    made = Clocks(tmp_path / "clocks")
    monkeypatch.setenv("HAPTICD_CLOCKS", str(made.file))
    monkeypatch.setenv("LD_PRELOAD", str(library))
    return made


@pytest.mark.long
def test_a_suspend_is_told_and_the_force_comes_back_over_the_ramp(tmp_path: Path, clocks: Clocks) -> None:
    config = with_config(tmp_path, f"scene: {json.dumps({'objects': PUSH})}\n")
    with running_daemon("-c", str(config)) as daemon, connect(daemon.directory) as client:
        assert client.get_status()["counters"]["suspends"] == 0
        lease = client.lease(1800.0)["token"]  # half of what the suspend takes
        with client.telemetry("samples", "event") as messages:
            parts: list[np.ndarray] = []
            stream = SampleStream(warn=False)
            event: dict[str, Any] = {}
            while len(parts) < 5:
                topic, message = next(messages)
                if topic == "samples":
                    parts.append(np.array(stream.convert(topic, message)))
            clocks.ahead(boottime_ns=3600_000_000_000)
            while not event or int(parts[-1]["tick"][-1]) < event["tick"] + 60:
                topic, message = next(messages)
                if topic == "samples":
                    parts.append(np.array(stream.convert(topic, message)))
                elif message["event"] == "resumed":
                    event = dict(message)
        data = np.concatenate(parts)
        assert event["suspended_s"] == pytest.approx(3600.0, abs=1.0)
        at = int(np.flatnonzero(data["tick"] == event["tick"])[0])
        force = data["force_n"][:, 1]
        assert force[at - 1] == pytest.approx(0.5)
        # A twentieth of the ramp in a period; a machine that is busy may have missed some just then.
        passed_s = 1e-9 * float(data["time_ns"][at] - data["time_ns"][at - 1])
        assert force[at] <= 0.5 * passed_s / 0.02 * 1.001
        assert force[at + 25] == pytest.approx(0.5)
        status = client.get_status()
        assert status["counters"]["suspends"] == 1
        assert (status["forces"], status["faults"]) == ("on", [])
        assert status["lease_s"] > 900
        client.lease(0, lease)
        until(lambda: "the machine was suspended for 1 h" in daemon.said())


@pytest.mark.slow
def test_setting_the_clock_changes_nothing(tmp_path: Path, clocks: Clocks) -> None:
    clocks.ahead(realtime_ns=-30 * 365 * DAY_NS)  # a machine whose battery is empty
    config = with_config(tmp_path, f"scene: {json.dumps({'objects': PUSH})}\n")
    with running_daemon("-c", str(config)) as daemon, connect(daemon.directory) as client:
        lease = client.lease(3600.0)["token"]
        with client.telemetry("event", "status") as messages:
            statuses = []
            while len(statuses) < 3:  # they come every second, by a clock that nobody sets
                clocks.ahead(realtime_ns=DAY_NS * (1 if len(statuses) % 2 else -1))
                topic, message = next(messages)
                if topic == "status":
                    statuses.append(message)
                else:
                    assert message["event"] not in ("fault", "resumed", "device_lost"), message
        assert all(status["forces"] == "on" and status["lease_s"] > 3500 for status in statuses)
        client.lease(0, lease)


@pytest.mark.long
def test_nothing_goes_by_the_time_of_day() -> None:
    """The daemon's own sources; what a library does with it is tested above. clock.py only tells it to recordings
    and to the logs of experiments' sessions."""
    asks = re.compile(
        r"CLOCK_REALTIME|CLOCK_TAI|gettimeofday|time\.time\b|localtime|gmtime|(date|datetime)\.(now|today|utcnow)\b"
    )
    sources = [*ROOT.glob("csrc/*/*.[ch]"), *ROOT.glob("hapticd/[!c]*/**/*.py"), *ROOT.glob("hapticd/config/*.py")]
    assert len(sources) > 60
    assert [source.name for source in sources if asks.search(source.read_text())] == ["clock.py"]
    using = {source.name for source in sources if re.search(r"\bclock\.read\b", source.read_text())}
    assert using == {"flight_recorder.py", "status.py", "session.py", "session_folders.py", "runner.py"}


# ---- Flight recorder -------------------------------------------------------------------------------------------------


def flights(daemon: Daemon) -> list[str]:
    return sorted(path.name for path in daemon.directory.glob("flight-*"))


def written(client: Client, count: int) -> dict[str, Any]:
    """The recorder's status, once it has written so many files."""
    found: dict[str, Any] = {}

    def enough() -> bool:
        found.update(client.get_status()["flight"] or {})
        return bool(found["written"] >= count and found["under_way"] == 0)

    until(enough)
    return found


@pytest.mark.long
def test_a_fault_leaves_a_file_with_the_fault_and_a_second_after_it(tmp_path: Path) -> None:
    # So long that the second fault is soon after the first, however slow we are.
    scene = f"flight: {{keep: 2, seconds: 60}}\nscene: {json.dumps({'objects': PUSH})}\n"
    config = str(with_config(tmp_path, scene))
    with running_daemon("-c", config) as daemon, connect(daemon.directory) as client:
        with client.events() as events:
            client.lease(0.3)
            fault = next(event for event in events if event["event"] == "fault")
        assert fault["faults"] == ["lease"]
        told = written(client, 1)
        assert flights(daemon) == ["flight-000001-fault.npz"]
        assert told["last"] == str(daemon.directory / "flight-000001-fault.npz")
        with np.load(told["last"]) as file:
            samples, events_kept = file["samples"], file["events"]
            about, status, scene_kept = (json.loads(str(file[key])) for key in ("flight", "status", "scene"))
        assert about == {"reason": "fault", "tick": fault["tick"], "complete_from": 0}
        assert scene_kept == client.get_scene()["scene"]
        assert status["version"] == client.get_status()["version"]
        assert np.all(np.diff(samples["tick"].astype(np.int64)) == 1)
        at = int(np.flatnonzero(samples["tick"] == fault["tick"])[0])
        assert samples["time_ns"][-1] - samples["time_ns"][at] > 800_000_000
        assert samples["time_ns"][at] - samples["time_ns"][0] > 100_000_000
        assert samples["force_n"][at - 1, 1] == pytest.approx(0.5)
        assert samples["force_n"][-1, 1] == 0.0
        assert int(events_kept["tick"][events_kept["event"] == "fault"][0]) == fault["tick"]
        # A fault soon after has no file; of more than two files the oldest goes.
        client.set_forces(True)
        client.lease(0.05)
        until(lambda: client.get_status()["faults"] == ["lease"])
        until(lambda: (client.get_status()["flight"] or {})["skipped"] == 1)
        copy = tmp_path / "mine.npz"
        command = [
            sys.executable,
            "-m",
            "hapticd",
            "--runtime-dir",
            str(daemon.directory),
            "record",
            "--past",
            str(copy),
        ]
        told = subprocess.run([*command, "--json"], capture_output=True, text=True, check=True).stdout
        assert (json.loads(told)["file"], json.loads(told)["events"] > 0) == (str(copy), True)
        with np.load(copy) as file:
            assert len(file["samples"]) == json.loads(told)["ticks"] >= len(samples)
            assert json.loads(str(file["flight"])) == {"reason": "asked", "tick": None, "complete_from": 0}
        client.dump_flight()
        written(client, 3)
        assert flights(daemon) == ["flight-000002-asked.npz", "flight-000003-asked.npz"]


@pytest.mark.long
def test_folders_that_are_missing_are_made_and_can_be_entered(tmp_path: Path) -> None:
    inner = tmp_path / "outer" / "inner"
    config = with_config(tmp_path, f"flight: {{directory: {inner}}}\n")
    with running_daemon("-c", str(config)) as daemon, connect(daemon.directory) as client:
        client.dump_flight()
        assert written(client, 1)["last"] == str(inner / "flight-000001-asked.npz")
    assert [path.stat().st_mode & 0o777 for path in (inner.parent, inner)] == [0o770, 0o750]


@pytest.mark.long
def test_a_disk_that_takes_no_more_is_told_and_changes_nothing(tmp_path: Path) -> None:
    """The limit of a file's size stands for a disk that is full."""
    with running_daemon("-c", str(with_config(tmp_path, ""))) as daemon:
        with connect(daemon.directory) as client:
            before = resource.prlimit(daemon.process.pid, resource.RLIMIT_FSIZE)
            resource.prlimit(daemon.process.pid, resource.RLIMIT_FSIZE, (10_000, before[1]))
            file = client.dump_flight()["file"]
            until(lambda: bool((client.get_status()["flight"] or {})["problem"]))
            told = client.get_status()["flight"]
            assert told is not None
            assert str(told["problem"]) == f"{file}: cannot be written: File too large"
            assert (told["written"], told["under_way"], told["last"]) == (0, 0, None)
            assert not [path for path in daemon.directory.iterdir() if "flight" in path.name]
            until(lambda: client.get_status()["forces"] == "on")  # a servo that waits for a processor has said nothing
            past = ["record", "--past", str(tmp_path / "past.npz")]
            command = [sys.executable, "-m", "hapticd", "--runtime-dir", str(daemon.directory), *past]
            refused = subprocess.run(command, capture_output=True, text=True, check=False)
            assert refused.returncode == 1
            assert "File too large" in refused.stderr
            resource.prlimit(daemon.process.pid, resource.RLIMIT_FSIZE, before)
            client.dump_flight()
            assert written(client, 1)["problem"] is None
        until(lambda: "File too large" in daemon.said())


# ---- Reload ----------------------------------------------------------------------------------------------------------

# A stall that is longer than the ramp, while the hand goes through, would leave the membrane whole.
SKIN = "{kind: membrane, center_m: [0, 0], normal: [0, 1], width_m: 0.1, material: cellophane}"


PEG = "{kind: disc, center_m: [0.05, 0], radius_m: 0.005, material: gum}"


def through(client: Client) -> set[str]:
    """Moves the hand from above the membrane to below it; what happened on the way. It stays at both ends, so that
    they are seen."""
    with client.telemetry("state", "event") as messages:

        def arrived(way: list[list[float]], there: Callable[[float], bool]) -> set[str]:
            begin, kinds, seen = client.set_operator(way)["tick"], set(), 0
            for topic, message in messages:
                if topic == "event":
                    kinds.add(message["event"])
                # Of the tick of a state events may come after it, and before the next one.
                elif message["tick"] > begin and there(message["position_m"][1]):
                    seen += 1
                    if seen == 2:
                        return kinds
            raise AssertionError("telemetry ended")

        arrived([[0, 0, 0.01]], lambda y: y > 0.008)
        return arrived([[0, 0, 0.01], [0.3, 0, -0.02]], lambda y: y < -0.015)


@pytest.mark.long
def test_reload_takes_scene_and_materials_and_keeps_what_is_open(tmp_path: Path) -> None:
    config = with_config(tmp_path, f"scene: {{ramp_s: 1, objects: {{skin: {SKIN}}}}}\n")
    with running_daemon("-c", str(config)) as daemon, connect(daemon.directory) as client:
        assert "puncture" in through(client)
        client.update_scene({"guest": {"kind": "viscous", "damping_n_s_per_m": 1}})
        config.write_text(
            QUIET + "materials: {gum: {stiffness_n_per_m: 300}}\n"
            f"scene: {{ramp_s: 1, objects: {{skin: {SKIN}, peg: {PEG}}}}}\n"
        )
        before = client.get_scene()["revision"]
        daemon.process.send_signal(signal.SIGHUP)
        until(lambda: client.get_scene()["revision"] == before + 1)
        assert set(client.get_scene()["scene"]["objects"]) == {"skin", "peg"}  # the files win
        assert client.get_materials()["materials"]["gum"]["stiffness_n_per_m"] == 300
        assert "puncture" not in through(client)  # it is open as it was
        until(lambda: f"reloaded: revision {before + 1}, 2 objects changed" in daemon.said())
        assert client.reload() == {"revision": before + 1, "margins": {}}  # nothing has changed


@pytest.mark.long
@pytest.mark.parametrize(
    ("text", "words"),
    [
        (QUIET.replace("1000", "2000") + "scene: {objects: {}}\n", ["servo.rate_hz", "2000", "restart"]),
        (QUIET + "device: {max_force_n: 3}\nflight: {keep: 3}\n", ["device.max_force_n", "flight.keep", "restart"]),
        (QUIET + "scene: {objects: {a: {kind: wall}}}\n", ["c.yaml:2", "point_m"]),
        (QUIET + "scene: [\n", ["c.yaml:3:1", "did not find expected node content"]),
        (None, ["No such file"]),
    ],
)
def test_reload_is_all_or_nothing(live: tuple[Daemon, Path], text: str | None, words: list[str]) -> None:
    daemon, config = live
    if text is None:
        config.unlink()
    else:
        config.write_text(text)
    with connect(daemon.directory) as client:
        before = client.get_scene()
        command = [sys.executable, "-m", "hapticd", "--runtime-dir", str(daemon.directory), "reload"]
        refused = subprocess.run(command, capture_output=True, text=True, check=False)
        assert refused.returncode == 1
        assert len(refused.stderr.splitlines()) == 1
        for word in (config.name, *words):
            assert word in refused.stderr
        assert client.get_scene() == before
    assert "not reloaded: " in daemon.said()


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Daemon, Path]]:
    config = with_config(tmp_path_factory.mktemp("live"), f"scene: {{objects: {{skin: {SKIN}}}}}\n")
    with running_daemon("-c", str(config)) as daemon:
        yield daemon, config


# ---- Upgrade ---------------------------------------------------------------------------------------------------------

FIRST = json.loads((ROOT / "tests" / "data" / "conversation-1.0.json").read_text())
KINDS = {"map": dict, "list": list, "string": str, "integer": int, "number": (int, float), "nil": type(None)}


def is_a(value: object, kinds: list[str]) -> bool:
    return not isinstance(value, bool) and any(isinstance(value, KINDS[kind]) for kind in kinds)  # type: ignore[arg-type]


@pytest.mark.long
def test_a_client_of_protocol_1_0_works(tmp_path: Path) -> None:
    with running_daemon("-c", str(with_config(tmp_path, ""))) as daemon, wired(daemon) as wire:
        for exchange in FIRST["conversation"]:
            asked = bytes.fromhex(exchange["request"])
            answer = wire.body(asked)
            assert answer["id"] == msgpack.unpackb(asked)["id"]
            assert "result" in answer, (exchange["method"], answer)
            for member, kinds in exchange["reads"].items():
                assert is_a(answer["result"][member], kinds), (exchange["method"], member, answer["result"][member])
            if exchange["method"] == "get_status":
                assert answer["result"]["protocol"] == 1
                assert set(FIRST["counters"]) <= answer["result"]["counters"].keys()
        for exchange in FIRST["errors"]:
            assert wire.body(bytes.fromhex(exchange["request"]))["error"]["code"] == exchange["code"], exchange
        with connect(daemon.directory) as client, client.telemetry("samples", "state", "event") as messages:
            seen: dict[str, Any] = {}
            while not {"samples", "state"} <= seen.keys():
                topic, message = next(messages)
                seen[topic] = message
        assert set(FIRST["state"]) <= seen["state"].keys()
        assert set(FIRST["samples"]) <= seen["state"].keys()
        forms = {
            entry[0]: "".join(entry[1][1:]) + (f"[{entry[2][0]}]" if len(entry) > 2 else "")
            for entry in seen["samples"]["dtype"]
        }
        assert FIRST["samples"].items() <= forms.items()


@pytest.mark.long
def test_events_have_the_members_that_a_client_of_protocol_1_0_reads() -> None:
    from hapticd.base.core import EVENT_DTYPE, EventKind, records
    from hapticd.protocol.events import event_map

    event = records(EVENT_DTYPE, 1)[0]
    for name, members in FIRST["events"].items():
        event["kind"] = EventKind[name.upper()]
        assert set(members) <= event_map(event, "x").keys()


@pytest.mark.long
def test_a_first_configuration_of_ones_own_is_taken_by_a_reload(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The built-in one says where the simulated handle starts; a file that does not is no other device."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    with running_daemon() as daemon, connect(daemon.directory) as client:
        own = tmp_path / "hapticd" / "config.yaml"
        own.parent.mkdir()
        own.write_text("scene: {objects: {honey: {kind: viscous, damping_n_s_per_m: 1}}}\n")
        client.reload()
        assert set(client.get_scene()["scene"]["objects"]) == {"honey"}
        own.write_text("servo: {spin_us: 1}\n")
        with pytest.raises(hapticd.RemoteError, match=r"servo\.spin_us: a change from 0\.0 to 1\.0 needs a restart"):
            client.reload()


@pytest.mark.long
def test_an_object_that_is_not_there_is_guessed_at() -> None:
    with running_daemon() as daemon, connect(daemon.directory) as client:
        client.set_scene({"objects": PUSH})
        with pytest.raises(hapticd.RemoteError, match=r"objects\.pusch: there is no object of this id.*mean push"):
            client.update_scene({"pusch": {"force_n": [0, 1]}})
        with pytest.raises(
            hapticd.RemoteError,
            match=r"objects\.display: .* a key of the scene, which set_scene \(`hapticd apply`\) changes",
        ):
            client.update_scene({"display": {"force": False}})
