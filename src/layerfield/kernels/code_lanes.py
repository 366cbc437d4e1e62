"""Sums of rows of codes, and what they stand for: what `code_sums` is made of.

Numba is imported here; see `compiled`.
"""

from collections.abc import Sequence
from typing import Any

from llvmlite import ir
from numba.core import cgutils
from numba.core import types as kinds
from numba.extending import intrinsic

from layerfield.kernels.ahead import LINE, ONCE, fetch_line
from layerfield.kernels.side_by_side import WHOLE, Lanes, side_by_side, summed

_FLOAT = ir.FloatType()
_SHAPES = (4, 16), (1, 16), (1, 1)  # vectors, and codes of each
_BITS = 256  # of a vector


@intrinsic
def add_codes(_: Any, sums: Any, codes: Any, made: Any, rows: Any, number: Any, span: Any) -> Any:
    """Add sum_n rows[n][x] to made[x]; a sum is read and written once for all rows.

    Args:
        sums: an array of what sums are.
        codes: an array of what codes are.
        made: address of a row of sums.
        rows: where the addresses of rows of codes are.
        number: of rows.
        span: the first x, and how many.
    """
    total, code = (ir.IntType(each.dtype.bitwidth) for each in (sums, codes))

    def generate(_: Any, builder: Any, __: Any, values: Sequence[Any]) -> Any:
        *_, made, table, number, span = values
        begin, count = cgutils.unpack_tuple(builder, span)
        table = builder.inttoptr(table, WHOLE.as_pointer())
        for lanes, beyond in side_by_side(builder, count, *_SHAPES):
            places = [builder.add(begin, place) for place in beyond]

            def wide(n: Any, lanes: Lanes = lanes, places: Sequence[Any] = places) -> list[Any]:
                row = builder.load(builder.gep(table, [n]))
                read = (lanes.read(row, place, code) for place in places)
                return [builder.zext(each, lanes.of(total)) for each in read]

            begun = [lanes.read(made, place, total) for place in places]
            for each, place in zip(summed(builder, begun, number, wide), places, strict=True):
                lanes.write(each, made, place)
        return WHOLE(0)

    return kinds.intp(sums, codes, made, rows, number, span), generate


