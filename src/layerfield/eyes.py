"""Eyes anywhere in front of a display, as users name them, and what they see."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.display import Display
from layerfield.geometry import Point
from layerfield.io import write_png
from layerfield.panels import quantise

_FARTHEST = 1e6  # a kilometre; farther eyes come from mistaken units


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
