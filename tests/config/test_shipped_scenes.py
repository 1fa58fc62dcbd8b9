"""Every shipped scene with the operator that its comment names does what the comment says.

Expected values follow from docs/materials.md; mass, hand and limits are the defaults: 0.05 kg, a hand
of 300 N/m, 10,000 ticks a second.
"""

from __future__ import annotations

import csv
import math
import re
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from hapticd import shipped
from hapticd.base.core import EventKind, Flag, lib
from hapticd.rendering.offline import Run, simulate_run

CONFIG = Path(shipped.__path__[0])
SCENES = sorted(CONFIG.glob("scenes/*.yaml"))
OPERATORS = sorted(CONFIG.glob("operators/*.yaml"))
RATE_HZ = 10_000
MASS_KG = 0.05

Floats = npt.NDArray[np.float64]


def operator_of(scene: Path) -> str:
    """Return the operator that the first comment of a scene names."""
    comment = re.match(r"(?:#.*\n)+", scene.read_text())
    assert comment is not None, scene
    named = re.search(r"\bOperator: (\w+\.yaml)\n\Z", comment[0])
    assert named is not None, scene
    return named[1]


@cache
def run_of(name: str) -> Run:
    scene = CONFIG / "scenes" / f"{name}.yaml"
    return simulate_run(str(scene), str(CONFIG / "operators" / operator_of(scene)))


def events_of(run: Run, *kinds: EventKind) -> list[tuple[str, str, Any]]:
    """Return kind, object and record of the events of these kinds, in order."""
    return [
        (EventKind(int(event["kind"])).name, run.objects[int(event["slot"]), int(event["generation"])], event)
        for event in run.events
        if EventKind(int(event["kind"])) in kinds
    ]


def touches(run: Run) -> list[tuple[str, str]]:
    kinds = EventKind.CONTACT, EventKind.RELEASE, EventKind.PUNCTURE
    return [(kind, name) for kind, name, _ in events_of(run, *kinds)]


def handle(run: Run) -> tuple[Floats, Floats]:
    """Return the exact positions and velocities of the handle, each of shape (n, 2)."""
    assert run.truth is not None
    return run.truth[:, :2], run.truth[:, 2:]


def at(run: Run, time_s: float) -> int:
    tick = round(time_s * RATE_HZ)
    assert tick < len(run.samples)
    return tick


def sliding(run: Run, left: float, right: float, way: int) -> npt.NDArray[np.bool_]:
    """Return, by tick, whether `left` < x < `right` and the handle moves in direction `way` at 0.05 m/s or more."""
    position, velocity = handle(run)
    inside: npt.NDArray[np.bool_] = (position[:, 0] > left) & (position[:, 0] < right) & (way * velocity[:, 0] > 0.05)
    assert inside.any()
    return inside


def beginnings(wanted: npt.NDArray[np.bool_]) -> int:
    """Return how often `wanted` changes from false to true."""
    return int(np.count_nonzero(wanted[1:] & ~wanted[:-1]))


def test_every_operator_is_for_a_scene() -> None:
    assert {operator_of(scene) for scene in SCENES} == {operator.name for operator in OPERATORS}


@pytest.mark.parametrize("name", [scene.stem for scene in SCENES])
def test_a_run_starts_in_the_open_and_stays_within_the_limits(name: str) -> None:
    run = run_of(name)
    assert not run.warnings
    assert not run.undisplayable
    flags = run.samples["flags"]
    assert not flags[0] & Flag.CONTACT
    assert not (flags & (Flag.SATURATED | Flag.GLITCH | Flag.FAULT)).any()
    assert np.abs(run.samples["force_n"][0]).max() < 0.01
    contacts = events_of(run, EventKind.CONTACT)
    assert not any(int(event["code"]) & lib.HD_CONTACT_SILENT for _, _, event in contacts)
    assert not flags[-1] & Flag.CONTACT


def test_the_combs() -> None:
    run = run_of("comb")
    position, _ = handle(run)
    force = run.samples["contact_force_n"][:, 0]
    strikes = events_of(run, EventKind.GROOVE)
    assert {name for _, name, _ in strikes} == {"floor"}
    passed = [k * 0.0048 for k in range(-8, -3)]  # from the beginning of the stroke to the end of the patch
    places = [position[int(event["tick"]), 0] for _, _, event in strikes]
    # A strike comes within a tick of 10 um and a step of the encoder, 20 um, of its groove.
    assert places == pytest.approx(passed + passed[::-1], abs=50e-6)
    loud = np.abs(run.samples["vibration_force_n"][:, 0]) > 0.1
    assert loud.any()
    assert position[loud, 0].max() < -0.015
    for way in (1, -1):
        shaped = force[sliding(run, -0.015, 0.015, way)]
        assert beginnings(shaped > 0.1) == beginnings(shaped < -0.1) == 7  # k = -3 to 3: pulls in, then holds
        dragged = way * force[sliding(run, 0.016, 0.0395, way)]
        assert beginnings(dragged < -0.1) == 5  # k = 4 to 8
        assert dragged.max() < 0.01


