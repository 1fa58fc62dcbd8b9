"""Thresholds of the fits: each has a value, a unit and a reason."""

from __future__ import annotations

import dataclasses

import pytest

from hapticd.fit import limits

CLASSES = [each for each in vars(limits).values() if isinstance(each, type) and dataclasses.is_dataclass(each)]


@pytest.mark.parametrize("limits_class", CLASSES, ids=lambda each: each.__name__)
def test_each_threshold_has_a_value_a_unit_and_a_reason(limits_class: type) -> None:
    instance = limits_class()
    for each in dataclasses.fields(instance):
        assert getattr(instance, each.name) > 0
        assert each.metadata["unit"]
        assert each.metadata["reason"].endswith(".")
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(instance, dataclasses.fields(instance)[0].name, 0)
