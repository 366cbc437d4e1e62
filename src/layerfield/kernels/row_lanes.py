"""Eight rows of pixels side by side, each a system of its own: sums stay in registers.

The unknowns of a row are the pixels of all layers, column by column. All rows have one matrix H,
symmetric, whose entries reach `reach` unknowns to either side. Lanes are eight numbers for every
unknown, one of each row; x begins and ends with `reach` more lanes, of zeros. Numba is imported
here; see `compiled`.
"""

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import cgutils
from numba.extending import intrinsic

from layerfield.kernels.lanes import FREE, Memory, everywhere, generated
from layerfield.kernels.radices import LANES
from layerfield.kernels.row_steps import CHUNK, TAPS

_FLOAT, _WHOLE = ir.FloatType(), ir.IntType(64)
_VECTOR = ir.VectorType(_FLOAT, LANES)
_ZERO, _ONE = ir.Constant(_VECTOR, None), ir.Constant(_VECTOR, [1.0] * LANES)
_LEAST = ir.Constant(_VECTOR, [1e-12] * LANES)  # curvature: below it there is none


@intrinsic
@generated
def find_fall(
    builder: Any,
    offsets: Memory,
    entries: Memory,
    taps: Any,
    x: Memory,
    data: Memory,
    fall: Memory,
    unknown: Any,
) -> None:
    """Find g_i = b_i - (H x)_i.

    Args:
        builder: of what is compiled.
        offsets: for every unknown, of what it knows: from `reach` before it on.
        entries: of H, beside their offsets.
        taps: how many there are for each, a multiple of `TAPS`.
        x: lanes.
        data: b.
        fall: g.
        unknown: i.
    """
    found = _fall(builder, (offsets, entries, taps), x, data, unknown)
    _put(fall, builder, unknown, found)


@intrinsic
@generated
def relax(
    builder: Any,
    offsets: Memory,
    entries: Memory,
    taps: Any,
    x: Memory,
    data: Memory,
    inverses: Memory,
    bounds: Memory,
    unknown: Any,
    reach: Any,
) -> None:
    """Have an unknown take its best place between bounds while all others stay.

        x_i <- clamp(x_i + (b_i - (H x)_i) / H_ii)

    Args:
        builder: of what is compiled.
        offsets: see `find_fall`.
        entries: the same.
        taps: the same.
        x: lanes.
        data: b.
        inverses: 1 / H_ii, a number for every unknown.
        bounds: lower and upper.
        unknown: i.
        reach: of H.
    """
    found = _fall(builder, (offsets, entries, taps), x, data, unknown)
    share = everywhere(builder, inverses.read(unknown, _FLOAT))
    place = builder.add(unknown, reach)
    moved = _plus(builder, _get(x, builder, place), share, found)
    _put(x, builder, place, _clamped(builder, moved, bounds))


@intrinsic
@generated
def eliminate(
    builder: Any,
    matrix: Memory,
    pitch: Any,
    left: Memory,
    place: Any,
    factor: Memory,
    moves: Memory,
    unknown: Any,
    reach: Any,
) -> None:
    """Take unknowns before this one out of its equation.

        S_id = H_id + sum_e T_(i-e)e S_(i-e)(d+e),   p_i <- p_i - sum_e S_(i-e)e p_(i-e)

    S_id is what is left of H between i and i + d, T = -S_id / (S_i0 + rho), or 0 where an unknown
    does not move: see `settle`.

    Args:
        builder: of what is compiled.
        matrix: H_id, for every unknown `pitch` numbers, zeros beyond the reach.
        pitch: reach + `CHUNK`.
        left: S, for every unknown `pitch` lanes, zeros beyond the reach.
        place: of this unknown in it.
        factor: T, for every unknown `reach` lanes.
        moves: p.
        unknown: i.
        reach: of H.
    """
    row = builder.mul(unknown, pitch)

    def entry(n: Any) -> Any:
        return everywhere(builder, matrix.read(builder.add(row, n), _FLOAT))

    _eliminate(builder, entry, pitch, left, place, factor, moves, unknown, reach)


