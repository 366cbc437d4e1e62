"""Layer by layer least squares where light adds up and views stand in a grid, without the views.

    P_k <- clamp(P_k + (b_k - sum_j (R_kj (x) C_kj) P_j) / A_k^T W A_k 1)

with b = A^T W L. What layer j brings is summed up over rows, then over columns; see `GridSystem`.
Layers follow each other down the rows, so that what one has made is at hand for the next.
"""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from layerfield.grid_system import GridSystem
from layerfield.kernels.compiled import compiled, native
from layerfield.kernels.parts import parts_of, rows_at, steps_of

Layers = Float[Tensor, "*batch 1 layer c ly lx"]


class _Turn(NamedTuple):
    """Which layer, and where those in front, it and those behind, and what is made are.

    0 for where the sweep begins, 1 for what is beside it: pixels that do not stand alone look at
    what others of their layer were.
    """

    layer: int
    front: int = 0
    rear: int = 0
    made: int = 0


class _Arrays(NamedTuple):
    """`[n, layer, c, y, x]`: where layers are, P of one sweep ago, and b."""

    layers: np.ndarray
    beside: np.ndarray
    last: np.ndarray
    seen: np.ndarray


class _Bounds(NamedTuple):
    low: np.float32
    high: np.float32


def swept_(
    system: GridSystem, seen: Layers, ahead: Layers, last: Layers, bounds: tuple[float, float]
) -> tuple[Layers, Bool[Tensor, "*batch 1 1 1 1 1"]]:
    """Return layers after a sweep, and whether it went back: (A - P) (P - last P) above 0.

    Args:
        system: the normal equations.
        seen: b; contiguous, of single precision, on a processor, as all others.
        ahead: A, where the sweep begins; may be written on.
        last: P of one sweep ago.
        bounds: of pixels.

    Raises:
        ValueError: layers of another shape than those of the equations.
    """
    in_place = bool(system.alone.all())
    made = ahead if in_place else torch.empty_like(ahead)
    new = 0 if in_place else 1
    turns = [_Turn(k, front=new, made=new) for k in range(len(system.alone))]
    return _made(system, turns, (ahead, made, last, seen), bounds)


def moved(
    system: GridSystem, seen: Layers, ahead: Layers, last: Layers, bounds: tuple[float, float]
) -> tuple[Layers, Bool[Tensor, "*batch 1 1 1 1 1"]]:
    """Return layers after all have moved at once, and what `swept_` does; arguments as there.

    Args:
        system: for layers to move at once, see `grid_system`.
        seen: b.
        ahead: A, where all begin.
        last: P of one step ago.
        bounds: of pixels.

    Raises:
        ValueError: as of `swept_`.
    """
    turns = [_Turn(k, made=1) for k in range(len(system.alone))]
    return _made(system, turns, (ahead, torch.empty_like(ahead), last, seen), bounds)


def _made(
    system: GridSystem,
    turns: list[_Turn],
    given: tuple[Tensor, Tensor, Tensor, Tensor],
    bounds: tuple[float, float],
) -> tuple[Tensor, Tensor]:
    made = given[1]
    back = _settle(_Arrays(*(_planes(system, each) for each in given)), system, turns, bounds)
    return made, torch.from_numpy(back > 0).view(*made.shape[:-5], 1, 1, 1, 1, 1)


def best_layer(
    system: GridSystem, seen: Layers, layers: Layers, index: int, bounds: tuple[float, float]
) -> Float[Tensor, "*batch 1 c ly lx"]:
    """Return one layer that minimises the (majorised) error per pixel.

    Args:
        system: the normal equations.
        seen: b; contiguous, of single precision, on a processor, as the layers.
        layers: P.
        index: of the layer.
        bounds: of pixels.

    Raises:
        ValueError: as of `swept_`.
    """
    made = torch.empty_like(layers)  # where nothing is written nothing is taken of the memory
    planes, out, given = (_planes(system, each) for each in (layers, made, seen))
    _settle(_Arrays(planes, out, planes, given), system, [_Turn(index, made=1)], bounds)
    return made[..., index, :, :, :]


def _planes(system: GridSystem, layers: Tensor) -> np.ndarray:
    """Return `[n, layer, c, y, x]`; compiled loops would go past the end of smaller ones."""
    height, width = (each.gains.shape[1] for each in (system.rows, system.columns))
    *_, subframes, number, channels, ly, lx = layers.shape
    expected = 1, len(system.alone), channels, height, width
    if (subframes, number, channels, ly, lx) != expected or not layers.is_contiguous():
        raise ValueError(
            f"found layers of shape {tuple(layers.shape)}, expected {expected}, contiguous"
        )
    return layers.detach().view(-1, *layers.shape[-4:]).numpy()


