"""Configuration: limits, faults with file and line, merging, numpy, schema, shipped files, the reference."""

import json
import math
import pathlib
import re
from collections.abc import Iterator
from importlib import resources

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from hapticd.base.errors import HapticdError, InvalidError
from hapticd.base.model import Model, problems_of
from hapticd.base.yaml_source import Json, load_text
from hapticd.config.configuration import Config, Sim, default_config, load_config
from hapticd.config.dynamics import Dynamics
from hapticd.config.materials import shipped_document, shipped_materials
from hapticd.config.operator import parse_operator
from hapticd.config.scene import Scene, load_scene
from hapticd.config.schema import config_schema, unit_of

DOCS = pathlib.Path(__file__).parents[2] / "docs"
REFERENCE = DOCS / "materials.md"

Schema = dict[str, Json]

NO_PATCHES: dict[str, Json] = {"patches": [], "patch_ramp_m": 0.001}


def faults(*sources: object) -> dict[str, str]:
    with pytest.raises(InvalidError) as caught:
        load_config(sources[0] if len(sources) == 1 else sources)  # type: ignore[arg-type]
    assert str(caught.value).isprintable()
    return {problem.where: problem.problem for problem in caught.value.problems}


# ---- limits ---------------------------------------------------------------------------------------


def mapping(value: Json) -> Schema:
    assert isinstance(value, dict)
    return value


def models() -> dict[str, Schema]:
    return {name: mapping(schema) for name, schema in mapping(config_schema()["$defs"]).items()}


def sound(schema: Schema) -> Schema:
    """Return the schema of a property without its alternative null."""
    options = schema.get("anyOf")
    if isinstance(options, list):
        return mapping(next(option for option in options if mapping(option).get("type") != "null"))
    return schema


def shown_number(value: float) -> str:
    """Return a number as in pydantic's messages, without an exponent."""
    return np.format_float_positional(value, trim="-")


def numbers() -> Iterator[tuple[str, str, Schema, int]]:
    """Yield model, key, limits and, for a list of numbers, its length; otherwise 0."""
    for name, model in models().items():
        for key, described in mapping(model["properties"]).items():
            property_ = sound(mapping(described))
            items = property_.get("prefixItems")
            if isinstance(items, list):
                yield name, key, mapping(items[0]), len(items)
            elif property_.get("type") in ("number", "integer") and "enum" not in property_:
                yield name, key, property_, 0


def faults_of_key(model: str, key: str, value: Json) -> list[str]:
    """Return the faults of one key, without those of other keys of the model."""
    try:
        Model.by_name[model].parsed({key: value})
    except ValidationError as error:
        problems = problems_of(error)
        return [p.problem for p in problems if p.where == key or p.where.startswith(f"{key}[")]
    return []


NUMBERS = list(numbers())


@pytest.mark.parametrize(("model", "key", "limits", "length"), NUMBERS, ids=[f"{n[0]}.{n[1]}" for n in NUMBERS])
def test_every_number_is_strict_and_has_limits(model: str, key: str, limits: Schema, length: int) -> None:
    low, high = limits["minimum"], limits["maximum"]
    assert isinstance(low, int | float)
    assert isinstance(high, int | float)
    assert low < high

    def problems(value: Json) -> list[str]:
        others: list[Json] = [1 if limits["type"] == "integer" else 0.5] * (length - 1)
        return faults_of_key(model, key, [value, *others] if length else value)

    assert problems(low) == problems(high) == []
    below, above = low - 1, high + 1
    (too_small,), (too_large,) = problems(below), problems(above)
    too_small = too_small.removesuffix("; a slower simulated joystick has device.sim.link.rate_hz")
    for text, limit, value in (
        (too_small, f"greater than or equal to {shown_number(low)}", below),
        (too_large, f"less than or equal to {shown_number(high)}", above),
    ):
        assert text.partition("; if it is in mm, write ")[0] == f"should be {limit}, is {value!r}"
    kind = "integer" if limits["type"] == "integer" else "number"
    wrong: list[tuple[Json, str]] = [(True, "true"), ("1", '"1"'), ([], "a list")]
    for value, shown in wrong:
        assert problems(value) == [f"should be a valid {kind}, is {shown}"]
    for number in (math.nan, math.inf, -math.inf):
        assert len(problems(number)) == 1


