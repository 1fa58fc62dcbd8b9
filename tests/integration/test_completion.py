"""Completion in the shells themselves: a key is pressed in bash and zsh, fish is asked what it would offer."""

from __future__ import annotations

import os
import pty
import select
import shutil
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import click
import pytest
from click.shell_completion import BashComplete

from hapticd.cli import cli, main, names
from hapticd.cli.machine import SCRIPT_PATH_BY_SHELL, script
from tests.support.daemon_process import PATIENCE_S, running_daemon
from tests.support.marks import rest_slow

PROMPT = "ready> "
# What is typed before the key is pressed, and the arguments of the command that results.
TYPED = {
    "hapticd recor": ["record"],
    "hapticd rep": ["replay"],
    "hapticd material li": ["material", "list"],
    "hapticd record --fo": ["record", "--for"],
    "hapticd completion zs": ["completion", "zsh"],
    "hapticd force of": ["force", "off"],
    "hapticd replay ta": ["replay", "tap 1.npz"],
    "hapticd run -c below/qu": ["run", "-c", "below/quiet.yaml"],
    "hapticd simulate com": ["simulate", "comb"],
    "hapticd simulate camer": ["simulate", "camera.yaml"],
    "hapticd simulate ta": ["simulate", "tap 1.npz"],
    "hapticd play cello": ["play", "cellophane"],
    "hapticd fit tap a.csv --rep": ["fit", "tap", "a.csv", "--report"],
    "hapticd --runtime-dir bel": ["--runtime-dir", "below"],
}
# Nothing is offered, and nothing is said.
IN_VAIN = ["hapticd force up", "hapticd reset flo", "hapticd record --nothing"]
Start = Callable[[Path], "list[str]"]


def start_bash(folder: Path) -> list[str]:
    (folder / "rc").write_text(
        f"source ./script; PS1='{PROMPT}'; bind 'set enable-bracketed-paste off'\n"
        "hapticd() { printf '<%s>' \"$@\"; echo; }\n"
    )
    return ["bash", "--noprofile", "--rcfile", "rc", "-i"]


def start_zsh(folder: Path) -> list[str]:
    (folder / ".zshrc").write_text(
        f"autoload -U compinit; compinit -u -D; source ./script; PS1='{PROMPT}'; unsetopt prompt_sp\n"
        "hapticd() { printf '<%s>' \"$@\"; echo; }\n"
    )
    return ["zsh", "-d", "-i"]


def start_zsh_as_installed(folder: Path) -> list[str]:
    """The script lies where a package puts it, and is loaded when the key is pressed first."""
    (folder / "below" / "_hapticd").write_text(script("zsh"))
    command = start_zsh(folder)
    text = (folder / ".zshrc").read_text().replace("source ./script; ", "")
    (folder / ".zshrc").write_text(f"fpath=({folder}/below $fpath)\n{text}")
    return command


STARTS: dict[str, Start] = {"bash": start_bash, "zsh": start_zsh, "zsh as installed": start_zsh_as_installed}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Files to be named, and a shell's home; no daemon is there."""
    (tmp_path / "below").mkdir()
    for name in ("tap 1.npz", "camera.yaml", "below/quiet.yaml"):
        (tmp_path / name).touch()
    for name in ("HAPTICD_RUNTIME_DIR", "RUNTIME_DIRECTORY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    for name in ("HOME", "ZDOTDIR", "XDG_CONFIG_HOME", "XDG_DATA_HOME"):
        monkeypatch.setenv(name, str(tmp_path))
    monkeypatch.setenv("TERM", "dumb")
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    monkeypatch.chdir(tmp_path)
    return tmp_path


class Terminal:
    """A shell that believes somebody types."""

    def __init__(self, command: list[str]) -> None:
        self._master, slave = pty.openpty()
        self._process = subprocess.Popen(command, stdin=slave, stdout=slave, stderr=slave, start_new_session=True)
        os.close(slave)
        self._shown = ""
        self.until(PROMPT)

    def type(self, text: str) -> None:
        os.write(self._master, text.encode())

    def until(self, wanted: str) -> str:
        """What is shown up to and with `wanted`. The bound only keeps a broken test from hanging."""
        while wanted not in self._shown:
            assert select.select([self._master], [], [], PATIENCE_S)[0], f"nothing more was shown: {self._shown!r}"
            try:
                self._shown += os.read(self._master, 4096).decode()
            except OSError:
                raise AssertionError(f"the shell ended: {self._shown!r}") from None
        before, _, self._shown = self._shown.partition(wanted)
        return before + wanted

    def close(self) -> None:
        self._process.kill()
        self._process.wait()
        os.close(self._master)


@pytest.fixture(params=rest_slow(["bash", "zsh", "zsh as installed"]))
def terminal(request: pytest.FixtureRequest, folder: Path) -> Iterator[Terminal]:
    shell = request.param.split()[0]
    if shutil.which(shell) is None:
        pytest.skip(f"no {shell} is installed")
    (folder / "script").write_text(script(shell))
    terminal = Terminal(STARTS[request.param](folder))
    yield terminal
    terminal.close()


@pytest.mark.long
def test_a_key_completes(terminal: Terminal) -> None:
    """The command that stands there after the key is a function that shows its arguments; the completion asks the
    program of that name."""
    for line, wanted in TYPED.items():
        terminal.type(f"{line}\t\r")
        shown = terminal.until(">\r\n")
        # zsh takes a folder's slash away where nothing follows it.
        assert "".join(f"<{word}>" for word in wanted) + "\r\n" in shown.replace("/>\r", ">\r"), line
        terminal.until(PROMPT)


@pytest.mark.long
def test_a_key_in_vain_says_nothing(terminal: Terminal) -> None:
    for line in IN_VAIN:
        terminal.type(f"{line}\t\t#\r")  # the sign keeps the line as it was where nothing was added
        shown = terminal.until(">\r\n")
        words = line.removeprefix("hapticd ").split()
        assert "hapticd:" not in shown and "Traceback" not in shown, shown
        assert f"<{words[0]}>" in shown
        terminal.until(PROMPT)


def fish(line: str) -> list[str]:
    done = subprocess.run(
        ["fish", "--no-config", "-c", f"source ./script; complete -C '{line}'"],
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
    )
    assert done.returncode == 0 and done.stderr == "", done.stderr
    return done.stdout.splitlines()


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("fish") is None, reason="no fish is installed")
def test_fish_offers_the_same(folder: Path) -> None:
    (folder / "script").write_text(script("fish"))
    for line, words in TYPED.items():
        offered = [each.split("\t")[0] for each in fish(line)]
        assert words[-1] in [each.replace("\\ ", " ").rstrip("/") for each in offered], (line, offered)
    for line in IN_VAIN:
        assert fish(line) == [], line
    assert any("\t" in each and "," in each.split("\t")[1] for each in fish("hapticd devi"))


