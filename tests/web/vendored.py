"""The npm packages that the page includes: their files against the record, and against the registry's packages.

`hapticd/web/static/vendor/packages.json` has name, version, licence, the hash of the package and of each file. To use
another version, replace the files and the record. `python -m tests.web.vendored` fetches the packages with npm.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
RECORD = ROOT / "hapticd" / "web" / "static" / "vendor" / "packages.json"
PACKAGES: list[dict[str, Any]] = json.loads(RECORD.read_text())["packages"]


def sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def faults(root: Path = ROOT, packages: list[dict[str, Any]] = PACKAGES) -> list[str]:
    """Return a line for each file of the tree that differs from the record."""
    found: list[str] = []
    for package in packages:
        folder = root / package["folder"]
        there = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
        for name, file in package["files"].items():
            if name not in there:
                found.append(f"{package['folder']}/{name}: is missing")
            elif sha256((folder / name).read_bytes()) != file["sha256"]:
                found.append(f"{package['folder']}/{name}: is not {package['name']} {package['version']}'s")
        found += [f"{package['folder']}/{name}: is not recorded" for name in sorted(there - package["files"].keys())]
    return found


def differences_from_registry(package: dict[str, Any]) -> list[str]:
    """Fetch the package with npm, and return a line for each file that differs from the record."""
    name = f"{package['name']}@{package['version']}"
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(["npm", "pack", "--silent", name], cwd=folder, capture_output=True, text=True)
        if done.returncode != 0:
            return [f"{name}: npm cannot fetch it: {(done.stderr or done.stdout).strip().splitlines()[-1:]}"]
        (fetched,) = Path(folder).iterdir()
        if sha256(fetched.read_bytes()) != package["tarball_sha256"]:
            return [f"{name}: the registry's package is not the one that was recorded"]
        with tarfile.open(fetched) as archive:
            return [
                f"{name}: {file['from']} is not as recorded"
                for file in package["files"].values()
                if sha256(archive.extractfile(f"package/{file['from']}").read()) != file["sha256"]  # type: ignore[union-attr]
            ]


def main() -> int:
    problems = faults()
    if shutil.which("npm") is None:
        print("skipped: no npm, so that the files are compared with their record alone")
    else:
        for package in PACKAGES:
            problems += differences_from_registry(package)
    for problem in problems:
        print(problem, file=sys.stderr)
    if not problems:
        print(", ".join(f"{package['name']} {package['version']}" for package in PACKAGES) + ": unchanged")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
