"""A loop of 60 frames per second, as in a game: it moves a disc that the hand feels, and draws the newest state.

    hapticd run                              # in one terminal
    python examples/gui_loop.py              # in another one; --for SECONDS ends it

To draw in a window, replace `picture`, and call `frame` from Tk's `after`, Qt's `QTimer` or the loop of a game.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from typing import Final

import hapticd
from hapticd.base.errors import HapticdError

FRAME_S: Final = 1 / 60
"""Period of a frame."""
RADIUS_M: Final = 0.01
WIDTH: Final = 60
"""Number of characters of the picture, which is 0.12 m wide."""


def disc_at(time_s: float) -> dict[str, object]:
    """Return the disc, which moves along x between -4 cm and 4 cm with a period of 2 s."""
    x_m = 0.04 * math.sin(math.pi * time_s)
    return {"kind": "disc", "center_m": [x_m, 0.0], "radius_m": RADIUS_M, "material": "acrylic"}


def picture(disc_x_m: float, state: hapticd.State) -> str:
    """Draw one line: the disc as O, the hand as *, or as + if it touches nothing."""
    line = ["."] * WIDTH
    for x_m, mark in ((disc_x_m, "O"), (state["position_m"][0], "*" if state["touching"] else "+")):
        column = round((x_m / 0.12 + 0.5) * (WIDTH - 1))
        line[min(max(column, 0), WIDTH - 1)] = mark
    return f"{''.join(line)}  {math.hypot(*state['force_n']):5.2f} N"


def frame(daemon: hapticd.Client, time_s: float) -> str:
    """Move the disc, and draw the newest state.

    The daemon moves the disc smoothly to its new position over the scene's `ramp_s`. No call waits for the servo.
    """
    disc = disc_at(time_s)
    daemon.update_scene({"disc": disc})
    return picture(disc["center_m"][0], daemon.state())  # type: ignore[index]


def main() -> int:
    """Run the loop, and return the exit code."""
    parser = argparse.ArgumentParser(prog="gui_loop", description="Move a disc, and show the hand, 60 times a second.")
    parser.add_argument("--for", dest="seconds", type=float, default=math.inf, help="End after this time in s.")
    seconds = parser.parse_args().seconds
    try:
        with hapticd.connect() as daemon:
            begin = due = time.monotonic()
            while due - begin < seconds:
                print(frame(daemon, due - begin), end="\r", flush=True)
                due = max(due + FRAME_S, time.monotonic())
                time.sleep(max(0.0, due - time.monotonic()))
            daemon.update_scene({"disc": None})
            print()
    except HapticdError as error:
        print(f"gui_loop: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
