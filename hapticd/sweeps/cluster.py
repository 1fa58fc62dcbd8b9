"""Where a study is computed: processes or threads of this machine, or the workers of a scheduler that runs."""

from __future__ import annotations

import asyncio
import importlib.util
import logging
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

from hapticd.base.errors import HapticdError, on_one_line
from hapticd.sweeps.forked_workers import START_METHOD, start_fork_server
from hapticd.sweeps.interrupts import deferred_interrupts

SCHEDULER_TIMEOUT_S: Final = 10.0
WORKERS_START_TIMEOUT_S: Final = 120.0
"""For the processes of all workers to start, on a machine that is busy."""
WORKER_END_TIMEOUT_S: Final = 1.0
"""For a worker to end, before it is killed."""
_LOCAL_ADDRESS: Final = "127.0.0.1:0"
"""A free port that this machine alone can reach."""
_MONITORING_SETTINGS: Final = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "500ms",
    "distributed.admin.system-monitor.interval": "5s",
}
"""Dask observes its own processes: with two workers this takes 11 % of a processor by default, and 3 % like this. The
dashboard's profiles are empty then."""


def require_dask() -> None:
    """Raises HapticdError (one line) where dask is missing."""
    # It is not imported here: that takes as long as the start of the process that workers are forked from, which is
    # started first.
    if importlib.util.find_spec("distributed") is None:
        raise HapticdError("sweeps need dask: pip install 'hapticd[cluster]'")


def processors() -> int:
    """Those that this process may use."""
    return len(os.sched_getaffinity(0))


@contextmanager
def client_of(scheduler: str | None, workers: int | None, threads: bool) -> Iterator[Any]:
    """A `distributed.Client`: of the scheduler at an address, or of as many processes as there are processors, or
    `workers` of them; with `threads` of threads of this process, which open no port.

    Processes listen on 127.0.0.1 alone. TLS of a scheduler is that of dask's own configuration. Raises HapticdError.
    """
    require_dask()
    count = processors() if workers is None else workers
    if scheduler is None and not threads:
        start_fork_server()  # imports while this process does
    import distributed  # noqa: F401

    # What goes wrong is told in our words, by whoever uses the client.
    for name in ("distributed", "distributed.client"):  # dask sets the level of each
        logging.getLogger(name).setLevel(logging.CRITICAL)
    if scheduler is not None:
        with _reached(scheduler) as client:
            yield client
    elif threads:
        with _threads(count) as client:
            yield client
    else:
        with _processes(count) as client:
            yield client


@contextmanager
def _reached(scheduler: str) -> Iterator[Any]:
    from distributed import Client

    try:
        # First by itself: a client that could not connect would try again when it is thrown away.
        found = asyncio.run(_kind_of(scheduler))
        if found != "Scheduler":
            raise HapticdError(f"{scheduler}: is no scheduler, but a {found.lower()}")
        client = Client(scheduler, timeout=SCHEDULER_TIMEOUT_S, set_as_default=False)
    except OSError as error:
        why = f": {on_one_line(str(error))}" if str(error) else ""
        raise HapticdError(f"{scheduler}: no scheduler answers there within {SCHEDULER_TIMEOUT_S:g} s{why}") from None
    except (ValueError, TypeError, RuntimeError) as error:
        raise HapticdError(f"{scheduler}: cannot be used: {on_one_line(str(error))}") from None
    try:
        yield client
    finally:
        with deferred_interrupts():
            client.close()


async def _kind_of(address: str) -> str:
    """What answers at an address: Scheduler, Worker, Nanny. Raises OSError where nothing does within SCHEDULER_TIMEOUT_S."""
    from distributed import Security
    from distributed.comm.core import connect

    comm = await connect(address, timeout=SCHEDULER_TIMEOUT_S, **Security().get_connection_args("client"))
    try:
        async with asyncio.timeout(SCHEDULER_TIMEOUT_S):
            await comm.write({"op": "identity"})
            answer = await comm.read()
    finally:
        comm.abort()
    return str(answer["type"]) if isinstance(answer, dict) and "type" in answer else "server of another kind"


@contextmanager
def _threads(count: int) -> Iterator[Any]:
    import dask
    from distributed import Client, LocalCluster

    cluster = client = None
    try:
        with deferred_interrupts(), dask.config.set(_MONITORING_SETTINGS), warnings.catch_warnings():
            # Dask asks for an address even for threads of one process. A machine without a network has none.
            warnings.filterwarnings("ignore", "Couldn't detect a suitable IP address", RuntimeWarning)
            cluster = LocalCluster(
                n_workers=1,
                threads_per_worker=count,
                processes=False,
                dashboard_address=_LOCAL_ADDRESS,
                worker_dashboard_address=_LOCAL_ADDRESS,
                silence_logs=logging.CRITICAL,
            )
            client = Client(cluster, set_as_default=False)
            cluster.sync(_without_listeners, cluster)
        yield client
    finally:
        with deferred_interrupts():
            for each in (client, cluster):
                if each is not None:
                    each.close()


async def _without_listeners(cluster: Any) -> None:
    """Dask has an HTTP server for the scheduler and one for each worker, whether a dashboard is wanted or not."""
    for each in (cluster.scheduler, *cluster.workers.values()):
        each.http_server.stop()


@contextmanager
def _processes(count: int) -> Iterator[Any]:
    import dask
    import distributed.utils
    from distributed import Client, LocalCluster

    # Dask would import pandas here, for a fork server of its own.
    distributed.utils._forkserver_preload_set = True
    cluster = client = adaptive = None
    with dask.config.set({"distributed.worker.multiprocessing-method": START_METHOD, **_MONITORING_SETTINGS}):
        try:
            with deferred_interrupts():
                cluster = LocalCluster(
                    n_workers=0,
                    threads_per_worker=1,
                    memory_limit=1.0 / count,  # of what there is
                    host="127.0.0.1",
                    dashboard_address=_LOCAL_ADDRESS,
                    silence_logs=logging.CRITICAL,
                )
                client = Client(cluster, set_as_default=False)
                cluster.scale(count)
                # A process that ends while it starts is given up for good otherwise.
                adaptive = cluster.adapt(minimum=count, maximum=count)
            try:
                client.wait_for_workers(count, timeout=WORKERS_START_TIMEOUT_S)
            except TimeoutError:
                raise HapticdError(
                    f"{count} processes of workers did not start within {WORKERS_START_TIMEOUT_S:g} s"
                ) from None
            yield client
        finally:
            with deferred_interrupts():
                if client is not None:
                    client.close()
                if adaptive is not None:
                    adaptive.stop()
                if cluster is not None:
                    cluster.sync(_end_workers, cluster)
                    cluster.close()


async def _end_workers(cluster: Any) -> None:
    """They hold nothing that is needed: after WORKER_END_TIMEOUT_S they are killed, where dask gives them four seconds."""
    await asyncio.gather(*(each.close(timeout=WORKER_END_TIMEOUT_S / 0.8) for each in cluster.workers.values()))
