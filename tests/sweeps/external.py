"""A dask scheduler and its workers in separate processes, as a shell script starts them."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from hapticd.sweeps.cluster import client_of
from tests.support.daemon_process import PATIENCE_S

ROOT = Path(__file__).parents[2]
_QUIET = ["--host", "127.0.0.1", "--no-dashboard"]
WORKER = [
    sys.executable,
    "-m",
    "distributed.cli.dask_worker",
    "--nworkers",
    "1",
    "--nthreads",
    "1",
    "--no-nanny",
    *_QUIET,
]


def _worker_after(program: str) -> list[str]:
    return [sys.executable, "-c", f"{program}; from distributed.cli.dask_worker import main; main()", *WORKER[3:]]


OTHER_VERSION = _worker_after(
    "import hapticd.sweeps.worker_check as check; check.code_version = lambda: '9.9.9 (other)'"
)
WITHOUT_HAPTICD = _worker_after(
    f"import sys; sys.path[:] = [each for each in sys.path if each not in ('', {str(ROOT)!r})]"
)


class External:
    """A running scheduler and its workers."""

    def __init__(self, stack: ExitStack, protocol: str, settings: Mapping[str, str]) -> None:
        self._stack = stack
        self._environment = {**os.environ, "PYTHONPATH": str(ROOT), **settings}
        words = ["-m", "distributed.cli.dask_scheduler", "--port", "0", "--protocol", protocol, *_QUIET]
        self.process = self._start([sys.executable, *words], subprocess.PIPE)
        assert self.process.stderr is not None
        where = re.compile(rf"{protocol}://127.0.0.1:\d+")
        self.address = next(found[0] for line in self.process.stderr if (found := where.search(line)))
        self.workers: list[subprocess.Popen[str]] = []

    def add(self, program: list[str]) -> subprocess.Popen[str]:
        """Start another worker."""
        self.workers.append(self._start([*program, self.address], subprocess.DEVNULL))
        return self.workers[-1]

    def _start(self, words: list[str], errors: int) -> subprocess.Popen[str]:
        process = self._stack.enter_context(
            subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=errors, text=True, env=self._environment)
        )
        self._stack.callback(process.kill)
        return process


@contextmanager
def scheduler(
    *workers: list[str], protocol: str = "tcp", settings: Mapping[str, str] | None = None
) -> Iterator[External]:
    """Yield a scheduler with these workers; `settings` are environment variables of all processes."""
    with ExitStack() as stack:
        found = External(stack, protocol, settings or {})
        for program in workers:
            found.add(program)
        yield found


@contextmanager
def connected(address: str, workers: int) -> Iterator[Any]:
    """Yield a client of a scheduler after `workers` workers have joined."""
    with client_of(address, None, False) as client:
        client.wait_for_workers(workers, timeout=PATIENCE_S)
        yield client
