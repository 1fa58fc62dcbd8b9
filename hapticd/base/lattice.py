"""Conversion between the coefficients and the reflection coefficients of an all-pole filter, with 100 digits.

With A_0 = B_0 = 1, A_m = A_(m-1) + k_m z^-1 B_(m-1) and B_m = k_m A_(m-1) + z^-1 B_(m-1), the all-pole filter 1/A_p has
coefficients a_1 .. a_p, A_p = 1 + sum a_i z^-i, and reflection coefficients k_1 .. k_p (Gray and Markel, 1975). It is
stable if and only if all k_m lie in (-1, 1).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from decimal import Context, Decimal, localcontext
from functools import lru_cache
from typing import Final, TypeAlias

Reflection: TypeAlias = tuple[float, ...]

_LATTICE_CONTEXT: Final = Context(prec=100)
"""Precision of the recursions: 100 digits, since they lose precision in proportion to 1 / prod(1 - k_m^2)."""


def coefficients_of(reflection: Sequence[float]) -> tuple[float, ...]:
    """Return the coefficients a_1 .. a_p of the filter with reflection coefficients k_1 .. k_p (step-up recursion)."""
    with localcontext(_LATTICE_CONTEXT):
        return tuple(float(a) for a in _step_up([Decimal(float(k)) for k in reflection])[1:])


def reflection_of(coefficients: Sequence[float]) -> Reflection:
    """Return the reflection coefficients k_1 .. k_p of a stable filter with coefficients a_1 .. a_p (step-down).

    Raises ValueError if the filter is unstable: the recursion is Jury's test. A reflection coefficient that rounds to
    1 or -1 counts as unstable.
    """
    return _reflection_of(tuple(float(a) for a in coefficients))


@lru_cache(maxsize=1024)
def _reflection_of(coefficients: tuple[float, ...]) -> Reflection:
    with localcontext(_LATTICE_CONTEXT):
        stages, _ = _step_down([Decimal(1), *map(Decimal, coefficients)])
    return stages


def _step_up(reflection: Sequence[Decimal]) -> list[Decimal]:
    polynomial = [Decimal(1)]
    for k in reflection:
        polynomial = [
            a + k * b for a, b in zip([*polynomial, Decimal(0)], [Decimal(0), *polynomial[::-1]], strict=True)
        ]
    return polynomial


def _step_down(polynomial: list[Decimal]) -> tuple[Reflection, list[list[Decimal]]]:
    """Return the reflection coefficients k_1 .. k_p of the polynomial A_p, and the recursion's A_p .. A_0."""
    if not all(a.is_finite() for a in polynomial):
        raise ValueError("coefficients must be finite")
    stages: list[float] = []
    ladder = [polynomial]
    while len(polynomial) > 1:
        k = polynomial[-1]
        if not abs(float(k)) < 1:
            raise ValueError("the filter is not stable: a pole lies on or outside the unit circle")
        stages.append(float(k))
        scale = 1 / ((1 - k) * (1 + k))
        polynomial = [(a - k * b) * scale for a, b in zip(polynomial[:-1], polynomial[:0:-1], strict=True)]
        ladder.append(polynomial)
    return tuple(stages[::-1]), ladder


def _monic(roots: Iterable[complex]) -> list[Decimal]:
    """Return the polynomial in z^-1 whose zeros are `roots`, and the conjugates of those off the real axis."""
    product = [Decimal(1)]
    for root in roots:
        re, im = Decimal(root.real), Decimal(root.imag)
        factor = [Decimal(1), -re] if im == 0 else [Decimal(1), -2 * re, re * re + im * im]
        product = _times(product, factor)
    return product


def _times(a: Sequence[Decimal], b: Sequence[Decimal]) -> list[Decimal]:
    product = [Decimal(0)] * (len(a) + len(b) - 1)
    for i, x in enumerate(a):
        for j, y in enumerate(b):
            product[i + j] += x * y
    return product


def with_poles(reflection: Sequence[float], poles: Iterable[complex]) -> Reflection:
    """Return the reflection coefficients of a filter after `poles`, one of each conjugate pair, were added."""
    with localcontext(_LATTICE_CONTEXT):
        return _step_down(_times(_monic(poles), _step_up([Decimal(k) for k in reflection])))[0]


def realised(poles: Sequence[complex], zeros: Sequence[complex]) -> tuple[Reflection, tuple[float, ...] | None]:
    """Return reflection coefficients and lattice taps of a filter with output power 1 for white noise of power 1.

    `poles` and `zeros` have one of each conjugate pair; zeros may not outnumber poles. With the numerator written as
    sum c_m B_m, and E_m = prod(1 - k_i^2), i <= m, the taps are c_m sqrt(E_m), m = 0 .. p, normalised. Without zeros
    the taps are None.
    """
    with localcontext(_LATTICE_CONTEXT):
        reflection, ladder = _step_down(_monic(poles))
        if not zeros:
            return reflection, None
        numerator = _monic(zeros)
        numerator += [Decimal(0)] * (len(ladder) - len(numerator))
        weights: list[Decimal] = []
        for forward in ladder:
            c = numerator[-1]
            weights.append(c)
            numerator = [n - c * a for n, a in zip(numerator, forward[::-1], strict=True)][:-1]
        error = Decimal(1)
        taps = [weights[-1]]
        for forward, c in zip(ladder[-2::-1], weights[-2::-1], strict=True):
            error *= (1 - forward[-1]) * (1 + forward[-1])
            taps.append(c * error.sqrt())
        norm = sum((v * v for v in taps), Decimal(0)).sqrt()
        return reflection, tuple(float(v / norm) for v in taps)
