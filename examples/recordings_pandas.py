"""A table of the contacts of a recording, with pandas: speed, duration, largest force and largest vibration of each.

    hapticd simulate materials -o taps.npz             # or: hapticd record taps.npz
    python examples/recordings_pandas.py taps.npz

It needs pandas: pip install 'hapticd[pandas]'.
"""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

import numpy as np

import hapticd
from hapticd.base.errors import HapticdError

if TYPE_CHECKING:
    import pandas


def contacts(recording: hapticd.Recording) -> pandas.DataFrame:
    """Return a row for each contact that ended within the recording.

    Columns: object, start_s and duration_s, speed_m_per_s along the normal, largest_force_n, largest_vibration_n.
    """
    import pandas

    frame = recording.to_pandas()
    force_n = np.hypot(frame["force_n_x"], frame["force_n_y"]).to_numpy()
    vibration_n = np.hypot(frame["vibration_force_n_x"], frame["vibration_force_n_y"]).to_numpy()
    ticks = recording.samples["tick"].astype(np.int64)
    begun: dict[str, hapticd.Event] = {}
    rows = []
    for event in recording.events:
        if event["event"] == "contact":
            begun[event["object"]] = event
        elif event["event"] == "release" and event["object"] in begun:
            contact = begun.pop(event["object"])
            first, last = np.searchsorted(ticks, [contact["tick"], event["tick"]])
            rows.append(
                {
                    "object": event["object"],
                    "start_s": frame.index[first],
                    "duration_s": (event["time_ns"] - contact["time_ns"]) / 1e9,
                    "speed_m_per_s": contact["speed_m_per_s"],
                    "largest_force_n": force_n[first:last].max(),
                    "largest_vibration_n": vibration_n[first:last].max(),
                }
            )
    return pandas.DataFrame(rows)


def main() -> int:
    """Print the table, and return the exit code."""
    parser = argparse.ArgumentParser(prog="recordings_pandas", description="Contacts of a recording as a table.")
    parser.add_argument("path", help="A recording (.npz).")
    given = parser.parse_args()
    try:
        found = contacts(hapticd.load(given.path))
    except HapticdError as error:
        print(f"recordings_pandas: {error}", file=sys.stderr)
        return 1
    print(found.to_string(index=False, float_format=lambda number: f"{number:.4g}"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
