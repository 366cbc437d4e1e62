"""A few learned steps of the direct solver from what is left of the frame before."""

from collections.abc import Sequence
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from layerfield.motion import framed, moved
from layerfield.solve import Problem
from layerfield.solvers.admm_steps import Constants, after_steps
from layerfield.solvers.learned_admm import BALANCE, LearnedState


@dataclass(frozen=True, eq=False)
class WarmAdmm:
    """Minimise 1/2 ||A P - L||^2_W over a box, from the state of the frame before.

    The first state is that of the frame before, s = z + u, moved as the picture moved; what follows
    from the views at once, the balanced start e, is that of the new views:

        s_new(p) = clamp(e_new(p) + (z - e)(p + m)) + u(p + m)

    The steps are those of `LearnedAdmm`, all on full size, with constants learned for frames in the
    middle of videos: for the least error of this frame and of the next.

    Args:
        full: constants of every step; those of the last serve all that are further asked for.
    """

    full: Sequence[Constants]

    def init(self, problem: Problem, start: LearnedState | Tensor | None) -> LearnedState:
        if isinstance(start, LearnedState):
            return start
        torus = problem.gram.torus
        known = problem.even_start(torus) if start is None else problem.gram.to_torus(start)
        return LearnedState(known)

    def step(self, problem: Problem, state: LearnedState) -> LearnedState:
        return self.steps(problem, state, 1)

    def steps(self, problem: Problem, state: LearnedState, count: int) -> LearnedState:
        rows = [self._constants(problem, state.count + n) for n in range(count)]
        made = after_steps(problem, state.shadow, state.before, rows, BALANCE)
        return LearnedState(*made, state.count + count)

    def _constants(self, problem: Problem, count: int) -> Constants:
        return self.full[min(count, len(self.full) - 1)].among(problem.layer_count)

    def layers(
        self, problem: Problem, state: LearnedState
    ) -> Float[Tensor, "*batch 1 layer c ly lx"]:
        return problem.gram.from_torus(state.shadow).clamp(*problem.bounds)


def moved_start(
    even: Float[Tensor, "*batch 1 layer c ly lx"],
    state: Float[Tensor, "*batch 1 layer c ly lx"],
    even_before: Float[Tensor, "*batch 1 layer c ly lx"],
    motion: Float[Tensor, "2 ly lx"],
    bounds: tuple[float, float] = (0.0, 1.0),
) -> Float[Tensor, "*batch 1 layer c ly lx"]:
    """Return where a frame starts from.

    What e asks for beyond the bounds is not the force of a bound: where motion is found wrongly
    from frame to frame, it would add up in the dual until layers stay dark. What comes in at an
    edge has the state that pixels near there have on average, rather than none.

    Args:
        even: e, its balanced start.
        state: s, or the layers, of the frame before.
        even_before: e of that.
        motion: m, from the new frame to the one before.
        bounds: of layer pixels.
    """
    iterate = state.clamp(*bounds)
    dual = moved(framed(state - iterate), motion)
    return dual.add_((even + moved(framed(iterate - even_before), motion)).clamp_(*bounds))
