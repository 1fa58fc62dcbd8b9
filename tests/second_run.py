"""Runs C test binaries and pytest; what fails is run once more after all others, with nothing beside it.

    python tests/second_run.py [--c-runs N] [BINARY ...] [-- PYTEST_ARGUMENT ...]

The C tests run beside pytest. A test that fails twice fails the run. A test that passes the second time is named in the
last lines of the output ("needed a second run: ..."): it depends on the machine's load, and is to be mended.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

TESTS_FAILED = 1
"""Exit code of pytest: some tests failed. Any other code above it is an error of the run itself."""


def run_binary(binary: str, runs: int) -> tuple[bool, str]:
    """Runs a C test `runs` times, each with random cases of its own (tests/c/hd_test.h); whether all passed, and their
    output."""
    output = ""
    for run in range(runs):
        done = subprocess.run(
            [binary], env={**os.environ, "HD_RUN": str(run)}, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
        )
        output += done.stdout.decode(errors="replace")
        if done.returncode != 0:
            return False, f"{output}{binary}: ended with {done.returncode}\n"
    return True, output


def run_binaries(binaries: list[str], runs: int) -> list[str]:
    """Runs C tests one after the other and prints what they print; those that failed."""
    results = {binary: run_binary(binary, runs) for binary in binaries}
    for _, output in results.values():
        print(output, end="", flush=True)
    return [binary for binary, (passed, _) in results.items() if not passed]


def run_pytest(arguments: list[str]) -> int:
    return subprocess.run([sys.executable, "-m", "pytest", *arguments]).returncode


def failed_tests() -> list[str]:
    """What pytest's cache says of the run before."""
    path = Path(".pytest_cache", "v", "cache", "lastfailed")
    return sorted(json.loads(path.read_text(encoding="utf-8"))) if path.exists() else []


def main(arguments: list[str]) -> int:
    """Runs everything, and a second time what failed; the exit code."""
    separator = arguments.index("--") if "--" in arguments else len(arguments)
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--c-runs", type=int, default=1, metavar="N")
    parser.add_argument("binaries", nargs="*", metavar="BINARY")
    options = parser.parse_args(arguments[:separator])
    pytest_arguments = arguments[separator + 1 :]

    with ThreadPoolExecutor(1) as beside:
        c_tests = beside.submit(run_binaries, options.binaries, options.c_runs)
        code = run_pytest(["--cache-clear", *pytest_arguments]) if pytest_arguments else 0
        failed_binaries = c_tests.result()
    if code > TESTS_FAILED:
        return code
    failed = failed_tests() if code else []

    failed_twice = []
    for binary in failed_binaries:
        print(f"a second run of {binary}", flush=True)
        failed_twice += run_binaries([binary], options.c_runs)
    if code:
        print(f"a second run of {len(failed)} tests that failed", flush=True)
        code = run_pytest(["--last-failed", "--last-failed-no-failures", "none", *pytest_arguments, "-n", "0"])
        failed_twice += failed_tests() if code else []
    for name in [*failed_binaries, *failed]:
        print(f"failed twice: {name}" if name in failed_twice else f"needed a second run: {name}")
    return 1 if code or failed_twice else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
