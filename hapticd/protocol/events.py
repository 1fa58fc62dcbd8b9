"""Events as maps with named members, made from the records of the core.

Telemetry sends these maps, recordings and simulated runs store them; docs/reference/events.md lists the members.
"""

from __future__ import annotations

import math
import os
from typing import Any

from hapticd.base.core import EventKind, Fault, lib
from hapticd.protocol.marks import Mark


def fault_names(faults: Fault) -> list[str]:
    """Return the names of the faults in a set of flags, in lower case."""
    return [fault.name.lower() for fault in Fault if fault in faults and fault.name]


def event_map(event: Any, object_id: str | None, mark: Mark | None = None) -> dict[str, object]:
    """Return an event, a record of `hapticd.base.core.EVENT_DTYPE`, as a map.

    `object_id` is the id of the event's object, `mark` the text and data of a mark, each None if there is none.
    """
    kind = EventKind(int(event["kind"]))
    time_ns = int(event["time_ns"])
    message: dict[str, object] = {
        "event": kind.name.lower(),
        "tick": int(event["tick"]),
        "time_ns": time_ns,
    }
    if kind in (EventKind.CONTACT, EventKind.RELEASE, EventKind.PUNCTURE, EventKind.GROOVE):
        message["object"] = object_id
    if kind in (EventKind.CONTACT, EventKind.PUNCTURE, EventKind.GROOVE):
        before_tick_s = float(event["before_tick_s"])
        true_speed = float(event["true_speed_m_per_s"])
        amplitude = float(event["amplitude_m_per_s2"])
        message |= {
            "onset_time_ns": time_ns - round(before_tick_s * 1e9),
            "before_tick_s": before_tick_s,
            "speed_m_per_s": float(event["speed_m_per_s"]),
            "true_speed_m_per_s": None if math.isnan(true_speed) else true_speed,
            "amplitude_m_per_s2": amplitude,
            # The core gives the fraction that the force limit left of a strike; without a strike nothing was limited.
            "scale": float(event["scale"]) if amplitude != 0.0 else 1.0,
        }
    match kind:
        case EventKind.CONTACT:
            message["appeared"] = bool(int(event["code"]) & lib.HD_CONTACT_SILENT)
        case EventKind.PUNCTURE:
            message["depth_m"] = float(event["value"])
        case EventKind.GROOVE:
            message |= {"count": 1, "grooves": int(event["value"])}
        case EventKind.SATURATION:
            message["wanted_n"] = float(event["value"])
        case EventKind.OVERRUN:
            message |= {"missed": int(event["value"]), "count": 1}
        case EventKind.FAULT:
            message["faults"] = fault_names(Fault(int(event["code"])))
        case EventKind.REVISION:
            message["revision"] = int(event["code"])
        case EventKind.OVERLOAD:
            message["missed_share"] = float(event["value"])
        case EventKind.RATE:
            message["rate_hz"] = float(event["value"])
        case EventKind.RESUMED:
            message["suspended_s"] = float(event["value"])
        case EventKind.MEMORY_REFUSED:
            message["problem"] = os.strerror(int(event["code"]))
        case EventKind.MARK:
            message |= {"text": mark.text if mark else "", "data": mark.data if mark else None}
        case EventKind.GESTURE_END:
            message |= {"started_tick": int(event["value"]), "completed": bool(int(event["code"]))}
        case EventKind.GLITCH:
            message["speed_m_per_s"] = float(event["value"])
    return message
