"""How much memory a process takes to load a recording, as the kernel counts it.

tracemalloc counts too much for an array that grows: from numpy 2.5 on (numpy/numpy#30900) it counts the old memory and
the new for a moment, while realloc moves the pages and takes no more. The process is new, so that nothing that others
freed in it is taken again. It loads a short recording first: what is imported for that is not counted.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def memory_of_loading(short: Path, path: Path, limit: int) -> int:
    """The most memory that `path`, which may take `limit`, takes at once, bytes; `short` is a recording of its form."""
    command = [sys.executable, "-m", __name__, str(short), str(path), str(limit)]
    return int(subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout)


def main() -> None:
    """Prints the bytes that `memory_of_loading` returns."""
    from hapticd.recording.reader import load_recorded

    load_recorded(sys.argv[1])
    before = memory_status()
    load_recorded(sys.argv[2], int(sys.argv[3]))
    after = memory_status()
    # Address space is what was asked for, whether it was ever used or not; resident memory is what was used.
    print(max(after["VmPeak"] - before["VmSize"], after["VmHWM"] - before["VmRSS"]))


def memory_status() -> dict[str, int]:
    """The lines of /proc/self/status about memory (VmPeak, VmRSS and others), bytes."""
    lines = Path("/proc/self/status").read_text().splitlines()
    pairs = (line.split(":", 1) for line in lines if line.startswith("Vm"))
    return {name: int(value.split()[0]) << 10 for name, value in pairs}


if __name__ == "__main__":
    main()
