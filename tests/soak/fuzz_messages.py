"""Mutated messages for a real daemon's command socket, as many as asked for: each is answered as the protocol says.

    python -m tests.soak.fuzz_messages [--runs 1000000] [--seed 0]

Messages begin as requests of every method, and are changed in their frames, their bytes, their encoding, their
envelope and their content. They go through several connections, many at once. What the answer has to be follows from
the bytes by a decoder written from msgpack's specification (tests/protocol/test_messages.py), as far as
docs/protocol.md says it: its code for all that is wrong with body and envelope, its id, that a notification has none,
and its members. Of parameters it follows whether they must be refused because one is unknown or missing; scenes are
judged by the daemon alone. Its revision counts what it took. Between messages that must all be refused, scene and
materials stay as they are to the byte.

The tests do a few hundred of the same; `make fuzz` does many. A message that fails is printed in hex.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import socket
import struct
import tempfile
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

import msgpack
import zmq

from tests.protocol.test_messages import Refused, reference
from tests.soak.fuzz_yaml import DEVICES, GESTURES, MATERIALS, OBJECTS, config_tree
from tests.support import fuzzing
from tests.support.daemon_process import Daemon
from tests.support.fuzzing import Tree
from tests.support.processes import memory_kib, scheduled_s

CONNECTIONS: Final = 8
WINDOW: Final = 128
"""Messages under way at once, over all connections."""
QUIET_EVERY: Final = 2
"""Of so many rounds, one has only messages that must be refused or change nothing."""
ROUND: Final = 256
"""Messages from one look at revision, scene and faults to the next."""
BUSY: Final = 0.5
"""Part of a round for which the daemon must have had a processor if its own work is to be why it did not beat."""
ANSWERED_S: Final = 30.0
"""Time for everything under way."""
GROWTH_MB: Final = 40.0
"""Of the daemon's memory, from after the first rounds to the end."""
LONGEST_MESSAGE: Final = 40_000
LONGEST_BODY: Final = 2 * 1024 * 1024
HUGE: Final = 2e-4
"""How many of the messages have hundreds of kilobytes."""

SCENE: Final = {"objects": {"floor": OBJECTS[0], "skin": OBJECTS[4], "peg": OBJECTS[3], "pull": OBJECTS[5]}}

GRAIN: Final = {"peak_hz": 200, "mean_hz": 260, "velocity_gain_per_s": 20, "direction": "normal", "seed": 7}

PARSE, INVALID, NO_METHOD, PARAMS = -32700, -32600, -32601, -32602
CHANGES: Final = frozenset(("set_scene", "update_scene", "set_materials", "update_materials", "apply", "reload"))
PARAMETERS: Final[dict[str, tuple[frozenset[str], frozenset[str]]]] = {
    name: (frozenset(required.split()), frozenset(optional.split()))
    for name, required, optional in (
        ("get_status", "", ""),
        ("get_state", "", ""),
        ("get_config", "", ""),
        ("get_scene", "", ""),
        ("set_scene", "scene", "expect_revision force wait"),
        ("update_scene", "objects", "expect_revision force wait"),
        ("get_materials", "", ""),
        ("set_materials", "materials", "expect_revision wait"),
        ("update_materials", "materials", "expect_revision wait"),
        ("apply", "", "materials scene expect_revision force wait"),
        ("play", "direction amplitude_m_per_s2", "mode material"),
        ("reset", "", "objects"),
        ("mark", "text", "data"),
        ("set_forces", "enabled", ""),
        ("set_operator", "", "waypoints interpolation gesture"),
        ("stream_target", "seq position_m", ""),
        ("stream_force", "seq force_n", ""),
        ("lease", "duration_s", "token"),
        ("reload", "", "expect_revision force wait"),
        ("dump_flight", "", ""),
    )
}
"""What each method must and may be given, as docs/protocol.md has it."""
RESULTS: Final[dict[str, tuple[frozenset[str], frozenset[str]]]] = {
    name: (frozenset(always.split()), frozenset(sometimes.split()))
    for name, always, sometimes in (
        (
            "get_state",
            "tick time_ns position_m velocity_m_per_s contact_force_n vibration_force_n force_n revision flags"
            " lateness_ns work_ns touching flag_names",
            "",
        ),
        ("get_config", "config", ""),
        ("get_scene", "scene revision", "margins"),
        ("set_scene", "revision", "margins tick warning warnings"),
        ("update_scene", "revision", "margins tick warning warnings"),
        ("get_materials", "materials revision", ""),
        ("set_materials", "revision", "margins tick warning warnings"),
        ("update_materials", "revision", "margins tick warning warnings"),
        ("apply", "revision", "margins tick warning warnings"),
        ("play", "tick displayed_hz", "warnings"),
        ("reset", "tick", ""),
        ("mark", "tick", ""),
        ("set_forces", "forces tick", "signs"),
        ("set_operator", "duration_s tick", "warnings"),
        ("stream_target", "", ""),
        ("stream_force", "forces", "warning"),
        ("lease", "token", "warning"),
        ("reload", "revision", "margins tick warning warnings"),
        ("dump_flight", "file", ""),
    )
}
_CHANGED, _FULL, _OFF = (frozenset((-32005, -32006, *more)) for more in ((-32001,), (), (-32003,)))
ERRORS: Final[dict[str, frozenset[int]]] = {
    **dict.fromkeys(CHANGES, _CHANGED),
    **dict.fromkeys(("set_scene", "update_scene", "apply", "reload"), _CHANGED | {-32011}),
    **dict.fromkeys(("get_state", "mark", "reset", "set_operator"), _FULL),
    **dict.fromkeys(("play", "set_forces"), _OFF),
    **dict.fromkeys(("stream_target", "stream_force"), frozenset((-32010,))),
    "lease": frozenset((-32004, -32007)),
}
"""What each method may answer beside INVALID_PARAMS."""


