"""A session loses nothing if its runner, daemon and pages are killed: tests.soak.kill_experiment in short."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.soak.kill_experiment import torture


@pytest.mark.slow
def test_a_session_that_is_killed_again_and_again_has_every_answer_once(tmp_path: Path) -> None:
    found = torture(tmp_path, kills=6, trials=12, seed=1)
    assert found.problems == []
    assert sum(found.kills.values()) == 6
