"""Layer by layer least squares where light multiplies and paths go through whole pixels.

    P_k <- clamp(sum_i w_i A_ik^T o_ik L_i / sum_i w_i A_ik^T o_ik^2)

with o_ik what the other layers let through. What the paths of a pixel bring is gathered there, and
nothing but layers is written. Layers follow each other down the rows, so that what one has made,
and the views, are at hand for the next; and sweeps follow each other in one call.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.kept_views import LARGEST, KeptViews
from layerfield.kernels.codes import look_up, looked_up
from layerfield.kernels.compiled import compiled, native, serve
from layerfield.kernels.light_paths import LightPaths
from layerfield.kernels.parts import parts_of, rows_at, steps_of
from layerfield.kernels.path_tables import AHEAD, EDGE, Light, PathTables, tables_of
from layerfield.kernels.sweep_passes import extrapolate
from layerfield.links import Multiplicative
from layerfield.projection import Projection

Layers = Float[Tensor, "*batch 1 layer c ly lx"]
One = Float[Tensor, "*batch 1 1 1 1 1"]

_BEGUN, _TURNS = 2, 3  # layers that a sweep begins with; those that are made in turn
_MOST = 1 << 28  # words of light: half a gigabyte
_LIGHT = WeakKeyDictionary[KeptViews, KeptViews]()  # as long as the views are kept


class _Arrays(NamedTuple):
    """P of one sweep ago, P, and room for what sweeps make, each `[n, layer, c, y, x]`.

    Layers number n are where `_turn` tells; sweep s makes those of s + 2. And `[n]`, the pushes
    that it begins with, and the sweeps since a restart; `[sweep, part]`, how far each led back.
    """

    turns: tuple[np.ndarray, ...]
    pushes: np.ndarray
    since: np.ndarray
    back: np.ndarray


class _Law(NamedTuple):
    """Bounds of pixels, what views are multiplied by, and the largest push."""

    low: np.float32
    high: np.float32
    unit: np.float32
    momentum: np.float32


def serves(paths: LightPaths, layers: Tensor) -> bool:
    """Whether `ProductSweeps` does: a product, whole pixels, single precision, on a processor."""
    whole = isinstance(paths.link, Multiplicative) and type(paths.projection) is Projection
    return whole and paths.serve(layers) and serve(layers) and paths.projection.is_whole


@dataclass(frozen=True, eq=False)
class ProductSweeps:
    """Sweeps over the layers of a display.

    Args:
        paths: from the layers to the views.
        tables: the same; views of no weight are not looked at.
        bounds: of pixels.
        momentum: the largest push.
    """

    paths: LightPaths
    tables: PathTables
    bounds: tuple[float, float]
    momentum: float

    @classmethod
    def along(
        cls, paths: LightPaths, bounds: tuple[float, float], momentum: float
    ) -> "ProductSweeps":
        """Return those along all paths; see `serves`."""
        paths = replace(paths, views=_light_of(paths.views))
        *_, channels, height, width = paths.views.stored.shape
        light = Light((height, width), channels, paths.views.stored.element_size())
        tables = tables_of(paths.projection, tuple(paths.weights), light)
        return cls(paths, tables, bounds, momentum)

    def __call__(
        self, layers: Layers, last: Layers, push: One, since: One, *, sweeps: int
    ) -> tuple[Layers, Layers, One, One]:
        """Return the same after so many sweeps, all in one call.

        A sweep begins at A = clamp(P + push (P - P of one sweep ago)), and led back if the sum of
        (A - P) (P - P of one sweep ago) is above 0.

        Args:
            layers: P.
            last: P of one sweep ago.
            push: share of the change, of the next sweep.
            since: sweeps made since one led back.
            sweeps: how many.

        Raises:
            ValueError: layers of another shape than those of the display and the views.
        """
        number, shape = len(self.tables.top), layers.shape
        for each in (layers, last):
            self.paths.expect(each, number)
        begun = [each.detach().contiguous() for each in (last, layers)]
        fresh = [torch.empty(shape, dtype=torch.float32) for _ in range(min(sweeps, _TURNS))]
        turns = [*begun, *fresh, *[begun[0]] * (_TURNS - len(fresh))]
        planes = tuple(each.view(-1, *shape[-4:]).numpy() for each in turns)
        items, _, channels, height, _ = planes[0].shape
        parts, needs = _parts_of(items * channels, height, self.tables.reach, number + 1, sweeps)
        back, views = np.zeros((sweeps, len(parts))), self.paths.arrays
        arrays = _Arrays(planes, push.flatten().numpy(), since.flatten().numpy(), back)
        law = _Law(*map(np.float32, (*self.bounds, 1 / self.paths.unit, self.momentum)))
        kind = np.empty(0, np.float32 if len(views.table) > 0 else views.stored.dtype)
        given = (0,) * (number - 1), kind, arrays, views, self.tables, parts, law
        numbers = number * views.stored.size
        _settle_parts.in_spans(*given, count=len(needs), numbers=numbers, needs=needs)
        after = push.new_tensor(
            [_pushed(arrays, parts, channels, n, sweeps, law) for n in range(items)]
        )
        pushes, made = (each.view(push.shape) for each in after.unbind(dim=1))
        return turns[_turn(sweeps + 1)], turns[_turn(sweeps)], pushes, made


@lru_cache(maxsize=16)
def _parts_of(
    planes: int, height: int, reach: int, passes: int, sweeps: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return `parts_of` a sweep, and needs of so many, each of which needs all before it."""
    parts, needs = parts_of(planes, height, reach, passes)
    return parts, (len(parts) * np.arange(sweeps)[:, None] + needs).ravel()


