"""Load a light field, whatever it is stored as."""

from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.io.images import Picture, to_floats
from layerfield.io.options import FieldOptions, Grid
from layerfield.io.readers import READERS
from layerfield.io.reframing import plan_reframing
from layerfield.io.selection import select_views
from layerfield.io.stored import StoredViews
from layerfield.light_field import LightField

_DEFAULTS = FieldOptions()


def load_light_field(path: str | Path, options: FieldOptions = _DEFAULTS) -> LightField:
    """Read a light field: a folder of views, an atlas, a quilt, a lenslet picture, .npy, .npz, .h5.

    Args:
        path: the folder or file.
        options: how it is stored and which part to take.

    Returns:
        float32 views from 0 to 1, with 1 or 3 channels, row by row from the top left.

    Raises:
        ValueError: one line that says what was found, what was expected and what to do.
    """
    path = Path(path)
    stored = _open(path, options)
    grid, chosen = select_views(stored.grid, options)
    first = stored.read(chosen[0])
    views, notes = _decode(stored, first, grid, chosen, options)
    return LightField(
        views,
        grid,
        name=field_name(path),
        notes=tuple(dict.fromkeys(stored.notes + notes)),
        bits=8 * first.pixels.itemsize if first.pixels.dtype.kind == "u" else None,
    )


def field_name(path: str | Path) -> str:
    """Return what a light field read from there is called: the file or folder, no path."""
    path = Path(path)
    return path.resolve().name if path.is_dir() else path.stem


def _open(path: Path, options: FieldOptions) -> StoredViews:
    try:
        exists = path.exists()
    except (OSError, ValueError):  # a name too long, or with a null character
        exists = False
    if not exists:
        raise ValueError(f"there is no file or folder {path}")
    for reader in READERS:
        if reader.accepts(path, options):
            return reader.open(path, options)
    raise ValueError(
        f"{path} is of no kind that is known; expected a folder of views, one picture (png, jpg, "
        "tif, webp, bmp), .npy, .npz or .h5"
    )


def _decode(
    stored: StoredViews, first: Picture, grid: Grid, chosen: tuple[int, ...], options: FieldOptions
) -> tuple[Float[Tensor, "view c y x"], tuple[str, ...]]:
    reframe = plan_reframing(grid, (first.pixels.shape[0], first.pixels.shape[1]), options)
    views = torch.empty(0)
    notes: list[str] = []
    for place, number in enumerate(chosen):
        picture = first if place == 0 else stored.read(number)
        _refuse_difference(picture, first, stored.label(number), stored.label(chosen[0]))
        notes += picture.notes
        pixels = torch.from_numpy(to_floats(picture.pixels, stored.label(number)))
        view = reframe(pixels, place)
        if place == 0:
            views = _allocate(len(chosen), view)
        views[place] = view
    return views, tuple(notes)


def _allocate(count: int, view: Float[Tensor, "c y x"]) -> Float[Tensor, "view c y x"]:
    try:
        return torch.empty(count, *view.shape)
    except RuntimeError:
        raise ValueError(
            f"{count} views of {view.shape[2]}x{view.shape[1]} px do not fit into the memory; take "
            "fewer views, or scale or crop them"
        ) from None


def _refuse_difference(picture: Picture, first: Picture, label: str, first_label: str) -> None:
    if picture.pixels.shape[:2] != first.pixels.shape[:2]:
        raise ValueError(
            f"{label} is {_size(picture)}, expected {_size(first)} like {first_label}; all views "
            "must have one size"
        )
    if picture.pixels.shape[2] != first.pixels.shape[2]:
        raise ValueError(
            f"{label} is {_kind(picture)}, but {first_label} is {_kind(first)}; all views must be "
            "of one kind"
        )


def _size(picture: Picture) -> str:
    return f"{picture.pixels.shape[1]}x{picture.pixels.shape[0]} px"


def _kind(picture: Picture) -> str:
    return "grey" if picture.pixels.shape[2] == 1 else "in colour"
