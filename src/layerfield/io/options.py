"""What a user may say about a light field: how it is stored and which part of it to take."""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import TypeVar

Grid = tuple[int, int]
_Parsed = TypeVar("_Parsed")


@dataclass(frozen=True)
class Order:
    """In which order the views are stored.

    Args:
        bottom: the first stored view is in the bottom row.
        right: the first stored view is in the right column.
        columns: views run down (or up) a column first, not along a row.
    """

    bottom: bool = False
    right: bool = False
    columns: bool = False

    @classmethod
    def parse(cls, text: str) -> "Order":
        """Parse `tl-row`, `br-column` ...; raise a ValueError that shows what is expected.

        >>> Order.parse("bl-row")
        Order(bottom=True, right=False, columns=False)
        """
        match = re.fullmatch(r"([tb])([lr])-(row|column)", text)
        if match is None:
            raise ValueError(
                f"order is '{text}', expected the corner of the first view (tl, tr, bl or br) and "
                "what runs first (row or column), such as tl-row"
            )
        return cls(match[1] == "b", match[2] == "r", match[3] == "column")

    def __str__(self) -> str:
        corner = ("b" if self.bottom else "t") + ("r" if self.right else "l")
        return f"{corner}-{'column' if self.columns else 'row'}"

    def stored(self, grid: Grid) -> Grid:
        """Return the stored layout (outer count, inner count) of a grid of rows and columns."""
        return (grid[1], grid[0]) if self.columns else grid

    def index(self, row: int, column: int, grid: Grid) -> int:
        """Return where in the stored sequence the view at (row, column) from the top left is."""
        row = grid[0] - 1 - row if self.bottom else row
        column = grid[1] - 1 - column if self.right else column
        return column * grid[0] + row if self.columns else row * grid[1] + column


@dataclass(frozen=True)
class Crop:
    """A rectangle of every view; without a corner, the central one."""

    width: int
    height: int
    corner: tuple[int, int] | None = None

    @classmethod
    def parse(cls, text: str) -> "Crop":
        """Parse `WxH` or `WxH+X+Y`; raise a ValueError that shows what is expected."""
        match = re.fullmatch(r"(\d{1,6})x(\d{1,6})(?:\+(\d{1,6})\+(\d{1,6}))?", text)
        if match is None or 0 in (int(match[1]), int(match[2])):
            raise ValueError(
                f"crop is '{text}', expected WxH or WxH+X+Y in pixels, as 400x300+10+0"
            )
        corner = None if match[3] is None else (int(match[3]), int(match[4]))
        return cls(int(match[1]), int(match[2]), corner)

    def __str__(self) -> str:
        size = f"{self.width}x{self.height}"
        return size if self.corner is None else f"{size}+{self.corner[0]}+{self.corner[1]}"


@dataclass(frozen=True)
class Quilt:
    """Columns and rows of a quilt's tiles, and the aspect ratio of a view if it is given."""

    columns: int
    rows: int
    aspect: float | None = None

    @classmethod
    def parse(cls, text: str) -> "Quilt":
        """Parse `CxR` or `CxRaA`; raise a ValueError that shows what is expected."""
        match = re.fullmatch(QUILT_LAYOUT, text)
        if match is None or 0 in (int(match[1]), int(match[2])):
            raise ValueError(
                f"quilt is '{text}', expected columns x rows and perhaps the aspect ratio, "
                "as 8x6 or 8x6a0.75"
            )
        return cls(int(match[1]), int(match[2]), float(match[3]) if match[3] else None)

    def __str__(self) -> str:
        return f"{self.columns}x{self.rows}" + ("" if self.aspect is None else f"a{self.aspect}")


QUILT_LAYOUT = r"(\d{1,4})x(\d{1,4})(?:a(\d+(?:\.\d+)?))?"


def parse_grid(name: str, text: str) -> Grid:
    """Parse rows and columns, `5x5`.

    Args:
        name: the option, for the message.
        text: what the user wrote.

    Raises:
        ValueError: not two whole numbers above 0.
    """
    match = re.fullmatch(r"(\d{1,4})x(\d{1,4})", text)
    if match is None or 0 in (int(match[1]), int(match[2])):
        raise ValueError(f"{name} is '{text}', expected rows x columns such as 5x5")
    return int(match[1]), int(match[2])


