"""A daemon under everything at once, for as long as one likes: does anything get lost, or grow?

python -m tests.soak.soak [--for 3600s] [--rate 10000] [--warm-up 300s] [--seed 1] [--out build/soak]

One daemon on the simulated joystick. The hand taps, strokes over grooves and sandpaper and
punctures a membrane; some twenty times a second an object or a material changes, each change at the revision that is
expected; ten clients come, ask, subscribe and leave, some of them killed, two of them never reading what they
subscribed to; `hapticd record` writes .npz and .mcap in turn, `hapticd record --past` and `hapticd watch` run now and
then; the configuration is reloaded; a lease is renewed. A client reads every sample, and recordings must hold the very
same bytes.

Each ten seconds memory, threads and descriptors of the daemon are looked at. After the warm-up its memory must not grow
by a mebibyte or more: medians of the last tenth and of the first. What was found goes into soak.json and
soak.png. Exit code 1 if anything was lost, wrong, or grew.

python -m tests.soak.soak --samples FILE      says of a recording, read without hapticd, which ticks it has; JSON
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import pty
import random
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
import zlib
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from bench.report import machine
from hapticd.base.errors import HapticdError
from hapticd.base.merge_patch import merge_patch
from hapticd.client.blocking import Client, connect
from hapticd.client.samples import SampleStream
from tests.soak.visitor import Visit
from tests.support.daemon_process import Daemon
from tests.support.processes import descriptors, threads

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LOOK_S = 10.0
TELL_S = 60.0
UPDATE_S = 0.05
BLOCK = 1000
"""Ticks whose bytes are compared as one: the checksums of a recording's against those that were sent."""
KEPT_BLOCKS = 6000
"""Checksums that are kept of what was sent: ten minutes at 10 kHz."""
CLIENTS = 10
DEAF = (0, 1)
KILLED_EVERY = 4
"""Of each client's visits, one in so many ends by SIGKILL; those that do not read are always left alone."""
VISIT_S = (4.0, 16.0)
RECORD_S = 20
LEASE_S = 10.0
GROWTH_KIB = 1024
"""1 MB."""
MOST_FAILURES = 50
TIMEOUT_S = 30.0
LATER = ("nice", "-n", "5")
"""Those who come and go must not keep those waiting that read and record every sample."""

MATERIALS = {"soft": {"stiffness_n_per_m": 700.0, "damping_n_s_per_m": 0.5}}
FLOORS = ("wood", "acrylic", "delrin", "soft")
BOX = {"kind": "box", "center_m": [-0.05, 0.06], "size_m": [0.01, 0.005], "angle_rad": 0.1, "material": "soft"}
DISC = {"kind": "disc", "center_m": [0.05, 0.06], "radius_m": 0.004, "material": "wood"}
MOVED = tuple(f"o{index}" for index in range(12))