def test_rates_of_1_hz_and_20_khz_are_refused() -> None:
    assert faults({"servo": {"rate_hz": 1}}) == {"servo.rate_hz": "should be greater than or equal to 1000, is 1"}
    assert faults({"servo": {"rate_hz": 20e3}}) == {
        "servo.rate_hz": "should be less than or equal to 10000, is 20000.0"
    }


def test_a_rate_of_a_slow_device_names_its_key() -> None:
    (text,) = faults({"servo": {"rate_hz": 500}}).values()
    assert text == (
        "should be greater than or equal to 1000, is 500; a slower simulated joystick has device.sim.link.rate_hz"
    )
    link = load_config({"device": {"sim": {"link": {"rate_hz": 500}}}}).device.sim.link
    assert link is not None and link.rate_hz == 500


@pytest.mark.parametrize(
    ("value", "wanted"), [(1.07, "0x0107"), (12.3, "0x1230"), (1.075, ""), (-1.0, ""), (math.nan, "")]
)
def test_a_version_as_lsusb_prints_it_is_given_as_the_device_has_it(value: float, wanted: str) -> None:
    (text,) = faults({"device": {"hid": {"device_version": value}}}).values()
    assert text.endswith(f"; write {wanted}") if wanted else "write" not in text


@pytest.mark.parametrize(
    ("y_m", "wanted"),
    [
        (-20, "should be greater than or equal to -10, is -20; if it is in mm, write -0.02"),
        (20, "should be less than or equal to 10, is 20; if it is in mm, write 0.02"),
        (-20000, "should be greater than or equal to -10, is -20000"),
    ],
)
def test_a_length_beyond_the_limits_may_be_in_mm(y_m: float, wanted: str) -> None:
    wall = {"kind": "wall", "point_m": [0, y_m], "normal": [0, 1], "material": "wood"}
    assert faults({"scene": {"objects": {"o": wall}}}) == {"scene.objects.o.point_m[1]": wanted}


def test_defaults_have_the_type_of_their_key() -> None:
    for model in Model.by_name.values():
        for key, field in model.model_fields.items():
            if field.annotation in (float, int, bool, str) and not field.is_required() and not field.default_factory:
                assert type(field.default) is field.annotation, f"{model.__name__}.{key}"


def test_effective_mass_follows_handle_and_hand() -> None:
    assert load_config({}).device.effective_mass_kg == 0.05
    sim: dict[str, Json] = {"handle_mass_kg": 0.5, "hand": {"mass_kg": 0.25}}
    assert load_config({"device": {"sim": sim}}).device.effective_mass_kg == 0.75
    assert load_config({"device": {"sim": sim, "effective_mass_kg": 1}}).device.effective_mass_kg == 1
    assert load_config({"device": {"sim": sim, "handle": {"mass_kg": 0.125}}}).device.effective_mass_kg == 0.375
    assert load_config({"device": {"sim": sim, "grip": {"mass_kg": 0.125}}}).device.effective_mass_kg == 0.625
    both = {"kind": "hid", "handle": {"mass_kg": 0.5}, "grip": {}}
    assert load_config({"device": both}).device.effective_mass_kg == 0.5


def test_undisplayable_modes_of_a_real_device_are_lowered_by_default() -> None:
    assert load_config({}).device.undisplayable == "mute"
    assert load_config({"device": {"kind": "hid"}}).device.undisplayable == "lower"
    assert load_config({"device": {"kind": "replay", "replay": {"path": "x"}}}).device.undisplayable == "lower"
    assert load_config({"device": {"kind": "hid", "undisplayable": "mute"}}).device.undisplayable == "mute"


