"""Whether a device can be driven, by its report descriptor and the configuration alone: one plan, one verdict.

The daemon, `hapticd devices`, `devices parse`, `doctor` and `check` all ask here, so that they cannot disagree. A
device that is found drivable may still refuse to make an effect when it is set up; that is not in its descriptor.
"""

from __future__ import annotations

from dataclasses import dataclass

from hapticd.base.core import Status, invalid_reason, lib
from hapticd.config.hid import Hid
from hapticd.hid.descriptor.layout import SKIPPED, Layout, layout_of
from hapticd.hid.descriptor.parser import DescriptorError, parse
from hapticd.hid.device import Driver
from hapticd.hid.drivers.pid import PidDriver
from hapticd.hid.drivers.pid_plan import plan_of, ways_of
from hapticd.hid.drivers.vendor import VendorDriver
from hapticd.hid.drivers.vendor import plan_of as vendor_plan_of
from hapticd.hid.plan import DeviceError, Plan, UndrivableError

_MOST_STEP_M = 1.0
"""The servo takes no coarser positions."""
_SHOWN = 3


@dataclass(frozen=True, slots=True)
class Verdict:
    """What becomes of a device with this report descriptor."""

    layout: Layout | None
    """None where the descriptor cannot be read."""
    problem: str | None
    """Why it cannot be read."""
    driver: Driver | None
    """What sets it up; None where it cannot be driven."""
    plan: Plan | None
    """The plan for a device that has room for what is wanted and numbers its effects from the first on; None where it
    cannot be driven."""
    why_not: str | None
    """One line; None where it can be driven."""

    @property
    def drivable(self) -> bool:
        return self.why_not is None

    def sound(self) -> tuple[Driver, Plan]:
        """Its driver and its plan. Raises UndrivableError where it cannot be driven."""
        if self.driver is None or self.plan is None:
            why_not = str(self.why_not)
            # A fault of the configuration names its key, which says enough.
            raise UndrivableError(
                why_not if why_not.startswith("device.hid.") else f"the device cannot be driven: {why_not}"
            )
        return self.driver, self.plan

    def to_dict(self) -> dict[str, object]:
        """As JSON: the layout, and the verdict."""
        layout = {} if self.layout is None else self.layout.to_dict()
        leak = None if self.plan is None else self.plan.leak
        return {**layout, "usable": self.drivable, "why_not": self.why_not, "leak": leak}


def verdict_of(hid: Hid, descriptor: bytes) -> Verdict:
    """Never raises: what is wrong with the device is the verdict."""
    layout, problem = None, None
    try:
        layout = layout_of(parse(descriptor))
    except DescriptorError as error:
        problem = str(error)
    try:
        if hid.report is not None:
            # What a descriptor says of effects is of no matter to reports of its own.
            vendor = VendorDriver(hid, descriptor)
            return Verdict(layout, problem, vendor, _checked(vendor_plan_of(hid, hid.report)), None)
        if layout is None:
            raise DeviceError(f"its report descriptor is not valid: {problem}")
        if not layout.usable:
            raise DeviceError(f"its report descriptor has no {', no '.join(layout.missing)}")
        driver = PidDriver(layout, hid)
        first, last = layout.effect_indices or (1, 1)
        # Set-up goes on to the next way where the device has no room for the first one.
        plans = [
            _checked(plan_of(layout, hid, way, range(first, last + 1)[: 1 if way in ("one", "polar") else 2]))
            for way in ways_of(layout, hid)
        ]
        return Verdict(layout, problem, driver, plans[0], None)
    except DeviceError as error:
        why_not = str(error)
        if layout is not None and not why_not.startswith("device.hid."):
            why_not += _unused(layout)
        return Verdict(layout, problem, None, None, why_not)


def _unused(layout: Layout) -> str:
    """What fields are there and cannot be used: one of them may be the cause."""
    fields = [problem for problem in layout.problems if not problem.startswith(SKIPPED)]
    if not fields:
        return ""
    more = f", and {len(fields) - _SHOWN} more" if len(fields) > _SHOWN else ""
    return f" (not used: {'; '.join(fields[:_SHOWN])}{more})"


def _checked(plan: Plan) -> Plan:
    """The plan, if the core takes it. Raises DeviceError."""
    if lib.hd_hid_check(plan.to_c()) != Status.OK:
        raise DeviceError(invalid_reason())
    if not plan.resolution_m < _MOST_STEP_M:
        raise DeviceError(f"positions come in steps of {plan.resolution_m:g} m; the servo takes less than 1 m")
    return plan
