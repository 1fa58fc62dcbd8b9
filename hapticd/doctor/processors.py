"""The processors: which the servo may have for itself, how fast they run, how deep they sleep."""

from __future__ import annotations

import os
import re
from collections import defaultdict
from collections.abc import Iterator
from typing import Final

from hapticd.doctor.machine import Finding, Machine, Needs, listed, processors, unknown

_CPU: Final = "/sys/devices/system/cpu"
LONGEST_WAKE_US: Final = 50
"""A tick at 10 kHz has 100 us; an idle state that takes half of that to leave is deep."""


def isolation(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Whether `servo.cpu` is there, allowed, and kept free of others."""
    online = machine.text(f"{_CPU}/online")
    isolated = processors(machine.text(f"{_CPU}/isolated") or "")
    if needs.cpu is None:
        if isolated:
            yield Finding(
                "processor",
                "warn",
                f"processors {listed(isolated)} are kept free, and servo.cpu names none",
                f"set servo.cpu to {min(isolated)}",
            )
        else:
            yield Finding("processor", "ok", "the servo may run on any processor (servo.cpu is not set)")
        return
    if online is None:
        yield unknown("processor", f"{_CPU}/online cannot be read")
        return
    name = f"processor {needs.cpu} (servo.cpu)"
    match = re.search(r"^Cpus_allowed_list:\s*(\S+)$", machine.text("/proc/self/status") or "", re.MULTILINE)
    allowed = processors(match[1]) if match else None
    if needs.cpu not in processors(online):
        yield Finding("processor", "fail", f"{name} is not there: {online} are", "name another one in servo.cpu")
    elif allowed is not None and needs.cpu not in allowed | isolated:
        yield Finding(
            "processor",
            "fail",
            f"{name} is not allowed here: {listed(allowed)} are",
            "name one of these, or give its control group the processor (cpuset.cpus)",
        )
    elif needs.cpu in isolated:
        ticks = processors(machine.text(f"{_CPU}/nohz_full") or "")
        quiet = "" if needs.cpu in ticks else ", though with the scheduler's tick (nohz_full)"
        yield Finding("processor", "ok", f"{name} is kept free of other tasks{quiet}")
    else:
        yield Finding(
            "processor",
            "warn",
            f"{name} is shared with other tasks",
            f"boot with isolcpus={needs.cpu} nohz_full={needs.cpu} irqaffinity=OTHERS, or move others away by cpusets",
        )


def governor(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """What decides on the frequency."""
    found: dict[str, set[int]] = defaultdict(set)
    for name in machine.names(_CPU, r"cpu\d+"):
        text = machine.text(f"{_CPU}/{name}/cpufreq/scaling_governor")
        if text:
            found[text].add(int(name[3:]))
    slow = {text: numbers for text, numbers in found.items() if text != "performance"}
    if needs.cpu is not None:
        slow = {text: {needs.cpu} for text, numbers in slow.items() if needs.cpu in numbers}
    if not found:
        yield unknown("governor", "no cpufreq: the frequency is the firmware's or the host's")
    elif not slow:
        yield Finding("governor", "ok", "performance")
    else:
        which = ", ".join(f"{text} on {listed(numbers)}" for text, numbers in slow.items())
        yield Finding(
            "governor", "warn", which, "cpupower frequency-set -g performance: a slow processor makes ticks late"
        )


def idle_states(machine: Machine, needs: Needs) -> Iterator[Finding]:
    """Whether the daemon may keep the processors out of deep idle states."""
    deepest = _deepest_us(machine, needs.cpu)
    node = machine.path("/dev/cpu_dma_latency")
    try:
        status = os.stat(node)
    except OSError:
        yield unknown(
            "idle", f"/dev/cpu_dma_latency is not there{'' if deepest is None else f'; up to {deepest} us to wake'}"
        )
        return
    to_wake = "how long it takes to wake is not known" if deepest is None else f"up to {deepest} us to wake"
    ours = status.st_mode & 0o020 and machine.group(status.st_gid) == "hapticd"
    if machine.may_write(node):
        yield Finding("idle", "ok", f"deep idle states can be held off ({to_wake})")
    elif ours:
        yield Finding("idle", "ok", f"the service can hold deep idle states off ({to_wake})")
    elif deepest is not None and deepest <= LONGEST_WAKE_US:
        yield Finding("idle", "ok", f"no deep idle states ({to_wake})")
    else:
        yield Finding(
            "idle",
            needs.without(),
            f"/dev/cpu_dma_latency may not be written: {to_wake}",
            "`hapticd install-service` gives it to the service's group, or boot with cpuidle.off=1",
        )


def _deepest_us(machine: Machine, cpu: int | None) -> int | None:
    """What the slowest idle state that is not switched off takes to leave; None where that is not known."""
    names = machine.names(_CPU, r"cpu\d+") if cpu is None else [f"cpu{cpu}"]
    found = []
    for name in names:
        for state in machine.names(f"{_CPU}/{name}/cpuidle", r"state\d+"):
            latency = machine.text(f"{_CPU}/{name}/cpuidle/{state}/latency") or ""
            if latency.isdecimal() and machine.text(f"{_CPU}/{name}/cpuidle/{state}/disable") != "1":
                found.append(int(latency))
    return max(found, default=None)
