"""The whole daemon under a sanitizer, driven with all that clients can say and all that befalls it.

As a program (`python -m tests.sanitized.daemon NAME LAUNCHER`, as `make NAME-daemon` says it): daemons run in LAUNCHER,
which tests/sanitized/launcher.c becomes under a sanitizer.

    sim       the simulated joystick under scene and material updates, every method, subscribers that come and go,
              leases that lapse, SIGHUP, SIGSTOP, and SIGTERM in the middle of that
    overload  a rate that cannot be held; the servo ends and goes on at half of it
    stick     a HID joystick that plays taps by itself, is unplugged, plugged in again and reset
    led       the same without offloading, its reports lead the ticks, and it freezes
    defect    a daemon in which a defect is committed

Each goes on for its share of `--seconds` and until everything has happened that is to happen. It is clean where the
daemon ends with exit code 0 and the sanitizer says nothing; the last one must not be.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import signal
import subprocess
import sys
import sysconfig
import tempfile
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import yaml

import hapticd
from hapticd.client.blocking import Client
from hapticd.protocol.calls import RemoteError
from hapticd.protocol.messages import Code
from tests.support.daemon_process import listens

ROOT: Final = Path(__file__).parents[2]
CONFIG: Final = ROOT / "config"
PATIENCE_S: Final = 300.0
"""A defect, not a slow machine."""


@dataclass(frozen=True)
class Sanitizer:
    """How one is run, and what it says of the defect."""

    environment: dict[str, str]
    rate_hz: int
    realtime: str
    says: Sequence[str]


# Python's own memory is taken from malloc, so that AddressSanitizer sees what is written beyond it. What Python and its
# extensions hold at their end is no leak of ours, and nothing tells it from one; the C tests look for leaks.
# ThreadSanitizer knows nothing of what code that was not built with it reads and writes: Python's, numpy's, libzmq's.
# It sees their locks, and memory that they touch by way of the C library is left out. No report is suppressed.
SANITIZERS: Final = {
    "tsan": Sanitizer(
        {"TSAN_OPTIONS": "ignore_noninstrumented_modules=1 history_size=4 second_deadlock_stack=1"},
        5000,
        "off",
        ("ThreadSanitizer: data race", "hd_triple_publish"),
    ),
    "asan": Sanitizer(
        {
            "ASAN_OPTIONS": "detect_leaks=0 detect_stack_use_after_return=1 strict_string_checks=1",
            "PYTHONMALLOC": "malloc",
        },
        5000,
        "off",
        ("AddressSanitizer: heap-buffer-overflow", "hd_ring_push"),
    ),
    "ubsan": Sanitizer(
        {"UBSAN_OPTIONS": "print_stacktrace=1"}, 10000, "preferred", ("runtime error", "hd_histogram.c")
    ),
    "rtsan": Sanitizer({}, 10000, "preferred", ("RealtimeSanitizer: unsafe-library-call", "malloc", "tick")),
}
REPORT: Final = re.compile(r"Sanitizer|runtime error:")


# ---- Daemons ---------------------------------------------------------------------------------------------------------


@dataclass
class Run:
    """What is the same for all daemons of a run."""

    name: str
    launcher: Path
    seconds: float
    directory: Path
    dice: random.Random = field(default_factory=lambda: random.Random(7))

    @property
    def sanitizer(self) -> Sanitizer:
        return SANITIZERS[self.name]


class Daemon:
    """One daemon in the launcher."""

    def __init__(self, run: Run, config: str, *program: str, on_one_processor: bool = False) -> None:
        self.directory = Path(tempfile.mkdtemp(dir=run.directory))
        self.runtime, self.config, self.log = (self.directory / name for name in ("run", "c.yaml", "log"))
        self.config.write_text(config)
        self.processor = min(os.sched_getaffinity(0)) if on_one_processor else None
        names = {"RUNTIME": str(self.runtime), "CONFIG": str(self.config)}
        paths = [str(ROOT), sysconfig.get_path("purelib"), sysconfig.get_path("platlib"), *sys.path]
        environment = {
            **os.environ,
            **run.sanitizer.environment,
            "PYTHONFAULTHANDLER": "1",
            "PYTHONPATH": os.pathsep.join(dict.fromkeys(path for path in paths if path)),
        }
        pinned = [] if self.processor is None else ["taskset", "-c", str(self.processor)]
        with open(self.log, "wb") as log:
            self.process = subprocess.Popen(
                [*pinned, str(run.launcher), "-m", *(names.get(word, word) for word in program)],
                cwd=ROOT,
                env=environment,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
            )
        try:
            until(lambda: listens(self.runtime / "hapticd.command"), self)
        except BaseException:
            self.process.kill()
            raise

    def tell(self, line: str) -> None:
        """Tells tests.sanitized.stick, which does it."""
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.write(f"{line}\n")
        self.process.stdin.flush()
        answer = self.process.stdout.readline()
        assert answer == "done\n", f"{line}: {answer!r}"

    def said(self) -> str:
        return self.log.read_text(errors="replace")

    def end(self) -> int:
        """SIGTERM; the exit code."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
        assert self.process.stdin is not None
        self.process.stdin.close()
        try:
            return self.process.wait(PATIENCE_S)
        finally:
            self.process.kill()

    def abort(self) -> None:
        """SIGABRT, for which Python writes into the log what each of its threads is doing."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGABRT)

    def findings(self, code: int) -> str | None:
        """What is wrong with how it ended; None: nothing."""
        said = self.said()
        if code == 0 and not REPORT.search(said):
            return None
        return f"exit code {code}\n{said}"


def until(what: Callable[[], bool], daemon: Daemon, every_s: float = 0.05) -> None:
    """Waits for what nobody tells."""
    pause, deadline = threading.Event(), time.monotonic() + PATIENCE_S
    while not what():
        if daemon.process.poll() is not None:
            raise AssertionError(f"the daemon ended: {daemon.findings(daemon.process.returncode)}")
        assert time.monotonic() < deadline, daemon.said()
        pause.wait(every_s)


@contextmanager
def clean(run: Run, config: str, *program: str, on_one_processor: bool = False) -> Iterator[Daemon]:
    """A daemon that must end in order and without a report."""
    daemon = Daemon(run, config, *program, on_one_processor=on_one_processor)
    try:
        yield daemon
    except BaseException:
        code = daemon.end()
        print(daemon.findings(code) or daemon.said(), file=sys.stderr)
        raise
    findings = daemon.findings(daemon.end())
    if findings:
        raise AssertionError(findings)


# ---- What clients do -------------------------------------------------------------------------------------------------


class Load:
    """Clients in threads of their own, and what they met."""

    def __init__(self, daemon: Daemon, run: Run, timeout_s: float = PATIENCE_S, *, to_the_end: bool = False) -> None:
        """`to_the_end`: of the daemon, whom clients then miss."""
        self.daemon = daemon
        self.dice = run.dice
        self.timeout_s = timeout_s
        self.to_the_end = to_the_end
        self.over = threading.Event()
        self.failures: list[BaseException] = []
        self.methods: set[str] = set()
        self.codes: set[Code] = set()
        self.events: set[str] = set()
        self.status: dict[str, Any] = {}
        self.rounds = 0
        """Of mishaps."""
        self._threads: list[threading.Thread] = []

    def client(self, work: Callable[[Client, random.Random], None]) -> None:
        """`work` again and again on a connection of its own."""
        dice = random.Random(self.dice.random())

        def guarded() -> None:
            try:
                with hapticd.connect(self.daemon.runtime, self.timeout_s) as client:
                    while not self.over.is_set():
                        work(client, dice)
            except hapticd.DaemonNotRunning as error:
                if not self.to_the_end:
                    self.failures.append(error)
                    self.daemon.abort()
            except BaseException as error:
                self.failures.append(error)

        self._threads.append(threading.Thread(target=guarded))

    def call(self, client: Client, method: str, **params: Any) -> dict[str, Any]:
        """A request that may be refused, but not by a defect."""
        self.methods.add(method)
        try:
            return client.call(method, params)  # type: ignore[return-value]
        except RemoteError as error:
            assert error.code != Code.INTERNAL, error
            self.codes.add(Code(error.code))
            return {}

    def listen(self, client: Client, dice: random.Random) -> None:
        """A subscriber that stays."""
        with client.telemetry("event", "status") as messages:
            while not self.over.is_set():
                for topic, message in (next(messages) for _ in range(10)):
                    if topic == "event":
                        self.events.add(str(message["event"]))
                    else:
                        self.status = message

    def come_and_go(self, client: Client, dice: random.Random) -> None:
        """Subscribers that go in the middle."""
        with client.samples() as samples, client.states() as states:
            for _ in range(dice.randrange(1, 20)):
                next(samples)
            next(states)

    @contextmanager
    def running(self) -> Iterator[None]:
        for thread in self._threads:
            thread.start()
        try:
            yield
        finally:
            self.over.set()
            for thread in self._threads:
                thread.join()
            for failure in self.failures:
                raise failure

    def last(self, seconds: float, what: Callable[[], bool]) -> None:
        """For so long at the least, and until that holds."""
        end = time.monotonic() + seconds
        until(lambda: bool(self.failures) or (time.monotonic() > end and what()), self.daemon)


def texts(folder: str) -> list[dict[str, Any]]:
    return [yaml.safe_load(path.read_text()) for path in sorted((CONFIG / folder).glob("*.yaml"))]


MATERIALS: Final = {name: one for file in texts("materials") for name, one in file["materials"].items()} | {
    # No link of less than 3750 forces a second carries it.
    "ringing": {
        "stiffness_n_per_m": 800,
        "tap": {"attack_slope_per_s": 300, "frequency_hz": 1500, "decay_time_s": 0.0005},
    }
}
SCENES: Final = [
    {**file["scene"], "passivity": passivity} for file in texts("scenes") for passivity in ("off", "observe", "control")
]
OPERATORS: Final = texts("operators")


def some_object(dice: random.Random) -> dict[str, Any] | None:
    x, y = (round(dice.uniform(-0.04, 0.04), 4) for _ in range(2))
    material = dice.choice(sorted(MATERIALS))
    return dice.choice(
        (
            None,
            {"kind": "disc", "center_m": [x, y], "radius_m": 0.005, "material": material},
            {"kind": "box", "center_m": [x, y], "size_m": [0.02, 0.01], "angle_rad": x, "material": material},
            {"kind": "membrane", "center_m": [x, y], "normal": [0, 1], "width_m": 0.05, "material": "cellophane"},
            {"kind": "wall", "point_m": [0, -0.01], "normal": [0, 1], "material": material},
        )
    )


def scenes(load: Load) -> Callable[[Client, random.Random], None]:
    """Scenes one after the other, each changed some times."""

    def work(client: Client, dice: random.Random) -> None:
        load.call(client, "set_scene", scene=dice.choice(SCENES), wait=dice.random() < 0.5)
        for _ in range(dice.randrange(30)):
            # Another kind under the same id would be patched; that is refused.
            id = f"o{dice.randrange(200)}"
            load.call(client, "update_scene", objects={id: None})
            load.call(client, "update_scene", objects={id: some_object(dice)}, wait=dice.random() < 0.2)
        name = dice.choice(("wood", "steel", "cellophane"))
        load.call(client, "update_materials", materials={name: {"stiffness_n_per_m": dice.uniform(100, 900)}})
        load.call(client, "set_materials", materials={name: {"stiffness_n_per_m": dice.uniform(100, 900)}})
        load.call(client, "update_materials", materials={name: None})
        soft = {"stiffness_n_per_m": dice.uniform(100, 900)}
        load.call(client, "apply", materials={"wood": soft}, scene=dice.choice(SCENES), wait=dice.random() < 0.2)
        load.call(client, "update_materials", materials={"wood": None})

    return work


def taps(load: Load) -> Callable[[Client, random.Random], None]:
    """A hand that goes through everything, over and over."""

    def work(client: Client, dice: random.Random) -> None:
        way = [[0, 0, 0.03]]
        for step in range(1, 12):
            way.append([0.08 * step, round(dice.uniform(-0.05, 0.05), 4), dice.choice((-0.012, 0.03))])
        load.call(client, "set_operator", **dice.choice([*OPERATORS, *[{"waypoints": way}] * 10]))
        load.over.wait(0.9)

    return work


def commands(load: Load) -> Callable[[Client, random.Random], None]:
    """Every other method, in any order."""
    mode = {"frequency_hz": 300, "decay_time_s": 0.01}

    def work(client: Client, dice: random.Random) -> None:
        push: dict[str, Any] = {"direction": [dice.uniform(-1, 1), 1], "amplitude_m_per_s2": dice.uniform(0, 300)}
        match dice.randrange(13):
            case 0 | 1 | 2:
                load.call(client, "play", material=dice.choice(("wood", "steel")), **push)
            case 3 | 4:
                load.call(client, "play", mode=mode, **push)
            case 5:
                load.call(client, "reset")
            case 6:
                load.call(client, "set_forces", enabled=False)
                load.call(client, "set_forces", enabled=True)
            case 7:
                load.call(client, "lease", duration_s=0.1)  # nobody renews it
                load.over.wait(0.2)
                load.call(client, "set_forces", enabled=True)
            case 8:
                token = load.call(client, "lease", duration_s=1).get("token")
                if token:
                    load.call(client, "lease", duration_s=0, token=token)
            case 9:
                for method in ("get_status", "get_state", "get_config", "get_scene", "get_materials"):
                    load.call(client, method)
            case 10:
                load.call(client, "dump_flight")
            case 11:
                load.call(client, "mark", text="trial", data={"number": dice.randrange(100)})
            case _:
                load.call(client, "reload", wait=True)
                load.call(client, "update_scene", objects={"floor": {"kind": "none"}})

    return work


def streams(load: Load) -> Callable[[Client, random.Random], None]:
    """Targets of the hand, then forces: messages without an answer."""

    def work(client: Client, dice: random.Random) -> None:
        for kind, most in (("target", 0.04), ("force", 2.0)):
            load.methods.add(f"stream_{kind}")
            try:
                with client.stream() as stream:
                    for _ in range(dice.randrange(1, 100)):
                        getattr(stream, kind)(dice.uniform(-most, most), dice.uniform(-most, most))
                        load.over.wait(0.001)
            except RemoteError as error:
                assert error.code != Code.INTERNAL, error
                load.codes.add(Code(error.code))
            load.over.wait(0.5)

    return work


# ---- Daemons and what befalls them -----------------------------------------------------------------------------------


def head(run: Run, **servo: Any) -> str:
    """The configuration's beginning."""
    servo = {"realtime": run.sanitizer.realtime, "rate_hz": run.sanitizer.rate_hz, "overruns": {"threshold": 1}} | servo
    return yaml.safe_dump({"servo": servo, "materials": MATERIALS, "flight": {"keep": 2}})