class Failure(AssertionError):
    """What was found, with the message."""


# ---- What a body means -------------------------------------------------------------------------------------------


@dataclass(slots=True)
class Expected:
    """What the answer to a message has to be; `codes` None: none may come, of which 0 is a result."""

    frames: list[bytes]
    delimited: bool
    codes: frozenset[int] | None
    id: Tree = None
    method: str | None = None
    may_change: bool = False
    """Whether it is a change that may be taken."""

    @property
    def late(self) -> bool:
        """Whether answers to later messages may come before its own: a change; the newest sample, which another thread
        tells."""
        return self.method in CHANGES or self.method == "get_state"

    def same_id(self, other: Expected) -> bool:
        """Whether both answers carry the same id."""
        return type(self.id) is type(other.id) and repr(self.id) == repr(other.id)


_ONLY: Final = {code: frozenset((code,)) for code in (PARSE, INVALID, NO_METHOD, PARAMS)}


def _message(body: bytes, plain: bool) -> Tree:
    """What a body says. Where it is plain and cannot be too deep, the library, which is faster, reads it right."""
    if plain and len(body) < 4096 and len(body) - len(body.translate(None, _OPENERS)) <= 32:
        try:
            return msgpack.unpackb(body)
        except UnicodeDecodeError:
            raise Refused from None
    if len(body) > LONGEST_BODY:
        raise Refused
    return reference(body)


_OPENERS: Final = bytes((*range(0x80, 0xA0), *range(0xDC, 0xE0)))
"""The bytes that can open a map or an array."""


def expected(frames: list[bytes], plain: bool = False) -> Expected:
    """What docs/protocol.md says of the answer to these frames; `plain`: the body is known to be well encoded."""
    delimited = len(frames) > 1 and not frames[0]
    if len(frames) != 1 and not (delimited and len(frames) == 2):
        return Expected(frames, delimited, _ONLY[INVALID])
    try:
        message = _message(frames[-1], plain)
    except Refused:
        return Expected(frames, delimited, _ONLY[PARSE])
    if type(message) is not dict:
        return Expected(frames, delimited, _ONLY[INVALID])
    has_id, id = "id" in message, message.get("id")
    legal = id is None or type(id) in (int, str) or (type(id) is float and math.isfinite(id))
    if not legal:
        return Expected(frames, delimited, _ONLY[INVALID])
    method = message.get("method")
    unknown = set(message) - {"jsonrpc", "id", "method", "params"}
    if message.get("jsonrpc") != "2.0" or type(method) is not str or unknown:
        return Expected(frames, delimited, _ONLY[INVALID], id)
    codes, may_change = _codes(method, message.get("params", {}))
    return Expected(frames, delimited, codes if has_id else None, id, method, may_change)


def _codes(method: str, params: Tree) -> tuple[frozenset[int], bool]:
    """What a call may be answered with, and whether it may change the scene."""
    known = PARAMETERS.get(method)
    if type(params) is not dict:
        return _ONLY[PARAMS] if known else frozenset((PARAMS, NO_METHOD)), False
    if known is None:
        return _ONLY[NO_METHOD], False
    required, optional = known
    if not required <= params.keys() or not params.keys() <= required | optional:
        return _ONLY[PARAMS], False
    if method in RESULTS or method == "get_status":
        bad = method in CHANGES and (params.get("expect_revision") == NEVER or _poisoned(method, params))
        return (frozenset((PARAMS, -32001)) if bad else _MAY[method]), method in CHANGES and not bad
    raise AssertionError(method)


NEVER: Final = 0xFFFFFFFF
"""A revision that no daemon of ours reaches."""
POISON: Final = "poison"
POISONS: Final[dict[str, tuple[Tree, ...]]] = {
    "objects": ({"kind": "none"}, {"kind": "disc", "center_m": [0, 0], "radius_m": 0.1, "material": "none"}),
    "materials": ({"stiffness_n_per_m": "none"}, {"tap": {}}, {"stiffness_n_per_m": -1}),
}
"""What is refused under the name POISON, wherever it is looked at: some at once, some after all the others."""


def _poisoned(method: str, params: Tree) -> bool:
    return any(type(held) is dict and held.get(POISON) in POISONS[kind] for kind, held in _held(method, params))


