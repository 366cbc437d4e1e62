"""A few learned steps of the direct solver from what is left of the frame before."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import pad

from layerfield.kernels.compiled import serve
from layerfield.kernels.moved import moved_parts
from layerfield.motion import framed, moved, rim_of
from layerfield.problem import Problem
from layerfield.solvers.admm_steps import Constants, after_steps
from layerfield.solvers.learned_admm import BALANCE, LearnedState

_ALL = slice(None)


@dataclass(frozen=True, eq=False)
class WarmAdmm:
    """Minimise 1/2 ||A P - L||^2_W over a box, from the state of the frame before.

    The first state is that of the frame before, s = z + u, moved as the picture moved; what follows
    from the views at once, the balanced start e, is that of the new views; and a share of what the
    steps of the frame before have changed, d, is changed once more (momentum, from frame to frame):

        c(p) = clamp(e_new(p) + (z - e)(p + m))
        s_new(p) = clamp(e_new(p) + (z - e)(p + m) + momentum d(p + m)) + u(p + m)
        d_new = z_new - c

    Where light takes long to find its layer, every frame goes a part of the way, and d is the
    direction; where things move evenly it is what the start lacks.

    The steps are those of `LearnedAdmm`, all on full size, with constants learned for frames in the
    middle of videos: for the least error of this frame and of the next. The first step has none
    before it in its frame: its momentum is that from frame to frame.

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

    def again(self, layers: int) -> float:
        """Return the momentum from frame to frame, of so many layers."""
        return self.full[0].among(layers).momentum

    def layers(
        self, problem: Problem, state: LearnedState
    ) -> Float[Tensor, "*batch 1 layer c ly lx"]:
        return problem.gram.clamped_from_torus(state.shadow, problem.bounds)


class Left(NamedTuple):
    """What a frame leaves to the next.

    Args:
        state: s, or the layers; on a torus they are in the top left corner.
        even: e, its balanced start.
        carried: c, the layers that it would have started from if nothing had been changed once
            more; its own where nothing was carried to it.
    """

    state: Float[Tensor, "*batch subframe layer c ty tx"]
    even: Float[Tensor, "*batch 1 layer c ly lx"]
    carried: Float[Tensor, "*batch subframe layer c ly lx"]


class MovedStart(NamedTuple):
    """Where a frame starts from.

    Args:
        state: s.
        carried: c.
    """

    state: Float[Tensor, "*batch subframe layer c ty tx"]
    carried: Float[Tensor, "*batch subframe layer c ly lx"]


def moved_start(
    even: Float[Tensor, "*batch 1 layer c ly lx"],
    left: Left,
    motion: Float[Tensor, "2 ly lx"],
    *,
    again: float | Float[Tensor, ""] = 0.0,
    bounds: tuple[float, float] = (0.0, 1.0),
    size: tuple[int, int] | None = None,
) -> MovedStart:
    """Return where a frame starts from; the formulas are those of `WarmAdmm`.

    What e asks for beyond the bounds is not the force of a bound: where motion is found wrongly
    from frame to frame, it would add up in the dual until layers stay dark. What comes in at an
    edge has the state that pixels near there have on average, rather than none.

    Args:
        even: e, its balanced start.
        left: by the frame before.
        motion: m, from the new frame to the one before.
        again: the momentum from frame to frame.
        bounds: of layer pixels.
        size: of a torus, on which the state is, and 0 beside the layers.
    """
    height, width = even.shape[-2:]

    def parts(y: slice, x: slice) -> Float[Tensor, "3 *batch subframe layer c y x"]:
        """Return u, z - e and momentum (z - c)."""
        state = left.state[..., :height, :width][..., y, x]
        iterate = state.clamp(*bounds)
        change = again * (iterate - left.carried[..., y, x])
        return torch.stack([state - iterate, iterate - left.even[..., y, x], change])

    torus = size or (height, width)
    is_one = even.shape[:-2] == left.state.shape[:-2]  # subframes share one balanced start
    if is_one and not isinstance(again, Tensor) and serve(even, *left):
        made = moved_parts(even, *left, again, motion, rim_of(parts), bounds, torus)
        return MovedStart(*made)
    dual, other, change = moved(framed(parts(_ALL, _ALL)), motion)
    light = even + other
    state = (light + change).clamp(*bounds) + dual
    beside = (0, torus[1] - width, 0, torus[0] - height)
    return MovedStart(pad(state, beside), light.clamp(*bounds))
