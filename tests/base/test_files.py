"""Finished files get their names, and take no other's."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from hapticd.base.errors import HapticdError
from hapticd.base.partial_files import write_file, write_whole


@pytest.mark.parametrize("links", [True, False])
def test_a_name_that_is_taken_is_not_taken_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, links: bool) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.EPERM, "no hard links here")

    if not links:
        monkeypatch.setattr(os, "link", refuse)
    target = tmp_path / "a.yaml"
    for number, name in enumerate(("a.yaml", "a-2.yaml", "a-3.yaml"), 1):
        assert write_file(target, str(number).encode(), overwrite=False) == tmp_path / name
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {
        "a.yaml": "1",
        "a-2.yaml": "2",
        "a-3.yaml": "3",
    }
    assert write_file(target, b"4", overwrite=True) == target and target.read_text() == "4"
    assert len(list(tmp_path.iterdir())) == 3


def test_what_a_command_found_is_kept_beside_a_file_that_appeared(tmp_path: Path) -> None:
    target = tmp_path / "found.yaml"
    target.write_text("precious")
    told = r"found.yaml: another file has appeared there meanwhile; what was written is in .*/found-2.yaml"
    with pytest.raises(HapticdError, match=told):
        write_whole(str(target), "ours", overwrite=False)
    assert target.read_text() == "precious" and (tmp_path / "found-2.yaml").read_text() == "ours"
    write_whole(str(target), "ours", overwrite=True)
    assert target.read_text() == "ours" and len(list(tmp_path.iterdir())) == 2
