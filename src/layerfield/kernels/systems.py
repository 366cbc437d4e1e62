"""What the steps of ADMM on one display have in common, and the sums that a step consists of."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from layerfield.kernels.blends import Shares
from layerfield.kernels.compiled import compiled
from layerfield.kernels.inverses import Terms
from layerfield.kernels.spectra import Turns, turns_of
from layerfield.kernels.symbols import Symbol

_ZERO: Any = np.float32(0)  # numbers as all others are: whole ones would make them double
_ONE: Any = np.float32(1)

Steps = Sequence[tuple[float, float, float, float, float]]
"""Penalty, relaxation, trust, kept and momentum of every step, as of `admm_steps.Constants`."""


class System(NamedTuple):
    """G(f), to which every step adds its rho I, and the bounds of layers.

    Args:
        symbol: G(f), of a single row where all are transformed by themselves.
        turns: of the spectrum.
        weight: W, of all views together.
        pull: of the term for frequency zero.
        low: of the bounds.
        high: of the bounds.
        by_row: whether rows are transformed by themselves.
    """

    symbol: Symbol
    turns: Turns
    weight: np.float32
    pull: np.float32
    low: np.float32
    high: np.float32
    by_row: bool


def system_of(
    symbol: Symbol,
    by_row: bool,
    weight: float,
    balance: float,
    bounds: tuple[float, float],
) -> System:
    """Return the system for compiled loops.

    Args:
        symbol: G(f), of an even width.
        by_row: whether rows are transformed by themselves.
        weight: W, of all views together.
        balance: share of it, of the term for frequency zero; not of rows by themselves.
        bounds: of layer pixels.
    """
    pull = 0 if by_row else balance * weight
    low, high = (np.float32(each) for each in bounds)
    known = symbol, turns_of(2 * (symbol.shape[-1] - 1))
    return System(*known, np.float32(weight), np.float32(pull), low, high, by_row)


@compiled
def shares_of_start(weight, number):
    """Of b / (W K), where b stands for s."""
    return Shares(_ZERO, _ONE / (weight * np.float32(number)), _ZERO)


@compiled
def shares_of_data():
    """Of b."""
    return Shares(_ZERO, _ZERO, _ONE)


@compiled
def shares_of_right(constants, weight):
    """Of z - trust (s - z) + b / rho."""
    trust = constants[2]
    return Shares(_ONE + trust, -trust, _ONE / (constants[0] * weight))


@compiled
def shares_of_rest(constants):
    """Of what is added to a x: (1 - a) z + kept (s - z) + momentum (s - s of one step ago)."""
    a, kept, momentum = constants[1], constants[3], constants[4]
    return Shares(_ONE - a - kept, kept + momentum, -momentum)


@compiled
def terms_of(constants, system, points):
    """Of a rho (G + rho I)^-1, over what transforms leave out."""
    rho = constants[0] * system.weight
    return Terms(rho, system.pull, constants[1] * rho / np.float32(points), _ZERO)


@compiled
def terms_of_first(constants, system, number, points):
    """Of what makes z + a (x - z) of b, with x = (G + rho I)^-1 (b + rho z) and z = b / (W K)."""
    rho, a = constants[0] * system.weight, constants[1]
    share = _ONE / (system.weight * np.float32(number))
    gain, kept = a * (_ONE + rho * share), (_ONE - a) * share
    return Terms(rho, system.pull, gain / np.float32(points), kept / np.float32(points))
