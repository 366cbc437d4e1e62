"""What is to be solved: the layers, within bounds, whose views come nearest to given ones."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float, UInt16
from torch import Tensor

from layerfield.back_projection import back_projected, back_projected_words
from layerfield.composition import compose_view
from layerfield.display import Display
from layerfield.display_constants import DisplayConstants, constants_of
from layerfield.gram import Gram
from layerfield.grid_system import GridSystem
from layerfield.kept_views import KeptViews
from layerfield.kernels.codes import mean_of
from layerfield.kernels.compiled import serve
from layerfield.kernels.gpu.serving import on_gpu
from layerfield.kernels.light_paths import LightPaths
from layerfield.kernels.seen_words import light_of_words, words_of_light
from layerfield.kernels.starts import shared_start
from layerfield.links import Additive, Link
from layerfield.pieces import Piece, pieces
from layerfield.projection import Projection

_SEED = 0  # of what makes subframes differ
APART = 0.05  # how much they differ; on procedural scenes sweeps ended higher the less they did


@dataclass(frozen=True, eq=False)
class Problem:
    """Find layers within bounds that minimise sum_i w_i ||link_k (A_i P)_k - L_i||^2.

    Args:
        projection: A, from layers to views.
        link: what combines the layers.
        views: L, the views to be shown, as light; see `light`.
        weights: w, one for every view.
        bounds: the range of layer pixels.
        subframes: whose mean is seen.
        whole: constants of whole size, where this is at half size; see `half_size`.
    """

    projection: Projection
    link: Link
    views: KeptViews
    weights: tuple[float, ...]
    bounds: tuple[float, float] = (0.0, 1.0)
    subframes: int = 1
    whole: DisplayConstants | None = None

    @classmethod
    def of(
        cls, display: Display, target: Tensor | KeptViews, weights: Sequence[float] | None = None
    ) -> "Problem":
        """Pose the problem of showing views, as encoded in their files, on a display: in light.

        Raises:
            ValueError: not as many views or weights as viewpoints, or a negative weight.
        """
        count = display.view_count
        views = target if isinstance(target, KeptViews) else KeptViews(target)
        if views.stored.dtype in (torch.float16, torch.bfloat16):
            views = KeptViews(views.stored.float())  # there are no transforms of half precision
        if len(views) != count:
            raise ValueError(f"found {len(views)} views, display '{display.name}' expects {count}")
        chosen = tuple(float(w) for w in weights) if weights is not None else (1.0,) * count
        if len(chosen) != count or min(chosen) < 0 or not 0 < sum(chosen) < math.inf:
            raise ValueError(f"expected {count} view weights, at least 0 and not all 0")
        light = views.then(display.transfer.decode)
        return cls(display.projection, display.link, light, chosen, subframes=display.subframes)

    def in_sum_domain(self) -> "Problem":
        """Return the problem in the domain where the link is a sum (logarithms for a product)."""
        views = self.views.then(self.link.to_sum)
        return Problem(
            self.projection, Additive(), views, self.weights, bounds=self.link.sum_bounds
        )

    def pieces(self) -> Iterator[tuple["Problem", Piece]]:
        """Return the problem piece by piece, for what adds up view by view; see `Piece`."""
        for piece in pieces(self.projection, self.views, self.subframes):
            yield replace(self, views=piece.of_views(self.views)), piece

    def is_posed_as(self, other: "Problem") -> bool:
        """Whether but for what the views show, and how many there are at once, both are one."""

        def posed(problem: Problem) -> tuple:
            known = (problem.projection, problem.link, problem.weights, problem.bounds)
            return *known, problem.subframes, problem.layer_shape[-5:], problem.views.like.dtype

        return posed(self) == posed(other)

    def light(self, index: int) -> Float[Tensor, "*batch c y x"]:
        """Return what one view is to show."""
        return self.views.view(index)

    @cached_property
    def target(self) -> Float[Tensor, "*batch view c y x"]:
        """What all views are to show: floats, where `light` is sparing of memory."""
        return self.views.all()

    @property
    def device(self) -> torch.device:
        """Where the views are."""
        return self.views.stored.device

    @property
    def layer_shape(self) -> tuple[int, ...]:
        """Shape of the layers: *batch, subframe, layer, channel, y, x."""
        *batch, _, channels, _, _ = self.views.stored.shape
        size = self.projection.layer_size(self.views.stored)
        return (*batch, self.subframes, self.layer_count, channels, *size)

    @property
    def layer_count(self) -> int:
        """Number of layers."""
        return len(self.projection.shifts[0])

    @property
    def view_size(self) -> tuple[int, int]:
        """Height and width of the views."""
        return self.views.stored.shape[-2], self.views.stored.shape[-1]

    @cached_property
    def constants(self) -> DisplayConstants:
        """What problems posed alike have in common."""
        like = self.views.like
        kept = constants_of if self.whole is None else self.whole.of_half_size
        return kept(self.projection, self.weights, self.view_size, like.dtype, like.device)

    def grid(self, *, at_once: bool = False) -> GridSystem | None:
        """Return the normal equations of a grid, where solvers go by them instead of by the views.

        Light adds up, views stand in a grid and count alike; single precision, on a processor.

        Args:
            at_once: for all layers to move at once, see `grid_system`.
        """
        fits = self.views.like.dtype == torch.float32 and self.device.type == "cpu"
        if not fits or not isinstance(self.link, Additive) or self.subframes > 1:
            return None
        return self.constants.grid_at_once if at_once else self.constants.grid

    @property
    def gram(self) -> Gram:
        """A^T M W A, what a sum link makes of layers."""
        return self.constants.gram

    @cached_property
    def back_projected(self) -> Float[Tensor, "*batch 1 layer c ly lx"]:
        """A^T W L: all that a sum link needs to know of the views."""
        return back_projected(self.projection, self.views, self.weights).unsqueeze(-5)

    @cached_property
    def back_projected_words(self) -> UInt16[Tensor, "*batch 1 layer c ly words"]:
        """The same in 16-bit words, of views from 0 to 1 whose equations are words, too."""
        words = self.constants.words
        assert words is not None
        if "back_projected" in vars(self):
            return words_of_light(self.back_projected, words)
        given = self.projection, self.views, self.weights
        return back_projected_words(*given, words).unsqueeze(-5)

    @cached_property
    def rest_of_words(self) -> Float[np.ndarray, "item c"]:
        """What `even_shares` has for pixels that nobody sees, by those words."""
        words = self.constants.words
        assert words is not None
        light = light_of_words(self.back_projected_words, self.layer_shape[-1])
        return light * (words.weight / words.most * self.constants.mean_share)

    @property
    def light_paths(self) -> LightPaths:
        """From the layers to the views."""
        return LightPaths(self.projection, self.link, self.views, self.weights)

    @property
    def coverage(self) -> Float[Tensor, "layer 1 ly lx"]:
        """A^T W 1: the weight of the views that see a layer pixel; 0 where nobody looks."""
        return self.constants.coverage

    def view(
        self, layers: Float[Tensor, "*batch subframe layer c ly lx"], index: int
    ) -> Float[Tensor, "*batch c y x"]:
        """Return what one view shows of layers, unclipped."""
        return compose_view(layers, self.projection, self.link, index)

    def mean_square_error(self, layers: Float[Tensor, "*batch subframe layer c ly lx"]) -> float:
        """Return the weighted mean square error of unclipped views, pooled over all pixels."""
        total = 0.0
        for i, weight in enumerate(self.weights):
            residual = self.view(layers, i) - self.light(i)
            total += weight * residual.double().square().mean().item()
        return total / sum(self.weights)

    @cached_property
    def even_shares(
        self,
    ) -> tuple[Float[Tensor, "layer 1 ly lx"], Float[Tensor, "*batch 1 1 c 1 1"]]:
        """What A^T W L is multiplied by for the balanced start, and what is taken where that is 0.

        The mean of the views is that of the first layer's light over its coverage.
        """
        first = self.back_projected[..., :1, :, :, :]
        rest = first.sum(dim=(-2, -1), keepdim=True) * self.constants.mean_share
        return self.constants.even_shares, rest

    def even_start(
        self, size: tuple[int, int] | None = None, *, rim: bool = False
    ) -> Float[Tensor, "*batch 1 layer c ty tx"]:
        """Return the balanced start: every layer shows what its viewers see on average, shared.

        z_k = A_k^T W L / (A_k^T W 1) / K. Pixels that nobody sees take the mean of the
        views over K.

        Args:
            size: of a torus, on which the layers are, and 0 beside them.
            rim: no more is needed than what the band depends on, see `Gram`. On a GPU other
                pixels are then what was in memory.
        """
        shares, rest = self.even_shares
        height, width = self.layer_shape[-2:]
        ty, tx = size or (height, width)
        if on_gpu(self.back_projected):
            from layerfield.kernels.gpu.blends import even_start  # noqa: PLC0415  needs Triton

            (rows, columns), (my, mx) = self.view_size, self.projection.margin
            # No path meets those pixels that ends beside a view.
            spared = (2 * my, rows, 2 * mx, columns) if rim else (0, 0, 0, 0)
            return even_start(self.back_projected, shares, rest, (ty, tx), spared)
        if serve(self.back_projected):
            return shared_start(self.back_projected, shares, rest, (ty, tx))
        start = torch.where(shares > 0, self.back_projected * shares, rest)
        return torch.nn.functional.pad(start, (0, tx - width, 0, ty - height))

    def flat_start(self, apart: float = APART) -> Float[Tensor, "*batch subframe layer c ly lx"]:
        """Return the classical start: constant layers that together show the mean of the views.

        Subframes differ by random factors, 1 - apart to 1 + apart.
        """
        mean = _mean_of(self.views.then(self.link.to_sum)) / self.layer_count
        *batch, _, layers, channels, height, width = self.layer_shape
        shape = (*batch, 1, layers, channels, height, width)
        start = self.link.from_sum(mean)[(..., *[None] * 5)].expand(shape)
        return self.in_subframes(start.clamp(*self.bounds).clone(), apart)

    def in_subframes(
        self, layers: Float[Tensor, "*batch 1 layer c ly lx"], apart: float = APART
    ) -> Float[Tensor, "*batch subframe layer c ly lx"]:
        """Return a start for all subframes from one for a single one.

        Equal subframes would stay equal, so pixels are multiplied by random factors, 1 - apart to
        1 + apart, which depend on the size of the layers alone.
        """
        if self.subframes == 1:
            return layers
        generator = torch.Generator().manual_seed(_SEED)
        shape = (self.subframes, *layers.shape[-4:])
        factors = 1 + apart * (2 * torch.rand(shape, generator=generator).to(layers) - 1)
        return (layers * factors).clamp(*self.bounds)


def _mean_of(views: KeptViews) -> Float[Tensor, "*batch"]:
    if views.is_whole and serve(views.levels):
        return mean_of(views.stored, views.levels).to(views.levels)
    return views.mean()
