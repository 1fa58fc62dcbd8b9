"""Stiffness of discs at depth: bounds of the second derivatives of the stored energy, by difference quotients."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from hapticd.base.core import MATERIAL_DTYPE, Texture, records
from hapticd.rendering.disc_stiffness import round_properties

PRESS_N = 1.0


def stored(p: npt.NDArray[np.float64], material: np.void, radius: float, anchor: float) -> float:
    """The energy of a probe at p, which sticks to the rim at `anchor`."""
    r, angle = float(np.hypot(*p)), float(np.arctan2(p[0], p[1]))
    x = min(max((r / radius - 0.2) / 0.3, 0.0), 1.0)
    g, s = x * x * (3 - 2 * x), radius * angle
    height = float(material["depth_m"]) * (0.5 + 0.5 * np.cos(2 * np.pi * s / float(material["width_m"])))
    lowered = g * height if material["texture"] == Texture.GEOMETRY else 0.0
    elastic = 0.5 * float(material["stiffness_n_per_m"]) * (radius - r - lowered) ** 2
    return float(elastic + 0.5 * g * float(material["friction_stiffness_n_per_m"]) * (s - anchor) ** 2)


def stiffness(p: npt.NDArray[np.float64], material: np.void, radius: float, anchor: float) -> npt.NDArray[np.float64]:
    """Its second derivatives along the radius and around it, (2, 2)."""
    h = 1e-4 * radius
    outward = p / np.hypot(*p)
    axes = np.array([outward, [outward[1], -outward[0]]]) * h
    found = np.empty((2, 2))
    for i, a in enumerate(axes):
        for j, b in enumerate(axes):
            corners = [stored(p + u * a + v * b, material, radius, anchor) * u * v for u in (1, -1) for v in (1, -1)]
            found[i, j] = sum(corners) / (4 * h * h)
    return found


@pytest.mark.long
def test_no_point_of_a_disc_is_stiffer_than_the_bound() -> None:
    """Random discs, random places up to 1 N deep, stuck within mu F_n: the form is nowhere above the bound."""
    rng = np.random.default_rng(3)
    nearest = 0.0
    for _ in range(30):
        material = records(MATERIAL_DTYPE, 1)
        material["stiffness_n_per_m"] = k = rng.uniform(200, 3000)
        material["width_m"], material["spacing_m"] = 0.001, 0.001
        mu = 0.0
        if rng.random() < 0.7:
            material["friction_coefficient"] = mu = rng.uniform(0.05, 1)
            material["friction_stiffness_n_per_m"] = rng.uniform(100, 2000)
        if mu == 0.0 or rng.random() < 0.5:
            material["texture"], material["depth_m"] = Texture.GEOMETRY, rng.uniform(1e-5, 2e-4)
        radius = float(rng.choice([0.001, 0.002, 0.005, 0.02]))
        bound = round_properties(np.array([radius]), material, PRESS_N)
        allowed = np.diag([bound.normal[0], bound.tangent[0]])
        for _ in range(30):
            depth = rng.uniform(0.0, min(PRESS_N / k, 0.97 * radius))
            angle = rng.uniform(-3, 3)
            p = (radius - depth) * np.array([np.sin(angle), np.cos(angle)])
            stuck = mu * k * depth / max(float(material["friction_stiffness_n_per_m"][0]), 1.0)
            form = stiffness(p, material[0], radius, radius * angle + rng.choice([-1, 0, 1]) * stuck)
            over = float(np.linalg.eigvalsh(form - allowed).max())
            assert over <= 1e-3 * allowed.max()
            nearest = max(nearest, 1 + over / allowed.max())
    assert nearest > 0.9  # it is no empty bound


def test_a_disc_that_is_large_is_as_stiff_as_a_wall() -> None:
    material = records(MATERIAL_DTYPE, 1)
    material["stiffness_n_per_m"], material["friction_coefficient"] = 800, 0.3
    material["friction_stiffness_n_per_m"] = 500
    found = round_properties(np.array([100.0]), material, PRESS_N)
    assert abs(found.normal[0] / 800 - 1) < 1e-3
    assert abs(found.tangent[0] / 500 - 1) < 1e-3
    assert abs(found.friction_per_depth[0] / 240 - 1) < 1e-3


def test_on_a_small_disc_friction_is_several_times_as_stiff() -> None:
    """1 N on a radius of 1.5 mm goes to 0.17 R: at most (R/r)^2 g = 4.67, at 0.41 R."""
    material = records(MATERIAL_DTYPE, 1)
    material["stiffness_n_per_m"], material["friction_coefficient"] = 800, 0.3
    material["friction_stiffness_n_per_m"] = 500
    assert round_properties(np.array([0.0015]), material, PRESS_N).spring[0] / 500 == pytest.approx(4.67, abs=0.01)
