"""Light field video: every frame starts from what is left of the one before.

The state of a solver, s (the layers, for the direct solver also their dual), moves as the picture
does, and the share of it that follows from the views at once is that of the new views:

    s_new(p) = e_new(p) + (s - e)(p + m)

with e the balanced start, every layer the mean of what its viewers see, and m the motion of e from
frame to frame, found by block matching. What comes into the picture starts from e_new alone.
Without m the dual holds pixels at bounds that have moved on, and a start can be worse than none.
Where the direct solver makes the start of every run and sweeps follow (links that are no sum),
that start is better than moved layers: each frame has its own, and fewer sweeps.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.display import Display
from layerfield.light_field import LightField
from layerfield.methods import Method, RunOptions, SolverMethod, ToneMethod
from layerfield.motion import block_motion, moved
from layerfield.solve import Clock, Problem, Solution
from layerfield.solvers.fourier_admm import AdmmState
from layerfield.solvers.fourier_start import FourierStart
from layerfield.solvers.nearest_shifts import NearestShifts
from layerfield.synthesizer import find_method, pose

WARM_ITERATIONS = 3
_CUT = 0.3  # share of the variance of a frame that the one before, moved, does not explain
_DARKEST = 1e-3  # layers darker than this move as if they were this bright


@dataclass(frozen=True, eq=False)
class _Frame:
    """A frame that was solved, and what the next one needs of it."""

    even: Float[Tensor, "1 layer c ly lx"]
    solution: Solution


def synthesize_frames(
    fields: Iterable[LightField],
    display: Display,
    *,
    method: str = "fourier-admm",
    iterations: int = WARM_ITERATIONS,
    weights: Sequence[float] | None = None,
) -> Iterator[Solution]:
    """Make the layers of one frame after the other, each as soon as its light field is there.

    The first frame, and the first after a cut, take the iterations that the method makes of
    itself; networks, and what follows them, start anew in every frame. No more than the frame
    before is kept. `Solution.details` says what a frame started from: "start" is "cold", "cut" or
    "moved"; "unexplained" is the share of the variance of a frame that the moved one before lacks.

    Args:
        fields: the frames, all of one size.
        display: what shows them.
        method: one of `METHODS`, a weight file, or NETWORK+SOLVER.
        iterations: of every frame that has one before.
        weights: how much each view counts, at least 0; all alike if not given. For solvers.

    Raises:
        ValueError: an unknown method, one that does not serve the display, a frame whose views are
            not those of the display, or one of another size than the first.
    """
    if iterations < 0:
        raise ValueError(f"found {iterations} iterations a frame, expected 0 or more")
    found = find_method(method)
    found.refuse_unserved(display)
    return _frames(fields, display, found, RunOptions(iterations, weights=weights))


def _frames(
    fields: Iterable[LightField], display: Display, method: Method, options: RunOptions
) -> Iterator[Solution]:
    before, shape = None, None
    for field in fields:
        shape = shape or field.views.shape
        _refuse_other_shape(field, shape)
        problem = pose(field, display, options.weights)
        if isinstance(method, SolverMethod):
            before = _next_frame(before, problem, display, method, options)
            yield before.solution
        else:
            cold = method.run(problem, display, replace(options, iterations=method.iterations))
            yield _noted(cold, problem, start="cold")


def _refuse_other_shape(field: LightField, shape: tuple[int, ...]) -> None:
    if field.views.dim() != 4:
        raise ValueError(
            f"'{field.name}' is a batch of shape {tuple(field.views.shape)}, expected one light "
            "field [view, channel, y, x] a frame"
        )
    if field.views.shape != shape:
        raise ValueError(
            f"'{field.name}' has views of shape {tuple(field.views.shape)}, the first frame had "
            f"{tuple(shape)}; start another video where the size changes"
        )


def _next_frame(
    before: _Frame | None,
    problem: Problem,
    display: Display,
    method: SolverMethod,
    options: RunOptions,
) -> _Frame:
    clock, start, share, follows = Clock(problem.target.device), None, None, False
    with torch.no_grad(), clock:
        even = problem.in_sum_domain().even_start()
        if before is not None:
            motion = block_motion(_grey(even), _grey(before.even))
            share = _unexplained(even, before.even, motion)
            follows = share <= _CUT
            if follows and not _starts_itself(method, before):
                start = _started(before, even, motion, problem)
    made = options.iterations if follows else method.count(None)
    run = method.run(problem, display, replace(options, init=start, iterations=made))
    details = {} if share is None else {"unexplained": share}
    kind = "moved" if start is not None else "cold" if follows or before is None else "cut"
    timed = replace(run, seconds=run.seconds + clock.seconds)
    return _Frame(even, _noted(timed, problem, start=kind, **details))


def _starts_itself(method: SolverMethod, before: _Frame) -> bool:
    """Whether the direct solver makes the start of every run, before sweeps."""
    solver = before.solution.solver
    return isinstance(method, ToneMethod) or isinstance(solver, FourierStart | NearestShifts)


def _noted(solution: Solution, problem: Problem, **details: float | str) -> Solution:
    noted = {**solution.details, **details}
    return replace(solution, problem=solution.problem or problem, details=noted)


def _grey(even: Float[Tensor, "1 layer c ly lx"]) -> Float[Tensor, "layer ly lx"]:
    """All layers, as bright as the views: each is sharp where things are near it."""
    return even[0].mean(dim=1) * even.shape[1]


def _unexplained(even: Tensor, old: Tensor, motion: Tensor) -> float:
    """Return the variance of what motion leaves over the variance of the frame."""
    left = _grey(even) - moved(_grey(old), motion)
    seen = moved(torch.ones_like(left), motion) > 0
    spread = _grey(even) - _grey(even).mean(dim=(-2, -1), keepdim=True)
    return (left[seen].square().mean() / spread.square().mean().clamp(min=1e-8)).item()


def _started(
    before: _Frame, even: Tensor, motion: Tensor, problem: Problem
) -> Solution | Float[Tensor, "subframe layer c ly lx"]:
    """Return what the next frame starts from: a state of the direct solver, otherwise layers."""
    state = before.solution.state
    if isinstance(state, AdmmState):
        gram = problem.gram
        shadow = even + moved(gram.from_torus(state.shadow) - before.even, motion)
        return replace(before.solution, state=replace(state, shadow=gram.to_torus(shadow)))
    link = problem.link
    sums = _to_sum(before.solution.layers, problem) - before.even
    return link.from_sum(even + moved(sums, motion)).clamp(*problem.bounds)


def _to_sum(layers: Tensor, problem: Problem) -> Tensor:
    """Return layers where the link is a sum, not floored as views are: undoes `from_sum`."""
    multiplies = problem.link.sum_bounds[1] == 0
    return layers.clamp(min=_DARKEST).log() if multiplies else layers
