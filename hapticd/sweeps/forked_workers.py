"""The fork server: the process that local workers are forked from, with dask, numpy and hapticd already imported.

Without it each worker would import these again, which takes longer than many studies.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from multiprocessing import forkserver, resource_tracker
from typing import Any, Final, cast

START_METHOD: Final = "forkserver"
"""The start method of multiprocessing for local workers."""
_PRELOADED_MODULES: Final = ("distributed.nanny", "hapticd.sweeps.preloaded")
"""Modules that the fork server imports."""
_ONE_THREAD_VARIABLES: Final = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
"""Environment variables that limit numerical libraries to one thread; dask sets them for its workers, too.

Dask's setting that makes malloc return memory at once is not used: it causes a thousand page faults for each point.
"""


def start_fork_server() -> None:
    """Start the fork server if it is not running. It imports its modules while this process continues.

    Ctrl-C at a terminal sends SIGINT to every process of the command. The fork server and its workers block it, since
    this process ends them.
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
