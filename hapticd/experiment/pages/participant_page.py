"""The methods of the participant's page, which receives only screens and the position at which the stylus is drawn.

    participant.screen    {} -> {screen, notice, hand}: the current screen; a notice (a text, or ""); whether this page
                          moves the hand of the simulated joystick
    participant.beat      {}: heartbeat
    participant.go_on     {screen}: the button to continue was pressed on a screen
    participant.answer    {screen, answer}: index from 0 of a choice, null for a measure, else a text or a number
    participant.stop      {}: end the session

Of the daemon's methods the page may call `set_forces` and, with the simulated joystick, `stream_target`. It can only
switch the forces off, because it never has a lease.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final, cast

from hapticd.base.codec import encode
from hapticd.base.core import Flag
from hapticd.base.errors import HapticdError
from hapticd.experiment.front import Command, Seen
from hapticd.experiment.pages.pages_front import PagesFront
from hapticd.experiment.pages.presence import Presence
from hapticd.protocol import messages
from hapticd.web.page import Method, Page

STOP_METHODS: Final = frozenset(("set_forces",))
"""Methods of the daemon that the page may always call."""
HAND_METHODS: Final = frozenset(("stream_target",))
"""Methods of the daemon that the page may also call with the simulated joystick."""
STYLUS_TOPIC: Final = "stylus"
"""Topic of the messages [x, y] to the page, the position in m at which it draws the stylus."""


def screen_number(params: Mapping[str, object]) -> int:
    """Return `screen`, the number of a screen, from the parameters of a call by a page.

    Raises HapticdError if `screen` is missing or not an integer.
    """
    number = params.get("screen")
    if not isinstance(number, int) or isinstance(number, bool):
        raise HapticdError("screen: must be the number of a screen, an integer")
    return number


def methods(front: PagesFront, presence: Presence, hand: bool) -> dict[str, Method]:
    """Return the functions that the participant's page may call, by the name of the method.

    `hand` is whether the page moves the hand of the simulated joystick.
    """
    newest: list[Page] = []

    async def hello(page: Page, _: Mapping[str, object]) -> object:
        return {}

    async def screen(page: Page, _: Mapping[str, object]) -> object:
        if presence.follow(page):
            for older in newest:
                # Only the newest page may answer, and only its heartbeats count.
                older.end("The session continues in another window, where this page was opened again.")
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


def drawn_at(position_m: tuple[float, float], touches: bool, surfaces: Sequence[Seen]) -> tuple[float, float]:
    """Return the position in m at which the stylus is drawn for a handle at `position_m`.

    If the handle touches an object, the stylus is drawn at the height of the surface above it, also beyond the end of
    the surface and at the side of a box: no depth is visible, as it would reveal the stiffness of the material. Of
    several surfaces, the one with the smallest distance beyond its end is used. A handle that touches nothing, also
    behind a punctured membrane, is drawn at `position_m`.
    """
    x, y = position_m
    found = [(*each.from_surface(position_m), each.normal) for each in surfaces] if touches else []
    below = [each for each in found if each[1] < 0.0]
    if not below:
        return x, y
    _, above, (n_x, n_y) = min(below)
    return x - above * n_x, y - above * n_y


class StylusRelay:
    """Receives the states of the daemon, and sends the participant's pages the position at which to draw the stylus."""

    def __init__(self, front: PagesFront, pages: Callable[[], Iterable[Page]]) -> None:
        self._front, self._pages = front, pages

    def telemetry(self, topic: str, message: bytes) -> None:
        """Send the pages the position at which to draw the stylus, from `message`, a state of the daemon."""
        state = cast("dict[str, Any]", cast("list[Any]", messages.decode_trusted(message))[1])
        x, y = state["position_m"]
        at = drawn_at((x, y), bool(state["flags"] & Flag.CONTACT), self._front.surfaces)
        sent = encode([STYLUS_TOPIC, list(at)])
        for page in self._pages():
            page.outbox.telemetry(topic, sent)
