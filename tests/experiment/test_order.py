"""Orders and sides: balanced by construction, equal for equal seeds, and equally likely over many seeds."""

from __future__ import annotations

from collections import Counter
from itertools import combinations, combinations_with_replacement, pairwise

import numpy as np
import pytest

from hapticd.experiment.order import (
    blocks_of,
    generator_of,
    interleaved,
    latin_order,
    participant_number,
    sides,
    target_positions,
    track_positions,
    williams_row,
    williams_rows,
)

SEEDS = 10_000
FOUR_SIGMA = 4.0


def _even(counts: np.ndarray, total: int) -> None:
    """Assert that counts of equally likely outcomes, and their chi squared, are within 4.5 standard deviations."""
    mean = total / counts.size
    deviation = np.sqrt(mean * (1 - 1 / counts.size))
    assert np.abs(counts - mean).max() < 4.5 * deviation
    chi = float(((counts - mean) ** 2 / mean).sum())
    freedom = counts.size - 1
    assert abs(chi - freedom) < 4.5 * np.sqrt(2 * freedom)


@pytest.mark.parametrize("count", range(1, 13))
def test_a_williams_design_is_balanced_for_position_and_for_what_came_before(count: int) -> None:
    rows = [williams_row(count, row) for row in range(williams_rows(count))]
    for row in rows:
        assert sorted(row) == list(range(count))
    for position in range(count):
        assert set(Counter(row[position] for row in rows).values()) == {len(rows) // count}
    followed = Counter(pair for row in rows for pair in pairwise(row))
    assert len(followed) == count * (count - 1)
    assert len(set(followed.values())) <= 1


def test_participants_in_a_row_get_the_rows_of_the_square() -> None:
    orders = [tuple(latin_order(6, 3, f"P{number:02}", 1)) for number in range(1, 7)]
    assert len(set(orders)) == 6
    for position in range(6):
        assert {order[position] for order in orders} == set(range(6))
    assert latin_order(6, 3, "P07", 1) == latin_order(6, 3, "P01", 1)
    assert latin_order(6, 3, "P01", 2) == latin_order(6, 3, "P02", 1)
    assert latin_order(6, 3, "anna", 1) == latin_order(6, 3, "anna", 1)
    assert participant_number("P07") == 7 and participant_number("anna") is None


@pytest.mark.parametrize("seed", range(200))
def test_sides_are_balanced_for_each_pair_and_for_each_stimulus(seed: int) -> None:
    generator = np.random.default_rng(seed)
    stimuli = int(generator.integers(2, 9))
    repetitions = int(generator.integers(1, 5))
    pairs = [pair for pair in combinations_with_replacement(range(stimuli), 2) for _ in range(repetitions)]
    pairs = [pair[::-1] if generator.integers(2) else pair for pair in pairs]
    turned = sides(pairs, generator_of(seed, "P1", 1))
    shown = [pair[::-1] if back else pair for pair, back in zip(pairs, turned, strict=True) if pair[0] != pair[1]]
    orders = Counter(shown)
    for one, other in combinations(range(stimuli), 2):
        assert orders[one, other] + orders[other, one] == repetitions
        assert abs(orders[one, other] - orders[other, one]) <= 1
    first, second = Counter(pair[0] for pair in shown), Counter(pair[1] for pair in shown)
    for stimulus in range(stimuli):
        assert abs(first[stimulus] - second[stimulus]) <= 1


@pytest.mark.slow
def test_no_order_effect_over_ten_thousand_seeds() -> None:
    """Seven stimuli as in the paper: each pair is at each of 28 positions, in each order, and after each other pair
    equally often."""
    pairs = list(combinations_with_replacement(range(7), 2))
    count = len(pairs)
    places = np.zeros((count, count), dtype=int)
    follows = np.zeros((count, count), dtype=int)
    backwards = np.zeros(count, dtype=int)
    for seed in range(SEEDS):
        generator = generator_of(seed, "P01", 1)
        backwards += sides(pairs, generator)
        order = np.array(blocks_of([0] * count, "random", generator)[0])
        places[order, np.arange(count)] += 1
        follows[order[:-1], order[1:]] += 1
    for row in places:
        _even(row, SEEDS)
    off_diagonal = follows[~np.eye(count, dtype=bool)]
    assert follows.diagonal().sum() == 0
    _even(off_diagonal, SEEDS * (count - 1))
    different = np.array([one != other for one, other in pairs])
    assert np.abs(backwards[different] - SEEDS / 2).max() < FOUR_SIGMA * np.sqrt(SEEDS) / 2
    assert not backwards[~different].any()


def test_blocks_come_in_every_order_equally_often() -> None:
    keys = ["a", "b", "c"] * 2
    seen: Counter[tuple[str, ...]] = Counter()
    for seed in range(3000):
        blocks = blocks_of(keys, "blocked", generator_of(seed, "P1", 1))
        assert sorted(index for block in blocks for index in block) == list(range(6))
        assert all(len({keys[index] for index in block}) == 1 for block in blocks)
        seen[tuple(keys[block[0]] for block in blocks)] += 1
    assert len(seen) == 6
    _even(np.array(list(seen.values())), 3000)


def test_a_square_orders_the_blocks_and_a_list_stays() -> None:
    keys = ["a", "a", "b", "c"]
    blocks = blocks_of(keys, "latin_square", generator_of(1, "P1", 1), [2, 0, 1])
    assert [keys[block[0]] for block in blocks] == ["c", "a", "b"]
    assert blocks_of(keys, "listed", generator_of(1, "P1", 1)) == [[0, 1, 2, 3]]


@pytest.mark.parametrize("seed", range(50))
def test_targets_stand_at_each_position_equally_often(seed: int) -> None:
    counts = [7, 3, 8, 1, 5]
    dealt = target_positions(counts, 3, generator_of(seed, "P1", 1))
    assert [len(cell) for cell in dealt] == counts
    for cell in dealt:
        of_cell = [cell.count(position) for position in range(3)]
        assert max(of_cell) - min(of_cell) <= 1
    together = Counter(position for cell in dealt for position in cell)
    assert max(together.values()) - min(together.values()) <= 1
    track = track_positions(50, 2, generator_of(seed, "P1", 1))
    assert len(track) == 50
    for begin in range(0, 48, 8):
        assert sum(track[begin : begin + 8]) == 4


def test_procedures_are_interleaved_in_rounds() -> None:
    order = interleaved([3, 5, 2], generator_of(4, "P1", 1))
    assert Counter(order) == {0: 3, 1: 5, 2: 2}
    assert sorted(order[:3]) == [0, 1, 2] and sorted(order[3:6]) == [0, 1, 2]
    assert sorted(order[6:8]) == [0, 1] and order[8:] == [1, 1]


def test_the_generator_follows_from_seed_participant_and_session() -> None:
    def first(*key: object) -> int:
        return int(generator_of(*key).integers(2**62))  # type: ignore[arg-type]

    assert first(1, "P01", 1) == first(1, "P01", 1)
    assert len({first(1, "P01", 1), first(2, "P01", 1), first(1, "P02", 1), first(1, "P01", 2), first(1, "", 1)}) == 5
