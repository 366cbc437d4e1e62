"""What depends on a display and the size of its views alone, kept for the next light field."""

from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from layerfield.gram import Gram
from layerfield.grid_system import GridSystem, grid_system
from layerfield.kernels.row_products import RowPaths, paths_of
from layerfield.kernels.row_steps import RowMatrix, matrix_of
from layerfield.kernels.words import Words, words_of
from layerfield.projection import Projection
from layerfield.row_system import row_entries

_KEPT = 4  # displays; more would rather fill the memory than save time


@dataclass(frozen=True)
class DisplayConstants:
    """Each is found when it is first asked for, and not to be written on.

    Args:
        projection: A.
        weights: W, one for every view.
        view_size: height and width of the views.
        dtype: of what is found.
        device: where it is.
    """

    projection: Projection
    weights: tuple[float, ...]
    view_size: tuple[int, int]
    dtype: torch.dtype
    device: torch.device
    _smaller: dict[tuple[Any, ...], "DisplayConstants"] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def of_half_size(self, *given: Any) -> "DisplayConstants":
        """Return those of half size, kept as long as these; arguments as of `DisplayConstants`."""
        return self._smaller.setdefault(given, DisplayConstants(*given))

    @cached_property
    def gram(self) -> Gram:
        """A^T M W A."""
        with torch.inference_mode(False):  # what is kept must serve training, too
            like = torch.empty(0, dtype=self.dtype, device=self.device)
            return Gram(self.projection, self.weights, self.view_size, like)

    @cached_property
    def coverage(self) -> Float[Tensor, "layer 1 ly lx"]:
        """A^T W 1, the weight of the views that see a layer pixel; 0 where nobody looks."""
        with torch.inference_mode(False):
            ones = torch.ones(1, *self.view_size, dtype=self.dtype, device=self.device)
            count, size = len(self.projection.shifts[0]), self.projection.layer_size(ones)
            layers = ones.new_zeros(count, 1, *size)
            for i, weight in enumerate(self.weights):
                for k, layer in enumerate(layers):
                    self.projection.scatter_(layer, ones, i, k, weight)
            return layers

    @cached_property
    def even_shares(self) -> Float[Tensor, "layer 1 ly lx"]:
        """What A^T W L is multiplied by for the balanced start, 1 / (K A^T W 1).

        Where nobody looks that is 0.
        """
        with torch.inference_mode(False):
            coverage = self.coverage
            shares = 1 / (len(coverage) * coverage.clamp(min=1e-6 * sum(self.weights)))
            return shares.masked_fill_(coverage <= 0, 0)

    @cached_property
    def mean_share(self) -> float:
        """What the light of all pixels of one layer, A^T W L, is multiplied by for their mean."""
        return 1 / (len(self.coverage) * self.coverage[0].sum().item())

    @cached_property
    def row_entries(self) -> Float64[np.ndarray, "unknown ahead"]:
        """A^T M W A of a row of pixels, see `row_entries`; where views stand in a row."""
        return row_entries(self.projection, self.weights, self.view_size[1])

    @cached_property
    def row_matrix(self) -> RowMatrix:
        """The same for compiled loops."""
        return matrix_of(self.row_entries)

    @cached_property
    def row_paths(self) -> RowPaths:
        """The light paths of a row of pixels; where views stand in a row, of whole pixels."""
        return paths_of(self.projection, self.weights, self.view_size[1])

    @cached_property
    def grid(self) -> GridSystem | None:
        """A^T M W A of views in a grid, as what acts on rows times what acts on columns."""
        return grid_system(self.projection, self.weights, self.view_size)

    @cached_property
    def grid_at_once(self) -> GridSystem | None:
        """The same for all layers to move at once; see `grid_system`."""
        return grid_system(self.projection, self.weights, self.view_size, at_once=True)

    @cached_property
    def words(self) -> Words | None:
        """The same in 16-bit words, where that is as fine as panels are."""
        return None if self.grid is None else words_of(self.grid, self.weights[0])


@lru_cache(maxsize=_KEPT)
def constants_of(
    projection: Projection,
    weights: tuple[float, ...],
    view_size: tuple[int, int],
    dtype: torch.dtype,
    device: torch.device,
) -> DisplayConstants:
    """Return the same constants as long as they are kept; arguments as of `DisplayConstants`."""
    return DisplayConstants(projection, weights, view_size, dtype, device)
