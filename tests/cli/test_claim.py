"""`devices claim` and `release`, and the warning for devices whose resets are not noticed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hapticd.cli import main
from hapticd.daemon import status_text as status
from hapticd.hid import claim, discovery
from tests.support.hid_descriptors import Joystick
from tests.support.hid_tree import Kernel

STICK = "0003:2341:8036.0007"
PAD = "0003:045E:02FD.0008"
SILENT = Joystick(without=frozenset({0x92}))
"""A joystick without PID State, which does not report which effects play."""


@pytest.fixture
def kernel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Kernel:
    made = Kernel(tmp_path)
    made.plug(STICK, SILENT)
    made.plug(PAD, Joystick(without=frozenset({0x73})))
    monkeypatch.setattr(claim, "Claims", lambda: made.claims)
    monkeypatch.setattr(discovery, "find", made.all)
    return made


def said(kernel: Kernel, capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str]:
    code = main(["devices", *words])
    captured = capsys.readouterr()
    return code, (captured.out + captured.err).replace(str(kernel.root), "").strip()


def test_the_only_one_that_can_be_driven_is_claimed_and_released(
    kernel: Kernel, capsys: pytest.CaptureFixture[str]
) -> None:
    text = "/dev/hidraw7 (Stick) is claimed: other programs cannot open its event nodes; its driver is hid-generic"
    assert said(kernel, capsys, "claim") == (0, text)
    assert kernel.modes(STICK) == {0o600}
    assert said(kernel, capsys, "claim")[0] == 1
    text = "/dev/hidraw8 (Stick) is released: other programs may use it; its driver is hid-generic"
    assert said(kernel, capsys, "release") == (0, text)
    assert said(kernel, capsys, "release") == (1, "hapticd: no device is claimed; name one")


def test_as_json_and_by_name(kernel: Kernel, capsys: pytest.CaptureFixture[str]) -> None:
    code, text = said(kernel, capsys, "claim", "2341:8036", "--json")
    assert code == 0
    assert json.loads(text) == {"device": STICK, "path": "/dev/hidraw7", "driver": "hid-generic"}
    listed = json.loads(said(kernel, capsys, "--json")[1])
    assert [(item["claimed"], item["resets_seen"]) for item in listed] == [(False, None), (True, False)]
    path = kernel.found(STICK).path
    assert main(["devices", "release", path]) == 0


@pytest.mark.parametrize("what", ["claim", "release"])
def test_an_unknown_device_is_refused(kernel: Kernel, capsys: pytest.CaptureFixture[str], what: str) -> None:
    code, text = said(kernel, capsys, what, "1209:0001")
    assert code == 1 and text.startswith('hapticd: no HID device "1209:0001"; connected: ') and "\n" not in text


def test_one_of_several_devices_must_be_named(kernel: Kernel, capsys: pytest.CaptureFixture[str]) -> None:
    kernel.plug("0003:FFFF:2055.0009")
    code, text = said(kernel, capsys, "claim")
    assert code == 1 and text.startswith("hapticd: 2 devices can be driven; name one by its path: /dev/hidraw5 (Stick")


def test_the_list_warns_of_unseen_resets_and_names_the_remedy(
    kernel: Kernel, capsys: pytest.CaptureFixture[str]
) -> None:
    condition = "    /dev/hidraw5 does not report which of its effects play: a reset by another program is not noticed"
    action = "    `hapticd devices claim /dev/hidraw5` keeps other programs off"
    lines = said(kernel, capsys)[1].splitlines()
    assert lines[1:4] == ["    can be driven", condition, action]
    said(kernel, capsys, "claim")
    lines = said(kernel, capsys)[1].splitlines()
    assert lines[3:] == [
        "    can be driven",
        condition.replace("hidraw5", "hidraw7"),
        "    claimed: `hapticd devices release /dev/hidraw7` lets other programs use it again",
    ]


def test_the_status_warns_of_unseen_resets_with_duration_and_remedy() -> None:
    connection = dict.fromkeys(("name", "problem", "link_hz", "report_hz", "force_hz", "states", "resets"))
    connection |= {"path": "/dev/hidraw3", "state": "connected", "resets_seen": False, "foreign_effect_s": 0.0954}
    assert list(status._connection(connection))[1:] == [
        (
            "unseen",
            "/dev/hidraw3 does not report which of its effects play: a reset by another program is not noticed; "
            "an effect that it uploads lasts up to 95 ms",
        ),
        ("", "`hapticd devices claim /dev/hidraw3` keeps other programs off"),
    ]
    for seen in (True, None):
        assert len(list(status._connection(connection | {"resets_seen": seen}))) == 1
