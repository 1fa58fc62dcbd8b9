"""The results of sweeps in a folder: pieces as Parquet, each written whole, and what belongs to the study.

    lock                  locked by the process that writes
    study.json            title, columns, the study itself, seed and versions
    points.npy            (n,) the identities of the study's points
    pieces/HASH.parquet   rows, sorted by point; HASH is that of the points' identities

Two studies in one folder share the points that compute the same.
"""

from __future__ import annotations

import fcntl
import io
import json
import os
import platform
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from hapticd.base.errors import HapticdError
from hapticd.base.files import check_regular, write_whole
from hapticd.sweeps.columns import ERROR_COLUMN, POINT_COLUMN, Column, Row, Value
from hapticd.sweeps.work import ID_DTYPE, Work
from hapticd.sweeps.worker_check import code_version

STUDY_FILE: Final = "study.json"
POINTS_FILE: Final = "points.npy"
PIECES_FOLDER: Final = "pieces"
_ROWS_IN_MEMORY: Final = 500
"""Rows that are objects of Python at once, where all are visited."""
LOCK_FILE: Final = "lock"
_PARTIAL_PIECE: Final = re.compile(r"\.[0-9a-f]{32}\.parquet\.\d+\.[0-9a-f]{16}\.part")
"""A piece that a killed process left half written."""
_POINT_ID: Final = re.compile(r"[0-9a-f]{32}")


def require_pyarrow() -> None:
    """Raises HapticdError (one line) where pyarrow is missing."""
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError:
        raise HapticdError("results of sweeps need pyarrow: pip install 'hapticd[cluster]'") from None


