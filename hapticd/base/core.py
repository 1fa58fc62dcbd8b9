"""The C core as Python sees it: `ffi`, `lib`, its records as numpy dtypes, its enums, and a few helpers.

This module alone imports the compiled extension, but for the one call of memory.py. Layouts and numbers come from the
compiled code, never from a second definition here; that the enums are complete is tested. `csrc/api/hd_api.h` documents
every function and field.
"""

from enum import IntEnum, IntFlag
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from hapticd._core import ffi, lib

if TYPE_CHECKING:
    from hapticd._core import CData, CType
else:
    CData, CType = ffi.CData, ffi.CType

__all__ = [
    "COMMAND_DTYPE",
    "COUNTERS_DTYPE",
    "EVENT_DTYPE",
    "FIELD_DTYPE",
    "HISTOGRAM_EDGES_NS",
    "KICKS",
    "MARKS",
    "MATERIAL_DTYPE",
    "MODE_DTYPE",
    "NOISE_DTYPE",
    "NO_SLOT",
    "OBJECT_DTYPE",
    "PASSIVITY_AGE_MAX",
    "PIECE_DTYPE",
    "PLAY_SLOT",
    "SAMPLE_DTYPE",
    "SIM_FORCES",
    "TABLE_DTYPE",
    "TUNE_NODE",
    "WAVE_PARTS",
    "WAVE_SAMPLES",
    "CData",
    "ClockSource",
    "CommandKind",
    "EventKind",
    "Fault",
    "Flag",
    "HidMeaning",
    "HidQuantity",
    "Interpolation",
    "OverrunAction",
    "PassivityMode",
    "Realtime",
    "Shape",
    "SignsProblem",
    "SignsState",
    "Status",
    "Texture",
    "address",
    "ffi",
    "invalid_reason",
    "lib",
    "pointer",
    "record_dtype",
    "records",
]

_SCALARS: dict[str, np.dtype[Any]] = {
    "double": np.dtype(np.float64),
    "int32_t": np.dtype(np.int32),
    "uint8_t": np.dtype(np.uint8),
    "uint32_t": np.dtype(np.uint32),
    "int64_t": np.dtype(np.int64),
    "uint64_t": np.dtype(np.uint64),
}


def _dtype_of(ctype: CType) -> np.dtype[Any]:
    if ctype.kind == "struct":
        # The size first: that refuses an opaque struct, whose fields must not be asked for (cffi 2.1 aborts).
        size = ffi.sizeof(ctype)
        fields = ctype.fields or []
        return np.dtype(
            {
                "names": [name for name, _ in fields],
                "formats": [_dtype_of(field.type) for _, field in fields],
                "offsets": [field.offset for _, field in fields],
                "itemsize": size,
            }
        )
    if ctype.kind == "array":
        subarray: np.dtype[Any] = np.dtype((_dtype_of(ctype.item), (ctype.length,)))
        return subarray
    if ctype.kind == "pointer":
        return np.dtype(np.uintp)
    return _SCALARS[ctype.cname]


def record_dtype(struct: str) -> np.dtype[np.void]:
    """The numpy dtype of a C struct such as "struct hd_mode": the same names, offsets and size.

    Nested structs are nested dtypes, arrays are subarrays, pointers are addresses (`numpy.uintp`).
    Raises `ffi.error` for an opaque struct or an unknown one.
    """
    return _dtype_of(ffi.typeof(struct))


MODE_DTYPE = record_dtype("struct hd_mode")
MATERIAL_DTYPE = record_dtype("struct hd_material")
NOISE_DTYPE = record_dtype("struct hd_noise")
PIECE_DTYPE = record_dtype("struct hd_piece")
OBJECT_DTYPE = record_dtype("struct hd_object")
FIELD_DTYPE = record_dtype("struct hd_field")
TABLE_DTYPE = record_dtype("struct hd_table")
SAMPLE_DTYPE = record_dtype("struct hd_sample")
EVENT_DTYPE = record_dtype("struct hd_event")
COMMAND_DTYPE = record_dtype("struct hd_command")
COUNTERS_DTYPE = record_dtype("struct hd_counters")

