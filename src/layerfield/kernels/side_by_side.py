"""Numbers side by side in rows given by their addresses: what loops over rows are put together of.

Numba is imported by those who use it; see `compiled`.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from llvmlite import ir
from numba.core import cgutils

from layerfield.kernels.lanes import everywhere

WHOLE = ir.IntType(64)


class Lanes:
    """So many numbers side by side, or a single one."""

    def __init__(self, builder: Any, count: int) -> None:
        self._builder, self._count = builder, count

    def of(self, kind: ir.Type) -> ir.Type:
        """Return the type of numbers of a kind."""
        return kind if self._count == 1 else ir.VectorType(kind, self._count)

    def all(self, number: Any) -> Any:
        """Return a number for all of them."""
        return number if self._count == 1 else everywhere(self._builder, number, self._count)

    def constant(self, kind: ir.Type, number: float) -> Any:
        """Return a known number for all of them."""
        return ir.Constant(self.of(kind), number if self._count == 1 else [number] * self._count)

    def each(self, values: Any) -> list[Any]:
        """Return them one by one."""
        if self._count == 1:
            return [values]
        places = map(ir.IntType(32), range(self._count))
        return [self._builder.extract_element(values, place) for place in places]

    def read(self, row: Any, place: Any, kind: ir.Type) -> Any:
        """Return those of a row from a place on."""
        there, size = self._at(row, place, kind)
        return self._builder.load(there, align=size)

    def write(self, values: Any, row: Any, place: Any) -> None:
        """Write them into a row from a place on."""
        kind = values.type if self._count == 1 else values.type.element
        there, size = self._at(row, place, kind)
        self._builder.store(values, there, align=size)

    def read_some(self, row: Any, place: Any, kind: ir.Type, chosen: Any) -> Any:
        """Return those of a row from a place on that are chosen, and 0 elsewhere.

        Memory where none is chosen is not looked at.
        """
        there, size = self._at(row, place, kind)
        values, bits = self.of(kind), self.of(ir.IntType(1))
        called = ir.FunctionType(values, [there.type, ir.IntType(32), bits, values])
        given = there, ir.IntType(32)(size), chosen, ir.Constant(values, None)
        return self._builder.call(self._masked("load", kind, called), given)

    def write_some(self, values: Any, row: Any, place: Any, chosen: Any) -> None:
        """Write those that are chosen into a row from a place on."""
        kind = values.type.element
        there, size = self._at(row, place, kind)
        bits = self.of(ir.IntType(1))
        called = ir.FunctionType(ir.VoidType(), [values.type, there.type, ir.IntType(32), bits])
        given = values, there, ir.IntType(32)(size), chosen
        self._builder.call(self._masked("store", kind, called), given)

    def fused(self, one: Any, other: Any, more: Any) -> Any:
        """Return one times other, and more, of single precision, rounded once."""
        kind = "f32" if self._count == 1 else f"v{self._count}f32"
        called = ir.FunctionType(one.type, [one.type] * 3)
        known = cgutils.get_or_insert_function(self._builder.module, called, f"llvm.fma.{kind}")
        return self._builder.call(known, (one, other, more))

    def _masked(self, what: str, kind: Any, called: ir.FunctionType) -> Any:
        name = f"v{self._count}{kind.intrinsic_name}"
        return cgutils.get_or_insert_function(
            self._builder.module, called, f"llvm.masked.{what}.{name}.p0{name}"
        )

    def _at(self, row: Any, place: Any, kind: ir.Type) -> tuple[Any, int]:
        """Return where they are, and the bytes of one."""
        first = self._builder.inttoptr(row, kind.as_pointer())
        there = self._builder.gep(first, [place])
        size = kind.width // 8 if isinstance(kind, ir.IntType) else 4
        return self._builder.bitcast(there, self.of(kind).as_pointer()), size


def side_by_side(
    builder: Any, count: Any, *shapes: tuple[int, int]
) -> Iterator[tuple[Lanes, list[Any]]]:
    """Yield lanes and places inside loops over a row, for each shape those that it goes into.

    Args:
        builder: of what is compiled.
        count: numbers of the row.
        shapes: vectors and lanes of each, both powers of two; what the last leaves over stays.
    """
    begin = WHOLE(0)
    for vectors, lanes in shapes:
        length = vectors * lanes
        end = builder.and_(count, WHOLE(-length))
        with cgutils.for_range_slice(builder, begin, end, WHOLE(length), WHOLE) as (at, _):
            yield Lanes(builder, lanes), [builder.add(at, WHOLE(lanes * n)) for n in range(vectors)]
        begin = end


def summed(
    builder: Any, begun: Sequence[Any], number: Any, more: Callable[[Any], Sequence[Any]]
) -> list[Any]:
    """Return whole numbers, and so many more of each added to them, in registers.

    Args:
        builder: of what is compiled.
        begun: what is added to.
        number: how often.
        more: what is added to each the nth time, given n.
    """
    sums = [cgutils.alloca_once(builder, each.type) for each in begun]
    for each, value in zip(sums, begun, strict=True):
        builder.store(value, each)
    with cgutils.for_range(builder, number) as turn:
        for each, value in zip(sums, more(turn.index), strict=True):
            builder.store(builder.add(builder.load(each), value), each)
    return [builder.load(each) for each in sums]
