"""The flight recorder alone: which data it keeps, and which faults get a file. test_faults_live.py tests the files."""

from __future__ import annotations

import json
import threading
import time
import weakref
from pathlib import Path

import numpy as np
import pytest

from hapticd.base.core import SAMPLE_DTYPE, records
from hapticd.config.scene import Scene
from hapticd.daemon.flight_recorder import FAULT_AFTERMATH_S, MAX_KEPT_EVENTS, Flight, directory_of
from hapticd.daemon.flight_scene import FlightScene
from tests.support.special_files import KINDS, special, untouched

RATE_HZ = 1000


class Life:
    """A recorder, a clock, and telemetry in batches of 20 ticks."""

    def __init__(self, directory: Path, seconds: float = 2.0, keep: int = 10) -> None:
        self.tick = 0
        self.scene = FlightScene(Scene(), {}, 0, RATE_HZ)
        self.flight = Flight(directory, seconds, keep, RATE_HZ, lambda: self.tick * 1_000_000, self.scene)

    def go_on(self, ticks: int) -> None:
        for _ in range(ticks // 20):
            batch = records(SAMPLE_DTYPE, 20)
            batch["tick"] = np.arange(self.tick, self.tick + 20)
            self.flight.keep_samples(batch)
            self.tick += 20
            self.flight.hand_over_due(self.tick * 1_000_000)

    def fault(self, *faults: str) -> None:
        self.flight.keep_event({"event": "fault", "tick": self.tick, "time_ns": 0, "faults": list(faults)})

    def end(self) -> None:
        """Write the files that are due."""
        self.flight.finish()
        self.flight.wake()
        self.flight.run(threading.Event())


def ticks_of(path: Path) -> tuple[int, int, dict[str, object]]:
    with np.load(path) as file:
        ticks = file["samples"]["tick"].astype(int)
        assert np.all(np.diff(ticks) == 1)
        assert file["events"]["tick"].min() >= ticks[0]
        return int(ticks[0]), int(ticks[-1]), json.loads(str(file["flight"]))


def test_a_file_goes_from_before_the_fault_to_a_second_after_it(tmp_path: Path) -> None:
    life = Life(tmp_path)
    life.fault()  # cleared faults need no file
    life.go_on(5000)
    life.fault("lease")
    life.go_on(500)
    life.fault("lease", "device")  # in the same file
    life.go_on(3000)
    life.end()
    (path,) = tmp_path.iterdir()
    first, last, about = ticks_of(path)
    assert about == {"reason": "fault", "tick": 5000, "complete_from": 0}
    assert last == 5000 + FAULT_AFTERMATH_S * RATE_HZ - 1
    assert 5000 - 2000 - 20 < first <= 5000 - 2000
    assert life.flight.status()["skipped"] == 1


def test_faults_of_later_have_files_of_their_own_and_the_oldest_go(tmp_path: Path) -> None:
    life = Life(tmp_path, keep=2)
    for _ in range(3):
        life.fault("lease")
        life.go_on(4000)
    life.end()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["flight-000002-fault.npz", "flight-000003-fault.npz"]
    # Another daemon on the same directory continues the numbers.
    later = Life(tmp_path)
    later.go_on(100)
    later.fault("lease")
    assert later.flight.dump() == tmp_path / "flight-000005-asked.npz"
    later.end()
    assert len(list(tmp_path.iterdir())) == 4


def test_what_is_kept_is_bounded(tmp_path: Path) -> None:
    life = Life(tmp_path)
    for _ in range(50):
        life.go_on(200)
        for _ in range(50):
            life.flight.keep_event({"event": "release", "tick": life.tick, "time_ns": 0, "object": None})
    assert {int(str(event["tick"])) for event in life.flight._events} == set(range(7000, 10_001, 200))
    for _ in range(2 * MAX_KEPT_EVENTS):
        life.flight.keep_event({"event": "release", "tick": life.tick, "time_ns": 0, "object": None})
    assert len(life.flight._events) == MAX_KEPT_EVENTS
    life.flight.dump()
    life.end()
    (path,) = tmp_path.iterdir()
    with np.load(path) as file:
        ticks = file["samples"]["tick"].astype(int)
    assert np.array_equal(ticks, np.arange(7000, 10_000))


@pytest.mark.parametrize("size", [7, 2999, 3000, 3001, 10_000])
def test_batches_of_any_size_go_round(tmp_path: Path, size: int) -> None:
    life = Life(tmp_path)
    samples = records(SAMPLE_DTYPE, 20_000)
    samples["tick"] = np.arange(len(samples))
    for first in range(0, len(samples), size):
        life.flight.keep_samples(samples[first : first + size])
    life.flight.dump()
    life.end()
    (path,) = tmp_path.iterdir()
    with np.load(path) as file:
        assert np.array_equal(file["samples"], samples[-3000:])


def test_a_directory_is_made_and_one_that_cannot_be_is_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    life = Life(tmp_path / "new" / "place")
    life.go_on(100)
    path = life.flight.dump()
    life.fault("lease")
    life.end()
    assert path.exists() and path.parent.stat().st_mode & 0o777 == 0o750
    (tmp_path / "file").write_text("")
    life = Life(tmp_path / "file" / "place")
    life.go_on(100)
    life.flight.dump()
    life.end()
    status = life.flight.status()
    assert (status["written"], status["under_way"]) == (0, 0)
    assert "Not a directory" in str(status["problem"])
    assert str(status["problem"]) in caplog.text


def test_whoever_asks_without_end_has_two_copies_kept_at_most(tmp_path: Path) -> None:
    life = Life(tmp_path)
    asked = []
    for _ in range(50):  # the writer is busy
        asked.append(life.flight.dump())
        life.go_on(20)
    assert len(set(asked)) == 2 and life.flight._jobs.qsize() == 1
    life.fault("lease")  # has a separate file
    life.go_on(1020)
    assert life.flight._jobs.qsize() == 2
    life.end()
    assert len(list(tmp_path.iterdir())) == 3
    later = life.flight.dump()
    life.flight.hand_over_due(life.tick * 1_000_000)
    life.end()
    assert later.exists() and life.flight.status()["under_way"] == 0


def test_where_files_go() -> None:
    runtime = Path("/run/hapticd")
    assert directory_of(None, runtime, {}) == runtime
    assert directory_of(None, runtime, {"STATE_DIRECTORY": "/var/lib/hapticd:/x"}) == Path("/var/lib/hapticd")
    assert directory_of("/data", runtime, {"STATE_DIRECTORY": "/var/lib/hapticd"}) == Path("/data")


def test_what_was_written_is_let_go(tmp_path: Path) -> None:
    class Event(dict[str, object]):
        """A dict that weak references can observe."""

    life = Life(tmp_path)
    event = Event(event="contact", tick=0, time_ns=0)
    kept = weakref.ref(event)
    life.go_on(100)
    life.flight.keep_event(event)
    del event
    writer = threading.Thread(target=life.flight.run, args=(threading.Event(),))
    writer.start()
    try:
        path = life.flight.dump()
        life.flight.hand_over_due(life.tick * 1_000_000)
        life.go_on(4000)  # it is too old to be kept
        pause, deadline = threading.Event(), time.monotonic() + 60.0
        while kept() is not None and time.monotonic() < deadline:
            pause.wait(0.01)
        assert path.exists()
        assert kept() is None, "the writer waits, and holds what it wrote"
    finally:
        life.flight.wake()
        writer.join()


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_no_recording_is_neither_replaced_nor_removed(tmp_path: Path, kind: str) -> None:
    special(tmp_path / "flight-000001-fault.npz", kind)
    (tmp_path / "flight-000002-fault.npz").symlink_to("nowhere")
    life = Life(tmp_path, keep=1)
    with untouched(tmp_path, "flight-000004-fault.npz"):
        for _ in range(2):
            life.fault("lease")
            life.go_on(4000)
        life.end()
    assert life.flight.status()["problem"] is None