def sim(run: Run) -> None:
    program = ("hapticd", "--runtime-dir", "RUNTIME", "run", "-c", "CONFIG")
    text = head(run)
    with clean(run, text, *program) as daemon:
        load = Load(daemon, run)
        works = (
            scenes(load),
            taps(load),
            commands(load),
            commands(load),
            streams(load),
            load.listen,
            *[load.come_and_go] * 3,
        )
        for work in works:
            load.client(work)

        def disturb(client: Client, dice: random.Random) -> None:
            daemon.config.write_text(text + yaml.safe_dump({"scene": dice.choice(SCENES)}))
            daemon.process.send_signal(signal.SIGHUP)
            load.over.wait(1.0)
            daemon.process.send_signal(signal.SIGSTOP)
            load.over.wait(0.1)
            daemon.process.send_signal(signal.SIGCONT)

        load.client(disturb)
        wanted = {"contact", "release", "puncture", "groove", "fault", "revision", "overrun"}
        methods = known_methods()
        with load.running():
            load.last(0.45 * run.seconds, lambda: wanted <= load.events and methods <= load.methods)
        assert load.methods == methods, methods ^ load.methods
        # And taken down in the middle of it.
        load = Load(daemon, run, timeout_s=5.0, to_the_end=True)
        load.client(load.come_and_go)
        load.client(scenes(load))
        with load.running():
            load.last(0.05 * run.seconds, lambda: True)
            daemon.process.send_signal(signal.SIGTERM)
            daemon.process.wait(PATIENCE_S)


