"""`hapticd fit batch`: materials equal those of `hapticd fit` with any workers, and finished fits are reused."""

from __future__ import annotations

import csv
import json
import re
import shutil
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from hapticd.cli import main
from hapticd.config.configuration import load_config
from hapticd.fit.recording import save
from hapticd.fit.synthesize import Hand, Stylus, grooves, puncture, taps, texture
from hapticd.materials import shipped_materials
from hapticd.sweeps import engine
from hapticd.sweeps.batches.batch import Batch
from hapticd.sweeps.batches.tree import read_tree
from hapticd.sweeps.cluster import client_of
from hapticd.sweeps.store import Store
from tests.sweeps.test_engine import WORKER, connected, scheduler, threads

pytestmark = pytest.mark.slow

SPEEDS = (0.1, 0.15, 0.2, 0.25, 0.3)


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Wood of two kinds, steel, a comb, sandpaper, and taps that cannot be fitted."""
    root, shipped = tmp_path_factory.mktemp("recordings") / "tree", shipped_materials()

    def made(name: str, *several: Any) -> None:
        folder = root / name
        folder.mkdir(parents=True)
        for index, each in enumerate(several):
            save(each, folder / f"{index}.npz")

    def tap(name: str, speeds: tuple[float, ...], seed: int) -> Any:
        found = shipped[name].tap
        assert found is not None
        return taps(found, speeds, Stylus(rate_hz=10_000, noise_rms=0.01, seed=seed))[0]

    def stylus(seed: int) -> Stylus:
        return Stylus(rate_hz=5_000, noise_rms=0.01, seed=seed)

    made("wood/tap", tap("wood", SPEEDS[:3], 1), tap("wood", SPEEDS[2:], 2))
    made(
        "wood/puncture",
        *(puncture(shipped["cellophane"], v, Stylus(rate_hz=10_000, seed=n)) for n, v in enumerate((0.03, 0.05, 0.08))),
    )
    made("steel/tap", tap("steel", SPEEDS, 3))
    made(
        "comb/grooves",
        *(grooves(shipped["comb"], v, 1.0, stylus(n), Hand(duration_s=0.5)) for n, v in enumerate((0.05, 0.1))),
    )
    made(
        "silk",
        *(
            texture(shipped["sandpaper_100"], v, f, stylus(n), Hand(duration_s=2))
            for n, (v, f) in enumerate([(0.05, 0.5), (0.1, 1.5), (0.1, 0.5)])
        ),
    )
    (root / "silk/fit.yaml").write_text("kind: texture\nstiffness_n_per_m: 300\n")
    made("felt/tap", tap("wood", (0.2, 0.2, 0.2), 4))
    return root


@pytest.fixture
def tree(recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the recordings in the current folder."""
    shutil.copytree(recordings, tmp_path / "tree")
    monkeypatch.chdir(tmp_path)
    return Path("tree")


def batch(capsys: pytest.CaptureFixture[str], *words: str, code: int = 1) -> dict[str, Any]:
    assert main(["fit", "batch", *words, "--threads", "--json"]) == code
    printed = capsys.readouterr()
    assert printed.err == ""
    found: dict[str, Any] = json.loads(printed.out)
    return found


def fitted(*words: str) -> None:
    assert main(["fit", *words]) == 0


