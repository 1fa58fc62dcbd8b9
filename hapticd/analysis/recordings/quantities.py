"""What a recording may hold: the quantities, their names and units, and how large each can be."""

from __future__ import annotations

from typing import Final, Literal, TypeAlias

Quantity: TypeAlias = Literal["time", "acceleration", "force", "position", "tangential_position", "speed"]

NAMES: Final[dict[Quantity, str]] = {
    "time": "time_s",
    "acceleration": "acceleration_m_per_s2",
    "force": "force_n",
    "position": "position_m",
    "tangential_position": "tangential_position_m",
    "speed": "speed_m_per_s",
}
UNITS: Final[dict[Quantity, dict[str, float]]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "acceleration": {"m/s^2": 1.0, "mm/s^2": 1e-3, "g": 9.80665},
    "force": {"N": 1.0, "mN": 1e-3, "kN": 1e3},
    "position": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6},
    "tangential_position": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6},
    "speed": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3},
}
LARGEST: Final[dict[Quantity, float]] = {
    "time": 1e12,
    "acceleration": 1e9,
    "force": 1e9,
    "position": 1e9,
    "tangential_position": 1e9,
    "speed": 1e9,
}
"""In SI units; far beyond what can be, so that nothing overflows before a fit says what is wrong."""
