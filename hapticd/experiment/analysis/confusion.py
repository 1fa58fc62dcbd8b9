"""Confusion matrices of identification, and the information that answers transfer about stimuli.

Information is in bits: T = sum of p(s, r) log2(p(s, r) / (p(s) p(r))) (Miller and Nicely, J. Acoust. Soc. Am. 27,
1955). The estimate from counts is too large; its first-order bias is

    (sum over stimuli of (R_s - 1) - (R - 1)) / (2 n ln 2)

where n is the number of trials, R that of different answers, and R_s that of different answers to stimulus s (Panzeri
and Treves, Network 7, 1996). If each of S stimuli received all answers, it is Miller's (S - 1)(R - 1) / (2 n ln 2). The
corrected estimate is clipped to the range from 0 to the entropy of the stimuli.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hapticd.analysis.statistics import FitError, Floats, Ints


@dataclass(frozen=True, slots=True)
class Confusion:
    """A confusion matrix: how often each stimulus received each answer."""

    stimuli: tuple[str, ...]
    answers: tuple[str, ...]
    counts: Ints
    """Number of trials, shape (stimuli, answers)."""

    @property
    def percent(self) -> Floats:
        """Percentage (stimuli, answers) of a stimulus's trials with each answer; NaN for a stimulus without trials."""
        total = self.counts.sum(axis=1, keepdims=True)
        return np.asarray(
            np.divide(100.0 * self.counts, total, out=np.full(self.counts.shape, np.nan), where=total > 0)
        )


@dataclass(frozen=True, slots=True)
class Information:
    """Information that answers transfer about stimuli, in bits per trial."""

    transfer: float
    """Estimate of the transfer, from the counts."""
    corrected: float
    """Estimate of the transfer minus its bias."""
    stimuli: float
    """Entropy of the stimuli, the largest possible transfer."""

    @property
    def relative(self) -> float:
        """Corrected transfer divided by the entropy of the stimuli; NaN for a single stimulus."""
        return self.corrected / self.stimuli if self.stimuli > 0 else float("nan")


def confusion(shown: Sequence[str], answered: Sequence[str], order: Sequence[str] = ()) -> Confusion:
    """Return the confusion matrix of trials, from the stimulus shown and the answer given in each trial.

    Stimuli and answers are sorted as in `order`; other names follow, in the order of the trials. Raises FitError
    without trials, and if the numbers of stimuli and answers differ.
    """
    if len(shown) != len(answered) or not shown:
        raise FitError(f"a confusion matrix needs one answer per trial, has {len(answered)} for {len(shown)} trials")
    stimuli, answers = _in_order(shown, order), _in_order([*_in_order(shown, order), *answered], order)
    counts = np.zeros((len(stimuli), len(answers)), dtype=np.int64)
    for one, other in zip(shown, answered, strict=True):
        counts[stimuli.index(one), answers.index(other)] += 1
    return Confusion(tuple(stimuli), tuple(answers), counts)


def information(counts: npt.ArrayLike) -> Information:
    """Return the information transfer, from the counts (stimuli, answers) of a confusion matrix.

    Raises FitError for negative counts, or without counts.
    """
    table = np.asarray(counts, dtype=float)
    total = table.sum()
    if table.ndim != 2 or not (table >= 0).all() or not total > 0:
        raise FitError(
            "counts must be a table of stimuli by answers, without negative counts and with at least one trial"
        )
    joint = table / total
    transfer = _entropy(joint.sum(axis=1)) + _entropy(joint.sum(axis=0)) - _entropy(joint.ravel())
    given = table.sum(axis=1) > 0
    to_each = np.count_nonzero(table[given], axis=1)
    to_any = np.count_nonzero(table.sum(axis=0))
    bias = (float(np.sum(to_each - 1)) - (to_any - 1)) / (2.0 * total * np.log(2.0))
    most = _entropy(joint.sum(axis=1))
    return Information(max(0.0, transfer), float(min(max(transfer - bias, 0.0), most)), most)


def _entropy(probabilities: Floats) -> float:
    """Return the entropy of a probability distribution, in bits."""
    some = probabilities[probabilities > 0]
    return float(-np.sum(some * np.log2(some))) + 0.0


def _in_order(names: Sequence[str], order: Sequence[str]) -> list[str]:
    present = list(dict.fromkeys(names))
    return [*(name for name in order if name in present), *(name for name in present if name not in order)]
