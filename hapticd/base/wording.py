"""Numbers, counts and times for people: 12,340 ticks, 1 period, 10 kHz, 2.5 ms, 19 %.

JSON, YAML and other files have plain numbers instead.
"""

from __future__ import annotations

import math
import numbers
from collections.abc import Sequence
from typing import Final

DEFAULT_DIGITS: Final = 4
"""Significant digits of a number that is not an integer."""
_SI_PREFIXES: Final = {-9: "n", -6: "u", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
_MIN_PLAIN_EXPONENT: Final = -4
"""Numbers below 1e-4 are written with an exponent."""
_SIZE_UNITS: Final = ("bytes", "KiB", "MiB", "GiB", "TiB")


def number(value: float, digits: int = DEFAULT_DIGITS) -> str:
    """Format a number: 12340 -> 12,340; 8.90 -> 8.9; 0.06481234 -> 0.06481. An integer keeps all its digits."""
    if isinstance(value, numbers.Integral):  # numpy's, too
        return f"{value:,}"
    if not math.isfinite(value) or value == 0:
        return f"{value:g}"
    exponent = math.floor(math.log10(abs(value)))
    if exponent < _MIN_PLAIN_EXPONENT:
        return f"{value:.{digits}g}"
    text = f"{value:,.{max(0, digits - 1 - exponent)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def below(limit: float, value: float) -> str:
    """Format a limit > 0, at most `value`, so that it reads as lower than `value`: 40 and 40.001 -> 39.99."""
    text = f"{limit:.{DEFAULT_DIGITS}g}"
    if text != f"{value:.{DEFAULT_DIGITS}g}":
        return text
    return f"{limit - 10.0 ** (math.floor(math.log10(limit)) + 1 - DEFAULT_DIGITS):.{DEFAULT_DIGITS}g}"


def count(amount: int, thing: str, things: str | None = None) -> str:
    """Format a count: 1 period; 12,340 periods; 2 glitches. `things` is the plural if s or es does not form it."""
    plural = things or thing + ("es" if thing.endswith("ch") else "s")
    return f"{amount:,} {thing if amount == 1 else plural}"


def si(value: float, unit: str, digits: int = DEFAULT_DIGITS) -> str:
    """Format a quantity with an SI prefix: 10000 Hz -> 10 kHz; 0.0025 s -> 2.5 ms; 0.0003 s -> 300 us.

    Use `quantity` for units that do not take a prefix.
    """
    if value == 0 or not math.isfinite(value):
        return quantity(value, unit)
    rounded = float(f"{value:.{digits - 1}e}")
    power = 3 * math.floor(math.log10(abs(rounded)) / 3)
    power = min(max(power, min(_SI_PREFIXES)), max(_SI_PREFIXES))
    scaled = rounded / 10**power if power >= 0 else rounded * 10**-power
    return f"{number(float(scaled), digits)} {_SI_PREFIXES[power]}{unit}"


def quantity(value: float, unit: str, digits: int = DEFAULT_DIGITS) -> str:
    """Format a quantity without a prefix: 1234.5 and N/m -> 1,234 N/m; 0.05 and kg -> 0.05 kg."""
    return f"{number(value, digits)} {unit}"


def percent(fraction: float, digits: int = 3) -> str:
    """Format a fraction in percent: 0.1924 -> 19.2 %; 1 -> 100 %."""
    return f"{number(100.0 * fraction, digits)} %"


def duration(seconds: float) -> str:
    """Format a time in s: 2.5 ms; 64 s; 5 min 20 s; 3 h 5 min; 2 days 4 h."""
    if seconds < 0:
        return f"-{duration(-seconds)}"
    if seconds < 120 or not math.isfinite(seconds):
        return si(seconds, "s") if seconds < 1 else quantity(seconds, "s")
    rounded_s = round(seconds)
    if rounded_s < 3600:
        return _two(rounded_s // 60, "min", rounded_s % 60, "s")
    minutes = round(seconds / 60)
    if minutes < 48 * 60:
        return _two(minutes // 60, "h", minutes % 60, "min")
    hours = round(seconds / 3600)
    return _two(hours // 24, "days", hours % 24, "h")


def size(number_of_bytes: int) -> str:
    """Format a number of bytes: 1 byte; 512 bytes; 4.2 MiB."""
    if number_of_bytes < 1024:
        return count(number_of_bytes, "byte")
    power = min(int(math.log2(number_of_bytes) // 10), len(_SIZE_UNITS) - 1)
    return f"{number(number_of_bytes / 1024**power, 3)} {_SIZE_UNITS[power]}"


def listed(names: Sequence[str]) -> str:
    """Join names: a, b and c."""
    return " and ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))


def _two(large: int, large_unit: str, small: int, small_unit: str) -> str:
    return f"{large:,} {large_unit}" + (f" {small} {small_unit}" if small else "")
