"""The content of a wheel: its extras, as messages and pages name them, and its man pages."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import click
import pytest

from hapticd import __version__
from hapticd._share import write
from hapticd.base.errors import HapticdError
from hapticd.cli.machine import SCRIPT_PATH_BY_SHELL, script
from tests.support.cli import contexts, page_names
from tests.support.special_files import KINDS, special, untouched

ROOT = Path(__file__).parents[2]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
EXTRAS = PYPROJECT["project"]["optional-dependencies"]


def test_messages_and_pages_name_extras_that_exist() -> None:
    extras = {
        (extra, path.name)
        for folder, pattern in (("hapticd", "*.py"), ("docs", "*.md"))
        for path in (ROOT / folder).rglob(pattern)
        for names in re.findall(r"(?:hapticd\[|install_command\(['\"])([a-z,]+)['\"\]]", path.read_text())
        for extra in names.split(",")
    }
    assert {extra for extra, _ in extras} == {"cluster", "experiment", "fit", "lsl", "mcap", "pandas", "web"}
    assert {"experiment", "fit", "lsl", "mcap", "web"} < EXTRAS.keys()


def test_the_extra_for_fits_keeps_its_first_name() -> None:
    assert sorted(re.match(r"[a-z]+", each)[0] for each in EXTRAS["fit"]) == ["matplotlib", "pandas", "scipy"]  # type: ignore[index]
    assert EXTRAS["plots"] == ["hapticd[fit]"]


# ---- Man pages and completion ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def share(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the man pages and completion scripts."""
    folder = tmp_path_factory.mktemp("made")
    names = write(folder)
    assert {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()} == set(names)
    return folder / "share"


def page(share: Path, name: str) -> str:
    return (share / "man" / "man1" / f"{name}.1").read_text()


def test_every_command_has_a_page_with_its_help(share: Path) -> None:
    assert page_names() == {path.stem for path in (share / "man" / "man1").iterdir()}
    for ctx in (ctx for ctx in contexts() if not ctx.command.hidden):
        shown = page(share, ctx.command_path.replace(" ", "-")).replace(r"\-", "-")
        for option in (each for each in ctx.command.params if isinstance(each, click.Option)):
            assert all(spelling in shown for spelling in option.opts), (ctx.command_path, option.opts)
            assert option.help is None or option.help.split()[0] in shown


@pytest.mark.skipif(shutil.which("groff") is None, reason="no groff is installed")
def test_roff_accepts_the_pages_without_warnings(share: Path) -> None:
    files = sorted((share / "man" / "man1").iterdir())
    done = subprocess.run(["groff", "-man", "-ww", "-Kutf8", "-Tutf8", *files], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    text = re.sub(r"\x1b\[\d*m|.\x08", "", done.stdout)
    assert re.search(r"\n +hapticd play --mode frequency_hz=200,decay_time_s=0.01 --amplitude 20\n", text)


def test_files_for_share_depend_only_on_the_commands(share: Path, tmp_path: Path) -> None:
    """They depend neither on place, time or environment, nor on packages other than click, which a build may lack."""
    program = """if True:
        import sys
        from pathlib import Path

        class Nothing:
            def find_spec(self, name, path=None, target=None):
                top = name.partition(".")[0]
                if top in sys.stdlib_module_names or top in ("click", "click_man", "hapticd", "typing_extensions"):
                    return None
                raise ModuleNotFoundError(f"no {name} where wheels are built")

        sys.meta_path.insert(0, Nothing())
        from hapticd._share import write
        print(*write(Path(sys.argv[1])))
    """
    environment = {
        "PATH": os.environ["PATH"],
        "HOME": "/elsewhere",
        "COLUMNS": "40",
        "HAPTICD_RUNTIME_DIR": "/x",
        "TZ": "Asia/Tokyo",
        "LC_ALL": "C",
    }
    done = subprocess.run(
        [sys.executable, "-c", program, tmp_path], cwd=ROOT, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    for name in done.stdout.split():
        assert (tmp_path / name).read_text() == (share.parent / name).read_text(), name
    assert all((tmp_path / place).read_text() == script(shell) for shell, place in SCRIPT_PATH_BY_SHELL.items())


def test_the_day_of_a_page_is_that_of_the_sources(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1789000000")
    write(tmp_path)
    assert page(tmp_path / "share", "hapticd-run").startswith(f'.TH "HAPTICD RUN" "1" "2026-09-10" "{__version__}"')


@pytest.mark.parametrize("kind", KINDS)
def test_files_for_share_replace_only_regular_files(kind: str, tmp_path: Path) -> None:
    place = tmp_path / "share" / "man" / "man1" / "hapticd.1"
    place.parent.mkdir(parents=True)
    problem = special(place, kind)
    with untouched(tmp_path), pytest.raises(HapticdError) as caught:
        write(tmp_path)
    assert str(caught.value) == problem
