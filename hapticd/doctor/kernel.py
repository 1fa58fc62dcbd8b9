"""The kernel: how it is preempted, what it leaves to real-time tasks, and its clock."""

from __future__ import annotations

import gzip
import re
from collections.abc import Iterator
from typing import Final

from hapticd.base import wording
from hapticd.doctor.machine import Finding, Machine, Needs, unknown

_GOOD_CLOCKS: Final = (
    "tsc",
    "kvm-clock",
    "hyperv_clocksource_tsc_page",
    "arch_sys_counter",
    "timebase",
    "riscv_clocksource",
)
_LEAST_SHARE: Final = 0.5


def config(machine: Machine) -> str | None:
    """The configuration that the kernel was built with; None where it cannot be read."""
    release = machine.text("/proc/sys/kernel/osrelease") or ""
    found = machine.text(f"/boot/config-{release}") or machine.text(f"/lib/modules/{release}/config")
    if found is None:
        try:
            with gzip.open(machine.path("/proc/config.gz"), "rt", encoding="utf-8") as file:
                found = file.read(1 << 20)
        except (OSError, EOFError):
            return None
    return found


def preemption(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """PREEMPT_RT, or how the kernel is preempted otherwise."""
    version = machine.text("/proc/version")
    release = machine.text("/proc/sys/kernel/osrelease") or "this kernel"
    if machine.text("/sys/kernel/realtime") == "1" or re.search(r"\bPREEMPT_RT\b", version or ""):
        yield Finding("kernel", "ok", f"{release}, PREEMPT_RT")
        return
    model = _model(machine, version)
    if model is None:
        yield unknown(
            "kernel", f"/proc/version and /sys/kernel/debug/sched/preempt do not say how {release} is preempted"
        )
    elif model in ("full", "lazy"):
        yield Finding("kernel", "ok", f"{release}, preemption: {model} (PREEMPT_RT has a lower worst case)")
    else:
        yield Finding(
            "kernel",
            "warn",
            f"{release}, preemption: {model}; a long system call of anybody makes ticks late",
            "boot with preempt=full, or a PREEMPT_RT kernel (Debian: linux-image-rt-amd64)",
        )


def _model(machine: Machine, version: str | None) -> str | None:
    """none, voluntary, lazy or full."""
    # "none voluntary (full)": the one in force stands in brackets.
    match = re.search(r"\((\w+)\)", machine.text("/sys/kernel/debug/sched/preempt") or "")
    if match:
        return match[1]
    if not version:
        return None
    if re.search(r"\bPREEMPT\b(?!_)", version):
        return "full"
    if "PREEMPT_DYNAMIC" not in version:
        return "voluntary or none"
    match = re.search(r"(?:^|\s)preempt=(\w+)", machine.text("/proc/cmdline") or "")
    if match:
        return match[1]
    built = config(machine)
    if built is None:
        return None
    names = (("CONFIG_PREEMPT", "full"), ("CONFIG_PREEMPT_LAZY", "lazy"), ("CONFIG_PREEMPT_VOLUNTARY", "voluntary"))
    for name, model in (*names, ("CONFIG_PREEMPT_NONE", "none")):
        if re.search(rf"^{name}=y$", built, re.MULTILINE):
            return model
    return None


def throttling(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """How much of the time real-time tasks may have."""
    texts = [machine.text(f"/proc/sys/kernel/sched_rt_{name}_us") for name in ("runtime", "period")]
    try:
        runtime, period = (int(text) for text in texts if text is not None)
    except ValueError:
        yield unknown("throttling", "/proc/sys/kernel/sched_rt_runtime_us cannot be read")
        return
    if runtime < 0:
        yield Finding("throttling", "ok", "real-time tasks are not throttled")
    elif runtime >= _LEAST_SHARE * period > 0:
        yield Finding("throttling", "ok", f"real-time tasks may have {100 * runtime / period:.3g} % of the time")
    else:
        yield Finding(
            "throttling",
            needs.without() if runtime == 0 else "warn",
            f"real-time tasks may have {wording.si(1e-6 * runtime, 's')} of {wording.si(1e-6 * period, 's')}",
            "sysctl kernel.sched_rt_runtime_us=950000",
        )


def group_budget(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Whether the control group leaves room for SCHED_FIFO."""
    groups = machine.text("/proc/self/cgroup")
    if groups is None:
        yield unknown("cgroup", "/proc/self/cgroup cannot be read")
        return
    for line in groups.splitlines():
        _, _, rest = line.partition(":")
        controllers, _, path = rest.partition(":")
        if "cpu" in controllers.split(","):
            for mount in ("cpu", controllers, "cpu,cpuacct"):
                budget = machine.text(f"/sys/fs/cgroup/{mount}/{path.lstrip('/')}/cpu.rt_runtime_us")
                if budget is not None and budget.lstrip("-").isdecimal():
                    yield _budget(path, int(budget), needs)
                    return
    built = config(machine)
    if built is None:
        yield unknown("cgroup", "the kernel's configuration cannot be read, so whether groups have real-time budgets")
    elif not re.search(r"^CONFIG_RT_GROUP_SCHED=y$", built, re.MULTILINE):
        yield Finding("cgroup", "ok", "control groups do not limit real time")
    elif re.search(r"(?:^|\s)rt_group_sched=(?:0|n|off)\b", machine.text("/proc/cmdline") or ""):
        yield Finding("cgroup", "ok", "control groups do not limit real time (rt_group_sched=0)")
    else:
        yield Finding(
            "cgroup",
            needs.without(),
            "the kernel has real-time budgets for control groups (CONFIG_RT_GROUP_SCHED); this group's is not told",
            "boot with rt_group_sched=0 (Linux 6.16), or a kernel without it",
        )


def _budget(path: str, runtime_us: int, needs: Needs) -> Finding:
    if runtime_us != 0:
        return Finding("cgroup", "ok", f"{path} has a real-time budget of {wording.si(1e-6 * runtime_us, 's')}")
    return Finding(
        "cgroup",
        needs.without(),
        f"{path} has no real-time budget: SCHED_FIFO is refused in it",
        f"write a budget into cpu.rt_runtime_us of {path} and the groups above it",
    )


def clock(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """The clock source: some take microseconds to read."""
    name = machine.text("/sys/devices/system/clocksource/clocksource0/current_clocksource")
    if not name:
        yield unknown("clock", "/sys/devices/system/clocksource cannot be read")
    elif name in _GOOD_CLOCKS:
        yield Finding("clock", "ok", f"clock source {name}")
    else:
        yield Finding(
            "clock",
            "warn",
            f"clock source {name}, which is slow to read or coarse",
            "see in dmesg why the kernel left tsc; a firmware update often helps",
        )
