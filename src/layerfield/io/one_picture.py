"""All views in one picture: an atlas of tiles, a quilt, or a picture taken through lenslets."""

from pathlib import Path

from layerfield.io.images import SUFFIXES, Picture, read_picture
from layerfield.io.options import FieldOptions, Quilt
from layerfield.io.quilt import quilt_in_name, views_of_atlas, views_of_quilt
from layerfield.io.stored import Reader, StoredViews, known_grid, show


def open_atlas(path: Path, options: FieldOptions, picture: Picture | None = None) -> StoredViews:
    """Cut a picture into `options.grid` equal tiles.

    Raises:
        ValueError: no grid was given, or the tiles do not divide the picture.
    """
    if options.grid is None:
        raise ValueError(
            f"{path} is one picture; say how the views lie in it: grid RxC for tiles row by row, "
            "quilt CxR for a quilt, or lenslet PITCH for a picture taken through lenslets"
        )
    picture = picture or read_picture(path)
    rows, columns = options.order.stored(options.grid)
    height, width = _tile(picture, rows, columns)
    if height * rows != picture.pixels.shape[0] or width * columns != picture.pixels.shape[1]:
        raise ValueError(
            f"{path} is {_size(picture)}, which {show((rows, columns))} equal tiles do not divide; "
            "check the grid (rows x columns)"
        )
    tiles = views_of_atlas(picture.pixels, columns, rows)

    def read(n: int) -> Picture:
        return Picture(tiles[n // columns, n % columns], picture.notes)

    grid = known_grid((rows, columns), options, str(path))
    return StoredViews(grid, read, lambda n: f"tile {n} of {path.name}")


def open_quilt(path: Path, options: FieldOptions, picture: Picture | None = None) -> StoredViews:
    """Cut a quilt into a row of views: view 0 bottom left, then to the right, then upward.

    Rows and columns of pixels left over at the top and at the right are left out, as on the
    displays that quilts are made for.

    Raises:
        ValueError: more tiles than pixels.
    """
    picture = picture or read_picture(path)
    quilt = options.quilt or quilt_in_name(path)
    assert quilt is not None  # otherwise this reader did not accept
    height, width = _tile(picture, quilt.rows, quilt.columns)
    if 0 in (height, width):
        raise ValueError(
            f"{path} is {_size(picture)}, too small for a quilt of {quilt.columns}x{quilt.rows}"
        )
    whole = picture.pixels[-height * quilt.rows :, : width * quilt.columns]
    views = views_of_quilt(whole, quilt.columns, quilt.rows)
    count = quilt.rows * quilt.columns

    def read(n: int) -> Picture:
        return Picture(views[n // quilt.columns, n % quilt.columns], picture.notes)

    notes = _quilt_notes(quilt, picture, height, width)
    grid = known_grid((1, count), options, str(path))
    return StoredViews(grid, read, lambda n: f"view {n} of {path.name}", notes)


def open_lenslets(path: Path, options: FieldOptions, picture: Picture | None = None) -> StoredViews:
    """Take view (u, v) as every pitch-th pixel from column u and row v on.

    Raises:
        ValueError: the pitch does not divide the picture.
    """
    picture = picture or read_picture(path)
    pitch = options.lenslet or 1
    height, width = picture.pixels.shape[:2]
    if height % pitch or width % pitch:
        raise ValueError(
            f"{path} is {_size(picture)}, which lenslets of {pitch} px do not divide; crop it to "
            "whole lenslets or resample it to a whole pitch"
        )
    grid = known_grid((pitch, pitch), options, str(path))

    def read(n: int) -> Picture:
        return Picture(picture.pixels[n // pitch :: pitch, n % pitch :: pitch], picture.notes)

    return StoredViews(grid, read, lambda n: f"view {n} of {path.name}")


def views_in_picture(path: Path, options: FieldOptions, picture: Picture) -> StoredViews:
    """Find the views in a picture that came out of a file of many, a frame of a video.

    Args:
        path: of that file; its name may tell the layout of a quilt, and errors name it.
        options: `grid`, `order`, `quilt` and `lenslet` matter.
        picture: the frame.

    Raises:
        ValueError: as for a picture in a file of its own.
    """
    if options.lenslet is not None:
        return open_lenslets(path, options, picture)
    if (options.quilt or quilt_in_name(path)) is not None:
        return open_quilt(path, options, picture)
    return open_atlas(path, options, picture)


def _is_picture(path: Path) -> bool:
    return path.suffix.lower() in SUFFIXES


QUILT = Reader(
    accepts=lambda path, options: (
        _is_picture(path)
        and options.lenslet is None
        and (options.quilt or quilt_in_name(path)) is not None
    ),
    open=open_quilt,
)
LENSLETS = Reader(
    accepts=lambda path, options: _is_picture(path) and options.lenslet is not None,
    open=open_lenslets,
)
ATLAS = Reader(accepts=lambda path, options: _is_picture(path), open=open_atlas)


def _tile(picture: Picture, rows: int, columns: int) -> tuple[int, int]:
    return picture.pixels.shape[0] // rows, picture.pixels.shape[1] // columns


def _size(picture: Picture) -> str:
    return f"{picture.pixels.shape[1]}x{picture.pixels.shape[0]} px"


def _quilt_notes(quilt: Quilt, picture: Picture, height: int, width: int) -> tuple[str, ...]:
    notes = []
    if (height * quilt.rows, width * quilt.columns) != picture.pixels.shape[:2]:
        notes.append(
            f"the quilt of {_size(picture)} does not divide into {quilt.columns}x{quilt.rows} "
            f"tiles of {width}x{height}; the rest at the top and right was left out"
        )
    if quilt.aspect and abs(width / height / quilt.aspect - 1) > 0.02:
        notes.append(
            f"the quilt is meant for views of aspect {quilt.aspect:g}, its tiles of "
            f"{width}x{height} were not resampled"
        )
    return tuple(notes)
