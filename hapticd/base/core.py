"""The C core as Python sees it: `ffi`, `lib`, its records as numpy dtypes, its enums, and a few helpers.

Only this module imports the compiled extension, except for one call in memory.py. Layouts, enums and constants come
from the compiled code, never from a second definition here. `csrc/api/hd_api.h` documents every function and field.
"""

import os
import re
from enum import IntEnum, IntFlag
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from hapticd._core import ffi as ffi
from hapticd._core import lib as lib

if TYPE_CHECKING:
    from hapticd._core import *  # noqa: F403
    from hapticd._core import CData, CType
else:
    CData, CType = ffi.CData, ffi.CType

_DTYPE_OF_C_TYPE: dict[str, np.dtype[Any]] = {
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
    return _DTYPE_OF_C_TYPE[ctype.cname]


def record_dtype(struct: str) -> np.dtype[np.void]:
    """Return the numpy dtype of a C struct such as "struct hd_mode": the same names, offsets and size.

    Nested structs are nested dtypes, arrays are subarrays, pointers are addresses (`numpy.uintp`). Raises `ffi.error`
    for an opaque or unknown struct.
    """
    return _dtype_of(ffi.typeof(struct))


MODE_DTYPE = record_dtype("struct hd_mode")
MATERIAL_DTYPE = record_dtype("struct hd_material")
NOISE_DTYPE = record_dtype("struct hd_noise")
PIECE_DTYPE = record_dtype("struct hd_piece")
OBJECT_DTYPE = record_dtype("struct hd_object")
SAMPLE_DTYPE = record_dtype("struct hd_sample")
EVENT_DTYPE = record_dtype("struct hd_event")

NO_SLOT = lib.HD_NO_SLOT
"""Value of `slot` (index of an object) in an event or a reset that concerns no single object."""
PLAY_SLOT = lib.HD_PLAY_SLOT
"""Value of `slot` (index of an object) for ringing modes that a `play` command started."""
MAX_AGE_PERIODS: int = lib.HD_PASSIVITY_AGE_MAX
"""Largest age of a position that the passivity observer accepts, in periods."""
HISTOGRAM_EDGES_NS: tuple[int, ...] = tuple(map(lib.hd_histogram_edge_ns, range(lib.HD_HISTOGRAM_BINS - 1)))
"""Edges between the bins of the histograms of lateness and work, in ns. The first and the last bin have one edge."""
MAX_PENDING_MARKS: int = lib.HD_MARKS
"""Maximum number of marks that may wait for the servo: the ring of events has room for them."""
MAX_CORRECTED_SAMPLES: int = lib.HD_KICKS
"""Number of ticks from the beginning of a strike in which compensation can correct the force."""
TUNE_NODE_NUMBERS: int = lib.HD_TUNE_NODE
"""Count of values that describe compensation at one frequency: enum hd_tune_number, csrc/scene/hd_table_numbers.h."""
KEPT_TAP_GAINS: int = lib.HD_KEPT_GAINS
"""Count of values for the gains of one mode of a compensated tap: enum hd_kept_number, as above."""
MAX_WAVEFORM_SAMPLES: int = lib.HD_WAVE_SAMPLES
WAVEFORM_PARTS: int = lib.HD_WAVE_PARTS
"""Number of equal parts of a waveform; the table holds the largest magnitude after the start of each part."""
MAX_FORCE_DELAY_FRAMES: int = lib.HD_SIM_FORCES
"""Largest delay of forces to the simulated joystick, in intervals of the simulated link."""


# Enums are named after those of C: enum hd_event_kind is EventKind, and HD_EVENT_CONTACT is EventKind.CONTACT.
_DOC_OF_ENUM = {
    "Status": "Return value of a C function.",
    "Texture": "How a texture is displayed.",
    "Shape": "Kind of the object in a slot.",
    "PassivityMode": "Whether the energy that objects give to the hand is observed, or limited too.",
    "Flag": "Bits of a sample's `flags`.",
    "EventKind": "`kind` of an event.",
    "Fault": "Bits of latched faults.",
    "OverrunAction": "Reaction to an overload, in addition to its event.",
    "Interpolation": "Interpolation between an operator's waypoints.",
    "Realtime": "Whether real-time rights are required, tried or not used.",
    "ClockSource": "Source of the signal that a tick is due.",
    "HidQuantity": "Quantity of a number in an output report.",
    "HidMeaning": "Quantity of a number in an input report.",
    "SignsState": "State of the check of the force's signs.",
    "SignsProblem": "Problem that the check of the force's signs found.",
    "CommandKind": "`kind` of a command to the servo.",
    "StreamKind": "Quantity that is streamed: targets of the simulated hand, or forces.",
}


def _enum(name: str, doc: str) -> Any:
    numbers = ffi.typeof("enum hd" + re.sub("([A-Z])", r"_\1", name).lower()).relements
    shared = os.path.commonprefix(list(numbers)).rpartition("_")[0] + "_"  # noqa: RUF071
    in_order = sorted(numbers.items(), key=lambda item: abs(item[1]))
    # Enumerators 1, 2, 4, ... are bits.
    kind: Any = IntFlag if [number for _, number in in_order[:3]] == [1, 2, 4] else IntEnum
    made = kind(name, {one.removeprefix(shared): number for one, number in in_order}, module=__name__)
    made.__doc__ = doc
    return made


if not TYPE_CHECKING:
    globals().update({name: _enum(name, doc) for name, doc in _DOC_OF_ENUM.items()})


def records(dtype: np.dtype[np.void], count: int) -> npt.NDArray[np.void]:
    """Return `count` zeroed records of a `record_dtype`, shape (count,), which C can use in place."""
    return np.zeros(count, dtype)


def pointer(ctype: str, array: npt.NDArray[np.generic]) -> CData:
    """Return the memory of an array as a C array, for example "double[]"; the returned pointer keeps the array alive.

    Raises ValueError if the array is not C-contiguous, or its size is not a multiple of the C item's.
    """
    if not array.flags.c_contiguous:
        raise ValueError("an array for C must be C-contiguous")
    item = ffi.sizeof(ffi.typeof(ctype).item)
    if array.nbytes % item:
        raise ValueError(f"{array.nbytes} bytes are not a multiple of the {item} bytes of an item of {ctype}")
    return ffi.from_buffer(ctype, array)


def invalid_reason() -> str:
    """Return why the last check of the C core on this thread failed, as one line."""
    return ffi.string(lib.hd_invalid_reason()).decode()
