"""C's HID interface as Python uses it, with a socket pair in place of the hidraw node."""

from __future__ import annotations

import errno
import math
import os
import signal
import socket
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest

from hapticd.base.core import CData, HidMeaning, HidQuantity, Status, ffi, invalid_reason, lib

SECOND_NS = 10**9
PATIENCE_S = 30.0


def new_plan() -> CData:
    """Return a plan. Report 1: x, y, 16 bits, 0.1 mm/count; 2: actuators on. Output 5: two forces, 100 counts/N."""
    plan = ffi.new("struct hd_hid_plan *")
    for axis in range(2):
        plan.axes[axis].field = {"bit_offset": 16 * axis, "bit_size": 16, "is_signed": 1}
        plan.axes[axis].report_id = 1
        plan.axes[axis].m_per_count = (1e-4, 1e-4)
    plan.states[0].field = {"bit_offset": 1, "bit_size": 1}
    plan.states[0].report_id = 2
    plan.states[0].meaning = HidMeaning.ACTUATORS
    plan.state_count = 1
    message = plan.force.messages[0]
    message.length = 5
    message.bytes[0] = 5
    message.value_count = 2
    for axis, quantity in enumerate((HidQuantity.X, HidQuantity.Y)):
        message.values[axis].field = {"bit_offset": 16 * axis, "bit_size": 16, "is_signed": 1}
        message.values[axis].quantity = quantity
        message.values[axis].counts_per_unit = 100.0
        message.values[axis].least = -900
        message.values[axis].most = 900
    plan.force.count = 1
    plan.stop.messages[0].length = 2
    plan.stop.messages[0].bytes[0] = 6
    plan.stop.messages[0].bytes[1] = 3
    plan.stop.count = 1
    return plan


@pytest.fixture
def hid() -> Iterator[CData]:
    yield ffi.gc(lib.hd_hid_new(), lib.hd_hid_free)


@pytest.fixture
def pair() -> Iterator[tuple[socket.socket, socket.socket]]:
    ours, device = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    device.settimeout(PATIENCE_S)
    with ours, device:
        yield ours, device


def status_of(hid: CData) -> CData:
    status = ffi.new("struct hd_hid_status *")
    lib.hd_hid_status(hid, status)
    return status


def test_a_connection_from_end_to_end(hid: CData, pair: tuple[socket.socket, socket.socket]) -> None:
    ours, device = pair
    assert lib.hd_hid_connect(hid, new_plan(), ours.fileno(), 0) == Status.OK
    assert device.recv(64) == struct.pack("<Bhh", 5, 0, 0)
    device.send(struct.pack("<Bhh", 1, 250, -3))
    device.send(bytes([2, 2]))
    device.send(bytes([2, 0]))
    assert lib.hd_hid_wait(hid, int(PATIENCE_S) * SECOND_NS) == 1
    status = status_of(hid)
    assert (status.connected, status.error, status.reset) == (1, 0, 1)
    assert (status.states, status.states_known) == (0, 1 << (HidMeaning.ACTUATORS - 1))
    assert (status.positions, status.short_reports) == (1, 0)
    lib.hd_hid_clear_reset(hid)
    assert status_of(hid).reset == 0
    assert lib.hd_hid_disconnect(hid, 1) == 0
    assert device.recv(64) == struct.pack("<Bhh", 5, 0, 0)
    assert device.recv(64) == bytes([6, 3])
    assert status_of(hid).connected == 0


def test_a_fault_of_its_threads_reaches_the_handler_that_ends_the_force(
    hid: CData, pair: tuple[socket.socket, socket.socket]
) -> None:
    """In a thread that blocks the signal, the kernel would end the process at once."""
    ours, device = pair
    before = set(os.listdir("/proc/self/task"))
    assert lib.hd_hid_connect(hid, new_plan(), ours.fileno(), 0) == Status.OK
    # Both threads have worked: until a thread begins, the C library blocks all signals in it.
    device.recv(64)
    device.send(bytes([2, 2]))
    device.send(bytes([2, 0]))
    assert lib.hd_hid_wait(hid, int(PATIENCE_S) * SECOND_NS) == 1
    threads = set(os.listdir("/proc/self/task")) - before
    assert len(threads) == 2
    for thread in threads:
        status = Path(f"/proc/self/task/{thread}/status").read_text(encoding="utf-8")
        blocked = int(status.partition("SigBlk:")[2].split()[0], 16)
        passed = {number for number in signal.valid_signals() if not blocked >> (number - 1) & 1}
        faults = {signal.SIGABRT, signal.SIGSEGV, signal.SIGBUS, signal.SIGILL, signal.SIGFPE}
        assert passed >= faults and not passed & {signal.SIGTERM, signal.SIGINT, signal.SIGPIPE, signal.SIGCHLD}


def test_a_device_that_leaves(hid: CData, pair: tuple[socket.socket, socket.socket]) -> None:
    ours, device = pair
    assert lib.hd_hid_connect(hid, new_plan(), ours.fileno(), 0) == Status.OK
    device.recv(64)
    device.close()
    assert lib.hd_hid_wait(hid, int(PATIENCE_S) * SECOND_NS) == 1
    status = status_of(hid)
    assert status.connected == 0
    assert status.error in (errno.ENODEV, errno.ECONNRESET)
    assert lib.hd_hid_disconnect(hid, 1) == status.error


def test_a_wrong_plan_is_refused_in_words(hid: CData, pair: tuple[socket.socket, socket.socket]) -> None:
    plan = new_plan()
    plan.force.messages[0].length = 4
    assert lib.hd_hid_connect(hid, plan, pair[0].fileno(), 0) == Status.ERR_INVALID
    assert invalid_reason() == "plan: force[0]: a number of 16 bits at bit 16 does not lie in its 4 bytes"


def test_a_wake_ends_a_wait(hid: CData) -> None:
    lib.hd_hid_wake(hid)
    assert lib.hd_hid_wait(hid, SECOND_NS) == 1
    assert lib.hd_hid_wait(hid, 0) == 0


@pytest.mark.parametrize("force", [(2.0, 0.0), (0.0, 3.0), (-1.5, 2.0), (-1.0, -1.0), (0.0, -4.0)])
def test_direction_and_magnitude(force: tuple[float, float]) -> None:
    """A direction is where a force comes from, clockwise from north: 90 degrees pushes to the left."""
    message = ffi.new("struct hd_hid_message *")
    message.length = 4
    message.value_count = 2
    message.values[0].field = {"bit_offset": 0, "bit_size": 16}
    message.values[0].quantity = HidQuantity.DIRECTION
    message.values[0].counts_per_unit = 36000 / (2 * math.pi)
    message.values[0].most = 35999
    message.values[1].field = {"bit_offset": 16, "bit_size": 8}
    message.values[1].quantity = HidQuantity.MAGNITUDE
    message.values[1].counts_per_unit = 255 / 8.0
    message.values[1].most = 255
    composed = ffi.new("uint8_t[4]")
    lib.hd_hid_compose(message, ffi.new("double[]", force), composed)
    direction, magnitude = struct.unpack("<xHB", ffi.buffer(composed)[:])
    angle = math.radians(direction / 100)
    assert -math.sin(angle) * magnitude * 8 / 255 == pytest.approx(force[0], abs=0.02)
    assert -math.cos(angle) * magnitude * 8 / 255 == pytest.approx(force[1], abs=0.02)
