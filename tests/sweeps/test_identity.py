"""Two documents have the same hash if and only if they have the same content."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticd.base.yaml_source import Json
from hapticd.sweeps.identity import sum_of, sums_at

SCALARS = st.one_of(st.none(), st.booleans(), st.integers(-(2**60), 2**60), st.floats(allow_nan=False), st.text())
DOCUMENTS = st.recursive(
    SCALARS,
    lambda inner: st.one_of(st.lists(inner, min_size=1), st.dictionaries(st.text(), inner, min_size=1)),
    max_leaves=12,
)


def normal(data: Json) -> object:
    """Return a document in which equal numbers are equal, and true differs from 1."""
    if isinstance(data, dict):
        return {key: normal(value) for key, value in data.items()}
    if isinstance(data, list):
        return [normal(value) for value in data]
    if isinstance(data, bool):
        return ("bool", data)
    if isinstance(data, int) and abs(data) > 2**53:
        return ("large", data)
    return ("number", repr(float(data))) if isinstance(data, int | float) else (type(data).__name__, data)


@given(DOCUMENTS, DOCUMENTS)
@pytest.mark.slow
def test_the_same_sum_means_the_same_document(one: Json, other: Json) -> None:
    same = normal(one) == normal(other)
    assert (sum_of(one).tolist() == sum_of(other).tolist()) == same


@pytest.mark.long
@given(st.dictionaries(st.text(), SCALARS, min_size=2))
def test_the_order_of_keys_has_no_effect(data: dict[str, Json]) -> None:
    turned = dict(reversed(data.items()))
    assert sum_of(data).tolist() == sum_of(turned).tolist()


def test_equal_numbers_have_equal_hashes_and_true_is_not_a_number() -> None:
    assert sum_of(1000).tolist() == sum_of(1000.0).tolist()
    assert sum_of(1).tolist() != sum_of(True).tolist()
    assert sum_of("1").tolist() != sum_of(1).tolist()
    assert sum_of(2**53 + 1).tolist() != sum_of(float(2**53)).tolist()


def test_the_order_of_a_list_has_an_effect() -> None:
    assert sum_of([1, 2]).tolist() != sum_of([2, 1]).tolist()


def test_hashes_of_values_at_a_path_are_those_of_their_documents() -> None:
    values: list[Json] = [1000, 0.1, "steel", True, None]
    for value, found in zip(values, sums_at(("servo", "rate_hz"), values), strict=True):
        assert found.tolist() == sum_of({"servo": {"rate_hz": value}}).tolist()


def test_the_path_of_a_value_has_an_effect() -> None:
    assert sum_of({"a": {"b": 1}}).tolist() != sum_of({"a": 1, "b": 1}).tolist()
    assert sum_of({"a.b": 1}).tolist() != sum_of({"a": {"b": 1}}).tolist()