def _light_of(views: KeptViews) -> KeptViews:
    """Return views whose codes need not be looked up in every sweep, where there is room for them.

    Light of 16 bits differs from what the law makes of codes by less than 8e-6.
    """
    table, stored = views.table, views.stored
    if table is None or stored.numel() > _MOST or table.min() < 0 or table.max() > 1:
        return views
    if (known := _LIGHT.get(views)) is None:
        words = (table * LARGEST[torch.uint16]).round().to(torch.uint16)
        known = _LIGHT[views] = KeptViews(looked_up(stored, words))
    return known


_ask_for = native("layerfield.kernels.ahead", "ask_for_bytes")
_settle_paths = native("layerfield.kernels.product_lanes", "settle_paths")


class _Places(NamedTuple):
    """Addresses of layers as they are made, and as they were, and of light; the bytes of steps.

    Steps lead to the next item, layer, channel and row of layers; item, channel and row of light.
    """

    made: np.int64
    before: np.int64
    light: np.int64
    layer_steps: tuple[int, int, int, int]
    light_steps: tuple[int, int, int]


class _Room(NamedTuple):
    """What a thread has for a row that not all views look at: the tables of `settle_paths`.

    Light is copied, or looked up, into rows as long as those of layers and `EDGE` more.
    """

    others: np.ndarray
    light: np.ndarray
    left: np.ndarray
    weight: np.ndarray
    rows: np.ndarray


@compiled
def _settle_parts(each, kind, arrays, views, paths, parts, law, begin, end):
    """Parts of sweeps from and to, layer by layer behind what they begin with; see `parts_of`."""
    (_, number, channels, _, columns), count = arrays.turns[0].shape, len(paths.which)
    room = _Room(
        np.empty((count, max(1, number - 1)), np.int64),
        np.zeros(count + AHEAD, np.int64),
        np.empty(count, np.int64),
        np.empty(count, np.float32),
        np.zeros((count, columns + EDGE), kind.dtype),
    )
    for n in range(count):
        room.light[n] = n * room.rows.strides[0]
    for place in range(begin, end):
        sweep, part = divmod(place, len(parts))
        item, channel = divmod(parts[part, 0], channels)
        last, layers, made = (
            arrays.turns[_turn(sweep)],
            arrays.turns[_turn(sweep + 1)],
            arrays.turns[_turn(sweep + 2)],
        )
        push, _ = _pushed(arrays, parts, channels, item, sweep, law)
        places, back = _places(made, layers, views.stored), np.float32(0)
        for step in range(*steps_of(parts, part, number + 1, paths.reach)):
            for turn in range(number + 1):
                for y in range(*rows_at(parts, part, turn, step, paths.reach)):
                    if turn > 0:
                        row = item, paths.order[turn - 1], channel, y
                        back += _settle_row(each, kind, views, paths, room, places, row, law)
                        continue
                    for k in range(number):
                        begun, row = made[item, k, channel, y], layers[item, k, channel, y]
                        extrapolate(begun, row, last[item, k, channel, y], push, law)
        arrays.back[sweep, part] = back


