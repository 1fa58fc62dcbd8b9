"""The page's modules for samples, scene and connection, imported in the page with data made up by tests."""

from __future__ import annotations

from typing import Any

import pytest
from playwright.sync_api import Page

from tests.web.browser import Pages

pytestmark = pytest.mark.slow

# Makes batches like those of the daemon from a description: [name, format, value(tick, component)].
MAKE = """
  const { SampleStore, MAX_ROWS } = await import("/static/samples.js");
  const WIDTHS = { f8: 8, f4: 4, i8: 8, u8: 8, i4: 4, u4: 4, u2: 2 };
  const SETTERS = { f8: "setFloat64", f4: "setFloat32", i8: "setBigInt64", u8: "setBigUint64", i4: "setInt32",
                    u4: "setUint32", u2: "setUint16" };
  const TODAY = [["tick", "<u8"], ["time_ns", "<i8"], ["position_m", "<f8", [2]], ["velocity_m_per_s", "<f8", [2]],
    ["contact_force_n", "<f8", [2]], ["vibration_force_n", "<f8", [2]], ["force_n", "<f8", [2]], ["revision", "<u4"],
    ["flags", "<u4"], ["lateness_ns", "<i4"], ["work_ns", "<i4"]];
  const VALUE = { time_ns: (t) => 8888888888888000000n + BigInt(t) * 100000n, position_m: (t, c) => t + c / 4,
                  force_n: (t, c) => -t - c, flags: (t) => t % 7,
                  lateness_ns: (t) => 1000 * t, work_ns: () => -5, tick: (t) => BigInt(t), revision: () => 3 };
  const batch = (first, count, dtype = TODAY, dropped = 0, offset = 0) => {
    const size = dtype.reduce((sum, [, format, shape]) => sum + WIDTHS[format.slice(1)] * (shape?.[0] ?? 1), 0);
    const data = new Uint8Array(offset + size * count).subarray(offset);
    const view = new DataView(data.buffer, data.byteOffset);
    let at = 0;
    for (let tick = first; tick < first + count; tick++) {
      for (const [name, format, shape] of dtype) {
        const kind = format.slice(1);
        for (let c = 0; c < (shape?.[0] ?? 1); c++, at += WIDTHS[kind]) {
          const value = (VALUE[name] ?? (() => 0))(tick, c);
          const big = kind === "i8" || kind === "u8";
          view[SETTERS[kind]](at, big ? BigInt(value) : Number(value), format[0] === "<");
        }
      }
    }
    return { first_tick: first, dropped, dtype, data };
  };
  const row = (store, row) => Object.fromEntries(["time_s", "x_m", "y_m", "force_y_n", "flags", "lateness_s", "work_s"]
    .map((name) => [name, store.columns[name][row % store.capacity]]));
"""


def logic(page: Page, script: str) -> Any:
    return page.evaluate(f"async () => {{ {MAKE} {script} }}")


def test_samples_are_read_by_their_dtype_wherever_fields_lie_and_however_they_are_aligned(page: Page) -> None:
    found = logic(
        page,
        """
        const moved = [["flags", "<u2"], ["lateness_ns", "<i4"], ["force_n", ">f4", [2]], ["more", "<f8", [3]],
                       ["time_ns", ">u8"], ["work_ns", "<i4"], ["position_m", "<f8", [2]]];
        return [[TODAY, 0], [TODAY, 3], [moved, 0], [moved, 5]].map(([dtype, offset]) => {
          const store = new SampleStore(1);
          store.add(batch(40, 3, dtype, 0, offset));
          return row(store, 2);
        });""",
    )
    expected = {
        "time_s": 0.0002,
        "x_m": 42,
        "y_m": 42.25,
        "force_y_n": -43,
        "flags": 0,
        "lateness_s": 42e-6,
        "work_s": -5e-9,
    }
    for each in found:
        assert each == pytest.approx(expected, rel=1e-6)


