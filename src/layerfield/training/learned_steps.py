"""Learned steps of the direct solver as a differentiable formula: what `learned_admm` runs fast.

The band around the views and the solving in the Fourier domain are linear, so that their
derivatives are themselves once more; the rest is left to autograd.
"""

import math
from itertools import pairwise
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from layerfield.fast import StepConstants
from layerfield.frequencies import (
    Matrix,
    Spectral,
    interleaved,
    low_part,
    multiply,
    replace_low_part_,
    resolvent,
)
from layerfield.gram import Gram
from layerfield.kernels.cells import SIGNS
from layerfield.problem import Problem
from layerfield.projection import sum_of
from layerfield.solvers.admm_steps import OVERRELAXED, Constants, stride
from layerfield.solvers.fourier_admm import dual_at_bounds
from layerfield.solvers.learned_admm import BALANCE, SOFTEST, coarse_grid
from layerfield.solvers.newton_admm import renews_scale, scale_of
from layerfield.solvers.relief import Relief
from layerfield.solvers.slope import slope

_FIRST = {"penalty": math.log(0.02), "relaxation": 1.6, "trust": 1.0, "kept": 0.6, "momentum": 0.0}
_MOMENTUM = Constants._fields.index("momentum")
_LAST_PENALTY = math.log(0.1)
_FIRST_NEWTON = [math.log(0.4), 1.0, 1.0, 1.0, 0.0]


class LearnedSteps(nn.Module):
    """Constants of steps, to be learned; see `LearnedAdmm` and `NewtonAdmm` for the formulas.

    Args:
        full: number of steps.
        coarse: number of steps on large pixels.
        newton: number of steps behind them, on light that is multiplied.
        relief: channels of the network behind the first of several steps; none if 0.

    Attributes:
        full: a row for every step, in the order of `Constants`; the logarithm of the penalty.
        coarse: the same; of the penalty above its least.
        newton: as `full`.
        relief: the tensors of a `Relief`.
    """

    def __init__(self, full: int, coarse: int, newton: int = 0, relief: int = 0) -> None:
        super().__init__()
        self.full = nn.Parameter(_start(full))
        self.coarse = nn.Parameter(_start(coarse))
        self.newton = nn.Parameter(torch.tensor([_FIRST_NEWTON]).repeat(newton, 1))
        self.relief = nn.ParameterList(_first_relief(relief) if relief and full > 1 else [])

    @torch.no_grad()
    def rows(self) -> StepConstants:
        """Return what was learned."""
        made = _real(self.full), _real(self.coarse, SOFTEST), _real(self.newton)
        constants = (tuple(Constants(*row) for row in rows.tolist()) for rows in made)
        tensors = [each.detach().clone() for each in self.relief]
        return StepConstants(*constants, relief=Relief.of(tensors) if tensors else None)

    def again(self, layers: int) -> Float[Tensor, ""]:
        """Return the momentum from frame to frame, of so many layers; see `WarmAdmm`."""
        return _among(layers, _real(self.full))[0, _MOMENTUM]

    def onward(
        self, problem: Problem, state: Float[Tensor, "*batch 1 layer c ly lx"]
    ) -> Float[Tensor, "*batch 1 layer c ly lx"]:
        """Return s after all full steps from a state; see `WarmAdmm`."""
        gram = problem.gram
        full = _among(problem.layer_count, _real(self.full))
        return gram.from_torus(_steps(problem, gram.to_torus(state), full))

    def forward(self, problem: Problem) -> Float[Tensor, "*batch 1 layer c ly lx"]:
        """Return the layers of a problem whose link is a sum, in the bounds of the problem."""
        gram, bounds = problem.gram, problem.bounds
        real = _real(self.full), _real(self.coarse, SOFTEST)
        full, coarse = (_among(problem.layer_count, rows) for rows in real)
        data = _completed(problem, problem.even_start(gram.torus))
        shadow = _first(gram.spectral, data, full[0], coarse, bounds)
        if len(self.relief):
            relief, by_row = Relief.of(list(self.relief)), gram.spectral.by_row
            shadow = relief.relieve_(shadow, gram.layer_size, bounds, by_row=by_row)
        return gram.from_torus(_steps(problem, shadow, full[1:])).clamp(*bounds)

    def behind(
        self, problem: Problem, layers: Float[Tensor, "*batch 1 layer c ly lx"]
    ) -> Float[Tensor, "*batch 1 layer c ly lx"]:
        """Return layers after all Newton steps from some; see `NewtonAdmm`.

        Steps here stay as bold as they are: those that were learned lower the error.
        """
        bounds, gram, weight = problem.bounds, problem.gram, problem.gram.spectral.weight
        shadow, before, scale = layers, None, torch.ones_like(layers)
        share = stride(problem.layer_count)
        for count, (penalty, relaxation, trust, kept, momentum) in enumerate(_real(self.newton)):
            iterate, known = shadow.clamp(*bounds), scale
            found, curvature = _Slope.apply(iterate, problem)
            if renews_scale(count):
                scale = scale_of(curvature.clone(), weight)
            rho = penalty * weight
            dual = (shadow - iterate) * (known / scale).square()
            if before is None:
                dual = dual_at_bounds(iterate, found, bounds, rho * scale.square())
            right = gram.to_torus(found / scale + rho * trust * scale * dual)
            solved = _solution(gram.spectral, right, penalty)
            moved = iterate + kept * dual - share * relaxation * gram.from_torus(solved) / scale
            if before is not None:
                moved = moved + share * momentum * (shadow - before)
            shadow, before = moved, shadow
        return shadow.clamp(*bounds)


