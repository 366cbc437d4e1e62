"""All views of a light field on one picture, to see at a glance what was read."""

import math
from pathlib import Path

import torch
from PIL import Image, ImageDraw, ImageFont
from PIL.PngImagePlugin import PngInfo
from torch.nn import functional

from layerfield.light_field import LightField

_MARK = "layerfield contact sheet"  # in the file, to know our own again
_GAP = 4
_LABEL = 16  # height of the line above every thumbnail
_LARGEST = 240  # a thumbnail is not wider than this, px
_BACKGROUND, _INK = (24, 24, 24), (230, 230, 230)


def write_contact_sheet(path: Path, field: LightField) -> None:
    """Write the contact sheet of a light field as PNG, marked as one."""
    mark = PngInfo()
    mark.add_text("Software", _MARK)
    contact_sheet(field).save(path, format="PNG", pnginfo=mark)


def is_contact_sheet(path: Path) -> bool:
    """Return whether this is a file that `write_contact_sheet` wrote."""
    try:
        with Image.open(path, formats=["PNG"]) as image:
            return image.info.get("Software") == _MARK
    except Exception:  # whatever else it is, it is not ours
        return False


def contact_sheet(field: LightField, max_width: int = 1600) -> Image.Image:
    """Draw thumbnails of all views on their grid, each under its row and column.

    Args:
        field: one light field, no batch. A single row or column is broken into lines.
        max_width: of the picture, in pixels.

    Returns:
        An RGB picture.

    Raises:
        ValueError: the width is too small to hold a pixel of every view.
    """
    rows, columns = field.grid
    across = columns if min(rows, columns) > 1 else math.ceil(math.sqrt(rows * columns))
    width = min(_LARGEST, field.size[1], (max_width - _GAP) // across - _GAP)
    if width < 1:
        raise ValueError(f"max_width is {max_width}, too small for {across} views side by side")
    height = max(1, round(width * field.size[0] / field.size[1]))
    down = math.ceil(rows * columns / across)
    font = ImageFont.load_default(size=12)
    labelled = font.getlength(f"{rows - 1},{columns - 1}") <= width
    label = _LABEL if labelled else 0
    sheet = Image.new(
        "RGB",
        (_GAP + across * (width + _GAP), _GAP + down * (height + label + _GAP)),
        _BACKGROUND,
    )
    draw = ImageDraw.Draw(sheet)
    for number in range(rows * columns):
        x = _GAP + number % across * (width + _GAP)
        y = _GAP + number // across * (height + label + _GAP)
        sheet.paste(_thumbnail(field, number, (height, width)), (x, y + label))
        if labelled:
            text = f"{number // columns},{number % columns}"
            draw.text((x, y + label - 2), text, fill=_INK, font=font, anchor="ls")
    return sheet


def _thumbnail(field: LightField, number: int, size: tuple[int, int]) -> Image.Image:
    view = field.view(number).detach().to("cpu", torch.float32)
    small = functional.interpolate(view[None], size, mode="bilinear", antialias=True)[0]
    pixels = (small.clamp(0, 1) * 255).round().to(torch.uint8).expand(3, -1, -1)
    return Image.fromarray(pixels.permute(1, 2, 0).contiguous().numpy(), "RGB")
