"""Dask clients of a study: local processes, local threads, or the workers of a running scheduler."""

from __future__ import annotations

import asyncio
import importlib.util
import logging
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

from hapticd.base.errors import HapticdError, collapse_whitespace
from hapticd.sweeps.forked_workers import START_METHOD, start_fork_server
from hapticd.sweeps.interrupts import deferred_interrupts
from hapticd.system.extras import install_command

SCHEDULER_TIMEOUT_S: Final = 10.0
WORKERS_START_TIMEOUT_S: Final = 120.0
"""Time in s within which all local worker processes must start, also on a busy machine."""
WORKER_END_TIMEOUT_S: Final = 1.0
"""Time in s that a worker gets to end before it is killed."""
_LOCAL_ADDRESS: Final = "127.0.0.1:0"
"""An address that only this machine can reach; port 0 stands for any free port."""
_MONITORING_SETTINGS: Final = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "500ms",
    "distributed.admin.system-monitor.interval": "5s",
}
"""Settings of dask that reduce the monitoring of its processes.

With two workers, monitoring takes 11 % of a core by default, and 3 % with these settings. The dashboard then shows no
profiles.
"""


def require_dask() -> None:
    """Raise HapticdError (one line) if dask is missing."""
    # Dask is not imported here, since its import takes as long as the start of the fork server, which is started first.
    if importlib.util.find_spec("distributed") is None:
        raise HapticdError(f"sweeps need dask: {install_command('cluster')}")


def processors() -> int:
    """Return the number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0))


@contextmanager
def client_of(scheduler: str | None, workers: int | None, threads: bool) -> Iterator[Any]:
    """Open a `distributed.Client` and close it at the end of the context.

    Args:
        scheduler: Address of a running scheduler. TLS is configured in dask's own configuration.
        workers: Number of local processes or threads, by default the number of processors.
        threads: Use threads of this process, which open no port, instead of processes, which listen on 127.0.0.1.

    Raises HapticdError if the scheduler cannot be used, or local processes do not start.
    """
    require_dask()
    count = processors() if workers is None else workers
    if scheduler is None and not threads:
        start_fork_server()  # first, so that it imports its modules while this process imports dask
    import distributed  # noqa: F401

    # Users of the client report errors themselves, so dask's logs are silenced.
    for name in ("distributed", "distributed.client"):  # dask sets the levels of both
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
        # Checked without a client: a client that fails to connect tries again when it is deleted.
        found = asyncio.run(_kind_of(scheduler))
        if found != "Scheduler":
            raise HapticdError(f"{scheduler}: not a dask scheduler, but a {found.lower()}")
        client = Client(scheduler, timeout=SCHEDULER_TIMEOUT_S, set_as_default=False)
    except OSError as error:
        why = f": {collapse_whitespace(str(error))}" if str(error) else ""
        raise HapticdError(f"{scheduler}: no scheduler answers within {SCHEDULER_TIMEOUT_S:g} s{why}") from None
    except (ValueError, TypeError, RuntimeError) as error:
        raise HapticdError(f"{scheduler}: cannot be used: {collapse_whitespace(str(error))}") from None
    try:
        yield client
    finally:
        with deferred_interrupts():
            client.close()


async def _kind_of(address: str) -> str:
    """Return the kind of dask server at an address: Scheduler, Worker or Nanny.

    Raises OSError if there is no answer within SCHEDULER_TIMEOUT_S.
    """
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
            # Dask looks up an IP address even for threads of one process. A machine without a network has none.
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
    """Stop the HTTP servers of scheduler and workers, which dask starts even without a dashboard."""
    for each in (cluster.scheduler, *cluster.workers.values()):
        each.http_server.stop()


@contextmanager
def _processes(count: int) -> Iterator[Any]:
    import dask
    import distributed.utils
    from distributed import Client, LocalCluster

    # Prevents dask from preloading pandas and other modules into a fork server.
    distributed.utils._forkserver_preload_set = True
    cluster = client = adaptive = None
    with dask.config.set({"distributed.worker.multiprocessing-method": START_METHOD, **_MONITORING_SETTINGS}):
        try:
            with deferred_interrupts():
                cluster = LocalCluster(
                    n_workers=0,
                    threads_per_worker=1,
                    memory_limit=1.0 / count,  # as a fraction of the memory of the machine
                    host="127.0.0.1",
                    dashboard_address=_LOCAL_ADDRESS,
                    silence_logs=logging.CRITICAL,
                )
                client = Client(cluster, set_as_default=False)
                cluster.scale(count)
                # Without this, a process that ends during its start is never replaced.
                adaptive = cluster.adapt(minimum=count, maximum=count)
            try:
                client.wait_for_workers(count, timeout=WORKERS_START_TIMEOUT_S)
            except TimeoutError:
                raise HapticdError(
                    f"{count} worker processes did not start within {WORKERS_START_TIMEOUT_S:g} s"
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
    """End the workers, and kill those that still run after WORKER_END_TIMEOUT_S; dask would wait four seconds."""
    await asyncio.gather(*(each.close(timeout=WORKER_END_TIMEOUT_S / 0.8) for each in cluster.workers.values()))
