"""`hapticd mark`: a mark in the event stream and in recordings."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, cast

import click

from hapticd.cli.common import daemon, json_option, print_result

if TYPE_CHECKING:
    from hapticd.base.yaml_source import Json


@click.command("mark", short_help="Leave a mark in the event stream.")
@click.argument("text")
@click.option("--data", "data_text", metavar="JSON", help='Kept with the mark: 3, "left", {"trial": 3}.')
@json_option
@click.pass_context
def mark_command(ctx: click.Context, text: str, data_text: str | None, as_json: bool) -> None:
    """Leave a mark with TEXT in the event stream and in every recording that is under way.

    \b
    hapticd mark "trial 3" --data '{"condition": "comb"}'
    """
    data: Json = None
    if data_text is not None:
        try:
            data = cast("Json", json.loads(data_text))
        except ValueError as error:
            raise click.UsageError(f"--data {data_text}: is not JSON: {error}") from None
    with daemon(ctx) as client:
        result = client.mark(text, data)
    print_result(result, as_json, f"marked at tick {result['tick']:,}")
