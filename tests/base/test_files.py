"""Finished files get their names, and take no other's."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from hapticd.base.errors import HapticdError
from hapticd.base.partial_files import check_new, write_file, write_whole
from tests.support.special_files import KINDS, refused, special, untouched


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


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_what_is_no_regular_file_is_refused_and_left(tmp_path: Path, kind: str, overwrite: bool) -> None:
    (tmp_path / "real").mkdir()
    end, link = tmp_path / "real" / "found.yaml", tmp_path / "link.yaml"
    special(end, kind)
    link.symlink_to(tmp_path / "second.yaml")
    (tmp_path / "second.yaml").symlink_to(end)
    for place in (end, link):
        for write in (check_new, lambda path, overwrite: write_whole(path, "ours", overwrite)):
            with untouched(tmp_path), pytest.raises(HapticdError) as caught:
                write(str(place), overwrite)
            assert str(caught.value) == refused(place, kind)


@pytest.mark.parametrize("links", [True, False])
@pytest.mark.parametrize("kind", KINDS)
def test_what_appears_meanwhile_and_is_no_regular_file_keeps_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, links: bool
) -> None:
    """Also with `overwrite`, which is about that name alone."""

    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.EPERM, "no hard links here")

    special(tmp_path / "end", kind)
    (tmp_path / "a.yaml").symlink_to("end")
    special(tmp_path / "b.yaml", kind)
    if not links:
        monkeypatch.setattr(os, "link", refuse)
    for name in "ab":
        (tmp_path / f"{name}-2.yaml").write_text("precious")
        with untouched(tmp_path, f"{name}-3.yaml"):
            assert write_file(tmp_path / f"{name}.yaml", b"ours", overwrite=True) == tmp_path / f"{name}-3.yaml"
        assert (tmp_path / f"{name}-2.yaml").read_text() == "precious"


@pytest.mark.parametrize("there", [True, False])
def test_the_end_of_a_link_is_written_and_the_link_stays(tmp_path: Path, there: bool) -> None:
    (tmp_path / "real").mkdir()
    end, link = tmp_path / "real" / "found.yaml", tmp_path / "link.yaml"
    link.symlink_to("real/found.yaml")
    if there:
        end.write_text("old")
    check_new(str(link), overwrite=there)
    write_whole(str(link), "ours", overwrite=there)
    assert os.readlink(link) == "real/found.yaml" and end.read_text() == "ours"
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["found.yaml", "link.yaml", "real"]
