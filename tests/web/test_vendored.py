"""Packages from npm are included unchanged, with their licences."""

from __future__ import annotations

import copy
import shutil
import tomllib
from pathlib import Path

from tests.web.vendored import PACKAGES, RECORD, ROOT, faults, sha256

LICENCES = {"uplot": "MIT", "@msgpack/msgpack": "ISC", "axe-core": "MPL-2.0"}


def test_every_file_is_recorded_and_every_record_has_its_file() -> None:
    assert faults() == []
    assert {package["name"]: package["licence"] for package in PACKAGES} == LICENCES


def test_no_folder_of_packages_is_left_out_of_the_record() -> None:
    recorded = {package["folder"] for package in PACKAGES}
    for folder in (RECORD.parent, ROOT / "tests" / "web" / "vendor"):
        for path in folder.iterdir():
            assert path == RECORD or path.relative_to(ROOT).as_posix() in recorded


def test_what_is_changed_missing_or_added_is_named(tmp_path: Path) -> None:
    package = copy.deepcopy(PACKAGES[0])
    folder = tmp_path / package["folder"]
    shutil.copytree(ROOT / package["folder"], folder)
    assert faults(tmp_path, [package]) == []
    (folder / "uPlot.esm.js").write_bytes((folder / "uPlot.esm.js").read_bytes() + b"\n")
    (folder / "uPlot.min.css").unlink()
    (folder / "more.js").touch()
    assert faults(tmp_path, [package]) == [
        f"{package['folder']}/uPlot.esm.js: is not uplot 1.6.32's",
        f"{package['folder']}/uPlot.min.css: is missing",
        f"{package['folder']}/more.js: is not recorded",
    ]


def test_licences_are_beside_the_files_and_in_the_wheel() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    licences = {path for pattern in project["project"]["license-files"] for path in ROOT.glob(pattern)}
    for package in PACKAGES:
        licence = ROOT / package["folder"] / "LICENSE"
        assert sha256(licence.read_bytes()) == package["files"]["LICENSE"]["sha256"]
        shipped = package["folder"].startswith("hapticd/")
        assert (licence in licences) == shipped
        assert not shipped or package["licence"] in project["project"]["license"].split(" AND ")
    assert "web/static/**/*" in project["tool"]["setuptools"]["package-data"]["hapticd"]
