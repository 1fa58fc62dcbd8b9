"""Stiffness of discs at depth: bounds of the second derivatives of the stored energy, by difference quotients.

The energy of friction's spring depends on the path of the probe, so its bound is compared with forces of the core.
"""

from __future__ import annotations

from copy import deepcopy

import numpy as np
import numpy.typing as npt
import pytest

from bench.loops import Case, draw, settle
from bench.stability import evaluated
from hapticd.base.core import MATERIAL_DTYPE, Texture, records
from hapticd.config.configuration import load_config
from hapticd.rendering.disc_stiffness import round_properties
from tests.support.rig import Rig

PRESS_N = 1.0


def stored(p: npt.NDArray[np.float64], material: np.void, radius: float) -> float:
    """The energy of a probe at p, without friction."""
    r, angle = float(np.hypot(*p)), float(np.arctan2(p[0], p[1]))
    x = min(max((r / radius - 0.2) / 0.3, 0.0), 1.0)
    g, s = x * x * (3 - 2 * x), radius * angle
    height = float(material["depth_m"]) * (0.5 + 0.5 * np.cos(2 * np.pi * s / float(material["width_m"])))
    lowered = g * height if material["texture"] == Texture.GEOMETRY else 0.0
    return 0.5 * float(material["stiffness_n_per_m"]) * (radius - r - lowered) ** 2


def stiffness(p: npt.NDArray[np.float64], material: np.void, radius: float) -> npt.NDArray[np.float64]:
    """Its second derivatives along the radius and around it, (2, 2)."""
    h = 1e-4 * radius
    outward = p / np.hypot(*p)
    axes = np.array([outward, [outward[1], -outward[0]]]) * h
    found = np.empty((2, 2))
    for i, a in enumerate(axes):
        for j, b in enumerate(axes):
            corners = [stored(p + u * a + v * b, material, radius) * u * v for u in (1, -1) for v in (1, -1)]
            found[i, j] = sum(corners) / (4 * h * h)
    return found


@pytest.mark.long
def test_no_point_of_a_shaped_disc_is_stiffer_than_the_bound() -> None:
    """Random discs, random places up to 1 N deep: the form is nowhere above the bound."""
    rng = np.random.default_rng(3)
    nearest = 0.0
    for _ in range(30):
        material = records(MATERIAL_DTYPE, 1)
        material["stiffness_n_per_m"] = k = rng.uniform(200, 3000)
        material["width_m"], material["spacing_m"] = 0.001, 0.001
        material["texture"], material["depth_m"] = Texture.GEOMETRY, rng.uniform(1e-5, 2e-4)
        radius = float(rng.choice([0.001, 0.002, 0.005, 0.02]))
        bound = round_properties(np.array([radius]), material, PRESS_N)
        allowed = np.diag([bound.normal[0], bound.tangent[0]])
        for _ in range(30):
            depth = rng.uniform(0.0, min(PRESS_N / k, 0.97 * radius))
            angle = rng.uniform(-3, 3)
            p = (radius - depth) * np.array([np.sin(angle), np.cos(angle)])
            over = float(np.linalg.eigvalsh(stiffness(p, material[0], radius) - allowed).max())
            assert over <= 1e-3 * allowed.max()
            nearest = max(nearest, 1 + over / allowed.max())
    assert nearest > 0.9  # it is no empty bound


def test_no_step_on_a_rubbing_disc_gives_more_than_the_bound_allows() -> None:
    """F.dx of the force before a step is at most the energy that the disc loses, and the bound's form of the step.

    The energies are those of the two springs, from the forces at both ends, which are held by stiffnesses K and k.
    """
    rng = np.random.default_rng(5)
    nearest = 0.0
    for _ in range(300):
        k, spring, mu = float(rng.uniform(200, 3000)), float(rng.uniform(100, 2000)), float(rng.uniform(0.1, 2))
        radius = float(rng.choice([0.001, 0.002, 0.005]))
        material = records(MATERIAL_DTYPE, 1)
        material["stiffness_n_per_m"], material["friction_coefficient"] = k, mu
        material["friction_stiffness_n_per_m"] = spring
        bound = round_properties(np.array([radius]), material, k * radius)
        friction = {"coefficient": mu, "stiffness_n_per_m": spring}
        rig = Rig(
            {"peg": {"kind": "disc", "center_m": [0, 0], "radius_m": radius, "material": "rough"}},
            materials={"rough": {"stiffness_n_per_m": k, "friction": friction}},
        )
        r = float(rng.uniform(0.22, 0.98)) * radius
        far = float(rng.uniform(-1.2, 1.2)) * mu * k * (radius - r) / spring / r
        angle = np.concatenate([np.zeros(300), np.linspace(0, far, 300)])
        height = np.concatenate([np.linspace(1.1 * radius, r, 300), np.full(300, r)])
        path = np.column_stack([height * np.sin(angle), height * np.cos(angle)])
        step = rng.normal(size=2) * radius * 10 ** rng.uniform(-4, -2)
        force = rig.render(np.concatenate([path, path[-1:] + step]))["contact_force_n"][-2:]
        ends = np.stack([path[-1], path[-1] + step])
        outward = ends / np.hypot(*ends.T)[:, None]
        normal = np.sum(force * outward, axis=1)
        along = force[:, 0] * outward[:, 1] - force[:, 1] * outward[:, 0]
        energy = normal**2 / (2 * k) + along**2 / (2 * spring)
        allowed = bound.normal[0] * (step @ outward[0]) ** 2
        allowed += bound.tangent[0] * (step[0] * outward[0, 1] - step[1] * outward[0, 0]) ** 2
        given = 2 * (float(force[0] @ step) + energy[1] - energy[0])
        assert given <= allowed * (1 + 3 * float(np.hypot(*step)) / r)  # the terms of third order
        nearest = max(nearest, given / allowed)
    assert nearest > 0.9


