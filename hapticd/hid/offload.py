"""Modes that a device plays by itself: the nearest periodic effect, and which mode has which of the device's effects.

A sine of the PID class has a period, and an envelope of straight lines: from the attack level to the magnitude over the
attack time, and from there to the fade level over the fade time, at the end of its duration. Levels are absolute, as
the magnitude is (so in DirectInput's DIENVELOPE and in Linux' struct ff_envelope). Times are whole counts of the
device's. The nearest such effect to a mode is found by least squares over its levels, none of them below zero, for each
choice of its times.

`Offload` is used by two threads: the one that changes the scene, and the one that looks after the connection.
"""

from __future__ import annotations

import math
import threading
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from itertools import chain, combinations
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from hapticd.base.core import CData, HidQuantity, Status, ffi, invalid_reason, lib
from hapticd.base.errors import HapticdError
from hapticd.config.materials import Material, Tap
from hapticd.config.modes import Mode
from hapticd.hid.plan import Message, Numbers, Periodic, Scale, Value, fill_message
from hapticd.hid.texts import offload_text
from hapticd.rendering.displayability import DISPLAYABLE

MOST_ERROR: Final = 0.2
"""An effect that differs by more from its mode (RMS of the difference over RMS) is none of it."""
LONGEST_S: Final = 0.1
"""No effect plays longer: nothing but its end stops it where the daemon is gone."""
SPAN: Final = 6.0
"""So many decay times are compared."""
STEPS: Final = 50
"""Times are tried at this many places over the span, or at every count if those are fewer."""
_SAMPLES: Final = 3000
_PER_CYCLE: Final = 24
_MOST_SAMPLES: Final = 200_000
_SUBSETS: Final = tuple(chain.from_iterable(combinations(range(3), size) for size in (1, 2, 3)))

_Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Fit:
    """The nearest effect to a mode with a coefficient of one: times in counts of the device, levels over one."""

    period: int
    duration: int
    attack: int
    fade: int
    attack_level: float
    magnitude: float
    fade_level: float
    period_s: float
    duration_s: float
    error: float
    """RMS of the difference from the mode over the mode's."""

    @property
    def frequency_hz(self) -> float:
        """What is shown in place of the mode's frequency."""
        return 1.0 / self.period_s

    @property
    def peak(self) -> float:
        """The largest level."""
        return max(self.attack_level, self.magnitude, self.fade_level)


class _Times(NamedTuple):
    """What is tried, each of the same length: counts, and where the lines of the envelope meet, s."""

    duration: npt.NDArray[np.int64]
    attack: npt.NDArray[np.int64]
    fade: npt.NDArray[np.int64]
    attack_s: _Floats
    fade_from_s: _Floats
    end_s: _Floats


@lru_cache(maxsize=1024)
def fit(mode: Mode, numbers: Numbers) -> Fit | None:
    """The nearest effect that a device with these numbers can play; None where there is none at all."""
    times = _times(min(SPAN * mode.decay_time_s, LONGEST_S), numbers)
    if not len(times.end_s):
        return None
    best: Fit | None = None
    nearest = numbers.period.counts(1.0 / mode.frequency_hz)
    for period in sorted({*range(nearest - 1, nearest + 2)}):
        period_s = numbers.period.quantity(period)
        if not numbers.period.least <= period <= numbers.period.most or period_s <= 0.0:
            continue
        gram, product, power = _products(mode, period_s, times)
        levels = _not_negative(gram, product)
        at = int(np.argmax(np.einsum("ij,ij->i", levels, product)))
        shown = _rounded(levels[at], numbers)
        error = math.sqrt(max(0.0, float(power - 2.0 * shown @ product[at] + shown @ gram[at] @ shown)) / power)
        if best is None or error < best.error:
            best = Fit(
                period=period,
                duration=int(times.duration[at]),
                attack=int(times.attack[at]),
                fade=int(times.fade[at]),
                attack_level=float(shown[0]),
                magnitude=float(shown[1]),
                fade_level=float(shown[2]),
                period_s=period_s,
                duration_s=float(times.end_s[at]),
                error=error,
            )
    return best


