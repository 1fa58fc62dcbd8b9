"""Confusion matrices of identification, and the information that answers transfer about stimuli.

Information is in bits: T = sum of p(s, r) log2(p(s, r) / (p(s) p(r))) (Miller and Nicely, J. Acoust. Soc. Am. 27,
1955). Estimated from counts it is too large; the bias to first order is

    (sum over stimuli of (R_s - 1) - (R - 1)) / (2 n ln 2)

with R answers that were given at all, R_s to one stimulus, n trials (Panzeri and Treves, Network 7, 1996; with all
answers given to all stimuli it is Miller's (S - 1)(R - 1) / (2 n ln 2)). What remains is kept between 0 and the
information in the stimuli.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hapticd.analysis.statistics import FitError, Floats, Ints


@dataclass(frozen=True, slots=True)
class Confusion:
    """How often each stimulus got each answer."""

    stimuli: tuple[str, ...]
    answers: tuple[str, ...]
    counts: Ints
    """(stimuli, answers)"""

    @property
    def percent(self) -> Floats:
        """(stimuli, answers) of each stimulus' trials; nan for a stimulus without any."""
        total = self.counts.sum(axis=1, keepdims=True)
        return np.asarray(
            np.divide(100.0 * self.counts, total, out=np.full(self.counts.shape, np.nan), where=total > 0)
        )


@dataclass(frozen=True, slots=True)
class Information:
    """Bits per trial."""

    transfer: float
    """As the counts have it."""
    corrected: float
    """Less the bias."""
    stimuli: float
    """Entropy of the stimuli: the most that can be transferred."""

    @property
    def relative(self) -> float:
        """Corrected transfer over the stimuli's entropy; nan with one stimulus."""
        return self.corrected / self.stimuli if self.stimuli > 0 else float("nan")


def confusion(shown: Sequence[str], answered: Sequence[str], order: Sequence[str] = ()) -> Confusion:
    """The matrix of trials. Stimuli and answers stand in `order`; those that it lacks follow as they come.

    Raises FitError without trials, and for lists of two lengths.
    """
    if len(shown) != len(answered) or not shown:
        raise FitError(f"a confusion matrix needs an answer a trial, has {len(answered)} to {len(shown)} trials")
    stimuli, answers = _in_order(shown, order), _in_order([*_in_order(shown, order), *answered], order)
    counts = np.zeros((len(stimuli), len(answers)), dtype=np.int64)
    for one, other in zip(shown, answered, strict=True):
        counts[stimuli.index(one), answers.index(other)] += 1
    return Confusion(tuple(stimuli), tuple(answers), counts)


def information(counts: npt.ArrayLike) -> Information:
    """Of counts (stimuli, answers). Raises FitError for counts that are none."""
    table = np.asarray(counts, dtype=float)
    total = table.sum()
    if table.ndim != 2 or not (table >= 0).all() or not total > 0:
        raise FitError("information needs counts of stimuli by answers, none negative and one at least")
    joint = table / total
    transfer = _entropy(joint.sum(axis=1)) + _entropy(joint.sum(axis=0)) - _entropy(joint.ravel())
    given = table.sum(axis=1) > 0
    to_each = np.count_nonzero(table[given], axis=1)
    to_any = np.count_nonzero(table.sum(axis=0))
    bias = (float(np.sum(to_each - 1)) - (to_any - 1)) / (2.0 * total * np.log(2.0))
    most = _entropy(joint.sum(axis=1))
    return Information(max(0.0, transfer), float(min(max(transfer - bias, 0.0), most)), most)


def _entropy(probabilities: Floats) -> float:
    """Bits."""
    some = probabilities[probabilities > 0]
    return float(-np.sum(some * np.log2(some))) + 0.0


def _in_order(names: Sequence[str], order: Sequence[str]) -> list[str]:
    present = list(dict.fromkeys(names))
    return [*(name for name in order if name in present), *(name for name in present if name not in order)]
