"""Random walls and corners, simulated and compared with their stability margins; and maps of the limit of stiffness.

A trial is a device, a hand, a wall or a corner of two walls, and a motion onto them. Its margin is that of
`get_status`; its motion is computed with the tick of the servo and the simulated joystick. In addition, the linear loop
(bilateral, without friction, rounding and force limit) is simulated from its closed form.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from copy import deepcopy
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from bench.report import Advance, Floats, Options, Section, Table, between
from bench.swept import STUDIES, swept, workers
from hapticd.base.core import ffi, lib
from hapticd.base.yaml_source import Json, load_path
from hapticd.config.configuration import Config, load_config
from hapticd.rendering.contact_sets import ContactSets
from hapticd.rendering.device_output import loop_of
from hapticd.rendering.end_state import EndState, Fate, end_of
from hapticd.rendering.joystick import new_sim
from hapticd.rendering.scene_stability import sets_of
from hapticd.rendering.stability import Loop, spectral_radius

if TYPE_CHECKING:
    from hapticd.sweeps.measures.sweep_point import SweepPoint

SEED = 20
TRIALS = 10_000
LONGEST_S = 640.0
"""Longest simulated time of a trial that the margin calls safe, unless it rests or cycles regularly."""
UNSAFE_S = 160.0
"""Longest simulated time of a trial that the margin does not call safe."""


@dataclass(frozen=True, slots=True)
class Trial:
    """A random device and scene, the waypoints of the hand, and the stability margin."""

    config: Config
    waypoints: list[list[float]]
    loop: Loop
    factor: float
    """Factor by which all stiffnesses may grow until the trial is no longer proved safe."""
    safe: bool
    stiffness: Floats
    """Stiffness matrix of the walls in N/m, (2, 2)."""
    damping: Floats
    """Damping matrix of the walls in N s/m, (2, 2)."""
    walls: int

    @property
    def radius(self) -> float:
        """The spectral radius of the linear loop."""
        return float(spectral_radius(self.stiffness, self.damping, self.loop))

    @property
    def plainly_safe(self) -> bool:
        """Whether the conditions of the literature hold: b > K (T/2 + t_d) + |D|, and K step/2 + |D| step/T <= c."""
        timing, dynamics = self.loop.timing, self.loop.dynamics
        stiffness, damping = (float(np.linalg.norm(each, 2)) for each in (self.stiffness, self.damping))
        delay_s = 0.5 * timing.period_s + timing.delay_s
        step_m = self.loop.encoder_step_m
        noise_n = stiffness * step_m / 2.0 + damping * step_m / timing.reading_s
        return dynamics.handle_damping_n_s_per_m > stiffness * delay_s + damping and noise_n <= dynamics.friction_n


def _log(random: np.random.Generator, low: float, high: float) -> float:
    return float(math.exp(random.uniform(math.log(low), math.log(high))))


def _log_or_zero(random: np.random.Generator, zero_probability: float, low: float, high: float) -> float:
    return 0.0 if random.random() < zero_probability else _log(random, low, high)


def _drawn_device(random: np.random.Generator, rate_hz: float) -> tuple[dict[str, Any], bool]:
    """Return a random simulated joystick, and whether its handle is free."""
    sim: dict[str, Any] = {
        "handle_mass_kg": _log(random, 0.01, 0.3),
        "handle_damping_n_s_per_m": _log(random, 0.05, 20.0),
        "coulomb_friction_n": _log_or_zero(random, 0.2, 0.005, 0.5),
        "encoder_step_m": _log_or_zero(random, 0.25, 1e-6, 1e-4),
        "force_step_n": _log_or_zero(random, 0.5, 1e-4, 1e-2),
        "max_force_n": 100.0,
        "workspace_m": 1.0,
    }
    match int(random.integers(6)):
        case 0 | 1:
            pass
        case 2 | 3:
            sim["report_delay_s"] = int(random.integers(1, 6)) / rate_hz
        case 4:
            sim["report_interval_s"] = random.uniform(1.0, 5.0) / rate_hz
            sim["report_delay_s"] = random.uniform(0.0, 3.0) / rate_hz
        case _:
            frames = int(random.integers(1, 3))
            sim["link"] = {"rate_hz": min(8000.0, rate_hz / random.integers(1, 11)), "delay_frames": frames}
    free = random.random() < 0.25
    sim["hand"] = {
        "mass_kg": 0.0 if free else random.uniform(0.0, 0.1),
        "stiffness_n_per_m": 0.0 if free else _log(random, 30.0, 1500.0),
        "damping_n_s_per_m": 0.0 if free else _log_or_zero(random, 0.3, 0.1, 10.0),
    }
    return sim, free


def draw(random: np.random.Generator) -> Trial:
    """Return a random trial, with stiffnesses of 1/20 to 4 times the proved limit.

    A quarter of the handles are free, and a constant force pushes them onto the walls.
    """
    rate_hz = _log(random, 1000.0, 10_000.0)
    sim, free = _drawn_device(random, rate_hz)
    # The normals are symmetric about the direction from which the hand comes.
    towards = random.uniform(0.0, 2.0 * math.pi)
    corner = random.random() < 0.5
    half = random.uniform(math.radians(2.5), math.radians(85.0))
    turns = (0.5 * math.pi - half, half - 0.5 * math.pi) if corner else (0.0,)
    normals = [[math.cos(towards + turn), math.sin(towards + turn)] for turn in turns]
    back = np.array([math.cos(towards), math.sin(towards)])
    ratio = [1.0, _log(random, 0.1, 10.0)]
    rubs = random.random() < 0.3
    materials: dict[str, Any] = {}
    damping_ratio = _log_or_zero(random, 0.6, 0.01, 1.5)
    for index in range(len(normals)):
        friction = {"coefficient": random.uniform(0.05, 1.0), "stiffness_n_per_m": _log(random, 0.1, 10.0)}
        materials[f"m{index}"] = {"stiffness_n_per_m": ratio[index]} | ({"friction": friction} if rubs else {})
    objects: dict[str, Any] = {
        f"w{index}": {"kind": "wall", "point_m": [0.0, 0.0], "normal": normal, "material": f"m{index}"}
        for index, normal in enumerate(normals)
    }
    start = 0.02 * back
    if free:
        objects["push"] = {"kind": "constant", "force_n": (-_log(random, 0.05, 2.0) * back).tolist()}
        deep = start
    else:
        deep = -random.uniform(0.001, 0.01) * back
    speed = _log(random, 0.05, 0.4)
    sideways = random.uniform(-0.01, 0.01) * np.array([-back[1], back[0]])
    reached_s = float(np.hypot(*(deep - start))) / speed + 1e-3
    waypoints = [[0.0, *start], [reached_s, *(deep + (0.0 if free else 1.0) * sideways)]]
    sim["start_m"] = start.tolist()
    wall_damping = damping_ratio * sim["handle_damping_n_s_per_m"]
    source: dict[str, Any] = {
        "servo": {"rate_hz": rate_hz},
        "device": {"max_force_n": 100.0, "max_speed_m_per_s": 1000.0, "sim": sim},
        "materials": materials,
        "scene": {"objects": objects, "display": {"force": True, "vibration": False}},
    }
    # The damping is set first, since the limit of the stiffnesses depends on it.
    first = load_config(source)
    echo = _loop(first).damping_echo
    for material in materials.values():
        material["damping_n_s_per_m"] = wall_damping / echo / len(normals)
    sets = evaluated(load_config(source))
    # Trials near the limit are the hardest.
    fraction = float(random.choice((0.5, 0.999, 2.0))) if random.random() < 0.4 else _log(random, 0.05, 4.0)
    scale = fraction * float(sets.factor.min())
    if not scale > 0.0 or not math.isfinite(scale):
        scale = _log(random, 50.0, 20_000.0)
    scale = min(scale, 9e4 / max(ratio))
    for material in materials.values():
        material["stiffness_n_per_m"] *= scale
        if rubs:
            stiffness = material["friction"]["stiffness_n_per_m"] * scale
            material["friction"]["stiffness_n_per_m"] = min(1e5, max(1e-3, stiffness))
    config = load_config(source)
    sets = evaluated(config)
    worst = int(sets.factor.argmin())
    matrices = sets.matrices(worst)
    return Trial(
        config, waypoints, _loop(config), float(sets.factor.min()), bool(sets.safe.all()), *matrices, len(normals)
    )


def _loop(config: Config) -> Loop:
    loop = loop_of(config, config.servo.rate_hz)
    assert loop is not None
    return loop


def evaluated(config: Config) -> ContactSets:
    """Return the stability of all contact sets of a scene. The handle must be known."""
    found = sets_of(config)
    assert found is not None
    return found


def fate_of(config: Config, waypoints: list[list[float]], longest_s: float = LONGEST_S) -> EndState:
    """Return how the motion of the handle ends after the hand's last waypoint."""
    return end_of(config, waypoints, longest_s)


