"""Compiled functions over tasks in order, on the threads that PyTorch computes with.

Whoever is free takes the next task, and waits until all are done that it needs. So threads wait for
what they need only, and not for each other at the end of every pass. Numba is imported here; see
`compiled`.
"""

from types import FunctionType
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from layerfield.kernels.regions import (
    call_kernel,
    call_threads,
    field_of,
    linked,
    named_as,
    take,
    worker_of,
)

_FIELDS = _ARGUMENTS, _COUNT, _NEEDS, _DONE, _NEXT, _FAILED = range(6)  # what all threads share
_FLAG = ir.IntType(32)


def flow_of(function: FunctionType, kernel: Any) -> FunctionType:
    """Return what calls a kernel for 0 .. count - 1, each when all before what it needs are done.

    It is to be compiled. It takes a tuple of the kernel's arguments but for the last, which is the
    number of a task; `needs`, a whole number for every task; `done`, a zero of 32 bits for every
    task; how many threads; and the address of `GOMP_parallel`. It returns whether the kernel failed
    anywhere; what was not begun by then is left out.

    Args:
        function: in Python; what is compiled is kept on disk beside what is compiled of it.
        kernel: Numba's own.
    """

    @intrinsic
    def call(_: Any, arguments: Any, needs: Any, done: Any, threads: Any, address: Any) -> Any:
        whole = types.intp

        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            return _enter(context, builder, signature.args, values, kernel)

        return whole(arguments, needs, done, whole, whole), generate

    return named_as(function, _flow, "flow", {"_call": call})


def _flow(arguments, needs, done, threads, address):
    return _call(arguments, needs, done, threads, address)


def _call(arguments, needs, done, threads, address):
    """Stands for what `flow_of` puts in its place."""
    raise NotImplementedError


def _enter(context: Any, builder: Any, kinds: Any, values: Any, kernel: Any) -> Any:
    """Put what threads share in one place and have each of them call a worker with it."""
    known, needs, done, threads, address = values
    listed, flags = (
        context.make_array(kind)(context, builder, value)
        for kind, value in zip(kinds[1:3], (needs, done), strict=True)
    )
    count = builder.extract_value(listed.shape, 0)
    zero = count.type(0)
    shared = cgutils.pack_struct(builder, [known, count, listed.data, flags.data, zero, zero])
    place = cgutils.alloca_once_value(builder, shared)
    work = _worker(context, builder.module, place.type, kinds[0], kernel)
    call_threads(builder, work, place, threads, address)
    return builder.load(field_of(builder, place, _FAILED))


def _worker(context: Any, module: Any, pointer: Any, arguments: Any, kernel: Any) -> Any:
    """Return a function that takes tasks as long as there are any."""
    made = linked(context, kernel, (*arguments.types, types.intp))
    work, builder, shared = worker_of(module, pointer)
    loop, wait, look, turn, step, begin, done = (work.append_basic_block() for _ in range(7))
    known, count, needs, flags = (
        builder.load(field_of(builder, shared, which)) for which in _FIELDS[:4]
    )
    seen = cgutils.alloca_once_value(builder, count.type(0))  # tasks, from the first on, are done
    builder.branch(loop)

    builder.position_at_end(loop)
    task = take(builder, field_of(builder, shared, _NEXT), count.type(1))
    builder.cbranch(builder.icmp_signed("<", task, count), wait, done)

    builder.position_at_end(wait)
    first = builder.load(seen)
    needed = builder.load(builder.gep(needs, [task]))
    builder.cbranch(builder.icmp_signed("<", first, needed), look, begin)

    builder.position_at_end(look)
    flag = builder.load_atomic(builder.gep(flags, [first]), "acquire", align=4)
    builder.cbranch(builder.icmp_signed("==", flag, _FLAG(0)), turn, step)

    builder.position_at_end(turn)  # whose task is waited for may need this core
    builder.call(_let_others(module), [])
    builder.branch(look)

    builder.position_at_end(step)
    builder.store(builder.add(first, count.type(1)), seen)
    builder.branch(wait)

    builder.position_at_end(begin)
    failed = field_of(builder, shared, _FAILED)
    with builder.if_then(builder.icmp_signed("==", builder.load(failed), count.type(0))):
        status = call_kernel(context, builder, made, arguments, known, [task])
        with builder.if_then(status.is_error):
            builder.store(count.type(1), failed)
    # Others may count on it either way: where one has failed, they do nothing.
    builder.store_atomic(_FLAG(1), builder.gep(flags, [task]), "release", align=4)
    builder.branch(loop)

    builder.position_at_end(done)
    builder.ret_void()
    return work


def _let_others(module: Any) -> Any:
    return cgutils.get_or_insert_function(module, ir.FunctionType(_FLAG, []), "sched_yield")
