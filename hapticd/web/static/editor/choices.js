// Keys that exclude each other: how the editors offer them, and how a switch converts the values.
//
// The JSON Schema of the configuration defines which keys exclude each other (`oneOf`, `not`); this module has the options
// that the user chooses from, and the conversions.

const FULL_TURN_RAD = 2 * Math.PI;

// Two keys for one quantity, with the functions that convert one to the other.
export const PAIRS = [
  { keys: ["frequency_hz", "angular_frequency_rad_per_s"], to: (hertz) => FULL_TURN_RAD * hertz, from: (radians) => radians / FULL_TURN_RAD },
  { keys: ["decay_time_s", "decay_rate_per_s"], to: (seconds) => 1 / seconds, from: (rate) => 1 / rate },
];

export const pairOf = (key) => PAIRS.find(({ keys }) => keys.includes(key));

const MODE_KEYS = PAIRS.flatMap(({ keys }) => keys);
const frequency = (value) => value.frequency_hz ?? (value.angular_frequency_rad_per_s ?? FULL_TURN_RAD * 200) / FULL_TURN_RAD;
const decay = (value) => value.decay_time_s ?? 1 / (value.decay_rate_per_s ?? 200);
const decayKeys = (value) => ("decay_rate_per_s" in value ? {} : { decay_time_s: decay(value) });

// Half a sine that rises from 0 and falls to 0 again.
const curve = () => Array.from({ length: 21 }, (_, index) => Number(Math.sin((Math.PI * index) / 20).toFixed(4)) || 0);

const aimed = (what) => ({
  name: "direction",
  label: "Acts",
  options: [
    { name: "usual", label: "across the surface", keys: [], start: () => ({}) },
    { name: "normal", label: "across, as set", rare: true, keys: ["direction"], is: ({ direction }) => direction === "normal", start: () => ({ direction: "normal" }) },
    { name: "tangent", label: "along the surface", keys: ["direction"], is: ({ direction }) => direction === "tangent", start: () => ({ direction: "tangent" }) },
    { name: "angle", label: "at an angle", keys: ["angle_rad"], start: () => ({ angle_rad: 0.5 }) },
  ],
  what,
});

// Choices by definition of the schema. The option whose keys a value has is in force. When an option is chosen, the `keys` of
// the others are removed, and `start` gives the missing values. `rare`: offered only while it is in force.
export const CHOICES = {
  Tap: [
    {
      name: "form",
      label: "Vibration",
      options: [
        { name: "mode", label: "one mode", keys: MODE_KEYS, start: (tap) => fromTable(tap) },
        {
          name: "mode_table",
          label: "mode over speed",
          keys: ["mode_table"],
          start: (tap) => ({ mode_table: { speeds_m_per_s: [0.1, 0.3], frequencies_hz: [frequency(tap), frequency(tap)], decay_times_s: [decay(tap), decay(tap)] } }),
        },
        { name: "waveform", label: "recorded waveform", keys: ["waveform"], without: ["second"], start: () => ({ waveform: { rate_hz: 10000, samples: curve() } }) },
      ],
    },
    {
      name: "amplitude",
      label: "Amplitude",
      options: [
        { name: "slope", label: "in proportion to speed", keys: ["attack_slope_per_s"], start: (tap) => ({ attack_slope_per_s: slope(tap) }) },
        { name: "points", label: "by points over speed", keys: ["amplitudes"], start: (tap) => ({ amplitudes: [[0.1, 0.1 * (tap.attack_slope_per_s ?? 400)], [0.3, 0.3 * (tap.attack_slope_per_s ?? 400)]] }) },
      ],
    },
    aimed("tap"),
  ],
  Rupture: [
    {
      name: "breaks",
      label: "Breaks at",
      options: [
        { name: "depth", label: "a depth", keys: ["depth_m"], start: (rupture) => ({ depth_m: depth(rupture) }) },
        { name: "strain", label: "a strain", keys: ["max_strain", "radius_m"], start: (rupture) => strain(rupture) },
      ],
    },
    aimed("rupture"),
  ],
  Grooves: [
    {
      name: "form",
      label: "Rings with",
      only: ({ display }) => display === "vibration",
      options: [
        { name: "tap", label: "the mode of the tap", keys: [], start: () => ({}) },
        { name: "mode", label: "a mode", keys: MODE_KEYS, start: (grooves) => ({ ...modeOf(grooves) }) },
        {
          name: "table",
          label: "a frequency over speed and force",
          keys: ["frequency_table", "decay_time_s", "decay_rate_per_s"],
          is: (grooves) => "frequency_table" in grooves,
          start: (grooves) => ({
            ...decayKeys(grooves),
            frequency_table: { speeds_m_per_s: [0.05, 0.2], forces_n: [0.5, 2], frequencies_hz: [[frequency(grooves), frequency(grooves)], [frequency(grooves), frequency(grooves)]] },
          }),
        },
      ],
    },
  ],
  AutoregressiveModel: [
    {
      name: "loudness",
      label: "Loudness as",
      options: [
        { name: "rms", label: "RMS", keys: ["rms_m_per_s2"], start: () => ({ rms_m_per_s2: 5 }) },
        { name: "variance", label: "variance of the innovation", keys: ["variance_m2_per_s4"], start: () => ({ variance_m2_per_s4: 1 }) },
      ],
    },
  ],
};