def linear_grows(trial: Trial) -> bool:
    """Return whether the motion of the linear loop grows after a push.

    The loop is the simulated joystick with its reports and frames, without friction, rounding and force limit. The
    walls push and pull, F = -K p - D v, with the velocity v from the last two reports. The motion grows if its peak in
    the last third of the time exceeds that in the second third, or is 1e4 times the first peak.
    """
    sim = trial.config.device.sim
    plain = sim.model_copy(
        update={"coulomb_friction_n": 0.0, "encoder_step_m": 0.0, "force_step_n": 0.0, "start_m": (0.0, 0.0)}
    )
    period_s = 1.0 / trial.config.servo.rate_hz
    joystick = new_sim(plain, trial.config.servo.rate_hz)
    reading = ffi.new("struct hd_reading *")
    force = ffi.new("double[2]")
    (k_xx, k_xy), (_, k_yy) = trial.stiffness.tolist()
    (d_xx, d_xy), (_, d_yy) = trial.damping.tolist()
    third = math.ceil(3000 * trial.loop.timing.period_s / period_s)
    peaks = [0.0, 0.0, 0.0]
    x = y = v_x = v_y = 0.0
    push = 1e-9 * (1.0 + float(np.linalg.norm(trial.stiffness, 2)))
    # A direction that is not an axis of the walls.
    kick = (0.6 * push, 0.8 * push)
    kicked = math.ceil(4 * trial.loop.timing.period_s / period_s)
    first = 0.0
    for tick in range(3 * third):
        lib.hd_sim_read(joystick, reading)
        new_x, new_y = reading.position_m[0], reading.position_m[1]
        if reading.interval_s > 0.0:
            v_x, v_y = (new_x - x) / reading.interval_s, (new_y - y) / reading.interval_s
        x, y = new_x, new_y
        force[0] = -(k_xx * x + k_xy * y + d_xx * v_x + d_xy * v_y)
        force[1] = -(k_xy * x + k_yy * y + d_xy * v_x + d_yy * v_y)
        if tick < kicked:
            force[0] += kick[0]
            force[1] += kick[1]
        lib.hd_sim_put(joystick, force)
        lib.hd_sim_advance(joystick, 1)
        size = max(abs(x), abs(y))
        peaks[tick // third] = max(peaks[tick // third], size)
        if tick < 2 * kicked:
            first = max(first, size)
        elif size > 1e4 * first:
            return True
    return peaks[2] > peaks[1]


# ---- Counts --------------------------------------------------------------------------------------------------------


@dataclass(slots=True)
class Counts:
    """Number of trials with each ending, by the verdict of the margin."""

    fates: Counter[tuple[str, Fate]] = field(default_factory=Counter)
    broken: list[int] = field(default_factory=list)
    """Indices of trials that the margin calls safe and that did not come to rest."""
    plain: Counter[Fate] = field(default_factory=Counter)
    """Endings of the trials that the conditions of the literature call safe."""
    linear: int = 0
    """Number of trials whose linear loop has a spectral radius above 1.001."""
    grew: int = 0
    """Number of these trials whose motion grew in the linear simulation."""
    not_grown: list[int] = field(default_factory=list)
    """Indices of these trials whose motion did not grow."""

    def add(self, index: int, became: Became) -> None:
        """Count a trial."""
        self.fates[became.called, became.fate] += 1
        if became.called == SAFE and became.fate != "rests":
            self.broken.append(index)
        if became.plainly_safe:
            self.plain[became.fate] += 1
        if became.grows is not None:
            self.linear += 1
            self.grew += became.grows
            if not became.grows:
                self.not_grown.append(index)


SAFE, STABLE, GROWING = "safe", "not safe, stable in this hand", "not safe, spectral radius above 1.001"


@dataclass(frozen=True, slots=True)
class Became:
    """Result of a trial."""

    called: str
    """Verdict of the margin: SAFE, STABLE or GROWING."""
    fate: Fate
    plainly_safe: bool
    grows: bool | None
    """Whether the motion of the linear loop grows; None if its spectral radius is at most 1.001."""


def became(seed: int, index: int, longest_s: float = LONGEST_S) -> Became:
    """Draw and simulate a trial. Seed and index determine the result."""
    trial = draw(np.random.default_rng((seed, index)))
    fate = fate_of(trial.config, trial.waypoints, longest_s if trial.safe else min(longest_s, UNSAFE_S)).fate
    radius = trial.radius
    called = SAFE if trial.safe else GROWING if radius > 1.001 else STABLE
    return Became(called, fate, trial.plainly_safe, linear_grows(trial) if radius > 1.001 else None)


def counted(seed: int, indices: range, longest_s: float = LONGEST_S) -> Counts:
    """Count the trials with these indices, one after the other."""
    found = Counts()
    for index in indices:
        found.add(index, became(seed, index, longest_s))
    return found


def trial(point: SweepPoint) -> dict[str, Any]:
    """Return the result of a point of studies/stability_trials.yaml."""
    return asdict(became(point.parameters["seed"], point.parameters["trial"]))


# ---- Maps ----------------------------------------------------------------------------------------------------------

WALL = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "m"}
HELD = {"mass_kg": 0.01, "stiffness_n_per_m": 300.0, "damping_n_s_per_m": 5.0}
"""The default hand."""
LIGHT = {"mass_kg": 0.0, "stiffness_n_per_m": 0.0, "damping_n_s_per_m": 0.0}
"""No hand: a constant force pushes the handle onto the wall."""
LOWEST, HIGHEST = 10.0, 1e5
"""Range of the stiffness in maps, in N/m."""
STEP_RATIO = 1.005
"""Ratio of successive stiffnesses in the search for the first unstable island, from 0.9 of the proved stiffness."""
EDGE_RATIO = 1.001
"""Ratio to which the edge of the first unstable island is found."""
UNPROVED_STEP_RATIO = 1.02
"""As STEP_RATIO if no stiffness is proved: the search then begins at LOWEST."""
BEYOND_RATIO, BEYOND_STEP_RATIO = 2.0, 1.02
"""Stiffnesses up to twice the first unstable one, in steps of 2 %, are tried, as handles may rest there again."""
NO_LIMIT = 1e300
"""Stands for an infinite stiffness in results."""
AXES: dict[str, tuple[str, str, float]] = {
    "rate": ("rate, Hz", "servo.rate_hz", 1.0),
    "delay": ("delay, ms", "device.sim.report_delay_s", 1e3),
    "step": ("encoder step, um", "device.sim.encoder_step_m", 1e6),
    "friction": ("dry friction, N", "device.sim.coulomb_friction_n", 1.0),
}
"""For each map: the label of its axis, the varied key, and the factor from the key's unit to that of the label."""
Tree: TypeAlias = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Start:
    """The initial motion of a handle to the wall."""

    height_m: float
    depth_m: float
    """Depth of the hand's reference at the end."""
    push_n: float
    """The force that pushes a free handle onto the wall."""


