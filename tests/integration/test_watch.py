"""The live view: what it draws, and that it lives on a real terminal and a real daemon."""

from __future__ import annotations

import fcntl
import json
import math
import os
import pty
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticd.client.watch import View, bar, draw_scene, event_line, signed_bar
from hapticd.protocol.results import State, Status
from tests.support.daemon_process import PATIENCE_S, Daemon, connect, running_daemon

ROOT = Path(__file__).parents[2]
SCENE: dict[str, Any] = {
    "objects": {
        "floor": {"kind": "wall", "point_m": [0.0, 0.0], "normal": [0.0, 1.0], "material": "wood"},
        "skin": {"kind": "membrane", "center_m": [0.0, 0.04], "normal": [0.0, 1.0], "width_m": 0.06, "material": "x"},
        "honey": {"kind": "viscous", "damping_n_s_per_m": 1.0},
    }
}


def status(**members: Any) -> Status:
    plain = {
        "version": "1.2.3",
        "protocol": 1,
        "state": "running",
        "device": "sim",
        "rate_hz": 10000.0,
        "realtime": None,
        "revision": 3,
        "tick": 5,
        "forces": "on",
        "faults": [],
        "lease_s": None,
        "counters": {"overruns": 0, "skipped": 0},
        "undisplayable": [],
    }
    return plain | members  # type: ignore[return-value]


def state(tick: int = 100, **members: Any) -> State:
    plain = {
        "tick": tick,
        "time_ns": tick * 100_000,
        "position_m": [0.01, 0.02],
        "velocity_m_per_s": [0.1, -0.2],
        "contact_force_n": [0.0, 0.0],
        "vibration_force_n": [0.0, 0.0],
        "force_n": [0.0, 0.0],
        "revision": 3,
        "flags": 32,
        "lateness_ns": 12_000,
        "work_ns": 300,
        "touching": [],
        "flag_names": ["forces_on"],
    }
    return plain | members  # type: ignore[return-value]


def event(kind: str, **members: Any) -> dict[str, Any]:
    return {"event": kind, "tick": 1, "time_ns": 100_000, **members}


def contact(name: str) -> dict[str, Any]:
    return event("contact", object=name, appeared=False, speed_m_per_s=0.1, amplitude_m_per_s2=31.0, scale=1.0)


def view(**members: Any) -> View:
    shown = View()
    shown.feed("status", status())
    shown.feed("state", state(tick=90))
    shown.feed("state", state(**members))
    shown.set_scene(SCENE, 3)
    return shown


def drawn(shown: View, width: int = 80, height: int = 24) -> list[str]:
    return shown.render(width, height).plain.split("\n")


def test_it_fits_the_terminal() -> None:
    shown = view(force_n=[-123.0, 99.0], touching=["a" * 100])
    shown.feed("event", contact("x" * 200) | {"time_ns": 10**18})
    for width, height in ((80, 24), (120, 50), (200, 24), (40, 10), (1, 1), (20, 3)):
        lines = drawn(shown, width, height)
        assert len(lines) == height
        assert max(map(len, lines)) <= width


def test_it_shows_what_matters() -> None:
    shown = view(force_n=[0.0, 1.25], contact_force_n=[0.0, 1.0], vibration_force_n=[0.0, 0.25], touching=["floor"])
    shown.feed(
        "status", status(forces="faulted", faults=["lease"], counters={"overruns": 7, "skipped": 9}, lease_s=2.0)
    )
    text = "\n".join(drawn(shown))
    for wanted in (
        "hapticd 1.2.3",
        "sim",
        "10 kHz",
        "forces faulted",
        "+10.000  +20.000 mm",
        "+100.0   -200.0 mm/s",
        "+1.25 N",
        "touching   floor",
        "rate       10,000 Hz",
        "12 us",
        "300 ns",
        "missed     9 periods, 7 times",
        "faults     lease",
        "lease      2.0 s left",
    ):
        assert wanted in text, wanted


def test_forces_that_are_held_back_are_not_shown_as_on() -> None:
    shown = view()
    for state_of_signs, problem, wanted in (
        ("checking", None, "signs are checked"),
        ("waiting", "idle", "device exerts no force"),
        ("right", None, "forces on"),
    ):
        shown.feed("status", status(connection={"signs": {"state": state_of_signs, "problem": problem}}))
        assert wanted in drawn(shown)[0]


