"""`hapticd doctor` against trees as the kernel's documentation describes the files: admin-guide/sysctl/kernel,
admin-guide/cgroup-v1/rt, admin-guide/pm/{cpufreq,cpuidle}, ABI/testing/sysfs-devices-system-cpu, driver-api/input."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import pytest

from hapticd.base.errors import HapticdError
from hapticd.cli import main
from hapticd.config.hid import Hid
from hapticd.doctor import ALL_CHECKS, devices, diagnose, realtime, service
from hapticd.doctor.machine import Finding, Machine, Needs, parse_cpu_list, socket_holder
from hapticd.hid.discovery import find
from hapticd.protocol.calls import DaemonNotRunning
from tests.support.hid_descriptors import Joystick

Check = Callable[[Machine, Needs], Iterator[Finding]]
CPU = "sys/devices/system/cpu"
NO_CAPABILITIES = "Name:\thapticd\nCapEff:\t0000000000000000\nCpus_allowed_list:\t0-3\n"


def put(root: Path, files: Mapping[str, str]) -> None:
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)


def reported(
    root: Path, check: Check, files: Mapping[str, str] | None = None, needs: Needs | None = None, **how: Any
) -> str:
    """Return verdict and text of each finding of one check, over a tree of files."""
    put(root, files or {})
    found = list(check(Machine(root, **how), needs or Needs()))
    assert found, check
    for finding in found:
        assert "\n" not in str(finding)
        assert finding.todo or finding.verdict == "ok" or finding.what.startswith("not known")
    return " | ".join(f"{finding.verdict} {finding.what} -> {finding.todo}" for finding in found)


def nothing(resource_number: int) -> tuple[int, int]:
    return 0, 0


# ---- Nothing there ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "check",
    [
        realtime.preemption,
        realtime.throttling,
        realtime.group_budget,
        realtime.clock,
        realtime.governor,
        realtime.idle_states,
        service.unit,
    ],
)
def test_missing_files_are_not_known_and_never_well(tmp_path: Path, check: Check) -> None:
    assert reported(tmp_path, check).startswith("warn not known: ")


def test_a_processor_that_is_asked_for_is_not_known_without_files(tmp_path: Path) -> None:
    assert reported(tmp_path, realtime.isolation, needs=Needs(cpu=2)).startswith("warn not known: ")


def test_every_check_stands_an_empty_machine(tmp_path: Path) -> None:
    for needs in (Needs(), Needs("required", 90, 3, Hid())):
        found = list(diagnose(Machine(tmp_path, limit=nothing), needs))
        assert len(found) >= len(ALL_CHECKS) - 1  # without a joystick there is no line for competitors


def test_files_that_hold_nonsense(tmp_path: Path) -> None:
    junk = "\0\xff(((:::,,--\n"
    names = ["proc/version", "proc/cmdline", "proc/self/status", "sys/kernel/debug/sched/preempt"]
    names += ["proc/sys/kernel/sched_rt_runtime_us", "proc/sys/kernel/sched_rt_period_us", "proc/config.gz"]
    names += [f"{CPU}/online", f"{CPU}/isolated", f"{CPU}/cpu0/cpuidle/state0/latency", "proc/123/cmdline"]
    put(tmp_path, dict.fromkeys(names, junk))
    for needs in (Needs(), Needs("required", 90, 3, Hid())):
        assert list(diagnose(Machine(tmp_path, limit=nothing), needs))


def test_a_pipe_in_the_place_of_a_file_does_not_keep_it_waiting(tmp_path: Path) -> None:
    (tmp_path / "proc").mkdir()
    os.mkfifo(tmp_path / "proc" / "version")
    assert reported(tmp_path, realtime.preemption).startswith("warn not known: ")


# ---- Kernel ----------------------------------------------------------------------------------------------------------

VERSION = (
    "Linux version 6.1.0-20-amd64 (debian-kernel@lists.debian.org) (gcc-12) #1 SMP {} Debian 6.1.85-1 (2024-04-11)\n"
)
BUILT = "# CONFIG_PREEMPT_NONE is not set\nCONFIG_PREEMPT_VOLUNTARY=y\nCONFIG_PREEMPT_DYNAMIC=y\n"


@pytest.mark.parametrize(
    ("files", "verdict", "words"),
    [
        ({"sys/kernel/realtime": "1\n"}, "ok", "PREEMPT_RT"),
        ({"proc/version": VERSION.format("PREEMPT_RT")}, "ok", "PREEMPT_RT"),
        ({"proc/version": VERSION.format("PREEMPT")}, "ok", "preemption: full"),
        ({"sys/kernel/debug/sched/preempt": "none voluntary (full)\n"}, "ok", "preemption: full"),
        ({"sys/kernel/debug/sched/preempt": "full (lazy)\n"}, "ok", "preemption: lazy"),
        ({"sys/kernel/debug/sched/preempt": "none (voluntary) full\n"}, "warn", "voluntary"),
        ({"proc/version": VERSION.format("PREEMPT_DYNAMIC"), "proc/cmdline": "ro preempt=full quiet\n"}, "ok", "full"),
        ({"proc/version": VERSION.format("PREEMPT_DYNAMIC"), "proc/cmdline": "preempt=none\n"}, "warn", "none"),
        (
            {
                "proc/version": VERSION.format("PREEMPT_DYNAMIC"),
                "proc/cmdline": "quiet\n",
                "proc/sys/kernel/osrelease": "6.1.0-20-amd64\n",
                "boot/config-6.1.0-20-amd64": BUILT,
            },
            "warn",
            "voluntary",
        ),
        ({"proc/version": VERSION.format("PREEMPT_DYNAMIC"), "proc/cmdline": "quiet\n"}, "warn", "not known"),
        ({"proc/version": "Linux version 6.1.0 #1 SMP Debian\n"}, "warn", "voluntary or none"),
    ],
)
def test_preemption(tmp_path: Path, files: dict[str, str], verdict: str, words: str) -> None:
    text = reported(tmp_path, realtime.preemption, files)
    assert text.startswith(verdict)
    assert words in text


@pytest.mark.parametrize(
    ("runtime", "period", "verdict"),
    [("-1", "1000000", "ok"), ("950000", "1000000", "ok"), ("100000", "1000000", "warn"), ("0", "1000000", "warn")],
)
def test_throttling(tmp_path: Path, runtime: str, period: str, verdict: str) -> None:
    files = {f"proc/sys/kernel/sched_rt_{name}_us": text for name, text in (("runtime", runtime), ("period", period))}
    assert reported(tmp_path, realtime.throttling, files).startswith(verdict)


@pytest.mark.parametrize(
    ("files", "verdict"),
    [
        ({}, "warn not known"),
        ({"lib/modules/6.1/config": "# CONFIG_RT_GROUP_SCHED is not set\n"}, "ok"),
        ({"lib/modules/6.1/config": "CONFIG_RT_GROUP_SCHED=y\n"}, "warn the kernel refuses SCHED_FIFO"),
        (
            {
                "lib/modules/6.1/config": "CONFIG_RT_GROUP_SCHED=y\n",
                "proc/cmdline": "ro rt_group_sched=0\n",
            },
            "ok",
        ),
    ],
)
def test_budget_of_the_control_group(tmp_path: Path, files: dict[str, str], verdict: str) -> None:
    assert reported(tmp_path, realtime.group_budget, {"proc/sys/kernel/osrelease": "6.1\n", **files}).startswith(
        verdict
    )


@pytest.mark.parametrize(("required", "verdict"), [("required", "fail"), ("preferred", "warn"), ("off", "ok")])
@pytest.mark.parametrize("check", [realtime.throttling, realtime.group_budget])
def test_the_verdict_without_time_for_real_time_tasks_follows_the_configuration(
    tmp_path: Path, check: Check, required: Literal["required", "preferred", "off"], verdict: str
) -> None:
    files = {
        "proc/sys/kernel/sched_rt_runtime_us": "0",
        "proc/sys/kernel/sched_rt_period_us": "1000000",
        "proc/sys/kernel/osrelease": "6.1\n",
        "lib/modules/6.1/config": "CONFIG_RT_GROUP_SCHED=y\n",
    }
    assert reported(tmp_path, check, files, needs=Needs(required)).startswith(verdict)


@pytest.mark.parametrize(
    ("name", "verdict"), [("tsc", "ok"), ("arch_sys_counter", "ok"), ("hpet", "warn"), ("acpi_pm", "warn")]
)
def test_clock(tmp_path: Path, name: str, verdict: str) -> None:
    files = {"sys/devices/system/clocksource/clocksource0/current_clocksource": name + "\n"}
    assert reported(tmp_path, realtime.clock, files).startswith(verdict)


# ---- Rights ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("required", "limit", "capabilities", "verdict"),
    [
        ("preferred", 0, "0000000000000000", "warn"),
        ("required", 0, "0000000000000000", "fail"),
        ("off", 0, "0000000000000000", "ok"),
        ("required", 79, "0000000000000000", "fail"),
        ("required", 80, "0000000000000000", "ok"),
        ("required", resource.RLIM_INFINITY, "0000000000000000", "ok"),
        ("required", 0, "0000000000800000", "ok"),  # CAP_SYS_NICE is 23
        ("required", 0, "0000000000400000", "fail"),
    ],
)
def test_real_time_rights(tmp_path: Path, required: Any, limit: int, capabilities: str, verdict: str) -> None:
    files = {"proc/self/status": f"Name:\tx\nCapEff:\t{capabilities}\n"}
    text = reported(tmp_path, realtime.priority, files, Needs(required, 80), limit=lambda number: (limit, limit))
    assert text.startswith(verdict)


@pytest.mark.parametrize(
    ("limit", "capabilities", "verdict"),
    [
        (8 << 20, "0000000000000000", "fail"),
        (1 << 30, "0000000000000000", "ok"),
        (resource.RLIM_INFINITY, "0000000000000000", "ok"),
        (0, "0000000000004000", "ok"),  # CAP_IPC_LOCK is 14
    ],
)
def test_locked_memory(tmp_path: Path, limit: int, capabilities: str, verdict: str) -> None:
    files = {"proc/self/status": f"CapEff:\t{capabilities}\n"}
    text = reported(tmp_path, realtime.memory, files, Needs("required"), limit=lambda number: (limit, limit))
    assert text.startswith(verdict)


# ---- Processors ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("text", "wanted"), [("0-3,6", {0, 1, 2, 3, 6}), ("", set()), ("5", {5}), ("(null)", set())])
def test_lists_of_processors(text: str, wanted: set[int]) -> None:
    assert parse_cpu_list(text) == wanted


@pytest.mark.parametrize(
    ("cpu", "files", "verdict"),
    [
        (None, {f"{CPU}/isolated": "\n"}, "ok"),
        (None, {f"{CPU}/isolated": "2-3\n"}, "warn processors 2-3"),
        (3, {f"{CPU}/online": "0-3\n", f"{CPU}/isolated": "3\n", f"{CPU}/nohz_full": "3\n"}, "ok"),
        (2, {f"{CPU}/online": "0-3\n", f"{CPU}/isolated": "3\n"}, "warn"),
        (7, {f"{CPU}/online": "0-3\n"}, "fail processor 7"),
        (5, {f"{CPU}/online": "0-7\n"}, "fail processor 5 (servo.cpu) is not allowed here; allowed are 0-3"),
    ],
)
def test_isolation(tmp_path: Path, cpu: int | None, files: dict[str, str], verdict: str) -> None:
    files = {"proc/self/status": NO_CAPABILITIES, **files}
    assert reported(tmp_path, realtime.isolation, files, Needs(cpu=cpu)).startswith(verdict)


def test_governor(tmp_path: Path) -> None:
    files = {f"{CPU}/cpu{n}/cpufreq/scaling_governor": "performance\n" for n in range(4)}
    assert reported(tmp_path, realtime.governor, files) == "ok performance -> "
    files[f"{CPU}/cpu1/cpufreq/scaling_governor"] = "powersave\n"
    assert reported(tmp_path, realtime.governor, files).startswith("warn powersave on 1 of 4 processors")
    assert reported(tmp_path, realtime.governor, files, Needs(cpu=1)).startswith("warn powersave on 1 of 1 processor")
    assert reported(tmp_path, realtime.governor, files, Needs(cpu=2)).startswith("ok")


def test_idle_states_that_cannot_be_held_off(tmp_path: Path) -> None:
    states = {"state0": "0", "state1": "2", "state2": "133"}
    put(tmp_path, {f"{CPU}/cpu0/cpuidle/{name}/latency": f"{latency}\n" for name, latency in states.items()})
    put(tmp_path, {"dev/cpu_dma_latency": ""})
    node = tmp_path / "dev" / "cpu_dma_latency"
    refused: dict[str, Any] = {"may_write": lambda path: False}
    node.chmod(0o400)
    assert reported(tmp_path, realtime.idle_states, **refused).startswith("warn")
    assert reported(tmp_path, realtime.idle_states, needs=Needs("required"), **refused).startswith("fail")
    node.chmod(0o460)
    assert reported(tmp_path, realtime.idle_states, group=lambda gid: "hapticd", **refused).startswith(
        "ok the service can"
    )
    assert reported(tmp_path, realtime.idle_states, group=lambda gid: "users", **refused).startswith("warn")
    put(tmp_path, {f"{CPU}/cpu0/cpuidle/state2/disable": "1\n"})
    assert reported(tmp_path, realtime.idle_states, group=lambda gid: "users", **refused).startswith("ok no deep")


def test_idle_states_that_can_be_held_off(tmp_path: Path) -> None:
    put(tmp_path, {"dev/cpu_dma_latency": "", f"{CPU}/cpu0/cpuidle/state1/latency": "200\n"})
    assert reported(tmp_path, realtime.idle_states).startswith("ok deep idle states can be held off (up to 200 us")


# ---- Joysticks -------------------------------------------------------------------------------------------------------


def joystick(root: Path, number: int = 0, effects: str = "1 0\n") -> Path:
    """Create a PID joystick in sysfs, with an event node, and return its hidraw node."""
    device = root / "sys" / "class" / "hidraw" / f"hidraw{number}" / "device"
    put(
        device,
        {
            "uevent": "DRIVER=hid-generic\nHID_ID=0003:0000045E:0000001B\nHID_NAME=Stick\nHID_PHYS=usb-1\nHID_UNIQ=7\n",
            "input/input9/capabilities/ff": effects,
        },
    )
    (device / "report_descriptor").write_bytes(bytes(Joystick()))
    for name in ("event5", "js0"):
        (device / "input" / "input9" / name).mkdir()
    node = root / "dev" / f"hidraw{number}"
    put(root, {f"dev/hidraw{number}": "", "dev/input/event5": "", "dev/input/js0": ""})
    for name in ("event5", "js0"):
        (root / "dev" / "input" / name).chmod(0o600)
    return node


def process(root: Path, pid: int, name: str, *open_files: str) -> None:
    put(root, {f"proc/{pid}/comm": name + "\n", f"proc/{pid}/cmdline": f"/usr/bin/{name}\0run\0"})
    (root / "proc" / str(pid) / "fd").mkdir()
    for number, target in enumerate(open_files):
        (root / "proc" / str(pid) / "fd" / str(number)).symlink_to(target)


def test_no_joystick(tmp_path: Path) -> None:
    assert reported(tmp_path, devices.permissions).startswith("ok no force-feedback joystick")
    assert reported(tmp_path, devices.permissions, needs=Needs(device=Hid())).startswith(
        "warn no force-feedback joystick"
    )
    assert reported(tmp_path, devices.rule).startswith("ok")
    assert reported(tmp_path, devices.rule, needs=Needs(device=Hid())).startswith("warn")
    assert list(devices.competitors(Machine(tmp_path), Needs())) == []


def test_a_joystick_that_may_be_driven(tmp_path: Path) -> None:
    joystick(tmp_path)
    process(tmp_path, 77, "bash", "/dev/pts/0")
    assert reported(tmp_path, devices.permissions) == "ok this user may drive Stick at /dev/hidraw0 -> "
    assert reported(tmp_path, devices.rule).startswith("warn 70-hapticd.rules is not installed")
    put(tmp_path, {"etc/udev/rules.d/70-hapticd.rules": ""})
    assert reported(tmp_path, devices.rule) == "ok /etc/udev/rules.d/70-hapticd.rules -> "
    assert reported(tmp_path, devices.competitors) == "ok no other program uses /dev/hidraw0 -> "


def test_a_joystick_that_the_configuration_describes(tmp_path: Path) -> None:
    joystick(tmp_path)
    descriptor = tmp_path / "sys/class/hidraw/hidraw0/device/report_descriptor"
    # One axis and two output bytes: no forces, unless the configuration describes them.
    descriptor.write_bytes(bytes.fromhex("05010904a10109301500 26ff0075089502 8102 0600ff0901 9102c0"))
    assert reported(tmp_path, devices.permissions).startswith("ok no force-feedback joystick of the PID class")
    report = {
        "input": {name: {"bit_offset": at, "bit_size": 8, "counts_per_m": 1000} for name, at in (("x", 0), ("y", 8))},
        "output": {
            "length": 2,
            **{name: {"bit_offset": at, "bit_size": 8, "counts_per_n": 10} for name, at in (("x", 0), ("y", 8))},
        },
    }
    mine = Needs(device=Hid.model_validate({"vendor": 0x45E, "product": 0x1B, "report": report}))
    other = Needs(device=Hid.model_validate({"vendor": 0x45E, "product": 0x1C, "report": report}))
    assert reported(tmp_path, devices.permissions, needs=mine) == "ok this user may drive Stick at /dev/hidraw0 -> "
    assert reported(tmp_path, devices.competitors, needs=mine) == "ok no other program uses /dev/hidraw0 -> "
    missing = "warn no force-feedback joystick that the configuration describes is connected; there are 1 other"
    assert reported(tmp_path, devices.permissions, needs=other).startswith(missing)
    # A description that does not fit is reported as by `hapticd run`.
    report["output"]["length"] = 3
    wrong = Needs(device=Hid.model_validate({"vendor": 0x45E, "product": 0x1B, "report": report}))
    lines = [str(one) for one in devices.permissions(Machine(tmp_path), wrong)]
    assert lines[0].startswith("warn  joystick     no force-feedback joystick that the configuration describes")
    assert "Stick at /dev/hidraw0 cannot be driven: device.hid.report.output.length: output report 0" in lines[1]


def test_a_joystick_that_run_would_refuse(tmp_path: Path) -> None:
    joystick(tmp_path)
    descriptor = tmp_path / "sys/class/hidraw/hidraw0/device/report_descriptor"
    descriptor.write_bytes(bytes(Joystick(force_axes=(), direction_bits=0)))
    for needs, verdict in (
        (Needs(), "warn"),
        (Needs(device=Hid()), "warn"),
        (Needs(device=Hid(product=0x1B)), "fail"),
    ):
        _, second = devices.permissions(Machine(tmp_path), needs)
        assert second.verdict == verdict
        assert second.what.startswith("Stick at /dev/hidraw0 cannot be driven: the device has two axes, and neither")


def test_a_joystick_without_permission(tmp_path: Path) -> None:
    node = joystick(tmp_path)
    node.chmod(0o460)
    how: dict[str, Any] = {"find": lambda *where: [replace(one, permission="denied") for one in find(*where)]}
    assert reported(tmp_path, devices.permissions, **how).startswith("warn")
    assert reported(tmp_path, devices.permissions, needs=Needs(device=Hid()), **how).startswith("fail")
    put(tmp_path, {"etc/systemd/system/hapticd.service": ""})
    how["group"] = lambda gid: "input"
    assert reported(tmp_path, devices.permissions, **how).startswith("ok the service may drive Stick at /dev/hidraw0")
    how["group"] = lambda gid: "video"
    assert reported(tmp_path, devices.permissions, **how).startswith("warn")


def test_competing_programs(tmp_path: Path) -> None:
    joystick(tmp_path)
    process(tmp_path, 77, "hapticd", "/dev/hidraw0")
    assert reported(tmp_path, devices.competitors).startswith("ok no other program")
    process(tmp_path, 88, "game", "/dev/null", "/dev/input/event5")
    process(tmp_path, 99, "other", "/dev/hidraw1")
    text = reported(tmp_path, devices.competitors)
    assert text.startswith("warn /dev/hidraw0 or its event nodes are open in game (88)")
    assert "other" not in text


def test_the_kernels_own_effects_are_reported_where_others_may_use_them(tmp_path: Path) -> None:
    joystick(tmp_path)
    (tmp_path / "dev" / "input" / "event5").chmod(0o660)
    assert "at /dev/input/event5" in reported(tmp_path, devices.competitors)
    put(tmp_path, {"sys/class/hidraw/hidraw0/device/input/input9/capabilities/ff": "0\n"})
    assert reported(tmp_path, devices.competitors).startswith("ok no other program")


def test_a_device_whose_resets_nobody_sees(tmp_path: Path) -> None:
    joystick(tmp_path)
    (tmp_path / "sys/class/hidraw/hidraw0/device/report_descriptor").write_bytes(
        bytes(Joystick(without=frozenset({0x92})))
    )
    condition = "/dev/hidraw0 does not report which of its effects play: a reset by another program is not noticed"
    assert reported(tmp_path, devices.competitors).endswith(f"ok {condition} -> ")
    (tmp_path / "dev" / "input" / "event5").chmod(0o660)
    action = "`hapticd devices claim /dev/hidraw0` keeps other programs off"
    assert reported(tmp_path, devices.competitors).endswith(f"warn {condition} -> {action}")


# ---- Service and daemon ----------------------------------------------------------------------------------------------


def systemctl(**properties: str) -> Callable[[Sequence[str]], str]:
    shown = {"LoadState": "loaded", "ActiveState": "active", "SubState": "running", "UnitFileState": "enabled"}
    shown |= {"NRestarts": "0", "Result": "success", **properties}
    return lambda words: "".join(f"{name}={value}\n" for name, value in shown.items())


@pytest.mark.parametrize(
    ("properties", "wanted"),
    [
        ({}, "ok hapticd.service is active, enabled -> "),
        ({"NRestarts": "3"}, "warn hapticd.service is active, enabled, after 3 restarts -> journalctl"),
        ({"LoadState": "not-found", "ActiveState": "inactive"}, "warn hapticd.service: not-found -> hapticd install"),
        ({"ActiveState": "failed", "Result": "watchdog"}, "fail hapticd.service: failed, watchdog -> journalctl"),
        ({"ActiveState": "activating", "NRestarts": "9", "Result": "exit-code"}, "fail hapticd.service: activating"),
        ({"ActiveState": "inactive", "UnitFileState": "disabled"}, "warn hapticd.service is inactive, disabled -> sys"),
    ],
)
def test_the_unit(tmp_path: Path, properties: dict[str, str], wanted: str) -> None:
    (tmp_path / "run" / "systemd" / "system").mkdir(parents=True)
    assert reported(tmp_path, service.unit, run=systemctl(**properties)).startswith(wanted)
    assert reported(tmp_path, service.unit, run=lambda words: None).startswith("warn not known")


def test_the_daemon(tmp_path: Path) -> None:
    status = {"version": "1.2", "faults": [], "realtime": {"missing": []}}
    assert reported(tmp_path, service.daemon).startswith("warn no daemon answers")
    assert reported(tmp_path, service.daemon, daemon=lambda: status, version="1.2") == "ok hapticd 1.2 answers -> "
    assert reported(tmp_path, service.daemon, daemon=lambda: status, version="1.3").startswith(
        "warn hapticd 1.2 runs, but 1.3"
    )
    status |= {"faults": ["device"], "realtime": {"missing": ["SCHED_FIFO priority 80: not permitted"]}}
    text = reported(tmp_path, service.daemon, daemon=lambda: status, version="1.2")
    assert "warn the daemon was not granted: SCHED_FIFO priority 80" in text
    assert text.endswith("warn a fault holds the forces off: device -> hapticd force on")
    status["connection"] = {"problem": "stick.jsonl: the recording is over", "resets_seen": None}
    text = reported(tmp_path, service.daemon, daemon=lambda: status, version="1.2")
    assert text.endswith("forces off: device -> the device is lost: stick.jsonl: the recording is over")
    status["connection"] = {"path": "/dev/hidraw3", "resets_seen": False, "foreign_effect_s": 0.0957}
    text = reported(tmp_path, service.daemon, daemon=lambda: status, version="1.2")
    assert (
        "is not noticed; an effect that it uploads lasts up to 96 ms -> `hapticd devices claim /dev/hidraw3` keeps"
        in text
    )

    def silent() -> None:
        raise HapticdError("the daemon did not answer within 2 s")

    assert reported(tmp_path, service.daemon, daemon=silent).startswith("fail the daemon did not answer")


# ---- The command -----------------------------------------------------------------------------------------------------


def test_the_command_on_this_machine(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    code = main(["doctor", "--json"])
    assert list(tmp_path.rglob("*")) == [], "it changes nothing"
    captured = capsys.readouterr()
    found = json.loads(captured.out)
    failed = [item for item in found if item["verdict"] == "fail"]
    assert code == (1 if failed else 0)
    assert captured.err.startswith("hapticd: not ready: ") == bool(failed)
    assert {item["name"] for item in found} >= {"kernel", "clock", "rtprio", "memlock", "daemon"}
    assert [item["what"] for item in found if item["name"] == "daemon"] == ["no daemon answers"]
    assert main(["doctor"]) == code
    assert len(capsys.readouterr().out.splitlines()) == len(found)


def test_a_fault_of_the_machine_is_exit_code_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    config = tmp_path / "c.yaml"
    config.write_text("servo: {cpu: 1023}\n")
    assert main(["doctor", "-c", str(config)]) == 1
    captured = capsys.readouterr()
    assert "\nfail  processor    processor 1023" in captured.out
    assert captured.err == "hapticd: not ready: processor\n"
    assert captured.out.startswith(f"ok    config       {config}\n")
    config.write_text("servo: {cpu: -1}\n")
    assert main(["doctor", "-c", str(config)]) == 1
    captured = capsys.readouterr()
    assert captured.out.startswith(
        f"fail  config       {config}:1:9: servo.cpu: should be greater than or equal to 0, is -1; the lines below"
    )
    assert "\nok    clock " in captured.out or "\nwarn  clock " in captured.out
    assert captured.err.startswith("hapticd: not ready: config")


# A process that listens as a daemon does and never answers.
LISTENS = """
import socket, sys
with socket.socket(socket.AF_UNIX) as own:
    own.bind(sys.argv[1])
    own.listen()
    print("listens", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def silent(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """Listen on the command socket in `tmp_path`, and never answer."""
    words = [sys.executable, "-c", LISTENS, str(tmp_path / "hapticd.command")]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stdout.readline() == "listens\n"
        yield process
        process.kill()


def of_the_daemon(directory: Path, capsys: pytest.CaptureFixture[str]) -> str:
    assert main(["--runtime-dir", str(directory), "doctor"]) == 1
    captured = capsys.readouterr()
    assert "daemon" in captured.err
    return next(line for line in captured.out.splitlines() if line.startswith("fail  daemon "))


def test_a_stopped_daemon_is_known_without_being_asked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], silent: subprocess.Popen[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def asked(*_: object) -> None:
        raise AssertionError("it waits for an answer")

    os.kill(silent.pid, signal.SIGSTOP)
    assert os.WIFSTOPPED(os.waitpid(silent.pid, os.WUNTRACED)[1])
    assert socket_holder(tmp_path / "hapticd.command") == (silent.pid, True)
    monkeypatch.setattr("hapticd.client.blocking.connect", asked)
    line = of_the_daemon(tmp_path, capsys)
    assert f"process {silent.pid}, which holds {tmp_path}, is stopped and does not answer; kill -CONT" in line


def test_a_daemon_that_runs_and_does_not_answer_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], silent: subprocess.Popen[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hapticd.cli.machine._STATUS_TIMEOUT_S", 0.1)
    line = of_the_daemon(tmp_path, capsys)
    assert f"process {silent.pid}, which holds {tmp_path}, did not answer within 0.1 s" in line


def test_a_socket_without_a_listener_has_no_holder(tmp_path: Path) -> None:
    assert socket_holder(tmp_path / "hapticd.command") is None
    (tmp_path / "hapticd.command").touch()
    assert socket_holder(tmp_path / "hapticd.command") is None


def test_whose_daemon_is_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[str] = []

    def connect(place: object, timeout_s: float) -> None:
        asked.append(str(place))
        raise DaemonNotRunning("nobody")

    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr("hapticd.system.paths.SYSTEM_DIRECTORY", tmp_path / "service")
    monkeypatch.setattr("hapticd.client.blocking.connect", connect)
    main(["doctor"])
    assert asked == [str(tmp_path / "hapticd"), str(tmp_path / "service")]
    asked.clear()
    main(["--runtime-dir", str(tmp_path / "named"), "doctor"])
    assert asked == [str(tmp_path / "named")]
