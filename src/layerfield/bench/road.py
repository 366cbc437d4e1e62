"""The whole road that is timed: 8-bit views in memory to 8-bit layers in memory."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from layerfield.display import Display
from layerfield.light_field import LightField
from layerfield.panels import quantise
from layerfield.synthesizer import synthesize

BITS = 8


@dataclass(frozen=True, eq=False)
class EightBitViews:
    """Views as a decoder or a camera hands them over.

    Args:
        codes: 0 to 255, row by row from the top left.
        grid: (rows, columns) of the viewpoints.
        name: of the light field.
    """

    codes: UInt8[Tensor, "view c y x"]
    grid: tuple[int, int]
    name: str = "light field"

    @classmethod
    def of(cls, field: LightField, device: torch.device | str = "cpu") -> "EightBitViews":
        """Return the views of a light field, rounded to 8 bits where they were not."""
        return cls(quantise(field.views, BITS).to(device), field.grid, field.name)

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of a view in pixels."""
        return self.codes.shape[-2], self.codes.shape[-1]

    def light_field(self) -> LightField:
        """Return what methods take; 8-bit views stay such as far as a method lets them."""
        return LightField(self.codes, self.grid, name=self.name, bits=BITS)


@dataclass(frozen=True, eq=False)
class Panels:
    """The end of the road.

    Args:
        codes: 0 to 255, each pixel rounded by itself; with the margin of the display.
        layers: the same before rounding: light, 0 to 1.
    """

    codes: UInt8[Tensor, "subframe layer c ly lx"]
    layers: Float[Tensor, "subframe layer c ly lx"]


def views_to_panels(views: EightBitViews, display: Display, method: str, iterations: int) -> Panels:
    """Make the panels that show views: from 8 bits to 8 bits, everything between included.

    Resampling to panels with pixels of their own is the same for all methods and not part of it.

    Args:
        views: on the device where all is done.
        display: its object may be kept, and with it what a method keeps of its constants.
        method: as `synthesize` takes it.
        iterations: of the method; 0 for networks.

    Raises:
        ValueError: as `synthesize` does.
    """
    field = views.light_field()
    layers = synthesize(field, display, method=method, iterations=iterations).layers
    return Panels(quantise(layers, BITS, display.transfer), layers)
