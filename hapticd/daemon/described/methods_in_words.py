"""What each method does, which type it answers with, and with which errors beside those that every method has."""

from __future__ import annotations

from typing import Final, NamedTuple

from hapticd.protocol import results
from hapticd.protocol.messages import Code

_CHANGE: Final = (Code.STALE_REVISION, Code.RING_FULL, Code.WAIT_TIMED_OUT)
_COMMAND: Final = (Code.RING_FULL, Code.WAIT_TIMED_OUT)

EVERY_METHOD: Final = (Code.INVALID_PARAMS, Code.INTERNAL, Code.DAEMON_AWAY)
"""Errors that a request of any method may get."""
ANY_MESSAGE: Final = (Code.PARSE, Code.INVALID_REQUEST, Code.NO_SUCH_METHOD)
"""Errors of a message that calls none of the methods."""


class MethodInWords(NamedTuple):
    """A method, as a reader who looks for one needs it."""

    summary: str
    result: type | None
    """None: an empty map."""
    codes: tuple[Code, ...] = ()


METHODS: Final[dict[str, MethodInWords]] = {
    "get_status": MethodInWords("What the daemon is and does", results.Status),
    "get_state": MethodInWords("The newest sample", results.State, _COMMAND),
    "get_config": MethodInWords("Servo and device of the configuration", results.ConfigResult),
    "get_scene": MethodInWords("The scene, in a form that can be sent back", results.SceneResult),
    "set_scene": MethodInWords("Replaces the scene, all or nothing", results.RevisionResult, _CHANGE),
    "update_scene": MethodInWords("Changes, adds and removes objects", results.RevisionResult, _CHANGE),
    "get_materials": MethodInWords("All materials, the shipped ones too", results.MaterialsResult),
    "set_materials": MethodInWords("Adds materials, or replaces them whole", results.RevisionResult, _CHANGE),
    "update_materials": MethodInWords("Changes, adds and removes materials", results.RevisionResult, _CHANGE),
    "apply": MethodInWords("Materials and scene in one change", results.RevisionResult, _CHANGE),
    "play": MethodInWords("Strikes a mode once", results.PlayResult, (Code.FORCES_OFF, *_COMMAND)),
    "reset": MethodInWords("Closes membranes and forgets contacts", results.TickResult, _COMMAND),
    "mark": MethodInWords("Leaves a mark in events and recordings", results.TickResult, _COMMAND),
    "set_forces": MethodInWords("Turns forces on or off", results.ForcesResult, (Code.FORCES_OFF, *_COMMAND)),
    "set_operator": MethodInWords(
        "Moves the hand on the simulated joystick", results.OperatorResult, (Code.NO_OPERATOR, *_COMMAND)
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
    "reload": MethodInWords("Reads the configuration files again", results.RevisionResult, _CHANGE),
    "dump_flight": MethodInWords("Writes what the flight recorder keeps", results.FlightResult),
}
