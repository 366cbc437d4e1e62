"""Where training samples come from; every batch is a function of the seed and its step.

A sample is one colour channel of a patch of a light field, `[view, y, x]`. Because nothing depends
on what was drawn before, a training that is resumed sees what one that was never interrupted would.
"""

import hashlib
import inspect
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from layerfield.display import Display
from layerfield.io import FieldOptions, load_light_field
from layerfield.nearest import did_you_mean
from layerfield.scenes import render, scenes_for
from layerfield.synthesizer import pose
from layerfield.training.recipe import Cut, DrawnScenes, FieldFolder, Recipe, StoredScenes, Stretch

# Seeds of scenes, apart from each other whatever the recipe's seed, which is below 2^8. PyTorch
# takes the lowest 32 bits of a seed.
_TRAINING, _VALIDATION, _TEST = 0, 2**30, 2**31
_ROOM = 2**20  # scenes of one seed
_BATCH = 8  # scenes rendered at once

_PURPOSES = {"training": _TRAINING, "validation": _VALIDATION, "test": _TEST}

Samples = Float[Tensor, "sample view y x"]


@runtime_checkable
class Source(Protocol):
    """Training samples."""

    def steps(self, batch: int) -> int:
        """Steps of an epoch with batches of this size."""
        ...

    def batch(self, step: int, count: int) -> Samples:
        """Return the samples of a step; the same ones whenever they are asked for."""
        ...

    def facts(self) -> dict[str, int | str]:
        """Return what a report says of the data."""
        ...

    def sets(self, recipe: Recipe) -> dict[str, Float[Tensor, "scene view c y x"]]:
        """Return what a network is judged on: `validation`, `test` and, if finite, `train`."""
        ...


def first_seed(purpose: str, seed: int) -> int:
    """Return the seed of the first scene for a purpose: `training`, `validation` or `test`."""
    return _PURPOSES[purpose] + seed * _ROOM


def scenes(
    display: Display, count: int, size: int, *, seed: int, stretch: Stretch, device: torch.device
) -> UInt8[Tensor, "scene view 3 y x"]:
    """Return 8-bit views of procedural scenes, seed for seed the same ones.

    Args:
        display: whose viewpoints and depth they have.
        count: how many.
        size: height and width, pixels.
        seed: of the first.
        stretch: range of disparities, in units of the depth of the display; every scene draws its
            own from a pair.
        device: where they are drawn.
    """
    parts = []
    at_once = 1 if isinstance(stretch, tuple) else _BATCH
    for first in range(seed, seed + count, at_once):
        drawn = scenes_for(
            display.geometry, min(at_once, seed + count - first), size=(size, size), seed=first,
            stretch=_stretch_of(first, *stretch) if isinstance(stretch, tuple) else stretch,
            device=device,
        )  # fmt: skip
        parts.append(render(drawn, display.geometry.slopes).mul(255).round().to(torch.uint8))
    return torch.cat(parts)


def _stretch_of(seed: int, low: float, high: float) -> float:
    """The stretch of a scene, evenly spread in its logarithm."""
    return low * (high / low) ** torch.rand((), generator=_generator(seed, 0)).item()


def fresh_sets(display: Display, recipe: Recipe) -> dict[str, Float[Tensor, "scene view 3 y x"]]:
    """Return scenes of validation and of test, values 0 to 1; the same for all seeds."""
    chosen, device = recipe.judging, torch.device("cpu")
    return {
        name: scenes(
            display, chosen.scenes, chosen.size, seed=seed, stretch=chosen.stretch, device=device
        ).float()
        / 255
        for name, seed in (("validation", _VALIDATION), ("test", _TEST))
    }