def test_the_warnings_of_the_connection_are_shown_completely() -> None:
    shown = view()
    first, second = "the handle rests inside floor: " + "long " * 20 + "end", "axis y reported -327..396"
    shown.feed("status", status(connection={"warnings": [first, second]}))
    lines = drawn(shown)
    assert " ".join(" ".join(lines[1:4]).split()) == f"{first} {second}"
    assert len(lines) == 24
    assert "missed" in "\n".join(lines)


def test_before_anything_came_and_after_the_daemon_left() -> None:
    assert "connecting" in drawn(View())[0]
    shown = view()
    shown.lost_for_s = 3.0
    assert "daemon lost: nothing for 3 s" in drawn(shown)[0]
    assert not shown.wants_scene
    shown.feed("state", state(tick=200))
    assert "daemon lost" not in drawn(shown)[0]


def test_the_picture_shows_probe_wall_and_membrane() -> None:
    lines = [line[:46] for line in drawn(view())[1:19]]
    probe_row = next(row for row, line in enumerate(lines) if "●" in line)
    probe_column = lines[probe_row].index("●")
    skin_row = next(row for row, line in enumerate(lines) if "─" in line)
    floor_row = next(row for row, line in enumerate(lines) if "░" in line)
    assert skin_row < probe_row < floor_row, "from the top: 40 mm, 20 mm, 0"
    assert probe_column > 46 / 2, "to the right of the middle"
    assert all(set(line) == {"░"} for line in lines[floor_row:])
    # A character is as wide as the plane's 160 mm over twice the 18 rows, and twice as high.
    cell_m = 0.16 / 36
    assert probe_column == int(0.01 / cell_m + 46 / 2)
    assert probe_row == int(18 / 2 - 0.02 / (2 * cell_m))


def test_a_probe_outside_widens_the_picture() -> None:
    assert any("●" in line for line in drawn(view(position_m=[0.0, -0.3])))


@pytest.mark.long
@given(
    st.floats(-10, 10),
    st.floats(-10, 10),
    st.floats(-1e9, 1e9),
    st.floats(-1e9, 1e9),
    st.floats(1e-4, 20),
    st.integers(1, 60),
)
def test_any_scene_can_be_drawn(x: float, y: float, nx: float, ny: float, width: float, size: int) -> None:
    objects = {
        "wall": {"kind": "wall", "point_m": [x, y], "normal": [nx, ny]},
        "skin": {"kind": "membrane", "center_m": [x, y], "normal": [nx, ny], "width_m": width},
    }
    cells = draw_scene({"objects": objects}, size, size, 0.004)
    assert len(cells) == size and {len(row) for row in cells} == {size}


def plane(objects: dict[str, dict[str, Any]], columns: int, rows: int, cell_m: float) -> npt.NDArray[np.str_]:
    """The scene in single characters."""
    return np.array([list(row) for row in draw_scene({"objects": objects}, columns, rows, cell_m)])


def test_membranes_are_lines_that_lean_as_they_do() -> None:
    for normal, shape in (([0, 1], (1, 10)), ([-2, 0], (5, 2))):
        skin = {"kind": "membrane", "center_m": [0.0, 0.004], "normal": normal, "width_m": 0.04, "material": "x"}
        rows, columns = np.nonzero(plane({"skin": skin}, 40, 20, 0.004) == "─")
        assert (np.ptp(rows) + 1, np.ptp(columns) + 1) == shape


def test_walls_are_shaded_where_they_are_solid() -> None:
    wall = {"kind": "wall", "point_m": [0.0, 0.0], "normal": [1.0, 0.0]}
    cells = plane({"wall": wall}, 10, 4, 0.01)
    assert (cells[:, :5] == "░").all() and (cells[:, 5:] == " ").all()


def test_boxes_and_discs_are_drawn_where_they_are() -> None:
    box = {"kind": "box", "center_m": [-0.02, 0.01], "size_m": [0.02, 0.004], "angle_rad": math.pi / 2}
    disc = {"kind": "disc", "center_m": [0.02, -0.01], "radius_m": 0.008}
    cells = plane({"box": box, "disc": disc}, 80, 40, 0.001)
    x = (np.arange(80) - 39.5) * 0.001
    y = (19.5 - np.arange(40)) * 0.002
    upright = (abs(x[None, :] + 0.02) < 0.002) & (abs(y[:, None] - 0.01) < 0.01)
    round_ = np.hypot(x[None, :] - 0.02, y[:, None] + 0.01) < 0.008
    assert np.array_equal(cells != " ", upright | round_)