def known_methods() -> set[str]:
    from hapticd.daemon.methods import _METHOD_HANDLERS

    return set(_METHOD_HANDLERS)


def overload(run: Run) -> None:
    """With others on its only processor."""
    text = head(run, realtime="off", rate_hz=10000, overruns={"threshold": 0.001, "action": "step_down"})
    with ExitStack() as stack:
        daemon = stack.enter_context(
            clean(run, text, "hapticd", "--runtime-dir", "RUNTIME", "run", "-c", "CONFIG", on_one_processor=True)
        )
        for _ in range(3):
            busy = subprocess.Popen(["taskset", "-c", str(daemon.processor), sys.executable, "-c", "while True: pass"])
            stack.callback(busy.wait)
            stack.callback(busy.kill)
        load = Load(daemon, run)
        for work in (scenes(load), commands(load), taps(load), load.listen, load.come_and_go):
            load.client(work)
        with load.running():
            load.last(0.1 * run.seconds, lambda: {"overload", "rate"} <= load.events)


def strikes(load: Load) -> Callable[[Client, random.Random], None]:
    """What the joystick plays by itself, if the forces are on."""

    def work(client: Client, dice: random.Random) -> None:
        load.call(client, "play", material="ringing", direction=[0, 1], amplitude_m_per_s2=dice.uniform(1, 40))
        load.over.wait(0.05)

    return work


