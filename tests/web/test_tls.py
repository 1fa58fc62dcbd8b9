"""`hapticd web` for other machines, as in docs/web.md: from password and TLS to telemetry, and refused requests."""

from __future__ import annotations

import asyncio
import json
import socket
import ssl
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import aiohttp
import numpy as np
import pytest
from aiohttp.abc import AbstractResolver, ResolveResult
from aiohttp.connector import AddrInfoType

from tests.support.daemon_process import PATIENCE_S, Daemon, running_daemon
from tests.support.network_namespace import NoNamespaceError, network_namespace
from tests.web.served import Tab, until
from tests.web.test_process import Web, refusal, running

pytestmark = pytest.mark.slow

PASSWORD = "rosewood comb"
NAME = "haptics.test"
UPGRADE = {
    "Connection": "Upgrade",
    "Upgrade": "websocket",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
}
ROOT = Path(__file__).parents[2]


class Files(NamedTuple):
    """Paths of certificate, key and password file."""

    cert: Path
    key: Path
    password: Path

    @property
    def options(self) -> tuple[str, ...]:
        return ("--tls-cert", str(self.cert), "--tls-key", str(self.key), "--password-file", str(self.password))


def made(folder: Path, *names: str) -> Files:
    """Make a certificate for these names with openssl, and a password file with `hapticd web --set-password`."""
    files = Files(folder / "cert.pem", folder / "key.pem", folder / "password")
    subprocess.run(
        [
            *("openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"),
            *("-days", "2", "-subj", "/CN=lab", "-addext", f"subjectAltName={','.join(names)}"),
            *("-keyout", str(files.key), "-out", str(files.cert)),
        ],
        check=True,
        capture_output=True,
    )
    command = [sys.executable, "-m", "hapticd", "web", "--set-password", str(files.password)]
    subprocess.run(command, input=PASSWORD + "\n", text=True, check=True, capture_output=True)
    return files


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    config = tmp_path_factory.mktemp("config") / "slow.yaml"
    config.write_text("servo: {rate_hz: 1000, realtime: off}\n")
    with running_daemon("-c", str(config)) as daemon:
        yield daemon


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Files:
    return made(tmp_path_factory.mktemp("tls"), f"DNS:{NAME}")


@pytest.fixture(scope="module")
def web(files: Files, daemon: Daemon, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Web]:
    """Run `hapticd web` on all addresses of this machine, for clients that use the name NAME."""
    folder = tmp_path_factory.mktemp("web")
    place = ("--runtime-dir", str(daemon.directory))
    with running(folder, "--host", "0.0.0.0", *files.options, before=place) as web:
        yield web
    assert "Traceback" not in (folder / "web.log").read_text()


@pytest.fixture(scope="module")
def cookie(web: Web, files: Files) -> dict[str, str]:
    """Return the cookie header of a browser with access, one for all tests because tries of passwords are limited."""

    async def test() -> str:
        async with session(files.cert, Here()) as browser:
            status, _, cookie = await log_in(browser, origin_of(web), PASSWORD)
            assert status == 303
            return cookie.partition(";")[0]

    return {"Cookie": asyncio.run(test())}


class Here(AbstractResolver):
    """Resolves every name to this machine."""

    async def resolve(
        self, host: str, port: int = 0, family: socket.AddressFamily = socket.AF_INET
    ) -> list[ResolveResult]:
        return [ResolveResult(hostname=host, host="127.0.0.1", port=port, family=socket.AF_INET, proto=0, flags=0)]

    async def close(self) -> None:
        pass


@asynccontextmanager
async def session(cert: Path, resolver: AbstractResolver | None = None) -> AsyncIterator[aiohttp.ClientSession]:
    """Yield a browser that trusts only this certificate; afterwards all its TLS connections have ended."""
    opened: list[socket.socket] = []

    def new_socket(found: AddrInfoType) -> socket.socket:
        opened.append(socket.socket(*found[:3]))
        return opened[-1]

    trusts = ssl.create_default_context(cafile=str(cert))
    connector = aiohttp.TCPConnector(ssl=trusts, resolver=resolver, socket_factory=new_socket)
    async with aiohttp.ClientSession(connector=connector, cookie_jar=aiohttp.CookieJar(unsafe=True)) as browser:
        yield browser
    await until(lambda: all(each.fileno() < 0 for each in opened))