def test_the_sandpapers() -> None:
    run = run_of("sandpaper")
    force = run.samples["vibration_force_n"]
    pressed = 0.0037 / (1 / 300 + 1 / 800)
    found = []
    for left, velocity_gain, force_gain in ((-0.04, 30, 3), (-0.02, 24, 2.4), (0, 12, 1.2), (0.02, 8, 0.8)):
        there = sliding(run, left + 0.002, left + 0.018, 1) | sliding(run, left + 0.002, left + 0.018, -1)
        found.append(float(np.sqrt(np.mean(force[there, 0] ** 2))))
        # The RMS of 0.3 s of noise around 200 Hz is uncertain by about 8 %.
        assert found[-1] == pytest.approx(MASS_KG * (velocity_gain * 0.1 + force_gain * pressed), rel=0.2)
    assert found == sorted(found, reverse=True)
    assert not force[:, 1].any()


def test_the_slippery_and_the_sticky_floor() -> None:
    run = run_of("friction")
    force = run.samples["contact_force_n"]
    for way in (1, -1):
        for left, right, coefficient in ((-0.03, -0.01, 0.05), (0.01, 0.03, 0.8)):
            there = sliding(run, left, right, way)
            assert np.median(-way * force[there, 0] / force[there, 1]) == pytest.approx(coefficient, rel=0.01)


def test_around_the_solids() -> None:
    run = run_of("solids")
    position, _ = handle(run)
    force = run.samples["contact_force_n"]
    assert touches(run) == [
        ("CONTACT", "floor"),
        ("CONTACT", "box"),  # in the corner the handle also touches the floor
        ("RELEASE", "floor"),
        ("RELEASE", "box"),
        ("CONTACT", "box"),
        ("RELEASE", "box"),
        ("CONTACT", "peg"),
        ("RELEASE", "peg"),
        ("CONTACT", "card"),
        ("RELEASE", "card"),
    ]
    assert force[at(run, 1.1)] == pytest.approx([-0.65, 0.65], abs=0.05)  # 3 mm, 300 and 800 N/m in series
    assert force[at(run, 2.2)] == pytest.approx([0, 0.65], abs=0.05)
    assert not force[at(run, 2.45)].any()  # past the edge of the box
    out = position - [0.01, 0]
    distance = np.linalg.norm(out, axis=1)
    on_the_disc = distance < 0.008
    pushed = (800 * (0.008 / distance - 1))[:, np.newaxis] * out  # away from the middle of the disc
    assert force[on_the_disc] == pytest.approx(pushed[on_the_disc], abs=0.05)
    assert force[at(run, 3), 0] < -0.1 < 0.1 < force[at(run, 3.6), 0]  # from left to right over the disc
    assert force[at(run, 4.7), 0] < -0.5
    assert position[:, 0].max() < 0.042  # the card holds


def test_through_the_skin_and_onto_the_floor() -> None:
    run = run_of("membrane")
    assert touches(run) == [
        ("CONTACT", "skin"),
        ("PUNCTURE", "skin"),
        ("RELEASE", "skin"),
        ("CONTACT", "floor"),
        ("RELEASE", "floor"),
    ]
    ((_, _, puncture),) = events_of(run, EventKind.PUNCTURE)
    assert puncture["value"] == pytest.approx(0.004, abs=50e-6)
    tick = int(puncture["tick"])
    force = run.samples["contact_force_n"][:, 1]
    assert force[: tick + 1].max() == pytest.approx(600 * 0.004, rel=0.02)
    assert force[tick + 1] == 0
    assert np.abs(run.samples["vibration_force_n"][tick : tick + 100, 1]).max() > 0.5
    assert force[at(run, 1.35)] == pytest.approx(0.005 / (1 / 300 + 1 / 800), rel=0.05)
    assert handle(run)[0][-1, 1] > 0.025  # back above the membrane, through the hole


def test_the_seven_materials() -> None:
    run = run_of("materials")
    with (Path(__file__).parents[1] / "data" / "okamura1998_tapping.csv").open() as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    slopes = {row["material"]: float(row["attack_slope_per_s"]) for row in rows}
    contacts = events_of(run, EventKind.CONTACT)
    assert [name for _, name, _ in contacts] == list(slopes)
    for _, name, event in contacts:
        assert event["true_speed_m_per_s"] == pytest.approx(0.1, rel=0.02)
        assert event["amplitude_m_per_s2"] == pytest.approx(slopes[name] * 0.1, rel=0.03)
        assert event["scale"] == 1


def test_into_the_corner() -> None:
    run = run_of("corner")
    assert touches(run) == [
        ("CONTACT", "floor"),
        ("CONTACT", "side"),
        ("RELEASE", "side"),
        ("RELEASE", "floor"),
    ]
    x, y = handle(run)[0][at(run, 1.35)]
    normal = np.array([math.sqrt(3) / 2, -0.5])
    depth = -float(normal @ [x + 0.03, y])
    assert depth > 0.001
    assert y < -0.001
    # A step of the encoder, 20 um, is 16 mN.
    assert run.samples["contact_force_n"][at(run, 1.35)] == pytest.approx(
        800 * (depth * normal + [0, -y]), abs=2 * 0.016
    )


@pytest.mark.long
def test_the_fields() -> None:
    run = run_of("fields")
    position, velocity = handle(run)
    samples = run.samples
    law = -50 * samples["position_m"] - 2.5 * samples["velocity_m_per_s"] + [0, -0.2]
    assert samples["contact_force_n"] == pytest.approx(law, abs=1e-9)
    # Speeds are estimated from an encoder, so that they lag and ripple a little.
    assert samples["contact_force_n"] == pytest.approx(-50 * position - 2.5 * velocity + [0, -0.2], abs=0.1)
    assert np.ptp(position, axis=0).min() > 0.03
    assert np.abs(law).max() > 1.5
