"""What a device and a rate make of a scene: muted, lowered, refused, warned of."""

import math

import numpy as np
import pytest
from scipy import signal
from scipy.integrate import trapezoid

from hapticd.base.errors import Problem
from hapticd.base.lattice import coefficients_of, reflection_of
from hapticd.base.yaml_source import Json
from hapticd.config.materials import Material, Mode, validate_materials
from hapticd.config.scene import SceneObject, validate_scene
from hapticd.config.texture import Stochastic
from hapticd.rendering.device_output import Output
from hapticd.rendering.displayability import (
    DISPLAYABLE_RATE_FRACTION,
    displayed_mode,
    displayed_pair,
    rate_faults,
    undisplayable,
    warnings,
)
from hapticd.rendering.filter_design import stochastic_filter
from hapticd.rendering.resampling import resampled
from hapticd.rendering.undisplayable_text import Undisplayable

Keys = dict[str, Json]

WALL: Keys = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1]}
MODE: Keys = {"frequency_hz": 200, "decay_time_s": 0.003}
STRIKES: Keys = {
    "kind": "grooves",
    "display": "vibration",
    "spacing_m": 0.002,
    "width_m": 0.0005,
    "velocity_gain_per_s": 1,
}
GRIT: Keys = {"kind": "stochastic", "peak_hz": 160, "mean_hz": 210, "velocity_gain_per_s": 24}


def output(rate_hz: float = 1000, rest: str = "mute", link_rate_hz: float | None = None) -> Output:
    assert rest in ("mute", "lower")
    return Output(rate_hz, 0.05, 8.9, 5.0, "mute" if rest == "mute" else "lower", link_rate_hz)


def library(**materials: Keys) -> dict[str, Material]:
    return validate_materials({name: {"stiffness_n_per_m": 800, **keys} for name, keys in materials.items()})


def objects(**materials: str) -> dict[str, SceneObject]:
    return scene(**{id: {**WALL, "material": material} for id, material in materials.items()})


def scene(**objects: Keys) -> dict[str, SceneObject]:
    return validate_scene({"objects": objects}).objects


def told(texture: Keys, out: Output) -> dict[str, str]:
    """Warnings of a scene with one wall of one material, by place."""
    found = warnings(objects(a="m"), library(m={"texture": texture}), out)
    return {problem.where.removeprefix("materials.m.texture."): problem.problem for problem in found}


# ---- muted and lowered ----------------------------------------------------------------------------


def test_modes_at_0_4_of_the_rate_are_the_last_that_are_shown() -> None:
    last = Mode(100, 2 * math.pi * 400)
    assert displayed_mode(last, output()) == (last, 1)
    above = Mode(100, 2 * math.pi * 400 * 1.001)
    assert displayed_mode(above, output()) == (None, 1)
    lowered, factor = displayed_mode(above, output(rest="lower"))
    assert lowered is not None
    assert lowered.decay_rate_per_s == 100
    assert lowered.frequency_hz == pytest.approx(DISPLAYABLE_RATE_FRACTION * 1000, rel=1e-15)
    assert factor * lowered.peak == pytest.approx(above.peak, rel=1e-15)


def test_undisplayable_modes_by_use() -> None:
    high: Keys = {"frequency_hz": 500, "decay_time_s": 0.003}
    materials = library(
        fine={"tap": {"attack_slope_per_s": 1, **MODE}, "texture": {**STRIKES, **MODE}},
        tapped={"tap": {"attack_slope_per_s": 1, **high}},
        skin={"rupture": {"amplitude_m_per_s2": 38, "depth_m": 0.004, **high}},
        comb={"texture": {**STRIKES, **high}},
        both={"tap": {"attack_slope_per_s": 1, **high}, "texture": STRIKES},
        grit={"texture": {**GRIT, "peak_hz": 450, "mean_hz": 460}},
    )
    uses = [("tapped", "tap"), ("skin", "rupture"), ("comb", "groove"), ("both", "tap"), ("both", "groove")]
    for rest, shown in (("mute", None), ("lower", pytest.approx(400, rel=1e-15))):
        found = undisplayable(materials, output(rest=rest))
        assert [(each.material, each.mode) for each in found] == [*uses, ("grit", "texture")]
        assert all(each.shown_hz == shown for each in found)
        assert found[-1].frequency_hz == 450
    assert undisplayable(materials, output(10_000)) == []
    assert undisplayable({}, output()) == []


def test_peak_and_mean_of_a_texture_are_lowered_together() -> None:
    texture = library(m={"texture": {**GRIT, "peak_hz": 450, "mean_hz": 480}})["m"].texture
    assert isinstance(texture, Stochastic)
    assert displayed_pair(texture, output()) is None
    assert displayed_pair(texture, output(rest="lower")) == pytest.approx((400, 480 * 400 / 450), rel=1e-15)
    assert displayed_pair(texture, output(1125)) == (450, 480)
    assert undisplayable(library(m={"texture": texture.to_dict()}), output(rest="lower")) == [
        Undisplayable("m", "texture", 450, 400)
    ]


