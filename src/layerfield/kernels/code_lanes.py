"""Sums of rows of codes, and what they stand for: what `code_sums` is made of.

Numba is imported here; see `compiled`.
"""

from collections.abc import Sequence
from typing import Any

from llvmlite import ir
from numba.core import types as kinds
from numba.extending import intrinsic

from layerfield.kernels.side_by_side import WHOLE, Lanes, side_by_side, summed

_FLOAT = ir.FloatType()
_SHAPES = (4, 16), (1, 16), (1, 1)  # vectors, and codes of each


@intrinsic
def add_codes(_: Any, sums: Any, codes: Any, made: Any, rows: Any, number: Any, count: Any) -> Any:
    """Add sum_n rows[n][x] to made[x]; a sum is read and written once for all rows.

    Args:
        sums: an array of what sums are.
        codes: an array of what codes are.
        made: address of a row of sums.
        rows: where the addresses of rows of codes are.
        number: of rows.
        count: of codes in each.
    """
    total, code = (ir.IntType(each.dtype.bitwidth) for each in (sums, codes))

    def generate(_: Any, builder: Any, __: Any, values: Sequence[Any]) -> Any:
        *_, made, table, number, count = values
        table = builder.inttoptr(table, WHOLE.as_pointer())
        for lanes, places in side_by_side(builder, count, *_SHAPES):

            def wide(n: Any, lanes: Lanes = lanes, places: Sequence[Any] = places) -> list[Any]:
                row = builder.load(builder.gep(table, [n]))
                read = (lanes.read(row, place, code) for place in places)
                return [builder.zext(each, lanes.of(total)) for each in read]

            begun = [lanes.read(made, place, total) for place in places]
            for each, place in zip(summed(builder, begun, number, wide), places, strict=True):
                lanes.write(each, made, place)
        return WHOLE(0)

    return kinds.intp(sums, codes, made, rows, number, count), generate


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
