"""Configuration of HID devices: `device.hid` and `device.replay`."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self, TypeAlias

from pydantic import AfterValidator, Field, field_validator, model_validator

from hapticd.base.errors import shown
from hapticd.base.model import Model

Usage: TypeAlias = Literal["X", "Y", "Z", "Rx", "Ry", "Rz"]
"""Name of an axis in HID's usage page Generic Desktop."""
Sign: TypeAlias = Literal[1, -1]
Count: TypeAlias = Annotated[int, Field(ge=-(2**31), le=2**32 - 1)]
"""A number in a report's field of at most 32 bits."""
CountRange: TypeAlias = Annotated[tuple[Count, Count, Count], Field(strict=False)]
"""The counts of an axis at the lower end of its range, in the middle, and at the upper end."""
Quirk: TypeAlias = Literal[
    "infinite_duration",
    "no_device_gain",
    "no_pid_pool",
    "no_reset",
    "one_effect",
    "reports_on_change",
    "reports_steadily",
]
ReportId: TypeAlias = Annotated[int, Field(ge=0, le=255)]
MAX_REPORT_BYTES = 255
"""Maximum size of a HID report in bytes, without its id."""
MAX_REPORTS = 24
"""Maximum number of HID reports in the key `disable`, which switches the device off."""


def _hex(text: str) -> str:
    try:
        report = bytes.fromhex(text.removeprefix("feature "))
    except ValueError:
        report = b""
    if not 0 < len(report) <= MAX_REPORT_BYTES + 1:
        raise ValueError(f'must be hex digits, as "02 01 00", at most {MAX_REPORT_BYTES + 1} bytes, is {shown(text)}')
    return text


HexReport: TypeAlias = Annotated[str, Field(max_length=1024), AfterValidator(_hex)]
"""A report as hex digits, its id first (00 if reports are not numbered). A feature report begins with `feature `."""


class HandleAxis(Model):
    """The axis of the device's reports that gives one axis of the handle."""

    usage: Usage = Field(default="X", description="HID usage of the report's axis; for y by default Y.")
    sign: Sign = Field(
        default=1,
        description="-1 if the counts grow to the left, or towards the user; for y without usage by default -1.",
    )
    counts: CountRange | None = Field(
        default=None,
        description="Counts at the lower end of the travel, in the middle, and at the upper end, as `hapticd devices "
        "calibrate` measures them; null: the range in the report descriptor.",
    )

    @model_validator(mode="after")
    def _counts_increase(self) -> Self:
        if self.counts is not None and not self.counts[0] < self.counts[1] < self.counts[2]:
            raise ValueError(f"counts must increase: low, middle, high, are {list(self.counts)}")
        return self


class HandleAxes(Model):
    """The axes of the handle."""

    x: HandleAxis = Field(default=HandleAxis(usage="X"), description="The axis to the right.")
    y: HandleAxis = Field(
        default=HandleAxis(usage="Y", sign=-1), description="The axis away from the user; HID's Y is opposite."
    )

    @model_validator(mode="before")
    @classmethod
    def _usage_of_y(cls, data: Any) -> Any:
        if isinstance(data, dict) and isinstance(data.get("y"), dict) and "usage" not in data["y"]:
            return {**data, "y": {"usage": "Y", "sign": -1, **data["y"]}}
        return data

    def with_counts(self, x: CountRange | None, y: CountRange | None) -> HandleAxes:
        """Return these axes with other counts."""
        return HandleAxes(x=self.x.model_copy(update={"counts": x}), y=self.y.model_copy(update={"counts": y}))


class ForceAxis(Model):
    """Sign of the force along one axis of the device."""

    sign: Sign = Field(default=1, description="-1 if the device pushes in the other direction.")


class ForceAxes(Model):
    """The axes along which the device pushes; found by `hapticd devices calibrate`."""

    x: ForceAxis = Field(default=ForceAxis(), description="The device's first axis, to the right.")
    y: ForceAxis = Field(default=ForceAxis(), description="The device's second axis, away from the user.")
    swap: bool = Field(default=False, description="Whether the device's two axes are swapped.")


