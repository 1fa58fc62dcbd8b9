"""The checks of the core's files find faults, and the core passes them."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.project.check_includes import CSRC, Includes, faults, has_purpose_comment, includes_of, unexplained_files

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
            "csrc/scene/hd_world.c includes tick/hd_tick.h, of a room below",
        ),
        (
            "tick/hd_waveform.c",
            "scene/hd_index.h",
            "csrc/tick/hd_waveform.c includes scene/hd_index.h, a private header; public: hd_world.h",
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


def test_each_file_of_the_core_says_what_it_is_for() -> None:
    assert unexplained_files(CSRC) == []


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("/* Fields: constant, spring and viscous ones. */\n", True),
        ("/* Walls are half planes of the\n * plane. */\n", True),
        ('#include "tick/hd_tap.h"\n/* What an onset of a contact strikes. */\n', False),
        ("/* See hd_index.h. */\n", False),
        ("// clang-format off\n/* The motion of the simulated handle. */\n", False),
        ("/* Triples, see\n * hd_triple.h for what they are. */\n", False),
    ],
)
def test_a_first_line_is_a_comment_of_four_words(text: str, says: bool) -> None:
    assert has_purpose_comment(text) == says


def test_the_list_of_a_room_is_complete(tmp_path: Path) -> None:
    room = tmp_path / "tick"
    room.mkdir()
    (room / "hd_tick.h").write_text("/* The files of this room:\n *\n *   hd_tick   the stages\n */\n")
    (room / "hd_tap.c").write_text("/* The tap of an onset. */\n")
    assert unexplained_files(tmp_path) == ["csrc/tick/hd_tap.c is missing in the list at the top of hd_tick.h"]
