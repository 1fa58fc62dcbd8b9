"""`hapticd run` and `hapticd status`."""

from __future__ import annotations

import gc
import os
from collections.abc import Mapping
from typing import Any

import click

from hapticd.cli.common import change_options, changed, config_option, daemon, json_option, print_json, print_result
from hapticd.errors import offload_text, undisplayable_text

RELOAD_S = 60.0
"""So long is a reload waited for: the daemon itself gives up files that do not come after 10 s."""
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


@click.command("reload", short_help="Read the configuration anew.")
@change_options
@json_option
@click.pass_context
def reload_command(ctx: click.Context, expect_revision: int | None, wait: bool, as_json: bool) -> None:
    """Have the daemon read its configuration files anew, and take scene and materials from them: all or nothing.

    What was touched or punctured stays so. Anything else that changed needs a restart, and refuses the whole.
    """
    with daemon(ctx, RELOAD_S) as client:
        result = client.reload(expect_revision, wait)
    print_result(result, as_json, changed(result))


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
        *[_times(name, told) for name, told in status.get("histograms", {}).items()],
        *_missed(status.get("overruns")),
        *_flight(status.get("flight")),
    ]
    for mode in status["undisplayable"]:
        lines.append(("undisplayable", undisplayable_text(mode)))
    lines += [("offload", offload_text(told)) for told in status["offload"]]
    lines += [("warning", f"{warning['where']}: {warning['problem']}") for warning in status["warnings"]]
    lines += _stability(status.get("stability"))
    width = max(len(name) for name, _ in lines)
    for name, value in lines:
        click.echo(f"{name:<{width}}  {value}")


def _times(name: str, histogram: Mapping[str, Any]) -> tuple[str, str]:
    p50, p99 = (quantile_ns(histogram, part) for part in (0.5, 0.99))
    return name.removesuffix(
        "_ns"
    ), f"p50 {p50 / 1e3:.3g} us, p99 {p99 / 1e3:.3g} us, max {histogram['max'] / 1e3:.4g} us"


def quantile_ns(histogram: Mapping[str, Any], part: float) -> float:
    """So long or shorter is this part of the times; as far as the bins tell, and never more than the longest."""
    edges, counts = histogram["edges"], histogram["counts"]
    wanted, below = part * sum(counts), 0
    for place, count in enumerate(counts):
        if count and below + count >= wanted:
            if place == len(edges):
                break
            low = edges[place - 1] if place else 0
            return float(min(low + (wanted - below) / count * (edges[place] - low), histogram["max"]))
        below += count
    return float(histogram["max"])


def _missed(told: object) -> list[tuple[str, str]]:
    if not isinstance(told, dict):
        return []
    share = f"{100 * told['missed_share']:.3g} % of the last second's periods"
    return [("missed", f"{share}; above {100 * told['threshold']:g} %: {told['action'].replace('_', ' ')}")]


def _flight(told: object) -> list[tuple[str, str]]:
    if not isinstance(told, dict):
        return []
    lines = [("flight recorder", f"{told['seconds']:g} s, {told['written']} files written to {told['directory']}")]
    if told["problem"] is not None:
        lines.append(("flight recorder", told["problem"]))
    return lines


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
