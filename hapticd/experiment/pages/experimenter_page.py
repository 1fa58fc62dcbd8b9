"""The methods of the experimenter's page, in addition to those of every page of `hapticd web`.

    experiment.watch    {since} -> state of the session (console.py), answers from index `since` on; also a heartbeat
    experiment.beat     {}: heartbeat
    experiment.go_on    {screen}: the button to continue was pressed on a screen
    experiment.command  {kind: pause | repeat | abort | note, text}
    experiment.auto     {on}: whether trials begin automatically

After every change the page receives {"experiment": {...}}: the state of the session. Its `answers` is their number.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from hapticd.base.errors import HapticdError
from hapticd.experiment.front import COMMAND_KINDS, Command
from hapticd.experiment.pages.pages_front import PagesFront
from hapticd.experiment.pages.participant_page import screen_number
from hapticd.experiment.pages.presence import Presence
from hapticd.web.page import Method, Page

MAX_COMMAND_CHARACTERS: Final = 10_000
"""Longest text of a command, such as a note."""


def methods(front: PagesFront, presence: Presence) -> dict[str, Method]:
    """Return the functions that the experimenter's page may call, by the name of the method."""

    async def watch(page: Page, params: Mapping[str, object]) -> object:
        since = params.get("since", 0)
        if not isinstance(since, int) or isinstance(since, bool) or since < 0:
            raise HapticdError("since: must be the index of an answer, an integer of at least 0")
        presence.follow(page)
        presence.beat(page)
        return {**front.console(), "since": since, "rows": front.rows(since)}

    async def beat(page: Page, _: Mapping[str, object]) -> object:
        presence.beat(page)
        return {}

    async def go_on(_: Page, params: Mapping[str, object]) -> object:
        front.go_on("experimenter", screen_number(params))
        return {}

    async def command(_: Page, params: Mapping[str, object]) -> object:
        kind, text = params.get("kind"), params.get("text", "")
        if kind not in COMMAND_KINDS:
            raise HapticdError(f"kind: must be one of {', '.join(COMMAND_KINDS)}")
        if not isinstance(text, str) or len(text) > MAX_COMMAND_CHARACTERS:
            raise HapticdError(f"text: must be a text of at most {MAX_COMMAND_CHARACTERS} characters")
        front.command(Command(kind, text.strip()))
        return {}

    async def auto(_: Page, params: Mapping[str, object]) -> object:
        on = params.get("on")
        if not isinstance(on, bool):
            raise HapticdError("on: must be true or false")
        front.set_auto(on)
        return {}

    return {
        "experiment.watch": watch,
        "experiment.beat": beat,
        "experiment.go_on": go_on,
        "experiment.command": command,
        "experiment.auto": auto,
    }


def news(front: PagesFront) -> dict[str, object]:
    """Return the message to the experimenter's page after a change: the state of the session, without the answers."""
    return {"experiment": front.console()}
