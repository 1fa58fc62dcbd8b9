"""The udev rule for joysticks: which devices it names, and how it recognises those of the PID class."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

from tests.support.firmware_descriptors import ADAPT_FFB_JOY, FINO, OPENFFBOARD_1, OPENFFBOARD_2, SIDEWINDER_FF2
from tests.support.hid_descriptors import Joystick

ROOT = Path(__file__).parents[2]
RULE = (ROOT / "systemd" / "70-hapticd.rules").read_text()
KNOWN = [line for line in RULE.splitlines() if 'ENV{HAPTICD_KNOWN}="1"' in line]
PLAIN = bytes.fromhex("05010904a101093009311500 26ff0375109502 8102c0")
"""A joystick without forces."""


def known() -> list[str]:
    """Return VENDOR:PRODUCT of the named devices."""
    return [name for line in KNOWN for name in re.findall(r"\*:([0-9A-F]{4}:[0-9A-F]{4})\.\*", line)]


def test_each_known_device_is_named_once_as_the_kernel_writes_it() -> None:
    names = known()
    assert len(names) == len(set(names)) > 30
    for line in KNOWN:
        patterns = line.split('"')[1].split("|")
        assert line.startswith('KERNELS=="') and all(
            re.fullmatch(r"\*:[0-9A-F]{4}:[0-9A-F]{4}\.\*", pattern) for pattern in patterns
        )
    families = "045E:001B 03EB:2056 2341:8036 1209:FFB0 FFFF:2055 346E:1000 16D0:0D5A 0483:A355 045B:58F9"
    assert set(families.split()) <= set(names)


def test_no_other_file_has_the_numbers() -> None:
    """Only the rule has the numbers of boards and vendors; tests and examples may name a device."""
    paths = [path for folder in ("hapticd", "docs") for path in (ROOT / folder).rglob("*")]
    text = "\n".join(path.read_text() for path in paths if path.suffix in (".py", ".md")).lower()
    # The example in the documentation.
    assert [name for name in known() if name.lower() in text] in ([], ["045E:001B"])


@pytest.mark.parametrize(
    ("descriptor", "is_pid"),
    [
        *((descriptor, True) for descriptor in (ADAPT_FFB_JOY, FINO, OPENFFBOARD_1, OPENFFBOARD_2, SIDEWINDER_FF2)),
        (bytes(Joystick()), True),
        (PLAIN, False),
    ],
)
def test_the_pid_class_is_recognised_by_the_report_descriptor(tmp_path: Path, descriptor: bytes, is_pid: bool) -> None:
    patterns = re.findall(r"/bin/grep -q?s?aP '([^']+)'", RULE)
    assert len(patterns) == 2 and patterns[0] == patterns[1]
    here = tmp_path / "report_descriptor"
    here.write_bytes(descriptor)
    # A file that does not exist does not matter: event nodes lie deeper than hidraw nodes.
    command = ["/bin/grep", "-qsaP", patterns[0], str(tmp_path / "none"), str(here)]
    assert (subprocess.run(command, check=False).returncode == 0) == is_pid
