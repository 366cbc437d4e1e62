"""Training of learned steps: a hundred numbers, some hundred iterations of Adam, one core."""

import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import chain, cycle, islice
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.fast import Learned, LearnedCard, write_learned
from layerfield.io import whole_file
from layerfield.links import Multiplicative
from layerfield.problem import Problem
from layerfield.provenance import provenance
from layerfield.solve import solve
from layerfield.synthesizer import SOLVERS
from layerfield.training.checkpoint import Checkpoint, read_checkpoint, write_checkpoint
from layerfield.training.films import Film, FilmLesson, films, last_frames
from layerfield.training.learned_steps import LearnedSteps, squares
from layerfield.training.records import CHECKPOINT, RESULT, WEIGHTS, open_run
from layerfield.training.sources import first_seed, scenes
from layerfield.training.steps_recipe import StepsRecipe

_CPU = torch.device("cpu")
_NETWORK = 0.5  # rate of a network, of that of constants


def problems(recipe: StepsRecipe, purpose: str) -> list[Problem]:
    """Return the problems of a recipe: some scenes of every display by turns, for one purpose.

    Args:
        recipe: which.
        purpose: `training`, `validation` or `test`; they share no scene.
    """
    posed = []
    for n, grid in enumerate(recipe.displays):
        display = grid.display(recipe.link)
        seed = first_seed(purpose, recipe.seed) + n * recipe.scenes
        drawn = scenes(
            display, recipe.scenes, recipe.size, seed=seed, stretch=recipe.stretch, device=_CPU
        )
        generator = torch.Generator().manual_seed(seed)
        low, high = (math.log(end) for end in recipe.gammas)
        gammas = torch.empty(recipe.scenes).uniform_(low, high, generator=generator).exp()
        light = (drawn / 255.0) ** gammas[:, None, None, None, None]
        posed.append([Problem.of(display, part) for part in light.split(recipe.together)])
    return list(chain.from_iterable(zip(*posed, strict=True)))


def examples(recipe: StepsRecipe, purpose: str) -> list[Problem] | list[Film]:
    """Return what is learned from, or judged by: pictures, or videos."""
    return films(recipe, purpose) if recipe.frames > 1 else problems(recipe, purpose)


Lesson = Callable[[LearnedSteps], Tensor]


def lessons(recipe: StepsRecipe, posed: list[Problem] | list[Film]) -> list[Lesson]:
    """Return what is to be made small: for pictures that do not move, the logarithm of errors."""

    def of_problem(problem: Problem) -> Lesson:
        return lambda model: squares(problem, shown_by(recipe, model, problem)).log().mean()

    return [FilmLesson(each) if isinstance(each, Film) else of_problem(each) for each in posed]


def learn(
    recipe: StepsRecipe, model: LearnedSteps, given: list[Lesson], tick: Callable[[int], None]
) -> None:
    """Learn the constants of a model in one stage.

    Minimised is the mean logarithm of the mean square errors of scenes, PSNR but for its sign.

    Args:
        recipe: how; of the stage.
        model: the constants to begin with, and then what was learned.
        given: to train on, one after the other.
        tick: called with the number of iterations done.
    """
    groups: list[dict[str, Any]] = [{"params": [model.full, model.coarse, model.newton]}]
    if recipe.relief:
        groups.append({"params": list(model.relief), "lr": _NETWORK * recipe.rate})
    optimiser = torch.optim.Adam(groups, lr=recipe.rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, recipe.iterations)
    for done, lesson in enumerate(islice(cycle(given), recipe.iterations)):
        tick(done)
        loss = lesson(model)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()


def shown_by(
    recipe: StepsRecipe, model: LearnedSteps, problem: Problem
) -> Float[Tensor, "*batch 1 layer c ly lx"]:
    """Return layers for a problem, differentiable by the constants."""
    if problem.link.is_sum:
        return model(problem)
    known = replace(problem, link=Multiplicative(darkest=recipe.darkest))
    return model.behind(problem, problem.link.from_sum(model(known.in_sum_domain())))


@dataclass(frozen=True, kw_only=True)
class StepsRun:
    """A training of learned steps: a recipe and a place.

    Args:
        recipe: what to do.
        out: folder of the run.
        resume: go on behind the last number of steps that was finished in `out`.
        force: replace an earlier training in `out`.
        command: to be recorded.
        tick: called with a line and the share of the work that is done, of 100.
    """

    recipe: StepsRecipe
    out: Path
    resume: bool = False
    force: bool = False
    command: str = ""
    tick: Callable[[str, int], None] | None = None


