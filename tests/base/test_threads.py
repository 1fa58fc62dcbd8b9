"""A user's limit of processes leaves no room for threads: the result is one line, and libzmq does not abort."""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from hapticd.base import threads
from hapticd.base.errors import HapticdError
from tests.support.marks import rest_slow

NOBODY = 64321
"""A user without other processes. Root has no limit of processes."""
LEFT = "-all,+dac_override"
"""Capabilities to keep: only root may read the interpreter's files on some machines."""


def limited(limit: int, directory: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run a command as a user who may have `limit` processes and threads."""
    before: list[str] = []
    if os.geteuid() == 0:
        if shutil.which("setpriv") is None:
            pytest.skip("no setpriv to become another user with")
        for path in (directory, *directory.iterdir()):
            os.chown(path, NOBODY, NOBODY)
        before = ["setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups", f"--bounding-set={LEFT}"]
        before += [f"--inh-caps={LEFT}", f"--ambient-caps={LEFT}"]
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    return subprocess.run(
        [*before, sys.executable, "-m", "hapticd", "--runtime-dir", str(directory / "run"), *words],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NPROC, (limit, limit)),
        env=environment | {"PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.fixture
def folder() -> Iterator[Path]:
    """A folder that another user can enter."""
    with tempfile.TemporaryDirectory(prefix="ht-") as made:
        yield Path(made)


@pytest.mark.long
@pytest.mark.parametrize("limit", rest_slow([1, 4, 2, 3, 6, 9], fast=2))
def test_a_daemon_without_threads_does_not_start_and_reports_it(folder: Path, limit: int) -> None:
    done = limited(limit, folder, "run")
    line = done.stderr.splitlines()[-1]
    reason = f"the user's limit of {limit} processes and threads is reached (ulimit -u), or memory is short"
    assert (done.returncode, line) == (1, f"hapticd: the system refuses another thread: {reason}")
    assert "Traceback" not in done.stderr and "zmq" not in done.stderr and "thread.cpp" not in done.stderr
    assert not (folder / "run" / "hapticd.command").exists()


@pytest.mark.long
@pytest.mark.parametrize("words", [["status"], ["record", "a.npz"]])
def test_a_client_without_threads_is_one_line(folder: Path, words: list[str]) -> None:
    done = limited(2, folder, *(str(folder / word) if "." in word else word for word in words))
    assert done.returncode == 1
    assert done.stderr.startswith("hapticd: the system refuses another thread: ") and done.stderr.count("\n") == 1


@pytest.mark.long
def test_commands_that_need_no_thread_work(folder: Path) -> None:
    done = limited(1, folder, "simulate", "comb", "--for", "0.01s", "-o", str(folder / "a.npz"))
    assert (done.returncode, done.stderr) == (0, "")
    assert limited(1, folder, "stop-device").returncode == 0


def test_no_thread_is_left_over(monkeypatch: pytest.MonkeyPatch) -> None:
    before = threading.active_count()
    threads.check(5)
    start, left = threading.Thread.start, [3]

    def refuses(thread: threading.Thread) -> None:
        left[0] -= 1
        if left[0] < 0:
            raise RuntimeError(threads.THREAD_START_ERROR)
        start(thread)

    monkeypatch.setattr(threading.Thread, "start", refuses)
    with pytest.raises(HapticdError, match="the system refuses another thread"):
        threads.check(5)
    assert threading.active_count() == before
