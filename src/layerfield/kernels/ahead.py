"""Memory that is fetched while something else is done. Numba is imported here; see `compiled`."""

from collections.abc import Sequence
from typing import Any

from llvmlite import ir
from numba.core import cgutils
from numba.core import types as kinds
from numba.extending import intrinsic

_BYTE = ir.IntType(8)
_TO_READ, _DATA = 0, 1
LINE = 64  # bytes that memory is fetched in
FIRST, SECOND = 3, 2  # caches that it is fetched into,
ONCE = 0  # or where it leaves no trace in those that keep what others throw out


@intrinsic
def ask_for(_: Any, array: Any) -> Any:
    """Have all of a contiguous array fetched, and go on."""

    def generate(context: Any, builder: Any, signature: Any, values: Sequence[Any]) -> Any:
        known = context.make_array(signature.args[0])(context, builder, values[0])
        _fetch(builder, known.data, builder.mul(known.nitems, known.itemsize))
        return context.get_dummy_value()

    return kinds.void(array), generate


@intrinsic
def ask_for_bytes(_: Any, address: Any, count: Any) -> Any:
    """Have so many bytes fetched, from an address on, and go on; nothing need be there."""

    def generate(context: Any, builder: Any, _: Any, values: Sequence[Any]) -> Any:
        _fetch(builder, builder.inttoptr(values[0], _BYTE.as_pointer()), values[1])
        return context.get_dummy_value()

    return kinds.void(address, count), generate


def fetch_line(builder: Any, address: Any, cache: int = FIRST) -> None:
    """Have what is at an address fetched into a cache; nothing need be there."""
    _fetch_line(builder, builder.inttoptr(address, _BYTE.as_pointer()), cache)


def _fetch(builder: Any, data: Any, count: Any) -> None:
    """Ask for every line of so many bytes."""
    first = builder.bitcast(data, _BYTE.as_pointer())
    span = count.type(0), count, count.type(LINE), count.type
    with cgutils.for_range_slice(builder, *span) as (at, _):
        _fetch_line(builder, builder.gep(first, [at]), SECOND)


def _fetch_line(builder: Any, place: Any, cache: int) -> None:
    number = ir.IntType(32)
    kind = ir.FunctionType(ir.VoidType(), [place.type, number, number, number])
    fetch = builder.module.declare_intrinsic("llvm.prefetch", [place.type], kind)
    builder.call(fetch, [place, *map(number, (_TO_READ, cache, _DATA))])
