"""What the processes of workers have in common: they are forked from one process that has imported this module.

Without it each of them imports dask, numpy and hapticd again, which takes longer than many a study.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from multiprocessing import forkserver, resource_tracker
from typing import Any, Final, cast

START_METHOD: Final = "forkserver"
_PRELOADED_MODULES: Final = ("distributed.nanny", "hapticd.sweeps.preloaded")
_ONE_THREAD_VARIABLES: Final = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
"""What dask sets for workers too. Its setting of malloc, to give memory back at once, is left out: the arrays of every
point would then be a thousand page faults."""


def start_fork_server() -> None:
    """Starts that process, if it does not run yet; it imports while this one goes on.

    Ctrl-C at a terminal reaches every process of the command. Workers block it: this process ends them.
    """
    for name in _ONE_THREAD_VARIABLES:
        os.environ.setdefault(name, "1")
    cast("Any", multiprocessing.get_context(START_METHOD)).set_forkserver_preload(list(_PRELOADED_MODULES))
    # The tracker would otherwise be started by the server's start, and would unblock the signal.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        forkserver.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
