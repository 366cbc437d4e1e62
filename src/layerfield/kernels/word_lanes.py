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
from layerfield.kernels.unsigned import BITS, INT, WORD, high_product, less, within
from layerfield.kernels.words import WORDS

_FLOAT = ir.FloatType()
_ALONE = (1, WORDS)  # vectors, and words of each
_ADDED = (4, WORDS), _ALONE
_ONE_BY_ONE = _ALONE, (1, 1)  # floats are as many as there are pixels


@intrinsic
def add_up(_: Any, made: Any, rows: Any, number: Any, count: Any) -> Any:
    """Write made[x] = sum_n rows[n][x].

    Args:
        made: address of a row, apart from those that are added.
        rows: where the addresses of rows are.
        number: of rows, one at the least.
        count: of words, `WORDS` times a whole number.
    """

    def generate(_: Any, builder: Any, __: Any, values: Sequence[Any]) -> Any:
        made, rows, number, count = values
        table = builder.inttoptr(rows, WHOLE.as_pointer())
        for lanes, places in side_by_side(builder, count, *_ADDED):
            sums = _sums(builder, lanes, [places], [table], number)
            for each, place in zip(sums, places, strict=True):
                lanes.write(each, made, place)
        return WHOLE(0)

    return kinds.intp(made, rows, number, count), generate


@intrinsic
def add_up_both(_: Any, both: Any, first: Any, apart: Any, shared: Any, count: Any) -> Any:
    """Write two sums of rows: of those that they share, and of one more each, those behind.

    Args:
        both: addresses of two rows, apart from those that are added.
        first: address that rows are so many bytes apart from,
        apart: as are here.
        shared: how many are.
        count: of words, `WORDS` times a whole number.
    """

    def generate(_: Any, builder: Any, __: Any, values: Sequence[Any]) -> Any:
        both, first, apart, shared, count = values
        table = builder.inttoptr(apart, WHOLE.as_pointer())

        def row(n: Any) -> Any:
            return builder.add(first, builder.load(builder.gep(table, [n])))

        for lanes, places in side_by_side(builder, count, *_ADDED):

            def words(
                n: Any, lanes: Lanes = lanes, places: Sequence[Any] = places
            ) -> Sequence[Any]:
                there = row(n)
                return [lanes.read(there, place, WORD) for place in places]

            none = [lanes.constant(WORD, 0) for _ in places]
            sums = summed(builder, none, shared, words)
            for n, made in enumerate(cgutils.unpack_tuple(builder, both)):
                own = words(builder.add(shared, WHOLE(n)))
                for each, more, place in zip(sums, own, places, strict=True):
                    lanes.write(builder.add(each, more), made, place)
        return WHOLE(0)

    return kinds.intp(both, first, apart, shared, count), generate


def _sums(
    builder: Any,
    lanes: Lanes,
    places: Sequence[Sequence[Any]],
    tables: Sequence[Any],
    number: Any,
) -> list[Any]:
    """Return sums of rows, in registers, masked where there is a table of masks, too.

    Each table has places of its own.
    """

    def words(n: Any) -> list[Any]:
        rows = [builder.load(builder.gep(each, [n])) for each in tables]
        read = [
            [lanes.read(row, place, WORD) for place in own]
            for row, own in zip(rows, places, strict=True)
        ]
        return [reduce(builder.and_, each) for each in zip(*read, strict=True)]

    return summed(builder, [lanes.constant(WORD, 0) for _ in places[0]], number, words)


@intrinsic
def settle_inside(
    _: Any,
    rows: Any,
    ahead: Any,
    noise: Any,
    across: Any,
    number: Any,
    quotient: Any,
    most: Any,
    span: Any,
    apart: Any,
) -> Any:
    """Do what `settle` does where every view looks.

    Args:
        rows: addresses of rows: P, b, what is left of b, the least P, and gains.
        ahead: as `settle` has it.
        noise: likewise.
        across: likewise.
        number: likewise.
        quotient: half, and by how many bits what was multiplied by a gain is shifted.
        most: the largest P.
        span: the first word, and how many, `WORDS` times a whole number.
        apart: as `settle` has it.
    """

    def generate(_: Any, builder: Any, __: Any, values: Sequence[Any]) -> Any:
        rows, ahead, noise, across, number, quotient, most, span, apart = _apart(
            builder, given, values
        )
        made, seen, left, floor, gains = rows
        half, bits, limit = (builder.trunc(each, WORD) for each in (*quotient, most))
        table = builder.inttoptr(across, WHOLE.as_pointer())
        begin, count = span
        shapes = _ADDED if len(noise) == 1 else (_ALONE,)
        for lanes, steps in side_by_side(builder, count, *shapes):
            places = [builder.add(begin, step) for step in steps]
            below, beneath, lowest = (_below(builder, places, noise, each) for each in apart)
            sums = _sums(builder, lanes, [below], [table], number)
            here = [(place, each) for each in noise for place in places]
            every = zip(sums, beneath, lowest, here, strict=True)
            for shown, place, low, (above, threshold) in every:
                rest = less(builder, lanes, lanes.read(seen, place, WORD), shown)
                gain = lanes.read(gains, above, WORD)  # a number would be no word before the loop
                found = high_product(builder, lanes, builder.add(rest, lanes.all(half)), gain)
                found = builder.lshr(found, lanes.all(bits))
                bounds = lanes.read(floor, low, WORD), lanes.all(limit)
                found = within(builder, found, bounds)
                own = lanes.read(threshold, above, WORD) if ahead else None
                _write(builder, lanes, place, (found, rest), (made, left), ahead, own, bounds)
        return WHOLE(0)

    given = rows, ahead, noise, across, number, quotient, most, span, apart
    return kinds.intp(*given), generate


