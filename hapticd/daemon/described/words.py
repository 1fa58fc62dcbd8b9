"""Texts of the OpenRPC description: summaries of methods, error codes, and rules that JSON Schema cannot express."""

from __future__ import annotations

from typing import Final, NamedTuple

from hapticd.protocol import results
from hapticd.protocol.messages import Code

# ---- Methods ---------------------------------------------------------------------------------------------------------

_CHANGE_CODES: Final = (Code.STALE_REVISION, Code.RING_FULL, Code.WAIT_TIMED_OUT)
"""Errors of the methods that change scene or materials."""
_SCENE_CODES: Final = (*_CHANGE_CODES, Code.HANDLE_INSIDE)
"""Errors of the methods that may put objects under the hand."""
_COMMAND_CODES: Final = (Code.RING_FULL, Code.WAIT_TIMED_OUT)
"""Errors of the methods that send the servo a command."""

CODES_OF_EVERY_METHOD: Final = (Code.INVALID_PARAMS, Code.INTERNAL, Code.DAEMON_AWAY)
"""Errors that a request of any method may get."""
CODES_OF_ANY_MESSAGE: Final = (Code.PARSE, Code.INVALID_REQUEST, Code.NO_SUCH_METHOD)
"""Errors of a message that is not a request for a method of the protocol."""


class MethodDescription(NamedTuple):
    """Summary, result and error codes of a method of the protocol."""

    summary: str
    result: type | None
    """The type of the result; None: an empty map."""
    codes: tuple[Code, ...] = ()


METHOD_DESCRIPTIONS: Final[dict[str, MethodDescription]] = {
    "get_status": MethodDescription("Return the state of the daemon", results.Status),
    "get_state": MethodDescription("Return the newest sample", results.State, (Code.WAIT_TIMED_OUT,)),
    "get_config": MethodDescription(
        "Return the sections `servo` and `device` of the configuration", results.ConfigResult
    ),
    "get_scene": MethodDescription("Return the scene, in a form that can be sent back", results.SceneResult),
    "set_scene": MethodDescription("Replace the scene, all or nothing", results.RevisionResult, _SCENE_CODES),
    "update_scene": MethodDescription("Change, add and remove objects", results.RevisionResult, _SCENE_CODES),
    "get_materials": MethodDescription("Return all materials, the shipped ones too", results.MaterialsResult),
    "set_materials": MethodDescription(
        "Add materials, or replace them completely", results.RevisionResult, _CHANGE_CODES
    ),
    "update_materials": MethodDescription("Change, add and remove materials", results.RevisionResult, _CHANGE_CODES),
    "apply": MethodDescription("Set materials and scene in one change", results.RevisionResult, _SCENE_CODES),
    "play": MethodDescription("Strike a mode once", results.PlayResult, (Code.FORCES_OFF, *_COMMAND_CODES)),
    "reset": MethodDescription("Close punctured membranes and clear contacts", results.TickResult, _COMMAND_CODES),
    "mark": MethodDescription("Put a mark into events and recordings", results.TickResult, _COMMAND_CODES),
    "set_forces": MethodDescription("Turn forces on or off", results.ForcesResult, (Code.FORCES_OFF, *_COMMAND_CODES)),
    "set_operator": MethodDescription(
        "Move the hand on the simulated joystick", results.OperatorResult, (Code.NO_OPERATOR, *_COMMAND_CODES)
    ),
    "stream_target": MethodDescription(
        "Set the target of the simulated hand: one message of a stream", None, (Code.NO_OPERATOR, Code.STREAM_HELD)
    ),
    "stream_force": MethodDescription(
        "Set the force that is added to the rendered one: one message of a stream",
        results.StreamedForceResult,
        (Code.STREAM_HELD,),
    ),
    "lease": MethodDescription(
        "Take, renew or end the lease under which forces stay on",
        results.LeaseResult,
        (Code.LEASE_HELD, Code.LEASE_LAPSED),
    ),
    "reload": MethodDescription("Read the configuration files again", results.RevisionResult, _SCENE_CODES),
    "dump_flight": MethodDescription(
        "Write the telemetry that the flight recorder keeps to a file", results.FlightResult
    ),
}

# ---- Errors: the same texts as in docs/protocol.md -------------------------------------------------------------------


class CodeDescription(NamedTuple):
    """An error code of the protocol: when the error occurs, and the member `data` of the error object."""

    when: str
    data: str = ""


