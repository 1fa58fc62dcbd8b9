"""`devices`: HID devices, and what their report descriptors say."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from hapticd.cli.common import json_option, print_json
from hapticd.errors import HapticdError, quoted

if TYPE_CHECKING:
    from hapticd.hid.layout import Layout

_MAX_FILE_BYTES: Final = 1 << 20
"""More than any report descriptor is as text; what lies behind is not read."""


@click.group("devices")
def devices_command() -> None:
    """HID devices, and which of them can be driven."""


@devices_command.command("parse")
@click.argument("file", metavar="FILE", type=click.Path(dir_okay=False))
@json_option
def parse_command(file: str, as_json: bool) -> None:
    """Say what would be driven of a device with the report descriptor in FILE, binary or hex text; - is the input."""
    from hapticd.hid.descriptor import parse
    from hapticd.hid.layout import layout_of

    with click.open_file(file, "rb") as stream:
        data = stream.read(_MAX_FILE_BYTES)
    layout = layout_of(parse(descriptor_bytes(data, "the standard input" if file == "-" else Path(file).name)))
    if as_json:
        print_json(layout.to_dict())
    else:
        click.echo("\n".join(_lines(layout)))


def descriptor_bytes(data: bytes, name: str) -> bytes:
    """The bytes of a file that holds a report descriptor, as they are or as hex text.

    Hex text is pairs of digits, between them white space, commas or `0x`; `#` and `//` begin a comment. Raises
    HapticdError for text that is something else.
    """
    if any(byte > 126 or (byte < 32 and byte not in b"\t\n\r\f\v") for byte in data):
        return data
    digits = []
    for number, line in enumerate(data.decode("ascii").splitlines(), 1):
        for word in re.sub(r"(#|//).*", "", line).replace(",", " ").split():
            pairs = re.sub("^0[xX]", "", word)
            if not re.fullmatch("([0-9a-fA-F]{2})+", pairs):
                raise HapticdError(
                    f"{name}, line {number}: {quoted(word)} is not bytes in hexadecimal such as 05 01 09 04"
                )
            digits.append(pairs)
    return bytes.fromhex("".join(digits))


def _lines(layout: Layout) -> list[str]:
    """What a person wants to know of a layout."""
    lines = ["can be driven" if layout.usable else f"cannot be driven; missing: {', '.join(layout.missing)}"]
    for name, axis in layout.input.items():
        place = axis.field
        lines.append(
            f"axis {name}: input report {place.report_id}, {place.bit_size} bits at {place.bit_offset}, "
            f"{place.logical_min} to {place.logical_max}"
        )
    if layout.constant_force is not None:
        force = layout.constant_force
        lines.append(
            f"constant force: output report {force.report_id} of {force.report_bytes} bytes, magnitude "
            f"{force.magnitude.logical_min} to {force.magnitude.logical_max}"
        )
    if layout.set_effect is not None:
        effect = layout.set_effect
        lines.append(
            f"effects: {', '.join(effect.effect_type.entries)}; directions {len(effect.direction)}, "
            f"axes enabled one by one: {', '.join(effect.axes_enable) or 'no'}"
        )
    if layout.device_control is not None:
        lines.append(
            f"device control: output report {layout.device_control.report_id} ({layout.device_control.kind}): "
            f"{', '.join(layout.device_control.command.entries)}"
        )
    optional = {
        "block free": layout.block_free,
        "device gain": layout.device_gain,
        "state": layout.pid_state,
        "pool": layout.pool,
        "periodic": layout.set_periodic,
        "envelope": layout.set_envelope,
    }
    lines.append(f"also: {', '.join(name for name, report in optional.items() if report) or 'nothing'}")
    return lines + [f"not used: {problem}" for problem in layout.problems]
