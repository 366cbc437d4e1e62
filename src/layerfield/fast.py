"""The method `fast`: the direct solver with steps whose constants were learned.

They are learned for light that adds up and for light that multiplies, on random scenes and displays
of many kinds, and serve any number of views and layers at any spacing. A file of learned steps is
safetensors: `N.full`, `N.coarse` and `N.newton` hold the constants of N steps, a row each (of steps
on light that multiplies N are Newton's, behind `full` ones on logarithms), `N.relief.0` and those
after it the tensors of a `Relief`; the metadata say what they are for.
"""

import json
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from layerfield.display import Display
from layerfield.half_size import half_of
from layerfield.io.safe_output import whole_file
from layerfield.kernels import sweep_passes
from layerfield.links import LINKS, Link, Multiplicative
from layerfield.methods import RunOptions, SolverMethod
from layerfield.problem import Problem
from layerfield.row_system import row_reach, serves_products, serves_rows
from layerfield.shipped import TRAINED
from layerfield.solve import Solution, Solver
from layerfield.solvers.admm_steps import Constants
from layerfield.solvers.fourier_start import FourierStart
from layerfield.solvers.halved_sweeps import HalvedSweeps
from layerfield.solvers.learned_admm import LearnedAdmm
from layerfield.solvers.learned_sweeps import LearnedSweeps, serves_words
from layerfield.solvers.newton_admm import FourierNewton, NewtonAdmm
from layerfield.solvers.relief import Relief
from layerfield.solvers.row_gauss_newton import RowGaussNewton
from layerfield.solvers.row_newton import RowNewton
from layerfield.solvers.sweeps import Sweeps
from layerfield.solvers.warm_admm import WarmAdmm
from layerfield.weights import WEIGHT_SUFFIX

_KEY = "layerfield"  # of the metadata
_FAR, _FAR_OF_PRODUCTS = 24, 28  # unknowns that the matrix of a row reaches
_STEPS = 4  # unless told otherwise
_SWEEPS = 2  # of an iteration, where they are quick: better than a Newton step, and sooner
_BEFORE_WORDS = 2  # steps whose first is the only one where sweeps of words follow
_FEW = 4  # layers; of more, what half size tells is less, and sweeps of whole size are more
_FEW_VIEWS = 25  # 5x5


@dataclass(frozen=True)
class LearnedCard:
    """What a file of learned steps says of itself.

    Args:
        solver: `fast`.
        link: of the displays it serves.
        darkest: see `Multiplicative`.
        recipe: name of the recipe.
        training: facts: command, scenes, figures, versions.
    """

    solver: str
    link: str
    darkest: float
    recipe: str
    training: dict[str, Any]


@dataclass(frozen=True)
class StepConstants:
    """What a number of steps depends on: see `LearnedAdmm` and, for `newton`, `NewtonAdmm`."""

    full: Sequence[Constants]
    coarse: Sequence[Constants] = ()
    newton: Sequence[Constants] = ()
    relief: Relief | None = None

    @property
    def direct(self) -> LearnedAdmm:
        """The solver of what adds up."""
        return LearnedAdmm(self.full, self.coarse, self.relief)

    def tensors(self) -> dict[str, Tensor]:
        """Return all as tensors, by the names of their parts."""
        rows = {"full": self.full, "coarse": self.coarse, "newton": self.newton}
        found = {part: torch.tensor([list(each) for each in of]) for part, of in rows.items() if of}
        parts = self.relief.tensors if self.relief else ()
        return found | {f"relief.{n}": each.contiguous() for n, each in enumerate(parts)}

    @classmethod
    def of(cls, tensors: Mapping[str, Tensor]) -> "StepConstants":
        """Return what `tensors` were made from.

        Raises:
            TypeError: constants that are none.
            KeyError: parts that are none.
        """
        relief = [tensors[f"relief.{n}"] for n in range(sum("relief" in name for name in tensors))]
        rows = {name: each.tolist() for name, each in tensors.items() if "relief" not in name}
        known = {name: tuple(Constants(*row) for row in of) for name, of in rows.items()}
        return cls(**known, relief=Relief.of(relief) if relief else None)


