"""The guest's Python. It imports everything once, and runs every job in a process that begins as a copy of this one:
an import takes seconds in a machine that is translated instruction by instruction.

machine.py SECONDS JOB.py...: the jobs one after the other; the exit code is that of the first that failed.
A job that takes longer than SECONDS, of the machine's own time, is ended and has failed.
"""

from __future__ import annotations

import importlib
import pkgutil
import runpy
import signal
import sys
import time
from pathlib import Path

import rig

import hapticd

HERE = Path(__file__).resolve().parent
JOBS_NEED = ("uhid_vendor_joystick", "usb_firmware", "usb_pid_joystick")
NOT_NEEDED = ("hapticd.__main__", "hapticd._build")


def load() -> None:
    """What jobs and daemons would import."""
    for name in JOBS_NEED:
        importlib.import_module(name)
    for module in pkgutil.walk_packages(hapticd.__path__, "hapticd."):
        if not module.name.startswith(NOT_NEEDED):
            importlib.import_module(module.name)


def run(job: str, limit_s: float) -> int:
    """Its exit code."""
    child = rig.Child(lambda: runpy.run_path(str(HERE / job), run_name="__main__"), [job])
    code = child.wait(limit_s)
    if code is not None:
        return code
    print(f"  FAILED {job} was not done after {limit_s:g} s of the machine's time", flush=True)
    child.kill(signal.SIGKILL)
    child.wait()
    return 124


def main() -> int:
    limit_s = float(sys.argv[1])
    load()
    failed = 0
    for job in sys.argv[2:]:
        (rig.OUT / "job").write_text(job)
        begin = time.monotonic()
        code = run(job, limit_s)
        took = f"{time.monotonic() - begin:.1f} s of the machine's time"
        print(f"{job}: {'ok' if code == 0 else f'failed, exit code {code}'}, {took}", flush=True)
        failed = failed or code
    return failed


if __name__ == "__main__":
    sys.exit(main())
