"""How much memory a process takes to load a recording, told by the kernel.

tracemalloc does not tell it of an array that grows: from numpy 2.5 on (numpy/numpy#30900) it counts the old memory and
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
    """Prints it."""
    from hapticd.recording.reader import load_recorded

    load_recorded(sys.argv[1])
    before = _told()
    load_recorded(sys.argv[2], int(sys.argv[3]))
    after = _told()
    # Address space is what was asked for, whether it was ever used or not; resident memory is what was used.
    print(max(after["VmPeak"] - before["VmSize"], after["VmHWM"] - before["VmRSS"]))


def _told() -> dict[str, int]:
    """What /proc says of this process's memory, bytes."""
    lines = Path("/proc/self/status").read_text().splitlines()
    pairs = (line.split(":", 1) for line in lines if line.startswith("Vm"))
    return {name: int(value.split()[0]) << 10 for name, value in pairs}


if __name__ == "__main__":
    main()
