"""Compiled functions over spans, on the threads that PyTorch computes with.

The loop that hands out spans is compiled, too: threads that had to take turns at the interpreter
would wait longer for it than a pass over a picture takes. Numba is imported here; see `compiled`.
"""

from inspect import unwrap
from types import FunctionType
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from layerfield.kernels.threads import SPANS

_FIELDS = _ARGUMENTS, _COUNT, _LENGTH, _NEXT, _FAILED = range(5)  # what all threads share
_BYTES, _NUMBER, _NOTHING = ir.IntType(8).as_pointer(), ir.IntType(32), ir.VoidType()


def region_of(function: FunctionType, kernel: Any) -> FunctionType:
    """Return what calls a kernel for spans of 0 .. count, whoever is free for the next one.

    It is to be compiled. It takes a tuple of the kernel's arguments but for the last two, which are
    the begin and the end of a span; the count; how many threads; and the address of
    `GOMP_parallel`. It returns whether the kernel failed anywhere.

    Args:
        function: in Python; what is compiled is kept on disk beside what is compiled of it.
        kernel: Numba's own.
    """

    @intrinsic
    def call(_: Any, arguments: Any, count: Any, length: Any, threads: Any, address: Any) -> Any:
        whole = types.intp

        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            return _enter(context, builder, signature.args[0], values, kernel)

        return whole(arguments, whole, whole, whole, whole), generate

    return named_as(function, _region, "region", {"_call": call, "SPANS": SPANS})


def _region(arguments, count, threads, address):
    spans = SPANS * threads if threads > 1 else 1
    length = max(1, (count + spans - 1) // spans)
    return _call(arguments, count, length, threads, address)


def _call(arguments, count, length, threads, address):
    """Stands for what `region_of` puts in its place."""
    raise NotImplementedError


def _enter(context: Any, builder: Any, arguments: Any, values: Any, kernel: Any) -> Any:
    """Put what threads share in one place and have each of them call a worker with it."""
    known, count, length, threads, address = values
    zero = count.type(0)
    shared = cgutils.pack_struct(builder, [known, count, length, zero, zero])
    place = cgutils.alloca_once_value(builder, shared)
    work = _worker(context, builder.module, place.type, arguments, kernel)
    call_threads(builder, work, place, threads, address)
    return builder.load(field_of(builder, place, _FAILED))


def _worker(context: Any, module: Any, pointer: Any, arguments: Any, kernel: Any) -> Any:
    """Return a function that takes spans as long as there are any."""
    made = linked(context, kernel, (*arguments.types, types.intp, types.intp))
    work, builder, shared = worker_of(module, pointer)
    loop, span, done = (work.append_basic_block() for _ in range(3))
    known, count, length = (
        builder.load(field_of(builder, shared, which)) for which in (_ARGUMENTS, _COUNT, _LENGTH)
    )
    builder.branch(loop)

    builder.position_at_end(loop)
    begin = take(builder, field_of(builder, shared, _NEXT), length)
    builder.cbranch(builder.icmp_signed("<", begin, count), span, done)

    builder.position_at_end(span)
    after = builder.add(begin, length)
    end = builder.select(builder.icmp_signed("<", after, count), after, count)
    status = call_kernel(context, builder, made, arguments, known, [begin, end])
    with builder.if_then(status.is_error):
        builder.store(count.type(1), field_of(builder, shared, _FAILED))
    builder.branch(loop)

    builder.position_at_end(done)
    builder.ret_void()
    return work


def named_as(
    function: FunctionType, template: FunctionType, kind: str, known: dict[str, Any]
) -> FunctionType:
    """Return a function that is kept on disk beside what is compiled of another.

    Args:
        function: the other.
        template: whose code it has.
        kind: of what it is, for its name.
        known: what its code names.
    """
    place = function.__code__
    code = unwrap(template).__code__.replace(
        co_filename=place.co_filename, co_firstlineno=place.co_firstlineno
    )
    made = FunctionType(code, known, f"{function.__name__}_{kind}")
    made.__qualname__, made.__module__ = made.__name__, function.__module__
    return made


def call_threads(builder: Any, work: Any, shared: Any, threads: Any, address: Any) -> None:
    """Have a number of threads call a worker with what they share, and wait for them."""
    parallel = ir.FunctionType(_NOTHING, [work.type, _BYTES, _NUMBER, _NUMBER])
    run = builder.inttoptr(address, parallel.as_pointer())
    data = builder.bitcast(shared, _BYTES)
    builder.call(run, [work, data, builder.trunc(threads, _NUMBER), _NUMBER(0)])


def worker_of(module: Any, pointer: Any) -> tuple[Any, Any, Any]:
    """Return a function for `call_threads`, what builds it, and what is shared, in there."""
    kind = ir.FunctionType(_NOTHING, [_BYTES])
    work = ir.Function(module, kind, module.get_unique_name("work"))
    work.linkage = "internal"
    builder = ir.IRBuilder(work.append_basic_block())
    return work, builder, builder.bitcast(work.args[0], pointer)


def linked(context: Any, kernel: Any, takes: tuple[Any, ...]) -> Any:
    """Return a kernel compiled for such arguments, as part of what is compiled now."""
    kernel.compile(takes)
    made = kernel.overloads[takes]
    context.active_code_library.add_linking_library(made.library)
    return made


def take(builder: Any, counter: Any, number: Any) -> Any:
    """Return a counter that threads share, which is larger by a number then."""
    return builder.atomic_rmw("add", counter, number, "monotonic")


def call_kernel(
    context: Any, builder: Any, made: Any, arguments: Any, known: Any, last: list[Any]
) -> Any:
    """Call a kernel with a tuple of arguments and what comes last; return its status."""
    given = [*cgutils.unpack_tuple(builder, _borrowed(context, builder, arguments, known)), *last]
    status, _ = context.call_internal_no_propagate(builder, made.fndesc, made.signature, given)
    return status


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


def field_of(builder: Any, shared: Any, which: int) -> Any:
    """Return where a field of what is shared lies."""
    return builder.gep(shared, [_NUMBER(0), _NUMBER(which)])
