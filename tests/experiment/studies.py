"""Valid studies, one of each kind, as text for tests to change."""

from __future__ import annotations

PAIRS = """\
experiment: 1
title: Which is stiffer?
instructions: Tap both.
base:
  materials: {left: wood, right: wood}
  scene:
    objects:
      left: {kind: box, center_m: [-0.03, -0.03], size_m: [0.05, 0.04], material: left}
      right: {kind: box, center_m: [0.03, -0.03], size_m: [0.05, 0.04], material: right}
places: [left, right]
factors:
  material:
    at: "materials.{place}"
    levels: [wood, acrylic, glass, steel]
conditions:
  both: {}
  alone: {changes: {scene: {display: {force: false}}}}
trial:
  type: paired_comparison
  presentation: places
  cross: [material]
  with_itself: true
  question: stiffer
order: {kind: blocked, by: condition}
practice: {trials: 2}
breaks: {every_trials: 5, least_s: 10}
questions:
  stiffer:
    kind: choice
    text: Which is stiffer?
    answers:
      - {name: first, label: Left, key: "1", means: first}
      - {name: same, label: Same, key: "2", means: same}
      - {name: second, label: Right, key: "3", means: second}
    asks: {factor: material, which: highest}
feedback: correctness
analysis: {published: okamura1998.tapping}
"""

ADAPTIVE = """\
experiment: 1
title: Which rings higher?
instructions: Tap both.
base:
  materials:
    surface: {stiffness_n_per_m: 800, tap: {attack_slope_per_s: 400, frequency_hz: 200, decay_time_s: 0.01}}
  scene:
    objects:
      floor: {kind: wall, point_m: [0, 0], normal: [0, 1], material: surface}
trial:
  type: forced_choice
  question: higher
  procedures:
    one:
      variable: {name: frequency_hz, at: materials.surface.tap.frequency_hz, reference: 200, level: added}
      method: {kind: staircase, rule: 1-up-2-down, start: 50, least: 1, most: 200, steps: [10, 5], trials: 20}
      practice_level: 100
    two:
      variable: {name: frequency_hz, at: materials.surface.tap.frequency_hz, reference: 200, level: factor}
      method: {kind: staircase, rule: 1-up-1-down, start: 1.5, least: 1.01, most: 2, steps: [0.1], trials: 15}
      practice_level: 2
practice: {trials: 3}
questions:
  higher:
    kind: choice
    text: Which rings higher?
    answers:
      - {name: first, label: The first, key: "1", means: first}
      - {name: second, label: The second, key: "2", means: second}
"""

LISTED = """\
experiment: 1
title: Which material?
instructions: Tap it.
base:
  materials: {surface: wood}
  scene:
    objects:
      floor: {kind: wall, point_m: [0, 0], normal: [0, 1], material: surface}
factors:
  material:
    at: materials.surface
    levels: [wood, steel]
conditions:
  first: {}
  second: {}
trial:
  type: identification
  question: which
  list:
    - {stimuli: [{material: wood}], condition: first}
    - {stimuli: [{material: steel}], repetitions: 2}
questions:
  which:
    kind: choice
    text: Which?
    answers:
      - {name: A, label: A, key: a, level: wood}
      - {name: B, label: B, key: b, level: steel}
"""

RATING = """\
experiment: 1
title: How real?
instructions: Tap it.
base:
  materials: {surface: wood}
  scene:
    objects:
      floor: {kind: wall, point_m: [0, 0], normal: [0, 1], material: surface}
factors:
  stiffness:
    at: materials.surface.stiffness_n_per_m
    levels: [400, 800]
  display:
    variants:
      silent: {scene: {display: {vibration: false}}}
      ringing: {scene: {display: {vibration: true}}}
trial:
  type: rating
  cross: [stiffness, display]
  question: real
  measures: [peak_force_n]
repetitions: 3
order: {kind: latin_square, by: cell}
questions:
  real: {kind: slider, text: "How real?", low: 0, high: 10, step: 1}
time_limit_s: 30
"""

CONSTANT = """\
experiment: 1
title: Which is stiffer?
instructions: Tap all.
base:
  materials: {surface: wood}
  scene:
    objects:
      floor: {kind: wall, point_m: [0, 0], normal: [0, 1], material: surface}
factors:
  stiffness:
    at: materials.surface.stiffness_n_per_m
    levels: [600, 700, 900, 1000]
trial:
  type: forced_choice
  alternatives: 3
  cross: [stiffness]
  reference: {stiffness: 800}
  question: odd
repetitions: 7
questions:
  odd:
    kind: choice
    text: Which is unlike the others?
    answers:
      - {name: one, label: The first, means: first}
      - {name: two, label: The second, means: second}
      - {name: three, label: The third, means: third}
"""
