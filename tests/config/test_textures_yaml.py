"""Friction and textures in YAML: valid ones, texts of faults, and the shipped ones."""

import math
import pathlib
from collections.abc import Mapping, Sequence

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticd.base.errors import InvalidError
from hapticd.base.yaml_source import Json, load_bytes
from hapticd.config.materials import (
    Friction,
    Material,
    library_files,
    shipped_document,
    shipped_materials,
    validate_materials,
)
from hapticd.config.texture import Autoregressive, AutoregressiveModel, Grooves, Stochastic
from hapticd.rendering.filter_design import stochastic_filter

Keys = dict[str, Json]

TAP: Keys = {"attack_slope_per_s": 300, "frequency_hz": 67, "decay_time_s": 0.006}
MODE: Keys = {"frequency_hz": 200, "decay_time_s": 0.003}
GROOVES: Keys = {"kind": "grooves", "spacing_m": 0.002, "width_m": 0.0005}
VIBRATION: Keys = {**GROOVES, "display": "vibration", "velocity_gain_per_s": 1200, **MODE}
GEOMETRY: Keys = {**GROOVES, "display": "geometry", "depth_m": 0.0001}
DAMPING: Keys = {**GROOVES, "display": "damping", "damping_n_s_per_m": 3}
STOCHASTIC: Keys = {"kind": "stochastic", "peak_hz": 250, "mean_hz": 310, "velocity_gain_per_s": 40}
MODEL: Keys = {"speed_m_per_s": 0.1, "force_n": 1, "coefficients": [-1.8, 0.9], "rms_m_per_s2": 2}
AUTOREGRESSIVE: Keys = {"kind": "autoregressive", "rate_hz": 5000, "models": [MODEL]}


def material(**keys: Json) -> Material:
    return validate_materials({"m": {"stiffness_n_per_m": 1, **keys}})["m"]


def faults(**keys: Json) -> dict[str, str]:
    with pytest.raises(InvalidError) as caught:
        material(**keys)
    assert str(caught.value).isprintable()
    return {problem.where.removeprefix("materials.m."): problem.problem for problem in caught.value.problems}


def without(keys: Keys, *names: str) -> Keys:
    return {key: value for key, value in keys.items() if key not in names}


def models(*changes: Mapping[str, Json]) -> Keys:
    return {**AUTOREGRESSIVE, "models": [{**MODEL, **change} for change in changes]}


# ---- valid textures -------------------------------------------------------------------------------


@pytest.mark.parametrize("texture", [VIBRATION, GEOMETRY, DAMPING, STOCHASTIC, AUTOREGRESSIVE])
def test_canonical_form_is_valid_and_stays(texture: Keys) -> None:
    taken = material(texture=texture, friction={"coefficient": 0.3})
    again = Material.model_validate(taken.to_dict())
    assert again == taken
    assert hash(again) == hash(taken)
    assert again.to_dict() == taken.to_dict()


def test_canonical_form_has_only_the_keys_of_its_display() -> None:
    assert material(texture=GEOMETRY).to_dict()["texture"] == GEOMETRY
    assert material(texture=DAMPING).to_dict()["texture"] == DAMPING
    assert material(texture=VIBRATION).to_dict()["texture"] == {**VIBRATION, "force_gain_m_per_s2_per_n": 0}


def test_defaults() -> None:
    assert material(friction={"coefficient": 0.2}).friction == Friction(coefficient=0.2, stiffness_n_per_m=500)
    for keys in (STOCHASTIC, AUTOREGRESSIVE):
        texture = material(texture=keys).texture
        assert isinstance(texture, Stochastic | Autoregressive)
        assert (texture.threshold_m_per_s, texture.direction, texture.seed) == (0.002, "tangent", 1)
    assert material().friction is None
    assert material().texture is None


