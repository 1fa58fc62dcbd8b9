"""The code version of hapticd, which must be the same in a worker and in the command that runs the study."""

from __future__ import annotations

from functools import cache
from hashlib import sha256
from pathlib import Path

from hapticd._version import __version__
from hapticd.config.shipped_files import folder_of


@cache
def code_version() -> str:
    """Return the version of hapticd with 12 hexadecimal digits of a SHA-256 hash: `0.1.0 (1f2e3d4c5b6a)`.

    The hash covers the files that results depend on: Python files, the C core, and the shipped materials.
    """
    root = Path(__file__).parents[1]
    digest = sha256()
    for folder, files in ((root, "**/*.py"), (root, "_core*.so"), (folder_of("materials"), "*.yaml")):
        for file in sorted(folder.glob(files)):
            digest.update(str(file.relative_to(folder)).encode() + b"\0" + file.read_bytes())
    return f"{__version__} ({digest.hexdigest()[:12]})"
