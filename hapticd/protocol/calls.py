"""A client's side of a call, without I/O: encoding of requests, decoding of replies, exceptions and warnings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, Literal, TypeAlias, cast

from hapticd.base import arguments
from hapticd.base.codec import NotEncodableError
from hapticd.base.errors import HapticdError, Problem, in_order, lines_of, shown
from hapticd.protocol import messages

REPLY_TIMEOUT_S: Final = 5.0
"""Time that a client waits for a reply by default."""

Topic: TypeAlias = Literal["samples", "state", "event", "change", "status"]


class RemoteError(HapticdError):
    """The daemon replied with an error.

    `code` is one of `hapticd.protocol.messages.Code`. `data` is the data of the error. `problems` are the faults of the
    params, if `data` lists any.
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
    """No daemon answers at the runtime directory, or the daemon has stopped answering."""


class TimedOut(HapticdError, TimeoutError):
    """An awaited event or state did not occur within the timeout."""


class TelemetryLoss(UserWarning):
    """Samples were lost because this subscriber was too slow."""


class MissedPeriods(UserWarning):
    """The servo missed a larger fraction of its periods than `servo.overruns.threshold` during a recording."""


class ForcesOff(UserWarning):
    """Forces are off although a client holds the lease or streams forces; `set_forces(True)` turns them on."""


def encode_request(id: int, method: str, params: Mapping[str, object] | None) -> bytes:
    """Return the encoded request that calls a method. Raises HapticdError if it cannot be encoded or is too long."""
    if not isinstance(method, str):
        raise arguments.invalid_argument("method", f"must be a string, is {shown(method)}")
    if params is not None and not isinstance(params, Mapping):
        raise arguments.invalid_argument("params", f"must be a mapping, is {shown(params)}")
    try:
        body = messages.request(id, method, params)
        if len(body) > messages.MAX_BODY_BYTES:
            raise HapticdError(
                f"{method}: message too long: must be at most {messages.MAX_BODY_BYTES} bytes, is {len(body)}"
            )
        if params:
            messages.check_encoded(body)
    except (messages.WireError, NotEncodableError) as error:
        arguments.plain((), params)  # raises an error with the place of the fault
        raise HapticdError(f"{method}: {error}") from None
    return body


def result_of(result: object | RemoteError, params: Mapping[str, object] | None) -> object:
    """Return the result of a call to the daemon, or raise the error with which the daemon replied.

    Faults and warnings of params that were read from a file are reported with their lines in that file.
    """
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
    """Return the id of a reply, and its result or error. Raises WireError for a body that is not a reply."""
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
    return messages.WireError(messages.Code.INVALID_REQUEST, "the daemon's reply is not a JSON-RPC object")
