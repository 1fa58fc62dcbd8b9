"""Figures that no known material has are reported with the unit that they may be in; shipped ones never are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import hapticd
from hapticd import shipped
from hapticd.analysis.check import check
from hapticd.base.errors import InvalidError
from hapticd.base.yaml_source import load_text
from hapticd.config.configuration import load_config
from hapticd.config.materials import shipped_materials
from hapticd.config.scene import Spring, Viscous
from hapticd.rendering.offline import render_run
from hapticd.rendering.placement import Reach, placement_warnings
from hapticd.rendering.plausibility import field_problem, figure_warnings
from tests.support.page_blocks import blocks

ROOT = Path(__file__).parents[2]
CONFIG = Path(shipped.__path__[0])
FLOOR = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "m"}
GROOVES = {"kind": "grooves", "display": "geometry", "spacing_m": 0.002, "width_m": 0.001, "depth_m": 0.0001}
TAP = {"attack_slope_per_s": 309, "frequency_hz": 67, "decay_time_s": 0.00648}
RUPTURE = {"depth_m": 0.004, "amplitude_m_per_s2": 38, "decay_rate_per_s": 330, "angular_frequency_rad_per_s": 1260}
NOISE = {"kind": "stochastic", "peak_hz": 250, "mean_hz": 310, "velocity_gain_per_s": 40}


def found(**keys: Any) -> dict[str, str]:
    config = load_config({"materials": {"m": {"stiffness_n_per_m": 800, **keys}}})
    return {each.where: each.problem for each in figure_warnings("m", config.materials["m"])}


@pytest.mark.parametrize(
    ("keys", "where", "remedy"),
    [
        ({"stiffness_n_per_m": 0.8}, "stiffness_n_per_m", "if it is in N/mm, write 800"),
        ({"damping_n_s_per_m": 900}, "damping_n_s_per_m", "if it is in mN s/m, write 0.9"),
        ({"friction": {"coefficient": 0.2, "stiffness_n_per_m": 0.5}}, "friction.stiffness_n_per_m", "write 500"),
        ({"tap": {**TAP, "frequency_hz": 1.7}}, "tap", "if it is in kHz, write 1700"),
        ({"tap": {**TAP, "decay_time_s": 6.48}}, "tap", "if it is in ms, write 0.00648"),
        ({"tap": {**TAP, "attack_slope_per_s": 0.309}}, "tap.attack_slope_per_s", "if it is in 1/ms, write 309"),
        (
            {"tap": {"amplitudes": [[50, 15], [100, 30]], "frequency_hz": 67, "decay_time_s": 0.006}},
            "tap.amplitudes",
            "if it is in mm/s, write 0.1",
        ),
        ({"rupture": {**RUPTURE, "depth_m": 0.4}}, "rupture.depth_m", "if it is in mm, write 0.0004"),
        ({"rupture": {**RUPTURE, "amplitude_m_per_s2": 0.05}}, "rupture.amplitude_m_per_s2", "in g, write 0.49"),
        ({"texture": {**GROOVES, "spacing_m": 0.762}}, "texture.spacing_m", "if it is in mm, write 0.000762"),
        ({"texture": {**GROOVES, "depth_m": 0.1}}, "texture.depth_m", "if it is in mm, write 0.0001"),
        ({"texture": {**NOISE, "peak_hz": 0.25}}, "texture.peak_hz", "if it is in kHz, write 250"),
    ],
)  # fmt: skip
def test_a_slip_is_reported_with_the_value_that_was_meant(keys: dict[str, Any], where: str, remedy: str) -> None:
    problems = found(**keys)
    assert list(problems) == [f"materials.m.{where}"]
    assert remedy in problems[f"materials.m.{where}"]


def test_a_remedy_is_a_value_that_materials_have() -> None:
    (problem,) = found(tap={**TAP, "frequency_hz": 12}).values()
    assert problem == "a frequency of 12 Hz is below that of all known materials, 15 Hz"


def test_bells_are_known_to_ring_longer() -> None:
    (problem,) = found(tap={**TAP, "frequency_hz": 290, "decay_time_s": 7.5}).values()
    assert problem == "a decay time of 7.5 s is above that of all known materials but bells, 2 s; if it is in ms, " + (
        "write 0.0075"
    )


@pytest.mark.parametrize(
    "keys",
    [
        {"stiffness_n_per_m": 0, "tap": {**TAP, "attack_slope_per_s": 0}},  # turned off
        {"stiffness_n_per_m": 5},  # brain and liver, in N/m of a probe
        {"stiffness_n_per_m": 50_000, "damping_n_s_per_m": 100},  # a magnetic levitation device
        {"tap": {**TAP, "frequency_hz": 18, "decay_time_s": 0.0167}},  # rubber, Okamura et al. 2001
        {"tap": {**TAP, "frequency_hz": 50_000}},  # silent, and reported as such
        {"tap": {**TAP, "decay_time_s": 3e-5}},  # the limit; as a rate and back, it is a bit lower
        {"texture": {**GROOVES, "spacing_m": 0.00004, "width_m": 0.00002}},  # sandpaper, the finest
    ],
)
def test_what_is_known_is_not_reported(keys: dict[str, Any]) -> None:
    assert found(**keys) == {}


def test_the_limits_leave_a_margin_around_every_shipped_material() -> None:
    """Nothing is said if stiffness, frequency or decay time of a shipped material changes by a factor of 3."""
    for name, material in shipped_materials().items():
        assert figure_warnings(name, material) == []
        for factor in (1 / 3, 3):
            scaled: dict[str, Any] = {"stiffness_n_per_m": material.stiffness_n_per_m * factor}
            if material.tap is not None:
                mode = material.tap.mode
                scaled["tap"] = {
                    "attack_slope_per_s": 309,
                    "frequency_hz": mode.frequency_hz * factor,
                    "decay_time_s": mode.decay_time_s * factor,
                }
            assert found(**scaled) == {}, name


def test_fields_are_judged_as_materials_are() -> None:
    assert field_problem(Viscous(kind="viscous", damping_n_s_per_m=2)) is None
    key, problem = field_problem(Spring(kind="spring", center_m=(0, 0), stiffness_n_per_m=0.05)) or ("", "")
    assert key == "stiffness_n_per_m"
    assert "if it is in N/mm, write 50" in problem


SHIPPED = sorted(path for folder in ("scenes", "materials", ".") for path in (CONFIG / folder).glob("*.yaml"))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.name)
def test_no_shipped_file_is_called_implausible(path: Path) -> None:
    config = load_config(path)
    assert [each for name, one in config.materials.items() for each in figure_warnings(name, one)] == []
    assert list(placement_warnings(config.scene, config.materials, Reach.of(config))) == []


PAGES = sorted([ROOT / "README.md", *(page for page in (ROOT / "docs").rglob("*.md") if "adr" not in page.parts)])


def test_no_example_of_a_page_is_called_implausible() -> None:
    """Each block with a scene or materials; other kinds of files, and files that need a device, are left out."""
    judged = 0
    for block in (block for page in PAGES for block in blocks(page) if block.language == "yaml"):
        data = load_text(block.code, "block").data
        if not isinstance(data, dict) or not data.keys() <= {"materials", "scene"}:
            continue
        try:
            config = load_config(data)
        except InvalidError:
            continue  # the rest of its materials is in another block
        judged += 1
        warned = [each for name, one in config.materials.items() for each in figure_warnings(name, one)]
        warned += placement_warnings(config.scene, config.materials, Reach.of(config))
        assert warned == [], block.where
    assert judged >= 4


def test_check_and_render_report_the_slip() -> None:
    source = {"materials": {"m": {"stiffness_n_per_m": 0.8}}, "scene": {"objects": {"floor": FLOOR}}}
    (warning,) = check(load_config(source)).warnings
    assert warning.where == "materials.m.stiffness_n_per_m"
    assert render_run(source, [[0, 0.01]]).implausible == (warning,)
    with pytest.warns(hapticd.ImplausibleValue, match="if it is in N/mm, write 800") as caught:
        hapticd.render(source, [[0, 0.01]])
    assert [each.filename for each in caught] == [__file__]
