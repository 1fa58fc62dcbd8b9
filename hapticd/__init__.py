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
    from hapticd.client import DaemonNotRunning, RemoteError, TelemetryLoss, connect
    from hapticd.config import Config, load_config
    from hapticd.core import SAMPLE_DTYPE
    from hapticd.errors import HapticdError, InvalidError, Problem
    from hapticd.materials import Material
    from hapticd.offline import render, simulate
    from hapticd.recording import Recording, load
    from hapticd.replayed import replay
    from hapticd.samples import SampleBatch
    from hapticd.scene import Scene, load_scene

__all__ = [
    "SAMPLE_DTYPE",
    "Config",
    "DaemonNotRunning",
    "HapticdError",
    "InvalidError",
    "Material",
    "Problem",
    "Recording",
    "RemoteError",
    "SampleBatch",
    "Scene",
    "TelemetryLoss",
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
    "connect": "client",
    "DaemonNotRunning": "client",
    "RemoteError": "client",
    "TelemetryLoss": "client",
    "SampleBatch": "samples",
    "Config": "config",
    "load_config": "config",
    "SAMPLE_DTYPE": "core",
    "HapticdError": "errors",
    "InvalidError": "errors",
    "Problem": "errors",
    "Material": "materials",
    "render": "offline",
    "Recording": "recording",
    "load": "recording",
    "replay": "replayed",
    "simulate": "offline",
    "Scene": "scene",
    "load_scene": "scene",
}


def __getattr__(name: str) -> object:
    if name == "aio":
        return importlib.import_module("hapticd.aio")
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module 'hapticd' has no attribute {name!r}")
    return getattr(importlib.import_module(f"hapticd.{home}"), name)
