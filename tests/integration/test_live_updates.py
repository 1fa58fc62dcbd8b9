"""Scene updates as fast as they come, while the simulated hand presses on a wall and a tap rings."""

from __future__ import annotations

import threading

import msgpack
import numpy as np
import pytest

from tests.support.daemon_process import connect, running_daemon, wired

FLOOR = {"kind": "wall", "point_m": [0.0, 0.0], "normal": [0.0, 1.0], "material": "wood"}
UPDATES = 3000
RAMP_S = 0.02
RAMP_TICKS = 200  # at the 10 kHz of the daemon
EVERY = 100  # of them is a play, and one a reset of another object


@pytest.mark.long
def test_updates_lose_nothing_and_step_nothing() -> None:
    with running_daemon() as daemon, wired(daemon) as wire:
        wire.result("set_scene", scene={"objects": {"floor": FLOOR, "far": {**FLOOR, "point_m": [0, -0.06]}}})
        batches: list[np.ndarray] = []
        done = threading.Event()
        end = 0
        with connect(daemon.directory) as client, client.samples() as samples:

            def listen() -> None:
                for batch in samples:
                    assert batch.lost == 0
                    batches.append(np.array(batch))
                    if done.is_set() and batch["tick"][-1] >= end:
                        return

            with client.events() as events:
                listener = threading.Thread(target=listen)
                listener.start()
                wire.result("set_operator", waypoints=[[0.05, 0, 0.002], [0.3, 0, -0.004], [0.6, 0, -0.004]])
                while True:
                    event = next(events)
                    if event["event"] == "contact":
                        break
            # Pressed: let it come to rest, then go.
            while len(batches) < 50:
                done.wait(0.05)
            strikes = wire.result("get_status")["counters"]["strikes"]
            begin = wire.result("get_status")["tick"]
            ticks = []
            for n in range(UPDATES):
                stiff = {"kind": "wall", "material": "wood", "point_m": [0, 1e-5 * (n % 2)]}
                answer = wire.result("update_scene", objects={"floor": stiff})
                assert answer["revision"]
                if n % EVERY == 0:
                    ticks.append(wire.result("play", material="wood", direction=[1, 0], amplitude_m_per_s2=0.5)["tick"])
                    wire.result("reset", objects=["far"])
            end = wire.result("get_status")["tick"]
            assert wire.result("get_status")["counters"]["strikes"] - strikes == UPDATES // EVERY
            assert len(set(ticks)) == UPDATES // EVERY
            done.set()
            listener.join()
        data = np.concatenate(batches)
        span = data[(data["tick"] >= begin) & (data["tick"] < end)]
        assert len(span) == end - begin
        assert len(np.unique(span["revision"])) > UPDATES / 3
        # In contact throughout: the force never falls to nothing, and steps by no more than a ramp of the whole force.
        contact = span["contact_force_n"][:, 1]
        largest = contact.max()
        # After a stall longer than the ramp, the contact force rises from zero over a ramp that counts ticks. The ramp
        # of what the updates change is added to it. Neither is steeper than one ramp of the whole force.
        stalls = np.flatnonzero(np.diff(span["time_ns"]) > RAMP_S * 1e9) + 1
        resumed = np.zeros(len(span), bool)
        for stall in stalls.tolist():
            resumed[stall : stall + 2 * RAMP_TICKS] = True
        assert contact[~resumed].min() > 0.3 * largest
        moved = 800 * np.abs(np.diff(span["position_m"][:, 1]))  # what the hand itself moved
        whole = 800 * (1e-5 - span["position_m"][:, 1].min())  # what the deepest place calls for
        ramps = np.where(resumed[1:], 2, 1)
        allowed = moved + ramps * whole * np.diff(span["time_ns"]) * 1e-9 / RAMP_S
        assert np.all(np.abs(np.diff(contact)) <= allowed + 1e-9)
        assert wire.result("get_status")["counters"]["samples_dropped"] == 0
        for tick in ticks:
            if np.any((span["tick"][stalls] > tick) & (span["tick"][stalls] < tick + 60)):
                continue  # it has rung out meanwhile
            ringing = span[(span["tick"] > tick) & (span["tick"] < tick + 60)]["vibration_force_n"][:, 0]
            assert np.any(ringing != 0.0)


@pytest.mark.long
def test_every_answer_is_msgpack_with_the_same_form() -> None:
    with running_daemon() as daemon, wired(daemon) as wire:
        (frame,) = wire.raw(msgpack.packb({"jsonrpc": "2.0", "id": "a", "method": "get_scene"}))
        assert set(msgpack.unpackb(frame)) == {"jsonrpc", "id", "result"}
