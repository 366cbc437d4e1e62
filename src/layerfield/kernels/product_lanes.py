"""Pixels settled by what their light paths let through: what sweeps over products are made of.

Everything that the paths of a pixel bring stays in the processor's registers until it is settled:
added up view by view in memory, it would pass through the cache with every view. Numba is imported
here; see `compiled`.
"""

from collections.abc import Sequence
from functools import partial, reduce
from typing import Any

from llvmlite import ir
from numba.core import cgutils
from numba.core import types as kinds
from numba.extending import intrinsic

from layerfield.kernels.ahead import fetch_line
from layerfield.kernels.lanes import FREE
from layerfield.kernels.path_tables import AHEAD, EDGE
from layerfield.kernels.side_by_side import WHOLE, Lanes

_FLOAT, _INT = ir.FloatType(), ir.IntType(32)
_LANES, _VECTORS = 16, 2
_LEAST = 1e-12  # curvature: one over less than that may be infinite


@intrinsic
def settle_paths(
    _: Any,
    others: Any,
    codes: Any,
    rows: Any,
    paths: Any,
    number: Any,
    span: Any,
    limits: Any,
) -> Any:
    """Write P = clamp(A + (sum_i w_i o_i L_i - A sum_i w_i o_i^2) / sum_i w_i o_i^2) into a row.

    o_i is the product of the pixels of all other layers along the path of view i. Pixels through
    which nothing shines stay. Returned is the sum of (A - P) (P - P of one sweep ago).

    Rows of whole numbers are read past their ends: from where the row of the layer begins on, and
    up to `EDGE` behind its end. What is found there is multiplied by 0.

    Args:
        others: something for every other layer; they are known when this is compiled.
        codes: an array of the kind of numbers that L is kept in, whole ones or floats.
        rows: addresses of A, which P is written into, of P of one sweep ago, and of L.
        paths: where the tables of the views are that look at the row: how many bytes from A the row
            of the first other layer begins, then those of the next ones, where pixel 0 of the row
            would look; how many from L that of the view does; first columns; weights.
        number: of views. The table of L goes on for `AHEAD` more, whatever they are.
        span: columns of the row; from where to where all views look; columns of a view.
        limits: least and most; and what L is multiplied by.
    """
    count, given = len(others), (others, codes, rows, paths, number, span, limits)
    is_whole = isinstance(codes.dtype, kinds.Integer)
    code = ir.IntType(codes.dtype.bitwidth) if is_whole else _FLOAT

    def generate(_: Any, builder: Any, __: Any, values: Sequence[Any]) -> Any:
        _, _, rows, paths, number, span, limits = values
        width, begin, end, columns = cgutils.unpack_tuple(builder, span)
        given = (cgutils.unpack_tuple(builder, each) for each in (rows, paths, limits))
        known = partial(_Paths, builder, *given, number, count, code)
        whole, edge = known(_LANES), known(EDGE)
        step = _LANES * _VECTORS
        until = builder.add(begin, builder.and_(builder.sub(end, begin), WHOLE(-step)))
        with cgutils.for_range_slice(builder, begin, until, WHOLE(step), WHOLE) as (at, _):
            whole.settle([builder.add(at, WHOLE(_LANES * n)) for n in range(_VECTORS)])
        for first, last in ((WHOLE(0), begin), (until, width)):
            with cgutils.for_range_slice(builder, first, last, WHOLE(EDGE), WHOLE) as (at, _):
                edge.settle([at], (last, columns))
        return builder.fadd(whole.back(), edge.back(), flags=FREE)

    return kinds.float32(*given), generate


