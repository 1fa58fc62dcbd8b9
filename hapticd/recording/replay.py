"""Replay of recordings: the servo's tick renders the recorded input again, and the forces are compared.

The force of a tick is a function of scene, state and input. Samples hold the input: position, velocity, time, and
whether forces were on. A recording also holds the scenes and the commands `play` and `reset`, but not the state. So a
replay begins where the state is known: at tick 0, or at a tick without contacts, ringing modes and ramps. It begins
again after missing ticks, a fault, a change of the rate, or a streamed force, which recordings do not hold. Rendered
forces should equal the recorded ones, bit for bit. Otherwise the recording lacks something that affects forces.

A file of the flight recorder holds all commands from the tick `complete_from` on; earlier ticks are not rendered.

A recording does not hold the number of earlier contacts of an object (which selects its noise), membranes that were
punctured before, effects that the device played, the time within a period at which a real device's report arrived, and
the order in which the forces of objects that are touched at once were summed (the last bits of the sum).
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from hapticd.base import wording
from hapticd.base.core import SAMPLE_DTYPE, Flag
from hapticd.base.errors import HapticdError
from hapticd.config.configuration import Device, load_config
from hapticd.config.materials import Material, validate_materials
from hapticd.config.modes import Mode
from hapticd.config.scene import Scene, materials_of, validate_object, validate_scene
from hapticd.config.texture import Autoregressive, Stochastic
from hapticd.protocol.changes import MAX_FLIGHT_OBJECTS, MAX_FLIGHT_PARTS
from hapticd.protocol.events import event_map
from hapticd.recording.missed_periods import rates_of
from hapticd.recording.recording import Recording, load, recording_into, recording_path
from hapticd.recording.writer import Samples
from hapticd.rendering.device_output import output_of
from hapticd.rendering.offline import Rerun

FORCE_FIELDS: Final = ("contact_force_n", "vibration_force_n", "force_n")
"""Fields of recorded and rendered samples that are compared."""

REQUIRED_TEXTS: Final = ("config", "scene", "materials", "changes")
"""Texts that a recording must hold to be rendered again."""

_REASON_OF_LEFT_OUT: Final = {
    "fault": "with a fault latched",
    "scene": "whose scene is not in the file",
    "streamed": "with a streamed force",
    "begun_before": "with an unknown state",
}
"""Text in `Replay.summary` for each key of `Replay.left_out`."""
_UNSETTLED_FLAGS: Final = int(Flag.CONTACT | Flag.RINGING | Flag.RAMPING | Flag.GLITCH | Flag.REPEATED)
"""A replay cannot begin at a tick with one of these flags, as its state depends on earlier ticks."""
_MAX_PERIODS: Final = 0xFFFFFFFF
"""Maximum number of periods between two ticks, as the core counts them with 32 bits."""


@dataclass(frozen=True, slots=True)
class Difference:
    """Maximum and RMS of the magnitude of the recorded minus the rendered force, in N."""

    largest_n: float
    rms_n: float


@dataclass(frozen=True, slots=True)
class Replay:
    """A recording that was rendered again."""

    samples: Samples
    """Rendered samples, records of SAMPLE_DTYPE, shape (m,)."""
    recorded: Samples
    """Recorded samples of the same ticks, shape (m,)."""
    events: list[dict[str, object]]
    """Events of the rendered ticks."""
    ticks: int
    """Number of ticks of the recording."""
    identical: int
    """Number of ticks whose three forces equal the recorded ones, bit for bit."""
    first_different: int | None
    """First tick whose rendered force differs from the recorded one; None without such a tick."""
    differences: dict[str, Difference]
    """Difference of the forces over all rendered ticks, for each of FORCE_FIELDS."""
    missing_revisions: tuple[int, ...]
    """Revisions of the scene that the recording lacks; their ticks were not rendered."""
    left_out: Mapping[str, int]
    """Number of ticks that were not rendered, by reason: `fault` (a fault was latched), `scene` (the file lacks the
    scene), `streamed` (a force was streamed), `begun_before` (a contact, mode or ramp began before the recording, or
    the file lacks an earlier `play`)."""
    doubts: tuple[str, ...]
    """Sentences on possible reasons for different forces; empty if all forces are identical."""
    settled: bool
    """Whether the state is known at any tick. If not, the replay assumes that nothing acted before the recording."""
    texts: Mapping[str, Any]
    """Texts of the recording; see `hapticd.Recording`."""
    source: str | os.PathLike[str]
    """Path of the replayed recording."""

    def summary(self) -> str:
        """Return the result of the replay as one line of text."""
        ticks = len(self.samples)
        text = f"{ticks:,} of {wording.count(self.ticks, 'tick')} rendered again, "
        if self.identical == ticks:
            text += "all as recorded, bit for bit"
        else:
            force = self.differences["force_n"]
            text += f"{ticks - self.identical:,} not as recorded, the first is tick {self.first_different}; "
            text += f"the force differs by {force.largest_n:.3g} N at most, {force.rms_n:.3g} N RMS"
        if self.left_out:
            text += f"; left out: {_left_out_text(self.left_out)}"
        if not self.settled:
            text += "; each has a contact, a ringing mode or a ramp"
        if self.missing_revisions:
            text += f"; {wording.count(len(self.missing_revisions), 'revision')} of the scene missing"
        return text + "".join(f"; {doubt}" for doubt in self.doubts)

    def write(self, target: str | os.PathLike[str], overwrite: bool = False) -> None:
        """Write the rendered ticks as another recording.

        Raises HapticdError if the target cannot be written, already exists, or is the replayed recording.
        """
        made = recording_path(target)
        if made.exists() and made.samefile(self.source):
            raise HapticdError(f"{os.fspath(target)}: {made} is the replayed recording; give another name")
        with recording_into(target, overwrite) as writer:
            last = ("changes", "recording", "flight")
            first = {name: text for name, text in self.texts.items() if name not in last}
            writer.write_all(first, self.texts["changes"], self.samples, self.events)
            about = self.texts.get("recording")
            clocks = {name: about.get(name) for name in ("started", "ended")} if isinstance(about, dict) else {}
            writer.finish({"recording": clocks})

    def to_dict(self) -> dict[str, object]:
        """Return the result of the replay as a mapping for JSON, without samples and events."""
        return {
            "ticks": self.ticks,
            "replayed": len(self.samples),
            "identical": self.identical,
            "first_different": self.first_different,
            "differences": {name: asdict(one) for name, one in self.differences.items()},
            "missing_revisions": list(self.missing_revisions),
            "left_out": dict(self.left_out),
            "doubts": list(self.doubts),
            "settled": self.settled,
        }


def replay(path: str | os.PathLike[str]) -> Replay:
    """Render a recording (.npz) again, and compare the forces. It takes about 400 bytes of memory per sample.

    Raises HapticdError if the file is not a recording, lacks one of REQUIRED_TEXTS, or holds values that this version
    refuses.
    """
    recorded = load(path)
    missing = [name for name in REQUIRED_TEXTS if not recorded.texts.get(name)]
    if "flight" in recorded.texts and "config" not in missing and "scene" in missing:
        raise HapticdError(
            f"{os.fspath(path)}: cannot be rendered again: files of the flight recorder do not hold scenes of more "
            f"than {MAX_FLIGHT_OBJECTS:,} objects, or {MAX_FLIGHT_PARTS:,} patches and models"
        )
    if missing:
        raise HapticdError(f"{os.fspath(path)}: cannot be rendered again: it holds no {', '.join(missing)}")
    try:
        return _replay(recorded)
    except HapticdError as error:
        raise HapticdError(f"{os.fspath(path)}: {error}") from None
    except MemoryError:
        raise HapticdError(f"{os.fspath(path)}: not enough memory") from None
    except (LookupError, TypeError, AttributeError, ValueError, ArithmeticError, RecursionError) as error:
        raise HapticdError(f"{os.fspath(path)}: cannot be rendered again: {error!r}") from None


def _replay(recorded: Recording) -> Replay:
    samples, texts = recorded.samples, recorded.texts
    servo, status = texts["config"]["servo"], texts.get("status") or {}
    # After a step down the daemon's rate differs from its configuration.
    rate_hz = status.get("rate_hz", servo["rate_hz"])
    revisions = list(_revisions(texts, set(np.unique(samples["revision"]).tolist()), rate_hz))
    known = [revision.number for revision in revisions]
    rates_hz = rates_of(samples, texts["changes"], rate_hz)
    # Files of the flight recorder hold all commands from the tick `complete_from` on; other recordings hold all.
    complete_from = int((texts.get("flight") or {}).get("complete_from", 0))
    is_known = np.isin(samples["revision"], known) & (samples["tick"] >= complete_from)
    segments, settled = _segments(samples, rates_hz, is_known, texts)
    link_hz = (status.get("connection") or {}).get("link_hz")

    device = texts["config"]["device"]
    configs = {
        hz: load_config({"servo": {**servo, "rate_hz": hz}, "device": device})
        for hz in {rate_hz, *(revision.rate_hz for revision in revisions)}
    }
    outputs = {
        hz: output_of(config, hz, None if link_hz is None or link_hz >= hz else link_hz)
        for hz, config in configs.items()
    }
    rerun = Rerun(outputs[rate_hz], max((len(revision.scene.objects) for revision in revisions), default=0))
    periods = _periods(samples, rates_hz)
    intervals = _intervals(samples, periods, rates_hz, configs[rate_hz].device)
    commands = _commands(texts)
    index = -1
    count = sum(segment.stop - segment.start for segment, _ in segments)
    again, at = np.empty(count, SAMPLE_DTYPE), 0
    events: list[dict[str, object]] = []
    for segment, muted in segments:
        rerun.restart(muted)
        if rates_hz[segment.start] != rate_hz:  # its first revision is set below
            rate_hz = float(rates_hz[segment.start])
            rerun.change_rate(outputs[rate_hz])
        periods[segment.start] = 1
        for part in _split(samples, segment, commands):
            number = int(samples["revision"][part.start])
            if index < 0 or known[index] != number:
                index = _change_scene(rerun, revisions, index, known.index(number))
            for command in commands.get(int(samples["tick"][part.start]), ()):
                _carry_out(rerun, command, int(samples["time_ns"][part.start]))
            rendered, happened = rerun.run(samples[part], intervals[part], periods[part])
            again[at : at + len(rendered)] = rendered
            at += len(rendered)
            events += [event_map(event, rerun.name_of(event)) for event in happened]
    if not count:
        raise HapticdError(f"no tick can be rendered again: {_left_out_text(_left_out(samples, known, 0))}")
    before = samples
    if count < len(samples):
        before = np.concatenate([samples[segment] for segment, _ in segments])
    different = np.zeros(len(again), bool)
    for name in FORCE_FIELDS:
        different |= (again[name].view(np.uint64) != before[name].view(np.uint64)).any(axis=1)
    first = int(before["tick"][np.argmax(different)]) if different.any() else None
    missing = sorted(set(np.unique(samples["revision"]).tolist()) - set(known))
    return Replay(
        again,
        before,
        events,
        len(samples),
        int(len(again) - different.sum()),
        first,
        {name: _difference(again[name] - before[name]) for name in FORCE_FIELDS},
        tuple(missing),
        _left_out(samples, known, len(again)),
        _doubts(configs[rate_hz].device, revisions) if different.any() else (),
        settled,
        texts,
        recorded.path,
    )


def _left_out(samples: Samples, known: list[int], rendered: int) -> dict[str, int]:
    """Return the number of ticks that were not rendered, by reason (see `Replay.left_out`)."""
    faults = samples["flags"] & Flag.FAULT != 0
    unknown = ~np.isin(samples["revision"], known) & ~faults
    streamed = (samples["flags"] & Flag.STREAMED != 0) & ~faults & ~unknown
    counts = {"fault": int(faults.sum()), "scene": int(unknown.sum()), "streamed": int(streamed.sum())}
    counts["begun_before"] = len(samples) - rendered - sum(counts.values())
    return {why: count for why, count in counts.items() if count}


def _left_out_text(left_out: Mapping[str, int]) -> str:
    return ", ".join(f"{count:,} {_REASON_OF_LEFT_OUT[why]}" for why, count in left_out.items())


def _difference(between: npt.NDArray[np.float64]) -> Difference:
    square = (between**2).sum(axis=1)
    return Difference(float(np.sqrt(square.max())), float(np.sqrt(square.mean())))


def _doubts(device: Device, revisions: list[_Revision]) -> tuple[str, ...]:
    """Return sentences on influences that recordings do not hold, as possible reasons for different forces."""
    noise = any(
        isinstance(revision.materials[name].texture, Stochastic | Autoregressive)
        for revision in revisions
        for item in revision.scene.objects.values()
        for name in materials_of(item)
        if name in revision.materials
    )
    membranes = any(item.kind == "membrane" for revision in revisions for item in revision.scene.objects.values())
    doubts = []
    if noise:
        doubts.append("noise of textures depends on the number of earlier contacts")
    if membranes:
        doubts.append("membranes may have been punctured before")
    if device.kind != "sim":
        doubts.append("the arrival of the device's reports within a period is not recorded")
        if device.hid.offload == "auto":
            doubts.append("effects that the device played are not recorded")
    return tuple(doubts)


# ---- Scenes ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Revision:
    number: int
    scene: Scene
    materials: Mapping[str, Material]
    changed: tuple[str, ...]
    """Ids of objects that changed since the previous _Revision, the first change first."""
    rate_hz: float


def _revisions(texts: Mapping[str, Any], wanted: set[int], rate_hz: float) -> Iterator[_Revision]:
    """Yield those revisions of the scene whose numbers are in `wanted`, in order."""
    scene = validate_scene(texts["scene"], ("scene",))
    materials: dict[str, Material] = validate_materials(texts["materials"])
    pending = dict.fromkeys(scene.objects)
    for change in texts["changes"]:
        if "revision" not in change:
            continue
        objects = {
            id: None if item is None else validate_object(id, item, ("changes",))
            for id, item in change.get("objects", {}).items()
        }
        if objects:
            scene = scene.with_objects(objects)
        pending |= dict.fromkeys(objects)
        if "scene" in change:
            shown = validate_scene({**scene.model_copy(update={"objects": {}}).to_dict(), **change["scene"]})
            scene = shown.model_copy(update={"objects": scene.objects})
        if "materials" in change:
            patch = change["materials"]
            new = validate_materials({name: item for name, item in patch.items() if item is not None})
            materials = {name: item for name, item in materials.items() if name not in patch} | new
        rate_hz = change.get("rate_hz", rate_hz)
        if change["revision"] in wanted:
            yield _Revision(change["revision"], scene, materials, tuple(pending), rate_hz)
            pending = {}


def _change_scene(rerun: Rerun, revisions: list[_Revision], index: int, to: int) -> int:
    """Change the scene of a rerun from `revisions[index]` (`index` < 0: no scene) to `revisions[to]`; return `to`."""
    if to > index:
        changed = [id for revision in revisions[index + 1 : to + 1] for id in revision.changed]
    else:
        changed = [*revisions[index].scene.objects, *revisions[to].scene.objects]
    revision = revisions[to]
    # The order of the changed objects determines the order in which forces are summed.
    rerun.turn_to(revision.scene, dict.fromkeys(changed), revision.materials, revision.number)
    return to


# ---- Begin, and input of each tick -----------------------------------------------------------------------------------


def _segments(
    samples: Samples, rates_hz: npt.NDArray[np.float64], known: npt.NDArray[np.bool_], texts: Mapping[str, Any]
) -> tuple[list[tuple[slice, bool]], bool]:
    """Return the segments of consecutive ticks to render, and whether the state at their beginnings is known.

    Each segment has a flag: whether its commanded force begins at zero and rises over the ramp.
    """
    flags = samples["flags"]
    usable = known & (flags & (Flag.FAULT | Flag.STREAMED) == 0)
    follows = np.diff(samples["tick"].astype(np.int64), prepend=-2) == 1
    follows &= np.diff(rates_hz, prepend=rates_hz[:1]) == 0.0
    begins = np.flatnonzero(usable & ~(follows & np.roll(usable, 1)))
    ends = np.flatnonzero(usable & ~np.append((follows & usable)[1:], False)) + 1
    at_start = samples["tick"] == 0
    # A replay begins at the second of two quiet ticks: a removed object still acts in the last tick of its ramp.
    quiet = flags & _UNSETTLED_FLAGS == 0
    fit = (quiet & np.roll(quiet, 1) & follows) | at_start
    runs = list(zip(begins.tolist(), ends.tolist(), strict=True))
    settled = bool((usable & fit).any())
    segments = []
    for begin, end in runs:
        if settled:
            left = np.flatnonzero(fit[begin:end])
            if len(left) == 0:
                continue
            begin += int(left[0])
        # When a daemon starts, its command rises over the ramp; that of a simulation does not.
        # During the check of signs the command is zero.
        on = int(flags[begin]) & (Flag.FORCES_ON | Flag.CHECKING) == Flag.FORCES_ON
        muted = "status" in texts if at_start[begin] else not on
        segments.append((slice(begin, end), muted))
    return segments, settled


def _split(samples: Samples, segment: slice, commands: Mapping[int, object]) -> Iterator[slice]:
    """Divide a segment of ticks where the scene's revision changes and where commands take effect."""
    inside = samples[segment]
    edges = {0, len(inside), *(np.flatnonzero(np.diff(inside["revision"])) + 1).tolist()}
    first = int(inside["tick"][0])
    edges |= {tick - first for tick in commands if 0 < tick - first < len(inside)}
    for begin, end in pairwise(sorted(edges)):
        yield slice(segment.start + begin, segment.start + end)


