"""Steps for links that are no sum: their slope exactly, their curvature as if they were one."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.kernels import newton_passes
from layerfield.problem import Problem
from layerfield.solvers.admm_steps import Constants, stride
from layerfield.solvers.fourier_admm import dual_at_bounds
from layerfield.solvers.fourier_start import FourierStart
from layerfield.solvers.learned_admm import BALANCE
from layerfield.solvers.slope import slope

_LEAST = 0.01  # curvature, as a share of the weight of all views: no pixel is moved more boldly
# Of the first steps and of those behind them: momentum pays once long strides are made.
_PLAIN = Constants(penalty=0.5, relaxation=1.2, trust=1.0, kept=1.0, momentum=0.0)
_LATER = Constants(penalty=0.5, relaxation=1.2, trust=1.0, kept=1.0, momentum=0.5)
_STRIDES = 4
_GROWN = 1 + 1e-4  # the error, by more than rounding


@dataclass(frozen=True, eq=False)
class NewtonState:
    """Iterate and dual, s = z + u, those of one step ago, D, and the steps made.

    At the start there are layers only: s is z. Without one of a step ago there is no momentum. Of
    every light field of a batch, the error of the iterate of one step ago, and how boldly steps go.
    """

    shadow: Float[Tensor, "*batch 1 layer c ly lx"]
    before: Float[Tensor, "*batch 1 layer c ly lx"] | None = None
    scale: Float[Tensor, "*batch 1 layer c ly lx"] | None = None
    count: int = 0
    error: Float[Tensor, "*batch 1 1 1 1 1"] | None = None
    boldness: Float[Tensor, "*batch 1 1 1 1 1"] | None = None


@dataclass(frozen=True, eq=False)
class NewtonAdmm:
    """Minimise 1/2 sum_i w_i ||link(P)_i - L_i||^2 over a box, where the link is no sum.

    Near the layers P with the slope g, the error is taken for

        <g, p> + 1/2 <D p, G D p>,   D^2 = sum_i w_i A_i^T o_i^2 / sum_i w_i

    with the Gram matrix G of the sum and o_i the derivative of what view i shows by the pixel that
    it looks at: pixels behind dark ones count for little. D is found anew in the first three steps
    and then in every third: in dark scenes one of the start leads astray. ADMM on this, a step for
    every slope:

        z = clamp(s),  u = s - z
        s <- z + kept u - a D^-1 (G + rho I)^-1 (D^-1 g + rho trust D u)
               + momentum (s - s of one step ago)

    A step reads every view once, where a sweep does for every layer; and it moves light of low
    frequency as far as it has to go. Of more than four layers it is shorter, see `stride`; and half
    as long whenever the error has grown: where views are shown badly, what G leaves out, how layers
    bend what shows through others, leads away from the optimum (all layers on one side of the
    display plane, say).

    Args:
        full: constants of every step; behind them come plain ones.
    """

    full: Sequence[Constants] = ()

    def init(self, problem: Problem, start: NewtonState | Tensor | None) -> NewtonState:
        if isinstance(start, NewtonState):
            return start
        return NewtonState(problem.flat_start() if start is None else start)

    def step(self, problem: Problem, state: NewtonState) -> NewtonState:
        known = self._constants(state.count, problem.layer_count)
        spectral = problem.gram.spectral
        right, dual, scale, error = _right_hand_side(problem, state, known)
        solved = spectral.solved_pixels(right, known.penalty, BALANCE, gain=-known.relaxation)
        boldness, made = _boldness(state, error), state.count + 1
        moved = _moved(problem, state, dual, scale, solved, boldness, known)
        # The last learned step looks to nothing behind it: not a change to be made once more.
        before = None if made == len(self.full) else state.shadow
        return NewtonState(moved, before, scale, made, error, boldness)

    def _constants(self, count: int, layers: int) -> Constants:
        if count < len(self.full):
            found = self.full[count]
        else:
            found = _PLAIN if count < _STRIDES else _LATER
        share = stride(layers)
        relaxation, momentum = share * found.relaxation, share * found.momentum
        return found._replace(relaxation=relaxation, momentum=momentum)

    def layers(
        self, problem: Problem, state: NewtonState
    ) -> Float[Tensor, "*batch 1 layer c ly lx"]:
        return state.shadow.clamp(*problem.bounds)


@dataclass(frozen=True, eq=False)
class FourierNewton:
    """Solve where the link is a sum, go back, then take Newton steps on the views as they are.

    An iteration is a Newton step; the start is part of `init`.

    Args:
        start: what makes the start; its sweeps are not made.
        newton: what follows. It has one subframe only.
    """

    start: FourierStart
    newton: NewtonAdmm

    def init(self, problem: Problem, start: NewtonState | Tensor | None) -> NewtonState:
        if start is None:
            start = self.start.begun(problem)
        return self.newton.init(problem, start)

    def step(self, problem: Problem, state: NewtonState) -> NewtonState:
        return self.newton.step(problem, state)

    def layers(
        self, problem: Problem, state: NewtonState
    ) -> Float[Tensor, "*batch 1 layer c ly lx"]:
        return self.newton.layers(problem, state)


def _right_hand_side(
    problem: Problem, state: NewtonState, known: Constants
) -> tuple[Tensor, Tensor, Tensor, Float[Tensor, "*batch 1 1 1 1 1"]]:
    """Return (D^-1 g + rho trust D u) / rho on the torus, u, D, and the error of the iterate."""
    gram, (low, high) = problem.gram, problem.bounds
    rho, weight = known.penalty * gram.spectral.weight, gram.spectral.weight
    terms = newton_passes.Before(rho, known.trust, low, high, weight, _LEAST)
    iterate = state.shadow.clamp(low, high)
    error = iterate.new_zeros(*iterate.shape[:-5], 1, 1, 1, 1, 1)
    curvature = iterate.new_empty(iterate.shape) if renews_scale(state.count) else None
    found = slope(problem, iterate, curvature, error)
    del iterate
    if newton_passes.serve_layers(state.shadow, found, curvature, state.scale):
        given = state.shadow, found, curvature, state.scale
        return *newton_passes.before(terms, *given, gram.torus), error
    scale = state.scale if curvature is None else scale_of(curvature, weight)
    assert scale is not None
    iterate = state.shadow.clamp(low, high)
    if state.scale is None:
        dual = dual_at_bounds(iterate, found, problem.bounds, rho * scale.square())
    else:
        dual = state.shadow - iterate
        if scale is not state.scale:
            dual *= (state.scale / scale).square_()  # of the same force, rho D^2 u
    right = found.div_(scale).div_(rho).addcmul_(dual, scale, value=known.trust)
    return gram.to_torus(right), dual, scale, error


def _moved(
    problem: Problem,
    state: NewtonState,
    dual: Tensor,
    scale: Tensor,
    solved: Tensor,
    boldness: Tensor,
    known: Constants,
) -> Tensor:
    """Return s behind a step; the dual is written on."""
    low, high = problem.bounds
    momentum = 0.0 if state.before is None else known.momentum
    if newton_passes.serve_layers(state.shadow, state.before, dual, scale, solved):
        terms = newton_passes.Behind(known.kept, momentum, low, high)
        return newton_passes.behind(
            terms, state.shadow, state.before, dual, scale, solved, boldness
        )
    moved = problem.gram.from_torus(solved) / scale
    if state.before is not None:
        moved.add_(state.shadow - state.before, alpha=momentum)
    return moved.mul_(boldness).add_(state.shadow.clamp(low, high)).add_(dual, alpha=known.kept)


def _boldness(state: NewtonState, error: Tensor) -> Tensor:
    known = torch.ones_like(error) if state.boldness is None else state.boldness
    if state.error is None:
        return known
    return torch.where(error > _GROWN * state.error, known / 2, known)


def renews_scale(count: int) -> bool:
    """Whether D is found anew in the step behind so many."""
    return count < 3 or count % 3 == 0


def scale_of(
    curvature: Float[Tensor, "*batch 1 layer c ly lx"], weight: float
) -> Float[Tensor, "*batch 1 layer c ly lx"]:
    """Return D of the curvature, in place; no less than a tenth of what clear layers have."""
    return curvature.div_(weight).clamp_(min=_LEAST).sqrt_()
