"""Pictures of PsychoPy during a session of `hapticd experiment`, selected by the event codes of the session.

    hapticd run                                            # in one terminal
    python examples/psychopy_stimuli.py                    # in another one, before the session
    hapticd experiment run STUDY.yaml --participant P07 --text

It needs hapticd and PsychoPy (pip install psychopy). Escape closes the window; the session continues without it. To
show other pictures, change `pictures_of`: PsychoPy's images, gratings and films have the method `draw`, too.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, Protocol

import hapticd
from hapticd.base.errors import HapticdError
from hapticd.experiment.event_codes import EventCode, code_of

WAIT_S: Final = 0.004
"""Time to wait for an event in each frame: short, so that `flip` keeps the screen's rate."""
END_CODES: Final = frozenset({EventCode.SESSION_END, EventCode.SESSION_ABORTED})


class Picture(Protocol):
    """A stimulus of PsychoPy."""

    def draw(self) -> object: ...


class Window(Protocol):
    """A window of PsychoPy: `flip` shows what was drawn at the next frame."""

    def flip(self) -> object: ...


class Events(Protocol):
    """The result of `daemon.events()`."""

    def receive(self, timeout_s: float) -> Mapping[str, Any] | None: ...


def follow(
    events: Events,
    window: Window,
    pictures: Mapping[EventCode, Picture | None],
    closed: Callable[[], bool] = lambda: False,
) -> None:
    """Show the picture of each event code until the next code in `pictures`; None is an empty screen.

    Returns at the end of the session, or when `closed` returns True. Raises DaemonNotRunning if the daemon ends.
    """
    shown: Picture | None = None
    while not closed():
        event = events.receive(WAIT_S)
        code = None if event is None else code_of(event)
        if code is not None and code in pictures:
            shown = pictures[code]
        if shown is not None:
            shown.draw()
        window.flip()
        if code in END_CODES:
            return


def pictures_of(visual: Any, window: Any) -> dict[EventCode, Picture | None]:
    """Return the pictures: a cross when a trial is ready, a disc while forces are on. `visual` is psychopy.visual."""
    pause = visual.TextStim(window, text="A break. Rest your hand.", height=0.06)
    return {
        EventCode.TRIAL_ARMED: visual.TextStim(window, text="+", height=0.1),
        EventCode.INTERVAL: visual.Circle(window, radius=0.15, fillColor="white"),
        EventCode.FORCES_OFF: None,
        EventCode.TRIAL_GIVEN_UP: None,
        EventCode.BREAK_BEGIN: pause,
        EventCode.BREAK_END: None,
        EventCode.PAUSE_BEGIN: pause,
        EventCode.PAUSE_END: None,
        EventCode.SESSION_END: None,
        EventCode.SESSION_ABORTED: None,
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Follow one session, and return the exit code."""
    parser = argparse.ArgumentParser(prog="psychopy_stimuli", description="Show pictures at the codes of a session.")
    parser.add_argument("--runtime-dir", help="Folder of the daemon's sockets.")
    parser.add_argument("--full-screen", action="store_true", help="Fill the screen.")
    given = parser.parse_args(arguments)
    try:
        from psychopy import event, visual
    except ImportError:
        print("psychopy_stimuli: needs PsychoPy: pip install psychopy", file=sys.stderr)
        return 1
    try:
        with hapticd.connect(given.runtime_dir) as daemon, daemon.events() as events:
            window = visual.Window(fullscr=given.full_screen, color="black", units="height")
            try:
                follow(events, window, pictures_of(visual, window), lambda: "escape" in event.getKeys(["escape"]))
            finally:
                window.close()
    except HapticdError as error:
        print(f"psychopy_stimuli: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
