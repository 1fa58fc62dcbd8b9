"""A puncture: the hand presses slowly through a membrane, which breaks and rings."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from rich.table import Table

from examples.demo.marks import Marks
from examples.demo.perform import HOVER_M, Recorded, Unseen
from examples.demo.strikes import Strikes, strikes_of
from hapticd.config.materials import Material

MATERIAL: Final = "cellophane"
SKIN: Final = {"kind": "membrane", "center_m": [0, 0], "normal": [0, 1], "width_m": 0.02, "material": MATERIAL}
PATH: Final = [
    [0.2, 0.0, HOVER_M],
    [0.5, 0.0, 0.005],
    [1.7, 0.0, -0.03],
    [1.9, 0.0, -0.03],
    [2.3, 0.0, HOVER_M],
]
"""Waypoints of a hand that presses through the membrane slowly, and comes back through the hole for a second try."""


def measured(recorded: Recorded) -> Strikes:
    """The ringing of the rupture. Raises Unseen where missed periods hide it: just before its tick, its strike, or the
    whole way down, so that it broke on the way back."""
    if not recorded.told("puncture") and len(recorded.gaps()):
        raise Unseen("the membrane was passed while periods were missed")
    (event,) = recorded.told("puncture")
    at = tick_of(recorded, event)
    if at in recorded.gaps() or recorded.samples["velocity_m_per_s"][at - 1, 1] > 0:
        raise Unseen("the membrane broke while periods were missed")
    return strikes_of(recorded, 1, [recorded.onset_s(event)])


def tick_of(recorded: Recorded, event: dict[str, Any]) -> int:
    """The sample of an event's tick."""
    return int(np.searchsorted(recorded.time_s, (event["time_ns"] - recorded.start_ns) / 1e9 - 1e-9))


def table(recorded: Recorded, torn: Strikes, material: Material, marks: Marks) -> Table:
    """The membrane's force at the tick of rupture, how far past its limit it came, and the ringing."""
    rupture = material.rupture
    assert rupture is not None
    (event,) = recorded.told("puncture")
    at = tick_of(recorded, event)
    force = recorded.samples["contact_force_n"][:, 1]
    deflection = -recorded.samples["position_m"][:, 1]
    before, after = float(force[at - 1]), float(abs(force[at:]).max())
    past, travel = float(deflection[at] - rupture.rupture_depth_m), float(deflection[at] - deflection[at - 1])
    marks.expect(after == 0.0, "the membrane still pushed at the tick of rupture")
    marks.expect(0 < past <= travel, "the rupture came later than a tick's travel")

    rows = Table(title=f"Puncture of {MATERIAL}", show_header=False)
    rows.add_row("force before, and from the tick of rupture on", f"{before:.3f} N, {after:g} N")
    rows.add_row("past the rupture deflection", f"{1e6 * past:.0f} um, of {1e6 * travel:.0f} um travelled in that tick")
    marks.expect(torn.left_over == 0, f"puncture: {torn.left_over} samples ring otherwise")
    for what, measured, wanted, unit in (
        ("amplitude", float(torn.amplitude[0]), rupture.amplitude_m_per_s2, "m/s^2"),
        ("angular frequency", 2 * np.pi * torn.frequency_hz, rupture.mode.angular_frequency_rad_per_s, "rad/s"),
        ("decay rate", 1 / torn.decay_time_s, rupture.mode.decay_rate_per_s, "1/s"),
    ):
        difference = marks.off(f"puncture: {what}", measured, wanted, 0.01)
        rows.add_row(what, f"{measured:.2f} {unit} (library {wanted:g}: {difference})")
    return rows
