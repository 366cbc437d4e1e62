"""What all light paths of a display bring to the pixels that they meet, in one pass over the views.

    first_k  = sum_i w_i A_ik^T o_ik (a shown_i + b L_i)
    second_k = sum_i w_i A_ik^T o_ik^2

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
from layerfield.kernels.compiled import compiled, is_plain, native
from layerfield.kernels.gpu.serving import on_gpu
from layerfield.links import Additive, Link, Multiplicative
from layerfield.projection import Projection

_ROWS = 32  # of a band, at the least: neighbouring ones wait for each other


class Shares(NamedTuple):
    """How much of what is shown and of what is to be shown enters `first`: a, b."""

    shown: float = 1.0
    light: float = -1.0


_SLOPE = Shares()


class _Taps(NamedTuple):
    """`Projection.taps` as arrays; of windows that are fewer than the most the rest is unused.

    A view looks at the pixels of a layer as they are, or between them.
    """

    top: np.ndarray
    left: np.ndarray
    weight: np.ndarray
    windows: np.ndarray
    is_whole: np.ndarray


class _Views(NamedTuple):
    """`[n, view, c, y, x]` as stored, what codes stand for if a law says so, and weights."""

    stored: np.ndarray
    table: np.ndarray
    weights: np.ndarray


class _Sums(NamedTuple):
    """What is found: `[n, chosen, c, ly, lx]` twice, the second or nothing; and errors."""

    first: np.ndarray
    second: np.ndarray
    errors: np.ndarray


class _Law(NamedTuple):
    """What is added: shares of what is shown and to be shown, whether it is a product, layers.

    There is a 0 for each layer of the display: their number is known when loops are compiled.
    """

    each: tuple[int, ...]
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

        Or there is a GPU for kernels. Light paths go straight (no magnifications), and a subframe
        is all there is.
        """
        stored, derivatives = self.views.stored, torch.is_grad_enabled()
        return (
            not is_plain()
            and type(self.projection) is Projection
            and isinstance(self.link, Additive | Multiplicative)
            and layers.shape[-5] == 1
            and (layers.device.type == "cpu" or on_gpu(layers.detach()))
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
        """Write what they bring into `first` and `second`; see `serve`.

        Args:
            first: a contiguous tensor, for all layers or the only one; whatever it holds.
            layers: P; not looked at where neither a nor o depends on them.
            shares: a and b; the slope of the error as they are.
            second: the same, or none.
            only: the only layer that anything is found for.
            error: to which sum_i w_i ||a shown_i + b L_i||^2 is added, of some views.
            every: how many views there are to one of them.

        Raises:
            ValueError: layers or sums of other shapes than those of the display and the views, or
                sums that are not contiguous.
        """
        number = len(self.projection.shifts[0])
        begin, end = (0, number) if only is None else (only, only + 1)
        self.expect(layers, number)
        self.expect(first, end - begin)
        if not first.is_contiguous() or (second is not None and not second.is_contiguous()):
            raise ValueError("found sums that lie apart in memory, expected contiguous ones")
        if on_gpu(layers.detach()):
            self._add_up_on_gpu(first, layers, shares, second, only, error, every)
            return
        batch, channels = math.prod(first.shape[:-5]), first.shape[-3]
        height, rows = self.views.stored.shape[-2], max(_ROWS, 2 * self.projection.margin[0] + 1)
        bands = math.ceil(height / rows)
        seen, taps, views = _planes(layers.contiguous()), _taps(self.projection), self.arrays
        squares = _planes(first)[:0] if second is None else _planes(second.view_as(first))
        sums = _Sums(_planes(first), squares, np.zeros((batch, channels, bands)))
        law = _Law(
            (0,) * number,
            np.float32(shares.shown),
            np.float32(shares.light / self.unit),
            isinstance(self.link, Multiplicative),
            begin,
            end,
            0 if error is None else every,
        )
        for parity in (0, 1):  # bands side by side bring something to the same rows of the layers
            count = batch * channels * len(range(parity, bands, 2))
            given = (seen, views, taps, sums, law, rows, parity)
            _add_bands.in_spans(*given, count=count, numbers=views.stored.size)
        if error is not None:
            error += torch.from_numpy(sums.errors.sum(axis=(1, 2))).to(error).view(error.shape)

    def _add_up_on_gpu(
        self,
        first: Tensor,
        layers: Tensor,
        shares: Shares,
        second: Tensor | None,
        only: int | None,
        error: Tensor | None,
        every: int,
    ) -> None:
        from layerfield.kernels.gpu.light_paths import add_up, looked_up  # noqa: PLC0415  needs Triton

        found = add_up(
            self.projection,
            looked_up(self.views),
            self.weights,
            first,
            layers,
            second,
            (shares.shown, shares.light / self.unit),
            0 if error is None else every,
            is_product=isinstance(self.link, Multiplicative),
            only=only,
        )
        if error is not None:
            error += found.view(error.shape)

    def expect(self, layers: Tensor, number: int) -> None:
        """Compiled loops would go past the end of smaller ones."""
        *batch, _, channels, _, _ = self.views.stored.shape
        size = self.projection.layer_size(self.views.stored)
        expected = (*batch, 1, number, channels, *size)
        if layers.shape != expected:
            raise ValueError(f"found layers of shape {tuple(layers.shape)}, expected {expected}")

    @property
    def arrays(self) -> _Views:
        """The views for compiled loops."""
        table = self.views.like if self.views.table is None else self.views.table.contiguous()
        weights = np.asarray(self.weights, dtype=np.float32)
        return _Views(_planes(self.views.stored.contiguous()), table.numpy(), weights)

    @property
    def unit(self) -> int:
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
        np.array([[len(taps) == 1 and taps[0][2] == 1 for taps in layers] for layers in known]),
    )
    for i, layers in enumerate(known):
        for k, taps in enumerate(layers):
            found.windows[i, k] = len(taps)
            for n, (top, left, weight) in enumerate(taps):
                found.top[i, k, n], found.left[i, k, n], found.weight[i, k, n] = top, left, weight
    return found