def test_a_groove_rings_with_its_own_mode_or_the_taps() -> None:
    own = material(texture=VIBRATION, tap=TAP).groove_mode
    assert own is not None
    assert (own.frequency_hz, own.decay_time_s) == pytest.approx((200, 0.003), rel=1e-15)
    other: Keys = {"angular_frequency_rad_per_s": 1000, "decay_rate_per_s": 200}
    angular = material(texture={**without(VIBRATION, *MODE), **other}).groove_mode
    assert angular is not None
    assert (angular.angular_frequency_rad_per_s, angular.decay_rate_per_s) == (1000, 200)
    borrowed = material(texture=without(VIBRATION, *MODE), tap=TAP)
    assert borrowed.tap is not None
    assert borrowed.groove_mode == borrowed.tap.mode
    for keys in (GEOMETRY, DAMPING, STOCHASTIC):
        assert material(texture=keys, tap=TAP).groove_mode is None
    assert material(tap=TAP).groove_mode is None


def test_gains_of_noise_may_be_negative() -> None:
    texture = material(texture={**STOCHASTIC, "force_gain_m_per_s2_per_n": -5}).texture
    assert isinstance(texture, Stochastic)
    assert texture.force_gain_m_per_s2_per_n == -5


def test_noise_is_given_by_rms_or_by_the_variance_of_the_innovation() -> None:
    by_variance = {**without(MODEL, "rms_m_per_s2"), "variance_m2_per_s4": 4}
    assert AutoregressiveModel.model_validate(MODEL).level((0.6,)) == 2
    assert AutoregressiveModel.model_validate(by_variance).level((0.6,)) == pytest.approx(2.5, rel=1e-15)


# ---- faults ---------------------------------------------------------------------------------------


# The variance of the innovation gives a large RMS with a pole close to the unit circle.
LOUD: Keys = {"variance_m2_per_s4": 1e10, "rms_m_per_s2": None, "coefficients": [-1 + 1e-13]}


@pytest.mark.parametrize(
    ("keys", "problem"),
    [
        ({**VIBRATION, "width_m": 0.003}, "width_m must be at most spacing_m, 0.002, is 0.003"),
        (
            without(VIBRATION, "velocity_gain_per_s"),
            "needs velocity_gain_per_s or force_gain_m_per_s2_per_n above 0; otherwise the texture is silent",
        ),
        (
            without(VIBRATION, *MODE),
            "needs a mode: frequency_hz and decay_time_s of the texture, or a tap of the material",
        ),
        (
            without(VIBRATION, "frequency_hz"),
            "needs exactly one of frequency_hz and angular_frequency_rad_per_s, has neither",
        ),
        ({**VIBRATION, "decay_rate_per_s": 300}, "needs exactly one of decay_time_s and decay_rate_per_s, has both"),
        ({**VIBRATION, "depth_m": 0.001}, "depth_m belongs to display geometry, but display is vibration"),
        (without(GEOMETRY, "depth_m"), "needs depth_m to be displayed as geometry"),
        ({**GEOMETRY, "frequency_hz": 3}, "frequency_hz belongs to display vibration, but display is geometry"),
        (
            {**GEOMETRY, "velocity_gain_per_s": 0},
            "velocity_gain_per_s belongs to display vibration, but display is geometry",
        ),
        (without(DAMPING, "damping_n_s_per_m"), "needs damping_n_s_per_m to be displayed as damping"),
        ({**DAMPING, "depth_m": 0.001}, "depth_m belongs to display geometry, but display is damping"),
        (
            {**STOCHASTIC, "velocity_gain_per_s": 0},
            "needs velocity_gain_per_s or force_gain_m_per_s2_per_n above 0; otherwise the texture is silent",
        ),
        (
            {**STOCHASTIC, "velocity_gain_per_s": -1, "force_gain_m_per_s2_per_n": -1},
            "needs velocity_gain_per_s or force_gain_m_per_s2_per_n above 0; otherwise the texture is silent",
        ),
        (models({}, {"force_n": 2}, {}), "models[0] and models[2] are both at 0.1 m/s and 1 N"),
    ],
)
def test_faults_between_keys(keys: Keys, problem: str) -> None:
    assert faults(texture=keys) == {"texture": problem}


def test_the_fault_of_a_tap_is_reported_once() -> None:
    assert list(faults(texture=without(VIBRATION, *MODE), tap={"attack_slope_per_s": -1})) == ["tap.attack_slope_per_s"]


