"""Compiled functions over spans, on the threads that PyTorch computes with.

The loop that hands out spans is compiled, too: threads that had to take turns at the interpreter
would wait longer for it than a pass over a picture takes.
"""

from inspect import unwrap
from types import FunctionType
from typing import Any

_FIELDS = _ARGUMENTS, _COUNT, _LENGTH, _NEXT, _FAILED = range(5)


def _call(arguments, count, length, threads, address):
    """Stands for what `region_of` puts in its place."""
    raise NotImplementedError


def _region(arguments, count, length, threads, address):
    return _call(arguments, count, length, threads, address)


def region_of(function: FunctionType, kernel: Any) -> Any:
    """Return what calls a kernel for spans of 0 .. count, whoever is free for the next one.

    It takes a tuple of the kernel's arguments but for the last two, which are the begin and the end
    of a span; their count and the length of a span; how many threads; and the address of
    `GOMP_parallel`. It returns whether the kernel failed anywhere.

    Args:
        function: in Python; what is compiled is kept on disk beside what is compiled of it.
        kernel: Numba's own.
    """
    import numba  # noqa: PLC0415 - see `compiled`
    from numba.extending import intrinsic  # noqa: PLC0415

    @intrinsic
    def call(_: Any, arguments: Any, count: Any, length: Any, threads: Any, address: Any) -> Any:
        whole = numba.types.intp
        return whole(arguments, whole, whole, whole, whole), _code_of(kernel)

    place = function.__code__
    code = unwrap(_region).__code__.replace(
        co_filename=place.co_filename, co_firstlineno=place.co_firstlineno
    )
    made = FunctionType(code, {"_call": call}, f"{function.__name__}_region")
    made.__qualname__, made.__module__ = made.__name__, function.__module__
    return made


def _code_of(kernel: Any) -> Any:
    from llvmlite import ir  # noqa: PLC0415
    from numba import types  # noqa: PLC0415
    from numba.core import cgutils  # noqa: PLC0415

    byte, number = ir.IntType(8).as_pointer(), ir.IntType(32)

    def field(builder: Any, shared: Any, which: int) -> Any:
        return builder.gep(shared, [number(0), number(which)])

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        """Put what all threads need in one place and have each of them call `work` with it."""
        arguments, count, length, threads, address = values
        whole = count.type
        held = ir.LiteralStructType([arguments.type, *[whole] * (len(_FIELDS) - 1)])
        shared = cgutils.alloca_once(builder, held)
        for which, value in enumerate((arguments, count, length, whole(0), whole(0))):
            builder.store(value, field(builder, shared, which))
        work = worker(context, builder.module, shared.type, signature.args[0])
        parallel = ir.FunctionType(ir.VoidType(), [work.type, byte, number, number])
        run = builder.inttoptr(address, parallel.as_pointer())
        data = builder.bitcast(shared, byte)
        builder.call(run, [work, data, builder.trunc(threads, number), number(0)])
        return builder.load(field(builder, shared, _FAILED))

    def worker(context: Any, module: Any, pointer: Any, arguments: Any) -> Any:
        """Return a function that takes spans as long as there are any."""
        takes = (*arguments.types, types.intp, types.intp)
        kernel.compile(takes)
        made = kernel.overloads[takes]
        context.active_code_library.add_linking_library(made.library)
        kind = ir.FunctionType(ir.VoidType(), [byte])
        work = ir.Function(module, kind, module.get_unique_name("work"))
        work.linkage = "internal"
        begun, loop, span, done = (work.append_basic_block() for _ in range(4))

        builder = ir.IRBuilder(begun)
        shared = builder.bitcast(work.args[0], pointer)
        known, count, length = (
            builder.load(field(builder, shared, which)) for which in (_ARGUMENTS, _COUNT, _LENGTH)
        )
        builder.branch(loop)

        builder.position_at_end(loop)
        begin = builder.atomic_rmw("add", field(builder, shared, _NEXT), length, "monotonic")
        builder.cbranch(builder.icmp_signed("<", begin, count), span, done)

        builder.position_at_end(span)
        after = builder.add(begin, length)
        end = builder.select(builder.icmp_signed("<", after, count), after, count)
        given = [*cgutils.unpack_tuple(builder, known), begin, end]
        status, _ = context.call_internal_no_propagate(builder, made.fndesc, made.signature, given)
        with builder.if_then(status.is_error):
            builder.store(count.type(1), field(builder, shared, _FAILED))
        builder.branch(loop)

        builder.position_at_end(done)
        builder.ret_void()
        return work

    return generate
