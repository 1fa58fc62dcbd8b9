"""Operators of the simulated hand: messages, files, and gestures whose motion is checked on a held handle."""

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from hapticd.base.core import ffi, lib, pointer
from hapticd.base.errors import HapticdError, InvalidError
from hapticd.config.operator import MAX_WAYPOINTS, Grip, Operator, Target, load_operator, parse_operator

FLOOR = Target(point_m=(0.0, 0.0), normal=(0.0, 1.0), stiffness_n_per_m=800.0, rupture_depth_m=None)
SLOPE = Target(point_m=(0.01, -0.02), normal=(0.6, 0.8), stiffness_n_per_m=800.0, rupture_depth_m=None)
SKIN = Target(point_m=(0.0, 0.01), normal=(0.0, 1.0), stiffness_n_per_m=600.0, rupture_depth_m=0.004)
HAND = Grip(stiffness_n_per_m=300.0, damping_n_s_per_m=5.0, moving_mass_kg=0.05)


def faults(error: pytest.ExceptionInfo[InvalidError]) -> list[tuple[str, str]]:
    return [(problem.where, problem.problem) for problem in error.value.problems]


def gesture(
    target: Target | None = FLOOR, reference: tuple[float, float] = (0.0, 0.03), **fields: Any
) -> npt.NDArray[np.float64]:
    operator = parse_operator({"gesture": {"object": "it", **fields}})
    assert operator.interpolation == "linear"
    return operator.waypoints_for({"it": target}.get, HAND, reference)


# ---- messages ---------------------------------------------------------------------------------------------


def test_waypoints_stay_unchanged() -> None:
    rows = [[0.0, 0.01, -0.02], [1, 0, 0.5], [1.5, -0.03, 2e-3]]
    for given in (rows, tuple(map(tuple, rows)), np.array(rows)):
        for chosen in ({}, {"interpolation": "linear"}, {"interpolation": "minimum_jerk"}):
            operator = parse_operator({"waypoints": given, **chosen})
            assert operator.interpolation == chosen.get("interpolation", "linear")
            path = operator.waypoints_for(lambda id: None, HAND, (0.0, 0.0))
            np.testing.assert_array_equal(path, rows)
            assert path.dtype == np.float64


@pytest.mark.parametrize(
    ("params", "expected"),
    [
        ({}, [("", "needs exactly one of waypoints and gesture")]),
        ({"waypoints": None}, [("", "needs exactly one of waypoints and gesture")]),
        ({"waypoints": 3}, [("waypoints", "should be a list, is 3")]),
        ({"waypoints": []}, [("waypoints", "List should have at least 1 item after validation, not 0")]),
        (
            {"waypoint": []},
            [("waypoint", "unknown key; did you mean waypoints?")],
        ),
        (
            {"waypoints": [[0, 0, 0]], "interpolation": "cubic"},
            [("interpolation", "should be 'linear' or 'minimum_jerk', is \"cubic\"")],
        ),
        ({"waypoints": [[0, 0, 0], [1, 0], 7]}, [("waypoints[1][2]", "Field required")]),
        ({"waypoints": [7, 8]}, [("waypoints[0]", "should be a list, is 7")]),
        (
            {"waypoints": [[0, "1", True], 7]},
            [
                ("waypoints[0][1]", 'should be a valid number, is "1"'),
                ("waypoints[0][2]", "should be a valid number, is true"),
            ],
        ),
        (
            {"waypoints": [[-1, 11, math.nan]]},
            [
                ("waypoints[0][0]", "should be greater than or equal to 0, is -1"),
                ("waypoints[0][1]", "should be less than or equal to 10, is 11; if it is in mm, write 0.011"),
                ("waypoints[0][2]", "should be a finite number, is nan"),
            ],
        ),
        (
            {"waypoints": [[0, 0, 0], [1.0, 0, 0], [1.0, 0, 0], [0.5, 0, 0], [2, 0, 0]]},
            [("waypoints[2][0]", "must be at least 1e-05 later than 1.0 before it, is 1.0")],
        ),
        ({"gesture": {}}, [("gesture.kind", "Field required")]),
        (
            {"gesture": {"kind": "tab"}},
            [
                (
                    "gesture.kind",
                    "should be one of 'tap', 'stroke', 'puncture', is \"tab\"",
                )
            ],
        ),
        (
            {"gesture": {"kind": "tap"}},
            [("gesture.object", "Field required"), ("gesture.speed_m_per_s", "Field required")],
        ),
        (
            {"gesture": {"kind": "tap", "object": "a", "speed_m_per_s": 0, "count": 1.5}},
            [
                ("gesture.speed_m_per_s", "should be greater than or equal to 0.001, is 0"),
                ("gesture.count", "should be a valid integer, is 1.5"),
            ],
        ),
        (
            {"gesture": {"kind": "puncture", "object": "a", "speed_m_per_s": 0.1, "press_n": 1}},
            [("gesture.press_n", "unknown key; known: kind, object, speed_m_per_s, at_m, height_m")],
        ),
        (
            {
                "gesture": {
                    "kind": "stroke",
                    "object": "a",
                    "speed_m_per_s": 0.1,
                    "press_n": 1,
                    "from_m": 0.01,
                    "to_m": 0.01,
                }
            },
            [("gesture", "from_m and to_m must differ")],
        ),
        (
            {"gesture": {"kind": "tap", "object": "a", "speed_m_per_s": 0.1}, "interpolation": "linear"},
            [("", "interpolation belongs to waypoints; a gesture is made of straight lines")],
        ),
    ],
)
def test_every_fault_is_named(params: Mapping[str, object], expected: list[tuple[str, str]]) -> None:
    with pytest.raises(InvalidError) as error:
        parse_operator(params)
    assert faults(error) == expected