@dataclass(frozen=True, eq=False)
class Learned:
    """Learned steps.

    Args:
        steps: the constants of so many steps.
        card: what its file says.
    """

    steps: Mapping[int, StepConstants]
    card: LearnedCard

    def at_most(self, count: int) -> StepConstants:
        """Return the constants of the largest number of steps that does not exceed a count.

        Of none, those of the smallest.
        """
        least = min(self.steps)
        return self.steps[max((n for n in self.steps if n <= count), default=least)]

    def solver(self, count: int) -> Solver:
        """Return what makes so many steps from views alone; others go on behind the last."""
        rows = self.at_most(count)
        if LINKS[self.card.link].is_sum:
            return rows.direct
        return FourierNewton(self.start(count), NewtonAdmm(rows.newton))

    def start(self, count: int) -> FourierStart:
        """Return what solves in logarithms before so many Newton steps, or before sweeps."""
        rows, dark = self.at_most(count), Multiplicative(darkest=self.card.darkest)
        return FourierStart(rows.direct, len(rows.full), nearly=dark)


def write_learned(path: Path, learned: Learned) -> None:
    """Write a file of learned steps, whole or not at all; an earlier one is replaced."""
    tensors = {
        f"{number}.{part}": tensor
        for number, known in learned.steps.items()
        for part, tensor in known.tensors().items()
    }
    with whole_file(path, force=True) as temporary:
        save_file(tensors, temporary, {_KEY: json.dumps(asdict(learned.card), sort_keys=True)})


def read_learned(path: Path) -> Learned:
    """Read a file of learned steps.

    Raises:
        ValueError: there is none, or it was not written by `write_learned`.
    """
    try:
        with safe_open(path, "pt") as file:
            card = LearnedCard(**json.loads((file.metadata() or {})[_KEY]))
            parts: dict[int, dict[str, Tensor]] = defaultdict(dict)
            for name in sorted(file.keys()):
                number, _, part = name.partition(".")
                parts[int(number)][part] = file.get_tensor(name)
        made = {number: StepConstants.of(known) for number, known in sorted(parts.items())}
    except FileNotFoundError:
        raise ValueError(f"there is no file {path}; expected learned steps") from None
    except (SafetensorError, KeyError, ValueError, TypeError, OSError):
        raise ValueError(f"{path} holds no learned steps; train them again") from None
    return Learned(made, card)


@lru_cache
def shipped_steps(name: str) -> Learned:
    """Return the learned steps that come with the package.

    Args:
        name: the link; `additive-warm`, see `warm_steps`; `multiplicative-rows`, see `steps_for`.
    """
    return read_learned(TRAINED / f"fast-{name}{WEIGHT_SUFFIX}")


def steps_for(problem: Problem) -> Learned:
    """Return the learned steps for a display.

    Where light is multiplied and views stand in a row there are others: rows of pixels that know
    nothing of each other have little of large pixels, and take more steps on logarithms instead.
    """
    rows = problem.projection.is_horizontal and not problem.link.is_sum
    return shipped_steps(f"{problem.link.name}-rows" if rows else problem.link.name)


def takes_rows(problem: Problem) -> bool:
    """Whether rows of pixels are solved as the small systems that they are.

    See `RowNewton` and `RowGaussNewton`: where views stand in a row, on a processor. A GPU would
    wait for one pixel of a row after the other. What a step costs grows with the square of what the
    matrix reaches; from some on, learned steps are as good sooner.
    """
    is_sum = problem.link.is_sum
    served, far = (serves_rows, _FAR) if is_sum else (serves_products, _FAR_OF_PRODUCTS)
    fits = problem.subframes == 1 and served(problem.projection)
    return fits and problem.device.type == "cpu" and row_reach(problem.projection) <= far


