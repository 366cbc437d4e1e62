"""What is in a result of `synth`, or in a plain folder of layer images, and what it shows."""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.display import Display
from layerfield.io import load_light_field, read_image
from layerfield.io.images import SUFFIXES
from layerfield.light_field import LightField
from layerfield.panel_images import views_through_panels


@dataclass(frozen=True, eq=False)
class StoredResult:
    """A result of `synth` as it lies on disk, or a plain folder of layer images.

    Args:
        name: of its folder.
        display: what the layers are for.
        layers: encoded values as in the files, 0 to 1, front to back.
        margin: pixels (y, x) by which they exceed the views on each side.
        facts: what result.json holds; nothing for a plain folder.
        targets: the views that were aimed at, encoded as in their files; None if not at hand.
    """

    name: str
    display: Display
    layers: Float[Tensor, "subframe layer c ly lx"]
    margin: tuple[int, int]
    facts: dict[str, Any]
    targets: Float[Tensor, "view c y x"] | None = None

    @property
    def view_size(self) -> tuple[int, int]:
        """Height and width of a view in pixels."""
        (height, width), (y, x) = self.layers.shape[-2:], self.margin
        return height - 2 * y, width - 2 * x

    def light(self) -> Float[Tensor, "subframe layer c ly2 lx2"]:
        """Return the light of the layers, with the margin of the display; see `mount`."""
        return mount(self.layers, self.display, self.margin)

    def views(self) -> Float[Tensor, "view c y x"]:
        """Return what viewers see of the layers, unclipped, encoded as the files are."""
        return simulate(self.layers, self.display, self.margin)


def open_result(
    folder: str | Path,
    field: LightField | None = None,
    display: Display | None = None,
    margin: int | None = None,
) -> StoredResult:
    """Open a result of `synth`, or a plain folder of layer images.

    Args:
        folder: of it.
        field: what it was made of; `targets` in the folder if not given.
        display: what shows the layers; that of the folder if not given.
        margin: pixels by which layers exceed the views; as the folder says if not given, and as
            the display has for plain layers.

    Raises:
        ValueError: no layers, no display, layers of another display, or views that are not those
            the layers show.
    """
    folder = Path(folder)
    layers, shown_on = read_layers(folder), display or display_of(folder)
    if shown_on is None:
        raise ValueError(f"{folder} holds no display.toml; say which display with --display")
    targets = None if field is None else field.views
    if targets is None and (folder / "targets").is_dir():
        targets = load_light_field(folder / "targets").views
    result = StoredResult(
        name=folder.resolve().name,
        display=shown_on,
        layers=layers,
        margin=(margin_of(folder) or shown_on.margin) if margin is None else (margin, margin),
        facts=facts_of(folder),
        targets=targets,
    )
    seen = (shown_on.view_count, result.light().shape[-3], *result.view_size)
    if targets is not None and targets.shape != seen:
        raise ValueError(
            f"{folder} shows {_described(seen)}, the light field beside it holds "
            f"{_described(tuple(targets.shape))}; give the one that it was made of"
        )
    return result


def _described(shape: tuple[int, ...]) -> str:
    count, channels, height, width = shape
    return f"{count} views of {width}x{height} px {'grey' if channels == 1 else 'in colour'}"


def facts_of(folder: str | Path) -> dict[str, Any]:
    """Return what result.json holds; nothing for a plain folder of layers.

    Raises:
        ValueError: a result.json that is none.
    """
    path = Path(folder) / "result.json"
    if not path.is_file():
        return {}
    try:
        match json.loads(path.read_text("utf-8")):
            case dict(facts):
                return facts
    except (OSError, ValueError, RecursionError):
        pass
    raise ValueError(f"{path} is not what synth writes; make the result anew")


