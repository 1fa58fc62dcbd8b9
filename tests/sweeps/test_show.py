"""`hapticd sweep show`, as users call it: table, PNG, page and errors."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
import yaml

from hapticd.cli import main
from hapticd.system.extras import install_command
from tests.support.special_files import KINDS, special, untouched
from tests.sweeps.results_of import MASS, RATE, STIFFNESS, study_of

PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The results of a study of six points."""
    path = tmp_path_factory.mktemp("study")
    file = path / "study.yaml"
    file.write_text("# my own words\n" + yaml.safe_dump(study_of(vary={RATE: [1000, 2000, 4000], MASS: [0.04, 0.08]})))
    assert main(["sweep", "run", str(file), "-o", str(path / "results"), "--threads"]) == 0
    return str(path / "results")


def ran(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    capsys.readouterr()
    code = main(["sweep", "show", *words])
    printed = capsys.readouterr()
    return code, printed.out, printed.err


@pytest.mark.long
def test_figures_and_page_are_written_in_addition_to_the_table(
    folder: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page, figures = tmp_path / "page.html", tmp_path / "new" / "figures"
    code, out, err = ran(capsys, folder, "--figures", str(figures), "--html", str(page))
    assert code == 0 and len(out.splitlines()) == 8
    names = ["1-stability-factor-over-rate.png", "2-passive-limit-over-rate.png"]
    assert sorted(path.name for path in figures.iterdir()) == names
    assert all((figures / name).read_bytes().startswith(PNG) for name in names)
    assert [line.rpartition("/")[2] for line in err.splitlines()] == [*names, "page.html"]
    text = page.read_text()
    assert "# my own words" in text and text.count("<svg ") == 2
    code, _, err = ran(capsys, folder, "--html", str(page))
    assert code == 1 and err.startswith(f"hapticd: {page}: ") and len(err.splitlines()) == 1
    code, _, _ = ran(capsys, folder, "--html", str(page), "--overwrite")
    assert code == 0 and page.read_text() == text, "the same page each time"


@pytest.mark.parametrize("kind", KINDS)
def test_page_and_figures_are_written_only_to_regular_files(
    kind: str, folder: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, option, value in (
        ("page.html", "--html", "page.html"),
        ("figures/1-stability-factor-over-rate.png", "--figures", "figures"),
    ):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        message = special(tmp_path / name, kind)
        for overwrite in ([], ["--overwrite"]):
            with untouched(tmp_path):
                code, out, err = ran(capsys, folder, option, str(tmp_path / value), *overwrite)
            assert (code, out, err) == (1, "", f"hapticd: {message}\n")


def test_the_option_where_selects_rows(folder: str, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = ran(capsys, folder, "--where", "rate_hz=2000", "--where", f"{MASS}=0.08", "--json")
    (row,) = json.loads(out)["rows"]
    assert code == 0 and (row[RATE], row[MASS]) == (2000, 0.08)
    code, out, _ = ran(capsys, folder, "--where", "rate_hz=2000")
    assert code == 0 and len(out.splitlines()) == 4


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--where", "rate_hz"], "--where rate_hz: must be COLUMN=VALUE"),
        (["--where", "rate=1000"], "--where rate=1000: unknown column rate; known: point, device"),
        (["--where", "rate_hz=fast"], "--where rate_hz=fast: servo.rate_hz must be a number"),
        (["--html", "page.pdf"], "page.pdf: must end in .html"),
    ],
)
def test_a_usage_error_is_one_line(
    words: list[str], message: str, folder: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = ran(capsys, folder, *words)
    assert code == 1 and out == "" and message in err and len(err.splitlines()) == 1, err


def test_without_matplotlib_one_line_says_what_is_missing(
    folder: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    code, out, err = ran(capsys, folder, "--figures", str(tmp_path / "figures"))
    assert (code, out) == (1, "") and err == f"hapticd: a figure needs matplotlib: {install_command('fit')}\n"
    assert not (tmp_path / "figures").exists()
    code, out, _ = ran(capsys, folder)
    assert code == 0 and len(out.splitlines()) == 8


def test_results_of_another_kind_have_no_figures(
    folder: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("points.npy", "study.json"):
        (tmp_path / name).write_bytes(Path(folder, name).read_bytes())
    manifest = json.loads((tmp_path / "study.json").read_text())
    (tmp_path / "study.json").write_text(json.dumps({**manifest, "kind": "other"}))
    code, _, err = ran(capsys, str(tmp_path), "--html", str(tmp_path / "page.html"))
    assert code == 1 and "holds no results of a sweep" in err and len(err.splitlines()) == 1


def test_before_a_point_is_computed_nothing_is_drawn(
    folder: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("points.npy", "study.json"):
        (tmp_path / name).write_bytes(Path(folder, name).read_bytes())
    (tmp_path / "pieces").mkdir()
    code, _, err = ran(capsys, str(tmp_path), "--html", str(tmp_path / "page.html"))
    assert code == 1 and "no point has been computed yet" in err and len(err.splitlines()) == 1


@pytest.mark.long
def test_a_study_whose_points_have_no_result_is_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Every point has an error: the map has only crosses."""
    keys = {"vary": {RATE: [1000, 2000], STIFFNESS: [100, 200]}, "measure": [{"displayed_error": {"material": "m"}}]}
    figure = {"kind": "map", "x": RATE, "y": STIFFNESS, "color": "displayed_error"}
    file, results = tmp_path / "study.yaml", str(tmp_path / "results")
    file.write_text(yaml.safe_dump({**study_of(**keys), "figures": [figure]}))
    assert main(["sweep", "run", str(file), "-o", results, "--threads"]) == 1
    code, out, _ = ran(capsys, results, "--html", str(tmp_path / "page.html"), "--figures", str(tmp_path))
    assert code == 0 and "m is not a material with a tap" in out
    assert "4 points, 4 without a result" in (tmp_path / "page.html").read_text()