@compiled
def _turn(number):
    """Return where layers number n are: those begun with, then others in turn."""
    return number if number < _BEGUN else _BEGUN + (number - _BEGUN) % _TURNS


@compiled
def _pushed(arrays, parts, channels, item, sweeps, law):
    """Return the push of an item behind so many sweeps, and how many there were since a restart.

    As `Sweeps` has it.
    """
    push, since = arrays.pushes[item], arrays.since[item]
    for sweep in range(sweeps):
        back = 0.0
        for part in range(len(parts)):
            if parts[part, 0] // channels == item:
                back += arrays.back[sweep, part]
        since = np.float32(1 if back > 0 else since + 1)
        push = min(np.float32(2.0 * (since - 1.0) / (since + 2.0)), law.momentum)
    return push, since


@compiled
def _places(made, before, light):
    """Return where things are, and how far apart."""
    return _Places(
        np.int64(made.ctypes.data),
        np.int64(before.ctypes.data),
        np.int64(light.ctypes.data),
        (made.strides[0], made.strides[1], made.strides[2], made.strides[3]),
        (light.strides[0], light.strides[2], light.strides[3]),
    )


@compiled
def _settle_row(each, kind, views, paths, room, places, place, law):
    """Settle a row of a layer, and return how far that led back.

    Rows of light are read past their ends, see `settle_paths`. Where that may not be, or not all
    views look, they are copied; otherwise the next ones are fetched meanwhile.
    """
    (item, k, channel, y), steps = place, places.layer_steps
    here = item * steps[0] + k * steps[1] + channel * steps[2] + y * steps[3]
    rows, known = (places.made + here, places.before + here), (law.low, law.high, law.unit)
    columns, width = room.rows.shape[1] - EDGE, views.stored.shape[4]
    if len(views.table) > 0 or y < paths.inner[k, 0] or y >= paths.inner[k, 1]:
        count, first, last = _gather(views, paths, room, place)
        tables = (
            room.others.ctypes.data,
            room.light.ctypes.data,
            room.left.ctypes.data,
            room.weight.ctypes.data,
        )
        light = np.int64(room.rows.ctypes.data)
    else:
        count, first, last = len(paths.which), paths.inner[k, 2], paths.inner[k, 3]
        tables = (
            paths.others[k].ctypes.data,
            paths.light[k].ctypes.data,
            paths.left[k].ctypes.data,
            paths.weight.ctypes.data,
        )
        steps = places.light_steps
        light = places.light + item * steps[0] + channel * steps[1] + y * steps[2]
        for n in range(count):
            _ask_for(light + steps[2] + paths.light[k, n], steps[2])
    span = columns, first, max(first, last), width
    return _settle_paths(each, kind, (*rows, light), tables, count, span, known)


@compiled
def _gather(views, paths, room, place):
    """Fill the tables of a row; return how many views look at it, from where to where all."""
    (item, k, channel, y), (height, width) = place, views.stored.shape[3:]
    seen, first, last = 0, 0, room.rows.shape[1] - EDGE
    for n in range(len(paths.which)):
        row, left = y - paths.top[k, n], paths.left[k, n]
        if 0 <= row < height:
            codes = views.stored[item, paths.which[n], channel, row]
            light = room.rows[seen, left : left + width]
            if len(views.table) > 0:
                look_up(light, codes, views.table)
            else:
                light[:] = codes
            for j in range(paths.others.shape[2]):
                room.others[seen, j] = paths.others[k, n, j]
            room.left[seen], room.weight[seen] = left, paths.weight[n]
            first, last = max(first, left), min(last, left + width)
            seen += 1
    return seen, first, last
