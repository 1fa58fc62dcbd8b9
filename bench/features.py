"""What each feature of a surface adds to a tick, beside the error of what it renders; and what a ringing mode costs.

The probe strokes: it goes to and fro along a surface that it presses with about 0.8 N, and its velocity is given. A
feature is compared with the bare wall under the same strokes, round by round. The references are written here from
the equations and share no code with what is measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from bench.report import Advance, Floats, Options, Section, Table, spread, verdict
from bench.tick import RATE_HZ, STRETCH, Motion, Stretch
from hapticd.base.core import EventKind, Flag
from hapticd.rendering.offline import Run, render_run

STIFFNESS, DAMPING = 800.0, 1.0
DEPTH_M = 1e-3
SPEED_M_PER_S = 0.1
MASS_KG = 0.05
FRICTION, FRICTION_STIFFNESS = 0.3, 500.0
SPACING_M, WIDTH_M, GROOVE_M, DRAG = 2e-3, 5e-4, 1e-4, 3.0
GAINS = (30.0, 3.0)
"""Of grooves and of noise: (m/s^2) per m/s, and per N."""
LEVELS = tuple(1.0 + 0.05 * i for i in range(16))
"""RMS of the models, m/s^2."""
GRID_SPEEDS, GRID_FORCES = (0.04, 0.08, 0.12, 0.16), (0.4, 0.7, 1.0, 1.3)
SOFT, RAMP_M = 400.0, 2e-3
RADIUS_M, SMALL_M = 0.05, 0.0015
MODES = (1, 10, 100, 1000)


# ---- Motion --------------------------------------------------------------------------------------------------------


def strokes(stretches: int, speed: float = SPEED_M_PER_S, begin_m: float = 0.0, height_m: float = -DEPTH_M) -> Motion:
    """To the right and back at constant speed and height. At rest with a speed of 0."""
    count = stretches * STRETCH
    tick = np.arange(count)
    x = begin_m + speed / RATE_HZ * np.minimum(tick, count - tick)
    along = np.where((tick > 0) & (tick <= count // 2), speed, -speed)
    return Motion(np.stack((x, np.full(count, height_m)), 1), np.stack((along, np.zeros(count)), 1))


def _waving() -> Motion:
    """20 mm to either side and back, pressed with 0.56 to 1.04 N: speed and force change from tick to tick."""
    count = 64 * STRETCH
    turn = 2 * np.pi * np.arange(count) / count
    rate = 2 * np.pi * RATE_HZ / count
    path = np.stack((0.02 * np.sin(turn), -DEPTH_M + 3e-4 * np.sin(3 * turn)), 1)
    return Motion(path, np.stack((0.02 * rate * np.cos(turn), 9e-4 * rate * np.cos(3 * turn)), 1))


def _around(radius_m: float) -> Motion:
    """As `strokes`, around within a disc whose top is at 0."""
    flat = strokes(64, begin_m=-0.02)
    inside = radius_m - DEPTH_M
    angle = flat.path_m[:, 0] / inside
    radial = np.stack((np.sin(angle), np.cos(angle)), 1)
    tangent = np.stack((np.cos(angle), -np.sin(angle)), 1)
    return Motion(np.subtract(inside * radial, (0.0, radius_m)), flat.speeds_m_per_s[:, :1] * tangent)


# Turns lie more than half a spacing from the groove that was passed last, so that it strikes again on the way back.
STEADY = strokes(64, begin_m=-0.0195)
WAVING = _waving()
AROUND, AROUND_DEEP = _around(RADIUS_M), _around(SMALL_M)
IN_RAMP = strokes(1, begin_m=-3.2e-4)
OFF_RAMP = strokes(1, begin_m=0.025)


# ---- Scenes --------------------------------------------------------------------------------------------------------


def _coefficients(order: int, seed: int) -> list[float]:
    """a_1 .. a_p of a stable filter: the step-up recursion from random reflection coefficients."""
    polynomial = np.ones(1)
    for k in np.random.default_rng(seed).uniform(-0.3, 0.3, order):
        polynomial = np.append(polynomial, 0.0) + k * np.append(0.0, polynomial[::-1])
    return [float(a) for a in polynomial[1:]]


def _models(order: int, gridded: bool) -> list[dict[str, object]]:
    places = [(v, f) for v in GRID_SPEEDS for f in GRID_FORCES] if gridded else [(SPEED_M_PER_S, 0.8)]
    return [
        {"speed_m_per_s": v, "force_n": f, "coefficients": _coefficients(order, seed), "rms_m_per_s2": LEVELS[seed]}
        for seed, (v, f) in enumerate(places)
    ]


def _grooves(display: str, **keys: object) -> dict[str, object]:
    return {"kind": "grooves", "display": display, "spacing_m": SPACING_M, "width_m": WIDTH_M, **keys}


def _noise(peak_hz: float, mean_hz: float) -> dict[str, object]:
    gains = dict(zip(("velocity_gain_per_s", "force_gain_m_per_s2_per_n"), GAINS, strict=True))
    return {"kind": "stochastic", "peak_hz": peak_hz, "mean_hz": mean_hz, **gains}


def _autoregressive(order: int, gridded: bool) -> dict[str, object]:
    return {"kind": "autoregressive", "rate_hz": RATE_HZ, "models": _models(order, gridded)}


TEXTURES: Mapping[str, dict[str, object]] = {
    "comb": _grooves(
        "vibration",
        velocity_gain_per_s=GAINS[0],
        force_gain_m_per_s2_per_n=GAINS[1],
        frequency_hz=200,
        decay_time_s=0.003,
    ),
    "shape": _grooves("geometry", depth_m=GROOVE_M),
    "drag": _grooves("damping", damping_n_s_per_m=DRAG),
    "plain noise": _noise(250.0, 310.0),
    "noise with a zero": _noise(250.0, 200.0),
    "ar10": _autoregressive(10, False),
    "ar32": _autoregressive(32, False),
    "ar10 grid": _autoregressive(10, True),
    "ar32 grid": _autoregressive(32, True),
}
BARE: dict[str, object] = {"stiffness_n_per_m": STIFFNESS, "damping_n_s_per_m": DAMPING}
MATERIALS: Mapping[str, object] = {
    "bare": BARE,
    "rubbery": {**BARE, "friction": {"coefficient": FRICTION, "stiffness_n_per_m": FRICTION_STIFFNESS}},
    "soft": {**BARE, "stiffness_n_per_m": SOFT},
    **{name: {**BARE, "texture": texture} for name, texture in TEXTURES.items()},
}
BOX = {"kind": "box", "center_m": [0, -0.05], "size_m": [0.1, 0.1], "material": "bare"}
DISC = {"kind": "disc", "center_m": [0, -RADIUS_M], "radius_m": RADIUS_M, "material": "bare"}
SMALL = {"kind": "disc", "center_m": [0, -SMALL_M], "radius_m": SMALL_M, "material": "bare"}
FLUSH = {side: {**BOX, "center_m": [x, -0.05], "material": "rubbery"} for side, x in (("left", -0.05), ("right", 0.05))}
"""Two boxes that meet at s = 0."""
SKIN = {"kind": "membrane", "center_m": [0, 0], "normal": [0, 1], "width_m": 0.1, "material": "bare"}
EDGE = {"patches": [{"from_m": 0, "to_m": 0.05, "material": "soft"}], "patch_ramp_m": RAMP_M}


def _wall(material: str, **keys: object) -> dict[str, object]:
    return {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": material, **keys}


# ---- Errors --------------------------------------------------------------------------------------------------------


def _objects(item: Mapping[str, object]) -> dict[str, object]:
    """One object, or several by their names."""
    return {"it": item} if "kind" in item else dict(item)


def _entered(item: Mapping[str, object], motion: Motion, times: int = 1) -> tuple[Run, int]:
    """A run that comes down onto the object and then goes through the motion, and the tick at which that begins."""
    down = 100
    height = np.linspace(motion.path_m[0, 1] + 0.004, motion.path_m[0, 1], down, endpoint=False)
    way = np.stack((np.full(down, motion.path_m[0, 0]), height), 1)
    path = np.concatenate((way, np.tile(motion.path_m, (times, 1))))
    speeds = np.concatenate((np.tile([0.0, -0.4], (down, 1)), np.tile(motion.speeds_m_per_s, (times, 1))))
    config = {"materials": MATERIALS, "scene": {"objects": _objects(item)}, "device": {"effective_mass_kg": MASS_KG}}
    return render_run(config, path, RATE_HZ, velocity_m_per_s=speeds), down


def _force_error(item: Mapping[str, object], motion: Motion, law: Callable[[Floats, Floats], Floats]) -> str:
    """The largest difference of the force, [n][2], from the law of position and velocity."""
    run, begin = _entered(item, motion)
    rendered = run.samples["contact_force_n"][begin:]
    return f"force: {np.abs(rendered - law(motion.path_m, motion.speeds_m_per_s)).max():.1e} N"


def _bare(path: Floats, speeds: Floats) -> Floats:
    """F = (0, K d - D v_y)."""
    return np.stack((np.zeros(len(path)), -STIFFNESS * path[:, 1] - DAMPING * speeds[:, 1]), 1)


def _round(path: Floats, radius_m: float) -> Floats:
    """F = K (R - r) along the radius; nothing moves along it."""
    offset = np.add(path, (0.0, radius_m))
    distance = np.hypot(offset[:, 0], offset[:, 1])
    law: Floats = (STIFFNESS * (radius_m - distance) / distance)[:, None] * offset
    return law


def _sticking(path: Floats, speeds: Floats) -> Floats:
    """Coulomb friction behind a spring, from turn to turn: f = clip(f_turn - k (s - s_turn), -mu F_n, mu F_n)."""
    force = _bare(path, speeds)
    s = path[:, 0]
    largest = FRICTION * STIFFNESS * DEPTH_M
    turn = len(path) // 2
    force[: turn + 1, 0] = np.clip(-FRICTION_STIFFNESS * (s[: turn + 1] - s[0]), -largest, largest)
    force[turn:, 0] = np.clip(force[turn, 0] - FRICTION_STIFFNESS * (s[turn:] - s[turn]), -largest, largest)
    return force


def _profile(s: Floats) -> tuple[Floats, Floats]:
    """The raised cosine of the groove nearest to s, 0 to 1, and its slope."""
    offset = s - SPACING_M * np.round(s / SPACING_M)
    inside = 2 * np.abs(offset) < WIDTH_M
    turn = 2 * np.pi / WIDTH_M
    return (
        np.where(inside, np.cos(turn * offset / 2) ** 2, 0.0),
        np.where(inside, -turn * np.sin(turn * offset / 2) * np.cos(turn * offset / 2), 0.0),
    )


def _shaped(path: Floats, speeds: Floats) -> Floats:
    """F = (K e h', K e - D v_y), e = d - h."""
    height, slope = _profile(path[:, 0])
    elastic = STIFFNESS * (-path[:, 1] - GROOVE_M * height)
    return np.stack((elastic * GROOVE_M * slope, elastic - DAMPING * speeds[:, 1]), 1)


def _dragged(path: Floats, speeds: Floats) -> Floats:
    force = _bare(path, speeds)
    force[:, 0] = -DRAG * _profile(path[:, 0])[0] * speeds[:, 0]
    return force


def _patched(path: Floats, speeds: Floats) -> Floats:
    """F = (-K'/2 d^2, K d - D v_y), K going from the wall's to the patch's by 3 x^2 - 2 x^3 over the ramp."""
    part = np.clip(path[:, 0] / RAMP_M + 0.5, 0.0, 1.0)
    stiffness = STIFFNESS + (SOFT - STIFFNESS) * (3 * part**2 - 2 * part**3)
    slope = (SOFT - STIFFNESS) * 6 * part * (1 - part) / RAMP_M
    depth = -path[:, 1]
    return np.stack((-0.5 * slope * depth**2, stiffness * depth - DAMPING * speeds[:, 1]), 1)


def _strike_error() -> str:
    """Number, times and amplitudes of the strikes of two strokes."""
    run, begin = _entered(_wall("comb"), STEADY)
    struck = run.events[run.events["kind"] == EventKind.GROOVE]
    times = struck["tick"] / RATE_HZ - struck["before_tick_s"]
    half = len(STEADY.path_m) // 2
    left, right = STEADY.path_m[0, 0], STEADY.path_m[half, 0]
    grooves = SPACING_M * np.arange(math.ceil(left / SPACING_M), math.floor(right / SPACING_M) + 1)
    there = begin / RATE_HZ + (grooves - left) / SPEED_M_PER_S
    back = (begin + half) / RATE_HZ + (right - grooves[::-1]) / SPEED_M_PER_S
    wanted = np.concatenate((there, back))
    count = f"{len(times)} of {len(wanted)} strikes"
    if len(times) != len(wanted):
        return count
    amplitude = GAINS[0] * SPEED_M_PER_S + GAINS[1] * STIFFNESS * DEPTH_M
    relative = np.abs(struck["amplitude_m_per_s2"] / amplitude - 1).max()
    return f"{count}, times: {np.abs(times - wanted).max():.1e} s, A: {relative:.1e} of it"


def _bilinear(values: Floats, speed: Floats, force: Floats) -> Floats:
    """`values` [speeds][forces] of the grid at each speed and force, [n]; beyond the grid, those at its edge."""
    rows = np.stack([np.interp(force, GRID_FORCES, row) for row in values])
    weights = np.stack([np.interp(speed, GRID_SPEEDS, unit) for unit in np.eye(len(GRID_SPEEDS))])
    total: Floats = (rows * weights).sum(0)
    return total


def _noise_error(name: str, motion: Motion, options: Options) -> str:
    """The RMS of a minute against the law, each sample over what the law says at its speed and force."""
    seconds = options.few(60, 4)
    run, begin = _entered(_wall(name), motion, max(1, round(seconds * RATE_HZ / len(motion.path_m))))
    samples = run.samples[begin:]
    speed = np.abs(samples["velocity_m_per_s"][:, 0])
    force = -STIFFNESS * samples["position_m"][:, 1] - DAMPING * samples["velocity_m_per_s"][:, 1]
    if TEXTURES[name]["kind"] == "stochastic":
        law = GAINS[0] * speed + GAINS[1] * force
    else:
        levels = np.reshape(LEVELS, (len(GRID_SPEEDS), len(GRID_FORCES)))
        law = _bilinear(levels, speed, force) if name.endswith("grid") else np.full(len(speed), LEVELS[0])
    heard = speed > 0.002
    sample = samples["vibration_force_n"][heard, 0] / MASS_KG / law[heard]
    return f"RMS: {100 * abs(math.sqrt(sample @ sample / len(sample)) - 1):.2f} % off"


# ---- The table -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Case:
    """A row: an object or several, how it is stroked, and what is said of its error."""

    item: Mapping[str, object]
    motion: Motion
    error: Callable[[Options], str]
    bare: str | None
    """The row that it is compared with."""


def _cases() -> dict[str, Case]:
    steady, waving, short = "bare wall", "bare wall, waving", "bare wall, short strokes"

    def forced(item: Mapping[str, object], motion: Motion, law: Callable[[Floats, Floats], Floats]) -> Case:
        # The law is asked where force and speed change too, but for what remembers where it has been.
        tried = WAVING if motion is STEADY and law is not _sticking else motion
        bare = short if motion in (IN_RAMP, OFF_RAMP) else steady
        return Case(item, motion, lambda _: _force_error(item, tried, law), bare)

    def noisy(name: str, motion: Motion) -> Case:
        bare = steady if motion is STEADY else waving
        return Case(_wall(name), motion, lambda options: _noise_error(name, motion, options), bare)

    wall = _wall("bare")
    return {
        steady: Case(wall, STEADY, lambda _: _force_error(wall, STEADY, _bare), None),
        waving: Case(wall, WAVING, lambda _: _force_error(wall, WAVING, _bare), None),
        short: Case(wall, OFF_RAMP, lambda _: _force_error(wall, OFF_RAMP, _bare), None),
        "box": forced(BOX, STEADY, _bare),
        "disc": forced(DISC, AROUND, lambda path, _: _round(path, RADIUS_M)),
        "disc of 1.5 mm, at a third of its radius": forced(SMALL, AROUND_DEEP, lambda path, _: _round(path, SMALL_M)),
        "membrane": forced(SKIN, STEADY, _bare),
        "friction": forced(_wall("rubbery"), STEADY, _sticking),
        "friction, over the seam of two boxes": forced(FLUSH, STEADY, _sticking),
        "grooves as vibration": Case(_wall("comb"), STEADY, lambda _: _strike_error(), steady),
        "grooves as geometry": forced(_wall("shape"), STEADY, _shaped),
        "grooves as damping": forced(_wall("drag"), STEADY, _dragged),
        "patches, away from the ramp": forced(_wall("bare", **EDGE), OFF_RAMP, _patched),
        "patches, in the ramp": forced(_wall("bare", **EDGE), IN_RAMP, _patched),
        "stochastic, order 2": noisy("plain noise", STEADY),
        "stochastic, order 2 and a zero": noisy("noise with a zero", STEADY),
        "autoregressive, order 10": noisy("ar10", STEADY),
        "autoregressive, order 32": noisy("ar32", STEADY),
        "order 10 on 4 x 4, steady": noisy("ar10 grid", STEADY),
        "order 32 on 4 x 4, steady": noisy("ar32 grid", STEADY),
        "order 10 on 4 x 4, waving": noisy("ar10 grid", WAVING),
        "order 32 on 4 x 4, waving": noisy("ar32 grid", WAVING),
    }


def _features(options: Options, advance: Advance) -> Table:
    cases = _cases()
    errors = {}
    for index, (name, case) in enumerate(cases.items()):
        errors[name] = case.error(options)
        advance(0.3 * (index + 1) / len(cases), "errors")
    scenes = {name: Stretch(_objects(case.item), case.motion, materials=MATERIALS) for name, case in cases.items()}
    rounds, times = options.few(30, 4), options.few(40, 4)
    taken: dict[str, list[float]] = {name: [] for name in cases}
    for index in range(rounds):
        for name, scene in scenes.items():
            # As many ticks of each, however long the motion is.
            repeats = times * len(STEADY.path_m) // len(scene.motion.path_m)
            scene.enter()
            scene.render(max(1, repeats // 20))
            taken[name].append(float(np.median(scene.timed(repeats))))
            if not scene.flags() & Flag.CONTACT:
                raise RuntimeError(f"{name}: is not touched")
        advance(0.3 + 0.7 * (index + 1) / rounds, "features")
    rows = []
    for name, case in cases.items():
        more = "" if case.bare is None else spread(np.subtract(taken[name], taken[case.bare]), ".1f")
        rows.append([name, spread(taken[name], ".1f"), more, errors[name]])
    return Table(
        f"ns a tick, {rounds} rounds in turns, each of {times * len(STEADY.path_m)} ticks: median (10 to 90 %)",
        ["surface", "ns a tick", "more than the bare wall", "error against the reference"],
        rows,
    )


# ---- Ringing modes -------------------------------------------------------------------------------------------------

BELL_M = 0.02
DECAY_PER_S = 0.2
SLOPE_PER_S = 0.05


def _frequency_rad_per_s(index: int) -> float:
    return 300.0 + 5.0 * index


def _bells(count: int, ringing: bool) -> Stretch:
    """Walls that are touched and left again together; the probe rests out of their reach."""
    materials: dict[str, object] = {}
    for i in range(count):
        tap = {
            "attack_slope_per_s": SLOPE_PER_S,
            "angular_frequency_rad_per_s": _frequency_rad_per_s(i),
            "decay_rate_per_s": DECAY_PER_S,
        }
        materials[f"m{i}"] = {"stiffness_n_per_m": 1, **({"tap": tap} if ringing else {})}
    objects = {f"wall{i}": _wall(f"m{i}") for i in range(count)}
    return Stretch(objects, strokes(1, 0.0, 0.0, BELL_M), materials=materials)


def _ring(scene: Stretch) -> float:
    """Taps all walls with 0.2 m/s and leaves them; how many ticks ago that was, in ticks, at the last one."""
    down, up = np.linspace(0.002, -1e-4, 106), np.linspace(-1e-4, BELL_M, 202)
    height = np.concatenate((np.linspace(BELL_M, 0.002, 100), down[1:], up[1:]))
    onset = 99 + 0.002 / (down[0] - down[1])
    speeds = np.stack((np.zeros(len(height)), np.full(len(height), -0.2)), 1)
    scene.go(np.stack((np.zeros(len(height)), height), 1), speeds)
    return len(height) - 1 - onset


def _rotor_error(count: int, seconds: float) -> float:
    """Largest error of the sum of `count` modes over so long, as a fraction of the sum of their amplitudes."""
    scene = _bells(count, True)
    ago = _ring(scene)
    omega = np.array([_frequency_rad_per_s(i) for i in range(count)], dtype=np.longdouble)
    amplitude = 0.2 * SLOPE_PER_S * MASS_KG
    worst = 0.0
    rest = np.tile([0.0, BELL_M], (STRETCH, 1))
    calls = round(seconds * RATE_HZ / STRETCH)
    for call in range(calls):
        samples, _ = scene.go(rest, np.zeros((STRETCH, 2)))
        if call % (calls // 100 + 1) == 0 or call == calls - 1:
            time_s = np.longdouble(ago + call * STRETCH + 1) / np.longdouble(RATE_HZ)
            wanted = amplitude * np.sum(np.exp(-np.longdouble(DECAY_PER_S) * time_s) * np.sin(omega * time_s))
            worst = max(worst, abs(float(samples["vibration_force_n"][0, 1] - wanted)))
    return worst / (count * amplitude)


def _modes(options: Options, advance: Advance) -> Table:
    rounds, calls = options.few(30, 4), options.few(100, 20)
    seconds = options.few(5, 1)
    pairs = [(count, _bells(count, True), _bells(count, False)) for count in MODES]
    added: dict[int, list[float]] = {count: [] for count in MODES}
    for index in range(rounds):
        for count, ringing, silent in pairs:
            for scene in (ringing, silent):
                _ring(scene)
                scene.render(5)
            share = max(10, calls * 10 // (10 + count))
            with_modes = float(np.median(ringing.timed(share)))
            added[count].append(with_modes - float(np.median(silent.timed(share))))
            if not ringing.flags() & Flag.RINGING or silent.flags() & Flag.RINGING:
                raise RuntimeError(f"{count} modes: do not ring as they should")
        advance(0.8 * (index + 1) / rounds, "ringing modes")
    rows = []
    for index, count in enumerate(MODES):
        error = _rotor_error(count, seconds)
        per_mode = np.array(added[count]) / count
        rows.append([f"{count} ringing", spread(added[count], ".1f"), spread(per_mode, ".2f"), "", "", f"{error:.1e}"])
        advance(0.8 + 0.2 * (index + 1) / len(MODES), "their error")
    counts = np.array(MODES, dtype=np.float64)
    slopes = [float(np.polyfit(counts, each, 1, w=1 / counts)[0]) for each in np.array([added[n] for n in MODES]).T]
    reached = verdict(float(np.median(slopes)), 6.0)
    rows.append(["slope of a fit", "", spread(slopes, ".2f"), "< 6", reached, ""])
    return Table(
        f"Ringing modes, out of reach of what rings: ns more than the same scene silent, {rounds} rounds in turns "
        f"(10 to 90 %); error in {seconds} s, as a fraction of the sum of the amplitudes",
        ["modes", "ns a tick", "ns a mode", "aim", "reached", "error"],
        rows,
    )


def run(options: Options, advance: Advance) -> Section:
    """All tables of it."""
    return Section(
        "Features",
        [
            "`hd_render` from Python, one object (a seam: two boxes), velocities given. The probe strokes 41 mm to and "
            "fro at 0.1 m/s, pressed with 0.8 N; waving, it swings 20 mm to either side at up to 0.15 m/s, pressed "
            "with 0.56 to 1.04 N; short strokes are of 0.64 mm. Grooves are 2 mm apart; the ringing of those that "
            "strike is in their row. Forces are compared with the formulas at every tick of a whole stroke, of the "
            "waving one where the surface has no memory; noise by the RMS of a minute against the law, whose own "
            "scatter is up to 1 %.",
            _features(options, lambda part, what: advance(0.75 * part, what)),
            _modes(options, lambda part, what: advance(0.75 + 0.25 * part, what)),
        ],
    )
