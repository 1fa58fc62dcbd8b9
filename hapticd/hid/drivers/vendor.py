"""Driver of devices with vendor reports, which `device.hid.report` describes."""

from __future__ import annotations

from hapticd.base.core import HidQuantity
from hapticd.config.hid import Hid, VendorBits, VendorInputAxis, VendorReport
from hapticd.hid.descriptor.parser import Descriptor, DescriptorError, ReportKind, parse
from hapticd.hid.device import Device
from hapticd.hid.plan import STILL_AXIS_M_PER_COUNT, AxisPlan, Bits, DeviceError, Message, Plan, Value


class VendorDriver:
    """Driver of a device with vendor reports: sends the configured reports that enable it, and makes the plan."""

    def __init__(self, hid: Hid, descriptor: bytes) -> None:
        """Create a driver, and compare the configuration with the device's report descriptor.

        Raises DeviceError if the two contradict each other. An invalid descriptor is ignored.
        """
        assert hid.report is not None
        self._hid = hid
        self._report = hid.report
        try:
            parsed = parse(descriptor)
        except DescriptorError:
            return
        _check(self._report, parsed)

    def set_up(self, device: Device) -> Plan:
        """Send the reports that enable the device, and return the plan."""
        for text in self._report.enable:
            report = report_bytes(text)
            if text.startswith("feature"):
                device.send_feature(report)
            else:
                device.write(report)
        return plan_of(self._hid, self._report)


def report_bytes(text: str) -> bytes:
    """Return the bytes of a report of the configuration, its id first."""
    return bytes.fromhex(text.removeprefix("feature "))


def plan_of(hid: Hid, report: VendorReport) -> Plan:
    """Return the plan of a device with vendor reports."""
    into, out = report.input, report.output
    data = bytes([out.report_id]) + bytes(out.length)
    values = [
        Value(bits, quantity, axis.counts_per_n, axis.zero_counts, bits.min_counts, bits.max_counts)
        for axis, quantity in ((out.x, HidQuantity.X), (out.y, HidQuantity.Y))
        if axis is not None
        for bits in [_bits(axis)]
    ]
    return Plan(
        x=_axis(into.x, into.report_id),
        # A handle with one axis does not move along the other.
        y=_axis(into.x, into.report_id, still=True) if into.y is None else _axis(into.y, into.report_id),
        force=(Message(data, tuple(values)),),
        renew=(),
        stop=tuple(Message(report_bytes(text)) for text in report.disable),
        renew_s=report.renew_s,
        write_interval_s=0.0 if hid.max_rate_hz is None else 1.0 / hid.max_rate_hz,
    )


def _axis(axis: VendorInputAxis, report_id: int, still: bool = False) -> AxisPlan:
    m_per_count = STILL_AXIS_M_PER_COUNT if still else 1.0 / axis.counts_per_m
    return AxisPlan(_bits(axis), report_id, axis.zero_counts, (m_per_count, m_per_count))


def _bits(axis: VendorBits) -> Bits:
    return Bits(axis.bit_offset, axis.bit_size, axis.signed, axis.byte_order == "big")


def _check(report: VendorReport, descriptor: Descriptor) -> None:
    """Raise DeviceError if the configuration contradicts the report descriptor."""
    into, out = report.input, report.output
    written = _data_bytes(descriptor, ReportKind.OUTPUT, out.report_id)
    if written != out.length:
        raise DeviceError(
            f"device.hid.report.output.length: output report {out.report_id} of the device has {written} bytes after "
            f"its id, not {out.length}"
        )
    read = _data_bytes(descriptor, ReportKind.INPUT, into.report_id)
    for name, axis in (("x", into.x), ("y", into.y)):
        if axis is not None and axis.end > 8 * read:
            raise DeviceError(
                f"device.hid.report.input.{name}: bit {axis.end - 1} is beyond input report {into.report_id} of the "
                f"device, which has {read} bytes after its id"
            )


def _data_bytes(descriptor: Descriptor, kind: ReportKind, report_id: int) -> int:
    """Return the length of a report in bytes, without its id. Raises DeviceError if there is no report of that id."""
    bits = descriptor.report_bits.get((kind, report_id))
    if bits is None:
        ids = sorted(number for of, number in descriptor.report_bits if of == kind)
        raise DeviceError(
            f"device.hid.report.{kind}.report_id: the device has no {kind} report {report_id}; "
            f"it has {', '.join(map(str, ids)) or 'none'}"
        )
    return (bits + 7) // 8
