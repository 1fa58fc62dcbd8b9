"""The service and the daemon, if they are there."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from hapticd.base.errors import HapticdError
from hapticd.doctor.machine import Finding, Machine, Needs, unknown
from hapticd.hid.device_texts import unseen_text

_SHOW = ("LoadState", "ActiveState", "SubState", "UnitFileState", "NRestarts", "Result")


def unit(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """What systemd says of hapticd.service."""
    if not machine.path("/run/systemd/system").exists():
        yield unknown("service", "systemd does not run here")
        return
    said = machine.run(["systemctl", "show", "--no-pager", f"--property={','.join(_SHOW)}", "hapticd.service"])
    if said is None:
        yield unknown("service", "systemctl is not here, or does not answer")
        return
    properties = dict(line.split("=", 1) for line in said.splitlines() if "=" in line)
    state, restarts = properties.get("ActiveState", "?"), properties.get("NRestarts", "0")
    after = f", after {restarts} restarts" if restarts not in ("", "0") else ""
    at_start = properties.get("UnitFileState", "")
    if properties.get("LoadState") != "loaded":
        yield Finding(
            "service", "warn", f"hapticd.service: {properties.get('LoadState') or 'unknown'}", "hapticd install-service"
        )
    elif state == "active":
        yield Finding(
            "service", "warn" if after else "ok", f"hapticd.service is active, {at_start}{after}", _log(after)
        )
    elif state == "failed" or after:
        yield Finding("service", "fail", f"hapticd.service: {state}, {properties.get('Result')}{after}", _log("failed"))
    else:
        yield Finding("service", "warn", f"hapticd.service is {state}, {at_start}", "systemctl enable --now hapticd")


def _log(why: str) -> str:
    return "journalctl -u hapticd says why" if why else ""


def daemon(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Whether a daemon answers, which, and what it was not granted."""
    try:
        status = machine.daemon()
    except HapticdError as error:
        yield Finding(
            "daemon",
            "fail",
            str(error),
            "kill -CONT lets a stopped one go on; whoever is refused joins the group hapticd",
        )
        return
    if status is None:
        yield Finding("daemon", "warn", "none answers", "hapticd run, or systemctl start hapticd")
        return
    version = status.get("version")
    if version != machine.version:
        yield Finding("daemon", "warn", f"it is hapticd {version}, this is {machine.version}", "restart it")
    else:
        yield Finding("daemon", "ok", f"hapticd {version} answers")
    granted = status.get("realtime")
    missing = granted.get("missing") if isinstance(granted, Mapping) else None
    if isinstance(missing, list) and missing:
        yield Finding("daemon", "warn", f"it was not granted: {'; '.join(map(str, missing))}", "see the lines above")
    connection = status.get("connection")
    if isinstance(connection, Mapping) and connection.get("resets_seen") is False:
        condition, action = unseen_text(str(connection["path"]), connection.get("foreign_effect_s"))
        yield Finding("daemon", "warn", condition, action)
    faults = status.get("faults")
    if isinstance(faults, list) and faults:
        yield Finding(
            "daemon", "warn", f"a fault holds the forces off: {', '.join(map(str, faults))}", "hapticd force on"
        )