class _Paths:
    """The tables of views that look at a row; see `settle_paths`."""

    def __init__(
        self,
        builder: Any,
        rows: Sequence[Any],
        tables: Sequence[Any],
        limits: Sequence[Any],
        number: Any,
        count: int,
        code: ir.Type,
        lanes: int,
    ) -> None:
        whole, self._weights = WHOLE.as_pointer(), builder.inttoptr(tables[3], _FLOAT.as_pointer())
        self._others, self._light, self._lefts = (
            builder.inttoptr(each, whole) for each in tables[:3]
        )
        self._made, self._ago, self._codes = rows
        self._builder, self._number, self._count, self._code = builder, number, count, code
        self._lanes, self._steps, self._limits = Lanes(builder, lanes), range(lanes), limits
        self._size = code.width // 8 if isinstance(code, ir.IntType) else 4
        self._total = self._zero()

    def back(self) -> Any:
        """Return the sum of (A - P) (P - P of one sweep ago) of what was settled."""
        parts = self._lanes.each(self._builder.load(self._total))
        return reduce(partial(self._builder.fadd, flags=FREE), parts)

    def settle(self, places: Sequence[Any], ends: Any = None) -> None:
        """Settle pixels side by side from places on.

        Args:
            places: of so many pixels each.
            ends: of the row and of the columns of a view, where not all views look.
        """
        builder, lanes, multiplied = self._builder, self._lanes, self._times
        sums = [[self._zero() for _ in range(2)] for _ in places]
        inside = None if ends is None else self._below(places[0], ends[0])
        with cgutils.for_range(builder, self._number) as view:
            n, seen = view.index, inside
            if ends is not None:
                here = builder.sub(places[0], self._load(self._lefts, n))
                seen = builder.and_(inside, self._below(here, ends[1]))
            weight = lanes.all(self._load(self._weights, n))
            light = self._from(self._codes, self._light, n)
            others = builder.mul(n, WHOLE(self._count))
            rows = [
                self._from(self._made, self._others, builder.add(others, WHOLE(j)))
                for j in range(self._count)
            ]
            if ends is None:
                ahead = self._from(self._codes, self._light, builder.add(n, WHOLE(AHEAD)))
                fetch_line(builder, builder.add(ahead, builder.mul(places[0], WHOLE(self._size))))
            for place, (first, second) in zip(places, sums, strict=True):
                through = self._ones() if not rows else self._read(rows[0], place, seen)
                for row in rows[1:]:
                    through = multiplied(through, self._read(row, place, seen))
                shown, force = self._shown(light, place, seen), weight
                if seen is not None:
                    force = builder.select(seen, weight, lanes.constant(_FLOAT, 0.0))
                force = multiplied(through, force)
                self._add(first, multiplied(force, shown))
                self._add(second, multiplied(force, through))
        for place, (first, second) in zip(places, sums, strict=True):
            self._move(place, (builder.load(first), builder.load(second)), inside)

    def _move(self, place: Any, sums: Any, inside: Any) -> None:
        builder, lanes = self._builder, self._lanes
        low, high, unit = map(lanes.all, self._limits)
        light, bent = sums
        zero, least = (lanes.constant(_FLOAT, each) for each in (0.0, _LEAST))
        begun, before = (self._read(row, place, inside) for row in (self._made, self._ago))
        rest = builder.fsub(self._times(light, unit), self._times(begun, bent), flags=FREE)
        divisor = builder.select(builder.fcmp_ordered(">", bent, least), bent, least)
        found = builder.fadd(begun, builder.fdiv(rest, divisor, flags=FREE), flags=FREE)
        found = builder.select(builder.fcmp_ordered("<", found, low), low, found)
        found = builder.select(builder.fcmp_ordered(">", found, high), high, found)
        found = builder.select(builder.fcmp_ordered(">", bent, zero), found, begun)
        self._write(found, self._made, place, inside)
        gone = builder.fsub(begun, found, flags=FREE)
        part = self._times(gone, builder.fsub(found, before, flags=FREE))
        if inside is not None:
            part = builder.select(inside, part, zero)
        self._add(self._total, part)

    def _read(self, row: Any, place: Any, seen: Any) -> Any:
        """Return pixels of a row; those that are not seen are 0, and not looked at."""
        if seen is None:
            return self._lanes.read(row, place, _FLOAT)
        return self._lanes.read_some(row, place, _FLOAT, seen)

    def _shown(self, row: Any, place: Any, seen: Any) -> Any:
        """Return numbers of L as floats; whole ones also where they are not seen.

        Processors that have no masks for bytes would look at them one by one.
        """
        if self._code is _FLOAT:
            return self._read(row, place, seen)
        builder, lanes = self._builder, self._lanes
        found = builder.zext(lanes.read(row, place, self._code), lanes.of(_INT))
        return builder.sitofp(found, lanes.of(_FLOAT))

    def _write(self, values: Any, row: Any, place: Any, inside: Any) -> None:
        if inside is None:
            self._lanes.write(values, row, place)
        else:
            self._lanes.write_some(values, row, place, inside)

    def _below(self, place: Any, end: Any) -> Any:
        """Return which of the numbers from a place on are not before 0, and come before an end."""
        builder, lanes = self._builder, self._lanes
        steps = ir.Constant(lanes.of(_INT), [*self._steps])
        here = builder.add(lanes.all(builder.trunc(place, _INT)), steps)
        return builder.icmp_unsigned("<", here, lanes.all(builder.trunc(end, _INT)))

    def _zero(self) -> Any:
        zero = self._lanes.constant(_FLOAT, 0.0)
        place = cgutils.alloca_once(self._builder, zero.type)
        self._builder.store(zero, place)
        return place

    def _ones(self) -> Any:
        return self._lanes.constant(_FLOAT, 1.0)

    def _from(self, origin: Any, offsets: Any, place: Any) -> Any:
        return self._builder.add(origin, self._load(offsets, place))

    def _load(self, table: Any, place: Any) -> Any:
        return self._builder.load(self._builder.gep(table, [place]))

    def _times(self, one: Any, other: Any) -> Any:
        return self._builder.fmul(one, other, flags=FREE)

    def _add(self, total: Any, value: Any) -> None:
        self._builder.store(self._builder.fadd(self._builder.load(total), value, flags=FREE), total)
