"""`hapticd simulate`: simulates a scene and an operator from files, and writes a recording."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict
from typing import Any

import numpy as np
import numpy.typing as npt

from hapticd.base.core import EventKind
from hapticd.config.configuration import Config, config_of_documents, load_all
from hapticd.config.document_kinds import kind_of, refuse_other_kinds
from hapticd.protocol.events import event_map
from hapticd.recording.recording import recording_into
from hapticd.recording.writer import RecordingWriter, Samples
from hapticd.rendering.offline import simulate_run


def simulate_files(
    scenes: Sequence[str],
    operator_file: str,
    output: str | None,
    duration_s: float | None,
    rate_hz: float | None,
    *,
    overwrite: bool = False,
    notes: Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """Simulate the scene in configuration files with the simulated joystick; write a recording if `output` is given.

    `rate_hz` replaces the configured rate. Returns the map that `hapticd simulate --json` prints. Raises HapticdError
    or InvalidError for invalid values and for files that cannot be read or written. An existing output without
    `overwrite` is refused before the simulation.
    """
    with nullcontext() if output is None else recording_into(output, overwrite) as writer:
        config = configuration(scenes)
        run = simulate_run(config, operator_file, duration_s, rate_hz)
        if writer is not None:
            objects = run.objects
            events = [event_map(each, objects.get((int(each["slot"]), int(each["generation"])))) for each in run.events]
            write_run(writer, config, run.rate_hz, run.samples, events, notes or {}, run.truth)
    magnitudes = np.hypot(*run.samples["force_n"].T)
    return {
        "file": output,
        "ticks": len(run.samples),
        "duration_s": len(run.samples) / run.rate_hz,
        "events": len(run.events),
        "event_counts": dict(Counter(EventKind(int(kind)).name.lower() for kind in run.events["kind"])),
        "largest_force_n": float(magnitudes.max(initial=0.0)),
        "undisplayable": [asdict(mode) for mode in run.undisplayable],
        "warnings": [asdict(problem) for problem in run.warnings],
    }


def write_run(
    writer: RecordingWriter,
    config: Config,
    rate_hz: float,
    samples: Samples,
    events: Sequence[Mapping[str, Any]],
    notes: Mapping[str, object],
    truth: npt.NDArray[np.float64] | None = None,
) -> None:
    """Write a simulated run as a recording and finish it. `rate_hz` replaces the rate of the configuration."""
    servo = config.servo.model_copy(update={"rate_hz": rate_hz})
    texts = {
        "config": {"servo": servo.to_dict(), "device": config.device.to_dict()},
        "scene": config.scene.to_dict(),
        "materials": {name: material.to_dict() for name, material in config.materials.items()},
    }
    writer.write_all(texts, [{"revision": 1}], samples, events)
    held = {"ticks": len(samples), "duration_s": len(samples) / rate_hz, "events": len(events)}
    about = {**held, "missed_periods": 0, "notes": dict(notes)}
    writer.finish({"recording": about}, {} if truth is None else {"truth": truth})


def configuration(paths: Sequence[str]) -> Config:
    """Load a configuration from files, as load_config does. Raises InvalidError also if no file has a scene."""
    documents = load_all(paths)
    if all(kind_of(document.data) == "materials" for document in documents):
        refuse_other_kinds(documents[0], "configuration", "change", "scene", "bare scene")
    return config_of_documents(documents)
