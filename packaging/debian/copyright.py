"""debian/copyright of the package: hapticd's own licence, and those of what it brings from PyPI.

copyright.py SITE_PACKAGES, in the copy of the tree: prints it. A package or a library whose licence is not known ends
the build.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from importlib.metadata import Distribution, PackageMetadata, distributions
from pathlib import Path
from typing import Final

HEAD: Final = """\
Format: https://www.debian.org/doc/packaging-manuals/copyright-format/1.0/
Upstream-Name: hapticd
Comment: The Python packages below /usr/lib/hapticd were taken from PyPI when this
 package was built. Each has a paragraph, which names the files with its terms.
"""
OF_LIBRARIES: Final = {
    "attr": "LGPL-2.1+",
    "bz2": "bzip2-1.0.6",
    "cap": "BSD-3-clause or GPL-2",
    "dw": "GPL-2+ or LGPL-3+",
    "elf": "GPL-2+ or LGPL-3+",
    "gfortran": "GPL-3+ with GCC-Runtime-Library exception",
    "lzma": "public-domain",
    "quadmath": "LGPL-2.1+",
    "scipy_openblas64_": "BSD-3-clause",
    "sodium": "ISC",
    "udev": "LGPL-2.1+",
    "usb": "LGPL-2.1+",
    "zmq": "MPL-2.0",
}
"""Libraries that wheels bring in NAME.libs, by their own pages."""


class UnknownLicenceError(Exception):
    """Nothing says on which terms something may be passed on."""


def licence(of: PackageMetadata) -> str:
    """In a few words. Raises UnknownLicenceError."""
    for key in ("License-Expression", "License"):
        said = (of.get(key) or "").strip()
        if said and "\n" not in said:
            return said
    classifiers = [each for each in of.get_all("Classifier") or () if each.startswith("License :: ")]
    if not classifiers:
        raise UnknownLicenceError(f"{of['Name']} {of['Version']}: its metadata names no licence")
    return " or ".join(each.rpartition(" :: ")[2] for each in classifiers)


def terms(distribution: Distribution) -> list[str]:
    """The files that have them, as metadata and RECORD name them."""
    files = [str(file) for file in distribution.files or ()]
    inside = [file for file in files if re.match(r"[^/]+\.dist-info/(.*/)?(LICEN|COPYING|NOTICE)", file)]
    return sorted(inside)


def top(distribution: Distribution) -> list[str]:
    """What stands in site-packages for it."""
    parts = {str(file).partition("/")[0] for file in distribution.files or () if not str(file).startswith("..")}
    return sorted(parts)


def paragraph(distribution: Distribution, site: str) -> str:
    of = distribution.metadata
    people = of.get("Author") or of.get("Author-email") or of.get("Maintainer") or f"the authors of {of['Name']}"
    said = licence(of)
    files = terms(distribution) or [f"{of['Name'].replace('-', '_')}-{of['Version']}.dist-info/METADATA"]
    lines = [
        "Files: " + "\n ".join(f"{site}/{part}" + ("" if "." in part else "/*") for part in top(distribution)),
        f"Copyright: {' '.join(people.split())}",
        f"License: {re.sub(r'[^A-Za-z0-9.+()-]+', '-', of['Name'])}",
        f" {of['Name']} {of['Version']}: {said}.",
        " Its terms stand in",
        *(f"  /{site}/{file}" for file in files),
    ]
    return "\n".join(lines) + "\n"


def libraries(site_packages: Path, site: str) -> Iterator[str]:
    """Paragraphs of the libraries beside the packages. Raises UnknownLicenceError."""
    for file in sorted(site_packages.glob("*.libs/lib*.so*")):
        name = re.split(r"(?:-\d[\w.]*)?-[0-9a-f]{6,}|\.so", file.name.removeprefix("lib"))[0]
        if name not in OF_LIBRARIES:
            raise UnknownLicenceError(f"{file.name}: no licence in OF_LIBRARIES of packaging/debian/copyright.py")
        yield (
            f"Files: {site}/{file.parent.name}/{file.name}\n"
            f"Copyright: the authors of lib{name}\n"
            f"License: lib{name}\n"
            f" {OF_LIBRARIES[name]}, unchanged, as linked into the wheel by its makers. GNU's licences stand\n"
            " in /usr/share/common-licenses.\n"
        )


def main(site_packages: Path) -> None:
    site = str(site_packages).partition("debian/hapticd/")[2]
    ours = Path("LICENSE").read_text(encoding="utf-8").splitlines()
    text = "\n".join(f" {line}" if line else " ." for line in ours[4:])
    found = sorted(distributions(path=[str(site_packages)]), key=lambda each: each.metadata["Name"].lower())
    print(HEAD)
    print(f"Files: *\nCopyright: {ours[2].removeprefix('Copyright (c) ')}\nLicense: Expat\n{text}\n")
    for distribution in found:
        if distribution.metadata["Name"] != "hapticd":
            print(paragraph(distribution, site))
    for file in sorted(Path("hapticd/web/static/vendor").glob("*/LICENSE")):
        print(
            f"Files: {site}/hapticd/web/static/vendor/{file.parent.name}/*\n"
            f"Copyright: the authors of {file.parent.name}\nLicense: {file.parent.name}-of-npm\n"
            + "\n".join(f" {line}" if line.strip() else " ." for line in file.read_text().splitlines())
            + "\n"
        )
    for each in libraries(site_packages, site):
        print(each)


if __name__ == "__main__":
    try:
        main(Path(sys.argv[1]))
    except UnknownLicenceError as error:
        sys.exit(str(error))
