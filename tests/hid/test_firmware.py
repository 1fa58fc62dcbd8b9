"""The simulated firmware, with which other tests check hapticd, follows the specification."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from hapticd.hid.plan import DeviceError
from tests.support import firmware_descriptors as descriptors
from tests.support.firmware import Firmware, Variant
from tests.support.firmware_reports import FEATURE, INPUT, OUTPUT, Form, places_of
from tests.support.hid_descriptors import Joystick

FINE = descriptors.OPENFFBOARD_2
FULL = 32767


class Host:
    """Sends what a driver sends, from the numbers that a test gives."""

    def __init__(self, stick: Firmware) -> None:
        self.stick = stick
        self.control("enable_actuators")

    def form(self, name: str) -> Form:
        return self.stick.forms[name]

    def send(self, name: str, chosen: str = "", **numbers: int) -> None:
        self.stick.take(self.form(name).write(chosen, **numbers))

    def control(self, command: str) -> None:
        self.send("control", command)

    def create(self, kind: str = "constant_force") -> tuple[str, int, int]:
        """Create an effect; return its status, its block and the remaining memory."""
        self.stick.set_feature(self.form("create").write(kind))
        load = self.form("load")
        content = load.read(self.stick.get_feature(load.report, load.size + 1)[1:])
        return str(content["chosen"]), int(content["index"]), int(content["ram_pool_available"])

    def effect(self, kind: str = "constant_force", *, turns: float = 0.75, **numbers: int) -> int:
        """Create an effect of one second that comes from a direction in turns (east is 0.25), and return its block."""
        _, index, _ = self.create(kind)
        asked = {"duration": 1000, "gain": 255, "direction_enable": 1, **numbers}
        self.send("set_effect", kind, index=index, direction=round(36000 * turns), **asked)
        return index

    def start(self, index: int, loops: int = 1, how: str = "start") -> None:
        self.send("operation", how, index=index, loops=loops)


@pytest.fixture
def host() -> Host:
    return Host(Firmware(FINE))


def along_x(stick: Firmware, t_s: float) -> float:
    x, y = stick.force(t_s)
    assert y == pytest.approx(0.0, abs=1e-12)
    return x


def test_a_descriptor_is_read_bit_by_bit() -> None:
    """Set Effect of the captured joystick has block, type, times, gain, trigger button, flags and direction."""
    places = [place for place in places_of(descriptors.SIDEWINDER_FF2) if place.kind == OUTPUT and place.report == 1]
    at = {place.usages[0] & 0xFFFF: (place.at, place.bits) for place in places if place.usages}
    assert at[0x22] == (0, 8) and at[0x50] == (16, 16) and at[0x52] == (64, 8) and at[0x53] == (72, 8)
    assert at[0x30] == (80, 1) and at[0x31] == (81, 1) and at[0x56] == (82, 1) and at[0xA7] == (104, 16)
    report = bytes.fromhex("01 01 01 64 00 00 00 00 00 ff ff 04 bf 00 00 00")
    with Firmware(descriptors.SIDEWINDER_FF2) as stick:
        name, content = stick.read(report)
        assert name == "set_effect" and content["chosen"] == "constant_force" and content["duration"] == 100
        assert content["direction_enable"] == 1 and content["direction 0"] == 191 and content["axes"] == ""


def test_signs_and_the_width_of_numbers() -> None:
    places = {place.usages[0] & 0xFFFF: place for place in places_of(bytes(Joystick())) if place.usages}
    magnitude = next(p for p in places_of(bytes(Joystick())) if p.usages == (0x0F0070,) and p.logical[0] < 0)
    data = bytearray(3)
    for number in (-10000, -1, 0, 1, 10000):
        magnitude.put(data, number)
        assert magnitude.get(data) == number
    assert {place.kind for place in places.values()} <= {INPUT, OUTPUT, FEATURE}


@pytest.mark.parametrize(
    ("turns", "way"),
    [(0.0, (0, -1)), (0.25, (-1, 0)), (0.5, (0, 1)), (0.75, (1, 0)), (0.875, (math.sqrt(0.5), -math.sqrt(0.5)))],
)
def test_a_force_comes_from_its_direction(host: Host, turns: float, way: tuple[float, float]) -> None:
    index = host.effect(turns=turns)
    host.send("constant_force", index=index, magnitude=FULL)
    assert host.stick.force() == (0.0, 0.0)
    host.start(index)
    assert host.stick.force() == pytest.approx(way, abs=1e-9)
    host.stick.close()


def test_envelope_gain_and_the_end(host: Host) -> None:
    stick, index = host.stick, host.effect(gain=51)
    host.send("gain", gain=102)
    host.send("constant_force", index=index, magnitude=-FULL // 2)
    host.send("envelope", index=index, attack_level=FULL, attack_time=200, fade_level=0, fade_time=100)
    host.start(index)
    scale = 51 / 255 * 102 / 255
    half = FULL // 2 / FULL
    for t_s, level in ((0.0, 1.0), (0.1, (1.0 + half) / 2), (0.5, half), (0.95, half / 2), (1.0, 0.0), (2.0, 0.0)):
        assert along_x(stick, t_s) == pytest.approx(-scale * level, abs=1e-4), t_s
    stick.close()


WAVES: dict[str, Callable[[float], float]] = {
    "sine": lambda turn: math.sin(2 * math.pi * turn),
    "square": lambda turn: 1.0 if turn % 1 < 0.5 else -1.0,
    "triangle": lambda turn: 2 / math.pi * math.asin(math.sin(2 * math.pi * turn)),
    "sawtooth_up": lambda turn: 2 * (turn % 1) - 1,
    "sawtooth_down": lambda turn: 1 - 2 * (turn % 1),
}


@pytest.mark.parametrize("kind", WAVES)
def test_waves(host: Host, kind: str) -> None:
    stick, index = host.stick, host.effect(kind)
    host.send("periodic", index=index, magnitude=FULL // 2, offset=FULL // 4, phase=9000, period=50)
    host.start(index)
    for k in range(1, 40):
        t_s = k * 0.0071
        wanted = FULL // 4 / FULL + FULL // 2 / FULL * WAVES[kind](t_s / 0.05 + 0.25)
        assert along_x(stick, t_s) == pytest.approx(wanted, abs=1e-9), t_s
    stick.close()


def test_ramp_delay_and_loops(host: Host) -> None:
    stick, index = host.stick, host.effect("ramp", duration=400, start_delay=100)
    host.send("ramp", index=index, ramp_start=-FULL, ramp_end=FULL)
    host.start(index, loops=2)
    for t_s, level in (
        (0.05, 0.0),
        (0.1, -1.0),
        (0.3, 0.0),
        (0.4, 0.5),
        (0.55, 0.0),
        (0.8, 0.0),
        (0.9, 0.5),
        (1.1, 0.0),
    ):
        assert along_x(stick, t_s) == pytest.approx(level, abs=1e-9), t_s
    stick.close()


def test_stop_solo_pause_and_reset(host: Host) -> None:
    stick = host.stick
    first, second = host.effect(), host.effect()
    for index, magnitude in ((first, FULL // 2), (second, FULL // 4)):
        host.send("constant_force", index=index, magnitude=magnitude)
        host.start(index)
    assert along_x(stick, 0.0) == pytest.approx(0.75, abs=1e-4)
    host.start(second, how="start_solo")
    assert along_x(stick, 0.0) == pytest.approx(0.25, abs=1e-4)
    stick.now = 0.4
    host.control("device_pause")
    assert stick.force() == (0.0, 0.0)
    stick.now = 2.0
    host.control("device_continue")
    # The rest of the second at the moment of the pause.
    assert along_x(stick, 2.59) == pytest.approx(0.25, abs=1e-4) and along_x(stick, 2.61) == 0.0
    host.control("disable_actuators")
    assert stick.force() == (0.0, 0.0)
    host.control("enable_actuators")
    assert stick.force() != (0.0, 0.0)
    host.control("stop_all_effects")
    assert stick.force() == (0.0, 0.0) and len(stick.effects) == 2
    host.control("device_reset")
    assert stick.effects == {} and stick.enabled != stick.variant.reset_disables
    stick.close()


def test_conditions(host: Host) -> None:
    stick = host.stick
    stick.motion = lambda t_s: (0.5 * math.sin(2.0 * t_s), 0.25)
    spring, damper = host.effect("spring"), host.effect("damper")
    numbers = {"positive_saturation": FULL, "negative_saturation": FULL // 4}
    shape = {"positive_coefficient": FULL // 2, "negative_coefficient": FULL, "dead_band": FULL // 8}
    for block in (0, 1):
        host.send("condition", index=spring, block=block, center=FULL // 10 if block == 0 else 0, **numbers, **shape)
    host.start(spring)
    for t_s in (0.1, 0.3, 0.7):
        beyond = 0.5 * math.sin(2.0 * t_s) - 0.1
        wanted = -0.5 * max(beyond - 0.125, 0.0)
        assert stick.force(t_s) == pytest.approx((wanted, -(0.25 - 0.125)), abs=1e-4), t_s
    # In the other direction the other coefficient applies, up to its saturation.
    assert stick.force(0.99)[0] < 0.0
    stick.motion = lambda t_s: (-0.5, 0.0)
    assert stick.force() == (pytest.approx(FULL // 4 / FULL), 0.0)
    stick.motion = lambda t_s: (0.3 * t_s, 0.0)
    host.send("operation", "stop", index=spring)
    host.send("condition", index=damper, block=0, positive_coefficient=FULL // 2, positive_saturation=FULL)
    host.start(damper)
    assert stick.force(0.5) == pytest.approx((-0.15, 0.0), abs=1e-4)
    stick.close()


def test_memory_and_indices() -> None:
    with Firmware(FINE, Variant(most_effects=3, ram=40, effect_ram=16, refuses=frozenset({"spring"}))) as stick:
        host = Host(stick)
        assert host.create() == ("success", 1, 24)
        assert host.create("spring") == ("error", 0, 24)
        assert host.create() == ("success", 2, 8)
        assert host.create() == ("full", 0, 8)
        host.send("block_free", index=1)
        assert host.create("sine") == ("success", 1, 8)
        assert stick.faults == []
        host.send("constant_force", index=9, magnitude=1)
        assert len(stick.faults) == 1


def test_pools() -> None:
    asked: list[int] = []
    for variant in (Variant(pool_frees=True), Variant(pool_says=(1,), simultaneous=4), Variant(pool_stalls=True)):
        with Firmware(FINE, variant) as stick:
            Host(stick).create()
            pool = stick.forms["pool"]
            for _ in range(2):
                try:
                    answer = stick.get_feature(pool.report, pool.size + 1)
                    asked.append(int(pool.read(answer[1:])["simultaneous_effects_max"]))
                except DeviceError:
                    asked.append(-1)
            assert len(stick.effects) == (0 if variant.pool_frees else 1)
    assert asked == [40, 40, 1, 4, -1, -1]


def test_another_program_gets_the_block_of_a_lost_effect(host: Host) -> None:
    """Firmware that accepts reports for lost effects mixes another program's effects with hapticd's."""
    with Firmware(FINE, Variant(takes_unknown=True)) as stick:
        ours = Host(stick)
        index = ours.effect(turns=0.75)
        ours.send("constant_force", index=index, magnitude=FULL)
        ours.start(index)
        assert stick.force() == pytest.approx((1.0, 0.0))
        assert stick.stranger(turns=0.0, magnitude=0.5) == index
        ours.send("constant_force", index=index, magnitude=FULL)
        assert stick.force() == pytest.approx((0.0, -1.0))
    host.stick.close()
