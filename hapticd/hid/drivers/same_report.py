"""Reports that must not be one: what is sent as one report writes zeros over the numbers of all the others in it."""

from __future__ import annotations

from hapticd.hid.descriptor.layout import Layout


def shared_report(layout: Layout, *, with_periodic: bool = False) -> str | None:
    """Which output reports of a device have one id, and what comes of it; None: each has its own. `with_periodic`:
    periodic effects are sent, too."""
    sent = {
        "Set Effect": layout.set_effect,
        "Set Constant Force": layout.constant_force,
        "Effect Operation": layout.effect_operation,
        "Device Control": layout.device_control,
        "Device Gain": layout.device_gain,
        "PID Block Free": layout.block_free,
        "Set Envelope": layout.set_envelope,
        "Set Periodic": layout.set_periodic if with_periodic else None,
    }
    by_id: dict[int, list[str]] = {}
    for name, report in sent.items():
        if report is not None:
            by_id.setdefault(report.report_id, []).append(name)
    for number, names in by_id.items():
        if len(names) > 1:
            which = f"output report {number}" if number else "the one output report, which has no id"
            return f"{', '.join(names[:-1])} and {names[-1]} are {which}: sending one would set the others to zero"
    return None
