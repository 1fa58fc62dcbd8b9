"""Which of a test's many cases `make test` and CI run."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def rest_slow(cases: Iterable[Any], fast: int = 1) -> list[Any]:
    """The first cases are fast; the others, which show the same at other values, are marked slow."""
    return [
        each if place < fast else pytest.param(*(each if isinstance(each, tuple) else (each,)), marks=pytest.mark.slow)
        for place, each in enumerate(cases)
    ]
