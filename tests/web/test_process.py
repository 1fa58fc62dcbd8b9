"""`hapticd web` as a process: its output, its end, and the end of a demo's daemon."""

from __future__ import annotations

import asyncio
import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import aiohttp
import pytest

from hapticd.cli import main
from hapticd.system.extras import install_command
from tests.support.daemon_process import PATIENCE_S, running_daemon, until
from tests.web.served import Tab, asked


class Web:
    """A process of `hapticd web`, and the address that it printed."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process
        self.address = self.line()

    def line(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline().strip()


@contextmanager
def running(folder: Path, *words: str, before: tuple[str, ...] = ()) -> Iterator[Web]:
    """Run `hapticd web` until the end of the block, then end it; its exit code must be 0."""
    with open(folder / "web.log", "wb") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "hapticd", *before, "web", "--port", "0", *words],
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
            env={name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")},
        )
    assert process.stdout is not None
    try:
        yield Web(process)
    finally:
        if process.poll() is None:
            process.terminate()
        rest = process.stdout.read()
        process.stdout.close()
        code = process.wait(PATIENCE_S)
    if code != -signal.SIGKILL:
        assert (code, rest) == (0, ""), (folder / "web.log").read_text()


def refusal(capfd: pytest.CaptureFixture[str], *words: str) -> str:
    """Return the single error line of a refused command."""
    assert main(list(words)) != 0
    out, err = capfd.readouterr()
    assert out == "" and err.count("\n") == 1, err
    return err


def children(pid: int) -> list[int]:
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def alive(pid: int) -> bool:
    try:
        return ") Z " not in Path(f"/proc/{pid}/stat").read_text()
    except FileNotFoundError:
        return False


@pytest.mark.slow
def test_a_demo_prints_one_line_and_ends_with_its_daemon(tmp_path: Path) -> None:
    with running(tmp_path, "--demo", "--open") as web:
        assert re.fullmatch(r"http://127\.0\.0\.1:[0-9]+/\?token=[\w-]{43}", web.address)
        assert asyncio.run(asked(web.address, "web.hello"))["result"]["demo"] is True
        web.process.send_signal(signal.SIGUSR1)
        assert asyncio.run(asked(web.line(), "get_status"))["result"]["device"] == "sim"
        (daemon,) = children(web.process.pid)
    assert not alive(daemon)
    assert (tmp_path / "web.log").read_text() == "no browser can be opened here: open the address above\n"


@pytest.mark.slow
def test_a_demo_that_is_killed_takes_its_daemon_along(tmp_path: Path) -> None:
    with running(tmp_path, "--demo") as web:
        (daemon,) = children(web.process.pid)
        web.process.kill()
        until(lambda: not alive(daemon))


@pytest.mark.slow
def test_it_ends_at_once_with_pages_open_that_do_not_read(tmp_path: Path) -> None:
    async def test(web: Web) -> None:
        origin = web.address.partition("/?")[0]
        async with aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as session:
            async with session.get(web.address):
                pass
            sockets = [
                await session.ws_connect(f"{origin}/socket", headers={"Origin": origin}, autoping=False)
                for _ in range(20)
            ]
            for page in sockets:
                await Tab(page).call("web.subscribe", {"topics": ["samples", "state"]})
            web.process.terminate()
            assert await asyncio.to_thread(web.process.wait, PATIENCE_S) == 0
            for page in sockets:
                await page.close()

    with running(tmp_path, "--demo") as web:
        asyncio.run(test(web))


@pytest.mark.slow
def test_a_restarted_daemon_is_found_again(tmp_path: Path) -> None:
    async def test(address: str, daemon: int, command: list[str]) -> None:
        origin = address.partition("/?")[0]
        async with aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as session:
            async with session.get(address):
                pass
            async with session.ws_connect(f"{origin}/socket", headers={"Origin": origin}) as page:
                tab = Tab(page)
                await tab.daemon_there()
                await tab.call("web.subscribe", {"topics": ["status"]})
                os.kill(daemon, signal.SIGTERM)
                while (await tab.telemetry("daemon"))["daemon"]:
                    pass
                with subprocess.Popen(command, stderr=subprocess.DEVNULL) as again:
                    try:
                        await tab.daemon_there()
                        assert (await tab.telemetry("status"))["device"] == "sim"
                    finally:
                        again.terminate()

    with running_daemon() as daemon:
        place = ("--runtime-dir", str(daemon.directory))
        with running(tmp_path, before=place) as web:
            asyncio.run(test(web.address, daemon.process.pid, [sys.executable, "-m", "hapticd", *place, "run"]))


@pytest.mark.slow
def test_without_a_daemon_it_reports_this_and_waits(tmp_path: Path) -> None:
    with running(tmp_path, before=("--runtime-dir", str(tmp_path / "none"))) as web:
        assert asyncio.run(asked(web.address, "web.hello"))["result"]["daemon"] is False
    assert "no daemon at" in (tmp_path / "web.log").read_text()


@pytest.mark.slow
def test_a_failed_start_is_reported_in_one_line(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    assert "--tls-key and --password-file are missing" in refusal(capfd, "web", "--host", "0.0.0.0", "--tls-cert", "x")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        assert f"--port {port}: is in use" in refusal(capfd, "web", "--port", port)
    assert "--config needs --demo" in refusal(capfd, "web", "-c", "play.yaml")
    assert "cannot be combined with --runtime-dir" in refusal(capfd, "--runtime-dir", str(tmp_path), "web", "--demo")
    broken = tmp_path / "play.yaml"
    broken.write_text("servo: {rate_hz: none}\n")
    line = refusal(capfd, "web", "--demo", "-c", str(broken), "--port", "0")
    assert "the daemon of the demo did not start: " in line and "rate_hz" in line
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert refusal(capfd, "web") == f"hapticd: hapticd web needs aiohttp: {install_command('web')}\n"


@pytest.mark.slow
def test_a_password_is_set_from_a_pipe(tmp_path: Path) -> None:
    path = tmp_path / "password"
    words = [sys.executable, "-m", "hapticd", "web", "--set-password", str(path)]
    done = subprocess.run(words, input="rosewood comb\n", text=True, capture_output=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert path.read_text().startswith("scrypt:")