def _apart(builder: Any, given: Sequence[Any], values: Sequence[Any]) -> list[Any]:
    """Return arguments, those that are tuples as such."""
    return [
        cgutils.unpack_tuple(builder, each) if isinstance(kind, kinds.BaseTuple) else each
        for each, kind in zip(values, given, strict=True)
    ]


def _below(builder: Any, places: Sequence[Any], rows: Sequence[Any], apart: Any) -> list[Any]:
    """Return places in rows that lie so many words apart, row by row."""
    first = [builder.mul(WHOLE(n), apart) for n in range(len(rows))]
    return [builder.add(place, more) for more in first for place in places]


@intrinsic
def settle(
    _: Any,
    rows: Any,
    ahead: Any,
    noise: Any,
    across: Any,
    masks: Any,
    number: Any,
    most: Any,
    ends: Any,
    apart: Any,
) -> Any:
    """Write P = min(max((b - sum) / views, least), most), and what is left of b, sum taken away.

    The sum is that of rows that are masked. Rounded exactly, see `_quotients` of `words`: what
    views hardly see would grow from sweep to sweep otherwise, or fade. Words without a gain stay.
    Rows of one layer that as many views see go side by side: each alone waits for its sums.

    Args:
        rows: addresses of the first row: P, b, what is left of b, the least P, and halves, gains
            and powers, which are those of all.
        ahead: nothing, or what P is pushed on by, and then nothing is left of b: address of a row
            that gets P, and where P of one sweep ago was; and the share and more of `push`.
        noise: addresses of thresholds, as many as there are rows, or of none where nothing is
            pushed.
        across: where the addresses of rows are that are added up.
        masks: where those of rows of masks are.
        number: of those.
        most: the largest P.
        ends: of all rows, `WORDS` times a whole number: the words before one, and those from one on
            to one. Both go side by side as far as the shorter one.
        apart: words from one row to the next, of those that are added up, of P and b, and of the
            least P.
    """

    def generate(_: Any, builder: Any, __: Any, values: Sequence[Any]) -> Any:
        rows, ahead, noise, *tables, number, most, ends, apart = _apart(builder, given, values)
        made, seen, left, floor, *quotient = rows
        limit = builder.trunc(most, WORD)
        tables = [builder.inttoptr(each, WHOLE.as_pointer()) for each in tables]
        for lanes, places in _at_ends(builder, *ends):
            below, beneath, lowest = (_below(builder, places, noise, each) for each in apart)
            here = [(place, each) for each in noise for place in places]
            sums = _sums(builder, lanes, [below, [each for each, _ in here]], tables, number)
            every = zip(sums, beneath, lowest, here, strict=True)
            for shown, place, low, (above, threshold) in every:
                light, own = (lanes.read(row, place, WORD) for row in (seen, made))
                half, gain, power = (lanes.read(row, above, WORD) for row in quotient)
                rest = less(builder, lanes, light, shown)
                found = high_product(builder, lanes, builder.add(rest, half), gain)
                is_seen = builder.icmp_unsigned("!=", gain, lanes.constant(WORD, 0))
                kept = builder.add(own, lanes.constant(WORD, 1))  # as if multiplied once
                found = builder.select(is_seen, found, kept)
                found = high_product(builder, lanes, found, power)
                bounds = lanes.read(floor, low, WORD), lanes.all(limit)
                found = within(builder, found, bounds)
                own = lanes.read(threshold, above, WORD) if ahead else None
                _write(builder, lanes, place, (found, rest), (made, left), ahead, own, bounds)
        return WHOLE(0)

    given = rows, ahead, noise, across, masks, number, most, ends, apart
    return kinds.intp(*given), generate