def mishaps(load: Load, *, freezes: bool) -> Callable[[Client, random.Random], None]:
    """The joystick freezes, is unplugged, plugged in again and reset."""

    def work(client: Client, dice: random.Random) -> None:
        def happens(line: str, event: str) -> None:
            def happened() -> bool:
                load.call(client, "set_forces", enabled=True)
                return load.over.is_set() or event in load.events

            load.events.discard(event)
            load.daemon.tell(line)
            until(happened, load.daemon, every_s=0.2)

        # What happens before somebody listens is told to nobody.
        until(lambda: load.over.is_set() or bool(load.status), load.daemon)
        if freezes:
            happens("hold", "fault")
            load.daemon.tell("move")
        happens("unplug", "device_lost")
        happens("plug", "device_found")
        load.daemon.tell("reset")
        load.rounds += 1
        load.over.wait(1.0)

    return work


def stick(run: Run, *, led: bool) -> None:
    """A joystick, with `led` one that leads the ticks."""
    hid = {
        "travel_m": 0.05,
        "full_scale_force_n": 8.9,
        "signs": "trust",
        "offload": "off" if led else "auto",
        "max_rate_hz": 500,
    }
    device = {"kind": "hid", "effective_mass_kg": 0.05, "hid": hid, **({"frozen_after_s": 0.2} if led else {})}
    floor = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "ringing"}
    text = head(run, clock="device" if led else "timer", rate_hz=1000) + yaml.safe_dump(
        {"device": device, "scene": {"objects": {"floor": floor}}}
    )
    with clean(run, text, "tests.sanitized.stick", "RUNTIME", "CONFIG") as daemon:
        load = Load(daemon, run)
        for work in (load.listen, load.come_and_go, strikes(load), mishaps(load, freezes=led)):
            load.client(work)

        def enough() -> bool:
            connection = load.status.get("connection") or {}
            return load.rounds > 0 and (led or connection.get("strikes", 0) > 0)

        with load.running():
            load.last((0.1 if led else 0.2) * run.seconds, enough)


