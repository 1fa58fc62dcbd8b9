"""Units of measured quantities: their spellings, and the unit that the name of a column states.

A unit may stand in a column's name in these places; the table is in docs/fit.md:

    Acc (g), Acc [g], Acc {g}     in brackets, anywhere
    a / g                         behind a slash
    ax_g, Acc g, a-g, a_mm_per_s2 as the last word; a single letter counts only if it is written as the unit is
    acc_g_x, acc_g_1, ax_g (left) as the last word before x, y, z, a number, `filtered`, or brackets without a unit
    ms                            as the complete name
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Literal, TypeAlias

from hapticd.base.errors import shown_name

Quantity: TypeAlias = Literal["time", "acceleration", "force", "position", "tangential_position", "speed"]

_METRES_PER_UNIT: Final = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6}
UNITS_OF: Final[dict[Quantity, dict[str, float]]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "acceleration": {"m/s^2": 1.0, "cm/s^2": 1e-2, "mm/s^2": 1e-3, "g": 9.80665, "mg": 9.80665e-3},
    "force": {"N": 1.0, "mN": 1e-3, "kN": 1e3},
    "position": _METRES_PER_UNIT,
    "tangential_position": _METRES_PER_UNIT,
    "speed": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3},
}
"""Units of each quantity that are known, with their values in SI units."""
_SINGLE_LETTERS: Final = ("g", "m", "s", "N", "V")
"""Single letters that are units in a name. Others, and these in another case, number a channel or name an axis."""
_OTHER_UNIT_PATTERN: Final = re.compile(
    "[mku]?v(?:dc|ac|rms|pp|pk)?|m?volts?|voltage|[pn]c|[kmh]?pa|m?bar|psi|[km]?hz|db(?:v|m|fs)?|%(?:fs)?|°c?|"
    "deg(?:c|rees?)?|m?rad|dps|rpm|ips|mph|lb[fs]?|k?gf|[km]?gr(?:f|am(?:me)?s?)?|kg|ozf?|[uc]n|dan|n[cm]?m|[un]g|m?gal|"
    "ohm|px|pixels?|lsbs?|adc|raw|counts?|cts|codes?|digits?|bits|au|arb(?:units?)?|unitless|normali[sz]ed"
)
"""Units of quantities that no recording has here, and of raw numbers, as `_key` spells them."""
_OTHER_LENGTH_PATTERN: Final = re.compile("in|inch(?:es)?|ft|mils?|dm|km|steps?|ticks?")
_OTHER_PATTERN_OF: Final[dict[Quantity | None, re.Pattern[str]]] = {
    "time": re.compile("min(?:utes)?|h|hrs?|hours?|d|days?|samples?|ticks?|index"),
    "force": re.compile("m?g"),
    "position": _OTHER_LENGTH_PATTERN,
    "tangential_position": _OTHER_LENGTH_PATTERN,
}
"""The same for one quantity only: `min` is a minimum in the name of another column."""
_PART_PATTERN: Final = re.compile("rad|in|ft|min|h|1|[cdmkun]?m|m?s|g|n|" + _OTHER_UNIT_PATTERN.pattern)
"""What a unit with a slash may consist of."""
_SPELLING_PATTERNS: Final = (
    (r"squared|sq$", "2"),
    (r"microns?$|^u$", "um"),
    (r"seconds?|secs?|sek", "s"),
    (r"met(?:er|re)s?", "m"),
    (r"newtons?", "n"),
    (r"milli", "m"),
    (r"micro", "u"),
    (r"centi", "c"),
    (r"nano", "n"),
    (r"kilo", "k"),
    (r"per(?!cent)", "/"),
    (r"^(m?)(?:gs|g's|g0|gn|gee|gforce|grms|gpk)$", r"\1g"),
    (r"^([cmu]?m)/?(?:s-2|ss|s/s|ps2|pss|s2|s[?\ufffd\u00fd])$", r"\1/s2"),
    (r"^([cmu]?m)(?:s-1|ps)$", r"\1/s"),
)
"""Spellings of units and their replacements, in the order in which they are applied; ? and \u00fd are a damaged 2."""
_BRACKETS_PATTERN: Final = re.compile(r"\(((?:[^()]|\([^()]*\))*)\)|\[([^\[\]]*)\]|\{([^{}]*)\}")
_GRAVITY_PATTERN: Final = re.compile(
    r"(?<![^\W_])(?:with(?:out)?|w/?o|no|minus|incl|excl|ohne|mit|sans|sin)[\s_.]+g(?![^\W_])"
    r"|(?<![^\W_])g[\s_-]+(?:removed|subtracted|compensated|free)",
    re.IGNORECASE,
)
"""A g in a name that is the gravity, such as `Acceleration (without g)`."""
_SUFFIX_PATTERN: Final = re.compile(r"[xyz]|\d+|filt(?:ered)?", re.IGNORECASE)
"""A word that may follow the unit in a name."""
_MAX_CONVERSION_ERROR: Final = 0.02
"""Largest relative error of a `scale` that still is a conversion of units, such as 9.81 for g."""


class ColumnUnitError(ValueError):
    """The unit of a column is unknown, or is stated in two ways that contradict each other."""


@dataclass(frozen=True, slots=True)
class StatedUnit:
    """A unit that a file states for a column."""

    text: str
    """The unit as it stands in the file."""
    source: str
    """Where it stands, for messages."""
    column: str
    """Name of the column; without the unit, if the unit stands in it."""

    def is_converted(self, quantity: Quantity) -> bool:
        """Return whether the unit is known, and is not the SI unit of the quantity."""
        return UNITS_OF[quantity].get(unit_of(self.text, quantity) or "", 1.0) != 1


def unit_of(text: str, quantity: Quantity) -> str | None:
    """Return a unit as UNITS_OF spells it; None if it is not a known unit of this quantity."""
    return _UNIT_OF_KEY[quantity].get(_key(text))


def is_unit(text: str, quantity: Quantity | None = None) -> bool:
    """Return whether a text is nothing but a unit, known or unknown, of this quantity or of any."""
    bare = text.strip("()[]{} ")
    if len(bare) == 1 or bare == "mA":
        return bare in _SINGLE_LETTERS or bare in ("%", "°", "μ", "mA")
    key = _key(text)
    if _is_other(key, quantity) or any(key in known for known in _UNIT_OF_KEY.values()):
        return True
    parts = [re.sub(r"(?<=[a-z])-?\d$", "", part) for part in key.split("/")]
    return len(parts) > 1 and all(map(_PART_PATTERN.fullmatch, parts))


def has_unit_in_brackets(text: str) -> bool:
    """Return whether a unit of any quantity stands in brackets in a text."""
    return any(_in_brackets(match, None) for match in _BRACKETS_PATTERN.finditer(text))


def stated_unit(name: str, quantity: Quantity, line_unit: str = "") -> StatedUnit | None:
    """Return the unit that a column's name states, or its cell `line_unit` in a line of units; None without one.

    Raises ColumnUnitError if they contradict each other.
    """
    found = _unit_in_name(_GRAVITY_PATTERN.sub("gravity", unicodedata.normalize("NFKC", name)), quantity)
    by_name = None if found is None else StatedUnit(found[0], f"the name of its column {shown_name(name)}", found[1])
    if not line_unit:
        return by_name
    by_line = StatedUnit(line_unit, "the line of units", name)
    if by_name is None:
        return by_line
    own = unit_of(line_unit, quantity)
    if (own or is_unit(line_unit, quantity)) and own != unit_of(by_name.text, quantity):
        raise ColumnUnitError(
            f"the {quantity} is in {by_name.text} by {by_name.source}, in {line_unit} by {by_line.source}: correct one "
            "of them"
        )
    return by_name


def factor_of(
    quantity: Quantity, stated: StatedUnit | None, unit: str | None, scale: float | None, where: str
) -> float:
    """Return the factor of a column's numbers to SI units.

    `stated` is the unit of the file, `unit` and `scale` are those of its YAML file `where`; each is None if it is not
    given. Raises ColumnUnitError if they contradict each other, or for an unknown unit that no `scale` converts.
    """
    units = UNITS_OF[quantity]
    given = 1.0 if unit is None else units[unit]
    factor = 1.0 if scale is None else scale
    if stated is None:
        return factor * given
    own = unit_of(stated.text, quantity)
    by = f"the {quantity} is in {stated.text} by {stated.source}"
    if own is None:
        converted = scale is not None and (abs(scale) != 1 or unit is not None)
        if converted or (unit is not None and not is_unit(stated.text, quantity)):
            return factor * given
        if unit is not None:
            raise ColumnUnitError(
                f"{by}, in {unit} by {where}: correct one of them, or set there the scale that converts"
            )
        raise ColumnUnitError(
            f"unknown unit of {quantity} {shown_name(stated.text)} by {stated.source}, known: {', '.join(units)}: set "
            f"the scale that converts its numbers, and their unit after that, in {where}"
        )
    ratio = units[own] / given
    is_conversion = abs(abs(factor) / ratio - 1) <= _MAX_CONVERSION_ERROR
    if unit is not None and ratio != 1:
        if not is_conversion:
            raise ColumnUnitError(f"{by}, in {unit} by {where}: correct one of them")
        return factor * given
    if unit is None and units[own] != 1 and is_conversion:
        raise ColumnUnitError(
            f"{by}, and the scale {scale:g} in {where} converts it once more: leave the scale out, or set unit: "
            f"{next(iter(units))}"
        )
    return factor * units[own]


def _unit_in_name(name: str, quantity: Quantity) -> tuple[str, str] | None:
    """Return the unit in a name and the name without it. A known unit of the quantity is preferred to an unknown one.

    Raises ColumnUnitError if two known units stand in brackets.
    """
    own = {unit for match in _BRACKETS_PATTERN.finditer(name) if (unit := _in_brackets(match, quantity))}
    if len(known := sorted(unit for unit in own if unit_of(unit, quantity))) > 1:
        raise ColumnUnitError(f"the name of the column of the {quantity} states two units: {' and '.join(known)}")
    found = list(_candidates(name, quantity))
    return next((each for each in found if unit_of(each[0], quantity)), found[0] if found else None)


def _in_brackets(match: re.Match[str], quantity: Quantity | None) -> str:
    """Return the unit in brackets, of which it may be a part: `(g, filtered)`, `(16g)`; "" without one."""
    text = "".join(filter(None, match.groups())).strip()
    parts = [text, *re.split(r"[\s,;|]+|(?<=\d)(?=[^\W\d])", text)]
    is_g = ("G",) if quantity in (None, "acceleration") else ()
    return next((part for part in parts if part in is_g or is_unit(part, quantity)), "")


def _is_other(key: str, quantity: Quantity | None) -> bool:
    """Return whether a key is that of an unknown unit of this quantity or of any."""
    patterns = (_OTHER_UNIT_PATTERN, _OTHER_PATTERN_OF.get(quantity))
    return any(pattern is not None and pattern.fullmatch(key) for pattern in patterns)


def _candidates(name: str, quantity: Quantity) -> Iterator[tuple[str, str]]:
    """Yield the parts of a name that are units, each with the rest of the name."""
    for match in _BRACKETS_PATTERN.finditer(name):
        if text := _in_brackets(match, quantity):
            yield text, name[: match.start()] + name[match.end() :]
    left, _, right = map(str.strip, name.partition("/"))
    divided = re.split(r"[\s_]", left)[-1]
    if left and not set(left) & set("([{") and not is_unit(divided) and is_unit(right, quantity):
        yield right, left
    words = re.findall(r"[^\s_,:;.]+", _BRACKETS_PATTERN.sub(" ", name))
    yield from _last_words(words, name, quantity)
    if words and "-" in words[-1]:
        yield from _last_words(words[-1].split("-"), name, quantity)
    if len(words) > 2 and _SUFFIX_PATTERN.fullmatch(words[-1]):
        yield from _last_words(words[:-1], name, quantity)
    if name == "force_n":
        yield "N", "force"
    if "raw" in map(str.casefold, words):
        yield "raw", name


def _last_words(words: list[str], name: str, quantity: Quantity) -> Iterator[tuple[str, str]]:
    """Yield the units that the last words of a name may be, each with the words before it."""
    for count in range(min(4, len(words)), 1, -1):
        may_join = words[-count].casefold() in ("milli", "micro", "g")
        for joint in ("_", "/"):
            text = joint.join(words[-count:])
            if (may_join or "/" in _key(text)) and (unit_of(text, quantity) or (joint == "_" and is_unit(text))):
                yield text, " ".join(words[:-count])
    if words:
        text, rest = words[-1], " ".join(words[:-1])
        # A short word is a unit of another quantity by chance: x_cm is the centre of mass. `16 g` is a value.
        known = unit_of(text, quantity) is not None or _is_other(_key(text), quantity) or "/" in text
        spelt = is_unit(text, quantity) or (text == "G" and (name.isupper() or words[-2:-1] == ["in"]))
        named = any(map(str.isalpha, rest)) or (rest == "" and (text != "V" or quantity != "speed"))
        if known and spelt and named and text != "in":
            yield text, rest


@lru_cache(maxsize=4096)
def _key(text: str) -> str:
    """Return one spelling of a unit: in lower case, without brackets, blanks and signs of powers and products.

    The letter \u00e2 is left out, too: it is a part of a `\u00b2` or `\u00b5` in UTF-8 that was read as Latin-1.
    """
    text = unicodedata.normalize("NFKC", text).casefold().strip()
    text = text.replace("\u2212", "-").replace("\u2215", "/").replace("\u03bc", "u")
    text = re.sub(r"^in\s|[\s()\[\]{}\u00b7\u22c5*^._$\u00e2]|-(?=[a-z])", "", text)
    for pattern, symbol in _SPELLING_PATTERNS:
        text = re.sub(pattern, symbol, text)
    return text


_UNIT_OF_KEY: Final = {quantity: {_key(unit): unit for unit in units} for quantity, units in UNITS_OF.items()}
"""For each quantity, its units by their keys."""
