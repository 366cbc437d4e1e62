"""Which views to decode: order, step and views."""

from layerfield.geometry import Point
from layerfield.io.options import FieldOptions, Grid
from layerfield.io.stored import show


def select_views(grid: Grid, options: FieldOptions) -> tuple[Grid, tuple[int, ...]]:
    """Choose views before anything is decoded.

    Args:
        grid: (rows, columns) of the light field.
        options: `order`, `step` and `views` matter.

    Returns:
        The grid that is left, and for each of its views, row by row from the top left, its place
        in the stored sequence.

    Raises:
        ValueError: a step or a number of views that the grid does not have.
    """
    rows, columns = _lines(grid, options)
    chosen = tuple(options.order.index(r, c, grid) for r in rows for c in columns)
    return (len(rows), len(columns)), chosen


def select_eyes(grid: Grid, options: FieldOptions, reach: float) -> dict[Point, int]:
    """Choose all views in and around those that `select_views` chooses.

    Args:
        grid: (rows, columns) of the light field.
        options: `order`, `step` and `views` matter.
        reach: how far out, 1 for the outermost views that `select_views` chooses.

    Returns:
        The position (x, y) of every view, in view steps from the centre of the chosen grid, and
        its place in the stored sequence.
    """
    (ys, xs) = (
        [
            (place, index)
            for index in range(count)
            if abs(place := (index - (line[0] + line[-1]) / 2) / options.step)
            <= reach * (len(line) - 1) / 2
        ]
        for count, line in zip(grid, _lines(grid, options), strict=True)
    )
    return {(x, y): options.order.index(r, c, grid) for y, r in ys for x, c in xs}


def _lines(grid: Grid, options: FieldOptions) -> tuple[range, range]:
    """The rows and columns that are chosen."""
    rows, columns = (_every(count, options.step, grid) for count in grid)
    if options.views is not None:
        left = (len(rows), len(columns))
        if options.views[0] > left[0] or options.views[1] > left[1]:
            after = f" after step {options.step}" if options.step > 1 else ""
            raise ValueError(
                f"views is {show(options.views)}, but the light field has {show(left)} views{after}"
                "; ask for as many or fewer (rows x columns)"
            )
        rows = _central(rows, options.views[0])
        columns = _central(columns, options.views[1])
    return rows, columns


def _every(count: int, step: int, grid: Grid) -> range:
    if step >= count > 1:
        raise ValueError(
            f"step is {step}, but the light field has {show(grid)} views; give a smaller step"
        )
    last = (count - 1) // step * step
    first = (count - 1 - last) // 2
    return range(first, first + last + 1, step)


def _central(indices: range, count: int) -> range:
    first = (len(indices) - count) // 2
    return indices[first : first + count]
