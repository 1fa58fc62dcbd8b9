"""Numbers and counts as people write them."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticd.base import wording


@pytest.mark.parametrize(
    ("text", "as_written"),
    [
        (wording.number(12340), "12,340"),
        (wording.number(-1234567), "-1,234,567"),
        (wording.number(8.9), "8.9"),
        (wording.number(12340.6), "12,341"),
        (wording.number(0.06481234), "0.06481"),
        (wording.number(9999.96), "10,000"),
        (wording.number(2.0), "2"),
        (wording.number(0.0), "0"),
        (wording.number(1.25e-7), "1.25e-07"),
        (wording.count(2, "glitch"), "2 glitches"),
        (wording.below(80.0, 800.0), "80"),
        (wording.below(40.0, 40.0), "39.99"),
        (wording.below(39.9999, 40.0), "39.99"),
        (wording.below(1000.0, 1000.001), "999"),
        (wording.count(1, "period"), "1 period"),
        (wording.count(0, "event"), "0 events"),
        (wording.count(12340, "tick"), "12,340 ticks"),
        (wording.count(2, "entry", "entries"), "2 entries"),
        (wording.si(10_000, "Hz"), "10 kHz"),
        (wording.si(67.0, "Hz"), "67 Hz"),
        (wording.si(1333.3333, "Hz"), "1.333 kHz"),
        (wording.si(0.0025, "s"), "2.5 ms"),
        (wording.si(0.0003, "s"), "300 us"),
        (wording.si(999.999, "Hz"), "1 kHz"),
        (wording.si(0, "N"), "0 N"),
        (wording.si(-0.002, "m"), "-2 mm"),
        (wording.quantity(0.05, "kg"), "0.05 kg"),
        (wording.quantity(1234.5, "N/m"), "1,234 N/m"),
        (wording.percent(0.1924), "19.2 %"),
        (wording.percent(1.0), "100 %"),
        (wording.percent(0.0), "0 %"),
        (wording.duration(0.0025), "2.5 ms"),
        (wording.duration(4.0), "4 s"),
        (wording.duration(64), "64 s"),
        (wording.duration(320), "5 min 20 s"),
        (wording.duration(3600), "1 h"),
        (wording.duration(11100), "3 h 5 min"),
        (wording.duration(187200), "2 days 4 h"),
        (wording.duration(0), "0 s"),
        (wording.size(1), "1 byte"),
        (wording.size(512), "512 bytes"),
        (wording.size(4_404_019), "4.2 MiB"),
        (wording.listed([]), ""),
        (wording.listed(["a"]), "a"),
        (wording.listed(["a", "b", "c"]), "a, b and c"),
    ],
)
def test_as_a_person_writes_it(text: str, as_written: str) -> None:
    assert text == as_written


_POWERS = {"n": 1e-9, "u": 1e-6, "m": 1e-3, "": 1.0, "k": 1e3, "M": 1e6, "G": 1e9}


@given(st.floats(1e-9, 1e12))
def test_a_number_with_a_prefix_is_the_number_to_four_digits(value: float) -> None:
    figure, unit = wording.si(value, "Hz").split()
    assert math.isclose(float(figure.replace(",", "")) * _POWERS[unit.removesuffix("Hz")], value, rel_tol=1e-3)


@given(st.integers())
def test_a_whole_number_keeps_its_digits(value: int) -> None:
    assert int(wording.number(value).replace(",", "")) == value
