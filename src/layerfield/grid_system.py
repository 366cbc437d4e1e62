"""The normal equations of views in a grid: what acts on rows, times what acts on columns.

Where every position along y meets every position along x, and all views count alike,

    A_k^T W A_j = R_kj (x) C_kj

with R_kj and C_kj banded matrices, one pixel of a column or a row by another. What one layer adds
to another's equations then takes as many numbers as both have bands, not one for every view.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.projection import Projection, taps_of


class Bands(NamedTuple):
    """The bands of one direction, R or C, layer by layer; see `GridSystem`.

    Args:
        begins: `[layer, other + 1]`, from which band to which are those of another layer.
        offsets: `[layer, band]`, from a pixel of the layer to one of the other.
        shares: `[layer, band, pixel of the layer]`.
        coverage: `[layer, pixel]`, of how many positions it is seen.
        gains: `[layer, pixel]`, one over that and the weight; 0 where it is not seen.
        inside: `[layer, 2]`, from which pixel and to which all views see it.
        reach: the farthest offset.
    """

    begins: np.ndarray
    offsets: np.ndarray
    shares: np.ndarray
    coverage: np.ndarray
    gains: np.ndarray
    inside: np.ndarray
    reach: int


class GridSystem(NamedTuple):
    """R, with the weight of a view in it, and C; and which layers have pixels that stand alone.

    Those are seen at whole pixels, so their own matrix is diagonal, and not among the bands. The
    order is that in which sweeps in words settle layers, see `Projection.inner_first`.
    """

    rows: Bands
    columns: Bands
    alone: np.ndarray
    order: np.ndarray

    def brought(
        self, layers: Float[Tensor, "*batch layer c ly lx"], index: int
    ) -> Float[Tensor, "*batch c ly lx"]:
        """Return what bands bring to the equations of one layer: sum_j (R_kj (x) C_kj) P_j."""
        total = torch.zeros_like(layers[..., index, :, :, :])
        for j, part in enumerate(layers.unbind(dim=-4)):
            if self.rows.begins[index, j] < self.rows.begins[index, j + 1]:
                rows = _banded(part, self.rows, index, j, -2)
                total += _banded(rows, self.columns, index, j, -1)
        return total

    def settled(
        self,
        layers: Float[Tensor, "*batch layer c ly lx"],
        seen: Float[Tensor, "*batch layer c ly lx"],
        index: int,
    ) -> Float[Tensor, "*batch c ly lx"]:
        """Return one layer that answers to all others as they are, unclamped.

            P_k + (b_k - sum_j (R_kj (x) C_kj) P_j) / A_k^T W A_k 1

        Args:
            layers: P.
            seen: b = A^T W L.
            index: k.
        """
        own, gains = layers[..., index, :, :, :], self.gains(index)
        rest = seen[..., index, :, :, :] - self.brought(layers, index)
        base = torch.where(gains > 0, 0, own) if self.alone[index] else own
        return base + gains * rest

    def gains(self, index: int) -> Float[Tensor, "ly lx"]:
        """Return 1 / A_k^T W A_k 1 of a layer, 0 where nobody looks."""
        down, across = (torch.from_numpy(each.gains[index]) for each in (self.rows, self.columns))
        return down[:, None] * across


def _banded(pixels: Tensor, bands: Bands, index: int, other: int, dim: int) -> Tensor:
    """Return banded matrices times the rows or columns of a layer."""
    made, length = torch.zeros_like(pixels), pixels.shape[dim]
    for band in range(bands.begins[index, other], bands.begins[index, other + 1]):
        offset = int(bands.offsets[index, band])
        begin, count = max(0, -offset), max(0, length - abs(offset))
        shares = torch.from_numpy(bands.shares[index, band]).narrow(0, begin, count)
        there = pixels.narrow(dim, begin + offset, count)
        made.narrow(dim, begin, count).addcmul_(there, shares if dim == -1 else shares[:, None])
    return made


def grid_system(
    projection: Projection,
    weights: Sequence[float],
    view_size: tuple[int, int],
    *,
    at_once: bool = False,
) -> GridSystem | None:
    """Return the normal equations of a grid, or None where views are none or count differently.

    Args:
        projection: A.
        weights: W, one for every view.
        view_size: height and width of the views.
        at_once: for all K layers to move at once. Their own matrices are then among the bands, and
            gains are smaller by K, so that together they do not go too far.
    """
    upright = [tuple(y for _, y in layers) for layers in projection.shifts]
    level = [tuple(x for x, _ in layers) for layers in projection.shifts]
    every, down, across = {*zip(upright, level, strict=True)}, {*upright}, {*level}
    is_grid = len(every) == len(upright) == len(down) * len(across)
    if type(projection) is not Projection or not is_grid or len({*weights}) > 1:
        return None
    taps = zip(*projection.taps, strict=True)
    alone = np.array([not at_once and all(len(each) == 1 for each in views) for views in taps])
    (height, width), (my, mx) = view_size, projection.margin
    rows = _bands(sorted(down), alone, height, my, weights[0])
    if at_once:
        rows = rows._replace(gains=rows.gains / len(alone))
    columns = _bands(sorted(across), alone, width, mx, 1.0)
    return GridSystem(rows, columns, alone, np.array(projection.inner_first))


def _bands(
    positions: Sequence[tuple[float, ...]],
    alone: np.ndarray,
    length: int,
    margin: int,
    weight: float,
) -> Bands:
    """Return the bands of one direction.

    Args:
        positions: of viewers; the shift of every layer for each.
        alone: which layers are no part of their own sums.
        length: of a view.
        margin: by which layers exceed it on either side.
        weight: of each.
    """
    number, pixels = len(positions[0]), length + 2 * margin
    coverage, inside = np.zeros((number, pixels)), np.tile((0, pixels), (number, 1))
    found = [[dict[int, np.ndarray]() for _ in range(number)] for _ in range(number)]
    for shifts in positions:
        for k, here, share in _windows(shifts):
            begin = margin + here
            end = begin + length
            inside[k] = max(inside[k, 0], begin), min(inside[k, 1], end)
            coverage[k, begin:end] += share
            for j, there, other in _windows(shifts):
                if j != k or not alone[k]:
                    band = found[k][j].setdefault(there - here, np.zeros(pixels))
                    band[begin:end] += weight * share * other
    counts = np.array([[len(bands) for bands in layer] for layer in found])
    begins = np.pad(counts.cumsum(axis=1), ((0, 0), (1, 0)))
    offsets = np.zeros((number, max(1, begins.max())), np.int64)
    shares = np.zeros((*offsets.shape, pixels), np.float32)
    for k, layer in enumerate(found):
        listed = [(offset, bands[offset]) for bands in layer for offset in sorted(bands)]
        for n, (offset, band) in enumerate(listed):
            offsets[k, n], shares[k, n] = offset, band
    known = coverage.astype(np.float32)
    gains = np.divide(1 / weight, known, out=np.zeros_like(known), where=known > 0)
    return Bands(begins, offsets, shares, known, gains, inside, int(abs(offsets).max()))


def _windows(shifts: Sequence[float]) -> list[tuple[int, int, float]]:
    """Return layers, offsets and weights of what a viewer sees along one direction."""
    return [(k, *tap) for k, shift in enumerate(shifts) for tap in taps_of(shift)]
