"""Velocity estimators side by side: error at constant speed, under deceleration, after an impact; and cost.

    python bench/velocity.py [--rate 10000] [--step 20e-6]

Compiles `csrc/hd_velocity.c` and its peers (`velocity_peers.c`) into a temporary directory. All trials
are seeded. A position is the truth rounded to the encoder's step; every trial has its own speed and phase.
Errors are estimate minus truth.
"""

from __future__ import annotations

import argparse
import importlib
import platform
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cffi
import numpy as np
import numpy.typing as npt

ROOT = Path(__file__).resolve().parent.parent
Array = npt.NDArray[np.float64]
Estimator = Callable[[float, Array, Array], Array]

CDEF = """
int hd_velocity_run(double, size_t, const double *, const double *, double *, double *);
void peer_backward(size_t, const double *, const double *, double *);
void peer_foaw(int, size_t, double, size_t, const double *, const double *, double *);
void peer_update_ns(double, size_t, const double *, const double *, double *);
"""
WARM_S = 0.04
TRIALS = 300


def build(folder: str) -> tuple[Any, Any]:
    """Compile the estimators into `folder`; returns cffi's (ffi, lib)."""
    builder = cffi.FFI()
    builder.cdef(CDEF)
    builder.set_source(
        "_velocity_peers",
        CDEF,
        sources=[str(ROOT / name) for name in ("bench/velocity_peers.c", "csrc/hd_velocity.c", "csrc/hd_error.c")],
        include_dirs=[str(ROOT / "csrc")],
        extra_compile_args=["-std=c11", "-O2", "-ffp-contract=off", "-D_GNU_SOURCE"],
        libraries=["m"],
    )
    builder.compile(tmpdir=folder)
    sys.path.insert(0, folder)
    module = importlib.import_module("_velocity_peers")
    return module.ffi, module.lib


class Library:
    """The compiled estimators as functions of (step_m, interval_s [n], position_m [n, 2]) -> m/s [n, 2]."""

    def __init__(self, folder: str) -> None:
        self.ffi, self.lib = build(folder)

    def pointer(self, array: Array) -> Any:
        """The array's memory as `double *`."""
        return self.ffi.cast("double *", self.ffi.from_buffer(array))

    def ours(self, step_m: float, interval_s: Array, position_m: Array) -> tuple[Array, Array]:
        """Velocity and half width."""
        velocity, width = np.empty_like(position_m), np.empty_like(position_m)
        arguments = [self.pointer(a) for a in (interval_s, position_m, velocity, width)]
        if self.lib.hd_velocity_run(step_m, len(position_m), *arguments) != 0:
            raise ValueError("hd_velocity_run refused its arguments")
        return velocity, width

    def line_up(self) -> dict[str, Estimator]:
        """All estimators by name."""

        def backward(step_m: float, interval_s: Array, position_m: Array) -> Array:
            velocity = np.empty_like(position_m)
            self.lib.peer_backward(len(position_m), *map(self.pointer, (interval_s, position_m, velocity)))
            return velocity

        def foaw(best: int, window: int) -> Estimator:
            def run(step_m: float, interval_s: Array, position_m: Array) -> Array:
                velocity = np.empty_like(position_m)
                arguments = map(self.pointer, (interval_s, position_m, velocity))
                self.lib.peer_foaw(best, window, step_m, len(position_m), *arguments)
                return velocity

            return run

        return {
            "backward difference": backward,
            "FOAW end fit, 16": foaw(0, 16),
            "FOAW end fit, 64": foaw(0, 64),
            "FOAW best fit, 16": foaw(1, 16),
            "FOAW best fit, 64": foaw(1, 64),
            "hd_velocity": lambda s, i, p: self.ours(s, i, p)[0],
        }


def path(rate_hz: float, duration_s: float) -> tuple[Array, Array]:
    """Time stamps [n] and intervals [n] of `duration_s` at `rate_hz`."""
    time_s = np.arange(round(duration_s * rate_hz)) / rate_hz
    return time_s, np.full(len(time_s), 1.0 / rate_hz)


