"""Costs of a link (bench/link.py), compared with values computed without a simulation, and with the documentation."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from bench import link
from hapticd.config.configuration import Sim
from hapticd.config.materials import shipped_materials
from hapticd.config.modes import Mode

ROOT = Path(__file__).parents[2]


def staircase_error(mode: Mode, frame_s: float) -> float:
    """Return the smallest error, over delays, of a mode that is sampled before each frame and held for a frame."""
    step_s = frame_s / 200
    time_s = np.arange(0, 6 / mode.decay_rate_per_s + 4 * frame_s, step_s) + step_s / 2

    def wave(at_s: np.ndarray) -> np.ndarray:
        since = np.maximum(at_s, 0)
        return np.exp(-mode.decay_rate_per_s * since) * np.sin(mode.angular_frequency_rad_per_s * since)

    held = wave(np.floor(time_s / frame_s) * frame_s - 0.5 / link.RATE_HZ)
    left = [((held - wave(time_s - delay)) ** 2).sum() for delay in np.arange(0, 1.5, 0.02) * frame_s]
    return math.sqrt(min(left) / (wave(time_s) ** 2).sum())


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "link_hz"), [("wood", 1000.0), ("wood", 250.0), ("delrin", 500.0), ("acrylic", 1000.0)]
)
def test_a_tap_behind_a_link_is_its_closed_form_held(name: str, link_hz: float) -> None:
    material = shipped_materials()[name]
    assert material.tap is not None
    found = link.struck_error(name, material, link_hz)
    assert found is not None
    delay_s, error = found
    expected = staircase_error(material.tap.mode, 1 / link_hz)
    # The onset lies anywhere within a tick.
    assert error == pytest.approx(expected, rel=0.05)
    assert 1.5 / link_hz < delay_s < 2.5 / link_hz + 1e-4


@pytest.mark.long
def test_without_a_link_little_is_left() -> None:
    for name in ("wood", "steel", "cellophane"):
        found = link.struck_error(name, shipped_materials()[name], None)
        assert found is not None
        assert found[1] < 0.01


@pytest.mark.long
def test_modes_above_the_rate_of_the_link_are_silent() -> None:
    for name, link_hz, silent in (("steel", 1000.0, True), ("wood", 250.0, False), ("acrylic", 250.0, True)):
        assert (link.struck_error(name, shipped_materials()[name], link_hz) is None) == silent
    assert link.stroked_error("sandpaper_400", 500.0) is None


@pytest.mark.long
def test_walls_become_unstable_when_their_lateness_undoes_the_damping() -> None:
    """Stiffness times the force's mean age equals the damping of hand and handle, a little more with dry friction."""
    sim = Sim()
    damping = sim.handle_damping_n_s_per_m + sim.hand.damping_n_s_per_m
    for link_hz in (1000.0, 500.0):
        bound = damping / (2.5 / link_hz)
        assert bound < link.stiffest(link_hz) < 1.5 * bound


@pytest.mark.long
def test_the_page_has_the_computed_values() -> None:
    text = (ROOT / "docs" / "devices.md").read_text()
    rows = [line for line in text.splitlines() if line.startswith("| 1000 Hz |")]
    assert len(rows) == 1
    assert f"| {link._rounded(link.stiffest(1000.0))} |" in rows[0]
    (wood,) = [line for line in text.splitlines() if line.startswith("| wood |")]
    assert link._cell(link.struck_error("wood", shipped_materials()["wood"], 500.0)) in wood
    assert all(f"\n| {name} |" in text for name in link.SHOWN_MATERIALS)
