"""The work behind `hapticd simulate`, apart from it because it loads the core."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import TypedDict

from hapticd.config import Config, load_config
from hapticd.document_kinds import refuse_other_kinds
from hapticd.errors import HapticdError
from hapticd.events import event_map
from hapticd.offline import simulate_run
from hapticd.place import displaced
from hapticd.sink import open_sink
from hapticd.yaml_source import load_path


class SimulationResult(TypedDict):
    """What was written."""

    file: str
    ticks: int
    duration_s: float
    events: int
    undisplayable: list[dict[str, object]]
    warnings: list[dict[str, str]]


def simulate_to_file(
    scene: str,
    operator_file: str,
    output: str,
    duration_s: float | None,
    rate_hz: float | None,
    *,
    overwrite: bool = False,
    notes: Mapping[str, str] | None = None,
) -> SimulationResult:
    """Runs a scene or a configuration with the simulated joystick, into a file; without a rate at its own.

    Raises HapticdError or InvalidError for what cannot be read, run or written, before anything is run for a file that
    is there already and not to be replaced.
    """
    with open_sink(output, overwrite) as sink:
        config = _config(scene)
        run = simulate_run(config, operator_file, duration_s, rate_hz)
        servo = config.servo.model_copy(update={"rate_hz": run.rate_hz})
        sink.begin(
            {
                "config": {"servo": servo.to_dict(), "device": config.device.to_dict()},
                "scene": config.scene.to_dict(),
                "materials": {name: material.to_dict() for name, material in config.materials.items()},
            }
        )
        sink.write_change({"revision": 1})
        sink.write(run.samples)
        for event in run.events:
            place = int(event["slot"]), int(event["generation"])
            sink.write_event(event_map(event, run.objects.get(place)))
        ticks = len(run.samples)
        about = {
            "ticks": ticks,
            "duration_s": ticks / run.rate_hz,
            "events": len(run.events),
            "missed_periods": 0,
            "notes": dict(notes or {}),
        }
        sink.finish({"recording": about}, {} if run.truth is None else {"truth": run.truth})
        if sink.displaced:
            raise HapticdError(displaced(output, sink.target))
    return {
        "file": output,
        "ticks": ticks,
        "duration_s": ticks / run.rate_hz,
        "events": len(run.events),
        "undisplayable": [asdict(mode) for mode in run.undisplayable],
        "warnings": [asdict(problem) for problem in run.warnings],
    }


def _config(path: str) -> Config:
    refuse_other_kinds(load_path(path), "configuration", "change", "scene", "bare scene")
    return load_config(path)
