"""What is measured beside what the library says, and what was missed."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(slots=True)
class Marks:
    """Collects what lies farther from the library than its limit, a line each."""

    missed: list[str] = field(default_factory=list)

    def off(self, what: str, measured: float, wanted: float, limit: float) -> str:
        """The difference in percent; missed beyond the fraction `limit`, and where it is no number."""
        error = measured / wanted - 1
        self.expect(abs(error) <= limit, f"{what} is off by {100 * error:+.2f} % (limit {100 * limit:.3g} %)")
        return f"{100 * error:+.2f}%"

    def expect(self, holds: bool, otherwise: str) -> None:
        """Notes `otherwise` unless it holds."""
        if not holds:
            self.missed.append(otherwise)
