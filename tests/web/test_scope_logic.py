"""The computations of the oscilloscope: its modules, imported in a browser without a daemon, with made-up samples."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from playwright.sync_api import Browser, Page, Route

from hapticd.config.materials import shipped_materials
from hapticd.web.application import STATIC_FOLDER

pytestmark = pytest.mark.slow

ORIGIN = "http://page.test"
# A store with the interface of samples.js, which tests fill.
STORE = """
const NAMES = ["x_m", "y_m", "vx_m_per_s", "vy_m_per_s", "contact_x_n", "contact_y_n", "vibration_x_n", "vibration_y_n",
               "force_x_n", "force_y_n"];
export class Store {
  constructor(capacity, periodS = 1e-4) {
    Object.assign(this, { capacity, periodS, rows: 0, tick: 0, now: 0 });
    this.columns = { time_s: new Float64Array(capacity) };
    for (const name of NAMES) this.columns[name] = new Float64Array(capacity);
    this.ticks = new Float64Array(capacity);
    this.leftOut = new Set();
  }
  leftOutBefore(row) { return this.leftOut.has(row); }
  get first() { return Math.max(0, this.rows - this.capacity); }
  // One row for each map of `rows`; before the first of them `skip` periods were missed, `lost` samples were lost and
  // `pause` samples left out on purpose.
  add(rows, { skip = 0, lost = 0, pause = 0 } = {}) {
    this.tick += lost + pause;
    this.now += skip + lost + pause;
    if (pause > 0) this.leftOut.add(this.rows);
    for (const row of rows) {
      const at = this.rows++ % this.capacity;
      for (const name of NAMES) this.columns[name][at] = row[name] ?? 0;
      this.columns.time_s[at] = this.now++ * this.periodS;
      this.ticks[at] = this.tick++;
    }
    return this;
  }
}
export const flat = (count, value = {}) => Array.from({ length: count }, () => value);
"""
TYPES = {".js": "text/javascript", ".mjs": "text/javascript", ".css": "text/css", ".html": "text/html"}


@pytest.fixture(scope="module")
def modules(browser: Browser) -> Iterator[Page]:
    """Open an empty page of an origin that serves only the static files."""

    def answer(route: Route) -> None:
        path = route.request.url.removeprefix(ORIGIN)
        if path == "/":
            styles = "".join(f'<link rel="stylesheet" href="/static/{name}.css">' for name in ("style", "scope"))
            route.fulfill(body=f"<!doctype html>{styles}<body></body>", content_type="text/html")
        elif path == "/store.js":
            route.fulfill(body=STORE, content_type="text/javascript")
        else:
            file = STATIC_FOLDER / path.removeprefix("/static/")
            route.fulfill(body=file.read_bytes(), content_type=TYPES[Path(file).suffix])

    page = browser.new_page()
    page.route(f"{ORIGIN}/**", answer)
    page.goto(f"{ORIGIN}/")
    yield page
    page.close()


def run(page: Page, names: str, body: str, argument: object = None) -> Any:
    """Run `body` in a function with the imports `names`, as `name, name from file; ...`, and the argument `given`."""
    imports = ""
    for entry in names.split(";"):
        what, _, file = entry.strip().rpartition(" from ")
        address = "/store.js" if file == "store" else f"/static/scope/{file}.js"
        imports += f"const {{ {what} }} = await import('{address}');\n"
    return page.evaluate(f"async (given) => {{ {imports} {body} }}", argument)


# ---- Extremes, columns, gaps -------------------------------------------------------------------------------------


def test_extremes_are_those_of_all_samples_also_around_the_ring(modules: Page) -> None:
    wrong = run(
        modules,
        "Pyramid from pyramid",
        """
        const capacity = 5000, column = new Float64Array(capacity), pyramid = new Pyramid(column);
        const start = 8 ** 8 - 3000;  // rows are counted on from there in another way
        let rows = start, seed = 7, wrong = 0;
        const random = () => (seed = (seed * 1103515245 + 12345) % 2147483648) / 2147483648;
        for (const batch of [3, 197, 1000, 1, 6000, 4097, 12, 5000, 777]) {
          for (let i = 0; i < batch; i++) column[rows++ % capacity] = random() < 0.01 ? NaN : random() - 0.5;
          const first = Math.max(start, rows - capacity);
          pyramid.extend(first, rows);
          for (let k = 0; k < 60; k++) {
            const a = first + Math.floor(random() * (rows - first));
            const b = a + Math.floor(random() * (rows - a + 1));
            let low = Infinity, high = -Infinity;
            for (let row = a; row < b; row++) {
              const value = column[row % capacity];
              if (value < low) low = value;
              if (value > high) high = value;
            }
            pyramid.range(a, b);
            wrong += pyramid.low !== low || pyramid.high !== high;
          }
        }
        return wrong;
        """,
    )
    assert wrong == 0


@pytest.mark.parametrize("at", [0, 1, 299_999, 511_998, 599_999])
def test_a_single_sample_of_a_minute_is_seen(modules: Page, at: int) -> None:
    seen = run(
        modules,
        "Store from store; Source from source; Columns, Raster, drawTrace, pixelOf from trace_drawing",
        """
        const store = new Store(600000);
        store.add(Array.from({ length: 600000 }, (_, i) => (i === given ? { force_y_n: 1 } : {})));
        const source = new Source(store);
        source.update();
        const canvas = document.createElement("canvas");
        [canvas.width, canvas.height] = [613, 100];
        const ctx = canvas.getContext("2d", { willReadFrequently: true });
        const columns = new Columns();
        columns.prepare(source, source.newest - 60, 60.0001, 613);
        const raster = new Raster();
        raster.begin(613, 100);
        const style = { color: "#ff0000", pixel: pixelOf("#ff0000"), width: 1, left: source.newest - 60 };
        style.widthS = 60.0001;
        const box = { left: 0, top: 0, width: 613, height: 100 };
        drawTrace(ctx, raster, source, source.track("force_y"), columns, box, { low: -0.1, high: 1.1 }, 1, style);
        raster.draw(ctx, 0, 0);
        const { data } = ctx.getImageData(0, 5, 613, 10);
        let painted = 0;
        for (let k = 0; k < data.length; k += 4) painted += data[k] === 255 && data[k + 1] === 0 && data[k + 3] === 255;
        return [columns.raw, painted];
        """,
        at,
    )
    assert seen[0] is False
    assert seen[1] > 0


def test_missed_periods_and_lost_samples_are_gaps(modules: Page) -> None:
    found = run(
        modules,
        "Store, flat from store; Source from source; Columns from trace_drawing",
        """
        const store = new Store(100000);
        store.add(flat(30000)).add(flat(20000), { skip: 1 }).add(flat(10000), { lost: 5000 });
        const source = new Source(store);
        source.update();
        const columns = new Columns();
        columns.prepare(source, 0, 6.6, 660);
        const marked = [];
        columns.gaps.forEach((gap, c) => gap && marked.push(c));
        return { marked, rows: [source.gaps[30000], source.gaps[50000]], sum: source.gaps.reduce((a, b) => a + b, 0) };
        """,
    )
    assert found["rows"] == [1, 1] and found["sum"] == 2
    # 3.0 s: one period; 5.0001 to 5.5001 s: half a second, of 10 ms a column
    assert found["marked"][0] == 300
    assert found["marked"][1:] == list(range(501, 551)) or found["marked"][1:] == list(range(500, 551))


def shaded(page: Page, store: str, left: float, width: float) -> list[int]:
    """Return the columns of pixels, 10 ms each, that are shaded as missed or lost in a window of this store."""
    return list(
        run(
            page,
            "Store, flat from store; Source from source; Columns from trace_drawing",
            f"""
            const store = {store}, source = new Source(store), columns = new Columns();
            source.update();
            columns.prepare(source, given[0], given[1], Math.round(100 * given[1]));
            return [...columns.gaps.keys()].filter((c) => columns.gaps[c] === 1);
            """,
            [left, width],
        )
    )


def test_time_before_the_first_sample_is_not_shaded(modules: Page) -> None:
    # Samples from 3.0 s on. A period was missed at 3.005 s, within the first column that has samples.
    store = "new Store(100000).add(flat(50), { skip: 30000 }).add(flat(9949), { skip: 1 })"
    assert shaded(modules, store, 0.0, 4.0) == [300]
    # The ring has no samples before 3.0 s any more, nor the gap at its beginning.
    forgotten = "new Store(1000).add(flat(29000)).add(flat(1000), { lost: 1000 })"
    assert shaded(modules, forgotten, 2.0, 2.0) == []


def test_what_was_left_out_on_purpose_is_not_shaded_and_what_was_lost_is(modules: Page) -> None:
    pause = "new Store(100000).add(flat(1000)).add(flat(1000), { pause: 3000 })"
    assert shaded(modules, pause, 0.0, 0.5) == []
    lost = "new Store(100000).add(flat(1000)).add(flat(1000), { lost: 3000 })"
    assert shaded(modules, lost, 0.0, 0.5) == list(range(10, 41))
    assert shaded(modules, lost, 0.15, 0.1) == list(range(10))  # a window within the gap


def test_a_slower_or_restarted_servo_causes_no_lasting_gaps(modules: Page) -> None:
    found = run(
        modules,
        "Store, flat from store; Source from source",
        """
        const store = new Store(100000, 1e-4);
        const source = new Source(store);
        store.add(flat(1000));
        source.update();
        for (let k = 0; k < 1000; k++) store.add(flat(1), { skip: 9 });  // 1 kHz from here on
        source.update();
        const slower = [source.periodS, source.gaps.subarray(1000, 2000).reduce((a, b) => a + b, 0)];
        store.tick = 0;  // a daemon that was started again
        store.add(flat(500), { skip: 20000 });
        source.update();
        const row = source.rowOfTick(10);
        return { slower, row, kept: source.time[row] > 3, ahead: source.rowOfTick(700) };
        """,
    )
    assert found["slower"][0] == pytest.approx(1e-3)
    assert found["slower"][1] <= 10
    assert found["row"] == 2010 and found["kept"]
    assert found["ahead"] == -1


def test_what_is_zoomed_in_is_raw_samples(modules: Page) -> None:
    raw = run(
        modules,
        "Store, flat from store; Source from source; Columns from trace_drawing",
        """
        const source = new Source(new Store(20000).add(flat(20000)));
        source.update();
        return [0.02, 0.1, 1].map((width) => {
          const columns = new Columns();
          columns.prepare(source, 0.5, width, 700);
          return [columns.raw, columns.to - columns.from];
        });
        """,
    )
    assert [each[0] for each in raw] == [True, True, False]
    assert 200 <= raw[0][1] <= 203


# ---- Trigger -----------------------------------------------------------------------------------------------------

TRIGGER = "Store, flat from store; Source from source; Trigger, Acquisition from trigger; ViewWindow from view_window"


def test_an_event_waits_for_its_sample_and_is_shown_at_its_onset(modules: Page) -> None:
    found = run(
        modules,
        TRIGGER,
        """
        const store = new Store(50000), source = new Source(store), view = new ViewWindow(), trigger = new Trigger();
        const acquisition = new Acquisition(trigger, view);
        trigger.source = "contact";
        acquisition.mode = "normal";
        view.setWidth(0.1);
        source.update();
        acquisition.restart(source);
        const step = (count) => { store.add(flat(count)); source.update(); return acquisition.update(source); };
        const seen = [step(200)];
        trigger.add({ event: "release", tick: 210 });
        trigger.add({ event: "contact", tick: 305, appeared: true });
        trigger.add({ event: "contact", tick: 300, before_tick_s: 4e-5 });
        seen.push(step(50), step(60));  // its tick comes with the second of these
        const at = { time: view.trigger, left: view.left, zero: view.zero, state: acquisition.state };
        trigger.add({ event: "contact", tick: 600 });  // in the window of the first: it is part of that picture
        seen.push(step(800));
        const done = acquisition.state;
        trigger.add({ event: "contact", tick: 1200, before_tick_s: 0 });
        seen.push(step(200), step(1));
        return { seen, at, done, next: view.trigger };
        """,
    )
    assert found["seen"] == [False, False, True, False, True, False]
    assert found["at"]["time"] == pytest.approx(300e-4 - 4e-5, abs=1e-12)
    assert found["at"]["left"] == pytest.approx(0.03 - 4e-5 - 0.02, abs=1e-12)
    assert found["at"]["zero"] == found["at"]["time"]
    assert found["at"]["state"] == "filling" and found["done"] == "complete"
    assert found["next"] == pytest.approx(0.12)


def test_a_level_is_passed_once_for_each_swing_beyond_the_hysteresis(modules: Page) -> None:
    values = [0, 0, 0.4, 0.62, 0.48, 0.55, 0.2, 0.9, 0.9, -1, 0.5, 0.1]
    script = """
        const store = new Store(1000), source = new Source(store), trigger = new Trigger();
        const { rising } = given;
        Object.assign(trigger, { source: "level", channel: "force_y", level: 0.5, hysteresis: 0.1, rising });
        source.update();
        trigger.restart(source);
        store.add(given.values.map((value) => ({ force_y_n: value })));
        source.update();
        const times = [];
        for (let found; (found = trigger.find(source, -1)); ) times.push(found.time * 1e4);
        return times;
        """
    rising = run(modules, TRIGGER, script, {"values": values, "rising": True})
    # From 0.4 to 0.62; 0.48 to 0.55 is within the hysteresis; 0.2 to 0.9; at 0.5 itself.
    assert rising == pytest.approx([2 + 0.1 / 0.22, 6 + 0.3 / 0.7, 10.0])
    falling = run(modules, TRIGGER, script, {"values": values, "rising": False})
    assert falling == pytest.approx([3 + 0.12 / 0.14, 8 + 0.4 / 1.9])


def test_single_holds_and_auto_continues_without_triggers(modules: Page) -> None:
    found = run(
        modules,
        TRIGGER,
        """
        const run = (mode) => {
          const store = new Store(100000), source = new Source(store), view = new ViewWindow(), trigger = new Trigger();
          const acquisition = new Acquisition(trigger, view);
          Object.assign(trigger, { source: "level", channel: "force_y", level: 0.5, hysteresis: 0.1 });
          acquisition.mode = mode;
          view.setWidth(0.1);
          source.update();
          acquisition.restart(source);
          const step = (rows) => {
            store.add(rows); source.update(); acquisition.update(source);
            return acquisition.state;
          };
          const states = [step(flat(100)), step(flat(10, { force_y_n: 1 })), step(flat(1000)), step(flat(1000)),
                          step(flat(10, { force_y_n: 1 })), step(flat(40000)), step(flat(1))];
          return [states, view.trigger === null ? null : view.trigger * 1e4];
        };
        return { single: run("single"), auto: run("auto"), normal: run("normal") };
        """,
    )
    assert found["single"][0] == ["waiting", "filling", "held", "held", "held", "held", "held"]
    assert found["single"][1] == pytest.approx(99.5)
    assert found["auto"][0][:3] == ["waiting", "filling", "complete"]
    assert found["auto"][0][-1] == "waiting" and found["auto"][1] is None
    assert found["normal"][0][-1] == "complete" and found["normal"][1] == pytest.approx(2109.5)


# ---- Fit ---------------------------------------------------------------------------------------------------------

TAPS = {name: material.tap for name, material in shipped_materials().items() if material.tap is not None}
FIT = "fitModes, mainDirection from tap_fit"


def ringing(
    frequency_hz: float, decay_time_s: float, rate_hz: float, count: int, lag_s: float = 0.0
) -> npt.NDArray[np.float64]:
    t = np.arange(count) / rate_hz + lag_s
    return np.asarray(np.exp(-t / decay_time_s) * np.sin(2 * np.pi * frequency_hz * t))


def fit(page: Page, samples: npt.NDArray[np.float64], rate_hz: float) -> Any:
    return run(page, FIT, "return fitModes(Float64Array.from(given[0]), 1 / given[1]);", [samples.tolist(), rate_hz])


@pytest.mark.parametrize("name", sorted(TAPS))
@pytest.mark.parametrize("rate_hz", [10_000.0, 4_000.0])
def test_a_single_mode_is_found_exactly(modules: Page, name: str, rate_hz: float) -> None:
    tap = TAPS[name]
    assert tap.frequency_hz is not None and tap.decay_time_s is not None
    shown_hz = min(tap.frequency_hz, 0.4 * rate_hz)
    samples = ringing(shown_hz, tap.decay_time_s, rate_hz, max(8, int(5 * tap.decay_time_s * rate_hz)), 3e-5)
    found = fit(modules, samples, rate_hz)
    assert len(found["modes"]) == 1
    assert found["modes"][0]["frequencyHz"] == pytest.approx(shown_hz, rel=1e-9)
    assert found["modes"][0]["decayPerS"] == pytest.approx(1 / tap.decay_time_s, rel=1e-8)


def test_modes_that_ring_together_are_separated(modules: Page) -> None:
    samples = ringing(67, 0.00648, 1e4, 324) + 0.5 * ringing(400, 0.003, 1e4, 324) + 0.2 * ringing(230, 0.01, 1e4, 324)
    found = fit(modules, samples, 1e4)
    assert [mode["frequencyHz"] for mode in found["modes"]] == pytest.approx([67, 400, 230], rel=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_noise_moves_frequency_and_decay_little(modules: Page, seed: int) -> None:
    noise = 0.02 * np.random.default_rng(seed).standard_normal(324)
    found = fit(modules, ringing(67, 0.00648, 1e4, 324) + noise, 1e4)
    assert found["modes"][0]["frequencyHz"] == pytest.approx(67, rel=0.02)
    assert found["modes"][0]["decayPerS"] == pytest.approx(1 / 0.00648, rel=0.06)


def test_noise_alone_and_silence_have_no_modes(modules: Page) -> None:
    assert fit(modules, np.zeros(100), 1e4) is None
    assert fit(modules, np.random.default_rng(1).standard_normal(300), 1e4) is None


def test_the_direction_of_a_vibration_is_that_of_its_first_half_wave(modules: Page) -> None:
    wave = ringing(200, 0.003, 1e4, 100)
    body = "return mainDirection(Float64Array.from(given[0]), Float64Array.from(given[1]));"
    found = run(modules, FIT, body, [(-0.6 * wave).tolist(), (0.8 * wave).tolist()])
    assert found == pytest.approx([-0.6, 0.8], abs=1e-12)


# ---- The library's closed form -----------------------------------------------------------------------------------

MODEL = "tapModel, closedForm, materialAt from tap_model"
EVENT = {"event": "contact", "object": "floor", "speed_m_per_s": 0.2, "amplitude_m_per_s2": 60.0, "scale": 0.5}
DEVICE = {"effective_mass_kg": 0.05, "compensation": "off"}


def model(page: Page, tap: object, undisplayable: object = None, times: Sequence[float] = ()) -> Any:
    body = """
        const material = given.tap === null ? {} : { tap: given.tap };
        const model = tapModel("it", material, given.event, given.device, given.undisplayable);
        return { ...model, values: (model.modes ? given.times.map((t) => closedForm(model.modes, t)) : null) };
        """
    given = {
        "tap": tap,
        "event": EVENT,
        "device": DEVICE,
        "undisplayable": undisplayable,
        "times": list(times),
    }  # type: ignore[call-overload]
    return run(page, MODEL, body, given)


def test_the_closed_form_is_mass_times_equation_1(modules: Page) -> None:
    times = [-0.001, 0.0, 0.002, 0.01, 0.0299, 0.0301]
    found = model(modules, {"attack": "coefficient", "frequency_hz": 100, "decay_time_s": 0.006}, times=times)
    wanted = [
        0.05 * 60 * 0.5 * math.exp(-t / 0.006) * math.sin(2 * math.pi * 100 * t) if 0 <= t <= 0.03 else 0 for t in times
    ]
    assert found["values"] == pytest.approx(wanted, abs=1e-14)
    assert found["endS"] == pytest.approx(0.03)


def test_a_first_peak_is_as_high_as_the_event_says(modules: Page) -> None:
    times = np.linspace(0, 0.01, 20001).tolist()
    tap = {"attack": "first_peak", "angular_frequency_rad_per_s": 600, "decay_rate_per_s": 200}
    assert max(model(modules, tap, times=times)["values"]) == pytest.approx(0.05 * 60 * 0.5, rel=1e-6)


def test_a_lowered_tap_keeps_its_peak_and_a_silent_tap_is_reported(modules: Page) -> None:
    times = np.linspace(0, 0.002, 20001).tolist()
    tap = {"attack": "coefficient", "frequency_hz": 1682, "decay_time_s": 0.00032}
    lowered = [{"material": "it", "mode": "tap", "frequency_hz": 1682, "shown_hz": 400.0}]
    full, low = model(modules, tap, times=times), model(modules, tap, lowered, times)
    assert low["modes"][0]["frequencyHz"] == 400 and low["meantHz"] == 1682
    assert max(low["values"]) == pytest.approx(max(full["values"]), rel=1e-4)
    assert "silent" in model(modules, tap, [{**lowered[0], "shown_hz": None}])["problem"]
    assert "no tap" in model(modules, None)["problem"]
    assert "waveform" in model(modules, {"waveform": {"rate_hz": 1000, "samples": [0, 1, 0]}})["problem"]


def test_a_table_gives_the_mode_of_the_speed_and_a_second_mode_rings_with_it(modules: Page) -> None:
    table = {"speeds_m_per_s": [0.1, 0.3], "frequencies_hz": [100, 300], "decay_times_s": [0.01, 0.02]}
    found = model(modules, {"attack": "coefficient", "mode_table": table})
    assert found["modes"][0]["frequencyHz"] == pytest.approx(200) and found["endS"] == pytest.approx(0.075)
    second = {"ratio": 0.5, "frequency_hz": 500, "decay_time_s": 0.004}
    found = model(modules, {"attack": "coefficient", "frequency_hz": 100, "decay_time_s": 0.01, "second": second})
    assert found["modes"][1]["amplitudeN"] == pytest.approx(0.5 * found["modes"][0]["amplitudeN"])


def test_the_material_is_that_of_the_patch(modules: Page) -> None:
    wall = {"kind": "wall", "point_m": [0.01, 0], "normal": [0, 2], "material": "wood",
            "patches": [{"from_m": 0.0, "to_m": 0.02, "material": "comb"}]}  # fmt: skip
    body = "return given[1].map((x) => materialAt(given[0], [x, 0]));"
    assert run(modules, MODEL, body, [wall, [0.005, 0.015, 0.035]]) == ["wood", "comb", "wood"]
    assert run(modules, MODEL, body, [{"kind": "disc", "material": "glass"}, [0]]) == ["glass"]


# ---- Spectrum, histogram -----------------------------------------------------------------------------------------

SPECTRUM = "spectrum from spectrum"


def test_a_spectrum_is_numpy_s(modules: Page) -> None:
    samples = np.random.default_rng(3).standard_normal(3000) + 5
    found = run(
        modules, SPECTRUM, "const s = spectrum(Float64Array.from(given), 1e4); return [...s.power];", samples.tolist()
    )
    window = np.hanning(3001)[:-1]
    mean = np.average(samples, weights=window)
    wanted = 2 * np.abs(np.fft.rfft((samples - mean) * window, 8192)) ** 2 / window.sum() ** 2
    assert np.allclose(found, wanted, rtol=1e-9, atol=1e-18)


@pytest.mark.parametrize(("count", "hz"), [(1000, 123.456), (8192, 67.0), (100_000, 1471.3)])
def test_the_peak_of_a_sine_is_its_frequency_and_its_level(modules: Page, count: int, hz: float) -> None:
    samples = 0.5 * math.sqrt(2) * np.sin(2 * np.pi * hz * np.arange(count) / 1e4 + 1)
    body = "const { peakHz, peakDb, centroidHz, resolutionHz } = spectrum(Float64Array.from(given), 1e4);"
    found = run(modules, SPECTRUM, body + "return { peakHz, peakDb, centroidHz, resolutionHz };", samples.tolist())
    resolution = 1.5e4 / min(count, 32768)
    assert found["resolutionHz"] == pytest.approx(resolution)
    assert found["peakHz"] == pytest.approx(hz, abs=0.01 * resolution)
    assert found["peakDb"] == pytest.approx(20 * math.log10(0.5), abs=0.02)
    assert found["centroidHz"] == pytest.approx(hz, abs=0.05 * resolution)


STRETCHES = [
    # Gaps at rows 300 and 350 of 1000: the trigger at row 310 is in the shortest of the three stretches.
    (0.031, (300, 350)),
    (0.0300, (300, 350)),  # in the first row after a gap
    (0.02995, (300, 350)),  # an onset within the gap
    (0.0299, (0, 300)),
    (0.09, (350, 1000)),
    (None, (350, 1000)),
    (-0.01, (350, 1000)),  # before the window
    (0.2, (350, 1000)),  # after it
]


@pytest.mark.parametrize(("trigger", "rows"), STRETCHES)
def test_the_spectrum_is_of_the_stretch_that_has_the_trigger(
    modules: Page, trigger: float | None, rows: tuple[int, int]
) -> None:
    found = run(
        modules,
        "Store, flat from store; Source from source; unbroken from spectrum_view",
        """
        // Rows stay where they are in time: row r is at r * 0.1 ms, but for the gaps of two periods before 300 and 350.
        const store = new Store(2000).add(flat(300)).add(flat(50)).add(flat(650)), source = new Source(store);
        source.update();
        source.gaps[300] = source.gaps[350] = 1;
        return unbroken(source, 0, 0.1, given);
        """,
        trigger,
    )
    assert tuple(found) == rows


def test_the_spectrum_of_a_tap_between_gaps_is_the_tap_s_and_says_over_how_long_it_was_computed(modules: Page) -> None:
    ring = ringing(1000.0, 0.005, 1e4, 150)
    found = run(
        modules,
        "Store, flat from store; Source from source; SpectrumView from spectrum_view",
        """
        // 40 ms with a slow swing, then the tap: 5 ms before it, 15 ms of it; then 60 ms with the swing again.
        const swing = (count) => Array.from({ length: count }, (_, k) => ({ vibration_y_n: Math.sin(0.0628 * k) }));
        const store = new Store(5000).add(swing(400));
        store.add([...flat(50), ...given.map((value) => ({ vibration_y_n: value }))], { skip: 1 });
        store.add(swing(600), { lost: 20 });
        const source = new Source(store), host = document.body.appendChild(document.createElement("div"));
        host.style.width = host.style.height = "300px";
        source.update();
        let said = "";
        const seen = [0.0451, null].map((trigger) => {
          const view = new SpectrumView(host, (text) => (said = text));
          for (let k = 0; k < 10 && view.result === null; k++) view.step(source, "vibration_y", 0, 0.2, trigger, true);
          return { peakHz: view.result.peakHz, said };
        });
        host.remove();
        return seen;
        """,
        ring.tolist(),
    )
    around, longest = found
    assert around["peakHz"] == pytest.approx(1000.0, rel=0.05)
    assert "computed over 20.00 ms of 200.0 ms, the stretch that contains the trigger without a gap" in around["said"]
    assert longest["peakHz"] == pytest.approx(100.0, rel=0.05)
    assert "computed over 60.00 ms of 200.0 ms, the longest stretch without a gap" in longest["said"]


@pytest.mark.parametrize("before", [10, 50, 200])
def test_the_peak_of_a_short_tap_is_the_tap_s_wherever_it_lies_in_the_window(modules: Page, before: int) -> None:
    # Steel, 80 ms: after subtraction of a plain mean, the hump at the window's ends would be higher than the tap.
    samples = np.concatenate([np.zeros(before), ringing(1682.0, 0.00032, 1e4, 800 - before)])
    body = "return spectrum(Float64Array.from(given), 1e4).peakHz;"
    assert run(modules, SPECTRUM, body, samples.tolist()) == pytest.approx(1682, rel=0.1)


def test_nothing_has_no_peak(modules: Page) -> None:
    body = "const s = spectrum(new Float64Array(100).fill(3), 1e4); return [s.peakHz, s.centroidHz].map(Number.isNaN);"
    assert run(modules, SPECTRUM, body) == [True, True]


def test_quantiles_of_a_histogram_are_those_of_its_values(modules: Page) -> None:
    values = np.random.default_rng(5).lognormal(math.log(8000), 0.8, 20_000)
    edges = 128 * 2 ** (np.arange(100) / 4)
    counts = np.histogram(values, [0, *edges, np.inf])[0]
    given = {"edges": edges.tolist(), "counts": counts.tolist(), "max": values.max()}
    body = "return [0.5, 0.99, 1].map((share) => quantile(given, share));"
    found = run(modules, "quantile from histogram", body, given)
    assert found[:2] == pytest.approx(np.quantile(values, [0.5, 0.99]).tolist(), rel=0.02)
    assert found[2] == values.max()
    assert math.isnan(run(modules, "quantile from histogram", body, {**given, "counts": [0] * 101})[0])


# ---- Files, scales -----------------------------------------------------------------------------------------------


def test_numpy_finds_the_very_samples_in_a_csv(modules: Page, tmp_path: Path) -> None:
    values = np.random.default_rng(9).standard_normal((12_000, 2)) * [1e-3, 4.0]
    text = run(
        modules,
        "Store from store; Source from source; snapshot, csvParts, pause from export",
        """
        const store = new Store(10000);  // smaller than the number of samples: the oldest rows are removed
        store.add(given.map(([x, y]) => ({ x_m: x, vibration_y_n: y })));
        const source = new Source(store);
        source.update();
        const taken = snapshot(source, ["position_x", "vibration_y", "vibration_magnitude"], 2000, 12000, 0.25);
        store.add(given.slice(0, 9000).map(() => ({})));  // what comes meanwhile does not change it
        return (await csvParts(taken, pause)).join("");
        """,
        values.tolist(),
    )
    file = tmp_path / "samples.csv"
    file.write_text(text)
    found = np.genfromtxt(file, delimiter=",", names=True)
    assert found.dtype.names == ("tick", "time_s", "position_x_m", "vibration_force_y_n", "vibration_force_magnitude_n")
    assert np.array_equal(found["tick"], np.arange(2000, 12_000))
    assert np.array_equal(found["position_x_m"], values[2000:, 0])
    assert np.array_equal(found["vibration_force_y_n"], values[2000:, 1])
    assert np.array_equal(found["vibration_force_magnitude_n"], np.abs(values[2000:, 1]))
    assert np.allclose(found["time_s"], np.arange(2000, 12_000) * 1e-4 - 0.25, atol=1e-12)


def test_an_automatic_scale_grows_at_once_and_shrinks_after_a_while(modules: Page) -> None:
    found = run(
        modules,
        "VerticalScale, niceStep from vertical_scale",
        """
        const scale = new VerticalScale(0.02), seen = [];
        const fit = (low, high, now, settled = false) => {
          scale.fit(low, high, now, settled);
          seen.push([scale.low, scale.high]);
        };
        fit(-0.1, 3.7, 0); fit(0, 0.1, 10); fit(0, 0.1, 500); fit(0, 0.1, 1100); fit(5, 5, 1200, true);
        scale.set(-2, 2); fit(-9, 9, 1300);
        return { seen, steps: [0.011, 0.5, 3, 70].map(niceStep) };
        """,
    )
    assert found["steps"] == pytest.approx([0.02, 0.5, 5, 100])
    low, high = found["seen"][0]
    assert low <= -0.1 and high >= 3.7 and high - low <= 6
    assert found["seen"][1] == found["seen"][2] == found["seen"][0]
    assert found["seen"][3][1] - found["seen"][3][0] < 0.3
    assert found["seen"][4][0] < 5 < found["seen"][4][1]
    assert found["seen"][5] == [-2, 2]


def test_a_held_window_keeps_the_time_under_the_pointer_while_it_zooms(modules: Page) -> None:
    found = run(
        modules,
        "ViewWindow from view_window",
        """
        const view = new ViewWindow();
        view.follow(100);
        view.setWidth(10);
        const running = [view.left, view.right];
        view.hold();
        view.follow(200);
        view.zoom(0.1, 0.3);
        const zoomed = [view.left, view.widthS];
        view.pan(-1, 90, 200);
        const panned = view.left;
        view.pan(-1000, 90, 200);
        const first = view.left;
        view.zoom(1e9);
        return { running, zoomed, panned, first, widest: view.widthS, zero: view.zero };
        """,
    )
    assert found["running"] == [90, 100]
    assert found["zoomed"] == pytest.approx([93 - 0.3, 1])
    assert found["panned"] == pytest.approx(91.7)
    assert found["first"] == pytest.approx(90 - 0.9)
    assert found["widest"] == 60 and found["zero"] == 100


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_trace_stands_out_from_its_ground(modules: Page, scheme: str) -> None:
    modules.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
    colors = run(
        modules,
        "CHANNELS from channels",
        """
        const value = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
        const traces = CHANNELS.map(({ quantity, part }) => value(`${quantity}-${part}`));
        return { traces, grounds: ["surface", "gap"].map(value) };
        """,
    )
    assert len(set(colors["traces"])) == 15

    def luminance(text: str) -> float:
        parts = [int(text[k : k + 2], 16) / 255 for k in (1, 3, 5)]
        red, green, blue = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
        return 0.2126 * red + 0.7152 * green + 0.0722 * blue

    for ground, least in zip(colors["grounds"], (4.5, 3.0), strict=True):
        for trace in colors["traces"]:
            dark, light = sorted((luminance(ground), luminance(trace)))
            assert (light + 0.05) / (dark + 0.05) >= least, (trace, ground)
