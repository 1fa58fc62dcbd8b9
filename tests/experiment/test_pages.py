"""The command with its two pages, on a daemon with the simulated joystick. A script plays the pages."""

from __future__ import annotations

import asyncio
import json
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import aiohttp
import msgpack
import pytest

from hapticd.base.core import Flag
from hapticd.config.materials import shipped_materials
from hapticd.experiment.plan import plan
from hapticd.experiment.runner import MAX_ATTEMPTS_NOT_DONE
from hapticd.experiment.study import load_study
from tests.experiment.scripted_pages import SERVO, SESSION, Running, Script, answered, log_of, page, run_study
from tests.support.daemon_process import Daemon, connect, running_daemon

PAPER = ("okamura1998_tapping", "okamura1998_texture", "okamura1998_puncture")


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    path = tmp_path_factory.mktemp("daemon") / "servo.yaml"
    path.write_text(SERVO)
    with running_daemon("-c", str(path)) as running:
        yield running


@pytest.fixture
def start(daemon: Daemon) -> Iterator[Callable[..., Running]]:
    """Return a function that starts `hapticd` with arguments on the daemon. The fixture kills what still runs."""
    started: list[Running] = []

    def begin(*words: str) -> Running:
        started.append(Running("--runtime-dir", str(daemon.directory), *words))
        return started[-1]

    yield begin
    for each in started:
        each.stop()


def _numbers(value: object) -> Iterator[float]:
    """Yield every number in a message."""
    if isinstance(value, dict):
        for each in value.values():
            yield from _numbers(each)
    elif isinstance(value, list):
        for each in value:
            yield from _numbers(each)
    elif isinstance(value, float):
        yield value


def _secrets(study: str) -> tuple[set[str], set[float]]:
    """Return the names of materials, conditions, factors, levels and cells of a study, and the materials' numbers."""
    made = plan(load_study(study), "P07", 1, 1)
    names = {*shipped_materials(), *made.study.factors, *made.study.conditions} - {"all"}
    for trial in made.trials:
        names |= {each.name for each in trial.stimuli} | {trial.cell}
    numbers: set[float] = set()
    for material in shipped_materials().values():
        numbers |= {each for each in _numbers(material.to_dict()) if each not in (0.0, 1.0)}
    for trial in made.trials:
        for stimulus in trial.stimuli:
            numbers |= set(_numbers(dict(stimulus.changes)))
    return {name for name in names if len(name) > 3}, numbers


@pytest.mark.long
@pytest.mark.parametrize("study", PAPER)
def test_the_participant_is_sent_no_name_and_no_number_of_a_material(
    study: str, tmp_path: Path, start: Callable[..., Running]
) -> None:
    # Without a rupture a motor task is repeated until the runner accepts it as not done.
    attempts = MAX_ATTEMPTS_NOT_DONE if study == "okamura1998_puncture" else 1
    running, script = start(*run_study(tmp_path, study)), Script(max_answers=4 * attempts)
    asyncio.run(script.play(running.links))
    code, out, _ = running.ended()
    assert code == 1 and "continue with" in out
    assert len(answered(tmp_path)) == 4
    assert script.participant is not None
    names, numbers = _secrets(study)
    assert len(names) > 8 and len(numbers) > 20
    instructions = load_study(study).instructions + "".join(each.text for each in load_study(study).questions.values())
    # Values that all trials have in common (places of surfaces, time limit) reveal no material.
    trials = [set(_numbers(screen)) for screen in script.screens if screen.get("question")]
    numbers -= set.intersection(*trials)
    for message in script.participant.messages:
        text = message.decode("utf-8", "replace")
        # The texts that the study shows to the participant are not secret.
        found = [name for name in names if name in text and name not in instructions]
        assert not found, text
        assert not set(_numbers(msgpack.unpackb(message))) & numbers


@pytest.mark.slow
def test_a_demo_has_a_daemon_of_its_own_and_ends_it(tmp_path: Path) -> None:
    running, script = Running(*run_study(tmp_path, PAPER[2], "--demo")), Script(max_answers=MAX_ATTEMPTS_NOT_DONE)
    try:
        asyncio.run(script.play(running.links))
        code, out, _ = running.ended()
    finally:
        running.stop()
    assert code == 1 and "1 of 24 trials; continue with" in out
    about = json.loads((tmp_path / SESSION / "session.json").read_text())
    assert about["stage"]["device"] == "sim"


@pytest.mark.long
def test_the_participants_address_lets_nobody_into_the_experimenters_page(
    tmp_path: Path, start: Callable[..., Running]
) -> None:
    running = start(*run_study(tmp_path, PAPER[0]))
    token = running.links["participant"].partition("=")[2]
    other = running.links["experimenter"].partition("?")[0]

    async def look() -> None:
        jar = aiohttp.CookieJar(unsafe=True)
        async with aiohttp.ClientSession(cookie_jar=jar) as session:
            async with session.get(running.links["participant"]) as response:
                assert response.status == 200
            # Cookies ignore ports: the cookie of this page is also sent to the other port.
            async with session.get(other) as response:
                assert response.status == 403
            async with session.get(f"{other}?token={token}") as response:
                assert response.status == 403
            async with session.get(f"{other}socket", headers={"Origin": other.rstrip("/")}) as response:
                assert response.status == 403

    asyncio.run(look())


