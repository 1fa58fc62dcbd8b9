// The page, put together. What it shares with the experimenter's page is in app.js. Each module draws one part of it into
// the element that it is given, and takes what it needs from `app`:
//
//   app.link       connection.js: calls to the daemon and to `hapticd web`; telemetry, as events by topic
//   app.samples    samples.js: the last minute of samples, every one of them
//   app.model      model.js: scene, materials, schema and configuration as the daemon has them; their changes
//   app.safety     safety.js: who holds the forces; begin() at a press on the scene, stop()
//   app.undo       undo.js: undo and redo of what the page changes in scene and materials
//   app.attention  attention.js: hold(name) while samples are wanted though nobody sees the page
//   app.timing     timing.js: frames and latencies, measured while somebody asked for it; drew(row) after a picture
//   app.parts      parts.js: loads and mounts the modules below; `failed` are those that could not be
//   app.tabs       tabs.js: show("materials-panel")
//   app.playback   playback.js: a recording that is looked through. While it is `active`, its `store`, `scene` and `state`
//                  are shown in place of app.samples, app.model.scene and app.model.state
//   app.view       what modules tell each other: an EventTarget. Events: `select` {id} an object was picked,
//                  `material` {name} a material was picked, `notice` {text, kind} a line for the person (info, error),
//                  `tab` {panel} a panel is shown,
//                  `playback` {active, moved, ...} a recording is opened, left, played, or its moment jumped,
//                  `moment` the same with every picture while it plays
//
// A module exports `mount(app, element)`. It may leave functions for others in `app` under its own name. What it needs
// from the network, it asks for before it listens to anything: where that fails, parts.js mounts it again. Colours and
// classes: style.css; colours on a canvas: theme.js.
import { begin, newApp } from "./app.js";
import { Safety } from "./safety.js";
import { Undo } from "./undo.js";

// Those that need no daemon come first: they say that there is none.
const FRAME = [
  ["notices", "./notices.js"],
  ["status-bar", "./status_bar.js"],
  ["tabs", "./tabs.js"],
];
const PARTS = [
  ["scene-view", "./scene_view.js"],
  ["scope", "./scope.js"],
  ["materials-panel", "./materials_panel.js"],
  ["objects-panel", "./objects_panel.js"],
  ["files-panel", "./files_panel.js"],
  ["sound-panel", "./sound.js"],
  ["recordings-panel", "./recordings_panel.js"],
];

const app = newApp((made) => {
  made.undo = new Undo(made);
  return new Safety(made);
});
await begin(app, FRAME, PARTS);
document.body.dataset.ready = "true";
