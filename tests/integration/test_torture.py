"""A short run of the torture of a real daemon; `make torture` does a long one."""

from __future__ import annotations

import random

import pytest

from tests.soak import torture_live


@pytest.mark.long
def test_no_command_moves_the_force_faster_than_the_ramp() -> None:
    found = torture_live.run(random.Random(105), 250)
    # If samples were lost, the scene before a command is not known, and no tick with a command is looked at.
    assert found.changed > 0 or found.lost > 0
    assert found.flags["contact"] > 0
    assert found.worst <= torture_live.ROUNDED, found.over
    assert found.worst_changed <= torture_live.ROUNDED, found.over
    assert found.worst_moving <= torture_live.MOVING