NO_SLOT = lib.HD_NO_SLOT
"""`slot` of an event or a reset that means no object in particular."""
PLAY_SLOT = lib.HD_PLAY_SLOT
"""`slot` of what a `play` command struck."""
PASSIVITY_AGE_MAX: int = lib.HD_PASSIVITY_AGE_MAX
"""The oldest reports that the passivity observer understands, in periods."""
HISTOGRAM_EDGES_NS: tuple[int, ...] = tuple(map(lib.hd_histogram_edge_ns, range(lib.HD_HISTOGRAM_BINS - 1)))
"""Between the bins of lateness and work, the first and the last of which have one each."""
MARKS: int = lib.HD_MARKS
"""So many marks may be under way to the servo and back: their events find room."""
KICKS: int = lib.HD_KICKS
"""So many samples of a strike may be corrected one by one."""
TUNE_NODE: int = lib.HD_TUNE_NODE
"""So many numbers say what compensation makes of a frequency: enum hd_tune_number in csrc/tick/hd_tune.h."""
WAVE_SAMPLES: int = lib.HD_WAVE_SAMPLES
"""The most samples of a tap's waveform."""
WAVE_PARTS: int = lib.HD_WAVE_PARTS
"""So many parts of a waveform have a peak of their own: csrc/tick/hd_waveform.h."""
SIM_FORCES: int = lib.HD_SIM_FORCES
"""So many frames a force may be under way to the simulated joystick."""


class Status(IntEnum):
    """What a C function returns: enum hd_status."""

    OK = lib.HD_OK
    ERR_INVALID = lib.HD_ERR_INVALID
    ERR_FULL = lib.HD_ERR_FULL
    ERR_MEMORY = lib.HD_ERR_MEMORY
    ERR_SYSTEM = lib.HD_ERR_SYSTEM
    ERR_TIMEOUT = lib.HD_ERR_TIMEOUT
    ERR_DENIED = lib.HD_ERR_DENIED


class Texture(IntEnum):
    """How a texture is displayed: enum hd_texture."""

    NONE = lib.HD_TEXTURE_NONE
    STRIKES = lib.HD_TEXTURE_STRIKES
    GEOMETRY = lib.HD_TEXTURE_GEOMETRY
    DRAG = lib.HD_TEXTURE_DRAG
    NOISE = lib.HD_TEXTURE_NOISE


class Shape(IntEnum):
    """What is in a slot: enum hd_shape."""

    NONE = lib.HD_SHAPE_NONE
    WALL = lib.HD_SHAPE_WALL
    MEMBRANE = lib.HD_SHAPE_MEMBRANE
    BOX = lib.HD_SHAPE_BOX
    DISC = lib.HD_SHAPE_DISC


class PassivityMode(IntEnum):
    """Whether the energy that objects give to the hand is watched: enum hd_passivity_mode."""

    OFF = lib.HD_PASSIVITY_OFF
    OBSERVE = lib.HD_PASSIVITY_OBSERVE
    CONTROL = lib.HD_PASSIVITY_CONTROL


class Flag(IntFlag):
    """Bits of a sample's `flags`: enum hd_flag."""

    SKIPPED = lib.HD_FLAG_SKIPPED
    CONTACT = lib.HD_FLAG_CONTACT
    RINGING = lib.HD_FLAG_RINGING
    SATURATED = lib.HD_FLAG_SATURATED
    RAMPING = lib.HD_FLAG_RAMPING
    FORCES_ON = lib.HD_FLAG_FORCES_ON
    FAULT = lib.HD_FLAG_FAULT
    GLITCH = lib.HD_FLAG_GLITCH
    REPEATED = lib.HD_FLAG_REPEATED
    RESTRAINED = lib.HD_FLAG_RESTRAINED
    CHECKING = lib.HD_FLAG_CHECKING


class EventKind(IntEnum):
    """`kind` of an event: enum hd_event_kind."""

    CONTACT = lib.HD_EVENT_CONTACT
    RELEASE = lib.HD_EVENT_RELEASE
    PUNCTURE = lib.HD_EVENT_PUNCTURE
    SATURATION = lib.HD_EVENT_SATURATION
    OVERRUN = lib.HD_EVENT_OVERRUN
    FAULT = lib.HD_EVENT_FAULT
    REVISION = lib.HD_EVENT_REVISION
    GLITCH = lib.HD_EVENT_GLITCH
    DEVICE_LOST = lib.HD_EVENT_DEVICE_LOST
    DEVICE_FOUND = lib.HD_EVENT_DEVICE_FOUND
    GROOVE = lib.HD_EVENT_GROOVE
    OVERLOAD = lib.HD_EVENT_OVERLOAD
    RATE = lib.HD_EVENT_RATE
    RESUMED = lib.HD_EVENT_RESUMED
    MEMORY_REFUSED = lib.HD_EVENT_MEMORY_REFUSED
    MARK = lib.HD_EVENT_MARK
    GESTURE_END = lib.HD_EVENT_GESTURE_END


class Fault(IntFlag):
    """Bits of latched faults: enum hd_fault."""

    NONFINITE = lib.HD_FAULT_NONFINITE
    CONTROL = lib.HD_FAULT_CONTROL
    LEASE = lib.HD_FAULT_LEASE
    DEVICE = lib.HD_FAULT_DEVICE
    OVERRUN = lib.HD_FAULT_OVERRUN
    FROZEN = lib.HD_FAULT_FROZEN
    SIGNS = lib.HD_FAULT_SIGNS


