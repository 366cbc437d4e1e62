"""For viewpoints at different distances: the direct solver as if they shared one, then sweeps."""

from dataclasses import dataclass, field, replace

from jaxtyping import Float
from torch import Tensor

from layerfield.problem import Problem
from layerfield.solvers.fourier_start import FourierStart
from layerfield.solvers.sweeps import SweepsState


@dataclass(frozen=True)
class NearestShifts:
    """Solve for the shifts of all views without their magnifications, then sweep on both.

    An iteration is one sweep; the start is part of `init`. It is right at the centre of the views
    and off by a fraction of a pixel at their edges: light of low spatial frequency, which sweeps
    are slow to move between layers, is where it belongs, and more iterations would not help.

    Args:
        start: what makes the start, and the sweeps.
    """

    start: FourierStart = field(default_factory=lambda: FourierStart(direct_iterations=4))

    def init(self, problem: Problem, start: SweepsState | Tensor | None) -> SweepsState:
        near = replace(problem, projection=problem.projection.shifts_only)
        return self.start.init(near, start)

    def step(self, problem: Problem, state: SweepsState) -> SweepsState:
        return self.start.step(problem, state)

    def layers(
        self, problem: Problem, state: SweepsState
    ) -> Float[Tensor, "*batch subframe layer c ly lx"]:
        return self.start.layers(problem, state)
