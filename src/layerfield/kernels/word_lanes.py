"""Sums of rows of 16-bit words, and pixels settled by them: what `word_sweeps` is made of.

Twice as many words as floats go side by side, and half the memory is moved. Rows are as long as
`LANES` go into, so nothing is left over at their ends. Numba is imported here; see `compiled`.
"""

from collections.abc import Iterator, Sequence
from typing import Any

from llvmlite import ir
from numba.core import cgutils
from numba.core import types as kinds
from numba.extending import intrinsic

from layerfield.kernels.lanes import FREE
from layerfield.kernels.words import WORDS

_WORD, _INT, _FLOAT = ir.IntType(16), ir.IntType(32), ir.FloatType()
_WHOLE = ir.IntType(64)
_WORDS, _INTS, _FLOATS = (ir.VectorType(kind, WORDS) for kind in (_WORD, _INT, _FLOAT))
_POINT = 14  # binary places of a product that are dropped, and one that is rounded


@intrinsic
def add_up(_: Any, made: Any, rows: Any, number: Any, count: Any) -> Any:
    """Write made[x] = sum_n rows[n][x].

    Args:
        made: address of a row, apart from those that are added.
        rows: where the addresses of rows are.
        number: of rows, one at the least.
        count: of words, `WORDS` times a whole number.
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
        count: of words, `WORDS` times a whole number.
    """
    return _adding(made, rows, masks, number, count, is_masked=True)


def _adding(*given: Any, is_masked: bool) -> Any:
    """Return the kinds of a sum of rows, and what generates it."""

    def generate(_: Any, builder: Any, __: Any, values: Sequence[Any]) -> Any:
        made, *tables, number, count = values
        tables = [builder.inttoptr(each, _WHOLE.as_pointer()) for each in tables]
        for places in _side_by_side(builder, count):
            sums = [cgutils.alloca_once(builder, _WORDS) for _ in places]
            for each in sums:
                builder.store(ir.Constant(_WORDS, None), each)
            with cgutils.for_range(builder, number) as row:
                rows = [builder.load(builder.gep(each, [row.index])) for each in tables]
                for each, place in zip(sums, places, strict=True):
                    words = _read(builder, rows[0], place, _WORDS)
                    if is_masked:
                        words = builder.and_(words, _read(builder, rows[1], place, _WORDS))
                    builder.store(builder.add(builder.load(each), words), each)
            for each, place in zip(sums, places, strict=True):
                _write(builder, builder.load(each), made, place)
        return _WHOLE(0)

    return kinds.intp(*given), generate


@intrinsic
def settle(_: Any, rows: Any, most: Any, count: Any) -> Any:
    """Write P = min(g max(b - sum, 0), most), and what is left of b where the sum was.

    Words without a gain stay.

    Args:
        rows: addresses of rows: P, b, the sum, and gains in parts of 2^15.
        most: the largest P.
        count: of words, `WORDS` times a whole number.
    """

    def generate(_: Any, builder: Any, __: Any, values: Sequence[Any]) -> Any:
        rows, most, count = values
        made, seen, total, gains = cgutils.unpack_tuple(builder, rows)
        limit = _all(builder, builder.trunc(most, _WORD), _WORDS)
        for (place,) in _side_by_side(builder, count, 1):
            light, shown = (_read(builder, each, place, _WORDS) for each in (seen, total))
            more = builder.icmp_unsigned(">", light, shown)
            rest = builder.select(more, builder.sub(light, shown), _constant(_WORDS, 0))
            _write(builder, rest, total, place)
            gain = _read(builder, gains, place, _WORDS)
            found = _rounded_product(builder, rest, gain)
            found = builder.select(builder.icmp_unsigned("<", found, limit), found, limit)
            is_seen = builder.icmp_unsigned("!=", gain, _constant(_WORDS, 0))
            own = _read(builder, made, place, _WORDS)
            _write(builder, builder.select(is_seen, found, own), made, place)
        return _WHOLE(0)

    return kinds.intp(rows, most, count), generate


