"""Random closed loops with everything in them: does what is called safe come to rest, and what is the hand given?

    python -m bench.loops [--count 10000] [--first 0] [--kind KIND]...

A loop is a device, a hand that presses and slides and then holds still, and a scene: a wall, plain, of patches or
with textures, a corner, flush boxes with seams, a disc pressed to its centre, or several of these on one another.
Stiffnesses are 0.3 to 1 of what its margin says is safe; a scene whose margin is not safe, or of which `hapticd check`
warns of anything, is drawn anew. Each loop runs with the passivity controller off and with it, for at most ten
simulated minutes; `hapticd.rendering.end_state` says whether it rests. One that goes on is run again without
vibration: what rests then was driven by its own texture.

The energy given to the hand is summed from samples and from the handle's own positions, here and not by the servo.
"""

from __future__ import annotations

import argparse
import math
import time
from collections import Counter
from dataclasses import dataclass, field
from typing import Any, Final, Literal, TypeAlias, get_args

import numpy as np

from bench.stability import evaluated
from hapticd.analysis.check import check
from hapticd.base.core import Flag
from hapticd.config.configuration import Config, load_config
from hapticd.rendering.end_state import EndState, end_state
from hapticd.rendering.offline import CompiledScene, Simulation
from hapticd.sweeps.measures.energy import given_j

Kind: TypeAlias = Literal["wall", "texture", "patches", "corner", "seam", "disc", "mixed"]
KINDS: Final[tuple[Kind, ...]] = get_args(Kind)
Mode: TypeAlias = Literal["observe", "control"]
Tree: TypeAlias = dict[str, Any]

LONGEST_S: Final = 600.0
AFTER_S: Final = 0.5
"""So long after the hand's reference has come to rest energy is summed."""
TRIES: Final = 40
"""Scenes drawn for a loop until one is called safe."""


# ---- What is drawn -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Case:
    """One loop."""

    seed: int
    kind: Kind
    source: Tree
    waypoints: list[list[float]]
    factor: float
    """The stiffnesses may be so many times as large."""

    @property
    def rate_hz(self) -> float:
        """Of the servo."""
        return float(self.source["servo"]["rate_hz"])

    @property
    def age(self) -> int:
        """How old a position is when it is read, in whole periods."""
        return math.ceil(float(self.source["device"]["sim"].get("report_delay_s", 0.0)) * self.rate_hz)

    def config(self, mode: Mode, vibration: bool = True) -> Config:
        """As a configuration."""
        scene = {**self.source["scene"], "passivity": mode, "display": {"force": True, "vibration": vibration}}
        return load_config({**self.source, "scene": scene})


class Drawer:
    """Draws the parts of a loop."""

    def __init__(self, random: np.random.Generator) -> None:
        self._random = random

    def between(self, low: float, high: float) -> float:
        """Uniformly."""
        return float(self._random.uniform(low, high))

    def log(self, low: float, high: float) -> float:
        """Uniformly in its logarithm."""
        return math.exp(self.between(math.log(low), math.log(high)))

    def chance(self, part: float) -> bool:
        """True in this part of the draws."""
        return bool(self._random.random() < part)

    def device(self, rate_hz: float) -> Tree:
        """Joystick and hand."""
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
        """Grooves, shown in one of three ways, or noise up to what the limit leaves."""
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
        """Of stiffness 1, which is scaled later."""
        material: Tree = {"stiffness_n_per_m": self.log(0.3, 3.0)}
        if self.chance(0.4):
            material["friction"] = {"coefficient": self.between(0.05, 1.0), "stiffness_n_per_m": self.log(0.3, 3.0)}
        if textured and self.chance(0.7):
            material["texture"] = self.texture(rate_hz)
        if self.chance(0.5):
            material["tap"] = {"attack_slope_per_s": self.log(10, 300), "frequency_hz": 100, "decay_time_s": 0.01}
        return material

    def objects(self, kind: Kind) -> Tree:
        """The scene; its top is at y = 0, about x = 0."""
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
        """In, along, half out, in again; there the hand stays."""
        points = [[0.0, 0.0 if kind == "corner" else self.between(-0.01, 0.01), 0.02 if kind == "mixed" else 0.005]]
        for part in (1.0, 1.0, 0.3, 1.0):
            along_m, deep_m = self.between(-0.015, 0.015), -part * press_m
            points.append([points[-1][0] + self.between(0.05, 0.3), along_m, deep_m])
        return points


def _scaled(source: Tree, factor: float) -> Tree:
    """The same with all stiffnesses so many times as large, as far as they go."""
    materials = {}
    for name, material in source["materials"].items():
        most = min(9e4, max(1e-2, factor * material["stiffness_n_per_m"]))
        scaled = {**material, "stiffness_n_per_m": most}
        if "friction" in material:
            stiffness = min(9e4, max(1e-2, factor * material["friction"]["stiffness_n_per_m"]))
            scaled["friction"] = {**material["friction"], "stiffness_n_per_m": stiffness}
        materials[name] = scaled
    return {**source, "materials": materials}