def _held(method: str, params: dict[str, Tree]) -> list[tuple[str, Tree]]:
    """What a change holds by name, with its kind."""
    scene = params.get("scene")
    held = [("objects", scene.get("objects"))] if type(scene) is dict and method in ("set_scene", "apply") else []
    if method == "update_scene":
        held.append(("objects", params.get("objects")))
    if method in ("set_materials", "update_materials", "apply"):
        held.append(("materials", params.get("materials")))
    return held


_MAY: Final = {
    method: frozenset((0,))
    | (frozenset((PARAMS,)) if required or optional else frozenset())
    | ERRORS.get(method, frozenset())
    for method, (required, optional) in PARAMETERS.items()
}


# ---- Messages ----------------------------------------------------------------------------------------------------


class Pairs(list[tuple[Tree, Tree]]):
    """A map by its pairs: keys may be of any type, and twice."""


@cache
def seeds() -> dict[str, list[bytes]]:
    """Packed requests by method: a client's of the first release, and more of every method."""
    path = Path(__file__).parents[1] / "data" / "conversation-1.0.json"
    told = json.loads(path.read_text())
    found: dict[str, list[bytes]] = {}
    for each in (*told["conversation"], *told["errors"]):
        found.setdefault(each["method"], []).append(bytes.fromhex(each["request"]))
    calls: list[tuple[str, Tree]] = [
        ("set_scene", {"scene": SCENE}),
        *(
            ("set_scene", {"scene": {"objects": {"floor": item}}, "wait": number % 4 == 0})
            for number, item in enumerate(OBJECTS)
        ),
        ("set_scene", {"scene": {"objects": {}, "display": {"force": True}, "ramp_s": 0.01, "passivity": "observe"}}),
        *(("update_scene", {"objects": {"floor": item}}) for item in OBJECTS),
        *(("update_scene", {"objects": {"x": item, "peg": {"radius_m": 0.01}, "skin": None}}) for item in OBJECTS),
        *(("update_materials", {"materials": {"mine": item}}) for item in MATERIALS),
        # Used by the scene, so that it is compiled: filters of noise, for example.
        *(("update_scene", {"objects": {id: {"material": "mine"}}}) for id in ("floor", "skin", "peg")),
        (
            "update_scene",
            {"objects": {"floor": OBJECTS[1] | {"material": "mine"}, "x": OBJECTS[2] | {"material": "mine"}}},
        ),
        *(
            ("update_materials", {"materials": {"mine": item, "sandpaper_100": {"texture": GRAIN}}})
            for item in MATERIALS
        ),
        (
            "update_materials",
            {"materials": {"mine": None, "steel": {"tap": {"attack_slope_per_s": 300}}, "comb": None}},
        ),
        *(
            ("set_materials", {"materials": {"mine": item}, "wait": number % 4 == 0})
            for number, item in enumerate(MATERIALS)
        ),
        *(("apply", {"materials": {"mine": item}, "scene": SCENE}) for item in MATERIALS),
        *(("apply", {"scene": {"objects": {"floor": item}}}) for item in OBJECTS),
        ("mark", {"text": "trial 3"}),
        ("mark", {"text": "trial 4", "data": {"condition": [1, 2.5, None, {"left": True}]}}),
        ("play", {"material": "cellophane", "direction": [0, 1], "amplitude_m_per_s2": 3.5}),
        (
            "play",
            {
                "mode": {"angular_frequency_rad_per_s": 900, "decay_rate_per_s": 50},
                "direction": [1, 1],
                "amplitude_m_per_s2": 1,
            },
        ),
        ("reset", {"objects": ["floor", "skin"]}),
        ("set_forces", {"enabled": False}),
        ("set_forces", {"enabled": True}),
        *(("set_operator", item) for item in GESTURES),
        *(("stream_target", {"seq": seq, "position_m": [0.001 * seq, 0.01]}) for seq in (0, 7, 200, 2**40)),
        *(("stream_force", {"seq": seq, "force_n": [0.5, 0.0]}) for seq in (0, 7, 200, 2**63 - 1)),
        ("lease", {"duration_s": 0.05}),
        ("lease", {"duration_s": 0, "token": "me"}),
        ("reload", {}),
        ("reload", {"wait": True, "expect_revision": 1}),
        ("dump_flight", {}),
        ("get_config", {}),
        ("get_scene", {}),
        ("get_materials", {}),
        ("get_status", {}),
        ("get_state", {}),
    ]
    for method, params in calls:
        found.setdefault(method, []).append(
            msgpack.packb({"jsonrpc": "2.0", "id": 1, "method": method, "params": params})
        )
    return found


WEIGHTS: Final = {
    **{"set_scene": 20, "update_scene": 20, "update_materials": 14, "set_materials": 6, "apply": 6},
    **{"play": 12, "set_operator": 10, "mark": 6, "reset": 6, "lease": 6, "set_forces": 5},
    **{"stream_target": 4, "stream_force": 4, "get_scene": 3, "get_config": 3, "no_such": 2},
    **{"get_state": 1, "get_status": 1, "reload": 0.7, "get_materials": 0.5, "dump_flight": 0.05},
}
"""Those whose answer is long or takes long come seldom."""
_METHODS: Final = tuple(WEIGHTS)
_CUMULATIVE: Final = tuple(sum(tuple(WEIGHTS.values())[: place + 1]) for place in range(len(WEIGHTS)))


