"""The registry of readers; a new one is one file and one line here."""

from layerfield.io import arrays, hdf5, one_picture, view_folder
from layerfield.io.stored import Reader

# The first that accepts a path reads it.
READERS: tuple[Reader, ...] = (
    view_folder.READER,
    arrays.READER,
    hdf5.READER,
    one_picture.LENSLETS,
    one_picture.QUILT,
    one_picture.ATLAS,
)
