"""What every reader returns: views that are known but not yet decoded."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from layerfield.io.images import Picture
from layerfield.io.options import FieldOptions, Grid


@dataclass(frozen=True, eq=False)
class StoredViews:
    """The views of one light field in the order in which they are stored.

    Args:
        grid: (rows, columns) of the light field, `FieldOptions.order` taken into account.
        read: decodes the n-th stored view.
        label: what an error calls the n-th stored view.
        notes: what the reader had to do, one sentence each.
    """

    grid: Grid
    read: Callable[[int], Picture]
    label: Callable[[int], str]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Reader:
    """One way of storing light fields.

    Args:
        accepts: whether this reader is meant by a path and options.
        open: finds the views without decoding more than it must.
    """

    accepts: Callable[[Path, FieldOptions], bool]
    open: Callable[[Path, FieldOptions], StoredViews]


def refuse_picture_hints(path: Path, kind: str, options: FieldOptions) -> None:
    """Refuse options for one picture where something else is read.

    Args:
        path: what is read.
        kind: what that is, for the message.
        options: `quilt` and `lenslet` matter.

    Raises:
        ValueError: one of them was given.
    """
    for name in ("quilt", "lenslet"):
        if getattr(options, name) is not None:
            raise ValueError(f"{path} is {kind}, but {name} is for one picture; leave it out")


def known_grid(found: Grid, options: FieldOptions, source: str) -> Grid:
    """Return the grid of views whose stored layout is known.

    Args:
        found: outer and inner count as stored. A single line of views may be laid out anew by
            `options.grid`.
        options: `order` and `grid` matter.
        source: what an error calls the light field.

    Raises:
        ValueError: `options.grid` contradicts what was found.
    """
    grid = options.order.stored(found)
    wanted = options.grid or grid
    same_count = wanted[0] * wanted[1] == grid[0] * grid[1]
    if wanted != grid and not (1 in grid and same_count):
        raise ValueError(
            f"{source} holds {show(grid)} views, but the grid given is {show(wanted)}; leave it "
            "out or give what is there"
        )
    return wanted


def listed_grid(count: int, options: FieldOptions, source: str) -> Grid:
    """Return the grid of views that are merely listed; it must have been given.

    Args:
        count: number of views found.
        options: `grid` matters.
        source: what an error calls the light field.

    Raises:
        ValueError: no grid was given, or one with another number of views.
    """
    if options.grid is None:
        root = round(count**0.5)
        example = (root, root) if root * root == count else (1, count)
        raise ValueError(
            f"{source} holds {count} views, but nothing says on which grid; give rows and columns, "
            f"such as grid {show(example)}"
        )
    needed = options.grid[0] * options.grid[1]
    if needed != count:
        raise ValueError(
            f"{source} holds {count} views, but a grid of {show(options.grid)} needs {needed}"
        )
    return options.grid


def show(grid: Grid) -> str:
    """Return a grid as users write it, `5x5`."""
    return f"{grid[0]}x{grid[1]}"