def test_dynamics_of_handle_and_hand() -> None:
    sim = load_config({}).device
    assert sim.dynamics == Dynamics(0.04, 0.2, 0.05, 0.01, 5, 300)
    assert (sim.dynamics.mass_kg, sim.dynamics.damping_n_s_per_m) == (sim.effective_mass_kg, 5.2)
    handle: dict[str, Json] = {"mass_kg": 0.1, "damping_n_s_per_m": 0.5, "friction_n": 0.2}
    grip: dict[str, Json] = {"mass_kg": 0.02, "damping_n_s_per_m": 3, "stiffness_n_per_m": 200}
    for kind in ("sim", "hid"):
        given = load_config({"device": {"kind": kind, "handle": handle, "grip": grip}}).device.dynamics
        assert given == Dynamics(0.1, 0.5, 0.2, 0.02, 3, 200)
    assert load_config({"device": {"kind": "hid", "handle": handle}}).device.dynamics == Dynamics(
        0.1, 0.5, 0.2, 0, 0, 0
    )
    assert load_config({"device": {"kind": "hid", "grip": grip}}).device.dynamics is None


def test_start_is_inside_the_workspace() -> None:
    assert faults({"device": {"sim": {"start_m": [0, 0.1]}}}) == {
        "device.sim": "start_m must be inside the workspace, -0.075 to 0.075 m"
    }
    assert load_config({"device": {"sim": {"start_m": [0, -0.1], "workspace_m": 0.1}}}).device.sim.start_m[1] == -0.1


def test_a_link_sets_interval_and_age_of_positions() -> None:
    assert load_config({}).device.sim.reports_s == (0, 0)
    sim = load_config({"device": {"sim": {"link": {"rate_hz": 250, "delay_frames": 3}}}}).device.sim
    assert sim.reports_s == pytest.approx((0.004, 0.012), rel=1e-15)
    text = "with a link, leave out report_interval_s and report_delay_s: the link sets both"
    for key in ("report_interval_s", "report_delay_s"):
        assert faults({"device": {"sim": {"link": {"rate_hz": 1000}, key: 0.001}}}) == {"device.sim": text}
    assert list(faults({"device": {"sim": {"link": {}}}})) == ["device.sim.link.rate_hz"]


def test_words() -> None:
    assert faults(
        {
            "servo": {"realtime": False, "priority": 80.0},
            "device": {"kind": "usb", "undisplayable": "Mute"},
            "scene": {"display": {"force": "off", "vibration": 1}},
        }
    ) == {
        "servo.realtime": "should be 'required', 'preferred' or 'off', is false",
        "servo.priority": "should be a valid integer, is 80.0",
        "device.kind": "should be 'sim', 'hid' or 'replay', is \"usb\"",
        "device.undisplayable": "should be 'mute' or 'lower', is \"Mute\"",
        "scene.display.force": 'should be a valid boolean, is "off"',
        "scene.display.vibration": "should be a valid boolean, is 1",
    }
    assert load_config({"servo": {"realtime": "off", "cpu": None}}).servo.realtime == "off"


# ---- sources --------------------------------------------------------------------------------------


def write(path: pathlib.Path, text: str) -> pathlib.Path:
    path.write_text(text)
    return path


BAD = """\
servo:
  rate_hz: 1
  realtime: off
  prioriti: 3
materials:
  pine:
    stiffness_n_per_m: "1"
    tap: {attack_slope_per_s: 300,
          frequency_hz: 67}
scene:
  objects:
    table:
      kind: wall
      point_m: [0, true]
      material: wood
"""


