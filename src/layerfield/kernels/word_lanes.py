"""Sums of rows of 16-bit words, and pixels settled by them: what `word_sweeps` is made of.

Twice as many words as floats go side by side, and half the memory is moved. Rows are as long as
`WORDS` go into, so nothing is left over at their ends. Numba is imported here; see `compiled`.
"""

from collections.abc import Sequence
from typing import Any

from llvmlite import ir
from numba.core import cgutils
from numba.core import types as kinds
from numba.extending import intrinsic

from layerfield.kernels.lanes import FREE
from layerfield.kernels.side_by_side import WHOLE, Lanes, side_by_side, summed
from layerfield.kernels.words import EDGE, WORDS

_WORD, _INT, _FLOAT = ir.IntType(16), ir.IntType(32), ir.FloatType()
_ADDED = (4, WORDS), (1, WORDS), (1, EDGE)  # vectors, and words of each
_ONE_BY_ONE = (1, WORDS), (1, 1)  # floats are as many as there are pixels
_BITS = 16


@intrinsic
def add_up(_: Any, made: Any, rows: Any, number: Any, count: Any) -> Any:
    """Write made[x] = sum_n rows[n][x].

    Args:
        made: address of a row, apart from those that are added.
        rows: where the addresses of rows are.
        number: of rows, one at the least.
        count: of words, `EDGE` times a whole number.
    """
    return _adding(made, rows, number, count, is_masked=False)


@intrinsic
def add_masked(_: Any, made: Any, rows: Any, masks: Any, number: Any, count: Any) -> Any:
    """Write made[x] = sum_n masks[n][x] & rows[n][x], as `add_up` does.

    Args:
        made: address of a row, apart from those that are added.
        rows: where the addresses of rows are.
        masks: where those of rows of masks are.
        number: of rows, one at the least.
        count: of words, `EDGE` times a whole number.
    """
    return _adding(made, rows, masks, number, count, is_masked=True)


def _adding(*given: Any, is_masked: bool) -> Any:
    """Return the kinds of a sum of rows, and what generates it."""

    def generate(_: Any, builder: Any, __: Any, values: Sequence[Any]) -> Any:
        made, *tables, number, count = values
        tables = [builder.inttoptr(each, WHOLE.as_pointer()) for each in tables]
        for lanes, places in side_by_side(builder, count, *_ADDED):

            def words(n: Any, lanes: Lanes = lanes, places: Sequence[Any] = places) -> list[Any]:
                rows = [builder.load(builder.gep(each, [n])) for each in tables]
                read = [[lanes.read(row, place, _WORD) for row in rows] for place in places]
                return [builder.and_(*each) if is_masked else each[0] for each in read]

            begun = [lanes.constant(_WORD, 0) for _ in places]
            for each, place in zip(summed(builder, begun, number, words), places, strict=True):
                lanes.write(each, made, place)
        return WHOLE(0)

    return kinds.intp(*given), generate


@intrinsic
def settle(_: Any, rows: Any, most: Any, count: Any) -> Any:
    """Write P = min(max(b - sum, 0) / views, most), and what is left of b where the sum was.

    Rounded exactly, see `_quotients` of `words`: what views hardly see would grow from sweep to
    sweep otherwise, or fade. Words without a gain stay.

    Args:
        rows: addresses of rows: P, b, the sum, halves, gains and powers.
        most: the largest P.
        count: of words, `WORDS` times a whole number.
    """

    def generate(_: Any, builder: Any, __: Any, values: Sequence[Any]) -> Any:
        rows, most, count = values
        made, seen, total, *quotient = cgutils.unpack_tuple(builder, rows)
        limit = builder.trunc(most, _WORD)
        for lanes, (place,) in side_by_side(builder, count, (1, WORDS)):
            light, shown, half, gain, power, own = (
                lanes.read(row, place, _WORD) for row in (seen, total, *quotient, made)
            )
            zero, largest = lanes.constant(_WORD, 0), lanes.all(limit)
            more = builder.icmp_unsigned(">", light, shown)
            rest = builder.select(more, builder.sub(light, shown), zero)
            lanes.write(rest, total, place)
            found = _high_product(builder, lanes, builder.add(rest, half), gain)
            is_seen = builder.icmp_unsigned("!=", gain, zero)
            kept = builder.add(own, lanes.constant(_WORD, 1))  # as if it had been multiplied once
            found = builder.select(is_seen, found, kept)
            found = _high_product(builder, lanes, found, power)
            found = builder.select(builder.icmp_unsigned("<", found, largest), found, largest)
            lanes.write(found, made, place)
        return WHOLE(0)

    return kinds.intp(rows, most, count), generate