class Store:
    """A folder of results."""

    def __init__(self, folder: Path, note: Callable[[str], None]) -> None:
        """`note` is called with a line on each file that cannot be read."""
        require_pyarrow()
        self._folder = folder
        self._note = note

    @property
    def folder(self) -> Path:
        """Where it is."""
        return self._folder

    @contextmanager
    def locked(self) -> Iterator[None]:
        """The folder for this process alone, made where it is missing. Raises HapticdError: where it cannot be made, or
        another process has it."""
        pieces = self._folder / PIECES_FOLDER
        try:
            pieces.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise HapticdError(f"{self._folder}: cannot be made: {error.strerror}") from None
        file = self._folder / LOCK_FILE
        check_regular(file)
        try:
            descriptor = os.open(file, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
        except OSError as error:
            raise HapticdError(f"{file}: cannot be written: {error.strerror}") from None
        try:
            self._lock(descriptor)
            for each in pieces.iterdir():
                if _PARTIAL_PIECE.fullmatch(each.name):
                    each.unlink()
            yield
        finally:
            os.close(descriptor)

    def _lock(self, descriptor: int) -> None:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise HapticdError(
                f"{self._folder}: another process writes results into it: wait for its end, or give another folder"
            ) from None
        except OSError as error:
            # Not every file system of a cluster has locks. Pieces are written whole all the same.
            self._note(f"{self._folder}: cannot be locked ({error.strerror}): run one study at a time into it")

    def begin(self, work: Work) -> None:
        """Writes what belongs to the study; pieces that are there stay. Raises HapticdError."""
        points = io.BytesIO()
        np.save(points, np.frombuffer(work.ids.tobytes(), np.uint8).reshape(-1, ID_DTYPE.itemsize))
        columns = [asdict(column) for column in work.columns]
        manifest = {
            "title": work.title,
            "columns": columns,
            "versions": {"hapticd": code_version(), "python": platform.python_version(), "numpy": np.__version__},
            **work.manifest(),
        }
        write_whole(str(self._folder / POINTS_FILE), points.getvalue(), overwrite=True)
        write_whole(str(self._folder / STUDY_FILE), json.dumps(manifest, indent=1).encode() + b"\n", overwrite=True)

    def manifest(self) -> dict[str, Any]:
        """What study.json holds. Raises HapticdError."""
        file = self._folder / STUDY_FILE
        try:
            found = json.loads(file.read_bytes())
        except OSError as error:
            raise HapticdError(f"{file}: cannot be read: {error.strerror}; no sweep was run into this folder") from None
        except ValueError:
            raise HapticdError(f"{file}: is no JSON: run the study again to have it written anew") from None
        if not isinstance(found, dict) or not isinstance(found.get("columns"), list):
            raise HapticdError(f"{file}: is of no sweep: run the study again to have it written anew")
        return found

    def columns(self) -> tuple[Column, ...]:
        """Of the study."""
        return tuple(Column(**each) for each in self.manifest()["columns"])

    def points(self) -> npt.NDArray[np.void]:
        """The identities of the study's points, (n,) ID_DTYPE. Raises HapticdError."""
        file = self._folder / POINTS_FILE
        try:
            found = np.load(file, allow_pickle=False)
        except (OSError, ValueError):
            raise HapticdError(f"{file}: cannot be read: run the study again to have it written anew") from None
        return np.frombuffer(found.tobytes(), ID_DTYPE)

    def present(self, columns: Sequence[Column], again: bool = False) -> npt.NDArray[np.void]:
        """The identities of all rows of the folder with these columns, (m,) ID_DTYPE; `again`: of those without an
        error."""
        found = [b""]
        for table in self._tables(_schema(columns), [POINT_COLUMN.name, ERROR_COLUMN.name]):
            if again:
                import pyarrow.compute as compute

                table = table.filter(compute.is_null(table[ERROR_COLUMN.name]))
            found += [bytes.fromhex(each) for each in table[POINT_COLUMN.name].to_pylist()]
        return np.frombuffer(b"".join(found), ID_DTYPE)

    def write(self, rows: Sequence[Row], columns: Sequence[Column]) -> None:
        """One piece, whole and on disk when this returns. Raises HapticdError."""
        import pyarrow
        from pyarrow import parquet

        schema = _schema(columns)
        ordered = sorted(rows, key=lambda row: str(row[POINT_COLUMN.name]))
        table = pyarrow.Table.from_pylist(ordered, schema=schema)
        name = sha256("".join(str(row[POINT_COLUMN.name]) for row in ordered).encode()).hexdigest()[:32]
        content = io.BytesIO()
        parquet.write_table(table, content)
        write_whole(str(self._folder / PIECES_FOLDER / f"{name}.parquet"), content.getvalue(), overwrite=True)

    def table(self) -> Any:
        """The study's rows that there are, a pyarrow.Table sorted by point. Raises HapticdError."""
        import pyarrow

        schema = _schema(self.columns())
        own = {each.tobytes().hex() for each in self.points()}
        rows: dict[str, Row] = {}
        for table in self._tables(schema, schema.names):
            for row in table.to_pylist():
                point = row[POINT_COLUMN.name]
                if point in own and (point not in rows or row[ERROR_COLUMN.name] is None):
                    rows[point] = row
        return pyarrow.Table.from_pylist([rows[point] for point in sorted(rows)], schema=schema)

    def digest(self) -> str:
        """SHA-256 of the sorted rows: names, kinds and values; not of how files hold them."""
        table = self.table()
        digest = sha256()
        for name in table.column_names:
            digest.update(f"{name} {table.schema.field(name).type}\n".encode())
            for number, each in enumerate(_values(table[name])):
                digest.update(
                    f"{', ' if number else '['}{(each.hex() if isinstance(each, float) else each)!r}".encode()
                )
            digest.update(b"]" if len(table) else b"[]")
        return digest.hexdigest()

    def rows(self) -> Iterator[Row]:
        """As table, one row after the other."""
        table = self.table()
        for begin in range(0, len(table), _ROWS_IN_MEMORY):
            yield from table.slice(begin, _ROWS_IN_MEMORY).to_pylist()

    def _tables(self, schema: Any, columns: list[str]) -> Any:
        """Of each piece that can be read and has the fields of this schema, these columns."""
        import pyarrow
        from pyarrow import parquet

        for file in sorted((self._folder / PIECES_FOLDER).glob("*.parquet")):
            try:
                found = parquet.ParquetFile(file)
                own = found.schema_arrow
                if POINT_COLUMN.name not in own.names or ERROR_COLUMN.name not in own.names:
                    self._note(f"{file}: holds no points: it is left out")
                    continue
                # A piece with others is of another study in this folder.
                if not all(each.name in own.names and _alike(own.field(each.name), each) for each in schema):
                    continue
                table = found.read(columns)
            except (OSError, pyarrow.ArrowException):
                self._note(f"{file}: is no piece of a sweep, or damaged: its points are computed again")
                continue
            if not all(each is not None and _POINT_ID.fullmatch(each) for each in table[POINT_COLUMN.name].to_pylist()):
                self._note(f"{file}: holds no points: it is left out")
                continue
            yield table


def _alike(one: Any, other: Any) -> bool:
    """Whether the values of two fields are of one kind; a whole number is a number."""
    kinds = [str(each.type) for each in (one, other)]
    return kinds[0] == kinds[1] or set(kinds) <= {"int64", "double"}


def _values(column: Any) -> Iterator[Value]:
    """Of a column, never all of them as objects of Python."""
    for begin in range(0, len(column), _ROWS_IN_MEMORY):
        yield from column.slice(begin, _ROWS_IN_MEMORY).to_pylist()


def _schema(columns: Sequence[Column]) -> Any:
    """The fields of a table, with unit and description of each as metadata."""
    import pyarrow

    made: dict[str, Callable[[], Any]] = {
        "number": pyarrow.float64,
        "integer": pyarrow.int64,
        "boolean": pyarrow.bool_,
        "text": pyarrow.string,
    }
    fields = [
        pyarrow.field(
            column.name,
            made[column.kind](),
            metadata={"unit": column.unit, "description": column.description, "role": column.role},
        )
        for column in columns
    ]
    return pyarrow.schema(fields, metadata={"hapticd": code_version()})
