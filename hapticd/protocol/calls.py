"""Calls as they go over the wire, without I/O: how a client asks, what an answer says, and the errors it may be."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, Literal, TypeAlias, cast

from hapticd.base import arguments
from hapticd.base.codec import NotEncodableError
from hapticd.base.errors import HapticdError, Problem, in_order, lines_of, shown
from hapticd.protocol import messages

REPLY_TIMEOUT_S: Final = 5.0
"""How long a client waits for an answer by default."""

Topic: TypeAlias = Literal["samples", "state", "event", "change", "status"]


class RemoteError(HapticdError):
    """The daemon answered with an error.

    `code` is one of `hapticd.protocol.messages.Code`, `problems` holds the faults that were found in the params, `data`
    is the error's data as it came.
    """

    def __init__(self, code: int, message: str, data: object = None) -> None:
        super().__init__(code, message, data)
        self.code = code
        self.message = message
        self.data = data
        self.problems: tuple[Problem, ...] = _problems(data)

    def __str__(self) -> str:
        return "; ".join(lines_of(self.problems)) or self.message


def _problems(data: object) -> tuple[Problem, ...]:
    if not isinstance(data, list):
        return ()
    return tuple(
        Problem(str(item["where"]), str(item["problem"]))
        for item in data
        if isinstance(item, dict) and "where" in item and "problem" in item
    )


class DaemonNotRunning(HapticdError):
    """Nobody answers at the runtime directory, or nobody any more."""


class TimedOut(HapticdError, TimeoutError):
    """What was waited for did not come in the time that was given for it."""


class TelemetryLoss(UserWarning):
    """This subscriber was too slow: the daemon sent samples that never arrived here."""


class MissedPeriods(UserWarning):
    """The servo missed a greater part of its periods than `servo.overruns.threshold` while something was recorded."""


class ForcesOff(UserWarning):
    """A lease is held, but a fault keeps the forces off until `set_forces(True)`."""


def encode_request(id: int, method: str, params: Mapping[str, object] | None) -> bytes:
    """The body of a call; raises HapticdError for one that the daemon would refuse to read."""
    if not isinstance(method, str):
        raise arguments.wrong("method", f"must be a text, is {shown(method)}")
    if params is not None and not isinstance(params, Mapping):
        raise arguments.wrong("params", f"must be a mapping, is {shown(params)}")
    try:
        body = messages.request(id, method, params)
        if len(body) > messages.MAX_BODY_BYTES:
            raise HapticdError(f"{method}: {len(body)} bytes in one message (at most {messages.MAX_BODY_BYTES})")
        if params:
            messages.check_encoded(body)
    except (messages.WireError, NotEncodableError) as error:
        arguments.plain((), params)  # says where
        raise HapticdError(f"{method}: {error}") from None
    return body


def result_of(result: object | RemoteError | DaemonNotRunning, params: Mapping[str, object] | None) -> object:
    """The result of a call, or its error raised; places in params that came from a file are those in the file."""
    if isinstance(result, DaemonNotRunning):
        raise result
    if isinstance(result, RemoteError):
        if params and result.problems:
            from hapticd.config.file_faults import placed

            result.problems = in_order(Problem(placed(each.where, params), each.problem) for each in result.problems)
        raise result
    if params and isinstance(result, dict) and result.get("warnings"):
        from hapticd.config.file_faults import placed

        warnings = [{**each, "where": placed(str(each["where"]), params)} for each in result["warnings"]]
        return {**result, "warnings": warnings}
    return result


def decode_response(body: bytes) -> tuple[messages.Id, object | RemoteError]:
    """The id that an answer carries, and the result or the error in it."""
    message = messages.decode_trusted(body)
    if not isinstance(message, dict):
        raise _not_an_answer()
    id = cast(messages.Id, message.get("id"))
    if "error" not in message:
        return id, message.get("result")
    error = message["error"]
    if not isinstance(error, dict):
        raise _not_an_answer()
    code, message = int(error.get("code", 0)), str(error.get("message", ""))
    return id, RemoteError(code, message, error.get("data"))


def _not_an_answer() -> messages.WireError:
    return messages.WireError(messages.Code.INVALID_REQUEST, "the daemon's answer is not a JSON-RPC object")
