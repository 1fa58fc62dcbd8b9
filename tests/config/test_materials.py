"""Materials: the shipped library against the paper's figures, modes against arbitrary precision, faults."""

import csv
import math
import pathlib

import mpmath
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticd.base.errors import InvalidError
from hapticd.base.yaml_source import Json
from hapticd.config.materials import MAX_MATERIALS, Material, Mode, Rupture, shipped_materials, validate_materials

PAPER = pathlib.Path(__file__).parents[1] / "data" / "okamura1998_tapping.csv"
MODE = {"frequency_hz": 100, "decay_time_s": 0.01}

rates = st.floats(0.1, 1e6)
angular_frequencies = st.floats(0.05, 1e6)


def rupture(**keys: Json) -> Rupture:
    return Rupture.model_validate({"amplitude_m_per_s2": 38, **MODE, **keys})


def faults(data: object) -> dict[str, str]:
    with pytest.raises(InvalidError) as caught:
        validate_materials(data)
    return {problem.where: problem.problem for problem in caught.value.problems}


def test_shipped_taps_are_those_of_the_paper() -> None:
    with PAPER.open() as file:
        rows = list(csv.DictReader(file))
    library = shipped_materials()
    tapped = [row["material"] for row in rows]
    assert list(library)[: len(rows) + 2] == [*tapped, "cellophane", "comb"]
    assert [name for name, material in library.items() if material.tap is not None] == tapped
    for row in rows:
        material = library[row["material"]]
        assert material.rupture is None
        assert material.tap is not None
        assert material.tap.attack == "coefficient"
        assert material.tap.attack_slope_per_s == float(row["attack_slope_per_s"])
        assert material.tap.frequency_hz == float(row["frequency_hz"])
        assert material.tap.decay_time_s == pytest.approx(float(row["decay_time_ms"]) / 1000, rel=1e-15)


def test_shipped_rupture_is_that_of_the_paper() -> None:
    cellophane = shipped_materials()["cellophane"]
    assert cellophane.tap is None
    assert cellophane.rupture is not None
    assert cellophane.rupture.amplitude_m_per_s2 == 38
    assert cellophane.rupture.mode == Mode(330, 1260)
    assert cellophane.rupture.rupture_depth_m == 0.004
    assert not cellophane.rupture.heals


@pytest.mark.parametrize(("name", "peak"), [("wood", "0.600"), ("acrylic", "0.470"), ("glass", "0.782")])
def test_known_peaks(name: str, peak: str) -> None:
    tap = shipped_materials()[name].tap
    assert tap is not None
    assert f"{tap.mode.peak:.3f}" == peak
    assert tap.mode.coefficient(3.0, "coefficient") == 3.0
    assert tap.mode.coefficient(3.0, "first_peak") == pytest.approx(3.0 / float(peak), rel=1e-3)


@given(rates, angular_frequencies)
def test_peak_is_the_first_maximum(decay_rate_per_s: float, angular_frequency_rad_per_s: float) -> None:
    mode = Mode(decay_rate_per_s, angular_frequency_rad_per_s)
    with mpmath.workdps(60):
        b, w = mpmath.mpf(decay_rate_per_s), mpmath.mpf(angular_frequency_rad_per_s)
        # The zero of the derivative, w cos(w t) - b sin(w t), in the first half period, by bisection.
        time_s = mpmath.findroot(
            lambda t: w * mpmath.cos(w * t) - b * mpmath.sin(w * t),
            (0, mpmath.pi / w),
            solver="anderson",
            tol=1e-60,
        )
        peak = mpmath.exp(-b * time_s) * mpmath.sin(w * time_s)
        assert abs(mode.peak_time_s / time_s - 1) < 1e-14
        assert abs(mode.peak / peak - 1) < 1e-14


@given(st.floats(0.01, 1e5), st.floats(1e-6, 10))
def test_both_ways_to_write_a_mode_agree(frequency_hz: float, decay_time_s: float) -> None:
    mode = rupture(frequency_hz=frequency_hz, decay_time_s=decay_time_s, depth_m=0.01).mode
    assert mode.decay_rate_per_s == pytest.approx(1 / decay_time_s, rel=1e-15)
    assert mode.angular_frequency_rad_per_s == pytest.approx(2 * math.pi * frequency_hz, rel=1e-15)
    assert mode.frequency_hz == pytest.approx(frequency_hz, rel=1e-14)
    assert mode.decay_time_s == pytest.approx(decay_time_s, rel=1e-14)