CODE_DESCRIPTIONS: Final[dict[Code, CodeDescription]] = {
    Code.PARSE: CodeDescription(
        "the body is over 2 MiB, truncated, not msgpack, followed by other bytes, nested deeper than "
        "32, has a map of more than 65,536 members, a duplicate key, a key that is not a string, an "
        "extension type, or a string that is not UTF-8; `id` is nil",
    ),
    Code.INVALID_REQUEST: CodeDescription(
        'wrong number of frames, not a map, a batch, `jsonrpc` is not `"2.0"`, an id of another type, '
        "`method` is not a string, an unknown member",
    ),
    Code.NO_SUCH_METHOD: CodeDescription("unknown method"),
    Code.INVALID_PARAMS: CodeDescription(
        "`params` is not a map (then without `data`), or its content is wrong",
        'a list of `{"where", "problem"}`',
    ),
    Code.INTERNAL: CodeDescription("internal error of the daemon; see its log"),
    Code.STALE_REVISION: CodeDescription(
        "`expect_revision` is not the scene's revision",
        '`{"revision"}`: the revision of the scene',
    ),
    Code.FORCES_OFF: CodeDescription(
        "`play` while forces are off; `set_forces` if it could not clear every fault",
        '`{"faults"}`, if faults are the reason',
    ),
    Code.LEASE_HELD: CodeDescription(
        "a client with a different token has the lease",
        '`{"lease_s"}`: seconds until that lease ends',
    ),
    Code.RING_FULL: CodeDescription(
        "the servo has not yet taken earlier commands, 64 marks are under way, or 64 changes or 4 MiB of "
        "changes are waiting. The command was not carried out: send it again",
    ),
    Code.WAIT_TIMED_OUT: CodeDescription(
        "the servo did not take a command or a revision within a second. It may still take it: a "
        "changed scene stays changed, and a mark may still appear. Also: `get_state`, if no first "
        "tick was rendered in that time",
    ),
    Code.LEASE_LAPSED: CodeDescription(
        "no lease has this token: the lease lapsed, was ended, or never existed",
        '`{"faults"}`: the latched faults',
    ),
    Code.NO_OPERATOR: CodeDescription(
        "`set_operator` or `stream_target`, but the device is not the simulated joystick"
    ),
    Code.DAEMON_AWAY: CodeDescription("from the server of the page: no daemon accepted or answered the request"),
    Code.STREAM_HELD: CodeDescription(
        "a stream of another connection is under way",
        '`{"free_s"}`: seconds until that stream ends, if its sender sends nothing more',
    ),
    Code.HANDLE_INSIDE: CodeDescription(
        "while forces are on, a new or moved object would hold the handle deep inside: it would push with the device's "
        "largest force. Move the object or the handle, or send `force`: true",
        'a list of `{"where", "problem"}`',
    ),
}

# ---- Rules: params that match their schema are accepted, or refused with -32602 for one of these reasons -------------

VALIDATION_RULES: Final[dict[str, str]] = {
    "length": "a normal, and the direction of play, must have a length of at least 1e-9",
    "patches": "a patch of a wall must be at least 1e-5 m wide; patches must not overlap, and the gap between two must "
    "be 0 or at least 1e-5 m",
    "rising": "speeds, forces and times of a list of points must rise by at least 1e-6 m/s, 1e-6 N or 1e-5 s",
    "table_size": "a table must have a row, a frequency and a decay time for each of its speeds and forces",
    "grooves": "width_m of grooves must be at most their spacing_m",
    "waveform": "a waveform must begin and end with 0, have a sample that is not 0, and last at most 0.1 s",
    "models": "models of a texture must be stable, have an RMS of at most 1e6 m/s^2, at most 256 different speeds and "
    "256 different forces, and no two of them may have the same speed and force",
    "provenance": "a date must be a day of the calendar; the upper end of an interval must not be below the lower one",
    "stroke": "from_m and to_m of a stroke must differ",
    "json": "data of a mark must not contain byte strings, and must have at most 8192 bytes as JSON",
    "known": "named materials and objects must exist; the material of play must have a tap that is not a waveform, or, "
    "without a tap, a rupture; materials that the scene uses cannot be removed",
    "rate": "frequencies of textures that the scene uses must be below the limit of the servo's rate",
    "reach": "a gesture must lie on its object, which must have a stiffness (a stroke) or a rupture (a puncture)",
    "merged": "an object or a material must be valid after a merge patch",
    "seq": "seq must be above that of the previous message",
    "files": "the configuration files must be valid, and must not change a key that needs a restart",
}

_SCENE_RULES: Final = ("length", "patches", "known", "rate")
_MATERIAL_RULES: Final = ("rising", "table_size", "grooves", "waveform", "models", "provenance", "rate")
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
"""The rules that apply to each method; methods without rules are left out."""
