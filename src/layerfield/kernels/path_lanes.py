"""Light paths of pixels side by side: what compiled loops over rows are put together of.

All that one path meets stays in the processor's registers. As one simple loop after the other, what
lies between them would pass through the cache, which takes three times as long; and one loop over
rows that may all be the same memory would look at a pixel at a time. Numba is imported here; see
`compiled`.
"""

from collections.abc import Sequence
from itertools import product
from typing import Any, NamedTuple

from llvmlite import ir
from numba.core import cgutils
from numba.core import types as kinds
from numba.extending import intrinsic

from layerfield.kernels.lanes import FREE, everywhere

_FLOAT, _WHOLE = ir.FloatType(), ir.IntType(64)
_SIDE_BY_SIDE = (16, 4, 1)  # pixels; fewer for those that are left over at the end of a row


class _Rows(NamedTuple):
    """Where the first pixel of each row is: of layers, of what is added to, and of the views."""

    seen: list[Any]
    first: list[Any]
    second: list[Any]
    light: Any


class _Law(NamedTuple):
    """What is added: for all layers or for the first one, of their product or sum, and twice."""

    is_product: bool
    is_one: bool
    is_twice: bool


@intrinsic
def follow(
    _: Any,
    each: Any,
    seen: Any,
    first: Any,
    second: Any,
    light: Any,
    count: Any,
    shown: Any,
    weight: Any,
    law: Any,
) -> Any:
    """Follow the paths of a row, and return the sum of r^2.

        r = a * (sum or product of the pixels) + light
        first_k += w o_k r,    second_k += w o_k^2

    with o_k the derivative of the sum or product by pixel k. Rows are given by their addresses.

    Args:
        each: something for every layer; they are known when this is compiled.
        seen: rows of the layers.
        first: rows that are added to, of all layers, or of the first of them.
        second: the same.
        light: row of what else there is.
        count: pixels.
        shown: a.
        weight: w.
        law: four times whether pixels are multiplied, twice whether the first layer alone is added
            to, and whether anything is added to `second`.
    """
    layers = len(each)
    given = (each, seen, first, second, light, count, shown, weight, law)

    def generate(context: Any, builder: Any, signature: Any, values: Sequence[Any]) -> Any:
        arrays = [
            context.make_array(kind)(context, builder, value).data
            for kind, value in zip(signature.args[1:4], values[1:4], strict=True)
        ]
        here, count, shown, weight, law = values[4:]
        total = cgutils.alloca_once_value(builder, _FLOAT(0))
        done = builder.append_basic_block()
        chosen = builder.switch(law, done)
        for flags in product((False, True), repeat=3):
            known = _Law(*flags)
            block = builder.append_basic_block()
            chosen.add_case(_WHOLE(4 * flags[0] + 2 * flags[1] + flags[2]), block)
            builder.position_at_end(block)
            made = 1 if known.is_one else layers
            numbers = layers, made, made if known.is_twice else 0
            behind = [_pointers(builder, *each) for each in zip(arrays, numbers, strict=True)]
            rows = _Rows(behind[0], behind[1], behind[2], _pointer(builder, here))
            _follow_all(builder, rows, known, count, (shown, weight), total)
            builder.branch(done)
        builder.position_at_end(done)
        return builder.load(total)

    return kinds.float32(*given), generate


def _pointers(builder: Any, array: Any, number: int) -> list[Any]:
    places = (builder.gep(array, [_WHOLE(n)]) for n in range(number))
    return [_pointer(builder, builder.load(place)) for place in places]


def _pointer(builder: Any, address: Any) -> Any:
    return builder.inttoptr(address, _FLOAT.as_pointer())


def _follow_all(
    builder: Any, rows: _Rows, law: _Law, count: Any, factors: tuple[Any, Any], total: Any
) -> None:
    """Follow paths from the first pixel to the last, as many side by side as there are."""
    begin = _WHOLE(0)
    for lanes in _SIDE_BY_SIDE:
        kind = _FLOAT if lanes == 1 else ir.VectorType(_FLOAT, lanes)
        end = builder.and_(count, _WHOLE(-lanes))
        sums = cgutils.alloca_once_value(builder, ir.Constant(kind, None))
        shown, weight = (
            factor if lanes == 1 else everywhere(builder, factor, lanes) for factor in factors
        )
        with cgutils.for_range_slice(builder, begin, end, _WHOLE(lanes), _WHOLE) as (at, _):
            one = _Pixels(builder, at, kind)
            squares = one.follow(rows, law, shown, weight)
            builder.store(builder.fadd(builder.load(sums), squares, flags=FREE), sums)
        found = builder.load(sums)
        for lane in range(lanes):
            part = found if lanes == 1 else builder.extract_element(found, ir.IntType(32)(lane))
            builder.store(builder.fadd(builder.load(total), part, flags=FREE), total)
        begin = end


class _Pixels:
    """Pixels side by side, from one of a row on."""

    def __init__(self, builder: Any, at: Any, kind: ir.Type) -> None:
        self._builder, self._at, self._kind = builder, at, kind

    def follow(self, rows: _Rows, law: _Law, shown: Any, weight: Any) -> Any:
        """Add what their paths bring, and return r^2; see `follow`."""
        pixels = [self._read(row) for row in rows.seen]
        if law.is_product:
            slopes = self._others(pixels)
            value = self._times(slopes[0], pixels[0])
        else:
            slopes, value = [None] * len(pixels), pixels[0]
            for pixel in pixels[1:]:
                value = self._plus(value, pixel)
        rest = self._plus(self._times(shown, value), self._read(rows.light))
        force = self._times(rest, weight)
        for row, slope in zip(rows.first, slopes, strict=False):
            self._add(row, force if slope is None else self._times(slope, force))
        for row, slope in zip(rows.second, slopes, strict=False):
            bent = weight if slope is None else self._times(self._times(slope, slope), weight)
            self._add(row, bent)
        return self._times(rest, rest)

    def _others(self, pixels: Sequence[Any]) -> list[Any]:
        """Return, for each, the product of what is in front of it and of what is behind it."""
        front, behind = list[Any](), list[Any]()
        for made, order in ((front, pixels), (behind, pixels[::-1])):
            made.append(None)
            for pixel in order[:-1]:
                made.append(pixel if made[-1] is None else self._times(made[-1], pixel))
        return [
            self._product(one, other) for one, other in zip(front, reversed(behind), strict=True)
        ]

    def _product(self, one: Any | None, other: Any | None) -> Any:
        if one is None:
            ones = [1.0] * getattr(self._kind, "count", 1)
            clear = ir.Constant(self._kind, ones if len(ones) > 1 else 1.0)
            return clear if other is None else other
        return one if other is None else self._times(one, other)

    def _times(self, one: Any, other: Any) -> Any:
        return self._builder.fmul(one, other, flags=FREE)

    def _plus(self, one: Any, other: Any) -> Any:
        return self._builder.fadd(one, other, flags=FREE)

    def _read(self, row: Any) -> Any:
        return self._builder.load(self._place(row), align=4)

    def _add(self, row: Any, value: Any) -> None:
        place = self._place(row)
        known = self._builder.load(place, align=4)
        self._builder.store(self._plus(known, value), place, align=4)

    def _place(self, row: Any) -> Any:
        there = self._builder.gep(row, [self._at])
        return self._builder.bitcast(there, self._kind.as_pointer())
