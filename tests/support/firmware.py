"""A simulated firmware of a force feedback device, written from the USB-IF's "Device Class Definition for Physical
Interface Devices" 1.0. It judges the bytes that go out: nothing of it is taken from the product, neither the reading of
the report descriptor nor the places of the numbers nor what effects do.

    stick = Firmware(descriptors.SIDEWINDER_FF2)                  # tests/support/firmware_descriptors.py has the
    known families
    stick = Firmware(descriptors.FINO, FINO)                      # and how such firmware behaves: a Variant
    plan = PidDriver(layout_of(parse(stick.descriptor)), hid).set_up(stick.device)
    stick.now = 0.05                                              # the test drives the time; nothing else does
    x, y = stick.force()                                          # now, as parts of the full force
    x, y = stick.force(0.2)                                       # then, if nothing else is sent; or at any time before

Where it plugs in: `device` is a `hapticd.hid.device.Device`, one end of a SOCK_SEQPACKET pair whose other end a thread
serves: output reports that are written there are taken, and `position` and PID State reports come out of it. `take`,
`set_feature` and `get_feature` are the same without a device. A clock may be given for a host that runs in real time:
`Firmware(..., clock=time.monotonic)`; then `now` is not to be set.

What a test asks: `force`, `reports` (time, kind, bytes), `said` (words, as `set_effect 1`), `sent` (a kind of report),
`read` (a report's numbers by name), `faults` (what a strict device would have refused), `effects`, `enabled`,
`paused_s`, `gain`; `wait` until something holds after a report. What a test does: `now`, `position`, `motion` (where
the handle is, for conditions), `stranger` (another driver resets the device and uploads an effect of its own),
`power_on`, `unplug`, `close`.

x is to the right and y away from the user. By the specification, device coordinates have x to the right and y towards
the user, a direction is where a force comes from, clockwise from the far side ("north"), and a duration of all ones is
without end. Forces are parts of the full force along each axis, limited to it. Times are in s.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from hapticd.hid.plan import DeviceError  # what a Device raises: the interface, no part of the encoding
from tests.support.firmware_effects import CONDITIONS, ENDLESS, Condition, Effect
from tests.support.firmware_reports import AXES, DESKTOP, FEATURE, INPUT, OUTPUT, Form, Place, forms_of, places_of
from tests.support.hid_node import Node


@dataclass(frozen=True)
class Variant:
    """How a firmware differs from the specification, or from others that hold to it."""

    axes: tuple[str, ...] = ("x", "y")
    """Along which it can push."""
    signs: tuple[int, int] = (1, 1)
    """-1: it pushes the other way along x, y."""
    most_effects: int = 40
    first_index: int = 1
    ram: int = 0xFFFF
    effect_ram: int = 16
    """What an effect takes of the pool."""
    simultaneous: int | None = None
    """Effects that play at a time; None: all of them."""
    never_full: bool = False
    """Where there is no room it makes a new effect in the place of the first one, and says success."""
    load_after: int = 0
    """It answers so many times that nothing is loaded yet."""
    refuses: frozenset[str] = frozenset()
    """Kinds of effects that end as an error."""
    pool_frees: bool = False
    """Asked for its pool, it frees all effects: adapt-ffb-joy, Arduino, Fino, BRWheel."""
    pool_stalls: bool = False
    """It does not answer that."""
    pool_says: tuple[int, ...] = ()
    """Simultaneous effects in its first answers; then what is true."""
    takes_unknown: bool = False
    """A report for an effect that was not created goes into its block all the same: Arduino, Fino."""
    keeps_blocks: bool = False
    """A new effect begins with what its block had before, as its envelope."""
    angle_always: bool = False
    """Without Direction Enable, the axes that are enabled get their part of the direction: Arduino, Fino."""
    turn_counts: float | None = None
    """Counts of a turn; None: what the direction's logical range spans, or 36000 where it ends one short."""
    tells: str = "playing"
    """PID State reports: `playing`: about each effect; `flags`: about the device; `nothing`."""
    gain_at_start: float = 1.0
    reset_disables: bool = False
    """A reset leaves the actuators off; by the specification it leaves them on."""
    hand_sensor: bool = False
    """It exerts no force while no hand is on the handle."""
    ready: str = "true"
    """Safety Switch and Actuator Power in PID State: `true`; `never`: always 0; `turned`: 0 for 1 and 1 for 0."""
    dead_band: float = 0.0
    """A smaller part of the full force exerts nothing, a larger one is reduced by it."""


