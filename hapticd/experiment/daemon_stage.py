"""Trials on a running daemon: forces under a lease, scenes replaced in one change, telemetry recorded."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Final, Self, cast

import numpy as np

from hapticd._version import __version__
from hapticd.base.core import SAMPLE_DTYPE, Flag
from hapticd.base.errors import HapticdError
from hapticd.base.yaml_source import Json
from hapticd.client.blocking import Client, Subscription
from hapticd.client.samples import SampleBatch
from hapticd.config.configuration import Config
from hapticd.config.materials import shipped_materials
from hapticd.experiment.event_codes import EventCode
from hapticd.experiment.front import Seen
from hapticd.experiment.stage import ForcesLost, ForcesStopped, Motion, Samples, Telemetry
from hapticd.experiment.trial_scenes import membranes
from hapticd.protocol.calls import RemoteError
from hapticd.protocol.messages import Code
from hapticd.protocol.results import Event
from hapticd.recording.recording import load

LEASE_S: Final = 3.0
"""Forces fade out so long after the runner was killed or hangs."""
BEHIND_S: Final = 20.0
"""Telemetry of a trial is here by then, or the machine is too busy."""
FADE_S: Final = 5.0
"""The force is zero by then, or something is wrong."""
_GRACE_S: Final = 1.0
_ASKED_AGAIN_S: Final = 0.1
"""Between two tries to take a lease that somebody holds; nothing tells when one lapses."""
_KEPT: Final = ("version", "protocol", "started_ns", "device", "rate_hz", "realtime", "undisplayable")


class DaemonStage:
    """A stage that a client of a daemon makes; a context that holds the daemon's lease."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._held = client.hold_lease(LEASE_S)
        self._token = ""
        self._enabled = False
        self._revision: int | None = None
        self._membranes: tuple[Seen, ...] = ()
        """Of the scene that is armed."""
        self._file: Path | None = None

    def __enter__(self) -> Self:
        # Off before the lease: taking it turns nothing on, and nobody feels the scene of before.
        self._client.set_forces(False)
        deadline = time.monotonic() + LEASE_S + _GRACE_S
        while True:
            try:
                self._token = self._held.__enter__()
                return self
            except RemoteError as error:
                # A runner that was killed holds the lease until it lapses; another one does for longer.
                if error.code != Code.LEASE_HELD or time.monotonic() >= deadline:
                    raise
            self._held = self._client.hold_lease(LEASE_S)
            time.sleep(_ASKED_AGAIN_S)

    def __exit__(self, *error: object) -> None:
        self._held.__exit__(*error)  # type: ignore[arg-type]

    def describe(self) -> dict[str, Json]:
        """The daemon's version, device, configuration (with its calibration) and rights."""
        status = self._client.get_status()
        told = {name: value for name, value in cast("dict[str, Json]", status).items() if name in _KEPT}
        return {
            "kind": "daemon",
            "client": __version__,
            **told,
            "config": cast("Json", self._client.get_config()["config"]),
        }

    def check(self) -> None:
        """As `Stage.check`; DaemonNotRunning where the daemon is gone."""
        status = self._client.get_status()
        if status["faults"]:
            faults = ", ".join(status["faults"])
            raise ForcesLost(f"the daemon took the forces away ({faults}); see docs/protocol.md, Faults")
        if self._enabled and status["forces"] != "on":
            raise ForcesStopped("somebody else switched the forces off")

    def arm(self, config: Config) -> None:
        """As `Stage.arm`: `apply` replaces scene and materials together, `reset` heals what was broken."""
        self.fade()
        known = shipped_materials()
        materials = {
            name: material.to_dict()
            for name, material in config.materials.items()
            if name not in known or material != known[name]
        }
        # Without materials of its own a scene is a change, too.
        changed = self._client.apply(materials=materials or None, scene=config.scene, wait=True)
        self._client.reset()
        self._revision = changed["revision"]
        self._membranes = membranes(config)

    def is_clear(self) -> bool:
        """By the newest sample."""
        state = self._client.get_state()
        x, y = state["position_m"]
        from_membranes = [each.from_surface((x, y)) for each in self._membranes]
        return not state["touching"] and not any(beyond == 0.0 and above < 0.0 for beyond, above in from_membranes)

    def enable(self) -> None:
        """Raises where another client changed the scene since it was armed, the lease lapsed, or a fault stays."""
        revision = self._client.get_status()["revision"]
        if revision != self._revision:
            raise HapticdError(
                f"another client changed the scene (revision {revision}, not {self._revision}); "
                "leave the daemon to the experiment, and resume"
            )
        # No forces without a lease: one that lapsed while they were off is not renewed, and they would stay on.
        self._client.lease(LEASE_S, self._token)
        self._client.reset()  # the handle may have gone through a membrane while the forces were off
        self._client.set_forces(True)
        self._enabled = True

    def fade(self) -> None:
        """Returns once forces are off and the command is zero."""
        self._enabled = False
        self._client.set_forces(False)
        deadline = time.monotonic() + FADE_S
        with self._client.states(newest=True) as states:
            while (state := states.receive(FADE_S)) is not None and time.monotonic() < deadline:
                if not state["flags"] & Flag.FORCES_ON and state["force_n"] == [0.0, 0.0]:
                    return
        raise HapticdError(f"the force is not zero {FADE_S:g} s after it was switched off; stop the device by hand")

    def mark(self, text: str, data: Json) -> None:
        """A mark in the event stream, which every client may read: event codes without names."""
        self._client.mark(text, data)

    @contextmanager
    def recording(self, target: Path, notes: Mapping[str, Json]) -> Iterator[None]:
        """Every tick and event into `target`, a .npz."""
        with self._client.record(target, overwrite=False, **notes) as recorder, self._client.events() as events:
            yield
            self._await_telemetry(events)
        self._file = Path(recorder.result.file)

    def _await_telemetry(self, events: Subscription[Event]) -> None:
        """Telemetry may be behind where the machine is busy: the recording goes on until the trial's end is sent."""
        tick = self._client.mark("recorded")["tick"]
        deadline = time.monotonic() + BEHIND_S
        while (left_s := deadline - time.monotonic()) > 0:
            event = events.receive(left_s)
            if event is not None and event["event"] == "mark" and cast(int, event["tick"]) >= tick:
                return
        raise HapticdError(f"telemetry is more than {BEHIND_S:g} s behind: the machine is too busy to record a trial")

    def move(self, motion: Motion) -> Samples:
        """The simulated joystick's hand goes its way in real time; the samples from its first tick to its last.

        With a reaction it is taken off its way at the time that the reaction says, or as soon after as samples come.
        """
        with self._client.samples() as batches:
            started = self._client.set_operator(motion.waypoints)
            first, period_s = started["tick"], 1.0 / self._client.get_status()["rate_hz"]
            ends = first + round(started["duration_s"] / period_s)
            taken: list[Samples] = []
            reacting = motion.reaction
            for samples in _of(batches, first):
                taken.append(samples)
                if reacting is not None:
                    at_s = reacting.noticed_s(np.concatenate(taken))
                    now_s = (int(samples["tick"][-1]) + 1 - first) * period_s
                    if at_s is not None and now_s >= at_s - _BATCH_S:
                        rest = reacting.then(at_s)
                        # Times of waypoints count from the command: those that are over have come too late.
                        rest = rest - np.array([now_s, 0.0, 0.0])
                        rest = rest[rest[:, 0] > _BATCH_S]
                        again = self._client.set_operator(rest)
                        ends = again["tick"] + round(again["duration_s"] / period_s)
                        reacting = None
                if int(samples["tick"][-1]) >= ends:
                    break
        return np.concatenate(taken)

    def telemetry(self) -> Telemetry:
        """Read from the file of the trial, as anybody reads it later."""
        if self._file is None:
            raise HapticdError("no trial was recorded yet")
        found = load(self._file)
        begun = [mark["tick"] for mark in found.marks if mark["text"] == EventCode.INTERVAL.text]
        ended = [mark["tick"] for mark in found.marks if mark["text"] == EventCode.ANSWER.text]
        ticks = found.samples["tick"]
        inside = ticks >= (begun[-1] if begun else 0)
        if ended:
            inside &= ticks <= ended[-1]
        first = begun[-1] if begun else 0
        return Telemetry(found.samples[inside], [each for each in found.events if each["tick"] >= first])


_BATCH_S: Final = 0.02
"""Between two batches of samples."""


def _of(batches: Subscription[SampleBatch], first: int) -> Iterator[Samples]:
    """The samples from a tick on, as plain arrays; without empty ones."""
    for batch in batches:
        samples = np.asarray(batch.view(np.ndarray))[batch["tick"] >= first].astype(SAMPLE_DTYPE, copy=False)
        if len(samples):
            yield samples
