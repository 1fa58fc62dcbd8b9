"""Checks of Host and Origin in every spelling, against DNS rebinding and pages of other sites."""

from __future__ import annotations

import pytest
from aiohttp.test_utils import make_mocked_request
from hypothesis import given, settings
from hypothesis import strategies as st
from multidict import CIMultiDict

from hapticd.web.hosts import Hosts

HERE = Hosts(frozenset({"127.0.0.1", "localhost"}), 8765, secure=False)
SIX = Hosts(frozenset({"[::1]", "localhost"}), 8765, secure=False)
LAB = Hosts(frozenset({"haptics.lab.org", "*.wild.org", "192.0.2.7"}), 443, secure=True)


def refusal(hosts: Hosts, host: str | None, origin: str | None = None, path: str = "/", **more: str) -> str | None:
    headers = {**({} if host is None else {"Host": host}), **({} if origin is None else {"Origin": origin})}
    headers |= {name.replace("_", "-"): value for name, value in more.items()}
    return hosts.refusal(make_mocked_request("GET", path, headers=headers))


@pytest.mark.parametrize("host", ["127.0.0.1:8765", "localhost:8765", "LOCALHOST:8765", "LocalHost:8765"])
def test_our_names(host: str) -> None:
    assert refusal(HERE, host) is None


@pytest.mark.parametrize(
    "host",
    [
        None,
        "",
        "evil.example",
        "evil.example:8765",
        "127.0.0.1",
        "127.0.0.1:80",
        "127.0.0.1:8766",
        "127.0.0.1:08765",
        "127.0.0.1:",
        "localhost.:8765",
        "127.0.0.1.:8765",
        "127.1:8765",
        "127.0.0.2:8765",
        "0.0.0.0:8765",
        "2130706433:8765",
        "0x7f000001:8765",
        "0177.0.0.1:8765",
        "127.0.0.1.evil.example:8765",
        "localhost:8765@evil.example",
        "user@localhost:8765",
        "evil.example, localhost:8765",
        " localhost:8765",
        "[::1]:8765",
        "[::ffff:127.0.0.1]:8765",
        "localhost:8765/",
        "loc\u0430lhost:8765",
        "localhost\u3002:8765",
    ],
)
def test_other_names(host: str | None) -> None:
    assert refusal(HERE, host) == "Host: this address is not served here"


def test_ipv6() -> None:
    assert refusal(SIX, "[::1]:8765", "http://[::1]:8765", "/socket") is None
    for host in (
        "::1:8765",
        "[0:0:0:0:0:0:0:1]:8765",
        "[::1%lo]:8765",
        "[::1]",
        "127.0.0.1:8765",
        "[::ffff:7f00:1]:8765",
    ):
        assert refusal(SIX, host) is not None, host


def test_names_of_a_certificate() -> None:
    for host in ("haptics.lab.org", "HAPTICS.lab.org:443", "a.wild.org", "192.0.2.7"):
        assert refusal(LAB, host) is None, host
    for host in ("lab.org", "haptics.lab.org:80", "a.b.wild.org", "wild.org", "*.wild.org", "haptics.lab.org:8443"):
        assert refusal(LAB, host) is not None, host
    assert refusal(LAB, "haptics.lab.org", "https://haptics.lab.org", "/socket") is None
    assert refusal(LAB, "haptics.lab.org", "https://haptics.lab.org:443", "/socket") is None
    assert refusal(LAB, "haptics.lab.org", "http://haptics.lab.org", "/socket") is not None
    assert refusal(LAB, "haptics.lab.org", "https://a.wild.org", "/socket") is not None


def test_two_hosts_or_two_origins() -> None:
    headers = (("Host", "localhost:8765"), ("Host", "localhost:8765"))
    assert HERE.refusal(make_mocked_request("GET", "/", headers=CIMultiDict(headers))) is not None
    twice = (("Host", "localhost:8765"), ("Origin", "http://localhost:8765"), ("Origin", "http://localhost:8765"))
    assert HERE.refusal(make_mocked_request("GET", "/", headers=CIMultiDict(twice))) is not None


@pytest.mark.parametrize(
    "origin",
    [
        "null",
        "http://localhost",
        "http://localhost:8765/",
        "https://localhost:8765",
        "http://127.0.0.1:8765",
        "http://localhost.:8765",
        "http://evil.example",
        "http://evil.example:8765",
        "file://",
        "localhost:8765",
        "ws://localhost:8765",
        "http://localhost:8765, http://evil.example",
    ],
)
def test_foreign_origins(origin: str) -> None:
    assert refusal(HERE, "localhost:8765", origin) == "Origin: only pages of this server may do this"


def test_an_origin_that_is_missing() -> None:
    assert refusal(HERE, "localhost:8765") is None
    assert refusal(HERE, "localhost:8765", path="/socket") is not None
    assert refusal(HERE, "localhost:8765", Upgrade="websocket") is not None


def test_what_a_browser_says_of_who_asks() -> None:
    host = "localhost:8765"
    for site in ("same-site", "cross-site"):
        assert refusal(HERE, host, Sec_Fetch_Site=site) is not None
        assert refusal(HERE, host, Sec_Fetch_Site=site, Sec_Fetch_Mode="no-cors", Sec_Fetch_Dest="script") is not None
        assert refusal(HERE, host, Sec_Fetch_Site=site, Sec_Fetch_Mode="navigate", Sec_Fetch_Dest="iframe") is not None
        assert refusal(HERE, host, Sec_Fetch_Site=site, Sec_Fetch_Mode="navigate", Sec_Fetch_Dest="document") is None
    assert refusal(HERE, host, Sec_Fetch_Site="same-origin") is None
    assert refusal(HERE, host, Sec_Fetch_Site="none") is None


@settings(max_examples=30)
@given(st.text(max_size=40))
def test_no_other_spelling(host: str) -> None:
    """No other spelling of a name is accepted."""
    if host.lower() not in ("localhost:8765", "127.0.0.1:8765"):
        assert refusal(HERE, host.encode("utf-8", "replace").decode("utf-8")) is not None
