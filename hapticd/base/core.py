"""The C core as Python sees it: `ffi`, `lib`, its records as numpy dtypes, its enums, and a few helpers.

This module alone imports the compiled extension, but for the one call of memory.py. Layouts, enums and numbers come
from the compiled code, never from a second definition here; mypy knows them from hapticd/_core.pyi, which the build
makes from the same header. `csrc/api/hd_api.h` documents every function and field.
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
SAMPLE_DTYPE = record_dtype("struct hd_sample")
EVENT_DTYPE = record_dtype("struct hd_event")

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
"""So many numbers say what compensation makes of a frequency: enum hd_tune_number in csrc/scene/hd_table_numbers.h."""
WAVE_SAMPLES: int = lib.HD_WAVE_SAMPLES
"""The most samples of a tap's waveform."""
WAVE_PARTS: int = lib.HD_WAVE_PARTS
"""So many parts of a waveform have a peak of their own: csrc/tick/hd_waveform.h."""
SIM_FORCES: int = lib.HD_SIM_FORCES
"""So many frames a force may be under way to the simulated joystick."""


# enum hd_event_kind is EventKind, HD_EVENT_CONTACT its CONTACT: what all names of an enum begin with is left out.
_ENUMS = {
    "Status": "What a C function returns.",
    "Texture": "How a texture is displayed.",
    "Shape": "What is in a slot.",
    "PassivityMode": "Whether the energy that objects give to the hand is watched.",
    "Flag": "Bits of a sample's `flags`.",
    "EventKind": "`kind` of an event.",
    "Fault": "Bits of latched faults.",
    "OverrunAction": "What becomes of an overload, beside its event.",
    "Interpolation": "Between an operator's waypoints.",
    "Realtime": "How much real-time rights are wanted.",
    "ClockSource": "What says that a tick is due.",
    "HidQuantity": "What a number in an output report says of the force.",
    "HidMeaning": "What a number in an input report says of the device.",
    "SignsState": "How far the check of signs is.",
    "SignsProblem": "What the check of signs met.",
    "CommandKind": "`kind` of a command to the servo.",
    "StreamKind": "What is streamed: targets of the simulated hand, or forces.",
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
    globals().update({name: _enum(name, doc) for name, doc in _ENUMS.items()})


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


def invalid_reason() -> str:
    """Why the last check on this thread failed, as one line."""
    return ffi.string(lib.hd_invalid_reason()).decode()
