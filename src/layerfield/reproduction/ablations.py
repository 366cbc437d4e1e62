"""What the paper says of skips, depth, picture size and augmentation, on narrow networks.

Everything is the recipe `gao2024-unet` or `gao2024-stacked-cnn` but for width, rate and steps (see
`Scale`), and for the one thing that is tried out.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import interpolate

from layerfield.display import Display
from layerfield.light_field import LightField
from layerfield.metrics import decibels, psnr
from layerfield.networks import Network
from layerfield.networks.frame import pixels
from layerfield.report.plots import Cell, Level, Line, Panel, Sheet, chart, save, sheet
from layerfield.reproduction.claims import Check, Claim, better
from layerfield.reproduction.contenders import CNN, COLOURS, RECIPES, UNET
from layerfield.reproduction.measures import Tick
from layerfield.synthesizer import synthesize
from layerfield.training.loop import Run, train
from layerfield.training.objective import Objective, shown_by
from layerfield.training.recipe import Recipe, StoredScenes, read_recipe
from layerfield.training.records import WEIGHTS, History, read_history
from layerfield.training.sources import Samples, Stored, turned
from layerfield.training.start import starting_network
from layerfield.weights import read_weights

COLLAPSED = 0.1  # of the target's contrast
VANISHED = 0.01  # of the last module's gradient, relative to its weights
_STRETCH = 1.5  # of pictures that are scaled
_SHADES = ("#0072B2", "#E69F00", "#009E73", "#CC79A7")

Change = Callable[[Samples, torch.Generator], Samples]


@dataclass(frozen=True)
class Scale:
    """How small the trainings are.

    Args:
        steps: of every training, at the least; whole epochs are made.
        width: of the networks instead of 64.
        rate: of Adam instead of 1e-4, as there are few steps.
        scenes: of the training data.
        patch: height and width of patches, pixels; the paper's "reduced pixel number".
        large: the same where pictures are not reduced.
        large_batch: samples of a step there instead of 15.
        stacks: numbers of modules.
    """

    steps: int = 400
    width: int = 16
    rate: float = 1e-3
    scenes: int = 50
    patch: int = 64
    large: int = 256
    large_batch: int = 4
    stacks: tuple[int, ...] = (5, 10, 19, 30)


@dataclass(frozen=True, eq=False)
class Trial:
    """A small training that has ended."""

    recipe: Recipe
    source: Stored
    history: History
    network: Network

    @property
    def tested(self) -> float:
        """PSNR on test scenes of the epoch that validation chooses, dB."""
        return max(self.history, key=lambda row: row["validation_psnr"])["test_psnr"]

    def line(self, label: str, colour: str, style: str = "-") -> Line:
        """Return its test PSNR against steps."""
        steps = [row["step"] for row in self.history]
        return Line(label, steps, [row["test_psnr"] for row in self.history], colour, style)


@dataclass(frozen=True)
class Changed(Stored):
    """Stored samples, changed at random whenever they are drawn."""

    change: Change

    def batch(self, step: int, count: int) -> Samples:
        generator = torch.Generator().manual_seed(step)
        return self.change(super().batch(step, count), generator)


def ablate(folder: Path, scale: Scale | None = None, tick: Tick = lambda _: None) -> list[Claim]:
    """Train the variants, draw their figures into a folder, and judge."""
    chosen = scale or Scale()
    usual = _tried(_recipe(UNET, chosen), tick)
    return [
        _skips(folder, chosen, usual, tick),
        _modules(folder, chosen, tick),
        _large_pictures(folder, chosen, usual, tick),
        _augmentation(folder, chosen, usual, tick),
    ]


def _recipe(
    network: str, scale: Scale, *, options: dict[str, Any] | None = None, large: bool = False
) -> Recipe:
    """Return the paper's recipe of a network, scaled down."""
    paper = read_recipe(RECIPES[network])
    assert paper.stored is not None
    size = scale.large if large else scale.patch
    batch = scale.large_batch if large else paper.batch
    stored = paper.stored.model_copy(update={"scenes": scale.scenes, "patch": size})
    samples = scale.scenes * 3 * len(stored.intensities)
    return paper.model_copy(
        update={
            "options": {**paper.options, "width": scale.width} | (options or {}),
            "stored": stored,
            "batch": batch,
            "epochs": math.ceil(scale.steps / math.ceil(samples / batch)),
            "optimiser": paper.optimiser.model_copy(update={"rate": scale.rate}),
            "judging": paper.judging.model_copy(
                update={"scenes": min(6, scale.scenes), "size": scale.patch}
            ),
        }
    )