def streamed_error(mode: Mode, carried_hz: float) -> float:
    """RMS of the difference over RMS, of a mode that is held for a frame of the link at a time.

    sqrt(2 - 2 sin(h) / h), h = w / (2 rate), is that of a steady sine once its delay is taken off. 1 above 0.4 of the
    rate, where nothing is shown, or something else.
    """
    if mode.frequency_hz > DISPLAYABLE * carried_hz:
        return 1.0
    half = 0.5 * mode.angular_frequency_rad_per_s / carried_hz
    return math.sqrt(max(0.0, 2.0 - 2.0 * math.sin(half) / half))


def _multiples(scale: Scale, longest: float) -> npt.NDArray[np.int64]:
    """Counts of times from nothing to the longest, at most about STEPS of them."""
    first, last = scale.counts(0.0), scale.counts(longest)
    return np.arange(first, last + 1, max(1, round((last - first) / STEPS)))


def _times(longest: float, numbers: Numbers) -> _Times:
    durations, attacks = _multiples(numbers.duration, longest), _multiples(numbers.attack_time, longest)
    duration, attack = (grid.ravel() for grid in np.meshgrid(durations, attacks, indexing="ij"))
    end_s, attack_s = numbers.duration.quantities(duration), numbers.attack_time.quantities(attack)
    fade_time = numbers.fade_time
    # The longest fade that begins after the attack.
    counts = np.floor((end_s - attack_s) * fade_time.counts_per_unit + fade_time.zero_counts + 1e-6)
    fade = np.clip(counts, fade_time.least - 1, fade_time.most).astype(np.int64)
    fade_from_s = np.maximum(end_s - fade_time.quantities(fade), attack_s)
    sound = (end_s > 0.0) & (attack_s >= 0.0) & (attack_s < end_s) & (fade >= fade_time.least)
    return _Times(duration[sound], attack[sound], fade[sound], attack_s[sound], fade_from_s[sound], end_s[sound])


def _products(mode: Mode, period_s: float, times: _Times) -> tuple[_Floats, _Floats, float]:
    """Of what attack level, magnitude and fade level contribute to the effects: their products with each other
    [n][3][3], with the mode [n][3], and the mode's with itself; means over the span.

    Sums up to each sample are made once; every product over a stretch between two knots is a difference of them.
    """
    span_s = SPAN * mode.decay_time_s
    cycles = span_s * max(mode.frequency_hz, 1.0 / period_s)
    count = min(max(_SAMPLES, math.ceil(_PER_CYCLE * cycles)), _MOST_SAMPLES)
    time_s = (np.arange(count) + 0.5) * (span_s / count)
    wanted = np.exp(-mode.decay_rate_per_s * time_s) * np.sin(mode.angular_frequency_rad_per_s * time_s)
    sine = np.sin(2.0 * np.pi * time_s / period_s)
    square, shared = sine * sine, wanted * sine
    parts = (square, time_s * square, time_s * time_s * square, shared, time_s * shared)
    sums = np.array([np.concatenate(([0.0], np.cumsum(part))) for part in parts]) / count

    def between(from_s: _Floats, to_s: _Floats) -> _Floats:
        places = [np.clip(np.rint(at / span_s * count).astype(np.int64), 0, count) for at in (from_s, to_s)]
        found: _Floats = sums[:, places[1]] - sums[:, places[0]]
        return found

    start_s, size = np.zeros_like(times.end_s), len(times.end_s)
    gram, product = np.zeros((size, 3, 3)), np.zeros((size, 3))
    # The magnitude alone, from the attack to the fade.
    flat = between(times.attack_s, times.fade_from_s)
    gram[:, 1, 1] += flat[0]
    product[:, 1] += flat[3]
    # A line from level `first` at u to the next one at v: (v - t) / (v - u) of the one, (t - u) / (v - u) of the other.
    for first, u, v in ((0, start_s, times.attack_s), (1, times.fade_from_s, times.end_s)):
        zero, one, two, with_zero, with_one = between(u, v)
        length = np.where(v > u, v - u, np.inf)
        crossed = ((u + v) * one - u * v * zero - two) / length**2
        gram[:, first, first] += (v * v * zero - 2.0 * v * one + two) / length**2
        gram[:, first + 1, first + 1] += (two - 2.0 * u * one + u * u * zero) / length**2
        gram[:, first, first + 1] += crossed
        gram[:, first + 1, first] += crossed
        product[:, first] += (v * with_zero - with_one) / length
        product[:, first + 1] += (with_one - u * with_zero) / length
    return gram, product, float(wanted @ wanted) / count


