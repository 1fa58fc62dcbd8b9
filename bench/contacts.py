"""A hundred kinds of contact, twelve taps each at 1 kHz with seven samples of rest: what is refused, whether verdicts
are right, and how much of each recorded tap the rendered one explains.

The taps are closed forms with the variety that recordings of real surfaces have: one ringing mode or two, pulses that
do not ring, amplitudes that saturate, decays that grow with the speed, noise, hum, a few clipped. Generator and judge
are numpy, and share nothing with the fit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeAlias

import numpy as np

import hapticd
from bench.report import Advance, Floats, Options, Section, Table, verdict
from hapticd.base.errors import HapticdError
from hapticd.config.materials import validate_materials
from hapticd.fit.from_files import fit_taps
from hapticd.fit.recording import Recording, Source
from hapticd.fit.tap import TapFit
from hapticd.fit.waveform import WaveformFit

Kind: TypeAlias = Literal["one mode", "two modes", "pulse", "pulse and mode"]

RATE_HZ: Final = 1000.0
REST: Final = 7
TAPS: Final = 12
SAMPLES: Final = 160
KINDS: Final[tuple[tuple[Kind, int], ...]] = (
    ("one mode", 45),
    ("two modes", 20),
    ("pulse", 25),
    ("pulse and mode", 10),
)
"""And how many of a hundred are of it."""
USABLE_SHARE: Final = 0.95
USABLE_R2: Final = 0.9
"""What a fit has to explain of the median tap, and of the amplitudes over speed, for its figures to be used;"""
USABLE_SCATTER: Final = 0.15
"""of amplitudes that hardly depend on the speed it is enough that they scatter by this at most."""
WITHIN: Final = 0.03
"""So near to these bounds either verdict is right: fits are over the ringing, the judge is over all samples."""
SERVO_HZ: Final = 10_000
MASS_KG: Final = 0.05


@dataclass(frozen=True, slots=True)
class Contact:
    """Twelve taps of one kind of surface."""

    name: str
    kind: Kind
    speeds: Floats
    onsets: Floats
    """In samples from the first one."""
    clean: Floats
    """(taps, samples) m/s^2, without noise, hum and gravity."""
    recorded: Floats
    clipped: tuple[bool, ...]

    def recordings(self) -> list[Recording]:
        """One a tap."""
        return [
            Recording(f"{self.name} {index}", RATE_HZ, seen, None, None, None, float(speed), Source(self.name, ""))
            for index, (speed, seen) in enumerate(zip(self.speeds, self.recorded, strict=True))
        ]


def contact(number: int, kind: Kind) -> Contact:
    """The contact with this number; the same each time."""
    random = np.random.default_rng([20261123, number])
    speeds = np.sort(random.uniform(0.05, 0.4, TAPS)) if number % 3 else np.geomspace(0.05, 0.4, TAPS)
    usual = 0.2
    power = float(random.choice([1.0, 1.0, 0.5, random.uniform(0.5, 0.9)]))
    grows = float(random.choice([0.0, random.uniform(0.1, 0.4)]))
    rises = float(random.choice([0.0, random.uniform(0.0, 0.03)]))
    hz = float(math.exp(random.uniform(math.log(30), math.log(480))))
    damping = random.uniform(0.03, 0.2) if hz > 60 else random.uniform(0.05, 0.3)
    size = random.uniform(10, 80)
    ratio, above = random.uniform(0.25, 0.8), random.uniform(1.8, 3.5)
    width_s = random.uniform(0.004, 0.015)
    time = np.arange(SAMPLES)
    onsets = REST + random.uniform(0.0, 1.0, TAPS) - 1
    clean = np.zeros((TAPS, SAMPLES))
    for index, speed in enumerate(speeds):
        since = np.maximum((time - onsets[index]) / RATE_HZ, 0.0)
        heavier = speed / usual
        large = size * heavier**power * math.exp(0.04 * random.standard_normal())
        w = 2 * math.pi * hz * heavier**rises
        b = damping * 2 * math.pi * hz * heavier**grows
        if kind in ("one mode", "two modes"):
            clean[index] = large * np.exp(-b * since) * np.sin(w * since)
        if kind == "two modes":
            if hz * above > 450:
                above = 1 / above
            clean[index] += ratio * large * np.exp(-1.3 * above**0.5 * b * since) * np.sin(above * w * since)
        if kind in ("pulse", "pulse and mode"):
            wide = width_s * heavier**-0.1
            clean[index] = large * np.where(since < wide, np.sin(np.pi * np.minimum(since / wide, 1.0)) ** 1.5, 0.0)
        if kind == "pulse and mode":
            clean[index] += 0.3 * large * np.exp(-b * since) * np.sin(w * since)
    noise = random.uniform(0.003, 0.02) * float(np.abs(clean).max(axis=1).mean())
    recorded = 9.81 + clean + noise * random.standard_normal(clean.shape)
    if number % 4 == 0:
        hum_hz = float(random.choice([50.0, 60.0, 100.0, 200.0, 300.0]))
        phase = random.uniform(0, 2 * math.pi, (TAPS, 1))
        recorded += random.uniform(0.5, 2.0) * noise * np.sin(2 * math.pi * hum_hz * time / RATE_HZ + phase)
    end = math.inf
    if number % 12 == 5:
        end = 9.81 + float(np.sort(np.abs(clean).max(axis=1))[-3]) * 0.9
    recorded = np.clip(recorded, -end, end)
    cut = tuple(bool(np.count_nonzero(seen >= end) >= 3) for seen in recorded)
    return Contact(f"{kind} {number}", kind, speeds, onsets, clean, recorded, cut)


def contacts(count: int = 100) -> list[Contact]:
    """So many, of every kind in its share."""
    kinds = [kind for kind, many in KINDS for _ in range(many)]
    order = np.random.default_rng(7).permutation(len(kinds))
    return [contact(number, kinds[order[number % len(kinds)]]) for number in range(count)]


# ---- The judge -------------------------------------------------------------------------------------------------------


def explained(tap: Floats, model: Floats) -> float:
    """1 less the part of the variance, about the rest value, that the model leaves; a constant beside it is free."""
    whole, left = tap - tap.mean(), tap - model
    return 1.0 - float(np.sum((left - left.mean()) ** 2) / np.sum(whole**2))


def _columns(since_s: Floats, hertz: Floats, dampings: Floats) -> Floats:
    """(modes, samples) of every frequency with every damping, struck at 0."""
    w = 2 * math.pi * np.repeat(hertz, len(dampings))[:, None]
    b = np.tile(dampings, len(hertz))[:, None] * w
    return np.where(since_s > 0, np.exp(-b * np.maximum(since_s, 0)) * np.sin(w * np.maximum(since_s, 0)), 0.0)


def _best(seen: Floats, beside: Floats | None, since_s: Floats) -> tuple[float, Floats, float]:
    """Share of the variance of one mode more, `beside` columns (k, n), that mode's column, and how large the mode is,
    m/s^2; by ever finer grids."""
    hertz, dampings = np.geomspace(15, 495, 80), np.geomspace(0.01, 1.5, 16)
    shifts_s = np.linspace(-1.0, 1.0, 9) / RATE_HZ if beside is None else np.zeros(1)
    best: tuple[float, Floats, float, float, float] | None = None
    for finer in range(4):
        for shift_s in shifts_s:
            tried = _columns(since_s - shift_s, hertz, dampings)
            base = np.ones((1, len(seen))) if beside is None else np.vstack([np.ones((1, len(seen))), beside])
            q = np.linalg.qr(base.T)[0]
            left = seen - q @ (q.T @ seen)
            free = tried - (tried @ q) @ q.T
            power = np.sum(free**2, axis=1)
            gain = np.where(power > 1e-9, (free @ left) ** 2 / np.maximum(power, 1e-9), 0.0)
            place = int(np.argmax(gain))
            share = 1 - (float(left @ left) - float(gain[place])) / float(np.sum((seen - seen.mean()) ** 2))
            if best is None or share > best[0]:
                which = divmod(place, len(dampings))
                best = share, tried[place], float(hertz[which[0]]), float(dampings[which[1]]), float(shift_s)
        assert best is not None
        wide = 1.06 ** (1 / 3**finer)
        hertz = best[2] * np.geomspace(1 / wide, wide, 9)
        dampings = best[3] * np.geomspace(wide**-6, wide**6, 9)
        if beside is None:
            shifts_s = best[4] + np.linspace(-0.25, 0.25, 5) / RATE_HZ / 3**finer
    assert best is not None
    off = best[1] - best[1].mean()
    return best[0], best[1], float(off @ seen) / float(off @ off)


@dataclass(frozen=True, slots=True)
class Judged:
    """What numpy says of a contact: medians over the taps that are not clipped."""

    one: float
    """Share of the variance that one mode explains."""
    two: float
    wave: float
    """That the mean shape of the taps explains."""
    law: float
    """r^2 of the logarithm of the taps' size over that of the speed, by a straight line."""
    scatter: float
    """RMS of what that line leaves, as a part of the size."""


