"""The event and joystick nodes of a HID device: what other programs use of it."""

from __future__ import annotations

import os
import re
import stat
from pathlib import Path


def event_nodes(device: Path) -> list[str]:
    """Names of them below /dev/input, in the order of their numbers. `device`: the HID device in sysfs; none of one
    that is gone or cannot be read."""
    try:
        entries = [entry for entry in device.glob("input/input*/*") if re.fullmatch(r"(event|js)\d+", entry.name)]
    except OSError:
        return []
    return [entry.name for entry in sorted(entries, key=lambda entry: (*_number(entry.parent), *_number(entry)))]


def _number(entry: Path) -> tuple[int, str]:
    return int(re.sub(r"\D", "", entry.name) or 0), entry.name


def is_for_others(node: Path) -> bool:
    """Whether anybody but its owner may use a node; false of one that is not there."""
    try:
        return bool(os.stat(node).st_mode & (stat.S_IRWXG | stat.S_IRWXO))
    except OSError:
        return False
