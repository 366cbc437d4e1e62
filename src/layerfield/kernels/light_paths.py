"""What all light paths of a display add to the pixels that they meet, in one pass over the views.

    first_k  += sum_i w_i A_ik^T o_ik (a shown_i + b L_i)
    second_k += sum_i w_i A_ik^T o_ik^2

shown_i is what view i shows of the layers, a sum or a product of the pixels along each path; o_ik
its derivative by the pixel of layer k; L_i what the view is to show.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.kept_views import LARGEST, KeptViews
from layerfield.kernels.compiled import compiled, is_plain
from layerfield.links import Additive, Link, Multiplicative
from layerfield.projection import Projection

_ROWS = 32  # of a band, at the least: neighbouring ones wait for each other


class Shares(NamedTuple):
    """How much of what is shown and of what is to be shown enters `first`: a, b."""

    shown: float = 1.0
    light: float = -1.0


_SLOPE = Shares()


class _Taps(NamedTuple):
    """`Projection.taps` as arrays; of windows that are fewer than the most the rest is unused."""

    top: np.ndarray
    left: np.ndarray
    weight: np.ndarray
    windows: np.ndarray


class _Views(NamedTuple):
    """`[n, view, c, y, x]` as stored, what codes stand for if a law says so, and weights."""

    stored: np.ndarray
    table: np.ndarray
    weights: np.ndarray


class _Sums(NamedTuple):
    """What is added to: `[n, chosen, c, ly, lx]` twice, the second or nothing; and errors."""

    first: np.ndarray
    second: np.ndarray
    errors: np.ndarray


class _Law(NamedTuple):
    """What is added: shares of what is shown and to be shown, whether it is a product, layers."""

    of_shown: np.float32
    of_light: np.float32
    is_product: bool
    begin: int
    end: int
    every: int


@dataclass(frozen=True, eq=False)
class LightPaths:
    """The paths from the layers of a display to the pixels of its views.

    Args:
        projection: A.
        link: of the pixels along a path.
        views: L.
        weights: w, one for every view.
    """

    projection: Projection
    link: Link
    views: KeptViews
    weights: Sequence[float]

    def serve(self, layers: Tensor) -> bool:
        """Whether `add_up_` can be called: a sum or a product, single precision, a processor.

        Light paths go straight (no magnifications), and a subframe is all there is.
        """
        stored, derivatives = self.views.stored, torch.is_grad_enabled()
        return (
            not is_plain()
            and type(self.projection) is Projection
            and isinstance(self.link, Additive | Multiplicative)
            and layers.shape[-5] == 1
            and layers.device.type == "cpu"
            and layers.dtype == self.views.like.dtype == torch.float32
            and not (derivatives and (layers.requires_grad or stored.requires_grad))
        )

    def add_up_(
        self,
        first: Float[Tensor, "*batch 1 chosen c ly lx"],
        layers: Float[Tensor, "*batch 1 layer c ly lx"],
        *,
        shares: Shares = _SLOPE,
        second: Float[Tensor, "*batch 1 chosen c ly lx"] | None = None,
        only: int | None = None,
        error: Float[Tensor, "*batch 1 1 1 1 1"] | None = None,
        every: int = 1,
    ) -> None:
        """Add what they bring to `first` and `second`, in place; see `serve`.

        Args:
            first: a contiguous tensor, for all layers or the only one.
            layers: P; not looked at where neither a nor o depends on them.
            shares: a and b; the slope of the error as they are.
            second: a contiguous tensor, or none to be added to.
            only: the only layer that anything is added to.
            error: to which sum_i w_i ||a shown_i + b L_i||^2 is added, of some views.
            every: how many views there are to one of them.

        Raises:
            ValueError: layers or sums of other shapes than those of the display and the views.
        """
        number = len(self.projection.shifts[0])
        begin, end = (0, number) if only is None else (only, only + 1)
        self._expect(layers, number)
        self._expect(first, end - begin)
        batch, channels = math.prod(first.shape[:-5]), first.shape[-3]
        height, rows = self.views.stored.shape[-2], max(_ROWS, 2 * self.projection.margin[0] + 1)
        bands = math.ceil(height / rows)
        seen, taps, views = _planes(layers.contiguous()), _taps(self.projection), self._arrays()
        squares = _planes(first)[:0] if second is None else _planes(second.view_as(first))
        sums = _Sums(_planes(first), squares, np.zeros((batch, channels, bands)))
        law = _Law(
            np.float32(shares.shown),
            np.float32(shares.light / self._unit),
            isinstance(self.link, Multiplicative),
            begin,
            end,
            0 if error is None else every,
        )
        for parity in (0, 1):  # bands side by side add to the same rows of the layers
            count = batch * channels * len(range(parity, bands, 2))
            given = (seen, views, taps, sums, law, rows, parity)
            _add_bands.in_spans(*given, count=count, numbers=views.stored.size)
        if error is not None:
            error += torch.from_numpy(sums.errors.sum(axis=(1, 2))).to(error).view(error.shape)

    def _expect(self, layers: Tensor, number: int) -> None:
        """Compiled loops would go past the end of smaller ones."""
        *batch, _, channels, _, _ = self.views.stored.shape
        size = self.projection.layer_size(self.views.stored)
        expected = (*batch, 1, number, channels, *size)
        if layers.shape != expected:
            raise ValueError(f"found layers of shape {tuple(layers.shape)}, expected {expected}")

    def _arrays(self) -> _Views:
        table = torch.empty(0) if self.views.table is None else self.views.table.contiguous()
        weights = np.asarray(self.weights, dtype=np.float32)
        return _Views(_planes(self.views.stored.contiguous()), table.numpy(), weights)

    @property
    def _unit(self) -> int:
        """What stands for 1 in the views as they are stored; codes of a law are looked up."""
        looked_up = self.views.table is not None
        return LARGEST[self.views.stored.dtype] if self.views.is_whole and not looked_up else 1


def _planes(layers: Tensor) -> np.ndarray:
    return layers.detach().view(-1, *layers.shape[-4:]).numpy()


@lru_cache(maxsize=16)
def _taps(projection: Projection) -> _Taps:
    known = projection.taps
    shape = len(known), len(known[0]), max(len(taps) for layers in known for taps in layers)
    found = _Taps(
        np.zeros(shape, dtype=np.int64),
        np.zeros(shape, dtype=np.int64),
        np.zeros(shape, dtype=np.float32),
        np.zeros(shape[:2], dtype=np.int64),
    )
    for i, layers in enumerate(known):
        for k, taps in enumerate(layers):
            found.windows[i, k] = len(taps)
            for n, (top, left, weight) in enumerate(taps):
                found.top[i, k, n], found.left[i, k, n], found.weight[i, k, n] = top, left, weight
    return found


@compiled
def _add_bands(layers, views, taps, sums, law, rows, parity, begin, end):
    """Every second band of all channels, one after the other, from and to."""
    channels, bands = sums.errors.shape[1:]
    mine = (bands + 1 - parity) // 2
    for number in range(begin, end):
        before, band = divmod(number, mine)
        item, channel = divmod(before, channels)
        _add_band(layers, views, taps, sums, law, rows, (item, channel, parity + 2 * band))


@compiled
def _add_band(layers, views, taps, sums, law, rows, place):
    """Add what paths through a band of rows of the views bring to one channel of the layers.

    Loops over pixels are simple ones on whole rows, and outer ones go up: others stay scalar.
    """
    item, channel, band = place
    top, left, share, windows = taps.top, taps.left, taps.weight, taps.windows
    first, second, stored, table = sums.first, sums.second, views.stored, views.table
    number, height, width = layers.shape[1], stored.shape[3], stored.shape[4]
    pixels = np.zeros((number, width), layers.dtype)
    slopes = np.ones((number, width), layers.dtype)
    value = np.zeros(width, layers.dtype)
    error = 0.0
    for y in range(band * rows, min(height, (band + 1) * rows)):
        for i in range(len(views.weights)):
            weight = views.weights[i]
            for k in range(number if law.is_product or law.of_shown != 0 else 0):
                for n in range(windows[i, k]):
                    x0, y0 = left[i, k, n], y + top[i, k, n]
                    row = layers[item, k, channel, y0, x0 : x0 + width]
                    _look(pixels[k], row, share[i, k, n], n > 0)
            if law.is_product:
                _multiply(pixels, slopes, value)
            else:
                _add(pixels, value)
            _compare(value, stored[item, i, channel, y], table, law.of_shown, law.of_light)
            if law.every > 0 and i % law.every == 0:
                error += weight * _square(value)
            for k in range(law.begin, law.end):
                for n in range(windows[i, k]):
                    x0, y0, w = left[i, k, n], y + top[i, k, n], weight * share[i, k, n]
                    row = first[item, k - law.begin, channel, y0, x0 : x0 + width]
                    _add_product(row, slopes[k], value, w)
                    if len(second) > 0:
                        row = second[item, k - law.begin, channel, y0, x0 : x0 + width]
                        _add_product(row, slopes[k], slopes[k], w)
    sums.errors[item, channel, band] = error


@compiled
def _look(pixels, row, share, further):
    """Find a share of the pixels that are looked at, or a further one."""
    if further:
        for x in range(len(pixels)):
            pixels[x] += share * row[x]
    else:
        for x in range(len(pixels)):
            pixels[x] = share * row[x]


@compiled
def _add(pixels, value):
    """Find the sum; its slopes are 1."""
    for x in range(len(value)):
        value[x] = pixels[0, x]
    for k in range(1, len(pixels)):
        met = pixels[k]
        for x in range(len(value)):
            value[x] += met[x]


@compiled
def _multiply(pixels, slopes, value):
    """Find the product, and its slopes: what is in front of a layer times what is behind it."""
    number, width = pixels.shape
    for k in range(1, number):
        met, before, slope = pixels[k - 1], slopes[k - 1], slopes[k]
        for x in range(width):
            slope[x] = met[x]
        if k > 1:
            for x in range(width):
                slope[x] *= before[x]
    met = pixels[number - 1]
    for x in range(width):
        value[x] = met[x]
    for n in range(2, number + 1):
        met, slope = pixels[number - n], slopes[number - n]
        if n < number:
            for x in range(width):
                slope[x] *= value[x]
        else:
            for x in range(width):
                slope[x] = value[x]
        for x in range(width):
            value[x] *= met[x]


@compiled
def _compare(value, light, table, of_shown, of_light):
    """Weigh what is shown against what is to be shown."""
    if len(table) > 0:
        for x in range(len(value)):
            value[x] = of_shown * value[x] + of_light * table[np.int64(light[x])]
    else:
        for x in range(len(value)):
            value[x] = of_shown * value[x] + of_light * light[x]


@compiled
def _square(value):
    total = np.float32(0)
    for x in range(len(value)):
        total += value[x] * value[x]
    return total


@compiled
def _add_product(row, one, other, share):
    for x in range(len(row)):
        row[x] += share * one[x] * other[x]
