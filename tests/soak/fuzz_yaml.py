"""Mutated YAML, as many documents as asked for: each is taken, or refused in one line that names file and line.

    python -m tests.soak.fuzz_yaml [--runs 1000000] [--seed 0] [--kind config]

Kinds: `config` is what `hapticd run -c` loads, compiled where it is valid; `check` what `hapticd check` says of it;
`operator` YAML, JSON and CSV of operators; `reload` has a live daemon take bad configurations by SIGHUP, none of which
may change its scene. The tests do a few hundred of each; `make fuzz` does many. A document that fails is printed.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import random
import re
import signal
import socket
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from hapticd.analysis.check import check
from hapticd.base.errors import HapticdError, InvalidError
from hapticd.base.yaml_source import load_bytes
from hapticd.config.configuration import Config, load_config
from hapticd.config.operator import Grip, Operator, load_operator
from hapticd.rendering.compiler.table import Compiler
from hapticd.rendering.device_output import output_of
from hapticd.rendering.displayability import rate_faults
from tests.support import fuzzing
from tests.support.daemon_process import Daemon, Wire, wired
from tests.support.fuzzing import Tree

HANGS_S = 5.0
"""Processor time; a document of a few kilobytes that takes longer hangs."""
ROOT = Path(__file__).resolve().parents[2]
LONGEST_LINE = 40_000
"""Characters of a message: 50 faults, each with a path."""

REPORT = {
    "input": {"report_id": 1, "x": {"bit_offset": 0, "bit_size": 12, "signed": False, "counts_per_m": 40950}},
    "output": {"report_id": 2, "length": 6, "x": {"bit_offset": 0, "bit_size": 16, "counts_per_n": 10000}},
    "enable": ["02 00 00 00 00 01 00"],
}
DEVICES: tuple[Tree, ...] = (
    {"kind": "sim", "max_force_n": 8.9, "sim": {"start_m": [0, 0.01], "workspace_m": 0.075}},
    {"kind": "sim", "undisplayable": "lower", "sim": {"link": {"rate_hz": 1000, "delay_frames": 1}}},
    {"kind": "sim", "compensation": "full", "grip": {"mass_kg": 0.01}, "handle": {"mass_kg": 0.05}},
    {"kind": "hid", "max_force_n": 3, "hid": {"vendor": 0x1209, "product": 1, "report": REPORT}},
    {"kind": "hid", "hid": {"axes": {"x": {"usage": "Y"}, "y": {"usage": "X"}}, "quirks": ["no_reset"]}},
    {"kind": "replay", "replay": {"path": "away.hid", "loop": True}},
)
SERVOS: tuple[Tree, ...] = (
    {"rate_hz": 10000, "cpu": None, "priority": 80, "realtime": "preferred", "spin_us": 0},
    {"rate_hz": 2000.0, "realtime": "off", "overruns": {"threshold": 0.2, "action": "step_down"}},
    {"clock": "device"},
)
OBJECTS: tuple[Tree, ...] = (
    {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"},
    {
        "kind": "wall",
        "point_m": [0, -0.02],
        "normal": [0.6, 0.8],
        "material": "wood",
        "patches": [
            {"from_m": 0.0, "to_m": 0.05, "material": "comb"},
            {"from_m": 0.05, "to_m": 0.1, "material": "steel"},
        ],
        "patch_ramp_m": 0.002,
    },
    {"kind": "box", "center_m": [0.03, 0.02], "size_m": [0.02, 0.01], "angle_rad": 0.1, "material": "glass"},
    {"kind": "disc", "center_m": [-0.03, 0.02], "radius_m": 0.005, "material": "sandpaper_100"},
    {"kind": "membrane", "center_m": [0, 0.03], "normal": [0, 1], "width_m": 0.02, "material": "cellophane"},
    {"kind": "spring", "center_m": [0, 0], "stiffness_n_per_m": 50, "damping_n_s_per_m": 0.5},
    {"kind": "viscous", "damping_n_s_per_m": 2},
    {"kind": "constant", "force_n": [0, -0.2]},
)
"""Every kind of object; of materials, those that are shipped, and these, which have what no shipped one has."""
MATERIALS: tuple[Tree, ...] = (
    {
        "stiffness_n_per_m": 700,
        "tap": {
            "amplitudes": [[0.05, 10], [0.2, 50]],
            "angular_frequency_rad_per_s": 800,
            "decay_rate_per_s": 90,
            "attack": "first_peak",
            "second": {"frequency_hz": 300, "decay_time_s": 0.01, "ratio": 0.3},
        },
        "friction": {"coefficient": 0.3, "stiffness_n_per_m": 400},
    },
    {
        "stiffness_n_per_m": 500,
        "texture": {
            "kind": "autoregressive",
            "rate_hz": 10000,
            "models": [
                {"speed_m_per_s": 0.05, "force_n": 0.5, "coefficients": [-1.2, 0.5], "rms_m_per_s2": 1.0},
                {"speed_m_per_s": 0.2, "force_n": 0.5, "coefficients": [-1.1, 0.4], "variance_m2_per_s4": 0.1},
            ],
        },
    },
    {
        "stiffness_n_per_m": 500,
        "rupture": {
            "max_strain": 0.2,
            "radius_m": 0.01,
            "amplitude_m_per_s2": 38,
            "frequency_hz": 200,
            "decay_time_s": 0.003,
        },
        "provenance": {
            "files": [{"path": "a.csv"}],
            "date": "2024-02-29",
            "version": "1.0",
            "intervals": {"x": [1, 2]},
        },
    },
)
GESTURES: tuple[Tree, ...] = (
    {"waypoints": [[0, 0, 0.01], [0.5, 0.01, -0.005], [1, 0, 0.01]], "interpolation": "minimum_jerk"},
    {"gesture": {"kind": "tap", "object": "floor", "speed_m_per_s": 0.1, "count": 3, "at_m": 0.01, "height_m": 0.01}},
    {"gesture": {"kind": "stroke", "object": "floor", "speed_m_per_s": 0.1, "press_n": 1, "from_m": 0, "to_m": 0.02}},
    {"gesture": {"kind": "puncture", "object": "skin", "speed_m_per_s": 0.1}},
)
NAMES = ("floor", "skin", "a", "peg 2", "Stra\u00dfe", "wood")
SNIPPETS = (
    *("\t", "  ", "\n", "\r\n", "\r", "\x00", "\x07", "\x85", "\u2028", "\ufeff", "\xa0"),
    *("#", " #", ": ", "- ", "? ", ", ", "{", "}", "[", "]", "'", '"', "\\", "@", "`", "="),
    *("&a ", "*a", "<<: ", "<<: *a", "!", "!<x> ", "!!int ", "!!float ", "!!str ", "!!binary "),
    "!!python/object/apply:os.system ",
    *("%YAML 1.2\n---\n", "%TAG ! x\n", "---\n", "...\n", "--- ", "|\n", ">-\n", "|9\n"),
    *('"\\x00"', '"\\ud800"', '"\\u2028"', "é", "\U0001f600", "\u0301"),
    *("0o17", "0x_1", "1_000", "1:30", ".inf", "-.NaN", "1e999", "9" * 500, "null", "~", "yes", "off"),
    *("[" * 40, "{a: " * 40, "- " * 40, "? " * 40, "x" * 300, "kind: wall\n"),
)
"""Blanks, indicators, anchors and tags, directives and blocks, escapes, scalars, depth."""
BYTES = (
    *(b"\xff\xfe", b"\xfe\xff", b"\xef\xbb\xbf", b"\x00\x00\xfe\xff"),
    *(b"\x80", b"\xc0\xaf", b"\xed\xa0\x80", b"\xf5\x80\x80\x80"),
)
"""Marks of byte orders, and what is no UTF-8."""


class Failure(AssertionError):
    """What was found, with the document."""


def _shipped(folder: str) -> list[str]:
    return [path.read_text() for path in sorted((ROOT / "config").glob(folder))]


@cache
def library() -> dict[str, str]:
    """The shipped materials and ours as JSON, by name: parsing it again makes a copy."""
    found = {f"own_{number}": json.dumps(material) for number, material in enumerate(MATERIALS)}
    for document in _shipped("materials/*.yaml"):
        tree = load_bytes(document.encode(), "library").data
        assert isinstance(tree, dict)
        found |= {name: json.dumps(material) for name, material in dict(tree["materials"]).items()}  # type: ignore[arg-type]
    return found


@cache
def texts() -> list[str]:
    """Documents as people wrote them, short ones."""
    blocks = [
        block.split("```")[0]
        for page in (ROOT / "docs").glob("*.md")
        for block in page.read_text().split("```yaml\n")[1:]
    ]
    whole = [*_shipped("*.yaml"), *_shipped("scenes/*.yaml"), *blocks]
    return [text for text in whole if len(text) < 1000]


def _copy(tree: Tree) -> Tree:
    return json.loads(json.dumps(tree))


def config_tree(source: random.Random) -> Tree:
    """A configuration that is valid, but small: some of each section."""
    tree: Tree = {}
    if source.random() < 0.3:
        tree["servo"] = _copy(source.choice(SERVOS))
    if source.random() < 0.4:
        tree["device"] = _copy(source.choice(DEVICES))
    if source.random() < 0.35:
        name = source.choice(tuple(library()))
        tree["materials"] = {name if source.random() < 0.7 else "mine": json.loads(library()[name])}
    if source.random() < 0.6:
        objects = {source.choice(NAMES): _copy(source.choice(OBJECTS)) for _ in range(source.randrange(3))}
        tree["scene"] = {"objects": objects}
        if source.random() < 0.2:
            tree["scene"] |= {"display": {"force": True, "vibration": False}, "ramp_s": 0.05, "passivity": "control"}
    if source.random() < 0.1:
        tree["flight"] = {"seconds": 5, "keep": 3, "directory": "/nowhere"}
    return tree


# ---- Writing -----------------------------------------------------------------------------------------------------


def _scalar(source: random.Random, value: Tree) -> str:
    if value is None:
        return source.choice(("null", "~"))
    if value is True or value is False:
        return str(value).lower() if source.random() < 0.8 else str(value)
    if isinstance(value, float):
        if math.isnan(value):
            return ".nan"
        return f"{'-' if value < 0 else ''}.inf" if math.isinf(value) else repr(value)
    if isinstance(value, int):
        return hex(value) if value >= 0 and source.random() < 0.1 else str(value)
    text: str = value
    plain = text.isidentifier() and text.lower() not in ("null", "true", "false")
    if plain and source.random() < 0.8:
        return text
    if text.isprintable() and source.random() < 0.5:
        return "'" + text.replace("'", "''") + "'"
    return json.dumps(text, ensure_ascii=not text.isprintable())


def _flow(source: random.Random, tree: Tree) -> str:
    if isinstance(tree, dict):
        return "{" + ", ".join(f"{_scalar(source, key)}: {_flow(source, below)}" for key, below in tree.items()) + "}"
    if isinstance(tree, list):
        return "[" + ", ".join(_flow(source, below) for below in tree) + "]"
    return _scalar(source, tree)


def _block(source: random.Random, tree: Tree, indent: str) -> Iterator[str]:
    step = source.choice(("  ", " ", "    "))
    is_map = isinstance(tree, dict)
    for key in tree if is_map else range(len(tree)):
        below = tree[key]
        head = f"{indent}{_scalar(source, key)}:" if is_map else f"{indent}-"
        if isinstance(below, dict | list) and below and source.random() < 0.6:
            yield head
            yield from _block(source, below, indent + step)
        else:
            comment = "  # as measured" if source.random() < 0.05 else ""
            yield f"{head} {_flow(source, below)}{comment}"


def written(source: random.Random, tree: Tree) -> str:
    """A tree as YAML of some style; it means exactly that tree."""
    if not isinstance(tree, dict | list) or not tree or source.random() < 0.2:
        return _flow(source, tree) + "\n"
    end = "\n" if source.random() < 0.9 else "\r\n"
    return end.join(_block(source, tree, "")) + end


def _same(one: Tree, other: Tree) -> bool:
    """Equal in type and value, everywhere."""
    if type(one) is not type(other):
        return False
    if isinstance(one, dict):
        return list(one) == list(other) and all(_same(one[key], other[key]) for key in one)
    if isinstance(one, list):
        return len(one) == len(other) and all(map(_same, one, other))
    return bool(one == other) or one != one


def _indented(source: random.Random, text: str) -> str:
    lines = text.split("\n")
    at = source.randrange(len(lines))
    match source.randrange(6):
        case 0:
            lines[at] = " " * source.randrange(1, 5) + lines[at]
        case 1:
            lines[at] = lines[at].lstrip(" ")
        case 2:
            lines[at] = "\t" + lines[at]
        case 3:
            lines.insert(at, lines[source.randrange(len(lines))])
        case 4:
            del lines[at]
        case _:
            other = source.randrange(len(lines))
            lines[at], lines[other] = lines[other], lines[at]
    return "\n".join(lines)


def torn(source: random.Random, text: str) -> bytes:
    """Text with one to four changes of its characters, lines or bytes."""
    for _ in range(source.choice((1, 1, 1, 2, 4))):
        at = source.randrange(len(text) + 1)
        choice = source.random()
        if choice < 0.4:
            text = text[:at] + source.choice(SNIPPETS) + text[at + source.choice((0, 0, 1, 3)) :]
        elif choice < 0.7:
            text = _indented(source, text)
        elif choice < 0.8:
            text = text[:at] + text[at + source.randrange(1, 20) :]
        elif choice < 0.87:
            text = text[:at]
        elif choice < 0.94:
            end = at + source.randrange(1, 40)
            text = text[:at] + text[at:end] * source.choice((2, 3, 20)) + text[end:]
        else:
            text = text.replace(
                source.choice(("\n", " ", ":", "{", ",")), source.choice(SNIPPETS), source.choice((1, 3))
            )
    content = text.encode("utf-8", "surrogatepass")
    choice = source.random()
    if choice < 0.03:
        at = source.randrange(len(content) + 1)
        return content[:at] + source.choice(BYTES) + content[at:]
    if choice < 0.04:
        return text.encode(source.choice(("utf-16", "utf-32", "utf-7")), "replace")
    if choice < 0.05:
        return content * source.choice((10, 100))
    return content


def _mutated(source: random.Random, tree: Tree, graft: Callable[[], Tree]) -> None:
    for _ in range(source.choice((0, 1, 1, 1, 2, 3))):
        fuzzing.mutate(source, tree, graft)


@dataclass(slots=True)
class Case:
    """A document, and the tree that it was written from, where nobody tore at it since."""

    content: bytes
    tree: Tree = field(default=...)


def case_of(source: random.Random, tree: Callable[[random.Random], Tree], whole: Callable[[], list[str]]) -> Case:
    """Half of them trees with a wrong branch, half of them torn text, some of them both."""
    choice = source.random()
    found = whole() if choice < 0.2 else None
    if found:
        return Case(torn(source, source.choice(found)))
    made = tree(source)
    if choice < 0.8:
        _mutated(source, made, lambda: tree(source))
    if choice > 0.995:
        made[source.choice(fuzzing.KEYS)] = fuzzing.nested(source, source.randrange(20, 200))
    text = written(source, made)
    return Case(torn(source, text)) if choice < 0.45 else Case(text.encode("utf-8", "surrogatepass"), made)


# ---- Checking ----------------------------------------------------------------------------------------------------


def check_refusal(error: HapticdError, path: Path, content: bytes, lined: bool = True) -> None:
    """One line, not too long, and every fault of it in the file, on a line that it has."""
    told = str(error)
    assert told
    assert told.isprintable(), repr(told)
    assert len(told) < LONGEST_LINE, len(told)
    if not lined:
        assert told.startswith(f"{path}:") or str(path) in told, told
        return
    assert isinstance(error, InvalidError), told
    most = 2 + len(content.decode("utf-8", "replace").splitlines())
    for problem in error.problems:
        assert problem.problem, told
        if problem.where == str(path):  # a document of another kind, as a whole
            assert problem.problem.startswith("holds "), told
            continue
        head = f"{path}:"
        assert problem.where.startswith(head), problem.where
        line = problem.where[len(head) :].split(":")[0]
        assert line.isdecimal() and 1 <= int(line) <= most, problem.where


def rendered(config: Config) -> None:
    """Compiles what is valid, as the daemon would at its start."""
    output = output_of(config, config.servo.rate_hz, None)
    if not rate_faults(config.scene.objects, config.materials, output):
        Compiler(output).update(config.scene, config.scene.objects, config.materials, 1)


def run_config(source: random.Random, path: Path, look: Callable[[Config], object] = rendered) -> str:
    """One configuration; what came of it."""
    case = case_of(source, config_tree, texts)
    path.write_bytes(case.content)
    try:
        config = load_config([path])
    except HapticdError as error:
        check_refusal(error, path, case.content)
        outcome = "refused"
    else:
        look(config)
        if source.random() < 0.2:
            assert load_config(config.to_dict()) == config, "what it says of itself is another configuration"
        outcome = "taken"
    if source.random() < 0.3:
        _check_read(case, path)
    return outcome


def _check_read(case: Case, path: Path) -> None:
    """Where the tree is known, it is what was read; where it is none that YAML of ours has, it was refused."""
    if case.tree is ...:
        return
    try:
        read = load_bytes(case.content, str(path)).data
    except InvalidError:
        assert _deep(case.tree) > 32 or _unwritable(case.tree), "what is well written was refused"
    else:
        assert _same(read, case.tree), f"read as {read!r}"


def _deep(tree: Tree) -> int:
    if not isinstance(tree, dict | list):
        return 0
    return 1 + max(map(_deep, tree.values() if isinstance(tree, dict) else tree), default=0)


def _unwritable(tree: Tree) -> bool:
    """Whether it holds a lone surrogate, which is no Unicode."""
    if isinstance(tree, str):
        return any(0xD800 <= ord(character) < 0xE000 for character in tree)
    if isinstance(tree, dict):
        return any(map(_unwritable, tree)) or any(map(_unwritable, tree.values()))
    return isinstance(tree, list) and any(map(_unwritable, tree))


def run_check(source: random.Random, path: Path) -> str:
    """One configuration through the work behind `hapticd check`."""
    return run_config(source, path, lambda config: json.dumps(check(config).to_dict()))


GRIP = Grip(300.0)


def run_operator(source: random.Random, path: Path) -> str:
    """One operator: YAML, JSON or CSV."""
    kind = source.choice((".yaml", ".json", ".csv"))
    here = path.with_suffix(kind)
    tree = _copy(source.choice(GESTURES))
    if kind == ".csv":
        rows = ["t_s,x_m,y_m"] * source.randrange(2) + [
            f"{0.1 * row:g},0.01,{source.uniform(-1, 1):g}" for row in range(5)
        ]
        content = torn(source, "\n".join(rows))
    elif kind == ".json":
        _mutated(source, tree, lambda: _copy(source.choice(GESTURES)))
        text = json.dumps(tree, indent=source.choice((None, 1, "\t")), ensure_ascii=source.random() < 0.5)
        content = torn(source, text) if source.random() < 0.5 else text.encode("utf-8", "surrogatepass")
    else:
        content = case_of(source, lambda _: _copy(tree), lambda: _shipped("operators/*.yaml")).content
    here.write_bytes(content)
    try:
        operator = load_operator(here)
    except HapticdError as error:
        check_refusal(error, here, content)
        return "refused"
    finally:
        here.unlink()
    assert isinstance(operator, Operator)
    if operator.gesture is None:
        assert operator.waypoints
        rows_ = operator.waypoints_for(lambda _: None, GRIP, (0.0, 0.0))
        assert rows_.shape == (len(operator.waypoints), 3)
    return "taken"


# ---- A live daemon -----------------------------------------------------------------------------------------------


@contextmanager
def _told(path: Path) -> Iterator[socket.socket]:
    """Where a daemon says, as to systemd, that a reload is over."""
    before = os.environ.get("NOTIFY_SOCKET")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as heard:
        heard.bind(str(path))
        heard.settimeout(60)
        os.environ["NOTIFY_SOCKET"] = str(path)
        try:
            yield heard
        finally:
            if before is None:
                del os.environ["NOTIFY_SOCKET"]
            else:
                os.environ["NOTIFY_SOCKET"] = before


def _wait_ready(heard: socket.socket) -> None:
    while "READY=1" not in heard.recv(65536).decode().splitlines():
        pass


def run_reloads(source: random.Random, runs: int, progress: Callable[[int], None]) -> Counter[str]:
    """Bad configurations for a live daemon by SIGHUP: not one of them changes its scene, or anything else.

    A document that happens to be valid is made bad by a key that nobody knows.
    """
    outcomes: Counter[str] = Counter()
    good = f"servo: {{realtime: off}}\nscene: {{objects: {{floor: {json.dumps(OBJECTS[0])}}}}}\n"
    with tempfile.TemporaryDirectory(prefix="hapticd-test-") as parent, _told(Path(parent) / "notify") as heard:
        path = Path(parent) / "c.yaml"
        path.write_text(good)
        daemon = Daemon(Path(parent) / "run", "-c", str(path))
        try:
            daemon.wait_ready()
            _wait_ready(heard)
            with wired(daemon) as wire:
                before = _all_of(wire)
                for number in range(runs):
                    content = case_of(source, config_tree, texts).content
                    if _valid(path, content):
                        content += b"\nno_such_key: 1\n"
                        if _valid(path, content):
                            content = b"no_such_key: 1\n"
                        outcomes["made bad"] += 1
                    path.write_bytes(content)
                    daemon.process.send_signal(signal.SIGHUP)
                    _wait_ready(heard)
                    if number % 100 == 99 or number == runs - 1:
                        if _all_of(wire) != before:
                            raise Failure(
                                f"reload {number - 99} to {number} changed something; the last was {content!r}"
                            )
                        progress(number + 1)
                said = daemon.said()
                outcomes["refused"] = runs
                # It still takes a good one.
                path.write_text(good.replace("wood", "steel"))
                daemon.process.send_signal(signal.SIGHUP)
                _wait_ready(heard)
                now = wire.result("get_scene")
                assert now["scene"]["objects"]["floor"]["material"] == "steel"
                assert now["revision"] == before[0]["revision"] + 1
                assert wire.result("get_status")["faults"] == []
            assert "Traceback" not in said
        finally:
            code = daemon.stop()
        assert code == 0, daemon.said()
        # What comes faster than once a second is one line, with the number of the others.
        told = [line for line in daemon.said().splitlines() if "not reloaded: " in line]
        more = sum(
            int(number.replace(",", "")) for number in re.findall(r"\(and ([\d,]+) more in the last ", "\n".join(told))
        )
        assert len(told) + more == runs, f"{len(told) + more} of {runs} were told"
    return outcomes


def _valid(path: Path, content: bytes) -> bool:
    path.write_bytes(content)
    try:
        load_config([path])
    except HapticdError:
        return False
    return True


def _all_of(wire: Wire) -> tuple[dict[str, Tree], ...]:
    return wire.result("get_scene"), wire.result("get_materials"), wire.result("get_config")


# ---- Many --------------------------------------------------------------------------------------------------------

KINDS: dict[str, Callable[[random.Random, Path], str]] = {
    "config": run_config,
    "check": run_check,
    "operator": run_operator,
}


@dataclass(slots=True)
class Found:
    """What came of many documents."""

    outcomes: Counter[str]
    worst_s: float
    rate_per_s: float


def run(kind: str, source: random.Random, runs: int, progress: Callable[[int], None] = lambda _: None) -> Found:
    """So many documents of one kind. Raises Failure with the one that did not go well."""
    outcomes: Counter[str] = Counter()
    worst_s = 0.0
    began = time.process_time()
    # Files in memory: many file systems wait for the disk when a file is cut to be written anew.
    memory = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with (
        tempfile.TemporaryDirectory(prefix="hapticd-test-", dir=memory) as folder,
        fuzzing.hangs_after(HANGS_S) as begin,
    ):
        path = Path(folder) / "f.yaml"
        for number in range(runs):
            state = source.getstate()
            begin()
            started = time.process_time()
            try:
                outcomes[KINDS[kind](source, path)] += 1
            except BaseException as error:  # a panic of pydantic is no Exception
                content = path.read_bytes() if path.exists() else b""
                source.setstate(state)
                raise Failure(f"{kind} {number}: {type(error).__name__}: {error}\n{content[:5000]!r}") from error
            worst_s = max(worst_s, time.process_time() - started)
            if (number + 1) % 50_000 == 0:
                progress(number + 1)
    return Found(outcomes, worst_s, runs / (time.process_time() - began))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kind", choices=(*KINDS, "reload"), default="config")
    arguments = parser.parse_args()
    source = random.Random(arguments.seed)
    kind = arguments.kind

    def progress(done: int) -> None:
        print(f"{done} documents", flush=True)

    if kind == "reload":
        print(f"fuzz_yaml: ok, reload, {dict(run_reloads(source, arguments.runs, lambda _: None))}")
        return
    found = run(kind, source, arguments.runs, progress)
    told = ", ".join(f"{count} {outcome}" for outcome, count in found.outcomes.most_common())
    print(
        f"fuzz_yaml: ok, {kind}, {arguments.runs} documents, {told}; {found.rate_per_s:.0f} in a second of processor "
        f"time, the slowest {1e3 * found.worst_s:.0f} ms"
    )


if __name__ == "__main__":
    main()