def test_every_fault_names_file_line_key_and_limit(tmp_path: pathlib.Path) -> None:
    path = write(tmp_path / "bad.yaml", BAD)
    assert faults(path) == {
        f"{path}:2:3: servo.rate_hz": "should be greater than or equal to 1000, is 1",
        f"{path}:4:3: servo.prioriti": "unknown key; did you mean priority?",
        f"{path}:7:5: materials.pine.stiffness_n_per_m": 'should be a valid number, is "1"',
        f"{path}:8:5: materials.pine.tap": "needs exactly one of decay_time_s and decay_rate_per_s, has neither",
        f"{path}:14:20: scene.objects.table.point_m[1]": "should be a valid number, is true",
        f"{path}:12:5: scene.objects.table.normal": "Field required",
    }


def test_unknown_materials_are_reported_if_all_keys_are_valid(tmp_path: pathlib.Path) -> None:
    text = "scene:\n  objects:\n    t: {kind: wall, point_m: [0, 0], normal: [0, 1], material: pine}\n"
    path = write(tmp_path / "pine.yaml", text)
    ((where, problem),) = faults(path).items()
    assert where == f"{path}:3:54: scene.objects.t.material"
    assert problem.startswith('unknown material "pine"; ')
    both = write(tmp_path / "both.yaml", text + "servo: {rate_hz: 1}\n")
    assert list(faults(both)) == [f"{both}:4:9: servo.rate_hz"]
    own = write(tmp_path / "own.yaml", text + "materials: {pine: {stiffness_n_per_m: 500}}\n")
    assert load_config(own).materials["pine"].stiffness_n_per_m == 500


def test_faults_of_all_files_are_reported_by_file_and_line(tmp_path: pathlib.Path) -> None:
    first, second = write(tmp_path / "a.yaml", "servo: {\n"), write(tmp_path / "b.yaml", "device: [\n")
    assert [where.partition(":")[0] for where in faults([second, first])] == [str(first), str(second)]
    write(first, "flight: {keep: 0}\nservo: {rate_hz: 1}\n")
    write(second, "device: {max_force_n: -1}\n")
    assert [*faults([second, first])] == [
        f"{first}:1:10: flight.keep",
        f"{first}:2:9: servo.rate_hz",
        f"{second}:1:10: device.max_force_n",
    ]


@pytest.mark.parametrize("text", ["", "- servo\n", "servo\n"])
def test_a_configuration_is_a_mapping(tmp_path: pathlib.Path, text: str) -> None:
    path = write(tmp_path / "c.yaml", text)
    problem = "must be a mapping" if text else "is empty"
    assert faults(path) == {f"{path}:1:1": f"{problem}; known keys: servo, device, materials, scene, flight"}


def test_later_files_override_by_key_but_replace_materials_and_objects(tmp_path: pathlib.Path) -> None:
    first = write(
        tmp_path / "first.yaml",
        """
servo: {rate_hz: 2000, priority: 10}
device: {sim: {hand: {mass_kg: 0.1}, start_m: [0, 0.01]}}
materials:
  a: {stiffness_n_per_m: 1, damping_n_s_per_m: 1}
  b: {stiffness_n_per_m: 2}
scene:
  display: {force: false}
  objects:
    x: {kind: viscous, damping_n_s_per_m: 1}
    y: {kind: wall, point_m: [0, 0], normal: [0, 1], material: a}
""",
    )
    second = write(
        tmp_path / "second.yaml",
        """
servo: {rate_hz: 4000}
device: {sim: {hand: {stiffness_n_per_m: 7}, start_m: [0.01, 0]}}
materials:
  a: {stiffness_n_per_m: 3}
scene:
  display: {vibration: false}
  objects:
    x: {kind: constant, force_n: [1, 0]}
""",
    )
    config = load_config([first, second])
    assert (config.servo.rate_hz, config.servo.priority) == (4000, 10)
    hand = config.device.sim.hand
    assert (hand.mass_kg, hand.stiffness_n_per_m, hand.damping_n_s_per_m) == (0.1, 7, 5)
    assert config.device.sim.start_m == (0.01, 0)
    assert config.materials["a"].to_dict() == {"stiffness_n_per_m": 3, "damping_n_s_per_m": 0}
    assert config.materials["b"].stiffness_n_per_m == 2
    assert (config.scene.display.force, config.scene.display.vibration) == (False, False)
    assert config.scene.objects["x"].to_dict() == {"kind": "constant", "force_n": [1, 0]}
    assert config.scene.objects["y"].kind == "wall"
    assert load_config((str(first),)) == load_config(first)
    assert load_config([]) == load_config({})