def _tried(recipe: Recipe, tick: Tick, change: Change | None = None) -> Trial:
    display = Display.load(recipe.display)
    data = recipe.stored
    assert data is not None
    source = _source(data, display, recipe.seed, change)
    with TemporaryDirectory() as place:
        out = Path(place) / "run"
        run = Run(recipe=recipe, out=out, source=source, tick=lambda what, _: tick(what))
        train(run)
        return Trial(recipe, source, read_history(out), read_weights(out / WEIGHTS).network)


def _source(data: StoredScenes, display: Display, seed: int, change: Change | None) -> Stored:
    if change is None:
        return Stored(data, display, seed)
    return Changed(data, display, seed, change)


# ------------------------------------------------------------------------------ A. skip connections


def _skips(folder: Path, scale: Scale, usual: Trial, tick: Tick) -> Claim:
    without = _tried(_recipe(UNET, scale, options={"skips": False}), tick)
    lines = [
        usual.line("with skip connections", COLOURS[UNET]),
        without.line("without", COLOURS[UNET], ":"),
    ]
    _save_curves(folder / "ablation-skips.png", "Ablation A. Skip connections of the U-Net", lines)
    check = Check(
        f"higher test PSNR with skip connections after {usual.history[-1]['step']:.0f} steps",
        better(usual.tested, without.tested),
        f"with {usual.tested:.2f}, without {without.tested:.2f} dB",
    )
    return Claim("A", (check,), (_small(scale),))


def _save_curves(path: Path, title: str, lines: Sequence[Line], *levels: Level) -> None:
    save(chart(title, [Panel("", "steps", "PSNR of test scenes, dB", lines, levels)]), path)


def _small(scale: Scale) -> str:
    return (
        f"networks of width {scale.width} instead of 64, Adam {scale.rate:g} instead of 1e-4, "
        f"about {scale.steps} steps instead of 2000, one seed: a tendency, no proof"
    )


# --------------------------------------------------------------------------------------- B. modules


def _modules(folder: Path, scale: Scale, tick: Tick) -> Claim:
    before, after, tested = {}, {}, {}
    for count in scale.stacks:
        trial = _tried(_recipe(CNN, scale, options={"modules": count}), tick)
        display = Display.load(trial.recipe.display)
        start, _ = starting_network(trial.recipe, display, trial.source, Path())
        before[count] = gradients(start, trial)
        after[count] = gradients(trial.network, trial)
        tested[count] = trial.tested
    panels = [
        Panel(title, "convolution, from the input on", "gradient / weights (norms)", _norms(found))
        for title, found in (("at initialisation", before), ("after training", after))
    ]
    title = "Ablation B. Gradient of every convolution of the stacked CNN, by modules"
    save(chart(title, panels, log_y=True), folder / "ablation-modules.png")
    deepest = max(scale.stacks)
    first = [f"{n} modules {found[0] / found[-1]:.3g}" for n, found in before.items()]
    best = max(tested, key=lambda n: tested[n])
    checks = (
        Check(
            f"with {deepest} modules the first gradient is below {VANISHED:.0%} of the last at the "
            "start",
            before[deepest][0] < VANISHED * before[deepest][-1],
            "first over last: " + ", ".join(first),
        ),
        Check(
            f"{deepest} modules reach less than the best stack",
            better(tested[best], tested[deepest]),
            ", ".join(f"{n} modules {value:.2f} dB" for n, value in tested.items()),
        ),
    )
    return Claim("B", checks, (_small(scale),))


def gradients(network: Network, trial: Trial) -> list[float]:
    """Return |dE/dw| / |w| of every convolution on the first batch, from the input on."""
    objective = Objective(network, Display.load(trial.recipe.display), trial.recipe.loss)
    network.zero_grad()
    objective(trial.source.batch(0, trial.recipe.batch)).backward()
    found = []
    for module in network.modules():
        if isinstance(module, nn.Conv2d):
            assert module.weight.grad is not None
            found.append((module.weight.grad.norm() / module.weight.norm()).item())
    return found


def _norms(found: dict[int, list[float]]) -> list[Line]:
    return [
        Line(f"{n} modules", range(1, len(values) + 1), values, _SHADES[k % len(_SHADES)])
        for k, (n, values) in enumerate(found.items())
    ]


# -------------------------------------------------------------------------------- C. large pictures


