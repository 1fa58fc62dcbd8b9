// Labels of keys in the editors, typical values, and initial values of optional blocks.

// By key, or by definition and key if a key has several meanings.
const LABELS = {
  stiffness_n_per_m: "Stiffness",
  damping_n_s_per_m: "Damping",
  angular_frequency_rad_per_s: "Frequency",
  frequency_hz: "Frequency",
  decay_time_s: "Decay time",
  decay_rate_per_s: "Decay rate",
  attack_slope_per_s: "Amplitude per speed",
  attack: "Amplitude means",
  amplitudes: "Amplitude over speed",
  mode_table: "Mode over speed",
  second: "Second mode",
  angle_rad: "Angle",
  display: "Displayed as",
  velocity_gain_per_s: "Gain with speed",
  force_gain_m_per_s2_per_n: "Gain with force",
  threshold_m_per_s: "Fades below",
  rms_m_per_s2: "RMS",
  variance_m2_per_s4: "Innovation variance",
  max_strain: "Largest strain",
  heals: "Closes again",
  point_m: "Point of the surface",
  center_m: "Middle",
  size_m: "Size",
  patch_ramp_m: "Ramp between patches",
  ramp_s: "Ramp",
  force_n: "Force",
  "Rupture.depth_m": "Rupture depth",
  "Grooves.depth_m": "Groove depth",
  "Grooves.width_m": "Groove width",
  "Friction.stiffness_n_per_m": "Stiffness at rest",
  "Wall.normal": "Faces",
  "Membrane.normal": "Across",
  "Display.force": "Contact force",
  "Scene.display": "Displayed",
  "Stochastic.direction": "Acts along",
  "Autoregressive.direction": "Acts along",
  "Stochastic.mean_hz": "Mean frequency",
  "Stochastic.peak_hz": "Peak frequency",
  provenance: "Origin of the figures",
};

// Labels of the values of enumerations.
const VALUES = {
  "Tap.attack.coefficient": "coefficient A",
  "Tap.attack.first_peak": "first peak",
  "Grooves.display.vibration": "strikes",
  "Grooves.display.geometry": "shape",
  "Grooves.display.damping": "drag",
  "Stochastic.direction.tangent": "the surface",
  "Stochastic.direction.normal": "the normal",
  "Autoregressive.direction.tangent": "the surface",
  "Autoregressive.direction.normal": "the normal",
  "Scene.passivity.off": "off",
  "Scene.passivity.observe": "observed",
  "Scene.passivity.control": "controlled",
};

export const TEXTURES = { grooves: "grooves", stochastic: "noise (sandpaper)", autoregressive: "recorded noise" };

export const KINDS = {
  wall: "Wall",
  box: "Box",
  disc: "Disc",
  membrane: "Membrane",
  spring: "Spring field",
  viscous: "Viscous field",
  constant: "Constant force",
};

export function labelOf(definition, key) {
  const found = LABELS[`${definition}.${key}`] ?? LABELS[key];
  if (found !== undefined) {
    return found;
  }
  const plain = key.replace(/_(hz|m|n|s|rad|m_per_s)$/, "").replaceAll("_", " ");
  return plain[0].toUpperCase() + plain.slice(1);
}

export const valueLabel = (definition, key, value) => VALUES[`${definition}.${key}.${value}`] ?? String(value).replaceAll("_", " ");

// Typical values by key, or else by unit: the middle of a slider if the current value is 0.
const TYPICAL = {
  "Friction.coefficient": 0.5,
  damping_n_s_per_m: 1,
  velocity_gain_per_s: 30,
  force_gain_m_per_s2_per_n: 3,
  ratio: 1,
  angle_rad: Math.PI,
};
const TYPICAL_BY_UNIT = { m: 0.075, N: 1, "N/m": 800, "1/s": 300, "m/s^2": 30, Hz: 200, s: 0.005, "m/s": 0.05, rad: Math.PI };

export const typicalOf = (definition, key, unit) =>
  TYPICAL[`${definition}.${key}`] ?? TYPICAL[key] ?? TYPICAL_BY_UNIT[unit] ?? 1;

// Initial values of an added block; `material` is the complete material.
export const BLOCKS = {
  tap: () => ({ frequency_hz: 200, decay_time_s: 0.005, attack_slope_per_s: 400, attack: "coefficient" }),
  friction: () => ({ coefficient: 0.3, stiffness_n_per_m: 500 }),
  texture: () => TEXTURE_STARTS.grooves(),
  rupture: () => ({ depth_m: 0.004, amplitude_m_per_s2: 38, frequency_hz: 200, decay_time_s: 0.003, heals: true }),
  second: (tap) => ({
    frequency_hz: Math.min(2 * (tap.frequency_hz ?? (tap.angular_frequency_rad_per_s ?? 1000) / (2 * Math.PI)), 100000),
    decay_time_s: Number((0.5 * (tap.decay_time_s ?? 1 / (tap.decay_rate_per_s ?? 200))).toPrecision(3)),
    ratio: 0.5,
  }),
};

const NOISE = { threshold_m_per_s: 0.002, direction: "tangent", seed: 1 };

export const TEXTURE_STARTS = {
  grooves: () => ({
    kind: "grooves",
    display: "vibration",
    spacing_m: 0.002,
    width_m: 0.0005,
    velocity_gain_per_s: 60,
    force_gain_m_per_s2_per_n: 6,
    frequency_hz: 200,
    decay_time_s: 0.003,
  }),
  stochastic: () => ({
    kind: "stochastic",
    peak_hz: 200,
    mean_hz: 250,
    velocity_gain_per_s: 20,
    force_gain_m_per_s2_per_n: 2,
    ...NOISE,
  }),
  autoregressive: () => ({ kind: "autoregressive", rate_hz: 2000, models: [{ ...MODEL }], ...NOISE }),
};

// A model of recorded noise with a peak at 200 Hz: two poles at 0.9.
export const MODEL = {
  speed_m_per_s: 0.1,
  force_n: 1,
  coefficients: [-1.4562, 0.81],
  rms_m_per_s2: 5,
};
