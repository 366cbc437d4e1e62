"""NumPy files: `.npy`, and `.npz` with one array."""

import zipfile
import zlib
from pathlib import Path
from typing import BinaryIO

import numpy as np

from layerfield.io.images import Picture, select_channels
from layerfield.io.options import FieldOptions, Grid
from layerfield.io.stored import (
    Reader,
    StoredViews,
    known_grid,
    listed_grid,
    refuse_picture_hints,
)

_CHANNELS = (1, 3, 4)
_PREFERRED = ("views", "LF")


def open_array(path: Path, options: FieldOptions) -> StoredViews:
    """Find the views in an array.

    Shapes: [rows, columns, y, x, c], [rows, columns, c, y, x], grey [rows, columns, y, x]; with a
    grid also [view, y, x, c], [view, c, y, x], grey [view, y, x].

    Args:
        path: the file; it is never unpickled.
        options: `grid` and `order` matter.

    Raises:
        ValueError: not such a file, a damaged one, or another shape.
    """
    refuse_picture_hints(path, "an array", options)
    return views_of_array(_load(path), options, str(path))


def views_of_array(array: np.ndarray, options: FieldOptions, source: str) -> StoredViews:
    """Return the views in an array of one of the shapes above; `source` is its name in errors."""
    if 0 in array.shape:
        raise ValueError(f"{source} holds an empty array of shape {array.shape}")
    views, grid = _as_list(array, options, source)

    def read(n: int) -> Picture:
        return Picture(*select_channels(np.asarray(views[n]), source))

    return StoredViews(grid, read, lambda n: f"view {n} of {source}")


READER = Reader(
    accepts=lambda path, options: path.suffix.lower() in (".npy", ".npz"), open=open_array
)


def _as_list(array: np.ndarray, options: FieldOptions, source: str) -> tuple[np.ndarray, Grid]:
    shape = array.shape
    if len(shape) == 5 and (shape[-1] in _CHANNELS or shape[2] in _CHANNELS):
        grid = known_grid(shape[:2], options, source)
        return _channels_last(array.reshape(-1, *shape[2:])), grid
    laid_out = options.grid is not None and options.order.stored(options.grid) == shape[:2]
    if len(shape) == 4 and (shape[-1] in _CHANNELS or shape[1] in _CHANNELS) and not laid_out:
        return _channels_last(array), listed_grid(shape[0], options, source)
    if len(shape) == 4:
        grid = known_grid(shape[:2], options, source)
        return array.reshape(-1, *shape[2:])[..., None], grid
    if len(shape) == 3 and shape[-1] not in _CHANNELS:
        return array[..., None], listed_grid(shape[0], options, source)
    raise ValueError(
        f"{source} holds an array of shape {shape}, expected [rows, columns, y, x, 1 or 3], or "
        "[views, y, x, 1 or 3] with a grid"
    )


def _channels_last(views: np.ndarray) -> np.ndarray:
    return views if views.shape[-1] in _CHANNELS else np.moveaxis(views, 1, -1)


def _load(path: Path) -> np.ndarray:
    try:
        with path.open("rb") as file:  # ours, so that it is closed whatever NumPy stumbles over
            if path.suffix.lower() == ".npz":
                return _only_array(file, path)
        return np.lib.format.open_memmap(path, mode="r")
    except (OSError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        reason = getattr(error, "strerror", None) or "it is damaged or truncated"
        raise ValueError(f"cannot read {path}: {reason}") from None
    except _NoArrayError:
        raise
    except Exception as error:  # on damaged headers NumPy raises whatever it stumbles over
        first = str(error).partition("\n")[0]
        raise ValueError(f"{path} is no plain NumPy file or is damaged ({first})") from None


class _NoArrayError(ValueError):
    """The archive is sound but does not hold one array."""


def _only_array(file: BinaryIO, path: Path) -> np.ndarray:
    loaded = np.load(file, allow_pickle=False)
    if isinstance(loaded, np.ndarray):  # an .npy by another name
        return loaded
    with loaded:
        return loaded[_only_name(loaded.files, path)]


def _only_name(names: list[str], path: Path) -> str:
    for name in _PREFERRED:
        if name in names:
            return name
    if len(names) != 1:
        raise _NoArrayError(
            f"{path} holds {len(names)} arrays ({', '.join(names[:6])}); expected one, or one "
            "named 'views'"
        )
    return names[0]