def test_materials_are_those_of_single_fits(tree: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = batch(capsys, "tree")
    assert (found["fits"], found["computed"], found["failed"]) == (6, 6, 1)
    wood = [str(each) for each in sorted((tree / "wood/tap").iterdir())]
    punctures = [str(each) for each in sorted((tree / "wood/puncture").iterdir())]
    fitted("tap", *wood, "-o", "wood.yaml")
    fitted("puncture", *punctures, "-o", "wood.yaml", "--merge")
    fitted("tap", "tree/steel/tap/0.npz", "-o", "steel.yaml")
    fitted("grooves", "tree/comb/grooves/0.npz", "tree/comb/grooves/1.npz", "-o", "comb.yaml")
    fitted("texture", *(f"tree/silk/{n}.npz" for n in range(3)), "-o", "silk.yaml", "--stiffness", "300")
    for name in ("wood", "steel", "comb", "silk"):
        assert Path(f"tree-fits/materials/{name}.yaml").read_text() == Path(f"{name}.yaml").read_text()
        assert name in load_config(f"tree-fits/materials/{name}.yaml").materials
    ranks = {each["material"]: each for each in found["materials"]}
    assert ranks["felt"]["rank"] == 5 and ranks["felt"]["quality"] == "refused" and ranks["felt"]["file"] is None
    assert "about one speed" in ranks["felt"]["fits"][0]["verdict"]
    assert [fit["kind"] for fit in ranks["wood"]["fits"]] == ["tap", "puncture"]
    # The interval contains the value of the library.
    low, high = ranks["steel"]["fits"][0]["figures"]["frequency_hz"][1:]
    mode = shipped_materials()["steel"].tap.mode  # type: ignore[union-attr]
    assert low < mode.frequency_hz < high
    order = ["good", "fair", "poor", "refused"]
    places = [order.index(each["quality"]) for each in found["materials"]]
    assert places == sorted(places) and sum(found["qualities"].values()) == 5


def test_finished_fits_are_not_computed_again(tree: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first = batch(capsys, "tree")
    stamps = {each: each.stat().st_mtime_ns for each in Path("tree-fits/materials").iterdir()}
    page = Path("tree-fits/report.html").stat().st_mtime_ns
    again = batch(capsys, "tree")
    assert (again["computed"], again["reused"], again["sha256"]) == (0, 6, first["sha256"])
    assert Path("tree-fits/report.html").stat().st_mtime_ns == page
    # A changed stiffness needs no fit, a changed recording needs one.
    (tree / "fit.yaml").write_text("stiffness_n_per_m: 650\n")
    (tree / "steel/tap/0.npz.yaml").write_text(f"speed_m_per_s: {list(SPEEDS)}\n")
    third = batch(capsys, "tree")
    assert (third["computed"], third["reused"]) == (1, 5)
    changed = {each.stem for each, stamp in stamps.items() if each.stat().st_mtime_ns != stamp}
    assert changed == {"comb", "steel"}  # silk sets its stiffness, and that of wood is measured
    assert load_config("tree-fits/materials/comb.yaml").materials["comb"].stiffness_n_per_m == 650
    assert load_config("tree-fits/materials/silk.yaml").materials["silk"].stiffness_n_per_m == 300


def test_a_change_of_the_date_alone_changes_no_file(tree: Path, capsys: pytest.CaptureFixture[str]) -> None:
    batch(capsys, "tree")
    file = Path("tree-fits/materials/comb.yaml")
    older = re.sub(r'date: "[0-9-]+"', 'date: "2001-02-03"', file.read_text())
    file.write_text(older)
    Path("tree-fits/materials/elm.yaml").write_text("materials: {}\n")
    assert main(["fit", "batch", "tree", "--threads"]) == 1
    assert older != "" and file.read_text() == older
    notes = capsys.readouterr().err
    assert "1 file of an earlier batch kept: tree-fits/materials/elm.yaml" in notes


def test_tables_and_page(tree: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tree / "silk/notes.txt").write_text("")
    assert main(["fit", "batch", "tree", "--threads", "-o", "out"]) == 1
    printed = capsys.readouterr()
    assert "hapticd: 1 file left out, not recordings: silk/notes.txt" in printed.err
    assert "5 materials: " in printed.out and "1 refused" in printed.out
    lines = printed.out.splitlines()
    assert lines[0].split() == ["rank", "material", "verdict", "fits", "recordings", "reasons"]
    assert lines[6].split()[:4] == ["5", "felt", "refused", "tap"]
    with open("out/ranking.csv", newline="") as file:
        ranking = list(csv.DictReader(file))
    assert len(ranking) == 6 and ranking[-1]["material"] == "felt" and ranking[-1]["file"] == ""
    assert {each["file"] for each in ranking[:-1]} == {f"materials/{n}.yaml" for n in ("wood", "steel", "comb", "silk")}
    figures = pd.read_csv("out/figures.csv").set_index(["material", "kind", "figure"])
    row = figures.loc[("steel", "tap", "frequency_hz")]
    tap = load_config("out/materials/steel.yaml").materials["steel"].tap
    assert tap is not None
    assert row["unit"] == "Hz" and row["value"] == pytest.approx(tap.mode.frequency_hz, rel=1e-6)
    rows = pd.read_parquet("out/pieces")
    assert sorted(rows["material"]) == ["comb", "felt", "silk", "steel", "wood", "wood"]
    assert rows.set_index("material")["error"]["felt"].startswith("all 3 taps have about one speed")
    text = Path("out/report.html").read_text()
    checked = _Checked()
    checked.feed(text)
    assert checked.open == [] and checked.anchors <= checked.ids
    assert checked.files == {f"materials/{n}.yaml" for n in ("wood", "steel", "comb", "silk")}
    assert main(["sweep", "show", "out"]) == 1
    assert capsys.readouterr().err == ("hapticd: out: holds results of hapticd fit batch; see its report.html\n")
    # One picture for each fit that was not refused, and one over the materials for taps, of which there are two.
    assert text.count("data:image/png;base64,") == 5 + 1


class _Checked(HTMLParser):
    """Checks that tags are closed in order, and collects links."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.anchors: set[str] = set()
        self.files: set[str] = set()
        self.ids: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        href = given.get("href")
        if href is not None:
            (self.anchors if href.startswith("#") else self.files).add(href.removeprefix("#"))
        if given.get("id") is not None:
            self.ids.add(str(given["id"]))
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_without_matplotlib_the_page_has_no_pictures(
    tree: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("comb", "silk", "wood", "felt"):
        shutil.rmtree(tree / name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert main(["fit", "batch", "tree", "--threads"]) == 0
    assert "the page has no figures: a report needs matplotlib" in capsys.readouterr().err
    assert "base64" not in Path("tree-fits/report.html").read_text()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("none",), "none: no such folder"),
        (("tree", "-o", "tree/out"), "tree/out: is inside the tree of recordings; give a folder outside of it"),
        (("tree", "-o", "."), ".: not empty, and not a folder of results; give a new folder"),
    ],
)
def test_an_invalid_folder_is_reported_in_one_line(
    words: tuple[str, ...], message: str, tree: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["fit", "batch", *words, "--threads"]) == 1
    printed = capsys.readouterr()
    assert printed.out == "" and message in printed.err and printed.err.count("\n") == 1


def test_a_recording_that_changes_meanwhile_is_a_row(tree: Path) -> None:
    work = Batch(read_tree("tree"))
    (tree / "steel/tap/0.npz").write_bytes(b"")
    names = [each.material for each in work.tree.sets]
    (row,) = work.piece(np.array([names.index("steel")])).rows()
    assert row["error"] == "steel/tap/0.npz: changed since the batch began, or differs at the worker"
    (tree / "steel/tap/0.npz").unlink()
    (row,) = work.piece(np.array([names.index("steel")])).rows()
    assert str(row["error"]).endswith("steel/tap/0.npz: cannot be read: No such file or directory")


# ---- The same bits -------------------------------------------------------------------------------------------------


def digest(root: Path, folder: Path, opened: Callable[[], AbstractContextManager[Any]]) -> str:
    notes: list[str] = []
    store = Store(folder, notes.append)
    outcome = engine.run(Batch(read_tree(str(root))), store, opened, notes.append, lambda progress: None)
    assert outcome.computed == 6 and notes == []
    return store.digest()


@pytest.mark.slow
def test_processes_threads_and_external_workers_give_the_same_bits(recordings: Path, tmp_path: Path) -> None:
    expected = digest(recordings, tmp_path / "threads", threads)
    assert digest(recordings, tmp_path / "one", lambda: client_of(None, 1, False)) == expected
    assert digest(recordings, tmp_path / "two", lambda: client_of(None, 2, False)) == expected
    with scheduler(WORKER, WORKER) as external:
        assert digest(recordings, tmp_path / "external", lambda: connected(external.address, 2)) == expected


@pytest.mark.slow
def test_an_interrupted_batch_fits_only_what_is_missing(recordings: Path, tmp_path: Path) -> None:
    work, store = Batch(read_tree(str(recordings))), Store(tmp_path, lambda text: None)

    def interrupt(progress: engine.Progress) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        engine.run(work, store, threads, lambda text: None, interrupt)
    kept = store.table().num_rows
    outcome = engine.run(work, store, threads, lambda text: None, lambda progress: None)
    assert 0 < kept < 6 and (outcome.reused, outcome.computed) == (kept, 6 - kept)
