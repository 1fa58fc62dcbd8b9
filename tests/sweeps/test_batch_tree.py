"""Trees of recordings: materials, kinds and options, and each fault in one line."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from hapticd.base.errors import HapticdError, InvalidError
from hapticd.fit.options import FitOptions
from hapticd.materials import shipped_materials
from hapticd.sweeps.batches.batch import Batch
from hapticd.sweeps.batches.output import write_materials, write_tables
from hapticd.sweeps.batches.page import write_page
from hapticd.sweeps.batches.ranking import MaterialResult
from hapticd.sweeps.batches.tree import read_tree
from tests.support.special_files import KINDS, special, untouched


def grown(root: Path, files: dict[str, str]) -> str:
    """Create a tree of these files, and return its path; a name that ends in a slash is a folder."""
    for name, content in files.items():
        path = root / name
        if name.endswith("/"):
            path.mkdir(parents=True, exist_ok=True)
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)
    return str(root)


def test_kinds_are_known_by_folders_and_by_yaml(tmp_path: Path) -> None:
    tree = read_tree(
        grown(
            tmp_path,
            {
                "fit.yaml": "kind: tap\nas: mode\nstiffness_n_per_m: 700\n",
                "oak/1.npz": "a",
                "pine/tap/2.csv": "b",
                "pine/tap/10.csv": "c",
                "pine/tap/2.csv.yaml": "rate_hz: 1000",
                "pine/puncture/1.npz": "d",
                "pine/fit.yaml": "law: power\nstrict: true\n",
                "pine/tap/fit.yaml": "law: table\n",
                "silk/fit.yaml": "kind: texture\nautoregressive: true\n",
                "silk/A.WAV": "e",
                ".git/x": "",
                "silk/notes.txt": "",
            },
        )
    )
    found = {(each.material, each.kind): each for each in tree.sets}
    assert list(found) == [("oak", "tap"), ("pine", "tap"), ("pine", "puncture"), ("silk", "texture")]
    assert found["oak", "tap"].options == FitOptions(form="mode") and not found["oak", "tap"].strict
    pine = found["pine", "tap"]
    assert pine.options == FitOptions(form="mode", law="table") and pine.strict and pine.stiffness_n_per_m == 700
    assert [file.name for file in pine.files] == ["pine/tap/10.csv", "pine/tap/2.csv"]
    assert [bool(file.yaml_sha256) for file in pine.files] == [False, True]
    assert found["silk", "texture"].options == FitOptions(autoregressive=True)
    assert [file.name for file in found["silk", "texture"].files] == ["silk/A.WAV"]
    assert tree.others == ("silk/notes.txt",)


TAP = {"pine/tap/1.npz": "a"}


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ({"x/": ""}, "x: holds no recordings; put them into a folder tap, grooves, texture or puncture, or here"),
        ({".x/": ""}, ": holds no material: each has a folder with folders tap, grooves"),
        ({"pine/tap/": ""}, "pine/tap: holds no recordings (.csv, .npz, .wav)"),
        ({"pine/taps/1.npz": "a"}, 'pine/taps: unknown kind "taps"; did you mean tap?'),
        ({"pine/1.npz": "a"}, "pine: holds recordings without a kind; put them into a folder tap, grooves"),
        ({"1.npz": "a", **TAP}, "1.npz: recording outside of a material's folder"),
        ({"a.b/tap/1.npz": "a"}, "a.b: invalid name of a material: must not hold a dot or a control character"),
        ({"x" * 65 + "/tap/1.npz": "a"}, "invalid name of a material: String should have at most 64 characters"),
        ({"pine/tap/more/1.npz": "a", **TAP}, "pine/tap/more: too deep; recordings must be in pine/tap itself"),
        (
            {"pine/grooves/1.npz": "b", "pine/texture/1.npz": "a"},
            "pine: has grooves and a texture; a material can have",
        ),
        (
            {"pine/1.npz": "b", "pine/fit.yaml": "kind: tap", **TAP},
            "pine/tap: has the same kind as the recordings in pine itself",
        ),
        ({"oak/tap/x.npz": "a", **TAP}, "pine/tap/1.npz: same content as {root}/oak/tap/x.npz; a "),
        # YAML
        ({"pine/fit.yml": "kind: tap", **TAP}, "pine/fit.yml: must be named fit.yaml"),
        (
            {"pine/tap/scene.yaml": "", **TAP},
            "pine/tap/scene.yaml: unexpected YAML file; options of a folder are in fit.yaml",
        ),
        ({"pine/tap/2.npz.yaml": "", **TAP}, "pine/tap/2.npz.yaml: describes 2.npz, which does not exist"),
        ({"pine/tap/1.npz.yml": "", **TAP}, "pine/tap/1.npz.yml: must be named 1.npz.yaml"),
        ({"pine/fit.yaml": "", **TAP}, "pine/fit.yaml:1:1: is empty; known keys: kind, stiffness_n_per_m, strict, as"),
        ({"pine/fit.yaml": "objects: {}", **TAP}, "holds a scene; use: hapticd apply {root}/pine/fit.yaml"),
        ({"fit.yaml": "\nlaws: line", **TAP}, "fit.yaml:2:1: laws: unknown key; did you mean law?"),
        ({"fit.yaml": "as: pulse", **TAP}, "fit.yaml:1:1: as: should be 'auto', 'mode' or 'waveform', is "),
        (
            {"fit.yaml": "stiffness_n_per_m: -1", **TAP},
            "fit.yaml:1:1: stiffness_n_per_m: should be greater than or equal to 0, is -1",
        ),
        ({"pine/fit.yaml": "kind: tap", **TAP}, "pine/fit.yaml:1:1: kind: only for recordings directly in the folder"),
        (
            {"pine/tap/fit.yaml": "kind: texture", **TAP},
            "pine/tap/fit.yaml:1:1: kind: must be tap, the name of the folder",
        ),
        (
            {"pine/fit.yaml": "autoregressive: true", **TAP},
            "pine/fit.yaml:1:1: autoregressive: only for texture; fitted here: tap",
        ),
        (
            {"fit.yaml": "as: waveform", "pine/fit.yaml": "strict: true\nlaw: line", **TAP},
            "pine/fit.yaml:2:1: law: law is only for modes, and as: waveform fits no modes: leave out one",
        ),
        (
            {"fit.yaml": "two_modes: true\nattack: first_peak", **TAP},
            "fit.yaml:1:1: two_modes: two_modes and attack exclude each other: leave out one",
        ),
    ],
)
def test_a_fault_of_a_tree_is_one_line_with_its_place(files: dict[str, str], message: str, tmp_path: Path) -> None:
    root = grown(tmp_path / "tree", files)
    with pytest.raises(InvalidError) as caught:
        read_tree(root)
    (problem,) = caught.value.problems
    assert str(problem).startswith(root) and message.format(root=root) in str(problem)


def test_all_faults_of_a_tree_are_reported_together(tmp_path: Path) -> None:
    with pytest.raises(InvalidError) as caught:
        read_tree(grown(tmp_path, {"a/": "", "b/taps/1.npz": "", "c/fit.yaml": "kind: tops", "c/1.npz": ""}))
    assert len(caught.value.problems) == 3


@pytest.mark.parametrize(("name", "why"), [("none", "no such folder"), ("file", "not a folder")])
def test_a_path_without_a_tree_is_refused(name: str, why: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(HapticdError, match=f"{name}: {why}; a batch needs a folder with a folder for each material"):
        read_tree(str(tmp_path / name))


def test_a_recording_that_is_a_pipe_or_a_broken_link_is_reported(tmp_path: Path) -> None:
    root = grown(tmp_path, TAP)
    os.mkfifo(tmp_path / "pine/tap/2.npz")
    (tmp_path / "pine/tap/3.npz").symlink_to("nowhere")
    with pytest.raises(InvalidError) as caught:
        read_tree(root)
    messages = [str(each) for each in caught.value.problems]
    assert messages == [
        f"{root}/pine/tap/2.npz: not a regular file",
        f"{root}/pine/tap/3.npz: cannot be read: No such file or directory",
    ]


def ids(root: Path) -> set[bytes]:
    return {each.tobytes() for each in Batch(read_tree(str(root))).ids}


def test_the_identity_of_a_fit_is_content_options_and_names_but_not_the_path(tmp_path: Path) -> None:
    files = {"pine/tap/1.npz": "a", "oak/tap/1.npz": "b"}
    one = tmp_path / "one"
    grown(one, files)
    before = ids(one)
    assert len(before) == 2
    assert ids(Path(grown(tmp_path / "two", files))) == before
    # The stiffness is added to the material, and no fit reads it.
    grown(one, {"fit.yaml": "stiffness_n_per_m: 300"})
    assert ids(one) == before
    for change in (
        {"pine/fit.yaml": "law: power"},
        {"pine/fit.yaml": "strict: true"},
        {"pine/tap/1.npz": "c"},
        {"pine/tap/1.npz.yaml": "rate_hz: 1000"},
        {"pine/tap/2.npz": "d"},
    ):
        grown(one, change)
        after = ids(one)
        assert len(after) == 2 and len(after & before) == 1, change
        before = after


@pytest.mark.parametrize("kind", KINDS)
def test_results_are_written_only_to_regular_files(kind: str, tmp_path: Path) -> None:
    wood = MaterialResult("wood", "good", (), shipped_materials()["wood"], ())
    for name, write in (
        ("ranking.csv", lambda: write_tables(tmp_path, [], {})),
        ("report.html", lambda: write_page("", [], {}, tmp_path, False, print)),
        ("materials/wood.yaml", lambda: write_materials(tmp_path, [wood])),
    ):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        message = special(tmp_path / name, kind)
        with untouched(tmp_path), pytest.raises(HapticdError) as caught:
            write()
        assert str(caught.value) == message
