"""Sums of rows of 16-bit words, and pixels settled by them: what `word_sweeps` is made of.

Twice as many words as floats go side by side, and half the memory is moved. Rows are as long as
`WORDS` go into, so nothing is left over at their ends. Numba is imported here; see `compiled`.
"""

from collections.abc import Sequence
from functools import reduce
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
_ALONE = (1, WORDS), (1, EDGE)
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
def add_up_both(_: Any, both: Any, rows: Any, shared: Any, count: Any) -> Any:
    """Write two sums of rows: of those that they share, and of one more each, those behind.

    Args:
        both: addresses of two rows, apart from those that are added.
        rows: where the addresses of rows are.
        shared: how many are.
        count: of words, `EDGE` times a whole number.
    """

    def generate(_: Any, builder: Any, __: Any, values: Sequence[Any]) -> Any:
        both, rows, shared, count = values
        table = builder.inttoptr(rows, WHOLE.as_pointer())
        for lanes, places in side_by_side(builder, count, *_ADDED):
            sums = _sums(builder, lanes, places, [table], shared)
            for n, made in enumerate(cgutils.unpack_tuple(builder, both)):
                row = builder.load(builder.gep(table, [builder.add(shared, WHOLE(n))]))
                for each, place in zip(sums, places, strict=True):
                    own = lanes.read(row, place, _WORD)
                    lanes.write(builder.add(each, own), made, place)
        return WHOLE(0)

    return kinds.intp(both, rows, shared, count), generate


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
            sums = _sums(builder, lanes, places, tables, number)
            for each, place in zip(sums, places, strict=True):
                lanes.write(each, made, place)
        return WHOLE(0)

    return kinds.intp(*given), generate


def _sums(
    builder: Any, lanes: Lanes, places: Sequence[Any], tables: Sequence[Any], number: Any
) -> list[Any]:
    """Return sums of rows, in registers, masked where there is a table of masks, too."""

    def words(n: Any) -> list[Any]:
        rows = [builder.load(builder.gep(each, [n])) for each in tables]
        read = [[lanes.read(row, place, _WORD) for row in rows] for place in places]
        return [reduce(builder.and_, each) for each in read]

    return summed(builder, [lanes.constant(_WORD, 0) for _ in places], number, words)


@intrinsic
def settle_inside(
    _: Any, rows: Any, across: Any, number: Any, quotient: Any, most: Any, count: Any
) -> Any:
    """Do what `settle` does where every view looks, and add up what it takes away on the way.

    Args:
        rows: addresses of rows: P, b, what is left of b, and gains.
        across: where the addresses of rows are that are added up.
        number: of those.
        quotient: half, and by how many bits what was multiplied by a gain is shifted.
        most: the largest P.
        count: of words, `EDGE` times a whole number.
    """

    def generate(_: Any, builder: Any, __: Any, values: Sequence[Any]) -> Any:
        rows, across, number, quotient, most, count = values
        made, seen, left, gains = cgutils.unpack_tuple(builder, rows)
        half, bits = (
            builder.trunc(each, _WORD) for each in cgutils.unpack_tuple(builder, quotient)
        )
        limit, table = builder.trunc(most, _WORD), builder.inttoptr(across, WHOLE.as_pointer())
        for lanes, places in side_by_side(builder, count, *_ADDED):
            sums = _sums(builder, lanes, places, [table], number)
            for shown, place in zip(sums, places, strict=True):
                rest = _less(builder, lanes, lanes.read(seen, place, _WORD), shown)
                lanes.write(rest, left, place)
                gain = lanes.read(gains, place, _WORD)  # a number would be no word before the loop
                found = _high_product(builder, lanes, builder.add(rest, lanes.all(half)), gain)
                found = builder.lshr(found, lanes.all(bits))
                lanes.write(_at_most(builder, found, lanes.all(limit)), made, place)
        return WHOLE(0)

    return kinds.intp(rows, across, number, quotient, most, count), generate


@intrinsic
def settle(_: Any, rows: Any, most: Any, count: Any) -> Any:
    """Write P = min(max(b - sum, 0) / views, most), and what is left of b where the sum was.

    Rounded exactly, see `_quotients` of `words`: what views hardly see would grow from sweep to
    sweep otherwise, or fade. Words without a gain stay.

    Args:
        rows: addresses of rows: P, b, the sum, halves, gains and powers.
        most: the largest P.
        count: of words, `EDGE` times a whole number.
    """

    def generate(_: Any, builder: Any, __: Any, values: Sequence[Any]) -> Any:
        rows, most, count = values
        made, seen, total, *quotient = cgutils.unpack_tuple(builder, rows)
        limit = builder.trunc(most, _WORD)
        for lanes, (place,) in side_by_side(builder, count, (1, EDGE)):
            light, shown, half, gain, power, own = (
                lanes.read(row, place, _WORD) for row in (seen, total, *quotient, made)
            )
            rest = _less(builder, lanes, light, shown)
            lanes.write(rest, total, place)
            found = _high_product(builder, lanes, builder.add(rest, half), gain)
            is_seen = builder.icmp_unsigned("!=", gain, lanes.constant(_WORD, 0))
            kept = builder.add(own, lanes.constant(_WORD, 1))  # as if it had been multiplied once
            found = builder.select(is_seen, found, kept)
            found = _high_product(builder, lanes, found, power)
            lanes.write(_at_most(builder, found, lanes.all(limit)), made, place)
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
        count: of words, `EDGE` times a whole number.
    """

    def generate(_: Any, builder: Any, __: Any, values: Sequence[Any]) -> Any:
        rows, *numbers, count = values
        here, ago, thresholds = cgutils.unpack_tuple(builder, rows)
        factor, shift, limit = (builder.trunc(each, _WORD) for each in numbers)
        for lanes, (place,) in side_by_side(builder, count, *_ALONE):
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


def _less(builder: Any, lanes: Lanes, one: Any, other: Any) -> Any:
    """Return one word less another, both without a sign, 0 at the least."""
    more = builder.icmp_unsigned(">", one, other)
    return builder.select(more, builder.sub(one, other), lanes.constant(_WORD, 0))


def _at_most(builder: Any, one: Any, other: Any) -> Any:
    """Return the lesser of words without a sign."""
    return builder.select(builder.icmp_unsigned("<", one, other), one, other)


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
