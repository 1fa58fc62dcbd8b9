"""`hapticd completion`: the script by which a shell completes hapticd's commands, options, files and names."""

from __future__ import annotations

import re
from typing import Final

import click
from click.shell_completion import ShellComplete, get_completion_class

SHELLS: Final = {
    "bash": "share/bash-completion/completions/hapticd",
    "zsh": "share/zsh/site-functions/_hapticd",
    "fish": "share/fish/vendor_completions.d/hapticd.fish",
}
"""The shells, and where below a prefix each looks for the scripts of packages."""

# Where click's scripts ask hapticd: the end of that command, before the bracket that ends the substitution.
_QUESTION: Final = re.compile(r"(_complete \$1|_complete hapticd|\(commandline -t\) hapticd)(?=\))")


def script(shell: str) -> str:
    """click's script for a shell, with three things mended: what goes wrong while a key is pressed is kept from the
    terminal, fish shows help texts beyond their first comma, and zsh, where it loads the script from its fpath, does
    not lose the second key."""
    from hapticd.cli import cli

    kind = get_completion_class(shell)
    assert kind is not None
    # The class's own source() asks the bash that is installed for its version; the text is the same for all.
    source = ShellComplete.source(kind(cli, {}, "hapticd", "_HAPTICD_COMPLETE"))
    source = _QUESTION.sub(r"\1 2>/dev/null", source)
    source = source.replace("$zsh_eval_context[-1] == loadautofunc", "$funcstack[1] == _hapticd")
    return source.replace('string split ","', 'string split -m 1 ","')


@click.command("completion", short_help="Print the completion script of a shell.")
@click.argument("shell", type=click.Choice(list(SHELLS)))
def completion_command(shell: str) -> None:
    """Print the script by which SHELL completes commands, options, files, scenes, materials and objects.

    For the terminal that is open:

    \b
    eval "$(hapticd completion bash)"
    eval "$(hapticd completion zsh)"           # after compinit
    hapticd completion fish | source

    For every new one, the same line in ~/.bashrc or ~/.zshrc; for fish:

    \b
    hapticd completion fish > ~/.config/fish/completions/hapticd.fish

    An installation into /usr or /usr/local brings the scripts with it, where the shells look for them.
    """
    click.echo(script(shell), nl=False)
