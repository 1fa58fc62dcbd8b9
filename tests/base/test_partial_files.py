"""Parts of recordings where others write, too, and what becomes of parts that were damaged."""

from __future__ import annotations

import errno
import os
import random
import re
import stat
from pathlib import Path

import pytest

from hapticd.base.errors import HapticdError
from hapticd.base.partial_files import Folder, PartialFile, new_stem, resolved, write_file
from hapticd.cli import main
from hapticd.recording.formats import open_writer
from hapticd.recording.reader import load_recorded
from hapticd.recording.recovery import partial_files_beside, recover
from tests.recording.test_writer import FORMS, noisy, record_until_killed, some

SECRET = '["texts", "root:$6$hash"]\n'


def planted(folder: Path, name: str) -> Path:
    """A file that is nobody's business, and a part that leads to it."""
    secret = folder.parent / "secret"
    secret.write_text(SECRET)
    for kind in ("part", "notes"):
        (folder / f".{name}.99999.{kind}").symlink_to(secret)
        (folder / f".{name}.99999.0123456789abcdef.{kind}").symlink_to(secret)
    return secret


@pytest.mark.parametrize("ending", FORMS)
def test_a_planted_part_is_named_and_never_followed(tmp_path: Path, ending: str) -> None:
    folder = tmp_path / "shared"
    folder.mkdir()
    target = folder / f"tap.{ending}"
    secret = planted(folder, target.name)
    (told,) = partial_files_beside(target)
    assert f".{target.name}.99999.part" in told and told.endswith("is no part of ours, and left as it is")
    with open_writer(target) as writer:
        writer.write(some(3))
        writer.finish({"scene": {}})
    found = recover(target)
    assert found.files == [] and found.problems == [told]
    assert secret.read_text() == SECRET
    assert sum(path.is_symlink() for path in folder.iterdir()) == 4


