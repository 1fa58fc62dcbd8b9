"""The daemon's process: configuration, runtime directory, threads, signals.

    main thread      waits for a signal: has the configuration reloaded, or takes everything down in order
    command thread   dispatch.py: answers requests, makes changes, beats
    telemetry thread hapticd.telemetry: drains the rings, publishes
    flight thread    flight_recorder.py: writes what was kept of that to a file, after a fault
    servo thread     csrc/servo/hd_servo_thread.c: owns time and force

The command socket is bound last, so that its existence means ready. Whatever ends the daemon, the force fades to zero
first.
"""

from __future__ import annotations

import gc
import logging
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from time import monotonic_ns
from typing import Final

from hapticd.base import memory, threads, wording
from hapticd.base.core import lib
from hapticd.base.errors import HapticdError
from hapticd.base.model import MAX_FAULTS
from hapticd.config.configuration import Config, chosen_config
from hapticd.config.locations import ConfigFiles, choose
from hapticd.daemon.counters import Granted
from hapticd.daemon.dispatch import Dispatch, serve
from hapticd.daemon.engine import Engine
from hapticd.daemon.flight_recorder import Flight, directory_of
from hapticd.daemon.flight_scene import FlightScene
from hapticd.daemon.methods import Methods
from hapticd.daemon.publisher import LIMITS as TELEMETRY_LIMITS
from hapticd.daemon.publisher import Publisher
from hapticd.daemon.router import LIMITS as COMMAND_LIMITS
from hapticd.daemon.router import Router
from hapticd.daemon.telemetry import TOPICS, Telemetry
from hapticd.hid.stopper import StopFile, stop_device
from hapticd.protocol.events import fault_names
from hapticd.system import journal, notify, open_files
from hapticd.system.paths import Owned, owned, runtime_paths

SWITCH_S: Final = 0.0005
"""A thread that computes in the interpreter gives it to another one after so long, instead of 5 ms. The thread that
serves commands waits for it after each system call."""

MOST_NAMED: Final = 3
"""Surfaces whose margin the log names at the start, the lowest first."""

_SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)

_log = logging.getLogger("hapticd")


def run(
    config_paths: Sequence[str | os.PathLike[str]] = (),
    runtime_dir: str | os.PathLike[str] | None = None,
    log_level: str = "info",
) -> int:
    """Runs the daemon until SIGTERM or SIGINT; returns its exit code.

    SIGHUP reloads the configuration, but ends a daemon that was started on a terminal, which has closed then.

    `config_paths` are merged in order; without one, the configuration is looked for (config_files). A reload reads the
    same files again; where none was found, it looks again. `log_level`: one of LOG_LEVELS. Raises HapticdError (one
    line) where the daemon cannot start: bad configuration, another daemon on the directory, real time required and
    refused.
    """
    with ExitStack() as stack:
        memory.settle()
        stack.callback(sys.setswitchinterval, sys.getswitchinterval())
        sys.setswitchinterval(SWITCH_S)
        connections = open_files.raise_descriptor_limit()
        stack.enter_context(journal.attached(log_level))
        stack.push(_log_end)
        chosen = choose(config_paths)
        config = chosen_config(chosen)
        stack.callback(os.umask, os.umask(0o007))
        signals = stack.enter_context(_signals())
        mine = stack.enter_context(owned(runtime_paths(runtime_dir)))
        lib.hd_last_report_arm()
        return _run(config, chosen, mine, signals, stack, connections)


def _run(
    config: Config, chosen: ConfigFiles, mine: Owned, signals: socket.socket, stack: ExitStack, connections: int
) -> int:
    paths = mine.paths
    stop_file = StopFile(paths.device)
    _stop_what_was_left(stop_file.path)
    engine = Engine(config, stop_file)
    flight = Flight(
        directory_of(config.flight.directory, paths.directory),
        config.flight.seconds,
        config.flight.keep,
        engine.rate_hz,
        monotonic_ns,
        FlightScene(engine.scene, engine.materials, engine.revision, engine.rate_hz),
        lambda: _about(engine, methods),
    )
    methods = Methods(
        engine, lambda: chosen_config(chosen if chosen.files else choose()), flight, lambda: telemetry.state()
    )
    threads.check(threads.DAEMON_THREADS)
    publisher = Publisher(mine.listen(paths.telemetry), TOPICS, TELEMETRY_LIMITS.of(connections))
    # Long enough for the last samples, which say that the force is zero, to reach those who read.
    stack.callback(publisher.close, linger_s=0.2)
    failures: list[BaseException] = []
    telemetry = Telemetry(engine, publisher, methods.status, flight)
    # Taken down in reverse: commands end, the force fades, telemetry tells of it, and what is to be written is.
    _thread("flight", flight.run, failures, stack, wake=flight.wake)
    _thread("telemetry", telemetry.run, failures, stack, wake=telemetry.wake)
    granted = engine.start()
    stack.callback(engine.stop)
    _log_limits(engine, granted, chosen)
    router = Router(mine.listen(paths.command), COMMAND_LIMITS.of(connections))
    stack.callback(router.close)
    watch = notify.Watch(lambda: _progress(engine))
    dispatch = Dispatch(methods, methods.repeats, router.wake)

    def between() -> None:
        watch()
        mine.check()

    _thread(
        "command",
        lambda stop: serve(router, engine, dispatch, stop, between),
        failures,
        stack,
        wake=router.wake,
    )
    # What garbage there is by now is little; to look for it would hold up the first answer.
    gc.freeze()
    gc.enable()
    _log_ready(engine, granted, paths.command)
    notify.ready(_progress(engine)[1])
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)
    ended = _await_end(signals, dispatch)
    notify.stopping()
    if failures:
        _log.error("a thread failed: %s: %s", type(failures[0]).__name__, failures[0])
        return 1
    _log.info("%s: stopping", ended.name)
    mine.remove(paths.command)
    return 0


