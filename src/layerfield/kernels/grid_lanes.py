"""Weighted sums of rows, and pixels settled by them: what sweeps of grids of views are made of.

Sums of pixels side by side stay in the processor's registers while one row after the other is
added. As one simple loop for every row, each would pass through the cache. Numba is imported here;
see `compiled`.
"""

from collections.abc import Sequence
from functools import partial, reduce
from typing import Any

from llvmlite import ir
from numba.core import cgutils
from numba.core import types as kinds
from numba.extending import intrinsic

from layerfield.kernels.lanes import FREE
from layerfield.kernels.side_by_side import WHOLE, Lanes, side_by_side

_FLOAT = ir.FloatType()
_VECTORS, _LANES = 4, 16
_ONE_BY_ONE = (1, _LANES), (1, 1)


@intrinsic
def weigh(_: Any, made: Any, rows: Any, shares: Any, number: Any, count: Any) -> Any:
    """Write made[x] = sum_n shares[n] rows[n][x].

    Args:
        made: address of a row, apart from those that are added.
        rows: where the addresses of rows are.
        shares: where what they count is.
        number: of rows.
        count: of pixels.
    """
    return _weighing(made, rows, shares, number, count, is_each=False)


@intrinsic
def weigh_each(_: Any, made: Any, rows: Any, shares: Any, number: Any, count: Any) -> Any:
    """Write made[x] = sum_n shares[n][x] rows[n][x], as `weigh` does.

    Args:
        made: address of a row, apart from those that are added.
        rows: where the addresses of rows are.
        shares: where the addresses of rows are that say what each pixel counts.
        number: of rows.
        count: of pixels.
    """
    return _weighing(made, rows, shares, number, count, is_each=True)


def _weighing(*given: Any, is_each: bool) -> Any:
    """Return the kinds of a sum of rows, and what generates it."""

    def generate(_: Any, builder: Any, __: Any, values: Sequence[Any]) -> Any:
        made, rows, shares, number, count = values
        rows = builder.inttoptr(rows, WHOLE.as_pointer())
        shares = builder.inttoptr(shares, (WHOLE if is_each else _FLOAT).as_pointer())
        for lanes, places in side_by_side(builder, count, (_VECTORS, _LANES), *_ONE_BY_ONE):
            sums = [cgutils.alloca_once(builder, lanes.of(_FLOAT)) for _ in places]
            for each in sums:
                builder.store(lanes.constant(_FLOAT, 0.0), each)
            with cgutils.for_range(builder, number) as row:
                address = builder.load(builder.gep(rows, [row.index]))
                known = builder.load(builder.gep(shares, [row.index]))
                for each, place in zip(sums, places, strict=True):
                    share = lanes.read(known, place, _FLOAT) if is_each else lanes.all(known)
                    pixels = lanes.read(address, place, _FLOAT)
                    part = builder.fmul(pixels, share, flags=FREE)
                    builder.store(builder.fadd(builder.load(each), part, flags=FREE), each)
            for each, place in zip(sums, places, strict=True):
                lanes.write(builder.load(each), made, place)
        return WHOLE(0)

    return kinds.intp(*given), generate


@intrinsic
def settle(_: Any, rows: Any, gain: Any, bounds: Any, is_alone: Any, count: Any) -> Any:
    """Write P = clamp(A + g (b - sum)), or clamp(g (b - sum)), and return (A - P) (P - last P).

    Pixels without a gain stay, in the bounds.

    Args:
        rows: addresses of rows: P, A, last P, b, the sum, and gains by pixel.
        gain: g is the product of it and of those by pixel.
        bounds: least and most.
        is_alone: whether A is part of no sum.
        count: of pixels.
    """
    given = rows, gain, bounds, is_alone, count

    def generate(_: Any, builder: Any, __: Any, values: Sequence[Any]) -> Any:
        rows, gain, bounds, is_alone, count = values
        made, own, ago, seen, total, gains = cgutils.unpack_tuple(builder, rows)
        limits = cgutils.unpack_tuple(builder, bounds)
        every = [Lanes(builder, each) for _, each in _ONE_BY_ONE]
        totals = [  # before the loops: inside, each turn would begin anew
            cgutils.alloca_once_value(builder, lanes.constant(_FLOAT, 0.0)) for lanes in every
        ]
        loops = side_by_side(builder, count, *_ONE_BY_ONE)
        for (lanes, (place,)), back in zip(loops, totals, strict=True):
            zero, low, high = lanes.constant(_FLOAT, 0.0), *map(lanes.all, limits)
            light, shown, begun, before, known = (
                lanes.read(row, place, _FLOAT) for row in (seen, total, own, ago, gains)
            )
            share = builder.fmul(known, lanes.all(gain), flags=FREE)
            rest = builder.fsub(light, shown, flags=FREE)
            is_seen = builder.fcmp_ordered(">", share, zero)
            base = builder.select(is_alone, builder.select(is_seen, zero, begun), begun)
            step = builder.select(is_seen, builder.fmul(rest, share, flags=FREE), zero)
            found = builder.fadd(base, step, flags=FREE)
            found = builder.select(builder.fcmp_ordered("<", found, low), low, found)
            found = builder.select(builder.fcmp_ordered(">", found, high), high, found)
            lanes.write(found, made, place)
            gone = builder.fsub(begun, found, flags=FREE)
            part = builder.fmul(gone, builder.fsub(found, before, flags=FREE), flags=FREE)
            builder.store(builder.fadd(builder.load(back), part, flags=FREE), back)
        backs = zip(every, totals, strict=True)
        parts = (part for lanes, back in backs for part in lanes.each(builder.load(back)))
        return reduce(partial(builder.fadd, flags=FREE), parts)

    return kinds.float32(*given), generate