@pytest.mark.parametrize(
    ("keys", "where", "problem"),
    [
        ({}, "kind", "Field required"),
        (
            {"kind": "groves"},
            "kind",
            "should be one of 'grooves', ",
        ),
        (without(GEOMETRY, "width_m"), "width_m", "Field required"),
        ({**GEOMETRY, "display": "depth"}, "display", "should be 'vibration', 'geometry' or 'damping', is "),
        ({**GEOMETRY, "spacing_m": 1e-6}, "spacing_m", "should be greater than or equal to 0.00001, is 1e-06"),
        ({**STOCHASTIC, "peak_hz": 0}, "peak_hz", "should be greater than or equal to 0.01, is 0"),
        ({**STOCHASTIC, "direction": "up"}, "direction", "should be 'tangent' or 'normal', is "),
        (
            {**STOCHASTIC, "seed": 2**53 + 1},
            "seed",
            "should be less than or equal to 9007199254740992, is 9007199254740993",
        ),
        ({**STOCHASTIC, "seed": 1.0}, "seed", "should be a valid integer, is 1.0"),
        ({**STOCHASTIC, "spacing_m": 1}, "spacing_m", "unknown key; known: kind, peak_hz"),
        ({**AUTOREGRESSIVE, "models": []}, "models", "List should have at least 1 item after validation, not 0"),
        ({**AUTOREGRESSIVE, "models": 3}, "models", "should be a list, is 3"),
        (models(*({"force_n": i / 8} for i in range(65))), "models", "must hold at most 64 entries, holds 65"),
        (
            models({"coefficients": []}),
            "models[0].coefficients",
            "List should have at least 1 item after validation, not 0",
        ),
        (models({}, {"coefficients": [0.0] * 33}), "models[1].coefficients", "must hold at most 32 entries, holds 33"),
        (models({"coefficients": [0, "x"]}), "models[0].coefficients[1]", 'should be a valid number, is "x"'),
        (models({"coefficients": [math.nan]}), "models[0].coefficients[0]", "should be a finite number, is nan"),
        (models({}, {"speed_m_per_s": -1}), "models[1].speed_m_per_s", "should be greater than or equal to 0, is -1"),
        (
            models({"variance_m2_per_s4": 1}),
            "models[0]",
            "needs exactly one of rms_m_per_s2 and variance_m2_per_s4, has",
        ),
        (models(LOUD), "models[0]", "has an RMS of "),
    ],
)
def test_faults_of_a_key(keys: Keys, where: str, problem: str) -> None:
    ((found_where, found),) = faults(texture=keys).items()
    assert found_where == f"texture.{where}"
    assert found.startswith(problem)


def test_both_or_neither_innovation() -> None:
    bare = without(MODEL, "rms_m_per_s2")
    found = faults(texture={**AUTOREGRESSIVE, "models": [bare]})
    assert found == {"texture.models[0]": "needs exactly one of rms_m_per_s2 and variance_m2_per_s4, has neither"}


@given(st.floats(0.001, 1.5), st.floats(0.01, math.pi - 0.01), st.floats(-0.9, 0.9))
def test_unstable_models_are_refused(radius: float, angle: float, real: float) -> None:
    """Coefficients are computed from poles, by multiplying out."""
    pair = (1.0, -2 * radius * math.cos(angle), radius**2)
    coefficients = np.convolve(pair, (1.0, -real))[1:].tolist()
    largest = max(radius, abs(real))
    if abs(largest - 1) < 1e-6:
        return
    keys = models({}, {"force_n": 2, "coefficients": coefficients})
    if largest < 1:
        assert material(texture=keys).texture is not None
    else:
        problem = "is unstable: all poles must lie inside the unit circle"
        assert faults(texture=keys) == {"texture.models[1]": problem}


def test_models_at_a_negative_zero_are_at_zero() -> None:
    found = faults(texture=models({"speed_m_per_s": -0.0}, {"speed_m_per_s": 0.0}))
    assert found == {"texture": "models[0] and models[1] are both at 0 m/s and 1 N"}


def test_the_rms_that_is_refused_is_that_of_the_model() -> None:
    """An AR(1) with a pole r has the RMS sigma/sqrt(1 - r^2)."""
    pole = 1 - 1e-13
    ((_, problem),) = faults(texture=models(LOUD)).items()
    with mpmath.workdps(40):
        expected = float(1e5 / mpmath.sqrt(1 - mpmath.mpf(pole) ** 2))
    assert f"has an RMS of {expected:.6g} m/s^2" in problem


