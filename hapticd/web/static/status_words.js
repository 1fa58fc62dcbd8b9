// Texts and numbers of the status bar: explanations of faults, the lateness of the last seconds.

const FAULT_TEXTS = {
  nonfinite: "A position or a force was not a finite number, so the force was set to zero.",
  control: "The daemon answered no commands for 1 s, so the forces faded.",
  lease: "The page or program that held the forces was closed, froze or lost its connection, so the forces faded.",
  device: "The joystick does not report its position. Check its cable and power.",
  frozen: "The joystick reported the same position for too long while it was pushed. Move the handle to see whether it reports.",
};

// Returns one line: what happened, and what can be done about it.
export function faultText(fault, model) {
  if (fault === "overrun") {
    const share = model.status.overruns?.threshold;
    const percent = share === undefined ? "too many" : `more than ${Number((100 * share).toPrecision(2))} %`;
    return `The machine missed ${percent} of a second's periods. Close what else runs on it, or lower servo.rate_hz.`;
  }
  if (fault === "device" && model.status.device === "replay") {
    return model.status.connection?.state === "lost"
      ? "The recording of the joystick is over. Restart the daemon, or set device.replay.loop."
      : "The recording of the joystick has a pause without reports.";
  }
  if (fault === "signs") {
    return model.status.connection?.signs?.advice ?? "The check of the joystick's directions failed.";
  }
  return FAULT_TEXTS[fault] ?? `Fault: ${fault}.`;
}

const LATENESS_WINDOW_S = 10;

function microseconds(ns) {
  return ns < 9950 ? (ns / 1e3).toFixed(1) : Math.round(ns / 1e3).toLocaleString("en");
}

// The 99 % quantile of the lateness in the last 10 s, rounded up to an edge of the status's histograms (steps of 19 %).
// `max` is the maximum since the daemon's start.
export function lateness() {
  let kept = []; // histogram counts of the last seconds
  let newest = null;
  let started = null;

  function add(histogram, startedNs) {
    if (histogram === undefined) {
      return;
    }
    if (startedNs !== started) {
      [kept, started] = [[], startedNs];
    }
    kept.push(histogram.counts);
    kept = kept.slice(-(LATENESS_WINDOW_S + 1));
    newest = histogram;
  }

  function quantile(share) {
    if (kept.length < 2) {
      return null;
    }
    const counts = kept.at(-1).map((count, i) => count - kept[0][i]);
    const wanted = share * counts.reduce((a, b) => a + b, 0);
    let below = 0;
    for (let i = 0; i < counts.length; i++) {
      below += counts[i];
      if (below >= wanted && below > 0) {
        return Math.min(newest.edges[i] ?? newest.max, newest.max);
      }
    }
    return null;
  }

  function text() {
    const p99 = quantile(0.99);
    return p99 === null ? "–" : `p99 ${microseconds(p99)} µs, max ${microseconds(newest.max)} µs`;
  }

  return { add, quantile, text };
}
