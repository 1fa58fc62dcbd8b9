"""Build `hapticd._core`: every file of csrc/, behind the boundary that csrc/api/ declares.

Run by setuptools (setup.py), never imported by the package. cffi and _stub.py, which makes the types for mypy, read the
same headers as the C compiler, so that they cannot disagree. HAPTICD_WERROR=1 turns warnings into errors; it is not the
default, because newer compilers have new warnings.
"""

import os
import runpy
from pathlib import Path

from cffi import FFI

SOURCE_ROOT = Path(__file__).resolve().parent.parent
# Relative, because setuptools refuses absolute paths in its file lists; it runs in SOURCE_ROOT.
C_SOURCES = sorted(str(path.relative_to(SOURCE_ROOT)) for path in SOURCE_ROOT.glob("csrc/*/*.c"))
C_HEADERS = sorted(str(path.relative_to(SOURCE_ROOT)) for path in SOURCE_ROOT.glob("csrc/*/*.h"))
WARNING_FLAGS = ["-Wall", "-Wextra", "-Wshadow", "-Wdouble-promotion"]
# Results must be the same bits on every run and at every optimisation level: no fused multiply-add, and no fast-math
# even if the environment's CFLAGS ask for it. libm's errno is not used. No vectorization of straight-line code: a
# vector load after two scalar stores stalls, which makes a tick a third slower (docs/adr/0002).
COMPILER_FLAGS = [
    "-std=c11",
    "-O2",
    "-fno-tree-slp-vectorize",
    "-fno-fast-math",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-fvisibility=hidden",
]

ERROR_FLAGS = ["-Werror"] if os.environ.get("HAPTICD_WERROR") == "1" else []

API_HEADER = "".join(
    (SOURCE_ROOT / "csrc" / "api" / name).read_text(encoding="utf-8")
    for name in ("hd_api.h", "hd_api_device.h", "hd_api_servo.h")
)
STUB_PATH = SOURCE_ROOT / "hapticd" / "_core.pyi"

ffibuilder = FFI()
ffibuilder.cdef(API_HEADER)
ffibuilder.set_source(
    "hapticd._core",
    '#include "api/hd_core.h"',
    sources=C_SOURCES,
    depends=[*C_HEADERS, "hapticd/_build.py"],
    include_dirs=["csrc"],
    define_macros=[("_GNU_SOURCE", "1")],
    extra_compile_args=[*COMPILER_FLAGS, *WARNING_FLAGS, *ERROR_FLAGS],
    libraries=["m", "pthread"],
)

stub = runpy.run_path(str(SOURCE_ROOT / "hapticd" / "_stub.py"))["stub_of"](API_HEADER)
if not STUB_PATH.exists() or STUB_PATH.read_text(encoding="utf-8") != stub:
    STUB_PATH.write_text(stub, encoding="utf-8")

if __name__ == "__main__":
    ffibuilder.compile(verbose=True)