def test_a_second_name_of_a_file_is_no_part_of_ours(tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.write_text(SECRET)
    os.link(other, tmp_path / ".tap.npz.1.0123456789abcdef.part")
    os.mkfifo(tmp_path / ".tap.npz.2.0123456789abcdef.part")
    (told,) = recover(tmp_path / "tap.npz").problems
    assert "is no part of ours" in told and other.read_text() == SECRET
    folder = Folder(tmp_path)
    with pytest.raises(PermissionError):
        PartialFile(folder, ".tap.npz.1.0123456789abcdef.part", resume=True)
    folder.close()


@pytest.mark.parametrize("there", [True, False])
def test_a_new_part_is_never_what_has_its_name_already(tmp_path: Path, there: bool) -> None:
    secret = tmp_path / "secret"
    if there:
        secret.write_text(SECRET)
    (tmp_path / ".link.part").symlink_to(secret)
    (tmp_path / ".file.part").write_text(SECRET)
    folder = Folder(tmp_path)
    for name in (".link.part", ".file.part"):
        with pytest.raises(FileExistsError):
            PartialFile(folder, name)
    folder.close()
    assert secret.exists() == there and (tmp_path / ".file.part").read_text() == SECRET


def test_a_part_that_was_left_is_not_opened_through_a_link(tmp_path: Path) -> None:
    """Though it leads to a file of ours."""
    ours = tmp_path / "ours"
    ours.write_text(SECRET)
    (tmp_path / ".tap.npz.1.0123456789abcdef.part").symlink_to(ours)
    folder = Folder(tmp_path)
    with pytest.raises(OSError) as caught:
        PartialFile(folder, ".tap.npz.1.0123456789abcdef.part", resume=True)
    folder.close()
    assert caught.value.errno == errno.ELOOP


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can make another user's file")
def test_a_part_of_another_user_is_named_and_left(tmp_path: Path) -> None:
    part = tmp_path / ".tap.npz.1.0123456789abcdef.part"
    part.write_text(SECRET)
    os.chown(part, 12345, 12345)
    (told,) = recover(tmp_path / "tap.npz").problems
    assert "is no part of ours" in told and part.read_text() == SECRET
    folder = Folder(tmp_path)
    with pytest.raises(PermissionError):
        PartialFile(folder, part.name, resume=True)
    folder.close()


def test_nobody_can_guess_the_name_of_a_part(tmp_path: Path) -> None:
    target = tmp_path / "tap.npz"
    assert len({new_stem(target) for _ in range(100)}) == 100
    with open_writer(target) as writer:
        writer.write(some(3))
        part, notes = sorted(os.listdir(tmp_path), reverse=True)
        assert re.fullmatch(rf"\.tap\.npz\.{os.getpid()}\.[0-9a-f]{{16}}\.part", part), part
        assert notes == part.replace(".part", ".notes")


def test_a_part_that_is_not_the_one_we_opened_gets_no_name(tmp_path: Path) -> None:
    target = tmp_path / "tap.npz"
    with pytest.raises(HapticdError, match="it was removed while it was being written"), open_writer(target) as writer:
        writer.write(some(3))
        (part,) = tmp_path.glob(".tap.npz.*.part")
        part.rename(tmp_path / "aside")
        part.write_text("theirs")
        writer.finish({})
    assert part.read_text() == "theirs" and not target.exists()


@pytest.mark.parametrize("overwrite", [False, True])
def test_other_files_are_written_beside_a_planted_part_too(tmp_path: Path, overwrite: bool) -> None:
    target = tmp_path / "wood.yaml"
    (tmp_path / f".wood.yaml.{os.getpid()}.part").write_text("theirs")
    assert write_file(target, b"ours", overwrite) == target
    assert target.read_bytes() == b"ours" and len(os.listdir(tmp_path)) == 2


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can make another user's link")
@pytest.mark.parametrize("mode", [0o1777, 0o770])
def test_a_target_that_another_user_made_a_link_is_refused(tmp_path: Path, mode: int) -> None:
    folder = tmp_path / "shared"
    folder.mkdir()
    folder.chmod(mode)
    link = folder / "tap.npz"
    link.symlink_to(tmp_path / "made.npz")
    os.lchown(link, 12345, 12345)
    with pytest.raises(HapticdError, match=r"tap.npz: is another user's link, in a folder that others may write to"):
        open_writer(link)
    folder.chmod(0o700)
    assert resolved(link) == tmp_path / "made.npz"


# ---- What becomes of folder and part meanwhile -----------------------------------------------------------------------


@pytest.mark.parametrize("another", [True, False])
@pytest.mark.parametrize("ending", FORMS)
def test_a_folder_that_was_renamed_has_the_recording(tmp_path: Path, ending: str, another: bool) -> None:
    (tmp_path / "a").mkdir()
    with open_writer(tmp_path / "a" / f"run.{ending}") as writer:
        writer.write(some(3))
        (tmp_path / "a").rename(tmp_path / "b")
        if another:
            (tmp_path / "a").mkdir()
        writer.finish({"scene": {}})
        assert writer.displaced and writer.target == tmp_path / "b" / f"run.{ending}"
    assert len(load_recorded(tmp_path / "b" / f"run.{ending}").samples) == 3
    assert not another or os.listdir(tmp_path / "a") == []


@pytest.mark.parametrize("ending", FORMS)
def test_a_part_that_was_removed_ends_the_recording_at_once(tmp_path: Path, ending: str) -> None:
    told = f"run.{ending}: cannot be written: it was removed while it was being written"
    with pytest.raises(HapticdError, match=told), open_writer(tmp_path / f"run.{ending}") as writer:
        writer.write(noisy(10, 0))
        for path in tmp_path.iterdir():
            path.unlink()
        for batch in range(1, 100):
            writer.write_event({"event": "overrun", "tick": 1, "time_ns": 2, "missed": 3, "count": 1})
            writer.write(noisy(1000, 1000 * batch))
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("ending", FORMS)
def test_what_cannot_get_its_name_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    target = tmp_path / f"a run.{ending}"
    monkeypatch.setattr(os, "link", refuse)
    with pytest.raises(HapticdError) as caught, open_writer(target) as writer:
        writer.begin({"scene": {"objects": {}}}, {"notes": {}})
        writer.write(noisy(20_000, 0))
        writer.finish({})
    assert str(caught.value) == (
        f"{target}: cannot be written: Permission denied; what was recorded is kept, and `hapticd recover '{target}'` "
        "makes a file of it"
    )
    monkeypatch.undo()
    (told,) = partial_files_beside(target)
    assert f"hapticd recover '{target}'" in told
    (made,) = recover(target).files
    assert load_recorded(made).samples.tobytes() == noisy(20_000, 0).tobytes()
    assert not [name for name in os.listdir(tmp_path) if name.startswith(".")]


# ---- Parts that were damaged -------------------------------------------------------------------------------------


def damages(source: random.Random, path: Path) -> None:
    """Changes a file as disks and people do."""
    content = bytearray(path.read_bytes())
    at = source.randrange(len(content)) if content else 0
    match source.randrange(9):
        case 0:
            content.clear()
        case 1:
            del content[at:]
        case 2:
            content[at : at + 64] = source.randbytes(64)
        case 3:
            content[:64] = source.randbytes(64)
        case 4:
            content[:] = b"\0" * len(content)
        case 5:
            content[:] = b'["texts", []]\n["dtype", [["tick", "|O"]]]\n["event", 5]\n[1]\n5\n[]\n'
        case 6 if source.random() < 0.5:
            content[:] = b'["dtype", [["tick", "<u8,("], ["time_ns", "<i8"]]]\n' + content
        case 6:
            content[:] = b"root:$6$secret:0:0\n" * 100
        case 7:
            content[at : at + 8] = b"\xff" * 8
        case _:
            content[:] = b'["dtype", [["tick", "<u8", [1000000]], ["time_ns", "|V0"]]]\n' + content[:at]
    path.write_bytes(content)


@pytest.mark.parametrize("ending", FORMS)
def test_a_damaged_part_stops_no_recording_and_shows_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], ending: str
) -> None:
    given = tmp_path / "given"
    given.mkdir()
    record_until_killed(given / f"run.{ending}", some(500))
    whole = {path.name: path.read_bytes() for path in given.iterdir()}
    source = random.Random(7)
    target = tmp_path / f"run.{ending}"
    for number in range(60):
        for path in (*tmp_path.glob(".run.*"), *tmp_path.glob("run*")):
            path.unlink()
        for name, content in whole.items():
            (tmp_path / name).write_bytes(content)
        for name in source.sample(sorted(whole), source.choice((1, 1, 2))):
            if source.random() < 0.05:
                (tmp_path / name).unlink()
            else:
                damages(source, tmp_path / name)
        assert len(list(partial_files_beside(target))) == any(
            name.endswith(".part") for name in os.listdir(tmp_path)
        ), number
        with open_writer(target) as writer:
            writer.write(some(3))
            writer.finish({"scene": {}})
        assert len(load_recorded(target).samples) == 3
        code = main(["recover", str(target)])
        out, err = capsys.readouterr()
        assert code in (0, 1) and "Traceback" not in err and "$6$" not in err and (out + err).isascii(), err
        assert all(line.startswith("hapticd: ") for line in err.splitlines()), err
        for line in out.splitlines():
            load_recorded(line)


def test_what_is_left_stays_where_the_disk_takes_no_file_of_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    target = tmp_path / "run.npz"
    record_until_killed(target, some(500))
    before = {path.name: path.stat().st_size for path in tmp_path.iterdir()}
    monkeypatch.setattr(os, "fsync", full)
    (told,) = recover(target).problems
    assert "cannot be finished, and is left as it is" in told and "No space left on device" in told
    monkeypatch.undo()
    assert {path.name: path.stat().st_size for path in tmp_path.iterdir()} == before
    (made,) = recover(target).files
    assert load_recorded(made).samples.tobytes() == some(500).tobytes()
    assert stat.S_ISREG(made.stat().st_mode)


def test_recover_says_that_nothing_lies_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["recover", str(tmp_path / "run.npz")]) == 1
    assert capsys.readouterr().err == f"hapticd: {tmp_path}/run.npz: no recording into it left anything\n"
