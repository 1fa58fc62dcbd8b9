"""Both pages of a session in a browser, and the actions of participant and experimenter."""

from __future__ import annotations

from playwright.sync_api import Browser, BrowserContext, Page

from tests.experiment.scripted_pages import Running
from tests.support.daemon_process import PATIENCE_S
from tests.web.browser import WIDE

STEPS = 20
_NEXT = """() => new Promise((resolve) => {
  const look = () => {
    const { kind, question, go_on } = participant.screen;
    if (kind === "over" || question) resolve(kind);
    else if (kind === "read" && go_on && !document.getElementById("go-on").disabled) resolve(kind);
    else setTimeout(look, 10);
  };
  look();
})"""
_PLACES = """([index, depth_m]) => {
  const { point_m: [x, y], normal: [nx, ny] } = participant.screen.surfaces[index];
  const box = document.getElementById("picture").getBoundingClientRect();
  const at = (d) => {
    const [px, py] = participant.picture.transform.toPx([x + d * nx, y + d * ny]);
    return [box.left + px, box.top + py];
  };
  return [at(0.01), at(-depth_m)];
}"""

_TOUCHES = """([index, beyond_m]) => {
  const { point_m: [x, y], normal: [nx, ny] } = participant.screen.surfaces[index];
  const [sx, sy] = participant.picture.stylus;
  return (sx - x) * nx + (sy - y) * ny < 1e-9 - beyond_m;
}"""


class Session:
    """The command, and its two pages, each in a separate browser profile."""

    def __init__(self, browser: Browser, running: Running) -> None:
        self.running, self.errors = running, list[str]()
        self._contexts: list[BrowserContext] = []
        self._browser = browser
        self.participant: Page
        self.experimenter: Page

    def open_both(self) -> None:
        self.participant = self.open("participant")
        self.experimenter = self.open("experimenter")

    def open(self, who: str) -> Page:
        context = self._browser.new_context(viewport=WIDE, reduced_motion="reduce")
        context.set_default_timeout(1e3 * PATIENCE_S)
        self._contexts.append(context)
        page = context.new_page()
        page.on("pageerror", lambda error: self.errors.append(f"{who}: {error.stack or error.message}"))
        page.goto(self.running.links[who])
        page.wait_for_function("() => document.body.dataset.ready === 'true'")
        return page

    def close(self) -> None:
        for context in self._contexts:
            context.close()
        self.running.stop()
        assert self.errors == []

    # ---- What people do ----------------------------------------------------------------------------------------------

    def begin(self) -> None:
        """Continue after the instructions. The experimenter lets trials begin automatically."""
        self.experimenter.click("#session-go-on")
        self.experimenter.check("#session-auto")

    def next_question(self) -> dict[str, object]:
        """Return the screen of the next question. Texts before it are continued."""
        while True:
            kind = self.participant.evaluate(_NEXT)
            if kind != "read":
                return dict(self.participant.evaluate("() => participant.screen"))
            number = self.participant.evaluate("() => participant.screen.screen")
            self.participant.keyboard.press("Enter")
            self.participant.wait_for_function(f"() => participant.screen.screen > {number}")

    def press_on(self, surface: int, depth_m: float, beyond_m: float = 0.0) -> None:
        """Press `depth_m` below a surface with the mouse, and withdraw when the stylus is drawn `beyond_m` below it."""
        over, below = self.places(surface, depth_m)
        self.participant.mouse.move(*over)
        self.participant.mouse.down()
        for step in range(1, STEPS + 1):
            # One step per frame, as fast as a hand. A faster motion is a jump, which touches no surface.
            self.participant.evaluate("() => new Promise(requestAnimationFrame)")
            self.participant.mouse.move(over[0], over[1] + step / STEPS * (below[1] - over[1]))
        self.touches(surface, beyond_m)
        self.participant.mouse.move(*over, steps=4)
        self.participant.mouse.up()

    def places(self, surface: int, depth_m: float) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return the mouse positions 1 cm above a surface, and `depth_m` below it."""
        over, below = self.participant.evaluate(_PLACES, [surface, depth_m])
        return over, below

    def touches(self, surface: int, beyond_m: float = 0.0) -> None:
        """Wait until the stylus is drawn on a surface, or `beyond_m` below it."""
        self.participant.wait_for_function(_TOUCHES, arg=[surface, beyond_m])

    def answer(self, key: str) -> None:
        number = self.participant.evaluate("() => participant.screen.screen")
        self.participant.keyboard.press(key)
        self.participant.wait_for_function(f"() => participant.screen.screen > {number}")