def takes_sweeps(problem: Problem) -> bool:
    """Whether sweeps are so quick that they follow the start where light is multiplied.

    Where light paths lead through whole pixels, two are made while a Newton step is.
    """
    if problem.device.type == "cpu":
        return problem.subframes == 1 and problem.projection.is_whole
    like = problem.views.like.new_empty(problem.subframes, 0, 0, 0, 0)
    return sweep_passes.serve_colours(problem.light_paths, like, problem.bounds)


def solver_for(problem: Problem, count: int) -> Solver:
    """Return what makes so many iterations for a display, or goes on from given layers."""
    if takes_rows(problem):
        return RowNewton() if problem.link.is_sum else RowGaussNewton()
    solver = steps_for(problem).solver(count)
    if isinstance(solver, LearnedAdmm) and serves_words(problem):
        return _with_sweeps(problem.layer_count, len(problem.projection.shifts))
    if not isinstance(solver, FourierNewton):
        return solver
    if not takes_sweeps(problem):
        return solver.start if problem.subframes > 1 else solver
    if problem.device.type == "cpu" and half_of(problem):
        return HalvedSweeps(steps_for(problem).start(1))
    return replace(solver.start, refine=Sweeps(sweeps=_SWEEPS))


@lru_cache
def _with_sweeps(layers: int, views: int) -> LearnedSweeps:
    """Return what sweeps in words, given how many layers and views there are.

    Where half size serves not, and of more than four layers there, it begins with the first step of
    two, however few iterations. The second would do no more than sweeps do, and cost as much as
    many of them. First steps of more go farther, but by softer penalties: layers of a scene that
    moves would move less alike. Of more views than 5x5 more sweeps are made at half size: without
    the views they are soon done, beside the sum of those.
    """
    known = shipped_steps("additive").at_most(_BEFORE_WORDS).direct
    solver = LearnedSweeps(replace(known, full=known.full[:1]))
    if layers > _FEW:
        return replace(solver, early=3, inner=8, outer=5, gray=0)
    return solver if views <= _FEW_VIEWS else replace(solver, inner=12, gray=60)


def warm_solver(problem: Problem, count: int) -> RowNewton | LearnedSweeps | WarmAdmm:
    """Return what makes a frame that starts from the one before, where light adds up.

    Rows that are solved by themselves have a penalty three times that of single pictures, which
    holds layers where they come from: on four videos they changed by 7 to 30 % less from frame to
    frame, and three steps left less than a percent. Sweeps in words go on from moved layers, with
    less momentum than behind steps: near the optimum it would make much of what words round.
    """
    if takes_rows(problem):
        return RowNewton(penalty=2e-3)
    solver = solver_for(problem, count)
    if isinstance(solver, LearnedSweeps):
        return replace(solver, momentum=0.8)
    return warm_steps(count)


def warm_steps(count: int) -> WarmAdmm:
    """Return the steps that were learned for frames that start from the one before."""
    return WarmAdmm(shipped_steps("additive-warm").at_most(count).full)


@dataclass(frozen=True)
class FastMethod(SolverMethod):
    """Learned steps; see `LearnedAdmm`.

    Where light adds up, an iteration is a step, or some sweeps at half and whole size (see
    `LearnedSweeps`). Where views stand in a row it is one of `RowNewton` or, of light that is
    multiplied, `RowGaussNewton`, of which nothing is learned (see `takes_rows`). Elsewhere, where
    light is multiplied, steps on logarithms are the start, at half size where that serves (see
    `HalvedSweeps`). An iteration is two sweeps where they are quick (see `takes_sweeps`), otherwise
    a Newton step, learned ones from given layers too; and of displays with subframes, which Newton
    steps do not serve, a sweep.
    """

    @classmethod
    def shipped(cls) -> "FastMethod":
        """Return the method with the steps that come with the package."""
        links = ("additive", "multiplicative")
        return cls("fast", "direct solver with learned steps", _STEPS, links, _learned)

    def run(self, problem: Problem, display: Display, options: RunOptions) -> Solution:
        solver = solver_for(problem, options.iterations)
        return SolverMethod.run(replace(self, make=lambda _: solver), problem, display, options)


def _learned(link: Link) -> Solver:
    return shipped_steps(link.name).solver(_STEPS)
