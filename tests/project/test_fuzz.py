"""A short run of each fuzzer with other seeds than `make fuzz`, and inputs that long runs found."""

from __future__ import annotations

import io
import json
import random
import struct
import threading
import zipfile
from pathlib import Path

import msgpack
import numpy as np
import pytest
import zmq

from hapticd.base.errors import HapticdError
from hapticd.config.configuration import load_config
from hapticd.config.materials import validate_materials
from hapticd.config.operator import parse_operator
from hapticd.config.scene import validate_scene
from hapticd.recording.recording import load
from hapticd.recording.replay import replay
from tests.soak import fuzz_messages, fuzz_recordings, fuzz_yaml, fuzz_zmtp


@pytest.mark.long
def test_messages() -> None:
    found = fuzz_messages.run(random.Random(101), 400)
    assert {0, -32700, -32600, -32602} <= found.outcomes.keys(), "some kind of message was not among them"


def test_zmtp() -> None:
    assert 0 < fuzz_zmtp.run(random.Random(105), 2000) < 2000


@pytest.mark.parametrize(("kind", "runs"), [("config", 200), ("check", 20), ("operator", 100)])
def test_documents(kind: str, runs: int) -> None:
    found = fuzz_yaml.run(kind, random.Random(102), runs)
    assert found.outcomes["taken"] > 0
    assert found.outcomes["refused"] > 0


@pytest.mark.long
def test_reloads() -> None:
    outcomes = fuzz_yaml.run_reloads(random.Random(103), 20, lambda _: None)
    assert outcomes["refused"] == 20


@pytest.mark.long
def test_recordings() -> None:
    outcomes, _, most = fuzz_recordings.run(random.Random(104), 150)
    assert most < fuzz_recordings.LIMIT_BYTES
    tried = {outcome.split()[0] for outcome in outcomes}
    assert tried == set(fuzz_recordings.FORMS)
    # Files of killed recordings are rarer than complete files, and more of them can be used.
    complete = [form for form in fuzz_recordings.FORMS if not form.startswith("left")]
    assert all(outcomes[f"{form} refused"] > 0 for form in complete)
    assert any(outcomes[f"{form} refused"] > 0 for form in fuzz_recordings.FORMS if form not in complete)
    assert any(outcome.endswith("rendered") for outcome in outcomes)


def test_the_initial_inputs_are_valid() -> None:
    for material in fuzz_yaml.MATERIALS:
        validate_materials({"mine": material})
    for item in fuzz_yaml.OBJECTS:
        validate_scene({"objects": {"mine": item}})
    for device in fuzz_yaml.DEVICES:
        load_config({"device": device})
    for gesture in fuzz_yaml.GESTURES:
        parse_operator(gesture)


# ---- The fuzzers' own checks -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("body", "codes"),
    [
        (b"", {-32700}),
        (b"\xc1", {-32700}),
        (b"\x80\x00", {-32700}),
        (b"\x81\x01\x01", {-32700}),
        (b"\x82\xa1a\x01\xa1a\x01", {-32700}),
        (b"\xd4\x01x", {-32700}),
        (b"\xa1\xff", {-32700}),
        (b"\x91" * 32 + b"\xc0", {-32600}),
        (b"\x91" * 33 + b"\xc0", {-32700}),
        (b"\xdd\xff\xff\xff\xff", {-32700}),
        (b"\x01", {-32600}),
    ],
)
def test_what_a_body_is_answered_with(body: bytes, codes: set[int]) -> None:
    assert fuzz_messages.expected([body]).codes == codes
    assert fuzz_messages.expected([b"", body]).codes == codes
    assert fuzz_messages.expected([b"x", body]).codes == {-32600}


# ---- Recordings that claim more than they hold -------------------------------------------------------------------


def archive(path: Path, **members: bytes) -> Path:
    with zipfile.ZipFile(path, "w") as file:
        for name, member in members.items():
            file.writestr(f"{name}.npy", member)
    return path


def array(header: str, data: bytes = b"") -> bytes:
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode() + data


def saved(value: object) -> bytes:
    made = io.BytesIO()
    np.save(made, np.asarray(value))
    return made.getvalue()


def answered_late(directory: Path, stopped: threading.Event) -> None:
    """Serve a command socket that answers changes only if no other message comes, as a daemon answers long changes."""
    change = msgpack.packb({"jsonrpc": "2.0", "id": None, "result": {"revision": 7}})
    bad = msgpack.packb({"jsonrpc": "2.0", "id": None, "error": {"code": -32700, "message": "1 trailing bytes"}})
    held: list[list[bytes]] = []
    with zmq.Context() as context, context.socket(zmq.ROUTER) as router:
        router.linger = 0
        router.bind(f"ipc://{directory}/hapticd.command")
        while not stopped.is_set():
            if not router.poll(20):
                for each in held:
                    router.send_multipart(each)
                held.clear()
                continue
            identity, *envelope, body = router.recv_multipart()
            if b"update_scene" not in body:
                unknown = {"jsonrpc": "2.0", "id": "sentinel", "error": {"code": -32601, "message": "no such method"}}
                router.send_multipart([identity, *envelope, msgpack.packb(unknown)])
            elif body.endswith(b"\0"):
                router.send_multipart([identity, *envelope, bad])
            else:
                held.append([identity, *envelope, change])


