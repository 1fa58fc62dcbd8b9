"""Common mistakes in YAML, each reported in one line with its place.

Each mistake is in a scene or a configuration that is valid without it.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

from hapticd.base import yaml_source
from hapticd.base.errors import InvalidError
from hapticd.config.configuration import load_config

PARSERS = [yaml.BaseLoader] + ([yaml.CBaseLoader] if yaml.__with_libyaml__ else [])
HONEY = "{kind: viscous, damping_n_s_per_m: 1}"
FLOOR = "{kind: wall, point_m: [0, 0], normal: [0, 1], material: glass}"


@pytest.fixture(params=PARSERS, ids=lambda parser: parser.__name__, autouse=True)
def parser(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run every test with PyYAML's Python parser and with libyaml's."""
    monkeypatch.setattr(yaml_source, "_YAML_LOADER", request.param)


def floor(old: str, new: str) -> str:
    """Return a scene of a floor with a mistake in it."""
    assert FLOOR.count(old) == 1
    return f"objects:\n  floor: {FLOOR.replace(old, new)}\n"


BLOCK = "objects:\n  floor:\n    kind: wall\n    point_m: [0, 0]\n    normal: [0, 1]\n    material: glass\n"

SLIPS = {
    "a tab": ("scene:\n\tobjects: {}\n", "f:2:1: a tab; YAML is indented by spaces"),
    "a tab below a mapping": (
        f"objects:\n  honey:\n\tkind: viscous\n  b: {HONEY}\n",
        "f:3:1: a tab; YAML is indented by",
    ),
    "a tab behind spaces": (f"objects:\n  \thoney: {HONEY}\n", "f:2:3: a tab; YAML is indented by spaces"),
    "a tab after a value": ("servo:\n  priority: 10\n\tspin_us: 0\n", "f:3:1: a tab; YAML is indented by spaces"),
    "curly quotes for a number": ("servo: {priority: \u201c10\u201d}\n", "; quotes are straight: "),
    "not indented": (
        f"objects:\nhoney: {HONEY}\n",
        "f:1:1: objects: should be a mapping, is null; f:2:1: honey: unknown key; known: display, ",
    ),
    "a decimal comma": (
        "servo:\n  spin_us: 0,5\n",
        'should be a valid number, is "0,5"; decimals have a point, not a comma',
    ),
    "a key that is nearly one": (f"objcts:\n  honey: {HONEY}\n", "f:1:1: objcts: unknown key; known: servo, device, "),
    "another key that is nearly one": (floor("normal", "normals"), "normals: unknown key; did you mean normal?"),
    "a kind that is nearly one": (
        f"objects:\n  honey: {HONEY.replace('s,', 's_,')}\n",
        "should be one of 'wall', ",
    ),
    "a material that is nearly one": (floor("glass", "Glas"), 'unknown material "Glas"; did you mean glass?'),
    "a choice that is nearly one": ("servo: {realtime: prefered}\n", "should be 'required', 'preferred' or 'off', is "),
}
OTHERS = {
    "no-break spaces": f"objects:\n\xa0\xa0honey: {HONEY}\n",
    "no colon after a mapping's key": f"scene:\n  objects\n    honey: {HONEY}\n",
    "no colon in the first line": f"objects\n  honey: {HONEY}\n",
    "no colon before a value": "servo:\n  rate_hz 1000\n  priority: 1\n",
    "no colon in the last line": "servo:\n  priority: 1\n  rate_hz 1000\n",
    "no colon, comments between": f"scene:\n  objects  # here\n\n    # and here\n    honey: {HONEY}\n",
    "no colon, and nothing else": "servo:\n  rate_hz 1000\n",
    "no colon in braces": floor("kind:", "kind"),
    "no colon before a bracket": floor("point_m:", "point_m"),
    "no space after a colon": "servo:\n  rate_hz:1000\n  priority: 1\n",
    "no space after the only colon": "servo:\n  rate_hz:1000\n",
    "no space after a colon in braces": floor("kind: ", "kind:"),
    "equals": "servo:\n  rate_hz = 1000\n  priority: 1\n",
    "two colons": "servo:\n  rate_hz: priority: 10\n",
    "a brace not closed": f"objects:\n  floor: {FLOOR[:-1]}\n  honey: {HONEY}\n",
    "the last brace not closed": f"objects:\n  honey: {HONEY[:-1]}\n",
    "a bracket not closed": floor("[0, 0]", "[0, 0"),
    "a bracket of a line not closed": BLOCK.replace("0]", "0"),
    "a bracket not opened": BLOCK.replace("[0, 0", "0, 0"),
    "a bracket too many": BLOCK.replace("0, 0]", "0, 0]]"),
    "a brace too many": f"objects:\n  honey: {HONEY}}}\n",
    "no comma in braces": f"objects:\n  honey: {HONEY.replace(',', '')}\n",
    "no comma after a list": floor("0], n", "0] n"),
    "no comma in a list": floor("[0, 0]", "[0 0]"),
    "round brackets": floor("[0, 0]", "(0, 0)"),
    "a quote not closed": f'objects:\n  "honey: {HONEY}\n',
    "a quote closed by the next": 'servo:\n  realtime: "off\n  clock: "timer"\n',
    "an apostrophe not closed": "servo:\n  realtime: 'off\n  clock: timer\n",
    "indented too far": "servo:\n  rate_hz: 1000\n    priority: 10\n",
    "indented by less than beside": "objects:\n    honey:\n        kind: viscous\n      damping_n_s_per_m: 1\n",
    "the first line indented": "  servo: {}\ndevice: {}\n",
    "an at sign": "servo:\n  realtime: @off\n",
    "a comment of another language": f"objects: {{a: {HONEY}}} // b\n",
    "the fence of a page": "```yaml\nobjects: {}\n```\n",
    "the end of a here document": f"objects:\n  a: {HONEY}\nEOF\n",
    "a backslash in double quotes": 'flight: {directory: "C:\\data"}\n',
    "a dash without a space": BLOCK.replace("[0, 0]", "\n      -0\n      -0"),
}
"""The texts for these mistakes come from the parser or from pydantic."""


def refused(text: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Return the error for a file named "f"."""
    monkeypatch.chdir(folder)
    Path("f").write_text(text)
    with pytest.raises(InvalidError) as caught:
        load_config("f")
    return str(caught.value)


@pytest.mark.parametrize("name", SLIPS)
def test_slips_are_called_by_their_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    text, expected = SLIPS[name]
    message = refused(text, tmp_path, monkeypatch)
    assert expected in message, message
    assert message.isprintable()


@pytest.mark.parametrize("name", OTHERS)
def test_each_slip_is_one_line_with_its_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    message = refused(OTHERS[name], tmp_path, monkeypatch)
    assert re.match(r"f:\d+:\d+: \S", message) and message.isprintable(), message


def test_tabs_between_braces_are_white_space_where_the_parser_takes_them() -> None:
    text = "{\n\ta: 1,\n\tb: c: 2}"
    with pytest.raises(InvalidError) as caught:
        yaml_source.load_text(text, "f")
    assert str(caught.value) == "f:2:1: a tab; YAML is indented by spaces" or str(caught.value).startswith("f:3:")
