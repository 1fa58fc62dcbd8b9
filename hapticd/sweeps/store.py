"""The results of sweeps in a folder: the study, and its rows as Parquet files, each written atomically.

    lock                  locked by the process that writes
    study.json            title, columns, the study itself, seed and versions
    points.npy            the identities of the study's points, (n,)
    pieces/HASH.parquet   rows, sorted by identity; HASH is the hash of these identities

Two studies in one folder share the rows of points with the same identity.
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
from hapticd.base.files import check_regular, write_atomically
from hapticd.sweeps.columns import ERROR_COLUMN, POINT_COLUMN, Column, Row, Value
from hapticd.sweeps.work import ID_DTYPE, Work
from hapticd.sweeps.worker_check import code_version
from hapticd.system.extras import install_command

STUDY_FILE: Final = "study.json"
"""Name of the file with the study in a result folder."""
POINTS_FILE: Final = "points.npy"
"""Name of the file with the identities of points in a result folder."""
PIECES_FOLDER: Final = "pieces"
"""Name of the subfolder with the rows in a result folder."""
_ROWS_IN_MEMORY: Final = 500
"""Maximum number of rows that are Python objects at the same time."""
_PARTIAL_PIECE: Final = re.compile(r"\.[0-9a-f]{32}\.parquet\.\d+\.[0-9a-f]{16}\.part")
"""Pattern of the name of a temporary file that a killed process may leave behind."""
_POINT_ID: Final = re.compile(r"[0-9a-f]{32}")
"""Pattern of the identity of a point as text: 32 hexadecimal digits."""


def require_pyarrow() -> None:
    """Raise HapticdError (one line) if pyarrow is missing."""
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError:
        raise HapticdError(f"results of sweeps need pyarrow: {install_command('cluster')}") from None


class Store:
    """A folder with the results of a study: study.json, identities of points, and rows."""

    def __init__(self, folder: Path, note: Callable[[str], None]) -> None:
        """Open a folder; `note` gets a line of text if a file of rows cannot be read or the folder cannot be locked."""
        require_pyarrow()
        self._folder = folder
        self._note = note

    @property
    def folder(self) -> Path:
        """Path of the folder of results."""
        return self._folder

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Lock the folder of results for this process while the context is active; create a missing folder.

        Temporary files of killed processes are removed. Raises HapticdError if the folder cannot be created, or another
        process has locked it.
        """
        pieces = self._folder / PIECES_FOLDER
        try:
            pieces.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise HapticdError(f"{self._folder}: cannot be created: {error.strerror}") from None
        file = self._folder / "lock"
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
                f"{self._folder}: another process writes results into it; wait for its end, or give another folder"
            ) from None
        except OSError as error:
            # Some file systems of clusters have no locks. Pieces are written atomically even there.
            self._note(f"{self._folder}: cannot be locked: {error.strerror}; run only one study at a time into it")

    def begin(self, work: Work) -> None:
        """Write study.json and points.npy of a study; existing rows are kept. Raises HapticdError."""
        points = io.BytesIO()
        np.save(points, np.frombuffer(work.ids.tobytes(), np.uint8).reshape(-1, ID_DTYPE.itemsize))
        columns = [asdict(column) for column in work.columns]
        manifest = {
            "title": work.title,
            "columns": columns,
            "versions": {"hapticd": code_version(), "python": platform.python_version(), "numpy": np.__version__},
            **work.manifest(),
        }
        write_atomically(self._folder / POINTS_FILE, points.getvalue(), overwrite=True)
        write_atomically(self._folder / STUDY_FILE, json.dumps(manifest, indent=1) + "\n", overwrite=True)

    def manifest(self) -> dict[str, Any]:
        """Read study.json. Raises HapticdError."""
        file = self._folder / STUDY_FILE
        try:
            found = json.loads(file.read_bytes())
        except OSError as error:
            raise HapticdError(f"{file}: cannot be read: {error.strerror}; not a folder of results") from None
        except ValueError:
            raise HapticdError(f"{file}: not JSON; run the study again to restore it") from None
        if not isinstance(found, dict) or not isinstance(found.get("columns"), list):
            raise HapticdError(f"{file}: not a file of a sweep; run the study again to restore it")
        return found

    def columns(self) -> tuple[Column, ...]:
        """Return the columns of the study. Raises HapticdError."""
        return tuple(Column(**each) for each in self.manifest()["columns"])

    def points(self) -> npt.NDArray[np.void]:
        """Return the identities of the study's points, (n,) ID_DTYPE. Raises HapticdError."""
        file = self._folder / POINTS_FILE
        try:
            found = np.load(file, allow_pickle=False)
        except (OSError, ValueError):
            raise HapticdError(f"{file}: cannot be read; run the study again to restore it") from None
        return np.frombuffer(found.tobytes(), ID_DTYPE)

    def present(self, columns: Sequence[Column], again: bool = False) -> npt.NDArray[np.void]:
        """Return the identities of the points whose rows are in the folder with these columns, (m,) ID_DTYPE.

        With `again`, rows with an error are left out.
        """
        found = [b""]
        for table in self._tables(_schema(columns), [POINT_COLUMN.name, ERROR_COLUMN.name]):
            if again:
                import pyarrow.compute as compute

                table = table.filter(compute.is_null(table[ERROR_COLUMN.name]))
            found += [bytes.fromhex(each) for each in table[POINT_COLUMN.name].to_pylist()]
        return np.frombuffer(b"".join(found), ID_DTYPE)

    def write(self, rows: Sequence[Row], columns: Sequence[Column]) -> None:
        """Write rows as one Parquet file, atomically. Raises HapticdError."""
        import pyarrow
        from pyarrow import parquet

        schema = _schema(columns)
        ordered = sorted(rows, key=lambda row: str(row[POINT_COLUMN.name]))
        table = pyarrow.Table.from_pylist(ordered, schema=schema)
        name = sha256("".join(str(row[POINT_COLUMN.name]) for row in ordered).encode()).hexdigest()[:32]
        content = io.BytesIO()
        parquet.write_table(table, content)
        write_atomically(self._folder / PIECES_FOLDER / f"{name}.parquet", content.getvalue(), overwrite=True)

    def table(self) -> Any:
        """Return the computed rows of the study, a pyarrow.Table sorted by point. Raises HapticdError."""
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
        """Return the SHA-256 of names, types and values of all columns, independent of the division into files."""
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
        """Yield the computed rows of the study, sorted by point. Raises HapticdError."""
        table = self.table()
        for begin in range(0, len(table), _ROWS_IN_MEMORY):
            yield from table.slice(begin, _ROWS_IN_MEMORY).to_pylist()

    def _tables(self, schema: Any, columns: list[str]) -> Any:
        """Yield a pyarrow.Table with `columns` for each readable Parquet file that has the fields of `schema`."""
        import pyarrow
        from pyarrow import parquet

        for file in sorted((self._folder / PIECES_FOLDER).glob("*.parquet")):
            try:
                found = parquet.ParquetFile(file)
                own = found.schema_arrow
                if POINT_COLUMN.name not in own.names or ERROR_COLUMN.name not in own.names:
                    self._note(f"{file}: not a piece of a sweep; it is left out")
                    continue
                # A piece with other fields belongs to another study in this folder.
                if not all(each.name in own.names and _same_kind(own.field(each.name), each) for each in schema):
                    continue
                table = found.read(columns)
            except (OSError, pyarrow.ArrowException):
                self._note(f"{file}: not a piece of a sweep, or damaged; its points are computed again")
                continue
            if not all(each is not None and _POINT_ID.fullmatch(each) for each in table[POINT_COLUMN.name].to_pylist()):
                self._note(f"{file}: not a piece of a sweep; it is left out")
                continue
            yield table


def _same_kind(one: Any, other: Any) -> bool:
    """Return whether two fields have the same type; integers and floats count as one type."""
    kinds = [str(each.type) for each in (one, other)]
    return kinds[0] == kinds[1] or set(kinds) <= {"int64", "double"}


def _values(column: Any) -> Iterator[Value]:
    """Yield the values of a column, with at most _ROWS_IN_MEMORY of them as Python objects at a time."""
    for begin in range(0, len(column), _ROWS_IN_MEMORY):
        yield from column.slice(begin, _ROWS_IN_MEMORY).to_pylist()


def _schema(columns: Sequence[Column]) -> Any:
    """Return the schema of columns; unit, description and role of each column are metadata of its field."""
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
