"""What people get wrong in YAML, and what they are told: the place of the slip itself, and its name.

Each slip stands in a scene or a configuration that is sound without it.
"""

from __future__ import annotations

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
    """Every test with PyYAML's own parser and with the one over libyaml."""
    monkeypatch.setattr(yaml_source, "_LOADER", request.param)


def floor(old: str, new: str) -> str:
    """A floor with a slip in it."""
    assert FLOOR.count(old) == 1
    return f"objects:\n  floor: {FLOOR.replace(old, new)}\n"


BLOCK = "objects:\n  floor:\n    kind: wall\n    point_m: [0, 0]\n    normal: [0, 1]\n    material: glass\n"

SLIPS = {
    "a tab": ("scene:\n\tobjects: {}\n", "f:2:1: a tab; YAML indents by spaces"),
    "a tab below a mapping": (f"objects:\n  honey:\n\tkind: viscous\n  b: {HONEY}\n", "f:3:1: a tab; YAML indents by"),
    "a tab behind spaces": (f"objects:\n  \thoney: {HONEY}\n", "f:2:3: a tab; YAML indents by spaces"),
    "a tab after a value": ("servo:\n  priority: 10\n\tspin_us: 0\n", "f:3:1: a tab; YAML indents by spaces"),
    "no-break spaces": (f"objects:\n\xa0\xa0honey: {HONEY}\n", "a no-break space stands where a space belongs"),
    "no colon after a mapping's key": (
        f"scene:\n  objects\n    honey: {HONEY}\n",
        "f:2:10: a colon is missing after objects",
    ),
    "no colon in the first line": (f"objects\n  honey: {HONEY}\n", "f:1:8: a colon is missing after objects"),
    "no colon before a value": ("servo:\n  rate_hz 1000\n  priority: 1\n", "f:2:10: a colon is missing after rate_hz"),
    "no colon in the last line": (
        "servo:\n  priority: 1\n  rate_hz 1000\n",
        "f:3:10: a colon is missing after rate_hz",
    ),
    "no colon, comments between": (
        f"scene:\n  objects  # here\n\n    # and here\n    honey: {HONEY}\n",
        "f:2:10: a colon is missing after objects",
    ),
    "no colon, and nothing else": ("servo:\n  rate_hz 1000\n", 'is "rate_hz 1000"; a colon is missing after rate_hz'),
    "no colon in braces": (
        floor("kind:", "kind"),
        "f:2:3: objects.floor.kind: is missing: a colon is missing after kind",
    ),
    "no colon before a bracket": (floor("point_m:", "point_m"), "f:2:30: a colon is missing after point_m"),
    "no space after a colon": ("servo:\n  rate_hz:1000\n  priority: 1\n", "f:2:10: a space is missing after rate_hz:"),
    "no space after the only colon": ("servo:\n  rate_hz:1000\n", "; a space is missing after rate_hz:"),
    "no space after a colon in braces": (floor("kind: ", "kind:"), "kind: is missing: a space is missing after kind:"),
    "equals": ("servo:\n  rate_hz = 1000\n  priority: 1\n", "f:2:10: after rate_hz belongs a colon, not ="),
    "two colons": ("servo:\n  rate_hz: priority: 10\n", "f:2:20: a second colon in a line"),
    "a brace not closed": (
        f"objects:\n  floor: {FLOOR[:-1]}\n  honey: {HONEY}\n",
        "f:2:10: the { that begins here is not closed by }",
    ),
    "the last brace not closed": (f"objects:\n  honey: {HONEY[:-1]}\n", "f:2:10: the { that begins here is not closed"),
    "a bracket not closed": (floor("[0, 0]", "[0, 0"), "f:2:32: the [ that begins here is closed by }, not by ]"),
    "a bracket of a line not closed": (BLOCK.replace("0]", "0"), "f:4:14: the [ that begins here is not closed by ]"),
    "a bracket not opened": (
        BLOCK.replace("[0, 0", "0, 0"),
        'f:4:5: objects.floor.point_m: must be two numbers [x, y], is "0, 0]"; the [ is missing',
    ),
    "a bracket too many": (BLOCK.replace("0, 0]", "0, 0]]"), "f:4:20: a ] too many: nothing is open that it would"),
    "a brace too many": (
        f"objects:\n  honey: {HONEY}}}\n",
        "f:2:47: a } too many: nothing is open that it would close",
    ),
    "no comma in braces": (
        f"objects:\n  honey: {HONEY.replace(',', '')}\n",
        "f:2:25: a comma is missing before damping",
    ),
    "no comma after a list": (floor("0], n", "0] n"), "f:2:39: a comma is missing before normal"),
    "no comma in a list": (floor("[0, 0]", "[0 0]"), 'must be a number, is "0 0"; between two numbers belongs a comma'),
    "round brackets": (floor("[0, 0]", "(0, 0)"), "lists stand in [ ], not in ( )"),
    "a quote not closed": (f'objects:\n  "honey: {HONEY}\n', 'f:2:3: the " that begins here is not closed'),
    "a quote closed by the next": (
        'servo:\n  realtime: "off\n  clock: "timer"\n',
        'f:2:13: the " that begins here is not',
    ),
    "an apostrophe not closed": ("servo:\n  realtime: 'off\n  clock: timer\n", "f:2:13: the ' that begins here is not"),
    "curly quotes for a number": ("servo: {priority: \u201c10\u201d}\n", "; quotes are straight: "),
    "indented too far": ("servo:\n  rate_hz: 1000\n    priority: 10\n", "f:3:5: indented deeper than the line above"),
    "indented by less than beside": (
        "objects:\n    honey:\n        kind: viscous\n      damping_n_s_per_m: 1\n",
        "f:4:7: indented by 6, but the lines above that it could belong to by 0 or 4 or 8",
    ),
    "not indented": (
        f"objects:\nhoney: {HONEY}\n",
        "f:1:1: objects: must be a mapping, is null: what belongs to it is ind",
    ),
    "the first line indented": ("  servo: {}\ndevice: {}\n", "f:2:1: indented by 0, but the lines above that it could"),
    "an at sign": ("servo:\n  realtime: @off\n", "f:2:13: @ cannot begin a value; put the value in quotes"),
    "a comment of another language": (
        f"objects: {{a: {HONEY}}} // b\n",
        "the value ends before this; a comment begins with",
    ),
    "the fence of a page": ("```yaml\nobjects: {}\n```\n", "f:1:1: ``` belongs to the page that this was copied from"),
    "the end of a here document": (f"objects:\n  a: {HONEY}\nEOF\n", "f:3:4: a colon is missing after EOF"),
    "a backslash in double quotes": (
        'flight: {directory: "C:\\data"}\n',
        "in double quotes a backslash begins an escape",
    ),
    "a decimal comma": ("servo:\n  spin_us: 0,5\n", 'must be a number, is "0,5"; decimals have a point, not a comma'),
    "a dash without a space": (BLOCK.replace("[0, 0]", "\n      -0\n      -0"), "after the - of a list a space"),
    "a key that is nearly one": (f"objcts:\n  honey: {HONEY}\n", "f:1:1: objcts: unknown key; did you mean objects?"),
    "another key that is nearly one": (floor("normal", "normals"), "normals: unknown key; did you mean normal?"),
    "a kind that is nearly one": (
        f"objects:\n  honey: {HONEY.replace('s,', 's_,')}\n",
        "did you mean viscous?",
    ),
    "a material that is nearly one": (floor("glass", "Glas"), 'unknown material "Glas"; did you mean glass?'),
    "a choice that is nearly one": ("servo: {realtime: prefered}\n", 'is "prefered"; did you mean preferred?'),
}


