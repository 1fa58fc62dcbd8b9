"""One-time tokens, and the sessions that browsers have in a cookie."""

from __future__ import annotations

import hmac
import secrets
from collections import OrderedDict
from typing import Final

MAX_SESSIONS: Final = 64
"""Maximum number of sessions; the session that was used longest ago ends first."""
MAX_TOKENS: Final = 16
"""Maximum number of unused tokens; the oldest becomes invalid first."""


class Sessions:
    """The tokens and sessions of this process; all become invalid when it ends."""

    def __init__(self) -> None:
        self._sessions: OrderedDict[str, None] = OrderedDict()
        self._tokens: OrderedDict[str, None] = OrderedDict()

    def new_token(self) -> str:
        """Return a token for an address that gives one browser access, once."""
        return _added(self._tokens, MAX_TOKENS)

    def admit(self, token: str) -> str | None:
        """Use up a one-time token and return a new session for the cookie; None if the token is not valid."""
        known = _find(self._tokens, token)
        if known is None:
            return None
        del self._tokens[known]
        return self.open()

    def open(self) -> str:
        """Return a new session, a secret for a browser's cookie."""
        return _added(self._sessions, MAX_SESSIONS)

    def knows(self, session: str) -> bool:
        """Return whether a session is valid."""
        known = _find(self._sessions, session)
        if known is not None:
            self._sessions.move_to_end(known)
        return known is not None


def _added(valid: OrderedDict[str, None], limit: int) -> str:
    """Add a new secret to `valid`, remove the oldest secrets beyond `limit`, and return the new secret."""
    made = secrets.token_urlsafe(32)
    valid[made] = None
    while len(valid) > limit:
        valid.popitem(last=False)
    return made


def _find(valid: OrderedDict[str, None], given: str) -> str | None:
    """Return the valid secret that equals `given`, or None. All secrets are compared, each in constant time."""
    match = None
    for each in valid:
        if hmac.compare_digest(each.encode(), given.encode("utf-8", "surrogateescape")):
            match = each
    return match
