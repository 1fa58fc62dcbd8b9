"""Random changes of every kind at a real daemon, under a simulated hand that presses, strokes and lets ring; and the
rule of csrc/tick/hd_ramp.h, looked at in every tick that was recorded meanwhile.

    python -m tests.soak.torture_live [--ticks 10000000] [--changes 50000] [--seed 0] [--rate 10000]

Daemons of a million ticks follow each other, so that no recording is larger than memory; each has its own seed, and
what it recorded is looked at before the next one starts. Changes come in bursts, as fast as the daemon answers, and on
average as often as ticks and changes say: 50 a second.

What a command does in a tick is the force of the tick, less that of the same tick with the scene from before and every
ramp standing still. It is at most max_force_n / ramp_s, for the periods since the tick before. The second force comes
from rendering the recording again, twice: as it was, and from a copy of the state.

A tick that takes a command is looked at twice. First with the hand where it was in the tick before, as
tests/c/test_ramp.c does it: there the servo knows exactly what the scene from before would do, and the rule holds as it
stands. Then as the hand went on: what the scene from before makes of that way the servo knows to the first order, and a
noise that ends keeps the level of its last sample. So the force is compared with all that lies between the tick before
and the scene from before, in contact and vibration each, and up to MOVING is allowed.

Left out are ticks in which a contact has a ramp that no command is the reason of (after a jump, a stall, a start, or
where solids overlap), and ticks with a command in which the scene from before by itself meets, leaves or strikes
something. The tests do a few hundred changes; `make torture` does many.
"""

from __future__ import annotations

import argparse
import random
import shutil
import tempfile
import threading
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final
from unittest.mock import patch

import numpy as np
import numpy.typing as npt
import yaml

import hapticd
from hapticd.base.core import EVENT_DTYPE, SAMPLE_DTYPE, EventKind, Flag, Status, ffi, lib, pointer, records
from hapticd.config.materials import Material
from hapticd.config.scene import Scene
from hapticd.recording import replay
from hapticd.recording.reader import Samples
from hapticd.rendering.device_output import Output
from hapticd.rendering.offline import Rerun, new_world
from tests.support.daemon_process import connect, running_daemon

LIMIT_N: Final = 8.9
ROUNDING_N: Final = 1e-9
ROUNDED: Final = 1.000001
"""What counts as 1: ramps count whole ticks, and parts of them are rounded."""
MOVING: Final = 10.0
"""Allowed in a tick that takes a command while the hand moves, as a multiple: the second order of its way, on flanks,
edges and discs, and of a noise that ends the change of its level within the tick."""
_BY_ITSELF: Final = (EventKind.CONTACT, EventKind.RELEASE, EventKind.GROOVE, EventKind.PUNCTURE)
ROOM: Final = 256
"""Events of one tick."""
ROUND: Final = 1_000_000
"""Ticks of one daemon."""
WITHOUT: Final = "without one"
BURST: Final = 20
"""Changes that follow each other at once, at most."""
SHIPPED: Final = ("wood", "steel", "comb", "sandpaper_100", "cellophane", "rubber", "glass")

Tree = dict[str, Any]


# ---- What is changed -----------------------------------------------------------------------------------------------


