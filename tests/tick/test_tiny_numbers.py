"""Coordinates, steps and changes so small that their squares are subnormal or zero: every number stays finite."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from hapticd.base.core import EVENT_DTYPE, SAMPLE_DTYPE, EventKind, Flag, Status, ffi, lib, pointer, records
from tests.support.rig import FLOOR, Rig

Points = npt.NDArray[np.float64]

TINY = np.array([0.0, 5e-324, 1e-320, 1e-310, 3e-308, 1e-250, 1e-200, 1.6e-162, 3e-162, 1e-160, 1e-155, 1e-100, 1e-30])
"""Zero, subnormal numbers, numbers whose squares are zero or subnormal, and small ordinary ones."""
R = 0.004
GROOVES = {"kind": "grooves", "spacing_m": R, "width_m": R / 2}
MODE = {"frequency_hz": 100, "decay_time_s": 0.003}
TAP = {"attack_slope_per_s": 309, **MODE}
MATERIALS: dict[str, object] = {
    "rough": {"stiffness_n_per_m": 800, "friction": {"coefficient": 0.5}, "tap": TAP},
    "shaped": {"stiffness_n_per_m": 800, "texture": {**GROOVES, "display": "geometry", "depth_m": 1e-4}},
    "comb": {
        "stiffness_n_per_m": 800,
        "friction": {"coefficient": 0.5},
        "texture": {**GROOVES, "display": "vibration", "velocity_gain_per_s": 1000, **MODE},
    },
    "drag": {
        "stiffness_n_per_m": 800,
        "damping_n_s_per_m": 1,
        "texture": {**GROOVES, "display": "damping", "damping_n_s_per_m": 3},
    },
    "noise": {
        "stiffness_n_per_m": 800,
        "texture": {
            "kind": "stochastic",
            "peak_hz": 100,
            "mean_hz": 150,
            "velocity_gain_per_s": 20,
            "force_gain_m_per_s2_per_n": 2,
        },
    },
    "skin": {
        "stiffness_n_per_m": 300,
        "tap": TAP,
        "rupture": {"depth_m": 0.003, "amplitude_m_per_s2": 30, **MODE, "heals": True},
    },
}
NAMES = list(MATERIALS)


def tiny(rng: np.random.Generator) -> float:
    return 0.0 if rng.random() < 0.4 else float(rng.choice(TINY) * rng.choice([-1.0, 1.0]))


def place(rng: np.random.Generator, ordinary: float = 0.4) -> list[float]:
    """A point whose coordinates are tiny, or those of a centre, a face or a rim, or both of them added."""
    at = []
    for _ in range(2):
        offset = float(rng.choice([-R, R, 0.5 * R, 2 * R])) if rng.random() < ordinary else 0.0
        at.append(offset + tiny(rng))
    return at


def surface(rng: np.random.Generator) -> dict[str, object]:
    """A surface with its centre, a face or its rim within a tiny distance of the origin."""
    kind = ("wall", "box", "disc", "membrane")[int(rng.integers(4))]
    item: dict[str, object] = {"kind": kind, "material": NAMES[int(rng.integers(len(NAMES)))]}
    normal = [[0, 1], [1, 0], [0, -1], [-1, 0], [0.6, 0.8], [1, tiny(rng)]][int(rng.integers(6))]
    match kind:
        case "wall":
            return {**item, "point_m": place(rng), "normal": normal}
        case "box":
            return {
                **item,
                "center_m": place(rng),
                "size_m": [2 * R, 2 * R],
                "angle_rad": float(rng.choice([0, 1, tiny(rng)])),
            }
        case "disc":
            return {**item, "center_m": place(rng), "radius_m": R}
        case _:
            return {**item, "center_m": place(rng), "normal": normal, "width_m": 4 * R}


def path_of(rng: np.random.Generator, count: int) -> Points:
    """Rests at a point, with tiny motions, and jumps or strokes to the next one."""
    legs: list[Points] = []
    while sum(map(len, legs)) < count:
        to = np.array(place(rng, 0.2))
        if legs and rng.random() < 0.5:
            steps = int(rng.integers(2, 30))
            here = legs[-1][-1]
            legs.append(here + (to - here) * np.linspace(0, 1, steps)[:, None])
        legs.append(np.array([[x + tiny(rng), y + tiny(rng)] for x, y in [to] * int(rng.integers(1, 6))]))
        legs.append(to[None, :])
    return np.concatenate(legs)[:count]


def check(rig: Rig, samples: npt.NDArray[np.void]) -> None:
    for key in ("position_m", "velocity_m_per_s", "contact_force_n", "vibration_force_n", "force_n"):
        assert np.isfinite(samples[key]).all(), key
    assert not (samples["flags"] & Flag.FAULT).any()
    for key in ("before_tick_s", "speed_m_per_s", "amplitude_m_per_s2", "scale", "value"):
        assert np.isfinite(rig.events[key]).all(), key


@pytest.mark.parametrize("seed", range(40))
def test_every_number_is_finite(seed: int) -> None:
    """All shapes and textures at and around tiny coordinates, while surfaces move and change by tiny amounts."""
    rng = np.random.default_rng((35, seed))
    rig = Rig(
        {f"s{i}": surface(rng) for i in range(int(rng.integers(1, 4)))},
        rate_hz=float(rng.choice([1000, 10_000])),
        materials=MATERIALS,
        device={"max_force_n": 8.0, "max_speed_m_per_s": 1000},
        passivity=("off", "observe", "control")[int(rng.integers(3))],
    )
    contacts = 0
    for _ in range(30):
        check(rig, rig.render(path_of(rng, 100)))
        contacts += len(rig.of(EventKind.CONTACT))
        id, item = str(rng.choice(list(rig.source["scene"]["objects"]))), surface(rng)
        if rng.random() < 0.5:  # a tiny move
            was = rig.source["scene"]["objects"][id]
            key = "point_m" if was["kind"] == "wall" else "center_m"
            item = {**was, key: [each + tiny(rng) for each in was[key]]}
        rig.update({id: item})
    assert contacts > 20


@pytest.mark.parametrize("offset", [(1e-310, 0.0), (5e-324, 0.0), (0.0, 1e-320), (1e-200, -1e-200), (1e-160, 1e-160)])
@pytest.mark.parametrize("material", ["rough", "comb"])
def test_around_the_centre_of_a_disc_the_force_is_that_at_the_centre(
    offset: tuple[float, float], material: str
) -> None:
    """The force is K R; its direction is that of the way in, or any if the disc appears."""
    item = {"kind": "disc", "center_m": [0, 0], "radius_m": R, "material": material}
    at = np.array(offset)
    for sign in (1, -1):
        rig = Rig({"peg": item}, materials=MATERIALS)
        samples = rig.render(np.tile(sign * at, (400, 1)))
        check(rig, samples)
        assert np.hypot(*samples["contact_force_n"][-1]) == pytest.approx(800 * R)
        rig = Rig({"peg": item}, materials=MATERIALS, rate_hz=1000)
        samples = rig.render([[0, 1.2 * R], [0, 0.5 * R], sign * at, -sign * at, sign * at])
        check(rig, samples)
        np.testing.assert_allclose(samples["contact_force_n"][2:], [[0, 800 * R]] * 3, rtol=1e-12, atol=1e-12)


def test_a_probe_that_goes_over_the_bottom_of_a_disc_by_a_tiny_step_strikes_finitely() -> None:
    """s goes from one end to the other, where a groove lies: 2 pi R is a multiple of the spacing."""
    spacing = 2 * np.pi * R / 8
    comb = {
        "stiffness_n_per_m": 800,
        "texture": {
            "kind": "grooves",
            "spacing_m": spacing,
            "width_m": spacing / 2,
            "display": "vibration",
            "velocity_gain_per_s": 1000,
            **MODE,
        },
    }
    item = {"kind": "disc", "center_m": [0, 0], "radius_m": R, "material": "comb"}
    for step in (-0.0, *-TINY):
        rig = Rig({"peg": item}, materials={"comb": comb})
        rig.render([[step, -1.1 * R], [step, -0.9 * R]])
        check(rig, rig.render([[step, -0.9 * R], [-step, -0.9 * R], [step, -0.9 * R]]))


def test_a_recorded_jump_within_a_tiny_interval_has_a_finite_speed() -> None:
    rig = Rig({"floor": FLOOR})
    recorded = rig.render([[0, 0.01], [0, -0.01]])
    assert [EventKind(int(kind)) for kind in rig.events["kind"]][:1] == [EventKind.GLITCH]
    state = ffi.gc(lib.hd_state_new(1), lib.hd_state_free)
    samples, events, count = records(SAMPLE_DTYPE, 2), records(EVENT_DTYPE, 16), ffi.new("size_t *")
    status = lib.hd_replay(
        rig.world,
        state,
        pointer("struct hd_sample[]", recorded),
        pointer("double[]", np.array([0.0, 5e-324])),
        pointer("uint32_t[]", np.array([1, 1], np.uint32)),
        2,
        pointer("struct hd_sample[]", samples),
        pointer("struct hd_event[]", events),
        len(events),
        count,
    )
    assert status == Status.OK
    (glitch,) = events[: count[0]][events["kind"][: count[0]] == EventKind.GLITCH]
    assert glitch["value"] == rig.config.device.max_speed_m_per_s