def train_steps(run: StepsRun) -> dict[str, Any]:
    """Learn all constants of a recipe; return the facts of `OUT/result.json`.

    A number of steps is learned from nothing, so that a training which goes on after one of them
    ends as one that was never interrupted.

    Raises:
        ValueError: a folder that is not to be replaced, or a checkpoint of another recipe.
    """
    open_run(run.out, resume=run.resume, force=run.force)
    tensors, seconds = _known(run) if run.resume else ({}, 0.0)
    posed = [(stage, examples(stage, "training")) for stage in run.recipe.stages]
    for n, steps in enumerate(run.recipe.steps):
        if f"{steps}.full" not in tensors:
            began = time.monotonic()
            model = LearnedSteps(*run.recipe.rows(steps))
            for k, (stage, given) in enumerate(posed):
                learn(stage, model, lessons(stage, given), _ticker(run, n, k))
            seconds += time.monotonic() - began
            tensors |= {f"{steps}.{key}": value.detach() for key, value in model.named_parameters()}
            facts = {"recipe": run.recipe.model_dump(mode="json"), "seconds": seconds}
            write_checkpoint(run.out / CHECKPOINT, Checkpoint(tensors, facts))
    recipe = run.recipe
    models = {steps: _model(recipe, steps, tensors) for steps in recipe.steps}
    facts = {
        "command": run.command,
        "recipe": recipe.model_dump(mode="json"),
        "seconds": seconds,
        "figures": {name: _figures(recipe, models, name) for name in ("validation", "test")},
    } | provenance(_CPU)
    with whole_file(run.out / RESULT, force=True) as path:
        path.write_text(json.dumps(facts, indent=1), encoding="utf-8")
    made = {steps: model.rows() for steps, model in models.items()}
    card = LearnedCard(recipe.solver, recipe.link, recipe.darkest, recipe.name, facts)
    write_learned(run.out / WEIGHTS, Learned(made, card))
    return facts


def _known(run: StepsRun) -> tuple[dict[str, Tensor], float]:
    """Return what a training that was interrupted has learned."""
    found = read_checkpoint(run.out / CHECKPOINT)
    then, now = found.facts["recipe"], run.recipe.model_dump(mode="json")
    for key, value in now.items():
        if then.get(key) != value:
            raise ValueError(
                f"{run.out} was trained with another recipe: '{key}' was {then.get(key)}, now it "
                f"is {value}; give another --out"
            )
    return found.tensors, found.facts["seconds"]


def _model(recipe: StepsRecipe, steps: int, tensors: dict[str, Tensor]) -> LearnedSteps:
    model = LearnedSteps(*recipe.rows(steps))
    model.load_state_dict({key: tensors[f"{steps}.{key}"] for key in model.state_dict()})
    return model


def _ticker(run: StepsRun, number: int, stage: int) -> Callable[[int], None]:
    """Return what tells how far a training is; more steps on more pixels take longer."""
    recipe = run.recipe
    pixels = [each.together * each.size**2 for each in recipe.stages]
    work = [
        sum(recipe.rows(count)[:3]) * each * part.iterations
        for count in recipe.steps
        for part, each in zip(recipe.stages, pixels, strict=True)
    ]
    at = number * len(pixels) + stage

    def tick(done: int) -> None:
        if run.tick is not None:
            part = work[at] * done / recipe.stages[stage].iterations
            share = (sum(work[:at]) + part) / sum(work)
            run.tick(f"{recipe.name}, {recipe.steps[number]} steps", int(100 * share))

    return tick


@torch.no_grad()
def _figures(
    recipe: StepsRecipe, models: dict[int, LearnedSteps], purpose: str
) -> dict[str, dict[str, float]]:
    """Return mean PSNR, by number of steps, beside as many and more of the direct solver.

    Of videos, that is the last frame; the direct solver has none before it.
    """
    posed = examples(recipe.stages[-1], purpose)
    frames = [each.frames[-1] if isinstance(each, Film) else each for each in posed]
    moving = [each for each in posed if isinstance(each, Film)]

    def decibels(errors: list[Tensor]) -> float:
        return -10 * sum(each.log10().mean().item() for each in errors) / len(errors)

    def made_by(layers: Callable[[Problem], Tensor]) -> float:
        return decibels([squares(problem, layers(problem)) for problem in frames])

    direct = SOLVERS["fourier-admm"]
    counts = sorted({*recipe.steps, 10}) if frames[0].link.is_sum else [1, 2, 3]
    return {
        "fast": {
            str(steps): decibels(last_frames(moving, model))
            if moving
            else made_by(lambda p, m=model: shown_by(recipe, m, p))
            for steps, model in models.items()
        },
        "fourier-admm": {
            str(n): made_by(lambda p, n=n: solve(p, direct.make(p.link), iterations=n).layers)
            for n in counts
        },
    }
