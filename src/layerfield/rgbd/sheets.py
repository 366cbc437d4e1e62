"""A picture that stands in depth, and what is assumed to be behind its edges.

Disparity d is in pixels per unit of slope, larger is nearer, as the eye in the middle sees it (see
`scenes`): what it has at u another eye of slope s has at x = u - s d(u).
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

_BLURRED = 2  # pixels that edges of depth maps are blurred over, twice
_AROUND = [(y, x) for y in range(3) for x in range(3) if (y, x) != (1, 1)]


@dataclass(frozen=True, eq=False)
class Sheet:
    """A picture with the disparity of every pixel.

    Args:
        picture: values, 0 to 1.
        disparity: pixels per unit of slope.
        tear: neighbours are parts of one surface if their disparities differ by no more.
    """

    picture: Float[Tensor, "c y x"]
    disparity: Float[Tensor, "y x"]
    tear: float

    def nearest(self, at: Float[Tensor, "point 2"]) -> Float[Tensor, " point"]:
        """Return the disparity of the pixels nearest to points (x, y), in pixels from the centre.

        Outside the picture, those at its border.
        """
        column, row = self._indices(at).round().long().unbind(-1)
        return self.disparity.flatten()[self._flat(row, column)]

    def sample(
        self, at: Float[Tensor, "point 2"], disparity: Float[Tensor, " point"]
    ) -> tuple[Float[Tensor, "c point"], Float[Tensor, " point"]]:
        """Interpolate values and disparity between those neighbours that are of one surface.

        Args:
            at: points (x, y), in pixels from the centre.
            disparity: of the surface, roughly.

        Returns:
            Both; where none of the neighbours is of that surface, those of the nearest pixel.
        """
        place = self._indices(at)
        first = place.floor()
        share = place - first
        column, row = first.long().unbind(-1)
        total = torch.zeros_like(disparity)
        values = self.picture.new_zeros(len(self.picture), len(at))
        found = torch.zeros_like(disparity)
        for dy in (0, 1):
            for dx in (0, 1):
                index = self._flat(row + dy, column + dx)
                there = self.disparity.flatten()[index]
                weight = (share[:, 0] if dx else 1 - share[:, 0]) * (
                    share[:, 1] if dy else 1 - share[:, 1]
                )
                weight = weight * ((there - disparity).abs() <= self.tear)
                total += weight
                values += weight * self.picture.flatten(1)[:, index]
                found += weight * there
        index = self._flat(*place.round().long().flip(-1).unbind(-1))
        alone = total == 0
        total = total.masked_fill(alone, 1)
        return (
            torch.where(alone, self.picture.flatten(1)[:, index], values / total),
            torch.where(alone, self.disparity.flatten()[index], found / total),
        )

    def _indices(self, at: Float[Tensor, "point 2"]) -> Float[Tensor, "point 2"]:
        """Columns and rows of points, within the picture."""
        height, width = self.disparity.shape
        last = at.new_tensor([width - 1, height - 1])
        return (at + last / 2).clamp(min=0).minimum(last)

    def _flat(self, row: Int[Tensor, " point"], column: Int[Tensor, " point"]) -> Tensor:
        height, width = self.disparity.shape
        return row.clamp(0, height - 1) * width + column.clamp(0, width - 1)


def with_edges(disparity: Float[Tensor, "y x"], tear: float) -> Float[Tensor, "y x"]:
    """Return disparities that leap at edges, a pixel outside of what is in front.

    Depth maps are often blurred there, which would stretch a skin from the near surface to the far
    one. Pictures mix both within about a pixel, and such a mixture stays with what is in front.

    Args:
        disparity: as measured or estimated.
        tear: see `Sheet`.
    """
    for _ in range(2):
        near, far = _largest(disparity, _BLURRED), -_largest(-disparity, _BLURRED)
        nearer = near - disparity < disparity - far
        disparity = torch.where(near - far > tear, torch.where(nearer, near, far), disparity)
    near = _largest(disparity, 1)
    return torch.where(near > disparity + tear, near, disparity)


def beneath(sheet: Sheet, width: int) -> Sheet:
    """Return a sheet whose far surfaces go on beneath the near ones at their edges.

    Pixel by pixel inward from an edge, a pixel takes the mean of those neighbours that are next
    behind it, once.

    Args:
        sheet: what the eye in the middle sees.
        width: pixels to go on.
    """
    both = torch.cat([sheet.picture, sheet.disparity[None]])
    own = torch.ones_like(sheet.disparity, dtype=torch.bool)
    for _ in range(width):
        around = _neighbours(both)
        level = around[:, -1]
        behind = level < both[-1] - sheet.tear
        next_behind = level.where(behind, -math.inf).amax(0)
        taken = (behind & (level >= next_behind - sheet.tear))[:, None]
        mean = (around * taken).sum(0) / taken.sum(0).clamp(min=1)
        changed = own & behind.any(0)
        both = torch.where(changed, mean, both)
        own &= ~changed
    return Sheet(both[:-1], both[-1], sheet.tear)


def _largest(values: Float[Tensor, "y x"], reach: int) -> Float[Tensor, "y x"]:
    return functional.max_pool2d(values[None, None], 2 * reach + 1, 1, reach)[0, 0]


def _neighbours(planes: Float[Tensor, "c y x"]) -> Float[Tensor, "8 c y x"]:
    height, width = planes.shape[-2:]
    padded = functional.pad(planes[None], (1, 1, 1, 1), mode="replicate")[0]
    return torch.stack([padded[:, y : y + height, x : x + width] for y, x in _AROUND])
