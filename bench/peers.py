"""The peers of the core's kernels, compiled once a run: `bench/peers/*.c`, and what of `csrc/` they call.

They are compiled with the extension's own flags, so that both sides of a comparison are.
"""

from __future__ import annotations

import atexit
import importlib
import shutil
import sys
import tempfile
from functools import cache
from typing import Any

import cffi
import numpy as np
import numpy.typing as npt

from bench.report import ROOT, Floats
from hapticd._build import FLAGS
from hapticd.base.errors import HapticdError

FOLDER = ROOT / "bench" / "peers"
CORE = (
    "velocity",
    "error",
    "mode",
    "waveform",
    "strike_correction",
    "noise",
    "check_noise",
    "gaussian",
    "sim_time",
    "sim_solver",
    "sim_setup",
    "actuator",
    "operator",
)
_MODULE = "_hapticd_peers"


class Peers:
    """The compiled peers; every time is in nanoseconds a call's own loop took."""

    def __init__(self, ffi: Any, lib: Any) -> None:
        self.ffi, self.lib = ffi, lib

    def doubles(self, array: Floats) -> Any:
        """The memory of a contiguous array as `double *`."""
        return self.ffi.cast("double *", self.ffi.from_buffer(array))

    def memory(self, form: str, array: npt.NDArray[Any]) -> Any:
        """The same as another pointer."""
        return self.ffi.cast(form, self.ffi.from_buffer(array))

    # ---- Ringing modes

    def modes(self, kind: int, decay_per_s: Floats, omega_rad_per_s: Floats, period_s: float, size: int = 0) -> Any:
        """A bank of silent modes [n]; freed with its last reference."""
        decay, omega = (np.ascontiguousarray(values, dtype=np.float64) for values in (decay_per_s, omega_rad_per_s))
        bank = self.lib.peer_modes_new(kind, len(decay), period_s, self.doubles(decay), self.doubles(omega), size)
        if bank == self.ffi.NULL:
            raise MemoryError("no memory for the modes")
        return self.ffi.gc(bank, self.lib.peer_modes_free)

    def ring(self, bank: Any, ticks: int) -> tuple[Floats, float]:
        """What a bank gives in so many ticks, [ticks][2], and the ns that took."""
        out = np.empty((ticks, 2))
        return out, self.lib.peer_modes_run(bank, ticks, self.doubles(out))

    # ---- Velocity

    def velocity(
        self, kind: int, parameter: float, step_m: float, interval_s: Floats, position_m: Floats
    ) -> tuple[Floats, float]:
        """Velocities of positions [n][2], and the ns that took."""
        out = np.empty_like(position_m)
        pointers = [self.doubles(array) for array in (interval_s, position_m, out)]
        return out, self.lib.peer_velocity(kind, parameter, step_m, len(position_m), *pointers)

    def each_update_ns(self, step_m: float, interval_s: Floats, position_m: Floats) -> Floats:
        """Every update of csrc/tick/hd_velocity.c on its own; a negative step: the clock alone."""
        out = np.empty(len(position_m))
        pointers = [self.doubles(array) for array in (interval_s, position_m, out)]
        self.lib.peer_velocity_each_ns(step_m, len(position_m), *pointers)
        return out

    # ---- Times

    def onset(self, kind: int, period_s: float, depth_m: Floats, speed_m_per_s: Floats) -> tuple[Floats, float]:
        """How long before the tick each onset was, from depths [n][2] around it; the ns that took."""
        out = np.empty(len(depth_m))
        pointers = [self.doubles(array) for array in (depth_m, speed_m_per_s, out)]
        return out, self.lib.peer_onset(kind, len(depth_m), period_s, *pointers)

    def grooves(
        self, kind: int, period_s: float, spacing_m: float, along_m: Floats
    ) -> tuple[Floats, npt.NDArray[np.int64], float]:
        """Times and grooves of the strikes along a way [n], one position a tick; the ns that took."""
        capacity = 16 * len(along_m)
        times, which = np.empty(capacity), np.empty(capacity, dtype=np.int64)
        found = self.ffi.new("size_t *")
        taken = self.lib.peer_grooves(
            kind,
            len(along_m),
            period_s,
            spacing_m,
            self.doubles(along_m),
            capacity,
            self.doubles(times),
            self.memory("int64_t *", which),
            found,
        )
        if found[0] > capacity:
            raise RuntimeError("more strikes than there is room for")
        return times[: found[0]], which[: found[0]], taken

    # ---- Noise

    def noise(
        self, kind: int, coefficients: Floats, gains: Floats, which: npt.NDArray[np.uint8], seed: int
    ) -> tuple[Floats, float]:
        """Noise of the filters [nodes][order] that `which` [n] picks, and the ns that took."""
        table = np.ascontiguousarray(coefficients, dtype=np.float64)
        levels = np.ascontiguousarray(gains, dtype=np.float64)
        out = np.empty(len(which))
        taken = self.lib.peer_noise(
            kind,
            table.shape[-1],
            self.doubles(table),
            self.doubles(levels),
            len(which),
            self.memory("uint8_t *", which),
            seed,
            self.doubles(out),
        )
        return out, taken

    def lattice(self, noise: Any, numbers: Floats, speed_m_per_s: Floats, force_n: Floats) -> tuple[Floats, float]:
        """csrc/tick/hd_noise.c on a `struct hd_noise` of hapticd.base.core's ffi, and the ns that took."""
        from hapticd.base.core import ffi

        out = np.empty(len(speed_m_per_s))
        where = self.ffi.cast("const void *", int(ffi.cast("uintptr_t", noise)))
        pointers = [self.doubles(array) for array in (speed_m_per_s, force_n, out)]
        return out, self.lib.peer_noise_lattice(where, self.doubles(numbers), len(out), *pointers)

    # ---- The joystick

    def joystick(
        self, kind: int, handle: dict[str, float], period_s: float, waypoints: Floats, force_n: Floats
    ) -> tuple[Floats, float]:
        """Positions [n + 1] under a force [n] that is held from tick to tick; the ns that took."""
        out = np.empty(len(force_n) + 1)
        taken = self.lib.peer_joystick(
            kind,
            self.ffi.new("struct peer_handle *", handle),
            period_s,
            len(waypoints),
            self.doubles(np.ascontiguousarray(waypoints)),
            len(force_n),
            self.doubles(force_n),
            self.doubles(out),
        )
        if taken < 0:
            raise RuntimeError("the core refuses the device")
        return out, taken


