"""Tables of answers as sessions write them. A known rule draws the participants' answers."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from hapticd.base.yaml_text import yaml_text

COLUMNS = (
    *("onset", "duration", "participant", "session", "phase", "block", "trial", "condition", "cell", "repetition"),
    *("stimulus_1", "stimulus_2", "question", "response", "correct", "response_time", "procedure", "level"),
    *("overtravel_m", "peak_force_n", "completion_s", "path_m"),
)
MATERIALS = ("wood", "acrylic", "delrin", "aluminum", "glass", "cast_iron", "steel")
ANSWERS = [{"name": f"answer_{means}", "label": means, "means": means} for means in ("first", "same", "second")]


def write_session(
    root: Path, participant: str, task: str, study: Mapping[str, object], rows: Iterable[Mapping[str, object]]
) -> Path:
    """Write the folder of a session as the runner does, with the given rows. Missing cells are n/a."""
    folder = root / f"sub-{participant}" / "ses-01"
    (folder / "beh").mkdir(parents=True)
    (folder / "study.yaml").write_text(yaml_text(dict(study)))  # type: ignore[arg-type]
    lines = ["\t".join(COLUMNS)]
    for number, row in enumerate(rows):
        filled = {
            **{"onset": number, "duration": 1, "participant": participant, "session": 1, "phase": "test", "block": 0},
            **{"trial": number, "repetition": 0, "question": "q"},
            **row,
        }
        lines.append("\t".join(str(filled.get(name, "n/a")) for name in COLUMNS))
    (folder / "beh" / f"sub-{participant}_ses-01_task-{task}_beh.tsv").write_text("\n".join(lines) + "\n")
    return folder


def tapping(root: Path, people: Sequence[str]) -> None:
    """Write paired comparisons of seven materials: answers are surer the larger the difference in rank."""
    study = {
        "experiment": 1,
        "title": "Which of two surfaces is stiffer?",
        "factors": {"material": {"at": "materials.{place}", "levels": list(MATERIALS)}},
        "conditions": {"force_and_vibration": {}, "vibration_only": {}},
        "trial": {"type": "paired_comparison", "question": "q"},
        "questions": {"q": {"kind": "choice", "answers": ANSWERS}},
        "analysis": {"chance": 1 / 3, "published": "okamura1998.tapping"},
    }
    for number, person in enumerate(people):
        generator = np.random.Generator(np.random.PCG64(number))
        rows = []
        for condition in ("vibration_only", "force_and_vibration"):
            for one in range(7):
                for other in range(one, 7):
                    felt = other - one + generator.normal(0, 1.5)
                    means = "same" if abs(felt) < 1 else "second" if felt > 0 else "first"
                    right = means == ("same" if one == other else "second")
                    names = (MATERIALS[one], MATERIALS[other])
                    rows.append(
                        {
                            **{"condition": condition, "cell": "/".join(names), "correct": int(right)},
                            **{"stimulus_1": names[0], "stimulus_2": names[1], "response": f"answer_{means}"},
                            "response_time": round(float(generator.uniform(1, 4)), 3),
                        }
                    )
        rows.append(
            {"phase": "practice", "condition": "vibration_only", "cell": "wood/wood", "response": "answer_same"}
        )
        rows.append({"condition": "vibration_only", "cell": "wood/wood", "stimulus_1": "wood", "stimulus_2": "wood"})
        write_session(root, person, "tapping", study, rows)


def puncture(root: Path, people: Sequence[str]) -> None:
    """Write a motor study: overtravel is 1 mm less with vibration. The sessions begin without vibration."""
    study = {
        "experiment": 1,
        "title": "Puncture a membrane and stop",
        "conditions": {"with_vibration": {}, "without_vibration": {}},
        "trial": {"type": "motor", "question": "q"},
        "questions": {"q": {"kind": "measure", "measure": "overtravel_m"}},
        "analysis": {"published": "okamura1998.puncture"},
    }
    for number, person in enumerate(people):
        generator = np.random.Generator(np.random.PCG64(100 + number))
        rows = [
            {
                **{"condition": condition, "cell": "base", "stimulus_1": "base"},
                "overtravel_m": float(mean + generator.normal(0, 1e-3)),
                "peak_force_n": float(2 + generator.normal(0, 0.1)),
            }
            for condition, mean in (("without_vibration", 6e-3), ("with_vibration", 5e-3))
            for _ in range(10)
        ]
        write_session(root, person, "puncture", study, rows)


def frequency(root: Path, people: Sequence[str], threshold: float = 40.0) -> None:
    """Write the answers of a Weibull observer in two intervals, at levels on a logarithmic axis."""
    variable = {"name": "frequency_hz", "at": "materials.surface.tap.frequency_hz", "reference": 200, "level": "added"}
    procedure = {"variable": variable, "method": {"kind": "constant_stimuli", "axis": "logarithmic"}}
    study = {
        "experiment": 1,
        "title": "The just noticeable difference of a tap's frequency",
        "trial": {"type": "forced_choice", "procedures": {"down": procedure}},
        "analysis": {"chance": 0.5},
    }
    for number, person in enumerate(people):
        generator = np.random.Generator(np.random.PCG64(200 + number))
        rows = []
        for level in np.repeat([10.0, 20.0, 30.0, 40.0, 60.0, 90.0], 50):
            right = generator.random() < 0.5 + 0.49 * (1 - math.exp(-((level / threshold) ** 2.5)))
            rows.append(
                {
                    **{"condition": "all", "cell": "down", "procedure": "down", "level": level, "correct": int(right)},
                    **{"stimulus_1": "target", "stimulus_2": "reference", "response": "first"},
                }
            )
        write_session(root, person, "frequency", study, rows)


def staircases(
    root: Path, people: Sequence[str], thresholds: Mapping[str, float], harder: str = "lower", highest: float = 90.0
) -> None:
    """Write two procedures of one variable in each cell of a factor. The observer's threshold depends on the cell."""
    variable = {"name": "stiffness_n_per_m", "at": "materials.tested.stiffness_n_per_m", "reference": 400}
    made = {
        "variable": {**variable, "level": "added"},
        "method": {"kind": "constant_stimuli", "guess": 0.5, "rising": harder == "lower"},
    }
    study = {
        "experiment": 1,
        "title": "How much stiffer is felt as stiffer?",
        "trial": {"type": "forced_choice", "cross": ["decay"], "procedures": {"near": made, "far": made}},
    }
    for number, person in enumerate(people):
        generator = np.random.Generator(np.random.PCG64(300 + number))
        rows = []
        for cell, threshold in thresholds.items():
            for level in np.repeat(np.linspace(highest / 6, highest, 6), 60):
                ease = (level - threshold) / 8 * (1 if harder == "lower" else -1)
                right = generator.random() < 0.5 + 0.5 / (1 + math.exp(-ease))
                procedure = f"{generator.choice(('near', 'far'))}.{cell}"
                rows.append(
                    {
                        **{"condition": "all", "cell": cell, "procedure": procedure, "level": level},
                        **{"correct": int(right), "stimulus_1": "target", "stimulus_2": "reference"},
                        "response": "first",
                    }
                )
        write_session(root, person, "staircases", study, rows)