def _log_limits(engine: Engine, granted: Granted, chosen: ConfigFiles) -> None:
    """What was not granted, and what of the scene is not displayed as it was meant."""
    _log.info("configuration: %s", chosen)
    for missing in granted.missing:
        _log.warning("not granted: %s", missing)
    undisplayable, warnings = engine.limits()
    for problem in (*undisplayable[:MAX_FAULTS], *warnings[:MAX_FAULTS]):
        _log.warning("%s", problem)
    low = [(margin, id) for id, margin in (engine.margins() or {}).items() if margin is not None and margin < 1.0]
    if low:
        worst = wording.listed([f"{id} {margin:.2g}" for margin, id in sorted(low)[:MOST_NAMED]])
        surfaces = wording.count(len(low), "surface")
        _log.warning("%s with a margin of stability below 1: %s; `hapticd check` says more", surfaces, worst)


def _log_ready(engine: Engine, granted: Granted, command: Path) -> None:
    if engine.connection is not None:
        found = engine.connection.status()
        _log.info("device: %s at %s; forces are off until somebody turns them on", found["name"], found["path"])
    _log.info(
        "ready: %s at %s, %s%s, commands at %s",
        engine.config.device.kind,
        wording.si(engine.config.servo.rate_hz, "Hz"),
        f"SCHED_FIFO {granted.priority}" if granted.priority else "no real-time priority",
        f", memory locked: {granted.memory}",
        command,
    )


def _await_end(signals: socket.socket, dispatch: Dispatch) -> signal.Signals:
    """The signal that ends the daemon; others have the configuration reloaded."""
    # Asked now: the terminal may have closed since the start.
    ends = {signal.SIGTERM, signal.SIGINT} | ({signal.SIGHUP} if _on_terminal() else set())
    # Of signals that came together the end overtakes the reloads.
    while not ends.intersection(received := signals.recv(4096)):
        dispatch.ask_reload()
    return signal.Signals(next(number for number in received if number in ends))


def _log_end(kind: type[BaseException] | None, *_: object) -> None:
    """The last line of the log, once everything is down; an error has its own line."""
    if kind is None:
        _log.info("stopped")


def _on_terminal() -> bool:
    return sys.stdin is not None and not sys.stdin.closed and sys.stdin.isatty()


def _about(engine: Engine, methods: Methods) -> dict[str, object]:
    """What goes into a file of the flight recorder beside the telemetry and what that was rendered with."""
    config = engine.config
    return {
        "config": {"servo": config.servo.to_dict(), "device": config.device.to_dict()},
        "status": methods.status(),
    }


def _stop_what_was_left(record: Path) -> None:
    """A daemon that was killed, without a systemd that runs `hapticd stop-device`, left its device as it was."""
    try:
        done = stop_device(record)
    except HapticdError as error:
        _log.warning("the daemon before: %s", error)
    else:
        if done is not None:
            _log.warning("the daemon before: %s", done)


def _progress(engine: Engine) -> tuple[int, str]:
    """Ticks so far, and how the daemon is in one line."""
    counters = engine.counters()
    connection = None if engine.connection is None else engine.connection.status()
    device = engine.config.device.kind if connection is None else connection["name"] or "device lost"
    forces = "on" if counters.forces_on else "off"
    if counters.faults:
        forces = f"off by fault: {', '.join(fault_names(counters.faults))}"
    return (
        counters.ticks,
        f"{device} at {wording.si(engine.rate_hz, 'Hz')}; scene revision {engine.revision}; forces {forces}",
    )


def _thread(
    name: str,
    work: Callable[[threading.Event], None],
    failures: list[BaseException],
    stack: ExitStack,
    wake: Callable[[], None] | None = None,
) -> None:
    """A thread that takes the daemon down if it fails, and is ended and joined when the stack unwinds.

    `wake`: has it look at its event, where it waits for something else.
    """
    stop = threading.Event()

    def guarded() -> None:
        try:
            work(stop)
        except BaseException as error:
            _log.exception("the %s thread failed", name)
            failures.append(error)
            os.kill(os.getpid(), signal.SIGTERM)

    thread = threading.Thread(target=guarded, name=name)
    thread.start()
    stack.callback(thread.join)
    if wake is not None:
        stack.callback(wake)
    stack.callback(stop.set)


@contextmanager
def _signals() -> Iterator[socket.socket]:
    """A socket from which the number of a signal can be read, whichever thread the kernel chose for it.

    Libraries may have threads, too, so blocking and sigwait would not be enough. Threads that are started
    while the context lasts inherit the block, so that no handler ever runs in the servo's.
    """
    ours, pythons = socket.socketpair()
    with ours, pythons:
        pythons.setblocking(False)
        signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
        before = [signal.signal(number, lambda *_: None) for number in _SIGNALS]
        fd = signal.set_wakeup_fd(pythons.fileno())
        try:
            yield ours
        finally:
            signal.set_wakeup_fd(fd)
            for number, handler in zip(_SIGNALS, before, strict=True):
                signal.signal(number, handler)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)
