"""`hapticd.render` and `hapticd.simulate` give the same bits as when the hashes below were taken.

A change that is to leave every force as it is (files that move, functions that are cut in stages) is held to that here.
A change of the physics takes the hashes anew and says so in CHANGELOG.md: `python -m tests.rendering.test_same_bits`
prints
them. The paths are made of integers and one division, so that they have the same bits everywhere. Exponentials, sines
and eigenvalues are the library's of the machine: where those differ from the ones of the hashes, nothing can be said.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pytest

import hapticd

ROOT = Path(__file__).resolve().parents[2]
SCENES: Final = {
    "comb": "stroke",
    "corner": "corner",
    "fields": "push",
    "friction": "stroke",
    "materials": "taps",
    "membrane": "push",
    "sandpaper": "stroke",
    "solids": "around",
}
"""Shipped scenes, each with an operator."""

MATERIALS: Final[dict[str, Any]] = {
    "tile": {
        "stiffness_n_per_m": 900,
        "tap": {
            "amplitudes": [[0.05, 60], [0.2, 120], [0.4, 170]],
            "mode_table": {
                "speeds_m_per_s": [0.1, 0.4],
                "frequencies_hz": [300, 320],
                "decay_times_s": [0.006, 0.01],
            },
        },
    },
    "cushion": {
        "stiffness_n_per_m": 400,
        "damping_n_s_per_m": 0.5,
        "tap": {
            "attack_slope_per_s": 60,
            "attack": "first_peak",
            "waveform": {"rate_hz": 2000, "samples": [0, 0.18, 0.62, 0.97, 1, 0.74, 0.41, 0.17, 0.05, -0.04, 0]},
        },
    },
    "drum": {
        "stiffness_n_per_m": 300,
        "tap": {"attack_slope_per_s": 200, "frequency_hz": 90, "decay_time_s": 0.02, "attack": "first_peak"},
        "rupture": {
            "depth_m": 0.003,
            "amplitude_m_per_s2": 30,
            "decay_rate_per_s": 200,
            "angular_frequency_rad_per_s": 900,
            "heals": True,
        },
    },
    "reed": {
        "stiffness_n_per_m": 800,
        "friction": {"coefficient": 0.2, "stiffness_n_per_m": 500},
        "texture": {
            "kind": "grooves",
            "display": "vibration",
            "spacing_m": 0.002,
            "width_m": 0.0005,
            "velocity_gain_per_s": 60,
            "decay_time_s": 0.003,
            "frequency_table": {
                "speeds_m_per_s": [0.05, 0.2],
                "forces_n": [0.5, 2],
                "frequencies_hz": [[180, 210], [240, 300]],
            },
        },
    },
    "ridges": {
        "stiffness_n_per_m": 700,
        "texture": {"kind": "grooves", "display": "geometry", "spacing_m": 0.004, "width_m": 0.002, "depth_m": 0.0005},
    },
    "brakes": {
        "stiffness_n_per_m": 700,
        "friction": {"coefficient": 0.3, "stiffness_n_per_m": 600},
        "texture": {
            "kind": "grooves",
            "display": "damping",
            "spacing_m": 0.004,
            "width_m": 0.002,
            "damping_n_s_per_m": 3,
        },
    },
    "grit": {
        "stiffness_n_per_m": 800,
        "texture": {
            "kind": "stochastic",
            "peak_hz": 160,
            "mean_hz": 210,
            "velocity_gain_per_s": 24,
            "force_gain_m_per_s2_per_n": 2.4,
        },
    },
}
PATCHES: Final = ["reed", "ridges", "brakes", "grit", "tile"]
SCENE: Final[dict[str, Any]] = {
    "display": {"force": True, "vibration": True},
    "objects": {
        "table": {
            "kind": "wall",
            "point_m": [0, 0],
            "normal": [0, 1],
            "material": "wood",
            "patches": [
                {"from_m": 0.01 * k - 0.03, "to_m": 0.01 * k - 0.02, "material": name} for k, name in enumerate(PATCHES)
            ],
        },
        "side": {"kind": "wall", "point_m": [0.035, 0], "normal": [-1, 0], "material": "steel"},
        "block": {
            "kind": "box",
            "center_m": [-0.02, 0.004],
            "size_m": [0.01, 0.008],
            "angle_rad": 0.3,
            "material": "tile",
        },
        "peg": {"kind": "disc", "center_m": [0.005, 0.006], "radius_m": 0.005, "material": "cushion"},
        "skin": {"kind": "membrane", "center_m": [0.02, 0.01], "normal": [0, 1], "width_m": 0.02, "material": "drum"},
        "pull": {"kind": "spring", "center_m": [0, 0], "stiffness_n_per_m": 20, "damping_n_s_per_m": 0.5},
        "honey": {"kind": "viscous", "damping_n_s_per_m": 1},
        "push": {"kind": "constant", "force_n": [0, -0.2]},
    },
}
EVERYTHING: Final[dict[str, Any]] = {"materials": MATERIALS, "scene": SCENE}
HANDLE: Final[dict[str, Any]] = {
    "handle": {"mass_kg": 0.06, "damping_n_s_per_m": 0.4},
    "grip": {"mass_kg": 0.01, "damping_n_s_per_m": 2.0, "stiffness_n_per_m": 200.0},
}
SLOW: Final[dict[str, Any]] = {
    "actuator": {"bandwidth_hz": 300, "order": 2},
    "sim": {"actuator": {"bandwidth_hz": 300, "order": 2}, "report_interval_s": 0.001, "report_delay_s": 0.001},
}


def triangle(tick: npt.NDArray[np.int64], period: int) -> npt.NDArray[np.float64]:
    """From -1 to 1 and back in `period` ticks."""
    place = tick % period
    folded = np.where(2 * place < period, 4 * place - period, 3 * period - 4 * place)
    return folded / period


def path(count: int, first: int, second: int) -> npt.NDArray[np.float64]:
    """(count, 2) over table, side, block, peg and skin."""
    tick = np.arange(count, dtype=np.int64)
    return np.stack([0.04 * triangle(tick, first), 0.004 + 0.009 * triangle(tick + second // 4, second)], axis=1)


def rendered(rate_hz: float, **device: object) -> bytes:
    config = EVERYTHING | ({"device": {"kind": "sim", **device}} if device else {})
    run = hapticd.render(config, path(24_000, 9_700, 1_130), rate_hz)
    return run.tobytes()


def simulated(scene: str, operator: str, **device: object) -> bytes:
    config: Any = str(ROOT / "config" / "scenes" / f"{scene}.yaml")
    if device:
        config = hapticd.load_config(config).model_dump(mode="json", exclude_unset=True)
        config["device"] = {"kind": "sim", **device}
    return hapticd.simulate(config, str(ROOT / "config" / "operators" / f"{operator}.yaml"), 1.5).tobytes()


def controlled() -> bytes:
    """With the passivity controller."""
    config = EVERYTHING | {"scene": SCENE | {"passivity": "control"}}
    waypoints = [[0.1 * k, 0.03 * (-1) ** (k // 2), 0.012 - 0.016 * (k % 2)] for k in range(16)]
    return hapticd.simulate(config, waypoints, 1.5).tobytes()


CASES: Final[dict[str, Callable[[], bytes]]] = {
    "rendered at 10 kHz": lambda: rendered(10_000),
    "rendered at 4 kHz": lambda: rendered(4_000),
    "rendered at 1 kHz": lambda: rendered(1_000),
    "compensated": lambda: rendered(10_000, compensation="full", **HANDLE),
    "lowered": lambda: rendered(1_000, undisplayable="lower"),
    "controlled": controlled,
    "behind a slow actuator": lambda: simulated("materials", "taps", compensation="full", **SLOW),
    "behind a link": lambda: simulated("comb", "stroke", sim={"link": {"rate_hz": 1000}}),
    **{f"{scene}, simulated": lambda scene=scene, by=by: simulated(scene, by) for scene, by in SCENES.items()},
}
HASHES: Final[dict[str, str]] = {
    "rendered at 10 kHz": "569b7c383a03ffc1",
    "rendered at 4 kHz": "32d06172b892ba99",
    "rendered at 1 kHz": "09d5987b6a36fa4e",
    "compensated": "88ed0b21ce3969fd",
    "lowered": "7ae68ff265945769",
    "controlled": "11fd8d997debc193",
    "behind a slow actuator": "8bdccb3e4322c70c",
    "behind a link": "c45e58a40ae809f2",
    "comb, simulated": "87dd22d30dc35e4e",
    "corner, simulated": "415fbf018d452e9e",
    "fields, simulated": "5c2e8236b8ab375c",
    "friction, simulated": "f89e12d7d022b0c6",
    "materials, simulated": "b9299cb224116873",
    "membrane, simulated": "76135273b076b196",
    "sandpaper, simulated": "ff697dcf82eec3a8",
    "solids, simulated": "cd5d285464229ebf",
}
BY_LAPACK: Final = ("compensated", "behind a slow actuator")
"""Those that stand on eigenvalues and least squares as well: compensation is designed by them."""
LIBM: Final = "d65eaa84c8275576"
LAPACK: Final = "59f8661f25d14eba"
"""Of the functions of the libraries that the hashes stand on."""


def hash_of(*numbers: npt.ArrayLike) -> str:
    digest = hashlib.sha256()
    for each in numbers:
        digest.update(np.ascontiguousarray(each).tobytes())
    return digest.hexdigest()[:16]


def libm() -> str:
    """A hash of exponentials and sines, which no function of the project makes."""
    x = [k / 97 for k in range(-400, 400)]
    plain = [f(each) for f in (math.exp, math.sin, math.cos, math.tanh) for each in x]
    plain += [math.pow(abs(a) + 0.1, 1.7) for a in x] + [math.log(abs(a) + 0.1) for a in x]
    spread = np.array(x)
    return hash_of(plain, np.exp(spread), np.sin(spread), np.cos(spread), np.sqrt(np.abs(spread)))


def lapack() -> str:
    """The same of eigenvalues, solutions and least squares."""
    square = (np.arange(144.0).reshape(12, 12) * 37 % 29) / 29 + np.eye(12)
    solved = np.linalg.solve(square, np.arange(12.0))
    return hash_of(np.linalg.eigvals(square), solved, np.linalg.lstsq(square[:, :5], solved)[0], square @ square)


@pytest.mark.parametrize("case", CASES)
def test_forces_have_the_same_bits(case: str) -> None:
    if libm() != LIBM or (case in BY_LAPACK and lapack() != LAPACK):
        pytest.skip("the mathematical libraries of this machine give other bits than those of the hashes")
    assert hashlib.sha256(CASES[case]()).hexdigest()[:16] == HASHES[case]


if __name__ == "__main__":
    print(f'LIBM = "{libm()}", LAPACK = "{lapack()}"')
    for name, make in CASES.items():
        print(f'    "{name}": "{hashlib.sha256(make()).hexdigest()[:16]}",')
