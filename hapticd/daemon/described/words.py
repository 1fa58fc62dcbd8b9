"""What the documents say in words: methods, error codes, and what is validated that JSON Schema cannot say."""

from __future__ import annotations

from typing import Final, NamedTuple

from hapticd.protocol import results
from hapticd.protocol.messages import Code

# ---- Methods ---------------------------------------------------------------------------------------------------------

_CHANGE_CODES: Final = (Code.STALE_REVISION, Code.RING_FULL, Code.WAIT_TIMED_OUT)
_COMMAND_CODES: Final = (Code.RING_FULL, Code.WAIT_TIMED_OUT)

CODES_OF_EVERY_METHOD: Final = (Code.INVALID_PARAMS, Code.INTERNAL, Code.DAEMON_AWAY)
"""Errors that a request of any method may get."""
CODES_OF_ANY_MESSAGE: Final = (Code.PARSE, Code.INVALID_REQUEST, Code.NO_SUCH_METHOD)
"""Errors of a message that calls none of the methods."""


class MethodInWords(NamedTuple):
    """A method, as a reader who looks for one needs it."""

    summary: str
    result: type | None
    """None: an empty map."""
    codes: tuple[Code, ...] = ()


METHODS: Final[dict[str, MethodInWords]] = {
    "get_status": MethodInWords("What the daemon is and does", results.Status),
    "get_state": MethodInWords("The newest sample", results.State, (Code.WAIT_TIMED_OUT,)),
    "get_config": MethodInWords("Servo and device of the configuration", results.ConfigResult),
    "get_scene": MethodInWords("The scene, in a form that can be sent back", results.SceneResult),
    "set_scene": MethodInWords("Replaces the scene, all or nothing", results.RevisionResult, _CHANGE_CODES),
    "update_scene": MethodInWords("Changes, adds and removes objects", results.RevisionResult, _CHANGE_CODES),
    "get_materials": MethodInWords("All materials, the shipped ones too", results.MaterialsResult),
    "set_materials": MethodInWords("Adds materials, or replaces them whole", results.RevisionResult, _CHANGE_CODES),
    "update_materials": MethodInWords("Changes, adds and removes materials", results.RevisionResult, _CHANGE_CODES),
    "apply": MethodInWords("Materials and scene in one change", results.RevisionResult, _CHANGE_CODES),
    "play": MethodInWords("Strikes a mode once", results.PlayResult, (Code.FORCES_OFF, *_COMMAND_CODES)),
    "reset": MethodInWords("Closes membranes and forgets contacts", results.TickResult, _COMMAND_CODES),
    "mark": MethodInWords("Leaves a mark in events and recordings", results.TickResult, _COMMAND_CODES),
    "set_forces": MethodInWords("Turns forces on or off", results.ForcesResult, (Code.FORCES_OFF, *_COMMAND_CODES)),
    "set_operator": MethodInWords(
        "Moves the hand on the simulated joystick", results.OperatorResult, (Code.NO_OPERATOR, *_COMMAND_CODES)
    ),
    "stream_target": MethodInWords(
        "Where the simulated hand wants to be, one of a stream", None, (Code.NO_OPERATOR, Code.STREAM_HELD)
    ),
    "stream_force": MethodInWords(
        "A force that is added, one of a stream", results.StreamedForceResult, (Code.STREAM_HELD,)
    ),
    "lease": MethodInWords(
        "Takes, renews or ends the lease under which forces stay on",
        results.LeaseResult,
        (Code.LEASE_HELD, Code.LEASE_LAPSED),
    ),
    "reload": MethodInWords("Reads the configuration files again", results.RevisionResult, _CHANGE_CODES),
    "dump_flight": MethodInWords("Writes what the flight recorder keeps", results.FlightResult),
}

# ---- Errors: docs/protocol.md has the same words ---------------------------------------------------------------------


class CodeInWords(NamedTuple):
    """One row of the table of errors."""

    when: str
    data: str = ""


