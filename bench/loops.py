"""Random closed loops: do loops that the margin calls safe come to rest, and how much energy does the hand get?

    python -m bench.loops [--count 10000] [--first 0] [--kind KIND]... [--rest]

A loop is a device, a hand that presses, slides and then rests, and a scene: a wall, plain, of patches or with textures,
a corner, flush boxes with seams, a disc pressed to its centre, or several of these that overlap. Stiffnesses are 0.3 to
1 of the safe stiffness. A scene that is not safe, or has a warning of `hapticd check`, is drawn again. Each loop runs
with and without the passivity controller, for at most ten simulated minutes, until `hapticd.rendering.end_state` is
certain that it rests. A loop that does not rest is run again without vibration: if it then rests, its texture drove it.
With `--rest` each loop runs once, without vibration and controller, and the exit code is 1 if one does not rest.

The energy given to the hand is the sum over samples and true positions of the handle; the servo's sum is not used.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from functools import partial
from multiprocessing import Pool
from typing import Any, Final, Literal, TypeAlias, get_args

import numpy as np

from bench.stability import evaluated
from hapticd.analysis.check import check
from hapticd.base.core import Flag
from hapticd.config.configuration import Config, load_config
from hapticd.rendering.end_state import EndState, end_state
from hapticd.rendering.offline import CompiledScene, Simulation
from hapticd.sweeps.measures.energy import given_j

Kind: TypeAlias = Literal["wall", "texture", "patches", "corner", "seam", "disc", "mixed", "overlap"]
KINDS: Final[tuple[Kind, ...]] = get_args(Kind)[:-1]
"""Kinds that are drawn by default; `overlap` is drawn on request, with harder presses."""
Mode: TypeAlias = Literal["observe", "control"]
Tree: TypeAlias = dict[str, Any]

LONGEST_S: Final = 600.0
"""Longest simulated time of a loop."""
AFTER_S: Final = 0.5
"""Time after the last motion of the hand's reference until which energy is summed."""
MAX_SCENES: Final = 40
"""Maximum number of scenes that are drawn until one is safe."""


# ---- Random loops --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Case:
    """A random loop that the margin calls safe."""

    seed: int
    kind: Kind
    source: Tree
    waypoints: list[list[float]]
    factor: float
    """Factor by which all stiffnesses may grow until the loop is no longer proved safe."""

    @property
    def rate_hz(self) -> float:
        """Rate of the servo."""
        return float(self.source["servo"]["rate_hz"])

    @property
    def age(self) -> int:
        """Age of a position when the servo reads it, rounded up to periods."""
        return math.ceil(float(self.source["device"]["sim"].get("report_delay_s", 0.0)) * self.rate_hz)

    def config(self, mode: Mode, vibration: bool = True) -> Config:
        """Return the configuration of the loop with this mode of the passivity controller."""
        scene = {**self.source["scene"], "passivity": mode, "display": {"force": True, "vibration": vibration}}
        return load_config({**self.source, "scene": scene})


