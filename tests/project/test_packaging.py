"""What a wheel is made of: its extras, as messages and pages name them, and its man pages."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from hapticd import __version__
from hapticd._share import man_pages, write
from hapticd.base.errors import HapticdError
from hapticd.cli import cli
from hapticd.cli.completion import SHELLS, script
from tests.support.special_files import KINDS, special, untouched

ROOT = Path(__file__).parents[2]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
EXTRAS = PYPROJECT["project"]["optional-dependencies"]


def test_messages_and_pages_name_extras_that_exist() -> None:
    told = {
        (extra, path.name)
        for folder, pattern in (("hapticd", "*.py"), ("docs", "*.md"))
        for path in (ROOT / folder).rglob(pattern)
        for names in re.findall(r"hapticd\[([a-z,]+)\]", path.read_text())
        for extra in names.split(",")
    }
    assert {extra for extra, _ in told} == {"cluster", "experiment", "fit", "lsl", "mcap", "pandas", "web"}
    assert {"experiment", "fit", "lsl", "mcap", "web"} < EXTRAS.keys()


def test_the_extra_for_fits_keeps_its_first_name() -> None:
    assert sorted(re.match(r"[a-z]+", each)[0] for each in EXTRAS["fit"]) == ["matplotlib", "scipy"]  # type: ignore[index]
    assert EXTRAS["plots"] == ["hapticd[fit]"]


# ---- Man pages -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def pages() -> dict[str, str]:
    return man_pages()


def test_every_command_has_a_page_with_its_help(pages: dict[str, str]) -> None:
    root = click.Context(cli, info_name="hapticd", **cli.context_settings)
    found = dict(contexts(root))
    assert pages.keys() == found.keys()
    for name, ctx in found.items():
        shown = pages[name].replace(r"\-", "-").replace(r"\(aq", "'").replace(r"\(rs", "\\")
        assert shown.startswith(f'.TH "{name.upper()}" "1" ')
        for option in (each for each in ctx.command.get_params(ctx) if isinstance(each, click.Option)):
            assert all(spelling in shown for spelling in option.opts), (name, option.opts)
            assert option.help is None or option.help.split()[0] in shown
    assert r"\fBhapticd\-devices\-dump\fP(1)" in pages["hapticd-devices"]
    assert "HAPTICD_RUNTIME_DIR" in pages["hapticd"] and "130" in pages["hapticd"].partition(".SH EXIT STATUS")[2]


def contexts(ctx: click.Context) -> Iterator[tuple[str, click.Context]]:
    yield ctx.command_path.replace(" ", "-"), ctx
    if isinstance(ctx.command, click.Group):
        for name in ctx.command.list_commands(ctx):
            command = ctx.command.get_command(ctx, name)
            assert command is not None
            yield from contexts(click.Context(command, info_name=name, parent=ctx))


@pytest.mark.skipif(shutil.which("groff") is None, reason="no groff is installed")
def test_roff_has_nothing_to_say_about_the_pages(pages: dict[str, str], tmp_path: Path) -> None:
    for name, page in pages.items():
        (tmp_path / f"{name}.1").write_text(page)
    files = sorted(tmp_path.glob("*.1"))
    done = subprocess.run(["groff", "-man", "-ww", "-Kutf8", "-Tutf8", *files], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    text = re.sub(r"\x1b\[\d*m|.\x08", "", done.stdout)
    assert re.search(r"\n {10,}hapticd play --mode frequency_hz=200,decay_time_s=0.01 --amplitude 20\n", text)


def test_what_is_made_for_share_depends_on_the_commands_alone(pages: dict[str, str], tmp_path: Path) -> None:
    """Neither on where and when it is made, nor on what is set there, nor on anything of hapticd's but click: whoever
    builds a wheel has nothing else."""
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
    assert {path: (tmp_path / path).read_text() for path in done.stdout.split()} == (
        {f"share/man/man1/{name}.1": page for name, page in pages.items()}
        | {place: script(shell) for shell, place in SHELLS.items()}
    )


def test_the_day_of_a_page_is_that_of_the_sources(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SOURCE_DATE_EPOCH", raising=False)
    changes = (ROOT / "CHANGELOG.md").read_text()
    released = re.search(rf"^## \[{re.escape(__version__)}\] - (.+)$", changes, re.MULTILINE)
    assert released is not None
    assert man_pages()["hapticd-run"].startswith(f'.TH "HAPTICD-RUN" "1" "{released[1]}" "hapticd {__version__}"')
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1789000000")
    assert man_pages()["hapticd-run"].startswith('.TH "HAPTICD-RUN" "1" "2026-09-10"')


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_made_for_share_is_written_to_files_alone(kind: str, tmp_path: Path) -> None:
    place = tmp_path / "share" / "man" / "man1" / "hapticd.1"
    place.parent.mkdir(parents=True)
    told = special(place, kind)
    with untouched(tmp_path), pytest.raises(HapticdError) as caught:
        write(tmp_path)
    assert str(caught.value) == told
