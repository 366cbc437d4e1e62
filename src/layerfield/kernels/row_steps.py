"""Projected Newton steps on rows of pixels that know nothing of each other.

Each is a system of its own, with one matrix H for all; see `RowNewton`, whose formulas these are.
Eight rows go together (`row_lanes`), and all steps of theirs are made while they are in the cache.
"""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.kernels.compiled import compiled, native
from layerfield.kernels.radices import LANES

CHUNK = 8  # entries of a row that are found together
TAPS = 4  # sums that go on side by side: every addition waits for the one before
KEPT = 64  # unknowns whose equations are kept, behind those that the next one reaches
_ZERO, _ONE, _HALF = np.float32(0), np.float32(1), np.float32(0.5)
_MOST = np.float32(1e12)  # that a penalty is multiplied by
CLOSE = 1e-6  # a share of its energy, by which that of a row may seem to grow


class RowMatrix(NamedTuple):
    """H for compiled loops; see `row_lanes`.

    Args:
        offsets: of what every unknown knows, from `reach` before it on.
        entries: beside them.
        inverses: 1 / H_ii, or 0.
        ahead: H_id, d = 0 .. reach, and zeros behind them.
        reach: the largest d.
    """

    offsets: np.ndarray
    entries: np.ndarray
    inverses: np.ndarray
    ahead: np.ndarray
    reach: int


class RowRules(NamedTuple):
    """How steps are made.

    Args:
        first: sweeps before the first step.
        sweeps: behind every step.
        steps: how many.
        share: of the fall that is tried.
        prox: rho.
        growth: that of a row is multiplied by, where a step did not help.
        bounds: of unknowns.
    """

    first: int
    sweeps: int
    steps: int
    share: np.float32
    prox: np.float32
    growth: np.float32
    bounds: np.ndarray


def matrix_of(ahead: np.ndarray) -> RowMatrix:
    """Return H, given by its entries on the diagonal and behind it.

    Args:
        ahead: H_id, d = 0 .. reach, zero beyond the last unknown.
    """
    number, width = ahead.shape
    reach = width - 1
    both = np.zeros((number, 2 * reach + 1))
    for d in range(width):
        both[: number - d, reach + d] = both[d:, reach - d] = ahead[: number - d, d]
    known = both != 0
    taps = int(known.sum(axis=1).max())
    taps += -taps % TAPS
    offsets, entries = np.full((number, taps), reach), np.zeros((number, taps), np.float32)
    place = known.cumsum(axis=1) - 1
    rows, columns = known.nonzero()
    offsets[rows, place[known]], entries[rows, place[known]] = columns, both[known]
    own = ahead[:, 0]
    inverses = np.divide(1, own, out=np.zeros(number), where=own > 0).astype(np.float32)
    behind = np.zeros((number, width - 1 + CHUNK), np.float32)
    behind[:, :width] = ahead
    return RowMatrix(offsets.ravel(), entries.ravel(), inverses, behind.ravel(), reach)


