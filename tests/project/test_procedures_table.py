"""The keys of procedures that reference/studies.md lists are those of a study."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from hapticd.experiment.procedures.constant_stimuli import ConstantStimuliParameters
from hapticd.experiment.procedures.quest_plus import QuestPlusParameters
from hapticd.experiment.procedures.staircase import StaircaseParameters

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "studies.md"


@pytest.mark.parametrize(
    ("kind", "parameters"),
    [
        ("staircase", StaircaseParameters),
        ("quest_plus", QuestPlusParameters),
        ("constant_stimuli", ConstantStimuliParameters),
    ],
)
def test_keys_of_a_procedure_are_those_of_the_code(
    kind: str, parameters: type[StaircaseParameters | QuestPlusParameters | ConstantStimuliParameters]
) -> None:
    row = next(line for line in PAGE.read_text().splitlines() if line.startswith(f"| `{kind}` |"))
    needed, optional = (
        set(re.findall(r"`(\w+)`", re.sub(r"\([^)]*\)", "", cell))) for cell in row.strip("| ").split(" | ")[1:]
    )
    fields = {name: field.is_required() for name, field in parameters.model_fields.items() if name != "kind"}
    assert needed == {name for name, required in fields.items() if required}
    assert optional == {name for name, required in fields.items() if not required}
