"""Many views in one picture: quilts, as lenticular displays take them, and atlases.

A quilt is a line of views, the leftmost at the bottom left, then to the right, then upward. Its
name says so to those who read it: `car_qs8x6a0.75.png` has 8 columns and 6 rows of views whose
width is 0.75 of their height. In an atlas views lie as on their grid, the top left one first.

Reference: docs.lookingglassfactory.com/keyconcepts/quilts
"""

import math
import re
from pathlib import Path

import numpy as np
from jaxtyping import Num

from layerfield.io.options import QUILT_LAYOUT, Quilt

_IN_NAME = re.compile(rf"_qs({QUILT_LAYOUT})")


def views_of_quilt(
    picture: Num[np.ndarray, "y x c"], columns: int, rows: int
) -> Num[np.ndarray, "row column y2 x2 c"]:
    """Cut a quilt into its views, without copying.

    Args:
        picture: the quilt.
        columns: of its tiles.
        rows: of its tiles.

    Returns:
        View `row * columns + column` of the line at [row, column], counted from the left: row 0
        is the bottom row of tiles. As everywhere, views run row by row.

    Raises:
        ValueError: the tiles do not divide the picture.
    """
    return _tiles(picture, columns, rows, "quilt")[::-1]


def quilt_of_views(
    views: Num[np.ndarray, "row column y x c"],
) -> Num[np.ndarray, "y2 x2 c"]:
    """Put views into a quilt, the inverse of `views_of_quilt`."""
    return atlas_of_views(views[::-1])


def views_of_atlas(
    picture: Num[np.ndarray, "y x c"], columns: int, rows: int
) -> Num[np.ndarray, "row column y2 x2 c"]:
    """Cut an atlas into its views, the top left one at [0, 0]; otherwise as `views_of_quilt`."""
    return _tiles(picture, columns, rows, "atlas")


def atlas_of_views(
    views: Num[np.ndarray, "row column y x c"],
) -> Num[np.ndarray, "y2 x2 c"]:
    """Put views into an atlas, the inverse of `views_of_atlas`."""
    rows, columns, height, width, channels = views.shape
    return views.swapaxes(1, 2).reshape(rows * height, columns * width, channels)


def quilt_in_name(path: Path) -> Quilt | None:
    """Return the layout that the name of a quilt tells, if it does.

    >>> quilt_in_name(Path("car_qs8x6a0.75.png"))
    Quilt(columns=8, rows=6, aspect=0.75)
    """
    match = _IN_NAME.search(path.stem)
    return Quilt.parse(match[1]) if match else None


def with_quilt_in_name(path: Path, quilt: Quilt) -> Path:
    """Return a name that tells the layout of a quilt.

    >>> with_quilt_in_name(Path("car.png"), Quilt(8, 6, 0.75)).name
    'car_qs8x6a0.75.png'
    """
    return path.with_name(f"{path.stem}_qs{quilt}{path.suffix}")


def nearly_square(count: int, size: tuple[int, int]) -> Quilt:
    """Lay out a line of views so that the quilt comes as near to a square as it can.

    Args:
        count: of views; all tiles are used.
        size: height and width of a view.

    >>> nearly_square(48, (560, 420))
    Quilt(columns=8, rows=6, aspect=0.75)
    """
    aspect = size[1] / size[0]
    divisors = [n for n in range(1, count + 1) if count % n == 0]
    columns = min(divisors, key=lambda n: abs(math.log(n * n / count * aspect)))
    return Quilt(columns, count // columns, round(aspect, 4))


def _tiles(
    picture: Num[np.ndarray, "y x c"], columns: int, rows: int, what: str
) -> Num[np.ndarray, "row column y2 x2 c"]:
    height, width, channels = picture.shape
    if height % rows or width % columns:
        raise ValueError(
            f"the {what} is {width}x{height} px, which {columns} columns and {rows} rows of views "
            "do not divide; check both, or cut it to whole views"
        )
    tiles = picture.reshape(rows, height // rows, columns, width // columns, channels)
    return tiles.swapaxes(1, 2)
