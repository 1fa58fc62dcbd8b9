"""The documentation against the code: names, limits and files are compared, examples are run."""

from __future__ import annotations

import ast
import re
import textwrap
from pathlib import Path
from typing import Any, TypeGuard, get_args

import msgpack
import numpy as np
import pytest
from pydantic import BaseModel

from bench.summary import with_summary
from docs import tables as docs_tables
from hapticd.base.core import EVENT_DTYPE, SAMPLE_DTYPE, EventKind, Fault, Flag, records
from hapticd.base.yaml_source import load_text
from hapticd.config.configuration import default_config, load_config
from hapticd.config.hid import Hid, Quirk
from hapticd.config.materials import ModeKeys
from hapticd.config.operator import OperatorParams, PunctureGesture, StrokeGesture, TapGesture
from hapticd.daemon.counters import Granted
from hapticd.daemon.described.words import CODE_DESCRIPTIONS
from hapticd.daemon.engine import Engine
from hapticd.daemon.methods import _METHOD_HANDLERS, Methods
from hapticd.doctor import diagnose
from hapticd.doctor.machine import Machine, Needs
from hapticd.protocol import messages
from hapticd.protocol.events import event_map, fault_names
from hapticd.protocol.messages import Code
from hapticd.protocol.results import State
from hapticd.recording.event_columns import NO_TIME
from hapticd.recording.simulated import simulate_files
from hapticd.recording.writer import RecordingWriter
from hapticd.system import service_files
from hapticd.system.service_files import Installation

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]
README = (ROOT / "README.md").read_text()
PROTOCOL = (ROOT / "docs" / "protocol.md").read_text()
TELEMETRY = (ROOT / "docs" / "reference" / "telemetry.md").read_text()
GESTURES = (ROOT / "docs" / "reference" / "gestures.md").read_text()
EVENTS = (ROOT / "docs" / "reference" / "events.md").read_text()
STATUS = (ROOT / "docs" / "reference" / "status.md").read_text()
RECORDINGS = (ROOT / "docs" / "reference" / "recordings.md").read_text()
LANGUAGES = (ROOT / "docs" / "howto" / "other_languages.md").read_text()
DEVICES = (ROOT / "docs" / "devices.md").read_text()
SERVICE = (ROOT / "docs" / "service.md").read_text()
ARCHITECTURE = (ROOT / "docs" / "architecture.md").read_text()

Rows = list[list[str]]


def section(text: str, heading: str) -> str:
    """Return the text below a heading, up to the next heading of the same or a higher level."""
    level = len(heading) - len(heading.lstrip("#"))
    _, found, rest = text.partition(f"\n{heading}\n")
    assert found, heading
    return re.split(rf"^#{{1,{level}}} ", rest, maxsplit=1, flags=re.MULTILINE)[0]


def tables(text: str) -> dict[str, Rows]:
    """Return every table by its first heading cell, as rows of stripped cells without heading and rule."""
    found: dict[str, Rows] = {}
    for block in re.findall(r"(?:^\|.*\n)+", text, flags=re.MULTILINE):
        rows = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in block.splitlines()]
        rows = [[cell.strip("| ") for cell in row] for row in rows]
        found[rows[0][0]] = rows[2:]
    return found


def names(cell: str) -> list[str]:
    """Return the texts in backticks."""
    return re.findall(r"`([^`]+)`", cell)


def without_links(text: str) -> str:
    """Return a text with its links replaced by their texts, as the code has it."""
    return re.sub(r"\[([^]]+)\]\([^)]+\)", r"\1", text)


def first_names(rows: Rows) -> list[str]:
    return [name for row in rows for name in names(row[0])]


