"""A recording that a page begins: one at a time, with news to pages, and all ways in which it ends."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest

from hapticd.base.errors import HapticdError
from hapticd.client.record import STOPPED_REASON, RecordSummary
from hapticd.web import recorder
from hapticd.web.recorder import WebRecorder
from hapticd.web.recording_folder import RecordingFolder


class Writer:
    count, written_bytes = 40, 4480


def summary(target: Path, ended: str | None) -> RecordSummary:
    return RecordSummary(str(target), 40, 0.004, 0, 1, 2, (), 0, None, None, ended, None)


def until_stopped(
    _: object, target: Path, duration_s: float | None, *, stop: Any, progress: Any, opened: Any, **rest: object
) -> RecordSummary:
    """Take the place of hapticd.client.record.record: record until stopped."""
    opened(Writer())
    progress(0.0)
    progress(0.004)
    assert stop.wait(10)
    target.write_bytes(b"whole")
    return summary(target, STOPPED_REASON)


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """Return a function that runs a coroutine with a recorder; `record` replaces hapticd.client.record.record."""

    def running(test: Callable[[WebRecorder], Coroutine[Any, Any, Any]], record: Any = until_stopped) -> Any:
        monkeypatch.setattr(recorder, "record", record)

        async def main() -> Any:
            return await test(WebRecorder(lambda: nullcontext(None), RecordingFolder(tmp_path)))  # type: ignore[arg-type]

        return asyncio.run(main())

    return running


def test_it_is_begun_and_stopped_and_pages_hear_of_it(run: Callable[..., Any], tmp_path: Path) -> None:
    async def test(made: WebRecorder) -> None:
        news: list[Mapping[str, Any]] = []
        made.watch(news.append)
        state = await made.start("tap.npz", {"note": "first"}, None)
        assert (state["recording"], state["name"]) == (True, "tap.npz")
        assert state["recorded_s"] in (0.0, 0.004)  # the thread continues meanwhile
        assert (state["ticks"], state["bytes"]) == (40, 4480)
        with pytest.raises(HapticdError, match=r"a recording is under way: tap\.npz; stop it first"):
            await made.start("other.npz")
        ended = await made.stop()
        assert ended["recording"] is False
        assert ended["last"] == {
            "name": "tap.npz",
            "ticks": 40,
            "duration_s": 0.004,
            "lost": 3,
            "ended_because": None,
            "warning": None,
        }
        assert news[-1] == {"recording": ended}
        with pytest.raises(HapticdError, match="nothing is being recorded"):
            await made.stop()

    run(test)
    assert (tmp_path / "tap.npz").read_bytes() == b"whole"


def test_it_continues_without_the_page_that_began_it(run: Callable[..., Any], tmp_path: Path) -> None:
    async def test(made: WebRecorder) -> None:
        news: list[Mapping[str, Any]] = []
        made.watch(news.append)
        await made.start("tap.npz")
        made.unwatch(news.append)
        heard = len(news)
        assert made.state()["recording"] is True
        await made.close()
        assert made.state()["recording"] is False
        assert len(news) == heard

    run(test)
    assert (tmp_path / "tap.npz").exists()


def test_the_reason_of_an_early_end_is_reported(run: Callable[..., Any]) -> None:
    def ends(_: object, target: Path, *rest: object, progress: Any, opened: Any, **more: object) -> RecordSummary:
        opened(Writer())
        progress(0.004)
        return summary(target, "the disk is full")

    async def test(made: WebRecorder) -> None:
        await made.start("tap.npz")
        while made.state()["recording"]:
            await asyncio.sleep(0)
        last: Any = made.state()["last"]
        assert last["ended_because"] == "the disk is full"

    run(test, ends)


@pytest.mark.parametrize(
    ("error", "said"), [(HapticdError("no daemon listens"), "no daemon listens"), (KeyError("x"), "internal error")]
)
def test_the_reason_why_it_cannot_begin_is_reported(run: Callable[..., Any], error: Exception, said: str) -> None:
    def fails(*rest: object, **more: object) -> RecordSummary:
        raise error

    async def test(made: WebRecorder) -> None:
        with pytest.raises(HapticdError, match=said):
            await made.start("tap.npz")
        assert made.state()["recording"] is False

    run(test, fails)


@pytest.mark.parametrize(
    ("name", "notes", "for_s", "said"),
    [
        ("../tap.npz", None, None, "name: must consist of letters"),
        ("tap.csv", None, None, "name: must end in"),
        ("tap.npz", "text", None, "notes: must be a map"),
        ("tap.npz", {"note": "a" * 4001}, None, "notes: each must be a text"),
        ("tap.npz", {"note": 3}, None, "notes: each must be a text"),
        ("tap.npz", {}, 0, "for_s: must be a number"),
        ("tap.npz", {}, float("nan"), "for_s: must be a number"),
        ("tap.npz", {}, True, "for_s: must be a number"),
    ],
)
def test_params_are_checked_before_anything_is_begun(
    run: Callable[..., Any], tmp_path: Path, name: str, notes: object, for_s: object, said: str
) -> None:
    async def test(made: WebRecorder) -> None:
        with pytest.raises(HapticdError, match=said):
            await made.start(name, notes, for_s)
        assert made.state()["recording"] is False

    run(test)
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_reported_before_the_beginning(run: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RecordingFolder, "free_bytes", lambda _: 1 << 20)

    async def test(made: WebRecorder) -> None:
        with pytest.raises(HapticdError, match="a recording needs at least"):
            await made.start("tap.npz")

    run(test)
