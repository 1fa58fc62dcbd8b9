"""The page in a browser, with the servo at 10 kHz: frame rate, and latency of force, picture and sound.

Needs Chromium and playwright, a package for development.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.report import Advance, Options, Section, Table, verdict
from hapticd.base.errors import HapticdError

if TYPE_CHECKING:
    from playwright.sync_api import Page

PRESSED_M = (-0.005, -0.009)
"""The two heights below the floor between which the pointer moves."""
MOVES_PER_S = 8
LATENCIES_MS = (
    ("from pointer to force", "pointer_to_force_ms", 30.0),
    ("from sample to pixel", "sample_to_pixel_ms", 100.0),
)
AIM_FRAMES_PER_S, AIM_SOUND_MS, AIM_TAP_S = 50.0, 150.0, 10.0
_TAP = {"kind": "tap", "object": "floor", "at_m": 0.0, "speed_m_per_s": 0.2}


def first_tap(page: Page) -> None:
    """Let the hand tap, and wait until the oscilloscope shows the tap."""
    page.evaluate("() => hapticd.safety.engage()")
    page.evaluate("() => hapticd.scope.actions.catchTap()")
    page.evaluate("(gesture) => hapticd.link.call('set_operator', { gesture })", _TAP)
    page.wait_for_function("() => hapticd.scope.tap !== null")


def stroked(page: Page, seconds: float) -> dict[str, Any]:
    """Move the pointer below the floor for `seconds`, and return the timing that the page measured."""
    from tests.web.drawing import on_page

    page.evaluate("() => hapticd.sound.start()")
    page.mouse.move(*on_page(page, [0.01, 0.02]))
    page.mouse.down()
    page.mouse.move(*on_page(page, [0.01, PRESSED_M[0]]), steps=10)
    page.wait_for_function("() => hapticd.scene.moments.newest.contact[1] > 0.5")
    page.evaluate("() => hapticd.timing.start()")
    for index in range(round(seconds * MOVES_PER_S)):
        page.mouse.move(*on_page(page, [0.01, PRESSED_M[(index + 1) % 2]]))
        time.sleep(1 / MOVES_PER_S)
    found: dict[str, Any] = page.evaluate("() => hapticd.timing.report()")
    found["sound"] = page.evaluate("() => hapticd.sound.latency()")
    page.mouse.up()
    return found


def run(options: Options, advance: Advance) -> Section:
    """Start the demo several times, and return the section with latencies and frame rate."""
    from tests.web.browser import NAMES, WIDE, Pages, running_browser, running_demo

    if not any(map(shutil.which, NAMES)):
        raise HapticdError(f"no browser: none of {', '.join(NAMES)} is on PATH (Debian: apt install chromium)")
    starts, seconds = options.few(5, 1), 3.0 if options.quick else 30.0
    taps_s: list[float] = []
    found: dict[str, Any] = {}
    with (
        tempfile.TemporaryDirectory() as folder,
        running_browser("--autoplay-policy=no-user-gesture-required") as browser,
    ):
        for index in range(starts):
            begin = time.monotonic()
            with running_demo(Path(folder)) as demo:
                context = browser.new_context(viewport=WIDE)  # type: ignore[arg-type]
                page = Pages(context, demo).open()
                first_tap(page)
                taps_s.append(time.monotonic() - begin)
                if index == starts - 1:
                    found = stroked(page, seconds)
                context.close()
            advance((index + 1) / starts, f"start {index + 1}")
    frames = found["frames_per_s"]
    middle_s = sorted(taps_s)[len(taps_s) // 2]
    rows = [
        [
            "from `hapticd web --demo` to a tap in the oscilloscope, s",
            f"{middle_s:.1f}",
            "",
            verdict(middle_s, AIM_TAP_S),
        ],
        ["frames a second", f"{frames:.1f}", "", verdict(frames, AIM_FRAMES_PER_S, above=True)],
    ]
    for words, key, aim in LATENCIES_MS:
        each = found[key]
        rows.append([f"{words}, ms", f"{each['p50']:.1f}", f"{each['p95']:.1f}", verdict(each["p95"], aim)])
    sound = found["sound"]
    rows.append(["from sample to sound, ms", f"{sound['sum']:.1f}", "", verdict(sound["sum"], AIM_SOUND_MS)])
    return Section(
        "The page in a browser",
        [
            Table(
                "Chromium, headless, no graphics processor, 1280 x 800, scene and oscilloscope drawn, sound on, "
                f"servo at 10 kHz on the same machine; {seconds:g} s; aims of the rows: {AIM_TAP_S:g} s, "
                f"{AIM_FRAMES_PER_S:g}, 30 ms and 100 ms (p95), {AIM_SOUND_MS:g} ms",
                ["", "median", "p95", "reached"],
                rows,
            ),
            f"Samples lost: {found['samples_lost']}; movements of the pointer without a change of the force: "
            f"{found['pointer_to_force_ms']['unanswered']} of {found['pointer_to_force_ms']['count']}. The clocks of "
            f"page and daemon agree to {found['clock_error_ms']:.1f} ms.",
        ],
    )
