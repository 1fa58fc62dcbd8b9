"""The schema of a method and the daemon accept the same random messages."""

from __future__ import annotations

import itertools
import random
import re
from collections import Counter
from collections.abc import Iterator
from typing import Any, Final

import pytest

from hapticd.config.configuration import load_config
from hapticd.daemon.described.documents import openrpc_document
from hapticd.daemon.described.words import RULES_OF_METHOD, VALIDATION_RULES
from hapticd.daemon.engine import Engine
from hapticd.daemon.methods import Methods
from hapticd.daemon.refusal import MethodError
from hapticd.protocol.messages import Code
from tests.support.schema_messages import Values, validator

DOCUMENT: Final[Any] = openrpc_document()
COMPONENTS: Final[Any] = DOCUMENT["components"]["schemas"]
METHODS: Final = [method["name"] for method in DOCUMENT["methods"]]
WALL = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"}
CONFIG = {
    "servo": {"rate_hz": 2000, "realtime": "off"},
    "scene": {
        "objects": {
            "floor": WALL,
            "skin": {
                "kind": "membrane",
                "center_m": [0, 0.03],
                "normal": [0, 1],
                "width_m": 0.02,
                "material": "cellophane",
            },
            "peg": {"kind": "disc", "center_m": [-0.03, 0.02], "radius_m": 0.005, "material": "steel"},
            "pull": {"kind": "spring", "center_m": [0, 0], "stiffness_n_per_m": 50},
        }
    },
}
NAMES = {
    "": ["floor", "skin", "peg", "pull", "wood", "steel", "new"],
    "material": ["wood", "steel", "cellophane"],
    "object": ["floor", "skin", "peg"],
    "objects": ["floor", "skin", "peg", "pull"],
}
# The daemon's problems for each broken rule of x-validation.
PROBLEM_BY_RULE: Final = {
    "length": "must have a direction: a length of at least",
    "patches": r"above from_m|overlap$|overlap;|leave a gap of",
    "rising": r"above the one before|later than",
    "table_size": r"for each (speed|force)",
    "grooves": "width_m must be at most spacing_m",
    "waveform": r"of the samples must be 0|needs a sample that is not 0|must last at most",
    "models": r"is unstable|has an RMS of|different (speed|force)|are both at",
    "provenance": r"must be a date|low <= high",
    "stroke": "from_m and to_m must differ",
    "json": r"must be a JSON value|bytes as JSON|^data\S*: must be finite",
    "known": r"unknown (material|object)|has the id|cannot be removed|is a waveform, which play|neither a tap nor",
    "rate": r"of the rate|servo rate|servo\.rate",
    "reach": r"is beyond the|has no stiffness|cannot be punctured|would last",
    "seq": "must be above .*the last of this stream",
    "files": "restart",
}
MIN_MESSAGES: Final = 100
"""Smallest number of accepted, and of refused, messages of a thousand of a method with parameters."""


def tidy(source: random.Random, value: dict[str, Any]) -> None:
    """Change numbers so that they meet the rules of x-validation."""
    rows = len(value.get("speeds_m_per_s") or ())
    for key in ("speeds_m_per_s", "forces_n"):
        if isinstance(value.get(key), list):
            value[key] = [index + 0.5 for index, _ in enumerate(value[key])]
    for key in ("frequencies_hz", "decay_times_s"):
        if rows and isinstance(value.get(key), list):
            row = value[key][0]
            row = [100.0] * len(value["forces_n"]) if isinstance(row, list) and value.get("forces_n") else row
            value[key] = [row] * rows
    if isinstance(value.get("amplitudes"), list):
        value["amplitudes"] = [[index + 0.5, 10.0] for index, _ in enumerate(value["amplitudes"])]
    if isinstance(value.get("width_m"), float) and isinstance(value.get("spacing_m"), float):
        value["width_m"] = max(1e-6, min(value["width_m"], value["spacing_m"]))
    if "coefficients" in value:
        value["coefficients"] = [0.1]
    if isinstance(value.get("models"), list):
        for index, model in enumerate(value["models"]):
            if isinstance(model, dict):
                model["speed_m_per_s"] = 0.1 * index
                model.update({"rms_m_per_s2": 1.0} if "rms_m_per_s2" in model else {"variance_m2_per_s4": 1.0})
    if isinstance(value.get("samples"), list):
        value["samples"] = [0.0, *([0.5] * source.randint(1, 5)), 0]
        value["rate_hz"] = 1000.0
    if isinstance(value.get("patches"), list):
        for index, patch in enumerate(value["patches"]):
            patch.update(from_m=0.1 * index, to_m=0.1 * index + 0.05)
    for key in ("normal", "direction"):
        if isinstance(value.get(key), list):
            value[key] = [0.6, -0.8]
    if isinstance(value.get("waypoints"), list):
        value["waypoints"] = [[0.5 * index, *row[1:]] for index, row in enumerate(value["waypoints"])]
    for key, interval in (value.get("intervals") or {}).items():
        value["intervals"][key] = interval and sorted(interval)
    if {"from_m", "to_m"} <= value.keys() and "kind" in value:
        value.update(from_m=0.0, to_m=0.004, height_m=0.01)
    if "at_m" in value:
        value["at_m"] = 0.0


