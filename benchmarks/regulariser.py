"""What the regulariser of the training loss does: two readings, three weights.

    python benchmarks/regulariser.py OUT.json [STEPS]

Trains the network of the recipe `quick` for a few hundred steps with each, and prints PSNR on
validation and test scenes with the share of pixels that synthesis has to clamp.
"""

import json
import sys
import tempfile
from pathlib import Path

import torch

from layerfield import Display, LightField, synthesize
from layerfield.training.loop import Run, train
from layerfield.training.recipe import Loss, Recipe, read_recipe
from layerfield.training.records import WEIGHTS
from layerfield.training.sources import fresh_sets

READINGS = ("range", "energy")
STRENGTHS = (0.01, 0.1, 1.0)


def main(out: Path, steps: int) -> None:
    quick = read_recipe("quick")
    assert quick.drawn is not None
    epochs = max(steps // quick.drawn.steps, 1)
    rows = []
    for reading in READINGS:
        for weight in STRENGTHS:
            loss = Loss(regulariser=reading, weight=weight, error=quick.loss.error)
            rows.append(measured(quick.model_copy(update={"epochs": epochs, "loss": loss})))
            print(rows[-1], flush=True)
    out.write_text(json.dumps({"recipe": "quick", "epochs": epochs, "rows": rows}, indent=1))


def measured(recipe: Recipe) -> dict:
    with tempfile.TemporaryDirectory() as folder:
        run = Run(recipe=recipe, out=Path(folder) / "run")
        facts = train(run)
        test = fresh_sets(run.display, recipe)["test"]
        clamped, shares = pixels(str(run.out / WEIGHTS), test, run.display)
    return {
        "regulariser": recipe.loss.regulariser,
        "weight": recipe.loss.weight,
        "validation_psnr": round(facts["best"]["validation_psnr"], 3),
        "test_psnr": round(facts["best"]["test_psnr"], 3),
        "clamped": round(clamped, 6),
        "shares": [round(share, 3) for share in shares],
    }


def pixels(weights: str, views: torch.Tensor, display: Display) -> tuple[float, list[float]]:
    """The share of pixels above 1, and of light in every layer."""
    grid = display.geometry.grid or (1, display.view_count)
    found = synthesize(LightField(views, grid), display, method=weights)
    light = found.layers.mean(dim=(0, 1, 3, 4, 5))
    return float(found.details["clamped"]), (light / light.sum()).tolist()


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 400)