function modeOf(value) {
  const rate = "angular_frequency_rad_per_s" in value;
  return { ...(rate ? {} : { frequency_hz: frequency(value) }), ...decayKeys(value) };
}

function fromTable(tap) {
  const table = tap.mode_table;
  return table ? { frequency_hz: table.frequencies_hz[0], decay_time_s: table.decay_times_s[0] } : modeOf(tap);
}

function slope(tap) {
  const [speed, amplitude] = tap.amplitudes?.at(-1) ?? [1, 400];
  return Number((amplitude / speed).toPrecision(4));
}

// depth = R sqrt((1 + strain)^2 - 1), see docs/materials.md.
function depth({ max_strain: strain = 0.1, radius_m: radius = 0.01 }) {
  return Number((radius * Math.sqrt(strain * (2 + strain))).toPrecision(4));
}

function strain({ depth_m: deep = 0.004 }) {
  const radius = 0.01;
  return { radius_m: radius, max_strain: Number((Math.hypot(1, deep / radius) - 1).toPrecision(4)) };
}

// For each display of grooves, the keys that only it has, with their initial values.
const GROOVE_DISPLAYS = {
  vibration: { keys: [...MODE_KEYS, "frequency_table", "velocity_gain_per_s", "force_gain_m_per_s2_per_n"], start: { velocity_gain_per_s: 60, force_gain_m_per_s2_per_n: 6 } },
  geometry: { keys: ["depth_m"], start: { depth_m: 0.0001 } },
  damping: { keys: ["damping_n_s_per_m"], start: { damping_n_s_per_m: 3 } },
};

// Returns the other changes when the display of grooves changes. Strikes get the mode of the tap, if there is one.
export function displayed(grooves, display, tap) {
  const others = Object.entries(GROOVE_DISPLAYS).flatMap(([name, { keys }]) => (name === display ? [] : keys));
  const removed = Object.fromEntries(others.filter((key) => key in grooves).map((key) => [key, null]));
  const rings = tap !== undefined && !("waveform" in tap) && !("mode_table" in tap);
  const mode = display === "vibration" && !rings ? { frequency_hz: 200, decay_time_s: 0.003 } : {};
  return { ...removed, ...GROOVE_DISPLAYS[display].start, ...mode };
}

const present = (option, value) => (option.is ? option.is(value) : option.keys.some((key) => key in value));

// Returns the option of a value: the last one whose keys it has, or else the one that needs no key.
export function chosen(choice, value) {
  return choice.options.findLast((option) => present(option, value)) ?? choice.options.find(({ keys }) => !keys.length) ?? choice.options[0];
}

// Returns the merge patch that changes a value to another option.
export function switchTo(choice, option, value) {
  const start = option.start(value);
  const patch = {};
  for (const key of [...choice.options.flatMap(({ keys }) => keys), ...(option.without ?? [])]) {
    if (key in value && !(option.keys.includes(key) && !(key in start))) {
      patch[key] = null;
    }
  }
  return { ...patch, ...start };
}