FIGURES = ("passive", "quiet", "free", "held", "simulated_light", "simulated_held", "again")
STARTS = (Start(0.005, 0.003, 0.5), Start(0.001, 0.001, 0.2), Start(0.02, 0.008, 1.0))


@dataclass(frozen=True, slots=True)
class Limits:
    """The limits at one point of a map, as stiffnesses in N/m."""

    at: float
    passive: float
    quiet: float
    free: float
    held: float
    """Limits of passivity, of quantisation, and of the linear loop with a free handle and in the default hand."""
    simulated_light: float
    simulated_held: float
    """The smallest stiffness at which the handle does not come to rest; HIGHEST if none was found."""
    again: float
    """Fraction of the stiffnesses up to BEYOND_RATIO times `simulated_light` at which the free handle rests."""


def on_wall(source: Tree, hand: dict[str, float], stiffness: float, start: Start = STARTS[0]) -> Config:
    """Return the configuration of a point of a map with this hand, stiffness and start."""
    tree = deepcopy(source)
    tree["device"]["sim"] |= {"hand": hand, "start_m": [0.0, start.height_m]}
    tree["materials"]["m"]["stiffness_n_per_m"] = stiffness
    if hand is not HELD:
        tree["scene"]["objects"]["push"] = {"kind": "constant", "force_n": [0.0, -start.push_n]}
    return load_config(tree)


