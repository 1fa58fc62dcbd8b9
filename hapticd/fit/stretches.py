"""The whole stretches of a recording: between gaps of its clock and clipped samples."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np

from hapticd.analysis.recordings.clipping import clipped
from hapticd.analysis.recordings.spans import spans_of
from hapticd.analysis.statistics import FitError, Floats
from hapticd.fit.exclusions import PART, LeftOut
from hapticd.fit.recording import Recording

LEAST_PART: Final = 0.5
"""A recording of which less is whole is left out altogether."""


def between_gaps(recording: Recording, samples: int) -> list[tuple[int, int]]:
    """First sample, and the one after the last, of every stretch in which no sample is missing."""
    edges = [0, *(edge for gap in recording.gaps for edge in gap), samples]
    return [(begin, end) for begin, end in zip(edges[::2], edges[1::2], strict=True) if end > begin]


def whole_stretches(recording: Recording, least_s: float, left: LeftOut) -> list[Recording]:
    """The recording, or its stretches of at least this length without gaps and clipped samples, as recordings.

    What falls out is told to `left`. Raises FitError where that is too much.
    """
    acceleration = recording.acceleration_m_per_s2
    lengths = [len(values) for values in _columns(recording) if values is not None]
    if not lengths:
        return [recording]
    samples, rate_hz = lengths[0], recording.rate_hz
    bad = np.ones(samples, dtype=np.bool_)
    for begin, end in between_gaps(recording, samples):
        bad[begin:end] = False
    cut = np.zeros(samples, dtype=np.bool_) if acceleration is None else clipped(acceleration)
    bad |= cut
    if not bad.any():
        return [recording]
    kept = [(begin, end) for begin, end in spans_of(~bad) if end - begin >= least_s * rate_hz]
    there = sum(end - begin for begin, end in kept)
    reasons = []
    if acceleration is not None and cut.any():
        places = len(spans_of(cut))
        levels = " and ".join(f"{level:.4g}" for level in np.unique(acceleration[cut]))
        reasons.append(f"clipped at {levels} m/s^2 in {places} {'place' if places == 1 else 'places'}")
    if recording.gaps:
        reasons.append(gaps_told(recording))
    reason = ", ".join(reasons)
    if there < LEAST_PART * samples:
        raise FitError(
            f"{recording.name}: {reason}: {100 * there / samples:.0f} % of it is whole in stretches of {least_s:g} s, "
            f"{100 * LEAST_PART:.0f} % are wanted"
        )
    left.add(recording.name, f"{(samples - there) / rate_hz:.3g} of {samples / rate_hz:.3g} s, {reason}", PART)
    return [_part(recording, begin, end, samples) for begin, end in kept]


def gaps_told(recording: Recording) -> str:
    """Where samples are missing, in words."""
    (begin, end), more = recording.gaps[0], len(recording.gaps) - 1
    others = f", and in {more} more {'place' if more == 1 else 'places'}" if more else ""
    return f"{end - begin} samples are missing at {begin / recording.rate_hz:.4g} s{others}"


def in_gap(recording: Recording, begin: int, end: int) -> bool:
    """Whether samples are missing between these."""
    return any(begin < last and first < end for first, last in recording.gaps)


def _columns(recording: Recording) -> tuple[Floats | None, ...]:
    return recording.acceleration_m_per_s2, recording.force_n, recording.position_m, recording.tangential_position_m


def _part(recording: Recording, begin: int, end: int, samples: int) -> Recording:
    speed = recording.speed_m_per_s
    if isinstance(speed, np.ndarray) and len(speed) == samples:
        speed = speed[begin:end]
    parts = [None if values is None else values[begin:end] for values in _columns(recording)]
    return dataclasses.replace(
        recording,
        name=f"{recording.name} from {begin / recording.rate_hz:.4g} s",
        acceleration_m_per_s2=parts[0],
        force_n=parts[1],
        position_m=parts[2],
        tangential_position_m=parts[3],
        speed_m_per_s=speed,
        gaps=(),
    )


def stretches_of(recordings: Sequence[Recording], least_s: float, left: LeftOut) -> list[Recording]:
    """The whole stretches of all recordings; one that is not whole enough is left out."""
    return [part for parts in left.each(recordings, lambda one: whole_stretches(one, least_s, left)) for part in parts]
