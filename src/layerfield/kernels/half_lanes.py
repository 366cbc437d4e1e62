"""Rows of half size brought to whole size in 16-bit words: what `half_words` is made of.

Numbers are four times less than words hold: sums of four are words, too. Numba is imported here;
see `compiled`.
"""

from collections.abc import Sequence
from typing import Any

from llvmlite import ir
from numba.core import cgutils
from numba.core import types as kinds
from numba.extending import intrinsic

from layerfield.kernels.side_by_side import WHOLE, Lanes, side_by_side
from layerfield.kernels.unsigned import BITS, INT, WORD, high_product
from layerfield.kernels.words import WORDS

_SHAPE = 1, WORDS


@intrinsic
def blend(_: Any, made: Any, near: Any, far: Any, count: Any) -> Any:
    """Write (3 near + far) / 4, rounded.

    Args:
        made: address of a row.
        near: likewise.
        far: likewise.
        count: of numbers, `WORDS` times a whole number.
    """

    def generate(_: Any, builder: Any, __: Any, values: Sequence[Any]) -> Any:
        made, near, far, count = values
        for lanes, (place,) in side_by_side(builder, count, _SHAPE):
            one, other = (lanes.read(row, place, WORD) for row in (near, far))
            lanes.write(_blended(builder, lanes, one, other), made, place)
        return WHOLE(0)

    return kinds.intp(made, near, far, count), generate


@intrinsic
def spread(_: Any, made: Any, row: Any, count: Any) -> Any:
    """Write two numbers for each: (3 row[x] + row[x - 1]) / 4, and the same with row[x + 1].

    Args:
        made: address of a row twice as long.
        row: address of one that goes on at both ends.
        count: of numbers, `WORDS` times a whole number.
    """

    def generate(_: Any, builder: Any, __: Any, values: Sequence[Any]) -> Any:
        made, row, count = values
        for lanes, (place,) in side_by_side(builder, count, _SHAPE):
            before, after = (builder.add(place, WHOLE(step)) for step in (-1, 1))
            left, here, right = (lanes.read(row, each, WORD) for each in (before, place, after))
            both = (_blended(builder, lanes, here, each) for each in (left, right))
            by_turns = [n // 2 + WORDS * (n % 2) for n in range(2 * WORDS)]
            mask = ir.Constant(ir.VectorType(INT, 2 * WORDS), by_turns)
            wide = builder.shuffle_vector(*both, mask)
            Lanes(builder, 2 * WORDS).write(wide, made, builder.add(place, place))
        return WHOLE(0)

    return kinds.intp(made, row, count), generate


@intrinsic
def start(_: Any, rows: Any, rest: Any, bits: Any, most: Any, count: Any) -> Any:
    """Write min(shares b / 2^16 ratio / 2^bits, most), rounded.

    Where shares are 0, the rest takes the place of the first two.

    Args:
        rows: addresses of rows: two that are written, b, shares, and ratios.
        rest: a word.
        bits: of a ratio that stand behind its point; what shares make of b has no more than they.
        most: the largest word, less than 2^15.
        count: of words, `WORDS` times a whole number.
    """

    def generate(_: Any, builder: Any, __: Any, values: Sequence[Any]) -> Any:
        rows, *numbers, count = values
        *made, seen, shares, ratios = cgutils.unpack_tuple(builder, rows)
        rest, bits, limit = (builder.trunc(each, WORD) for each in numbers)
        finer = builder.sub(WORD(BITS), bits)  # bits that e is told in, behind its point
        for lanes, (place,) in side_by_side(builder, count, _SHAPE):
            light, share, ratio = (lanes.read(row, place, WORD) for row in (seen, shares, ratios))
            high = builder.shl(high_product(builder, lanes, light, share), lanes.all(finer))
            low = builder.lshr(builder.mul(light, share), lanes.all(bits))
            is_seen = builder.icmp_unsigned("!=", share, lanes.constant(WORD, 0))
            dark = lanes.all(builder.shl(rest, finer))
            begun = builder.select(is_seen, builder.or_(high, low), dark)
            beyond = builder.lshr(builder.mul(begun, ratio), lanes.constant(WORD, BITS - 1))
            found = builder.add(high_product(builder, lanes, begun, ratio), beyond)
            largest = lanes.all(limit)
            found = builder.select(builder.icmp_unsigned("<", found, largest), found, largest)
            for row in made:
                lanes.write(found, row, place)
        return WHOLE(0)

    return kinds.intp(rows, rest, bits, most, count), generate


def _blended(builder: Any, lanes: Lanes, near: Any, far: Any) -> Any:
    three, two = lanes.constant(WORD, 3), lanes.constant(WORD, 2)
    total = builder.add(builder.mul(near, three), builder.add(far, two))
    return builder.lshr(total, two)
