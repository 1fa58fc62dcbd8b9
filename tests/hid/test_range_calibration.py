"""The measurement of a handle's range: a simulated person moves it to all corners, and lets go."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from hapticd.config.hid import Hid
from hapticd.hid.drivers.pid import PidDriver
from hapticd.hid.plan import DeviceError
from hapticd.hid.range_calibration import START_TIMEOUT_S, MeasuredRange, measure_range
from tests.support.hid_descriptors import Joystick
from tests.support.hid_device import FakePid

TRAVEL_M = 0.06
Counts = tuple[int, int]
LOW, REST, HIGH = (-400, -327), (3, 20), (450, 396)
"""Counts of x and y at the ends and at rest."""


class Table:
    """A device whose handle follows `hand(t_s)`, and a clock that advances only while the caller waits."""

    def __init__(self, hand: Callable[[float], Counts | None], like: Joystick | None = None) -> None:
        self.stick = FakePid(bytes(like or Joystick(axis_range=(-512, 511), axis_bits=10)))
        self.hand = hand
        self.time_s = 0.0
        self.shown: list[str] = []

    def pause(self, duration_s: float) -> None:
        self.time_s += duration_s
        counts = self.hand(self.time_s)
        if counts is not None:
            self.stick.report(*counts)

    def measure(self) -> MeasuredRange:
        driver = PidDriver(self.stick.layout, Hid(travel_m=TRAVEL_M))
        try:
            return measure_range(
                self.stick.device,
                driver,
                TRAVEL_M,
                self.shown.append,
                now=lambda: self.time_s,
                pause=self.pause,
            )
        finally:
            assert not self.stick.gone and self.stick.force() == (0.0, 0.0) and not self.stick.enabled
            self.stick.close()


def swept(t_s: float, rest: Counts = REST, low: Counts = LOW, high: Counts = HIGH, until_s: float = 6.0) -> Counts:
    """Rest for a second, move round the four corners with half a second at each, and let go at `until_s`."""
    corners = [(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]
    if t_s < 1.0 or t_s >= until_s:
        return rest
    turn = (t_s - 1.0) % 4.0
    here, there = corners[int(turn)], corners[(int(turn) + 1) % 4]
    part = max(0.0, 2.0 * (turn % 1.0) - 1.0)
    return round(here[0] + part * (there[0] - here[0])), round(here[1] + part * (there[1] - here[1]))


def test_a_sprung_handle() -> None:
    table = Table(swept)
    found = table.measure()
    assert (found.x, found.y, found.notes) == ((-400, 3, 450), (-327, 20, 396), ())
    assert 8.0 < table.time_s < 10.0, "some seconds after it was let go"
    assert any("x -400..450, y -327..396" in line for line in table.shown)


def test_a_pause_at_a_corner_is_not_the_end() -> None:
    def hand(t_s: float) -> Counts:
        return (450, 396) if 2.0 < t_s < 8.0 else swept(t_s, until_s=14.0)

    assert Table(hand).measure() == MeasuredRange((-400, 3, 450), (-327, 20, 396), ())


def test_an_outlier_and_noise_do_not_widen_the_range() -> None:
    def hand(t_s: float) -> Counts:
        x, y = swept(t_s)
        tick = round(100 * t_s)
        return (511, -512) if tick in (250, 450) else (x, y + tick % 2)

    found = Table(hand).measure()
    assert found.x == (-400, 3, 450)
    assert found.y is not None and found.y == pytest.approx((-327, 20, 396), abs=1)


def test_a_noisy_potentiometer_comes_to_rest() -> None:
    """Its counts of 10 bits change by up to 4 either way while nobody holds the handle."""

    def hand(t_s: float) -> Counts:
        x, y = swept(t_s)
        tick = round(100 * t_s)
        return x + 7 * tick % 9 - 4, y + 5 * tick % 9 - 4

    table = Table(hand)
    found = table.measure()
    assert found.x == pytest.approx((-400, 3, 450), abs=4) and found.y == pytest.approx((-327, 20, 396), abs=4)
    assert table.time_s < 20.0, "some seconds after it was let go"


def test_a_device_that_reports_only_changes() -> None:
    last: list[Counts] = []

    def hand(t_s: float) -> Counts | None:
        here = swept(t_s)
        if last and last[-1] == here:
            return None
        last.append(here)
        return here

    assert Table(hand).measure() == MeasuredRange((-400, 3, 450), (-327, 20, 396), ())


def test_a_handle_without_a_spring() -> None:
    """It stays where it was let go of: the middle is that of the range."""
    table = Table(lambda t_s: swept(t_s, rest=(448, -320)))
    found = table.measure()
    assert (found.x, found.y) == ((-400, 25, 450), (-327, 34, 396))
    assert found.notes[0] == (
        "axis x came to rest at 448, far from the middle of its range -400..450, as a handle without a spring does: 25 "
        "is taken for the middle"
    )
    assert "axis y came to rest at -320" in found.notes[1]


def test_a_small_part_of_the_reports_range() -> None:
    """12 bits of a position in a report of 16 bits."""
    hand = lambda t_s: swept(t_s, rest=(5, -9), low=(-2048, -2000), high=(2047, 1990))  # noqa: E731
    found = Table(hand, Joystick(direction_bits=16)).measure()
    assert (found.x, found.y, found.notes) == ((-2048, 5, 2047), (-2000, -9, 1990), ())


def test_an_axis_that_is_not_moved() -> None:
    found = Table(lambda t_s: (swept(t_s)[0], 20)).measure()
    assert (found.x, found.y) == ((-400, 3, 450), None)
    assert found.notes == ("axis y was hardly moved: its counts are not measured",)


@pytest.mark.parametrize("hand", [lambda t_s: (3, 20), lambda t_s: None], ids=["still", "silent"])
def test_nobody_moves_it(hand: Callable[[float], Counts | None]) -> None:
    table = Table(hand)
    found = table.measure()
    assert (found.x, found.y) == (None, None)
    assert found.notes == (
        "the handle moved by less than 1 % of its axes' range within 20 s: its counts are not measured",
    )
    assert table.time_s == pytest.approx(START_TIMEOUT_S, abs=0.1)


def test_a_handle_with_one_axis() -> None:
    like = Joystick(axis_range=(-512, 511), axis_bits=10, axes=(0x30,), force_axes=(0x30,))
    found = Table(swept, like).measure()
    assert (found.x, found.y, found.notes) == ((-400, 3, 450), None, ())


def test_ctrl_c_leaves_no_force() -> None:
    def hand(t_s: float) -> Counts:
        if t_s > 3.0:
            raise KeyboardInterrupt
        return swept(t_s)

    with pytest.raises(KeyboardInterrupt):
        Table(hand).measure()


def test_a_device_that_is_unplugged() -> None:
    table = Table(swept)

    def hand(t_s: float) -> Counts | None:
        if t_s < 3.0:
            return swept(t_s)
        if not math.isinf(table.time_s):
            table.stick.unplug()
            table.time_s = math.inf
        return None

    table.hand = hand
    driver = PidDriver(table.stick.layout, Hid(travel_m=TRAVEL_M))
    with pytest.raises(DeviceError, match="gone"):
        measure_range(table.stick.device, driver, TRAVEL_M, print, now=lambda: table.time_s, pause=table.pause)
    table.stick.close()