def judged(given: Contact) -> Judged:
    """By grids and linear least squares, from the true onsets."""
    one, two, aligned, sizes = [], [], [], []
    kept = [k for k in range(TAPS) if not given.clipped[k]]
    grid = np.arange(0, SAMPLES - REST - 2)
    for k in kept:
        seen = given.recorded[k]
        since_s = (np.arange(SAMPLES) - given.onsets[k]) / RATE_HZ
        share, column, size = _best(seen, None, since_s)
        one.append(share)
        sizes.append(abs(size))
        two.append(_best(seen, column[None], since_s)[0])
        moved = np.interp(grid + given.onsets[k], np.arange(SAMPLES), seen - np.median(seen[: REST - 1]))
        aligned.append(moved / np.linalg.norm(moved))
    mean = np.mean(aligned, axis=0)
    wave = [explained(tap, mean * float(tap @ mean) / float(mean @ mean)) for tap in aligned]
    # Of the two measures of a tap's size the better: samples miss peaks, and a mode that is none has no amplitude.
    peaks = [np.ptp(given.recorded[k]) for k in kept]
    laws = []
    for each in (sizes, peaks):
        logs, at = np.log(each), np.log(given.speeds[kept])
        off = logs - np.polyval(np.polyfit(at, logs, 1), at)
        laws.append((1 - float(np.var(off) / np.var(logs)), float(np.std(off))))
    law, scatter = max(laws)
    return Judged(*(float(np.median(values)) for values in (one, two, wave)), law, scatter)


