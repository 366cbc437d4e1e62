"""Compiled functions over spans, on the threads that PyTorch computes with.

The loop that hands out spans is compiled, too: threads that had to take turns at the interpreter
would wait longer for it than a pass over a picture takes. Where spans need others, whoever takes
one waits until those are done, and not for all others at the end of every pass. Numba is imported
here; see `compiled`.
"""

from inspect import unwrap
from types import FunctionType
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from layerfield.kernels.threads import SPANS

# What all threads share.
_FIELDS = _ARGUMENTS, _COUNT, _LENGTH, _WAITS, _NEEDS, _DONE, _NEXT, _FAILED = range(8)
_BYTES, _NUMBER, _NOTHING = ir.IntType(8).as_pointer(), ir.IntType(32), ir.VoidType()


def region_of(function: FunctionType, kernel: Any) -> FunctionType:
    """Return what calls a kernel for spans of 0 .. count, whoever is free for the next one.

    It is to be compiled. It takes a tuple of the kernel's arguments but for the last two, which are
    the begin and the end of a span; the count; `needs` and `done`; how many threads; and the
    address of `GOMP_parallel`. It returns whether the kernel failed anywhere; what was not begun
    by then is left out.

    `needs` is empty, or says for each of the count how many, from the first on, are to be done
    before it, and spans are of one. `done` has as many zeros of 32 bits.

    Args:
        function: in Python; what is compiled is kept on disk beside what is compiled of it.
        kernel: Numba's own.
    """

    @intrinsic
    def call(
        _: Any, known: Any, count: Any, length: Any, needs: Any, done: Any, team: Any, address: Any
    ) -> Any:
        whole = types.intp

        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            return _enter(context, builder, signature.args, values, kernel)

        return whole(known, whole, whole, needs, done, whole, whole), generate

    place = function.__code__
    code = unwrap(_region).__code__.replace(
        co_filename=place.co_filename, co_firstlineno=place.co_firstlineno
    )
    made = FunctionType(code, {"_call": call, "SPANS": SPANS}, f"{function.__name__}_region")
    made.__qualname__, made.__module__ = made.__name__, function.__module__
    return made


def _region(arguments, count, needs, done, threads, address):
    spans = SPANS * threads if threads > 1 else 1
    length = 1 if len(needs) > 0 else max(1, (count + spans - 1) // spans)
    return _call(arguments, count, length, needs, done, threads, address)


def _call(arguments, count, length, needs, done, threads, address):
    """Stands for what `region_of` puts in its place."""
    raise NotImplementedError


def _enter(context: Any, builder: Any, kinds: Any, values: Any, kernel: Any) -> Any:
    """Put what threads share in one place and have each of them call a worker with it."""
    known, count, length, needs, done, threads, address = values
    listed, flags = (
        context.make_array(kind)(context, builder, value)
        for kind, value in zip(kinds[3:5], (needs, done), strict=True)
    )
    zero = count.type(0)
    fields = known, count, length, listed.nitems, listed.data, flags.data, zero, zero
    shared = cgutils.alloca_once_value(builder, cgutils.pack_struct(builder, fields))
    work = _worker(context, builder.module, shared.type, kinds[0], kernel)
    parallel = ir.FunctionType(_NOTHING, [work.type, _BYTES, _NUMBER, _NUMBER])
    run = builder.inttoptr(address, parallel.as_pointer())
    data = builder.bitcast(shared, _BYTES)
    builder.call(run, [work, data, builder.trunc(threads, _NUMBER), _NUMBER(0)])
    return builder.load(_field(builder, shared, _FAILED))


def _worker(context: Any, module: Any, pointer: Any, arguments: Any, kernel: Any) -> Any:
    """Return a function that takes spans as long as there are any."""
    takes = (*arguments.types, types.intp, types.intp)
    kernel.compile(takes)
    made = kernel.overloads[takes]
    context.active_code_library.add_linking_library(made.library)
    kind = ir.FunctionType(_NOTHING, [_BYTES])
    work = ir.Function(module, kind, module.get_unique_name("work"))
    work.linkage = "internal"
    begun, loop, span, done = (work.append_basic_block() for _ in range(4))

    builder = ir.IRBuilder(begun)
    shared = builder.bitcast(work.args[0], pointer)
    known, count, length, waits, needs, flags = (
        builder.load(_field(builder, shared, which)) for which in _FIELDS[:6]
    )
    zero, one = count.type(0), count.type(1)
    waits = builder.icmp_signed("!=", waits, zero)
    given = cgutils.unpack_tuple(builder, _borrowed(context, builder, arguments, known))
    failed = _field(builder, shared, _FAILED)
    seen = cgutils.alloca_once_value(builder, zero)  # so many, from the first on, are done
    builder.branch(loop)

    builder.position_at_end(loop)
    begin = builder.atomic_rmw("add", _field(builder, shared, _NEXT), length, "monotonic")
    builder.cbranch(builder.icmp_signed("<", begin, count), span, done)

    builder.position_at_end(span)
    with builder.if_then(waits):
        _wait(builder, builder.load(builder.gep(needs, [begin])), seen, flags)
    has_failed = builder.load_atomic(failed, "monotonic", align=8)
    with builder.if_then(builder.icmp_signed("==", has_failed, zero)):
        after = builder.add(begin, length)
        end = builder.select(builder.icmp_signed("<", after, count), after, count)
        status, _ = context.call_internal_no_propagate(
            builder, made.fndesc, made.signature, [*given, begin, end]
        )
        with builder.if_then(status.is_error):
            builder.store_atomic(one, failed, "monotonic", align=8)
    with builder.if_then(waits):  # done or failed: nobody is to wait for ever
        builder.store_atomic(_NUMBER(1), builder.gep(flags, [begin]), "release", align=4)
    builder.branch(loop)

    builder.position_at_end(done)
    builder.ret_void()
    return work


def _wait(builder: Any, needed: Any, seen: Any, flags: Any) -> None:
    """Wait until so many are done, from the first on."""
    look, turn, step, over = (builder.append_basic_block() for _ in range(4))
    builder.branch(look)

    builder.position_at_end(look)
    first = builder.load(seen)
    with builder.if_then(builder.icmp_signed(">=", first, needed)):
        builder.branch(over)
    flag = builder.load_atomic(builder.gep(flags, [first]), "acquire", align=4)
    builder.cbranch(builder.icmp_signed("!=", flag, _NUMBER(0)), step, turn)

    builder.position_at_end(turn)  # who makes what is waited for may need this core
    yields = ir.FunctionType(_NUMBER, [])
    builder.call(cgutils.get_or_insert_function(builder.module, yields, "sched_yield"), [])
    builder.branch(look)

    builder.position_at_end(step)
    builder.store(builder.add(first, first.type(1)), seen)
    builder.branch(look)

    builder.position_at_end(over)


def _borrowed(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    """Return arrays that do not count who holds them: threads would wait for that number."""
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder, value)
        array.meminfo = cgutils.get_null_value(array.meminfo.type)
        return array._getvalue()
    if isinstance(kind, types.BaseTuple):
        for place, each in enumerate(kind.types):  # pyright: ignore[reportAttributeAccessIssue]
            part = _borrowed(context, builder, each, builder.extract_value(value, place))
            value = builder.insert_value(value, part, place)
    return value


def _field(builder: Any, shared: Any, which: int) -> Any:
    return builder.gep(shared, [_NUMBER(0), _NUMBER(which)])
