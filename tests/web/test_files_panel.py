"""The files panel in the browser: YAML is opened, faults have their line, and saved files can be opened."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page

from hapticd.config.shipped_files import described

pytestmark = pytest.mark.slow

TABLE = """\
# My table.
scene:
  # What stands on it.
  objects:
    floor: {kind: wall, point_m: [0, 0], normal: [0, 1], material: wood}  # it is oak
    ball: {kind: disc, center_m: [0.02, 0.03], radius_m: 0.01, material: acrylic}
"""
SCENE = "async () => (await hapticd.link.call('get_scene')).scene.objects"


@pytest.fixture
def files(page: Page) -> Page:
    """Return a page that shows the panel, once it lists the shipped files."""
    page.locator("#files-tab").click()
    page.wait_for_function("() => document.querySelector('#shipped-scene').options.length > 0")
    return page


def give(page: Page, text: str, name: str = "table.yaml") -> None:
    page.set_input_files("#yaml-file", {"name": name, "mimeType": "application/yaml", "buffer": text.encode()})


def wait_said(page: Page, begin: str) -> str:
    """Return the panel's message, once it begins with `begin`."""
    page.wait_for_function("(text) => document.querySelector('#files-message').textContent.startsWith(text)", arg=begin)
    return page.locator("#files-message").inner_text()


def save(page: Page, folder: Path) -> Path:
    with page.expect_download() as downloading:
        page.get_by_role("button", name="Save as YAML").click()
    file = folder / downloading.value.suggested_filename
    downloading.value.save_as(file)
    return file


def checked(file: Path) -> None:
    done = subprocess.run([sys.executable, "-m", "hapticd", "check", "-c", str(file)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr + done.stdout


def objects(page: Page) -> dict[str, Any]:
    return page.evaluate(SCENE)  # type: ignore[no-any-return]


def test_a_file_that_is_opened_becomes_the_daemon_s_scene(files: Page) -> None:
    give(files, TABLE)
    assert "a scene of 2 objects" in wait_said(files, "table.yaml was opened")
    found = objects(files)
    assert sorted(found) == ["ball", "floor"]
    assert found["ball"]["radius_m"] == 0.01 and found["floor"]["material"] == "wood"
    assert files.locator("#files-faults").inner_text() == ""
    # The page draws it, too.
    files.wait_for_function("() => Object.keys(hapticd.model.scene.objects).sort().join() === 'ball,floor'")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("radius_m: 0.01", "radius_m: -1"), ["line 6", "scene.objects.ball.radius_m"]),
        (("material: wood", "material: wod"), ["line 5", "scene.objects.floor.material", "wod"]),
        (("normal: [0, 1]", "normal: [0, 1"), ["line 5"]),
    ],
    ids=["value", "name", "syntax"],
)
def test_a_fault_is_shown_with_its_line_and_key_and_changes_nothing(
    files: Page, change: tuple[str, str], said: list[str]
) -> None:
    before = objects(files)
    give(files, TABLE.replace(*change))
    faults = files.locator("#files-faults li")
    faults.first.wait_for()
    assert faults.count() == 1
    for word in said:
        assert word in faults.inner_text()
    assert "table.yaml: 1 fault; nothing was changed" in files.locator("#files-faults").inner_text()
    assert objects(files) == before
    give(files, TABLE)
    wait_said(files, "table.yaml was opened")
    assert files.locator("#files-faults").inner_text() == ""


def test_a_file_that_holds_the_handle_deep_inside_is_applied_once_it_is_opened_once_more(files: Page) -> None:
    give(files, TABLE)
    wait_said(files, "table.yaml was opened")
    before = objects(files)
    x, y = files.evaluate("() => hapticd.model.state.position_m")
    deep = TABLE.replace("center_m: [0.02, 0.03], radius_m: 0.01", f"center_m: [{x}, {y}], radius_m: 0.03")
    for name in ("deep.yaml", "other.yaml"):
        give(files, deep, name)
        fault = files.locator("#files-faults", has_text=f"{name}: ")
        fault.wait_for()
        assert "to apply it all the same, open it once more" in fault.inner_text()
        assert objects(files) == before
    give(files, deep, name)
    wait_said(files, "other.yaml was opened")
    assert objects(files)["ball"]["radius_m"] == 0.03
    assert files.locator("#files-faults").inner_text() == ""


def test_what_is_no_text_is_refused_by_name(files: Page) -> None:
    files.set_input_files("#yaml-file", {"name": "photo.yaml", "mimeType": "image/png", "buffer": b"\x89PNG\xff"})
    files.wait_for_function("() => document.querySelector('#files-faults').textContent !== ''")
    assert files.locator("#files-faults").inner_text() == "photo.yaml is not UTF-8 text"


def test_a_shipped_scene_is_chosen_by_its_name_and_saved(files: Page, tmp_path: Path) -> None:
    files.locator("#shipped-scene").select_option("corner")
    shown = "() => document.querySelector('#shipped-scene').closest('.row').nextElementSibling.textContent"
    assert files.evaluate(shown) == next(each.shows for each in described("scenes") if each.name == "corner")
    files.get_by_role("button", name="Open the shipped scenes").click()
    wait_said(files, "corner.yaml was opened")
    found = objects(files)
    file = save(files, tmp_path)
    assert file.name == "corner.yaml"
    checked(file)
    give(files, TABLE)
    wait_said(files, "table.yaml was opened")
    assert objects(files) != found
    give(files, file.read_text(encoding="utf-8"), file.name)
    wait_said(files, "corner.yaml was opened")
    assert objects(files) == found


def test_what_is_saved_keeps_the_comments_and_opens_again(files: Page, tmp_path: Path) -> None:
    give(files, TABLE)
    wait_said(files, "table.yaml was opened")
    files.evaluate(
        "() => hapticd.link.call('update_scene',"
        " { objects: { ball: { radius_m: 0.015 }, floor: { material: 'steel' } }, wait: true })"
    )
    changed = objects(files)
    file = save(files, tmp_path)
    assert wait_said(files, "table.yaml was saved") == "table.yaml was saved."
    wanted = TABLE.replace("radius_m: 0.01", "radius_m: 0.015").replace("material: wood", "material: steel")
    assert file.read_text(encoding="utf-8") == wanted
    checked(file)
    files.evaluate("() => hapticd.link.call('update_scene', { objects: { ball: { radius_m: 0.002 } }, wait: true })")
    give(files, wanted)
    wait_said(files, "table.yaml was opened")
    assert objects(files) == changed


def test_a_new_file_holds_scene_and_changed_materials(files: Page, tmp_path: Path) -> None:
    give(files, TABLE)
    wait_said(files, "table.yaml was opened")
    files.get_by_role("button", name="Start a new file").click()
    files.evaluate(
        "() => hapticd.link.call('update_materials', { materials: { wood: { stiffness_n_per_m: 321 } }, wait: true })"
    )
    before = objects(files)
    files.get_by_label("Name of the file").fill("a/table of mine")
    file = save(files, tmp_path)
    assert file.name == "a-table of mine.yaml"
    checked(file)
    text = file.read_text(encoding="utf-8")
    assert "# My table." not in text and "stiffness_n_per_m: 321" in text
    give(files, text, file.name)
    wait_said(files, "a-table of mine.yaml was opened")
    assert objects(files) == before
