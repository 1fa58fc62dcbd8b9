"""`hapticd fit`: arguments, files and output. Most tests replace the fits by a fake of the same interface."""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import json
import os
import re
import struct
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from hapticd._version import __version__
from hapticd.analysis.statistics import Estimate
from hapticd.base.errors import HapticdError
from hapticd.cli import main
from hapticd.config.configuration import load_config
from hapticd.config.materials import validate_materials
from hapticd.config.texture import Autoregressive, Grooves
from hapticd.fit.recording import Recording, load
from hapticd.fit.report import Curve, Page, Panel, drawn, figure_rows, thinned
from hapticd.fit.verdict import Exclusion, Verdict
from hapticd.system.extras import install_command
from tests.support.cli import said

JUDGED = Verdict("fair", "one mode, well fitted <&>", ("the first tap is weak",))
PNG = b"\x89PNG\r\n\x1a\n"


@dataclass(frozen=True, slots=True)
class FakeSecond:
    frequency_hz: Estimate
    variance_accounted_for: float = 0.99
    kept: bool = False


@dataclass(frozen=True, slots=True)
class FakeFit:
    slope_per_s: Estimate
    frequency_hz: Estimate
    decay_time_s: Estimate
    r_squared: float = float("nan")
    nothing: Estimate | None = None
    warnings: tuple[str, ...] = ("the first tap is weak",)
    judged: Verdict = JUDGED
    left_out: tuple[Exclusion, ...] = ()
    found: tuple[tuple[str, object], ...] = ()
    linear: bool = True
    power: None = None
    second: object = None

    def material(self, attack: str = "coefficient", two_modes: bool = False) -> dict[str, object]:
        tap: dict[str, object] = {
            "attack_slope_per_s": self.slope_per_s.value,
            "frequency_hz": self.frequency_hz.value,
            "decay_time_s": self.decay_time_s.value,
        }
        if attack != "coefficient":
            tap["attack"] = attack
        if not self.linear:
            del tap["attack_slope_per_s"]
            tap["amplitudes"] = [[0.1, 30.0]]
        if two_modes:
            if self.second is None:
                raise HapticdError("no second mode was found")
            assert isinstance(self.second, FakeSecond)
            tap["second"] = {"frequency_hz": self.second.frequency_hz.value, "decay_time_s": 0.002, "ratio": 0.3}
        return {"tap": tap, **dict(self.found)}

    @property
    def verdict(self) -> str:
        return str(self.judged)

    def to_dict(self) -> dict[str, object]:
        return {"frequency_hz": self.frequency_hz.to_dict(), "r_squared": self.r_squared, "taps": [1.0, float("inf")]}


FIT = FakeFit(Estimate(300.0, 290.0, 310.0), Estimate(67.0, 66.5, 67.5), Estimate(0.0065, 0.006, float("inf")))


Progress = Callable[[Recording], None]


class Fits:
    """Replaces the fits, and records their arguments."""

    def __init__(self) -> None:
        self.recordings: list[Sequence[Recording]] = []
        self.options: list[dict[str, object]] = []
        self.excluded: list[object] = []
        self.answer: FakeFit | HapticdError = FIT

    def fit(
        self, recordings: Sequence[Recording], progress: Callable[[Recording], None] | None = None, **options: object
    ) -> FakeFit:
        for recording in recordings if progress is not None else ():
            progress(recording)
        self.recordings.append(recordings)
        self.excluded.append(options.pop("excluded"))
        self.options.append(options)
        if isinstance(self.answer, HapticdError):
            raise self.answer
        return self.answer


@pytest.fixture
def fits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Fits:
    monkeypatch.chdir(tmp_path)
    found = Fits()
    for kind in ("grooves", "texture", "puncture"):
        monkeypatch.setattr(f"hapticd.fit.{kind}.fit_{kind}", found.fit)

    def fit_taps(
        recordings: Sequence[Recording],
        kind: str,
        progress: Progress,
        excluded: object,
        law: str | None,
        mode_table: bool | None,
        one_mode: bool,
    ) -> FakeFit:
        fit = found.fit(recordings, progress, excluded=excluded)
        return fit if law is None else dataclasses.replace(fit, linear=law == "line")

    monkeypatch.setattr("hapticd.fit.from_files.fit_taps", fit_taps)
    for name, seed in (("a.csv", 1), ("b.csv", 2)):
        values = np.random.default_rng(seed).standard_normal(100)
        lines = [f"{i / 1000:.3f},{value:.6f}" for i, value in enumerate(values)]
        Path(name).write_text("\n".join(["time_s,acceleration_m_per_s2", *lines]) + "\n")
    return found


