"""Words of 16 bits without a sign, side by side: what loops over them are put together of.

Numba is imported by those who use it; see `compiled`.
"""

from typing import Any

from llvmlite import ir

from layerfield.kernels.side_by_side import Lanes

WORD, INT = ir.IntType(16), ir.IntType(32)
BITS = 16


def less(builder: Any, lanes: Lanes, one: Any, other: Any) -> Any:
    """Return one word less another, 0 at the least."""
    more = builder.icmp_unsigned(">", one, other)
    return builder.select(more, builder.sub(one, other), lanes.constant(WORD, 0))


def lesser(builder: Any, one: Any, other: Any) -> Any:
    """Return the lesser of words."""
    return builder.select(builder.icmp_unsigned("<", one, other), one, other)


def within(builder: Any, one: Any, bounds: tuple[Any, Any]) -> Any:
    """Return words between others."""
    least, most = bounds
    found = lesser(builder, one, most)
    return builder.select(builder.icmp_unsigned(">", found, least), found, least)


def high_product(builder: Any, lanes: Lanes, one: Any, other: Any) -> Any:
    """Return the product of words over 2^16, rounded down."""
    wide = (builder.zext(each, lanes.of(INT)) for each in (one, other))
    whole = builder.lshr(builder.mul(*wide), lanes.constant(INT, BITS))
    return builder.trunc(whole, lanes.of(WORD))