def source_of(recipe: Recipe, display: Display, folder: Path, device: torch.device) -> Source:
    """Return the training data of a recipe.

    Args:
        recipe: which.
        display: that is trained for.
        folder: that paths in the recipe are relative to.
        device: where scenes are drawn.

    Raises:
        ValueError: a folder that is missing or holds no light field of the display's views.
    """
    if recipe.stored is not None:
        return Stored(recipe.stored, display, recipe.seed)
    grid = _square_grid(display) if recipe.symmetries else None
    drawn, given = recipe.drawn, recipe.fields
    if drawn is not None:
        pool: Pool = ScenePool(drawn, display, recipe.seed, device)
        about: dict[str, int | str] = {"scenes": "without end", "pool": drawn.pool}
        return Patches(pool, drawn, recipe.seed, grid, about, display)
    assert given is not None
    views = _load_all(given, folder, display)
    about = {"light fields": len(views)}
    return Patches(lambda _: views, given, recipe.seed, grid, about, display)


@dataclass(frozen=True)
class Stored:
    """A finite set, in another order in every epoch."""

    data: StoredScenes
    display: Display
    seed: int

    @cached_property
    def patches(self) -> UInt8[Tensor, "scene view 3 y x"]:
        """One patch of every scene."""
        return scenes(
            self.display, self.data.scenes, self.data.patch,
            seed=first_seed("training", self.seed), stretch=self.data.stretch,
            device=torch.device("cpu"),
        )  # fmt: skip

    @cached_property
    def samples(self) -> UInt8[Tensor, "sample view y x"]:
        """All of it: scene by scene, intensity by intensity, channel by channel."""
        factors = torch.tensor(self.data.intensities)[:, None, None, None, None]
        scaled = self.patches.unsqueeze(1) * factors
        return scaled.round().to(torch.uint8).movedim(3, 2).flatten(0, 2)

    def steps(self, batch: int) -> int:
        return math.ceil(len(self.samples) / batch)

    def batch(self, step: int, count: int) -> Samples:
        epoch, index = divmod(step, self.steps(count))
        order = torch.randperm(len(self.samples), generator=_generator(self.seed, epoch))
        return self.samples[order[index * count : (index + 1) * count]].float() / 255

    def facts(self) -> dict[str, int | str]:
        return {
            "scenes": self.data.scenes,
            "samples": len(self.samples),
            "sha256": hashlib.sha256(self.samples.numpy().tobytes()).hexdigest(),
        }

    def sets(self, recipe: Recipe) -> dict[str, Float[Tensor, "scene view 3 y x"]]:
        train = self.patches[: recipe.judging.scenes].float() / 255
        return {"train": train} | fresh_sets(self.display, recipe)


Pool = Callable[[int], Sequence[Float[Tensor, "view 3 y x"] | UInt8[Tensor, "view 3 y x"]]]


@dataclass(frozen=True)
class Patches:
    """Patches cut at random from the light fields that a pool holds at a step.

    Args:
        pool: step -> views, 8 bit or 0 to 1.
        cut: size and values of patches, and how many steps are called an epoch.
        seed: of the choice.
        grid: of the views, square; samples are then transposed and half-turned at random.
        about: facts for a report.
        display: that is trained for.
    """

    pool: Pool
    cut: Cut
    seed: int
    grid: tuple[int, int] | None
    about: dict[str, int | str]
    display: Display

    def steps(self, batch: int) -> int:
        return self.cut.steps

    def batch(self, step: int, count: int) -> Samples:
        generator = _generator(self.seed, step)
        pool = self.pool(step)
        samples = torch.stack([self._sample(pool, generator) for _ in range(count)])
        return samples if self.grid is None else turned(samples, self.grid, generator)

    def facts(self) -> dict[str, int | str]:
        return self.about

    def sets(self, recipe: Recipe) -> dict[str, Float[Tensor, "scene view c y x"]]:
        return fresh_sets(self.display, recipe)

    def _sample(
        self, pool: Sequence[Tensor], generator: torch.Generator
    ) -> Float[Tensor, "view y x"]:
        def below(bound: int) -> int:
            return int(torch.randint(bound, (), generator=generator))

        def between(low: float, high: float) -> float:
            return low + (high - low) * float(torch.rand((), generator=generator))

        views, side = pool[below(len(pool))], self.cut.patch
        channels, height, width = views.shape[1:]
        top, left = below(height - side + 1), below(width - side + 1)
        window = views[:, below(channels), top : top + side, left : left + side]
        factor = between(*self.cut.intensities)
        values = window if window.is_floating_point() else window.float() / 255
        if self.cut.gammas == (1.0, 1.0):  # draws nothing: older recipes see what they saw
            return values * factor
        low, high = map(math.log, self.cut.gammas)
        return values ** math.exp(between(low, high)) * factor


