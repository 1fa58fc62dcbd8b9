"""Who is let in: Host and Origin of every request, a token that is good once, a password, and the cookie after them."""

from __future__ import annotations

import logging
from collections import Counter
from typing import Final

from aiohttp import web
from aiohttp.typedefs import Handler, Middleware

from hapticd.web import door
from hapticd.web.hosts import Hosts
from hapticd.web.passwords import Passwords
from hapticd.web.sessions import Sessions

_POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
    "worker-src 'self'; media-src 'self' blob:; manifest-src 'self'; base-uri 'none'; form-action 'self'; "
    "frame-ancestors 'none'"
)
HEADERS: Final = {
    "Content-Security-Policy": _POLICY,
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Embedder-Policy": "require-corp",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), microphone=(), geolocation=()",
    "Cache-Control": "no-store",
}
"""Of every answer. No inline code, nothing from another host, in no frame of another site."""
_POSTED: Final = frozenset({("POST", "/login"), ("POST", "/uploads")})
_FOR_EVERYBODY: Final = frozenset(("/login", "/door.css"))
FORM_BYTES: Final = 4096

_log = logging.getLogger("hapticd.web")


class Guard:
    """Lets in who has a token or the password, and afterwards its cookie."""

    def __init__(self, hosts: Hosts, sessions: Sessions, passwords: Passwords | None, port: int, secure: bool) -> None:
        self._hosts, self._sessions, self._passwords, self._secure = hosts, sessions, passwords, secure
        # Cookies do not know ports: several servers of one machine each have a name of their own.
        self.cookie = f"__Host-hapticd-{port}" if secure else f"hapticd-{port}"
        self.refused: Counter[str] = Counter()
        """Requests that were not answered, by the reason's first word."""

    def middleware(self) -> Middleware:
        @web.middleware
        async def check(request: web.Request, handler: Handler) -> web.StreamResponse:
            refusal = self._hosts.refusal(request)
            if refusal is not None:
                self.refused[refusal.partition(":")[0]] += 1
                return web.Response(status=403, text=refusal + "\n")
            if request.method not in ("GET", "HEAD") and (request.method, request.path) not in _POSTED:
                return web.Response(status=405, text="only GET\n", headers={"Allow": "GET, HEAD"})
            known = self._sessions.knows(request.cookies.get(self.cookie, ""))
            token = request.query.get("token")
            if request.path == "/" and token is not None and request.method == "GET":
                return self._redeem(request, token, known)
            if known or request.path in _FOR_EVERYBODY:
                return await handler(request)
            return self._not_yet(request)

        return check

    @staticmethod
    async def add_headers(_: web.Request, response: web.StreamResponse) -> None:
        """Of every answer, errors too."""
        response.headers.update(HEADERS)
        response.headers.pop("Server", None)

    def _redeem(self, request: web.Request, token: str, known: bool) -> web.StreamResponse:
        session = None if known else self._sessions.admit(token)
        if session is None and not known:
            self.refused["token"] += 1
            return _html(door.no_address(used=True), 403)
        return self._enter(request, session)

    def _not_yet(self, request: web.Request) -> web.StreamResponse:
        if self._passwords is not None and request.path == "/":
            return web.Response(status=303, headers={"Location": "/login"})
        self.refused["cookie"] += 1
        return _html(door.no_address(used=False), 403)

    def _enter(self, request: web.Request, session: str | None) -> web.StreamResponse:
        # Whoever came from another site is not sent a strict cookie on the way on: a page of ours leads there.
        if request.headers.get("Sec-Fetch-Site", "none") in ("none", "same-origin"):
            entered = web.Response(status=303, headers={"Location": "/"})
        else:
            entered = _html(door.onward())
        if session is not None:
            entered.set_cookie(
                self.cookie, session, httponly=True, samesite="Strict", path="/", secure=self._secure or None
            )
        return entered

    # ---- The password ------------------------------------------------------------------------------------------------

    async def show_form(self, _: web.Request) -> web.StreamResponse:
        if self._passwords is None:
            raise web.HTTPNotFound
        return _html(door.login())

    async def take_form(self, request: web.Request) -> web.StreamResponse:
        """A password that somebody sent."""
        if self._passwords is None:
            raise web.HTTPNotFound
        if request.content_type != "application/x-www-form-urlencoded":
            raise web.HTTPUnsupportedMediaType
        given = (await request.post()).get("password")
        address = request.remote or ""
        verdict = await self._passwords.check(given if isinstance(given, str) else "", address)
        if verdict == "right":
            return self._enter(request, self._sessions.open())
        self.refused["password"] += 1
        _log.warning("%s: %s", address, "a wrong password" if verdict == "wrong" else "too many passwords")
        if verdict == "later":
            return _html(door.login("Too many passwords were tried. Wait ten seconds, then try again."), 429)
        return _html(door.login("This is not the password."), 403)


def _html(text: str, status: int = 200) -> web.Response:
    return web.Response(status=status, text=text, content_type="text/html")
