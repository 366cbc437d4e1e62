"""Layer by layer least squares, for any link."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.grid_system import GridSystem
from layerfield.kernels import grid_sweeps, product_sweeps, sweep_passes
from layerfield.kernels.compiled import serve
from layerfield.kernels.light_paths import Shares
from layerfield.kernels.product_sweeps import ProductSweeps
from layerfield.links import Multiplicative
from layerfield.problem import Problem

_LEFT = Shares(shown=-1, light=1)  # what is to be shown, less what is
_PASSES = 3  # through several subframes of a layer in a step; they cost nothing per view


@dataclass(frozen=True, eq=False)
class SweepsState:
    """Layers after the last sweep and the one before, the next push, the sweeps since a restart.

    The next sweep begins at clamp(layers + push (layers - last)). There are a push and a count for
    every light field of a batch, where the layers are: to look at them would be to wait for a GPU.
    """

    layers: Float[Tensor, "*batch subframe layer c ly lx"]
    last: Float[Tensor, "*batch subframe layer c ly lx"]
    push: Float[Tensor, "*batch 1 1 1 1 1"]
    count: Float[Tensor, "*batch 1 1 1 1 1"]


@dataclass(frozen=True)
class Sweeps:
    """Sweep over the layers; each step is a least-squares solve of one layer per pixel.

        P_k <- clamp(P_k + A_k^T W o (L - link(P)) / A_k^T W o^2 A_k 1)

    with o the derivative of the link by the layer (for a product, the other layers along the
    path). Exact for whole-pixel shifts and links linear in each layer, descending for fractional
    shifts, where the denominator majorises. For other links it is damped by the residual times
    the largest second derivative. With subframes, o is a vector, o^2 a small matrix, and each
    step goes a few times through the subframes. Pixels that influence nothing stay. Inner layers
    come first where light is multiplied, otherwise layers in the order of their depth. From the
    third sweep on, the start of a sweep is extrapolated along the last change, unless that led
    uphill.

    Args:
        momentum: the largest extrapolation, as a share of the last change; 0 for plain sweeps.
        sweeps: of a step.
        exact: whether pixels that shine through others keep single precision on a GPU, too; ten
            bits are enough to show, but not to compare with.
    """

    momentum: float = 0.9
    sweeps: int = 1
    exact: bool = False

    def init(self, problem: Problem, start: SweepsState | Tensor | None) -> SweepsState:
        if isinstance(start, SweepsState):
            return start
        layers = problem.flat_start() if start is None else start
        none = layers.new_zeros(*layers.shape[:-5], 1, 1, 1, 1, 1)
        return SweepsState(layers, layers, none, none)

    def step(self, problem: Problem, state: SweepsState) -> SweepsState:
        return self.steps(problem, state, 1)

    def steps(self, problem: Problem, state: SweepsState, count: int) -> SweepsState:
        paths = problem.light_paths
        if product_sweeps.serves(paths, state.layers):
            along = ProductSweeps.along(paths, problem.bounds, self.momentum)
            known = state.layers, state.last, state.push, state.count
            return SweepsState(*along(*known, sweeps=self.sweeps * count))
        for _ in range(self.sweeps * count):
            layers, uphill = _swept(problem, state, exact=self.exact)
            number = torch.where(uphill, 1, state.count + 1)
            push = (2 * (number - 1) / (number + 2)).clamp(max=self.momentum)
            state = SweepsState(layers, state.layers, push, number)
        return state

    def layers(
        self, problem: Problem, state: SweepsState
    ) -> Float[Tensor, "*batch subframe layer c ly lx"]:
        return state.layers


def _swept(problem: Problem, state: SweepsState, *, exact: bool) -> tuple[Tensor, Tensor]:
    """Return layers after a sweep, and whether it went back: (A - P) (P - last P) above 0.

    A is where it began.
    """
    given, paths = (state.layers, state.last, state.push), problem.light_paths
    if not exact and sweep_passes.serve_colours(paths, state.layers, problem.bounds):
        return sweep_passes.swept_colours(paths, *given)
    ahead = sweep_passes.ahead(*given, problem.bounds)
    if (grid := problem.grid()) is not None and state.layers.is_contiguous():
        seen = problem.back_projected
        if serve(seen, ahead, state.layers):
            return grid_sweeps.swept_(grid, seen, ahead, state.layers, problem.bounds)
    layers = ahead.clone()
    if _are_served(problem, layers, state.layers) and serve(layers):
        slope, curvature = (layers.new_empty(layers[..., :1, :, :, :].shape) for _ in range(2))
        for k in _order(problem):
            paths.add_up_(slope, layers, shares=_LEFT, second=curvature, only=k)
            sweep_passes.move_layer_(layers, k, slope, curvature, problem.bounds)
    else:
        for k in _order(problem):
            layers[..., k, :, :, :] = best_layer(problem, layers, k)
    return layers, sweep_passes.leads_uphill(ahead, layers, state.layers)


def _order(problem: Problem) -> Sequence[int]:
    """Return layers in the order in which they are swept.

    Where light adds up, inner ones first are no better from a flat start: of five photographed
    light fields four were worse after five to twenty sweeps, of six procedural ones none.
    """
    is_product = isinstance(problem.link, Multiplicative)
    return problem.projection.inner_first if is_product else range(problem.layer_count)


def best_layer(
    problem: Problem, layers: Float[Tensor, "*batch subframe layer c ly lx"], index: int
) -> Float[Tensor, "*batch subframe c ly lx"]:
    """Return one layer, in all subframes, that minimises the (majorised) error per pixel."""
    if (grid := problem.grid()) is not None:
        return _best_of_grid(problem, grid, layers, index)
    best = layers[..., index, :, :, :].clone()
    slope, curvature = _normal_equations(problem, layers, index)
    subframes = range(best.shape[-4])
    if len(subframes) == 1:
        return (best + _step(slope[0], curvature[0][0]).unsqueeze(-4)).clamp(*problem.bounds)
    for _ in range(_PASSES):
        for s in subframes:
            pixels = best[..., s, :, :, :]
            step = _step(slope[s], curvature[s][s])
            moved = (pixels + step).clamp_(*problem.bounds).sub_(pixels)
            pixels.add_(moved)
            for t in subframes:
                slope[t].addcmul_(curvature[s][t], moved, value=-1)
    return best


def _best_of_grid(problem: Problem, grid: GridSystem, layers: Tensor, index: int) -> Tensor:
    """Return `best_layer` by the normal equations."""
    seen = problem.back_projected
    if serve(layers, seen) and layers.is_contiguous() and seen.is_contiguous():
        return grid_sweeps.best_layer(grid, seen, layers, index, problem.bounds)
    return grid.settled(layers, seen, index).clamp(*problem.bounds)


def _are_served(problem: Problem, *layers: Tensor) -> bool:
    """Whether compiled loops find normal equations, and go by them."""
    paths = problem.light_paths
    return not problem.link.bend and all(
        each.is_contiguous() and paths.serve(each) for each in layers
    )


def _step(slope: Tensor, curvature: Tensor) -> Tensor:
    """Pixels that influence nothing stay."""
    return torch.where(curvature > 0, slope / curvature.clamp(min=1e-12), 0)


def _normal_equations(
    problem: Problem, layers: Tensor, index: int
) -> tuple[list[Tensor], list[list[Tensor]]]:
    """Return A_k^T W o (L - link(P)), by subframe, and A_k^T W o o^T A_k 1 with its damping."""
    projection, link, count = problem.projection, problem.link, layers.shape[-5]
    if _are_served(problem, layers):
        first, second = (layers.new_empty(layers[..., :1, :, :, :].shape) for _ in range(2))
        problem.light_paths.add_up_(first, layers, shares=_LEFT, second=second, only=index)
        return [first[..., 0, 0, :, :, :]], [[second[..., 0, 0, :, :, :]]]
    empty = layers[..., 0, index, :, :, :]
    slope = [torch.zeros_like(empty) for _ in range(count)]
    curvature = [[torch.zeros_like(empty) for _ in range(s + 1)] for s in range(count)]
    for alone, piece in problem.pieces():
        seen = piece.of_layers(layers)
        for i, weight in enumerate(problem.weights):
            if weight == 0:
                continue
            pixels = projection.windows(seen, i)
            others = link.derivative(pixels, index).unbind(dim=-4)
            residual = alone.light(i) - link.compose(pixels).mean(dim=-4)
            for s in range(count):
                part, share = piece.of_layers(slope[s]), weight / count
                projection.scatter_product_(part, others[s], residual, i, index, share)
                for t in range(s + 1):
                    part = piece.of_layers(curvature[s][t])
                    projection.scatter_product_(part, others[s], others[t], i, index, share / count)
                    if s == t and link.bend:
                        damping = residual.abs()
                        projection.scatter_(part, damping, i, index, share * link.bend)
    return slope, [[curvature[max(s, t)][min(s, t)] for t in range(count)] for s in range(count)]
