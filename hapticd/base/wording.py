"""Numbers, counts and times as a person writes them: 12,340 ticks, 1 period, 10 kHz, 2.5 ms, 19 %.

For lines that people read. JSON, YAML and files carry plain numbers.
"""

from __future__ import annotations

import math
import numbers
from collections.abc import Sequence
from typing import Final

DIGITS: Final = 4
"""Significant digits of a number that is not whole."""

_PREFIXES: Final = {-9: "n", -6: "u", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
_SMALLEST: Final = -4
"""A number below ten to this power has an exponent."""
_SIZES: Final = ("bytes", "KiB", "MiB", "GiB", "TiB")


def number(value: float, digits: int = DIGITS) -> str:
    """12340 -> 12,340; 8.90 -> 8.9; 0.06481234 -> 0.06481. A whole number keeps all its digits."""
    if isinstance(value, numbers.Integral):  # numpy's, too
        return f"{value:,}"
    if not math.isfinite(value) or value == 0:
        return f"{value:g}"
    exponent = math.floor(math.log10(abs(value)))
    if exponent < _SMALLEST:
        return f"{value:.{digits}g}"
    text = f"{value:,.{max(0, digits - 1 - exponent)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def count(amount: int, thing: str, things: str | None = None) -> str:
    """1 period; 12,340 periods; 0 periods. `things`: the plural where it is not made by an s."""
    return f"{amount:,} {thing if amount == 1 else things or thing + 's'}"


def si(value: float, unit: str, digits: int = DIGITS) -> str:
    """With the prefix that a person would choose: 10000 Hz -> 10 kHz; 0.0025 s -> 2.5 ms; 0.0003 s -> 300 us.

    For units that take a prefix; `quantity` is for the others.
    """
    if value == 0 or not math.isfinite(value):
        return quantity(value, unit)
    rounded = float(f"{value:.{digits - 1}e}")
    power = 3 * math.floor(math.log10(abs(rounded)) / 3)
    power = min(max(power, min(_PREFIXES)), max(_PREFIXES))
    return (
        f"{number(float(rounded / 10**power if power >= 0 else rounded * 10**-power), digits)} {_PREFIXES[power]}{unit}"
    )


def quantity(value: float, unit: str, digits: int = DIGITS) -> str:
    """A number and its unit as it is: 1234.5 and N/m -> 1,234 N/m; 0.05 and kg -> 0.05 kg."""
    return f"{number(value, digits)} {unit}"


def percent(share: float, digits: int = 3) -> str:
    """0.1924 -> 19.2 %; 1 -> 100 %."""
    return f"{number(100.0 * share, digits)} %"


def duration(seconds: float) -> str:
    """2.5 ms; 64 s; 5 min 20 s; 3 h 5 min; 2 days 4 h."""
    if seconds < 0:
        return f"-{duration(-seconds)}"
    if seconds < 120 or not math.isfinite(seconds):
        return si(seconds, "s") if seconds < 1 else quantity(seconds, "s")
    whole = round(seconds)
    if whole < 3600:
        return _two(whole // 60, "min", whole % 60, "s")
    whole = round(seconds / 60)
    if whole < 48 * 60:
        return _two(whole // 60, "h", whole % 60, "min")
    whole = round(seconds / 3600)
    return _two(whole // 24, "days", whole % 24, "h")


def size(number_of_bytes: int) -> str:
    """1 byte; 512 bytes; 4.2 MiB."""
    if number_of_bytes < 1024:
        return count(number_of_bytes, "byte")
    power = min(int(math.log2(number_of_bytes) // 10), len(_SIZES) - 1)
    return f"{number(number_of_bytes / 1024**power, 3)} {_SIZES[power]}"


def listed(names: Sequence[str]) -> str:
    """a, b and c."""
    return " and ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))


def _two(large: int, large_unit: str, small: int, small_unit: str) -> str:
    return f"{large:,} {large_unit}" + (f" {small} {small_unit}" if small else "")