def at_its_margin(seed: int) -> Case | None:
    """A loop with a disc that rubs, at 0.99 of the safe stiffness, and small enough to be pressed nearly to its centre.

    None if the margin cannot be reached, because it does not scale with the stiffness.
    """
    rng = np.random.default_rng((61, seed))
    case = draw(seed, ("disc",))
    assert case is not None
    source = deepcopy(case.source)
    material, disc = source["materials"]["b"], source["scene"]["objects"]["disc"]
    hand_n_per_m = source["device"]["sim"]["hand"]["stiffness_n_per_m"]
    ratio, press_n = float(rng.uniform(0.3, 3)), float(rng.uniform(0.3, 1))
    material["friction"] = {"coefficient": float(rng.uniform(0.1, 1.5)), "stiffness_n_per_m": 1.0}
    factor = 1.0
    for _ in range(8):
        k = material["stiffness_n_per_m"] = float(np.clip(0.99 * factor * material["stiffness_n_per_m"], 0.1, 9e4))
        material["friction"]["stiffness_n_per_m"] = min(9e4, ratio * k)
        disc["radius_m"] = float(np.clip(rng.uniform(1.02, 1.5) * press_n / k, 1e-4, 0.1))
        disc["center_m"] = [0, -disc["radius_m"]]
        factor = float(evaluated(load_config(source)).factor.min())
    if not (evaluated(load_config(source)).safe.all() and factor < 1.3):
        return None
    deep_m, radius_m = press_n * (1 / hand_n_per_m + 1 / k), disc["radius_m"]
    waypoints = [[0.0, float(rng.uniform(-1, 1)) * radius_m, 0.005]]
    for part in (1.0, 1.0, 0.3, 1.0):
        along_m = float(rng.uniform(-1.5, 1.5)) * radius_m
        waypoints.append([waypoints[-1][0] + float(rng.uniform(0.05, 0.3)), along_m, -part * deep_m])
    source["device"]["sim"]["start_m"] = waypoints[0][1:]
    return Case(seed, "disc", source, waypoints, factor)


@pytest.mark.long
def test_a_rubbing_disc_just_inside_its_margin_comes_to_rest() -> None:
    """Random devices and hands: pressed deep, slid around the disc, partly out and in again."""
    cases = [case for seed in range(50) if (case := at_its_margin(seed)) is not None]
    assert len(cases) > 30
    for case in cases:
        assert settle(case, "observe", 120.0).rests, case.seed


def test_a_disc_that_is_large_is_as_stiff_as_a_wall() -> None:
    material = records(MATERIAL_DTYPE, 1)
    material["stiffness_n_per_m"], material["friction_coefficient"] = 800, 0.3
    material["friction_stiffness_n_per_m"] = 500
    found = round_properties(np.array([100.0]), material, PRESS_N)
    assert abs(found.normal[0] / 800 - 1) < 1e-3
    assert abs(found.tangent[0] / 500 - 1) < 1e-3
    assert abs(found.friction_per_depth[0] / 240 - 1) < 1e-3


def test_on_a_small_disc_friction_is_as_stiff_as_on_a_wall() -> None:
    """Along the surface; along the radius mu^2 F_n / (4 r) are added, at 0.2 R at most, where F_n is 0.96 N."""
    material = records(MATERIAL_DTYPE, 1)
    material["stiffness_n_per_m"], material["friction_coefficient"] = 800, 0.3
    material["friction_stiffness_n_per_m"] = 500
    found = round_properties(np.array([0.0015]), material, PRESS_N)
    assert found.spring[0] == 500
    assert found.normal[0] == pytest.approx(800 + 0.09 * 0.96 / (4 * 0.0003))