@cache
def compiled() -> Peers:
    """The peers, built in a temporary folder that goes when the process ends. Raises HapticdError without compiler."""
    if all(shutil.which(name) is None for name in ("cc", "gcc", "clang")):
        raise HapticdError("there is no C compiler to build the alternatives with; install gcc or clang")
    folder = tempfile.TemporaryDirectory(prefix="hapticd-bench-")
    atexit.register(folder.cleanup)
    builder = cffi.FFI()
    builder.cdef((FOLDER / "peers.h").read_text(encoding="utf-8"))
    builder.set_source(
        _MODULE,
        '#include <stddef.h>\n#include <stdint.h>\n#include "peers.h"',
        sources=[
            str(path)
            for path in (*sorted(FOLDER.glob("*.c")), *(next((ROOT / "csrc").rglob(f"hd_{x}.c")) for x in CORE))
        ],
        include_dirs=[str(ROOT / "csrc"), str(FOLDER)],
        define_macros=[("_GNU_SOURCE", "1")],
        extra_compile_args=FLAGS,
        libraries=["m"],
    )
    builder.compile(tmpdir=folder.name)
    sys.path.insert(0, folder.name)
    try:
        module = importlib.import_module(_MODULE)
    finally:
        sys.path.remove(folder.name)
    return Peers(module.ffi, module.lib)
