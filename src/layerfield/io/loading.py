"""Load a light field, whatever it is stored as."""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Num
from torch import Tensor

from layerfield.io.images import Picture, to_planes
from layerfield.io.options import FieldOptions
from layerfield.io.readers import READERS
from layerfield.io.reframing import Reframing, plan_reframing, reframing_of_eyes
from layerfield.io.selection import select_eyes, select_views
from layerfield.io.stored import StoredViews
from layerfield.kept_views import KeptViews
from layerfield.light_field import EyeViews, LightField

_DEFAULTS = FieldOptions()


def load_light_field(path: str | Path, options: FieldOptions = _DEFAULTS) -> LightField:
    """Read a light field: a folder of views, an atlas, a quilt, a lenslet picture, .npy, .npz, .h5.

    Args:
        path: the folder or file.
        options: how it is stored and which part to take.

    Returns:
        Views with 1 or 3 channels, row by row from the top left. Whole numbers of files stay what
        they are, unless views are shifted by fractions of a pixel or scaled; others become float32.

    Raises:
        ValueError: one line that says what was found, what was expected and what to do.
    """
    path = Path(path)
    return decoded(_open(path, options), options, field_name(path))


def decoded(stored: StoredViews, options: FieldOptions, name: str) -> LightField:
    """Return the light field in views that were found, as `load_light_field` does.

    Raises:
        ValueError: as `load_light_field`.
    """
    grid, chosen = select_views(stored.grid, options)
    first = stored.read(chosen[0])
    reframe = plan_reframing(grid, _pixels(first), options)
    views, notes = _decode(stored, chosen, reframe, (chosen[0], first))
    return LightField(
        views,
        grid,
        name=name,
        notes=tuple(dict.fromkeys(stored.notes + notes)),
        bits=8 * first.pixels.itemsize if first.pixels.dtype.kind == "u" else None,
    )


def load_eye_views(path: str | Path, options: FieldOptions, *, reach: float = 1.5) -> EyeViews:
    """Read the views in and around those that `load_light_field` takes, cut to the same area.

    Args:
        path: the folder or file.
        options: as for `load_light_field`; `step` and `views` say which views it takes.
        reach: how far out to read, 1 for the outermost views that it takes.

    Returns:
        What all eyes see that the light field has views for; those that it takes, too.

    Raises:
        ValueError: as `load_light_field`.
    """
    stored = _open(Path(path), options)
    grid, chosen = select_views(stored.grid, options)
    first = stored.read(chosen[0])
    places = select_eyes(stored.grid, options, reach)
    plan = plan_reframing(grid, _pixels(first), options)
    reframe, eyes = reframing_of_eyes(plan, grid, _pixels(first), list(places), options.shift)
    views, _ = _decode(stored, tuple(places[eye] for eye in eyes), reframe, (chosen[0], first))
    return EyeViews(KeptViews(views).all(), eyes)


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


def _pixels(picture: Picture) -> tuple[int, int]:
    return picture.pixels.shape[0], picture.pixels.shape[1]


def _decode(
    stored: StoredViews, chosen: tuple[int, ...], reframe: Reframing, known: tuple[int, Picture]
) -> tuple[Num[Tensor, "view c y x"], tuple[str, ...]]:
    """Read and reframe chosen views; one of the light field is known, and others are like it."""
    known_number, first = known
    views = torch.empty(0)
    notes: list[str] = []
    for place, number in enumerate(chosen):
        picture = first if number == known_number else stored.read(number)
        _refuse_difference(picture, first, stored.label(number), stored.label(known_number))
        notes += picture.notes
        planes = to_planes(picture.pixels, stored.label(number))
        pixels = torch.from_numpy(np.require(planes, requirements=["W"]))  # torch wants to write
        view = reframe(pixels if reframe.is_cut else _values(pixels), place)
        if place == 0:
            views = _allocate(len(chosen), view)
        if view.dtype != views.dtype:  # files of different depth
            views, view = _values(views), _values(view)
        views[place] = view
    return views, tuple(notes)


def _values(stored: Num[Tensor, "*view c y x"]) -> Float[Tensor, "*view c y x"]:
    return KeptViews(stored).all() if stored.ndim > 3 else KeptViews(stored[None]).view(0)


def _allocate(count: int, view: Num[Tensor, "c y x"]) -> Num[Tensor, "view c y x"]:
    try:
        return view.new_empty(count, *view.shape)
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