def _not_negative(gram: _Floats, product: _Floats) -> _Floats:
    """[n][3]: least squares with no level below zero. The best of the solutions in which some of them are zero."""
    best, gained = np.zeros_like(product), np.zeros(len(product))
    for subset in _SUBSETS:
        rows = list(subset)
        part = gram[:, rows][:, :, rows]
        # What contributes nothing gets nothing.
        ridge = 1e-12 * np.trace(part, axis1=1, axis2=2) + 1e-30
        part = part + ridge[:, None, None] * np.eye(len(rows))
        found = np.linalg.solve(part, product[:, rows, None])[:, :, 0]
        gain = np.einsum("ij,ij->i", found, product[:, rows])
        better = (found >= 0.0).all(axis=1) & (gain > gained)
        gained[better] = gain[better]
        best[better] = 0.0
        best[np.ix_(better, rows)] = found[better]
    return best


def _rounded(levels: _Floats, numbers: Numbers) -> _Floats:
    """The levels as the device has them where the strike is as strong as it can be; weaker ones are coarser."""
    most_n = _most_n(float(levels.max()), numbers)
    scales = (numbers.attack_level, numbers.magnitude, numbers.fade_level)
    shown = [scale.quantity(scale.counts(level * most_n)) for scale, level in zip(scales, levels, strict=True)]
    return np.array(shown) / most_n


def _most_n(peak: float, numbers: Numbers) -> float:
    """The largest coefficient, N, whose largest level every field can hold."""
    return min(scale.largest for scale in (numbers.attack_level, numbers.magnitude, numbers.fade_level)) / max(
        peak, 1e-9
    )


# ---- Which mode has which effect -----------------------------------------------------------------------------------


class EffectUse(NamedTuple):
    """What a mode's record says of the effect that is played in its place."""

    id: int
    peak: float
    """The largest level over the coefficient."""
    duration_s: float


@dataclass(frozen=True, slots=True)
class Offloaded:
    """What became of a tap or a rupture; what is None is not known, as there is no effect."""

    material: str
    mode: str
    frequency_hz: float
    shown_hz: float | None
    period_resolution_s: float | None
    envelope_resolution_s: float | None
    error_percent: float | None
    streamed_error_percent: float
    refused: str | None
    """Why it is streamed; None: the device plays it."""

    def __str__(self) -> str:
        return offload_text(asdict(self))


@dataclass(frozen=True, slots=True)
class _Held:
    id: int
    place: int
    fit: Fit