def squares(problem: Problem, layers: Tensor) -> Float[Tensor, " batch"]:
    """Return the mean square error of every light field of a batch."""
    total = torch.zeros(len(layers))
    for i, weight in enumerate(problem.weights):
        residual = problem.view(layers, i) - problem.light(i)
        total = total + weight * residual.square().mean(dim=(-3, -2, -1))
    return total / sum(problem.weights)


def _steps(problem: Problem, shadow: Tensor, rows: Tensor) -> Tensor:
    """Return s after a step for every row of constants."""
    spectral, before = problem.gram.spectral, None
    for row in rows:
        data = _completed(problem, shadow)
        shadow, before = _moved(spectral, data, shadow, before, row, problem.bounds), shadow
    return shadow


def _completed(problem: Problem, shadow: Tensor) -> Tensor:
    """Return what `completed` does."""
    gram = problem.gram
    band = _Band.apply(shadow.clamp(*problem.bounds), gram)
    return gram.to_torus(problem.back_projected) + band


def _start(steps: int) -> Tensor:
    rows = torch.tensor([list(_FIRST.values())]).repeat(steps, 1)
    rows[:, 0] = torch.linspace(_LAST_PENALTY, _FIRST["penalty"], steps).flip(0)
    return rows


def _first_relief(channels: int) -> list[nn.Parameter]:
    """Return a network that does nothing yet."""
    generator = torch.Generator().manual_seed(channels)
    made = list[Tensor]()
    for given, answered in pairwise((SIGNS, channels, channels)):
        reach = 1 / math.sqrt(9 * given)
        for shape in ((answered, given, 3, 3), (answered, given, 3, 3), (answered,)):
            made.append(torch.empty(shape).uniform_(-reach, reach, generator=generator))
    return [nn.Parameter(each) for each in (*made, torch.zeros(1, channels, 3, 3))]


def _real(rows: Tensor, softest: float = 0.0) -> Tensor:
    """Return constants for what is learned of them: a penalty is above the softest."""
    assert rows.shape[-1] == len(Constants._fields)
    return torch.cat([rows[:, :1].exp() + softest, rows[:, 1:]], dim=1)


def _among(layers: int, rows: Tensor) -> Tensor:
    """Return rows as `Constants.among` does each."""
    penalty, relaxation, trust, kept, momentum = rows.unbind(dim=1)
    share = stride(layers)
    relaxation = relaxation - (1 - share**2) * (relaxation - OVERRELAXED).relu()
    return torch.stack([penalty, relaxation, trust, kept, share * momentum], dim=1)


def _first(
    spectral: Spectral,
    data: Tensor,
    row: Tensor,
    coarse: Tensor,
    bounds: tuple[float, float],
) -> Tensor:
    """Return s after the first step."""
    share = 1 / (spectral.weight * len(spectral.symbol))
    penalty, a = row[0], row[1]
    rho = penalty * spectral.weight
    seen = spectral.to_frequencies(data)
    start = share * seen
    spectrum = start + a * (_solved(spectral, seen + rho * start, penalty) - start)
    coarser = coarse_grid(spectral)
    if coarser is not None and len(coarse):
        back = coarser.to_pixels(low_part(seen, coarser)) / coarser.pixels
        shadow, before = share * back, None
        for each in coarse:
            moved = _moved(coarser, back, shadow, before, each, bounds)
            shadow, before = moved, shadow
        replace_low_part_(spectrum, coarser.to_frequencies(shadow) * coarser.pixels, coarser)
    return spectral.to_pixels(spectrum)


