"""Energy that random walls and corners, most of them unstable, give to the hand with and without passivity control.

Each case is the closed loop of tick and simulated joystick. The energy of a contact is the sum of f.(x' - x) over its
ticks, with the commanded force f and the true position x of the handle. The result is the largest value that this sum
reaches, relative to F_max v_max T.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal, NamedTuple, TypeAlias

import numpy as np

from bench.report import Advance, Options, Section, Table, between, spread
from bench.swept import swept, workers
from bench.tick import MATERIALS, RATE_HZ, STRETCH, Stretch, measured, walls
from hapticd.base.core import EVENT_DTYPE, SAMPLE_DTYPE, CData, Flag, Status, ffi, invalid_reason, lib, pointer, records
from hapticd.base.yaml_source import Json
from hapticd.config.configuration import load_config
from hapticd.rendering.compiler.table import Compiler
from hapticd.rendering.device_output import output_of
from hapticd.rendering.joystick import new_operator, new_sim
from hapticd.rendering.offline import new_world
from hapticd.sweeps.measures.energy import given_j

if TYPE_CHECKING:
    from hapticd.sweeps.measures.sweep_point import SweepPoint

MAX_FORCE_N: Final = 8.9
MAX_SPEED_M_PER_S: Final = 5.0
DURATION_S: Final = 0.6
"""Duration of a case."""
HANDLE_DAMPING: Final = 0.2
"""Damping of the handle in N s/m."""

Group: TypeAlias = Literal["exact", "encoder", "delay"]
Mode: TypeAlias = Literal["off", "observe", "control"]
GROUPS: Final[Mapping[Group, str]] = {
    "exact": "exact positions",
    "encoder": "steps of 1 to 100 um",
    "delay": "0.2 to 3 periods old, half of them in steps",
}


@dataclass(frozen=True, slots=True)
class Case:
    """One wall or a corner of two walls, and the hand that presses. SI units."""

    rate_hz: float
    stiffness: float
    damping: float
    friction: float
    corner_rad: float
    """The angle between two walls; pi stands for a single wall."""
    encoder_step_m: float
    delay_s: float
    coulomb_n: float
    light: bool
    """Whether a weak spring pulls a light handle, instead of the default hand."""
    depth_m: float
    slide_m: float

    @property
    def bound_j(self) -> float:
        """The bound F_max v_max T of the energy."""
        return MAX_FORCE_N * MAX_SPEED_M_PER_S / self.rate_hz

    @property
    def age(self) -> int:
        """Age of a position when the servo reads it, rounded up to periods."""
        return int(np.ceil(self.delay_s * self.rate_hz))

    def config(self, passivity: Mode) -> dict[str, object]:
        """Return the configuration of the case."""
        material: dict[str, object] = {"stiffness_n_per_m": self.stiffness, "damping_n_s_per_m": self.damping}
        if self.friction:
            material["friction"] = {"coefficient": self.friction}
        half = 0.5 * self.corner_rad
        # Two walls with the angle corner_rad between them, open upwards.
        normals = {"left": [np.cos(half), np.sin(half)], "right": [-np.cos(half), np.sin(half)]}
        objects = {
            name: {"kind": "wall", "point_m": [0, 0], "normal": normal, "material": "it"}
            for name, normal in normals.items()
            if name == "left" or self.corner_rad < np.pi
        }
        hand = {"mass_kg": 0.0, "stiffness_n_per_m": 30, "damping_n_s_per_m": 0.0} if self.light else {}
        return {
            "device": {
                "max_force_n": MAX_FORCE_N,
                "max_speed_m_per_s": MAX_SPEED_M_PER_S,
                "sim": {
                    "handle_mass_kg": 0.02 if self.light else 0.04,
                    "handle_damping_n_s_per_m": HANDLE_DAMPING,
                    "coulomb_friction_n": self.coulomb_n,
                    "encoder_step_m": self.encoder_step_m,
                    "report_delay_s": self.delay_s,
                    "max_force_n": 20,
                    "force_step_n": 0,
                    "hand": hand,
                },
            },
            "materials": {"it": material},
            "scene": {"objects": objects, "passivity": passivity},
        }

    def waypoints(self) -> list[list[float]]:
        """Return the hand's waypoints: in, along the surface, partly out, in again and out."""
        deep, along = -self.depth_m, self.slide_m
        reach = 10.0 if self.light else 1.0
        return [
            [0.0, 0.0, 0.004],
            [0.1, 0.0, reach * deep],
            [0.25, along, reach * deep],
            [0.35, along, 0.3 * reach * deep],
            [0.45, 0.0, reach * deep],
            [DURATION_S, 0.0, 0.004],
        ]


