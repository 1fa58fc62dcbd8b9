"""Comparison of measured figures with the library."""

from __future__ import annotations

from dataclasses import dataclass, field


def residual(measured: float, wanted: float) -> str:
    """Return the difference in per cent of the wanted value."""
    return f"{100 * (measured / wanted - 1):+.2f}%"


@dataclass(slots=True)
class Marks:
    """Collects deviations from the library that exceed their limits, one line each."""

    missed: list[str] = field(default_factory=list)

    def off(self, what: str, measured: float, wanted: float, limit: float) -> str:
        """Return the difference in percent; add a line if it exceeds the fraction `limit` or is NaN."""
        error = measured / wanted - 1
        self.expect(abs(error) <= limit, f"{what} is off by {100 * error:+.2f} % (limit {100 * limit:.3g} %)")
        return residual(measured, wanted)

    def expect(self, holds: bool, otherwise: str) -> None:
        """Add the line `otherwise` unless the condition holds."""
        if not holds:
            self.missed.append(otherwise)
