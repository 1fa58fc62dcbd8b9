"""Opening addresses in the browser of this machine, if it has a browser and a screen."""

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

_SCREEN_VARIABLES: Final = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")
"""A browser can be opened only if one of these environment variables is set."""
_OPENER_SCRIPT: Final = "import sys, webbrowser; sys.exit(not webbrowser.open(sys.argv[1]))"
"""Python program that opens its argument in a browser."""


async def open_in_browser(addresses: Sequence[str]) -> None:
    """Open the addresses in the browser, or print on stderr that this is not possible; then wait until cancelled.

    The browser gets files that redirect to the addresses: an address contains the token, and every user of this machine
    can read the browser's command line. The files exist until the call ends.
    """
    with tempfile.TemporaryDirectory(prefix="hapticd-open-") as folder:
        opened = any(map(os.environ.get, _SCREEN_VARIABLES))
        for number, address in enumerate(addresses):
            path = Path(folder, f"open-{number}.html")
            with open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
                file.write(door.redirect_page(address))
            opened = opened and await _opened(path.as_uri())
        if not opened:
            what = "the address" if len(addresses) == 1 else "the addresses"
            click.echo(f"no browser can be opened here: open {what} above", err=True)
        await asyncio.Event().wait()


async def _opened(uri: str) -> bool:
    """Open a browser in a process that neither prints nor blocks this one, and return whether a browser was opened."""
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-c", _OPENER_SCRIPT, uri),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    return await process.wait() == 0
