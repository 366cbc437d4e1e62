"""The command `rgbd`."""

from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import torch
import typer

from layerfield.cli.options import DisplayName, Force, Out
from layerfield.cli.refusals import depth_asked, keep_inputs, own_file
from layerfield.cli.terminal import say, status
from layerfield.display import Display
from layerfield.io import refuse_existing
from layerfield.io.images import Picture, read_picture, to_floats
from layerfield.panels import largest_code
from layerfield.rendering.placement import Fit
from layerfield.rgbd.depth_maps import KINDS, read_depth_map
from layerfield.rgbd.flat_picture import place_picture
from layerfield.rgbd.writing import write_field
from layerfield.version import __version__

_MAP = f"{' or '.join(KINDS)}: what is near in the map, or distances, larger is farther"
_SMALLEST, _LARGEST = 16, 8192  # pixels along a side
_MADE_UP = "these views are an approximation; what the picture hides was made up"


def rgbd_command(
    picture: Annotated[Path, typer.Argument(help="png, jpg, tif, webp or bmp")],
    depth: Annotated[Path, typer.Argument(help="its depth map, a grey picture or .npy")],
    display: DisplayName,
    out: Out,
    kind: Annotated[str, typer.Option("--map", help=_MAP)] = KINDS[0],
    depth_mm: Annotated[
        float | None, typer.Option("--depth-mm", help="of what is seen; that of the display")
    ] = None,
    depth_px: Annotated[
        float | None,
        typer.Option("--depth-px", help="the same for displays in pixels of disparity"),
    ] = None,
    width: Annotated[
        int | None, typer.Option("--width", help="of the views, pixels; that of the picture")
    ] = None,
    bits: Annotated[
        int | None, typer.Option("--bits", help="8 or 16; those of the picture")
    ] = None,
    force: Force = False,
) -> None:
    """Make an approximate light field of a picture with its depth map, for a display."""
    target = Display.load(display)
    fit = Fit(depth=depth_asked(target, depth_mm, depth_px))
    if bits is not None:
        largest_code(bits)
    refuse_existing(out, force=force)
    keep_inputs(out, picture, depth, own_file(display))
    read = read_picture(picture)
    pixels = _resized(read, width)
    nearness, notes = read_depth_map(depth, kind, pixels.shape[1:])
    made = place_picture(torch.from_numpy(pixels), torch.from_numpy(nearness), target, fit)
    facts = {
        "picture": picture.name,
        "depth_map": depth.name,
        "map": kind,
        "disparities": made.disparities,
        "layerfield": __version__,
    }
    depth_of_values = bits or (8 if read.pixels.dtype == np.uint8 else 16)
    with status(total=target.view_count) as tick:
        write_field(out, made, target, bits=depth_of_values, facts=facts, force=force, tick=tick)
    low, high = made.disparities
    for note in [*read.notes, *notes, _MADE_UP]:
        say(f"note: {note}")
    if target.geometry.grid is not None:
        say(f"disparities are {low:.2f} to {high:.2f} px between neighbouring views")
    say(f"{target.view_count} views are in {out}")


def _resized(picture: Picture, width: int | None) -> np.ndarray:
    """Values [c, y, x] of a picture of this width."""
    values = to_floats(picture.pixels, "the picture")
    height, now = values.shape[1:]
    size = (height, now) if width is None else (round(height * width / now), width)
    if not all(_SMALLEST <= side <= _LARGEST for side in size):
        raise ValueError(
            f"the views would be {size[1]}x{size[0]} px, expected {_SMALLEST} to {_LARGEST} along "
            "each side; give another --width"
        )
    if size == (height, now):
        return values
    how = cv2.INTER_AREA if size[1] < now else cv2.INTER_CUBIC
    resized = [cv2.resize(plane, size[::-1], interpolation=how) for plane in values]
    return np.stack(resized).clip(0, 1)
