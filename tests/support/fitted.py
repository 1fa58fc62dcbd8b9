"""The material that a fit makes."""

from __future__ import annotations

import datetime
from collections.abc import Mapping, Sequence

from hapticd.config.materials import Material
from hapticd.fit.contribution import added, contribution_of
from hapticd.fit.from_files import Fitted
from hapticd.fit.recording import Kind, Recording
from hapticd.fit.result import Fit

DAY = datetime.date(2026, 1, 31)


def fitted_material(
    fit: Fit,
    recordings: Sequence[Recording],
    kind: Kind,
    stiffness_n_per_m: float,
    figures: Mapping[str, object] | None = None,
    onto: Material | None = None,
) -> Material:
    """The material m of a fit, with these figures of it, or all."""
    part = contribution_of(kind, Fitted(fit, fit.material() if figures is None else figures), recordings)
    return added(part, "m", DAY, onto=onto, stiffness_n_per_m=stiffness_n_per_m).material