def _commands(texts: Mapping[str, Any]) -> dict[int, list[dict[str, Any]]]:
    """Return the commands `play` and `reset` by the tick at which they took effect."""
    commands: dict[int, list[dict[str, Any]]] = {}
    for change in texts["changes"]:
        if "tick" in change:
            commands.setdefault(change["tick"], []).append(change)
    return commands


def _carry_out(rerun: Rerun, command: Mapping[str, Any], time_ns: int) -> None:
    if "play" in command:
        play = command["play"]
        mode = Mode(play["decay_rate_per_s"], play["angular_frequency_rad_per_s"])
        rerun.play(mode, play["attack"], tuple(play["direction"]), play["amplitude_m_per_s2"])
    if "reset" in command:
        rerun.reset(command["reset"].get("objects"), time_ns)


def _periods(samples: Samples, rates_hz: npt.NDArray[np.float64]) -> npt.NDArray[np.uint32]:
    """Return the number of periods from the previous tick to each tick, shape (n,); above 1 if periods were missed."""
    elapsed = np.diff(samples["time_ns"], prepend=samples["time_ns"][:1]) * (rates_hz / 1e9)
    missed = samples["flags"] & Flag.SKIPPED != 0
    return np.where(missed, np.clip(np.rint(elapsed), 1, _MAX_PERIODS), 1).astype(np.uint32)


def _intervals(
    samples: Samples, periods: npt.NDArray[np.uint32], rates_hz: npt.NDArray[np.float64], device: Device
) -> npt.NDArray[np.float64]:
    """Return the time (s) from the previous position report to that of each tick, (n,); 0 without a new report."""
    report_s = device.sim.reports_s[0] if device.kind == "sim" else 0.0
    fresh = samples["flags"] & Flag.REPEATED == 0
    intervals = np.zeros(len(samples))
    places = np.flatnonzero(fresh)
    since = np.diff(np.cumsum(periods, dtype=np.int64)[places], prepend=0)
    elapsed = since * (1.0 / rates_hz[places])
    if report_s:
        elapsed = np.maximum(np.rint(elapsed / report_s), 1.0) * report_s
    intervals[places] = elapsed
    # The first tick has no previous report.
    intervals[samples["tick"] == 0] = 0.0
    return intervals
