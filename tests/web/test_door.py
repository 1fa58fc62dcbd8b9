"""Access to the page over HTTP, for browsers and other clients."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import aiohttp
import pytest

from hapticd.web.application import STATIC_FOLDER, WEB_PAGE_METHODS
from hapticd.web.passwords import write_password
from hapticd.web.security import SECURITY_HEADERS
from tests.web.served import WebSite, served, tab

Answer = tuple[int, str, Mapping[str, str]]


async def ask(site: WebSite, path: str, method: str = "GET", **more: Any) -> Answer:
    more.setdefault("allow_redirects", False)
    async with aiohttp.ClientSession() as session, session.request(method, site.url + path, **more) as response:
        return response.status, await response.text(), response.headers


async def raw(site: WebSite, *lines: str) -> bytes:
    """Return the first line of the answer to a request that no client library would send."""
    port = int(site.url.rpartition(":")[2])
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write("\r\n".join([*lines, "Connection: close", "", ""]).encode())
    line = await reader.readline()
    writer.close()
    return line


def test_the_token_of_an_address_gives_one_browser_access_once() -> None:
    async def test() -> None:
        async with served() as site:
            token = site.sessions.new_token()
            status, _, headers = await ask(site, f"/?token={token}")
            assert (status, headers["Location"]) == (303, "/")
            port = site.url.rpartition(":")[2]
            cookie = headers["Set-Cookie"]
            assert cookie.startswith(f"hapticd-{port}=")
            assert "HttpOnly" in cookie and "SameSite=Strict" in cookie and "Path=/" in cookie
            session = cookie.partition(";")[0]
            assert (await ask(site, "/", headers={"Cookie": session}))[0] == 200
            # A second browser, and the first one when it returns to its address.
            status, text, _ = await ask(site, f"/?token={token}")
            assert status == 403 and "was used before" in text and "kill -USR1" in text
            status, _, headers = await ask(site, f"/?token={token}", headers={"Cookie": session})
            assert (status, headers["Location"]) == (303, "/") and "Set-Cookie" not in headers

    asyncio.run(test())


def test_a_page_makes_an_address_for_another_browser() -> None:
    async def test() -> None:
        async with served() as site, tab(site) as page:
            address = (await page.call("web.new_address"))["result"]["address"]
            assert (await ask(site, address.removeprefix(site.url)))[0] == 303

    asyncio.run(test())


def test_a_browser_from_another_site_continues_from_a_page_of_this_server() -> None:
    """Browsers send a strict cookie only with requests from the same site."""

    async def test() -> None:
        async with served() as site:
            led = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "document"}
            status, text, headers = await ask(site, f"/?token={site.sessions.new_token()}", headers=led)
            assert status == 200 and 'content="0; url=/"' in text and "Set-Cookie" in headers

    asyncio.run(test())


@pytest.mark.parametrize("path", ["/", "/static/main.js", "/static/style.css", "/socket", "/static/", "/nothing"])
@pytest.mark.parametrize("cookie", [None, "", "guess", "\xe9"])
def test_browsers_without_access_get_nothing(path: str, cookie: str | None) -> None:
    async def test() -> None:
        async with served(there=False) as site:
            headers = dict(site.origin)
            if cookie is not None:
                headers["Cookie"] = f"{site.guard.cookie}={cookie}"
            status, text, _ = await ask(site, path, headers=headers)
            assert status == 403 and "has no access" in text

    asyncio.run(test())


def test_every_answer_has_the_headers() -> None:
    async def test() -> None:
        async with served(there=False) as site:
            for path, headers in (
                ("/", site.cookie),
                ("/", {}),
                ("/static/main.js", site.cookie),
                ("/nothing", site.cookie),
                ("/", {"Host": "evil.example"}),
                ("/door.css", {}),
            ):
                _, _, answered = await ask(site, path, headers=headers)
                assert {name: answered.get(name) for name in SECURITY_HEADERS} == SECURITY_HEADERS, path
                assert "Server" not in answered
        policy = SECURITY_HEADERS["Content-Security-Policy"]
        assert "unsafe" not in policy and "default-src 'none'" in policy and "worker-src 'self'" in policy

    asyncio.run(test())


def test_the_page_has_no_inline_code() -> None:
    for path in STATIC_FOLDER.glob("*.html"):
        text = path.read_text()
        assert not re.search(r"<script>|<style|javascript:|\son[a-z]+=|\sstyle=", text)


@pytest.mark.parametrize(
    "path",
    [
        "/static/../page.py",
        "/static/%2e%2e/page.py",
        "/static/..%2fpage.py",
        "/static/%2e%2e%2f%2e%2e%2f%2e%2e%2fetc/passwd",
        "/static//etc/passwd",
        "/static/vendor/../../security.py",
        "/static/main.js%00.css",
        "/static/..\\page.py",
    ],
)
def test_no_path_leads_out_of_static(path: str) -> None:
    async def test() -> None:
        async with served(there=False) as site:
            host = site.url.removeprefix("http://")
            cookie = site.cookie["Cookie"]
            line = await raw(site, f"GET {path} HTTP/1.1", f"Host: {host}", f"Cookie: {cookie}")
            assert line.split()[1] in (b"400", b"403", b"404"), line

    asyncio.run(test())


def test_a_link_in_static_is_not_followed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    secret = tmp_path / "secret"
    secret.write_text("secret")
    folder = tmp_path / "static"
    folder.mkdir()
    (folder / "here.txt").write_text("here")
    (folder / "link.txt").symlink_to(secret)
    monkeypatch.setattr("hapticd.web.application.STATIC_FOLDER", folder)

    async def test() -> None:
        async with served(there=False) as site:
            assert (await ask(site, "/static/here.txt", headers=site.cookie))[:2] == (200, "here")
            assert (await ask(site, "/static/link.txt", headers=site.cookie))[0] in (403, 404)
            assert (await ask(site, "/static/", headers=site.cookie))[0] in (403, 404)

    asyncio.run(test())


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE", "HEAD"])
def test_only_get_and_the_form(method: str) -> None:
    async def test() -> None:
        async with served(there=False) as site:
            status, _, _ = await ask(site, "/", method, headers={**site.cookie, **site.origin})
            assert status == (200 if method == "HEAD" else 405)
            token = site.sessions.new_token()
            await ask(site, f"/?token={token}", "HEAD")
            assert site.sessions.admit(token) is not None, "to look at an address does not use it"

    asyncio.run(test())


def test_a_cookie_of_another_server_of_this_machine_is_another() -> None:
    async def test() -> None:
        async with served(there=False) as one, served(there=False) as other:
            assert one.guard.cookie != other.guard.cookie
            both = {"Cookie": f"{one.cookie['Cookie']}; {other.cookie['Cookie']}"}
            assert (await ask(one, "/", headers=both))[0] == 200
            assert (await ask(other, "/", headers=both))[0] == 200
            assert (await ask(other, "/", headers=one.cookie))[0] == 403

    asyncio.run(test())


# ---- The upgrade -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("origin", "status"),
    [
        ("{url}", None),
        (None, 403),
        ("null", 403),
        ("", 403),
        ("http://evil.example", 403),
        ("http://127.0.0.1", 403),
        ("https://{host}", 403),
        ("http://localhost:{port}", 403),
        ("{url}.evil.example", 403),
        ("http://evil.example:{port}", 403),
        ("{url}/", 403),
    ],
)
def test_only_our_own_pages_open_a_socket(origin: str | None, status: int | None) -> None:
    async def test() -> None:
        async with served(there=False) as site:
            headers = dict(site.cookie)
            if origin is not None:
                host = site.url.removeprefix("http://")
                headers["Origin"] = origin.format(url=site.url, host=host, port=host.partition(":")[2])
            async with aiohttp.ClientSession() as session:
                try:
                    async with session.ws_connect(f"{site.url}/socket", headers=headers):
                        assert status is None
                except aiohttp.WSServerHandshakeError as error:
                    assert error.status == status

    asyncio.run(test())


# ---- The password ----------------------------------------------------------------------------------------------------


def test_a_password_gives_access(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hapticd.web.passwords._SCRYPT_N", 1 << 10)
    path = str(tmp_path / "password")
    write_password(path, "rosewood comb")

    async def test() -> None:
        async with served(password_file=path, there=False) as site:
            status, _, headers = await ask(site, "/")
            assert (status, headers["Location"]) == (303, "/login")
            status, text, _ = await ask(site, "/login")
            assert status == 200 and 'type="password"' in text and "<script" not in text
            form = {"data": {"password": "rosewood comb"}, "headers": site.origin}
            status, _, headers = await ask(site, "/login", "POST", **form)
            assert status == 303
            session = headers["Set-Cookie"].partition(";")[0]
            assert (await ask(site, "/", headers={"Cookie": session}))[0] == 200
            # A page of another site cannot log somebody in.
            assert (await ask(site, "/login", "POST", data={"password": "rosewood comb"}))[0] == 403
            evil = {"Origin": "http://evil.example"}
            assert (await ask(site, "/login", "POST", data={"password": "rosewood comb"}, headers=evil))[0] == 403

    asyncio.run(test())


def test_tries_of_passwords_are_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hapticd.web.passwords._SCRYPT_N", 1 << 10)
    path = str(tmp_path / "password")
    write_password(path, "rosewood comb")

    async def test() -> None:
        async with served(password_file=path, there=False) as site:
            found = [
                (await ask(site, "/login", "POST", data={"password": guess}, headers=site.origin))[0]
                for guess in ["a" * 2000, *("b" * 2000,) * 4, "rosewood comb"]
            ]
            assert found == [403] * 5 + [429]
            big = {"data": {"password": "a" * 8000}, "headers": site.origin}
            assert (await ask(site, "/login", "POST", **big))[0] == 413

    asyncio.run(test())


def test_without_a_password_file_there_is_no_form() -> None:
    async def test() -> None:
        async with served(there=False) as site:
            assert (await ask(site, "/login"))[0] == 404
            assert (await ask(site, "/login", "POST", data={"password": ""}, headers=site.origin))[0] == 404

    asyncio.run(test())


def test_all_methods_of_this_process_begin_with_web() -> None:
    assert all(name.startswith("web.") for name in WEB_PAGE_METHODS)
