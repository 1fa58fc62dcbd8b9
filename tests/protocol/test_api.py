"""The public names: each exists, is listed and typed, and every error is a HapticdError."""

from __future__ import annotations

import ast
import inspect
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

import hapticd
from hapticd.base.model import Model
from hapticd.client.blocking import Client
from hapticd.protocol import results


def test_every_public_name_is_there_and_shown() -> None:
    assert set(hapticd.__all__) <= set(dir(hapticd))
    for name in hapticd.__all__:
        assert getattr(hapticd, name) is not None
    shown = {name for name in dir(hapticd) if not name.startswith("_")}
    assert shown == {name for name in hapticd.__all__ if not name.startswith("_")}
    with pytest.raises(AttributeError, match="no attribute 'conect'"):
        hapticd.conect  # noqa: B018


def test_every_public_name_is_typed() -> None:
    """Names that are loaded on use are imported for type checkers."""
    tree = ast.parse(Path(hapticd.__file__).read_text())
    (typed,) = [node for node in tree.body if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"]
    imported = {alias.asname or alias.name for node in ast.walk(typed) for alias in getattr(node, "names", ())}
    assert set(hapticd.__all__) - imported == {"__version__"}


def test_every_result_of_the_clients_is_public() -> None:
    public = {
        name for name, value in vars(results).items() if isinstance(value, type) and "TypedDict" in repr(type(value))
    }
    used = {
        word
        for method in vars(Client).values()
        if inspect.isfunction(method)
        for word in str(method.__annotations__.get("return", "")).replace("[", " ").replace("]", " ").split()
    }
    assert public & used <= set(hapticd.__all__)


PROGRAM = '''\
"""A small program with every kind of annotation that a user would write."""

import asyncio

import hapticd

NAMES: list[str] = hapticd.__all__


def show(state: hapticd.State) -> float:
    return state["position_m"][0]


def of_event(event: hapticd.Event) -> str:
    return str(event["event"])


def of_status(status: hapticd.Status) -> list[hapticd.GestureEnd]:
    operator: hapticd.OperatorStatus | None = status["operator"]
    return [] if operator is None else operator["ends"]


def checked(result: hapticd.RevisionResult) -> list[hapticd.Warned]:
    return result.get("warnings", [])


def run(daemon: hapticd.Client) -> hapticd.GestureEnd:
    wood = hapticd.Material(stiffness_n_per_m=800.0)
    scene: hapticd.Scene = hapticd.load_scene({"objects": {}})
    checked(daemon.apply(materials={"mine": wood.to_dict()}, scene=scene, wait=True))
    checked(daemon.set_materials({"mine": {"stiffness_n_per_m": 1.0}}))
    tick: hapticd.TickResult = daemon.mark("trial 3", {"condition": [1, None]})
    print(tick["tick"], show(daemon.state()))
    daemon.set_operator([[0.0, 0.0, 0.01]])
    states: hapticd.Subscription[hapticd.State] = daemon.states(newest=True)
    with states, daemon.samples(newest=True) as samples:
        batch: hapticd.SampleBatch = next(samples)
        print(show(next(states)), batch.lost)
    return daemon.wait_gesture(timeout_s=1.0)


async def both() -> None:
    client: hapticd.aio.Client = await hapticd.aio.connect(wait_s=1.0)
    async with client:
        await client.mark("here")
    async with hapticd.aio.connect() as daemon:
        async with daemon.states(newest=True) as states:
            async for state in states:
                show(state)
        print(await daemon.wait_gesture(), await daemon.state())


try:
    with hapticd.connect(wait_s=2.0) as client:
        run(client)
    asyncio.run(both())
except (hapticd.DaemonNotRunning, hapticd.RemoteError, hapticd.TimedOut) as error:
    print(error)
except hapticd.InvalidError as error:
    problems: tuple[hapticd.Problem, ...] = error.problems
'''


@pytest.mark.slow
def test_a_program_with_annotations_passes_a_strict_type_checker(tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    options = ["--strict", "--config-file=", "--follow-imports=silent", f"--cache-dir={tmp_path / 'cache'}"]
    checked = subprocess.run([sys.executable, "-m", "mypy", *options, program], capture_output=True, text=True)
    assert (checked.returncode, checked.stderr) == (0, ""), checked.stdout


# ---- Errors ----------------------------------------------------------------------------------------------------------

MODELS = [
    value for name in hapticd.__all__ if isinstance(value := getattr(hapticd, name), type) and issubclass(value, Model)
]


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.__name__)
def test_no_model_raises_an_error_of_pydantic(model: type[Model]) -> None:
    for wrong in (
        lambda: model(nothing_of_this_name=1),
        lambda: model.model_validate({"nothing_of_this_name": 1}),
        lambda: model.model_validate(3),
        lambda: model.model_validate_json("[1, 2"),
        lambda: model.model_validate_json('{"nothing_of_this_name": 1}'),
        lambda: model.model_validate_strings({"nothing_of_this_name": "1"}),
    ):
        with pytest.raises(hapticd.InvalidError) as caught:
            wrong()
        assert caught.value.problems
        assert "\n" not in str(caught.value)
    with pytest.raises(hapticd.InvalidError, match="nothing_of_this_name: unknown key"):
        model(nothing_of_this_name=1)


def test_a_model_that_is_there_cannot_be_changed() -> None:
    scene = hapticd.Scene(ramp_s=0.5)
    with pytest.raises(hapticd.InvalidError, match="ramp_s: cannot be changed"):
        scene.ramp_s = 1.0  # type: ignore[misc]
    with pytest.raises(hapticd.InvalidError, match="ramp_s: cannot be changed"):
        del scene.ramp_s
    assert scene.ramp_s == 0.5
    assert scene.model_copy(update={"ramp_s": 0.25}).ramp_s == 0.25


def test_faults_are_told_by_their_path() -> None:
    wall: dict[str, Any] = {"kind": "wall", "point_m": [0, 0], "normal": [0, 0], "material": "wood"}
    with pytest.raises(hapticd.InvalidError) as caught:
        hapticd.Scene(objects={"a": wall}, ramp_s="1")  # type: ignore[arg-type]
    assert [problem.where for problem in caught.value.problems] == ["ramp_s", "objects.a.normal"]


def test_what_is_nested_is_validated_without_python(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten thousand objects would take seconds if each were made by the __init__ of its class."""
    made: list[str] = []
    original = Model.__init__

    def counted(self: Model, **data: Any) -> None:
        made.append(type(self).__name__)
        original(self, **data)

    monkeypatch.setattr(Model, "__init__", counted)
    spring = {"kind": "spring", "center_m": [0.0, 0.0], "stiffness_n_per_m": 1.0}
    hapticd.Scene.model_validate({"objects": {f"s{index}": spring for index in range(10)}})
    assert made == []


def test_documents_are_read_with_errors_of_pydantic_which_know_their_places() -> None:
    with pytest.raises(ValidationError):
        hapticd.Scene.parsed({"ramp_s": "1"})