@pytest.mark.parametrize("kind", ["tap", "grooves", "texture", "puncture"])
def test_a_fit_becomes_a_material_that_can_be_loaded(kind: str, fits: Fits, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fit", kind, "a.csv", "b.csv", "-o", "pine.yaml"]) == 0
    captured = capsys.readouterr()
    assert [recording.source.path for recording in fits.recordings[0]] == ["a.csv", "b.csv"]
    assert "one mode, well fitted" in captured.out
    assert "290 to 310" in captured.out
    notes = captured.err.splitlines()
    assert notes == [
        "hapticd: the first tap is weak",
        "hapticd: the stiffness, 800 N/m, is assumed, not measured; --stiffness sets it",
    ]
    material = load_config("pine.yaml").materials["pine"]
    assert material.stiffness_n_per_m == 800
    assert material.tap is not None and material.tap.attack_slope_per_s == 300.0
    origin = material.provenance
    assert origin is not None
    hashes = {name: hashlib.sha256(Path(name).read_bytes()).hexdigest() for name in ("a.csv", "b.csv")}
    assert {file.path: file.sha256 for file in origin.files} == hashes
    assert origin.version == __version__
    # Values with an infinite interval, and missing values, are left out.
    assert origin.intervals == {f"{kind}.slope_per_s": (290.0, 310.0), f"{kind}.frequency_hz": (66.5, 67.5)}


def test_notes_tell_how_recordings_were_read(fits: Fits, capsys: pytest.CaptureFixture[str]) -> None:
    """Each note once, with the number of the other recordings."""
    for name in ("c.csv", "d.csv"):
        text = Path("a.csv" if name == "c.csv" else "b.csv").read_text()
        Path(name).write_text(text.replace("acceleration_m_per_s2", "a_g"))
        Path(f"{name}.yaml").write_text("columns: {time: {column: 1}, acceleration: {column: a_g}}")
    assert main(["fit", "tap", "a.csv", "c.csv", "d.csv", "-o", "x.yaml"]) == 0
    notes = [line for line in capsys.readouterr().err.splitlines() if " is in " in line]
    assert notes == ["hapticd: c.csv and 1 more: the acceleration is in g by the name of its column 'a_g'"]
    # A wrong unit refuses all recordings: it may be wrong in the others, too.
    Path("d.csv.yaml").write_text("columns: {time: {column: 1}, acceleration: {column: a_g, unit: m/s^2}}")
    assert "d.csv: the acceleration is in g by" in said(capsys, 1, "fit", "tap", "a.csv", "c.csv", "d.csv")


def test_the_printed_material_can_be_loaded(fits: Fits, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fit", "tap", "a.csv", "--name", "oak 2", "--stiffness", "1234"]) == 0
    captured = capsys.readouterr()
    # stdout has only the material: table and verdict are on stderr.
    assert captured.err.endswith("\nhapticd: the first tap is weak\n") and "290 to 310" in captured.err
    Path("seen.yaml").write_text(captured.out)
    assert load_config("seen.yaml").materials["oak 2"].stiffness_n_per_m == 1234


def test_a_stiffness_that_was_fitted_is_kept(fits: Fits, capsys: pytest.CaptureFixture[str]) -> None:
    fits.answer = FakeFit(FIT.slope_per_s, FIT.frequency_hz, FIT.decay_time_s, found=(("stiffness_n_per_m", 432.0),))
    assert main(["fit", "tap", "a.csv", "-o", "x.yaml"]) == 0
    assert load_config("x.yaml").materials["x"].stiffness_n_per_m == 432
    assert "stiffness" not in capsys.readouterr().err


def test_a_tap_may_mean_its_peaks_or_be_a_table(fits: Fits, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fit", "tap", "a.csv", "--attack", "first_peak", "-o", "x.yaml"]) == 0
    tap = load_config("x.yaml").materials["x"].tap
    assert tap is not None and (tap.attack, tap.attack_slope_per_s) == ("first_peak", 300.0)
    assert main(["fit", "tap", "a.csv", "--table", "-o", "y.yaml"]) == 0
    tap = load_config("y.yaml").materials["y"].tap
    assert tap is not None and (tap.amplitudes, tap.attack_slope_per_s) == (((0.1, 30.0),), None)
    capsys.readouterr()
    origin = load_config("y.yaml").materials["y"].provenance
    assert origin is not None and origin.intervals == {"tap.frequency_hz": (66.5, 67.5)}  # there is no slope


def test_options_that_exclude_one_another(fits: Fits, capsys: pytest.CaptureFixture[str]) -> None:
    for options in (("--table", "--attack", "first_peak"), ("--two-modes", "--attack", "first_peak")):
        assert "exclude each other" in said(capsys, 2, "fit", "tap", "a.csv", *options)
    assert "--merge needs -o" in said(capsys, 2, "fit", "tap", "a.csv", "--merge")
    assert fits.recordings == []


def test_notes_name_the_options_of_a_fit(fits: Fits, capsys: pytest.CaptureFixture[str]) -> None:
    fits.answer = dataclasses.replace(FIT, linear=False, second=FakeSecond(Estimate(500.0, 499.0, 502.0)))
    assert main(["fit", "tap", "a.csv", "-o", "one.yaml"]) == 0
    captured = capsys.readouterr()
    notes = captured.err
    assert "second.frequency_hz" in captured.out and "499 to 502" in captured.out
    origin = load_config("one.yaml").materials["one"].provenance
    assert origin is not None and origin.intervals is not None
    # The law of these taps is a table, so the material has no slope.
    assert set(origin.intervals) == {"tap.frequency_hz"}
    assert "hapticd: --two-modes takes" in notes
    assert main(["fit", "tap", "a.csv", "--law", "line", "-o", "line.yaml"]) == 0
    assert load_config("line.yaml").materials["line"].tap.attack_slope_per_s == 300.0  # type: ignore[union-attr]
    capsys.readouterr()
    assert main(["fit", "tap", "a.csv", "--table"]) == 0
    notes = capsys.readouterr().err
    assert "--table" not in notes and "hapticd: --two-modes takes" in notes
    assert main(["fit", "tap", "a.csv", "--two-modes", "-o", "x.yaml"]) == 0
    assert "--two-modes" not in capsys.readouterr().err
    material = load_config("x.yaml").materials["x"]
    assert material.tap is not None and material.tap.second is not None
    assert material.tap.second.ratio == 0.3
    # The other intervals belong to the fit of one mode.
    assert material.provenance is not None
    assert material.provenance.intervals == {"tap.second.frequency_hz": (499.0, 502.0)}
    assert main(["fit", "tap", "a.csv", "--two-modes", "--table", "-o", "xx.yaml"]) == 0
    tap = load_config("xx.yaml").materials["xx"].tap
    assert tap is not None and tap.second is not None and tap.amplitudes == ((0.1, 30.0),)
    assert capsys.readouterr().err.count("hapticd: --") == 0
    fits.answer = FIT
    assert said(capsys, 1, "fit", "tap", "a.csv", "--two-modes") == "hapticd: no second mode was found\n"


def test_fitted_values_are_rounded(fits: Fits, capsys: pytest.CaptureFixture[str]) -> None:
    poles = [-1.2345678901234567, 0.5]
    models = [{"speed_m_per_s": 0.123456789, "force_n": 1.0, "coefficients": poles, "rms_m_per_s2": 1.0}]
    texture = {"kind": "autoregressive", "rate_hz": 2000.0, "models": models}
    fits.answer = dataclasses.replace(FIT, slope_per_s=Estimate(300.123456789, 1.0, 2.0), found=(("texture", texture),))
    assert main(["fit", "tap", "a.csv", "-o", "x.yaml"]) == 0
    material = load_config("x.yaml").materials["x"]
    assert material.tap is not None and material.tap.attack_slope_per_s == 300.1235
    assert isinstance(material.texture, Autoregressive)
    (model,) = material.texture.models
    assert model.speed_m_per_s == 0.1234568
    assert model.coefficients == tuple(poles)  # poles may be near the unit circle


# ---- Several fits, one material --------------------------------------------------------------------------------------


def test_fits_of_several_kinds_make_one_material(fits: Fits, capsys: pytest.CaptureFixture[str]) -> None:
    rupture = {"depth_m": 0.004, "amplitude_m_per_s2": 38.0, "frequency_hz": 200.0, "decay_time_s": 0.003}
    groove = {
        "kind": "grooves",
        "display": "vibration",
        "spacing_m": 0.002,
        "width_m": 0.0005,
        "velocity_gain_per_s": 100.0,
    }
    assert main(["fit", "tap", "a.csv", "-o", "pine.yaml", "--stiffness", "432"]) == 0

    @dataclass(frozen=True, slots=True)
    class Other(FakeFit):
        def material(self, *options: object) -> dict[str, object]:
            return dict(self.found)

    other = Other(FIT.slope_per_s, FIT.frequency_hz, FIT.decay_time_s, found=(("texture", groove),))
    fits.answer = other
    assert main(["fit", "grooves", "b.csv", "-o", "pine.yaml", "--merge"]) == 0
    captured = capsys.readouterr()
    assert "replaced" not in captured.err and "stiffness" not in captured.err
    pine = load_config("pine.yaml").materials["pine"]
    assert pine.tap is not None and isinstance(pine.texture, Grooves)
    assert pine.stiffness_n_per_m == 432
    assert pine.provenance is not None and pine.provenance.intervals is not None
    assert [file.path for file in pine.provenance.files] == ["a.csv", "b.csv"]
    assert {name.split(".")[0] for name in pine.provenance.intervals} == {"tap", "grooves"}

    # A puncture measures the stiffness, and a texture replaces the grooves and their intervals.
    fits.answer = dataclasses.replace(other, found=(("stiffness_n_per_m", 600.0), ("rupture", rupture)))
    assert main(["fit", "puncture", "b.csv", "-o", "pine.yaml", "--merge"]) == 0
    assert "hapticd: stiffness_n_per_m of pine in pine.yaml is replaced\n" in capsys.readouterr().err
    smooth = {"kind": "stochastic", "peak_hz": 150.0, "mean_hz": 200.0, "velocity_gain_per_s": 20.0}
    fits.answer = dataclasses.replace(other, found=(("texture", smooth),))
    assert main(["fit", "texture", "a.csv", "-o", "pine.yaml", "--merge"]) == 0
    assert "hapticd: texture of pine in pine.yaml is replaced\n" in capsys.readouterr().err
    pine = load_config("pine.yaml").materials["pine"]
    assert pine.stiffness_n_per_m == 600 and pine.tap is not None and pine.rupture is not None
    assert pine.provenance is not None and pine.provenance.intervals is not None
    assert {name.split(".")[0] for name in pine.provenance.intervals} == {"tap", "puncture", "texture"}
    assert [file.path for file in pine.provenance.files] == ["b.csv", "a.csv"]

    # With another name the file gets another material.
    fits.answer = FIT
    assert main(["fit", "tap", "a.csv", "-o", "pine.yaml", "--merge", "--name", "oak"]) == 0
    assert {"pine", "oak"} <= set(load_config("pine.yaml").materials)
    assert load_config("pine.yaml").materials["pine"] == pine


def test_a_file_without_valid_materials_is_not_changed(fits: Fits, capsys: pytest.CaptureFixture[str]) -> None:
    for text, message in (
        ("materials: {}\nscene: {}\n", "must have no key but materials"),
        ("a: [", "x.yaml:"),
        (
            "materials: {pine: {stiffness_n_per_m: -1}}\n",
            "x.yaml:1:20: materials.pine.stiffness_n_per_m: should be greater than or equal to 0",
        ),
    ):
        Path("x.yaml").write_text(text)
        assert message in said(capsys, 1, "fit", "tap", "a.csv", "-o", "x.yaml", "--merge")
        assert Path("x.yaml").read_text() == text
    assert fits.recordings == []
    assert main(["fit", "tap", "a.csv", "-o", "new.yaml", "--merge"]) == 0
    assert load_config("new.yaml").materials["new"].tap is not None


def test_fit_prints_json(fits: Fits, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fit", "tap", "a.csv", "--json"]) == 0

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    result = json.loads(capsys.readouterr().out, parse_constant=refuse)
    assert result["kind"] == "tap"
    assert result["fit"] == {
        "frequency_hz": {"value": 67.0, "low": 66.5, "high": 67.5},
        "r_squared": None,
        "taps": [1.0, None],
    }
    assert validate_materials(result["materials"])["tap"].tap is not None
    assert result["notes"] == ["the stiffness, 800 N/m, is assumed, not measured; --stiffness sets it"]


def test_texture_alone_has_autoregressive_models(fits: Fits, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fit", "texture", "--ar", "a.csv"]) == 0
    assert main(["fit", "texture", "a.csv"]) == 0
    assert fits.options == [{"autoregressive": True}, {"autoregressive": False}]
    capsys.readouterr()
    assert "No such option" in said(capsys, 2, "fit", "tap", "--ar", "a.csv")


def test_impossible_fits_are_reported_in_one_line(fits: Fits, capsys: pytest.CaptureFixture[str]) -> None:
    assert "Missing argument" in said(capsys, 2, "fit", "tap")
    assert said(capsys, 1, "fit", "tap", "none.csv").startswith("hapticd: none.csv: cannot be read: ")
    assert said(capsys, 1, "fit", "tap", "a.csv", "-o", "b.csv").startswith("hapticd: b.csv: already exists")
    assert "does not exist" in said(capsys, 1, "fit", "tap", "a.csv", "-o", "no/x.yaml")
    assert "must end in .html or .png" in said(capsys, 1, "fit", "tap", "a.csv", "--report", "x.pdf")
    assert "must not hold a dot" in said(capsys, 1, "fit", "tap", "a.csv", "--name", "a.b", "--json")
    assert "used twice in this command" in said(capsys, 1, "fit", "tap", "a.csv", "-o", "./a.csv", "--overwrite")
    both = ("-o", "x.png", "--report", "./x.png")
    assert "used twice in this command" in said(capsys, 1, "fit", "tap", "a.csv", *both)
    Path("twin.csv").write_bytes(Path("a.csv").read_bytes())
    assert "too many recordings: 1001" in said(capsys, 1, "fit", "tap", *["a.csv"] * 1001)
    assert fits.recordings == []
    fits.answer = HapticdError("a.csv: no onset")
    assert said(capsys, 1, "fit", "tap", "a.csv", "-o", "x.yaml") == "hapticd: a.csv: no onset\n"
    assert not Path("x.yaml").exists()


def test_a_value_out_of_the_range_of_a_material_is_refused(fits: Fits, capsys: pytest.CaptureFixture[str]) -> None:
    fits.answer = FakeFit(Estimate(-3.0, -4.0, -2.0), FIT.frequency_hz, FIT.decay_time_s)
    message = said(capsys, 1, "fit", "tap", "a.csv", "--json")
    assert message == (
        "hapticd: materials.tap.tap.attack_slope_per_s: should be greater than or equal to 0, is -3.0: "
        "the fitted value is out of the range of a material\n"
    )


def test_warnings_of_numpy_are_not_printed(
    fits: Fits, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Divided(FakeFit):
        def material(self, *options: object) -> dict[str, object]:
            return {"tap": {"attack_slope_per_s": float(np.float64(1.0) / np.float64(0.0)), **dict(self.found)}}

    fits.answer = Divided(FIT.slope_per_s, FIT.frequency_hz, FIT.decay_time_s)
    message = said(capsys, 1, "fit", "tap", "a.csv")
    assert message.startswith("hapticd: materials.tap.tap.attack_slope_per_s: should be")


def test_file_names_that_are_not_utf8(fits: Fits, capsys: pytest.CaptureFixture[str]) -> None:
    name = os.fsdecode(b"caf\xe9 $x$.csv")
    Path(name).write_bytes(Path("a.csv").read_bytes())
    assert main(["fit", "tap", name, "-o", "x.yaml"]) == 0
    origin = load_config("x.yaml").materials["x"].provenance
    assert origin is not None and origin.files[0].path == r"caf\xe9 $x$.csv"


@pytest.mark.parametrize("missing", ["scipy", "pandas", "matplotlib"])
def test_without_an_optional_package(
    missing: str, fits: Fits, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, missing, None)
    message = said(capsys, 1, "fit", "tap", "a.csv", "--report", "x.html")
    assert f"needs {missing}: {install_command('fit')}" in message


# ---- Reports ---------------------------------------------------------------------------------------------------------


def page() -> Page:
    x = np.linspace(0, 1, 200)
    lines = (Curve("recording", x, np.sin(9 * x)), Curve("model", x, np.sin(9 * x), low=x - 1, high=x + 1))
    dots = Curve("taps", x[::20], x[::20], points=True, low=x[::20] - 0.1, high=x[::20] + 0.2)
    law = Panel("law", "m/s", "m/s²", (dots,))
    made = ((Panel("one <tap> of $x_{$ 木", "s", "m/s²", lines), Panel("bare", "x", "y", ())), (law,), (law, law))
    estimates, sources = {"slope_per_s": FIT.slope_per_s}, [("a.csv", "00"), (os.fsdecode(b"\xff.csv"), "01")]
    return Page("pine: tap", FIT.verdict, FIT.warnings, estimates, {"r_squared": 0.9876}, sources, made)


def size_of(png: bytes) -> tuple[int, int]:
    assert png.startswith(PNG)
    width, height = struct.unpack(">II", png[16:24])
    return width, height


class Checked(HTMLParser):
    """Checks that tags are closed in order."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.add(tag)
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.mark.long
def test_a_page_holds_its_pictures_and_nothing_from_elsewhere() -> None:
    text = drawn("r.html", page()).decode()
    checked = Checked()
    checked.feed(text)
    assert checked.open == [] and {"html", "title", "body", "h1", "table", "img"} <= checked.seen
    pictures = re.findall(r'src="data:image/png;base64,([^"]+)"', text)
    assert len(pictures) == text.count("src=") == 3
    assert all(min(size_of(base64.b64decode(picture))) > 100 for picture in pictures)
    assert "http" not in text and "href" not in text
    for words in (
        "one mode, well fitted &lt;&amp;&gt;",
        "the first tap is weak",
        "290 to 310",
        "a.csv",
        "one &lt;tap&gt;",
        "0.9876",
    ):
        assert words in text


@pytest.mark.long
def test_a_picture_shows_all_panels() -> None:
    width, height = size_of(drawn("r.PNG", page()))
    assert min(width, height) > 800


def test_figures_have_units() -> None:
    assert figure_rows({"frequency_hz": FIT.frequency_hz}) == [("frequency_hz", "67", "66.5 to 67.5", "Hz")]


def test_a_thinned_line_keeps_its_extremes() -> None:
    x = np.arange(100_000.0)
    y = np.random.default_rng(3).standard_normal(100_000)
    fewer_x, fewer_y = thinned(x, y, 1000)
    assert len(fewer_x) <= 1000
    assert np.all(np.diff(fewer_x) > 0)
    assert (fewer_y.min(), fewer_y.max()) == (y.min(), y.max())
    assert np.array_equal(fewer_y, y[fewer_x.astype(int)])


# ---- Synthetic recordings --------------------------------------------------------------------------------------------


@pytest.mark.long
def test_synthetic_recordings_are_fitted_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Synthesize each kind, fit it into one material and draw it; fitted values are those that `synthesize` prints."""
    monkeypatch.chdir(tmp_path)
    short = {"tap": (), "grooves": ("--duration", "0.5"), "texture": ("--duration", "3"), "puncture": ()}
    within = {"mean_hz": 0.05, "velocity_gain_per_s": 0.2, "force_gain_m_per_s2_per_n": 0.2}
    for kind, more in short.items():
        assert main(["fit", "synthesize", kind, "-o", f"{kind}.npz", "--noise", "0.01", "--json", *more]) == 0
        made = json.loads(capsys.readouterr().out)
        assert made["kind"] == kind and all(Path(file).is_file() for file in made["files"])
        arguments = ["-o", "all.yaml", "--merge", "--name", "pine", "--json"]
        if kind == "tap":
            arguments += ["--report", "tap.html"]
        assert main(["fit", kind, *made["files"], *arguments]) == 0
        result = json.loads(capsys.readouterr().out)
        assert len(made["truth"]) >= 4
        for name, truth in made["truth"].items():
            found = result["fit"][name]
            if name == "peak_hz":
                # 12 s do not resolve the peak of a broad spectrum.
                assert found is None and truth < result["fit"]["peak_below_hz"]
                continue
            assert found["value"] == pytest.approx(truth, rel=within.get(name, 0.02) if kind == "texture" else 0.02)
            assert found["low"] <= found["value"] <= found["high"]
    assert Path("tap.html").read_text().count("data:image/png;base64,") == 4
    pine = load_config("all.yaml").materials["pine"]
    assert pine.tap is not None and pine.rupture is not None and pine.texture is not None
    assert pine.provenance is not None and len(pine.provenance.files) == 1 + 4 + 4 + 4


def test_synthesize_follows_its_options(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    sensor = ["--rate", "12000", "--noise", "0", "--full-scale", "20", "--seed", "7"]
    for _ in range(2):
        assert main(["fit", "synthesize", "tap", "-o", "t.npz", "--speed", "0.2", *sensor, "--overwrite"]) == 0
    made = load("t.npz")
    assert made.rate_hz == 12000
    assert made.acceleration_m_per_s2 is not None and made.acceleration_m_per_s2.max() == 20.0  # clipped
    assert made.speed_m_per_s == 0.2
    assert "slope_per_s: 309 1/s" in capsys.readouterr().out
    assert main(["fit", "synthesize", "tap", "-o", "u.npz", "--speed", "0.2", *sensor]) == 0
    assert np.array_equal(load("u.npz").acceleration_m_per_s2, made.acceleration_m_per_s2)  # the same seed

    strokes = ["--speed", "0.05", "--speed", "0.1", "--force", "1", "--duration", "0.3"]
    assert main(["fit", "synthesize", "grooves", "-o", "g.npz", *strokes]) == 0
    assert sorted(path.name for path in Path().glob("g*")) == ["g-1.npz", "g-2.npz"]

    Path("mine.yaml").write_text(
        "materials: {felt: {stiffness_n_per_m: 90, tap: {frequency_hz: 80, decay_time_s: 0.01, "
        "attack_slope_per_s: 50, attack: first_peak}}}\n"
    )
    assert main(["fit", "synthesize", "tap", "-o", "f.npz", "--material", "felt", "-c", "mine.yaml"]) == 0
    assert "first_peak_slope_per_s: 50 1/s" in capsys.readouterr().out


def test_impossible_syntheses_are_reported_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("two.yaml").write_text(
        "materials: {two: {stiffness_n_per_m: 90, tap: {frequency_hz: 80, decay_time_s: 0.01, attack_slope_per_s: 50, "
        "second: {frequency_hz: 300, decay_time_s: 0.01, ratio: 1}}}}\n"
    )
    Path("old.npz").write_text("")
    make = ("fit", "synthesize")
    for message, code, arguments in (
        ("Missing option '-o'", 2, ("tap",)),
        ("must end in .npz", 1, ("tap", "-o", "x.csv")),
        ("already exists", 1, ("tap", "-o", "old.npz")),
        ("the folder no does not exist", 1, ("tap", "-o", "no/x.npz")),
        ("-c FILE adds other materials", 1, ("tap", "-o", "x.npz", "--material", "cork")),
        ('unknown material "wod"', 1, ("tap", "-o", "x.npz", "--material", "wod")),
        ("the material has no tap", 1, ("tap", "-o", "x.npz", "--material", "cellophane")),
        ("its tap has two modes", 1, ("tap", "-o", "x.npz", "--material", "two", "-c", "two.yaml")),
        ("grooves", 1, ("grooves", "-o", "x.npz", "--material", "wood")),
        ("texture", 1, ("texture", "-o", "x.npz", "--material", "wood")),
        ("rupture", 1, ("puncture", "-o", "x.npz", "--material", "wood")),
        ("not a finite number", 2, ("tap", "-o", "x.npz", "--rate", "nan")),
    ):
        assert message in said(capsys, code, *make, *arguments)
    assert sorted(path.name for path in Path().iterdir()) == ["old.npz", "two.yaml"]
