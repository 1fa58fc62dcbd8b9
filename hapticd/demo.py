"""The main job, shown: `make demo`.

Starts the daemon on the simulated joystick in a process of its own and drives it over ZeroMQ: taps on the seven
materials of the paper and a puncture of its membrane. What comes back in telemetry is measured (frequency, decay and
slope fitted to the vibration that was rendered) and compared with the library. Ends by itself.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.progress import Progress, TaskID
from rich.table import Table

from hapticd.calls import Event
from hapticd.client import Client, Subscription, connect
from hapticd.errors import HapticdError
from hapticd.materials import Material, Mode, shipped_materials

Floats = npt.NDArray[np.float64]

SPEEDS_M_PER_S = (0.04, 0.05, 0.06, 0.07, 0.08, 0.09, 0.10, 0.11, 0.12, 0.13, 0.14, 0.15, 0.30)
HOVER_M = 0.012
PRESS_M = 0.004
HOLD_S = 0.08
PLOT = "demo.png"


@dataclass(frozen=True, slots=True)
class Tap:
    """One contact and what was rendered after it."""

    onset_s: float
    speed: float
    true_speed: float
    amplitude: float
    scale: float


@dataclass(frozen=True, slots=True)
class Recorded:
    """Telemetry of one material or membrane, times in seconds from its first sample."""

    time_s: Floats
    position: Floats
    contact_force: Floats
    vibration: Floats
    taps: tuple[Tap, ...]
    events: tuple[dict[str, Any], ...]
    start_ns: int


@dataclass(frozen=True, slots=True)
class Fitted:
    """A mode fitted to recorded vibration; slopes in 1/s, from unscaled taps."""

    frequency_hz: float
    decay_time_s: float
    amplitudes: Floats
    slope_estimated: float
    slope_true: float
    used: int
    residual: float


def ringing(since: Floats, mode: Mode) -> Floats:
    """exp(-B t) sin(w t) for 0 <= t <= 5/B, else 0."""
    inside = (since >= 0) & (since <= 5.0 / mode.decay_rate_per_s)
    t = np.where(inside, since, 0.0)
    return np.where(inside, np.exp(-mode.decay_rate_per_s * t) * np.sin(mode.angular_frequency_rad_per_s * t), 0.0)


def fit(recorded: Recorded, guess: Mode, mass_kg: float) -> Fitted:
    """Frequency, decay and one amplitude a contact, by variable projection: the amplitudes are linear.

    Contacts closer together than a mode lasts share one ring-down, which ends with its last strike (as the model says),
    so each stretch of samples is fitted with all the strikes that sound in it. The slope is the regression of amplitude
    on speed through the origin, over contacts that the force limit did not scale.
    """
    from scipy.optimize import least_squares

    onsets = np.array([tap.onset_s for tap in recorded.taps])
    signal_ = recorded.vibration / mass_kg
    # Only what the guess says sounds for sure: the cut itself is the model's, not what is measured.
    last = np.searchsorted(onsets, recorded.time_s, side="right") - 1
    since_last = np.where(last >= 0, recorded.time_s - onsets[np.maximum(last, 0)], np.inf)
    used = since_last <= 4.9 / guess.decay_rate_per_s
    times, wanted, last = recorded.time_s[used], signal_[used], last[used]
    gap = np.diff(onsets, prepend=-np.inf) > 5.0 / guess.decay_rate_per_s
    group = np.cumsum(gap)  # strikes that sound together

    def columns(parameters: Floats) -> Floats:
        omega, decay = parameters
        matrix = np.zeros((len(times), len(onsets)))
        for column, onset in enumerate(onsets):
            inside = (times >= onset) & (group[last] == group[column])
            t = times[inside] - onset
            matrix[inside, column] = np.exp(-decay * t) * np.sin(omega * t)
        return matrix

    def amplitudes(matrix: Floats) -> Floats:
        return np.asarray(np.linalg.lstsq(matrix, wanted, rcond=None)[0], dtype=np.float64)

    def residual(parameters: Floats) -> Floats:
        matrix = columns(parameters)
        return matrix @ amplitudes(matrix) - wanted

    # From a guess that is well off: what comes out is measured, not what went in.
    start = np.array([guess.angular_frequency_rad_per_s * 1.1, guess.decay_rate_per_s * 0.85])
    found = least_squares(residual, start, x_scale=start, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    omega, decay = found.x
    strengths = amplitudes(columns(found.x))
    whole = np.array([tap.scale == 1.0 and tap.amplitude > 0 for tap in recorded.taps])
    if not whole.any():
        raise HapticdError("every tap was scaled down: there is no slope to measure; tap more slowly")

    def slope(speeds: Floats) -> float:
        return float(np.dot(speeds[whole], strengths[whole]) / np.dot(speeds[whole], speeds[whole]))

    return Fitted(
        frequency_hz=omega / (2 * np.pi),
        decay_time_s=1 / decay,
        amplitudes=strengths,
        slope_estimated=slope(np.array([tap.speed for tap in recorded.taps])),
        slope_true=slope(np.array([tap.true_speed for tap in recorded.taps])),
        used=int(whole.sum()),
        residual=float(np.sqrt(np.mean(found.fun**2)) / np.sqrt(np.mean(wanted**2))),
    )


def tapping(speeds: Sequence[float], x_m: float = 0.0) -> list[list[float]]:
    """Waypoints of a hand that taps the floor at y = 0 once at each speed, in straight lines."""
    now, path = 0.0, [[0.0, x_m, HOVER_M]]
    for speed in speeds:
        for height, lasting in (
            (HOVER_M, 0.06),
            (-PRESS_M, (HOVER_M + PRESS_M) / speed),
            (-PRESS_M, HOLD_S),
            (HOVER_M, 0.09),
        ):
            now += lasting
            path.append([now, x_m, height])
    return path


def pressing(center_y_m: float) -> list[list[float]]:
    """Waypoints of a hand that presses through a membrane slowly."""
    return [
        [0.0, 0.0, center_y_m + 0.01],
        [0.3, 0.0, center_y_m + 0.005],
        [1.5, 0.0, center_y_m - 0.03],
        [1.7, 0.0, center_y_m - 0.03],
    ]


@dataclass(frozen=True, slots=True)
class Part:
    """A bar of the progress display."""

    progress: Progress
    task: TaskID

    def __call__(self, done: float) -> None:
        """`done`, 0 to 1."""
        self.progress.update(self.task, completed=done)


def perform(daemon: Client, waypoints: list[list[float]], advance: Part) -> Recorded:
    """Has the operator follow the waypoints and records it until the end."""
    feed: Subscription[Event]
    with daemon.samples() as samples, daemon.events() as feed:
        answer = daemon.set_operator(waypoints)
        begin, lasting = int(answer["tick"]), float(answer["duration_s"])
        rate = float(daemon.get_status()["rate_hz"])
        batches = []
        events: list[dict[str, Any]] = []
        start_ns = None
        while True:
            batch = next(samples)
            if batch.lost:
                raise HapticdError(f"{batch.lost} samples were lost: the machine is too busy for the demo")
            while (event := feed.receive(0.0)) is not None:
                events.append({**event})
            kept = batch[batch["tick"] >= begin]
            if len(kept):
                start_ns = int(kept["time_ns"][0]) if start_ns is None else start_ns
                batches.append(np.array(kept))
                advance(min(1.0, (int(kept["time_ns"][-1]) - start_ns) / 1e9 / lasting))
                if int(kept["time_ns"][-1]) - start_ns > (lasting + 5 / rate) * 1e9:
                    break
        end_ns = int(batches[-1]["time_ns"][-1])
        # What happened until the end may still be on its way; what happened after it says that it has come.
        while not (events and events[-1]["time_ns"] > end_ns) and (event := feed.receive(0.1)) is not None:
            events.append({**event})
    events = [event for event in events if begin <= event["tick"] and event["time_ns"] <= end_ns]
    data = np.concatenate(batches)
    zero = int(data["time_ns"][0])
    taps = tuple(
        Tap(
            onset_s=(event["time_ns"] - zero) / 1e9 - event["before_tick_s"],
            speed=event["speed_m_per_s"],
            true_speed=event["true_speed_m_per_s"],
            amplitude=event["amplitude_m_per_s2"],
            scale=event["scale"],
        )
        for event in events
        if event["event"] in ("contact", "puncture") and event["amplitude_m_per_s2"] > 0
    )
    return Recorded(
        time_s=(data["time_ns"] - zero) / 1e9,
        position=np.ascontiguousarray(data["position_m"]),
        contact_force=data["contact_force_n"][:, 1].copy(),
        vibration=data["vibration_force_n"][:, 1].copy(),
        taps=taps,
        events=tuple(events),
        start_ns=zero,
    )


@contextmanager
def running_daemon(directory: Path) -> Iterator[Client]:
    """`hapticd run` in a process of its own, stopped (and checked to have stopped well) at the end."""
    process = subprocess.Popen(
        [sys.executable, "-m", "hapticd", "--runtime-dir", str(directory), "run"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield _connected(process, directory)
    finally:
        process.send_signal(signal.SIGTERM)
        _, said = process.communicate(timeout=30)
    if process.returncode != 0:
        raise HapticdError(f"the daemon ended with {process.returncode}: {said.strip()}")


def _connected(process: subprocess.Popen[str], directory: Path) -> Client:
    deadline = time.monotonic() + 30
    while not (directory / "hapticd.command").exists():
        if process.poll() is not None:
            raise HapticdError(f"the daemon does not start: {process.communicate()[1].strip()}")
        if time.monotonic() > deadline:
            raise HapticdError("the daemon was not ready within 30 s")
        time.sleep(0.02)  # it is another process, and what it says last is this file
    return connect(directory)


def puncture_report(recorded: Recorded, depth_m: float, center_y_m: float) -> dict[str, float]:
    """What the puncture did: the force of the membrane at its tick, and how far past the limit it came."""
    (event,) = [event for event in recorded.events if event["event"] == "puncture"]
    at = int(np.searchsorted(recorded.time_s, (event["time_ns"] - recorded.start_ns) / 1e9 - 1e-9))
    deflection = center_y_m - recorded.position[:, 1]
    return {
        "force_at_rupture_n": float(abs(recorded.contact_force[at:]).max()),
        "force_before_n": float(recorded.contact_force[at - 1]),
        "overshoot_m": float(deflection[at] - depth_m),
        "travel_m": float(deflection[at] - deflection[at - 1]),
    }


def main() -> int:
    """Runs the demo; its exit code."""
    console = Console()
    library = shipped_materials()
    names = [name for name, material in library.items() if material.tap is not None]
    with (
        tempfile.TemporaryDirectory(prefix="hapticd-demo-") as directory,
        running_daemon(Path(directory, "run")) as daemon,
    ):
        status = daemon.get_status()
        realtime = status["realtime"] or {}
        console.print(
            f"hapticd {status['version']}, {status['device']} at {status['rate_hz']:g} Hz, "
            f"{'SCHED_FIFO' if realtime.get('priority') else 'without real-time rights'}; "
            f"{len(SPEEDS_M_PER_S)} taps on each material, {min(SPEEDS_M_PER_S)} to {max(SPEEDS_M_PER_S)} m/s"
        )
        mass_kg = 0.05
        daemon.update_materials({})
        recordings: dict[str, Recorded] = {}
        with Progress(console=console) as progress:
            floor = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1]}
            for name in names:
                task = progress.add_task(name, total=1.0)
                daemon.set_scene({"objects": {"floor": {**floor, "material": name}}}, wait=True)
                recordings[name] = perform(daemon, tapping(SPEEDS_M_PER_S), Part(progress, task))
            task = progress.add_task("cellophane", total=1.0)
            skin = {"kind": "membrane", "center_m": [0, 0], "normal": [0, 1], "width_m": 0.02, "material": "cellophane"}
            daemon.set_operator([[0, 0, HOVER_M], [0.2, 0, 0.01]])
            daemon.set_scene({"objects": {"skin": skin}}, wait=True)
            punctured = perform(daemon, pressing(0.0), Part(progress, task))
        counters = daemon.get_status()["counters"]
    return report(console, library, recordings, punctured, mass_kg, counters)


def report(
    console: Console,
    library: Any,
    recordings: dict[str, Recorded],
    punctured: Recorded,
    mass_kg: float,
    counters: Any,
) -> int:
    """Prints the measured table, saves the plot; 1 if anything misses its mark."""
    table = Table(title="Rendered, fitted to telemetry (below: library, difference)", show_lines=True)
    for heading in ("material", "frequency Hz", "decay ms", "slope 1/s", "slope by true speed", "taps"):
        table.add_column(heading, justify="left" if heading == "material" else "right")
    worst: list[str] = []
    fits: dict[str, Fitted] = {}

    def off(measured: float, wanted: float, limit: float, what: str) -> str:
        error = measured / wanted - 1
        if abs(error) > limit:
            worst.append(f"{what} is off by {100 * error:+.2f} % (limit {100 * limit:g} %)")
        return f"{100 * error:+.2f}%"

    for name, recorded in recordings.items():
        material: Material = library[name]
        assert material.tap is not None
        mode, slope = material.tap.mode, material.tap.attack_slope_per_s
        fitted = fits[name] = fit(recorded, mode, mass_kg)
        if fitted.used < 10:
            worst.append(f"{name}: {fitted.used} unscaled taps, 10 are wanted")
        scaled = sum(tap.scale < 1 for tap in recorded.taps)

        def cell(measured: float, wanted: float, digits: int, limit: float, what: str, name: str = name) -> str:
            return f"{measured:.{digits}f}\n{wanted:.{digits}f} {off(measured, wanted, limit, f'{name}: {what}')}"

        table.add_row(
            name,
            cell(fitted.frequency_hz, mode.frequency_hz, 1, 0.01, "frequency"),
            cell(1e3 * fitted.decay_time_s, 1e3 * mode.decay_time_s, 3, 0.01, "decay time"),
            cell(fitted.slope_estimated, slope, 1, 0.01, "slope"),
            cell(fitted.slope_true, slope, 1, 0.03, "slope by true speed"),
            f"{fitted.used}" + (f"\n+ {scaled} scaled" if scaled else ""),
        )
    console.print(table)
    cellophane: Material = library["cellophane"]
    assert cellophane.rupture is not None
    rupture = puncture_report(punctured, cellophane.rupture.rupture_depth_m, 0.0)
    mode = cellophane.rupture.mode
    torn = fit(punctured, mode, mass_kg)
    skin = Table(title="Puncture of cellophane", show_header=False)
    before, after = rupture["force_before_n"], rupture["force_at_rupture_n"]
    skin.add_row("force before, and from the tick of rupture on", f"{before:.3f} N, {after:g} N")
    past, travel = 1e6 * rupture["overshoot_m"], 1e6 * rupture["travel_m"]
    skin.add_row("past the rupture deflection", f"{past:.0f} um, of {travel:.0f} um travelled in that tick")
    for what, measured, wanted, unit in (
        ("amplitude", float(torn.amplitudes[0]), cellophane.rupture.amplitude_m_per_s2, "m/s^2"),
        ("angular frequency", 2 * np.pi * torn.frequency_hz, mode.angular_frequency_rad_per_s, "rad/s"),
        ("decay rate", 1 / torn.decay_time_s, mode.decay_rate_per_s, "1/s"),
    ):
        difference = off(measured, wanted, 0.01, f"puncture: {what}")
        skin.add_row(what, f"{measured:.2f} {unit} (library {wanted:g}: {difference})")
    console.print(skin)
    if rupture["force_at_rupture_n"] != 0.0:
        worst.append("the membrane still pushed at the tick of rupture")
    if not 0 < rupture["overshoot_m"] <= rupture["travel_m"]:
        worst.append("the rupture came later than a tick's travel")
    plot(recordings, fits, library, punctured, mass_kg)
    console.print(
        f"{counters['ticks']} ticks, {counters['skipped']} periods skipped, {counters['samples_dropped']} samples "
        f"dropped; plot: {PLOT}"
    )
    for line in worst:
        console.print(f"missed: {line}", style="bold red")
    return 1 if worst else 0


def plot(
    recordings: dict[str, Recorded], fits: dict[str, Fitted], library: Any, punctured: Recorded, mass_kg: float
) -> None:
    """Each material's tap with its fit, slopes, and the puncture, into `demo.png`."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(3, 3, figsize=(13, 9.5), constrained_layout=True)
    panels = iter(axes.flat)
    for name, recorded in recordings.items():
        panel = next(panels)
        fitted = fits[name]
        mode: Mode = library[name].tap.mode
        chosen = max((t for t in recorded.taps if t.scale == 1.0), key=lambda t: t.speed)
        window = (recorded.time_s > chosen.onset_s - 0.2 / mode.decay_rate_per_s) & (
            recorded.time_s < chosen.onset_s + 5.5 / mode.decay_rate_per_s
        )
        t = recorded.time_s[window]
        panel.plot(1e3 * (t - chosen.onset_s), recorded.vibration[window] / mass_kg, ".", ms=4, label="rendered")
        fine = np.linspace(0, 5 / mode.decay_rate_per_s, 800)
        closed = library[name].tap.attack_slope_per_s * chosen.speed * ringing(fine, mode)
        panel.plot(1e3 * fine, closed, lw=1, label="library")
        panel.set_title(f"{name}: {fitted.frequency_hz:.0f} Hz, {1e3 * fitted.decay_time_s:.2f} ms", fontsize=10)
        panel.set_xlabel("ms after contact")
        panel.set_ylabel("m/s²")
        panel.legend(fontsize=8)
    panel = next(panels)
    for name, recorded in recordings.items():
        whole = [t.scale == 1.0 for t in recorded.taps]
        speeds = np.array([t.true_speed for t in recorded.taps])[whole]
        (line,) = panel.plot(speeds, np.abs(fits[name].amplitudes[whole]), "o", ms=3, label=name)
        ends = np.array([0, 1.02 * max(t.true_speed for t in recorded.taps)])
        panel.plot(ends, library[name].tap.attack_slope_per_s * ends, lw=0.8, color=line.get_color())
    panel.set_title("amplitude over the handle's true speed; lines: library", fontsize=10)
    panel.set_xlabel("m/s")
    panel.set_ylabel("m/s²")
    panel.legend(fontsize=7)
    panel = next(panels)
    panel.plot(-1e3 * punctured.position[:, 1], punctured.contact_force, lw=1, label="membrane")
    panel.plot(-1e3 * punctured.position[:, 1], punctured.vibration, lw=0.7, label="vibration")
    panel.axvline(4, color="grey", lw=0.6)
    panel.set_xlim(-1, 9)
    panel.set_title("puncture of cellophane", fontsize=10)
    panel.set_xlabel("mm of deflection")
    panel.set_ylabel("N")
    panel.legend(fontsize=8)
    figure.savefig(PLOT, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        sys.exit(main())
    except HapticdError as problem:
        print(f"hapticd demo: {problem}", file=sys.stderr)
        sys.exit(1)