def test_bars() -> None:
    assert bar(0, 2, 4) == "····" and bar(1, 2, 4) == "██··" and bar(9, 2, 4) == "████"
    assert signed_bar(0, 2, 4) == "··│··"
    assert signed_bar(1, 2, 4) == "··│█·" and signed_bar(-2, 2, 4) == "██│··" and signed_bar(99, 2, 4) == "··│██"


@pytest.mark.parametrize(
    ("event", "words"),
    [
        (
            {"event": "contact", "object": "floor", "speed_m_per_s": 0.1234, "amplitude_m_per_s2": 31.0, "scale": 1.0},
            "contact floor at 0.123 m/s, 31.0 m/s²",
        ),
        (
            {"event": "contact", "object": "a", "speed_m_per_s": 0.1, "amplitude_m_per_s2": 31.0, "scale": 0.5},
            "contact a at 0.100 m/s, 31.0 m/s² scaled to 0.50 by the force limit",
        ),
        (
            {"event": "contact", "object": "a", "speed_m_per_s": 0.1, "amplitude_m_per_s2": 31.0, "scale": 0.0},
            "contact a at 0.100 m/s, 31.0 m/s² not displayed",
        ),
        ({"event": "contact", "object": "a", "appeared": True}, "contact a appeared around the probe"),
        ({"event": "puncture", "object": "skin", "depth_m": 0.004}, "puncture skin at 4.00 mm"),
        ({"event": "fault", "faults": ["lease", "device"]}, "fault lease, device"),
        ({"event": "fault", "faults": []}, "fault cleared"),
        ({"event": "saturation", "wanted_n": 12.0}, "saturation wanted 12.00 N"),
        ({"event": "overrun", "missed": 1}, "overrun 1 period missed"),
        ({"event": "overload", "missed_share": 0.123}, "overload 12 % of a second's periods missed"),
        ({"event": "rate", "rate_hz": 5000.0}, "rate 5 kHz from now on"),
        ({"event": "mark", "text": "trial 3"}, "mark trial 3"),
        ({"event": "gesture_end", "completed": True}, "gesture end completed"),
        ({"event": "glitch", "speed_m_per_s": 100.0}, "glitch a jump of 100 m/s"),
        ({"event": "revision", "revision": 4}, "revision 4"),
        ({"event": "device_lost"}, "device lost"),
        ({"event": "something_new", "x": 1}, "something new"),
    ],
)
def test_events_in_words(event: dict[str, object], words: str) -> None:
    assert event_line(event) == words


def test_a_stream_of_updates_leaves_room_for_other_events() -> None:
    shown = view()
    shown.feed("event", event("puncture", object="skin", depth_m=0.004))
    for revision in range(100):
        shown.feed("event", event("revision", revision=revision))
        shown.feed("event", event("overrun", missed=1))
    text = "\n".join(drawn(shown))
    assert "puncture skin" in text and "revision 99" in text and "revision 98" not in text


def test_a_new_daemon_is_taken_for_one() -> None:
    shown = view(tick=1_000_000)
    assert not shown.wants_scene
    shown.feed("state", state(tick=5))
    assert shown.wants_scene, "its scene may be another under the same revision"
    assert shown.rate_hz is None


# ---- on a real daemon ------------------------------------------------------------------------------------------


@pytest.fixture
def quiet_config(tmp_path: Path) -> str:
    path = tmp_path / "quiet.yaml"
    path.write_text("servo: {rate_hz: 1000, realtime: off}\n")
    return str(path)


@pytest.fixture
def daemon(quiet_config: str) -> Iterator[Daemon]:
    with running_daemon("-c", quiet_config) as daemon:
        yield daemon


def arguments(daemon: Daemon, *more: str) -> list[str]:
    return [sys.executable, "-m", "hapticd", "--runtime-dir", str(daemon.directory), "watch", *more]