def draw(seed: int, group: Group) -> Case:
    """Return a random case; `group` selects exact positions, encoder steps or delayed positions."""
    random = np.random.default_rng([seed, list(GROUPS).index(group)])
    rate_hz = 1000.0 * 10.0 ** random.uniform(0, 1)
    limit = 2.0 * HANDLE_DAMPING * rate_hz
    stiffness = min(1e5, limit * 10.0 ** random.uniform(-0.3, 2))
    encoder = group == "encoder" or (group == "delay" and random.random() < 0.5)
    return Case(
        rate_hz=rate_hz,
        stiffness=stiffness,
        damping=float(random.choice([0.0, 0.0, 10.0 ** random.uniform(-1, 2.5)])),
        friction=float(random.choice([0.0, 0.0, random.uniform(0.1, 0.9)])),
        corner_rad=float(random.choice([np.pi, np.deg2rad(random.uniform(10, 170))])),
        encoder_step_m=1e-6 * 10.0 ** random.uniform(0, 2) if encoder else 0.0,
        delay_s=random.uniform(0.2, 3.0) / rate_hz if group == "delay" else 0.0,
        coulomb_n=float(random.choice([0.0, 0.05])),
        light=bool(random.integers(2)),
        depth_m=random.uniform(0.001, 0.01),
        slide_m=float(random.choice([0.0, random.uniform(-0.02, 0.02)])),
    )


class Energy(NamedTuple):
    """The energy that touched objects gave to the hand, as summed by the passivity observer."""

    energy_j: float
    """Energy of the current or last contact; negative if the hand gave more than it received."""
    largest_j: float
    """Largest energy of any contact so far."""
    contacts: int
    """Number of contacts, each from the first touch of an object to the last release."""
    restrained: int
    """Number of contacts in which the controller acted."""
    acted: int
    """Number of ticks in which the controller acted."""


@dataclass(frozen=True, slots=True)
class Given:
    """The energy that a run gave to the hand."""

    true_j: float
    """Largest energy of a contact, from the true positions of the handle."""
    energy: Energy
    """The energy according to the passivity observer."""
    speed_m_per_s: float
    """Largest speed of the handle."""
    ticks: int


def energy_of(state: CData) -> Energy:
    """Return the energy in a `struct hd_state`."""
    raw = ffi.new("struct hd_energy *")
    lib.hd_state_energy(state, raw)
    return Energy(raw.energy_j, raw.largest_j, raw.contacts, raw.restrained, raw.acted)


def simulated(case: Case, passivity: Mode) -> Given:
    """Simulate the closed loop of a case."""
    config = load_config(case.config(passivity))
    compiler = Compiler(output_of(config, case.rate_hz))
    world = new_world(compiler.update(config.scene, config.scene.objects, config.materials, 1))
    sim = new_sim(config.device.sim, case.rate_hz)
    hand = new_operator(case.waypoints(), "linear")
    lib.hd_sim_operate(sim, hand)
    lib.hd_sim_settle(sim)
    state = ffi.gc(lib.hd_state_new(2), lib.hd_state_free)
    lib.hd_state_set_resolution(state, case.encoder_step_m)
    count = round(DURATION_S * case.rate_hz)
    samples, truth = records(SAMPLE_DTYPE, count), np.empty((count, 4))
    events, found = records(EVENT_DTYPE, 4 * count), ffi.new("size_t *")
    status = lib.hd_simulate(
        world,
        state,
        sim,
        count,
        pointer("struct hd_sample[]", samples),
        pointer("double[]", truth),
        pointer("struct hd_event[]", events),
        len(events),
        found,
    )
    if status != Status.OK:
        raise RuntimeError(invalid_reason())
    force = samples["force_n"]  # without vibration: the material has no tap
    touched = (samples["flags"] & Flag.CONTACT) != 0
    return Given(
        given_j(force, truth[:, :2], touched, case.age), energy_of(state), float(np.hypot(*truth[:, 2:].T).max()), count
    )


def given(point: SweepPoint) -> dict[str, float]:
    """Return energy and bounds at a point of studies/passivity.yaml."""
    case = draw(point.parameters["case"], point.parameters["positions"])
    run = simulated(case, point.parameters["passivity"])
    return {
        "given_j": run.true_j,
        "bound_j": case.bound_j,
        "older_j": case.bound_j * (1 + case.age),
        "speed_m_per_s": run.speed_m_per_s,
        "contacts": run.energy.contacts,
        "restrained": run.energy.restrained,
    }