def defect(run: Run) -> None:
    """What is to be found must be found, in a daemon that runs, and end it otherwise than with 0."""
    daemon = Daemon(run, head(run), "tests.sanitized.stick", "RUNTIME", "CONFIG")
    try:
        with suppress(AssertionError):  # most end there
            daemon.tell("commit")
    finally:
        findings = daemon.findings(daemon.end())
    said = findings or "nothing"
    for words in run.sanitizer.says:
        assert words in said, f"{run.name} did not find the defect ({words}): {said}"


def main(name: str, launcher: Path, seconds: float) -> int:
    """Prints a line for each daemon; 0: all as it should be."""
    phases: dict[str, Callable[[Run], None]] = {
        "defect": defect,
        "sim": sim,
        "overload": overload,
        "stick": lambda run: stick(run, led=False),
        "led": lambda run: stick(run, led=True),
    }
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="hapticd-test-") as directory:
        run = Run(name, launcher.resolve(), seconds, Path(directory))
        for phase, work in phases.items():
            try:
                work(run)
            except AssertionError as error:
                traceback.print_exception(error)
                print(f"{name}-daemon: {phase}: failed", file=sys.stderr)
                return 1
            print(f"{name}-daemon: {phase}: {'found' if phase == 'defect' else 'clean'}", flush=True)
    print(f"{name}-daemon: ok, {time.monotonic() - began:.0f} s")
    return 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("name", choices=SANITIZERS)
    parser.add_argument("launcher", type=Path)
    parser.add_argument("--seconds", type=float, default=30.0)
    arguments = parser.parse_args()
    sys.exit(main(arguments.name, arguments.launcher, arguments.seconds))