# ---- refused --------------------------------------------------------------------------------------


def test_a_texture_beyond_half_the_rate_is_refused() -> None:
    materials = library(
        high={"texture": {**GRIT, "peak_hz": 600, "mean_hz": 500}},
        mean={"texture": {**GRIT, "mean_hz": 500}},
        fine={"texture": {**GRIT, "mean_hz": 499}},
        idle={"texture": {**GRIT, "peak_hz": 3000}},
    )
    used = objects(a="high", b="mean", c="fine", d="mean")
    assert rate_faults(used, materials, output()) == [
        Problem("materials.high.texture.peak_hz", "must be less than half the servo rate of 1000 Hz, is 600"),
        Problem("materials.high.texture.mean_hz", "must be less than half the servo rate of 1000 Hz, is 500"),
        Problem("materials.mean.texture.mean_hz", "must be less than half the servo rate of 1000 Hz, is 500"),
    ]
    assert rate_faults(used, materials, output(10_000)) == []
    assert rate_faults(used, materials, output(rest="lower")) == rate_faults(used, materials, output())
    assert warnings(objects(a="high"), materials, output()) == []


def test_the_material_of_a_patch_is_used_too() -> None:
    materials = library(plain={}, bad={"texture": {**GRIT, "peak_hz": 600}})
    patched = scene(t={**WALL, "material": "plain", "patches": [{"from_m": 0, "to_m": 1, "material": "bad"}]})
    assert [problem.where for problem in rate_faults(patched, materials, output())] == ["materials.bad.texture.peak_hz"]
    assert rate_faults(objects(a="plain"), materials, output()) == []


# ---- warned of ------------------------------------------------------------------------------------


def test_grooves_nearer_than_a_ticks_travel() -> None:
    found = told({**STRIKES, **MODE}, output())
    assert found == {
        "spacing_m": "0.002 is less than the probe may travel in a tick, 0.005 at the device's max_speed_m_per_s; "
        "up to 2 m/s it passes at most one groove in a tick"
    }
    assert told({**STRIKES, **MODE}, output(2500)) == {}  # 5 m/s over 2500 Hz: exactly a spacing


@pytest.mark.parametrize(
    "keys", [{"display": "geometry", "depth_m": 1e-4}, {"display": "damping", "damping_n_s_per_m": 3}]
)
def test_narrow_grooves(keys: Keys) -> None:
    grooves: Keys = {"kind": "grooves", "spacing_m": 0.01, "width_m": 0.001, **keys}
    assert told(grooves, output()) == {}  # 0.5 m/s over 1 kHz: half a width in a tick
    assert told({**grooves, "width_m": 0.0008}, output()) == {
        "width_m": "0.0008 is passed in less than two ticks at 0.5 m/s, too fast for its shape to be displayed; "
        "must be at least 0.001"
    }
    assert told({**grooves, "width_m": 0.0008}, output(1250)) == {}
    # A spacing that is less than a tick's travel means something for strikes only.
    assert told({**grooves, "spacing_m": 0.004}, output()) == {}


def test_strikes_do_not_mind_narrow_grooves() -> None:
    assert told({**STRIKES, **MODE, "spacing_m": 0.01, "width_m": 1e-6}, output()) == {}


def test_a_pair_that_is_not_met_is_named_as_shown() -> None:
    assert told(GRIT, output()) == {}
    shown = stochastic_filter(300, 100, 1000)
    assert not shown.met(300, 100)
    assert told({**GRIT, "peak_hz": 300, "mean_hz": 100}, output()) == {
        "mean_hz": "a peak of 300 Hz and a mean of 100 Hz cannot both be reached at 1000 Hz; "
        f"shown are {shown.peak_hz:.4g} Hz and {shown.mean_hz:.4g} Hz"
    }


def test_a_muted_texture_causes_no_warning() -> None:
    assert told({**GRIT, "peak_hz": 450, "mean_hz": 100}, output()) == {}
    assert list(told({**GRIT, "peak_hz": 450, "mean_hz": 100}, output(rest="lower"))) == ["mean_hz"]


def poles(radius: float, angle: float) -> list[float]:
    return [-2 * radius * math.cos(angle), radius**2]


