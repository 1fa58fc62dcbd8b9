"""A network namespace of the kernel, which stands for another machine on the network."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple


class NoNamespaceError(Exception):
    """Why there can be no network namespace here."""


class Elsewhere(NamedTuple):
    """A network namespace; `here` is our address in its eyes, `there` its own."""

    name: str
    here: str
    there: str

    def command(self, *words: str) -> list[str]:
        """What runs this Python in it."""
        return ["ip", "netns", "exec", self.name, sys.executable, *words]


@contextmanager
def network_namespace() -> Iterator[Elsewhere]:
    """Addresses by the process's number, as other test runs have theirs. Raises NoNamespaceError."""
    if os.geteuid() != 0 or shutil.which("ip") is None:
        raise NoNamespaceError("network namespaces need root and iproute2")
    pid = os.getpid()
    name = f"hapticd-{pid}"
    ends = f"hd{pid}a", f"hd{pid}b"
    here, there = (f"10.213.{pid >> 6 & 255}.{(pid & 63) << 2 | end}" for end in (1, 2))

    def ip(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(["ip", *arguments], capture_output=True, text=True)

    if ip("netns", "add", name).returncode:
        raise NoNamespaceError("network namespaces are not allowed here")
    try:
        if ip("link", "add", ends[0], "type", "veth", "peer", "name", ends[1], "netns", name).returncode:
            raise NoNamespaceError("no virtual network interfaces here")
        for command in (
            ("addr", "add", f"{here}/30", "dev", ends[0]),
            ("link", "set", ends[0], "up"),
            ("-n", name, "addr", "add", f"{there}/30", "dev", ends[1]),
            ("-n", name, "link", "set", ends[1], "up"),
        ):
            done = ip(*command)
            assert done.returncode == 0, done.stderr
        yield Elsewhere(name, here, there)
    finally:
        ip("netns", "del", name)
        ip("link", "del", ends[0])