def newton_steps(
    layers: Float[Tensor, "*batch layer c y x"],
    data: Float[Tensor, "*batch layer c y x"],
    factors: Float[Tensor, "*batch c y"],
    matrix: RowMatrix,
    rules: RowRules,
) -> tuple[Float[Tensor, "*batch layer c y x"], Float[Tensor, "*batch c y"]]:
    """Return layers after some steps, and what rho is multiplied by for every row.

    Args:
        layers: within bounds, single precision.
        data: b.
        factors: what rho was multiplied by.
        matrix: H.
        rules: how steps are made.
    """
    lined_up = torch.contiguous_format
    made, by_row = (each.clone(memory_format=lined_up) for each in (layers, factors))
    shape = layers.shape[-4:]
    planes, seen = (each.reshape(-1, *shape).numpy() for each in (made, data.contiguous()))
    rows = by_row.view(-1, *factors.shape[-2:]).numpy()
    number, _, colours, height, _ = planes.shape
    groups = number * colours * -(-height // LANES)
    work = planes.size * max(1, rules.steps)
    step_rows.in_spans(planes, seen, rows, matrix, rules, count=groups, numbers=work)
    return made, by_row


_find_fall = native("layerfield.kernels.row_lanes", "find_fall")
_relax = native("layerfield.kernels.row_lanes", "relax")
_eliminate = native("layerfield.kernels.row_lanes", "eliminate")
_settle = native("layerfield.kernels.row_lanes", "settle")
_substitute = native("layerfield.kernels.row_lanes", "substitute")


class _Lanes(NamedTuple):
    """What eight rows are solved with; see `row_lanes`."""

    x: np.ndarray
    data: np.ndarray
    fall: np.ndarray
    moves: np.ndarray
    left: np.ndarray
    factor: np.ndarray
    prox: np.ndarray
    share: np.ndarray


@compiled
def _falls(lanes, matrix):
    """Find g = b - H x."""
    number = len(matrix.inverses)
    taps = len(matrix.entries) // number
    for i in range(number):
        _find_fall(matrix.offsets, matrix.entries, taps, lanes.x, lanes.data, lanes.fall, i)


@compiled
def _sweep(lanes, matrix, bounds):
    """Relax one unknown after the other."""
    number = len(matrix.inverses)
    taps = len(matrix.entries) // number
    for i in range(number):
        _relax(
            matrix.offsets,
            matrix.entries,
            taps,
            lanes.x,
            lanes.data,
            matrix.inverses,
            bounds,
            i,
            matrix.reach,
        )


@compiled
def carry(left, first, pitch, reach):
    """Keep the equations of those before that the next unknowns know; before the first are none."""
    for n in range(reach * pitch * LANES):
        left[n] = left[KEPT * pitch * LANES + n] if first > 0 else _ZERO


@compiled
def settle(lanes, bounds, pitch, place, i, reach):
    """Take the step of an unknown, or leave it at a bound."""
    _settle(
        lanes.left,
        pitch,
        place,
        lanes.factor,
        lanes.moves,
        lanes.x,
        lanes.fall,
        lanes.prox,
        lanes.share,
        bounds,
        i,
        reach,
    )


@compiled
def go_back(lanes, bounds, number, reach):
    """Take the unknowns behind each into its step, from the last to the first."""
    for behind in range(number):
        i, far = number - 1 - behind, min(reach, behind)
        _substitute(lanes.factor, lanes.moves, lanes.x, bounds, i, reach, far)


@compiled
def _newton(lanes, matrix, rules):
    """Solve for all unknowns that do not stay at bounds."""
    number, reach = len(matrix.inverses), matrix.reach
    pitch = len(matrix.ahead) // number
    lanes.moves[:] = lanes.fall
    for first in range(0, number, KEPT):
        carry(lanes.left, first, pitch, reach)
        for i in range(first, min(number, first + KEPT)):
            place = i - first + reach
            _eliminate(matrix.ahead, pitch, lanes.left, place, lanes.factor, lanes.moves, i, reach)
            settle(lanes, rules.bounds, pitch, place, i, reach)
    go_back(lanes, rules.bounds, number, reach)


@compiled
def _energy(lanes, reach, energy):
    """Find x H x / 2 - b x of every row."""
    energy[:] = 0.0
    for n in range(len(lanes.data)):
        value = lanes.x[reach * LANES + n] * (lanes.data[n] + lanes.fall[n])
        energy[n % LANES] -= np.float64(_HALF * value)


@compiled
def judge(x, kept, factors, energy, found, growth):
    """Take rows back whose energy has grown, and say whether there are any."""
    some = False
    for lane in range(LANES):
        if found[lane] > energy[lane] + CLOSE * abs(energy[lane]):
            for n in range(lane, len(kept), LANES):
                x[n] = kept[n]
            factors[lane] = min(factors[lane] * growth, _MOST)
            some = True
        else:
            energy[lane] = found[lane]
            factors[lane] = max(_ONE, _HALF * factors[lane])
    return some


@compiled
def take(planes, lanes, before, first):
    """Put rows side by side, eight from `first` on; behind the last of a picture it again.

    Pixels of all planes go column by column, behind so many other lanes.
    """
    count, height, width = planes.shape
    for lane in range(LANES):
        y = min(first + lane, height - 1)
        for k in range(count):
            for x in range(width):
                lanes[(before + x * count + k) * LANES + lane] = planes[k, y, x]


@compiled
def give(planes, lanes, before, first):
    """Put back what `take` took."""
    count, height, width = planes.shape
    for lane in range(min(LANES, height - first)):
        for k in range(count):
            for x in range(width):
                planes[k, first + lane, x] = lanes[(before + x * count + k) * LANES + lane]


@compiled
def _solve(lanes, kept, factors, energies, matrix, rules):
    """Make all steps of eight rows."""
    reach = matrix.reach
    energy, found = energies
    for _ in range(rules.first):
        _sweep(lanes, matrix, rules.bounds)
    _falls(lanes, matrix)
    _energy(lanes, reach, energy)
    for _ in range(rules.steps):
        kept[:] = lanes.x
        lanes.prox[:] = rules.prox * factors
        _newton(lanes, matrix, rules)
        for _ in range(rules.sweeps):
            _sweep(lanes, matrix, rules.bounds)
        _falls(lanes, matrix)
        _energy(lanes, reach, found)
        if judge(lanes.x, kept, factors, energy, found, rules.growth):
            _falls(lanes, matrix)


@compiled
def step_rows(layers, data, by_row, matrix, rules, begin, end):
    """Make all steps of groups of eight rows."""
    colours, height = layers.shape[2:4]
    number, reach = len(matrix.inverses), matrix.reach
    pitch = len(matrix.ahead) // number
    groups = -(-height // LANES)
    lanes = _Lanes(
        np.zeros((number + 2 * reach) * LANES, np.float32),
        np.empty(number * LANES, np.float32),
        np.empty(number * LANES, np.float32),
        np.empty(number * LANES, np.float32),
        np.zeros((KEPT + reach) * pitch * LANES, np.float32),
        np.empty(number * reach * LANES, np.float32),
        np.empty(LANES, np.float32),
        np.full(LANES, rules.share, np.float32),
    )
    kept, factors = np.empty_like(lanes.x), np.empty(LANES, np.float32)
    energies = np.empty(LANES, np.float64), np.empty(LANES, np.float64)
    for group in range(begin, end):
        plane, first = group // groups, group % groups * LANES
        n, c = plane // colours, plane % colours
        for lane in range(LANES):
            factors[lane] = by_row[n, c, min(first + lane, height - 1)]
        take(layers[n, :, c], lanes.x, reach, first)
        take(data[n, :, c], lanes.data, 0, first)
        _solve(lanes, kept, factors, energies, matrix, rules)
        give(layers[n, :, c], lanes.x, reach, first)
        count = min(LANES, height - first)
        by_row[n, c, first : first + count] = factors[:count]
