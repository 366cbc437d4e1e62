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
        place, number = ir.IntType(8).as_pointer(), ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [place, number, number, number])
        fetch = builder.module.declare_intrinsic("llvm.prefetch", [place], kind)
        data, how = builder.bitcast(known.data, place), [number(each) for each in _HOW]
        count = builder.mul(known.nitems, known.itemsize)
        span = count.type(0), count, count.type(_LINE), count.type
        with cgutils.for_range_slice(builder, *span) as (at, _):
            builder.call(fetch, [builder.gep(data, [at]), *how])
        return context.get_dummy_value()

    return kinds.void(array), generate
