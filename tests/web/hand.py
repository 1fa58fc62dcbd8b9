"""The hand of the simulated joystick, moved by a test of the page, and the forces in its samples."""

from __future__ import annotations

from playwright.sync_api import Page

_PRESSED = """() => {
  const { columns, rows, capacity } = hapticd.samples;
  return rows > 0 && columns.force_y_n[(rows - 1) % capacity] > 0.3;
}"""
_ZERO = """() => {
  const { columns, rows, capacity } = hapticd.samples;
  return columns.force_x_n[(rows - 1) % capacity] === 0 && columns.force_y_n[(rows - 1) % capacity] === 0;
}"""
_LAST_FORCE = """() => {
  const { samples, timing } = hapticd;
  const { columns, capacity } = samples;
  let row = samples.rows - 1;
  while (row >= samples.first && columns.force_x_n[row % capacity] === 0 && columns.force_y_n[row % capacity] === 0) {
    row--;
  }
  return timing.timeOf(row);
}"""


def press(page: Page) -> None:
    """Press the floor with the hand, and wait for its force."""
    page.evaluate("() => hapticd.link.call('set_operator', { waypoints: [[0.1, 0.01, 0.005], [0.2, 0.01, -0.004]] })")
    page.wait_for_function(_PRESSED)


def wait_for_no_force(page: Page) -> None:
    page.wait_for_function(_ZERO)


def now_ms(page: Page) -> float:
    """Return performance.now() of the page, once the page has compared its clock with that of the samples."""
    page.evaluate("() => hapticd.timing.compareClocks()")
    return float(page.evaluate("() => performance.now()"))


def last_force_ms(page: Page) -> float:
    """Return the time of the last force that was not zero, on the page's clock, in ms; call now_ms before."""
    return float(page.evaluate(_LAST_FORCE))


def engage(page: Page) -> bool:
    """Take control of the forces, as a press on the scene does."""
    return bool(page.evaluate("() => hapticd.safety.begin()"))
