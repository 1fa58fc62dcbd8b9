"""The same recording twice in a set: it would count twice."""

from __future__ import annotations

from collections.abc import Sequence

from hapticd.analysis.statistics import FitError
from hapticd.fit.recording import Recording


def refuse_twins(recordings: Sequence[Recording]) -> None:
    """Raises FitError for two recordings of the same file, or of files with the same bytes."""
    seen: dict[str, str] = {}
    for recording in recordings:
        sha256 = recording.source.sha256
        if sha256 and sha256 in seen:
            raise FitError(f"{recording.name}: holds the same as {seen[sha256]}, and would count twice; leave out one")
        seen[sha256] = recording.name
