"""The measures by their names in `measure` of a study."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from pydantic import ValidationError

from hapticd.base.errors import InvalidError, Problem, known_names, path_text
from hapticd.base.model import Model, faults_of
from hapticd.base.yaml_source import Json
from hapticd.sweeps.measures.display import DisplayedError, DisplayedErrorOptions
from hapticd.sweeps.measures.displayed_materials import DisplayedMaterials, DisplayedMaterialsOptions
from hapticd.sweeps.measures.energy import EnergyGiven
from hapticd.sweeps.measures.loop import LoopError
from hapticd.sweeps.measures.margin import StabilityFactor
from hapticd.sweeps.measures.measure import Measure, NoOptions
from hapticd.sweeps.measures.onset import OnsetError
from hapticd.sweeps.measures.passive_limit import PassiveLimit, PassiveLimitOptions
from hapticd.sweeps.measures.peaks import PeakForce, PeakSpeed
from hapticd.sweeps.measures.quantile import Quantile, QuantileOptions
from hapticd.sweeps.measures.rest import Rest, RestOptions
from hapticd.sweeps.measures.user_function import FUNCTION_MEASURE, FunctionOptions, UserFunction, identity_options

MEASURE_CLASSES: Final[Mapping[str, tuple[type[Model], Callable[..., Measure]]]] = {
    "end": (RestOptions, Rest),
    "peak_force_n": (NoOptions, PeakForce),
    "peak_speed_m_per_s": (NoOptions, PeakSpeed),
    "quantile": (QuantileOptions, Quantile),
    "stability_factor": (NoOptions, StabilityFactor),
    "energy_given": (NoOptions, EnergyGiven),
    "loop_error": (NoOptions, LoopError),
    "onset_error": (NoOptions, OnsetError),
    "displayed_error": (DisplayedErrorOptions, DisplayedError),
    "passive_limit": (PassiveLimitOptions, PassiveLimit),
    "displayed_materials": (DisplayedMaterialsOptions, DisplayedMaterials),
    FUNCTION_MEASURE: (FunctionOptions, UserFunction),
}
"""Options and class of each measure, by its name. Without options, the class takes no argument."""


def parse_measure(given: str | Mapping[str, Json]) -> Measure:
    """Return a measure from its name, or from `{name: options}`.

    Raises InvalidError, with paths relative to the measure.
    """
    if isinstance(given, str):
        name, options = given, {}
    elif len(given) == 1:
        name, found = next(iter(given.items()))
        if not isinstance(found, dict):
            raise InvalidError([Problem(path_text((name,)), "must be a mapping of options")])
        options = found
    else:
        raise InvalidError([Problem("", f"must be a name or {{name: options}}, has {len(given)} keys")])
    if name not in MEASURE_CLASSES:
        raise InvalidError([Problem("", f"unknown measure {name}; {known_names(name, MEASURE_CLASSES)}")])
    model, made = MEASURE_CLASSES[name]
    try:
        given_options = model.parsed(options)
    except ValidationError as error:
        raise InvalidError(Problem(path_text((name, *path)), text) for path, text in faults_of(error)) from None
    return made() if model is NoOptions else made(given_options)


def identity_of(given: str | Mapping[str, Json]) -> Json:
    """Return the options on which a measure's results depend: of a user's function its source, but not its path."""
    if isinstance(given, str):
        return given
    return {
        name: identity_options(options) if name == FUNCTION_MEASURE and isinstance(options, dict) else options
        for name, options in given.items()
    }