def quantise(position_m: Array, step_m: float) -> Array:
    """What the encoder says."""
    return np.ascontiguousarray(np.round(position_m / step_m) * step_m)


def constant(estimate: Estimator, rate_hz: float, step_m: float) -> str:
    """Median, 99 % and worst relative error at 0.05 to 0.5 m/s."""
    rng = np.random.default_rng(1)
    time_s, interval_s = path(rate_hz, 2 * WARM_S)
    errors = []
    for _ in range(TRIALS):
        speed = np.exp(rng.uniform(np.log(0.05), np.log(0.5), 2))
        position = quantise(time_s[:, None] * speed + rng.uniform(0, step_m, 2), step_m)
        errors.append((estimate(step_m, interval_s, position) / speed - 1.0)[time_s >= WARM_S].ravel())
    error = 100 * np.abs(np.concatenate(errors))
    return f"{np.median(error):6.2f} {np.percentile(error, 99):7.2f} {error.max():7.2f}"


def contact(estimate: Estimator, rate_hz: float, step_m: float, deceleration: float) -> str:
    """Mean and RMS error (mm/s) at contact, 0.05 to 0.3 m/s, 2 to 30 ms after a deceleration began."""
    rng = np.random.default_rng(2)
    time_s, interval_s = path(rate_hz, WARM_S + 0.05)
    errors = []
    for _ in range(TRIALS):
        held = rng.uniform(0.002, 0.03, 2)
        at_contact = rng.uniform(0.05, 0.3, 2)
        since = np.clip(time_s[:, None] - (time_s[-1] - held), 0.0, None)
        position = (at_contact + deceleration * held) * time_s[:, None] - 0.5 * deceleration * since**2
        velocity = estimate(step_m, interval_s, quantise(position + rng.uniform(0, step_m, 2), step_m))
        errors.append(velocity[-1] - at_contact)
    error = 1e3 * np.concatenate(errors)
    return f"{error.mean():+7.2f} {np.sqrt(np.mean(error**2)):6.2f}"


def impact(estimate: Estimator, rate_hz: float, step_m: float) -> str:
    """Speed 0.3 to -0.15 m/s at once: samples until within 0.045 m/s (median, worst), RMS error (mm/s).

    The RMS error is that from 1 to 10 ms after.
    """
    rng = np.random.default_rng(3)
    time_s, interval_s = path(rate_hz, WARM_S + 0.03)
    samples, errors = [], []
    for _ in range(TRIALS):
        since = time_s[:, None] - (WARM_S + rng.uniform(0, 1.0 / rate_hz, 2))
        position = np.where(since < 0, 0.3, -0.15) * since + rng.uniform(0, step_m, 2)
        error = estimate(step_m, interval_s, quantise(position, step_m)) + 0.15
        for a in range(2):
            after = since[:, a] > 0
            samples.append(int(np.argmax(np.abs(error[after, a]) < 0.045)) + 1)
            errors.append(error[(since[:, a] > 1e-3) & (since[:, a] < 1e-2), a])
    rms = 1e3 * np.sqrt(np.mean(np.concatenate(errors) ** 2))
    return f"{np.median(samples):5.0f} {max(samples):5d} {rms:7.2f}"


def motions(rate_hz: float, count: int) -> dict[str, Array]:
    """What the cost is measured on, [count, 2]."""
    time_s = np.arange(count) / rate_hz
    turn = 2 * np.pi * time_s
    return {
        "rest": np.zeros((count, 2)),
        "0.05, 0 m/s": np.stack((0.05 * time_s, 0 * time_s), 1),
        "0.1, 0.3 m/s": np.stack((0.1 * time_s, 0.3 * time_s), 1),
        "1 Hz circle": 0.05 * np.stack((np.sin(turn), np.cos(turn)), 1),
        "3 Hz circle": 0.04 * np.stack((np.sin(3 * turn), np.cos(3 * turn)), 1),
    }