@pytest.mark.long
def test_a_list_of_faulty_waypoints_gives_few_problems() -> None:
    with pytest.raises(InvalidError) as error:
        parse_operator({"waypoints": [["x", "y", "z"]] * MAX_WAYPOINTS})
    assert len(error.value.problems) == 3
    with pytest.raises(InvalidError, match="at most 100000 entries"):
        parse_operator({"waypoints": [[time_s, 0, 0] for time_s in [0] * (MAX_WAYPOINTS + 1)]})


# ---- files ------------------------------------------------------------------------------------------------

POINTS = [[0.0, 0.01, 0.0], [0.5, -0.01, 0.02]]


@pytest.mark.parametrize(
    ("name", "text", "interpolation"),
    [
        (
            "a.yaml",
            "waypoints:\n  - [0, 0.01, 0]\n  - [0.5, -1e-2, 0.02]\ninterpolation: minimum_jerk\n",
            "minimum_jerk",
        ),
        ("a.json", '{\n\t"waypoints": [[0, 0.01, 0],\t[0.5, -1e-2, 0.02]]\n}\n', "linear"),
        ("a.csv", "t_s,x_m,y_m\n0,0.01,0\n0.5,-1e-2,0.02\n", "linear"),
        ("a.CSV", "\ufefft_s, x_m, y_m\r\n0, 0.01, 0\r\n\r\n0.5, -1e-2, 0.02\r\n", "linear"),
        ("b.csv", "0,0.01,0\n\n.5,-.01,.02", "linear"),
        ("c.csv", "sep=;\nt_s;x_m;y_m\n0;0,01;0\n0,5;-0,01;0,02\n", "linear"),
        ("d.csv", "Stage: A, 3\nDate: Mon, 12:00\ny (mm),t_ms,load,X [cm]\n0,0,a,1\n20,500,b,-1\n", "linear"),
        ("e.csv", "Time\tx\ty\ns\tmm\tmm\n0\t10\t0\n0,5\t-10\t20\n", "linear"),
        ("f.csv", "# t_s,x_m,y_m\n0,0.01,0\n0.5,-1e-2,0.02\n", "linear"),
        ("g.csv", "# t (ms) x (mm) y (mm)\n# by hand\n0 10 0\n500 -10 20\n", "linear"),
    ],
)
def test_a_file(tmp_path: Path, name: str, text: str, interpolation: str) -> None:
    file = tmp_path / name
    file.write_bytes(text.encode())
    for path in (file, str(file)):
        operator = load_operator(path)
        assert operator.interpolation == interpolation
        np.testing.assert_allclose(operator.waypoints_for(lambda id: None, HAND, (0, 0)), POINTS, rtol=1e-15)