def _at_ends(builder: Any, left: Any, right: Any, end: Any) -> Any:
    """Yield lanes and places, before one word and from one on, as far as both go in pairs."""
    more = builder.sub(end, right)
    both = builder.select(builder.icmp_signed("<", left, more), left, more)
    before = (both,), builder.sub(left, both)
    after = (builder.add(right, both),), builder.sub(more, both)
    for begins, count in (((WHOLE(0), right), both), before, after):
        for lanes, (place,) in side_by_side(builder, count, _ALONE):
            yield lanes, [builder.add(begin, place) for begin in begins]


def _write(
    builder: Any,
    lanes: Lanes,
    place: Any,
    found: tuple[Any, Any],
    rows: tuple[Any, Any],
    ahead: Sequence[Any],
    threshold: Any,
    bounds: tuple[Any, Any],
) -> None:
    """Write P and what is left of b; or P where it was one sweep ago, and P pushed on."""
    (now, rest), (made, left) = found, rows
    if ahead:
        ago, *both = ahead
        factor, more = (builder.trunc(each, WORD) for each in both)
        last = lanes.read(ago, place, WORD)
        lanes.write(now, ago, place)
        pushed = _pushed(builder, lanes, now, last, threshold, factor, more, bounds)
        lanes.write(pushed, made, place)
    else:
        lanes.write(rest, left, place)
        lanes.write(now, made, place)


@intrinsic
def push(_: Any, rows: Any, share: Any, more: Any, most: Any, count: Any) -> Any:
    """Write P <- min(max(P + share (P - last P), least), most), and last P <- P of before.

    What is added is rounded up as often as what lies beyond its whole part says: where it is above
    a threshold. Rounded to the nearest, the last 1 of a change would be pushed on forever.

    Args:
        rows: addresses of rows: P, P of one sweep ago, the least P, and thresholds, all words.
        share: in parts of 2^15.
        more: by which thresholds go up; beyond 2^16 they begin anew.
        most: the largest P, less than 2^14.
        count: of words, `WORDS` times a whole number.
    """

    def generate(_: Any, builder: Any, __: Any, values: Sequence[Any]) -> Any:
        rows, *numbers, count = values
        here, ago, floor, thresholds = cgutils.unpack_tuple(builder, rows)
        factor, shift, limit = (builder.trunc(each, WORD) for each in numbers)
        for lanes, (place,) in side_by_side(builder, count, _ALONE):
            now, before, low, threshold = (
                lanes.read(each, place, WORD) for each in (here, ago, floor, thresholds)
            )
            lanes.write(now, ago, place)
            bounds = low, lanes.all(limit)
            found = _pushed(builder, lanes, now, before, threshold, factor, shift, bounds)
            lanes.write(found, here, place)
        return WHOLE(0)

    return kinds.intp(rows, share, more, most, count), generate


def _pushed(
    builder: Any,
    lanes: Lanes,
    now: Any,
    before: Any,
    threshold: Any,
    factor: Any,
    shift: Any,
    bounds: tuple[Any, Any],
) -> Any:
    """Return words that are pushed on, see `push`."""
    least, most = bounds
    change = builder.shl(builder.sub(now, before), lanes.constant(WORD, 1))
    whole, beyond = _product(builder, lanes, change, lanes.all(factor))
    is_up = builder.icmp_unsigned(">", beyond, builder.add(threshold, lanes.all(shift)))
    found = builder.add(now, builder.add(whole, builder.zext(is_up, lanes.of(WORD))))
    found = builder.select(builder.icmp_signed(">", found, least), found, least)
    return builder.select(builder.icmp_signed("<", found, most), found, most)


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
            whole = builder.fptosi(builder.fadd(value, half, flags=FREE), lanes.of(INT))
            for row in cgutils.unpack_tuple(builder, rows):
                lanes.write(builder.trunc(whole, lanes.of(WORD)), row, place)
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
            whole = [builder.zext(lanes.read(row, place, WORD), lanes.of(INT)) for row in words]
            rest, own = (builder.sitofp(each, lanes.of(_FLOAT)) for each in whole)
            value = builder.fmul(rest, known, flags=FREE)
            value = builder.select(builder.fcmp_ordered(">", value, one), one, value)
            dark = builder.fmul(own, lanes.all(unit), flags=FREE)
            is_seen = builder.fcmp_ordered(">", known, zero)
            lanes.write(builder.select(is_seen, value, dark), made, place)
        return WHOLE(0)

    return kinds.intp(rows, gain, unit, count), generate


def _product(builder: Any, lanes: Lanes, one: Any, other: Any) -> tuple[Any, Any]:
    """Return the product of words with a sign over 2^16, rounded down, and what lies beyond."""
    wide = (builder.sext(each, lanes.of(INT)) for each in (one, other))
    whole = builder.ashr(builder.mul(*wide), lanes.constant(INT, BITS))
    return builder.trunc(whole, lanes.of(WORD)), builder.mul(one, other)
