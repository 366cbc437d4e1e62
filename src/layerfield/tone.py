"""Errors measured on encoded values: least squares in light gives away the dark tones.

The link is followed by the encoding, so that solvers which follow the derivative of a link, as
sweeps do, minimise what viewers and the papers' PSNR see, without knowing of it (Gauss-Newton):

    sum_i w_i ||encode(link_k (A_i P)_k) - encode(L_i)||^2
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from layerfield.links import Link
from layerfield.problem import Problem
from layerfield.transfer import Transfer

_STEP = 1e-3  # of light, over which the slope of an encoding is taken: steep ones end there


@dataclass(frozen=True)
class EncodedLink:
    """A link whose light is looked at as values.

    Args:
        link: what the display does.
        transfer: between the light and the values.
    """

    link: Link
    transfer: Transfer
    is_sum: bool = False

    @property
    def name(self) -> str:
        return f"{self.link.name}, encoded"

    @property
    def neutral(self) -> float:
        return self.link.neutral

    @property
    def steepest(self) -> float:
        return self.link.steepest * self._slope(torch.zeros(())).item()

    @property
    def bend(self) -> float:
        return self.link.bend

    @property
    def sum_bounds(self) -> tuple[float, float]:
        return self.link.sum_bounds

    def compose(self, pixels: Sequence[Tensor]) -> Tensor:
        return self.transfer.encode(self.link.compose(pixels))

    def derivative(self, pixels: Sequence[Tensor], layer: int) -> Tensor:
        return self._slope(self.link.compose(pixels)) * self.link.derivative(pixels, layer)

    def _slope(self, light: Tensor) -> Tensor:
        """The slope of the encoding, which is the steepest in the dark."""
        around = light.clamp(min=_STEP)
        rise = self.transfer.encode(around + _STEP) - self.transfer.encode(around - _STEP)
        return rise / (2 * _STEP)

    def to_sum(self, values: Tensor) -> Tensor:
        return self.link.to_sum(self.transfer.decode(values))

    def from_sum(self, values: Tensor) -> Tensor:
        return self.link.from_sum(values)


def on_values(problem: Problem, transfer: Transfer) -> Problem:
    """Return a problem, posed in light, with its errors measured on encoded values."""
    views = problem.views.then(transfer.encode)
    return replace(problem, link=EncodedLink(problem.link, transfer), views=views)
