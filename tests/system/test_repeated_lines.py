"""Lines that repeat each other: what is told, when, and that nothing is lost."""

from __future__ import annotations

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from hapticd.system.repeated_lines import FORGET_AFTER_S, MAX_REPEAT_INTERVAL_S, MIN_REPEAT_INTERVAL_S, Repeats, Since


class Clock:
    def __init__(self) -> None:
        self.s = 0.0

    def __call__(self) -> float:
        return self.s


def test_sparse_ones_are_told_as_they_come() -> None:
    clock, told = Clock(), list[Since]()
    repeats = Repeats(clock)
    for _ in range(20):
        repeats.note("a", told.append)
        clock.s += FORGET_AFTER_S
        repeats.flush()
    assert told == [Since()] * 20
    assert not repeats._kinds


def test_kinds_do_not_hold_each_other_back() -> None:
    clock, told = Clock(), list[str]()
    repeats = Repeats(clock)
    for kind in "abca":
        repeats.note(kind, lambda since, kind=kind: told.append(kind))  # type: ignore[misc]
    assert told == ["a", "b", "c"]


def test_one_that_was_held_back_says_so() -> None:
    clock, told = Clock(), list[Since]()
    repeats = Repeats(clock)
    for _ in range(2):
        repeats.note("a", told.append)
    clock.s = 1.0
    repeats.flush()
    assert [since.more for since in told] == ["", " (once in the last 1 s)"]


def test_what_is_held_back_is_told_when_it_has_been_quiet() -> None:
    clock, told = Clock(), list[Since]()
    repeats = Repeats(clock)
    while clock.s < 2 * MAX_REPEAT_INTERVAL_S:
        repeats.note("a", told.append)
        repeats.flush()
        clock.s += 1.0
    before = len(told)
    clock.s += FORGET_AFTER_S
    repeats.flush()
    assert len(told) == before + 1
    clock.s += MIN_REPEAT_INTERVAL_S
    repeats.note("a", told.append)
    assert told[-1] == Since()


@given(st.lists(st.tuples(st.floats(0, 1000), st.integers(0, 9)), max_size=200))
def test_nothing_is_lost_and_no_two_lines_come_close(steps: list[tuple[float, int]]) -> None:
    clock, told, at = Clock(), list[Since](), list[float]()
    repeats = Repeats(clock)

    def tell(since: Since) -> None:
        told.append(since)
        at.append(clock.s)

    for seconds, amount in steps:
        clock.s += seconds
        repeats.flush()
        repeats.note("a", tell, {"n": amount})
    clock.s += MAX_REPEAT_INTERVAL_S
    repeats.flush()
    assert sum(since.times for since in told) == len(steps)
    assert sum(since.amounts["n"] for since in told) == sum(amount for _, amount in steps)
    assert all(after - before >= MIN_REPEAT_INTERVAL_S for before, after in pairwise(at))


def test_at_the_end_all_is_told() -> None:
    clock, told = Clock(), list[Since]()
    repeats = Repeats(clock)
    for _ in range(5):
        repeats.note("a", told.append)
        clock.s += 0.1
    repeats.finish()
    repeats.finish()
    assert [since.times for since in told] == [1, 4]
