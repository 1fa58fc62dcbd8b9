"""hapticd: a haptic daemon, and its computation of forces for Python programs without the daemon.

    with hapticd.connect() as daemon: ...         talk to a running daemon (hapticd.aio.connect for asyncio)
    hapticd.render(config, position_m)            forces for a path of positions, open loop
    hapticd.simulate(config, waypoints, 2.0)      closed loop with the simulated joystick
    hapticd.load("tap.npz")                       a recording: samples, events, marks, scene, materials

Names are loaded when they are first used, so that a client pays for no more than it needs.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Final

from hapticd._version import __version__

if TYPE_CHECKING:
    from hapticd import aio
    from hapticd.base.core import SAMPLE_DTYPE, Flag
    from hapticd.base.errors import HapticdError, InvalidError, Problem
    from hapticd.base.yaml_source import Json
    from hapticd.client.blocking import Client, Stream, Subscription, connect
    from hapticd.client.samples import SampleBatch
    from hapticd.config.configuration import Config, load_config
    from hapticd.config.materials import Friction, Material, Rupture, Tap
    from hapticd.config.modes import Mode
    from hapticd.config.scene import (
        Box,
        Constant,
        Disc,
        Membrane,
        Scene,
        SceneObject,
        Spring,
        Viscous,
        Wall,
        load_scene,
    )
    from hapticd.config.texture import Autoregressive, Grooves, Stochastic
    from hapticd.protocol.calls import (
        DaemonNotRunning,
        ForcesOff,
        MissedPeriods,
        RemoteError,
        TelemetryLoss,
        TimedOut,
        Topic,
    )
    from hapticd.protocol.results import (
        ConfigResult,
        Event,
        FlightResult,
        ForcesResult,
        GestureEnd,
        LeaseResult,
        MaterialsResult,
        OperatorResult,
        OperatorStatus,
        PlayResult,
        RevisionResult,
        SceneResult,
        State,
        Status,
        StreamStatus,
        TickResult,
        Warned,
    )
    from hapticd.recording.recording import Recording, load
    from hapticd.recording.replay import replay
    from hapticd.rendering.offline import render, simulate
    from hapticd.rendering.plausibility import ImplausibleValue
    from hapticd.sweeps.sweep import sweep

__all__ = [
    "SAMPLE_DTYPE",
    "Autoregressive",
    "Box",
    "Client",
    "Config",
    "ConfigResult",
    "Constant",
    "DaemonNotRunning",
    "Disc",
    "Event",
    "Flag",
    "FlightResult",
    "ForcesOff",
    "ForcesResult",
    "Friction",
    "GestureEnd",
    "Grooves",
    "HapticdError",
    "ImplausibleValue",
    "InvalidError",
    "Json",
    "LeaseResult",
    "Material",
    "MaterialsResult",
    "Membrane",
    "MissedPeriods",
    "Mode",
    "OperatorResult",
    "OperatorStatus",
    "PlayResult",
    "Problem",
    "Recording",
    "RemoteError",
    "RevisionResult",
    "Rupture",
    "SampleBatch",
    "Scene",
    "SceneObject",
    "SceneResult",
    "Spring",
    "State",
    "Status",
    "Stochastic",
    "Stream",
    "StreamStatus",
    "Subscription",
    "Tap",
    "TelemetryLoss",
    "TickResult",
    "TimedOut",
    "Topic",
    "Viscous",
    "Wall",
    "Warned",
    "__version__",
    "aio",
    "connect",
    "load",
    "load_config",
    "load_scene",
    "render",
    "replay",
    "simulate",
    "sweep",
]

_NAMES_OF_MODULE: Final = {
    "base.core": "SAMPLE_DTYPE Flag",
    "base.errors": "HapticdError InvalidError Problem",
    "base.yaml_source": "Json",
    "client.blocking": "Client Stream Subscription connect",
    "client.samples": "SampleBatch",
    "config.configuration": "Config load_config",
    "config.materials": "Friction Material Rupture Tap",
    "config.modes": "Mode",
    "config.scene": "Box Constant Disc Membrane Scene SceneObject Spring Viscous Wall load_scene",
    "config.texture": "Autoregressive Grooves Stochastic",
    "protocol.calls": "DaemonNotRunning ForcesOff MissedPeriods RemoteError TelemetryLoss TimedOut Topic",
    "protocol.results": "ConfigResult Event FlightResult ForcesResult GestureEnd LeaseResult MaterialsResult "
    "OperatorResult OperatorStatus PlayResult RevisionResult SceneResult State Status StreamStatus TickResult Warned",
    "recording.recording": "Recording load",
    "recording.replay": "replay",
    "rendering.offline": "render simulate",
    "rendering.plausibility": "ImplausibleValue",
    "sweeps.sweep": "sweep",
}
"""Public names by module; the imports above repeat them for type checkers."""
_MODULE_OF_NAME: Final = {name: module for module, names in _NAMES_OF_MODULE.items() for name in names.split()}


def __getattr__(name: str) -> object:
    if name == "aio":
        return importlib.import_module("hapticd.aio")
    home = _MODULE_OF_NAME.get(name)
    if home is None:
        raise AttributeError(f"module 'hapticd' has no attribute {name!r}")
    return getattr(importlib.import_module(f"hapticd.{home}"), name)


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
