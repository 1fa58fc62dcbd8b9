"""The command that adds an extra of hapticd to this installation."""

from __future__ import annotations

import os
import shlex
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Final

DEBIAN_PREFIX: Final = Path("/usr/lib/hapticd")
"""The private environment of the Debian package. It has no pip; that of Debian installs into it."""
IMAGE_EXTRAS_VARIABLE: Final = "HAPTICD_IMAGE_EXTRAS"
"""Environment variable that packaging/Containerfile sets: the extras of the image."""


def install_command(extras: str) -> str:
    """Return the shell command that adds `extras`, such as "fit" or "experiment,web", to this installation.

    pip keeps the installed hapticd, and adds only the packages that the extras need. An image is built again, with its
    own extras and the new ones.
    """
    requirement = shlex.quote(f"hapticd[{extras}]")
    prefix = Path(sys.prefix)
    if IMAGE_EXTRAS_VARIABLE in os.environ:
        names = ",".join(dict.fromkeys(f"{os.environ[IMAGE_EXTRAS_VARIABLE]},{extras}".strip(",").split(",")))
        return f"podman build -f packaging/Containerfile --build-arg EXTRAS={names} -t hapticd ."
    if prefix == DEBIAN_PREFIX:
        pip = f"sudo /usr/bin/python3 -m pip --python {DEBIAN_PREFIX}/bin/python3"
        return f"sudo apt install python3-pip && {pip} install {requirement}"
    if (prefix / "pipx_metadata.json").is_file():
        return f"pipx runpip {shlex.quote(prefix.name)} install {requirement}"
    if find_spec("pip") is None:
        return f"uv pip install --python {shlex.quote(sys.executable)} {requirement}"
    return f"{shlex.quote(sys.executable)} -m pip install {requirement}"
