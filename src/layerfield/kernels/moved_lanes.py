"""Pixels side by side that move alike: what compiled loops over rows are put together of.

One simple loop over rows that may all be the same memory would look at a pixel at a time. Numba is
imported here; see `compiled`.
"""

from typing import Any

from llvmlite import ir
from numba.extending import intrinsic

from layerfield.kernels.lanes import FREE, Memory, everywhere, generated
from layerfield.kernels.radices import LANES

_FLOAT = ir.FloatType()
_NEIGHBOURS = 4


@intrinsic
@generated
def move_run(  # noqa: PLR0913, PLR0917 - whole numbers that compiled loops pass one by one
    builder: Any,
    factors: Memory,
    state: Memory,
    there: Any,
    width: Any,
    even: Memory,
    carried: Memory,
    here: Any,
    narrow: Any,
    new: Memory,
    left: Memory,
    place: Any,
    made: Memory,
    to: Any,
) -> None:
    """Find the start of `LANES` pixels that move alike; see `moved_parts`.

    Args:
        builder: of what is compiled.
        factors: of the four neighbours that a pixel comes from, of z - c, and the bounds of z.
        state: s of the frame before.
        there: where in it the first pixel comes from.
        width: of a row of it.
        even: e of the frame before.
        carried: c of that.
        here: where in both the first pixel comes from.
        narrow: width of a row of both.
        new: e of the new frame.
        left: c of that, which is written on.
        place: of the first pixel in both.
        made: s of that, which is written on.
        to: the place of the first pixel in it.
    """
    known = [factors.read(place.type(n), _FLOAT) for n in range(_NEIGHBOURS + 3)]
    *shares, again, low, high = (everywhere(builder, each, LANES) for each in known)

    def plus(one: Any, other: Any) -> Any:
        return builder.fadd(one, other, flags=FREE)

    def minus(one: Any, other: Any) -> Any:
        return builder.fsub(one, other, flags=FREE)

    def times(one: Any, other: Any) -> Any:
        return builder.fmul(one, other, flags=FREE)

    def clamped(value: Any) -> Any:
        value = builder.select(builder.fcmp_ordered("<", value, low, flags=FREE), low, value)
        return builder.select(builder.fcmp_ordered(">", value, high, flags=FREE), high, value)

    def between(values: list[Any]) -> Any:
        return _between(builder, shares, values)

    states = _neighbours(builder, state, there, width)
    iterate = between([clamped(each) for each in states])
    dual = minus(between(states), iterate)
    even_there = between(_neighbours(builder, even, here, narrow))
    carried_there = between(_neighbours(builder, carried, here, narrow))
    light = plus(new.read(place), minus(iterate, even_there))
    change = times(again, minus(iterate, carried_there))
    left.write(clamped(light), place)
    made.write(plus(clamped(plus(light, change)), dual), to)


@intrinsic
@generated
def add_unlike(
    builder: Any,
    factors: Memory,
    old: Memory,
    there: Any,
    width: Any,
    new: Memory,
    place: Any,
    sums: Memory,
) -> None:
    """Add the square differences of `LANES` pixels from what they come from.

    Args:
        builder: of what is compiled.
        factors: of the four neighbours that a pixel comes from.
        old: the picture before.
        there: where in it the first pixel comes from.
        width: of a row of both.
        new: the picture.
        place: of the first pixel in it.
        sums: of every pixel, which are added to.
    """
    parts = [factors.read(place.type(n), _FLOAT) for n in range(_NEIGHBOURS)]
    shares = [everywhere(builder, each, LANES) for each in parts]
    known = _between(builder, shares, _neighbours(builder, old, there, width))
    unlike, zero = builder.fsub(known, new.read(place), flags=FREE), place.type(0)
    square = builder.fmul(unlike, unlike, flags=FREE)
    sums.write(builder.fadd(sums.read(zero), square, flags=FREE), zero)


def _neighbours(builder: Any, array: Memory, first: Any, width: Any) -> list[Any]:
    """Return the four pixels that each of `LANES` lies between, in a plane of such a width."""
    rows = first, builder.add(first, width)
    return [array.read(builder.add(row, row.type(n))) for row in rows for n in range(2)]


def _between(builder: Any, shares: list[Any], values: list[Any]) -> Any:
    """Return the sum of their shares."""
    total = builder.fmul(shares[0], values[0], flags=FREE)
    for share, value in zip(shares[1:], values[1:], strict=True):
        total = builder.fadd(total, builder.fmul(share, value, flags=FREE), flags=FREE)
    return total