def test_a_field_that_samples_do_not_have_is_nan(page: Page) -> None:
    script = """
        const store = new SampleStore(1);
        store.add(batch(0, 2, TODAY.filter(([name]) => name !== "velocity_m_per_s")));
        return [Number.isNaN(store.columns.vx_m_per_s[1]), store.columns.x_m[1]];"""
    assert logic(page, script) == [True, 1]


def test_an_unknown_format_is_an_error_that_names_the_field(page: Page) -> None:
    script = """
        try { new SampleStore(1).add({ first_tick: 0, dropped: 0, dtype: [["x", "<c16"]], data: new Uint8Array(16) }); }
        catch (error) { return error.message; }"""
    assert logic(page, script) == "samples: field x has a format that this page cannot read: <c16"


def test_the_ring_keeps_the_newest_and_grows_with_the_rate(page: Page) -> None:
    found = logic(
        page,
        """
        const store = new SampleStore(1);
        store.setRate(100);
        for (let first = 0; first < 250; first += 10) store.add(batch(first, 10));
        const before = [store.rows, store.first, store.capacity, row(store, 150).x_m, row(store, 249).x_m];
        store.setRate(1000);
        store.add(batch(250, 10));
        const after = [store.rows, store.first, store.capacity, row(store, 200).x_m, row(store, 259).x_m, store.lost];
        store.setRate(10);
        return [before, after, store.capacity];""",
    )
    # After the ring grew, its older rows are those of the small ring.
    assert found == [[250, 150, 100, 150, 249], [260, 150, 1000, 200, 259, 0], 1000]


def test_lost_samples_are_counted_and_those_of_the_daemon_separately(page: Page) -> None:
    found = logic(
        page,
        """
        const store = new SampleStore(1);
        const counts = [];
        store.addEventListener("lost", (event) => counts.push(event.detail.count));
        store.add(batch(0, 10));
        store.add(batch(15, 10));            // 5 lost on the way
        store.add(batch(32, 10, TODAY, 4));  // 7 missing, 4 of them in the daemon
        store.expectGap();
        store.add(batch(900, 10, TODAY, 20)); // left out on purpose
        return [store.lost, store.dropped, counts, store.ticks[store.rows - 1]];""",
    )
    assert found == [12, 4, [5, 7], 909]


def test_another_daemon_begins_at_tick_0_and_the_old_rows_are_forgotten(page: Page) -> None:
    found = logic(
        page,
        """
        const store = new SampleStore(1);
        let restarts = 0;
        store.addEventListener("restart", () => restarts++);
        store.add(batch(500, 10));
        store.add(batch(0, 10));
        store.add(batch(10, 10));
        return [restarts, store.lost, store.first, store.rows, row(store, store.first).time_s, row(store, 29).x_m];""",
    )
    assert found == [1, 0, 10, 30, 0, 19]


def test_a_minute_at_10_khz_takes_less_than_60_mb(page: Page) -> None:
    script = """
        const store = new SampleStore(60);
        store.setRate(10000);
        const arrays = [store.ticks, ...Object.values(store.columns)];
        const bytes = arrays.reduce((sum, { byteLength }) => sum + byteLength, 0);
        store.setRate(100000);
        return [bytes, store.capacity === MAX_ROWS];"""
    size, bounded = logic(page, script)
    assert 600_000 * 60 < size < 60e6 and bounded


FAKE_LINK = """
  const { Model } = await import("/static/model.js");
  class Fake extends EventTarget {
    asked = []; revision = 1; pending = [];
    scene = { objects: { a: { kind: "wall" } } };
    call(method) {
      this.asked.push(method);
      const answers = { get_status: { started_ns: 1, revision: this.revision }, get_config: { config: {} },
        get_scene: { scene: this.scene, revision: this.revision },
        get_materials: { materials: {}, revision: this.revision } };
      return Promise.resolve(answers[method]);
    }
    tell(topic, detail) { this.dispatchEvent(new CustomEvent(topic, { detail })); }
  }
  const link = new Fake();
  const model = new Model(link);
  const events = [];
  for (const name of ["scene", "materials"]) model.addEventListener(name, () => events.push(name));
  await model.load();
  events.length = link.asked.length = 0;
"""


