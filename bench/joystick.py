"""The simulated joystick's integration beside other ones at the same tick: ns a period against error.

The truth is the closed form of each stretch between events (a waypoint of the hand's reference, a change of the held
force, a turn, rest), in 40 digits; turns and releases are found in them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.peers import Peers, compiled
from bench.plots import Figure, Point, beside, trade
from bench.report import Advance, Floats, Options, Section, Table, alternated, between, spread

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

RATES_HZ = (1000.0, 2000.0, 5000.0, 10_000.0)
LASTING_S = 0.4
OURS, FLOOR = "closed form (hapticd)", "explicit Euler"


@dataclass(frozen=True, slots=True)
class Handle:
    """What is moved; the fields of struct peer_handle."""

    mass_kg: float = 0.1
    damping_n_s_per_m: float = 0.2
    hand_stiffness_n_per_m: float = 300.0
    hand_damping_n_s_per_m: float = 3.0
    friction_n: float = 0.0


HANDLES = {
    "a hand draws it": Handle(),
    "the same with 0.2 N of friction": Handle(friction_n=0.2),
    "light and firm": Handle(mass_kg=0.02, hand_stiffness_n_per_m=1000.0, hand_damping_n_s_per_m=1.0),
}
WAYPOINTS = np.array([[0.0, 0.0], [0.15, 0.015], [0.25, 0.015], [0.35, 0.005]])
PULSE_S, PULSE_N = (0.2, 0.3), -0.8
"""The actuator pushes for a while; its edges lie on ticks of every rate."""


def force(rate_hz: float) -> Floats:
    """Held from tick to tick, [n]."""
    time_s = np.arange(round(LASTING_S * rate_hz)) / rate_hz
    return np.where((time_s > PULSE_S[0] - 1e-9) & (time_s < PULSE_S[1] - 1e-9), PULSE_N, 0.0)


class Closed:
    """The motion from 0 on, asked for at rising times."""

    def __init__(self, handle: Handle) -> None:
        import mpmath  # type: ignore[import-untyped]

        self.mp = mpmath
        self.handle = handle
        knots = {0.0, LASTING_S, *PULSE_S, *WAYPOINTS[:, 0].tolist()}
        self.knots = sorted(knots)

    def at(self, rate_hz: float) -> Floats:
        """Positions at every tick of a rate, the last one at the end."""
        mp = self.mp
        count = round(LASTING_S * rate_hz)
        out = np.empty(count + 1)
        with mp.workdps(40):
            x, v, tick = mp.mpf(0), mp.mpf(0), 0
            for begin, end in pairwise(self.knots):
                begin_s, end_s = _exactly(mp, begin), _exactly(mp, end)
                now = begin_s
                while now < end_s:
                    until, motion = self._flight(begin_s, now, end_s, x, v)
                    while tick <= count and mp.mpf(tick) / int(rate_hz) <= until:
                        out[tick] = float(motion(mp.mpf(tick) / int(rate_hz) - now)[0])
                        tick += 1
                    x, v = motion(until - now)
                    if until < end_s:
                        v = mp.mpf(0)
                    now = until
        return out

    def _flight(self, begin: Any, now: Any, end: Any, x: Any, v: Any) -> tuple[Any, Callable[[Any], tuple[Any, Any]]]:
        """Until when the motion from x, v at `now` goes on in one direction or rests, and what it is after a while."""
        mp, h = self.mp, self.handle
        reference, rate, push = self._driven(begin, now)
        mass, k, b = mp.mpf(h.mass_kg), mp.mpf(h.hand_stiffness_n_per_m), mp.mpf(h.hand_damping_n_s_per_m)
        friction = mp.mpf(h.friction_n)

        def pull(after: Any) -> Any:
            return push + k * (reference + rate * after - x) + b * rate

        # What is left of a turn by rounding is none.
        if friction and abs(v) < mp.mpf(10) ** -30:
            if abs(pull(0)) <= friction:
                # At rest, until the spring has been drawn far enough.
                rest = end
                if rate != 0:
                    ways = [(side * friction - pull(0)) / (k * rate) for side in (-1, 1)]
                    rest = min([end, *(now + way for way in ways if way > 0)])
                if rest > now:
                    return rest, lambda after: (x, mp.mpf(0))
            way = rate if abs(abs(pull(0)) - friction) < mp.mpf(10) ** -25 else pull(0)
            direction = mp.sign(way)
        else:
            direction = mp.sign(v) if friction else mp.mpf(0)
        damping = mp.mpf(h.damping_n_s_per_m) + b
        beta = rate
        alpha = reference + (push - direction * friction + b * rate - damping * beta) / k
        root = mp.sqrt(mp.mpc(damping * damping - 4 * mass * k))
        p = [(-damping + root) / (2 * mass), (-damping - root) / (2 * mass)]
        c1 = ((v - beta) - p[1] * (x - alpha)) / (p[0] - p[1])
        c = [c1, (x - alpha) - c1]

        def motion(after: Any) -> tuple[Any, Any]:
            grown = [c[i] * mp.exp(p[i] * after) for i in range(2)]
            return (
                mp.re(alpha + beta * after + grown[0] + grown[1]),
                mp.re(beta + p[0] * grown[0] + p[1] * grown[1]),
            )

        if not friction:
            return end, motion
        # The first turn: looked for in steps far shorter than a swing.
        step = mp.mpf("0.0005")
        low = mp.mpf(0)
        while now + low < end:
            high = min(low + step, end - now)
            if direction * motion(high)[1] < 0:
                for _ in range(140):
                    middle = (low + high) / 2
                    low, high = (middle, high) if direction * motion(middle)[1] > 0 else (low, middle)
                return now + high, motion
            low = high
        return end, motion

    def _driven(self, begin: Any, now: Any) -> tuple[Any, Any, Any]:
        """Reference, its speed and the actuator's force from `now` on, in the stretch that begins at `begin`."""
        mp = self.mp
        push = mp.mpf(PULSE_N) if PULSE_S[0] - 1e-9 < begin < PULSE_S[1] - 1e-9 else mp.mpf(0)
        for (t0, w0), (t1, w1) in pairwise(WAYPOINTS):
            if t0 - 1e-9 < begin < t1 - 1e-9:
                rate = (_exactly(mp, w1) - _exactly(mp, w0)) / (_exactly(mp, t1) - _exactly(mp, t0))
                return _exactly(mp, w0) + rate * (now - _exactly(mp, t0)), rate, push
        return _exactly(mp, WAYPOINTS[-1, 1]), mp.mpf(0), push