class Drawer:
    """Draws the values of a loop at random."""

    def __init__(self, random: np.random.Generator) -> None:
        self._random = random

    def between(self, low: float, high: float) -> float:
        """Return a uniformly distributed number."""
        return float(self._random.uniform(low, high))

    def log(self, low: float, high: float) -> float:
        """Return a log-uniformly distributed number."""
        return math.exp(self.between(math.log(low), math.log(high)))

    def chance(self, probability: float) -> bool:
        """Return True with this probability."""
        return bool(self._random.random() < probability)

    def device(self, rate_hz: float) -> Tree:
        """Return a simulated joystick with a hand."""
        sim: Tree = {
            "handle_mass_kg": self.log(0.02, 0.2),
            "handle_damping_n_s_per_m": self.log(0.1, 5.0),
            "coulomb_friction_n": 0.0 if self.chance(0.2) else self.log(0.01, 0.3),
            "encoder_step_m": 0.0 if self.chance(0.3) else self.log(1e-6, 1e-4),
            "force_step_n": 0.0 if self.chance(0.5) else self.log(1e-4, 1e-2),
            "max_force_n": 20.0,
            "workspace_m": 0.2,
        }
        if self.chance(0.3):
            sim["report_delay_s"] = int(self._random.integers(1, 4)) / rate_hz
        sim["hand"] = {
            "mass_kg": self.between(0.0, 0.1),
            "stiffness_n_per_m": self.log(50.0, 1000.0),
            "damping_n_s_per_m": 0.0 if self.chance(0.2) else self.log(0.3, 10.0),
        }
        return sim

    def texture(self, rate_hz: float) -> Tree:
        """Return grooves with one of three displays, or noise."""
        spacing_m = self.log(0.001, 0.006)
        grooves = {"kind": "grooves", "spacing_m": spacing_m, "width_m": self.between(0.3, 1.0) * spacing_m}
        match int(self._random.integers(4)):
            case 0:
                return {**grooves, "display": "geometry", "depth_m": self.log(1e-5, 3e-4)}
            case 1:
                return {**grooves, "display": "damping", "damping_n_s_per_m": self.between(0.01, 0.1)}
            case 2:
                gains = {"velocity_gain_per_s": self.log(1, 100), "force_gain_m_per_s2_per_n": self.log(0.1, 5)}
                return {**grooves, **gains, "display": "vibration", "frequency_hz": 150.0, "decay_time_s": 0.004}
            case _:
                peak_hz = self.between(0.02, 0.08) * rate_hz
                gains = {"velocity_gain_per_s": self.log(1, 100), "force_gain_m_per_s2_per_n": self.log(0.1, 20)}
                return {"kind": "stochastic", "peak_hz": peak_hz, "mean_hz": 1.4 * peak_hz, **gains}

    def material(self, rate_hz: float, textured: bool) -> Tree:
        """Return a material with a stiffness of about 1, which is scaled later."""
        material: Tree = {"stiffness_n_per_m": self.log(0.3, 3.0)}
        if self.chance(0.4):
            material["friction"] = {"coefficient": self.between(0.05, 1.0), "stiffness_n_per_m": self.log(0.3, 3.0)}
        if textured and self.chance(0.7):
            material["texture"] = self.texture(rate_hz)
        if self.chance(0.5):
            material["tap"] = {"attack_slope_per_s": self.log(10, 300), "frequency_hz": 100, "decay_time_s": 0.01}
        return material

    def overlapping(self) -> Tree:
        """Return two to five plain objects whose middles lie near the origin."""
        found: Tree = {}
        for name in "vwxyz"[: int(self._random.integers(2, 6))]:
            at_m = [self.between(-0.006, 0.006), self.between(-0.006, 0.006)]
            turn = self.between(-math.pi, math.pi)
            normal = [-math.sin(turn), math.cos(turn)]
            material = "abc"[int(self._random.integers(3))]
            share = self.between(0.0, 1.0)
            if share < 0.65:
                size = [self.log(0.001, 0.02), self.log(0.001, 0.02)]
                place = {"kind": "box", "center_m": at_m, "size_m": size, "angle_rad": turn}
            elif share < 0.85:
                place = {"kind": "disc", "center_m": at_m, "radius_m": self.log(0.001, 0.01)}
            elif share < 0.93:
                place = {"kind": "wall", "point_m": at_m, "normal": normal}
            else:
                place = {"kind": "membrane", "center_m": at_m, "normal": normal, "width_m": self.log(0.002, 0.02)}
            found[name] = {**place, "material": material}
        return found

    def presses(self, stiffness_n_per_m: float) -> list[list[float]]:
        """Return waypoints of a hand that presses several times with 0.5 to 9 N near the origin."""
        points: list[list[float]] = []
        for _ in range(int(self._random.integers(1, 4))):
            turn, press_m = self.between(-math.pi, math.pi), self.log(0.5, 9.0) / stiffness_n_per_m
            inward = [math.cos(turn), math.sin(turn)]
            at_m = [self.between(-0.006, 0.006), self.between(-0.006, 0.006)]
            for along_m in (-0.03, press_m):
                time_s = points[-1][0] + self.between(0.05, 0.3) if points else 0.0
                points.append([time_s, *(at_m[axis] + along_m * inward[axis] for axis in (0, 1))])
        return points

    def objects(self, kind: Kind) -> Tree:
        """Return the objects of a scene with its top at y = 0, near x = 0."""
        if kind == "overlap":
            return self.overlapping()
        floor = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "a"}
        if kind == "patches":
            cuts = sorted(self.between(-0.015, 0.015) for _ in range(3))
            pairs = zip(cuts[:-1], cuts[1:], "bc", strict=True)
            floor["patches"] = [{"from_m": a, "to_m": b, "material": name} for a, b, name in pairs if b - a > 2e-3]
        if kind == "corner":
            half = self.between(math.radians(10), math.radians(80))
            sides = {"left": math.cos(half), "right": -math.cos(half)}
            names = dict(zip(sides, "ab", strict=True))
            return {
                side: {"kind": "wall", "point_m": [0, 0], "normal": [x, math.sin(half)], "material": names[side]}
                for side, x in sides.items()
            }
        if kind == "seam":
            material = "a" if self.chance(0.5) else "b"
            width_m, height_m = self.between(0.008, 0.02), self.between(0.006, 0.02)
            return {
                f"box{place}": {
                    "kind": "box",
                    "center_m": [place * width_m, -height_m / 2],
                    "size_m": [width_m, height_m],
                    "material": material if place == 0 else "a",
                }
                for place in (-1, 0, 1)
            }
        radius_m = self.log(0.001, 0.01)
        disc = {"kind": "disc", "center_m": [0, -radius_m], "radius_m": radius_m, "material": "b"}
        if kind == "disc":
            return {"disc": disc}
        if kind == "mixed":
            disc["center_m"] = [self.between(-0.01, 0.01), self.between(-1.0, 0.5) * radius_m]
            box = {
                "kind": "box",
                "center_m": [self.between(-0.01, 0.01), self.between(-0.003, 0.002)],
                "size_m": [self.log(0.002, 0.02), self.log(0.001, 0.01)],
                "angle_rad": self.between(-0.8, 0.8),
                "material": "c",
            }
            return {"floor": floor, "disc": disc, "box": box}
        return {"floor": floor}

    def waypoints(self, kind: Kind, press_m: float) -> list[list[float]]:
        """Return the hand's waypoints: in, along the surface, partly out, and in again."""
        points = [[0.0, 0.0 if kind == "corner" else self.between(-0.01, 0.01), 0.02 if kind == "mixed" else 0.005]]
        for fraction in (1.0, 1.0, 0.3, 1.0):
            along_m, deep_m = self.between(-0.015, 0.015), -fraction * press_m
            points.append([points[-1][0] + self.between(0.05, 0.3), along_m, deep_m])
        return points