def _moved(
    spectral: Spectral,
    data: Tensor,
    shadow: Tensor,
    before: Tensor | None,
    row: Tensor,
    bounds: tuple[float, float],
) -> Tensor:
    """Return s after a step."""
    penalty, relaxation, trust, kept, momentum = row
    iterate = shadow.clamp(*bounds)
    dual = shadow - iterate
    right = data + penalty * spectral.weight * (iterate - trust * dual)
    moved = iterate + kept * dual + relaxation * (_solution(spectral, right, penalty) - iterate)
    return moved if before is None else moved + momentum * (shadow - before)


def _solution(spectral: Spectral, right: Tensor, penalty: Tensor) -> Tensor:
    """Return (G + rho I)^-1 right."""
    return spectral.to_pixels(_solved(spectral, spectral.to_frequencies(right), penalty))


def _solved(spectral: Spectral, spectrum: Tensor, penalty: Tensor) -> Tensor:
    """Return the same of a spectrum."""
    rho = penalty * spectral.weight
    matrix = interleaved(resolvent(spectral, penalty.item(), BALANCE))
    return _Solve.apply(spectrum, rho, matrix) / rho


class _Band(torch.autograd.Function):
    """The band of layers is linear in them and its own adjoint."""

    @staticmethod
    def forward(ctx: Any, layers: Tensor, gram: Gram) -> Tensor:
        ctx.gram = gram
        return gram.band(layers)

    @staticmethod
    def backward(ctx: Any, slope: Tensor) -> tuple[Tensor, None]:  # pyright: ignore
        return ctx.gram.band(slope), None


class _Slope(torch.autograd.Function):
    """The slope and the curvature of the error by layers; their own derivatives view by view."""

    @staticmethod
    def forward(ctx: Any, layers: Tensor, problem: Problem) -> tuple[Tensor, Tensor]:
        ctx.save_for_backward(layers)
        ctx.problem = problem
        ctx.set_materialize_grads(False)
        curvature = layers.new_empty(layers.shape)
        return slope(problem, layers, curvature), curvature

    @staticmethod
    def backward(  # pyright: ignore
        ctx: Any, along: Tensor, bent: Tensor | None
    ) -> tuple[Tensor, None]:
        (layers,), problem = ctx.saved_tensors, ctx.problem
        projection, link = problem.projection, problem.link
        result, bent = torch.zeros_like(layers), torch.zeros_like(layers) if bent is None else bent
        for i, weight in enumerate(problem.weights):
            # <g, along> + <D^2, bent> of this view, by the pixels that it looks at
            shares = zip(projection.windows(along, i), projection.windows(bent, i), strict=True)
            pixels = [each.detach().requires_grad_() for each in projection.windows(layers, i)]
            with torch.enable_grad():
                residual = link.compose(pixels) - problem.light(i).unsqueeze(-4)
                others = [link.derivative(pixels, k) for k in range(len(pixels))]
                across = sum_of(
                    [o * (g * residual + c * o) for o, (g, c) in zip(others, shares, strict=True)]
                )
                slopes = torch.autograd.grad(across.sum(), pixels)
            for k, plane in enumerate(result.unbind(dim=-4)):
                projection.scatter_(plane, slopes[k], i, k, weight)
        return result, None


class _Solve(torch.autograd.Function):
    """R S with R = rho (G + rho I)^-1, hence dR / d rho = (R - R^2) / rho; R = R^H."""

    @staticmethod
    def forward(ctx: Any, spectrum: Tensor, rho: Tensor, matrix: Matrix) -> Tensor:
        product = multiply(matrix, spectrum)
        ctx.save_for_backward(product, rho)
        ctx.matrix = matrix
        return product

    @staticmethod
    def backward(ctx: Any, slope: Tensor) -> tuple[Tensor, Tensor, None]:  # pyright: ignore
        (product, rho), matrix = ctx.saved_tensors, ctx.matrix
        by_rho = (product - multiply(matrix, product)) / rho
        return multiply(matrix, slope), (slope.conj() * by_rho).real.sum(), None
