"""Numbers and counts as a person writes them."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticd import words


@pytest.mark.parametrize(
    ("told", "as_written"),
    [
        (words.number(12340), "12,340"),
        (words.number(-1234567), "-1,234,567"),
        (words.number(8.9), "8.9"),
        (words.number(12340.6), "12,341"),
        (words.number(0.06481234), "0.06481"),
        (words.number(9999.96), "10,000"),
        (words.number(2.0), "2"),
        (words.number(0.0), "0"),
        (words.number(1.25e-7), "1.25e-07"),
        (words.count(1, "period"), "1 period"),
        (words.count(0, "event"), "0 events"),
        (words.count(12340, "tick"), "12,340 ticks"),
        (words.count(2, "entry", "entries"), "2 entries"),
        (words.si(10_000, "Hz"), "10 kHz"),
        (words.si(67.0, "Hz"), "67 Hz"),
        (words.si(1333.3333, "Hz"), "1.333 kHz"),
        (words.si(0.0025, "s"), "2.5 ms"),
        (words.si(0.0003, "s"), "300 us"),
        (words.si(999.999, "Hz"), "1 kHz"),
        (words.si(0, "N"), "0 N"),
        (words.si(-0.002, "m"), "-2 mm"),
        (words.quantity(0.05, "kg"), "0.05 kg"),
        (words.quantity(1234.5, "N/m"), "1,234 N/m"),
        (words.percent(0.1924), "19.2 %"),
        (words.percent(1.0), "100 %"),
        (words.percent(0.0), "0 %"),
        (words.duration(0.0025), "2.5 ms"),
        (words.duration(4.0), "4 s"),
        (words.duration(64), "64 s"),
        (words.duration(320), "5 min 20 s"),
        (words.duration(3600), "1 h"),
        (words.duration(11100), "3 h 5 min"),
        (words.duration(187200), "2 days 4 h"),
        (words.duration(0), "0 s"),
        (words.size(1), "1 byte"),
        (words.size(512), "512 bytes"),
        (words.size(4_404_019), "4.2 MiB"),
        (words.listed([]), ""),
        (words.listed(["a"]), "a"),
        (words.listed(["a", "b", "c"]), "a, b and c"),
    ],
)
def test_as_a_person_writes_it(told: str, as_written: str) -> None:
    assert told == as_written


_POWERS = {"n": 1e-9, "u": 1e-6, "m": 1e-3, "": 1.0, "k": 1e3, "M": 1e6, "G": 1e9}


@given(st.floats(1e-9, 1e12))
def test_a_number_with_a_prefix_is_the_number_to_four_digits(value: float) -> None:
    figure, unit = words.si(value, "Hz").split()
    assert math.isclose(float(figure.replace(",", "")) * _POWERS[unit.removesuffix("Hz")], value, rel_tol=1e-3)


@given(st.integers())
def test_a_whole_number_keeps_its_digits(value: int) -> None:
    assert int(words.number(value).replace(",", "")) == value
