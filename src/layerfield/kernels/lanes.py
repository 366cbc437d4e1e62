"""Fourier transforms of a few numbers, eight side by side: what compiled loops are put together of.

Vectors of eight are the values here, and every operation is one of the processor's, or two where
its vectors are shorter: a loop over eight numbers that may lie anywhere would remain one. Complex
numbers are two vectors, of real and of imaginary parts, one behind the other in memory: a lane
group. Numba is imported here; see `compiled`.
"""

import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial, reduce, wraps
from typing import Any

from llvmlite import ir
from numba.core import cgutils
from numba.core import types as kinds
from numba.extending import intrinsic

from layerfield.kernels.radices import LANES, RADICES

_GROUP = 2 * LANES  # numbers of a lane group, and of a line of the cache
_FLOAT, _INT = ir.FloatType(), ir.IntType(32)
_VECTOR, _PAIRS = ir.VectorType(_FLOAT, LANES), ir.VectorType(_FLOAT, _GROUP)
FREE = ("contract", "reassoc", "nsz", "arcp", "nnan", "ninf")  # as `compiled` has it
_EVEN, _ODD = [*range(0, _GROUP, 2)], [*range(1, _GROUP, 2)]
_BY_TURNS = [place // 2 + LANES * (place % 2) for place in range(_GROUP)]


class _Lanes:
    """A vector with the arithmetic of numbers."""

    def __init__(self, builder: Any, value: Any) -> None:
        self.builder, self.value = builder, value

    def __add__(self, other: "_Lanes") -> "_Lanes":
        return self._made("fadd", other)

    def __sub__(self, other: "_Lanes") -> "_Lanes":
        return self._made("fsub", other)

    def __mul__(self, other: "_Lanes | float") -> "_Lanes":
        if not isinstance(other, _Lanes):
            other = _Lanes(self.builder, ir.Constant(_VECTOR, [other] * LANES))
        return self._made("fmul", other)

    def _made(self, name: str, other: "_Lanes") -> "_Lanes":
        made = getattr(self.builder, name)(self.value, other.value, flags=FREE)
        return _Lanes(self.builder, made)


@dataclass(frozen=True)
class _Complex:
    """Eight complex numbers."""

    real: _Lanes
    imaginary: _Lanes

    def __add__(self, other: "_Complex") -> "_Complex":
        return _Complex(self.real + other.real, self.imaginary + other.imaginary)

    def __sub__(self, other: "_Complex") -> "_Complex":
        return _Complex(self.real - other.real, self.imaginary - other.imaginary)

    def times(self, factor: float) -> "_Complex":
        return _Complex(self.real * factor, self.imaginary * factor)

    def turned(self, cos: _Lanes | float, sin: _Lanes | float) -> "_Complex":
        """Return the product with cos - i sin."""
        real, imaginary = self.real, self.imaginary
        return _Complex(real * cos + imaginary * sin, imaginary * cos - real * sin)

    def turned_by(self, part: int, whole: int) -> "_Complex":
        """Return the product with exp(-2 pi i part / whole), 0 < part < whole / 2."""
        real, imaginary = self.real, self.imaginary
        if 4 * part == whole:
            return _Complex(imaginary, _negative(real))
        if 8 * part == whole:
            return _Complex(real + imaginary, imaginary - real).times(math.sqrt(0.5))
        if 8 * part == 3 * whole:
            return _Complex(imaginary - real, _negative(real + imaginary)).times(math.sqrt(0.5))
        angle = 2 * math.pi * part / whole
        return self.turned(math.cos(angle), math.sin(angle))


def _negative(lanes: _Lanes) -> _Lanes:
    return _Lanes(lanes.builder, lanes.builder.fneg(lanes.value))


def _transformed(x: Sequence[_Complex]) -> list[_Complex]:
    """Return y_k = sum_j x_j exp(-2 pi i j k / n)."""
    count = len(x)
    if count == 1:
        return [*x]
    if count % 2 == 0:
        even, odd = _transformed(x[::2]), _transformed(x[1::2])
        odd = [odd[0], *(odd[k].turned_by(k, count) for k in range(1, count // 2))]
        both = [*zip(even, odd, strict=True)]
        return [*(e + o for e, o in both), *(e - o for e, o in both)]
    # x_j and x_(n - j) meet the same cosine, and sines of opposite sign.
    pairs = range(1, count // 2 + 1)
    sums = [x[j] + x[count - j] for j in pairs]
    differences = [x[j] - x[count - j] for j in pairs]
    y = [_sum([x[0], *sums])] * count
    for k in pairs:
        angles = [2 * math.pi * (j * k % count) / count for j in pairs]
        parts = [*zip(sums, differences, angles, strict=True)]
        a = _sum([x[0], *(each.times(math.cos(angle)) for each, _, angle in parts)])
        b = _sum([each.times(math.sin(angle)) for _, each, angle in parts])
        y[k] = _Complex(a.real + b.imaginary, a.imaginary - b.real)
        y[count - k] = _Complex(a.real - b.imaginary, a.imaginary + b.real)
    return y


def _sum(terms: Sequence[_Complex]) -> _Complex:
    return reduce(operator.add, terms)


class Memory:
    """An array of single precision, as vectors are read from it and put into it."""

    def __init__(self, context: Any, builder: Any, kind: Any, array: Any) -> None:
        self.builder = builder
        self._data = context.make_array(kind)(context, builder, array).data

    def read(self, place: Any, kind: ir.Type = _VECTOR) -> Any:
        return self.builder.load(self._at(place, kind), align=4)

    def write(self, value: Any, place: Any) -> None:
        self.builder.store(value, self._at(place, value.type), align=4)

    def write_past_cache(self, value: Any, place: Any) -> None:
        """Write whole lines, aligned: what they held before is not fetched."""
        stored = self.builder.store(value, self._at(place, value.type), align=4 * _GROUP)
        once = self.builder.module.add_metadata([_INT(1)])
        stored.set_metadata("nontemporal", once)

    def _at(self, place: Any, kind: ir.Type) -> Any:
        return self.builder.bitcast(self.builder.gep(self._data, [place]), kind.as_pointer())


def generated(function: Callable[..., None]) -> Any:
    """Turn a function of a builder, arrays and whole numbers into one that compiled ones call."""

    @wraps(function)  # Numba asks for the names of what it takes; the first is its own context
    def typed(*arguments: Any) -> Any:
        given = arguments[1:]

        def generate(context: Any, builder: Any, _: Any, values: Sequence[Any]) -> Any:
            function(builder, *map(partial(_known, context, builder), given, values))
            return context.get_dummy_value()

        return kinds.void(*given), generate

    return typed


def _known(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    """Return an array as vectors are read from it, of a tuple its length, and numbers."""
    if isinstance(kind, kinds.Array):
        return Memory(context, builder, kind, value)
    return len(kind) if isinstance(kind, kinds.BaseTuple) else value


@intrinsic
@generated
def butterflies(  # noqa: PLR0913, PLR0917 - whole numbers that compiled loops pass one by one
    builder: Any,
    radix: Any,
    seen: Memory,
    begin: Any,
    step: Any,
    made: Memory,
    place: Any,
    stride: Any,
    count: Any,
    turns: Memory,
    turn: Any,
) -> None:
    """Transform `radix` lane groups, and the groups behind each of them, `count` in all.

    Args:
        builder: of what is compiled.
        radix: one of `RADICES`; nothing is done for others.
        seen: where the groups are.
        begin: where the first of them is.
        step: from one to the next.
        made: where results are put.
        place: of the first of them.
        stride: from one to the next.
        count: how often.
        turns: cos and sin of 2 pi t / n, one beside the other, t = 0 .. n - 1.
        turn: t of result 1; result k is turned k times as far.
    """
    whole = radix.type
    done = builder.append_basic_block()
    chosen = builder.switch(radix, done)
    for number in RADICES:
        block = builder.append_basic_block()
        chosen.add_case(whole(number), block)
        builder.position_at_end(block)
        angles = [_turn(builder, turns, builder.mul(turn, whole(k))) for k in range(1, number)]
        with cgutils.for_range(builder, count) as loop:
            beside = builder.mul(loop.index, whole(_GROUP))
            x, at = list[_Complex](), builder.add(begin, beside)
            for _ in range(number):
                parts = (seen.read(at), seen.read(builder.add(at, whole(LANES))))
                x.append(_Complex(*(_Lanes(builder, part) for part in parts)))
                at = builder.add(at, step)
            at = builder.add(place, beside)
            for k, y in enumerate(_transformed(x)):
                turned = y.turned(*angles[k - 1]) if k > 0 else y
                made.write(turned.real.value, at)
                made.write(turned.imaginary.value, builder.add(at, whole(LANES)))
                at = builder.add(at, stride)
        builder.branch(done)
    builder.position_at_end(done)


@intrinsic
@generated
def take_rows(
    builder: Any, seen: Memory, begin: Any, pitch: Any, made: Memory, place: Any, swapped: Any
) -> None:
    """Put eight complex numbers of eight rows into eight lane groups.

    Args:
        builder: of what is compiled.
        seen: the rows.
        begin: where the first of the numbers is.
        pitch: from row to row.
        made: where the groups are.
        place: of the first.
        swapped: whether real and imaginary parts change places.
    """
    parts: tuple[list[Any], list[Any]] = ([], [])
    for _ in range(LANES):
        row = seen.read(begin, _PAIRS)
        for part, mask in zip(parts, (_EVEN, _ODD), strict=True):
            part.append(_shuffled(builder, row, row, mask))
        begin = builder.add(begin, pitch)
    for part, offset in zip(parts, _offsets(builder, swapped), strict=True):
        at = builder.add(place, offset)
        for column in _transposed(builder, part):
            made.write(column, at)
            at = builder.add(at, at.type(_GROUP))


@intrinsic
@generated
def put_rows(
    builder: Any,
    seen: Memory,
    begin: Any,
    made: Memory,
    place: Any,
    pitch: Any,
    swapped: Any,
    as_groups: Any,
) -> None:
    """Put eight lane groups into eight rows: of complex numbers, or of a lane group each.

    Args:
        builder: of what is compiled.
        seen: the groups.
        begin: where the first is.
        made: the rows.
        place: where the first of the numbers comes.
        pitch: from row to row.
        swapped: whether real and imaginary parts change places.
        as_groups: whether those parts stay apart.
    """
    rows = _rows(builder, seen, begin, _offsets(builder, swapped))
    with builder.if_else(builder.trunc(as_groups, ir.IntType(1))) as (groups, numbers):
        for way, mask in ((groups, [*range(_GROUP)]), (numbers, _BY_TURNS)):
            with way:
                at = place
                for real, imaginary in rows:
                    made.write(_shuffled(builder, real, imaginary, mask), at)
                    at = builder.add(at, pitch)


@intrinsic
@generated
def put_group(
    builder: Any, seen: Memory, begin: Any, made: Memory, place: Any, swapped: Any
) -> None:
    """Put a lane group somewhere as complex numbers; arguments as of `put_rows`."""
    offsets = _offsets(builder, swapped)
    real, imaginary = (seen.read(builder.add(begin, offset)) for offset in offsets)
    made.write(_shuffled(builder, real, imaginary, _BY_TURNS), place)


def _turn(builder: Any, turns: Memory, number: Any) -> tuple[_Lanes, _Lanes]:
    """Return cos and sin of one angle, for all lanes."""
    place, found = builder.mul(number, number.type(2)), list[_Lanes]()
    for part in range(2):
        value = turns.read(builder.add(place, place.type(part)), _FLOAT)
        found.append(_Lanes(builder, everywhere(builder, value)))
    return found[0], found[1]


def everywhere(builder: Any, number: Any, lanes: int = LANES) -> Any:
    """Return a number in all lanes."""
    kind = ir.VectorType(number.type, lanes)
    one = builder.insert_element(ir.Constant(kind, ir.Undefined), number, _INT(0))
    return _shuffled(builder, one, one, [0] * lanes)


def _rows(builder: Any, seen: Memory, begin: Any, offsets: Sequence[Any]) -> list[tuple[Any, Any]]:
    """Return eight lane groups, one behind the other, by row: parts that are at these offsets."""
    parts = list[list[Any]]()
    for offset in offsets:
        at = builder.add(begin, offset)
        places = (builder.add(at, at.type(_GROUP * n)) for n in range(LANES))
        parts.append(_transposed(builder, [seen.read(place) for place in places]))
    return [*zip(*parts, strict=True)]


def _offsets(builder: Any, swapped: Any) -> tuple[Any, Any]:
    """Return where real and imaginary parts are in a lane group."""
    whole = ir.IntType(64)
    far = builder.select(builder.trunc(swapped, ir.IntType(1)), whole(LANES), whole(0))
    return far, builder.sub(whole(LANES), far)


def _shuffled(builder: Any, one: Any, other: Any, mask: Sequence[int]) -> Any:
    return builder.shuffle_vector(one, other, ir.Constant(ir.VectorType(_INT, len(mask)), [*mask]))


def _transposed(builder: Any, rows: Sequence[Any]) -> list[Any]:
    """Exchange blocks beside the diagonal: single numbers, pairs, fours."""
    made, size, lanes = [*rows], 1, range(LANES)
    while size < LANES:
        upper = [lane if lane & size == 0 else LANES + lane - size for lane in lanes]
        lower = [lane + size if lane & size == 0 else LANES + lane for lane in lanes]
        for row in lanes:
            if row & size == 0:
                both = made[row], made[row + size]
                made[row], made[row + size] = (
                    _shuffled(builder, *both, mask) for mask in (upper, lower)
                )
        size *= 2
    return made


@intrinsic
@generated
def take_groups(
    builder: Any, seen: Memory, begin: Any, pitch: Any, made: Memory, place: Any
) -> None:
    """Put a lane group of each of eight rows into eight lane groups; see `take_rows`."""
    rows = [builder.add(begin, builder.mul(pitch, pitch.type(row))) for row in range(LANES)]
    for offset in (0, LANES):
        parts = [seen.read(builder.add(row, row.type(offset))) for row in rows]
        for number, column in enumerate(_transposed(builder, parts)):
            made.write(column, builder.add(place, place.type(_GROUP * number + offset)))


@intrinsic
@generated
def put_groups(builder: Any, seen: Memory, begin: Any, made: Memory, place: Any) -> None:
    """Put eight lane groups, one behind the other, turned as `take_groups` does, past the cache."""
    offsets = begin.type(0), begin.type(LANES)
    for number, (real, imaginary) in enumerate(_rows(builder, seen, begin, offsets)):
        value = _shuffled(builder, real, imaginary, [*range(_GROUP)])
        made.write_past_cache(value, builder.add(place, place.type(_GROUP * number)))


@intrinsic
@generated
def put_past_cache(builder: Any, seen: Memory, made: Memory, count: Any) -> None:
    """Copy so many numbers from the first on, whole lines of them."""
    whole = count.type
    span = whole(0), count, whole(_GROUP), whole
    with cgutils.for_range_slice(builder, *span) as (at, _):
        made.write_past_cache(seen.read(at, _PAIRS), at)


@intrinsic
@generated
def settle(builder: Any) -> None:
    """Have what passed by the cache arrive before what other threads are told afterwards."""
    builder.fence("seq_cst")


@intrinsic
@generated
def swap_group(builder: Any, seen: Memory, begin: Any, made: Memory, place: Any) -> None:
    """Put a lane group somewhere else, with imaginary and real parts in each other's place."""
    far = begin.type(LANES)
    real, imaginary = seen.read(begin), seen.read(builder.add(begin, far))
    made.write(imaginary, place)
    made.write(real, builder.add(place, far))


@intrinsic
@generated
def take_lanes(
    builder: Any, seen: Memory, begin: Any, factor: Any, made: Memory, place: Any
) -> None:
    """Copy eight numbers, multiplied."""
    lanes = _Lanes(builder, seen.read(begin)) * _Lanes(builder, everywhere(builder, factor))
    made.write(lanes.value, place)


@intrinsic
@generated
def multiply_groups(
    builder: Any,
    each: int,
    matrix: Memory,
    entry: Any,
    step: Any,
    seen: Memory,
    group: Any,
    stride: Any,
) -> None:
    """Multiply lane groups, one of every layer, by symmetric matrices, in place.

    Imaginary parts come first afterwards.

    Args:
        builder: of what is compiled.
        each: a tuple with something for every layer.
        matrix: of entries [k, m], k <= m, eight real numbers.
        entry: where those of the first are.
        step: from one to the next.
        seen: lane groups.
        group: where the first is.
        stride: from one to the next.
    """
    groups = [builder.add(group, builder.mul(stride, stride.type(layer))) for layer in range(each)]
    given, known = [_read_complex(builder, seen, place) for place in groups], dict[int, _Lanes]()
    for k, place in enumerate(groups):
        products = list[_Complex]()
        for m, x in enumerate(given):
            number = min(k, m) * each + max(k, m)
            if number not in known:
                there = builder.add(entry, builder.mul(step, step.type(number)))
                known[number] = _Lanes(builder, matrix.read(there))
            products.append(_Complex(x.real * known[number], x.imaginary * known[number]))
        total = _sum(products)
        _write_complex(builder, seen, place, _Complex(total.imaginary, total.real))


@intrinsic
@generated
def pairs_to_spectrum(
    builder: Any, values: Memory, near: Any, far: Any, other: Any, turns: Memory, x: Any
) -> None:
    """Find X(x) and X(W/2 - x) of Z at both frequencies; see `spectra`.

    Args:
        builder: of what is compiled.
        values: lane groups.
        near: where Z(x) is, and X(x) will be.
        far: where Z(-x) is.
        other: where X(W/2 - x) will be.
        turns: cos and sin of 2 pi t / W.
        x: the frequency.
    """
    z, y = _read_complex(builder, values, near), _read_complex(builder, values, far)
    even = _Complex(z.real + y.real, z.imaginary - y.imaginary).times(0.5)
    odd = _Complex(z.imaginary + y.imaginary, y.real - z.real).times(0.5)
    odd = odd.turned(*_turn(builder, turns, x))
    _write_complex(builder, values, near, even + odd)
    found = even - odd
    _write_complex(builder, values, other, _Complex(found.real, _negative(found.imaginary)))


@intrinsic
@generated
def spectrum_to_pairs(
    builder: Any, values: Memory, near: Any, far: Any, turns: Memory, x: Any
) -> None:
    """Find Z(x) and Z(W/2 - x) of X at both, imaginary parts first; see `pairs_to_spectrum`."""
    one, other = _read_complex(builder, values, near), _read_complex(builder, values, far)
    even = _Complex(one.real + other.real, one.imaginary - other.imaginary).times(0.5)
    odd = _Complex(one.real - other.real, one.imaginary + other.imaginary).times(0.5)
    cos, sin = _turn(builder, turns, x)
    real, imaginary = (
        odd.real * cos - odd.imaginary * sin,
        odd.imaginary * cos + odd.real * sin,
    )
    z = _Complex(even.imaginary + real, even.real - imaginary)
    _write_complex(builder, values, near, z)
    z = _Complex(real - even.imaginary, even.real + imaginary)
    _write_complex(builder, values, far, z)


def _read_complex(builder: Any, values: Memory, place: Any) -> _Complex:
    parts = (values.read(place), values.read(builder.add(place, place.type(LANES))))
    return _Complex(*(_Lanes(builder, part) for part in parts))


def _write_complex(builder: Any, values: Memory, place: Any, found: _Complex) -> None:
    values.write(found.real.value, place)
    values.write(found.imaginary.value, builder.add(place, place.type(LANES)))
