"""Methods of files and recordings over the WebSocket: accepted and refused calls."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import aiohttp
import numpy as np
import pytest

from hapticd.base.core import SAMPLE_DTYPE
from hapticd.base.errors import HapticdError
from hapticd.config.materials import shipped_materials
from hapticd.protocol import messages
from hapticd.recording.recording import Recording
from hapticd.web import uploads
from hapticd.web.recording_methods import Recordings
from tests.support.fake_daemon import result
from tests.web.served import Tab, WebSite, served, tab

SCENE = {"objects": {"peg": {"kind": "disc", "center_m": [0.0, 0.0], "radius_m": 0.01, "material": "wood"}}}


def daemon(request: dict[str, Any]) -> list[bytes]:
    """Answer like a daemon that has scene and materials."""
    materials = {name: material.to_dict() for name, material in shipped_materials().items()}
    match request["method"]:
        case "apply" if "unknown" in str(request["params"]):
            problem = {"where": "scene.objects.peg.material", "problem": "unknown material"}
            return [messages.error_reply(request["id"], -32602, "invalid params", [problem])]
        case "apply":
            return [result(request, {"revision": 2, "tick": 3})]
        case "get_materials":
            return [result(request, {"materials": materials, "revision": 2})]
        case "get_scene":
            return [result(request, {"scene": SCENE, "revision": 2})]
    return []


@asynccontextmanager
async def site(folder: Path) -> AsyncIterator[tuple[WebSite, Tab]]:
    def nobody() -> Any:
        raise HapticdError("no daemon listens")

    async with served(daemon, recordings=Recordings(folder, nobody)) as found, tab(found) as page:
        yield found, page


def written(folder: Path, name: str = "tap.npz", count: int = 300) -> Path:
    samples = np.zeros(count, SAMPLE_DTYPE)
    samples["tick"] = np.arange(count)
    samples["time_ns"] = np.arange(count) * 100_000
    texts = {"config": {"servo": {"rate_hz": 10_000.0}}, "scene": SCENE, "changes": [{"revision": 0}]}
    folder.mkdir(exist_ok=True)
    return Recording(name, samples, [], texts).save(folder / name)


async def problem(page: Tab, method: str, params: dict[str, object]) -> Any:
    answer = await page.call(method, params)
    assert "error" in answer, answer
    return answer["error"]


def test_yaml_is_opened_and_faults_come_with_their_lines(tmp_path: Path) -> None:
    async def test() -> None:
        async with site(tmp_path) as (_, page):
            text = (
                "# mine\nscene:\n  objects:\n    peg: {kind: disc, center_m: [0, 0], radius_m: 0.01, material: wood}\n"
            )
            opened = (await page.call("web.yaml_open", {"name": "a.yaml", "text": text}))["result"]
            assert (opened["revision"], opened["objects"], opened["materials"]) == (2, 1, [])
            saved = (await page.call("web.yaml_save", {"opened": {"name": "a.yaml", "text": text, "others": {}}}))[
                "result"
            ]
            assert saved == {"text": text, "kept": True, "materials": []}
            bad = await problem(page, "web.yaml_open", {"name": "a.yaml", "text": text.replace("disc", "dis")})
            assert bad["message"] == "a.yaml: 1 fault; nothing was changed"
            assert (bad["data"][0]["line"], bad["data"][0]["where"]) == (4, "scene.objects.peg.kind")
            of_daemon = await problem(
                page, "web.yaml_open", {"name": "a.yaml", "text": text.replace("wood", "unknown")}
            )
            assert [(each["line"], each["problem"]) for each in of_daemon["data"]] == [(4, "unknown material")]

    asyncio.run(test())


def test_shipped_files_are_opened_by_name_alone(tmp_path: Path) -> None:
    async def test() -> None:
        async with site(tmp_path) as (_, page):
            found = (await page.call("web.yaml_shipped"))["result"]
            assert {"name": "corner", "shows": found["scenes"][1]["shows"]} == found["scenes"][1]
            opened = (await page.call("web.yaml_open_shipped", {"folder": "scenes", "name": "corner"}))["result"]
            assert opened["objects"] == 2 and opened["text"].startswith("# A wooden floor")
            for folder, name in (("scenes", "../play"), ("..", "default"), ("scenes", "/etc/passwd"), ("scenes", None)):
                refused = await problem(page, "web.yaml_open_shipped", {"folder": folder, "name": name})
                assert "must be" in refused["message"]

    asyncio.run(test())


@pytest.mark.parametrize(
    ("method", "params", "said"),
    [
        ("web.yaml_open", {}, "name: must be a text"),
        ("web.yaml_open", {"name": "a", "text": ["a"]}, "text: must be a text"),
        ("web.yaml_open", {"name": "a", "text": "a: &a [*a]"}, "1 fault"),
        ("web.yaml_save", {"parts": ["secrets"]}, "parts: must be"),
        ("web.yaml_save", {"opened": 3}, "opened: must be"),
        ("web.yaml_save", {"opened": {"name": "a", "text": "scene: {}", "others": 3}}, "others: must be"),
        ("web.recording_delete", {"name": "../x.npz"}, "name: must consist"),
        ("web.recording_delete", {"name": "x.npz"}, "no such recording"),
        ("web.record_start", {"name": "/tmp/x.npz"}, "name: must consist"),
        ("web.record_start", {"name": "x.npz"}, "no daemon listens"),
        ("web.record_stop", {}, "nothing is being recorded"),
        ("web.playback_open", {"name": "../x.npz"}, "name: must consist"),
        ("web.playback_open", {"name": "x.npz"}, "no such recording"),
        ("web.playback_open", {"upload": "../x"}, "the file was removed"),
        ("web.playback_open", {"upload": ["x"]}, "the file was removed"),
        ("web.playback_rows", {"first": 0, "count": 1}, "no recording is open"),
    ],
)
def test_wrong_params_are_refused(tmp_path: Path, method: str, params: dict[str, object], said: str) -> None:
    async def test() -> None:
        async with site(tmp_path) as (_, page):
            assert said in (await problem(page, method, params))["message"]

    asyncio.run(test())


def test_a_recording_is_opened_and_forgotten(tmp_path: Path) -> None:
    async def test() -> None:
        written(tmp_path)
        async with site(tmp_path) as (_, page):
            listed = (await page.call("web.recordings"))["result"]
            assert [each["name"] for each in listed["recordings"]] == ["tap.npz"]
            facts = (await page.call("web.playback_open", {"name": "tap.npz"}))["result"]
            assert (facts["rows"], facts["rate_hz"]) == (300, 10_000.0)
            rows = (await page.call("web.playback_rows", {"first": 290, "count": 20}))["result"]
            assert rows["count"] == 10
            outline = {"column": "force_n", "first": 0, "last": 300, "pixels": 30}
            assert len((await page.call("web.playback_outline", outline))["result"]["min"]) == 4 * 30
            assert (await page.call("web.playback_scene", {"row": 0}))["result"]["scene"] == SCENE
            for params in (
                {"first": "0", "count": 1},
                {"first": 0},
                {"first": 1.5, "count": 1},
                {"first": 0, "count": True},
            ):
                assert "must be an integer" in (await problem(page, "web.playback_rows", params))["message"]
            await page.call("web.playback_close")
            assert "no recording is open" in (await problem(page, "web.playback_scene", {"row": 0}))["message"]

    asyncio.run(test())


def test_what_is_no_recording_is_refused_without_its_path(tmp_path: Path) -> None:
    async def test() -> None:
        (tmp_path / "bad.npz").write_bytes(b"PK\x03\x04" + b"\xff" * 100)
        async with site(tmp_path) as (_, page):
            said = (await problem(page, "web.playback_open", {"name": "bad.npz"}))["message"]
            assert said.startswith("bad.npz: damaged, or not a recording of hapticd")
            assert str(tmp_path) not in said

    asyncio.run(test())


def test_downloads_take_a_cookie_and_names_of_the_folder(tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    path = written(folder, "tap 1.npz")
    (tmp_path / "secret.npz").write_text("secret")
    os.symlink(tmp_path / "secret.npz", folder / "link.npz")

    async def test() -> None:
        async with site(folder) as (found, _), aiohttp.ClientSession() as session:
            async with session.get(f"{found.url}/recordings/tap%201.npz") as without:
                assert without.status == 403
            async with session.get(f"{found.url}/recordings/tap%201.npz", headers=found.cookie) as answer:
                assert answer.status == 200
                assert await answer.read() == path.read_bytes()
                assert answer.headers["Content-Disposition"] == "attachment; filename*=UTF-8''tap%201.npz"
                assert answer.headers["X-Content-Type-Options"] == "nosniff"
            for name in ("link.npz", "..%2Fsecret.npz", "%2e%2e/secret.npz", "%2Fetc%2Fpasswd", "gone.npz"):
                async with session.get(f"{found.url}/recordings/{name}", headers=found.cookie) as answer:
                    assert answer.status == 404
                    assert "secret" not in (await answer.text()).replace("secret.npz", "")

    asyncio.run(test())


def test_a_file_that_is_sent_is_opened_once_and_removed(tmp_path: Path) -> None:
    path = written(tmp_path / "mine")

    async def test() -> None:
        async with site(tmp_path) as (found, page), aiohttp.ClientSession() as session:
            url, allowed = f"{found.url}/uploads?name=tap.npz", {**found.cookie, **found.origin}
            async with session.post(url, data=path.read_bytes(), headers=allowed) as answer:
                token = (await answer.json())["upload"]
            facts = (await page.call("web.playback_open", {"upload": token, "name": "tap.npz"}))["result"]
            assert (facts["rows"], facts["name"]) == (300, "tap.npz")
            assert "the file was removed" in (await problem(page, "web.playback_open", {"upload": token}))["message"]
            async with session.post(url, data=b"x", headers=found.cookie) as answer:
                assert answer.status == 403
            async with session.post(
                url, data=b"x", headers={**found.cookie, "Origin": "http://evil.example"}
            ) as answer:
                assert answer.status == 403
            async with session.post(url, data=b"x", headers=found.origin) as answer:
                assert answer.status == 403
            async with session.post(url.replace(".npz", ".yaml"), data=b"x", headers=allowed) as answer:
                assert answer.status == 415

    asyncio.run(test())


def test_a_file_that_is_too_large_is_not_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uploads, "MAX_UPLOAD_BYTES", 1000)

    async def in_pieces() -> AsyncIterator[bytes]:
        for _ in range(3):
            yield b"x" * 500

    async def test() -> None:
        async with site(tmp_path) as (found, _), aiohttp.ClientSession() as session:
            allowed = {**found.cookie, **found.origin}
            for data in (b"x" * 1001, in_pieces()):
                async with session.post(f"{found.url}/uploads?name=a.npz", data=data, headers=allowed) as answer:
                    assert answer.status == 413
            kept = found.pages.recordings._uploads  # type: ignore[union-attr]
            assert kept._folder is None or list(Path(kept._folder.name).iterdir()) == []

    asyncio.run(test())