class Scenes:
    """Random scenes about the hand's way, as a client would send them."""

    def __init__(self, source: random.Random) -> None:
        self._random = source

    def between(self, low: float, high: float) -> float:
        return self._random.uniform(low, high)

    def one_in(self, count: int) -> bool:
        return self._random.randrange(count) == 0

    def material(self) -> str:
        return self._random.choice(("a", "b", "c", *SHIPPED))

    def law(self) -> Tree:
        """A material of our own."""
        law: Tree = {"stiffness_n_per_m": self.between(50, 3000)}
        if self.one_in(2):
            law["damping_n_s_per_m"] = self.between(0, 3)
        if self.one_in(2):
            law["friction"] = {"coefficient": self.between(0.05, 1.0)}
        if self.one_in(2):
            law["tap"] = {"attack_slope_per_s": self.between(50, 400), "frequency_hz": 120, "decay_time_s": 0.02}
        choice = self._random.randrange(4)
        spacing_m = self.between(0.001, 0.004)
        grooves = {"kind": "grooves", "spacing_m": spacing_m, "width_m": 0.6 * spacing_m}
        if choice == 0:
            law["texture"] = {**grooves, "display": "geometry", "depth_m": self.between(1e-5, 4e-4)}
        elif choice == 1:
            law["texture"] = {**grooves, "display": "damping", "damping_n_s_per_m": self.between(0.1, 3)}
        return law

    def normal(self) -> list[float]:
        angle = 0.0 if self.one_in(2) else self.between(-1.0, 1.0)
        return [float(np.sin(angle)), float(np.cos(angle))]

    def place(self) -> list[float]:
        far = self.one_in(20)
        return [self.between(-0.02, 0.02), self.between(-1.0, 1.0) if far else self.between(-0.008, 0.004)]

    def patches(self) -> list[Tree]:
        cuts = sorted(self.between(-0.02, 0.02) for _ in range(4))
        ends = [(cuts[0], cuts[1]), (cuts[2], cuts[3])]
        return [{"from_m": a, "to_m": b, "material": self.material()} for a, b in ends if b - a > 1e-3]

    def object(self) -> Tree:
        match self._random.randrange(8):
            case 0 | 1:
                wall = {"kind": "wall", "point_m": self.place(), "normal": self.normal(), "material": self.material()}
                return wall | ({"patches": self.patches()} if self.one_in(2) else {})
            case 2:
                return {
                    "kind": "membrane",
                    "center_m": self.place(),
                    "normal": self.normal(),
                    "width_m": self.between(0.002, 0.04),
                    "material": self.material(),
                }
            case 3:  # thin, mostly
                size_m = [self.between(0.002, 0.04), self.between(4e-4, 2e-3 if self.one_in(2) else 0.01)]
                return {
                    "kind": "box",
                    "center_m": self.place(),
                    "size_m": size_m,
                    "angle_rad": self.between(-1, 1),
                    "material": self.material(),
                }
            case 4:
                radius_m = self.between(0.001, 0.02)
                return {"kind": "disc", "center_m": self.place(), "radius_m": radius_m, "material": self.material()}
            case 5:
                far = 10.0 if self.one_in(4) else 0.02
                return {
                    "kind": "spring",
                    "center_m": [self.between(-far, far), self.between(-far, far)],
                    "stiffness_n_per_m": self.between(0, 200),
                    "damping_n_s_per_m": self.between(0, 3),
                }
            case 6:
                return {"kind": "viscous", "damping_n_s_per_m": self.between(0, 3)}
            case _:
                return {"kind": "constant", "force_n": [self.between(-3, 3), self.between(-3, 3)]}

    def scene(self) -> Tree:
        objects = {id: self.object() for id in "pqrst" if self.one_in(2)}
        return {
            "display": {"force": not self.one_in(4), "vibration": not self.one_in(4)},
            "ramp_s": self._random.choice((0.001, 0.005, 0.02, 0.05)),
            "passivity": self._random.choice(("off", "observe", "control")),
            "objects": {"floor": self.floor(), **objects},
        }

    def floor(self) -> Tree:
        return {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": self.material()}

    def path(self) -> list[list[float]]:
        """A second or so of pressing, stroking and lifting."""
        points = [[0.0, 0.0, 0.005]]
        for _ in range(self._random.randrange(3, 8)):
            y_m = self._random.choice((-0.006, -0.003, -0.001, 0.004))
            points.append([points[-1][0] + self.between(0.05, 0.4), self.between(-0.015, 0.015), y_m])
        return points


class Hand:
    """Sends the changes. Each kind is a method, and what the daemon refuses is counted and no fault."""

    def __init__(self, client: hapticd.Client, scenes: Scenes, source: random.Random, config: Path) -> None:
        self._client, self._scenes, self._random, self._config = client, scenes, source, config
        self._ids: list[str] = ["floor"]
        self.sent: Counter[str] = Counter()
        self.refused: Counter[str] = Counter()

    def change(self) -> None:
        kinds: tuple[Callable[[], object], ...] = (
            *(self.add, self.add, self.move, self.move, self.slide, self.slide, self.remove, self.thin),
            *(self.soften, self.swap, self.patch, self.reset_all, self.reset_one, self.play, self.forget_material),
            *(self.set_scene, self.display, self.forces, self.reload, self.gesture),
        )
        kind = self._random.choice(kinds)
        self.sent[kind.__name__] += 1
        try:
            kind()
        except hapticd.RemoteError:
            self.refused[kind.__name__] += 1

    def _objects(self) -> dict[str, Any]:
        return dict(self._client.get_scene()["scene"]["objects"])

    def _some(self, kinds: tuple[str, ...]) -> tuple[str, Tree]:
        found = [(id, item) for id, item in self._objects().items() if item["kind"] in kinds]
        return self._random.choice(found) if found else ("floor", self._scenes.floor())

    def add(self) -> None:
        self._client.update_scene({self._random.choice("pqrst"): self._scenes.object()})

    def remove(self) -> None:
        id, _ = self._some(("wall", "membrane", "box", "disc", "spring", "viscous", "constant"))
        self._client.update_scene({id: None})

    def move(self) -> None:
        id, item = self._some(("wall", "membrane", "box", "disc", "spring"))
        place = "point_m" if item["kind"] == "wall" else "center_m"
        self._client.update_scene({id: {place: self._scenes.place()}} if id in self._objects() else {id: item})

    def slide(self) -> None:
        """A wall along itself, or a little way off."""
        id, item = self._some(("wall",))
        x, y = item["point_m"]
        nx, ny = item["normal"]
        way = self._scenes.between(-0.01, 0.01)
        self._client.update_scene({id: {**item, "point_m": [x + way * ny, y - way * nx]}})

    def thin(self) -> None:
        """What comes between a pressed surface and the hand."""
        y_m = self._scenes.between(-0.004, 0.0)
        thing = self._random.choice(
            (
                {"kind": "membrane", "center_m": [0, y_m], "normal": [0, 1], "width_m": 0.08},
                {"kind": "box", "center_m": [0, y_m], "size_m": [0.08, 0.001]},
                {"kind": "disc", "center_m": [0, y_m], "radius_m": 0.001},
            )
        )
        self._client.update_scene({self._random.choice("pq"): {**thing, "material": self._scenes.material()}})

    def soften(self) -> None:
        self._client.update_materials({self._random.choice("abc"): self._scenes.law()})

    def forget_material(self) -> None:
        """Of what is in use it is refused, of the rest it is a change that nobody feels."""
        self._client.set_materials({name: self._scenes.law() for name in "abc"})

    def swap(self) -> None:
        id, item = self._some(("wall", "membrane", "box", "disc"))
        self._client.update_scene({id: {**item, "material": self._scenes.material()}})

    def patch(self) -> None:
        id, item = self._some(("wall",))
        self._client.update_scene({id: {**item, "patches": self._scenes.patches()}})

    def reset_all(self) -> None:
        self._client.reset()

    def reset_one(self) -> None:
        self._client.reset([self._some(("wall", "membrane", "box", "disc"))[0]])

    def play(self) -> None:
        self._client.play(material="wood", direction=(0.6, 0.8), amplitude_m_per_s2=self._scenes.between(1, 20))

    def set_scene(self) -> None:
        self._client.set_scene(self._scenes.scene())

    def display(self) -> None:
        scene = dict(self._client.get_scene()["scene"])
        self._client.set_scene({**self._scenes.scene(), "objects": scene["objects"]})

    def forces(self) -> None:
        self._client.set_forces(False)
        self._client.set_forces(True)

    def reload(self) -> None:
        write_config(self._config, self._scenes, self._random)
        self._client.reload()

    def gesture(self) -> None:
        self._client.set_operator(self._scenes.path())


def write_config(path: Path, scenes: Scenes, source: random.Random, **servo: object) -> None:
    """Another scene and other materials; the first time nothing, so that nothing is before the recording."""
    materials = {name: scenes.law() for name in "abc"}
    if path.exists():
        config = {**yaml.safe_load(path.read_text()), "materials": materials, "scene": scenes.scene()}
    else:
        # Ticks that come late are looked at as all others; a machine without real-time rights has many.
        config = {"servo": {"realtime": "preferred", "overruns": {"threshold": 1}, **servo}, "materials": materials}
        config["scene"] = {"objects": {}}
    path.write_text(yaml.safe_dump(config))


# ---- What is looked at ---------------------------------------------------------------------------------------------


@dataclass
class Found:
    """What commands did, as parts of what they may."""

    ticks: int = 0
    changed: int = 0
    """Ticks that took a command."""
    left_out: int = 0
    worst: float = 0.0
    """In ticks that took no command."""
    worst_changed: float = 0.0
    """In those that did, with the hand where it was."""
    worst_moving: float = 0.0
    """In those that did, as the hand went on."""
    over: list[tuple[int, float, str]] = field(default_factory=list)
    """Ticks with more than is allowed, how much, and what they are."""
    flags: Counter[str] = field(default_factory=Counter)
    identical: int = 0
    rendered: int = 0
    lost: int = 0
    """Samples that did not reach the recording."""
    looked_s: float = 0.0
    """What looking took."""
    sent: Counter[str] = field(default_factory=Counter)
    refused: Counter[str] = field(default_factory=Counter)

    def add(self, other: Found) -> None:
        self.ticks += other.ticks
        self.changed += other.changed
        self.left_out += other.left_out
        self.worst = max(self.worst, other.worst)
        self.worst_changed = max(self.worst_changed, other.worst_changed)
        self.worst_moving = max(self.worst_moving, other.worst_moving)
        self.over += other.over
        self.flags += other.flags
        self.identical += other.identical
        self.rendered += other.rendered
        self.lost += other.lost
        self.looked_s += other.looked_s
        self.sent += other.sent
        self.refused += other.refused


class Tortured(Rerun):
    """Renders every tick twice: as it was, and from a copy of the state with the scene from before and no ramp."""

    found = Found()

    def __init__(self, output: Output, slots: int) -> None:
        self._still_now: Any = None
        self._still_next: Any = None
        self._tried: Any = None
        self._copied = False
        super().__init__(output, slots)
        self._event_room = records(EVENT_DTYPE, ROOM)

    def restart(self, muted: bool) -> None:
        super().restart(muted)
        state = lib.hd_state_new(self._slots)
        assert state != ffi.NULL
        self._tried = ffi.gc(state, lib.hd_state_free)
        self._resting = [ffi.gc(lib.hd_state_new(self._slots), lib.hd_state_free) for _ in range(2)]
        self._copied = False
        self._own_ramp_until = -1
        self._commanded = -(1 << 62)
        self._forces = 0
        self._first = True
        self._last: Samples | None = None

    def turn_to(self, scene: Scene, changed: Iterable[str], materials: dict[str, Material], revision: int) -> None:  # type: ignore[override]
        table = self._compiler.update(scene, changed, materials, revision)
        self._world = new_world(table)
        self._still_next = new_world(table)
        lib.hd_world_still(self._still_next)
        self._allowed_n = LIMIT_N * float(table.ramp_step)
        self._ramp_ticks = float(table.ramp_s) / float(table.period_s)

    def reset(self, objects: Iterable[str] | None, time_ns: int) -> None:
        self._copy()
        super().reset(objects, time_ns)

    def play(self, *arguments: Any) -> None:
        super().play(*arguments)
        if self._copied:  # no command of the rule: both are struck
            self._state, self._tried = self._tried, self._state
            super().play(*arguments)
            self._state, self._tried = self._tried, self._state

    def _copy(self) -> None:
        if not self._copied:
            assert lib.hd_state_copy(self._tried, self._state) == Status.OK
            self._copied = True

    def run(
        self, recorded: Samples, interval_s: npt.NDArray[np.float64], periods: npt.NDArray[np.uint32]
    ) -> tuple[Samples, npt.NDArray[np.void]]:
        recorded, interval_s = np.ascontiguousarray(recorded), np.ascontiguousarray(interval_s)
        periods = np.ascontiguousarray(periods)
        count = len(recorded)
        samples, still = np.empty(count, SAMPLE_DTYPE), np.empty(count, SAMPLE_DTYPE)
        # Where forces are switched, the tick without the command has them as they were.
        told = recorded.copy()
        on = recorded["flags"] & Flag.FORCES_ON
        before = np.append(self._forces, on[:-1])
        if self._first:
            before[0] = on[0]
        told["flags"] = (recorded["flags"] & ~np.uint32(Flag.FORCES_ON)) | before.astype(np.uint32)
        self._forces = on[-1]
        taken, out, tried = (pointer("struct hd_sample[]", array) for array in (recorded, samples, still))
        given = pointer("struct hd_sample[]", told)
        since, counts = pointer("double[]", interval_s), pointer("uint32_t[]", periods)
        room, happened = pointer("struct hd_event[]", self._event_room), ffi.new("size_t *")
        ramp = float(np.float64(self._allowed_n))
        left_out = np.zeros(count, bool)
        rested = np.zeros(count)
        commanded = before != on
        commanded[0] |= self._copied or self._still_next is not None
        ticks, flags = recorded["tick"].tolist(), recorded["flags"].tolist()
        for i in range(count):
            self._copy()
            self._copied = False
            if commanded[i]:
                self._commanded = ticks[i]
            world = self._still_now if i == 0 and self._still_now is not None else self._still_next or self._still_now
            if i == 0 and self._still_next is not None:
                self._still_now, self._still_next = self._still_next, None
            if commanded[i] and not (self._first and i == 0):
                earlier = recorded[i - 1 : i] if i else self._last
                rested[i] = self._rest(world, earlier, recorded[i : i + 1], told[i : i + 1])
            # A fresh start has no scene before.
            last = (since + i, counts + i, 1)
            assert lib.hd_replay(world, self._tried, given + i, *last, tried + i, room, ROOM, happened) == Status.OK
            if happened[0] and commanded[i] and self._crosses(happened[0]):
                left_out[i] = True
            assert lib.hd_replay(self._world, self._state, taken + i, *last, out + i, room, ROOM, happened) == Status.OK
            stalled = periods[i] >= self._ramp_ticks or flags[i] & Flag.GLITCH
            if stalled or (happened[0] and self._begins_own_ramp(happened[0], ticks[i])):
                self._own_ramp_until = ticks[i] + self._ramp_ticks + 1
            left_out[i] |= ticks[i] <= self._own_ramp_until
        left_out[0] |= self._first
        self._first = False
        self._last = recorded[-1:].copy()
        self._judge(samples, still, left_out, commanded, rested, ramp * periods)
        return samples, self._event_room[:0].copy()

    def _rest(self, before: Any, earlier: Samples, taken: Samples, told: Samples) -> float:
        """What a command does, N, where the hand rests at the sample before it; 0 where the scene from before meets or
        leaves something by itself."""
        forces = []
        happened = ffi.new("size_t *")
        states = ((before, self._tried, told), (self._world, self._state, taken))
        for state, (world, from_state, record) in zip(self._resting, states, strict=True):
            assert lib.hd_state_copy(state, from_state) == Status.OK
            given = record.copy()
            for name in ("position_m", "velocity_m_per_s"):
                given[name] = earlier[name]
            given["flags"] &= ~np.uint32(Flag.GLITCH)
            since, counts, out = np.zeros(1), np.ones(1, np.uint32), np.empty(1, SAMPLE_DTYPE)
            taken_in = (pointer("double[]", since), pointer("uint32_t[]", counts), 1)
            samples = (pointer("struct hd_sample[]", given), *taken_in, pointer("struct hd_sample[]", out))
            room = pointer("struct hd_event[]", self._event_room)
            assert lib.hd_replay(world, state, *samples, room, ROOM, happened) == Status.OK
            if not forces and happened[0] and self._crosses(happened[0]):
                return 0.0
            forces.append(out["force_n"][0].copy())
        return float(np.hypot(*(forces[1] - forces[0])))

    def _crosses(self, count: int) -> bool:
        kinds = self._event_room["kind"][:count]
        return bool(np.isin(kinds, _BY_ITSELF).any())

    def _begins_own_ramp(self, count: int, tick: int) -> bool:
        events = self._event_room[:count]
        silent = bool(((events["kind"] == EventKind.CONTACT) & (events["code"] != 0)).any())
        return silent and tick - self._commanded >= self._ramp_ticks

    def _judge(
        self,
        samples: Samples,
        still: Samples,
        left_out: npt.NDArray[np.bool_],
        commanded: npt.NDArray[np.bool_],
        rested: npt.NDArray[np.float64],
        allowed_n: npt.NDArray[np.float64],
    ) -> None:
        found = type(self).found
        force = samples["force_n"]
        allowed = allowed_n + ROUNDING_N
        parts = np.linalg.norm(force - still["force_n"], axis=1) / allowed
        moving = np.zeros(len(samples))
        for i in np.flatnonzero(commanded & ~left_out):
            earlier = samples[i - 1] if i else self._before
            moving[i] = off_between(force[i], earlier, still[i]) / allowed[i]
        self._before = samples[-1].copy()
        parts[commanded] = (rested / allowed)[commanded]
        parts[left_out] = 0.0
        found.ticks += len(samples)
        found.changed += int(commanded.sum())
        found.left_out += int(left_out.sum())
        found.worst = max(found.worst, float(parts[~commanded].max(initial=0.0)))
        found.worst_changed = max(found.worst_changed, float(parts[commanded].max(initial=0.0)))
        found.worst_moving = max(found.worst_moving, float(moving.max(initial=0.0)))
        for i in np.flatnonzero((parts > ROUNDED) | (moving > MOVING)):
            what = "with a command" if commanded[i] else WITHOUT
            found.over.append((int(samples["tick"][i]), max(float(parts[i]), float(moving[i])), what))
        for flag in (Flag.CONTACT, Flag.RINGING, Flag.RAMPING, Flag.SATURATED, Flag.RESTRAINED):
            found.flags[str(flag.name).lower()] += int((samples["flags"] & flag != 0).sum())


def off_between(force: npt.NDArray[np.float64], before: Any, after: Any) -> float:
    """How far a force is, N, from all that lies between two samples, (1,) each, in contact and vibration each."""
    contact = before["contact_force_n"] - after["contact_force_n"]
    vibration = before["vibration_force_n"] - after["vibration_force_n"]
    off = force - after["force_n"]
    parts = np.zeros(2)
    ways = np.stack((contact, vibration))
    for _ in range(50):  # the nearest point of a parallelogram, one side after the other
        for side in range(2):
            rest = off - parts[1 - side] * ways[1 - side]
            square = float(ways[side] @ ways[side])
            parts[side] = min(1.0, max(0.0, float(rest @ ways[side]) / square)) if square > 0.0 else 0.0
    return float(np.hypot(*(off - parts @ ways)))


def look(path: Path) -> Found:
    """What commands did in a recording."""

    class Fresh(Tortured):
        found = Found()

    with patch.object(replay, "Rerun", Fresh):
        again = replay.replay(path)
    found = Fresh.found
    found.identical, found.rendered = again.identical, len(again.samples)
    if again.missing_revisions:
        # Samples were lost on the way to the recording, and scenes with them: what was before a command is not known.
        found.changed, found.worst_changed, found.worst_moving = 0, 0.0, 0.0
        found.over = [one for one in found.over if one[2] == WITHOUT]
    return found


def run(
    source: random.Random, changes: int, rate_hz: float = 10_000.0, lasts_s: float = 0.0, keep: Path | None = None
) -> Found:
    """So many changes at a daemon, as fast as it answers or spread over `lasts_s`, and what they did; a recording in
    which they did too much is kept in a folder `keep`."""
    with tempfile.TemporaryDirectory(prefix="hapticd-torture-") as name:
        config, recording = Path(name) / "config.yaml", Path(name) / "torture.npz"
        scenes = Scenes(source)
        write_config(config, scenes, source, rate_hz=rate_hz)
        with (
            running_daemon("-c", str(config)) as daemon,
            connect(daemon.directory) as client,
            warnings.catch_warnings(),
            client.record(recording) as recorder,
        ):
            # A busy machine loses samples: `look` leaves out what they make unknown, and Found counts them.
            warnings.simplefilter("ignore", hapticd.TelemetryLoss)
            hand = Hand(client, scenes, source, config)
            stop = threading.Event()

            def move() -> None:
                paths = Scenes(random.Random(1))
                with connect(daemon.directory) as other:
                    while not stop.is_set():
                        path = paths.path()
                        with suppress(hapticd.HapticdError):
                            other.set_operator(path)
                        stop.wait(path[-1][0])

            mover = threading.Thread(target=move)
            mover.start()
            try:
                began = time.monotonic()
                burst = 0
                for sent in range(changes):
                    if burst == 0:
                        burst = source.randrange(1, BURST)
                        stop.wait(max(0.0, began + lasts_s * sent / changes - time.monotonic()))
                    burst -= 1
                    hand.change()
                stop.wait(max(0.0, began + lasts_s - time.monotonic()))
            finally:
                stop.set()
                mover.join()
        began = time.monotonic()
        found = look(recording)
        if found.over and keep is not None:
            keep.mkdir(parents=True, exist_ok=True)
            shutil.copy(recording, keep / f"{time.time_ns()}.npz")
        found.looked_s = time.monotonic() - began
        found.lost = recorder.result.lost
        found.sent, found.refused = hand.sent, hand.refused
        return found


def tell(found: Found) -> str:
    """One line for people, and the worst ticks."""
    text = (
        f"{found.ticks:,} ticks, {found.changed:,} took a command ({sum(found.sent.values()):,} sent, "
        f"{sum(found.refused.values()):,} refused), {found.left_out:,} left out; {found.identical:,} of "
        f"{found.rendered:,} as recorded, bit for bit, {found.lost:,} lost; "
        f"{dict(found.flags)}; at most {found.worst:.6f} of what is "
        f"allowed, {found.worst_changed:.6f} in ticks that took a command, {found.worst_moving:.6f} as the hand went "
        f"on in them, more than is allowed in {len(found.over)} ticks; "
        f"looked at in {found.looked_s:.0f} s"
    )
    worst = sorted(found.over, key=lambda one: -one[1])[:20]
    return "\n".join([text, *(f"  tick {tick}, {what}: {part:.3f}" for tick, part, what in worst)])


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--ticks", type=int, default=10_000_000)
    parser.add_argument("--changes", type=int, default=50_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rate", type=float, default=10_000.0)
    arguments = parser.parse_args()
    rounds = -(-arguments.ticks // ROUND)
    total = Found()
    for i in range(rounds):
        source = random.Random(arguments.seed + i)
        changes = arguments.changes * (i + 1) // rounds - arguments.changes * i // rounds
        lasts_s = arguments.ticks / rounds / arguments.rate
        found = run(source, changes, arguments.rate, lasts_s, Path("build/torture"))
        print(f"seed {arguments.seed + i}: {tell(found)}", flush=True)
        total.add(found)
    print(f"all: {tell(total)}")
    print(dict(total.sent), "refused", dict(total.refused))
    broken = max(total.worst, total.worst_changed) > ROUNDED or total.worst_moving > MOVING
    if broken or total.identical < total.rendered:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
