"""Configuration of HID devices: `device.hid` and `device.replay`."""

from typing import Annotated, Any, Literal, Self, TypeAlias

from pydantic import AfterValidator, Field, model_validator

from hapticd.base.errors import shown
from hapticd.base.model import Model

Usage: TypeAlias = Literal["X", "Y", "Z", "Rx", "Ry", "Rz"]
Sign: TypeAlias = Literal[1, -1]
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
MAX_REPORTS = 24


def _hex(text: str) -> str:
    try:
        report = bytes.fromhex(text.removeprefix("feature "))
    except ValueError:
        report = b""
    if not 0 < len(report) <= MAX_REPORT_BYTES + 1:
        raise ValueError(f'must be hex digits such as "02 01 00", at most {MAX_REPORT_BYTES + 1} bytes: {shown(text)}')
    return text


HexReport: TypeAlias = Annotated[str, Field(max_length=1024), AfterValidator(_hex)]
"""A report as hex digits, its id first (00 where reports are not numbered); `feature ` before it: a feature report."""


class HandleAxis(Model):
    """Which of the device's axes this is."""

    usage: Usage = Field(description="The axis of the report, by its usage.")
    sign: Sign = Field(default=1, description="-1 where the counts grow to the left, or towards the user.")


class HandleAxes(Model):
    """The axes of the handle."""

    x: HandleAxis = Field(default=HandleAxis(usage="X"), description="To the right.")
    y: HandleAxis = Field(
        default=HandleAxis(usage="Y", sign=-1), description="Away from the user; HID's Y grows towards."
    )


class ForceAxis(Model):
    """What the device makes of a force along this axis of its own."""

    sign: Sign = Field(default=1, description="-1 where the device pushes the other way.")


class ForceAxes(Model):
    """The axes along which the device pushes; found by `hapticd devices calibrate`."""

    x: ForceAxis = Field(default=ForceAxis(), description="The device's first axis, to the right.")
    y: ForceAxis = Field(default=ForceAxis(), description="The device's second axis, away from the user.")
    swap: bool = Field(default=False, description="Whether the device has its two axes the other way round.")


class VendorBits(Model):
    """Where a number lies in a report."""

    bit_offset: int = Field(ge=0, le=8 * MAX_REPORT_BYTES - 1, description="First bit, counted after the report id.")
    bit_size: int = Field(ge=1, le=32, description="Bits of the number.")
    signed: bool = Field(default=True, description="Whether it is a number in two's complement.")
    byte_order: Literal["little", "big"] = Field(
        default="little", description="Order of bytes; `big` needs whole bytes."
    )

    @property
    def end(self) -> int:
        """The first bit after it."""
        return self.bit_offset + self.bit_size

    @model_validator(mode="after")
    def _whole_bytes(self) -> Self:
        if self.byte_order == "big" and (self.bit_offset % 8 or self.bit_size % 8):
            raise ValueError("byte_order big needs whole bytes: bit_offset and bit_size must be multiples of 8")
        if self.end > 8 * MAX_REPORT_BYTES:
            raise ValueError(f"bit {self.end - 1} lies beyond the longest report, {MAX_REPORT_BYTES} bytes")
        return self


Scale: TypeAlias = Annotated[float, Field(ge=-1e9, le=1e9)]


class VendorInputAxis(VendorBits):
    """A position in an input report."""

    counts_per_m: Scale = Field(description="Counts for a metre; negative where they grow the other way.")
    zero_counts: float = Field(default=0.0, ge=-4294967296, le=4294967296, description="Counts in the middle.")

    @model_validator(mode="after")
    def _scaled(self) -> Self:
        if abs(self.counts_per_m) < 1.0:
            raise ValueError(f"counts_per_m must be at least 1 either way, is {self.counts_per_m:g}")
        return self


class VendorOutputAxis(VendorBits):
    """A force in an output report."""

    counts_per_n: Scale = Field(description="Counts for a newton; negative where the device pushes the other way.")
    zero_counts: float = Field(default=0.0, ge=-4294967296, le=4294967296, description="Counts of no force.")

    @model_validator(mode="after")
    def _scaled(self) -> Self:
        if abs(self.counts_per_n) < 1e-3:
            raise ValueError(f"counts_per_n must be at least 0.001 either way, is {self.counts_per_n:g}")
        low = -(1 << (self.bit_size - 1)) if self.signed else 0
        high = (1 << (self.bit_size - self.signed)) - 1
        if not low <= self.zero_counts <= high:
            raise ValueError(
                f"zero_counts {self.zero_counts:g} does not fit into {self.bit_size} bits: {low} to {high}"
            )
        return self


def _apart(x: VendorBits, y: VendorBits) -> None:
    if x.bit_offset < y.end and y.bit_offset < x.end:
        raise ValueError(f"x (bits {x.bit_offset} to {x.end - 1}) and y (bits {y.bit_offset} to {y.end - 1}) overlap")


