"""One picture that compares methods: what viewers see, where it errs, and the layers."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

_GAP, _TEXT, _TITLE = 10, 15, 20
_INK, _MUTED, _PAPER = (25, 28, 33), (95, 100, 110), (255, 255, 255)
ERROR_GAIN = 5  # error maps show five times the error


@dataclass(frozen=True, eq=False)
class Tile:
    """A picture with a heading and a line below it.

    Args:
        pixels: values, clipped to 0..1 when drawn.
        heading: what it is.
        caption: its figures.
    """

    pixels: Float[Tensor, "c y x"]
    heading: str
    caption: str = ""


@dataclass(frozen=True, eq=False)
class Strip:
    """A row of tiles under a title."""

    title: str
    tiles: Sequence[Tile]


def error_map(view: Float[Tensor, "c y x"], target: Float[Tensor, "c y x"]) -> Tensor:
    """Return the error, averaged over channels and amplified, white where there is none."""
    error = (view - target).abs().mean(dim=0, keepdim=True) * ERROR_GAIN
    return 1 - error.clamp(0, 1).expand(3, -1, -1)


def comparison_picture(strips: Sequence[Strip], tile_width: int = 256) -> Image.Image:
    """Draw rows of pictures, all of one width, with titles and captions."""
    columns = max(len(strip.tiles) for strip in strips)
    height, width = strips[0].tiles[0].pixels.shape[-2:]
    tile = (tile_width, round(tile_width * height / width))
    row = _TITLE + tile[1] + 3 * _TEXT + 2 * _GAP
    canvas = Image.new("RGB", (columns * (tile[0] + _GAP) + _GAP, len(strips) * row + _GAP), _PAPER)
    for y, strip in enumerate(strips):
        _draw_strip(canvas, strip, tile, _GAP + y * row)
    return canvas


def _draw_strip(canvas: Image.Image, strip: Strip, tile: tuple[int, int], top: int) -> None:
    pen = ImageDraw.Draw(canvas)
    pen.text((_GAP, top), strip.title, _INK, ImageFont.load_default(_TITLE - 4))
    font = ImageFont.load_default(_TEXT - 3)
    for x, entry in enumerate(strip.tiles):
        left, y = _GAP + x * (tile[0] + _GAP), top + _TITLE + _GAP // 2
        canvas.paste(_picture(entry.pixels, tile), (left, y))
        pen.rectangle((left - 1, y - 1, left + tile[0], y + tile[1]), outline=(210, 213, 218))
        pen.text((left, y + tile[1] + 3), entry.heading, _INK, font)
        pen.text((left, y + tile[1] + 3 + _TEXT), entry.caption, _MUTED, font)


def _picture(pixels: Tensor, size: tuple[int, int]) -> Image.Image:
    array = (pixels.detach().cpu().clamp(0, 1) * 255).round().numpy()
    array = np.broadcast_to(array, (3, *array.shape[-2:])).astype(np.uint8)
    return Image.fromarray(np.moveaxis(array, 0, -1)).resize(size, Image.Resampling.LANCZOS)