def _scaled(source: Tree, factor: float) -> Tree:
    """Return the configuration with all stiffnesses multiplied by `factor`, from 1e-2 to 9e4 N/m."""
    materials = {}
    for name, material in source["materials"].items():
        scaled = {**material, "stiffness_n_per_m": min(9e4, max(1e-2, factor * material["stiffness_n_per_m"]))}
        if "friction" in material:
            stiffness = min(9e4, max(1e-2, factor * material["friction"]["stiffness_n_per_m"]))
            scaled["friction"] = {**material["friction"], "stiffness_n_per_m": stiffness}
        materials[name] = scaled
    return {**source, "materials": materials}


def draw(seed: int, kinds: tuple[Kind, ...] = KINDS) -> Case | None:
    """Return a loop without a warning of `hapticd check`; None if none of MAX_SCENES scenes is safe."""
    drawer = Drawer(np.random.default_rng(seed))
    kind = kinds[seed % len(kinds)]
    for _ in range(MAX_SCENES):
        rate_hz = drawer.log(1000.0, 10_000.0)
        sim = drawer.device(rate_hz)
        textured = kind not in ("wall", "corner", "overlap")
        limit_n = 20.0 if kind == "overlap" else 8.9 if drawer.chance(0.5) else drawer.log(1.0, 8.9)
        source: Tree = {
            "servo": {"rate_hz": rate_hz},
            "device": {"max_force_n": limit_n, "sim": sim},
            "materials": {name: drawer.material(rate_hz, textured) for name in "abc"},
            "scene": {"objects": drawer.objects(kind)},
        }
        # The margin of flanks and ramps between materials assumes at most 1 N, so the hand presses with at most 1 N.
        hand_n_per_m = sim["hand"]["stiffness_n_per_m"]
        if kind == "overlap":
            waypoints = drawer.presses(hand_n_per_m)
        else:
            waypoints = drawer.waypoints(kind, drawer.between(0.2, 1.0) / hand_n_per_m)
        sim["start_m"] = waypoints[0][1:]
        source = _scaled(source, 100.0)
        fraction = drawer.between(0.9 if kind == "overlap" else 0.3, 1.0)
        for _ in range(3):  # repeated, since some margins do not scale with stiffness
            sets = evaluated(load_config(source))
            factor = float(sets.factor.min())
            if not 1e-6 < factor < 1e6 or (bool(sets.safe.all()) and factor < 1.1 / fraction):
                break
            source = _scaled(source, 0.999 * fraction * factor)
        config = load_config(source)
        sets = evaluated(config)
        if bool(sets.safe.all()) and float(sets.factor.min()) > 0.0 and check(config).faults == 0:
            return Case(seed, kind, source, waypoints, float(sets.factor.min()))
    return None


