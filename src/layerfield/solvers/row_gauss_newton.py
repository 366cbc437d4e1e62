"""Projected Gauss-Newton steps where views stand in a row and light is multiplied."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.kernels.compiled import serve
from layerfield.kernels.row_products import ProductRules, RowPaths, product_steps
from layerfield.links import Multiplicative
from layerfield.problem import Problem
from layerfield.row_system import serves_products
from layerfield.solvers.row_newton import RowState, plain_steps, x_behind_step


@dataclass(frozen=True)
class RowGaussNewton:
    """Minimise E = 1/2 sum w (prod x - L)^2 over the light paths of every row, within bounds.

    As `RowNewton` does where light adds up; here a row's matrix is its own and changes with
    x. With o_i what the others on a path let through, sweeps give each unknown its best place,

        x_i <- clamp(sum w o_i L / sum w o_i^2)

    and a step takes paths for linear near where they are (Gauss-Newton):

        g_i = sum w o_i (L - prod x),   H_ij = sum w o_i o_j,   D_ii = H_ii + least
        A = { i : x_i + g_i / H_ii <= low or >= high },   p_A = bound - x_A
        (H + rho D)_FF p_F = g_F - H_FA p_A,              x <- clamp(x + p)

    All sums go over the paths through an unknown, or through both. A row whose error has grown goes
    back, and its rho grows; with every step that helps it falls again.

    Args:
        sweeps: before the first step and behind every step.
        penalty: rho.
        least: as a share of the weights of all views.
        growth: what rho of a row is multiplied by where a step did not help.
    """

    sweeps: int = 6
    penalty: float = 1e-3
    least: float = 4e-3
    growth: float = 8.0

    def init(self, problem: Problem, start: RowState | Tensor | None) -> RowState:
        product = isinstance(problem.link, Multiplicative) and problem.subframes == 1
        if not (product and serves_products(problem.projection)):
            raise ValueError(
                "row-newton needs views in a single row, and where light is multiplied layers that "
                "are shifted by whole pixels; take fourier-admm"
            )
        if isinstance(start, RowState):
            return start
        if start is None:
            start = problem.link.from_sum(problem.in_sum_domain().even_start())
        layers = start.clamp(*problem.bounds)
        return RowState(layers, layers.new_ones(layers[..., 0, :, :, 0].shape))

    def step(self, problem: Problem, state: RowState) -> RowState:
        return self.steps(problem, state, 1)

    def steps(self, problem: Problem, state: RowState, count: int) -> RowState:
        rules = ProductRules(
            first=0 if state.count else self.sweeps,
            sweeps=self.sweeps,
            steps=count,
            prox=np.float32(self.penalty),
            least=np.float32(self.least * sum(problem.weights)),
            growth=np.float32(self.growth),
            bounds=np.array(problem.bounds, np.float32),
        )
        paths, like = problem.constants.row_paths, problem.views.like
        if serve(state.layers) and like.dtype == torch.float32:
            given = state.layers, problem.light_paths, state.factors
            made = product_steps(*given, paths, rules)
        else:
            light = problem.target.movedim(-4, -2).flatten(-2).unsqueeze(-4)
            rows = _Rows.of(paths, light, rules.least.item(), problem.bounds)
            made = plain_steps(rows, state, rules)
        return RowState(*made, state.count + count)

    def layers(self, problem: Problem, state: RowState) -> Float[Tensor, "*batch 1 layer c ly lx"]:
        return state.layers


@dataclass(frozen=True, eq=False)
class _Rows:
    """All rows side by side; formulas as of `RowGaussNewton`.

    Args:
        light: L of every path.
        shown: L of every view pixel that counts.
        weights: of paths, and
        shares: of view pixels.
        owners: of every path its unknown.
        others: of every path the other unknowns.
        places: of every view pixel all unknowns.
        begins: of every unknown its first path; and the number of all.
        reach: how far unknowns on a path are apart.
        least: what rho counts beside H_ii.
        bounds: of unknowns.
    """

    light: Float[Tensor, "*row path"]
    shown: Float[Tensor, "*row pixel"]
    weights: Float[Tensor, " path"]
    shares: Float[Tensor, " pixel"]
    owners: Tensor
    others: Tensor
    places: Tensor
    begins: list[int]
    reach: int
    least: float
    bounds: tuple[float, float]

    @classmethod
    def of(
        cls,
        paths: RowPaths,
        light: Float[Tensor, "*row seen"],
        least: float,
        bounds: tuple[float, float],
    ) -> "_Rows":
        known = {
            name: torch.from_numpy(value)
            for name, value in paths._asdict().items()
            if name != "reach"
        }
        known = {name: value.to(light.device) for name, value in known.items()}
        number, count = len(known["begins"]) - 1, len(known["lights"])
        layers = len(known["places"]) // len(known["pixels"])
        return cls(
            light[..., known["lights"]],
            light[..., known["pixels"]],
            known["weights"].to(light.dtype),
            known["shares"].to(light.dtype),
            torch.arange(number, device=light.device).repeat_interleave(known["begins"].diff()),
            known["others"].view(count, layers - 1) - paths.reach,
            known["places"].view(len(known["pixels"]), -1) - paths.reach,
            paths.begins.tolist(),
            paths.reach,
            least,
            bounds,
        )

    def energy(self, x: Float[Tensor, "*row unknown"]) -> Float[Tensor, "*row"]:
        """Return E of every row, in double precision."""
        off = x[..., self.places].prod(dim=-1) - self.shown
        return 0.5 * (self.shares * off.square()).sum(dim=-1, dtype=torch.float64)

    def swept(self, x: Float[Tensor, "*row unknown"]) -> Float[Tensor, "*row unknown"]:
        """Return what one unknown after the other makes of x."""
        made = x.clone()
        for i, (begin, end) in enumerate(zip(self.begins, self.begins[1:], strict=False)):
            other = made[..., self.others[begin:end]].prod(dim=-1)
            weighed = self.weights[begin:end] * other
            bent = (weighed * other).sum(dim=-1)
            best = (weighed * self.light[..., begin:end]).sum(dim=-1) / bent
            made[..., i] = torch.where(bent > 1e-12, best.clamp(*self.bounds), made[..., i])
        return made

    def stepped(
        self, x: Float[Tensor, "*row unknown"], prox: Float[Tensor, "*row 1"]
    ) -> Float[Tensor, "*row unknown"]:
        """Return x after a Gauss-Newton step."""
        met = x[..., self.others]
        other, own = met.prod(dim=-1), x[..., self.owners]
        weighed = self.weights * other
        fall = torch.zeros_like(x).index_add_(-1, self.owners, weighed * (self.light - other * own))
        matrix = x.new_zeros(*x.shape, self.reach + 1).flatten(-2)
        first = self.owners * (self.reach + 1)
        matrix.index_add_(-1, first, weighed * other)
        for m in range(met.shape[-1]):
            ahead = self.others[:, m] - self.owners
            rest = torch.cat([met[..., :m], met[..., m + 1 :]], dim=-1).prod(dim=-1)
            far = ahead > 0
            matrix.index_add_(-1, (first + ahead)[far], (weighed * own * rest)[..., far])
        matrix = matrix.unflatten(-1, (-1, self.reach + 1))
        bent = matrix[..., 0]
        tried = x + torch.where(bent > 1e-12, fall / bent, 0)
        return x_behind_step(x, tried, fall, (matrix, prox * (bent + self.least)), self.bounds)
