"""Build `hapticd._core`: every file of csrc/, behind the boundary that csrc/api/hd_api.h declares.

Run by setuptools (setup.py), never imported by the package. cffi reads the very header that the C compiler
reads, so the two cannot disagree; so does _stub.py, which makes the types for mypy. HAPTICD_WERROR=1 turns warnings
into errors; a user's build never fails for a warning that a newer compiler has learned.
"""

import os
import runpy
from pathlib import Path

from cffi import FFI

ROOT = Path(__file__).resolve().parent.parent
# Relative, because setuptools refuses absolute paths in its file lists; it runs in ROOT.
SOURCES = sorted(str(path.relative_to(ROOT)) for path in ROOT.glob("csrc/*/*.c"))
HEADERS = sorted(str(path.relative_to(ROOT)) for path in ROOT.glob("csrc/*/*.h"))
WARNINGS = ["-Wall", "-Wextra", "-Wshadow", "-Wdouble-promotion"]
# Results must be the same bits on every run and at every optimisation level: no contraction into fused
# operations, nothing of fast-math even if the environment's CFLAGS ask for it. Nobody looks at libm's errno.
# Two doubles that were just stored one by one and are loaded as one vector stall until the stores are
# through; a tick is made of such pairs, so packing straight-line code costs it a third (docs/adr/0002).
FLAGS = [
    "-std=c11",
    "-O2",
    "-fno-tree-slp-vectorize",
    "-fno-fast-math",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-fvisibility=hidden",
]

API = (ROOT / "csrc" / "api" / "hd_api.h").read_text(encoding="utf-8")
STUB = ROOT / "hapticd" / "_core.pyi"

ffibuilder = FFI()
ffibuilder.cdef(API)
ffibuilder.set_source(
    "hapticd._core",
    '#include "api/hd_core.h"',
    sources=SOURCES,
    depends=[*HEADERS, "hapticd/_build.py"],
    include_dirs=["csrc"],
    define_macros=[("_GNU_SOURCE", "1")],
    extra_compile_args=[*FLAGS, *WARNINGS, *(["-Werror"] if os.environ.get("HAPTICD_WERROR") == "1" else [])],
    libraries=["m", "pthread"],
)

stub = runpy.run_path(str(ROOT / "hapticd" / "_stub.py"))["stub_of"](API)
if not STUB.exists() or STUB.read_text(encoding="utf-8") != stub:
    STUB.write_text(stub, encoding="utf-8")

if __name__ == "__main__":
    ffibuilder.compile(verbose=True)