def test_a_file_with_a_gesture(tmp_path: Path) -> None:
    file = tmp_path / "tap.yaml"
    file.write_text("gesture: {kind: tap, object: table, speed_m_per_s: 0.2}\n")
    operator = load_operator(file)
    assert operator.gesture is not None and operator.gesture.object == "table"


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        (
            "a.yaml",
            "waypoints:\n  - [0, 0, 0]\n  - [0.5, zero, 0]\n  - [1, 0]\n",
            [(":3:11: waypoints[1][1]", 'should be a valid number, is "zero"')],
        ),
        ("a.yaml", "- [0, 0, 0]\n", [(":1:1", "must be a mapping with waypoints or gesture")]),
        ("a.yaml", "", [(":1:1", "must be a mapping with waypoints or gesture")]),
        (
            "a.json",
            '{\n"gesture": {"kind": "tap",\n"object": "a", "speed_m_per_s": "1"}}',
            [(":3:16: gesture.speed_m_per_s", 'should be a valid number, is "1"')],
        ),
        (
            "a.csv",
            "t_s,x_m,y_m\n0,0,0\n\n0.5,x,0\n1,0\n0.9,0,0,\n",
            [(":4", 'must hold numbers, holds "x"')],
        ),
        (
            "a.csv",
            "0,0,0\n1,0,0,\n",
            [(":2", "must have 3 columns, has 4")],
        ),
        (
            "a.csv",
            "t,x,y\n0,0,0\n",
            [
                (
                    ":1",
                    "the columns must be t_s,x_m,y_m, or be named with other units of time and length as in "
                    't (ms),x (mm),y (mm); they are "t,x,y"',
                )
            ],
        ),
        (
            "a.csv",
            "0,0,0\n0,0,0\n",
            [(":2:1: waypoints[1][0]", "must be at least 1e-05 later than 0.0 before it, is 0.0")],
        ),
        (
            "a.csv",
            "0,1_0,nan\n",
            [(":1", 'must hold numbers, holds "1_0"')],
        ),
        (
            "a.csv",
            "t_s,x_m,y_m\nt_s,0,0\n",
            [(":2", 'must hold numbers, holds "t_s"')],
        ),
        (
            "a.csv",
            "t_s,x_m,y_m\nms,mm,mm\n0,0,0\n",
            [
                (
                    ":1",
                    "the time is in s by the name of its column 't_s', in ms by the line of units: correct one of them",
                )
            ],
        ),
        ("a.csv", "", [(":1", "is empty")]),
        ("a.csv", "t_s,x_m,y_m\n", [(":1", "holds no line of numbers in lines 1 to 1")]),
    ],
)
def test_a_fault_in_a_file_has_its_line(tmp_path: Path, name: str, text: str, expected: list[tuple[str, str]]) -> None:
    file = tmp_path / name
    file.write_text(text)
    with pytest.raises(InvalidError) as error:
        load_operator(file)
    found = [(where.removeprefix(str(file)), text) for where, text in faults(error)]
    assert found[: len(expected)] == expected


def test_a_file_that_cannot_be_read(tmp_path: Path) -> None:
    for name in ("none.csv", "none.yaml", "none.json"):
        with pytest.raises(HapticdError, match=f"{name}: cannot be read"):
            load_operator(tmp_path / name)
    file = tmp_path / "a.csv"
    file.write_bytes(b"0,0,0\n1,\xff,0\n")
    with pytest.raises(InvalidError, match=r'a\.csv:2: must hold numbers, holds "ÿ"'):
        load_operator(file)


# ---- gestures: their lines --------------------------------------------------------------------------------