def test_changes_are_applied_without_a_request(page: Page) -> None:
    script = f"""{FAKE_LINK}
        link.tell("change", {{ revision: 2, objects: {{ a: null, b: {{ kind: "disc" }} }}, scene: {{ ramp_s: 0.1 }} }});
        link.tell("change", {{ revision: 3, materials: {{ wood: {{ stiffness_n_per_m: 5 }} }} }});
        link.tell("change", {{ revision: 2, materials: {{ wood: null }} }}); // of before
        link.tell("change", {{ tick: 5, play: {{}} }});
        return [model.scene, model.materials, model.revision, events, link.asked];"""
    assert page.evaluate(f"async () => {{ {script} }}") == [
        {"objects": {"b": {"kind": "disc"}}, "ramp_s": 0.1},
        {"wood": {"stiffness_n_per_m": 5}},
        3,
        ["scene", "materials"],
        [],
    ]


def test_a_missed_change_causes_one_request_for_everything(page: Page) -> None:
    script = f"""{FAKE_LINK}
        link.revision = 40;
        for (let revision = 10; revision <= 40; revision++) link.tell("change", {{ revision, objects: {{}} }});
        link.tell("change", {{ revision: 41, objects: {{ c: {{ kind: "disc" }} }} }}); // while everything is on its way
        while (model.revision !== 41) await new Promise((resolve) => setTimeout(resolve, 1));
        return ["c" in model.scene.objects, link.asked.length];"""
    assert page.evaluate(f"async () => {{ {script} }}") == [True, 4]


def test_a_status_of_another_daemon_causes_a_request_for_everything(page: Page) -> None:
    script = f"""{FAKE_LINK}
        link.tell("status", {{ started_ns: 1, revision: 0 }}); // of before
        const before = link.asked.length;
        link.tell("status", {{ started_ns: 2, revision: 1 }});
        return [before, link.asked.length];"""
    assert page.evaluate(f"async () => {{ {script} }}") == [0, 4]


def test_parts_that_failed_are_mounted_again_and_no_others(page: Page, pages: Pages) -> None:
    script = """async () => {
      const { Parts } = await import("/static/parts.js");
      const app = new EventTarget(), mounts = [], heard = [];
      let there = false;
      const load = async (path) => ({
        mount: async (_, element) => {
          mounts.push(path);
          if (path !== "whole" && !there) {
            throw new Error(`${path} did not come`);
          }
          app.addEventListener("news", () => heard.push(path));
          element.append("mounted");
        },
      });
      for (const id of ["a", "b", "c"]) {
        const element = document.body.appendChild(document.createElement("section"));
        element.id = id;
        element.append("begins, ");
      }
      const parts = new Parts(app, load);
      const said = () => ["a", "b", "c"].map((id) => document.getElementById(id).innerText.replaceAll("\\n", " "));
      await parts.mount([["a", "whole"], ["b", "late"], ["c", "later"]]);
      const first = said(), failed = parts.failed;
      await parts.mountFailed();
      there = true;
      await Promise.all([parts.mountFailed(), parts.mountFailed()]); // the button, and the connection
      app.dispatchEvent(new Event("news"));
      return { first, failed, mounts, heard, last: said(), left: parts.failed };
    }"""
    found = page.evaluate(script)
    failure = "begins, This part of the page failed: {} did not come Try again"
    assert [" ".join(each.split()) for each in found["first"]] == [
        "begins, mounted",
        failure.format("late"),
        failure.format("later"),
    ]
    assert found["failed"] == ["b", "c"] and found["left"] == []
    assert found["last"] == ["begins, mounted"] * 3
    assert found["mounts"] == ["whole", *["late", "later"] * 3]
    assert found["heard"] == ["whole", "late", "later"]
    assert len(pages.take_errors()) == 4  # each failure is on the console