def _settle(
    arrays: _Arrays, system: GridSystem, turns: list[_Turn], bounds: tuple[float, float]
) -> np.ndarray:
    """Write layers by turns, and return (A - P) (P - last P) of each item."""
    items, _, channels, height, _ = arrays.seen.shape
    parts, needs = parts_of(items * channels, height, system.rows.reach, len(turns))
    sums, limits = np.zeros(len(parts)), _Bounds(*map(np.float32, bounds))
    given = arrays, sums, system, np.array(turns), parts, limits
    numbers = len(turns) * arrays.seen.size
    _settle_parts.in_spans(*given, count=len(parts), numbers=numbers, needs=needs)
    return np.bincount(parts[:, 0] // channels, sums, items)


_ZERO, _FEW = np.float32(0), 16  # pixels that cost no more than one
_ask_for = native("layerfield.kernels.ahead", "ask_for_bytes")
_weigh = native("layerfield.kernels.grid_lanes", "weigh")
_weigh_each = native("layerfield.kernels.grid_lanes", "weigh_each")
_settle_row = native("layerfield.kernels.grid_lanes", "settle")


class _Room(NamedTuple):
    """What a thread has for a row; rows are given by their addresses.

    To cut rows out of arrays would count who holds those.

    Args:
        sums: over rows of each layer, with zeros on both sides.
        total: of those over columns.
        found: addresses of rows, and
        counts: what those count.
        across: `[3, layer, band]`, addresses of sums: on the left, on the right, where all look.
        each: `[2, layer, band]`, addresses of shares by pixel, on the left and on the right.
        inside: `[layer, band]`, the shares where all look.
        few: pixels on both ends.
    """

    sums: np.ndarray
    total: np.ndarray
    found: np.ndarray
    counts: np.ndarray
    across: np.ndarray
    each: np.ndarray
    inside: np.ndarray
    few: int


@compiled
def _settle_parts(arrays, uphill, system, turns, parts, bounds, begin, end):
    """Parts from and to, turn by turn; see `parts_of`."""
    rows, seen = system.rows, arrays.seen
    number, channels, _, width = seen.shape[1:]
    places = (arrays.layers.ctypes.data, arrays.beside.ctypes.data)
    last, light, gains = arrays.last.ctypes.data, seen.ctypes.data, rows.gains
    of_columns = _at(system.columns.gains, 0)
    item_size, layer_size, channel_size, row_size = seen.strides[:4]
    room, limits = _room(system, number, width), (bounds.low, bounds.high)
    for part in range(begin, end):
        item, channel = divmod(parts[part, 0], channels)
        above, back = item * item_size + channel * channel_size, _ZERO
        for step in range(*steps_of(parts, part, len(turns), rows.reach)):
            for turn in range(len(turns)):
                k, front, rear, made = turns[turn]
                for y in range(*rows_at(parts, part, turn, step, rows.reach)):
                    level = above + y * row_size
                    here = level + k * layer_size
                    _ask_for(light + here + row_size, row_size)
                    if turn == 0:
                        for j in range(number):
                            ahead = level + j * layer_size + (rows.reach + 1) * row_size
                            _ask_for(places[rear] + ahead, row_size)
                    if gains[k, y] > _ZERO:
                        for j in range(number):
                            source = places[front if j < k else rear] + level + j * layer_size
                            _add_rows(room, rows, (k, j, y), source, row_size)
                        _add_columns(room, system.columns, k)
                    addresses = (
                        places[made] + here,
                        places[rear] + here,
                        last + here,
                        light + here,
                        room.total.ctypes.data,
                        of_columns + k * system.columns.gains.strides[0],
                    )
                    back += _settle_row(addresses, gains[k, y], limits, system.alone[k], width)
        uphill[part] = back


@compiled
def _add_rows(room, rows, place, source, row_size):
    """Add up the rows of layer j that views show together with row y of layer k.

    Row y of layer j is at `source`.
    """
    (k, j, y), n = place, 0
    for band in range(rows.begins[k, j], rows.begins[k, j + 1]):
        share = rows.shares[k, band, y]
        if share != _ZERO:
            room.found[n] = source + rows.offsets[k, band] * row_size
            room.counts[n] = share
            n += 1
    if n > 0:
        side = (room.sums.shape[1] - len(room.total)) // 2
        to = _at(room.sums, j) + 4 * side
        _weigh(to, room.found.ctypes.data, room.counts.ctypes.data, n, len(room.total))


@compiled
def _add_columns(room, columns, k):
    """Add up over columns; near both ends of a row shares differ from pixel to pixel."""
    n, total = columns.begins[k, -1], room.total.ctypes.data
    for end in range(2):
        to = total + 4 * end * (len(room.total) - room.few)
        _weigh_each(to, _at(room.across[end], k), _at(room.each[end], k), n, room.few)
    left, right = columns.inside[k, 0], columns.inside[k, 1]
    if right > left:
        _weigh(total + 4 * left, _at(room.across[2], k), _at(room.inside, k), n, right - left)


@compiled
def _at(table, row):
    return table.ctypes.data + row * table.strides[0]


@compiled
def _room(system, number, width):
    columns, bands = system.columns, system.rows.offsets.shape[1]
    few = _FEW
    for k in range(number):
        few = max(few, columns.inside[k, 0], width - columns.inside[k, 1])
    few = min(few, width)
    sums = np.zeros((number, width + 2 * columns.reach), np.float32)
    across, each, inside = _find_columns(columns, sums, few)
    found, counts = np.empty(bands, np.int64), np.empty(bands, np.float32)
    return _Room(sums, np.zeros(width, np.float32), found, counts, across, each, inside, few)


@compiled
def _find_columns(columns, sums, few):
    """Return where sums over rows are for each band, and shares; see `_Room`."""
    number, most = columns.offsets.shape
    across, each = np.empty((3, number, most), np.int64), np.empty((2, number, most), np.int64)
    inside, right = np.empty((number, most), np.float32), sums.shape[1] - 2 * columns.reach - few
    for k in range(number):
        left = min(columns.inside[k, 0], columns.shares.shape[2] - 1)
        for j in range(number):
            for band in range(columns.begins[k, j], columns.begins[k, j + 1]):
                first = _at(sums, j) + 4 * (columns.reach + columns.offsets[k, band])
                shares = _at(columns.shares[k], band)
                across[0, k, band], each[0, k, band] = first, shares
                across[1, k, band], each[1, k, band] = first + 4 * right, shares + 4 * right
                across[2, k, band], inside[k, band] = (
                    first + 4 * left,
                    columns.shares[k, band, left],
                )
    return across, each, inside
