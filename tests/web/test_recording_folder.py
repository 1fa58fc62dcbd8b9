"""The folder of recordings: a page can name only the recordings in the folder."""

import os
from pathlib import Path

import pytest

from hapticd.base.errors import HapticdError
from hapticd.web.recording_folder import RecordingFolder, checked_name, default_folder


@pytest.fixture
def folder(tmp_path: Path) -> RecordingFolder:
    made = RecordingFolder(tmp_path / "recordings")
    made.target("first.npz").write_bytes(b"one")
    return made


@pytest.mark.parametrize("name", ["tap 3.npz", "Ärger-2.npz", "2026-11-23 14.05.npz", "a+b_c.npz", "1" * 60 + ".npz"])
def test_names_of_recordings_are_accepted(name: str) -> None:
    assert checked_name(name) == name


@pytest.mark.parametrize(
    "name",
    [
        "../secret.npz",
        "a/b.npz",
        "/etc/passwd.npz",
        "a\\b.npz",
        "..npz",
        "a..b.npz",
        ".hidden.npz",
        "-o.npz",
        "a\n.npz",
        "a\x00.npz",
        "tap.yaml",
        "tap",
        "",
        ".npz",
        "tap .npz",
        "tap..npz",
        "tap.NPZ",
        "a" * 65 + ".npz",
        "~/a.npz",
        "a:b.npz",
        None,
        3,
        ["tap.npz"],
    ],
)
def test_other_names_are_refused(name: object, folder: RecordingFolder) -> None:
    with pytest.raises(HapticdError):
        checked_name(name)
    with pytest.raises(HapticdError):
        folder.target(name)
    with pytest.raises(HapticdError), folder.file(name):
        pass
    with pytest.raises(HapticdError):
        folder.delete(name)


def test_the_list_has_only_recordings_and_the_newest_first(folder: RecordingFolder) -> None:
    folder.target("second.npz").write_bytes(b"second")
    os.utime(folder.path / "first.npz", ns=(1, 1))
    (folder.path / "notes.txt").write_text("no recording")
    (folder.path / ".first.npz.1.00.part").write_text("under way")
    (folder.path / "folder.npz").mkdir()
    os.mkfifo(folder.path / "pipe.npz")
    os.symlink("first.npz", folder.path / "link.npz")
    found = folder.list()
    assert [(each.name, each.size) for each in found] == [("second.npz", 6), ("first.npz", 3)]


def test_a_folder_that_is_not_there_is_empty(tmp_path: Path) -> None:
    folder = RecordingFolder(tmp_path / "a" / "b")
    assert folder.list() == []
    assert folder.free_bytes()
    assert not folder.path.exists()


def test_a_file_is_read(folder: RecordingFolder) -> None:
    with folder.file("first.npz") as file:
        assert file.read() == b"one"


@pytest.mark.parametrize("make", ["symlink", "folder", "pipe"])
def test_only_regular_files_are_opened(folder: RecordingFolder, tmp_path: Path, make: str) -> None:
    secret, place = tmp_path / "secret", folder.path / "link.npz"
    secret.write_text("secret")
    match make:
        case "symlink":
            os.symlink(secret, place)
        case "folder":
            place.mkdir()
        case "pipe":
            os.mkfifo(place)
    with pytest.raises(HapticdError, match=r"link\.npz: no such recording"), folder.file("link.npz"):
        pass
    with pytest.raises(HapticdError, match="no such recording"):
        folder.delete("link.npz")
    assert os.path.lexists(place)


def test_the_name_of_an_existing_file_or_dangling_link_is_refused(folder: RecordingFolder) -> None:
    with pytest.raises(HapticdError, match=r"first\.npz already exists"):
        folder.target("first.npz")
    os.symlink("/nowhere", folder.path / "gone.npz")
    with pytest.raises(HapticdError, match="already"):
        folder.target("gone.npz")


def test_a_recording_is_deleted_once(folder: RecordingFolder) -> None:
    folder.delete("first.npz")
    assert folder.list() == []
    with pytest.raises(HapticdError, match=r"first\.npz: no such recording"):
        folder.delete("first.npz")


def test_a_folder_that_cannot_be_used_says_so(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    folder = RecordingFolder(tmp_path / "file")
    with pytest.raises(HapticdError, match="cannot be used for recordings: Not a directory"):
        folder.list()
    with pytest.raises(HapticdError, match="cannot be used for recordings: File exists"):
        folder.target("a.npz")


def test_the_default_is_in_the_home_of_data() -> None:
    assert default_folder({"STATE_DIRECTORY": "/var/lib/hapticd-web"}) == Path("/var/lib/hapticd-web/recordings")
    assert default_folder({"XDG_DATA_HOME": "/data"}) == Path("/data/hapticd/recordings")
    assert default_folder({"XDG_DATA_HOME": "relative"}) == Path.home() / ".local/share/hapticd/recordings"