# ---- Simulated loops -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of a simulated loop."""

    end: EndState
    given_j: float
    """Largest energy that touched objects gave to the hand in a contact, without vibration."""
    bound_j: float
    """F_max v_max (T + a), with the age a of a position rounded up to periods."""
    restrained: int
    """Number of ticks in which the passivity controller acted."""
    samples: Any
    """The samples up to AFTER_S after the last motion of the hand's reference."""

    @property
    def rests(self) -> bool:
        """Whether the loop comes to rest."""
        return self.end.fate == "rests"

    @property
    def fraction(self) -> float:
        """The energy given to the hand, as a fraction of the bound."""
        return self.given_j / self.bound_j


def given(case: Case, mode: Mode) -> float:
    """Return the largest energy in J that touched objects give to the hand in a contact.

    Vibration is off, since samples do not show its contribution to a limited force. Without fields, every force is that
    of touched objects.
    """
    loop = Simulation(CompiledScene(case.config(mode, vibration=False)), case.waypoints)
    samples, truth, _ = loop.run(case.waypoints[-1][0] + AFTER_S)
    touched = (samples["flags"] & Flag.CONTACT) != 0
    return given_j(samples["force_n"], truth[:, :2], touched, case.age)


def settle(case: Case, mode: Mode, longest_s: float = LONGEST_S) -> Outcome:
    """Run a loop until it is certain how its motion ends."""
    config = case.config(mode)
    loop = Simulation(CompiledScene(config), case.waypoints)
    device = config.device
    samples, _, _ = loop.run(case.waypoints[-1][0] + AFTER_S)
    return Outcome(
        end=end_state(loop.advance, longest_s),
        given_j=given(case, mode),
        bound_j=device.max_force_n * device.max_speed_m_per_s * (1 + case.age) / case.rate_hz,
        restrained=int(((samples["flags"] & Flag.RESTRAINED) != 0).sum()),
        samples=samples,
    )


def rests_without_vibration(case: Case, mode: Mode, longest_s: float = LONGEST_S) -> bool:
    """Return whether the loop rests without vibration."""
    loop = Simulation(CompiledScene(case.config(mode, vibration=False)), case.waypoints)
    loop.advance(case.waypoints[-1][0] + AFTER_S)
    return end_state(loop.advance, longest_s).fate == "rests"


def changed_n(off: Outcome, control: Outcome) -> float:
    """Return the largest difference in N of the forces with and without the controller; 0 if it never acted."""
    if control.restrained == 0:
        return 0.0
    return float(np.hypot(*(off.samples["force_n"] - control.samples["force_n"]).T).max())