def map_fate(source: Tree, hand: dict[str, float], stiffness: float, start: Start = STARTS[0]) -> EndState:
    """Return how the motion of a handle on a wall of this stiffness ends, at a point of a map."""
    config = on_wall(source, hand, stiffness, start)
    deep = -start.depth_m if hand is HELD else start.height_m
    return fate_of(config, [[0.0, 0.0, start.height_m], [0.08, 0.0, deep]], UNSAFE_S)


def _is_unstable(source: Tree, hand: dict[str, float], stiffness: float) -> bool:
    """Return whether the motion cycles or grows from any start. A falling energy, as just below a limit, is stable."""
    return any(map_fate(source, hand, stiffness, start).fate in ("cycles", "grows") for start in STARTS)


def simulated_limit(source: Tree, hand: dict[str, float], proved: float, beyond: float) -> float:
    """Return the smallest stiffness at which a handle on a wall does not come to rest, by a dense search upwards.

    With an encoder, unstable stiffnesses are islands. The search begins below the `proved` stiffness, and ends at 1.5
    times the linear limit `beyond`.
    """
    stiffness, step = (0.9 * proved, STEP_RATIO) if proved > LOWEST else (LOWEST, UNPROVED_STEP_RATIO)
    top = min(HIGHEST, 1.5 * beyond)
    while stiffness < top and not _is_unstable(source, hand, stiffness):
        stiffness *= step
    if stiffness >= top:
        return HIGHEST
    low = stiffness / step
    while stiffness / low > EDGE_RATIO:
        middle = math.sqrt(low * stiffness)
        low, stiffness = (low, middle) if _is_unstable(source, hand, middle) else (middle, stiffness)
    return stiffness


