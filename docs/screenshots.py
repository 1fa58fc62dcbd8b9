"""Takes the pictures of the pages in docs/images in a browser: `make screenshots`.

Of `hapticd web`: the scene while the hand strokes the comb, the oscilloscope after its trigger caught a tap, and the
panel of materials; each in light and dark colours, 1280 and 390 pixels wide. Of an experiment, in light colours: both
pages of a session, and the top of a report.
"""

from __future__ import annotations

import io
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import Browser, Page

from tests.experiment.browser_session import Session
from tests.experiment.scripted_pages import Running, run_study
from tests.web.browser import NARROW, WIDE, Pages, running_browser, running_demo

IMAGES = Path(__file__).parent / "images"
MAX_FULL_COLOUR_BYTES = 200 << 10
"""A larger picture gets a palette."""
_STROKE = {"gesture": {"kind": "stroke", "object": "floor", "from_m": -0.039, "to_m": -0.016, "speed_m_per_s": 0.02,
                       "press_n": 0.8, "count": 50}}  # fmt: skip
_TAP = {"gesture": {"kind": "tap", "object": "floor", "speed_m_per_s": 0.2, "count": 20}}
_IS_TOUCHING = "() => hapticd.model.state?.touching.includes('floor')"


def save(picture: bytes, name: str) -> Path:
    """Write a PNG and return its path. A large picture gets a palette, which changes colours of small marks."""
    path = IMAGES / f"{name}.png"
    IMAGES.mkdir(exist_ok=True)
    image = Image.open(io.BytesIO(picture)).convert("RGB")
    image.save(path, optimize=True)
    if path.stat().st_size > MAX_FULL_COLOUR_BYTES:
        image.quantize(256, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(path, optimize=True)
    return path


def operate(page: Page, params: dict[str, object]) -> None:
    page.evaluate("(params) => hapticd.link.call('set_operator', params)", params)
    page.wait_for_function(_IS_TOUCHING)


def take(page: Page, part: str, width: int) -> bytes:
    """Return a picture of a part of the page; for the scene in a wide window, of the complete window."""
    if part == "scene" and width == WIDE["width"]:
        return page.screenshot()
    element = {"scene": "#scene-view", "scope": "#scope", "materials": ".panels"}[part]
    if width == WIDE["width"]:
        return page.locator(element).screenshot()
    page.locator(element).evaluate("(each) => each.scrollIntoView({ block: 'start' })")
    return page.screenshot()


def take_all(page: Page) -> list[Path]:
    """Take all pictures of the loaded page, and return their paths."""
    taken: list[Path] = []
    page.evaluate("() => hapticd.tabs.show('materials-panel')")
    for part, params in (("scene", _STROKE), ("scope", _TAP), ("materials", _STROKE)):
        if part == "scope":
            page.get_by_role("button", name="Catch a tap").click()
        operate(page, params)
        if part == "scope":
            page.wait_for_function("() => hapticd.scope.tap !== null")
        for size in (WIDE, NARROW):
            page.set_viewport_size(size)  # type: ignore[arg-type]
            for scheme in ("light", "dark"):
                page.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
                # Two frames: canvases are drawn again in the frame after the change.
                page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
                narrow = "" if size is WIDE else f"-{size['width']}"
                taken.append(save(take(page, part, size["width"]), f"web-{part}-{scheme}{narrow}"))
    return taken


def take_session(browser: Browser, folder: Path) -> list[Path]:
    """Take the participant's page during a trial and the experimenter's page; return the paths."""
    running = Running(*run_study(folder, "okamura1998_tapping", "--demo"))
    session = Session(browser, running)
    try:
        session.open_both()
        session.begin()
        for key in ("1", "3", "2"):
            session.next_question()
            session.answer(key)
        session.next_question()
        session.press_on(1, 0.004)
        session.participant.set_viewport_size({"width": 1000, "height": 700})
        return [
            save(session.participant.screenshot(), "experiment-participant"),
            save(session.experimenter.screenshot(), "experiment-experimenter"),
        ]
    finally:
        session.close()


def take_report(browser: Browser, folder: Path) -> Path:
    """Take the top of a report of four simulated participants and those of the paper; return the path."""
    people = [word for name in "ABCD" for word in ("--participant", f"simulated:{name}")]
    data, report = folder / "simulated", folder / "simulated.html"
    for words in (
        ["run", "okamura1998_texture", *people, "--offline", "-o", str(data)],
        ["analyze", str(data), "-o", str(report)],
    ):
        subprocess.run([sys.executable, "-m", "hapticd", "experiment", *words], check=True, capture_output=True)
    page = browser.new_page(viewport={"width": 1000, "height": 640})
    page.goto(report.as_uri())
    return save(page.screenshot(), "experiment-report")


def main() -> int:
    with tempfile.TemporaryDirectory() as folder, running_browser() as browser, running_demo(Path(folder)) as demo:
        pages = Pages(browser.new_context(viewport=WIDE, reduced_motion="reduce"), demo)  # type: ignore[arg-type]
        page = pages.open()
        for path in (*take_all(page), *take_session(browser, Path(folder)), take_report(browser, Path(folder))):
            print(f"{path.relative_to(IMAGES.parents[1])}: {path.stat().st_size / 1024:.0f} KiB")
        problems = pages.take_errors()
    for problem in problems:
        print(problem, file=sys.stderr)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
