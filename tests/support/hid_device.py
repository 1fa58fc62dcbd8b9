"""A joystick for tests that speaks PID (tests/support/hid_node.py: how the code under test opens it).

It is a state machine of its own: it reads output and feature reports by its own layout, keeps effects, and
says what force it would display. Nothing is timed; its effects do not expire by themselves.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from hapticd.hid.descriptor.fields import Choice, Field
from hapticd.hid.descriptor.layout import Layout, layout_of
from hapticd.hid.descriptor.parser import parse
from hapticd.hid.plan import Bits
from tests.support.hid_node import Node


def number(report: bytes, place: Field) -> int:
    return Bits(place.bit_offset, place.bit_size, place.is_signed).get(report)


def chosen(report: bytes, choice: Choice) -> list[str]:
    """The names that a report chooses."""
    return [name for name, entry in choice.entries.items() if number(report, entry.field) == entry.value]


@dataclass
class Effect:
    """What the device knows of one effect."""

    kind: str = "constant_force"
    set_effect: bytes = b""
    magnitude: int = 0
    envelope: bytes = b""
    periodic: bytes = b""
    playing: bool = False


@dataclass(frozen=True)
class Strike:
    """A periodic effect as it was when it was started."""

    index: int
    set_effect: bytes
    envelope: bytes
    periodic: bytes


@dataclass
class FakePid(Node):
    """The device."""

    descriptor: bytes
    room: int = 16
    """Effects that it has room for."""
    first_index: int = 1
    load_says: str | None = None
    answers_as: int | None = None
    """The report id in its answers to feature reports; None: the right one."""
    tells_playing: bool = True
    """It reports when an effect begins or ends to play."""
    on_log: Callable[[str], None] = lambda _: None
    log: list[str] = field(default_factory=list)
    """Names of the reports received, in order, as `operation start 1`."""
    effects: dict[int, Effect] = field(default_factory=dict)
    strikes: list[Strike] = field(default_factory=list)
    """Periodic effects that were started, in order."""
    enabled: bool = False

    def __post_init__(self) -> None:
        self.layout: Layout = layout_of(parse(self.descriptor))
        self.loaded = 0
        self._open("fake0")

    # ---- What the code under test calls ------------------------------------------------------------------------------

    def take(self, report: bytes) -> None:
        with self.changed:
            self._take(report)
            self.changed.notify_all()

    def _take(self, report: bytes) -> None:
        parts = self.layout
        assert parts.device_control and parts.set_effect and parts.constant_force and parts.effect_operation
        match report[0]:
            case parts.device_control.report_id:
                for name in chosen(report, parts.device_control.command):
                    self._note(name)
                    if name == "device_reset":
                        self._forget()
                        self._enable(False)
                    elif name in ("enable_actuators", "disable_actuators"):
                        self._enable(name == "enable_actuators")
                    elif name == "stop_all_effects":
                        for index in self.effects:
                            self._play(index, False)
            case parts.set_effect.report_id:
                index = number(report, parts.set_effect.effect_index)
                self._note(f"set_effect {index}")
                self._of(index).set_effect = report
            case parts.constant_force.report_id:
                index = number(report, parts.constant_force.effect_index)
                self._note(f"constant_force {index}")
                self._of(index).magnitude = number(report, parts.constant_force.magnitude)
            case parts.effect_operation.report_id:
                index = number(report, parts.effect_operation.effect_index)
                for name in chosen(report, parts.effect_operation.operation):
                    effect = self._of(index)
                    if effect.kind == "sine" and name != "stop":
                        assert chosen(effect.set_effect, parts.set_effect.effect_type) == ["sine"]
                        self.strikes.append(Strike(index, effect.set_effect, effect.envelope, effect.periodic))
                    self._note(f"operation {name} {index}")
                    self._play(index, name != "stop")
            case _ if parts.set_periodic and report[0] == parts.set_periodic.report_id:
                index = number(report, parts.set_periodic.effect_index)
                self._note(f"periodic {index}")
                self._of(index).periodic = report
            case _ if parts.set_envelope and report[0] == parts.set_envelope.report_id:
                index = number(report, parts.set_envelope.effect_index)
                self._note(f"envelope {index}")
                self._of(index).envelope = report
            case _ if parts.block_free and report[0] == parts.block_free.report_id:
                index = number(report, parts.block_free.effect_index)
                self._note(f"block_free {index}")
                self._play(index, False)
                self.effects.pop(index, None)
            case _ if parts.device_gain and report[0] == parts.device_gain.report_id:
                self._note(f"gain {number(report, parts.device_gain.gain)}")
            case _:
                self._note(f"unknown {report.hex()}")

    def _play(self, index: int, playing: bool) -> None:
        effect = self._of(index)
        if effect.playing != playing:
            effect.playing = playing
            if self.tells_playing and index in self.effects:
                self._tell(index)

    def _forget(self) -> None:
        for index in self.effects:
            self._play(index, False)
        self.effects.clear()

    def _of(self, index: int) -> Effect:
        # A report for an effect that does not exist is heard and ignored.
        return self.effects.get(index, Effect())

    def _words(self) -> list[str]:
        return self.log

    def _note(self, text: str) -> None:
        self.log.append(text)
        self.on_log(text)

    def set_feature(self, report: bytes) -> None:
        create = self.layout.create_new_effect
        assert create is not None and report[0] == create.report_id and len(report) == create.report_bytes
        (kind,) = chosen(report, create.effect_type)
        assert kind in ("constant_force", "sine")
        with self.changed:
            self._note("create" if kind == "constant_force" else f"create {kind}")
            self.loaded = 0
            if len(self.effects) < self.room:
                self.loaded = next(n for n in range(self.first_index, 999) if n not in self.effects)
                self.effects[self.loaded] = Effect(kind)

    def get_feature(self, report_id: int, length: int) -> bytes:
        load, pool = self.layout.block_load, self.layout.pool
        report = bytearray(length)
        report[0] = report_id if self.answers_as is None else self.answers_as
        if load is not None and report_id == load.report_id:
            assert length == load.report_bytes
            self._note("load")
            status = self.load_says or ("success" if self.loaded else "full")
            _put(report, load.effect_index, self.loaded)
            if load.status is not None:
                entry = load.status.entries[status]
                _put(report, entry.field, entry.value)
        elif pool is not None and report_id == pool.report_id:
            self._note("pool")
            if pool.simultaneous_effects_max is not None:
                _put(report, pool.simultaneous_effects_max, min(self.room, 255))
        return bytes(report)

    # ---- What a test does --------------------------------------------------------------------------------------------

    def report(self, x: int, y: int, **states: bool) -> None:
        """Sends an input report with these counts."""
        for axis in {axis.field.report_id: axis for axis in self.layout.input.values()}.values():
            data = bytearray(axis.report_bytes + (axis.field.report_id == 0))
            data[0] = axis.field.report_id
            for name, counts in (("x", x), ("y", y)):
                if name in self.layout.input and self.layout.input[name].field.report_id == data[0]:
                    _put(data, self.layout.input[name].field, counts)
            self._send(bytes(data))

    def reset(self, *, enabled: bool = False) -> None:
        """Somebody else resets it, and it has its actuators on or off then."""
        with self.changed:
            self.log.clear()
            self._forget()
            self._enable(enabled)

    def _enable(self, enabled: bool) -> None:
        """Actuators on or off, which a PID State report tells."""
        self.enabled = enabled
        self._tell(0)

    def _tell(self, index: int) -> None:
        """A PID State report, about one effect or none."""
        state = self.layout.pid_state
        if state is not None and state.actuators_enabled is not None:
            data = bytearray(state.report_bytes)
            data[0] = state.report_id
            _put(data, state.actuators_enabled, int(self.enabled))
            for ready in (state.safety_switch, state.actuator_power):
                if ready is not None:
                    _put(data, ready, 1)
            place = state.effect_index
            if place is not None and state.effect_playing is not None and index <= place.logical_max:
                _put(data, place, index)
                _put(data, state.effect_playing, int(self._of(index).playing))
            self._send(bytes(data))

    def force(self) -> tuple[float, float]:
        """What it displays, as parts of its largest magnitude, [x, y]: by the specification, a force comes from its
        direction, which is counted clockwise from the north."""
        with self.changed:
            return self._force()

    def _force(self) -> tuple[float, float]:
        effect_to, force_to = self.layout.set_effect, self.layout.constant_force
        assert effect_to is not None and force_to is not None
        x = y = 0.0
        for effect in self.effects.values() if self.enabled else ():
            if not effect.playing or not effect.set_effect or effect.kind != "constant_force":
                continue
            size = effect.magnitude / force_to.magnitude.logical_max
            if effect_to.direction_enable is not None and number(effect.set_effect, effect_to.direction_enable):
                place = effect_to.direction[0]
                turns = _turns(number(effect.set_effect, place), place)
                x -= size * math.sin(2 * math.pi * turns)
                y -= size * math.cos(2 * math.pi * turns)
            else:
                enabled = {name for name, bit in effect_to.axes_enable.items() if number(effect.set_effect, bit)}
                x += size * ("x" in enabled)
                y += size * ("y" in enabled)
        return x, y

    def shown(self, strike: Strike, time_s: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """What a periodic effect does after its start, as parts of the largest magnitude, (n, 2) [x, y]: a sine within
        the lines of its envelope, by the specification and by this device's own reading of its times."""
        effect_to, lines, wave = self.layout.set_effect, self.layout.set_envelope, self.layout.set_periodic
        assert effect_to is not None and lines is not None and wave is not None
        assert wave.phase is not None and number(strike.periodic, wave.phase) == 0
        assert wave.offset is not None and number(strike.periodic, wave.offset) == 0
        end_s = _seconds(strike.set_effect, effect_to.duration)
        attack_s, fade_s = _seconds(strike.envelope, lines.attack_time), _seconds(strike.envelope, lines.fade_time)
        assert attack_s + fade_s <= end_s + 1e-9 and end_s <= 0.1
        parts = (
            (strike.envelope, lines.attack_level),
            (strike.periodic, wave.magnitude),
            (strike.envelope, lines.fade_level),
        )
        first, middle, last = (number(report, place) / place.logical_max for report, place in parts)
        level = np.full(len(time_s), middle)
        if attack_s > 0.0:
            rising = time_s < attack_s
            level[rising] = first + (middle - first) * time_s[rising] / attack_s
        if fade_s > 0.0:
            falling = time_s > end_s - fade_s
            level[falling] = middle + (last - middle) * (time_s[falling] - end_s + fade_s) / fade_s
        level[time_s > end_s] = 0.0
        value = level * np.sin(2 * np.pi * time_s / _seconds(strike.periodic, wave.period))
        place = effect_to.direction[0]
        angle = 2 * math.pi * _turns(number(strike.set_effect, place), place)
        return np.outer(value, [-math.sin(angle), -math.cos(angle)])


def _turns(counts: int, place: Field) -> float:
    """A direction, by the specification: counts are interpolated between the ends of the physical range, in 0.01 of a
    degree in every descriptor here, or in degrees where it names none."""
    share = (counts - place.logical_min) / (place.logical_max - place.logical_min)
    physical = place.physical_min + share * (place.physical_max - place.physical_min)
    if place.unit == 0x14:
        return physical / 36000
    return physical / (place.physical_max - place.physical_min)


def _seconds(report: bytes, place: Field) -> float:
    """A time in counts of 10^exponent s; of 1 ms where the descriptor has no unit for it."""
    return number(report, place) * (10.0**place.unit_exponent if place.unit else 1e-3)


def _put(report: bytearray, place: Field, counts: int) -> None:
    Bits(place.bit_offset, place.bit_size, place.is_signed).put(report, counts)
