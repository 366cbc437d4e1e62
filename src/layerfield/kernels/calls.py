"""Calls of C functions from compiled ones. Numba is imported here; see `compiled`."""

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

_LONG, _BYTES = ir.IntType(64), ir.IntType(8).as_pointer()


@intrinsic
def call(_: Any, address: Any, handle: Any, values: Any) -> Any:
    """Call `long (*)(void *, void *, ...)` with a handle and where the values of an array begin.

    Both addresses are whole numbers: they are another in every process, and what is compiled is
    kept for the next.
    """
    if not isinstance(values, types.Array):
        return None

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        array = context.make_array(signature.args[2])(context, builder, given[2])
        kind = ir.FunctionType(_LONG, [_BYTES, _BYTES], var_arg=True)
        function = builder.inttoptr(given[0], kind.as_pointer())
        data = builder.bitcast(array.data, _BYTES)
        return builder.call(function, [builder.inttoptr(given[1], _BYTES), data])

    return types.int64(types.intp, types.intp, values), generate