class Terminal:
    """A command on a pseudo-terminal of 80x24."""

    def __init__(self, command: list[str]) -> None:
        self._master, slave = pty.openpty()
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
        environment = {**os.environ, "TERM": "xterm-256color", "COLUMNS": "80", "LINES": "24", "LC_ALL": "C.UTF-8"}
        self.process = subprocess.Popen(
            command,
            stdin=slave,
            stdout=slave,
            stderr=subprocess.PIPE,
            cwd=ROOT,
            env=environment,
            start_new_session=True,
        )
        os.close(slave)
        self.output = b""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()

    def read_until(self, wanted: str) -> None:
        """Reads on until `wanted` was written after what was read before."""
        start = len(self.output)
        deadline = time.monotonic() + 60
        while wanted.encode() not in self.output[start:]:
            assert time.monotonic() < deadline, self.output[start:].decode(errors="replace")
            if select.select([self._master], [], [], 1.0)[0]:
                self.output += os.read(self._master, 65536)

    def hang_up(self) -> tuple[int, bytes]:
        """The terminal goes away, and nobody is sent SIGHUP: it is the controlling one of none."""
        os.close(self._master)
        assert self.process.stderr is not None
        with self.process.stderr:
            return self.process.wait(PATIENCE_S), self.process.stderr.read()

    def end(self, number: int) -> tuple[int, bytes]:
        self.process.send_signal(number)
        return self.wait()

    def wait(self) -> tuple[int, bytes]:
        """Its exit code, and what it said on stderr."""
        assert self.process.stderr is not None
        with self.process.stderr:
            # What it still writes must be read, or it never ends.
            with suppress(OSError):  # the other end is closed: all is read
                while True:
                    self.output += os.read(self._master, 65536)
            os.close(self._master)
            return self.process.wait(PATIENCE_S), self.process.stderr.read()


@pytest.mark.long
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_on_a_terminal(daemon: Daemon, number: int, code: int) -> None:
    with connect(daemon.directory) as client, Terminal(arguments(daemon)) as terminal:
        client.set_scene({"objects": {"floor": SCENE["objects"]["floor"]}})
        terminal.read_until("forces on")
        terminal.read_until("●")
        terminal.read_until("░")
        client.set_forces(False)
        terminal.read_until("forces off")
        assert terminal.end(number) == (code, b"")
        assert terminal.output.endswith(b"\x1b[?25h\x1b[?1049l"), "the cursor and the screen of before are back"


@pytest.mark.slow
def test_a_daemon_that_goes_away_is_waited_for(daemon: Daemon, quiet_config: str) -> None:
    with Terminal(arguments(daemon)) as terminal:
        terminal.read_until("touching")
        daemon.stop()
        terminal.read_until("daemon lost")
        again = Daemon(daemon.directory, "-c", quiet_config)
        try:
            again.wait_ready()
            terminal.read_until("forces on")
        finally:
            assert again.stop() == 0
        assert terminal.end(signal.SIGINT) == (130, b"")


@pytest.mark.long
def test_into_a_pipe_it_prints_lines(daemon: Daemon) -> None:
    process = subprocess.Popen(arguments(daemon), stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=ROOT, text=True)
    assert process.stdout is not None and process.stderr is not None
    with process:
        # An event of before, the daemon's first revision or a busy machine's overload, may still be on its way.
        first = next(line for line in process.stdout if line.startswith("tick "))
        assert "position" in first and "forces on" in first
        with connect(daemon.directory) as client:
            revision = client.set_scene(SCENE | {"objects": {}})["revision"]
        while process.stdout.readline() != f"revision {revision}\n":
            assert process.poll() is None
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 130
        assert process.stderr.read() == ""


@pytest.mark.long
@pytest.mark.parametrize("options", [[], ["--json"]], ids=["lines", "json"])
def test_into_a_pipe_it_ends_by_itself(daemon: Daemon, options: list[str]) -> None:
    done = subprocess.run(
        arguments(daemon, "--for", "300ms", *options), capture_output=True, cwd=ROOT, text=True, timeout=PATIENCE_S
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "tick" in done.stdout
    if options:
        # A daemon that is held up is said to be lost.
        lines = [line for line in map(json.loads, done.stdout.splitlines()) if line != {"topic": "lost"}]
        assert {line["topic"] for line in lines} <= {"state", "event"}
        assert all("tick" in line for line in lines)


@pytest.mark.long
def test_on_a_terminal_it_ends_by_itself(daemon: Daemon) -> None:
    with Terminal(arguments(daemon, "--for", "300ms")) as terminal:
        terminal.read_until("hapticd")
        code, said = terminal.wait()
    assert (code, said) == (0, b"")


@pytest.mark.long
def test_it_ends_with_its_terminal(daemon: Daemon) -> None:
    with Terminal(arguments(daemon)) as terminal:
        terminal.read_until("hapticd")
        code, said = terminal.hang_up()
    assert (code, said) == (1, b"hapticd: the terminal was closed\n")