def draw(seed: int, kinds: tuple[Kind, ...] = KINDS) -> Case | None:
    """A loop of which `check` says nothing; None where no scene of TRIES is such."""
    drawer = Drawer(np.random.default_rng(seed))
    kind = kinds[seed % len(kinds)]
    for _ in range(TRIES):
        rate_hz = drawer.log(1000.0, 10_000.0)
        sim = drawer.device(rate_hz)
        textured = kind not in ("wall", "corner")
        limit_n = 8.9 if drawer.chance(0.5) else drawer.log(1.0, 8.9)
        source: Tree = {
            "servo": {"rate_hz": rate_hz},
            "device": {"max_force_n": limit_n, "sim": sim},
            "materials": {name: drawer.material(rate_hz, textured) for name in "abc"},
            "scene": {"objects": drawer.objects(kind)},
        }
        # Flanks and ramps between materials are judged under 1 N: what the hand may press with at most.
        press_m = drawer.between(0.2, 1.0) / sim["hand"]["stiffness_n_per_m"]
        waypoints = drawer.waypoints(kind, press_m)
        sim["start_m"] = waypoints[0][1:]
        source = _scaled(source, 100.0)
        part = drawer.between(0.3, 1.0)
        for _ in range(3):  # not all of them scale with stiffness
            sets = evaluated(load_config(source))
            factor = float(sets.factor.min())
            if not 1e-6 < factor < 1e6 or (bool(sets.safe.all()) and factor < 1.1 / part):
                break
            source = _scaled(source, 0.999 * part * factor)
        config = load_config(source)
        sets = evaluated(config)
        if bool(sets.safe.all()) and float(sets.factor.min()) > 0.0 and check(config).faults == 0:
            return Case(seed, kind, source, waypoints, float(sets.factor.min()))
    return None


# ---- What becomes of it --------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a loop."""

    end: EndState
    given_j: float
    """The most that touched objects gave to the hand in a contact, without vibration."""
    bound_j: float
    """F_max v_max (T + a), a the age of a position in whole periods."""
    restrained: int
    """Ticks in which the controller acted."""
    samples: Any
    """Those up to AFTER_S after the hand's reference rests."""

    @property
    def rests(self) -> bool:
        """In the end."""
        return self.end.fate == "rests"

    @property
    def part(self) -> float:
        """What was given, of the bound."""
        return self.given_j / self.bound_j


def given(case: Case, mode: Mode) -> float:
    """The most, J, that touched objects give to the hand in a contact: without vibration, whose part of a force at the
    limit samples do not tell. No fields, forces on: every force is theirs."""
    loop = Simulation(CompiledScene(case.config(mode, vibration=False)), case.waypoints)
    samples, truth, _ = loop.run(case.waypoints[-1][0] + AFTER_S)
    touched = (samples["flags"] & Flag.CONTACT) != 0
    return given_j(samples["force_n"], truth[:, :2], touched, case.age)


def settle(case: Case, mode: Mode, longest_s: float = LONGEST_S) -> Outcome:
    """Runs a loop until its end is certain."""
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


def drives_itself(case: Case, mode: Mode, longest_s: float = LONGEST_S) -> bool:
    """Whether it rests without vibration."""
    loop = Simulation(CompiledScene(case.config(mode, vibration=False)), case.waypoints)
    loop.advance(case.waypoints[-1][0] + AFTER_S)
    return end_state(loop.advance, longest_s).fate == "rests"


def changed_n(off: Outcome, control: Outcome) -> float:
    """The largest difference between the commands with the controller and without it; 0 where it never acted."""
    if control.restrained == 0:
        return 0.0
    return float(np.hypot(*(off.samples["force_n"] - control.samples["force_n"]).T).max())


@dataclass(slots=True)
class Counts:
    """What became of many."""

    drawn: Counter[str] = field(default_factory=Counter)
    told: dict[str, Counter[str]] = field(default_factory=dict)
    """What was found, and of how many of a kind."""
    part: float = 0.0
    """The most that was given under control, of the bound."""
    changed_n: float = 0.0
    longest_s: float = 0.0

    def look(self, case: Case) -> str:
        """Runs a loop; a line, empty where there is nothing to tell."""
        off, control = settle(case, "observe"), settle(case, "control")
        change_n = changed_n(off, control)
        self.drawn[case.kind] += 1
        self.part = max(self.part, control.part)
        self.changed_n = max(self.changed_n, change_n)
        self.longest_s = max(self.longest_s, off.end.after_s, control.end.after_s)
        found = []
        if not off.rests:
            found.append("driven by its own texture" if drives_itself(case, "observe") else "does not rest")
        if off.rests and not control.rests:
            driven = drives_itself(case, "control")
            found.append("driven by its own texture" if driven else "does not rest under control")
        if off.part > 1.0:
            found.append("gives more than the bound without the controller")
        if control.part > 1.0:
            found.append("gives more than the bound")
        if change_n > 0.0:
            found.append("changed by the controller")
        for what in found:
            self.told.setdefault(what, Counter())[case.kind] += 1
        told = f"seed {case.seed} {case.kind}: {off.end.fate}, with control {control.end.fate}, "
        told += f"{off.end.peak_m_per_s:.2g} m/s after {off.end.after_s:g} s; given {off.part:.3g} of the bound, with "
        told += f"control {control.part:.3g}; the controller acted in {control.restrained} ticks, {change_n:.3g} N"
        return f"{told}: {', '.join(found)}" if found else ""


def main() -> None:
    """Draws and runs, and tells."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kind", choices=KINDS, action="append")
    arguments = parser.parse_args()
    kinds = tuple(arguments.kind) if arguments.kind else KINDS
    counts, began, unsafe = Counts(), time.monotonic(), 0
    for seed in range(arguments.first, arguments.first + arguments.count):
        case = draw(seed, kinds)
        if case is None:
            unsafe += 1
        elif line := counts.look(case):
            print(line, flush=True)
    print(
        f"{counts.drawn.total()} loops in {time.monotonic() - began:.0f} s: {dict(counts.drawn)}; of {unsafe} no scene "
        f"was safe; given under control at most {counts.part:.3g} of the bound; changed by the controller by at most "
        f"{counts.changed_n:.3g} N; the end was certain after {counts.longest_s:g} s at most"
    )
    for what, kinds_of in counts.told.items():
        print(f"  {what}: {kinds_of.total()}, {dict(kinds_of)}")


if __name__ == "__main__":
    main()
