"""What a worker is sent: a piece, packed, and the function that unpacks and computes it.

A worker that cannot read what it is sent ends, as dask has it, and takes the piece of another one along. So the
function names nothing of hapticd, and every worker can read it; one without hapticd, or with another, answers so.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, TypeAlias

from hapticd.sweeps.columns import Row
from hapticd.sweeps.work import Piece

Refusal: TypeAlias = tuple[str, str]
"""The address of a worker that cannot compute the piece, and why."""
Answer: TypeAlias = "tuple[list[Row], float] | Refusal"
"""The rows and how long they took, s; or a refusal."""


def packed(piece: Piece) -> bytes:
    """A piece as bytes, which nobody on its way reads."""
    from distributed.protocol.pickle import dumps

    found: bytes = dumps(piece)
    return found


def _task() -> Callable[[bytes, str], Answer]:
    # Within a function, so that it is sent as code and not as a name of this module.
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