def _counts(options: Options, advance: Advance) -> list[str | Table]:
    many = options.few(1000, 40)
    drawn: dict[str, Json] = {"parameters.case": {"low": 0, "high": many - 1, "count": many}}
    with workers() as client:
        found = swept(client, "passivity", lambda part: advance(part, "cases"), drawn)
    rows, contacts = [], sum(row["contacts"] for row in found)
    modes: tuple[Mode, Mode] = ("observe", "control")
    for group, name in GROUPS.items():
        for mode in modes:
            runs = [row for row in found if (row["parameters.positions"], row["parameters.passivity"]) == (group, mode)]
            energy, bounds, older = (np.array([row[key] for row in runs]) for key in ("given_j", "bound_j", "older_j"))
            rows.append(
                [
                    f"{name}, {'off' if mode == 'observe' else 'control'}",
                    f"{len(runs)}",
                    f"{np.sum(energy > bounds)}",
                    f"{(energy / bounds).max():.3g}",
                    f"{np.sum(energy > older)}",
                    f"{(energy / older).max():.3g}",
                    spread(energy / bounds, ".2g"),
                    spread([row["speed_m_per_s"] for row in runs], ".2g"),
                    f"{sum(row['restrained'] > 0 for row in runs)}",
                ]
            )
    text = (
        f"{len(GROUPS) * many} seeded cases (`bench/passivity.py`, `draw`), each of {DURATION_S:g} s with the "
        f"controller off and on, {contacts} contacts: one wall or a corner of 10 to 170 degrees, 1 to 10 kHz, "
        "stiffness of 0.5 to 100 times the passive stiffness, a third with wall damping of 0.1 to 300 N s/m, a third "
        "with friction, the default hand or a released handle of 20 g. "
        f"F_max is {MAX_FORCE_N:g} N, v_max {MAX_SPEED_M_PER_S:g} m/s, T one period, a the age of a position rounded "
        "up to periods. Energies are computed from the true motion of the handle."
    )
    return [
        text,
        Table(
            "Largest energy that a contact of each case gives to the hand, relative to F v T (F_max v_max T)",
            [
                "positions, controller",
                "cases",
                "cases above F v T",
                "worst / F v T",
                "cases above F v (T + a)",
                "worst / F v (T + a)",
                "energy / F v T (10 to 90 %)",
                "largest speed, m/s (10 to 90 %)",
                "cases in which the controller acted",
            ],
            rows,
        ),
    ]


def _stretch(mode: str, pressed: bool) -> Stretch:
    objects = walls(1, "plain")
    config = load_config({"materials": MATERIALS, "scene": {"objects": objects, "passivity": mode}})
    compiler = Compiler(output_of(config, RATE_HZ))
    world = new_world(compiler.update(config.scene, config.scene.objects, config.materials, 1))
    return Stretch(objects, -0.001 if pressed else 0.01, world=world)


def _cost(options: Options, advance: Advance) -> Table:
    rounds, calls = options.few(40, 6), options.few(200, 50)
    rows = []
    for place, (name, pressed) in enumerate({"wall out of reach": False, "wall in contact": True}.items()):
        scenes = {mode: _stretch(mode, pressed) for mode in ("off", "observe", "control")}
        wanted = dict.fromkeys(scenes, Flag.CONTACT if pressed else Flag(0))
        progress = between(advance, place / 2, (place + 1) / 2, "cost")
        taken = measured(scenes, wanted, Flag.CONTACT, rounds, calls * STRETCH, progress)
        more = [np.subtract(taken[mode], taken["off"]) for mode in ("observe", "control")]
        rows.append(
            [name, *(spread(values, ".1f") for values in taken.values()), *(spread(each, ".1f") for each in more)]
        )
    return Table(
        f"ns a tick, {rounds} interleaved rounds, each the median of {calls} calls of {STRETCH} ticks (10 to 90 %)",
        ["scene", "off", "observe", "control", "observe - off", "control - off"],
        rows,
    )


def run(options: Options, advance: Advance) -> Section:
    """Return the section with the energies of random cases and the cost of a tick."""
    counts = _counts(options, lambda part, what: advance(0.7 * part, what))
    cost = _cost(options, lambda part, what: advance(0.7 + 0.3 * part, what))
    return Section("Passivity observer and controller", [*counts, cost])