def rests_again(source: Tree, first: float) -> float:
    """Return the fraction of stiffnesses above the first unstable one at which a free handle rests from every start."""
    if first >= HIGHEST:
        return 0.0
    steps = round(math.log(BEYOND_RATIO) / math.log(BEYOND_STEP_RATIO))
    tried = first * BEYOND_STEP_RATIO ** np.arange(1, steps + 1)
    return sum(not _is_unstable(source, LIGHT, float(stiffness)) for stiffness in tried) / len(tried)


def linear_limit(loop: Loop) -> float:
    """Return the stiffness at which the sampled linear loop of one axis has a spectral radius of 1, to 1e-6."""
    low, high = 1e-3, 1e7
    while high / low > 1.0 + 1e-6:
        middle = math.sqrt(low * high)
        # The wall acts on both axes: without it, the other axis of a free handle has an eigenvalue of 1.
        grows = float(spectral_radius(middle * np.eye(2), np.zeros((2, 2)), loop)) > 1.0
        low, high = (low, middle) if grows else (middle, high)
    return low


def limits(point: SweepPoint) -> dict[str, float]:
    """Return the fields of Limits except `at` at a point of studies/stability_{rate,delay,step,friction}.yaml."""
    source, stiffness = point.config, 100.0
    config = on_wall(source, HELD, stiffness)
    factors = evaluated(config).factors(0)
    loop = _loop(config)
    passive, quiet = stiffness * factors["passivity"], stiffness * factors["quantisation"]
    free, held = linear_limit(loop.without_hand()), linear_limit(loop)
    light = simulated_limit(source, LIGHT, min(passive, quiet), free)
    return {
        "passive": min(passive, NO_LIMIT),
        "quiet": min(quiet, NO_LIMIT),
        "free": free,
        "held": held,
        "simulated_light": light,
        "simulated_held": simulated_limit(source, HELD, min(passive, quiet), held),
        "again": rests_again(source, light) if point.parameters.get("again") else 0.0,
    }


