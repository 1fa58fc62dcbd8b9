"""The force limit: strikes scaled whole, the wall last, nothing clipped into another waveform."""

from __future__ import annotations

import numpy as np
import pytest

from hapticd.base.core import EventKind, Flag, Status, ffi, lib
from hapticd.config.materials import shipped_materials
from tests.support.rig import FLOOR, Rig, line, still

RATE = 10_000


def closed(mode: object, since: np.ndarray) -> np.ndarray:
    from hapticd.config.materials import Mode

    assert isinstance(mode, Mode)
    wave = np.exp(-mode.decay_rate_per_s * since) * np.sin(mode.angular_frequency_rad_per_s * since)
    return np.where((since >= 0) & (since <= 5 / mode.decay_rate_per_s), wave, 0.0)


def test_strike_beyond_the_headroom_is_scaled_whole() -> None:
    """Steel at 0.4 m/s wants 22 N on an actuator of 5 N: the same waveform, smaller, and the scale is reported."""
    speed, steel = 0.4, shipped_materials()["steel"].tap
    assert steel is not None
    rig = Rig({"w": {**FLOOR, "material": "steel"}}, device={"effective_mass_kg": 0.05, "max_force_n": 5})
    samples = rig.render(line(0.0123, speed, 360))
    (contact,) = rig.of(EventKind.CONTACT)
    scale = contact["scale"]
    assert 0 < scale < 1
    assert contact["amplitude_m_per_s2"] == pytest.approx(1692 * speed)
    onset = contact["tick"] / RATE - contact["before_tick_s"]
    wave = 0.05 * 1692 * speed * closed(steel.mode, np.arange(360) / RATE - onset)
    vibration = samples["vibration_force_n"][:, 1]
    assert np.allclose(vibration, scale * wave, rtol=0, atol=1e-12 * 22)
    # It used the room that there was: the closed form's peak and the wall's growth until then reach the limit.
    peak = scale * 0.05 * 1692 * speed * steel.mode.peak
    assert peak + 800 * speed * steel.mode.peak_time_s == pytest.approx(5, rel=1e-9)
    assert np.hypot(*samples["force_n"].T).max() <= 5
    assert samples["flags"][int(contact["tick"])] & Flag.SATURATED
    assert np.array_equal(samples["force_n"], samples["contact_force_n"] + samples["vibration_force_n"])


def test_wall_that_grows_into_a_ringing_mode_takes_the_room_from_it() -> None:
    rig = Rig({"w": FLOOR}, device={"effective_mass_kg": 0.05, "max_force_n": 3})
    samples = rig.render(line(0.001, 0.3, 160))
    force = samples["force_n"][:, 1]
    assert force.max() <= 3
    both = samples["contact_force_n"][:, 1] + samples["vibration_force_n"][:, 1]
    inside = samples["contact_force_n"][:, 1] + np.abs(samples["vibration_force_n"][:, 1]) <= 3
    assert np.allclose(force[inside], both[inside], rtol=0, atol=1e-15)
    assert np.any(both > 3)
    # Between the ticks that scaled it, what rings is the same mode: each sample follows from the two before.
    mode = shipped_materials()["wood"].tap.mode  # type: ignore[union-attr]
    z = np.exp((-mode.decay_rate_per_s + 1j * mode.angular_frequency_rad_per_s) / RATE)
    vibration = samples["vibration_force_n"][:, 1]
    cut = np.flatnonzero(~inside)
    struck = int(rig.of(EventKind.CONTACT)[0]["tick"])
    for k in range(struck + 2, 160):
        if not any(c in (k - 1, k - 2) for c in cut):
            predicted = 2 * z.real * vibration[k - 1] - abs(z) ** 2 * vibration[k - 2]
            assert vibration[k] == pytest.approx(predicted, abs=1e-12)
    # Nothing is flat at the limit: a clipped waveform would repeat it with the wall constant.
    (saturation,) = [e for e in rig.of(EventKind.SATURATION)][:1]
    assert saturation["value"] > 3


def test_wall_beyond_the_limit_is_cut_last_and_along_its_direction() -> None:
    normal = np.array([0.6, 0.8])
    wall = {**FLOOR, "normal": normal.tolist()}
    rig = Rig({"w": wall}, device={"max_force_n": 2})
    samples = rig.render(np.outer(-np.linspace(0, 0.01, 1000), normal))
    force = np.hypot(*samples["force_n"].T)
    assert force.max() <= 2
    assert force[-1] == pytest.approx(2, rel=1e-12)
    assert np.allclose(samples["force_n"][-1], 2 * normal, rtol=1e-12)
    assert samples["contact_force_n"][-1] == pytest.approx(8 * normal, rel=1e-9)
    assert not np.any(samples["vibration_force_n"][-1])


def test_limit_holds_for_anything(rng_seed: int = 5) -> None:
    rng = np.random.default_rng(rng_seed)
    walls = {
        f"w{i}": {
            "kind": "wall",
            "point_m": rng.uniform(-0.01, 0.01, 2).tolist(),
            "normal": rng.normal(size=2).tolist(),
            "material": ["wood", "steel", "glass", "acrylic"][i % 4],
        }
        for i in range(8)
    }
    walls["skin"] = {
        "kind": "membrane",
        "center_m": [0, 0],
        "normal": [1, 1],
        "width_m": 0.02,
        "material": "cellophane",
    }
    walls["pull"] = {"kind": "spring", "center_m": [0.1, 0], "stiffness_n_per_m": 1000}
    rig = Rig(walls, device={"effective_mass_kg": 0.2, "max_force_n": 4, "max_speed_m_per_s": 1000})
    path = np.cumsum(rng.normal(0, 1e-3, (20_000, 2)), axis=0) * 0.2
    samples = rig.render(path)
    force = np.hypot(*samples["force_n"].T)
    assert np.all(np.isfinite(force))
    assert force.max() <= 4


def test_force_at_the_very_limit_is_a_force_and_no_fault() -> None:
    """A field of exactly the limit, in every direction: rounding puts some a little above it and some below."""
    for degrees in range(360):
        angle = np.radians(degrees)
        push = {"kind": "constant", "force_n": [8.9 * np.cos(angle), 8.9 * np.sin(angle)]}
        rig = Rig({"push": push}, device={"max_force_n": 8.9})
        samples = rig.render(still(0, 0, 3))
        assert lib.hd_state_faults(rig.state) == 0, degrees
        force = np.hypot(*samples["force_n"].T)
        assert np.all(force <= 8.9)
        assert force == pytest.approx(8.9, rel=1e-12)


def test_limit_that_is_no_limit_is_refused() -> None:
    for limit in (0.0, 1e-7, -1.0, 1e7):
        rig = Rig({"w": FLOOR})
        rig.table.max_force_n = limit
        world = ffi.gc(lib.hd_world_new(), lib.hd_world_free)
        assert lib.hd_world_load(world, rig.table) == Status.ERR_INVALID
