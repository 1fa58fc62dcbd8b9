"""What the participant's page may call, and what it gets: screens, and where the stylus is drawn. Nothing else.

    participant.screen    {} -> {screen, notice, hand}: the screen now; what is said beside it (a text, or "");
                          whether this page moves the simulated joystick's hand
    participant.beat      {}: its script runs
    participant.go_on     {screen}: the button of a screen
    participant.answer    {screen, answer}: of a choice its place from 0, of a measure nothing, else a text or a number
    participant.stop      {}: the session ends here

Of the daemon it may call `set_forces` (off, as it never has a lease) and, with the simulated joystick, `stream_target`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final, cast

from hapticd.base.codec import encode
from hapticd.base.core import Flag
from hapticd.base.errors import HapticdError
from hapticd.experiment.front import Command
from hapticd.experiment.pages.pages_front import PagesFront
from hapticd.experiment.pages.presence import Presence
from hapticd.experiment.pages.stylus import drawn_at
from hapticd.protocol import messages
from hapticd.web.page import Method, Page

STOPS: Final = frozenset(("set_forces",))
MOVES: Final = frozenset(("stream_target",))
STYLUS: Final = "stylus"
"""Topic of where the stylus is drawn: [x, y], m."""


def screen_number(params: Mapping[str, object]) -> int:
    """Raises HapticdError."""
    number = params.get("screen")
    if not isinstance(number, int) or isinstance(number, bool):
        raise HapticdError("screen: must be the number of the screen")
    return number


def methods(front: PagesFront, presence: Presence, hand: bool) -> dict[str, Method]:
    """By name. `hand`: the device is the simulated joystick."""
    newest: list[Page] = []

    async def hello(page: Page, _: Mapping[str, object]) -> object:
        return {}

    async def screen(page: Page, _: Mapping[str, object]) -> object:
        if presence.follow(page):
            for older in newest:
                # Only one may answer, and be away.
                older.end("This page was opened somewhere else, and goes on there.")
            newest[:] = [page]
        return {"screen": front.screen, "notice": front.notice, "hand": hand}

    async def beat(page: Page, _: Mapping[str, object]) -> object:
        presence.beat(page)
        return {}

    async def go_on(_: Page, params: Mapping[str, object]) -> object:
        front.go_on("participant", screen_number(params))
        return {}

    async def answer(_: Page, params: Mapping[str, object]) -> object:
        try:
            front.answer(screen_number(params), params.get("answer"))
        except ValueError as error:
            raise HapticdError(str(error)) from None
        return {}

    async def stop(_: Page, __: Mapping[str, object]) -> object:
        front.command(Command("abort", "the participant pressed the stop"))
        return {}

    return {
        "web.hello": hello,
        "participant.screen": screen,
        "participant.beat": beat,
        "participant.go_on": go_on,
        "participant.answer": answer,
        "participant.stop": stop,
    }


class StylusTaker:
    """Gets the daemon's states, and passes on where the stylus is drawn."""

    def __init__(self, front: PagesFront, pages: Callable[[], Iterable[Page]]) -> None:
        self._front, self._pages = front, pages

    def telemetry(self, topic: str, message: bytes) -> None:
        state = cast("dict[str, Any]", cast("list[Any]", messages.decode_trusted(message))[1])
        x, y = state["position_m"]
        at = drawn_at((x, y), bool(state["flags"] & Flag.CONTACT), self._front.surfaces)
        told = encode([STYLUS, list(at)])
        for page in self._pages():
            page.outbox.telemetry(topic, told)