class VendorBits(Model):
    """Place and format of a number in a report."""

    bit_offset: int = Field(ge=0, le=8 * MAX_REPORT_BYTES - 1, description="First bit, counted after the report id.")
    bit_size: int = Field(ge=1, le=32, description="Number of bits.")
    signed: bool = Field(default=True, description="Whether it is a number in two's complement.")
    byte_order: Literal["little", "big"] = Field(
        default="little", description="Byte order; `big` needs offset and size in multiples of 8 bits."
    )

    @property
    def end(self) -> int:
        """Index of the first bit after the number in the report."""
        return self.bit_offset + self.bit_size

    @model_validator(mode="after")
    def _bytes_of_big_endian(self) -> Self:
        if self.byte_order == "big" and (self.bit_offset % 8 or self.bit_size % 8):
            raise ValueError("with byte_order big, bit_offset and bit_size must be multiples of 8")
        if self.end > 8 * MAX_REPORT_BYTES:
            raise ValueError(f"bit {self.end - 1} lies beyond the longest report, {MAX_REPORT_BYTES} bytes")
        return self


Scale: TypeAlias = Annotated[float, Field(ge=-1e9, le=1e9)]


class VendorInputAxis(VendorBits):
    """A position in an input report."""

    counts_per_m: Scale = Field(description="Counts per metre; negative if they grow in the other direction.")
    zero_counts: float = Field(default=0.0, ge=-4294967296, le=4294967296, description="Counts in the middle.")

    @model_validator(mode="after")
    def _scaled(self) -> Self:
        if abs(self.counts_per_m) < 1.0:
            raise ValueError(f"counts_per_m must be at least 1, or at most -1, is {self.counts_per_m:g}")
        return self


class VendorOutputAxis(VendorBits):
    """A force in an output report."""

    counts_per_n: Scale = Field(description="Counts per newton; negative if the device pushes in the other direction.")
    zero_counts: float = Field(default=0.0, ge=-4294967296, le=4294967296, description="Counts at zero force.")

    @model_validator(mode="after")
    def _scaled(self) -> Self:
        if abs(self.counts_per_n) < 1e-3:
            raise ValueError(f"counts_per_n must be at least 0.001, or at most -0.001, is {self.counts_per_n:g}")
        low = -(1 << (self.bit_size - 1)) if self.signed else 0
        high = (1 << (self.bit_size - self.signed)) - 1
        if not low <= self.zero_counts <= high:
            raise ValueError(
                f"zero_counts {self.zero_counts:g} does not fit into {self.bit_size} bits: {low} to {high}"
            )
        return self


def _refuse_overlap(x: VendorBits, y: VendorBits) -> None:
    if x.bit_offset < y.end and y.bit_offset < x.end:
        raise ValueError(f"x (bits {x.bit_offset} to {x.end - 1}) and y (bits {y.bit_offset} to {y.end - 1}) overlap")


class VendorInput(Model):
    """The input report that holds positions."""

    report_id: ReportId = Field(default=0, description="Id of the report; 0 if reports are not numbered.")
    x: VendorInputAxis = Field(description="The position to the right.")
    y: VendorInputAxis | None = Field(default=None, description="The position away from the user; null: none.")

    @model_validator(mode="after")
    def _fields_disjoint(self) -> Self:
        if self.y is not None:
            _refuse_overlap(self.x, self.y)
        return self


class VendorOutput(Model):
    """The output report that holds forces."""

    report_id: ReportId = Field(default=0, description="Id of the report; 0 if reports are not numbered.")
    length: int = Field(ge=1, le=MAX_REPORT_BYTES, description="Size of the report in bytes, without the id.")
    x: VendorOutputAxis = Field(description="The force to the right.")
    y: VendorOutputAxis | None = Field(default=None, description="The force away from the user; null: none.")

    @model_validator(mode="after")
    def _fields_inside(self) -> Self:
        for name, axis in (("x", self.x), ("y", self.y)):
            if axis is not None and axis.end > 8 * self.length:
                raise ValueError(
                    f"{name} ends at bit {axis.end - 1}, but {self.length} bytes end at bit {8 * self.length - 1}"
                )
        if self.y is not None:
            _refuse_overlap(self.x, self.y)
        return self


class VendorReport(Model):
    """Report formats of a device that is not of the PID class."""

    input: VendorInput = Field(description="The input report with the positions.")
    output: VendorOutput = Field(description="The output report with the forces.")
    enable: Annotated[tuple[HexReport, ...], Field(max_length=64, strict=False)] = Field(
        default=(),
        description="Reports that switch the device on: hex digits, the id first; a feature report begins with "
        "`feature `.",
    )
    disable: Annotated[tuple[HexReport, ...], Field(max_length=MAX_REPORTS, strict=False)] = Field(
        default=(), description="Output reports that switch the device off."
    )
    renew_s: float = Field(
        default=0.04, ge=0.001, le=10, description="Interval at which the force is sent again, changed or not."
    )

    @model_validator(mode="after")
    def _disable_writes(self) -> Self:
        if any(text.startswith("feature") for text in self.disable):
            raise ValueError("disable must hold output reports only, not feature reports")
        return self