class Offload:
    """The effects of one connection, and the modes that have them. A mode keeps its effect while something uses it, and
    afterwards until another mode needs the place."""

    def __init__(self, hid: CData) -> None:
        """`hid`: a `struct hd_hid *`."""
        self._hid = hid
        self._lock = threading.Lock()
        self._carried_hz = math.inf
        self._periodic: Periodic | None = None
        self._problem = "the device is not connected"
        self._attached = False
        self._held: dict[Mode, _Held] = {}
        """The longest unused first."""
        self._uses: Counter[Mode] = Counter()
        self._fits: dict[Mode, Fit | None] = {}
        """Of the modes that are used: a fit takes its time, and what asks for the status has none."""
        self._last_id = 0
        self._changed = False
        self.version = 0
        """Raised whenever what `told` says may be another."""

    # ---- The connection's thread ---------------------------------------------------------------------------------

    def attach(self, periodic: Periodic | None, problem: str) -> None:
        """There is a connection, with these effects; without, `problem` says why. The first ones that there are decide
        what modes look like; a device with others plays none."""
        with self._lock:
            known = self._periodic
            if known is None or periodic is None:
                self._problem = problem
            elif (known.numbers, len(known.blocks)) != (periodic.numbers, len(periodic.blocks)):
                periodic, self._problem = None, "the device that is connected now plays other effects"
            self._periodic = periodic if known is None else known if periodic is None else periodic
            self._attached = periodic is not None
            self.version += 1
            self._offer()

    def detach(self) -> None:
        """The connection is about to end."""
        with self._lock:
            self._attached = False
            self._problem = "the device is not connected"
            self.version += 1

    # ---- The thread that changes the scene -----------------------------------------------------------------------

    def judge_by(self, carried_hz: float) -> None:
        """How many forces a second are streamed otherwise."""
        self._carried_hz = carried_hz

    def take(self, mode: Mode) -> EffectUse | None:
        """Something uses this mode from now on: what is played in its place, None if it is streamed."""
        with self._lock:
            if mode not in self._fits and self._periodic is not None:
                self._fits[mode] = fit(mode, self._periodic.numbers)
            denied = self._uses[mode] > 0 and mode not in self._held
            self._uses[mode] += 1
            held = None if denied else self._assign(mode)
            if held is None:
                return None
            return EffectUse(held.id, held.fit.peak, held.fit.duration_s)

    def give(self, mode: Mode) -> None:
        """One thing less uses it."""
        with self._lock:
            self._uses[mode] -= 1
            if not self._uses[mode]:
                del self._uses[mode]
                self._fits.pop(mode, None)

    def settle(self) -> None:
        """The device knows what was taken before this returns."""
        with self._lock:
            if self._changed:
                self._offer()

    def shown_hz(self, mode: Mode) -> float | None:
        """The frequency that the device plays in place of a mode; None where it is streamed."""
        with self._lock:
            held = self._held.get(mode) if self._attached else None
            return None if held is None else held.fit.frequency_hz

    def told(self, materials: Mapping[str, Material]) -> list[Offloaded]:
        """What became of the taps and ruptures of these materials, which are all used."""
        found: list[Offloaded] = []
        for name, material in materials.items():
            if material.tap is not None:
                found.append(self._tell_tap(name, material.tap))
            if material.rupture is not None:
                found.append(self._tell(name, "rupture", material.rupture.mode))
        return found

    def _tell_tap(self, material: str, tap: Tap) -> Offloaded:
        if tap.waveform is not None:
            hertz, why = tap.waveform.middle_hz, "it is a waveform, which no effect plays"
        elif tap.mode_table is not None:
            hertz, why = tap.mode.frequency_hz, "its mode follows the speed, an effect has one"
        else:
            return self._tell(material, "tap", tap.mode)
        streamed = 100.0 * streamed_error(Mode(1.0, 2.0 * math.pi * hertz), self._carried_hz)
        return Offloaded(material, "tap", hertz, None, None, None, None, streamed, why)

    def _tell(self, material: str, use: str, mode: Mode) -> Offloaded:
        with self._lock:
            periodic = self._periodic
            streamed = 100.0 * streamed_error(mode, self._carried_hz)
            if periodic is None:
                return Offloaded(material, use, mode.frequency_hz, None, None, None, None, streamed, self._problem)
            numbers = periodic.numbers
            nearest = self._fits.get(mode)
            refused = _refusal(nearest, mode, self._carried_hz)
            if refused is None and not self._attached:
                refused = self._problem
            if refused is None and mode not in self._held:
                refused = f"the device has no more than {len(periodic.blocks)} effects for this"
            return Offloaded(
                material,
                use,
                mode.frequency_hz,
                nearest.frequency_hz if nearest is not None else None,
                numbers.period.resolution,
                max(scale.resolution for scale in (numbers.duration, numbers.attack_time, numbers.fade_time)),
                None if nearest is None else 100.0 * nearest.error,
                streamed,
                refused,
            )

    # ---- With the lock held --------------------------------------------------------------------------------------

    def _assign(self, mode: Mode) -> _Held | None:
        held = self._held.pop(mode, None)
        if held is None:
            nearest = self._fits.get(mode)
            if self._periodic is None or nearest is None or _refusal(nearest, mode, self._carried_hz) is not None:
                return None
            place = self._free_place(len(self._periodic.blocks))
            if place is None:
                return None
            self._last_id = self._last_id % 0xFFFFFFFF + 1
            held = _Held(self._last_id, place, nearest)
            self._changed = True
            self.version += 1
        self._held[mode] = held
        return held

    def _free_place(self, count: int) -> int | None:
        taken = {held.place for held in self._held.values()}
        for place in range(count):
            if place not in taken:
                return place
        unused = next((mode for mode in self._held if not self._uses[mode]), None)
        return None if unused is None else self._held.pop(unused).place

    def _offer(self) -> None:
        self._changed = False
        if not self._attached or self._periodic is None:
            return
        effects = ffi.new("struct hd_hid_offers *")
        effects.count = len(self._held)
        for into, held in zip(effects.effects, self._held.values(), strict=False):
            _fill_effect(into, held, self._periodic)
        if lib.hd_hid_offer(self._hid, effects) != Status.OK:
            raise HapticdError(f"device.hid.offload: {invalid_reason()}")


