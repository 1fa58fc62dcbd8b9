"""What pyproject.toml cannot say: the C extension, the abi3 tag of its wheel, and what is made for share/."""

import os
import shutil
import sys
import sysconfig
from pathlib import Path
from typing import ClassVar

from setuptools import Command, setup
from setuptools.command.build import build
from setuptools.command.build_ext import build_ext
from setuptools.errors import PlatformError

ROOT = Path(__file__).resolve().parent


class BuildShare(Command):
    """Makes man pages and completion scripts, and has them installed below the prefix."""

    description = "make man pages and completion scripts (below build/share)"
    user_options: ClassVar = []

    def initialize_options(self) -> None:
        self.build_base = None

    def finalize_options(self) -> None:
        self.set_undefined_options("build", ("build_base", "build_base"))

    def run(self) -> None:
        sys.path.insert(0, str(ROOT))
        try:
            from hapticd._share import write
        except ModuleNotFoundError as error:
            raise PlatformError(f"{error.name} is not installed: pyproject.toml says what a build requires") from None
        folders: dict[str, list[str]] = {}
        for name in write(Path(self.build_base)):
            folders.setdefault(os.path.dirname(name), []).append(os.path.join(self.build_base, name))
        self.distribution.data_files = list(folders.items())


class Build(build):
    """The usual build, and the files of share/."""

    sub_commands: ClassVar = [*build.sub_commands, ("build_share", None)]


class BuildExtension(build_ext):
    """The usual compilation, after one clear line for each thing that is missing."""

    def build_extensions(self) -> None:
        if sys.platform != "linux":
            raise PlatformError(f"hapticd needs Linux: this is {sys.platform}")
        compiler = self.compiler.compiler_so[0]
        if shutil.which(compiler) is None:
            raise PlatformError(f"no C compiler ({compiler}) found: install gcc (Debian, Ubuntu: build-essential)")
        if not Path(sysconfig.get_path("include"), "Python.h").exists():
            raise PlatformError("Python's C headers are missing: install python3-dev (Debian, Ubuntu)")
        super().build_extensions()


setup(
    cffi_modules=["hapticd/_build.py:ffibuilder"],
    cmdclass={"build": Build, "build_ext": BuildExtension, "build_share": BuildShare},
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
)
