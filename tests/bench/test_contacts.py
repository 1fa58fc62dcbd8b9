"""A hundred kinds of contact: generator and judge are right by themselves, and some of the contacts are fitted well."""

from __future__ import annotations

import numpy as np
import pytest

from bench.contacts import KINDS, REST, SAMPLES, TAPS, contact, contacts, explained, judged, outcome


def test_contacts_have_seven_samples_of_rest_and_every_kind() -> None:
    every = contacts()
    assert len(every) == 100
    assert {kind: sum(each.kind == kind for each in every) for kind, _ in KINDS} == dict(KINDS)
    for each in every:
        assert each.recorded.shape == (TAPS, SAMPLES)
        assert np.all(each.clean[:, : REST - 1] == 0) and np.all((each.onsets >= REST - 1) & (each.onsets < REST))
    assert np.array_equal(every[3].recorded, contact(3, every[3].kind).recorded)
    assert sum(any(each.clipped) for each in every) >= 3 and sum(sum(each.clipped) for each in every) >= 5


def test_what_a_model_explains_is_the_part_of_the_variance() -> None:
    tap = np.sin(np.arange(100) / 7)
    assert explained(tap, tap + 3) == pytest.approx(1)
    assert explained(tap, 0 * tap) == pytest.approx(0)
    assert explained(tap, 0.5 * tap) == pytest.approx(0.75)


@pytest.mark.slow
def test_the_judge_knows_modes_from_pulses() -> None:
    """Without noise one mode is explained wholly by one, two by two, and a pulse by its shape."""
    shares = {}
    for given in (
        next(each for each in contacts() if each.kind == kind and not any(each.clipped)) for kind, _ in KINDS
    ):
        found = judged(given)
        shares[given.kind] = found
        assert found.two >= found.one - 1e-9
    assert shares["one mode"].one > 0.95
    assert shares["pulse"].wave > 0.95


@pytest.mark.slow
def test_taps_of_some_contacts_are_fitted_and_rendered() -> None:
    """Of ten: none refused, verdicts as the judge's, and what the rendered tap explains."""
    every = [outcome(given) for given in contacts(10)]
    assert [each.refused for each in every] == [""] * len(every)
    assert np.mean([each.agrees for each in every]) >= 0.9
    assert np.median([each.shown for each in every]) >= 0.9
