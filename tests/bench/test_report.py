"""The report itself: pages, figures, percentiles, what happens where something fails, and the command."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from bench import __main__ as bench
from bench import lateness
from bench.plots import Figure, Point, beside, trade
from bench.report import Advance, Options, Section, Table, alternated
from hapticd import cli
from hapticd.base.errors import HapticdError
from hapticd.cli import bench as command

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas


def draw(canvas: Canvas) -> None:
    axes = canvas.add_subplot()
    trade(axes, [Point("a", [1.0, 2.0, 3.0], 1e-3), None, Point("b", [5.0], 0.0, True)])
    beside(canvas, axes)


def section(options: Options, advance: Advance) -> Section:
    advance(1.0, "all")
    return Section("One", ["Words.", Table("Numbers", ["a", "b"], [["x", "1"]]), Figure("one", "A figure", draw)])


def failing(options: Options, advance: Advance) -> Section:
    raise RuntimeError("it broke\nhere")


def test_a_section_in_markdown() -> None:
    assert section(Options(), lambda part, what: None).markdown() == (
        "## One\n\nWords.\n\nNumbers\n\n| a | b |\n| --- | ---: |\n| x | 1 |\n\n![A figure](report/one.png)"
    )


def test_a_part_replaces_its_own_sections() -> None:
    page = "# Page\n\nAbout.\n\n## One\n\nOld.\n\n## Two\n\nStays.\n"
    found = bench.replaced(page, [Section("One", ["New."]), Section("Three", ["More."])])
    assert found == "# Page\n\nAbout.\n\n## One\n\nNew.\n\n## Two\n\nStays.\n\n## Three\n\nMore.\n"


@pytest.mark.usefixtures("measurements")
def test_a_part_goes_into_the_page_that_is_there_and_says_how_it_was_made(tmp_path: Path) -> None:
    (tmp_path / "accuracy.md").write_text("# Page\n\nAbout.\n\n## One\n\nOld.\n\n## Two\n\nStays.\n", encoding="utf-8")
    assert bench.perform(["good"], Options(), tmp_path, overwrite=True) == 0
    text = (tmp_path / "accuracy.md").read_text(encoding="utf-8")
    assert text.startswith("# Page\n\nAbout.\n\n## One\n\nWords.")
    assert re.search(r"\n\n`python -m bench good`, \d+ s, by itself: ", text)
    assert "Old." not in text and text.endswith("## Two\n\nStays.\n")


def test_runs_take_turns() -> None:
    order: list[str] = []

    def run(name: str, value: float) -> float:
        order.append(name)
        return value

    heard: list[float] = []
    found = alternated(3, {name: lambda name=name: run(name, len(order)) for name in "abc"}, heard.append)  # type: ignore[misc]
    assert order == list("abc" + "abc" + "bca" + "cab")
    assert heard == pytest.approx([1 / 3, 2 / 3, 1])
    assert found["b"].tolist() == [4, 6, 11]


def test_weighted_percentiles_are_those_of_all_values() -> None:
    rng = np.random.default_rng(1)
    values, count = rng.normal(size=50), rng.integers(1, 9, 50).astype(np.float64)
    every = np.repeat(values, count.astype(int))
    for percentile in (1.0, 50.0, 99.0, 100.0):
        expected = np.percentile(every, percentile, method="inverted_cdf")
        assert lateness.weighted(values, count, percentile) == expected
    middle = np.percentile(every, 50, method="inverted_cdf")
    expected_jitter = np.percentile(np.abs(every - middle), lateness.PERCENTILES, method="inverted_cdf")
    assert lateness.jitter_of(values, count) == pytest.approx(expected_jitter)


def test_a_quarter_of_a_period_is_ninety_degrees() -> None:
    assert lateness.phase_degrees(100.0, 2.5e6) == pytest.approx(90.0)


@pytest.fixture
def measurements(monkeypatch: pytest.MonkeyPatch) -> None:
    few = {
        "good": bench.Measurement("that works", section),
        "bad": bench.Measurement("that fails", failing, (bench.SPEED,)),
    }
    monkeypatch.setattr(bench, "MEASUREMENTS", few)


@pytest.mark.usefixtures("measurements")
def test_what_fails_says_so_and_the_rest_is_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert bench.perform([], Options(quick=True), tmp_path) == 1
    assert "![A figure](report/one.png)" in (tmp_path / "accuracy.md").read_text(encoding="utf-8")
    assert "**Not measured:** it broke here" in (tmp_path / "benchmarks.md").read_text(encoding="utf-8")
    assert (tmp_path / "report" / "one.png").read_bytes().startswith(b"\x89PNG")
    assert "bench: not measured: bad" in capsys.readouterr().err
    with pytest.raises(HapticdError, match=r"benchmarks.md: is there already; give another name, or --overwrite"):
        bench.perform(["bad"], Options(quick=True), tmp_path)
    assert bench.perform(["bad"], Options(quick=True), tmp_path, overwrite=True) == 1


@pytest.mark.usefixtures("measurements")
def test_a_part_writes_nothing_unless_asked_to(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(bench, "DOCS", tmp_path)
    assert bench.perform(["good"], Options(), None) == 0
    assert bench.perform([], Options(quick=True), None) == 1
    assert list(tmp_path.iterdir()) == []


def test_the_command_names_what_there_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["bench", "--list"]) == 0
    said = capsys.readouterr().out
    assert all(name in said for name in bench.MEASUREMENTS)
    assert cli.main(["bench", "nothing"]) == 2
    assert "unknown benchmark nothing; known: rendered," in capsys.readouterr().err


def test_an_installed_hapticd_says_where_the_benchmarks_are(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, "TREE", tmp_path)
    assert cli.main(["bench"]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "the benchmarks are not installed with hapticd: run this in a source tree" in said


def test_what_is_missing_is_told_before_anything_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "NEEDED", ("no_such_module",))
    with pytest.raises(HapticdError, match="need no_such_module: pip install"):
        bench.perform([], Options(quick=True), None)


@pytest.mark.usefixtures("measurements")
def test_a_folder_that_cannot_be_is_told_before_anything_is_measured(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(HapticdError, match="file/report: cannot be made: Not a directory"):
        bench.perform([], Options(quick=True), tmp_path / "file" / "report")
    assert "not measured" not in capsys.readouterr().err
