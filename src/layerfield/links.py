"""How a light path combines the pixels of the layers that it meets.

Each link is one class. It composes what a view sees, differentiates that by one layer, and names
the domain in which it is (or nearly is) a sum, where the direct solver works:

    additive        L = sum_k P_k
    multiplicative  L = prod_k P_k,               log L = sum_k log P_k
    polarisation    L = sin^2(pi/2 sum_k P_k),    2/pi arcsin sqrt(L) = sum_k P_k
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add, mul
from typing import Protocol, runtime_checkable

import torch
from torch import Tensor


@runtime_checkable
class Link(Protocol):
    """The combination law of a display."""

    @property
    def name(self) -> str:
        """What display files call it."""
        ...

    @property
    def neutral(self) -> float:
        """The pixel value that leaves a light path as it is; it surrounds the layers."""
        ...

    @property
    def is_sum(self) -> bool:
        """Whether pixels add up as they are, so that views are linear in the layers."""
        ...

    @property
    def sum_bounds(self) -> tuple[float, float]:
        """The range of a layer in the domain where the link is a sum."""
        ...

    @property
    def steepest(self) -> float:
        """The largest derivative by a pixel; pixels are within their range."""
        ...

    @property
    def bend(self) -> float:
        """The largest second derivative by a pixel."""
        ...

    def compose(self, pixels: Sequence[Tensor]) -> Tensor:
        """Return the light of paths that meet these pixels, one tensor a layer."""
        ...

    def derivative(self, pixels: Sequence[Tensor], layer: int) -> Tensor:
        """Return the derivative of `compose` by the pixels of one layer."""
        ...

    def to_sum(self, values: Tensor) -> Tensor:
        """Bring views (or layers) into the domain where the link is a sum."""
        ...

    def from_sum(self, values: Tensor) -> Tensor:
        """Bring layers back from the domain where the link is a sum."""
        ...


@dataclass(frozen=True)
class Additive:
    """L = sum_k P_k: layers that emit or scatter light."""

    name: str = "additive"
    neutral: float = 0.0
    is_sum: bool = True
    sum_bounds: tuple[float, float] = (0.0, 1.0)
    steepest: float = 1.0
    bend: float = 0.0

    def compose(self, pixels: Sequence[Tensor]) -> Tensor:
        return reduce(add, pixels)

    def derivative(self, pixels: Sequence[Tensor], layer: int) -> Tensor:
        return torch.ones_like(pixels[layer])

    def to_sum(self, values: Tensor) -> Tensor:
        return values

    def from_sum(self, values: Tensor) -> Tensor:
        return values


@dataclass(frozen=True)
class Multiplicative:
    """L = prod_k P_k: layers that attenuate a white backlight."""

    name: str = "multiplicative"
    neutral: float = 1.0
    is_sum: bool = False
    sum_bounds: tuple[float, float] = (-float("inf"), 0.0)
    steepest: float = 1.0
    bend: float = 0.0
    darkest: float = 0.1  # darker values would dominate least squares on logarithms

    def compose(self, pixels: Sequence[Tensor]) -> Tensor:
        return reduce(mul, pixels)

    def derivative(self, pixels: Sequence[Tensor], layer: int) -> Tensor:
        others = [p for k, p in enumerate(pixels) if k != layer]
        return reduce(mul, others) if others else torch.ones_like(pixels[layer])

    def to_sum(self, values: Tensor) -> Tensor:
        return values.clamp(min=self.darkest).log()

    def from_sum(self, values: Tensor) -> Tensor:
        return values.exp()


@dataclass(frozen=True)
class Polarisation:
    """L = sin^2(pi/2 sum_k P_k): layers that turn polarised light between crossed polarisers.

    A pixel of 1 turns it by a right angle, from dark to bright.

    Reference: Lanman et al., "Polarization fields", ACM Trans. Graphics 30(6), 2011.
    """

    name: str = "polarisation"
    neutral: float = 0.0
    is_sum: bool = False
    sum_bounds: tuple[float, float] = (0.0, 1.0)
    steepest: float = math.pi / 2
    bend: float = math.pi**2 / 2

    def compose(self, pixels: Sequence[Tensor]) -> Tensor:
        return _turned(pixels).sin().square()

    def derivative(self, pixels: Sequence[Tensor], layer: int) -> Tensor:
        return (2 * _turned(pixels)).sin() * (math.pi / 2)

    def to_sum(self, values: Tensor) -> Tensor:
        return values.clamp(0, 1).sqrt().asin() * (2 / math.pi)

    def from_sum(self, values: Tensor) -> Tensor:
        return values


def _turned(pixels: Sequence[Tensor]) -> Tensor:
    """The angle by which light paths are turned, radians."""
    return reduce(add, pixels) * (math.pi / 2)


LINKS: dict[str, Link] = {
    link.name: link for link in (Additive(), Multiplicative(), Polarisation())
}
