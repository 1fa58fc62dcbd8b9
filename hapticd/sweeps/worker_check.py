"""Whether a worker runs the same hapticd as whoever sends it a piece."""

from __future__ import annotations

from functools import cache
from hashlib import sha256
from pathlib import Path

from hapticd._version import __version__
from hapticd.config.shipped_files import folder_of


@cache
def code_version() -> str:
    """The version of hapticd, and 12 hexadecimal digits of a hash: `0.1.0 (1f2e3d4c5b6a)`.

    The hash is of what results depend on: Python files, the C core, the shipped materials. A clone that
    was changed has another one than the version that it was cloned from.
    """
    root = Path(__file__).parents[1]
    digest = sha256()
    for folder, files in ((root, "**/*.py"), (root, "_core*.so"), (folder_of("materials"), "*.yaml")):
        for file in sorted(folder.glob(files)):
            digest.update(str(file.relative_to(folder)).encode() + b"\0" + file.read_bytes())
    return f"{__version__} ({digest.hexdigest()[:12]})"
