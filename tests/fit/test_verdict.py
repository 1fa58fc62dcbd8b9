"""The verdict on a fit: limits, the verdict in a material, and the commands that show it."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from hapticd.analysis.check import check
from hapticd.analysis.statistics import Estimate
from hapticd.base.errors import InvalidError
from hapticd.base.yaml_source import load_text
from hapticd.cli import main
from hapticd.config.configuration import load_config
from hapticd.config.materials import validate_materials
from hapticd.fit.puncture import fit_puncture
from hapticd.fit.synthesize import Stylus, puncture
from hapticd.fit.verdict import Verdict, Warnings
from tests.support.fitted import fitted_material

RUPTURE = {"depth_m": 0.002, "amplitude_m_per_s2": 38.0, "frequency_hz": 200.0, "decay_rate_per_s": 330.0}
JUDGED = {"texture": {"quality": "poor", "reasons": ["no law"]}, "tap": {"quality": "good", "reasons": []}}


@pytest.mark.parametrize(
    ("value", "quality"), [(0.98, "good"), (0.69, "fair"), (0.49, "poor"), (-0.02, "poor"), (math.nan, "poor")]
)
def test_a_law_that_explains_little_is_fair_or_poor(value: float, quality: str) -> None:
    warnings = Warnings()
    warnings.check("correlation of the law", value, what="loudness")
    assert warnings.verdict("so much").quality == quality


@pytest.mark.parametrize(("half", "quality"), [(0.2, "good"), (0.3, "fair"), (0.6, "poor")])
def test_a_figure_that_is_uncertain_is_a_reason(half: float, quality: str) -> None:
    warnings = Warnings()
    warnings.check_interval("depth", Estimate(2.0, 2.0 - 2.0 * half, 2.1))
    judged = warnings.verdict("so much")
    assert judged.quality == quality
    assert judged.reasons == (() if quality == "good" else (f"the depth is uncertain: {100 * half:.0f} %",))


def test_a_verdict_in_words() -> None:
    warnings = Warnings()
    assert str(warnings.verdict("ten taps", "on a line")) == "good: ten taps, on a line"
    warnings.note("as good with it")
    assert warnings.verdict("ten taps").quality == "good"
    for name in "ab":
        warnings.add_for_recording("softer at first", f"{name}: softer by 1 mm")
    warnings.add_fair("hum")
    assert (
        str(warnings.verdict("ten taps", "on a line")) == "fair: ten taps, but hum; softer at first (in 2 recordings)"
    )
    assert warnings.lines == ["as good with it", "a: softer by 1 mm", "b: softer by 1 mm", "hum"]


@pytest.mark.long
def test_the_material_keeps_the_verdict() -> None:
    """The verdict of a fit is dropped if a later fit replaces its values."""
    truth = validate_materials({"film": {"stiffness_n_per_m": 500.0, "rupture": RUPTURE}})["film"]
    recordings = [puncture(truth, 0.05 + 0.01 * seed, Stylus(seed=seed)) for seed in range(3)]
    fit = fit_puncture(recordings)
    assert fit.judged.quality == "good"
    assert fit.to_dict()["verdict"] == fit.verdict
    origin = {"files": [{"path": "a"}], "date": "2026-01-01", "version": "1", "verdict": JUDGED}
    noise = {"kind": "stochastic", "peak_hz": 200.0, "mean_hz": 250.0, "velocity_gain_per_s": 1.0}
    before = validate_materials({"m": {"stiffness_n_per_m": 1.0, "texture": noise, "provenance": origin}})["m"]
    made = fitted_material(fit, recordings, "puncture", 1.0, onto=before)
    assert {kind: each.quality for kind, each in made.fitted.items()} == {
        "texture": "poor",
        "tap": "good",
        "puncture": "good",
    }
    again = fitted_material(fit, recordings, "grooves", 1.0, onto=made)
    assert set(again.fitted) == {"tap", "puncture", "grooves"}
    assert validate_materials({"m": made.to_dict()})["m"] == made


def test_a_verdict_that_is_none_is_refused() -> None:
    for verdict, message in (
        ({"tap": "good"}, "m.provenance.verdict.tap"),
        ({"tap": {"quality": "fine"}}, "m.provenance.verdict.tap.quality"),
    ):
        origin = {"files": [{"path": "a"}], "date": "2026-01-01", "version": "1", "verdict": verdict}
        with pytest.raises(InvalidError, match=re.escape(message)):
            validate_materials({"m": {"stiffness_n_per_m": 1.0, "provenance": origin}}, ("materials",))


def test_check_shows_the_verdict(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    origin = {"files": [{"path": "a"}], "date": "2026-01-01", "version": "1", "verdict": JUDGED}
    wood = {"stiffness_n_per_m": 300.0, "provenance": origin}
    floor = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "pine"}
    source = {"materials": {"pine": wood}, "scene": {"objects": {"floor": floor}}}
    report = check(load_config(source))
    (pine,) = (each for each in report.materials if each.name == "pine")
    assert pine.verdict == {"texture": "poor", "tap": "good"}
    assert all(not each.verdict for each in report.materials if each.name != "pine")
    (note,) = report.notes
    assert str(note) == "materials.pine.provenance.verdict.texture: the fit is poor: no law"

    file = tmp_path / "pine.yaml"
    file.write_text(
        "materials:\n  pine:\n    stiffness_n_per_m: 300\n    provenance:\n      files: [{path: a}]\n"
        "      date: 2026-01-01\n      version: '1'\n      verdict:\n"
        "        texture: {quality: poor, reasons: [no law]}\n"
        "scene:\n  objects:\n    floor: {kind: wall, point_m: [0, 0], normal: [0, 1], material: pine}\n"
    )
    assert main(["check", "-c", str(file)]) == 0
    shown = capsys.readouterr().out
    assert re.search(r"pine .* texture poor", shown)
    assert "the fit is poor: no law" in shown


def test_the_list_of_materials_shows_the_verdict(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    origin = {"files": [{"path": "a"}], "date": "2026-01-01", "version": "1", "verdict": JUDGED}
    made = validate_materials({"pine": {"stiffness_n_per_m": 300.0, "provenance": origin}})
    monkeypatch.setattr("hapticd.config.materials.shipped_materials", lambda: made)
    assert main(["--runtime-dir", str(tmp_path), "material", "list"]) == 0
    listed = load_text(capsys.readouterr().out, "printed").data
    assert isinstance(listed, dict)
    assert listed["materials"]["pine"]["provenance"]["verdict"] == JUDGED


def test_the_text_of_a_poor_verdict() -> None:
    assert str(Verdict("poor", "4 s of noise", ("a", "b"))) == "poor: 4 s of noise, but a; b"