@intrinsic
def push(_: Any, rows: Any, share: Any, more: Any, most: Any, count: Any) -> Any:
    """Write P <- min(max(P + share (P - last P), 0), most), and last P <- P of before.

    What is added is rounded up as often as what lies beyond its whole part says: where it is above
    a threshold. Rounded to the nearest, the last 1 of a change would be pushed on forever.

    Args:
        rows: addresses of rows: P, P of one sweep ago, and thresholds, all words.
        share: in parts of 2^15.
        more: by which thresholds go up; beyond 2^16 they begin anew.
        most: the largest P, less than 2^14.
        count: of words, `WORDS` times a whole number.
    """

    def generate(_: Any, builder: Any, __: Any, values: Sequence[Any]) -> Any:
        rows, *numbers, count = values
        here, ago, thresholds = cgutils.unpack_tuple(builder, rows)
        factor, shift, limit = (builder.trunc(each, _WORD) for each in numbers)
        for lanes, (place,) in side_by_side(builder, count, (1, WORDS)):
            now, before, threshold = (
                lanes.read(each, place, _WORD) for each in (here, ago, thresholds)
            )
            zero, largest = lanes.constant(_WORD, 0), lanes.all(limit)
            lanes.write(now, ago, place)
            change = builder.shl(builder.sub(now, before), lanes.constant(_WORD, 1))
            whole, beyond = _product(builder, lanes, change, lanes.all(factor))
            is_up = builder.icmp_unsigned(">", beyond, builder.add(threshold, lanes.all(shift)))
            found = builder.add(now, builder.add(whole, builder.zext(is_up, lanes.of(_WORD))))
            found = builder.select(builder.icmp_signed(">", found, zero), found, zero)
            found = builder.select(builder.icmp_signed("<", found, largest), found, largest)
            lanes.write(found, here, place)
        return WHOLE(0)

    return kinds.intp(rows, share, more, most, count), generate


@intrinsic
def to_words(_: Any, made: Any, source: Any, factor: Any, most: Any, count: Any) -> Any:
    """Write round(min(max(factor * source, 0), most)).

    Args:
        made: addresses of rows of words that are all written.
        source: of one of single precision.
        factor: of single precision.
        most: likewise.
        count: of words.
    """

    def generate(_: Any, builder: Any, __: Any, values: Sequence[Any]) -> Any:
        rows, source, factor, most, count = values
        for lanes, (place,) in side_by_side(builder, count, *_ONE_BY_ONE):
            low, half = lanes.constant(_FLOAT, 0.0), lanes.constant(_FLOAT, 0.5)
            high, share = lanes.all(most), lanes.all(factor)
            value = builder.fmul(lanes.read(source, place, _FLOAT), share, flags=FREE)
            value = builder.select(builder.fcmp_ordered("<", value, low), low, value)
            value = builder.select(builder.fcmp_ordered(">", value, high), high, value)
            whole = builder.fptosi(builder.fadd(value, half, flags=FREE), lanes.of(_INT))
            for row in cgutils.unpack_tuple(builder, rows):
                lanes.write(builder.trunc(whole, lanes.of(_WORD)), row, place)
        return WHOLE(0)

    return kinds.intp(made, source, factor, most, count), generate


@intrinsic
def to_light(_: Any, rows: Any, gain: Any, unit: Any, count: Any) -> Any:
    """Write min(gain * gains * rest, 1), or unit * P for pixels without a gain.

    Args:
        rows: addresses of rows: what is written, gains, both of single precision, what is left of
            b, and P.
        gain: of single precision.
        unit: likewise.
        count: of pixels.
    """

    def generate(_: Any, builder: Any, __: Any, values: Sequence[Any]) -> Any:
        rows, gain, unit, count = values
        made, gains, *words = cgutils.unpack_tuple(builder, rows)
        for lanes, (place,) in side_by_side(builder, count, *_ONE_BY_ONE):
            one, zero = lanes.constant(_FLOAT, 1.0), lanes.constant(_FLOAT, 0.0)
            shares = lanes.read(gains, place, _FLOAT)
            known = builder.fmul(shares, lanes.all(gain), flags=FREE)
            whole = [builder.zext(lanes.read(row, place, _WORD), lanes.of(_INT)) for row in words]
            rest, own = (builder.sitofp(each, lanes.of(_FLOAT)) for each in whole)
            value = builder.fmul(rest, known, flags=FREE)
            value = builder.select(builder.fcmp_ordered(">", value, one), one, value)
            dark = builder.fmul(own, lanes.all(unit), flags=FREE)
            is_seen = builder.fcmp_ordered(">", known, zero)
            lanes.write(builder.select(is_seen, value, dark), made, place)
        return WHOLE(0)

    return kinds.intp(rows, gain, unit, count), generate


def _high_product(builder: Any, lanes: Lanes, one: Any, other: Any) -> Any:
    """Return the product of words without a sign over 2^16, rounded down."""
    wide = (builder.zext(each, lanes.of(_INT)) for each in (one, other))
    whole = builder.lshr(builder.mul(*wide), lanes.constant(_INT, _BITS))
    return builder.trunc(whole, lanes.of(_WORD))


def _product(builder: Any, lanes: Lanes, one: Any, other: Any) -> tuple[Any, Any]:
    """Return the product of words with a sign over 2^16, rounded down, and what lies beyond."""
    wide = (builder.sext(each, lanes.of(_INT)) for each in (one, other))
    whole = builder.ashr(builder.mul(*wide), lanes.constant(_INT, _BITS))
    return builder.trunc(whole, lanes.of(_WORD)), builder.mul(one, other)