@intrinsic
@generated
def eliminate_from(
    builder: Any,
    pitch: Any,
    left: Memory,
    place: Any,
    factor: Memory,
    moves: Memory,
    unknown: Any,
    reach: Any,
) -> None:
    """Do the same where every row has a matrix of its own: H_id is in S before.

    Args:
        builder: of what is compiled.
        pitch: see `eliminate`.
        left: S.
        place: the same.
        factor: T.
        moves: p.
        unknown: i.
        reach: of H.
    """
    here = builder.mul(place, pitch)

    def entry(n: Any) -> Any:
        return _get(left, builder, builder.add(here, n))

    _eliminate(builder, entry, pitch, left, place, factor, moves, unknown, reach)


@intrinsic
@generated
def settle(  # noqa: PLR0913, PLR0917
    builder: Any,
    left: Memory,
    pitch: Any,
    place: Any,
    factor: Memory,
    moves: Memory,
    x: Memory,
    fall: Memory,
    prox: Memory,
    share: Memory,
    bounds: Memory,
    unknown: Any,
    reach: Any,
) -> None:
    """Find out which unknowns go to a bound and stay there, and take the step of the others.

    Those go there whose own step, x_i + share g_i, would lead past it. With p_i as `eliminate`
    left it and q = 1 / (S_i0 + rho):

        p_i <- bound - x_i,  T_id = 0        or        p_i <- q p_i,  T_id = -q S_id

    Args:
        builder: of what is compiled.
        left: see `eliminate`.
        pitch: the same.
        place: the same.
        factor: T.
        moves: p.
        x: lanes.
        fall: g.
        prox: rho, a number for every row.
        share: a number for every row.
        bounds: lower and upper.
        unknown: i.
        reach: of H.
    """
    here = _get(x, builder, builder.add(unknown, reach))
    tried = _plus(builder, here, share.read(reach.type(0)), _get(fall, builder, unknown))
    low, high = _limits(builder, bounds)
    goes_low = builder.fcmp_ordered("<=", tried, low)
    stays = builder.or_(goes_low, builder.fcmp_ordered(">=", tried, high))
    rest = builder.mul(place, pitch)
    own = builder.fadd(_get(left, builder, rest), prox.read(reach.type(0)), flags=FREE)
    inverse = builder.fdiv(_ONE, own, flags=FREE)
    step = builder.fmul(_get(moves, builder, unknown), inverse, flags=FREE)
    bound = builder.fsub(builder.select(goes_low, low, high), here, flags=FREE)
    _put(moves, builder, unknown, builder.select(stays, bound, step))
    factors = builder.select(stays, _ZERO, builder.fneg(inverse))
    row = builder.mul(unknown, reach)
    with cgutils.for_range(builder, reach) as loop:
        at = builder.add(rest, builder.add(loop.index, reach.type(1)))
        value = builder.fmul(factors, _get(left, builder, at), flags=FREE)
        _put(factor, builder, builder.add(row, loop.index), value)


@intrinsic
@generated
def substitute(
    builder: Any,
    factor: Memory,
    moves: Memory,
    x: Memory,
    bounds: Memory,
    unknown: Any,
    reach: Any,
    far: Any,
) -> None:
    """Take the unknowns behind this one into its step, and the step, between bounds.

        p_i <- p_i + sum_d T_id p_(i+d),   x_i <- clamp(x_i + p_i)

    Args:
        builder: of what is compiled.
        factor: T.
        moves: p.
        x: lanes.
        bounds: lower and upper.
        unknown: i.
        reach: of H.
        far: the largest d.
    """
    move = cgutils.alloca_once_value(builder, _get(moves, builder, unknown))
    before = builder.sub(builder.mul(unknown, reach), reach.type(1))
    with cgutils.for_range(builder, far) as loop:
        d = builder.sub(far, loop.index)
        value = _get(factor, builder, builder.add(before, d))
        _add(builder, move, value, _get(moves, builder, builder.add(unknown, d)))
    found = builder.load(move)
    _put(moves, builder, unknown, found)
    place = builder.add(unknown, reach)
    moved = builder.fadd(_get(x, builder, place), found, flags=FREE)
    _put(x, builder, place, _clamped(builder, moved, bounds))


