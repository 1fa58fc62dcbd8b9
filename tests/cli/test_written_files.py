"""No command replaces a path that is not a regular file: a device, FIFO, socket, folder, or a link to one."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.cli import said
from tests.support.special_files import KINDS, refused, special, untouched

COMMANDS = {
    "record": ("record", "out.npz", "--for", "1s"),
    "record as csv": ("record", "out.csv", "--for", "1s"),
    "record as mcap": ("record", "out.mcap", "--for", "1s"),
    "record, the past": ("record", "out.npz", "--past"),
    "export": ("export", "none.npz", "out.mcap"),
    "simulate": ("simulate", "none.yaml", "--operator", "none.yaml", "-o", "out.npz"),
    "replay": ("replay", "none.npz", "-o", "out.npz"),
    "fit": ("fit", "tap", "none.csv", "-o", "out.yaml"),
    "fit, the report": ("fit", "tap", "none.csv", "--report", "out.png"),
    "fit synthesize": ("fit", "synthesize", "tap", "-o", "out.npz"),
    "calibrate": ("calibrate", "-o", "out.yaml"),
    "calibrate, the plot": ("calibrate", "--plot", "out.png"),
    "devices dump": ("devices", "dump", "1209:5aff", "-o", "out.jsonl"),
    "devices calibrate": ("devices", "calibrate", "-o", "out.yaml", "--yes"),
    "experiment analyze": ("experiment", "analyze", "none", "-o", "out.html"),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("command", COMMANDS)
def test_only_regular_files_are_written(
    command: str, kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = COMMANDS[command]
    (name,) = (word for word in words if word.startswith("out."))
    monkeypatch.chdir(tmp_path)
    Path("elsewhere").mkdir()
    special(Path("elsewhere", name), kind)
    Path("second").symlink_to(Path("elsewhere", name))
    Path(name).symlink_to("second")
    Path("direct").mkdir()
    special(Path("direct", name), kind)
    for place in (name, f"direct/{name}"):
        asked = [place if word == name else word for word in words]
        for overwrite in ([], ["--overwrite"]):
            with untouched(tmp_path):
                assert said(capsys, 1, *asked, *overwrite) == f"hapticd: {refused(place, kind)}\n"
