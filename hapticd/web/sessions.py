"""Who has been let in: tokens that are good once, and the sessions that browsers hold in a cookie."""

from __future__ import annotations

import hmac
import secrets
from collections import OrderedDict
from typing import Final

MOST_SESSIONS: Final = 64
MOST_TOKENS: Final = 16


class Sessions:
    """Those of one process. They end with it. Where there would be too many, the one that was used longest ago ends."""

    def __init__(self) -> None:
        self._sessions: OrderedDict[str, None] = OrderedDict()
        self._tokens: OrderedDict[str, None] = OrderedDict()

    def new_token(self) -> str:
        """For an address that lets in one browser, once."""
        return _added(self._tokens, MOST_TOKENS)

    def admit(self, token: str) -> str | None:
        """A session for who has a token that was not used yet; else None."""
        found = _find(self._tokens, token)
        if found is None:
            return None
        del self._tokens[found]
        return self.open()

    def open(self) -> str:
        """A new session."""
        return _added(self._sessions, MOST_SESSIONS)

    def knows(self, session: str) -> bool:
        """Whether it is one of ours."""
        found = _find(self._sessions, session)
        if found is not None:
            self._sessions.move_to_end(found)
        return found is not None


def _added(known: OrderedDict[str, None], most: int) -> str:
    """A new secret among those that are known, of which the oldest gives way."""
    made = secrets.token_urlsafe(32)
    known[made] = None
    while len(known) > most:
        known.popitem(last=False)
    return made


def _find(secrets_: OrderedDict[str, None], given: str) -> str | None:
    """The one that is equal. All are compared, each in constant time."""
    found = None
    for each in secrets_:
        if hmac.compare_digest(each.encode(), given.encode("utf-8", "surrogateescape")):
            found = each
    return found
