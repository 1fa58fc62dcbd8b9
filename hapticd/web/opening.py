"""Opens addresses in the browser of this machine, where it has one and a screen."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import click

from hapticd.web import door

_SCREENS: Final = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")
_OPENER: Final = "import sys, webbrowser; sys.exit(not webbrowser.open(sys.argv[1]))"


async def open_in_browser(addresses: Sequence[str]) -> None:
    """Opens the addresses in the browser, or says on stderr that there is none. Until cancelled.

    The browser is told the names of files that lead to them: its command line, with the token, could be read by every
    user of this machine. The files stay until we end.
    """
    with tempfile.TemporaryDirectory(prefix="hapticd-open-") as folder:
        opened = any(map(os.environ.get, _SCREENS))
        for number, address in enumerate(addresses):
            path = Path(folder, f"open-{number}.html")
            with open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
                file.write(door.leads_to(address))
            opened = opened and await _opened(path.as_uri())
        if not opened:
            what = "the address" if len(addresses) == 1 else "the addresses"
            click.echo(f"no browser can be opened here: open {what} above", err=True)
        await asyncio.Event().wait()


async def _opened(uri: str) -> bool:
    """In a process: what a browser prints is none of ours, and one in a terminal would not come back."""
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-c", _OPENER, uri),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    return await process.wait() == 0
