"""`hapticd bench`: the list of benchmarks, and errors."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench import __main__ as bench
from hapticd import cli
from hapticd.cli import machine
from tests.support.special_files import KINDS, special


def test_the_command_lists_all_benchmarks(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["bench", "--list"]) == 0
    said = capsys.readouterr().out
    assert all(name in said for name in bench.MEASUREMENTS)
    assert cli.main(["bench", "nothing"]) == 2
    assert "unknown benchmark nothing; known: closed_loop," in capsys.readouterr().err


def test_no_benchmark_has_the_name_of_another_program_of_bench() -> None:
    """`python -m bench NAME` runs a benchmark, `python -m bench.NAME` a module with a command line of its own."""
    modules = Path(bench.__file__).parent.glob("*.py")
    programs = {path.stem for path in modules if f"    python -m bench.{path.stem} [" in path.read_text()}
    assert "loops" in programs
    assert not programs & set(bench.MEASUREMENTS)


def test_an_installed_hapticd_reports_that_benchmarks_need_a_source_tree(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(machine, "SOURCE_TREE", tmp_path)
    assert cli.main(["bench"]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "hapticd bench: not in a source tree; the benchmarks need one" in said


def test_quick_figures_do_not_replace_those_of_docs(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["bench", "tick", "--quick", "--overwrite"]) == 1
    message = "hapticd: --quick measures too little for docs: give another folder with --out, or no --overwrite\n"
    assert capsys.readouterr().err == message


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("overwrite", [[], ["--overwrite"]])
def test_a_page_is_written_only_to_a_regular_file(
    kind: str, overwrite: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(bench, "_measure", lambda *_: pytest.fail("a measurement before the check"))
    message = special(tmp_path / bench.ACCURACY, kind)
    assert cli.main(["bench", "closed_loop", "--quick", "--out", str(tmp_path), *overwrite]) == 1
    assert capsys.readouterr().err == f"hapticd: {message}\n"