_ask_for = native("layerfield.kernels.ahead", "ask_for")
_follow = native("layerfield.kernels.path_lanes", "follow")


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
    """Add what paths through a band of rows of the views bring to one channel of the layers."""
    item, channel, band = place
    number, height, width = layers.shape[1], views.stored.shape[3], views.stored.shape[4]
    chosen, is_twice = law.end - law.begin, len(sums.second) > 0
    pixels = np.zeros((number, width), layers.dtype)
    parts = np.zeros((2, chosen, width), layers.dtype)
    light = np.zeros(width, layers.dtype)
    seen, first = np.zeros(number, np.int64), np.zeros(number, np.int64)
    second = np.zeros(number, np.int64)
    how = (4 if law.is_product else 0) + (2 if chosen < number else 0) + (1 if is_twice else 0)
    error = 0.0
    is_seen = law.is_product or law.of_shown != 0
    for n in range(number):
        seen[n] = pixels[n].ctypes.data
    span = band * rows, min(height, (band + 1) * rows)
    for y in range(*span):
        _clear(sums, place, y, span, height)
        for i in range(len(views.weights)):
            for n in range(number if is_seen else 0):
                k = (law.begin + n) % number  # the only one that is added to comes first
                seen[n] = _look(pixels[n], layers[item, k, channel], taps, i, k, y)
            for n in range(chosen):
                k = law.begin + n
                first[n] = _begin(parts[0, n], sums.first[item, n, channel], taps, i, k, y)
                if is_twice:
                    second[n] = _begin(parts[1, n], sums.second[item, n, channel], taps, i, k, y)
            _read(light, views.stored[item, i, channel, y], views.table, law.of_light)
            if i + 1 < len(views.weights):
                _ask_for(views.stored[item, i + 1, channel, y])
            given, weight = (seen, first, second, light.ctypes.data, width), views.weights[i]
            square = _follow(law.each, *given, law.of_shown, weight, how)
            if law.every > 0 and i % law.every == 0:
                error += weight * square
            for n in range(chosen):
                k = law.begin + n
                _spread(parts[0, n], sums.first[item, n, channel], taps, i, k, y)
                if is_twice:
                    _spread(parts[1, n], sums.second[item, n, channel], taps, i, k, y)
    sums.errors[item, channel, band] = error


@compiled
def _clear(sums, place, y, span, height):
    """Begin with nothing in rows of the layers that paths of row y are the first to meet.

    Every second band, from the first on, comes before those beside it.
    """
    (item, channel, band), (start, stop) = place, span
    reach, comes_first = sums.first.shape[3] - height, band % 2 == 0
    if comes_first or y + reach < stop or stop == height:
        for row in range(start if comes_first and y == start else y + reach, y + reach + 1):
            for n in range(sums.first.shape[1]):
                sums.first[item, n, channel, row] = 0
                if len(sums.second) > 0:
                    sums.second[item, n, channel, row] = 0


@compiled
def _look(pixels, plane, taps, i, k, y):
    """Return where the pixels are that are looked at: found first, if they lie between others."""
    if taps.is_whole[i, k]:
        return _place(plane, taps, i, k, y)
    pixels[:] = 0
    for n in range(taps.windows[i, k]):
        _add_share(pixels, _row(plane, taps, i, k, y, n), taps.weight[i, k, n])
    return pixels.ctypes.data


@compiled
def _begin(part, plane, taps, i, k, y):
    """Return where to add: to the pixels themselves, or to what is then spread over them."""
    if taps.is_whole[i, k]:
        return _place(plane, taps, i, k, y)
    part[:] = 0
    return part.ctypes.data


@compiled
def _spread(part, plane, taps, i, k, y):
    """Add to the pixels what did not go there by itself."""
    if not taps.is_whole[i, k]:
        for n in range(taps.windows[i, k]):
            row = _row(plane, taps, i, k, y, n)
            _add_share(row, part, taps.weight[i, k, n])


@compiled
def _place(plane, taps, i, k, y):
    """Return where the row of the only window is."""
    pixel = (y + taps.top[i, k, 0]) * plane.shape[1] + taps.left[i, k, 0]
    return plane.ctypes.data + pixel * plane.itemsize


@compiled
def _row(plane, taps, i, k, y, n):
    """Return the row of a window, from its first pixel on."""
    return plane[y + taps.top[i, k, n], taps.left[i, k, n] :]


@compiled
def _read(light, row, table, of_light):
    """Weigh what is to be shown."""
    if len(table) > 0:
        for x in range(len(light)):
            light[x] = of_light * table[np.int64(row[x])]
    else:
        for x in range(len(light)):
            light[x] = of_light * row[x]


@compiled
def _add_share(row, other, share):
    """Of rows that may be of other lengths."""
    for x in range(min(len(row), len(other))):
        row[x] += share * other[x]