@pytest.mark.parametrize("shell", SCRIPT_PATH_BY_SHELL)
def test_a_script_outlives_its_program(shell: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a terminal whose virtual environment was left or removed."""
    if shutil.which(shell) is None:
        pytest.skip(f"no {shell} is installed")
    (folder / "script").write_text(script(shell))
    # An activated environment is in PATH a second time.
    without = [each for each in os.get_exec_path() if shutil.which("hapticd", path=each) is None]
    monkeypatch.setenv("PATH", os.pathsep.join(without))
    assert shutil.which("hapticd") is None
    if shell == "fish":
        assert fish("hapticd rec") == []
    else:
        terminal = Terminal(STARTS[shell](folder))
        terminal.type("hapticd rec\t\r")
        shown = terminal.until(">\r\n")
        assert "<rec>" in shown and "No such file" not in shown and "not found" not in shown, shown
        terminal.close()


@pytest.mark.parametrize("shell", SCRIPT_PATH_BY_SHELL)
def test_the_command_prints_the_script(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", shell]) == 0
    printed = capsys.readouterr()
    assert printed.out == script(shell) and printed.err == ""
    assert printed.out.count("2>/dev/null") == 1


# ---- What is offered -------------------------------------------------------------------------------------------------


def commands(command: click.Command, ctx: click.Context) -> Iterator[tuple[str, click.Command]]:
    yield ctx.command_path, command
    if isinstance(command, click.Group):
        for name in command.list_commands(ctx):
            found = command.get_command(ctx, name)
            assert found is not None
            yield from commands(found, click.Context(found, info_name=name, parent=ctx))


def test_every_file_and_folder_is_completed() -> None:
    # Click keeps what a context makes of --help, so each has the settings of the root.
    for path, command in commands(cli, click.Context(cli, info_name="hapticd", **cli.context_settings)):
        ctx = click.Context(command, info_name=path, **cli.context_settings)
        for parameter in command.params:
            shown = parameter.make_metavar(ctx)
            if "FILE" in shown or "DIR" in shown:
                (item,) = parameter.shell_complete(ctx, "zzz")
                assert item.type in ("file", "dir"), f"{path}: {shown} is not completed: give it type=click.Path()"


def offered(*words: str) -> list[str]:
    found = BashComplete(cli, {}, "hapticd", "_HAPTICD_COMPLETE").get_completions(list(words), "")
    return [item.value for item in found]


@pytest.mark.long
def test_names_of_a_daemon(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(names, "_COMPLETION_TIMEOUT_S", 60.0)
    config = tmp_path / "config.yaml"
    config.write_text(
        "servo: {rate_hz: 1000, realtime: off}\n"
        "materials: {pine: {stiffness_n_per_m: 700}}\n"
        "scene: {objects: {shelf: {kind: wall, point_m: [0, 0], normal: [0, 1], material: pine}}}\n"
    )
    with running_daemon("-c", str(config)) as daemon:
        place = ("--runtime-dir", str(daemon.directory))
        assert offered(*place, "reset") == ["shelf"]
        assert {"pine", "wood"} < set(offered(*place, "play"))


def test_a_daemon_that_does_not_answer_holds_nobody_up(tmp_path: Path) -> None:
    """Its socket is there, as after a kill: a bounded wait, and the shipped names."""
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(tmp_path / "hapticd.command"))
    assert offered("--runtime-dir", str(tmp_path), "reset") == []
    assert "wood" in offered("--runtime-dir", str(tmp_path), "play")
