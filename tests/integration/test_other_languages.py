"""The clients of examples/ in C, C++ and JavaScript: built as their pages say, run with a daemon and without one.

A test whose compiler, libraries or node are missing is skipped with one line, or fails where HAPTICD_CLIENTS=required
is set.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.daemon_process import PATIENCE_S, Daemon, running_daemon

EXAMPLES = Path(__file__).parents[2] / "examples"
# What there must be, and what installs it on Debian. A header is asked of the compiler.
NEEDED = {
    "c": (("cc", "make", "pkg-config"), ("zmq.h", "msgpack.h"), "gcc make pkg-config libzmq3-dev libmsgpack-dev"),
    "cpp": (
        ("c++", "make", "pkg-config"),
        ("zmq.hpp", "msgpack.hpp"),
        "g++ make pkg-config cppzmq-dev libmsgpack-cxx-dev",
    ),
    "js": (("node", "npm"), (), "nodejs npm"),
}


def missing(what: str) -> None:
    line = f"the client of examples/{what}"
    if os.environ.get("HAPTICD_CLIENTS") == "required":
        pytest.fail(line, pytrace=False)
    pytest.skip(line)


def need(language: str) -> None:
    programs, headers, packages = NEEDED[language]
    absent = [program for program in programs if shutil.which(program) is None]
    for header in () if absent else headers:
        source = f"#include <{header}>\n"
        words = [
            programs[0],
            "-E",
            "-DMSGPACK_NO_BOOST",
            "-x",
            "c++" if language == "cpp" else "c",
            "-",
            "-o",
            os.devnull,
        ]
        if subprocess.run(words, input=source, text=True, capture_output=True).returncode != 0:
            absent.append(header)
    if absent:
        missing(f"client_{language} needs {', '.join(absent)} (Debian: apt install {packages})")


def built(language: str, folder: Path) -> list[str]:
    """The words that start the client, built in this folder."""
    home = EXAMPLES / f"client_{language}"
    if language != "js":
        made = subprocess.run(["make", "-C", str(home), f"BUILD={folder}"], capture_output=True, text=True)
        assert made.returncode == 0, made.stderr
        assert "warning" not in made.stderr
        return [str(folder / "client")]
    for name in ("client.mjs", "package.json", "package-lock.json"):
        shutil.copy(home / name, folder)
    # The packages bring their binaries: nothing of theirs is run to install them.
    words = ["npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund", "--no-update-notifier"]
    made = subprocess.run(words, cwd=folder, capture_output=True, text=True)
    if made.returncode != 0:
        missing(f"client_js needs its packages: npm ci says {made.stderr.strip().splitlines()[-1:]}")
    return ["node", str(folder / "client.mjs")]


@pytest.fixture(scope="module", params=NEEDED)
def client(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    language = str(request.param)
    need(language)
    return built(language, tmp_path_factory.mktemp(language))


@pytest.fixture(scope="module")
def daemon() -> Iterator[Daemon]:
    with running_daemon() as daemon:
        yield daemon


def run(client: list[str], directory: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*client, str(directory)], capture_output=True, text=True, timeout=PATIENCE_S)


@pytest.mark.slow
def test_it_taps_and_prints(client: list[str], daemon: Daemon) -> None:
    done = run(client, daemon.directory)
    assert (done.returncode, done.stderr) == (0, "")
    wall, contact, sample = done.stdout.splitlines()
    in_force = re.fullmatch(r"wall in force from tick (\d+) on", wall)
    touched = re.fullmatch(r"contact at tick (\d+) with ([\d.]+) m/s, tap of ([\d.]+) m/s\^2", contact)
    shown = re.fullmatch(r"sample of tick (\d+): position (\S+) (\S+) m, force (\S+) (\S+) N", sample)
    assert in_force and touched and shown
    assert int(in_force[1]) < int(touched[1]) <= int(shown[1])
    # The gesture comes at 0.2 m/s within SPEED_WITHIN; wood's slope is 309 1/s.
    assert float(touched[2]) == pytest.approx(0.2, rel=0.05)
    assert float(touched[3]) == pytest.approx(309 * float(touched[2]), rel=0.01)
    # x of the gesture's place; it presses 0.15 s, and lies below the surface or is on its way back.
    assert float(shown[2]) == pytest.approx(0, abs=1e-3)


@pytest.mark.slow
def test_without_a_daemon_it_says_so_in_one_line(client: list[str]) -> None:
    with tempfile.TemporaryDirectory(prefix="hapticd-test-") as nobody:
        done = run(client, Path(nobody))
    assert done.returncode == 1
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert re.fullmatch(r"client: .*does (a daemon|one) run\?", line), line