def test_lost_power_is_reported_for_the_worst_model() -> None:
    """The fraction above half the servo rate, integrated over scipy's spectrum."""
    rate_hz, shown_hz = 5000.0, 2000.0
    radius, angle = 0.9, 2 * math.pi * 900 / rate_hz
    quiet, loud = poles(0.9, 0.1), poles(radius, angle)
    texture: Keys = {
        "kind": "autoregressive",
        "rate_hz": rate_hz,
        "models": [
            {"speed_m_per_s": 0.1, "force_n": force, "coefficients": list[Json](a), "rms_m_per_s2": 1}
            for force, a in ((1, quiet), (2, loud), (3, quiet))
        ],
    }
    w, h = signal.freqz([1], [1, *loud], worN=200_001, include_nyquist=True)
    power = np.abs(h) ** 2
    kept = w <= math.pi * shown_hz / rate_hz
    lost = 1 - trapezoid(power[kept], w[kept]) / trapezoid(power, w)
    assert lost > 0.01
    ((where, problem),) = told(texture, output(shown_hz)).items()
    assert where == "models[1]"
    assert problem.startswith("loses ")
    assert float(problem.split()[1]) == pytest.approx(100 * lost, rel=0.01)
    assert problem.endswith(" % of its power at a rate of 2000 Hz, more than any other model")
    models = texture["models"]
    assert isinstance(models, list)
    alone = told({**texture, "models": models[1:2]}, output(shown_hz))
    assert alone == {"models[0]": problem.removesuffix(", more than any other model")}
    assert told(texture, output(5000)) == told(texture, output(10_000)) == {}


def test_a_small_loss_is_not_reported() -> None:
    texture: Keys = {
        "kind": "autoregressive",
        "rate_hz": 5000,
        "models": [{"speed_m_per_s": 0, "force_n": 0, "coefficients": [*poles(0.97, 0.2)], "rms_m_per_s2": 1}],
    }
    w, h = signal.freqz([1], [1, *poles(0.97, 0.2)], worN=200_001, include_nyquist=True)
    power = np.abs(h) ** 2
    assert trapezoid(power[w > math.pi * 0.8], w[w > math.pi * 0.8]) < 0.01 * trapezoid(power, w)
    assert told(texture, output(4000)) == {}


def test_a_deviating_spectrum_is_reported_with_its_error() -> None:
    """Sixteen sharp resonances below 500 Hz, shown at ten times their rate with 32 coefficients; scipy's spectra."""
    angles = np.linspace(0.2, 2.9, 16)
    roots = 0.985 * np.exp(1j * angles)
    a = np.poly(np.concatenate((roots, roots.conj()))).real
    model = {"speed_m_per_s": 0.1, "force_n": 1, "coefficients": [float(each) for each in a[1:]], "rms_m_per_s2": 1}
    easy = {**model, "force_n": 2, "coefficients": list[Json](poles(0.8, 0.3))}
    texture: Keys = {"kind": "autoregressive", "rate_hz": 1000, "models": [easy, model]}
    ((where, problem),) = told(texture, output(10_000)).items()
    assert where == "models[1]"
    shown = coefficients_of(resampled(reflection_of(a[1:].tolist()), 1e3, 1e4).reflection)
    density = []
    for each, rate in ((a[1:], 1e3), (shown, 1e4)):
        frequency, response = signal.freqz([1], [1, *each], worN=np.linspace(0, rate / 2, 500_001), fs=rate)
        power = np.abs(response) ** 2 / trapezoid(np.abs(response) ** 2, frequency)
        density.append(10 * np.log10(np.interp(np.linspace(0, 499.9, 50_001), frequency, power)))
    off = np.abs(density[1] - density[0])[density[0] >= density[0].max() - 30].max()
    assert off > 3
    assert float(problem.split(" dB")[0].split()[-1]) == pytest.approx(off, rel=0.05)
    assert problem.endswith(" dB at a rate of 10000 Hz, more than any other model")
    alone = told({**texture, "models": [model]}, output(10_000))
    assert alone == {"models[0]": problem.removesuffix(", more than any other model")}
    assert told(texture, output(1000)) == {}


# ---- behind a link --------------------------------------------------------------------------------


@pytest.mark.parametrize("rest", ["mute", "lower"])
def test_behind_a_link_its_rate_counts_if_it_is_lower(rest: str) -> None:
    slow, linked = output(1000, rest), output(10_000, rest, 1000)
    materials = library(
        tapped={"tap": {"attack_slope_per_s": 1, "frequency_hz": 500, "decay_time_s": 0.003}},
        low={"tap": {"attack_slope_per_s": 1, "frequency_hz": 399, "decay_time_s": 0.003}},
        grit={"texture": {**GRIT, "peak_hz": 450, "mean_hz": 460}},
    )
    assert [(each.material, each.frequency_hz) for each in undisplayable(materials, linked)] == [
        ("tapped", pytest.approx(500)),
        ("grit", 450),
    ]
    assert undisplayable(materials, linked) == undisplayable(materials, slow)
    for frequency_hz in (399, 401, 3999, 4001):
        mode = Mode(100, 2 * math.pi * frequency_hz)
        assert displayed_mode(mode, linked) == displayed_mode(mode, slow)
        fast = output(10_000, rest, 20_000)
        assert displayed_mode(mode, fast) == displayed_mode(mode, output(10_000, rest))
    # A filter runs at the rate of the servo: frequencies from half of it on are refused.
    high = library(m={"texture": {**GRIT, "peak_hz": 600, "mean_hz": 700}})
    assert rate_faults(objects(a="m"), high, linked) == []