def blocks(text: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", text, flags=re.MULTILINE | re.DOTALL)


# ---- Tables that repeat code ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", docs_tables.PAGES)
def test_tables_are_those_of_the_code(name: str) -> None:
    """If this test fails, `make docs-tables` writes the tables again."""
    page = (ROOT / "docs" / name).read_text()
    assert docs_tables.PAGES[name](page) == page


def test_the_summary_of_the_errors_is_that_of_the_tables_below_it() -> None:
    page = (ROOT / "docs" / "accuracy.md").read_text()
    assert with_summary(page) == page


# ---- protocol.md ---------------------------------------------------------------------------------------------------


def test_every_method_is_documented() -> None:
    documented = re.findall(r"^### (\w+)$", section(PROTOCOL, "## Methods"), flags=re.MULTILINE)
    assert documented == list(_METHOD_HANDLERS)


@pytest.mark.parametrize("method", _METHOD_HANDLERS)
def test_parameters(method: str) -> None:
    model: type[BaseModel] = _METHOD_HANDLERS[method][0] or OperatorParams
    rows = tables(section(PROTOCOL, f"### {method}")).get("parameter", [])
    assert {name for name in first_names(rows) if name != "id"} == set(model.model_fields)
    for row in rows:
        (name,) = names(row[0])
        optional = not model.model_fields[name].is_required()
        assert row[0].startswith("[") == optional, name
        if not row[2].startswith("as in `"):
            assert model.model_fields[name].description == without_links(row[2]), name


def test_the_keys_of_a_mode() -> None:
    (row,) = [row for row in tables(section(PROTOCOL, "### play"))["parameter"] if "`mode`" in row[0]]
    assert set(names(row[2])) == set(ModeKeys.model_fields)


@pytest.mark.parametrize("model", [TapGesture, StrokeGesture, PunctureGesture])
def test_gestures(model: type[BaseModel]) -> None:
    documented: dict[str, dict[str, bool]] = {}
    for row in tables(GESTURES)["gesture"]:
        if names(row[0]):
            (kind,) = names(row[0])
            documented[kind] = {}
        for name in names(row[1]):
            documented[kind][name] = row[1].startswith("[")
    (kind,) = [kind for kind in documented if kind == model.__name__.removesuffix("Gesture").lower()]
    assert documented[kind] == {name: not field.is_required() for name, field in model.model_fields.items()}


def test_error_codes() -> None:
    rows = tables(section(PROTOCOL, "## Errors"))["code"]
    assert {
        Code(int(row[0])): (row[2], row[3]) for row in ([without_links(cell) for cell in row] for row in rows)
    } == CODE_DESCRIPTIONS
    assert {(int(row[0]), *names(row[1])) for row in rows} == {(int(code), code.name) for code in messages.Code}


def test_status() -> None:
    engine = Engine(default_config())
    status = Methods(engine).status()
    assert first_names(tables(STATUS)["member"]) == list(status)
    assert first_names(tables(STATUS)["counter"]) == list(status["counters"])  # type: ignore[call-overload]
    (realtime,) = re.findall(r"^`realtime` has (.*?)$\n\n", STATUS, flags=re.MULTILINE | re.DOTALL)
    granted = Granted("fifo", 80, None, "process", True, ())
    assert set(granted.to_dict()) <= set(names(realtime))


def test_samples() -> None:
    described = tables(section(TELEMETRY, "## samples"))
    formats = {"f8[2]": ("<f8", (2,)), **{form: (f"<{form}", ()) for form in ("u8", "i8", "u4", "i4")}}
    documented = [(*names(row[0]), *formats[row[1]]) for row in described["field"]]
    fields = [(name, SAMPLE_DTYPE[name]) for name in SAMPLE_DTYPE.names or ()]
    assert documented == [(name, dtype.base.str, dtype.shape) for name, dtype in fields]
    assert f"{SAMPLE_DTYPE.itemsize} bytes each" in TELEMETRY
    assert np.lib.format.descr_to_dtype(np.lib.format.dtype_to_descr(SAMPLE_DTYPE)) == SAMPLE_DTYPE


def test_the_records_are_packed_and_the_lines_of_numpy_read_them() -> None:
    dtypes = [SAMPLE_DTYPE[name] for name in SAMPLE_DTYPE.names or ()]
    assert SAMPLE_DTYPE.itemsize == sum(dtype.itemsize for dtype in dtypes)
    samples = np.frombuffer(np.random.default_rng(1).bytes(3 * SAMPLE_DTYPE.itemsize), SAMPLE_DTYPE)
    described = msgpack.packb({"dtype": np.lib.format.dtype_to_descr(SAMPLE_DTYPE), "data": samples.tobytes()})
    (code,) = blocks(section(TELEMETRY, "## samples"), "python")
    found: dict[str, Any] = {"np": np, "message": msgpack.unpackb(described)}
    exec(code, found)
    assert found["dtype"] == SAMPLE_DTYPE
    assert found["samples"].tobytes() == samples.tobytes()


def test_flags() -> None:
    rows = tables(section(EVENTS, "## Flags"))["flag"]
    assert [(*names(row[0]), int(row[1])) for row in rows] == [(flag.name, flag.value) for flag in Flag]


def test_state() -> None:
    rows = tables(section(TELEMETRY, "## state"))["member"]
    assert set(first_names(rows)) == set(State.__annotations__) - set(SAMPLE_DTYPE.names or ())


def test_events() -> None:
    described = tables(section(EVENTS, "## Events"))
    documented = {names(row[0])[0]: set(names(row[1])) for row in described["event"]}
    event = records(EVENT_DTYPE, 1)[0]
    expected = {}
    for kind in EventKind:
        event["kind"] = kind
        expected[kind.name.lower()] = set(event_map(event, "x")) - {"event", "tick", "time_ns"}
    assert documented == expected
    assert set(first_names(described["member"])) == set().union(*expected.values())


def test_faults() -> None:
    rows = tables(section(EVENTS, "## Faults"))["fault"]
    assert first_names(rows) == fault_names(Fault(sum(Fault)))


def test_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The table has the keys, shapes and columns of a file, and the page's lines open the file."""
    described = RECORDINGS
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.yaml").write_text(
        "objects:\n  w: {kind: wall, point_m: [0, 0], normal: [0, 1], material: wood}\n"
    )
    (tmp_path / "hand.yaml").write_text("waypoints: [[0, 0, 0.01], [0.05, 0, -0.002]]\n")
    simulate_files(["scene.yaml"], "hand.yaml", "tap.npz", None, None)
    event = records(EVENT_DTYPE, 1)[0]
    with RecordingWriter("events.npz") as writer:
        for kind in EventKind:
            event["kind"] = kind
            writer.write_event(event_map(event, "x"))
        writer.finish()
    rows = tables(described)["key"]
    with np.load("tap.npz") as file:
        count = len(file["samples"])
        for row in rows:
            if row[1] in ("both", "`simulate`"):
                (shape,) = names(row[2])
                shapes = {"(n,)": (count,), "(m,)": (len(file["events"]),), "(n, 4)": (count, 4), "()": ()}
                assert file[names(row[0])[0]].shape == shapes[shape]
        assert set(file) == {names(row[0])[0] for row in rows if row[1] != "`record`"}
    with np.load("events.npz") as file:
        events = file["events"]
    forms = {"text": "U", "i8": "i8", "i1": "i1", "f8": "f8"}
    nothing = {'`""`': "", "-2^63, as numpy's NaT": NO_TIME, "0": 0, "-1": -1, "nan": np.nan}
    documented = {name: row for row in tables(described)["column"] for name in names(row[0])}
    assert documented.keys() == set(events.dtype.names or ())
    for name, row in documented.items():
        assert events.dtype[name].str[1:].startswith(forms[re.split("[;:]", row[1])[0]]), name
        for value, kind in zip(events[name], EventKind, strict=True):
            if name not in members(kind):
                np.testing.assert_equal(value, nothing[row[2]])
    by_numpy, by_hapticd, _ = blocks(described, "python")
    found: dict[str, Any] = {}
    exec(by_numpy, found)
    assert found["contacts"]["object"].tolist() == ["w"]
    exec(by_hapticd, found)
    assert found["marks"] == [] and len(found["frame"]) == count
    recording = found["recording"]
    members_of_table = {name for row in tables(described)["member"] for name in names(row[0])}
    assert recording.texts["recording"].keys() <= members_of_table
    public = {name: value for name, value in vars(type(recording)).items() if not name.startswith("_") and value}
    assert public and [name for name, value in public.items() if not value.__doc__] == []  # the site has the docstrings


