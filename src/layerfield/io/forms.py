"""Forms in which light fields are written; each is read again by `load_light_field`.

folder   view_RR_CC.png, row 00 on top, column 00 left
quilt    one .png for lenticular displays, a single row of views; its name tells the layout
atlas    one .png, views as on their grid
npy      an array [row, column, y, x, channel]
h5       the same as the dataset /LF, as in the older HCI archive
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from jaxtyping import Num

from layerfield.io.hdf5 import DATASET
from layerfield.io.images import write_png
from layerfield.io.options import Quilt
from layerfield.io.quilt import (
    atlas_of_views,
    nearly_square,
    quilt_in_name,
    quilt_of_views,
    with_quilt_in_name,
)
from layerfield.io.safe_output import whole_directory, whole_file
from layerfield.io.stored import show
from layerfield.light_field import LightField
from layerfield.nearest import did_you_mean
from layerfield.panels import quantise

RECORD = "field.json"
_ASPECTS_DIFFER = 0.02  # names round them
_Views = Num[np.ndarray, "row column y x c"]


@dataclass(frozen=True)
class Form:
    """One way of writing a light field.

    Args:
        name: what users call it.
        suffixes: of its files; none for a folder.
        write: writes views to a path.
        pictures: whether values must be whole numbers.
    """

    name: str
    suffixes: tuple[str, ...]
    write: Callable[[Path, _Views], None]
    pictures: bool = True


def _write_folder(path: Path, views: _Views) -> None:
    for row, line in enumerate(views):
        for column, view in enumerate(line):
            write_png(path / f"view_{row:02d}_{column:02d}.png", np.moveaxis(view, -1, 0))


def _write_quilt(path: Path, views: _Views) -> None:
    write_png(path, np.moveaxis(quilt_of_views(views), -1, 0))


def _write_atlas(path: Path, views: _Views) -> None:
    write_png(path, np.moveaxis(atlas_of_views(views), -1, 0))


def _write_npy(path: Path, views: _Views) -> None:
    with path.open("wb") as file:  # by a name np.save would add an ending to
        np.save(file, views, allow_pickle=False)


def _write_h5(path: Path, views: _Views) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset(DATASET, data=views)


FOLDER = Form("folder", (), _write_folder)
QUILT = Form("quilt", (".png",), _write_quilt)
ATLAS = Form("atlas", (".png",), _write_atlas)
NPY = Form("npy", (".npy",), _write_npy, pictures=False)
H5 = Form("h5", (".h5", ".hdf5"), _write_h5, pictures=False)
FORMS = {form.name: form for form in (FOLDER, QUILT, ATLAS, NPY, H5)}


def form_of(path: Path, asked: str | None = None) -> Form:
    """Return the form that a name stands for.

    Args:
        path: to be written; `_qs8x6` in its name means a quilt.
        asked: the name of a form; needed for an atlas only, and for folders whose name looks as if
            it had an ending.

    Raises:
        ValueError: an unknown form or ending, a picture that could be either, or a name that
            contradicts what is asked for.
    """
    if asked is not None and asked not in FORMS:
        raise ValueError(f"unknown form '{asked}'{did_you_mean(asked, FORMS)}")
    suffix = path.suffix.lower()
    named = quilt_in_name(path) is not None
    if named and asked not in (None, QUILT.name):
        raise ValueError(f"{path.name} is the name of a quilt, but {asked} is asked for")
    form = FORMS[asked] if asked else QUILT if named else _by_suffix(path, suffix)
    fits = suffix in form.suffixes if form.suffixes else not _known(suffix)
    if not fits:
        ending = " or ".join(form.suffixes) or "no ending"
        raise ValueError(f"{path.name} is to be written as {form.name}, expected {ending}")
    return form


def write_light_field(
    path: Path,
    field: LightField,
    form: Form,
    *,
    facts: dict[str, Any],
    bits: int | None = None,
    force: bool = False,
) -> Path:
    """Write a light field, whole or not at all.

    Whole numbers stay what they are if their bits do, and so do floats in arrays.

    Args:
        path: the file or folder to make.
        field: no batch.
        form: how.
        facts: for the record `field.json` of a folder.
        bits: 8 or 16; those of the files it was read from if not given, for pictures of floats 16.
        force: replace an earlier one.

    Returns:
        Where it is; the name of a quilt that did not tell its layout tells it now.

    Raises:
        ValueError: it exists, cannot be written, or does not fit into the quilt that is named.
    """
    grid = field.grid
    if form is QUILT:
        layout = quilt_layout(path, field)
        path = path if quilt_in_name(path) else with_quilt_in_name(path, layout)
        grid = (layout.rows, layout.columns)
    views = _codes(field, form, bits)
    views = views.reshape(*grid, *views.shape[1:])
    whole = whole_file if form.suffixes else whole_directory
    with whole(path, force=force) as temporary:
        form.write(temporary, views)
        if not form.suffixes:
            (temporary / RECORD).write_text(json.dumps(facts, indent=2), "utf-8")
    return path


def quilt_layout(path: Path, field: LightField) -> Quilt:
    """Return the layout of a quilt of a light field.

    Raises:
        ValueError: the views are no row, or the name of the quilt tells of others.
    """
    rows, columns = field.grid
    if rows > 1:
        raise ValueError(
            f"'{field.name}' has {show(field.grid)} views, but a quilt is one row of them from "
            f"left to right; take the middle row with --views 1x{columns}, or write an atlas"
        )
    own = nearly_square(columns, field.size)
    named = quilt_in_name(path)
    if named is None:
        return own
    if named.columns * named.rows != columns:
        raise ValueError(
            f"{path.name} tells of {named.columns}x{named.rows} views, but '{field.name}' has "
            f"{columns}; name it {with_quilt_in_name(Path('...png'), own).name} for example"
        )
    aspect = field.size[1] / field.size[0]
    if named.aspect and abs(named.aspect / aspect - 1) > _ASPECTS_DIFFER:
        raise ValueError(
            f"{path.name} tells of views whose aspect is {named.aspect:g}, but those of "
            f"'{field.name}' are {field.size[1]}x{field.size[0]} px, {aspect:.4g}; crop them, or "
            f"write a{aspect:.4g} into the name"
        )
    return named


def _codes(field: LightField, form: Form, bits: int | None) -> Num[np.ndarray, "view y x c"]:
    if bits is None and (field.kept.is_whole or not form.pictures):
        stored = field.stored
        return np.moveaxis(stored.cpu().numpy(), -3, -1)
    depth = bits or field.bits or 16
    views = np.empty((len(field), *field.size, field.stored.shape[-3]), f"uint{depth}")
    for place, view in zip(views, field.kept, strict=True):
        place[:] = np.moveaxis(quantise(view.clamp(0, 1), depth).cpu().numpy(), 0, -1)
    return views


def _known(suffix: str) -> bool:
    return any(suffix in form.suffixes for form in FORMS.values())


def _by_suffix(path: Path, suffix: str) -> Form:
    found = [form for form in FORMS.values() if suffix in form.suffixes]
    match found:
        case [form]:
            return form
        case [] if not suffix:
            return FOLDER
        case []:
            raise ValueError(
                f"{path.name} ends in {suffix}, expected .png, .npy, .h5, or no ending for a "
                "folder of views"
            )
    raise ValueError(
        f"{path.name} could be an atlas or a quilt; say which with --as, or give a quilt a name "
        "that tells its columns and rows, as car_qs8x6.png"
    )
