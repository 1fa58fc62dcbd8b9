"""Cost of each feature of a surface, and of an active mode, in a tick.

The probe strokes a surface to and fro, pressing with about 0.8 N; velocities are given. A feature is compared with a
bare wall under the same strokes, round by round.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bench.report import Advance, Options, Section, Table, spread, verdict
from bench.tick import RATE_HZ, STRETCH, Motion, Stretch, measured
from hapticd.base.core import Flag

STIFFNESS, DAMPING = 800.0, 1.0
DEPTH_M = 1e-3
SPEED_M_PER_S = 0.1
FRICTION, FRICTION_STIFFNESS = 0.3, 500.0
SPACING_M, WIDTH_M, GROOVE_M, DRAG = 2e-3, 5e-4, 1e-4, 3.0
GAINS = (30.0, 3.0)
"""Gains of grooves and noise: (m/s^2) per m/s, and (m/s^2) per N."""
RMS_M_PER_S2 = tuple(1.0 + 0.05 * i for i in range(16))
"""RMS of each autoregressive model."""
GRID_SPEEDS, GRID_FORCES = (0.04, 0.08, 0.12, 0.16), (0.4, 0.7, 1.0, 1.3)
SOFT, RAMP_M = 400.0, 2e-3
RADIUS_M, SMALL_M = 0.05, 0.0015
MODES = (1, 10, 100, 1000)


# ---- Motion --------------------------------------------------------------------------------------------------------


def strokes(stretches: int, speed: float = SPEED_M_PER_S, begin_m: float = 0.0, height_m: float = -DEPTH_M) -> Motion:
    """Return a stroke to the right and back at constant speed and height; with a speed of 0 the probe rests."""
    count = stretches * STRETCH
    tick = np.arange(count)
    x = begin_m + speed / RATE_HZ * np.minimum(tick, count - tick)
    along = np.where((tick > 0) & (tick <= count // 2), speed, -speed)
    return Motion(np.stack((x, np.full(count, height_m)), 1), np.stack((along, np.zeros(count)), 1))


def _waving() -> Motion:
    """Return a motion of 20 mm to either side, pressed with 0.56 to 1.04 N; speed and force change at every tick."""
    count = 64 * STRETCH
    turn = 2 * np.pi * np.arange(count) / count
    rate = 2 * np.pi * RATE_HZ / count
    path = np.stack((0.02 * np.sin(turn), -DEPTH_M + 3e-4 * np.sin(3 * turn)), 1)
    return Motion(path, np.stack((0.02 * rate * np.cos(turn), 9e-4 * rate * np.cos(3 * turn)), 1))


def _around(radius_m: float) -> Motion:
    """Return a stroke along the surface of a disc whose top is at y = 0."""
    flat = strokes(64, begin_m=-0.02)
    inside = radius_m - DEPTH_M
    angle = flat.path_m[:, 0] / inside
    radial = np.stack((np.sin(angle), np.cos(angle)), 1)
    tangent = np.stack((np.cos(angle), -np.sin(angle)), 1)
    return Motion(np.subtract(inside * radial, (0.0, radius_m)), flat.speeds_m_per_s[:, :1] * tangent)


# The probe turns more than half a spacing behind the last groove, so that this groove strikes again on the way back.
STEADY = strokes(64, begin_m=-0.0195)
WAVING = _waving()
AROUND, AROUND_DEEP = _around(RADIUS_M), _around(SMALL_M)
IN_RAMP = strokes(1, begin_m=-3.2e-4)
OFF_RAMP = strokes(1, begin_m=0.025)


# ---- Scenes --------------------------------------------------------------------------------------------------------


def _coefficients(order: int, seed: int) -> list[float]:
    """Return coefficients a_1 to a_p of a stable filter, by step-up recursion from random reflection coefficients."""
    polynomial = np.ones(1)
    for k in np.random.default_rng(seed).uniform(-0.3, 0.3, order):
        polynomial = np.append(polynomial, 0.0) + k * np.append(0.0, polynomial[::-1])
    return [float(a) for a in polynomial[1:]]


def _models(order: int, gridded: bool) -> list[dict[str, object]]:
    places = [(v, f) for v in GRID_SPEEDS for f in GRID_FORCES] if gridded else [(SPEED_M_PER_S, 0.8)]
    return [
        {
            "speed_m_per_s": v,
            "force_n": f,
            "coefficients": _coefficients(order, seed),
            "rms_m_per_s2": RMS_M_PER_S2[seed],
        }
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
"""Two boxes that meet at x = 0."""
SKIN = {"kind": "membrane", "center_m": [0, 0], "normal": [0, 1], "width_m": 0.1, "material": "bare"}
EDGE = {"patches": [{"from_m": 0, "to_m": 0.05, "material": "soft"}], "patch_ramp_m": RAMP_M}


def _wall(material: str, **keys: object) -> dict[str, object]:
    return {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": material, **keys}


def _objects(item: Mapping[str, object]) -> dict[str, object]:
    """Return a scene of one object, or of several objects by name."""
    return {"it": item} if "kind" in item else dict(item)


# ---- The table -----------------------------------------------------------------------------------------------------


STEADY_WALL, WAVING_WALL, SHORT_STROKES = "bare wall", "bare wall, waving", "bare wall, short strokes"
SURFACE_CASES: Mapping[str, tuple[Mapping[str, object], Motion, str | None]] = {
    STEADY_WALL: (_wall("bare"), STEADY, None),
    WAVING_WALL: (_wall("bare"), WAVING, None),
    SHORT_STROKES: (_wall("bare"), OFF_RAMP, None),
    "box": (BOX, STEADY, STEADY_WALL),
    "disc": (DISC, AROUND, STEADY_WALL),
    "disc of 1.5 mm, at a third of its radius": (SMALL, AROUND_DEEP, STEADY_WALL),
    "membrane": (SKIN, STEADY, STEADY_WALL),
    "friction": (_wall("rubbery"), STEADY, STEADY_WALL),
    "friction, over the seam of two boxes": (FLUSH, STEADY, STEADY_WALL),
    "grooves as vibration": (_wall("comb"), STEADY, STEADY_WALL),
    "grooves as geometry": (_wall("shape"), STEADY, STEADY_WALL),
    "grooves as damping": (_wall("drag"), STEADY, STEADY_WALL),
    "patches, away from the ramp": (_wall("bare", **EDGE), OFF_RAMP, SHORT_STROKES),
    "patches, in the ramp": (_wall("bare", **EDGE), IN_RAMP, SHORT_STROKES),
    "stochastic, order 2": (_wall("plain noise"), STEADY, STEADY_WALL),
    "stochastic, order 2 and a zero": (_wall("noise with a zero"), STEADY, STEADY_WALL),
    "autoregressive, order 10": (_wall("ar10"), STEADY, STEADY_WALL),
    "autoregressive, order 32": (_wall("ar32"), STEADY, STEADY_WALL),
    "order 10 on 4 x 4, steady": (_wall("ar10 grid"), STEADY, STEADY_WALL),
    "order 32 on 4 x 4, steady": (_wall("ar32 grid"), STEADY, STEADY_WALL),
    "order 10 on 4 x 4, waving": (_wall("ar10 grid"), WAVING, WAVING_WALL),
    "order 32 on 4 x 4, waving": (_wall("ar32 grid"), WAVING, WAVING_WALL),
}
"""For each row of the table: its objects, the motion of the probe, and the row with which it is compared."""


def _features(options: Options, advance: Advance) -> Table:
    scenes = {
        name: Stretch(_objects(item), motion, materials=MATERIALS) for name, (item, motion, _) in SURFACE_CASES.items()
    }
    rounds, times = options.few(30, 4), options.few(40, 4)
    ticks = times * len(STEADY.path_m)
    touched = dict.fromkeys(SURFACE_CASES, Flag.CONTACT)
    taken = measured(scenes, touched, Flag.CONTACT, rounds, ticks, lambda part: advance(part, "features"))
    rows = []
    for name, (_, _, bare) in SURFACE_CASES.items():
        more = "" if bare is None else spread(np.subtract(taken[name], taken[bare]), ".1f")
        rows.append([name, spread(taken[name], ".1f"), more])
    return Table(
        f"ns a tick, {rounds} interleaved rounds, each of {ticks} ticks: median (10 to 90 %)",
        ["surface", "ns a tick", "ns more than the bare wall"],
        rows,
    )


# ---- Ringing modes -------------------------------------------------------------------------------------------------

BELL_M = 0.02
DECAY_PER_S = 0.2
SLOPE_PER_S = 0.05


def _frequency_rad_per_s(index: int) -> float:
    return 300.0 + 5.0 * index


def _bells(count: int, ringing: bool) -> Stretch:
    """Return a scene of walls that are touched at the same time; the probe then rests out of reach."""
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


def _ring(scene: Stretch) -> None:
    """Tap all walls at 0.2 m/s, and leave them."""
    down, up = np.linspace(0.002, -1e-4, 106), np.linspace(-1e-4, BELL_M, 202)
    height = np.concatenate((np.linspace(BELL_M, 0.002, 100), down[1:], up[1:]))
    speeds = np.stack((np.zeros(len(height)), np.full(len(height), -0.2)), 1)
    scene.go(np.stack((np.zeros(len(height)), height), 1), speeds)


def _modes(options: Options, advance: Advance) -> Table:
    rounds, calls = options.few(30, 4), options.few(100, 20)
    pairs = [(count, _bells(count, True), _bells(count, False)) for count in MODES]
    added: dict[int, list[float]] = {count: [] for count in MODES}
    for index in range(rounds):
        for count, ringing, silent in pairs:
            for scene in (ringing, silent):
                _ring(scene)
                scene.render(5)
            repeats = max(10, calls * 10 // (10 + count))
            with_modes = float(np.median(ringing.timed(repeats)))
            added[count].append(with_modes - float(np.median(silent.timed(repeats))))
            if not ringing.flags() & Flag.RINGING or silent.flags() & Flag.RINGING:
                raise RuntimeError(f"{count} modes: some do not ring, or a silent scene rings")
        advance((index + 1) / rounds, "ringing modes")
    rows = []
    for count in MODES:
        per_mode = np.array(added[count]) / count
        rows.append([f"{count} ringing", spread(added[count], ".1f"), spread(per_mode, ".2f"), "", ""])
    counts = np.array(MODES, dtype=np.float64)
    slopes = [float(np.polyfit(counts, each, 1, w=1 / counts)[0]) for each in np.array([added[n] for n in MODES]).T]
    reached = verdict(float(np.median(slopes)), 6.0)
    rows.append(["slope of a fit", "", spread(slopes, ".2f"), "< 6", reached])
    return Table(
        f"Ringing modes, probe out of reach: ns more than in the scene without ringing, {rounds} interleaved rounds "
        "(10 to 90 %)",
        ["modes", "ns a tick", "ns a mode", "aim", "reached"],
        rows,
    )


def run(options: Options, advance: Advance) -> Section:
    """Return the section with the costs of features and active modes."""
    return Section(
        "Features",
        [
            "Python calls `hd_render` with given velocities and one object (a seam: two boxes). The probe strokes 41 "
            "mm to and fro at 0.1 m/s and presses with 0.8 N. *Waving*: the probe swings 20 mm to either side at up to "
            "0.15 m/s and presses with 0.56 to 1.04 N. Short strokes are 0.64 mm long. *On 4 x 4*: an autoregressive "
            "texture of 4 by 4 models over speed and force. The spacing of grooves is 2 mm; the row of grooves as "
            "vibration includes the ringing of their modes. `tests/tick/` asserts the error of each feature; [Features "
            "of a surface](alternatives.md#features-of-a-surface) has the errors, measured once.",
            _features(options, lambda part, what: advance(0.75 * part, what)),
            _modes(options, lambda part, what: advance(0.75 + 0.25 * part, what)),
        ],
    )