PLOT = "stability.png"


def draw_maps(maps: dict[str, list[Limits]], path: Path) -> None:
    """Draw the maps into a file."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, panels = pyplot.subplots(2, 2, figsize=(11, 8.5), sharey=True, layout="constrained")
    for panel, (axis, points) in zip(panels.ravel(), maps.items(), strict=True):
        at = np.array([point.at for point in points])
        # The value 0 is drawn left of all others, since the axis is logarithmic.
        shown = np.where(at > 0.0, at, at[at > 0.0].min() / 3.0)

        def line(name: str, style: str, label: str, points: list[Limits] = points, shown: Floats = shown) -> None:
            values = np.array([getattr(point, name) for point in points])
            # A limit that was not found has no marker.
            top = HIGHEST * (1.0 - 1e-9) if name.startswith("simulated") else 2.0 * HIGHEST
            values = np.where((values > 0.0) & (values <= top), values, np.nan)
            panel.plot(shown, values, style, label=label)  # noqa: B023

        line("passive", "-", "passive (any hand)")
        line("quiet", "--", "encoder's step held by friction")
        line("free", "-.", "linear loop, free handle")
        line("held", ":", "linear loop, default hand")
        line("simulated_light", "v", "simulated, free handle: first unstable island")
        line("simulated_held", "o", "simulated, default hand: first unstable island")
        panel.set_xscale("log")
        panel.set_yscale("log")
        panel.set_ylim(LOWEST / 2.0, 1.6 * HIGHEST)
        panel.set_xlabel(AXES[axis][0])
        panel.grid(visible=True, which="major", alpha=0.4)
        panel.set_xticks(shown, [f"{value:g}" for value in at])
        panel.minorticks_off()
    for panel in panels[:, 0]:
        panel.set_ylabel("stiffness, N/m")
    panels[0, 0].set_title("exact positions, no friction, b = 0.2 N s/m", fontsize=10)
    panels[0, 1].set_title("the same at 10 kHz, positions late", fontsize=10)
    panels[1, 0].set_title("10 kHz, friction 0.05 N, b = 10 N s/m", fontsize=10)
    panels[1, 1].set_title("10 kHz, step 20 um, b = 10 N s/m", fontsize=10)
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=9)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def _rows_of(points: list[Limits]) -> list[list[str]]:
    def cell(value: float) -> str:
        return "any" if value >= HIGHEST else f"{value:.4g}"

    return [
        [
            f"{p.at:g}",
            *(cell(v) for v in (p.passive, p.quiet, p.free, p.simulated_light, p.held, p.simulated_held)),
            f"{100 * p.again:.0f} %",
        ]
        for p in points
    ]


def mapped(client: Any, axis: str, progress: Callable[[float], None], quick: bool = False) -> list[Limits]:
    """Compute a map and return its points; with `quick` only every third point."""
    name, (_, key, scale) = f"stability_{axis}", AXES[axis]
    vary: dict[str, Json] = {}
    if quick:
        places = load_path(STUDIES / f"{name}.yaml").data["vary"][key]  # type: ignore[index,call-overload]
        vary = {key: places[::3]}  # type: ignore[index]
    rows = swept(client, name, progress, vary)
    # Rounded: 0.1 ms instead of 0.10000000000000002 ms.
    return [Limits(float(f"{scale * row[key]:.6g}"), *(row[each] for each in FIGURES)) for row in rows]


def run(options: Options, advance: Advance) -> Section:
    """Return the section with trials and maps; draw the maps into PLOT if pages are written."""
    trials = options.few(TRIALS, 200)
    drawn: dict[str, Json] = {"parameters.trial": {"low": 0, "high": trials - 1, "count": trials}}
    maps: dict[str, list[Limits]] = {}
    found = Counts()
    with workers() as client:
        for row in swept(client, "stability_trials", between(advance, 0.0, 0.6, f"{trials} trials"), drawn):
            result = Became(row["called"], row["fate"], row["plainly_safe"], row["grows"])
            found.add(row["parameters.trial"], result)
        for index, axis in enumerate(AXES):
            progress = between(advance, 0.6 + 0.1 * index, 0.7 + 0.1 * index, f"map of {axis}")
            maps[axis] = mapped(client, axis, progress, quick=options.quick)
    fates: tuple[Fate, ...] = ("rests", "cycles", "grows", "falls")
    rows = []
    for what in (SAFE, STABLE, GROWING):
        numbers = [found.fates[what, fate] for fate in fates]
        rows.append([what, str(sum(numbers)), *map(str, numbers)])
    numbers = [found.plain[fate] for fate in fates]
    rows.append(["safe by the plain conditions", str(sum(numbers)), *map(str, numbers)])
    if options.folder is not None:
        draw_maps(maps, options.folder / PLOT)
    heads = [
        "passive",
        "step held",
        "linear, free",
        "simulated, free",
        "linear, held",
        "simulated, held",
        "rests again",
    ]
    return Section(
        "Stability",
        [
            f"{trials} seeded trials with the servo's tick and the simulated joystick: random walls and corners, "
            "devices and hands. A quarter of the handles are free and pushed; two fifths of the stiffnesses are 0.5, "
            "0.999 or 2 times the proved limit. The first table shows the motion after the hand has come to rest, by "
            f"the verdict of the stability margin. {len(found.broken)} trials are called safe and do not come to rest. "
            f"{found.linear} trials have a linear loop with a spectral radius above 1.001; {found.grew} of them grow "
            "in the bilateral loop without friction, rounding and limit. A trial runs for at most "
            f"{UNSAFE_S:.0f} s ({LONGEST_S:.0f} s if it is called safe); [Maps](stability.md#maps) defines rest and "
            "cycle. The plain conditions are those of the [literature](stability.md#the-proof).",
            "The other tables have stiffness limits on one wall, of the handle without a hand (free) and in the "
            "default hand (held). Passive and step held: the proved limits of passivity and of quantisation. Linear: "
            "the limit of the linear loop. Simulated: the smallest stiffness at which the handle does not come to "
            "rest. The search for this first unstable island goes upwards by "
            f"{100 * (STEP_RATIO - 1):.1f} % from 0.9 of the proved stiffness, from {len(STARTS)} starts. Rests again: "
            f"fraction of the stiffnesses up to {BEYOND_RATIO:g} times as large at which a free handle rests. Any: no "
            f"limit was found up to {HIGHEST:g} N/m.",
            Table(
                "Trials by verdict of the stability margin and by motion",
                ["", "trials", "rest", "cycle", "grow", "still falling"],
                rows,
            ),
            *(
                Table(f"Stiffness over {label}, N/m", [label, *heads], _rows_of(maps[axis]))
                for axis, (label, *_) in AXES.items()
            ),
        ],
    )