@intrinsic
def push(_: Any, rows: Any, share: Any, most: Any, count: Any) -> Any:
    """Write P <- min(max(P + share (P - last P), 0), most), and last P <- P of before.

    Args:
        rows: addresses of rows: P, and P of one sweep ago.
        share: in parts of 2^15.
        most: the largest P, less than 2^15.
        count: of words, `WORDS` times a whole number.
    """

    def generate(_: Any, builder: Any, __: Any, values: Sequence[Any]) -> Any:
        rows, share, most, count = values
        here, ago = cgutils.unpack_tuple(builder, rows)
        limit, factor = (
            _all(builder, builder.trunc(each, _WORD), _WORDS) for each in (most, share)
        )
        zero = _constant(_WORDS, 0)
        for (place,) in _side_by_side(builder, count, 1):
            now, before = (_read(builder, each, place, _WORDS) for each in (here, ago))
            _write(builder, now, ago, place)
            change = _rounded_product(builder, builder.sub(now, before), factor)
            found = builder.add(now, change)
            found = builder.select(builder.icmp_signed(">", found, zero), found, zero)
            found = builder.select(builder.icmp_signed("<", found, limit), found, limit)
            _write(builder, found, here, place)
        return _WHOLE(0)

    return kinds.intp(rows, share, most, count), generate


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
        zero, half = _FLOAT(0), _FLOAT(0.5)
        for lanes, place in _one_by_one(builder, count):
            floats, words = (_kind(kind, lanes) for kind in (_FLOAT, _WORD))
            low, high, middle, share = (
                _all(builder, each, floats) for each in (zero, most, half, factor)
            )
            value = builder.fmul(_read(builder, source, place, floats), share, flags=FREE)
            value = builder.select(builder.fcmp_ordered("<", value, low), low, value)
            value = builder.select(builder.fcmp_ordered(">", value, high), high, value)
            whole = builder.fptosi(builder.fadd(value, middle, flags=FREE), _kind(_INT, lanes))
            for row in cgutils.unpack_tuple(builder, rows):
                _write(builder, builder.trunc(whole, words), row, place)
        return _WHOLE(0)

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
        for lanes, place in _one_by_one(builder, count):
            floats = _kind(_FLOAT, lanes)
            one, zero, share, dark = (
                _all(builder, each, floats) for each in (_FLOAT(1), _FLOAT(0), gain, unit)
            )
            known = builder.fmul(_read(builder, gains, place, floats), share, flags=FREE)
            rest, own = (
                builder.sitofp(
                    builder.zext(
                        _read(builder, row, place, _kind(_WORD, lanes)), _kind(_INT, lanes)
                    ),
                    floats,
                )
                for row in words
            )
            value = builder.fmul(rest, known, flags=FREE)
            value = builder.select(builder.fcmp_ordered(">", value, one), one, value)
            is_seen = builder.fcmp_ordered(">", known, zero)
            own = builder.fmul(own, dark, flags=FREE)
            _write(builder, builder.select(is_seen, value, own), made, place)
        return _WHOLE(0)

    return kinds.intp(rows, gain, unit, count), generate


def _rounded_product(builder: Any, one: Any, other: Any) -> Any:
    """Return the product of words with a sign over 2^15; processors have an instruction for it."""
    product = builder.mul(builder.sext(one, _INTS), builder.sext(other, _INTS))
    halves = builder.add(builder.ashr(product, _constant(_INTS, _POINT)), _constant(_INTS, 1))
    return builder.trunc(builder.ashr(halves, _constant(_INTS, 1)), _WORDS)


def _side_by_side(builder: Any, count: Any, vectors: int = 4) -> Iterator[list[Any]]:
    """Yield the places of vectors of words, inside loops over a row."""
    begin = _WHOLE(0)
    for many in sorted({vectors, 1}, reverse=True):
        length = many * WORDS
        end = builder.and_(count, _WHOLE(-length))
        with cgutils.for_range_slice(builder, begin, end, _WHOLE(length), _WHOLE) as (at, _):
            yield [builder.add(at, _WHOLE(WORDS * n)) for n in range(many)]
        begin = end


def _one_by_one(builder: Any, count: Any) -> Iterator[tuple[int, Any]]:
    """Yield lanes and the place of the first, inside loops over a row of any length."""
    begin = _WHOLE(0)
    for lanes in (WORDS, 1):
        end = builder.and_(count, _WHOLE(-lanes))
        with cgutils.for_range_slice(builder, begin, end, _WHOLE(lanes), _WHOLE) as (at, _):
            yield lanes, at
        begin = end


def _kind(kind: ir.Type, lanes: int) -> ir.Type:
    return kind if lanes == 1 else ir.VectorType(kind, lanes)


def _constant(kind: ir.VectorType, number: int) -> Any:
    return ir.Constant(kind, [number] * WORDS)


def _all(builder: Any, number: Any, kind: ir.Type) -> Any:
    """Return a number in all lanes, if there are several."""
    if not isinstance(kind, ir.VectorType):
        return number
    one = builder.insert_element(ir.Constant(kind, ir.Undefined), number, _INT(0))
    return builder.shuffle_vector(one, one, ir.Constant(ir.VectorType(_INT, kind.count), None))


def _read(builder: Any, row: Any, place: Any, kind: ir.Type) -> Any:
    return builder.load(_at(builder, row, place, kind), align=2)


def _write(builder: Any, value: Any, row: Any, place: Any) -> None:
    builder.store(value, _at(builder, row, place, value.type), align=2)


def _at(builder: Any, row: Any, place: Any, kind: ir.Type) -> Any:
    one = kind.element if isinstance(kind, ir.VectorType) else kind
    first = builder.inttoptr(row, one.as_pointer())
    return builder.bitcast(builder.gep(first, [place]), kind.as_pointer())
