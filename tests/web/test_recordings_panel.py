"""The tab of the recordings: its controls make, list, download, show and close recordings.

test_playback_in_browser.py tests the samples that the page draws, test_recorder.py the files.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, Locator, Page

import hapticd
from tests.web.browser import Demo, running_demo

pytestmark = pytest.mark.slow

TAP = {"kind": "tap", "object": "floor", "at_m": 0.0, "speed_m_per_s": 0.2}
SHOWN = """() => {
  const { scope, playback, scene } = hapticd, { source } = scope, at = (source.rows - 1) % source.capacity;
  const { columns } = playback.store;
  return { row: source.rows - 1, same: source.store === playback.store, tick: source.store.ticks[at],
           force: source.track("force_y").column[at], right: scope.view.right - source.newest,
           position: scene.moments.newest.position, sceneTick: scene.moments.newest.tick };
}"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("recordings")


@pytest.fixture(scope="module")
def demo(browser: Browser, folder: Path) -> Iterator[Demo]:
    with running_demo(folder, "--recordings", str(folder)) as running:
        yield running


@pytest.fixture
def panel(page: Page) -> Locator:
    """Return the tab of a page that receives samples and has turned the forces on."""
    page.wait_for_function("() => hapticd.samples.rows > 100 && hapticd.safety.forces === 'on'")
    page.get_by_role("tab", name="Recordings").click()
    return page.locator("#recordings-panel")


def record(panel: Locator, stem: str, note: str = "") -> None:
    """Record a tap and half a second after it, with the controls of the page."""
    page = panel.page
    panel.get_by_label("Name", exact=True).fill(stem)
    panel.get_by_label("Notes, kept in the file").fill(note)
    panel.get_by_role("button", name="Record", exact=True).click()
    panel.get_by_role("button", name="Stop recording").wait_for()
    page.evaluate("(gesture) => hapticd.link.call('set_operator', { gesture })", TAP)
    rows = page.evaluate("() => hapticd.samples.rows")
    page.wait_for_function(f"() => hapticd.samples.rows > {rows + 10_000}")
    panel.get_by_role("button", name="Stop recording").click()
    panel.get_by_role("status").filter(has_text=f"{stem}.npz: ").wait_for()


def show_recording(panel: Locator, name: str) -> None:
    panel.get_by_role("button", name=f"Open {name}").click()
    panel.get_by_role("heading", name=name).wait_for()


def seek(panel: Locator, row: int) -> None:
    """Move the slider to a row, and wait until the row is shown."""
    panel.get_by_role("slider", name="Moment").fill(str(row))
    panel.page.wait_for_function(
        "(row) => hapticd.playback.row === row && hapticd.scope.source.rows === row + 1", arg=row
    )


def test_what_is_recorded_is_listed_and_its_download_is_the_recording(
    panel: Locator, folder: Path, tmp_path: Path
) -> None:
    name = "made by hand.npz"
    record(panel, "made by hand", "a tap on the floor")
    kept = hapticd.load(folder / name)
    assert panel.get_by_role("status").inner_text().startswith(f"{name}: {len(kept.samples):,} ticks")
    assert panel.get_by_role("rowheader", name=name).is_visible()
    with panel.page.expect_download() as downloading:
        panel.get_by_role("link", name=f"Download {name}").click()
    assert downloading.value.suggested_filename == name
    downloading.value.save_as(tmp_path / name)
    loaded = hapticd.load(tmp_path / name)
    assert np.array_equal(loaded.samples, kept.samples) and len(loaded.samples) > 5000
    assert loaded.notes == {"note": "a tap on the floor"}
    assert "contact" in [event["event"] for event in loaded.events]


