"""User functions as measures: arguments, return values and failures."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
from pathlib import Path
from textwrap import dedent
from typing import Any

import numpy as np
import pytest

import hapticd
from hapticd.base.errors import HapticdError, InvalidError
from hapticd.sweeps.identity import sum_of
from hapticd.sweeps.measures import function_process
from hapticd.sweeps.measures.registry import identity_of, parse_measure
from hapticd.sweeps.plan import Plan
from hapticd.sweeps.study import load_sweep
from tests.support.marks import rest_slow

pytestmark = pytest.mark.slow

MODULE = """
import ctypes, os, sys, time
import numpy as np


def peak(point):
    force = np.hypot(*point.samples["force_n"].T).max()
    return {"own_peak_n": force, "deep": bool(point.truth[:, 1].min() < -0.001), "ticks": len(point.samples),
            "who": point.config["materials"]["m"].get("provenance", "nobody") and str(point.parameters["who"])}


def alone(point):
    return point.config["servo"]["rate_hz"] / 1000


def none(point):
    return None


def raises(point):
    raise ValueError("not\\nthis one")


def leaves(point):
    sys.exit(3)


def crashes(point):
    os.kill(os.getpid(), 11)


def quits(point):
    os._exit(7)


def missing(point):
    return {}


def strange(point):
    return {"x": 1.0, "y": 2.0}


def nan(point):
    return float("nan")


def words(point):
    return "abc"


def odd(point):
    return {"x": object()}


def truth(point):
    return np.bool_(True)


def spins(point):
    while True:
        pass


def sleeps(point):
    time.sleep(1e6)


def in_c(point):
    # Holds the interpreter lock in C code that never returns.
    ctypes.PyDLL(None).pause()


def deaf(point):
    import signal
    for each in set(signal.Signals) - {signal.SIGKILL, signal.SIGSTOP}:
        signal.signal(each, signal.SIG_IGN)
    while True:
        time.sleep(1)


def prints(point):
    print("to nobody")
    os.write(1, b"to nobody")
    return os.read(0, 10) == b"" and 1.5