def read_layers(folder: str | Path) -> Float[Tensor, "subframe layer c ly lx"]:
    """Read layer images, values from 0 to 1, of a result of `synth` or a plain folder of images.

    Images are taken in the order of the numbers in their names, the nearest to the viewer first.
    Folders named `subframe_0`, `subframe_1` ... hold the layers of one subframe each.

    Raises:
        ValueError: no folder, no images, or images that differ in size or number.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ValueError(f"there is no folder {folder}; expected a result of synth or layer images")
    inner = folder / "layers"
    subframes = _pictures_in(inner if inner.is_dir() else folder)
    if not subframes[0]:
        raise ValueError(
            f"found no layer images in {folder}; expected layer_0.png, layer_1.png ..."
        )
    images = [image for images in subframes for image in images]
    layers = [torch.from_numpy(read_image(image)) for image in images]
    for image, layer in zip(images, layers, strict=True):
        if layer.shape != layers[0].shape:
            raise ValueError(
                f"{image.name} is {_size(layer)}, {images[0].name} is {_size(layers[0])}; "
                "all layers must have one size and one kind"
            )
    return torch.stack(layers).unflatten(0, (len(subframes), -1))


def read_panels(folder: str | Path) -> list[Float[Tensor, "subframe c _ _"]]:
    """Read the pictures of panels, values from 0 to 1, of a result of `synth`; none if it has none.

    Raises:
        ValueError: pictures in colour beside grey ones, or subframes that differ in size.
    """
    inner = Path(folder) / "panels"
    panels = []
    for files in zip(*(_pictures_in(inner) if inner.is_dir() else []), strict=True):
        pictures = [torch.from_numpy(read_image(file)) for file in files]
        first = panels[0][0] if panels else pictures[0]
        for file, picture in zip(files, pictures, strict=True):
            if picture.shape != pictures[0].shape or picture.shape[0] != first.shape[0]:
                raise ValueError(
                    f"{file.name} is {_size(picture)}, others are {_size(first)}; panels have one "
                    "size in all subframes, and are all grey or all in colour"
                )
        panels.append(torch.stack(pictures))
    return panels


def view_size_of(folder: str | Path) -> tuple[int, int]:
    """Return the height and width of the views that a result of `synth` was made for.

    Raises:
        ValueError: no result.json, or one that does not say.
    """
    path = Path(folder) / "result.json"
    try:
        size = json.loads(path.read_text("utf-8"))["field"]["size"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        size = None
    match size:
        case [int(height), int(width)] if height > 0 and width > 0:
            return height, width
    raise ValueError(f"{path} holds no size of the views; make the result anew")


def display_of(folder: str | Path) -> Display | None:
    """Return the display that a result of `synth` is for; None for a plain folder."""
    path = Path(folder) / "display.toml"
    return Display.load(path) if path.is_file() else None


def margin_of(folder: str | Path) -> tuple[int, int] | None:
    """Return the margin (y, x) of the layers in a result of `synth`; None for a plain folder.

    Raises:
        ValueError: a result.json without a margin.
    """
    path = Path(folder) / "result.json"
    if not path.is_file():
        return None
    try:
        margin = json.loads(path.read_text("utf-8"))["margin"]
    except (ValueError, KeyError, TypeError, RecursionError):
        margin = None
    match margin:
        case [int(y), int(x)]:
            return y, x
    raise ValueError(f"{path} holds no margin; give --margin, or make the result anew")


def simulate(
    layers: Float[Tensor, "subframe layer c ly lx"], display: Display, margin: tuple[int, int]
) -> Float[Tensor, "view c y x"]:
    """Return the unclipped views that layers show, encoded as those in files are; see `mount`."""
    return display.transfer.encode(display(mount(layers, display, margin)))


def mount(
    layers: Float[Tensor, "subframe layer c ly lx"], display: Display, margin: tuple[int, int]
) -> Float[Tensor, "subframe layer c ly2 lx2"]:
    """Return the light of layers, with the margin of a display.

    Args:
        layers: encoded values, 0 to 1, front to back.
        display: what shows them.
        margin: pixels (y, x) by which they exceed the views on each side. Light paths that leave
            the layers go on unchanged: nothing is added, or multiplied.

    Raises:
        ValueError: not as many subframes or layers as the display has, or nothing left of the
            views.
    """
    for found, has, what in (
        (layers.shape[1], display.layer_count, "layer images"),
        (layers.shape[0], display.subframes, "subframes"),
    ):
        if found != has:
            raise ValueError(f"found {found} {what}, display '{display.name}' has {has}")
    size = [n - 2 * m for n, m in zip(layers.shape[-2:], margin, strict=True)]
    if min(margin) < 0 or min(size) < 1:
        raise ValueError(
            f"layers of {_size(layers)} with a margin of {margin[1]}x{margin[0]} px show no views; "
            "give a smaller --margin, 0 or more"
        )
    return display.surround(display.transfer.decode(layers), display.margin, margin)


def simulate_panels(
    pictures: Sequence[Float[Tensor, "subframe c _ _"]],
    display: Display,
    view_size: tuple[int, int],
) -> Float[Tensor, "view c y x"]:
    """Return the unclipped views that the pictures of panels show, encoded as those in files are.

    Args:
        pictures: values, 0 to 1, front to back.
        display: with panels.
        view_size: height and width of the views.

    Raises:
        ValueError: not as many pictures as panels, of another size, or smaller than the views.
    """
    return display.transfer.encode(views_through_panels(pictures, display, view_size))


def _pictures_in(folder: Path) -> list[list[Path]]:
    """Return the pictures of every subframe, front to back.

    Raises:
        ValueError: not as many in one subframe as in another.
    """
    places = [p for p in folder.glob("subframe_*") if p.is_dir()]
    places = sorted(places, key=_numbers) or [folder]
    found = [_numbered(place) for place in places]
    for place, pictures in zip(places, found, strict=True):
        if len(pictures) != len(found[0]):
            raise ValueError(
                f"found {len(pictures)} pictures in {place}, {len(found[0])} in {places[0]}; all "
                "subframes must have the same"
            )
    return found


def _numbers(path: Path) -> tuple[list[int], str]:
    return [int(n) for n in re.findall(r"\d+", path.stem)], path.name


def _numbered(folder: Path) -> list[Path]:
    images = [
        p
        for p in folder.iterdir()
        if p.suffix.lower() in SUFFIXES and not p.name.startswith(".") and not p.is_dir()
    ]
    return sorted(images, key=_numbers)


def _size(layer: Tensor) -> str:
    kind = "grey" if layer.shape[-3] == 1 else "in colour"
    return f"{layer.shape[-1]}x{layer.shape[-2]} px {kind}"
