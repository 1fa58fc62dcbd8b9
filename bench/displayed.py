"""Displayed error of the tap of every material in three grips, measured on the motion of the handle.

The displayed error (hapticd/rendering/displayed_error.py) is the RMS of the difference between the handle's
acceleration and the library's waveform over the RMS of the waveform, both limited to 30 Hz to 0.4 of the rate. Here the
force of a tap from `hapticd.render`, held from tick to tick, moves the linear device.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.report import Advance, Floats, Options, Section, Table, between, verdict
from bench.swept import swept, workers
from hapticd.analysis.calibration.verify import ONSET_LEAD_PERIODS, acceleration_on, tap_force
from hapticd.config.configuration import Compensation, Hand, Sim, load_config
from hapticd.config.dynamics import Dynamics
from hapticd.config.materials import shipped_materials
from hapticd.config.modes import Mode
from hapticd.rendering.compensation import pole_gain, pole_shape, shape_of
from hapticd.rendering.displayed_error import PARTS_PER_PERIOD, band_error, handle_acceleration, waveform

if TYPE_CHECKING:
    from hapticd.sweeps.measures.sweep_point import SweepPoint

RATE_HZ = 10_000.0
COMPARED: tuple[Compensation, ...] = ("off", "full")
HANDLE = (0.04, 0.2)
"""Mass in kg and damping in N s/m of the default simulated joystick."""
GRIPS = {"light": (0.005, 2.0, 100.0), "default": (0.01, 5.0, 300.0), "firm": (0.02, 10.0, 600.0)}
"""Mass in kg, damping in N s/m and stiffness in N/m: two fingers, the default hand, and twice the default."""
MATERIALS = ("wood", "acrylic", "delrin", "aluminum", "glass", "cast_iron", "steel", "comb", "cellophane")
MAX_ERROR, AIM = 0.13, 0.05
WALL_N_PER_M = 800.0
"""Stiffness of the shipped materials."""
PHASES = 8
"""Number of positions of the onset within a tick."""
DURATION_S = 0.25
"""Duration of the motion after a strike."""


def modes() -> dict[str, Mode]:
    """Return the mode of each material: its tap, groove or rupture."""
    found = {}
    for name in MATERIALS:
        material = shipped_materials()[name]
        mode = material.tap.mode if material.tap is not None else material.groove_mode
        if mode is None:
            assert material.rupture is not None
            mode = material.rupture.mode
        found[name] = mode
    return found


def held(grip: str) -> Dynamics:
    """Return the dynamics of the default handle in a grip."""
    mass, damping, stiffness = GRIPS[grip]
    return Dynamics(*HANDLE, 0.0, mass, damping, stiffness)


def tapped(
    mode: Mode,
    grip: str,
    compensation: Compensation,
    rate_hz: float,
    part: float,
    stiffness_n_per_m: float = 0.0,
    slope_per_s: float = 64.0,
) -> Floats:
    """Return the force of a tap with amplitude 1 m/s^2, whose onset is `part` of a period before the first sample.

    `slope_per_s` is the amplitude over the approach speed, with which a tap on a wall lifts the handle.
    """
    mass, damping, stiffness = GRIPS[grip]
    hand = {"mass_kg": mass, "damping_n_s_per_m": damping, "stiffness_n_per_m": stiffness}
    handle = {"mass_kg": HANDLE[0], "damping_n_s_per_m": HANDLE[1]}
    tap = {
        "attack_slope_per_s": slope_per_s,
        "angular_frequency_rad_per_s": mode.angular_frequency_rad_per_s,
        "decay_rate_per_s": mode.decay_rate_per_s,
    }
    config = {
        "servo": {"rate_hz": rate_hz},
        "device": {"handle": handle, "grip": hand, "compensation": compensation, "max_force_n": 100},
        "materials": {"it": {"stiffness_n_per_m": stiffness_n_per_m, "tap": tap}},
    }
    return tap_force(load_config(config), "it", 1 / slope_per_s, int(DURATION_S * rate_hz), onset_periods=part)[:, 1]


def moved_error(
    mode: Mode, grip: str, compensation: Compensation, rate_hz: float, part: float = ONSET_LEAD_PERIODS
) -> float:
    """Return the displayed error of the motion, from the onset, although the force begins only at the first tick."""
    force = tapped(mode, grip, compensation, rate_hz, part)
    late = round(part * PARTS_PER_PERIOD)
    moved = np.concatenate((np.zeros(late), handle_acceleration(force, held(grip), rate_hz, PARTS_PER_PERIOD)))
    wanted = waveform(mode, len(moved), PARTS_PER_PERIOD * rate_hz)
    return band_error(moved, wanted, PARTS_PER_PERIOD * rate_hz, 30.0, 0.4 * rate_hz)


def walled(force_n: Floats, grip: str, rate_hz: float) -> Floats:
    """Return the acceleration of the handle, as handle_acceleration, on a wall of WALL_N_PER_M."""
    mass, damping, stiffness = GRIPS[grip]
    sim = Sim(
        handle_mass_kg=HANDLE[0],
        handle_damping_n_s_per_m=HANDLE[1],
        coulomb_friction_n=0.0,
        force_step_n=0.0,
        max_force_n=100.0,
        hand=Hand(mass_kg=mass, damping_n_s_per_m=damping, stiffness_n_per_m=stiffness),
    )
    forces = np.column_stack((np.zeros(len(force_n)), force_n))
    return acceleration_on(sim, forces, rate_hz, WALL_N_PER_M)[:, 1]


def wall_error(mode: Mode, slope_per_s: float, grip: str, known: bool, part: float = ONSET_LEAD_PERIODS) -> float:
    """Return the displayed error with `full` on a wall; unless `known`, the forces are computed without the wall."""
    force = tapped(mode, grip, "full", RATE_HZ, part, WALL_N_PER_M if known else 0.0, slope_per_s)
    moved = np.concatenate((np.zeros(round(part * PARTS_PER_PERIOD)), walled(force, grip, RATE_HZ)))
    wanted = waveform(mode, len(moved), PARTS_PER_PERIOD * RATE_HZ)
    return band_error(moved, wanted, PARTS_PER_PERIOD * RATE_HZ, 30.0, 0.4 * RATE_HZ)


def on_wall(point: SweepPoint) -> dict[str, float]:
    """Return the displayed errors at a point of studies/displayed_walls.yaml."""
    name, grip = point.parameters["material"], point.parameters["grip"]
    tap = shipped_materials()[name].tap
    assert tap is not None
    struck = modes()[name], tap.largest_slope_per_s, grip
    anywhere = [wall_error(*struck, True, (place + 0.5) / PHASES) ** 2 for place in range(PHASES)]
    return {
        "left_out": wall_error(*struck, False),
        "full": wall_error(*struck, True),
        "anywhere": float(np.sqrt(np.mean(anywhere))),
    }


def _walls(client: Any, progress: Callable[[float], None]) -> Table:
    cells: dict[str, list[str]] = {}
    for row in swept(client, "displayed_walls", progress):
        errors = [_percent(row[key]) for key in ("left_out", "full", "anywhere")]
        cells.setdefault(row["parameters.material"], []).extend(errors)
    columns = [f"{grip}: {what}" for grip in GRIPS for what in ("wall left out", "full", "any onset")]
    caption = f"On a wall of {WALL_N_PER_M:g} N/m, {RATE_HZ:.0f} Hz: displayed error with `full`, %"
    return Table(caption, ["material", *columns], [[name, *each] for name, each in cells.items()])


def _percent(value: float) -> str:
    return f"{100 * value:.1f}"


def in_grip(point: SweepPoint) -> dict[str, float | None]:
    """Return the displayed errors at a point of studies/displayed_grips.yaml."""
    mode, grip = modes()[point.parameters["material"]], point.parameters["grip"]
    shape = shape_of(mode, held(grip), RATE_HZ, "full")
    phases = (np.arange(PHASES) + 0.5) / PHASES

    def anywhere(compensation: Compensation) -> float:
        errors = [moved_error(mode, grip, compensation, RATE_HZ, part) ** 2 for part in phases]
        return float(np.sqrt(np.mean(errors)))

    return {
        "off": moved_error(mode, grip, "off", RATE_HZ),
        "mass": moved_error(mode, grip, "mass", RATE_HZ),
        "alone": pole_shape(mode, held(grip), RATE_HZ, pole_gain(mode, held(grip), 1 / RATE_HZ)).error,
        "full": moved_error(mode, grip, "full", RATE_HZ),
        "tail_s": None if shape.tail is None else shape.tail.end_s,
        "largest": float(np.abs(tapped(mode, grip, "full", RATE_HZ, ONSET_LEAD_PERIODS)).max() / held(grip).mass_kg),
        "off_anywhere": anywhere("off"),
        "full_anywhere": anywhere("full"),
    }


def _errors(client: Any, progress: Callable[[float], None]) -> list[str | Table]:
    columns = [
        "material",
        "off",
        "mass",
        "C alone",
        "full",
        "tail",
        "largest force / (m A)",
        "any onset: off",
        "any onset: full",
    ]
    tables: list[str | Table] = []
    found = swept(client, "displayed_grips", progress)
    for grip, (mass, damping, stiffness) in GRIPS.items():
        rows = [
            [
                row["parameters.material"],
                *(_percent(row[key]) for key in ("off", "mass", "alone", "full")),
                "none" if row["tail_s"] is None else f"{1e3 * row['tail_s']:.1f} ms",
                f"{row['largest']:.2f}",
                *(_percent(row[key]) for key in ("off_anywhere", "full_anywhere")),
            ]
            for row in found
            if row["parameters.grip"] == grip
        ]
        caption = (
            f"{grip} grip ({mass:g} kg, {damping:g} N s/m, {stiffness:g} N/m), {RATE_HZ:.0f} Hz: displayed error, %"
        )
        tables.append(Table(caption, columns, rows))
    worst = [row["full"] for row in found]
    reached = sum(error <= AIM for error in worst)
    tables.append(
        f"Worst with `full`: {100 * max(worst):.1f} %; at most {100 * MAX_ERROR:g} %: "
        f"{verdict(max(worst), MAX_ERROR)}. {reached} of {len(worst)} reach the aim of {100 * AIM:g} %."
    )
    return tables


def at_rate(point: SweepPoint) -> dict[str, float | None]:
    """Return the displayed errors at a point of studies/displayed_rates.yaml; None for a mode above 0.4 of the rate."""
    mode, rate_hz = modes()[point.parameters["material"]], point.rate_hz
    if mode.frequency_hz > 0.4 * rate_hz:
        return {"off": None, "full": None}
    return {each: moved_error(mode, "default", each, rate_hz) for each in COMPARED}


def _rates(client: Any, progress: Callable[[float], None]) -> Table:
    cells: dict[str, dict[float, str]] = {}
    for row in swept(client, "displayed_rates", progress):
        errors = [row[each] for each in COMPARED]
        cell = "not displayable" if None in errors else " / ".join(map(_percent, errors))
        cells.setdefault(row["parameters.material"], {})[row["servo.rate_hz"]] = cell
    rates = next(iter(cells.values()))
    caption = "Displayed error by rate, default grip, %: `off` / `full`"
    rows = [[name, *each.values()] for name, each in cells.items()]
    return Table(caption, ["material", *(f"{rate:.0f} Hz" for rate in rates)], rows)


def run(options: Options, advance: Advance) -> Section:
    """Return the section with displayed errors in each grip, on walls and at each rate."""
    with workers() as client:
        errors = _errors(client, between(advance, 0.0, 0.5, "grips"))
        walls = _walls(client, between(advance, 0.5, 0.8, "walls"))
        rates = _rates(client, between(advance, 0.8, 0.9, "rates"))
    parts: list[str | Table] = [
        "A tap moves the default simulated handle (0.04 kg, 0.2 N s/m) in three grips, with each "
        "[compensation](devices.md#compensation-of-strikes). `C alone` is a part of `full`: the mode times one complex "
        "number C, the inverse of device and "
        "hold at the mode's pole. `full`: C and a tail of further forces after the onset, fitted together by least "
        "squares. The displayed error is that of the handle's acceleration relative to the mode. The onset is at a "
        "tick, as with `play`, except in the columns `any onset`: there a tap begins at any time between two ticks, "
        f"its force begins at the second of them, and the error includes what is missing until then (RMS over {PHASES} "
        "positions). `tail` is the time from the onset to the end of the tail. The largest force is relative to m A, "
        "with the mass m of handle and hand and the tap's amplitude A.",
        *errors,
        "These figures are without contact, as with `play`. On a wall, the wall acts on the handle while its tap "
        "rings. `wall left out`: forces that were computed without the wall act on the wall. `full`: forces that were "
        "computed for a tap on this wall. The slope of amplitude over speed is the library's, and the hand presses "
        "long enough for the complete compensation: `python -m bench.kept_taps` taps with hands that do not.",
        walls,
        "`hapticd verify` reports the same errors for the device and materials of a configuration, with the onset at a "
        "tick: rows `tap` without contact, rows `wall` on a wall of the material's stiffness. It also includes dry "
        "friction, force resolution, the force limit and the link of the joystick. Without these four it gives the "
        "figures above.",
        rates,
    ]
    return Section("Displayed acceleration", parts)
