"""Light field video: every frame starts from what is left of the one before.

The state of a solver, s (the layers, for the direct solver also their dual), moves as the picture
does, and the share of it that follows from the views at once is that of the new views:

    s_new(p) = e_new(p) + (s - e)(p + m)

with e the balanced start, every layer the mean of what its viewers see, and m the motion of what
the middle of the viewers sees, found by block matching. What comes into the picture has the state
that pixels near there have. Without m the dual holds pixels at bounds that have moved on, and a
start can be worse than none. Where light adds up, `fast` has steps that were learned for such a
start, and goes on where the steps of the frame before went: see `WarmAdmm`. Where views stand in
a grid and look at whole pixels, on a processor, it sweeps on from moved layers: see
`LearnedSweeps`; where they stand in a row it solves from there for whole rows: see `RowNewton`.
Where the direct solver makes the start of every run and sweeps or Newton steps follow (links that
are no sum), that start is better than moved layers: each frame has its own, and fewer of those.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import pad

from layerfield.clock import Clock
from layerfield.display import Display
from layerfield.fast import FastMethod, takes_rows, warm_solver
from layerfield.light_field import LightField
from layerfield.methods import Method, RowsMethod, RunOptions, SolverMethod, ToneMethod
from layerfield.motion import block_motion, comes_from_inside, moved
from layerfield.problem import Problem
from layerfield.solve import Solution, Solver
from layerfield.solvers.fourier_admm import AdmmState
from layerfield.solvers.fourier_start import FourierStart
from layerfield.solvers.learned_admm import LearnedState
from layerfield.solvers.learned_sweeps import LearnedSweeps
from layerfield.solvers.nearest_shifts import NearestShifts
from layerfield.solvers.warm_admm import Left, WarmAdmm, moved_start
from layerfield.synthesizer import find_method, pose

WARM_ITERATIONS = 3
_FIRST = 20  # iterations at least, where later frames live on what is made
_RUN_IN = 8  # frames until the start of a video is forgotten, but for scenes that stand still
_CUT = 0.3  # share of the variance of a frame that the one before, moved, does not explain
_AGAIN = 0.7  # momentum from frame to frame, of sweeps
_DARKEST = 1e-3  # layers darker than this move as if they were this bright


@dataclass(frozen=True, eq=False)
class _Frame:
    """A frame that was solved, and what the next one needs of it.

    Args:
        picture: what the middle of the viewers sees.
        even: its balanced start; None where frames start themselves.
        solution: of it.
        carried: the layers that were carried to it from the one before, see `WarmAdmm`, or those of
            its solution.
    """

    picture: Float[Tensor, "ly lx"]
    even: Float[Tensor, "1 layer c ly lx"] | None
    solution: Solution
    carried: Float[Tensor, "subframe layer c ly lx"]


def synthesize_frames(
    fields: Iterable[LightField],
    display: Display,
    *,
    method: str = "fast",
    iterations: int = WARM_ITERATIONS,
    weights: Sequence[float] | None = None,
) -> Iterator[Solution]:
    """Make the layers of one frame after the other, each as soon as its light field is there.

    The first frame, and the first after a cut, take the iterations that the method makes of itself,
    or twenty where that is further from the optimum than frames come with time; networks, and what
    follows them, start anew in every frame. No more than the frame before is kept.
    `Solution.details` says what a frame started from: "start" is "cold", "cut" or "moved";
    "unexplained" is the share of the variance of a frame that the moved one before lacks.

    Args:
        fields: the frames, all of one size.
        display: what shows them.
        method: one of `METHODS`, a weight file, or NETWORK+SOLVER.
        iterations: of every frame that has one before; those of `fast` are learned up to
            eight.
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
        shape = shape or field.stored.shape
        _refuse_other_shape(field, shape)
        problem = pose(field, display, options.weights)
        if isinstance(method, SolverMethod):
            before = _next_frame(before, problem, display, method, options)
            yield before.solution
        else:
            cold = method.run(problem, display, replace(options, iterations=method.iterations))
            yield _noted(cold, problem, start="cold")


def run_in(method: Method, display: Display) -> int:
    """Return how many frames to make first, and throw away, where a video is begun in its middle.

    Behind them frames are nearly those of a video that was begun earlier. Where every frame makes
    its own start it is one, so that none has more iterations than others; of networks none.
    """
    if not isinstance(method, SolverMethod):
        return 0
    return 1 if _starts_itself(method, display) else _RUN_IN


def _refuse_other_shape(field: LightField, shape: tuple[int, ...]) -> None:
    if field.stored.dim() != 4:
        raise ValueError(
            f"'{field.name}' is a batch of shape {tuple(field.stored.shape)}, expected one light "
            "field [view, channel, y, x] a frame"
        )
    if field.stored.shape != shape:
        raise ValueError(
            f"'{field.name}' has views of shape {tuple(field.stored.shape)}, the first frame had "
            f"{tuple(shape)}; start another video where the size changes"
        )


