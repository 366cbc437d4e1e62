"""The HDF5 files of the older HCI archive."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from layerfield.io.images import Picture, select_channels
from layerfield.io.options import FieldOptions
from layerfield.io.stored import Reader, StoredViews, known_grid, refuse_picture_hints

DATASET = "LF"


def open_hdf5(path: Path, options: FieldOptions) -> StoredViews:
    """Find the views in the dataset /LF, [rows, columns, y, x, channels].

    Args:
        path: the file.
        options: `grid` and `order` matter.

    Raises:
        ValueError: not such a file, a damaged one, no /LF or one of another shape.
    """
    refuse_picture_hints(path, "an array", options)
    shape = _from_file(path, lambda dataset: dataset.shape)
    if len(shape) != 5 or 0 in shape:
        raise ValueError(
            f"/{DATASET} in {path} has shape {shape}, expected [rows, columns, y, x, channels]"
        )

    def read(n: int) -> Picture:
        pixels = _from_file(path, lambda dataset: dataset[n // shape[1], n % shape[1]])
        return Picture(*select_channels(np.asarray(pixels), str(path)))

    grid = known_grid(shape[:2], options, str(path))
    return StoredViews(grid, read, lambda n: f"view {n} of {path.name}")


READER = Reader(
    accepts=lambda path, options: path.suffix.lower() in (".h5", ".hdf5"), open=open_hdf5
)


def _from_file(path: Path, take: Any) -> Any:
    try:
        with path.open("rb"), h5py.File(path, "r") as file:
            dataset = file.get(DATASET)
            names = ", ".join(list(file)[:6]) or "nothing"
            return take(dataset) if isinstance(dataset, h5py.Dataset) else _missing(path, names)
    except _NoDatasetError:
        raise
    except (FileNotFoundError, PermissionError) as error:
        raise ValueError(f"cannot read {path}: {error.strerror}") from None
    except Exception as error:  # on damaged files HDF5 raises whatever it stumbles over
        first = str(error).partition("\n")[0]
        raise ValueError(f"{path} is no HDF5 file or is damaged ({first})") from None


class _NoDatasetError(ValueError):
    """The file is sound but is no light field."""


def _missing(path: Path, names: str) -> None:
    raise _NoDatasetError(f"{path} holds no dataset /{DATASET} (found {names})")
