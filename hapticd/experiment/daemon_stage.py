"""The stage (renderer) for trials on a running daemon: it holds the lease, replaces scenes and records telemetry."""

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

RUNNER_LEASE_S: Final = 3.0
"""Duration of the lease, the right to use forces. Forces fade when it lapses because the process hangs or died."""
TELEMETRY_LAG_TIMEOUT_S: Final = 20.0
"""Longest wait for the telemetry of a trial after its end. A machine that takes longer is too busy to record."""
FADE_TIMEOUT_S: Final = 5.0
"""The force must be zero within this time after the forces were switched off."""
_LEASE_GRACE_S: Final = 1.0
"""The stage waits for the end of another client's lease for RUNNER_LEASE_S plus this time."""
_LEASE_RETRY_S: Final = 0.1
"""Time between two attempts to get the lease from another client. The daemon does not report when a lease lapses."""
_DESCRIBED_STATUS_KEYS: Final = ("version", "protocol", "started_ns", "device", "rate_hz", "realtime", "undisplayable")
"""Keys of the daemon's status that are stored with the session."""
_SAMPLE_BATCH_S: Final = 0.02
"""Time between two batches of samples from the daemon."""


class DaemonStage:
    """A renderer of trials on a running daemon; a context manager that holds the lease, the right to use the forces."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._held = client.hold_lease(RUNNER_LEASE_S)
        self._token = ""
        self._enabled = False
        self._revision: int | None = None
        self._membranes: tuple[Seen, ...] = ()
        """Surfaces of the membranes of the armed scene."""
        self._file: Path | None = None

    def __enter__(self) -> Self:
        # Forces are off before the lease is held, so that the participant does not feel the previous scene.
        self._client.set_forces(False)
        deadline = time.monotonic() + RUNNER_LEASE_S + _LEASE_GRACE_S
        while True:
            try:
                self._token = self._held.__enter__()
                return self
            except RemoteError as error:
                # A killed process's lease lapses before the deadline. A running process renews its lease.
                if error.code != Code.LEASE_HELD or time.monotonic() >= deadline:
                    raise
            self._held = self._client.hold_lease(RUNNER_LEASE_S)
            time.sleep(_LEASE_RETRY_S)

    def __exit__(self, *error: object) -> None:
        self._held.__exit__(*error)  # type: ignore[arg-type]

    def describe(self) -> dict[str, Json]:
        """Return the daemon's version, device, configuration (with its calibration) and real-time rights."""
        status = cast("dict[str, Json]", self._client.get_status())
        return {
            "kind": "daemon",
            "client": __version__,
            **{name: value for name, value in status.items() if name in _DESCRIBED_STATUS_KEYS},
            "config": cast("Json", self._client.get_config()["config"]),
        }

    def check(self) -> None:
        """Check that a fault or another client has not switched the forces off.

        Raises ForcesLost after a fault, ForcesStopped if another client switched the forces off after `enable`, and
        DaemonNotRunning if the daemon has ended.
        """
        status = self._client.get_status()
        if status["faults"]:
            faults = ", ".join(status["faults"])
            raise ForcesLost(
                f"the daemon switched the forces off after a fault ({faults}); see docs/reference/events.md, Faults"
            )
        if self._enabled and status["forces"] != "on":
            raise ForcesStopped("another client switched the forces off")

    def arm(self, config: Config) -> None:
        """Switch the forces off, replace scene and materials, and restore ruptured membranes."""
        self.fade()
        known = shipped_materials()
        materials = {
            name: material.to_dict()
            for name, material in config.materials.items()
            if name not in known or material != known[name]
        }
        changed = self._client.apply(materials=materials or None, scene=config.scene, wait=True)
        self._client.reset()
        self._revision = changed["revision"]
        self._membranes = membranes(config)

    def is_clear(self) -> bool:
        """Return whether the handle is outside every object and in front of every membrane, by the newest state."""
        state = self._client.get_state()
        x, y = state["position_m"]
        from_membranes = [each.from_surface((x, y)) for each in self._membranes]
        return not state["touching"] and not any(beyond == 0.0 and above < 0.0 for beyond, above in from_membranes)

    def enable(self) -> None:
        """Switch the forces on.

        Raises HapticdError if another client changed the scene since `arm`, the lease lapsed, or a fault persists.
        """
        revision = self._client.get_status()["revision"]
        if revision != self._revision:
            raise HapticdError(
                f"another client changed the scene (revision is {revision}, must be {self._revision}); "
                "disconnect other clients from the daemon, and resume"
            )
        # This raises if the lease lapsed meanwhile. Without a lease the forces would stay on if this process died.
        self._client.lease(RUNNER_LEASE_S, self._token)
        self._client.reset()  # the handle may have gone through a membrane while the forces were off
        self._client.set_forces(True)
        self._enabled = True

    def fade(self) -> None:
        """Switch the forces off, and return when the commanded force is zero.

        Raises HapticdError if the force is not zero after FADE_TIMEOUT_S.
        """
        self._enabled = False
        self._client.set_forces(False)
        deadline = time.monotonic() + FADE_TIMEOUT_S
        with self._client.states(newest=True) as states:
            while (state := states.receive(FADE_TIMEOUT_S)) is not None and time.monotonic() < deadline:
                if not state["flags"] & Flag.FORCES_ON and state["force_n"] == [0.0, 0.0]:
                    return
        raise HapticdError(
            f"the force is not zero {FADE_TIMEOUT_S:g} s after the forces were switched off; switch the device off"
        )

    def mark(self, text: str, data: Json) -> None:
        """Add a mark, a text with data, to the daemon's event stream.

        Every client can read marks, so a mark must not name a stimulus.
        """
        self._client.mark(text, data)

    @contextmanager
    def recording(self, target: Path, notes: Mapping[str, Json]) -> Iterator[None]:
        """Record every sample and event into `target`, a .npz file, until the context ends."""
        with self._client.record(target, overwrite=False, **notes) as recorder, self._client.events() as events:
            yield
            self._await_telemetry(events)
        self._file = Path(recorder.result.file)

    def _await_telemetry(self, events: Subscription[Event]) -> None:
        """Wait until the daemon has sent all telemetry of the trial."""
        tick = self._client.mark("recorded")["tick"]
        deadline = time.monotonic() + TELEMETRY_LAG_TIMEOUT_S
        while (left_s := deadline - time.monotonic()) > 0:
            event = events.receive(left_s)
            if event is not None and event["event"] == "mark" and cast(int, event["tick"]) >= tick:
                return
        raise HapticdError(
            f"telemetry lags more than {TELEMETRY_LAG_TIMEOUT_S:g} s: the machine is too busy to record a trial"
        )

    def move(self, motion: Motion) -> Samples:
        """Move the simulated joystick's hand in real time, and return the samples from the first tick to the last.

        If the motion has a reaction, the hand leaves its path at the time of the reaction, or with the first batch of
        samples after that time.
        """
        with self._client.samples() as batches:
            started = self._client.set_operator(motion.waypoints)
            first, period_s = started["tick"], 1.0 / self._client.get_status()["rate_hz"]
            ends = first + round(started["duration_s"] / period_s)
            taken: list[Samples] = []
            reacting = motion.reaction
            for samples in _sample_arrays(batches, first):
                taken.append(samples)
                if reacting is not None:
                    at_s = reacting.noticed_s(np.concatenate(taken))
                    now_s = (int(samples["tick"][-1]) + 1 - first) * period_s
                    if at_s is not None and now_s >= at_s - _SAMPLE_BATCH_S:
                        rest = reacting.then(at_s)
                        # Times of waypoints count from the command. Waypoints whose time has passed are dropped.
                        rest = rest - np.array([now_s, 0.0, 0.0])
                        rest = rest[rest[:, 0] > _SAMPLE_BATCH_S]
                        again = self._client.set_operator(rest)
                        ends = again["tick"] + round(again["duration_s"] / period_s)
                        reacting = None
                if int(samples["tick"][-1]) >= ends:
                    break
        return np.concatenate(taken)

    def telemetry(self) -> Telemetry:
        """Return the telemetry of the last interval of the last recorded trial, read from the trial's .npz file."""
        if self._file is None:
            raise HapticdError("no trial has been recorded yet")
        found = load(self._file)
        begun = [mark["tick"] for mark in found.marks if mark["text"] == EventCode.INTERVAL.text]
        ended = [mark["tick"] for mark in found.marks if mark["text"] == EventCode.ANSWER.text]
        ticks, first = found.samples["tick"], begun[-1] if begun else 0
        inside = ticks >= first
        if ended:
            inside &= ticks <= ended[-1]
        return Telemetry(found.samples[inside], [each for each in found.events if each["tick"] >= first])


def _sample_arrays(batches: Subscription[SampleBatch], first: int) -> Iterator[Samples]:
    """Yield the samples from tick `first` on, one plain array per batch. Batches without such samples are skipped."""
    for batch in batches:
        samples = np.asarray(batch.view(np.ndarray))[batch["tick"] >= first].astype(SAMPLE_DTYPE, copy=False)
        if len(samples):
            yield samples