def rendered(material: dict[str, Any], speed: float) -> tuple[Floats, Floats]:
    """Times since the touch, s, and the vibration in m/s^2, as the core plays the material's tap at this speed."""
    ticks = round((SAMPLES + 20) / RATE_HZ * SERVO_HZ)
    # Half way between two samples.
    path = np.full((ticks + 1, 2), [0.0, -0.5 * speed / SERVO_HZ])
    path[0, 1] = 0.5 * speed / SERVO_HZ
    velocity = np.full((ticks + 1, 2), [0.0, -speed])
    config = {
        "device": {"effective_mass_kg": MASS_KG, "max_force_n": 100},
        "materials": {"m": material},
        "scene": {"objects": {"w": {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "m"}}},
    }
    force = hapticd.render(config, path, SERVO_HZ, velocity_m_per_s=velocity)["vibration_force_n"][1:, 1]
    return (np.arange(ticks) + 0.5) / SERVO_HZ, np.asarray(force / MASS_KG, dtype=np.float64)


def shown(given: Contact, material: dict[str, Any], sign: float = 1.0) -> Floats:
    """Share of the variance of each tap that is not clipped, that the rendered one explains, where it fits best."""
    found = []
    for k in range(TAPS):
        if given.clipped[k]:
            continue
        since, played = rendered(material, float(given.speeds[k]))
        times = (np.arange(SAMPLES) - given.onsets[k]) / RATE_HZ
        shares = [
            explained(given.recorded[k], sign * np.interp(times - late, since, played, left=0.0, right=0.0))
            for late in np.linspace(-1.5e-3, 1.5e-3, 61)
        ]
        found.append(max(shares))
    return np.array(found)


