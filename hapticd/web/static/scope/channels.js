// The channels of the oscilloscope: one for each quantity along x, along y, and its magnitude.

// The quantities, each with its vertical scale and its colour of style.css.
export const QUANTITIES = [
  { id: "position", label: "Position", scale: "position", unit: "m", x: "x_m", y: "y_m" },
  { id: "velocity", label: "Velocity", scale: "velocity", unit: "m_per_s", x: "vx_m_per_s", y: "vy_m_per_s" },
  { id: "contact", label: "Contact force", scale: "force", unit: "n", x: "contact_x_n", y: "contact_y_n" },
  { id: "vibration", label: "Vibration force", scale: "force", unit: "n", x: "vibration_x_n", y: "vibration_y_n" },
  { id: "force", label: "Total force", scale: "force", unit: "n", x: "force_x_n", y: "force_y_n" },
];

// The vertical scales: an axis shows `factor` times the SI value, in `unit`.
export const SCALES = {
  force: { label: "Force", unit: "N", factor: 1, side: 3 },
  position: { label: "Position", unit: "mm", factor: 1e3, side: 1 },
  velocity: { label: "Velocity", unit: "m/s", factor: 1, side: 1 },
};

const FILE_NAMES = {
  position: "position",
  velocity: "velocity",
  contact: "contact_force",
  vibration: "vibration_force",
  force: "force",
};

// Each channel has `columns`: one of the store, or two of which it is the magnitude; `heading`: its column in a CSV file.
export const CHANNELS = QUANTITIES.flatMap((quantity) =>
  ["x", "y", "magnitude"].map((part) => ({
    id: `${quantity.id}_${part}`,
    quantity: quantity.id,
    part,
    scale: quantity.scale,
    label: `${quantity.label}${part === "magnitude" ? ", magnitude" : ` ${part}`}`,
    columns: part === "magnitude" ? [quantity.x, quantity.y] : [quantity[part]],
    heading: `${FILE_NAMES[quantity.id]}_${part}_${quantity.unit}`,
    unit: SCALES[quantity.scale].unit,
    factor: SCALES[quantity.scale].factor,
  })),
);

export const CHANNEL = Object.fromEntries(CHANNELS.map((channel) => [channel.id, channel]));