class Daemon:
    """The daemon's methods on a running engine; after a message that changed the scene, the scene is restored."""

    def __init__(self) -> None:
        self.config = load_config(CONFIG)
        self.engine = Engine(self.config)
        self.methods = Methods(self.engine, lambda: (self.config, ""), read_state=lambda: {"position_m": [0.0, 0.0]})
        self._streamed = itertools.count(1)

    def put_back(self) -> None:
        if self.engine.scene is not self.config.scene or self.engine.materials is not self.config.materials:
            self.engine.take(self.config.scene, self.config.materials)

    def refusal(self, method: str, params: dict[str, object]) -> list[str] | None:
        """Return the problems of params; None if they are valid, even if the request failed."""
        try:
            if method.startswith("stream_"):
                self.methods.stream(method, params, next(self._streamed))
            else:
                self.methods.call(method, params)
        except MethodError as error:
            assert error.code != Code.INTERNAL or method == "dump_flight", error.message
            if error.code == Code.INVALID_PARAMS:
                problems: Any = error.data
                return [f"{each['where']}: {each['problem']}" for each in problems]
        return None


@pytest.fixture(scope="module")
def daemon() -> Iterator[Daemon]:
    daemon = Daemon()
    daemon.engine.start()
    yield daemon
    daemon.engine.stop()


def merged(before: Any, patch: Any) -> Any:
    """Return a merge patch applied to a value, as in section 2 of RFC 7396."""
    if not isinstance(patch, dict):
        return patch
    result = dict(before) if isinstance(before, dict) else {}
    for key, value in patch.items():
        if value is None:
            result.pop(key, None)
        else:
            result[key] = merged(result.get(key), value)
    return result


OBJECT = validator(next(iter(COMPONENTS["Scene"]["properties"]["objects"]["patternProperties"].values())), COMPONENTS)
MATERIAL = validator({"$ref": "#/components/schemas/Material"}, COMPONENTS)


def merges_well(daemon: Daemon, method: str, params: dict[str, Any]) -> bool:
    """Return whether the patched objects or materials match their schema."""
    is_scene = method == "update_scene"
    before: Any = daemon.engine.scene.objects if is_scene else daemon.engine.materials
    check = OBJECT if is_scene else MATERIAL
    patches = params["objects" if is_scene else "materials"]
    return all(
        patch is None or check.is_valid(merged(before[name].to_dict() if name in before else None, patch))
        for name, patch in patches.items()
    )


def compare(daemon: Daemon, method: str, count: int) -> Counter[str]:
    (described,) = [each for each in DOCUMENT["methods"] if each["name"] == method]
    check = validator(described["x-params"], COMPONENTS)
    values = Values(method, COMPONENTS, NAMES, tidy)
    rules = [re.compile(PROBLEM_BY_RULE[rule]) for rule in RULES_OF_METHOD.get(method, ()) if rule != "merged"]
    found = Counter[str]()
    for number in itertools.count():
        if found.total() == count:
            break
        daemon.put_back()
        params = values.of(described["x-params"])
        for _ in range(number % 3):
            params = values.nearly(params)
        if not isinstance(params, dict):
            continue
        if type(params.get("expect_revision")) is int and 0 <= params["expect_revision"] < 2**32:
            params["expect_revision"] = daemon.engine.revision  # a stale one is refused before the rest is validated
        is_valid = check.is_valid(params)
        patches_are_sound = not is_valid or not method.startswith("update_") or merges_well(daemon, method, params)
        faults = daemon.refusal(method, params)
        by_rule = bool(faults) and all(any(rule.search(fault) for rule in rules) for fault in faults or ())
        seen = f"{params!r}\nschema: {[*check.iter_errors(params)][:2] if not is_valid else 'valid'}\ndaemon: {faults}"
        if not is_valid:
            assert faults is not None, f"refused by the schema, taken by the daemon: {seen}"
            found["refused by the schema"] += 1
        elif not patches_are_sound:
            assert faults is not None, f"makes what is not valid, taken by the daemon: {seen}"
            found["refused for what a patch makes"] += 1
        elif faults is None:
            found["taken"] += 1
        else:
            assert by_rule, f"valid by the schema, refused for no rule of x-validation: {seen}"
            found["refused by a rule"] += 1
    return found


@pytest.mark.long
@pytest.mark.parametrize("method", METHODS)
def test_a_thousand_random_messages_in_all(daemon: Daemon, method: str) -> None:
    compare(daemon, method, -(-1000 // len(METHODS)))


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_a_thousand_random_messages_each(daemon: Daemon, method: str) -> None:
    found = compare(daemon, method, 1000)
    refused = found.total() - found["taken"]
    assert found["taken"] >= MIN_MESSAGES, found
    assert refused >= MIN_MESSAGES, found


def test_every_rule_is_told_and_known() -> None:
    applied = {rule for rules in RULES_OF_METHOD.values() for rule in rules}
    assert {*PROBLEM_BY_RULE, "merged"} == VALIDATION_RULES.keys() == applied