@intrinsic
@generated
def relax_product(  # noqa: PLR0913, PLR0917
    builder: Any,
    lights: Memory,
    weights: Memory,
    others: Memory,
    count: Any,
    begin: Any,
    end: Any,
    x: Memory,
    light: Memory,
    bounds: Memory,
    place: Any,
) -> None:
    """Have a factor of products take its best place between bounds while all others stay.

        x_i <- clamp(sum w o L / sum w o^2)

    over the paths through it, o what all others on a path let through. It stays where they are
    dark.

    Args:
        builder: of what is compiled.
        lights: of every path the number of its view pixel.
        weights: w.
        others: of every path the places of its other factors in x.
        count: how many those are.
        begin: number of its first path.
        end: that behind its last.
        x: lanes.
        light: L.
        bounds: lower and upper.
        place: of the unknown in x.
    """
    seen, known = (cgutils.alloca_once_value(builder, _ZERO) for _ in range(2))
    with cgutils.for_range(builder, end, begin) as loop:
        path = loop.index
        share = everywhere(builder, weights.read(path, _FLOAT))
        other = _met(builder, others, count, path, x)
        weighed = builder.fmul(share, other, flags=FREE)
        _add(builder, seen, weighed, _get(light, builder, lights.read(path, _WHOLE)))
        _add(builder, known, weighed, other)
    here, bent = _get(x, builder, place), builder.load(known)
    best = builder.fdiv(builder.load(seen), bent, flags=FREE)
    lit = builder.fcmp_ordered(">", bent, _LEAST)
    _put(x, builder, place, builder.select(lit, _clamped(builder, best, bounds), here))


@intrinsic
@generated
def find_equation(  # noqa: PLR0913, PLR0917
    builder: Any,
    lights: Memory,
    weights: Memory,
    others: Memory,
    count: Any,
    begin: Any,
    end: Any,
    x: Memory,
    light: Memory,
    left: Memory,
    pitch: Any,
    row: Any,
    fall: Memory,
    moves: Memory,
    share: Memory,
    unknown: Any,
    reach: Any,
) -> None:
    """Find the equation of a factor of products, as if they were linear near where they are.

        g_i = sum w o_i (L - o_i x_i),   H_id = sum w o_i o_(i+d)

    Args:
        builder: of what is compiled.
        lights: see `relax_product`.
        weights: the same.
        others: the same.
        count: the same.
        begin: the same.
        end: the same.
        x: lanes.
        light: L.
        left: where H_id is put, `pitch` lanes.
        pitch: of it.
        row: number of this one in it.
        fall: g.
        moves: g, too.
        share: 1 / H_ii, a number for every row; 0 where no light comes through.
        unknown: i.
        reach: of H.
    """
    place, start = builder.add(unknown, reach), builder.mul(row, pitch)
    with cgutils.for_range(builder, pitch) as loop:
        _put(left, builder, builder.add(start, loop.index), _ZERO)
    own = _get(x, builder, place)
    slope, known = (cgutils.alloca_once_value(builder, _ZERO) for _ in range(2))
    with cgutils.for_range(builder, end, begin) as loop:
        path = loop.index
        weight = everywhere(builder, weights.read(path, _FLOAT))
        other = _met(builder, others, count, path, x)
        weighed = builder.fmul(weight, other, flags=FREE)
        off = builder.fsub(
            _get(light, builder, lights.read(path, _WHOLE)),
            builder.fmul(other, own, flags=FREE),
            flags=FREE,
        )
        _add(builder, slope, weighed, off)
        _add(builder, known, weighed, other)
        through = builder.fmul(weighed, own, flags=FREE)
        with cgutils.for_range(builder, count) as inner:
            number = builder.add(builder.mul(path, count), inner.index)
            ahead = builder.sub(others.read(number, _WHOLE), place)
            with builder.if_then(builder.icmp_signed(">", ahead, ahead.type(0))):
                rest = _met(builder, others, count, path, x, without=inner.index)
                at = builder.add(start, ahead)
                value = _plus(builder, _get(left, builder, at), through, rest)
                _put(left, builder, at, value)
    bent, found = builder.load(known), builder.load(slope)
    _put(left, builder, start, bent)
    _put(fall, builder, unknown, found)
    _put(moves, builder, unknown, found)
    lit = builder.fcmp_ordered(">", bent, _LEAST)
    inverse = builder.fdiv(_ONE, bent, flags=FREE)
    share.write(builder.select(lit, inverse, _ZERO), reach.type(0))


def _met(
    builder: Any, others: Memory, count: Any, path: Any, x: Memory, without: Any = None
) -> Any:
    """Return the product of the other factors of a path, or of all of them but one."""
    product, first = cgutils.alloca_once_value(builder, _ONE), builder.mul(path, count)
    with cgutils.for_range(builder, count) as loop:
        at = others.read(builder.add(first, loop.index), _WHOLE)
        value = _get(x, builder, at)
        if without is not None:
            value = builder.select(builder.icmp_signed("==", loop.index, without), _ONE, value)
        builder.store(builder.fmul(builder.load(product), value, flags=FREE), product)
    return builder.load(product)