def test_a_recording_is_shown_moment_by_moment_and_closed(panel: Locator, folder: Path) -> None:
    page, name = panel.page, "looked through.npz"
    record(panel, "looked through")
    recording = hapticd.load(folder / name)
    samples = recording.samples
    show_recording(panel, name)
    slider = panel.get_by_role("slider", name="Moment")
    assert page.evaluate("() => document.activeElement.id") == slider.get_attribute("id") == "recording-moment"
    assert slider.get_attribute("max") == str(len(samples) - 1)
    # The moment of the floor's largest force, and one before the tap.
    pushed = int(np.argmax(samples["contact_force_n"][:, 1]))
    assert samples["contact_force_n"][pushed, 1] > 0.1
    for row in (pushed, 5):
        seek(panel, row)
        shown = page.evaluate(SHOWN)
        sample = samples[row]
        assert shown["same"] and shown["row"] == row
        assert shown["tick"] == shown["sceneTick"] == sample["tick"]
        assert shown["force"] == np.float32(sample["force_n"][1])
        assert shown["position"] == sample["position_m"].astype("f4").tolist()
        assert shown["right"] == pytest.approx(0.0, abs=1e-9)  # the scope's picture ends at the moment
        time_s = (int(sample["time_ns"]) - int(samples[0]["time_ns"])) * 1e-9
        assert slider.get_attribute("aria-valuetext") == f"{time_s:.4f} s"
    assert page.locator("#scope .scope-state").inner_text().startswith("Recording.")
    slider.press("Shift+ArrowRight")
    page.wait_for_function("() => hapticd.playback.row === 6")
    slider.press("ArrowRight")
    page.wait_for_function("(row) => hapticd.playback.row === row", arg=6 + round(0.01 * recording.rate_hz))
    panel.get_by_role("button", name="Back to now").click()
    page.wait_for_function("() => !hapticd.playback.active && hapticd.scope.source.store === hapticd.samples")
    assert slider.is_hidden()
    assert page.evaluate("() => hapticd.scene.moments.playback") is None
    rows = page.evaluate("() => hapticd.samples.rows")
    page.wait_for_function(f"() => hapticd.scope.source.rows > {rows}")


def test_a_click_on_the_outline_goes_there_and_play_continues_to_the_end(panel: Locator, folder: Path) -> None:
    page, name = panel.page, "clicked.npz"
    record(panel, "clicked")
    rows = len(hapticd.load(folder / name).samples)
    show_recording(panel, name)
    box = panel.get_by_role("img", name="Force over time").bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + 0.75 * box["width"], box["y"] + box["height"] / 2)
    page.wait_for_function("(row) => Math.abs(hapticd.playback.row - row) < 0.02 * row", arg=0.75 * rows)
    panel.get_by_role("button", name="Play").click()
    page.wait_for_function("(last) => hapticd.playback.row === last && !hapticd.playback.playing", arg=rows - 1)
    assert panel.get_by_role("button", name="Play").is_visible()


def damaged(folder: Path, kind: str) -> tuple[str, bytes]:
    """Return name and content of a file that is damaged or not a recording."""
    complete = next(folder.glob("*.npz")).read_bytes()
    return "damaged.npz", {"empty": b"", "foreign": b"no recording\n" * 50, "cut": complete[: len(complete) // 2]}[kind]


@pytest.mark.parametrize("kind", ["empty", "foreign", "cut"])
def test_a_damaged_file_gets_one_line_that_names_it(panel: Locator, folder: Path, kind: str) -> None:
    page = panel.page
    if not list(folder.glob("*.npz")):
        record(panel, "whole")
    intact = next(folder.glob("*.npz")).name
    show_recording(panel, intact)
    name, content = damaged(folder, kind)
    panel.get_by_label("Open a file of yours").set_input_files(
        {"name": name, "mimeType": "application/octet-stream", "buffer": content}
    )
    line = panel.get_by_role("alert").filter(has_text=name)
    line.wait_for()
    said = line.inner_text()
    assert said.count(name) == 1 and "\n" not in said and "Traceback" not in said and "/" not in said
    # The page shows the present and not the closed recording; another one can be opened.
    page.wait_for_function("() => !hapticd.playback.active")
    assert panel.get_by_role("status").inner_text() == ""
    show_recording(panel, intact)
    assert line.count() == 0


def test_a_file_of_the_user_is_opened(panel: Locator, folder: Path, tmp_path: Path) -> None:
    record(panel, "sent")
    copy = tmp_path / "from elsewhere.npz"
    copy.write_bytes((folder / "sent.npz").read_bytes())
    panel.get_by_label("Open a file of yours").set_input_files(copy)
    panel.get_by_role("heading", name=copy.name).wait_for()
    rows = len(hapticd.load(copy).samples)
    assert panel.page.evaluate("() => hapticd.playback.facts.rows") == rows
    assert panel.get_by_role("rowheader", name=copy.name).count() == 0  # it is not added to the folder


def test_a_recording_is_deleted_after_a_second_question(panel: Locator, folder: Path) -> None:
    record(panel, "deleted")
    panel.get_by_role("button", name="Delete deleted.npz").click()
    panel.get_by_role("button", name="Keep it").click()
    assert (folder / "deleted.npz").exists()
    panel.get_by_role("button", name="Delete deleted.npz").click()
    panel.get_by_role("button", name="Delete for good").click()
    panel.get_by_role("status").filter(has_text="deleted.npz was deleted.").wait_for()
    assert panel.get_by_role("rowheader", name="deleted.npz").count() == 0
    assert not (folder / "deleted.npz").exists()
