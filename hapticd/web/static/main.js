// The page of `hapticd web`. app.js has what it shares with the experimenter's page. Each module draws one part of the page
// into the element that it is given, and uses `app`:
//
//   app.link       connection.js: calls to the daemon and to `hapticd web`; telemetry, as events by topic
//   app.samples    samples.js: all samples of the last minute
//   app.model      model.js: scene, materials, schema and configuration as the daemon has them; their changes
//   app.safety     safety.js: control of the forces; begin() at a press on the scene, stop()
//   app.undo       undo.js: undo and redo of the page's changes of scene and materials
//   app.attention  attention.js: hold(name) while samples are needed although the page is hidden
//   app.timing     timing.js: frame rate and latencies, measured on request; drew(row) after drawing
//   app.parts      parts.js: loads and mounts the modules below; `failed` are those that failed
//   app.tabs       tabs.js: show("materials-panel")
//   app.playback   playback.js: the playback of a recording. While it is `active`, its `store`, `scene` and `state` are
//                  shown in place of app.samples, app.model.scene and app.model.state
//   app.view       an EventTarget for events between modules: `select` {id} an object was selected,
//                  `material` {name} a material was selected, `notice` {text, kind} a line for the user (info, error),
//                  `tab` {panel} a panel is shown,
//                  `playback` {active, moved, ...} a recording is opened, closed or played, or its moment jumped,
//                  `moment` the same with every frame while it plays
//
// A module exports `mount(app, element)`. It may put functions for other modules into `app` under its name. It requests
// what it needs from the network before it adds listeners: if a request fails, parts.js mounts the module again. Colours
// and classes: style.css; colours on a canvas: theme.js.
import { begin, newApp } from "./app.js";
import { Safety } from "./safety.js";
import { Undo } from "./undo.js";

// Parts that need no daemon are mounted first: they show that no daemon is connected.
const FRAME_PARTS = [
  ["notices", "./notices.js"],
  ["status-bar", "./status_bar.js"],
  ["tabs", "./tabs.js"],
];
const DAEMON_PARTS = [
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
await begin(app, FRAME_PARTS, DAEMON_PARTS);
document.body.dataset.ready = "true";