class OverrunAction(IntEnum):
    """What becomes of an overload, beside its event: enum hd_overrun_action."""

    WARN = lib.HD_OVERRUN_WARN
    FAULT = lib.HD_OVERRUN_FAULT
    STEP_DOWN = lib.HD_OVERRUN_STEP_DOWN


class Interpolation(IntEnum):
    """Between an operator's waypoints: enum hd_interpolation."""

    LINEAR = lib.HD_LINEAR
    MINIMUM_JERK = lib.HD_MINIMUM_JERK


class Realtime(IntEnum):
    """How much real-time rights are wanted: enum hd_realtime."""

    OFF = lib.HD_REALTIME_OFF
    PREFERRED = lib.HD_REALTIME_PREFERRED
    REQUIRED = lib.HD_REALTIME_REQUIRED


class ClockSource(IntEnum):
    """What says that a tick is due: enum hd_clock_source."""

    TIMER = lib.HD_CLOCK_TIMER
    DEVICE = lib.HD_CLOCK_DEVICE


class HidQuantity(IntEnum):
    """What a number in an output report says of the force: enum hd_hid_quantity."""

    X = lib.HD_HID_X
    Y = lib.HD_HID_Y
    MAGNITUDE = lib.HD_HID_MAGNITUDE
    DIRECTION = lib.HD_HID_DIRECTION


class HidMeaning(IntEnum):
    """What a number in an input report says of the device: enum hd_hid_meaning."""

    RESET = lib.HD_HID_RESET
    ACTUATORS = lib.HD_HID_ACTUATORS
    PAUSED = lib.HD_HID_PAUSED
    SAFETY = lib.HD_HID_SAFETY
    POWER = lib.HD_HID_POWER


class SignsState(IntEnum):
    """How far the check is: enum hd_signs_state."""

    UNCHECKED = lib.HD_SIGNS_UNCHECKED
    TRUSTED = lib.HD_SIGNS_TRUSTED
    CHECKING = lib.HD_SIGNS_CHECKING
    WAITING = lib.HD_SIGNS_WAITING
    RIGHT = lib.HD_SIGNS_RIGHT
    WRONG = lib.HD_SIGNS_WRONG
    UNCLEAR = lib.HD_SIGNS_UNCLEAR


class SignsProblem(IntEnum):
    """What it met: enum hd_signs_problem."""

    FINE = lib.HD_SIGNS_FINE
    REVERSED = lib.HD_SIGNS_REVERSED
    SWAPPED = lib.HD_SIGNS_SWAPPED
    STILL = lib.HD_SIGNS_STILL
    UNCERTAIN = lib.HD_SIGNS_UNCERTAIN
    MOVING = lib.HD_SIGNS_MOVING
    CONTACT = lib.HD_SIGNS_CONTACT


class CommandKind(IntEnum):
    """`kind` of a command to the servo: enum hd_command_kind."""

    PLAY = lib.HD_COMMAND_PLAY
    RESET = lib.HD_COMMAND_RESET
    FORCES = lib.HD_COMMAND_FORCES
    OPERATOR = lib.HD_COMMAND_OPERATOR
    MARK = lib.HD_COMMAND_MARK


def records(dtype: np.dtype[np.void], count: int) -> npt.NDArray[np.void]:
    """`count` zeroed records of one of the dtypes above, shape (count,), which C can use in place."""
    return np.zeros(count, dtype)


def pointer(ctype: str, array: npt.NDArray[np.generic]) -> CData:
    """The memory of an array as a C array such as "struct hd_object[]" or "double[]"; it keeps the array alive.

    Raises ValueError if the array is not C-contiguous or its size is no multiple of the C item's.
    """
    if not array.flags.c_contiguous:
        raise ValueError("an array for C must be C-contiguous")
    item = ffi.sizeof(ffi.typeof(ctype).item)
    if array.nbytes % item:
        raise ValueError(f"{array.nbytes} bytes are no whole number of {ctype} items of {item} bytes")
    return ffi.from_buffer(ctype, array)


def address(array: npt.NDArray[np.generic]) -> int:
    """Where an array lies, for a pointer field of TABLE_DTYPE; the caller keeps the array alive.

    Raises ValueError if the array is not C-contiguous.
    """
    if not array.flags.c_contiguous:
        raise ValueError("an array for C must be C-contiguous")
    return int(array.ctypes.data)


def invalid_reason() -> str:
    """Why the last check on this thread failed, as one line."""
    return ffi.string(lib.hd_invalid_reason()).decode()
