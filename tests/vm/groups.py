"""The guest's group file. It begins as the host's, so a group that a job needs may be there already."""

from __future__ import annotations


def with_group(text: str, name: str, gid: int) -> str:
    """This group file with one group of this name, which has this number. The others stay."""
    lines = [line for line in text.splitlines() if line.split(":")[0] != name]
    return "\n".join([*lines, f"{name}:x:{gid}:"]) + "\n"
