"""A first tap with the hapticd that is installed beside this Python: `PYTHON packaging/first_tap.py`.

The command says its version, a simulated hand taps the seven shipped materials, and a daemon plays a tap and lets its
own hand tap wood. It needs no device and no other file of the clone. What fails ends it with a message on stderr and
exit code 1.
"""

from __future__ import annotations

import importlib.metadata
import json
import platform
import signal
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

import hapticd

MATERIALS = 7
"""Objects of the shipped scene `materials`, each of which its hand taps once."""

PATIENCE_S = 60.0

COMMAND = Path(sysconfig.get_path("scripts"), "hapticd")


def run(*words: str | Path) -> str:
    """The standard output of a command of hapticd. Ends the program where the command fails."""
    done = subprocess.run([COMMAND, *words], capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"hapticd {' '.join(map(str, words))}: exit code {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout


def simulated_contacts() -> int:
    """How many contacts the shipped scene of materials has, without a daemon."""
    contacts: int = json.loads(run("simulate", "materials", "--json"))["event_counts"]["contact"]
    return contacts


def tapped(directory: Path) -> str:
    """What is touched first once the hand of a daemon on the simulated joystick taps wood.

    The daemon is new; its runtime directory is `directory`.
    """
    runtime = ("--runtime-dir", str(directory))
    with subprocess.Popen([COMMAND, *runtime, "run", "--quiet", "--config", "materials"]) as process:
        try:
            with hapticd.connect(directory, wait_s=PATIENCE_S) as daemon, daemon.events() as events:
                run(*runtime, "play", "wood", "--amplitude", "20")
                daemon.set_operator(gesture={"kind": "tap", "object": "wood", "speed_m_per_s": 0.1})
                contact = next(event for event in events if event["event"] == "contact")
        finally:
            process.send_signal(signal.SIGINT)
            code = process.wait(PATIENCE_S)
    if code != 0:
        sys.exit(f"hapticd run: exit code {code} after SIGINT; it would be 0")
    return str(contact["object"])


def main() -> None:
    """All of it."""
    installed = importlib.metadata.version("hapticd")
    if (said := run("--version")) != f"hapticd {installed}\n":
        sys.exit(f"hapticd --version says {said!r}; hapticd {installed} is installed")
    if (contacts := simulated_contacts()) != MATERIALS:
        sys.exit(f"hapticd simulate materials: {contacts} contacts; it would be {MATERIALS}")
    with tempfile.TemporaryDirectory(prefix="hapticd-") as folder:
        touched = tapped(Path(folder, "run"))
    if touched != "wood":
        sys.exit(f"the daemon's hand touched {touched}; it was to tap wood")
    print(f"hapticd {installed}, Python {platform.python_version()}: {contacts} taps simulated, one played, one felt")


if __name__ == "__main__":
    main()
