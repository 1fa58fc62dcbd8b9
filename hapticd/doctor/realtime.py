"""Checks of what real-time scheduling needs: kernel, clock, limits and capabilities, processors."""

from __future__ import annotations

import gzip
import os
import re
import resource
from collections.abc import Iterator
from typing import Final

from hapticd.base import wording
from hapticd.doctor.machine import Finding, Machine, Needs, fail, ok, parse_cpu_list, unknown, warn

_CPU_FOLDER: Final = "/sys/devices/system/cpu"
"""The processors in sysfs: frequency governors, idle states, and which are online or isolated."""

_FAST_CLOCK_SOURCES: Final = (
    "tsc",
    "kvm-clock",
    "hyperv_clocksource_tsc_page",
    "arch_sys_counter",
    "timebase",
    "riscv_clocksource",
)
"""Clock sources of the kernel that take only nanoseconds to read, without a trap or an I/O port."""

_MIN_REALTIME_SHARE: Final = 0.5
"""A warning is given if the kernel grants real-time tasks less than this fraction of the time."""
_CAP_IPC_LOCK: Final = 14
_CAP_SYS_NICE: Final = 23
"""Numbers of the capabilities in linux/capability.h."""

_MIN_LOCKABLE_BYTES: Final = 256 << 20
"""Memory that a user must be allowed to lock: more than a daemon with a large scene needs."""

_LIMITS_HINT: Final = (
    "/etc/security/limits.d/hapticd.conf, and log in again; or run the service (`hapticd install-service`)"
)

_MAX_IDLE_EXIT_US: Final = 50
"""An idle state with a longer exit latency counts as deep: half of the 100 us of a period at 10 kHz."""


# ---- The kernel ------------------------------------------------------------------------------------------------------