FINO: Final = Variant(pool_frees=True, takes_unknown=True, angle_always=True, tells="nothing", reset_disables=True)
ARDUINO: Final = dataclasses.replace(FINO, signs=(-1, -1))
"""Newer ones pull where older ones push."""
ADAPT: Final = Variant(pool_frees=True, tells="nothing", most_effects=20, effect_ram=16)
OPENFFBOARD: Final = Variant(tells="flags", reset_disables=True)
OPENFFBOARD_1: Final = dataclasses.replace(OPENFFBOARD, axes=("x",))


@dataclass(frozen=True)
class _Moment:
    """Everything that a force depends on, from a time on."""

    t_s: float
    effects: dict[int, Effect]
    enabled: bool
    paused_s: float | None
    """Since when."""
    gain: float


class Firmware(Node):
    """The device."""

    def __init__(
        self, descriptor: bytes, variant: Variant = Variant(), *, clock: Callable[[], float] | None = None
    ) -> None:
        self.descriptor = descriptor
        self.variant = variant
        self.clock = clock
        self.places = places_of(descriptor)
        self.forms = forms_of(self.places)
        self.motion: Callable[[float], tuple[float, float]] = lambda t_s: (0.0, 0.0)
        """Where the handle is, as parts of half its travel, x to the right and y away; for conditions."""
        self.reports: list[tuple[float, str, bytes]] = []
        """Time, kind (output, set, get) and bytes, the id first; of a get what was answered."""
        self.said: list[str] = []
        self.faults: list[str] = []
        self.hand, self.power = not variant.hand_sensor, True
        """Whether a hand is on the handle, and the motors have power."""
        self.stopped = self.locked = False
        """Whether the emergency stop is pressed, and whether the device refuses to enable its actuators."""
        self._now = 0.0
        self._pools = 0
        self._open("firmware")
        self.power_on()

    # ---- Time --------------------------------------------------------------------------------------------------------

    @property
    def now(self) -> float:
        """The time, s; a test sets it, forward only."""
        return self._now if self.clock is None else self.clock()

    @now.setter
    def now(self, t_s: float) -> None:
        assert self.clock is None and t_s >= self._now, "time goes on"
        with self.changed:
            self._now = t_s
            self._settle()

    def power_on(self) -> None:
        """As after it lost its power: no effects, actuators off. Nobody is told."""
        with self.changed:
            self.effects: dict[int, Effect] = {}
            self.memory: dict[int, Effect] = {}
            """What blocks that were freed had."""
            self.enabled = False
            self.paused_s: float | None = None
            self.gain = self.variant.gain_at_start
            self._loaded: tuple[str, int] = ("error", 0)
            self._not_yet = 0
            self._told: dict[int, bool] = {}
            self._moments: list[_Moment] = []
            self._keep()

    def _keep(self) -> None:
        self._moments.append(_Moment(self.now, dict(self.effects), self.enabled, self.paused_s, self.gain))

    # ---- What it shows -----------------------------------------------------------------------------------------------

    def force(self, t_s: float | None = None) -> tuple[float, float]:
        """What it displays at a time, as parts of the full force: x to the right, y away from the user."""
        with self.changed:
            t_s = self.now if t_s is None else t_s
            at = next((moment for moment in reversed(self._moments) if moment.t_s <= t_s), self._moments[0])
            deserted = self.variant.hand_sensor and not self.hand
            if not at.enabled or at.paused_s is not None or deserted or self.stopped or not self.power:
                return 0.0, 0.0
            total = [0.0, 0.0]
            for effect in at.effects.values():
                within = effect.elapsed(t_s)
                if within is not None:
                    for axis, part in enumerate(self._shown(effect, within, t_s)):
                        total[axis] += part * effect.gain * at.gain
            felt = (math.copysign(max(abs(value) - self.variant.dead_band, 0.0), value) for value in total)
            x, y = (min(max(value, -1.0), 1.0) * sign for value, sign in zip(felt, self.variant.signs, strict=True))
            return (x if "x" in self.variant.axes else 0.0), (y if "y" in self.variant.axes else 0.0)

    def _shown(self, effect: Effect, within_s: float, t_s: float) -> tuple[float, float]:
        if effect.kind in CONDITIONS:
            return self._conditioned(effect, t_s)
        level = effect.level(within_s)
        x, y = self._way(effect)
        return level * x, level * y

    def _way(self, effect: Effect) -> tuple[float, float]:
        """Which way a positive level pushes."""
        form = self.forms["set_effect"]
        enabled = float("x" in effect.axes), float("y" in effect.axes)
        if form.directions and form.directions[0].logical[0] < 0 and form.directions[0].usages[0] & ~0xFFFF == DESKTOP:
            length = math.hypot(*effect.direction[:2]) or 1.0
            return effect.direction[0] / length, -effect.direction[1] / length
        if effect.is_directed or (self.variant.angle_always and effect.direction):
            angle = 2.0 * math.pi * effect.direction[0]
            x, y = -math.sin(angle), -math.cos(angle)
            return (x, y) if effect.is_directed else (x * enabled[0], y * enabled[1])
        # Along the axes themselves: y towards the user.
        return enabled[0], -enabled[1]

    def _conditioned(self, effect: Effect, t_s: float) -> tuple[float, float]:
        step = 1e-4
        before, here, after = (self.motion(t_s + k * step) for k in (-1, 0, 1))
        metrics = []
        for axis in (0, 1):
            speed = (after[axis] - before[axis]) / (2.0 * step)
            metrics.append(
                {
                    "spring": here[axis],
                    "damper": speed,
                    "inertia": (after[axis] - 2.0 * here[axis] + before[axis]) / step**2,
                    "friction": math.copysign(1.0, speed) if speed else 0.0,
                }[effect.kind]
            )
        conditions = dict(effect.conditions)
        if set(conditions) == {0} and effect.is_directed:
            x, y = self._way(effect)
            along = conditions[0].force(metrics[0] * x + metrics[1] * y)
            return along * x, along * y
        # Device coordinates have y towards the user.
        return (
            conditions[0].force(metrics[0]) if 0 in conditions else 0.0,
            -conditions[1].force(-metrics[1]) if 1 in conditions else 0.0,
        )

    # ---- What the host says ------------------------------------------------------------------------------------------

    def take(self, report: bytes) -> None:
        """An output report, its id first, 0 where reports have none."""
        with self.changed:
            self._settle()
            self.reports.append((self.now, OUTPUT, bytes(report)))
            form = self._form(OUTPUT, report)
            if form is not None:
                self._obey(form, report[1:])
                self._settle()
                self._keep()
            self.changed.notify_all()

    def set_feature(self, report: bytes) -> None:
        """A feature report, its id first."""
        with self.changed:
            self._settle()
            self.reports.append((self.now, "set", bytes(report)))
            form = self._form(FEATURE, report)
            if form is not None and form.name == "create":
                self._create(str(form.read(report[1:])["chosen"]))
            elif form is not None:
                self._fault(f"feature report {report[0]} is not to be set", report)
            self._keep()
            self.changed.notify_all()

    def get_feature(self, report_id: int, length: int) -> bytes:
        """What it answers, its id first."""
        with self.changed:
            self._settle()
            form = next(
                (form for form in self.forms.values() if (form.kind, form.report) == (FEATURE, report_id)), None
            )
            if form is None or form.name == "create":
                self._fault(f"feature report {report_id} is not to be asked for", b"")
                answer = bytes([report_id]) + bytes(max(length - 1, 0))
            elif form.name == "load":
                answer = self._load(form)
            else:
                answer = self._pool(form)
            self.reports.append((self.now, "get", answer))
            self._keep()
            self.changed.notify_all()
            return answer[:length]

    def read(self, report: bytes) -> tuple[str, dict[str, float | str | bool]]:
        """An output report's name and its numbers as they are, `chosen` being the name of a choice."""
        form = next(form for form in self.forms.values() if (form.kind, form.report) == (OUTPUT, report[0]))
        return form.name, form.read(report[1:])

    def sent(self, name: str) -> list[bytes]:
        """The output reports of a name, in order."""
        report = self.forms[name].report
        return [data for _, kind, data in self.reports if kind == OUTPUT and data[0] == report]

    def _form(self, kind: str, report: bytes) -> Form | None:
        form = next(
            (form for form in self.forms.values() if report and (form.kind, form.report) == (kind, report[0])), None
        )
        if form is None:
            self._fault(f"the descriptor has no such {kind} report", report)
        elif len(report) != form.size + 1:
            self._fault(f"{form.name} of {len(report)} bytes, it has {form.size + 1}", report)
            return None
        else:
            self._judge(form, report)
        return form

    def _judge(self, form: Form, report: bytes) -> None:
        """Notes what is out of its range. All ones are no number: none, or without end. A flag is on whatever its range
        says, as the bits that say which axes there are."""
        for name, place in form.numbers.items():
            number = place.get(report[1:])
            if not (place.logical[0] <= number <= place.logical[1] or number == place.ones or place.bits == 1):
                self._fault(f"{form.name}: {name} {number} is not {place.logical[0]} to {place.logical[1]}", report)
        for place in form.directions:
            number = place.get(report[1:])
            if not place.logical[0] <= number <= place.logical[1]:
                self._fault(f"{form.name}: direction {number}", report)

    def _fault(self, what: str, report: bytes) -> None:
        self.faults.append(f"{what}: {report.hex(' ')}")

    # ---- What it does with it ----------------------------------------------------------------------------------------

    def _obey(self, form: Form, data: bytes) -> None:
        read = form.read(data)
        index = int(read.get("index", 0))
        chosen = str(read["chosen"])
        if form.name == "control":
            self.said.append(chosen or "control")
            for command in chosen.split():
                self._control(command)
            return
        if form.name == "gain":
            self.said.append("gain")
            self.gain = self._share(form, "gain", data)
            return
        self.said.append(" ".join(filter(None, (form.name, chosen if form.name == "operation" else "", str(index)))))
        if index not in self.effects:
            if not self.variant.takes_unknown or not 1 <= index <= self.variant.most_effects:
                self._fault(f"{form.name} of effect {index}, which there is not", bytes([form.report]) + data)
                return
            self.effects[index] = self.memory.get(index, Effect())
        effect = self.effects[index]
        match form.name:
            case "operation":
                self._operate(index, chosen, int(read.get("loops", 1)))
            case "block_free":
                self.memory[index] = dataclasses.replace(self.effects.pop(index), started_s=None)
            case _:
                self.effects[index] = dataclasses.replace(effect, **self._numbers(form, data, effect))

    def _numbers(self, form: Form, data: bytes, effect: Effect) -> dict[str, object]:
        """What a report of an effect's numbers changes."""
        read = form.read(data)
        match form.name:
            case "set_effect":
                return {
                    "kind": str(read["chosen"]),
                    "is_set": True,
                    "duration_s": self._time(form, "duration", data),
                    "delay_s": self._time(form, "start_delay", data),
                    "gain": self._share(form, "gain", data) if "gain" in form.numbers else 1.0,
                    "axes": tuple(str(read.get("axes", "")).split()),
                    "is_directed": bool(read.get("direction_enable", 0)),
                    "direction": tuple(self._turns(place, place.get(data)) for place in form.directions),
                }
            case "envelope":
                return {
                    "attack_level": self._share(form, "attack_level", data),
                    "attack_s": self._time(form, "attack_time", data),
                    "fade_level": self._share(form, "fade_level", data),
                    "fade_s": self._time(form, "fade_time", data),
                }
            case "constant_force":
                return {"magnitude": self._share(form, "magnitude", data)}
            case "periodic":
                phase = form.numbers.get("phase")
                return {
                    "magnitude": self._share(form, "magnitude", data),
                    "offset": self._share(form, "offset", data),
                    "phase": self._turns(phase, phase.get(data)) if phase is not None else 0.0,
                    "period_s": self._time(form, "period", data),
                }
            case "ramp":
                return {"ramp": (self._share(form, "ramp_start", data), self._share(form, "ramp_end", data))}
            case "condition":
                names = [each.name for each in dataclasses.fields(Condition) if each.name in form.numbers]
                made = Condition(**{name: self._share(form, name, data) for name in names})
                if "negative_coefficient" not in names:
                    made = dataclasses.replace(made, negative_coefficient=made.positive_coefficient)
                return {"conditions": tuple((dict(effect.conditions) | {int(read.get("block", 0)): made}).items())}
            case _:
                return {}

    def _share(self, form: Form, name: str, data: bytes) -> float:
        """A level, as part of the largest."""
        place = form.numbers.get(name)
        return 0.0 if place is None else place.get(data) / place.logical[1]

    def _time(self, form: Form, name: str, data: bytes) -> float:
        """A time in the descriptor's unit, or in ms where it names none."""
        place = form.numbers.get(name)
        if place is None:
            return 0.0
        number = place.get(data)
        if name == "duration" and (number == place.ones or number > place.logical[1]):
            return ENDLESS
        return number * (10.0**place.exponent if place.unit in (0x1001, 0x1003) else 1e-3)

    def _turns(self, place: Place, number: int) -> float:
        """A direction or a phase."""
        if place.usages[0] & ~0xFFFF == DESKTOP:
            return float(number)
        span = float(place.logical[1] - place.logical[0])
        return number / (self.variant.turn_counts or (36000.0 if span == 35999.0 else span))

    def _operate(self, index: int, chosen: str, loops: int) -> None:
        if chosen == "stop":
            self.effects[index] = dataclasses.replace(self.effects[index], started_s=None)
        elif chosen in ("start", "start_solo"):
            if chosen == "start_solo":
                self._stop_all()
            others = sum(effect.started_s is not None for other, effect in self.effects.items() if other != index)
            most = self.variant.simultaneous
            if most is not None and others >= most:
                return
            times = ENDLESS if loops == 255 else float(max(loops, 1))
            self.effects[index] = dataclasses.replace(self.effects[index], started_s=self.now, loops=times)

    def _stop_all(self) -> None:
        for index, effect in self.effects.items():
            self.effects[index] = dataclasses.replace(effect, started_s=None)

    def _free_all(self) -> None:
        self._stop_all()
        self._tell_playing()
        self.memory |= self.effects
        self.effects.clear()

    def _control(self, command: str) -> None:
        match command:
            case "enable_actuators" | "disable_actuators":
                self.enabled = command == "enable_actuators" and not self.locked
            case "stop_all_effects":
                self._stop_all()
            case "device_reset":
                self._free_all()
                self.enabled, self.paused_s = not self.variant.reset_disables and not self.locked, None
            case "device_pause":
                self.paused_s = self.now if self.paused_s is None else self.paused_s
            case "device_continue" if self.paused_s is not None:
                held = self.now - self.paused_s
                for index, effect in self.effects.items():
                    if effect.started_s is not None:
                        self.effects[index] = dataclasses.replace(effect, started_s=effect.started_s + held)
                self.paused_s = None
        self._tell(0)

    def _create(self, kind: str) -> None:
        self.said.append(f"create {kind}")
        self._not_yet = self.variant.load_after
        end = self.variant.first_index + self.variant.most_effects
        free = next((n for n in range(self.variant.first_index, end) if n not in self.effects), None)
        if free is None and self.variant.never_full:
            free = self.variant.first_index
        if not kind or kind in self.variant.refuses:
            self._loaded = ("error", 0)
        elif free is None or self._ram_left() < self.variant.effect_ram:
            self._loaded = ("full", 0)
        else:
            self._loaded = ("success", free)
            kept = self.memory.get(free, Effect()) if self.variant.keeps_blocks else Effect()
            self.effects[free] = dataclasses.replace(kept, kind=kind, is_set=False, started_s=None)

    def _ram_left(self) -> int:
        return self.variant.ram - self.variant.effect_ram * len(self.effects)

    def _load(self, form: Form) -> bytes:
        self.said.append("load")
        status, index = self._loaded
        if self._not_yet > 0:
            self._not_yet -= 1
            return form.write()
        return form.write(status, index=index, ram_pool_available=self._ram_left())

    def _pool(self, form: Form) -> bytes:
        self.said.append("pool")
        self._pools += 1
        if self.variant.pool_frees:
            self._free_all()
        if self.variant.pool_stalls:
            self.reports.append((self.now, "get", b""))
            raise DeviceError(f"firmware: cannot get feature report {form.report}: Broken pipe")
        said = self.variant.pool_says[self._pools - 1 : self._pools]
        true = self.variant.most_effects if self.variant.simultaneous is None else self.variant.simultaneous
        return form.write(
            ram_pool_size=self.variant.ram,
            simultaneous_effects_max=(said or (true,))[0],
            device_managed=1,
            shared_blocks=0,
        )

    # ---- What it says ------------------------------------------------------------------------------------------------

    def _settle(self) -> None:
        """Ends what has ended by itself, and tells it."""
        for index, effect in self.effects.items():
            if effect.started_s is not None and self.paused_s is None:
                once = effect.delay_s + effect.duration_s
                if effect.is_set and self.now - effect.started_s >= once * effect.loops:
                    self.effects[index] = dataclasses.replace(effect, started_s=None)
        self._tell_playing()

    def _tell_playing(self) -> None:
        for index, effect in self.effects.items():
            playing = effect.started_s is not None
            if self._told.get(index, False) != playing:
                self._told[index] = playing
                if self.variant.tells == "playing":
                    self._tell(index)

    def _tell(self, index: int) -> None:
        """A PID State report, about one effect or none."""
        form = self.forms.get("state")
        if form is None or self.variant.tells == "nothing":
            return
        ready = {"safety_switch": self.hand, "power": self.power}
        told = {
            name: 0 if self.variant.ready == "never" else on == (self.variant.ready == "true")
            for name, on in ready.items()
        }
        flags = {"enabled": self.enabled, "paused": self.paused_s is not None, **told}
        playing = index in self.effects and self.effects[index].started_s is not None
        self._send(form.write(**{name: int(on) for name, on in flags.items()}, index=index, playing=int(playing)))

    def position(self, x: float, y: float) -> None:
        """An input report: where the handle is, as parts of half its travel, x to the right and y away."""
        inputs = [place for place in self.places if place.kind == INPUT and not place.is_array and place.usages]
        axes: dict[str, Place] = {}
        for place in inputs:
            if place.usages[0] & ~0xFFFF == DESKTOP and place.usages[0] & 0xFFFF in AXES:
                axes.setdefault(AXES[place.usages[0] & 0xFFFF], place)
        for report in {place.report for name, place in axes.items() if name in ("x", "y")}:
            ends = [p.at + p.bits for p in self.places if p.kind == INPUT and p.report == report]
            data = bytearray((max(ends) + 7) // 8)
            for name, place in axes.items():
                share = {"x": x, "y": -y}.get(name, 0.0)
                low, high = place.logical
                if place.report == report:
                    place.put(data, round(low + (high - low) * (share + 1.0) / 2.0))
            self._send(bytes([report, *data]))

    # ---- What a test does --------------------------------------------------------------------------------------------

    def becomes(self, **states: bool) -> None:
        """Sets `hand`, `power`, `enabled` or `locked`, and tells it."""
        with self.changed:
            for name, state in states.items():
                setattr(self, name, state)
            self._keep()
            self._tell(0)

    def stranger(
        self, *, turns: float = 0.0, magnitude: float = 0.0, duration_ms: int = 1000, resets: bool = True
    ) -> int:
        """Another driver uploads a constant force from a direction and plays it, as hid-pidff does for a game: first it
        resets the device and enables it. The block that it got, 0: none. Firmware that counts its blocks from the first
        one again gives it one that was somebody else's."""
        before = len(self.faults)
        if resets:
            for command in ("device_reset", "enable_actuators"):
                self.take(self.forms["control"].write(command))
        self.set_feature(self.forms["create"].write("constant_force"))
        load = self.forms["load"]
        index = load.numbers["index"].get(self.get_feature(load.report, load.size + 1)[1:])
        if index:
            effect, force = self.forms["set_effect"], self.forms["constant_force"]
            angle = effect.directions[0].logical if effect.directions else (0, 0)
            numbers = {"index": index, "duration": duration_ms, "direction_enable": 1}
            if "gain" in effect.numbers:
                numbers["gain"] = effect.numbers["gain"].logical[1]
            report = bytearray(
                effect.write("constant_force", **numbers, direction=round(angle[0] + turns * (angle[1] - angle[0])))
            )
            body = bytearray(report[1:])
            for place in effect.axes.values():
                place.put(body, 1)
            self.take(bytes([report[0], *body]))
            most = force.numbers["magnitude"].logical[1]
            self.take(force.write(index=index, magnitude=round(magnitude * most)))
            self.take(self.forms["operation"].write("start", index=index, loops=1))
        del self.faults[before:]
        return index

    def _words(self) -> list[str]:
        return self.said

    def __enter__(self) -> Firmware:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