# ---- The section -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a contact."""

    given: Contact
    judged: Judged
    fit: TapFit | WaveformFit | None
    refused: str
    form: str
    """What of the tap was made: one mode, two, or a waveform; a slope or a table."""
    shown: float
    """Median share of the variance of its taps that the rendered ones explain."""

    @property
    def agrees(self) -> bool:
        """Whether fit and judge say the same of whether the figures can be used."""
        if self.fit is None:
            return False
        share = {"one": self.judged.one, "two": self.judged.two, "wave": self.judged.wave}[self.form.split()[0]]
        law = max(self.judged.law - USABLE_R2, USABLE_SCATTER - self.judged.scatter)
        over = min(share - USABLE_SHARE, law)
        return abs(over) < WITHIN or (over > 0) == (not self.fit.verdict.startswith("poor"))


def outcome(given: Contact, fitted: Callable[[list[Recording]], TapFit | WaveformFit] = fit_taps) -> Outcome:
    """Fits, renders and judges a contact."""
    said = judged(given)
    try:
        fit = fitted(given.recordings())
        figures: Any = fit.material()
    except HapticdError as error:
        return Outcome(given, said, None, str(error), "none", 0.0)
    tap = figures["tap"]
    form = "wave" if "waveform" in tap else "two" if "second" in tap else "one"
    law = "slope" if "attack_slope_per_s" in tap else "table"
    material = {"stiffness_n_per_m": 800.0, **figures}
    validate_materials({"m": material})
    return Outcome(given, said, fit, "", f"{form} {law}", float(np.median(shown(given, material))))


def run(options: Options, advance: Advance) -> Section:
    """A table by kind."""
    every: list[Outcome] = []
    count = options.few(100, 12)
    for given in contacts(count):
        every.append(outcome(given))
        advance(len(every) / count, given.name)
    rows = [_row(kind, [each for each in every if each.given.kind == kind]) for kind, _ in KINDS]
    rows.append(_row("all", every))
    all_shown = float(np.median([each.shown for each in every]))
    agree = float(np.mean([each.agrees for each in every]))
    refused = sum(each.fit is None for each in every)
    return Section(
        "Taps of a hundred kinds of contact",
        [
            f"{count} synthetic materials, {TAPS} taps each at {RATE_HZ:g} Hz with {REST} samples of rest before the "
            "contact: modes of 30 to 480 Hz, two modes, pulses that do not ring, amplitudes that saturate, decays that "
            "grow with the speed, noise, hum, a few clipped. The fit is what `hapticd fit tap` makes of them without "
            "options; its tap is rendered at each speed and compared with the recorded one. An independent fit "
            "(numpy, by grids and linear least squares) says whether the form explains 95 % of the median tap, and "
            "whether the speed explains 90 % of the variance of the amplitudes' logarithms or all but a scatter of "
            f"15 %; *agree* is the part of the verdicts (poor or not) that say the same, or are within {WITHIN:g} of "
            "these bounds.",
            Table(
                "Outcome by kind of contact",
                ["kind", "materials", "refused", "one mode", "two", "waveform", "table", "agree, %", "rendered, %"],
                rows,
            ),
            f"None refused: {verdict(refused, 0)} ({refused}). Verdicts agree for 95 %: "
            f"{verdict(agree, 0.949, above=True)} ({100 * agree:.0f} %). Median of what the rendered tap explains at "
            f"least 90 %: {verdict(all_shown, 0.899, above=True)} ({100 * all_shown:.1f} %).",
        ],
    )


def _row(name: str, every: list[Outcome]) -> list[str]:
    if not every:
        return [name, "0", *["-"] * 7]
    forms = [each.form for each in every]
    return [
        name,
        str(len(every)),
        str(sum(each.fit is None for each in every)),
        *(str(sum(form.startswith(what) for form in forms)) for what in ("one", "two", "wave")),
        str(sum(form.endswith("table") for form in forms)),
        f"{100 * np.mean([each.agrees for each in every]):.0f}",
        f"{100 * np.median([each.shown for each in every]):.1f}",
    ]
