"""A recording shown in the browser: the page draws the samples of the file."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Browser, Page

import hapticd
from tests.web.browser import Demo, running_demo

pytestmark = pytest.mark.slow

RECORD = """async (name) => {
  await hapticd.link.call("web.record_start", { name });
  await hapticd.link.call("set_operator", { gesture: { kind: "tap", object: "floor", speed_m_per_s: 0.1 } });
  const marked = await hapticd.link.call("mark", { text: "after the tap" });
  const until = (what) => new Promise((resolve) => {
    const look = () => (what() ? resolve() : requestAnimationFrame(look));
    look();
  });
  const rows = hapticd.samples.rows;
  await until(() => hapticd.samples.rows > rows + 5000);
  return (await hapticd.link.call("web.record_stop")).last;
}"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("recordings")


@pytest.fixture(scope="module")
def demo(browser: Browser, folder: Path) -> Iterator[Demo]:
    with running_demo(folder, "--recordings", str(folder)) as running:
        yield running


def record(page: Page, folder: Path, name: str) -> Any:
    last = page.evaluate(RECORD, name)
    assert last["ended_because"] is None
    recording = hapticd.load(folder / name)
    assert len(recording.samples) == last["ticks"] > 5000
    return recording


def test_what_was_recorded_is_shown_at_every_row(page: Page, folder: Path) -> None:
    name = "first.npz"
    recording = record(page, folder, name)
    facts = page.evaluate("async (name) => await hapticd.playback.open({ name })", name)
    assert facts["rows"] == len(recording.samples)
    assert "mark" in [event["event"] for event in facts["events"]]
    row = len(recording.samples) // 2
    state = page.evaluate("async (row) => { await hapticd.playback.seek(row); return hapticd.playback.state; }", row)
    sample = recording.samples[row]
    assert state["tick"] == sample["tick"]
    assert state["position_m"] == sample["position_m"].astype("f4").tolist()
    assert state["force_n"] == sample["force_n"].astype("f4").tolist()
    assert page.evaluate("() => hapticd.playback.scene.objects.floor.kind") == "wall"
    column = page.evaluate("() => Array.from(hapticd.playback.store.columns.y_m.subarray(0, 100))")
    assert column == recording.samples["position_m"][:100, 1].astype("f4").tolist()
    page.evaluate("async () => await hapticd.playback.close()")
    assert page.evaluate("() => [hapticd.playback.active, hapticd.playback.state]") == [False, None]


def test_it_plays_every_row_to_the_end_and_jumps(page: Page, folder: Path) -> None:
    recording = record(page, folder, "played.npz")
    page.evaluate("async () => await hapticd.playback.open({ name: 'played.npz' })")
    page.evaluate("() => { hapticd.playback.store.addEventListener('lost', () => { globalThis.lost = true; }); }")
    page.evaluate("() => hapticd.playback.play(1)")
    page.wait_for_function("() => !hapticd.playback.playing")
    last = len(recording.samples) - 1
    assert page.evaluate("() => hapticd.playback.row") == last
    column = page.evaluate(
        "() => { const s = hapticd.playback.store; return Array.from(s.columns.x_m.slice(s.first, s.rows)); }"
    )
    assert column == recording.samples["position_m"][:, 0].astype("f4").tolist()
    assert not page.evaluate("() => globalThis.lost")
    page.evaluate(
        "async () => { const p = hapticd.playback; await Promise.all([p.seek(10), p.seek(3000), p.seek(70)]); }"
    )
    assert page.evaluate("() => hapticd.playback.row") == 70
    times_ns = recording.samples["time_ns"]  # more than 70 periods if some were missed
    passed_s = 1e-9 * float(times_ns[70] - times_ns[0])
    assert np.isclose(page.evaluate("() => hapticd.playback.timeS"), passed_s, atol=2e-4)
