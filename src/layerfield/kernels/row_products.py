"""Projected Gauss-Newton steps on rows of pixels whose light is multiplied.

Every row is a problem of its own, with a matrix of its own that changes from step to step; see
`RowGaussNewton`, whose formulas these are. Eight rows go together, as in `row_steps`.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.kernels.compiled import compiled, native
from layerfield.kernels.light_paths import LightPaths
from layerfield.kernels.radices import LANES
from layerfield.kernels.row_steps import CHUNK, KEPT, carry, give, go_back, judge, settle, take
from layerfield.projection import Projection
from layerfield.row_system import row_reach

_ONE, _HALF = np.float32(1), np.float32(0.5)


class RowPaths(NamedTuple):
    """The light paths of a row, by the unknowns that they go through and by view pixels.

    Unknowns are numbered column by column; a place is such a number, and `reach` more.

    Args:
        begins: of every unknown the number of its first path; and the number of all.
        lights: of every path the number of its view pixel.
        weights: of every path.
        others: of every path the places of the other unknowns on it.
        pixels: numbers of view pixels, view by view; of views that count.
        places: of each of them the places of all unknowns on its path.
        shares: of each of them its weight.
        reach: how far unknowns on a path are apart.
    """

    begins: np.ndarray
    lights: np.ndarray
    weights: np.ndarray
    others: np.ndarray
    pixels: np.ndarray
    places: np.ndarray
    shares: np.ndarray
    reach: int


class ProductRules(NamedTuple):
    """How steps are made.

    Args:
        first: sweeps before the first step.
        sweeps: behind every step.
        steps: how many.
        prox: rho, as a share of H_ii and a little more.
        least: that, as a share of the weights of all views.
        growth: what rho of a row is multiplied by, where a step did not help.
        bounds: of unknowns.
    """

    first: int
    sweeps: int
    steps: int
    prox: np.float32
    least: np.float32
    growth: np.float32
    bounds: np.ndarray


def paths_of(projection: Projection, weights: Sequence[float], width: int) -> RowPaths:
    """Return the paths of a row.

    Args:
        projection: of views in a row, and of whole pixels.
        weights: of the views; those of 0 have no paths.
        width: of the views.
    """
    layers, margin = len(projection.shifts[0]), projection.margin[1]
    reach, number = row_reach(projection), layers * (width + 2 * margin)
    shown = np.flatnonzero(np.asarray(weights) > 0)
    lefts = np.array([[taps[0][1] for taps in projection.taps[view]] for view in shown])
    columns = np.arange(width)[:, None] + lefts[:, None, :]  # [view, x, layer]
    unknowns = (columns * layers + np.arange(layers)).reshape(-1, layers)
    pixels = (shown[:, None] * width + np.arange(width)).ravel()
    shares = np.repeat(np.asarray(weights, np.float32)[shown], width)
    owners = unknowns.ravel()
    order = np.argsort(owners, kind="stable")
    pixel, layer = np.divmod(order, layers)
    beside = [[j for j in range(layers) if j != k] for k in range(layers)]
    others = np.take_along_axis(unknowns[pixel], np.array(beside, np.int64)[layer], axis=1)
    return RowPaths(
        np.searchsorted(owners[order], np.arange(number + 1)),
        pixels[pixel],
        shares[pixel],
        (others + reach).ravel(),
        pixels,
        (unknowns + reach).ravel(),
        shares,
        reach,
    )


def product_steps(
    layers: Float[Tensor, "*batch 1 layer c y x"],
    light_paths: LightPaths,
    factors: Float[Tensor, "*batch 1 c y"],
    paths: RowPaths,
    rules: ProductRules,
) -> tuple[Float[Tensor, "*batch 1 layer c y x"], Float[Tensor, "*batch 1 c y"]]:
    """Return layers after some steps, and what rho is multiplied by for every row.

    Args:
        layers: within bounds, single precision.
        light_paths: what is to be shown.
        factors: what rho was multiplied by.
        paths: of a row.
        rules: how steps are made.
    """
    light_paths.expect(layers, layers.shape[-4])
    lined_up = torch.contiguous_format
    made, by_row = (each.clone(memory_format=lined_up) for each in (layers, factors))
    planes = made.view(-1, *layers.shape[-4:]).numpy()
    rows = by_row.view(-1, *factors.shape[-2:]).numpy()
    views, unit = light_paths.arrays, np.float32(light_paths.unit)
    number, _, colours, height, _ = planes.shape
    groups = number * colours * -(-height // LANES)
    work = planes.size * max(1, rules.steps)
    given = planes, views.stored, views.table, unit, rows, paths, rules
    step_products.in_spans(*given, count=groups, numbers=work)
    return made, by_row


_relax = native("layerfield.kernels.row_lanes", "relax_product")
_find_equation = native("layerfield.kernels.row_lanes", "find_equation")
_eliminate = native("layerfield.kernels.row_lanes", "eliminate_from")


class _Lanes(NamedTuple):
    """What eight rows are solved with; see `row_lanes`."""

    x: np.ndarray
    light: np.ndarray
    fall: np.ndarray
    moves: np.ndarray
    left: np.ndarray
    factor: np.ndarray
    prox: np.ndarray
    share: np.ndarray


@compiled
def _sweep(lanes, paths, bounds):
    """Relax one unknown after the other."""
    number = len(paths.begins) - 1
    count = len(paths.others) // len(paths.lights)
    for i in range(number):
        _relax(
            paths.lights,
            paths.weights,
            paths.others,
            count,
            paths.begins[i],
            paths.begins[i + 1],
            lanes.x,
            lanes.light,
            bounds,
            i + paths.reach,
        )


@compiled
def _newton(lanes, paths, factors, rules):
    """Solve for all unknowns that do not stay at bounds."""
    number, reach = len(paths.begins) - 1, paths.reach
    count, pitch = len(paths.others) // len(paths.lights), reach + CHUNK
    for first in range(0, number, KEPT):
        carry(lanes.left, first, pitch, reach)
        for i in range(first, min(number, first + KEPT)):
            place = i - first + reach
            _find_equation(
                paths.lights,
                paths.weights,
                paths.others,
                count,
                paths.begins[i],
                paths.begins[i + 1],
                lanes.x,
                lanes.light,
                lanes.left,
                pitch,
                place,
                lanes.fall,
                lanes.moves,
                lanes.share,
                i,
                reach,
            )
            for lane in range(LANES):
                bent = lanes.left[place * pitch * LANES + lane]
                lanes.prox[lane] = rules.prox * factors[lane] * (bent + rules.least)
            _eliminate(pitch, lanes.left, place, lanes.factor, lanes.moves, i, reach)
            settle(lanes, rules.bounds, pitch, place, i, reach)
    go_back(lanes, rules.bounds, number, reach)


@compiled
def _energy(lanes, paths, energy):
    """Find half the error of every row."""
    layers = len(paths.places) // len(paths.pixels)
    energy[:] = 0.0
    for n in range(len(paths.pixels)):
        for lane in range(LANES):
            shown = _ONE
            for k in range(layers):
                shown *= lanes.x[paths.places[n * layers + k] * LANES + lane]
            off = shown - lanes.light[paths.pixels[n] * LANES + lane]
            energy[lane] += np.float64(_HALF * paths.shares[n] * off * off)


@compiled
def _light(views, table, unit, light, first):
    """Put what rows of views are to show side by side, eight from `first` on."""
    count, height, width = views.shape
    for lane in range(LANES):
        y = min(first + lane, height - 1)
        for view in range(count):
            for x in range(width):
                stored = views[view, y, x]
                value = table[int(stored)] if len(table) else np.float32(stored) / unit
                light[(view * width + x) * LANES + lane] = value


@compiled
def _solve(lanes, kept, factors, energies, paths, rules):
    """Make all steps of eight rows."""
    energy, found = energies
    for _ in range(rules.first):
        _sweep(lanes, paths, rules.bounds)
    _energy(lanes, paths, energy)
    for _ in range(rules.steps):
        kept[:] = lanes.x
        _newton(lanes, paths, factors, rules)
        for _ in range(rules.sweeps):
            _sweep(lanes, paths, rules.bounds)
        _energy(lanes, paths, found)
        judge(lanes.x, kept, factors, energy, found, rules.growth)


@compiled
def step_products(layers, views, table, unit, by_row, paths, rules, begin, end):
    """Make all steps of groups of eight rows."""
    colours, height = layers.shape[2:4]
    number, reach = len(paths.begins) - 1, paths.reach
    groups = -(-height // LANES)
    lanes = _Lanes(
        np.zeros((number + 2 * reach) * LANES, np.float32),
        np.empty(views.shape[1] * views.shape[4] * LANES, np.float32),
        np.empty(number * LANES, np.float32),
        np.empty(number * LANES, np.float32),
        np.zeros((KEPT + reach) * (reach + CHUNK) * LANES, np.float32),
        np.empty(number * reach * LANES, np.float32),
        np.empty(LANES, np.float32),
        np.empty(LANES, np.float32),
    )
    kept, factors = np.empty_like(lanes.x), np.empty(LANES, np.float32)
    energies = np.empty(LANES, np.float64), np.empty(LANES, np.float64)
    for group in range(begin, end):
        plane, first = group // groups, group % groups * LANES
        n, c = plane // colours, plane % colours
        for lane in range(LANES):
            factors[lane] = by_row[n, c, min(first + lane, height - 1)]
        take(layers[n, :, c], lanes.x, reach, first)
        _light(views[n, :, c], table, unit, lanes.light, first)
        _solve(lanes, kept, factors, energies, paths, rules)
        give(layers[n, :, c], lanes.x, reach, first)
        count = min(LANES, height - first)
        by_row[n, c, first : first + count] = factors[:count]