@dataclass(slots=True)
class Counts:
    """Results of many loops."""

    drawn: Counter[str] = field(default_factory=Counter)
    findings: dict[str, Counter[str]] = field(default_factory=dict)
    """For each finding, the number of loops by kind."""
    fraction: float = 0.0
    """Largest energy given to the hand with the controller, as a fraction of the bound."""
    changed_n: float = 0.0
    longest_s: float = 0.0

    def run(self, case: Case) -> str:
        """Run a loop, and return a line with its findings; empty without findings."""
        off, control = settle(case, "observe"), settle(case, "control")
        change_n = changed_n(off, control)
        self.drawn[case.kind] += 1
        self.fraction = max(self.fraction, control.fraction)
        self.changed_n = max(self.changed_n, change_n)
        self.longest_s = max(self.longest_s, off.end.after_s, control.end.after_s)
        found = []
        if not off.rests:
            found.append("driven by its own texture" if rests_without_vibration(case, "observe") else "does not rest")
        if off.rests and not control.rests:
            driven = rests_without_vibration(case, "control")
            found.append("driven by its own texture" if driven else "does not rest under control")
        if off.fraction > 1.0:
            found.append("gives more than the bound without the controller")
        if control.fraction > 1.0:
            found.append("gives more than the bound")
        if change_n > 0.0:
            found.append("changed by the controller")
        for what in found:
            self.findings.setdefault(what, Counter())[case.kind] += 1
        line = f"seed {case.seed} {case.kind}: {off.end.fate}, with control {control.end.fate}, "
        line += f"{off.end.peak_m_per_s:.2g} m/s after {off.end.after_s:g} s; given {off.fraction:.3g} of the bound, "
        line += f"with control {control.fraction:.3g}; the controller acted in {control.restrained} ticks, "
        return f"{line}{change_n:.3g} N: {', '.join(found)}" if found else ""


# ---- Rest alone ----------------------------------------------------------------------------------------------------


def end_of_loop(seed: int, kinds: tuple[Kind, ...]) -> tuple[Case, EndState] | None:
    """Return how a loop ends without vibration and controller; None if no scene of this seed is safe."""
    case = draw(seed, kinds)
    if case is None:
        return None
    loop = Simulation(CompiledScene(case.config("off", vibration=False)), case.waypoints)
    loop.advance(case.waypoints[-1][0] + AFTER_S)
    return case, end_state(loop.advance, LONGEST_S)


def count_rests(seeds: range, kinds: tuple[Kind, ...]) -> int:
    """Run loops in two processes, print those that do not rest and the slowest, and return how many do not rest."""
    began, loops, moving, slowest = time.monotonic(), 0, 0, "none"
    longest_s = 0.0
    with Pool(2) as workers:
        for found in workers.imap(partial(end_of_loop, kinds=kinds), seeds, 8):
            if found is None:
                continue
            case, end = found
            loops += 1
            line = f"seed {case.seed} {case.kind}: {end.fate}, {end.peak_m_per_s:.2g} m/s after {end.after_s:g} s"
            if end.fate != "rests":
                moving += 1
                print(line, flush=True)
            if end.after_s > longest_s:
                longest_s, slowest = end.after_s, line
    print(f"{loops} loops in {time.monotonic() - began:.0f} s: {moving} do not rest")
    print(f"worst case: the slowest was {slowest}")
    return moving


def main() -> None:
    """Run random loops, and print the findings."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kind", choices=get_args(Kind), action="append")
    parser.add_argument("--rest", action="store_true")
    arguments = parser.parse_args()
    kinds = tuple(arguments.kind) if arguments.kind else KINDS
    if arguments.rest:
        sys.exit(count_rests(range(arguments.first, arguments.first + arguments.count), kinds) > 0)
    counts, began, unsafe = Counts(), time.monotonic(), 0
    for seed in range(arguments.first, arguments.first + arguments.count):
        case = draw(seed, kinds)
        if case is None:
            unsafe += 1
        elif line := counts.run(case):
            print(line, flush=True)
    print(
        f"{counts.drawn.total()} loops in {time.monotonic() - began:.0f} s: {dict(counts.drawn)}; {unsafe} seeds have "
        f"no safe scene; given with the controller: at most {counts.fraction:.3g} of the bound; changed by the "
        f"controller: at most {counts.changed_n:.3g} N; the end was certain after at most {counts.longest_s:g} s"
    )
    for what, by_kind in counts.findings.items():
        print(f"  {what}: {by_kind.total()}, {dict(by_kind)}")


if __name__ == "__main__":
    main()