def _large_pictures(folder: Path, scale: Scale, usual: Trial, tick: Tick) -> Claim:
    large = _tried(_recipe(UNET, scale, large=True), tick)
    target = usual.source.sets(usual.recipe)["test"]
    display = Display.load(usual.recipe.display)
    seen = {
        f"{each.recipe.patch} px": _views(each.network, target, display) for each in (usual, large)
    }
    kept = {name: contrast(views, target) for name, views in seen.items()}
    middle = display.view_count // 2
    rows = [("target", "black", [Cell(scene[middle]) for scene in target[:4]])]
    rows += [
        (f"trained on {name}", "black", [Cell(scene[middle]) for scene in views[:4]])
        for name, views in seen.items()
    ]
    title = "Ablation C. Central views of test scenes, U-Net trained on small or large pictures"
    save(sheet(Sheet(title, rows)), folder / "ablation-pixels.png")
    small, big = kept.values()
    check = Check(
        f"trained on {scale.large} px it keeps less than {COLLAPSED:.0%} of the contrast, on "
        f"{scale.patch} px more",
        big < COLLAPSED <= small,
        ", ".join(f"{name} {value:.0%}" for name, value in kept.items())
        + f"; {usual.tested:.2f} and {large.tested:.2f} dB",
    )
    note = f"batches of {usual.recipe.batch} and {large.recipe.batch}, as larger pictures take more"
    return Claim("C", (check,), (note, _small(scale)))


def _views(
    network: Network, scenes: Float[Tensor, "scene view c y x"], display: Display
) -> Float[Tensor, "scene view c y x"]:
    channels = scenes.transpose(1, 2).flatten(0, 1)
    with torch.no_grad():
        shown = shown_by(display, pixels(network, channels, display.margin).clamp(0, 1))
    return shown.unflatten(0, (len(scenes), -1)).transpose(1, 2)


def contrast(views: Tensor, target: Tensor) -> float:
    """Return how much of the deviation within a picture is left, the mean over scenes."""
    deviations = [each.flatten(-2).std(dim=-1).flatten(1).mean(dim=1) for each in (views, target)]
    return (deviations[0] / deviations[1]).mean().item()


# --------------------------------------------------------------------------------- D. augmentation


def rotated(samples: Samples, generator: torch.Generator) -> Samples:
    """Turn all images by 0, 90, 180 or 270 degrees, the view grid left as it is: not valid."""
    return samples.rot90(int(torch.randint(4, (), generator=generator)), (-2, -1))


def scaled(samples: Samples, generator: torch.Generator) -> Samples:
    """Enlarge all images by 1 to 1.5, and their disparities with them: beyond the display."""
    factor = 1 + (_STRETCH - 1) * float(torch.rand((), generator=generator))
    size = samples.shape[-1]
    larger = interpolate(samples, scale_factor=factor, mode="bilinear", antialias=True)
    start = (larger.shape[-1] - size) // 2
    return larger[..., start : start + size, start : start + size]


def _augmentation(folder: Path, scale: Scale, usual: Trial, tick: Tick) -> Claim:
    display = Display.load(usual.recipe.display)
    grid = display.geometry.grid or (1, display.view_count)
    changes: dict[str, Change] = {
        "image and view grid together": lambda samples, g: turned(samples, grid, g),
        "images rotated": rotated,
        "images scaled": scaled,
    }
    trials = {"none": usual} | {
        name: _tried(_recipe(UNET, scale), tick, change) for name, change in changes.items()
    }
    lines = [t.line(n, c) for (n, t), c in zip(trials.items(), _SHADES, strict=True)]
    _save_curves(folder / "ablation-augmentation.png", "Ablation D. Augmentation, U-Net", lines)
    test = usual.source.sets(usual.recipe)["test"]
    shown = {name: _optimum(test, change, display) for name, change in changes.items()}
    plain = _optimum(test, lambda samples, _: samples, display)
    tested = ", ".join(f"{name} {trial.tested:.2f}" for name, trial in trials.items())
    checks = tuple(
        Check(
            f"{name} is worse than none on test scenes",
            better(usual.tested, trials[name].tested),
            f"{trials[name].tested:.2f} and {usual.tested:.2f} dB",
        )
        for name in ("images rotated", "images scaled")
    )
    beside = (
        f"test PSNR, dB: {tested}",
        f"what the display can show of test scenes so changed, solver, dB: unchanged {plain:.2f}, "
        + ", ".join(f"{name} {value:.2f}" for name, value in shown.items()),
        "a joint transpose or half turn of image and view grid keeps the mapping and is valid",
        _small(scale),
    )
    return Claim("D", checks, beside)


def _optimum(scenes: Float[Tensor, "scene view c y x"], change: Change, display: Display) -> float:
    """Mean over scenes of what the direct solver reaches on changed light fields, dB."""
    generator = torch.Generator().manual_seed(1)
    total = 0.0
    for scene in scenes:
        views = change(scene.transpose(0, 1), generator).transpose(0, 1).contiguous()
        field = LightField(views, display.geometry.grid or (1, display.view_count))
        layers = synthesize(field, display, iterations=40).layers
        total += min(psnr(display(layers), views), decibels(1e-10))
    return total / len(scenes)
