"""The content of the scene's canvas: pixels of a colour, in CSS pixels, and written texts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from playwright.sync_api import Page

from tests.web.browser import Pages

# Draws, then finds the pixels of a colour of style.css within [left, top, right, bottom] of the canvas. Blended pixels
# at the edges of shapes do not count.
_FOUND = """([name, rect, within]) => {
  const { canvas, picture } = hapticd.scene;
  const ink = document.createElement("canvas").getContext("2d");
  ink.fillStyle = getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  ink.fillRect(0, 0, 1, 1);
  const wanted = ink.getImageData(0, 0, 1, 1).data;
  picture.drawAtOnce();
  const scale = canvas.width / canvas.clientWidth;
  const [left, top, right, bottom] = (rect ?? [0, 0, canvas.clientWidth, canvas.clientHeight])
    .map((value) => Math.round(value * scale));
  const size = [Math.max(1, right - left), Math.max(1, bottom - top)];
  const { data, width } = canvas.getContext("2d").getImageData(left, top, ...size);
  const found = { count: 0, left: Infinity, top: Infinity, right: -Infinity, bottom: -Infinity };
  for (let i = 0; i < data.length; i += 4) {
    if ([0, 1, 2].every((k) => Math.abs(data[i + k] - wanted[k]) <= within)) {
      const [x, y] = [(left + ((i / 4) % width)) / scale, (top + Math.floor(i / 4 / width)) / scale];
      found.count++;
      found.left = Math.min(found.left, x);
      found.right = Math.max(found.right, x);
      found.top = Math.min(found.top, y);
      found.bottom = Math.max(found.bottom, y);
    }
  }
  return found.count === 0 ? { count: 0 } : found;
}"""
_TEXTS = """() => {
  const { fillText } = CanvasRenderingContext2D.prototype;
  const texts = [];
  CanvasRenderingContext2D.prototype.fillText = function (text, x, y) {
    texts.push([text, x, y]);
    fillText.call(this, text, x, y);
  };
  try {
    hapticd.scene.picture.refresh();
    hapticd.scene.picture.drawAtOnce();
  } finally {
    CanvasRenderingContext2D.prototype.fillText = fillText;
  }
  return texts;
}"""


@contextmanager
def scene_page(pages: Pages, *parts: str) -> Iterator[Page]:
    """Open a page that shows only the scene and these parts; hidden parts draw nothing and cost no time."""
    page = pages.open()
    hidden = [part for part in ("scope",) if part not in parts]
    page.evaluate("(hidden) => hidden.forEach((id) => (document.getElementById(id).hidden = true))", hidden)
    page.wait_for_function("() => hapticd.samples.rows > 0 && hapticd.model.state !== null")
    try:
        yield page
    finally:
        page.close()
    errors = pages.take_errors()
    assert errors == [], errors


def pixels(page: Page, colour: str, rect: list[float] | None = None, within: int = 24) -> dict[str, float]:
    """Return `count`, the number of pixels of a colour of style.css, and their bounds `left`, `right`, `top`, `bottom`.

    A pixel counts if each component, 0 to 255, differs by at most `within`; lines thinner than two pixels need more.
    """
    found: dict[str, float] = page.evaluate(_FOUND, [colour, rect, within])
    return found


def texts(page: Page) -> list[tuple[str, float, float]]:
    """Return the texts of the picture with their positions: text, x, y."""
    return [(text, x, y) for text, x, y in page.evaluate(_TEXTS)]


def to_px(page: Page, point: list[float]) -> tuple[float, float]:
    """Convert a point of the plane, in m, to pixels of the canvas."""
    x, y = page.evaluate("(point) => hapticd.scene.transform.toPx(point)", point)
    return x, y


def on_page(page: Page, point: list[float]) -> tuple[float, float]:
    """Convert a point of the plane, in m, to pixels of the window, for the mouse."""
    box = page.evaluate(
        "() => { const { left, top } = hapticd.scene.canvas.getBoundingClientRect(); return [left, top]; }"
    )
    x, y = to_px(page, point)
    return box[0] + x, box[1] + y


def show(page: Page, state: Mapping[str, Any], touching: list[str]) -> None:
    """Show a moment in the scene, as of a recording; missing members are zero. `live` shows the present again."""
    names = ("position_m", "velocity_m_per_s", "contact_force_n", "vibration_force_n", "force_n")
    still = {name: [0.0, 0.0] for name in names}
    detail = {"state": {"tick": 0, "flags": 0, **still, **state}, "touching": touching}
    page.evaluate("(detail) => hapticd.view.dispatchEvent(new CustomEvent('playback', { detail }))", detail)


def live(page: Page) -> None:
    page.evaluate(
        "() => hapticd.view.dispatchEvent(new CustomEvent('playback', { detail: { state: null, touching: [] } }))"
    )
