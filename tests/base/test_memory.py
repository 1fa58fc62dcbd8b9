"""Large blocks of memory are kept separate from small ones, according to glibc's malloc_info."""

from __future__ import annotations

import json
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from hapticd.base.errors import HapticdError
from hapticd.base.memory import MIN_RETURNED_BLOCK_BYTES, return_large_blocks

pytestmark = pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc's limit moves, and is set")
ROOT = Path(__file__).parents[2]
PROGRAM = """
import ctypes, json, re, sys
from hapticd.base.memory import return_large_blocks
libc = ctypes.CDLL(None)
libc.fopen.restype = ctypes.c_void_p

def separate_blocks():
    # How many blocks have separate pages.
    file = ctypes.c_void_p(libc.fopen(sys.argv[1].encode(), b"w"))
    assert file and libc.malloc_info(0, file) == 0 and libc.fclose(file) == 0
    return int(re.search(r'<total type="mmap" count="(\\d+)"', open(sys.argv[1]).read())[1])

if sys.argv[2] == "settled":
    return_large_blocks()
del (buffer := [bytearray(4 << 20)])[:]  # this raises the limit
before = separate_blocks()
kept = [bytearray(size) for size in json.loads(sys.argv[3])]
print(separate_blocks() - before)
"""


def separate_blocks(tmp_path: Path, how: str, *sizes: int) -> int:
    """Return how many blocks of these sizes have separate pages, after a larger block was allocated and freed."""
    command = [sys.executable, "-c", PROGRAM, str(tmp_path / "info.xml"), how, json.dumps(sizes)]
    return int(subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT).stdout)


def test_large_blocks_are_kept_separate(tmp_path: Path) -> None:
    sizes = (1 << 20, 2 << 20, 3 << 20)  # more than the heap has free
    assert separate_blocks(tmp_path, "as it is", *sizes) == 0, "the setting is not needed any more"
    assert separate_blocks(tmp_path, "settled", *sizes) == 3
    assert separate_blocks(tmp_path, "settled", MIN_RETURNED_BLOCK_BYTES // 2) == 0


def test_a_size_that_malloc_does_not_take_is_refused() -> None:
    with pytest.raises(HapticdError, match="memory: malloc cannot map blocks of 4294967296 bytes"):
        return_large_blocks(2**32)
