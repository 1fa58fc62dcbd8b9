"""Writer of YAML that yaml_source reads: mappings of scalars on one line, larger ones as a block."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Final

_PLAIN_PATTERN: Final = re.compile("[A-Za-z_][A-Za-z0-9_-]*")
"""Strings that need no quotes in any context."""


def yaml_text(value: Mapping[str, object]) -> str:
    """Return a mapping as YAML text, without a line break at the end."""
    return "\n".join(_block(value, ""))


def _block(mapping: Mapping[str, object], pad: str) -> list[str]:
    lines = []
    for key, value in mapping.items():
        if isinstance(value, dict) and any(isinstance(inner, dict) for inner in value.values()):
            lines += [f"{pad}{flow_text(key)}:", *_block(value, pad + "  ")]
        else:
            lines.append(f"{pad}{flow_text(key)}: {flow_text(value)}")
    return lines


def flow_text(value: object) -> str:
    """Return plain data (scalars, lists, dicts) as YAML on one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{flow_text(key)}: {flow_text(inner)}" for key, inner in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(flow_text, value)) + "]"
    if isinstance(value, str) and _PLAIN_PATTERN.fullmatch(value) and value.lower() not in ("null", "true", "false"):
        return value
    return json.dumps(value, ensure_ascii=False)
