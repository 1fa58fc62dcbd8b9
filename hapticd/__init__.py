"""hapticd: a haptic daemon, and the same tick for Python without it.

    with hapticd.connect() as daemon: ...         talk to a running daemon (hapticd.aio.connect for asyncio)
    hapticd.render(config, position_m)            forces for a path of positions, open loop
    hapticd.simulate(config, waypoints, 2.0)      closed loop with the simulated joystick
    hapticd.load("tap.npz")                       a recording: samples, events, marks, scene, materials

Names are loaded when they are first used, so that a client pays for no more than it needs.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from hapticd._version import __version__

if TYPE_CHECKING:
    from hapticd import aio
    from hapticd.calls import (
        DaemonNotRunning,
        ForcesOff,
        KeyRefused,
        MissedPeriods,
        RemoteError,
        TelemetryLoss,
        TimedOut,
        Topic,
    )
    from hapticd.client import Client, Subscription, connect
    from hapticd.config import Config, load_config
    from hapticd.core import SAMPLE_DTYPE, Flag
    from hapticd.errors import HapticdError, InvalidError, Problem
    from hapticd.materials import Friction, Material, Rupture, Tap
    from hapticd.mode import Mode
    from hapticd.offline import render, simulate
    from hapticd.recording import Recording, load
    from hapticd.replayed import replay
    from hapticd.results import (
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
        TickResult,
        Warned,
    )
    from hapticd.samples import SampleBatch
    from hapticd.scene import Box, Constant, Disc, Membrane, Scene, SceneObject, Spring, Viscous, Wall, load_scene
    from hapticd.texture import Autoregressive, Grooves, Stochastic
    from hapticd.yaml_source import Json

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
    "InvalidError",
    "Json",
    "KeyRefused",
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
]

_HOMES = {
    "ConfigResult": "results",
    "DaemonNotRunning": "calls",
    "Event": "results",
    "FlightResult": "results",
    "ForcesResult": "results",
    "GestureEnd": "results",
    "KeyRefused": "calls",
    "LeaseResult": "results",
    "MaterialsResult": "results",
    "OperatorResult": "results",
    "OperatorStatus": "results",
    "PlayResult": "results",
    "RemoteError": "calls",
    "RevisionResult": "results",
    "SceneResult": "results",
    "State": "results",
    "Status": "results",
    "ForcesOff": "calls",
    "MissedPeriods": "calls",
    "TelemetryLoss": "calls",
    "TickResult": "results",
    "TimedOut": "calls",
    "Topic": "calls",
    "Warned": "results",
    "Client": "client",
    "Subscription": "client",
    "connect": "client",
    "Config": "config",
    "load_config": "config",
    "SAMPLE_DTYPE": "core",
    "Flag": "core",
    "HapticdError": "errors",
    "InvalidError": "errors",
    "Problem": "errors",
    "Friction": "materials",
    "Material": "materials",
    "Rupture": "materials",
    "Tap": "materials",
    "Mode": "mode",
    "render": "offline",
    "simulate": "offline",
    "Recording": "recording",
    "load": "recording",
    "replay": "replayed",
    "SampleBatch": "samples",
    "Box": "scene",
    "Constant": "scene",
    "Disc": "scene",
    "Membrane": "scene",
    "Scene": "scene",
    "SceneObject": "scene",
    "Spring": "scene",
    "Viscous": "scene",
    "Wall": "scene",
    "load_scene": "scene",
    "Autoregressive": "texture",
    "Grooves": "texture",
    "Stochastic": "texture",
    "Json": "yaml_source",
}
"""The public names, and the module that each stands in."""


def __getattr__(name: str) -> object:
    if name == "aio":
        return importlib.import_module("hapticd.aio")
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module 'hapticd' has no attribute {name!r}")
    return getattr(importlib.import_module(f"hapticd.{home}"), name)


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