def _placed(made: dict[str, Any], index: int) -> dict[str, Any]:
    return {**made, "center_m": [-0.055 + 0.02 * (index % 6), 0.045 + 0.015 * (index // 6)]}


SCENE = {
    "objects": {
        "floor": {
            "kind": "wall",
            "point_m": [0, 0],
            "normal": [0, 1],
            "material": "wood",
            "patches": [
                {"from_m": -0.05, "to_m": -0.02, "material": "comb_2400um_vibration"},
                {"from_m": 0.02, "to_m": 0.05, "material": "sandpaper_100"},
            ],
        },
        "skin": {
            "kind": "membrane",
            "center_m": [0, 0.03],
            "normal": [0, 1],
            "width_m": 0.03,
            "material": "cellophane",
        },
        "honey": {"kind": "viscous", "damping_n_s_per_m": 0.5},
        **{id: _placed(DISC if index % 2 else BOX, index) for index, id in enumerate(MOVED)},
    }
}
GESTURES: tuple[dict[str, Any], ...] = (
    {"kind": "tap", "object": "floor", "speed_m_per_s": 0.2, "at_m": 0.0, "count": 3, "height_m": 0.01},
    {
        "kind": "stroke",
        "object": "floor",
        "speed_m_per_s": 0.1,
        "press_n": 1.0,
        "from_m": -0.045,
        "to_m": 0.0,
        "count": 2,
    },
    {
        "kind": "stroke",
        "object": "floor",
        "speed_m_per_s": 0.1,
        "press_n": 0.8,
        "from_m": 0.0,
        "to_m": 0.045,  # beside the skin, so that the hand comes to it from above
        "count": 1,
    },
    {"kind": "puncture", "object": "skin", "speed_m_per_s": 0.1, "height_m": 0.01},
)
TELEMETRY = ("samples", "event", "status")

# What the daemon may say in its log. Anything else is a finding.
EXPECTED = (
    r"configuration: ",
    r"ready: ",
    r"SIGTERM: stopping",
    r"stopp(?:ing|ed)",
    r"\d+ periods? missed",
    r"overload: .* of a second's periods were missed",
    r"not granted: ",
    r"flight recorder: /",
    r"process \d+ of user \d+ does not keep up with telemetry: ",
    r"reloaded",
    r"reload: ",
)


# ---- A recording, read by others' means ------------------------------------------------------------------------------


def samples_in(path: Path) -> npt.NDArray[np.void]:
    """The samples of a recording, read by numpy or by mcap's own reader; packed as telemetry sends them."""
    if path.suffix == ".npz":
        with np.load(path) as file:
            return np.asarray(file["samples"])
    from mcap.reader import make_reader

    from hapticd.base.core import SAMPLE_DTYPE

    with open(path, "rb") as file:
        messages = make_reader(file, validate_crcs=True).iter_messages("hapticd/samples", log_time_order=False)
        # Four bytes say how the record after them is encoded.
        return np.frombuffer(b"".join(message.data[4:] for _, _, message in messages), SAMPLE_DTYPE)


def blocks_of(samples: npt.NDArray[np.void]) -> dict[int, int]:
    """Checksums of all blocks of ticks that are there whole, by their number. The ticks must have no gap."""
    first = int(samples["tick"][0])
    start = -first % BLOCK
    count = (len(samples) - start) // BLOCK
    data = samples[start : start + count * BLOCK].tobytes()
    size = BLOCK * samples.dtype.itemsize
    return {(first + start) // BLOCK + at: zlib.crc32(data[at * size : (at + 1) * size]) for at in range(count)}


def account(path: Path) -> dict[str, Any]:
    """What `--samples` prints."""
    samples = samples_in(path)
    gaps = int(np.count_nonzero(np.diff(samples["tick"].astype(np.int64)) != 1))
    return {"count": len(samples), "gaps": gaps, "blocks": {} if gaps or not len(samples) else blocks_of(samples)}


# ---- Processes -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Look:
    """A process at one moment; memory in KiB."""

    rss: int
    anonymous: int
    """Pss_Anon: what is its own and in no file."""
    locked: int
    """VmLck, which counts address space."""
    threads: int
    descriptors: int


def look_at(pid: int) -> Look:
    """Reads /proc."""
    folder = Path(f"/proc/{pid}")
    told = dict(line.split(":", 1) for line in (folder / "status").read_text().splitlines())
    rollup = dict(line.split(":", 1) for line in (folder / "smaps_rollup").read_text().splitlines()[1:])

    def kib(text: str) -> int:
        return int(text.split()[0])

    return Look(
        kib(told["VmRSS"]),
        kib(rollup["Pss_Anon"]),
        kib(told["VmLck"]),
        threads(pid),
        descriptors(pid),
    )


def unexpected(log: str) -> list[str]:
    """Lines of a daemon's log that nobody expects."""
    known = re.compile(rf"\S+ \S+ hapticd: (?:{'|'.join(EXPECTED)})")
    return [line for line in log.splitlines() if not known.match(line)]


def hapticd(place: Path, *arguments: str) -> list[str]:
    """A command of hapticd's."""
    return [sys.executable, "-m", "hapticd", "--runtime-dir", str(place), *arguments]


# ---- The soak --------------------------------------------------------------------------------------------------------


@dataclass(slots=True)
class Seen:
    """What was seen in one interval of LOOK_S; times in us."""

    at_s: float
    daemon: Look
    lateness_us: list[float]
    """p50, p99, p99.9, largest."""
    answer_us: list[float]
    """p50, p99, largest: of the changes' round trips."""
    missed: int
    """Periods that the servo missed, since the look before."""


@dataclass(slots=True)
class Counted:
    """Totals of what was done."""

    done: Counter[str] = field(default_factory=Counter)
    events: Counter[str] = field(default_factory=Counter)
    samples: int = 0


class Soak:
    """Everything under way. Each party runs in a thread of its own, with connections of its own."""

    def __init__(self, folder: Path, daemon: Daemon, seed: int) -> None:
        self.folder, self.daemon, self.seed = folder, daemon, seed
        self.place = daemon.directory
        self.began = time.monotonic()
        self.stop = threading.Event()
        self.failures: list[str] = []
        self.counted = Counted()
        self.seen: list[Seen] = []
        self._lock = threading.Lock()
        self._changing = threading.Lock()
        """Held by whoever changes the scene, so that each revision is expected."""
        self._revision = 0
        self._mirror: dict[str, Any] = {}
        self._of_file: dict[str, Any] = {}
        self._forms: tuple[dict[str, Any], ...] = ()
        """A box and a disc, in the form in which the daemon tells them."""
        self._lateness: list[npt.NDArray[np.int32]] = []
        self._answers: list[float] = []
        self._blocks: dict[int, int] = {}
        self._kept: npt.NDArray[np.void] | None = None
        self._skipped = 0

    def elapsed_s(self) -> float:
        return time.monotonic() - self.began

    def fail(self, who: str, what: str) -> None:
        """Notes what is wrong, and says so at once."""
        line = f"{self.elapsed_s():.0f} s, {who}: {what}"
        with self._lock:
            self.failures.append(line)
            if len(self.failures) >= MOST_FAILURES:
                self.stop.set()
        print(f"FAILED {line}", flush=True)

    def count(self, what: str, number: int = 1) -> None:
        with self._lock:
            self.counted.done[what] += number

    def rng(self, name: str) -> random.Random:
        return random.Random(f"{self.seed} {name}")

    def client(self) -> Client:
        return connect(self.place, TIMEOUT_S)

    def parties(self) -> dict[str, Callable[[], None]]:
        """Who takes part; each returns when `stop` is set."""
        return {
            "update": self._update,
            "operator": self._operate,
            "lease": self._lease,
            "reader": self._read,
            "record": self._record,
            "flight": self._flight,
            "watch": self._watch,
            "reload": self._reload,
            **{f"client {slot}": partial(self._visit, slot) for slot in range(CLIENTS)},
        }

    def run_party(self, name: str, work: Callable[[], None]) -> None:
        """Once more after a failure, which is a finding."""
        while not self.stop.is_set():
            try:
                work()
            except Exception as error:
                self.fail(name, f"{type(error).__name__}: {error}")
                self.stop.wait(1.0)

    # ---- Changes -----------------------------------------------------------------------------------------------------

    def prepare(self, client: Client) -> None:
        """The scene as the daemon says it: what every change is laid over here, too."""
        told = client.get_scene()
        self._revision, self._of_file = told["revision"], told["scene"]
        self._mirror = dict(self._of_file)
        objects = self._mirror["objects"]
        self._forms = (objects[MOVED[0]], objects[MOVED[1]])

    def _changed(self, told: Any, what: str) -> None:
        self._revision = (self._revision + 1) & 0xFFFFFFFF
        if told["revision"] != self._revision:
            self.fail("update", f"{what}: revision {told['revision']}, expected {self._revision}")
            self._revision = told["revision"]
        self.count(what)

    def _form(self, rng: random.Random) -> dict[str, Any]:
        """A box or a disc somewhere above, in the form in which the daemon tells it."""
        made = dict(rng.choice(self._forms))
        made["center_m"] = [rng.uniform(-0.06, 0.06), rng.uniform(0.045, 0.065)]
        made["material"] = rng.choice(("soft", "wood", "delrin"))
        return made

    def _patch(self, rng: random.Random) -> Any:
        """Objects, as a merge patch."""
        objects, kind, id = self._mirror["objects"], rng.random(), rng.choice(MOVED)
        if kind < 0.1:
            return {"floor": {"material": rng.choice(FLOORS)}}
        if kind < 0.15 and id in objects:
            return {id: None}
        if id in objects and kind < 0.85:
            return {id: {"center_m": [rng.uniform(-0.06, 0.06), rng.uniform(0.045, 0.065)]}}
        made = self._form(rng)
        # A change of kind names the keys of the old one with nil.
        return {id: {**{key: None for key in objects.get(id, {}) if key not in made}, **made}}

    def _update(self) -> None:
        rng = self.rng("update")
        with self.client() as client:
            number, due = 0, time.monotonic()
            while not self.stop.is_set():
                number += 1
                with self._changing:
                    begin = time.perf_counter()
                    self._change_one(client, rng, number)
                    self._answers.append(1e6 * (time.perf_counter() - begin))
                due = max(due + UPDATE_S, time.monotonic())
                self.stop.wait(max(0.0, due - time.monotonic()))

    def _change_one(self, client: Client, rng: random.Random, number: int) -> None:
        wait = number % 10 == 0
        if number % 100 == 0:
            told = client.get_scene()
            if told["scene"] != self._mirror or told["revision"] != self._revision:
                self.fail("update", f"the scene of revision {told['revision']} is not what was set")
                self._mirror = dict(told["scene"])
            self.count("scenes compared")
        if number % 50 == 1:
            patch = {"soft": {"stiffness_n_per_m": rng.uniform(500.0, 900.0)}}
            self._changed(client.update_materials(patch, self._revision, wait), "material changes")
        elif number % 200 == 2:
            self._changed(client.set_scene(self._mirror, self._revision, wait), "whole scenes")
        else:
            patch = self._patch(rng)
            told_update = client.update_scene(patch, self._revision, wait)
            merged: Any = merge_patch(self._mirror["objects"], patch)
            self._mirror["objects"] = merged
            self._changed(told_update, "object changes")

    def _reload(self) -> None:
        """By SIGHUP and by the method, in turns; both take the scene of the file."""
        rng = self.rng("reload")
        with self.client() as client:
            by_signal = False
            while not self.stop.wait(rng.uniform(15, 45)):
                by_signal = not by_signal
                with self._changing:
                    self._changed(
                        client.update_scene({"floor": {"material": "delrin"}}, self._revision), "object changes"
                    )
                    if by_signal:
                        self.daemon.process.send_signal(signal.SIGHUP)
                        self._await_revision(client)
                    else:
                        self._changed(client.reload(self._revision, True), "reloads")
                    told = client.get_scene()
                    if told["revision"] != self._revision or told["scene"] != self._of_file:
                        self.fail("reload", f"revision {told['revision']} is not the scene of the file")
                    self._mirror = dict(told["scene"])

    def _await_revision(self, client: Client) -> None:
        deadline = time.monotonic() + TIMEOUT_S
        while (told := client.get_scene())["revision"] == self._revision:
            if time.monotonic() > deadline:
                raise HapticdError("SIGHUP reloaded nothing")
            time.sleep(0.02)  # nothing answers a signal
        self._changed(told, "reloads")

    # ---- Hand and lease ----------------------------------------------------------------------------------------------

    def _operate(self) -> None:
        with self.client() as client:
            while not self.stop.is_set():
                for gesture in GESTURES:
                    told = client.set_operator(gesture=gesture)
                    self.count(f"gestures: {gesture['kind']}")
                    if self.stop.wait(told["duration_s"]):
                        return
                client.reset(["skin"])

    def _lease(self) -> None:
        with self.client() as client:
            token = client.lease(LEASE_S)["token"]
            while not self.stop.wait(LEASE_S / 5):
                client.lease(LEASE_S, token)
                self.count("lease renewals")
            client.lease(0, token)

    # ---- Telemetry ---------------------------------------------------------------------------------------------------

    def _read(self) -> None:
        stream = SampleStream(warn=False)
        with self.client() as client, client.telemetry(*TELEMETRY, timeout_s=TIMEOUT_S) as feed:  # type: ignore[arg-type]
            while not self.stop.is_set():
                received = feed.receive(1.0)
                if received is None:
                    self.fail("reader", "no telemetry for a second")
                    continue
                topic, message = received
                if topic == "samples":
                    batch = stream.convert(topic, message)
                    if batch.lost or stream.dropped or stream.restarts:
                        self.fail(
                            "reader", f"before tick {batch.first_tick}: {batch.lost} lost, {stream.dropped} dropped"
                        )
                        stream.dropped = stream.restarts = 0
                    self.counted.samples = stream.received
                    self._take(batch.view(np.ndarray))
                else:
                    self._judge(str(topic), message)

    def _take(self, batch: npt.NDArray[np.void]) -> None:
        kept = batch if self._kept is None else np.concatenate([self._kept, batch])
        with self._lock:
            self._lateness.append(batch["lateness_ns"].copy())
            found = blocks_of(kept)
            self._blocks |= found
            for number in found:
                self._blocks.pop(number - KEPT_BLOCKS, None)
        if found:
            kept = kept[np.searchsorted(kept["tick"], (max(found) + 1) * BLOCK) :]
        self._kept = kept.copy()

    def _judge(self, topic: str, message: dict[str, Any]) -> None:
        if topic == "event":
            self.counted.events[message["event"]] += 1
            if message["event"] in ("fault", "device_lost", "glitch", "rate", "memory_refused"):
                self.fail("events", str(message))
        elif topic == "status" and (message["faults"] or message["forces"] != "on"):
            self.fail("status", f"forces {message['forces']}, faults {message['faults']}")

    # ---- Commands ----------------------------------------------------------------------------------------------------

    def _run(self, arguments: Sequence[str], codes: Sequence[int] = (0,), timeout_s: float = 120) -> str:
        done = subprocess.run(arguments, capture_output=True, text=True, timeout=timeout_s, check=False)
        if done.returncode not in codes:
            raise HapticdError(f"{' '.join(arguments[1:])}: exit code {done.returncode}: {done.stderr.strip()}")
        return done.stdout

    def _record(self) -> None:
        number = 0
        while not self.stop.is_set():
            for ending in ("npz", "mcap"):
                number += 1
                file = self.folder / f"recording-{number}.{ending}"
                said = self._run(hapticd(self.place, "record", str(file), "--for", f"{RECORD_S}s", "--json"))
                told = json.loads(said)
                if told["lost"] or told["dropped"] or told["missing_revisions"] or told["ended_because"]:
                    self.fail("record", said.strip())
                self._compare(file, told["ticks"])
                self.count(f"recordings: {ending}")
                for path in self.folder.glob(f"recording-{number}.*"):
                    path.unlink()
                if self.stop.is_set():
                    return

    def _flight(self) -> None:
        rng = self.rng("flight")
        file = self.folder / "flight.npz"
        while not self.stop.wait(rng.uniform(20, 60)):
            self._run(hapticd(self.place, "record", "--past", str(file), "--overwrite"))
            self._compare(file, None)
            self.count("flight files")

    def _compare(self, file: Path, ticks: int | None) -> None:
        """That a file holds what was sent, bit for bit."""
        found = json.loads(self._run([*LATER, sys.executable, "-m", "tests.soak.soak", "--samples", str(file)]))
        with self._lock:
            sent = {number: self._blocks.get(number) for number in map(int, found["blocks"])}
        wrong = [number for number, told in found["blocks"].items() if sent[int(number)] not in (None, told)]
        compared = sum(told is not None for told in sent.values())
        if found["gaps"] or wrong or (ticks is not None and found["count"] != ticks):
            self.fail("record", f"{file.name}: {found['count']} samples, {found['gaps']} gaps, wrong blocks {wrong}")
        self.count("recorded ticks compared", compared * BLOCK)

    def _watch(self) -> None:
        """On a terminal of its own."""
        rng = self.rng("watch")
        while not self.stop.is_set():
            master, slave = pty.openpty()
            with open(master, "rb", buffering=0) as screen:
                process = subprocess.Popen(
                    hapticd(self.place, "watch"),
                    stdin=slave,
                    stdout=slave,
                    stderr=slave,
                    env={**os.environ, "TERM": "xterm"},
                )
                os.close(slave)
                reader = threading.Thread(target=_drain, args=(screen,))
                reader.start()
                try:
                    self.stop.wait(rng.uniform(10, 40))
                finally:
                    process.terminate()
                    try:
                        code = process.wait(30)
                    except subprocess.TimeoutExpired:
                        process.kill()
                        code = process.wait()
                    reader.join()
            if code != 128 + signal.SIGTERM:
                self.fail("watch", f"exit code {code}")
            self.count("watches")

    # ---- Clients that come and go ------------------------------------------------------------------------------------

    def _visit(self, slot: int) -> None:
        rng = self.rng(f"client {slot}")
        number = 0
        while not self.stop.is_set():
            number += 1
            visit = Visit(str(self.place), rng.getrandbits(32), rng.uniform(*VISIT_S), slot not in DEAF)
            killed = slot not in DEAF and number % KILLED_EVERY == 0
            process = subprocess.Popen(
                [*LATER, sys.executable, "-m", "tests.soak.visitor", json.dumps(asdict(visit))],
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
            try:
                said, errors = process.communicate(timeout=rng.uniform(1, visit.seconds) if killed else 120)
            except subprocess.TimeoutExpired:
                process.kill()
                process.communicate()
                if killed:
                    self.count("clients killed")
                else:
                    self.fail(f"client {slot}", "did not end within two minutes")
                continue
            if process.returncode:
                self.fail(f"client {slot}", errors.strip()[-500:])
                continue
            told = json.loads(said)
            if told["lost"]:
                self.fail(f"client {slot}", f"{told['lost']} samples lost")
            self.count("requests of visitors", told["asked"])
            self.count("visits")

    # ---- What is looked at -------------------------------------------------------------------------------------------

    def look(self, client: Client) -> Seen:
        counters = client.get_status()["counters"]
        for name in ("samples_dropped", "events_dropped"):
            if counters[name]:
                self.fail("counters", f"{name}: {counters[name]}")
        missed, self._skipped = counters["skipped"] - self._skipped, counters["skipped"]
        with self._lock:
            lateness, self._lateness = self._lateness, []
            answers, self._answers = self._answers, []
        late = np.concatenate([np.zeros(0, np.int32), *lateness]) / 1e3
        one = Seen(
            self.elapsed_s(),
            look_at(self.daemon.process.pid),
            [*_percentiles(late, (50, 99, 99.9)), float(late.max(initial=0))],
            [*_percentiles(np.array(answers), (50, 99)), max(answers, default=0.0)],
            missed,
        )
        self.seen.append(one)
        return one


def _drain(screen: Any) -> None:
    with contextlib.suppress(OSError):  # the other end of a terminal is told so
        while screen.read(65536):
            pass


def _percentiles(values: npt.NDArray[Any], parts: Sequence[float]) -> list[float]:
    return [float(value) for value in np.percentile(values, parts)] if len(values) else [0.0] * len(parts)


# ---- Judgement -------------------------------------------------------------------------------------------------------


def growth(times_s: Sequence[float], values: Sequence[float]) -> dict[str, float]:
    """Of memory in KiB: median of the last tenth less that of the first, and the slope by least squares, an hour."""
    tenth = max(1, len(values) // 10)
    first, last = (float(np.median(part)) for part in (values[:tenth], values[-tenth:]))
    slope = float(np.polyfit(times_s, values, 1)[0]) * 3600 if len(values) > 1 else 0.0
    return {"first_kib": first, "last_kib": last, "growth_kib": last - first, "slope_kib_per_hour": slope}


def judge(soak: Soak, warm_up_s: float, before: Look, after: Look) -> dict[str, Any]:
    """What grew; failures are noted."""
    warm = [one for one in soak.seen if one.at_s >= warm_up_s]
    looks = [one.daemon for one in warm]
    found: dict[str, Any] = {}
    for what in ("rss", "anonymous", "locked"):
        grown = growth([one.at_s for one in warm], [getattr(look, what) for look in looks])
        found[what] = grown
        if what != "locked" and grown["growth_kib"] >= GROWTH_KIB:
            soak.fail("daemon", f"{what} grew by {grown['growth_kib'] / 1024:.2f} MiB")
    for what in ("threads", "descriptors"):
        told = [getattr(look, what) for look in (before, *looks, after)]
        found[what] = {"before": told[0], "most": max(told), "after": told[-1]}
        if told[-1] > told[0]:
            soak.fail("daemon", f"{told[-1]} {what} when everybody had left, {told[0]} before anybody came")
    return found


def _settled(before: Look, daemon: Daemon) -> Look:
    """The daemon when everybody has left; what is closed last has half a minute."""
    deadline = time.monotonic() + 30
    while True:
        after = look_at(daemon.process.pid)
        if after.descriptors <= before.descriptors or time.monotonic() > deadline:
            return after
        time.sleep(0.5)  # another process, which tells nobody


def draw(seen: Sequence[Seen], warm_up_s: float, path: Path) -> None:
    """Memory, latency and missed periods over time."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    canvas = Figure(figsize=(10.0, 9.0), dpi=100, layout="constrained")
    FigureCanvasAgg(canvas)
    axes: Sequence[Axes] = canvas.subplots(3, 1, sharex=True)
    at = [one.at_s / 60 for one in seen]
    for what, label in (("rss", "resident"), ("anonymous", "of it anonymous")):
        axes[0].plot(at, [getattr(one.daemon, what) / 1024 for one in seen], label=label)
    axes[0].set_ylabel("memory, MiB")
    axes[0].axvspan(0, warm_up_s / 60, alpha=0.1, label="warm-up")
    axes[0].legend(loc="lower right")
    for index, label in enumerate(("p50", "p99", "p99.9", "largest")):
        axes[1].plot(at, [max(one.lateness_us[index], 0.1) for one in seen], label=label)
    axes[1].set_yscale("log")
    axes[1].set_ylabel("lateness, us")
    axes[1].legend(loc="upper right")
    axes[2].plot(at, [one.missed for one in seen])
    axes[2].set_ylabel(f"periods missed in {LOOK_S:g} s")
    axes[2].set_xlabel("minutes")
    canvas.savefig(path, metadata={"Software": None})


# ---- The order of it -------------------------------------------------------------------------------------------------


def _progress(one: Seen, soak: Soak, total_s: float) -> str:
    done = soak.counted.done
    return (
        f"{one.at_s:5.0f} of {total_s:.0f} s: daemon {one.daemon.rss / 1024:.2f} MiB, "
        f"{one.daemon.descriptors} descriptors, {one.daemon.threads} threads; lateness p99 "
        f"{one.lateness_us[1]:.0f} us, answers p99 {1e-3 * one.answer_us[1]:.1f} ms; "
        f"{sum(number for name, number in done.items() if 'changes' in name)} changes, {done['visits']} visits, "
        f"{sum(number for name, number in done.items() if name.startswith('recordings'))} recordings; "
        f"{len(soak.failures)} failures"
    )


def run(total_s: float, rate_hz: float, warm_up_s: float, seed: int, out: Path) -> int:
    """All of it; the exit code. Raises HapticdError where it cannot begin."""
    on = machine()
    print(on, flush=True)
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="hapticd-soak-") as name:
        folder = Path(name)
        config = folder / "daemon.yaml"
        config.write_text(json.dumps({"servo": {"rate_hz": rate_hz}, "materials": MATERIALS, "scene": SCENE}))
        daemon = Daemon(folder / "run", "-c", str(config))
        try:
            daemon.wait_ready()
            soak = Soak(folder, daemon, seed)
            before = look_at(daemon.process.pid)
            with soak.client() as client:
                granted = client.get_status()["realtime"]
                soak.prepare(client)
                parties = [
                    threading.Thread(target=soak.run_party, args=party, name=party[0])
                    for party in soak.parties().items()
                ]
                for thread in parties:
                    thread.start()
                next_look, next_told = LOOK_S, TELL_S
                try:
                    while not soak.stop.is_set() and soak.elapsed_s() < total_s:
                        if soak.stop.wait(max(0.0, min(next_look, total_s) - soak.elapsed_s())):
                            break
                        one = soak.look(client)
                        next_look += LOOK_S
                        if one.at_s >= next_told:
                            next_told += TELL_S
                            print(_progress(one, soak, total_s), flush=True)
                        if daemon.process.poll() is not None:
                            soak.fail("daemon", f"ended with {daemon.process.returncode}")
                            soak.stop.set()
                except KeyboardInterrupt:
                    soak.fail("soak", "interrupted")
                finally:
                    lasted_s = soak.elapsed_s()
                    soak.stop.set()
                    for thread in parties:
                        thread.join()
                status: Any = client.call("get_status", {"detail": True})
            after = _settled(before, daemon)
            grown = judge(soak, warm_up_s, before, after)
        finally:
            code = daemon.stop()
        if code:
            soak.fail("daemon", f"ended with {code}")
        for line in unexpected(daemon.said()):
            soak.fail("daemon's log", line)
    draw(soak.seen, warm_up_s, out / "soak.png")
    found = {
        "machine": on,
        "seconds": lasted_s,
        "rate_hz": rate_hz,
        "warm_up_s": warm_up_s,
        "seed": seed,
        "realtime": granted,
        "failures": soak.failures,
        "done": dict(sorted(soak.counted.done.items())),
        "events": dict(sorted(soak.counted.events.items())),
        "samples": soak.counted.samples,
        "counters": status["counters"],
        "histograms": status["histograms"],
        "memory": grown,
        "looks": [asdict(one) for one in soak.seen],
    }
    (out / "soak.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    _tell(found, out)
    return 1 if soak.failures else 0


def _tell(found: dict[str, Any], out: Path) -> None:
    print(f"\n{found['seconds']:.0f} s at {found['rate_hz']:g} Hz, {found['samples']} samples")
    for what in ("done", "events", "counters"):
        print(f"{what}: {', '.join(f'{name} {number}' for name, number in found[what].items())}")
    print("| | first tenth, MiB | last tenth, MiB | growth, KiB | slope, KiB/h |")
    print("| --- | ---: | ---: | ---: | ---: |")
    for what in ("rss", "anonymous", "locked"):
        each = found["memory"][what]
        print(
            f"| {what} | {each['first_kib'] / 1024:.2f} | {each['last_kib'] / 1024:.2f} | "
            f"{each['growth_kib']:+.0f} | {each['slope_kib_per_hour']:+.0f} |"
        )
    for what in ("threads", "descriptors"):
        each = found["memory"][what]
        print(f"{what}: {each['before']} before, {each['most']} at most, {each['after']} after")
    print(f"{len(found['failures'])} failures; written: {out / 'soak.json'}, {out / 'soak.png'}")


def _seconds(text: str) -> float:
    match = re.fullmatch(r"(\d+(?:\.\d+)?)(s|min|h)?", text)
    if match is None or not math.isfinite(float(match[1])):
        raise argparse.ArgumentTypeError("a time, such as 3600s, 60min or 1h")
    return float(match[1]) * {"s": 1, "min": 60, "h": 3600}[match[2] or "s"]


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.soak.soak", description=__doc__.splitlines()[0])
    parser.add_argument("--for", dest="total_s", type=_seconds, default=3600.0, help="how long: 3600s, 15min, 1h")
    parser.add_argument("--rate", type=float, default=10_000.0, help="ticks a second")
    parser.add_argument("--warm-up", type=_seconds, help="before memory is judged [default: 300s, a third at most]")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("build/soak"), help="where soak.json and soak.png go")
    parser.add_argument("--samples", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args(arguments)
    if given.samples is not None:
        print(json.dumps(account(given.samples)))
        return 0
    warm_up_s = min(300.0, given.total_s / 3) if given.warm_up is None else given.warm_up
    try:
        return run(given.total_s, given.rate, warm_up_s, given.seed, given.out)
    except HapticdError as error:
        print(f"soak: {error}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
