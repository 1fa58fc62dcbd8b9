"""The handlers of the protocol's methods. `docs/protocol.md` is the reference.

A handler gets validated parameters and returns the result, or raises MethodError. Sockets belong to `router.py`.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from itertools import islice
from time import monotonic_ns
from typing import Any, Final, NamedTuple, TypeAlias, cast

from pydantic import ValidationError

from hapticd.base import wording
from hapticd.base.codec import Encoded
from hapticd.base.core import Fault
from hapticd.base.errors import (
    MAX_SHOWN_PROBLEMS,
    HapticdError,
    InvalidError,
    Path,
    Problem,
    known_names,
    path_text,
    quoted,
)
from hapticd.base.model import MAX_FAULTS, Model, problems_of
from hapticd.base.steps import Steps, finish
from hapticd.config.configuration import Config
from hapticd.config.materials import Materials
from hapticd.config.operator import Target, operator_of
from hapticd.config.scene import (
    Scene,
    SceneObject,
    material_names,
    materials_of,
    reference_problems,
    same_materials,
    scene_steps,
    used_materials,
)
from hapticd.daemon.command_ring import RingFullError, WaitTimeoutError
from hapticd.daemon.engine import Engine, StaleRevisionError
from hapticd.daemon.flight_recorder import Flight
from hapticd.daemon.lease import Lease, LeaseHeldError, LeaseLapsedError
from hapticd.daemon.params import (
    ApplyParams,
    ChangeParams,
    GetStatusParams,
    LeaseParams,
    NoParams,
    PlayParams,
    ReloadParams,
    ResetParams,
    SceneChangeParams,
    SetForcesParams,
    SetMaterialsParams,
    SetSceneParams,
    StreamForceParams,
    StreamTargetParams,
    UpdateMaterialsParams,
    UpdateSceneParams,
)
from hapticd.daemon.refusal import MethodError
from hapticd.daemon.reload import needing_restart, read_again
from hapticd.daemon.status import Status
from hapticd.daemon.status_text import FAULT_REASONS
from hapticd.daemon.streams import NotInTurnError, Streams
from hapticd.protocol.displayability_warnings import above_rate, change_warnings, operator_warnings
from hapticd.protocol.events import fault_names
from hapticd.protocol.marks import Mark, MarkParams, checked_data
from hapticd.protocol.messages import Code, decode_trusted
from hapticd.protocol.validation import (
    dropped_parts,
    further_faults,
    patched_materials,
    patched_objects,
    replaced_materials,
)
from hapticd.rendering.displayability import material_rate_faults, rate_faults
from hapticd.rendering.joystick import grip_of, target_of
from hapticd.rendering.placement import Point, held_problem, holding, leaps_onto, placement_warnings
from hapticd.system.repeated_lines import MIN_REPEAT_INTERVAL_S, Repeats

_MAX_PARAM_MEMBERS: Final = 16
"""Largest number of members of `params`, checked before their values; no method has more parameters."""


class _Proposed(NamedTuple):
    """Scene and materials of a requested change, before the checks of material names and of limits of the rate."""

    scene: Scene
    materials: Materials
    objects: Mapping[str, SceneObject] = {}
    """Objects of `scene` that the request contains."""
    root: Path = ()
    """The place of `objects` in the request, for error messages."""
    sent: Collection[str] = ()
    """Names of the materials that the request contains."""
    changed: Collection[str] | None = ()
    """Ids of the objects that may differ or are removed; None: all objects must be compared."""
    dropped: Sequence[Problem] = ()
    """Warnings of parts that replaced materials no longer have."""


class _Changed(NamedTuple):
    """A change of scene or materials that takes effect at the next tick, or has already done so."""

    revision: int
    wait: bool
    """Whether the answer waits for the first tick of this revision and contains it."""
    warnings: list[Problem]
    margins: dict[str, float | None] | None
    """Stability margins of the surfaces that were added or changed (Engine.margins)."""


CHANGE_METHODS: Final = frozenset(("set_scene", "update_scene", "set_materials", "update_materials", "apply", "reload"))
"""Methods that change scene or materials. They may take seconds and run in steps; all others take milliseconds."""
Result: TypeAlias = dict[str, object] | Encoded
FIRST_STATE_TIMEOUT_S: Final = 1.0
"""Time that `get_state` waits for the first tick; other requests wait too."""
_FIRST_STATE_POLL_S: Final = 0.001
"""Interval in which `get_state` polls for the first tick."""
_MOVE_OR_FORCE: Final = (
    "; nothing was changed: move the object or the handle, turn forces off, or repeat the change with force: true "
    "(--force)"
)
"""End of a problem with an object that would hold the handle deep inside."""
_Handler = Callable[["Methods", Any], Result | Steps[_Changed]]


def _objects_to_check(new: _Proposed) -> tuple[Mapping[str, SceneObject], Path]:
    """Return the objects of a change, or those of its changed materials, and their place in the request or scene."""
    if new.objects or not new.sent:
        return new.objects, new.root
    sent = frozenset(new.sent)
    touched = {id: item for id, item in new.scene.objects.items() if not sent.isdisjoint(material_names(item))}
    return touched, ("scene", "objects")


def _with_warnings(result: dict[str, object], warnings: list[Problem]) -> dict[str, object]:
    """Return `result` with a member `warnings`, or unchanged if there are none."""
    return {**result, "warnings": [asdict(problem) for problem in warnings]} if warnings else result


def _with_margins(result: dict[str, object], margins: dict[str, float | None] | None) -> dict[str, object]:
    """Return `result` with a member `margins`, the stability margins of surfaces, or unchanged if they are unknown."""
    return result if margins is None else {**result, "margins": margins}


class Methods:
    """The protocol's methods for one engine. One thread at a time may call them."""

    def __init__(
        self,
        engine: Engine,
        load: Callable[[], tuple[Config, str]] | None = None,
        flight: Flight | None = None,
        read_state: Callable[[], dict[str, object] | None] | None = None,
    ) -> None:
        """Act on `engine`. `read_state` returns the newest sample.

        `load` reads the configuration again, and returns it with the names of its files as one text.
        """
        self._engine = engine
        self._load = load
        self._flight = flight
        self._read_state = read_state
        self.repeats = Repeats()
        """Limits the log lines that clients cause. The caller of the methods must call its `flush`."""
        self._lease = Lease(engine.set_lease, monotonic_ns)
        self.streams = Streams(engine, engine.connection is None, round(1e9 * engine.config.servo.stream_timeout_s))
        self._sender: object = None
        self._status = Status(engine, self._lease, flight, self.streams)
        self._reference_m = engine.config.device.sim.start_m

    def call(self, method: str, params: Mapping[str, object]) -> dict[str, object]:
        """Run a method to its end and return its result. Raises MethodError."""
        result = finish(self.change(method, params)) if method in CHANGE_METHODS else self.perform(method, params)
        return cast(dict[str, object], decode_trusted(bytes(result))) if isinstance(result, Encoded) else result

    def perform(self, method: str, params: Mapping[str, object]) -> Result:
        """Run a method that changes neither scene nor materials, and return its result. Raises MethodError."""
        with self._refusals(params):
            return cast(Result, self._handled(method, params))

    def change(self, method: str, params: Mapping[str, object]) -> Steps[Result]:
        """Run one of CHANGE_METHODS in steps of a few milliseconds each, and return its result.

        Only the last step changes anything; it may wait for the servo. Raises MethodError.
        """
        engine = self._engine
        with self._refusals(params):
            try:
                changed = yield from cast("Steps[_Changed]", self._handled(method, params))
            except ValidationError as error:
                more = yield from further_faults(method, params, engine.scene, engine.materials)
                raise InvalidError([*problems_of(error), *more]) from None
            finally:
                engine.forget_prepared()
            result: dict[str, object] = {"revision": changed.revision}
            if changed.wait:
                result["tick"] = engine.wait_revision(changed.revision)
            faults = engine.counters().faults
            if faults:
                result["warning"] = self._off_because(faults)
            return _with_warnings(_with_margins(result, changed.margins), changed.warnings)

    def _handled(self, method: str, params: Mapping[str, object]) -> Result | Steps[_Changed]:
        """Validate the params of a method, and return the result of its handler.

        Raises MethodError, and the errors that `_refusals` converts.
        """
        entry = _METHOD_HANDLERS.get(method)
        if entry is None:
            raise MethodError(Code.NO_SUCH_METHOD, f"no such method; {known_names(method, _METHOD_HANDLERS)}")
        model, handler = entry
        if len(params) > _MAX_PARAM_MEMBERS:
            raise InvalidError(
                [Problem("", f"params must have at most {_MAX_PARAM_MEMBERS} members, has {len(params)}")]
            )
        self._engine.beat()
        given = params if model is None else model.parsed(params)
        if isinstance(given, ChangeParams) and given.expect_revision not in (None, self._engine.revision):
            raise StaleRevisionError
        return handler(self, given)

    @contextmanager
    def _refusals(self, params: Mapping[str, object]) -> Iterator[None]:
        """Convert the errors of a handler to MethodError."""
        try:
            yield
        except ValidationError as error:
            raise MethodError.faulty(problems_of(error)) from None
        except InvalidError as error:
            raise MethodError.faulty(error.problems) from None
        except StaleRevisionError:
            raise self._stale(params.get("expect_revision")) from None
        except RingFullError as error:
            raise MethodError(Code.RING_FULL, str(error)) from None
        except WaitTimeoutError as error:
            raise MethodError(Code.WAIT_TIMED_OUT, str(error)) from None

    def stream(self, method: str, params: Mapping[str, object], sender: object) -> dict[str, object]:
        """Accept a streamed target or force from a connection; count a refused one. Raises MethodError."""
        self._sender = sender
        try:
            return cast("dict[str, object]", self.perform(method, params))
        except NotInTurnError:
            raise
        except MethodError:
            self.streams.refused(method)
            raise

    def status(self) -> dict[str, object]:
        """Return the message of the topic `status`: the result of get_status with all details."""
        return self._status.report()

    # ---- Scene and materials ---------------------------------------------------------------------------------------

    def _get_status(self, params: GetStatusParams) -> Encoded:
        return self._status.encoded(params.detail)

    def _get_state(self, _: NoParams) -> dict[str, object]:
        if self._read_state is None:
            raise MethodError(Code.INTERNAL, "this daemon has no telemetry")
        until_ns = monotonic_ns() + int(FIRST_STATE_TIMEOUT_S * 1e9)
        while (state := self._read_state()) is None:
            if monotonic_ns() >= until_ns:
                raise MethodError(Code.WAIT_TIMED_OUT, f"no tick was rendered within {FIRST_STATE_TIMEOUT_S:g} s")
            self._engine.beat()
            self._engine.poll_servo()
            time.sleep(_FIRST_STATE_POLL_S)
        return state

    def _get_config(self, _: NoParams) -> dict[str, object]:
        config = self._engine.config
        return {"config": {"servo": config.servo.to_dict(), "device": config.device.to_dict()}}

    def _get_scene(self, _: NoParams) -> dict[str, object]:
        state = self._engine.state
        result: dict[str, object] = {"scene": state.scene.to_dict(), "revision": state.revision}
        return _with_margins(result, self._engine.margins())

    def _set_scene(self, params: SetSceneParams) -> Steps[_Changed]:
        scene = yield from scene_steps(params.scene, ("scene",))
        new = _Proposed(scene, self._engine.materials, scene.objects, ("scene", "objects"), changed=None)
        return (yield from self._take(params, new))

    def _update_scene(self, params: UpdateSceneParams) -> Steps[_Changed]:
        before = self._engine.scene
        changes = yield from patched_objects(params.objects, before)
        present = {id: item for id, item in changes.items() if item is not None}
        scene = before.with_objects(changes)
        new = _Proposed(scene, self._engine.materials, present, ("objects",), changed=changes.keys())
        return (yield from self._take(params, new))

    def _take(self, params: ChangeParams, new: _Proposed) -> Steps[_Changed]:
        """Compile a scene and its materials, and put them in force. Raises InvalidError, StaleRevisionError."""
        engine, output = self._engine, None
        # Between two steps the servo may have stepped down to another rate.
        while output is not engine.output:
            output = engine.output
            problems = self._problems_of(new)
            if problems:
                raise InvalidError(problems)
            reports = yield from engine.prepared(new.objects.values(), new.materials, new.sent)
        handle_m, (objects, root) = self._handle_m(), _objects_to_check(new)
        held = holding(new.scene, objects, new.materials, engine.reach, handle_m)
        if held and new.objects and not (isinstance(params, SceneChangeParams) and params.force):
            self._refuse_to_hold(new, held, handle_m)
        placed = placement_warnings(
            new.scene, new.materials, engine.reach, objects=objects, root=root, handle_m=handle_m, held=held
        )
        revision = engine.take(new.scene, new.materials, new.changed, params.expect_revision)
        shown = change_warnings(new.objects, new.sent, reports, new.root, engine.played())
        warnings = [*new.dropped, *islice(placed, MAX_FAULTS), *shown]
        return _Changed(revision, params.wait, warnings[:MAX_FAULTS], engine.margins(touched=True))

    def _handle_m(self) -> Point:
        """Return the newest position of the handle, or the position at the start before the first tick."""
        newest = None if self._read_state is None else self._read_state()
        return self._engine.reach.rest_m if newest is None else cast(Point, newest["position_m"])

    def _refuse_to_hold(self, new: _Proposed, held: Collection[str], handle_m: Point) -> None:
        """Raise MethodError if forces are on, and a new or moved object is one of `held`, which hold the handle."""
        engine, counters, before = self._engine, self._engine.counters(), self._engine.scene
        if not counters.forces_on or counters.latched:
            return
        known = before.objects if before.display.force else {}
        refused = [
            id
            for id, item in new.objects.items()
            if id in held and leaps_onto(item, known.get(id), engine.reach, handle_m)
        ]
        problems = [
            Problem(
                path_text((*new.root, id)),
                held_problem(new.objects[id], new.materials, engine.reach, handle_m) + _MOVE_OR_FORCE,
            )
            for id in refused[: MAX_SHOWN_PROBLEMS - 1]
        ]
        if problems:
            raise MethodError.faulty(problems, Code.HANDLE_INSIDE, len(refused))

    def _problems_of(self, new: _Proposed) -> list[Problem]:
        """Return the problems of materials that do not exist or are impossible at this rate."""
        engine, before = self._engine, self._engine.scene.objects
        if new.materials is not engine.materials:
            known = engine.materials
            others = {name: each for name, each in new.materials.items() if known.get(name) is not each}
            # Changed materials are compiled for the old scene too, before its objects are removed.
            problems = rate_faults(new.scene.objects, others, engine.output) or rate_faults(
                before, others, engine.output
            )
            if problems:
                return problems
        # Objects whose materials keep their names were checked when they were added.
        objects = {id: item for id, item in new.objects.items() if not same_materials(before.get(id), item)}
        if not objects:
            return []
        problems = reference_problems(objects, new.materials, new.root[:-1])[:MAX_FAULTS]
        if problems:
            return problems
        refused = {
            name: faults
            for name in used_materials(objects.values())
            if (faults := material_rate_faults(name, new.materials[name], engine.output))
        }
        for id, item in objects.items() if refused else ():
            for index, name in enumerate(materials_of(item)):
                inner: Path = ("patches", index - 1, "material") if index else ("material",)
                for fault in refused.get(name, ()):
                    problems.append(Problem(path_text((*new.root, id, *inner)), str(fault)))
            if len(problems) >= MAX_FAULTS:
                break
        return problems[:MAX_FAULTS]

    def _get_materials(self, _: NoParams) -> dict[str, object]:
        state = self._engine.state
        materials = {name: material.to_dict() for name, material in state.materials.items()}
        return {"materials": materials, "revision": state.revision}

    def _set_materials(self, params: SetMaterialsParams) -> Steps[_Changed]:
        engine = self._engine
        materials = yield from replaced_materials(params.materials, engine.materials)
        dropped = dropped_parts(params.materials, materials, engine.materials)
        return (
            yield from self._take(params, _Proposed(engine.scene, materials, sent=params.materials, dropped=dropped))
        )

    def _update_materials(self, params: UpdateMaterialsParams) -> Steps[_Changed]:
        engine = self._engine
        materials, patched = yield from patched_materials(params.materials, engine.materials)
        missing = [
            Problem(path_text(("materials", name)), f"cannot be removed: object {quoted(id)} uses it")
            for id, item in engine.scene.objects.items()
            for name in material_names(item)
            if name not in materials
        ]
        if missing:
            raise InvalidError(missing)
        return (yield from self._take(params, _Proposed(engine.scene, materials, sent=patched)))

    def _apply(self, params: ApplyParams) -> Steps[_Changed]:
        """Change materials and scene at one tick, or neither of them; report the problems of both."""
        engine = self._engine
        problems: list[Problem] = []
        has_scene = "scene" in params.model_fields_set
        if params.materials is None and not has_scene:
            raise InvalidError([Problem("", "needs materials, scene or both")])
        new = _Proposed(engine.scene, engine.materials, sent=params.materials or ())
        if params.materials is not None:
            try:
                materials = yield from replaced_materials(params.materials, engine.materials)
                dropped = dropped_parts(params.materials, materials, engine.materials)
                new = new._replace(materials=materials, dropped=dropped)
            except InvalidError as error:
                problems += error.problems
        if has_scene:
            try:
                scene = yield from scene_steps(params.scene, ("scene",))
                new = new._replace(scene=scene, objects=scene.objects, root=("scene", "objects"), changed=None)
            except InvalidError as error:
                problems += error.problems
        if problems:
            raise InvalidError(problems)
        return (yield from self._take(params, new))

    def _reload(self, params: ReloadParams) -> Steps[_Changed]:
        """Reload the configuration; refuse the reload if any changed key needs a restart."""
        engine = self._engine
        if self._load is None:
            raise MethodError(Code.INTERNAL, "this daemon has no configuration to read")
        files = ""
        try:
            config, files = yield from read_again(self._load)
            fixed = needing_restart(engine.config, config)
            if fixed:
                raise InvalidError(fixed)
            objects, changed_ids = config.scene.objects, config.scene.changed_since(engine.scene)
            used = used_materials(objects.values())
            proposed = _Proposed(config.scene, config.materials, objects, ("scene", "objects"), used, changed_ids)
            if config.scene == engine.scene and config.materials == engine.materials:
                # The same objects stay in force, so that nothing is compiled again.
                proposed = proposed._replace(scene=engine.scene, materials=engine.materials)
            changed = yield from self._take(params, proposed)
        except StaleRevisionError:
            raise
        except (MethodError, HapticdError) as error:
            where = f"{files}: " if files else ""  # a fault of a file itself names the file
            self._log_reload(logging.ERROR, f"not reloaded: {where}{error}")
            if isinstance(error, MethodError):
                raise error.prefixed(where) from None
            problems = error.problems if isinstance(error, InvalidError) else (Problem("", str(error)),)
            raise InvalidError(
                [Problem(f"{where}{each.where}" if each.where else files, each.problem) for each in problems]
            ) from None
        count = wording.count(len(changed_ids), "object")
        self._log_reload(logging.INFO, f"reloaded: revision {changed.revision}, {count} changed")
        return changed

    def _log_reload(self, level: int, line: str) -> None:
        """Log the outcome of a reload, at most one line a second: a client may request hundreds."""
        self.repeats.line(f"reload {level}", level, line, MIN_REPEAT_INTERVAL_S)

    def _dump_flight(self, _: NoParams) -> dict[str, object]:
        if self._flight is None:
            raise MethodError(Code.INTERNAL, "this daemon has no flight recorder")
        return {"file": str(self._flight.dump())}

    def _stale(self, expected: object) -> MethodError:
        revision = self._engine.revision
        return MethodError(
            Code.STALE_REVISION,
            f"expect_revision: {expected} is stale, the scene is at revision {revision}",
            {"revision": revision},
        )

    # ---- Commands --------------------------------------------------------------------------------------------------

    def _play(self, params: PlayParams) -> dict[str, object]:
        if (params.mode is None) == (params.material is None):
            raise InvalidError([Problem("", "needs exactly one of mode and material")])
        problems = []
        if math.hypot(*params.direction) < 1e-9:
            problems.append(Problem("direction", "must have a direction: a length of at least 1e-9"))
        attack, name = "coefficient", params.material or ""
        if params.mode is not None:
            mode = params.mode.mode
        else:
            material = self._engine.materials.get(name)
            if material is None:
                names = known_names(name, self._engine.materials)
                problems.append(Problem("material", f"unknown material {quoted(name)}; {names}"))
            elif material.tap is not None and material.tap.ringing is None:
                problem = f"the tap of {quoted(name)} is a waveform, which play cannot strike; give a mode"
                problems.append(Problem("material", problem))
            elif material.tap is not None:
                mode, attack = material.tap.mode, material.tap.attack
            elif material.rupture is not None:
                mode = material.rupture.mode
            else:
                problems.append(Problem("material", f"{quoted(name)} has neither a tap nor a rupture to play"))
        if problems:
            raise InvalidError(problems)
        self._need_forces()
        tick, shown_hz = self._engine.play(mode, cast(Any, attack), params.direction, params.amplitude_m_per_s2)
        wanted_hz = mode.frequency_hz
        warnings = []
        if shown_hz is None or abs(shown_hz - wanted_hz) > 1e-9 * wanted_hz:
            where = "material" if params.mode is None else "mode"
            warnings.append(Problem(where, above_rate(wanted_hz, shown_hz, self._engine.output)))
        return _with_warnings({"tick": tick, "displayed_hz": shown_hz}, warnings)

    def _reset(self, params: ResetParams) -> dict[str, object]:
        if params.objects is not None:
            objects = self._engine.scene.objects
            unknown = [
                Problem(f"objects[{place}]", f"unknown object {quoted(id)}; {known_names(id, objects)}")
                for place, id in enumerate(params.objects)
                if id not in objects
            ]
            if unknown:
                raise InvalidError(unknown)
        return {"tick": self._engine.reset(params.objects)}

    def _mark(self, params: MarkParams) -> dict[str, object]:
        return {"tick": self._engine.mark(Mark(params.text, checked_data(params.data)))}

    def _set_forces(self, params: SetForcesParams) -> dict[str, object]:
        self._lease.forget_lapsed()
        before = self._engine.counters()
        tick = self._engine.set_forces(params.enabled)
        after = self._engine.counters()
        were_on, are_on = (each.forces_on and not each.latched for each in (before, after))
        if are_on == params.enabled and are_on != were_on:
            line = f"forces turned {'on' if params.enabled else 'off'} by a command (set_forces)"
            self.repeats.line("forces", logging.INFO, line, MIN_REPEAT_INTERVAL_S)
        faults = after.faults
        if params.enabled and faults:
            raise MethodError(Code.FORCES_OFF, self._off_because(faults), {"faults": fault_names(faults)})
        result: dict[str, object] = {"forces": "faulted" if faults else "on" if params.enabled else "off", "tick": tick}
        signs = self._engine.counters().signs
        return {**result, "signs": signs.to_dict()} if params.enabled and signs.holds_back else result

    def _lease_request(self, params: LeaseParams) -> dict[str, object]:
        try:
            token = self._lease.request(params.duration_s, params.token)
        except LeaseHeldError:
            remaining = self._lease.remaining_s or 0.0
            raise MethodError(
                Code.LEASE_HELD, f"another client holds the lease for {remaining:.3f} s more", {"lease_s": remaining}
            ) from None
        except LeaseLapsedError:
            raise self._lapsed() from None
        result: dict[str, object] = {"token": token}
        faults = self._engine.counters().faults
        if faults:
            result["warning"] = self._off_because(faults)
        return result

    def _lapsed(self) -> MethodError:
        faults = self._engine.counters().faults
        message = "token: no lease has this token: the lease lapsed, was ended or never existed"
        if faults:
            message += f"; {self._off_because(faults)}"
        return MethodError(Code.LEASE_LAPSED, message, {"faults": fault_names(faults)})

    def _set_operator(self, params: Mapping[str, object]) -> dict[str, object]:
        engine = self._engine
        self._need_simulated_hand("set_operator")
        operator = operator_of(params)
        engine.beat()
        grip = grip_of(engine.config.device.sim)
        reference_m = self.streams.target_m or self._reference_m
        waypoints = operator.waypoints_for(self._target, grip, reference_m, engine.scene.objects)
        tick = engine.set_operator(waypoints, operator.interpolation)
        self._reference_m = (float(waypoints[-1, 1]), float(waypoints[-1, 2]))
        self.streams.target_m = None
        where = None if operator.gesture is None else "gesture"
        warnings = operator_warnings(waypoints, engine.config.device.sim.workspace_m, where)
        return _with_warnings({"duration_s": float(waypoints[-1, 0]), "tick": tick}, warnings)

    def _stream_target(self, params: StreamTargetParams) -> dict[str, object]:
        self._need_simulated_hand("stream_target")
        self.streams.take(self._sender, "target", params.seq, *params.position_m)
        return {}

    def _stream_force(self, params: StreamForceParams) -> dict[str, object]:
        self.streams.take(self._sender, "force", params.seq, *params.force_n)
        counters = self._engine.counters()
        if counters.faults:
            return {"forces": "faulted", "warning": self._off_because(counters.faults)}
        if not counters.forces_on:
            warning = (
                "a streamed force has no effect while forces are off: `hapticd force on` or set_forces turns them on"
            )
            return {"forces": "off", "warning": warning}
        held_back = self._held_back()
        return {"forces": "on", "warning": held_back} if held_back else {"forces": "on"}

    def _target(self, id: str) -> Target | None:
        item = self._engine.scene.objects.get(id)
        return target_of(item, self._engine.materials)

    def _need_simulated_hand(self, method: str) -> None:
        if self._engine.connection is not None:
            kind = self._engine.config.device.kind
            raise MethodError(Code.NO_OPERATOR, f"{method}: needs the simulated joystick, device.kind is {kind}")

    def _need_forces(self) -> None:
        counters = self._engine.counters()
        if counters.faults:
            raise MethodError(
                Code.FORCES_OFF, self._off_because(counters.faults), {"faults": fault_names(counters.faults)}
            )
        if not counters.forces_on:
            raise MethodError(Code.FORCES_OFF, "forces are off: `hapticd force on` or set_forces turns them on")
        held_back = self._held_back()
        if held_back:
            raise MethodError(Code.FORCES_OFF, held_back)

    def _held_back(self) -> str | None:
        """Return why the forces, which are on, are not displayed yet; None if they are displayed."""
        signs = self._engine.counters().signs
        waits = signs.line() or "they begin when the signs of the device are checked"
        return f"forces are held back: {waits}" if signs.holds_back else None

    def _off_because(self, faults: Fault) -> str:
        signs = self._engine.counters().signs
        words = FAULT_REASONS | ({"signs": signs.problem_text} if signs.problem_text else {})
        reasons = " and ".join(words[name] for name in fault_names(faults))
        if Fault.SIGNS in faults and signs.problem_text:
            return f"forces are off because {reasons}: {signs.advice}"
        return f"forces are off because {reasons}: `hapticd force on` or set_forces turns them on again"


