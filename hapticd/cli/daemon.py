"""`hapticd run` and `hapticd status`."""

from __future__ import annotations

import gc
import os

import click

from hapticd.cli.common import config_option, daemon, json_option, print_json
from hapticd.errors import offload_text, undisplayable_text

_SHOWN_MARGINS = 5


@click.command("run")
@config_option
@click.pass_context
def run_command(ctx: click.Context, configs: tuple[str, ...]) -> int:
    """Run the daemon in the foreground."""
    # What is loaded now stays: looking for garbage among it would only take time. The daemon turns it on again.
    gc.disable()
    # Before numpy is loaded: its BLAS would start a thread for each processor, and the daemon multiplies no matrices.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from hapticd.daemon import run

    return run(configs, ctx.find_root().obj)


@click.command("status")
@json_option
@click.pass_context
def status_command(ctx: click.Context, as_json: bool) -> None:
    """Say what the daemon is and does."""
    with daemon(ctx) as client:
        status = client.get_status()
    if as_json:
        print_json(status)
        return
    counters = status["counters"]
    lines = [
        ("daemon", f"hapticd {status['version']}, protocol {status['protocol']}, {status['state']}"),
        ("device", f"{status['device']} at {status['rate_hz']:g} Hz"),
        *_connection(status.get("connection")),
        ("real time", _realtime(status["realtime"])),
        ("scene", f"revision {status['revision']}, tick {status['tick']}"),
        ("forces", status["forces"] + (f" ({', '.join(status['faults'])})" if status["faults"] else "")),
        ("lease", "none" if status["lease_s"] is None else f"held, {status['lease_s']:.3f} s left"),
        *[(name.replace("_", " "), str(value)) for name, value in counters.items() if name != "ticks"],
    ]
    for mode in status["undisplayable"]:
        lines.append(("undisplayable", undisplayable_text(mode)))
    lines += [("offload", offload_text(told)) for told in status["offload"]]
    lines += [("warning", f"{warning['where']}: {warning['problem']}") for warning in status["warnings"]]
    lines += _stability(status.get("stability"))
    width = max(len(name) for name, _ in lines)
    for name, value in lines:
        click.echo(f"{name:<{width}}  {value}")


def _connection(told: object) -> list[tuple[str, str]]:
    if not isinstance(told, dict):
        return []
    where = f"{told['name']} at {told['path']}, " if told["name"] else ""
    lines = [("connection", f"{where}{told['state']}" + (f": {told['problem']}" if told["problem"] else ""))]
    rates = [
        f"{what} {told[key]:g} Hz"
        for what, key in (
            ("carries forces at", "link_hz"),
            ("reports at", "report_hz"),
            ("takes forces at", "force_hz"),
        )
        if told[key] is not None
    ]
    if rates:
        lines.append(("link", ", ".join(rates)))
    if told["states"]:
        lines.append(("states", ", ".join(f"{name} {_word(value)}" for name, value in told["states"].items())))
    if told["resets"]:
        lines.append(("resets", str(told["resets"])))
    return lines


def _stability(told: object) -> list[tuple[str, str]]:
    if not isinstance(told, dict):
        return []
    if told["unknown"] is not None:
        return [("stability", f"not known: {told['unknown']}")]
    lines = [("stability", f"{told['sets'] - told['unsafe']} of {told['sets']} sets of objects safe in any hand")]
    for margin in told["worst"][:_SHOWN_MARGINS]:
        lines.append(
            (
                margin["verdict"],
                f"{', '.join(margin['objects'][:4])}: {margin['stiffness_n_per_m']:.4g} N/m, at most "
                f"{margin['limit_n_per_m']:.4g} ({margin['limited_by']})",
            )
        )
    return lines


def _realtime(granted: object) -> str:
    if not isinstance(granted, dict):
        return "not asked for"
    return ", ".join(f"{name.replace('_', ' ')} {_word(value)}" for name, value in granted.items())


def _word(value: object) -> str:
    if value is None:
        return "any"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list):
        return "; ".join(map(str, value)) or "none"
    return str(value)