def test_answers_without_an_id_are_distinguished(tmp_path: Path) -> None:
    """The oldest message without an id was a change, which is answered late; the answer was that of another message."""
    stopped = threading.Event()
    server = threading.Thread(target=answered_late, args=(tmp_path, stopped))
    server.start()
    params = {"objects": {"floor": {"kind": "wall"}}}
    change = msgpack.packb({"jsonrpc": "2.0", "id": None, "method": "update_scene", "params": params})
    traffic = fuzz_messages.Traffic(tmp_path)
    try:
        for _ in range(fuzz_messages.CONNECTIONS):
            traffic.send(fuzz_messages.expected([change]))
        for _ in range(fuzz_messages.CONNECTIONS):
            traffic.send(fuzz_messages.expected([b"", change + b"\0"]))
        traffic.settle()
    finally:
        traffic.close()
        stopped.set()
        server.join()
    assert traffic.outcomes == {0: 8, -32700: 8, -32601: 8}


@pytest.mark.parametrize(
    "member",
    [
        array("{'descr': '<f8', 'fortran_order': False, 'shape': (1099511627776,), }"),
        array("{'descr': '<f8', 'fortran_order': False, 'shape': (-8,), }"),
        array("{'descr': '|O', 'fortran_order': False, 'shape': (1,), }", b"cos\nsystem\n."),
        array("{'descr': '<f8', 'fortran_order': False, 'shape': " + "(" * 60),
        array("{'descr': '<f8', 'fortran_order': " + "-" * 5000 + "1, 'shape': (1,), }", bytes(8)),
        saved([1.0, 2.0]),
        saved(1.0),
        b"",
    ],
    ids=(
        "a terabyte",
        "less than nothing",
        "pickled",
        "open brackets",
        "many signs",
        "no fields",
        "one number",
        "empty",
    ),
)
def test_invalid_samples_are_refused(tmp_path: Path, member: bytes) -> None:
    path = archive(tmp_path / "a.npz", samples=member)
    with fuzz_recordings.bounded_memory(), pytest.raises(HapticdError) as caught:
        load(path)
    fuzz_recordings.check_refusal(caught.value, path)


def changed_npz(path: Path, at: int, value: bytes) -> Path:
    """Write a recording whose zip directory has another value for its first member."""
    content = bytearray(fuzz_recordings.whole(".npz")[".npz"])
    place = content.find(b"PK\x01\x02") + at
    content[place : place + len(value)] = value
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(("at", "value"), [(8, b"\x01\x00"), (10, b"\x63\x00"), (24, bytes(4))])
def test_archives_that_cannot_be_read(tmp_path: Path, at: int, value: bytes) -> None:
    path = changed_npz(tmp_path / "a.npz", at, value)
    with pytest.raises(HapticdError) as caught:
        load(path)
    fuzz_recordings.check_refusal(caught.value, path)


def test_too_long_texts_are_refused(tmp_path: Path) -> None:
    with np.load(io.BytesIO(fuzz_recordings.whole(".npz")[".npz"])) as file:
        samples = saved(file["samples"])
    path = archive(tmp_path / "a.npz", samples=samples, scene=saved("[" * 200_000))
    with pytest.raises(HapticdError) as caught:
        load(path)
    fuzz_recordings.check_refusal(caught.value, path)


def test_texts_that_are_not_unicode_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(io.BytesIO(fuzz_recordings.whole(".npz")[".npz"])) as old:
        members = {name.removesuffix(".npy"): old.read(name) for name in old.namelist()}
    text = members["materials"]
    members["materials"] = text.replace("w".encode("utf-32-le"), b"\xff\xff\xff\x7f")
    with pytest.raises(HapticdError) as caught:
        load(archive(path, **members))
    fuzz_recordings.check_refusal(caught.value, path)
    members["materials"] = text
    assert "wood" in load(archive(path, **members)).texts["materials"]


@pytest.mark.parametrize("direction", [[0.0, 0.0], [1.0], [], "up"])
def test_invalid_directions_of_played_modes_are_refused(tmp_path: Path, direction: object) -> None:
    with zipfile.ZipFile(io.BytesIO(fuzz_recordings.whole(".npz")[".npz"])) as file:
        members = {name.removesuffix(".npy"): file.read(name) for name in file.namelist()}
    changes = json.loads(str(np.load(io.BytesIO(members["changes"]))))
    (played,) = [change["play"] for change in changes if "play" in change]
    played["direction"] = direction
    members["changes"] = saved(json.dumps(changes))
    path = archive(tmp_path / "a.npz", **members)
    with pytest.raises(HapticdError) as caught:
        replay(path)
    fuzz_recordings.check_refusal(caught.value, path)
