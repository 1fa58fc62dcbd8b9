"""Holds a version tag to the package's version: `python packaging/version_tag.py v1.2.3`.

Exit code 1 and a line on stderr where the tag is not `v` followed by the version of hapticd/_version.py.
"""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

VERSION_FILE = Path(__file__).resolve().parent.parent / "hapticd" / "_version.py"


def tag_of(path: Path) -> str:
    """The tag that a release with this file has."""
    return f"v{runpy.run_path(str(path))['__version__']}"


def main(arguments: list[str]) -> str | None:
    """None where the tag is right, otherwise what is wrong with it."""
    if len(arguments) != 1:
        return "usage: version_tag.py TAG"
    wanted = tag_of(VERSION_FILE)
    if arguments[0] != wanted:
        return f"tag {arguments[0]}: hapticd/_version.py says {wanted.removeprefix('v')}, whose tag is {wanted}"
    return None


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