CODES: Final[dict[Code, CodeInWords]] = {
    Code.PARSE: CodeInWords(
        "the body is over 2 MiB, truncated, not msgpack, followed by other bytes, nested deeper than "
        "32, has a map of more than 65,536 members, has a key twice or one that is no string, an "
        "extension type, or a string that is not UTF-8; `id` is nil",
    ),
    Code.INVALID_REQUEST: CodeInWords(
        'wrong number of frames, not a map, a batch, `jsonrpc` is not `"2.0"`, an id of another type, '
        "`method` is not a string, an unknown member",
    ),
    Code.NO_SUCH_METHOD: CodeInWords("there is no such method"),
    Code.INVALID_PARAMS: CodeInWords(
        "`params` is not a map (then without `data`), or its content is wrong",
        'a list of `{"where", "problem"}`',
    ),
    Code.INTERNAL: CodeInWords("a defect of the daemon; its log says more"),
    Code.STALE_REVISION: CodeInWords(
        "`expect_revision` is not the scene's revision",
        '`{"revision"}`: the scene\'s',
    ),
    Code.FORCES_OFF: CodeInWords(
        "`play` while forces are off; `set_forces` that could not clear every fault",
        '`{"faults"}`, if faults are the reason',
    ),
    Code.LEASE_HELD: CodeInWords(
        "a client with another token has the lease",
        '`{"lease_s"}`: seconds until that lease ends',
    ),
    Code.RING_FULL: CodeInWords(
        "the servo has not yet taken earlier commands, or 64 marks are under way, or "
        "64 changes wait, or 4 MiB of them. Nothing of this command was done: send it again",
    ),
    Code.WAIT_TIMED_OUT: CodeInWords(
        "the servo did not take a command or a revision within a second. It may still take it: a "
        "changed scene stays changed, and a mark may still appear. Also: `get_state`, if no first "
        "tick was rendered in that time",
    ),
    Code.LEASE_LAPSED: CodeInWords(
        "no lease has this token: the lease lapsed, was ended, or never existed",
        '`{"faults"}`: the latched faults',
    ),
    Code.NO_OPERATOR: CodeInWords("`set_operator` or `stream_target`, but the device is not the simulated joystick"),
    Code.DAEMON_AWAY: CodeInWords("from the server of the page: no daemon took the request, or none answered it"),
    Code.STREAM_HELD: CodeInWords(
        "the stream of another connection is under way",
        '`{"free_s"}`: seconds until that stream ends, if its sender sends nothing more',
    ),
}

# ---- Rules: params that are valid by their schema are taken, or refused with -32602 for one of these reasons ---------

RULES: Final[dict[str, str]] = {
    "length": "a normal, and the direction of play, have a length of at least 1e-9",
    "patches": "a patch of a wall is at least 1e-5 m wide; patches do not overlap, and touch or are 1e-5 m apart",
    "rising": "points over a speed, a force or time rise: by 1e-6 m/s, 1e-6 N, 1e-5 s",
    "as_many": "a table has as many rows, frequencies and decay times as it has speeds and forces",
    "grooves": "width_m of grooves is at most their spacing_m",
    "waveform": "a waveform begins and ends with 0, has a sample that is not 0, and lasts 0.1 s at most",
    "models": "models of a texture are stable, have an RMS of 1e6 m/s^2 at most, at most 256 different speeds and as "
    "many different forces, and no two of them have the same speed and force",
    "provenance": "a date is a day of the calendar; an interval does not end below its beginning",
    "stroke": "from_m and to_m of a stroke differ",
    "json": "data of a mark holds no byte strings, and has at most 8192 bytes as JSON",
    "known": "materials, objects and the tap or rupture of a material that are named must be there; materials that "
    "the scene uses stay",
    "rate": "the rate of the servo can carry the frequencies of textures that the scene uses",
    "reach": "a gesture lies on its object, which has a stiffness (a stroke) or a rupture (a puncture)",
    "merged": "what a merge patch makes of an object or a material is valid as a whole",
    "seq": "seq is above that of the message before",
    "files": "the configuration files are sound, and change nothing that needs a restart",
}

_SCENE_RULES: Final = ("length", "patches", "known", "rate")
_MATERIAL_RULES: Final = ("rising", "as_many", "grooves", "waveform", "models", "provenance", "rate")
RULES_OF_METHOD: Final[dict[str, tuple[str, ...]]] = {
    "set_scene": _SCENE_RULES,
    "update_scene": (*_SCENE_RULES, "merged"),
    "set_materials": _MATERIAL_RULES,
    "update_materials": (*_MATERIAL_RULES, "known", "merged"),
    "apply": (*dict.fromkeys(_SCENE_RULES + _MATERIAL_RULES),),
    "play": ("length", "known"),
    "reset": ("known",),
    "mark": ("json",),
    "set_operator": ("rising", "stroke", "known", "reach"),
    "stream_target": ("seq",),
    "stream_force": ("seq",),
    "reload": ("files",),
}
"""The rules that apply to each method; to others, none."""
