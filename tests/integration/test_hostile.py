"""A short run of `tests.soak.hostile`: whatever members of the group do, nothing fails and nobody loses anything.

How long answers take is not judged: that is for a quiet machine.
"""

from __future__ import annotations

import io
import random
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from hapticd.config.materials import validate_materials
from hapticd.config.scene import validate_object
from tests.soak import attackers, hostile, under_attack


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
    found = under_attack.Found(seconds=1.0, samples=5, missing=2, memory_mib=[50.0, 70.0, 60.0])
    found.took_ms["under attack"] = [1.0, 3.0]
    found.faults.update(["control"])
    told = found.table().markdown()
    assert "| samples lost | 0 | 2 |" in told and "| control 1 times |" in told
    assert "2.00 / 2.98 / 3.00 / 3.00, 2 times" in told
    assert not found.kept() and not found.held()
    found.faults.clear()
    found.missing = 0
    assert found.kept()


@pytest.fixture
def resting() -> Iterator[subprocess.Popen[bytes]]:
    """A process that goes on."""
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as process:
        yield process


def test_an_attacker_that_did_nothing_is_a_problem(resting: subprocess.Popen[bytes]) -> None:
    found = under_attack.Found(memory_mib=[50.0, 50.0, 50.0])
    found.took_ms["under attack"] = [1.0]
    said = [("connections", b"0 connections\n1,200 connections\n"), ("connections", b"34 connections\n")]
    with ExitStack() as stack:

        def attacker(kind: str, words: bytes) -> under_attack.Attacker:
            output = stack.enter_context(tempfile.TemporaryFile())
            output.write(words)
            output.flush()
            return under_attack.Attacker(kind, resting, output)

        found.count([attacker(*each) for each in said])
        assert found.kept() and found.held()
        assert found.table().markdown().count("attacker:") == 1
        assert "| 1,234 connections, by 2 processes |" in found.table().markdown()
        found.count([attacker("huge", b"0 messages\n"), attacker("long", b"")])
    assert found.idle == ["huge did nothing: 0 messages", "long did nothing: 0 (has not begun)"]
    assert "| problem | none | huge did nothing: 0 messages |" in found.table().markdown()
    assert not found.kept() and not found.held()
    found.processor_s = (1.0, 2.0)  # others held the processors
    assert found.kept() and not found.held()


def test_an_attacker_that_ended_is_a_problem() -> None:
    found = under_attack.Found()
    with tempfile.TemporaryFile() as output, subprocess.Popen(["true"]) as process:
        output.write(b"5 messages\nAssertionError: no answer\n")
        output.flush()
        process.wait()
        found.count([under_attack.Attacker("fuzz", process, output)])
    assert found.problems == ["fuzz ended: AssertionError: no answer"]


def test_only_what_was_done_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Attempts at a daemon that takes no connection are none."""
    told = io.StringIO()
    monkeypatch.setattr(sys, "stdout", told)
    tries = iter([None, None])

    def attack(path: Path) -> Iterator[None]:
        next(tries)  # ends the attacker at its third attempt
        with attackers.open_to(path, b"DEALER"):
            yield

    monkeypatch.setitem(attackers.ATTACKS, "ask", (attack, "command", "answers"))
    with pytest.raises(RuntimeError):
        attackers.main("ask", tmp_path)
    assert told.getvalue() == "0 answers\n"
