"""The one loop behind every solver: iterations, stopping, time limit, callback, history.

A solver is a frozen set of hyper-parameters with `init`, `step` and `layers`; its state is a value
passed along. An unrolled network calls `step` itself. One that has `steps`, too, is asked for
several at once, and for single ones where somebody looks at what is between.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple, Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.back_projection import back_projected
from layerfield.clock import Clock
from layerfield.composition import compose_view
from layerfield.display import Display
from layerfield.display_constants import DisplayConstants, constants_of
from layerfield.gram import Gram
from layerfield.kept_views import KeptViews
from layerfield.kernels.codes import mean_of
from layerfield.kernels.compiled import serve
from layerfield.kernels.gpu.serving import on_gpu
from layerfield.kernels.light_paths import LightPaths
from layerfield.kernels.starts import shared_start
from layerfield.links import Additive, Link
from layerfield.memory import keep_large_blocks
from layerfield.pieces import Piece, pieces
from layerfield.projection import Projection

_SEED = 0  # of what makes subframes differ
_AT_ONCE = 10  # iterations at once: between them the keyboard can interrupt
_LARGE = 1 << 20  # pixels of a layer: on a processor iterations take long, states much memory
APART = 0.05  # how much they differ; on procedural scenes sweeps ended higher the less they did


@dataclass(frozen=True, eq=False)
class Problem:
    """Find layers within bounds that minimise sum_i w_i ||link_k (A_i P)_k - L_i||^2.

    Args:
        projection: A, from layers to views.
        link: what combines the layers.
        views: L, the views to be shown, as light; see `light`.
        weights: w, one for every view.
        bounds: the range of layer pixels.
        subframes: whose mean is seen.
    """

    projection: Projection
    link: Link
    views: KeptViews
    weights: tuple[float, ...]
    bounds: tuple[float, float] = (0.0, 1.0)
    subframes: int = 1

    @classmethod
    def of(
        cls, display: Display, target: Tensor | KeptViews, weights: Sequence[float] | None = None
    ) -> "Problem":
        """Pose the problem of showing views, as encoded in their files, on a display: in light.

        Raises:
            ValueError: not as many views or weights as viewpoints, or a negative weight.
        """
        count = display.view_count
        views = target if isinstance(target, KeptViews) else KeptViews(target)
        if views.stored.dtype in (torch.float16, torch.bfloat16):
            views = KeptViews(views.stored.float())  # there are no transforms of half precision
        if len(views) != count:
            raise ValueError(f"found {len(views)} views, display '{display.name}' expects {count}")
        chosen = tuple(float(w) for w in weights) if weights is not None else (1.0,) * count
        if len(chosen) != count or min(chosen) < 0 or not 0 < sum(chosen) < math.inf:
            raise ValueError(f"expected {count} view weights, at least 0 and not all 0")
        light = views.then(display.transfer.decode)
        return cls(display.projection, display.link, light, chosen, subframes=display.subframes)

    def in_sum_domain(self) -> "Problem":
        """Return the problem in the domain where the link is a sum (logarithms for a product)."""
        views = self.views.then(self.link.to_sum)
        return Problem(
            self.projection, Additive(), views, self.weights, bounds=self.link.sum_bounds
        )

    def pieces(self) -> Iterator[tuple["Problem", Piece]]:
        """Return the problem piece by piece, for what adds up view by view; see `Piece`."""
        for piece in pieces(self.projection, self.views, self.subframes):
            yield replace(self, views=piece.of_views(self.views)), piece

    def is_posed_as(self, other: "Problem") -> bool:
        """Whether but for what the views show, and how many there are at once, both are one."""

        def posed(problem: Problem) -> tuple:
            known = (problem.projection, problem.link, problem.weights, problem.bounds)
            return *known, problem.subframes, problem.layer_shape[-5:], problem.views.like.dtype

        return posed(self) == posed(other)

    def light(self, index: int) -> Float[Tensor, "*batch c y x"]:
        """Return what one view is to show."""
        return self.views.view(index)

    @cached_property
    def target(self) -> Float[Tensor, "*batch view c y x"]:
        """What all views are to show: floats, where `light` is sparing of memory."""
        return self.views.all()

    @property
    def device(self) -> torch.device:
        """Where the views are."""
        return self.views.stored.device

    @property
    def layer_shape(self) -> tuple[int, ...]:
        """Shape of the layers: *batch, subframe, layer, channel, y, x."""
        *batch, _, channels, _, _ = self.views.stored.shape
        size = self.projection.layer_size(self.views.stored)
        return (*batch, self.subframes, self.layer_count, channels, *size)

    @property
    def layer_count(self) -> int:
        """Number of layers."""
        return len(self.projection.shifts[0])

    @property
    def view_size(self) -> tuple[int, int]:
        """Height and width of the views."""
        return self.views.stored.shape[-2], self.views.stored.shape[-1]

    @cached_property
    def constants(self) -> DisplayConstants:
        """What problems posed alike have in common."""
        like = self.views.like
        posed = (self.projection, self.weights, self.view_size)
        return constants_of(*posed, like.dtype, like.device)

    @property
    def gram(self) -> Gram:
        """A^T M W A, what a sum link makes of layers."""
        return self.constants.gram

    @cached_property
    def back_projected(self) -> Float[Tensor, "*batch 1 layer c ly lx"]:
        """A^T W L: all that a sum link needs to know of the views."""
        return back_projected(self.projection, self.views, self.weights).unsqueeze(-5)

    @property
    def light_paths(self) -> LightPaths:
        """From the layers to the views."""
        return LightPaths(self.projection, self.link, self.views, self.weights)

    @property
    def coverage(self) -> Float[Tensor, "layer 1 ly lx"]:
        """A^T W 1: the weight of the views that see a layer pixel; 0 where nobody looks."""
        return self.constants.coverage

    def view(
        self, layers: Float[Tensor, "*batch subframe layer c ly lx"], index: int
    ) -> Float[Tensor, "*batch c y x"]:
        """Return what one view shows of layers, unclipped."""
        return compose_view(layers, self.projection, self.link, index)

    def mean_square_error(self, layers: Float[Tensor, "*batch subframe layer c ly lx"]) -> float:
        """Return the weighted mean square error of unclipped views, pooled over all pixels."""
        total = 0.0
        for i, weight in enumerate(self.weights):
            residual = self.view(layers, i) - self.light(i)
            total += weight * residual.double().square().mean().item()
        return total / sum(self.weights)

    @property
    def even_shares(
        self,
    ) -> tuple[Float[Tensor, "layer 1 ly lx"], Float[Tensor, "*batch 1 1 c 1 1"]]:
        """What A^T W L is multiplied by for the balanced start, and what is taken where that is 0.

        The mean of the views is that of the first layer's light over its coverage.
        """
        first = self.back_projected[..., :1, :, :, :]
        rest = first.sum(dim=(-2, -1), keepdim=True) * self.constants.mean_share
        return self.constants.even_shares, rest

    def even_start(
        self, size: tuple[int, int] | None = None, *, rim: bool = False
    ) -> Float[Tensor, "*batch 1 layer c ty tx"]:
        """Return the balanced start: every layer shows what its viewers see on average, shared.

        z_k = A_k^T W L / (A_k^T W 1) / K. Pixels that nobody sees take the mean of the
        views over K.

        Args:
            size: of a torus, on which the layers are, and 0 beside them.
            rim: no more is needed than what the band depends on, see `Gram`. On a GPU other
                pixels are then what was in memory.
        """
        shares, rest = self.even_shares
        height, width = self.layer_shape[-2:]
        ty, tx = size or (height, width)
        if on_gpu(self.back_projected):
            from layerfield.kernels.gpu.blends import even_start  # noqa: PLC0415  needs Triton

            (rows, columns), (my, mx) = self.view_size, self.projection.margin
            # No path meets those pixels that ends beside a view.
            spared = (2 * my, rows, 2 * mx, columns) if rim else (0, 0, 0, 0)
            return even_start(self.back_projected, shares, rest, (ty, tx), spared)
        if serve(self.back_projected):
            return shared_start(self.back_projected, shares, rest, (ty, tx))
        start = torch.where(shares > 0, self.back_projected * shares, rest)
        return torch.nn.functional.pad(start, (0, tx - width, 0, ty - height))

    def flat_start(self, apart: float = APART) -> Float[Tensor, "*batch subframe layer c ly lx"]:
        """Return the classical start: constant layers that together show the mean of the views.

        Subframes differ by random factors, 1 - apart to 1 + apart.
        """
        mean = _mean_of(self.views.then(self.link.to_sum)) / self.layer_count
        *batch, _, layers, channels, height, width = self.layer_shape
        shape = (*batch, 1, layers, channels, height, width)
        start = self.link.from_sum(mean)[(..., *[None] * 5)].expand(shape)
        return self.in_subframes(start.clamp(*self.bounds).clone(), apart)

    def in_subframes(
        self, layers: Float[Tensor, "*batch 1 layer c ly lx"], apart: float = APART
    ) -> Float[Tensor, "*batch subframe layer c ly lx"]:
        """Return a start for all subframes from one for a single one.

        Equal subframes would stay equal, so pixels are multiplied by random factors, 1 - apart to
        1 + apart, which depend on the size of the layers alone.
        """
        if self.subframes == 1:
            return layers
        generator = torch.Generator().manual_seed(_SEED)
        shape = (self.subframes, *layers.shape[-4:])
        factors = 1 + apart * (2 * torch.rand(shape, generator=generator).to(layers) - 1)
        return (layers * factors).clamp(*self.bounds)


def _mean_of(views: KeptViews) -> Float[Tensor, "*batch"]:
    if views.is_whole and serve(views.levels):
        return mean_of(views.stored, views.levels).to(views.levels)
    return views.mean()


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
    several = solver if isinstance(solver, MultiStep) and not one_by_one else None
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
