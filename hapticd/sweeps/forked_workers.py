"""The fork server: a process with dask, numpy and hapticd imported, from which local workers are forked.

Without it each worker would import these packages, which takes longer than many studies.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from multiprocessing import forkserver, resource_tracker
from typing import Any, Final, cast

START_METHOD: Final = "forkserver"
"""Start method of multiprocessing with which local workers are created."""
_PRELOADED_MODULES: Final = ("distributed.nanny", "hapticd.sweeps.preloaded")
"""Modules that the fork server imports."""
_ONE_THREAD_VARIABLES: Final = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
"""Environment variables that limit numerical libraries to one thread; dask also sets them for its workers.

Dask also sets MALLOC_TRIM_THRESHOLD_, which is not set here: it causes a thousand page faults for each point.
"""


def start_fork_server() -> None:
    """Start the fork server if it is not running. The server imports its modules while this process continues.

    Ctrl-C sends SIGINT to this process, the server and the workers. Server and workers block SIGINT, since this process
    ends them.
    """
    for name in _ONE_THREAD_VARIABLES:
        os.environ.setdefault(name, "1")
    cast("Any", multiprocessing.get_context(START_METHOD)).set_forkserver_preload(list(_PRELOADED_MODULES))
    # Started here because starting it together with the fork server would unblock the signal.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        forkserver.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
