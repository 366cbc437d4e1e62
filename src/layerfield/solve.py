"""The one loop behind every solver: iterations, stopping, time limit, callback, history.

A solver is a frozen set of hyper-parameters with `init`, `step` and `layers`; its state is a value
passed along. An unrolled network calls `step` itself. One that has `steps`, too, is asked for
several at once, and for single ones where somebody looks at what is between.
"""

import math
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, NamedTuple, Protocol, cast, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.clock import Clock
from layerfield.memory import keep_large_blocks
from layerfield.problem import Problem

_AT_ONCE = 10  # iterations at once: between them the keyboard can interrupt
_LARGE = 1 << 20  # pixels of a layer: on a processor iterations take long, states much memory

State = Any  # each solver's own value, a tensor or a small dataclass


@runtime_checkable
class Solver(Protocol):
    """An iterative algorithm: frozen hyper-parameters, state passed along."""

    def init(self, problem: Problem, start: State | Tensor | None) -> State:
        """Return the first state: from nothing, from layers, or from a state of this solver."""
        ...

    def step(self, problem: Problem, state: State) -> State:
        """Return the state after one iteration."""
        ...

    def layers(
        self, problem: Problem, state: State
    ) -> Float[Tensor, "*batch subframe layer c ly lx"]:
        """Return the layers of a state, within the bounds of the problem."""
        ...


class OutlivesViews:
    """What states are that go on with other views: they hold no slope or error of these."""


@runtime_checkable
class MultiStep(Solver, Protocol):
    """One that makes several iterations sooner than one by one."""

    def steps(self, problem: Problem, state: State, count: int) -> State:
        """Return the state after so many iterations."""
        ...


class Progress(NamedTuple):
    """One line of history; `seconds` does not count the making of history itself."""

    iteration: int
    seconds: float
    mean_square_error: float


@dataclass(frozen=True, eq=False)
class Solution:
    """Layers and how they came about.

    Args:
        layers: light, 0 to 1; layer 0 nearest to the viewer, with the margin of the display.
        iterations: how many were made.
        seconds: spent in `init` and `step`.
        status: why it ended, a sentence.
        history: error after every iteration, if it was asked for.
        solver: what made it, and
        state: its last state, for a warm start.
        details: what else is worth recording, by name: plain numbers and texts.
        problem: what was solved, with its weights and targets: rounding goes on with it.
    """

    layers: Float[Tensor, "*batch subframe layer c ly lx"]
    iterations: int
    seconds: float
    status: str
    history: tuple[Progress, ...] = ()
    solver: Solver | None = None
    state: State = field(default=None, repr=False)
    details: Mapping[str, float | str] = field(default_factory=dict)
    problem: Problem | None = field(default=None, repr=False)


def solve(
    problem: Problem,
    solver: Solver,
    *,
    iterations: int,
    init: Solution | Tensor | None = None,
    tolerance: float = 0.0,
    time_limit: float = math.inf,
    callback: Callable[[int, State], None] | None = None,
    history: bool = False,
) -> Solution:
    """Run a solver.

    Args:
        problem: what to solve.
        solver: how.
        iterations: the most steps to take; 0 returns the start.
        init: layers, or a solution, whose state is taken up if such a solver made it for a problem
            posed alike, of the same views or, see `OutlivesViews`, of others; if not, its layers
            are. Layers are clamped.
        tolerance: stop when no layer pixel changes by more than this in a step; 0: never. That is
            found outside the clock.
        time_limit: start no step after this many seconds.
        callback: called with the iteration and the state after every step.
        history: record the mean square error of every iteration, outside the clock.

    Raises:
        ValueError: a negative number of iterations, or a start of the wrong shape.
    """
    if iterations < 0:
        raise ValueError(f"found {iterations} iterations, expected 0 or more")
    keep_large_blocks()
    clock = Clock(problem.device)
    watched = history or callback is not None or tolerance > 0 or time_limit < math.inf
    records: list[Progress] = []
    status = f"stopped after the {iterations} iterations asked for"
    done = 0
    is_large = math.prod(problem.layer_shape[-2:]) >= _LARGE and problem.device.type == "cpu"
    one_by_one = watched or is_large
    makes_several = _makes_several(type(solver)) and not one_by_one
    several = cast("MultiStep", solver) if makes_several else None
    # Where nobody looks at what is between, an accelerator is waited for once, not at every step.
    with nullcontext() if watched else clock:
        with torch.no_grad(), clock:
            state = solver.init(problem, _start(problem, solver, init))
            before = solver.layers(problem, state).clone() if tolerance > 0 else None
        while done < iterations:
            if clock.seconds > time_limit:
                status = f"stopped at the time limit of {time_limit:g} s"
                break
            count = 1 if several is None else min(_AT_ONCE, iterations - done)
            with torch.no_grad(), clock:
                if several is None:
                    state = solver.step(problem, state)
                else:
                    state = several.steps(problem, state, count)
                done += count
            if history:
                error = problem.mean_square_error(solver.layers(problem, state))
                records.append(Progress(done, clock.seconds, error))
            if callback is not None:
                callback(done, state)
            if before is not None:
                with torch.no_grad():
                    after = solver.layers(problem, state).clone()
                change, before = (after - before).abs().max().item(), after
                if change <= tolerance:
                    status = (
                        f"converged: no pixel changed by more than {tolerance:g}, iteration {done}"
                    )
                    break
        with clock:
            layers = solver.layers(problem, state)
    return Solution(
        layers, done, clock.seconds, status, tuple(records), solver, state, problem=problem
    )


@lru_cache
def _makes_several(kind: type) -> bool:
    """Whether such a solver is a `MultiStep`; to look takes as long as a small picture's step."""
    return issubclass(kind, MultiStep)


def _start(problem: Problem, solver: Solver, init: Solution | Tensor | None) -> State | Tensor:
    if isinstance(init, Solution) and type(init.solver) is type(solver):
        known = init.problem
        if known is None or _goes_on(init.state, known, problem):
            return init.state
    layers = init.layers if isinstance(init, Solution) else init
    if layers is None:
        return None
    if tuple(layers.shape) != problem.layer_shape:
        raise ValueError(
            f"the layers to start from have shape {tuple(layers.shape)}, expected "
            f"{problem.layer_shape} [subframe, layer, channel, y, x]"
        )
    return layers.detach().to(problem.views.like).clamp(*problem.bounds)


def _goes_on(state: State, known: Problem, problem: Problem) -> bool:
    """Whether a state of one problem serves another."""
    if not known.is_posed_as(problem) or known.layer_shape != problem.layer_shape:
        return False
    return isinstance(state, OutlivesViews) or known.views.show_as(problem.views)