def test_grooves_behind_a_link_are_passed_in_frames() -> None:
    grooves: Keys = {"kind": "grooves", "spacing_m": 0.01, "width_m": 0.0008, "display": "geometry", "depth_m": 1e-4}
    for texture in ({**STRIKES, **MODE}, grooves):
        slow, linked = told(texture, output()), told(texture, output(10_000, link_rate_hz=1000))
        assert linked == {
            key: text.replace("ticks", "frames of the link").replace("tick", "frame of the link")
            for key, text in slow.items()
        }
        assert slow
        assert told(texture, output(10_000, link_rate_hz=10_000)) == {}


def above(coefficients: list[float], from_hz: float, rate_hz: float) -> float:
    """The fraction of an all-pole filter's power above a frequency, integrated over scipy's spectrum."""
    frequency, h = signal.freqz([1], [1, *coefficients], worN=400_001, include_nyquist=True, fs=rate_hz)
    power = np.abs(h) ** 2
    high = frequency >= from_hz
    return float(trapezoid(power[high], frequency[high]) / trapezoid(power, frequency))


@pytest.mark.parametrize("link_hz", [1000.0, 500.0])
def test_noise_above_the_range_of_a_link_is_reported(link_hz: float) -> None:
    shown = stochastic_filter(160, 210, 10_000)
    assert shown.taps is None
    lost = above(list(coefficients_of(shown.reflection)), 0.4 * link_hz, 10_000)
    assert lost > 0.01
    (text,) = told(GRIT, output(10_000, link_rate_hz=link_hz)).values()
    assert text == (
        f"has {100 * lost:.3g} % of its power above {0.4 * link_hz:g} Hz, which the link's {link_hz:.4g} Hz "
        "cannot carry"
    )
    assert told(GRIT, output(10_000)) == told(GRIT, output(10_000, link_rate_hz=10_000)) == {}


def test_power_above_the_range_of_a_link_is_reported_for_the_worst_model() -> None:
    rate_hz = 5000.0
    low, high = poles(0.98, 2 * math.pi * 100 / rate_hz), poles(0.98, 2 * math.pi * 480 / rate_hz)
    texture: Keys = {
        "kind": "autoregressive",
        "rate_hz": rate_hz,
        "models": [
            {"speed_m_per_s": 0.1, "force_n": force, "coefficients": list[Json](a), "rms_m_per_s2": 1}
            for force, a in ((1, low), (2, high), (3, low))
        ],
    }
    ((where, problem),) = told(texture, output(rate_hz, link_rate_hz=1000)).items()
    assert where == "models[1]"
    assert float(problem.split()[1]) == pytest.approx(100 * above(high, 400, rate_hz), rel=0.01)
    assert problem.endswith("more than any other model")
    assert told(texture, output(rate_hz)) == {}


def test_narrow_patches_and_gaps() -> None:
    materials = library(plain={}, other={})

    def patch(from_m: float, to_m: float) -> Keys:
        return {"from_m": from_m, "to_m": to_m, "material": "other"}

    def found(*patches: Keys, **keys: Json) -> list[Problem]:
        wall: Keys = {**WALL, "material": "plain", "patches": list[Json](patches), **keys}
        return warnings(scene(table=wall), materials, output())

    narrow = "patch_ramp_m, 0.001; the ramps between are narrowed"
    assert found(patch(0, 0.001), patch(0.001, 0.002), patch(0.003, 0.1)) == []
    assert found(patch(0.5, 0.6), patch(0, 0.0005)) == [
        Problem("scene.objects.table.patches[1]", f"is 0.0005 wide, narrower than {narrow}")
    ]
    assert found(patch(0.1003, 0.2), patch(0, 0.1)) == [
        Problem("scene.objects.table.patches[0]", f"is 0.0003 from patches[1], nearer than {narrow}")
    ]
    assert found(patch(0, 0.0005), patch_ramp_m=0.0005) == []


def test_only_used_materials_are_reported_and_once() -> None:
    materials = library(comb={"texture": {**STRIKES, **MODE}}, idle={"texture": {**STRIKES, **MODE}})
    box: Keys = {"kind": "box", "center_m": [0, 0], "size_m": [0.01, 0.01], "material": "comb"}
    many = scene(**{f"o{i}": box for i in range(1000)})
    assert [problem.where for problem in warnings(many, materials, output())] == ["materials.comb.texture.spacing_m"]
    assert warnings({}, materials, output()) == []
