"""A session in the browser: the options of `hapticd experiment run` and `resume` for its two pages."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

import click

from hapticd.base.errors import HapticdError
from hapticd.cli.listening import Listening, listening_options, refuse_another_daemon

if TYPE_CHECKING:
    from hapticd.config.configuration import Config
    from hapticd.experiment.daemon_stage import DaemonStage
    from hapticd.experiment.pages.pages_front import PagesFront
    from hapticd.experiment.plan import Plan
    from hapticd.experiment.stage import Stage
    from hapticd.system.paths import RuntimePaths

PORT = 8766

pages_options = listening_options(
    "both pages",
    PORT,
    "The port of the participant's page; the experimenter's is the next one. 0 takes free ones.",
    last_port=65534,
)
demo_option = click.option(
    "--demo", is_flag=True, help="Start a daemon with the simulated joystick, and end it afterwards."
)


@contextmanager
def place_of_session(ctx: click.Context, demo: bool) -> Iterator[RuntimePaths]:
    """Where the daemon of a session is; with `demo` one of its own, as long as the context lasts."""
    if not demo:
        from hapticd.protocol.places import place_of

        yield place_of(ctx.find_root().obj)
        return
    refuse_another_daemon(ctx)
    from hapticd.web.demo import DemoDaemon

    with DemoDaemon() as daemon:
        yield daemon.place


def rig_at(place: RuntimePaths) -> Config:
    """Servo and device of the daemon at `place`."""
    from hapticd.client.blocking import Client
    from hapticd.config.configuration import load_config

    with Client(place.directory) as client:
        return load_config(client.get_config()["config"])


@contextmanager
def live_stage(place: RuntimePaths, lsl: bool) -> Iterator[DaemonStage]:
    """The daemon at `place` as a stage; with `lsl` what happens goes to Lab Streaming Layer, too."""
    from hapticd.client.blocking import Client
    from hapticd.experiment.daemon_stage import DaemonStage

    with ExitStack() as stack:
        client = stack.enter_context(Client(place.directory))
        if lsl:
            from hapticd.experiment.lsl import streaming

            stack.enter_context(streaming(client))
        yield stack.enter_context(DaemonStage(client))


def run_on_pages(
    place: RuntimePaths,
    simulated: bool,
    listening: Listening,
    made: Plan,
    lsl: bool,
    session: Callable[[Stage, PagesFront], int],
) -> int:
    """Shows both pages while `session` runs on the daemon at `place`; returns what it returns. `simulated`: that daemon
    has the simulated joystick."""
    if importlib.util.find_spec("aiohttp") is None:
        raise HapticdError("the pages of a session need aiohttp: pip install 'hapticd[experiment,web]'")
    from hapticd.experiment.pages.pages_front import PagesFront
    from hapticd.experiment.pages.process import News, Options, run

    news = News()
    front = PagesFront(made, news)

    def on_stage() -> int:
        with live_stage(place, lsl) as stage:
            return session(stage, front)

    return run(Options(place=place, simulated=simulated, **listening), front, news, on_stage)
