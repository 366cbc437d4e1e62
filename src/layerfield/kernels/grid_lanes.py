"""Weighted sums of rows, and pixels settled by them: what sweeps of grids of views are made of.

Sums of pixels side by side stay in the processor's registers while one row after the other is
added. As one simple loop for every row, each would pass through the cache. Numba is imported here;
see `compiled`.
"""

from collections.abc import Iterator, Sequence
from functools import partial, reduce
from typing import Any

from llvmlite import ir
from numba.core import cgutils
from numba.core import types as kinds
from numba.extending import intrinsic

from layerfield.kernels.lanes import FREE, everywhere

_FLOAT, _WHOLE = ir.FloatType(), ir.IntType(64)
_LANES, _VECTORS = 16, 4  # pixels of a vector, vectors side by side


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
        rows = builder.inttoptr(rows, _WHOLE.as_pointer())
        shares = builder.inttoptr(shares, (_WHOLE if is_each else _FLOAT).as_pointer())
        for lanes, places in _side_by_side(builder, count, _VECTORS):
            pixels = _Pixels(builder, lanes)
            sums = [cgutils.alloca_once(builder, pixels.kind) for _ in places]
            for each in sums:
                builder.store(ir.Constant(pixels.kind, None), each)
            with cgutils.for_range(builder, number) as row:
                address = builder.load(builder.gep(rows, [row.index]))
                known = builder.load(builder.gep(shares, [row.index]))
                for each, place in zip(sums, places, strict=True):
                    share = pixels.read(known, place) if is_each else pixels.all(known)
                    part = builder.fmul(pixels.read(address, place), share, flags=FREE)
                    builder.store(builder.fadd(builder.load(each), part, flags=FREE), each)
            for each, place in zip(sums, places, strict=True):
                pixels.write(builder.load(each), made, place)
        return _WHOLE(0)

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
        totals = list[tuple[_Pixels, Any]]()
        for lanes, (place,) in _side_by_side(builder, count, 1):
            pixels = _Pixels(builder, lanes)
            back = cgutils.alloca_once_value(builder, ir.Constant(pixels.kind, None))
            totals.append((pixels, back))
            zero, low, high = ir.Constant(pixels.kind, None), *map(pixels.all, limits)
            share = builder.fmul(pixels.read(gains, place), pixels.all(gain), flags=FREE)
            rest = builder.fsub(pixels.read(seen, place), pixels.read(total, place), flags=FREE)
            begun = pixels.read(own, place)
            is_seen = builder.fcmp_ordered(">", share, zero)
            base = builder.select(is_alone, builder.select(is_seen, zero, begun), begun)
            step = builder.select(is_seen, builder.fmul(rest, share, flags=FREE), zero)
            found = builder.fadd(base, step, flags=FREE)
            found = builder.select(builder.fcmp_ordered("<", found, low), low, found)
            found = builder.select(builder.fcmp_ordered(">", found, high), high, found)
            pixels.write(found, made, place)
            gone = builder.fsub(begun, found, flags=FREE)
            before = builder.fsub(found, pixels.read(ago, place), flags=FREE)
            part = builder.fmul(gone, before, flags=FREE)
            builder.store(builder.fadd(builder.load(back), part, flags=FREE), back)
        first, *rest = (pixels.sum(builder.load(back)) for pixels, back in totals)
        return reduce(partial(builder.fadd, flags=FREE), rest, first)

    return kinds.float32(*given), generate


def _side_by_side(builder: Any, count: Any, vectors: int) -> Iterator[tuple[int, list[Any]]]:
    """Yield lanes, and the places of as many vectors of them, inside loops over a row."""
    begin = _WHOLE(0)
    for many, lanes in ((vectors, _LANES), (1, _LANES), (1, 1))[0 if vectors > 1 else 1 :]:
        length = many * lanes
        end = builder.and_(count, _WHOLE(-length))
        with cgutils.for_range_slice(builder, begin, end, _WHOLE(length), _WHOLE) as (at, _):
            yield lanes, [builder.add(at, _WHOLE(lanes * n)) for n in range(many)]
        begin = end


class _Pixels:
    """Pixels side by side in rows given by their addresses."""

    def __init__(self, builder: Any, lanes: int) -> None:
        self._builder, self._lanes = builder, lanes
        self.kind = _FLOAT if lanes == 1 else ir.VectorType(_FLOAT, lanes)

    def all(self, number: Any) -> Any:
        """Return a number for all of them."""
        return number if self._lanes == 1 else everywhere(self._builder, number, self._lanes)

    def read(self, row: Any, place: Any) -> Any:
        return self._builder.load(self._at(row, place), align=4)

    def write(self, value: Any, row: Any, place: Any) -> None:
        self._builder.store(value, self._at(row, place), align=4)

    def sum(self, value: Any) -> Any:
        """Return the sum of all."""
        if self._lanes == 1:
            return value
        lanes = map(ir.IntType(32), range(self._lanes))
        first, *rest = (self._builder.extract_element(value, lane) for lane in lanes)
        return reduce(partial(self._builder.fadd, flags=FREE), rest, first)

    def _at(self, row: Any, place: Any) -> Any:
        first = self._builder.inttoptr(row, _FLOAT.as_pointer())
        return self._builder.bitcast(self._builder.gep(first, [place]), self.kind.as_pointer())
