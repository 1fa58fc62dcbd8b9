"""PID Pool is read once, before the first effect is created, and a set-up never fails because of it."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass, field

import pytest

from hapticd.config.hid import Hid
from hapticd.hid.drivers import pid
from hapticd.hid.drivers.pid import PidDriver
from hapticd.hid.plan import Bits, DeviceError
from hapticd.system.repeated_lines import Repeats
from tests.support.hid_descriptors import Joystick
from tests.support.hid_device import FakePid

FINE = Joystick(direction_bits=16, time_exponent=-4, level=10000)
"""A joystick that can play periodic effects, too."""


@dataclass
class Pooled(FakePid):
    """A joystick whose pool behaves as that of real firmware."""

    frees: bool = False
    """Every effect is freed when the pool is read."""
    stalls: bool = False
    """The request is not answered."""
    cut: int | None = None
    """Bytes of its answer."""
    says: list[int] = field(default_factory=list)
    """Reported numbers of effects at a time, the last one repeatedly; if empty, the number that it has room for."""

    def get_feature(self, report_id: int, length: int) -> bytes:
        place = self.layout.pool
        assert place is not None and place.simultaneous_effects_max is not None
        if report_id != place.report_id:
            return super().get_feature(report_id, length)
        report = bytearray(super().get_feature(report_id, length))
        if self.frees:
            self._forget()
        if self.stalls:
            raise DeviceError(f"fake0: cannot get feature report {report_id}: Broken pipe")
        if self.says:
            max_effects = self.says.pop(0) if len(self.says) > 1 else self.says[0]
            where = place.simultaneous_effects_max
            Bits(where.bit_offset, where.bit_size, where.is_signed).put(report, max_effects)
        return bytes(report[: self.cut])


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pid, "POOL_REREAD_DELAY_S", 0.0)
    monkeypatch.setattr(pid, "_repeats", Repeats())


@pytest.fixture
def sticks() -> Iterator[list[Pooled]]:
    made: list[Pooled] = []
    yield made
    for stick in made:
        stick.close()


def set_up(sticks: list[Pooled], stick: Pooled, times: int = 1, **keys: object) -> PidDriver:
    sticks.append(stick)
    driver = PidDriver(stick.layout, Hid.model_validate({"offload": "auto", **keys}))
    for _ in range(times):
        driver.set_up(stick.device)
    return driver


def lines(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [record.getMessage() for record in caplog.records if record.name == "hapticd"]


@pytest.mark.parametrize("offload", ["off", "auto"])
@pytest.mark.parametrize("quirks", [[], ["one_effect"], ["no_reset"]])
def test_a_pool_that_frees_all_effects(sticks: list[Pooled], offload: str, quirks: list[str]) -> None:
    stick = Pooled(bytes(FINE), frees=True)
    set_up(sticks, stick, times=2, offload=offload, quirks=quirks)
    constant = 1 if "one_effect" in quirks else 2
    periodic = 8 if offload == "auto" else 0
    assert len(stick.effects) == constant + periodic
    assert all(stick.effects[index].playing for index in range(1, constant + 1))
    # Once in each set-up, before the first effect; never if only one effect is wanted.
    order = [name for name in stick.log if name in ("pool", "create")]
    one = [*["pool"] * (constant + periodic > 1), *["create"] * constant]
    assert order == 2 * one


def test_an_unanswered_pool_is_reported_once(sticks: list[Pooled], caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING, "hapticd")
    stick = Pooled(bytes(FINE), stalls=True)
    set_up(sticks, stick, times=3)
    assert len(stick.effects) == 10
    assert lines(caplog) == [
        "fake0: cannot get feature report 3: Broken pipe; PID Block Load decides how many effects there are"
    ]


def test_a_pool_that_ends_too_soon(sticks: list[Pooled], caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING, "hapticd")
    stick = Pooled(bytes(FINE), cut=2, room=5)
    set_up(sticks, stick)
    assert len(stick.effects) == 5
    assert lines(caplog) == ["fake0: PID Pool is too short, 2 bytes; PID Block Load decides how many effects there are"]


def test_a_pool_that_is_another_report(sticks: list[Pooled], caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING, "hapticd")
    stick = Pooled(bytes(FINE), cut=0)
    set_up(sticks, stick)
    assert len(stick.effects) == 10
    assert lines(caplog) == [
        "fake0: requested PID Pool, report 3, the device returned nothing; "
        "PID Block Load decides how many effects there are"
    ]


@pytest.mark.parametrize("says", [[1, 16], [0, 16]])
def test_a_pool_that_reports_too_few_effects_at_first(
    sticks: list[Pooled], caplog: pytest.LogCaptureFixture, says: list[int]
) -> None:
    caplog.set_level(logging.WARNING, "hapticd")
    stick = Pooled(bytes(FINE), says=says, frees=True)
    set_up(sticks, stick)
    assert len(stick.effects) == 10 and not lines(caplog)
    assert [name for name in stick.log if name in ("pool", "create")][:3] == ["pool", "pool", "create"]


def test_a_pool_that_reports_one_effect_twice(sticks: list[Pooled], caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING, "hapticd")
    stick = Pooled(bytes(FINE), says=[1])
    set_up(sticks, stick)
    assert list(stick.effects) == [1]
    assert stick.log.count("pool") == 2 and stick.log.count("device_reset") == 1
    assert lines(caplog) == ["fake0: plays 1 effect at a time, 2 are needed; one effect with direction is used"]


def test_where_two_effects_are_the_only_way_block_load_decides(
    sticks: list[Pooled], caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING, "hapticd")
    stick = Pooled(bytes(Joystick(direction_bits=0)), says=[1])
    set_up(sticks, stick)
    assert list(stick.effects) == [1, 2]
    assert lines(caplog) == ["fake0: plays 1 effect at a time, 2 are needed; PID Block Load decides"]


def test_a_device_without_a_pool_is_not_asked(sticks: list[Pooled]) -> None:
    stick = Pooled(bytes(FINE), stalls=True)
    set_up(sticks, stick, quirks=["no_pid_pool"])
    assert "pool" not in stick.log and len(stick.effects) == 10
