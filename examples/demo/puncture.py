"""A puncture: the hand presses slowly on a membrane, which ruptures and rings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from rich.table import Table

from examples.demo import paper
from examples.demo.marks import Marks, residual
from examples.demo.perform import HOVER_M, Floats, Recorded
from examples.demo.strikes import Strikes, strikes_of
from hapticd.config.materials import Material

MATERIAL: Final = "cellophane"
SKIN: Final = {"kind": "membrane", "center_m": [0, 0], "normal": [0, 1], "width_m": 0.02, "material": MATERIAL}
PATH: Final = [[0.2, 0.0, HOVER_M], [0.5, 0.0, 0.005], [1.7, 0.0, -0.03], [1.9, 0.0, -0.03], [2.3, 0.0, HOVER_M]]
"""Waypoints of a hand that presses slowly through the membrane, and returns through the hole."""


MIN_RUPTURES: Final = 1
"""Minimum number of ruptures from which figures are measured."""


@dataclass(frozen=True, slots=True)
class Torn:
    """Measurements of the puncture; arrays have one element per visible rupture."""

    strikes: Strikes
    """All strikes, including those of ruptures that are not completely visible."""
    amplitude: Floats
    """Amplitude in m/s^2."""
    force_before_n: Floats
    force_after_n: Floats
    """Largest force in the tick of the rupture and after it."""
    past_m: Floats
    """Deflection beyond the rupture deflection, in the tick of the rupture."""
    travelled_m: Floats
    """Distance travelled in the tick of the rupture."""
    unreported: int
    """Number of times that the deflection was exceeded without an event, not counting those at missed periods."""

    @property
    def count(self) -> int:
        return len(self.amplitude)


def measured(recorded: Recorded, material: Material) -> Torn:
    """Measure the rupture and its ringing.

    Missed periods hide the rupture just before the tick in which the deflection is exceeded, and shortly after it.
    """
    assert material.rupture is not None
    force = recorded.samples["contact_force_n"][:, 1]
    deflection = -recorded.samples["position_m"][:, 1]
    beyond = np.flatnonzero(deflection > material.rupture.rupture_depth_m)[:1]
    at = np.setdiff1d(beyond, recorded.gaps())
    events = recorded.reported("puncture")
    strikes = strikes_of(recorded, 1, [recorded.onset_s(event) for event in events])
    ticks = recorded.samples["tick"][at]
    seen = [event["tick"] in ticks and event["scale"] == 1.0 for event in (events[n] for n in strikes.number.tolist())]
    reported = np.isin(ticks, [event["tick"] for event in events])
    at = at[: sum(seen)]
    return Torn(
        strikes=strikes,
        amplitude=strikes.amplitude[np.array(seen, dtype=np.bool_)],
        force_before_n=force[at - 1],
        force_after_n=np.array([abs(force[n:]).max() for n in at.tolist()]),
        past_m=deflection[at] - material.rupture.rupture_depth_m,
        travelled_m=deflection[at] - deflection[at - 1],
        unreported=int((~reported).sum()),
    )


def table(torn: Torn, material: Material, marks: Marks) -> Table:
    """Return the table of force at the rupture, deflection beyond the limit, and ringing."""
    rupture, strikes = material.rupture, torn.strikes
    assert rupture is not None
    rows = Table(title=f"Puncture of {MATERIAL}", show_header=False)
    marks.expect(torn.unreported == 0, "the membrane did not break at its depth")
    marks.expect(strikes.left_over == 0, f"puncture: {strikes.left_over} samples ring otherwise")
    marks.expect(bool((torn.force_after_n == 0.0).all()), "the membrane still pushed at the tick of rupture")
    in_time = (torn.past_m > 0) & (torn.past_m <= torn.travelled_m)
    marks.expect(bool(in_time.all()), "the rupture came later than a tick's travel")
    if torn.count < MIN_RUPTURES:
        rows.add_row("ruptures that were seen", f"{torn.count} of {MIN_RUPTURES}")
        return rows
    before, after, past, travelled = (
        float(each[-1]) for each in (torn.force_before_n, torn.force_after_n, torn.past_m, torn.travelled_m)
    )
    rows.add_row("force before the rupture, and from its tick on", f"{before:.3f} N, {after:g} N")
    rows.add_row(
        "beyond the rupture deflection", f"{1e6 * past:.0f} um, of {1e6 * travelled:.0f} um travelled in that tick"
    )
    mode, printed = rupture.mode, paper.PUNCTURE_MODE
    for what, measured, wanted, published, unit in (
        (
            "amplitude",
            float(torn.amplitude[-1]),
            rupture.amplitude_m_per_s2,
            paper.PUNCTURE_AMPLITUDE_M_PER_S2,
            "m/s^2",
        ),
        (
            "angular frequency",
            2 * np.pi * strikes.frequency_hz,
            mode.angular_frequency_rad_per_s,
            printed.angular_frequency_rad_per_s,
            "rad/s",
        ),
        ("decay rate", 1 / strikes.decay_time_s, mode.decay_rate_per_s, printed.decay_rate_per_s, "1/s"),
    ):
        difference = marks.off(f"puncture: {what}", measured, wanted, 0.01)
        rows.add_row(
            what,
            f"{measured:.2f} {unit} (library {wanted:g}: {difference}; paper {published:g}: "
            f"{residual(measured, published)})",
        )
    return rows