def identification(root: Path, people: Sequence[str]) -> None:
    """Write identifications of seven materials, named by letters. Every fourth answer is the next letter."""
    letters = "ABCDEFG"
    study = {
        "experiment": 1,
        "title": "Identify seven materials",
        "factors": {"material": {"at": "materials.surface", "levels": list(MATERIALS)}},
        "trial": {"type": "identification", "question": "q"},
        "questions": {
            "q": {
                "kind": "choice",
                "answers": [{"name": letter, "level": name} for letter, name in zip(letters, MATERIALS, strict=True)],
            }
        },
        "analysis": {"chance": 1 / 7},
    }
    for person in people:
        rows = []
        for repetition in range(8):
            for place, name in enumerate(MATERIALS):
                answered = (place + (repetition % 4 == 3)) % 7
                rows.append(
                    {
                        **{"condition": "all", "cell": name, "stimulus_1": name, "response": letters[answered]},
                        "correct": int(answered == place),
                    }
                )
        write_session(root, person, "identification", study, rows)


def rating(root: Path, people: Sequence[str]) -> None:
    """Write ratings of two cells: the answers of participant k are 10 k and 20 k."""
    study = {"experiment": 1, "title": "How real does it feel?", "trial": {"type": "rating"}}
    for number, person in enumerate(people, 1):
        rows = [
            {"condition": "all", "cell": cell, "stimulus_1": cell, "response": factor * number}
            for cell, factor in (("wood", 10), ("steel", 20))
        ]
        write_session(root, person, "rating", study, rows)
