"""Cost of a link with frames: stability of walls, and error of the actuator's force for each material.

Everything is simulated (device.sim.link), with the same results on every machine. A position is one frame old when it
is read. A force acts from the first frame after its command until the next frame.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np

from bench.report import Advance, Floats, Options, Section, Table
from hapticd.base.core import EventKind, ffi, lib, pointer
from hapticd.config.configuration import Sim, load_config
from hapticd.config.materials import Material, shipped_materials
from hapticd.config.modes import Mode
from hapticd.rendering.displayability import DISPLAYABLE_RATE_FRACTION
from hapticd.rendering.joystick import new_sim
from hapticd.rendering.offline import Run, simulate_run

RATE_HZ = 10_000.0
LINKS_HZ: tuple[float | None, ...] = (None, 1000.0, 500.0, 250.0, 125.0)
WORST_MOTION_M = 100e-6
"""A handle is at rest if its motion a second after that of the hand is at most five encoder steps, peak to peak."""
TOP_N_PER_M = 1e5
"""Largest stiffness that a configuration may have."""
SPEEDS_M_PER_S = (0.05, 0.1, 0.2)
"""Speeds at which the hand approaches a wall."""
TAP_M_PER_S = 0.05
STROKE_M_PER_S = 0.1
PHASES = 8
"""Number of positions of the onset within a frame; the worst result is reported."""
MASS_KG = 0.05
SHOWN_MATERIALS = (
    *("wood", "acrylic", "delrin", "aluminum", "glass", "cast_iron", "steel", "cellophane", "comb"),
    *("comb_2400um_vibration", "comb_2400um_geometry", "comb_2400um_damping", "sticky"),
    *("sandpaper_60", "sandpaper_100", "sandpaper_400", "sandpaper_600"),
)
SILENT = "silent"
BEGIN, END = "<!-- Written by `python -m bench link`. -->\n", "<!-- To here. -->\n"


def _link(link_hz: float | None) -> dict[str, float] | None:
    return None if link_hz is None else {"rate_hz": link_hz}


def _name(link_hz: float | None) -> str:
    return "none" if link_hz is None else f"{link_hz:.0f} Hz"


# ---- Stability ---------------------------------------------------------------------------------------------------


def unrest_m(stiffness: float, link_hz: float | None) -> float:
    """Return the motion of the handle in m, peak to peak, a second after the hand has pressed it onto a wall.

    The default hand presses the default joystick to 3 mm inside; the result is the worst over SPEEDS_M_PER_S.
    """
    config = {
        "device": {"sim": {"link": _link(link_hz)}},
        "materials": {"m": {"stiffness_n_per_m": stiffness}},
        "scene": {"objects": {"floor": {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "m"}}},
    }
    worst = 0.0
    for speed in SPEEDS_M_PER_S:
        pressed_s = 0.008 / speed
        run = simulate_run(config, [[0, 0, 0.005], [pressed_s, 0, -0.003]], pressed_s + 1.2, RATE_HZ)
        assert run.truth is not None
        worst = max(worst, float(np.ptp(run.truth[-2000:, 1])))
    return worst


def stiffest(link_hz: float | None) -> float:
    """Return the largest stiffness without a limit cycle in N/m, by bisection to 1 %, at most TOP_N_PER_M."""
    low, high = 10.0, TOP_N_PER_M
    if unrest_m(high, link_hz) <= WORST_MOTION_M:
        return high
    while high / low > 1.01:
        middle = math.sqrt(low * high)
        low, high = (low, middle) if unrest_m(middle, link_hz) > WORST_MOTION_M else (middle, high)
    return low


def _rounded(value: float) -> str:
    return f"{float(f'{value:.3g}'):.0f}"


def _displayed(materials: Table, advance: Advance) -> Table:
    """Return what each link displays; `materials` names what is silent behind it."""
    sim = Sim()
    damping = sim.handle_damping_n_s_per_m + sim.hand.damping_n_s_per_m
    library = max(material.stiffness_n_per_m for material in shipped_materials().values())
    rows = []
    for index, link_hz in enumerate(LINKS_HZ):
        found = stiffest(link_hz)
        # A force acts two frames after its position was measured, and is held for one frame: half a frame on average.
        age_s = 0.5 / RATE_HZ if link_hz is None else 2.5 / link_hz
        highest_hz = DISPLAYABLE_RATE_FRACTION * (RATE_HZ if link_hz is None else link_hz)
        stable = "yes" if found > library else "**no**"
        measured = f"{_rounded(found)}{' or more' if found == TOP_N_PER_M else ''}"
        silent = ", ".join(row[0] for row in materials.rows if row[2 + index] == SILENT) or "none"
        rows.append(
            [
                _name(link_hz),
                f"{1e3 * age_s:g}",
                measured,
                _rounded(damping / age_s),
                stable,
                f"{highest_hz:.0f}",
                silent,
            ]
        )
        advance(0.7 + 0.3 * (index + 1) / len(LINKS_HZ), f"walls, link {_name(link_hz)}")
    return Table(
        "What a link displays: walls in N/m, modes in Hz",
        [
            *("link", "mean age of a force, ms", "stiffest wall without a limit cycle", "damping over age"),
            *(f"library's {library:.0f} N/m is stable", "highest mode", "silent materials"),
        ],
        rows,
    )


# ---- Materials ---------------------------------------------------------------------------------------------------


def _held(link_hz: float | None) -> dict[str, Any]:
    """Return an ideal joystick with a hand that no force deflects: the motion is the same with every link."""
    return {
        "handle_mass_kg": MASS_KG,
        "handle_damping_n_s_per_m": 0,
        "coulomb_friction_n": 0,
        "encoder_step_m": 0,
        "max_force_n": 100,
        "force_step_n": 0,
        "hand": {"mass_kg": 10, "stiffness_n_per_m": 1e5, "damping_n_s_per_m": 1000},
        "link": _link(link_hz),
    }


def _run(material: str, kind: str, link_hz: float | None, waypoints: list[list[float]], force: bool) -> Run:
    shape = {"kind": kind, "normal": [0, 1], "material": material}
    shape |= {"point_m": [0, 0]} if kind == "wall" else {"center_m": [0, 0], "width_m": 0.1}
    config = {
        "device": {"effective_mass_kg": MASS_KG, "max_force_n": 100, "sim": _held(link_hz)},
        "scene": {"objects": {"it": shape}, "display": {"force": force, "vibration": True}},
    }
    return simulate_run(config, waypoints, None, RATE_HZ)


def delivered(commands: Floats, link_hz: float | None) -> Floats:
    """Return the force of the actuator in each of n ticks, (n, 2), for `commands` (n, 2) over the simulated link."""
    config = load_config({"device": {"sim": _held(link_hz)}})
    sim = new_sim(config.device.sim, RATE_HZ)
    position, velocity, force = (ffi.new("double[2]") for _ in range(3))
    found = np.empty_like(commands)
    for index in range(len(commands)):
        lib.hd_sim_put(sim, pointer("double[]", commands[index]))
        lib.hd_sim_truth(sim, position, velocity, force)
        found[index] = (force[0], force[1])
        lib.hd_sim_advance(sim, 1)
    return found


def _best(error_of_delay: dict[float, float]) -> tuple[float, float]:
    """Return the delay with the smallest error, and this error."""
    delay = min(error_of_delay, key=lambda each: error_of_delay[each])
    return delay, error_of_delay[delay]


def struck_error(name: str, material: Material, link_hz: float | None) -> tuple[float, float] | None:
    """Return mean delay in s and worst error of a tap or rupture; None if it is silent.

    The error is relative to the RMS of the closed form, which is delayed by the best delay.
    """
    ruptures = material.rupture is not None
    mode: Mode
    if material.rupture is not None:
        mode, depth = material.rupture.mode, material.rupture.rupture_depth_m
    else:
        assert material.tap is not None
        mode, depth = material.tap.mode, 0.0
    frame_s = 1.0 / (RATE_HZ if link_hz is None else link_hz)
    delays, errors = [], []
    for phase in range(PHASES):
        start = 0.01 + TAP_M_PER_S * frame_s * phase / PHASES
        end_s = (start + depth) / TAP_M_PER_S + max(0.05, 6 / mode.decay_rate_per_s)
        path = [[0, 0, start], [end_s, 0, start - TAP_M_PER_S * end_s]]
        run = _run(name, "membrane" if ruptures else "wall", link_hz, path, force=False)
        assert run.truth is not None
        if not run.samples["vibration_force_n"].any():
            return None
        kind = EventKind.PUNCTURE if ruptures else EventKind.CONTACT
        assert (run.events["kind"] == kind).sum() == 1
        shown = delivered(run.samples["force_n"].copy(), link_hz)[:, 1]
        y = run.truth[:, 1]
        after = int(np.argmax(y <= -depth))
        part = (y[after - 1] + depth) / (y[after - 1] - y[after])
        onset_s = (after - 1 + part) / RATE_HZ
        if material.rupture is not None:
            acceleration = material.rupture.amplitude_m_per_s2
        else:
            assert material.tap is not None
            speed = -float(run.truth[after, 3])
            acceleration = mode.coefficient(material.tap.amplitude_m_per_s2(speed), material.tap.attack)
        middle_s = (np.arange(len(shown)) + 0.5) / RATE_HZ - onset_s

        def wave(delay_s: float, middle_s: Floats = middle_s, acceleration: float = acceleration) -> Floats:
            since = np.maximum(middle_s - delay_s, 0)
            ringing = np.exp(-mode.decay_rate_per_s * since) * np.sin(mode.angular_frequency_rad_per_s * since)
            found: Floats = MASS_KG * acceleration * ringing
            return found

        power = float((wave(0.0) ** 2).sum())
        sign = np.sign(shown[np.argmax(shown != 0)])
        tried = np.arange(-0.5, 4.5, 0.02) * frame_s
        left = {float(each): math.sqrt(((shown - sign * wave(each)) ** 2).sum() / power) for each in tried}
        delay, error = _best(left)
        delays.append(delay)
        errors.append(error)
    return float(np.mean(delays)), max(errors)


def stroked_error(name: str, link_hz: float) -> tuple[float, float] | None:
    """Return mean delay in s and worst error of the force's changes in a stroke; None if the texture is silent.

    The reference is the same stroke without a link.
    """
    ticks = round(RATE_HZ / link_hz)
    delays, errors = [], []
    for phase in range(0, PHASES, 2):
        start = -0.03 + STROKE_M_PER_S / link_hz * phase / PHASES
        path = [[0, start, 0.002], [0.1, start, -0.00125], [0.7, start + 0.6 * STROKE_M_PER_S, -0.00125]]
        forces = []
        for each in (None, link_hz):
            run = _run(name, "wall", each, path, force=True)
            if each is not None and run.undisplayable:
                return None
            forces.append(delivered(run.samples["force_n"].copy(), each))
        window = slice(3000, 6500)
        shown = forces[1][window] - forces[1][window].mean(0)
        left = {}
        for shift in range(-ticks, 5 * ticks):
            wanted = forces[0][window.start - shift : window.stop - shift]
            wanted = wanted - wanted.mean(0)
            left[shift / RATE_HZ] = math.sqrt(((shown - wanted) ** 2).sum() / (wanted**2).sum())
        delay, error = _best(left)
        delays.append(delay)
        errors.append(error)
    return float(np.mean(delays)), max(errors)


def _cell(found: tuple[float, float] | None) -> str:
    return SILENT if found is None else f"{100 * found[1]:.2g} %, {1e3 * found[0]:.2g} ms"


def _materials(advance: Advance) -> Table:
    rows = []
    for index, name in enumerate(SHOWN_MATERIALS):
        material = shipped_materials()[name]
        struck = material.tap is not None or material.rupture is not None
        cells = []
        for link_hz in LINKS_HZ:
            if struck:
                cells.append(_cell(struck_error(name, material, link_hz)))
            else:
                cells.append("reference" if link_hz is None else _cell(stroked_error(name, link_hz)))
        rows.append([name, _frequency(material), *cells])
        advance(0.7 * (index + 1) / len(SHOWN_MATERIALS), name)
    return Table(
        "Error of the actuator's force, and its delay",
        ["material", "Hz", *(f"link {_name(link_hz)}" for link_hz in LINKS_HZ)],
        rows,
    )


def _frequency(material: Material) -> str:
    mode = material.groove_mode
    if material.tap is not None:
        mode = material.tap.mode
    if material.rupture is not None:
        mode = material.rupture.mode
    if mode is not None:
        return f"{mode.frequency_hz:.0f}"
    peak = getattr(material.texture, "peak_hz", None)
    return "" if peak is None else f"{peak:.0f}"


# ---- The section -------------------------------------------------------------------------------------------------


def run(options: Options, advance: Advance) -> Section:
    """Return the section with stability and materials; a quick run computes the same."""
    sim = Sim()
    materials = _materials(advance)
    return Section(
        "Links",
        [
            "The simulated joystick is behind `device.sim.link`: a position is one frame old when the servo reads it, "
            "and a force acts from the first frame after its command until the next one. The figures are computed, not "
            "timed.",
            f"Walls: the hand ({sim.hand.mass_kg:g} kg, {sim.hand.stiffness_n_per_m:g} N/m, "
            f"{sim.hand.damping_n_s_per_m:g} N s/m) presses the default joystick ({sim.handle_mass_kg:g} kg, encoder "
            f"{1e6 * sim.encoder_step_m:g} um) onto a wall and holds it; a second later the handle must move by less "
            f"than {1e6 * WORST_MOTION_M:g} um. A late force acts as negative damping: stiffness times the force's "
            "age. If that exceeds the damping of hand and handle, to which dry friction adds, the wall buzzes. "
            "Another hand may make another wall buzz: `hapticd check` reports what is safe in any hand.",
            _displayed(materials, advance),
            f"Materials: a hand that no force deflects taps, punctures ({TAP_M_PER_S:g} m/s) and strokes "
            f"({STROKE_M_PER_S:g} m/s, 1 N). The table shows the error of the actuator's force, and its delay. The "
            "reference is the closed form of the library (taps and puncture), or the changes of force in the same "
            "stroke without a link. The error is the RMS of the difference over the RMS of the reference, after the "
            "delay is removed; the worst of several onsets within a frame. Much of it is the staircase of held forces, "
            "which the mass of a handle smooths. Above 0.4 of the link's rate a mode is silent "
            "(`undisplayable: mute`).",
            materials,
        ],
    )


def write_into(page: Path, section: Section) -> None:
    """Write the text of a section between BEGIN and END in a page. Raises ValueError for a page without these marks."""
    text = page.read_text(encoding="utf-8")
    found, count = re.subn(
        f"{re.escape(BEGIN)}.*?{re.escape(END)}", lambda _: f"{BEGIN}\n{section.body()}\n\n{END}", text, flags=re.DOTALL
    )
    if count != 1:
        raise ValueError(f"{page} lacks the marks around the tables of the link")
    page.write_text(found, encoding="utf-8")
