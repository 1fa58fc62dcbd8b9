"""The configuration that the other checks go by, and its faults."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hapticd.base.errors import HapticdError
from hapticd.doctor.machine import Finding

if TYPE_CHECKING:
    from hapticd.config.configuration import Config
    from hapticd.config.locations import Chosen


def taken(chosen: Chosen) -> tuple[Config, Finding]:
    """The configuration, or where it is faulty the built-in one, and the line that says so."""
    from hapticd.config.configuration import chosen_config, default_config

    try:
        return chosen_config(chosen), Finding("config", "ok", str(chosen))
    except HapticdError as error:
        finding = Finding("config", "fail", str(error), "the lines below hold for the built-in configuration")
        return default_config(), finding