class ScenePool:
    """Scenes numbered step / every onward; those of earlier steps are let go."""

    def __init__(self, data: DrawnScenes, display: Display, seed: int, device: torch.device):
        self.data, self.display, self.device = data, display, device
        self.first = first_seed("training", seed)
        self._held: dict[int, Tensor] = {}

    def __call__(self, step: int) -> list[UInt8[Tensor, "view 3 y x"]]:
        first = step // self.data.every
        wanted = range(first, first + self.data.pool)
        missing = [n for n in wanted if n not in self._held]
        if missing:
            made = scenes(
                self.display, len(missing), self.data.size, seed=self.first + missing[0],
                stretch=self.data.stretch, device=self.device,
            )  # fmt: skip
            self._held |= dict(zip(missing, made, strict=True))
        self._held = {n: self._held[n] for n in wanted}
        return list(self._held.values())


def turned(samples: Samples, grid: tuple[int, int], generator: torch.Generator) -> Samples:
    """Transpose the batch or not, half-turn it or not; images and view grid together."""
    transpose, half_turn = (torch.rand(2, generator=generator) < 0.5).tolist()
    views = samples.unflatten(1, grid)
    if transpose:
        views = views.permute(0, 2, 1, 4, 3)
    if half_turn:
        views = views.flip(1, 2, 3, 4)
    return views.flatten(1, 2)


def _square_grid(display: Display) -> tuple[int, int]:
    """The view grid of a display on which transposed and half-turned fields are right, too."""
    grid = display.geometry.grid
    if grid is not None and grid[0] == grid[1]:
        points = torch.tensor(display.geometry.slopes).unflatten(0, grid)
        transposed, half_turn = points.transpose(0, 1).flip(-1), -points.flip(0, 1)
        if torch.allclose(points, transposed) and torch.allclose(points, half_turn):
            return grid
    raise ValueError(
        f"'symmetries' needs a square view grid with equal steps along x and y; those of display "
        f"'{display.name}' are not; set it to false"
    )


def _load_all(data: FieldFolder, folder: Path, display: Display) -> list[Tensor]:
    """The views of all light fields in a folder, those of the display."""
    root = folder / data.folder
    if not root.is_dir():
        raise ValueError(
            f"there is no folder {root} of training data; say which in 'fields.folder'"
        )
    options = field_options(data.options)
    found = [p for p in sorted(root.iterdir()) if not p.name.startswith(".")]
    fields = [load_light_field(path, options) for path in found]
    for field in fields:
        pose(field, display)
        if min(field.size) < data.patch:
            height, width = field.size
            raise ValueError(
                f"'{field.name}' is {width}x{height} px, smaller than patches of {data.patch} px"
            )
    if not fields:
        raise ValueError(f"{root} holds no light fields to train on")
    return [field.views for field in fields]


def field_options(given: dict[str, str | int | float]) -> FieldOptions:
    """Return reading options; the keys are those of the command line.

    Raises:
        ValueError: an unknown key, with the nearest one.
    """
    known = inspect.signature(FieldOptions.parse).parameters
    for key in given:
        if key not in known:
            raise ValueError(f"unknown key 'fields.options.{key}'{did_you_mean(key, known)}")
    return FieldOptions.parse(**{key: str(value) for key, value in given.items()})


def _generator(seed: int, number: int) -> torch.Generator:
    digest = hashlib.sha256(f"{seed} {number}".encode()).digest()
    return torch.Generator().manual_seed(int.from_bytes(digest[:4], "big"))