def test_every_fault_of_every_model_is_reported() -> None:
    keys = models({"coefficients": [-2]}, {"coefficients": [3.0]}, {"force_n": -1}, {"coefficients": ["x"]})
    assert set(faults(texture=keys)) == {
        "texture.models[0]",
        "texture.models[1]",
        "texture.models[2].force_n",
        "texture.models[3].coefficients[0]",
    }


@pytest.mark.parametrize(
    ("keys", "where", "problem"),
    [
        ({}, "coefficient", "Field required"),
        ({"coefficient": -0.1}, "coefficient", "should be greater than or equal to 0, is -0.1"),
        ({"coefficient": 11}, "coefficient", "should be less than or equal to 10, is 11"),
        (
            {"coefficient": 1, "stiffness_n_per_m": 0},
            "stiffness_n_per_m",
            "should be greater than or equal to 0.001, is 0",
        ),
        (
            {"coefficient": 1, "stiffness_n_per_m": 2e5},
            "stiffness_n_per_m",
            "should be less than or equal to 100000, is 200000.0",
        ),
    ],
)
def test_faults_of_friction(keys: Keys, where: str, problem: str) -> None:
    assert faults(friction=keys) == {f"friction.{where}": problem}


# ---- shipped textures -----------------------------------------------------------------------------

SPACINGS_UM = (1600, 2400, 4800, 6400)
"""Spacings that the paper compares."""
GRITS = (60, 100, 400, 600)
"""Grits that the paper measured."""
SIM_DAMPING = 5.2
"""Damping of the simulated handle and hand, in N s/m."""


def test_names() -> None:
    combs = [
        f"comb_{spacing}um_{display}" for spacing in SPACINGS_UM for display in ("vibration", "geometry", "damping")
    ]
    sandpapers = [f"sandpaper_{grit}" for grit in GRITS]
    assert list(shipped_materials())[9:] == [*combs, "comb_762um_vibration", "slippery", "sticky", *sandpapers]


def test_no_name_is_defined_in_two_files() -> None:
    names = [name for file in library_files() for name in keys_of(shipped_document(file).data, "materials")]
    assert len(names) == len(set(names)) == len(shipped_materials())


def keys_of(data: Json, section: str) -> Sequence[str]:
    assert isinstance(data, dict)
    inner = data[section]
    assert isinstance(inner, dict)
    return list(inner)


def grooves(name: str) -> Grooves:
    texture = shipped_materials()[name].texture
    assert isinstance(texture, Grooves)
    return texture


PAPER = load_bytes((pathlib.Path(__file__).parents[1] / "data" / "okamura1998_other.yaml").read_bytes(), "paper").data


def printed(section: str) -> Mapping[str, float]:
    assert isinstance(PAPER, dict)
    figures = PAPER[section]
    assert isinstance(figures, dict)
    return {key: float(value) for key, value in figures.items() if isinstance(value, int | float)}


def test_combs_and_sandpapers_are_those_that_the_paper_names() -> None:
    """The paper gives the measured comb, the compared spacings, the comb of Figure 5, and the grits."""
    measured, comb = printed("grooves_measured"), grooves("comb")
    for key in ("spacing_m", "width_m", "velocity_gain_per_s", "force_gain_m_per_s2_per_n"):
        assert getattr(comb, key) == measured[key]
    assert isinstance(PAPER, dict)
    assert PAPER["groove_spacings_compared_m"] == [spacing / 1e6 for spacing in SPACINGS_UM]
    assert PAPER["sandpaper_grits"] == list(GRITS)
    pictured, comb = printed("grooves_pictured"), grooves("comb_762um_vibration")
    assert comb.spacing_m == pytest.approx(pictured["spacing_in"] * 0.0254, rel=1e-12)
    # The comment of the library: a strike of the pictured stroke peaks at 0.6 N with 0.05 kg, 79 in a second.
    mode = shipped_materials()["comb_762um_vibration"].groove_mode
    assert mode is not None
    law = comb.velocity_gain_per_s * pictured["speed_m_per_s"] + comb.force_gain_m_per_s2_per_n * pictured["force_n"]
    assert 0.05 * law * mode.peak == pytest.approx(0.6, abs=0.05)
    assert pictured["speed_m_per_s"] / comb.spacing_m == pytest.approx(79, abs=0.5)


