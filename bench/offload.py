"""How well a device's own periodic effect would play a tap: `python -m bench.offload`, figures of docs/adr.

The effect is the one that `device.hid.offload: auto` would use (hapticd/hid/offload.py), on devices whose times differ
in their resolution.
"""

from __future__ import annotations

from bench.report import Table
from hapticd.config.materials import shipped_materials
from hapticd.hid.nearest_effect import nearest_effect
from hapticd.hid.plan import Bits, Numbers, Scale

RESOLUTIONS_S = (1e-3, 1e-4, 1e-5)
FULL_N = 8.9


def numbers_of(resolution_s: float) -> Numbers:
    """A device whose times are 16 bits of this resolution, and whose levels are those of most: 0 to 10000."""
    times = Scale(Bits(0, 16, False), 1.0 / resolution_s, 0.0, 0, 32767)
    levels = Scale(Bits(0, 16, False), 10000 / FULL_N, 0.0, 0, 10000)
    return Numbers(times, times, times, times, levels, levels, levels)


def table() -> Table:
    """Each material that is struck, at each resolution."""
    rows = []
    for name, material in shipped_materials().items():
        if material.tap is None and material.rupture is None:
            continue
        mode = material.tap.mode if material.tap is not None else material.rupture.mode  # type: ignore[union-attr]
        cells = []
        for resolution_s in RESOLUTIONS_S:
            nearest = nearest_effect(mode, numbers_of(resolution_s))
            cells.append("none" if nearest is None else f"{nearest.frequency_hz:.0f} Hz, {100 * nearest.error:.0f} %")
        rows.append([name, f"{mode.frequency_hz:.0f}", f"{1e3 * mode.decay_time_s:.2f}", *cells])
    heads = [f"{1e3 * resolution_s:g} ms" for resolution_s in RESOLUTIONS_S]
    return Table("The nearest periodic effect and its error", ["material", "Hz", "decay, ms", *heads], rows)


if __name__ == "__main__":
    print(table().markdown())
