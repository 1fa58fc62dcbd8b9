"""`hapticd bench`: the list of benchmarks, and errors."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path

import pytest

from bench import __main__ as bench
from bench import stability
from bench.link import BEGIN, END
from bench.report import Advance, Options, Section
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


@pytest.mark.parametrize(
    "where", [["--overwrite"], ["--out", str(bench.DOCS)], ["--out", str(bench.DOCS / ".." / "docs")]]
)
def test_quick_figures_do_not_replace_those_of_docs(where: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["bench", "link", "--quick", *where]) == 1
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


def measured(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """Let a benchmark take no time; its section has the title "Measured" and the text "new"."""

    def run(options: Options, advance: Advance) -> Section:
        return Section("Measured", ["new"])

    about, page = bench.MEASUREMENTS[name].about, bench.MEASUREMENTS[name].page
    monkeypatch.setitem(bench.MEASUREMENTS, name, bench.Measurement(about, run, page))


def test_the_section_of_links_goes_into_the_page_of_docs_by_any_name_of_the_folder(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    measured(monkeypatch, "link")
    monkeypatch.setattr(bench, "DOCS", tmp_path / "docs")
    monkeypatch.chdir(tmp_path)
    page = tmp_path / "docs" / bench.DEVICES
    page.parent.mkdir()
    page.write_text(f"# By hand\n{BEGIN}old\n{END}More\n")
    assert cli.main(["bench", "link", "--out", "docs"]) == 0
    text = page.read_text()
    assert text.startswith(f"# By hand\n{BEGIN}\nnew\n") and text.endswith(f"{END}More\n")


def test_another_folder_gets_a_page_with_the_section_of_links(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    measured(monkeypatch, "link")
    assert cli.main(["bench", "link", "--quick", "--out", str(tmp_path)]) == 0
    page = tmp_path / bench.DEVICES
    assert "## Measured\n\nnew\n" in page.read_text()
    page.write_text("another page\n")
    assert cli.main(["bench", "link", "--quick", "--out", str(tmp_path)]) == 1
    assert page.read_text() == "another page\n"


@pytest.mark.parametrize("out", [True, False])
def test_the_maps_of_stability_are_drawn_beside_the_pages(
    out: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    points = [stability.Limits(at, *[100.0] * 6, again=0.0) for at in (0.0, 1.0, 2.0)]
    monkeypatch.setattr(stability, "workers", nullcontext)
    monkeypatch.setattr(stability, "swept", lambda *_: [])
    monkeypatch.setattr(stability, "mapped", lambda *_, **__: points)
    monkeypatch.setattr(bench, "DOCS", tmp_path / "docs")
    folder = tmp_path / "other"
    assert cli.main(["bench", "stability", "--quick", *(["--out", str(folder)] if out else [])]) == 0
    found = sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.*"))
    assert found == (["other/accuracy.md", "other/stability.png"] if out else [])