def _eliminate(
    builder: Any,
    entry: Callable[[Any], Any],
    pitch: Any,
    left: Memory,
    place: Any,
    factor: Memory,
    moves: Memory,
    unknown: Any,
    reach: Any,
) -> None:
    """Take unknowns before one out of its equation, whose entries are given; see `eliminate`."""
    one = reach.type(1)
    here = builder.mul(place, pitch)
    sums = [cgutils.alloca_once(builder, _VECTOR) for _ in range(CHUNK)]
    move = cgutils.alloca_once_value(builder, _get(moves, builder, unknown))
    span = reach.type(0), builder.add(reach, one), reach.type(CHUNK), reach.type
    with cgutils.for_range_slice(builder, *span) as (first, _):
        for number, total in enumerate(sums):
            builder.store(entry(builder.add(first, first.type(number))), total)
        far = _least(builder, builder.sub(reach, first), unknown)
        with cgutils.for_range(builder, far) as loop:  # the nearest last: it is known last
            e = builder.sub(far, loop.index)
            other = builder.sub(unknown, e)
            at = builder.add(builder.mul(other, reach), builder.sub(e, one))
            share = _get(factor, builder, at)
            at = builder.mul(builder.sub(place, e), pitch)
            at = builder.add(at, builder.add(e, first))
            for number, total in enumerate(sums):
                value = _get(left, builder, builder.add(at, at.type(number)))
                _add(builder, total, share, value)
        for number, total in enumerate(sums):
            at = builder.add(here, builder.add(first, first.type(number)))
            _put(left, builder, at, builder.load(total))
    far = _least(builder, reach, unknown)
    with cgutils.for_range(builder, far) as loop:
        e = builder.sub(far, loop.index)
        at = builder.add(builder.mul(builder.sub(place, e), pitch), e)
        value = builder.fneg(_get(left, builder, at))
        _add(builder, move, value, _get(moves, builder, builder.sub(unknown, e)))
    _put(moves, builder, unknown, builder.load(move))


def _fall(
    builder: Any, matrix: tuple[Memory, Memory, Any], x: Memory, data: Memory, unknown: Any
) -> Any:
    """Return b_i - (H x)_i."""
    offsets, entries, taps = matrix
    sums = [cgutils.alloca_once(builder, _VECTOR) for _ in range(TAPS)]
    for total in sums:
        builder.store(_ZERO, total)
    row, whole = builder.mul(unknown, taps), taps.type
    span = whole(0), taps, whole(TAPS), whole
    with cgutils.for_range_slice(builder, *span) as (first, _):
        for number, total in enumerate(sums):
            at = builder.add(row, builder.add(first, whole(number)))
            place = builder.add(unknown, offsets.read(at, _WHOLE))
            entry = everywhere(builder, entries.read(at, _FLOAT))
            _add(builder, total, entry, _get(x, builder, place))
    found = _get(data, builder, unknown)
    for total in sums:
        found = builder.fsub(found, builder.load(total), flags=FREE)
    return found


def _get(values: Memory, builder: Any, number: Any) -> Any:
    return values.read(builder.mul(number, number.type(LANES)))


def _put(values: Memory, builder: Any, number: Any, value: Any) -> None:
    values.write(value, builder.mul(number, number.type(LANES)))


def _least(builder: Any, one: Any, other: Any) -> Any:
    return builder.select(builder.icmp_signed("<", one, other), one, other)


def _plus(builder: Any, value: Any, factor: Any, other: Any) -> Any:
    return builder.fadd(value, builder.fmul(factor, other, flags=FREE), flags=FREE)


def _add(builder: Any, total: Any, one: Any, other: Any) -> None:
    builder.store(_plus(builder, builder.load(total), one, other), total)


def _limits(builder: Any, bounds: Memory) -> tuple[Any, Any]:
    low, high = (everywhere(builder, bounds.read(_WHOLE(n), _FLOAT)) for n in range(2))
    return low, high


def _clamped(builder: Any, value: Any, bounds: Memory) -> Any:
    low, high = _limits(builder, bounds)
    value = builder.select(builder.fcmp_ordered("<", value, low), low, value)
    return builder.select(builder.fcmp_ordered(">", value, high), high, value)
