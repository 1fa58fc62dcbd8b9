"""Repeated lines of the log: which lines are logged, when, and that no amount is lost."""

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


def test_sparse_lines_are_logged_at_once() -> None:
    clock, logged = Clock(), list[Since]()
    repeats = Repeats(clock)
    for _ in range(20):
        repeats.note("a", logged.append)
        clock.s += FORGET_AFTER_S
        repeats.flush()
    assert logged == [Since()] * 20
    assert not repeats._kinds


def test_kinds_do_not_hold_each_other_back() -> None:
    clock, logged = Clock(), list[str]()
    repeats = Repeats(clock)
    for kind in "abca":
        repeats.note(kind, lambda since, kind=kind: logged.append(kind))  # type: ignore[misc]
    assert logged == ["a", "b", "c"]


def test_a_delayed_line_has_a_suffix() -> None:
    clock, logged = Clock(), list[Since]()
    repeats = Repeats(clock)
    for _ in range(2):
        repeats.note("a", logged.append)
    clock.s = 1.0
    repeats.flush()
    assert [since.more for since in logged] == ["", " (once in the last 1 s)"]


def test_a_delayed_line_is_logged_after_a_quiet_time() -> None:
    clock, logged = Clock(), list[Since]()
    repeats = Repeats(clock)
    while clock.s < 2 * MAX_REPEAT_INTERVAL_S:
        repeats.note("a", logged.append)
        repeats.flush()
        clock.s += 1.0
    before = len(logged)
    clock.s += FORGET_AFTER_S
    repeats.flush()
    assert len(logged) == before + 1
    clock.s += MIN_REPEAT_INTERVAL_S
    repeats.note("a", logged.append)
    assert logged[-1] == Since()


@given(st.lists(st.tuples(st.floats(0, 1000), st.integers(0, 9)), max_size=200))
def test_nothing_is_lost_and_no_two_lines_come_close(steps: list[tuple[float, int]]) -> None:
    clock, logged, at = Clock(), list[Since](), list[float]()
    repeats = Repeats(clock)

    def tell(since: Since) -> None:
        logged.append(since)
        at.append(clock.s)

    for seconds, amount in steps:
        clock.s += seconds
        repeats.flush()
        repeats.note("a", tell, {"n": amount})
    clock.s += MAX_REPEAT_INTERVAL_S
    repeats.flush()
    assert sum(since.times for since in logged) == len(steps)
    assert sum(since.amounts["n"] for since in logged) == sum(amount for _, amount in steps)
    assert all(after - before >= MIN_REPEAT_INTERVAL_S for before, after in pairwise(at))


def test_at_the_end_all_sums_are_logged() -> None:
    clock, logged = Clock(), list[Since]()
    repeats = Repeats(clock)
    for _ in range(5):
        repeats.note("a", logged.append)
        clock.s += 0.1
    repeats.finish()
    repeats.finish()
    assert [since.times for since in logged] == [1, 4]
