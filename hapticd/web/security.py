"""Access control: Host and Origin of every request, the one-time token, the password, and the cookie."""

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

_CONTENT_SECURITY_POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
    "worker-src 'self'; media-src 'self' blob:; manifest-src 'self'; base-uri 'none'; form-action 'self'; "
    "frame-ancestors 'none'"
)
SECURITY_HEADERS: Final = {
    "Content-Security-Policy": _CONTENT_SECURITY_POLICY,
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Embedder-Policy": "require-corp",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), microphone=(), geolocation=()",
    "Cache-Control": "no-store",
}
"""Headers of every response: no inline code, nothing from other hosts, no frame of another site."""
_POST_ROUTES: Final = frozenset({("POST", "/login"), ("POST", "/uploads")})
"""Routes that accept a method other than GET and HEAD."""
_PUBLIC_PATHS: Final = frozenset(("/login", "/door.css"))
"""Paths that are also served to browsers without access."""
MAX_FORM_BYTES: Final = 4096
"""Largest body of the login form."""

_log = logging.getLogger("hapticd.web")


class Guard:
    """Gives a browser with a token or the password access, and recognizes it by its cookie afterwards."""

    def __init__(self, hosts: Hosts, sessions: Sessions, passwords: Passwords | None, port: int, secure: bool) -> None:
        """Guard the server at `port`. `secure`: whether it uses TLS."""
        self._hosts, self._sessions, self._passwords, self._secure = hosts, sessions, passwords, secure
        # Cookies are shared by all ports of a host, so that the name contains the port.
        self.cookie = f"__Host-hapticd-{port}" if secure else f"hapticd-{port}"
        self.refused: Counter[str] = Counter()
        """Number of refused requests, by the first word of the reason."""

    def middleware(self) -> Middleware:
        """Return the middleware that refuses requests of browsers without access, and of other sites."""

        @web.middleware
        async def check(request: web.Request, handler: Handler) -> web.StreamResponse:
            refusal = self._hosts.refusal(request)
            if refusal is not None:
                self.refused[refusal.partition(":")[0]] += 1
                return web.Response(status=403, text=refusal + "\n")
            if request.method not in ("GET", "HEAD") and (request.method, request.path) not in _POST_ROUTES:
                return web.Response(status=405, text="only GET\n", headers={"Allow": "GET, HEAD"})
            known = self._sessions.knows(request.cookies.get(self.cookie, ""))
            token = request.query.get("token")
            if request.path == "/" and token is not None and request.method == "GET":
                return self._redeem(request, token, known)
            if known or request.path in _PUBLIC_PATHS:
                return await handler(request)
            return self._deny(request)

        return check

    @staticmethod
    async def add_headers(_: web.Request, response: web.StreamResponse) -> None:
        """Add SECURITY_HEADERS to every response, also to errors."""
        response.headers.update(SECURITY_HEADERS)
        response.headers.pop("Server", None)

    def _redeem(self, request: web.Request, token: str, known: bool) -> web.StreamResponse:
        session = None if known else self._sessions.admit(token)
        if session is None and not known:
            self.refused["token"] += 1
            return _html(door.address_needed_page(used=True), 403)
        return self._enter(request, session)

    def _deny(self, request: web.Request) -> web.StreamResponse:
        if self._passwords is not None and request.path == "/":
            return web.Response(status=303, headers={"Location": "/login"})
        self.refused["cookie"] += 1
        return _html(door.address_needed_page(used=False), 403)

    def _enter(self, request: web.Request, session: str | None) -> web.StreamResponse:
        # After a link on another site, a redirect would not send the strict cookie: a page of this server leads on.
        if request.headers.get("Sec-Fetch-Site", "none") in ("none", "same-origin"):
            entered = web.Response(status=303, headers={"Location": "/"})
        else:
            entered = _html(door.continue_page())
        if session is not None:
            entered.set_cookie(
                self.cookie, session, httponly=True, samesite="Strict", path="/", secure=self._secure or None
            )
        return entered

    # ---- The password ------------------------------------------------------------------------------------------------

    async def show_form(self, _: web.Request) -> web.StreamResponse:
        """Answer a GET of the login form."""
        if self._passwords is None:
            raise web.HTTPNotFound
        return _html(door.login_page())

    async def take_form(self, request: web.Request) -> web.StreamResponse:
        """Check the password of a POST of the login form."""
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
        _log.warning("%s: %s", address, "wrong password" if verdict == "wrong" else "too many tries of a password")
        if verdict == "later":
            return _html(door.login_page("Too many passwords were tried. Wait ten seconds, then try again."), 429)
        return _html(door.login_page("Wrong password."), 403)


def _html(text: str, status: int = 200) -> web.Response:
    return web.Response(status=status, text=text, content_type="text/html")
