"""Assigns device effects to modes, and reports for each tap and rupture whether the device plays it.

A mode without an effect is streamed: hapticd computes it and sends it as part of the force. nearest_effect.py finds the
nearest effect to a mode. Two threads use `Offload`: the one that changes the scene, and the connection's.
"""

from __future__ import annotations

import math
import threading
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

from hapticd.base.core import CData, HidQuantity, Status, ffi, invalid_reason, lib
from hapticd.base.errors import HapticdError
from hapticd.config.materials import Material, Tap
from hapticd.config.modes import Mode
from hapticd.hid.nearest_effect import NearestEffect, max_coefficient_n, nearest_effect, streamed_error
from hapticd.hid.plan import Message, Periodic, Scale, Value

MAX_EFFECT_ERROR: Final = 0.2
"""Largest relative RMS error of an effect that replaces a mode; a mode with a larger one is streamed."""


class EffectUse(NamedTuple):
    """The device effect that is played in place of a mode."""

    id: int
    peak: float
    """Largest level of the effect's envelope, as a multiple of the mode's initial amplitude (its coefficient)."""
    duration_s: float


@dataclass(frozen=True, slots=True)
class Offloaded:
    """Whether and how the device plays a tap or rupture of a material. Without an effect, its properties are None."""

    material: str
    mode: str
    frequency_hz: float
    shown_hz: float | None
    period_resolution_s: float | None
    envelope_resolution_s: float | None
    error_percent: float | None
    streamed_error_percent: float
    refused: str | None
    """Why the mode is streamed; None if the device plays it."""


@dataclass(frozen=True, slots=True)
class _AssignedEffect:
    id: int
    place: int
    """Index of the device's effect in `Periodic.blocks`."""
    effect: NearestEffect


class Offload:
    """The device effects of one connection, and the modes that they are assigned to.

    A mode keeps its effect while it is used, and afterwards until another mode needs it.
    """

    def __init__(self, hid: CData) -> None:
        """Create the assignment for a connection, a `struct hd_hid *`."""
        self._hid = hid
        self._lock = threading.Lock()
        self._carried_hz = math.inf
        self._periodic: Periodic | None = None
        self._problem = "the device is not connected"
        self._attached = False
        self._held: dict[Mode, _AssignedEffect] = {}
        """Assigned effects; the one that was taken longest ago is first."""
        self._uses: Counter[Mode] = Counter()
        self._nearest: dict[Mode, NearestEffect | None] = {}
        """Nearest effects of the used modes, cached, because finding one takes too long for a request of the status."""
        self._last_id = 0
        self._changed = False
        self.version = 0
        """Incremented whenever the result of `outcomes` may change."""

    # ---- The connection's thread ---------------------------------------------------------------------------------

    def attach(self, periodic: Periodic | None, problem: str) -> None:
        """Use the effects of a new connection; without effects, `problem` says why.

        The first device with effects determines the effects of all modes. A device connected later plays effects only
        if it has as many effects, with the same fields.
        """
        with self._lock:
            known = self._periodic
            if known is None or periodic is None:
                self._problem = problem
            elif (known.scales, len(known.blocks)) != (periodic.scales, len(periodic.blocks)):
                periodic, self._problem = None, "the device that is connected now has other effects"
            self._periodic = periodic if known is None else known if periodic is None else periodic
            self._attached = periodic is not None
            self.version += 1
            self._offer()

    def detach(self) -> None:
        """Stop using the device's effects, because the connection is about to end."""
        with self._lock:
            self._attached = False
            self._problem = "the device is not connected"
            self.version += 1

    # ---- The thread that changes the scene -----------------------------------------------------------------------

    def set_carried(self, carried_hz: float) -> None:
        """Set the rate at which forces reach the device, in Hz, on which the error of a streamed mode depends."""
        self._carried_hz = carried_hz

    def take(self, mode: Mode) -> EffectUse | None:
        """Register a use of a mode, and return the device effect played in its place; None if the mode is streamed."""
        with self._lock:
            if mode not in self._nearest and self._periodic is not None:
                self._nearest[mode] = nearest_effect(mode, self._periodic.scales)
            denied = self._uses[mode] > 0 and mode not in self._held
            self._uses[mode] += 1
            held = None if denied else self._assign(mode)
            if held is None:
                return None
            return EffectUse(held.id, held.effect.peak, held.effect.duration_s)

    def give(self, mode: Mode) -> None:
        """Remove one use of a mode, which `take` has registered."""
        with self._lock:
            self._uses[mode] -= 1
            if not self._uses[mode]:
                del self._uses[mode]
                self._nearest.pop(mode, None)

    def settle(self) -> None:
        """Pass all assigned effects to C, which uploads them to the device, if `take` has assigned a new one."""
        with self._lock:
            if self._changed:
                self._offer()

    def shown_hz(self, mode: Mode) -> float | None:
        """Return the frequency that the device plays in place of a mode, in Hz; None if the mode is streamed."""
        with self._lock:
            held = self._held.get(mode) if self._attached else None
            return None if held is None else held.effect.frequency_hz

    def outcomes(self, materials: Mapping[str, Material]) -> list[Offloaded]:
        """Return whether the device plays each tap and rupture of these materials; `take` must have registered them."""
        found: list[Offloaded] = []
        for name, material in materials.items():
            if material.tap is not None:
                found.append(self._outcome_of_tap(name, material.tap))
            if material.rupture is not None:
                found.append(self._outcome(name, "rupture", material.rupture.mode))
        return found

    def _outcome_of_tap(self, material: str, tap: Tap) -> Offloaded:
        if tap.waveform is not None:
            hertz, why = tap.waveform.curve.middle_hz, "it is a waveform, which no effect can play"
        elif tap.mode_table is not None:
            hertz, why = tap.mode.frequency_hz, "its mode depends on the speed, an effect has a fixed mode"
        else:
            return self._outcome(material, "tap", tap.mode)
        streamed = 100.0 * streamed_error(Mode(1.0, 2.0 * math.pi * hertz), self._carried_hz)
        return Offloaded(material, "tap", hertz, None, None, None, None, streamed, why)

    def _outcome(self, material: str, use: str, mode: Mode) -> Offloaded:
        with self._lock:
            periodic = self._periodic
            streamed = 100.0 * streamed_error(mode, self._carried_hz)
            if periodic is None:
                return Offloaded(material, use, mode.frequency_hz, None, None, None, None, streamed, self._problem)
            scales = periodic.scales
            nearest = self._nearest.get(mode)
            refused = _refusal_reason(nearest, mode, self._carried_hz)
            if refused is None and not self._attached:
                refused = self._problem
            if refused is None and mode not in self._held:
                refused = f"all {len(periodic.blocks)} effects of the device are assigned to other modes"
            return Offloaded(
                material,
                use,
                mode.frequency_hz,
                nearest.frequency_hz if nearest is not None else None,
                scales.period.resolution,
                max(scale.resolution for scale in (scales.duration, scales.attack_time, scales.fade_time)),
                None if nearest is None else 100.0 * nearest.error,
                streamed,
                refused,
            )

    # ---- With the lock held --------------------------------------------------------------------------------------

    def _assign(self, mode: Mode) -> _AssignedEffect | None:
        held = self._held.pop(mode, None)
        if held is None:
            nearest = self._nearest.get(mode)
            if self._periodic is None or _refusal_reason(nearest, mode, self._carried_hz) is not None:
                return None
            assert nearest is not None
            place = self._free_place(len(self._periodic.blocks))
            if place is None:
                return None
            self._last_id = self._last_id % 0xFFFFFFFF + 1
            held = _AssignedEffect(self._last_id, place, nearest)
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
        held = [_for_c(each, self._periodic) for each in self._held.values()]
        effects = ffi.new("struct hd_device_effects *", {"count": len(held), "effects": held})
        if lib.hd_hid_set_effects(self._hid, effects) != Status.OK:
            raise HapticdError(f"device.hid.offload: {invalid_reason()}")