REFUSED: dict[str, dict[str, Any]] = {
    "get_scene": {},
    "get_materials": {},
    "get_status": {},
    "lease": {"duration_s": 1},
    "web.subscribe": {"topics": ["samples"]},
    "experiment.watch": {"since": 0},
    "web.new_address": {},
}


@pytest.mark.long
def test_a_signal_gives_new_addresses_after_the_first_ones_were_used(
    tmp_path: Path, start: Callable[..., Running]
) -> None:
    """A lost browser cannot be replaced through the first address, which opens only once."""
    running = start(*run_study(tmp_path, PAPER[0]))
    used = running.links

    async def opens(link: str) -> int:
        jar = aiohttp.CookieJar(unsafe=True)
        async with aiohttp.ClientSession(cookie_jar=jar) as session, session.get(link) as response:
            return response.status

    for link in used.values():
        assert asyncio.run(opens(link)) == 200
        assert asyncio.run(opens(link)) != 200
    running.process.send_signal(signal.SIGUSR1)
    again = running.read_links()
    assert [asyncio.run(opens(again[who])) for who in ("participant", "experimenter")] == [200, 200]


@pytest.mark.long
def test_the_participants_page_may_ask_for_nothing_of_the_scene(tmp_path: Path, start: Callable[..., Running]) -> None:
    running, messages = start(*run_study(tmp_path, PAPER[0])), []

    async def heard(_: object, message: Any) -> None:
        raise AssertionError(message)

    async def ask() -> None:
        async with page(running.links["participant"], heard) as participant:
            for method, params in REFUSED.items():
                await participant.call(method, **params)
            async for message in participant.socket:
                answer = msgpack.unpackb(message.data)
                if isinstance(answer, dict):
                    messages.append(answer["error"]["message"])
                    if len(messages) == len(REFUSED):
                        return

    asyncio.run(ask())
    assert messages == [f"no method {method!r} for a page" for method in REFUSED]


@pytest.mark.slow
def test_a_stopped_session_continues_to_its_end_with_the_pages(tmp_path: Path, start: Callable[..., Running]) -> None:
    study = tmp_path / "study.yaml"
    study.write_text(SHORT)
    running = start(*run_study(tmp_path, str(study)))
    asyncio.run(Script(max_answers=2).play(running.links))
    assert running.ended()[0] == 1
    again, script = start("experiment", "resume", str(tmp_path / SESSION), "--port", "0"), Script()
    asyncio.run(script.play(again.links))
    code, out, errors = again.ended()
    # With a servo of 1 kHz the study's stiffness is too high.
    assert all(line.startswith("hapticd: on this device: ") for line in errors.splitlines())
    assert code == 0 and "complete" in out
    assert sorted(answered(tmp_path)) == list(range(5))
    assert script.screens[-1]["kind"] == "over"
    kinds = {screen["question"]["kind"] for screen in script.screens if screen.get("question")}
    assert kinds == {"slider"}
    rows = script.consoles[-1]
    assert rows["doing"] == "over" and rows["done"] == 5


@pytest.mark.long
def test_a_participant_whose_page_dies_feels_nothing_and_the_trial_begins_again(
    daemon: Daemon, tmp_path: Path, start: Callable[..., Running]
) -> None:
    study = tmp_path / "study.yaml"
    study.write_text(SHORT)
    running = start(*run_study(tmp_path, str(study)))

    script = Script()

    async def both() -> None:
        # Instead of a third answer the page closes its connection.
        original = script._participant

        async def goes(page: Any, content: Any) -> None:
            screen = content[1].get("screen") if isinstance(content, list) and content[0] == "web" else None
            if script.answers == 2 and screen and screen["kind"] == "trial" and screen["felt"]:
                await page.socket.close()
                return
            await original(page, content)

        script._participant = goes  # type: ignore[method-assign]
        playing = asyncio.create_task(script.play(running.links))
        with connect(daemon.directory) as client:
            while not (script.consoles and script.consoles[-1]["doing"] == "paused"):
                await asyncio.sleep(0.01)
            with client.states(newest=True) as states:
                state = await asyncio.to_thread(states.receive, 30.0)
        assert state is not None and not state["flags"] & Flag.FORCES_ON and state["force_n"] == [0.0, 0.0]
        running.process.send_signal(signal.SIGTERM)
        await playing

    asyncio.run(both())
    assert running.ended()[0] == 1
    assert len(answered(tmp_path)) == 2
    assert [each["because"] for each in log_of(tmp_path) if each["kind"] == "trial_given_up"] == ["pause"]


SHORT = """\
experiment: 1
title: How rough?
instructions: Stroke it.
base:
  materials: {surface: wood}
  scene:
    objects:
      floor: {kind: wall, point_m: [0, 0], normal: [0, 1], material: surface}
factors:
  material: {at: materials.surface, levels: [wood, delrin, glass, steel, acrylic]}
trial: {type: rating, cross: [material], question: rough}
questions:
  rough: {kind: slider, text: How rough?, low: 0, high: 10}
"""