def members(kind: EventKind) -> set[str]:
    event = records(EVENT_DTYPE, 1)[0]
    event["kind"] = kind
    return set(event_map(event, "x"))


def test_the_bytes_of_the_example() -> None:
    example = section(LANGUAGES, "## The steps")
    listings = re.findall(r"((?:^ {4}[0-9a-f]{2} .*\n)+)", example, flags=re.MULTILINE)
    question, answer = (
        bytes.fromhex("".join(re.match(r" {4}((?:[0-9a-f]{2} {1,2})+)", line)[1] for line in listing.splitlines()))  # type: ignore[index]
        for listing in listings
    )
    assert question == messages.request(1, "set_forces", {"enabled": True})
    assert messages.parse_request(messages.decode(question)).params == {"enabled": True}
    assert answer == messages.result_reply(1, {"forces": "on", "tick": 1500})
    assert msgpack.unpackb(answer) == {"jsonrpc": "2.0", "id": 1, "result": {"forces": "on", "tick": 1500}}


# ---- devices.md ----------------------------------------------------------------------------------------------------


def test_the_configurations_of_the_devices_page_are_valid() -> None:
    found = re.findall(r"^ *```yaml\n(.*?)^ *```$", DEVICES, flags=re.MULTILINE | re.DOTALL)
    kinds = {load_config(load_text(textwrap.dedent(each), "docs/devices.md").data).device.kind for each in found}
    assert kinds == {"sim", "hid", "replay"}


