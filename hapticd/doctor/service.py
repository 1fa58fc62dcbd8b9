"""Checks of the configuration, the systemd unit and the running daemon."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from hapticd.base.errors import HapticdError
from hapticd.doctor.machine import Finding, Machine, Needs, fail, ok, unknown, warn
from hapticd.hid.device_texts import unseen_reset_text

if TYPE_CHECKING:
    from hapticd.config.configuration import Config
    from hapticd.config.locations import ConfigFiles

_UNIT_PROPERTIES = ("LoadState", "ActiveState", "UnitFileState", "NRestarts", "Result")
_JOURNAL_HINT = "journalctl -u hapticd shows why"


def configuration(chosen: ConfigFiles) -> tuple[Config, Finding]:
    """Return the chosen configuration and an `ok`; if it cannot be loaded, the built-in one and a failure."""
    from hapticd.config.configuration import chosen_config, default_config

    try:
        return chosen_config(chosen), ok("config", str(chosen))
    except HapticdError as error:
        return default_config(), fail("config", str(error), "the lines below hold for the built-in configuration")


def unit(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Check the state of hapticd.service, as systemd reports it."""
    if not machine.path("/run/systemd/system").exists():
        yield unknown("service", "systemd does not run here")
        return
    output = machine.run(
        ["systemctl", "show", "--no-pager", f"--property={','.join(_UNIT_PROPERTIES)}", "hapticd.service"]
    )
    if output is None:
        yield unknown("service", "systemctl is not installed, or does not answer")
        return
    shown = dict(line.split("=", 1) for line in output.splitlines() if "=" in line)
    state, at_start = shown.get("ActiveState", "?"), shown.get("UnitFileState", "")
    restarts = shown.get("NRestarts") or "0"
    after = f", after {restarts} restarts" if restarts != "0" else ""
    if shown.get("LoadState") != "loaded":
        yield warn("service", f"hapticd.service: {shown.get('LoadState') or 'unknown'}", "hapticd install-service")
    elif state == "active" and not after:
        yield ok("service", f"hapticd.service is active, {at_start}")
    elif state == "active":
        yield warn("service", f"hapticd.service is active, {at_start}{after}", _JOURNAL_HINT)
    elif state == "failed" or after:
        yield fail("service", f"hapticd.service: {state}, {shown.get('Result')}{after}", _JOURNAL_HINT)
    else:
        yield warn("service", f"hapticd.service is {state}, {at_start}", "systemctl enable --now hapticd")


def daemon(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Check whether a daemon answers, and its version, missing real-time rights and faults."""
    try:
        status = machine.daemon()
    except HapticdError as error:
        todo = "kill -CONT continues a stopped daemon; if permission is denied, join the group hapticd"
        yield fail("daemon", str(error), todo)
        return
    if status is None:
        yield warn("daemon", "no daemon answers", "hapticd run, or systemctl start hapticd")
        return
    version = status.get("version")
    if version == machine.version:
        yield ok("daemon", f"hapticd {version} answers")
    else:
        yield warn("daemon", f"hapticd {version} runs, but {machine.version} is installed", "restart the daemon")
    granted, connection, faults = (status.get(name) for name in ("realtime", "connection", "faults"))
    missing = granted.get("missing") if isinstance(granted, Mapping) else None
    if isinstance(missing, list) and missing:
        yield warn("daemon", f"the daemon was not granted: {'; '.join(map(str, missing))}", "see the lines above")
    if isinstance(connection, Mapping) and connection.get("resets_seen") is False:
        yield warn("daemon", *unseen_reset_text(str(connection["path"]), connection.get("foreign_effect_s")))
    if isinstance(faults, list) and faults:
        lost = isinstance(connection, Mapping) and connection.get("problem")
        todo = f"the device is lost: {lost}" if lost else "hapticd force on"
        yield warn("daemon", f"a fault holds the forces off: {', '.join(map(str, faults))}", todo)
