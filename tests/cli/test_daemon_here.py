"""Commands that must run on the daemon's machine."""

from __future__ import annotations

from pathlib import Path

import pytest

from hapticd.cli import main
from hapticd.protocol.keys import new_certificate, write_certificate


@pytest.mark.parametrize(
    ("command", "arguments"),
    [("web", ""), ("lsl", ""), ("experiment run", "okamura1998_tapping --participant P07 --text")],
)
def test_the_address_of_another_machine_is_refused_in_one_line(
    command: str, arguments: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_certificate(new_certificate(), "ours", tmp_path)
    keys = ["--key", str(tmp_path / "ours.key_secret"), "--server-key", str(tmp_path / "ours.key")]
    assert main(["--connect", "tcp://127.0.0.1:9", *keys, *command.split(), *arguments.split()]) == 1
    told = f"tcp://127.0.0.1:9: hapticd {command} runs on the daemon's machine, and takes no other"
    assert capsys.readouterr().err == f"hapticd: {told}\n"
