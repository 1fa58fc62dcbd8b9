"""JSON Schema of the configuration, for editors that complete and check YAML."""

from typing import cast

from hapticd.base.yaml_source import Json
from hapticd.config.configuration import Config

SCHEMA_DIALECT = "https://json-schema.org/draft/2020-12/schema"
"""Version of JSON Schema."""

# The longest endings come first: `_n_s_per_m` ends in `_m` too.
_UNIT_OF_SUFFIX = {
    "_m_per_s2_per_n": "m/s^2/N",
    "_hz_s_per_m": "Hz s/m",
    "_m2_per_s4": "m^2/s^4",
    "_n_s_per_m": "N s/m",
    "_rad_per_s": "rad/s",
    "_m_per_s2": "m/s^2",
    "_hz_per_n": "Hz/N",
    "_m_per_s": "m/s",
    "_n_per_m": "N/m",
    "_per_m": "1/m",
    "_per_n": "1/N",
    "_per_s": "1/s",
    "_rad": "rad",
    "_hz": "Hz",
    "_us": "us",
    "_kg": "kg",
    "_m": "m",
    "_n": "N",
    "_s": "s",
}


def unit_of(key: str) -> str | None:
    """Return the unit of a key by its ending: `N/m` for `stiffness_n_per_m`; None if it names no unit."""
    return next((unit for ending, unit in _UNIT_OF_SUFFIX.items() if key.endswith(ending)), None)


def unit_suffix_of(key: str) -> str:
    """Return the ending of a key that names its unit: `_n_per_m` of `stiffness_n_per_m`; else an empty text."""
    return next((ending for ending in _UNIT_OF_SUFFIX if key.endswith(ending)), "")


def closed(schema: Json) -> Json:
    """Return a JSON Schema whose mappings allow only keys that match their pattern; pydantic's also allows others."""
    if isinstance(schema, list):
        return [closed(each) for each in schema]
    if not isinstance(schema, dict):
        return schema
    inner = {key: closed(value) for key, value in schema.items()}
    return {**inner, "additionalProperties": False} if isinstance(inner.get("patternProperties"), dict) else inner


def config_schema() -> dict[str, Json]:
    """Return the JSON Schema of a configuration file, with descriptions, units, limits and defaults."""
    schema = cast(dict[str, Json], closed(cast(Json, Config.model_json_schema())))
    schema = {"$schema": SCHEMA_DIALECT, **schema, "title": "hapticd configuration"}
    definitions = schema["$defs"]
    assert isinstance(definitions, dict)
    for definition in (schema, *definitions.values()):
        assert isinstance(definition, dict)
        properties = definition["properties"]
        assert isinstance(properties, dict)
        for key, described in properties.items():
            assert isinstance(described, dict)
            described["title"] = key
            unit = unit_of(key)
            if unit:
                described["description"] = f"{described['description']} In {unit}."
    return schema
