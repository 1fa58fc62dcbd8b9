"""The boundary of C and Python: records, enums and the type stub agree with the compiled core, completely."""

import ast
import enum
import re
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from hapticd import _version
from hapticd.base import core
from hapticd.base.core import ffi, lib

ROOT = Path(__file__).resolve().parents[2]
API = "".join(path.read_text(encoding="utf-8") for path in sorted((ROOT / "csrc" / "api").glob("hd_api*.h")))
RECORDS = {
    "struct hd_mode": core.MODE_DTYPE,
    "struct hd_material": core.MATERIAL_DTYPE,
    "struct hd_noise": core.NOISE_DTYPE,
    "struct hd_piece": core.PIECE_DTYPE,
    "struct hd_object": core.OBJECT_DTYPE,
    "struct hd_field": core.record_dtype("struct hd_field"),
    "struct hd_table": core.record_dtype("struct hd_table"),
    "struct hd_sample": core.SAMPLE_DTYPE,
    "struct hd_event": core.EVENT_DTYPE,
    "struct hd_command": core.record_dtype("struct hd_command"),
    "struct hd_counters": core.record_dtype("struct hd_counters"),
}


@pytest.mark.parametrize("name", RECORDS)
def test_a_dtype_has_the_compilers_size_and_offsets(name: str) -> None:
    dtype = RECORDS[name]
    assert dtype.itemsize == ffi.sizeof(name)
    assert dtype.fields is not None
    for field in dtype.names or ():
        assert dtype.fields[field][1] == ffi.offsetof(name, field)


@pytest.mark.parametrize("name", RECORDS)
def test_every_double_that_c_writes_is_found_under_its_name(name: str) -> None:
    """C writes a different number into each member, and numpy reads the same numbers."""
    array = core.records(RECORDS[name], 2)
    c_record = core.pointer(f"{name}[]", array)[1]
    count = 0

    def walk(struct: core.CData, record: np.void) -> None:
        nonlocal count
        for field, member in ffi.typeof(struct).fields or ():
            if member.type.kind == "struct":
                walk(getattr(struct, field), record[field])
            elif member.type.cname == "double":
                count += 1
                setattr(struct, field, count + 0.5)
                assert record[field] == count + 0.5
            elif member.type.kind == "array":
                for index in range(member.type.length):
                    count += 1
                    getattr(struct, field)[index] = count + 0.25
                    assert record[field][index] == count + 0.25
            elif member.type.kind == "primitive":
                count += 1
                setattr(struct, field, count)
                assert record[field] == count

    walk(c_record, array[1])
    assert count >= 4
    assert not array[0].tobytes().strip(b"\0")


def test_the_telemetry_record_is_as_documented() -> None:
    expected = [
        ("tick", "<u8"),
        ("time_ns", "<i8"),
        ("position_m", "<f8", (2,)),
        ("velocity_m_per_s", "<f8", (2,)),
        ("contact_force_n", "<f8", (2,)),
        ("vibration_force_n", "<f8", (2,)),
        ("force_n", "<f8", (2,)),
        ("revision", "<u4"),
        ("flags", "<u4"),
        ("lateness_ns", "<i4"),
        ("work_ns", "<i4"),
    ]
    assert np.dtype(expected) == core.SAMPLE_DTYPE


def test_an_opaque_or_unknown_struct_has_no_dtype() -> None:
    with pytest.raises(ffi.error, match="hd_state"):
        core.record_dtype("struct hd_state")
    with pytest.raises(ffi.error, match="hd_nothing"):
        core.record_dtype("struct hd_nothing")


def test_only_whole_contiguous_items_become_c_arrays() -> None:
    positions = np.zeros((4, 2))
    assert len(core.pointer("double[]", positions)) == 8
    assert len(core.pointer("double[]", positions[:0])) == 0
    with pytest.raises(ValueError, match="contiguous"):
        core.pointer("double[]", positions[:, 0])
    with pytest.raises(ValueError, match="9 bytes"):
        core.pointer("double[]", np.zeros(9, np.uint8))


