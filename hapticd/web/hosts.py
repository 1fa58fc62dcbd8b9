"""Under which names this server is asked: the Host of every request, and the Origin of what a page asks for.

A page of another site may have its own name lead to this machine (DNS rebinding): its requests carry that name as Host,
and are refused. Names and numbers are compared as they are spelled; browsers spell each address in one way.
"""

from __future__ import annotations

import re
from typing import Final

from aiohttp import web

_AUTHORITY: Final = re.compile(r"(\[[0-9a-f:.]+\]|[a-z0-9._-]+)(?::([1-9][0-9]{0,4}))?", re.ASCII)
_NOT_FOREIGN: Final = ("same-origin", "none")


class Hosts:
    """The names of one server, at one port."""

    def __init__(self, names: frozenset[str], port: int, secure: bool) -> None:
        """`names`: in lower case, IPv6 addresses in brackets; `*.lab.org` stands for each name with one label more."""
        self._names = names
        self._port = port
        self._default = 443 if secure else 80
        self._scheme = "https://" if secure else "http://"

    def _known(self, authority: str) -> str | None:
        """Name and port of `authority` where they are ours, else None."""
        match = _AUTHORITY.fullmatch(authority.lower())
        if match is None or int(match[2] or self._default) != self._port:
            return None
        name = match[1]
        if name not in self._names and "*." + name.partition(".")[2] not in self._names:
            return None
        return f"{name}:{self._port}"

    def refusal(self, request: web.Request) -> str | None:
        """Why a request is not answered; None for one that is ours."""
        hosts, origins = request.headers.getall("Host", []), request.headers.getall("Origin", [])
        host = self._known(hosts[0]) if len(hosts) == 1 else None
        if host is None:
            return "Host: this address is not served here"
        if not origins:
            if request.path == "/socket" or "Upgrade" in request.headers or request.method not in ("GET", "HEAD"):
                return "Origin: it is missing; only pages of this server may do this"
        elif len(origins) > 1 or not self._same(origins[0], host):
            return "Origin: only pages of this server may do this"
        return self._foreign(request)

    def _same(self, origin: str, host: str) -> bool:
        scheme = origin[: len(self._scheme)].lower()
        return scheme == self._scheme and self._known(origin[len(self._scheme) :]) == host

    def _foreign(self, request: web.Request) -> str | None:
        """A browser says who asks. Another site may lead to the page, and to nothing else."""
        site = request.headers.get("Sec-Fetch-Site", "none")
        if site in _NOT_FOREIGN:
            return None
        leads = request.headers.get("Sec-Fetch-Mode") == "navigate" and request.method == "GET"
        if leads and request.headers.get("Sec-Fetch-Dest") == "document":
            return None
        return "Sec-Fetch-Site: only pages of this server may ask for this"
