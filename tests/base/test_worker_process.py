"""What takes long is computed in a process of its own, and comes out the same; without that process nothing changes."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from hapticd.base import lattice, worker_process
from hapticd.base.worker_process import Apart, ApartError, beside, used
from hapticd.rendering import filter_design, resampling
from tests.daemon.test_dispatch import Daemon, taken


class EndsError(Exception):
    """Raised by who works, to end it."""


def nothing() -> None:
    """Who works has nothing to do meanwhile."""


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is computed by the thread itself."""
    monkeypatch.setattr(worker_process, "HERE", 0)


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch, at_once: None) -> Iterator[list[subprocess.Popen[bytes]]]:
    """The processes that are made."""
    found: list[subprocess.Popen[bytes]] = []
    popen = subprocess.Popen

    def kept(*args: object, **options: object) -> subprocess.Popen[bytes]:
        found.append(popen(*args, **options))  # type: ignore[call-overload]
        return found[-1]

    monkeypatch.setattr(subprocess, "Popen", kept)
    yield found
    for each in found:
        assert each.returncode is not None, "a process was left"


def unstable(call: Callable[[], object]) -> str:
    """What a call says of coefficients that are not stable."""
    with pytest.raises(ValueError, match="not stable") as found:
        call()
    return str(found.value)


@pytest.mark.slow
def test_it_computes_the_same_bits(made: list[subprocess.Popen[bytes]]) -> None:
    random = np.random.default_rng(31)
    reflection = tuple(random.uniform(-0.9, 0.9, 12).tolist())
    coefficients = lattice.coefficients_of(reflection)

    def all_of_it() -> list[object]:
        for each in (lattice._reflection_of, resampling._resampled, filter_design.stochastic_filter):
            each.cache_clear()
        return [
            lattice.reflection_of(coefficients),
            resampling.resampled(reflection, 2000.0, 10_000.0),
            resampling.resampled(reflection, 10_000.0, 1000.0),
            filter_design.stochastic_filter(200.0, 301.0, 4000.0),
            lattice.pole_radius([2.5, 1.0]),
            unstable(lambda: lattice.reflection_of([2.5, 1.0])),
        ]

    here = all_of_it()
    assert not made
    with beside(nothing):
        assert all_of_it() == here
        assert len(made) == 1
        given_up = used()
    assert given_up is not None
    with pytest.raises(ApartError, match="over"), worker_process.using(given_up):
        lattice.pole_radius([0.25])
    assert used() is None and made[0].returncode == -signal.SIGKILL


def test_little_is_computed_by_the_thread_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Apart, "_make", lambda _: pytest.fail("a process was made"))
    with beside(nothing):
        for place in range(worker_process.HERE):
            assert lattice.pole_radius([0.5 + 0.01 * place]) == pytest.approx(0.5 + 0.01 * place)


@pytest.mark.slow
def test_a_process_that_is_killed_is_told_in_a_line(made: list[subprocess.Popen[bytes]]) -> None:
    with beside(nothing):
        assert lattice.pole_radius([0.25]) == pytest.approx(0.25)
        made[0].kill()
        with pytest.raises(ApartError, match="ended before it answered"):
            lattice.pole_radius([0.25])


@pytest.mark.slow
def test_who_waits_can_be_ended(made: list[subprocess.Popen[bytes]]) -> None:
    ends = False

    def working() -> None:
        if ends:
            raise EndsError

    with pytest.raises(EndsError), beside(working):
        assert lattice.pole_radius([0.25]) == pytest.approx(0.25)
        made[0].send_signal(signal.SIGSTOP)  # it never answers
        ends = True
        lattice.pole_radius([0.25])


@pytest.mark.slow
def test_it_ends_when_nobody_asks_any_more(at_once: None) -> None:
    one = Apart(nothing)
    assert one.compute(lattice.pole_radius, [0.25]) == pytest.approx(0.25)
    process, pipe = one._process, one._pipe
    assert process is not None and pipe is not None
    pipe.close()  # as a daemon does that is killed
    assert process.wait(60) == 0


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (BlockingIOError(11, os.strerror(11)), "the system refuses another thread: the user's limit"),
        (FileNotFoundError(2, os.strerror(2)), "no process that designs filters: No such file or directory"),
    ],
)
def test_a_process_that_is_refused_is_told_in_a_line(
    monkeypatch: pytest.MonkeyPatch, at_once: None, error: OSError, told: str
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(subprocess, "Popen", refuse)
    before = len(os.listdir("/proc/self/fd"))
    with beside(nothing), pytest.raises(ApartError) as found:
        lattice.pole_radius([0.25])
    assert told in str(found.value) and "\n" not in str(found.value)
    assert len(os.listdir("/proc/self/fd")) == before


def test_a_change_is_refused_without_it_and_the_next_one_is_taken(
    monkeypatch: pytest.MonkeyPatch, at_once: None
) -> None:
    daemon = Daemon()
    daemon.engine.start()
    try:
        before = daemon.engine.state
        with monkeypatch.context() as broken:

            def refuse(*_: object, **__: object) -> None:
                raise BlockingIOError(11, os.strerror(11))

            broken.setattr(subprocess, "Popen", refuse)
            change = daemon.send("apply", taken(seed=3101))
            daemon.over()
        answer = daemon.answers[change]["error"]
        assert answer["message"].endswith("nothing of this was done: send it again") and "\n" not in answer["message"]
        assert daemon.engine.state is before and daemon.ask("get_status")["intake"] is None
        monkeypatch.setattr(worker_process, "HERE", 1_000_000)
        change = daemon.send("apply", taken(seed=3101))
        daemon.over()
        assert daemon.answers[change]["result"]["revision"] == before.revision + 1
    finally:
        daemon.methods.end()
        daemon.methods.intake.join()
        daemon.engine.stop()


@pytest.mark.slow
def test_a_change_comes_out_as_without_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def numbers(here: int) -> bytes:
        monkeypatch.setattr(worker_process, "HERE", here)
        for each in (lattice._reflection_of, resampling._resampled):
            each.cache_clear()
        from hapticd.rendering.compiler import noise_filters

        monkeypatch.setattr(noise_filters, "designs", noise_filters.Designs())
        noise_filters._shown_model.cache_clear()
        daemon = Daemon()
        daemon.engine.start()
        try:
            daemon.send("apply", taken(seed=3102))
            daemon.over()
            return daemon.engine._compiler._materials._numbers.tobytes()
        finally:
            daemon.methods.end()
            daemon.methods.intake.join()
            daemon.engine.stop()

    assert numbers(0) == numbers(1_000_000)