def test_every_quirk_is_documented() -> None:
    assert set(first_names(tables(section(DEVICES, "## Quirks"))["quirk"])) == set(get_args(Quirk))


def test_the_rule_sorts_where_the_page_says() -> None:
    rule = ROOT / "systemd" / "70-hapticd.rules"
    assert f"systemd/{rule.name}" in DEVICES
    assert rule.name < "70-uaccess.rules"
    assert 'KERNELS=="*:1209:0001.*", ENV{HAPTICD_DEVICE}="1"' in rule.read_text()


# ---- service.md ----------------------------------------------------------------------------------------------------


def test_the_files_of_the_service_are_documented(tmp_path: Path) -> None:
    lines = service_files.run("system", Installation(Path("/usr/bin/hapticd"), ()), root=tmp_path)
    written = [line.split()[-1].removeprefix(str(tmp_path)) for line in lines]
    assert first_names(tables(section(SERVICE, "## Setting it up"))["file"]) == written


def test_the_lines_of_the_doctor_are_documented() -> None:
    found = diagnose(Machine(limit=lambda number: (0, 0)), Needs(device=Hid()))
    described = first_names(tables(SERVICE)["line"])
    assert {finding.name for finding in found} <= set(described)
    sources = "".join(path.read_text() for path in (ROOT / "hapticd" / "doctor").glob("*.py"))
    assert all(f'"{name}"' in sources for name in described)


def test_the_directives_that_the_page_names_are_in_the_unit() -> None:
    unit = (ROOT / "systemd" / "hapticd.service").read_text().splitlines()
    needs = tables(section(SERVICE, "## The sandbox"))["right"]
    for directive in (name for row in needs for name in names(row[1]) if "=" in name):
        assert directive in unit
    for name in re.findall(r"`([A-Z]\w+)(?:=[^`]*)?`", section(SERVICE, "## The sandbox")):
        assert any(line.startswith(f"{name}=") for line in unit) or name.startswith(
            ("IPAddress", "CPUScheduling", "BindRead")
        )


