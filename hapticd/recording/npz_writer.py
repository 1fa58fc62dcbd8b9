"""Recordings in .npz, written: an archive that numpy.load reads without pickle.

`samples` (structured, one a tick), `events` (structured, one column for each key that occurs), and texts as JSON. The
samples are the first member, so that they are in place at once; its header is written at the end, when their number is
known, and with it the checksum, for which they are read once more.
"""

from __future__ import annotations

import io
import json
import os
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import IO, Any, Final

import numpy as np
import numpy.typing as npt

from hapticd.recording.event_columns import columns_of, dtype_of, rows_of
from hapticd.recording.writer import Checkpoint, RecordingWriter, Samples, last_of

_MEMBER: Final = "samples.npy"
_READ: Final = 1 << 20


class NpzWriter(RecordingWriter):
    """The .npz format."""

    def _write(self, samples: Samples) -> None:
        if self.count == 0:
            self._leave_room(samples.dtype)
        self._partial.append(samples.tobytes())
        self._checkpoint(self.count + len(samples), samples)

    def _leave_room(self, dtype: np.dtype[np.void]) -> None:
        """For the headers."""
        self._npy_size = len(_npy_header(dtype, 10**18, 0))
        self._start = len(_zip_info(0, 0).FileHeader(zip64=True)) + self._npy_size
        if self._partial.size < self._start:
            self._partial.cut(self._start)
        self._checkpoints = [Checkpoint(self._start, 0)]

    def _finish(self, texts: Mapping[str, object], arrays: Mapping[str, npt.NDArray[Any]]) -> None:
        dtype = self._dtype or np.dtype([])
        if self.count == 0:
            self._leave_room(dtype)
        members = {**arrays}
        members |= {name: np.array(json.dumps(value)) for name, value in self._with_changes(texts).items()}
        size = self._partial.size
        header = _npy_header(dtype, self.count, self._npy_size)
        info = _zip_info(self._npy_size + size - self._start, self._checksum(header))
        try:
            with _closing(open(self._partial.descriptor(), "r+b")) as file:
                file.seek(size)
                with zipfile.ZipFile(file, "w") as archive:
                    archive.infolist().append(info)
                    self._write_events(archive)
                    for name, array in members.items():
                        with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                            np.lib.format.write_array(member, array, allow_pickle=False)
            self._partial.put(0, info.FileHeader(zip64=True) + header)
            self._publish({self.target: self._partial})
        except OSError:
            self._partial.cut(size)
            raise

    def _checksum(self, header: bytes) -> int:
        checksum = zlib.crc32(header)
        for at in range(self._start, self._partial.size, _READ):
            checksum = zlib.crc32(os.pread(self._partial.fd, min(_READ, self._partial.size - at), at), checksum)
        return checksum

    def _write_events(self, archive: zipfile.ZipFile) -> None:
        """Row by row: one long mark makes every row as long, which compression then takes away again."""
        total, columns = columns_of(self.read_events())
        info = zipfile.ZipInfo("events.npy")
        info.compress_type = zipfile.ZIP_DEFLATED
        with archive.open(info, "w", force_zip64=True) as member:
            member.write(_npy_header(dtype_of(columns), total, 0))
            for rows in rows_of(self.read_events(), columns):
                member.write(rows.tobytes())

    def _count_written(self, dtype: np.dtype[np.void]) -> int:
        self._leave_room(dtype)
        self.count = max(self._partial.size - self._start, 0) // dtype.itemsize
        end = self._start + self.count * dtype.itemsize
        if self.count:
            last = os.pread(self._partial.fd, dtype.itemsize, end - dtype.itemsize)
            self.last_tick, self.last_time_ns = last_of(np.frombuffer(last, dtype))
        return end


@contextmanager
def _closing(file: IO[bytes]) -> Iterator[IO[bytes]]:
    """Closes a file; where it failed before, a full disk may refuse again what closing would still write."""
    try:
        yield file
    except BaseException:
        with suppress(OSError):
            file.close()
        raise
    file.close()


def _npy_header(dtype: np.dtype[Any], count: int, size: int) -> bytes:
    """The header of a .npy file of (count,) records, of `size` bytes at least."""
    file = io.BytesIO()
    header = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": (count,)}
    np.lib.format.write_array_header_1_0(file, header)
    written = file.getvalue()
    size = max(size, len(written))
    return written[:8] + (size - 10).to_bytes(2, "little") + written[10:-1].ljust(size - 11) + b"\n"


def _zip_info(size: int, checksum: int) -> zipfile.ZipInfo:
    """The samples as the archive's first member; its header has one length, whatever the size."""
    info = zipfile.ZipInfo(_MEMBER)
    info.header_offset, info.CRC = 0, checksum
    info.file_size = info.compress_size = size
    return info