def test_faults_name_the_file_that_they_come_from(tmp_path: pathlib.Path) -> None:
    first = write(
        tmp_path / "1.yaml",
        "servo: {rate_hz: 1}\nscene:\n  objects:\n"
        "    t: {kind: wall, point_m: [0, 0], normal: [0, 1], material: wood}\n    u: {kind: viscous}\n",
    )
    second = write(
        tmp_path / "2.yaml",
        "\nservo:\n  priority: 0\nscene:\n  objects:\n    t: {kind: wall, material: wood}\n",
    )
    assert faults(first, second) == {
        f"{first}:1:9: servo.rate_hz": "should be greater than or equal to 1000, is 1",
        f"{second}:3:3: servo.priority": "should be greater than or equal to 1, is 0",
        f"{second}:6:5: scene.objects.t.point_m": "Field required",
        f"{second}:6:5: scene.objects.t.normal": "Field required",
        f"{first}:5:5: scene.objects.u.damping_n_s_per_m": "Field required",
    }


def test_python_values_that_people_use() -> None:
    wall = {
        "kind": "wall",
        "point_m": np.array([0, 0]),
        "normal": (0, np.float32(1)),
        "material": np.str_("wood"),
    }
    data = {"servo": {"rate_hz": np.int64(2000), "cpu": np.int32(1)}, "scene": {"objects": {"t": wall}}}
    config = load_config(data)
    assert config.servo.cpu == 1
    assert config.scene.objects["t"].to_dict() == {**wall, "point_m": [0, 0], "normal": [0, 1], **NO_PATCHES}
    assert type(config.servo.rate_hz) is float
    assert load_config({"scene": config.scene}).scene == config.scene
    assert load_config({"scene": {"display": {"force": np.bool_(False)}}}).scene.display.force is False
    assert load_config(config) is config


@pytest.mark.parametrize(
    ("data", "problem"),
    [
        ({1: 2}, "keys must be strings, this one is 1"),
        ({"servo": {None: 2}}, "servo: keys must be strings, this one is null"),
        ({"scene": {"objects": {"a": {"kind": "constant", "force_n": {0, 1}}}}}, "is not plain data"),
        ({"servo": {"rate_hz": np.array([True])}}, "servo.rate_hz: should be a valid number, is a list"),
        ({"servo": {"rate_hz": np.array(True)}}, "servo.rate_hz: should be a valid number, is true"),
        ({"servo": {"rate_hz": 1j}}, "is not plain data: a Python object of type complex"),
        ({"servo": {"rate_hz": 10**5000}}, "should be a valid number, is an integer of 16610 bits"),
        ({"servo": {"priority": 10**5000}}, "should be less than or equal to 99"),
        ({"servo": None}, "servo: should be a mapping, is null"),
        ({"servo\n" * 100: 1}, "unknown key; known: servo, device, materials, scene, flight"),
        ({"\ud800": 1}, 'as a unicode string, is "\\ud800"'),
    ],
)
def test_python_values_that_are_wrong(data: dict[object, object], problem: str) -> None:
    with pytest.raises(InvalidError) as caught:
        load_config(data)  # type: ignore[arg-type]
    assert problem in str(caught.value)
    assert str(caught.value).isprintable()