def test_the_comb_is_the_papers() -> None:
    comb = grooves("comb")
    assert (comb.spacing_m, comb.width_m) == (0.002, 0.0005)
    assert (comb.velocity_gain_per_s, comb.force_gain_m_per_s2_per_n) == (1200, 63.4)


@pytest.mark.parametrize("spacing_um", SPACINGS_UM)
def test_combs_are_felt_and_stable_on_a_joystick_at_1_khz(spacing_um: int) -> None:
    """Forces at 0.1 m/s and 1 N with 0.05 kg, and passivity at 1 kHz: b > K T/2 + D (Colgate and Schenkel)."""
    vibration = grooves(f"comb_{spacing_um}um_vibration")
    geometry = grooves(f"comb_{spacing_um}um_geometry")
    damping = grooves(f"comb_{spacing_um}um_damping")
    for comb in (vibration, geometry, damping):
        assert comb.spacing_m == spacing_um / 1e6
        assert comb.width_m == vibration.width_m
    mode = shipped_materials()[f"comb_{spacing_um}um_vibration"].groove_mode
    assert mode is not None
    assert mode.frequency_hz <= 0.4 * 1000
    struck = 0.05 * (vibration.velocity_gain_per_s * 0.1 + vibration.force_gain_m_per_s2_per_n * 1.0) * mode.peak
    assert geometry.depth_m is not None
    assert damping.damping_n_s_per_m is not None
    # A raised cosine of depth g and width w is at most pi g/w steep, and bends by at most 2 pi^2 g/w^2.
    pushed = math.pi * geometry.depth_m / geometry.width_m
    dragged = damping.damping_n_s_per_m * 0.1
    for force in (struck, pushed, dragged):
        assert 0.1 < force < 1
    bend = 2 * math.pi**2 * geometry.depth_m / geometry.width_m**2
    stiffness = shipped_materials()[f"comb_{spacing_um}um_geometry"].stiffness_n_per_m
    assert (bend * 1.0 + stiffness * pushed**2) * 1e-3 / 2 < SIM_DAMPING
    assert stiffness * 1e-3 / 2 + damping.damping_n_s_per_m < SIM_DAMPING


@pytest.mark.parametrize("rate_hz", [1000, 2000, 4000, 5000, 10_000])
@pytest.mark.parametrize("grit", GRITS)
def test_sandpapers_are_met_at_every_rate(grit: int, rate_hz: float) -> None:
    texture = shipped_materials()[f"sandpaper_{grit}"].texture
    assert isinstance(texture, Stochastic)
    assert stochastic_filter(texture.peak_hz, texture.mean_hz, rate_hz).met(texture.peak_hz, texture.mean_hz)


def test_sandpapers_go_from_coarse_to_fine() -> None:
    textures = [shipped_materials()[f"sandpaper_{grit}"].texture for grit in GRITS]
    levels, peaks, seeds = [], [], set()
    for texture in textures:
        assert isinstance(texture, Stochastic)
        levels.append(0.05 * (texture.velocity_gain_per_s * 0.1 + texture.force_gain_m_per_s2_per_n * 1.0))
        peaks.append(texture.peak_hz)
        seeds.add(texture.seed)
    assert sorted(levels, reverse=True) == levels
    assert all(0.05 < level < 1 / 3 for level in levels)  # three times the RMS stays below 1 N
    assert sorted(peaks) == peaks
    assert len(seeds) == len(GRITS)


def test_shipped_friction_is_stable_at_1_khz() -> None:
    coefficients = []
    for name in ("slippery", "sticky"):
        shipped = shipped_materials()[name]
        assert shipped.friction is not None
        assert shipped.friction.stiffness_n_per_m <= 2 * SIM_DAMPING / 1e-3
        assert shipped.friction.stiffness_n_per_m <= shipped.stiffness_n_per_m
        coefficients.append(shipped.friction.coefficient)
    assert coefficients[0] < 0.1 < 0.5 < coefficients[1]
