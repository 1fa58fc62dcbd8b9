"""Random taps in the closed loop, with and without compensation: contacts and displayed errors.

    python -m bench.kept_taps [--taps 2000] [--seed 35] [--processes 2]

A hand comes at a constant speed and stops at a depth behind the surface; it holds the handle with mass, damper and
spring. Materials, hands, speeds and depths are random. The displayed motion is that of the handle minus that of the
same tap without vibration. Its error is the RMS of the difference from the library's waveform, from 30 Hz to 0.4 of the
rate, over the RMS of the waveform. Joystick and encoder are exact: without dry friction and steps.

No tap that stays in contact with `off` may leave the surface with `full`. Of those that stay without vibration as well,
none may have an error above MAX_ERROR_RATIO times that with `off`. Otherwise the run fails.
"""

from __future__ import annotations

import argparse
import math
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from hapticd.base.core import EventKind, lib, pointer
from hapticd.config.configuration import load_config
from hapticd.config.materials import shipped_materials
from hapticd.config.modes import Mode
from hapticd.rendering.compensation import ERROR_BAND_LOW_HZ, ERROR_BAND_RATE_FRACTION
from hapticd.rendering.displayed_error import PARTS_PER_PERIOD, band_error, waveform
from hapticd.rendering.joystick import new_operator, new_sim
from hapticd.rendering.offline import CompiledScene, Simulation

Floats = npt.NDArray[np.float64]

RATE_HZ: Final = 10_000.0
FINE_RATE_HZ: Final = RATE_HZ * PARTS_PER_PERIOD
"""Rate of the accelerations that are compared."""
LEAD_S: Final = 0.1
"""Time before the onset."""
COMPARED_S: Final = 0.33
"""Time from the onset that is compared."""
TAPPED_MATERIALS: Final = ("wood", "acrylic", "delrin", "aluminum", "glass", "cast_iron", "steel")
MAX_KEPT_ERROR: Final = 0.1
MAX_ERROR_RATIO: Final = 1.02


@dataclass(frozen=True, slots=True)
class Tap:
    """A random tap."""

    material: dict[str, Any]
    hand: tuple[float, float, float]
    """Mass (kg), damping (N s/m) and stiffness (N/m)."""
    speed_m_per_s: float
    depth_m: float


@dataclass(frozen=True, slots=True)
class Displayed:
    """A tap as it is displayed."""

    contacts: int
    error: float


def random_tap(random: np.random.Generator) -> Tap:
    """Return a tap of a shipped material, or of a mode between 40 and 400 Hz on 300 to 3000 N/m."""

    def between(low: float, high: float) -> float:
        return float(np.exp(random.uniform(math.log(low), math.log(high))))

    if random.random() < 0.6:
        shipped = shipped_materials()[TAPPED_MATERIALS[random.integers(len(TAPPED_MATERIALS))]].to_dict()
        material = {key: shipped[key] for key in ("stiffness_n_per_m", "tap")}
    else:
        frequency_hz, decay_time_s = between(40, 400), between(0.001, 0.01)
        w, b = 2 * math.pi * frequency_hz, 1 / decay_time_s
        # The part of the approach speed that the tap turns round.
        slope = float(random.uniform(0.05, 0.7)) * (w * w + b * b) / w
        tap = {"frequency_hz": frequency_hz, "decay_time_s": decay_time_s, "attack_slope_per_s": slope}
        material = {"stiffness_n_per_m": between(300, 3000), "tap": tap}
    hand = (between(0.003, 0.03), between(1.5, 12), between(80, 800))
    return Tap(material, hand, between(0.05, 0.5), between(0.0005, 0.02))


