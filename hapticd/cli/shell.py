"""The daemon's words in those of the shell: what names a method of the protocol names the command that calls it.

The daemon answers clients in any language, so its messages name methods and params. Here, and nowhere else, a command
of the shell takes their place.
"""

from __future__ import annotations

from typing import Final

from hapticd.base.errors import HapticdError

PHRASES: Final = (
    ("set_forces turns them on", "`hapticd force on` turns them on"),
    ("set_scene changes it", "`hapticd scene set` changes it"),
    ("set_operator moves", "`hapticd operator` moves"),
    ("expect_revision:", "--expect-revision:"),
)
"""What the daemon says, and what a person types."""


def in_shell_words(error: HapticdError) -> str:
    """An error's message, with commands of the shell in it."""
    from hapticd.protocol.calls import RemoteError
    from hapticd.protocol.messages import Code

    if not isinstance(error, RemoteError):
        return str(error)
    match error.code:
        case Code.NO_SUCH_METHOD:
            return "the daemon does not know this command: it is of another version; `hapticd status` says which"
        case Code.STALE_REVISION:
            return f"{shell_words(str(error))}: see `hapticd scene get`"
        case _:
            return shell_words(str(error))


def shell_words(text: str) -> str:
    """A message or a warning of the daemon's."""
    for said, typed in PHRASES:
        text = text.replace(said, typed)
    return text