@given(st.floats(1e-6, 10), st.floats(1e-4, 1))
def test_rupture_depth_from_strain(max_strain: float, radius_m: float) -> None:
    with mpmath.workdps(50):
        depth_m = mpmath.mpf(radius_m) * mpmath.sqrt((1 + mpmath.mpf(max_strain)) ** 2 - 1)
        computed = rupture(max_strain=max_strain, radius_m=radius_m).rupture_depth_m
        assert abs(computed / depth_m - 1) < 1e-14


@pytest.mark.parametrize(
    ("keys", "problem"),
    [
        ({"frequency_hz": 1}, "needs exactly one of decay_time_s and decay_rate_per_s, has neither"),
        ({"decay_rate_per_s": 1}, "one of frequency_hz and angular_frequency_rad_per_s, has neither"),
        (
            {**MODE, "angular_frequency_rad_per_s": 1},
            "one of frequency_hz and angular_frequency_rad_per_s, has both",
        ),
        ({**MODE, "decay_rate_per_s": 1}, "one of decay_time_s and decay_rate_per_s, has both"),
    ],
)
def test_a_mode_is_given_once(keys: dict[str, Json], problem: str) -> None:
    found = faults({"m": {"stiffness_n_per_m": 1, "tap": {"attack_slope_per_s": 1, **keys}}})
    assert list(found) == ["materials.m.tap"]
    assert problem in found["materials.m.tap"]


@pytest.mark.parametrize(
    ("keys", "has"),
    [
        ({}, "none of them"),
        ({"max_strain": 0.1}, "max_strain"),
        ({"radius_m": 0.1}, "radius_m"),
        ({"depth_m": 0.1, "radius_m": 0.1}, "depth_m and radius_m"),
        ({"depth_m": 0.1, "max_strain": 0.1, "radius_m": 0.1}, "depth_m and max_strain and radius_m"),
    ],
)
def test_a_rupture_is_given_once(keys: dict[str, Json], has: str) -> None:
    found = faults({"m": {"stiffness_n_per_m": 1, "rupture": {"amplitude_m_per_s2": 1, **MODE, **keys}}})
    assert found == {"materials.m.rupture": f"needs either depth_m or both max_strain and radius_m, has {has}"}


def test_every_fault_between_keys_is_reported() -> None:
    found = faults({"m": {"stiffness_n_per_m": 1, "rupture": {"amplitude_m_per_s2": 1}}})
    assert found["materials.m.rupture"].count("needs") == 3


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("", "String should have at least 1 character"),
        ("x" * 65, "String should have at most 64 characters, is "),
        ("a.b", 'must not hold a dot or a control character: "a.b"'),
        ("a\nb", 'must not hold a dot or a control character: "a\\nb"'),
        ("a\x85", "must not hold a dot or a control character"),
        ("\ud800", "unable to parse raw data as a unicode string"),
    ],
)
def test_names(name: str, problem: str) -> None:
    ((where, text),) = faults({name: {"stiffness_n_per_m": 1}}).items()
    assert where.startswith("materials.")
    assert where.isprintable()
    assert problem in text


@pytest.mark.parametrize("name", ["x" * 64, "cast iron", "Holz-3", "\u6728", "[key]", "wall"])
def test_names_that_are_taken(name: str) -> None:
    assert list(validate_materials({name: {"stiffness_n_per_m": 1}})) == [name]


def test_a_name_like_pydantics_own_marks_stays_in_the_path() -> None:
    assert list(faults({"[key]": {}})) == ['materials."[key]".stiffness_n_per_m']


@pytest.mark.slow
def test_number_of_materials_is_limited() -> None:
    one = Material(stiffness_n_per_m=1)
    many: dict[str, object] = {f"m{i}": one for i in range(MAX_MATERIALS + 1)}
    assert faults(many) == {"materials": f"must hold at most {MAX_MATERIALS} entries, holds {MAX_MATERIALS + 1}"}


@pytest.mark.parametrize("name", list(shipped_materials()))
def test_canonical_form_is_valid_and_stays(name: str) -> None:
    material = shipped_materials()[name]
    again = Material.model_validate(material.to_dict())
    assert again == material
    assert again.to_dict() == material.to_dict()


def test_the_shipped_library_cannot_be_changed() -> None:
    with pytest.raises(TypeError):
        shipped_materials()["wood"] = shipped_materials()["steel"]  # type: ignore[index]
    with pytest.raises(InvalidError, match="cannot be changed"):
        shipped_materials()["wood"].stiffness_n_per_m = 1  # type: ignore[misc]