class Hid(Model):
    """A HID joystick with force feedback."""

    vendor: Annotated[int, Field(ge=0, le=0xFFFF)] | None = Field(
        default=None, description="Vendor id of the device; null: any. This and the next three keys select a device."
    )
    product: Annotated[int, Field(ge=0, le=0xFFFF)] | None = Field(default=None, description="Product id; null: any.")
    serial: Annotated[str, Field(min_length=1, max_length=256)] | None = Field(
        default=None, description="Serial number; null: any."
    )
    path: Annotated[str, Field(min_length=1, max_length=256)] | None = Field(
        default=None, description="Device node, such as /dev/hidraw3; null: any."
    )
    device_version: Annotated[int, Field(ge=0, le=0xFFFF)] | None = Field(
        default=None,
        description="Version of the calibrated device: bcdDevice of USB, which lsusb prints as 1.07 for 0x0107. A "
        "device that shows another one is checked as by `signs: check`; null: not known.",
    )
    travel_m: float = Field(
        default=0.05, ge=0.001, le=10, description="Half the handle's travel, from the middle to the end of its range."
    )
    full_scale_force_n: float = Field(
        default=8.9, ge=0.01, le=100, description="Force at the report's maximum; device.max_force_n limits commands."
    )
    axes: HandleAxes = Field(default=HandleAxes(), description="Axes of the position in the report.")
    force_axes: ForceAxes = Field(default=ForceAxes(), description="Axes along which the device pushes.")
    signs: Literal["check", "trust"] = Field(
        default="check",
        description="`check`: before the first force of the scene, soft pulses must move the handle in the right "
        "direction; `trust`: no pulses. By default `trust` if force_axes or report is given.",
    )
    effect_duration_s: float = Field(
        default=0.1, ge=0.01, le=10, description="An effect that is not renewed ends after this time."
    )
    renew_s: float = Field(default=0.04, ge=0.005, le=5, description="Interval at which effects are started again.")
    max_rate_hz: Annotated[float, Field(ge=10, le=10000)] | None = Field(
        default=None, description="Maximum rate of forces, each in one or more reports; null: that of the link."
    )
    offload: Literal["off", "auto"] = Field(
        default="off",
        description="`auto`: the device plays taps and ruptures if that is more accurate than streaming them.",
    )
    quirks: Annotated[tuple[Quirk, ...], Field(max_length=16, strict=False)] = Field(
        default=(), description="Deviations of this device from the specification."
    )
    report: VendorReport | None = Field(
        default=None, description="Report formats of a device that is not of the PID class; null for a PID device."
    )

    @field_validator("device_version", mode="before")
    @classmethod
    def _bcd(cls, version: object) -> object:
        if isinstance(version, float) and 0 <= version < 100 and round(version, 2) == version:
            major, minor = f"{version:05.2f}".split(".")
            raise ValueError(f"should be an integer, is {shown(version)}; write 0x{major}{minor}")
        return version

    @model_validator(mode="before")
    @classmethod
    def _known_signs(cls, data: Any) -> Any:
        # With the axes configured, a check is not needed.
        if isinstance(data, dict) and "signs" not in data and any(data.get(key) for key in ("force_axes", "report")):
            return {**data, "signs": "trust"}
        return data

    @property
    def names_one(self) -> bool:
        """Whether a key of `device.hid` selects a certain device; otherwise any device is used."""
        return any(key is not None for key in (self.vendor, self.product, self.serial, self.path))

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.renew_s > 0.8 * self.effect_duration_s:
            raise ValueError(
                f"renew_s must be at most 0.8 of effect_duration_s, {0.8 * self.effect_duration_s:g}, "
                f"is {self.renew_s:g}"
            )
        if {"reports_on_change", "reports_steadily"} <= set(self.quirks):
            raise ValueError("quirks: reports_on_change and reports_steadily exclude each other")
        if self.axes.x.usage == self.axes.y.usage:
            raise ValueError(f"axes: x and y must be different axes, both are {self.axes.x.usage}")
        if self.report is not None and (self.axes.x.counts or self.axes.y.counts):
            raise ValueError("axes: counts are not used with report, whose input has counts_per_m and zero_counts")
        return self


class Replay(Model):
    """A recording of a device (`hapticd devices dump`), which is replayed in place of the device."""

    path: Annotated[str, Field(min_length=1, max_length=4096)] = Field(
        description="The recording; a relative path begins in the folder of the YAML file."
    )
    loop: bool = Field(default=False, description="Start again at the recording's end; otherwise the device is lost.")
    speed: float = Field(default=1.0, ge=0.01, le=100, description="Speed of the replay, relative to the recording.")