def _refusal(nearest: Fit | None, mode: Mode, carried_hz: float) -> str | None:
    """Why a mode is streamed rather than played as its nearest effect."""
    if nearest is None:
        return "no effect of the device is like it"
    if nearest.error > MOST_ERROR:
        return f"the nearest effect is {100 * nearest.error:.2g} % off"
    streamed = streamed_error(mode, carried_hz)
    if nearest.error >= streamed:
        return f"streamed it is nearer, {100 * streamed:.2g} %"
    return None


def _fill_effect(into: CData, held: _Held, periodic: Periodic) -> None:
    numbers, shape = periodic.numbers, held.fit
    for place, message in enumerate(effect_messages(shape, periodic, held.place)):
        fill_message(into.messages[place], message)
    into.message_count = place + 1
    fill_message(into.stop, periodic.blocks[held.place].stop)
    into.id, into.place = held.id, held.place
    into.duration_ns = round(shape.duration_s * 1e9)
    into.most_n = _most_n(shape.peak, numbers)
    # Half a count of the finest level.
    levels = (numbers.attack_level, numbers.magnitude, numbers.fade_level)
    into.least_n = min(0.5 * min(scale.resolution for scale in levels) / max(shape.peak, 1e-9), into.most_n)


def effect_messages(shape: Fit, periodic: Periodic, place: int) -> tuple[Message, ...]:
    """Set Effect, Set Envelope, Set Periodic and the start of one of the device's effects; their force is the mode's
    coefficient as a vector."""
    numbers, block = periodic.numbers, periodic.blocks[place]
    effect, envelope, period = bytearray(block.set_effect.data), bytearray(block.envelope), bytearray(block.periodic)
    numbers.duration.bits.put(effect, shape.duration)
    numbers.attack_time.bits.put(envelope, shape.attack)
    numbers.fade_time.bits.put(envelope, shape.fade)
    numbers.period.bits.put(period, shape.period)
    levels = (_level(numbers.attack_level, shape.attack_level), _level(numbers.fade_level, shape.fade_level))
    return (
        Message(bytes(effect), block.set_effect.values),
        Message(bytes(envelope), levels),
        Message(bytes(period), (_level(numbers.magnitude, shape.magnitude),)),
        block.start,
    )


def _level(scale: Scale, level: float) -> Value:
    counts_per_n = scale.counts_per_unit * level
    return Value(
        scale.bits, HidQuantity.MAGNITUDE, counts_per_n, scale.zero_counts, round(scale.zero_counts), scale.most
    )