def request(source: random.Random) -> Tree:
    """A fresh request that is valid, as a tree."""
    method = source.choices(_METHODS, cum_weights=_CUMULATIVE)[0]
    tree: Tree = msgpack.unpackb(source.choice(seeds()[method]))
    return tree


IDS: Final = ("", "x", "\x00", "\u2028", "9" * 300, None, 0, -1, 2**64 - 1, -(2**63), 1.5, -0.0, 1e308, 5e-324)


def mutated(source: random.Random, tree: Tree) -> None:
    """Changes a request's content."""
    choice = source.random()
    params = tree.get("params")
    if choice < 0.75 and type(params) is dict and params:
        for _ in range(source.choice((1, 1, 1, 2, 4))):
            fuzzing.mutate(source, params, lambda: _graft(source))
    elif choice < 0.80:
        tree["id"] = source.choice(IDS) if source.random() < 0.7 else fuzzing.value(source)
    elif choice < 0.88:
        fuzzing.mutate(source, tree, lambda: _graft(source))
    elif choice < 0.91:
        tree["params"] = fuzzing.value(source)
    elif choice < 0.93:
        tree["method"] = source.choice(
            (*_METHODS, "", "Get_status", "__init__", "get_status ", "rpc.discover", "x" * 5000)
        )
    elif choice < 0.96 and type(params) is dict:
        params[source.choice(("expect_revision", "force", "wait", "token", "unknown", "material"))] = fuzzing.value(
            source
        )
    elif choice < 0.98:
        target = params if type(params) is dict and params else tree
        target[source.choice(tuple(target))] = fuzzing.nested(source, source.choice((5, 28, 29, 30, 31, 32, 33, 60)))
    elif choice < 0.985:
        tree["params"] = {f"p{number}": 1 for number in range(source.choice((16, 17, 500)))}
    elif choice < 0.99:
        tree["id"] = source.choice(("a" * 100_000, 2**63, -1))
    else:
        tree["params"] = (
            config_tree(source) if source.random() < 0.5 else {"scene": config_tree(source).get("scene", {})}
        )


def _graft(source: random.Random) -> Tree:
    """A part that is valid, of something else."""
    tree: Tree = source.choice((*OBJECTS, *MATERIALS, *GESTURES, *DEVICES))
    if type(tree) is dict and source.random() < 0.5:
        tree = tree[source.choice(tuple(tree))]
    return msgpack.unpackb(msgpack.packb(tree))


def packed(source: random.Random, tree: Tree, odd: float) -> bytes:
    """msgpack in which each value, with the probability `odd`, is encoded longer than it must be."""
    kind = type(tree)
    long = source.random() < odd
    if kind is dict or kind is Pairs:
        pairs = tuple(tree.items()) if kind is dict else tree
        head = _head(len(pairs), (0x80, 16), (0xDE, 2), (0xDF, 4), long)
        return head + b"".join(packed(source, key, odd) + packed(source, below, odd) for key, below in pairs)
    if kind is list:
        head = _head(len(tree), (0x90, 16), (0xDC, 2), (0xDD, 4), long)
        return head + b"".join(packed(source, below, odd) for below in tree)
    if kind is str and long:
        content: bytes = tree.encode("utf-8", "surrogatepass")
        return b"\xdb" + struct.pack(">I", len(content)) + content
    if kind is int and long and -(2**63) <= tree < 2**63:
        return b"\xd3" + struct.pack(">q", tree)
    if kind is float and long and abs(tree) < 1e38:
        return b"\xca" + struct.pack(">f", tree)
    body: bytes = msgpack.packb(tree, unicode_errors="surrogatepass")
    return body


def _head(count: int, small: tuple[int, int], middle: tuple[int, int], large: tuple[int, int], long: bool) -> bytes:
    if count < small[1] and not long:
        return bytes((small[0] | count,))
    code, size = middle if count < 0x10000 and not long else large
    return bytes((code,)) + count.to_bytes(size, "big")


def _doubled(source: random.Random, tree: Tree) -> Tree:
    """The same with a pair of one map given twice, or under a key that is no string."""
    maps = [(holder, key) for holder, key in fuzzing.places({"root": tree}) if type(holder[key]) is dict]
    holder, key = source.choice(maps)
    pairs = Pairs(holder[key].items())
    if pairs and source.random() < 0.6:
        pairs.insert(source.randrange(len(pairs) + 1), source.choice(pairs))
    else:
        pairs.append((source.choice((1, None, b"kind", 1.5, True, [1])), 1))
    if holder[key] is tree:
        return pairs
    holder[key] = pairs
    return tree


