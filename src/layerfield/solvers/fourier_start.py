"""For links that are no sum: the direct solver where they nearly are one, then sweeps."""

from dataclasses import dataclass, field, replace

from jaxtyping import Float
from torch import Tensor

from layerfield.links import Link
from layerfield.problem import Problem
from layerfield.solve import Solver, solve
from layerfield.solvers.fourier_admm import FourierAdmm
from layerfield.solvers.sweeps import Sweeps, SweepsState


@dataclass(frozen=True)
class FourierStart:
    """Solve the box-constrained problem where the link is a sum, go back, then sweep.

    That is on log max(L, 0.1) for a product, on 2/pi arcsin sqrt(L) for polarisation.

    An iteration is a step of the sweeps; the start is part of `init`.

    Args:
        direct: the solver in the domain where the link is a sum.
        direct_iterations: its iterations.
        refine: what follows, on the views as they are.
        nearly: the link whose domain is solved in, if not that of the problem: where a product
            takes dark light for brighter is a choice.
    """

    direct: Solver = field(default_factory=FourierAdmm)
    direct_iterations: int = 20
    refine: Sweeps = field(default_factory=Sweeps)
    nearly: Link | None = None

    @classmethod
    def suited(cls, link: Link) -> "FourierStart":
        """Return the settings for a link.

        Where it bends, sweeps are damped and dear (a sweep takes as long as fifteen direct
        iterations, for a product as long as four), so that a better start pays. Chosen on
        procedural scenes.
        """
        return cls(FourierAdmm(penalty=0.02), direct_iterations=40) if link.bend else cls()

    def init(self, problem: Problem, start: SweepsState | Tensor | None) -> SweepsState:
        return self.refine.init(problem, self.begun(problem) if start is None else start)

    def begun(self, problem: Problem) -> Float[Tensor, "*batch subframe layer c ly lx"]:
        """Return the start: what sweeps go on from."""
        known = replace(problem, link=self.nearly or problem.link)
        direct = solve(known.in_sum_domain(), self.direct, iterations=self.direct_iterations)
        layers = problem.link.from_sum(direct.layers)  # from 0 to 1
        if problem.bounds != (0.0, 1.0):
            layers = layers.clamp(*problem.bounds)
        return problem.in_subframes(layers)

    def step(self, problem: Problem, state: SweepsState) -> SweepsState:
        return self.refine.step(problem, state)

    def steps(self, problem: Problem, state: SweepsState, count: int) -> SweepsState:
        return self.refine.steps(problem, state, count)

    def layers(
        self, problem: Problem, state: SweepsState
    ) -> Float[Tensor, "*batch subframe layer c ly lx"]:
        return self.refine.layers(problem, state)
