"""What a page may call of the daemon. What is not named here is refused, new methods too."""

from __future__ import annotations

from typing import Final

PASSED: Final = frozenset(
    (
        "get_status",
        "get_state",
        "get_config",
        "get_scene",
        "set_scene",
        "update_scene",
        "get_materials",
        "set_materials",
        "update_materials",
        "apply",
        "play",
        "reset",
        "set_operator",
        "mark",
    )
)
"""Passed on as they are. Not among them: `reload` and `dump_flight`, which read and write files where the daemon is."""

STREAMS: Final = frozenset(("stream_target", "stream_force"))
"""Notifications of which there may be many."""

SAFETY: Final = frozenset(("lease", "set_forces"))
"""Those that page_lease looks at."""

OF_THE_DAEMON: Final = PASSED | STREAMS | SAFETY
"""What takes a connection for commands."""