# ---- Tests of the promises of a page --------------------------------------------------------------------------------

SHOWS = "## What shows it"
PROMISING = [ROOT / "docs" / name for name in ("reliability.md", "service.md")]


def is_there(test: str) -> bool:
    """Return whether a test exists: a function of a file below tests/, a target of make, or a module that is run."""
    if test.startswith("make "):
        return re.search(rf"^{test[5:]}:|^\.PHONY:.* {test[5:]}\b", (ROOT / "Makefile").read_text(), re.M) is not None
    if test.startswith("python -m "):
        return (ROOT / f"{test[10:].replace('.', '/')}.py").exists()
    file, _, function = test.partition("::")
    path = ROOT / "tests" / file
    return path.is_file() and re.search(rf"^def {function}\(", path.read_text(), re.M) is not None


def test_the_tests_that_the_stability_page_names_exist() -> None:
    """Each `pytest FILE -k WORDS` and `pytest FILE::NAME` of the page selects a test."""
    text = " ".join((ROOT / "docs" / "stability.md").read_text().split())
    shown = re.findall(r"`pytest tests/(\S+?\.py)(?:::(\w+))?(?: -k (\"[^\"]*\"|\w+))?`", text)
    assert len(shown) > 12 and len(shown) == text.count("`pytest ")
    for file, function, chosen in shown:
        defined = re.findall(r"^def (test_\w+)\(", (ROOT / "tests" / file).read_text(), re.M)
        for word in chosen.strip('"').split(" or "):
            assert any(word in name and function in ("", name) for name in defined), (file, function, word)


@pytest.mark.parametrize("page", PROMISING, ids=lambda page: page.stem)
def test_the_tests_of_promises_exist(page: Path) -> None:
    for _, shown in tables(section(page.read_text(), SHOWS))["promise"]:
        assert names(shown) and all(map(is_there, names(shown))), shown


# ---- architecture.md, decision records, links ----------------------------------------------------------------------


def test_every_room_has_its_line() -> None:
    core, package = section(ARCHITECTURE, "## Rooms").split("The package, ")
    for text, home in ((core, ROOT / "csrc"), (package, ROOT / "hapticd")):
        rooms = {path.parent.relative_to(home).parts[0] for kind in ("*/*.[ch]", "*/*.py") for path in home.glob(kind)}
        assert sorted(first_names(tables(text)["room"])) == sorted(f"{room}/" for room in rooms)


def test_every_decision_record_is_listed() -> None:
    index = (ROOT / "docs" / "adr" / "README.md").read_text()
    for record in sorted((ROOT / "docs" / "adr").glob("[0-9]*.md")):
        assert f"({record.name})" in index


def anchors(text: str) -> set[str]:
    headings = re.findall(r"^#+ (.*)$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    for target in re.findall(r"\]\(([^)]+)\)", text):
        if target.startswith("http"):
            continue
        name, _, anchor = target.partition("#")
        there = page.parent / name if name else page
        assert there.exists(), target
        assert not anchor or anchor in anchors(there.read_text()), target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_blocks_of_python_import_what_they_use(page: Path) -> None:
    for code in re.findall(r"^```python\n(.*?)^```$", page.read_text(), flags=re.MULTILINE | re.DOTALL):
        names = {node.value.id for node in ast.walk(ast.parse(code)) if is_of_a_name(node)}
        imported = {alias.asname or alias.name for node in ast.walk(ast.parse(code)) for alias in names_of(node)}
        assert names & {"hapticd", "np", "json", "zmq", "msgpack"} <= imported, code


def is_of_a_name(node: ast.AST) -> TypeGuard[Any]:
    return isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)


def names_of(node: ast.AST) -> list[ast.alias]:
    return node.names if isinstance(node, ast.Import | ast.ImportFrom) else []