def displayed(tap: Tap) -> tuple[int, Displayed, Displayed]:
    """Return the contacts of a tap without vibration, and the tap with compensation `off` and `full`."""
    mass, damping, stiffness = tap.hand
    sim = {
        "coulomb_friction_n": 0,
        "encoder_step_m": 0,
        "force_step_n": 0,
        "max_force_n": 100,
        "hand": {"mass_kg": mass, "damping_n_s_per_m": damping, "stiffness_n_per_m": stiffness},
    }
    still_s = LEAD_S + tap.depth_m / tap.speed_m_per_s
    path = [[0, 0, tap.speed_m_per_s * LEAD_S], [still_s, 0, -tap.depth_m], [still_s + 1, 0, -tap.depth_m]]

    def run(compensation: str, vibration: bool) -> tuple[Any, Floats]:
        """Return the events of contact, and the handle's speed at FINE_RATE_HZ."""
        scene = CompiledScene(
            {
                "servo": {"rate_hz": RATE_HZ},
                "device": {"compensation": compensation, "sim": sim, "max_force_n": 100},
                "materials": {"it": tap.material},
                "scene": {
                    "objects": {"wall": {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "it"}},
                    "display": {"force": True, "vibration": vibration},
                },
            }
        )
        samples, _, events = Simulation(scene, path).run(LEAD_S + COMPARED_S + 0.03)
        again = new_sim(load_config({"device": {"sim": {**sim, "start_m": [0, 0]}}}).device.sim, FINE_RATE_HZ)
        lib.hd_sim_operate(again, operator := new_operator(path, "linear"))
        lib.hd_sim_settle(again)
        force = np.ascontiguousarray(np.repeat(samples["force_n"], PARTS_PER_PERIOD, axis=0))
        motion = np.empty((len(force), 4))
        lib.hd_sim_drive(again, pointer("double[]", force), len(force), pointer("double[]", motion))
        del operator
        return events[events["kind"] == EventKind.CONTACT], motion[:, 3]

    still, reference = run("off", False)
    found = []
    for compensation in ("off", "full"):
        events, speed = run(compensation, True)
        onset = events[0]
        before = float(onset["before_tick_s"]) * FINE_RATE_HZ
        first = int(onset["tick"]) * PARTS_PER_PERIOD - round(before)
        count = round(COMPARED_S * FINE_RATE_HZ) - 1
        moved = np.diff((speed - reference)[first : first + count + 1]) * FINE_RATE_HZ
        mode = Mode(1 / tap.material["tap"]["decay_time_s"], 2 * math.pi * tap.material["tap"]["frequency_hz"])
        wanted = float(onset["amplitude_m_per_s2"]) * waveform(
            mode, count, FINE_RATE_HZ, (before - round(before)) / FINE_RATE_HZ
        )
        error = band_error(moved, wanted, FINE_RATE_HZ, ERROR_BAND_LOW_HZ, ERROR_BAND_RATE_FRACTION * RATE_HZ)
        found.append(Displayed(len(events), error))
    return len(still), found[0], found[1]


def run_all(count: int, seed: int, processes: int) -> int:
    """Run taps and print what they show; return the number of those that break a rule of the module."""
    random = np.random.default_rng(seed)
    taps = [random_tap(random) for _ in range(count)]
    with ProcessPoolExecutor(processes) as pool:
        runs = list(zip(taps, pool.map(displayed, taps, chunksize=8), strict=True))
    lost, worse = 0, 0
    for name, still, plain in (
        ("stay in contact without vibration and with off", True, True),
        ("stay with off alone", False, True),
        ("leave the surface with off", None, False),
    ):
        group = [run for run in runs if (run[1][1].contacts == 1) is plain and still in (None, run[1][0] == 1)]
        more, larger = _print(name, group)
        lost += more if plain else 0
        worse += larger if plain and still else 0
    return lost + worse


def _print(name: str, group: list[tuple[Tap, tuple[int, Displayed, Displayed]]]) -> tuple[int, int]:
    """Print what a group of taps shows; return how many have more contacts than with `off`, and a larger error."""
    if not group:
        return 0, 0
    lost = [run for run in group if run[1][2].contacts > run[1][1].contacts]
    worse = [run for run in group if run[1][2].error > run[1][1].error * (1 + 1e-6)]
    full, off = (np.array([run[1][which].error for run in group]) for which in (2, 1))
    print(f"{name}: {len(group)} taps")
    print(f"  more contacts with full than with off: {len(lost)}; larger error: {len(worse)}")
    print(f"  error with off, %: median {100 * np.median(off):.1f}, largest {100 * off.max():.1f}")
    print(
        f"  error with full, %: median {100 * np.median(full):.1f}, largest {100 * full.max():.1f}; at most "
        f"{100 * MAX_KEPT_ERROR:g} % in {100 * np.mean(full <= MAX_KEPT_ERROR):.0f} % of the taps"
    )
    worst = int((full / off).argmax())
    print(f"worst case: error with full {full[worst] / off[worst]:.2f} times that with off, {group[worst][0]}")
    for run in lost[:5]:
        print(f"  more contacts: {run[0]}")
    return len(lost), int((full > MAX_ERROR_RATIO * off).sum())


def main() -> None:
    """Run the taps that the command line asks for."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--taps", type=int, default=2000)
    options.add_argument("--seed", type=int, default=35)
    options.add_argument("--processes", type=int, default=2)
    chosen = options.parse_args()
    raise SystemExit(1 if run_all(chosen.taps, chosen.seed, chosen.processes) else 0)


if __name__ == "__main__":
    main()
