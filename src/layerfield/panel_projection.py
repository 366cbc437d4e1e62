"""The linear map A from panels to views: where the light paths of a view meet each panel.

    (A Q)_i(x) = sum_k Q_k(M_k(m_ik x + d_ik))  linear interpolation between panel pixels

M_k is the homography from the pixels of layer k on its scaled grid to those of its panel. Outside a
panel there is no light; between its outermost pixels and that, values fade over one pixel.

Panels of several sizes share one tensor `[..., layer, c, y, x]`, each in the top left corner.
"""

from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import grid_sample

from layerfield.projection import Projection

Row = tuple[float, float, float]
Matrix = tuple[Row, Row, Row]

_LINEAR = _ZEROS = 0  # how PyTorch numbers interpolations and paddings


@dataclass(frozen=True)
class PanelProjection(Projection):
    """A for one set of shifts, through panels.

    Args:
        mappings: M, one a layer: (x, y, 1) of a layer pixel, margin included, to a panel pixel.
        sizes: height and width of every panel.
        views: height and width of the views.
        magnifications: `[view][layer]`, about the centre of the view; none: all are 1.
    """

    mappings: tuple[Matrix, ...]
    sizes: tuple[tuple[int, int], ...]
    views: tuple[int, int]
    magnifications: tuple[tuple[float, ...], ...] = ()

    @property
    def is_local(self) -> bool:
        return False

    @cached_property
    def is_whole(self) -> bool:
        return False

    def view_size(self, layers: Tensor) -> tuple[int, int]:
        return self.views

    def layer_size(self, views: Tensor) -> tuple[int, int]:
        heights, widths = zip(*self.sizes, strict=True)
        return max(heights), max(widths)

    def window(
        self, layer: Float[Tensor, "*batch ly lx"], view: int, index: int
    ) -> Float[Tensor, "*batch y x"]:
        return sampled(self._panel(layer, index), self._path(view, index), self.views)

    def scatter_(
        self, layer: Tensor, values: Tensor, view: int, index: int, factor: float = 1.0
    ) -> None:
        panel = self._panel(layer, index)
        spread = _spread(values, self._path(view, index), panel)
        panel.add_(spread, alpha=factor)

    def _panel(self, layer: Tensor, index: int) -> Tensor:
        height, width = self.sizes[index]
        return layer[..., :height, :width]

    def _path(self, view: int, index: int) -> Tensor:
        """The homography from the pixels of a view to those of a panel."""
        (x, y), (my, mx), (height, width) = self.shifts[view][index], self.margin, self.views
        m = self.magnifications[view][index] if self.magnifications else 1.0
        across, down = (width - 1) / 2, (height - 1) / 2
        on_layer = ((m, 0, (1 - m) * across + x + mx), (0, m, (1 - m) * down + y + my), (0, 0, 1))
        return as_matrix(self.mappings[index]) @ as_matrix(on_layer)


def sampled(
    picture: Float[Tensor, "*batch ly lx"],
    mapping: Float[Tensor, "3 3"],
    size: tuple[int, int],
) -> Float[Tensor, "*batch y x"]:
    """Return what a picture holds at the places that pixels are mapped to; outside it, zeros.

    Args:
        picture: to be interpolated.
        mapping: from the pixels (x, y, 1) of what is returned to those of the picture.
        size: height and width of what is returned.
    """
    planes = picture.reshape(1, -1, *picture.shape[-2:])
    places = _places(mapping, size, planes)
    found = grid_sample(planes, places, "bilinear", "zeros", align_corners=False)
    return found.reshape(*picture.shape[:-2], *size)


def _spread(values: Tensor, mapping: Tensor, like: Tensor) -> Tensor:
    """The adjoint of `sampled` with zeros outside: a picture of the shape of `like`."""
    full = values.expand(*like.shape[:-2], *values.shape[-2:])
    planes = full.reshape(1, -1, *values.shape[-2:]).contiguous()
    picture = planes.new_zeros(1, planes.shape[1], *like.shape[-2:])
    places = _places(mapping, (values.shape[-2], values.shape[-1]), picture)
    spread, _ = torch.ops.aten.grid_sampler_2d_backward(
        planes, picture, places, _LINEAR, _ZEROS, False, [True, False]
    )
    return spread.reshape(like.shape)


def _places(mapping: Tensor, size: tuple[int, int], picture: Tensor) -> Float[Tensor, "1 y x 2"]:
    """Where pixels are mapped to, as PyTorch counts: -1 to 1 from edge to edge of a picture."""
    height, width = picture.shape[-2:]
    counted = as_matrix(((2 / width, 0, 1 / width - 1), (0, 2 / height, 1 / height - 1), (0, 0, 1)))
    rows = (counted @ mapping).tolist()
    y = torch.arange(size[0], dtype=picture.dtype, device=picture.device)[:, None]
    x = torch.arange(size[1], dtype=picture.dtype, device=picture.device)
    across, down, scale = (a * x + (b * y + c) for a, b, c in rows)
    return torch.stack([across / scale, down / scale], dim=-1)[None]


def moved(x: float, y: float) -> Float[Tensor, "3 3"]:
    """Return the homography that moves pixels right and down."""
    return as_matrix(((1, 0, x), (0, 1, y), (0, 0, 1)))


def as_rows(matrix: Float[Tensor, "3 3"]) -> Matrix:
    """Return a homography as plain numbers."""
    first, second, third = ((a, b, c) for a, b, c in matrix.tolist())
    return first, second, third


def as_matrix(rows: Matrix) -> Float[Tensor, "3 3"]:
    """Return a homography in double precision, which pixels far from the corner need."""
    return torch.tensor(rows, dtype=torch.float64)
