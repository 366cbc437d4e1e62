"""The inverses of small matrices, one for every frequency of a row."""

from typing import NamedTuple

import numpy as np

from layerfield.kernels.compiled import compiled

_ONE = np.float32(1)  # a whole number would make the rest double


class Terms(NamedTuple):
    """Of g (G + rho I)^-1 + k I: rho; b of b (I - 1/K), added to G at frequency zero; g; and k."""

    rho: float
    balance: float
    gain: float
    kept: float = 0.0


@compiled
def invert(matrix, terms, is_first):
    """Find g (G + rho I)^-1 + k I: sweeps over all pivots end with minus the inverse."""
    number = len(matrix)
    for k in range(number):
        _add(matrix[k, k], terms.rho)
    if is_first:
        _balance(matrix, terms.balance)
    for k in range(number):
        _sweep(matrix, k)
    for k in range(number):
        for m in range(k, number):
            _scale(matrix[k, m], -terms.gain)
        _add(matrix[k, k], terms.kept)


@compiled
def _balance(matrix, balance):
    number = len(matrix)
    for k in range(number):
        for m in range(k, number):
            matrix[k, m, 0] += balance * ((1 if k == m else 0) - 1 / number)


@compiled
def _sweep(matrix, k):
    pivot = matrix[k, k]
    for x in range(len(pivot)):
        pivot[x] = _ONE / pivot[x]
    for i in range(len(matrix)):
        for j in range(i, len(matrix)):
            if k not in (i, j):
                _eliminate(matrix[i, j], _entry(matrix, i, k), _entry(matrix, j, k), pivot)
    for i in range(len(matrix)):
        if i != k:
            _divide(_entry(matrix, i, k), pivot)
    _scale(pivot, np.float32(-1))


@compiled
def _entry(matrix, i, k):
    return matrix[min(i, k), max(i, k)]


@compiled
def _add(entry, number):
    for x in range(len(entry)):
        entry[x] += number


@compiled
def _scale(entry, number):
    for x in range(len(entry)):
        entry[x] *= number


@compiled
def _divide(entry, pivot):
    for x in range(len(entry)):
        entry[x] *= pivot[x]


@compiled
def _eliminate(entry, one, other, pivot):
    for x in range(len(entry)):
        entry[x] -= one[x] * other[x] * pivot[x]