@pytest.mark.parametrize("name", re.findall(r"^enum (hd_\w+) \{", API, re.MULTILINE))
def test_an_enum_of_the_header_has_a_python_twin_that_is_complete(name: str) -> None:
    twin = getattr(core, name.removeprefix("hd_").title().replace("_", ""))
    elements = ffi.typeof(f"enum {name}").relements
    assert issubclass(twin, enum.IntEnum | enum.IntFlag) and twin.__doc__
    assert sorted(int(member) for member in twin) == sorted(elements.values())
    for element, number in elements.items():
        member = next(member for member in twin if element.endswith("_" + str(member.name)))
        assert int(member) == number


def test_bits_are_flags_and_everything_else_is_not() -> None:
    twins = [one for one in vars(core).values() if isinstance(one, enum.EnumType) and one.__module__ == core.__name__]
    assert {one for one in twins if issubclass(one, enum.IntFlag)} == {core.Flag, core.Fault}
    assert len(twins) == len(re.findall(r"^enum hd_\w+ \{", API, re.MULTILINE))


def _stub_type(ctype: "core.CType") -> str:
    if ctype.kind == "void":
        return "None"
    if ctype.kind in ("primitive", "enum"):
        return "float" if ctype.cname == "double" else "int"
    return "CData"


def test_the_type_stub_says_what_the_library_has() -> None:
    tree = ast.parse((ROOT / "hapticd" / "_core.pyi").read_text(encoding="utf-8"))
    body = next(node.body for node in tree.body if isinstance(node, ast.ClassDef) and node.name == "Lib")
    stub: dict[str, tuple[str, ...]] = {}
    for node in body:
        if isinstance(node, ast.FunctionDef):
            parameters = [ast.unparse(argument.annotation or node) for argument in node.args.posonlyargs[1:]]
            stub[node.name] = (*parameters, ast.unparse(node.returns or node))
        elif isinstance(node, ast.AnnAssign):
            stub[ast.unparse(node.target)] = (ast.unparse(node.annotation),)
    compiled: dict[str, tuple[str, ...]] = {}
    for name in dir(lib):
        member = getattr(lib, name)
        if isinstance(member, int):
            compiled[name] = ("int",)
        else:
            ctype = ffi.typeof(member)
            compiled[name] = (*map(_stub_type, ctype.args), _stub_type(ctype.result))
    assert stub == compiled


def test_the_type_stub_says_what_the_enums_have() -> None:
    tree = ast.parse((ROOT / "hapticd" / "_core.pyi").read_text(encoding="utf-8"))
    stub = {
        node.name: (ast.unparse(node.bases[0]), ast.unparse(node.body).splitlines())
        for node in tree.body
        if isinstance(node, ast.ClassDef) and node.bases
    }
    assert stub == {
        name: (twin.__base__.__name__, [f"{member.name} = {int(member)}" for member in twin])
        for name, twin in vars(core).items()
        if isinstance(twin, enum.EnumType) and twin.__module__ == core.__name__
    }


def test_only_core_imports_the_extension() -> None:
    """The exception is what a process without numpy needs (docs/adr/0022)."""
    importers = {
        path.name
        for path in (ROOT / "hapticd").rglob("*.py")
        if re.search(
            r"^\s*(from hapticd\._core |import hapticd\._core|from hapticd import .*\b_core\b)",
            path.read_text(encoding="utf-8"),
            re.M,
        )
    }
    assert importers == {"core.py", "memory.py"}


def test_the_shipped_configuration_is_part_of_the_package() -> None:
    shipped = resources.files("hapticd") / "shipped"
    assert "wood:" in (shipped / "materials" / "okamura1998.yaml").read_text(encoding="utf-8")


def test_the_changelog_knows_this_version() -> None:
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    latest = re.search(r"^## \[([^]]+)\]", changelog, re.M)
    assert latest is not None
    assert latest[1] == _version.__version__
