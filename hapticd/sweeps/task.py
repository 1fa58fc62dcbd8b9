"""The function that a worker runs on a piece (a group of points). The worker gets the piece as pickled bytes.

Dask ends a worker that cannot unpickle its task, and may then lose pieces of other workers. So the task is code that
every worker can run, and this code unpickles the piece. A worker without hapticd, or with another version, returns a
refusal.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, TypeAlias

from hapticd.sweeps.columns import Row
from hapticd.sweeps.work import Piece

Refusal: TypeAlias = tuple[str, str]
"""Address of a worker that cannot compute its piece (a group of points), and the reason."""
Answer: TypeAlias = "tuple[list[Row], float] | Refusal"
"""The rows of a piece and their computing time in s, or a refusal by the worker."""


def pickled(piece: Piece) -> bytes:
    """Return a piece (a group of points) as bytes, which the scheduler forwards without unpickling."""
    from distributed.protocol.pickle import dumps

    found: bytes = dumps(piece)
    return found


def _task() -> Callable[[bytes, str], Answer]:
    # A nested function is pickled as code; a function of a module would be pickled as its name.
    def computed(content: bytes, version: str) -> Answer:
        from pickle import loads
        from time import perf_counter

        from distributed import get_worker

        try:
            from hapticd.sweeps.worker_check import code_version

            own = code_version()
            if own != version:
                return get_worker().address, f"it runs hapticd {own}, this study needs {version}"
            piece: Any = loads(content)
            begin = perf_counter()
            rows = piece.rows()
        except ModuleNotFoundError as error:
            return get_worker().address, f"{type(error).__name__}: {error}"
        return rows, perf_counter() - begin

    return computed


task: Final = _task()
