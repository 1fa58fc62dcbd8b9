"""`hapticd devices`: HID devices and their report descriptors."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from hapticd.base import wording
from hapticd.base.errors import HapticdError, quoted
from hapticd.base.files import check_new, write_atomically
from hapticd.base.yaml_text import yaml_text
from hapticd.cli.common import (
    Finite,
    config_option,
    for_option,
    json_option,
    note,
    output_option,
    overwrite_option,
    print_json,
    print_result,
    status_line,
)
from hapticd.hid.device_texts import unseen_reset_text

if TYPE_CHECKING:
    from hapticd.config.hid import Hid
    from hapticd.hid.discovery import SysfsDevice
    from hapticd.hid.verdict import Verdict

_MAX_DESCRIPTOR_FILE_BYTES: Final = 1 << 20
"""A file with a report descriptor is read up to this size; no descriptor is longer, even as hex text."""


@click.group("devices", invoke_without_command=True, short_help="List HID devices, or set one up.")
@config_option
@json_option
@click.pass_context
def devices_command(ctx: click.Context, configs: tuple[str, ...], as_json: bool) -> None:
    """List HID devices, and whether each can be driven or the reason why not.

    A device that matches device.hid of the configuration is judged by this section, others by its defaults.
    """
    if ctx.invoked_subcommand is not None:
        return
    from hapticd.hid.claim import Claims
    from hapticd.hid.discovery import find

    hid = _hid_of(configs)
    found = [item.evaluated_by(hid) for item in find()]
    claimed = Claims().names()
    if as_json:
        print_json([{**item.to_dict(), "claimed": item.hid_name in claimed} for item in found])
        return
    if not found:
        note("no HID device is connected, or the kernel lacks hidraw")
    for item in found:
        click.echo(f"{item}, {item.bus}")
        click.echo(f"    {_verdict(item)}")
        mine = item.hid_name in claimed
        if item.resets_seen is False:
            condition, action = unseen_reset_text(item.path)
            click.echo(f"    {condition}" if mine else f"    {condition}\n    {action}")
        if mine:
            click.echo(f"    claimed: `hapticd devices release {item.path}` lets other programs use it again")


def _hid_of(configs: tuple[str, ...]) -> Hid:
    """Return the section `device.hid` that `hapticd run` would use, or its defaults if no HID device is configured.

    A faulty configuration given with -c is an error. For a faulty one at a default path a note is printed.
    """
    from hapticd.config.configuration import config_of
    from hapticd.config.hid import Hid

    try:
        device = config_of(configs).device
    except HapticdError as error:
        if configs:
            raise
        note(f"using the defaults, as the configuration is faulty: {error}")
        return Hid()
    return device.hid if device.kind == "hid" else Hid()


def _verdict(item: SysfsDevice) -> str:
    from hapticd.hid.device import PERMISSION_HINT

    why_not = item.verdict.why_not
    if why_not is not None:
        return f"cannot be driven{' without a description' if item.lacks_forces else ''}: {why_not}"
    text = "can be driven"
    if item.out_interval_s:
        text += f", a report every {wording.si(item.out_interval_s, 's')}"
    if item.verdict.plan is not None and item.verdict.plan.leak_text:
        text += f"; {item.verdict.plan.leak_text}"
    return text + (f"; but no permission: {PERMISSION_HINT}" if item.permission == "denied" else "")


def _selected(device: str | None, found: Sequence[SysfsDevice], what: str) -> SysfsDevice:
    """Return the device in `found` with this path or VENDOR:PRODUCT; if `device` is None, the only one in `found`.

    `what` completes errors such as "2 devices can be driven". Raises HapticdError unless exactly one device matches.
    """
    matching = [item for item in found if device in (None, item.path, f"{item.vendor:04x}:{item.product:04x}")]
    if len(matching) == 1:
        return matching[0]
    listed = ", ".join(map(str, matching or found)) or "none"
    if matching:
        raise HapticdError(f"{len(matching)} devices {what}; name one by its path: {listed}")
    if device is None:
        raise HapticdError(f"no device {what}; name one")
    raise HapticdError(f"no HID device {quoted(device)}; connected: {listed}")


@devices_command.command("dump", short_help="Record the reports of a device.")
@click.argument("device", metavar="DEVICE")
@output_option("File of the recording.", required=True)
@for_option("5s", "5s")
@overwrite_option
@json_option
def dump_command(device: str, output: str, duration_s: float, overwrite: bool, as_json: bool) -> None:
    """Record the report descriptor and the input reports of DEVICE, its path or VENDOR:PRODUCT in hex.

    Move the handle meanwhile. The file is for a bug report, or for `device: {kind: replay}`.
    """
    from hapticd.hid.discovery import find
    from hapticd.hid.replay import Recording, record, save

    check_new(output, overwrite)
    item = _selected(device, find(), f"are {device}")
    fd = os.open(item.path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        reports = record(fd, duration_s)
    finally:
        os.close(fd)
    save(output, Recording(item.name, item.vendor, item.product, item.descriptor, reports), overwrite)
    found = {"file": output, "device": item.to_dict(), "reports": len(reports)}
    print_result(found, as_json, f"{wording.count(len(reports), 'report')} of {item} in {output}")


@devices_command.command("claim", short_help="Keep other programs off a device.")
@click.argument("device", metavar="[DEVICE]", required=False)
@json_option
def claim_command(device: str | None, as_json: bool) -> None:
    """Keep other programs off DEVICE until it is released or unplugged.

    DEVICE is a path or VENDOR:PRODUCT in hex, by default the only device that can be driven. Needs root. The kernel
    driver is unbound, which closes the device in other programs, and bound again; its event and joystick nodes then
    belong to root. A daemon that drives the device initializes it again and turns forces off.
    """
    _hand_over(device, as_json, release=False)


@devices_command.command("release", short_help="Let other programs use a device again.")
@click.argument("device", metavar="[DEVICE]", required=False)
@json_option
def release_command(device: str | None, as_json: bool) -> None:
    """Let other programs use a claimed DEVICE again.

    DEVICE is a path or VENDOR:PRODUCT in hex, by default the only claimed device. Needs root.
    """
    _hand_over(device, as_json, release=True)


def _hand_over(device: str | None, as_json: bool, *, release: bool) -> None:
    """Claim or release the named device, by default the only device that can be driven or that is claimed."""
    from hapticd.hid.claim import Claims
    from hapticd.hid.discovery import find

    claims, found = Claims(), find()
    if device is None:
        names = claims.names()
        found = [item for item in found if (item.hid_name in names if release else item.usable)]
    item = _selected(device, found, "is claimed" if release else "can be driven")
    driver = claims.release(item) if release else claims.claim(item)
    result = {"device": item.hid_name, "path": claims.path(item.hid_name), "driver": driver}
    what = "claimed: other programs cannot open its event nodes"
    if release:
        what = "released: other programs may use it"
    print_result(result, as_json, f"{result['path']} ({item.name or 'no name'}) is {what}; its driver is {driver}")


@devices_command.command("calibrate", short_help="Measure a device's directions and range.")
@config_option
@click.option(
    "--force", "force_n", type=Finite(0, min_open=True), metavar="N", help="Test force [default: 5 % of full scale]."
)
@output_option("File for the section, in addition to the output.")
@overwrite_option
@click.option("--yes", is_flag=True, help="Do not ask whether the handle is free.")
@json_option
def calibrate_command(
    configs: tuple[str, ...], force_n: float | None, output: str | None, overwrite: bool, yes: bool, as_json: bool
) -> None:
    """Measure in which direction a device pushes, and the range of its handle; print the section device.hid.

    First the handle is pushed gently along each axis, in both directions: let go of it, or hold it lightly and still if
    it has a hand sensor. Then move it to all corners, and let go: the measurement ends once the handle is still. Ctrl-C
    leaves out the range.
    """
    from hapticd.config.configuration import config_of
    from hapticd.config.hid import ForceAxes
    from hapticd.hid.range_calibration import measure_range
    from hapticd.hid.sign_calibration import MAX_FORCE_SHARE, calibrate
    from hapticd.hid.sources import open_hid

    if output is not None and any(os.path.realpath(output) == os.path.realpath(path) for path in configs):
        raise click.UsageError(f"-o {output}: is the configuration file; name another file")
    if output is not None:
        check_new(output, overwrite)
    config = config_of(configs)
    hid = config.device.hid
    limit_n = MAX_FORCE_SHARE * hid.full_scale_force_n
    force_n = 0.5 * limit_n if force_n is None else force_n
    if force_n > limit_n:
        raise click.UsageError(
            f"--force must be at most {limit_n:g} N, a tenth of device.hid.full_scale_force_n, is {force_n:g}"
        )
    bare = {"force_axes": ForceAxes(), "axes": hid.axes.with_counts(None, None)}
    opened = open_hid(hid.model_copy(update=bare))
    try:
        if not yes:
            click.confirm(f"{opened.name} at {opened.device.path} will move. Is the handle free?", abort=True, err=True)
        found = calibrate(opened.device, opened.driver, hid, force_n)
        measured = {**opened.keys, **hid.to_dict({*opened.keys, "device_version"})}
        measured |= {"force_axes": found.force_axes.to_dict(), "signs": "trust"}
        try:
            if hid.report is None:
                note("now move the handle slowly to all corners of its range, then let go of it and wait")
                with status_line() as show:
                    reached = measure_range(opened.device, opened.driver, hid.travel_m, show)
                for line in reached.notes:
                    note(line)
                axes = hid.axes.with_counts(reached.x or hid.axes.x.counts, reached.y or hid.axes.y.counts)
                measured["axes"] = axes.to_dict()
        finally:
            # Ctrl-C or an unplugged device loses only the range.
            section = {"device": {"kind": "hid", "hid": measured}}
            text = yaml_text(section)
            print_result(section, as_json, text)  # first, since the file may fail
            if output is not None:
                write_atomically(output, text + "\n", overwrite)
    finally:
        opened.device.close()


@devices_command.command("parse", short_help="Show the axes and forces in a report descriptor.")
@click.argument("file", metavar="FILE", type=click.Path(dir_okay=False))
@config_option
@json_option
def parse_command(file: str, configs: tuple[str, ...], as_json: bool) -> None:
    """Show which axes and forces of the report descriptor in FILE hapticd would use.

    FILE is binary or hex text; - is standard input. The result is that of `hapticd run` with the same configuration.
    --json lists all reports and fields.
    """
    from hapticd.hid.verdict import verdict_of

    with click.open_file(file, "rb") as stream:
        data = stream.read(_MAX_DESCRIPTOR_FILE_BYTES)
    descriptor = descriptor_bytes(data, "the standard input" if file == "-" else Path(file).name)
    verdict = verdict_of(_hid_of(configs), descriptor)
    if verdict.layout is None and not verdict.drivable:
        raise HapticdError(str(verdict.problem))
    print_result(verdict.to_dict(), as_json, "\n".join(_lines(verdict)))


def descriptor_bytes(data: bytes, name: str) -> bytes:
    """Return the report descriptor in a file, which is binary or hex text.

    Hex text is pairs of digits, separated by white space, commas or `0x`; `#` and `//` begin a comment. Raises
    HapticdError for any other text.
    """
    if any(byte > 126 or (byte < 32 and byte not in b"\t\n\r\f\v") for byte in data):
        return data
    found = b""
    for number, line in enumerate(data.decode("ascii").splitlines(), 1):
        digits = re.sub(r"(#|//).*|,|\b0[xX]", " ", line)
        try:
            found += bytes.fromhex(digits)
        except ValueError:
            raise HapticdError(
                f"{name}, line {number}: {quoted(line.strip())}: must be bytes in hexadecimal such as 05 01 09 04"
            ) from None
    return found


def _lines(verdict: Verdict) -> Iterator[str]:
    """Yield the output lines of `devices parse`: verdict, axes, forces, and unused parts of the report descriptor."""
    if verdict.plan is None:
        yield f"cannot be driven: {verdict.why_not}"
    else:
        yield "can be driven"
        plan = verdict.plan
        pushed = [name for name, step_n in zip("xy", plan.force_steps_n, strict=True) if step_n > 0.0]
        along = f"forces: along {' and '.join(pushed)}{' only' if len(pushed) == 1 else ''}"
        # A device that is driven by vendor reports (device.hid.report) has no effects.
        yield along if plan.foreign_effect_s is None else f"{along}, by {wording.count(len(plan.renew), 'effect')}"
        yield from filter(None, [plan.leak_text])
    if verdict.layout is None:
        yield f"the report descriptor is not valid: {verdict.problem}"
        return
    fields = {f"axis {name}: input": axis.field for name, axis in verdict.layout.input.items()}
    if verdict.layout.constant_force is not None:
        fields["constant force: magnitude in output"] = verdict.layout.constant_force.magnitude
    for what, field in fields.items():
        at = f"{field.report_id}, {field.bit_size} bits at {field.bit_offset}"
        yield f"{what} report {at}, {field.logical_min} to {field.logical_max}"
    yield from (f"not used: {problem}" for problem in verdict.layout.problems)
