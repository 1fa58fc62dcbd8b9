"""Effects of another program in place of hapticd's: how long they last, with a model of the link and C's writer."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest

from hapticd.base.core import CData, Status, ffi, lib
from hapticd.config.hid import Hid
from hapticd.hid.descriptor.layout import layout_of
from hapticd.hid.descriptor.parser import parse
from hapticd.hid.drivers.pid import PidDriver
from hapticd.hid.link import MAX_FOREIGN_EFFECT_S, MAX_RESTORE_SHARE, plan_paced_for_link
from hapticd.hid.plan import Message, Plan
from tests.support.firmware import ADAPT, FINO, OPENFFBOARD, Firmware, Variant
from tests.support.firmware_descriptors import ADAPT_FFB_JOY, OPENFFBOARD_2
from tests.support.firmware_descriptors import FINO as FINO_DESCRIPTOR

FULL_N = 8.9
NOTHING = Variant(tells="nothing", takes_unknown=True)
"""Firmware that accepts reports for lost effects, and reports nothing about effects."""
KINDS: dict[str, tuple[bytes, Variant]] = {
    "fino": (FINO_DESCRIPTOR, FINO),
    "openffboard": (OPENFFBOARD_2, replace(OPENFFBOARD, takes_unknown=True)),
    "plain": (FINO_DESCRIPTOR, NOTHING),
}


def set_up(stick: Firmware, **keys: Any) -> Plan:
    hid = Hid.model_validate({"full_scale_force_n": FULL_N, **keys})
    return PidDriver(layout_of(parse(stick.descriptor)), hid).set_up(stick.device)


class Writer:
    """Model of C's writer: changed forces, or at a renewal all forces and the renewal, then one restoring report."""

    def __init__(self, stick: Firmware, plan: Plan, report_s: float) -> None:
        self.stick, self.plan, self.report_s = stick, plan, report_s
        self.now = self.renew_s = self.restore_s = stick.now
        self.which = self.restored = self.written = 0
        self.sent: dict[int, bytes] = {}
        described = plan.to_c()
        self.scripts = {name: getattr(described, name).messages for name in ("force", "renew", "restore")}
        self.described: CData = described

    def _bytes(self, script: str, place: int, message: Message, force_n: tuple[float, float]) -> bytes:
        room = ffi.new("uint8_t[]", len(message.data))
        lib.hd_hid_compose(ffi.addressof(self.scripts[script], place), ffi.new("double[2]", force_n), room)
        return bytes(ffi.buffer(room))

    def _write(self, data: bytes) -> None:
        self.now += self.report_s
        self.stick.now = self.now
        self.stick.take(data)
        self.written += 1

    def go(self, force_n: tuple[float, float]) -> None:
        """Make one pass of the writer."""
        before = self.now
        renews = self.now >= self.renew_s
        for place, message in enumerate(self.plan.force):
            data = self._bytes("force", place, message, force_n)
            if renews or self.sent.get(place) != data:
                self._write(data)
                self.sent[place] = data
        if renews:
            self.renew_s = self.now + self.plan.renew_s
            for place, message in enumerate(self.plan.renew):
                self._write(self._bytes("renew", place, message, force_n))
        if self.plan.restore and self.now >= self.restore_s:
            self.restore_s = max(self.restore_s + self.plan.restore_s, self.now)
            place = self.which % len(self.plan.restore)
            self.which, self.restored = place + 1, self.restored + 1
            self._write(self._bytes("restore", place, self.plan.restore[place], force_n))
        if self.now == before:
            self.now += 1e-3
            self.stick.now = self.now


def wobbling(force_n: tuple[float, float]) -> Callable[[int], tuple[float, float]]:
    """Return a force that changes at each pass, so that the link is full."""
    return lambda count: (force_n[0] + 0.04 * (count % 2), force_n[1] - 0.04 * (count % 2))


@pytest.mark.parametrize(
    ("kind", "keys", "report_s"),
    [
        ("fino", {}, 1e-3),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (
                ("fino", {}, 0.0),
                ("fino", {}, 4e-3),
                *((kind, {}, report_s) for kind in ("openffboard", "plain") for report_s in (1e-3, 4e-3)),
                *((kind, {"quirks": ["one_effect"]}, 2e-3) for kind in ("fino", "openffboard")),
                ("fino", {"renew_s": 0.4, "effect_duration_s": 1}, 1e-3),
            )
        ),
    ],
)
def test_an_effect_of_another_program_ends_in_time(kind: str, keys: dict[str, Any], report_s: float) -> None:
    with Firmware(*KINDS[kind]) as stick:
        plan = set_up(stick, **keys)
        plan = plan_paced_for_link(plan, 1.0 / (report_s * len(plan.force)) if report_s else None)
        assert plan.foreign_effect_s is not None and plan.foreign_effect_s <= MAX_FOREIGN_EFFECT_S + 1e-9
        writer = Writer(stick, plan, report_s)
        wanted = wobbling((4.0, -2.5))
        ours: tuple[float, float] | None = None
        for turn in range(5):
            passes = 0
            # Each time at another place in the sequence of restoring reports.
            until = writer.now + 0.1 + 0.0217 * turn
            while writer.now < until:
                writer.go(wanted(passes))
                passes += 1
            ours = ours or stick.force()
            assert [abs(part) for part in ours] == pytest.approx([4.0 / FULL_N, 2.5 / FULL_N], abs=0.02)
            assert stick.force() == pytest.approx(ours, abs=0.02), turn
            stick.stranger(turns=0.2 * turn, magnitude=0.9)
            begun = writer.now
            wrong = begun
            while writer.now < begun + 0.15:
                writer.go(wanted(passes))
                passes += 1
                if stick.force() != pytest.approx(ours, abs=0.02):
                    wrong = writer.now
            assert wrong - begun <= MAX_FOREIGN_EFFECT_S, turn