def _exactly(mp: Any, value: float) -> Any:
    """The decimal number that was meant: a knot lies on a tick, not a rounding beside it."""
    return mp.mpf(f"{value:.6g}")


def ways(peers: Peers) -> dict[str, int]:
    """All of them by name."""
    lib = peers.lib
    return {
        FLOOR: lib.PEER_JOYSTICK_EULER,
        "semi-implicit Euler": lib.PEER_JOYSTICK_SEMI_IMPLICIT,
        "Runge-Kutta, 4th order": lib.PEER_JOYSTICK_RK4,
        OURS: lib.PEER_JOYSTICK_EXACT,
    }


def path_of(peers: Peers, way: int, handle: Handle, rate_hz: float) -> Floats:
    """Positions at every tick, [n + 1]."""
    return peers.joystick(way, asdict(handle), 1 / rate_hz, WAYPOINTS, force(rate_hz))[0]


def run(options: Options, advance: Advance) -> Section:
    """Table and figure of it."""
    rounds = options.few(40, 6)
    rates = RATES_HZ if not options.quick else (1000.0, 10_000.0)
    errors: dict[tuple[str, float, str], float] = {}
    costs = {}
    peers = compiled()
    for index, (case, handle) in enumerate(HANDLES.items()):
        for rate in rates:
            truth = Closed(handle).at(rate)
            for name, way in ways(peers).items():
                found = path_of(peers, way, handle, rate)
                errors[case, rate, name] = float(np.abs(found - truth).max() / np.abs(truth).max())
        advance(0.5 * (index + 1) / len(HANDLES), case)
    for index, (case, handle) in enumerate(HANDLES.items()):
        held = force(10_000.0)
        runs: dict[str, Callable[[], float]] = {}
        for name, way in ways(peers).items():

            def timed(way: int = way, handle: Handle = handle, held: Floats = held) -> float:
                return peers.joystick(way, asdict(handle), 1e-4, WAYPOINTS, held)[1] / len(held)

            runs[name] = timed
        part = 0.5 + 0.5 * index / len(HANDLES)
        costs[case] = alternated(rounds, runs, between(advance, part, part + 0.5 / len(HANDLES), "costs"))
    rows = []
    for case in HANDLES:
        for name in costs[case]:
            cells = [f"{errors[case, rate, name]:.1e}" for rate in rates]
            cost = costs[case][name]
            rows.append([f"{case}: {name}", *cells, spread(cost, ".1f"), spread(cost / costs[case][FLOOR], ".2f")])

    def draw(canvas: Canvas) -> None:
        plots = canvas.subplots(1, len(HANDLES), sharey=True)
        for axes, case in zip(plots, HANDLES, strict=True):
            for rate, hollow in ((10_000.0, False), (1000.0, True)):
                points = [
                    Point(name, cost.tolist(), errors[case, rate, name], name == OURS)
                    for name, cost in costs[case].items()
                ]
                trade(axes, points, hollow=hollow)
            axes.set_xlabel("ns a period, both axes")
            axes.set_title(case, fontsize=10)
        plots[0].set_ylabel("worst error at ticks, of the way")
        canvas.suptitle("The simulated joystick: 10 kHz filled, 1 kHz hollow")
        beside(canvas, plots[0])

    return Section(
        "The simulated joystick",
        [
            f"{LASTING_S:g} s of a handle of 0.1 kg (light: 0.02 kg) in a hand of 300 N/m and 3 N s/m (firm: 1000 "
            "N/m, 1 N s/m), whose reference is drawn to and fro, under a force that the actuator holds from tick to "
            "tick. The other ways take one step a period and know of dry friction what a step can: a handle that would "
            "turn within it stops. References: closed forms from event to event in 40 digits.",
            Table(
                f"Worst error at ticks, of the largest excursion; ns a period at 10 kHz, both axes, {rounds} rounds in "
                "turns: median (10 to 90 %)",
                ["motion: way", *(f"{rate / 1000:g} kHz" for rate in rates), "ns", f"over {FLOOR}"],
                rows,
            ),
            Figure("joystick", "The simulated joystick: cost against error", draw, (12.0, 4.5)),
        ],
    )
