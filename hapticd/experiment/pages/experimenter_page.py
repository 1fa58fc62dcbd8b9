"""What the experimenter's page may call beside what every page of `hapticd web` may.

    experiment.watch    {since} -> the console (console.py), with the answers from `since` on; now the page is here
    experiment.beat     {}: its script runs
    experiment.go_on    {screen}
    experiment.command  {kind: pause | repeat | abort | note, text}
    experiment.auto     {on}: whether trials begin by themselves

News {"experiment": {...}} is the console without its answers, whenever it changed; `answers` says how many there are.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from hapticd.base.errors import HapticdError
from hapticd.experiment.front import Command, CommandKind
from hapticd.experiment.pages.pages_front import PagesFront
from hapticd.experiment.pages.participant_page import screen_number
from hapticd.experiment.pages.presence import Presence
from hapticd.web.page import Method, Page

KINDS: Final[tuple[CommandKind, ...]] = ("pause", "repeat", "abort", "note")
MOST_TEXT: Final = 10_000


def methods(front: PagesFront, presence: Presence) -> dict[str, Method]:
    """By name."""

    async def watch(page: Page, params: Mapping[str, object]) -> object:
        since = params.get("since", 0)
        if not isinstance(since, int) or isinstance(since, bool) or since < 0:
            raise HapticdError("since: must be a number of answers")
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
        if kind not in KINDS:
            raise HapticdError(f"kind: must be one of {', '.join(KINDS)}")
        if not isinstance(text, str) or len(text) > MOST_TEXT:
            raise HapticdError(f"text: must be a text of at most {MOST_TEXT} characters")
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
    """What the pages are told when something changed: all but the answers."""
    return {"experiment": front.console()}
