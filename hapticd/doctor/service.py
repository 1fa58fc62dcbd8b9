"""The configuration that the other checks go by, the service and the daemon, if they are there."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from hapticd.base.errors import HapticdError
from hapticd.doctor.machine import Finding, Machine, Needs, fail, ok, unknown, warn
from hapticd.hid.device_texts import unseen_text

if TYPE_CHECKING:
    from hapticd.config.configuration import Config
    from hapticd.config.locations import ConfigFiles

_UNIT_PROPERTIES = ("LoadState", "ActiveState", "UnitFileState", "NRestarts", "Result")
_SEE_JOURNAL = "journalctl -u hapticd says why"


def configuration(chosen: ConfigFiles) -> tuple[Config, Finding]:
    """The configuration, or where it is faulty the built-in one, and the line that says so."""
    from hapticd.config.configuration import chosen_config, default_config

    try:
        return chosen_config(chosen), ok("config", str(chosen))
    except HapticdError as error:
        return default_config(), fail("config", str(error), "the lines below hold for the built-in configuration")


def unit(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """What systemd says of hapticd.service."""
    if not machine.path("/run/systemd/system").exists():
        yield unknown("service", "systemd does not run here")
        return
    said = machine.run(
        ["systemctl", "show", "--no-pager", f"--property={','.join(_UNIT_PROPERTIES)}", "hapticd.service"]
    )
    if said is None:
        yield unknown("service", "systemctl is not here, or does not answer")
        return
    shown = dict(line.split("=", 1) for line in said.splitlines() if "=" in line)
    state, at_start = shown.get("ActiveState", "?"), shown.get("UnitFileState", "")
    restarts = shown.get("NRestarts") or "0"
    after = f", after {restarts} restarts" if restarts != "0" else ""
    if shown.get("LoadState") != "loaded":
        yield warn("service", f"hapticd.service: {shown.get('LoadState') or 'unknown'}", "hapticd install-service")
    elif state == "active" and not after:
        yield ok("service", f"hapticd.service is active, {at_start}")
    elif state == "active":
        yield warn("service", f"hapticd.service is active, {at_start}{after}", _SEE_JOURNAL)
    elif state == "failed" or after:
        yield fail("service", f"hapticd.service: {state}, {shown.get('Result')}{after}", _SEE_JOURNAL)
    else:
        yield warn("service", f"hapticd.service is {state}, {at_start}", "systemctl enable --now hapticd")


def daemon(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Whether a daemon answers, which, and what it was not granted."""
    try:
        status = machine.daemon()
    except HapticdError as error:
        todo = "kill -CONT lets a stopped one go on; whoever is refused joins the group hapticd"
        yield fail("daemon", str(error), todo)
        return
    if status is None:
        yield warn("daemon", "none answers", "hapticd run, or systemctl start hapticd")
        return
    version = status.get("version")
    if version == machine.version:
        yield ok("daemon", f"hapticd {version} answers")
    else:
        yield warn("daemon", f"it is hapticd {version}, this is {machine.version}", "restart it")
    granted, connection, faults = (status.get(name) for name in ("realtime", "connection", "faults"))
    missing = granted.get("missing") if isinstance(granted, Mapping) else None
    if isinstance(missing, list) and missing:
        yield warn("daemon", f"it was not granted: {'; '.join(map(str, missing))}", "see the lines above")
    if isinstance(connection, Mapping) and connection.get("resets_seen") is False:
        yield warn("daemon", *unseen_text(str(connection["path"]), connection.get("foreign_effect_s")))
    if isinstance(faults, list) and faults:
        yield warn("daemon", f"a fault holds the forces off: {', '.join(map(str, faults))}", "hapticd force on")
