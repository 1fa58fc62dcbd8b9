"""When each error code is sent, and what its `data` holds. `docs/protocol.md` has the same words."""

from __future__ import annotations

from typing import Final, NamedTuple

from hapticd.protocol.messages import Code


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
    Code.NO_SUCH_METHOD: CodeInWords(
        "there is no such method",
    ),
    Code.INVALID_PARAMS: CodeInWords(
        "`params` is not a map (then without `data`), or its content is wrong",
        'a list of `{"where", "problem"}`',
    ),
    Code.INTERNAL: CodeInWords(
        "a defect of the daemon; its log says more",
    ),
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
        "the servo has not yet taken earlier commands, or 64 marks or 64 `get_state` are under way, or "
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
    Code.NO_OPERATOR: CodeInWords(
        "`set_operator` or `stream_target`, but the device is not the simulated joystick",
    ),
    Code.DAEMON_AWAY: CodeInWords(
        "from the server of the page: no daemon took the request, or none answered it",
    ),
    Code.STREAM_HELD: CodeInWords(
        "the stream of another connection is under way",
        '`{"free_s"}`: seconds until that stream ends, if its sender sends nothing more',
    ),
}
