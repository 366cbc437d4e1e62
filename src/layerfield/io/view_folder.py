"""Folders with one picture a view."""

import re
from collections.abc import Iterable
from itertools import islice, pairwise
from math import isqrt
from pathlib import Path
from typing import TypeVar

from layerfield.io.images import SUFFIXES, read_picture
from layerfield.io.options import FieldOptions, Grid
from layerfield.io.stored import (
    Reader,
    StoredViews,
    known_grid,
    listed_grid,
    refuse_picture_hints,
    show,
)

# Row and column at the end of the name; or, in the Stanford archive, before the camera's position.
_ROW_AND_COLUMN = (
    re.compile(r"(?:^|.*[^\d.+-])(\d{1,6})_(\d{1,6})$"),
    re.compile(r"\D*?(\d{1,6})_(\d{1,6})_.*$"),
)
_NUMBERED = re.compile(r".*Cam(\d{1,6})$", re.IGNORECASE)  # the HCI archive, row by row
_NAMED_AT_MOST = 6
_Place = TypeVar("_Place", int, tuple[int, int])


def open_folder(path: Path, options: FieldOptions) -> StoredViews:
    """Find the views of a folder.

    Names with a row and a column say where a view belongs, the HCI's `input_CamNNN` are numbered
    row by row on a square grid, and any others are sorted (numbers by value) and need a grid.

    Args:
        path: the folder.
        options: `grid` and `order` matter.

    Raises:
        ValueError: no views, missing ones, two for one place, or a grid that does not fit.
    """
    refuse_picture_hints(path, "a folder", options)
    pictures = _pictures(path)
    places = [(file, _row_and_column(file.stem)) for file in pictures]
    placed = [(file, place) for file, place in places if place is not None]
    numbered = [(file, int(m[1])) for file in pictures if (m := _NUMBERED.match(file.stem))]
    if 2 * len(numbered) > len(pictures):
        files, grid, notes = _from_numbers(path, numbered, options)
    elif 2 * len(placed) > len(pictures):
        files, grid, notes = _from_places(path, placed, options)
    else:
        files, grid, notes = pictures, listed_grid(len(pictures), options, str(path)), ()
    if len(files) < len(pictures):
        notes += (f"{len(pictures) - len(files)} pictures with other names were ignored",)
    return StoredViews(grid, lambda n: read_picture(files[n]), lambda n: files[n].name, notes)


READER = Reader(accepts=lambda path, options: path.is_dir(), open=open_folder)


def _pictures(path: Path) -> list[Path]:
    try:
        entries = sorted(path.iterdir(), key=lambda entry: by_numbers(entry.name))
    except OSError as error:
        raise ValueError(f"cannot read the folder {path}: {error.strerror}") from None
    files = [
        entry
        for entry in entries
        if entry.suffix.lower() in SUFFIXES
        and not entry.name.startswith(".")
        and not entry.is_dir()
    ]
    if not files:
        expected = ", ".join(suffix[1:] for suffix in SUFFIXES)
        raise ValueError(f"found no pictures in the folder {path}; expected views as {expected}")
    return files


def by_numbers(name: str) -> list[tuple[int, int, str]]:
    """Return what sorts digits by their value, so that 2.png comes before 10.png."""
    parts = re.findall(r"\d+|\D+", name)
    return [(0, int(p), p) if p.isdecimal() else (1, 0, p) for p in parts]


def _row_and_column(stem: str) -> tuple[int, int] | None:
    for pattern in _ROW_AND_COLUMN:
        match = pattern.match(stem)
        if match:
            return int(match[1]), int(match[2])
    return None


def _from_numbers(
    path: Path, numbered: list[tuple[Path, int]], options: FieldOptions
) -> tuple[list[Path], Grid, tuple[str, ...]]:
    files = _unique((number, file) for file, number in numbered)
    first = min(1, *files)
    side = 1 + isqrt(max(files) - first)
    grid = options.grid or (side, side)
    expected = range(first, first + grid[0] * grid[1])
    _refuse_missing(path, len(files), (f"Cam{n:03}" for n in expected if n not in files), grid)
    known = known_grid(options.order.stored(grid), options, str(path))
    if len(files) > grid[0] * grid[1]:
        listed_grid(len(files), options, str(path))
    return [files[n] for n in sorted(files)], known, ()


def _from_places(
    path: Path, placed: list[tuple[Path, tuple[int, int]]], options: FieldOptions
) -> tuple[list[Path], Grid, tuple[str, ...]]:
    files = _unique((place, file) for file, place in placed)
    outer = _evenly_spaced({place[0] for place in files})
    inner = _evenly_spaced({place[1] for place in files})
    stored = (len(outer), len(inner))
    missing = (f"{a:02}_{b:02}" for a in outer for b in inner if (a, b) not in files)
    _refuse_missing(path, len(files), missing, options.order.stored(stored))
    apart = max((b - a for line in (outer, inner) for a, b in pairwise(line)), default=1)
    notes = (f"the names of the views count in steps of {apart}",) if apart > 1 else ()
    ordered = [files[a, b] for a in outer for b in inner]
    return ordered, known_grid(stored, options, str(path)), notes


def _evenly_spaced(numbers: set[int]) -> range:
    """Cover the numbers at the smallest distance between two of them, so that gaps stand out."""
    ordered = sorted(numbers)
    apart = min((b - a for a, b in pairwise(ordered)), default=1)
    exact = all((n - ordered[0]) % apart == 0 for n in ordered)
    return range(ordered[0], ordered[-1] + 1, apart if exact else 1)


def _unique(pairs: Iterable[tuple[_Place, Path]]) -> dict[_Place, Path]:
    files: dict[_Place, Path] = {}
    for key, file in pairs:
        if key in files:
            raise ValueError(
                f"found two files for one view, {files[key].name} and {file.name}; keep one of "
                f"them in {file.parent}"
            )
        files[key] = file
    return files


def _refuse_missing(path: Path, found: int, missing: Iterable[str], grid: Grid) -> None:
    named = list(islice(missing, _NAMED_AT_MOST))
    count = grid[0] * grid[1] - found
    if named:
        more = " ..." if count > len(named) else ""
        raise ValueError(
            f"{path} lacks {count} of the {show(grid)} views (found {found}): missing "
            f"{', '.join(named)}{more}; add them or give the grid that is there"
        )