async def log_in(browser: aiohttp.ClientSession, origin: str, password: str) -> tuple[int, str, str]:
    """Send the login form, and return status, text and cookie of the answer."""
    given = {"data": {"password": password}, "headers": {"Origin": origin}, "allow_redirects": False}
    async with browser.post(f"{origin}/login", **given) as response:  # type: ignore[arg-type]
        return response.status, await response.text(), response.headers.get("Set-Cookie", "")


def dtype(batch: dict[str, Any]) -> np.dtype[np.void]:
    return np.dtype([(name, form, *map(tuple, rest)) for name, form, *rest in batch["dtype"]])


async def visited(browser: aiohttp.ClientSession, origin: str) -> dict[str, Any]:
    """Visit as a user: the form, a wrong password, the right one, the page, its socket, telemetry."""
    found: dict[str, Any] = {}
    async with browser.get(origin) as response:
        found["at first"] = response.status, response.url.path, "Password" in await response.text()
    found["wrong"] = await log_in(browser, origin, "rosewood chair")
    found["right"] = await log_in(browser, origin, PASSWORD)
    async with browser.get(origin) as response:
        found["then"] = response.status, response.url.path
    async with browser.ws_connect(f"{origin}/socket".replace("https", "wss"), headers={"Origin": origin}) as socket:
        tab = Tab(socket)
        found["device"] = (await tab.call("get_status"))["result"]["device"]
        await tab.call("web.subscribe", {"topics": ["samples"]})
        batches = [await tab.telemetry("samples") for _ in range(3)]
    found["batches"] = [
        (batch["first_tick"], len(np.frombuffer(batch["data"], dtype(batch))), batch["dropped"]) for batch in batches
    ]
    return found


def check(found: dict[str, Any]) -> None:
    assert list(found["at first"]) == [200, "/login", True]
    status, text, cookie = found["wrong"]
    assert status == 403 and "Wrong password." in text and cookie == ""
    status, _, cookie = found["right"]
    assert status == 303 and cookie.startswith("__Host-hapticd-")
    for word in ("Secure", "HttpOnly", "SameSite=Strict", "Path=/"):
        assert word in cookie.split("; ")
    assert list(found["then"]) == [200, "/"]
    assert found["device"] == "sim"
    for (first, count, dropped), (after, _, more) in pairwise(found["batches"]):
        assert count > 0 and after == first + count + more - dropped


def origin_of(web: Web) -> str:
    return web.address.partition("/?")[0]


def test_from_the_password_to_telemetry(web: Web, files: Files) -> None:
    async def test() -> dict[str, Any]:
        async with session(files.cert, Here()) as browser:
            return await visited(browser, origin_of(web))

    assert origin_of(web).startswith(f"https://{NAME}:")
    check(asyncio.run(test()))


def test_the_printed_address_lets_in_over_tls(web: Web, files: Files) -> None:
    async def test() -> None:
        async with session(files.cert, Here()) as browser:
            async with browser.get(web.address) as response:
                assert (response.status, response.url.path) == (200, "/")
            headers = {"Origin": origin_of(web)}
            async with browser.ws_connect(f"{origin_of(web)}/socket", headers=headers) as socket:
                page = Tab(socket)
                await page.daemon_there()
                assert (await page.call("web.hello"))["result"]["daemon"] is True

    asyncio.run(test())


def test_without_tls_nothing_is_answered(web: Web) -> None:
    port = int(origin_of(web).rpartition(":")[2])
    with socket.create_connection(("127.0.0.1", port), PATIENCE_S) as plain:
        plain.sendall(f"GET /login HTTP/1.1\r\nHost: {NAME}:{port}\r\n\r\n".encode())
        answer = b""
        while block := plain.recv(4096):
            answer += block
    assert b"HTTP" not in answer


