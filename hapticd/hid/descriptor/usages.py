"""Names of usages that are chosen from: of the page Physical Interface Device (0x0F) but for the axes."""

from __future__ import annotations

from typing import Final

PID: Final = 0x000F0000
DESKTOP: Final = 0x00010000
"""Usage pages, above the sixteen bits of a usage."""
AXES: Final = {"x": 0x30, "y": 0x31, "z": 0x32, "rx": 0x33, "ry": 0x34, "rz": 0x35}
"""Usages of the axes on the page Generic Desktop."""

EFFECT_TYPES: Final = {
    "constant_force": 0x26,
    "ramp": 0x27,
    "custom_force": 0x28,
    "square": 0x30,
    "sine": 0x31,
    "triangle": 0x32,
    "sawtooth_up": 0x33,
    "sawtooth_down": 0x34,
    "spring": 0x40,
    "damper": 0x41,
    "inertia": 0x42,
    "friction": 0x43,
}
OPERATIONS: Final = {"start": 0x79, "start_solo": 0x7A, "stop": 0x7B}
COMMANDS: Final = {
    "enable_actuators": 0x97,
    "disable_actuators": 0x98,
    "stop_all_effects": 0x99,
    "device_reset": 0x9A,
    "device_pause": 0x9B,
    "device_continue": 0x9C,
}
LOAD_STATUS: Final = {"success": 0x8C, "full": 0x8D, "error": 0x8E}
