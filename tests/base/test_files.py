"""Files that are written atomically: they get their names, and never replace another program's file."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

import pytest

from hapticd.base.errors import HapticdError
from hapticd.base.files import atomic_file, check_new, write_atomically
from tests.support.special_files import KINDS, refused, special, untouched


@pytest.mark.parametrize("links", [True, False])
def test_a_name_that_is_taken_is_not_taken_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, links: bool) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.EPERM, "no hard links here")

    if not links:
        monkeypatch.setattr(os, "link", refuse)
    target = tmp_path / "a.yaml"
    write_atomically(target, "1", overwrite=False)
    for number in (2, 3):
        with pytest.raises(HapticdError, match=f"the output is in {tmp_path}/a-{number}.yaml"):
            write_atomically(target, str(number), overwrite=False)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {
        "a.yaml": "1",
        "a-2.yaml": "2",
        "a-3.yaml": "3",
    }
    write_atomically(target, "4", overwrite=True)
    assert target.read_text() == "4"
    assert len(list(tmp_path.iterdir())) == 3


def test_the_output_is_kept_next_to_a_file_that_appeared(tmp_path: Path) -> None:
    target = tmp_path / "found.yaml"
    target.write_text("precious")
    message = r"found.yaml: another program created this file meanwhile; the output is in .*/found-2.yaml"
    with pytest.raises(HapticdError, match=message):
        write_atomically(str(target), "ours", overwrite=False)
    assert target.read_text() == "precious" and (tmp_path / "found-2.yaml").read_text() == "ours"
    write_atomically(str(target), "ours", overwrite=True)
    assert target.read_text() == "ours" and len(list(tmp_path.iterdir())) == 2


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_a_target_that_is_not_a_regular_file_is_refused_and_unchanged(
    tmp_path: Path, kind: str, overwrite: bool
) -> None:
    (tmp_path / "real").mkdir()
    end, link = tmp_path / "real" / "found.yaml", tmp_path / "link.yaml"
    special(end, kind)
    link.symlink_to(tmp_path / "second.yaml")
    (tmp_path / "second.yaml").symlink_to(end)
    for place in (end, link):
        for write in (check_new, lambda path, overwrite: write_atomically(path, "ours", overwrite)):
            with untouched(tmp_path), pytest.raises(HapticdError) as caught:
                write(str(place), overwrite)
            assert str(caught.value) == refused(place, kind)


@pytest.mark.parametrize("links", [True, False])
@pytest.mark.parametrize("kind", KINDS)
def test_a_device_or_folder_that_appears_meanwhile_keeps_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, links: bool
) -> None:
    """The same holds with `overwrite`, which allows to replace regular files only."""

    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.EPERM, "no hard links here")

    if not links:
        monkeypatch.setattr(os, "link", refuse)
    for name in "ab":
        target, message = tmp_path / f"{name}.yaml", f"the output is in {tmp_path}/{name}-3.yaml"
        with pytest.raises(HapticdError, match=message), atomic_file(target, overwrite=True) as file:
            file.write(b"ours")
            if name == "a":
                special(tmp_path / "end", kind)
                target.symlink_to("end")
            else:
                special(target, kind)
            (tmp_path / f"{name}-2.yaml").write_text("precious")
            before = target.lstat()
        assert os.path.samestat(target.lstat(), before) and (tmp_path / f"{name}-2.yaml").read_text() == "precious"
        assert (tmp_path / f"{name}-3.yaml").read_text() == "ours"


def test_a_block_that_fails_leaves_the_file_unchanged(tmp_path: Path) -> None:
    target = tmp_path / "a.yaml"
    target.write_text("precious")
    with pytest.raises(RuntimeError), atomic_file(target, overwrite=True) as file:
        file.write(b"half")
        raise RuntimeError
    assert target.read_text() == "precious" and os.listdir(tmp_path) == ["a.yaml"]


def test_a_secret_is_nobody_else_s_to_read(tmp_path: Path) -> None:
    write_atomically(tmp_path / "key", "secret", overwrite=False, mode=0o600)
    assert stat.S_IMODE((tmp_path / "key").stat().st_mode) == 0o600


@pytest.mark.parametrize("there", [True, False])
def test_the_end_of_a_link_is_written_and_the_link_stays(tmp_path: Path, there: bool) -> None:
    (tmp_path / "real").mkdir()
    end, link = tmp_path / "real" / "found.yaml", tmp_path / "link.yaml"
    link.symlink_to("real/found.yaml")
    if there:
        end.write_text("old")
    check_new(str(link), overwrite=there)
    write_atomically(str(link), "ours", overwrite=there)
    assert os.readlink(link) == "real/found.yaml" and end.read_text() == "ours"
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["found.yaml", "link.yaml", "real"]
