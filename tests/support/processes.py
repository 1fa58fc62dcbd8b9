"""What a process of ours takes, as the kernel tells it in /proc."""

from __future__ import annotations

import os
import re
from pathlib import Path


def memory_kib(pid: int) -> int:
    """Memory of a process that is its own and in use."""
    rollup = Path(f"/proc/{pid}/smaps_rollup").read_text()
    return sum(int(kib) for kib in re.findall(r"^Private_(?:Clean|Dirty): +(\d+) kB", rollup, re.MULTILINE))


def scheduled_s(pid: int) -> tuple[float, float]:
    """How long its threads had a processor, and how long they waited for one."""
    told = [each.read_text().split() for each in Path(f"/proc/{pid}/task").glob("*/schedstat")]
    return sum(int(each[0]) for each in told) / 1e9, sum(int(each[1]) for each in told) / 1e9


def threads(pid: int) -> int:
    """How many it has."""
    return len(os.listdir(f"/proc/{pid}/task"))


def descriptors(pid: int) -> int:
    """How many it has."""
    return len(os.listdir(f"/proc/{pid}/fd"))
