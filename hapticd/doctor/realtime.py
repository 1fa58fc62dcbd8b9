"""What real time needs: the kernel's preemption and clock, the time and the rights that it grants, and processors."""

from __future__ import annotations

import gzip
import os
import re
import resource
from collections.abc import Iterator
from typing import Final

from hapticd.base import wording
from hapticd.doctor.machine import Finding, Machine, Needs, fail, ok, processors, unknown, warn

_CPU: Final = "/sys/devices/system/cpu"
_GOOD_CLOCKS: Final = (
    "tsc",
    "kvm-clock",
    "hyperv_clocksource_tsc_page",
    "arch_sys_counter",
    "timebase",
    "riscv_clocksource",
)
_LEAST_SHARE: Final = 0.5
"""Of the time, for real-time tasks."""
_CAP_IPC_LOCK: Final = 14
_CAP_SYS_NICE: Final = 23
_LEAST_LOCKED_BYTES: Final = 256 << 20
"""More than a daemon with a large scene locks."""
_LIMITS: Final = "/etc/security/limits.d/hapticd.conf, and log in anew; or run the service (`hapticd install-service`)"
_LONGEST_WAKE_US: Final = 50
"""A tick at 10 kHz has 100 us; an idle state that takes half of that to leave is deep."""


# ---- The kernel ------------------------------------------------------------------------------------------------------


