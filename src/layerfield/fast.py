"""The method `fast`: the direct solver with steps whose constants were learned.

They are learned for light that adds up and for the logarithms of light that multiplies, on random
scenes and displays of many kinds, and serve any number of views and layers at any spacing. A file
of learned steps is safetensors: `N.full` and `N.coarse` hold the constants of N steps, a row each;
the metadata say what they are for.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from layerfield.display import Display
from layerfield.io.safe_output import whole_file
from layerfield.links import Link, Multiplicative
from layerfield.methods import RunOptions, SolverMethod
from layerfield.solve import Problem, Solution
from layerfield.solvers.fourier_start import FourierStart
from layerfield.solvers.learned_admm import Constants, LearnedAdmm
from layerfield.solvers.warm_admm import WarmAdmm
from layerfield.weights import TRAINED, WEIGHT_SUFFIX

_KEY = "layerfield"  # of the metadata
_PARTS = ("full", "coarse")


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


@dataclass(frozen=True, eq=False)
class Learned:
    """Learned steps.

    Args:
        steps: the solver that makes so many steps.
        card: what its file says.
    """

    steps: Mapping[int, LearnedAdmm]
    card: LearnedCard

    def at_most(self, count: int) -> LearnedAdmm:
        """Return the solver of the largest number of steps that does not exceed a count."""
        return self.steps[max(number for number in self.steps if number <= count)]


def write_learned(path: Path, learned: Learned) -> None:
    """Write a file of learned steps, whole or not at all; an earlier one is replaced."""
    tensors = {
        f"{number}.{part}": torch.tensor([list(asdict(row).values()) for row in rows])
        for number, solver in learned.steps.items()
        for part, rows in zip(_PARTS, (solver.full, solver.coarse), strict=True)
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
            rows = {
                name: [Constants(*row) for row in file.get_tensor(name).tolist()]
                for name in file.keys()  # noqa: SIM118
            }
        numbers = sorted({int(name.partition(".")[0]) for name in rows})
        made = {n: LearnedAdmm(rows[f"{n}.full"], rows[f"{n}.coarse"]) for n in numbers}
    except FileNotFoundError:
        raise ValueError(f"there is no file {path}; expected learned steps") from None
    except (SafetensorError, KeyError, ValueError, TypeError, OSError):
        raise ValueError(f"{path} holds no learned steps; train them again") from None
    return Learned(made, card)


@lru_cache
def shipped_steps(name: str) -> Learned:
    """Return the learned steps that come with the package.

    Args:
        name: the link; or `additive-warm`, see `warm_steps`.
    """
    return read_learned(TRAINED / f"fast-{name}{WEIGHT_SUFFIX}")


def warm_steps(count: int) -> WarmAdmm:
    """Return the steps of a frame that starts from the one before, where light adds up."""
    return WarmAdmm(shipped_steps("additive-warm").at_most(count).full)


@dataclass(frozen=True)
class FastMethod(SolverMethod):
    """Learned steps; see `LearnedAdmm`.

    Where light adds up, an iteration is a step. Where it is multiplied, all steps are the start,
    and an iteration is a sweep.
    """

    @classmethod
    def shipped(cls) -> "FastMethod":
        """Return the method with the steps that come with the package."""
        summary = "direct solver with learned steps; where light is multiplied followed by sweeps"
        links = ("additive", "multiplicative")
        return cls("fast", summary, 4, links, _before_sweeps)

    def run(self, problem: Problem, display: Display, options: RunOptions) -> Solution:
        known = shipped_steps(problem.link.name)
        if not problem.link.is_sum:
            return super().run(problem, display, options)
        solver = known.at_most(max(options.iterations, 1))
        return SolverMethod.run(replace(self, make=lambda _: solver), problem, display, options)


def _before_sweeps(link: Link) -> FourierStart:
    """Return what makes a start with all learned steps, in logarithms, then sweeps."""
    learned = shipped_steps(link.name)
    steps = max(learned.steps)
    dark = Multiplicative(darkest=learned.card.darkest)
    return FourierStart(learned.steps[steps], direct_iterations=steps, nearly=dark)