@pytest.mark.parametrize("name", SLIPS)
def test_slips_are_called_by_their_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    text, told = SLIPS[name]
    monkeypatch.chdir(tmp_path)
    Path("f").write_text(text)
    with pytest.raises(InvalidError) as caught:
        load_config("f")
    message = str(caught.value)
    assert told in message, message
    assert message.isprintable()


@pytest.mark.parametrize(
    "text",
    [
        "objects: {it's: {kind: viscous, damping_n_s_per_m: 1}}\nscene: {}\n  x: 1\n",
        "# it's a comment, with a [ and a {\nservo: {rate_hz: 1000}\n  x: 1\n",
        "flight: {directory: a[1}\n",
        "servo: {realtime: 'it''s'}\n  x: 1\n",
    ],
)
def test_what_is_no_quote_and_no_bracket_is_not_blamed(text: str) -> None:
    with pytest.raises(InvalidError) as caught:
        yaml_source.load_text(text, "f")
    assert "begins here is not closed" not in str(caught.value) or "directory" in text


def test_tabs_between_braces_are_white_space_where_the_parser_takes_them() -> None:
    text = "{\n\ta: 1,\n\tb: c: 2}"
    with pytest.raises(InvalidError) as caught:
        yaml_source.load_text(text, "f")
    takes_tabs = yaml_source._LOADER is not yaml.BaseLoader
    assert str(caught.value) == (
        "f:3:5: a comma is missing before c" if takes_tabs else "f:2:1: a tab; YAML indents by spaces"
    )