not_callable = 3
"""

BASE: dict[str, Any] = {
    "base": {
        "materials": {"m": {"stiffness_n_per_m": 500}},
        "scene": {"objects": {"floor": {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "m"}}},
        "device": {"sim": {"encoder_step_m": 0}},
    },
    "operator": {"waypoints": [[0, 0, 0.002], [0.05, 0, -0.004]]},
}


@pytest.fixture(autouse=True)
def _module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)


def planned(name: str, columns: dict[str, str] | None = None, **keys: Any) -> Plan:
    options = {"call": f"mine:{name}", "columns": columns or {"x": ""}, **keys.pop("options", {})}
    study = {**BASE, "vary": {"servo.rate_hz": [1000, 2000]}, "measure": [{"function": options}], **keys}
    return load_sweep({key: value for key, value in study.items() if value is not None})


def rows(found: Plan) -> list[dict[str, Any]]:
    return found.piece(np.arange(len(found.ids))).rows()  # type: ignore[return-value]


def error(name: str, columns: dict[str, str] | None = None, **options: Any) -> str:
    """Return the error in the row of a point at which the function fails."""
    (row,) = rows(planned(name, columns, vary=None, options=options))
    measured = columns or {"x": ""}
    assert all(row[column] is None for column in measured)
    assert "\n" not in row["error"]
    return str(row["error"])


def test_a_function_gets_the_point_and_returns_columns() -> None:
    columns = {"own_peak_n": "N", "deep": "boolean", "ticks": "integer", "who": "text"}
    options = {"call": "mine:peak", "columns": columns}
    found = planned("peak", columns, measure=["peak_force_n", {"function": options}], parameters={"who": "me"})
    units = {column.name: (column.kind, column.unit) for column in found.columns if column.role == "measured"}
    assert units["own_peak_n"] == ("number", "N") and units["deep"] == ("boolean", "")
    assert units["ticks"] == ("integer", "") and units["who"] == ("text", "")
    for row, rate in zip(rows(found), (1000, 2000), strict=True):
        run = hapticd.simulate({**BASE["base"], "servo": {"rate_hz": rate}}, BASE["operator"])
        peak = float(np.hypot(*run["force_n"].T).max())
        assert row["error"] is None and row["own_peak_n"] == row["peak_force_n"] == peak
        assert (row["deep"], row["ticks"], row["who"]) == (True, len(run), "me")


def test_one_column_needs_no_name_and_may_have_no_value() -> None:
    assert [row["x"] for row in rows(planned("alone"))] == [1.0, 2.0]
    assert [row["x"] for row in rows(planned("none"))] == [None, None]
    assert [row["x"] for row in rows(planned("truth", {"x": "boolean"}))] == [True, True]


def test_a_study_without_a_run_gives_a_function_no_samples(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("def what(point):\n    return point.samples is None and point.truth is None\n")
    assert [row["x"] for row in rows(planned("what", {"x": "boolean"}, operator=None))] == [True, True]
    assert [row["x"] for row in rows(planned("what", {"x": "boolean"}))] == [False, False]


def test_a_function_may_print_and_has_no_input() -> None:
    assert [row["x"] for row in rows(planned("prints"))] == [1.5, 1.5]


@pytest.mark.parametrize(
    ("name", "columns", "message"),
    rest_slow(
        [
            ("raises", None, "mine:raises: raised ValueError: not this one (mine.py, line 21)"),
            ("leaves", None, "mine:leaves: raised SystemExit: 3 (mine.py, line 25)"),
            ("crashes", None, "mine:crashes: its process ended with SIGSEGV"),
            ("quits", None, "mine:quits: ended its process with exit code 7"),
            ("missing", None, "mine:missing: returned no column x; return None if it has no value"),
            ("strange", None, 'mine:strange: returned unknown column "y"; declared: x'),
            ("alone", {"x": "", "y": ""}, "mine:alone: must return a mapping of the columns x, y, returned a float"),
            ("nan", None, "mine:nan: column x must be a finite number, is nan"),
            ("words", None, 'mine:words: column x must be a finite number, is "abc"'),
            ("odd", None, "mine:odd: column x must be a finite number, is a object"),
            ("truth", None, "mine:truth: column x must be a finite number, is true"),
            ("alone", {"x": "integer"}, "mine:alone: column x must be an integer of 64 bits, is 10.0"),
            ("alone", {"x": "boolean"}, "mine:alone: column x must be true or false, is 10.0"),
            ("alone", {"x": "text"}, "mine:alone: column x must be a string, is 10.0"),
        ],
        fast=5,
    ),
)
def test_a_fault_of_a_function_is_the_error_of_the_row(name: str, columns: dict[str, str] | None, message: str) -> None:
    if name == "alone":
        text = Path("mine.py").read_text().replace('point.config["servo"]["rate_hz"] / 1000', "10.0")
        Path("mine.py").write_text(text)
    assert error(name, columns) == message


@pytest.mark.parametrize("name", rest_slow(["in_c", "spins", "sleeps", "deaf"]))
def test_a_function_that_hangs_is_killed_and_the_next_point_is_computed(name: str) -> None:
    text = f"{MODULE}\n\ndef some(point):\n    return {name}(point) if point.parameters['n'] == 1 else os.getpid()\n"
    Path("mine.py").write_text(text)
    found = rows(planned("some", {"x": "integer"}, vary={"parameters.n": [0, 1, 2]}, options={"timeout_s": 2}))
    assert [row["error"] for row in found] == [
        None, "mine:some: timed out after 2 s and was killed (timeout_s)", None,
    ]  # fmt: skip
    first, last = (row["x"] for row in (found[0], found[2]))
    assert first != last
    with pytest.raises(ProcessLookupError):
        os.kill(first, 0)


def test_one_process_serves_all_points_of_a_thread(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("import os\n\n\ndef who(point):\n    return os.getpid()\n")
    found = planned("who", {"x": "integer"})
    pids = {row["x"] for row in rows(found) + rows(found)}
    assert len(pids) == 1 and os.getpid() not in pids


def test_a_thread_keeps_the_processes_of_its_last_functions(tmp_path: Path) -> None:
    pids = []
    for n in (0, 1, 2, 3, 4, 4):
        (tmp_path / "mine.py").write_text(f"import os\n\n\ndef who(point):\n    return os.getpid() + 0 * {n}\n")
        pids.append(rows(planned("who", {"x": "integer"}, vary=None))[0]["x"])
    assert len(set(pids)) == 5 and pids[4] == pids[5]
    os.kill(pids[1], 0)
    with pytest.raises(ProcessLookupError):
        os.kill(pids[0], 0)


def test_a_function_ends_even_if_its_calling_process_is_killed(tmp_path: Path) -> None:
    """The calling process is killed during a call."""
    (tmp_path / "mine.py").write_text(
        dedent("""
        import os

        def hangs(point):
            with open("pid.tmp", "w") as file:
                file.write(str(os.getpid()))
            os.rename("pid.tmp", "pid")
            while True:
                pass
        """)
    )
    program = "import sys; sys.path.insert(0, '.'); import asking; asking.go()"
    (tmp_path / "asking.py").write_text(
        dedent("""
        import numpy as np
        from hapticd.sweeps.study import load_sweep

        def go():
            function = {"call": "mine:hangs", "columns": {"x": ""}, "timeout_s": 600}
            found = load_sweep({"measure": [{"function": function}]})
            found.piece(np.arange(1)).rows()
        """)
    )
    asking = subprocess.Popen([sys.executable, "-c", program], cwd=tmp_path)
    descriptor = -1
    try:
        while not (tmp_path / "pid").exists():
            assert asking.poll() is None
        descriptor = os.pidfd_open(int((tmp_path / "pid").read_text()))
        asking.send_signal(signal.SIGKILL)
        asking.wait()
        assert select.select([descriptor], [], [], 30)[0], "the function still runs"
    finally:
        asking.kill()
        if descriptor >= 0:
            os.close(descriptor)


@pytest.mark.parametrize(
    ("options", "place", "message"),
    [
        ("call: 'mine:peek', columns: {x: ''}", "call", "mine has no function peek; did you mean peak?"),
        ("call: 'mine:not_callable', columns: {x: ''}", "call", "mine:not_callable is not a function, but a int"),
        ("call: 'yours:peak', columns: {x: ''}", "call", "no module yours, neither as yours.py in "),
        ("call: 'math:sqrt', columns: {x: ''}", "call", "math is not a Python file; workers need its source"),
        ("call: 'broken:peak', columns: {x: ''}", "call", "broken cannot be loaded: line 2: '(' was never closed"),
        ("call: 'needs:peak', columns: {x: ''}", "call",
         "needs cannot be loaded: ModuleNotFoundError: No module named 'no_such_thing' (needs.py, line 1)"),
        ("call: mine.peak, columns: {x: ''}", "call", "call: "),
        ("columns: {x: ''}", "", "call"),
        ("call: 'mine:peak', columns: {}", "columns", "columns"),
        ("call: 'mine:peak', columns: {x: ''}, timeout_s: 0", "timeout_s", "should be greater than 0"),
        ("call: 'mine:peak', columns: {x: ''}, time: 1", "time", "unknown key"),
    ],
)  # fmt: skip
def test_a_faulty_function_is_reported_with_its_line_before_anything_is_computed(
    options: str, place: str, message: str, tmp_path: Path
) -> None:
    (tmp_path / "broken.py").write_text("x = 1\ny = (\n")
    (tmp_path / "needs.py").write_text("import no_such_thing\n")
    file = tmp_path / "study.yaml"
    file.write_text(f"title: A\nmeasure:\n  - peak_force_n\n  - function: {{{options}}}\n")
    with pytest.raises(InvalidError) as caught:
        load_sweep(file)
    lines = str(caught.value).splitlines()
    found = [line for line in lines if message in line]
    assert found and f"{file}:4:" in found[0] and f"measure[1].function{'.' if place else ''}{place}" in found[0]


def test_two_columns_with_one_name_are_refused() -> None:
    with pytest.raises(InvalidError, match="duplicate column peak_force_n; give one of them another name"):
        planned("peak", measure=["peak_force_n", {"function": {"call": "mine:peak", "columns": {"peak_force_n": "N"}}}])


def test_a_module_that_is_not_loaded_in_time_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine.py").write_text("import time\ntime.sleep(1e6)\n")
    monkeypatch.setattr(function_process, "MODULE_LOAD_TIMEOUT_S", 1.0)
    with pytest.raises(InvalidError, match="its module was not loaded within 1 s"):
        planned("peak")


def test_the_identity_of_a_function_is_its_source_not_its_path_or_time_out(tmp_path: Path) -> None:
    first = planned("alone")
    assert np.array_equal(planned("alone", options={"timeout_s": 7}).ids, first.ids)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "mine.py").write_text(MODULE)
    os.chdir(elsewhere)
    assert np.array_equal(planned("alone").ids, first.ids)
    (elsewhere / "mine.py").write_text(MODULE + "# other\n")
    assert not set(planned("alone").ids.tolist()) & set(first.ids.tolist())
    assert not set(planned("none").ids.tolist()) & set(first.ids.tolist())


def test_the_identity_of_other_measures_has_all_their_options() -> None:
    given: dict[str, Any] = {"quantile": {"field": "force_n", "q": 0.5}}
    assert identity_of("end") == "end" and identity_of(given) == given
    assert not np.array_equal(sum_of(identity_of(given)), sum_of(identity_of({"quantile": {"q": 0.5}})))


def test_a_piece_contains_the_source_of_the_function(tmp_path: Path) -> None:
    found = planned("alone")
    (tmp_path / "mine.py").unlink()
    assert [row["x"] for row in rows(found)] == [1.0, 2.0]


def test_a_module_of_a_package_on_pythons_path_may_import_its_neighbours(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "lib" / "some_package_of_mine"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("")
    (package / "other.py").write_text("FACTOR = 4.0\n")
    (package / "module.py").write_text("from .other import FACTOR\n\n\ndef f(point):\n    return FACTOR\n")
    monkeypatch.syspath_prepend(tmp_path / "lib")
    options = {"call": "some_package_of_mine.module:f", "columns": {"x": ""}}
    assert [row["x"] for row in rows(planned("", measure=[{"function": options}]))] == [4.0, 4.0]


def test_a_boundary_may_be_searched_by_a_function(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("def soft(point):\n    return point.parameters['k'] < 321.0\n")
    refine = {"key": "parameters.k", "start": 1, "end": 1e4, "holds": "x", "within": 1e-4}
    (row,) = rows(planned("soft", {"x": "boolean"}, vary=None, operator=None, refine=refine))
    assert row["boundary"] < 321.0 <= row["boundary_fails"] <= 1.0001 * row["boundary"]


def test_without_dask_a_measure_is_parsed_without_loading_anything() -> None:
    measure = parse_measure({"function": {"call": "nowhere:f", "columns": {"x": "m"}}})
    assert measure.columns[0].unit == "m"


@pytest.mark.parametrize("threads", rest_slow([True, False]))
def test_a_study_with_functions_that_fail_and_hang_ends_with_a_row_each(threads: bool) -> None:
    text = dedent("""
        import time

        def some(point):
            n = point.parameters["n"]
            if n == 3:
                raise LookupError("three")
            if n == 5:
                while True:
                    pass
            return n * n
    """)
    Path("mine.py").write_text(text)
    study = {
        "vary": {"parameters.n": {"low": 0, "high": 9, "count": 10}},
        "measure": [{"function": {"call": "mine:some", "columns": {"square": ""}, "timeout_s": 2}}],
    }
    table = hapticd.sweep(study, workers=2, threads=threads)
    assert len(table) == 10
    for n, square, why in zip(table["parameters.n"], table["square"], table["error"], strict=True):
        if n == 3:
            assert why == "mine:some: raised LookupError: three (mine.py, line 7)"
        elif n == 5:
            assert why == "mine:some: timed out after 2 s and was killed (timeout_s)"
        else:
            assert square == n * n and not isinstance(why, str)


def test_a_point_is_a_row_if_no_process_can_be_started(monkeypatch: pytest.MonkeyPatch) -> None:
    found = planned("alone", vary=None)

    def refused(*_: Any, **__: Any) -> None:
        raise OSError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(function_process.subprocess, "Popen", refused)
    (row,) = rows(found)
    assert row["error"] == "cannot start a process for mine:alone: Resource temporarily unavailable"
    with pytest.raises(HapticdError):
        function_process.process_of(function_process.Function("a", "b", "", "a.py", "", (("x", "number"),)))