@dataclass(frozen=True, kw_only=True)
class FieldOptions:
    """How to read a light field and which part to take: order, step, views, shift, scale, crop.

    They are applied in this order. The first two describe the files, like `quilt` and `lenslet`.

    Args:
        grid: rows and columns of the views.
        order: which corner is stored first, and whether rows or columns run first.
        step: take every n-th view in both directions, keeping the grid centred.
        views: take the central (rows, columns) of what is left.
        shift: subtract this from every disparity, pixels per view; the views are cut to the area
            that all of them cover.
        scale: resize every view by this factor.
        crop: take a rectangle of every view.
        quilt: the picture is a quilt with this layout.
        lenslet: the picture is seen through lenslets of this many pixels.

    Raises:
        ValueError: a number out of range, or both a quilt and lenslets.
    """

    grid: Grid | None = None
    order: Order = Order()
    step: int = 1
    views: Grid | None = None
    shift: float = 0.0
    scale: float = 1.0
    crop: Crop | None = None
    quilt: Quilt | None = None
    lenslet: int | None = None

    def __post_init__(self) -> None:
        if self.step < 1:
            raise ValueError(f"step is {self.step}, expected a whole number from 1 upward")
        if not math.isfinite(self.shift):
            raise ValueError(f"shift is {self.shift}, expected a number of pixels per view")
        if not 0 < self.scale <= 16:
            raise ValueError(f"scale is {self.scale:g}, expected a factor above 0 and up to 16")
        if self.lenslet is not None and self.lenslet < 1:
            raise ValueError(f"lenslet is {self.lenslet}, expected a pitch of 1 pixel or more")
        if self.quilt is not None and self.lenslet is not None:
            raise ValueError("found both quilt and lenslet; a picture is one or the other")

    @classmethod
    def parse(
        cls,
        *,
        grid: str | None = None,
        order: str | None = None,
        step: str | int | None = None,
        views: str | None = None,
        shift: str | float | None = None,
        scale: str | float | None = None,
        crop: str | None = None,
        quilt: str | None = None,
        lenslet: str | int | None = None,
    ) -> "FieldOptions":
        """Make options from what a command line holds; `None` leaves the default.

        Args:
            grid: `RxC`.
            order: `{tl,tr,bl,br}-{row,column}`.
            step: a whole number.
            views: `RxC`.
            shift: a number.
            scale: a number.
            crop: `WxH` or `WxH+X+Y`.
            quilt: `CxR` or `CxRaA`.
            lenslet: a whole number.

        Raises:
            ValueError: one line that names the option, what was found and what is expected.
        """
        return cls(
            grid=_parse(lambda text: parse_grid("grid", text), grid),
            order=_parse(Order.parse, order) or Order(),
            step=_default("step", _parse(lambda text: _whole("step", text), step)),
            views=_parse(lambda text: parse_grid("views", text), views),
            shift=_default("shift", _parse(lambda text: _number("shift", text), shift)),
            scale=_default("scale", _parse(lambda text: _number("scale", text), scale)),
            crop=_parse(Crop.parse, crop),
            quilt=_parse(Quilt.parse, quilt),
            lenslet=_parse(lambda text: _whole("lenslet", text), lenslet),
        )

    def written(self) -> dict[str, str]:
        """Return what differs from the default as `parse` takes it.

        >>> FieldOptions.parse(views="5x5", crop="16x12+3+0").written()
        {'views': '5x5', 'crop': '16x12+3+0'}
        """
        given = ((f, getattr(self, f.name)) for f in fields(self))
        return {f.name: _text(value) for f, value in given if value != f.default}


def _text(value: object) -> str:
    return f"{value[0]}x{value[1]}" if isinstance(value, tuple) else str(value)


def _parse(parser: Callable[[str], _Parsed], value: str | float | None) -> _Parsed | None:
    return None if value is None else parser(str(value).strip())


def _default(name: str, value: _Parsed | None) -> _Parsed:
    if value is not None:
        return value
    return next(field.default for field in fields(FieldOptions) if field.name == name)  # pyright: ignore[reportReturnType]


def _whole(name: str, text: str) -> int:
    if not re.fullmatch(r"\d{1,6}", text):
        raise ValueError(f"{name} is '{text}', expected a whole number from 1 upward")
    return int(text)


def _number(name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{name} is '{text}', expected a number") from None
