"""The limit of descriptors of the daemon, and how many connections it allows."""

from __future__ import annotations

import resource

import pytest

from hapticd.system import open_files


@pytest.mark.parametrize(
    ("limits", "wanted", "connections"),
    [
        ((1024, 524_288), 65_536, 1024),
        ((1024, resource.RLIM_INFINITY), 65_536, 1024),
        ((1024, 4096), 4096, 1024),
        ((1024, 1024), None, 384),
        ((256, 512), 512, 128),
        ((64, 64), None, 8),
        ((resource.RLIM_INFINITY, resource.RLIM_INFINITY), None, 1024),
    ],
)
def test_the_limit_is_raised_and_a_reserve_is_left(
    monkeypatch: pytest.MonkeyPatch, limits: tuple[int, int], wanted: int | None, connections: int
) -> None:
    asked: list[tuple[int, int]] = []
    monkeypatch.setattr(resource, "getrlimit", lambda _: limits)
    monkeypatch.setattr(resource, "setrlimit", lambda _, new: asked.append(new))
    assert open_files.raise_descriptor_limit() == connections
    assert asked == ([] if wanted is None else [(wanted, limits[1])])
