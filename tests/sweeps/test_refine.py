"""Known boundaries, found by scan and bisection."""

from __future__ import annotations

import math
from typing import Any

import pytest

from hapticd.base.errors import HapticdError, InvalidError
from hapticd.sweeps.keys import SweepRefine
from hapticd.sweeps.refine import boundary_of, holds


def refine(**keys: Any) -> SweepRefine:
    return SweepRefine.parsed({"key": "a.x", "start": 1.0, "end": 1e4, "holds": "rests", **keys})


@pytest.mark.parametrize("edge", [1.0001, 2.0, 777.0, 9999.0])
def test_a_boundary_is_found_within_the_tolerance(edge: float) -> None:
    found = boundary_of(refine(within=1e-6), lambda value: value < edge)
    assert found.state == "found" and found.holds_at is not None and found.fails_at is not None
    assert found.holds_at < edge <= found.fails_at <= found.holds_at * (1.0 + 1e-6)
    # Each bisection halves the logarithm of the ratio.
    assert found.tried <= 2 + math.ceil(math.log2(math.log(1e4) / math.log1p(1e-6))) + 1


def test_a_search_downwards_and_linear() -> None:
    found = boundary_of(refine(start=10.0, end=-10.0, spacing="linear", within=0.01), lambda value: value > -3.0)
    assert found.holds_at is not None and found.fails_at is not None
    assert found.fails_at <= -3.0 < found.holds_at and found.holds_at - found.fails_at <= 0.01


def test_a_condition_that_always_or_never_holds_has_no_boundary() -> None:
    always = boundary_of(refine(), lambda value: True)
    assert (always.state, always.holds_at, always.fails_at, always.tried) == ("always", 1e4, None, 2)
    never = boundary_of(refine(), lambda value: False)
    assert (never.state, never.holds_at, never.fails_at, never.tried) == ("never", None, 1.0, 1)


def test_a_scan_finds_the_first_island_between_the_ends() -> None:
    def island(value: float) -> bool:
        return not 50.0 <= value <= 60.0

    assert boundary_of(refine(), island).state == "always"
    found = boundary_of(refine(scan=100, within=1e-4), island)
    assert found.holds_at is not None and found.fails_at is not None
    assert found.holds_at < 50.0 <= found.fails_at <= found.holds_at * 1.0001


def test_bisection_ends_at_neighbouring_numbers() -> None:
    found = boundary_of(refine(within=1e-300, start=1.0, end=2.0), lambda value: value < 1.5)
    assert found.holds_at is not None and found.fails_at == math.nextafter(found.holds_at, 2.0)


def test_conditions() -> None:
    assert holds(refine(), {"rests": True}) and not holds(refine(), {"rests": False})
    limit = refine(holds={"column": "given_j", "at_most": 0.1})
    assert holds(limit, {"given_j": 0.1}) and not holds(limit, {"given_j": 0.2})
    least = refine(holds={"column": "given_j", "at_least": 0.1})
    assert holds(least, {"given_j": 0.1}) and not holds(least, {"given_j": 0.05})
    with pytest.raises(HapticdError, match="given_j has no value at this point"):
        holds(limit, {"given_j": None})


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"start": 5.0, "end": 5.0}, "start and end must differ"),
        ({"start": -5.0}, "start and end must be above 0 with logarithmic spacing"),
        ({"within": 0.0}, "within: should be greater than 0"),
    ],
)
def test_an_impossible_search_is_refused(keys: dict[str, Any], message: str) -> None:
    given = {"key": "a.x", "start": 1.0, "end": 1e4, "holds": "rests", **keys}
    with pytest.raises(InvalidError, match=message):
        SweepRefine.model_validate(given)