class VendorInput(Model):
    """The input report that holds positions."""

    report_id: ReportId = Field(default=0, description="Its id; 0 where reports are not numbered.")
    x: VendorInputAxis = Field(description="To the right.")
    y: VendorInputAxis | None = Field(default=None, description="Away from the user; null: there is none.")

    @model_validator(mode="after")
    def _fields_apart(self) -> Self:
        if self.y is not None:
            _apart(self.x, self.y)
        return self


class VendorOutput(Model):
    """The output report that takes forces."""

    report_id: ReportId = Field(default=0, description="Its id; 0 where reports are not numbered.")
    length: int = Field(ge=1, le=MAX_REPORT_BYTES, description="Its bytes, without the id.")
    x: VendorOutputAxis = Field(description="To the right.")
    y: VendorOutputAxis | None = Field(default=None, description="Away from the user; null: there is none.")

    @model_validator(mode="after")
    def _fields_inside(self) -> Self:
        for name, axis in (("x", self.x), ("y", self.y)):
            if axis is not None and axis.end > 8 * self.length:
                raise ValueError(
                    f"{name} ends at bit {axis.end - 1}, a report of {self.length} bytes at bit {8 * self.length - 1}"
                )
        if self.y is not None:
            _apart(self.x, self.y)
        return self


class VendorReport(Model):
    """A device with reports of its own: where position and force stand in them."""

    input: VendorInput = Field(description="Positions.")
    output: VendorOutput = Field(description="Forces.")
    enable: Annotated[tuple[HexReport, ...], Field(max_length=64, strict=False)] = Field(
        default=(),
        description="Reports that switch it on: hex digits, the id first; after `feature `: a feature report.",
    )
    disable: Annotated[tuple[HexReport, ...], Field(max_length=MAX_REPORTS, strict=False)] = Field(
        default=(), description="Output reports that switch it off."
    )
    renew_s: float = Field(
        default=0.04, ge=0.001, le=10, description="Interval at which the force is sent again, changed or not."
    )

    @model_validator(mode="after")
    def _disable_writes(self) -> Self:
        if any(text.startswith("feature") for text in self.disable):
            raise ValueError("disable takes output reports only, no feature reports")
        return self


class Hid(Model):
    """A HID joystick with force feedback."""

    vendor: Annotated[int, Field(ge=0, le=0xFFFF)] | None = Field(
        default=None, description="Its vendor id; null: any. This and the next three choose among several."
    )
    product: Annotated[int, Field(ge=0, le=0xFFFF)] | None = Field(default=None, description="Its product id.")
    serial: Annotated[str, Field(min_length=1, max_length=256)] | None = Field(
        default=None, description="Its serial number."
    )
    path: Annotated[str, Field(min_length=1, max_length=256)] | None = Field(
        default=None, description="Its node, such as /dev/hidraw3."
    )
    travel_m: float = Field(
        default=0.05, ge=0.001, le=10, description="Half the handle's travel: from the middle to the end of its range."
    )
    full_scale_force_n: float = Field(
        default=8.9, ge=0.01, le=100, description="Force of the largest magnitude; device.max_force_n limits commands."
    )
    axes: HandleAxes = Field(default=HandleAxes(), description="Which axis of the report is which.")
    force_axes: ForceAxes = Field(default=ForceAxes(), description="Along which axes the device pushes.")
    signs: Literal["check", "trust"] = Field(
        default="check",
        description="check: before the first force of the scene soft pulses must move the handle the right way; "
        "`trust`: they are left out. By default `trust` where force_axes or report is given.",
    )
    effect_duration_s: float = Field(
        default=0.1, ge=0.01, le=10, description="An effect ends by itself after this time, unless it is renewed."
    )
    renew_s: float = Field(default=0.04, ge=0.005, le=5, description="Interval at which effects are started again.")
    max_rate_hz: Annotated[float, Field(ge=10, le=10000)] | None = Field(
        default=None, description="Most forces per second, however many reports each takes; null: what the link takes."
    )
    offload: Literal["off", "auto"] = Field(
        default="off",
        description="auto: the device plays taps and ruptures, if that is more accurate than to stream them.",
    )
    quirks: Annotated[tuple[Quirk, ...], Field(max_length=16, strict=False)] = Field(
        default=(), description="Deviations of this device from the specification."
    )
    report: VendorReport | None = Field(
        default=None, description="The reports of a device that is not of the PID class; null: it is."
    )

    @model_validator(mode="before")
    @classmethod
    def _known_signs(cls, data: Any) -> Any:
        # Who says along which axes the device pushes is believed.
        if isinstance(data, dict) and "signs" not in data and any(data.get(key) for key in ("force_axes", "report")):
            return {**data, "signs": "trust"}
        return data

    @property
    def names_one(self) -> bool:
        """Whether it names a device rather than taking any."""
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
            raise ValueError(f"axes: x and y must be two axes, both are {self.axes.x.usage}")
        return self


class Replay(Model):
    """A recording of a device (`hapticd devices dump`), played as if it were the device."""

    path: Annotated[str, Field(min_length=1, max_length=4096)] = Field(description="The recording.")
    loop: bool = Field(default=False, description="Begin anew at its end; otherwise the device is gone then.")
    speed: float = Field(default=1.0, ge=0.01, le=100, description="How many times as fast as it was recorded.")
