"""Small matrices, one for every frequency of a row, times what is there.

Sums over layers stay in the processor's registers: as one simple loop after the other, they would
pass through the cache for every layer. Numba is imported here; see `compiled`.
"""

from collections.abc import Sequence
from itertools import chain
from typing import Any

from llvmlite import ir
from numba.core import cgutils
from numba.extending import intrinsic

from layerfield.kernels.lanes import FREE, Memory, generated
from layerfield.kernels.symbols import BESIDE

_LANES = 16  # of a vector
_VECTOR = ir.VectorType(ir.FloatType(), _LANES)
_VECTORS = BESIDE // _LANES


@intrinsic
@generated
def multiply_rows(
    builder: Any,
    number: Any,
    width: Any,
    forth: Memory,
    back: Memory,
    across: Memory,
    here: Memory,
    there: Memory,
    made: Memory,
    other: Memory,
) -> None:
    """Find made = forth here + across there and other = back there + across here.

    Args:
        builder: of what is compiled.
        number: of layers.
        width: numbers of a row, a multiple of `BESIDE`.
        forth: rows of the entries [k, m], k <= m, of symmetric matrices.
        back: the same.
        across: the same.
        here: rows of all layers.
        there: the same.
        made: the same.
        other: the same.
    """
    sums = [[cgutils.alloca_once(builder, _VECTOR) for _ in range(2)] for _ in range(_VECTORS)]
    span = width.type(0), width, width.type(BESIDE), width.type
    beside = cgutils.for_range_slice(builder, *span)
    with beside as (x, _), cgutils.for_range(builder, number) as to:
        for total in chain(*sums):
            builder.store(ir.Constant(_VECTOR, None), total)
        with cgutils.for_range(builder, number) as come:
            entry = _place(builder, _entry(builder, to.index, come.index, number), width, x)
            row = _place(builder, come.index, width, x)
            for part, (total, rest) in enumerate(sums):
                one, two, both = (
                    _read(each, builder, entry, part) for each in (forth, back, across)
                )
                z, r = (_read(each, builder, row, part) for each in (here, there))
                _add(builder, total, (one, z), (both, r))
                _add(builder, rest, (two, r), (both, z))
        row = _place(builder, to.index, width, x)
        for part, totals in enumerate(sums):
            for result, total in zip((made, other), totals, strict=True):
                result.write(builder.load(total), builder.add(row, row.type(_LANES * part)))


def _entry(builder: Any, k: Any, m: Any, number: Any) -> Any:
    """Return the number of an entry above the diagonal."""
    is_above = builder.icmp_signed("<", k, m)
    first, second = builder.select(is_above, k, m), builder.select(is_above, m, k)
    return builder.add(builder.mul(first, number), second)


def _place(builder: Any, row: Any, width: Any, x: Any) -> Any:
    return builder.add(builder.mul(row, width), x)


def _read(array: Memory, builder: Any, place: Any, part: int) -> Any:
    return array.read(builder.add(place, place.type(_LANES * part)), _VECTOR)


def _add(builder: Any, total: Any, *products: Sequence[Any]) -> None:
    found = builder.load(total)
    for one, other in products:
        found = builder.fadd(found, builder.fmul(one, other, flags=FREE), flags=FREE)
    builder.store(found, total)
