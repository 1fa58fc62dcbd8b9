"""The two pages of a session in the browser, the options of these pages, and the daemon of a session."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

import click

from hapticd.base.errors import HapticdError
from hapticd.cli.listening import Listening, listening_options, refuse_another_daemon
from hapticd.system.extras import install_command

if TYPE_CHECKING:
    from hapticd.config.configuration import Config
    from hapticd.experiment.daemon_stage import DaemonStage
    from hapticd.experiment.pages.pages_front import PagesFront
    from hapticd.experiment.plan import Plan
    from hapticd.experiment.stage import Stage
    from hapticd.system.paths import RuntimePaths

PARTICIPANT_PAGE_PORT = 8766
"""Default port of the participant's page. The default of `hapticd web` is 8765."""

pages_options = listening_options(
    "both pages",
    PARTICIPANT_PAGE_PORT,
    "Port of the participant's page; the experimenter's page gets the next one. 0 chooses free ports.",
    last_port=65534,
)


@contextmanager
def place_of_session(ctx: click.Context, demo: bool) -> Iterator[RuntimePaths]:
    """Yield the paths of the session's daemon: with `demo` a separate one that runs while the context is active."""
    if not demo:
        from hapticd.protocol.places import place_of

        yield place_of(ctx.find_root().obj)
        return
    refuse_another_daemon(ctx)
    from hapticd.web.demo import DemoDaemon

    with DemoDaemon() as daemon:
        yield daemon.place


def rig_at(place: RuntimePaths) -> Config:
    """Return the configuration of the daemon with the paths `place`."""
    from hapticd.client.blocking import Client
    from hapticd.config.configuration import load_config

    with Client(place.directory) as client:
        return load_config(client.get_config()["config"])


@contextmanager
def live_stage(place: RuntimePaths, lsl: bool) -> Iterator[DaemonStage]:
    """Yield a stage that renders trials on the daemon at `place`; with `lsl` it streams to Lab Streaming Layer."""
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
    plan: Plan,
    lsl: bool,
    session: Callable[[Stage, PagesFront], int],
) -> int:
    """Serve the pages of participant and experimenter while `session` runs; return the session's exit code.

    `place` has the daemon's paths; `simulated` says whether the daemon has the simulated joystick.
    """
    if importlib.util.find_spec("aiohttp") is None:
        raise HapticdError(f"the pages of a session need aiohttp: {install_command('experiment,web')}")
    from hapticd.experiment.pages.pages_front import PagesFront
    from hapticd.experiment.pages.process import News, Options, run

    news = News()
    front = PagesFront(plan, news)

    def on_stage() -> int:
        with live_stage(place, lsl) as stage:
            return session(stage, front)

    return run(Options(place=place, simulated=simulated, **listening), front, news, on_stage)