def _refusal_reason(nearest: NearestEffect | None, mode: Mode, carried_hz: float) -> str | None:
    """Return why a mode is streamed rather than played as its nearest effect; None if it is played."""
    if nearest is None:
        return "the device can play no effect"
    if nearest.error > MAX_EFFECT_ERROR:
        return f"the nearest effect is {100 * nearest.error:.2g} % off"
    streamed = streamed_error(mode, carried_hz)
    if nearest.error >= streamed:
        return f"streaming is more accurate, {100 * streamed:.2g} % off"
    return None


def _for_c(held: _AssignedEffect, periodic: Periodic) -> dict[str, object]:
    """Return an assigned effect as the members of C's `struct hd_device_effect`."""
    scales, shape = periodic.scales, held.effect
    messages = [message.for_c() for message in effect_messages(shape, periodic, held.place)]
    largest_n = max_coefficient_n(shape.peak, scales)
    finest_n = min(level.resolution for level in scales.levels)
    return {
        "id": held.id,
        "place": held.place,
        "message_count": len(messages),
        "duration_ns": round(shape.duration_s * 1e9),
        # Coefficient whose level is half a count of the finest field.
        "least_n": min(0.5 * finest_n / max(shape.peak, 1e-9), largest_n),
        "most_n": largest_n,
        "messages": messages,
        "stop": periodic.blocks[held.place].stop.for_c(),
    }


def effect_messages(shape: NearestEffect, periodic: Periodic, place: int) -> tuple[Message, ...]:
    """Return the messages that play the effect `shape` in `periodic.blocks[place]`, the last of which starts it.

    They are Set Effect, Set Envelope, Set Periodic and Effect Operation. The force that C writes into them is the
    mode's initial amplitude (its coefficient) as a vector.
    """
    scales, block = periodic.scales, periodic.blocks[place]
    effect, envelope, period = bytearray(block.set_effect.data), bytearray(block.envelope), bytearray(block.periodic)
    scales.duration.bits.put(effect, shape.duration)
    scales.attack_time.bits.put(envelope, shape.attack)
    scales.fade_time.bits.put(envelope, shape.fade)
    scales.period.bits.put(period, shape.period)
    levels = (_level(scales.attack_level, shape.attack_level), _level(scales.fade_level, shape.fade_level))
    return (
        Message(bytes(effect), block.set_effect.values),
        Message(bytes(envelope), levels),
        Message(bytes(period), (_level(scales.magnitude, shape.magnitude),)),
        block.start,
    )


def _level(scale: Scale, level: float) -> Value:
    counts_per_n = scale.counts_per_unit * level
    return Value(
        scale.bits, HidQuantity.MAGNITUDE, counts_per_n, scale.zero_counts, round(scale.zero_counts), scale.max_counts
    )
