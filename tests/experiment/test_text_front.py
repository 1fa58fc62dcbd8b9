"""The keys of a terminal, and the lines of another input."""

from __future__ import annotations

import io
import os
import pty
from collections.abc import Iterator
from typing import TextIO

import pytest

from hapticd.base.errors import HapticdError
from hapticd.experiment.text_front import Keys, TextFront


@pytest.fixture
def pipe() -> Iterator[tuple[int, TextIO]]:
    """Return the writing end of a pipe, and its reading end as a stream."""
    read, write = os.pipe()
    with os.fdopen(read) as stream:
        yield write, stream


@pytest.fixture
def terminal() -> Iterator[tuple[int, TextIO]]:
    """Return the end of a terminal into which a person types, and the terminal as a stream."""
    person, end = pty.openpty()
    with os.fdopen(end) as stream:
        yield person, stream
    os.close(person)


def test_lines_of_a_pipe_are_read_one_by_one_and_its_end_is_reported(pipe: tuple[int, TextIO]) -> None:
    write, stream = pipe
    keys = Keys(stream)
    assert keys.read(0.0) is None
    os.write(write, b"first\nsec")
    assert keys.read(30.0) == "first"
    assert keys.line(0.0) is None  # the line has not ended
    os.write(write, "ond \N{LATIN SMALL LETTER E WITH ACUTE}\n".encode())
    assert keys.line(30.0) == "second \N{LATIN SMALL LETTER E WITH ACUTE}"
    os.close(write)
    with pytest.raises(HapticdError, match="the input has ended; continue with `hapticd experiment resume`"):
        keys.read(30.0)


def test_keys_of_a_terminal_come_as_they_are_pressed(terminal: tuple[int, TextIO]) -> None:
    person, stream = terminal
    keys = Keys(stream)
    with keys.single():
        assert keys.read(0.0) is None
        os.write(person, b"a\x1b[D ")
        assert [keys.read(30.0) for _ in range(3)] == ["a", "left", "space"]
    os.write(person, b"words\n")
    assert keys.line(30.0, begun="two ") == "two words"


def test_instructions_are_read_without_the_signs_of_markdown(pipe: tuple[int, TextIO]) -> None:
    write, stream = pipe
    out = io.StringIO()
    os.write(write, b"\n")
    TextFront(stream, out).begin("Stiffness", "Press **both** surfaces.\n\n- the *left* one", 0, 1, False)
    assert "Press both surfaces." in out.getvalue() and "the left one" in out.getvalue()
    assert "*" not in out.getvalue()
    os.close(write)


@pytest.mark.parametrize(
    ("at_most", "expected"), [(False, "3 of 124 trials done."), (True, "3 of at most 124 trials done.")]
)
def test_a_session_that_may_end_early_shows_at_most(pipe: tuple[int, TextIO], at_most: bool, expected: str) -> None:
    write, stream = pipe
    out = io.StringIO()
    os.write(write, b"\n")
    TextFront(stream, out).begin("Stiffness", "Press.", 3, 124, at_most)
    assert expected in out.getvalue().splitlines()
    os.close(write)
