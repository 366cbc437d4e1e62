"""Memory that is fetched while something else is done. Numba is imported here; see `compiled`."""

from collections.abc import Sequence
from typing import Any

from llvmlite import ir
from numba.core import cgutils
from numba.core import types as kinds
from numba.extending import intrinsic

_LINE = 64  # bytes that memory is fetched in
_HOW = 0, 2, 1  # to be read, into the second cache, data


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
        _fetch(builder, builder.inttoptr(values[0], ir.IntType(8).as_pointer()), values[1])
        return context.get_dummy_value()

    return kinds.void(address, count), generate


def _fetch(builder: Any, data: Any, count: Any) -> None:
    """Ask for every line of so many bytes."""
    place, number = ir.IntType(8).as_pointer(), ir.IntType(32)
    kind = ir.FunctionType(ir.VoidType(), [place, number, number, number])
    fetch = builder.module.declare_intrinsic("llvm.prefetch", [place], kind)
    first, how = builder.bitcast(data, place), [number(each) for each in _HOW]
    span = count.type(0), count, count.type(_LINE), count.type
    with cgutils.for_range_slice(builder, *span) as (at, _):
        builder.call(fetch, [builder.gep(first, [at]), *how])