def test_a_mapping_that_holds_itself() -> None:
    data: dict[str, object] = {}
    data["servo"] = data
    with pytest.raises(InvalidError, match="nested deeper than 32 levels"):
        load_config(data)


def test_many_faults_are_all_kept_and_shown_in_one_line() -> None:
    objects: Json = {f"o{i}": {"kind": "viscous"} for i in range(200)}
    with pytest.raises(InvalidError) as caught:
        load_config({"scene": {"objects": objects}})
    assert len(caught.value.problems) == 200
    assert str(caught.value).endswith("; and 150 more")


WORDS = [
    "servo",
    "device",
    "materials",
    "scene",
    "objects",
    "display",
    "force",
    "a",
    "wall",
    "spring",
    "viscous",
]
WORDS += [
    "kind",
    "tap",
    "rupture",
    "normal",
    "point_m",
    "material",
    "sim",
    "wood",
    "stiffness_n_per_m",
    "[key]",
    "texture",
    "friction",
    "patches",
    "box",
    "grooves",
]
words = st.sampled_from([*WORDS, "", "a.b"])
json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | words | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(words | st.text(max_size=3), inner, max_size=5),
    max_leaves=30,
)


def sections(inner: st.SearchStrategy[Json]) -> st.SearchStrategy[dict[str, Json]]:
    """Return a strategy for data that is almost valid, so that faults occur at every depth."""
    wall: st.SearchStrategy[Json] = st.fixed_dictionaries(
        {"kind": st.sampled_from(["wall", "membrane", "spring", "box", "disc", "zz"])},
        optional={
            "patches": inner | st.lists(st.dictionaries(words, inner), max_size=2),
            "size_m": inner,
            "point_m": inner,
            "center_m": inner,
            "normal": inner,
            "material": inner,
            "wall": inner,
        },
    )
    texture: st.SearchStrategy[Json] = st.fixed_dictionaries(
        {"kind": st.sampled_from(["grooves", "stochastic", "autoregressive"]) | inner},
        optional={
            "display": st.sampled_from(["vibration", "geometry", "damping"]) | inner,
            "spacing_m": st.just(0.1) | inner,
            "width_m": st.just(0.1) | inner,
            "depth_m": st.just(0.1) | inner,
            "models": inner | st.lists(st.dictionaries(words, inner), max_size=2),
        },
    )
    material: st.SearchStrategy[Json] = st.fixed_dictionaries(
        {"stiffness_n_per_m": st.just(1) | inner},
        optional={
            "tap": inner | st.dictionaries(words, inner),
            "rupture": inner | st.dictionaries(words, inner),
            "friction": inner,
            "texture": inner | texture,
        },
    )
    return st.fixed_dictionaries(
        {},
        optional={
            "servo": inner,
            "device": st.fixed_dictionaries({}, optional={"sim": inner, "kind": inner}),
            "materials": st.dictionaries(words, material, max_size=2),
            "scene": st.fixed_dictionaries({}, optional={"objects": st.dictionaries(words, wall, max_size=3)}),
        },
    )


@pytest.mark.long
@settings(max_examples=100)
@given(sections(json_values) | st.dictionaries(words, json_values))
def test_any_data_is_accepted_or_refused(data: dict[str, Json]) -> None:
    try:
        config = load_config(data)
    except InvalidError as error:
        assert error.problems
        assert str(error).isprintable()
    else:
        assert load_config(config.to_dict()) == config


# ---- what ships -----------------------------------------------------------------------------------

SHIPPED_FOLDER = resources.files("hapticd.shipped")
SHIPPED = [
    f"{below}{file.name}"
    for below, folder in (
        ("", SHIPPED_FOLDER),
        ("materials/", SHIPPED_FOLDER.joinpath("materials")),
        ("scenes/", SHIPPED_FOLDER.joinpath("scenes")),
    )
    for file in folder.iterdir()
    if file.name.endswith(".yaml")
]


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_files_are_valid(name: str) -> None:
    data = shipped_document(name).data
    assert isinstance(data, dict)
    config = load_config(data)
    assert load_config(config.to_dict()) == config
    if name.startswith("scenes/"):
        assert load_scene(data) == config.scene
        assert config.scene.objects


