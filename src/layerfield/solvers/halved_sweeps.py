"""Sweeps at half size, then at whole size, where light is multiplied."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.half_size import HalfState, at_half_size, at_whole_size_of_products, half_of
from layerfield.problem import Problem
from layerfield.projection import Projection
from layerfield.solvers.fourier_start import FourierStart
from layerfield.solvers.sweeps import Sweeps, SweepsState

_SETS = 3  # of views


@dataclass(frozen=True)
class HalvedSweeps:
    """Find what is far apart at half size, and sweep over layers of whole size.

    At half size, where nine of 25 views are asked for, a sweep takes less than a tenth of the time.
    There steps on logarithms are the start. An iteration is `inner` sweeps at half size and one of
    whole size more; behind `early` ones, and from layers that are given, it is `later` sweeps of
    whole size.

    Before those of whole size come two sweeps with a third of the views each, no two of which stand
    side by side: what half size could not show is the same in all of them.

    Args:
        start: of layers of half size; its sweeps are not made.
        early: iterations that go on at half size.
        inner: sweeps of each there.
        later: sweeps of an iteration behind those.
        coarse: how to sweep at half size.
        fine: how to at whole size.
    """

    start: FourierStart
    early: int = 8
    inner: int = 10
    later: int = 2
    coarse: Sweeps = field(default_factory=lambda: Sweeps(momentum=0.95))
    fine: Sweeps = field(default_factory=Sweeps)

    def init(
        self, problem: Problem, start: HalfState | SweepsState | Tensor | None
    ) -> HalfState | SweepsState:
        if isinstance(start, HalfState):
            start = self._swept(problem, start) if start.count > 0 else None
        if start is not None:
            return self.fine.init(problem, start)
        half = half_of(problem)
        if half is None:
            raise ValueError("found no views whose paths lead through whole pixels of half size")
        small = at_half_size(problem, half)
        return HalfState(half, small, self.start.init(small, None))

    def step(self, problem: Problem, state: HalfState | SweepsState) -> HalfState | SweepsState:
        return self.steps(problem, state, 1)

    def steps(
        self, problem: Problem, state: HalfState | SweepsState, count: int
    ) -> HalfState | SweepsState:
        if isinstance(state, SweepsState):
            return replace(self.fine, sweeps=self.later * count).step(problem, state)
        early = min(count, self.early - state.count)
        coarse = replace(self.coarse, sweeps=self.inner * early)
        inner = coarse.step(state.problem, state.state)
        known = replace(state, state=inner, count=state.count + early)
        if early == count:
            return known
        return self.steps(problem, self._swept(problem, known), count - early)

    def layers(
        self, problem: Problem, state: HalfState | SweepsState
    ) -> Float[Tensor, "*batch 1 layer c ly lx"]:
        return (state if isinstance(state, SweepsState) else self._swept(problem, state)).layers

    def _begun(self, problem: Problem, known: HalfState) -> Tensor:
        found = self.coarse.layers(known.problem, known.state)
        layers = at_whole_size_of_products(problem, known.half, found, known.problem)
        return layers.clamp(*problem.bounds)

    def _swept(self, problem: Problem, known: HalfState) -> SweepsState:
        """Return layers of whole size, after as many sweeps as there were iterations."""
        state = self.fine.init(problem, self._begun(problem, known))
        if known.count == 0:
            return state
        for chosen in _sets_of(problem.projection)[:-1]:
            weights = tuple(w if n in chosen else 0.0 for n, w in enumerate(problem.weights))
            state = _plain(self.fine.step(replace(problem, weights=weights), state))
        # They count as one sweep: momentum begins with the second.
        begun = replace(state, count=torch.ones_like(state.count))
        return replace(self.fine, sweeps=known.count).step(problem, begun)


def _plain(state: SweepsState) -> SweepsState:
    """Return the state without momentum."""
    return replace(state, last=state.layers, push=torch.zeros_like(state.push))


def _sets_of(projection: Projection) -> Sequence[frozenset[int]]:
    """Return three sets of views, none of which stand side by side in a row or a column."""
    shifts = torch.tensor(projection.shifts)  # [view, layer, y x]
    far = int((shifts.amax(dim=0) - shifts.amin(dim=0)).sum(dim=-1).argmax())
    places = [torch.unique(shifts[:, far, n], return_inverse=True)[1] for n in range(2)]
    which = (torch.stack(places).sum(dim=0) % _SETS).tolist()
    return [frozenset(i for i, each in enumerate(which) if each == n) for n in range(_SETS)]
