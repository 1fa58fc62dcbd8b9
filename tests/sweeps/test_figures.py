"""Figures of sweeps, checked by the data of their axes instead of pixels."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure

from hapticd.base.errors import HapticdError, InvalidError
from hapticd.sweeps.figures import drawings_of, file_names
from hapticd.sweeps.report_page import page
from hapticd.sweeps.results import best_of
from hapticd.sweeps.study import load_sweep
from tests.sweeps.results_of import MASS, RATE, STIFFNESS, results_of, study_of

RATES, STIFFNESSES = [1000.0, 2000.0, 4000.0, 8000.0], [100.0, 300.0, 1000.0]
MAP = {"kind": "map", "x": RATE, "y": STIFFNESS, "color": "stability_factor", "overlay": "passive_limit_n_per_m"}
CROSSED = study_of(vary={RATE: RATES, STIFFNESS: STIFFNESSES}, figures=[MAP])
ROWS = [
    {RATE: rate, STIFFNESS: k, "stability_factor": rate / k, "passive_limit_n_per_m": 0.4 * rate}
    for rate in RATES
    for k in STIFFNESSES
]


def drawn(study: dict[str, Any], rows: list[dict[str, Any]]) -> list[Figure]:
    return [each.draw() for each in drawings_of(results_of(study, rows))]


def cells(axes: Axes) -> Any:
    (mesh,) = (each for each in axes.collections if isinstance(each, QuadMesh))
    return mesh.get_array()


def labelled(axes: Axes, label: str) -> np.ndarray:
    """Return the data of the line with this label, (n, 2)."""
    (line,) = (line for line in axes.lines if line.get_label() == label)
    return np.asarray(line.get_xydata(), dtype=float)


# ---- Maps ------------------------------------------------------------------------------------------------------------


def test_a_map_has_a_cell_for_each_point_and_units_at_its_axes() -> None:
    (figure,) = drawn(CROSSED, ROWS)
    axes, bar = figure.axes
    assert cells(axes).filled(np.nan) == pytest.approx(np.array([[rate / k for rate in RATES] for k in STIFFNESSES]))
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("rate, Hz", "stiffness, N/m")
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    assert bar.get_ylabel() == "stability factor (no unit)"


def test_a_line_over_a_map_lies_at_its_own_values() -> None:
    (figure,) = drawn(CROSSED, ROWS)
    found = labelled(figure.axes[0], "passive limit")
    assert found[:, 0].tolist() == RATES
    assert found[:, 1] == pytest.approx(0.4 * np.array(RATES))


def test_edges_of_cells_are_half_way_between_values_on_the_axis() -> None:
    (figure,) = drawn(CROSSED, ROWS)
    (mesh,) = (each for each in figure.axes[0].collections if isinstance(each, QuadMesh))
    edges = np.asarray(mesh.get_coordinates())[0, :, 0]
    assert edges == pytest.approx(1000 * 2.0 ** np.array([-0.5, 0.5, 1.5, 2.5, 3.5]))


def test_an_overlay_that_depends_on_y_is_refused_in_one_line() -> None:
    rows = [{**row, "passive_limit_n_per_m": row[STIFFNESS]} for row in ROWS]
    with pytest.raises(
        HapticdError, match=r"overlay passive_limit_n_per_m has more than one value at servo\.rate_hz 1000"
    ):
        drawn(CROSSED, rows)


def test_points_without_a_result_are_crosses_and_those_not_computed_are_empty() -> None:
    rows = [{**ROWS[0], "stability_factor": None, "error": "no"}, *ROWS[2:]]
    (figure,) = drawn(CROSSED, rows)
    axes = figure.axes[0]
    assert labelled(axes, "no result").tolist() == [[1000.0, 100.0]]
    empty = np.argwhere(np.ma.getmaskarray(cells(axes))).tolist()
    assert empty == [[0, 0], [1, 0]]
    assert "no result" in [text.get_text() for text in figure.legends[0].get_texts()]


def test_values_of_a_third_key_have_a_panel_each_and_one_scale_of_colors() -> None:
    study = study_of(
        vary={RATE: [1000.0, 2000.0], STIFFNESS: [100.0, 200.0], MASS: [0.04, 0.08]}, figures=[{**MAP, "by": MASS}]
    )
    rows = [
        {RATE: rate, STIFFNESS: k, MASS: mass, "stability_factor": mass}
        for rate in (1000.0, 2000.0)
        for k in (100.0, 200.0)
        for mass in (0.04, 0.08)
    ]
    (figure,) = drawn(study, rows)
    first, second = figure.axes[:2]
    assert (first.get_title(), second.get_title()) == ("handle mass 40 g", "handle mass 80 g")
    assert set(cells(first).ravel()) == {0.04} and set(cells(second).ravel()) == {0.08}
    assert {each.collections[0].get_clim() for each in (first, second)} == {(0.04, 0.08)}


def test_texts_have_a_color_each_in_the_order_and_with_the_words_of_the_legend() -> None:
    press = {"waypoints": [[0, 0, 0.002], [0.05, 0, -0.001]]}
    words = {"rests": "comes to rest", "cycles": "oscillates"}
    keys = {"kind": "map", "x": RATE, "y": STIFFNESS, "color": "end", "legend": words}
    study = study_of(
        vary={RATE: [1000.0, 2000.0], STIFFNESS: [100.0, 200.0]}, operator=press, measure=["end"], figures=[keys]
    )
    ends = ["cycles", "rests", "grows", "rests"]
    points = [(rate, k) for rate in (1000.0, 2000.0) for k in (100.0, 200.0)]
    (figure,) = drawn(study, [{RATE: r, STIFFNESS: k, "end": end} for (r, k), end in zip(points, ends, strict=True)])
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["comes to rest", "oscillates", "grows"]
    assert cells(figure.axes[0]).tolist() == [[1.0, 2.0], [0.0, 0.0]]


@pytest.mark.parametrize(
    "keys",
    [{**MAP, "by": MASS}, {"kind": "line", "x": RATE, "y": "stability_factor", "by": MASS, "where": {STIFFNESS: 200}}],
)
def test_the_computed_points_of_an_interrupted_study_are_drawn(keys: dict[str, Any]) -> None:
    vary = {RATE: RATES, STIFFNESS: [100.0, 200.0], MASS: [0.04, 0.08]}
    row = {RATE: 4000.0, STIFFNESS: 100.0, MASS: 0.08, "stability_factor": 3.0}
    (figure,) = drawn(study_of(vary=vary, figures=[keys]), [row])
    figure.canvas.draw()
    if keys["kind"] == "map":
        first, second = (cells(axes) for axes in figure.axes[:2])
        assert first.mask.all() and second.shape == (2, 4)
        assert np.argwhere(~second.mask).tolist() == [[0, 2]] and second[0, 2] == 3.0


def test_too_many_texts_are_refused_in_one_line() -> None:
    options = {"materials": ["wood"]}
    figure = {"kind": "map", "x": RATE, "y": STIFFNESS, "color": "not_displayed"}
    study = study_of(
        vary={RATE: RATES, STIFFNESS: STIFFNESSES}, measure=[{"displayed_materials": options}], figures=[figure]
    )
    rows = [{RATE: row[RATE], STIFFNESS: row[STIFFNESS], "not_displayed": f"{place}"} for place, row in enumerate(ROWS)]
    with pytest.raises(HapticdError, match="not_displayed has 12 different texts; a map can have at most 8"):
        drawn(study, rows)
    titles = [each.title for each in drawings_of(results_of({**study, "figures": None}, rows))]
    assert not any("Not displayed" in title for title in titles)


def test_an_infinite_value_is_not_a_missing_result() -> None:
    rows = [{**row, "stability_factor": np.inf if row[RATE] == 8000 else 1.0 + row[RATE]} for row in ROWS]
    (figure,) = drawn(CROSSED, rows)
    axes, bar = figure.axes
    assert "no result" not in [line.get_label() for line in axes.lines]
    assert axes.collections[0].get_clim() == (1001.0, 4001.0)
    assert (cells(axes)[:, 3] > 4001.0).all() and (cells(axes)[:, :3] <= 4001.0).all()
    assert bar.get_ylim() == (1001.0, 4001.0)


@pytest.mark.parametrize("color", ["end", "rests"])
def test_a_map_without_a_result_has_only_crosses(color: str) -> None:
    press = {"waypoints": [[0, 0, 0.002], [0.05, 0, -0.001]]}
    figure = {"kind": "map", "x": RATE, "y": STIFFNESS, "color": color}
    study = study_of(
        vary={RATE: RATES, STIFFNESS: STIFFNESSES}, operator=press, measure=["end"], figures=[figure]
    )  # fmt: skip
    (found,) = drawn(study, [{RATE: row[RATE], STIFFNESS: row[STIFFNESS], "error": "no"} for row in ROWS])
    found.canvas.draw()
    assert len(labelled(found.axes[0], "no result")) == 12


def test_random_points_are_dots_at_their_values() -> None:
    study = study_of(
        vary={RATE: {"low": 1000, "high": 9000}, STIFFNESS: {"low": 100, "high": 900}},
        combine="random", count=3, figures=[{**MAP, "overlay": None}],
    )  # fmt: skip
    places = [(1500.0, 200.0), (3000.0, 800.0), (8000.0, 300.0)]
    (figure,) = drawn(study, [{RATE: x, STIFFNESS: y, "stability_factor": x / y} for x, y in places])
    (dots,) = figure.axes[0].collections
    assert np.asarray(dots.get_offsets()).tolist() == [list(place) for place in places]
    assert np.asarray(dots.get_array()) == pytest.approx([x / y for x, y in places])


# ---- Lines -----------------------------------------------------------------------------------------------------------

LINE = {"kind": "line", "x": RATE, "y": "passive_limit_n_per_m", "by": MASS}


def test_each_value_of_another_key_has_a_line_with_its_unit_in_the_legend() -> None:
    study = study_of(vary={RATE: RATES, MASS: [0.04, 0.08]}, figures=[LINE])
    rows = [{RATE: rate, MASS: mass, "passive_limit_n_per_m": rate * mass} for rate in RATES for mass in (0.04, 0.08)]
    (figure,) = drawn(study, rows)
    (axes,) = figure.axes
    assert labelled(axes, "80")[:, 1] == pytest.approx(0.08 * np.array(RATES))
    assert axes.get_ylabel() == "passive limit, N/m"
    (legend,) = figure.legends
    assert legend.get_title().get_text() == "handle mass, g"
    assert [text.get_text() for text in legend.get_texts()] == ["40", "80"]


def test_the_key_where_keeps_one_value_and_is_in_the_caption() -> None:
    study = study_of(
        vary={RATE: RATES, MASS: [0.04, 0.08]}, figures=[{**LINE, "by": None, "where": {MASS: 0.08}}]
    )  # fmt: skip
    rows = [{RATE: rate, MASS: mass, "passive_limit_n_per_m": rate * mass} for rate in RATES for mass in (0.04, 0.08)]
    (figure,) = drawn(study, rows)
    assert labelled(figure.axes[0], "passive limit")[:, 1] == pytest.approx(0.08 * np.array(RATES))
    assert figure.get_suptitle().endswith("\nhandle mass: 80 g")


REFINED = study_of(
    vary={RATE: RATES},
    measure=["stability_factor", {"passive_limit": {"material": "m"}}],
    refine={"key": STIFFNESS, "start": 100, "end": 10000, "holds": {"column": "stability_factor", "at_least": 1}},
)
BOUNDS = [
    {RATE: 1000.0, "boundary": 390.0, "boundary_fails": 410.0, "boundary_state": "found"},
    {RATE: 2000.0, "boundary": 790.0, "boundary_fails": 820.0, "boundary_state": "found"},
    {RATE: 4000.0, "boundary": None, "boundary_fails": 100.0, "boundary_state": "never"},
    {RATE: 8000.0, "boundary": 10000.0, "boundary_fails": None, "boundary_state": "always"},
]


def test_a_boundary_is_a_line_with_a_band_and_one_that_was_not_found_is_marked() -> None:
    (figure,) = drawn(REFINED, BOUNDS)
    (axes,) = figure.axes
    line = labelled(axes, "stiffness at the boundary")
    assert line[:2].tolist() == [[1000.0, 390.0], [2000.0, 790.0]] and np.isnan(line[2:, 1]).all()
    (band,) = axes.collections
    corners = {tuple(point) for path in band.get_paths() for point in path.vertices.tolist()}
    assert {(1000.0, 390.0), (1000.0, 410.0), (2000.0, 790.0), (2000.0, 820.0)} == corners
    assert labelled(axes, "does not hold at the start of the search").tolist() == [[4000.0, 100.0]]
    assert labelled(axes, "holds to the end of the search").tolist() == [[8000.0, 10000.0]]
    assert "no result" not in [line.get_label() for line in axes.lines]
    assert axes.get_ylabel() == "stiffness at the boundary, N/m" and axes.get_yscale() == "log"


def test_a_point_of_a_line_without_a_result_is_a_cross_at_the_edge() -> None:
    rows = [{RATE: rate, "stability_factor": None if rate == 2000 else 1.0} for rate in RATES]
    figure = drawn(study_of(vary={RATE: RATES}), rows)[0]
    (axes,) = figure.axes
    (missing,) = (line for line in axes.lines if line.get_label() == "no result")
    assert np.asarray(missing.get_xdata()).tolist() == [2000.0]
    assert missing.get_transform() == axes.get_xaxis_transform()


# ---- Default figures -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("vary", "expected"),
    [
        ({RATE: RATES}, ("line", RATE, None)),
        ({MASS: [0.1, 0.2], RATE: RATES}, ("line", RATE, MASS)),
        ({RATE: [1e3, 2e3, 3e3, 4e3, 5e3], STIFFNESS: [1.0, 2.0, 3.0, 4.0, 5.0]}, ("map", RATE, None)),
        ({"hand": {"levels": {"light": {MASS: 0.1}, "firm": {MASS: 0.2}}}, RATE: RATES}, ("line", RATE, "hand")),
    ],
)
def test_default_figures(vary: dict[str, Any], expected: tuple[Any, ...]) -> None:
    values = [list(each["levels"]) if isinstance(each, dict) else each for each in vary.values()]
    points = [dict(zip(vary, point, strict=True)) for point in np.array(np.meshgrid(*values, indexing="ij"), object)
              .reshape(len(vary), -1).T.tolist()]  # fmt: skip
    results = results_of(study_of(vary=vary), [{**point, "stability_factor": 2.0} for point in points])
    (first,) = drawings_of(results)
    assert (first.keys.kind, first.keys.x, first.keys.by) == expected
    first.draw()


def test_without_a_varied_number_nothing_is_drawn() -> None:
    vary = {"hand": {"levels": {"light": {MASS: 0.1}, "firm": {MASS: 0.2}}}}
    assert drawings_of(results_of(study_of(vary=vary), [{"hand": "light"}, {"hand": "firm"}])) == []


# ---- Faults ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"kind": "pie"}, "figures[0].kind: should be 'map', 'line' or 'table'"),
        ({"kind": "map", "x": RATE, "y": STIFFNESS}, "figures[0]: kind: map needs color"),
        ({"kind": "line", "x": RATE, "y": "stability_factor", "color": "x"}, "color is not a key of kind: line"),
        ({**MAP, "x": "servo.rate"}, "figures[0].x: servo.rate is not a varied key; did you mean servo.rate_hz?"),
        ({**MAP, "color": "stability"}, "figures[0].color: unknown measured column stability"),
        (
            {**MAP, "overlay": "stability_factor"},
            "figures[0].overlay: stability_factor must have the unit of y, N/m, has no unit",
        ),
        (
            {"kind": "line", "x": RATE, "y": ["stability_factor", "passive_limit_n_per_m"], "where": {STIFFNESS: 100}},
            "figures[0].y: columns of one figure must have the same unit, have: stability_factor (no unit), "
            "passive_limit_n_per_m",
        ),
        (
            {"kind": "line", "x": RATE, "y": "stability_factor"},
            f"figures[0]: {STIFFNESS} is varied, too: set one of its values in where, or use it as by",
        ),
        (
            {"kind": "line", "x": RATE, "y": "stability_factor", "where": {STIFFNESS: 150}},
            "no point has the value 150; known: 100.0, 300.0, 1000.0",
        ),
        ({**MAP, "y": RATE}, "is used twice"),
        ({"kind": "table", "columns": ["rate"]}, "figures[0].columns: unknown column rate"),
        ({"kind": "table", "best": {"error": "least"}}, "error is a text column; best needs numbers"),
    ],
)
def test_a_fault_of_a_figure_has_its_line(keys: dict[str, Any], message: str, tmp_path: Path) -> None:
    file = tmp_path / "study.yaml"
    file.write_text(yaml.safe_dump({**CROSSED, "figures": [keys]}, sort_keys=False))
    with pytest.raises(InvalidError) as caught:
        load_sweep(file)
    (first, *_) = str(caught.value).splitlines()
    assert message in str(caught.value)
    assert re.match(r".*/study\.yaml:\d+:\d+: figures", first)


def test_a_label_of_an_unknown_column_is_a_fault() -> None:
    with pytest.raises(InvalidError, match=r"unknown column servo\.rate; did you mean servo\.rate_hz\?"):
        load_sweep({**CROSSED, "labels": {"servo.rate": "rate"}})


def test_figures_and_labels_do_not_change_identities() -> None:
    without = {**CROSSED, "figures": [], "labels": {RATE: "ticks a second"}}
    assert (load_sweep(CROSSED).ids == load_sweep(without).ids).all()


# ---- Page ------------------------------------------------------------------------------------------------------------


def test_the_page_is_one_file_in_the_colors_of_the_screen() -> None:
    study = {
        **CROSSED,
        "title": "Walls & hands",
        "seed": 7,
        "labels": {"stability_factor": "margin of <safety>"},
        "figures": [MAP, {"kind": "table", "title": "Stiff", "where": {STIFFNESS: 1000}}],
    }
    results = results_of(study, [*ROWS[:-1], {**ROWS[-1], "stability_factor": None, "error": "not known"}])
    text = page(results, drawings_of(results))
    assert "<h1>Walls &amp; hands</h1>" in text and "12 points, 1 without a result" in text
    # The page loads no other file: all references are within the page.
    references = re.findall(r"""(?:src|href)\s*=\s*["']([^"']*)""", text) + re.findall(r"url\(([^)]*)\)", text)
    assert references and all(re.match("['\"]?(#|data:image/png;base64,)", each) for each in references)
    assert not re.search(r"<(script|link|iframe|object|embed|img)\b|@import", text)
    assert "color-scheme:light dark" in text and "currentColor" in text and "#010203" not in text
    assert "margin of &lt;safety&gt;" in text and "<safety>" not in text
    tables = re.findall(r"<table>.*?</table>", text, re.S)
    assert [len(re.findall("<tr>", table)) - 1 for table in tables[:2]] == [4, 12]
    assert "<caption>Stiff</caption>" in tables[0] and "not known" in tables[1]
    assert "<td" in tables[2] and "seed" in tables[2] and ">7<" in tables[2] and ">v<" in tables[2]
    shown = re.search(r"<pre>(.*?)</pre>", text, re.S)
    assert shown is not None
    written = yaml.safe_load(
        shown[1].replace("&amp;", "&").replace("&lt;", "<").replace("&gt;", ">").replace("&quot;", '"')
    )
    assert load_sweep(written).ids.tolist() == load_sweep(study).ids.tolist()


def test_the_page_has_the_file_of_the_study_unchanged(tmp_path: Path) -> None:
    file = tmp_path / "study.yaml"
    file.write_text("# Why: <ask me>\n" + yaml.safe_dump(CROSSED))
    manifest = load_sweep(file).manifest()
    assert manifest["source"] == file.read_text()


def test_file_names_have_number_and_title() -> None:
    assert file_names(drawings_of(results_of(CROSSED, ROWS))) == ["1-stability-factor-over-rate-and-stiffness.png"]


def test_the_best_rows_are_pareto_optimal() -> None:
    rows: list[dict[str, Any]] = [{"a": a, "b": b} for a, b in [(1, 5), (2, 5), (2, 7), (3, 9), (1, 4), (None, 99)]]
    assert best_of(rows, {"a": "least", "b": "most"}) == [rows[0], rows[2], rows[3]]