def along(target: Target, path: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return the coordinates of a path along and above a surface."""
    x, y = path[:, 1] - target.point_m[0], path[:, 2] - target.point_m[1]
    n_x, n_y = target.normal
    return x * n_y - y * n_x, x * n_x + y * n_y


ALL = {
    "tap": {"kind": "tap", "speed_m_per_s": 0.2, "count": 3, "at_m": 0.012},
    "stroke": {"kind": "stroke", "speed_m_per_s": 0.1, "press_n": 1.0, "from_m": -0.01, "to_m": 0.02, "count": 2},
    "puncture": {"kind": "puncture", "speed_m_per_s": 0.05, "at_m": -0.003},
}


@pytest.mark.parametrize("reference", [(0.0, 0.05), (0.03, 0.001), (-0.02, -0.03)])
@pytest.mark.parametrize("kind", ALL)
def test_a_path_starts_at_the_reference_and_is_in_order(kind: str, reference: tuple[float, float]) -> None:
    target = replace(SLOPE, rupture_depth_m=0.003)
    path = gesture(target, reference, **ALL[kind])
    times = np.concatenate([[0.0], path[:, 0]])
    assert (np.diff(times) >= 1e-5).all()
    points = np.vstack([reference, path[:, 1:]])
    speeds = np.hypot(*np.diff(points, axis=0).T) / np.diff(times)
    fields = ALL[kind]
    assert speeds.max() == pytest.approx(max(0.15, float(str(fields["speed_m_per_s"]))), rel=1e-9)
    # The path touches nothing before the gesture: once above the surface, it stays above.
    _, heights = along(target, np.column_stack([times, points]))
    first = int(np.argmax(heights > 0.004))
    lowest = int(np.argmin(heights[first:])) + first
    assert (heights[first:lowest] > 0).all() or kind == "stroke"
    assert heights[-1] > 0.004


def test_a_path_that_begins_where_the_hand_is() -> None:
    path = gesture(FLOOR, (0.0, 0.04), kind="tap", speed_m_per_s=0.1, height_m=0.04, press_depth_m=0.01)
    np.testing.assert_allclose(path[:, 1:], [[0, 0.04], [0, -0.01], [0, -0.01], [0, 0.04]], atol=1e-15)
    assert path[1, 0] - path[0, 0] == pytest.approx(0.5)


def test_a_gesture_that_does_not_fit_its_object() -> None:
    for target, fields, expected in (
        (
            None,
            ALL["tap"],
            ("gesture.object", 'no wall, membrane, box or disc of the scene has the id "it"; known: none'),
        ),
        (
            FLOOR,
            ALL["puncture"],
            ("gesture.object", '"it" cannot be punctured: not a membrane, or its material has no rupture'),
        ),
        (
            replace(FLOOR, stiffness_n_per_m=0.0),
            ALL["stroke"],
            ("gesture.object", '"it" has no stiffness to press against'),
        ),
    ):
        with pytest.raises(InvalidError) as error:
            gesture(target, **fields)
        assert faults(error) == [expected]
    operator = parse_operator({"gesture": {"object": "it", **ALL["tap"]}})
    with pytest.raises(InvalidError, match="needs a hand"):
        operator.waypoints_for({"it": FLOOR}.get, Grip(stiffness_n_per_m=0.0), (0, 0))


@pytest.mark.parametrize("kind", ALL)
def test_a_gesture_beyond_the_end_of_a_surface(kind: str) -> None:
    fields = ALL[kind]
    places = {name: float(str(value)) for name, value in fields.items() if name in ("at_m", "from_m", "to_m")}
    skin = replace(SLOPE, rupture_depth_m=0.003, face="face")
    farthest = max(map(abs, places.values()))
    assert gesture(replace(skin, half_m=farthest), **fields).tolist() == gesture(skin, **fields).tolist()
    for half in (0.005, math.nextafter(farthest, 0), 0.001):
        expected = [
            (f"gesture.{name}", f"{at:.15g} is beyond the face, which ends at {math.copysign(half, at):.15g}")
            for name, at in places.items()
            if abs(at) > half
        ]
        if expected:
            with pytest.raises(InvalidError) as error:
                gesture(replace(skin, half_m=half), **fields)
            assert faults(error) == expected
    with pytest.raises(InvalidError, match=r"^gesture.at_m: 0.02 is beyond the face, which ends at 0.005$"):
        gesture(replace(skin, half_m=0.005), kind="tap", speed_m_per_s=0.2, at_m=0.02)
    with pytest.raises(InvalidError, match=r"^gesture.at_m: -0.02 is beyond the face, which ends at -0.005$"):
        gesture(replace(skin, half_m=0.005), kind="tap", speed_m_per_s=0.2, at_m=-0.02)


@pytest.mark.long
@pytest.mark.parametrize("damping", [1.0, 3.0, 5.0, 2 * math.sqrt(300 * 0.05), 9.0, 20.0])
def test_settling(damping: float) -> None:
    """The settling time agrees with the integration of M e'' + b e' + k e = 0 from e(0) = 1, e'(0) = -b/M."""
    grip = Grip(stiffness_n_per_m=300.0, damping_n_s_per_m=damping, moving_mass_kg=0.05)
    step_s = 1e-5
    system = np.array([[0.0, 1.0], [-300 / 0.05, -damping / 0.05]]) * step_s
    forward = np.eye(2) + system + system @ system / 2 + system @ system @ system / 6
    state, last = np.array([1.0, -damping / 0.05]), 0.0
    for step in range(100_000):
        if abs(state[0]) > 0.01:
            last = step * step_s
        state = forward @ state
    assert last <= grip.settling_s <= last + 0.002


# ---- gestures: what they do to a handle that is held ------------------------------------------------------


@dataclass(frozen=True)
class Held:
    """Heights, speeds and depths of the default handle and hand against a spring surface at 10 kHz."""

    along: npt.NDArray[np.float64]
    height: npt.NDArray[np.float64]
    speed: npt.NDArray[np.float64]
    force: npt.NDArray[np.float64]
    broke: int | None


def held(target: Target, reference: tuple[float, float], path: npt.NDArray[np.float64]) -> Held:
    config = ffi.new("struct hd_sim_config *")
    config.handle_mass_kg, config.handle_damping_n_s_per_m, config.coulomb_friction_n = 0.04, 0.2, 0.05
    config.max_force_n, config.workspace_m, config.force_timeout_s = 8.9, 0.075, 0.1
    config.hand_mass_kg, config.hand_stiffness_n_per_m, config.hand_damping_n_s_per_m = 0.01, 300.0, 5.0
    config.start_m = reference
    sim = ffi.gc(lib.hd_sim_new(config, 1e-4), lib.hd_sim_free)
    points = np.ascontiguousarray(path)
    operator = ffi.gc(lib.hd_operator_new(pointer("double[]", points), len(points), 0), lib.hd_operator_free)
    lib.hd_sim_operate(sim, operator)
    position, velocity, command = (ffi.new("double[2]") for _ in range(3))
    n_x, n_y = target.normal
    rows, broke = [], None
    for tick in range(int(path[-1, 0] * 1e4)):
        lib.hd_sim_truth(sim, position, velocity, command)
        x, y = position[0] - target.point_m[0], position[1] - target.point_m[1]
        height = x * n_x + y * n_y
        if target.rupture_depth_m is not None and height < -target.rupture_depth_m and broke is None:
            broke = tick
        force = target.stiffness_n_per_m * max(0.0, -height) if broke is None else 0.0
        lib.hd_sim_put(sim, ffi.new("double[2]", [force * n_x, force * n_y]))
        lib.hd_sim_advance(sim, 1)
        rows.append((x * n_y - y * n_x, height, velocity[0] * n_x + velocity[1] * n_y, force))
    return Held(*np.array(rows).T, broke)


def onsets(run: Held) -> Iterator[int]:
    below = run.height < 0
    yield from np.flatnonzero(below[1:] & ~below[:-1]) + 1


@pytest.mark.parametrize("speed", [0.02, 0.1, 0.3, 0.5])
@pytest.mark.parametrize(("target", "stiffness"), [(FLOOR, 800.0), (SLOPE, 800.0), (FLOOR, 4000.0)])
def test_a_tap_meets_the_surface_at_its_speed_and_stays(target: Target, stiffness: float, speed: float) -> None:
    target = replace(target, stiffness_n_per_m=stiffness)
    reference = (0.02, 0.02)
    path = gesture(target, reference, kind="tap", speed_m_per_s=speed, count=2, at_m=0.01)
    run = held(target, reference, path)
    taps = list(onsets(run))
    assert len(taps) == 2
    for tick in taps:
        # The tolerance is 1 % of the speed, and the remaining effect of friction after an oblique start.
        assert -run.speed[tick] == pytest.approx(speed, rel=0.012)
        assert run.along[tick] == pytest.approx(0.01, abs=5e-4)
        # The handle rests on the surface long enough for the slowest mode of the library to decay.
        assert (run.height[tick : tick + 1000] < 0).all()


@pytest.mark.parametrize("press", [0.2, 1.0, 3.0])
def test_a_stroke_presses_with_the_given_force(press: float) -> None:
    reference = (0.0, 0.03)
    fields = {**ALL["stroke"], "press_n": press, "count": 3}
    run = held(FLOOR, reference, gesture(FLOOR, reference, **fields))
    touching = list(onsets(run))
    assert len(touching) == 1
    inside = (run.along > -0.005) & (run.along < 0.015) & (run.height < 0)
    inside[: touching[0] + 3000] = False
    # The force may be too small by the friction, but not by more.
    assert run.force[inside] == pytest.approx(press, abs=0.05 + 1e-3)
    assert run.along[run.height < 0].min() == pytest.approx(-0.01, abs=2e-3)
    assert run.along[run.height < 0].max() == pytest.approx(0.02, abs=2e-3)
    passes = [sign for sign, _ in itertools.groupby(np.sign(np.diff(run.along[inside])[::50])) if sign]
    assert passes == [1, -1, 1]


@pytest.mark.long
@pytest.mark.parametrize("stiffness", [100.0, 600.0, 2000.0])
@pytest.mark.parametrize("speed", [0.005, 0.05, 0.3])
def test_a_puncture_breaks_through(speed: float, stiffness: float) -> None:
    target = replace(SKIN, stiffness_n_per_m=stiffness)
    reference = (0.01, 0.05)
    run = held(target, reference, gesture(target, reference, kind="puncture", speed_m_per_s=speed))
    assert run.broke is not None
    assert run.height[-1] > 0


def test_an_operator_cannot_be_changed() -> None:
    operator = parse_operator({"waypoints": POINTS})
    with pytest.raises(AttributeError):
        operator.interpolation = "minimum_jerk"  # type: ignore[misc]
    assert isinstance(operator, Operator)
