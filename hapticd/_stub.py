"""Makes hapticd/_core.pyi, the types of the compiled extension for mypy and editors, from the headers of csrc/api/.

_build.py runs this module, the package never imports it; git ignores the stub. The headers hold only declarations and
numbers, so a few regular expressions can read them; tests/project/test_core_layout.py compares the stub with the
compiled library.
"""

import keyword
import os
import re

_STUB_HEAD = '''"""Types of the compiled extension: written by hapticd/_stub.py from csrc/api/. Do not edit."""

from collections.abc import Callable, Iterator
from enum import IntEnum, IntFlag
from typing import Any, final

@final
class CType:
    kind: str
    cname: str
    item: CType
    length: int
    fields: list[tuple[str, CField]] | None
    args: tuple[CType, ...]
    result: CType
    elements: dict[int, str]
    relements: dict[str, int]

@final
class CField:
    type: CType
    offset: int

@final
class CData:
    def __getattr__(self, name: str) -> Any: ...
    def __setattr__(self, name: str, value: Any) -> None: ...
    def __getitem__(self, index: int | slice) -> Any: ...
    def __setitem__(self, index: int | slice, value: Any) -> None: ...
    def __len__(self) -> int: ...
    def __iter__(self) -> Iterator[Any]: ...
    def __bool__(self) -> bool: ...
    def __int__(self) -> int: ...
    def __add__(self, offset: int) -> CData: ...
    def __enter__(self) -> CData: ...
    def __exit__(self, *exc: object) -> None: ...

class FFI:
    NULL: CData
    errno: int
    def new(self, cdecl: str, init: Any = ...) -> CData: ...
    def cast(self, cdecl: str, source: CData | int | float) -> CData: ...
    def typeof(self, cdecl: str | CData | Callable[..., Any]) -> CType: ...
    def sizeof(self, cdecl: str | CType | CData) -> int: ...
    def offsetof(self, cdecl: str | CType, *fields_or_indexes: str | int) -> int: ...
    def addressof(self, cdata: CData, *fields_or_indexes: str | int) -> CData: ...
    def string(self, cdata: CData, maxlen: int = ...) -> bytes: ...
    def unpack(self, cdata: CData, length: int) -> Any: ...
    def buffer(self, cdata: CData, size: int = ...) -> memoryview: ...
    def from_buffer(self, cdecl: str, python_buffer: Any, require_writable: bool = ...) -> CData: ...
    def memmove(self, dest: Any, src: Any, n: int) -> None: ...
    def gc(self, cdata: CData, destructor: Callable[[CData], Any] | None, size: int = ...) -> CData: ...
    def release(self, cdata: CData) -> None: ...
'''


def stub_of(header: str) -> str:
    """Return the text of the stub: cffi's types, the enums of the header, and the functions and numbers of `lib`."""
    code = re.sub(r"/\*.*?\*/", "", header, flags=re.DOTALL)
    enums, library = "", "\nclass Lib:\n"
    for name in re.findall(r"^#define (HD_\w+) \d+", code, re.MULTILINE):
        library += f"    {name}: int\n"
    for name, body in re.findall(r"^enum hd_(\w+) {(.*?)};", code, re.DOTALL | re.MULTILINE):
        numbers = re.findall(r"(HD_\w+) = (-?\d+)", body)
        library += "".join(f"    {one}: int\n" for one, _ in numbers)
        shared = os.path.commonprefix([one for one, _ in numbers]).rpartition("_")[0] + "_"  # noqa: RUF071
        # Enumerators 1, 2, 4, ... are bits: the rule of base/core.py.
        base = "IntFlag" if [number for _, number in numbers[:3]] == ["1", "2", "4"] else "IntEnum"
        enums += f"\nclass {name.title().replace('_', '')}({base}):\n"
        enums += "".join(f"    {one.removeprefix(shared)} = {number}\n" for one, number in numbers)
    for result, name, parameters in re.findall(r"^([a-z][\w ]*[ *])(hd_\w+)\(([^)]*)\);", code, re.MULTILINE):
        named = ["self", *(_parameter(one) for one in parameters.split(",") if one != "void"), "/"]
        library += f"    def {name}({', '.join(named)}) -> {_type(result)}: ...\n"
    return f"{_STUB_HEAD}{enums}{library}\nffi: FFI\nlib: Lib\n"


def _parameter(declaration: str) -> str:
    name = re.findall(r"\w+", declaration.partition("[")[0])[-1]
    return f"{name}{'_' * keyword.iskeyword(name)}: {_type(declaration)}"


def _type(declaration: str) -> str:
    if "*" in declaration or "[" in declaration:
        return "CData"
    first = declaration.split()[0]
    return {"void": "None", "double": "float"}.get(first, "int")
