"""Claim and release of devices, on a tree of files and a simulated kernel that binds and unbinds drivers."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from hapticd.base.errors import HapticdError
from hapticd.hid import claim as claim_module
from hapticd.hid.claim import CLAIM_RULES_PATH, Claims
from tests.support.hid_tree import Kernel
from tests.support.special_files import KINDS, refused, special, untouched

STICK = "0003:2341:8036.0007"
OTHER = "0003:045E:001B.0008"


@pytest.fixture
def kernel(tmp_path: Path) -> Kernel:
    made = Kernel(tmp_path)
    made.plug(STICK)
    made.plug(OTHER)
    return made


def test_claimed_and_released(kernel: Kernel) -> None:
    before = kernel.found(STICK).path
    assert kernel.claims.claim(kernel.found(STICK)) == "hid-generic"
    assert kernel.log == [f"drivers/hid-generic/unbind {STICK}", f"drivers/hid-generic/bind {STICK}"]
    assert kernel.commands == ["udevadm control --reload"]
    assert kernel.claims.names() == [STICK]
    after = kernel.found(STICK).path
    assert after != before and kernel.claims.path(STICK) == after and not os.path.exists(before)
    # Only the nodes of this device are hidden, also without udev.
    assert kernel.modes(STICK) == {0o600} and kernel.modes(OTHER) == {0o660}
    lines = (kernel.root / CLAIM_RULES_PATH).read_text().splitlines()
    assert len(lines) == 2 and all(f'KERNELS=="{STICK}"' in line and OTHER not in line for line in lines)
    assert 'GROUP:="root", MODE:="0600"' in lines[1] and 'TAG-="uaccess"' in lines[0]

    kernel.log.clear()
    assert kernel.claims.release(kernel.found(STICK)) == "hid-generic"
    assert kernel.log == [f"drivers/hid-generic/unbind {STICK}", f"drivers_probe {STICK}"]
    assert kernel.modes(STICK) == {0o660} and kernel.claims.names() == []
    assert not (kernel.root / CLAIM_RULES_PATH).exists() and len(kernel.commands) == 2


def test_the_rule_is_written_before_the_nodes_are_created_again(kernel: Kernel) -> None:
    seen: list[bool] = []

    def write(path: Path, text: str) -> None:
        seen.append((kernel.root / CLAIM_RULES_PATH).exists())
        kernel.write(path, text)

    Claims(kernel.root, write, kernel.run).claim(kernel.found(STICK))
    Claims(kernel.root, write, kernel.run).release(kernel.found(STICK))
    assert seen == [True, True, False, False]


def test_the_driver_of_a_vendor_may_insist(kernel: Kernel) -> None:
    kernel.vendors[STICK] = "hid-vendor"
    kernel.log.clear()
    kernel.write(kernel.root / "sys/bus/hid/drivers/hid-generic/unbind", STICK)
    kernel.write(kernel.root / "sys/bus/hid/drivers_probe", STICK)
    kernel.log.clear()
    assert kernel.claims.claim(kernel.found(STICK)) == "hid-vendor"
    assert kernel.log == [
        f"drivers/hid-vendor/unbind {STICK}",
        f"drivers/hid-generic/bind {STICK}",
        f"drivers_probe {STICK}",
    ]
    assert kernel.modes(STICK) == {0o600}
    assert kernel.claims.release(kernel.found(STICK)) == "hid-vendor"


def test_two_are_claimed_and_one_is_unplugged(kernel: Kernel) -> None:
    for name in (STICK, OTHER):
        kernel.claims.claim(kernel.found(name))
    assert kernel.claims.names() == [STICK, OTHER]
    (kernel.root / "sys/bus/hid/devices" / STICK).unlink()
    assert kernel.claims.names() == [OTHER]
    kernel.claims.release(kernel.found(OTHER))
    assert not (kernel.root / CLAIM_RULES_PATH).exists()


def refusal(kernel: Kernel, what: str, claims: Claims | None = None) -> str:
    with pytest.raises(HapticdError) as caught:
        getattr(claims or kernel.claims, what)(kernel.found(STICK))
    assert "\n" not in str(caught.value)
    return str(caught.value).replace(str(kernel.root), "")


def test_what_is_refused(kernel: Kernel) -> None:
    assert refusal(kernel, "release") == "/dev/hidraw5 (Stick, 2341:8036) is not claimed"
    for node in kernel.claims.nodes(STICK):
        node.chmod(0o600)
    kept = "a line in 70-hapticd.rules already lets only root open its event nodes"
    assert refusal(kernel, "claim") == f"/dev/hidraw5 (Stick, 2341:8036): {kept}"
    assert f"is not claimed: {kept}" in refusal(kernel, "release")
    for node in kernel.claims.nodes(STICK):
        node.chmod(0o644)
    kernel.claims.claim(kernel.found(STICK))
    assert "is already claimed; `hapticd devices release /dev/hidraw7`" in refusal(kernel, "claim")


def test_without_rights_nothing_changes(kernel: Kernel) -> None:
    def denied(path: Path, text: str) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    without = Claims(kernel.root, denied, kernel.run)
    message = "no permission to unbind it from its driver: use sudo"
    assert refusal(kernel, "claim", without).endswith(message)
    assert not (kernel.root / CLAIM_RULES_PATH).exists() and kernel.modes(STICK) == {0o660}
    kernel.claims.claim(kernel.found(STICK))
    assert message in refusal(kernel, "release", without)
    assert kernel.claims.names() == [STICK]


def test_a_device_that_no_driver_takes_again(kernel: Kernel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(claim_module, "REBIND_TIMEOUT_S", 0.0)
    kernel.stubborn.add(STICK)
    assert refusal(kernel, "claim") == f"{STICK}: no driver accepted it: unplug it and plug it in again"
    assert not (kernel.root / CLAIM_RULES_PATH).exists()


@pytest.mark.parametrize("kind", KINDS)
def test_rules_are_written_only_to_a_regular_file(kernel: Kernel, kind: str, tmp_path: Path) -> None:
    rules, end = kernel.root / CLAIM_RULES_PATH, tmp_path / "end"
    rules.parent.mkdir(parents=True, exist_ok=True)
    special(end, kind)
    rules.symlink_to(end)
    with untouched(tmp_path):
        assert refusal(kernel, "claim") == refused(f"/{CLAIM_RULES_PATH}", kind)
    assert kernel.log == []
