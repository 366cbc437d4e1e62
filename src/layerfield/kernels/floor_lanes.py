"""How far words may fall, and what that leaves as the least of larger pixels: see `floors`.

Numba is imported here; see `compiled`.
"""

from collections.abc import Sequence
from typing import Any

from llvmlite import ir
from numba.core import cgutils
from numba.core import types as kinds
from numba.extending import intrinsic

from layerfield.kernels.floors import FAR, PARTS
from layerfield.kernels.side_by_side import WHOLE, Lanes, side_by_side
from layerfield.kernels.unsigned import INT, WORD, high_product, less, lesser
from layerfield.kernels.words import WORDS

_SHAPE = 1, WORDS


@intrinsic
def lessen(_: Any, made: Any, rows: Any, count: Any) -> Any:
    """Write min(made, shares b / 2^16 - least), no less than 0; where shares are 0 it stays.

    Args:
        made: address of a row.
        rows: addresses of rows: b, shares, and least.
        count: of words, `WORDS` times a whole number.
    """

    def generate(_: Any, builder: Any, __: Any, values: Sequence[Any]) -> Any:
        made, rows, count = values
        rows = cgutils.unpack_tuple(builder, rows)
        for lanes, (place,) in side_by_side(builder, count, _SHAPE):
            light, share, least = (lanes.read(row, place, WORD) for row in rows)
            own = lanes.read(made, place, WORD)
            fall = less(builder, lanes, high_product(builder, lanes, light, share), least)
            is_seen = builder.icmp_unsigned("!=", share, lanes.constant(WORD, 0))
            fall = builder.select(is_seen, fall, own)
            lanes.write(lesser(builder, fall, own), made, place)
        return WHOLE(0)

    return kinds.intp(made, rows, count), generate


@intrinsic
def write_floor(_: Any, made: Any, rows: Any, falls: Any, unit: Any, count: Any) -> Any:
    """Write shares b / 2^16 - unit least / `PARTS`, no less than 0.

    The least of word x is that of falls[2 x] to falls[2 x + 3], of two rows.

    Args:
        made: address of a row.
        rows: addresses of b and shares.
        falls: addresses of two rows twice as long and 2 more.
        unit: what 1 of those comes to, less than 2^16.
        count: of words, `WORDS` times a whole number.
    """

    def generate(_: Any, builder: Any, __: Any, values: Sequence[Any]) -> Any:
        made, rows, falls, unit, count = values
        rows, falls = (cgutils.unpack_tuple(builder, each) for each in (rows, falls))
        factor = builder.trunc(unit, INT)
        wide = Lanes(builder, 2 * WORDS)
        for lanes, (place,) in side_by_side(builder, count, _SHAPE):
            light, share = (lanes.read(row, place, WORD) for row in rows)
            first = builder.add(place, place)
            least = lanes.constant(WORD, FAR)
            for row in falls:
                for step in (0, 2):
                    both = wide.read(row, builder.add(first, WHOLE(step)), WORD)
                    for begin in (0, 1):
                        least = lesser(builder, least, _every_other(builder, both, begin))
            whole = builder.mul(builder.zext(least, lanes.of(INT)), lanes.all(factor))
            whole = builder.lshr(whole, lanes.constant(INT, PARTS.bit_length() - 1))
            fall = builder.trunc(lesser(builder, whole, lanes.constant(INT, FAR)), lanes.of(WORD))
            own = high_product(builder, lanes, light, share)
            lanes.write(less(builder, lanes, own, fall), made, place)
        return WHOLE(0)

    return kinds.intp(made, rows, falls, unit, count), generate


def _every_other(builder: Any, both: Any, begin: int) -> Any:
    places = ir.Constant(ir.VectorType(INT, WORDS), [2 * n + begin for n in range(WORDS)])
    return builder.shuffle_vector(both, both, places)