def test_without_restoring_it_would_last(monkeypatch: pytest.MonkeyPatch) -> None:
    """The test above relies on this: the firmware lets another program reverse hapticd's force."""
    with Firmware(FINO_DESCRIPTOR, FINO) as stick:
        writer = Writer(stick, plan_paced_for_link(set_up(stick), 500.0), 1e-3)
        object.__setattr__(writer.plan, "restore", ())
        for _ in range(100):
            writer.go((4.0, 0.0))
        stick.stranger(turns=0.0, magnitude=0.9)
        for _ in range(1000):
            writer.go((4.0, 0.0))
        x, y = stick.force()
        assert abs(x) < 0.01 and y == pytest.approx(-4.0 / FULL_N, abs=0.01)


def test_an_envelope_and_a_gain_of_a_stranger_end_too() -> None:
    with Firmware(FINO_DESCRIPTOR, FINO) as stick:
        writer = Writer(stick, plan_paced_for_link(set_up(stick), 500.0), 1e-3)
        envelope, gain = stick.forms["envelope"], stick.forms["gain"]
        stick.take(envelope.write(index=1, attack_level=0, attack_time=30000))
        stick.take(gain.write(gain=20))
        begun = writer.now
        while writer.now < begun + MAX_FOREIGN_EFFECT_S:
            writer.go((4.0, -2.5))
        assert stick.force() == pytest.approx((4.0 / FULL_N, -2.5 / FULL_N), abs=0.01)


def test_a_device_that_ignores_lost_effects_exerts_only_the_force_of_hapticd() -> None:
    with Firmware(ADAPT_FFB_JOY, ADAPT) as stick:
        writer = Writer(stick, plan_paced_for_link(set_up(stick), 500.0), 1e-3)
        stick.stranger(turns=0.3, magnitude=0.9)
        begun = writer.now
        while writer.now < begun + MAX_FOREIGN_EFFECT_S:
            writer.go((4.0, -2.5))
        assert stick.force() == pytest.approx((4.0 / FULL_N, 0.0), abs=0.02)


@pytest.mark.parametrize("report_s", [1e-3, 2e-3, 4e-3, 8e-3, 16e-3])
def test_restoring_takes_at_most_a_third_of_a_slow_link_and_its_time_is_reported(report_s: float) -> None:
    with Firmware(FINO_DESCRIPTOR, FINO) as stick:
        plan = set_up(stick)
        # Direction and envelope of two effects, and the gain of the device.
        assert len(plan.restore) == 5
        plan = plan_paced_for_link(plan, 1.0 / (report_s * len(plan.force)))
        assert plan.foreign_effect_s is not None
        assert (plan.foreign_effect_s <= MAX_FOREIGN_EFFECT_S + 1e-9) == (report_s <= 4e-3)
        writer = Writer(stick, plan, report_s)
        wanted = wobbling((4.0, -2.5))
        begun, longest, since, turns = writer.now, 0.0, writer.now, 0
        for count in range(400):
            writer.go(wanted(count))
            if writer.restored // len(plan.restore) > turns:
                turns = writer.restored // len(plan.restore)
                longest, since = max(longest, writer.now - since), writer.now
        assert turns > 3 and longest <= plan.foreign_effect_s + 1e-9
        assert writer.restored <= MAX_RESTORE_SHARE * (writer.now - begun) / report_s + 1
        # The effects are started again before they end, however slow the link is.
        starts = [t_s for t_s, _, data in stick.reports if data[:1] == plan.renew[0].data[:1]]
        assert max(b - a for a, b in pairwise(starts)) < 0.1 or report_s > 8e-3


def test_a_plan_without_effects_is_left_as_it_is() -> None:
    with Firmware(FINO_DESCRIPTOR, FINO) as stick:
        plan = set_up(stick)
        other = Plan(x=plan.x, y=plan.y, force=plan.force, renew=plan.renew, stop=plan.stop)
        assert plan_paced_for_link(other, 100.0) == other and other.foreign_effect_s is None


# ---- The core's own writer -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "kind", ["fino", pytest.param("openffboard", marks=pytest.mark.slow), pytest.param("plain", marks=pytest.mark.slow)]
)
def test_the_writer_restores_effects_that_another_program_changed(kind: str) -> None:
    """Only the order of reports counts, not their times."""
    descriptor, variant = KINDS[kind]
    with Firmware(descriptor, variant, clock=time.monotonic) as stick:
        plan = plan_paced_for_link(set_up(stick), None)
        hid = ffi.gc(lib.hd_hid_new(), lib.hd_hid_free)
        assert lib.hd_hid_connect(hid, plan.to_c(), stick.device.fileno(), 0) == Status.OK
        try:
            for turns in (0.0, 0.3):
                stick.stranger(turns=turns, magnitude=0.9)
                before = len(stick.reports)
                # From here on, all parameters of both effects.
                wanted = {message.data for message in (*plan.restore, *plan.renew)}
                stick.wait(lambda: wanted <= {data for _, _, data in stick.reports[before:]})  # noqa: B023
                effects = [stick.effects[index] for index in (1, 2)]
                assert [effect.kind for effect in effects] == ["constant_force", "constant_force"]
                assert [effect.magnitude for effect in effects] == [0.0, 0.0]
            assert stick.force() == (0.0, 0.0)
        finally:
            lib.hd_hid_disconnect(hid, 1)
