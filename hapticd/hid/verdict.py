"""Decides whether a device can be driven, from its report descriptor and the configuration.

The daemon, `hapticd devices`, `devices parse`, `doctor` and `check` all use this decision, so that they agree. The
descriptor does not show everything: a device that can be driven may refuse to create an effect during set-up.
"""

from __future__ import annotations

from dataclasses import dataclass

from hapticd.base.core import Status, invalid_reason, lib
from hapticd.config.hid import Hid
from hapticd.hid.descriptor.layout import SKIPPED_ITEM_PREFIX, Layout, layout_of
from hapticd.hid.descriptor.parser import DescriptorError, parse
from hapticd.hid.device import Driver
from hapticd.hid.drivers.pid import PidDriver
from hapticd.hid.drivers.pid_plan import plan_of, schemes_of
from hapticd.hid.drivers.vendor import VendorDriver
from hapticd.hid.drivers.vendor import plan_of as vendor_plan_of
from hapticd.hid.plan import DeviceError, Plan, UndrivableError

_MAX_POSITION_STEP_M = 1.0
"""The position step of one count must be smaller."""
_MAX_LISTED_PROBLEMS = 3
"""An error lists at most this many fields that cannot be used."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether and how a device with this report descriptor can be driven."""

    layout: Layout | None
    """The reports and axes of the descriptor; None if the descriptor is not valid."""
    problem: str | None
    """Why the descriptor is not valid; None if it is valid."""
    driver: Driver | None
    """The driver that sets up the device; None if the device cannot be driven."""
    plan: Plan | None
    """The plan of fields and reports, assuming that the device can create all wanted effects and numbers them from the
    first Effect Block Index on; None if it cannot be driven."""
    why_not: str | None
    """Why the device cannot be driven; None if it can be driven."""

    @property
    def drivable(self) -> bool:
        """Whether the device can be driven."""
        return self.why_not is None

    def driver_and_plan(self) -> tuple[Driver, Plan]:
        """Return the device's driver and the plan of its reports. Raises UndrivableError if it cannot be driven."""
        if self.driver is None or self.plan is None:
            why_not = str(self.why_not)
            # An error of the configuration begins with its key and needs no prefix.
            raise UndrivableError(
                why_not if why_not.startswith("device.hid.") else f"the device cannot be driven: {why_not}"
            )
        return self.driver, self.plan

    def to_dict(self) -> dict[str, object]:
        """Return layout and verdict as a map for `hapticd devices parse --json`."""
        layout = {} if self.layout is None else self.layout.to_dict()
        leak = None if self.plan is None else self.plan.leak
        return {**layout, "usable": self.drivable, "why_not": self.why_not, "leak": leak}


def verdict_of(hid: Hid, descriptor: bytes) -> Verdict:
    """Return the verdict on a device with this report descriptor; a device that cannot be driven raises no error."""
    layout, problem = None, None
    try:
        layout = layout_of(parse(descriptor))
    except DescriptorError as error:
        problem = str(error)
    try:
        if hid.report is not None:
            # With vendor reports, the PID reports of the descriptor do not matter.
            vendor = VendorDriver(hid, descriptor)
            return Verdict(layout, problem, vendor, _checked(vendor_plan_of(hid, hid.report)), None)
        if layout is None:
            raise DeviceError(f"its report descriptor is not valid: {problem}")
        if not layout.usable:
            raise DeviceError(f"its report descriptor has no {', no '.join(layout.missing)}")
        driver = PidDriver(layout, hid)
        first, last = layout.effect_indices or (1, 1)
        # If the device has no room for the first scheme, set-up tries the next one; so all plans are checked.
        plans = [
            _checked(plan_of(layout, hid, scheme, range(first, last + 1)[: 1 if scheme in ("one", "polar") else 2]))
            for scheme in schemes_of(layout, hid)
        ]
        return Verdict(layout, problem, driver, plans[0], None)
    except DeviceError as error:
        why_not = str(error)
        if layout is not None and not why_not.startswith("device.hid."):
            why_not += _unused_fields_text(layout)
        return Verdict(layout, problem, None, None, why_not)


def _unused_fields_text(layout: Layout) -> str:
    """Return a text that lists the fields that exist but cannot be used, a possible cause of an undrivable device."""
    fields = [problem for problem in layout.problems if not problem.startswith(SKIPPED_ITEM_PREFIX)]
    if not fields:
        return ""
    more = f", and {len(fields) - _MAX_LISTED_PROBLEMS} more" if len(fields) > _MAX_LISTED_PROBLEMS else ""
    return f" (not used: {'; '.join(fields[:_MAX_LISTED_PROBLEMS])}{more})"


def _checked(plan: Plan) -> Plan:
    """Return the plan if C accepts it; otherwise raise DeviceError."""
    if lib.hd_hid_check(plan.to_c()) != Status.OK:
        raise DeviceError(invalid_reason())
    if not plan.resolution_m < _MAX_POSITION_STEP_M:
        raise DeviceError(f"the step of positions must be below 1 m, is {plan.resolution_m:g} m")
    return plan
