"""A short run of `python -m bench.hostile`: whatever members of the group do, nothing fails and nobody loses anything.

How long answers take is not judged: that is for a quiet machine.
"""

from __future__ import annotations

import random

import pytest

from bench import attackers, hostile
from hapticd.materials import validate_materials
from hapticd.scene import validate_object


@pytest.mark.slow
@pytest.mark.alone
def test_everything_at_once_is_borne() -> None:
    found = hostile.attack(seconds=10.0, rate_hz=2000.0, connections=500, settle_s=0.0, nice=19)
    assert found.kept(), found.table().markdown()
    assert found.samples > 0


def test_long_changes_are_valid() -> None:
    validate_materials({"noise": attackers.noise(random.Random(1), 3)})
    assert len(validate_object("wall", attackers.wall(0, 10)).patches) == 10  # type: ignore[union-attr]
    assert attackers.wall(1)["patches"][-1]["to_m"] < 20  # type: ignore[index]


def test_what_was_found_is_a_table() -> None:
    found = hostile.Found(seconds=1.0, samples=5, missing=2, memory_mib=[50.0, 70.0, 60.0])
    found.took_ms["under attack"] = [1.0, 3.0]
    found.faults.update(["control"])
    told = found.table().markdown()
    assert "| samples lost | 0 | 2 |" in told and "| control 1 times |" in told
    assert "2.00 / 2.98 / 3.00 / 3.00, 2 times" in told
    assert not found.kept() and not found.held()
