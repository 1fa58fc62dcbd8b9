"""The check of includes finds what it is for, and the core as it is passes it."""

from __future__ import annotations

import pytest

from tests.project.check_includes import CSRC, Includes, faults, includes_of

SOUND: Includes = {
    "api/hd_core.h": ["api/hd_api.h"],
    "base/hd_ring.h": ["api/hd_core.h", "base/hd_atomic.h"],
    "scene/hd_world.h": ["api/hd_core.h", "scene/hd_index.h"],
    "tick/hd_state.h": ["scene/hd_world.h"],
    "tick/hd_mode.h": ["tick/hd_state.h"],
    "tick/hd_mode.c": ["tick/hd_mode.h", "base/hd_vector.h"],
}


def test_the_core_keeps_the_order_of_its_rooms() -> None:
    assert faults(includes_of(CSRC)) == []


def test_a_sound_order_has_no_faults() -> None:
    assert faults(SOUND) == []


@pytest.mark.parametrize(
    ("file", "included", "fault"),
    [
        (
            "scene/hd_world.c",
            "tick/hd_tick.h",
            "csrc/scene/hd_world.c includes tick/hd_tick.h, of a room below its own",
        ),
        (
            "tick/hd_waveform.c",
            "scene/hd_index.h",
            "csrc/tick/hd_waveform.c includes scene/hd_index.h, an inner header; the door of scene/ is hd_world.h",
        ),
        (
            "tick/hd_waveform.c",
            "hd_waveform.h",
            'csrc/tick/hd_waveform.c includes "hd_waveform.h", which does not begin with a room',
        ),
        (
            "tick/hd_state.c",
            "tick/hd_mode.h",
            "these files of csrc/ include each other in a circle: tick/hd_mode -> tick/hd_state -> tick/hd_mode",
        ),
    ],
)
def test_each_fault_is_one_line(file: str, included: str, fault: str) -> None:
    assert faults({**SOUND, file: [included]}) == [fault]
