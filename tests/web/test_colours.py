"""The colours of the page are readable: contrast as WCAG 2.2 AA requires, light and dark."""

from __future__ import annotations

import re

import pytest

from tests.web.vendored import ROOT

CSS = (ROOT / "hapticd" / "web" / "static" / "style.css").read_text()
GROUNDS = ("page", "surface", "sunken")
TEXT = ("text", "muted", "accent", "ok", "warn", "bad")
PLOTS = ("position", "velocity", "contact", "vibration", "force", "hand", "groove", "rupture")
PAIRS = [
    *((name, ground, 4.5) for name in (*TEXT, *PLOTS) for ground in GROUNDS),
    *((name, f"{name}-ground", 4.5) for name in ("accent", "ok", "warn", "bad")),
    ("on-accent", "accent", 4.5),
    ("on-stop", "stop", 4.5),
    *(("edge", ground, 3.0) for ground in GROUNDS),  # edges of controls: 1.4.11
]


def colours(theme: str) -> dict[str, str]:
    light, dark = re.findall(r":root \{(.*?)\n *\}", CSS, re.DOTALL)
    found = dict(re.findall(r"--([a-z-]+): (#[0-9a-f]{6});", light))
    return found if theme == "light" else found | dict(re.findall(r"--([a-z-]+): (#[0-9a-f]{6});", dark))


def luminance(colour: str) -> float:
    channels = (int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one: str, other: str) -> float:
    darker, lighter = sorted((luminance(one), luminance(other)))
    return (lighter + 0.05) / (darker + 0.05)


def test_contrast_is_that_of_known_pairs() -> None:
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.01)  # just too small


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_every_colour_has_contrast_on_its_grounds(theme: str) -> None:
    known = colours(theme)
    measured = [(a, b, round(contrast(known[a], known[b]), 2), least) for a, b, least in PAIRS]
    assert [each for each in measured if each[2] < each[3]] == []
