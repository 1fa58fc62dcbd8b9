"""What tests of the command line share."""

from __future__ import annotations

import pytest

from hapticd.cli import main


def said(capsys: pytest.CaptureFixture[str], code: int, *arguments: str) -> str:
    """The one line on stderr of a command that fails with `code`."""
    assert main(arguments) == code
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("hapticd: ") and captured.err.count("\n") == 1, captured.err
    return captured.err
