"""Writes the tables of the pages that repeat the code: `make docs-tables`. A test compares the pages with the code.

A table of keys is below the heading of its model in materials.md. Other tables are between the marks
`<!-- NAME: written by make docs-tables -->` and `<!-- end -->`. In tables with explanations only figures are written.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from hapticd.base import codec
from hapticd.base.model import Model
from hapticd.base.yaml_source import Json
from hapticd.config.configuration import Device
from hapticd.config.schema import config_schema, unit_of
from hapticd.daemon import peers, publisher, router
from hapticd.fit import limits as fit_limits
from hapticd.fit.verdict import LOWER_LIMITS, UPPER_LIMITS
from hapticd.protocol import messages

DOCS = Path(__file__).resolve().parent
Schema = dict[str, Json]


# ---- The parts of a page ---------------------------------------------------------------------------------------------


def block(page: str, name: str, rows: Sequence[Sequence[object]], heads: Sequence[str] = ("what", "limit")) -> str:
    """Return the page with `rows` as the table between the marks of `name`."""
    table = "\n".join(f"| {' | '.join(map(str, row))} |" for row in (heads, ["---"] * len(heads), *rows))
    begin, end = f"<!-- {name}: written by make docs-tables -->", "<!-- end -->"
    before, _, rest = page.partition(begin)
    if not rest:
        raise ValueError(f"no {begin}")
    return f"{before}{begin}\n\n{table}\n\n{end}{rest.partition(end)[2]}"


def filled(page: str, name: str, cells: Mapping[int, object]) -> str:
    """Return the page with new cells, by their column, in the row whose first cell begins with `name`."""
    row = re.search(rf"^\| {re.escape(name)}(?=[ ,:]).*\|$", page, flags=re.MULTILINE)
    if row is None:
        raise ValueError(f"no row of {name}")
    written = row[0].split(" | ")
    for column, cell in cells.items():
        written[column] = f"{cell} |" if column == len(written) - 1 else str(cell)
    return page.replace(row[0], " | ".join(written), 1)


# ---- materials.md ----------------------------------------------------------------------------------------------------


def materials(page: str) -> str:
    """Return materials.md with the description and the keys of every model."""
    for name, schema in _models().items():
        present = re.search(rf"^### {name}\n\n.*?\n\n\|.*?\n(?=\n|\Z)", page, flags=re.MULTILINE | re.DOTALL)
        if present is None:
            raise ValueError(f"no ### {name} with a description and a table")
        written = f"### {name}\n\n{schema['description']}\n\n{_keys(name, schema)}\n"
        # Links are only in the page: text that differs in nothing else stays.
        if re.sub(r"\[([^]]+)\]\([^)]+\)", r"\1", present[0]) != written:
            page = page.replace(present[0], written)
    return page


def _map(value: Json) -> Schema:
    assert isinstance(value, dict)
    return value


def _models() -> dict[str, Schema]:
    return {name: _map(schema) for name, schema in _map(config_schema()["$defs"]).items()}


def _without_null(schema: Schema) -> Schema:
    """Return the schema of a property without its option null."""
    options = schema.get("anyOf")
    if isinstance(options, list):
        return _map(next(option for option in options if _map(option).get("type") != "null"))
    return schema


def _number(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:.15g}"


def _limits(schema: Schema) -> str:
    items = schema.get("prefixItems")
    options = schema.get("enum", [schema["const"]] if "const" in schema else None)
    if isinstance(items, list):
        length = {2: "two", 3: "three"}[len(items)]
        return f"{length} numbers, {' and '.join(dict.fromkeys(_limits(_map(item)) for item in items))}"
    if isinstance(options, list):
        return ", ".join(f"`{option}`" for option in options)
    match schema:
        case {"type": "boolean"}:
            return "`true`, `false`"
        case {"minimum": int() | float() as low, "maximum": int() | float() as high}:
            return f"{_number(low)} to {_number(high)}" + (", integer" if schema["type"] == "integer" else "")
        case {"items": {"prefixItems": list()} as item, "minItems": int() as low, "maxItems": int() as high}:
            return f"{low} to {high} pairs, {_limits(_map(item)).removeprefix('two numbers, ')}"
        case {"pattern": "^[0-9a-f]{64}$"}:
            return "64 hex digits"
        case {"pattern": "^[0-9]{4}-[0-9]{2}-[0-9]{2}$"}:
            return "a day, such as 2026-01-31"
        case {"items": {"$ref": str()} as item, "maxItems": int() as high}:
            return f"a list, {_limits(_map(item))}, at most {high}"
        case {"items": {"type": "array"} as item, "minItems": int() as low, "maxItems": int() as high}:
            return f"{low} to {high} lists of {_limits(_map(item))}"
        case {"items": {"type": "number"} as item, "minItems": int() as low, "maxItems": int() as high}:
            return f"{low} to {high} numbers, {_limits(_map(item))}"
        case {"oneOf": list() as members}:
            return "see " + ", ".join(_limits(_map(member)).removeprefix("see ") for member in members)
        case {"items": {"enum": list() as options}}:
            return "a list of " + ", ".join(f"`{option}`" for option in options)
        case {"items": {"minLength": 1}, "maxItems": int() as high} | {"maxProperties": int() as high}:
            return f"at most {high} entries"
        case {"items": {"type": "string"}, "maxItems": int() as high}:
            return f"a list of reports in hex, at most {high}"
        case {"$ref": str() as reference}:
            return f"see {reference.rpartition('/')[2]}"
        case {"maxLength": int() as high}:
            return f"text, at most {high} characters"
    raise AssertionError(schema)


def _default(model: type[Model], key: str) -> str:
    field = model.model_fields[key]
    if field.is_required():
        return "required"
    if key == "effective_mass_kg":
        return f"handle and hand, {Device().effective_mass_kg:.15g}"
    if key == "undisplayable":
        return f"`{Device().undisplayable}`; of a real joystick `{Device(kind='hid').undisplayable}`"
    value: object = field.default
    match value:
        case None:
            return "none"
        case Model() | dict():
            return ""
        case bool():
            return f"`{str(value).lower()}`"
        case int() | float():
            return f"{value:.15g}"
        case ():
            return "none"
        case tuple():
            return f"[{', '.join(f'{number:.15g}' for number in value)}]"
    return f"`{value}`"


def _keys(name: str, schema: Schema) -> str:
    rows = ["| key | unit | limits | default | meaning |", "| --- | --- | --- | --- | --- |"]
    for key, described in _map(schema["properties"]).items():
        described = _map(described)
        meaning = Model.by_name[name].model_fields[key].description or "Kind of the object."
        options = described.get("allOf")
        limits = _limits(_map(options[0]) if isinstance(options, list) else _without_null(described))
        default = _default(Model.by_name[name], key)
        rows.append(f"| `{key}` | {unit_of(key) or ''} | {limits} | {default} | {meaning} |")
    return "\n".join(rows)


# ---- Other pages -----------------------------------------------------------------------------------------------------


FIT_LIMITS = {
    "preparation": fit_limits.PREPARATION_LIMITS,
    "taps": fit_limits.TAP_LIMITS,
    "speed law": fit_limits.SPEED_LAW_LIMITS,
    "pulses": fit_limits.WAVEFORM_LIMITS,
    "ringing": fit_limits.RINGING_LIMITS,
    "spectral lines": fit_limits.LINE_LIMITS,
    "grooves": fit_limits.GROOVE_LIMITS,
    "textures": fit_limits.TEXTURE_LIMITS,
    "punctures": fit_limits.PUNCTURE_LIMITS,
}


def fit(page: str) -> str:
    """Return reference/fit_limits.md with the thresholds of all fits, and the limits of the verdicts."""
    for name, values in FIT_LIMITS.items():
        rows = [
            (f"`{each.name}`", f"{getattr(values, each.name):.6g}", each.metadata["unit"], each.metadata["reason"])
            for each in dataclasses.fields(values)
        ]
        page = block(page, f"thresholds of {name}", rows, ("threshold", "value", "unit", "reason"))
    for name, bound in {**LOWER_LIMITS, **UPPER_LIMITS}.items():
        page = filled(page, name, {2: f"{bound.fair:g}", 3: f"{bound.poor:g}"})
    return page


def protocol(page: str) -> str:
    """Return protocol.md with the limits of connections and messages, and the version of the protocol."""
    mib = 2**20
    page = block(
        page,
        "connections",
        [
            (
                "connections of one process to a socket",
                f"{router.COMMAND_SOCKET_LIMITS.process_connections}; a new one is closed",
            ),
            (
                "all connections to a socket",
                f"{router.COMMAND_SOCKET_LIMITS.connections:,}; the user with most connections loses the newest one",
            ),
            ("frames of a message", f"{router.MAX_MESSAGE_FRAMES:,}"),
            (
                "a message, all frames together",
                f"{router.MAX_MESSAGE_BYTES // mib} MiB; "
                f"{publisher.TELEMETRY_SOCKET_LIMITS.message.size // 1024} KiB to the telemetry socket",
            ),
            ("time for the handshake", f"{peers.HANDSHAKE_TIMEOUT_S:g} s"),
            ("subscriptions that match no topic", f"{publisher.MAX_USELESS_SUBSCRIPTIONS:,}"),
            (
                "incomplete messages and unread answers, of all clients together",
                f"{router.COMMAND_SOCKET_LIMITS.buffers // mib} MiB; the connection that holds most is closed",
            ),
            ("data that is not ZMTP 3", "closed at once"),
        ],
    )
    return block(
        page,
        "body",
        [
            ("version of the protocol", messages.PROTOCOL_VERSION),
            ("length", f"{messages.MAX_BODY_BYTES // mib} MiB"),
            ("nesting depth, with the body itself", codec.MAX_DEPTH),
            ("members of a map", f"{messages.MAX_MAP_MEMBERS:,}"),
            ("messages that wait for a slow subscriber", publisher.MAX_QUEUED_MESSAGES),
            ("bytes of these messages", f"{publisher.MAX_QUEUED_BYTES // mib} MiB"),
        ],
    )


PAGES: dict[str, Callable[[str], str]] = {
    "materials.md": materials,
    "reference/fit_limits.md": fit,
    "protocol.md": protocol,
}


if __name__ == "__main__":
    for name, written in PAGES.items():
        text = (DOCS / name).read_text(encoding="utf-8")
        (DOCS / name).write_text(written(text), encoding="utf-8")
