"""Short videos to learn on how one frame follows from another."""

import math
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.display import Display
from layerfield.fast import shipped_steps
from layerfield.motion import block_motion
from layerfield.problem import Problem
from layerfield.scenes import animated, panned, travelled
from layerfield.solve import solve
from layerfield.solvers.warm_admm import Left, moved_start
from layerfield.stream import seen_from_the_middle
from layerfield.training.learned_steps import LearnedSteps, squares
from layerfield.training.sources import first_seed
from layerfield.training.steps_recipe import StepsRecipe

_KINDS = 4  # pan, noise, travel, animation
_FASTEST = 5  # pixels per frame
_LEAST_TRAVEL, _MOST_TRAVEL = 0.2, 3.0  # view steps per frame
_NOISIEST = 0.015
_AT_ONCE = 3  # frames whose errors are made small together


@dataclass(frozen=True, eq=False)
class Film:
    """Videos on a display, all of the same length.

    Args:
        frames: a problem for every frame, whose batch are the videos.
    """

    frames: list[Problem]

    @cached_property
    def evens(self) -> list[Float[Tensor, "video 1 layer c ly lx"]]:
        """The balanced start of every frame."""
        return [frame.even_start() for frame in self.frames]

    @cached_property
    def motions(self) -> dict[tuple[int, int], list[Float[Tensor, "2 ly lx"]]]:
        """The motion of every video from a frame to its neighbour, by their numbers."""
        seen = [seen_from_the_middle(frame) for frame in self.frames]
        numbers = range(len(seen))
        return {
            (new, old): [block_motion(*pair) for pair in zip(seen[new], seen[old], strict=True)]
            for new in numbers
            for old in (new - 1, new + 1)
            if old in numbers
        }

    def first(self) -> Left:
        """Return what the first frame leaves: after all learned steps from nothing."""
        known = shipped_steps("additive")
        steps = max(known.steps)
        made = solve(self.frames[0], known.solver(steps), iterations=steps)
        return self.unmoved(0, self.frames[0].gram.from_torus(made.state.shadow))

    def unmoved(self, number: int, state: Tensor) -> Left:
        """Return what a frame leaves that did not change what was carried to it."""
        return Left(state, self.evens[number], state.clamp(*self.frames[number].bounds))

    def follow(self, model: LearnedSteps, new: int, old: int, left: Left) -> Left:
        """Return what a frame leaves, given what its neighbour has left."""
        problem, motions = self.frames[new], self.motions[new, old]
        again, videos = model.again(problem.layer_count), zip(*left, strict=True)
        starts = [
            moved_start(even, Left(*each), motion, again=again, bounds=problem.bounds)
            for even, each, motion in zip(self.evens[new], videos, motions, strict=True)
        ]
        state, carried = (torch.stack(each) for each in zip(*starts, strict=True))
        return Left(model.onward(problem, state), self.evens[new], carried)


class FilmLesson:
    """A film that is played to and fro without end: states are those of the middle of a video."""

    def __init__(self, film: Film) -> None:
        self._film = film
        self._at, self._ahead = 0, 1
        self._left: Left | None = None

    def __call__(self, model: LearnedSteps) -> Tensor:
        """Return the mean logarithm of the errors of the next frames."""
        left = self._film.first() if self._left is None else self._left
        logs = []
        for _ in range(_AT_ONCE):
            left = self._next(model, left)
            problem = self._film.frames[self._at]
            logs.append(squares(problem, left.state.clamp(*problem.bounds)).log().mean())
        self._left = Left(*(each.detach() for each in left))
        return torch.stack(logs).mean()

    def _next(self, model: LearnedSteps, left: Left) -> Left:
        if not 0 <= self._at + self._ahead < len(self._film.frames):
            self._ahead = -self._ahead
            left = self._film.unmoved(self._at, left.state)  # what was ahead is behind now
        old, self._at = self._at, self._at + self._ahead
        return self._film.follow(model, self._at, old, left)


@torch.no_grad()
def last_frames(films: list[Film], model: LearnedSteps) -> list[Float[Tensor, " video"]]:
    """Return the mean square errors of the last frame of every video."""
    found = []
    for film in films:
        left = film.first()
        for n in range(1, len(film.frames)):
            left = film.follow(model, n, n - 1, left)
        last = film.frames[-1]
        found.append(squares(last, left.state.clamp(*last.bounds)))
    return found


def films(recipe: StepsRecipe, purpose: str) -> list[Film]:
    """Return the videos of a recipe: those of every display, for one purpose.

    Args:
        recipe: which.
        purpose: `training`, `validation` or `test`; they share no scene.
    """
    made = []
    for n, grid in enumerate(recipe.displays):
        display = grid.display(recipe.link)
        first = first_seed(purpose, recipe.seed) + n * recipe.scenes
        videos = [_video(display, recipe, first + k, k % _KINDS) for k in range(recipe.scenes)]
        frames = torch.stack(videos, dim=1)
        made.append(Film([Problem.of(display, frame) for frame in frames]))
    return made


def _video(
    display: Display, recipe: StepsRecipe, seed: int, kind: int
) -> Float[Tensor, "frame view 3 y x"]:
    generator = torch.Generator().manual_seed(seed)

    def between(low: float, high: float) -> float:
        return low + (high - low) * float(torch.rand((), generator=generator))

    def log_between(low: float, high: float) -> float:
        return math.exp(between(math.log(low), math.log(high)))

    facts = {
        "frames": recipe.frames, "size": (recipe.size, recipe.size), "seed": seed,
        "stretch": log_between(*recipe.stretch),
    }  # fmt: skip
    step = round(between(-_FASTEST, _FASTEST)), round(between(-_FASTEST, _FASTEST) / 2)
    if kind == 2:
        way = 1 if between(-1, 1) > 0 else -1
        views = travelled(display.geometry, way * log_between(_LEAST_TRAVEL, _MOST_TRAVEL), **facts)
    elif kind == 3:
        views = animated(display.geometry, between(0, _FASTEST), **facts)
    else:
        views = panned(display.geometry, step if kind == 0 else (step[0] // 2, 0), **facts)
    if kind == 1:
        views += between(0, _NOISIEST) * torch.randn(views.shape, generator=generator)
    codes = views.clamp_(0, 1).mul_(255).round_()
    return (codes / 255) ** log_between(*recipe.gammas)
