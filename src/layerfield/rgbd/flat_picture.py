"""A picture with its depth map, put into the depth of a display."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from torch import Tensor

from layerfield.display import Display
from layerfield.geometry import Geometry
from layerfield.rendering.placement import Fit, depth_range, view_step
from layerfield.rgbd.sheets import Sheet, beneath, with_edges
from layerfield.rgbd.warping import view

_PARTED = 1.0  # px between neighbours in the outermost view, above which a surface is torn


@dataclass(frozen=True, eq=False)
class PictureWithDepth:
    """What the eye in the middle of the viewpoints sees, and how far it is.

    Args:
        picture: values, 0 to 1.
        disparity: pixels per unit of slope, see `sheets`.
        geometry: of the viewpoints.
    """

    picture: Float[Tensor, "c y x"]
    disparity: Float[Tensor, "y x"]
    geometry: Geometry

    def views(self) -> Iterator[Float[Tensor, "c y x"]]:
        """Return the views in turn, as if the picture and what it hides were all there is.

        What it hides goes on from what is visible beside it, farther away; what is outside, from
        its border.
        """
        slopes, approaches = self.geometry.slopes, self.geometry.approaches
        half = max(self.disparity.shape) / 2
        reach = max(
            math.hypot(*slope) + abs(approach) * half
            for slope, approach in zip(slopes, approaches, strict=True)
        )
        tear = _PARTED / max(reach, 1e-9)
        front = Sheet(self.picture, with_edges(self.disparity, tear), tear)
        span = (self.disparity.max() - self.disparity.min()).item()
        back = beneath(front, math.ceil(reach * span) + 2)
        for slope, approach in zip(slopes, approaches, strict=True):
            yield view(front, back, slope, approach)

    @property
    def disparities(self) -> tuple[float, float]:
        """The lowest and the highest, in pixels between neighbouring views."""
        low, high = self.disparity.min().item(), self.disparity.max().item()
        return low * view_step(self.geometry), high * view_step(self.geometry)


def place_picture(
    picture: Float[Tensor, "c y x"], nearness: Float[Tensor, "y x"], display: Display, fit: Fit
) -> PictureWithDepth:
    """Put a picture into the depth of a display, the nearest pixel at its front layer.

    The farthest is at the back layer; disparities between are linear in nearness.

    Args:
        picture: values, 0 to 1.
        nearness: 0 to 1, see `read_depth_map`.
        display: that is to show it.
        fit: `depth` matters.

    Raises:
        ValueError: as `depth_range` does.
    """
    geometry = display.geometry
    mean = float(np.mean([1 / distance for distance in geometry.distances]))
    near, far = (z / (1 - z * mean) / geometry.pitch for z in depth_range(display, fit))
    return PictureWithDepth(picture, far + nearness * (near - far), geometry)