def best_half_width(position_m: Array, interval_s: float, step_m: float) -> float:
    """Half the width of the set of slopes of one axis' samples [n], from all pairs (m/s)."""
    n = len(position_m)
    later, earlier = np.tril_indices(n, -1)
    run = (later - earlier) * interval_s
    rise = position_m[later] - position_m[earlier]
    return float(0.5 * (((rise + step_m) / run).min() - ((rise - step_m) / run).max()))


def widths(library: Library, rate_hz: float, step_m: float) -> str:
    """Median half width at constant speed: ours, and what the newest 64 samples allow at all (mm/s)."""
    rng = np.random.default_rng(4)
    time_s, interval_s = path(rate_hz, 2 * WARM_S)
    ours: list[float] = []
    best: list[float] = []
    for _ in range(TRIALS):
        speed = np.exp(rng.uniform(np.log(0.05), np.log(0.5), 2))
        position = quantise(time_s[:, None] * speed + rng.uniform(0, step_m, 2), step_m)
        ours.extend(library.ours(step_m, interval_s, position)[1][-1])
        best.extend(best_half_width(position[-64:, a], 1.0 / rate_hz, step_m) for a in range(2))
    return f"{1e3 * np.median(ours):.2f} (64 samples allow {1e3 * np.median(best):.2f})"


def cost_ns(estimate: Estimator, step_m: float, interval_s: Array, position_m: Array) -> float:
    """Nanoseconds an update of both axes, median of runs of the whole path."""
    runs = []
    for _ in range(7):
        start = time.perf_counter_ns()
        estimate(step_m, interval_s, position_m)
        runs.append((time.perf_counter_ns() - start) / len(position_m))
    return float(np.median(runs))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description="velocity estimators: error and cost side by side")
    parser.add_argument("--rate", type=float, default=10_000.0, help="samples a second")
    parser.add_argument("--step", type=float, default=20e-6, help="encoder step, m")
    options = parser.parse_args()
    rate_hz, step_m = options.rate, options.step
    with tempfile.TemporaryDirectory() as folder:
        library = Library(folder)
        estimators = library.line_up()
        print(f"{rate_hz:g} Hz, step {step_m * 1e6:g} um, {platform.machine()}, {TRIALS} trials of two axes")
        print(
            "\nerror: constant % (median, 99 %, worst) | at contact, mm/s (mean, rms) at 1, 3, 10 m/s^2 |"
            " impact (samples: median, worst; rms mm/s)"
        )
        for name, estimate in estimators.items():
            decelerations = " | ".join(contact(estimate, rate_hz, step_m, a) for a in (1.0, 3.0, 10.0))
            steady, struck = constant(estimate, rate_hz, step_m), impact(estimate, rate_hz, step_m)
            print(f"{name:20s} {steady} | {decelerations} | {struck}", flush=True)
        print(f"\nhalf width at constant speed, mm/s, median: {widths(library, rate_hz, step_m)}")
        count = 20_000
        paths = {name: quantise(p + 1.23e-6, step_m) for name, p in motions(rate_hz, count).items()}
        interval_s = np.full(count, 1.0 / rate_hz)
        print("\ncost, ns an update of both axes, mean over the path, median of 7: " + ", ".join(paths))
        for name, estimate in estimators.items():
            costs = " ".join(f"{cost_ns(estimate, step_m, interval_s, p):8.1f}" for p in paths.values())
            print(f"{name:20s} {costs}", flush=True)
        exact = cost_ns(estimators["hd_velocity"], 0.0, interval_s, paths["1 Hz circle"])
        print(f"{'hd_velocity, step 0':20s} {exact:8.1f} on exact positions (argument checks included)")
        ns = np.empty(count)
        print("\nsingle updates of hd_velocity, ns less the clock's own: median, 99 %, 99.9 %")
        for name, position in paths.items():
            arguments = [library.pointer(a) for a in (interval_s, position, ns)]
            library.lib.peer_update_ns(-1.0, count, *arguments)
            clock = float(np.median(ns))
            library.lib.peer_update_ns(step_m, count, *arguments)
            p50, p99, p999 = np.percentile(ns, (50, 99, 99.9)) - clock
            print(f"{name:20s} {p50:6.0f} {p99:6.0f} {p999:6.0f}")


if __name__ == "__main__":
    main()
