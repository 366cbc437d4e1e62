"""What viewers of a stored result see."""

from collections.abc import Sequence
from pathlib import Path

from jaxtyping import Float
from torch import Tensor

from layerfield.display import Display
from layerfield.eyes import Eye, eyes_in_line, look
from layerfield.io import field_name
from layerfield.light_field import LightField
from layerfield.stored_result import (
    display_of,
    facts_of,
    margin_of,
    mount,
    read_layers,
    read_panels,
    simulate_panels,
    view_size_of,
)


def is_result(path: Path) -> bool:
    """Return whether a folder holds layers and their display."""
    return (path / "layers").is_dir() and (path / "display.toml").is_file()


def views_shown(
    folder: Path,
    layers: Float[Tensor, "subframe layer c ly lx"],
    display: Display,
    eyes: Sequence[Eye] = (),
    margin: int | None = None,
) -> Float[Tensor, "view c y x"]:
    """Return what the panels show, where there are any; else, or to eyes, what the layers show.

    Args:
        folder: the result, or a plain folder of layers.
        layers: of it, encoded.
        display: that shows them.
        eyes: that look; the display's own viewpoints if there are none.
        margin: of the layers, if not the result's own.
    """
    panels = read_panels(folder) if display.panels and margin is None and not eyes else []
    if panels:
        return simulate_panels(panels, display, view_size_of(folder))
    light = mounted(folder, layers, display, margin)
    return display.transfer.encode(look(light, display, eyes) if eyes else display(light))


def mounted(
    folder: Path,
    layers: Float[Tensor, "subframe layer c ly lx"],
    display: Display,
    margin: int | None = None,
) -> Float[Tensor, "subframe layer c ly2 lx2"]:
    """Return the light of layers as `mount` does; arguments as in `views_shown`."""
    given = margin_of(folder) if margin is None else (margin, margin)
    return mount(layers, display, display.margin if given is None else given)


def shown_field(folder: Path) -> LightField:
    """Return the views that a result shows, clipped to 0..1.

    Raises:
        ValueError: the result is incomplete or contradicts itself.
    """
    layers, display = _opened(folder)
    return _as_field(folder, views_shown(folder, layers, display), display.geometry.grid)


def field_in_line(folder: Path, count: int | None = None) -> LightField:
    """Return what eyes side by side see of a result, clipped to 0..1; see `eyes_in_line`.

    Args:
        folder: the result.
        count: of eyes; if not given, as many as the display has columns of viewpoints.

    Raises:
        ValueError: the result is incomplete, or its viewpoints form no grid.
    """
    layers, display = _opened(folder)
    _, columns = display.geometry.grid or (1, 1)
    eyes = eyes_in_line(display, columns if count is None else count)
    return _as_field(folder, views_shown(folder, layers, display, eyes))


def _opened(folder: Path) -> tuple[Float[Tensor, "subframe layer c ly lx"], Display]:
    layers, display = read_layers(folder), display_of(folder)
    assert display is not None  # otherwise it is no result
    return layers, display


def _as_field(
    folder: Path, views: Float[Tensor, "view c y x"], grid: tuple[int, int] | None = None
) -> LightField:
    name, bits = field_name(folder), facts_of(folder).get("bits")
    return LightField(views.clamp(0, 1), grid or (1, len(views)), name=name, bits=bits)