def _torn(source: random.Random, body: bytes) -> bytes:
    """Bytes changed, cut, added, repeated."""
    content = bytearray(body)
    for _ in range(source.choice((1, 1, 2, 5))):
        at = source.randrange(len(content) + 1) if content else 0
        match source.randrange(7):
            case 0 | 1 if at < len(content):
                content[at] ^= 1 << source.randrange(8)
            case 2 if at < len(content):
                content[at] = source.randrange(256)
            case 3:
                del content[at:]
            case 4:
                content += source.choice((b"\xc0", b"\x00", b"\xc1", body[:50], source.randbytes(3)))
            case 5:
                content[at:at] = source.choice(_SPLICES)
            case _:
                del content[at : at + source.randrange(1, 9)]
    return bytes(content)


_SPLICES: Final = (
    *(b"\xc1", b"\xd6\xff\x00\x00\x00\x01", b"\xc7\x00\x01", b"\xd4\x05x"),
    *(b"\xdd\xff\xff\xff\xff", b"\xdf\x7f\xff\xff\xff", b"\xc6\xff\xff\xff\xff", b"\xdb\xff\xff\xff\xff"),
    *(b"\x91" * 40, b"\x81\xa1a" * 40, b"\xa2\xff\xfe", b"\xa3\xed\xa0\x80", b"\xcb\x7f\xf8" + bytes(6)),
)
"""Extensions, sizes that are not there, depth, texts that are no UTF-8, a NaN."""


def body_of(source: random.Random, quiet: bool, huge: bool) -> tuple[bytes, bool]:
    """One body, and whether it is msgpack as anybody writes it. In a quiet round a change is made to be refused."""
    choice = source.random()
    if choice < 0.01:
        return source.randbytes(source.choice((0, 1, 2, 20, 200))), False
    tree = request(source)
    tree["id"] = source.randrange(2**32)
    if choice < 0.06:
        del tree["id"]
    if choice < 0.62:
        mutated(source, tree)
    if huge:
        _enlarge(source, tree)
    if quiet:
        _hush(source, tree)
    if choice > 0.985:
        tree = [tree] * source.choice((1, 2, 50))
    elif choice > 0.95:
        return packed(source, _doubled(source, tree), 0.1), False
    elif choice > 0.90:
        return packed(source, tree, 0.3), False
    body: bytes = msgpack.packb(tree, unicode_errors="surrogatepass")
    return (_torn(source, body), False) if 0.62 < choice < 0.82 else (body, True)


def _hush(source: random.Random, tree: Tree) -> None:
    """Has a change refused: at once by its revision, or only after all of it was looked at."""
    method, params = tree.get("method"), tree.setdefault("params", {})
    if type(method) is not str or method not in CHANGES or type(params) is not dict:
        return
    found = [(kind, held) for kind, held in _held(method, params) if type(held) is dict]
    if not found or source.random() < 0.2:
        params["expect_revision"] = NEVER
    else:
        kind, held = source.choice(found)
        held[POISON] = source.choice(POISONS[kind])


