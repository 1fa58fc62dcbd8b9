"""A short run of the descriptor fuzzer, defects that long runs found, and proofs that the fuzzer finds defects."""

from __future__ import annotations

import random
from dataclasses import replace
from pathlib import Path

import pytest

from hapticd.cli import main
from hapticd.config.hid import Hid
from hapticd.hid.descriptor.layout import layout_of
from hapticd.hid.descriptor.parser import parse
from hapticd.hid.drivers.pid import PidDriver
from hapticd.hid.drivers.pid_plan import periodic_of
from hapticd.hid.nearest_effect import _tried_times
from hapticd.hid.verdict import verdict_of
from tests.soak import fuzz_descriptors as fuzz
from tests.support.hid_descriptors import Joystick, logical, physical, usage
from tests.support.report_fields import OUTPUT, reports_of

STICK = bytes(Joystick())


def test_descriptors() -> None:
    outcomes, _ = fuzz.fuzz(random.Random(107), 40)
    assert {"driven", "refused", "not usable"} <= outcomes.keys()


@pytest.mark.slow
def test_more_descriptors() -> None:
    outcomes, _ = fuzz.fuzz(random.Random(108), 3000)
    assert outcomes["driven"] > 1000 and outcomes["not drivable"] > 100


def test_the_initial_descriptors_can_be_driven() -> None:
    """All initial descriptors can be driven, except the one without a constant force."""
    refused = [at for at, descriptor in enumerate(fuzz.DEVICES) if not verdict_of(Hid(), descriptor).drivable]
    assert refused == [fuzz.DEVICES.index(fuzz.known.XBOX_ONE_S)]


@pytest.mark.long
@pytest.mark.parametrize("command", [False, True])
def test_the_command_agrees_with_the_driver(command: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The first line of `devices parse` agrees with a set-up, over mutated descriptors."""
    source, file = random.Random(109), tmp_path / "descriptor"
    items = fuzz.items_of(STICK)
    seen = set()
    with fuzz.without_pauses():
        for _ in range(12 if command else 25):
            descriptor = fuzz.mutated_items(source, items)
            drivable = verdict_of(Hid(), descriptor).drivable
            if command:
                file.write_bytes(descriptor)
                main(["devices", "parse", str(file)])
                assert capsys.readouterr().out.startswith("can be driven\n") == drivable
            elif drivable:
                layout = layout_of(parse(descriptor))
                assert PidDriver(layout, Hid()).set_up(fuzz.Loader(layout, 40)).renew
            seen.add(drivable)
    assert seen == {False, True}


def test_a_number_outside_of_its_field_is_found() -> None:
    """Set Constant Force of effect 1: a magnitude one too large or small, another report, another length."""
    reports = reports_of(STICK)
    number = Joystick().ids()["constant_force"]

    def force(magnitude: int, index: int = 1) -> bytes:
        return bytes([number, index]) + magnitude.to_bytes(2, "little", signed=True)

    for magnitude in (-10000, 0, 10000):
        fuzz.check_report(reports, OUTPUT, force(magnitude), endless=False)
    for wrong in (force(10001), force(-10001), force(1, index=41), force(1, index=0), b"\x63" + force(1)[1:]):
        with pytest.raises(AssertionError):
            fuzz.check_report(reports, OUTPUT, wrong, endless=False)
    with pytest.raises(AssertionError):
        fuzz.check_report(reports, OUTPUT, force(1) + b"\0", endless=False)


def instead(old: bytes, new: bytes) -> bytes:
    assert old in STICK
    return STICK.replace(old, new, 1)


def test_a_load_status_that_cannot_say_success_is_not_waited_for() -> None:
    """The index shows that the effect was created. Each set-up took 0.3 s and failed before."""
    layout = layout_of(parse(instead(usage(0x8C, 0x8D, 0x8E), usage(0x8B, 0x8D, 0x8E))))
    assert layout.block_load is not None and layout.block_load.status is None
    assert PidDriver(layout, Hid()).set_up(fuzz.Loader(layout, 40)).renew


def test_times_in_parts_of_a_picosecond_do_not_overflow() -> None:
    """A fade of 0.1 s is 4e20 counts, more than 64 bits hold: the longest time of the field is used."""
    scales = periodic_of(layout_of(parse(bytes(Joystick(time_exponent=-4)))), Hid(), [1]).scales
    tiny = replace(scales.fade_time, counts_per_unit=4e21)
    times = _tried_times(0.05, replace(scales, fade_time=tiny))
    assert len(times.fade) and set(times.fade.tolist()) <= {0, tiny.max_counts}


def test_an_index_that_block_free_cannot_carry_is_not_freed_as_another() -> None:
    ids = Joystick().ids()
    index = usage(0x22) + logical(1, 40) + physical(1, 40)
    at = STICK.index(bytes([0x85, ids["block_free"]]), STICK.index(usage(0x90)))
    narrow = STICK[:at] + STICK[at:].replace(index, usage(0x22) + logical(1, 1) + physical(1, 1), 1)
    layout = layout_of(parse(narrow))
    assert layout.block_free is not None and layout.block_free.effect_index.logical_max == 1
    plan = PidDriver(layout, Hid()).set_up(fuzz.Loader(layout, 40))
    assert [message.data[1] for message in plan.stop if message.data[0] == ids["block_free"]] == [1]
