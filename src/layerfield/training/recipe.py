"""A training as it is written down: validated data, one TOML file."""

import inspect
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, StrictBool, StrictInt, model_validator

from layerfield.nearest import did_you_mean
from layerfield.networks import NETWORKS
from layerfield.toml_model import parse_toml, read_toml_text, validated

_RECIPES = files("layerfield") / "training" / "recipes"

Count = Annotated[int, Field(strict=True, ge=1)]
Positive = Annotated[float, Field(strict=True, gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(strict=True, ge=0, allow_inf_nan=False)]
Stretch = Positive | tuple[Positive, Positive]
Factors = Annotated[tuple[Positive, ...], Field(min_length=1)]


class Table(BaseModel):
    """A table of a recipe: no unknown keys, not to be changed."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class StoredScenes(Table):
    """A finite set of patches of procedural scenes; one epoch is one pass.

    A sample is one colour channel of a patch, its intensity multiplied by one of the factors.

    Args:
        scenes: how many; one patch is cut from each.
        patch: height and width of a patch, pixels.
        intensities: factors; every channel of every patch appears with each of them.
        stretch: range of disparities, in units of the depth of the display.
    """

    scenes: Count
    patch: Annotated[int, Field(strict=True, ge=16)]
    intensities: Factors = (1.0,)
    stretch: Positive = 1.0


class Cut(Table):
    """How patches are cut from light fields at random.

    Args:
        patch: height and width of a patch, pixels.
        intensities: the lowest and the highest factor.
        gammas: the lowest and the highest exponent of the values, before the factor: the same
            scene with other tones, as deeper blacks beside bright pixels. 1 and 1 leave them.
        steps: of an epoch.
    """

    patch: Annotated[int, Field(strict=True, ge=16)]
    intensities: tuple[Positive, Positive] = (0.4, 1.0)
    gammas: tuple[Positive, Positive] = (1.0, 1.0)
    steps: Count = 100

    @model_validator(mode="after")
    def _lowest_first(self):
        for name, (low, high) in (("intensities", self.intensities), ("gammas", self.gammas)):
            if low > high:
                raise ValueError(f"'{name}' is [{low:g}, {high:g}], expected the lower one first")
        return self


class DrawnScenes(Cut):
    """Procedural scenes without end: patches of a pool in which new scenes replace old ones.

    Args:
        pool: scenes at hand at any time.
        every: steps after which the oldest scene is replaced.
        size: height and width of the scenes, pixels.
        stretch: range of disparities, in units of the depth of the display; of a pair, every
            scene draws its own, evenly in its logarithm.
    """

    pool: Count
    every: Count
    size: Annotated[int, Field(strict=True, ge=16)]
    stretch: Stretch = 1.0

    @model_validator(mode="after")
    def _patches_fit(self):
        _refuse_large(self.patch, self.size)
        return self


class FieldFolder(Cut):
    """Patches of light fields of the user's own.

    Args:
        folder: holds light fields, whatever reader they need; relative to the recipe.
        options: how to read them, as on the command line (`views = "5x5"`).
    """

    folder: str
    options: dict[str, str | int | float] = {}


class Loss(Table):
    """Mean square error of the views plus weight times a regulariser of the pixel values.

    Args:
        regulariser: `range`, mean of relu(P - 1)^2 + relu(-P)^2, or `energy`, mean of P^2.
        weight: of it.
        error: `mean`, the mean square error of the batch as in the paper, or `log`, the mean
            logarithm of the mean square errors of the samples: dark and easy samples then count
            as much as difficult ones, as they do in PSNR.
        clamped: layers show no more than 1, as at synthesis, not what the network says, as in the
            paper. Where layers multiply, values above 1 would be worth too much.
    """

    regulariser: Literal["range", "energy"] = "range"
    weight: NotNegative = 0.1
    error: Literal["mean", "log"] = "mean"
    clamped: bool = False


class Optimiser(Table):
    """How weights follow gradients.

    Args:
        name: `adam`, as in the paper, or `muon`: orthogonalised momentum for kernels, Adam for
            the rest.
        rate: the highest learning rate.
        schedule: `constant`, or `cosine`: a rise over the first 2 % of the steps, then half a
            cosine down to 0.
    """

    name: Literal["adam", "muon"] = "adam"
    rate: Positive = 1e-4
    schedule: Literal["constant", "cosine"] = "constant"


class Judging(Table):
    """Validation and test scenes, disjoint from each other and from those of training.

    Args:
        scenes: of each.
        size: height and width, pixels.
        stretch: as of the scenes to train on.
    """

    scenes: Count = 12
    size: Annotated[int, Field(strict=True, ge=16)] = 96
    stretch: Stretch = 1.0


class Recipe(Table):
    """Everything that a training depends on.

    Args:
        name: of the recipe and of its run.
        description: one sentence.
        display: a preset or a display file (relative to the recipe).
        network: one of `NETWORKS`.
        options: of the network: width, depth, skips or modules.
        stored: training data: this, or
        drawn: this, or
        fields: this.
        loss: what is minimised.
        optimiser: how.
        judging: what checkpoints are judged on.
        batch: samples of a step, over all devices.
        epochs: how many.
        start: `drawn`: Kaiming initialisation as it comes, `even`: its output channels scaled
            so that all layers share what is shown, `identity`: besides, every convolution but
            the last hands on what it gets, plus a share of what was drawn. Or else the name of
            shipped weights, or a weight file, of such a network: it learns from what it knows.
            A stacked CNN may start from one of fewer modules.
        symmetries: transpose or half-turn samples at random, image and view grid together. (One
            without the other would change the mapping from angles to depths.)
        precision: of convolutions, `fp32` or `bf16`; weights and losses are fp32.
        seed: of weights, order, patches and scenes.
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
    description: str = ""
    display: str
    network: str
    options: dict[str, StrictInt | StrictBool] = {}
    stored: StoredScenes | None = None
    drawn: DrawnScenes | None = None
    fields: FieldFolder | None = None
    loss: Loss = Loss()
    optimiser: Optimiser = Optimiser()
    judging: Judging = Judging()
    batch: Count = 15
    epochs: Count = 100
    start: str = "drawn"
    symmetries: bool = False
    precision: Literal["fp32", "bf16"] = "fp32"
    seed: Annotated[int, Field(strict=True, ge=0, le=255)] = 0

    @model_validator(mode="after")
    def _network_exists(self):
        if self.network not in NETWORKS:
            raise ValueError(
                f"unknown network '{self.network}'{did_you_mean(self.network, NETWORKS)}"
            )
        known = dict(list(inspect.signature(NETWORKS[self.network]).parameters.items())[2:])
        for key, value in self.options.items():
            if key not in known:
                raise ValueError(f"unknown key 'options.{key}'{did_you_mean(key, known)}")
            switch = isinstance(known[key].default, bool)
            if isinstance(value, bool) != switch or not (switch or value >= 1):
                expected = "true or false" if switch else "a whole number of at least 1"
                raise ValueError(f"'options.{key}' is {value!r}, expected {expected}")
        return self

    @model_validator(mode="after")
    def _has_one_source(self):
        found = [key for key in ("stored", "drawn", "fields") if getattr(self, key) is not None]
        if len(found) != 1:
            named = " and ".join(f"[{key}]" for key in found) or "none"
            raise ValueError(
                f"expected one table of training data, [stored], [drawn] or [fields]; found {named}"
            )
        if self.stored is not None and self.symmetries:
            raise ValueError(
                "'symmetries' turns samples of [drawn] and [fields]; those of [stored] "
                "stay as they are: leave it out"
            )
        return self

    @property
    def patch(self) -> int:
        """Height and width of what a step is made on, pixels."""
        source = self.stored or self.drawn or self.fields
        assert source is not None
        return source.patch


def recipe_names() -> list[str]:
    """Names of the recipes that come with the package, sorted."""
    found = (entry.name for entry in _RECIPES.iterdir())
    return sorted(name.removesuffix(".toml") for name in found if name.endswith(".toml"))


def read_recipe(name: str | Path) -> Recipe:
    """Return the recipe of a network, by its name or from a TOML file.

    Raises:
        ValueError: no such recipe or file, or a file that is no recipe, with the key.
    """
    data, source = recipe_data(name)
    return validated(Recipe, data, source)


def recipe_data(name: str | Path) -> tuple[dict[str, Any], str]:
    """Return what a recipe says, of a network or of learned steps, and where that was found.

    A path whose file does not exist, as `recipes/quick.toml`, means the recipe that ships under
    that name.

    Raises:
        ValueError: no such recipe or file, or no TOML.
    """
    path = Path(name)
    if path.is_file():
        text, source = read_toml_text(path, "a recipe"), str(path)
    elif path.stem in recipe_names() and path.suffix in ("", ".toml"):
        text, source = (_RECIPES / f"{path.stem}.toml").read_text("utf-8"), path.stem
    else:
        near = did_you_mean(path.stem, recipe_names())
        raise ValueError(
            f"there is no file {name}, and no such recipe ships: unknown recipe '{path.stem}'{near}"
        )
    return parse_toml(text, source), source


def _refuse_large(patch: int, size: int) -> None:
    if patch > size:
        raise ValueError(f"patches of {patch} px do not fit into scenes of {size} px")