def _enlarge(source: random.Random, tree: Tree) -> None:
    """A body of hundreds of kilobytes to beyond 2 MiB."""
    many = source.choice((1000, 10_000, 60_000))
    tree["params"] = source.choice(
        (
            lambda: {"waypoints": [[0.001 * number, 0, 0] for number in range(many)]},
            lambda: {"objects": {f"o{number}": None for number in range(many)}},
            lambda: {"objects": {f"o{number}": {"kind": "wall"} for number in range(many // 10)}},
            lambda: {"scene": {"objects": {f"o{number}": number for number in range(many)}}},
            lambda: {"materials": {f"m{number}": {"kind": 1} for number in range(many // 10)}},
            lambda: {"objects": ["floor"] * many},
            lambda: {"objects": ["floor"] * 900},
            lambda: {"token": "t" * source.choice((300, 100_000, 2_200_000)), "duration_s": 1},
            lambda: {"x" * source.choice((1000, 2_000_000)): 1},
            lambda: {"scene": [[]] * many},
            lambda: {"scene": {"objects": {"w": OBJECTS[1] | {"patches": OBJECTS[1]["patches"] * (many // 60)}}}},
        )
    )()


def frames_of(source: random.Random, body: bytes) -> list[bytes]:
    """The frames around a body."""
    choice = source.random()
    if choice < 0.72:
        return [body]
    if choice < 0.94:
        return [b"", body]
    return source.choice(
        (
            lambda: [b"", b"", body],
            lambda: [body, body],
            lambda: [body, b""],
            lambda: [b"x", body],
            lambda: [b"", body, b""],
            lambda: [b""],
            lambda: [b"", b""],
            lambda: [b""] * source.choice((3, 4, 100)),
            lambda: [body] * 3,
        )
    )()


def message(source: random.Random, quiet: bool) -> Expected:
    """One message, and what its answer has to be; in a quiet round none that may change the scene."""
    while True:
        body, plain = body_of(source, quiet, source.random() < HUGE)
        frames = frames_of(source, body)
        what = expected(frames, plain and frames[-1] is body)
        if not (quiet and what.may_change):
            return what


# ---- Checking an answer ------------------------------------------------------------------------------------------


def check_answer(what: Expected, frames: list[bytes]) -> tuple[int, Tree]:
    """Its code (0: a result) and its result or error."""
    assert what.codes is not None
    assert len(frames) == (2 if what.delimited else 1), "its envelope is not the message's"
    assert not what.delimited or frames[0] == b""
    answer = msgpack.unpackb(frames[-1])
    assert answer["jsonrpc"] == "2.0"
    id = answer["id"]
    assert type(id) is type(what.id) and repr(id) == repr(what.id), f"its id is {id!r:.80}, not {what.id!r:.80}"
    assert len(answer) == 3, f"members {sorted(answer)}"
    if "result" in answer:
        assert 0 in what.codes, f"answered with a result, expected {sorted(what.codes)}"
        _check_result(what.method or "", answer["result"])
        return 0, answer["result"]
    error = answer["error"]
    code, message = error["code"], error["message"]
    # A change for which there is no room to wait is not looked at.
    if code != -32005 or what.method not in CHANGES:
        assert code in what.codes, f"answered with {code} ({message:.300}), expected {sorted(what.codes)}"
    assert type(message) is str and 0 < len(message) < LONGEST_MESSAGE
    assert message.isprintable(), f"no line: {message!r:.300}"
    _check_data(code, error)
    return code, error


def _check_result(method: str, result: Tree) -> None:
    if method == "get_status":
        assert {"version", "protocol", "faults", "revision", "counters"} <= result.keys()
        return
    always, sometimes = RESULTS[method]
    assert always <= result.keys() <= always | sometimes, f"members {sorted(result)}"
    for name in ("revision", "tick"):
        assert type(result.get(name, 0)) is int
    duration = result.get("duration_s", 0.0)
    assert math.isfinite(duration) and duration >= 0


def _check_data(code: int, error: Tree) -> None:
    data = error.get("data")
    if code in (PARAMS, -32011) and data is not None:
        assert type(data) is list and data
        for fault in data:
            assert fault.keys() == {"where", "problem"}
            assert fault["problem"] and fault["problem"].isprintable(), repr(fault)
            assert fault["where"].isprintable(), repr(fault)
    elif code == -32001:
        assert type(data["revision"]) is int
    elif code in (-32003, -32007):
        assert data is None or type(data["faults"]) is list
    elif code == -32004:
        assert data["lease_s"] >= 0
    elif code == -32010:
        assert 0 < data["free_s"] <= 0.02
    else:
        assert data is None


# ---- Connections -------------------------------------------------------------------------------------------------


class Traffic:
    """Connections to one daemon, with many messages under way."""

    def __init__(self, directory: Path) -> None:
        self._endpoint = f"ipc://{directory}/hapticd.command"
        self._path = str(directory / "hapticd.command")
        self.context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._poller = zmq.Poller()
        self._sockets = [self._connect() for _ in range(CONNECTIONS)]
        self._under_way: list[deque[Expected]] = [deque() for _ in self._sockets]
        self._count = 0
        self._next = 0
        self.outcomes: Counter[int] = Counter()
        self.revisions: list[int] = []
        self.notified = 0
        """Changes that were sent as notifications since they were last looked at."""
        self.leased = False

    def _connect(self) -> zmq.Socket[bytes]:
        made = self.context.socket(zmq.DEALER)
        made.setsockopt(zmq.LINGER, 0)
        made.setsockopt(zmq.SNDTIMEO, int(1e3 * ANSWERED_S))
        made.connect(self._endpoint)
        self._poller.register(made, zmq.POLLIN)
        return made

    def close(self) -> None:
        self.context.destroy(0)

    def send(self, what: Expected) -> None:
        """Sends a message, and waits for answers where many are under way."""
        place = self._place_for(what)
        self._next = (place + 1) % CONNECTIONS
        self._sockets[place].send_multipart(what.frames)
        self.leased = self.leased or what.method == "lease"
        if what.codes is None:
            self.notified += what.may_change
            self.outcomes[1] += 1
            return
        self._under_way[place].append(what)
        self._count += 1
        while self._count >= WINDOW:
            self._receive()

    def _place_for(self, what: Expected) -> int:
        """The next connection on which its answer and those to others can be told apart.

        By their id, or by their order where none of the same id may be late. Ids repeat: what is wrong has none.
        """
        while True:
            for step in range(CONNECTIONS):
                place = (self._next + step) % CONNECTIONS
                others = self._under_way[place]
                if not any((what.late or other.late) and what.same_id(other) for other in others):
                    return place
            self._receive()

    def _receive(self) -> None:
        ready = dict(self._poller.poll(int(1e3 * ANSWERED_S)))
        if not ready:
            waiting = [queue[0].frames for queue in self._under_way if queue]
            raise Failure(f"not answered within {ANSWERED_S:g} s: {_hex(waiting[0])}")
        for place, each in enumerate(self._sockets):
            if each not in ready:
                continue
            while True:
                try:
                    frames = each.recv_multipart(zmq.NOBLOCK)
                except zmq.Again:
                    break
                self._take(place, frames)

    def _take(self, place: int, frames: list[bytes]) -> None:
        if not self._under_way[place]:
            raise Failure(f"an answer to nothing: {frames[-1][:200]!r}")
        what = self._asked_by(place, frames)
        self._count -= 1
        try:
            code, content = check_answer(what, frames)
        except (AssertionError, KeyError, TypeError, ValueError) as error:
            raise Failure(
                f"{type(error).__name__}: {error}; answer {frames[-1][:500]!r} to {_hex(what.frames)}"
            ) from error
        self.outcomes[code] += 1
        if what.method in CHANGES and code == 0:
            self.revisions.append(content["revision"])

    def _asked_by(self, place: int, frames: list[bytes]) -> Expected:
        """What an answer is to: the oldest of its id. Long changes, and those that wait for them, are answered late."""
        queue = self._under_way[place]
        with suppress(ValueError, TypeError, KeyError):
            id = msgpack.unpackb(frames[-1])["id"]
            for what in queue:
                if type(what.id) is type(id) and repr(what.id) == repr(id):
                    queue.remove(what)
                    return what
        return queue.popleft()

    def settle(self) -> None:
        """Waits for all answers; a sentinel on each connection shows that there is not one too many."""
        sentinel = msgpack.packb({"jsonrpc": "2.0", "id": "sentinel", "method": "no_such"})
        for _ in self._sockets:
            self.send(expected([sentinel]))
        while self._count:
            self._receive()

    def ask(self, method: str, params: Tree = None) -> Tree:
        """The result of one call, while nothing else is under way."""
        assert not self._count
        body = {"jsonrpc": "2.0", "id": method, "method": method, "params": params or {}}
        return self._asked(msgpack.packb(body))

    def asked_bytes(self, method: str) -> bytes:
        """The whole answer, as it came."""
        asked = self._sockets[0]
        asked.send(msgpack.packb({"jsonrpc": "2.0", "id": 0, "method": method}))
        assert asked.poll(int(1e3 * ANSWERED_S))
        return asked.recv()

    def turn_forces_on(self) -> None:
        """Clears every fault. A lease that lapses while this is taken is over when it is asked once more."""
        assert not self._count
        body = msgpack.packb({"jsonrpc": "2.0", "id": "on", "method": "set_forces", "params": {"enabled": True}})
        error = self._answered(body).get("error")
        if error is not None:
            assert error["data"] == {"faults": ["lease"]}, error
            self._asked(body)

    def _asked(self, body: bytes) -> Tree:
        answer = self._answered(body)
        assert "result" in answer, answer
        return answer["result"]

    def _answered(self, body: bytes) -> Tree:
        asked = self._sockets[0]
        asked.send(body)
        if not asked.poll(int(1e3 * ANSWERED_S)):
            raise Failure(f"not answered within {ANSWERED_S:g} s: {body!r}")
        return msgpack.unpackb(asked.recv())

    def vanish(self, source: random.Random) -> None:
        """A client that sends and is gone, and one that does not speak ZeroMQ."""
        with self.context.socket(zmq.DEALER) as gone:
            gone.setsockopt(zmq.LINGER, 0)
            gone.connect(self._endpoint)
            for _ in range(5):
                gone.send_multipart(message(source, True).frames)
            if source.random() < 0.5:
                gone.poll(1000)
        with socket.socket(socket.AF_UNIX) as stranger:
            stranger.connect(self._path)
            greeting = b"\xff\0\0\0\0\0\0\0\x01\x7f\x03\x00NULL"
            stranger.sendall(greeting[: source.randrange(16)] + source.randbytes(source.choice((0, 1, 64, 5000))))


def _hex(frames: list[bytes]) -> str:
    told = [frame.hex() if len(frame) < 3000 else f"{frame[:1000].hex()}... ({len(frame)} bytes)" for frame in frames]
    return f"{told[:5]} ({len(frames)} frames)"


# ---- A run -------------------------------------------------------------------------------------------------------


@dataclass(slots=True)
class Found:
    """What came of many messages."""

    outcomes: Counter[int]
    seconds: float = 0.0
    grown_mb: float = 0.0
    processor_s: float = 0.0
    """The daemon's."""
    worst_round_s: float = 0.0
    changes: int = 0
    stalls: int = 0
    """Rounds in which the machine did not let the daemon run for a second."""


class Book:
    """What the scene has to be after a round, by what was answered."""

    def __init__(self, traffic: Traffic, process: int) -> None:
        self._traffic = traffic
        self._revision = 0
        self._bytes: tuple[bytes, ...] = ()
        self._process = process
        self._looked_s, self._used_s = time.monotonic(), scheduled_s(process)[0]
        self.changes = 0
        self.stalls = 0
        self.look(None)

    def look(self, quiet: bool | None) -> None:
        """Compares revision, scene, materials and faults; of a quiet round none but the messages' own may be others."""
        traffic = self._traffic
        told = traffic.asked_bytes("get_scene"), traffic.asked_bytes("get_materials")
        revision: int = msgpack.unpackb(told[0])["result"]["revision"]
        assert msgpack.unpackb(told[1])["result"]["revision"] == revision
        if quiet is not None:
            # A reload that changes nothing answers with the revision that there was.
            taken = sorted(set(traffic.revisions) - {self._revision})
            assert all(self._revision < each <= revision for each in taken), (self._revision, taken, revision)
            assert len(taken) <= revision - self._revision <= len(taken) + traffic.notified, (
                f"revision {self._revision} became {revision}: {len(taken)} changes answered, {traffic.notified} not"
            )
            if quiet:
                assert not traffic.revisions and not traffic.notified
            if revision == self._revision:
                assert told == self._bytes, "the scene changed though nothing was taken"
            self.changes += revision - self._revision
        traffic.revisions.clear()
        traffic.notified = 0
        self._revision, self._bytes = revision, told
        faults = set(traffic.ask("get_status")["faults"])
        now_s, used_s = time.monotonic(), scheduled_s(self._process)[0]
        busy = (used_s - self._used_s) / max(now_s - self._looked_s, 1e-9)
        self._looked_s, self._used_s = now_s, used_s
        if "control" in faults and busy < BUSY:
            # The machine did not let it run.
            self.stalls += 1
            faults.remove("control")
            traffic.turn_forces_on()
        assert faults <= ({"lease"} if traffic.leased else set()), f"{faults}, busy for {busy:.2f} of the time"


@contextmanager
def fuzzed_daemon() -> Iterator[Daemon]:
    """A daemon with a configuration that can be reloaded, and a flight recorder that keeps one file."""
    with tempfile.TemporaryDirectory(prefix="hapticd-test-") as parent:
        config = Path(parent) / "c.yaml"
        config.write_text(
            f"servo: {{realtime: off, rate_hz: 2000}}\nflight: {{keep: 1, seconds: 1}}\nscene: {json.dumps(SCENE)}\n"
        )
        daemon = Daemon(Path(parent) / "run", "-c", str(config))
        try:
            daemon.wait_ready()
            yield daemon
        finally:
            if daemon.process.poll() is None:
                code = daemon.stop()
                assert code == 0, f"exit code {code}: {daemon.said()[-5000:]}"
        check_log(daemon.said())


def check_log(text: str) -> None:
    """No traceback, nothing that failed."""
    at = max(text.find("Traceback"), text.find(" failed\n"))
    assert at < 0, text[max(0, at - 500) : at + 3000]


def run(source: random.Random, runs: int, progress: Callable[[str], None] = lambda _: None) -> Found:
    """So many messages to a daemon of its own. Raises AssertionError with the message that did not go well."""
    found = Found(Counter())
    with fuzzed_daemon() as daemon:
        traffic = Traffic(daemon.directory)
        found.outcomes = traffic.outcomes
        try:
            book = Book(traffic, daemon.process.pid)
            began, first_s = time.monotonic(), scheduled_s(daemon.process.pid)[0]
            memory: float | None = None
            sent, rounds = 0, 0
            while sent < runs:
                quiet = rounds % QUIET_EVERY == 1
                started = time.monotonic()
                for _ in range(min(ROUND, runs - sent)):
                    traffic.send(message(source, quiet))
                    sent += 1
                traffic.settle()
                book.look(quiet)
                found.worst_round_s = max(found.worst_round_s, time.monotonic() - started)
                rounds += 1
                if rounds % 8 == 0:
                    traffic.vanish(source)
                    # So that the scene has what the requests speak of, and does not grow without end.
                    book.look(None)
                    traffic.turn_forces_on()
                    traffic.ask("reload")
                    book.look(None)
                if rounds == 40:
                    memory = memory_kib(daemon.process.pid) / 1024
                if rounds % 200 == 0:
                    speed = sent / (time.monotonic() - began)
                    progress(
                        f"{sent} messages, {speed:.0f} a second, memory {memory_kib(daemon.process.pid) / 1024:.1f} MB"
                    )
            found.seconds = time.monotonic() - began
            found.processor_s = scheduled_s(daemon.process.pid)[0] - first_s
            found.changes, found.stalls = book.changes, book.stalls
            if memory is not None:
                found.grown_mb = memory_kib(daemon.process.pid) / 1024 - memory
                assert found.grown_mb < GROWTH_MB, f"the daemon's memory grew by {found.grown_mb:.1f} MB"
            # What lapsed is over when the forces are turned on; nothing else may be left.
            traffic.turn_forces_on()
            status = traffic.ask("get_status")
            assert status["faults"] == [] and status["state"] == "running"
        except (AssertionError, zmq.ZMQError) as error:
            if daemon.process.poll() is not None:
                raise Failure(f"the daemon ended with {daemon.process.returncode}: {daemon.said()[-5000:]}") from error
            raise
        finally:
            traffic.close()
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    found = run(random.Random(arguments.seed), arguments.runs, lambda line: print(line, flush=True))
    print(
        f"fuzz_messages: ok, {arguments.runs} messages in {found.seconds:.0f} s "
        f"({arguments.runs / found.seconds:.0f} a second; the daemon used {found.processor_s:.0f} s), {found.changes} "
        f"changes taken, the slowest {ROUND} {found.worst_round_s:.2f} s, {found.stalls} stalls of the machine, "
        f"memory {found.grown_mb:+.1f} MB"
    )
    told = {{0: "result", 1: "notification"}.get(code, code): count for code, count in found.outcomes.most_common()}
    print(f"fuzz_messages: {told}")


if __name__ == "__main__":
    main()
