"""The methods of the daemon that a page may call. All others are refused, also methods that are added later."""

from __future__ import annotations

from typing import Final

FORWARDED_METHODS: Final = frozenset(
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
"""Methods of the daemon whose calls are passed on unchanged.

`reload` and `dump_flight` are not among them, because they read and write files on the daemon's machine.
"""

STREAM_METHODS: Final = frozenset(("stream_target", "stream_force"))
"""Methods of the daemon for streams: notifications with a separate rate limit."""

SAFETY_METHODS: Final = frozenset(("lease", "set_forces"))
"""Methods whose params page_lease.py reads."""

DAEMON_METHODS: Final = FORWARDED_METHODS | STREAM_METHODS | SAFETY_METHODS
"""All methods of the daemon that a page may call."""
