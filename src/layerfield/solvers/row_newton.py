"""Projected Newton steps where views stand in a row, and every row of pixels is a small system."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.kernels.compiled import serve
from layerfield.kernels.row_products import ProductRules
from layerfield.kernels.row_steps import CLOSE, RowRules, newton_steps
from layerfield.problem import Problem
from layerfield.row_system import serves_rows


@dataclass(frozen=True, eq=False)
class RowState:
    """Layers, and how far their rows are.

    Args:
        layers: within bounds.
        factors: what the penalty of every row is multiplied by.
        count: steps made.
    """

    layers: Float[Tensor, "*batch 1 layer c ly lx"]
    factors: Float[Tensor, "*batch 1 c ly"]
    count: int = 0


@dataclass(frozen=True)
class RowNewton:
    """Minimise E = 1/2 x^T H x - b^T x of every row within bounds, b = A^T W L.

    H is a band matrix (`row_system`), so a system of some of its unknowns is solved exactly, at
    the cost of a few products a pixel and no transform. Before the first step, and behind every
    one, come sweeps: each unknown in turn takes its best place while the others stay,

        x_i <- clamp(x_i + g_i / H_ii)        g = b - H x

    which leaves no error but smooth ones. A step removes those. Unknowns whose own step would lead
    past a bound go to it, the others take a Newton step for these places:

        A = { i : x_i + g_i / W <= low or >= high },   p_A = bound - x_A
        (H + rho I)_FF p_F = g_F - H_FA p_A,           x <- clamp(x + p)

    rho keeps from going far what light says little about. A row whose energy has grown goes back to
    where it was, and its rho grows; with every step that helps it falls again.

    Active sets: Bertsekas, SIAM J. Control Optim. 20, 221 (1982). Sweeps between solutions of
    subspaces: Silcowitz, Niebuhr Poulsen and Erleben, GRAPP 2010.

    Args:
        sweeps: before the first step and behind every step.
        penalty: rho, as a share of the weights of all views.
        growth: what rho of a row is multiplied by where a step did not help.
    """

    sweeps: int = 6
    penalty: float = 6e-4
    growth: float = 8.0

    def init(self, problem: Problem, start: RowState | Tensor | None) -> RowState:
        if not serves_rows(problem.projection):
            raise ValueError(
                "row-newton needs views in a single row, and eyes between them there, too; take "
                "fourier-admm"
            )
        if isinstance(start, RowState):
            return start
        layers = problem.even_start() if start is None else start
        layers = layers.clamp(*problem.bounds)
        return RowState(layers, layers.new_ones(layers[..., 0, :, :, 0].shape))

    def step(self, problem: Problem, state: RowState) -> RowState:
        return self.steps(problem, state, 1)

    def steps(self, problem: Problem, state: RowState, count: int) -> RowState:
        data, weight = problem.back_projected, sum(problem.weights)
        rules = RowRules(
            first=0 if state.count else self.sweeps,
            sweeps=self.sweeps,
            steps=count,
            share=np.float32(1 / weight),
            prox=np.float32(self.penalty * weight),
            growth=np.float32(self.growth),
            bounds=np.array(problem.bounds, np.float32),
        )
        if serve(data, state.layers):
            matrix = problem.constants.row_matrix
            made = newton_steps(state.layers, data, state.factors, matrix, rules)
        else:
            ahead = torch.from_numpy(problem.constants.row_entries).to(data)
            rows = _Rows(ahead, to_rows(data), 1 / weight, problem.bounds)
            made = plain_steps(rows, state, rules)
        return RowState(*made, state.count + count)

    def layers(self, problem: Problem, state: RowState) -> Float[Tensor, "*batch 1 layer c ly lx"]:
        return state.layers


@runtime_checkable
class Rows(Protocol):
    """All rows side by side, what a step and a sweep make of them, and how far they are."""

    def swept(self, x: Float[Tensor, "*row unknown"]) -> Float[Tensor, "*row unknown"]:
        """Return what one unknown after the other makes of x."""
        ...

    def stepped(
        self, x: Float[Tensor, "*row unknown"], prox: Float[Tensor, "*row 1"]
    ) -> Float[Tensor, "*row unknown"]:
        """Return x after a step, with a rho for every row."""
        ...

    def energy(self, x: Float[Tensor, "*row unknown"]) -> Float[Tensor, "*row"]:
        """Return E of every row, in double precision."""
        ...


def plain_steps(
    rows: Rows, state: RowState, rules: RowRules | ProductRules
) -> tuple[Float[Tensor, "*batch 1 layer c ly lx"], Float[Tensor, "*batch 1 c ly"]]:
    """Return layers and what the penalty is multiplied by after some steps, in PyTorch."""
    x, factors = to_rows(state.layers), state.factors
    for _ in range(rules.first):
        x = rows.swept(x)
    for _ in range(rules.steps):
        made = rows.stepped(x, (factors * rules.prox.item())[..., None])
        for _ in range(rules.sweeps):
            made = rows.swept(made)
        before, after = rows.energy(x), rows.energy(made)
        is_worse = after > before + CLOSE * before.abs()
        x = torch.where(is_worse[..., None], x, made)
        easier = (factors / 2).clamp(min=1)
        harder = (factors * rules.growth.item()).clamp(max=1e12)
        factors = torch.where(is_worse, harder, easier)
    return _from_rows(x, state.layers.shape[-4]), factors


@dataclass(frozen=True, eq=False)
class _Rows:
    """All rows side by side; formulas as of `RowNewton`.

    Args:
        ahead: H_id.
        data: b.
        share: of the fall that is tried, 1 / W.
        bounds: of unknowns.
    """

    ahead: Float[Tensor, "unknown ahead"]
    data: Float[Tensor, "*row unknown"]
    share: float
    bounds: tuple[float, float]

    def fall(self, x: Float[Tensor, "*row unknown"]) -> Float[Tensor, "*row unknown"]:
        """Return g."""
        result = self.data - self.ahead[:, 0] * x
        number = len(self.ahead)
        for d, entries in enumerate(self.ahead.T[1:], start=1):
            near, far = slice(number - d), slice(d, number)
            result[..., near] -= entries[near] * x[..., far]
            result[..., far] -= entries[near] * x[..., near]
        return result

    def energy(self, x: Float[Tensor, "*row unknown"]) -> Float[Tensor, "*row"]:
        """Return E of every row, in double precision."""
        return -0.5 * (x * (self.data + self.fall(x))).sum(dim=-1, dtype=torch.float64)

    def swept(self, x: Float[Tensor, "*row unknown"]) -> Float[Tensor, "*row unknown"]:
        """Return what one unknown after the other makes of x."""
        made, ahead = x.clone(), self.ahead
        number, reach = len(ahead), ahead.shape[1] - 1
        for i in range(number):
            far, near = min(reach, number - 1 - i), min(reach, i)
            if ahead[i, 0] > 0:
                known = made[..., i : i + far + 1] @ ahead[i, : far + 1]
                for d in range(1, near + 1):
                    known = known + ahead[i - d, d] * made[..., i - d]
                moved = made[..., i] + (self.data[..., i] - known) / ahead[i, 0]
                made[..., i] = moved.clamp(*self.bounds)
        return made

    def stepped(
        self, x: Float[Tensor, "*row unknown"], prox: Float[Tensor, "*row 1"]
    ) -> Float[Tensor, "*row unknown"]:
        """Return x after a Newton step."""
        fall = self.fall(x)
        tried, ahead = x + self.share * fall, self.ahead.expand(*x.shape, -1)
        return x_behind_step(x, tried, fall, (ahead, prox.expand(x.shape)), self.bounds)


def x_behind_step(
    x: Float[Tensor, "*row unknown"],
    tried: Float[Tensor, "*row unknown"],
    fall: Float[Tensor, "*row unknown"],
    system: tuple[Float[Tensor, "*row unknown ahead"], Float[Tensor, "*row unknown"]],
    bounds: tuple[float, float],
) -> Float[Tensor, "*row unknown"]:
    """Return clamp(x + p): elimination from the first unknown to the last, and back.

    Args:
        x: where the step begins.
        tried: unknowns for which that lies beyond a bound go there.
        fall: g.
        system: H_id of every row, and rho of every unknown.
        bounds: of unknowns.
    """
    (low, high), (matrix, prox) = bounds, system
    goes_low = tried <= low
    stays = goes_low | (tried >= high)
    bound = torch.where(goes_low, low, high) - x
    number, reach = x.shape[-1], matrix.shape[-1] - 1
    left, factors, moves = list[Tensor](), list[Tensor](), [*fall.unbind(dim=-1)]
    for i, entries in enumerate(matrix.unbind(dim=-2)):
        row = entries.clone()
        for e in range(1, min(reach, i) + 1):
            row[..., : reach + 1 - e] += factors[i - e][..., e : e + 1] * left[i - e][..., e:]
            moves[i] = moves[i] - left[i - e][..., e] * moves[i - e]
        own = row[..., :1] + prox[..., i : i + 1]
        moves[i] = torch.where(stays[..., i], bound[..., i], moves[i] / own[..., 0])
        left.append(row)
        factors.append(torch.where(stays[..., i : i + 1], 0, -row / own))
    for i in reversed(range(number)):
        for d in range(1, min(reach, number - 1 - i) + 1):
            moves[i] = moves[i] + factors[i][..., d] * moves[i + d]
    return (x + torch.stack(moves, dim=-1)).clamp(low, high)


def to_rows(layers: Float[Tensor, "*batch layer c y x"]) -> Float[Tensor, "*batch c y unknown"]:
    """Return the pixels of a row of all layers column by column."""
    return layers.movedim(-4, -1).flatten(-2)


def _from_rows(
    rows: Float[Tensor, "*batch c y unknown"], count: int
) -> Float[Tensor, "*batch layer c y x"]:
    return rows.unflatten(-1, (-1, count)).movedim(-1, -4)