def _next_frame(
    before: _Frame | None,
    problem: Problem,
    display: Display,
    method: SolverMethod,
    options: RunOptions,
) -> _Frame:
    clock, start, carried, details = Clock(problem.device), None, None, {}
    moves = not _starts_itself(method, display)
    lives_on = moves and not _solves_rows(method, problem)
    made, count = method, max(method.count(None), _FIRST if lives_on else 0)
    with torch.no_grad(), clock:
        picture = seen_from_the_middle(problem)
        even = _summed(problem).even_start() if moves else None
        if before is not None:
            motion = block_motion(picture, before.picture)
            details["unexplained"] = _unexplained(picture, before.picture, motion)
            if details["unexplained"] <= _CUT:
                count = options.iterations
                if even is not None:
                    made = _warm(method, problem, count)
                    solver = made.make(display.link)
                    start, carried = _started(before, problem, even, motion, solver)
    run = made.run(problem, display, replace(options, init=start, iterations=count))
    cut = details.get("unexplained", 0.0) > _CUT
    details["start"] = "cut" if cut else "cold" if start is None else "moved"
    timed = replace(run, seconds=run.seconds + clock.seconds)
    left = run.layers if carried is None else carried
    return _Frame(picture, even, _noted(timed, problem, **details), left)


def _starts_itself(method: SolverMethod, display: Display) -> bool:
    """Whether the direct solver makes the start of every run, before what refines it."""
    if isinstance(method, FastMethod):
        return not display.link.is_sum
    made = method.make if display.geometry.is_regular else method.apart
    solver = made(display.link) if made is not None else None
    return isinstance(method, ToneMethod) or isinstance(solver, FourierStart | NearestShifts)


def _solves_rows(method: SolverMethod, problem: Problem) -> bool:
    """Whether rows are solved by themselves, and are soon at the optimum."""
    is_fast = isinstance(method, FastMethod)
    return isinstance(method, RowsMethod) or (is_fast and takes_rows(problem))


def _summed(problem: Problem) -> Problem:
    return problem if problem.link.is_sum else problem.in_sum_domain()


def _warm(method: SolverMethod, problem: Problem, count: int) -> SolverMethod:
    """Return what makes the frames that have one before."""
    if not isinstance(method, FastMethod):
        return method
    solver = warm_solver(problem, max(count, 1))
    return SolverMethod(method.name, method.summary, count, method.links, lambda _: solver)


def _noted(solution: Solution, problem: Problem, **details: float | str) -> Solution:
    noted = {**solution.details, **details}
    return replace(solution, problem=solution.problem or problem, details=noted)


def seen_from_the_middle(problem: Problem) -> Float[Tensor, "*batch ly lx"]:
    """Return what the middle of the viewers sees, grey, continued over the margin of layers."""
    reach = [sum(abs(x) + abs(y) for x, y in paths) for paths in problem.projection.shifts]
    middle = problem.light(reach.index(min(reach))).mean(dim=-3)
    my, mx = problem.projection.margin
    planes = middle.reshape(-1, *middle.shape[-2:])
    whole = pad(planes, (mx, mx, my, my), mode="replicate")
    return whole.reshape(*middle.shape[:-2], *whole.shape[-2:])


def _unexplained(new: Tensor, old: Tensor, motion: Tensor) -> float:
    """Return the variance of what motion leaves over the variance of the picture.

    Infinite where all comes from outside, as may be in pictures of a few pixels.
    """
    seen = comes_from_inside(motion)
    left = ((new - moved(old, motion)) * seen).square().sum() / seen.sum()
    return (left / new.var().clamp(min=1e-8)).item() if seen.any() else math.inf


def _started(
    before: _Frame, problem: Problem, even: Tensor, motion: Tensor, solver: Solver
) -> tuple[Solution | Tensor, Tensor]:
    """Return what the next frame starts from: a state of the direct solver, otherwise layers.

    And the layers that were carried to it.
    """
    state, solution = before.solution.state, before.solution
    assert before.even is not None  # frames do not start themselves
    again = _momentum(solver, problem.layer_count)
    if type(state) in (LearnedState, AdmmState):  # that of tiles is on a torus of its own
        left = Left(state.shadow, before.even, before.carried)
        start = moved_start(even, left, motion, again=again, size=problem.gram.torus)
        is_warm = isinstance(solver, WarmAdmm)
        known = LearnedState(start.state) if is_warm else replace(state, shadow=start.state)
        return replace(solution, solver=solver, state=known), start.carried
    layers, bounds = _to_sum(solution.layers, problem), problem.link.sum_bounds
    left = Left(layers, before.even, before.carried)
    start = moved_start(even, left, motion, again=again, bounds=bounds)
    return problem.link.from_sum(start.state).clamp(*problem.bounds), start.carried


def _momentum(solver: Solver, layers: int) -> float:
    """Return how much of what the frame before has changed is changed once more."""
    if isinstance(solver, WarmAdmm):
        return solver.again(layers)
    return _AGAIN if isinstance(solver, LearnedSweeps) else 0.0


def _to_sum(layers: Tensor, problem: Problem) -> Tensor:
    """Return layers where the link is a sum, not floored as views are: undoes `from_sum`."""
    multiplies = problem.link.sum_bounds[1] == 0
    return layers.clamp(min=_DARKEST).log() if multiplies else layers
