"""The separate daemon of `hapticd web --demo`: the simulated joystick in the scene of DEMO_CONFIG_PATH."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Final, Self

from hapticd.base.errors import HapticdError
from hapticd.base.threads import end_with_parent
from hapticd.protocol import places
from hapticd.system.paths import RuntimePaths, daemon_paths

DEMO_CONFIG_PATH: Final = Path(__file__).parents[1] / "shipped" / "play.yaml"
_READY_TIMEOUT_S: Final = 60.0
"""Time in which the daemon must start; long, for slow machines."""
_END_TIMEOUT_S: Final = 5.0
"""Time in which the daemon must end after SIGTERM, before it is killed."""
_MAX_SHOWN_LOG_LINES: Final = 20
"""Maximum number of lines from the end of the daemon's log that an error shows."""


class DemoDaemon:
    """A daemon in a temporary folder that runs while the context lasts. Its log is shown only if it fails."""

    def __init__(self, configs: Sequence[str] = ()) -> None:
        """Run with the files `configs`, where later files override earlier ones, or with DEMO_CONFIG_PATH if empty."""
        self._configs = configs or (str(DEMO_CONFIG_PATH),)

    def __enter__(self) -> Self:
        self._folder = tempfile.TemporaryDirectory(prefix="hapticd-play-")
        self._log = Path(self._folder.name, "log")
        runtime = Path(self._folder.name, "run")
        command = [sys.executable, "-m", "hapticd", "--runtime-dir", str(runtime), "run"]
        for config in self._configs:
            command += ["-c", config]
        # HAPTICD_ variables are meant for the user's own daemon.
        environment = {name: value for name, value in os.environ.items() if not name.startswith("HAPTICD_")}
        with open(self._log, "wb") as log:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env=environment,
                start_new_session=True,
                preexec_fn=end_with_parent(os.getpid(), signal.SIGTERM),
            )
        try:
            runtime.mkdir(mode=0o700, exist_ok=True)
            self.place: RuntimePaths = daemon_paths(runtime)
            places.await_ready(self.place, _READY_TIMEOUT_S, lambda: self._process.poll() is not None)
            places.probe(self.place)
        except HapticdError:
            problem = HapticdError(f"the daemon of the demo did not start: {self._last_log_lines()}")
            self.__exit__(None, None, None)
            raise problem from None
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._process.poll() is None:
            self._process.terminate()
        try:
            self._process.wait(_END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._folder.cleanup()

    async def failed(self) -> str:
        """Wait until the daemon ends, and return an error text with its last log lines."""
        loop, ended = asyncio.get_running_loop(), asyncio.Event()
        descriptor = os.pidfd_open(self._process.pid)
        try:
            loop.add_reader(descriptor, ended.set)
            await ended.wait()
        finally:
            loop.remove_reader(descriptor)
            os.close(descriptor)
        return f"the daemon of the demo ended: {self._last_log_lines()}"

    def _last_log_lines(self) -> str:
        lines = self._log.read_text(errors="replace").split("\n")[-_MAX_SHOWN_LOG_LINES - 1 :]
        return "; ".join(line.strip() for line in lines if line.strip()) or "it logged nothing"
