"""A network tuned to one light field: the loss needs no labels, so the field itself will do."""

from dataclasses import replace

from jaxtyping import Float
from torch import Tensor

from layerfield.light_field import LightField
from layerfield.networks import Network
from layerfield.synthesizer import pose
from layerfield.training.loop import Run
from layerfield.training.recipe import Cut, Optimiser, Recipe
from layerfield.training.sources import Patches

STEPS = 100
_RATE = 0.2  # of the recipe's highest rate
_LARGEST = 256  # pixels of the field that progress is judged on


class OneField(Patches):
    """Patches of one light field, which is also what counts in the end."""

    def sets(self, recipe: Recipe) -> dict[str, Float[Tensor, "scene view c y x"]]:
        middle = _middle(self.pool(0)[0])
        return {"validation": middle, "test": middle}


def adaptation(run: Run, field: LightField, network: Network) -> Run:
    """Return the run that tunes a trained network to a field, about 100 steps.

    Args:
        run: with the recipe that the network was trained by.
        field: with the views of the recipe's display.
        network: to start from.

    Raises:
        ValueError: the views are not those of the display, or smaller than a patch.
    """
    recipe, display = _recipe(run.recipe, field), run.display
    pose(field, display)
    cut = Cut(patch=recipe.patch, intensities=(0.7, 1.0), steps=STEPS)
    about: dict[str, int | str] = {"adapted to": field.name}
    source = OneField(lambda _: [field.views], cut, recipe.seed, None, about, display)
    return replace(run, recipe=recipe, initial=network, source=source)


def _recipe(recipe: Recipe, field: LightField) -> Recipe:
    chosen = recipe.optimiser
    slower = Optimiser(name=chosen.name, rate=chosen.rate * _RATE, schedule="cosine")
    if min(field.size) < recipe.patch:
        height, width = field.size
        raise ValueError(
            f"'{field.name}' is {width}x{height} px, smaller than the patches of {recipe.patch} px "
            f"that recipe '{recipe.name}' trains on"
        )
    return recipe.model_copy(
        update={"name": f"{recipe.name}-adapted", "epochs": 1, "optimiser": slower}
    )


def _middle(views: Tensor) -> Float[Tensor, "1 view c y x"]:
    """The middle of a light field, as one scene."""
    (height, width), size = (min(n, _LARGEST) for n in views.shape[-2:]), views.shape[-2:]
    top, left = (size[0] - height) // 2, (size[1] - width) // 2
    return views[None, ..., top : top + height, left : left + width]