def preemption(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """PREEMPT_RT, or how the kernel is preempted otherwise."""
    version = machine.text("/proc/version") or ""
    release = machine.text("/proc/sys/kernel/osrelease") or "this kernel"
    if machine.text("/sys/kernel/realtime") == "1" or re.search(r"\bPREEMPT_RT\b", version):
        yield ok("kernel", f"{release}, PREEMPT_RT")
        return
    model = _model(machine, version)
    if model is None:
        files = "/proc/version and /sys/kernel/debug/sched/preempt"
        yield unknown("kernel", f"{files} do not say how {release} is preempted")
    elif model in ("full", "lazy"):
        yield ok("kernel", f"{release}, preemption: {model} (PREEMPT_RT has a lower worst case)")
    else:
        what = f"{release}, preemption: {model}; a long system call of anybody makes ticks late"
        yield warn("kernel", what, "boot with preempt=full, or a PREEMPT_RT kernel (Debian: linux-image-rt-amd64)")


def _model(machine: Machine, version: str) -> str | None:
    """none, voluntary, lazy or full."""
    # "none voluntary (full)": the one in force stands in brackets.
    match = re.search(r"\((\w+)\)", machine.text("/sys/kernel/debug/sched/preempt") or "")
    if match or not version:
        return match[1] if match else None
    if re.search(r"\bPREEMPT\b(?!_)", version):
        return "full"
    if "PREEMPT_DYNAMIC" not in version:
        return "voluntary or none"
    match = re.search(r"(?:^|\s)preempt=(\w+)", machine.text("/proc/cmdline") or "")
    match = match or re.search(r"^CONFIG_PREEMPT(?:_(LAZY|VOLUNTARY|NONE))?=y$", _built(machine) or "", re.MULTILINE)
    return (match[1] or "full").lower() if match else None


def _built(machine: Machine) -> str | None:
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


def throttling(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """How much of the time real-time tasks may have."""
    texts = [machine.text(f"/proc/sys/kernel/sched_rt_{name}_us") for name in ("runtime", "period")]
    try:
        runtime, period = (int(text or "") for text in texts)
    except ValueError:
        yield unknown("throttling", "/proc/sys/kernel/sched_rt_runtime_us cannot be read")
        return
    if runtime < 0:
        yield ok("throttling", "real-time tasks are not throttled")
    elif runtime >= _LEAST_SHARE * period > 0:
        yield ok("throttling", f"real-time tasks may have {100 * runtime / period:.3g} % of the time")
    else:
        what = f"real-time tasks may have {wording.si(1e-6 * runtime, 's')} of {wording.si(1e-6 * period, 's')}"
        verdict = needs.without() if runtime == 0 else "warn"
        yield Finding("throttling", verdict, what, "sysctl kernel.sched_rt_runtime_us=950000")


def group_budget(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Whether the control group leaves room for SCHED_FIFO."""
    built = _built(machine)
    if built is None:
        yield unknown("cgroup", "the kernel's configuration cannot be read, so whether groups have real-time budgets")
    elif not re.search(r"^CONFIG_RT_GROUP_SCHED=y$", built, re.MULTILINE):
        yield ok("cgroup", "control groups do not limit real time")
    elif re.search(r"(?:^|\s)rt_group_sched=(?:0|n|off)\b", machine.text("/proc/cmdline") or ""):
        yield ok("cgroup", "control groups do not limit real time (rt_group_sched=0)")
    else:
        what = "the kernel refuses SCHED_FIFO to control groups without a real-time budget (CONFIG_RT_GROUP_SCHED)"
        todo = "boot with rt_group_sched=0 (Linux 6.16), or a kernel without it"
        yield Finding("cgroup", needs.without(), what, todo)


def clock(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """The clock source: some take microseconds to read."""
    name = machine.text("/sys/devices/system/clocksource/clocksource0/current_clocksource")
    if not name:
        yield unknown("clock", "/sys/devices/system/clocksource cannot be read")
    elif name in _GOOD_CLOCKS:
        yield ok("clock", f"clock source {name}")
    else:
        todo = "see in dmesg why the kernel left tsc; a firmware update often helps"
        yield warn("clock", f"clock source {name}, which is slow to read or coarse", todo)


# ---- Rights of whoever asks. A unit has its own, LimitRTPRIO and LimitMEMLOCK ----------------------------------------


def priority(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Whether a daemon that is started from here may have its priority."""
    soft, _ = machine.limit(resource.RLIMIT_RTPRIO)
    wanted, capable = f"SCHED_FIFO {needs.priority}", _capable(machine, _CAP_SYS_NICE)
    if capable or soft == resource.RLIM_INFINITY or soft >= needs.priority:
        yield ok("rtprio", f"{wanted} is allowed here, by {'CAP_SYS_NICE' if capable else 'the limit rtprio'}")
    else:
        what = f"{wanted} is not allowed here: the limit rtprio is {soft}"
        yield Finding("rtprio", needs.without(), what, f"`YOU - rtprio {needs.priority}` in {_LIMITS}")


def memory(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Whether a daemon that is started from here may lock its memory."""
    soft, _ = machine.limit(resource.RLIMIT_MEMLOCK)
    if _capable(machine, _CAP_IPC_LOCK) or soft == resource.RLIM_INFINITY:
        yield ok("memlock", "memory may be locked here, without a limit")
    elif soft >= _LEAST_LOCKED_BYTES:
        yield ok("memlock", f"{soft >> 20} MiB of memory may be locked here")
    else:
        what = f"only {soft >> 10} KiB of memory may be locked here: the rest may be paged out, and ticks wait for it"
        yield Finding("memlock", needs.without(), what, f"`YOU - memlock unlimited` in {_LIMITS}")


def _capable(machine: Machine, bit: int) -> bool:
    """Whether this process has a capability, by its number in linux/capability.h."""
    match = re.search(r"^CapEff:\s*([0-9a-f]+)$", machine.text("/proc/self/status") or "", re.MULTILINE)
    return match is not None and bool(int(match[1], 16) >> bit & 1)


# ---- The processors --------------------------------------------------------------------------------------------------


def isolation(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Whether `servo.cpu` is there, allowed, and kept free of others."""
    online, isolated = (machine.text(f"{_CPU}/{name}") or "" for name in ("online", "isolated"))
    name = f"processor {needs.cpu} (servo.cpu)"
    match = re.search(r"^Cpus_allowed_list:\s*(\S+)$", machine.text("/proc/self/status") or "", re.MULTILINE)
    allowed = match[1] if match else online
    if needs.cpu is None:
        if isolated:
            todo = f"set servo.cpu to {min(processors(isolated), default=0)}"
            yield warn("processor", f"processors {isolated} are kept free, and servo.cpu names none", todo)
        else:
            yield ok("processor", "the servo may run on any processor (servo.cpu is not set)")
    elif not online:
        yield unknown("processor", f"{_CPU}/online cannot be read")
    elif needs.cpu not in processors(online):
        yield fail("processor", f"{name} is not there: {online} are", "name another one in servo.cpu")
    elif needs.cpu not in processors(allowed) | processors(isolated):
        todo = "name one of these, or give its control group the processor (cpuset.cpus)"
        yield fail("processor", f"{name} is not allowed here: {allowed} are", todo)
    elif needs.cpu in processors(isolated):
        ticks = processors(machine.text(f"{_CPU}/nohz_full") or "")
        quiet = "" if needs.cpu in ticks else ", though with the scheduler's tick (nohz_full)"
        yield ok("processor", f"{name} is kept free of other tasks{quiet}")
    else:
        boot = f"isolcpus={needs.cpu} nohz_full={needs.cpu} irqaffinity=OTHERS"
        yield warn("processor", f"{name} is shared with other tasks", f"boot with {boot}, or move others by cpusets")


def governor(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """What decides on the frequency."""
    names = machine.names(_CPU, r"cpu\d+") if needs.cpu is None else [f"cpu{needs.cpu}"]
    found = {name: machine.text(f"{_CPU}/{name}/cpufreq/scaling_governor") for name in names}
    slow = {name: text for name, text in found.items() if text and text != "performance"}
    if not any(found.values()):
        yield unknown("governor", "no cpufreq: the frequency is the firmware's or the host's")
    elif not slow:
        yield ok("governor", "performance")
    else:
        which = f"{', '.join(sorted(set(slow.values())))} on {len(slow)} of {wording.count(len(found), 'processor')}"
        yield warn("governor", which, "cpupower frequency-set -g performance: a slow processor makes ticks late")


def idle_states(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Whether the daemon may keep the processors out of deep idle states."""
    deepest = _deepest_us(machine, needs.cpu)
    to_wake = "how long it takes to wake is not known" if deepest is None else f"up to {deepest} us to wake"
    node = machine.path("/dev/cpu_dma_latency")
    try:
        status = os.stat(node)
    except OSError:
        yield unknown("idle", f"/dev/cpu_dma_latency is not there; {to_wake}")
        return
    if machine.may_write(node):
        yield ok("idle", f"deep idle states can be held off ({to_wake})")
    elif status.st_mode & 0o020 and machine.group(status.st_gid) == "hapticd":
        yield ok("idle", f"the service can hold deep idle states off ({to_wake})")
    elif deepest is not None and deepest <= _LONGEST_WAKE_US:
        yield ok("idle", f"no deep idle states ({to_wake})")
    else:
        todo = "`hapticd install-service` gives it to the service's group, or boot with cpuidle.off=1"
        yield Finding("idle", needs.without(), f"/dev/cpu_dma_latency may not be written: {to_wake}", todo)


def _deepest_us(machine: Machine, cpu: int | None) -> int | None:
    """What the slowest idle state that is not switched off takes to leave; None where that is not known."""
    found = []
    for name in machine.names(_CPU, r"cpu\d+") if cpu is None else [f"cpu{cpu}"]:
        for state in machine.names(f"{_CPU}/{name}/cpuidle", r"state\d+"):
            latency = machine.text(f"{_CPU}/{name}/cpuidle/{state}/latency") or ""
            if latency.isdecimal() and machine.text(f"{_CPU}/{name}/cpuidle/{state}/disable") != "1":
                found.append(int(latency))
    return max(found, default=None)
