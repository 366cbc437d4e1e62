"""How the steps of `fast` are trained, as it is written down."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from layerfield.display import Display
from layerfield.display_spec import Depths, DisparitySpec
from layerfield.toml_model import validated
from layerfield.training.recipe import Count, Positive, Table, recipe_data

Size = Annotated[int, Field(strict=True, ge=48)]


class Grid(Table):
    """A display to train on: as in a display file.

    Args:
        views: rows and columns of viewpoints.
        disparity: of every layer, front to back, pixels per view step.
    """

    views: tuple[Count, Count]
    disparity: Depths

    @model_validator(mode="after")
    def _is_a_display(self):
        self.display("additive")
        return self

    def display(self, link: str) -> Display:
        """Return the display with a link."""
        facts = {"name": "trained on", "link": link, **self.model_dump()}
        rows, columns = self.views
        return Display(validated(DisparitySpec, facts, f"{rows}x{columns} views"))


class Stage(Table):
    """A further stage of a training, on scenes of another size; arguments as of `StepsRecipe`."""

    size: Size
    scenes: Count
    batch: Count | None = None
    iterations: Count
    rate: Positive


class StepsRecipe(Table):
    """Everything that a training of learned steps depends on.

    Args:
        name: of the recipe and of its run.
        description: one sentence.
        solver: what is trained.
        link: of the displays: light that adds up, or logarithms of light that multiplies.
        steps: numbers of steps; constants are learned for each by itself. Where light is
            multiplied they are Newton steps.
        before: number of steps on logarithms before those, where light is multiplied.
        coarse: number of steps on large pixels.
        relief: channels of the network behind the first of several steps, see `Relief`, which is
            learned in the last stage; 0 for none.
        darkest: darker light is taken for this before its logarithm.
        frames: of videos whose frames start from the one before; 1 for pictures that do not move.
        displays: to train on.
        scenes: of every display; size: their height and width, pixels.
        batch: so many of them are learned from at a time; all of a display unless told otherwise.
        stretch: range of their disparities, in units of the depth of the display.
        gammas: the lowest and the highest exponent of their values.
        iterations: of the optimiser, Adam, for every number of steps.
        rate: the highest, which falls to 0 along half a cosine.
        then: further stages, which go on from what was learned: constants are found sooner on many
            small scenes, but light of the lowest frequencies is only in large ones.
        seed: of scenes.
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
    description: str = ""
    solver: Literal["fast"]
    link: Literal["additive", "multiplicative"]
    steps: Annotated[tuple[Count, ...], Field(min_length=1)]
    before: Annotated[int, Field(strict=True, ge=0)] = 0
    coarse: Annotated[int, Field(strict=True, ge=0)] = 6
    relief: Annotated[int, Field(strict=True, ge=0, le=64)] = 0
    darkest: Positive = 0.1
    frames: Count = 1
    displays: Annotated[tuple[Grid, ...], Field(min_length=1)]
    scenes: Count = 6
    size: Size = 96
    batch: Count | None = None
    stretch: tuple[Positive, Positive] = (0.6, 2.5)
    gammas: tuple[Positive, Positive] = (1.0, 2.2)
    iterations: Count = 300
    rate: Positive = 0.02
    then: tuple[Stage, ...] = ()
    seed: Annotated[int, Field(strict=True, ge=0, le=255)] = 0

    def rows(self, steps: int) -> tuple[int, int, int, int]:
        """Return what `LearnedSteps` is made with where so many steps are asked for."""
        if self.link == "multiplicative":
            return self.before, self.coarse, steps, self.relief
        return steps, self.coarse, 0, self.relief

    @property
    def stages(self) -> list["StepsRecipe"]:
        """The recipe of every stage."""
        alone = self.model_copy(update={"then": ()})
        made = [alone, *(alone.model_copy(update=stage.model_dump()) for stage in self.then)]
        return [*(each.model_copy(update={"relief": 0}) for each in made[:-1]), made[-1]]

    @property
    def together(self) -> int:
        """Scenes of a display that are learned from at a time."""
        return self.batch or self.scenes

    @model_validator(mode="after")
    def _each_once(self):
        if len(set(self.steps)) < len(self.steps):
            raise ValueError(f"'steps' is {list(self.steps)}, expected every number once")
        return self

    @model_validator(mode="after")
    def _warm_where_light_adds_up(self):
        if self.frames > 1 and (self.link, self.coarse) != ("additive", 0):
            raise ValueError(
                f"'frames' is {self.frames}, but link and coarse are '{self.link}' and "
                f"{self.coarse}; expected 'additive' and 0"
            )
        return self

    @model_validator(mode="after")
    def _relief_where_pictures_start_anew(self):
        if self.relief and self.frames > 1:
            raise ValueError(f"'relief' is {self.relief}, expected 0 for videos")
        return self

    @model_validator(mode="after")
    def _batches_of_pictures(self):
        for stage in (self, *self.then):
            if stage.batch and self.frames > 1:
                raise ValueError(f"'batch' is {stage.batch}, expected none for videos")
        return self

    @model_validator(mode="after")
    def _before_where_light_is_multiplied(self):
        if (self.before > 0) != (self.link == "multiplicative"):
            expected = "0" if self.link == "additive" else "1 or more"
            raise ValueError(
                f"'before' is {self.before}, expected {expected} where light is {self.link}"
            )
        return self

    @model_validator(mode="after")
    def _lowest_first(self):
        for name, (low, high) in (("stretch", self.stretch), ("gammas", self.gammas)):
            if low > high:
                raise ValueError(f"'{name}' is [{low:g}, {high:g}], expected the lower one first")
        return self


def read_steps_recipe(name: str | Path) -> StepsRecipe:
    """Return the recipe of learned steps, by its name or from a TOML file.

    Raises:
        ValueError: no such recipe or file, or a file that is no recipe, with the key.
    """
    data, source = recipe_data(name)
    return validated(StepsRecipe, data, source)


def is_of_steps(name: str | Path) -> bool:
    """Say whether a recipe is for learned steps: it names a solver, not a network."""
    return "solver" in recipe_data(name)[0]
