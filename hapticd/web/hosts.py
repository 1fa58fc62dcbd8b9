"""Checks of the headers Host and Origin of requests.

Another site may let its name resolve to this machine (DNS rebinding). Requests of its pages have that name as Host and
are refused. Names and addresses are compared as texts; browsers write each address in one way.
"""

from __future__ import annotations

import re
from typing import Final

from aiohttp import web

_AUTHORITY_PATTERN: Final = re.compile(r"(\[[0-9a-f:.]+\]|[a-z0-9._-]+)(?::([1-9][0-9]{0,4}))?", re.ASCII)
"""Host and port, in lower case."""
_OWN_FETCH_SITES: Final = ("same-origin", "none")
"""Values of Sec-Fetch-Site for requests of our pages, and for addresses that a person typed."""


class Hosts:
    """The host names under which one server may be requested, at one port."""

    def __init__(self, names: frozenset[str], port: int, secure: bool) -> None:
        """Accept requests for the host `names`.

        Names are in lower case, IPv6 addresses in brackets; `*` in `*.lab.org` matches one label.
        """
        self._names = names
        self._port = port
        self._default = 443 if secure else 80
        self._scheme = "https://" if secure else "http://"

    def _known(self, authority: str) -> str | None:
        """Return `authority` as NAME:PORT if this server has this name and port, else None."""
        match = _AUTHORITY_PATTERN.fullmatch(authority.lower())
        if match is None or int(match[2] or self._default) != self._port:
            return None
        name = match[1]
        if name not in self._names and "*." + name.partition(".")[2] not in self._names:
            return None
        return f"{name}:{self._port}"

    def refusal(self, request: web.Request) -> str | None:
        """Return why a request is refused; None if it is accepted."""
        hosts, origins = request.headers.getall("Host", []), request.headers.getall("Origin", [])
        host = self._known(hosts[0]) if len(hosts) == 1 else None
        if host is None:
            return "Host: this address is not served here"
        if not origins:
            if request.path == "/socket" or "Upgrade" in request.headers or request.method not in ("GET", "HEAD"):
                return "Origin: is missing; only pages of this server may do this"
        elif len(origins) > 1 or not self._same(origins[0], host):
            return "Origin: only pages of this server may do this"
        return self._foreign(request)

    def _same(self, origin: str, host: str) -> bool:
        scheme = origin[: len(self._scheme)].lower()
        return scheme == self._scheme and self._known(origin[len(self._scheme) :]) == host

    def _foreign(self, request: web.Request) -> str | None:
        """Return why a request that another site caused is refused. Other sites may only link to the page."""
        site = request.headers.get("Sec-Fetch-Site", "none")
        if site in _OWN_FETCH_SITES:
            return None
        leads = request.headers.get("Sec-Fetch-Mode") == "navigate" and request.method == "GET"
        if leads and request.headers.get("Sec-Fetch-Dest") == "document":
            return None
        return "Sec-Fetch-Site: only pages of this server may request this"
