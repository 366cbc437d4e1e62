"""Views of a picture with depth, written into a folder one at a time."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from layerfield.display import Display
from layerfield.display_spec import format_spec
from layerfield.io import whole_directory, write_png
from layerfield.io.forms import RECORD
from layerfield.panels import quantise
from layerfield.rgbd.flat_picture import PictureWithDepth


def write_field(
    folder: Path,
    made: PictureWithDepth,
    display: Display,
    *,
    bits: int,
    facts: dict[str, Any],
    force: bool = False,
    tick: Callable[[str, int], None] | None = None,
) -> None:
    """Write a light field, whole or not at all.

    Args:
        folder: to be made.
        made: the picture in the depth of the display.
        display: whose viewpoints see it.
        bits: of the pictures, 8 or 16.
        facts: for the record `field.json`.
        force: replace an earlier folder.
        tick: called with a word and the number of views that are done.

    Raises:
        ValueError: the folder exists, or it cannot be written.
    """
    _, columns = display.geometry.grid or (1, display.view_count)
    with whole_directory(folder, force=force) as temporary:
        for i, view in enumerate(made.views()):
            if tick:
                tick(f"view {i + 1} of {display.view_count}", i)
            name = f"view_{i // columns:02d}_{i % columns:02d}.png"
            write_png(temporary / name, quantise(view, bits))
        (temporary / "display.toml").write_text(format_spec(display.spec), "utf-8")
        (temporary / RECORD).write_text(json.dumps(facts, indent=2), "utf-8")