def preemption(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Check the kernel's preemption model: PREEMPT_RT, full, lazy, voluntary or none."""
    version = machine.text("/proc/version") or ""
    release = machine.text("/proc/sys/kernel/osrelease") or "this kernel"
    if machine.text("/sys/kernel/realtime") == "1" or re.search(r"\bPREEMPT_RT\b", version):
        yield ok("kernel", f"{release}, PREEMPT_RT")
        return
    model = _preemption_model(machine, version)
    if model is None:
        files = "/proc/version and /sys/kernel/debug/sched/preempt"
        yield unknown("kernel", f"{files} do not say how {release} is preempted")
    elif model in ("full", "lazy"):
        yield ok("kernel", f"{release}, preemption: {model} (PREEMPT_RT has a lower worst case)")
    else:
        what = f"{release}, preemption: {model}; a long system call of any program delays ticks"
        yield warn("kernel", what, "boot with preempt=full, or a PREEMPT_RT kernel (Debian: linux-image-rt-amd64)")


def _preemption_model(machine: Machine, version: str) -> str | None:
    """Return the preemption model: "none", "voluntary", "lazy", "full", "voluntary or none"; None if not known."""
    # "none voluntary (full)": the active model is in parentheses.
    match = re.search(r"\((\w+)\)", machine.text("/sys/kernel/debug/sched/preempt") or "")
    if match or not version:
        return match[1] if match else None
    if re.search(r"\bPREEMPT\b(?!_)", version):
        return "full"
    if "PREEMPT_DYNAMIC" not in version:
        return "voluntary or none"
    match = re.search(r"(?:^|\s)preempt=(\w+)", machine.text("/proc/cmdline") or "")
    match = match or re.search(
        r"^CONFIG_PREEMPT(?:_(LAZY|VOLUNTARY|NONE))?=y$", _kernel_config(machine) or "", re.MULTILINE
    )
    return (match[1] or "full").lower() if match else None


def _kernel_config(machine: Machine) -> str | None:
    """Return the build configuration of the kernel (CONFIG_...); None if it cannot be read."""
    release = machine.text("/proc/sys/kernel/osrelease") or ""
    found = machine.text(f"/boot/config-{release}") or machine.text(f"/lib/modules/{release}/config")
    if found is None:
        try:
            with gzip.open(machine.path("/proc/config.gz"), "rt", encoding="utf-8") as file:
                found = file.read(1 << 20)
        except (OSError, EOFError):
            return None
    return found


def throttling(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Check which fraction of the time the kernel grants to real-time tasks."""
    texts = [machine.text(f"/proc/sys/kernel/sched_rt_{name}_us") for name in ("runtime", "period")]
    try:
        runtime, period = (int(text or "") for text in texts)
    except ValueError:
        yield unknown("throttling", "/proc/sys/kernel/sched_rt_runtime_us cannot be read")
        return
    if runtime < 0:
        yield ok("throttling", "real-time tasks are not throttled")
    elif runtime >= _MIN_REALTIME_SHARE * period > 0:
        yield ok("throttling", f"real-time tasks may run {100 * runtime / period:.3g} % of the time")
    else:
        what = f"real-time tasks may run {wording.si(1e-6 * runtime, 's')} of {wording.si(1e-6 * period, 's')}"
        verdict = needs.verdict_without_realtime() if runtime == 0 else "warn"
        yield Finding("throttling", verdict, what, "sysctl kernel.sched_rt_runtime_us=950000")


def group_budget(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Check whether the kernel refuses SCHED_FIFO to control groups without a real-time budget."""
    built = _kernel_config(machine)
    if built is None:
        yield unknown("cgroup", "control groups may need a real-time budget: cannot read the kernel's configuration")
    elif not re.search(r"^CONFIG_RT_GROUP_SCHED=y$", built, re.MULTILINE):
        yield ok("cgroup", "control groups do not need a real-time budget")
    elif re.search(r"(?:^|\s)rt_group_sched=(?:0|n|off)\b", machine.text("/proc/cmdline") or ""):
        yield ok("cgroup", "control groups do not need a real-time budget (rt_group_sched=0)")
    else:
        what = "the kernel refuses SCHED_FIFO to control groups without a real-time budget (CONFIG_RT_GROUP_SCHED)"
        todo = "boot with rt_group_sched=0 (since Linux 6.16), or boot a kernel without this option"
        yield Finding("cgroup", needs.verdict_without_realtime(), what, todo)


def clock(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Check the kernel's clock source: some take microseconds to read."""
    name = machine.text("/sys/devices/system/clocksource/clocksource0/current_clocksource")
    if not name:
        yield unknown("clock", "/sys/devices/system/clocksource cannot be read")
    elif name in _FAST_CLOCK_SOURCES:
        yield ok("clock", f"clock source {name}")
    else:
        todo = "dmesg shows why the kernel does not use tsc; a firmware update often helps"
        yield warn("clock", f"clock source {name}, which is slow to read or coarse", todo)


# ---- Rights of this user; the unit sets those of the service (LimitRTPRIO, LimitMEMLOCK) -----------------------------


def priority(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Check whether a daemon that this user starts would get its priority under SCHED_FIFO."""
    soft, _ = machine.limit(resource.RLIMIT_RTPRIO)
    wanted, capable = f"SCHED_FIFO {needs.priority}", _has_capability(machine, _CAP_SYS_NICE)
    if capable or soft == resource.RLIM_INFINITY or soft >= needs.priority:
        yield ok("rtprio", f"{wanted} is allowed here, by {'CAP_SYS_NICE' if capable else 'the limit rtprio'}")
    else:
        what = f"{wanted} is not allowed here: the limit rtprio is {soft}"
        todo = f"`YOU - rtprio {needs.priority}` in {_LIMITS_HINT}"
        yield Finding("rtprio", needs.verdict_without_realtime(), what, todo)


def memory(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Check whether a daemon that this user starts could lock its memory."""
    soft, _ = machine.limit(resource.RLIMIT_MEMLOCK)
    if _has_capability(machine, _CAP_IPC_LOCK) or soft == resource.RLIM_INFINITY:
        yield ok("memlock", "memory may be locked here, without a limit")
    elif soft >= _MIN_LOCKABLE_BYTES:
        yield ok("memlock", f"{soft >> 20} MiB of memory may be locked here")
    else:
        what = f"only {soft >> 10} KiB of memory may be locked here; the rest may be paged out, which delays ticks"
        yield Finding("memlock", needs.verdict_without_realtime(), what, f"`YOU - memlock unlimited` in {_LIMITS_HINT}")


def _has_capability(machine: Machine, bit: int) -> bool:
    """Return whether this process has a capability; `bit` is its number in linux/capability.h."""
    match = re.search(r"^CapEff:\s*([0-9a-f]+)$", machine.text("/proc/self/status") or "", re.MULTILINE)
    return match is not None and bool(int(match[1], 16) >> bit & 1)


# ---- The processors --------------------------------------------------------------------------------------------------


def isolation(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Check whether the processor `servo.cpu` exists, is allowed, and is isolated from other tasks."""
    online, isolated = (machine.text(f"{_CPU_FOLDER}/{name}") or "" for name in ("online", "isolated"))
    name = f"processor {needs.cpu} (servo.cpu)"
    match = re.search(r"^Cpus_allowed_list:\s*(\S+)$", machine.text("/proc/self/status") or "", re.MULTILINE)
    allowed = match[1] if match else online
    if needs.cpu is None:
        if isolated:
            todo = f"set servo.cpu to {min(parse_cpu_list(isolated), default=0)}"
            yield warn("processor", f"processors {isolated} are isolated, but servo.cpu is not set", todo)
        else:
            yield ok("processor", "the servo may run on any processor (servo.cpu is not set)")
    elif not online:
        yield unknown("processor", f"{_CPU_FOLDER}/online cannot be read")
    elif needs.cpu not in parse_cpu_list(online):
        yield fail("processor", f"{name} does not exist: online are {online}", "set servo.cpu to one of these")
    elif needs.cpu not in parse_cpu_list(allowed) | parse_cpu_list(isolated):
        todo = "set servo.cpu to one of these, or allow the processor in the control group (cpuset.cpus)"
        yield fail("processor", f"{name} is not allowed here; allowed are {allowed}", todo)
    elif needs.cpu in parse_cpu_list(isolated):
        ticks = parse_cpu_list(machine.text(f"{_CPU_FOLDER}/nohz_full") or "")
        quiet = "" if needs.cpu in ticks else "; the scheduler's tick still interrupts it (see nohz_full)"
        yield ok("processor", f"{name} is isolated from other tasks{quiet}")
    else:
        boot = f"isolcpus={needs.cpu} nohz_full={needs.cpu} irqaffinity=OTHERS"
        yield warn("processor", f"{name} is shared with other tasks", f"boot with {boot}, or move them by cpusets")


def governor(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Check whether the frequency governors let the processors run at a low clock frequency."""
    names = machine.names(_CPU_FOLDER, r"cpu\d+") if needs.cpu is None else [f"cpu{needs.cpu}"]
    found = {name: machine.text(f"{_CPU_FOLDER}/{name}/cpufreq/scaling_governor") for name in names}
    slow = {name: text for name, text in found.items() if text and text != "performance"}
    if not any(found.values()):
        yield unknown("governor", "there is no cpufreq; the firmware or the host sets the frequency")
    elif not slow:
        yield ok("governor", "performance")
    else:
        which = f"{', '.join(sorted(set(slow.values())))} on {len(slow)} of {wording.count(len(found), 'processor')}"
        yield warn("governor", which, "cpupower frequency-set -g performance: a slow processor makes ticks late")


def idle_states(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Check whether the daemon may keep the processors out of deep idle states."""
    deepest = _slowest_idle_exit_us(machine, needs.cpu)
    to_wake = "exit latency not known" if deepest is None else f"up to {deepest} us to wake"
    node = machine.path("/dev/cpu_dma_latency")
    try:
        status = os.stat(node)
    except OSError:
        yield unknown("idle", f"/dev/cpu_dma_latency does not exist; {to_wake}")
        return
    if machine.may_write(node):
        yield ok("idle", f"deep idle states can be held off ({to_wake})")
    elif status.st_mode & 0o020 and machine.group(status.st_gid) == "hapticd":
        yield ok("idle", f"the service can hold deep idle states off ({to_wake})")
    elif deepest is not None and deepest <= _MAX_IDLE_EXIT_US:
        yield ok("idle", f"no deep idle states ({to_wake})")
    else:
        todo = "`hapticd install-service` gives it to the service's group, or boot with cpuidle.off=1"
        what = f"/dev/cpu_dma_latency is not writable, so deep idle states cannot be held off ({to_wake})"
        yield Finding("idle", needs.verdict_without_realtime(), what, todo)


def _slowest_idle_exit_us(machine: Machine, cpu: int | None) -> int | None:
    """Return the largest exit latency of the enabled idle states, in us; None if it is not known.

    `cpu` selects one processor; None means all.
    """
    found = []
    for name in machine.names(_CPU_FOLDER, r"cpu\d+") if cpu is None else [f"cpu{cpu}"]:
        for state in machine.names(f"{_CPU_FOLDER}/{name}/cpuidle", r"state\d+"):
            latency = machine.text(f"{_CPU_FOLDER}/{name}/cpuidle/{state}/latency") or ""
            if latency.isdecimal() and machine.text(f"{_CPU_FOLDER}/{name}/cpuidle/{state}/disable") != "1":
                found.append(int(latency))
    return max(found, default=None)
