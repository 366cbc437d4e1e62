"""Eyes anywhere in front of a display, as users name them, and what they see."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.between import positions_between
from layerfield.display import Display
from layerfield.geometry import Point
from layerfield.io import write_png
from layerfield.light_field import EyeViews
from layerfield.metrics import decibels, finite, mean_square_error
from layerfield.panels import quantise

_FARTHEST = 1e6  # a kilometre; farther eyes come from mistaken units
_MOST_EYES = 1000


@dataclass(frozen=True)
class Eye:
    """Where an eye is, as `Display.look` takes it.

    Args:
        slope: (X / Z, Y / Z); in view steps for displays in pixel disparities.
        distance: Z in metres (see `Geometry`); None: as far as the viewpoints.
    """

    slope: Point
    distance: float | None = None

    @classmethod
    def parse(cls, text: str, display: Display) -> "Eye":
        """Parse `X,Y` or `X,Y,Z` in the units of the display's file.

        Millimetres for physical displays. For those in pixel disparities X and Y count view steps,
        and Z is how many pixels neighbouring viewpoints are apart at the distance of the eye.

        Raises:
            ValueError: not two or three numbers, or an eye at or behind a layer.
        """
        try:
            position = [float(part) for part in text.split(",")]
        except ValueError:
            position = []
        if len(position) not in (2, 3) or not all(abs(number) <= _FARTHEST for number in position):
            raise ValueError(
                f"eye is '{text}', expected X,Y or X,Y,Z, numbers up to {_FARTHEST:.0f}, such as "
                "30,0,450"
            )
        return cls(*display.spec.eye(position))


def eyes_in_line(display: Display, count: int) -> list[Eye]:
    """Return eyes side by side, evenly from the leftmost viewpoint of a display to the rightmost.

    At half the height of the view grid; a single eye is in the middle.

    Raises:
        ValueError: the viewpoints form no grid, or there are too many eyes.
    """
    if count > _MOST_EYES:
        raise ValueError(f"found {count} eyes side by side, expected at most {_MOST_EYES}")
    _, columns = display.geometry.grid or (1, 1)
    step = (columns - 1) / max(count - 1, 1)
    places = ((i - (count - 1) / 2) * step for i in range(count))
    return [Eye(display.geometry.slope_at((x, 0.0))) for x in places]


def look(
    layers: Float[Tensor, "1 layer c ly lx"], display: Display, eyes: Sequence[Eye]
) -> Float[Tensor, "eye c y x"]:
    """Return what every eye sees of layers, unclipped."""
    return torch.stack([display.look(layers, eye.slope, eye.distance) for eye in eyes])


def write_eyes(folder: Path, views: Float[Tensor, "eye c y x"], bits: int) -> None:
    """Write what eyes see as `eye_00.png`, `eye_01.png` ..., clipped to 0..1."""
    folder.mkdir()
    for i, view in enumerate(quantise(views.clamp(0, 1), bits)):
        write_png(folder / f"eye_{i:02d}.png", view.cpu())


class EyeFigure(NamedTuple):
    """What one eye sees.

    Args:
        x: its position in view steps from the centre of the view grid,
        y: the same, downward.
        psnr: dB; None if it sees exactly what it should.
    """

    x: float
    y: float
    psnr: float | None


@dataclass(frozen=True)
class EyeFigures:
    """How well eyes in and around a view grid are served.

    Args:
        psnr_between: of all eyes within the grid that are at no viewpoint, one error pooled, dB;
            None where the light field has no such views, or all is exact.
        by_eye: of every eye, row by row.
    """

    psnr_between: float | None
    by_eye: tuple[EyeFigure, ...]


def judge_eyes(
    layers: Float[Tensor, "subframe layer c ly lx"],
    display: Display,
    around: EyeViews,
) -> EyeFigures:
    """Compare what eyes see of layers with what they should see.

    Args:
        layers: light, 0 to 1, with the margin of the display.
        display: one with a view grid.
        around: what eyes in and around that grid should see.
    """
    errors = {}
    for position, view in zip(around.positions, around.views, strict=True):
        light = display.look(layers, display.geometry.slope_at(position))
        seen = display.transfer.encode(light)
        errors[position] = mean_square_error(seen, view)
    between = [errors[eye] for eye in positions_between(around.positions, display.geometry.grid)]
    pooled = sum(between) / len(between) if between else 0.0
    by_eye = tuple(EyeFigure(x, y, finite(decibels(error))) for (x, y), error in errors.items())
    return EyeFigures(finite(decibels(pooled)), by_eye)
