"""Random values of a JSON Schema (draft 7), and values that are nearly of it: for tests of what a schema describes.

A value follows the members and limits of the schema. Conditions beside the members of an object (`allOf`, `if`, ...)
are met by trying; `tidy` brings numbers into the relations that a schema cannot say, most of the time.
"""

from __future__ import annotations

import copy
import math
import random
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

from jsonschema import Draft7Validator, validators

_CONDITIONS: Final = ("allOf", "anyOf", "oneOf", "not", "if", "then", "else")
_LONG: Final = 4
"""Lists have no more entries than this, if they need not."""


def _is_number(_: object, value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_integer(_: object, value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


# As `info.description` of the document says: an integer is msgpack's, a number is finite, bytes are no string.
_Validator: Final = validators.extend(
    Draft7Validator,
    type_checker=Draft7Validator.TYPE_CHECKER.redefine("number", _is_number).redefine("integer", _is_integer),
)


def validator(schema: Mapping[str, Any], components: Mapping[str, Any]) -> Draft7Validator:
    """Of a schema that refers to `#/components/schemas`."""
    return _Validator(_ecma({**schema, "components": {"schemas": components}}))


def _ecma(tree: Any) -> Any:
    r"""Patterns as ECMA 262 means them: Python's `$` also stands before a line break at the end, `\Z` does not."""
    if isinstance(tree, list):
        return [_ecma(each) for each in tree]
    if isinstance(tree, str):
        return tree[:-1] + r"\Z" if tree.startswith("^") and tree.endswith("$") else tree
    return {_ecma(key): _ecma(value) for key, value in tree.items()} if isinstance(tree, dict) else tree


class Values:
    """Makes values."""

    def __init__(
        self,
        seed: object,
        components: Mapping[str, Any],
        names: Mapping[str, list[str]],
        tidy: Callable[[random.Random, dict[str, Any]], None],
    ) -> None:
        """`names`: known strings by the key that holds them; "" for the keys of mappings by names."""
        self.source = random.Random(repr(seed))
        self._components, self._names, self._tidy = components, names, tidy
        self._conditions: dict[int, tuple[Mapping[str, Any], Draft7Validator]] = {}

    def of(self, schema: Mapping[str, Any], key: str = "") -> Any:
        """A value, valid but for relations that only `tidy` knows."""
        source = self.source
        if "$ref" in schema:
            return self.of(self._components[schema["$ref"].rpartition("/")[2]], key)
        if "const" in schema:
            return schema["const"]
        if "enum" in schema:
            return source.choice(schema["enum"])
        if "properties" in schema or schema.get("type") == "object":
            return self._object(schema)
        for options in ("anyOf", "oneOf", "allOf"):
            if options in schema:
                return self.of(source.choice(schema[options]), key)
        match schema.get("type"):
            case "array":
                return self._array(schema, key)
            case "number":
                return self._number(schema)
            case "integer":
                low, high = schema.get("minimum", -1000), schema.get("maximum", 1000)
                return source.choice((low, high, min(max(source.randrange(50), low), high)))
            case "boolean":
                return source.random() < 0.5
            case "string":
                return self._string(schema, key)
            case "null":
                return None
        return source.choice((None, True, 1.5, "text", [1, "a"], {"b": [None]}))

    def _number(self, schema: Mapping[str, Any]) -> float:
        source = self.source
        low, high = float(schema.get("minimum", -1e6)), float(schema.get("maximum", 1e6))
        if low > 0:
            between = math.exp(source.uniform(math.log(low), math.log(high)))
        else:
            between = source.choice((source.uniform(low, high), min(max(10 ** source.uniform(-4, 3), low), high)))
        value = source.choice((low, high, between, between, between, between))
        return (
            min(max(value, low), high) if source.random() < 0.9 else int(min(max(round(between), math.ceil(low)), high))
        )

    def _string(self, schema: Mapping[str, Any], key: str) -> str:
        pattern = schema.get("pattern", "")
        if key in self._names:
            return self.source.choice(self._names[key])
        if "[0-9a-f]" in pattern:
            return "0a" * 32
        if "[0-9]" in pattern:
            return self.source.choice(("2026-01-31", "2024-02-29", "2026-01-01"))
        least, most = schema.get("minLength", 0), schema.get("maxLength", 20)
        return "é" * self.source.choice((least, min(most, 3 + least), most))

    def _array(self, schema: Mapping[str, Any], key: str) -> list[Any]:
        items = schema.get("items", {})
        if isinstance(items, list):
            return [self.of(each) for each in items]
        least, most = schema.get("minItems", 0), schema.get("maxItems", _LONG)
        return [self.of(items, key) for _ in range(self.source.randint(least, max(least, min(most, _LONG))))]

    def _object(self, schema: Mapping[str, Any]) -> dict[str, Any]:
        value: dict[str, Any] = {}
        properties, required = schema.get("properties", {}), schema.get("required", ())
        conditions = {key: each for key, each in schema.items() if key in _CONDITIONS}
        check = self._check(schema, {**conditions, "required": list(required)})
        for attempt in range(60):
            if attempt % 10 == 0:
                every = {key: self.of(each, key) for key, each in properties.items()}
            share = self.source.random()
            value = {key: each for key, each in every.items() if key in required or self.source.random() < share}
            self._choose(value, every, conditions.get("allOf", [conditions]))
            if not conditions or check.is_valid(value):
                break
        for each in schema.get("patternProperties", {}).values():
            known = self._names.get("", ["name"])
            value |= {self.source.choice(known): self.of(each) for _ in range(self.source.randint(0, 3))}
        if self.source.random() < 0.9:
            self._tidy(self.source, value)
        return value

    def _choose(self, value: dict[str, Any], every: Mapping[str, Any], conditions: list[Any]) -> None:
        """Meets conditions of exactly one, most of the time: takes one and leaves out the others."""
        for condition in conditions:
            if "oneOf" not in condition:
                continue
            for part in self.source.choice(condition["oneOf"]).get("allOf", ()):
                for key, each in part.get("properties", {}).items():
                    if each == {"type": "null"}:
                        value.pop(key, None)
                    elif key in every:
                        value[key] = every[key]

    def _check(self, schema: Mapping[str, Any], conditions: Mapping[str, Any]) -> Draft7Validator:
        if id(schema) not in self._conditions:
            # The schema is kept, too: nothing else gets its id.
            self._conditions[id(schema)] = schema, _Validator(_ecma(conditions))
        return self._conditions[id(schema)][1]

    def nearly(self, value: Any) -> Any:
        """A copy of a value with one thing changed, which may leave it valid."""
        changed = copy.deepcopy({"root": value})
        holder, key = self.source.choice([*_places(changed)])
        self.source.choice((self._replace, self._replace, self._add, self._remove, self._shift))(holder, key)
        return changed.get("root", {})

    def _replace(self, holder: Any, key: Any) -> None:
        wrong = (
            None,
            True,
            "1",
            "",
            -1,
            0,
            3.0,
            1e300,
            10**30,
            math.nan,
            math.inf,
            b"x",
            [],
            {},
            [1.0],
            {"kind": "wall"},
            "a\n",
        )
        holder[key] = self.source.choice(wrong)

    def _add(self, holder: Any, key: Any) -> None:
        if isinstance(holder[key], dict):
            name = self.source.choice(("unknown", "a.b", "", "x" * 65, "line\n", "kind", "scene", "material"))
            holder[key][name] = self.source.choice((None, 1, "wood", {}))
        elif isinstance(holder[key], list):
            holder[key].append(holder[key][0] if holder[key] else 0)
        else:
            self._replace(holder, key)

    def _remove(self, holder: Any, key: Any) -> None:
        del holder[key]

    def _shift(self, holder: Any, key: Any) -> None:
        value = holder[key]
        if isinstance(value, bool) or not isinstance(value, int | float):
            self._replace(holder, key)
        else:
            holder[key] = self.source.choice((-value, value * 10, math.nextafter(value, math.inf), float(value), 1e-12))


def _places(tree: Any) -> Iterator[tuple[Any, Any]]:
    for key, value in tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ():
        yield tree, key
        yield from _places(value)