@pytest.mark.parametrize(
    ("headers", "problem"),
    [
        ({"Host": "evil.example"}, "Host: this address is not served here\n"),
        ({"Host": "127.0.0.1"}, "Host: this address is not served here\n"),
        ({"Origin": "https://evil.example"}, "Origin: only pages of this server may do this\n"),
        ({"Origin": f"http://{NAME}"}, "Origin: only pages of this server may do this\n"),
        ({}, "Origin: is missing; only pages of this server may do this\n"),
    ],
    ids=["foreign host", "number instead of the name", "foreign origin", "origin without TLS", "no origin"],
)
def test_host_and_origin_of_the_upgrade(
    web: Web, files: Files, cookie: dict[str, str], headers: dict[str, str], problem: str
) -> None:
    """A request with another Host or Origin is refused in one line even if the browser has access."""

    async def test() -> tuple[int, str]:
        port = origin_of(web).rpartition(":")[2]
        given = {name: f"{value}:{port}" for name, value in headers.items()}
        async with (
            session(files.cert, Here()) as browser,
            browser.get(f"{origin_of(web)}/socket", headers={**UPGRADE, **cookie, **given}) as response,
        ):
            return response.status, await response.text()

    assert asyncio.run(test()) == (403, problem)


def test_a_certificate_that_the_client_does_not_trust(web: Web, tmp_path: Path) -> None:
    """The client refuses another certificate of the same name, so an attacker in between is noticed."""
    other = made(tmp_path, f"DNS:{NAME}")

    async def test() -> None:
        async with session(other.cert, Here()) as browser:
            with pytest.raises(aiohttp.ClientConnectorCertificateError):
                await browser.get(origin_of(web))

    asyncio.run(test())


def test_missing_options_are_reported_in_one_line(
    files: Files, daemon: Daemon, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    words = ("--runtime-dir", str(daemon.directory), "web", "--port", "0", "--host", "0.0.0.0")
    cert, key, password = (("--tls-cert", str(files.cert)), ("--tls-key", str(files.key)), files.options[4:])
    for given, missing in (
        ((*cert, *key), "--password-file is missing"),
        (password, "--tls-cert and --tls-key are missing"),
        ((*cert, *password), "--tls-key is missing"),
    ):
        begin = "hapticd: --host 0.0.0.0: other machines can reach this address, so TLS and a password are needed: "
        assert refusal(capfd, *words, *given) == f"{begin}{missing}\n"
    nowhere = str(tmp_path / "nowhere")
    problem = refusal(capfd, *words, *cert, *key, "--password-file", nowhere)
    assert problem == f"hapticd: {nowhere}: cannot be read: No such file or directory\n"


def test_from_another_network_namespace(daemon: Daemon, tmp_path: Path) -> None:
    """Connect as from another machine: not over the loopback, to the address in the certificate."""
    try:
        with network_namespace() as elsewhere:
            files = made(tmp_path, f"IP:{elsewhere.here}")
            place = ("--runtime-dir", str(daemon.directory))
            with running(tmp_path, "--host", elsewhere.here, *files.options, before=place) as web:
                assert origin_of(web).startswith(f"https://{elsewhere.here}:")
                visitor = elsewhere.command("-m", "tests.web.test_tls", origin_of(web), str(files.cert))
                done = subprocess.run(visitor, cwd=ROOT, text=True, capture_output=True, timeout=PATIENCE_S)
                assert done.returncode == 0, done.stderr
                check(json.loads(done.stdout))
    except NoNamespaceError as error:
        pytest.skip(str(error))


async def _visit(origin: str, cert: str) -> None:
    async with session(Path(cert)) as browser:
        print(json.dumps(await visited(browser, origin)))


if __name__ == "__main__":
    asyncio.run(_visit(*sys.argv[1:]))