@pytest.mark.parametrize("name", [file.name for file in SHIPPED_FOLDER.joinpath("operators").iterdir()])
def test_shipped_operators_are_valid_and_stay_in_the_workspace(name: str) -> None:
    operator = parse_operator(mapping(shipped_document(f"operators/{name}").data))
    assert operator.waypoints is not None
    assert all(max(abs(x), abs(y)) <= Sim().workspace_m for _, x, y in operator.waypoints)


def test_default_configuration() -> None:
    config = default_config()
    assert config.device.kind == "sim"
    (floor,) = config.scene.objects.values()
    assert floor.to_dict() == {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood", **NO_PATCHES}
    assert set(config.materials) == set(shipped_materials())
    assert default_config() is config


def test_materials_of_a_configuration_replace_shipped_ones_completely() -> None:
    config = load_config({"materials": {"wood": {"stiffness_n_per_m": 5}}})
    assert config.materials["wood"].tap is None
    assert config.materials["steel"] == shipped_materials()["steel"]
    assert shipped_materials()["wood"].tap is not None


# ---- schema and reference -------------------------------------------------------------------------


def test_schema_is_plain_json_with_words_and_units() -> None:
    schema = config_schema()
    assert json.loads(json.dumps(schema, allow_nan=False)) == schema
    assert set(mapping(schema["properties"])) == {"servo", "device", "materials", "scene", "flight"}
    for name, model in models().items():
        assert model["description"], name
        assert model["additionalProperties"] is False
        for key, described in mapping(model["properties"]).items():
            assert mapping(described)["title"] == key
            assert key == "kind" or mapping(described)["description"], f"{name}.{key}"
    stiffness = mapping(mapping(models()["Material"]["properties"])["stiffness_n_per_m"])
    assert stiffness["description"] == "Normal force per penetration depth or deflection. In N/m."
    assert (stiffness["minimum"], stiffness["maximum"]) == (0, 1e5)


@pytest.mark.parametrize(
    ("key", "unit"),
    [
        ("stiffness_n_per_m", "N/m"),
        ("damping_n_s_per_m", "N s/m"),
        ("angular_frequency_rad_per_s", "rad/s"),
        ("amplitude_m_per_s2", "m/s^2"),
        ("max_speed_m_per_s", "m/s"),
        ("decay_rate_per_s", "1/s"),
        ("force_gain_m_per_s2_per_n", "m/s^2/N"),
        ("variance_m2_per_s4", "m^2/s^4"),
        ("angle_rad", "rad"),
        ("ramp_s", "s"),
        ("depth_m", "m"),
        ("force_n", "N"),
        ("mass_kg", "kg"),
        ("rate_hz", "Hz"),
        ("spin_us", "us"),
        ("counts_per_n", "1/N"),
        ("frequency_per_force_hz_per_n", "Hz/N"),
        ("frequency_per_speed_hz_s_per_m", "Hz s/m"),
        ("max_strain", None),
        ("heals", None),
    ],
)
def test_units(key: str, unit: str | None) -> None:
    assert unit_of(key) == unit


@pytest.mark.parametrize("page", ["materials.md", "howto/materials.md"])
def test_the_examples_of_materials_are_valid(page: str) -> None:
    examples = re.findall(r"^```yaml\n(.*?)^```", (DOCS / page).read_text(), re.M | re.S)
    assert examples
    for example in examples:
        data = load_text(example, page).data
        assert isinstance(data, dict)
        load_config(data)


def test_errors_are_of_one_family() -> None:
    assert issubclass(InvalidError, HapticdError)
    assert Scene.__name__ in Model.by_name
    assert Config.__name__ in Model.by_name
