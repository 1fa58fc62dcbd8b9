"""Daemon and page server with the system calls that their units leave them, and no others: as systemd would have the
kernel refuse the rest."""

from __future__ import annotations

import asyncio
import ctypes
import errno
import functools
import platform
import re
import shutil
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from hapticd.client.blocking import connect
from tests.support.daemon_process import PATIENCE_S, running_daemon
from tests.web.served import asked

ROOT = Path(__file__).parents[2]
NUMBERS = Path("/usr/include/x86_64-linux-gnu/asm/unistd_64.h")
NO_NEW_PRIVS, SET_SECCOMP, FILTER = 38, 22, 2
ALLOW, ERRNO = 0x7FFF0000, 0x00050000
LOAD, EQUAL, RETURN = 0x20, 0x15, 0x06
SET_SCHEDULER = 144
ALWAYS = {"execve", "exit", "exit_group", "getrlimit", "rt_sigreturn", "sigreturn"}
"""What systemd.exec(5) says is allowed in any case."""

pytestmark = pytest.mark.skipif(
    platform.machine() != "x86_64" or not NUMBERS.exists() or shutil.which("systemd-analyze") is None,
    reason="needs an x86_64, the kernel's headers and systemd-analyze",
)


@functools.cache
def members(name: str) -> frozenset[str]:
    """System calls of a name: one, or a set of systemd's."""
    if not name.startswith("@"):
        return frozenset({name})
    words = ["systemd-analyze", "syscall-filter", name]
    said = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    lines = [line.strip() for line in said.splitlines()[1:]]
    return frozenset().union(*(members(line) for line in lines if line and not line.startswith("#")))


def allowed(unit: str) -> set[str]:
    """What the lines of a unit leave, in their order."""
    left = set(ALWAYS)
    for line in re.findall(r"^SystemCallFilter=(.*)$", (ROOT / "systemd" / unit).read_text(), re.MULTILINE):
        named = set().union(*(members(word) for word in line.removeprefix("~").split()))
        left = left - named if line.startswith("~") else left | named
    return left


def filter_of(names: set[str], realtime: bool) -> bytes:
    """A program for the kernel: these, and EPERM for the rest. Without real time, as RestrictRealtime says, no other
    policy than SCHED_OTHER, SCHED_BATCH and SCHED_IDLE may be set."""
    numbers = dict(re.findall(r"#define __NR_(\w+) (\d+)", NUMBERS.read_text()))

    def step(code: int, yes: int, no: int, value: int) -> bytes:
        return struct.pack("=HBBI", code, yes, no, value)

    steps = [step(LOAD, 0, 0, 0)]
    if not realtime:
        # The second argument; whatever the policy, the number of the call is loaded again.
        steps += [step(EQUAL, 0, 6, SET_SCHEDULER), step(LOAD, 0, 0, 24)]
        steps += [step(EQUAL, 3 - place, 0, policy) for place, policy in enumerate((0, 3, 5))]
        steps += [step(RETURN, 0, 0, ERRNO | errno.EPERM), step(LOAD, 0, 0, 0)]
    for name in sorted(names & numbers.keys()):
        steps += [step(EQUAL, 0, 1, int(numbers[name])), step(RETURN, 0, 0, ALLOW)]
    return b"".join([*steps, step(RETURN, 0, 0, ERRNO | errno.EPERM)])


def restricted(unit: str) -> Callable[[], None]:
    """What a process does before it becomes the service of a unit."""
    realtime = "RestrictRealtime=yes" not in (ROOT / "systemd" / unit).read_text()
    program = filter_of(allowed(unit), realtime)
    libc = ctypes.CDLL(None, use_errno=True)
    steps = ctypes.create_string_buffer(program, len(program))
    # struct sock_fprog: a count, and where they are.
    told = ctypes.create_string_buffer(struct.pack("@HP", len(program) // 8, ctypes.addressof(steps)))

    def restrict() -> None:
        if libc.prctl(NO_NEW_PRIVS, 1, 0, 0, 0) or libc.prctl(SET_SECCOMP, FILTER, told, 0, 0):
            raise OSError(ctypes.get_errno(), "the kernel takes no filter")
        assert steps

    return restrict


@contextmanager
def service(unit: str, ready: str, *words: str) -> Iterator[re.Match[str]]:
    """The service of a unit with these arguments, as soon as it is ready; afterwards stopped, which must go well."""
    process = subprocess.Popen(
        [sys.executable, "-m", "hapticd", *words],
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=restricted(unit),
    )
    assert process.stderr is not None
    said: list[str] = []
    try:
        for line in process.stderr:
            said.append(line)
            if match := re.search(ready, line):
                yield match
                break
        else:
            raise AssertionError(f"it ended with {process.wait()}: {said}")
    finally:
        process.terminate()
        rest = process.stderr.read()
        process.stderr.close()
        code = process.wait(PATIENCE_S)
    assert code == 0, (said, rest)


@pytest.mark.long
def test_a_filter_refuses() -> None:
    """Or nothing below would say anything."""
    code = "import os\ntry: os.chroot('/')\nexcept PermissionError: print('refused')"
    for unit in ("hapticd.service", "hapticd-web.service"):
        done = subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            preexec_fn=restricted(unit),
            timeout=PATIENCE_S,
        )
        assert done.stdout == "refused\n", done.stderr
    code = (
        "import os\ntry: os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))\nexcept OSError: print('refused')\n"
        "os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0)); print('taken')"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        preexec_fn=restricted("hapticd-web.service"),
        timeout=PATIENCE_S,
    )
    assert done.stdout == "refused\ntaken\n", done.stderr


@pytest.mark.long
def test_the_daemon(tmp_path: Path) -> None:
    with (
        service("hapticd.service", "ready: sim", "--runtime-dir", str(tmp_path / "run"), "run"),
        connect(tmp_path / "run", timeout_s=PATIENCE_S) as client,
    ):
        client.set_scene({"objects": {}}, wait=True)
        client.set_forces(False)
        with client.states() as states:
            next(states)


@pytest.mark.long
def test_the_page_server() -> None:
    """It lets somebody in, passes a call on, and ends."""
    with running_daemon() as daemon:
        process = subprocess.Popen(
            [sys.executable, "-m", "hapticd", "--runtime-dir", str(daemon.directory), "web", "--port", "0"],
            stdout=subprocess.PIPE,
            text=True,
            preexec_fn=restricted("hapticd-web.service"),
        )
        assert process.stdout is not None
        try:
            address = process.stdout.readline().strip()
            assert asyncio.run(asked(address, "get_status"))["result"]["protocol"] == 1
        finally:
            process.terminate()
            process.stdout.close()
            assert process.wait(PATIENCE_S) == 0