# The params of `set_operator` are those of an operator file: config/operator.py validates them.
_METHOD_HANDLERS: Final[Mapping[str, tuple[type[Model] | None, _Handler]]] = {
    "get_status": (GetStatusParams, Methods._get_status),
    "get_state": (NoParams, Methods._get_state),
    "get_config": (NoParams, Methods._get_config),
    "get_scene": (NoParams, Methods._get_scene),
    "set_scene": (SetSceneParams, Methods._set_scene),
    "update_scene": (UpdateSceneParams, Methods._update_scene),
    "get_materials": (NoParams, Methods._get_materials),
    "set_materials": (SetMaterialsParams, Methods._set_materials),
    "update_materials": (UpdateMaterialsParams, Methods._update_materials),
    "apply": (ApplyParams, Methods._apply),
    "play": (PlayParams, Methods._play),
    "reset": (ResetParams, Methods._reset),
    "mark": (MarkParams, Methods._mark),
    "set_forces": (SetForcesParams, Methods._set_forces),
    "set_operator": (None, Methods._set_operator),
    "stream_target": (StreamTargetParams, Methods._stream_target),
    "stream_force": (StreamForceParams, Methods._stream_force),
    "lease": (LeaseParams, Methods._lease_request),
    "reload": (ReloadParams, Methods._reload),
    "dump_flight": (NoParams, Methods._dump_flight),
}
METHOD_PARAMS: Final[Mapping[str, type[Model] | None]] = {name: model for name, (model, _) in _METHOD_HANDLERS.items()}
"""The model that validates the params of each method; None: config/operator.py validates them."""