@intrinsic
def sum_codes(_: Any, sums: Any, codes: Any, made: Any, rows: Any, number: Any, span: Any) -> Any:
    """Write made[x] = sum_n rows[n][x], for at least `SUMMED` x.

    Where sums are twice as long as codes two of these go as one number: sums of such, and of what
    stands in their upper halves, tell both. What is needed later is fetched meanwhile, little by
    little: many lines that are asked for at once wait for each other.

    Args:
        sums: as `add_codes` has it.
        codes: likewise.
        made: likewise.
        rows: where the addresses of rows of codes are, and those of rows that are fetched.
        number: as `add_codes` has it.
        span: likewise.
    """
    total, code = (ir.IntType(each.dtype.bitwidth) for each in (sums, codes))
    in_pairs = total.width == 2 * code.width
    length = _BITS // (code if in_pairs else total).width  # codes of a vector
    kind = ir.VectorType(total, length // 2 if in_pairs else length)

    def generate(_: Any, builder: Any, __: Any, values: Sequence[Any]) -> Any:
        *_, made, rows, number, span = values
        begin, count = cgutils.unpack_tuple(builder, span)
        tables = [
            builder.inttoptr(each, WHOLE.as_pointer())
            for each in cgutils.unpack_tuple(builder, rows)
        ]
        lanes = Lanes(builder, length)

        def write(places: Sequence[Any]) -> None:
            def found(n: Any) -> list[Any]:
                row, later = (builder.load(builder.gep(each, [n])) for each in tables)
                _fetch(builder, later, places[0], len(places) * length, code.width // 8)
                read = [lanes.read(row, place, code) for place in places]
                if not in_pairs:
                    return [builder.zext(each, kind) for each in read]
                both = [builder.bitcast(each, kind) for each in read]
                return [*both, *(builder.lshr(each, upper) for each in both)]

            upper = Lanes(builder, kind.count).constant(total, code.width)
            none = [ir.Constant(kind, None)] * (len(places) * (1 + in_pairs))
            parts = summed(builder, none, number, found)
            if in_pairs:
                both, high = parts[: len(places)], parts[len(places) :]
                low = [
                    builder.sub(one, builder.shl(other, upper))
                    for one, other in zip(both, high, strict=True)
                ]
                parts = [_by_turns(builder, *each) for each in zip(low, high, strict=True)]
            for each, place in zip(parts, places, strict=True):
                lanes.write(each, made, place)

        for _, places in side_by_side(builder, count, (4, length), (1, length)):
            write([builder.add(begin, place) for place in places])
        is_over = builder.icmp_unsigned("!=", builder.and_(count, WHOLE(length - 1)), WHOLE(0))
        with builder.if_then(is_over):  # some once more
            write([builder.sub(builder.add(begin, count), WHOLE(length))])
        return WHOLE(0)

    return kinds.intp(sums, codes, made, rows, number, span), generate


def _fetch(builder: Any, row: Any, place: Any, count: int, size: int) -> None:
    """Have so many codes of a row fetched, from a place on, given the bytes of one.

    Rows of layers that follow soon look at them, and nobody after those: all codes together are
    more than all that is made of them, and would drive it out of the last cache.
    """
    first = builder.add(row, builder.mul(place, WHOLE(size)))
    for at in range(0, count * size, LINE):
        fetch_line(builder, builder.add(first, WHOLE(at)), ONCE)


def _by_turns(builder: Any, even: Any, odd: Any) -> Any:
    """Return numbers of two vectors by turns."""
    half = even.type.count
    order = [n // 2 + half * (n % 2) for n in range(2 * half)]
    mask = ir.Constant(ir.VectorType(ir.IntType(32), 2 * half), order)
    return builder.shuffle_vector(even, odd, mask)


@intrinsic
def to_words(_: Any, sums: Any, made: Any, row: Any, factor: Any, most: Any, count: Any) -> Any:
    """Write round(min(factor row[x], most)) in 16-bit words.

    Args:
        sums: an array of what sums are.
        made: address of a row of words.
        row: address of a row of sums.
        factor: of single precision.
        most: likewise.
        count: of sums.
    """
    total = ir.IntType(sums.dtype.bitwidth)

    def generate(_: Any, builder: Any, __: Any, values: Sequence[Any]) -> Any:
        _, made, row, factor, most, count = values
        for lanes, places in side_by_side(builder, count, *_SHAPES):
            half, high, share = lanes.constant(_FLOAT, 0.5), lanes.all(most), lanes.all(factor)
            for place in places:
                found = builder.sitofp(lanes.read(row, place, total), lanes.of(_FLOAT))
                value = lanes.fused(found, share, half)
                value = builder.select(builder.fcmp_ordered(">", value, high), high, value)
                whole = builder.fptosi(value, lanes.of(ir.IntType(32)))
                lanes.write(builder.trunc(whole, lanes.of(ir.IntType(16))), made, place)
        return WHOLE(0)

    return kinds.intp(sums, made, row, factor, most, count), generate


@intrinsic
def to_light(_: Any, sums: Any, made: Any, row: Any, unit: Any, rest: Any, count: Any) -> Any:
    """Write (unit + rest) row[x], rounded once: what is exact stays so.

    Args:
        sums: an array of what sums are.
        made: address of a row of single precision.
        row: address of a row of sums.
        unit: of single precision.
        rest: likewise: what a number of single precision does not hold.
        count: of sums.
    """
    total = ir.IntType(sums.dtype.bitwidth)

    def generate(_: Any, builder: Any, __: Any, values: Sequence[Any]) -> Any:
        _, made, row, unit, rest, count = values
        for lanes, places in side_by_side(builder, count, *_SHAPES):
            for place in places:
                found = builder.sitofp(lanes.read(row, place, total), lanes.of(_FLOAT))
                small = builder.fmul(found, lanes.all(rest))
                lanes.write(lanes.fused(found, lanes.all(unit), small), made, place)
        return WHOLE(0)

    return kinds.intp(sums, made, row, unit, rest, count), generate
